"""Nitsche's method, penalty and augmented Lagrangian on one problem, over eight decades of gamma0 and three meshes.

    mpirun -n 2 python drivers/studies/compare.py -o compare
    mpirun -n 2 python drivers/studies/compare.py -o compare --order 2 --facets 3 6 12
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

Runs of one degree (--order) replace those of the same degree in compare.json, and leave those of the other.
--publish puts tables and plots of compare.json into a document.
"""

import json
import shutil
import sys
import time as clock
from pathlib import Path

import numpy as np

from drivers._common import contact_points, log, main, make_parser, running, write_json
from drivers.cases.hertz import CASES, generate
from drivers.studies._compare_report import METHODS, document, plots, report
from drivers.studies._condition import condition
from pcontact.contact.formulation.parameters import coercive
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps

CASE = CASES["cylinder_on_block"]
MEASURES = ("penetration", "error", "oscillation", "balance")
COUNTS = ("newton", "krylov", "updates", "condition", "seconds", "cpu")
FREE, INNER = "free", 0.9
MARK = "<!-- What follows is written by drivers/studies/compare.py with the option publish. -->"


def make_scene(mesh: Path, name: str, gamma0: float, order: int) -> Scene:
    """The scene of one run: the load in one step, and one more in which the search is renewed."""
    formulation, theta, _ = METHODS[name]
    source, target = CASE.skins
    return Scene(
        mesh=MeshSpec(mesh, order=order),
        materials={"elastic": Material(CASE.E, CASE.nu)},
        bodies=[Body(CASE.upper, "elastic"), Body(CASE.lower, "elastic")],
        contacts=[Contact(source, target, name="pair", formulation=formulation, theta=theta, gamma0=gamma0,
                          traction="source")],
        displacements=[Displacement("symmetry_x", [0.0, FREE]), Displacement(CASE.held, [FREE, 0.0])],
        loads=[Load(CASE.driven, pressure=CASE.pressure, amplitude=[[0.0, 0.0], [1.0, 1.0], [2.0, 1.0]])],
        # what does not converge in a step and a quarter of it is given up
        steps=Steps(end=2.0, count=2, min_step=0.25),
        output=Output(fields=False, probes=[CASE.driven]),
        title=f"{name}, gamma0 {gamma0:g}",
        # what a gamma0 does is the question here
        allow_unsafe=["gamma0"],
        petsc={"contact_uzawa_grow": "false", "contact_uzawa_accept": "true"} if "augmented" in formulation else {},
    )


class Totals(Observer):
    """Observer: iterations of the run, the last record, and why the last attempt of a load step failed."""

    def __init__(self):
        self.counts, self.record, self.cause = dict.fromkeys(("newton", "krylov", "updates"), 0), None, ""

    def step(self, step, u, record):
        """Add a step."""
        self.record = record
        self.counts["newton"] += record["newton"]
        self.counts["krylov"] += record["krylov"]
        self.counts["updates"] += record.get("uzawa", {"updates": 0})["updates"]

    def cut(self, target, result):
        """Keep the cause: the run goes on, or ends."""
        self.cause = f"step to time {target:g}: {result.reason} after {result.newton} iterations"


def smooth(s: np.ndarray, p: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The nearest smooth profile: Hertz's, wider or narrower, or a parabola (the overlap, of which penalty makes it).

    Parameters
    ----------
    s, p, weight : ndarray (n,)
        Distance from the axis over Hertz's half width, below 1; contact pressure [stress]; area of the points.
    """
    hertz = np.sqrt(1.0 - s**2)
    shapes, root = np.column_stack([hertz, hertz * s**2, np.ones_like(s), s**2]), np.sqrt(weight)
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


def is_coercive(name: str, gamma0: float) -> bool:
    """Whether gamma0 is not below the bound of coercivity of a formulation; penalty and multipliers have none."""
    formulation, theta, *_ = METHODS[name]
    return formulation != "nitsche" or gamma0 >= coercive(theta)


def solve(mesh: Path, name: str, gamma0: float, order: int) -> dict:
    """One run. *Collective.*

    Returns
    -------
    dict
        ``method``, ``gamma0``, ``coercive``, ``converged``, ``cause`` (of a run that did not), measures and counts; the
        same on every rank.
    """
    totals = Totals()
    row = {"method": name, "gamma0": gamma0, "coercive": is_coercive(name, gamma0), "converged": False, "cause": ""}
    row.update(dict.fromkeys((*MEASURES, *COUNTS), float("nan")))
    start, work = clock.perf_counter(), clock.process_time()
    try:
        with running(make_scene(mesh, name, gamma0, order), None, [totals]) as (simulation, converged):
            row["converged"], row["unknowns"] = converged, simulation.problem.space.n_dofs
            if not converged:
                row["cause"] = totals.cause
                return row
            cpu = MPI.COMM_WORLD.allreduce(clock.process_time() - work)
            row.update(totals.counts, cpu=cpu, seconds=clock.perf_counter() - start - simulation.timing["setup"])
            points = contact_points(simulation)
            found = None if points is None else measure(points, totals.record)
            row.update(simulation.comm.bcast(found, root=0))
            simulation.problem.tangent(simulation.stepper.u)
            row["condition"] = condition(simulation.problem.matrix.matrix)
    except InputError as error:
        # what the program refuses is an answer, too
        row["cause"] = f"refused: {error}"
    return row


def earlier(path: Path, order: int) -> list[dict]:
    """Rows of an earlier sweep with another degree. *Collective.*"""
    rows = load(path)["runs"] if MPI.COMM_WORLD.bcast(path.exists()) else []
    return [row for row in rows if row["order"] != order]


def load(path: Path) -> dict:
    """What earlier sweeps left. *Collective.*

    Raises
    ------
    InputError
    """

    def read():
        try:
            data = json.loads(path.read_text())
            rows = [{k: float("nan") if v is None else v for k, v in row.items()} for row in data["runs"]]
            return {"commands": data["commands"], "ranks": data["ranks"], "runs": rows}
        except (OSError, ValueError, KeyError, TypeError) as error:
            text = f"{path}: found {type(error).__name__}, allowed: the file of an earlier sweep, see -o"
            raise InputError(text) from None

    return MPI.COMM_WORLD.bcast(on_root(MPI.COMM_WORLD, read))


def sweep(args) -> int:
    """All runs of a degree; 1 where none of a formulation converged on a mesh."""
    facets, decades = (args.facets[:1], 3) if args.tiny else (args.facets, args.decades)
    values = args.lowest * 10.0 ** np.arange(decades + 1) if not args.tiny else [1.0, 100.0]
    path = args.o / "compare.json"
    others = [] if args.tiny else earlier(path, args.order)
    said = load(path)["commands"] if others else {}
    command = "mpirun -n N python drivers/" + " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])
    head = {"case": "cylinder_on_block", "commands": {**said, str(args.order): command}, "ranks": MPI.COMM_WORLD.size}
    rows, good = [], True
    for count in facets:
        name = f"cylinder_{args.order}_{count}.msh"
        mesh = generate(CASE, args.o / name, CASE.half_width / count, args.order)
        if not rows:
            solve(mesh, "theta 0", 1.0, args.order)  # kernels are loaded outside the clock
        for method in METHODS:
            found = [
                {"order": args.order, "facets": count, **solve(mesh, method, float(gamma0), args.order)}
                for gamma0 in values
            ]
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
        try:
            head, mark, _ = args.publish.read_text().partition(MARK)
        except OSError as error:
            raise InputError(f"command line: --publish {args.publish}: found {error.strerror}") from None
        if not mark:
            raise InputError(f"{args.publish}: found no line {MARK!r}, allowed: a document with one")
        pictures = plots(args.o, data["runs"])
        for path in pictures:
            shutil.copy(path, args.publish.parent / path.name)
        args.publish.write_text(f"{head}{MARK}\n\n{document(data, pictures)}")

    on_root(MPI.COMM_WORLD, write)
    return 0


def run(args) -> int:
    """The sweep, or the document."""
    if args.decades < 1 or min(args.facets) < 2:
        raise InputError("command line: --decades and --facets: found less than 1 and 2, allowed: more")
    return publish(args) if args.publish is not None else sweep(args)


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "compare_results")
    add = parser.add_argument
    add("--facets", type=int, nargs="+", default=[5, 10, 20], help="facets in the half width of the contact, each mesh")
    add("--lowest", type=float, default=1e-2, help="smallest gamma0 (0.01)")
    add("--decades", type=int, default=8, help="powers of ten above it (8)")
    add("--order", type=int, choices=(1, 2), default=1, help="degree of displacement and geometry")
    add("--publish", type=Path, metavar="FILE", help="tables and plots of the sweeps in -o into this document")
    return parser


if __name__ == "__main__":
    main(run, make_options())
