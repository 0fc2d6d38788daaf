"""MED files, as gmsh and other programs write them."""

import gmsh
import h5py
import numpy as np
import pytest

from pcontact.mesh.raw import facet_multiplicity
from pcontact.mesh.read import read_mesh
from pcontact.runtime.errors import InputError
from tests.support.raw_meshes import CELL_TYPES, check_line, check_straight, normals, stack, volume


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


@pytest.mark.parametrize("cell", [*CELL_TYPES, "wedge"])
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
    (lambda mesh: mesh.move("MAI/TR3", "MAI/OCT12"), 'unsupported type "MED OCT12"'),
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
