"""Errors that are named and reached: the true error against the one named.

Every scene of `_named_scenes.py` is run with ``-error`` from its coarse mesh, for all quantities and targets. The
true error of the answer is that against the exact solution, or against one of degree 2 on the last mesh with all cells
halved, twice on small ones in the plane, with twice the load steps where these count, and a small tolerance. The energy
norm is that of elasticity, of errors and displacements, where bodies yield, too. ``--held`` runs the scenes that were
held back, ``--cost`` measures the seconds of the whole loop over those of a run of its last mesh alone, from scratch,
without estimate.

    python drivers/studies/named_error.py --scene hill -o hill
    python drivers/studies/named_error.py --scene punch -o punch
    python drivers/studies/named_error.py --join hill punch --publish docs/tables/named_error.md
"""

import time as clock
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers._common import main, make_parser, print_table, write_json
from drivers.studies import _named_page as page
from drivers.studies._named_scenes import HELD_BACK, SCENES
from drivers.studies._overkill import Overkill
from pcontact import build
from pcontact.adapt.loop import REACHED, Loop
from pcontact.adapt.variants import Last
from pcontact.assembly.error_norms import bulk_error
from pcontact.estimate.goal import value
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime.errors import InputError, StepFailure
from pcontact.runtime.options import Options
from pcontact.scene.target import Target
from pcontact.simulation import Simulation

TARGETS = (0.1, 0.05, 0.02, 0.01)
# [unknowns] Up to which cells of the reference are halved twice. From: where corners are singular, halved cells take
# too little of the error of small meshes away to stand for a solution.
SMALL = 3000
# [-] Tolerance of Newton's method for references. From: it is the smallest that the loop takes.
RTOL = 1e-9


@contextmanager
def ran(scene, mesh=None):
    """A run in memory, and the record of its last load step. *Collective.*"""
    simulation, last = Simulation(scene, mesh=mesh), Last()
    try:
        if not simulation.run(None, [last]):
            raise StepFailure(str(simulation.failure))
        yield simulation, last.record
    finally:
        simulation.free()


def reference(loop, scene):
    """A finer solution than that of a loop. *Collective.*"""
    balance = Balance(*build.balance(scene, Options()))
    n = sum(len(block.nodes) for block in loop.mesh.blocks)
    halvings = 2 if loop.passes[-1].unknowns <= SMALL and loop.mesh.dim == 2 else 1
    mesh = refine(loop.mesh, np.full(n, halvings * loop.mesh.dim), (), balance).mesh
    finer = scene.copy()
    last = loop.passes[-1]
    finer.mesh.order = mesh.degree
    if last.parts.get("load_steps", 0.0) > 0.0:
        finer.steps.count = 2 * last.steps
    finer.petsc = {**finer.petsc, "snes_rtol": f"{RTOL:g}"}
    return ran(finer, mesh)


def error_of(loop, scene, values, exact):
    """Relative error of the displacement (n_owned, d) on the last mesh in the energy norm. *Collective.*"""
    simulation = Simulation(scene, mesh=loop.mesh)
    try:
        space, bulk = simulation.problem.space, simulation.problem.bulk
        u = space.vector()
        u.setArray(values)
        error = bulk_error(space, bulk.constants, u, exact, 2 * space.degree + 2, orthotropic=bulk.orthotropic)
        return error.energy / error.energy_of_exact
    finally:
        simulation.free()


def true_error(named, loop, scene, target, values):
    """Relative error of the answer of a loop. *Collective.*"""
    if target.quantity == "energy" and named.exact is not None:
        return error_of(loop, scene, values, named.exact)
    with reference(loop, scene) as (finer, last):
        if target.quantity != "energy":
            best = value(finer.problem, target, last, finer.stepper.u)
            return abs(loop.passes[-1].quantity["value"] / best - 1.0)
        return error_of(loop, scene, values, Overkill(finer))


def expected(last):
    """The error that a pass expects, relative: of quantities with what loads and the solver lack, all with signs."""
    found = last.quantity
    if found is None or "extrapolated" not in found:
        return last.estimate
    return abs(found["extrapolated"] - found["value"]) / (abs(found["value"]) or 1.0)


def cost_of(loop, scene, seconds):
    """Seconds over those of a run on the last mesh alone. *Collective.*"""
    start = clock.perf_counter()
    with ran(scene, loop.mesh):
        return seconds / (clock.perf_counter() - start)


def measure(name, named, of, error, args):
    """A row of the table: a dict. *Collective.*"""
    scene = named.scene(args.o)
    if of.startswith("displacement:"):
        scene.output.probes = [of.partition(":")[2]]
    target, kept = Target(error, of), []
    start = clock.perf_counter()
    loop = Loop(
        replace(scene.copy(), accuracy=target),
        take=lambda run, _: kept.append(run.stepper.u.getArray(readonly=True).copy()),
    )
    outcome = loop.run()
    seconds = clock.perf_counter() - start
    row = {"scene": name, "of": of, "target": error}
    if not loop.passes or outcome.failure is not None:
        return row | {"reached": "not converged"}
    last, alone = loop.passes[-1], loop.last_scene()
    alone.output.estimate = False
    row |= {"reached": "yes" if outcome.status == REACHED else "no", "named": last.error,
            "true": true_error(named, loop, alone, target, kept[-1]), "estimate": expected(last),
            "unknowns": last.unknowns, "passes": len(loop.passes), "seconds": seconds}  # fmt: skip
    if args.cost:
        row["cost"] = cost_of(loop, alone, seconds)
    return row


def run(args):
    """All rows; exit status 1 where more than one in twenty is beyond what was named."""
    if args.join:
        return page.judged(args, page.joined(args.join))
    scenes = HELD_BACK if args.held else SCENES
    names = [name for name in (args.scene or scenes) if name in scenes]
    if len(names) != len(args.scene or names):
        raise InputError(f"command line: --scene: found {args.scene}; allowed: {', '.join(scenes)}")
    rows = []
    for name in ["rings"] if args.tiny else names:
        named = scenes[name]
        targets = [0.1] if args.tiny else [one for one in args.target if one >= named.least]
        for of in named.quantities[:1] if args.tiny else named.quantities:
            for target in targets:
                rows.append(measure(name, named, of, target, args))
                print_table("", page.HEAD, [page.line(rows[-1])])
                write_json(args.o / page.FILE, rows)
    return page.judged(args, rows)


def parser():
    """The driver's options."""
    p = make_parser(__doc__, "named_error_results")
    add = p.add_argument
    add("--scene", nargs="+", help="all, if nothing is said")
    add("--target", type=float, nargs="+", default=list(TARGETS))
    add("--held", action="store_true", help="the scenes that were held back")
    add("--cost", action="store_true", help="what reaching the error costs, too (on a quiet machine)")
    add("--join", type=Path, nargs="+", metavar="DIR", help="no runs: the rows of earlier ones, the later win")
    add("--publish", type=Path, metavar="FILE", help="a page to write the table to")
    add("--picture", type=Path, metavar="FILE", help="a picture of true errors over errors named")
    return p


if __name__ == "__main__":
    main(run, parser())
