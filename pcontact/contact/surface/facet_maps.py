"""Reference maps of the facet kinds: shape functions, their derivatives, boxes, tangents and normals.

Node orders are VTK's. Reference domains: [-1, 1] for segments, the unit triangle, [-1, 1]^2 for
quadrilaterals. Inside the kernels a facet is always `nodes` (9, 3): its nodes *relative to its node 0*, so
that no digits are lost far from the origin; in two dimensions the third component is zero.
"""

import numpy as np

from pcontact.runtime.jit import njit_exact, njit_inner_exact

SEGMENT2, SEGMENT3, TRIANGLE3, TRIANGLE6, QUADRILATERAL4, QUADRILATERAL9 = range(6)
PARALLELOGRAM = 6  # a QUADRILATERAL4 with an affine map; only inside the search
QUADRILATERAL8 = 7  # only outside of it: searched are QUADRILATERAL9 with the same map
KIND = {
    ("segment", 1): SEGMENT2,
    ("segment", 2): SEGMENT3,
    ("triangle", 1): TRIANGLE3,
    ("triangle", 2): TRIANGLE6,
    ("quadrilateral", 1): QUADRILATERAL4,
    ("quadrilateral", 2): QUADRILATERAL9,
    ("quadrilateral8", 1): QUADRILATERAL4,
    ("quadrilateral8", 2): QUADRILATERAL8,
}
NODE_COUNTS = np.array([2, 3, 3, 6, 4, 9, 4, 8], dtype=np.int64)
MAX_NODES = 9
# corners of the reference domains; edge i joins corners i and i + 1, its middle is node (corners + i)
TRIANGLE_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
SQUARE_CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
# which 1D function (0: left end, 1: right end, 2: middle) makes node i of the nine-node quadrilateral, per
# direction
TENSOR = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [1, 2], [2, 1], [0, 2], [2, 2]], dtype=np.int64)
# in Bezier form: pairs of control points whose differences make the tangents along u and v; how many, per direction
ALONG_U = np.zeros((7, 6, 2), dtype=np.int64)
ALONG_V = np.zeros((7, 6, 2), dtype=np.int64)
DIFFERENCES = np.array([1, 2, 1, 3, 2, 6, 2], dtype=np.int64)
for _kind, _u, _v in (
    (SEGMENT2, [(0, 1)], [(0, 0)]),
    (SEGMENT3, [(0, 2), (2, 1)], [(0, 0)]),
    (TRIANGLE3, [(0, 1)], [(0, 2)]),
    (TRIANGLE6, [(0, 3), (3, 1), (5, 4)], [(0, 5), (3, 4), (5, 2)]),
    (QUADRILATERAL4, [(0, 1), (3, 2)], [(0, 3), (1, 2)]),
    (
        QUADRILATERAL9,
        [(0, 4), (4, 1), (7, 8), (8, 5), (3, 6), (6, 2)],
        [(0, 7), (7, 3), (4, 8), (8, 6), (1, 5), (5, 2)],
    ),
    (PARALLELOGRAM, [(0, 1), (3, 2)], [(0, 3), (1, 2)]),
):
    ALONG_U[_kind, : len(_u)], ALONG_V[_kind, : len(_v)] = _u, _v
CORNERS = np.array([2, 2, 3, 3, 4, 4, 4], dtype=np.int64)


def padded(table, width):
    """Rows (n, m, ...) of the nodes of facets, widened to (n, width, ...) with their first node: so the kind of a facet
    is seen from its row, see `pcontact.contact.finite_pair.kinds_of`."""
    missing = width - table.shape[1]
    return table if not missing else np.concatenate([table, np.repeat(table[:, :1], missing, axis=1)], axis=1)


@njit_inner_exact
def is_triangle(kind):
    """Return whether the reference domain is the unit triangle."""
    return kind == TRIANGLE3 or kind == TRIANGLE6


@njit_inner_exact
def is_segment(kind):
    """Return whether the facet is a curve in the plane."""
    return kind == SEGMENT2 or kind == SEGMENT3


@njit_inner_exact
def _line3(i, s):
    """Value, first and second derivative of the quadratic function i on [-1, 1]."""
    if i == 0:
        return 0.5 * s * (s - 1.0), s - 0.5, 1.0
    if i == 1:
        return 0.5 * s * (s + 1.0), s + 0.5, 1.0
    return (1.0 - s) * (1.0 + s), -2.0 * s, -2.0


@njit_inner_exact
def fill_shapes(kind, u, v, out):
    """Shape functions of one facet at one reference point.

    Parameters
    ----------
    kind : int
        One of the constants above.
    u, v : float
        Reference coordinates (v is unused for segments).
    out : (6, 9) float64
        Written: rows N, dN/du, dN/dv, d2N/du2, d2N/dudv, d2N/dv2; columns are the facet's nodes, others are
        not touched.
    """
    if kind == TRIANGLE3:
        out[:, :3] = 0.0
        out[0, 0], out[0, 1], out[0, 2] = 1.0 - u - v, u, v
        out[1, 0], out[1, 1], out[2, 0], out[2, 2] = -1.0, 1.0, -1.0, 1.0
    elif kind == SEGMENT2:
        out[:, :2] = 0.0
        out[0, 0], out[0, 1] = 0.5 * (1.0 - u), 0.5 * (1.0 + u)
        out[1, 0], out[1, 1] = -0.5, 0.5
    elif kind == SEGMENT3:
        out[:, :3] = 0.0
        for i in range(3):
            out[0, i], out[1, i], out[3, i] = _line3(i, u)
    elif kind == TRIANGLE6:
        _fill_triangle6(u, v, out)
    elif kind == QUADRILATERAL9 or kind == QUADRILATERAL8:
        for i in range(9):
            f, df, ddf = _line3(TENSOR[i, 0], u)
            g, dg, ddg = _line3(TENSOR[i, 1], v)
            out[0, i], out[1, i], out[2, i] = f * g, df * g, f * dg
            out[3, i], out[4, i], out[5, i] = ddf * g, df * dg, f * ddg
        if kind == QUADRILATERAL8:
            # the ninth node follows the others, see `pcontact.element.reference.middle_weights`
            for i in range(8):
                for r in range(6):
                    out[r, i] += (-0.25 if i < 4 else 0.5) * out[r, 8]
    else:
        for i in range(4):
            a, b = SQUARE_CORNERS[i, 0], SQUARE_CORNERS[i, 1]
            f, g = 0.5 * (1.0 + a * u), 0.5 * (1.0 + b * v)
            out[0, i], out[1, i], out[2, i] = f * g, 0.5 * a * g, 0.5 * b * f
            out[3, i], out[4, i], out[5, i] = 0.0, 0.25 * a * b, 0.0


@njit_inner_exact
def _fill_triangle6(u, v, out):
    w = 1.0 - u - v
    barycentric = (w, u, v)
    du, dv = (-1.0, 1.0, 0.0), (-1.0, 0.0, 1.0)
    for i in range(3):
        l = barycentric[i]  # noqa: E741
        out[0, i] = l * (2.0 * l - 1.0)
        out[1, i], out[2, i] = (4.0 * l - 1.0) * du[i], (4.0 * l - 1.0) * dv[i]
        out[3, i], out[4, i], out[5, i] = 4.0 * du[i] * du[i], 4.0 * du[i] * dv[i], 4.0 * dv[i] * dv[i]
        j = (i + 1) % 3
        m = barycentric[j]
        out[0, 3 + i] = 4.0 * l * m
        out[1, 3 + i] = 4.0 * (du[i] * m + l * du[j])
        out[2, 3 + i] = 4.0 * (dv[i] * m + l * dv[j])
        out[3, 3 + i] = 8.0 * du[i] * du[j]
        out[4, 3 + i] = 4.0 * (du[i] * dv[j] + dv[i] * du[j])
        out[5, 3 + i] = 8.0 * dv[i] * dv[j]


@njit_inner_exact
def fill_jet(kind, u, v, nodes, rows, shapes, jet):
    """Map of a facet and its derivatives at one point.

    Parameters
    ----------
    nodes : (9, 3) float64
        Node coordinates, relative to any origin.
    rows : int
        1: position only, 3: and tangents, 6: and second derivatives.
    shapes : (6, 9) float64
        Scratch.
    jet : (6, 3) float64
        Written: y, dy/du, dy/dv, d2y/du2, d2y/dudv, d2y/dv2 (segments: the rows of v are zero).
    """
    fill_shapes(kind, u, v, shapes)
    for r in range(rows):
        x, y, z = 0.0, 0.0, 0.0
        for i in range(NODE_COUNTS[kind]):
            s = shapes[r, i]
            x, y, z = x + s * nodes[i, 0], y + s * nodes[i, 1], z + s * nodes[i, 2]
        jet[r, 0], jet[r, 1], jet[r, 2] = x, y, z


@njit_inner_exact
def jet_normal(kind, jet):
    """Outward unit normal (three floats) from the tangents in `jet`; zeros where the map is singular.

    Plane: the tangent turned by -90 degrees; space: first tangent x second tangent.
    """
    if is_segment(kind):
        x, y, z = jet[1, 1], -jet[1, 0], 0.0
    else:
        x = jet[1, 1] * jet[2, 2] - jet[1, 2] * jet[2, 1]
        y = jet[1, 2] * jet[2, 0] - jet[1, 0] * jet[2, 2]
        z = jet[1, 0] * jet[2, 1] - jet[1, 1] * jet[2, 0]
    length = np.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@njit_inner_exact
def clamp(kind, u, v):
    """The nearest point of the reference domain."""
    if is_triangle(kind):
        u, v = max(u, 0.0), max(v, 0.0)
        if u + v > 1.0:
            u = min(max(0.5 * (1.0 + u - v), 0.0), 1.0)
            v = 1.0 - u
        return u, v
    return min(max(u, -1.0), 1.0), min(max(v, -1.0), 1.0)


@njit_inner_exact
def load_nodes(x_facets, facet, kind, nodes):
    """Copy a facet's nodes, relative to its node 0, to `nodes` (9, 3); the third is 0 in the plane."""
    for i in range(NODE_COUNTS[kind]):
        nodes[i, 2] = 0.0
        for k in range(x_facets.shape[2]):
            nodes[i, k] = x_facets[facet, i, k] - x_facets[facet, 0, k]


def facet_boxes(x_facets, kinds):
    """Boxes that contain the facets, curved ones included (boxes of their Bezier points).

    Parameters
    ----------
    x_facets : (nf, m, d) float64
        Node coordinates; m is at least the largest node count.
    kinds : (nf,) int64

    Returns
    -------
    lower, upper : (nf, d) float64
    """
    x_facets = np.require(x_facets, np.float64, ["C", "W"])
    kinds = np.require(kinds, np.int64, ["C", "W"])
    lower = np.empty((x_facets.shape[0], x_facets.shape[2]))
    upper = np.empty_like(lower)
    _fill_boxes(x_facets, kinds, lower, upper)
    return lower, upper


@njit_exact
def _fill_boxes(x_facets, kinds, lower, upper):
    nodes = np.zeros(9)
    for f in range(x_facets.shape[0]):
        kind = kinds[f]
        for k in range(x_facets.shape[2]):
            origin = x_facets[f, 0, k]
            for i in range(NODE_COUNTS[kind]):
                nodes[i] = x_facets[f, i, k] - origin
            to_bezier(kind, nodes)
            low, high = 0.0, 0.0
            for i in range(NODE_COUNTS[kind]):
                low, high = min(low, nodes[i]), max(high, nodes[i])
            # the width of a rounding: the sum with the origin must not cut a corner off
            slack = 4e-16 * (abs(origin) + high - low)
            lower[f, k], upper[f, k] = origin + low - slack, origin + high + slack


@njit_inner_exact
def to_bezier(kind, x):
    """Replace nodal values by Bezier coefficients, whose convex hull contains the facet."""
    if kind == SEGMENT3:
        x[2] = 2.0 * x[2] - 0.5 * (x[0] + x[1])
    elif kind == TRIANGLE6:
        for i in range(3):
            x[3 + i] = 2.0 * x[3 + i] - 0.5 * (x[i] + x[(i + 1) % 3])
    elif kind == QUADRILATERAL9:
        corners = 0.25 * (x[0] + x[1] + x[2] + x[3])
        middles = x[4] + x[5] + x[6] + x[7]
        x[8] = 4.0 * x[8] - middles + corners
        for i in range(4):
            x[4 + i] = 2.0 * x[4 + i] - 0.5 * (x[i] + x[(i + 1) % 4])


@njit_exact
def simplest_kinds(x_facets, kinds, simple):
    """Write to `simple` (nf,) the cheapest kind that describes each facet.

    A degree-2 facet whose middle nodes sit at the middle (to rounding) is its degree-1 kind, and a
    quadrilateral with an affine map is a PARALLELOGRAM: both have closed-form projections.
    """
    d = x_facets.shape[2]
    for f in range(kinds.size):
        kind = kinds[f]
        size, offset = 0.0, 0.0
        for k in range(d):
            for i in range(NODE_COUNTS[kind]):
                size = max(size, abs(x_facets[f, i, k] - x_facets[f, 0, k]))
                offset = max(offset, abs(x_facets[f, i, k]))
        slack, bend = 4e-16 * offset + 1e-15 * size, 0.0
        corners = 2 if is_segment(kind) else (3 if is_triangle(kind) else 4)
        for i in range(corners, NODE_COUNTS[kind]):
            for k in range(d):
                if i == 8:
                    middle = x_facets[f, 0, k] + x_facets[f, 1, k] + x_facets[f, 2, k] + x_facets[f, 3, k]
                    middle *= 0.25
                else:
                    a, b = i - corners, (i - corners + 1) % corners
                    middle = 0.5 * (x_facets[f, a, k] + x_facets[f, b, k])
                bend = max(bend, abs(x_facets[f, i, k] - middle))
        simple[f] = kind
        if bend <= slack:
            simple[f] = kind - kind % 2
        if simple[f] == QUADRILATERAL4:
            twist = 0.0
            for k in range(d):
                difference = (x_facets[f, 0, k] - x_facets[f, 1, k]) + (x_facets[f, 2, k] - x_facets[f, 3, k])
                twist = max(twist, abs(difference))
            if twist <= slack:
                simple[f] = PARALLELOGRAM


@njit_inner_exact
def difference(b, ends):
    """Difference (three floats) of two of the points b (n, 3)."""
    i, j = ends[0], ends[1]
    return b[j, 0] - b[i, 0], b[j, 1] - b[i, 1], b[j, 2] - b[i, 2]
