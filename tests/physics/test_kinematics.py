"""Plane stress and axial symmetry: closed forms, patch tests, contact, coercivity, what is refused."""

import numpy as np
import pytest

from drivers.cases.hertz import fit
from drivers.error_norms import bulk_error
from meshes.blocks import one_block, two_blocks
from meshes.hertz import cylinders, two_balls
from meshes.rings import rings
from pcontact.contact.law import Frictionless, RowLaw
from pcontact.contact.pair import contact_pair
from pcontact.contact.surface.obstacle import RigidObstacle
from pcontact.contact.surface.sides import source_surface
from pcontact.element.dilatation import Dilatation
from pcontact.element.trace import trace_constant
from pcontact.material.elastic import in_plane, lame
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import (
    Body,
    Contact,
    Coupling,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
    Spring,
)
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation
from pcontact.space.space import Space
from tests.support.kinematics import DIRECT, INNER, NU, OUTER, PRESSURE, E, cylinder, mesh, nodal, solved, strip
from tests.support.pairs import STEPS, check_taylor, motion, pair, residual_of
from tests.support.pairs import bodies as friction_between
from tests.support.small import DIMENSION, SELF, blocks_file, dense_item, elastic_solid, make_space, vector_of

WORLD = MPI.COMM_WORLD
THETAS = [1.0, 0.0, -1.0]
# closed points that do not slip
ROUGH = RowLaw([0.0, 1e300, np.inf])


def stresses(simulation):
    """(n, 6) of the cells of this rank."""
    return np.concatenate([stress for stress, _ in simulation.problem.items[0].stress(simulation.stepper.u)])


def everywhere(value, largest=True):
    """The largest or smallest of all ranks, which may have none."""
    return WORLD.allreduce(float(value), op=MPI.MAX if largest else MPI.MIN)


# -- thick cylinder under inner pressure -----------------------------------


@pytest.mark.parametrize(
    "cell, order",
    [pytest.param("quadrilateral", 1, marks=pytest.mark.parallel(2, 3)), ("triangle", 1),
     pytest.param("triangle", 2, marks=pytest.mark.parallel(2, 3)), ("quadrilateral", 2)],
)  # fmt: skip
def test_thick_cylinder_axisymmetric(shared_tmp, cell, order):
    def look(simulation):
        u, x = nodal(simulation)
        inside = np.mean(u[x[:, 0] < INNER + 1e-9, 0]) if np.any(x[:, 0] < INNER + 1e-9) else -np.inf
        space, stress = simulation.problem.space, simulation.problem.items[0].stress(simulation.stepper.u)
        error = bulk_error(space, [lame(E, NU)], simulation.stepper.u, cylinder)
        volume = WORLD.allreduce(sum(v.sum() for _, v in stress))
        return everywhere(inside), error, volume

    errors, energies = [], []
    for n in (5, 10, 20):
        inside, error, volume = solved(strip(shared_tmp / f"{n}.msh", n, cell, order), look)
        errors.append(error.displacement / error.displacement_of_exact)
        energies.append(error.energy / error.energy_of_exact)
        assert volume == pytest.approx(np.pi * (OUTER**2 - INNER**2) * 2.0, rel=1e-12)
    assert inside == pytest.approx(9.08e-3, rel=2e-3)
    assert -np.diff(np.log2(errors))[-1] > order + 1 - 0.2
    assert -np.diff(np.log2(energies))[-1] > order - 0.1


def test_thick_cylinder_hoop_stress(shared_tmp):
    """Radial, axial, hoop stress at the middle of the cells: 166.7 inside, 66.7 outside."""
    stress, x = solved(
        strip(shared_tmp / "s.msh", 100, "quadrilateral"),
        lambda s: (stresses(s), s.problem.space.points[s.problem.space.cells[0], 0].mean(axis=1)),
    )
    part = PRESSURE * INNER**2 / (OUTER**2 - INNER**2)
    expected = np.zeros((len(x), 6))
    expected[:, 0], expected[:, 2] = part * (1 - (OUTER / x) ** 2), part * (1 + (OUTER / x) ** 2)
    expected[:, 1] = NU * 2 * part
    assert np.abs(stress - expected)[:, [0, 1, 2]].max() < 0.7
    assert np.abs(stress[:, 4:]).max() == 0.0
    assert stress[:, 2].max() == pytest.approx(166.7, rel=0.01)
    assert stress[:, 2].min() == pytest.approx(66.7, rel=0.005)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("kinematics", ["plane_strain", "plane_stress"])
def test_thick_cylinder_of_two_rings(shared_tmp, kinematics):
    """Quarter of two rings that contact holds together: as if they were one."""
    path = mesh(rings, shared_tmp / "rings.msh", (OUTER, 15.0, INNER), 16, order=2)
    scene = Scene(
        mesh=MeshSpec(path, order=2, kinematics=kinematics),
        materials={"m": Material(E, NU)},
        bodies=[Body("outer", "m"), Body("inner", "m")],
        contacts=[Contact("inner_outer_skin", "outer_inner_skin", name="c")],
        displacements=[Displacement("symmetry_x", [0.0, "free"]), Displacement("symmetry_y", ["free", 0.0])],
        loads=[Load("inner_skin", pressure=PRESSURE)],
        output=Output(fields=False),
        petsc=DIRECT,
    )

    def look(simulation):
        u, x = nodal(simulation)
        radius = np.linalg.norm(x, axis=1)
        radial = np.einsum("nd,nd->n", u, x) / radius
        stress, (lam, mu) = stresses(simulation), simulation.problem.items[0].constants[0]
        return radius, radial, stress, (lam, mu), simulation.problem.contacts[0].summary(simulation.stepper.u)

    radius, radial, stress, (lam, mu), pair_ = solved(scene, look)
    part = PRESSURE * INNER**2 / (OUTER**2 - INNER**2)
    uniform = 1 - 2 * NU if kinematics == "plane_strain" else (1 - NU) / (1 + NU)
    expected = (1 + NU) / E * part * (uniform * radius + OUTER**2 / radius)
    np.testing.assert_allclose(radial, expected, rtol=5e-4)
    # sigma_11 + sigma_22 is the same everywhere, sigma_33 follows from it
    assert np.abs(stress[:, 0] + stress[:, 1] - 2 * part).max() < 0.05 * part
    out_of_plane = NU * (stress[:, 0] + stress[:, 1]) if kinematics == "plane_strain" else 0.0
    np.testing.assert_allclose(stress[:, 2], out_of_plane, atol=1e-9)
    # the quarter's resultant
    assert pair_["force"] == pytest.approx([15.0 * part * ((OUTER / 15.0) ** 2 - 1)] * 2, rel=2e-3)
    assert pair_["open"] == 0


def test_constants_of_plane_stress():
    lam, mu = lame(7.0, 0.3)
    flat, shear = in_plane(lam, mu, "plane_stress")
    assert shear == mu and flat + 2 * mu == pytest.approx(7.0 / (1 - 0.3**2))
    assert in_plane(lam, mu, "plane_strain") == in_plane(lam, mu, "axisymmetric") == (lam, mu)
    # no stress out of the plane
    strain = -lam / (lam + 2 * mu)
    assert lam * (1.0 + strain) + 2 * mu * strain == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("cell, order", [("triangle", 1), ("quadrilateral", 2)])
def test_plane_stress_tension(shared_tmp, cell, order):
    path = mesh(one_block, shared_tmp / "b.msh", 2, 3, cell)
    scene = Scene(
        mesh=MeshSpec(path, order=order, kinematics="plane_stress"),
        materials={"m": Material(7.0, NU)},
        bodies=[Body("block", "m")],
        displacements=[Displacement("left", [0.0, "free"]), Displacement("bottom", ["free", 0.0])],
        loads=[Load("right", traction=[0.5, 0.0])],
        output=Output(fields=False),
        petsc=DIRECT,
    )
    u, x, stress = solved(scene, lambda s: (*nodal(s), stresses(s)))
    np.testing.assert_allclose(u, x * [0.5 / 7.0, -NU * 0.5 / 7.0], atol=1e-11)
    np.testing.assert_allclose(stress, np.tile([0.5, 0, 0, 0, 0, 0], (len(stress), 1)), atol=1e-10)


# -- contact with axial symmetry -------------------------------------------


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("cell, order", [("quadrilateral", 1), ("triangle", 1), ("quadrilateral", 2)])
def test_stacked_cylinders(shared_tmp, cell, order, theta, friction):
    """Two solid cylinders on each other: uniform stress, u_r = nu p r / E, on the axis too."""
    path = mesh(two_blocks, shared_tmp / "b.msh", 2, 3, 3, cell)
    scene = Scene(
        mesh=MeshSpec(path, order=order, kinematics="axisymmetric"),
        materials={"m": Material(10.0, NU)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", theta=theta, friction=friction, name="c")],
        displacements=[Displacement("lower_bottom", ["free", 0.0])],
        loads=[Load("upper_top", pressure=1.0)],
        output=Output(fields=False),
        petsc={**DIRECT, "snes_rtol": "1e-10"},
    )

    def look(simulation):
        # radially they are held by their hoops, and turning is no rigid motion
        assert simulation.floating == {1: 1}
        record = simulation.problem.contacts[0].summary(simulation.stepper.u)
        support = simulation.problem.forces.reactions(simulation.stepper.u)["lower_bottom"]
        return *nodal(simulation), stresses(simulation), record, support

    u, x, stress, pair_, support = solved(scene, look)
    np.testing.assert_allclose(u[:, 0], NU / 10.0 * x[:, 0], atol=1e-10)
    np.testing.assert_allclose(stress, np.tile([0, -1.0, 0, 0, 0, 0], (len(stress), 1)), atol=1e-9)
    assert pair_["area"] == pytest.approx(np.pi, rel=1e-12)
    assert pair_["force"][1] == pytest.approx(-np.pi, rel=1e-9)
    assert support[1] == pytest.approx(np.pi, rel=1e-9)
    assert pair_["max_pressure"] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("theta", THETAS)
def test_shaft_in_a_sleeve(shared_tmp, theta):
    """Shrink fit of a solid shaft: the pressure of Lame, the same along the axis, radial forces in balance or not."""
    c, b, height, delta = 1.0, 2.0, 0.5, 1e-3
    path = mesh(
        two_blocks, shared_tmp / "t.msh", 2, (8, 4), (12, 6), "quadrilateral",
        heights=(height, height), gap=-height, offset=c, widths=(c + delta, b - c),
    )  # fmt: skip
    held = [Displacement(f"{body}_{side}", ["free", 0.0]) for body in ("lower", "upper") for side in ("bottom", "top")]
    scene = Scene(
        mesh=MeshSpec(path, kinematics="axisymmetric"),
        materials={"m": Material(E, NU)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_left", "lower_right", theta=theta, name="c")],
        displacements=held,
        output=Output(fields=False),
    )

    def look(simulation):
        assert simulation.floating == {}
        problem, u = simulation.problem, simulation.stepper.u
        record = problem.contacts[0].summary(u)
        total = problem.forces.resultant({"reactions": problem.forces.reactions(u), "contacts": {"c": record}}, u)
        return record, total

    pair_, imbalance = solved(scene, look)
    free = 1 - 2 * NU
    expected = delta * E / (c * (1 + NU) * (free + (free * c**2 + b**2) / (b**2 - c**2)))
    area = 2 * np.pi * c * height
    # the force on the shaft points inwards, summed over the circumference
    assert -pair_["force"][0] / area == pytest.approx(expected, rel=5e-3)
    assert pair_["area"] == pytest.approx(area, rel=1e-9)
    assert pair_["max_pressure"] == pytest.approx(expected, rel=1e-2)
    assert imbalance < 1e-6 * area * expected


def balls(path, kinematics, h, half):
    """Two half balls of radius 50 pressed together by 2 half."""
    if kinematics == "axisymmetric":
        path = mesh(cylinders, path, h, 2, radius=50.0, half=True, contact_radius=15.0)
        symmetry, free = [Displacement("symmetry_x", [0.0, "free"])], ["free"]
    else:
        path = mesh(two_balls, path, h, 2, growth=0.6)
        symmetry = [
            Displacement("symmetry_x", [0.0, "free", "free"]), Displacement("symmetry_y", ["free", 0.0, "free"])
        ]  # fmt: skip
        free = ["free", "free"]
    return Scene(
        mesh=MeshSpec(path, order=2, kinematics=kinematics),
        materials={"m": Material(20000.0, NU)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_skin", "lower_skin", name="c")],
        displacements=[
            Displacement("upper_flat", [*free, -half]), Displacement("lower_flat", [*free, half]), *symmetry
        ],
        output=Output(fields=False),
    )  # fmt: skip


@pytest.mark.parallel(2, 3)
def test_hertz_axisymmetric(shared_tmp):
    """Contact radius and largest pressure for the computed force."""

    def look(simulation):
        item, u = simulation.problem.contacts[0], simulation.stepper.u
        states = WORLD.allgather(item.state(u))
        state = {key: np.concatenate([part[key] for part in states]) for key in ("x", "pressure", "weight")}
        return item.summary(u), state

    pair_, state = solved(balls(shared_tmp / "b.msh", "axisymmetric", 0.5, 0.5), look)
    modulus, radius, force = 20000.0 / (2 * (1 - NU**2)), 25.0, -pair_["force"][1]
    a = np.cbrt(3 * force * radius / (4 * modulus))
    p0 = 3 * force / (2 * np.pi * a**2)
    fitted = fit(state["x"][:, 0], state["pressure"], state["weight"], np.sqrt(pair_["area"] / np.pi))
    assert fitted == pytest.approx((a, p0), rel=0.01)
    assert pair_["max_pressure"] == pytest.approx(p0, rel=0.02)


def test_as_stiff_as_in_space(shared_tmp):
    """The whole body of the meridian section bears the force of four quarters of the one in space."""
    forces = []
    for kinematics, h in (("axisymmetric", 1.5), ("plane_strain", 3.0)):
        scene = balls(shared_tmp / f"{kinematics}.msh", kinematics, h, 2.0)
        forces.append(solved(scene, lambda s: s.problem.forces.reactions(s.stepper.u)["lower_flat"][-1]))
    assert forces[0] == pytest.approx(4 * forces[1], rel=0.01)


@pytest.mark.parallel(2, 3)
def test_ball_on_a_rigid_plane(shared_tmp):
    """Half a ball on an obstacle is one of two equal balls."""
    both = balls(shared_tmp / "b.msh", "axisymmetric", 1.0, 0.5)
    one = balls(shared_tmp / "b.msh", "axisymmetric", 1.0, 0.5)
    plane = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    one.contacts = [
        Contact("upper_skin", obstacle=plane, name="c", friction=None),
        Contact("lower_skin", obstacle=Obstacle("plane", point=[0.0, 0.0], normal=[0.0, -1.0]), name="d"),
    ]
    force = [solved(scene, lambda s: s.problem.forces.reactions(s.stepper.u)["lower_flat"][1]) for scene in (both, one)]
    # (a / R)^2 = 0.01: two balls measure their gap along other lines than a ball and a plane
    assert force[0] == pytest.approx(force[1], rel=0.01)


# -- operators ----------------------------------------


def lowest(space, theta, gamma0, law):
    """Smallest eigenvalue of the symmetric part of K_bulk + K_contact of a closed pair, the axis held."""
    constants = [lame(1.0, NU)]
    obstacle = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    contact = Contact("bottom", obstacle=obstacle, theta=theta, gamma0=gamma0, bilateral=True)
    rigid = RigidObstacle(obstacle, amplitude(None, 1.0), 1.0)
    source = source_surface(space, "bottom", constants, sticks=law.tangential)
    item = contact_pair(space, contact, source, rigid, 1.0, law=law)
    zero = space.vector()
    item.detect(zero, 1.0)
    free = np.ones((space.n_owned, 2), dtype=bool)
    free[:, 0] = ~space.on_axis()[space.owned_local]
    k = dense_item(elastic_solid(space, constants), zero) + dense_item(item, zero)
    k = k[np.ix_(free.ravel(), free.ravel())]
    eigenvalues = np.linalg.eigvalsh(0.5 * (k + k.T))
    return eigenvalues[0] / eigenvalues[-1]


@pytest.mark.parametrize("law", [Frictionless(), ROUGH], ids=["frictionless", "rough"])
@pytest.mark.parametrize("theta", [1.0, 0.0])
@pytest.mark.parametrize("inner", [0.0, 1.0, 100.0])
@pytest.mark.parametrize("cell, degree", [("quadrilateral", 1), ("triangle", 1), ("quadrilateral", 2), ("triangle", 2)])
def test_coercive_with_axial_symmetry(tmp_path, cell, degree, inner, theta, law):
    """Stable from gamma0 = (1 + theta)^2 / 4 for cells at the axis and away from it, and not far below."""
    path = one_block(tmp_path / "b.msh", 2, 1, cell, lower=(inner, 0.0))
    space = Space(make_space(SELF, path, ["block"], degree).mesh, degree, "axisymmetric")
    bound = (1.0 + theta) ** 2 / 4.0
    assert lowest(space, theta, 1.01 * bound, law) > -1e-12
    assert lowest(space, theta, 0.5 * bound, law) < -1e-6


@pytest.mark.parametrize("cell, degree", [("quadrilateral", 1), ("triangle", 1), ("quadrilateral", 2), ("triangle", 2)])
def test_trace_constant_far_from_the_axis(cell, degree):
    """Near that of plane strain, above it where turning the cell, which strains its hoops, counts; in any units."""
    nodes = np.array([[0.0, 0.0], [1.0, 0.1], [1.1, 1.0], [-0.1, 0.9]])[: 3 if cell == "triangle" else 4]
    x = np.repeat((nodes + [0.2, 0.0])[None], len(nodes), axis=0)
    facets, constants = np.arange(len(nodes)), (3.0, 2.0)
    plane = trace_constant(cell, x, facets, 1, degree, *constants)
    near, far, farther = (
        trace_constant(cell, x + [shift, 0.0], facets, 1, degree, *constants, Dilatation(True, False))
        for shift in (0.0, 1e3, 1e4)
    )
    np.testing.assert_allclose(far, farther, rtol=5e-3)
    assert np.all((far > 0.999 * plane) & (far < 1.5 * plane))
    if degree == 2:
        np.testing.assert_allclose(farther, plane, rtol=5e-4)
    scaled = trace_constant(cell, 1e3 * x, facets, 1, degree, 6.0, 4.0, Dilatation(True, False))
    np.testing.assert_allclose(scaled, 2e-3 * near, rtol=1e-9)


@pytest.mark.parametrize("averaged", [(), (0, 1)])
@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("name", ["coulomb", "all"])
@pytest.mark.parametrize("kinematics", ["axisymmetric", "plane_strain"])
def test_tangent_of_a_pair(tmp_path, kinematics, name, theta, averaged):
    """The derivative of the forces, in every status; with the friction of a glued pair symmetric for theta = 1."""
    path = blocks_file(tmp_path / "b.msh", "quadrilateral", [2, 2], [3, 1], offset=0.3)
    shifted = make_space(SELF, path, ["lower", "upper"], 1)
    space = Space(shifted.mesh, 1, kinematics, averaged)
    item = pair(space, friction_between(name, theta=theta, alpha=0.7), radius=0.3)
    first = motion(space, -0.01, 0.01)
    item.detect(space.vector(), 0.5)
    item.commit(vector_of(space, first), 0.5)
    item.detect(vector_of(space, first), 1.0)
    for depth, slide, tilt in STEPS:
        check_taylor(item, first + motion(space, depth + 0.01, slide, tilt, seed=3), name)


@pytest.mark.parametrize("cell", [c for c, d in DIMENSION.items() if d == 2])
@pytest.mark.parametrize("degree", [1, 2])
def test_energy_of_a_uniform_strain(tmp_path, cell, degree):
    """u = (e r, k z): energy of the whole ring, forces without axial resultant, one rigid mode."""
    path = one_block(tmp_path / "b.msh", 2, 2, cell, lower=(0.5, 0.0))
    space = Space(make_space(SELF, path, ["block"], degree).mesh, degree, "axisymmetric")
    lam, mu = lame(5.0, 0.3)
    bulk, e, k = elastic_solid(space, [(lam, mu)]), 0.02, -0.05
    u = space.points[space.owned_local] * [e, k]
    force = residual_of(bulk, u)
    volume = np.pi * (1.5**2 - 0.5**2)
    density = lam * (2 * e + k) ** 2 + 2 * mu * (2 * e**2 + k**2)
    assert force @ u.ravel() == pytest.approx(volume * density, rel=1e-12)
    assert np.abs(force[1::2].sum()) < 1e-12
    for stress, _ in bulk.stress(vector_of(space, u)):
        expected = lam * (2 * e + k) + 2 * mu * np.array([e, k, e])
        np.testing.assert_allclose(stress[:, :3], np.tile(expected, (len(stress), 1)), rtol=1e-12)
    matrix = dense_item(bulk, space.vector())
    values = np.linalg.eigvalsh(matrix)
    assert abs(values[0]) < 1e-12 * values[-1] and values[1] > 1e-4 * values[-1]


# -- what is said and refused -------------------------


SCENE = """
[mesh]
file = "b.msh"
kinematics = "{kinematics}"
[materials.m]
E = 1.0
nu = 0.3
[[bodies]]
region = "block"
material = "m"
[[displacements]]
region = "bottom"
value = [{value}, 0.0]
"""


def scene_of(folder, lower=0.0, kinematics="axisymmetric", value="'free'"):
    one_block(folder / "b.msh", 2, 2, lower=(lower, 0.0))
    (folder / "s.toml").write_text(SCENE.format(kinematics=kinematics, value=value))
    return read_scene(folder / "s.toml")


def test_a_mesh_across_the_axis_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"s.toml: mesh.kinematics: found \"axisymmetric\" with 3 nodes of .*b.msh at "
                       r"x < 0, down to -0.2; allowed: a mesh in x >= 0"):  # fmt: skip
        Simulation(scene_of(tmp_path, lower=-0.2))
    Simulation(scene_of(tmp_path, lower=-0.2, kinematics="plane_stress")).close()


def test_nodes_on_the_axis_stay_there(tmp_path):
    """Held without a word of the scene, whatever else is prescribed there; they cannot be asked to leave."""
    simulation = Simulation(scene_of(tmp_path))
    fixed, space = simulation.problem.conditions.supports.fixed, simulation.problem.space
    np.testing.assert_array_equal(fixed[:, 0], space.points[:, 0] < 1e-12)
    np.testing.assert_array_equal(fixed[:, 1], space.points[:, 1] < 1e-12)
    assert simulation.floating == {} and list(simulation.problem.forces.reactions(space.vector())) == ["bottom"]
    simulation.close()
    with pytest.raises(InputError, match=r"displacements\[0\] \(bottom\).value: found 0.1 in direction 0 on the axis"):
        Simulation(scene_of(tmp_path, value="0.1"))


def test_no_contact_on_the_axis(tmp_path):
    scene = scene_of(tmp_path)
    scene.contacts = [Contact("left", obstacle=Obstacle("plane", point=[-1.0, 0.0], normal=[1.0, 0.0]))]
    with pytest.raises(InputError, match=r"contacts \(left-plane\).source: found 'left' with 2 facets on the axis"):
        Simulation(scene)


@pytest.mark.parametrize("lower", [0.0, 1.0])
def test_only_the_axial_translation_is_a_rigid_mode(tmp_path, lower):
    for value, left in ((["free", "free"], {0: 1}), (["free", 0.0], {})):
        scene = scene_of(tmp_path, lower=lower)
        scene.displacements[0].value = value
        simulation = Simulation(scene)
        assert simulation.floating == left
        simulation.close()


@pytest.mark.parallel(2)
@pytest.mark.parametrize("lower", [0.0, 1.0])
def test_rounding_errors_of_a_group_hold_no_body(tmp_path, lower):
    """A rigid group holds turns and what is radial: of the axial translation that is nothing."""
    scene = scene_of(tmp_path, lower=lower)
    one_block(tmp_path / "b.msh", 2, 7, lower=(lower, 0.1), size=(0.37, 0.7), cell="triangle")
    scene.displacements, scene.couplings = [], [Coupling("bottom"), Coupling("top")]
    simulation = Simulation(scene)
    assert simulation.floating == {0: 1}
    simulation.close()


@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_springs_hold_a_body_in_any_unit(tmp_path, unit):
    one_block(tmp_path / "b.msh", 3, 2, size=unit)
    text = SCENE.format(kinematics="", value="'free', 'free'").replace('kinematics = ""', "")
    (tmp_path / "s.toml").write_text(text)
    scene = read_scene(tmp_path / "s.toml")
    scene.springs = [Spring("bottom", stiffness=[3.0, 3.0, 0.0])]
    simulation = Simulation(scene)
    assert simulation.floating == {}
    simulation.close()


@pytest.mark.parametrize("kinematics", ["plane_strain", "plane_stress", "axisymmetric"])
def test_the_model_is_told(tmp_path, kinematics):
    simulation = Simulation(scene_of(tmp_path, kinematics=kinematics))
    assert kinematics.replace("_", " ") in simulation.describe()[0]
    simulation.close()
