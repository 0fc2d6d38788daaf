"""Rigid surfaces of facets: files, sides, distances and normals."""

import meshio
import numpy as np
import pytest

from pcontact.contact.surface.obstacle import RigidSurface
from pcontact.mesh.read import read_surface
from pcontact.runtime.errors import InputError

WHERE = "scene.toml", "contacts[0] (pair).obstacle"
LOW, HIGH = np.array([-0.4, 0.1, 0.3]), np.array([0.6, 0.9, 1.4])


def box(cell, n=2):
    """Nodes and facets of a box in n^2 facets a side, each side with nodes of its own and any direction."""
    points, facets, rng = [], [], np.random.default_rng(1)
    s = np.linspace(0.0, 1.0, n + 1)
    for axis in range(3):
        for value in (0.0, 1.0):
            first = len(points)
            for a in s:
                for b in s:
                    points.append(np.insert([a, b], axis, value))
            for i in range(n):
                for j in range(n):
                    k = first + i * (n + 1) + j
                    quad = [k, k + 1, k + n + 2, k + n + 1]
                    quad = quad if rng.random() < 0.5 else quad[::-1]
                    facets += [quad] if cell == "quad" else [quad[:3], [quad[0], *quad[2:]][:: rng.choice([-1, 1])]]
    return LOW + np.array(points) * (HIGH - LOW), np.array(facets)


def box_distance(x, low, high):
    """Signed distance of a box."""
    q = np.maximum(low - x, x - high)
    return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)


def surface_of(path, points, cell, facets, dim=3, inside=False, region=None):
    meshio.write(path, meshio.Mesh(points, [(cell, facets)]))
    return RigidSurface(read_surface(path, dim, region, WHERE), inside)


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("cell, name", [("triangle", "box.vtu"), ("quad", "box.vtu"), ("triangle", "box.stl")])
def test_a_box(tmp_path, cell, name, inside):
    """All nodes of the sides are there twice or more, and facets face anywhere."""
    surface = surface_of(tmp_path / name, *(box(cell)[0], cell, box(cell)[1]), inside=inside)
    x = np.random.default_rng(3).uniform(-1.5, 2.5, (2000, 3))
    distance, normal = surface(x - surface.place, 0.0)
    expected = box_distance(x, LOW, HIGH) * (-1.0 if inside else 1.0)
    digits = 1e-7 if name.endswith("stl") else 1e-14
    np.testing.assert_allclose(distance, expected, atol=digits)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-14)
    h = 1e-6
    ends = [(surface(x + h * e - surface.place, 0.0), surface(x - h * e - surface.place, 0.0)) for e in np.eye(3)]
    slope = np.column_stack([(a[0] - b[0]) / (2.0 * h) for a, b in ends])
    smooth = np.all([np.abs(a[1] - b[1]).max(axis=1) < 1e-3 for a, b in ends], axis=0)
    np.testing.assert_allclose(normal[smooth], slope[smooth], atol=1e-7)
    assert np.sum(smooth) > 1900


def test_places_on_the_surface(tmp_path):
    """Facets, edges and corners: the normal is that of the side, or between the sides."""
    surface = surface_of(tmp_path / "box.vtu", *(box("quad")[0], "quad", box("quad")[1]))
    middle, edge = 0.5 * (LOW + HIGH), np.array([0.6, 0.9, 0.7])
    places = np.array([[HIGH[0], middle[1] + 0.01, middle[2] + 0.01], edge, HIGH])
    distance, normal = surface(places - surface.place, 0.0)
    np.testing.assert_allclose(distance, 0.0, atol=1e-15)
    half, third = np.sqrt(0.5), np.sqrt(1.0 / 3.0)
    np.testing.assert_allclose(normal, [[1, 0, 0], [half, half, 0], [third] * 3], atol=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_circle(tmp_path, degree):
    """Segments of a polygon, or arcs that are a hundredth of its error off."""
    n = 24
    t = 2.0 * np.pi * np.arange(n * degree) / (n * degree)
    points = np.column_stack([np.cos(t), np.sin(t), 0.0 * t])
    ends = degree * np.arange(n + 1) % (n * degree)
    facets = np.column_stack([ends[:-1], ends[1:]])
    if degree == 2:
        facets = np.column_stack([facets, ends[:-1] + 1])
    facets[::3, :2] = facets[::3, 1::-1]
    surface = surface_of(tmp_path / "circle.vtu", points, "line" if degree == 1 else "line3", facets, 2)
    x = np.random.default_rng(3).normal(size=(500, 2))
    length = np.linalg.norm(x, axis=1)
    distance, normal = surface(x - surface.place, 0.0)
    chord = 1.0 - np.cos(np.pi / n)
    some = length > 0.2
    off = np.abs(distance - (length - 1.0))[some].max()
    assert 0.5 * chord < off < 1.01 * chord if degree == 1 else off < 0.01 * chord
    turned = np.linalg.norm(normal - x / length[:, None], axis=1)[some & (np.abs(length - 1.0) > 0.1)]
    assert turned.max() < (0.2 if degree == 1 else 5e-3)


@pytest.mark.parametrize("cell", ["triangle6", "quad8", "quad9"])
def test_a_curved_patch(tmp_path, cell):
    """One facet of degree 2 that bends: closest points by many points of its map."""
    s = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0], [0.5, 0.5], [0, 0.5]]) if cell == "triangle6" else np.array(
        [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [1, 0.5], [0.5, 1], [0, 0.5], [0.5, 0.5]])  # fmt: skip

    def place(s):
        return np.column_stack([s, 0.3 * s[:, 0] ** 2 - 0.2 * s[:, 0] * s[:, 1]])

    points = place(s[:8] if cell == "quad8" else s)
    surface = surface_of(tmp_path / "patch.vtu", points, cell, np.arange(len(points))[None])
    grid = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 401)] * 2), axis=-1).reshape(-1, 2)
    grid = grid[grid.sum(axis=1) <= 1.0] if cell == "triangle6" else grid
    x = np.random.default_rng(5).uniform([-0.2, -0.2, -0.3], [1.2, 1.2, 0.5], (60, 3))
    distance, _ = surface(x - surface.place, 0.0)
    cloud = place(grid)
    nearest = np.array([np.linalg.norm(cloud - one, axis=1).min() for one in x])
    # a place of the cloud is at most half a diagonal of the grid beside the nearest one of the patch, 1.2 times as long
    assert np.all(np.abs(distance) <= nearest + 1e-12)
    assert np.max(nearest**2 - distance**2) <= (1.2 * np.sqrt(0.5) / 400.0) ** 2
    over = (x[:, :2] > 0.05).all(axis=1) & (x[:, :2].sum(axis=1) < 0.9)
    above = x[over, 2] - place(x[over, :2])[:, 2]
    assert np.array_equal(distance[over] > 0.0, above > 0.0) and np.sum(over) > 5


def test_surfaces_that_are_none(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.0]])
    cases = {
        "that meet at": (points, [[0, 1, 2], [0, 1, 3], [0, 1, 4]]),
        "face both ways": moebius(),
    }
    for words, (nodes, facets) in cases.items():
        with pytest.raises(InputError, match=f"obstacle.file: found .*{words}"):
            surface_of(tmp_path / "bad.vtu", nodes, "triangle", np.array(facets))
    with pytest.raises(InputError, match="without facets; allowed: a file with segments"):
        surface_of(tmp_path / "bad.vtu", points, "triangle", np.array([[0, 1, 2]]), 2)
    with pytest.raises(InputError, match="obstacle.region: found 'face'"):
        surface_of(tmp_path / "bad.vtu", points, "triangle", np.array([[0, 1, 2]]), region="face")


def moebius(n=9):
    """A strip that is closed with half a turn."""
    t = 2.0 * np.pi * np.arange(n) / n
    out = np.column_stack([np.cos(t), np.sin(t), 0.0 * t])
    way = 0.3 * np.column_stack([np.cos(t / 2) * np.cos(t), np.cos(t / 2) * np.sin(t), np.sin(t / 2)])
    points = np.vstack([out - way, out + way])
    facets = []
    for k in range(n):
        a, b = k, n + k
        c, d = (k + 1, n + k + 1) if k + 1 < n else (n, 0)
        facets += [[a, c, b], [c, d, b]]
    return points, facets
