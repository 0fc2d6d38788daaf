"""Pictures: what is seen, where solids are cut, which field is meant, and that files come out."""

import base64
import io
import json
import re
import subprocess
import sys
import zipfile
from contextlib import nullcontext
from unittest.mock import Mock

import numpy as np
import pytest
from matplotlib.image import imread
from mpi4py import MPI
from PIL import Image

from pcontact.io.fields import FieldWriter, Piece
from pcontact.io.result import Result, load_result
from pcontact.runtime.errors import InputError
from pcontact.view import camera, colours, extra
from pcontact.view.quantity import Quantity, available, find
from pcontact.view.show import show

# VTK is an extra: nothing here is about what runs without it
pytest.importorskip("pyvista")
extra.prepare_off_screen()

from pcontact.view import export  # noqa: E402
from pcontact.view.export import movie, page  # noqa: E402
from pcontact.view.picture import Look, picture, staged  # noqa: E402

SMALL = (480, 320)


def bricks(n, shift=(0.0, 0.0, 0.0)):
    """A unit cube of n^3 hexahedra: points, cells, facets at the bottom."""
    line = np.linspace(0, 1, n + 1)
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3) + shift
    i, j, k = (part.ravel() for part in np.meshgrid(*[np.arange(n)] * 3, indexing="ij"))
    corners = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    cells = np.column_stack([((i + a) * (n + 1) + j + b) * (n + 1) + k + c for a, b, c in corners])
    return points, cells, cells[k == 0][:, [0, 3, 2, 1]]


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
    return bodies, {"pair": surface}, {"pair": Piece(high[facets].mean(axis=1), [], {"pressure": pressure})}


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
    return bodies, {"top": surface}, {"top": Piece(points[[2, 3]], [], {"pressure": np.array([1.0, 2.0])})}


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
        ({"cut": "x=left"}, "-cut: found 'x=left'; allowed: true | false | x"),
        ({"views": "whole,back"}, "-views: found 'whole,back'; allowed: some of whole, cut, near"),
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
    with pytest.raises(InputError, match=r"found scene\.toml, no .*directory; allowed: the output directory of a run"):
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
    names = ("matplotlib", "PIL", "pyvista", "vtkmodules", "meshio", "scipy", "petsc4py")
    done = subprocess.run([sys.executable, "-c", LOADED, *names], capture_output=True, text=True, check=True)
    loaded, imported = json.loads(done.stdout)
    assert [name for name in loaded if name != "scipy"] == ["petsc4py"] and imported == ["petsc4py"]


def test_pressed_part_of_a_round_surface():
    """A quarter circle is as high as wide; what counts is the part under pressure."""
    angle = np.linspace(-np.pi / 2, 0, 19)
    points = np.column_stack([np.cos(angle), 1 + np.sin(angle), 0 * angle])
    cells = np.column_stack([np.arange(18), np.arange(1, 19)])
    piece = Piece(points, [("line", cells)], {}, {"contact_pressure": [(np.arange(18) < 3).astype(float)]})
    axis, (low, high) = camera.along({"pair": piece}, {"pair": points})
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
    assert camera.deformation_scale(result) == 50.0
    result.bodies.point_data["displacement"] *= 100
    assert camera.deformation_scale(result) == 1.0
    result.bodies.point_data["displacement"] *= 0
    assert camera.deformation_scale(result) == 1.0


def test_displacements_are_not_enlarged_where_bodies_of_different_shape_touch(solid_run):
    result = load_result(solid_run)
    largest = np.linalg.norm(result.bodies.point_data["displacement"], axis=1).max()
    result.points["pair"].point_data["gap"] = np.array([np.nan, 0.0, 0.4 * largest])
    assert camera.deformation_scale(result) == 50.0
    result.points["pair"].point_data["gap"] = np.array([np.nan, 0.0, 10 * largest])
    assert camera.deformation_scale(result) == 1.0


@pytest.mark.parametrize("low, axis, sign", [((-1, -1), 1, -1), ((0, -1), 0, -1), ((-1, -2), 1, 1)])
def test_half_models_are_looked_at_from_their_symmetry_plane(low, axis, sign):
    """The patch is [-0.4, 0.4]^2 in the whole, or its half; the block ends where the model does."""
    ends = np.array([low, (1, 0.4 if sign > 0 else 1)], dtype=float)
    middles = np.array([[x, y] for x in np.linspace(-0.4, 0.4, 21) for y in np.linspace(-0.4, 0.4, 21)])
    middles = middles[(middles > ends[0]).all(axis=1) & (middles < ends[1]).all(axis=1)]
    patch = camera.Patch(np.pad(middles, ((0, 0), (0, 1))), np.array([0.0, 0.0, 1.0]))
    positions = np.pad(ends, ((0, 0), (0, 1)), constant_values=((0, 0), (-1, 0)))
    normal, offset, eye = camera.cut_open(patch, positions)
    np.testing.assert_array_equal(normal, sign * np.eye(3)[axis])
    whole = tuple(low) == (-1, -1)
    assert (offset == pytest.approx(0.0)) if whole else offset is None
    assert eye.axes[2] @ normal > 0.8


def test_colours_fit_the_numbers():
    def scale(values, name="x", whole=False):
        quantity = Quantity(name, "bodies", "cell", {"": np.asarray(values, dtype=float)}, whole)
        return colours.colour_scale(quantity)

    assert (scale([1, 10]).norm.vmin, scale([1, 10]).norm.vmax) == (0, 10)
    assert (scale([-3, 10]).norm.vmin, scale([-3, 10]).norm.vmax) == (-10, 10)
    assert scale([0, 1, 2], "status", True).kinds == [0, 1, 2]
    singular = scale(np.append(np.linspace(0, 1, 10000), 100.0))
    assert singular.extend == "max" and singular.norm.vmax < 1.01
    constant = scale([2.0, 2.0])
    assert constant.norm.vmin < constant.norm.vmax
    assert np.isfinite(scale([]).rgb(np.zeros(1))).all()


def test_several_fields_and_views_are_side_by_side(solid_run):
    """Also what the options say of cuts; each panel has colours of its own."""
    options = {"field": "contact_pressure,displacement", "views": "cut,near", "cut": "x=0.4", "size": "960x640"}
    path = show(str(solid_run), options)
    assert path == solid_run / "contact_pressure_displacement.png" and colourful(path) > 0.02
    pixels = imread(path)[..., :3]
    for rows in (slice(0, 320), slice(320, 640)):
        for columns in (slice(0, 400), slice(400, 800)):
            assert np.mean(np.ptp(pixels[rows, columns], axis=2) > 0.15) > 0.003


@pytest.mark.parametrize("view", ["surface", "unrolled"])
def test_views_of_the_contact_alone(solid_run, plane_run, view):
    path = show(str(solid_run), {"views": view, "size": "480x320", "o": str(solid_run / "alone.png")})
    assert colourful(path) > 0.003
    with pytest.raises(InputError, match=f"-views: found '{view}' of equivalent_stress, a field of the bodies"):
        show(str(solid_run), {"field": "equivalent_stress", "views": view})


def test_a_section_shows_what_is_inside(solid_run):
    """A cut at another place shows another colour where the field falls along the normal."""
    result = load_result(solid_run)
    stress = result.bodies.points[result.bodies.cells[0][1]].mean(axis=1)[:, 0]
    result.bodies.cell_data["equivalent_stress"] = [stress]
    result.bodies.point_data.pop("displacement")
    FieldWriter(solid_run / "x", MPI.COMM_SELF).write(1, 1.0, result.bodies, {})
    shown = []
    for where in (0.2, 0.8):
        path = picture(solid_run / "x", "equivalent_stress", size=SMALL, cut=(0, where), smooth=False, scale=1.0)
        pixels = imread(path)[..., :3]
        shown.append(pixels[160:200, 180:220].mean(axis=(0, 1)))
    assert np.abs(shown[0] - shown[1]).max() > 0.3


def test_movies_show_all_load_steps(tmp_path):
    bodies, surfaces, points = two_cubes()
    writer = FieldWriter(tmp_path, MPI.COMM_SELF)
    for step in (1, 2, 3):
        bodies.point_data["displacement"] = -0.03 * step * bodies.points
        writer.write(step, float(step), bodies, surfaces, points)
    path = movie(tmp_path, "displacement", tmp_path / "a.gif", size=SMALL)
    with Image.open(path) as film:
        assert film.n_frames >= 3 and film.size == SMALL
        film.seek(0)
        first = np.asarray(film.convert("RGB"), dtype=int)
        film.seek(2)
        assert np.abs(first - np.asarray(film.convert("RGB"))).mean() > 1.0
    if not extra.missing(("imageio_ffmpeg",)):
        path = movie(tmp_path, "displacement", tmp_path / "a.mp4", size=SMALL)
        assert path.read_bytes()[4:8] == b"ftyp"


def test_a_page_holds_all_it_needs(solid_run):
    pytest.importorskip("trame_vtk")
    words = page(solid_run, None, solid_run / "a.html", size=SMALL).read_text()
    assert "OfflineLocalView.load" in words and "Contact pressure: time 1" in words
    assert not re.search(r"<(script|link)[^>]*(src|href)=.?https?:", words)


def test_a_page_has_a_slider_and_a_choice(tmp_path):
    """Over load steps, of fields, each a scene of its own in the same colours; a title that is seen, and the tab's."""
    pytest.importorskip("trame_vtk")
    writer, (bodies, surfaces, points) = FieldWriter(tmp_path, MPI.COMM_SELF), two_cubes()
    for step in (0, 1, 2):
        writer.write(step, 0.5 * step, bodies, surfaces, points)
    words = page(tmp_path, None, tmp_path / "a.html", size=SMALL).read_text()
    assert f"<title>{tmp_path.name}: Contact pressure</title>" in words and words.count("<title>") == 1
    assert '<h1 id="title">' in words and 'type="range"' in words and "<select" in words
    content = json.loads(re.search(r'<script type="application/json" id="content">(.*?)</script>', words)[1])
    assert content["fields"][:3] == ["Contact pressure", "Equivalent stress", "Displacement"]
    assert content["steps"] == ["time 0.5", "time 1"], "load steps; the undeformed bodies are none"
    for titles, scenes in zip(content["titles"], content["scenes"], strict=True):
        assert len(titles) == len(scenes) == 2 and ["time 0.5" in titles[0], "time 1" in titles[1]] == [True, True]
        for scene in scenes:
            with zipfile.ZipFile(io.BytesIO(base64.b64decode(scene))) as archive:
                assert json.loads(archive.read("index.json"))["scene"]["type"].endswith("RenderWindow")
    one = page(tmp_path, "displacement,pressure", tmp_path / "b.html", step=1, size=SMALL).read_text()
    content = json.loads(re.search(r'id="content">(.*?)</script>', one)[1])
    assert content["fields"] == ["Displacement, Pressure"] and content["steps"] == ["time 0.5"]


def test_windows_and_pages_have_several_views(solid_run, monkeypatch):
    """Side by side; what is drawn flat is no view of theirs."""
    pytest.importorskip("trame_vtk")
    look = Look(views=("whole", "cut", "near"))
    plotter, titles = export._plotted(staged(load_result(solid_run), "displacement", look), look, off_screen=True)
    try:
        assert plotter.shape == (1, 3) and titles.count("(near)") == 1
        scales = [renderer.camera.parallel_scale for renderer in plotter.renderers]
        assert scales[2] < scales[0], "near is nearer"
        assert len(plotter.scalar_bars) == 3
        assert plotter.renderers[1].actors and len({renderer.camera.position for renderer in plotter.renderers}) > 1
    finally:
        plotter.close()
    with pytest.raises(InputError, match="-views: found profile in a page; allowed: whole, cut, near"):
        show(str(solid_run), {"views": "profile", "o": str(solid_run / "b.html")})


def test_the_mesh_is_the_bodies_in_their_colours(solid_run):
    result = load_result(solid_run)
    mesh, body = find(result, "mesh"), find(result, "body")
    assert mesh.name == "body" and mesh.whole
    np.testing.assert_array_equal(mesh.values[""], body.values[""])


def test_a_display_that_does_not_answer(monkeypatch):
    """As after a lost connection: there are no windows, and no waiting for one."""
    monkeypatch.setenv("DISPLAY", "127.0.0.1:9999")
    assert not extra.has_display()
    monkeypatch.delenv("DISPLAY")
    assert not extra.has_display()


def test_without_what_draws_one_line_says_what_to_install(solid_run, monkeypatch):
    """In an environment that the set-up has not made nothing is installed."""
    monkeypatch.setattr(extra, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "prefix", str(solid_run))
    with pytest.raises(InputError, match=r"found no Python package pyvista.*the extra `view`: .* -m pip install"):
        show(str(solid_run), {})


@pytest.mark.parametrize(("answer", "runs"), [(None, 0), ("\n", 0), ("no\n", 0), ("y\n", 1)])
def test_nothing_is_installed_unasked(tmp_path, monkeypatch, answer, runs):
    """Nor where nobody can be asked."""
    commands = []
    (tmp_path / "pcontact-setup").touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(extra, "find_spec", lambda name: None if len(commands) == 0 else name)
    monkeypatch.setattr(extra.subprocess, "run", lambda words, **_: commands.append(words) or Mock(returncode=0))
    for name in ("stdin", "stderr"):
        monkeypatch.setattr(sys, name, io.StringIO(answer))
        getattr(sys, name).isatty = lambda: answer is not None
    with nullcontext() if runs else pytest.raises(InputError, match="-m pip install"):
        extra.require()
    assert len(commands) == runs


def test_what_cannot_draw_is_found_out_in_another_process(monkeypatch):
    """With OSMesa forced and not there VTK crashes; here that is one line."""
    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(extra, "OFF_SCREEN", ("vtkNoSuchRenderWindow",))
    monkeypatch.setattr(extra, "_PROBE", "import os; os.kill(os.getpid(), 11)")
    with pytest.raises(InputError, match="one of EGL and OSMesa"):
        extra.prepare_off_screen()
