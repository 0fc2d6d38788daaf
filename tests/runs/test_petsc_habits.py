"""What those who know PETSc try first: each row of the table in docs/petsc.md."""

import h5py
import numpy as np
import pytest

from meshes.blocks import two_blocks
from pcontact.runtime import log
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, own_options
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation
from tests.support.bad_input import Case
from tests.support.commands import execute, lay_out

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel


@pytest.fixture
def blocks(shared_tmp):
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        two_blocks(path, 2, 2, 3, "quadrilateral")
    WORLD.Barrier()
    return path


def pressed(path, theta=0.0, **options):
    moved = [Displacement("lower_bottom", [0.0] * 2), Displacement("upper_top", [0.0, -0.02])]
    return Scene(
        MeshSpec(path), {"m": Material(1000.0, 0.3)}, [Body("lower", "m"), Body("upper", "m")],
        [Contact("upper_bottom", "lower_top", name="pair", theta=theta)], moved,
        [Load("upper", body_force=[0.0, -1.0])], output=Output(fields=False), petsc={"snes_rtol": "1e-10", **options},
    )  # fmt: skip


def solved(scene):
    simulation = Simulation(scene)
    try:
        assert simulation.run(None)
        return simulation.stepper.u.getArray().copy(), simulation.newton.solver
    finally:
        simulation.close()


@parallel
@pytest.mark.parametrize("krylov", ["cg", "gmres", "bcgs", "tfqmr"])
def test_krylov(blocks, krylov):
    """Methods for symmetric matrices work where the tangent is nearly so, and a warning says what to do."""
    reference, _ = solved(pressed(blocks))
    log.forget_warnings()
    found, solver = solved(pressed(blocks, ksp_type=krylov))
    lines = log.warnings()
    assert solver["krylov"] == krylov
    assert WORLD.allreduce(float(np.abs(found - reference).max(initial=0.0)), op=MPI.MAX) < 1e-9
    assert any("-ksp_type cg is for symmetric tangents" in line for line in lines) == (krylov == "cg")


@parallel
@pytest.mark.parametrize("option", ["snes_fd_color", "snes_fd", "snes_mf_operator", "snes_mf"])
def test_differences_of_the_residual(blocks, option):
    """In the place of the tangent, or of its products, they lead to the same solution."""
    reference, _ = solved(pressed(blocks))
    found, _ = solved(pressed(blocks, **{option: True}, **({"pc_type": "none"} if option == "snes_mf" else {})))
    assert WORLD.allreduce(float(np.abs(found - reference).max(initial=0.0)), op=MPI.MAX) < 1e-9


@parallel
def test_jacobian(blocks, capfd):
    """The tangent is the derivative of the residual, at prescribed components, too, once the surfaces are closed."""
    solved(pressed(blocks, snes_test_jacobian=True))
    lines = [line for line in capfd.readouterr().out.splitlines() if "||J||_F =" in line]
    found = [float(line.split("=")[1].split(",")[0]) for line in lines]
    # at the first iterate the blocks touch: half of the differences are those of open points
    assert WORLD.rank > 0 or (len(found) == 2 and found[1] < 1e-8 < found[0])


def said(text):
    """What a run says of options in a text, before its first load step."""
    with own_options():
        options = Options()
        options.give(text)
        return options.strange()


def test_names_that_nobody_knows():
    """They are told when the run begins, whenever PETSc would ask for them; with two dashes, too."""
    known = (
        "-snes_rtol 1e-3 --snes_atol 0 -mg_levels_2_ksp_type richardson -log_view "
        "-contact_theta 1 -contact_filter_pc_type lu -sub_pc_factor_levels 1 -o there -pc_direct_below 3"
    )  # fmt: skip
    assert [line for line in said(known) if "contact_theta" not in line] == []
    (line,) = said("-snes_rtoll 1e-3")
    assert line == "option -snes_rtoll: neither pcontact nor PETSc has it; the nearest is -snes_rtol"
    (line,) = said("--pc_gamg_thresold 0.1")
    assert line.endswith("the nearest is -pc_gamg_threshold")
    (line,) = said("-pc_direct_belov 3")
    assert line.endswith("the nearest is -pc_direct_below")


def test_names_that_the_program_once_had():
    """They say what takes their place; one with a new name still does."""
    lines = said("-pc_rescue false -pc_patience -1 -contact_uzawa_accept -contact_search_every newton")
    assert len(lines) == 4 and all(" does nothing any more: " in line for line in lines)
    assert "-newton_without direct" in next(line for line in lines if "-pc_rescue" in line)
    with own_options():
        options = Options()
        options.give("-pc_direct_plane 7")
        assert options.strange() == [] and options.get("pc_direct_below") == 7


def test_they_are_named_once(tmp_path):
    """A line at the beginning, none at the end."""
    words = lay_out(tmp_path / "case", Case([], words=("run", "SCENE", "-o", "out", "-snes_rtoll", "1")))
    done = execute(tmp_path / "case", words)
    assert done.returncode == 0, done.stderr
    lines = [line for line in (done.stdout + done.stderr).splitlines() if "snes_rtoll" in line]
    assert len(lines) == 1 and "the nearest is -snes_rtol" in lines[0]


def test_views(tmp_path):
    """They show every linear solve of all load steps; what PETSc prints at the end is no word that nobody asked for."""
    words = ("run", "SCENE", "-o", "out", "-ksp_view", "ascii:ksp.txt", "-ksp_view_solution", "hdf5:u.h5", "-version",
             "-options_view", "-steps_count", "2")  # fmt: skip
    folder = tmp_path / "case"
    done = execute(folder, lay_out(folder, Case([], words=words)))
    assert done.returncode == 0, done.stderr
    text = done.stdout + done.stderr
    assert "Option Table entries" in text and "Release Version" in text and "was not used" not in text
    assert "type: gamg" in (folder / "ksp.txt").read_text()
    with h5py.File(folder / "u.h5") as file:
        (values,) = file.values()
        assert np.abs(values[...]).max() > 0.0


def test_options_left(tmp_path):
    """PETSc lists what nobody asked for, and neither the program's own words nor its defaults."""
    words = ("run", "SCENE", "-o", "out", "-pc_type", "lu", "-pc_fieldsplit_type", "schur", "-options_left")
    done = execute(tmp_path / "case", lay_out(tmp_path / "case", Case([], words=words)))
    assert done.returncode == 0, done.stderr
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.startswith("Option left")]
    assert len(lines) == 1 and "pc_fieldsplit_type" in lines[0]
