"""Values over the steps of a deck."""

import pytest

from pcontact.importer.history import Amplitude, History


def test_a_ramp_over_one_step_has_no_table():
    history = History()
    history.ramp(0.0, 2.0, -3.0)
    assert history.most == -3.0 and history.amplitude(2.0) is None
    assert history.amplitude(4.0) == ((0.0, 0.0), (2.0, 1.0))


def test_values_go_on_from_step_to_step():
    history = History()
    history.ramp(0.0, 1.0, 4.0)
    history.ramp(3.0, 4.0, 2.0)
    assert history.amplitude(4.0) == ((0.0, 0.0), (1.0, 1.0), (3.0, 1.0), (4.0, 0.5))


def test_an_amplitude_is_cut_at_the_end_of_its_step():
    history, wave = History(), Amplitude([(0.0, 1.0), (1.0, 0.0), (5.0, 4.0)])
    history.follow(0.0, 2.0, 10.0, wave)
    assert history.key() == ((0.0, 10.0), (1.0, 0.0), (2.0, 10.0))
    history.follow(2.0, 3.0, 10.0, wave)
    assert history.points[-1] == (3.0, 0.0) and history.points[-2][1] == 10.0
    assert Amplitude([(0.0, 0.0), (9.0, 9.0)], total=True).at(4.5) == pytest.approx(4.5)


def test_what_does_not_change_is_one_point():
    history = History()
    history.jump(0.0, 1.0, 5.0)
    history.ramp(1.0, 2.0, 5.0)
    assert history.key() == ((0.0, 5.0),) and history.amplitude(2.0) == ((0.0, 1.0),)
