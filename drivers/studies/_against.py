"""Two revisions of the program in alternation: the same scenes on the same mesh, each run in processes of its own."""

import json
import subprocess
import sys
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path

from drivers._common import log, make_mesh, print_table, write_json
from drivers.studies._press import make_scene
from meshes import ball_on_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.runtime.process import environment_outside

ROOT = Path(__file__).resolve().parents[2]
# of `drivers.studies._press`, by the names of the comparison
CASES = {"elastic": "linear", "contact": "elastic", "friction": "frictional", "plastic": "plastic", "finite": "finite"}
WARM = 1500  # unknowns of the mesh on which kernels compile (or load) outside the clock
LEAST = 1e-3  # seconds of a phase below which a ratio says nothing
SHOWN = ("setup", "search", "assembly", "linear", "solve", "total")


def _git(*words):
    return subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True)


def unpack(revision: str, folder: Path) -> tuple[str, Path]:
    """Lay out the files of a revision, unless they are there with the kernels that they have compiled.

    Parameters
    ----------
    revision : str
        What git takes for a commit.
    folder : Path

    Returns
    -------
    name : str
        Of the commit, short.
    tree : Path
        Below the folder.

    Raises
    ------
    InputError
        There is no such commit.
    """
    name = _git("rev-parse", "--short", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}")
    if name.returncode:
        raise InputError(f"command line: --against: found {revision!r}, allowed: a commit of {ROOT}")
    short = name.stdout.decode().strip()
    tree = folder.resolve() / short
    if not tree.exists():
        part = tree.with_suffix(".part")
        part.mkdir(parents=True, exist_ok=True)
        subprocess.run(["tar", "-x", "-C", str(part)], input=_git("archive", short).stdout, check=True)
        part.rename(tree)
    return short, tree


def tables(part):
    """Return what differs from the default, as tables of a scene file: a revision with these keys takes them."""
    if is_dataclass(part):
        made = {}
        for one in fields(part):
            value = getattr(part, one.name)
            default = one.default if one.default_factory is MISSING else one.default_factory()
            if value != default:
                made[one.name] = tables(value)
        return made
    if isinstance(part, dict):
        return {key: tables(value) for key, value in part.items()}
    if isinstance(part, list):
        return [tables(value) for value in part]
    return str(part.resolve()) if isinstance(part, Path) else part


def measure(tree: Path, scenes: list, args) -> dict | str:
    """Run scenes with the program of a tree, on ``args.ranks`` ranks.

    Returns
    -------
    dict or str
        What the last one took; the last line that was said where it failed.
    """
    job, report = (args.o.resolve() / name for name in ("job.json", "report.json"))
    report.unlink(missing_ok=True)
    # the one that the program sets itself is none of the caller's
    options = {name: value for name, value in PETSc.Options().getAll().items() if name != "options_left"}
    words = {"tree": str(tree), "options": options, "scenes": scenes, "report": str(report)}
    job.write_text(json.dumps(words))
    start = ["mpirun", "-n", str(args.ranks)] if args.ranks > 1 else []
    driver = Path(__file__).with_name("_bench_run.py")
    done = subprocess.run(
        [*start, sys.executable, "-P", str(driver), str(job)], capture_output=True, text=True,
        env=environment_outside(), stdin=subprocess.DEVNULL,
    )  # fmt: skip
    if not report.exists():
        said = [line for line in done.stderr.splitlines() if "Error" in line or "NotConverged" in line]
        return (said or done.stderr.strip().splitlines() or [f"status {done.returncode}"])[0]
    found = json.loads(report.read_text())
    timing = found["timing"]
    seconds = {key: timing[key] for key in ("setup", "search", "assembly", "linear", "total")}
    seconds["solve"] = seconds["search"] + seconds["assembly"] + seconds["linear"]
    return {
        "unknowns": found["dofs"],
        **{key: sum(step[key] for step in found["steps"]) for key in ("newton", "krylov")},
        "memory_mb": found["memory"]["solve"]["peak_mb"],
        "seconds": {**seconds, **timing["phases"]},
    }


def summed(runs: list[dict]) -> dict:
    """Of the runs of a case the counts, the fastest seconds of every phase, the largest memory, and the spread: slowest
    over fastest solve, less one."""
    solves = [run["seconds"]["solve"] for run in runs]
    return {
        **runs[0],
        "memory_mb": max(run["memory_mb"] for run in runs),
        "seconds": {key: min(run["seconds"][key] for run in runs) for key in runs[0]["seconds"]},
        "spread": max(solves) / min(solves) - 1.0,
        "repeats": len(runs),
    }


def compared(rows: dict) -> dict:
    """Ratios of the seconds, new over old, and both in units of the old linear elastic solve.

    Parameters
    ----------
    rows : dict of str to dict of str to dict
        Of every case its ``old`` and its ``new`` row, see :func:`summed`; one that failed is not there.

    Returns
    -------
    dict
        ``new_to_old`` by case and phase, for phases that are long enough for one; ``to_old_elastic`` by case, revision
        and phase, empty where the old elastic solve failed.
    """
    ratios = {
        case: {
            key: both["new"]["seconds"][key] / old
            for key, old in both["old"]["seconds"].items()
            if old > LEAST and key in both["new"]["seconds"]
        }
        for case, both in rows.items()
        if len(both) == 2
    }
    old = rows.get("elastic", {}).get("old")
    units = {} if old is None else {
        case: {which: {key: value / old["seconds"]["linear"] for key, value in row["seconds"].items()}
               for which, row in both.items()}
        for case, both in rows.items()
    }  # fmt: skip
    return {"new_to_old": ratios, "to_old_elastic": units}


def _phases(rows):
    """Names of the phases that take time in some row."""
    every = [row["seconds"] for both in rows.values() for row in both.values()]
    return [key for key in (every[0] if every else ()) if any(one.get(key, 0.0) > LEAST for one in every)]


def show(rows: dict, ratios: dict) -> None:
    """Print the tables: counts and solves, ratios of all phases, phases in units of the old linear elastic solve."""
    names = _phases(rows)
    nan = float("nan")
    units = ratios["to_old_elastic"]
    print_table(
        "fastest solve; spread: slowest over fastest, less one",
        ["", "", "unknowns", "Newton", "Krylov", "memory, MB", "solve, s", "spread", "new / old", "/ old elastic"],
        [
            [case, which, row["unknowns"], row["newton"], row["krylov"], f"{row['memory_mb']:.0f}",
             row["seconds"]["solve"], f"{100.0 * row['spread']:.0f} %",
             ratios["new_to_old"].get(case, {}).get("solve", nan) if which == "new" else "",
             units.get(case, {}).get(which, {}).get("solve", nan)]
            for case, both in rows.items() for which, row in both.items()
        ],
    )  # fmt: skip
    print_table("new / old", ["", *names], [
        [case, *(f"{row[name]:.3f}" if name in row else "-" for name in names)]
        for case, row in ratios["new_to_old"].items()
    ])  # fmt: skip
    print_table("seconds / old linear elastic solve", ["", "", *names], [
        [case, which, *(f"{row[name]:.3f}" if name in row else "-" for name in names)]
        for case, both in units.items() for which, row in both.items()
    ])  # fmt: skip


def against(args) -> int:
    """The comparison of this tree with the revision ``args.against``; writes bench.json. Returns the exit status.

    Raises
    ------
    InputError
        There is no such revision, or this process is one of several of mpirun.
    """
    if MPI.COMM_WORLD.size > 1:
        raise InputError("command line: --against: found mpirun, allowed: without it, and --ranks N")
    if args.ranks < 1 or args.repeat < 1:
        found = f"--ranks {args.ranks} --repeat {args.repeat}"
        raise InputError(f"command line: found {found}, allowed: at least 1 of each")
    name, tree = unpack(args.against, args.o / "revisions")
    trees = {"old": tree, "new": ROOT}
    sizes = (WARM, WARM if args.tiny else args.unknowns)
    meshes = [make_mesh(ball_on_block, args.o / f"ball_{size}.msh", unknowns=size) for size in sizes]
    numbers = args.theta, args.friction or 0.3, args.yield_stress or 5.0
    scenes = {case: [tables(make_scene(mesh, own, *numbers)) for mesh in meshes] for case, own in CASES.items()}
    runs, failures = {case: {which: [] for which in trees} for case in scenes}, {}

    def take(case, which, count):
        """Measure the first scenes of a case; what has failed is not tried again."""
        if (case, which) in failures:
            return
        found = measure(trees[which], scenes[case][:count], args)
        if isinstance(found, str):
            failures[case, which] = found
            log.warning("%s, %s: %s", case, which, found)
        elif count > 1:
            runs[case][which].append(found)

    # compiled where the memory of the compiler is nobody's
    for case in scenes:
        for which in trees:
            take(case, which, 1)
    for k in range(args.repeat):
        for case in scenes:
            # each is the first one in turn
            for which in list(trees)[:: 1 if k % 2 == 0 else -1]:
                take(case, which, 2)
    rows = {case: {which: summed(own) for which, own in both.items() if own} for case, both in runs.items()}
    ratios = compared(rows)
    now = _git("describe", "--always", "--dirty", "--exclude=*").stdout.decode().strip()
    log.info("old: %s, new: %s, %d ranks, fastest of %d", name, now, args.ranks, args.repeat)
    show(rows, ratios)
    failed = [{"case": case, "which": which, "error": text} for (case, which), text in failures.items()]
    revisions = {"old": name, "new": now}
    write_json(args.o / "bench.json", {
        "ranks": args.ranks, "revisions": revisions, "rows": rows, "ratios": ratios, "failed": failed, "runs": runs
    })  # fmt: skip
    return 1 if any(which == "new" for _, which in failures) else 0
