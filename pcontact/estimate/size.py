"""What an estimate says about the mesh: which cells to refine, and how large cells should be."""

import numpy as np

# a cell becomes at most so much smaller or larger at once: estimates of a coarse mesh know only so much
SMALLEST, LARGEST = 0.25, 2.0


def largest_contributions(estimates, part):
    """The fewest cells whose estimates make up a part of the whole (Doerfler 1996).

    Parameters
    ----------
    estimates : ndarray (n,)
        Of every cell, squares sum to that of the whole.
    part : float
        Of the sum of the squares, 0 to 1.

    Returns
    -------
    ndarray (n,) of bool
    """
    squares = np.asarray(estimates, dtype=float) ** 2
    order = np.argsort(-squares, kind="stable")
    count = np.searchsorted(np.cumsum(squares[order]), part * squares.sum() * (1.0 - 1e-12)) + 1
    marked = np.zeros(len(squares), dtype=bool)
    marked[order[:count]] = True
    return marked & (squares > 0.0)


def new_sizes(estimates, sizes, degree, dim, factor):
    """Sizes of cells that bring the error down with the fewest cells.

    A cell's part of the error falls with the size to the power of the degree p, the number of cells that take its place
    grows with its inverse to the power of the dimension: sizes are best in proportion to estimate^(-2 / (2 p + dim)).

    Parameters
    ----------
    estimates, sizes : ndarray (n,)
        Of the cells [sqrt(energy)], [length].
    degree, dim : int
    factor : float
        Error wanted over the estimate.

    Returns
    -------
    sizes : ndarray (n,)
        [length]
    predicted : float
        Error that they promise over the estimate.
    """
    squares = np.asarray(estimates, dtype=float) ** 2
    total = squares.sum()
    if total == 0.0:
        return sizes * LARGEST, 0.0
    # nothing is gained from cells without any error
    shape = np.maximum(squares / total, 1e-12) ** (-1.0 / (2 * degree + dim))

    def tried(scale):
        ratio = np.clip(scale * shape, SMALLEST, LARGEST)
        return ratio, float(np.sqrt(np.sum(squares * ratio ** (2 * degree)) / total))

    low, high = SMALLEST / shape.max(), LARGEST / shape.min()
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if tried(middle)[1] < factor else (low, middle)
    ratio, predicted = tried(low)
    return sizes * ratio, predicted


def edge_lengths(points, cells, edges):
    """Mean length (n,) of the edges (m, 2 local vertices) of cells (n, nodes) [length]."""
    ends = points[cells[:, edges]]
    return np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2).mean(axis=1)


def at_vertices(n_points, cells, sizes):
    """Sizes (n_points,) at the vertices of cells (n, k): geometric means of those of the cells around.

    Parameters
    ----------
    n_points : int
    cells : list of ndarray
        Vertices, one table for each kind of cell.
    sizes : list of ndarray
        [length]
    """
    total, count = np.zeros(n_points), np.zeros(n_points)
    for table, values in zip(cells, sizes, strict=True):
        np.add.at(total, table, np.log(values)[:, None])
        np.add.at(count, table, 1.0)
    return np.exp(total / np.maximum(count, 1.0))
