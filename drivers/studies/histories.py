"""What a load step of a history costs, in linear elastic solves on the same mesh, and where it goes.

Ironing in space and in the plane, Cattaneo and Mindlin's cylinders, a clip, a spring, an indentation, a heap, a
slab that irons with finite strain, a billet that is upset, and a sheet that is drawn, each with all of its load steps.
One linear elastic solve is a preconditioner and the Krylov method to 1e-8 (or factors) for the tangent of elastic
bodies with small strain after the first load step, and a force that is the same at all nodes. Seconds are those of the
processor, of rank 0, without set-up and the first load step; parts are as the seconds of the phases.
"""

import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from drivers._common import log, main, make_directory, make_mesh, markdown, print_table, running, write_json
from drivers.cases import cattaneo_mindlin, ironing
from drivers.studies import _robust_scenes as scenes
from drivers.studies._harness import Counts, Rows, study_parser
from meshes import ironing as ironing_mesh
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import Material, Scene
from pcontact.simulation import Simulation

# [solves] Of which the fastest is the unit. From: chosen.
REPEATS = 3
PHASES = {
    "krylov": ("krylov",), "preconditioner": ("preconditioner",), "search": ("search",), "matrix": ("matrix",),
    "bulk": ("bulk_assembly",), "contact": ("contact_assembly",), "output": ("output",),
}  # fmt: skip
COLUMNS = ("history", "unknowns", "steps", "cuts", "newton", "krylov", "searches", "units",
           *(f"of that: {word}" for word in PHASES))  # fmt: skip


def ironed(folder: Path, dim: int, h: float) -> Scene:
    """The foot that irons a slab."""
    path = make_mesh(ironing_mesh, folder / "mesh.msh", dim, h)
    return ironing.scene(path, dim, 0.3, count=20)


def cylinders(folder: Path, press: int = 10, steps: int = 5) -> Scene:
    """Cattaneo and Mindlin's cylinders."""
    args = Namespace(
        h=None, order=1, mu=0.2, gamma0=None, displacement=cattaneo_mindlin.DISPLACEMENT, press=press, steps=steps,
        fields=False, tiny=False,
    )  # fmt: skip
    cattaneo_mindlin.check(args)
    return cattaneo_mindlin.make_scene(cattaneo_mindlin.generate(folder / "mesh.msh", args), args, 0.0)


def coils(folder: Path, **keys) -> Scene:
    """The spring whose coils close."""
    return scenes.sprung(folder, h=0.25, along=1.0, steps=8, friction=0.2, **keys)


@dataclass(frozen=True)
class History:
    """A scene of the study: its kind is elastic, plastic or finite; `make` gives it a folder and returns the scene."""

    name: str
    kind: str
    make: Callable[[Path], Scene]


HISTORIES = [History(*row) for row in (
    ("Cattaneo and Mindlin", "elastic", cylinders),
    ("ironing, space", "elastic", partial(ironed, dim=3, h=0.125)),
    ("ironing, plane", "elastic", partial(ironed, dim=2, h=0.02)),
    ("clip", "elastic", partial(scenes.clipped, h=0.05, count=60, yield_stress=0.0)),
    ("spring", "elastic", coils),
    ("heap", "elastic", partial(scenes.heaped, h=0.13)),
    ("clip, yields", "plastic", partial(scenes.clipped, h=0.05, count=60)),
    ("spring, yields", "plastic", partial(coils, yield_stress=150.0)),
    ("indentation", "plastic", partial(scenes.indented, h=0.02, friction=0.3)),
    ("heap, yields", "plastic", partial(scenes.heaped, h=0.13, yield_stress=20.0)),
    ("ironing, finite strain", "finite", partial(
        scenes.large, make=scenes.slides.ironing_scene, mesh=(scenes.ironing_slab, 8), arguments={}, down=1.0, way=2.0,
        press=20, drag=20)),
    ("upsetting", "finite", partial(
        scenes.large, make=scenes.slides.upsetting_scene, mesh=(scenes.round_bar, (36, 54)),
        arguments={"radius": 10.0, "length": 30.0, "waist": 1.0}, most=0.4, count=20)),
    ("drawn sheet", "finite", partial(scenes.drawn, cells=(120, 6))),
)]  # fmt: skip


class Clock(Counts):
    """Observer: what load steps take, and the processor seconds at the end of each."""

    def __init__(self):
        super().__init__()
        self.seconds = []

    def step(self, step, u, record):
        """Add the step."""
        super().step(step, u, record)
        self.seconds.append(time.process_time())


class Unit(Counts):
    """Observer: the processor seconds of a linear solve after the first load step, which is the last one."""

    def __init__(self):
        super().__init__()
        self.seconds = self.iterations = None
        self.simulation = None

    def step(self, step, u, record):
        """Measure, and end the run."""
        problem = self.simulation.problem
        problem.tangent(u)
        operator, base = self.simulation.newton.snes.getKSP().getOperators()
        force, seconds = problem.space.vector(), []
        force.set(1.0)
        problem.conditions.follow(force)
        for _ in range(REPEATS):
            # what multigrid has found of a matrix stays with it
            matrix = base.copy()
            matrix.setNearNullSpace(base.getNearNullSpace())
            start = time.process_time()
            ksp = PETSc.KSP().create(comm=matrix.getComm())
            ksp.setOperators(operator if operator != base else matrix, matrix)
            ksp.setFromOptions()
            ksp.setTolerances(rtol=1e-8)
            ksp.solve(force, force.duplicate())
            seconds.append(time.process_time() - start)
            self.iterations = ksp.getIterationNumber()
            ksp.destroy()
        self.seconds = min(seconds)
        raise Measured


class Measured(Exception):
    """The unit is known."""


def elastic(scene: Scene) -> Scene:
    """The scene with elastic bodies and small strain, without the options of its own."""
    materials = {name: Material(one.E, one.nu) for name, one in scene.materials.items()}
    return replace(scene, materials=materials, mesh=replace(scene.mesh, strain="small", mean_dilatation=False))


def unit_of(scene: Scene) -> tuple[float, int]:
    """Processor seconds and Krylov iterations of one linear elastic solve. *Collective.*"""
    unit = Unit()
    unit.simulation = Simulation(elastic(scene))
    try:
        unit.simulation.run(None, [unit])
    except Measured:
        pass
    finally:
        unit.simulation.free()
    return unit.seconds, unit.iterations


def solve(history: History, folder: Path) -> dict:
    """A history: a row. *Collective.*"""
    make_directory(folder)
    scene = history.make(folder)
    unit, iterations = unit_of(scene)
    clock = Clock()
    start = time.process_time()
    with running(scene, None, [clock]) as (simulation, converged):
        phases, unknowns = simulation.profile.phases(), simulation.problem.space.n_dofs
        searches = sum(record.get("partners", {}).get("searches", 0) for record in clock.records)
    # set-up and the first load step, in which kernels are loaded, are no part of a load step
    steps = len(clock.seconds) - 1
    seconds = (clock.seconds[-1] - clock.seconds[0]) / steps
    row = {"history": history.name, "kind": history.kind, "converged": converged, "unknowns": unknowns}
    row |= {"steps": clock.steps, "cuts": clock.cuts, "newton": clock.newton / clock.steps}
    row |= {"krylov": clock.krylov / clock.newton, "searches": searches / clock.steps, "most": clock.most}
    row |= {"unit": unit, "unit_krylov": iterations, "seconds": seconds, "units": seconds / unit}
    row["whole"] = clock.seconds[-1] - start
    whole = sum(phases.get(name, 0.0) for names in PHASES.values() for name in names)
    for word, names in PHASES.items():
        row[f"of that: {word}"] = seconds / unit * sum(phases.get(name, 0.0) for name in names) / whole
    return row


def page(rows: list[dict]) -> list[str]:
    """The table in Markdown."""
    return markdown(COLUMNS, [[_short(row[key]) for key in COLUMNS] for row in rows])


def _short(value):
    return f"{value:.3g}" if isinstance(value, float) else value


def run(args) -> int:
    """All histories; 1 when one does not converge."""
    rows = Rows(args.o / "rows.jsonl", ("history",), args.go_on)
    chosen = [history for history in HISTORIES if not args.only or history.name in args.only]
    for history in chosen[:1] if args.tiny else chosen:
        row = rows.get({"history": history.name}, partial(solve, history, args.o / "run"))
        log.info("%s: %s", history.name, row)
    found = list(rows)
    print_table("histories", COLUMNS, [[_short(row[key]) for key in COLUMNS] for row in found])
    write_json(args.o / "histories.json", {"rows": found})
    if MPI.COMM_WORLD.rank == 0:
        (args.o / "histories.md").write_text("\n".join(page(found)) + "\n")
    return 0 if all(row["converged"] for row in found) else 1


if __name__ == "__main__":
    parser = study_parser(__doc__, "histories_results")
    names = ", ".join(history.name for history in HISTORIES)
    parser.add_argument("--only", nargs="+", metavar="NAME", help=f"some of: {names}")
    main(run, parser)
