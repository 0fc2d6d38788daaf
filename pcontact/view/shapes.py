"""Bodies and contact surfaces as VTK's meshes (skin, section, lines of the mesh), and these as pixels, without a
display, or in a plotter that people turn.
"""

from dataclasses import dataclass, field

import numpy as np
import pyvista
from matplotlib.colors import ListedColormap, to_rgba_array
from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter, vtkUnstructuredGridGeometryFilter

from pcontact.io import vtu
from pcontact.io.fields import Piece
from pcontact.view import cells
from pcontact.view.colours import GREYS, INK

VALUE, BODY = "value", "body"  # of what is drawn
CREASE = 40.0  # [degrees] turn between facets from which on their common edge is drawn
FINE = 2  # pixels computed per pixel shown, in each direction
THIN, THICK = 0.8, 1.2  # [pixels] lines of the mesh, outlines
LIFT = 2e-3  # [extent of what is drawn] lines above their faces
_LAMP = (-0.35, 0.55, 0.76)  # right, up, toward the viewer


@dataclass
class Shape:
    """Shape that is drawn.

    Parameters
    ----------
    faces : list of (pyvista.PolyData, bool)
        Polygons with the data `VALUE` of points or cells, NaN: grey, and the cell data `BODY`; and whether they are
        shaded by their slope. What is flat is not: its colours are those of the colour bar.
    lines : list of pyvista.PolyData
        Edges of the mesh.
    outlines : list of pyvista.PolyData
        Borders, and edges that are sharp.
    size : float
        Usual length of an edge of the mesh [length].
    """

    faces: list = field(default_factory=list)
    lines: list = field(default_factory=list)
    outlines: list = field(default_factory=list)
    size: float = 0.0

    def points(self):
        """ndarray (n, 3) : corners of all that is drawn."""
        return np.concatenate([np.zeros((0, 3)), *(np.asarray(mesh.points, dtype=float) for mesh, _ in self.faces)])


def grid(piece, positions, values=None, at="cell"):
    """Cells as VTK has them.

    Parameters
    ----------
    piece : Piece
    positions : ndarray (n, 3)
        Points as they are drawn.
    values : ndarray or None
        Per cell or per point; None: NaN.
    at : str
        "cell" or "point".

    Returns
    -------
    pyvista.UnstructuredGrid
    """
    tables = [(vtu.CELL_TYPES[name][0], np.asarray(nodes)) for name, nodes in piece.cells if len(nodes)]
    rows = [np.column_stack([np.full(len(nodes), nodes.shape[1]), nodes]).ravel() for _, nodes in tables]
    kinds = np.concatenate([np.zeros(0, np.uint8), *(np.full(len(nodes), kind, np.uint8) for kind, nodes in tables)])
    made = pyvista.UnstructuredGrid(np.concatenate([np.zeros(0, np.int64), *rows]).astype(np.int64), kinds, positions)
    body = [part for part in piece.cell_data.get("body", []) if len(part)]
    made.cell_data[BODY] = np.concatenate(body).astype(np.int32) if body else np.zeros(len(kinds), np.int32)
    data = made.cell_data if at == "cell" else made.point_data
    count = made.n_cells if at == "cell" else made.n_points
    data[VALUE] = np.full(count, np.nan) if values is None else np.asarray(values, dtype=float)
    return made


def _run(source, data):
    source.SetInputData(data)
    source.Update()
    return pyvista.wrap(source.GetOutput())


def surface(data):
    """Plane cells, or the skin of solid ones, as polygons; edges of degree 2 have their middle nodes."""
    source = vtkDataSetSurfaceFilter()
    source.SetNonlinearSubdivisionLevel(1)
    source.PassThroughPointIdsOff()
    return _run(source, data)


def _lines(data, positions, piece=None):
    """Edges of plane cells, or of the skin of solid ones."""
    if piece is None:
        found = _run(vtkUnstructuredGridGeometryFilter(), data)
        names = {int(kind): vtu.CELL_NAMES[int(kind)][0] for kind in np.unique(found.celltypes)}
        tables = found.cells_dict
        piece = Piece(found.points, [(name, tables[kind]) for kind, name in names.items()])
        positions = np.asarray(found.points)
    made = pyvista.PolyData()
    made.points = positions
    made.lines = cells.edges(piece)
    return made


def _size(lines):
    """Usual length of an edge."""
    if not lines.n_lines:
        return 0.0
    table, offset = lines.GetLines().GetConnectivityArray(), lines.GetLines().GetOffsetsArray()
    nodes, starts = pyvista.convert_array(table), pyvista.convert_array(offset)
    ends = np.asarray(lines.points)[np.column_stack([nodes[starts[:-1]], nodes[starts[1:] - 1]])]
    return float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))


def bodies(piece, positions, values=None, at="cell", smooth=False, plane=None):
    """The bodies: plane cells, or the skin of solid ones and their section.

    Parameters
    ----------
    piece : Piece
        Bodies without nodes in common.
    positions : ndarray (n, 3)
        Points as they are drawn.
    values : ndarray or None
        Per cell or per point; None: grey.
    at : str
        "cell" or "point".
    smooth : bool
        Values of cells are averaged at the nodes.
    plane : tuple of (ndarray (3,), float), optional
        Normal and offset: what is beyond is cut away (solids only).

    Returns
    -------
    Shape
    """
    volume = grid(piece, positions, values, at)
    if smooth and at == "cell" and values is not None:
        means = volume.cell_data_to_point_data()
        volume.point_data[VALUE] = means.point_data[VALUE]
        volume.cell_data.remove(VALUE)
    solid = cells.dimension(piece) == 3
    faces = surface(volume)
    lines = _lines(volume, positions, None if solid else piece)
    if not solid:
        return Shape([(faces, False)], [lines], [_creases(faces)], _size(lines))
    if plane is None:
        return Shape([(faces, True)], [lines], [_creases(faces)], _size(lines))
    normal, offset = np.asarray(plane[0], dtype=float), plane[1]
    distance = positions @ normal - offset
    origin = normal * offset
    section = volume.slice(normal=normal, origin=origin, generate_triangles=False)
    facets = cells.cut_facets(piece, distance)
    inner = grid(facets, positions).slice(normal=normal, origin=origin) if facets.cells else pyvista.PolyData()
    size = _size(lines)
    parts = [mesh.clip(normal=normal, origin=origin) for mesh in (faces, lines, _creases(faces))]
    rim = _border(section)
    return Shape([(parts[0], True), (section, False)], [parts[1], inner], [parts[2], rim], size)


def contact(piece, positions, values, at="cell", idle="keep"):
    """The facets of a contact pair.

    Parameters
    ----------
    piece : Piece
    positions : ndarray (n, 3)
    values : ndarray
        Per cell or per point.
    at : str
    idle : {"keep", "grey", "drop"}
        What becomes of facets without a positive value.

    Returns
    -------
    Shape
    """
    flat = grid(piece, positions, values, at)
    if idle != "keep":
        value = np.asarray(flat[VALUE])
        if at == "point":
            acts = np.concatenate([(value[table] > 0).any(axis=1) for _, table in piece.cells])
        else:
            acts = value > 0
        if idle == "drop":
            chosen = np.flatnonzero(acts)
            flat = flat.extract_cells(chosen) if len(chosen) else pyvista.UnstructuredGrid()
        elif at == "cell":
            flat.cell_data[VALUE] = np.where(acts, value, np.nan)
    if not flat.n_cells:
        return Shape()
    faces, lines = surface(flat), _lines(flat, None)
    return Shape([(faces, idle == "drop")], [lines], [_border(faces)], _size(lines))


def _creases(faces):
    return faces.extract_feature_edges(
        feature_angle=CREASE, non_manifold_edges=False, manifold_edges=False, clear_data=True
    )


def _border(faces):
    return faces.extract_feature_edges(
        boundary_edges=True, feature_edges=False, non_manifold_edges=False, manifold_edges=False, clear_data=True
    )


def join(shapes):
    """Several shapes as one."""
    made = Shape(size=max((shape.size for shape in shapes), default=0.0))
    for shape in shapes:
        made.faces += shape.faces
        made.lines += shape.lines
        made.outlines += shape.outlines
    return made


def add(plotter, shape, scale, pixel=0.0, opacity=1.0, width=1.0, lift=(0.0, 0.0, 0.0), thick=1.0):
    """Add a shape to a plotter.

    Parameters
    ----------
    plotter : pyvista.Plotter
    shape : pcontact.view.shapes.Shape
    scale : pcontact.view.colours.ColourScale
    pixel : float
        Size of a pixel shown: lines are fainter where cells are only a few pixels large, lest they cover the colours;
        0: not known [length].
    opacity : float
    width : float
        Factor of the widths of lines.
    lift : array_like (3,)
        Lines are drawn by this nearer to the viewer than the faces that they are on [length].
    thick : float
        Width of faces that are lines: contact surfaces of plane bodies [pixels].
    """
    colours = ListedColormap(scale.table(256))
    for mesh, lit in shape.faces:
        if not mesh.n_cells:
            continue
        ambient, diffuse = (0.55, 0.5) if lit else (0.0, 1.0)
        look = {"lighting": lit, "ambient": ambient, "diffuse": diffuse, "specular": 0.0, "opacity": opacity,
                "show_scalar_bar": False, "smooth_shading": False, "line_width": thick}  # fmt: skip
        if np.isnan(np.asarray(mesh[VALUE])).all():
            grey = np.rint(255.0 * to_rgba_array(GREYS)[:, :3]).astype(np.uint8)
            mesh = mesh.copy(deep=False)
            mesh.clear_point_data()
            mesh.cell_data["grey"] = grey[np.asarray(mesh.cell_data[BODY]) % len(grey)]
            plotter.add_mesh(mesh, scalars="grey", rgb=True, **look)
        else:
            plotter.add_mesh(
                mesh, scalars=VALUE, cmap=colours, clim=(scale.norm.vmin, scale.norm.vmax), nan_color=GREYS[0],
                interpolate_before_map=True, copy_mesh=True, **look,
            )  # fmt: skip
    strength = 0.5 if not pixel else 0.5 * np.clip((shape.size / pixel - 3) / 15, 0, 1)
    for meshes, share, size in ((shape.lines, strength, THIN), (shape.outlines, 0.75, THICK)):
        for mesh in meshes:
            if mesh.n_cells and share > 0.02:
                plotter.add_mesh(
                    mesh.translate(lift, inplace=False), color=INK, line_width=size * width,
                    opacity=float(share) * opacity, lighting=False,
                    show_scalar_bar=False,
                )  # fmt: skip


def aim(plotter, camera, window):
    """Have the plotter's current view look through a window, without perspective; a lamp at the left shoulder."""
    middle = np.array([(window[0] + window[1]) / 2, (window[2] + window[3]) / 2, 0.0])
    focus = middle @ camera.axes
    points = np.array(plotter.bounds).reshape(3, 2)
    far = 2 * np.linalg.norm(np.ptp(points, axis=1)) + np.abs(points).max() + 1e-12
    plotter.camera.focal_point, plotter.camera.position = focus, focus + far * camera.axes[2]
    plotter.camera.up = camera.axes[1]
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = (window[3] - window[2]) / 2
    plotter.reset_camera_clipping_range()
    plotter.remove_all_lights()
    plotter.add_light(pyvista.Light(position=focus + far * (np.array(_LAMP) @ camera.axes), focal_point=focus,
                                    light_type="scene light", intensity=1.0))  # fmt: skip


def image(shape, camera, window, size, scale):
    """Draw a shape.

    Parameters
    ----------
    shape : pcontact.view.shapes.Shape
    camera : pcontact.view.camera.Camera
    window : tuple of 4 floats
        Left, right, bottom, top in the view [length].
    size : tuple of int
        Height and width in pixels.
    scale : pcontact.view.colours.ColourScale

    Returns
    -------
    ndarray of float32 (height, width, 4)
        Red, green, blue, opacity, 0 to 1; row 0 at the top.
    """
    height, width = size
    plotter = pyvista.Plotter(off_screen=True, window_size=(width * FINE, height * FINE), lighting="none")
    plotter.set_background("white")
    try:
        extent = np.ptp(shape.points(), axis=0).max(initial=0.0) if len(shape.points()) else 0.0
        add(plotter, shape, scale, (window[1] - window[0]) / width, width=FINE, lift=LIFT * extent * camera.axes[2])
        if not plotter.actors:
            return np.zeros((height, width, 4), dtype=np.float32)
        aim(plotter, camera, window)
        pixels = plotter.screenshot(None, return_img=True, transparent_background=True)
    finally:
        plotter.close()
    pixels = pixels.astype(np.float32) / 255
    return _reduced(pixels[: height * FINE, : width * FINE])


def _reduced(pixels):
    """Blocks of pixels averaged: lines and borders become smooth."""
    height, width, _ = pixels.shape
    pixels[..., :3] *= pixels[..., 3:]
    mean = pixels.reshape(height // FINE, FINE, width // FINE, FINE, 4).mean(axis=(1, 3))
    mean[..., :3] /= np.maximum(mean[..., 3:], 1e-6)
    return mean


def through_glass(inside, glass):
    """Return what lies between bodies, seen through them.

    Parameters
    ----------
    inside, glass : ndarray (height, width, 4)
        Pixels of what lies between, and of the bodies.

    Returns
    -------
    ndarray (height, width, 4)
    """
    body, seen = glass[..., 3:], inside[..., 3:]
    pale = glass[..., :3] * 0.62 + 0.38
    rgb = (1 - seen) * pale + seen * (0.3 * glass[..., :3] + 0.7 * inside[..., :3])
    rgb = np.where(body > 0, rgb, inside[..., :3])
    return np.concatenate([rgb, np.maximum(body, seen)], axis=2)
