"""A minute of random scenes, and whether the judge would see what is wrong with one."""

import copy
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import fuzz
import numpy as np
import pytest
from grids import Elements, block, reference, symmetries, turned
from judge import differences, numbers_of, scales
from runner import environment, job_of, of_session, run_jobs
from scenes import kept, scene_of, texts
from variants import Motion, Variant, moved

pytestmark = pytest.mark.slow

# a slice of what `scripts/fuzz.sh` goes on with: in the plane and in space, small and finite strain, phases, friction
# that changes, follower loads, rubber, obstacles that move and turn
SEEDS = (20218, 20219, 20224, 20229)


def test_random_scenes_agree_with_themselves(tmp_path):
    """On three ranks, renumbered, mirrored, rotated, in other units, restarted, with another solver; each holds by
    itself, too."""
    cases = {seed: fuzz.prepared(seed) for seed in SEEDS}
    results = fuzz.run_scenes(cases, tmp_path)
    findings, steps = [], 0
    for seed, (case, variants) in cases.items():
        found, _ = fuzz.judged(case, variants, results[seed], tmp_path)
        findings += found
        steps += sum(len(result["steps"]) for result in results[seed].values())
        assert len(results[seed]) == len(variants) >= 8
    assert not findings, "\n".join(map(str, findings))
    assert steps > 20 * len(SEEDS)


@pytest.mark.parametrize(("seed", "variant"), [(18, "renumbered"), (20, "renumbered"), (1006, "ranks")],
                         ids=["multipliers", "held at corners", "facets of two kinds"])  # fmt: skip
def test_partners_are_those_of_the_solution(seed, variant, tmp_path):
    """Not those of the iterate that has looked for them: where means of multipliers are taken, and where points are
    held at corners. On ranks that have facets of one kind alone they are those of the others."""
    case, variants = fuzz.prepared(seed, only=variant, case=kept(fuzz.KEPT / str(seed)))
    results = fuzz.run_scenes({seed: (case, variants)}, tmp_path)[seed]
    findings, _ = fuzz.judged(case, variants, results, tmp_path)
    assert len(results) == 2 and not findings, "\n".join(map(str, findings))


def test_a_body_that_hangs_on_friction_of_open_points(tmp_path):
    """Nothing but Tresca's traction holds a loose block above another one: Newton's steps are as long as they are."""
    case, variants = fuzz.prepared(545, only="tight", case=kept(fuzz.KEPT / "545"))
    result = fuzz.run_scenes({545: (case, variants)}, tmp_path)[545]["tight"]
    assert result["status"] == "converged" and not result["cuts"][1:]


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """A case and what came out."""
    place = tmp_path_factory.mktemp("one")
    case = scene_of(3, {"arrangement": "stack", "bodies": 2, "drive": "moved", "gap1": "none", "phased": False})
    fuzz.write_case(place / "case", case)
    return case, run_jobs([job_of(place / "case")], 1, place)[0]


@pytest.mark.parametrize("what", ["u", "force", "energy", "pressure"])
def test_a_small_difference_is_seen(one, what):
    case, result = one
    plain = Variant("plain", case, {})
    first = numbers_of(result, plain, case)
    other = copy.deepcopy(result)
    row = other["steps"][-1]
    if what == "u":
        row["u"][np.abs(row["u"]).max(axis=1).argmax()] *= 1.0 + 1e-8
    elif what == "energy":
        row["energy"] *= 1.0 + 1e-6
    else:
        for contact in row["record"]["contacts"].values():
            contact["force"] = [f * (1.0 + 1e-8) for f in contact["force"]]
            contact["max_pressure"] *= 1.0 + 1e-8
    assert differences(first, numbers_of(result, plain, case), scales(case, first))[0][0] == 0.0
    worst = differences(first, numbers_of(other, plain, case), scales(case, first), kinds=(what,))
    assert worst[0][0] > 1e-9


def test_rounding_errors_are_no_difference(one):
    """Forces that the program itself takes for zero may differ, ten times as much may not."""
    case, result = one
    plain = Variant("plain", case, {})
    first = numbers_of(result, plain, case)
    for part, same in ((0.9, True), (10.0, False)):
        other = copy.deepcopy(result)
        for row in other["steps"]:
            for force in row["record"]["reactions"].values():
                force[0] += part * row["floor"]
        worst = differences(first, numbers_of(other, plain, case), scales(case, first), kinds=("force",))[0][0]
        assert (worst == 0.0) == same


def test_a_result_is_moved_back(one):
    """Numbers in other axes and units are those of the first scene again."""
    case, result = one
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])[: case.dim, : case.dim]
    motion = Motion(R, np.ones(case.dim), 1e3, 1e-6)
    other = copy.deepcopy(result)
    d = case.dim
    for row in other["steps"]:
        row["u"] = 1e3 * row["u"] @ R.T
        row["energy"] *= 1e-6 * 1e3**d
        record = row["record"]
        force = 1e-6 * 1e3 ** (d - 1)
        row["floor"] *= force
        record["reactions"] = {k: (force * R @ v).tolist() for k, v in record["reactions"].items()}
        for probe in record["probes"].values():
            probe["mean"] = (1e3 * R @ probe["mean"]).tolist()
        for contact in record["contacts"].values():
            contact["force"] = (force * R @ contact["force"]).tolist()
            if "moment" in contact:
                # about the origin, from where the scene has moved away
                own = R @ contact["moment"] if d == 3 else contact["moment"]
                contact["moment"] = (1e3 * force * own + np.cross(motion.shift, contact["force"])).tolist()
            contact["max_pressure"] *= 1e-6
            contact["max_penetration"] *= 1e3
    first = numbers_of(result, Variant("plain", case, {}), case)
    again = numbers_of(other, Variant("moved", moved(case, motion), {}, motion=motion), case)
    assert differences(first, again, scales(case, first))[0][0] < 1e-12


def test_what_has_several_solutions_and_says_so(tmp_path):
    """A slot whose sides yield while they close: the solvers come to different solutions."""
    case, variants = fuzz.prepared(110, only="plain", case=kept(fuzz.KEPT / "110"))
    # partners that are verified, or softer springs along the surface, lead all solvers to one of them
    former = {"contact_search_again": "0", "contact_alpha": "1"}
    variants = [replace(one, options={**one.options, **former}) for one in variants]
    results = fuzz.run_scenes({110: (case, variants)}, tmp_path)[110]
    findings, notes = fuzz.judged(case, variants, results, tmp_path)
    assert not findings and any(note.startswith("another solution: by strain") for note in notes)
    # without the program's word it is an error
    (tmp_path / "again").mkdir()
    for result in results.values():
        result["warnings"] = []
    findings, _ = fuzz.judged(case, variants, results, tmp_path / "again")
    assert [finding.kind for finding in findings] == ["differs"]


def test_solutions_that_are_not_stable_are_not_taken(tmp_path):
    """A slot closes in a load step so large that it has a solution which no slow motion comes to: all solvers find the
    other one."""
    case, variants = fuzz.prepared(488, only="plain", case=kept(fuzz.KEPT / "488"))
    former = {"contact_search_again": "0", "contact_traction": "source"}
    variants = [replace(one, options={**one.options, **former}) for one in variants]
    results = fuzz.run_scenes({488: (case, variants)}, tmp_path)[488]
    assert all(result["status"] == "converged" for result in results.values())
    findings, notes = fuzz.judged(case, variants, results, tmp_path)
    assert not findings, "\n".join(map(str, findings))


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("degree", [1, 2])
def test_other_numbers_are_the_same_cell(cell, degree):
    """Every symmetry maps the cell's nodes to themselves; half of them keep the sense."""
    n = {"triangle": 3, "quadrilateral": 4, "tetrahedron": 12, "hexahedron": 24}[cell]
    assert len(symmetries(cell, degree)) == len(symmetries(cell, degree, turned=True)) == n
    for order in symmetries(cell, degree):
        assert sorted(order) == list(range(len(reference(cell, degree))))
    mesh = block("b", cell, degree, [2] * len(reference(cell, 1)[0]))
    again = turned(turned(mesh))
    assert isinstance(again.bodies["b"][0], Elements)
    assert np.array_equal(np.sort(again.bodies["b"][0].nodes), np.sort(mesh.bodies["b"][0].nodes))


def test_a_seed_is_a_scene():
    """The same scene again and again, and many different ones; what a plan fixes leaves the rest."""
    assert texts(scene_of(7)) == texts(scene_of(7))
    assert len({texts(scene_of(seed))["scene.toml"] for seed in range(20)}) == 20
    first, planned = scene_of(2), scene_of(2, {"count": 4})
    first.scene["steps"]["count"] = 4
    assert texts(first) == texts(planned)


def test_what_the_scenes_have():
    """All kinds of contact, laws, formulations, cells and kinematics come up."""
    found = set()
    for seed in range(400):
        case = scene_of(seed)
        for key in ("loads", "displacements", "couplings", "pretensions", "phases", "bodies"):
            found |= {f"{key} {name}" for table in case.scene.get(key, []) for name in table}
        found |= case.scene.keys() | ({"expression"} if "Formula(" in repr(case.scene) else set())
        for contact in case.scene.get("contacts", []):
            obstacle = contact.get("obstacle", {})
            shape = obstacle.get("shape", "none")
            found |= {f"obstacle {name}" for name in obstacle}
            found |= {shape, *contact, str(contact.get("theta")), contact.get("formulation"), contact.get("search")}
            found.add("self" if contact.get("source") == contact.get("target") else "two surfaces")
        for material in case.scene["materials"].values():
            found |= set(material) | {material.get("law", "hencky")}
        found |= {e.cell for groups in case.mesh.bodies.values() for e in groups}
        found |= {case.scene["mesh"].get("kinematics"), "finite" if case.finite else "small"}
    assert found >= {
        "plane", "sphere", "cylinder", "level_set", "tied", "bilateral", "unbiased", "all", "self", "self_contact",
        "friction", "friction_limit", "adhesion", "tresca", "1", "0", "-1", "penalty", "augmented_lagrangian",
        "ray_tracing", "cut", "interference", "yield_stress", "hardening", "hardening_curve", "kinematic_hardening",
        "triangle", "quadrilateral", "tetrahedron", "hexahedron", "plane_stress", "axisymmetric",
        "small", "finite", "expression", "springs", "temperatures", "expansion", "density", "neo_hooke",
        "mooney_rivlin", "ogden", "axes", "angle", "point", "loads follower", "loads force", "loads acceleration",
        "displacements angle", "couplings average", "couplings rotation", "pretensions force", "pretensions shortening",
        "phases friction", "phases tied", "bodies phases", "obstacle angle", "obstacle displacement", "punch", "wedge",
        "cone", "torus",
    }  # fmt: skip


def test_shrinking_ends_at_the_smallest_scene(tmp_path, monkeypatch):
    """With a failure that any scene with friction has, nothing but friction is left."""

    def fails(finding, plan, work, number):
        contacts = scene_of(finding.seed, plan).scene.get("contacts", [])
        again = fuzz.Finding(finding.seed, "plain", "differs", "by much", plan)
        return again if any(c.get("friction") for c in contacts) else None

    monkeypatch.setattr(fuzz, "fails", fails)
    seed = next(k for k in range(100) if any(c.get("friction") for c in scene_of(k).scene["contacts"]))
    small = fuzz.shrunk(fuzz.Finding(seed, "plain", "differs", "by much"), tmp_path, attempts=1000)
    case = scene_of(seed, small.plan)
    assert case.dim == 2 and len(case.scene["bodies"]) == 1 and case.scene["steps"]["count"] == 1
    assert any(c.get("friction") for c in case.scene["contacts"])


WORKER = """\
import os, pathlib, signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
pathlib.Path(sys.argv[1] + ".pid").write_text(str(os.getpid()))
time.sleep(100)
"""
SUPERVISOR = """\
import pathlib, sys
from runner import supervised, take_along
take_along()
supervised(pathlib.Path(sys.argv[1]), [{}], 1, pathlib.Path(sys.argv[2]), None)
"""


def test_a_campaign_that_is_stopped_takes_its_processes_along(tmp_path):
    """Also one that does not hear SIGTERM."""
    (tmp_path / "worker.py").write_text(WORKER)
    words = [sys.executable, "-c", SUPERVISOR, str(tmp_path / "worker.py"), str(tmp_path)]
    process = subprocess.Popen(words, cwd=Path(__file__).parent, env=environment())
    while not (found := [file.read_text() for file in tmp_path.glob("*.pid")]) or not found[0]:
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 128 + signal.SIGTERM
    assert not of_session(int(found[0]))
