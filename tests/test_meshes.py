"""The mesh generators: cells the right way round, groups complete, curves true, bodies apart."""

from __future__ import annotations

import meshio
import numpy as np
import pytest

import meshes
from meshes.__main__ import main

DIMENSION = {"vertex": 0, "line": 1, "triangle": 2, "quad": 2, "tetra": 3, "hexahedron": 3}
VERTICES = {"line": 2, "triangle": 3, "quad": 4, "tetra": 4, "hexahedron": 8}
FACETS = {
    "triangle": [[0, 1], [1, 2], [2, 0]],
    "quad": [[0, 1], [1, 2], [2, 3], [3, 0]],
    "tetra": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    "hexahedron": [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]],
}
# At every corner of a cell: the corner and its neighbours, in an order that makes the determinant positive.
CORNERS = {
    "triangle": [[0, 1, 2]],
    "quad": [[0, 1, 3], [1, 2, 0], [2, 3, 1], [3, 0, 2]],
    "tetra": [[0, 1, 2, 3]],
    "hexahedron": [
        [0, 1, 3, 4],
        [1, 2, 0, 5],
        [2, 3, 1, 6],
        [3, 0, 2, 7],
        [4, 7, 5, 0],
        [5, 4, 6, 1],
        [6, 5, 7, 2],
        [7, 6, 4, 3],
    ],
}
ROUND = {"upper": "upper_skin upper_flat", "lower": "lower_skin lower_flat"}
BLOCK = "block_top block_bottom block_sides"
FOOT = "slab_top slab_bottom slab_sides indenter_top indenter_skin indenter_sides"

# name, arguments, bodies, groups of facets that make up the whole boundary
CASES = [
    ("one_block", {"dim": 2, "n": (3, 2), "size": (3, 1)}, "block", "left right bottom top"),
    ("one_block", {"dim": 2, "n": 3, "cell": "triangle"}, "block", "left right bottom top"),
    ("one_block", {"dim": 3, "n": (3, 2, 2)}, "block", "left right front back bottom top"),
    ("one_block", {"dim": 3, "n": 2, "cell": "tetrahedron"}, "block", "left right front back bottom top"),
    (
        "two_blocks",
        {"gap": 0.1, "offset": 0.2, "widths": (2, 1)},
        "lower upper",
        "left right lower_bottom lower_top upper_bottom upper_top",
    ),
    (
        "two_blocks",
        {"dim": 3, "n_lower": 3, "n_upper": 2, "cell": "tetrahedron", "cell_upper": "hexahedron"},
        "lower upper",
        "left right front back lower_bottom lower_top upper_bottom upper_top",
    ),
    (
        "overclosed_cubes",
        {"n_lower": 3, "n_upper": 2},
        "lower upper",
        "left right front back lower_bottom lower_top upper_bottom upper_top",
    ),
    ("beam", {}, "beam", "left right bottom top"),
    (
        "rings",
        {"n": 4},
        "outer inner",
        "outer_skin outer_inner_skin inner_outer_skin inner_skin symmetry_x symmetry_y",
    ),
    (
        "rings",
        {"n": 4, "cell": "triangle", "symmetry": "none", "delta": 0.01},
        "outer inner",
        "outer_skin outer_inner_skin inner_outer_skin inner_skin",
    ),
    ("disk_on_block", {"h": 0.08}, "disk block", "disk_skin " + BLOCK),
    (
        "disk_on_block",
        {"h": 0.08, "cell": "quadrilateral", "contact_h": 0.03},
        "disk block",
        "disk_skin " + BLOCK,
    ),
    ("cylinders", {"h": 0.3}, "upper lower", " ".join(ROUND.values())),
    (
        "cylinders",
        {"h": 0.3, "half": True, "cell": "quadrilateral"},
        "upper lower",
        " ".join(ROUND.values()) + " symmetry_x",
    ),
    (
        "cylinder_on_block",
        {"h": 0.4, "cell": "quadrilateral"},
        "cylinder block",
        "cylinder_skin cylinder_flat " + BLOCK,
    ),
    (
        "cylinder_on_block",
        {"h": 0.4, "half": True},
        "cylinder block",
        "cylinder_skin cylinder_flat symmetry_x " + BLOCK,
    ),
    ("two_balls", {"h": 4.0}, "upper lower", " ".join(ROUND.values()) + " symmetry_x symmetry_y"),
    ("two_balls", {"h": 6.0, "symmetry": "none"}, "upper lower", " ".join(ROUND.values())),
    ("ball_on_block", {"h": 0.15}, "ball block", "ball_skin ball_top " + BLOCK),
    (
        "ball_on_block",
        {"h": 0.1, "symmetry": "quarter"},
        "ball block",
        "ball_skin ball_top symmetry_x symmetry_y " + BLOCK,
    ),
    ("ironing", {"h": 0.2}, "slab indenter", FOOT),
    ("ironing", {"dim": 3, "h": 0.3}, "slab indenter", FOOT),
    ("ironing", {"dim": 3, "h": 0.4, "cell": "tetrahedron"}, "slab indenter", FOOT),
]
IDS = [f"{name}-{k}" for k, (name, *_) in enumerate(CASES)]


def base(kind: str) -> str:
    """meshio's cell name without the number of nodes."""
    return kind.rstrip("0123456789")


class Read:
    """A mesh read back: points (n, 3), groups as {name: [(cell name, nodes)]} and their dimension."""

    def __init__(self, path):
        mesh = meshio.read(path)
        self.points = mesh.points
        self.groups = {
            name: [
                (base(b.type), b.data[k])
                for b, k in zip(mesh.cells, mesh.cell_sets[name], strict=True)
                if len(k)
            ]
            for name in mesh.field_data
        }
        self.dims = {name: int(dim) for name, (_, dim) in mesh.field_data.items()}
        self.kinds = {b.type for b in mesh.cells}

    def nodes(self, name):
        return np.unique(np.concatenate([nodes.ravel() for _, nodes in self.groups[name]]))

    def x(self, name):
        return self.points[self.nodes(name)]


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    folder, known = tmp_path_factory.mktemp("meshes"), {}

    def make(name, order=1, **arguments):
        key = (name, order, str(arguments))
        if key not in known:
            known[key] = Read(meshes.GENERATORS[name](folder / f"{len(known)}.msh", order=order, **arguments))
        return known[key]

    return make


def corner_jacobians(points, kind, cells):
    """Jacobian determinants at the corners of cells over the lengths of the edges: 1 for a right angle."""
    dim = DIMENSION[kind]
    corner = cells[:, np.array(CORNERS[kind])]
    edges = points[corner[..., 1:]][..., :dim] - points[corner[..., :1]][..., :dim]
    return np.linalg.det(edges) / np.prod(np.linalg.norm(edges, axis=-1), axis=-1)


def facet_set(blocks, kinds=None):
    """Sorted vertex numbers of facets (or, with a table of facets, of all facets of the cells)."""
    rows = []
    for kind, nodes in blocks:
        found = nodes[:, : VERTICES[kind]][:, None] if kinds is None else nodes[:, np.array(kinds[kind])]
        rows += [tuple(row) for row in np.sort(found, axis=2).reshape(-1, found.shape[2]).tolist()]
    return rows


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("name", "arguments", "bodies", "boundary"), CASES, ids=IDS)
def test_cells_are_good_and_bodies_apart(read, name, arguments, bodies, boundary, order):
    mesh = read(name, order, **arguments)
    found = [mesh.nodes(body) for body in bodies.split()]
    assert sum(map(len, found)) == len(np.unique(np.concatenate(found))) == len(mesh.points)
    for body in bodies.split():
        for kind, cells in mesh.groups[body]:
            assert corner_jacobians(mesh.points, kind, cells).min() > 0.1
    linear = {"line", "triangle", "quad", "tetra", "hexahedron"}
    assert mesh.kinds <= linear | {"vertex"} if order == 1 else mesh.kinds.isdisjoint(linear)


@pytest.mark.parametrize(("name", "arguments", "bodies", "boundary"), CASES, ids=IDS)
def test_facet_groups_make_up_the_boundary(read, name, arguments, bodies, boundary):
    mesh = read(name, 1, **arguments)
    cells = [block for body in bodies.split() for block in mesh.groups[body]]
    facets, count = np.unique(np.array([str(f) for f in facet_set(cells, FACETS)]), return_counts=True)
    named = [str(f) for group in boundary.split() for f in facet_set(mesh.groups[group])]
    assert len(named) == len(set(named))
    assert set(named) == set(facets[count == 1])
    assert count.max() <= 2
    assert all(blocks for blocks in mesh.groups.values())


@pytest.mark.parametrize(("name", "arguments", "bodies", "boundary"), CASES, ids=IDS)
def test_groups_are_documented(read, name, arguments, bodies, boundary):
    mesh = read(name, 1, **arguments)
    text = meshes.GENERATORS[name].__doc__ + meshes.two_blocks.__doc__
    stems = ("lower_", "upper_", "corner_")
    missing = [g for g in mesh.groups if g not in text and not g.startswith(stems)]
    assert not missing


@pytest.mark.parametrize(
    ("group", "radius"),
    [("outer_skin", 1.0), ("outer_inner_skin", 0.6), ("inner_outer_skin", 0.61), ("inner_skin", 0.2)],
)
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_rings_are_round(read, cell, group, radius):
    mesh = read("rings", 2, n=3, delta=0.01, cell=cell)
    assert np.hypot(*mesh.x(group).T[:2]) == pytest.approx(radius, abs=1e-14)
    assert np.all(mesh.x("symmetry_x")[:, 0] == 0) and np.all(mesh.x("symmetry_y")[:, 1] == 0)


def test_ring_meshes_do_not_match(read):
    mesh = read("rings", 1, n=5)
    outer, inner = len(mesh.nodes("outer_inner_skin")) - 1, len(mesh.nodes("inner_outer_skin")) - 1
    assert outer == 5 and inner == 7
    # The quadratic polar grid: nodes inside lie on circles too.
    r = np.unique(np.round(np.hypot(*read("rings", 2, n=5).x("outer").T[:2]), 10))
    assert np.diff(r) == pytest.approx(np.diff(r)[0])


@pytest.mark.parametrize(
    ("name", "arguments", "group", "centre", "radius"),
    [
        ("cylinders", {"h": 0.4}, "upper_skin", (0, 8, 0), 8),
        ("cylinders", {"h": 0.4}, "lower_skin", (0, -8, 0), 8),
        ("cylinders", {"h": 0.4, "cell": "quadrilateral"}, "lower_skin", (0, -8, 0), 8),
        ("cylinder_on_block", {"h": 0.4}, "cylinder_skin", (0, 8, 0), 8),
        ("disk_on_block", {"cell": "quadrilateral"}, "disk_skin", (0, 0, 0), 0.25),
        ("two_balls", {"h": 6.0}, "upper_skin", (0, 0, 50), 50),
        ("two_balls", {"h": 6.0}, "lower_skin", (0, 0, -50), 50),
        ("ball_on_block", {"h": 0.15}, "ball_skin", (0, 0, 1), 1),
        ("ironing", {"h": 0.2, "cell": "triangle"}, "indenter_skin", (0, 1, 0), 1),
        ("ironing", {"dim": 3, "h": 0.3}, "indenter_skin", (0, 0, 1), 1),
    ],
)
def test_degree_two_nodes_lie_on_the_curve(read, name, arguments, group, centre, radius):
    mesh = read(name, 2, **arguments)
    assert np.linalg.norm(mesh.x(group) - centre, axis=1) == pytest.approx(radius, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "arguments", "where"),
    [
        ("disk_on_block", {}, {"pin_0": (0, 0, 0), "pin_1": (0, 0.1, 0), "disk_tip": (0, -0.25, 0)}),
        (
            "cylinders",
            {"h": 0.3},
            {"upper_tip": (0, 0, 0), "lower_tip": (0, 0, 0), "upper_center": (0, 8, 0)},
        ),
        (
            "ball_on_block",
            {"h": 0.15},
            {"ball_tip": (0, 0, 0), "block_origin": (0, 0, 0), "ball_center": (0, 0, 1)},
        ),
        (
            "overclosed_cubes",
            {"n_lower": 3, "n_upper": 2},
            {"lower_origin": (0, 0, 0), "upper_corner_101": (1, 0, 1.99)},
        ),
        (
            "two_blocks",
            {"gap": 0.1, "offset": 0.2},
            {"upper_origin": (0.2, 1.1, 0), "lower_corner_10": (1, 0, 0)},
        ),
    ],
)
def test_points(read, name, arguments, where):
    mesh = read(name, 1, **arguments)
    for group, point in where.items():
        assert mesh.dims[group] == 0
        assert mesh.x(group) == pytest.approx(np.array([point]), abs=1e-12)


def test_symmetry_lines_inside_cylinders(read):
    mesh = read("cylinders", 2, h=0.3)
    assert np.all(mesh.x("upper_axis")[:, 0] == 0) and np.ptp(mesh.x("lower_axis")[:, 1]) == pytest.approx(8)


def test_size_at_the_contact(read):
    for cell in ("triangle", "quadrilateral"):
        mesh = read("cylinders", 1, h=0.1, cell=cell)
        x = np.sort(mesh.x("upper_skin")[:, 0])
        assert np.diff(x[abs(x) < 0.9]) == pytest.approx(0.1, rel=0.2)


@pytest.mark.parametrize(("order", "symmetry"), [(1, "none"), (1, "quarter"), (2, "none")])
def test_wanted_number_of_unknowns(tmp_path, order, symmetry):
    mesh = Read(meshes.ball_on_block(tmp_path / "b.msh", order=order, symmetry=symmetry, unknowns=15_000))
    assert 3 * len(mesh.points) == pytest.approx(15_000, rel=0.1)


def test_too_few_unknowns(tmp_path):
    with pytest.raises(RuntimeError, match="unknowns wanted"):
        meshes.ball_on_block(tmp_path / "b.msh", unknowns=30)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [("ball_on_block", {"h": 0.15}), ("rings", {}), ("cylinders", {"h": 0.3, "cell": "quadrilateral"})],
)
def test_same_file_every_time(tmp_path, name, arguments):
    first, second = (meshes.GENERATORS[name](tmp_path / f"{k}.msh", **arguments).read_bytes() for k in "ab")
    assert first == second
    assert first.startswith(b"$MeshFormat\n4.1 1 8\n")


def test_command(tmp_path, capsys):
    assert main([]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in meshes.GENERATORS)
    assert main(["two_blocks", "-o", str(tmp_path / "a.msh"), "--n-lower", "2,3", "--cell", "triangle"]) == 0
    assert len(Read(tmp_path / "a.msh").groups["lower"][0][1]) == 12
    assert main(["two_blocks", "-o", str(tmp_path / "b.msh"), "--cell", "hexahedron"]) == 2
    assert not (tmp_path / "b.msh").exists()
