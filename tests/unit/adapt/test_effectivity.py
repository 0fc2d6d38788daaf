"""What the change of the solution says of the estimate."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcontact.adapt.effectivity import (
    ALIKE,
    LEAST,
    SEEN,
    UNSEEN,
    YIELDING,
    Effectivity,
    Range,
    State,
    between,
    fallen,
    left_after,
    part_of,
)
from pcontact.adapt.passes import Pass
from pcontact.estimate.goal import GoalError
from pcontact.scene.target import Target


@pytest.mark.parametrize("part", [0.4, 0.9])
def test_estimates_that_are_the_same_part(part):
    """Errors e and e / 4, whose solutions differ by what Pythagoras says."""
    error = 0.03
    change = error * np.sqrt(1.0 - 1.0 / 16.0)
    assert part_of(part * error, 0.25 * part * error, change) == pytest.approx(part)


def test_what_says_nothing():
    """Estimates are not made smaller, nor larger without end; without a change there is nothing to see."""
    assert part_of(0.05, 0.02, 0.03) == 1.0
    assert part_of(0.05, 0.05, 1.0) == LEAST
    assert part_of(0.05, 0.02, 0.0) == part_of(0.0, 0.0, 0.1) == 1.0


def _between(steps):
    """The part that two passes show, with errors of their load steps; their solutions differ by 1, the estimate has
    fallen from 1 to 0.6."""
    u = SimpleNamespace(
        copy=lambda: u, setArray=lambda _: None, getArray=lambda readonly: np.zeros(2)  # fmt: skip
    )
    estimate = SimpleNamespace(norm=lambda _: 1.0, over_steps=0.6)
    run = SimpleNamespace(stepper=SimpleNamespace(u=u), error_estimate=estimate)
    return between(run, np.zeros((1, 2)), 0.5, steps)


def test_load_steps_that_change_as_much_as_meshes():
    """What they may have changed is no change of meshes; where it is much, nothing is said."""
    assert _between(0.0)[0] == pytest.approx(0.5 * np.sqrt(1.0 - ALIKE**2))
    assert _between(0.6)[0] == pytest.approx(_between(0.0)[0] / 0.8)
    assert _between(0.6)[1] == pytest.approx(0.8 * _between(0.0)[1])
    assert _between(0.8)[0] is None


def test_what_is_left_of_a_quantity():
    """Values whose errors are those of the squared estimates tell them; what was left does not go faster than that."""
    error, coarse = 0.08, State(100, 2, 2, 0.3, 1.0)
    fine = State(200, 2, 2, 0.15, 1.0 + 0.75 * error)
    assert left_after(coarse, fine) == pytest.approx(0.25 * error)
    by_chance = fine._replace(value=1.0)
    assert left_after(coarse._replace(left=-error), by_chance) == pytest.approx(-0.25 * error)


def test_errors_of_quantities_that_fall():
    """They fall with the squares, but not faster than with the best meshes, and as far as two meshes can tell."""
    coarse, fine = State(100, 2, 2, 0.3, 1.0), State(200, 2, 2, 0.01, 1.0)
    assert fallen(coarse, fine) == pytest.approx(0.25)
    assert fallen(coarse, fine._replace(estimate=0.3)) == fallen(coarse._replace(estimate=0.0), coarse) == ALIKE**2


@pytest.mark.parametrize("foretold, told", [(0.05, "dual problem"), (0.01, "dual problem and meshes")])
def test_a_change_that_no_dual_problem_has_foretold_counts(foretold, told):
    """From one mesh to the next a force grows by 0.04: with 0.01 left, 0.05 or 0.01 had been said before."""
    simulation = SimpleNamespace(scene=SimpleNamespace(plastic=False))
    seen = Effectivity(Target(0.1, "force:face"))

    def found(value, error, unknowns, estimate):
        simulation.problem = SimpleNamespace(space=SimpleNamespace(n_dofs=unknowns, degree=2, dim=2))
        simulation.error_estimate = SimpleNamespace(over_steps=estimate)
        return seen.error(simulation, GoalError(value, error, []))

    assert found(1.0, foretold, 100, 0.2) == (foretold, foretold) and seen.told == "dual problem"
    left, likely = found(1.04, 0.01, 200, 0.12)
    assert seen.told == told and likely == 0.01
    part = max(0.12**2 / 0.2**2, 0.25)
    assert left == pytest.approx(0.01 if foretold == 0.05 else 0.04 * part / (1.0 - part))
    # then the coarser mesh had what has changed, and what is left
    assert seen.unforeseen == pytest.approx(0.0 if foretold == 0.05 else 0.04)
    simulation.scene.plastic, seen = True, Effectivity(Target(0.1, "force:face"))
    assert found(1.0, foretold, 100, 0.2)[0] == pytest.approx(foretold / YIELDING**2)


@pytest.mark.parametrize("plastic", [False, True])
def test_the_part_is_that_of_meshes_once_two_have_been_compared(plastic):
    """Before it is a safety factor of the dimension and degree; meshes of another degree are not compared."""
    u = SimpleNamespace(copy=lambda: u, setArray=lambda _: None, getArray=lambda readonly: np.zeros(2))
    comm = SimpleNamespace(allreduce=lambda value, op=None: value)
    space = SimpleNamespace(degree=1, dim=2, comm=comm, mesh=SimpleNamespace(blocks=[]))
    simulation = SimpleNamespace(
        scene=SimpleNamespace(plastic=plastic), problem=SimpleNamespace(space=space), begin=None,
        stepper=SimpleNamespace(u=u), error_estimate=SimpleNamespace(norm=lambda _: 1.0, over_steps=1.0),
    )  # fmt: skip
    seen, watch = Effectivity(Target(0.1)), SimpleNamespace(time=1.0)
    part, known = seen.part(simulation, watch, 0.0)
    assert part == (YIELDING if plastic else 1.0) and known[:2] == UNSEEN[2, 1]
    space.degree, simulation.begin = 2, SimpleNamespace(at=lambda time: np.zeros((1, 2)))
    part, known = seen.part(simulation, watch, 0.0)
    assert part == (YIELDING if plastic else 1.0) and known[:2] == UNSEEN[2, 2]
    simulation.error_estimate.over_steps = 0.6
    part, known = seen.part(simulation, watch, 0.0)
    assert part == pytest.approx(0.8) and known.least == SEEN
    assert seen.unforeseen == 1.0
    # one whose estimate has not fallen counts until the next one
    part, known = seen.part(simulation, watch, 0.0)
    assert part == pytest.approx(0.36) and known.least == SEEN
    # as long as load steps may have changed as much as the mesh, what was seen before counts
    simulation.error_estimate.over_steps = 0.1
    assert seen.part(simulation, watch, 0.9)[0] == pytest.approx(0.36) and seen.unforeseen == 0.0
    space.degree = 1
    assert seen.part(simulation, watch, 0.0)[1].least == UNSEEN[2, 1][0]


def test_an_error_that_was_not_seen_on_a_mesh_counts_there():
    """What was expected of the next mesh is the same part of it, and so is what the estimate is."""
    done = Pass(100, 50, 2, 0.1, Range(0.8, 1.5, "", 2), {"mesh": 0.1, "loads": 0.01}, 0.11, part=0.8,
                next={"mesh": 0.05})  # fmt: skip
    done.at_least(0.05)
    assert (done.error, done.part, done.next["mesh"]) == pytest.approx((0.11, 0.8, 0.05))
    done.at_least(0.4)
    assert (done.error, done.part, done.next["mesh"]) == pytest.approx((0.41, 0.2, 0.2))
