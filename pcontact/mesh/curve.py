"""Orders that keep neighbours in space together in memory: cells along a Z curve, nodes as the cells meet them."""

import numpy as np

from pcontact.runtime.jit import njit, njit_exact


@njit_exact
def _interleave(points, low, span, bits, out):
    """Bits of the positions (n, d) in a box, taken from the directions in turn."""
    d = points.shape[1]
    top = 2.0**bits - 1.0
    for k in range(points.shape[0]):
        key = np.uint64(0)
        for axis in range(d):
            place = np.uint64((points[k, axis] - low[axis]) / span[axis] * top)
            for bit in range(bits):
                key |= ((place >> np.uint64(bit)) & np.uint64(1)) << np.uint64(bit * d + axis)
        out[k] = key


def z_order(points):
    """Order (n,) of points (n, d) along a Z curve; that of the points where they coincide."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    d = points.shape[1]
    low, high = points.min(axis=0), points.max(axis=0)
    keys = np.empty(len(points), dtype=np.uint64)
    _interleave(np.ascontiguousarray(points), low, np.where(high > low, high - low, 1.0), 31 if d == 2 else 20, keys)
    return np.argsort(keys, kind="stable")


@njit
def _meet(table, number, order, count):
    """Number the entries of a table (n, k) as they come, and put these numbers into it."""
    for row in range(table.shape[0]):
        for column in range(table.shape[1]):
            node = table[row, column]
            if number[node] < 0:
                number[node] = count
                order[count] = node
                count += 1
            table[row, column] = number[node]
    return count


def as_met(tables, n):
    """Number nodes from 0 to ``n`` - 1 in the order in which tables meet them; nodes that none has are left out.

    Parameters
    ----------
    tables : list of ndarray (m, k) int64
        C-contiguous; changed in place.
    n : int

    Returns
    -------
    order : ndarray
        Old numbers in the new order.
    number : ndarray (n,)
        New numbers; -1 for nodes that are left out.
    """
    number, order = np.full(n, -1, dtype=np.int64), np.empty(n, dtype=np.int64)
    count = 0
    for table in tables:
        count = _meet(table, number, order, count)
    return order[:count], number
