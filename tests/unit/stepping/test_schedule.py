"""Which load steps are tried, without a problem."""

import numpy as np
import pytest

from pcontact.stepping.schedule import Schedule


def walk(schedule, works):
    """Times that are reached, and tried, when `works(start, target)` gives the iterations or None."""
    reached, tried = [], []
    while not schedule.done:
        target = schedule.next()
        assert target > schedule.time
        tried.append(target)
        iterations = works(schedule.time, target)
        if iterations is None:
            if not schedule.cut(target):
                break
        else:
            schedule.accept(target, iterations)
            reached.append(target)
        assert len(tried) < 1000
    return reached, tried


@pytest.mark.parametrize("count", [1, 2, 3, 7, 10, 49, 1000])
@pytest.mark.parametrize("end", [1.0, 0.3, 1e-6, 7e5])
def test_equal_steps(count, end):
    if count == 1000:
        count = 333
    reached, _ = walk(Schedule(end, count, 0.0), lambda a, b: 3)
    np.testing.assert_allclose(reached, end * np.arange(1, count + 1) / count, rtol=1e-12)
    assert reached[-1] == end


def test_stops_are_met_exactly():
    reached, _ = walk(Schedule(1.0, 4, 1e-3, [0.1, 0.3, 1.0, 2.0, 0.0, -1.0]), lambda a, b: 3)
    assert {0.1, 0.3, 1.0} <= set(reached)
    assert np.diff([0, *reached]).max() <= 0.25 + 1e-12


def test_a_stop_next_to_a_step_does_not_make_a_tiny_step():
    reached, _ = walk(Schedule(1.0, 10, 0.0, [0.3, 0.7 + 1e-9]), lambda a, b: 3)
    assert len(reached) == 10 and np.diff([0, *reached]).min() > 0.09


def test_cut_back_and_growth():
    """A step of more than 0.1 fails; then easy steps grow to the size that was asked for, not beyond."""
    reached, tried = walk(Schedule(1.0, 2, 1e-3), lambda a, b: 3 if b - a <= 0.1 or a >= 0.3 else None)
    sizes = np.diff([0, *reached])
    assert reached[-1] == 1.0 and sizes.max() <= 0.5 + 1e-12
    assert tried[:4] == [0.5, 0.25, 0.125, 0.0625] and reached[0] == 0.0625
    assert sizes.max() > 0.2


def test_hard_steps_do_not_grow():
    hard = Schedule.EASY + 1
    state = {"failed": False}

    def works(start, target):
        if not state["failed"]:
            state["failed"] = True
            return None
        return hard

    reached, _ = walk(Schedule(1.0, 2, 1e-3), works)
    np.testing.assert_allclose(reached, [0.25, 0.5, 0.75, 1.0])


def test_the_smallest_step_ends_the_run():
    schedule = Schedule(1.0, 4, 0.05)
    reached, tried = walk(schedule, lambda a, b: 2 if b <= 0.5 else None)
    np.testing.assert_allclose(reached[:2], [0.25, 0.5])
    assert not schedule.done and schedule.time < 0.51
    # nothing shorter than the smallest step was tried
    assert min(b - 0.5 for b in tried if b > 0.5) >= 0.05


def test_a_short_step_to_a_stop_does_not_shrink_the_others():
    """The remainder before a stop is short by itself; that is no reason to go on with short steps."""
    reached, _ = walk(Schedule(1.0, 4, 1e-3, [0.26]), lambda a, b: 3)
    sizes = np.diff([0, *reached])
    np.testing.assert_allclose(sizes[:3], [0.25, 0.01, 0.25])
