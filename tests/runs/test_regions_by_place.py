"""A scene on a mesh that has no groups: those that the scene makes by place are as those of a file."""

from functools import partial

import meshio
import numpy as np
import pytest

from meshes import two_blocks
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Region, Scene
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD
REGIONS = [
    Region("lower", "cells", "y < 1"), Region("upper", "cells", "y > 1"),
    Region("lower_top", where="y == 1", of="lower"), Region("upper_bottom", where="ny < -0.9", of="upper"),
    Region("lower_bottom", "nodes", "y == 0"),
    Region("upper_top", where="y == 2 and ny > 0"),
]  # fmt: skip


def bare(path, copy):
    """The same cells without groups."""
    two_blocks(path, 2)
    mesh = meshio.read(path)
    meshio.write(copy, meshio.Mesh(mesh.points, [("quad", mesh.cells_dict["quad"])]))


def scene(path, regions=(), order=2):
    return Scene(
        MeshSpec(path, order=order), {"m": Material(100.0, 0.3)}, [Body("lower", "m"), Body("upper", "m")],
        [Contact("upper_bottom", "lower_top", name="pair")],
        [Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.0, -0.01])],
        output=Output(fields=False), regions=list(regions),
    )  # fmt: skip


def force(case):
    simulation = Simulation(case)
    assert simulation.run(keep=True)
    data = simulation.records.data()
    simulation.close()
    return np.array(data["steps"][-1]["contacts"]["pair"]["force"])


@pytest.mark.parallel
def test_groups_by_place(shared_tmp):
    """On any number of ranks, also where nodes come in the middles of edges."""
    named, plain = shared_tmp / "named.msh", shared_tmp / "plain.vtu"
    on_root(WORLD, partial(bare, named, plain))
    np.testing.assert_allclose(force(scene(plain, REGIONS)), force(scene(named)), rtol=1e-6, atol=1e-6)
    with pytest.raises(InputError, match=r"has none \(in gmsh.*table \[\[regions\]\].*mesh goes from \[0.0, 0.0\] to"):
        force(scene(plain))
    for wrong, said in (
        (Region("lower", "cells", "y < -1"), r"regions\[0\] \(lower\).where: found 'y < -1', where there are no cells"),
        (Region("lower", "cells", "ny < 1"), "where: found ny of cells; allowed: x, y$"),
        (Region("lower", where="z < 1"), "found z with a 2D mesh; allowed: x, y, nx, ny"),
        (Region("lower", where="y < 1", of="all"), r"of: found 'all', no such group"),
    ):
        with pytest.raises(InputError, match=said):
            force(scene(plain, [wrong, *REGIONS[1:]]))
    with pytest.raises(InputError, match="name: found 'lower', a group that is there already"):
        force(scene(named, REGIONS))
