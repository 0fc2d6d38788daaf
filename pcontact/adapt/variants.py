"""Errors that the mesh has no part in, measured by what the solution on the first mesh makes of other settings."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from pcontact.runtime import log
from pcontact.runtime.errors import TOLD
from pcontact.simulation import Simulation

# degrees that the quadrature of contact is raised by, where a finer one is tried
HIGHER = 4


@contextmanager
def solved(scene, comm, said, mesh):
    """A run in memory whose lines are not shown; None where it does not converge. *Collective.*"""
    simulation = Simulation(scene, comm, said, mesh)
    try:
        with log.quiet():
            converged = simulation.run()
        yield simulation if converged else None
    finally:
        simulation.free()


def halved_steps(scene):
    """The scene with twice the load steps."""
    return replace(scene, steps=replace(scene.steps, count=2 * scene.steps.count))


def finer_quadrature(scene, degree):
    """The scene with more quadrature points on its contacts, for a displacement of a degree."""
    usual = 2 * degree + 5
    contacts = [replace(one, quadrature=(one.quadrature or usual) + HIGHER) for one in scene.contacts]
    return replace(scene, contacts=contacts)


def smooth_facets(scene):
    """The scene with the gaps of the smooth surfaces that straight facets stand for."""
    contacts = [one if one.tied else replace(one, smooth_geometry=True) for one in scene.contacts]
    return replace(scene, contacts=contacts)


def difference(simulation, other, comm, said):
    """Energy norm of what another setting changes in the solution, and the seconds it took. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run.
    other : pcontact.scene.model.Scene
        To be run on the same mesh.
    comm, said
        As for :class:`pcontact.simulation.Simulation`.

    Returns
    -------
    float
        [sqrt(energy)]; nan where it is not known.
    """
    try:
        with solved(other, comm, said, simulation.mesh) as run:
            if run is None:
                return float("nan")
            values = run.stepper.u.getArray(readonly=True).copy()
    except TOLD:
        # a setting that the scene does not take
        return float("nan")
    change = simulation.stepper.u.copy()
    change.setArray(np.asarray(change.getArray(readonly=True)) - values)
    return simulation.error_estimate.norm(change)
