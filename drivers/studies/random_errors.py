"""Errors that are named on scenes drawn from seeds: the true error against the one named, and what naming it costs.

`_random_scenes.py` draws the scene of a seed and the quantities whose errors are named. Each is run with ``-error`` on
one rank from its mesh to begin with, with at most `UNKNOWNS` unknowns. References come from meshes that know nothing of
the loop: graded towards vertices and, from the second one on, towards the edges of contact areas and of slip that the
one before has found, of degree 2, each finer than the one before it, until they lack less than a tenth of the smallest
target. For quantities that is the difference of the last two, or half of what it was before where that is more; for the
energy what follows from it and the difference before. What load steps lack is found on the first mesh, with twice and
four times as many. The column `reference` is the sum of both; rows for which it is more than a tenth of the target are
left out, and counted.

Rows are kept in ``errors.jsonl`` of the folder as they come, and references beside it: a run goes on where an earlier
one has ended. Scenes of seeds from 100 on are set apart for tables that are published: no choice of the program is made
on them.

    python drivers/studies/random_errors.py --seeds 0:20 --targets 5 -o DIR
    python drivers/studies/random_errors.py --table -o DIR
"""

import time as clock
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers._common import log, main, make_parser, markdown, print_table
from drivers.studies._harness import Rows, solved
from drivers.studies._named_reference import Cloud, Reference, clouds_of
from drivers.studies._random_scenes import drawn
from drivers.studies.named_error import Answer
from pcontact.adapt.loop import FAILED, REACHED, Loop
from pcontact.estimate.goal import value
from pcontact.runtime.errors import InputError, SolverError, StepFailure
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import LARGEST, QUANTITIES, Budget, Target
from pcontact.scene.validate import validate

COLUMNS = ("seed", "kind", "of", "target", "ended", "named", "true", "reference", "unknowns", "passes", "seconds",
           "cost")  # fmt: skip
# [%] Targets, and the part of one that a reference may lack.
TARGETS, PART = (10.0, 5.0, 2.0, 1.0), 0.1
# budget of a loop, in the plane and in space: a loop takes less than about 20 s on an idle machine
UNKNOWNS, SECONDS = {2: 30_000, 3: 15_000}, 300.0
# growth of cells of references with the distance from places, a mesh each; load steps where the answer depends on them;
# unknowns, and seconds of the processor, after which no finer mesh is made, which takes about four times as long
GROWTHS, LEAST_STEPS, MOST, LONG = (0.7, 0.45, 0.3, 0.2, 0.13), 4, 60_000, 10.0
# options of references
EXACT = {"pc_type": "lu", "ksp_type": "preonly", "pc_factor_mat_solver_type": "mumps", "snes_rtol": 1e-9,
         "contact_partner_rtol": 1e-4}  # fmt: skip
# places that cells are graded to, at most
PLACES = 16
# points across a depth, of Gauss's quadrature on (0, 1)
ACROSS = (np.polynomial.legendre.leggauss(4)[0] + 1.0) / 2.0, np.polynomial.legendre.leggauss(4)[1] / 2.0
FILE, COMPONENTS = "errors.jsonl", "xyz"
# the seed of the tiny run: elastic rings without friction
TINY = "219"
# what a loop may meet that is an end of it
ENDS = InputError, StepFailure, SolverError


def number(of, run, record):
    """A quantity of a run: norm or component of a force, mean displacement, largest stress."""
    word, _, name = of.partition(":")
    place, dot, axis = name.rpartition(".")
    where = {"force": "contacts", "support": "reactions"}.get(word)
    if where is None:
        return value(run.problem, Target(0.1, of), record, run.stepper.u)
    found = record[where][place if dot else name]
    force = np.asarray(found["force"] if where == "contacts" else found)
    return float(force[COMPONENTS.index(axis)]) if dot else float(np.linalg.norm(force))


def edges(run):
    """Places (n, 2) on the contacts of a run where status changes."""
    places = []
    for contact in run.problem.contacts:
        state = contact.state(run.stepper.u)
        x, status = state["x"], state["status"]
        if contact.name in [one.name for one in run.scene.contacts if one.tied] or not len(x):
            continue
        middle = x.mean(axis=0)
        along = np.linalg.svd(x - middle, full_matrices=False)[2][0]
        order = np.argsort((x - middle) @ along)
        changes = np.flatnonzero(np.diff(status[order]))
        places += [0.5 * (x[order[k]] + x[order[k + 1]]) for k in changes]
    return np.array(places).reshape(-1, 2)[:PLACES]


class Solved(NamedTuple):
    """A solution on a mesh of a reference: `clouds` and `values` as of :class:`Reference`, `at(x, body)` its
    displacement and gradient, `laws` of the bodies, and `places` to grade the next mesh to."""

    clouds: list
    values: dict
    at: Callable
    laws: list
    axisymmetric: bool
    unknowns: int
    places: np.ndarray


def run_graded(scene, graded, steps):
    """Run a scene on a mesh of a reference: a :class:`Solved`."""
    graded = graded.copy()
    graded.petsc, graded.steps.count = {**graded.petsc, **EXACT}, steps
    with log.quiet(), solved(graded, comm=MPI.COMM_SELF) as (run, record):
        answer = Answer.of(run, True)
        values = {of: number(of, run, record) for of in scene.known}
        return Solved(clouds_of(run), values, partial(answer.solution.at, near=True), answer.laws, answer.axisymmetric,
                      run.problem.space.n_dofs, edges(run))  # fmt: skip


class Lacks(NamedTuple):
    """What the load steps of a solution lack, on the first mesh: a displacement with its gradient, what it may lack
    itself, and both of quantities."""

    at: Callable
    values: dict
    error: float
    errors: dict


def steps_limit(scene, graded, first):
    """What the load steps of a first solution lack: of more of them, twice as many each time, when the error falls with
    one over their number."""
    runs = [first, *(run_graded(scene, graded, count * LEAST_STEPS) for count in (2, 4))]

    def combined(*factors):
        def at(x, body):
            found = [run.at(x, body) for run in runs]
            return [sum(factor * one[k] for factor, one in zip(factors, found, strict=True)) for k in (0, 1)]

        return at, {of: sum(factor * run.values[of] for factor, run in zip(factors, runs, strict=True))
                    for of in first.values}  # fmt: skip

    at, values = combined(-1.0, -1.0, 2.0)
    change, changes = combined(1.0, -3.0, 2.0)
    zero = replace_clouds(first, lambda one: (0.0 * one.u, 0.0 * one.slope))
    return Lacks(at, values, distance(zero, change), {of: abs(found) for of, found in changes.items()})


def replace_clouds(solved, to):
    """A solution with other values at its points."""
    return solved._replace(clouds=[one._replace(**dict(zip(("u", "slope"), to(one), strict=True)))
                                   for one in solved.clouds])  # fmt: skip


def distance(solved, at):
    """Energy norm of the difference to another displacement."""
    return float(np.sqrt(sum(cloud.distance(partial(at, body=body), solved.axisymmetric, *law) for body, (cloud, law)
                             in enumerate(zip(solved.clouds, solved.laws, strict=True)))))  # fmt: skip


def made(scene, least, folder):
    """The reference of a scene, in the plane, and its meshes until its error is below `least` or meshes are too large.

    Parameters
    ----------
    scene : drivers.studies._random_scenes.Drawn
    least : float
    folder : pathlib.Path

    Returns
    -------
    Reference
        Its error is infinite where no two meshes are solved.
    """
    best, last, places, lacks = Reference([], 1.0, np.inf, {}, 0, 0), None, (), None
    steps, rough, change, offs = LEAST_STEPS if scene.rests else 1, 0.0, 0.0, {}
    for growth in GROWTHS:
        begun = clock.process_time()
        graded = scene.graded(folder, growth, places)
        try:
            new = run_graded(scene, graded, steps)
            spent = clock.process_time() - begun
            if scene.rests and lacks is None:
                lacks = steps_limit(scene, graded, new)
        except ENDS as error:
            log.info("seed %d: reference: %s", scene.seed, error)
            break
        norm = distance(new, _nothing)
        best = Reference(new.clouds, norm, np.inf, dict.fromkeys(new.values, (0.0, np.inf)), new.unknowns, steps)
        if last is not None:
            # two meshes may agree by chance: what is off falls to a half at most
            off = {of: (found, max(abs(found - last.values[of]), 0.5 * offs.get(of, 0.0)))
                   for of, found in new.values.items()}  # fmt: skip
            offs = {of: some for of, (_, some) in off.items()}
            error = distance(new, last.at)
            rough = rough or error / norm
            # errors are at right angles to what finer meshes add: with e = r e' the change from e' to e is
            # (1 / r^2 - 1)^(1/2) e, and changes fall by the same r as errors
            fall = min(max(error / change, 0.4), 0.9) if change else 0.0
            change, error = error, error * (fall / (1.0 - fall**2) ** 0.5 if fall else 1.0)
            best = _with(best._replace(error=error, values=off), lacks, new, rough)
        last, places = new, new.places
        worst = max([best.error, *(error for _, error in best.values.values())])
        log.info("seed %d: reference: %d unknowns, %.2g of energy, %.2g of all, %.3g s", scene.seed, new.unknowns,
                 best.error, worst, spent)  # fmt: skip
        if worst < least or spent > LONG or new.unknowns > MOST:
            break
    return best


def _with(best, lacks, new, rough):
    """A reference with what its load steps lack, and relative errors; `rough`: that of the first mesh."""
    error, values = best.error, best.values
    if lacks is not None:
        # what is known on the first mesh has the error of that mesh
        zero = replace_clouds(new, lambda one: (0.0 * one.u, 0.0 * one.slope))
        error += lacks.error + distance(zero, lacks.at) * rough
        values = {of: (found + lacks.values[of], off + lacks.errors[of] + abs(lacks.values[of]) * rough)
                  for of, (found, off) in values.items()}  # fmt: skip
        more = [lacks.at(one.x, body) for body, one in enumerate(new.clouds)]
        new = new._replace(clouds=[one._replace(u=one.u + u, slope=one.slope + slope)
                                   for one, (u, slope) in zip(new.clouds, more, strict=True)])  # fmt: skip
    norm = distance(new, _nothing)
    values = {of: (found, off / max(abs(found), 1e-300)) for of, (found, off) in values.items()}
    return best._replace(clouds=new.clouds, norm=norm, error=error / norm, values=values)


def _nothing(x, body=0):
    return 0.0 * x, np.zeros((*x.shape, x.shape[1]))


def deep(best, depth):
    """The same solution in a geometry with a depth."""
    (z, weight), clouds = ACROSS, []
    for cloud in best.clouds:
        n, points = len(cloud.x), len(z)
        slope = np.zeros((points * n, 3, 3))
        slope[:, :2, :2] = np.tile(cloud.slope, (points, 1, 1))
        x, u = (np.column_stack([np.tile(one, (points, 1)), third])
                for one, third in ((cloud.x, np.repeat(depth * z, n)), (cloud.u, np.zeros(points * n))))  # fmt: skip
        clouds.append(Cloud(x, u, slope, np.outer(depth * weight, cloud.weight).ravel()))
    values = {of: (found * (depth if of.startswith(("force", "support")) else 1.0), error)
              for of, (found, error) in best.values.items()}  # fmt: skip
    return best._replace(clouds=clouds, norm=best.norm * depth**0.5, values=values)


def reference(scene, target, folder):
    """The reference of a scene for a target [%], from an earlier run where there is one."""
    path = folder / f"reference_{scene.seed}_{target:g}.npz"
    if not path.exists():
        made(scene, PART * target / 100.0, folder).write(path)
    best = Reference.read(path)
    return deep(best, scene.depth) if scene.depth else best


def measured(scene, of, target, args):
    """A row: a loop, and runs on its last mesh by default settings and by those of its last pass, whose error is the
    true one."""
    best, folder = reference(scene, min(args.targets), args.o), args.o
    row, begun = {"seed": scene.seed, "kind": scene.kind, "of": of, "target": target}, scene.begun(folder)
    if of.partition(":")[0] not in QUANTITIES:
        return row | {"ended": "refused: no such quantity"}
    known = (None, best.error) if of == "energy" else best.values.get(of, (0.0, np.inf))
    row["reference"] = known[1]
    if not known[1] <= PART * target / 100.0:
        return row | {"ended": "no reference"}
    accuracy = Target(target / 100.0, of, budget=Budget(unknowns=UNKNOWNS[3 if scene.depth else 2], time=SECONDS))
    try:
        validate(replace(begun.copy(), accuracy=accuracy))
        # kernels are loaded outside of the clock
        with log.quiet():
            Loop(replace(begun, accuracy=Target(LARGEST)), MPI.COMM_SELF).run()
            start = clock.process_time()
            loop = Loop(replace(begun.copy(), accuracy=accuracy), MPI.COMM_SELF)
            outcome = loop.run()
    except ENDS as error:
        return row | {"ended": f"refused: {error}"}
    row["seconds"] = clock.process_time() - start
    if not loop.passes:
        return row | {"ended": f"failed: {outcome.failure}"}
    last = loop.passes[loop.best - 1]
    ended = {REACHED: "reached", FAILED: f"failed: {outcome.failure}"}.get(outcome.status, loop._decision.why)
    row |= {"ended": ended, "named": last.error, "unknowns": last.unknowns, "passes": len(loop.passes)}
    usual = replace(begun.copy(), accuracy=None)
    usual.steps.count, usual.mesh.order, usual.output.estimate = last.steps, last.degree, False
    loop.mesh.pieces.clear()
    start = clock.process_time()
    with log.quiet(), solved(usual, loop.mesh, MPI.COMM_SELF):
        row["cost"] = row["seconds"] / (clock.process_time() - start)
    own = loop.best_scene()
    own.output.estimate = False
    with log.quiet(), solved(own, loop.mesh, MPI.COMM_SELF) as (run, record):
        # over what the run has found, as errors are named
        if of == "energy":
            answer = Answer.of(run, True)
            bodies = answer.axisymmetric, answer.laws
            size = best._replace(clouds=clouds_of(run)).distance(_nothing, *bodies)
            row["true"] = best.distance(partial(answer.solution.at, near=True), *bodies) / size
        else:
            found = number(of, run, record)
            row["true"] = abs(found - known[0]) / max(abs(found), 1e-300)
    return row


def tables(rows):
    """Titles, headers and rows of tables: what rows say together, and all of them."""
    lines, ends = [], {}
    for row in rows:
        word = row["ended"].partition(":")[0]
        ends[word] = ends.get(word, 0) + 1
    for name, some in (("all", lambda _: True), ("energy", lambda row: row["of"] == "energy"),
                       ("quantities", lambda row: row["of"] != "energy"),
                       ("reached", lambda row: row["ended"] == "reached"),
                       *((f"{t:g} %", lambda row, t=t: row["target"] == t) for t in TARGETS)):  # fmt: skip
        told = [row for row in rows if "true" in row and some(row)]
        if told:
            ratio = np.array([row["true"] / max(row["named"], 1e-300) for row in told])
            over, cost = 1.0 / np.maximum(ratio, 1e-12), np.array([row["cost"] for row in told])
            figures = [np.mean(ratio <= 1.0), np.mean(ratio > 1.5), ratio.max(), *np.quantile(over, (0.5, 0.9)),
                       *np.quantile(cost, (0.5, 0.9))]  # fmt: skip
            lines.append([name, len(told), *(_short(float(one)) for one in figures)])
    yield ("true and named errors", ("", "rows", "true <= named", "> 1.5 named", "largest true/named",
           "named/true median", "90 %", "cost median", "90 %"), lines)  # fmt: skip
    yield "ends", ("", "rows"), sorted(ends.items())
    far = [row for row in rows if "true" in row and row["true"] > row["named"]]
    for title, some in (("true above the one named", far), ("all rows", rows)):
        yield title, COLUMNS, [[_short(row.get(key)) for key in COLUMNS] for row in some]


PAGE = """# Errors named on scenes drawn from seeds

`python drivers/studies/random_errors.py --seeds ... -o DIR --publish docs/tables/random_errors.md` writes this page;
the driver's head says how scenes and references are made. Errors, named and true ones, are parts of what the run has
found. `reference` is what the reference may lack; rows for which that is more than a tenth of the target end with
*no reference*. `cost` is the processor time of the whole loop over that of one run on the last mesh by default
settings, of the same degree and with the same load steps, both on one rank; `true` the error of the last pass. Loops
end at 30,000 unknowns in the plane, 15,000 in space, and 300 s of the clock. Seeds are 200 and up: no choice was made
on them, and each row was run once, on a busy machine.
"""


def written(path, rows):
    """Write the page of the tables."""
    lines = PAGE.splitlines()
    for title, header, some in tables(rows):
        lines += ["", f"## {title[:1].upper()}{title[1:]}", "", *markdown(header, some)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _short(cell):
    return "-" if cell is None else float(f"{cell:.3g}") if isinstance(cell, float) else str(cell)[:100]


def seeds(words):
    """Seeds that words name, as 7 or 0:20."""
    found = []
    for word in words:
        first, _, last = word.partition(":")
        try:
            found += range(int(first), int(last or int(first) + 1))
        except ValueError:
            raise InputError(f"command line: --seeds: found {word!r}, allowed: as 7 or 0:20") from None
    return found


def run(args):
    """Rows that are missing, or the table: on the first rank."""
    on_root(MPI.COMM_WORLD, _run, args)
    return 0


def _run(args):
    rows = Rows(args.o / FILE, ("seed", "of", "target"), comm=MPI.COMM_SELF)
    if args.tiny:
        args.seeds, args.targets = [TINY], TARGETS[:1]
    for seed in () if args.table else seeds(args.seeds):
        scene = drawn(seed)
        for of, target in product(scene.quantities, args.targets):
            row = rows.get({"seed": seed, "of": of, "target": target}, partial(measured, scene, of, target, args))
            log.info("%s", ", ".join(f"{key} {_short(row[key])}" for key in COLUMNS if key in row))
    found = sorted(rows, key=lambda row: (row["seed"], row["of"] != "energy", row["of"], -row["target"]))
    for one in tables(found):
        print_table(*one)
    if args.publish is not None:
        written(args.publish, found)


def parser():
    """The driver's options."""
    p = make_parser(__doc__, str(Path.home() / "pcontact_random_errors"))
    p.add_argument("--seeds", nargs="+", default=["0:20"], metavar="A:B", help="of the scenes, B is left out (0:20)")
    p.add_argument("--targets", type=float, nargs="+", default=list(TARGETS), metavar="PERCENT")
    p.add_argument("--table", action="store_true", help="no runs: what the rows say")
    p.add_argument("--publish", type=Path, metavar="FILE", help="the tables are written there, too")
    return p


if __name__ == "__main__":
    main(run, parser())
