"""Local problems of cells that have yielded."""

import numpy as np
import pytest

from drivers.cases import thick_cylinder
from pcontact.estimate.stress import softening
from pcontact.simulation import Simulation


@pytest.mark.parametrize("kinematics", ["plane", "axisymmetric"])
def test_secant_moduli(shared_tmp, kinematics):
    """After one load step the stress that they give is on the yield surface."""
    path = thick_cylinder.make(shared_tmp / f"{kinematics}.msh", kinematics, "triangle", 2, 2)
    scene = thick_cylinder.scene(path, kinematics, 2, (0.16,), steps=1)
    simulation = Simulation(scene)
    assert simulation.run(None, [])
    space, bulk = simulation.problem.space, simulation.problem.bulk
    nodal = space.local.gather(simulation.stepper.u)
    state, (_, mu) = bulk.states[0], bulk.constants[0]
    points = np.array([[0.2, 0.2], [0.6, 0.2]])
    found = softening(space, bulk, 0, slice(None), nodal, points)
    yielded = state.p > 0.0
    assert yielded.any() and not yielded.all() and found.near.shape == (2,)
    assert (found.part[~yielded] == 0.0).all()
    part = found.part[yielded]
    assert (part > 0.0).all() and (part < 1.0).all()
    # |eps_p| is the part of |eps_dev|, and sigma_dev = 2 mu (1 - part) eps_dev
    size = np.linalg.norm(state.values[yielded][:, :-1], axis=1)
    radius = np.sqrt(2.0 / 3.0) * thick_cylinder.Cylinder().yield_stress
    assert 2.0 * mu * size * (1.0 - part) / part == pytest.approx(radius, rel=1e-6)
    assert found.moduli[3, 3] == pytest.approx(2.0 * mu) and found.moduli[:3].sum(axis=0) == pytest.approx(0.0)
    simulation.free()
