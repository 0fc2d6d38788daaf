"""Errors that the mesh has no part in, measured by what the solution on the first mesh makes of other settings."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from pcontact.adapt.watch import Beginning
from pcontact.contact.surface.smooth_geometry import smooth_surface
from pcontact.estimate.goal import value
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD
from pcontact.runtime.observer import Observer
from pcontact.simulation import Simulation

# degrees that the quadrature of contact is raised by, where a finer one is tried
HIGHER = 4


@contextmanager
def solved(scene, comm, said, mesh, known=None, watch=None):
    """A run in memory whose lines are not shown, and the record of its last load step; None where it does not converge.
    It begins where the bodies are known to be, see :class:`pcontact.adapt.watch.Beginning`; ``watch(simulation)`` makes
    a further observer. *Collective.*
    """
    simulation = Simulation(scene, comm, said, mesh)
    if known is not None:
        simulation.begin = Beginning(simulation, *known)
    try:
        with log.quiet():
            last = Last()
            converged = simulation.run(None, [last] if watch is None else [last, watch(simulation)])
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
    """The scene whose contacts look for partners at the iterations of Newton's method, until they stay."""
    return replace(scene, petsc={**scene.petsc, "contact_search_every": "newton"})


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
                if target.quantity != "energy":
                    quantities.append(value(run.problem, target, last, run.stepper.u))
                elif len(values) == 2:
                    change = run.problem.space.vector()
                    change.setArray(values[1] - values[0])
                    return run.error_estimate.norm(change)
    except TOLD:
        return float("nan")
    return abs(quantities[1] - quantities[0])


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
        In the energy norm [sqrt(energy)], or of the quantity; nan where it is not known.
    """
    try:
        known = watch.times, watch.fields
        with solved(other, simulation.comm, simulation.options.said, simulation.mesh, known) as (run, last):
            if last is None:
                return float("nan")
            values = run.stepper.u.getArray(readonly=True).copy()
            if target.quantity != "energy":
                own = value(simulation.problem, target, watch.record, simulation.stepper.u)
                return abs(value(run.problem, target, last, run.stepper.u) - own)
    except TOLD:
        # a setting that the scene does not take
        return float("nan")
    change = simulation.stepper.u.copy()
    change.setArray(np.asarray(change.getArray(readonly=True)) - values)
    return simulation.error_estimate.norm(change)
