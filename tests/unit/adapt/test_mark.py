"""How often cells are cut: the fewest cells for an error."""

from itertools import product

import numpy as np
import pytest

from pcontact.adapt.mark import AT_ONCE, LEAP, LEAST_GROWTH, Contributions, cuts
from pcontact.runtime.petsc import MPI


def test_no_choice_of_the_same_error_has_fewer_cells():
    """Against all choices of three cells."""
    squares, degree, dim = np.array([1.0, 0.07, 1e-3]), 1, 2
    for part in (0.9, 0.6, 0.4, 0.3):
        found = cuts(MPI.COMM_SELF, Contributions(squares, degree, dim), part)
        assert found.part < part
        left = [(np.sqrt(squares @ 0.25 ** (np.array(more) / 2) / squares.sum()), np.sum(2.0 ** np.array(more)))
                for more in product(range(5), repeat=3)]  # fmt: skip
        best = min(count for error, count in left if error <= found.part * (1 + 1e-12))
        assert np.sum(2.0**found.more) <= best * (1 + 1e-12)


def test_where_all_is_equal_all_is_cut():
    for degree, dim in product((1, 2), (2, 3)):
        found = cuts(MPI.COMM_SELF, Contributions(np.ones(10), degree, dim), 0.5 ** (degree * 1.0) * 1.0001)
        assert (found.more == dim).all() and found.growth == 2.0**dim
        assert found.part == pytest.approx(0.5**degree)


def test_a_singular_cell_does_not_cut_the_others():
    squares = np.concatenate([[1.0], np.full(1000, 1e-9)])
    found = cuts(MPI.COMM_SELF, Contributions(squares, 1, 2), 1e-3)
    assert found.more[0] == 2 * AT_ONCE and found.growth < 2.0 * LEAP


def test_growth_is_limited():
    found = cuts(MPI.COMM_SELF, Contributions(np.linspace(1.0, 2.0, 500), 1, 2), 0.1, most=1.7)
    assert 1.0 < found.growth <= 1.7


def test_the_first_meshes_are_the_same_whatever_the_target():
    """Until the rate is known, where there is more to gain than one pass brings."""
    errors = Contributions(np.random.default_rng(1).lognormal(0.0, 1.0, 400), 2, 2)
    for part, known in ((1e-3, False), (0.5, False), (1e-3, True)):
        whole = cuts(MPI.COMM_SELF, errors, part, least=LEAST_GROWTH)
        most = np.inf if known else LEAP
        found = cuts(MPI.COMM_SELF, errors, part, most, LEAST_GROWTH)
        if known or whole.growth <= LEAP:
            assert found.growth == whole.growth
        else:
            less = cuts(MPI.COMM_SELF, errors, 0.1 * part, most, LEAST_GROWTH)
            assert LEAP / 2 < found.growth <= LEAP and (less.more == found.more).all()


def test_cells_that_no_step_needs_fine_become_larger():
    """Where others are cut, by at most one halving and as often as they have been cut; not those of the file."""
    squares, level = np.concatenate([np.ones(50), np.full(50, 1e-6)]), np.repeat([0, 1, 2, 7], 25)
    errors = Contributions(squares, 1, 2, level=level)
    found = cuts(MPI.COMM_SELF, errors, 0.5001)
    assert (found.more[:50] == 2).all() and (found.more[50:75] == -2).all() and (found.more[75:] == -2).all()
    assert found.part < 0.5001 and found.growth == pytest.approx(0.5 * 4.0 + 0.5 * 0.25)
    once = cuts(MPI.COMM_SELF, errors._replace(level=np.repeat([0, 1, 1, 0], 25)), 0.5001)
    assert (once.more[50:75] == -1).all() and (once.more[75:] == 0).all()
    again = cuts(MPI.COMM_SELF, errors._replace(squares=squares * 4.0 ** np.minimum(-found.more, 2)), 0.5)
    assert (again.more[50:] <= 0).all()


def test_nothing_to_do():
    assert not cuts(MPI.COMM_SELF, Contributions(np.zeros(4), 1, 2), 0.1).more.any()


@pytest.mark.parallel
def test_parallel_equals_serial():
    comm = MPI.COMM_WORLD
    squares = np.random.default_rng(3).lognormal(0.0, 3.0, 200)
    own = np.array_split(np.arange(200), comm.size)[comm.rank]
    found = cuts(comm, Contributions(squares[own], 2, 3), 0.2)
    whole = cuts(MPI.COMM_SELF, Contributions(squares, 2, 3), 0.2)
    assert np.array_equal(found.more, whole.more[own]) and found.growth == pytest.approx(whole.growth)
