"""Warnings of load steps name what is not done already."""

from types import SimpleNamespace

import pytest

from pcontact.stepping.record import PARTED, Recorder


def recorder(contacts=(), verifies=True, inertia=None):
    """A recorder of a problem that has contacts (theta of each), whose items verify their partners or not."""
    methods = [SimpleNamespace(has_traction=True, theta=theta) for theta in contacts]
    contacts = [SimpleNamespace(name="c", overlap=0.0, sinks=False, method=method) for method in methods]
    one = Recorder.__new__(Recorder)
    one._told, one._parted = set(), PARTED
    one._problem = SimpleNamespace(
        contacts=contacts, others=[SimpleNamespace(verifies=verifies)], features=SimpleNamespace(inertia=inertia)
    )
    return one


@pytest.mark.parametrize(("partners", "verifies", "named"), [
    (None, True, True), ({"searches": 1}, True, False), (None, False, False),
])  # fmt: skip
def test_points_that_are_lost_name_the_check_where_it_is_left_out(partners, verifies, named, caplog):
    step = SimpleNamespace(time=1.0, partners=partners)
    recorder([0.0], verifies)._warn_of_lost(step, {"c": {"passed": 1, "left": 0}})
    assert ("-contact_search_again" in caplog.text) == named and "smaller load steps" in caplog.text


def test_partners_that_change_more_than_is_asked_are_told_once(caplog):
    one = recorder([0.0])
    for time in (1.0, 2.0):
        step = SimpleNamespace(time=time, partners={"searches": 1, "change": 0.03, "unsettled": ["c"]})
        one._warn_of_lost(step, {"c": {"passed": 0, "left": 0}})
    (line,) = caplog.messages
    assert "time 1: contact c" in line and "3 %" in line and "-contact_partner_rtol" in line


@pytest.mark.parametrize(("theta", "damps", "controls"), [(0.0, False, False), (1.0, True, True)])
def test_energy_from_nowhere_names_what_is_not_chosen(theta, damps, controls, caplog):
    inertia = SimpleNamespace(damps=damps, controls=controls)
    energy = {"kinetic": 1.0, "defect": 0.0, "numerical": -0.5}
    recorder([theta], inertia=inertia)._warn_of_energy(2.0, {"energy": energy, "contacts": {}})
    assert "come from nowhere" in caplog.text and "smaller cells" in caplog.text
    for word in ("theta = 1", "hht", "step_error"):
        assert (word in caplog.text) != damps
