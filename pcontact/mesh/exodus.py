"""Reading of Exodus II files: blocks, node sets and side sets with their names.

The files are netCDF, today mostly in HDF5; those in netCDF's own format need the package netCDF4.
"""

import importlib

import h5py
import numpy as np

from pcontact.mesh.raw import FileMesh, Table, default_name, reading
from pcontact.runtime.errors import InputError

# kind (meshio's name) and dimension by the beginning of an Exodus type and the number of nodes
_KINDS = {
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
_ORDER = {"wedge15": [*range(9), 12, 13, 14, 9, 10, 11], "hexahedron20": _TO_VTK,
          "hexahedron27": [*_TO_VTK, 23, 24, 25, 26, 21, 22, 20]}  # fmt: skip

# vertices of the sides of a cell, in the order of their numbers
_EDGES = {3: [(0, 1), (1, 2), (2, 0)], 4: [(0, 1), (1, 2), (2, 3), (3, 0)]}
_SIDES = {
    "tetra": [(0, 1, 3), (1, 2, 3), (0, 3, 2), (0, 2, 1)],
    "wedge": [(0, 1, 4, 3), (1, 2, 5, 4), (0, 3, 5, 2), (0, 2, 1), (3, 4, 5)],
    "pyramid": [(0, 1, 4), (1, 2, 4), (2, 3, 4), (0, 4, 3), (0, 3, 2, 1)],
    "hexahedron": [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (0, 4, 7, 3), (0, 3, 2, 1), (4, 5, 6, 7)],
}
_FACETS = {1: "vertex", 2: "line", 3: "triangle", 4: "quad"}


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
    with reading(path, path.suffix):
        if classic:
            with module.Dataset(path) as file:
                file.set_auto_mask(False)
                types = {name: v.elem_type for name, v in file.variables.items() if name[:7] == "connect"}
                return _build(path, file.variables, types)
        with h5py.File(path, "r") as file:
            types = {k: v.attrs.get("elem_type", "") for k, v in file.items() if k[:7] == "connect"}
            return _build(path, file, types)


def _build(path, variables, types):
    """The mesh from the variables of a file, by name, and the types of its blocks."""
    points = _points(variables)
    file, starts = FileMesh.of(points), [0]
    for number in range(1, len(types) + 1):
        nodes = np.asarray(variables[f"connect{number}"][...], dtype=np.int64) - 1
        kind, dim = _kind(types[f"connect{number}"], nodes.shape[1])
        starts.append(starts[-1] + len(nodes))
        file.add_elements(path, kind, dim, nodes[:, _ORDER[kind]] if kind in _ORDER else nodes)
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
    known = _KINDS.get((text[:3], n_nodes))
    return known or (f"{text} with {n_nodes} nodes", _DIMENSIONS.get(text[:3], 2))


def _count(variables, prefix):
    """How many variables there are that are called so, with numbers from 1 on."""
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
            file.tables.append(Table(_FACETS[n], 1 if n == 2 else 2, nodes, block.tags[rows[local == side]]))
            file.add(file.tables[-1].dim, name, len(file.tables) - 1, np.arange(len(nodes)))
