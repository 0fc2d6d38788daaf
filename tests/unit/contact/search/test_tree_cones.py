"""What the search leaves out by cones of normals: the same partners as without them, with fewer facets tried."""

import numpy as np
import pytest

from meshes import spring
from pcontact.contact.search.projection import QueryPoints, TargetFacets, closest_points
from pcontact.contact.search.self_contact import self_surface
from pcontact.contact.search.tree import build_tree, normal_cones
from pcontact.contact.surface.facet_maps import facet_boxes
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.mesh.read import read_mesh
from pcontact.mesh.topology import components
from pcontact.space.space import Space
from tests.support.dealt import distribute
from tests.support.pairs import CONSTANTS
from tests.support.self_contact import ALONE, annulus, skin_of
from tests.support.small import DIMENSION, SELF, block_file

SHAPES = {
    "bumps": lambda x: annulus(x, 5.0, 1.0 + 0.1 * np.sin(40.0 * x[:, 0]), 1.4),
    "wavy block": lambda x: x + 0.05 * np.sin(9.0 * x[:, ::-1]),
    "spikes": lambda x: x * (1.0 + 0.08 * np.sin(37.0 * x.sum(axis=1)))[:, None],
    **{key: ALONE[key] for key in ("plate", "thick shell", "edge of a knife")},
}


def same(surface, nodal, points, normals, radius, about=None):
    """Compares both searches; facets tried per point without and with cones."""
    x, kinds, ids, own, corners = surface.around(np.ascontiguousarray(surface.deformed(nodal)))
    tree = build_tree(*facet_boxes(x, kinds))
    exclusion = surface.exclusion(tree)
    cones = normal_cones(tree, x, kinds, corners, None if about is None else exclusion)
    exclusion = None if about is None else surface.placed(exclusion, about)
    query = QueryPoints(points, normals, radius)
    all_, some = (
        closest_points(TargetFacets(tree, x, kinds, ids, own, said), query, exclusion=exclusion)
        for said in (None, cones)
    )
    np.testing.assert_array_equal(some.id, all_.id)
    for key in ("xi", "y", "normal", "gap"):
        np.testing.assert_array_equal(getattr(some, key), getattr(all_, key))
    return all_.candidates.mean(), some.candidates.mean(), np.mean(all_.facet >= 0)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", list(DIMENSION))
@pytest.mark.parametrize("shape", list(SHAPES))
def test_partners_are_the_same(tmp_path, shape, cell, degree):
    """Of points all around and inside, with any normals; and of the surface itself, moved into itself."""
    d = DIMENSION[cell]
    space = skin_of(SELF, block_file(tmp_path / "b.msh", cell, [6, *[2] * (d - 1)]), SHAPES[shape], degree)
    source = source_surface(space, "skin", [CONSTANTS], 3)
    target = self_surface(space, target_surface(space, "skin"), source)
    random = np.random.default_rng(3)
    low, high = space.points.min(axis=0), space.points.max(axis=0)
    points = low + (high - low) * random.uniform(-0.3, 1.3, (200, d))
    normals = random.normal(size=(200, d))
    radius = np.linalg.norm(high - low)
    moved = 0.05 * radius * np.sin(3.0 * space.points[:, ::-1] / radius * np.arange(1, d + 1))
    tried, left, paired = same(target, moved, points, normals, radius)
    assert left <= tried and 0.2 < paired
    x = source.x + np.einsum("pa,pad->pd", source.shape, moved[source.cells[source.facet]])
    same(target, moved, x, source.normal, radius, target.about)
    # points on nodes and edges: what touches takes the mean of the normals there
    same(target, 0.0 * moved, space.points[:60], random.normal(size=space.points[:60].shape), radius)


def test_few_facets_of_a_spring_are_tried(tmp_path):
    """Half of its points have no partner within the radius, a hundred facets near them."""
    path = spring(tmp_path / "s.msh", 0.5, coils=3.0, pitch=3.0, ends="ground")
    raw = read_mesh(path)
    mesh = distribute(SELF, raw, False, np.zeros(len(raw.blocks[0].nodes), dtype=np.int64), components(raw), None)
    mesh.component_names = ["spring"]
    space = Space(mesh, 1)
    source = source_surface(space, "spring_skin", [CONSTANTS], 1)
    target = self_surface(space, target_surface(space, "spring_skin"), source)
    nodal = np.zeros_like(space.points)
    nodal[:, 2] = -0.2 * space.points[:, 2]
    x = source.x + np.einsum("pa,pad->pd", source.shape, nodal[source.cells[source.facet]])
    tried, left, paired = same(target, nodal, x, source.normal, 4.0, target.about)
    assert 0.2 < paired < 0.8
    assert left < 0.3 * tried
