"""Total forces and moments, forces at nodes, springs to the ground: known answers, ranks, restart, refusals."""

import numpy as np
import pytest

from meshes import beam, one_block
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.describe import describe
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
    Spring,
    Steps,
)
from pcontact.simulation import Simulation
from tests.support.restarts import STOP, Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel
E = 100.0


@pytest.fixture
def mesh(shared_tmp):
    """Unit boxes by dimension, and a beam of length 4 and height 1."""
    paths = {2: shared_tmp / "block2.msh", 3: shared_tmp / "block3.msh", "beam": shared_tmp / "beam.msh"}
    if WORLD.rank == 0:
        one_block(paths[2], 2, 4)
        one_block(paths[3], 3, 2, "tetrahedron")
        beam(paths["beam"], (8, 2), length=4.0, height=1.0, order=2)
    WORLD.Barrier()
    return paths


def scene(path, displacements, loads, nu=0.0, count=1, **more):
    region = "beam" if path.stem == "beam" else "block"
    order = 2 if region == "beam" else 1
    return Scene(
        MeshSpec(path, order=order), {"m": Material(E, nu)}, [Body(region, "m")], displacements=displacements,
        loads=loads, steps=Steps(count=count), petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-13"},
        output=Output(fields=False, checkpoint=True), **more,
    )  # fmt: skip


def simulated(case, comm=SELF):
    simulation = Simulation(case, comm)
    assert simulation.run(keep=True)
    simulation.close()
    return simulation, simulation.records.data()["steps"]


def test_beam_bent_by_a_moment_and_drawn(mesh):
    """Pure bending is a displacement of degree 2: rotation and displacement of the end are exact."""
    supports = [Displacement("left", [0, "free"]), Displacement("origin", ["free", 0])]
    case = scene(mesh["beam"], supports, [Load("right", force=[2.0, 0.0], moment=-0.5, name="end")], count=2)
    _, steps = simulated(case)
    end, curvature = steps[-1]["loads"]["end"], -0.5 / (E / 12.0)
    assert end["force"] == [2.0, 0.0] and end["moment"] == -0.5
    assert end["rotation"] == pytest.approx(4.0 * curvature, rel=1e-9)
    np.testing.assert_allclose(end["displacement"], [4.0 * 2.0 / E, 0.5 * curvature * 16.0], rtol=1e-9)
    assert steps[0]["loads"]["end"]["rotation"] == pytest.approx(2.0 * curvature, rel=1e-9)
    assert steps[-1]["imbalance"] < 1e-9


def test_force_beside_the_centroid(mesh):
    """A force at a point of its own has a moment; an eccentric pull bends as its moment does."""
    supports = [Displacement("left", [0, "free"]), Displacement("origin", ["free", 0])]
    _, pulled = simulated(scene(mesh["beam"], supports, [Load("right", force=[2.0, 0.0], point=[5.0, 0.25])]))
    _, both = simulated(scene(mesh["beam"], supports, [Load("right", force=[2.0, 0.0], moment=-0.5)]))
    one, other = pulled[-1]["loads"]["right"], both[-1]["loads"]["right"]
    assert one["rotation"] == pytest.approx(other["rotation"], rel=1e-9)
    # of the point beside the end
    turn = other["rotation"]
    expected = np.array(other["displacement"]) + turn * np.array([-0.25, 1.0])
    np.testing.assert_allclose(one["displacement"], expected, rtol=1e-9)


@parallel(1, 2, 3)
def test_works_and_moments_in_space(mesh):
    """Forces and moments on a side, a body, an edge and a corner do work on what the report says of their points; they
    have the resultants that were asked for."""
    loads = [
        Load("top", force=[1.0, -2.0, 0.5], moment=[0.3, 0.1, -0.4], point=[0.2, 1.5, 2.0]),
        Load("block", force=[0.0, 0.2, 0.0], moment=[0.0, 0.0, 0.1]),
        Load("right", moment=[0.1, 0.2, 0.3]),
        Load("corner_111", force=[0.0, 0.0, 0.1]),
        Load(at=[1.0, 0.0, 1.0], force=[0.0, 0.3, 0.0], name="corner"),
    ]
    case = scene(mesh[3], [Displacement("bottom", [0, 0, 0])], loads, nu=0.3)
    simulation, steps = simulated(case, WORLD)
    problem, space = simulation.problem, simulation.problem.space
    forces, u = problem.forces.external(1.0), simulation.stepper.u.getArray(readonly=True).reshape(-1, 3)
    x = space.points[space.owned_local]
    total = WORLD.allreduce(np.concatenate([forces.sum(axis=0), np.cross(x, forces).sum(axis=0)]))
    expected = np.concatenate([sum(np.array(one.force) for one in loads if one.force), np.zeros(3)])
    centres = {"top": [0.2, 1.5, 2.0], "block": [0.5] * 3, "right": [1, 0.5, 0.5], "corner_111": [1] * 3}
    for one in loads:
        centre = centres.get(one.region, [1.0, 0.0, 1.0])
        expected[3:] += np.array(one.moment or [0, 0, 0]) + np.cross(centre, one.force or [0, 0, 0])
    np.testing.assert_allclose(total, expected, atol=1e-13)
    record, work = steps[-1]["loads"], 0.0
    for one in loads:
        said = record[one.name or one.region]
        work += np.dot(one.force or [0, 0, 0], said["displacement"]) + np.dot(
            one.moment or [0, 0, 0], said.get("rotation", [0, 0, 0])
        )
    assert work == pytest.approx(WORLD.allreduce(float(np.sum(forces * u))), rel=1e-10)
    assert "rotation" not in record["corner"] and "rotation" in record["block"]
    corner = np.linalg.norm(x - [1.0, 0.0, 1.0], axis=1) < 1e-9
    assert all(np.allclose(value, record["corner"]["displacement"], atol=1e-14) for value in u[corner])


@pytest.mark.parametrize("dim", [2, 3])
def test_block_on_springs(mesh, dim):
    """Springs alone hold it, along the normal below and in all directions at a corner: a linear problem, exactly."""
    down = [0.0] * (dim - 1)
    case = scene(mesh[dim], [], [Load("top", force=[*down, -3.0])], springs=[
        Spring("bottom", per_area=50.0), Spring("left", stiffness=[2.0, *down], name="side"),
        *([Spring("front", per_area=[0.0, 4.0, 0.0]), Spring("right", per_area=[0.0, 1.0, 0.0])] if dim == 3 else []),
    ])  # fmt: skip
    simulation, steps = simulated(case)
    assert simulation.floating == {} and simulation.problem.linear and steps[-1]["newton"] == 1
    record = steps[-1]["springs"]
    np.testing.assert_allclose(record["bottom"]["force"], [*down, 3.0], atol=1e-10)
    np.testing.assert_allclose(record["side"]["force"], 0.0, atol=1e-10)
    assert steps[-1]["loads"]["top"]["displacement"][-1] == pytest.approx(-3.0 / 50.0 - 3.0 / E, rel=1e-9)
    assert steps[-1]["imbalance"] < 1e-10
    words, _ = describe(case)
    assert "springs to the ground: bottom, side" in " ".join(words)


def test_springs_that_leave_a_motion_free(mesh):
    simulation = Simulation(scene(mesh[2], [], [], springs=[Spring("bottom", per_area=50.0)]), SELF)
    simulation.close()
    assert simulation.floating == {0: 1}


@parallel(1, 2, 3)
@pytest.mark.usefixtures("one_order")
def test_restart(mesh, shared_tmp):
    def case():
        return scene(
            mesh[2], [], [Load("top", force=[0.4, -3.0], moment=0.2), Load("block", body_force=[0, "-t*x"])], nu=0.3,
            count=6, springs=[Spring("bottom", per_area=[5.0, 50.0])],
        )  # fmt: skip

    whole, cut, rest = (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(case(), WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(case(), WORLD, rest, restart=cut)
    for one, other in zip(steps[STOP:], after, strict=True):
        for part, name in (("loads", "top"), ("springs", "bottom")):
            for key, value in one[part][name].items():
                np.testing.assert_allclose(value, other[part][name][key], rtol=1e-9, atol=1e-14)
    head = (whole / "history.csv").read_text().splitlines()[0].split(",") if WORLD.rank == 0 else []
    assert WORLD.rank or {"loads.top.rotation", "loads.top.displacement_y", "springs.bottom.force_x"} <= set(head)
    np.testing.assert_allclose(steps[-1]["springs"]["bottom"]["force"], [-0.4, 3.5], rtol=1e-10)


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_springs_and_contact(mesh, strain):
    """A block that springs hold is pressed on a plane: they bear what contact does not."""
    floor = Contact("bottom", obstacle=Obstacle("plane", point=[0, 0], normal=[0, 1]), name="c")
    case = scene(mesh[2], [], [Load("top", force=[0, -2.0])], contacts=[floor],
                 springs=[Spring("left", stiffness=[20.0, 20.0])])  # fmt: skip
    case.mesh.strain = strain
    _, steps = simulated(case)
    borne = steps[-1]["contacts"]["c"]["force"][1] * -1.0 + steps[-1]["springs"]["left"]["force"][1]
    assert borne == pytest.approx(2.0, rel=1e-7) and steps[-1]["springs"]["left"]["force"][1] > 0.0


@pytest.mark.parametrize(
    "loads, springs, parts",
    [
        ([Load("top", force=[0, 1], pressure=1.0)], [], ("pressure and force", "exactly one")),
        ([Load("top", pressure=1.0, point=[0, 0])], [], ("point", "without force or moment")),
        ([Load(force=[0, 1])], [], ("loads[0].region", "at, the place")),
        ([Load("top", force=[0, 1, 0])], [], ("force", "3 entries")),
        ([Load("top", moment=[0, 0, 1.0])], [], ("moment", "the mesh is 2D")),
        ([Load("corner_00", moment=1.0)], [], ("moment", "'corner_00'", "in one place")),
        ([Load(at=[0.3, 0.3], force=[0, 1])], [], ("at", "nearest node, at (0.25, 0.25)", "0.07071")),
        ([Load(at=[0.375, 0.25], force=[0, 1], within=0.2)], [], ("at", "two nodes", "block")),
        ([Load(at=[0, 0], moment=1.0)], [], ("moment", "together with at")),
        ([Load("top", force=[0, 1]), Load("top", force=[1, 0])], [], ("loads[1] (top).name", "a second time")),
        ([Load("top", force=[0, 1], follower=True)], [], ("follower", "true without pressure")),
        ([], [Spring("top")], ("springs[0] (top)", "neither", "exactly one")),
        ([], [Spring("top", per_area=-1.0)], ("per_area", "-1", "a number > 0")),
        ([], [Spring("top", per_area=[1.0, 0, 0])], ("per_area", "3 entries", "2D")),
        ([], [Spring("top", stiffness=[0, 0])], ("stiffness", "not all zero")),
        ([], [Spring("block", per_area=1.0)], ("region", "a group of cells")),
        ([], [Spring("tap", per_area=1.0)], ("region", "'top'")),
        ([], [Spring("top", per_area=1.0), Spring("top", stiffness=[1.0, 0])], ("springs[1] (top).name", "second")),
    ],
)  # fmt: skip
def test_bad_loads_and_springs(mesh, loads, springs, parts):
    with pytest.raises(InputError) as caught:
        Simulation(scene(mesh[2], [Displacement("bottom", [0, 0])], loads, springs=springs), SELF)
    assert all(part in str(caught.value) for part in parts), str(caught.value)


def test_nodes_in_a_line_bear_no_moment_about_it(tmp_path, mesh):
    case = scene(mesh[3], [Displacement("bottom", [0, 0, 0])], [Load("corner_111", moment=[0, 0, 1.0])])
    with pytest.raises(InputError, match="in one place"):
        Simulation(case, SELF)
    case.mesh.kinematics, case.loads = "axisymmetric", [Load("right", moment=1.0)]
    with pytest.raises(InputError, match="moment.*axisymmetric"):
        Simulation(case, SELF)
    case = scene(mesh[2], [], [], springs=[Spring("corner_11", stiffness=[1.0, 1.0])])
    case.output.estimate = True
    with pytest.raises(InputError, match=r"output.estimate.*springs\[0\].*a group of nodes"):
        Simulation(case, SELF)


@pytest.mark.parametrize(
    "load, held, words", [
        (Load("top", traction=[0.0, -1.0]), ["free", -0.1], "direction y all its nodes have a prescribed"),
        (Load("top", traction=[1.0, -1.0]), [0.0, "free"], "direction x all its nodes"),
        (Load("top", traction=[0.0, -1.0]), [0.0, "free"], ""),
        (Load("top", force=[0.0, -1.0]), [0.0, 0.0], "direction y all its nodes"),
        (Load("top", pressure=1.0, amplitude=[[0.0, 0.0], [1.0, 0.0]]), None, "its amplitude is zero at all times"),
        (Load("top", pressure=1.0, amplitude=[[0.0, 1.0], [1.0, 0.0]]), None, ""),
    ],
)  # fmt: skip
def test_a_load_that_does_nothing_is_named(mesh, load, held, words):
    """A load on nodes that supports move in its direction, or whose amplitude is zero."""
    held = [] if held is None else [Displacement("top", held)]
    scene = Scene(MeshSpec(mesh[2]), {"m": Material(1000.0, 0.3)}, [Body("block", "m")], loads=[load],
                  displacements=[Displacement("bottom", [0.0, 0.0]), *held])  # fmt: skip
    simulation = Simulation(scene)
    simulation.close()
    told = [line for line in log.warnings() if "nothing" in line]
    assert len(told) == bool(words) and all(words in line and "loads[0] (top)" in line for line in told)
