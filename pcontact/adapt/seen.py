"""What the change of the solution from one mesh to a finer one says of the estimate, where theory says nothing.

With u_1 on a mesh and u_2 on a finer one, the errors e_1 and e_2 have  e_1^2 = e_2^2 + |u_2 - u_1|^2  if the solutions
are projections. Of estimates that are the same part k of the error then

    k^2 = (estimate_1^2 - estimate_2^2) / |u_2 - u_1|^2

Where bodies yield without hardening, what one cell lacks makes cells far from it flow more, or less, and this part of
the error is in no residual of theirs.
"""

import numpy as np

from pcontact import build
from pcontact.adapt.variants import solved
from pcontact.adapt.watch import at_nodes
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime.errors import TOLD

# [-] Estimates over each other that count at most, and the part that counts at least. From: the difference of two that
# hardly differ says nothing.
ALIKE, LEAST = 0.8, 0.25


def part_of(coarse, fine, change):
    """The part of the error that estimates are, at most 1.

    Parameters
    ----------
    coarse, fine : float
        Estimates on both meshes [sqrt(energy)].
    change : float
        Energy norm of the difference of the displacements [sqrt(energy)].
    """
    if not (coarse > 0.0 and change > 0.0):
        return 1.0
    return float(np.clip(coarse * np.sqrt(1.0 - min(fine / coarse, ALIKE) ** 2) / change, LEAST, 1.0))


def between(simulation, before, coarse):
    """The part that the last two passes have seen. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        Of the finer mesh, that has run.
    before : ndarray (n_owned, d)
        Displacement on the coarser mesh [length].
    coarse : float
        The estimate there [sqrt(energy)].
    """
    change = simulation.stepper.u.copy()
    change.setArray(change.getArray(readonly=True) - before.ravel())
    return part_of(coarse, simulation.error_estimate.last["absolute"], simulation.error_estimate.norm(change))


def on_halved(simulation, scene, options):
    """The part that a run on the mesh with all cells halved sees; nan where it does not converge. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run.
    scene : pcontact.scene.model.Scene
        To be run.
    options : pcontact.runtime.options.Options
    """
    mesh, space = simulation.mesh, simulation.problem.space
    scene.output.estimate, scene.output.checkpoint, scene.mesh.order = True, False, space.degree
    cells = sum(len(block.nodes) for block in mesh.blocks)
    more, balance = np.full(cells, mesh.dim), Balance(*build.balance(scene, options))
    finer, fields = refine(mesh, more, [at_nodes(space, simulation.stepper.u)], balance)
    try:
        with solved(scene, simulation.comm, simulation.options.said, finer) as (run, last):
            if last is None:
                return float("nan")
            own = run.problem.space
            before = fields[0][own.mesh_nodes[own.owned_local]]
            return between(run, before, simulation.error_estimate.last["absolute"])
    except TOLD:
        return float("nan")
