"""Reading of mesh files of other programs: Exodus II, blocks, node sets and side sets with their names; MED (Salome,
code_aster, gmsh), version 2 to 4, with the groups of their families; every other format through meshio.

Exodus' files are netCDF, today mostly in HDF5; those in netCDF's own format need the package netCDF4.
"""

import importlib
import io
from contextlib import redirect_stderr, redirect_stdout

import h5py
import numpy as np

from pcontact.element.reference import n_nodes
from pcontact.mesh.raw import KINDS, LOWER, FileMesh, Table, default_name
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import GEOMETRIES, reading

# cell data that number groups, by format
_TAG_KEYS = ("gmsh:physical", "medit:ref", "nastran:ref", "avsucd:material", "netgen:index", "su2:tag", "ugrid:ref",
             "tetgen:ref", "cell_tags")  # fmt: skip
# what is said of a file that ends in the middle, or is of another type
_UNREADABLE = "cannot be read as {}: {{kind}}: {{reason}}; allowed: a complete file of that type"
# nodes of cells that are filled up later
_INCOMPLETE = {"quad8": 8, "hexahedron20": 20, "wedge15": 15, "pyramid13": 13}
# types that meshio does not know, see `pcontact.mesh.read.READERS`
_WITHOUT_MESHIO = ".h5", ".unv"
_INSTALL = "another file type, or that package installed"
# kind (meshio's name) and dimension by the beginning of an Exodus type and the number of nodes
_EXODUS_KINDS = {
    ("SPH", 1): ("vertex", 0), ("CIR", 1): ("vertex", 0), ("POI", 1): ("vertex", 0), ("NOD", 1): ("vertex", 0),
    **{(name, n): (kind, 1) for name in ("BAR", "BEA", "TRU", "EDG", "ROD") for n, kind in ((2, "line"), (3, "line3"))},
    **{(name, n): (kind, 2) for name in ("TRI", "SHE") for n, kind in ((3, "triangle"), (6, "triangle6"))},
    **{(name, n): (kind, 2) for name in ("QUA", "SHE") for n, kind in ((4, "quad"), (8, "quad8"), (9, "quad9"))},
    ("TET", 4): ("tetra", 3), ("TET", 10): ("tetra10", 3),
    ("WED", 6): ("wedge", 3), ("WED", 15): ("wedge15", 3), ("PYR", 5): ("pyramid", 3), ("PYR", 13): ("pyramid13", 3),
    ("HEX", 8): ("hexahedron", 3), ("HEX", 20): ("hexahedron20", 3), ("HEX", 27): ("hexahedron27", 3),
}  # fmt: skip
_DIMENSIONS = {"WED": 3, "PYR": 3, "TET": 3, "HEX": 3, "NSI": 2, "NFA": 3}

_TO_VTK = [*range(12), *range(16, 20), *range(12, 16)]
# positions in Exodus' node order of VTK's nodes, where the two differ
_EXODUS_ORDER = {"wedge15": [*range(9), 12, 13, 14, 9, 10, 11], "hexahedron20": _TO_VTK,
          "hexahedron27": [*_TO_VTK, 23, 24, 25, 26, 21, 22, 20]}  # fmt: skip

# vertices of the sides of a cell, in the order of their numbers
_EDGES = {3: [(0, 1), (1, 2), (2, 0)], 4: [(0, 1), (1, 2), (2, 3), (3, 0)]}
_SIDES = {
    "tetra": [(0, 1, 3), (1, 2, 3), (0, 3, 2), (0, 2, 1)],
    "wedge": [(0, 1, 4, 3), (1, 2, 5, 4), (0, 3, 5, 2), (0, 2, 1), (3, 4, 5)],
    "pyramid": [(0, 1, 4), (1, 2, 4), (2, 3, 4), (0, 4, 3), (0, 3, 2, 1)],
    "hexahedron": [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (0, 4, 7, 3), (0, 3, 2, 1), (4, 5, 6, 7)],
}
# kind (meshio's name), dimension and number of nodes by MED's name
_MED_KINDS = {
    "PO1": ("vertex", 0), "SE2": ("line", 1), "SE3": ("line3", 1), "TR3": ("triangle", 2), "TR6": ("triangle6", 2),
    "QU4": ("quad", 2), "QU8": ("quad8", 2), "QU9": ("quad9", 2), "TE4": ("tetra", 3), "T10": ("tetra10", 3),
    "HE8": ("hexahedron", 3), "H20": ("hexahedron20", 3), "H27": ("hexahedron27", 3), "PE6": ("wedge", 3),
    "P15": ("wedge15", 3), "P18": ("wedge18", 3), "PY5": ("pyramid", 3), "P13": ("pyramid13", 3),
}  # fmt: skip
# positions in MED's node order of VTK's nodes, where the two differ (but for the sense, which is turned later)
_MED_ORDER = {"hexahedron27": [*range(20), 24, 22, 21, 23, 20, 25, 26]}
# dimensions of others, unless 3
_OTHERS = {"SE4": 1, "TR7": 2, "POG": 2, "POG2": 2}
# characters of the name of a group
_NAME = 80


def instead(path):
    """Words for a message: what makes a mesh of a file that holds something else; none where nothing is known."""
    suffix = path.suffix.lower()
    if suffix == ".inp":
        return f"; of a deck of Abaqus or CalculiX, pcontact import {path} makes a scene with its mesh"
    if suffix in (*GEOMETRIES, ".iges", ".igs"):
        return f"; of a geometry, gmsh -3 -order 2 {path} -o {path.with_suffix('.msh')} makes a mesh (in the plane: -2)"
    return ""


def read_meshio(path):
    """Read a file by meshio; its messages go to the log, its failures become an InputError."""
    suffix = path.suffix.lower()
    try:
        # a tenth of a second that a gmsh file does not need
        meshio = importlib.import_module("meshio")
    except ModuleNotFoundError as error:
        raise InputError(f'{path}: needs the Python package "{error.name}"; allowed: {_INSTALL}') from None
    known = sorted(meshio.extension_to_filetypes)
    if not any(path.name.lower().endswith(extension) for extension in known):
        allowed = ", ".join(sorted({*known, *_WITHOUT_MESHIO}))
        raise InputError(f'{path}: found the unknown mesh file type "{suffix}"; allowed: {allowed}{instead(path)}')
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
            f"{path}: cannot be read as {suffix}: {reason}; allowed: a complete file of that type{instead(path)}"
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
        raise _beyond(path, name)
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


def read_exodus(path):
    """Read an Exodus II file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    FileMesh
        A block, set of nodes or set of sides without a name is called after its number (`volume_3`).

    Raises
    ------
    InputError
        The file is damaged, or in netCDF's own format and the package netCDF4 is missing.
    """
    with open(path, "rb") as stream:
        classic = stream.read(3) == b"CDF"
    try:
        module = importlib.import_module("netCDF4") if classic else None
    except ModuleNotFoundError as error:
        raise InputError(
            f'{path}: found the classic format of netCDF, which needs the Python package "{error.name}"; '
            "allowed: netCDF-4 (HDF5), or that package installed"
        ) from None
    with reading(path, _UNREADABLE.format(path.suffix)):
        if classic:
            with module.Dataset(path) as file:
                file.set_auto_mask(False)
                types = {name: v.elem_type for name, v in file.variables.items() if name[:7] == "connect"}
                return _of_exodus(path, file.variables, types)
        with h5py.File(path, "r") as file:
            types = {k: v.attrs.get("elem_type", "") for k, v in file.items() if k[:7] == "connect"}
            return _of_exodus(path, file, types)


def _of_exodus(path, variables, types):
    """The mesh from the variables of a file, by name, and the types of its blocks."""
    points = _points(variables)
    file, starts = FileMesh.of(points), [0]
    for number in range(1, len(types) + 1):
        nodes = np.asarray(variables[f"connect{number}"][...], dtype=np.int64) - 1
        kind, dim = _kind(types[f"connect{number}"], nodes.shape[1])
        starts.append(starts[-1] + len(nodes))
        file.add_elements(path, kind, dim, nodes[:, _EXODUS_ORDER[kind]] if kind in _EXODUS_ORDER else nodes)
    blocks = list(file.tables)
    for k, (number, name) in enumerate(_labels(variables, "eb", len(blocks))):
        file.add(blocks[k].dim, name or default_name(blocks[k].dim, number), k, np.arange(len(blocks[k].tags)))
    for k, (number, name) in enumerate(_labels(variables, "ns", _count(variables, "node_ns"))):
        nodes = np.asarray(variables[f"node_ns{k + 1}"][...], dtype=np.int64) - 1
        if len(nodes) and not 0 <= nodes.min() <= nodes.max() < len(points):
            raise _beyond(path, name or default_name(0, number))
        file.point_groups[name or default_name(0, number)] = nodes
    top = max((table.dim for table in blocks), default=0)
    for k, (number, name) in enumerate(_labels(variables, "ss", _count(variables, "elem_ss"))):
        elements, sides = (np.asarray(variables[f"{what}_ss{k + 1}"][...], dtype=np.int64) for what in ("elem", "side"))
        name = name or default_name(max(top - 1, 0), number)
        if len(elements) and not 1 <= elements.min() <= elements.max() <= starts[-1] or len(sides) != len(elements):
            raise _beyond(path, name)
        _add_sides(path, file, blocks, np.array(starts), name, elements - 1, sides, points.shape[1])
    return file


def _beyond(path, name):
    return InputError(
        f'{path}: group "{name}" refers to what is not in the file; allowed: nodes, elements and sides of the file'
    )


def _points(variables):
    """Coordinates (n, d)."""
    if "coord" in variables:
        return np.asarray(variables["coord"][...], dtype=float).T
    names = [name for name in ("coordx", "coordy", "coordz") if name in variables]
    return np.stack([np.asarray(variables[name][...], dtype=float) for name in names], axis=1)


def _kind(text, n_nodes):
    """Kind and dimension of the elements of a block."""
    text = (text.decode() if isinstance(text, bytes) else str(text)).strip("\0 ").upper()
    known = _EXODUS_KINDS.get((text[:3], n_nodes))
    return known or (f"{text} with {n_nodes} nodes", _DIMENSIONS.get(text[:3], 2))


def _count(variables, prefix):
    """Count the variables that are called so, with numbers from 1 on."""
    k = 1
    while f"{prefix}{k}" in variables:
        k += 1
    return k - 1


def _labels(variables, what, n):
    """Number and name ("" if it has none) of each of n blocks (eb), node sets (ns) or side sets (ss)."""
    numbers, names = np.arange(1, n + 1), [""] * n
    if f"{what}_prop1" in variables:
        numbers = np.asarray(variables[f"{what}_prop1"][...])[:n]
    if f"{what}_names" in variables:
        rows = np.asarray(variables[f"{what}_names"][...])[:n]
        names = [b"".join(np.asarray(row, dtype="S1").tolist()).decode("utf-8", "replace").strip("\0 ") for row in rows]
    return list(zip(numbers.tolist(), names, strict=True))


def _add_sides(path, file, blocks, starts, name, elements, sides, space):
    """Facets of a side set: elements (n,) from 0, sides (n,) from 1. Plane elements in space have two faces first."""
    number = np.searchsorted(starts, elements, side="right") - 1
    for k in np.unique(number).tolist():
        block, mine = blocks[k], number == k
        rows, local = elements[mine] - starts[k], sides[mine] - 1
        family = block.kind.rstrip("0123456789")
        if family in _SIDES:
            table = _SIDES[family]
        elif family in ("triangle", "quad"):
            table = _EDGES[3 if family == "triangle" else 4]
            faces = [tuple(range(len(table)))] * 2
            table = (faces if space == 3 else []) + table
        else:
            raise InputError(f'{path}: group "{name}" has sides of elements of type {block.kind}; allowed: of cells')
        if local.min() < 0 or local.max() >= len(table):
            raise _beyond(path, name)
        for side in np.unique(local).tolist():
            nodes = block.nodes[rows[local == side]][:, table[side]]
            n = nodes.shape[1]
            file.tables.append(Table(*LOWER[n], nodes, block.tags[rows[local == side]]))
            file.add(file.tables[-1].dim, name, len(file.tables) - 1, np.arange(len(nodes)))


def read_med(path):
    """Read a MED file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    FileMesh
        Elements and nodes are numbered from 1 in the order of the file.

    Raises
    ------
    InputError
        The file is damaged, or holds more than one mesh or step of a mesh.
    """
    with reading(path, _UNREADABLE.format(".med")), h5py.File(path, "r") as file:
        return _of_med(path, file)


def _of_med(path, file):
    meshes = list(file["ENS_MAA"])
    if len(meshes) != 1:
        raise InputError(f"{path}: found {len(meshes)} meshes; allowed: one")
    mesh = file["ENS_MAA"][meshes[0]]
    dim = int(mesh.attrs["ESP"] if "ESP" in mesh.attrs else mesh.attrs["DIM"])
    # version 2 has the families in the mesh, and no steps of the mesh
    families = mesh.get("FAS") or file.get(f"FAS/{meshes[0]}") or {}
    if "NOE" not in mesh:
        if len(mesh) != 1:
            raise InputError(f"{path}: found {len(mesh)} steps of the mesh; allowed: one")
        mesh = mesh[next(iter(mesh))]
    # coordinate after coordinate, of all nodes; so are the nodes of cells
    coordinates = mesh["NOE/COO"][()].reshape(dim, -1).T
    out, names, points = FileMesh.of(coordinates), _families(families.get("ELEME", {})), coordinates
    for code, group in mesh["MAI"].items():
        kind, table_dim = _MED_KINDS.get(code, (f"MED {code}", _OTHERS.get(code, 3)))
        n_nodes = int("".join(c for c in code if c.isdigit())) if code in _MED_KINDS else 0
        nodes = group["NOD"][()].reshape(n_nodes, -1).T - 1 if n_nodes else np.zeros((len(group["FAM"]), 0), np.int64)
        number = out.add_elements(path, kind, table_dim, nodes[:, _MED_ORDER[kind]] if kind in _MED_ORDER else nodes)
        if "FAM" in group:
            for family, rows in _members(group["FAM"][()], len(nodes), names):
                for name in names[family]:
                    out.add(table_dim, name, number, rows)
    names = _families(families.get("NOEUD", {}))
    if "FAM" in mesh["NOE"]:
        for family, rows in _members(mesh["NOE/FAM"][()], len(points), names):
            for name in names[family]:
                out.point_groups[name] = np.union1d(out.point_groups.get(name, rows), rows)
    return out


def _members(numbers, n, names):
    """Families that have names, and their rows."""
    if len(numbers) != n:
        raise ValueError(f"{len(numbers)} families of {n} elements or nodes")
    for family in np.unique(numbers).tolist():
        if family in names:
            yield family, np.flatnonzero(numbers == family)


def _families(groups):
    """Names of groups by the number of a family; each is text of 80 characters, as numbers or bytes."""
    out = {}
    for family in groups.values():
        if "GRO" not in family:
            continue
        raw = np.ascontiguousarray(family["GRO/NOM"][()]).tobytes()
        texts = [raw[k : k + _NAME].split(b"\0")[0] for k in range(0, len(raw), _NAME)]
        out[int(family.attrs["NUM"])] = [_text(text) for text in texts]
    return out


def _text(raw):
    """Text of one byte a character or more, as old and new programs write it."""
    try:
        return raw.decode("utf-8").strip()
    except UnicodeDecodeError:
        return raw.decode("latin-1").strip()
