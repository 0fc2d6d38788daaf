"""The trade of speed for accuracy: fronts, what settings pay, errors against an overkill mesh, promises."""

import json

import numpy as np
import pytest

from drivers._common import make_directory, make_mesh, parse, running
from drivers.cases.rings import ring_scene
from drivers.studies._overkill import Overkill
from drivers.studies._pareto import cheapest, front, rounded_up
from drivers.studies._trade_cases import CASES, HELD_OUT, linear
from drivers.studies._trade_report import judged, promises
from drivers.studies._trade_runs import changed, paying
from drivers.studies.tradeoff import MARK, kept, make_options, run
from meshes import one_block, rings
from pcontact.runtime.errors import InputError
from pcontact.scene.model import Body, Displacement, Load, Material, MeshSpec, Output, Scene

pytestmark = pytest.mark.slow


def test_front():
    cost, error = [4.0, 1.0, 2.0, 3.0, 2.0, 5.0, np.nan], [1.0, 9.0, 5.0, 5.0, 4.0, 1.0, 0.0]
    # 2.0 with 4 beats 2.0 with 5, 5.0 is dearer than 4.0 for the same error, what is no number is left out
    assert front(cost, error) == [1, 4, 0]
    assert front([], []) == []
    assert front([1.0, 2.0, 3.0], [1.0, 0.995, 0.9], 0.01) == [0, 2]
    some = np.random.default_rng(1).random((50, 2))
    on = front(*some.T)
    assert np.all(np.diff(some[on, 0]) > 0) and np.all(np.diff(some[on, 1]) < 0)
    for k in range(50):
        beaten = np.any(np.all(some <= some[k], axis=1) & np.any(some < some[k], axis=1))
        assert beaten != (k in on)


def test_cheapest():
    assert cheapest([3.0, 1.0, 2.0], [0.1, 0.3, 0.2], 0.2) == 2
    assert cheapest([3.0], [0.1], 0.05) is None


@pytest.mark.parametrize(("value", "asked"), [(1.2e-3, 1.5e-3), (7.0, 7.0), (0.0301, 0.05), (95.0, 100.0), (0.0, 0.0)])
def test_rounded_up(value, asked):
    assert rounded_up(value) == pytest.approx(asked)


def row(size, degree, cpu, error, converged=True, **knobs):
    return {"size": size, "degree": degree, "knobs": knobs, "cpu": cpu, "unit_cpu": 1.0, "own_cpu": 2.0,
            "label": f"{size} {degree} {knobs}", "converged": converged,
            "errors": {"energy": error, "pressure": error} if converged else {}}  # fmt: skip


def test_what_pays():
    """Of each setting the cheapest value that costs no accuracy; never a failed run or a preset."""
    rows = [
        row(8, 1, 10.0, 0.1), row(8, 1, 5.0, 0.105, snes=1e-3), row(8, 1, 4.0, 0.2, snes=1e-1),
        row(8, 1, 6.0, 0.1, snes=1e-4), row(8, 1, 11.0, 0.05, again=1), row(8, 1, 1.0, 0.1, accuracy="draft"),
        row(8, 1, 2.0, 0.0, False, theta=1.0), row(16, 1, 3.0, 0.1, quadrature=1),
    ]  # fmt: skip
    assert paying(rows, 8, 1) == {"snes": 1e-3}
    assert paying([], 8, 1) == {}


def test_judged_and_promises():
    rows = [row(16, 2, 6.0, 0.1, accuracy="standard"), row(8, 2, 4.0, 0.09), row(8, 1, 1.0, 0.2)]
    table = judged(rows, ("energy", "pressure", "force"), "cpu")
    assert [(one["quantity"], one["ratio"]) for one in table] == [
        ("all norms", 1.5),
        ("energy", 1.5),
        ("pressure", 1.5),
    ]
    # one that is as good in one norm only is not as good
    rows[1]["errors"]["pressure"] = 0.2
    table = judged(rows, ("energy", "pressure", "force"), "cpu")
    assert [one["ratio"] for one in table] == [1.0, 1.5, 1.0]
    found = promises(CASES["rings"], rows, ("energy",), "cpu")
    # twice as much, rounded up: 0.2, and 6 linear elastic solves on the same mesh
    assert found == {"standard": {"size": 16, "degree": 2, "cost": 7.0, "errors": {"energy": 0.2}}}


def block(path, order, force=0.0):
    return Scene(
        mesh=MeshSpec(path, order), materials={"m": Material(10.0, 0.3)}, bodies=[Body("block", "m")],
        displacements=[Displacement("bottom", [0.0, 0.0])], loads=[Load("top", traction=[0.3, force])],
        output=Output(fields=False),
    )  # fmt: skip


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_overkill_is_the_solution(shared_tmp, cell):
    """Displacement and gradient of a finished run at other points: those of its own nodes and cells."""
    path = make_mesh(one_block, shared_tmp / f"{cell}.msh", 2, 4, cell)
    with running(block(path, 2)) as (simulation, converged):
        assert converged
        solution, space = Overkill(simulation), simulation.problem.space
        u = space.local.gather(simulation.stepper.u)
        # what a prescribed and what any other node is moved by; points of both ranks
        found, slope = solution(space.points, 0)
        np.testing.assert_allclose(found, u, atol=1e-12 * np.abs(u).max())
    step = 1e-5 * np.array([[1.0, 0.0], [0.0, 1.0]])
    x = np.array([[0.11, 0.13], [0.52, 0.61], [0.93, 0.31]])
    slope = solution(x, 0)[1]
    for k in (0, 1):
        by_differences = (solution(x + step[k], 0)[0] - solution(x - step[k], 0)[0]) / 2e-5
        np.testing.assert_allclose(slope[:, :, k], by_differences, atol=1e-6 * np.abs(slope).max())


def test_linear_reference(tmp_path):
    """No contact, no yielding, one solve; what contact held is held."""
    path = make_mesh(rings, tmp_path / "rings.msh", n=4, order=2)
    scene = linear(changed(ring_scene(path, 1, 0.0), {"snes": 1e-3}), ("outer_skin",))
    assert not scene.contacts and scene.petsc["snes_type"] == "ksponly" and "snes_rtol" not in scene.petsc
    with running(scene) as (simulation, converged):
        assert converged and simulation.problem.linear and not simulation.floating


def test_held_out_scenes_are_not_swept():
    assert not HELD_OUT.keys() & CASES.keys()
    kinds = {case.kind for case in CASES.values()}
    assert all(case.kind in kinds for case in HELD_OUT.values())


def test_tiny(tmp_path):
    args = parse(make_options(), ["--tiny", "-o", str(tmp_path / "out")])
    make_directory(args.o)
    assert run(args) == 0
    data = json.loads((args.o / "tradeoff.json").read_text())["scenes"]["rings"]
    fine, coarse = data["fronts"]["energy"][-1], data["fronts"]["energy"][0]
    assert fine["cost"] >= coarse["cost"] and fine["error"] <= coarse["error"]
    assert set(data["promises"]) <= {"draft", "standard", "fine"} and data["promises"]
    keys = ("cpu", "wall", "memory_mb", "unknowns", "newton", "krylov", "unit_cpu", "own_wall")
    assert all(one[key] > 0 for one in data["rows"] for key in keys)
    assert "front, pressure" in (args.o / "accuracy_tables.md").read_text()
    assert (args.o / "rings.png").stat().st_size > 1000
    document = tmp_path / "docs.md"
    document.write_text(f"What stands before.\n{MARK}\nold\n")
    options = ["--publish", str(document), "-o"]
    assert run(parse(make_options(), [*options, str(args.o)])) == 0
    text = document.read_text()
    assert text.startswith(f"What stands before.\n{MARK}\n") and "old" not in text
    assert "front, pressure" in text and "(accuracy_rings.png)" in text and (tmp_path / "accuracy_rings.png").exists()
    with pytest.raises(InputError, match="no line '<!-- What follows"):
        run(parse(make_options(), ["--publish", str(args.o / "accuracy_tables.md"), "-o", str(args.o)]))
    for mode in (options, ["--promise", "-o"]):
        with pytest.raises(InputError, match="earlier sweep"):
            run(parse(make_options(), [*mode, str(tmp_path)]))


def test_scenes_one_after_the_other(tmp_path):
    """A sweep of some scenes keeps what an earlier one found of others."""
    data = {"clock": "cpu", "ranks": 1, "command": "", "scenes": {name: {"rows": [name]} for name in ("hill", "rings")}}
    (tmp_path / "tradeoff.json").write_text(json.dumps(data))
    args = parse(make_options(), ["--cases", "rings", "-o", str(tmp_path)])
    assert kept(args) == ({"hill": ["hill"]}, {"hill": CASES["hill"]})
    assert kept(parse(make_options(), ["--tiny", "-o", str(tmp_path)])) == ({}, {})
    assert kept(parse(make_options(), ["-o", str(tmp_path / "new")])) == ({}, {})
