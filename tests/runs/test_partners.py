"""Partners of contact points decide no answer: bodies that pass, slide far, have corners, begin with a gap."""

import numpy as np
import pytest

import pcontact as pc
from drivers.studies._robust_scenes import reversal
from meshes import two_blocks
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps

RIGID = 1e7


def grids(*boxes):
    """A mesh of boxes (name, low, high, counts), with their sides NAME_left, NAME_right, NAME_bottom, NAME_top; also
    NAME_sides, the first two that meet in the lower left corner, and NAME_handle, the others. A box may say where its
    points (2, n) are instead of low and high."""
    points, cells, groups, facets, first = [], [], {}, {}, 0
    for name, *where, (nx, ny) in boxes:
        if len(where) == 2:
            low, high = where
            lines = (np.linspace(a, b, n + 1) for a, b, n in zip(low, high, (nx, ny), strict=True))
            where = [np.array(np.meshgrid(*lines, indexing="ij")).reshape(2, -1)]
        x, y = where[0].reshape(2, nx + 1, ny + 1)
        number = first + np.arange(x.size).reshape(x.shape)
        points.append(np.column_stack([x.ravel(), y.ravel()]))
        quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
        groups[name] = np.arange(len(quads)) + sum(map(len, cells))
        cells.append(quads)
        sides = {"left": number[0], "right": number[-1], "bottom": number[:, 0], "top": number[:, -1]}
        rows = {side: np.column_stack([row[:-1], row[1:]]) for side, row in sides.items()}
        rows |= {"sides": np.concatenate([rows["left"], rows["bottom"]]),
                 "handle": np.concatenate([rows["right"], rows["top"]])}  # fmt: skip
        facets |= {f"{name}_{side}": row for side, row in rows.items()}
        first += x.size
    return pc.mesh_from((np.concatenate(points), {"quad": np.concatenate(cells)}), groups, facets)


def scene(mesh, contact, displacements, count=1, end=1.0, **more):
    material = Material(1000.0, 0.3)
    return Scene(
        mesh=mesh, materials={"m": material, "hard": Material(RIGID, 0.3), **more.pop("materials", {})},
        bodies=more.pop("bodies"), contacts=[contact],
        displacements=[Displacement(*one[:2], **(one[2] if len(one) > 2 else {})) for one in displacements],
        steps=Steps(end, count), output=Output(fields=False), **more,
    )  # fmt: skip


def solved(case, **options):
    run = pc.run(case, options=options)
    assert run.converged
    return run.report["steps"], run.report["warnings"]


def test_bodies_that_pass_each_other_do_not_touch():
    """A block moves down beside a wall, past its corner: no pressure, no plastic strain."""
    mesh = grids(("wall", (1.05, 0.0), (2.05, 2.0), (4, 8)), ("block", (0.0, 2.2), (1.0, 3.2), (4, 4)))
    steel = Material(210e3, 0.3, yield_stress=300.0, hardening=1000.0)
    steps, warnings = solved(scene(
        mesh, Contact("block_right", "wall_left", name="c", friction=0.1),
        [("wall_right", [0.0, 0.0]), ("block_top", [0.0, -1.6])], 4,
        bodies=[Body("wall", "steel"), Body("block", "steel")], materials={"steel": steel},
    ))  # fmt: skip
    assert all("open at all points" in line for line in warnings)
    assert all(step["contacts"]["c"]["max_pressure"] == 0.0 for step in steps)
    assert steps[-1]["plastic"]["max_equivalent_strain"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_a_block_that_is_dragged_far_keeps_its_forces(order):
    """Along a plank, several facets in all: the normal force stays, the other one is the friction."""
    mesh = grids(("plank", (-0.3, -1.0), (0.3, 4.0), (2, 17)), ("block", (0.31, 3.2), (0.91, 4.0), (3, 4)))
    mesh.order = order if order == 1 else None
    drag = {"amplitude": [[0.0, 0.0], [1.0, 0.0], [4.0, 1.0]]}
    steps, warnings = solved(scene(
        mesh, Contact("block_left", "plank_right", name="c", friction=0.4),
        [("plank_left", [0.0, 0.0]), ("block_right", [-0.02, "free"], {"amplitude": [[0.0, 0.0], [1.0, 1.0]]}),
         ("block_right", ["free", -3.0], drag)], 20, 4.0,
        bodies=[Body("plank", "m"), Body("block", "m")],
    ))  # fmt: skip
    late = np.array([step["contacts"]["c"]["force"] for step in steps if step["time"] > 2.0])
    assert np.ptp(late[:, 0]) < 0.05 * np.abs(late[:, 0]).mean()
    assert np.abs(late[:, 1] / late[:, 0]) == pytest.approx(0.4, abs=5e-3)
    assert not [line for line in warnings if "partner" in line]


@pytest.mark.parallel
@pytest.mark.parametrize("strain", ["small", "finite"])
@pytest.mark.parametrize("gap", [0.0, 0.01])
def test_a_tool_all_of_whose_nodes_are_prescribed_is_felt_in_the_first_load_step(strain, gap):
    """Newton's method runs, though nothing of what is free has a residual where the tool moves alone."""
    mesh = grids(("block", (0.0, 0.0), (1.0, 1.0), (5, 5)), ("tool", (-0.2, 1.0 + gap), (1.2, 1.2), (7, 1)))
    mesh.strain = strain
    ((step,), _) = solved(scene(
        mesh, Contact("block_top", "tool_bottom", name="c"), [("block_bottom", [0.0, 0.0]), ("tool", [0.0, -0.05])],
        bodies=[Body("block", "m"), Body("tool", "hard")],
    ))  # fmt: skip
    assert step["newton"] > 0
    force = step["reactions"]["block_bottom"][1]
    assert step["contacts"]["c"]["force"][1] == pytest.approx(force, rel=1e-6) and force > 20.0
    assert step["imbalance"] < 1e-6


@pytest.mark.parallel
def test_a_clearance_is_that_of_the_undeformed_bodies_where_an_error_is_named():
    """Though later meshes look for partners where the bodies are expected."""
    mesh = grids(("lower", (0.0, 0.0), (1.2, 1.0), (3, 2)), ("upper", (0.1, 0.99), (1.1, 1.99), (2, 2)))
    case = scene(
        mesh, Contact("upper_bottom", "lower_top", name="c", clearance=0.005),
        [("lower_bottom", [0.0, 0.0]), ("upper_top", [0.0, -0.01])],
        bodies=[Body("lower", "m"), Body("upper", "m")],
    )  # fmt: skip
    plain, _ = solved(case)
    named, _ = solved(case, error=0.05)
    forces = [steps[-1]["contacts"]["c"]["force"][1] for steps in (plain, named)]
    assert forces[1] == pytest.approx(forces[0], rel=0.05) and forces[0] < -1.0


@pytest.mark.parallel
def test_an_interference_that_grows_is_imposed_once_where_an_error_is_named():
    mesh = grids(("lower", (0.0, 0.0), (1.2, 1.0), (3, 2)), ("upper", (0.1, 0.99), (1.1, 1.99), (2, 2)))
    amplitude = [[0.0, 0.0], [1.0, 1.0]]
    case = scene(
        mesh, Contact("upper_bottom", "lower_top", name="c", interference_amplitude=amplitude),
        [("lower_bottom", [0.0, 0.0]), ("upper_top", [0.0, 0.0])], 2,
        bodies=[Body("lower", "m"), Body("upper", "m")],
    )  # fmt: skip
    plain, _ = solved(case)
    named, _ = solved(case, error=0.05)
    for steps in (plain, named):
        half, whole = (step["contacts"]["c"]["force"][1] for step in (steps[-2], steps[-1]))
        assert half == pytest.approx(0.5 * whole, rel=1e-3)
    assert named[-1]["contacts"]["c"]["force"][1] == pytest.approx(plain[-1]["contacts"]["c"]["force"][1], rel=0.05)


@pytest.mark.parallel
@pytest.mark.parametrize("motion", [-0.05, -0.6])
def test_points_that_are_deep_for_their_facets_are_said(motion):
    """Blocks of penalty contact, whose overlap is known: p / gamma, gamma = (lambda + 2 mu) / h of cells of 0.5."""
    mesh = grids(("lower", (0.0, 0.0), (1.0, 1.0), (2, 2)), ("upper", (0.0, 1.0), (1.0, 2.0), (2, 2)))
    steps, warnings = solved(scene(
        mesh, Contact("upper_bottom", "lower_top", name="c", formulation="penalty", gamma0=1.0, search_radius=1.0),
        [("lower_bottom", [0.0, 0.0]), ("upper_top", [0.0, motion])],
        bodies=[Body("lower", "m"), Body("upper", "m")],
    ))  # fmt: skip
    deep = steps[-1]["contacts"]["c"]["max_penetration"] / 0.5
    said = [line for line in warnings if "points are inside their partner by" in line]
    assert bool(said) == (deep > 0.1) == (motion < -0.5)
    assert not said or "smaller cells" in said[0]


@pytest.mark.parallel
@pytest.mark.parametrize("source, target", [("tip_sides", "slab_top"), ("slab_top", "tip_sides")])
def test_a_corner_of_the_target_counts_as_penetration(source, target):
    """A diamond that stands on a slab: how deep its corner is, whichever surface is the source."""
    diamond = 0.5 * np.array([[1.0, -1.0], [1.0, 1.0]]) @ np.mgrid[0:4, 0:4].reshape(2, -1) / 1.5 + [[2.1], [0.0]]
    mesh = grids(("slab", (0.0, -2.0), (4.0, 0.0), (8, 4)), ("tip", diamond, (3, 3)))
    steps, warnings = solved(scene(
        mesh, Contact(source, target, name="c"),
        [("slab_bottom", [0.0, 0.0]), ("tip_handle", [0.0, -0.1])], 4,
        bodies=[Body("slab", "m"), Body("tip", "hard")],
    ))  # fmt: skip
    contact = steps[-1]["contacts"]["c"]
    sinks = [line for line in warnings if "a corner of tip_sides" in line]
    if target == "tip_sides":
        assert contact["target_penetration"] == contact["max_penetration"]
        assert contact["max_penetration"] > 0.05 and sinks and "unbiased = true" in sinks[0]
    else:
        assert contact["max_penetration"] < 0.1 and not sinks


@pytest.mark.parametrize("exchanged", [False, True])
def test_a_tool_that_is_narrower_than_a_facet_of_the_source(tmp_path, exchanged):
    """It sinks in by a part of what it compresses, though not of a facet."""
    path = two_blocks(tmp_path / "b.msh", 3, 3, 2, widths=(1.0, 0.3), heights=(1.0, 0.3))
    names = ("upper_bottom", "lower_top")[:: 1 if exchanged else -1]
    steps, warnings = solved(scene(
        MeshSpec(path), Contact(*names, name="c"),
        [("lower_bottom", [0.0] * 3), ("upper_top", [0.0, 0.0, -0.01])],
        bodies=[Body("lower", "m"), Body("upper", "hard")],
    ))  # fmt: skip
    contact = steps[-1]["contacts"]["c"]
    assert contact["max_penetration"] < 0.1 / 3.0
    assert any("a corner of upper_bottom" in line for line in warnings) == (not exchanged)


def test_elastic_bodies_that_go_on_as_they_did_begin_there(tmp_path):
    """A block that is pressed, and pushed to and fro: less than half of the iterations of a start where it was."""
    steps, _ = solved(reversal(tmp_path, friction=0.3, theta=0.0))
    newton = [step["newton"] for step in steps]
    assert len(newton) == 5 and sum(newton) <= 14, newton
