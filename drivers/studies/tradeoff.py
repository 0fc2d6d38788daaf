"""The trade of speed for accuracy, measured: which settings pay, on scenes with known answers.

    mpirun -n 2 python drivers/studies/tradeoff.py -o tradeoff
    mpirun -n 2 python drivers/studies/tradeoff.py -o tradeoff --promise

On rings, Hertz's cylinders and ball, Cattaneo and Mindlin's cylinders, Hill's cylinder and an elastoplastic
indentation (`drivers/studies/_trade_cases.py`) mesh and degree are varied together, and around a base of each degree
one setting after the other (`KNOBS` in `drivers/studies/_trade_runs.py`); then all of those that made the base cheaper
without more error, together, and the presets of `-accuracy`, on all meshes. Each run is a row of tradeoff.json: errors,
processor's and wall seconds of set-up and solve, memory, unknowns, iterations. Seconds become a cost by those of one
linear elastic solve (contact replaced by body forces, relative tolerance 1e-8) in the same run, of one mesh of the
scene, or of the row's own. accuracy_tables.md has the Pareto front of each scene and norm, what each setting does
alone, the presets, and what these promise; NAME.png shows the fronts.

--publish docs/tables/accuracy.md puts tables and plots of the sweep in -o into that document.

--promise runs the presets on scenes that are not in the sweep and compares errors and costs with the promises that an
earlier sweep left in the same directory.

Kernels are compiled or loaded by a run outside the clock; runs shorter than a second are repeated, the fastest counts.
"""

import json
from pathlib import Path

from drivers._common import log, main, make_parser, print_table, write_json
from drivers.studies import _harness as harness
from drivers.studies._harness import results
from drivers.studies._trade_cases import CASES, HELD_OUT, SCALARS, Case, tiny
from drivers.studies._trade_report import (
    ALL,
    ALLOWED,
    by_class,
    cost,
    fronts,
    judged,
    norms,
    plot,
    promises,
    tables,
    tell,
)
from drivers.studies._trade_runs import PRESETS, Runner, sweep
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI

FEW = {"snes": (1e-2,)}
MARK = "<!-- What follows is written by drivers/studies/tradeoff.py with the option publish. -->"


def summary(case: Case, rows: list[dict], clock: str) -> dict:
    """Sum up the rows of a scene: fronts (labels), promises, the preset `standard` against the best."""
    found = fronts(rows, case.quantities, clock)
    return {
        "fronts": {
            key: [{"label": row["label"], "cost": cost(row, clock), "error": row["errors"][key]} for row in line]
            for key, line in found.items()
        },
        "promises": promises(case, rows, case.quantities, clock),
        "standard": judged(rows, case.quantities, clock),
    }


def sweep_all(args) -> int:
    """All scenes; 1 where `standard` costs more than it may."""
    rows, cases = kept(args)
    good = True
    for name in args.cases:
        case = cases[name] = tiny(CASES[name]) if args.tiny else CASES[name]
        run = Runner(name, case, args.o, lambda row, case=case: tell(row, case.quantities, args.clock),
                     1 if args.tiny else 3)  # fmt: skip
        run.prepare()
        sweep(run, FEW if args.tiny else None)
        rows[name] = run.rows
        single = tuple(key for key in case.quantities if key in SCALARS)
        plot(args.o / f"{name}.png", case, run.rows, args.clock, norms(case.quantities))
        plot(args.o / f"{name}_numbers.png", case, run.rows, args.clock, single)
        table = summary(case, run.rows, args.clock)["standard"]
        if table:
            columns = ("label", "quantity", "error", "cost", "best", "best_cost", "ratio")
            title = f"{name}: standard against the cheapest setting with the same error (at most {ALLOWED:g})"
            print_table(title, columns, [[row[key] for key in columns] for row in table])
        good = good and all(row["ratio"] <= ALLOWED for row in documented(case, table))
        # at once: a run that is killed leaves what it has
        data = {one: {"rows": some, **summary(cases[one], some, args.clock)} for one, some in rows.items()}
        head = {"clock": args.clock, "ranks": MPI.COMM_WORLD.size, "command": harness.command()}
        write_json(args.o / "tradeoff.json", {**head, "scenes": data})
        if MPI.COMM_WORLD.rank == 0:
            (args.o / "accuracy_tables.md").write_text(tables(cases, rows, head, ""))
    log.info("tables, plots and rows in %s", args.o)
    return 0 if good or args.tiny else 1


def kept(args) -> tuple[dict, dict]:
    """Rows and cases of an earlier sweep in the same directory that are not to be run again. *Collective.*"""
    path = args.o / "tradeoff.json"
    if args.tiny or not MPI.COMM_WORLD.bcast(path.exists()):
        return {}, {}
    found = load(path)["scenes"]
    rows = {name: one["rows"] for name, one in found.items() if name not in args.cases and name in CASES}
    return rows, {name: CASES[name] for name in rows}


def documented(case, table: list[dict]) -> list[dict]:
    """Of what `judged` tells the row of the mesh that `standard` is documented on, all norms at once."""
    asked = (ALL, *case.promised["standard"])
    return [row for row in table if (row["quantity"], row["size"], row["degree"]) == asked]


def load(path: Path) -> dict:
    """Load the rows of an earlier sweep. *Collective.*

    Raises
    ------
    InputError
    """

    return results(path, "command line: -o", ("clock", "ranks", "command", "scenes"))


def keep_promises(args) -> int:
    """The presets on scenes that are not in the sweep; 1 where a promise does not hold."""
    scenes = load(args.o / "tradeoff.json")["scenes"]
    kinds = by_class({name: CASES[name] for name in scenes}, {k: one["rows"] for k, one in scenes.items()}, args.clock)
    table, rows = [], []
    for name, case in HELD_OUT.items():
        promised = kinds.get(case.kind, {})
        if not promised:
            log.info("%s: no scene of its class (%s) in the sweep", name, case.kind)
            continue
        run = Runner(name, case, args.o, lambda row, case=case: tell(row, case.quantities, args.clock))
        run.prepare()
        for preset in PRESETS:
            one = promised.get(preset)
            if one is None:
                continue
            row = run(one["size"], one["degree"], accuracy=preset)
            rows.append(row)
            found = {"cost": cost(row, args.clock, own=True), **row["errors"]}
            for key, bound in {"cost": one["cost"], **one["errors"]}.items():
                if key in found:
                    verdict = "held" if found[key] <= bound else "broken"
                    table.append([name, case.kind, preset, row["label"], key, bound, found[key], verdict])
                elif not row["converged"]:
                    table.append([name, case.kind, preset, row["label"], key, bound, float("nan"), "broken"])
    header = ["scene", "class", "preset", "run", "quantity", "promised", "found", ""]
    print_table("promises on scenes that are not in the sweep", header, table)
    named = [dict(zip(header, row, strict=True)) for row in table]
    write_json(args.o / "promise.json", {"clock": args.clock, "table": named, "rows": rows})
    return 0 if table and all(row[-1] == "held" for row in table) else 1


def publish(args) -> int:
    """Put the tables and plots of an earlier sweep into a document, in place of what follows its line `MARK`.

    Raises
    ------
    InputError
        The document has no such line, or cannot be written.
    """
    data = load(args.o / "tradeoff.json")

    def write():
        found = args.o / "promise.json"
        if found.exists():
            table = json.loads(found.read_text())["table"]
            data["promise"] = [
                list(table[0]),
                [[float("nan") if c is None else c for c in row.values()] for row in table],
            ]
        cases = {name: CASES[name] for name in data["scenes"]}
        rows = {name: one["rows"] for name, one in data["scenes"].items()}
        pictures = [(args.o / f"{name}.png", f"accuracy_{name}.png") for name in cases]
        harness.publish(args.publish, MARK, tables(cases, rows, data, "accuracy_"), pictures)

    on_root(MPI.COMM_WORLD, write)
    return 0


def run(args) -> int:
    """The sweep, the promises, or the document."""
    if args.tiny:
        args.cases = ["rings"]
    if args.publish is not None:
        return publish(args)
    return keep_promises(args) if args.promise else sweep_all(args)


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "tradeoff_results")
    add = parser.add_argument
    add("--cases", nargs="+", choices=list(CASES), default=list(CASES), help="scenes (all)")
    add("--clock", choices=("cpu", "wall"), default="wall", help="what costs are made of (wall); the JSON keeps both")
    add("--promise", action="store_true", help="presets on scenes outside of the sweep, against the sweep in -o")
    add("--publish", type=Path, metavar="FILE", help="tables and plots of the sweep in -o into this document")
    return parser


if __name__ == "__main__":
    main(run, make_options())
