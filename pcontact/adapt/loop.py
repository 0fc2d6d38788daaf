"""Runs on one mesh after the other, until the error is below the target or the budget is spent."""

import shutil
import time as clock
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcontact import build
from pcontact.adapt import seen, variants
from pcontact.adapt.budget import Budgeted
from pcontact.adapt.degree import cheaper
from pcontact.adapt.forecast import forecast
from pcontact.adapt.known import effectivity, of_quantity
from pcontact.adapt.passes import NAMES, Pass, said_of, table
from pcontact.adapt.sizes import cuts
from pcontact.adapt.watch import Beginning, Watch
from pcontact.element.reference import CELLS
from pcontact.mesh.refinement.refine import SIMPLICES, Balance, refine
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

REACHED, FAILED, SPENT = 0, 1, 4
# [-] Part of the target that the next mesh is made for. From: a mesh that just misses it costs another pass.
AIM = 0.9
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
# [-] Part of what was expected that counts at least. From: chosen.
LEAST_TRUST = 0.3
# [load steps] Times as many at once at most. From: chosen.
MORE_STEPS = 4
# Parts of the error that a finer mesh takes away as it does its own, and those that it leaves.
FALLING, STAYING = ("mesh", "quadrature", "loads", "frozen_partners"), ("straight_facets", "curved_facets")
# [passes] Before a forecast; the second one is left out where it would have more unknowns than that. From: one pass
# does not tell which of its seconds more unknowns take.
TRIED, SMALL = 2, 50_000


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
        self._degree = self._options.get(key_options(MeshSpec)["order"], scene.mesh.order)
        # estimate and degree of the last pass, and what part of the error estimates have been seen to be
        self._before, self._seen = None, 1.0
        # the pass of the lower degree, while the other one is tried
        self._lower, self._chosen, self._looks_ahead, self.ahead = None, None, False, None
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
        scene.output.estimate, scene.steps.count, scene.mesh.order = True, self._steps, self._degree
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
            self._require_simplices(simulation)
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

    def _require_simplices(self, simulation):
        """Refuse cells that cannot be cut. *Collective.*"""
        own = {block.cell for block in simulation.mesh.blocks if len(block.nodes)}
        kinds = set().union(*self.comm.allgather(own)) - set(SIMPLICES)
        if kinds:
            simulation.free()
            found = f"{', '.join(sorted(kinds))} cells together with accuracy.error"
            raise input_error(self.scene.where, "mesh.file", found, "triangles, tetrahedra: others are not cut")

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
        with reserved(directory, self.comm, said):
            status, best, failure = self._passes(directory)
            if directory is not None:
                on_root(self.comm, _tidy, directory, best, len(self.passes) + 1)
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
            status, step = self._next(watch, done)
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
        mesh = simulation.mesh
        if self._tries_degree(mesh):
            self._lower, self._degree = (mesh, watch, done, step), 2
            done.next = {"unknowns": None, "mesh": None, "load_steps": self._steps, "degree": 2}
            return mesh, (watch.times, watch.fields), None
        last = done
        if self._lower is not None:
            lower, self._lower = self._lower, None
            self._chosen = cheaper(lower[2], done, self.target.error)
            log.info("degree %d: %s", self._chosen["degree"], self._chosen["why"])
            if self._chosen["degree"] == 1:
                mesh, watch, last, step = lower
                self._degree = 1
                done.next = {"unknowns": step.growth * last.unknowns, "mesh": step.part * last.parts["mesh"],
                             "load_steps": self._steps, "degree": 1}  # fmt: skip
        balance = Balance(*build.balance(simulation.scene, self._options))
        finer, fields = refine(mesh, step.more, watch.fields, balance)
        status = self._fits(last.unknowns * finer.n_nodes_total / mesh.n_nodes_total)
        return finer, (watch.times, fields), status

    def _tries_degree(self, mesh):
        """Whether the degree is ours to choose, and has not been chosen."""
        return mesh.curved and self._degree is None and self._chosen is None and self._lower is None

    def _look_ahead(self, watch, done, step):
        """`SPENT` and a forecast where it has enough passes to stand on. *Collective.*"""
        growing = [one for one in self.passes if one.degree == done.degree]
        if self._tries_degree(self.mesh) or (len(growing) < TRIED and step.growth * done.unknowns < SMALL):
            return None
        self.ahead = forecast(self.comm, growing, watch.squares, self._wanted(done))
        return SPENT

    def _measured(self, simulation, watch, seconds):
        """What a pass says of its errors. *Collective.*"""
        space, mesh = simulation.problem.space, simulation.mesh
        kinds = {block.cell for block in mesh.blocks if len(block.nodes)}
        simplices = any(not CELLS[kind].is_tensor for some in self.comm.allgather(kinds) for kind in some)
        known = effectivity(simulation.scene, simplices, mesh.dim, space.degree)
        norm = watch.norm if watch.norm > 0.0 else 1.0
        estimate, size, found = watch.absolute / self._part_seen(simulation, watch) / norm, norm, None
        beside = {"algebraic": watch.algebraic / norm}
        loads, forces = simulation.error_estimate.of_loads(watch.time)
        beside["loads"] = loads / norm
        if self.target.quantity != "energy":
            found = simulation.error_estimate.of_quantity(
                self.target, watch.record, simulation.stepper.u, watch.time, watch.unbalanced
            )
            known, size = of_quantity(self.target.quantity, mesh.dim), abs(found.value) or 1.0
            estimate = abs(found.error) / size
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
        scene, degree = simulation.scene, simulation.problem.space.degree
        if self.target.quantity != "energy" or not any(scene.yields(body) for body in scene.bodies):
            return 1.0
        old, self._before = self._before, (simulation.error_estimate.last["absolute"], degree)
        part = float("nan")
        if old is None or old[1] != degree:
            simulation.close()
            part = seen.on_halved(simulation, self._scene(), self._options)
            if not np.isfinite(part):
                log.warning("not known: what part of the error the estimate is where bodies yield")
        elif simulation.begin(watch.time) is not None:
            part = seen.between(simulation, simulation.begin(watch.time), old[0])
        # a mesh that has changed the solution little says little
        self._seen = min(self._seen, part) if np.isfinite(part) else self._seen
        return self._seen

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

    def _next(self, watch, done):
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
        step = cuts(self.comm, watch.squares, done.degree, self.mesh.dim, self._wanted(done), most)
        done.next = {"unknowns": step.growth * done.unknowns, "mesh": step.part**done.power * done.parts["mesh"],
                     "load_steps": self._steps, "degree": done.degree}  # fmt: skip
        return None, step

    def _wanted(self, done):
        """The part of the error in the energy norm that the next mesh is made for."""
        goal, share = self.target.error, SHARE * self.target.error
        stays = sum(done.parts.get(name, 0.0) for name in STAYING)
        stays += sum(min(done.parts.get(name, 0.0), share) for name in ("algebraic", "load_steps"))
        falls = sum(done.parts.get(name, 0.0) for name in FALLING)
        part = min(AIM * max(goal - stays, share) / falls, 1.0) * self._trust(done)
        # errors of quantities are products of two errors of the energy norm
        return part ** (1.0 / done.power)

    def _trust(self, done):
        """What the last pass has brought over what was expected of it: less where solutions are singular."""
        old = self.passes[-2] if len(self.passes) > 1 else None
        if old is None or old.degree != done.degree or old.next is None or old.next["degree"] != done.degree:
            return 1.0
        return float(np.clip(old.next["mesh"] / done.parts["mesh"], LEAST_TRUST, 1.0))

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
        if self._chosen is not None:
            section["degree"] = self._chosen

        def write():
            data = simulation.records.report.data
            data["accuracy"] = {**data["accuracy"], **section}
            simulation.records.report.write()

        on_root(self.comm, write)


def _remembers(scene):
    """Whether what happens depends on what has happened: friction and plastic flow."""
    slips = any(one.friction or one.tresca or one.law for one in scene.contacts)
    return slips or any(scene.yields(body) for body in scene.bodies)


def _quantity(found, target, passes):
    """Value of a quantity, and what it is extrapolated to, with an uncertainty."""
    if target.quantity == "pressure":
        return {"value": found.value, "error": found.error}
    best = found.value + found.error + found.loads + found.algebraic
    # what is left of the estimate's own error; and, once there are two, by how much such values differ
    unsure = max([0.5 * abs(found.error), *(abs(one.quantity["extrapolated"] - best) for one in passes[-1:])])
    return {"value": found.value, "error": found.error, "extrapolated": best, "uncertainty": unsure}


def report(passes, target, reached):
    """Section `accuracy` of the report.

    Parameters
    ----------
    passes : list of Pass
    target : pcontact.scene.target.Target
    reached : bool
    """
    last = passes[-1]
    return {
        "target": {"error": target.error, "of": target.of}, "reached": reached, "error": last.error,
        "estimate": last.estimate, "parts": last.parts,
        "effectivity": {"least": last.known.least, "most": last.known.most, "of": last.known.words},
        **({} if last.quantity is None else {"quantity": last.quantity}), "rate": rate(passes),
        "half": cost_of(passes, 0.5 * last.error), "target_cost": cost_of(passes, target.error),
        "passes": [one.report() for one in passes],
    }  # fmt: skip


def rate(passes):
    """Power of the unknowns with which the error falls: as seen in the last two passes, or as smooth solutions have."""
    smooth = passes[-1].power * passes[-1].degree / passes[-1].known.dim
    if len(passes) < 2 or passes[-1].unknowns <= passes[-2].unknowns or passes[-1].degree != passes[-2].degree:
        return smooth
    old, new = passes[-2:]
    seen = np.log(old.parts["mesh"] / new.parts["mesh"]) / np.log(new.unknowns / old.unknowns)
    return float(np.clip(seen, 0.1 * smooth, 2.0 * smooth))


def cost_of(passes, error):
    """Unknowns and seconds that an error would take, from the last pass by the rate seen."""
    last = passes[-1]
    growth = max((last.error / error) ** (1.0 / rate(passes)), 1.0) if last.error > 0.0 else 1.0
    return {"error": error, "unknowns": last.unknowns * growth, "seconds": last.seconds * growth}


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
