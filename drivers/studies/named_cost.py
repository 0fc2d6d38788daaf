"""What reaching an error costs: the seconds of all passes over those of a run on the last mesh alone, from scratch.

Scenes of `_named_scenes.py` that take two refinements or more, on one rank of an idle machine; kernels are loaded by
runs outside the clock. ``--by-hand`` sets Hertz's ball beside uniform meshes of degree 1, and beside the mesh and
settings that cost least for their error in docs/tables/accuracy.md; the error of the loop is its estimate over the
effectivity that docs/estimate.md has for that scene.
"""

import time as clock
from dataclasses import replace

from drivers._common import log, main, make_parser, print_table, write_json
from drivers.studies._named_scenes import SCENES
from drivers.studies._trade_cases import CASES
from drivers.studies._trade_runs import changed
from pcontact.adapt.loop import Loop
from pcontact.runtime.errors import InputError
from pcontact.scene.target import LARGEST, Target
from pcontact.simulation import Simulation

HEAD = ("scene", "target", "named", "unknowns", "passes", "loop, s", "one run, s", "cost")
TARGETS = {"punch": 0.01, "hertz2d": 0.005, "cattaneo": 0.01, "receding": 0.005, "hertz3d": 0.03}
# [-] Estimate over error of the ball with degree 2. From: docs/estimate.md
EFFECTIVITY = 1.35
BEST = {"quadrature": 3, "snes": 1e-3, "krylov": 0.01, "patience": 30, "again": 1}


def seconds_of(scene, mesh=None):
    """Set-up and solve of one run, and its unknowns. *Collective.*"""
    begun = clock.perf_counter()
    simulation = Simulation(scene, mesh=mesh)
    try:
        if not simulation.run(None):
            raise InputError("a load step did not converge; allowed: another scene")
        return clock.perf_counter() - begun, simulation.problem.space.n_dofs
    finally:
        simulation.free()


def measured(name, target, folder):
    """A row of the table, and the loop. *Collective.*"""
    scene = SCENES[name].scene(folder)
    for one, error in ((scene, LARGEST), (SCENES["punch"].scene(folder), 0.1)):
        Loop(replace(one.copy(), accuracy=Target(error))).run()
    begun = clock.perf_counter()
    loop = Loop(replace(scene.copy(), accuracy=Target(target)))
    loop.run()
    seconds, last, alone = clock.perf_counter() - begun, loop.passes[-1], loop.last_scene()
    alone.output.estimate = False
    single, _ = seconds_of(alone, loop.mesh)
    return [name, target, last.error, last.unknowns, len(loop.passes), seconds, single, seconds / single], loop


def by_hand(args):
    """Hertz's ball: the loop, uniform meshes of degree 1, and what costs least by hand."""
    row, loop = measured("hertz3d", args.target, args.o)
    rows = [["-error", loop.passes[-1].estimate / EFFECTIVITY, row[3], row[5]]]
    case = CASES["hertz3d"]
    for facets, degree, knobs in ((4, 2, BEST), (8, 2, BEST), (8, 1, {}), (16, 1, {})):
        scene = changed(case.scene(case.mesh(args.o, facets, degree), degree, case.steps), knobs)
        seconds, unknowns = seconds_of(scene)
        rows.append([f"{facets} facets, degree {degree}", float("nan"), unknowns, seconds])
    print_table("ball on block", ("mesh", "error", "unknowns", "seconds"), rows)
    return rows


def run(args):
    """All rows; exit status."""
    rows = []
    for name in ["punch"] if args.tiny else args.scene:
        rows.append(measured(name, 0.1 if args.tiny else TARGETS[name], args.o)[0])
        write_json(args.o / "named_cost.json", [dict(zip(HEAD, row, strict=True)) for row in rows])
    print_table("cost of named errors", HEAD, rows)
    if args.by_hand:
        write_json(args.o / "by_hand.json", by_hand(args))
    log.info("most: %.3g", max((row[-1] for row in rows), default=0.0))
    return 0


def parser():
    """The driver's options."""
    p = make_parser(__doc__, "named_cost_results")
    add = p.add_argument
    add("--scene", nargs="*", default=list(TARGETS), choices=list(TARGETS), help="all, if nothing is said")
    add("--by-hand", action="store_true", help="Hertz's ball beside meshes made by hand")
    add("--target", type=float, default=0.04, help="of the ball with --by-hand (0.04)")
    return p


if __name__ == "__main__":
    main(run, parser())
