"""Orthotropic bodies: known answers, contact between them, turned frames, ranks."""

import gmsh
import numpy as np
import pytest

from meshes import cylinder_strip, one_block, thick_cylinder, two_blocks
from meshes.tools import gmsh_model
from pcontact.material.orthotropic import stiffness
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
    Temperature,
)
from pcontact.simulation import Simulation
from tests.support.orthotropic import LAMINATE, SKEW, WOOD, law_of, plane_axes
from tests.support.small import DIMENSION

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
TIGHT = {"snes_rtol": "1e-12", "ksp_rtol": "1e-13"}
# theta = -1 takes many iterations of the solver
THETAS = [0.0, 1.0, pytest.param(-1.0, marks=pytest.mark.slow)]


def material(constants, **more):
    return Material(constants[0], constants[1], G=constants[2], **more)


def solved(scene, look, comm=SELF):
    """What `look` makes of a finished run. Collective on `comm`."""
    simulation = Simulation(scene, comm)
    try:
        assert simulation.run(keep=True)
        return look(simulation)
    finally:
        simulation.close()


def nodal(simulation):
    """Places and displacements of the nodes of this rank, and stresses of its cells."""
    space, u = simulation.problem.space, simulation.stepper.u
    stress = np.concatenate([one for one, _ in simulation.problem.bulk.stress(u)])
    return space.points, space.local.gather(u), stress


# -- without contact ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kinematics", ["plane_stress", "space"])
@pytest.mark.parametrize("angle", [0.0, 20.0, -65.0])
def test_bar_pulled_off_axis(tmp_path, kinematics, angle):
    """Extension and shear coupling along a direction at an angle to the fibres (Lekhnitskii 1963).

    S11' = c^4 / E1 + s^4 / E2 + c^2 s^2 m,  m = 1 / G12 - 2 nu12 / E1
    S16' = c s (2 c^2 / E1 - 2 s^2 / E2 - (c^2 - s^2) m)
    """
    dim = 3 if kinematics == "space" else 2
    path = one_block(tmp_path / "b.msh", dim, 2, "quadrilateral" if dim == 2 else "tetrahedron")
    (e1, e2, _), (nu12, *_), (g12, *_) = LAMINATE
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    middle = 1.0 / g12 - 2.0 * nu12 / e1
    extension = c**4 / e1 + s**4 / e2 + c**2 * s**2 * middle
    shear = c * s * (2.0 * c**2 / e1 - 2.0 * s**2 / e2 - (c**2 - s**2) * middle)
    zeros, free = [0.0] * (dim - 1), ["free"] * (dim - 1)
    values = {"0" * dim: [0.0] * dim, f"1{'0' * (dim - 1)}": ["free", *zeros]}
    held = [Displacement(f"corner_{name}", value) for name, value in values.items()]
    if dim == 3:
        held.append(Displacement("corner_010", [*free, 0.0]))
    scene = Scene(
        MeshSpec(path, kinematics="plane_stress" if dim == 2 else "plane_strain"),
        {"m": material(LAMINATE, angle=angle)}, [Body("block", "m")], displacements=held,
        loads=[Load(side, traction=[pull, *zeros]) for side, pull in (("left", -1.0), ("right", 1.0))],
        output=Output(fields=False), petsc=TIGHT,
    )  # fmt: skip
    x, u, stress = solved(scene, nodal)
    np.testing.assert_allclose(stress, np.tile([1.0, 0, 0, 0, 0, 0], (len(stress), 1)), atol=1e-9)
    # the x axis keeps its direction
    np.testing.assert_allclose(u[:, 0], extension * x[:, 0] + shear * x[:, 1], atol=1e-10)


INNER, OUTER, PRESSURE = 1.0, 2.0, 1.0


def ring(r):
    """Radial displacement of a ring of wood around its axis in plane strain, pressed from inside (Lekhnitskii 1963)."""
    moduli = stiffness(*WOOD)
    power = np.sqrt(moduli[1, 1] / moduli[0, 0])
    slopes = [[(moduli[0, 0] * k + moduli[0, 1]) * a ** (k - 1.0) for k in (power, -power)] for a in (INNER, OUTER)]
    rise, fall = np.linalg.solve(slopes, [-PRESSURE, 0.0])
    return rise * r**power + fall * r ** (-power)


@pytest.mark.parametrize("kind", ["axisymmetric", "plane", "space"])
def test_ring_with_hoops(tmp_path, kind):
    """Axes of the material along radius, hoop and axis: of the rings as they are, around a point, around an axis."""
    bounds, constants, more = {"inner": INNER, "outer": OUTER}, WOOD, {}
    if kind == "axisymmetric":
        path = cylinder_strip(tmp_path / "r.msh", (10, 1), height=0.2, **bounds)
        # axes are radius, axis and hoop there
        (er, eh, ea), (rh, ra, ha), (g_rh, g_ra, g_ha) = WOOD
        constants = [er, ea, eh], [ra, rh, ha * ea / eh], [g_ra, g_rh, g_ha]
        held = [Displacement(side, ["free", 0.0]) for side in ("bottom", "top")]
    else:
        dim = 2 if kind == "plane" else 3
        n = (10, 6) if dim == 2 else (5, 4)
        path = thick_cylinder(tmp_path / "r.msh", dim, n, 2, **bounds, **({} if dim == 2 else {"height": 0.2}))
        more = {"point": [0.0] * dim, **({"axis": [0.0, 0.0, 2.0]} if dim == 3 else {})}
        rest = ["free"] * (dim - 2)
        held = [Displacement("side_x", [0.0, "free", *rest]), Displacement("side_y", ["free", 0.0, *rest])]
        held += [Displacement(side, ["free", "free", 0.0]) for side in ("front", "back")] if dim == 3 else []
    scene = Scene(
        MeshSpec(path, order=2, kinematics="axisymmetric" if kind == "axisymmetric" else "plane_strain"),
        {"m": material(constants, **more)}, [Body("body", "m")], displacements=held,
        loads=[Load("inner", pressure=PRESSURE)], output=Output(fields=False), petsc=TIGHT,
    )  # fmt: skip
    x, u, _ = solved(scene, nodal)
    radius = x[:, 0] if kind == "axisymmetric" else np.linalg.norm(x[:, :2], axis=1)
    radial = u[:, 0] if kind == "axisymmetric" else np.sum(u[:, :2] * x[:, :2], axis=1) / radius
    np.testing.assert_allclose(radial, ring(radius), atol=(1e-3 if kind == "space" else 1e-4) * ring(INNER))


ALPHA, HOT = [1e-3, 2e-3, 5e-3], 20.0


@pytest.mark.parametrize("kinematics", ["plane_stress", "plane_strain", "axisymmetric", "space"])
def test_heated_block(tmp_path, kinematics):
    """Held so that it is free to expand: no stress in space and plane stress. Held everywhere: -C : alpha dT."""
    dim, cell = (3, "tetrahedron") if kinematics == "space" else (2, "quadrilateral")
    path = one_block(tmp_path / "b.msh", dim, 2, cell)
    kin = "plane_strain" if kinematics == "space" else kinematics
    axes = SKEW if dim == 3 else plane_axes(0.0 if kinematics == "axisymmetric" else 25.0)
    law = law_of(WOOD, axes, dim, kin, expansion=ALPHA)
    frozen = -HOT * law.thermal(np.zeros((1, dim)))[0]
    free = {"000": [0.0] * 3, "100": ["free", 0.0, 0.0], "010": ["free", "free", 0.0]} if dim == 3 else {
        "00": [0.0] * 2, "10": ["free", 0.0]}  # fmt: skip
    for held in (True, False):
        supports = [Displacement("block", [0.0] * dim)] if held else [
            Displacement(f"corner_{name}", value) for name, value in free.items()]  # fmt: skip
        if not held and kinematics in ("plane_strain", "axisymmetric"):
            continue
        scene = Scene(
            MeshSpec(path, kinematics=kin), {"m": material(WOOD, axes=axes, expansion=ALPHA)}, [Body("block", "m")],
            displacements=supports, temperatures=[Temperature(HOT + 3.0, reference=3.0)],
            output=Output(fields=False, energy=True), petsc=TIGHT,
        )  # fmt: skip
        (_, u, stress), energy = solved(scene, lambda one: (nodal(one), one.problem.bulk.energies(one.stepper.u)[0]))
        expected = np.zeros(6)
        if held:
            expected[: len(frozen)] = frozen * ([1.0] * 3 + [np.sqrt(0.5)] * (len(frozen) - 3))
            volume = np.pi if kinematics == "axisymmetric" else 1.0
            assert energy == pytest.approx(0.5 * HOT**2 * volume * law.expansion_energy, rel=1e-9)
        else:
            assert np.abs(u).max() > 0.5 * HOT * min(ALPHA) and abs(energy) < 1e-12
        np.testing.assert_allclose(stress - expected, 0.0, atol=1e-9)


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("friction", [None, 0.3])
def test_hot_block_under_a_lid(tmp_path, theta, friction):
    """Between smooth walls, whose distance stays: uniform pressure of the lid, exactly."""
    path = one_block(tmp_path / "b.msh", 2, 2, "triangle")
    lid = Obstacle("plane", [0.0, 1.0], [0.0, -1.0])
    case = Scene(
        MeshSpec(path), {"m": material(WOOD, angle=90.0, expansion=ALPHA)}, [Body("block", "m")],
        contacts=[Contact("top", obstacle=lid, name="lid", theta=theta, friction=friction)],
        displacements=[Displacement(side, [0.0, "free"]) for side in ("left", "right")]
        + [Displacement("bottom", ["free", 0.0])],
        temperatures=[Temperature(HOT)], output=Output(fields=False), petsc=TIGHT,
    )  # fmt: skip
    expected = HOT * law_of(WOOD, plane_axes(90.0), 2, expansion=ALPHA).thermal(np.zeros((1, 2)))[0, 1]
    record = solved(case, lambda simulation: simulation.records.data()["steps"][-1]["contacts"]["lid"])
    assert record["max_pressure"] == pytest.approx(expected, rel=1e-8)
    assert record["force"][1] == pytest.approx(expected, rel=1e-8)


# -- contact -----------------------------------------------------------------------------------------------------------

PRESSED, SHEARED, STRAINS = 0.02, (0.003, -0.004), (1e-3, -5e-4, 4e-4)


def uniform(law, shear):
    """Displacement gradient of a uniform stress: -PRESSED and `shear` on planes across the last direction.

    Strains along these planes are STRAINS. The last component of the displacement depends on the last coordinate alone.
    """
    d, m = (2, 4) if law.size == 4 else (3, 6)
    on, known = ([1, 3], [0, 2]) if d == 2 else ([2, 4, 5], [0, 1, 3])
    along = [STRAINS[0], 0.0] if d == 2 else [STRAINS[0], STRAINS[1], np.sqrt(2.0) * STRAINS[2]]
    stress = [-PRESSED, *np.sqrt(2.0) * np.array(shear)[: d - 1][:: 1 if d == 2 else -1]]
    moduli, strain = law.moduli(np.zeros((1, d)))[0], np.zeros(m)
    strain[known] = along
    strain[on] = np.linalg.solve(moduli[np.ix_(on, on)], stress - moduli[np.ix_(on, known)] @ along)
    gradient, half = np.zeros((d, d)), np.sqrt(0.5)
    gradient[range(d), range(d)] = strain[:d]
    if d == 2:
        gradient[0, 1] = 2.0 * half * strain[3]
    else:
        gradient[0, 1] = gradient[1, 0] = half * strain[3]
        gradient[1, 2], gradient[0, 2] = 2.0 * half * strain[4], 2.0 * half * strain[5]
    total = moduli @ strain
    return gradient, np.array([*total[:3], *half * total[3:], *[0.0] * (6 - m)])


KINDS = {"frictionless": {}, "friction": {"friction": 0.5}, "tied": {"tied": True}}


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("kind", list(KINDS))
@pytest.mark.parametrize("case", [("triangle", "plane_strain", 2), ("quadrilateral", "plane_stress", 1),
                                  ("hexahedron", "plane_strain", 1)], ids=lambda case: case[0])  # fmt: skip
def test_uniform_stress_through_contact(tmp_path, case, kind, theta):
    """Two different orthotropic bodies, whose axes lie in different directions: exact."""
    cell, kinematics, order = case
    dim = DIMENSION[cell]
    path = two_blocks(tmp_path / "b.msh", dim, 2, 3, cell)
    axes = [plane_axes(25.0), plane_axes(-50.0)] if dim == 2 else [SKEW, ([0.0, 1.0, 2.0], [1.0, 0.0, 0.5])]
    several = dict(zip(("lower", "upper"), zip((WOOD, LAMINATE), axes, strict=True), strict=True))
    shear, held, exact = (0.0, 0.0) if kind == "frictionless" else SHEARED, [], {}
    for name, (constants, frame) in several.items():
        exact[name] = uniform(law_of(constants, frame, dim, kinematics), shear)
        place = ["x", "y", "z"][:dim]
        place[-1] = f"({place[-1]} - 1)"
        value = [" + ".join(f"{float(h)!r}*{x}" for h, x in zip(row, place, strict=True)) for row in exact[name][0]]
        sides = ["left", "right", *(["front", "back"] if dim == 3 else []), "top" if name == "upper" else "bottom"]
        held += [Displacement(f"{name}_{side}", value) for side in sides]
    scene = Scene(
        MeshSpec(path, order=order, kinematics=kinematics),
        {name: material(constants, axes=frame) for name, (constants, frame) in several.items()},
        [Body(name, name) for name in several],
        contacts=[Contact("upper_bottom", "lower_top", theta=theta, cut=True, **KINDS[kind])],
        displacements=held, output=Output(fields=False), petsc=TIGHT,
    )  # fmt: skip

    def look(simulation):
        bulk, u = simulation.problem.bulk, simulation.stepper.u
        state = simulation.problem.contacts[0].state(u)
        bodies = [block.body for block in simulation.problem.space.mesh.blocks]
        return dict(zip(bodies, [one for one, _ in bulk.stress(u)], strict=True)), state

    stress, state = solved(scene, look)
    for number, name in enumerate(several):
        np.testing.assert_allclose(stress[number] - exact[name][1], 0.0, atol=1e-9 * PRESSED)
    np.testing.assert_allclose(state["pressure"], PRESSED, rtol=1e-8)


def turned(source, path, matrix):
    """A mesh file turned about the origin."""
    with gmsh_model("turned"):
        gmsh.open(str(source))
        whole = np.eye(4)[:3]
        whole[: len(matrix), : len(matrix)] = matrix
        gmsh.model.mesh.affineTransform(whole.ravel().tolist())
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.write(str(path))
    return path


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("cell, order", [("triangle", 1), ("quadrilateral", 2)])
def test_turned_bodies_with_turned_frames(tmp_path, cell, order, theta):
    """Everything turned, axes of the materials as well: the displacement turns with it."""
    path, angle = two_blocks(tmp_path / "a.msh", 2, 2, 3, cell), 33.0
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    matrix, results = np.array([[c, -s], [s, c]]), []
    for file, turn, extra in ((path, np.eye(2), 0.0), (turned(path, tmp_path / "b.msh", matrix), matrix, angle)):
        scene = Scene(
            MeshSpec(file, order=order),
            {"wood": material(WOOD, angle=20.0 + extra), "laminate": material(LAMINATE, angle=-50.0 + extra)},
            [Body("lower", "wood"), Body("upper", "laminate")],
            contacts=[Contact("upper_bottom", "lower_top", theta=theta, friction=0.3)],
            displacements=[Displacement("lower_bottom", [0.0, 0.0]),
                           Displacement("upper_top", (turn @ [0.02, -0.05]).tolist())],
            output=Output(fields=False), petsc=TIGHT,
        )  # fmt: skip
        x, u, _ = solved(scene, nodal)
        x, u = x @ turn, u @ turn
        order_of = np.lexsort(np.round(x, 6).T)
        results.append(u[order_of])
    np.testing.assert_allclose(*results, atol=1e-9)


# -- ranks -------------------------------------------------------------------------------------------------------------


@pytest.mark.parallel
def test_ranks_do_not_matter(shared_tmp):
    path = shared_tmp / "b.msh"
    on_root(WORLD, two_blocks, path, 3, 2, 3)
    scene = Scene(
        MeshSpec(path), {"wood": material(WOOD, point=[0.5, -1.0, 0.0], axis=[1.0, 0.0, 0.0]),
                         "laminate": material(LAMINATE, axes=SKEW)},
        [Body("lower", "wood"), Body("upper", "laminate")],
        contacts=[Contact("upper_bottom", "lower_top", theta=1.0, friction=0.3, name="pair")],
        displacements=[Displacement("lower_bottom", [0.0] * 3), Displacement("upper_top", [0.02, 0.0, -0.05])],
        output=Output(fields=False, energy=True), petsc=TIGHT,
    )  # fmt: skip

    def look(simulation):
        return simulation.records.data()["steps"][-1]

    several, alone = solved(scene, look, WORLD), solved(scene, look)
    pairs = [one["contacts"]["pair"] for one in (several, alone)]
    np.testing.assert_allclose(*(pair["force"] for pair in pairs), rtol=1e-8)
    assert pairs[0]["max_pressure"] == pytest.approx(pairs[1]["max_pressure"], rel=1e-8)
    assert several["energy"]["stored"] == pytest.approx(alone["energy"]["stored"], rel=1e-9)
