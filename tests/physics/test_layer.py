"""Bodies on soft layers: springs in a row, and friction under the pressure of the layer."""

import numpy as np
import pytest

from drivers._common import running
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps
from tests.support.blocks import made
from tests.support.patch import blocks

WORLD = MPI.COMM_WORLD
LAM, MU = 1000.0 * 0.3 / (1.3 * 0.4), 1000.0 / 2.6
CURVE = [[-0.01, 0.0], [0.0, 2.0], [0.02, 40.0], [0.05, 130.0]]


def at(curve, closing):
    """Pressure of a curve, or of a slope."""
    if isinstance(curve, float):
        return curve * max(closing, 0.0)
    h, p = np.array(curve).T
    beyond = p[-2] + (p[-1] - p[-2]) * (closing - h[-2]) / (h[-1] - h[-2])
    return np.interp(closing, h, p) if closing < h[-1] else beyond


def uniform(curve, depth, finite, heights=1.0):
    """Pressure where a body that cannot widen is pressed on a layer, by bisection: (pressure, overclosure)."""
    low, high = -0.01, depth

    def stress(closing):
        stretch = 1.0 - (depth - closing) / heights
        return -(LAM + 2 * MU) * (np.log(stretch) / stretch if finite else stretch - 1.0)

    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stress(middle) > at(curve, middle) else (low, middle)
    return at(curve, low), low


def held(d, faces=("left", "right", "front", "back")):
    """No face moves across itself."""
    pairs = [(name, k // 2) for k, name in enumerate(faces)][: 2 * (d - 1)]
    return [Displacement(name, ["free" if i != axis else 0.0 for i in range(d)]) for name, axis in pairs]


def on_plane(path, d, strain, depth, **contact):
    obstacle = Obstacle("plane", [0.0] * d, [0.0] * (d - 1) + [1.0])
    return Scene(
        MeshSpec(path, strain=strain), {"m": Material(1000.0, 0.3)}, [Body("block", "m")],
        contacts=[Contact("bottom", obstacle=obstacle, name="floor", **contact)],
        displacements=[Displacement("top", ["free"] * (d - 1) + [-depth]), *held(d)],
        steps=Steps(count=2), output=Output(fields=False), petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("strain", ["small", "finite"])
@pytest.mark.parametrize("curve", [500.0, CURVE], ids=["slope", "table"])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_springs_in_a_row(shared_tmp, cell, curve, strain):
    """A body that cannot widen on a layer, a sixth of which is its own compression."""
    path, d = made(shared_tmp, cell)
    pressure, closing = uniform(curve, 0.06, strain == "finite")
    with running(on_plane(path, d, strain, 0.06, pressure_overclosure=curve)) as (simulation, converged):
        assert converged
        state = simulation.problem.contacts[0].state(simulation.stepper.u)
        np.testing.assert_allclose(state["pressure"], pressure, rtol=1e-9)
        np.testing.assert_allclose(state["gap"], -closing, rtol=1e-9)


@pytest.mark.parametrize("unbiased", [False, True])
@pytest.mark.parametrize("strain", ["small", "finite"])
def test_a_layer_between_bodies(shared_tmp, strain, unbiased):
    """Two blocks whose meshes do not match, each as high as one: the layer is one, whoever is the source."""
    path = blocks(shared_tmp, "quadrilateral", 2, 3)
    sides = [f"{body}_{side}" for body in ("lower", "upper") for side in ("left", "right")]
    case = Scene(
        MeshSpec(path, strain=strain), {"m": Material(1000.0, 0.3)}, [Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", pressure_overclosure=CURVE, unbiased=unbiased)],
        displacements=[Displacement("lower_bottom", ["free", 0.0]), Displacement("upper_top", ["free", -0.06]),
                       *[Displacement(name, [0.0, "free"]) for name in sides]],
        steps=Steps(count=2), output=Output(fields=False), petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip
    pressure, _ = uniform(CURVE, 0.06, strain == "finite", 2.0)
    with running(case) as (simulation, converged):
        assert converged
        state = simulation.problem.contacts[0].state(simulation.stepper.u)
        np.testing.assert_allclose(state["pressure"], pressure, rtol=1e-8)


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_friction(shared_tmp, strain):
    """A floor moves along beneath: points stick by their stiffness, and slide with a part of the layer's pressure."""
    path, d = made(shared_tmp, "quadrilateral")
    contact = {"pressure_overclosure": CURVE, "friction": 0.5, "stick_stiffness": 200.0}
    for way, expected in ((0.01, None), (1.0, 0.5)):
        case = on_plane(path, d, strain, 0.06, **contact)
        # rigid along the floor, so that slip is its way
        case.displacements = [Displacement("block", [0.0, "free"]), case.displacements[0]]
        case.contacts[0].obstacle.displacement = [way, 0.0]
        case.contacts[0].obstacle.amplitude = [[0.5, 0.0], [1.0, 1.0]]
        pressure, _ = uniform(CURVE, 0.06, strain == "finite")
        with running(case) as (simulation, converged):
            assert converged
            state = simulation.problem.contacts[0].state(simulation.stepper.u)
            # the mean of half a load step's slip that sticks
            along = state["traction"][:, 0]
            if expected is None:
                np.testing.assert_allclose(along, 200.0 * way, rtol=1e-6)
            else:
                np.testing.assert_allclose(along, 0.5 * pressure, rtol=1e-8)


def test_no_separation(shared_tmp):
    """A layer that holds in tension goes on with its first slope."""
    path, d = made(shared_tmp, "quadrilateral")
    with running(on_plane(path, d, "small", -0.05, pressure_overclosure=CURVE, bilateral=True)) as (simulation, done):
        assert done
        state = simulation.problem.contacts[0].state(simulation.stepper.u)
        stiff = LAM + 2 * MU
        # 200 (g - 0.01) = stiff (0.05 - g)
        gap = (stiff * 0.05 + 2.0) / (stiff + 200.0)
        np.testing.assert_allclose(state["gap"], gap, rtol=1e-9)
        np.testing.assert_allclose(state["pressure"], -200.0 * (gap - 0.01), rtol=1e-9)
