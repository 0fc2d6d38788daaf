"""Parts of the cases of the verification manual: their form, runs that leave a picture, sums over contact points."""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers._common import contact_points, running
from drivers.studies._harness import Counts
from pcontact.runtime.errors import StepFailure
from pcontact.scene.model import Output

JOHNSON = "K. L. Johnson, *Contact Mechanics*, Cambridge University Press 1985"
TIMOSHENKO = "S. P. Timoshenko, J. N. Goodier, *Theory of Elasticity*, 3rd ed., McGraw-Hill 1970"
# name of the folder of a run in that of its mesh
RUN = "run"


class Case(NamedTuple):
    """A case of the manual.

    Attributes
    ----------
    title, data, sketch, source : str
        What its page says; ``source``: of the reference.
    quantity : str
        What is compared, with its unit.
    reference : float
    levels : tuple of int
        Of the meshes, the coarsest first.
    solve : callable
        From a folder of its own and a level to the value, StepFailure where a load step did not converge. What it
        writes to the folder ``RUN`` is what the picture shows. *Collective.*
    bounds : (float, float)
        Of the relative error on the coarsest and on the finest mesh.
    remark : str
    tiny : bool
        Whether a tiny run of all cases has it.
    look : dict
        Of its picture, see :func:`pcontact.view.picture.picture`.
    """

    title: str
    data: str
    sketch: str
    source: str
    quantity: str
    reference: float
    levels: tuple
    solve: Callable
    bounds: tuple
    remark: str = ""
    tiny: bool = True
    look: dict = {}  # noqa: RUF012


def need(converged):
    """Raise StepFailure where a load step did not converge."""
    if not converged:
        raise StepFailure("a load step did not converge")


@contextmanager
def solved(scene, folder):
    """Run a scene, whose fields go to a folder beside its mesh. *Collective.*

    Yields
    ------
    Simulation, dict
        The record of the last load step.

    Raises
    ------
    StepFailure
    """
    counts = Counts()
    scene = replace(scene, output=replace(scene.output or Output(), fields=True))
    with running(scene, Path(folder) / RUN, [counts]) as (simulation, converged):
        need(converged)
        yield simulation, counts.record


def record_of(scene, folder):
    """The record of the last load step of a run, see :func:`solved`. *Collective.*"""
    with solved(scene, folder) as (_, record):
        return record


def points_of(scene, folder):
    """Return the values of a run at the points of its first contact, on all ranks, see :func:`solved`. *Collective.*"""
    with solved(scene, folder) as (simulation, _):
        return simulation.comm.bcast(contact_points(simulation), root=0)


def share(points, inside, direction):
    """Part of the force of a contact that the points inside bear, and the force along a direction on the source."""
    force = points["traction"] @ np.asarray(direction, float) * points["weight"]
    return float(force[inside].sum() / force.sum()), float(force.sum())
