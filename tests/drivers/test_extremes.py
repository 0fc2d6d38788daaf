"""Extremes: a part of the matrix of `drivers/studies/extremes.py`, and what was mended because of it."""

import json

import numpy as np
import pytest

from drivers.studies._extreme_cells import FAMILIES, REASONS
from drivers.studies._extreme_runs import REFUSED, RIGHT, WRONG, Cell, judge, not_numbers, run_cell
from drivers.studies._extreme_scenes import E, flowing_strain, stack
from drivers.studies.extremes import cells_of
from meshes.bricks import Brick, bricks
from pcontact.mesh.read import read_mesh
from pcontact.runtime import log
from pcontact.runtime.files import replace_file
from pcontact.runtime.petsc import MPI

pytestmark = pytest.mark.slow
CELLS = {cell.name: cell for cell in cells_of(FAMILIES)}
# every fifteenth of each family, on one rank
SOME = [cell.name for cell in cells_of(FAMILIES, 15)]

# cells that were WRONG before what is named was mended
MENDED = {
    # the residual was measured against the first one, that of a stiff body whose support has moved
    "stiffness, 1e+09, target soft, theta 0": RIGHT,
    "stiffness, 1e+06, target soft, dim 3": RIGHT,
    "nu, 0.499, blocks, quadrilateral 1": RIGHT,
    "gamma0, 1e+09, ring, theta 0": RIGHT,
    # the rounding errors of the residual did not count those of contact
    "gamma0, 1e+09, blocks, theta 0": RIGHT,
    # multigrid failed, and nothing took its place
    "nu, 0.49999, blocks, triangle 2": RIGHT,
    "mesh sizes, 1 : 100, source fine, theta 0": RIGHT,
    "shape, aspect 1e4, upright, quadrilateral 1": RIGHT,
    # what steadies a loose body was a millionth of its own stiffness, a thousand times that of what it lay on
    "stiffness, 1e+09, target soft, pressure 10.0": RIGHT,
    # a loose body came no nearer to what it was to touch than its small load could press what steadies it
    "few points, tangential touch, plane, load 1e-10": RIGHT,
    # one answer or the other, as the rounding errors of the processor have it
    "few points, tangential touch, plane, load 1e-12": f"{RIGHT} or {REFUSED}",
    # the gap of points without a partner was not a number
    "few points, corner on face, 2D, upper is source": RIGHT,
    # the gap along a ray went to and fro between two searches, until the load step was given up
    "few points, corner on face, 2D, upper is source, search ray_tracing": RIGHT,
    "few points, corner on face, 3D, upper is source, search ray_tracing": RIGHT,
    "few points, edge on edge, 3D, upper is source, search ray_tracing": RIGHT,
    # a pivot of the trace constant's local problem was a rounding error less than zero
    "shape, aspect 1e4, flat, hexahedron 1": RIGHT,
    # no word about gamma0 below the bound of coercivity, edges that the quadrature does not see, a limit load
    "gamma0, 1e-06, ring, theta 0": REFUSED,
    "mesh sizes, 1 : 100, target fine, hexahedron": RIGHT,
    "loads, 1e+06, shrink fit": REFUSED,
    "nu, 0.49, ring, triangle 1": REFUSED,
    # another solution of Coulomb's law than the one meant
    "friction, 10, slip, theta 1": REFUSED,
    # the volume change of cells of degree 2 took the digits of the pressure, or their displacement
    "nu, 0.49999, ring, quadrilateral 2": RIGHT,
    "nu, 0.49999, ring, triangle 2": RIGHT,
    # rounding errors of the gap, times gamma, were taken for forces at work
    "gamma0, 1e+18, blocks, theta 0": REFUSED,
    "gamma0, 1e+18, ring, theta 0": REFUSED,
    # multipliers had not settled after 30 updates
    "gamma0, 1e-06, blocks, augmented Lagrangian": RIGHT,
    "gamma0, 1e-03, blocks, augmented Lagrangian": RIGHT,
}
# the same, of runs that cut their steps again and again before they give up: on one rank
SLOW = ["hardening, 0, flowing block, 101 %", "loads, 1e+06, weight on a corner"]


@pytest.fixture(autouse=True)
def voice():
    """The log as the test found it: other tests look at it."""
    yield
    log.setup(MPI.COMM_WORLD.rank)


@pytest.mark.parametrize("name", SOME)
def test_a_part_of_the_matrix(tmp_path, name):
    row = run_cell(CELLS[name], tmp_path / "cell")
    assert row["verdict"] != WRONG, row["text"]


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("name", MENDED)
def test_what_was_wrong(shared_tmp, name):
    row = run_cell(CELLS[name], shared_tmp / "cell")
    assert row["verdict"] in MENDED[name].split(" or "), (row["verdict"], row["errors"], row["text"])


@pytest.mark.parametrize("name", SLOW)
def test_a_load_that_cannot_be_borne_is_named(tmp_path, name):
    row = run_cell(CELLS[name], tmp_path / "cell")
    assert row["verdict"] == REFUSED, (row["errors"], row["text"])


def test_the_matrix_is_large_and_every_cell_has_a_name_and_a_reason():
    cells = list(cells_of(FAMILIES))
    assert len(cells) >= 150 and len(CELLS) == len(cells)
    assert {cell.reason for cell in cells} <= REASONS.keys()


CASE = Cell("family", "setting", "variant", stack, bound=1e-3, cause="limit load")


@pytest.mark.parametrize(
    ("converged", "errors", "refusal", "bad", "verdict"),
    [
        (True, {"u": 1e-4}, "", [], RIGHT),
        (True, {"u": 1e-2}, "", [], WRONG),
        (True, {"u": np.inf}, "", [], WRONG),
        (True, {"u": 1e-4}, "", ["history.csv: time"], WRONG),
        (False, {}, "beyond the limit load", [], REFUSED),
        (False, {}, "did not converge", [], WRONG),
        (False, {}, "", [], WRONG),
    ],
)
def test_the_verdict(converged, errors, refusal, bad, verdict):
    assert judge(CASE, converged, errors, refusal, bad)[0] == verdict


def test_numbers_that_are_not_finite_are_found_in_files(tmp_path):
    assert run_cell(CELLS["gaps, gap 1e-03, pushed"], tmp_path)["verdict"] == RIGHT
    run = tmp_path / "run"
    assert not_numbers(run) == []
    report = json.loads((run / "report.json").read_text())
    report["steps"][0]["imbalance"] = None
    replace_file(run / "report.json", json.dumps(report))
    history = (run / "history.csv").read_text().splitlines()
    (run / "history.csv").write_text("\n".join([history[0], history[1].replace(history[1].split(",")[0], "nan", 1)]))
    assert not_numbers(run) == ["report.json", f"history.csv: {history[0].split(',')[0]}"]


def test_warnings_are_in_the_report(tmp_path):
    keys = {"gamma0": 1e-2, "friction": 2.0, "petsc": {"allow_unsafe": "gamma0,locking"}}
    run_cell(Cell("gamma0", "0.01", "blocks", stack, keys), tmp_path)
    lines = json.loads((tmp_path / "run" / "report.json").read_text())["warnings"]
    assert any("is coercive" in line for line in lines) and any("several solutions" in line for line in lines)
    run_cell(Cell("gamma0", "1", "blocks", stack), tmp_path)
    assert json.loads((tmp_path / "run" / "report.json").read_text())["warnings"] == []


@pytest.mark.parametrize(("length", "shift"), [(1e-12, 0.0), (1e12, 0.0), (1.0, 1e6)])
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_bricks_keep_their_digits(tmp_path, length, shift, cell):
    """Points nearer than 1e-8, or far from the origin, come back from the file as they were."""
    dim = 2 if cell == "quadrilateral" else 3
    brick = Brick("body", [0.0] * dim, [1.0] * dim, [2] * dim, cell)
    bricks(tmp_path / "mesh.msh", [brick], lambda x: length * (x + shift), {"corner": ["body_left", "body_bottom"]})
    raw = read_mesh(tmp_path / "mesh.msh")
    wanted = length * (np.array([0.0, 0.5, 1.0]) + shift)
    assert all(np.array_equal(np.unique(raw.points[:, k]), wanted) for k in range(dim))
    facets = {name: len(local) for name, (_, local) in raw.facet_groups.items()}
    assert facets["corner"] == facets["body_left"] + facets["body_bottom"] and facets["left"] == facets["body_left"]


@pytest.mark.parametrize("nu", [0.0, 0.3])
def test_strain_of_a_flowing_block(nu):
    """Elastic until the yield stress of plane strain, a straight line far beyond it."""
    first = 1.0 / np.sqrt(1.0 - nu + nu**2)
    assert flowing_strain(0.9 * first, nu, 0.0) == pytest.approx(0.9 * first * (1.0 - nu**2))
    # far beyond, sigma_z = k sigma_y with (k - nu) + (k - 1/2) / H = 0, and p = sigma_eq / H
    hardening = 0.05
    k = (nu + 0.5 / hardening) / (1.0 + 1.0 / hardening)
    a, b = (flowing_strain(load, nu, hardening) for load in (40.0, 41.0))
    assert b - a == pytest.approx(1.0 - nu * k + (1.0 - 0.5 * k) / hardening, rel=1e-4)


def test_forces_at_work_do_not_depend_on_a_stiff_first_guess(tmp_path):
    """With the softer body as target and the stiffer one pushed, the answer has the digits of any other one."""
    errors = []
    for ratio in (1.0, 1e6):
        cell = Cell("stiffness", f"{ratio:g}", "blocks", stack, {"youngs": (E, E * ratio)})
        errors.append(run_cell(cell, tmp_path)["errors"]["pressure"])
    assert max(errors) < 1e-7
