"""What facets do that stand for curved surfaces, against what is left of it on finer meshes."""

from functools import partial

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases import rings
from drivers.error_norms import bulk_error
from meshes import rings as ring_mesh
from pcontact import build
from pcontact.adapt import secondary
from pcontact.adapt.passes import Watch
from pcontact.adapt.secondary import FINER_SEE, answers, change_to, of_facets
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime.options import Options
from pcontact.scene.target import Target
from pcontact.simulation import Simulation

DELTA = 6e-4


@pytest.mark.parallel
def test_rings_with_interference(shared_tmp):
    """Six curved facets in a quarter: 2 % of the energy norm are theirs on cells that are halved twice, whose own error
    is a tenth of that, and a sixth of the pressure, where those on the contact are halved twice more. It is more than
    what they change on the first mesh, and is named."""
    path = make_mesh(ring_mesh, shared_tmp / "rings.msh", n=6, cell="triangle", order=2, delta=DELTA)
    scene = rings.ring_scene(path, 2, 0.0, pressure=0.0, gamma0=None)
    exact = partial(rings.exact, constants=rings.ring_constants(0.0, DELTA))
    scene.output.estimate = True
    first = Simulation(scene)
    watch = Watch(first)
    assert first.run(None, [watch], keep=True)
    first.close()
    targets = Target(0.1), Target(0.1, "pressure:circle")
    smooth = answers(first, secondary.smooth_facets(scene), Target(0.1, "energy,pressure:circle"))
    found, pressure = (FINER_SEE["curved_facets"] * change_to(first, smooth[one.of], one, watch.record)
                       for one in targets)  # fmt: skip
    finer, balance = first.mesh, Balance(*build.balance(scene, Options()))
    for cuts in (4, 0, 0):
        start = np.cumsum([0] + [len(block.nodes) for block in finer.blocks])
        more = np.full(start[-1], cuts)
        for some in (part for name in rings.SIDES["inner"] for part in finer.facet_groups.get(name, [])):
            more[start[some.block] + some.cells] = max(cuts, 2)
        finer = refine(finer, more, (), balance).mesh
    last = Simulation(scene, mesh=finer)
    assert last.run(None, [], keep=True)
    left = bulk_error(last.problem.space, last.problem.bulk.constants, last.stepper.u, exact).energy
    state = last.problem.contacts[0].state(last.stepper.u)
    off = state["weight"] @ (state["pressure"] - rings.interface_pressure(0.0, DELTA)) ** 2
    off = np.sqrt(last.comm.allreduce(float(off)))
    for one in (first, last):
        one.free()
    assert left < found < 1.3 * left
    assert off < pressure < 3.0 * off


def quarter(shared_tmp, n, cell="triangle", order=1):
    path = make_mesh(ring_mesh, shared_tmp / f"quarter{n}.msh", n=n, cell=cell, order=order)
    return rings.ring_scene(path, 2, 0.0, gamma0=None)


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_rounded_cells_have_their_middles_on_circles(shared_tmp, cell):
    """Nodes of all four circles, two of them free, and no others but those that follow; the straight mesh stays."""
    run = Simulation(quarter(shared_tmp, 6, cell))
    straight = run.mesh
    before = straight.points.copy()
    mesh = secondary.rounded(run.problem.space)
    assert not straight.curved and np.array_equal(before, straight.points) and secondary.OUTER not in mesh.facet_groups
    radius = np.linalg.norm(mesh.points, axis=1)
    was = np.linalg.norm(before, axis=1)
    for circle in (rings.SMALL, rings.MIDDLE, rings.LARGE):
        chords = (was < (1.0 - 1e-4) * circle) & (was > 0.985 * circle)
        assert run.comm.allreduce(int(chords.sum())) >= 6
        assert np.allclose(radius[chords], circle, rtol=3e-4, atol=0.0)
    run.free()


@pytest.mark.parallel
def test_straight_facets_of_free_and_loaded_surfaces_count(shared_tmp):
    """Six chords in a quarter: what they leave of the energy norm on fine meshes is more than what they change on the
    first one, and is named."""
    scene = quarter(shared_tmp, 6)
    scene.output.estimate = True
    first = Simulation(scene)
    assert first.run(None, [], keep=True)
    found = of_facets(first, scene, Target(0.1), {}) / first.error_estimate.last["energy_norm"]
    finer = first.mesh
    for _ in range(3):
        more = np.full(sum(len(block.nodes) for block in finer.blocks), 2)
        finer = refine(finer, more, (), Balance(*build.balance(scene, Options()))).mesh
    last = Simulation(scene, mesh=finer)
    assert last.run(None, [], keep=True)
    exact = partial(rings.exact, constants=rings.ring_constants())
    error = bulk_error(last.problem.space, last.problem.bulk.constants, last.stepper.u, exact)
    left = error.energy / error.energy_of_exact
    for one in (first, last):
        one.free()
    assert 0.01 < found < left < FINER_SEE["straight_facets"] * found
