"""Which load steps are tried, without a problem."""

import numpy as np
import pytest

from pcontact.stepping.schedule import Control, Schedule, filled, taken


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


@pytest.mark.parametrize("stops", [(), (0.3, 1.0), np.linspace(0.2, 2.0, 10)])
@pytest.mark.parametrize("count", [1, 4, 7, 31, 62, 100])
def test_load_steps_that_are_planned_fill_the_room_between_stops(count, stops):
    """As many as the schedule takes, without short remainders; one more that is planned takes more of them."""
    reached, _ = walk(Schedule(2.0, count, 1e-3, stops), lambda *_: 3)
    number = taken(2.0, count, stops).sum()
    assert number == len(reached)
    best = filled(2.0, count, stops)
    assert best >= count and taken(2.0, best, stops).sum() == number < taken(2.0, best + 1, stops).sum()


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


def test_iterations_say_how_long_load_steps_are():
    """Between the shortest and the longest; a load step of the wanted iterations keeps its length."""
    control = Control(longest=0.2)
    easy, _ = walk(Schedule(1.0, 20, 0.01, control=control), lambda a, b: 2)
    np.testing.assert_allclose(np.diff([0, *easy])[:4], [0.05, 0.1, 0.2, 0.2])
    right, _ = walk(Schedule(1.0, 20, 0.01, control=control), lambda a, b: Schedule.WANTED)
    np.testing.assert_allclose(np.diff([0, *right]), 0.05)
    hard, _ = walk(Schedule(1.0, 20, 0.01, control=control), lambda a, b: 100)
    np.testing.assert_allclose(np.diff([0, *hard])[:5], [0.05, 0.025, 0.0125, 0.01, 0.01])
    slow, _ = walk(Schedule(1.0, 20, 0.01, control=control), lambda a, b: 2 * Schedule.WANTED)
    assert slow[1] - slow[0] == pytest.approx(0.05 / np.sqrt(2.0))


def test_iterations_settle_where_a_load_step_takes_the_wanted_ones():
    """Iterations that grow with the length of the load step."""
    sizes = np.diff([0, *walk(Schedule(1.0, 4, 1e-3, control=Control(0.5)), lambda a, b: round(100 * (b - a)))[0]])
    np.testing.assert_allclose(sizes[4:-1], 0.08, rtol=0.1)


def test_planned_load_steps_do_not_follow_their_iterations():
    for iterations in (1, 100):
        reached, _ = walk(Schedule(1.0, 20, 0.01), lambda a, b, n=iterations: n)
        np.testing.assert_allclose(np.diff([0, *reached]), 0.05)


def test_a_stop_does_not_shorten_load_steps_that_follow_their_iterations():
    reached, _ = walk(Schedule(1.0, 5, 1e-3, [0.21], Control(0.2)), lambda a, b: 7)
    np.testing.assert_allclose(np.diff([0, *reached])[:3], [0.2, 0.01, 0.2])


def test_a_failed_load_step_is_cut_and_the_next_follow_their_iterations():
    reached, tried = walk(Schedule(1.0, 4, 1e-3, control=Control(0.5)), lambda a, b: 8 if b - a < 0.2 else None)
    assert tried[:2] == [0.25, 0.125]
    np.testing.assert_allclose(np.diff([0, *reached]), 0.125)


def test_load_steps_that_follow_iterations_go_on_as_they_were():
    """Time and length are all that the rest of a run depends on."""
    def works(a, b):
        return round(60 * (b - a)) + (20 if a < 0.3 else 0)

    whole, _ = walk(Schedule(1.0, 10, 1e-3, [0.5], Control(0.3)), works)
    first, second = (Schedule(1.0, 10, 1e-3, [0.5], Control(0.3)) for _ in range(2))
    done = []
    while len(done) < 6:
        done.append(first.next())
        first.accept(done[-1], works(first.time, done[-1]))
    second.resume(first.time, first.size)
    assert [*done, *walk(second, works)[0]] == whole


@pytest.mark.parametrize("count, parts", [(1, 9), (2, 10), (9, 9), (20, 20), (4, 12)])
def test_supports_turn_by_ten_degrees_at_most(count, parts):
    """A quarter of a turn: a load step is parted equally, and no more than it must be."""
    control = Control(turn=lambda begin, end: np.radians(90.0) * (end - begin))
    reached, _ = walk(Schedule(1.0, count, 1e-3, [0.25, 0.5], control) if count == 4 else
                      Schedule(1.0, count, 1e-3, control=control), lambda a, b: 3)  # fmt: skip
    np.testing.assert_allclose(np.diff([0, *reached]), 1.0 / parts)
    assert reached[-1] == 1.0


def test_a_load_step_that_is_wished():
    """Longer than planned, once; never beyond a stop or the end, nor shorter than the smallest."""
    schedule = Schedule(1.0, 10, 0.01, stops=[0.55])
    times = []
    for size in (0.1, 0.3, 0.4, 0.02, 5.0):
        schedule.wish(size)
        times.append(schedule.next())
        schedule.accept(times[-1], 3)
    assert times == pytest.approx([0.1, 0.4, 0.55, 0.57, 1.0]) and schedule.done
    for size in (0.0, -1.0, 0.005, np.nan, np.inf):
        with pytest.raises(ValueError, match="next load step: found .*; allowed: a number >= 0.01"):
            schedule.wish(size)
