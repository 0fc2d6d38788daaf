"""Patterns of owned rows, and the plan that sums the contributions of several ranks into them."""

import numpy as np

from pcontact.assembly.graph import add_blocks, add_chosen_blocks, locate_rows, merge_rows
from pcontact.runtime.parallel import split_by_rank


def union(ptr_a, col_a, ptr_b, col_b):
    """Union of two block patterns with the same rows.

    Returns
    -------
    rowptr (n + 1,), columns (nnz,) : ndarray
    """
    rowptr = np.zeros_like(ptr_a)
    merge_rows(ptr_a, col_a, ptr_b, col_b, rowptr, np.zeros(0, dtype=np.int64), False)
    columns = np.empty(rowptr[-1], dtype=np.int64)
    merge_rows(ptr_a, col_a, ptr_b, col_b, rowptr, columns, True)
    return rowptr, columns


def positions(ptr_a, col_a, rowptr, columns):
    """Position (int64) in a pattern of every entry of a pattern that it contains."""
    position = np.empty(len(col_a), dtype=np.int64)
    locate_rows(ptr_a, col_a, rowptr, columns, position)
    return position


class JoinedPattern:
    """Union of block patterns with the same rows, and the sum of values on them.

    Parameters
    ----------
    patterns : list of (ndarray (n + 1,), ndarray (nnz,))
        Row pointers and columns.
    n : int
        Rows.

    Attributes
    ----------
    rowptr, columns : ndarray (n + 1,), (nnz,)
        The union.
    """

    def __init__(self, patterns, n):
        self.rowptr, self.columns = np.zeros(n + 1, dtype=np.int64), np.zeros(0, dtype=np.int64)
        for pattern in patterns:
            self.rowptr, self.columns = union(self.rowptr, self.columns, *pattern)
        self._places = [positions(*pattern, self.rowptr, self.columns) for pattern in patterns]

    def sum(self, values):
        """Sum (nnz, d, d) of values on the patterns, a list in their order."""
        if len(values) == 1:
            return values[0]
        total = np.zeros((len(self.columns), *values[0].shape[1:]))
        for place, value in zip(self._places, values, strict=True):
            total[place] += value
        return total



def _sorted_rows(n_rows, rows, columns):
    """Pattern with sorted unique columns from unordered pairs."""
    order = np.lexsort((columns, rows))
    rows, columns = rows[order], columns[order]
    keep = np.ones(len(rows), dtype=bool)
    keep[1:] = (rows[1:] != rows[:-1]) | (columns[1:] != columns[:-1])
    rowptr = np.zeros(n_rows + 1, dtype=np.int64)
    np.cumsum(np.bincount(rows[keep], minlength=n_rows), out=rowptr[1:])
    return rowptr, np.ascontiguousarray(columns[keep])


class OwnedRows:
    """Block rows that this rank owns, summed from what all ranks contribute.

    Parameters
    ----------
    numbering : pcontact.space.space.Numbering
    exchanger : pcontact.runtime.parallel.Exchanger
    nodes : ndarray (n,)
        Global numbers of the local rows and columns.
    rowptr, columns : ndarray
        Local pattern over these nodes, see :func:`pcontact.assembly.graph.node_graph`.

    Attributes
    ----------
    rowptr (n_owned + 1,), columns (nnz,) : ndarray
        Pattern of the owned rows, global node numbers, sorted in each row.

    Notes
    -----
    *Collective.*
    """

    def __init__(self, numbering, exchanger, nodes, rowptr, columns):
        self._exchanger = exchanger
        n_owned, start = numbering.n_owned, numbering.start
        row = np.repeat(np.arange(len(nodes)), np.diff(rowptr))
        global_row, global_column = nodes[row], nodes[columns]
        owner = numbering.owner(global_row)
        mine = owner == numbering.rank
        away = np.flatnonzero(~mine)
        pairs = np.column_stack([global_row[away], global_column[away]])
        sends, order = split_by_rank(owner[away], pairs)
        self._send_index = {}
        first = 0
        for rank, part in sends.items():
            self._send_index[rank] = away[order[first : first + len(part)]]
            first += len(part)
        received = exchanger(sends, np.int64, 2)
        rows = [global_row[mine] - start] + [p[:, 0] - start for p in received.values()]
        cols = [global_column[mine]] + [p[:, 1] for p in received.values()]
        self.rowptr, self.columns = _sorted_rows(n_owned, np.concatenate(rows), np.concatenate(cols))
        self._own_index = np.flatnonzero(mine)
        self._own_position = self._find(rows[0], cols[0])
        self._received_position = {
            rank: self._find(r, c) for rank, r, c in zip(received, rows[1:], cols[1:], strict=True)
        }

    def _find(self, rows, columns):
        order = np.lexsort((columns, rows))
        ptr = np.zeros(len(self.rowptr), dtype=np.int64)
        np.cumsum(np.bincount(rows, minlength=len(self.rowptr) - 1), out=ptr[1:])
        found = np.empty(len(rows), dtype=np.int64)
        found[order] = positions(ptr, np.ascontiguousarray(columns[order]), self.rowptr, self.columns)
        return found

    def sum(self, values):
        """Sum local values into the owned rows. *Collective.*

        Parameters
        ----------
        values : ndarray (nnz_local, d, d)

        Returns
        -------
        ndarray (nnz, d, d)
        """
        d = values.shape[1]
        out = np.zeros((len(self.columns), d, d))
        add_chosen_blocks(values, self._own_index, self._own_position, out)
        sends = {rank: values[index].reshape(-1, d * d) for rank, index in self._send_index.items()}
        for rank, part in self._exchanger(sends, np.float64, d * d).items():
            add_blocks(part.reshape(-1, d, d), self._received_position[rank], out)
        return out
