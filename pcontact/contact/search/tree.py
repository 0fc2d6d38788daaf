"""A tree of axis-aligned boxes over facets, in flat arrays that compiled kernels can walk.

The boxes are handed in (`facet_maps.facet_boxes`), so that this module knows nothing of facet kinds. Nodes
are split at the median of the box centres along their widest direction; the tree is therefore balanced
whatever the mesh looks like, and is built in O(n log n).
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit_exact

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
