"""The matrix of extremes: is the answer right, or refused with its cause, where numbers are at the edge of sense?

Every cell is a small scene with a known answer, from a closed form or from statics, and a bound for the deviation. A
cell is right when the run ends within the bound, refused when the program ends it with a message that names the cause;
everything else is WRONG, a wrong answer with a warning, too. A number that is not finite in any file is WRONG, and a
cell that takes too long ends the run as HANG.
"""

from functools import partial
from itertools import islice
from pathlib import Path

from drivers._common import log, main, markdown, print_table, write_json
from drivers.studies._extreme_cells import FAMILIES, REASONS
from drivers.studies._extreme_runs import HANG, WRONG, run_cell
from drivers.studies._harness import Rows, study_parser
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI

COLUMNS = ("family", "setting", "variant", "deviation", "bound", "why", "newton", "krylov", "verdict", "message")


HEAD = """# Extremes: table

What `scripts/extremes.sh{ranks}` writes: {summary}. What a cell is, and what the verdicts mean:
[extremes.md](../extremes.md). Why a bound is what it is:

{why}
"""


def cells_of(families, every=1):
    """The cells of some families; every n-th of each."""
    for name in families:
        if name not in FAMILIES:
            raise InputError(f"command line: --family: found {name!r}, allowed: {' | '.join(FAMILIES)}")
        yield from islice(FAMILIES[name](), 0, None, every)


def _row(row):
    """A line of the table."""
    deviation = "" if row["deviation"] is None else f"{row['deviation']:.1e}"
    numbers = [deviation, f"{row['bound']:.0e}", row["reason"], row["newton"], row["krylov"]]
    return [row["family"], row["setting"], row["variant"], *numbers, row["verdict"], row["text"]]


def page(rows):
    """The table in Markdown."""
    clean = [[str(word).replace("|", "\\|").replace("\n", " ") for word in _row(row)] for row in rows]
    return "\n".join(markdown(COLUMNS, clean)) + "\n"


def counts(rows):
    """Count each verdict."""
    found = {}
    for row in rows:
        found[row["verdict"]] = found.get(row["verdict"], 0) + 1
    return found


def run(args):
    """All cells, one after the other; 1 when one is neither right nor refused."""
    every = args.every or (23 if args.tiny else 1)
    cells, rows = list(cells_of(args.family or list(FAMILIES), every)), []
    kept = Rows(args.o / "rows.jsonl", ("family", "setting", "variant"), args.go_on)
    for number, cell in enumerate(cells):
        # a run that hangs leaves this behind
        write_json(args.o / "extremes.json", {"verdict": HANG, "cell": cell.name, "rows": rows})
        key = {"family": cell.family, "setting": cell.setting, "variant": cell.variant}
        rows.append(kept.get(key, partial(run_cell, cell, args.o / "cell")))
        row = rows[-1]
        line = _row(row)
        log.info("%d/%d %s: %s", number + 1, len(cells), cell.name, " ".join(str(line[k]) for k in (8, 3, 9)))
    print_table("extremes", COLUMNS, [_row(row) for row in rows])
    found = counts(rows)
    summary = f"{len(rows)} cells: " + ", ".join(f"{count} {verdict}" for verdict, count in sorted(found.items()))
    log.info("%s", summary)
    write_json(args.o / "extremes.json", {"cells": len(rows), "verdicts": found, "reasons": REASONS, "rows": rows})
    if MPI.COMM_WORLD.rank == 0:
        ranks = f" -n {MPI.COMM_WORLD.size}" if MPI.COMM_WORLD.size > 1 else ""
        why = "".join(f"* {key}: {text}\n" for key, text in REASONS.items())
        Path(args.o / "extremes.md").write_text(HEAD.format(ranks=ranks, summary=summary, why=why) + page(rows))
    return 1 if {WRONG, HANG} & found.keys() else 0


if __name__ == "__main__":
    parser = study_parser(__doc__, "extremes_results")
    parser.add_argument("--family", nargs="+", metavar="NAME", help=f"only these of {', '.join(FAMILIES)}")
    parser.add_argument("--every", type=int, metavar="N", help="every N-th cell of each family only")
    main(run, parser)
