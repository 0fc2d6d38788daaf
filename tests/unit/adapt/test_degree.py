"""Which degree reaches a target with less work, and the pass from which the loop goes on."""

from pcontact.adapt.degree import Degree, Tried, cheaper
from pcontact.adapt.known import Range
from pcontact.adapt.passes import Pass


def done(unknowns, degree, mesh, entries):
    known = Range(1.0, 2.0, "", 2)
    return Pass(unknowns, unknowns, degree, mesh, known, {"mesh": mesh}, expected=mesh, entries=entries)


PASSES = done(100, 1, 0.1, 1e3), done(300, 2, 0.05, 6e3)


def test_the_degree_that_takes_fewer_entries():
    """A smooth solution is that of degree 2, a target that is nearly reached that of degree 1."""
    assert cheaper(*PASSES, 0.01)["degree"] == 2
    near = cheaper(*PASSES, 0.09)
    assert near["degree"] == 1 and near["entries"]["2"] == 6e3


def test_both_degrees_are_tried_once():
    lower, higher = (Tried("mesh", "watch", one, None, "step") for one in PASSES)
    for error, best in ((0.01, higher), (0.09, lower)):
        degree = Degree(None)
        assert degree.is_open
        degree.try_higher(lower)
        assert degree.now == 2 and not degree.is_open
        assert degree.choose(higher, error) is best and degree.now == best.done.degree
        assert degree.chosen["degree"] == degree.now and not degree.is_open
        assert degree.choose(higher, error) is higher


def test_a_degree_that_is_given_stays():
    degree, one = Degree(1), Tried("mesh", "watch", PASSES[0], None, "step")
    assert not degree.is_open and degree.choose(one, 0.01) is one and degree.chosen is None
