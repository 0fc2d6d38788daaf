"""Pictures: what is seen, where solids are cut, which field is meant, and that files come out."""

import json
import subprocess
import sys

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.image import imread
from mpi4py import MPI

from pcontact.element.reference import CELLS, MESHIO_NAMES, reference_nodes
from pcontact.io import paint, raster, skin, view
from pcontact.io.fields import Cloud, FieldWriter, Piece
from pcontact.io.picture import picture
from pcontact.io.quantity import NodeAverages, Quantity, available, find
from pcontact.io.result import Result, load_result
from pcontact.io.show import show
from pcontact.runtime.errors import InputError

SOLIDS = [(cell, degree) for cell in ("tetrahedron", "hexahedron") for degree in (1, 2)]
SMALL = (480, 320)


def solid(cell, degree):
    """One cell: the unit tetrahedron or the cube [-1, 1]^3, and its surface."""
    points = reference_nodes(cell, degree)
    piece = Piece(points, [(MESHIO_NAMES[cell, degree], np.arange(len(points))[None])])
    return piece, {"tetrahedron": 1.5 + np.sqrt(3) / 2, "hexahedron": 24.0}[cell]


def bricks(n, shift=(0.0, 0.0, 0.0)):
    """A unit cube of n^3 hexahedra: points, cells, facets at the bottom."""
    line = np.linspace(0, 1, n + 1)
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3) + shift
    i, j, k = (part.ravel() for part in np.meshgrid(*[np.arange(n)] * 3, indexing="ij"))
    corners = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    cells = np.column_stack([((i + a) * (n + 1) + j + b) * (n + 1) + k + c for a, b, c in corners])
    return points, cells, cells[k == 0][:, [0, 3, 2, 1]]


def areas(points, triangles):
    """Area vectors."""
    a, b, c = np.moveaxis(points[triangles.nodes], 1, 0)
    return np.cross(b - a, c - a) / 2


def side_length(points, triangles):
    """Length of all sides that are drawn."""
    corners = points[triangles.nodes]
    return np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)[triangles.edges == 1].sum()


@pytest.mark.parametrize("cell, degree", SOLIDS)
def test_skin_of_a_cell_is_closed_and_looks_outward(cell, degree):
    piece, area = solid(cell, degree)
    triangles = skin.skin(piece)
    vectors = areas(piece.points, triangles)
    assert np.linalg.norm(vectors, axis=1).sum() == pytest.approx(area)
    np.testing.assert_allclose(vectors.sum(axis=0), 0, atol=1e-14)
    outward = piece.points[triangles.nodes].mean(axis=1) - piece.points.mean(axis=0)
    assert ((vectors * outward).sum(axis=1) > 0).all()
    # each edge of the cell is a side of two facets
    ends = piece.points[np.array(CELLS[cell].edges)]
    assert side_length(piece.points, triangles) == pytest.approx(
        2 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    )


def test_skin_has_no_facets_between_cells():
    points, cells, _ = bricks(3)
    triangles = skin.skin(Piece(points, [("hexahedron", cells[:10]), ("hexahedron", cells[10:])]))
    assert len(triangles.owner) == 6 * 9 * 2
    assert not np.isin(13, triangles.owner), "the cell in the middle has no part in the skin"
    np.testing.assert_array_equal(np.sort(np.unique(triangles.owner)), np.delete(np.arange(27), 13))


@pytest.mark.parametrize("cell, degree", SOLIDS)
def test_section_has_the_area_and_the_outline_of_the_exact_cut(cell, degree):
    piece, _ = solid(cell, degree)
    cut = skin.section(piece, piece.points[:, 2] - 0.3)
    points = cut.interpolate(piece.points)
    np.testing.assert_allclose(points[:, 2], 0.3)
    side = {"tetrahedron": 0.7, "hexahedron": 2.0}[cell]
    half = {"tetrahedron": 0.5, "hexahedron": 1.0}[cell]
    assert np.linalg.norm(areas(points, cut.triangles), axis=1).sum() == pytest.approx(half * side**2)
    outline = {"tetrahedron": (2 + np.sqrt(2)) * side, "hexahedron": 4 * side}[cell]
    assert side_length(points, cut.triangles) == pytest.approx(outline), "inner divisions are not drawn"
    np.testing.assert_allclose(cut.interpolate(piece.points @ [1.0, 2.0, 3.0]), points @ [1.0, 2.0, 3.0])


def test_section_through_a_layer_of_nodes_is_complete():
    points, cells, _ = bricks(2)
    cut = skin.section(Piece(points, [("hexahedron", cells)]), points[:, 0] - 0.5)
    assert np.linalg.norm(areas(cut.interpolate(points), cut.triangles), axis=1).sum() == pytest.approx(1.0)


def test_each_pixel_shows_the_nearest_triangle():
    rng = np.random.default_rng(5)
    corners = rng.random((30, 3, 3)) * [20, 16, 1]
    values, beyond = rng.random((30, 3)), rng.random((30, 3)) - 0.6
    seen = raster.render(corners, values, beyond, np.ones((30, 3), bool), (0, 20, 0, 16), (16, 20))
    x, y = np.meshgrid(np.arange(20) + 0.5, np.arange(16) + 0.5)
    weights = np.empty((30, 3, 16, 20))
    for t, (a, b, c) in enumerate(corners):
        matrix = np.array([[a[0], b[0], c[0]], [a[1], b[1], c[1]], [1, 1, 1]])
        weights[t] = np.tensordot(np.linalg.inv(matrix), np.stack([x, y, np.ones_like(x)]), 1)
    depth = np.einsum("tkij,tk->tij", weights, corners[:, :, 2])
    depth[(weights < 0).any(axis=1) | (np.einsum("tkij,tk->tij", weights, beyond) > 0)] = -np.inf
    first = np.where(depth.max(axis=0) > -np.inf, depth.argmax(axis=0), -1)
    np.testing.assert_array_equal(seen.triangle, first)
    hit = first >= 0
    shown = np.take_along_axis(np.einsum("tkij,tk->tij", weights, values), first[None], 0)[0]
    np.testing.assert_allclose(seen.value[hit], shown[hit])
    np.testing.assert_allclose(seen.depth[hit], depth.max(axis=0)[hit])


def test_distance_from_the_drawn_sides():
    corners = np.array([[[0, 0, 0], [8, 0, 0], [0, 8, 0]]], dtype=float)
    edges = np.array([[True, False, False]])
    seen = raster.render(corners, np.zeros((1, 3)), None, edges, (0, 8, 0, 8), (8, 8))
    rows, columns = np.nonzero(seen.triangle == 0)
    np.testing.assert_allclose(seen.line[rows, columns], rows + 0.5)


def two_cubes(n=3, pressed=1.0):
    """Two cubes, the upper one under pressure from below."""
    low, cells, _ = bricks(n, (0.0, 0.0, -1.0))
    high, upper, facets = bricks(n)
    points = np.concatenate([low, high])
    everything = np.concatenate([cells, upper + len(low)])
    count = len(facets)
    pressure = pressed * np.linspace(0, 1, count)
    bodies = Piece(
        points,
        [("hexahedron", everything)],
        {"displacement": -1e-3 * points},
        {
            "equivalent_stress": [np.arange(float(len(everything)))],
            "stress": [np.outer(np.arange(len(everything)), [1.0, -1, 0, 0, 0, 2])],
            "body": [np.repeat([0, 1], len(cells))],
        },
    )
    surface = Piece(
        high,
        [("quad", facets)],
        {"displacement": -1e-3 * high},
        {"contact_pressure": [pressure], "status": [np.arange(count) % 3]},
    )
    return bodies, {"pair": surface}, {"pair": Cloud(high[facets].mean(axis=1), {"pressure": pressure})}


def plane_bodies():
    """Two dimensions, first and second order cells, a contact surface of lines."""
    points = np.array(
        [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [1, 0.5], [0.5, 1], [0, 0.5], [0.5, 0.5], [2, 0], [2, 1]]
    )
    cells = [("quad9", np.arange(9)[None]), ("triangle", np.array([[1, 9, 10], [1, 10, 2]]))]
    bodies = Piece(points, cells, {"displacement": 0.1 * points}, {"equivalent_stress": [[1.0], [2.0, 3.0]]})
    surface = Piece(
        points[[2, 3, 6]], [("line3", [[0, 1, 2]])], {}, {"contact_pressure": [[4.0]], "gap": [[0.0]]}
    )
    return bodies, {"top": surface}, {"top": Cloud(points[[2, 3]], {"pressure": np.array([1.0, 2.0])})}


@pytest.fixture
def solid_run(tmp_path):
    FieldWriter(tmp_path, MPI.COMM_SELF).write(1, 1.0, *two_cubes())
    return tmp_path


@pytest.fixture
def plane_run(tmp_path):
    FieldWriter(tmp_path, MPI.COMM_SELF).write(1, 1.0, *plane_bodies())
    return tmp_path


def colourful(path):
    """Share of the pixels that are neither white nor grey."""
    pixels = imread(path)[..., :3]
    return np.mean(np.ptp(pixels, axis=2) > 0.15)


@pytest.mark.parametrize(
    "field", [None, "equivalent_stress", "displacement", "stress_xz", "body", "status", "pressure"]
)
def test_pictures_of_solids(solid_run, field):
    path = picture(solid_run, field, size=SMALL)
    assert path == solid_run / f"{field or 'contact_pressure'}.png"
    assert imread(path).shape[:2] == SMALL[::-1]
    assert colourful(path) > 0.005


@pytest.mark.parametrize("field", [None, "equivalent_stress", "displacement_x", "gap", "pressure"])
def test_pictures_of_plane_bodies(plane_run, field):
    path = picture(plane_run, field, output=plane_run / "shot.png", scale=2.0, size=SMALL)
    assert path.name == "shot.png" and colourful(path) > 0.003


def test_a_contact_without_facets_is_no_obstacle(tmp_path):
    bodies, _, _ = two_cubes()
    nothing = Piece(
        np.zeros((0, 3)), [("quad", np.zeros((0, 4), dtype=np.int64))], {}, {"gap": [np.zeros(0)]}
    )
    bodies.cell_data["gap"] = [np.arange(float(len(bodies.cells[0][1])))]
    FieldWriter(tmp_path, MPI.COMM_SELF).write(1, 1.0, bodies, {"pair": nothing})
    assert find(load_result(tmp_path)).name == "equivalent_stress"
    assert colourful(picture(tmp_path, size=SMALL)) > 0.05
    assert colourful(picture(tmp_path, "gap", size=SMALL)) > 0.05


def test_nothing_is_written_of_a_picture_that_cannot_be(solid_run, tmp_path):
    with pytest.raises(
        InputError,
        match=r"no field 'strain'; allowed: body, equivalent_stress, stress_xx, .*contact_pressure",
    ):
        picture(solid_run, "strain")
    with pytest.raises(InputError, match="no such directory"):
        picture(tmp_path / "nowhere")
    with pytest.raises(InputError, match="-o .*nowhere.*: found no such file or directory"):
        picture(solid_run, output=tmp_path / "nowhere" / "a.png", size=SMALL)
    with pytest.raises(InputError, match="cannot be written"):
        picture(solid_run, output=tmp_path / "a.blob", size=SMALL)
    assert not list(tmp_path.glob("*.png"))


@pytest.mark.parametrize(
    "options, message",
    [
        ({"filed": "gap"}, "-filed: no such option of pcontact view; allowed: -field, .*; the nearest is -field"),
        ({"step": "last"}, "-step: found 'last'; allowed: a whole number"),
        ({"step": "0"}, "no step 0; allowed: 1 to 1, or -1"),
        ({"scale": "-2"}, "-scale: found '-2'; allowed: a number >= 0"),
        ({"cut": "maybe"}, "-cut: found 'maybe'; allowed: true | false"),
        ({"size": "100"}, "-size: found '100'; allowed: WIDTHxHEIGHT"),
        ({"field": ""}, "-field: found nothing"),
        ({"field": "displacment"}, "no field 'displacment'; allowed: .*; the nearest is 'displacement'"),
    ],
)
def test_options_of_the_command_line_that_are_wrong(solid_run, options, message):
    with pytest.raises(InputError, match=message):
        show(str(solid_run), options)
    assert not list(solid_run.glob("*.png"))


def test_options_of_the_command_line(solid_run):
    options = {"field": "equivalent_stress", "step": "1", "scale": "2", "cut": "false", "smooth": "", "size": "480x320"}
    path = show(str(solid_run), {**options, "o": str(solid_run / "shot")})
    assert path == solid_run / "shot.png"
    assert imread(path).shape[:2] == (320, 480)


def test_a_scene_is_no_result(tmp_path):
    with pytest.raises(InputError, match=r"found scene\.toml; allowed: the output directory of a run"):
        show("scene.toml", {})


# which of the named modules the start of the program loads, and which of them its own modules import
LOADED = """
import builtins, json, sys

imported, plain = set(), builtins.__import__

def noting(name, names=None, *more, **named):
    if (names or {}).get("__name__", "").split(".")[0] == "pcontact":
        imported.add(name.split(".")[0])
    return plain(name, names, *more, **named)

builtins.__import__ = noting
import pcontact.cli
print(json.dumps([sorted(set(sys.argv[1:]) & names) for names in (set(sys.modules), imported)]))
"""


def test_a_run_does_not_import_what_draws():
    """Nor what reads meshes of other programs: every start would wait for it. numba loads scipy where there is one."""
    names = ("matplotlib", "PIL", "meshio", "scipy", "petsc4py")
    done = subprocess.run([sys.executable, "-c", LOADED, *names], capture_output=True, text=True, check=True)
    loaded, imported = json.loads(done.stdout)
    assert [name for name in loaded if name != "scipy"] == ["petsc4py"] and imported == ["petsc4py"]


def test_averages_at_nodes_stay_in_their_body():
    """Two squares that share an edge, of one body or of two."""
    points = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]], dtype=float)
    piece = Piece(points, [("quad", np.array([[0, 1, 4, 3], [1, 2, 5, 4]]))])
    triangles = skin.surface(piece)
    right = triangles.owner == 1
    values = NodeAverages(piece, np.array([1.0, 3.0])).corners(triangles)
    np.testing.assert_array_equal(np.unique(values[right]), [2.0, 3.0])
    piece.cell_data["body"] = [np.array([0, 1])]
    values = NodeAverages(piece, np.array([1.0, 3.0])).corners(triangles)
    np.testing.assert_array_equal(np.unique(values[right]), [3.0])


def test_averages_on_a_section():
    """A field of cells that is a linear function of the middles keeps its value at the middle of a section."""
    points, cells, _ = bricks(4)
    piece = Piece(points, [("hexahedron", cells)])
    cut = skin.section(piece, points[:, 0] - 0.6)
    x = cut.interpolate(points)[cut.triangles.nodes]
    averages = NodeAverages(piece, points[cells].mean(axis=1) @ [1.0, 0.0, 2.0])
    inner = (np.abs(x[..., 1:] - 0.5) < 0.2501).all(axis=2)
    np.testing.assert_allclose(averages.corners(cut.triangles, cut)[inner], (x @ [1.0, 0.0, 2.0])[inner])


def test_outlines_are_on_the_side_of_the_body_all_around():
    labels = np.full((8, 8), -1)
    labels[2:6, 2:6] = 0
    expected = np.zeros((8, 8), dtype=bool)
    expected[2:6, 2:6] = True
    expected[3:5, 3:5] = False
    np.testing.assert_array_equal(raster.outlines(labels, 1), expected)


def test_sharp_edges_are_drawn():
    normals = np.array([[0, 0, 1.0], [0, 0.2, 0.98], [0, 1.0, 0]])
    triangle = np.repeat([[0, 0, 1, 1, 2, 2, -1, -1]], 3, axis=0)
    np.testing.assert_array_equal(np.flatnonzero(raster.creases(triangle, normals, 1)[1]), [4])


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_edges_of_curved_cells_have_no_gaps(cell):
    """Wherever a pixel is near an edge of a cell of degree 2, it is near a line that is drawn."""
    points = 20 * np.pad(reference_nodes(cell, 2), ((0, 0), (0, 1))) + [30.0, 30.0, 0.0]
    table, edges = skin.TRIANGLES[cell, 2]
    seen = raster.render(points[table], np.zeros((len(table), 3)), None, edges, (0, 60, 0, 60), (60, 60))
    middle = len(CELLS[cell].edges) + CELLS[cell].n_vertices
    rows, columns = np.nonzero(seen.triangle >= 0)
    centre = np.column_stack([columns, rows]) + 0.5
    for node in points[CELLS[cell].n_vertices : middle, :2]:
        distance = np.linalg.norm(centre - node, axis=1)
        near = distance < 1.0
        assert near.any()
        assert (seen.line[rows[near], columns[near]] <= distance[near] + 1e-9).all()


def test_pressed_part_of_a_round_surface():
    """A quarter circle is as high as wide; what counts is the part under pressure."""
    angle = np.linspace(-np.pi / 2, 0, 19)
    points = np.column_stack([np.cos(angle), 1 + np.sin(angle), 0 * angle])
    cells = np.column_stack([np.arange(18), np.arange(1, 19)])
    piece = Piece(points, [("line", cells)], {}, {"contact_pressure": [(np.arange(18) < 3).astype(float)]})
    axis, (low, high) = view.along({"pair": piece}, {"pair": points})
    assert axis == 0
    assert (low, high) == pytest.approx((0.0, 1.5 * np.sin(np.pi / 12)), abs=1e-12)


def test_a_field_is_found_by_name_and_component(solid_run):
    result = load_result(solid_run)
    assert {"displacement", "displacement_z", "stress_yz", "status", "pressure"} <= set(available(result))
    assert "stress" not in available(result), "a tensor has no one number"
    bodies = result.bodies
    np.testing.assert_array_equal(find(result, "stress_xz").values[""], bodies.cell_data["stress"][0][:, 5])
    length = np.linalg.norm(bodies.point_data["displacement"], axis=1)
    np.testing.assert_array_equal(find(result, "displacement").values[""], length)
    assert find(result).name == "contact_pressure" and find(result).place == "surfaces"


def test_without_pressure_the_stress_is_shown():
    bodies, surfaces, points = two_cubes(pressed=0.0)
    assert find(Result("", 1.0, [1.0], bodies, surfaces, points)).name == "equivalent_stress"


def test_small_displacements_are_enlarged_large_ones_are_not(solid_run):
    result = load_result(solid_run)
    assert view.deformation_scale(result) == 50.0
    result.bodies.point_data["displacement"] *= 100
    assert view.deformation_scale(result) == 1.0
    result.bodies.point_data["displacement"] *= 0
    assert view.deformation_scale(result) == 1.0


def test_displacements_are_not_enlarged_where_bodies_of_different_shape_touch(solid_run):
    result = load_result(solid_run)
    largest = np.linalg.norm(result.bodies.point_data["displacement"], axis=1).max()
    result.points["pair"].data["gap"] = np.array([np.nan, 0.0, 0.4 * largest])
    assert view.deformation_scale(result) == 50.0
    result.points["pair"].data["gap"] = np.array([np.nan, 0.0, 10 * largest])
    assert view.deformation_scale(result) == 1.0


@pytest.mark.parametrize("low, axis, sign", [((-1, -1), 1, -1), ((0, -1), 0, -1), ((-1, -2), 1, 1)])
def test_half_models_are_looked_at_from_their_symmetry_plane(low, axis, sign):
    """The patch is [-0.4, 0.4]^2 in the whole, or its half; the block ends where the model does."""
    ends = np.array([low, (1, 0.4 if sign > 0 else 1)], dtype=float)
    middles = np.array([[x, y] for x in np.linspace(-0.4, 0.4, 21) for y in np.linspace(-0.4, 0.4, 21)])
    middles = middles[(middles > ends[0]).all(axis=1) & (middles < ends[1]).all(axis=1)]
    patch = view.Patch(np.pad(middles, ((0, 0), (0, 1))), np.array([0.0, 0.0, 1.0]))
    positions = np.pad(ends, ((0, 0), (0, 1)), constant_values=((0, 0), (-1, 0)))
    normal, offset, camera = view.cut_open(patch, positions)
    np.testing.assert_array_equal(normal, sign * np.eye(3)[axis])
    whole = tuple(low) == (-1, -1)
    assert (offset == pytest.approx(0.0)) if whole else offset is None
    assert camera.axes[2] @ normal > 0.8


def test_colours_fit_the_numbers():
    def scale(values, name="x", whole=False):
        quantity = Quantity(name, "bodies", "cell", {"": np.asarray(values, dtype=float)}, whole)
        return paint.colour_scale(quantity, colormaps)

    assert (scale([1, 10]).norm.vmin, scale([1, 10]).norm.vmax) == (0, 10)
    assert (scale([-3, 10]).norm.vmin, scale([-3, 10]).norm.vmax) == (-10, 10)
    assert scale([0, 1, 2], "status", True).kinds == [0, 1, 2]
    singular = scale(np.append(np.linspace(0, 1, 10000), 100.0))
    assert singular.extend == "max" and singular.norm.vmax < 1.01
    constant = scale([2.0, 2.0])
    assert constant.norm.vmin < constant.norm.vmax
    assert np.isfinite(scale([]).rgb(np.zeros(1))).all()
