"""Nitsche's method, penalty and augmented Lagrangian on one problem, over eight decades of gamma0 and three meshes.

    mpirun -n 2 python drivers/compare.py -o compare

A cylinder is pressed on a block by a force, in plane strain, see `drivers/hertz.py`: the closed form is Hertz's for
that force. All formulations act at the same quadrature points and find the same partners. Columns: penetration, the
deepest over the approach of the bodies; error, that of the contact pressure in L2 over the norm of Hertz's;
oscillation, what is left of it inside 0.9 half widths when the profile is fitted to the pressure; balance, contact
force minus applied force over the applied one; Newton and Krylov iterations and updates of multipliers of the run;
seconds of the solves. A dash: the run did not converge, or there is nothing to fit a profile to.
"""

import time as clock
from pathlib import Path

import numpy as np

from drivers._common import contact_points, draw, log, main, make_parser, print_table, running, write_json
from drivers.hertz import CASES, fit, generate
from pcontact.runtime.errors import InputError
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps

CASE = CASES["cylinder_on_block"]
METHODS = {
    "theta 1": ("nitsche", 1.0, "#1b5e8a"),
    "theta 0": ("nitsche", 0.0, "#4c9a6b"),
    "theta -1": ("nitsche", -1.0, "#8a6bbf"),
    "penalty": ("penalty", 0.0, "#c8553d"),
    "augmented": ("augmented_lagrangian", 0.0, "#d9a441"),
}
MEASURES = ("penetration", "error", "oscillation", "balance")
COUNTS = ("newton", "krylov", "updates", "seconds")
FREE, INNER = "free", 0.9


def make_scene(mesh: Path, name: str, gamma0: float, order: int) -> Scene:
    """The scene of one run: the load in one step, and one more in which the search is renewed."""
    formulation, theta, _ = METHODS[name]
    source, target = CASE.skins
    return Scene(
        mesh=MeshSpec(mesh, order=order),
        materials={"elastic": Material(CASE.E, CASE.nu)},
        bodies=[Body(CASE.upper, "elastic"), Body(CASE.lower, "elastic")],
        contacts=[Contact(source, target, formulation=formulation, theta=theta, gamma0=gamma0, name="pair")],
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


class Totals:
    """Observer: iterations of the run, and the last record."""

    def __init__(self):
        self.counts, self.record = dict.fromkeys(("newton", "krylov", "updates"), 0), None

    def step(self, step, u, record):
        """Add a step."""
        self.record = record
        self.counts["newton"] += record["newton"]
        self.counts["krylov"] += record["krylov"]
        self.counts["updates"] += record.get("uzawa", {"updates": 0})["updates"]

    def cut(self, target, outcome):
        """The run goes on, or ends."""

    def end(self, converged):
        """Nothing is left to do."""


def measure(points: dict[str, np.ndarray], record: dict) -> dict[str, float]:
    """Deviations of a solution from Hertz's for the applied force, see the head of this module."""
    a, p0 = CASE.from_force(CASE.force)
    r, p, weight = np.abs(points["x"][:, 0]), points["pressure"], points["weight"]
    hertz = p0 * np.sqrt(np.maximum(1.0 - (r / a) ** 2, 0.0))
    closed, inside = points["status"] > 0, r < INNER * a
    width, peak = fit(r, p, weight, 0.5 * CASE.copies * weight[closed].sum())
    smooth = peak * np.sqrt(np.maximum(1.0 - (r[inside] / width) ** 2, 0.0))
    norm = np.sqrt(np.sum(weight * hertz**2))
    force = CASE.copies * abs(record["contacts"]["pair"]["force"][1])
    approach = abs(record["probes"][CASE.driven]["mean"][1])
    return {
        "penetration": float(np.max(-points["gap"][closed], initial=0.0) / approach),
        "error": float(np.sqrt(np.sum(weight * (p - hertz) ** 2)) / norm),
        "oscillation": float(np.sqrt(np.sum(weight[inside] * (p[inside] - smooth) ** 2)) / norm),
        "balance": abs(force / CASE.force - 1.0),
    }


def solve(mesh: Path, name: str, gamma0: float, order: int) -> dict:
    """One run. *Collective.*

    Returns
    -------
    dict
        ``method``, ``gamma0``, ``converged``, measures and counts; the same on every rank.
    """
    totals = Totals()
    row = {"method": name, "gamma0": gamma0, **dict.fromkeys((*MEASURES, *COUNTS), float("nan"))}
    start = clock.perf_counter()
    with running(make_scene(mesh, name, gamma0, order), None, [totals]) as (simulation, converged):
        row["converged"], row["unknowns"] = converged, simulation.problem.space.n_dofs
        if converged:
            row.update(totals.counts, seconds=clock.perf_counter() - start - simulation.timing["setup"])
            points = contact_points(simulation)
            found = None if points is None else measure(points, totals.record)
            row.update(simulation.comm.bcast(found, root=0))
    return row


def report(rows: list[dict], facets: int) -> None:
    """The table of one mesh."""
    keys = ("method", "gamma0", *MEASURES, *COUNTS)
    print_table(f"{facets} facets in the half width", keys, [[row[key] for key in keys] for row in rows])


def plot(path: Path, rows: list[dict]) -> None:
    """Penetration, error, oscillation and Newton iterations over gamma0; the finer the mesh, the thicker the line."""
    levels = sorted({row["facets"] for row in rows})

    def paint(axes):
        for one, key in zip(axes, ("penetration", "error", "oscillation", "newton"), strict=True):
            for name, (*_, colour) in METHODS.items():
                for level, facets in enumerate(levels):
                    chosen = [row for row in rows if row["method"] == name and row["facets"] == facets]
                    label = name if level == len(levels) - 1 else None
                    one.loglog([row["gamma0"] for row in chosen], [row[key] for row in chosen], "o-", ms=3,
                               lw=0.6 * (level + 1), color=colour, label=label)  # fmt: skip
            one.set(xlabel="gamma0", title=key)
        axes[0].legend(frameon=False)

    draw(path, paint, columns=4, size=(4.2, 3.8))


def run(args) -> int:
    """All runs; 1 where none of a formulation converged on a mesh."""
    if args.decades < 1 or min(args.facets) < 2:
        raise InputError("command line: --decades and --facets: found less than 1 and 2, allowed: more")
    facets, decades = (args.facets[:1], 3) if args.tiny else (args.facets, args.decades)
    values = args.lowest * 10.0 ** np.arange(decades + 1) if not args.tiny else [1.0, 100.0]
    rows, good = [], True
    for count in facets:
        mesh = generate(CASE, args.o / f"cylinder_{count}.msh", CASE.half_width / count, args.order)
        found = [
            {**solve(mesh, name, float(gamma0), args.order), "facets": count} for name in METHODS for gamma0 in values
        ]
        rows += found
        good &= all(any(row["converged"] for row in found if row["method"] == name) for name in METHODS)
        write_json(args.o / "compare.json", {"case": "cylinder_on_block", "order": args.order, "runs": rows})
    for count in facets:
        report([row for row in rows if row["facets"] == count], count)
    plot(args.o / "compare.png", rows)
    log.info("table and plot of %d runs in %s", len(rows), args.o)
    return 0 if good else 1


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "compare_results")
    add = parser.add_argument
    add("--facets", type=int, nargs="+", default=[5, 10, 20], help="facets in the half width of the contact, each mesh")
    add("--lowest", type=float, default=1e-2, help="smallest gamma0 (0.01)")
    add("--decades", type=int, default=8, help="powers of ten above it (8)")
    add("--order", type=int, choices=(1, 2), default=1, help="degree of displacement and geometry")
    return parser


if __name__ == "__main__":
    main(run, make_options())
