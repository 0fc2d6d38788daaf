"""Tree, closest point projection and ray tracing against numpy twins and surfaces with known answers."""

import numpy as np
import pytest

from pcontact.contact.search.partners import _best, nearest_box
from pcontact.contact.search.projection import (
    FACING,
    NO_ID,
    Projections,
    QueryPoints,
    TargetFacets,
    closest_points,
    no_projections,
    ray_tracing,
    surface_tree,
)
from pcontact.contact.search.tree import LEAF_SIZE, build_tree
from pcontact.contact.surface.facet_maps import MAX_NODES, NODE_COUNTS, facet_boxes, fill_shapes

ANY = -2.0  # facing rule switched off
REFERENCE = {
    0: [[-1], [1]],
    1: [[-1], [1], [0]],
    2: [[0, 0], [1, 0], [0, 1]],
    3: [[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]],
    4: [[-1, -1], [1, -1], [1, 1], [-1, 1]],
    5: [[-1, -1], [1, -1], [1, 1], [-1, 1], [0, -1], [1, 0], [0, 1], [-1, 0], [0, 0]],
}
KINDS = sorted(REFERENCE)


# --- helpers: surfaces and twins


def pad(x):
    """Facets (nf, m, d) with unused nodes up to the largest count, as mixed surfaces have them."""
    return np.concatenate([x, np.full((len(x), MAX_NODES - x.shape[1], x.shape[2]), np.nan)], axis=1)


def search(
    x, kinds, points, normals, radius=np.inf, facing=FACING, ids=None, method=closest_points, own=None, **said
):
    kinds = np.full(len(x), kinds) if np.isscalar(kinds) else kinds
    ids = np.arange(len(x)) if ids is None else ids
    points, normals = np.atleast_2d(points).astype(float), np.atleast_2d(normals).astype(float)
    normals = np.ascontiguousarray(np.broadcast_to(normals, points.shape))
    target = TargetFacets(surface_tree(x, kinds), x, kinds, ids, own)
    return method(target, QueryPoints(points, normals, radius), facing, **said)


def better(a, b):
    """What two searches over different facets found for the same points, merged as that of ranks is."""
    each, n = Projections(*(np.concatenate(pair) for pair in zip(a, b, strict=True))), len(a.facet)
    rows = np.flatnonzero(each.facet >= 0)
    answers = np.column_stack([each.id, each.distance, each.gap, each.held, each.size, each.y])[rows]
    winner = _best(rows % max(n, 1), answers, n, each.y.shape[1])
    chosen = np.where(winner >= 0, np.append(rows, 0)[winner], np.arange(n))
    return Projections(*(part[chosen] for part in each))._replace(candidates=a.candidates + b.candidates)


def random_facet(kind, rng, bend=0.15):
    """A facet near its reference shape, bent out of the plane and distorted in it."""
    reference = np.array(REFERENCE[kind], dtype=float)
    x = np.column_stack([reference, np.zeros(len(reference))])
    return x + bend * rng.uniform(-1, 1, x.shape)


def facet_shapes(kind, xi):
    """Shape functions (n, 9) at reference points (n, d - 1) of a facet."""
    values = np.zeros((len(xi), 6, MAX_NODES))
    for (u, *v), out in zip(xi, values, strict=True):
        fill_shapes(kind, u, *(v or [0.0]), out)
    return values[:, 0]


def evaluate(kind, x, xi):
    weights = facet_shapes(kind, xi)[:, : NODE_COUNTS[kind]]
    return weights @ x[: NODE_COUNTS[kind]]


def sampled_distance(kind, x, point):
    """Smallest distance by dense sampling, zooming in around the best sample."""
    d = x.shape[1] - 1
    low, high = (np.zeros(2), np.ones(2)) if kind in (2, 3) else (-np.ones(d), np.ones(d))
    best, width, centre = np.inf, high - low, 0.5 * (low + high)
    for step in range(14):
        n = 61 if step == 0 else 13
        axes = [np.clip(np.linspace(c - w / 2, c + w / 2, n), a, b)
                for c, w, a, b in zip(centre, width, low, high, strict=True)]  # fmt: skip
        xi = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, d)
        if kind in (2, 3):
            xi /= np.maximum(xi.sum(axis=1, keepdims=True), 1.0)
        distance = np.linalg.norm(evaluate(kind, x, xi) - point, axis=1)
        i = np.argmin(distance)
        best, centre, width = min(best, distance[i]), xi[i], width * (0.1 if step == 0 else 0.4)
    return best


def grid_plane(n, kind=2, size=1.0):
    """The square [0, size]^2 at z = 0, outward normal +z, as triangles (2) or quadrilaterals (4)."""
    g = np.linspace(0, size, n + 1)
    p = np.stack([*np.meshgrid(g, g, indexing="ij"), np.zeros((n + 1, n + 1))], axis=-1).reshape(-1, 3)
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (number[s].ravel() for s in (np.s_[:-1, :-1], np.s_[1:, :-1], np.s_[1:, 1:], np.s_[:-1, 1:]))
    quads = np.stack([a, b, c, d], axis=1)
    if kind == 4:
        return p[quads]
    return p[np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])]


def cube(kind=4, n=2):
    """Surface of the unit cube, outward."""
    faces = []
    for axis in range(3):
        top = np.roll(grid_plane(n, kind), axis + 1, axis=2)
        upper, lower = top.copy(), top[:, ::-1].copy()
        upper[..., axis] = 1.0
        faces += [upper, lower]
    return np.concatenate(faces)


def sphere(level):
    """Unit sphere of flat triangles: an octahedron, refined."""
    e = np.eye(3)
    signs = (1.0, -1.0)
    x = np.array([[s * e[0], t * e[1], r * e[2]] for s in signs for t in signs for r in signs])
    normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    flip = np.einsum("fd,fd->f", normal, x.sum(axis=1)) < 0
    x[flip] = x[flip][:, [0, 2, 1]]
    for _ in range(level):
        m = [x[:, i] + x[:, (i + 1) % 3] for i in range(3)]
        m = [v / np.linalg.norm(v, axis=1, keepdims=True) for v in m]
        a, b, c = x[:, 0], x[:, 1], x[:, 2]
        parts = ((a, m[0], m[2]), (m[0], b, m[1]), (m[2], m[1], c), (m[0], m[1], m[2]))
        x = np.concatenate([np.stack(t, axis=1) for t in parts])
    return x


def polygon(corners):
    """Closed plane polygon, counter-clockwise, as segments."""
    corners = np.asarray(corners, dtype=float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def assert_same(a, b, but=("candidates",)):
    for name, u, v in zip(a._fields, a, b, strict=True):
        if name not in but:
            np.testing.assert_array_equal(u, v, err_msg=name)


# --- reference maps and boxes


@pytest.mark.parametrize("kind", KINDS)
def test_shapes(kind):
    reference = np.array(REFERENCE[kind], dtype=float)
    n = len(reference)
    assert NODE_COUNTS[kind] == n
    values = facet_shapes(kind, reference)
    np.testing.assert_allclose(values[:, :n], np.eye(n), atol=1e-15)
    assert not values[:, n:].any()


@pytest.mark.parametrize("kind", KINDS)
def test_shape_derivatives(kind):
    n, h = NODE_COUNTS[kind], 1e-5
    out = {k: np.zeros((6, 9)) for k in ("0", "u", "-u", "v", "-v")}
    for name, (u, v) in {
        "0": (0.3, 0.2), "u": (0.3 + h, 0.2), "-u": (0.3 - h, 0.2), "v": (0.3, 0.2 + h), "-v": (0.3, 0.2 - h)
    }.items():  # fmt: skip
        fill_shapes(kind, u, v, out[name])
    along_u, along_v = (out["u"] - out["-u"]) / (2 * h), (out["v"] - out["-v"]) / (2 * h)
    exact = out["0"]
    np.testing.assert_allclose(exact[[0, 1, 2]].sum(axis=1), [1, 0, 0], atol=1e-14)
    np.testing.assert_allclose(exact[[1, 3, 4], :n], along_u[[0, 1, 2], :n], atol=1e-9)
    np.testing.assert_allclose(exact[[2, 4, 5], :n], along_v[[0, 1, 2], :n], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_boxes_contain_curved_facets(kind):
    rng = np.random.default_rng(kind)
    x = np.stack([random_facet(kind, rng, 0.6) for _ in range(30)])
    lower, upper = facet_boxes(x, np.full(30, kind))
    xi = rng.uniform(0 if kind in (2, 3) else -1, 1, (500, x.shape[2] - 1))
    if kind in (2, 3):
        xi = xi[xi.sum(axis=1) <= 1]
    for f in range(30):
        y = evaluate(kind, x[f], xi)
        assert (y >= lower[f] - 1e-15).all() and (y <= upper[f] + 1e-15).all()


@pytest.mark.parametrize("n", [0, 1, 4, 5, 1000])
@pytest.mark.parametrize("equal", [False, True])
def test_tree(n, equal):
    rng = np.random.default_rng(n)
    lower = np.zeros((n, 3)) if equal else rng.random((n, 3))
    upper = lower + 0.1
    tree = build_tree(lower, upper)
    np.testing.assert_array_equal(np.sort(tree.order), np.arange(n))
    np.testing.assert_array_equal(tree.facet_lower, lower[tree.order])
    leaves = tree.child < 0
    assert (tree.last - tree.first)[leaves].sum() == n
    assert ((tree.last - tree.first)[leaves] <= LEAF_SIZE).all()
    for node in range(len(tree.child)):
        inside = tree.order[tree.first[node] : tree.last[node]]
        np.testing.assert_array_equal(tree.lower[node], lower[inside].min(axis=0))
        np.testing.assert_array_equal(tree.upper[node], upper[inside].max(axis=0))


# --- one facet of each kind


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bend", [0.0, 0.1, 0.35])
def test_single_facet_is_global_minimum(kind, bend):
    rng = np.random.default_rng(10 * kind + int(100 * bend))
    for _ in range(8):
        x = random_facet(kind, rng, bend)
        points = rng.uniform(-1.6, 1.6, (8, x.shape[1]))
        r = search(pad(x[None]), kind, points, np.eye(x.shape[1])[0], facing=ANY)
        assert (r.facet == 0).all()
        y = evaluate(kind, x, r.xi)
        np.testing.assert_allclose(r.y, y, atol=1e-14)
        np.testing.assert_allclose(r.distance, np.linalg.norm(y - points, axis=1), atol=1e-14)
        np.testing.assert_allclose(r.gap, ((y - points) * r.normal).sum(axis=1), atol=1e-14)
        np.testing.assert_allclose(np.abs(r.gap), r.distance, atol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(r.normal, axis=1), 1.0, atol=1e-14)
        twin = np.array([sampled_distance(kind, x, p) for p in points])
        assert (r.distance <= twin * (1 + 1e-12)).all(), (r.distance - twin).max()


def test_orientation_in_the_plane_and_in_space():
    # a square's bottom side, counter-clockwise: outward is -y
    r = search(np.array([[[0.0, 0], [1, 0]]]), 0, [[0.25, -0.5], [0.25, 0.5]], [[0, 1.0]])
    np.testing.assert_allclose(r.normal, [[0, 1], [0, 1]])
    np.testing.assert_allclose(r.gap, [0.5, -0.5])
    np.testing.assert_allclose(r.xi, [[-0.5], [-0.5]])
    triangle = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    r = search(triangle, 2, [[0.25, 0.25, 0.5], [0.25, 0.25, -0.5]], [0, 0, -1])
    np.testing.assert_allclose(r.normal, [[0, 0, -1]] * 2)
    np.testing.assert_allclose(r.gap, [0.5, -0.5])
    np.testing.assert_allclose(r.xi, [[0.25, 0.25]] * 2)


@pytest.mark.parametrize(("x", "gap"), [([1.002, -0.02], -0.02), ([1.05, -0.02], None), ([1.05, 0.02], 0.0539)])
def test_beside_the_border_is_not_behind(x, gap):
    """Beyond the end of a side: deep below and hardly beyond is behind it, far beyond is not, above is open."""
    r = search(np.array([[[1.0, 0.0], [0.0, 0.0]]]), 0, [x], [[0.0, -1.0]])
    assert (r.facet[0] >= 0) == (gap is not None)
    if gap is not None:
        assert r.gap[0] == pytest.approx(gap, rel=0.01)


def test_straight_degree_2_facets_match_degree_1():
    rng = np.random.default_rng(5)
    for low, high in ((0, 1), (2, 3)):
        x = random_facet(low, rng, 0.3)
        y = np.concatenate([x, 0.5 * (x + np.roll(x, -1, axis=0))[: NODE_COUNTS[high] - NODE_COUNTS[low]]])
        points = rng.uniform(-2, 2, (40, x.shape[1]))
        a = search(x[None], low, points, np.eye(x.shape[1])[0], facing=ANY)
        b = search(y[None], high, points, np.eye(x.shape[1])[0], facing=ANY)
        assert_same(a, b)


# --- many facets against brute force


@pytest.mark.parametrize("kind", KINDS)
def test_tree_search_is_brute_force(kind):
    rng = np.random.default_rng(kind)
    d = 2 if kind < 2 else 3
    x = np.stack([0.3 * random_facet(kind, rng, 0.2) + rng.uniform(-1, 1, d) for _ in range(60)])
    points, normals = rng.uniform(-1, 1, (200, d)), rng.normal(size=(200, d))
    for method in (closest_points, ray_tracing):
        everything = search(x, kind, points, normals, radius=1.0, method=method)
        merged = no_projections(points, normals)
        for f in range(len(x)):
            one = search(x[f : f + 1], kind, points, normals, 1.0, ids=np.array([f]), method=method)
            merged = better(merged, one)
        assert_same(everything, merged, but=("candidates", "facet", "normal") if method is ray_tracing else
                    ("candidates", "facet"))  # fmt: skip
        np.testing.assert_array_equal(everything.id, np.where(everything.facet >= 0, everything.facet, NO_ID))
        assert 10 < (everything.facet >= 0).sum(), method


# --- corners


@pytest.mark.parametrize("kind", [2, 4])
def test_convex_corners_of_a_cube(kind):
    rng = np.random.default_rng(1)
    box = cube(kind)
    outside = rng.uniform(-0.6, 1.6, (3000, 3))
    inside = (np.abs(outside - 0.5) < 0.5).all(axis=1)
    exact = np.clip(outside, 0, 1) - outside
    length = np.linalg.norm(exact, axis=1)
    # the source faces the cube
    r = search(box, kind, outside[~inside], exact[~inside] / length[~inside, None])
    np.testing.assert_allclose(r.gap, length[~inside], atol=1e-14)
    # a triangle that ends beside the closest point may win within the tolerance of the distance
    np.testing.assert_allclose(r.normal, exact[~inside] / length[~inside, None], atol=3e-5)
    assert (np.abs(r.normal - exact[~inside] / length[~inside, None]) < 1e-9).mean() > 0.99
    # penetrating: normal of the nearest face
    depth = np.stack([outside[inside], 1 - outside[inside]], axis=2).reshape(-1, 6)
    face = depth.argmin(axis=1)
    normal = np.zeros((len(face), 3))
    normal[np.arange(len(face)), face // 2] = np.where(face % 2 == 0, 1.0, -1.0)
    r = search(box, kind, outside[inside], normal)
    np.testing.assert_allclose(r.gap, -depth.min(axis=1), atol=1e-14)
    np.testing.assert_allclose(r.normal, normal, atol=1e-14)


@pytest.mark.parametrize("angle", [20, 90, 160, 200, 270, 340])
def test_wedge_side_and_direction(angle):
    """Points whose closest point is the tip: outside a convex one, inside a concave one."""
    a = np.radians(angle)  # interior angle, bisector +x
    tip = np.zeros(2)
    legs = 5 * np.array([[np.cos(a / 2), -np.sin(a / 2)], [np.cos(a / 2), np.sin(a / 2)]])
    # counter-clockwise around the interior: in along the upper leg, out along the lower one
    x = np.array([[legs[1], tip], [tip, legs[0]]])
    half = np.radians(abs(180 - angle)) / 2 * 0.95
    fan = np.linspace(-half, half, 41)
    side = -1.0 if angle < 180 else 1.0
    points = 0.3 * side * np.column_stack([np.cos(fan), np.sin(fan)])
    normal = np.array([1.0, 0])
    r = search(x, 0, points, normal, facing=0.05)
    accepted = r.facet >= 0
    np.testing.assert_array_equal(accepted, np.cos(fan) > 0.05)
    np.testing.assert_allclose(r.y[accepted], 0, atol=1e-15)
    np.testing.assert_allclose(r.gap[accepted], -side * 0.3, rtol=1e-14)
    np.testing.assert_allclose(r.normal[accepted], (side * points / 0.3)[accepted] * 1.0, atol=1e-14)


def test_sharp_pyramid_tip_uses_angle_weights():
    """Many slivers on one side of a tip do not outvote one wide facet on the other."""
    ring = np.concatenate([np.radians([0, 120]), np.radians(np.linspace(240, 241, 12)), [2 * np.pi]])
    foot = np.column_stack([np.cos(ring), np.sin(ring), np.full(len(ring), -0.1)])
    x = np.stack([np.zeros((len(foot) - 1, 3)), foot[:-1], foot[1:]], axis=1)
    r = search(x, 2, [0, 0, 0.2], [0, 0, -1])
    np.testing.assert_allclose(r.gap, 0.2, rtol=1e-12)


def test_touching_a_convex_edge_takes_the_mean_normal():
    r = search(cube(4), 4, [1.0, 0.3, 1.0], [-1, 0, -1])
    np.testing.assert_allclose(r.normal, [[-np.sqrt(0.5), 0, -np.sqrt(0.5)]], atol=1e-12)
    np.testing.assert_allclose(r.gap, 0, atol=1e-15)


@pytest.mark.parametrize("kind", [2, 4])
@pytest.mark.parametrize("height", [0.3, 1e-3, 1e-7, 1e-12, 0.0, -1e-9, -0.05])
def test_edges_between_coplanar_facets_do_not_show(kind, height):
    g = np.linspace(0, 1, 9)
    points = np.stack([*np.meshgrid(g, g), np.full((9, 9), height)], axis=-1).reshape(-1, 3)
    r = search(grid_plane(4, kind), kind, points, [0, 0, -1], 1.0)
    np.testing.assert_array_equal(r.gap, height)
    np.testing.assert_allclose(r.normal, np.broadcast_to([0, 0, -1.0], points.shape), atol=1e-16)
    np.testing.assert_allclose(r.y[:, :2], points[:, :2], atol=1e-15)


def ridge(d):
    """A roof of two facets with a slope of 1:2, whose ridge and gables are along the last axis but one."""
    profile = np.array([[-1.0, -0.5], [0.0, 0.0], [1.0, -0.5]])
    if d == 2:
        return np.stack([profile[[1, 0]], profile[[2, 1]]]), 0
    rows = np.stack([np.insert(profile, 1, y, axis=1) for y in (0.0, 1.0)])
    return np.stack([rows[[0, 0, 1, 1], [0, 1, 1, 0]], rows[[0, 0, 1, 1], [1, 2, 2, 1]]]), 4


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("height", [0.4, 0.05, -0.2])
def test_only_points_opposite_the_surface(d, height):
    """Points beside its border have no partner if none is wanted; above the ridge, where they are as far from the
    facets, they keep theirs."""
    x, kind = ridge(d)
    x = pad(np.ascontiguousarray(x))
    along = np.linspace(-1.6, 1.6, 65)
    slope = -0.5 * np.abs(along)
    points = np.column_stack([along, slope + height]) if d == 2 else np.column_stack(
        [along, np.full(len(along), 0.5), slope + height]
    )  # fmt: skip
    down = -np.eye(d)[-1]
    every, some = (search(x, kind, points, down, 1.0, opposite=opposite) for opposite in (False, True))
    # the foot on the plane of the facet is 0.4 of the height nearer to the ridge
    foot = np.abs(along) - 0.4 * height
    opposite = foot <= 1.0
    np.testing.assert_array_equal(some.facet >= 0, opposite)
    assert np.any((every.facet >= 0) & ~opposite)
    for one, other in zip(every, some, strict=True):
        if one is not every.candidates:
            np.testing.assert_array_equal(one[opposite], other[opposite])


# --- which facet wins


def scattered(seed=3):
    rng = np.random.default_rng(seed)
    x = np.concatenate([cube(4, 3), cube(4, 2) + [1.25, 0, 0]])
    grid = np.linspace(-0.5, 2.5, 13)
    points = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3)  # full of ties
    normals = rng.normal(size=points.shape)
    return x, points, normals, np.arange(len(x)) * 7 + 1, rng


@pytest.mark.parametrize("method", [closest_points, ray_tracing])
def test_order_of_facets_does_not_matter(method):
    x, points, normals, ids, rng = scattered()
    reference = search(x, 4, points, normals, 0.6, ids=ids, method=method)
    assert 200 < (reference.facet >= 0).sum() < len(points)
    for _ in range(5):
        order = rng.permutation(len(x))
        r = search(x[order], 4, points, normals, 0.6, ids=ids[order], method=method)
        assert_same(reference, r, but=("candidates", "facet"))
        found = r.facet >= 0
        np.testing.assert_array_equal(order[r.facet[found]], reference.facet[found])


@pytest.mark.parametrize("method", [closest_points, ray_tracing])
def test_merging_ranks(method):
    x, points, normals, ids, rng = scattered()
    reference = search(x, 4, points, normals, 0.6, ids=ids, method=method)
    owner = rng.integers(0, 3, len(x))
    nodes = np.unique(x.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(len(x), -1)
    parts = []
    for rank in range(3):
        known = np.isin(nodes, nodes[owner == rank]).any(axis=1)
        own = owner[known] == rank
        parts.append(search(x[known], 4, points, normals, 0.6, ids=ids[known], method=method, own=own))
        assert np.isin(parts[-1].id, np.append(ids[owner == rank], NO_ID)).all()
    for a, b, c in ((0, 1, 2), (2, 0, 1)):
        assert_same(better(better(parts[a], parts[b]), parts[c]), reference, but=("candidates", "facet"))


def test_merging_ranks_without_neighbours():
    """Then only what lies at edges may differ."""
    x, points, _, ids, rng = scattered()
    x, ids = x[:54], ids[:54]
    points = points[(points < 1.0).any(axis=1) & (np.abs(points - 0.5) >= 0.5).any(axis=1)]
    exact = np.clip(points, 0, 1) - points
    keep = np.linalg.norm(exact, axis=1) > 0
    points, normals = points[keep], exact[keep]
    reference = search(x, 4, points, normals, ids=ids)
    owner = rng.integers(0, 2, len(x))
    a, b = (search(x[owner == k], 4, points, normals, ids=ids[owner == k]) for k in range(2))
    merged = better(a, b)
    np.testing.assert_array_equal(merged.id, reference.id)
    np.testing.assert_allclose(merged.gap, reference.gap, atol=1e-15)
    np.testing.assert_array_equal(merged.candidates, a.candidates + b.candidates)


def test_equal_distances_go_to_the_smaller_id():
    x = np.array([[[0.0, 0], [1, 0]], [[1.0, 1], [0, 1]]])  # lower side faces down, upper side faces up
    for ids in ([4, 9], [9, 4]):
        r = search(x, 0, [0.5, 0.5], [0, 1], ids=np.array(ids), facing=ANY)
        assert r.id == 4
    # a hair nearer (beyond the tolerance) beats the id
    r = search(x, 0, [0.5, 0.5 + 1e-9], [0, 1], facing=ANY)
    assert r.id == 1


@pytest.mark.parametrize("turned", [False, True])
def test_what_is_nearer_by_more_than_rounding_wins_whatever_the_numbers(turned):
    ids = np.array([1, 0] if turned else [0, 1])
    # inside of both, nearer by 2e-12, where distances of 1e-10 would be as good
    valley = np.array([[[1.0, 1], [0, 0]], [[0.0, 0], [-1, 1]]])
    for side in (-1.0, 1.0):
        r = search(valley, 0, [side * 1e-12, 1.0], [0, -1], ids=ids)
        assert r.y[0, 0] * side > 0.0
    # one straight line: the facet below the point, not the one over whose border it hangs by 5e-10
    line = np.array([[[1.0, 0], [0, 0]], [[0.0, 0], [-1, 0]]])
    for side in (-1.0, 1.0):
        r = search(line, 0, [side * 5e-10, 0.1], [0, -1], ids=ids)
        np.testing.assert_allclose(r.y[0], [side * 5e-10, 0.0], rtol=0, atol=1e-15)
    # beside an edge of two facets in a row: one has the point on its edge, the other one only a corner, 1e-6 away
    row = np.array([[[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[-1.0, 0, 0], [0, 0, 0], [0, 1, 0], [-1, 1, 0]]])
    for side in (-1.0, 1.0):
        r = search(row, 4, [side * 1e-6, -0.2, 0.1], [0, 0, -1], ids=ids)
        assert r.y[0, 0] == pytest.approx(side * 1e-6, rel=1e-9)


@pytest.mark.parametrize("middle", [0.5, 0.53])
def test_a_point_just_inside_a_facet_of_degree_2_is_not_held_at_its_corner(middle):
    """The squares of both distances are the same number: 2e-9 beside the corner, seen from a third of the length."""
    line = np.array([[[0.0, 0], [-1, 0], [-middle, 0]]])
    for x in (-2e-9, -1.0 + 2e-9):
        r = search(line, 1, [x, 0.3], [0, -1])
        np.testing.assert_allclose(r.y[0], [x, 0.0], rtol=0, atol=1e-15)
    # in space: beside an edge, beside the corner of an edge, and inside
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    middles = np.array([[middle, 0, 0], [1, middle, 0], [1.0 - middle, 1, 0], [0, 1.0 - middle, 0]])
    facet = np.concatenate([corners, middles, [[0.5, 0.5, 0.0]]])[None]
    for x in ([0.4, 2e-9, 0.3], [1.0 - 2e-9, 0.4, 0.3], [2e-9, -0.1, 0.3], [1.1, 1.0 - 2e-9, 0.3]):
        r = search(facet, 5, x, [0, 0, -1])
        np.testing.assert_allclose(r.y[0], [min(max(x[0], 0.0), 1.0), max(x[1], 0.0), 0.0], rtol=0, atol=1e-14)


def test_rejected_facets_do_not_hide_accepted_ones():
    """A thin closed plate: a source above pairs with the upper face wherever it is, even past the middle."""
    plate = cube(4, 4) * [1, 1, 0.01]
    for height in (0.02, 0.012, 0.01, 0.008, 0.005, 0.003, 0.0, -0.005):
        r = search(plate, 4, [[0.4, 0.6, height], [0.99, 0.5, height]], [0, 0, -1], 0.5)
        np.testing.assert_allclose(r.normal, [[0, 0, -1]] * 2, atol=1e-12)
        np.testing.assert_allclose(r.gap, height - 0.01, atol=1e-15)
        r = search(plate, 4, [[0.4, 0.6, height]], [0, 0, 1], 0.5)
        np.testing.assert_allclose(r.gap, -height, atol=1e-15)


def test_hanging_over_the_border():
    plane = grid_plane(4)
    # little gap, far outside: sideways, rejected; directly over the border and a rounding beyond: paired
    points = np.array([[1.2, 0.5, 1e-3], [1.2, 0.5, 0], [1.2, 0.5, -1e-3], [1 + 1e-11, 0.5, 0.01],
                       [1, 0.5, 0.01], [1 + 1e-11, 0.5, 0], [1, 1, -0.01], [0.5, 0.5, 1e-3]])  # fmt: skip
    r = search(plane, 2, points, [0, 0, -1], 1.0)
    np.testing.assert_array_equal(r.facet >= 0, [False] * 3 + [True] * 5)
    assert (r.facet[:3] == -1).all() and (r.id[:3] == NO_ID).all() and np.isinf(r.gap[:3]).all()
    np.testing.assert_allclose(r.normal[3:], np.broadcast_to([0, 0, -1.0], (5, 3)), atol=1e-15)
    np.testing.assert_allclose(r.gap[3:], points[3:, 2], atol=1e-16)
    # facets beside a hanging point are not even tried
    assert r.candidates[1] == 0


def test_beside_a_box_is_not_through_its_top():
    points = [[1.01, 0.5, 0.98], [1.01, 0.5, 1.02], [1.05, 0.5, 0.5]]
    r = search(cube(4, 2), 4, points, [0, 0, -1], 0.3)
    np.testing.assert_array_equal(r.facet >= 0, [False, True, False])
    np.testing.assert_allclose(r.gap[1], np.hypot(0.01, 0.02))


def test_radius():
    plane = grid_plane(2)
    points = np.array([[0.3, 0.4, 0.5], [0.3, 0.4, -0.5], [0.3, 0.4, 0.5]])
    for method in (closest_points, ray_tracing):
        r = search(plane, 2, points, [0, 0, -1], [0.6, 0.6, 0.4], method=method)
        np.testing.assert_array_equal(r.facet >= 0, [True, True, False])
        np.testing.assert_allclose(r.gap[:2], [0.5, -0.5])


@pytest.mark.parametrize("method", [closest_points, ray_tracing])
def test_empty(method):
    for d, kind in ((2, 0), (3, 2)):
        none = np.zeros((0, MAX_NODES, d))
        r = search(none, kind, np.zeros((3, d)), np.ones((3, d)), method=method)
        assert (r.facet == -1).all() and (r.distance == np.inf).all() and (r.candidates == 0).all()
        x = np.random.default_rng(0).random((5, MAX_NODES, d))
        r = search(x, kind, np.zeros((0, d)), np.zeros((0, d)), method=method)
        assert r.facet.shape == (0,) and r.xi.shape == (0, d - 1) and r.y.shape == (0, d)
        assert better(r, r).facet.shape == (0,)


def test_bad_points_and_facets_have_no_partner():
    x = np.concatenate([grid_plane(2), np.zeros((1, 3, 3)) + 0.3])  # the last facet is a point
    points = np.array([[np.nan, 0.3, 0.1], [0.3, 0.3, 0.1], [0.3, 0.3, 0.1]])
    r = search(x, 2, points, [[0, 0, -1], [0, 0, 0], [0, 0, -1]], 1.0)
    np.testing.assert_array_equal(r.facet >= 0, [False, False, True])
    with pytest.raises(ValueError, match="dimension"):
        search(x, 0, points, [0, 0, -1], 1.0)


# --- accuracy


@pytest.mark.parametrize("method", [closest_points, ray_tracing])
@pytest.mark.parametrize("kind", KINDS)
def test_scale_and_offset(kind, method):
    rng = np.random.default_rng(kind)
    d = 2 if kind < 2 else 3
    x = np.stack([0.5 * random_facet(kind, rng, 0.15) + rng.uniform(-1, 1, d) for _ in range(40)])
    points, normals = rng.uniform(-1, 1, (200, d)), rng.normal(size=(200, d))
    a = search(x, kind, points, normals, 0.8, method=method)
    found = a.facet >= 0
    assert found.sum() > 10
    for scale in (1e-12, 1e12, 3.7):
        b = search(x * scale, kind, points * scale, normals, 0.8 * scale, method=method)
        np.testing.assert_array_equal(a.id, b.id)
        np.testing.assert_allclose(b.gap[found] / scale, a.gap[found], atol=1e-12)
        np.testing.assert_allclose(b.normal, a.normal, atol=1e-10)
        np.testing.assert_allclose(b.xi, a.xi, atol=1e-10)
    # coordinates rounded at the far place in both: nothing but the offset differs
    offset = 1e6 * np.arange(1, d + 1)
    x, points = (x + offset) - offset, (points + offset) - offset
    a = search(x, kind, points, normals, 0.8, method=method)
    b = search(x + offset, kind, points + offset, normals, 0.8, method=method)
    np.testing.assert_array_equal(a.id, b.id)
    np.testing.assert_allclose(b.gap[found], a.gap[found], atol=1e-14)
    np.testing.assert_allclose(b.normal, a.normal, atol=1e-11)


@pytest.mark.parametrize("level", [3, 4])
def test_sphere_of_flat_facets(level):
    x = sphere(level)
    edge = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max()
    sagitta = edge**2 / 6 * 1.05  # 1 - cos of the circumradius edge / sqrt(3)
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(2000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    exact = rng.uniform(-0.2, 0.2, 2000)
    points = direction * (1 + exact)[:, None]
    for method in (closest_points, ray_tracing):
        r = search(x, 2, points, -direction, 0.5, method=method)
        error = r.gap - exact
        assert (r.facet >= 0).all()
        assert error.min() > -1e-12 and error.max() < sagitta
        assert np.linalg.norm(r.normal + direction, axis=1).max() < edge


def test_points_inside_a_sphere_far_from_every_facet_stop_at_the_radius():
    x = sphere(4)
    r = search(x, 2, [0.0, 0, 0], [0, 0, 1], 0.5)
    assert r.facet == -1 and r.candidates == 0


def test_quadratic_circle():
    """SEGMENT3 arcs: the gap error is that of the quadratic interpolation, O(h^4)."""
    t = np.linspace(0, 2 * np.pi, 33)

    def at(s):
        return np.column_stack([np.cos(s), np.sin(s)])

    x = np.stack([at(t[:-1]), at(t[1:]), at(0.5 * (t[:-1] + t[1:]))], axis=1)
    s = np.random.default_rng(2).uniform(0, 2 * np.pi, 500)
    for gap in (0.3, -0.3, 1e-7):
        for method in (closest_points, ray_tracing):
            r = search(x, 1, at(s) * (1 + gap), -at(s), 0.5, method=method)
            assert (r.facet >= 0).all()
            np.testing.assert_allclose(r.gap, gap, atol=4e-6)
            np.testing.assert_allclose(r.normal, -at(s), atol=2e-3)


# --- rays


@pytest.mark.parametrize("kind", KINDS)
def test_rays_hit_distorted_facets(kind):
    """Rays are aimed at known points of a bent facet."""
    rng = np.random.default_rng(kind)
    d = 2 if kind < 2 else 3
    hit = 0
    for _ in range(30):
        x = random_facet(kind, rng, 0.12)
        xi = rng.uniform(0 if kind in (2, 3) else -1, 1, (6, d - 1))
        if kind in (2, 3):
            xi[:, 1] *= 1 - xi[:, 0]
        y = evaluate(kind, x, xi)
        up = np.eye(d)[d - 1]
        outward = -up if d == 2 else up
        n = -outward + rng.uniform(-0.3, 0.3, (6, d))
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        g = rng.uniform(-0.7, 0.7, 6)
        r = search(x[None], kind, y - g[:, None] * n, n, method=ray_tracing)
        found = r.facet >= 0
        hit += found.sum()
        np.testing.assert_allclose(r.normal[found], n[found], atol=1e-15)
        np.testing.assert_allclose(r.y[found], evaluate(kind, x, r.xi)[found], atol=1e-11)
        # a bent facet may be met twice; then the nearer meeting counts
        assert (np.abs(r.gap) <= np.abs(g) + 1e-11)[found].all()
        assert np.isclose(r.gap, g, atol=1e-11)[found].mean() > 0.6
    assert hit > 0.95 * 180


def test_rays_do_not_slip_between_facets():
    x = grid_plane(7) @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    normal = np.cross(x[0, 1] - x[0, 0], x[0, 2] - x[0, 0])
    normal /= np.linalg.norm(normal)
    t = np.linspace(0, 1, 101)[:, None, None]
    on_edges = np.concatenate([((1 - t) * x[:, i] + t * x[:, (i + 1) % 3]).reshape(-1, 3) for i in range(3)])
    for gap in (0.3, -0.3, 0.0):
        r = search(x, 2, on_edges + gap * normal, -normal, 0.5, method=ray_tracing)
        assert (r.facet >= 0).all()
        np.testing.assert_allclose(r.gap, gap, atol=1e-14)


@pytest.mark.parametrize("ids", [(0, 1), (1, 0)])
@pytest.mark.parametrize("bend", [0.0, 0.01])
def test_rays_take_the_facet_that_they_hit_whatever_the_numbers(ids, bend):
    """Beside the corner between two facets both are near enough to be hit."""
    x = np.array([[[1.0, bend], [0.0, 0.0]], [[0.0, 0.0], [-1.0, 0.0]]])
    away = np.array([-4e-10, -1e-13, 1e-13, 4e-10])
    points = np.stack([away, np.full(4, 0.5)], axis=1)
    r = search(x, 0, points, [0, -1], 1.0, ids=np.array(ids), method=ray_tracing)
    np.testing.assert_array_equal(r.facet, [1, 1, 0, 0])


def test_rays_take_the_nearest_facing_facet_in_both_directions():
    low, high = grid_plane(2), grid_plane(2) + [0, 0, 1.0]
    x = np.concatenate([low, high, (grid_plane(2) + [0, 0, 0.45])[:, ::-1]])  # the last one faces down
    r = search(x, 2, [[0.3, 0.4, 0.4], [0.3, 0.4, 0.6], [0.3, 0.4, 2.5]], [0, 0, -1], 1.0, method=ray_tracing)
    np.testing.assert_allclose(r.gap[:2], [0.4, -0.4])
    assert r.facet[2] == -1


def test_tree_over_bodies():
    """Every body has a branch of its own, the other branches hold whole bodies; bodies in one place do no harm."""
    rng = np.random.default_rng(5)
    for places in (10.0 * rng.random((7, 3)), np.zeros((7, 3))):
        bodies = np.repeat(rng.permutation(7), rng.integers(5, 60, 7))
        lower = places[bodies] + rng.random((len(bodies), 3))
        tree = build_tree(lower, lower + 0.1, 100 + bodies)
        np.testing.assert_array_equal(np.sort(tree.order), np.arange(len(bodies)))
        inside = [bodies[tree.order[a:b]] for a, b in zip(tree.first, tree.last, strict=True)]
        pure = {int(one[0]) for one in inside if len(one) == np.sum(bodies == one[0]) and np.all(one == one[0])}
        assert pure == set(range(7))
        for one in inside:
            assert len(np.unique(one)) == 1 or len(one) == np.isin(bodies, one).sum()


@pytest.mark.parametrize("d", [2, 3])
def test_nearest_box(d):
    """The distances of numpy, and no distance beyond the radius."""
    rng = np.random.default_rng(d)
    low, points, radius = rng.random((5, d)), 3.0 * rng.random((2000, d)) - 1.0, 0.4
    high = low + 0.3 * rng.random((5, d))
    away = np.maximum(np.maximum(low[:, None] - points, points - high[:, None]), 0.0)
    known = np.linalg.norm(away, axis=2).min(axis=0)
    found = np.empty(len(points))
    nearest_box(np.hstack([low, high]), points, radius, found)
    np.testing.assert_allclose(found, np.where(known <= radius, known, np.inf), rtol=1e-14)
    assert np.any(found == 0.0) and np.any(np.isinf(found))
