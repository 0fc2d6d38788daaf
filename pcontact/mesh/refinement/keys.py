"""Keys of nodes: numbers of 64 bits by which all ranks know a node, whatever came before it, and a table of them.

A node of the base has the mixed bits of its number. The node in the middle of an edge has those of the keys of the
edge's ends, in any order: so two ranks that cut the edge they share agree on the new node without a message, and a
mesh that is made again from the base has the same keys. Two of n nodes have the same key with a probability of n^2 /
2^65: 1e-6 for 5 million.
"""

import numpy as np

from pcontact.runtime.jit import njit_exact, njit_inline

# value of a place of the table that is free, and of a key that is known, but has no node here yet
FREE, AWAITED = -2, -1


@njit_inline
def mixed(number):
    """64 bits that look like random ones (S. Vigna's splitmix64)."""
    z = np.uint64(number) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit_inline
def middle_key(a, b):
    """Key of the node between two others."""
    low, high = min(a, b), max(a, b)
    return mixed(low * np.uint64(3) + mixed(high))


@njit_exact
def vertex_keys(numbers, out):
    """Keys (n,) uint64 of nodes of the base, by their numbers."""
    for k in range(numbers.shape[0]):
        out[k] = mixed(np.uint64(numbers[k]))


@njit_exact
def middle_keys(one, other, out):
    """Keys (n,) uint64 of nodes between pairs of others, by the keys of these."""
    for k in range(one.shape[0]):
        out[k] = middle_key(one[k], other[k])


@njit_inline
def place(keys, values, key):
    """Where a key is in the table, or the free place where it belongs."""
    last = np.int64(keys.shape[0] - 1)
    at = np.int64(key & np.uint64(last))
    while values[at] != FREE and keys[at] != key:
        at = (at + 1) & last
    return at


@njit_exact
def enter(keys, values, entered, numbers):
    """Put keys (n,) with their values (n,) into a table that has room for them."""
    for k in range(entered.shape[0]):
        at = place(keys, values, entered[k])
        keys[at], values[at] = entered[k], numbers[k]


def new_table(n):
    """A table of keys with room for n of them: keys uint64, values int32, both (a power of two,)."""
    size = 2 << max(int(n), 8).bit_length()
    return np.zeros(size, dtype=np.uint64), np.full(size, FREE, dtype=np.int32)


def home_of_key(keys, size):
    """The rank (n,) that keeps what all ranks have to know of a node, by its key."""
    return ((keys >> np.uint64(32)) * np.uint64(size) >> np.uint64(32)).astype(np.int64)
