"""Whether the checks of one run see what is wrong with it, and whether what a scene has moves as it should."""

import copy

import checks
import fuzz
import numpy as np
import pytest
from formulas import Formula, combined
from grids import block, msh_text, read_msh, sectioned
from runner import job_of, run_jobs
from scenes import Case, kept, scene_of, texts
from variants import TIGHT, Motion, Variant, moved

MIRROR = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("formulation", ["augmented_lagrangian", "nitsche"])
def test_one_variant_that_stops_where_nothing_is_promised(monkeypatch, tmp_path, formulation):
    """No finding, whichever of the variants it is: another stop of the same cause."""
    case = Case(1, {"materials": {}, "contacts": [{"formulation": formulation}]}, None)
    wrong = fuzz.Finding(1, "plain", "status", "stopped became converged")
    monkeypatch.setattr(fuzz, "absolute", lambda *arguments: [])
    monkeypatch.setattr(fuzz, "uniqueness", lambda *arguments: [1.0])
    monkeypatch.setattr(fuzz, "_compared", lambda *arguments: wrong)
    variants = [Variant("tight", case, {}, against=""), Variant("plain", case, {})]
    results = {"tight": {"status": "stopped", "cuts": []}, "plain": {"status": "converged", "cuts": []}}
    findings, notes = fuzz.judged(case, variants, results, tmp_path)
    promised = formulation == "nitsche"
    assert [finding.kind for finding in findings] == (["stopped", "status"] if promised else [])
    assert len(notes) == (0 if promised else 2)


def test_a_formula_moves_with_the_places():
    one = Formula.of("exp(-0.3*x) + y*t", 2, 2.0)
    motion = Motion(np.array([[0.6, -0.8], [0.8, 0.6]]), np.array([3.0, -1.0]), 10.0, 1.0)
    x = np.random.default_rng(1).normal(size=(5, 2))
    there = 10.0 * x @ motion.R.T + motion.shift
    assert np.allclose(one.moved(motion)(there, 0.7), one(x, 0.7), rtol=1e-12)
    assert np.allclose(Formula.of(one.moved(motion).text(), 2)(there, 0.7), one(x, 0.7), rtol=1e-12)
    total = combined([0.5, 2.0], [one, 1.0])
    assert np.allclose(total(x, 0.7), 0.5 * one(x, 0.7) + 2.0)


@pytest.mark.parametrize("seed", range(80))
def test_a_motion_and_its_inverse_leave_the_scene(seed):
    """Mirrored, in other units and back: vectors, points, turns, expressions, frames, units."""
    case = scene_of(20000 + seed)
    d = case.dim
    R = np.diag([1.0, -1.0]) if case.axial else MIRROR[:d, :d]
    away = Motion(R, np.zeros(d), 100.0, 1e6)
    back = Motion(R.T, np.zeros(d), 0.01, 1e-6)
    again = moved(moved(case, away), back)
    assert np.allclose(again.mesh.points, case.mesh.points)
    _alike(again.scene, case.scene, case.mesh.points)


def _alike(a, b, x, key=""):
    """Tables are alike but for rounding. Axes of materials may be said in another way."""
    if isinstance(b, dict) and isinstance(b.get("E"), list) and "point" not in b:
        assert np.allclose(np.abs(_frame(a)), np.abs(_frame(b))), key
        a, b = ({k: v for k, v in one.items() if k not in ("angle", "axes")} for one in (a, b))
    if isinstance(b, dict):
        assert set(a) == set(b), key
        for name, value in b.items():
            _alike(a[name], value, x, name)
    elif isinstance(b, list) and not any(isinstance(v, Formula) for v in b):
        assert len(a) == len(b), key
        for one, other in zip(a, b, strict=True):
            _alike(one, other, x, key)
    elif isinstance(b, list):
        for one, other in zip(a, b, strict=True):
            _alike(one, other, x, key)
    elif isinstance(b, Formula):
        assert np.allclose(a(x, 0.4), b(x, 0.4)), key
    elif isinstance(b, float):
        assert a == pytest.approx(b, rel=1e-9, abs=1e-12), key
    else:
        assert a == b, key


def _frame(table):
    """Projector onto axis 1, and normal of the plane of axes 1 and 2 but for its sense."""
    angle = np.radians(table.get("angle", 0.0))
    turned = [[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0]]
    one, other = np.array(table.get("axes", turned))
    normal = np.cross(one, other)
    return np.vstack([np.outer(one, one) / (one @ one), np.outer(normal, normal) / (normal @ normal)])


@pytest.mark.parametrize("d", [2, 3])
def test_the_axes_of_a_material_turn_with_it(d):
    R = np.linalg.qr(np.random.default_rng(3).normal(size=(d, d)))[0]
    material = {"E": [1.0, 2.0, 3.0], "nu": [0.1] * 3, "G": [1.0] * 3, "angle": 30.0}
    scene = {"mesh": {}, "materials": {"m": material}}
    case = Case(1, scene, block("b", "quadrilateral" if d == 2 else "hexahedron", 1, [1] * d))
    turn = np.eye(3)
    turn[:d, :d] = R
    before, after = (np.split(_frame(one.scene["materials"]["m"]), 2)
                     for one in (case, moved(case, Motion(R, np.zeros(d)))))  # fmt: skip
    assert all(np.allclose(turn @ a @ turn.T, b) for a, b in zip(before, after, strict=True))


def test_what_is_written_is_read():
    mesh = sectioned(block("b", "tetrahedron", 2, [2, 1, 1]), "b", 0)
    assert msh_text(read_msh(msh_text(mesh))) == msh_text(mesh)
    area = checks.integration_points(mesh.facets["b_section"], mesh.points, False)[1].sum()
    assert area == pytest.approx(1.0)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("degree", [1, 2])
def test_integrals_and_distances(cell, degree):
    """Volume, area vector and the pressure on a side of a block; points inside and their distance from the surface."""
    d = 2 if cell in ("triangle", "quadrilateral") else 3
    mesh = block("b", cell, degree, [2] * d)
    x, size, _ = checks.integration_points(mesh.bodies["b"], mesh.points, False)
    assert size.sum() == pytest.approx(1.0) and (x[:, 0] * size).sum() == pytest.approx(0.5)
    scene = {"mesh": {}, "bodies": [{"region": "b"}], "steps": {"end": 1.0}}
    table = {"region": "b_x1", "pressure": Formula.of("1 + y", d)}
    force = checks.applied(Case(1, scene, mesh), table, 1.0)
    assert np.allclose(force, [-1.5, *[0.0] * (d - 1)])
    places = np.full((3, d), 0.45)
    places[:, 0] = [0.1, 0.9, 1.2]
    assert checks.within(places, mesh.bodies["b"], mesh.points).tolist() == [True, True, False]
    pieces = checks._straight(checks.boundary(mesh, "b"), mesh.points)
    assert np.allclose(checks.distances(places, pieces), [0.1, 0.1, 0.2])


def test_sizes_are_those_of_facets_near_by():
    """Of a segment on which a point is, and of the shorter one where two meet."""
    pieces = np.array([[[0.0, 0.0], [1.0, 0.0]], [[1.0, 0.0], [1.0, 0.1]], [[0.0, 0.0], [0.0, 3.0]]])
    assert np.allclose(checks.size_near(np.array([[0.5, 0.1], [1.0, 0.0], [-0.2, 2.0]]), pieces), [1.0, 0.1, 3.0])


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """A block on another one, and what came out."""
    place = tmp_path_factory.mktemp("pressed")
    plan = {"dim": 2, "arrangement": "stack", "bodies": 2, "floor": False, "kind0": "pair", "kind1": "pair",
            "gap1": "none", "drive": "pressed", "strain": "small", "phased": False, "springs": False, "bolt": False,
            "weight": False, "heated": False, "side": False, "pair1.adjust": False,
            "kinematics": "plane_strain", "inertia": False}  # fmt: skip
    case = scene_of(20007, plan)
    fuzz.write_case(place / "case", case)
    return case, run_jobs([job_of(place / "case", TIGHT)], 1, place)[0]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["momentum", "energy"])
def test_what_is_wrong_with_a_motion_is_seen(tmp_path, kind):
    """A force that is not there, and energy that is missing, of a block that flies at an obstacle."""
    plan = {"dim": 2, "inertia": True, "flight": True, "bodies": 1, "strain": "small", "heated": False,
            "low.yields": False, "low.is rubber": False, "inertia.auto": False, "bulge": 0.0,
            "floor.shape": "plane"}  # fmt: skip
    case = scene_of(20007, plan)
    fuzz.write_case(tmp_path / "case", case)
    result = run_jobs([job_of(tmp_path / "case", TIGHT)], 1, tmp_path)[0]
    assert checks.check(case, result) == []

    def change(row):
        force = row["record"]["contacts"]["floor"]["force"]
        if kind == "momentum":
            force[:] = [0.5 * one for one in force]
        else:
            row["record"]["energy"]["defect"] = 1e-6

    assert any(np.any(row["record"]["contacts"]["floor"]["force"]) for row in result["steps"])
    assert kind in {found for found, _ in checks.check(case, _changed(result, change))}


@pytest.mark.slow
def test_nothing_is_wrong_with_a_good_run(pressed):
    assert checks.check(*pressed) == []


def _changed(result, change):
    result = copy.deepcopy(result)
    for row in result["steps"]:
        change(row)
    return result


def _sunk(case):
    def change(row):
        upper = np.unique(case.mesh.bodies["middle"][0].nodes)
        row["u"][np.isin(row["nodes"], upper), -1] -= 0.3

    return change


def _lifted(case):
    def change(row):
        upper = np.unique(np.concatenate([e.nodes.ravel() for e in case.mesh.bodies["middle"]]))
        row["u"][np.isin(row["nodes"], upper), -1] += 0.3

    return change


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["unbalanced", "sum of points", "inside", "force without touch", "no iterations",
                                  "false warning"])  # fmt: skip
def test_what_is_wrong_is_seen(pressed, kind):
    case, result = pressed
    changes = {
        "unbalanced": lambda row: row["record"]["reactions"]["low_y0"].__setitem__(1, 0.0),
        "sum of points": lambda row: row["record"]["contacts"]["pair 1"]["force"].__setitem__(1, 0.0),
        "inside": _sunk(case),
        "force without touch": _lifted(case),
        "no iterations": lambda row: row["record"].__setitem__("newton", 0),
        "false warning": lambda row: None,
    }
    wrong = _changed(result, changes[kind])
    if kind == "false warning":
        wrong["warnings"] = ["time 1: the forces are out of balance by 2 %"]
    assert kind in {found for found, _ in checks.check(case, wrong)}
    if kind == "force without touch":
        # cells that strain so much press from a distance
        for row in wrong["steps"]:
            row["record"]["small_strain"] = {"middle": {"strain": 10.0}}
        assert kind not in {found for found, _ in checks.check(case, wrong)}


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "variant"), [
    (5602, "tight"), (5674, "rotated"), (20241, "tight"),
    *(pytest.param(seed, "tight", marks=pytest.mark.xfail(reason="a load step does not converge", strict=True))
      for seed in (5657, 5679)),
])  # fmt: skip
def test_scenes_that_were_kept(seed, variant, tmp_path):
    """Finite strain, and friction or yielding; a body that goes by above another one: they converge, and runs agree."""
    case, variants = fuzz.prepared(seed, only=variant, case=kept(fuzz.KEPT / str(seed)))
    results = fuzz.run_scenes({case.seed: (case, variants)}, tmp_path)[case.seed]
    findings, _ = fuzz.judged(case, variants, results, tmp_path)
    assert not findings, "\n".join(map(str, findings))


def test_kept_scenes_are_read_as_they_are():
    for folder in fuzz.KEPT.iterdir():
        again = texts(kept(folder))["scene.toml"]
        assert again.split() == (folder / "scene.toml").read_text().split()
