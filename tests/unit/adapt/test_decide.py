"""What the next mesh is made for."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcontact.adapt.decide import REACHED, SPENT, TRUST, Decision
from pcontact.adapt.effectivity import Range
from pcontact.adapt.mark import LEAP, SLOW_GROWTH, Cuts
from pcontact.adapt.passes import Pass
from pcontact.adapt.settings import AIM
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Target


class Recorder(SimpleNamespace):
    """Stands for the refining of a mesh of tetrahedra: remembers what it is asked for."""

    def step(self, space, squares, wanted, most, divided):
        self.wanted, self.most = wanted, most
        return Cuts(np.ones(1, dtype=np.int64), wanted, 10.0)


def asked(second, parts=(1.0, 1.0), first=0.4):
    """Of the refining after two passes, the second one of an error: the first had 0.4, and 0.1 was expected. `parts` of
    the error are what their estimates were taken for."""
    known = Range(1.0, 2.0, "", 3)
    passes = [Pass(100, 50, 2, error, known, {"mesh": error, "algebraic": 0.0}, error, seconds=1.0, memory=1e8)
              for error in (first, second)]  # fmt: skip
    passes[0].part, passes[1].part = parts
    passes[0].next = {"unknowns": 100.0, "mesh": 0.1, "load_steps": 1, "degree": 2}
    refining = Recorder(whole=False)
    settings = SimpleNamespace(staying=(), falling=("mesh",), steps=1, goal=0.01, balance=lambda *_: None,
                               follow=lambda _: None)  # fmt: skip
    decision = Decision(Target(0.01), settings, passes, refining, MPI.COMM_SELF)
    simulation = SimpleNamespace(problem=SimpleNamespace(space=SimpleNamespace(dim=3)))
    status, _ = decision.next(simulation, SimpleNamespace(squares=np.ones(1)), passes[-1])
    assert status is None
    return refining


@pytest.mark.parametrize("confirmed, status", [(True, REACHED), (False, None)])
def test_a_target_that_cells_reach_as_they_cancel_takes_another_mesh(confirmed, status):
    """The next mesh tells whether the dual problem of the first one has missed something."""
    parts = {"mesh": 0.0195, "algebraic": 0.0}
    done = Pass(100, 50, 2, 0.01, Range(0.4, 2.0, "", 2), parts, 0.0195, seconds=1.0, memory=1e8, quantity={},
                of="force:face", confirmed=confirmed)  # fmt: skip
    refining = Recorder(whole=False)
    settings = SimpleNamespace(staying=(), falling=("mesh",), steps=1, goal=0.02, balance=lambda *_: None,
                               follow=lambda _: None)  # fmt: skip
    decision = Decision(Target(0.02, "force:face"), settings, [done], refining, MPI.COMM_SELF)
    simulation = SimpleNamespace(problem=SimpleNamespace(space=SimpleNamespace(dim=2)))
    assert decision.next(simulation, SimpleNamespace(squares=np.ones(1)), done)[0] == status


def test_a_mesh_that_has_brought_much_less_than_expected_is_followed_by_a_trial():
    """As where cells have to become smaller toward an edge."""
    assert asked(0.12).most > LEAP and asked(0.25).most == SLOW_GROWTH


def test_estimates_that_are_taken_for_another_part_of_the_error_are_compared_as_they_are():
    """An error of 0.06 instead of 0.1 only since the estimate is taken for all of it, and not for six tenths."""
    assert asked(0.06, parts=(0.6, 1.0)).wanted == pytest.approx(0.085 * 0.1 / 0.06)
    assert asked(0.13, parts=(0.6, 1.0)).most == SLOW_GROWTH and asked(0.13, parts=(1.0, 1.0)).most > LEAP


def test_what_has_fallen_as_expected_is_trusted():
    """What has not is another rate, down to that of singular points."""
    assert asked(0.1).wanted == pytest.approx(0.085)
    assert asked(0.25).wanted == pytest.approx(0.034 ** (1.0 / TRUST))


def test_an_error_as_large_as_the_solution_says_nothing():
    """What was promised of the next mesh is no rate."""
    assert asked(0.25, first=1.5).wanted == pytest.approx(0.034 ** (1.0 / TRUST))


@pytest.mark.parametrize("error, status", [(0.5, None), (0.07, SPENT)])
def test_the_best_that_facets_leave_is_reached(error, status):
    """Facets alone are more than the target: meshes are made for as much again, and then there is no other one."""
    parts = {"mesh": error - 0.04, "algebraic": 0.0, "curved_facets": 0.04}
    done = Pass(100, 50, 2, error, Range(1.0, 2.0, "", 3), parts, error, seconds=1.0, memory=1e8)
    refining = Recorder(whole=False)
    settings = SimpleNamespace(staying=("curved_facets",), falling=("mesh",), steps=1, goal=0.02,
                               balance=lambda *_: None, follow=lambda _: None)  # fmt: skip
    decision = Decision(Target(0.02), settings, [done], refining, MPI.COMM_SELF)
    simulation = SimpleNamespace(problem=SimpleNamespace(space=SimpleNamespace(dim=3)))
    assert decision.next(simulation, SimpleNamespace(squares=np.ones(1)), done)[0] == status
    assert decision.aim == pytest.approx(0.08)
    if status is None:
        assert refining.wanted == pytest.approx((AIM * 0.04 / 0.46) ** (1.0 / TRUST))
    else:
        assert decision.why.endswith("alone make 4 %, which no mesh takes away")
