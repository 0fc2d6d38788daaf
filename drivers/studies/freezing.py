"""Freezing: what it costs that partners and normals stay as they are during a load step.

The ironing of `ironing.py`, a foot that is pressed into a slab and dragged along it, in few and in many load steps,
with partners looked for once per load step (``-contact_search_again 0``), again where Newton's method has ended until
that changes forces by 0.2 % at most, as by default, and to 1e-5 (``-contact_partner_rtol 1e-5``). The differences are
those of the normal and the tangential force from a run in many load steps, in L2 while the foot is dragged, relative to
that run's. Times are ratios to the first way's.
"""

import time as clock

import numpy as np

from drivers._common import draw, main, make_mesh, make_parser, print_table, running, write_json
from drivers.cases.ironing import PRESSED, Forces, scene
from meshes import ironing

WAYS = {
    "once": {"contact_search_again": "0"},
    "verified": {},
    "exact": {"contact_partner_rtol": "1e-5"},
}


def differences(rows, known):
    """Of the normal and tangential force while the foot is dragged, relative to those of a run in more load steps."""
    time, fine = (np.array([row["time"] for row in run if row["time"] > PRESSED]) for run in (rows, known))
    result = []
    for key in ("normal", "tangential"):
        force, other = (np.array([row[key] for row in run if row["time"] > PRESSED]) for run in (rows, known))
        other = np.interp(time, fine, other)
        result.append(float(np.linalg.norm(force - other) / np.linalg.norm(other)))
    return result


def solve(args, path, count, way):
    """Rows and seconds of a run. *Collective.*"""
    forces, start = Forces(), clock.perf_counter()
    keys = {"count": count, "theta": args.theta, "order": args.order, "petsc": WAYS[way]}
    with running(scene(path, args.dim, args.mu, **keys), args.o / f"{way}_{count}", [forces]) as (_, converged):
        return converged, forces.rows, clock.perf_counter() - start


def _plot(rows):
    def paint(axes):
        for way in WAYS:
            mine = [row for row in rows if row["partners"] == way]
            for ax, key in zip(axes, ("normal", "tangential"), strict=True):
                ax.loglog([row["count"] for row in mine], [row[key] for row in mine], "o-", label=way)
        for ax, key in zip(axes, ("normal", "tangential"), strict=True):
            ax.set_xlabel("load steps")
            ax.set_ylabel(f"difference of the {key} force")
            ax.legend()

    return paint


def run(args):
    """The table; 1 when a step fails or a force does not balance."""
    counts, reference, h = ([20], 40, 0.2) if args.tiny else (args.count, args.reference, args.h)
    path = make_mesh(ironing, args.o / f"ironing_{h:g}.msh", args.dim, h)
    good, known, _ = solve(args, path, reference, "exact")
    rows = []
    for count in counts:
        first = None
        for way in WAYS:
            converged, forces, seconds = solve(args, path, count, way)
            good, first = good and converged, first or seconds
            # a run that was cut off has nothing to compare
            normal, tangential = differences(forces, known) if converged else (np.nan, np.nan)
            newton = sum(row["newton"] for row in forces)
            cutbacks = sum(row["cutbacks"] for row in forces)
            said = {"newton": newton, "cutbacks": cutbacks, "time": seconds / first, "converged": converged}
            rows.append({"count": count, "partners": way, "normal": normal, "tangential": tangential, **said})
    table = [list(row.values()) for row in rows]
    print_table(f"ironing, {reference} load steps are the reference", list(rows[0]), table)
    draw(args.o / "freezing.png", _plot(rows), columns=2)
    write_json(args.o / "freezing.json", {"reference": reference, "h": h, "rows": rows})
    return 0 if good else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "freezing_results")
    parser.add_argument("--dim", type=int, default=2, choices=[2, 3], help="dimension")
    parser.add_argument("--h", type=float, default=0.1, help="element size of the slab")
    parser.add_argument("--order", type=int, default=1, choices=[1, 2], help="degree of the displacement")
    parser.add_argument("--theta", type=float, default=0.0, help="variant of the method")
    parser.add_argument("--mu", type=float, default=0.3, help="coefficient of friction")
    parser.add_argument("--count", type=int, nargs="+", default=[20, 40, 80], help="load steps, a fifth of them press")
    parser.add_argument("--reference", type=int, default=320, help="load steps of the run that is compared with")
    main(run, parser)
