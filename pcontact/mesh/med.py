"""Reading of MED files (Salome, code_aster, gmsh), version 2 to 4: cells, nodes and the groups of their families."""

import h5py
import numpy as np

from pcontact.mesh.raw import FileMesh, reading
from pcontact.runtime.errors import InputError

# kind (meshio's name), dimension and number of nodes by MED's name
_KINDS = {
    "PO1": ("vertex", 0), "SE2": ("line", 1), "SE3": ("line3", 1), "TR3": ("triangle", 2), "TR6": ("triangle6", 2),
    "QU4": ("quad", 2), "QU8": ("quad8", 2), "QU9": ("quad9", 2), "TE4": ("tetra", 3), "T10": ("tetra10", 3),
    "HE8": ("hexahedron", 3), "H20": ("hexahedron20", 3), "H27": ("hexahedron27", 3), "PE6": ("wedge", 3),
    "P15": ("wedge15", 3), "P18": ("wedge18", 3), "PY5": ("pyramid", 3), "P13": ("pyramid13", 3),
}  # fmt: skip
# positions in MED's node order of VTK's nodes, where the two differ (but for the sense, which is turned later)
_ORDER = {"hexahedron27": [*range(20), 24, 22, 21, 23, 20, 25, 26]}
# dimensions of others, unless 3
_OTHERS = {"SE4": 1, "TR7": 2, "POG": 2, "POG2": 2}
# characters of the name of a group
_NAME = 80


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
    with reading(path, ".med"), h5py.File(path, "r") as file:
        return _build(path, file)


def _build(path, file):
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
        kind, table_dim = _KINDS.get(code, (f"MED {code}", _OTHERS.get(code, 3)))
        n_nodes = int("".join(c for c in code if c.isdigit())) if code in _KINDS else 0
        nodes = group["NOD"][()].reshape(n_nodes, -1).T - 1 if n_nodes else np.zeros((len(group["FAM"]), 0), np.int64)
        number = out.add_elements(path, kind, table_dim, nodes[:, _ORDER[kind]] if kind in _ORDER else nodes)
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
