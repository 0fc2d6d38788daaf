"""Compiled kernels of the block sparse pattern: rows and columns are nodes, entries are (d, d) blocks."""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit, njit_inner


class BlockRows(NamedTuple):
    """A pattern of block rows and the values on it.

    Attributes
    ----------
    rowptr : ndarray (n + 1,)
    columns : ndarray (nnz,)
        Sorted within each row.
    values : ndarray (nnz, d, d)
    """

    rowptr: np.ndarray
    columns: np.ndarray
    values: np.ndarray


class Incidence(NamedTuple):
    """The elements at each of n nodes.

    Attributes
    ----------
    pointer : ndarray (n + 1,)
        Where those of each node begin.
    table, row : ndarray (pointer[n],)
        Table of each element, and its row in it.
    """

    pointer: np.ndarray
    table: np.ndarray
    row: np.ndarray


class Elements(NamedTuple):
    """The nodes of the elements of several tables, of which each has a number of nodes of its own.

    Attributes
    ----------
    nodes : ndarray (n,)
        All tables, one row after the other.
    first, width : ndarray (n_tables,)
        Where a table begins, and how many nodes an element of it has.
    """

    nodes: np.ndarray
    first: np.ndarray
    width: np.ndarray


@njit
def _fill_incidence(cells, number, cursor, incidence):
    for c in range(cells.shape[0]):
        for a in range(cells.shape[1]):
            k = cursor[cells[c, a]]
            incidence.table[k] = number
            incidence.row[k] = c
            cursor[cells[c, a]] = k + 1


@njit
def _rows(elements, incidence, rowptr, columns, fill):
    """Count (fill False) or write (fill True) the sorted unique columns of every row."""
    nodes, pointer = elements.nodes, incidence.pointer
    n = len(pointer) - 1
    last_seen = np.full(n, -1, np.int64)
    buffer = np.empty(n, np.int64)
    for row in range(n):
        count = 0
        for k in range(pointer[row], pointer[row + 1]):
            table = incidence.table[k]
            width = elements.width[table]
            first = elements.first[table] + incidence.row[k] * width
            for a in range(width):
                node = nodes[first + a]
                if last_seen[node] != row:
                    last_seen[node] = row
                    buffer[count] = node
                    count += 1
        if fill:
            part = np.sort(buffer[:count])
            for a in range(count):
                columns[rowptr[row] + a] = part[a]
        else:
            rowptr[row + 1] = rowptr[row] + count


def node_graph(tables, n_nodes):
    """Block pattern of elements that couple all their nodes.

    Parameters
    ----------
    tables : list of ndarray (n_elements, n_element_nodes)
        Node numbers, 0 to n_nodes - 1.
    n_nodes : int

    Returns
    -------
    rowptr : ndarray (n_nodes + 1,)
    columns : ndarray (nnz,)
        Sorted within each row.
    """
    tables = [np.ascontiguousarray(t, dtype=np.int64) for t in tables]
    pointer = np.zeros(n_nodes + 1, dtype=np.int64)
    for table in tables:
        pointer[1:] += np.bincount(table.ravel(), minlength=n_nodes)
    pointer = np.cumsum(pointer)
    incidence = Incidence(pointer, np.empty(pointer[-1], dtype=np.int32), np.empty(pointer[-1], dtype=np.int32))
    cursor = pointer[:-1].copy()
    for number, table in enumerate(tables):
        _fill_incidence(table, number, cursor, incidence)
    elements = Elements(
        np.concatenate([t.ravel() for t in tables]) if tables else np.zeros(0, dtype=np.int64),
        np.cumsum([0] + [t.size for t in tables])[:-1].astype(np.int64),
        np.array([t.shape[1] for t in tables], dtype=np.int64),
    )
    rowptr = np.zeros(n_nodes + 1, dtype=np.int64)
    _rows(elements, incidence, rowptr, np.zeros(0, np.int64), False)
    columns = np.empty(rowptr[-1], dtype=np.int64)
    _rows(elements, incidence, rowptr, columns, True)
    return rowptr, columns


@njit_inner
def find(columns, low, high, value):
    """Position of a value in the sorted part columns[low:high], or -1."""
    end = high
    while low < high:
        middle = (low + high) // 2
        if columns[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low if low < end and columns[low] == value else -1


@njit
def merge_rows(ptr_a, col_a, ptr_b, col_b, rowptr, columns, fill):
    """Union of two patterns with sorted rows; counts (fill False) or writes (fill True)."""
    for row in range(len(ptr_a) - 1):
        i, end_i = ptr_a[row], ptr_a[row + 1]
        j, end_j = ptr_b[row], ptr_b[row + 1]
        k = rowptr[row]
        while i < end_i or j < end_j:
            if j >= end_j or (i < end_i and col_a[i] <= col_b[j]):
                value = col_a[i]
                if j < end_j and col_b[j] == value:
                    j += 1
                i += 1
            else:
                value = col_b[j]
                j += 1
            if fill:
                columns[k] = value
            k += 1
        if not fill:
            rowptr[row + 1] = k


@njit
def locate_rows(ptr_a, col_a, rowptr, columns, position):
    """For every entry of pattern ``a`` its position in the pattern that contains it."""
    for row in range(len(ptr_a) - 1):
        for k in range(ptr_a[row], ptr_a[row + 1]):
            position[k] = find(columns, rowptr[row], rowptr[row + 1], col_a[k])


@njit
def add_chosen_blocks(values, chosen, position, out):
    """out[position[k]] += values[chosen[k]] for blocks (n, d, d)."""
    d = values.shape[1]
    for k in range(len(position)):
        p, v = position[k], chosen[k]
        for a in range(d):
            for b in range(d):
                out[p, a, b] += values[v, a, b]


class Product:
    """Products of block values on owned rows with vectors of a space. The constructor is *Collective*.

    Parameters
    ----------
    space : pcontact.space.space.Space
    rowptr, columns : ndarray
        Owned block rows; columns are global nodes.
    """

    def __init__(self, space, rowptr, columns):
        nodes, self._column = space.numbering.places(columns)
        self._rowptr, self._exchange, self._shape = rowptr, space.exchange(nodes), (space.n_owned, space.dim)

    def __call__(self, values, u, magnitudes=False):
        """Product (n_owned, d) of values (nnz, d, d) and a vector, or of their magnitudes. *Collective.*"""
        y = np.empty(self._shape)
        kernel = multiply_magnitudes if magnitudes else multiply
        kernel(self._rowptr, self._column, values, self._exchange.gather(u), y)
        return y


@njit
def multiply(rowptr, columns, values, x, y):
    """y = A x for a block pattern: values (nnz, d, d), x (n_columns, d), y (n_rows, d)."""
    d = values.shape[1]
    if d == 3:
        for row in range(len(rowptr) - 1):
            y0 = y1 = y2 = 0.0
            for k in range(rowptr[row], rowptr[row + 1]):
                c = columns[k]
                x0, x1, x2 = x[c, 0], x[c, 1], x[c, 2]
                v = values[k]
                y0 += v[0, 0] * x0 + v[0, 1] * x1 + v[0, 2] * x2
                y1 += v[1, 0] * x0 + v[1, 1] * x1 + v[1, 2] * x2
                y2 += v[2, 0] * x0 + v[2, 1] * x1 + v[2, 2] * x2
            y[row, 0], y[row, 1], y[row, 2] = y0, y1, y2
    else:
        for row in range(len(rowptr) - 1):
            y0 = y1 = 0.0
            for k in range(rowptr[row], rowptr[row + 1]):
                c = columns[k]
                y0 += values[k, 0, 0] * x[c, 0] + values[k, 0, 1] * x[c, 1]
                y1 += values[k, 1, 0] * x[c, 0] + values[k, 1, 1] * x[c, 1]
            y[row, 0], y[row, 1] = y0, y1


@njit
def multiply_magnitudes(rowptr, columns, values, x, y):
    """y = |A| |x|, see :func:`multiply`: magnitudes of all entries."""
    d = values.shape[1]
    for row in range(len(rowptr) - 1):
        for i in range(d):
            total = 0.0
            for k in range(rowptr[row], rowptr[row + 1]):
                for j in range(d):
                    total += abs(values[k, i, j] * x[columns[k], j])
            y[row, i] = total
