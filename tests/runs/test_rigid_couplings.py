"""Groups that move as rigid bodies with a reference point: known answers, contact, ranks, restart, refusals."""

import numpy as np
import pytest

from meshes import beam, one_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.describe import describe
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
    Steps,
)
from pcontact.simulation import Simulation
from tests.support.bad_input import CELLS, mesh_text
from tests.support.restarts import STOP, Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
E = 100.0


@pytest.fixture
def mesh(shared_tmp):
    paths = {name: shared_tmp / f"{name}.msh" for name in ("square", "cube", "beam")}
    if WORLD.rank == 0:
        one_block(paths["square"], 2, 3)
        one_block(paths["cube"], 3, 2, "tetrahedron")
        beam(paths["beam"], (8, 2), length=4.0, height=1.0, order=2)
    WORLD.Barrier()
    return paths


def scene(path, couplings, loads=(), displacements=(), nu=0.0, count=1, **more):
    region = "beam" if path.stem == "beam" else "block"
    return Scene(
        MeshSpec(path, order=2 if region == "beam" else 1, kinematics=more.pop("kinematics", "plane_strain")),
        {"m": Material(E, nu, **more.pop("material", {}))}, more.pop("bodies", [Body(region, "m")]),
        displacements=list(displacements), loads=list(loads), couplings=couplings, steps=Steps(count=count),
        petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-13"}, output=Output(fields=False, checkpoint=True), **more,
    )  # fmt: skip


def simulated(case, comm=SELF):
    simulation = Simulation(case, comm)
    assert simulation.run(keep=True)
    simulation.close()
    return simulation, simulation.records.data()["steps"][-1]


def displacement(simulation):
    space = simulation.problem.space
    x = space.points[space.owned_local]
    return x, simulation.stepper.u.getArray(readonly=True).reshape(x.shape)


def test_beam_with_a_rigid_end(mesh):
    """Pure bending keeps the end plane: the rigid end turns as beam theory says, exactly."""
    supports = [Displacement("left", [0, "free"]), Displacement("origin", ["free", 0])]
    loads = [Load("right", force=[2.0, 0.0], moment=-0.5, name="pull")]
    simulation, record = simulated(scene(mesh["beam"], [Coupling("right")], loads, supports))
    assert simulation.problem.linear and record["newton"] == 1 and simulation.floating == {}
    end, curvature = record["couplings"]["right"], -0.5 / (E / 12.0)
    assert end["rotation"] == pytest.approx(4.0 * curvature, rel=1e-8)
    np.testing.assert_allclose(end["displacement"], [8.0 / E, 8.0 * curvature], rtol=1e-8)
    np.testing.assert_allclose([*end["force"], end["moment"]], 0.0, atol=1e-9)
    assert record["loads"]["pull"]["rotation"] == pytest.approx(end["rotation"], rel=1e-9)
    assert record["imbalance"] < 1e-9


@parallel(1, 2, 3)
def test_rigid_side_in_space(mesh):
    """All nodes of the side have u = U + w x r; forces and moments at the point balance those below; a part of the
    motion is prescribed."""
    point = [0.2, 0.9, 1.4]
    side = Coupling("top", point, [0.01, "free", "free"], ["free", 0.03, "free"], name="head")
    loads = [Load("top", force=[0.5, -0.4, 1.0], moment=[0.2, 0.1, -0.3], point=point)]
    simulation, record = simulated(
        scene(mesh["cube"], [side], loads, [Displacement("bottom", [0, 0, 0])], nu=0.3), WORLD
    )
    x, u = displacement(simulation)
    head = record["couplings"]["head"]
    top = np.abs(x[:, 2] - 1.0) < 1e-9
    rigid = np.array(head["displacement"]) + np.cross(head["rotation"], x[top] - point)
    np.testing.assert_allclose(u[top], rigid, atol=1e-13)
    assert head["displacement"][0] == pytest.approx(0.01, rel=1e-12)
    assert head["rotation"][1] == pytest.approx(0.03, rel=1e-12)
    np.testing.assert_allclose([*head["force"][1:], head["moment"][0], head["moment"][2]], 0.0, atol=1e-8)
    assert abs(head["force"][0]) > 0.1 and abs(head["moment"][1]) > 0.1
    total = np.array(head["force"]) + loads[0].force + record["reactions"]["bottom"]
    np.testing.assert_allclose(total, 0.0, atol=1e-9)
    assert record["imbalance"] < 1e-8
    # the same on any ranks
    _, alone = simulated(scene(mesh["cube"], [side], loads, [Displacement("bottom", [0, 0, 0])], nu=0.3))
    np.testing.assert_allclose(head["rotation"], alone["couplings"]["head"]["rotation"], rtol=1e-9)


def test_prescribed_as_a_whole(mesh):
    """With nothing free it is a support: as displacements of the nodes."""
    whole = Coupling("top", [0.5, 1.0], [0.01, -0.02], 0.05)
    _, rigid = simulated(scene(mesh["square"], [whole], (), [Displacement("bottom", [0, 0])], nu=0.3))
    turned = [Displacement("top", [0.01, "-0.02*t + 0.05*(x - 0.5)*t"]), Displacement("bottom", [0, 0])]
    turned[0].value = ["0.01*t", turned[0].value[1]]
    _, nodes = simulated(scene(mesh["square"], [], (), turned, nu=0.3))
    np.testing.assert_allclose(rigid["couplings"]["top"]["force"], nodes["reactions"]["top"], rtol=1e-9)
    np.testing.assert_allclose(rigid["reactions"]["bottom"], nodes["reactions"]["bottom"], rtol=1e-9)


def pressed(path, count=2, kinematics="plane_strain", **more):
    """A block whose rigid top a force presses on a plane, and a moment tilts."""
    way = ["free", "free"] if kinematics == "axisymmetric" else [0, "free"]
    loads = [Load("top", force=[0.0, -4.0])]
    loads += [] if kinematics == "axisymmetric" else [Load("top", moment=0.3, name="tilt", amplitude=[(0, 0), (1, 1)])]
    case = scene(path, [Coupling("top", displacement=way)], loads, nu=0.3, count=count, kinematics=kinematics, **more)
    case.contacts = [Contact("bottom", obstacle=Obstacle("plane", [0, 0], [0, 1.0]), name="floor", friction=0.2)]
    return case


@pytest.mark.parametrize("kinematics", ["plane_strain", "axisymmetric"])
def test_head_on_contact(mesh, kinematics):
    """Contact alone holds the block: it bears force and moment."""
    simulation, record = simulated(pressed(mesh["square"], kinematics=kinematics))
    assert record["contacts"]["floor"]["force"][1] == pytest.approx(-4.0, rel=1e-7)
    assert record["imbalance"] < 1e-7
    x, u = displacement(simulation)
    top = np.abs(x[:, 1] - 1.0) < 1e-9
    head = record["couplings"]["top"]
    if kinematics == "axisymmetric":
        np.testing.assert_allclose(u[top], [[0.0, head["displacement"][1]]] * int(top.sum()), atol=1e-13)
        assert "moment" not in head and simulation.floating == {0: 1}
    else:
        rigid = head["displacement"][1] + head["rotation"] * (x[top, 0] - 0.5)
        np.testing.assert_allclose(u[top, 1], rigid, atol=1e-13)
        assert head["rotation"] > 0.0 and simulation.floating == {0: 2}


def test_bodies_that_a_group_joins(tmp_path):
    """Two squares above each other, drawn at their rigid right sides: one body that is held at one of its squares."""
    sides = [(1, 3, (4, 1)), (1, 4, (8, 5)), (1, 5, (2, 3)), (1, 5, (6, 7))]
    names = {(2, 1): "lower", (2, 2): "upper", (1, 3): "one", (1, 4): "other", (1, 5): "both"}
    (tmp_path / "squares.msh").write_text(mesh_text(elements=CELLS + sides, names=names))
    case = scene(tmp_path / "squares.msh", [Coupling("both", rotation=0.0)], [Load("both", force=[3.0, 0.0])],
                 [Displacement("one", [0, 0]), Displacement("other", [0, 0])],
                 bodies=[Body("lower", "m"), Body("upper", "m")])  # fmt: skip
    _, record = simulated(case)
    np.testing.assert_allclose(record["couplings"]["both"]["displacement"], [1.5 / E, 0.0], rtol=1e-9, atol=1e-12)
    case.displacements.pop()
    simulation, record = simulated(case)
    assert simulation.floating == {} and simulation.problem.space.mesh.component_names == ["lower + upper"]
    np.testing.assert_allclose(record["couplings"]["both"]["displacement"], [3.0 / E, 0.0], rtol=1e-9, atol=1e-12)


@parallel(1, 2, 3)
@pytest.mark.usefixtures("one_order")
def test_restart(mesh, shared_tmp):
    def case():
        return pressed(mesh["square"], 6, material={"yield_stress": 5.0, "hardening": 10.0})

    whole, cut, rest = (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(case(), WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(case(), WORLD, rest, restart=cut)
    for one, other in zip(steps[STOP:], after, strict=True):
        for key in ("displacement", "rotation"):
            np.testing.assert_allclose(one["couplings"]["top"][key], other["couplings"]["top"][key], rtol=1e-6)
    head = (whole / "history.csv").read_text().splitlines()[0].split(",") if WORLD.rank == 0 else []
    assert WORLD.rank or {"couplings.top.rotation", "couplings.top.force_y"} <= set(head)


@pytest.mark.parametrize(
    "couplings, parts",
    [
        ([Coupling("corner_11")], ("couplings[0] (corner_11).region", "in one place")),
        ([Coupling("bottom")], ("region", "prescribed displacement")),
        ([Coupling("top"), Coupling("top", name="second")], ("couplings[1] (top).region", "another coupling")),
        ([Coupling("top"), Coupling("left")], ("couplings[1] (left)", "point (0, 0)")),
        ([Coupling("top", displacement=[0, 0, 0])], ("displacement", "3 entries")),
        ([Coupling("top", rotation=["free", 0, 0])], ("rotation", "the mesh is 2D")),
        ([Coupling("top", rotation="fixed")], ("rotation", "'fixed'", "free")),
        ([Coupling("tap")], ("region", "'top'")),
    ],
)
def test_bad_couplings(mesh, couplings, parts):
    with pytest.raises(InputError) as caught:
        Simulation(scene(mesh["square"], couplings, (), [Displacement("bottom", [0, 0])]), SELF)
    assert all(part in str(caught.value) for part in parts), str(caught.value)


def test_where_groups_are_refused(mesh):
    case = scene(mesh["square"], [Coupling("top", rotation=0.1)])
    assert "rigid groups: top" in describe(case)[0]
    case.mesh.strain = "finite"
    with pytest.raises(InputError, match=r"couplings\[0\].*finite strain"):
        Simulation(case, SELF)
    case.mesh.strain, case.mesh.kinematics = "small", "axisymmetric"
    with pytest.raises(InputError, match=r"couplings\[0\].*rotation.*axisymmetric"):
        Simulation(case, SELF)
    case = scene(mesh["square"], [Coupling("top")], (), [Displacement("left", [0, "free"])])
    with pytest.raises(InputError, match=r"couplings\[0\] \(top\).region: found 'top'.*average = true"):
        Simulation(case, SELF)
    case = scene(mesh["square"], [Coupling("block", rotation=0.1)])
    case.output.estimate = True
    with pytest.raises(InputError, match=r"output.estimate.*couplings\[0\].*a group of cells"):
        Simulation(case, SELF)


# -- groups that move on average ---------------------------------------------------------------------------------------


def test_ends_on_average_leave_a_bar_free_to_contract(mesh):
    """Uniaxial stress, as a rigid end has it with nu = 0 alone; the force that holds the mean displacement is exact."""
    supports = [Displacement("left", [0, "free"]), Displacement("origin", ["free", 0])]
    end = Coupling("right", displacement=[0.1, "free"], rotation=0.0, average=True)
    simulation, record = simulated(scene(mesh["square"], [end], (), supports, nu=0.3))
    assert simulation.problem.linear and record["newton"] == 1 and "equations" not in record
    found, force = record["couplings"]["right"], 0.1 * E / (1.0 - 0.3**2)
    np.testing.assert_allclose(found["displacement"], [0.1, -0.5 * 0.1 * 0.3 / 0.7], rtol=1e-9)
    np.testing.assert_allclose([*found["force"], found["moment"], found["rotation"]], [force, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(record["reactions"]["left"], [-force, 0.0], atol=1e-9)
    assert record["imbalance"] < 1e-12
    x, u = displacement(simulation)
    np.testing.assert_allclose(u, x * [0.1, -0.1 * 0.3 / 0.7], atol=1e-10)
    # a load step that is expected to end elsewhere begins where the coupling has it
    vector, problem = simulation.stepper.u.copy(), simulation.problem
    expected = 2.0 * vector
    problem.prediction.expect(vector, expected)
    moved = vector.getArray().reshape(-1, 2)
    assert problem.features.averages[0].record(moved, 0.0 * moved)["displacement"][0] == pytest.approx(0.1, rel=1e-12)


def test_a_beam_that_is_bent_on_average(mesh):
    """M = E I angle / L, in pure bending, for a mean rotation of its end; and a mean deflection of an end that turns
    freely: shear adds to 3 E I / L^3."""
    supports = [Displacement("left", [0, "free"]), Displacement("origin", ["free", 0])]
    turned = Coupling("right", rotation=0.02, average=True, amplitude=[[0, 0], [1, 1]])
    _, record = simulated(scene(mesh["beam"], [turned], (), supports, count=2))
    found = record["couplings"]["right"]
    assert found["moment"] == pytest.approx(E / 12.0 * 0.02 / 4.0, rel=1e-8)
    np.testing.assert_allclose([*found["force"], found["rotation"]], [0, 0, 0.02], atol=1e-10)
    assert found["displacement"][1] == pytest.approx(0.5 * 0.02 * 4.0, rel=1e-8)
    clamped = [Displacement("left", [0, 0])]
    end = Coupling("right", displacement=["free", 0.1], average=True)
    _, record = simulated(scene(mesh["beam"], [end], (), clamped))
    found = record["couplings"]["right"]
    flexible = 4.0**3 / (3.0 * E / 12.0) + 4.0 / (5.0 / 6.0 * 0.5 * E)
    assert found["force"][1] == pytest.approx(0.1 / flexible, rel=0.01) and abs(found["moment"]) < 1e-9
    assert record["imbalance"] < 1e-9


def following(simulation, comm):
    """Nodes of the file and directions in which they follow others, of all ranks."""
    space, (rows, axes) = simulation.problem.space, np.nonzero(simulation.problem.conditions.followers)
    nodes = space.mesh.file_nodes[space.mesh_nodes[space.owned_local]][rows]
    return set().union(*comm.allgather(set(zip(nodes.tolist(), axes.tolist(), strict=True))))


@parallel(1, 2, 3)
def test_a_side_on_average_in_space(mesh):
    """Part of a motion about a point off the side; what is free bears nothing, what is prescribed balances."""
    point = [0.2, 0.9, 1.4]
    side = Coupling("top", point, [0.01, "free", "free"], ["free", 0.03, "free"], name="head", average=True)
    case = scene(mesh["cube"], [side], (), [Displacement("bottom", [0, 0, 0])], nu=0.3)
    (simulation, alone), (joint, whole) = (simulated(case, comm) for comm in (SELF, WORLD))
    assert following(simulation, SELF) == following(joint, WORLD) != set()
    found = alone["couplings"]["head"]
    assert found["displacement"][0] == pytest.approx(0.01, rel=1e-9)
    assert found["rotation"][1] == pytest.approx(0.03, rel=1e-9) and abs(found["rotation"][0]) > 1e-4
    held = [found["force"][0], found["moment"][1]]
    np.testing.assert_allclose([*found["force"], *found["moment"]], [held[0], 0, 0, 0, held[1], 0], atol=1e-10)
    np.testing.assert_allclose(alone["reactions"]["bottom"], [-held[0], 0, 0], atol=1e-10)
    for key, values in found.items():
        np.testing.assert_allclose(whole["couplings"]["head"][key], values, atol=1e-10)


def test_a_block_that_an_average_alone_holds(mesh):
    """Pressed on a plane by the mean motion of its top, which is free to bulge."""
    floor = Contact("bottom", obstacle=Obstacle("plane", [0.0, 0.0], [0.0, 1.0]), name="floor", friction=0.3)
    top = Coupling("top", displacement=[0.0, -0.02], rotation=0.0, average=True)
    simulation, record = simulated(scene(mesh["square"], [top], nu=0.3, contacts=[floor], count=2))
    assert simulation.floating == {} and record["imbalance"] < 1e-10
    np.testing.assert_allclose(record["couplings"]["top"]["force"], record["contacts"]["floor"]["force"], atol=1e-10)
    assert record["couplings"]["top"]["displacement"][1] == pytest.approx(-0.02, rel=1e-9)
    x, u = displacement(simulation)
    up = u[x[:, 1] == 1.0, 1]
    assert np.ptp(up) > 1e-4 and record["contacts"]["floor"]["force"][1] < -1.0


def test_an_average_that_bears_all_of_the_load(mesh):
    """Nothing moves: rounding errors of a load that the equations bear are all that is left."""
    end = Coupling("right", displacement=[0, 0], rotation=0.0, average=True)
    load = Load("right", traction=[0.1, 0.05])
    _, record = simulated(scene(mesh["square"], [end], [load], [Displacement("left", [0, 0])], nu=0.3))
    np.testing.assert_allclose(record["couplings"]["right"]["force"], [-0.1, -0.05], atol=1e-12)


@pytest.mark.parametrize("couplings, supports, message", [
    ([Coupling("right", displacement=[0.1, 0], average=True)], [Displacement("right", ["free", 0])],
     r"couplings \(right\): found a motion of which supports"),
    ([Coupling("right"), Coupling("top", displacement=[0, 0.1], average=True)], [],
     r"couplings\[1\] \(top\).region: found 'top', of which nodes are in another coupling"),
    ([Coupling("origin", rotation=0.1, average=True)], [], r"\(origin\).rotation: found a rotation; allowed"),
])  # fmt: skip
def test_averages_that_are_refused(mesh, couplings, supports, message):
    """What leaves nothing open, what others move, and points that turn."""
    with pytest.raises(InputError, match=message):
        simulated(scene(mesh["square"], couplings, (), [Displacement("left", [0, 0]), *supports]))


def test_groups_too_large_for_an_average_are_refused(mesh, monkeypatch):
    """Equations couple all nodes of the group."""
    monkeypatch.setattr("pcontact.assembly.coupling.MOST", 3)
    end = Coupling("right", displacement=[0.1, "free"], average=True)
    with pytest.raises(InputError, match="found 'right' on average, a group of 4 nodes; allowed: groups of at most 3"):
        simulated(scene(mesh["square"], [end], (), [Displacement("left", [0, 0])]))
