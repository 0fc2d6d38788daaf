"""Meshes as obstacles: the same as the shapes that they are, moving and turning, restarted, on any number of ranks."""

import meshio
import numpy as np
import pytest

from drivers._common import running
from meshes import one_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps
from tests.support.restarts import Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
PIVOT = [0.4, 0.3, -0.2]
MOVES = {"angle": 4.0, "turn_axis": [0.2, 1.0, 0.3], "displacement": [0.05, 0.02, 0.08]}


def write_floor(path):
    """A square of two triangles that looks upwards, far over the block."""
    points = np.array([[-3, -3, 0], [4, -3, 0], [4, 4, 0], [-3, 4, 0.0]])
    groups = {"gmsh:physical": [np.array([7, 7])], "gmsh:geometrical": [np.array([1, 1])]}
    mesh = meshio.Mesh(points, [("triangle", np.array([[0, 1, 2], [0, 2, 3]]))], cell_data=groups,
                       field_data={"face": np.array([7, 2])})  # fmt: skip
    meshio.write(path, mesh, "gmsh22", binary=False)


@pytest.fixture
def folder(shared_tmp):
    on_root(WORLD, one_block, shared_tmp / "block.msh", 3, 3)
    on_root(WORLD, write_floor, shared_tmp / "floor.msh")
    WORLD.Barrier()
    return shared_tmp


def scene(folder, obstacle, strain="small", **contact):
    return Scene(
        MeshSpec("block.msh", strain=strain), {"m": Material(10.0, 0.3)}, [Body("block", "m")],
        contacts=[Contact("bottom", obstacle=obstacle, name="floor", **contact)],
        displacements=[Displacement("top", [0.0, 0.0, -0.02])],
        steps=Steps(count=6), output=Output(fields=False, checkpoint=True), petsc={"snes_rtol": "1e-12"},
        beside=folder,
    )  # fmt: skip


PLANE = Obstacle("plane", [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], pivot=PIVOT, **MOVES)
MESH = Obstacle("mesh", file="floor.msh", region="face", pivot=PIVOT, **MOVES)


def numbers(case):
    """Force and moment on the floor at the end, and the displacement by the numbers of the file."""
    with running(case) as (simulation, converged):
        assert converged
        report = simulation.problem.contacts[0].summary(simulation.stepper.u)
        return np.array([*report["force"], *report["moment"]])


@pytest.mark.parallel(2)
@pytest.mark.parametrize("strain", ["small", "finite"])
def test_a_plane_of_triangles(folder, strain):
    plane = numbers(scene(folder, PLANE, strain, friction=0.3))
    mesh = numbers(scene(folder, MESH, strain, friction=0.3))
    assert np.abs(plane).min() > 1e-3
    np.testing.assert_allclose(mesh, plane, rtol=1e-9)


@pytest.mark.parallel(2)
def test_restart_and_ranks(folder):
    """The same numbers after a restart, and on one rank; another surface is refused."""
    case, full, kept = scene(folder, MESH, friction=0.3), folder / "full", folder / "kept"
    records = run(case, WORLD, full, [Keep(full, kept, WORLD)])
    again = run(case, WORLD, folder / "again", restart=kept)
    alone = run(case, SELF, folder / f"alone{WORLD.rank}")
    WORLD.Barrier()
    for other in (again[-1], alone[-1]):
        for key in ("force", "moment"):
            one = records[-1]["contacts"]["floor"][key]
            np.testing.assert_allclose(other["contacts"]["floor"][key], one, rtol=1e-8)
    if WORLD.rank == 0:
        text = (folder / "floor.msh").read_text()
        (folder / "floor.msh").write_text(text.replace("-3.0", "-2.9"))
    WORLD.Barrier()
    with pytest.raises(InputError, match="floor.msh, text"):
        run(case, WORLD, folder / "other", restart=kept)
