"""Runs on one mesh after the other, until the error is below the target or the budget is spent."""

import gc
import shutil
import time as clock
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcontact import build
from pcontact.adapt import seen, variants
from pcontact.adapt.budget import Budgeted
from pcontact.adapt.corners import Corners
from pcontact.adapt.degree import Degree, Tried
from pcontact.adapt.forecast import forecast
from pcontact.adapt.known import effectivity, of_quantity
from pcontact.adapt.passes import NAMES, Pass, cost_of, report, said_of, table
from pcontact.adapt.sizes import Contributions, Cuts, next_cuts
from pcontact.adapt.watch import Beginning, Watch
from pcontact.element.reference import CELLS
from pcontact.estimate.goal import value
from pcontact.mesh.refinement.refine import SIMPLICES, Balance, refine
from pcontact.mesh.refinement.regular import HALVED
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD
from pcontact.runtime.lock import reserved
from pcontact.runtime.messages import input_error
from pcontact.runtime.options import Options
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.keys import options as key_options
from pcontact.scene.model import MeshSpec
from pcontact.simulation import Simulation
from pcontact.view import extra
from pcontact.view.show import draw_errors

REACHED, FAILED, SPENT = 0, 1, 4
# [-] Part of the target that the next mesh is made for. From: a mesh that just misses it costs another pass.
AIM = 0.85
# [-] Part of the target that errors of one kind, other than the mesh's, may have. From: chosen.
SHARE = 0.1
# [passes] At most; and those after which a mesh must have brought something. From: each pass at least doubles the cells
# or is the last one.
MOST, PATIENCE = 14, 3
# [-] Unknowns that the target would take over those of now, with which it is out of reach. From: chosen, more than two
# more passes.
FARTHEST = 1e4
# [-] Part by which the error must have fallen where the cells have grown by the other. From: chosen.
FALLEN, GROWN = 0.97, 1.3
# [-] Tolerances of Newton's method: that of the first pass over the target, and the range. From: the first is checked
# against the algebraic error of every pass.
FIRST_RTOL, LEAST_RTOL, MOST_RTOL = 0.01, 1e-9, 1e-4
# [-] Power of the error with which meshes have brought it down, in that of smooth solutions: of the second mesh, before
# it is known (Hertz's cylinder and ball, receding contact: 0.81 to 0.85), and at least.
FIRST_TRUST, LEAST_TRUST = 0.83, 0.4
# [load steps] Times as many at once at most. From: chosen.
MORE_STEPS = 4
# Parts of the error that a finer mesh takes away as it does its own, and those that it leaves.
FALLING, STAYING = ("mesh", "quadrature", "loads", "frozen_partners"), ("straight_facets", "curved_facets")
# [passes] Before a forecast; the second one is left out where it would have more unknowns than that. From: one pass
# does not tell which of its seconds more unknowns take.
TRIED, SMALL = 2, 50_000


class Step(NamedTuple):
    """How to cut the cells of a mesh.

    Attributes
    ----------
    cuts : pcontact.adapt.sizes.Cuts
    rise : pcontact.mesh.refinement.refine.Rise or None
    around : sequence of ndarray (n_nodes, 3)
        What the next mesh has to know of this one, see :class:`pcontact.adapt.corners.Corners`.
    """

    cuts: Cuts
    rise: object
    around: tuple


class Outcome(NamedTuple):
    """What came of a loop.

    Attributes
    ----------
    status : int
        `REACHED`, `FAILED` or `SPENT`.
    kept : object
        What the caller took of the best pass.
    failure : StepFailure or None
        Of the pass that did not converge.
    """

    status: int
    kept: object
    failure: object


class Loop:
    """Reaches the error that a scene names.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        Of :func:`pcontact.adapt.target.wanted`.
    comm : MPI.Comm
    said : str
        Where the user gives options, for messages.
    take : callable
        ``take(simulation, converged)``: what the caller keeps of a pass that has run.
    observers : callable
        ``observers(simulation)``: further observers of a pass.

    Attributes
    ----------
    passes : list of pcontact.adapt.passes.Pass
    mesh : pcontact.mesh.mesh.Mesh
        Of the last one.

    Raises
    ------
    InputError
        On every rank.
    """

    def __init__(self, scene, comm=MPI.COMM_WORLD, said="command line", take=lambda *_: None, observers=lambda _: ()):
        self.scene, self.comm, self.said, self.target = scene, comm, said, scene.accuracy
        self._take, self._observers, self._options = take, observers, Options(said)
        self._start, self._budget = clock.perf_counter(), Budgeted(self.target.budget, comm)
        self._rtol = float(np.clip(FIRST_RTOL * self.target.error, LEAST_RTOL, MOST_RTOL))
        self._steps, self._others, self._why, self._searches = scene.steps.count, None, "", False
        # None where cells are halved, all alike
        self._corners = None
        self._degree = Degree(self._options.get(key_options(MeshSpec)["order"], scene.mesh.order))
        # estimate and degree of the last pass, and what part of the error estimates have been seen to be
        self._before, self._seen = None, 1.0
        self._looks_ahead, self.ahead = False, None
        self.passes, self.kept, self.mesh = [], None, None

    def last_scene(self):
        """The scene of the last pass, as it would be run alone."""
        scene = self._scene()
        scene.steps.count, scene.mesh.order = self.passes[-1].steps, self.passes[-1].degree
        return scene

    # -- one pass -------------------------------------------------------------------------------------------------

    def _scene(self):
        """The scene of the next pass."""
        scene = self.scene.copy()
        scene.accuracy = None
        scene.output.estimate, scene.steps.count, scene.mesh.order = True, self._steps, self._degree.now
        # looser partners and tolerances than the mesh deserves are no place to save
        ours = {"snes_rtol": f"{self._rtol:.3g}", "contact_search_again": "4"}
        if self._searches:
            ours["contact_search_every"] = "newton"
        scene.petsc = {**ours, **scene.petsc}
        return scene

    def _run(self, scene, mesh, known, directory):
        """Run a scene on a mesh (None: on that of the file). *Collective.*

        Returns
        -------
        simulation : Simulation
        watch : Watch
        converged : bool
        """
        simulation = Simulation(scene, self.comm, self.said, mesh)
        if mesh is None:
            self._look_at_cells(simulation)
        watch = Watch(simulation)
        if known is not None:
            simulation.begin = Beginning(simulation, *known)
        where = None if directory is None else directory / f"pass_{len(self.passes) + 1}"
        observers = [watch, *self._observers(simulation)]
        try:
            converged = simulation.run(where, observers, keep=True, said=self._where)
        except TOLD:
            simulation.free()
            raise
        except BaseException:
            # what one rank alone meets is no reason for it to wait for the others
            simulation.close()
            raise
        return simulation, watch, converged

    def _look_at_cells(self, simulation):
        """Refuse cells that cannot be cut, say so where all are. *Collective.*"""
        own = {block.cell for block in simulation.mesh.blocks if len(block.nodes)}
        kinds = set().union(*self.comm.allgather(own))
        if kinds <= set(SIMPLICES):
            self._corners = Corners(self.comm)
        elif kinds <= set(HALVED):
            log.info("%s: passes cut all of them, in %d parts each; triangles and tetrahedra are cut where it pays",
                     ", ".join(f"{kind}s" for kind in sorted(kinds)), 2**simulation.mesh.dim)  # fmt: skip
        else:
            simulation.free()
            found = f"{', '.join(sorted(kinds))} cells together with accuracy.error"
            allowed = f"triangles, tetrahedra; or {', '.join(f'{kind}s' for kind in HALVED[1:])} (and triangles)"
            raise input_error(self.scene.where, "mesh.file", found, allowed)

    def run(self, directory=None, said="command line: -o"):
        """All passes. *Collective.*

        Parameters
        ----------
        directory : str or pathlib.Path, optional
            Where the results of the best pass go.
        said : str
            Where the user names it, for messages.

        Returns
        -------
        Outcome
        """
        directory, self._where = None if directory is None else Path(directory), said
        if self.target.pictures:
            on_root(self.comm, extra.require)
        # objects that are there before the first pass outlive it: collections between passes need not look at them
        gc.collect()
        gc.freeze()
        try:
            return self._run_all(directory, said)
        finally:
            gc.unfreeze()

    def _run_all(self, directory, said):
        with reserved(directory, self.comm, said):
            status, best, failure = self._passes(directory)
            if directory is not None:
                on_root(self.comm, _tidy, directory, best, len(self.passes) + 1)
                if self.target.pictures and self.passes:
                    on_root(self.comm, draw_errors, directory)
        return Outcome(status, self.kept, failure)

    def forecast(self):
        """What the target would take, from the first one or two passes. *Collective.*

        Returns
        -------
        Outcome
            Its `kept` is that of the last pass; :attr:`ahead` is the forecast, None where these passes were enough or
            did not end.
        """
        self._looks_ahead, self._where = True, ""
        status, _, failure = self._passes(None)
        return Outcome(status, self.kept, failure)

    def _passes(self, directory):
        mesh = known = None
        while True:
            scene, begun = self._scene(), clock.perf_counter()
            simulation, watch, converged = self._run(scene, mesh, known, directory)
            if not converged and (self.passes or not simulation.stopped):
                failure = simulation.failure
                if not self.passes:
                    self.kept = self._take(simulation, converged)
                simulation.free()
                return FAILED, max(len(self.passes), 1), failure
            if not converged:
                self.kept = self._take(simulation, converged)
                simulation.free()
                return REACHED, 1, None
            self.mesh = simulation.mesh
            done = self._measured(simulation, watch, clock.perf_counter() - begun)
            self.passes.append(done)
            status, step = self._next(simulation, watch, done)
            if status is None and self._looks_ahead:
                status = self._look_ahead(watch, done, step)
            if status is None:
                mesh, known, status = self._onward(simulation, watch, done, step)
            done.seconds = clock.perf_counter() - begun
            for line in table(self.passes, self.target, self._why if status is not None else ""):
                log.info("%s", line)
            if not self._looks_ahead:
                self._tell(simulation, status)
            self.kept = self._take(simulation, converged)
            simulation.free()
            if status is not None:
                return status, len(self.passes), None

    def _onward(self, simulation, watch, done, step):
        """The next mesh, what is known on it, and None or the exit status where it is too large. *Collective.*"""
        last = Tried(simulation.mesh, watch, done, step)
        if self._degree.is_open(last.mesh.curved):
            self._degree.try_higher(last)
            done.next = {"unknowns": None, "mesh": None, "load_steps": self._steps, "degree": 2}
            return last.mesh, (watch.times, watch.fields), None
        begun = self._degree.choose(last, self.target.error)
        mesh, watch = begun.mesh, begun.watch
        done.next = self._expected(begun.done, begun.step.cuts)
        balance = Balance(*build.balance(simulation.scene, self._options))
        finer, fields = self._cut(mesh, begun.step, watch.fields, balance)
        status = self._fits(begun.done.unknowns * finer.n_nodes_total / mesh.n_nodes_total)
        return finer, (watch.times, fields), status

    def _expected(self, done, found):
        """What is expected of the next pass."""
        return {"unknowns": found.growth * done.unknowns, "mesh": found.part**done.power * done.parts["mesh"],
                "load_steps": self._steps, "degree": done.degree}  # fmt: skip

    def _cut(self, mesh, step, fields, balance):
        """The next mesh and fields on it. *Collective.*"""
        if self._corners is None:
            for _ in range(round(np.log2(step.cuts.growth) / mesh.dim)):
                n = sum(len(block.nodes) for block in mesh.blocks)
                mesh, fields = refine(mesh, np.ones(n, dtype=np.int64), fields, balance)
            return mesh, fields
        finer, fields = refine(mesh, step.cuts.more, [*fields, *step.around], balance, step.rise)
        self._corners.take(fields[len(fields) - len(step.around) :])
        return finer, fields[: len(fields) - len(step.around)]

    def _look_ahead(self, watch, done, step):
        """`SPENT` and a forecast where it has enough passes to stand on. *Collective.*"""
        growing = [one for one in self.passes if one.degree == done.degree]
        more = len(growing) < TRIED and step.cuts.growth * done.unknowns < SMALL
        if self._degree.is_open(self.mesh.curved) or more:
            return None
        self.ahead = forecast(self.comm, growing, watch.squares, self._wanted(done), self._corners is None)
        return SPENT

    def _measured(self, simulation, watch, seconds):
        """What a pass says of its errors. *Collective.*"""
        space, mesh = simulation.problem.space, simulation.mesh
        kinds = {block.cell for block in mesh.blocks if len(block.nodes)}
        simplices = any(not CELLS[kind].is_tensor for some in self.comm.allgather(kinds) for kind in some)
        known = effectivity(simulation.scene, simplices, mesh.dim, space.degree)
        norm = watch.norm if watch.norm > 0.0 else 1.0
        estimate, size, found = watch.absolute / norm, norm, None
        beside = {"algebraic": watch.algebraic / norm}
        loads, forces = simulation.error_estimate.of_loads(watch.time)
        beside["loads"] = loads / norm
        if self.target.quantity == "energy":
            estimate /= self._part_seen(simulation, watch)
        else:
            found = simulation.error_estimate.of_quantity(
                self.target, watch.record, simulation.stepper.u, watch.time, watch.unbalanced
            )
            known, size = of_quantity(self.target.quantity, mesh.dim), abs(found.value) or 1.0
            estimate = self._error_seen(simulation, found) / size
            watch.squares = self._indicators(watch.squares, found)
            if self.target.quantity != "pressure":
                beside = {"algebraic": abs(found.algebraic) / size, "loads": abs(found.loads) / size}
        times = simulation.times()
        done = Pass(
            unknowns=space.n_dofs, cells=mesh.n_cells_total, degree=space.degree, estimate=estimate, known=known,
            parts={"mesh": estimate / known.least, **beside}, steps=self._steps,
            seconds=seconds, solve=times["solve"], memory=times["peak_memory_mb"] * 2.0**20,
            entries=simulation.problem.matrix.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"],
            quantity=None if found is None else _quantity(found, self.target, self.passes),
        )  # fmt: skip
        self._add_loads(watch, forces, done.parts)
        done.parts |= self._beside_the_mesh(simulation, done, size, watch)
        done.error = sum(done.parts.values())
        return done

    def _part_seen(self, simulation, watch):
        """What part of the error the estimate is, as the last meshes show it, where bodies yield. *Collective.*"""
        own, degree = simulation.error_estimate.last["absolute"], simulation.problem.space.degree
        if not _yields(simulation.scene):
            return 1.0
        old, self._before, part = self._before, (own, degree), float("nan")
        if old is None or old[1] != degree:
            part = self._on_halved(simulation, lambda run, _, before: seen.between(run, before, own))
        elif simulation.begin.at(watch.time) is not None:
            part = seen.between(simulation, simulation.begin.at(watch.time), old[0])
        # a mesh that has changed the solution little says little
        self._seen = min(self._seen, part) if np.isfinite(part) else self._seen
        return self._seen

    def _error_seen(self, simulation, found):
        """The error of a quantity, where bodies yield as the last meshes show it. *Collective.*"""
        error, degree = abs(found.error), simulation.problem.space.degree
        if not _yields(simulation.scene) or self.target.quantity == "pressure":
            return error
        old = self._before
        if old is None or old[1] != degree:
            best = self._on_halved(simulation, lambda run, record, _: value(run.problem, self.target, record,
                                                                            run.stepper.u))  # fmt: skip
            left = max(error, seen.FARTHER * abs(best - found.value)) if np.isfinite(best) else error
            self._seen = max(error / left, seen.LEAST) if left > 0.0 else 1.0
        else:
            left = seen.left_of(error / self._seen, old[0], abs(found.value - old[2]))
        self._before = left, degree, found.value
        return left

    def _on_halved(self, simulation, found):
        """See :func:`pcontact.adapt.seen.on_halved`. *Collective.*"""
        simulation.close()
        result = seen.on_halved(simulation, self._scene(), self._options, found)
        if not np.isfinite(result):
            log.warning("not known: what part of the error the estimate is where bodies yield")
        return result

    def _indicators(self, squares, found):
        """What cells have in the error of a quantity, where that is what the mesh is refined for. *Collective.*"""
        own = np.concatenate([np.zeros(0), *found.cells])
        if self.target.quantity != "pressure":
            return np.abs(own)
        # the pressure is that of cells on the contact, and depends on the stress of all others
        sums = self.comm.allreduce(np.array([own.sum(), squares.sum()]), op=MPI.SUM)
        return own / (sums[0] or 1.0) + squares / (sums[1] or 1.0)

    def _add_loads(self, watch, forces, parts):
        """Let the indicators have cells whose loads are integrated badly, by their share. *Collective.*"""
        if parts["loads"] <= SHARE * self.target.error:
            return
        own = np.concatenate([np.zeros(0), *forces])
        sums = self.comm.allreduce(np.array([own.sum(), watch.squares.sum()]), op=MPI.SUM)
        ratio = (parts["loads"] / parts["mesh"]) ** 2 if parts["mesh"] > 0.0 else 1.0
        watch.squares = watch.squares + ratio * (sums[1] or 1.0) / (sums[0] or 1.0) * own

    def _beside_the_mesh(self, simulation, done, norm, watch):
        """Errors that the mesh has no part in, measured on the first mesh. *Collective.*"""
        if self._others is None:
            begun = clock.perf_counter()
            self._others = self._measure_others(simulation, norm, watch)
            self._others |= {"of": done.parts["mesh"], "steps": self._steps}
            done.trials = clock.perf_counter() - begun
        found, parts = self._others, {}
        finer = min(done.parts["mesh"] / found["of"], 1.0) if found["of"] > 0.0 else 1.0
        for name in (name for name in found if name in NAMES):
            # what a finer rule changes falls as fast as what a finer mesh does, what straight facets do stays
            fallen = found["steps"] / self._steps if name == "load_steps" else finer if name in FALLING else 1.0
            parts[name] = fallen * found[name]
        if self._searches:
            parts["frozen_partners"] = 0.0
        return parts

    def _measure_others(self, simulation, norm, watch):
        if simulation.problem.linear:
            return {}
        simulation.close()
        scene, tried = self._scene(), {}
        scene.output.estimate = scene.output.checkpoint = False
        if _remembers(simulation.scene):
            tried["load_steps"] = variants.halved_steps(scene)
        if any(not contact.tied for contact in scene.contacts):
            tried["frozen_partners"] = variants.searching(scene)
            tried["quadrature"] = variants.finer_quadrature(scene, simulation.problem.space.degree)
            if variants.bent(simulation):
                name = "curved_facets" if simulation.mesh.curved else "straight_facets"
                tried[name] = variants.smooth_facets(scene)
        found = {"load_steps": 0.0}
        for name, other in tried.items():
            if name in STAYING and simulation.problem.space.degree == 1:
                value = variants.of_facets(simulation, scene, self.target) / norm
            else:
                value = variants.difference(simulation, other, self.target, watch) / norm
            # with half the steps to go, the other half of a first-order error is left
            found[name] = 2.0 * value if name == "load_steps" else value
            if not np.isfinite(value):
                log.warning("not known: how much of the error is that of %s", said_of(name))
                found[name] = 0.0
        return found

    # -- the next one ---------------------------------------------------------------------------------------------

    def _next(self, simulation, watch, done):
        """Exit status and None, or None and how to cut the cells of the mesh. *Collective.*"""
        goal = self.target.error
        if done.error <= goal:
            self._why = "reached"
            return REACHED, None
        if len(self.passes) >= MOST or self._stalls():
            largest = max(done.parts, key=done.parts.get)
            self._why = f"not reached: finer meshes do not bring it down, the largest part is {said_of(largest)}"
            return SPENT, None
        far = cost_of(self.passes, goal)["unknowns"]
        if self._alike() > PATIENCE and far > FARTHEST * done.unknowns:
            self._why = f"not reached: at the rate seen it would take {far:.2g} unknowns"
            return SPENT, None
        self._balance(done)
        stays = sum(done.parts.get(name, 0.0) for name in STAYING)
        if stays >= goal:
            largest = max((name for name in STAYING), key=lambda name: done.parts.get(name, 0.0))
            self._why = f"not reached: {said_of(largest)} alone make {100.0 * stays:.2g} %, which no mesh takes away"
            return SPENT, None
        most = self._budget.growth(done, clock.perf_counter() - self._start)
        if most < GROWN:
            self._why = f"not reached: the budget is spent ({self._budget.by})"
            return SPENT, None
        step = self._step(simulation, watch, done, most)
        if step.cuts.growth <= 1.0:
            self._why = f"not reached: the budget is spent ({self._budget.by})"
            return SPENT, None
        done.next = self._expected(done, step.cuts)
        return None, step

    def _step(self, simulation, watch, done, most):
        """How to cut the cells. *Collective.*"""
        space, rise, around, power = simulation.problem.space, None, (), None
        if self._corners is not None:
            power, rise, around = self._corners.look(space, watch.squares)
        errors = Contributions(watch.squares, done.degree, space.dim, power=power, whole=self._corners is None)
        return Step(next_cuts(self.comm, errors, self._wanted(done), most, self._alike() > 1), rise, around)

    def _wanted(self, done):
        """The part of the error in the energy norm that the next mesh is made for."""
        goal, share = self.target.error, SHARE * self.target.error
        stays = sum(done.parts.get(name, 0.0) for name in STAYING)
        stays += sum(min(done.parts.get(name, 0.0), share) for name in ("algebraic", "load_steps"))
        falls = sum(done.parts.get(name, 0.0) for name in FALLING)
        part = min(AIM * max(goal - stays, share) / falls, 1.0) ** (1.0 / self._trust(done))
        # errors of quantities are products of two errors of the energy norm
        return part ** (1.0 / done.power)

    def _trust(self, done):
        """The power of the error in the one that was expected of the last mesh: below 1 where solutions are singular,
        unless that is known by now."""
        old = self.passes[-2] if len(self.passes) > 1 else None
        if old is None or old.degree != done.degree or old.next is None or old.next["degree"] != done.degree:
            return FIRST_TRUST
        expected, seen = old.next["mesh"] / old.parts["mesh"], done.parts["mesh"] / old.parts["mesh"]
        if self._corners is not None and self._corners.explain:
            return FIRST_TRUST
        if not 0.0 < expected < 1.0:
            return 1.0
        return float(np.clip(np.log(seen) / np.log(expected), LEAST_TRUST, 1.0))

    def _balance(self, done):
        """Spend on load steps, searches and tolerances where they are large beside what is wanted."""
        share = SHARE * self.target.error
        self._searches = self._searches or done.parts.get("frozen_partners", 0.0) > share
        steps = done.parts.get("load_steps", 0.0)
        if steps > share:
            self._steps = int(np.ceil(self._steps * min(steps / share, MORE_STEPS)))
        if done.parts["algebraic"] > 0.1 * min(done.parts["mesh"], self.target.error):
            wanted = 0.1 * self.target.error / done.parts["algebraic"]
            self._rtol = max(self._rtol * min(wanted, 0.3), LEAST_RTOL)

    def _alike(self):
        """Number of passes with the degree of the last one."""
        return sum(one.degree == self.passes[-1].degree for one in self.passes)

    def _stalls(self):
        """Whether the last meshes have brought nothing."""
        if self._alike() < PATIENCE:
            return False
        old, new = self.passes[-2], self.passes[-1]
        same = old.steps == new.steps and old.degree == new.degree
        return same and new.unknowns > GROWN * old.unknowns and new.error > FALLEN * old.error

    def _fits(self, unknowns):
        """None, or the exit status where a mesh has become too large for the budget."""
        self._budget.learn(self.passes[-1], unknowns)
        if self._budget.holds(unknowns):
            return None
        self._why = f"not reached: the budget is spent ({self._budget.by})"
        return SPENT

    # -- what is told ---------------------------------------------------------------------------------------------

    def _tell(self, simulation, status):
        """Put the section `accuracy` into the report of a pass. *Collective.*"""
        section = report(self.passes, self.target, status == REACHED)
        if self._degree.chosen is not None:
            section["degree"] = self._degree.chosen

        def write():
            data = simulation.records.report.data
            data["accuracy"] = {**data["accuracy"], **section}
            simulation.records.report.write()

        on_root(self.comm, write)


def _yields(scene):
    """Whether bodies may yield."""
    return any(scene.yields(body) for body in scene.bodies)


def _remembers(scene):
    """Whether what happens depends on what has happened: friction and plastic flow."""
    return _yields(scene) or any(one.friction or one.tresca or one.law for one in scene.contacts)


def _quantity(found, target, passes):
    """Value of a quantity, and what it is extrapolated to, with an uncertainty."""
    if target.quantity == "pressure":
        return {"value": found.value, "error": found.error}
    best = found.value + found.error + found.loads + found.algebraic
    # what is left of the estimate's own error; and, once there are two, by how much such values differ
    unsure = max([0.5 * abs(found.error), *(abs(one.quantity["extrapolated"] - best) for one in passes[-1:])])
    return {"value": found.value, "error": found.error, "extrapolated": best, "uncertainty": unsure}


def _tidy(directory, best, last):
    """The results of the best pass take the place of those of all passes."""
    folder = directory / f"pass_{best}"
    for source in sorted(folder.rglob("*")) if folder.is_dir() else []:
        if source.is_file():
            aim = directory / source.relative_to(folder)
            aim.parent.mkdir(parents=True, exist_ok=True)
            source.replace(aim)
    for number in range(1, last + 1):
        shutil.rmtree(directory / f"pass_{number}", ignore_errors=True)


def reach(scene, comm=MPI.COMM_WORLD, directory=None, **more):
    """Run a scene until its error is reached; parameters as for :class:`Loop`. *Collective.*"""
    return Loop(replace(scene), comm, **more).run(directory)
