"""Reading of .msh files of version 2.1 to 2.2 and 4.1, text or binary, without gmsh; others, and .unv, by its help.

Every number of a file is checked against what follows it before anything is done with it, so that a damaged file ends
in a message: gmsh's own library may leave a part out, or read beyond the end of its arrays.
"""

import importlib.util
import os
import re
import subprocess
import sys
import tempfile
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from pcontact.mesh.raw import NAMED, FileMesh, Table, default_name
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import SCRIPTS, replace_file
from pcontact.runtime.jit import njit

# gmsh's element types that the program knows, from 1, by meshio's names
_NAMES = (
    "line", "triangle", "quad", "tetra", "hexahedron", "wedge", "pyramid", "line3", "triangle6", "quad9", "tetra10",
    "hexahedron27", "wedge18", "pyramid14", "vertex", "quad8", "hexahedron20", "wedge15", "pyramid13",
)  # fmt: skip
_SIZES_OF = {"vertex": (0, 1), **{name: size for size, name in NAMED.items()}}
# names, dimensions, numbers of nodes
_KINDS = {number: (name, *_SIZES_OF[name]) for number, name in enumerate(_NAMES, 1)}
# those that it has heard of, so that they can be named: types of each family and their numbers of nodes
_OTHERS = {
    ("Line", 1): {26: 4, 27: 5, 28: 6, 62: 7, 63: 8, 64: 9, 65: 10, 66: 11},
    ("Triangle", 2): {20: 9, 21: 10, 22: 12, 23: 15, 24: 15, 25: 21, 42: 28, 43: 36, 44: 45, 45: 55, 46: 66},
    ("Quadrilateral", 2): {36: 16, 37: 25, 38: 36, 39: 12, 40: 16, 41: 20, 47: 49, 48: 64, 49: 81, 50: 100, 51: 121},
    ("Tetrahedron", 3): {29: 20, 30: 35, 31: 56, 32: 22, 33: 28, 71: 84, 72: 120, 73: 165, 74: 220, 75: 286, 137: 16},
    ("Hexahedron", 3): {92: 64, 93: 125, 94: 216, 95: 343, 96: 512, 97: 729, 98: 1000, 99: 32, 100: 44},
    ("Pyramid", 3): {118: 30, 119: 55, 120: 91, 121: 140, 122: 204, 123: 285, 124: 385, 125: 21, 126: 29},
}
_KINDS |= {
    kind: (f"{name} {n}", dim, n) for (name, dim), members in _OTHERS.items() for kind, n in members.items()
}
_SIZES = np.full(1 + max(_KINDS), -1, dtype=np.int64)
_SIZES[list(_KINDS)] = [n for _, _, n in _KINDS.values()]

_WEDGE_EDGES = [6, 9, 7, 12, 14, 13, 8, 10, 11]
_PYRAMID_EDGES = [5, 8, 10, 6, 7, 9, 11, 12]
_HEXAHEDRON_EDGES = [8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15]

# positions in gmsh's node order of VTK's nodes, where the two differ
VTK_ORDER = {
    11: [0, 1, 2, 3, 4, 5, 6, 7, 9, 8],
    12: [*range(8), *_HEXAHEDRON_EDGES, 22, 23, 21, 24, 20, 25, 26],
    13: [*range(6), *_WEDGE_EDGES, 15, 17, 16],
    14: [*range(5), *_PYRAMID_EDGES, 13],
    17: [*range(8), *_HEXAHEDRON_EDGES],
    18: [*range(6), *_WEDGE_EDGES],
    19: [*range(5), *_PYRAMID_EDGES],
}

_WHOLE = "allowed: a complete .msh file"
_BLANKS = re.compile(rb"\s*")
_HEAD = re.compile(rb"\$(\w+)[^\n]*\n")
_NAME = re.compile(r'^\s*([0-3])\s+(-?\d+)\s+"(.*)"\s*$', re.MULTILINE)
# sections without which another program has to help
_FOREIGN = ("PartitionedEntities", "ParametricNodes")
# A process of its own: gmsh may crash on a damaged file. An entity whose elements are of several groups, which versions
# before 4 may have, would get all groups for all elements.
_TRANSLATE = """
import sys
import gmsh
gmsh.initialize(readConfigFiles=False, interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
if gmsh.model.getNumberOfPartitions():
    gmsh.model.mesh.unpartition()
seen = set()
for dim, tag in gmsh.model.getPhysicalGroups():
    members = {(dim, abs(int(e))) for e in gmsh.model.getEntitiesForPhysicalGroup(dim, tag)}
    if sys.argv[3] == "old" and members & seen:
        raise SystemExit(f"elementary entity {min(members & seen)[1]} is in several physical groups")
    seen |= members
for name, value in (("Mesh.MshFileVersion", 4.1), ("Mesh.Binary", 1), ("Mesh.SaveAll", 1)):
    gmsh.option.setNumber(name, value)
gmsh.write(sys.argv[2])
"""
# datasets of groups that gmsh does not know, of which the newest has the same lines
_GROUPS = re.compile(rb"(?m)^( *-1 *\r?\n) *(?:2435|2452|2467) *(\r?)$")
# what a program started by mpirun must not take itself for
_LAUNCHER = ("PMIX_", "PMI_", "PRTE_", "OMPI_", "OPAL_", "MPI_", "HYDRA_")
# longest time [s] that gmsh may take to translate a file
_PATIENCE = 1800.0


def read_msh(path, source=None):
    """Read a .msh file.

    Parameters
    ----------
    path : Path
        For messages.
    source : Path, optional
        What is read in its place.

    Returns
    -------
    FileMesh or None
        None: a version, or sections, that gmsh has to translate.

    Raises
    ------
    InputError
        The file is no mesh, or is damaged.
    """
    data = (source or path).read_bytes()
    if data.lstrip()[:4] == b"$NOD":
        return None
    if data.lstrip()[:1] != b"$" or data.find(b"$MeshFormat", 0, 1 << 16) < 0:
        raise InputError(f'{path}: not a gmsh mesh; allowed: a .msh file, it begins with "$MeshFormat"')
    version, binary, order = _format(path, data)
    if version is None:
        return None
    sections = _sections(path, data)
    if any(name in sections for name in _FOREIGN):
        return None
    names = _names(path, data, sections)

    def cursor(name, text=np.float64):
        return _Cursor(path, name, data, sections.get(name, (0, 0)), order if binary else None, text)

    if "Nodes" not in sections:
        raise InputError(f"{path}: the file holds no nodes; allowed: nodes and cells")
    if version == 2:
        points, tags, of_point = *_old_nodes(cursor("Nodes")), None
    else:
        points, tags, of_point = _nodes(cursor("Nodes"))
    if not len(tags):
        raise InputError(f"{path}: the file holds no nodes; allowed: nodes and cells")
    points, tags, of_point = _once(path, points, tags, of_point)
    parts = []
    if "Elements" in sections:
        parts = (_old_elements if version == 2 else _elements)(cursor("Elements", np.int64))
    file = FileMesh(points, tags, of_point, [], repeats=version == 2)
    groups = {} if version == 2 or "Entities" not in sections else _entities(cursor("Entities"))
    _fill(path, file, parts, groups, names)
    return file


def _format(path, data):
    """Version (2 or 4; None: another one), whether the file is binary, and its byte order."""
    start = data.index(b"$MeshFormat")
    line = data[start:].partition(b"\n")[2].partition(b"\n")
    words = line[0].split()
    try:
        version, binary, size = words[0].decode(), int(words[1]), int(words[2])
        if not version[:1].isdigit() or binary not in (0, 1):
            raise ValueError
    except (IndexError, ValueError):
        what = " ".join(word.decode("latin-1") for word in words[:3]) or "nothing"
        raise InputError(
            f'{path}: found {what!r} after "$MeshFormat": no version number, or not followed by 0 or 1 and the size of '
            "a number; allowed: version 1 to 4.1"
        ) from None
    if version not in ("2", "2.1", "2.2", "4.1") or size != 8:
        return None, None, None
    if not binary:
        return int(version[0]), False, None
    for order in "<>":
        if line[2][:4] == np.array([1], order + "i4").tobytes():
            return int(version[0]), True, order
    raise InputError(f'{path}: found no 1 as a mark of the byte order after "$MeshFormat"; {_WHOLE}')


def _sections(path, data):
    """Return begin and end of the contents of each section, by name."""
    spans, at = {}, 0
    while (at := _BLANKS.match(data, at).end()) < len(data):
        head = _HEAD.match(data, at)
        if head is None:
            text = " ".join(data[at : at + 24].decode("latin-1").split())
            found = f"{text!r} where a section begins: the file is cut short or damaged"
            raise InputError(f"{path}: found {found}; {_WHOLE}")
        name = head[1].decode("latin-1")
        end = data.find(b"$End" + head[1], head.end())
        if end < 0:
            raise InputError(f"{path}: found no $End{name}: the file is cut short; {_WHOLE}")
        if name in spans and name in ("Nodes", "Elements", "Entities", "PhysicalNames"):
            raise InputError(f"{path}: ${name}: found a second time; allowed: once")
        spans[name] = head.end(), end
        at = end + 4 + len(name)
    return spans


def _names(path, data, sections):
    """Names of groups, by (dimension, number)."""
    first, last = sections.get("PhysicalNames", (0, 0))
    text = data[first:last].decode("utf-8", "replace")
    names = {(int(dim), int(tag)): name for dim, tag, name in _NAME.findall(text)}
    listed = text.split(None, 1)[:1]
    if listed and listed[0] != str(len(names)):
        raise InputError(
            f"{path}: $PhysicalNames: found {len(names)} names where {listed[0]} are announced; {_WHOLE}"
        )
    return names


class _Cursor:
    """The numbers of a section, one after the other.

    Parameters
    ----------
    path : Path
    name : str
        Of the section.
    data : bytes
        All of the file.
    span : (int, int)
        Of the section in the file.
    order : str or None
        Byte order; None: the file is text.
    text : dtype
        Of the numbers of a text.
    """

    def __init__(self, path, name, data, span, order, text):
        self.path, self.name, self.order = path, name, order
        self._data, (self._at, self._last) = data, span
        self._numbers = None
        if order is None:
            self._numbers, self._at = self._parsed(data[slice(*span)], text), 0
            self._last = len(self._numbers)

    def _parsed(self, text, dtype):
        with warnings.catch_warnings():
            # what older versions of numpy only warn of
            warnings.simplefilter("error")
            try:
                return np.fromstring(text, dtype, sep=" ")
            except (DeprecationWarning, ValueError):
                kind = "a number" if dtype == np.float64 else "a whole number"
                raise self.wrong(f"found what is not {kind}") from None

    def wrong(self, what):
        """An InputError about this section."""
        return InputError(f"{self.path}: ${self.name}: {what}; {_WHOLE}")

    def _room(self, width):
        if self._at + width > self._last:
            raise self.wrong("found fewer numbers than are announced: a count is wrong, or the file is cut short")

    def __call__(self, count, kind):
        """The next numbers: ``i4``, ``u8`` (whole ones, as int64) or ``f8``."""
        width = np.dtype(kind).itemsize if self._numbers is None else 1
        self._room(count * width)
        start, self._at = self._at, self._at + count * width
        if self._numbers is None:
            out = np.frombuffer(self._data, self.order + kind, count, start)
        else:
            out = self._numbers[start : start + count]
            if kind != "f8" and out.dtype == np.float64 and not np.all((np.abs(out) < 2.0**53) & (out == np.rint(out))):
                raise self.wrong("found what is not a whole number where one is expected")
        return out.astype(np.float64 if kind == "f8" else np.int64)

    def count(self, n=1):
        """The next n whole numbers as a list of int, which have to be counts."""
        out = self(n, "u8").tolist()
        if min(out) < 0:
            raise self.wrong(f"found a count of {min(out)}")
        return out

    def line(self):
        """The count in text with which a section of version 2 begins."""
        if self._numbers is not None:
            return self.count()[0]
        end = self._data.find(b"\n", self._at, self._last)
        word = self._data[self._at : end].strip() if 0 <= end < self._at + 40 else b""
        if not word.isdigit():
            raise self.wrong("found no count in its first line")
        self._at = end + 1
        return int(word)

    def rest(self):
        """All further numbers, of version 2: of a text, or 32 bits each."""
        left = self._last - self._at
        if self._numbers is not None:
            return self(left, "u8")
        return self(left // 4, "i4")

    def records(self, count):
        """Numbers (n,) and coordinates (n, 3) of nodes of version 2."""
        if self._numbers is not None:
            table = self(4 * count, "f8").reshape(count, 4)
            if not np.all((np.abs(table[:, 0]) < 2.0**53) & (table[:, 0] == np.rint(table[:, 0]))):
                raise self.wrong("found a number of a node that is not a whole number")
            return table[:, 0].astype(np.int64), table[:, 1:]
        self._room(28 * count)
        table = np.frombuffer(
            self._data, [("tag", self.order + "i4"), ("x", self.order + "f8", 3)], count, self._at
        )
        self._at += 28 * count
        return table["tag"].astype(np.int64), table["x"].astype(np.float64)

    def end(self):
        """Nothing may be left."""
        left = self._last > self._at
        if self._numbers is None:
            left = bool(self._data[self._at : self._last].strip())
        if left:
            raise self.wrong("found more numbers than are announced: a count is wrong")


def _old_nodes(cursor):
    """Coordinates (n, 3) and numbers (n,) of the nodes of version 2."""
    tags, points = cursor.records(cursor.line())
    cursor.end()
    return points, tags


@njit
def _walk(numbers, sizes, binary, kinds, tags, places):
    """Elements of version 2: type, number of tags, place of their own number; returns how many were found.

    After it stand the tags and the nodes; in a text, type and number of tags first. An element that does not fit ends
    the walk: -1 - k.
    """
    at, k = 0, 0
    while k < kinds.shape[0]:
        if at + 3 > numbers.shape[0]:
            return -1 - k
        together = 1
        if binary:
            kind, together, n_tags = numbers[at], numbers[at + 1], numbers[at + 2]
            at += 3
        else:
            kind, n_tags = numbers[at + 1], numbers[at + 2]
        if kind < 0 or kind >= sizes.shape[0] or sizes[kind] < 0 or together < 1:
            return -1 - k
        # wrong numbers may be too large to be added
        if n_tags < 0 or n_tags > numbers.shape[0] or together > kinds.shape[0] - k:
            return -1 - k
        step = 1 + n_tags + sizes[kind] + (0 if binary else 2)
        if step > numbers.shape[0] or at + together * step > numbers.shape[0]:
            return -1 - k
        for _ in range(together):
            kinds[k], tags[k], places[k] = kind, n_tags, at
            at += step
            k += 1
    return k if at == numbers.shape[0] else -1 - k


def _old_elements(cursor):
    """Elements of version 2: a list of (dimension, entity, type, numbers, nodes, groups (n,) or None)."""
    count, numbers = cursor.line(), cursor.rest()
    # the shortest element has five numbers in a text, three in a binary file
    if count > len(numbers):
        raise cursor.wrong(f"found fewer elements than the {count} that are announced")
    kinds, n_tags, places = np.empty((3, count), dtype=np.int64)
    binary = cursor.order is not None
    walked = _walk(numbers, _SIZES, binary, kinds, n_tags, places)
    if walked < 0:
        raise cursor.wrong(_misfit(numbers, binary, -1 - walked, kinds, n_tags, places))
    # the tags begin after the element's number and, in a text, after its type and number of tags
    first = places + (1 if binary else 3)
    padded = np.append(numbers, 0)
    group = np.where(n_tags > 0, np.abs(padded[first]), 0)
    entity = np.where(n_tags > 1, np.abs(padded[np.minimum(first + 1, len(numbers))]), 0)
    parts = []
    order = np.lexsort((entity, kinds))
    cuts = np.flatnonzero((np.diff(kinds[order]) != 0) | (np.diff(entity[order]) != 0)) + 1
    for rows in np.split(order, cuts) if count else ():
        kind = int(kinds[rows[0]])
        _, dim, n_nodes = _KINDS[kind]
        nodes = numbers[(first + n_tags)[rows][:, None] + np.arange(n_nodes)]
        parts.append((dim, int(entity[rows[0]]), kind, numbers[places[rows]], nodes, group[rows]))
    return parts


def _misfit(numbers, binary, k, kinds, n_tags, places):
    """Return why element k of version 2 cannot be read, or that too much is left behind the last one."""
    if k == len(kinds):
        return f"found more than the {k} elements that are announced"
    at = 0
    if k:
        at = places[k - 1] + 1 + n_tags[k - 1] + _SIZES[kinds[k - 1]] + (0 if binary else 2)
    if at + 3 > len(numbers):
        return f"found {k} elements where {len(kinds)} are announced: a count is wrong, or the file is cut short"
    kind = numbers[at] if binary else numbers[at + 1]
    if kind not in _KINDS:
        return f"found {kind} as the type of the element in place {k + 1}, which is none of gmsh's that can be read"
    return f"found an element in place {k + 1} that does not fit: its numbers of tags or nodes are wrong"


def _nodes(cursor):
    """Coordinates (n, 3), numbers (n,) and whether they belong to a geometric point (n,), of version 4.1."""
    n_blocks, total, _, _ = cursor.count(4)
    parts = [(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool))]
    for _ in range(n_blocks):
        dim, _, parametric = cursor(3, "i4").tolist()
        (n,) = cursor.count()
        if not 0 <= dim <= 3 or parametric not in (0, 1):
            raise cursor.wrong(f"found a block of nodes of dimension {dim}, parametric {parametric}")
        tags = cursor(n, "u8")
        width = 3 + (dim if parametric else 0)
        parts.append((cursor(n * width, "f8").reshape(n, width)[:, :3], tags, np.full(n, dim == 0)))
    points, tags, of_point = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    if len(tags) != total:
        raise cursor.wrong(f"found {len(tags)} nodes where {total} are announced")
    cursor.end()
    return points, tags, of_point


def _elements(cursor):
    """Elements of version 4.1, as `_old_elements` gives them."""
    n_blocks, total, _, _ = cursor.count(4)
    parts = []
    for _ in range(n_blocks):
        dim, entity, kind = cursor(3, "i4").tolist()
        (n,) = cursor.count()
        if kind not in _KINDS or _KINDS[kind][1] != dim:
            what = f"found elements of type {kind} and dimension {dim}"
            raise cursor.wrong(f"{what}, which is none of gmsh's that can be read")
        width = 1 + _KINDS[kind][2]
        rows = cursor(n * width, "u8").reshape(n, width)
        parts.append((dim, entity, kind, rows[:, 0], rows[:, 1:], None))
    found = sum(len(part[3]) for part in parts)
    if found != total:
        raise cursor.wrong(f"found {found} elements where {total} are announced")
    cursor.end()
    return parts


def _entities(cursor):
    """Groups of each entity of version 4.1: dict of (dimension, entity) to list of numbers."""
    groups = {}
    for dim, n in enumerate(cursor.count(4)):
        for _ in range(n):
            (entity,) = cursor(1, "i4").tolist()
            cursor(3 if dim == 0 else 6, "f8")
            members = cursor(cursor.count()[0], "i4")
            groups[dim, entity] = np.unique(np.abs(members)).tolist()
            if dim:
                cursor(cursor.count()[0], "i4")
    cursor.end()
    return groups


def _once(path, points, tags, of_point):
    """Nodes in the order of their numbers, of which each is there once."""
    ordered, first = np.unique(tags, return_index=True)
    if len(ordered) < len(tags):
        again = np.delete(np.arange(len(tags)), first)[0]
        raise InputError(
            f"{path}: node {tags[again]} is there more than once, a number that two nodes have "
            f"({len(tags) - len(ordered)} in all); allowed: each number once"
        )
    of_point = np.zeros(len(tags), dtype=bool) if of_point is None else of_point[first]
    return np.ascontiguousarray(points[first]), ordered, of_point


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
    return lambda numbers: table[np.clip(numbers, -1, span - 1)]


def _fill(path, file, parts, groups, names):
    """Put elements and groups into a FileMesh: parts as of `_elements`, groups of entities, names of groups."""
    rows_of, members = _lookup(file.tags), {}
    parts = sorted(parts, key=lambda part: part[:3])
    for number, (dim, entity, kind, tags, nodes, own) in enumerate(parts):
        rows = rows_of(nodes)
        lost = rows < 0
        if lost.any():
            row = int(np.flatnonzero(lost.any(axis=1))[0])
            raise InputError(
                f"{path}: element {tags[row]} refers to node {nodes[lost][0]} ({lost.sum()} such in all); "
                "allowed: nodes of the file"
            )
        if kind in VTK_ORDER:
            rows = rows[:, VTK_ORDER[kind]]
        file.tables.append(Table(_KINDS[kind][0], dim, np.ascontiguousarray(rows), tags))
        # elements that belong to no group but were saved are construction
        file.free[rows] = True
        if own is None:
            for group in groups.get((dim, entity), []):
                members.setdefault((dim, group), []).append((number, np.arange(len(tags))))
        else:
            for group in np.unique(own[own > 0]).tolist():
                members.setdefault((dim, group), []).append((number, np.flatnonzero(own == group)))
    for dim, group in sorted(members):
        name = names.get((dim, group)) or default_name(dim, group)
        for number, rows in members[dim, group]:
            file.add(dim, name, number, rows)
    file.declared = [(dim, name) for (dim, _), name in names.items()]


def available():
    """Return whether gmsh's Python module is installed."""
    return importlib.util.find_spec("gmsh") is not None


def read_gmsh(path):
    """Read a .msh file of any version.

    Parameters
    ----------
    path : Path

    Returns
    -------
    FileMesh

    Raises
    ------
    InputError
        The file is damaged, or gmsh is needed and not installed.
    """
    file = read_msh(path)
    if file is not None:
        return file
    if not available():
        words = path.read_bytes()[:1000].split()
        version = words[1].decode("latin-1") if words[0] == b"$MeshFormat" else "1"
        raise InputError(
            f"{path}: found version {version} of the format, or parts of a partition, without the Python package gmsh; "
            "allowed: version 2.1 to 2.2 and 4.1, or that package installed"
        )
    data = path.read_bytes()
    # gmsh takes a file for a script whose first line it does not know
    return _translated(path, data[max(data.find(b"$MeshFormat"), 0) :].lstrip())


def read_unv(path):
    """Read a universal file (I-DEAS, Salome), which gmsh translates; its groups are groups.

    Parameters
    ----------
    path : Path

    Returns
    -------
    FileMesh

    Raises
    ------
    InputError
        The file is damaged, or gmsh is not installed.
    """
    if not available():
        allowed = "another file type, or that package installed"
        raise InputError(f'{path}: needs the Python package "gmsh"; allowed: {allowed}')
    return _translated(path, _GROUPS.sub(rb"\g<1>  2477\2", path.read_bytes()))


@contextmanager
def apart(path, data=None):
    """A file as gmsh may open it, so that nothing runs: alone in a folder, for gmsh runs what has the same name and
    `.opt` behind it, and with an ending in small letters, for gmsh runs what it does not know by its ending.

    Parameters
    ----------
    path : Path
        A script of gmsh stays where it is: it is run anyway, and may speak of files beside it.
    data : bytes, optional
        What is in the file; absent: what is in that of `path`.

    Yields
    ------
    Path
    """
    if path.suffix.lower() in SCRIPTS:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"file{path.suffix.lower()}"
        if data is None:
            file.symlink_to(path.absolute())
        else:
            file.write_bytes(data)
        yield file


def _translated(path, data):
    """Return what gmsh reads out of the contents of a file."""
    words = data[:1000].split()
    old = "new" if words[:1] == [b"$MeshFormat"] and words[1:2] and words[1][:1] == b"4" else "old"
    with apart(path, data) as file:
        target = file.with_name("translated.msh")
        _convert(path, file, target, old)
        return read_msh(path, target)


def _convert(path, file, target, old):
    """Have gmsh write a file as one of version 4.1; messages have the name of the `path` that it is a copy of."""
    keep = {name: value for name, value in os.environ.items() if not name.startswith(_LAUNCHER)}
    # -P: no module of the working directory, which may be that of somebody's scene
    command = [sys.executable, "-P", "-c", _TRANSLATE, str(file), str(target), old]
    try:
        done = subprocess.run(
            command, env=keep, capture_output=True, text=True, errors="replace", timeout=_PATIENCE,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        reason = (done.stderr.strip().splitlines() or [""])[-1] if done.returncode else ""
        if done.returncode < 0:
            reason = f"it ends with signal {-done.returncode}"
        if done.returncode == 0 and target.is_file():
            return
    except (OSError, subprocess.TimeoutExpired) as error:
        reason = str(error)
    words = f"gmsh cannot read it: {reason or 'no reason given'}; allowed: a complete {path.suffix} file"
    raise InputError(f"{path}: {words}")


def write_msh(path, nodes, elements, names=()):
    """Write a mesh file of gmsh's version 2.2, in which an element stands once for each of its groups. Serial.

    Parameters
    ----------
    path : pathlib.Path
    nodes : iterable of (int, sequence of float)
        Numbers and places, two or three coordinates [length].
    elements : iterable of (int, str, int, sequence of int)
        Number, kind (meshio's name), number of the group (0: of none), and the nodes in the order of VTK.
    names : iterable of (int, int, str)
        Of the groups: dimension, number, name.

    Raises
    ------
    InputError
        gmsh has no elements of a kind.
    """
    kinds = {name: (kind, np.argsort(VTK_ORDER.get(kind, range(n)))) for kind, (name, _, n) in _KINDS.items()}
    named = [f'{dim} {number} "{name}"' for dim, number, name in names]
    text = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    text += ["$PhysicalNames", str(len(named)), *named, "$EndPhysicalNames"] if named else []
    rows = [f"{number} {' '.join(repr(float(x)) for x in (*place, 0.0)[:3])}" for number, place in nodes]
    text += ["$Nodes", str(len(rows)), *rows, "$EndNodes"]
    rows = []
    for number, name, group, members in elements:
        if name not in kinds:
            raise InputError(f"{path}: found elements of type {name!r}; allowed: {', '.join(kinds)}")
        kind, order = kinds[name]
        rows.append(f"{number} {kind} 2 {group} {group} {' '.join(str(members[k]) for k in order)}")
    replace_file(path, "\n".join([*text, "$Elements", str(len(rows)), *rows, "$EndElements", ""]))


def write_file(path, file):
    """Write what a mesh file of any format holds, with numbers from 1 on. Serial.

    Parameters
    ----------
    path : pathlib.Path
    file : pcontact.mesh.raw.FileMesh
    """
    numbers, rows, free = {}, [], [np.ones(len(table.nodes), dtype=bool) for table in file.tables]
    for key, parts in file.groups.items():
        number = numbers.setdefault(key, len(numbers) + 1)
        for k, own in parts:
            free[k][own] = False
            rows += [(file.tables[k].kind, number, nodes) for nodes in (file.tables[k].nodes[own] + 1).tolist()]
    for name, members in file.point_groups.items():
        number = numbers.setdefault((0, name), len(numbers) + 1)
        rows += [("vertex", number, [node]) for node in (members + 1).tolist()]
    for table, own in zip(file.tables, free, strict=True):
        rows += [(table.kind, 0, nodes) for nodes in (table.nodes[own] + 1).tolist()]
    write_msh(path, enumerate(file.points.tolist(), 1), ((k, *row) for k, row in enumerate(rows, 1)),
              [(dim, number, name) for (dim, name), number in numbers.items()])  # fmt: skip
