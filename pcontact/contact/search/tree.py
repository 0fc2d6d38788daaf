"""A tree of axis-aligned boxes over facets, in flat arrays that compiled kernels can walk, with cones of their normals.

Nodes are split at the median of the centres of the boxes (`facet_maps.facet_boxes`) along their widest direction; the
tree is therefore balanced whatever the mesh looks like, and is built in O(n log n).

Cones of normals tell in which direction a partner can lie at all. The point of a smooth surface that is nearest to x
has its normal along the line to x, and so has, at a corner, one of the directions between the normals of the facets
that meet there: a move that leads inwards across all of them leads into the body, and no point of the body is nearer
than the nearest. Facets all of whose normals, and those of all that share a node with them, point elsewhere thus hold
no partner, however near they are; nor do those whose normals make a contact normal that does not face the point, nor,
in self contact, those that are behind it through the material. Most of what is near is left out so: the sides and the
far skin of everything around. A facet on the border of the surface, or whose neighbours are not known, has the cone of
all directions.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.surface.facet_maps import (
    ALONG_U,
    ALONG_V,
    CORNERS,
    DIFFERENCES,
    difference,
    facet_boxes,
    is_segment,
    load_nodes,
    to_bezier,
)
from pcontact.runtime.jit import njit_exact, njit_inline, njit_inner_exact

LEAF_SIZE = 4
STACK_SIZE = 160  # the tree is balanced: its depth stays below log2(n) + 1, over several bodies below twice that


class Tree(NamedTuple):
    """Boxes over facets. Node 0 is the root; a tree over no facet has no node.

    Attributes
    ----------
    lower, upper : (n_nodes, d) float64
        Box of each node [length].
    child : (n_nodes,) int64
        First child of a node (the second one follows it), -1 for a leaf.
    first, last : (n_nodes,) int64
        The facets below a node are ``order[first:last]``.
    order : (n_facets,) int64
        Facet numbers in the order of the leaves.
    facet_lower, facet_upper : (n_facets, d) float64
        Boxes of the single facets, in the order of the leaves.
    """

    lower: np.ndarray
    upper: np.ndarray
    child: np.ndarray
    first: np.ndarray
    last: np.ndarray
    order: np.ndarray
    facet_lower: np.ndarray
    facet_upper: np.ndarray


def build_tree(lower, upper, bodies=None):
    """Build the tree over boxes.

    Parameters
    ----------
    lower, upper : (n, d) array_like
        Boxes of the facets; n = 0 is allowed.
    bodies : (n,) array_like of int, optional
        Of the facets. Branches then hold one body each as soon as they can: a tree over bodies, then over facets.
        Points of bodies that are no partners of themselves pass by their own branch at once.

    Returns
    -------
    Tree
    """
    lower = np.ascontiguousarray(lower, dtype=np.float64)
    upper = np.ascontiguousarray(upper, dtype=np.float64)
    n, d = lower.shape
    capacity = max(2 * n, 1)
    node_lower, node_upper = np.empty((capacity, d)), np.empty((capacity, d))
    child, first, last = (np.full(capacity, -1, dtype=np.int64) for _ in range(3))
    order, centre = np.arange(n, dtype=np.int64), 0.5 * (lower + upper)
    body, middles = np.zeros(n, dtype=np.int64), centre
    if bodies is not None and n:
        _, body = np.unique(bodies, return_inverse=True)
        sizes = np.bincount(body)
        middles = np.column_stack([np.bincount(body, column) / sizes for column in centre.T])
        # bodies in the same place are told apart by their numbers
        middles += 1e-9 * np.ptp(centre, axis=0).max() * np.linspace(0.0, 1.0, len(sizes))[:, None]
        middles, body = middles[body], body.astype(np.int64)
    tree = Tree(node_lower, node_upper, child, first, last, order, lower, upper)
    count = _build(centre, np.ascontiguousarray(middles), body, tree)
    return Tree(*(array[:count].copy() for array in tree[:5]), order, lower[order], upper[order])


@njit_exact
def _build(centre, middles, body, tree):
    """Fill the nodes of a tree and permute its `order`; return the number of nodes.

    The boxes of its facets are in the order of their numbers, before and after. Nodes with several bodies (n,) are
    divided by the middles (n, d) of the bodies, at a border between two of them.
    """
    child, first, last, order, lower, upper = tree[2:]
    n, d = lower.shape
    if n == 0:
        return 0
    stack = np.empty(STACK_SIZE, dtype=np.int64)
    stack[0], depth, count = 0, 1, 1
    first[0], last[0] = 0, n
    while depth > 0:
        depth -= 1
        node = stack[depth]
        a, b = first[node], last[node]
        several = False
        for i in range(a + 1, b):
            several = several or body[order[i]] != body[order[a]]
        at = middles if several else centre
        widest, axis = -1.0, 0
        for k in range(d):
            low, high, c_low, c_high = np.inf, -np.inf, np.inf, -np.inf
            for i in range(a, b):
                f = order[i]
                low, high = min(low, lower[f, k]), max(high, upper[f, k])
                c_low, c_high = min(c_low, at[f, k]), max(c_high, at[f, k])
            tree.lower[node, k], tree.upper[node, k] = low, high
            if c_high - c_low > widest:
                widest, axis = c_high - c_low, k
        if b - a <= LEAF_SIZE:
            child[node] = -1
            continue
        middle = (a + b) // 2
        _select(at, axis, order, a, b, middle)
        if several:
            middle = _border(at, axis, order, a, b, middle)
        child[node] = count
        first[count], last[count] = a, middle
        first[count + 1], last[count + 1] = middle, b
        stack[depth], stack[depth + 1] = count, count + 1
        depth += 2
        count += 2
    return count


@njit_exact
def _border(middles, axis, order, a, b, middle):
    """Divide ``order[a:b]``, selected about `middle`, between two bodies; return where the second part begins."""
    pivot, below = middles[order[middle], axis], 0
    for i in range(a, b):
        below += middles[order[i], axis] < pivot
    # the body in the middle goes to the second part, or, if it is the first, stays there alone
    whole = below > 0
    j = a
    for i in range(a, b):
        value = middles[order[i], axis]
        if value < pivot or (not whole and value == pivot):
            order[i], order[j] = order[j], order[i]
            j += 1
    # bodies that rounding puts in one place
    return j if a < j < b else middle


@njit_exact
def _select(centre, axis, order, a, b, middle):
    """Permute ``order[a:b]`` so that the `middle` smallest centres come first (Hoare's selection)."""
    low, high = a, b - 1
    while low < high:
        pivot = centre[order[(low + high) // 2], axis]
        i, j = low, high
        while i <= j:
            while centre[order[i], axis] < pivot:
                i += 1
            while centre[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@njit_exact
def _fill_meeting(tree, low, high, asked, found):
    """Write pairs of a box (low, high) and a facet (place in the tree's order) whose boxes meet; how many there are."""
    count, stack, d = 0, np.empty(STACK_SIZE, dtype=np.int64), low.shape[1]
    for q in range(len(low) if len(tree.lower) else 0):
        stack[0], depth = 0, 1
        while depth > 0:
            depth -= 1
            node, apart = stack[depth], False
            for k in range(d):
                apart = apart or tree.lower[node, k] > high[q, k] or tree.upper[node, k] < low[q, k]
            if apart:
                continue
            if tree.child[node] >= 0:
                stack[depth], stack[depth + 1] = tree.child[node], tree.child[node] + 1
                depth += 2
                continue
            for i in range(tree.first[node], tree.last[node]):
                apart = False
                for k in range(d):
                    apart = apart or tree.facet_lower[i, k] > high[q, k] or tree.facet_upper[i, k] < low[q, k]
                if not apart:
                    if count < len(asked):
                        asked[count], found[count] = q, i
                    count += 1
    return count


def meeting(tree, low, high):
    """Pairs of boxes (n, d) and facets of a tree whose boxes meet: numbers of the box, ascending, and of the facet."""
    arguments, none = (tree, np.ascontiguousarray(low), np.ascontiguousarray(high)), np.zeros(0, dtype=np.int64)
    room = _fill_meeting(*arguments, none, none)
    asked, found = np.zeros(room, dtype=np.int64), np.zeros(room, dtype=np.int64)
    _fill_meeting(*arguments, asked, found)
    return asked, tree.order[found]


# angle of a cone that leaves nothing out
ALL = np.pi
# added to all cones: ties of distances leave the direction of a nearest point open by so much [rad]
MARGIN = 0.02


class Cones(NamedTuple):
    """Of all nodes of a tree, then of its facets in the order of the leaves; empty arrays: nothing is known.

    Attributes
    ----------
    axis : (n, 3) float64
        Unit vectors.
    cosine, sine : (n,) float64
        Of the largest angle between the axis and a normal; -1 and 0: all directions.
    lower, upper : (n, d) float64
        Boxes in the undeformed bodies [length]; empty unless points are on the surface searched.
    parts : (n,) int64
        Connected body, -1 for several; empty likewise.
    """

    axis: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    parts: np.ndarray


def no_cones(d):
    """For surfaces whose neighbours nobody told."""
    none = np.zeros(0)
    return Cones(np.zeros((0, 3)), none, none, np.zeros((0, d)), np.zeros((0, d)), np.zeros(0, dtype=np.int64))


def normal_cones(tree, x_facets, kinds, corners, exclusion=None):
    """The cones over a tree.

    Parameters
    ----------
    tree : Tree
    x_facets : (nf, m, d) float64
    kinds : (nf,) int64
    corners : (nf, k) int64
        Numbers of the facets' nodes, those of the corners first: neighbours share numbers.
    exclusion : pcontact.contact.search.exclusion.Exclusion, optional
        Of the facets; that of points is not read.

    Returns
    -------
    Cones
    """
    nf, d = len(kinds), x_facets.shape[2]
    alone, rings = np.zeros((nf, 4)), np.zeros((nf, 4))
    _fill_facets(x_facets, kinds, alone)
    _fill_rings(*_around(corners, kinds), kinds, d, alone, rings)
    n_nodes = tree.child.size
    cones = np.empty((n_nodes + nf, 4))
    cones[n_nodes:] = rings[tree.order]
    _fill_nodes(tree, cones)
    angle = cones[:, 3]
    axes = np.ascontiguousarray(cones[:, :3]), np.where(angle < ALL, np.cos(angle), -1.0), np.sin(angle)
    if exclusion is None or not exclusion.facet_parts.size:
        return Cones(*axes, *no_cones(d)[3:])
    lower, upper = (np.empty((n_nodes + nf, d)) for _ in range(2))
    parts = np.empty(n_nodes + nf, dtype=np.int64)
    boxes = facet_boxes(exclusion.facet_x, kinds)
    lower[n_nodes:], upper[n_nodes:] = (box[tree.order] for box in boxes)
    parts[n_nodes:] = exclusion.facet_parts[tree.order]
    _fill_undeformed(tree, lower, upper, parts)
    return Cones(*axes, lower, upper, parts)


def _around(corners, kinds):
    """Corners (nf, k) by numbers from 0 on; the facets at corner a are around[first[a]:first[a + 1]]."""
    own = np.arange(corners.shape[1]) < CORNERS[kinds][:, None]
    row, column = np.nonzero(own)
    _, at = np.unique(corners[row, column], return_inverse=True)
    numbers = np.zeros(corners.shape, dtype=np.int64)
    numbers[row, column] = at
    order = np.argsort(at, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(at))]).astype(np.int64)
    return numbers, first, np.ascontiguousarray(row[order].astype(np.int64))


@njit_exact
def _fill_facets(x_facets, kinds, cones):
    """Cones (nf, 4) of single facets: axis and angle.

    With the facet in Bezier form, its tangents are positive combinations of differences of control points, and its
    normals of their cross products.
    """
    nodes, line, vectors = np.zeros((9, 3)), np.zeros(9), np.zeros((36, 3))
    for f in range(kinds.size):
        load_nodes(x_facets, f, kinds[f], nodes)
        for k in range(3):
            for i in range(9):
                line[i] = nodes[i, k]
            to_bezier(kinds[f], line)
            for i in range(9):
                nodes[i, k] = line[i]
        count = _normals(kinds[f], nodes, vectors)
        _bound(vectors, count, cones[f])


@njit_inner_exact
def _normals(kind, b, out):
    """Vectors (n of them) whose positive combinations are all normals of a facet with control points b (9, 3)."""
    count, m = 0, DIFFERENCES[kind]
    for i in range(m):
        a0, a1, a2 = difference(b, ALONG_U[kind, i])
        if is_segment(kind):
            out[i, 0], out[i, 1], out[i, 2] = a1, -a0, 0.0
            count += 1
            continue
        for j in range(m):
            b0, b1, b2 = difference(b, ALONG_V[kind, j])
            out[count, 0] = a1 * b2 - a2 * b1
            out[count, 1] = a2 * b0 - a0 * b2
            out[count, 2] = a0 * b1 - a1 * b0
            count += 1
    return count


@njit_inner_exact
def _everything(cone):
    cone[0], cone[1], cone[2], cone[3] = 0.0, 0.0, 1.0, ALL


@njit_inner_exact
def _bound(vectors, count, cone):
    """The cone of some vectors; that of all directions if one is zero or they spread over half of them."""
    for i in range(count):
        length = np.sqrt(vectors[i, 0] ** 2 + vectors[i, 1] ** 2 + vectors[i, 2] ** 2)
        if not 0.0 < length < np.inf:
            _everything(cone)
            return
        for k in range(3):
            vectors[i, k] /= length
    x, y, z = 0.0, 0.0, 0.0
    for i in range(count):
        x, y, z = x + vectors[i, 0], y + vectors[i, 1], z + vectors[i, 2]
    length = np.sqrt(x * x + y * y + z * z)
    if not length > 1e-6:
        _everything(cone)
        return
    cone[0], cone[1], cone[2], cone[3] = x / length, y / length, z / length, 0.0
    for i in range(count):
        cone[3] = max(cone[3], angle_between(cone[0], cone[1], cone[2], vectors[i, 0], vectors[i, 1], vectors[i, 2]))
    if not cone[3] < 0.5 * np.pi - 0.01:
        _everything(cone)


@njit_inner_exact
def angle_between(a0, a1, a2, b0, b1, b2):
    """Angle between unit vectors."""
    return np.arccos(min(max(a0 * b0 + a1 * b1 + a2 * b2, -1.0), 1.0))


@njit_exact
def _fill_rings(numbers, first, around, kinds, d, alone, rings):
    """Cones of the facets and of all that share a corner with them; of everything near a border."""
    border = np.zeros(first.size - 1, dtype=np.bool_)
    for f in range(kinds.size):
        corners = CORNERS[kinds[f]]
        for i in range(corners):
            a, b = numbers[f, i], numbers[f, (i + 1) % corners]
            if d == 2:
                border[a] |= first[a + 1] - first[a] != 2
            elif _count_at_edge(numbers, first, around, kinds, a, b) != 2:
                border[a] = border[b] = True
    for f in range(kinds.size):
        corners = CORNERS[kinds[f]]
        x, y, z, open_ = 0.0, 0.0, 0.0, False
        for i in range(corners):
            a = numbers[f, i]
            open_ |= border[a]
            for s in range(first[a], first[a + 1]):
                g = around[s]
                x, y, z = x + alone[g, 0], y + alone[g, 1], z + alone[g, 2]
        length = np.sqrt(x * x + y * y + z * z)
        if open_ or not length > 1e-6:
            _everything(rings[f])
            continue
        x, y, z, angle = x / length, y / length, z / length, 0.0
        for i in range(corners):
            a = numbers[f, i]
            for s in range(first[a], first[a + 1]):
                g = around[s]
                angle = max(angle, angle_between(x, y, z, alone[g, 0], alone[g, 1], alone[g, 2]) + alone[g, 3])
        rings[f, 0], rings[f, 1], rings[f, 2], rings[f, 3] = x, y, z, angle + MARGIN
        if not rings[f, 3] < 0.5 * np.pi:
            _everything(rings[f])


@njit_inner_exact
def _count_at_edge(numbers, first, around, kinds, a, b):
    """Count the facets that have both corners."""
    count = 0
    for s in range(first[a], first[a + 1]):
        g = around[s]
        for i in range(CORNERS[kinds[g]]):
            count += numbers[g, i] == b
    return count


@njit_inner_exact
def _join(a, b, out):
    """The cone around two cones."""
    if a[3] >= ALL or b[3] >= ALL:
        _everything(out)
        return
    between = angle_between(a[0], a[1], a[2], b[0], b[1], b[2])
    wide, narrow = (a, b) if a[3] >= b[3] else (b, a)
    if between + narrow[3] <= wide[3]:
        for k in range(4):
            out[k] = wide[k]
        return
    angle = 0.5 * (between + wide[3] + narrow[3])
    if not angle < 0.5 * np.pi or not between > 0.0:
        _everything(out)
        return
    # turned from the axis of the wide one towards that of the other
    turn = angle - wide[3]
    p, q = np.sin(between - turn) / np.sin(between), np.sin(turn) / np.sin(between)
    x, y, z = p * wide[0] + q * narrow[0], p * wide[1] + q * narrow[1], p * wide[2] + q * narrow[2]
    length = np.sqrt(x * x + y * y + z * z)
    out[0], out[1], out[2], out[3] = x / length, y / length, z / length, angle + 1e-9


@njit_exact
def _fill_nodes(tree, cones):
    """Cones of the nodes of a tree; those of its facets come filled."""
    n = tree.child.size
    for node in range(n - 1, -1, -1):  # children have larger numbers
        if tree.child[node] >= 0:
            _join(cones[tree.child[node]], cones[tree.child[node] + 1], cones[node])
            continue
        for k in range(4):
            cones[node, k] = cones[n + tree.first[node], k]
        for i in range(tree.first[node] + 1, tree.last[node]):
            _join(cones[node].copy(), cones[n + i], cones[node])


@njit_exact
def _fill_undeformed(tree, lower, upper, parts):
    """Boxes and bodies of the nodes of a tree; those of its facets come filled."""
    n = tree.child.size
    for node in range(n - 1, -1, -1):
        first, last = tree.child[node], tree.child[node] + 2
        if first < 0:
            first, last = n + tree.first[node], n + tree.last[node]
        parts[node] = parts[first]
        for k in range(lower.shape[1]):
            lower[node, k], upper[node, k] = lower[first, k], upper[first, k]
            for i in range(first + 1, last):
                lower[node, k], upper[node, k] = min(lower[node, k], lower[i, k]), max(upper[node, k], upper[i, k])
        for i in range(first + 1, last):
            if parts[i] != parts[node]:
                parts[node] = -1


@njit_inline
def holds_none(cones, item, lower, upper, row, x, n, facing):
    """Return whether no partner of a point can be on the facets of an item, whatever body they belong to.

    Parameters
    ----------
    cones : Cones
    item : int
        Number among nodes and facets.
    lower, upper : (m, d) float64
        Boxes [length]; that of the item is number ``row``.
    x, n : (3,) float64
        Point and its unit normal.
    facing : float
        Smallest cosine between its normal and the contact normal.
    """
    axes, cosine, sine, d = cones.axis, cones.cosine[item], cones.sine[item], lower.shape[1]
    facing_away = False
    if cosine >= 0.0:
        # the contact normal is a normal of the cone, reversed
        turned = -(axes[item, 0] * n[0] + axes[item, 1] * n[1] + axes[item, 2] * n[2])
        nearest = turned * cosine + np.sqrt(max(1.0 - turned * turned, 0.0)) * sine
        facing_away = turned < cosine and nearest < facing
        if not facing_away:
            # and it is along the way to the partner
            distance2, size2, along = 0.0, 0.0, 0.0
            for k in range(d):
                r, half = 0.5 * (lower[row, k] + upper[row, k]) - x[k], 0.5 * (upper[row, k] - lower[row, k])
                distance2, size2, along = distance2 + r * r, size2 + half * half, along + r * axes[item, k]
            size2 *= 1.0 + 2e-6
            if distance2 > size2:
                widest = cosine * np.sqrt(distance2 - size2) - sine * np.sqrt(size2)
                facing_away = abs(along) < widest
    return facing_away


@njit_inline
def is_behind(cones, item, part, x, slack):
    """Return whether all facets of an item are behind a point, through the material of its body: see `.exclusion`.

    Parameters
    ----------
    cones : Cones
    item : int
    part : int
        Body of the point.
    x : (d,) float64
        The point in the undeformed body [length].
    slack : float
        [length].
    """
    axes, lower, upper = cones.axis, cones.lower, cones.upper
    behind, cosine, sine = False, cones.cosine[item], cones.sine[item]
    if cosine >= 0.0 and cones.parts[item] == part:
        distance2, size2, along = 0.0, 0.0, 0.0
        for k in range(lower.shape[1]):
            r, half = 0.5 * (lower[item, k] + upper[item, k]) - x[k], 0.5 * (upper[item, k] - lower[item, k])
            distance2, size2, along = distance2 + r * r, size2 + half * half, along + r * axes[item, k]
        # the shortest way along any normal of the cone
        across = np.sqrt(max(distance2 - along * along, 0.0))
        behind = along * cosine - across * sine - np.sqrt(size2) > slack
    return behind
