"""Runs of bodies with small strain say where it ends: terminal, report, history."""

import csv
import json

import pytest

from meshes import indent, two_blocks
from pcontact.runtime import log
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps
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
    """Both blocks are strained by 10 % in the end: a word at the first load step beyond 4 %, and one at the end."""
    report, said = run(pressed(mesh, 0.2, count=5), shared_tmp / "run")
    steps = [step["small_strain"]["upper"] for step in report["steps"]]
    first = next(k for k, step in enumerate(steps) if step["error"] > 0.02)
    assert 0 < first < 4 and abs(steps[-1]["strain"] - 0.1) < 0.02 and steps[-1]["rotation"] < 3.0
    for body in ("lower", "upper"):
        lines = [line for line in said if f"body {body} goes beyond small strain" in line]
        assert [line.split(":")[0] for line in lines] == [f"time {0.2 * (first + 1):g}", "time 1"]
        assert all('strain = "finite"' in line and "most at (" in line for line in lines)
    if WORLD.rank == 0:
        written = json.loads((shared_tmp / "run" / "report.json").read_text())
        assert set(said) <= set(written["warnings"])
        rows = list(csv.DictReader((shared_tmp / "run" / "history.csv").open(newline="")))
        assert float(rows[-1]["small_strain.upper.error"]) == written["steps"][-1]["small_strain"]["upper"]["error"]
        assert {"small_strain.lower.place_x", "small_strain.lower.rotation"} <= rows[0].keys()


def test_no_word_where_small_strain_is_right(mesh):
    report, said = run(pressed(mesh, 0.04))
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
