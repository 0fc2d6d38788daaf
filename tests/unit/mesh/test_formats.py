"""MED and Exodus files, as other programs write them."""

import sys

import gmsh
import h5py
import numpy as np
import pytest

from pcontact.mesh.groups import facet_multiplicity
from pcontact.mesh.reader import read_mesh
from pcontact.runtime.errors import InputError
from tests.support.raw_meshes import CELL_TYPES, check_line, check_straight, normals, stack, volume

# -- MED -------------------------------


def med_file(path, cell, order=1, serendipity=0):
    """Two boxes, as gmsh writes them (version 4.1)."""
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", serendipity)
    stack(cell)
    gmsh.model.mesh.setOrder(order)
    gmsh.write(str(path))
    gmsh.model.remove()
    return path


def check_stack(raw):
    """Cells, groups of cells and facets, edges and points of the two boxes."""
    check_straight(raw)
    assert volume(raw) == pytest.approx(2.0) and not raw.lost
    lower = raw.points[raw.blocks[0].vertices[raw.cell_groups["lower"]]]
    assert 2 * len(lower) == raw.offsets[-1] and lower[..., -1].max() == pytest.approx(1.0)
    np.testing.assert_allclose(normals(raw, "bottom").sum(axis=0), -np.eye(raw.dim)[-1], atol=1e-12)
    assert set(facet_multiplicity(raw, *raw.facet_groups["interface"])) == {2}
    np.testing.assert_allclose(raw.points[raw.node_groups["corner"]], np.zeros((1, raw.dim)))
    assert raw.dim == 2 or len(raw.node_groups["rim"]) > 2


@pytest.mark.parametrize("cell", CELL_TYPES)
@pytest.mark.parametrize("order, serendipity", [(1, 0), (2, 0), (2, 1)])
def test_med_of_gmsh(session, tmp_path, cell, order, serendipity):
    raw = read_mesh(med_file(tmp_path / "m.med", cell, order, serendipity))
    assert raw.blocks[0].degree == order
    check_stack(raw)


def make_old(path, name=None):
    """As version 2 has it: no steps of the mesh, families inside it, names of groups as text."""
    with h5py.File(path, "r+") as file:
        (title,) = file["ENS_MAA"]
        mesh = file["ENS_MAA"][title]
        (step,) = mesh
        for part in ("NOE", "MAI"):
            file.move(f"ENS_MAA/{title}/{step}/{part}", f"ENS_MAA/{title}/{part}")
        del mesh[step]
        file.move(f"FAS/{title}", f"ENS_MAA/{title}/FAS")
        del file["FAS"], mesh.attrs["ESP"]
        for family in mesh["FAS/ELEME"].values():
            text = np.array([bytes(row.astype(np.uint8)) for row in family["GRO/NOM"][()]], dtype="S80")
            del family["GRO/NOM"]
            family["GRO/NOM"] = np.char.replace(text, b"lower", name or b"lower")
        file["INFOS_GENERALES"].attrs["MAJ"] = 2


@pytest.mark.parametrize("cell", CELL_TYPES)
def test_old_med(session, tmp_path, cell):
    path = med_file(tmp_path / "m.med", cell)
    make_old(path)
    check_stack(read_mesh(path))


def test_med_names_of_one_byte_a_character(session, tmp_path):
    path = med_file(tmp_path / "m.med", "triangle")
    make_old(path, "Körper".encode("latin-1"))
    assert "Körper" in read_mesh(path).cell_groups


@pytest.mark.parametrize("spoil, message", [
    (lambda mesh: mesh.__delitem__("MAI"), "KeyError"),
    (lambda mesh: mesh["MAI/TR3/NOD"].__setitem__(0, 999), r"element \d+ \(triangle\) refers to node 999"),
    (lambda mesh: mesh.move("MAI/TR3", "MAI/PY5"), 'unsupported type "MED PY5"'),
    (lambda mesh: mesh["NOE/COO"].__setitem__(0, np.nan), "not a finite number"),
    (lambda mesh: mesh.file["ENS_MAA"].create_group("other"), "found 2 meshes; allowed: one"),
])  # fmt: skip
def test_med_that_is_wrong(session, tmp_path, spoil, message):
    path = med_file(tmp_path / "m.med", "triangle")
    make_old(path)
    with h5py.File(path, "r+") as file:
        spoil(next(iter(file["ENS_MAA"].values())))
    with pytest.raises(InputError, match=message) as caught:
        read_mesh(path)
    check_line(caught.value, path)


def test_med_without_families(session, tmp_path):
    path = med_file(tmp_path / "m.med", "quadrilateral")
    make_old(path)
    with h5py.File(path, "r+") as file:
        mesh = next(iter(file["ENS_MAA"].values()))
        del mesh["FAS"], mesh["MAI/SE2/FAM"]
    raw = read_mesh(path)
    assert volume(raw) == pytest.approx(2.0) and not raw.cell_groups


# -- Exodus -------------------------------

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
