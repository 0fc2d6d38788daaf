"""A tree of axis-aligned boxes over facets, in flat arrays that compiled kernels can walk.

The boxes are handed in (`facet_maps.facet_boxes`), so that this module knows nothing of facet kinds. Nodes
are split at the median of the box centres along their widest direction; the tree is therefore balanced
whatever the mesh looks like, and is built in O(n log n).
"""

from typing import NamedTuple

import numpy as np

from pcontact.runtime.jit import njit_exact

LEAF_SIZE = 4
STACK_SIZE = 64  # the tree is balanced: its depth stays below log2(n) + 1


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


def build_tree(lower, upper):
    """Build the tree over boxes.

    Parameters
    ----------
    lower, upper : (n, d) array_like
        Boxes of the facets; n = 0 is allowed.

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
    order = np.arange(n, dtype=np.int64)
    count = _build(0.5 * (lower + upper), lower, upper, order, node_lower, node_upper, child, first, last)
    return Tree(
        node_lower[:count].copy(), node_upper[:count].copy(), child[:count].copy(), first[:count].copy(),
        last[:count].copy(), order, lower[order], upper[order],
    )  # fmt: skip


@njit_exact
def _build(centre, lower, upper, order, node_lower, node_upper, child, first, last):
    """Fill the node arrays and permute `order`; return the number of nodes."""
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
        widest, axis = -1.0, 0
        for k in range(d):
            low, high, c_low, c_high = np.inf, -np.inf, np.inf, -np.inf
            for i in range(a, b):
                f = order[i]
                low, high = min(low, lower[f, k]), max(high, upper[f, k])
                c_low, c_high = min(c_low, centre[f, k]), max(c_high, centre[f, k])
            node_lower[node, k], node_upper[node, k] = low, high
            if c_high - c_low > widest:
                widest, axis = c_high - c_low, k
        if b - a <= LEAF_SIZE:
            child[node] = -1
            continue
        middle = (a + b) // 2
        _select(centre, axis, order, a, b, middle)
        child[node] = count
        first[count], last[count] = a, middle
        first[count + 1], last[count + 1] = middle, b
        stack[depth], stack[depth + 1] = count, count + 1
        depth += 2
        count += 2
    return count


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
