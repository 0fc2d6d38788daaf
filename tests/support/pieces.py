"""Small pieces of fields, one per rank."""

import numpy as np

from pcontact.io.fields import Piece

CUBE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], dtype=float
)


def stretch(points):
    """A displacement with three different parts."""
    return points * [0.1, 0.2, -0.3] + [0.0, 1.0, 0.0]


def stack_piece(rank, ghost_rank_has_nothing=None):
    """A unit cube per rank, one upon the other, with a tetrahedron beside each."""
    if rank == ghost_rank_has_nothing:
        return Piece(np.zeros((0, 3)))
    points = np.concatenate([CUBE, [[2, 0, 0], [3, 0, 0], [2, 1, 0], [2, 0, 1]]]) + [0, 0, rank]
    cells = [("hexahedron", np.arange(8).reshape(1, 8)), ("tetra", np.arange(8, 12).reshape(1, 4))]
    stress = np.arange(6.0) + 10 * rank
    return Piece(
        points,
        cells,
        {"displacement": stretch(points), "number": np.arange(12)},
        {"stress": [stress[None], stress[None] + 100], "rank": [[rank], [rank]], "body": [[0], [1]]},
    )
