"""What a pass says of its errors, and which cells they come from."""

import numpy as np

from pcontact.adapt.beside import Beside
from pcontact.adapt.known import effectivity, of_quantity
from pcontact.adapt.passes import Pass
from pcontact.adapt.seen import Seen
from pcontact.adapt.settings import SHARE
from pcontact.element.reference import CELLS
from pcontact.runtime.petsc import MPI, PETSc


class Measure:
    """Measures the errors of passes.

    Parameters
    ----------
    target : pcontact.scene.target.Target
    settings : pcontact.adapt.settings.Settings
    passes : list of pcontact.adapt.passes.Pass
        Those before.
    options : pcontact.runtime.options.Options
    """

    def __init__(self, target, settings, passes, options):
        self._target, self._settings, self._passes = target, settings, passes
        self._beside, self._seen = Beside(target, settings), Seen(target, settings, options)

    def __call__(self, simulation, watch, seconds):
        """What a pass has shown. *Collective.*

        Parameters
        ----------
        simulation : pcontact.simulation.Simulation
            That has run.
        watch : pcontact.adapt.watch.Watch
            Its squares become those of the error that is named.
        seconds : float
            That it has taken.

        Returns
        -------
        pcontact.adapt.passes.Pass
        """
        space, mesh, comm = simulation.problem.space, simulation.mesh, simulation.comm
        kinds = {block.cell for block in mesh.blocks if len(block.nodes)}
        simplices = any(not CELLS[kind].is_tensor for some in comm.allgather(kinds) for kind in some)
        known = effectivity(simulation.scene, simplices, mesh.dim, space.degree)
        norm = watch.norm if watch.norm > 0.0 else 1.0
        estimate, size, found = watch.absolute / norm, norm, None
        beside = {"algebraic": watch.algebraic / norm}
        loads, forces = simulation.error_estimate.of_loads(watch.time)
        beside["loads"] = loads / norm
        if self._target.quantity == "energy":
            estimate /= self._seen.part(simulation, watch)
        else:
            found = simulation.error_estimate.of_quantity(
                self._target, watch.record, simulation.stepper.u, watch.time, watch.unbalanced
            )
            known, size = of_quantity(self._target.quantity, mesh.dim), abs(found.value) or 1.0
            estimate = self._seen.error(simulation, found) / size
            watch.squares = self._indicators(comm, watch.squares, found)
            if self._target.quantity != "pressure":
                beside = {"algebraic": abs(found.algebraic) / size, "loads": abs(found.loads) / size}
        times = simulation.times()
        done = Pass(
            unknowns=space.n_dofs, cells=mesh.n_cells_total, degree=space.degree, estimate=estimate, known=known,
            parts={"mesh": estimate / known.least, **beside}, steps=self._settings.steps,
            seconds=seconds, solve=times["solve"], memory=times["peak_memory_mb"] * 2.0**20,
            entries=simulation.problem.matrix.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"],
            quantity=None if found is None else self._quantity(found),
        )  # fmt: skip
        self._add_loads(comm, watch, forces, done.parts)
        done.parts |= self._beside.parts(simulation, done, size, watch)
        done.error = sum(done.parts.values())
        return done

    def _indicators(self, comm, squares, found):
        """What cells have in the error of a quantity, where that is what the mesh is refined for. *Collective.*"""
        own = np.concatenate([np.zeros(0), *found.cells])
        if self._target.quantity != "pressure":
            return np.abs(own)
        # the pressure is that of cells on the contact, and depends on the stress of all others
        sums = comm.allreduce(np.array([own.sum(), squares.sum()]), op=MPI.SUM)
        return own / (sums[0] or 1.0) + squares / (sums[1] or 1.0)

    def _add_loads(self, comm, watch, forces, parts):
        """Let the indicators have cells whose loads are integrated badly, by their share. *Collective.*"""
        if parts["loads"] <= SHARE * self._target.error:
            return
        own = np.concatenate([np.zeros(0), *forces])
        sums = comm.allreduce(np.array([own.sum(), watch.squares.sum()]), op=MPI.SUM)
        ratio = (parts["loads"] / parts["mesh"]) ** 2 if parts["mesh"] > 0.0 else 1.0
        watch.squares = watch.squares + ratio * (sums[1] or 1.0) / (sums[0] or 1.0) * own

    def _quantity(self, found):
        """Value of a quantity, and what it is extrapolated to, with an uncertainty."""
        if self._target.quantity == "pressure":
            return {"value": found.value, "error": found.error}
        best = found.value + found.error + found.loads + found.algebraic
        # what is left of the estimate's own error; and, once there are two, by how much such values differ
        others = [abs(one.quantity["extrapolated"] - best) for one in self._passes[-1:]]
        unsure = max([0.5 * abs(found.error), *others])
        return {"value": found.value, "error": found.error, "extrapolated": best, "uncertainty": unsure}
