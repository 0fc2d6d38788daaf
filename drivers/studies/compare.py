"""Nitsche's method, penalty and augmented Lagrangian on one problem, over eight decades of gamma0 and three meshes.

    mpirun -n 2 python drivers/studies/compare.py -o compare
    mpirun -n 2 python drivers/studies/compare.py -o compare --order 2 --facets 3 6 12
    mpirun -n 2 python drivers/studies/compare.py -o compare --friction
    python drivers/studies/compare.py -o compare --publish docs/tables/formulations.md

A cylinder is pressed on a block by a force, in plane strain, see `drivers/cases/hertz.py`: the closed form is Hertz's
for that force. All formulations act at the same quadrature points and find the same partners; Nitsche's traction is
that of the source, as in the literature compared. Columns: penetration, the deepest over the approach of the bodies;
error, that of the contact pressure in L2 over the norm of Hertz's;
oscillation, what is left of it inside 0.9 half widths when the nearest smooth profile is taken away; balance, contact
force minus applied force over the applied one; Newton and Krylov iterations and updates of multipliers of the run;
condition, an estimate of that of the last tangent (largest over smallest singular value); seconds of the load steps by
the clock, and with the set-up of the processor on all ranks. A dash: the run did not converge; its cause is in the JSON
and below the table.

With --friction two cylinders are pressed together and then sheared, after Cattaneo and Mindlin, see
`drivers/cases/cattaneo_mindlin.py`. There the columns of the tangential traction are ``tangential``, its error in L2
over the norm of the closed form for the force that presses, and ``ripple``, its oscillation: what is left of it in the
stick zone and in the slip zones, a tenth at their edges left out, when the nearest smooth profile of each is taken
away.

Runs of one degree (--order) and problem replace those of the same kind in compare.json, and leave the others.
--publish puts tables and plots of compare.json into a document.
"""

import time as clock
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from drivers._common import contact_points, log, main, running, write_json
from drivers.cases import cattaneo_mindlin as mindlin
from drivers.cases.hertz import CASES, generate
from drivers.studies import _harness as harness
from drivers.studies._compare_report import METHODS, SHEARED, document, plots, report
from drivers.studies._condition import condition
from drivers.studies._harness import Counts, Rows, composed, results, study_parser
from pcontact.contact.formulation.methods import coercive
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Load, Material, MeshSpec, Output, Scene, Steps

CASE = CASES["cylinder_on_block"]
MEASURES = ("penetration", "error", "oscillation", "balance", "tangential", "ripple")
COUNTS = ("newton", "krylov", "updates", "condition", "seconds", "cpu")
FREE, INNER = "free", 0.9
# of the sheared cylinders: coefficient of friction, load steps that press and that shear, largest gamma0, a decade each
FRICTION, PRESSING, SHEARING, DECADES = 0.2, 6, 3, 4
MARK = "<!-- What follows is written by drivers/studies/compare.py with the option publish. -->"


def make_scene(mesh: Path, name: str, gamma0: float, order: int) -> Scene:
    """The scene of one run: the load in one step, and one more in which the search is renewed."""
    formulation, theta, _ = METHODS[name]
    source, target = CASE.skins
    return composed(
        MeshSpec(mesh, order=order),
        dict.fromkeys((CASE.upper, CASE.lower), Material(CASE.E, CASE.nu)),
        {"symmetry_x": [0.0, FREE], CASE.held: [FREE, 0.0]},
        contacts=[Contact(source, target, name="pair", formulation=formulation, theta=theta, gamma0=gamma0,
                          traction="source")],
        loads=[Load(CASE.driven, pressure=CASE.pressure, amplitude=[[0.0, 0.0], [1.0, 1.0], [2.0, 1.0]])],
        # what does not converge in a step and a quarter of it is given up
        steps=Steps(end=2.0, count=2, min_step=0.25),
        output=Output(fields=False, probes=[CASE.driven]),
        title=f"{name}, gamma0 {gamma0:g}",
        # what a gamma0 does is the question here
        allow_unsafe=["gamma0"],
    )


def sheared_scene(mesh: Path, name: str, gamma0: float, order: int) -> Scene:
    """The scene of a run with friction."""
    formulation, theta, _ = METHODS[name]
    args = SimpleNamespace(order=order, mu=FRICTION, gamma0=gamma0, displacement=mindlin.DISPLACEMENT, press=PRESSING,
                           steps=SHEARING, fields=False)  # fmt: skip
    scene, plain = mindlin.make_scene(mesh, args, theta), make_scene(mesh, name, gamma0, order)
    scene.contacts[0].formulation, scene.contacts[0].traction = formulation, "source"
    scene.title, scene.allow_unsafe, scene.petsc = plain.title, plain.allow_unsafe, plain.petsc
    scene.steps.min_step = 0.25
    return scene


def smooth(s: np.ndarray, p: np.ndarray, weight: np.ndarray, inner: float = 0.0) -> np.ndarray:
    """The nearest smooth profile: Hertz's, wider or narrower, or a parabola (the overlap, of which penalty makes it);
    in a stick zone of the half width `inner` (over Hertz's) its own of both, too.

    Parameters
    ----------
    s, p, weight : ndarray (n,)
        Distance from the axis over Hertz's half width, below 1; contact pressure [stress]; area of the points.
    """
    hertz = np.sqrt(1.0 - s**2)
    stick = [np.sqrt(1.0 - (s / inner) ** 2)] if inner else []
    shapes, root = np.column_stack([hertz, hertz * s**2, np.ones_like(s), s**2, *stick]), np.sqrt(weight)
    return shapes @ np.linalg.lstsq(shapes * root[:, None], p * root, rcond=None)[0]


def measure(points: dict[str, np.ndarray], record: dict) -> dict[str, float]:
    """Deviations of a solution from Hertz's for the applied force, see the head of this module."""
    a, p0 = CASE.from_force(CASE.force)
    r, p, weight = np.abs(points["x"][:, 0]), points["pressure"], points["weight"]
    hertz = p0 * np.sqrt(np.maximum(1.0 - (r / a) ** 2, 0.0))
    closed, inside = points["status"] > 0, r < INNER * a
    wave = p[inside] - smooth(r[inside] / a, p[inside], weight[inside])
    norm = np.sqrt(np.sum(weight * hertz**2))
    force = CASE.copies * abs(record["contacts"]["pair"]["force"][1])
    approach = abs(record["probes"][CASE.driven]["mean"][1])
    return {
        "penetration": float(np.max(-points["gap"][closed], initial=0.0) / approach),
        "error": float(np.sqrt(np.sum(weight * (p - hertz) ** 2)) / norm),
        "oscillation": float(np.sqrt(np.sum(weight[inside] * wave**2)) / norm),
        "balance": abs(force / CASE.force - 1.0),
    }


def measure_sheared(points: dict[str, np.ndarray], record: dict) -> dict[str, float]:
    """Deviations of a solution from Cattaneo's and Mindlin's, see the head of this module."""
    load, shear = -record["reactions"]["upper_flat"][1], record["contacts"]["skins"]["force"][0]
    a, p0 = mindlin.CASE.from_force(load)
    c, _, tangential = mindlin.closed_form(points["x"], load, mindlin.FORCE, FRICTION)
    r, weight, found = np.abs(points["x"]), points["weight"], points["tangential"]
    hertz, norm = p0 * np.sqrt(np.maximum(1.0 - (r / a) ** 2, 0.0)), np.sqrt(np.sum(weight * tangential**2))
    left = 0.0
    for zone, inner in ((r < INNER * c, c / a), ((r > (2.0 - INNER) * c) & (r < INNER * a), 0.0)):
        wave = found[zone] - smooth(r[zone] / a, found[zone], weight[zone], inner)
        left += np.sum(weight[zone] * wave**2)
    inside = r < INNER * a
    wave = points["pressure"][inside] - smooth(r[inside] / a, points["pressure"][inside], weight[inside])
    return {
        "error": float(np.sqrt(np.sum(weight * (points["pressure"] - hertz) ** 2) / np.sum(weight * hertz**2))),
        "oscillation": float(np.sqrt(np.sum(weight[inside] * wave**2) / np.sum(weight * hertz**2))),
        "balance": abs(shear / mindlin.FORCE - 1.0),
        "tangential": float(np.sqrt(np.sum(weight * (found - tangential) ** 2)) / norm),
        "ripple": float(np.sqrt(left) / norm),
    }  # fmt: skip


def is_coercive(name: str, gamma0: float) -> bool:
    """Tell whether gamma0 is not below the bound of coercivity of a formulation; penalty and multipliers have none."""
    formulation, theta, *_ = METHODS[name]
    return formulation != "nitsche" or gamma0 >= coercive(theta)


def solve(mesh: Path, name: str, gamma0: float, order: int, sheared: bool = False) -> dict:
    """One run, of the sheared cylinders or of the one that is pressed. *Collective.*

    Returns
    -------
    dict
        ``method``, ``gamma0``, ``coercive``, ``converged``, ``cause`` (of a run that did not), measures and counts; the
        same on every rank.
    """
    totals = Counts()
    build, points_of, tell = (sheared_scene, mindlin.points_of, measure_sheared) if sheared else (
        make_scene, contact_points, measure)  # fmt: skip
    row = {"method": name, "gamma0": gamma0, "coercive": is_coercive(name, gamma0), "converged": False, "cause": ""}
    row.update(dict.fromkeys((*MEASURES, *COUNTS), float("nan")))
    start, work = clock.perf_counter(), clock.process_time()
    try:
        with running(build(mesh, name, gamma0, order), None, [totals]) as (simulation, converged):
            row["converged"], row["unknowns"] = converged, simulation.problem.space.n_dofs
            if not converged:
                row["cause"] = totals.cause
                return row
            cpu = MPI.COMM_WORLD.allreduce(clock.process_time() - work)
            row.update({key: getattr(totals, key) for key in ("newton", "krylov", "updates")})
            row.update(cpu=cpu, seconds=clock.perf_counter() - start - simulation.timing["setup"])
            points = points_of(simulation)
            found = None if points is None else tell(points, totals.record)
            row.update(simulation.comm.bcast(found, root=0))
            simulation.problem.tangent(simulation.stepper.u)
            row["condition"] = condition(simulation.problem.matrix.matrix)
    except InputError as error:
        # what the program refuses is an answer, too
        row["cause"] = f"refused: {error}"
    return row


def earlier(path: Path, order: int, case: str) -> list[dict]:
    """Rows of an earlier sweep with another degree or problem. *Collective.*"""
    rows = load(path)["runs"] if MPI.COMM_WORLD.bcast(path.exists()) else []
    return [row for row in rows if (row["order"], row["case"]) != (order, case)]


def load(path: Path) -> dict:
    """Load the rows of earlier sweeps. *Collective.*

    Raises
    ------
    InputError
    """
    data = results(path, "command line: -o", ("commands", "ranks", "runs"))
    rows = [{k: float("nan") if v is None else v for k, v in row.items()} for row in data["runs"]]
    return {**data, "runs": [{"case": "", **row} for row in rows]}


def sweep(args) -> int:
    """All runs of a degree; 1 where none of a formulation converged on a mesh."""
    case = SHEARED if args.friction else ""
    facets, decades = args.facets[:1] if args.tiny else args.facets, DECADES if args.friction else args.decades
    values = args.lowest * 10.0 ** np.arange(decades + 1) if not args.tiny else [1.0, 100.0]
    path = args.o / "compare.json"
    others = [] if args.tiny else earlier(path, args.order, case)
    said = load(path)["commands"] if others else {}
    said = {**said, f"{args.order}{case}": harness.command()}
    head = {"case": "cylinder_on_block", "commands": said, "ranks": MPI.COMM_WORLD.size}
    rows, good = [], True
    kept = Rows(args.o / "rows.jsonl", ("case", "order", "facets", "method", "gamma0"), args.go_on)
    for count in facets:
        path_of = args.o / f"cylinder{case}_{args.order}_{count}.msh"
        if args.friction:
            fine = SimpleNamespace(h=mindlin.CASE.half_width / count, order=args.order)
            mesh = mindlin.generate(path_of, fine)
        else:
            mesh = generate(CASE, path_of, CASE.half_width / count, args.order)
        if not rows:
            solve(mesh, "theta 0", 1.0, args.order, args.friction)  # kernels are loaded outside the clock
        for method in METHODS:
            keys = {"case": case, "order": args.order, "facets": count, "method": method}
            found = [
                kept.get({**keys, "gamma0": float(gamma0)},
                         partial(solve, mesh, method, float(gamma0), args.order, args.friction))
                for gamma0 in values
            ]  # fmt: skip
            rows += found
            good &= any(row["converged"] for row in found)
            # at once: a sweep that is killed leaves what it has
            write_json(path, {**head, "runs": sorted(others + rows, key=lambda row: row["order"])})
    report(rows)
    on_root(MPI.COMM_WORLD, plots, args.o, rows)
    log.info("table and plots of %d runs in %s", len(rows), args.o)
    return 0 if good else 1


def publish(args) -> int:
    """Put tables and plots of earlier sweeps into a document, in place of what follows its line `MARK`.

    Raises
    ------
    InputError
        The document has no such line, or cannot be read.
    """
    data = load(args.o / "compare.json")

    def write():
        pictures = plots(args.o, data["runs"])
        harness.publish(args.publish, MARK, document(data), [(path, path.name) for path in pictures])

    on_root(MPI.COMM_WORLD, write)
    return 0


def run(args) -> int:
    """The sweep, or the document."""
    if args.decades < 1 or min(args.facets) < 2:
        raise InputError("command line: --decades and --facets: found less than 1 and 2, allowed: more")
    return publish(args) if args.publish is not None else sweep(args)


def make_options():
    """The parser of this driver."""
    parser = study_parser(__doc__, "compare_results")
    add = parser.add_argument
    add("--facets", type=int, nargs="+", default=[5, 10, 20], help="facets in the half width of the contact, each mesh")
    add("--lowest", type=float, default=1e-2, help="smallest gamma0 (0.01)")
    add("--decades", type=int, default=8, help="powers of ten above it (8)")
    add("--order", type=int, choices=(1, 2), default=1, help="degree of displacement and geometry")
    add("--friction", action="store_true", help="two cylinders with friction, pressed and sheared")
    add("--publish", type=Path, metavar="FILE", help="tables and plots of the sweeps in -o into this document")
    return parser


if __name__ == "__main__":
    main(run, make_options())
