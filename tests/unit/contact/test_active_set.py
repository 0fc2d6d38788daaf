"""What opens where a contact recedes, without a mesh."""

from dataclasses import replace

import numpy as np
import pytest

from pcontact.assembly.item import Item
from pcontact.contact.active_set import AGAIN, BORNE, still_closed, turned, weakest
from pcontact.runtime.petsc import MPI
from pcontact.solve.problem import ActiveSets
from tests.support.few_unknowns import FewUnknowns, solved

SELF = MPI.COMM_SELF


def test_the_edge_is_found_at_once():
    """Pressures next to an edge that is too far out by d: what opens ends where it should, and not half way there."""
    x, d = (np.arange(4000) + 0.5) / 4000, 0.1
    tau = -(np.sqrt(x) - 0.5 * d / np.sqrt(x))
    left = still_closed(np.ones(4000, dtype=bool), tau, np.full(4000, 1.0 / 4000), SELF)
    assert np.all(left[x > d + 0.005]) and not np.any(left[x < d - 0.005])
    assert AGAIN == 2.0 and x[tau > 0.0].max() == pytest.approx(d / 2, abs=1e-3)


def test_what_bears_much_stays():
    """However much opens, of equal pressures none opens with it, and of different ones those that bear little."""
    area = np.full(100, 0.01)
    assert not weakest(np.ones(100), area, 10.0, SELF).any()
    pressure = np.linspace(0.01, 1.0, 100)
    opens = weakest(pressure, area, 10.0, SELF)
    assert 0.8 * BORNE < pressure[opens].sum() / pressure.sum() <= BORNE
    assert not weakest(pressure, area, 0.0, SELF).any() and not weakest(0.0 * pressure, area, 1.0, SELF).any()
    assert weakest(np.empty(0), np.empty(0), 1.0, SELF).shape == (0,)


@pytest.mark.parallel
def test_ranks_agree_on_the_edge():
    """Each rank has some of the points: those of all open that would on one."""
    comm = MPI.COMM_WORLD
    pressure = np.linspace(0.001, 1.0, 60)
    mine = np.arange(60) % comm.size == comm.rank
    one = weakest(pressure, np.ones(60), 12.0, SELF)
    assert 0 < one.sum() <= 12
    np.testing.assert_array_equal(weakest(pressure[mine], np.ones(int(mine.sum())), 12.0, comm), one[mine])


def test_turned():
    closed, paired = np.array([1, 1, 0, 0, 0], dtype=bool), np.array([1, 1, 1, 1, 0], dtype=bool)
    tau, area = np.array([-1.0, 1.0, -1.0, 1.0, -1.0]), np.array([1.0, 2.0, 4.0, 8.0, 16.0])
    assert turned(closed, paired, tau, area).tolist() == [3.0, 2.0, 4.0, 1.0]


class Bed(Item):
    """Springs under the nodes of a beam, which bear pressure only."""

    name = "pair"

    def __init__(self, n, stiffness):
        self.stiffness, self.area = stiffness, np.ones(n)
        self.closed = np.ones(n, dtype=bool)

    def _allowed(self, rule):
        return np.ones(len(self.area), dtype=bool) if rule.opened is None else ~rule.opened

    def pressures(self, w, rule):
        """Forces on the beam, upwards."""
        return np.where(self._allowed(rule), self.stiffness * np.maximum(-w, 0.0), 0.0)

    def slopes(self, w, rule):
        """Their derivatives."""
        self.closed = self._allowed(rule) & (w <= 0.0)
        return np.diag(np.where(self.closed, self.stiffness, 0.0))

    def closed_area(self):
        return float(self.closed.sum())

    def turned(self, u):
        return turned(self.closed, np.ones_like(self.closed), u.getArray(readonly=True), self.area)

    def recede(self, u, rule):
        return replace(rule, opened=~still_closed(self.closed, u.getArray(readonly=True), self.area, SELF))


class Beam(FewUnknowns):
    """Half a beam without weight on a bed of springs, pressed down in the middle (the first node)."""

    def __init__(self, n, stiffness):
        bend = np.diff(np.eye(n + 1), 2, axis=0)
        # the slope is zero in the middle: what is beyond the first node mirrors the second one
        bend = np.vstack([2.0 * (np.eye(n)[1] - np.eye(n)[0]) / np.sqrt(2.0), bend[:, :n][:-1]])
        self._bend, self._force = bend.T @ bend, np.zeros(n)
        self._force[0] = -1.0
        super().__init__(n, None, None, 1.0, lambda u: np.abs(self._bend) @ np.abs(u) + stiffness * np.abs(u))
        self.others = [Bed(n, stiffness)]
        self.active = ActiveSets(self.space, self.others, False)

    def residual(self, u, f, rules=None):
        w = u.getArray(readonly=True)
        f.setArray(self._bend @ w - self._force - self.others[0].pressures(w, (rules or self.active.by_law)[0]))

    def tangent(self, u, rules=None, predicted=False):
        self._tangent = lambda w: self._bend + self.others[0].slopes(w, (rules or self.active.by_law)[0])
        super().tangent(u, rules, predicted)


@pytest.mark.parametrize("stiffness", [1e-4, 1e-3, 1e-2, 1e-1])
def test_a_beam_lifts_off(stiffness):
    """It takes hardly more iterations than the edge does, where the law alone has false contacts travel outwards."""
    n = 200
    result, w = solved(Beam(n, stiffness), np.zeros(n))
    without, other = solved(Beam(n, stiffness), np.zeros(n), newton_without="opening")

    assert result.converged and result.newton <= 8
    # half a wave of a beam on springs, (E I / k)^(1/4) pi / sqrt(2) from the middle, is in contact
    assert (w <= 0.0).sum() == pytest.approx(np.pi / np.sqrt(2.0) * stiffness**-0.25, abs=2.0)
    assert not np.any(w[1:] < w[:-1]) and -stiffness * w[w < 0.0].sum() == pytest.approx(1.0)
    assert not without.converged or without.newton > result.newton
