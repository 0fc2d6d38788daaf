"""Bodies of degree 1 in a scene of degree 2: the answer of degree 1, beside bodies of degree 2, on several ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes import one_block, two_blocks
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene
from pcontact.simulation import Simulation

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
PETSC = {"snes_rtol": "1e-12", "ksp_rtol": "1e-13"}


def last(scene, comm):
    simulation = Simulation(scene, comm)
    assert simulation.run(keep=True)
    simulation.close()
    step = simulation.records.data()["steps"][-1]
    return np.concatenate([one["mean"] for one in step["probes"].values()] + list(step["reactions"].values()))


@pytest.mark.parametrize(("cell", "serendipity"), [
    ("hexahedron", False), ("hexahedron", True), ("tetrahedron", False), ("quadrilateral", True),
])  # fmt: skip
def test_the_answer_is_that_of_degree_1(shared_tmp, cell, serendipity):
    dim = 2 if cell == "quadrilateral" else 3
    path = make_mesh(one_block, shared_tmp / f"{cell}.msh", dim, 2, cell)
    found, corner = [], "corner_11" if dim == 2 else "corner_111"
    for order, lower in ((1, None), (2, 1)):
        found.append(last(Scene(
            MeshSpec(path, order=order, serendipity=serendipity and order == 2), {"m": Material(100.0, 0.3)},
            [Body("block", "m", order=lower)],
            displacements=[Displacement("bottom", [0] * dim)], loads=[Load("top", traction=[1.0, -2.0, 0.5][:dim])],
            output=Output(fields=False, probes=[corner]), petsc=PETSC,
        ), SELF))  # fmt: skip
    np.testing.assert_allclose(found[1], found[0], rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize(("cell", "kinematics", "finite"), [
    ("quadrilateral", "plane_strain", False), ("quadrilateral", "axisymmetric", False),
    ("hexahedron", "plane_strain", False), ("quadrilateral", "plane_strain", True),
])  # fmt: skip
def test_the_mean_dilatation_is_that_of_degree_1(shared_tmp, cell, kinematics, finite):
    """Nearly incompressible, pressed on a floor: cells with the linear mean dilatation of degree 2 would lock. Traction
    and parameter of the contact are those of degree 1, too."""
    dim = 2 if cell == "quadrilateral" else 3
    path, found = make_mesh(one_block, shared_tmp / f"{cell}.msh", dim, 3, cell), []
    floor = Contact("bottom", obstacle=Obstacle("plane", [0.0] * dim, [0.0] * (dim - 1) + [1.0]))
    for order, lower, mean in ((1, None, None), (2, 1, None), (1, None, False)):
        found.append(last(Scene(
            MeshSpec(path, order=order, kinematics=kinematics, mean_dilatation=mean,
                     strain="finite" if finite else "small"),
            {"m": Material(100.0, 0.4999)}, [Body("block", "m", order=lower)], contacts=[floor],
            displacements=[Displacement("top", [0.0] * (dim - 1) + [-0.02])],
            output=Output(fields=False, probes=["corner_10" + "0" * (dim - 2)]), petsc=PETSC, allow_unsafe=["locking"],
        ), SELF))  # fmt: skip
    # integrals of polynomials are the same with the points of both degrees
    rtol = 1e-3 if kinematics == "axisymmetric" else 1e-5 if finite else 1e-8
    np.testing.assert_allclose(found[1], found[0], rtol=rtol, atol=1e-7 if finite else 1e-9)
    assert abs(found[2][-1]) > 1.5 * abs(found[0][-1])


def test_tetrahedra_of_degree_1_lock_beside_others(shared_tmp):
    """And are refused, as in a scene of degree 1."""
    path = make_mesh(one_block, shared_tmp / "tetrahedron.msh", 3, 2, "tetrahedron")
    scene = Scene(MeshSpec(path, order=2), {"m": Material(100.0, 0.499)}, [Body("block", "m", order=1)],
                  displacements=[Displacement("bottom", [0] * 3)], petsc=PETSC)  # fmt: skip
    with pytest.raises(InputError, match="locking"):
        last(scene, SELF)


@pytest.mark.parallel
def test_ranks_do_not_matter(shared_tmp):
    """A body of each degree, with contact between them and friction on the ground below."""
    path = make_mesh(two_blocks, shared_tmp / "two.msh", 3, 2, 3)

    def scene(lower):
        return Scene(
            MeshSpec(path, order=2, serendipity=True), {"m": Material(100.0, 0.3)},
            [Body("lower", "m", order=lower), Body("upper", "m")],
            contacts=[Contact("upper_bottom", "lower_top", friction=0.4),
                      Contact("lower_bottom", obstacle=Obstacle("plane", [0, 0, 0.005], [0, 0, 1]), friction=0.3)],
            displacements=[Displacement("upper_top", [0.005, 0, -0.02])],
            output=Output(fields=False, probes=["lower_top", "upper_bottom"]), petsc=PETSC,
        )  # fmt: skip

    one = last(scene(1), SELF)
    np.testing.assert_allclose(last(scene(1), WORLD), one, rtol=1e-6, atol=1e-9)
    assert np.abs(last(scene(None), SELF) - one).max() > 1e-6
