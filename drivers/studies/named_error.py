"""Errors that are named and reached: the true error against the one named, and what reaching it costs.

Every scene of `_named_scenes.py` is run with ``-error`` from its coarse mesh, for all quantities and targets. The
true error is that against the exact solution, or against one of degree 2 on the last mesh with all cells halved, twice
on small ones in the plane, and twice the load steps. Cost: seconds of the whole loop over those of a run of its last
mesh alone, from scratch, without estimate. ``--held`` runs the scenes that were held back.
"""

import time as clock
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from drivers._common import log, main, make_parser, markdown, print_table, write_json
from drivers.studies._named_scenes import HELD_BACK, SCENES
from drivers.studies._overkill import Overkill
from pcontact import build
from pcontact.adapt.loop import REACHED, Loop
from pcontact.adapt.variants import Last
from pcontact.assembly.error_norms import bulk_error
from pcontact.estimate.goal import value
from pcontact.material.elastic import in_plane, lame
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime.errors import InputError, StepFailure
from pcontact.runtime.options import Options
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Target
from pcontact.simulation import Simulation

TARGETS = (0.1, 0.05, 0.02, 0.01)
# [unknowns] Up to which cells of the reference are halved twice. From: where corners are singular, halved cells take
# too little of the error of small meshes away to stand for a solution.
SMALL = 3000
HEAD = ("scene", "of", "target", "reached", "named", "true", "true/named", "estimate/true", "unknowns", "passes",
        "seconds", "cost")  # fmt: skip


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
    finer.mesh.order, finer.steps.count = mesh.degree, 2 * loop.passes[-1].steps
    return ran(finer, mesh)


def true_error(named, loop, scene, target, single, record):
    """Relative error of the run on the last mesh. *Collective.*"""
    materials = [scene.materials[body.material] for body in scene.bodies]
    constants = [in_plane(*lame(one.E, one.nu), scene.mesh.kinematics) for one in materials]
    space, u = single.problem.space, single.stepper.u
    if target.quantity == "energy" and named.exact is not None:
        error = bulk_error(space, constants, u, named.exact)
        return error.energy / error.energy_of_exact
    own = value(single.problem, target, record, u) if target.quantity != "energy" else None
    with reference(loop, scene) as (finer, last):
        if own is not None:
            best = value(finer.problem, target, last, finer.stepper.u)
            return abs(own / best - 1.0)
        error = bulk_error(space, constants, u, Overkill(finer), 2 * space.degree)
        return error.energy / error.energy_of_exact


def expected(last):
    """The error that a pass expects, relative: of quantities that of what loads lack, too, with its sign."""
    found = last.quantity
    if found is None or "extrapolated" not in found:
        return last.estimate
    return abs(found["extrapolated"] - found["value"]) / (abs(found["value"]) or 1.0)


def measure(name, named, of, error, folder):
    """A row of the table. *Collective.*"""
    scene = named.scene(folder)
    if of.startswith("displacement:"):
        scene.output.probes = [of.partition(":")[2]]
    target = Target(error, of)
    start = clock.perf_counter()
    loop = Loop(replace(scene.copy(), accuracy=target))
    outcome = loop.run()
    seconds = clock.perf_counter() - start
    if not loop.passes or outcome.failure is not None:
        return [name, of, error, "not converged", *[float("nan")] * 8]
    last, alone = loop.passes[-1], loop.last_scene()
    alone.output.estimate = False
    start = clock.perf_counter()
    with ran(alone, loop.mesh) as (single, record):
        cost = seconds / (clock.perf_counter() - start)
        true = true_error(named, loop, alone, target, single, record)
    return [name, of, error, "yes" if outcome.status == REACHED else "no", last.error, true, true / last.error,
            expected(last) / true, last.unknowns, len(loop.passes), seconds, cost]  # fmt: skip


def run(args):
    """All rows; exit status 1 where more than one in twenty is beyond what was named."""
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
                rows.append(measure(name, named, of, target, args.o))
                print_table("", HEAD, rows[-1:])
                write_json(args.o / "named_error.json", [dict(zip(HEAD, row, strict=True)) for row in rows])
    print_table("named errors", HEAD, rows)
    beyond = [row for row in rows if not row[6] <= 1.0]
    log.info("%d of %d errors are larger than named", len(beyond), len(rows))
    if args.publish is not None:
        text = "\n".join(["# Errors that were named, and true ones", "", *markdown(HEAD, rows), ""])
        on_root(MPI.COMM_WORLD, args.publish.write_text, text)
    return 0 if len(beyond) <= 0.05 * len(rows) else 1


def parser():
    """The driver's options."""
    p = make_parser(__doc__, "named_error_results")
    add = p.add_argument
    add("--scene", nargs="+", help="all, if nothing is said")
    add("--target", type=float, nargs="+", default=list(TARGETS))
    add("--held", action="store_true", help="the scenes that were held back")
    add("--publish", type=type(p.get_default("o")), help="a page to write the table to")
    return p


if __name__ == "__main__":
    main(run, parser())
