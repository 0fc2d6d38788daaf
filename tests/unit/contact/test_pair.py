"""Points that close in a Newton step and are kept open in the next one."""

import numpy as np
import pytest

from drivers.studies._press import make_scene
from meshes import ball_on_block
from pcontact.assembly.item import LAW
from pcontact.contact.law import SLIP, STICK
from pcontact.contact.pair import RIGHT, ContactPair, contact_pair
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.material.elastic import lame
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact
from pcontact.simulation import Simulation
from tests.support.small import blocks_file, make_space, vector_of

COMM = MPI.COMM_WORLD
GAP, EDGE, DEPTH = 0.2, 0.25, 0.5
CONSTANTS = [lame(1000.0, 0.3)] * 2
pytestmark = pytest.mark.parallel


@pytest.fixture
def space(shared_tmp):
    """Two blocks, one above the other."""
    path = shared_tmp / "blocks.msh"
    if COMM.rank == 0:
        blocks_file(path, "quadrilateral", [30, 1], [40, 1], gap=GAP)
    COMM.Barrier()
    return make_space(COMM, path, ["lower", "upper"])


def item_of(space, **law):
    """The pair, its partners found where nothing is displaced."""
    contact = Contact("upper_bottom", "lower_top", theta=0.0, search="closest_point", **law)
    source = source_surface(space, contact.source, CONSTANTS, contact.quadrature)
    target = target_surface(space, contact.target)
    item = contact_pair(space, contact, source, target, 1.0)
    item.detect(space.vector(), 1.0)
    return item


def with_gap(space, slope, start):
    """Displacement with a gap of start + slope x: shear without normal stress."""
    u = np.zeros((space.n_owned, space.dim))
    x = space.points[space.owned_local, 0]
    u[:, 1] = np.where(space.component[space.owned_local] == 1, start + slope * x - GAP, 0.0)
    return vector_of(space, u)


def total(values):
    """Sum over the ranks."""
    return COMM.allreduce(float(np.sum(values)))


def test_what_closes_last_is_deferred(space):
    """Closed up to an edge, then everywhere, equally deep: the last third of what closes is farthest from the edge."""
    item = item_of(space)
    first, last = with_gap(space, 1.0, -EDGE), with_gap(space, 0.0, -DEPTH)
    assert np.all(item.pairing.paired)
    out = np.zeros((space.n_owned, space.dim))
    item.residual(last, out)
    force = total(np.abs(out[:, 1]))
    rule = item.defer(first, last, LAW)
    deferred, x = rule.waiting, item.source.x[:, 0]
    edge = EDGE + RIGHT * (1.0 - EDGE)
    assert np.all(deferred[x > edge + 0.02]) and not np.any(deferred[x < edge - 0.02])
    rest = np.zeros_like(out)
    item.residual(last, rest, rule)
    # the pressure is the same everywhere
    assert total(np.abs(rest[:, 1])) == pytest.approx(edge * force, rel=0.02)
    again = np.zeros_like(out)
    item.residual(last, again)
    np.testing.assert_array_equal(again, out)


def test_nothing_is_deferred_without_an_edge(space):
    """Nothing closed before, as much opens as closes, a few points close, no separation."""
    item, everywhere, edge = item_of(space), with_gap(space, 0.0, -DEPTH), with_gap(space, 1.0, -EDGE)
    cases = {
        "first contact": (with_gap(space, 1.0, 0.1), everywhere),
        "rocking": (with_gap(space, 1.0, -0.5), with_gap(space, -1.0, 0.5)),
        "opening": (everywhere, edge),
        "nothing": (edge, edge),
        "a little": (edge, with_gap(space, 1.0, -EDGE - 0.01)),
    }
    for name, (first, last) in cases.items():
        assert item.defer(first, last, LAW) is None, name
    assert item_of(space, bilateral=True).defer(edge, everywhere, LAW) is None
    assert item_of(space, tresca=1.0).defer(edge, everywhere, LAW) is None


@pytest.mark.parametrize(("friction", "status"), [(10.0, STICK), (1e-6, SLIP)])
def test_all_sticks_meanwhile_where_most_does(space, friction, status):
    item = item_of(space, friction=friction)
    first, last = with_gap(space, 1.0, -EDGE), with_gap(space, 0.1, -0.3)
    item.tangent(first)
    rule = item.defer(first, last, LAW)
    assert rule.stick == (status == STICK)
    item.tangent(last, rule)
    assert set(item._status[~rule.waiting]) <= {status}


@pytest.mark.slow
@pytest.mark.parallel(2)
def test_sooner_at_the_same_force(shared_tmp, monkeypatch):
    """A ball on a block: the area in contact is found at once, and not halved towards."""
    path, found = shared_tmp / "ball.msh", {}
    if COMM.rank == 0:
        ball_on_block(path, unknowns=100_000, halvings=1)
    COMM.Barrier()
    scene = make_scene(path, "elastic")
    for name in ("deferred", "not"):
        if name == "not":
            monkeypatch.setattr(ContactPair, "defer", lambda *_: None)
        simulation, records = Simulation(scene), []
        assert simulation.run(None, [Keep(records)])
        simulation.close()
        found[name] = *records[-1], simulation.newton.norms
    (count, force, norms), (most, expected, others) = found["deferred"], found["not"]
    assert count <= most
    # the first iteration brings the ball half way, the second closes too much, the third begins with less of it
    np.testing.assert_allclose(norms[:3], others[:3], rtol=1e-6)
    assert norms[3] < 0.5 * others[3]
    np.testing.assert_allclose(force, expected, rtol=1e-6, atol=1e-8)


class Keep(Observer):
    """Observer: Newton iterations and the force of a step."""

    def __init__(self, rows):
        self.rows = rows

    def step(self, step, u, record):
        """Keep them."""
        self.rows.append((step.newton, record["contacts"]["ball-block"]["force"]))

    def cut(self, target, outcome):
        """No attempt fails here."""

    def end(self, converged):
        """Nothing is left to do."""
