"""Points that partners frozen during a load step mislead: counted, reported, and warned of."""

from types import SimpleNamespace

import numpy as np
import pytest

from meshes import one_block, two_blocks
from pcontact.contact.active_set import normal_motion
from pcontact.runtime import log
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD


class Records(Observer):
    """Observer: the records of all load steps."""

    def __init__(self):
        self.rows, self.cuts = [], 0

    def step(self, step, u, record):
        self.rows.append(record)

    def cut(self, target, outcome):
        self.cuts += 1


def solved(scene):
    """Records of a run that ends well. Collective."""
    records, simulation = Records(), Simulation(scene)
    try:
        assert simulation.run(None, [records])
    finally:
        simulation.close()
    return records


def made(path, function, *arguments, **more):
    """A mesh file, made by rank 0. Collective."""
    if WORLD.rank == 0:
        function(path, *arguments, **more)
    WORLD.Barrier()
    return path


# partners of a load step stay, whatever they do to its answer
STAY = {"contact_search_again": "0"}


def in_a_bowl(path, way, count):
    """A block that is moved along the bottom of a bowl of radius 2, into its side."""
    bowl = Obstacle("sphere", center=[0.5, 2.0], radius=2.2, inside=True)
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("block", "m")],
        contacts=[Contact("bottom", obstacle=bowl, name="bowl", search_radius=1.0)],
        displacements=[Displacement("block", [way, 0.0])],
        steps=Steps(1.0, count),
        output=Output(fields=False),
        petsc=STAY,
    )


@pytest.mark.parallel
def test_points_that_a_frozen_normal_takes_into_an_obstacle(shared_tmp, caplog):
    """Along the tangents of the beginning the block stays in the bowl; by its circle the foremost points leave it."""
    path = made(shared_tmp / "b.msh", one_block, 2, (8, 8))
    (far,) = solved(in_a_bowl(path, 1.0, 1)).rows
    assert far["contacts"]["bowl"]["passed"] > 0
    assert WORLD.rank != 0 or any("inside their partner" in line for line in caplog.messages)
    caplog.clear()
    near = solved(in_a_bowl(path, 0.1, 4)).rows
    assert all(row["contacts"]["bowl"]["passed"] == row["contacts"]["bowl"]["left"] == 0 for row in near)
    assert not any("inside their partner" in line for line in caplog.messages)


def below_a_bar(path, tool, source="top", **more):
    """A block with a bar of radius 0.2 on its upper side, or in it."""
    return Scene(
        mesh=MeshSpec(path, strain="finite"),
        materials={"m": Material(10.0, 0.3)},
        bodies=[Body("block", "m")],
        contacts=[Contact(source, obstacle=tool, name="bar")],
        displacements=[Displacement("bottom", [0.0, 0.0])],
        output=Output(fields=False),
        **more,
    )


@pytest.mark.parallel
def test_a_bar_that_lies_in_a_block_at_first(shared_tmp):
    """It is pushed out of the material as if it had been pressed in from above, with the same force."""
    path = made(shared_tmp / "b.msh", one_block, 2, (16, 8))
    pressed = Obstacle("sphere", center=[0.5, 1.205], radius=0.2, displacement=[0.0, -0.255])
    lies, forces = Obstacle("sphere", center=[0.5, 0.95], radius=0.2), []
    for tool, count in ((lies, 2), (pressed, 6)):
        bars = [row["contacts"]["bar"] for row in solved(below_a_bar(path, tool, steps=Steps(1.0, count))).rows]
        assert all(bar["passed"] == bar["left"] == 0 for bar in bars)
        forces.append(bars[-1]["force"])
    np.testing.assert_allclose(forces[0], forces[1], rtol=0.01, atol=1e-6)
    assert forces[0][1] > 0.1


@pytest.mark.parallel
def test_points_inside_an_obstacle_without_a_partner(shared_tmp, caplog):
    """The upper side of a block in a half space, whose lower side is no source: nothing pushes it out."""
    path = made(shared_tmp / "b.msh", one_block, 2, (4, 4))
    (row,) = solved(below_a_bar(path, Obstacle("plane", point=[0.0, 2.0], normal=[0.0, 1.0]))).rows
    assert row["contacts"]["bar"]["passed"] == row["contacts"]["bar"]["open"] > 0
    assert WORLD.rank != 0 or any("inside their partner" in line for line in caplog.messages)


def rising(path, way, **more):
    """The lower of two blocks rises through a gap wider than the search radius, against the upper one."""
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(1000.0, 0.0)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="pair", search_radius=0.1)],
        displacements=[Displacement("upper_top", [0.0, 0.0]), Displacement("lower_bottom", [0.0, way])],
        petsc={"snes_rtol": 1e-12},
        output=Output(fields=False),
        **more,
    )


@pytest.mark.parallel
@pytest.mark.parametrize("steps", [1, 3])
def test_a_target_that_comes_from_afar_meets_its_source(shared_tmp, steps):
    """It must not rise past points that had no partner when the load step began: the force is that of two columns."""
    path = made(shared_tmp / "b.msh", two_blocks, 2, 2, 2, gap=0.3)
    records = solved(rising(path, 0.34, steps=Steps(1.0, steps)))
    pair = records.rows[-1]["contacts"]["pair"]
    assert pair["force"][1] == pytest.approx(-0.04 / 2.0 * 1000.0, rel=1e-6)
    assert pair["passed"] == pair["left"] == 0


@pytest.mark.parallel
@pytest.mark.parametrize(("gap", "radius"), [(-0.1, None), (-0.3, None), (-0.3, 0.1)])
def test_an_overlap_deeper_than_the_search_radius(shared_tmp, caplog, gap, radius):
    """It is pushed apart with the force of two columns; where the user's radius is too short, a warning says so."""
    path = made(shared_tmp / "b.msh", two_blocks, 2, 3, 2, gap=gap)
    scene = rising(path, 0.0)
    scene.contacts[0].search_radius = radius
    (row,) = solved(scene).rows
    said = any("search_radius = 0.1" in line for line in caplog.messages)
    expected = 0.0 if radius else gap / 2.0 * 1000.0
    assert row["contacts"]["pair"]["force"][1] == pytest.approx(expected, rel=1e-6)
    assert WORLD.rank != 0 or said == bool(radius)


@pytest.mark.parallel
def test_bodies_that_move_together_are_not_far_from_each_other(shared_tmp):
    """Points without a partner, on bodies that move as one by many search radii, need no shorter load steps."""
    path = made(shared_tmp / "b.msh", two_blocks, 2, 2, 2, gap=0.3)
    scene = rising(path, 1.0)
    scene.displacements[0].value = [0.0, 1.0]
    assert solved(scene).cuts == 0


@pytest.mark.parallel
def test_points_that_slide_off_their_target(shared_tmp, caplog):
    """A loose block pushed over the edge of the one that it lies on."""
    path = made(shared_tmp / "b.msh", two_blocks, 2, 2, 4)
    scene = rising(path, 0.0, steps=Steps(1.0, 3))
    scene.displacements = [Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.5, "free"])]
    scene.loads = [Load("upper_top", pressure=1.0, amplitude=[[0.0, 1.0], [1.0, 1.0]])]
    scene.contacts[0].search_radius, scene.petsc = 0.2, {**scene.petsc, **STAY}
    rows = solved(scene).rows
    assert sum(row["contacts"]["pair"]["left"] for row in rows) > 0
    assert WORLD.rank != 0 or sum("have left theirs" in line for line in caplog.messages) == 1
    assert np.all([row["contacts"]["pair"]["passed"] == 0 for row in rows])


@pytest.mark.parallel
def test_forces_that_the_rounding_errors_of_a_stiff_body_hide(shared_tmp, caplog):
    """Tied to a body 1e17 times as stiff, which moves: the forces of the soft one are lost, and a warning says so."""
    path = made(shared_tmp / "b.msh", two_blocks, 2, 2, 3)
    scene = rising(path, 0.1)
    scene.materials = {"soft": Material(3.0, 0.3), "stiff": Material(3e17, 0.3)}
    scene.bodies = [Body("lower", "soft"), Body("upper", "stiff")]
    scene.contacts = [Contact("upper_bottom", "lower_top", name="pair", tied=True)]
    scene.displacements = [Displacement("upper_top", [0.013, 0.017]), Displacement("lower_bottom", [0.0, 0.0])]
    (row,) = solved(scene).rows
    assert row["imbalance"] < 1e-3 or WORLD.rank != 0 or any("out of balance" in line for line in caplog.messages)


def on_a_stiff_block(path, ratio, **contact):
    """Pressure (n,) of two blocks, pressed by 0.001, of which the upper one is ``ratio`` times as stiff; the mean that
    is expected."""
    scene = rising(path, 0.0)
    scene.materials = {"soft": Material(1.0, 0.0), "stiff": Material(ratio, 0.0)}
    scene.bodies = [Body("upper", "stiff"), Body("lower", "soft")]
    scene.contacts, scene.petsc = [Contact(name="pair", **contact)], {}
    scene.displacements = [Displacement("upper_top", [0.0, -0.001]), Displacement("lower_bottom", [0.0, 0.0])]
    simulation = Simulation(scene)
    assert simulation.run(None)
    state = simulation.problem.contacts[0].state(simulation.stepper.u)
    simulation.close()
    return state["pressure"], 0.001 * ratio / (1.0 + ratio)


def test_rounding_errors_of_a_stiff_body_do_not_end_what_a_soft_one_needs(shared_tmp):
    """The pressure is that of the soft source, and only its target is 1e12 times as stiff."""
    path = made(shared_tmp / "b.msh", two_blocks)
    pressure, expected = on_a_stiff_block(path, 1e12, source="lower_top", target="upper_bottom")
    np.testing.assert_allclose(pressure, expected, rtol=1e-9)


@pytest.mark.parametrize("ratio, told", [(1e8, False), (1e11, True)])
def test_rounding_errors_of_a_stiff_source_are_told(shared_tmp, caplog, ratio, told):
    """Its pressure is wrong by a rounding error of a displacement times its modulus."""
    path = made(shared_tmp / "b.msh", two_blocks)
    pressure, expected = on_a_stiff_block(path, ratio, source="upper_bottom", target="lower_top")
    lines = [line for line in caplog.messages if "rounding errors" in line]
    assert bool(lines) == told and all("upper" in line for line in lines)
    np.testing.assert_allclose(pressure, expected, rtol=1e-15 * ratio * 5.0)


@pytest.mark.parametrize("source, target", [("upper_bottom", "lower_top"), ("lower_top", "upper_bottom")])
def test_friction_on_a_target_that_is_too_soft_is_told(shared_tmp, source, target):
    """Where the traction is that of the source a load step that does not converge says
    that source and target are to be exchanged; exchanged, it does."""
    scene = rising(made(shared_tmp / "b.msh", two_blocks), 0.0)
    scene.materials = {"soft": Material(1e-8, 0.3), "stiff": Material(1.0, 0.3)}
    scene.bodies = [Body("upper", "stiff"), Body("lower", "soft")]
    scene.contacts, scene.petsc = [Contact(source, target, name="pair", friction=0.3, traction="source")], {}
    scene.steps = Steps(count=1, min_step=0.9)
    scene.displacements = [
        *(Displacement(name, ["free", value]) for name, value in (("lower_bottom", 0.0), ("upper_top", -0.01))),
        *(Displacement(name, [0.0, "free"]) for name in ("lower_left", "upper_left")),
    ]
    simulation = Simulation(scene)
    converged = simulation.run(None)
    simulation.close()
    assert converged == (source == "lower_top")
    assert converged or "remedy: source = 'lower_top', target = 'upper_bottom'" in str(simulation.failure)


@pytest.mark.parametrize("d", [2, 3])
def test_how_far_points_without_a_partner_go_does_not_depend_on_the_axes(d):
    """What stops a load step is how far the target's places go along their normals, not the box around that."""
    rng = np.random.default_rng(5)
    normal, own, moved = (rng.normal(size=(n, d)) for n in (40, 40, 60))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    exact = np.abs(np.einsum("pd,pd->p", normal, own)[:, None] - normal @ moved.T).max()
    for _ in range(5):
        R = np.linalg.qr(rng.normal(size=(d, d)))[0]
        for radius in (0.0, 0.999 * exact, 1.001 * exact):
            assert (normal_motion_of(normal @ R.T, own @ R.T, moved @ R.T, radius) > radius) == (exact > radius)
    assert normal_motion_of(normal, own, moved, 0.0) == pytest.approx(exact, rel=1e-14)


def normal_motion_of(normal, own, moved, radius):
    """That of points (np, d) without a partner, which have moved, on a target whose nodes (n, d) have moved."""
    points = len(own)
    exchange = SimpleNamespace(gather=lambda u: u)
    target = SimpleNamespace(nodes=points + np.arange(len(moved)).reshape(-1, 2))
    pairing = SimpleNamespace(exchange=exchange, paired=np.zeros(points, dtype=bool), normal=normal)
    return normal_motion(
        SimpleNamespace(
            pairing=pairing, radius=radius, rigid=False,
            terms=SimpleNamespace(gap=lambda p, u: -np.einsum("pd,pd->p", normal, u[:points])),
            space=SimpleNamespace(comm=MPI.COMM_SELF, local=exchange),
            search=SimpleNamespace(target=target),
        ),
        np.concatenate([own, moved]),
        np.zeros((points + len(moved), own.shape[1])),
    )  # fmt: skip


@pytest.mark.parametrize(
    "lift, radius, words", [(0.02, None, "least gap was 0.11, at time 0.5"), (0.02, 0.05, "no point had a partner"),
                            (-0.2, None, "")], ids=["apart", "out of sight", "closed"],
)  # fmt: skip
def test_a_contact_that_nothing_closes_is_named(shared_tmp, lift, radius, words):
    """With the least gap and when that was; a contact that closes in one load step is not named."""
    path = made(shared_tmp / "blocks.msh", two_blocks, n_lower=(2, 2), n_upper=(2, 2), gap=0.1)
    scene = Scene(
        mesh=MeshSpec(path), materials={"m": Material(1000.0, 0.3)}, bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="gap", search_radius=radius)],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.0, lift])],
        steps=Steps(count=2), output=Output(fields=False, estimate=False),
    )  # fmt: skip
    log.forget_warnings()
    solved(scene)
    told = [line for line in log.warnings() if "open at all points" in line]
    assert len(told) == bool(words) and all("contact gap" in line and words in line for line in told)
