"""Errors that the mesh has no part in, measured by what the solution on the first mesh makes of other settings."""

from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.adapt.settings import PARTNER_RTOL, STEPS_RATE
from pcontact.adapt.watch import Beginning
from pcontact.contact.surface.smooth_geometry import smooth_surface
from pcontact.estimate import pressures
from pcontact.estimate.goal import value
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD
from pcontact.runtime.observer import Observer
from pcontact.simulation import Simulation

# degrees that the quadrature of contact is raised by, where a finer one is tried
HIGHER = 4


@contextmanager
def solved(scene, comm, said, mesh, known=None):
    """A run in memory whose lines are not shown, and the record of its last load step; None where it does not converge.
    It begins where the bodies are known to be, see :class:`pcontact.adapt.watch.Beginning`. *Collective.*
    """
    simulation = Simulation(scene, comm, said, mesh)
    # estimates are those of all load steps
    simulation.newton.lasting, simulation.every = True, scene.output.estimate
    if known is not None:
        simulation.begin = Beginning(simulation, known)
    try:
        with log.quiet():
            last = Last()
            converged = simulation.run(None, [last])
        yield simulation, last.record if converged else None
    finally:
        simulation.free()


def with_steps(scene, count):
    """The scene with another number of load steps."""
    return replace(scene, steps=replace(scene.steps, count=count))


def finer_quadrature(scene, degree):
    """The scene with more quadrature points on its contacts, for a displacement of a degree."""
    usual = 2 * degree + 5
    contacts = [replace(one, quadrature=(one.quadrature or usual) + HIGHER) for one in scene.contacts]
    return replace(scene, contacts=contacts)


def smooth_facets(scene):
    """The scene with the gaps of the smooth surfaces that facets stand for."""
    contacts = [one if one.tied else replace(one, smooth_geometry=True) for one in scene.contacts]
    return replace(scene, contacts=contacts)


def searching(scene):
    """The scene whose contacts look for partners in each load step until they stay."""
    return replace(scene, petsc={**scene.petsc, PARTNER_RTOL: f"{0.01 * float(scene.petsc[PARTNER_RTOL]):.3g}"})


def bent(simulation):
    """Whether the facets of a contact stand for a smooth surface that they are not. *Collective.*"""
    names = {name for one in simulation.scene.contacts if not one.tied for name in (one.source, one.target)} - {None}
    return any([smooth_surface(simulation.problem.space, name, True) is not None for name in sorted(names)])


class Last(Observer):
    """Observer that keeps the record of the last load step."""

    def __init__(self):
        self.record = None

    def step(self, step, u, record):
        """Keep it."""
        self.record = record


def of_facets(simulation, scene, target):
    """What the smooth surfaces that facets stand for change in a solution of degree 2. *Collective.*

    Finer cells follow the gaps between facets as those of degree 2 do on the mesh given; those of degree 1 do not.

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
    scene : pcontact.scene.model.Scene
        To be run on the same mesh.
    target : pcontact.scene.target.Target
        Of what the change counts.

    Returns
    -------
    float
        As of :func:`difference`.
    """
    comm, said = simulation.comm, simulation.options.said
    # a straight mesh has no nodes for degree 2, but that of its file can be completed
    mesh = simulation.mesh if simulation.mesh.degree == 2 else None
    scene = replace(scene, mesh=replace(scene.mesh, order=2), output=replace(scene.output, checkpoint=False))
    smooth = replace(smooth_facets(scene), output=replace(scene.output, estimate=True))
    values, quantities = [], []
    try:
        for one in (scene, smooth):
            with solved(one, comm, said, mesh) as (run, last):
                if last is None:
                    return float("nan")
                values.append(run.stepper.u.getArray(readonly=True).copy())
                if target.quantity == "pressure":
                    quantities.append(pressures.named(run.problem, target.name, run.stepper.u))
                elif target.quantity != "energy":
                    quantities.append(value(run.problem, target, last, run.stepper.u))
                elif len(values) == 2:
                    change = run.problem.space.vector()
                    change.setArray(values[1] - values[0])
                    return run.error_estimate.norm(change)
    except TOLD:
        return float("nan")
    if target.quantity == "pressure":
        return pressures.apart(comm, *quantities)
    return quantities[1] - quantities[0]


class Answer(NamedTuple):
    """What a run with other settings has given.

    Attributes
    ----------
    number : int
        Load steps that it has taken.
    u : ndarray (n_owned d,)
        Displacement at its end [length].
    value : float or None
        Of the quantity, where there is one.
    pressure : list of pcontact.estimate.pressures.SourcePressure or None
        Where it is that of a contact.
    """

    number: int
    u: np.ndarray
    value: float | None
    pressure: list | None = None

    @classmethod
    def of(cls, run, record, target):
        """That of a simulation, and the record of its last load step. *Collective.*"""
        u = run.stepper.u
        own = None if target.quantity == "energy" else value(run.problem, target, record, u)
        pressure = pressures.named(run.problem, target.name, u) if target.quantity == "pressure" else None
        return cls(run.stepper.number, u.getArray(readonly=True).copy(), own, pressure)


def followed(taken, other, more):
    """What a change from one number of load steps to another says, of errors c n^-r, see `STEPS_RATE`.

    Parameters
    ----------
    taken, other : int
        Load steps; the change is u(taken) - u(other).
    more : float
        Of the run to come.

    Returns
    -------
    part : float
        Of the change, by which the solution changes from `taken` to `more` load steps.
    left : float
        Size of the change, times this: the error with `taken` load steps.
    """
    own, others, then = (number**-STEPS_RATE for number in (taken, other, more))
    return (own - then) / (others - own), own / abs(others - own)


def answer(simulation, other, target, known=None):
    """What a scene `other` gives on the same mesh, an :class:`Answer`; None where that is not known. *Collective.*"""
    try:
        with solved(other, simulation.comm, simulation.options.said, simulation.mesh, known) as (run, record):
            return None if record is None else Answer.of(run, record, target)
    except TOLD:
        # a setting that the scene does not take
        return None


def difference(simulation, other, target, watch):
    """What another setting changes in the solution. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run.
    other : pcontact.scene.model.Scene
        To be run on the same mesh.
    target : pcontact.scene.target.Target
        Of what the change counts.
    watch : pcontact.adapt.watch.Watch
        Of `simulation`.

    Returns
    -------
    float
        In the energy norm [sqrt(energy)], of the pressure in L2, or of another quantity, then with its sign: the value
        that the other setting has less that of the simulation; nan where it is not known.
    """
    return change_to(simulation, answer(simulation, other, target, watch.known), target, watch)


def change_to(simulation, other, target, watch):
    """How far an :class:`Answer`, or None, is from that of a simulation, as of :func:`difference`. *Collective.*"""
    if other is None:
        return float("nan")
    if target.quantity == "pressure":
        return _change_of_pressure(simulation, other, target.name)
    if target.quantity != "energy":
        return other.value - value(simulation.problem, target, watch.record, simulation.stepper.u)
    return simulation.error_estimate.norm(beyond(simulation, other.u))


def change_between(simulation, one, other, target):
    """How far an :class:`Answer` `other`, or None, is from `one`, both on the mesh of a simulation, as of
    :func:`difference`; not of pressures. *Collective.*"""
    if other is None:
        return float("nan")
    if target.quantity != "energy":
        return other.value - one.value
    change = simulation.problem.space.vector()
    change.setArray(other.u - one.u)
    return simulation.error_estimate.norm(change)


def beyond(simulation, values):
    """The displacement of a simulation less that of another run, values (n_owned d,): a PETSc.Vec."""
    change = simulation.stepper.u.copy()
    change.setArray(change.getArray(readonly=True) - values)
    return change


def _change_of_pressure(simulation, other, name):
    """How far the pressure of an :class:`Answer` is from that of a simulation on the same mesh. *Collective.*

    Where the points of the contact are others, the pressures are those that the contact of the simulation has with both
    displacements.
    """
    problem, u = simulation.problem, simulation.stepper.u
    own = pressures.named(problem, name, u)
    distance = pressures.apart(simulation.comm, own, other.pressure)
    if np.isfinite(distance):
        return distance
    moved = u.copy()
    moved.setArray(other.u)
    return pressures.apart(simulation.comm, own, pressures.named(problem, name, moved))
