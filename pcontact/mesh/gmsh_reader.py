"""Reading of .msh files through gmsh's own library, whatever their version (1 to 4.1, text or binary)."""

import re
from contextlib import contextmanager

import numpy as np

from pcontact.mesh.groups import FileMesh, Table, default_name
from pcontact.runtime.errors import InputError

try:
    import gmsh
except (ImportError, OSError):  # not installed, or a system library that it needs is missing
    gmsh = None

# gmsh's element types, by meshio's names
_KINDS = {
    1: "line",
    2: "triangle",
    3: "quad",
    4: "tetra",
    5: "hexahedron",
    6: "wedge",
    7: "pyramid",
    8: "line3",
    9: "triangle6",
    10: "quad9",
    11: "tetra10",
    12: "hexahedron27",
    13: "wedge18",
    14: "pyramid14",
    15: "vertex",
    16: "quad8",
    17: "hexahedron20",
    18: "wedge15",
    19: "pyramid13",
}

_HEXAHEDRON_EDGES = [8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15]

# positions in gmsh's node order of VTK's nodes, where the two differ
_VTK_ORDER = {
    11: [0, 1, 2, 3, 4, 5, 6, 7, 9, 8],
    12: [*range(8), *_HEXAHEDRON_EDGES, 22, 23, 21, 24, 20, 25, 26],
    17: [*range(8), *_HEXAHEDRON_EDGES],
}


def available():
    """Whether gmsh's Python module can be used."""
    return gmsh is not None


def read_gmsh(path):
    """Read a .msh file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    FileMesh or None
        None when the file must be read element by element: version 2 gives every element its own group, which
        gmsh turns into groups of whole entities; where an entity has elements of several groups they would be
        mixed up.

    Raises
    ------
    InputError
        If gmsh cannot read the file.
    """
    major, listed, names = _header(path)
    with _model(path):
        points, tags, made_for_point = _nodes(path)
        if major < 4 and listed not in (None, len(tags)):
            # gmsh drops them, but it does not write such a file
            raise InputError(
                f"{path}: {_first_loose(path, listed, tags)} is in no element ({listed - len(tags)} in all); "
                "allowed: nodes of elements, remove the others"
            )
        tables, table_of = _tables(path, tags)
        file = FileMesh(points, tags, made_for_point, tables)
        groups = gmsh.model.getPhysicalGroups()
        entities = [gmsh.model.getEntitiesForPhysicalGroup(*group) for group in groups]
        if major < 4 and _shared(groups, entities):
            return None
        for (dim, tag), members in zip(groups, entities, strict=True):
            name = gmsh.model.getPhysicalName(dim, tag) or default_name(dim, tag)
            for entity in np.unique(np.abs(members)):
                for table in table_of.get((dim, int(entity)), []):
                    file.add(dim, name, table, np.arange(len(tables[table].tags)))
    file.declared = names
    for table in tables:
        # elements that belong to no group but were saved are construction, too
        file.free[table.nodes] = True
    return file


def _header(path):
    """Major version of the format, for version 2 the number of nodes that it announces, names of groups.

    What is no mesh is kept from gmsh, which would run it as a script.
    """
    with open(path, "rb") as stream:
        raw = stream.read(1 << 16)
    head = raw.decode("latin-1")
    mark = head.find("$MeshFormat")
    if head.lstrip()[:4] == "$NOD":
        return 1, None, []
    if head.lstrip()[:1] != "$" or mark < 0:
        raise InputError(f'{path}: not a gmsh mesh; allowed: a .msh file, it begins with "$MeshFormat"')
    number = head[mark:].split()[1:2]
    if not number or not number[0][:1].isdigit():
        raise InputError(f'{path}: no version number after "$MeshFormat"; allowed: version 1 to 4.1')
    nodes = head.find("$Nodes")
    count = head[nodes:].split()[1:2] if nodes >= 0 else []
    section = raw.decode("utf-8", "replace").partition("$PhysicalNames")[2].partition("$EndPhysicalNames")[0]
    names = [(int(dim), name) for dim, name in re.findall(r'^\s*([0-3])\s+\d+\s+"(.*)"', section, re.MULTILINE)]
    return int(number[0][0]), int(count[0]) if count and count[0].isdigit() else None, names


def _first_loose(path, listed, tags):
    """The first node of a version 2 file that is not among the tags (n,), in the words of a message."""
    data = path.read_bytes()
    binary = data.split(None, 3)[2] == b"1"
    start = data.index(b"\n", data.index(b"\n", data.index(b"$Nodes")) + 1) + 1
    try:
        if binary:
            table = np.frombuffer(data, [("tag", "<i4"), ("x", "<f8", 3)], listed, start)
            numbers, x = table["tag"], table["x"]
        else:
            table = np.array(data[start : data.index(b"$EndNodes")].split(), dtype=float).reshape(listed, 4)
            numbers, x = table[:, 0].astype(np.int64), table[:, 1:]
    except ValueError:
        return f"one of {listed} nodes"
    lost = np.flatnonzero(~np.isin(numbers, tags))
    if not len(lost):
        return "a number that two nodes have"
    return f"node {numbers[lost[0]]} at ({', '.join(f'{c:g}' for c in x[lost[0]])})"


def _cut_short(path):
    """Whether a file does not end with the end of a section."""
    lines = path.read_bytes()[-200:].split()
    return not lines or not lines[-1].startswith(b"$End")


@contextmanager
def _model(path):
    """The file as gmsh's current model; what the caller has open in gmsh is left as it was."""
    was_running = gmsh.isInitialized()
    if not was_running:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    terminal = gmsh.option.getNumber("General.Terminal")
    current = gmsh.model.getCurrent()
    before = len(gmsh.model.list())
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        try:
            gmsh.open(str(path))
        except Exception as error:  # gmsh knows no other class
            reason = "the file is cut short" if _cut_short(path) else " ".join(str(error).split())
            raise InputError(f"{path}: gmsh cannot read it: {reason}; allowed: a complete .msh file") from None
        yield
    finally:
        if not was_running:
            gmsh.finalize()
        else:
            if len(gmsh.model.list()) > before:
                gmsh.model.remove()
            if current in gmsh.model.list():
                gmsh.model.setCurrent(current)
            gmsh.option.setNumber("General.Terminal", terminal)


def _nodes(path):
    """Coordinates (n, 3), numbers (n,) ascending, and whether a node belongs to a geometric point (n,)."""
    tags, points, of_point = [], [], []
    for dim in range(4):
        numbers, coordinates, _ = gmsh.model.mesh.getNodes(dim)
        tags.append(numbers.astype(np.int64))
        points.append(coordinates.reshape(-1, 3))
        of_point.append(np.full(len(numbers), dim == 0))
    tags = np.concatenate(tags)
    if len(tags) == 0:
        raise InputError(f"{path}: the file holds no nodes; allowed: nodes and cells")
    tags, order = np.unique(tags, return_index=True)
    return np.concatenate(points)[order], tags, np.concatenate(of_point)[order]


def _lookup(tags):
    """A function that gives the rows of numbers (any shape) among tags (n,), ascending; -1 where there is none."""
    span = int(tags[-1]) + 2
    if span > 8 * len(tags) or tags[0] < 0:

        def search(numbers):
            rows = np.minimum(np.searchsorted(tags, numbers), len(tags) - 1)
            return np.where(tags[rows] == numbers, rows, -1)

        return search
    table = np.full(span, -1, dtype=np.int64)
    table[tags] = np.arange(len(tags))
    return lambda numbers: table[np.clip(numbers, 0, span - 1)]


def _tables(path, tags):
    """All elements, entity by entity, and the tables of every (dimension, entity)."""
    tables, table_of, rows_of = [], {}, _lookup(tags)
    for part, (dim, entity) in enumerate(gmsh.model.getEntities()):
        for kind, numbers, nodes in zip(*gmsh.model.mesh.getElements(dim, entity), strict=True):
            nodes = nodes.reshape(len(numbers), -1).astype(np.int64)
            if kind in _VTK_ORDER:
                nodes = nodes[:, _VTK_ORDER[kind]]
            rows = rows_of(nodes)
            if rows.min(initial=0) < 0:
                lost = rows < 0
                row = int(np.flatnonzero(lost.any(axis=1))[0])
                raise InputError(
                    f"{path}: element {numbers[row]} refers to node {nodes[lost][0]}; allowed: nodes of the file"
                )
            name = _KINDS.get(kind) or gmsh.model.mesh.getElementProperties(kind)[0]
            table_of.setdefault((dim, entity), []).append(len(tables))
            tables.append(Table(name, dim, rows, numbers.astype(np.int64), part))
    return tables, table_of


def _shared(groups, entities):
    """Whether an entity is in several groups of its dimension."""
    for dim in range(4):
        members = [np.abs(e) for group, e in zip(groups, entities, strict=True) if group[0] == dim]
        if members:
            every = np.concatenate(members)
            if len(np.unique(every)) < len(every):
                return True
    return False
