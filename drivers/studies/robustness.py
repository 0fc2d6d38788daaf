"""How hard are hard scenes: Newton and Krylov iterations, cut load steps, failures; and what each heuristic brings.

Runs the scenes of `drivers/studies/_robust_scenes.py`, each as it is, and with ``--without all`` once more with each
of the heuristics of the nonlinear solver left out (``-newton_without``). An earlier run is the yardstick: with
``--against FILE.json`` a scene that fails and did not before, or more than 1.05 times as many Newton iterations in all,
is an error.
"""

import json
import re
import shutil
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

from drivers._common import log, main, make_directory, markdown, print_table, running, write_json
from drivers.studies._harness import Counts, Rows, study_parser
from drivers.studies._robust_scenes import CASES
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI

# what may be left out, and the options that do so
HEURISTICS = {
    "prediction": {"newton_without": "prediction"},
    "opening": {"newton_without": "opening"},
    "half_step": {"newton_without": "half_step"},
    "line_search": {"newton_without": "line_search"},
    "correction": {"newton_without": "correction"},
    "step_limit": {"newton_without": "step_limit"},
    "stabilisation": {"newton_without": "stabilisation"},
    "alpha": {"contact_alpha": "1"},
    "direct": {"newton_without": "direct"},
    "reuse": {"newton_without": "reuse"},
}
# Newton iterations over those of the yardstick that are no error
GROWTH = 1.05
COLUMNS = ("family", "scene", "steps", "newton", "most", "krylov", "cuts", "seconds", "ended")


def without(name):
    """Options that leave out a heuristic, or several: names joined by +."""
    options = {}
    for word in filter(None, name.split("+")):
        for key, value in HEURISTICS[word].items():
            options[key] = f"{options[key]},{value}" if key in options else value
    return options


def solve(case, folder, options):
    """One scene: a row. *Collective.*

    Returns
    -------
    dict
        ``steps`` (load steps that converged), ``newton``, ``krylov`` (of all attempts), ``most`` (Newton iterations of
        a load step with the attempts that failed before it), ``cuts``, ``seconds``, ``ended``.
    """
    on_root(MPI.COMM_WORLD, shutil.rmtree, folder, True)
    make_directory(folder)
    counts, ended = Counts(), "refused"
    scene = case.make(folder)
    scene = replace(scene, petsc={**(scene.petsc or {}), **options})
    start = time.perf_counter()
    try:
        with running(scene, None, [counts]) as (_, converged):
            ended = "converged" if converged else "failed"
    except InputError as error:
        log.error_line(str(error))
    row = {key: getattr(counts, key) for key in ("steps", "newton", "most", "krylov", "cuts")}
    seconds = MPI.COMM_WORLD.allreduce(time.perf_counter() - start, op=MPI.MAX)
    return {"family": case.family, "scene": case.name, **row, "seconds": seconds, "ended": ended}


def totals(rows):
    """Sums over the scenes."""
    sums = {key: sum(row[key] for row in rows) for key in ("newton", "krylov", "cuts", "seconds")}
    failed = sum(row["ended"] != "converged" for row in rows)
    return {**sums, "most": max(row["most"] for row in rows), "failed": failed}


def name_of(row):
    """Return the name that tells a scene from the others."""
    return f"{row['family']}, {row['scene']}"


def compare(rows, others):
    """Faults of a run against an earlier one, both lists of rows; of the scenes that both have."""
    before = {name_of(row): row for row in others}
    both = [(row, before[name_of(row)]) for row in rows if name_of(row) in before]
    worse = [name_of(row) for row, old in both if row["ended"] != "converged" == old["ended"]]
    faults = [f"{name}: does not converge any more" for name in worse]
    now, then = (sum(pair[k]["newton"] for pair in both) for k in (0, 1))
    if now > GROWTH * then:
        faults.append(f"{now} Newton iterations instead of {then}")
    log.info("%d scenes, Newton iterations %d, before %d", len(both), now, then)
    changes = sorted(both, key=lambda pair: abs(pair[0]["newton"] - pair[1]["newton"]), reverse=True)
    for row, old in changes[:12]:
        if row["newton"] != old["newton"] or row["ended"] != old["ended"]:
            log.info(
                "  %s: Newton %d -> %d, cuts %d -> %d, %s -> %s", name_of(row), old["newton"], row["newton"],
                old["cuts"], row["cuts"], old["ended"], row["ended"],
            )  # fmt: skip
    return faults


def page(rows, variants):
    """The tables: all scenes, and what each heuristic brings."""
    head = "# Robustness: table\n\nWhat `drivers/studies/robustness.py` writes: [robustness.md](../robustness.md).\n"
    columns = [*COLUMNS[:7], "ended"]
    lines = [head, *markdown(columns, [[row[key] for key in columns] for row in rows])]
    total = totals(rows)
    sums = f"All: {total['newton']} Newton, {total['krylov']} Krylov, {total['cuts']} cuts"
    lines += ["", f"{sums}, {total['failed']} not converged; at most {total['most']} Newton in a load step.", ""]
    if variants:
        columns = ["left out", "scenes", "Newton", "was", "Krylov", "was", "cuts", "was", "not converged", "was",
                   "worse in", "better in"]  # fmt: skip
        before, table = {name_of(row): row for row in rows}, []
        for name, others in variants.items():
            base = [before[name_of(row)] for row in others]
            now, then = totals(others), totals(base)
            worse = [row for row, old in zip(others, base, strict=True) if _worse(row, old)]
            better = [row for row, old in zip(others, base, strict=True) if _worse(old, row)]
            numbers = [word for key in ("newton", "krylov", "cuts", "failed") for word in (now[key], then[key])]
            table.append([name, len(others), *numbers, _listed(worse), _listed(better)])
        lines += [*markdown(columns, table), ""]
    return "\n".join(lines)


def _listed(rows):
    """Count the scenes of each family."""
    families = ", ".join(dict.fromkeys(row["family"] for row in rows))
    return f"{len(rows)} ({families})" if rows else "0"


def _worse(row, old):
    """Tell whether a scene takes more than a tenth and two more Newton iterations than it did, or fails and did not."""
    if row["ended"] != old["ended"]:
        return old["ended"] == "converged"
    return row["newton"] > 1.1 * old["newton"] + 2


def run(args):
    """All scenes; 1 when one is worse than the yardstick says."""
    unknown = {word for name in args.without for word in name.split("+")} - {"all", *HEURISTICS}
    if unknown:
        raise InputError(f"command line: --without: found {min(unknown)!r}, allowed: all | {' | '.join(HEURISTICS)}")
    cases = [case for case in CASES if re.search(args.scene, f"{case.family}, {case.name}")]
    cases = [case for case in cases if args.large or not case.large]
    if args.tiny:
        cases = [case for case in cases if not case.large][:: max(len(cases) // 4, 1)]
    if not cases:
        raise InputError(f"command line: --scene: found {args.scene!r}, allowed: a regular expression for some scenes")
    names = list(HEURISTICS) if "all" in args.without else args.without
    rows, variants = [], {name: [] for name in names}
    kept = Rows(args.o / "rows.jsonl", ("family", "scene", "left out"), args.go_on)
    for number, case in enumerate(cases):
        for name, some in {"": rows, **variants}.items():
            key = {"family": case.family, "scene": case.name, "left out": name}
            row = kept.get(key, partial(solve, case, args.o / "run", without(name)))
            some.append({key: value for key, value in row.items() if key != "left out"})
        log.info("%d/%d %s: %s", number + 1, len(cases), name_of(rows[-1]), rows[-1])
        write_json(args.o / "robustness.json", {"rows": rows, "without": variants})
    print_table("robustness", COLUMNS, [[row[key] for key in COLUMNS] for row in rows])
    for name, found in {"all": rows, **variants}.items():
        log.info("%s: %s", name if name == "all" else f"without {name}", totals(found) if found else "")
    if MPI.COMM_WORLD.rank == 0:
        Path(args.o / "robustness.md").write_text(page(rows, variants))
    faults = compare(rows, json.loads(args.against.read_text())["rows"]) if args.against else []
    for fault in faults:
        log.error_line(fault)
    return 1 if faults else 0


if __name__ == "__main__":
    parser = study_parser(__doc__, "robustness_results")
    parser.add_argument("--scene", default="", metavar="REGEX", help="only scenes whose family and name match")
    text = "with those of more than ten seconds"
    parser.add_argument("--large", action="store_true", help=text)
    names = ", ".join(HEURISTICS)
    text = f"run all scenes again without some heuristics: all, or some of {names}; NAME+NAME leaves out both at once"
    parser.add_argument("--without", nargs="*", default=[], metavar="NAME", help=text)
    parser.add_argument("--against", type=Path, metavar="FILE", help="robustness.json of an earlier run: the yardstick")
    main(run, parser)
