"""What ranks send each other."""

import numpy as np
import pytest

from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import Exchanger, agree, on_root, split_by_rank
from pcontact.runtime.petsc import MPI

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel


@parallel
def test_exchanger_moves_what_is_sent():
    """Every pattern of who talks to whom, empty messages and oneself included, many times over."""
    exchange = Exchanger(WORLD)
    me, size = WORLD.rank, WORLD.size
    for turn in range(12):
        partners = np.random.default_rng(turn).random((size, size)) < 0.5
        counts = np.random.default_rng(100 + turn).integers(0, 4, (size, size))
        sends = {
            r: 1000 * turn + 100 * me + 10 * r + np.arange(2 * counts[me, r]).reshape(-1, 2)
            for r in range(size)
            if partners[me, r]
        }
        received = exchange(sends, np.int64, 2)
        assert list(received) == [r for r in range(size) if partners[r, me]]
        for r, array in received.items():
            expected = 1000 * turn + 100 * r + 10 * me + np.arange(2 * counts[r, me]).reshape(-1, 2)
            assert array.dtype == np.int64
            np.testing.assert_array_equal(array, expected)


@parallel
def test_exchanger_does_not_mix_calls():
    """A rank that is far ahead does not hand its next message to a call that is still on."""
    exchange = Exchanger(WORLD)
    for turn in range(50):
        to = (WORLD.rank + turn) % WORLD.size
        received = exchange({to: np.array([[turn + 0.5]])}, np.float64, 1)
        assert [float(a[0, 0]) for a in received.values()] == [turn + 0.5]
    messages = exchange.messages
    assert messages == sum((WORLD.rank + t) % WORLD.size != WORLD.rank for t in range(50))
    assert exchange.bytes == 8 * messages


def test_split_by_rank():
    ranks = np.array([2, 0, 2, 5, 0])
    pieces, order = split_by_rank(ranks, np.arange(10).reshape(5, 2))
    assert list(pieces) == [0, 2, 5]
    np.testing.assert_array_equal(pieces[2], [[0, 1], [4, 5]])
    np.testing.assert_array_equal(order, [1, 4, 0, 2, 3])
    pieces, order = split_by_rank(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    assert pieces == {} and len(order) == 0


@parallel
def test_errors_are_raised_on_every_rank():
    def fails(text):
        raise InputError(text)

    with pytest.raises(InputError, match="the file is bad"):
        on_root(WORLD, fails, "the file is bad")
    last = WORLD.size - 1
    with pytest.raises(InputError, match=f"rank {last} says"):
        agree(WORLD, f"rank {last} says no" if WORLD.rank == last else None)
    agree(WORLD, None)
    assert on_root(WORLD, lambda: 7) == (7 if WORLD.rank == 0 else None)
