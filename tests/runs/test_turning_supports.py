"""Bodies whose supports turn: forces turn along, moments balance, any number of ranks, restart."""

import numpy as np
import pytest

from meshes import one_block, two_blocks
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps
from pcontact.simulation import Simulation
from tests.support.finite_contact import moved, turn
from tests.support.restarts import STOP, Keep, run

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel


def scene(path, *displacements, strain="finite", law="neo_hooke", count=1, **more):
    return Scene(
        MeshSpec(path, strain=strain), {"m": Material(10.0, 0.3, law=law)}, [Body("block", "m")],
        displacements=list(displacements), steps=Steps(count=count), petsc={"snes_rtol": "1e-12", "ksp_rtol": "1e-6"},
        output=Output(fields=False, checkpoint=True), **more,
    )  # fmt: skip


@pytest.fixture
def mesh(shared_tmp):
    """Unit boxes by dimension."""
    paths = {dim: shared_tmp / f"block{dim}.msh" for dim in (2, 3)}
    if WORLD.rank == 0:
        for dim, path in paths.items():
            one_block(path, dim, 4 if dim == 2 else 2)
    WORLD.Barrier()
    return paths


def steps_of(scene, comm=SELF):
    simulation = Simulation(scene, comm)
    try:
        assert simulation.run(keep=True)
        return simulation.records.data()["steps"]
    finally:
        simulation.close()


def test_forces_turn_with_the_body(mesh):
    """A block in compression and shear whose supports turn by a right angle, in load steps that are parted."""
    still = steps_of(scene(mesh[2], Displacement("bottom", [0, 0]), Displacement("top", [0.1, -0.2]), count=9))
    centre = {"angle": 90.0, "point": [0.3, 0.2]}
    turned = steps_of(
        scene(mesh[2], Displacement("bottom", [0, 0], **centre), Displacement("top", [0.2, 0.1], **centre))
    )
    assert len(turned) == 9 and {step["cutbacks"] for step in turned} == {0}
    assert max(step["newton"] for step in turned) <= 7
    for region in ("bottom", "top"):
        x, y = still[-1]["reactions"][region]
        np.testing.assert_allclose(turned[-1]["reactions"][region], [-y, x], rtol=1e-8)
    assert turned[-1]["moments"].keys() == {"bottom", "top"} and "moments" not in still[-1]


def test_forces_turn_with_a_pair_in_contact(tmp_path):
    """Two blocks, pressed and turned by a right angle on the way: as without the turn in every load step."""
    path, centre, ends = two_blocks(tmp_path / "blocks.msh", 2, 4, 3), np.array([0.5, 1.0]), []
    for degrees in (0.0, 90.0):
        one = scene(path, Displacement("lower_bottom", [0, 0]), Displacement("upper_top", [0, 0]), count=9)
        one.bodies = [Body("lower", "m"), Body("upper", "m")]
        one.contacts = [Contact("upper_bottom", "lower_top", name="pair", search="ray_tracing")]

        def place(x, time, degrees=degrees):
            pressed = x - time * np.array([0.0, 0.1]) * (x[:, 1:] > 1.0)
            return centre + (pressed - centre) @ turn(degrees * time).T

        ends.append(moved(one, place, lambda simulation: simulation.problem.contacts[0].state(simulation.stepper.u),
                          comm=SELF))  # fmt: skip
    still, turned = ends
    np.testing.assert_array_equal(turned["status"], still["status"])
    np.testing.assert_allclose(turned["traction"] @ turn(90.0), still["traction"], atol=1e-9)
    assert np.all(still["status"] > 0)


def test_moments_balance(mesh):
    """A block that is twisted about an axis beside its middle, and drawn along it."""
    axis = {"point": [0.4, 0.5, 7.0], "axis": [0, 0, 1]}
    steps = steps_of(scene(
        mesh[3], Displacement("bottom", [0, 0, 0], angle=-1e-6, **axis),
        Displacement("top", [0, 0, 0.1], angle=60.0, **axis),
    ))  # fmt: skip
    assert len(steps) == 6
    low, high = (np.array(steps[-1]["moments"][region]) for region in ("bottom", "top"))
    # the centre of the upper one has gone along: forces of 0 in sum across the axis would not mind
    force = np.array(steps[-1]["reactions"]["top"])
    np.testing.assert_allclose(low + high + np.cross([0, 0, 0.1], force), 0.0, atol=1e-8 * abs(high[2]))
    # of the order of shear modulus times twist times the torsion constant of a square
    assert 0.5 < high[2] / (10.0 / 2.6 * np.radians(60.0) * 0.1406) < 1.5


def test_bodies_turn_without_strain(mesh):
    """All of the boundary turns, about a slanted axis: there is no force."""
    sides = ["left", "right", "front", "back", "bottom", "top"]
    around = {"angle": 120.0, "point": [0, 0, 0], "axis": [1, 1, 1]}
    steps = steps_of(scene(mesh[3], *(Displacement(side, [0, 0, 0], **around) for side in sides)))
    assert len(steps) == 12
    assert max(np.abs(force).max() for force in steps[-1]["reactions"].values()) < 1e-11


def twisted(path):
    """A block that is turned about a slanted axis, and back a little."""
    around = {"angle": 50.0, "point": [0.4, 0.5, 1.0], "axis": [0, 0.2, 1]}
    ramp = [(0, 0), (0.8, 1), (1, 0.8)]
    return scene(path, Displacement("bottom", [0, 0, 0]), Displacement("top", [0, 0, 0.1], ramp, **around),
                 law="hencky", count=3)  # fmt: skip


def same(one, other):
    for key in ("moments", "reactions"):
        np.testing.assert_allclose(one[key]["top"], other[key]["top"], rtol=1e-8, atol=1e-8)


@parallel(2, 3)
def test_ranks(mesh, shared_tmp):
    alone = run(twisted(mesh[3]), SELF, shared_tmp / f"alone{WORLD.rank}")
    same(run(twisted(mesh[3]), WORLD, shared_tmp / "together")[-1], alone[-1])


@parallel(1, 2, 3)
@pytest.mark.usefixtures("one_order")
def test_restart(mesh, shared_tmp):
    whole, cut, rest = (shared_tmp / name for name in ("whole", "cut", "rest"))
    steps = run(twisted(mesh[3]), WORLD, whole, [Keep(whole, cut, WORLD)])
    after = run(twisted(mesh[3]), WORLD, rest, restart=cut)
    assert len(steps) > STOP + 1
    assert [step["time"] for step in after] == [step["time"] for step in steps[STOP:]]
    same(steps[-1], after[-1])


def test_small_strain_says_where_it_ends(mesh, caplog):
    def turned(angle, **more):
        return scene(mesh[2], Displacement("bottom", [0, 0]),
                     Displacement("top", [0, 0], angle=angle, point=[0.5, 1.0]), strain="small", law="hencky", **more)

    caplog.set_level("WARNING")
    assert "moments" in steps_of(turned(2.0))[-1]
    assert "small strain" not in caplog.text
    steps_of(turned(5.0))
    assert "displacements[1] (top).angle" in caplog.text and "0.38 %" in caplog.text
    with pytest.raises(InputError, match=r"displacements\[1\] \(top\).angle.*30 degrees.*allow_unsafe turn"):
        steps_of(turned(30.0))
    assert len(steps_of(turned(30.0, allow_unsafe=["turn"]))) == 3


@pytest.mark.parametrize(
    "dim, keys, parts",
    [
        (2, {"angle": 3.0}, ("angle", "3.0 without point")),
        (2, {"point": [0, 0]}, ("point", "without angle")),
        (2, {"angle": 3.0, "point": [0, 0], "axis": [0, 0, 1]}, ("axis", "3 entries")),
        (2, {"angle": 3.0, "point": [0, 0], "axis": [0, 1]}, ("axis", "2D")),
        (3, {"angle": 3.0, "point": [0, 0, 0]}, ("axis", "nothing")),
        (3, {"angle": 3.0, "point": [0, 0, 0], "axis": [0, 1, 1]}, ("value", "free", "direction 2")),
        (3, {"angle": 3.0, "point": [0, 0], "axis": [0, 0, 1]}, ("point", "2 entries")),
    ],
)
def test_bad_turns(mesh, dim, keys, parts):
    value = [0, 0] if dim == 2 else [0, 0, "free"]
    with pytest.raises(InputError) as caught:
        Simulation(scene(mesh[dim], Displacement("top", value, **keys)), SELF)
    assert "displacements[0]" in str(caught.value) and all(part in str(caught.value) for part in parts)


def test_rings_do_not_turn(mesh):
    one = scene(mesh[2], Displacement("top", [0, 0], angle=3.0, point=[0, 0]))
    one.mesh.kinematics = "axisymmetric"
    with pytest.raises(InputError, match="angle.*axisymmetric"):
        Simulation(one, SELF)
