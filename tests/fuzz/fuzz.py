"""Random scenes against themselves: ``python tests/fuzz/fuzz.py [--seconds S] [--scenes N] [--seed N] [-j N]``.

Every scene (scenes.py) runs with a direct solver and a small tolerance, then in other ways (variants.py): on three
ranks, renumbered, mirrored, rotated and moved, in other units, restarted, with the program's own solver, with source
and target swapped, with an error estimate. The numbers have to agree (judge.py), and what must hold in each run by
itself does (checks.py). A failure is shrunk: feature after feature is replaced by the simplest one, as long as the
scene still fails. What is left goes to a directory, with the command that repeats it.

With ``--log FILE`` every scene leaves a line there when it is over, and one that has a line is not run again: a
campaign that was ended goes on. ``--kept`` runs the scenes in tests/fuzz/kept instead, which have failed once.

The exit status is 1 if there was a failure.
"""

import argparse
import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from checks import check, phases_of
from grids import msh_text
from judge import SINGULAR, differences, numbers_of, scales
from runner import job_of, run_jobs, take_along
from scenes import kept, scene_of, texts
from variants import TIGHT, in_units, variants_of

HERE = Path(__file__).resolve().parent
KEPT = HERE / "kept"
# [-] Differences that partners of contact may make, in parts of those that the load steps have left: of two runs
PARTNERS = 2.0
# [-] Tolerance of partners with which runs are taken again that differ
FINE = "1e-8"
# scenes of one round: their runs share a process
ROUND = 5


@dataclass
class Finding:
    """Something wrong with a scene: `variant` is the run that shows it, `kind` in one word, `text` the numbers."""

    seed: int
    variant: str
    kind: str
    text: str
    plan: dict = field(default_factory=dict)

    def __str__(self):
        more = f" --plan '{json.dumps(self.plan)}'" if self.plan else ""
        return (f"seed {self.seed}, {self.variant}: {self.kind}: {self.text}\n"
                f"    repeat: python tests/fuzz/fuzz.py --seed {self.seed} --scenes 1{more}")  # fmt: skip


def write_case(folder, case):
    """The files of a case."""
    folder.mkdir(parents=True)
    for name, text in texts(case).items():
        (folder / name).write_text(text)
    (folder / "mesh.msh").write_text(msh_text(case.mesh))


def prepared(seed, plan=None, only=None, case=None):
    """The case of a seed in units of its own, or one that was kept, and its variants."""
    rng = np.random.default_rng([seed, 1])
    drawn = in_units(scene_of(seed, plan) if case is None else case, rng)
    # one that was kept has its units, and the variants that it had
    case = drawn if case is None else case
    variants = variants_of(case, rng)
    if only is not None:
        wanted = {only, *(v.against for v in variants if v.name == only), "tight"}
        variants = [v for v in variants if v.name in wanted]
    return case, variants


def jobs_of(folder, variants):
    """Files and jobs of all variants; the first one keeps its checkpoints."""
    jobs = []
    for variant in variants:
        place = folder / variant.name.replace(", ", "_")
        case = variant.case
        if not variant.against or variant.restart is not None:
            # a restart is refused where the scene is another one
            case = case.copy()
            case.scene["output"]["checkpoint"] = True
        write_case(place, case)
        jobs.append(job_of(
            place, variant.options, restart=variant.restart, of=folder / variant.against,
            checkpoint=not variant.against, write=variant.name == "estimated",
        ))  # fmt: skip
    return jobs


def run_scenes(cases, work):
    """Results of all variants of several cases: {seed: {variant: result}}."""
    lists = {}
    for seed, (_, variants) in cases.items():
        for variant, job in zip(variants, jobs_of(work / str(seed), variants), strict=True):
            lists.setdefault(variant.ranks, []).append((seed, variant.name, job))
    results = {seed: {} for seed in cases}
    for ranks, rows in sorted(lists.items()):
        found = run_jobs([job for *_, job in rows], ranks, work)
        for (seed, name, _), result in zip(rows, found, strict=True):
            results[seed][name] = result
    return results


# -- the verdict -------------------------------------------------------------------------------------------


def unpromised(case):
    """What a scene has that may end in a load step that does not converge; None: such an end is a failure.

    Multipliers need not settle. The residual of the consistent adjoint jumps where a cell yields.
    """
    contacts = case.scene.get("contacts", [])
    if any(c.get("formulation") == "augmented_lagrangian" for c in contacts):
        return "augmented Lagrangian"
    yields = any("yield_stress" in m or "hardening_curve" in m for m in case.scene["materials"].values())
    return "consistent adjoint" if yields and any(c.get("adjoint") == "consistent" for c in contacts) else None


def remembers(case):
    """Whether a scene has friction: what comes after a solution that is not unique depends on which one it was."""
    return any(c.get("friction") or c.get("tresca") for c in case.scene.get("contacts", []))


def uniqueness(case, work, number):
    """Smallest singular value of the tangent at every load step."""
    place = work / f"tangent_{number}"
    write_case(place, case)
    result = run_jobs([job_of(place, TIGHT, tangent=True)], 1, work)[0]
    return [row["singular"] for row in result["steps"]]


def another(case, variant, result, work):
    """Whether a result of the program's own solver is a solution beside another one, in a scene of which the program
    says that it may have several: iterated until rounding errors end it, it stays where it is.
    """
    said = any("more than one solution" in line for line in result["warnings"])
    if not said or "snes_rtol" in variant.options:
        return False
    place = work / f"again_{case.seed}_{variant.name.replace(', ', '_')}"
    write_case(place, variant.case)
    again = run_jobs([job_of(place, {**variant.options, "snes_rtol": TIGHT["snes_rtol"]})], variant.ranks, work)[0]
    return _compared(case, variant, variant, result, again) is None


def settled(case, variant, reference, work):
    """Whether two runs have the same numbers where partners are found as well as can be.

    Their tolerance is for the forces of whole contacts: that much of them may be on one point, whose pressure, often
    the largest, changes by as many times as much as there are points. Restarted runs have a beginning of their own.
    """
    if variant.restart is not None or "contact_partner_rtol" not in variant.options:
        return False
    results = []
    for one in (reference, variant):
        place = work / f"settled_{case.seed}_{variant.name.replace(', ', '_')}_{len(results)}"
        write_case(place, one.case)
        results += run_jobs([job_of(place, {**one.options, "contact_partner_rtol": FINE})], one.ranks, work)
    return _compared(case, variant, reference, *results) is None


def judged(case, variants, results, work):
    """Findings, and notes of what was left out with its reason."""
    findings, notes, by_name = [], [], {v.name: v for v in variants}
    for variant in variants:
        result = results[variant.name]
        if result["status"] in ("crashed", "hung", "refused"):
            text = " ".join(result["text"].split())[-400:]
            findings.append(Finding(case.seed, variant.name, result["status"], text))
            if not variant.against:
                return findings, notes
        seen = {finding.kind for finding in findings}
        findings += [Finding(case.seed, variant.name, *row) for row in absolute(variant, result) if row[0] not in seen]
    status = results["tight"]["status"]
    if status == "stopped":
        reason = (results["tight"]["cuts"] or [(0.0, "before any load step")])[-1][1]
        if unpromised(case) is not None:
            notes.append(f"{unpromised(case)} stopped: {reason[:60]}")
        else:
            findings.append(Finding(case.seed, "tight", "stopped", reason))
    singular = None
    for variant in variants:
        if not variant.against or results[variant.name]["status"] not in ("converged", "stopped"):
            continue
        base = results[variant.against]
        if base["status"] not in ("converged", "stopped"):
            continue
        wrong = _compared(case, variant, by_name[variant.against], base, results[variant.name])
        if wrong is None:
            continue
        if wrong.kind == "path":
            notes.append(f"path: {wrong.text}")
            continue
        if wrong.kind == "status" and unpromised(case) is not None:
            notes.append(f"{unpromised(case)}: {wrong.text}")
            continue
        if singular is None:
            singular = uniqueness(case, work, case.seed)
        first = next((k for k, value in enumerate(singular) if value < SINGULAR), None)
        if first is not None and wrong.kind == "differs":
            wrong = _compared(case, variant, by_name[variant.against], base, results[variant.name], first)
            notes.append(f"not unique from load step {first + 1} on")
        if wrong is not None and wrong.kind == "differs" and another(case, variant, results[variant.name], work):
            notes.append(f"another solution: {wrong.text}")
        elif wrong is not None and wrong.kind == "differs" and settled(case, variant, by_name[variant.against], work):
            notes.append(f"the tolerance of partners: {wrong.text}")
        elif wrong is not None:
            findings.append(wrong)
    return findings, notes


def absolute(variant, result):
    """What is wrong with one run by itself: (kind, text). One of each kind of run is enough."""
    if variant.restart is not None or variant.name not in ("tight", "plain", "ranks", "swapped"):
        return []
    return check(variant.case, result, "snes_rtol" in variant.options)


def _compared(case, variant, reference, base, result, singular=None):
    """A finding, or None. After the load step `singular` the solution is not unique."""
    a, b = numbers_of(base, reference, case), numbers_of(result, variant, case)
    skip = 0
    if variant.restart is not None:
        skip = len(a.times) - len(b.times)
        if result.get("restarted") is None:
            return None
    if base["status"] != result["status"]:
        return Finding(case.seed, variant.name, "status", f"{base['status']} became {result['status']}")
    scale = scales(case, a)
    end = phases_of(case.scene)[-1][2]
    same = len(a.times) - skip == len(b.times) and np.allclose(a.times[skip:], b.times, rtol=0, atol=1e-9 * end)
    if not same:
        cut = (sum(r["cutbacks"] for r in base["steps"]), sum(r["cutbacks"] for r in result["steps"]))
        lengths = f"{len(a.times)} and {len(b.times)} load steps"
        text = f"{variant.name}: {cut[0]} and {cut[1]} cut backs in {lengths} to {end:g}"
        return Finding(case.seed, variant.name, "path", text)
    parts = [(slice(skip, None), None)]
    if singular is not None:
        parts = [(slice(skip, max(singular, skip)), None)]
        if not remembers(case):
            parts.append((slice(max(singular, skip), None), ("force",)))
    worst = []
    for steps, kinds in parts:
        other = b.at(slice(steps.start - skip, None if steps.stop is None else steps.stop - skip))
        more = {} if kinds is None else {"kinds": kinds}
        worst += differences(a.at(steps), other, scale, **more)
    left = [row["record"].get("partners", {}).get("change", 0.0) for run in (base, result) for row in run["steps"]]
    # forces that one load step of a motion gets wrong are a velocity of all later ones, which adds up once more
    many = len(a.times) * (len(a.times) + 1) // 2 if "dynamics" in case.scene else 1
    allowed = many * max([variant.tolerance, *(PARTNERS * part for part in left)])
    bad = [f"{key} {value:.1e}" for value, key in sorted(worst, reverse=True) if value > allowed]
    if not bad:
        return None
    return Finding(case.seed, variant.name, "differs", f"by {', '.join(bad[:4])} (allowed {allowed:g})")


# -- shrinking ---------------------------------------------------------------------------------------------

# the simplest value of a draw, by the end of its name
SIMPLE = [
    ("inertia", False), ("flight", False), ("strain", "small"), ("phased", False), ("heated", False), ("bolt", False),
    ("springs", False), ("on springs", False), ("side", False), ("said", False), ("orthotropic", False),
    ("is rubber", False), ("turns", False), ("newton", False),
    ("dim", 2), ("arrangement", "stack"), ("bodies", 2), ("bodies", 1), ("degree", 1), ("order", 1),
    ("kinematics", "plane_strain"), ("count", 1), ("end", 1.0), ("floor", False), ("cell", "quadrilateral"),
    ("cell", "hexahedron"), ("curved", (0, 0)), ("jitter", 0.0), ("grade", 0.0), ("yields", False),
    ("stiff volume", False), ("auxetic", False), ("nu", 0.3), ("E", 1.0), ("law", "none"), ("law", "coulomb"),
    ("formulation", "nitsche"), ("theta", 0), ("consistent", False), ("gamma0 said", False), ("alpha said", False),
    ("quadrature said", False), ("ray", False), ("cut", None), ("kind1", "pair"), ("kind2", "pair"),
    ("kind0", "pair"), ("amplitude", None), ("no shear", True), ("drive", "moved"), ("shape", "plane"),
    ("moves", False), ("weight", False), ("mean", False), ("gap1", "none"), ("gap2", "none"), ("width", 1.0),
    ("off", 0.0), ("height", 1.0), ("flip", False), ("place", 0.0), ("swap", False), ("adjust", False),
    ("hardening", "isotropic"), ("n0", 1), ("n1", 1), ("n2", 1), ("n0", 2), ("n1", 2), ("depth", 0.02),
    ("friction", 0.3), ("gradient", False), ("kinematics said", False),
    ("warm said", False), ("force said", False), ("mass", False), ("tilts", False), ("follows", False), ("steps", 1),
    ("as a tool", False), ("bulge", False), ("slant", 0.0), ("aside", 0.0), ("gap", 0.0), ("tool", "punch"),
]  # fmt: skip


def drawn_names(seed, plan):
    """Names and values of all draws of a scene; None where the plan makes none (a quadrilateral in space)."""
    names = {}

    class Spy(dict):
        def get(self, name, default=None):
            names[name] = super().get(name, default)
            return names[name]

    try:
        scene_of(seed, Spy(plan))
    except (KeyError, ValueError, IndexError):
        return None
    return names


def fails(finding, plan, work, number):
    """The finding of the same variant and kind with another plan, or None."""
    case, variants = prepared(finding.seed, plan, finding.variant)
    place = work / f"shrink_{finding.seed}_{number}"
    results = run_scenes({finding.seed: (case, variants)}, place)[finding.seed]
    found, _ = judged(case, variants, results, place)
    shutil.rmtree(place, ignore_errors=True)
    same = [f for f in found if (f.variant, f.kind) == (finding.variant, finding.kind)]
    return Finding(finding.seed, finding.variant, finding.kind, same[0].text, plan) if same else None


def shrunk(finding, work, attempts=60):
    """The finding of the smallest scene that still fails."""
    plan, number = dict(finding.plan), 0
    for end, value in SIMPLE:
        for name, now in drawn_names(finding.seed, plan).items():
            if (name == end or name.endswith(f".{end}")) and now != value and number < attempts:
                if drawn_names(finding.seed, {**plan, name: value}) is None:
                    continue
                number += 1
                smaller = fails(finding, {**plan, name: value}, work, number)
                if smaller is not None:
                    finding, plan = smaller, smaller.plan
    return finding


def leave(finding, out):
    """Scene, mesh and command of a finding in a directory; both runs where it takes two."""
    case, variants = prepared(finding.seed, finding.plan, finding.variant)
    place = out / f"{finding.seed}_{finding.variant.replace(', ', '_').replace(' ', '_')}_{finding.kind}"
    shutil.rmtree(place, ignore_errors=True)
    lines = [str(finding), ""]
    for variant in variants:
        jobs_of(place, [variant])
        start = "" if variant.ranks == 1 else f"mpirun -n {variant.ranks} "
        words = " ".join(f"-{k} {v}" for k, v in variant.options.items())
        lines.append(f"{start}python -m pcontact run {variant.name.replace(', ', '_')}/scene.toml {words}")
    (place / "README.txt").write_text("\n".join([*lines, ""]))
    return place


# -- a campaign --------------------------------------------------------------------------------------------


def round_of(seeds, plan, work):
    """Findings, notes, number of load steps of some seeds, by seed; a Path is the folder of a scene that was kept."""
    place = Path(tempfile.mkdtemp(dir=work))
    cases = {}
    for seed in seeds:
        case, number = (kept(seed), int(seed.name)) if isinstance(seed, Path) else (None, seed)
        cases[number] = prepared(number, plan, case=case)
    results = run_scenes(cases, place)
    out = {}
    for seed, (case, variants) in cases.items():
        findings, notes = judged(case, variants, results[seed], place)
        for finding in findings:
            finding.plan = dict(plan or {})
        out[seed] = findings, notes, sum(len(r["steps"]) for r in results[seed].values())
    shutil.rmtree(place, ignore_errors=True)
    return out


def over(log):
    """Seeds that have a line in a log."""
    return {json.loads(line)["seed"] for line in log.read_text().splitlines()} if log and log.exists() else set()


def campaign(seeds, given, say):
    """Scenes until their number or the time is reached; all findings."""
    begin, findings, notes, count, steps = time.monotonic(), [], Counter(), 0, 0
    work = Path(tempfile.mkdtemp(prefix="pcontact_fuzz_"))
    done = over(given.log)
    seeds = [seed for seed in seeds if seed not in done]
    size = min(ROUND, max(1, len(seeds) // max(given.j, 1)))
    rounds = [seeds[k : k + size] for k in range(0, len(seeds), size)]
    with ThreadPoolExecutor(given.j) as pool:

        def turn(some):
            return {} if time.monotonic() - begin > given.seconds else round_of(some, given.plan, work)

        for found in pool.map(turn, rounds):
            for seed, (new, more, n) in found.items():
                count, steps = count + 1, steps + n
                findings += new
                notes.update(more)
                for finding in new:
                    say(str(finding))
                if given.log:
                    line = {"seed": seed, "findings": [[f.variant, f.kind, f.text] for f in new], "notes": more}
                    with open(given.log, "a") as stream:
                        stream.write(json.dumps(line) + "\n")
            if found:
                say(f"{count} scenes, {len(findings)} findings, {time.monotonic() - begin:.0f} s")
    wrong = len({finding.seed for finding in findings})
    say(f"{count} scenes, {steps} load steps, {wrong} scenes with findings")
    for note, n in sorted(notes.items()):
        say(f"    {n} times: {note}")
    if given.o is not None and not given.kept:
        for finding in _each_once(findings):
            small = shrunk(finding, work)
            say(f"shrunk: {small}\n    left in {leave(small, given.o)}")
    shutil.rmtree(work, ignore_errors=True)
    return findings


def _each_once(findings):
    """One finding for each seed, of the first run that shows it."""
    return list({finding.seed: finding for finding in reversed(findings)}.values())


def main(words=None):
    """The command line."""
    parser = argparse.ArgumentParser(description="random scenes, each run in many ways that must agree")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no scene begins after this time")
    parser.add_argument("--scenes", type=int, default=100000, help="how many (default: until the time is over)")
    parser.add_argument("--seed", type=int, default=1, help="of the first scene; they count up")
    parser.add_argument("-j", type=int, default=1, help="processes beside each other")
    parser.add_argument("--plan", type=json.loads, default=None, help="draws that are fixed, in JSON")
    parser.add_argument("-o", type=Path, default=None, help="directory for shrunk failures (default: none)")
    parser.add_argument("--log", type=Path, default=None, help="file with a line for every scene that is over")
    parser.add_argument("--kept", action="store_true", help="the scenes that were kept instead of new ones")
    given = parser.parse_args(words)
    take_along()

    def say(text):
        sys.stdout.write(text + "\n")
        sys.stdout.flush()

    seeds = sorted(KEPT.iterdir()) if given.kept else range(given.seed, given.seed + given.scenes)
    return 1 if campaign(seeds, given, say) else 0


if __name__ == "__main__":
    sys.exit(main())
