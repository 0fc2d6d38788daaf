"""Wedges and pyramids beside hexahedra and tetrahedra: patch tests, rates, several ranks, fields."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases import patch
from meshes import one_block
from pcontact.assembly.geometry import points_of, some_cells_weighted
from pcontact.io.result import load_result
from pcontact.mesh.hdf5 import convert
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene
from pcontact.simulation import Simulation
from pcontact.view.show import show
from tests.support.patch import blocks, solve
from tests.support.small import bend
from tests.support.wedges import cut_mesh

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
KINDS = {
    "wedge": ["wedge"], "pyramid": ["pyramid"], "columns": ["hexahedron", "wedge", "pyramid"],
    "beside": ["wedge", "hexahedron"],
}  # fmt: skip


def cut(folder, path, kinds, split="none", bent=None):
    """The cut mesh. Collective."""
    target = folder / f"{kinds}-{path.name}"
    if WORLD.rank == 0:
        cut_mesh(path, target, KINDS[kinds], split, bent)
    WORLD.Barrier()
    return target


@pytest.mark.parametrize(("kinds", "split"), [
    ("wedge", "none"), ("pyramid", "none"), ("beside", "none"), ("columns", "upper_bottom"),
])  # fmt: skip
@pytest.mark.parametrize(("order", "serendipity", "theta"), [(1, False, 0.0), (2, False, 1.0), (2, True, 0.0)])
def test_uniform_pressure_passes(shared_tmp, kinds, split, order, serendipity, theta):
    """Triangles and quadrilaterals on one surface, against those of the other body, which do not match."""
    path = cut(shared_tmp, blocks(shared_tmp, "hexahedron", [2, 2, 1], [3, 3, 1]), kinds, split)
    case = patch.scene(path, 3, order, theta=theta, cut=True)
    case.mesh.serendipity = serendipity
    assert max(solve(case, patch.errors)) < 1e-9


def field(x):
    """A displacement without divergence, of which the force is 4 mu times itself."""
    return np.sin(2.0 * x[..., [1, 2, 0]])


def error(simulation):
    """L2 norm of the error."""
    space, u, total = simulation.problem.space, simulation.stepper.u, 0.0
    nodal = space.local.gather(u)
    for number, cells in enumerate(space.cells):
        rows = np.arange(len(cells))
        _, weight, values, _ = some_cells_weighted(space, number, rows)
        wrong = values @ nodal[cells] - field(points_of(space, number, rows))
        total += np.einsum("cq,cqi->", weight, wrong**2)
    return np.sqrt(total)


@pytest.mark.parametrize(("order", "serendipity", "rate"), [(1, False, 1.8), (2, False, 2.8), (2, True, 2.7)])
@pytest.mark.parametrize("kinds", ["wedge", "pyramid"])
def test_errors_fall_with_the_degree(shared_tmp, kinds, order, serendipity, rate):
    """Prescribed displacements and body forces of a smooth field."""
    found = []
    for n in (2, 4):
        path = cut(shared_tmp, make_mesh(one_block, shared_tmp / f"b{n}.msh", 3, n, "hexahedron"), kinds)
        value = ["sin(2*y) + 0*t", "sin(2*z)", "sin(2*x)"]
        sides = ("left", "right", "front", "back", "bottom", "top")
        case = Scene(
            MeshSpec(path, order=order, serendipity=serendipity), {"m": Material(1.0, 0.0)}, [Body("block", "m")],
            displacements=[Displacement(side, value) for side in sides],
            loads=[Load("block", body_force=["2*sin(2*y) + 0*t", "2*sin(2*z) + 0*t", "2*sin(2*x) + 0*t"])],
            output=Output(fields=False),
        )  # fmt: skip
        found.append(solve(case, error))
    assert np.log2(found[0] / found[1]) > rate, found


def pressed(path, comm, folder=None, **more):
    """Probe and reaction of a block of several kinds of cells that is pressed onto a plane, and moved along it."""
    case = Scene(
        MeshSpec(path, **more), {"m": Material(100.0, 0.3, yield_stress=1.0, hardening=5.0)}, [Body("block", "m")],
        contacts=[Contact("bottom", obstacle=Obstacle("plane", [0, 0, 0.01], [0, 0, 1]), friction=0.3)],
        displacements=[Displacement("top", [0.01, 0, -0.01])],
        output=Output(fields=folder is not None, probes=["bottom"]),
        petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-13"},
    )  # fmt: skip
    simulation = Simulation(case, comm)
    assert simulation.run(folder, keep=True)
    simulation.close()
    step = simulation.records.data()["steps"][-1]
    assert step["imbalance"] < 1e-8 and step["contacts"]["bottom-plane"]["force"][2] < -0.1
    return [*step["probes"]["bottom"]["mean"], *step["reactions"]["top"]]


@pytest.mark.parallel
@pytest.mark.parametrize("more", [
    {"order": 1, "strain": "finite"}, {"order": 2, "serendipity": True}, {"order": 2, "mean_dilatation": True},
])  # fmt: skip
def test_ranks_do_not_matter(shared_tmp, more):
    bricks = make_mesh(one_block, shared_tmp / "block.msh", 3, 3, "hexahedron")
    path = cut(shared_tmp, bricks, "columns", "bottom", bend)
    one = pressed(path, SELF, **more)
    np.testing.assert_allclose(pressed(path, WORLD, **more), one, rtol=1e-7)


@pytest.mark.parametrize(("order", "names"), [
    (1, {"hexahedron", "wedge", "pyramid", "tetra"}), (2, {"hexahedron27", "wedge18", "pyramid13", "tetra10"}),
])  # fmt: skip
def test_fields_a_converted_mesh_and_a_picture(shared_tmp, order, names):
    path = cut(shared_tmp, make_mesh(one_block, shared_tmp / "block.msh", 3, 3, "hexahedron"), "columns", "bottom")
    stored = shared_tmp / "stored.h5"
    convert(path, stored, order)
    one, other = (pressed(mesh, SELF, shared_tmp / mesh.suffix[1:], order=order) for mesh in (path, stored))
    np.testing.assert_allclose(other, one, rtol=1e-8)
    result = load_result(shared_tmp / "msh")
    assert {name for name, _ in result.bodies.cells} == names
    show(str(shared_tmp / "msh"), {"o": str(shared_tmp / "picture.png"), "size": "300x200"})
    assert (shared_tmp / "picture.png").stat().st_size > 1000


def test_an_estimate_of_the_error_is_refused(shared_tmp):
    path = cut(shared_tmp, make_mesh(one_block, shared_tmp / "block.msh", 3, 1, "hexahedron"), "wedge")
    case = Scene(MeshSpec(path), {"m": Material(1.0, 0.0)}, [Body("block", "m")],
                 displacements=[Displacement("bottom", [0, 0, 0])], output=Output(estimate=True))  # fmt: skip
    with pytest.raises(InputError, match="output.estimate: found true with cells of the kind wedge"):
        Simulation(case, SELF)
