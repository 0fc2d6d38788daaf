"""Bodies and contact surfaces as VTK's meshes, ready to be looked at: skin, section, lines of the mesh."""

from dataclasses import dataclass, field

import numpy as np
import pyvista
from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter, vtkUnstructuredGridGeometryFilter

from pcontact.io import vtu
from pcontact.io.fields import Piece
from pcontact.view import cells

VALUE, BODY = "value", "body"  # of what is drawn
CREASE = 40.0  # [degrees] turn between facets from which on their common edge is drawn


@dataclass
class Shape:
    """What is drawn.

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
