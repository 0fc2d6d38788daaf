"""Source facets in space cut along the edges of the target: tiles, patch tests, several ranks."""

import numpy as np
import pytest

from drivers.cases.patch import errors, scene
from pcontact.contact.segmentation.overlaps import Polygons, Tiles, tile
from pcontact.contact.segmentation.overlaps import tiles as tiles_of
from pcontact.contact.segmentation.pieces import cut_source, cuts
from pcontact.contact.surface.facet_maps import SQUARE_CORNERS, TRIANGLE_CORNERS
from pcontact.contact.surface.sides import at_places, source_surface, target_surface
from pcontact.element.reference import facet_nodes, shape
from pcontact.runtime.petsc import MPI
from tests.support.patch import blocks, solve
from tests.support.small import SELF, make_space

WORLD = MPI.COMM_WORLD
ROUNDOFF = 1e-9
DOMAINS = {"triangle": TRIANGLE_CORNERS, "square": SQUARE_CORNERS}


def found_tiles(domain, polygons, corners):
    """Tiles (n, 3, 2) of one facet, their numbers of vertices (n,), and whether it was cut."""
    first, cut = np.array([0, len(corners)]), np.zeros(1, dtype=bool)
    polygons = Polygons(np.ascontiguousarray(polygons, dtype=float), np.array(corners, dtype=np.int64))
    none = np.zeros(0, np.int64)
    room = tile(domain, first, polygons, cut, Tiles(none, none, np.zeros((0, 3, 2))))
    found = Tiles(np.zeros(room, np.int64), np.zeros(room, np.int64), np.zeros((room, 3, 2)))
    assert tile(domain, first, polygons, cut, found) == room
    assert set(found.kinds) <= {3, 4}
    return found.vertices, found.kinds, bool(cut[0])


def tiles(domain, polygons, corners):
    """Tiles (n, 3, 2) of one facet, parallelograms as two triangles, and whether it was cut."""
    found, kinds, cut = found_tiles(domain, polygons, corners)
    whole = found[kinds == 4]
    others = np.stack([whole[:, 1] + whole[:, 2] - whole[:, 0], whole[:, 2], whole[:, 1]], axis=1)
    return np.concatenate([found, others]), cut


def centres(found, kinds, image):
    """Centres (n, 2) of tiles, moved back from an affine image of their facet, in order."""
    centre = np.where((kinds == 3)[:, None], found.mean(axis=1), found[:, 1:].mean(axis=1))
    back = (centre - image[:, 2]) @ np.linalg.inv(image[:, :2]).T
    return back[np.lexsort(np.rint(back.T * 1e9))]


def areas(found):
    a, b = found[:, 1] - found[:, 0], found[:, 2] - found[:, 0]
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def grid(n, turn, low=-2.0, high=2.0):
    """Triangles of a turned grid that covers both domains."""
    s = np.linspace(low, high, n + 1)
    c = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    p = [[(s[i + a], s[j + b]) for a, b in corner] for i in range(n) for j in range(n)
         for corner in (((0, 0), (1, 0), (1, 1), (1, 1)), ((0, 0), (1, 1), (0, 1), (0, 1)))]  # fmt: skip
    return np.array(p) @ c.T, np.full(2 * n * n, 3)


def inside(points, polygon):
    """How far (..., n) points (n, 2) are inside triangles (..., 3, 2), negative outside."""
    ahead = (np.roll(polygon, -1, axis=-2) - polygon)[..., None, :, :]
    away = points[:, None] - polygon[..., None, :, :]
    d = ahead[..., 0] * away[..., 1] - ahead[..., 1] * away[..., 0]
    return d.min(axis=-1)


@pytest.mark.parallel
@pytest.mark.parametrize("order", [1, 2])
def test_cuts_in_the_plane_are_at_the_ends_of_facets_to_rounding(shared_tmp, order):
    """Flat surfaces, 0.05 apart: pieces end where facets of either side end."""
    path = blocks(shared_tmp, "triangle", 7, 3, gap=0.05)
    space = make_space(WORLD, path, ["lower", "upper"], order)
    parts, target = space.mesh.facet_groups.get("upper_bottom", []), target_surface(space, "lower_top")
    part, row, _, a, b = cuts(space, parts, (target, 1.0, "closest_point"))
    ends = [np.zeros(0)]
    for k, facets in enumerate(parts):
        chosen = part == k
        ends += [at_places(space, facets, row[chosen], s[chosen, None])[0][:, 0] for s in (a, b)]
    found = np.concatenate(WORLD.allgather(np.concatenate(ends)))
    known = np.unique(np.round(np.concatenate([np.arange(8) / 7, np.arange(4) / 3]), 15))
    away = np.abs(found[:, None] - known)
    assert np.unique(away.argmin(axis=1)).size == known.size
    assert away.min(axis=1).max() < 1e-13


@pytest.mark.parametrize("domain", list(DOMAINS))
@pytest.mark.parametrize("n, turn", [(2, 0.0), (3, 0.4), (11, 1.1), (40, 0.7)])
def test_tiles_fill_the_facet_and_cross_no_edge(domain, n, turn):
    polygons, corners = grid(n, turn, -3.0, 3.0)
    found, cut = tiles(DOMAINS[domain], polygons, corners)
    whole = 0.5 if domain == "triangle" else 4.0
    assert cut and np.all(areas(found) > 0.0)
    assert areas(found).sum() == pytest.approx(whole, rel=1e-13)
    polygons = polygons[(polygons.min(axis=1) < 1.0).all(axis=1) & (polygons.max(axis=1) > -1.0).all(axis=1)]
    for corner in found:
        mean = corner.mean(axis=0)[None]
        home = int(np.argmax(inside(mean, polygons[:, :3])))
        assert inside(corner, polygons[home][:3]).min() > -1e-12


@pytest.mark.parametrize("domain", list(DOMAINS))
def test_what_is_not_covered_is_tiled_too(domain):
    """A target that ends within the facet: its area comes out of some triangles, the rest out of others."""
    polygons, corners = grid(3, 0.3, -0.1, 0.35)
    found, cut = tiles(DOMAINS[domain], polygons, corners)
    assert cut and areas(found).sum() == pytest.approx(0.5 if domain == "triangle" else 4.0, rel=1e-12)
    means = found.mean(axis=1)
    covered = np.max([inside(means, p[:3]) for p in polygons], axis=0) > 0.0
    if domain == "square":
        assert areas(found[covered]).sum() == pytest.approx(0.45**2, rel=1e-12)
    assert 0.0 < areas(found[covered]).sum() < areas(found).sum()


def test_the_nearest_of_several_layers_counts():
    near, far = grid(3, 0.3, -3.0, 3.0), grid(4, 0.9, -3.0, 3.0)
    alone, _ = tiles(SQUARE_CORNERS, *near)
    both, cut = tiles(SQUARE_CORNERS, np.concatenate([near[0], far[0]]), np.concatenate([near[1], far[1]]))
    assert cut and areas(both).sum() == pytest.approx(4.0, rel=1e-12)
    for corner in both:
        home = int(np.argmax([inside(corner.mean(axis=0)[None], p[:3])[0] for p in near[0]]))
        assert inside(corner, near[0][home][:3]).min() > -1e-12


def test_a_facet_without_target_is_not_cut():
    polygons, corners = grid(2, 0.0, 5.0, 6.0)
    found, cut = tiles(SQUARE_CORNERS, polygons, corners)
    assert not cut and len(found) == 0


@pytest.mark.slow
@pytest.mark.parallel
@pytest.mark.parametrize("unbiased", [False, True])
@pytest.mark.parametrize(
    "cell, upper, order",
    [("hexahedron", None, 1), ("tetrahedron", None, 1), ("hexahedron", None, 2), ("tetrahedron", None, 2),
     ("tetrahedron", "hexahedron", 2)],
)  # fmt: skip
def test_patch_is_exact_on_any_meshes(shared_tmp, cell, upper, order, unbiased):
    """A coarse source on a fine target, where whole facets are wrong by percents; by default with degree 2."""
    path = blocks(shared_tmp, cell, 3, 2, cell_upper=upper)
    said = {} if order == 2 else {"cut": True}
    for theta in (1.0, -1.0) if WORLD.size == 1 else (0.0,):
        assert max(solve(scene(path, 3, order, theta=theta, unbiased=unbiased, **said), errors)) < ROUNDOFF, theta
    assert max(solve(scene(path, 3, order, unbiased=unbiased, cut=False, quadrature=7), errors)) > 1e-4


@pytest.mark.parallel
@pytest.mark.parametrize("cell, other", [("tetrahedron", None), ("hexahedron", None), ("tetrahedron", "hexahedron")])
def test_the_coarser_source_is_cut_by_default(shared_tmp, cell, other):
    """With degree 1: facets a third longer than the target's, whatever the cells are; no longer ones are not."""
    assert max(solve(scene(blocks(shared_tmp, cell, 4, 3, cell_upper=other), 3), errors)) < ROUNDOFF
    assert max(solve(scene(blocks(shared_tmp, cell, 3, 4, cell_upper=other), 3), errors)) > 1e-4


@pytest.mark.parallel
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_pieces_are_those_of_one_rank(shared_tmp, cell):
    """Number, area and moments of all pieces, however the facets of both sides are spread."""
    path = blocks(shared_tmp, cell, 3, 2)
    sums = []
    for comm in (WORLD, SELF):
        space = make_space(comm, path, ["lower", "upper"])
        source = source_surface(space, "upper_bottom", [(50.0, 50.0), (50.0, 50.0)])
        target = target_surface(space, "lower_top")
        part, *_ = tiles_of(space, space.mesh.facet_groups.get("upper_bottom", []), target)
        cut = cut_source(space, source, "upper_bottom", target, 1.0, "closest_point")
        own = np.array([len(part), len(cut.facet), cut.jxw.sum(), *(cut.jxw @ cut.x), *(cut.jxw @ cut.x**2)])
        sums.append(comm.allreduce(own))
        assert np.all(cut.jxw > 0.0)
        per_facet = np.bincount(cut.facet, cut.jxw, minlength=len(cut.cells))
        assert per_facet == pytest.approx(np.bincount(source.facet, source.jxw, minlength=len(cut.cells)), rel=1e-12)
        assert np.all(np.diff(cut.facet) >= 0)
    assert sums[0] == pytest.approx(sums[1], rel=1e-12)
    assert sums[0][0] > 3 * 2 * 2


@pytest.mark.parametrize("domain", list(DOMAINS))
@pytest.mark.parametrize("low, high", [(-3.0, 3.0), (-0.1, 0.35)])
def test_tiles_depend_on_shapes_alone(domain, low, high):
    """Other first vertices, the facet seen from another corner or from behind, other numbers: the same tiles."""
    polygons, corners = grid(3, 0.37, low, high)
    vertices, random = DOMAINS[domain], np.random.default_rng(4)
    first = centres(*found_tiles(vertices, polygons, corners)[:2], np.eye(2, 3))
    for image in images(vertices):
        mirrored = np.linalg.det(image[:, :2]) < 0.0
        moved = polygons @ image[:, :2].T + image[:, 2]
        moved[:, :3] = moved[:, 2::-1] if mirrored else moved[:, :3]
        starts = random.integers(3, size=len(moved))
        moved = np.array([np.roll(p[:3], k, axis=0)[[0, 1, 2, 2]] for p, k in zip(moved, starts, strict=True)])
        found = centres(*found_tiles(vertices, moved[random.permutation(len(moved))], corners)[:2], image)
        assert found == pytest.approx(first, abs=1e-12)


def images(vertices):
    """Affine maps (2, 3) of a reference domain onto itself."""
    n, found = len(vertices), []
    for start in range(n):
        for step in (1, -1):
            a, b, c = (vertices[(start + k * step) % n] for k in (0, 1, n - 1))
            origin, sides = vertices[0], np.array([vertices[1] - vertices[0], vertices[n - 1] - vertices[0]]).T
            matrix = np.array([b - a, c - a]).T @ np.linalg.inv(sides)
            found.append(np.column_stack([matrix, a - matrix @ origin]))
    return found


@pytest.mark.parametrize("taper", [0.2, 0.7])
@pytest.mark.parametrize("quarter", range(4))
def test_large_targets_cut_small_trapezoids(shared_tmp, taper, quarter):
    """Four target facets, 20 times as large, meet under a trapezoid: no tile reaches into two, however it is turned."""
    path = blocks(shared_tmp, "hexahedron", 2, 1, gap=0.05)

    def change(points):
        upper = points[:, 2] > 1.0
        points[:, :2] -= 0.5
        points[~upper, :2] *= 20.0
        points[upper, 0] *= 1.0 - 2.0 * taper * points[upper, 1]
        points[upper, :2] += (0.07, 0.03)
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
        points[upper, :2] = points[upper, :2] @ np.array([[c, s], [-s, c]])
        return points

    space = make_space(SELF, path, ["lower", "upper"], 1, change)
    parts, target = space.mesh.facet_groups["upper_bottom"], target_surface(space, "lower_top")
    _, _, kinds, found = tiles_of(space, parts, target)
    block = space.mesh.blocks[parts[0].block]
    nodes = block.nodes[parts[0].cells[:, None], facet_nodes("hexahedron", 1)[parts[0].local]][0]
    others = np.where((kinds == 4)[:, None], found[:, 1] + found[:, 2] - found[:, 0], found[:, 0])
    every = np.concatenate([found, others[:, None]], axis=1)
    places = shape("quadrilateral", 1, every.reshape(-1, 2)) @ space.mesh.points[nodes, :2]
    places = places.reshape(every.shape)
    # the lines on which target facets meet are straight in the facet's reference domain, which moves them a little
    low, high = places.min(axis=1), places.max(axis=1)
    assert np.all((low > -0.02) | (high < 0.02))
    assert abs(np.sum(np.where(kinds == 4, 2.0, 1.0) * areas(found)) - 4.0) < 1e-12
    assert len(kinds) == 8
