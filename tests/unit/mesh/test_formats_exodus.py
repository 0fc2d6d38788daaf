"""Exodus files, as other programs write them."""

import sys

import h5py
import numpy as np
import pytest

from pcontact.mesh.read import read_mesh
from pcontact.runtime.errors import InputError
from tests.support.raw_meshes import check_line, check_straight, normals

EDGES = [(0, -1), (1, 0), (0, 1), (-1, 0)]
CORNERS = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
HEX20 = [
    *((*c, z) for z in (-1, 1) for c in CORNERS),
    *((*e, -1) for e in EDGES), *((*c, 0) for c in CORNERS), *((*e, 1) for e in EDGES),
]  # fmt: skip
TETRA = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
# Exodus' order of the nodes, and the outward normals of its sides
EXODUS = {
    "TRI3": ([(0, 0), (1, 0), (0, 1)], [(0, -1), (1, 1), (-1, 0)]),
    "QUAD4": (CORNERS, EDGES),
    "QUAD9": ([*CORNERS, *EDGES, (0, 0)], EDGES),
    "TETRA": (TETRA, [(0, -1, 0), (1, 1, 1), (-1, 0, 0), (0, 0, -1)]),
    "HEX8": (HEX20[:8], [(0, -1, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, 0, -1), (0, 0, 1)]),
    "HEX20": (HEX20, [(0, -1, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, 0, -1), (0, 0, 1)]),
    "HEX27": (
        [*HEX20, (0, 0, 0), (0, 0, -1), (0, 0, 1), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)],
        [(0, -1, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, 0, -1), (0, 0, 1)],
    ),
}


def letters(names, width=33):
    """Names as Exodus has them."""
    table = np.zeros((len(names), width), dtype="S1")
    for row, name in zip(table, names, strict=True):
        row[: len(name)] = [bytes([letter]) for letter in name.encode()]
    return table


def exodus_file(path, kind, split=True):
    """Two cells of a kind apart from each other in two blocks, with a side set for each side of the second."""
    x, sides = np.array(EXODUS[kind][0], dtype=float), EXODUS[kind][1]
    points, n = np.vstack([x, x + 5.0]), len(x)
    with h5py.File(path, "w") as file:
        if split:
            for name, column in zip("xyz", points.T, strict=False):
                file[f"coord{name}"] = column
        else:
            file["coord"] = points.T
        for k in (0, 1):
            file[f"connect{k + 1}"] = np.arange(1 + k * n, 1 + (k + 1) * n)[None].astype(np.int32)
            file[f"connect{k + 1}"].attrs["elem_type"] = kind if split else np.bytes_(kind.lower())
        file["eb_prop1"], file["eb_names"] = np.array([3, 10]), letters(["first", ""])
        file["ns_prop1"], file["node_ns1"] = np.array([7]), np.array([1, 2])
        file["ss_prop1"] = np.arange(1, len(sides) + 1) * 11
        file["ss_names"] = letters([f"side {k}" if k else "" for k in range(len(sides))])
        for k in range(len(sides)):
            file[f"elem_ss{k + 1}"], file[f"side_ss{k + 1}"] = np.array([2]), np.array([k + 1])
    return path


@pytest.mark.parametrize("kind", EXODUS)
@pytest.mark.parametrize("split", [True, False])
def test_exodus(tmp_path, kind, split):
    raw = read_mesh(exodus_file(tmp_path / "m.exo", kind, split))
    check_straight(raw)
    solid, skin = ("volume", "surface") if raw.dim == 3 else ("surface", "curve")
    assert {name: cells.tolist() for name, cells in raw.cell_groups.items()} == {"first": [0], f"{solid}_10": [1]}
    assert raw.node_groups["point_7"].tolist() == [0, 1]
    for k, normal in enumerate(EXODUS[kind][1]):
        name = f"side {k}" if k else f"{skin}_11"
        assert raw.facet_groups[name][0].tolist() == [1]
        found = normals(raw, name)[0]
        np.testing.assert_allclose(found / np.linalg.norm(found), normal / np.linalg.norm(normal), atol=1e-12)


@pytest.mark.parametrize("change, message", [
    ({"side_ss1": [7]}, 'group "surface_11" refers to what is not in the file'),
    ({"elem_ss1": [3]}, 'group "surface_11" refers to what is not in the file'),
    ({"elem_ss1": [1, 2]}, 'group "surface_11" refers to what is not in the file'),
    ({"node_ns1": [99]}, 'group "point_7" refers to what is not in the file'),
    ({"connect1": [[1, 2, 3, 4, 5, 6, 7, 99]]}, r"element 1 \(hexahedron\) refers to node 99"),
    ({"coordx": None, "coordy": None, "coordz": None}, "cannot be read as .exo: ValueError"),
])  # fmt: skip
def test_exodus_that_is_wrong(tmp_path, change, message):
    path = exodus_file(tmp_path / "m.exo", "HEX8")
    with h5py.File(path, "r+") as file:
        for name, value in change.items():
            kept = dict(file[name].attrs)
            del file[name]
            if value is not None:
                file[name] = np.array(value)
                file[name].attrs.update(kept)
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(path)
    check_line(caught.value, path)


def test_exodus_of_other_kinds(tmp_path, monkeypatch):
    """Cells that the program does not know, damaged files, and netCDF's own format without the package for it."""
    path = exodus_file(tmp_path / "m.exo", "HEX8")
    with h5py.File(path, "r+") as file:
        for k in (1, 2):
            file[f"connect{k}"].attrs["elem_type"] = "WEDGE"
    with pytest.raises(InputError, match="WEDGE"):
        read_mesh(path)
    data = path.read_bytes()
    for cut in (len(data) // 2, 100):
        path.write_bytes(data[:cut])
        with pytest.raises(InputError, match=".exo.*OSError") as caught:
            read_mesh(path)
        check_line(caught.value, path)
    monkeypatch.setitem(sys.modules, "netCDF4", None)
    path.write_bytes(b"CDF\1" + 60 * b"\0")
    with pytest.raises(InputError, match="netCDF") as caught:
        read_mesh(path)
    check_line(caught.value, path)
