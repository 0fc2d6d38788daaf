"""Runs of bodies with small strain say where it ends: terminal, report, history."""

import csv
import json

import pytest

from meshes import indent, one_block, two_blocks
from pcontact.runtime import log
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
    Steps,
    Temperature,
)
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD


def pressed(path, depth, upper=None, lower=None, count=1):
    """A block on another one, pressed down."""
    return Scene(
        MeshSpec(path), {"m": Material(10.0, 0.3)},
        [Body("lower", "m", strain=lower), Body("upper", "m", strain=upper)],
        contacts=[Contact("upper_bottom", "lower_top", name="pair")],
        displacements=[Displacement("lower_bottom", [0, 0]), Displacement("upper_top", [0, -depth])],
        steps=Steps(count=count), output=Output(fields=False),
    )  # fmt: skip


def run(case, directory=None):
    """Report of a run and its warnings of small strain. *Collective.*"""
    simulation = Simulation(case, WORLD)
    try:
        assert simulation.run(directory, keep=True)
        return simulation.records.data(), [line for line in log.warnings() if "small strain" in line]
    finally:
        simulation.close()


@pytest.fixture
def mesh(shared_tmp):
    path = shared_tmp / "blocks.msh"
    on_root(WORLD, two_blocks, path, 2, 4, 3)
    return path


@pytest.mark.parallel(1, 2)
def test_a_word_as_it_happens_and_at_the_end(mesh, shared_tmp):
    """Both blocks are strained by 10 % in the end: a word at the first load step beyond 1.3 %, and one at the end."""
    report, said = run(pressed(mesh, 0.2, count=20), shared_tmp / "run")
    steps = [step["small_strain"]["upper"] for step in report["steps"]]
    first = next(k for k, step in enumerate(steps) if step["error"] > 0.02)
    assert 0 < first < 4 and abs(steps[-1]["strain"] - 0.1) < 0.02 and steps[-1]["rotation"] < 3.0
    for body in ("lower", "upper"):
        lines = [line for line in said if f"body {body} goes beyond small strain" in line]
        assert [line.split(":")[0] for line in lines] == [f"time {0.05 * (first + 1):g}", "time 1"]
        assert all('strain = "finite"' in line and "most at (" in line for line in lines)
    if WORLD.rank == 0:
        written = json.loads((shared_tmp / "run" / "report.json").read_text())
        assert set(said) <= set(written["warnings"])
        rows = list(csv.DictReader((shared_tmp / "run" / "history.csv").open(newline="")))
        assert float(rows[-1]["small_strain.upper.error"]) == written["steps"][-1]["small_strain"]["upper"]["error"]
        assert {"small_strain.lower.place_x", "small_strain.lower.rotation"} <= rows[0].keys()


def test_no_word_where_small_strain_is_right(mesh):
    report, said = run(pressed(mesh, 0.02))
    assert not said and report["steps"][-1]["small_strain"].keys() == {"lower", "upper"}


@pytest.mark.parametrize("lower", ["small", "finite"])
def test_bodies_with_finite_strain_are_excepted(mesh, lower):
    report, said = run(pressed(mesh, 0.2, "finite", lower, 2))
    assert "upper" not in report["steps"][-1]["small_strain"]
    assert {line.split("body ")[1].split()[0] for line in said} == ({"lower"} if lower == "small" else set())


@pytest.mark.parametrize("depth, beyond", [(0.002, False), (0.2, True)])
def test_a_ball_in_a_perfectly_plastic_block(tmp_path, depth, beyond):
    """A shallow imprint is right, a deep one is not."""
    path = indent(tmp_path / "block.msh", 2, 0.1, length=3.0, growth=1.0)
    ball = Obstacle("sphere", center=[0.0, 1.0], radius=1.0, displacement=[0.0, -depth])
    case = Scene(
        MeshSpec(path, kinematics="axisymmetric"), {"m": Material(1000.0, 0.3, yield_stress=3.0)}, [Body("block", "m")],
        contacts=[Contact("block_top", obstacle=ball, name="ball")],
        displacements=[Displacement("block_bottom", [0, 0])], steps=Steps(count=8), output=Output(fields=False),
    )  # fmt: skip
    report, said = run(case)
    assert bool(said) == beyond
    assert report["steps"][-1]["plastic"]["max_equivalent_strain"] > (0.3 if beyond else 0.0)


THIN = 0.05


def beam(path, *displacements, order=2, loads=(), **more):
    """A beam of length 1 whose left end is clamped."""
    return Scene(
        MeshSpec(path, order=order), {"m": Material(10.0, 0.3)}, [Body("block", "m")],
        displacements=[Displacement("left", [0, 0]), *displacements], loads=list(loads), output=Output(fields=False),
        **more,
    )  # fmt: skip


@pytest.mark.parallel(1, 3)
@pytest.mark.parametrize("order, n, tolerance", [(2, (20, 2), 0.02), (1, (40, 4), 0.12)])
def test_a_beam_held_at_both_ends(shared_tmp, order, n, tolerance):
    """Half of it: the deflection w0 (3 s^2 - 2 s^3) has a mean of w'^2 / 2 of 0.6 w0^2, and forces 0.72 (w0 / h)^2."""
    path = shared_tmp / f"beam{order}.msh"
    on_root(WORLD, lambda: one_block(path, 2, n, size=(1.0, THIN), order=order))
    for part in (0.1, 0.5):
        report, said = run(beam(path, Displacement("right", [0, -part * THIN]), order=order))
        found = report["steps"][-1]["small_strain"]["block"]
        assert found["strain"] < 0.003 and found["rotation"] < 2.5
        assert found["stiffening"] == pytest.approx(0.72 * part**2, rel=tolerance)
        assert bool(said) == (part > 0.2)


@pytest.mark.parametrize("order, n", [(2, (20, 2)), (1, (80, 4))])
def test_a_cantilever_has_no_membrane_force(tmp_path, order, n):
    path, tip = one_block(tmp_path / "beam.msh", 2, n, size=(1.0, THIN), order=order), 0.1
    load = Load("right", traction=[0.0, -10.0 * tip * THIN**2 / 4.0 / 0.91])
    report, said = run(beam(path, loads=[load], order=order))
    found = report["steps"][-1]["small_strain"]["block"]
    assert not said and found["rotation"] > 3.0 and found["stiffening"] < 0.002


def test_a_load_along_a_beam(tmp_path):
    """A cantilever in compression by a part of Euler's load is softer by the moment of that part."""
    path, part, tip = one_block(tmp_path / "beam.msh", 2, (20, 2), size=(1.0, THIN), order=2), 0.05, 0.02
    bending = 10.0 / 0.91 * THIN**3 / 12.0
    along, across = part * 2.4674 * bending, 3.0 * bending * tip
    report, said = run(beam(path, loads=[Load("right", traction=[-along / THIN, -across / THIN])]))
    found = report["steps"][-1]["small_strain"]["block"]
    # the mean of w'^2 is 1.2 tip^2; the work is that of both loads
    expected = 1.5 * along * 1.2 * tip**2 / (across * tip + along**2 * 0.91 / (10.0 * THIN))
    assert found["stiffening"] == pytest.approx(expected, rel=0.05) and len(said) == 1


@pytest.mark.parallel(1, 2)
@pytest.mark.parametrize("holds", [False, True])
def test_a_stack_that_turns_as_a_whole(mesh, holds):
    """Two blocks that strain each other, as they are heated: a turn by 5 degrees does nothing to them, unless a support
    keeps what a linear turn makes longer."""
    ends = [Displacement("lower_corner_00", [0, 0]), Displacement("lower_corner_10", [0 if holds else "free", 0.0873])]
    case = Scene(
        MeshSpec(mesh), {"a": Material(10.0, 0.3, expansion=2e-3), "b": Material(10.0, 0.3)},
        [Body("lower", "b"), Body("upper", "a")], displacements=ends, temperatures=[Temperature(1.0)],
        contacts=[Contact("upper_bottom", "lower_top", name="pair", tied=True)], output=Output(fields=False),
    )  # fmt: skip
    report, said = run(case)
    found = report["steps"][-1]["small_strain"]
    for body in ("lower", "upper"):
        assert 4.9 < found[body]["rotation"] < 5.1
        assert found[body]["stiffening"] < 1e-3 or holds
    assert bool(said) == holds
