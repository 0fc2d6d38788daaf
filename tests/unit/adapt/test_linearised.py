"""What other settings of contacts change, to first order and by a run of their own."""

from functools import partial

import pytest

from drivers.cases import rings
from meshes import rings as rings_mesh
from pcontact.adapt import linearised, variants
from pcontact.adapt.watch import Watch
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Target
from pcontact.simulation import Simulation

COMM = MPI.COMM_WORLD


@pytest.mark.parallel
def test_first_order_is_close_to_a_run(shared_tmp):
    """Facets that are too straight, in the energy norm, of a force and of a pressure; a rule of a higher degree changes
    next to nothing."""
    path = shared_tmp / "rings.msh"
    on_root(COMM, partial(rings_mesh, path, n=4, cell="triangle", order=2))
    scene = rings.ring_scene(path, 2, 0.0, gamma0=None)
    scene.output.estimate = True
    simulation = Simulation(scene, COMM)
    watch = Watch(simulation)
    assert simulation.run(None, [watch], keep=True)
    names = ("quadrature", "curved_facets")
    simulation.close()
    for of, close in (("energy", 0.02), ("force:circle", 0.1), ("pressure:circle", 0.02)):
        target = Target(0.1, of)
        found = linearised.changes(simulation, target, watch, names)
        full = variants.difference(simulation, variants.smooth_facets(scene), target, watch)
        assert found["curved_facets"] == pytest.approx(full, rel=close), of
        assert 0.0 < abs(found["quadrature"]) < 1e-3 * abs(full)
    simulation.free()
