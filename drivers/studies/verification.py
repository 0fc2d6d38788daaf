"""The verification manual: cases with a reference that is not ours, under refinement, each with a bound.

    mpirun -n 2 python drivers/studies/verification.py -o DIR                               # all cases, all meshes
    python drivers/studies/verification.py --cases rotating_shrink_fit -o DIR               # one of them
    python drivers/studies/verification.py -o DIR --publish docs/verification               # and their pages

The exit status is 1 where a case misses its bound on its finest mesh; `--tiny` takes the coarsest one, with a bound of
its own, of the cases that take a second.
"""

import textwrap
from functools import partial
from pathlib import Path

from PIL import Image

from drivers._common import main, make_directory, picture, print_table, write_json
from drivers.studies import (
    _manual_friction,
    _manual_half_space,
    _manual_layers,
    _manual_left,
    _manual_mindlin,
    _manual_orthotropic,
    _manual_plastic,
    _manual_published,
    _manual_rings,
)
from drivers.studies._harness import Rows, study_parser
from drivers.studies._manual import RUN
from pcontact.runtime.errors import InputError, StepFailure
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI

CASES = {
    **_manual_rings.CASES,
    **_manual_half_space.CASES,
    **_manual_orthotropic.CASES,
    **_manual_layers.CASES,
    **_manual_friction.CASES,
    **_manual_mindlin.CASES,
    **_manual_plastic.CASES,
    **_manual_published.CASES,
}
# how the row of the overview begins
OVERVIEW = "| [verification/index.md](verification/index.md) |"
# pixels, colours of a picture
WIDTH, COLOURS = 640, 48


def verify(name, folder, tiny=False):
    """Rows (level, value, relative error) of a case, and whether it meets its bound. *Collective.*"""
    case = CASES[name]
    rows = []
    for level in case.levels[:1] if tiny else case.levels:
        try:
            value = case.solve(make_directory(folder / name / str(level)), level)
        except StepFailure:
            return rows, False
        rows.append((level, value, value / case.reference - 1.0))
    return rows, bool(abs(rows[-1][2]) <= case.bounds[0 if tiny else 1])


def _verified(*args):
    return {"found": verify(*args)}


def page(name, rows):
    """The page of a case."""
    case = CASES[name]
    table = [f"| {level} | {value:.6g} | {100.0 * error:+.3g} % |" for level, value, error in rows]
    return "\n".join([
        f"# {case.title}", "", *_wrapped(case.data), "", "```", case.sketch, "```", "",
        f"![the deformed bodies]({name}.png)", "",
        *_wrapped(f"Compared: {case.quantity}. Reference: {case.reference:.6g}, {case.source}."), "",
        "| n | computed | error |", "|---|---|---|", *table, "",
        *([*_wrapped(case.remark), ""] if case.remark else []),
        f"Bound of the finest mesh: {100.0 * case.bounds[1]:g} %. The command:", "",
        f"    python drivers/studies/verification.py --cases {name} -o DIR", "",
    ])  # fmt: skip


def _wrapped(text):
    """Lines of at most 120 characters."""
    return textwrap.wrap(text, 120, break_long_words=False, break_on_hyphens=False)


def draw_case(name, run, path):
    """The picture of a run, small enough for a page."""
    picture(run, output=path, **CASES[name].look)
    if path.is_file():
        drawn = Image.open(path).convert("RGB")
        drawn = drawn.resize((WIDTH, round(WIDTH * drawn.height / drawn.width)), Image.Resampling.LANCZOS)
        drawn.quantize(COLOURS).save(path, optimize=True)


def publish(folder, results, runs):
    """Write the pages of some cases, their pictures, and the list of all that have one."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in results.items():
        (folder / f"{name}.md").write_text(page(name, rows))
        draw_case(name, runs / name / str(CASES[name].levels[0]) / RUN, folder / f"{name}.png")
    listed = [f"| [{case.title}]({name}.md) | {case.quantity} | {case.source} |"
              for name, case in CASES.items() if (folder / f"{name}.md").is_file()]  # fmt: skip
    overview = folder.parent / "index.md"
    if overview.is_file():
        lines = [overview_row() if line.startswith(OVERVIEW) else line for line in overview.read_text().splitlines()]
        overview.write_text("\n".join([*lines, ""]))
    (folder / "index.md").write_text("\n".join([
        "# Verification manual", "",
        "Cases with a reference that is not ours, one page each, made by",
        "`python drivers/studies/verification.py -o DIR --publish docs/verification`. The driver is a test, too: its",
        "exit status is 1 where a case misses its bound. More cases are in [verification.md](../verification.md).", "",
        "| case | compared | reference |", "|---|---|---|", *listed, "",
        "## Not here", "",
        *(line for words in _manual_left.LEFT for line in [*_wrapped(words), ""]),
    ]))  # fmt: skip


def overview_row():
    """The row of the overview of all pages, which links all cases."""
    links = ", ".join(f"[{case.title}](verification/{name}.md)" for name, case in CASES.items())
    return f"{OVERVIEW} the verification manual: references that are not ours, a page and a bound each: {links} |"


def run(args):
    """All cases that are asked for."""
    args.cases = args.cases or [name for name, case in CASES.items() if case.tiny or not args.tiny]
    for name in args.cases:
        if name not in CASES:
            raise InputError(f"command line: --cases: found {name!r}, allowed: {', '.join(CASES)}")
    results, good, kept = {}, True, Rows(args.o / "rows.jsonl", ("case",), args.go_on)
    for name in args.cases:
        rows, held = kept.get({"case": name}, partial(_verified, name, args.o, args.tiny))["found"]
        results[name], good = rows, good and held
        title = f"{CASES[name].title}: reference {CASES[name].reference:.6g}, {'held' if held else 'MISSED'}"
        print_table(title, ["n", "computed", "error"], rows)
    write_json(args.o / "verification.json", results)
    if args.publish is not None and not args.tiny:
        on_root(MPI.COMM_WORLD, publish, args.publish, results, args.o)
    return 0 if good else 1


if __name__ == "__main__":
    parser = study_parser(__doc__, "verification_results")
    parser.add_argument("--cases", nargs="+", metavar="NAME", help="default: all")
    parser.add_argument("--publish", type=Path, metavar="DIR", help="write the pages there")
    main(run, parser)
