"""One rank's piece as a VTK XML file, and the small files that name the pieces.

Each array stands in its tag, compressed with zlib in one block, in base64. That takes a third more bytes than raw data
behind the XML, which older versions of this program wrote and which are still read. But of raw data meshio (5.3.5)
looks arrays up by offsets that it changes meanwhile: of some sizes it finds the wrong one, and where Python's base64
does not stop at padding always. Format: the "VTK XML formats" chapter of the VTK User's Guide.
"""

import base64
import json
import re
import sys
import zlib
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np

from pcontact.runtime.files import append_text, replace_file

CELL_TYPES = {
    "vertex": (1, 1), "line": (3, 2), "triangle": (5, 3), "quad": (9, 4), "tetra": (10, 4),
    "hexahedron": (12, 8),
    "line3": (21, 3), "triangle6": (22, 6), "quad8": (23, 8), "tetra10": (24, 10), "hexahedron20": (25, 20),
    "quad9": (28, 9), "hexahedron27": (29, 27),
    "wedge": (13, 6), "pyramid": (14, 5), "wedge15": (26, 15), "pyramid13": (27, 13), "wedge18": (32, 18),
}  # fmt: skip
# VTK has no pyramid with a node in the middle of its base
STORED = {"pyramid14": "pyramid13"}
# numbers of cells of dimension 3
SOLID = (10, 12, 13, 14, 24, 25, 26, 27, 29, 32)
CELL_NAMES = {number: (name, n_nodes) for name, (number, n_nodes) in CELL_TYPES.items()}
_TYPES = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "i4": "Int32", "i1": "Int8", "u1": "UInt8"}
DTYPES = {name: np.dtype(code) for code, name in _TYPES.items()}
_ORDER = {"little": "LittleEndian", "big": "BigEndian"}[sys.byteorder]
_HEAD = f'version="1.0" byte_order="{_ORDER}" header_type="UInt64" compressor="vtkZLibDataCompressor"'
# of a collection
# [bytes] of the header of an array, and [characters] in base64
_HEADER, _HEADER_TEXT = 32, 44
_SYMMETRIC = ("XX", "YY", "ZZ", "XY", "YZ", "XZ")


@dataclass
class Grid:
    """An unstructured grid in VTK's own arrays.

    Parameters
    ----------
    points : ndarray (n, 3)
        Coordinates [length].
    connectivity, offsets, types : ndarray of int64, int64, uint8
        Nodes of all cells one after the other, the end of each cell in it, the VTK type of each cell.
    point_data, cell_data : dict of str to ndarray (n,) or (n, k)
        Arrays of points and of cells.
    """

    points: np.ndarray
    connectivity: np.ndarray
    offsets: np.ndarray
    types: np.ndarray
    point_data: dict
    cell_data: dict


def no_cells():
    """A grid without points and cells."""
    none = np.zeros(0, np.int64)
    return Grid(np.zeros((0, 3)), none, none, none.astype(np.uint8), {}, {})


def storable(array):
    """The array in a type that VTK's files know, contiguous, in this machine's byte order.

    Parameters
    ----------
    array : array_like
        Numbers or truth values.

    Returns
    -------
    ndarray
        Floats of 4 or 8 bytes, signed integers of 1, 4 or 8 bytes, or bytes.
    """
    array = np.asarray(array)
    code = f"{array.dtype.kind}{array.dtype.itemsize}"
    if array.dtype.kind == "b":
        code = "u1"
    elif code not in _TYPES:
        if array.dtype.kind not in "iuf":
            raise ValueError(f"an array of type {array.dtype} cannot be written, only numbers can")
        code = "f8" if array.dtype.kind == "f" else "i8"
    return np.ascontiguousarray(array, dtype=code)


def signature(array):
    """VTK's name of the type and the number of components.

    Parameters
    ----------
    array : ndarray (n,) or (n, k)
        As `storable` returns it.

    Returns
    -------
    tuple of (str, int)
    """
    return _TYPES[f"{array.dtype.kind}{array.dtype.itemsize}"], 1 if array.ndim == 1 else array.shape[1]


def empty(kind, components):
    """An array of no rows with the given `signature`.

    Parameters
    ----------
    kind : str
        VTK's name of the type.
    components : int
        Columns; 1 gives a one-dimensional array.

    Returns
    -------
    ndarray (0,) or (0, components)
    """
    return np.zeros(0 if components == 1 else (0, components), dtype=DTYPES[kind])


def _array_tag(tag, name, kind, components, rest="/>"):
    """The tag that declares an array, with what follows; symmetric tensors get the names of their components."""
    text = f'<{tag} type={quoteattr(kind)} Name={quoteattr(name)} NumberOfComponents="{components}"'
    if components == len(_SYMMETRIC):
        text += "".join(f' ComponentName{i}="{part}"' for i, part in enumerate(_SYMMETRIC))
    return f"{text}{rest}\n"


def _written(array):
    """An array in its tag: VTK's header (blocks, size, that of a partial last one, compressed sizes) and the block."""
    if array.nbytes == 0:
        # meshio cannot read binary data of no blocks
        return ' format="ascii">\n</DataArray>'
    # level 1: the digits of floating point numbers hardly compress better at a multiple of the time
    block = zlib.compress(array.tobytes(), 1)
    head = np.array([1, array.nbytes, 0, len(block)], np.uint64).tobytes()
    data = (base64.b64encode(head) + base64.b64encode(block)).decode("ascii")
    return f' format="binary">\n{data}\n</DataArray>'


def write_vtu(path, grid):
    """Write one piece.

    Parameters
    ----------
    path : Path
        The .vtu file.
    grid : Grid
        Its arrays, all as `storable` returns them.
    """
    def section(tag, arrays):
        yield f"<{tag}>\n"
        for name, array in arrays.items():
            yield _array_tag("DataArray", name, *signature(array), rest=_written(array))
        yield f"</{tag}>\n"

    cells = {"connectivity": grid.connectivity, "offsets": grid.offsets, "types": grid.types}
    head = (
        f'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" {_HEAD}>\n<UnstructuredGrid>\n'
        f'<Piece NumberOfPoints="{len(grid.points)}" NumberOfCells="{len(grid.types)}">\n'
    )
    replace_file(path, chain(
        [head], section("PointData", grid.point_data), section("CellData", grid.cell_data),
        section("Points", {"Points": grid.points}), section("Cells", cells),
        ["</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"],
    ))  # fmt: skip


def write_pvtu(path, point_arrays, cell_arrays, pieces):
    """Write the file that names the pieces of one part at one time.

    Parameters
    ----------
    path : Path
        The .pvtu file.
    point_arrays, cell_arrays : dict of str to (str, int)
        `signature` of every array, which each piece holds.
    pieces : list of str
        File names of the pieces, beside this file.
    """

    def section(tag, arrays):
        lines = "".join(_array_tag("PDataArray", name, *arrays[name]) for name in arrays)
        return f"<{tag}>\n{lines}</{tag}>\n"

    replace_file(
        path,
        f'<?xml version="1.0"?>\n<VTKFile type="PUnstructuredGrid" {_HEAD}>\n'
        + '<PUnstructuredGrid GhostLevel="0">\n'
        + section("PPointData", point_arrays)
        + section("PCellData", cell_arrays)
        + section("PPoints", {"Points": ("Float64", 3)})
        + "".join(f"<Piece Source={quoteattr(piece)}/>\n" for piece in pieces)
        + "</PUnstructuredGrid>\n</VTKFile>\n",
    )


def _data_set(entry):
    return "<DataSet " + " ".join(f"{key}={quoteattr(str(value))}" for key, value in entry.items()) + "/>\n"


def _file_of_series(entry):
    return json.dumps({"name": entry["file"], "time": float(entry["timestep"])})


# by the end of its name, of an index: what it begins with, what stands between two entries, an entry, the end
_INDICES = {
    ".pvd": (f'<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="{_ORDER}">\n<Collection>\n',
             "", _data_set, "</Collection>\n</VTKFile>\n"),
    ".series": ('{"file-series-version": "1.0", "files": [\n', ",\n", _file_of_series, "\n]}\n"),
}  # fmt: skip


def write_index(path, entries):
    """Write the index of all times.

    Parameters
    ----------
    path : Path
        A collection ``.pvd``, or a ``.series`` of files.
    entries : list of dict
        Of each part of a time, or of each time: timestep, file (relative to the index); of a collection also group,
        part, name.
    """
    head, between, row, tail = _INDICES[path.suffix]
    replace_file(path, head + between.join(map(row, entries)) + tail)


def add_to_index(path, entries, more):
    """Add to an index that :func:`write_index` has written, with `more` to entries that are there: what that costs does
    not grow with the run.

    Raises
    ------
    OutputError
        The index is as it was.
    """
    _, between, row, tail = _INDICES[path.suffix]
    append_text(path, between * bool(more) + between.join(map(row, entries)), tail)


def read_index(path):
    """Entries of an index, as `write_index` takes them.

    Raises
    ------
    OSError, ValueError, LookupError, TypeError, SyntaxError
        It is no index.
    """
    if path.suffix == ".pvd":
        return [dict(tag.attrib) for tag in ElementTree.parse(path).getroot().iter("DataSet")]
    files = json.loads(path.read_text(encoding="utf-8"))["files"]
    return [{"timestep": one["time"], "file": one["name"]} for one in files]


def read_pvtu(path):
    """The pieces that a .pvtu names.

    Parameters
    ----------
    path : Path
        The .pvtu file.

    Returns
    -------
    list of Path
    """
    return [
        Path(path).parent / tag.attrib["Source"] for tag in ElementTree.parse(path).getroot().iter("Piece")
    ]


def read_vtu(path):
    """Read a piece that `write_vtu` wrote (other programs' forms of the file are not understood).

    Parameters
    ----------
    path : Path
        The .vtu file.

    Returns
    -------
    Grid
    """
    content, appended = Path(path).read_bytes(), b""
    mark = re.search(rb'<AppendedData encoding="raw">\s*_', content)
    if mark is not None:
        content, appended = content[: mark.start()] + b"</VTKFile>", memoryview(content)[mark.end() :]
    root = ElementTree.fromstring(content)
    sections = {
        tag.tag: {one.attrib["Name"]: _read_array(one, appended) for one in tag.iter("DataArray")}
        for tag in root.iter()
        if tag.tag in ("PointData", "CellData", "Points", "Cells")
    }
    cells = sections["Cells"]
    return Grid(
        sections["Points"]["Points"], cells["connectivity"], cells["offsets"], cells["types"],
        sections["PointData"], sections["CellData"],
    )  # fmt: skip


def _read_array(tag, appended):
    """The array of a tag: it stands there, or in the appended data of older versions."""
    kind, components = tag.attrib["type"], int(tag.attrib["NumberOfComponents"])
    if tag.attrib["format"] == "appended":
        data = appended[int(tag.attrib["offset"]) :]
        blocks, block = int(np.frombuffer(data, np.uint64, 1)[0]), data[_HEADER:]
    else:
        text = (tag.text or "").strip()
        # the header and the block are padded each for itself
        blocks, data = len(text), base64.b64decode(text[:_HEADER_TEXT])
        block = base64.b64decode(text[_HEADER_TEXT:])
    if blocks == 0:
        return empty(kind, components)
    length = int(np.frombuffer(data, np.uint64, 4)[3])
    array = np.frombuffer(zlib.decompress(block[:length]), DTYPES[kind])
    return array if components == 1 else array.reshape(-1, components)
