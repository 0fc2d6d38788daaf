"""The table of facets that the search has solved for a point, one row each: groups of them, normals, the winner."""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit_inner_exact

TIE = 1e-10  # of the facet size: distances that count as equal
TOUCH = 1e-9  # of the facet size: offsets that have no direction, and how far over a border a point may hang
SAME_POINT = 1e-6  # of the facet size: closest points of neighbours that count as one
BEHIND = 0.9  # how far an offset that leads out of a body may leave the cone of the normals at its end (in cosines)
ALONG = 1.0 - 1e-6  # the same of any offset, where only points opposite the surface have partners
EVEN = 1e-14  # of the distance and a tenth of it of the facet size: by how much rounding tells distances apart
AT_CORNER = 1e-13  # reference coordinates that are those of a corner
# how a projection is held: inside by how far it hangs over the border, below 1; at an edge, at a corner
EDGE, CORNER = 1.0, 2.0
# in the place of the facet of a point that has none because the search was not patient enough
GIVEN_UP = -2
# columns of the table of solved facets: distance, gap, reference coordinates, y - x (3), target normal (3),
# contact normal (3), interior (0 or 1), angle at y, facet size, rounding length, whether it is no partner (0 or 1),
# how it is held, whether the point is on it or on a neighbour (0 or 1)
DISTANCE, GAP, U, V, R, NY, N = 0, 1, 2, 3, 4, 7, 10
INTERIOR, ANGLE, SIZE, SLACK, LOST, HELD, AROUND, COLUMNS = 13, 14, 15, 16, 17, 18, 19, 20


class Solved(NamedTuple):
    """Facets that are solved for a point, in the order in which they were.

    Attributes
    ----------
    found : (nf, COLUMNS) float64
        The table.
    leaves : (nf,) int64
        Number of each of these facets in the order of the leaves of the tree.
    group : (nf,) int64
        Rows of those whose distances agree.
    """

    found: np.ndarray
    leaves: np.ndarray
    group: np.ndarray


@njit_inner_exact
def sort_group(solved, count, order, ids):
    """Sort a group by global number: sums over it and its winner must not depend on the facets' order."""
    group, leaves = solved.group, solved.leaves
    for i in range(1, count):
        slot, j = group[i], i
        while j > 0 and ids[order[leaves[group[j - 1]]]] > ids[order[leaves[slot]]]:
            group[j] = group[j - 1]
            j -= 1
        group[j] = slot


@njit_inner_exact
def goes_before(row, other):
    """Whether one of two facets of a group is the partner, by their shapes: else the smaller number is."""
    if row[HELD] != other[HELD]:
        return row[HELD] < other[HELD]
    rounding = EVEN * (other[DISTANCE] + 0.1 * other[SIZE]) + other[SLACK]
    return row[DISTANCE] < other[DISTANCE] - rounding


@njit_inner_exact
def set_normal(solved, count, row, strict, opposite):
    """Contact normal and gap of one facet of a group, see the head of `projection`; no normal: no partner.

    A point that touches another surface lies on its own facets, too: those say nothing of the other one.
    """
    found, group = solved.found, solved.group
    touching = row[DISTANCE] <= TOUCH * row[SIZE] + row[SLACK]
    if row[INTERIOR] > 0.0 and not touching:
        n0, n1, n2 = -row[NY], -row[NY + 1], -row[NY + 2]
    else:
        m0, m1, m2, same, cone = 0.0, 0.0, 0.0, (SAME_POINT * row[SIZE] + row[SLACK]) ** 2, np.inf
        for i in range(count):
            other = found[group[i]]
            c0, c1, c2 = other[R] - row[R], other[R + 1] - row[R + 1], other[R + 2] - row[R + 2]
            if c0 * c0 + c1 * c1 + c2 * c2 <= same and not other[AROUND] > row[AROUND]:
                w = other[ANGLE]
                m0, m1, m2 = m0 + w * other[NY], m1 + w * other[NY + 1], m2 + w * other[NY + 2]
        length = np.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
        for i in range(count):
            other = found[group[i]]
            c0, c1, c2 = other[R] - row[R], other[R + 1] - row[R + 1], other[R + 2] - row[R + 2]
            if c0 * c0 + c1 * c1 + c2 * c2 <= same and not other[AROUND] > row[AROUND]:
                cone = min(cone, m0 * other[NY] + m1 * other[NY + 1] + m2 * other[NY + 2])
        if not touching:
            # outside, the offset looks against the normals
            along = row[R] * m0 + row[R + 1] * m1 + row[R + 2] * m2
            inside = along > 0.0
            length = -row[DISTANCE] if inside else row[DISTANCE]
            n0, n1, n2 = row[R] / length, row[R + 1] / length, row[R + 2] / length
            if strict and (inside or opposite) and abs(along) < (ALONG if opposite else BEHIND) * cone * row[DISTANCE]:
                # out of the cone of the normals: beside the border of the target, not behind it or in front of it
                n0, n1, n2 = 0.0, 0.0, 0.0
        elif length > 0.0:
            n0, n1, n2 = -m0 / length, -m1 / length, -m2 / length
        else:
            n0, n1, n2 = -row[NY], -row[NY + 1], -row[NY + 2]
    row[N], row[N + 1], row[N + 2] = n0, n1, n2
    row[GAP] = row[R] * n0 + row[R + 1] * n1 + row[R + 2] * n2


@njit_inner_exact
def write_partner(projections, q, x, row, facet, ids):
    """Copy the winner to the arrays of the result."""
    projections.facet[q], projections.id[q] = facet, ids[facet]
    projections.gap[q], projections.distance[q] = row[GAP], row[DISTANCE]
    projections.size[q], projections.held[q] = row[SIZE], row[HELD]
    projections.xi[q, 0] = row[U]
    if projections.xi.shape[1] == 2:
        projections.xi[q, 1] = row[V]
    for k in range(projections.y.shape[1]):
        projections.y[q, k], projections.normal[q, k] = x[k] + row[R + k], row[N + k]
