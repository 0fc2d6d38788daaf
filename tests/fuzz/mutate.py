"""Damaged input: ``python tests/fuzz/mutate.py [--count 200] [--seed 1] [--ranks 1 3]``.

Scenes, meshes (.msh of two versions, text and binary; .h5) and checkpoints are changed at random: values, keys,
bytes, counts, lines. The program has to end with status 2 and one line; or, for a scene or a mesh, with 0 or 1 and
the numbers of the scene and the mesh as the second reader of independent.py reads them: what it has read, written
anew in the plainest form, gives the same report, and the report agrees with its own counts, with the balance of
forces and with what supports prescribe. A changed checkpoint or .h5 mesh is always refused. Nothing ends with a
traceback, a signal or not at all.

The exit status is 1 if there was a failure.
"""

import argparse
import json
import shutil
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import gmsh
import numpy as np
from grids import msh_text
from independent import Unread, complaints, lost, mesh_of, read_toml
from mutations import hdf5_mutated, mesh_mutated, scene_mutated
from runner import supervised, take_along
from scenes import PLAIN, scene_of, texts

HERE = Path(__file__).resolve().parent
# how far a report may be from that of the same scene, written in another way
SAME = 1e-5
# sensible scenes of which each is the start of a fifth of the mutations
SIMPLE = {**PLAIN, "degree": 1, "kinematics": "plane_strain", "kinematics said": False, "count": 2, "low.jitter": 0.2}
BASES = [
    {**SIMPLE, "dim": 2, "arrangement": "stack", "bodies": 2, "kind0": "pair", "kind1": "pair", "drive": "pressed",
     "pair1.law": "coulomb", "pair1.formulation": "nitsche"},
    {**SIMPLE, "dim": 3, "arrangement": "stack", "bodies": 2, "kind0": "pair", "kind1": "unbiased", "drive": "moved",
     "low.cell": "hexahedron", "middle.cell": "hexahedron", "order": 1, "pair1.formulation": "penalty",
     "low.yields": True},
    {**SIMPLE, "dim": 2, "arrangement": "stack", "bodies": 1, "drive": "moved", "floor.shape": "level_set",
     "floor.law": "capped", "floor.formulation": "nitsche", "order": 2, "low.curved": (0, 0)},
    {**SIMPLE, "dim": 2, "arrangement": "slot", "all": True, "slot.law": "none", "slot.formulation": "nitsche"},
    {**SIMPLE, "dim": 3, "arrangement": "stack", "bodies": 2, "kind0": "pair", "kind1": "tied", "drive": "moved",
     "floor": False, "low.cell": "tetrahedron", "middle.cell": "tetrahedron", "order": 1,
     "pair1.formulation": "nitsche"},
]  # fmt: skip
# what is damaged, and in what part of the mutations
SHARES = {"scene": 0.4, "msh": 0.3, "h5": 0.12, "checkpoint": 0.18}
TARGETS = tuple(SHARES)


@dataclass
class Mutation:
    """One damaged input: `target` of TARGETS, `text` says what was done, `words` and `options` run it."""

    number: int
    target: str
    text: str
    folder: Path
    words: list
    options: dict


# -- the sound input ---------------------------------------------------------------------------------------


def write_base(folder, number):
    """Scene, meshes of all formats and a checkpoint of a base, the latter by the program."""
    case = scene_of(1000 + number, BASES[number])
    scene = case.scene
    regions = [table["region"] for table in scene.get("displacements", [])]
    scene["output"] = {"fields": False, "checkpoint": True, "probes": sorted(set(regions))}
    folder.mkdir(parents=True)
    for name, text in texts(case).items():
        (folder / name).write_text(text)
    (folder / "mesh.msh").write_text(msh_text(case.mesh))
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(folder / "mesh.msh"))
    for name, version, binary in (("text4", 4.1, 0), ("binary4", 4.1, 1), ("binary2", 2.2, 1)):
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(folder / f"{name}.msh"))
    gmsh.finalize()
    scene["mesh"]["file"] = "mesh.h5"
    (folder / "stored.toml").write_text(texts(case)["scene.toml"])
    order = str(scene["mesh"]["order"])
    return [
        {"folder": str(folder), "words": ["convert", "mesh.msh", "-o", "mesh.h5", "--order", order], "options": {}},
        {"folder": str(folder), "words": ["run", "scene.toml", "-o", "out"], "options": {}},
        {"folder": str(folder), "words": ["run", "stored.toml", "-o", "out_stored"], "options": {}},
    ]


# -- a campaign --------------------------------------------------------------------------------------------


def mutated(number, seed, bases, place, targets=TARGETS):
    """One mutation in a folder of its own."""
    rng = np.random.default_rng([seed, number])
    base = bases[int(rng.integers(len(bases)))]
    weights = np.array([SHARES[target] for target in targets])
    target = str(rng.choice(targets, p=weights / weights.sum()))
    folder = place / f"mutation_{number}"
    shutil.copytree(base, folder, ignore=shutil.ignore_patterns("out*", "err*", "status*", "__pycache__"))
    words, options = ["run", "scene.toml", "-o", "results"], {}
    if target == "scene":
        text = scene_mutated(rng, folder)
    elif target == "msh":
        text = mesh_mutated(rng, folder)
    elif target == "h5":
        words[1] = "stored.toml"
        text = hdf5_mutated(rng, folder / "mesh.h5")
    else:
        (folder / "kept").mkdir()
        shutil.copy(base / "out" / "checkpoint.h5", folder / "kept")
        text, options = hdf5_mutated(rng, folder / "kept" / "checkpoint.h5"), {"restart": "kept"}
    return Mutation(number, target, f"{base.name}: {text}", folder, words, options)


def plainest(mutation):
    """The mutated input as the second reader has it, in a folder of its own; (folder, scene, mesh).

    Raises
    ------
    Unread
    """
    scene = read_toml((mutation.folder / "scene.toml").read_bytes())
    folder = mutation.folder / "plain"
    folder.mkdir()
    try:
        mesh = mesh_of((mutation.folder / scene["mesh"]["file"]).read_bytes())
        case = type("Case", (), {"scene": json.loads(json.dumps(scene))})
        case.scene["mesh"]["file"] = "mesh.msh"
        files = texts(case)
    except (KeyError, TypeError, AttributeError, OSError, ValueError) as error:
        raise Unread(f"{type(error).__name__}: {error}") from None
    (folder / "scene.toml").write_text(files["scene.toml"])
    (folder / "mesh.msh").write_text(msh_text(mesh))
    for path in mutation.folder.glob("*.py"):
        shutil.copy(path, folder)
    return folder, scene, mesh


def run_lines(jobs, ranks, work):
    """Statuses of all ranks, or what befell the process, for every job."""
    def collect(job):
        return json.loads((Path(job["folder"]) / "status.json").read_text())

    return supervised(HERE / "mutate_worker.py", jobs, ranks, work, collect)


def said(folder, ranks, name):
    """What all ranks wrote."""
    paths = [folder / f"{name}.{k}" for k in range(ranks)]
    return "".join(path.read_text(errors="replace") for path in paths if path.exists())


def verdict(mutation, status, ranks):
    """What is wrong with the end of a run, or None; not yet whether its numbers are right."""
    if isinstance(status, str):
        return status
    err, out = said(mutation.folder, ranks, "err"), said(mutation.folder, ranks, "out")
    for word in ("Traceback", "PETSC ERROR", "Segmentation", "MPI_ABORT"):
        if word in err or word in out:
            return f"{word}: {' '.join(err.split())[-200:]}"
    if len(set(status)) != 1 or status[0] not in (0, 1, 2):
        return f"exit statuses {status}"
    if status[0] == 2:
        lines = err.strip().splitlines()
        if len(lines) != 1 or not lines[0].startswith("pcontact: error: "):
            return f"status 2 with {len(lines)} lines: {err[:200]!r}"
        return None
    if mutation.target in ("h5", "checkpoint"):
        return f"status {status[0]}: not refused"
    return None


def report_of(folder):
    """The report of a run, None if there is none."""
    path = folder / "results" / "report.json"
    return json.loads(path.read_text()) if path.exists() else None


def numbers(report):
    """What is compared of two reports: (names, values)."""
    rows = []
    for step in report["steps"]:
        rows.append(("force", [step["time"], *[f for force in step["reactions"].values() for f in force]]))
        for contact in step["contacts"].values():
            rows.append(("force", contact["force"]))
        for name in sorted(step["probes"]):
            rows.append(("probe", step["probes"][name]["mean"]))
    return rows


def unlike(one, other, floor=0.0):
    """How two reports differ, None if they do not; forces by no less than `floor`."""
    if (one is None) != (other is None):
        return "one run has a report, the other has none"
    if one is None:
        return None
    for key in ("dofs", "cells", "converged"):
        if one[key] != other[key]:
            return f"{key}: {one[key]} and {other[key]}"
    a, b = numbers(one), numbers(other)
    if len(a) != len(b):
        return f"{len(a)} and {len(b)} rows"
    for kind in ("force", "probe"):
        x, y = ([np.array(v, dtype=float) for k, v in rows if k == kind] for rows in (a, b))
        largest = max([np.abs(v).max(initial=0.0) for v in x], default=0.0)
        worst = max([np.abs(p - q).max(initial=0.0) for p, q in zip(x, y, strict=True)], default=0.0)
        if not worst <= SAME * largest + (floor if kind == "force" else 0.0):
            return f"{kind} differs by {worst:g} of {largest:g}"
    return None


def judge(mutations, statuses, ranks, work):
    """Failures (mutation, text), and how runs ended."""
    failures, ends, accepted, jobs = [], Counter(), [], []
    for mutation, status in zip(mutations, statuses, strict=True):
        wrong = verdict(mutation, status, ranks)
        ends[f"{mutation.target}: {status if isinstance(status, str) else status[0]}"] += 1
        if wrong is not None:
            failures.append((mutation, wrong))
        elif status[0] in (0, 1):
            try:
                accepted.append((mutation, status[0], *plainest(mutation)))
            except Unread as error:
                failures.append((mutation, f"status {status[0]}, and the second reader says: {error}"))
    jobs = [{"folder": str(row[2]), "words": ["run", "scene.toml", "-o", "results"], "options": {}} for row in accepted]
    for row, again in zip(accepted, run_lines(jobs, 1, work), strict=True):
        mutation, status, folder, scene, mesh = row
        one, other = report_of(mutation.folder), report_of(folder)
        wrong = f"status {status}, of what the second reader read {again}"
        if again == [status]:
            wrong = unlike(one, other, lost(scene, mesh))
        if wrong is None and one is not None:
            wrong = "; ".join(complaints(scene, mesh, one)[:2]) or None
        if wrong is not None:
            failures.append((mutation, wrong))
    return failures, ends


def campaign(count, seed, ranks, say, out=None, targets=TARGETS):
    """Failures of some mutations on each of some numbers of ranks."""
    work = Path(tempfile.mkdtemp(prefix="pcontact_mutate_"))
    bases = [work / f"base_{k}" for k in range(len(BASES))]
    jobs = [job for k, base in enumerate(bases) for job in write_base(base, k)]
    for job, status in zip(jobs, run_lines(jobs, 1, work), strict=True):
        assert status == [0], f"{job}: {status}: {said(Path(job['folder']), 1, 'err')}"
    failures = []
    for n in ranks:
        place = work / f"ranks_{n}"
        place.mkdir()
        mutations = [mutated(number, seed, bases, place, targets) for number in range(count)]
        rows = [{"folder": str(m.folder), "words": m.words, "options": m.options} for m in mutations]
        found, ends = judge(mutations, run_lines(rows, n, work), n, work)
        for end, times in sorted(ends.items()):
            say(f"{n} ranks, {end}: {times} times")
        for mutation, text in found:
            say(f"FAILED on {n} ranks: mutation {mutation.number} of seed {seed} ({mutation.target})")
            say(f"    {mutation.text}: {text}")
            if out is not None:
                shutil.copytree(mutation.folder, out / f"{seed}_{mutation.number}_{n}", dirs_exist_ok=True)
        failures += found
    say(f"{count} mutations of seed {seed} on {ranks} ranks: {len(failures)} failures")
    shutil.rmtree(work, ignore_errors=True)
    return failures


def main(words=None):
    """The command line."""
    parser = argparse.ArgumentParser(description="damaged scenes, meshes and checkpoints")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 3])
    parser.add_argument("--targets", nargs="+", choices=TARGETS, default=TARGETS)
    parser.add_argument("-o", type=Path, default=None, help="directory for the input of failures")
    given = parser.parse_args(words)
    take_along()

    def say(text):
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    return 1 if campaign(given.count, given.seed, given.ranks, say, given.o, given.targets) else 0


if __name__ == "__main__":
    sys.exit(main())
