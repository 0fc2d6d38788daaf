"""Whether the forces on a loose body balance, and whether it falls."""

import numpy as np
import pytest

from meshes import two_blocks
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation
from pcontact.solve.convergence import VAIN, Balance
from pcontact.space.modes import free_motions

WORLD = MPI.COMM_WORLD


@pytest.fixture
def simulation(shared_tmp):
    """Two blocks with a gap, the upper of which may move up and down."""
    on_root(WORLD, lambda: two_blocks(shared_tmp / "b.msh", 2, 2, 2, gap=0.02))
    scene = Scene(
        mesh=MeshSpec(shared_tmp / "b.msh"),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="pair")],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_left", [0.0, "free"])],
        output=Output(fields=False),
    )
    one = Simulation(scene, WORLD)
    yield one
    one.close()


@pytest.mark.parallel
def test_balance(simulation, monkeypatch):
    """A body falls where the stabilisation alone answers its load; it rests where nothing pulls, or nothing helps, and
    does neither for a force that is nothing beside those that its supports bear."""
    problem = simulation.problem
    space = problem.space
    problem.items[1].detect(space.vector(), 0.0)
    balance = Balance(problem, free_motions(space, problem.conditions.supports))
    u, y, f = (space.vector() for _ in range(3))
    balance.begin(u)
    number = problem.space.mesh.component_names.index("upper")
    upper = space.component[space.owned_local] == number
    assert balance.rests(u, f) and not balance.falls(u, y, f).any()
    force, way = (vector.getArray().reshape(-1, 2) for vector in (f, y))
    force[upper, 1] = -1.0
    # the same way at all nodes is that of the sum of the forces
    total = [WORLD.allreduce(float(values.sum())) for values in (force[upper, 1], problem.stabilisation[upper])]
    way[upper, 1] = total[0] / total[1]
    # their norms are known from before, as PETSc sees it
    for vector in (f, y):
        vector.stateIncrease()
    falls = balance.falls(u, y, f)
    assert falls[number] and falls.sum() == 1
    with monkeypatch.context() as loaded:
        loaded.setattr(problem.forces, "by_component", lambda u: np.full(space.mesh.n_components, 1e8))
        assert balance.rests(u, f) and not balance.falls(u, y, f).any()
    # something else bears nine tenths of it
    y.scale(0.1)
    assert not balance.falls(u, y, f).any()
    # iterations that do not help
    assert [balance.rests(u, f) for _ in range(VAIN + 1)] == [False] * VAIN + [True]
    balance.begin(u)
    for _ in range(3 * VAIN):
        assert not balance.rests(u, f)
        f.scale(0.1)
    f.zeroEntries()
    assert balance.rests(u, f)
    # forces of another body, or those that balance each other, say nothing
    f.getArray().reshape(-1, 2)[~upper] = 1.0
    assert balance.rests(u, f) and not balance.falls(u, y, f).any()
