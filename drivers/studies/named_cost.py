"""What reaching an error costs: the seconds of all passes over those of a run on the last mesh alone, from scratch.

Scenes of `_named_scenes.py`, with targets that take two refinements or more, on one rank of an idle machine; kernels
are loaded by runs outside the clock. ``--by-hand`` sets Hertz's ball beside uniform meshes of degree 1, and beside the
meshes and settings that cost least for their error in docs/tables/accuracy.md: seconds of those, at the error of the
loop, are extrapolated with the rates of the two finest meshes. All errors are distances to the reference that
`named_error.py` leaves beside its rows (``--against``, which takes minutes and is no part of the seconds).

    python drivers/studies/named_cost.py --scene punch rings -o small
    python drivers/studies/named_cost.py --join small large --publish docs/tables/named_cost.md
    python drivers/studies/named_cost.py --scene --by-hand --target 0.04 0.02 -o hand
    python drivers/studies/named_cost.py --scene --by-hand --against ball/reference_hertz3d.npz -o errors
"""

import time as clock
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from drivers._common import log, main, markdown, print_table, write_json
from drivers.studies import _harness as harness
from drivers.studies._harness import Rows, solved, study_parser
from drivers.studies._named_reference import BUDGET, Reference
from drivers.studies._named_scenes import HELD_BACK, SCENES
from drivers.studies._trade_cases import CASES
from drivers.studies._trade_runs import changed
from drivers.studies.named_error import Answer
from pcontact.adapt.loop import Loop
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import LARGEST, Target

FILE = "named_cost.json"
HEAD = ("scene", "of", "target", "named", "unknowns", "passes", "loop, s", "last pass, s", "trials, s", "one run, s",
        "cost", "by default, s", "over that")  # fmt: skip
TARGETS = {
    "punch": (("energy", 0.01), ("support:punch_top", 0.01), ("support:punch_top", 1e-5), ("force:face", 0.01),
              ("force:face", 1e-5)),
    "receding": (("energy", 0.005), ("displacement:upper_top", 0.0005), ("displacement:upper_top", 1e-6),
                 ("pressure:face", 0.005)),
    "rings": (("energy", 0.01), ("pressure:circle", 0.05)),
    "shrink_fit": (("energy", 0.01),),
    "soft_punch": (("pressure:face", 0.02),),
    "hertz2d": (("energy", 0.005), ("pressure:cylinder_skin-block_top", 0.02)),
    "disk": (("energy", 0.01),),
    "sheared": (("energy", 0.02), ("energy", 0.005), ("support:upper_top", 0.005),
                ("support:upper_top", 2e-4)),
    "hill": (("energy", 0.01), ("energy", 0.005)),
    "cattaneo": (("energy", 0.01),),
    "indent": (("energy", 0.1), ("energy", 0.05)),
    "disc_press": (("energy", 0.1),),
    "lug": (("energy", 0.05), ("energy", 0.02)),
    "hertz3d": (("energy", 0.03),),
}
ALL = SCENES | HELD_BACK
# [s] Below, the best of three loops counts after a first one, and the best of three runs: what is loaded or compiled
# when it is first used is no part of either.
SHORT = 8.0
BEST = {"quadrature": 3, "snes": 1e-3, "krylov": 0.01, "again": 1}
ABOUT = """# What naming an error costs

`python drivers/studies/named_cost.py` writes this page (`--scene` by `--scene`, then `--join` and `--publish`). It runs
the scenes of `drivers/studies/_named_scenes.py` on one rank of an idle machine until the error `named` is below
`target`, from a coarse mesh. `loop` are the seconds of all passes, trials, estimates and dual problems together,
`last pass` those of the last one, `trials` those spent on errors that the mesh has no part in. `one run` are the
seconds of a run on the last mesh alone, from scratch, with the settings of the last pass and without an estimate;
`cost` is `loop` over these. `by default` are those of a run on that mesh with the settings of the scene alone, as a
user runs it, with the load steps of the last pass: it solves by multigrid where passes in the plane have factors, and
has another tolerance where the error of a number is named; `over that` is `loop` over these. Kernels are loaded before.
`pressure` is that in L2.

A pass takes 0.03 to 0.1 s however few unknowns it has, as one run does: where the last mesh has some hundred of them,
`cost` counts the runs. The same quantities at smaller targets, whose last meshes have some ten thousand, tell what
naming their errors costs.

"""


def seconds_of(scene, mesh=None, take=lambda _: None):
    """Set-up and solve of one run from scratch, its unknowns, and what `take` makes of it. *Collective.*"""
    if mesh is not None:
        mesh.pieces.clear()
    begun = clock.perf_counter()
    with solved(scene, mesh) as (simulation, _):
        return clock.perf_counter() - begun, simulation.problem.space.n_dofs, take(simulation)


def loop_of(scene, target):
    """A loop that has run, and its seconds. *Collective.*"""
    begun = clock.perf_counter()
    loop = Loop(replace(scene.copy(), accuracy=target))
    loop.run()
    return loop, clock.perf_counter() - begun


def measured(name, of, error, folder):
    """A row of the table, and the loop. *Collective.*"""
    scene = ALL[name].scene(folder)
    if of.startswith("displacement:"):
        scene.output.probes = [of.partition(":")[2]]
    for one, some in ((scene, LARGEST), (SCENES["punch"].scene(folder), 0.1)):
        loop_of(one, Target(some))
    loop, seconds = loop_of(scene, Target(error, of, budget=BUDGET))
    if seconds < SHORT:
        again = [loop_of(scene, Target(error, of, budget=BUDGET)) for _ in range(3)]
        loop, seconds = min(again, key=lambda one: one[1])
    last, alone = loop.passes[loop.best - 1], loop.best_scene()
    alone.output.estimate = False
    usual = replace(scene.copy(), accuracy=None)
    usual.steps.count, usual.mesh.order, usual.output.estimate = last.steps, last.degree, False
    single, default = (min(seconds_of(one, loop.mesh)[0] for _ in range(3 if seconds < SHORT else 1))
                       for one in (alone, usual))  # fmt: skip
    trials = sum(one.trials for one in loop.passes)
    return [name, of, error, last.error, last.unknowns, len(loop.passes), seconds, last.seconds, trials, single,
            seconds / single, default, seconds / default], loop  # fmt: skip


def told(*args):
    """The row alone, as a dict. *Collective.*"""
    return dict(zip(HEAD, measured(*args)[0], strict=True))


def at_error(rows, error):
    """Seconds at an error, with the rate of two (error, seconds)."""
    (coarse, little), (fine, much) = rows
    return much * (fine / error) ** (np.log(much / little) / np.log(coarse / fine))


def by_hand(args):
    """Hertz's ball: the loop, uniform meshes of degree 1, and what costs least by hand."""
    best = None if args.against is None else Reference.read(args.against)

    def error(kept):
        return float("nan") if best is None else best.distance(kept.solution.at, kept.axisymmetric, kept.laws)

    def taken(simulation):
        return None if best is None else Answer.of(simulation, True)

    rows, case = [], CASES["hertz3d"]
    loop_of(ALL["hertz3d"].scene(args.o), Target(0.1))
    for target in args.target:
        loop, seconds = loop_of(ALL["hertz3d"].scene(args.o), Target(target, budget=BUDGET))
        kept = None if best is None else seconds_of(loop.best_scene(), loop.mesh, taken)[2]
        rows.append([f"-error {target:g}", error(kept), loop.passes[-1].unknowns, seconds])
    for facets, degree, knobs in ((4, 2, BEST), (8, 2, BEST), (8, 1, {}), (16, 1, {})):
        scene = changed(case.scene(case.mesh(args.o, facets, degree), degree, case.steps), knobs)
        seconds, unknowns, kept = seconds_of(scene, take=taken)
        rows.append([f"{facets} facets, degree {degree}", error(kept), unknowns, seconds])
    print_table("ball on block", ("mesh", "error", "unknowns", "seconds"), rows)
    hand, uniform = ([(row[1], row[3]) for row in some] for some in (rows[-4:-2], rows[-2:]))
    for name, found, _, seconds in rows[:-4] if best is not None else ():
        log.info("%s: %.3g times the seconds of the best by hand, %.3g of uniform meshes of degree 1", name,
                 seconds / at_error(hand, found), seconds / at_error(uniform, found))  # fmt: skip
    return rows


def joined(places):
    """Rows of earlier runs, those of the same scene, quantity and target once: the later one."""
    rows = [[row[key] for key in HEAD] for row in harness.joined(places, FILE, HEAD[:3])]
    order = list(TARGETS)
    return sorted(rows, key=lambda row: (order.index(row[0]), row[1] != "energy", row[1]))


def page(rows):
    """The table as a page."""
    short = [[float(f"{value:.3g}") if isinstance(value, float) else value for value in row] for row in rows]
    return ABOUT + "\n".join(markdown(HEAD, short)) + "\n"


def run(args):
    """All rows; exit status."""
    rows, kept = joined(args.join) if args.join else [], Rows(args.o / "rows.jsonl", HEAD[:3], args.go_on)
    for name in [] if args.join else ["punch"] if args.tiny else args.scene:
        for of, error in [("energy", 0.1)] if args.tiny else TARGETS[name]:
            key = {"scene": name, "of": of, "target": error}
            row = kept.get(key, partial(told, name, of, error, args.o))
            rows.append([row[key] for key in HEAD])
            write_json(args.o / FILE, [dict(zip(HEAD, row, strict=True)) for row in rows])
    print_table("cost of named errors", HEAD, rows)
    if args.by_hand:
        write_json(args.o / "by_hand.json", by_hand(args))
    if args.publish:
        on_root(MPI.COMM_WORLD, args.publish.write_text, page(rows), "utf-8")
    log.info("most: %.3g, %.3g over runs by default",
             *(max((row[HEAD.index(one)] for row in rows), default=0.0) for one in ("cost", "over that")))  # fmt: skip
    return 0


def parser():
    """The driver's options."""
    p = study_parser(__doc__, "named_cost_results")
    add = p.add_argument
    add("--scene", nargs="*", default=list(TARGETS), choices=list(TARGETS), help="all, if nothing is said")
    add("--by-hand", action="store_true", help="Hertz's ball beside meshes made by hand")
    add("--target", type=float, nargs="+", default=[0.04], help="of the ball with --by-hand (0.04)")
    add("--against", type=Path, metavar="FILE", help="with --by-hand: the reference that errors are told by")
    add("--join", type=Path, nargs="+", metavar="DIR", help="no runs: the rows of earlier ones, the later win")
    add("--publish", type=Path, metavar="FILE", help="a page to write the table to")
    return p


if __name__ == "__main__":
    main(run, parser())
