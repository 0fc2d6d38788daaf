"""What a pass says of its errors, and which cells they come from."""

import time as clock

import numpy as np

from pcontact.adapt.beside import APART, Beside
from pcontact.adapt.corners import PressureError
from pcontact.adapt.fronts import front_of
from pcontact.adapt.known import effectivity, of_quantity
from pcontact.adapt.passes import Pass
from pcontact.adapt.seen import Seen
from pcontact.adapt.settings import FACETS, NOTICED, SHARE, STEPS_SHARE
from pcontact.adapt.trials import sign_of
from pcontact.adapt.variants import answer, beyond, change_to, followed
from pcontact.adapt.watch import at_nodes
from pcontact.element.reference import CELLS
from pcontact.runtime import log
from pcontact.runtime.petsc import MPI, PETSc

# [-] Of the displacements, or of the forces, that there are: a quantity below is zero but for rounding. From: chosen.
ZERO = 1e-9
# [-] Load steps over those of another run from which on their change tells an error. From: chosen; fewer tell little.
AGAIN = 1.5
# [-] Unknowns of a mesh where bodies yield over those of the last one that has told the error of load steps, up to
# which a mesh in the middle does not tell it again, and the last one does not where two meshes have told it. Where one
# has, the last one does so from `APART` on: a disc between a stamp and an anvil, 1.6 % of its rim's displacement with
# 1,114 unknowns and 2.5 % with 1,834. From: chosen.
NEAR, FAR = 2.0, 8.0


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
        # a run with other load steps on the mesh of a pass, and which pass
        self._other, self._other_of = None, None

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
        estimate, size, found, part = watch.absolute / norm, norm, None, 1.0
        beside = {"algebraic": watch.algebraic / norm}
        loads, forces = simulation.error_estimate.of_loads(watch.time, 0.5 * NOTICED * self._target.error * norm)
        beside["loads"] = loads / norm
        if self._target.quantity == "energy":
            far = estimate / known.least > self._target.error
            part = self._seen.part(simulation, watch, far, norm * self._of_other_steps())
            estimate /= part
        else:
            found = simulation.error_estimate.of_quantity(
                self._target, watch.record, simulation.stepper.u, watch.time, watch.unbalanced
            )
            known, size = of_quantity(self._target.quantity, mesh.dim), self._size(simulation, watch, found.value)
            error, likely = self._seen.error(simulation, found)
            found = found._replace(error=error)
            estimate = abs(found.error) / size
            watch.squares = self._indicators(simulation, watch, found)
            if self._target.quantity != "pressure":
                beside = {"algebraic": abs(found.algebraic) / size, "loads": abs(found.loads) / size}
        times = simulation.times()
        done = Pass(
            unknowns=space.n_dofs, cells=mesh.n_cells_total, degree=space.degree, estimate=estimate, known=known,
            parts={"mesh": estimate / known.least, **beside}, steps=self._settings.steps,
            seconds=seconds, solve=times["solve"], memory=times["peak_memory_mb"] * 2.0**20,
            entries=simulation.problem.matrix.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"],
            part=part,
        )  # fmt: skip
        self._add_loads(comm, watch, forces, done.parts)
        others, toward = self._beside.parts(simulation, done, size, watch)
        done.parts |= others
        self._add_facets(simulation, watch, done.parts)
        done.error = sum(done.parts.values())
        if self._hardly_knows_steps(simulation, done):
            self._of_half_steps(simulation, watch, done, None if found is None else found.value)
            done.parts["load_steps"] = self._beside.of_steps(done.steps)
            toward |= self._beside.toward({"load_steps": done.parts["load_steps"]})
            done.error = sum(done.parts.values())
        if found is not None:
            done.quantity = self._quantity(found, likely, sum(toward.values()) * size)
            found = found._replace(error=likely)
        done.expected = self._expected(done, found, toward, size)
        return done

    def _hardly_knows_steps(self, simulation, done):
        """Whether a coarser mesh has told the error of load steps, and it is much, or not small where bodies yield: on
        finer ones it is larger there. A disc between a stamp and an anvil: 1.3 % with 1,114 unknowns, 6.9 % with
        18,208. A lug on a loose pin has hardly any with twelve load steps, which three do not tell.

        Where bodies yield a mesh in the middle tells it for less than the last one would, and how it grows.
        """
        part, goal = done.parts.get("load_steps", 0.0), self._target.error
        if not self._passes:
            return False
        if done.error > goal and part > STEPS_SHARE * goal:
            # how many more the next pass takes hangs on it
            return True
        most = part * self._beside.may_have_grown(done.unknowns)
        if not simulation.scene.plastic or most <= SHARE * goal:
            return False
        near = NEAR if done.error > goal else FAR if self._beside.follows else APART
        return done.unknowns > near * self._beside.told_by()

    def _size(self, simulation, watch, value):
        """What errors of a quantity are divided by: its size, but not that of rounding errors where it is zero.
        *Collective.*"""
        if self._target.quantity == "pressure":
            return abs(value) or 1.0
        scale = simulation.stepper.u.norm(PETSc.NormType.NORM_INFINITY)
        if self._target.quantity != "displacement":
            # twice the strain energy over it: forces there are, if not their sum
            scale = watch.norm**2 / scale if scale > 0.0 else 0.0
        if abs(value) < ZERO * scale and not self._passes:
            log.warning("%s is zero but for rounding: its errors are named over %.3g", self._target.of, ZERO * scale)
        return max(abs(value), ZERO * scale) or 1.0

    def _expected(self, done, found, toward, size):
        """The error that a pass expects, relative: not the largest that there may be.

        What waves in the cells is at right angles to what facets change: squares of both norms add up. Changes of a
        number have signs, and cancel; squares of those whose signs are not known add up, and those of what is not known
        of the others.
        """
        parts = self._beside.once(done.parts)
        if found is None or self._target.quantity == "pressure":
            facets = [parts.get(name, 0.0) for name in FACETS]
            rest = sum(value for name, value in parts.items() if name not in ("mesh", *FACETS))
            return float(np.hypot(done.estimate, sum(facets))) + rest
        told = {"mesh", "algebraic", "loads", *toward}
        own = (found.error + found.loads + found.algebraic) / size + sum(toward.values())
        others = [value for name, value in parts.items() if name not in told]
        return float(np.linalg.norm([own, self._beside.unsure(parts), *others]))

    def _of_other_steps(self):
        """Errors of the load steps of this pass and the last one together, relative; 0 where these are the same."""
        if not self._passes or self._passes[-1].steps == self._settings.steps:
            return 0.0
        return float(np.hypot(*map(self._beside.of_steps, (self._passes[-1].steps, self._settings.steps))))

    def with_steps(self, simulation, watch, done):
        """Measure what load steps change on the mesh of a pass where the next one has more of them: a finer mesh than
        the first one tells it better. The next mesh is compared with this one as it would be with its load steps.
        *Collective.*

        Parameters
        ----------
        simulation : pcontact.simulation.Simulation
            Of the pass.
        watch : pcontact.adapt.watch.Watch
            Its `last` is set.
        done : pcontact.adapt.passes.Pass
        """
        if self._settings.steps == done.steps:
            return
        if len(self._passes) == 1:
            self._other = self._beside.other
        elif self._other_of is not done:
            own = None if done.quantity is None else done.quantity["value"]
            self._of_half_steps(simulation, watch, done, own)
        other, taken = self._other, simulation.stepper.number
        if other is None or other.number == taken:
            return
        part, _ = followed(taken, other.number, taken * self._settings.steps / done.steps)
        if self._target.quantity != "energy":
            own = done.quantity["value"]
            self._seen.with_steps(own + part * (own - other.value))
        moved = simulation.stepper.u.copy()
        moved.axpy(part, beyond(simulation, other.u))
        watch.last = at_nodes(simulation.problem.space, moved)

    def _of_half_steps(self, simulation, watch, done, own):
        """Run the mesh of a pass with half of its load steps: the change tells their error. *Collective.*

        It is followed by the power with which the error falls, see `pcontact.adapt.beside`.

        Parameters
        ----------
        simulation, watch, done
            As for :meth:`with_steps`.
        own : float or None
            Value of the quantity, if one is named.
        """
        begun, taken = clock.perf_counter(), simulation.stepper.number
        self._other, self._other_of = self._with_others(simulation, watch, done), done
        if self._other is None or self._other.number == taken:
            return
        _, times = followed(taken, self._other.number, taken)
        change = change_to(simulation, self._other, self._target, watch)
        size = watch.norm if self._target.quantity == "energy" else self._size(simulation, watch, own)
        # more load steps change a number as fewer of them do, the other way round
        sign = sign_of(change * (self._other.number - taken), self._target)
        self._beside.with_steps(times * abs(change) / size, done, sign)
        done.trials += clock.perf_counter() - begun

    def _with_others(self, simulation, watch, done):
        """A run of the mesh of a pass with half of its load steps; with twice as many where corners of amplitudes leave
        no fewer. None where it does not converge. *Collective.*"""
        simulation.close()
        scene, taken = self._settings.scene(), simulation.stepper.number
        scene.output.estimate = scene.output.checkpoint = False
        for count in (self._settings.halved(done.steps), 2 * done.steps):
            scene.steps.count = count
            other = answer(simulation, scene, self._target, watch.known)
            if other is None or max(other.number, taken) >= AGAIN * min(other.number, taken):
                return other
        return None

    def _indicators(self, simulation, watch, found):
        """What cells have in the error of a quantity, where that is what the mesh is refined for. *Collective.*"""
        own = np.concatenate([np.zeros(0), *found.cells])
        if self._seen.by_meshes:
            # as the quantity is said to follow the squares of the energy norm
            return watch.squares
        if self._target.quantity != "pressure":
            return np.abs(own)
        # the pressure is that of cells on the contact, and depends on the stress of all others: as much as they have in
        # the energy norm, but no more than the contact itself
        (contact,) = (one for one in simulation.problem.contacts if one.name == self._target.name)
        groups = [name for pair in contact.pairs for name in (pair.contact.source, pair.contact.target)]
        pressure, others = own / (found.value**2 or 1.0), watch.squares / (watch.norm**2 or 1.0)
        watch.energies = watch.squares
        sums = simulation.comm.allreduce(np.array([pressure.sum(), others.sum()]), op=MPI.SUM)
        squares = pressure + min(sums[0] / (sums[1] or 1.0), 1.0) * others
        if simulation.problem.space.dim == 2:
            watch.pressure = PressureError.of(simulation.problem.space, pressure, groups)
        else:
            watch.pressure = front_of(simulation.problem.space, contact, simulation.stepper.u, squares)
        return squares

    def _add_loads(self, comm, watch, forces, parts):
        """Let the indicators have cells whose loads are integrated badly, by their share. *Collective.*"""
        if parts["loads"] <= SHARE * self._target.error:
            return
        own = np.concatenate([np.zeros(0), *forces])
        sums = comm.allreduce(np.array([own.sum(), watch.squares.sum()]), op=MPI.SUM)
        ratio = (parts["loads"] / parts["mesh"]) ** 2 if parts["mesh"] > 0.0 else 1.0
        watch.squares = watch.squares + ratio * (sums[1] or 1.0) / (sums[0] or 1.0) * own

    def _add_facets(self, simulation, watch, parts):
        """Let the indicators have cells whose facets come nearer to the geometry when they are cut, by their share:
        what a facet is off is of the degree of the cells, and so falls as their squares do. *Collective.*"""
        large = sum(parts.get(name, 0.0) for name in FACETS)
        if self._settings.staying or large <= SHARE * self._target.error:
            return
        mesh, own = simulation.mesh, np.zeros(len(watch.squares))
        first = np.cumsum([0] + [len(block.nodes) for block in mesh.blocks])
        contacts = [one for one in simulation.scene.contacts if not one.tied]
        for name in sorted({name for one in contacts for name in (one.source, one.target)} & set(mesh.facet_groups)):
            for some in mesh.facet_groups[name]:
                x = mesh.points[mesh.facet_nodes(some)[:, : CELLS[some.kind].n_vertices]]
                size = np.linalg.norm(x - x[:, :1], axis=2).max(axis=1)
                np.add.at(own, first[some.block] + some.cells, size ** ((4.0 if mesh.curved else 2.0) + mesh.dim))
        sums = simulation.comm.allreduce(np.array([own.sum(), watch.squares.sum()]), op=MPI.SUM)
        ratio = (large / parts["mesh"]) ** 2 if parts["mesh"] > 0.0 else 1.0
        watch.squares = watch.squares + ratio * (sums[1] or 1.0) / (sums[0] or 1.0) * own

    def _quantity(self, found, likely, toward):
        """Value of a quantity, and what it is extrapolated to, with an uncertainty. `likely`: the error of the mesh as
        it is expected, `toward`: what settings beside the mesh change, with signs."""
        if self._target.quantity == "pressure":
            return {"value": found.value, "error": found.error}
        best = found.value + likely + found.loads + found.algebraic + toward
        # what is left of the estimate's own error; and, once there are two, by how much such values differ
        others = [abs(one.quantity["extrapolated"] - best) for one in self._passes[-1:]]
        unsure = max([0.5 * (abs(found.error) + abs(toward)), *others])
        return {"value": found.value, "error": found.error, "extrapolated": best, "uncertainty": unsure}
