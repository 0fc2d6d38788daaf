"""Runs of the trade of speed for accuracy: one setting, its errors and what it costs."""

import copy
import gc
import logging
import time as clock
from contextlib import contextmanager
from pathlib import Path

from drivers.studies._harness import Counts
from drivers.studies._overkill import Overkill
from drivers.studies._trade_cases import Case, linear
from pcontact.runtime.log import LOGGER
from pcontact.runtime.petsc import MPI
from pcontact.runtime.presets import PRESETS as CHOICES
from pcontact.scene.model import Scene
from pcontact.simulation import Simulation

# what is changed one after the other around the base. "straight": displacements of degree 2
# on a mesh of degree 1. "krylov": a fixed tolerance of the linear solves, or
# ("ew", x): inexact ones (Eisenstat, Walker) that begin with x and are never looser; the default is ("ew", 1e-3)
KNOBS = {
    "quadrature": (2, 3, 5, 15),
    "theta": (1.0, -1.0),
    "gamma0": (0.1, 0.3, 10.0),
    "snes": (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-10),
    "krylov": (("ew", 1e-1), ("ew", 1e-2), 1e-1, 1e-2, 1e-6),
    "steps": (2,),
    "partners": (1.0, 1e-4),
    "patience": (-1,),
    "jacobian": (2,),
    "straight": (True,),
}
PRESETS = tuple(CHOICES)
# a run that is shorter is repeated, three times at most, and the fastest counts [s]
SHORT = 1.0


class Timed(Simulation):
    """A simulation that counts the processor's seconds of its set-up, reading and distributing left out."""

    cpu_set_up = wall_set_up = 0.0

    def _assemble(self):
        cpu, wall = clock.process_time(), clock.perf_counter()
        super()._assemble()
        self.cpu_set_up, self.wall_set_up = clock.process_time() - cpu, clock.perf_counter() - wall


@contextmanager
def quiet():
    """Only warnings and errors are told: hundreds of runs follow each other."""
    level = LOGGER.level
    LOGGER.setLevel(logging.ERROR)
    try:
        yield
    finally:
        LOGGER.setLevel(level)


def changed(scene: Scene, knobs: dict) -> Scene:
    """The scene with the values of some settings, in place."""
    petsc = {}
    for key, value in knobs.items():
        if key in ("theta", "gamma0", "quadrature"):
            for contact in scene.contacts:
                setattr(contact, key, value)
            # values below the bound of coercivity are tried, too
            scene.allow_unsafe = ["gamma0"]
        elif key == "krylov":
            if isinstance(value, tuple):
                petsc |= {"snes_ksp_ew_rtol0": value[1], "snes_ksp_ew_rtolmax": value[1]}
            else:
                petsc |= {"snes_ksp_ew": False, "ksp_rtol": value}
        elif key == "accuracy":
            scene.accuracy = value
            if scene.mesh.order == CHOICES[value].order:
                # for the preset to find
                scene.mesh.order = None
        elif key == "patience":
            petsc["newton_without"] = "reuse"
        elif key not in ("steps", "straight"):
            name = {"snes": "snes_rtol", "partners": "contact_partner_rtol", "jacobian": "snes_lag_jacobian"}[key]
            petsc[name] = value
    scene.petsc = {**scene.petsc, **petsc}
    return scene


def timed(scene: Scene, measure=None, repeat: int = 3) -> dict:
    """Run a scene, more than once if it is short. *Collective.*

    Parameters
    ----------
    scene : Scene
    measure : callable, optional
        ``measure(simulation)`` gives a dict of errors, after the clock has stopped.
    repeat : int
        Runs at most.

    Returns
    -------
    dict
        ``converged``, ``unknowns``, ``newton``, ``krylov``, ``cpu`` and ``wall`` [s] of the set-up and the solve on
        the slowest rank, ``memory_mb`` (peak of all ranks beyond what they held before), ``errors`` (empty where it
        did not converge).
    """
    row, spent, comm = None, 0.0, MPI.COMM_WORLD
    for _ in range(repeat):
        gc.collect()
        counts = Counts()
        # the program writes into it what options say
        simulation = Timed(copy.deepcopy(scene))
        try:
            cpu, wall = clock.process_time(), clock.perf_counter()
            converged = simulation.run(None, [counts])
            cpu = comm.allreduce(clock.process_time() - cpu + simulation.cpu_set_up, op=MPI.MAX)
            wall = comm.allreduce(clock.perf_counter() - wall + simulation.wall_set_up, op=MPI.MAX)
            if row is None:
                memory = simulation.costs.memory()
                row = {
                    "converged": converged, "unknowns": simulation.problem.space.n_dofs, "newton": counts.newton,
                    "krylov": counts.krylov, "cpu": cpu, "wall": wall,
                    "memory_mb": max(memory["solve"]["peak_mb"] - memory["start"]["resident_mb"], 0.0),
                    "errors": measure(simulation) if measure is not None and converged else {},
                }  # fmt: skip
            row |= {"cpu": min(row["cpu"], cpu), "wall": min(row["wall"], wall)}
        finally:
            simulation.close()
        spent += wall
        if spent > SHORT:
            break
    return row


def label(row: dict) -> str:
    """A setting in words: mesh, degree, and what is not as in the base."""
    words = [f"{row['size']:g} facets", f"degree {row['degree']}"]
    for key, value in row["knobs"].items():
        shown = f"{value[0]} {value[1]:g}" if isinstance(value, (tuple, list)) else value
        words.append(str(shown) if key == "accuracy" else f"{key} {shown}")
    return ", ".join(words)


class Runner:
    """All runs of a case. *Collective.*

    Parameters
    ----------
    name : str
    case : Case
    directory : pathlib.Path
        Of the meshes.
    tell : callable
        Called with every row.
    repeat : int
        Of a short run.

    Attributes
    ----------
    rows : list of dict
        See :func:`timed`; ``size``, ``degree``, ``knobs``, ``label`` as well, ``unit_cpu``, ``unit_wall`` of the linear
        elastic solve on the mesh of the case's unit, and ``own_cpu``, ``own_wall`` of that on the row's mesh.
    """

    def __init__(self, name: str, case: Case, directory: Path, tell, repeat: int = 3):
        self.name, self.case, self.directory, self.tell, self.repeat = name, case, directory, tell, repeat
        self.rows, self._meshes, self._linear, self.reference = [], {}, {}, None

    def mesh(self, size, degree):
        """The mesh file."""
        if (size, degree) not in self._meshes:
            self._meshes[size, degree] = self.case.mesh(self.directory, size, degree)
        return self._meshes[size, degree]

    def prepare(self, overkill=True):
        """Compile or load all kernels outside the clock; solve on the overkill mesh where one is needed."""
        case, close = self.case, {"partners": 1e-4}
        with quiet():
            for degree, sizes in case.sizes.items():
                path = self.mesh(sizes[0], degree)
                timed(changed(case.scene(path, degree, case.steps), close), repeat=1)
            if case.overkill is None:
                return
            size, degree, steps = case.overkill
            if not overkill:
                size, degree, steps = case.sizes[2][-1], 2, case.steps
            scene = changed(case.scene(self.mesh(size, degree), degree, steps), close)
            simulation = Simulation(scene)
            try:
                if not simulation.run(None):
                    raise RuntimeError(f"{self.name}: the run on the overkill mesh did not converge")
                self.reference = Overkill(simulation)
            finally:
                simulation.close()

    def unit(self, size, degree):
        """Processor's and wall seconds of the linear elastic solve on a mesh."""
        if (size, degree) not in self._linear:
            scene = linear(self.case.scene(self.mesh(size, degree), degree, 1), self.case.loose)
            with quiet():
                row = timed(scene, repeat=self.repeat)
            self._linear[size, degree] = row["cpu"], row["wall"]
        return self._linear[size, degree]

    def __call__(self, size, degree, **knobs):
        """The row of a setting; what has been run before is not run again."""
        case = self.case
        for row in self.rows:
            if (row["size"], row["degree"], row["knobs"]) == (size, degree, knobs):
                return row
        unit, own = self.unit(case.unit, 1), self.unit(size, degree)
        mesh = self.mesh(size, 1 if knobs.get("straight") else degree)
        scene = changed(case.scene(mesh, degree, knobs.get("steps", case.steps)), knobs)
        with quiet():
            row = timed(scene, lambda simulation: case.errors(simulation, self.reference), self.repeat)
        row = {"scene": self.name, "size": size, "degree": degree, "knobs": knobs, **row}
        row |= {"unit_cpu": unit[0], "unit_wall": unit[1], "own_cpu": own[0], "own_wall": own[1], "label": label(row)}
        self.rows.append(row)
        self.tell(row)
        return row


def sweep(run: Runner, most: dict | None = None) -> None:
    """Mesh times degree; one setting after the other around the bases; what pays, together; the presets."""
    case = run.case
    knobs = {**KNOBS, **case.knobs} if most is None else most
    for degree, sizes in case.sizes.items():
        for size in sizes:
            run(size, degree)
    for degree, size in case.base.items():
        for key, values in knobs.items():
            for value in values if key != "straight" or degree == 2 else ():
                run(size, degree, **{key: value})
    for degree, sizes in case.sizes.items():
        together = paying(run.rows, case.base[degree], degree)
        for size in sizes:
            for finer in ({}, *case.finer):
                run(size, degree, **{**together, **finer})
    for name in PRESETS:
        for degree in preset_degrees(name):
            for size in case.sizes[degree]:
                run(size, degree, accuracy=name)


def preset_degrees(name: str) -> tuple:
    """Degrees of the meshes that a preset is run on; where it takes degree 2, a straight mesh still has degree 1."""
    return (1,) if CHOICES[name].order == 1 else (1, 2)


def paying(rows: list[dict], size, degree: int, worse: float = 1.1, clock_: str = "cpu") -> dict:
    """Of each setting the value that costs least while no error in a norm grows by more than a tenth.

    Parameters
    ----------
    rows : list of dict
        With the base and one setting changed in each.
    size, degree
        Of the base.
    worse : float
        Factor by which an error may grow.
    clock_ : "cpu" or "wall"

    Returns
    -------
    dict
        Settings that cost less than the base.
    """
    own = [row for row in rows if (row["size"], row["degree"]) == (size, degree) and row["converged"]]
    base = next((row for row in own if not row["knobs"]), None)
    best = {}
    for row in own if base else ():
        if len(row["knobs"]) != 1 or "accuracy" in row["knobs"]:
            continue
        ((key, value),) = row["knobs"].items()
        fine = all(row["errors"][name] <= worse * base["errors"][name] for name in base["errors"])
        if fine and row[clock_] < best.get(key, (base[clock_],))[0]:
            best[key] = row[clock_], value
    return {key: value for key, (_, value) in best.items()}
