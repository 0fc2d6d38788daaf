"""The compiled search behind `projection`: a best-first walk of the tree, one point after the other.

A heap holds, by distance, tree nodes and facets (with the distance of their boxes, a lower bound) and facets
already solved (with their own distance). Solved facets therefore leave the heap in the order of their
distance; those that agree within a tolerance form a group, in which normals are combined and the winner is
chosen. The walk ends with the first group that holds an accepted facet: facets behind it are never solved.

What cannot hold a partner (`cones`) is set aside, and solved only where it meets a facet that may: there its normals
count, and whether it is nearer.
"""

import numpy as np

from pcontact.contact.apart import is_own
from pcontact.contact.facet_maps import (
    SQUARE_CORNERS,
    TRIANGLE_CORNERS,
    fill_jet,
    is_segment,
    is_triangle,
    jet_normal,
    load_nodes,
)
from pcontact.contact.projection_facets import GRID, closest_on_facet
from pcontact.contact.projection_rays import ray_on_facet
from pcontact.contact.projection_walk import expand, load_point, pop, push, start_bound, starts_of
from pcontact.runtime.jit import njit_exact, njit_inline

TIE = 1e-10  # of the facet size: distances that count as equal
TOUCH = 1e-9  # of the facet size: offsets that have no direction, and how far over a border a point may hang
SAME_POINT = 1e-6  # of the facet size: closest points of neighbours that count as one
BEHIND = 0.9  # how far an offset that leads out of a body may leave the cone of the normals at its end (in cosines)
STARTS = 32  # nodes below the root at most from which the points of a facet start
# columns of the table of solved facets: distance, gap, reference coordinates, y - x (3), target normal (3),
# contact normal (3), interior (0 or 1), angle at y, facet size, rounding length, whether it is no partner (0 or 1)
DISTANCE, GAP, U, V, R, NY, N = 0, 1, 2, 3, 4, 7, 10
INTERIOR, ANGLE, SIZE, SLACK, LOST, COLUMNS = 13, 14, 15, 16, 17, 18


@njit_exact
def search_all(rays, tree, x_facets, kinds, ids, own, points, normals, radii, facing, partners, apart, cones):
    """Write the partners of all points.

    Parameters are those of `projection.closest_points`, with `kinds` simplified
    (`facet_maps.simplest_kinds`), `radii` (np,), and `rays` True for ray tracing; `partners` comes filled for
    points without a partner.
    """
    n_nodes, nf = tree.child.size, kinds.size
    # heap items: nodes, then facets in the order of the leaves, then rows of `found`
    keys, items = np.empty(n_nodes + 2 * nf), np.empty(n_nodes + 2 * nf, dtype=np.int64)
    found, leaves, group = np.zeros((nf, COLUMNS)), np.empty(nf, dtype=np.int64), np.empty(nf, dtype=np.int64)
    nodes, shapes, jet, grid = np.zeros((9, 3)), np.zeros((6, 9)), np.zeros((6, 3)), np.empty((GRID, GRID))
    x, n, p = np.zeros(3), np.zeros(3), np.zeros(3)
    # nodes and facets that hold no partner, but perhaps a neighbour of one: walked only beside a facet that may win
    aside = np.empty(n_nodes + nf, dtype=np.int64)
    on_it = apart.parts.size > 0
    # points of one facet start together below the root, where they pass by their own body
    starts, box, end, n_starts = np.zeros(STARTS, dtype=np.int64), np.zeros((2, 3)), 0, 1
    together = apart.whole.size > 0 and points.shape[0] > 0
    for q in range(points.shape[0]):
        if together and q >= end:
            end, n_starts = starts_of(tree, points, q, radii, apart, starts, box)
        if n_starts == 0:
            continue
        rounding = load_point(points, normals, q, x, n)
        if not rounding < np.inf:
            continue
        radius, n_queue, n_found, n_group, nearest, limit, n_aside = radii[q], 0, 0, 0, 0.0, 0.0, 0
        for i in range(n_starts):
            key = start_bound(rays, tree, starts[i], x, n, facing, rounding) if together else 0.0
            if key <= radius:
                n_queue = push(keys, items, n_queue, key, starts[i])
        while n_queue > 0 or n_group > 0:
            key, item = (keys[0], items[0]) if n_queue > 0 else (np.inf, -1)
            if n_group > 0 and not key <= limit:
                n_more = 0
                if n_aside > 0:
                    for i in range(n_group):
                        row, leaf = found[group[i]], leaves[group[i]]
                        if row[LOST] > 0.0 or not _asks(row):
                            continue
                        side = _side(row, cones.axis, cones.cosine, n_nodes + leaf)
                        row[LOST] = _loses(row, side, n, facing)
                        if on_it and row[LOST] == 0.0:
                            row[LOST] = _is_own_on(apart, q, tree.order[leaf], kinds, row, side, shapes)
                        if row[LOST] == 0.0 and _is_passed_by(
                            found, leaves, group[i], n_found, tree, x_facets, kinds, x, p, nodes, shapes, jet, grid
                        ):
                            row[LOST] = 1.0
                        if row[LOST] > 0.0:
                            continue
                        n_aside, n_more = _fetch(
                            found, row, n_found, n_more, leaves, aside, n_aside, tree, x_facets, kinds, facing,
                            rounding, x, n, p, nodes, shapes, jet, grid,
                        )  # fmt: skip
                    joined = n_group
                    for slot in range(n_found, n_found + n_more):
                        tie = TIE * found[slot, SIZE] + rounding
                        if found[slot, DISTANCE] <= radius and abs(found[slot, DISTANCE] - nearest) <= tie:
                            limit = max(limit, nearest * (1.0 + 1e-14) + tie)
                            group[n_group] = slot
                            n_group += 1
                    n_found += n_more
                    partners.candidates[q] += n_more
                    if n_group > joined:
                        continue
                _sort(group, n_group, leaves, tree.order, ids)
                if not rays:
                    for i in range(n_group):
                        _set_normal(found, group, n_group, found[group[i]], facing > 0.0)
                winner = -1
                for i in range(n_group):
                    slot = group[i]
                    row, facet = found[slot], tree.order[leaves[slot]]
                    if (
                        row[LOST] > 0.0
                        or n[0] * row[N] + n[1] * row[N + 1] + n[2] * row[N + 2] < facing
                        or (on_it and _is_own(apart, q, facet, kinds[facet], row, N, 1.0, shapes))
                        or _is_passed_by(
                            found, leaves, slot, n_found, tree, x_facets, kinds, x, p, nodes, shapes, jet, grid
                        )
                    ):
                        continue
                    # one of the others may be held at an edge whose neighbours are not known here: it hides nothing
                    if own[facet] and (winner < 0 or row[INTERIOR] > found[winner, INTERIOR]):
                        winner = slot
                if winner >= 0:
                    _write(partners, q, x, found[winner], tree.order[leaves[winner]], ids)
                    break
                n_group = 0
                continue
            n_queue = pop(keys, items, n_queue)
            if item < n_nodes:
                n_queue, n_aside = expand(
                    rays, tree, item, x, n, facing, rounding, radius, keys, items, n_queue, cones, apart, q, aside,
                    n_aside,
                )  # fmt: skip
            elif item < n_nodes + nf:
                row = found[n_found]
                partners.candidates[q] += 1
                _solve(
                    rays, tree, item - n_nodes, x_facets, kinds, x, n, facing, rounding, p, nodes, shapes, jet, grid,
                    row,
                )  # fmt: skip
                if row[DISTANCE] <= radius and row[DISTANCE] < np.inf:
                    leaves[n_found] = item - n_nodes
                    n_queue = push(keys, items, n_queue, row[DISTANCE], n_nodes + nf + n_found)
                    n_found += 1
            else:
                slot = item - n_nodes - nf
                if n_group == 0:
                    nearest = limit = key
                limit = max(limit, nearest * (1.0 + 1e-14) + TIE * found[slot, SIZE] + rounding)
                group[n_group] = slot
                n_group += 1


@njit_exact
def _is_own(apart, q, facet, kind, row, column, factor, shapes):
    """`apart.is_own` with a multiple of three columns of a solved facet as the normal."""
    n0, n1, n2 = factor * row[column], factor * row[column + 1], factor * row[column + 2]
    return is_own(apart, q, facet, kind, row[U], row[V], n0, n1, n2, shapes)


@njit_exact
def _asks(row):
    """Whether the contact normal of a solved facet depends on its neighbours: held at an edge, or touching."""
    return not row[INTERIOR] > 0.0 or row[DISTANCE] <= TOUCH * row[SIZE] + row[SLACK]


@njit_exact
def _side(row, axes, cosines, item):
    """The multiple of the offset r of a facet held at an edge that is its contact normal, if it has one.

    It is along r, and against a normal of the cone. Returns -1 / |r| (inside), 1 / |r| (outside), 0 (along no normal of
    the cone: a neighbour is nearer), inf (not known).
    """
    if cosines[item] < 0.0 or row[DISTANCE] <= TOUCH * row[SIZE] + row[SLACK]:
        return np.inf
    along = row[R] * axes[item, 0] + row[R + 1] * axes[item, 1] + row[R + 2] * axes[item, 2]
    if abs(along) < cosines[item] * row[DISTANCE]:
        return 0.0
    return -1.0 / row[DISTANCE] if along > 0.0 else 1.0 / row[DISTANCE]


@njit_exact
def _loses(row, side, n, facing):
    """1 if a facet held at an edge has no contact normal that faces the point, else 0."""
    if side == np.inf:
        return 0.0
    cosine = side * (n[0] * row[R] + n[1] * row[R + 1] + n[2] * row[R + 2])
    return 0.0 if side != 0.0 and cosine >= facing - 1e-9 else 1.0


@njit_exact
def _is_own_on(apart, q, facet, kinds, row, side, shapes):
    """1 if a facet belongs to the point's neighbourhood on the side that is known, else 0."""
    if side == np.inf:
        return 0.0
    return 1.0 if _is_own(apart, q, facet, kinds[facet], row, R, side, shapes) else 0.0


@njit_exact
def _fetch(
    found, row, n_found, count, leaves, aside, n_aside, tree, x_facets, kinds, facing, rounding,
    x, n, p, nodes, shapes, jet, grid,
):  # fmt: skip
    """Solve the facets set aside at the nearest point of a solved facet.

    They hold no partner, but their normals count there, and whether they are nearer. Returns how many are left aside,
    and how many rows of `found` there are from `n_found` on (they were `count`).
    """
    n_nodes, k = tree.child.size, 0
    lower, upper, facet_lower, facet_upper = tree.lower, tree.upper, tree.facet_lower, tree.facet_upper
    slack = SAME_POINT * row[SIZE] + row[SLACK]
    while k < n_aside:
        item = aside[k]
        if item < n_nodes:
            away = _distance_to_box(lower, upper, item, x, row)
        else:
            away = _distance_to_box(facet_lower, facet_upper, item - n_nodes, x, row)
        if away > slack:
            k += 1
            continue
        n_aside -= 1
        aside[k] = aside[n_aside]
        if item >= n_nodes:
            leaf, other = item - n_nodes, found[n_found + count]
            _solve(False, tree, leaf, x_facets, kinds, x, n, facing, rounding, p, nodes, shapes, jet, grid, other)
            leaves[n_found + count] = leaf
            count += 1
            continue
        first, last, shift = tree.child[item], tree.child[item] + 2, 0
        if first < 0:
            first, last, shift = tree.first[item], tree.last[item], n_nodes
        for child in range(first, last):
            aside[n_aside] = shift + child
            n_aside += 1
    return n_aside, count


@njit_inline
def _distance_to_box(lower, upper, row, x, solved):
    """Distance (largest component) between a box and the point x + r of a solved facet."""
    away = 0.0
    for k in range(lower.shape[1]):
        y = x[k] + solved[R + k]
        away = max(away, lower[row, k] - y, y - upper[row, k])
    return away


@njit_exact
def _solve(rays, tree, leaf, x_facets, kinds, x, n, facing, rounding, p, nodes, shapes, jet, grid, row):
    """Fill the row of one facet; distance inf if it is no partner whatever its neighbours are."""
    facet = tree.order[leaf]
    kind, size2 = kinds[facet], 0.0
    load_nodes(x_facets, facet, kind, nodes)
    for k in range(x_facets.shape[2]):
        p[k] = x[k] - x_facets[facet, 0, k]
        size2 += (tree.facet_upper[leaf, k] - tree.facet_lower[leaf, k]) ** 2
    row[SIZE], row[SLACK] = np.sqrt(size2), rounding
    row[DISTANCE], row[INTERIOR], row[ANGLE], row[LOST] = np.inf, 1.0, 1.0, 0.0
    if not row[SIZE] > 0.0:
        return
    if rays:
        g, row[U], row[V] = ray_on_facet(kind, nodes, p, n, facing, 1e-12 * row[SIZE] + row[SLACK], shapes, jet, grid)
        row[DISTANCE], row[GAP] = abs(g), g
        for k in range(3):
            row[R + k], row[N + k] = g * n[k], n[k]
        return
    row[U], row[V] = closest_on_facet(kind, nodes, p, shapes, jet, grid)
    fill_jet(kind, row[U], row[V], nodes, 3, shapes, jet)
    r0, r1, r2 = jet[0, 0] - p[0], jet[0, 1] - p[1], jet[0, 2] - p[2]
    distance = np.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
    row[ANGLE] = _corner_angle(kind, row[U], row[V], jet)
    n0, n1, n2 = jet_normal(kind, jet)
    if n0 == 0.0 and n1 == 0.0 and n2 == 0.0:
        # a collapsed corner has the normal of the middle
        middle = 1.0 / 3.0 if is_triangle(kind) else 0.0
        fill_jet(kind, middle, middle, nodes, 3, shapes, jet)
        n0, n1, n2 = jet_normal(kind, jet)
        if n0 == 0.0 and n1 == 0.0 and n2 == 0.0:
            return
    along = r0 * n0 + r1 * n1 + r2 * n2
    s0, s1, s2 = r0 - along * n0, r1 - along * n1, r2 - along * n2
    sideways = np.sqrt(s0 * s0 + s1 * s1 + s2 * s2)
    if sideways > TOUCH * row[SIZE] + row[SLACK] + 1e-14 * distance:
        row[INTERIOR] = 0.0
    row[DISTANCE] = distance
    row[R], row[R + 1], row[R + 2], row[NY], row[NY + 1], row[NY + 2] = r0, r1, r2, n0, n1, n2


@njit_exact
def _corner_angle(kind, u, v, jet):
    """Angle of the facet at a reference point: that of the corner there, pi elsewhere."""
    if is_segment(kind):
        return np.pi
    corners = 3 if is_triangle(kind) else 4
    table = TRIANGLE_CORNERS if is_triangle(kind) else SQUARE_CORNERS
    for i in range(corners):
        if max(abs(u - table[i, 0]), abs(v - table[i, 1])) > 1e-9:
            continue
        before, after = (i + corners - 1) % corners, (i + 1) % corners
        a0, a1 = table[after, 0] - table[i, 0], table[after, 1] - table[i, 1]
        b0, b1 = table[before, 0] - table[i, 0], table[before, 1] - table[i, 1]
        dot, aa, bb = 0.0, 0.0, 0.0
        for k in range(3):
            a, b = a0 * jet[1, k] + a1 * jet[2, k], b0 * jet[1, k] + b1 * jet[2, k]
            dot, aa, bb = dot + a * b, aa + a * a, bb + b * b
        if not aa * bb > 0.0:
            return 0.0
        return np.arccos(min(max(dot / np.sqrt(aa * bb), -1.0), 1.0))
    return np.pi


@njit_exact
def _sort(group, count, leaves, order, ids):
    """Sort a group by global number: sums over it and its winner must not depend on the facets' order."""
    for i in range(1, count):
        slot, j = group[i], i
        while j > 0 and ids[order[leaves[group[j - 1]]]] > ids[order[leaves[slot]]]:
            group[j] = group[j - 1]
            j -= 1
        group[j] = slot


@njit_exact
def _is_passed_by(found, leaves, slot, count, tree, x_facets, kinds, x, p, nodes, shapes, jet, grid):
    """Whether a projection held at an edge is passed by: a neighbour at that edge has a nearer point.

    The neighbour has been solved: it is nearer. It counts even if the facing rule rejected it: a point beside
    a box, its nearest side rejected, must not be taken for one that has gone through the top.
    """
    row = found[slot]
    if row[INTERIOR] > 0.0 or row[DISTANCE] <= TOUCH * row[SIZE] + row[SLACK]:
        return False
    d, slack = x_facets.shape[2], SAME_POINT * row[SIZE] + row[SLACK]
    lower, upper = tree.facet_lower, tree.facet_upper
    nearer = row[DISTANCE] * (1.0 - 1e-14) - TIE * row[SIZE] - row[SLACK]
    for other in range(count):
        if not found[other, DISTANCE] < nearer:
            continue
        leaf = leaves[other]
        if _distance_to_box(lower, upper, leaf, x, row) > slack:
            continue
        facet = tree.order[leaf]
        load_nodes(x_facets, facet, kinds[facet], nodes)
        for k in range(d):
            p[k] = (x[k] - x_facets[facet, 0, k]) + row[R + k]
        u, v = closest_on_facet(kinds[facet], nodes, p, shapes, jet, grid)
        fill_jet(kinds[facet], u, v, nodes, 1, shapes, jet)
        if (jet[0, 0] - p[0]) ** 2 + (jet[0, 1] - p[1]) ** 2 + (jet[0, 2] - p[2]) ** 2 <= slack * slack:
            return True
    return False


@njit_exact
def _set_normal(found, group, count, row, strict):
    """Contact normal and gap of one facet of a group, see the head of `projection`; no normal: no partner."""
    touching = row[DISTANCE] <= TOUCH * row[SIZE] + row[SLACK]
    if row[INTERIOR] > 0.0 and not touching:
        n0, n1, n2 = -row[NY], -row[NY + 1], -row[NY + 2]
    else:
        m0, m1, m2, same, cone = 0.0, 0.0, 0.0, (SAME_POINT * row[SIZE] + row[SLACK]) ** 2, np.inf
        for i in range(count):
            other = found[group[i]]
            c0, c1, c2 = other[R] - row[R], other[R + 1] - row[R + 1], other[R + 2] - row[R + 2]
            if c0 * c0 + c1 * c1 + c2 * c2 <= same:
                w = other[ANGLE]
                m0, m1, m2 = m0 + w * other[NY], m1 + w * other[NY + 1], m2 + w * other[NY + 2]
        length = np.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
        for i in range(count):
            other = found[group[i]]
            c0, c1, c2 = other[R] - row[R], other[R + 1] - row[R + 1], other[R + 2] - row[R + 2]
            if c0 * c0 + c1 * c1 + c2 * c2 <= same:
                cone = min(cone, m0 * other[NY] + m1 * other[NY + 1] + m2 * other[NY + 2])
        if not touching:
            # outside, the offset looks against the normals
            along = row[R] * m0 + row[R + 1] * m1 + row[R + 2] * m2
            inside = along > 0.0
            length = -row[DISTANCE] if inside else row[DISTANCE]
            n0, n1, n2 = row[R] / length, row[R + 1] / length, row[R + 2] / length
            if strict and inside and along < BEHIND * cone * row[DISTANCE]:
                # out of the cone of the normals: below the border of the target but beside it, not behind it
                n0, n1, n2 = 0.0, 0.0, 0.0
        elif length > 0.0:
            n0, n1, n2 = -m0 / length, -m1 / length, -m2 / length
        else:
            n0, n1, n2 = -row[NY], -row[NY + 1], -row[NY + 2]
    row[N], row[N + 1], row[N + 2] = n0, n1, n2
    row[GAP] = row[R] * n0 + row[R + 1] * n1 + row[R + 2] * n2


@njit_exact
def _write(partners, q, x, row, facet, ids):
    """Copy the winner to the arrays of the result."""
    partners.facet[q], partners.id[q] = facet, ids[facet]
    partners.gap[q], partners.distance[q] = row[GAP], row[DISTANCE]
    partners.size[q], partners.interior[q] = row[SIZE], row[INTERIOR] > 0.0
    partners.xi[q, 0] = row[U]
    if partners.xi.shape[1] == 2:
        partners.xi[q, 1] = row[V]
    for k in range(partners.y.shape[1]):
        partners.y[q, k], partners.normal[q, k] = x[k] + row[R + k], row[N + k]
