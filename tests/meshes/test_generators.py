"""The mesh generators: cells the right way round, groups complete, curves true, bodies apart."""

from __future__ import annotations

import meshio
import numpy as np
import pytest

import meshes
from meshes.__main__ import main
from meshes.halve import halve
from meshes.spring import Helix
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import facet_nodes, shape_gradient
from pcontact.mesh.read import read_mesh

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
PIPE = "inner outer side_x side_y"
DENT = "block_top block_bottom block_side"
SNAP = "clip_root clip_skin clip_sides catch_skin catch_base catch_sides"
SNAP_ENDS = " clip_front clip_back catch_front catch_back"
C_STRIP = "strip_inner strip_outer lip_upper lip_lower"
IRON = "foundation_top foundation_bottom foundation_sides slab_skin slab_top"
FOOT = "slab_top slab_bottom slab_sides indenter_top indenter_skin indenter_sides"

STACK = "top top_rim top_under bottom_over bottom_rim bottom_under axis small_lower small_upper large_lower large_upper"

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
    ("ironing_slab", {"n": 2}, "foundation slab", IRON),
    ("ironing_slab", {"n": 2, "cell": "triangle"}, "foundation slab", IRON),
    (
        "hemisphere_on_cube",
        {"n": 4},
        "hemisphere cube",
        "hemisphere_skin hemisphere_inside hemisphere_top cube_top cube_bottom cube_sides",
    ),
    ("pad_on_ring", {"n": 2}, "ring pad", "ring_top ring_bottom ring_sides pad_bottom pad_top pad_sides"),
    ("disk", {"n": 2}, "disk", "bottom top sides"),
    (
        "rounded_punch", {"h": 20.0}, "punch block",
        "punch_skin punch_side punch_top block_bottom block_side block_top axis",
    ),
    (
        "cube_on_block", {}, "punch block",
        "punch_face punch_top punch_side block_under block_top block_bottom block_side symmetry_x symmetry_y",
    ),
    ("lug_on_pin", {"h": 5.0}, "lug pin", "lug_bore lug_end lug_skin pin_skin pin_hole"),
    (
        "disc_in_press", {"h": 2.0}, "stamp disc anvil",
        "stamp_skin stamp_side stamp_top disc_top disc_bottom disc_rim anvil_top anvil_side anvil_bottom axis",
    ),
    (
        "crowned_roller", {"h": 2.0}, "roller block",
        "roller_tread roller_top roller_end block_top block_bottom block_sides symmetry_y",
    ),
    ("seal", {"n": (2, 12)}, "seal", "base outside inside symmetry"),
    ("seal", {"n": (2, 12), "cell": "triangle"}, "seal", "base outside inside symmetry"),
    ("cook", {"n": 4}, "panel", "left right bottom top"),
    ("cook", {"n": 3, "cell": "triangle"}, "panel", "left right bottom top"),
    ("round_bar", {"n": (3, 5)}, "bar", "axis middle end side"),
    ("round_bar", {"n": (3, 5), "cell": "triangle", "waist": 1.0}, "bar", "axis middle end side"),
    ("thick_cylinder", {"n": (3, 4), "grading": 3.0}, "body", PIPE),
    ("thick_cylinder", {"n": (3, 4), "cell": "triangle"}, "body", PIPE),
    ("thick_cylinder", {"dim": 3, "n": (3, 4), "height": 40.0}, "body", PIPE + " front back"),
    (
        "thick_cylinder",
        {"dim": 3, "n": (3, 4), "layers": 2, "height": 40.0, "cell": "tetrahedron"},
        "body",
        PIPE + " front back",
    ),
    ("cylinder_strip", {"n": (4, 2)}, "body", "inner outer bottom top"),
    (
        "cylinder_strip",
        {"n": (4, 2), "cell": "triangle", "inner": 0.0, "height": 80.0},
        "body",
        "inner outer bottom top",
    ),
    ("indent", {"h": 0.2}, "block", "axis " + DENT),
    ("indent", {"h": 0.2, "radius": 1.0}, "block ball", "axis ball_skin ball_top " + DENT),
    ("indent", {"h": 0.2, "radius": 1.0, "cell": "triangle"}, "block ball", "axis ball_skin ball_top " + DENT),
    ("indent", {"dim": 3, "h": 0.25}, "block", "side_x side_y " + DENT),
    ("indent", {"dim": 3, "h": 0.5, "mirrored": True}, "block", "side_y " + DENT),
    ("balls", {"h": 0.1}, "upper", "upper_skin upper_back axis"),
    ("balls", {"h": 0.1, "two": True, "gap": 0.1, "cell": "quadrilateral"}, "upper lower",
     "upper_skin upper_back lower_skin lower_back axis"),
    ("sphere_stack", {"h": 1.0}, "top_plate small large bottom_plate", STACK),
    ("cylinders", {"h": 0.4, "half": True, "single": True}, "upper", ROUND["upper"] + " symmetry_x"),
    ("indent", {"dim": 3, "h": 0.25, "radius": 1.0}, "block ball", "side_x side_y ball_skin ball_top " + DENT),
    (
        "indent",
        {"dim": 3, "h": 0.2, "radius": 1.0, "cell": "tetrahedron"},
        "block ball",
        "side_x side_y ball_skin ball_top " + DENT,
    ),
    ("clip", {"h": 0.2}, "clip catch", SNAP),
    ("clip", {"h": 0.2, "cell": "quadrilateral"}, "clip catch", SNAP),
    ("clip", {"dim": 3, "h": 0.2}, "clip catch", SNAP + SNAP_ENDS),
    ("clip", {"dim": 3, "h": 0.1, "cell": "tetrahedron", "width": 0.6}, "clip catch", SNAP + SNAP_ENDS),
    ("spring", {"h": 1.0, "coils": 1.5}, "spring", "spring_skin end_bottom end_top"),
    ("spring", {"h": 1.0, "coils": 3.0, "ends": "closed"}, "spring", "spring_skin end_bottom end_top"),
    ("spring", {"h": 0.5, "coils": 2.5, "ends": "ground"}, "spring", "spring_skin end_bottom end_top wire_ends"),
    ("c_strip", {"n": (2, 16), "split": True}, "strip_upper strip_lower", C_STRIP + " back"),
    ("c_strip", {"n": (2, 24), "cell": "triangle", "split": True}, "strip_upper strip_lower", C_STRIP + " back"),
]
IDS = [f"{name}-{k}" for k, (name, *_) in enumerate(CASES)]


def base(kind: str) -> str:
    """meshio's cell name without the number of nodes."""
    return kind.rstrip("0123456789")


class Read:
    """A mesh read back: points (n, 3), groups as {name: [(cell name, nodes)]} and their dimension."""

    def __init__(self, path):
        self.path, mesh = path, meshio.read(path)
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
    # The program's reader refuses cells whose Jacobian changes sign, and facets that belong to no cell.
    assert set(read_mesh(mesh.path).cell_groups) == set(bodies.split())


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
    [
        ("ball_on_block", {"h": 0.15}),
        ("rings", {}),
        ("cylinders", {"h": 0.3, "cell": "quadrilateral"}),
        ("indent", {"dim": 3, "h": 0.25, "radius": 1.0}),
        ("clip", {"dim": 3, "h": 0.2, "cell": "tetrahedron", "layers": 2}),
    ],
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


def measure(mesh, body, order):
    """Area or volume of a body; all Jacobians have to be positive."""
    total = 0.0
    for kind, nodes in mesh.groups[body]:
        cell = {"quad": "quadrilateral", "tetra": "tetrahedron"}.get(kind, kind)
        points, weights = quadrature(cell, 6)
        x = mesh.points[nodes][..., : DIMENSION[kind]]
        jacobians = np.einsum("ena,qnb->eqab", x, shape_gradient(cell, order, points))
        determinants = np.linalg.det(jacobians)
        assert determinants.min() > 0
        total += (determinants @ weights).sum()
    return total


def outward(mesh, group):
    """Area-weighted normals (n, 3) and centres (n, 3) of the facets of a group, by their vertices."""
    normals, centres = [], []
    for kind, nodes in mesh.groups[group]:
        x = mesh.points[nodes[:, : VERTICES[kind]]]
        if kind == "line":
            t = x[:, 1] - x[:, 0]
            normals.append(np.column_stack([t[:, 1], -t[:, 0], 0 * t[:, 0]]))
        else:
            normals.append(0.5 * np.cross(x[:, 2] - x[:, 0], x[:, 3 % x.shape[1]] - x[:, 1]))
        centres.append(x.mean(axis=1))
    return np.concatenate(normals), np.concatenate(centres)


QUARTER = 0.25 * np.pi * (200.0**2 - 100.0**2)


@pytest.mark.parametrize(
    ("name", "arguments", "body", "expected"),
    [
        ("thick_cylinder", {"n": (4, 8), "grading": 2.5}, "body", QUARTER),
        ("thick_cylinder", {"n": (4, 8), "cell": "triangle"}, "body", QUARTER),
        ("thick_cylinder", {"dim": 3, "n": (3, 8), "layers": 2}, "body", 10 * QUARTER),
        ("thick_cylinder", {"dim": 3, "n": (3, 8), "cell": "tetrahedron"}, "body", 10 * QUARTER),
        ("cylinder_strip", {"grading": 3.0, "cell": "triangle"}, "body", 1000.0),
        ("indent", {"h": 0.2, "cell": "triangle"}, "block", 25.0),
        ("indent", {"dim": 3, "h": 0.25}, "block", 125.0),
        ("indent", {"dim": 3, "h": 0.2, "cell": "tetrahedron"}, "block", 125.0),
        ("indent", {"h": 0.2, "radius": 1.0}, "ball", 0.25 * np.pi),
        ("indent", {"dim": 3, "h": 0.2, "radius": 1.0}, "ball", np.pi / 6),
        ("hemisphere_on_cube", {"n": 8}, "hemisphere", 7.0 / 12.0 * np.pi),
        ("hemisphere_on_cube", {"n": 8}, "cube", 8.0),
        ("pad_on_ring", {}, "ring", 0.084 * np.pi),
        ("pad_on_ring", {}, "pad", 0.016),
        ("disk", {"n": 8, "thickness": 0.1}, "disk", 0.1 * np.pi),
        ("seal", {}, "seal", 0.36 + 0.255 * np.pi),
    ],
)
@pytest.mark.parametrize("order", [1, 2])
def test_areas_and_volumes(read, name, arguments, body, expected, order):
    # A round body loses a part of the order of the angle squared to straight sides, of the fourth power to parabolas.
    flat = body not in ("ball", "disk", "hemisphere", "ring", "seal") and name != "thick_cylinder"
    tolerance = 1e-12 if flat else {1: 0.06, 2: 1e-3}[order]
    assert measure(read(name, order, **arguments), body, order) == pytest.approx(expected, rel=tolerance)


def test_thick_cylinder_is_graded_and_round(read):
    for arguments in ({}, {"dim": 3, "cell": "tetrahedron"}):
        mesh = read("thick_cylinder", 2, n=(4, 5), grading=4.0, **arguments)
        for group, radius in (("inner", 100.0), ("outer", 200.0)):
            assert np.hypot(*mesh.x(group).T[:2]) == pytest.approx(radius, rel=1e-14)
        size = np.diff(np.unique(np.round(mesh.x("side_y")[:, 0], 9)))[::2]
        assert size[-1] / size[0] == pytest.approx(4.0) and size[1:] / size[:-1] == pytest.approx(4 ** (1 / 3))


@pytest.mark.parametrize(
    ("name", "arguments", "group", "direction"),
    [
        ("thick_cylinder", {"n": (3, 4)}, "side_x", (-1, 0, 0)),
        ("thick_cylinder", {"dim": 3, "n": (3, 4), "cell": "tetrahedron"}, "side_y", (0, -1, 0)),
        ("thick_cylinder", {"dim": 3, "n": (3, 4)}, "back", (0, 0, 1)),
        ("thick_cylinder", {"dim": 3, "n": (3, 4), "cell": "tetrahedron"}, "front", (0, 0, -1)),
        ("cylinder_strip", {}, "outer", (1, 0, 0)),
        ("indent", {"h": 0.2}, "block_bottom", (0, -1, 0)),
        ("indent", {"dim": 3, "h": 0.25}, "block_top", (0, 0, 1)),
        ("indent", {"dim": 3, "h": 0.25}, "side_x", (-1, 0, 0)),
        ("hemisphere_on_cube", {"n": 4}, "hemisphere_top", (0, 0, 1)),
        ("pad_on_ring", {"n": 2}, "pad_bottom", (0, 0, -1)),
        ("disk", {"n": 2}, "bottom", (0, 0, -1)),
        ("seal", {"n": (2, 12)}, "base", (0, -1, 0)),
    ],
)
def test_facets_look_outward(read, name, arguments, group, direction):
    normals, _ = outward(read(name, 1, **arguments), group)
    assert normals @ np.array(direction) == pytest.approx(np.linalg.norm(normals, axis=1))


@pytest.mark.parametrize("arguments", [{}, {"cell": "triangle"}, {"dim": 3}, {"dim": 3, "cell": "tetrahedron"}])
def test_indented_block_is_fine_at_the_origin(read, arguments):
    mesh = read("indent", 1, h=0.125, **arguments)
    x = mesh.x("block")
    vertical = arguments.get("dim", 2) - 1
    on_axis = np.all(np.abs(np.delete(x, vertical, axis=1)) < 1e-12, axis=1)
    depth = np.sort(-x[on_axis, vertical])
    size = np.diff(depth)
    assert size[depth[1:] < 0.51] == pytest.approx(0.125, rel=0.25)
    assert depth[-1] == 5.0 and 0.5 < size.max() < 1.5


def distance(points, segments):
    """Smallest distance of points (n, 2) from segments (m, 2, 2)."""
    a, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    s = np.clip(np.einsum("nmi,mi->nm", points[:, None] - a, along) / (along**2).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(points[:, None] - a - s[..., None] * along, axis=2).min()


def apart(mesh, shift):
    """Distance between the skins of the clip, moved in x, and of the catch (degree 2)."""
    halves = [mesh.groups[key][0][1][:, [[0, 2], [2, 1]]].reshape(-1, 2) for key in ("clip_skin", "catch_skin")]
    clip, catch = (mesh.points[ends][..., :2] for ends in halves)
    clip = clip + [shift, 0.0]
    return min(distance(clip[:, 0], catch), distance(catch[:, 0], clip))


@pytest.mark.parametrize("shape", [meshes.CLIP, meshes.ClipShape(length=12.0, overlap=0.5, ramp=35.0, retention=60.0)])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_clip_starts_and_ends_free(read, shape, cell):
    mesh = read("clip", 2, h=0.1, cell=cell, shape=shape)
    assert apart(mesh, 0.0) == pytest.approx(shape.clearance, abs=2e-3)
    assert apart(mesh, shape.first_touch) == pytest.approx(0.0, abs=2e-3)
    assert apart(mesh, shape.passed) == pytest.approx(0.0, abs=2e-3)
    assert apart(mesh, shape.travel) == pytest.approx(shape.clearance, abs=2e-3)
    hook, nose = mesh.x("clip_skin") + [shape.travel, 0.0, 0.0], mesh.x("catch_skin")
    assert hook[hook[:, 1] > shape.nose_bottom, 0].min() > nose[nose[:, 1] < shape.nose_bottom + 1e-6, 0].max()
    assert hook[:, 1].max() - nose[:, 1].min() == pytest.approx(shape.overlap)
    assert np.diff(np.sort(mesh.x("clip_root")[:, 1])).max() < 0.25
    assert mesh.x("clip_root")[:, 0].max() == -shape.root_length


def test_clip_extruded(read):
    plane = measure(read("clip", 2, h=0.2), "clip", 2), measure(read("clip", 2, h=0.2), "catch", 2)
    for cell in ("tetrahedron", "hexahedron"):
        mesh = read("clip", 2, dim=3, h=0.2, cell=cell, width=2.0, layers=2)
        assert measure(mesh, "clip", 2) == pytest.approx(2.0 * plane[0], rel=1e-4)
        assert measure(mesh, "catch", 2) == pytest.approx(2.0 * plane[1], rel=1e-4)
        assert np.ptp(mesh.x("clip_back")[:, 2]) == 0.0 and mesh.x("catch_back")[0, 2] == 2.0
        for group, direction in (("clip_root", (-1, 0, 0)), ("catch_base", (0, 1, 0)), ("clip_front", (0, 0, -1))):
            normals, _ = outward(mesh, group)
            assert normals @ np.array(direction) == pytest.approx(np.linalg.norm(normals, axis=1))


def test_clip_that_cannot_snap(tmp_path):
    for wrong in ({"overlap": 0.9}, {"catch_ramp": 40.0}, {"radius": 0.6}):
        with pytest.raises(ValueError, match="clip"):
            meshes.ClipShape(**wrong)
    with pytest.raises(ValueError, match="ClipShape"):
        meshes.clip(tmp_path / "c.msh", shape=3)


def test_spring_volume_and_ends(read):
    mesh = read("spring", 2, h=1.0, coils=1.5)
    length = 1.5 * np.hypot(16.0 * np.pi, 5.0)
    assert measure(mesh, "spring", 2) == pytest.approx(np.pi * length, rel=1e-3)  # Pappus
    normals, _ = outward(mesh, "end_bottom")
    slope = np.array([0.0, -16.0 * np.pi, -5.0]) / np.hypot(16.0 * np.pi, 5.0)
    assert normals / np.linalg.norm(normals, axis=1)[:, None] == pytest.approx(np.tile(slope, (len(normals), 1)))
    r = np.hypot(*mesh.x("spring").T[:2])
    assert (r.min(), r.max()) == pytest.approx((7.0, 9.0), abs=0.01)


@pytest.mark.parametrize("order", [1, 2])
def test_ground_spring_stands_on_flat_ends(read, order):
    mesh = read("spring", order, h=0.5, coils=2.5, ends="ground")
    x = mesh.x("spring")
    height = (2.5 - 2.0) * 5.0 + 2.0 * 2.2 - 2 * 0.3
    for group, z, direction in (("end_bottom", 0.0, -1.0), ("end_top", height, 1.0)):
        assert np.all(mesh.x(group)[:, 2] == mesh.x(group)[0, 2]) and mesh.x(group)[0, 2] == pytest.approx(z)
        normals, _ = outward(mesh, group)
        assert np.all(normals[:, 2] * direction > 0) and np.abs(normals[:, :2]).max() < 1e-12
        # The cut runs along 0.59 turns (0.65 of the wire at 1.1 of it per turn), its mean width is about 1.65.
        assert 0.5 < np.abs(normals[:, 2]).sum() / (0.59 * np.pi * 16.0 * 1.65) < 1.0
    assert x[:, 2].min() == 0.0 and x[:, 2].max() == pytest.approx(height)
    assert measure(mesh, "spring", order) < np.pi * 2.5 * np.hypot(16.0 * np.pi, 5.0)


def test_coils_of_a_spring_are_apart():
    t = np.linspace(0.0, 3.0, 400)
    for ends, pitch in (("open", 5.0), ("closed", 2.2), ("ground", 2.2)):
        helix = Helix(2.0, 16.0, 4.0, 5.0, ends, 1.0, 0.1)
        (below, slope), (above, _) = helix.rise(t), helix.rise(t + 1.0)
        # The pitch begins to change a quarter of a turn before the closed ones are over.
        assert pitch - 1e-12 < (above - below).min() < pitch + 0.14
        assert slope == pytest.approx(np.gradient(below, t), abs=0.05)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_whole_and_cut_strip_are_the_same(read, cell):
    whole, cut = (read("c_strip", 2, n=(2, 16), cell=cell, split=split) for split in (False, True))
    area = (2 * np.pi - np.radians(10.0)) * 10.0
    both = measure(cut, "strip_upper", 2) + measure(cut, "strip_lower", 2)
    assert measure(whole, "strip", 2) == pytest.approx(area, rel=1e-4) and both == pytest.approx(area, rel=1e-4)
    assert len(cut.points) - len(whole.points) == len(whole.nodes("back")) == 5
    assert np.all(whole.x("back")[:, 1] == 0.0) and whole.x("back")[:, 0].max() < -9.0
    for mesh in (whole, cut):
        for group, side in (("lip_upper", 1.0), ("lip_lower", -1.0)):
            angle = np.arctan2(*mesh.x(group).T[1::-1])
            assert angle == pytest.approx(side * np.radians(5.0)) and len(angle) == 5
            normals, _ = outward(mesh, group)
            assert np.all(normals[:, 1] * side < 0)
        assert np.hypot(*mesh.x("strip_inner").T[:2]) == pytest.approx(9.5)
        assert np.hypot(*mesh.x("strip_outer").T[:2]) == pytest.approx(10.5)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("thick_cylinder", {"n": (0, 4)}),
        ("thick_cylinder", {"inner": 0.0}),
        ("cylinder_strip", {"inner": 3.0, "outer": 2.0}),
        ("indent", {"h": 1.0}),
        ("spring", {"ends": "round"}),
        ("spring", {"pitch": 2.0}),
        ("spring", {"coils": 2.0, "ends": "ground"}),
        ("c_strip", {"gap": 360.0}),
    ],
)
def test_wrong_dimensions(tmp_path, name, arguments):
    with pytest.raises(ValueError, match=name):
        meshes.GENERATORS[name](tmp_path / "w.msh", **arguments)
    assert not (tmp_path / "w.msh").exists()


def test_halves_are_cut_along_the_shortest_diagonal():
    """The four parts that are not corners share the shortest of three diagonals; no volume is lost or turned over."""
    points = np.random.default_rng(5).uniform(size=(200, 3))
    cells = np.arange(200).reshape(50, 4)
    low = np.linalg.det(points[cells][:, 1:] - points[cells][:, :1]) < 0.0
    cells[low] = cells[low][:, [1, 0, 2, 3]]
    none = np.zeros((0, 3), dtype=int), np.zeros((0, 2), dtype=int)
    x, parts, _, _ = halve(points, cells, *none)
    corners = points[cells]
    volume, whole = (np.linalg.det(x[:, 1:] - x[:, :1]) for x in (x[parts], corners))
    assert volume.min() > 0.0
    np.testing.assert_allclose(volume, np.repeat(whole / 8.0, 8), rtol=1e-9)
    for k in range(50):
        ends = set.intersection(*(set(part) for part in parts[8 * k + 4 : 8 * k + 8].tolist()))
        a, b = x[sorted(ends)]
        pairs = [(0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2)]
        ways = [corners[k][list(pair)] for pair in pairs]
        lengths = [np.linalg.norm(way[:2].mean(axis=0) - way[2:].mean(axis=0)) for way in ways]
        assert np.linalg.norm(a - b) == pytest.approx(min(lengths))


def test_a_ball_with_halved_edges(tmp_path):
    """As many cells as asked for, none turned over, new nodes of the skin on the ball, all groups filled."""
    raw = read_mesh(meshes.ball_on_block(tmp_path / "h.msh", unknowns=40_000, halvings=1))
    assert 3 * len(raw.points) == pytest.approx(40_000, rel=0.2)
    x = raw.points[raw.blocks[0].nodes]
    volume = np.linalg.det(x[:, 1:] - x[:, :1]) / 6.0
    assert volume.min() > 0.0 and volume.sum() == pytest.approx(4.0 + 2.0 * np.pi / 3.0, rel=0.02)
    cells, local = raw.facet_groups["ball_skin"]
    nodes = raw.blocks[0].nodes[cells[:, None], facet_nodes("tetrahedron", 1)[local]]
    np.testing.assert_allclose(np.linalg.norm(raw.points[nodes] - [0.0, 0.0, 1.0], axis=2), 1.0, rtol=1e-12)
    assert all(len(group[0]) for group in raw.facet_groups.values())
    np.testing.assert_allclose(raw.points[raw.node_groups["ball_tip"]], 0.0, atol=1e-12)
    with pytest.raises(ValueError, match="order 2 with halvings"):
        meshes.ball_on_block(tmp_path / "h.msh", order=2, halvings=1)
