"""Halving all cells or dividing them into simplices."""

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes.blocks import one_block
from pcontact.adapt.effectivity import Range
from pcontact.adapt.mark import MEASURED, Choice, locking, of_parts, parts_of
from pcontact.adapt.passes import Pass
from pcontact.mesh.distribute import load_mesh
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Material, MeshSpec, Scene
from pcontact.space.space import Space

COMM = MPI.COMM_WORLD


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    path = make_mesh(one_block, tmp_path_factory.mktemp("cells") / "block.msh", 2, 8, "quadrilateral")
    return load_mesh(COMM, path, 1, ["block"], [], lambda mesh: None)


def scene(**material):
    return Scene(mesh=MeshSpec("block.msh"), materials={"m": Material(1.0, **{"nu": 0.3, **material})},
                 bodies=[Body("block", "m")], displacements=[Displacement("bottom", [0.0, 0.0])])  # fmt: skip


def choice(mesh, squares, degree=1, fits=True, **material):
    known, done = Range(1.0, 2.0, "", 2), Choice(COMM)
    last = Pass(162, 64, degree, 0.1, known, {"mesh": 0.1}, entries=1000.0)
    return done.divides(scene(**material), Space(mesh, 1), last, squares, fits), done.made


def test_smooth_solutions_of_degree_1_are_halved(mesh):
    """Triangles with the same nodes have larger errors there."""
    divided, made = choice(mesh, np.ones(64))
    assert not divided and made["chosen"] == "quadrilaterals"
    assert made["entries"]["quadrilaterals"] < made["entries"]["triangles"]


@pytest.mark.parametrize("degree", [1, 2])
def test_what_is_large_in_one_place_is_cut_there(mesh, degree):
    squares = np.ones(64)
    squares[0] = 1e4
    divided, made = choice(mesh, squares, degree)
    assert divided and made["chosen"] == "triangles"
    assert made["entries"]["triangles"] < made["entries"]["quadrilaterals"]


def test_a_budget_that_does_not_hold_all_halves(mesh):
    assert choice(mesh, np.ones(64), fits=False)[0]


@pytest.mark.parametrize("material", [{"nu": 0.495}, {"yield_stress": 0.1, "hardening": 0.0}])
def test_triangles_that_lock_are_not_made(mesh, material):
    squares = np.ones(64)
    squares[0] = 1e4
    divided, made = choice(mesh, squares, 1, **material)
    assert not divided and "locking" in made["why"]
    assert choice(mesh, squares, 2, **material)[0]
    assert locking(scene(**material), 1) == "block" and locking(scene(), 1) is None


def test_parts(mesh):
    """They have the error of the cells, times what simplices have more."""
    parts = parts_of(mesh)
    assert (parts == 2).all()
    squares = np.arange(64.0)
    total = (parts * of_parts(squares, parts, 2, 1)).sum()
    assert total == pytest.approx(MEASURED[2, 1][0] ** 2 * squares.sum())
