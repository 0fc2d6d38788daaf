"""Reading of mesh files through meshio: every format that has no reader of its own."""

import importlib
import io
from contextlib import redirect_stderr, redirect_stdout

import numpy as np

from pcontact.element.reference import n_nodes
from pcontact.mesh.raw import KINDS, FileMesh, default_name
from pcontact.runtime import log
from pcontact.runtime.errors import InputError

# cell data that number groups, by format
_TAG_KEYS = (
    "gmsh:physical",
    "medit:ref",
    "nastran:ref",
    "avsucd:material",
    "netgen:index",
    "su2:tag",
    "ugrid:ref",
    "tetgen:ref",
    "cell_tags",
)
# nodes of cells that are filled up later
_INCOMPLETE = {"quad8": 8, "hexahedron20": 20, "wedge15": 15, "pyramid13": 13}
_INSTALL = "another file type, or that package installed"


def read_meshio(path):
    """What meshio makes of a file; its messages go to the log, its failures become an InputError."""
    suffix = path.suffix.lower()
    try:
        # a tenth of a second that a gmsh file does not need
        meshio = importlib.import_module("meshio")
    except ModuleNotFoundError as error:
        raise InputError(f'{path}: needs the Python package "{error.name}"; allowed: {_INSTALL}') from None
    known = sorted(meshio.extension_to_filetypes)
    if not any(path.name.lower().endswith(extension) for extension in known):
        raise InputError(f'{path}: found the unknown mesh file type "{suffix}"; allowed: {", ".join(known)}')
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            mesh = meshio.read(path)
    except ModuleNotFoundError as error:
        raise InputError(f'{path}: needs the Python package "{error.name}"; allowed: {_INSTALL}') from None
    except (Exception, SystemExit) as error:  # meshio's readers fail in any way, and end the program
        reason = said.getvalue() if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        reason = " ".join(reason.split()) or "no reason given"
        raise InputError(
            f"{path}: cannot be read as {suffix}: {reason}; allowed: a complete file of that type"
        ) from None
    if said.getvalue().strip():
        log.debug("%s: %s", path, " ".join(said.getvalue().split()))
    return mesh


def from_meshio(mesh, path):
    """Elements and groups of a mesh of meshio's.

    Groups come from cell and point sets, and from cell data that number groups (named by the field data where these
    know the number).

    Parameters
    ----------
    mesh : meshio.Mesh
    path : Path

    Returns
    -------
    FileMesh
        Elements and nodes are numbered from 1 in the order of the file: meshio does not keep its numbers.

    Raises
    ------
    InputError
        There are no nodes, or an element refers to one that does not exist.
    """
    if not np.size(mesh.points):
        raise InputError(f"{path}: the file holds no nodes; allowed: nodes and cells")
    file = FileMesh.of(mesh.points)
    for block in mesh.cells:
        file.add_elements(path, block.type, block.dim, _nodes(block, path))
    _sets(mesh, file, path)
    _numbers(mesh, file)
    return file


def _nodes(block, path):
    """Nodes (n, k) of a block of elements of meshio's, checked."""
    if block.type.startswith("polyhedron"):
        return np.zeros((len(block), 0), np.int64)
    nodes = np.asarray(block.data)
    width = _INCOMPLETE.get(block.type) or (n_nodes(*KINDS[block.type]) if block.type in KINDS else nodes.shape[-1])
    if nodes.shape != (len(block), width):
        raise InputError(f"{path}: elements of type {block.type} lack nodes; allowed: {width} nodes each")
    return nodes.astype(np.int64)


def _sets(mesh, file, path):
    """Named sets of cells and points. A set may mix dimensions."""
    for name, parts in mesh.cell_sets.items():
        # those of gmsh's reader are no groups
        for k, rows in enumerate(parts if not str(name).startswith("gmsh:") else ()):
            if rows is not None and len(rows):
                file.add(file.tables[k].dim, str(name), k, _rows(rows, len(file.tables[k].tags), name, path))
    for name, rows in mesh.point_sets.items():
        if len(rows):
            file.point_groups[str(name)] = _rows(rows, len(file.points), name, path)


def _rows(rows, bound, name, path):
    rows = np.asarray(rows).ravel()
    rows = np.flatnonzero(rows) if rows.dtype == bool else rows.astype(np.int64)
    if len(rows) and not 0 <= rows.min() <= rows.max() < bound:
        raise InputError(
            f'{path}: group "{name}" refers to what is not in the file; allowed: nodes and elements of the file'
        )
    return rows


def _numbers(mesh, file):
    """Groups that cell data give by number; 0 means no group."""
    names = {(int(v[1]), int(v[0])): name for name, v in mesh.field_data.items() if np.size(v) == 2}
    file.declared = [(dim, name) for (dim, _), name in names.items()]
    for key in _TAG_KEYS:
        for k, values in enumerate(mesh.cell_data.get(key, [])):
            dim, values = file.tables[k].dim, np.ravel(values)
            chosen = np.isfinite(values) & (values != 0) & (values == np.round(values))
            for value in np.unique(values[chosen]):
                name = names.get((dim, int(value)), default_name(dim, int(value)))
                file.add(dim, name, k, np.flatnonzero(values == value))
