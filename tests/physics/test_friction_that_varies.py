"""Coefficients of friction that depend on place, time and speed of slip: blocks on floors that move along."""

import numpy as np
import pytest

from drivers._common import running
from pcontact.runtime.observer import Observer
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Phase, Scene, Steps
from tests.support.blocks import made

DEPTH, STEPS = 0.02, 10
# at rest while the block is pressed down, then with speed 1, then with speed 4
MOVED = [[0.2, 0.0], [0.6, 0.4], [1.0, 2.0]]


class Watch(Observer):
    """Force along the floor over that across it, of every load step."""

    def __init__(self):
        self.ratios = []

    def step(self, step, u, record):
        force = record["contacts"]["floor"]["force"]
        self.ratios.append(abs(force[0] / force[-1]))


def dragged(path, d, strain="small", moved=MOVED, **contact):
    """A block that moves down alone, on a floor that moves along: the pressure is uniform."""
    floor = Obstacle("plane", [0.0] * d, [0.0] * (d - 1) + [1.0], displacement=[1.0] + [0.0] * (d - 1), amplitude=moved)
    down = Displacement("top", ["free"] * (d - 1) + [-DEPTH], [[0, 0], [0.2, 1]])
    return Scene(
        MeshSpec(path, strain=strain), {"m": Material(1000.0, 0.3)}, [Body("block", "m")],
        contacts=[Contact("bottom", obstacle=floor, name="floor", **contact)],
        displacements=[Displacement("block", [0.0] * (d - 1) + ["free"]), down],
        steps=Steps(count=STEPS), output=Output(fields=False), petsc={"snes_rtol": "1e-12"},
    )  # fmt: skip


def ratios(case):
    """Force along over force across, of every load step."""
    watch = Watch()
    with running(case, observers=[watch]) as (_, converged):
        assert converged
    return np.array(watch.ratios)


@pytest.mark.parallel(2)
@pytest.mark.parametrize("strain", ["small", "finite"])
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_coefficient_of_the_place(shared_tmp, cell, strain):
    """The mean over the bottom, which is the unit square: of x 1/2, of y 1/2; and over the time."""
    path, d = made(shared_tmp, cell)
    text = "(0.1 + 0.2*x)*(1 + t)" if d == 2 else "(0.1 + 0.2*x + 0.1*y)*(1 + t)"
    mean = 0.2 if d == 2 else 0.25
    moved = [[0.2, 0.0], [1.0, 4.0]]
    found = ratios(dragged(path, d, strain, moved, friction=text))
    times = np.arange(3, STEPS + 1) / STEPS
    np.testing.assert_allclose(found[2:], mean * (1.0 + times), rtol=1e-7)


@pytest.mark.parallel(2)
@pytest.mark.parametrize("formulation", ["nitsche", "penalty", "augmented_lagrangian"])
@pytest.mark.parametrize("strain", ["small", "finite"])
def test_coefficient_of_the_speed(shared_tmp, strain, formulation):
    """A load step has the coefficient of the speed of the one before."""
    path, d = made(shared_tmp, "quadrilateral")
    static, kinetic, decay = 0.5, 0.2, 0.4
    said = {"friction": static, "kinetic_friction": kinetic, "friction_decay": decay, "formulation": formulation}
    found = ratios(dragged(path, d, strain, **said))
    speeds = np.array([0.0, 1.0, 1.0, 1.0, 1.0, 4.0, 4.0, 4.0])
    np.testing.assert_allclose(found[2:], kinetic + (static - kinetic) * np.exp(-decay * speeds), rtol=1e-6)


def test_the_coefficient_of_a_phase_is_its_own(shared_tmp):
    """Slow points are not remembered, and the phase after the next one begins at rest."""
    path, d = made(shared_tmp, "quadrilateral")
    case = dragged(path, d, friction=0.5, kinetic_friction=0.2, friction_decay=0.4)
    case.phases = [Phase("first", 0.6, 6), Phase("second", 0.2, 2, {"floor": "0.3 + 0.1*x"}), Phase("third", 0.2, 2)]
    found, slow = ratios(case), 0.2 + 0.3 * np.exp(-0.4)
    np.testing.assert_allclose(found[3:6], slow, rtol=1e-6)
    assert found[7] == pytest.approx(0.35, rel=1e-6)
    assert found[9] == pytest.approx(0.2 + 0.3 * np.exp(-1.6), rel=1e-6)
