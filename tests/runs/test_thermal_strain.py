"""Thermal strain: known answers, contact and plasticity with it, ranks, restart, refusals."""

import meshio
import numpy as np
import pytest

from meshes import one_block, two_blocks
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.describe import describe
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
    Steps,
    Temperature,
)
from pcontact.simulation import Simulation
from tests.support.restarts import STOP, Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
E, NU, ALPHA, HOT = 1000.0, 0.3, 1e-3, 20.0


@pytest.fixture
def mesh(shared_tmp):
    """Unit boxes, and two layers of length 10 and height 1/2."""
    paths = {name: shared_tmp / f"{name}.msh" for name in ("square", "cube", "curved", "layers")}
    if WORLD.rank == 0:
        one_block(paths["square"], 2, 3)
        one_block(paths["cube"], 3, 2, "tetrahedron")
        one_block(paths["curved"], 3, 1, order=2)
        two_blocks(paths["layers"], 2, (12, 2), (10, 2), widths=(10.0, 10.0), heights=(0.5, 0.5), order=2)
    WORLD.Barrier()
    return paths


def scene(path, displacements, temperatures, kinematics="plane_strain", order=1, **more):
    material = {"m": Material(E, more.pop("nu", NU), expansion=ALPHA, **more.pop("material", {}))}
    return Scene(
        MeshSpec(path, order=order, kinematics=kinematics, mean_dilatation=more.pop("mean_dilatation", None)),
        material, more.pop("bodies", [Body("block", "m")]), displacements=displacements, temperatures=temperatures,
        steps=Steps(count=more.pop("count", 1)), output=Output(fields=False, checkpoint=True, probes=["top"]),
        petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-12"}, **more,
    )  # fmt: skip


def planes(dim):
    """Planes of symmetry that leave each direction free to expand."""
    sides = ["left", "bottom"] if dim == 2 else ["left", "front", "bottom"]
    return [Displacement(side, ["free"] * k + [0.0] + ["free"] * (dim - 1 - k)) for k, side in enumerate(sides)]


def simulated(case, comm=SELF):
    simulation = Simulation(case, comm)
    assert simulation.run(keep=True)
    simulation.close()
    return simulation, simulation.records.data()["steps"][-1]


def stresses(simulation):
    return np.concatenate([stress for stress, _ in simulation.problem.bulk.stress(simulation.stepper.u)])


@pytest.mark.parametrize("kinematics", ["plane_stress", "plane_strain", "axisymmetric", "space"])
def test_bar_between_walls(mesh, kinematics):
    """E alpha dT, in plane strain over 1 - nu: the third direction does not expand either."""
    space = kinematics == "space"
    dim = 3 if space else 2
    case = scene(mesh["cube" if space else "square"], planes(dim), [Temperature(HOT + 3.0, reference=3.0)],
                 kinematics="plane_strain" if space else kinematics, mean_dilatation=None if space else True
                 if kinematics != "plane_stress" else None)  # fmt: skip
    case.displacements.append(Displacement("top", ["free"] * (dim - 1) + [0.0]))
    simulation, record = simulated(case)
    expected = -E * ALPHA * HOT / (1.0 - NU if kinematics == "plane_strain" else 1.0)
    area = np.pi if kinematics == "axisymmetric" else 1.0
    assert record["reactions"]["top"][-1] == pytest.approx(expected * area, rel=1e-9)
    assert simulation.problem.linear and record["newton"] == 1
    stress = stresses(simulation)
    np.testing.assert_allclose(stress[:, dim - 1], expected, rtol=1e-8)
    np.testing.assert_allclose(stress[:, 0], 0.0, atol=1e-9 * abs(expected))


@pytest.mark.parametrize("nu", [0.3, 0.4999])
def test_linear_temperature_strains_freely(mesh, nu):
    """In space a temperature that is linear in the place leaves no stress, with mean dilatation, too."""
    case = scene(mesh["curved"], [], [Temperature("10*x*t + 5", reference=5.0)], order=2, nu=nu,
                 mean_dilatation=nu > 0.4)  # fmt: skip
    case.displacements = [Displacement(side, ["5e-3*(x**2 - y**2 - z**2)*t", "1e-2*x*y*t", "1e-2*x*z*t"])
                          for side in ("left", "right", "front")]  # fmt: skip
    simulation, record = simulated(case)
    assert np.abs(stresses(simulation)).max() < 1e-9 * E
    assert record["probes"]["top"]["max"][2] == pytest.approx(1e-2, rel=1e-9)


@pytest.mark.parametrize("theta", [0, 1, -1])
@pytest.mark.parametrize("kinematics, friction", [("plane_strain", 0.0), ("plane_strain", 0.3), ("axisymmetric", 0)])
def test_hot_block_under_a_lid(mesh, kinematics, friction, theta):
    """It expands by half of what it would, then contact bears the rest: uniform pressure, exactly."""
    lid = Obstacle("plane", [0.0, 1.01], [0.0, -1.0])
    ways = [Displacement("left", [0, "free"]), Displacement("right", [0, "free"]), Displacement("bottom", [0, 0])]
    case = scene(mesh["square"], ways, [Temperature(HOT, region="block")], kinematics, nu=0.0)
    case.contacts = [Contact("top", obstacle=lid, name="lid", theta=theta, friction=friction)]
    _, record = simulated(case)
    area = np.pi if kinematics == "axisymmetric" else 1.0
    assert record["contacts"]["lid"]["force"][1] == pytest.approx(E * (ALPHA * HOT - 0.01) * area, rel=1e-9)
    assert record["contacts"]["lid"]["max_pressure"] == pytest.approx(E * (ALPHA * HOT - 0.01), rel=1e-8)
    assert record["imbalance"] < 1e-8


@pytest.mark.parametrize("unbiased", [False, True])
def test_two_metals(mesh, unbiased):
    """Curvature of two layers of the same stiffness that are tied: 3/2 of the difference of strains over the height."""
    case = scene(mesh["layers"], [], [Temperature(HOT, region="upper")], "plane_stress", 2,
                 bodies=[Body("lower", "m"), Body("upper", "m")])  # fmt: skip
    case.contacts = [Contact("upper_bottom", "lower_top", tied=True, name="bond")]
    if unbiased:
        case.temperatures = [Temperature(f"{HOT} if y > 0.5 else 0")]
    case.displacements = [Displacement("lower_left", [0, "free"]), Displacement("upper_left", [0, "free"]),
                          Displacement("lower_corner_00", ["free", 0])]  # fmt: skip
    case.output.probes = ["lower_right", "upper_right"]
    _, record = simulated(case)
    down = 0.5 * (record["probes"]["lower_right"]["mean"][1] + record["probes"]["upper_right"]["mean"][1])
    # the hot layer is above: the end goes down by half the curvature times the square of the length
    assert down == pytest.approx(-0.5 * 1.5 * ALPHA * HOT * 100.0, rel=0.02)


@pytest.mark.parametrize("kinematics", ["space", "axisymmetric"])
def test_bar_that_yields_between_walls(mesh, kinematics):
    """Plastic strain (E alpha dT - yield stress) / (E + H); cold again, it pulls and yields back."""
    dim, hardening, strength = (3, 100.0, 8.0) if kinematics == "space" else (2, 100.0, 8.0)
    case = scene(mesh["cube" if dim == 3 else "square"], planes(dim), [Temperature("20*t if t < 0.5 else 20*(1 - t)")],
                 kinematics="plane_strain" if dim == 3 else kinematics, count=4,
                 material={"yield_stress": strength, "hardening": hardening})  # fmt: skip
    case.temperatures[0].amplitude = [(0, 2), (1, 2)]
    case.displacements.append(Displacement("top", ["free"] * (dim - 1) + [0.0]))
    simulation, record = simulated(case)
    hot = (E * ALPHA * 20.0 - strength) / (E + hardening)
    strain = hot + ((E - hardening) * hot - strength) / (E + hardening)
    force = record["reactions"]["top"][-1] / (np.pi if dim == 2 else 1.0)
    assert record["plastic"]["max_equivalent_strain"] == pytest.approx(strain, rel=1e-8)
    assert force == pytest.approx(strength + hardening * strain, rel=1e-8)


def gradient(path, count):
    case = scene(path, [Displacement("bottom", [0, 0, 0])], [Temperature("40*t*(1 + x*z)")], count=count,
                 nu=0.3, material={"yield_stress": 12.0, "hardening": 50.0})  # fmt: skip
    case.contacts = [Contact("top", obstacle=Obstacle("plane", [0, 0, 1.02], [0, 0, -1.0]), name="lid", friction=0.2)]
    return case


def same(one, other):
    for key in ("force", "max_pressure"):
        np.testing.assert_allclose(one["contacts"]["lid"][key], other["contacts"]["lid"][key], rtol=1e-6, atol=1e-7)
    assert one["plastic"]["max_equivalent_strain"] == pytest.approx(other["plastic"]["max_equivalent_strain"], rel=1e-6)


@parallel(2, 3)
def test_ranks(mesh):
    _, alone = simulated(gradient(mesh["cube"], 2))
    _, together = simulated(gradient(mesh["cube"], 2), WORLD)
    assert alone["contacts"]["lid"]["max_pressure"] > 1.0 and alone["plastic"]["yielded_volume"] > 0.01
    same(alone, together)


@parallel(1, 2, 3)
@pytest.mark.usefixtures("one_order")
def test_restart(mesh, shared_tmp):
    whole, cut, rest = (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(gradient(mesh["cube"], 6), WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(gradient(mesh["cube"], 6), WORLD, rest, restart=cut)
    for one, other in zip(steps[STOP:], after, strict=True):
        same(one, other)


@pytest.mark.parametrize(
    "change, parts",
    [
        (lambda s: s.temperatures.append(Temperature(1.0, region="block")), ("temperatures[1] (block).region", "9 ce")),
        (lambda s: setattr(s.materials["m"], "expansion", None), ("temperatures[0]", "no cell", "expansion")),
        (lambda s: setattr(s.mesh, "strain", "finite"), ("temperatures[0]", "body block with finite strain")),
        (lambda s: setattr(s.temperatures[0], "region", "top"), ("temperatures[0] (top).region", "group of facets")),
        (lambda s: setattr(s.temperatures[0], "value", "z"), ("temperatures[0].value", "z with a 2D mesh")),
    ],
)  # fmt: skip
def test_bad_temperatures(mesh, change, parts):
    case = scene(mesh["square"], planes(2), [Temperature(HOT)], "plane_stress")
    assert "thermal strain: all bodies" in describe(case)[0]
    change(case)
    with pytest.raises(InputError) as caught:
        Simulation(case, SELF)
    assert all(part in str(caught.value) for part in parts), str(caught.value)


def test_temperatures_that_are_not_finite(mesh):
    case = scene(mesh["square"], planes(2), [Temperature("log(x - 0.5)*t")])
    simulation = Simulation(case, SELF)
    with pytest.raises(InputError, match=r"temperatures\[0\]\.value.*nan at the point"):
        simulation.run(keep=True)
    simulation.free()


@pytest.mark.parallel(2)
@pytest.mark.parametrize("name, kinematics", [("square", "plane_strain"), ("cube", None), ("curved", None)])
def test_field_of_a_file(mesh, name, kinematics, shared_tmp):
    """A linear temperature at the nodes, in another order and among others, is that of the expression; in contact."""
    raw, d = meshio.read(mesh[name]), 2 if name == "square" else 3
    points = np.vstack([raw.points, [[9.0, 9.0, 9.0]]])[np.random.default_rng(3).permutation(len(raw.points) + 1)]
    if WORLD.rank == 0:
        field = 5.0 + points @ [3.0, -2.0, 4.0]
        meshio.write(shared_tmp / "heat.vtu", meshio.Mesh(points, [("vertex", np.arange(len(points))[:, None])],
                                                          point_data={"T": field}))  # fmt: skip
    WORLD.Barrier()
    order = 2 if name == "curved" else 1
    floor = Contact("bottom", obstacle=Obstacle("plane", [0.0] * d, [0.0] * (d - 1) + [1.0]), name="floor")
    held = [Displacement("top", [0.0] * d)]
    said = {"order": order, "contacts": [floor], "kinematics": kinematics or "plane_strain"}
    text = "5 + 3*x - 2*y" + (" + 4*z" if d == 3 else "")
    amplitude = [[0, 0], [1, 1]]
    by_field = Temperature(file="heat.vtu", field="T", reference=1.0)
    ends = []
    for one in (Temperature(text, reference=1.0, amplitude=amplitude), by_field):
        case = scene(mesh[name], held, [one], beside=shared_tmp, **said)
        ends.append(simulated(case, WORLD)[1]["contacts"]["floor"])
    np.testing.assert_allclose(ends[1]["force"], ends[0]["force"], rtol=1e-9, atol=1e-9)
    assert ends[1]["max_pressure"] == pytest.approx(ends[0]["max_pressure"], rel=1e-9) and ends[0]["max_pressure"] > 1.0


def test_fields_that_are_none(mesh, shared_tmp):
    raw = meshio.read(mesh["square"])
    n = len(raw.points) - 1
    fields = {"T": np.ones(n), "v": np.ones((n, 3))}
    some = meshio.Mesh(raw.points[:-1], [("vertex", np.arange(n)[:, None])], point_data=fields)
    meshio.write(shared_tmp / "some.vtu", some)
    for said, words in (({"field": "t"}, "field: found 't', no such field"), ({"field": "v"}, "one finite number at"),
                        ({"field": "T"}, "which has no node at"), ({}, "without field"),
                        ({"field": "T", "value": 3.0}, "both value and file")):  # fmt: skip
        case = scene(mesh["square"], planes(2), [Temperature(file="some.vtu", **said)], beside=shared_tmp)
        with pytest.raises(InputError, match=words):
            simulated(case)
    case = scene(mesh["square"], planes(2), [Temperature(file="none.vtu", field="T")], beside=shared_tmp)
    with pytest.raises(InputError, match="no such file"):
        simulated(case)
