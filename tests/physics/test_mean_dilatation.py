"""Mean dilatation: no locking, exact patches, coercive contact, when it is chosen."""

import numpy as np
import pytest

from drivers._common import running
from drivers.error_norms import bulk_error
from drivers.studies._extreme_shapes import wave
from drivers.studies._robust_scenes import squeezed_ring
from meshes.blocks import one_block, two_blocks
from pcontact.assembly.geometry import bulk_degree
from pcontact.contact.law import Frictionless, RowLaw
from pcontact.contact.pair import contact_pair
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.surface.sides import source_surface
from pcontact.element.dilatation import mean_dilatation
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, shape
from pcontact.material.elastic import lame
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene
from pcontact.scene.validate import validate
from pcontact.simulation import Simulation
from pcontact.space.space import Space
from tests.support.kinematics import DIRECT, cylinder, mesh, nodal, solved, strip
from tests.support.pairs import STEPS, check_taylor, motion, pair
from tests.support.pairs import bodies as friction_between
from tests.support.small import (
    DIMENSION,
    SELF,
    bend,
    block_file,
    blocks_file,
    dense_item,
    elastic_solid,
    make_space,
    numpy_gradients,
    vector_of,
)

WORLD = MPI.COMM_WORLD
SOFT = 0.4999
# closed points that do not slip
ROUGH = RowLaw([0.0, 1e300, np.inf])
TENSOR = ["quadrilateral", "hexahedron"]


# -- locking ------------------------------------------


def radial_error(folder, n, mean_dilatation, nu=SOFT):
    """Relative L2 error of the thick cylinder. Collective."""
    scene = strip(folder / f"{n}.msh", n, "quadrilateral", nu=nu, mean_dilatation=mean_dilatation)

    def look(simulation):
        space = simulation.problem.space
        error = bulk_error(space, [lame(210e3, nu)], simulation.stepper.u, lambda x, body: cylinder(x, body, nu))
        return error.displacement / error.displacement_of_exact

    return solved(scene, look)


@pytest.mark.parallel(2, 3)
def test_thick_cylinder(shared_tmp):
    """Axial symmetry, nu = 0.4999: order 2 with, 80 % too stiff without; usual nu: no difference."""
    errors = [radial_error(shared_tmp, n, None) for n in (8, 16)]
    assert errors[0] < 2e-3 and np.log2(errors[0] / errors[1]) > 1.8
    assert radial_error(shared_tmp, 8, False) > 0.7
    usual = [radial_error(shared_tmp, 8, chosen, 0.3) for chosen in (None, False, True)]
    # sums over ranks come in any order
    assert usual[0] == pytest.approx(usual[1], rel=1e-9) and max(usual) < 5e-3


def bending(folder, dim, cell, order=1, n=4, **more):
    """Cantilever 1 x 4, clamped at the left, sheared at the right; deflection of the end. Collective."""
    size = (4.0, *[1.0] * (dim - 1))
    cells = (4 * n, *[2 if dim == 3 else n] * (dim - 2), n)
    path = mesh(one_block, folder / f"{cell}{n}.msh", dim, cells, cell, size=size)
    # a slice in space: no strain across it
    across = [Displacement(side, ["free", 0.0, "free"]) for side in ("front", "back")] if dim == 3 else []
    scene = Scene(
        mesh=MeshSpec(path, order=order, **more),
        materials={"m": Material(1000.0, SOFT)},
        bodies=[Body("block", "m")],
        displacements=[Displacement("left", [0.0] * dim), *across],
        loads=[Load("right", traction=[*[0.0] * (dim - 1), 1.0])],
        output=Output(fields=False, probes=["right"]),
        petsc=DIRECT,
    )

    def look(simulation):
        u, x = nodal(simulation)
        end = x[:, 0] > 4.0 - 1e-9
        return float(np.mean(u[end, -1])) if end.any() else np.nan

    return solved(scene, look)


@pytest.mark.parametrize("dim, cell", [(2, "quadrilateral"), (3, "hexahedron")])
def test_bending(tmp_path, dim, cell):
    """nu = 0.4999, against quadratic cells of twice the fineness."""
    exact = bending(tmp_path, 2, "quadrilateral", order=2, n=8)
    assert bending(tmp_path, dim, cell) == pytest.approx(exact, rel=0.05)
    assert bending(tmp_path, dim, cell, n=8 if dim == 2 else 6) == pytest.approx(exact, rel=0.02)
    assert bending(tmp_path, dim, cell, mean_dilatation=False) < 0.35 * exact


# -- operators ----------------------------------------


KINDS = [*((cell, 1) for cell in TENSOR), *((cell, 2) for cell in DIMENSION)]


@pytest.fixture(scope="module", params=KINDS, ids=lambda kind: f"{kind[0]}-{kind[1]}")
def spaces(request, tmp_path_factory):
    """A bent box without and with mean dilatation, on one rank; of degree 2 with curved cells."""
    cell, degree = request.param
    path = block_file(tmp_path_factory.mktemp("b") / "b.msh", cell, 2, degree)
    plain = make_space(SELF, path, ["block"], degree, bend)
    return plain, Space(plain.mesh, degree, averaged=[0], averaged_simplices=[0])


def modes(space, x):
    """What the dilatation is projected onto, at points (..., d): constants, or linear functions."""
    linear = space.degree == 2 and space.mesh.blocks[0].cell in TENSOR
    return np.concatenate([np.ones_like(x[..., :1]), x], axis=-1) if linear else np.ones_like(x[..., :1])


def own_rule(space):
    """Gradients, weights and points of the quadrature of the cells' stiffness."""
    block = space.mesh.blocks[0]
    table, geometry = space.mesh.geometry_nodes(block)
    xi, weights = quadrature(block.cell, bulk_degree(block.cell, space.degree, geometry))
    grad, weight, _ = numpy_gradients(space, 0, xi, weights)
    return grad, weight, shape(block.cell, geometry, xi) @ space.mesh.points[table]


def test_stiffness(spaces):
    """int (lam + 2/3 mu) mean(div u)^2 + 2 mu |dev eps|^2, cell by cell, from the quadrature of the plain one.

    With degree 2  int lam mean(div u)^2 + 2 mu |eps|^2.
    """
    plain, averaged = spaces
    lam, mu = 3.0, 2.0
    own = -2.0 / 3.0 * mu if plain.degree == 1 else 0.0
    k = {
        "mean": dense_item(elastic_solid(averaged, [(lam, mu)]), plain.vector()),
        "shear": dense_item(elastic_solid(plain, [(own, mu)]), plain.vector()),
    }
    difference = k["mean"] - k["shear"]
    np.testing.assert_allclose(difference, difference.T, atol=1e-12)
    values, cells = np.linalg.eigvalsh(difference), len(plain.cells[0])
    # as many squares for each cell as there are modes (a checkerboard may be dependent) and nothing else
    size = modes(averaged, np.zeros((1, plain.dim))).shape[1]
    assert 0 < np.sum(values > 1e-9) <= size * cells and values[0] > -1e-10
    x = plain.points[plain.owned_local]
    volume = sum(v.sum() for _, v in elastic_solid(plain, [(lam, mu)]).stress(plain.vector()))
    blow = x.ravel() @ difference @ x.ravel()
    assert blow == pytest.approx((lam - own) * plain.dim**2 * volume, rel=1e-12)
    # any other displacement, against least squares in every cell
    u = np.random.default_rng(3).normal(size=plain.points.shape)
    grad, weight, points = own_rule(plain)
    divergence = np.einsum("cqad,cad->cq", grad, u[plain.cells[0]])
    root, energy = np.sqrt(weight), 0.0
    for c, basis in enumerate(modes(averaged, points)):
        fit = np.linalg.lstsq(root[c][:, None] * basis, root[c] * divergence[c], rcond=None)[0]
        energy += (lam - own) * weight[c] @ (basis @ fit) ** 2
    owned = u[plain.owned_local].ravel()
    assert owned @ difference @ owned == pytest.approx(energy, rel=1e-9)


def test_uniform_strain_is_the_same(spaces):
    plain, averaged = spaces
    d, rng = plain.dim, np.random.default_rng(0)
    u = vector_of(plain, plain.points[plain.owned_local] @ rng.normal(size=(d, d)))
    results = []
    for space in (plain, averaged):
        bulk, out = elastic_solid(space, [(3.0, 2.0)]), np.zeros((space.n_owned, d))
        bulk.residual(u, out)
        results.append((out, bulk.stress(u)[0][0]))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_only_rigid_modes_cost_nothing(spaces):
    _, averaged = spaces
    values = np.linalg.eigvalsh(dense_item(elastic_solid(averaged, [lame(1.0, SOFT)]), averaged.vector()))
    n = 3 if averaged.dim == 2 else 6
    assert np.abs(values[:n]).max() < 1e-12 * values[-1] and values[n] > 1e-7 * values[-1]


def test_pressure_at_facets(spaces):
    """(lam + 2/3 mu) mean(div u) - 2/3 mu div u of the parent cell, with degree 2 lam mean(div u)."""
    _, space = spaces
    lam, mu, rng = 3.0, 2.0, np.random.default_rng(1)
    surface = source_surface(space, "bottom", [(lam, mu)])
    u = rng.normal(size=space.points.shape)
    values = u[surface.cells[surface.facet]]
    grad, weight, points = own_rule(space)
    divergence, root = np.einsum("cqad,cad->cq", grad, u[space.cells[0]]), np.sqrt(weight)
    basis = modes(space, points)
    fits = np.array([
        np.linalg.lstsq(root[c][:, None] * basis[c], root[c] * divergence[c], rcond=None)[0] for c in range(len(root))
    ])  # fmt: skip
    row = {tuple(nodes): c for c, nodes in enumerate(space.cells[0].tolist())}
    parent = np.array([row[tuple(nodes)] for nodes in surface.cells.tolist()])[surface.facet]
    mean = np.sum(modes(space, surface.x) * fits[parent], axis=1)
    own = -2.0 / 3.0 * mu if space.degree == 1 else 0.0
    expected = (lam - own) * mean + own * np.einsum("pad,pad->p", surface.grad, values)
    np.testing.assert_allclose(np.einsum("pad,pad->p", surface.volumetric, values), expected, atol=1e-9)


def lowest(space, theta, gamma0, law, nu):
    """Smallest eigenvalue of the symmetric part of K_bulk + K_contact of a closed pair over the largest."""
    constants, d = [lame(1.0, nu)], space.dim
    obstacle = Obstacle("plane", point=[0.0] * d, normal=[*[0.0] * (d - 1), 1.0])
    contact = Contact("bottom", obstacle=obstacle, theta=theta, gamma0=gamma0, bilateral=True)
    rigid = RigidObstacle(obstacle, amplitude(None, 1.0), 1.0)
    source = source_surface(space, "bottom", constants, sticks=law.tangential)
    item = contact_pair(space, contact, source, rigid, 1.0, law=law)
    zero = space.vector()
    item.detect(zero, 1.0)
    k = dense_item(elastic_solid(space, constants), zero) + dense_item(item, zero)
    eigenvalues = np.linalg.eigvalsh(0.5 * (k + k.T))
    return eigenvalues[0] / eigenvalues[-1]


@pytest.mark.parametrize("law", [Frictionless(), ROUGH], ids=["frictionless", "rough"])
@pytest.mark.parametrize("theta", [1.0, 0.0])
@pytest.mark.parametrize("nu", [0.3, SOFT])
@pytest.mark.parametrize(
    "cell, kinematics",
    [("quadrilateral", "plane_strain"), ("quadrilateral", "axisymmetric"), ("hexahedron", "plane_strain")],
)
@pytest.mark.parametrize("degree", [1, 2])
def test_coercive(tmp_path, degree, cell, kinematics, nu, theta, law):
    """Stable from gamma0 = (1 + theta)^2 / 4, not far below."""
    path = one_block(tmp_path / "b.msh", DIMENSION[cell], 1, cell, lower=1.0)
    lowered = make_space(SELF, path, ["block"], degree, lambda x: x - np.eye(x.shape[1])[-1])
    space, bound = Space(lowered.mesh, degree, kinematics, [0]), (1.0 + theta) ** 2 / 4.0
    assert lowest(space, theta, 1.01 * bound, law, nu) > -1e-12
    assert lowest(space, theta, 0.5 * bound, law, nu) < -1e-6


@pytest.mark.parametrize("theta", [1.0, 0.0])
@pytest.mark.parametrize("cell, kinematics", [
    ("triangle", "plane_strain"), ("triangle", "axisymmetric"), ("tetrahedron", "plane_strain"),
])  # fmt: skip
def test_coercive_simplices(tmp_path, cell, kinematics, theta):
    """With the bound of cells that do not average, which theirs is not above."""
    path = one_block(tmp_path / "b.msh", DIMENSION[cell], 1, cell, lower=1.0)
    lowered = make_space(SELF, path, ["block"], 2, lambda x: x - np.eye(x.shape[1])[-1])
    space = Space(lowered.mesh, 2, kinematics, averaged_simplices=[0])
    assert lowest(space, theta, 1.01 * (1.0 + theta) ** 2 / 4.0, ROUGH, SOFT) > -1e-12


@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("cell, kinematics", [
    ("triangle", "plane_strain"), ("quadrilateral", "plane_strain"), ("quadrilateral", "axisymmetric"),
])  # fmt: skip
def test_tangent_of_a_pair_of_degree_2(tmp_path, cell, kinematics, theta):
    """The derivative of the forces, in every status."""
    path = blocks_file(tmp_path / "b.msh", cell, [2, 2], [3, 1], offset=0.3)
    mesh_of = make_space(SELF, path, ["lower", "upper"], 2).mesh
    space = Space(mesh_of, 2, kinematics, [0, 1], [0, 1])
    item = pair(space, friction_between("coulomb", theta=theta, alpha=0.7), radius=0.3)
    assert item.source.shared is not None
    first = motion(space, -0.01, 0.01)
    item.detect(space.vector(), 0.5)
    item.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    for depth, slide, tilt in STEPS:
        check_taylor(item, first + motion(space, depth + 0.01, slide, tilt, seed=3), "coulomb")


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("cell, bound", [("quadrilateral", 6e-3), ("triangle", 6e-2)])
def test_pressure_of_a_wave(shared_tmp, cell, bound):
    """Westergaard's solution with nu = 0.4999 and cells of degree 2; the pressure is lost without."""
    errors = []
    for chosen in (None, False):
        scene, measure = wave(shared_tmp, cell=cell, part=0.5, nu=SOFT, petsc=DIRECT)
        scene.mesh.mean_dilatation, scene.output.fields = chosen, False
        with running(scene, None) as (simulation, converged):
            assert converged
            errors.append(measure(simulation, [])["pressure, L2"])
    assert errors[0] < bound and errors[1] > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["nitsche", "penalty"])
def test_squeezed_ring_with_friction(tmp_path, formulation):
    """Points stick by springs that are as stiff as rubber is in shear. With lambda in them load steps of the penalty
    method fail."""
    scene = squeezed_ring(tmp_path, formulation=formulation)
    with running(scene, None) as (simulation, converged):
        assert converged
        (pair,) = simulation.problem.contacts[0].pairs
        lam, mu = lame(6.0, 0.4995)
        np.testing.assert_allclose(pair.method.alpha, 4.0 * mu / (lam + 2.0 * mu))


@pytest.mark.parametrize("nu, said, expected", [(-0.3, None, 1.0), (0.4, None, 2.0 / 3.0), (0.4, 0.7, 0.7)])
def test_alpha(tmp_path, nu, said, expected):
    path = block_file(tmp_path / "b.msh", "quadrilateral")
    wall = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    scene = Scene(MeshSpec(path), {"m": Material(1.0, nu)}, [Body("block", "m")],
                  contacts=[Contact("bottom", obstacle=wall, name="floor", friction=0.1, alpha=said)])  # fmt: skip
    with running(scene, None) as (simulation, _):
        np.testing.assert_allclose(simulation.problem.contacts[0].pairs[0].method.alpha, expected)


# -- patch tests --------------------------------------


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("cell", TENSOR)
def test_two_blocks(shared_tmp, cell, theta, friction):
    """Uniform pressure between matching meshes, nu = 0.49."""
    d, young, nu, pressure = DIMENSION[cell], 10.0, 0.49, 0.1
    path = mesh(two_blocks, shared_tmp / "b.msh", d, 2, 2, cell)
    planes = [Displacement("left", [0.0, *["free"] * (d - 1)])]
    if d == 3:
        planes.append(Displacement("front", ["free", 0.0, "free"]))
    scene = Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(young, nu)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", theta=theta, friction=friction, name="c")],
        displacements=[Displacement("lower_bottom", [*["free"] * (d - 1), 0.0]), *planes],
        loads=[Load("upper_top", pressure=pressure)],
        output=Output(fields=False),
        petsc={"snes_rtol": "1e-10"},
    )

    def look(simulation):
        assert "mean dilatation: lower, upper" in simulation.describe()[0]
        stress = simulation.problem.items[0].stress(simulation.stepper.u)
        return *nodal(simulation), stress, simulation.problem.contacts[0].summary(simulation.stepper.u)

    u, x, stress, pair = solved(scene, look)
    flat = nu * (1 + nu) if d == 2 else nu
    down = 1 - nu**2 if d == 2 else 1.0
    expected = pressure / young * x * [*[flat] * (d - 1), -down]
    np.testing.assert_allclose(u, expected, atol=1e-9)
    assert pair["max_pressure"] == pytest.approx(pressure, rel=1e-7)
    for values, _ in stress:
        np.testing.assert_allclose(values[:, d - 1], -pressure, rtol=1e-7)


# -- when it is chosen --------------------------------


def block(folder, cell, nu, order=1, **more):
    path = block_file(folder / f"{cell}.msh", cell)
    return Scene(
        mesh=MeshSpec(path, order=order, **more),
        materials={"m": Material(1.0, nu)},
        bodies=[Body("block", "m")],
        displacements=[Displacement("bottom", [0.0] * DIMENSION[cell])],
    )


@pytest.mark.parametrize(
    "cell, nu, order, said, chosen",
    [
        ("quadrilateral", 0.3, 1, {}, False),
        ("quadrilateral", 0.46, 1, {}, True),
        ("hexahedron", 0.46, 1, {}, True),
        ("quadrilateral", 0.46, 1, {"kinematics": "axisymmetric"}, True),
        ("quadrilateral", 0.46, 1, {"kinematics": "plane_stress"}, False),
        ("quadrilateral", 0.45, 2, {}, False),
        ("quadrilateral", 0.46, 2, {}, True),
        ("hexahedron", 0.46, 2, {}, True),
        ("triangle", 0.49, 2, {}, False),
        ("triangle", 0.495, 2, {}, True),
        ("tetrahedron", 0.495, 2, {}, True),
        ("tetrahedron", 0.495, 2, {"mean_dilatation": False}, False),
        ("triangle", 0.3, 2, {"mean_dilatation": True}, True),
        ("triangle", 0.3, 1, {"mean_dilatation": True}, False),
        ("quadrilateral", 0.46, 1, {"mean_dilatation": False}, False),
        ("quadrilateral", 0.3, 1, {"mean_dilatation": True}, True),
    ],
)
def test_choice(tmp_path, cell, nu, order, said, chosen):
    simulation = Simulation(block(tmp_path, cell, nu, order, **said))
    assert ("mean dilatation: block" in simulation.describe()[0]) == chosen
    assert simulation.problem.space.averages(simulation.mesh.blocks[0]) == chosen
    simulation.close()


def test_bodies_that_may_yield(tmp_path):
    scene = block(tmp_path, "quadrilateral", 0.3)
    scene.materials["m"].yield_stress = 1.0
    assert scene.averages(scene.bodies[0]) and not scene.locks(scene.bodies[0])
    scene.mesh.order = 2
    assert not scene.averages(scene.bodies[0]) and not scene.averages(scene.bodies[0], True)


@pytest.mark.parametrize("cell, nu, order, kinematics, refused", [
    ("triangle", 0.46, 1, "plane_strain", True),
    ("tetrahedron", 0.46, 1, "plane_strain", True),
    ("triangle", 0.46, 1, "axisymmetric", True),
    ("triangle", 0.46, 1, "plane_stress", False),
    ("triangle", 0.46, 2, "plane_strain", False),
    ("triangle", 0.45, 1, "plane_strain", False),
    ("quadrilateral", 0.46, 1, "plane_strain", False),
])  # fmt: skip
def test_simplices_of_degree_1_are_refused(tmp_path, monkeypatch, cell, nu, order, kinematics, refused):
    said = []
    monkeypatch.setattr("pcontact.runtime.log.warning", lambda text, *args: said.append(text % args))
    scene = block(tmp_path, cell, nu, order, kinematics=kinematics)
    if refused:
        with pytest.raises(InputError, match=r"materials.m.nu: found 0.46 in .*locking.*order = 2.*allow_unsafe lock"):
            Simulation(scene)
    scene.allow_unsafe = ["locking"]
    Simulation(scene).close()
    assert [("locking" in text and "order = 2" in text) for text in said] == [True] * refused


def test_warning_of_stress_that_is_lost(tmp_path, monkeypatch):
    """Who takes the mean dilatation out is warned."""
    said = []
    monkeypatch.setattr("pcontact.build.log.warning", lambda text, *args: said.append(text % args))
    Simulation(block(tmp_path, "triangle", 0.4999, 2, mean_dilatation=False)).close()
    Simulation(block(tmp_path, "triangle", 0.4999, 2)).close()
    assert len(said) == 1 and "by 2500 in stress" in said[0]


def test_plane_stress_is_refused(tmp_path):
    scene = block(tmp_path, "quadrilateral", 0.3, kinematics="plane_stress", mean_dilatation=True)
    with pytest.raises(InputError, match="mesh.mean_dilatation: found true together with .* kinematics"):
        validate(scene)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_of_no_cells(cell, degree):
    """A rank without cells of a block."""
    d = CELLS[cell].dim
    found = mean_dilatation(cell, np.zeros((0, CELLS[cell].n_vertices, d)), 1, degree, 4, False)
    assert [len(array) for array in found] == [0, 0]
