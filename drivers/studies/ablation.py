"""Numbers of the loop that reaches an error, each over and times 1.5: which of them change anything.

Loops of `LOOPS`, scenes of `random_errors.py` in the plane with 5 %, are run with every number of ``pcontact/adapt``
and ``pcontact/estimate`` as it is, over 1.5 and times 1.5. A number is one that a module has in capital letters; tables
and words are left out, what is made of other numbers, and modules that act in space alone. A row has the largest factor
between the unknowns of the last meshes and those with the number as it is, the same of the errors named, and the passes
and seconds of the processor of all loops together.

Rows are kept in ``rows.jsonl`` of the folder as they come: a run goes on where an earlier one has ended.

    python drivers/studies/ablation.py -o DIR
"""

import re
import time as clock
from dataclasses import replace
from functools import partial
from importlib import import_module
from itertools import islice
from pathlib import Path
from pkgutil import iter_modules

import pcontact.adapt
import pcontact.estimate
from drivers._common import log, main, make_parser, markdown, print_table
from drivers.studies._harness import Rows
from drivers.studies._random_scenes import drawn
from drivers.studies.random_errors import ENDS, UNKNOWNS
from pcontact.adapt.loop import Loop
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Budget, Target

# seeds and what is named
LOOPS = (
    (0, "energy"), (1, "displacement:outer_skin"), (2, "energy"), (3, "force:roller.y"), (5, "energy"), (6, "energy"),
    (7, "energy"), (8, "energy"), (9, "force:punch"), (11, "energy"), (13, "force:layer"), (14, "energy"),
    (15, "displacement:block_right"), (17, "displacement:layer_top"), (18, "support:top_top"), (19, "force:inner.x"),
    (20, "energy"), (21, "support:bar_right"), (22, "energy"), (24, "force:punch"),
)  # fmt: skip
TARGET, FACTORS = 0.05, (1.0 / 1.5, 1.5)
# words for exit statuses, sizes of arrays, and what rounding leaves
NOT_TRIED = {"pcontact.estimate.points"}
NO_NUMBERS = {"REACHED", "FAILED", "SPENT", "CHUNK", "ROOM", "PART", "ZERO", "ROUNDED", "SAME_TIME", "NUMBER",
              "ANGULAR", "TAKES_ALL"}
PAGE = """# Numbers of the loop that reaches an error

`python drivers/studies/ablation.py -o DIR --publish docs/tables/ablation.md` writes this page: what changes in twenty
loops, of scenes drawn from seeds 0 to 24 in the plane, when a number is over or times 1.5. `unknowns` and `named`: the
largest factor between those of the last meshes and those with the number as it is; 1: nothing changes. `passes` and
`seconds` (of the processor, on a busy machine) are of all. Numbers that change nothing here are those of ends that
these loops do not meet (budgets, meshes that bring nothing, pressures), of rounding, and of sizes.
"""


def modules():
    """All modules of both packages."""
    return [import_module(f"{package.__name__}.{one.name}") for package in (pcontact.adapt, pcontact.estimate)
            for one in iter_modules(package.__path__)]  # fmt: skip


def numbers(some, left_out=()):
    """Module, name and value of every number of some modules, where it is defined."""
    for module in some:
        text = Path(module.__file__).read_text(encoding="utf-8")
        lines = [line.partition(" = ") for line in text.splitlines() if line[:1].isupper() and " = " in line]
        for name, value in sorted(vars(module).items()):
            own = any(name in left.split(", ") and not re.search("[A-Z]{3}", right) for left, _, right in lines)
            if name.isupper() and type(value) in (int, float) and own and name not in left_out:
                yield module, name, value


def loops(folder, pairs=LOOPS):
    """Unknowns and errors of the last meshes of all loops, and passes and seconds together."""
    unknowns, named, passes, start = [], [], 0, clock.process_time()
    for seed, of in pairs:
        accuracy = Target(TARGET, of, budget=Budget(unknowns=UNKNOWNS[2]))
        loop = Loop(replace(drawn(seed).begun(folder), accuracy=accuracy), MPI.COMM_SELF)
        try:
            with log.quiet():
                loop.run()
        except ENDS as error:
            log.info("seed %d: %s", seed, error)
        last = loop.passes[loop.best - 1] if loop.passes else None
        unknowns.append(last.unknowns if last else 0)
        named.append(last.error if last else 0.0)
        passes += len(loop.passes)
    return {"unknowns": unknowns, "named": named, "passes": passes, "seconds": clock.process_time() - start}


def changed(number, factor, some, measure):
    """What a function measures with a number that is another one, in all of some modules that have it from there."""
    module, name, value = number
    other = type(value)(round(value * factor)) if type(value) is int else value * factor
    of = [one for one in some if vars(one).get(name) is value and (one is module or name in vars(one))]
    if other == value:
        other = value + (1 if factor > 1.0 else -1)
    try:
        for one in of:
            setattr(one, name, other)
        return {"value": value, **measure()}
    finally:
        for one in of:
            setattr(one, name, value)


def ablate(args, some, left_out, measure, compared, comm=MPI.COMM_SELF):
    """Rows of all numbers of some modules, those of an earlier run kept; and what the table says of each.

    Parameters
    ----------
    args : argparse.Namespace
    some : list of module
    left_out : set of str
        Names that are no numbers to try.
    measure : callable
        Makes a dict of lists and sums.
    compared : tuple of str
        Lists whose largest factor to those of the first row stands in the table; of the others the values.
    comm : MPI.Comm, optional
        Ranks that measure together.

    Returns
    -------
    columns, entries : list
    left : list of str
        Numbers without a row.
    """
    rows = Rows(args.o / "rows.jsonl", ("module", "name", "times"), comm=comm)
    first = rows.get({"module": "", "name": "as it is", "times": 1.0}, measure)
    every = list(numbers(some, left_out))
    for number in islice(every, 0 if args.table else 1 if args.tiny else None):
        for factor in FACTORS:
            key = {"module": number[0].__name__.partition(".")[2], "name": number[1], "times": round(factor, 2)}
            log.info("%s", rows.get(key, partial(changed, number, factor, some, measure)))
    known = {(module.__name__.partition(".")[2], name) for module, name, _ in every}
    found = [row for row in rows if (row["module"], row["name"]) in known or row is first]
    others = [key for key in first if key not in compared and key not in ("module", "name", "times")]
    left = known - {(row["module"], row["name"]) for row in rows}
    return (["module", "name", "value", "times", *compared, *others],
            [_entry(row, first, compared, others) for row in found], sorted(f"{a} {b}" for a, b in left))  # fmt: skip


def write_table(args, page, columns, found, left):
    """Show the table, and write it into the docs where that is wanted."""
    print_table("numbers over and times 1.5", columns, found)
    if args.publish is not None:
        rest = ["", f"Not run: {', '.join(left)}."] if left else []
        text = "\n".join([*page.splitlines(), *rest, "", *markdown(columns, found), ""])
        args.publish.write_text(text, encoding="utf-8")


def _entry(row, first, compared, others):
    def most(key):
        pairs = [(a, b) for a, b in zip(row[key], first[key], strict=True) if a and b]
        return float(f"{max([max(a / b, b / a) for a, b in pairs], default=float('inf')):.3g}")

    rest = [float(f"{row[key]:.2g}") if type(row[key]) is float else row[key] for key in others]
    return [row["module"], row["name"], row.get("value", "-"), row["times"], *map(most, compared), *rest]


def _run(args):
    some = [module for module in modules() if module.__name__ not in NOT_TRIED]
    measure = partial(loops, args.o, LOOPS[:3] if args.tiny else LOOPS)
    measure()
    found = ablate(args, some, NO_NUMBERS, measure, ("unknowns", "named"))
    write_table(args, PAGE, *found)


def run(args):
    """Rows that are missing, and the table: on the first rank."""
    on_root(MPI.COMM_WORLD, _run, args)
    return 0


def parser(description=__doc__, name="pcontact_ablation"):
    """Options of a driver that tries numbers; its rows are kept in a directory of the user's of that name."""
    p = make_parser(description, str(Path.home() / name))
    p.add_argument("--table", action="store_true", help="no runs: what the rows say")
    p.add_argument("--publish", type=Path, metavar="FILE", help="the table is written there, too")
    return p


if __name__ == "__main__":
    main(run, parser())
