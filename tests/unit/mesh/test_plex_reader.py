"""Meshes that come as a DMPlex: PETSc's own, with and without faces, distributed or on one rank; ours handed back."""

import numpy as np
import pytest

from pcontact.cli import convert_mesh
from pcontact.mesh.distribute import load_mesh
from pcontact.mesh.plex import read_plex
from pcontact.mesh.read import read_mesh
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, PETSc
from tests.support.small import blocks_file
from tests.support.wedges import cut_mesh

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel


def box(dim, interpolate, distribute):
    """PETSc's box of 2 by 3 (by 2) cells, cells of its lower half in "Cell Sets" 7, of the upper half in 8."""
    dm = PETSc.DMPlex().createBoxMesh([2, 3, 2][:dim], simplex=False, interpolate=interpolate, comm=WORLD)
    dm.createLabel("Cell Sets")
    for cell in range(*dm.getHeightStratum(0)):
        points = dm.getTransitiveClosure(cell)[0]
        v0, v1 = dm.getDepthStratum(0)
        x = dm.getCoordinatesLocal().getArray(readonly=True).reshape(-1, dim)
        middle = np.mean([x[p - v0] for p in points if v0 <= p < v1], axis=0)
        dm.setLabelValue("Cell Sets", cell, 7 if middle[0] < 0.5 else 8)
    if distribute:
        dm.distribute()
    return dm


def volumes(tables):
    """By the edges of bricks that meet in their first vertex, in the order of VTK."""
    total = 0.0
    for nodes in tables.cells.values():
        x = tables.points[nodes]
        corners = [1, 3] if x.shape[2] == 2 else [1, 3, 4]
        total += np.sum(np.linalg.det(x[:, corners] - x[:, :1]))
    return total


@parallel
@pytest.mark.parametrize("distribute", [True, False])
@pytest.mark.parametrize("interpolate", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_box_of_petsc(dim, interpolate, distribute):
    """All cells once, of positive volume, with the groups of "Cell Sets" and "Face Sets"."""
    tables = read_plex(box(dim, interpolate, distribute))
    if WORLD.rank:
        assert tables is None
        return
    assert volumes(tables) == pytest.approx(1.0)
    assert len(tables.points) == 3 * 4 * (3 if dim == 3 else 1)
    assert np.array_equal(np.unique(np.concatenate([t.ravel() for t in tables.cells.values()])),
                          np.arange(len(tables.points)))  # fmt: skip
    n = sum(len(nodes) for nodes in tables.cells.values())
    word = "volume" if dim == 3 else "surface"
    for number, half in ((7, 0.25), (8, 0.75)):
        rows = tables.cell_groups[f"{word}_{number}"]
        assert sum(len(some) for some in rows.values()) == n / 2
        for kind, some in rows.items():
            np.testing.assert_allclose(tables.points[tables.cells[kind][some]].mean(axis=1)[:, 0], half, atol=0.13)
    if interpolate:
        faces = "surface" if dim == 3 else "curve"
        assert {name for name in tables.lower_groups if name.startswith(faces)} == {
            f"{faces}_{k}" for k in range(1, 2 * dim + 1)
        }
        for rows in tables.lower_groups[f"{faces}_1"]:
            # a side of the box
            assert np.ptp(tables.points[rows].reshape(-1, dim), axis=0).min() == 0.0


@parallel
@pytest.mark.parametrize("distribute", [True, False])
@pytest.mark.parametrize("regions", [True, False])
def test_a_file_of_gmsh_that_petsc_reads(shared_tmp, distribute, regions):
    """Tetrahedra with faces, with groups by number, or by name."""
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, "tetrahedron", 3, 2)
    WORLD.Barrier()
    mesh = load_mesh(WORLD, path, 1, ["lower", "upper"], [("upper_bottom", "lower_top", None)], lambda raw: None)
    options = PETSc.Options()
    options.setValue("dm_plex_gmsh_use_regions", regions)
    try:
        dm = PETSc.DMPlex().createFromFile(str(path), interpolate=True, comm=WORLD)
    finally:
        options.delValue("dm_plex_gmsh_use_regions")
    if distribute:
        dm.distribute()
    tables = read_plex(dm)
    n = sum(len(part.cells) for part in mesh.facet_groups["upper_bottom"])
    n, size = WORLD.allreduce(n), np.ptp(mesh.points, axis=0)
    if WORLD.rank:
        return
    assert len(tables.points) == mesh.n_nodes_total and size.min() > 0.0
    assert sum(len(nodes) for nodes in tables.cells.values()) == mesh.n_cells_total
    counts = {name: sum(map(len, rows)) for name, rows in tables.lower_groups.items()}
    if regions:
        assert {"lower", "upper"} <= set(tables.cell_groups) and counts["upper_bottom"] == n
    else:
        assert len([name for name in tables.cell_groups if name.startswith("volume_")]) == 2
        assert n in [count for name, count in counts.items() if name.startswith("surface_")]


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "mixed"])
def test_what_convert_writes_for_petsc(tmp_path, cell):
    """PETSc loads it, with labels; the program reads the groups of the first file; degree 2 is refused."""
    path, target = tmp_path / "blocks.msh", tmp_path / "blocks.h5"
    blocks_file(path, "hexahedron" if cell == "mixed" else cell, 3, 2)
    if cell == "mixed":
        cut_mesh(path, path, ("hexahedron", "wedge", "pyramid"), split="upper_top")
    convert_mesh(str(path), {"o": str(target), "petsc": "true"})
    dm = PETSc.DMPlex().createFromFile(str(target), comm=MPI.COMM_SELF)
    raw, again = read_mesh(path), read_mesh(target)
    start, end = dm.getHeightStratum(0)
    assert end - start == again.offsets[-1] == raw.offsets[-1] and len(again.points) == len(raw.points)
    assert {"lower", "upper", "upper_bottom"} <= {dm.getLabelName(k) for k in range(dm.getNumLabels())}
    for name in ("lower", "upper"):
        assert len(again.cell_groups[name]) == len(raw.cell_groups[name])
    for name, (cells, _) in raw.facet_groups.items():
        assert len(again.facet_groups[name][0]) == len(cells)
    with pytest.raises(InputError, match="found cells of degree 2; allowed: degree 1"):
        convert_mesh(str(path), {"o": str(tmp_path / "other.h5"), "petsc": "true", "order": "2"})
    assert not (tmp_path / "other.h5").exists()


@parallel
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "mixed"])
def test_our_own_plex_handed_back(shared_tmp, cell):
    """Cells, groups of cells, facets and nodes are those of the file, by their places."""
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, "hexahedron" if cell == "mixed" else cell, 3, 2)
        if cell == "mixed":
            cut_mesh(path, path, ("hexahedron", "wedge", "pyramid"), split="upper_top")
    WORLD.Barrier()
    mesh = load_mesh(WORLD, path, 1, ["lower", "upper"], [("upper_bottom", "lower_top", None)], lambda raw: None)
    tables = read_plex(mesh.dm)
    members = {name: WORLD.allreduce(sum(len(rows) for rows in parts)) for name, parts in mesh.cell_groups.items()}
    facets = {
        name: WORLD.allreduce(sum(len(part.cells) for part in parts)) for name, parts in mesh.facet_groups.items()
    }
    if WORLD.rank:
        return
    assert len(tables.points) == mesh.n_nodes_total
    assert sum(len(nodes) for nodes in tables.cells.values()) == mesh.n_cells_total
    assert {name: sum(map(len, rows.values())) for name, rows in tables.cell_groups.items()} == members
    assert {name: sum(map(len, tables.lower_groups[name])) for name in facets} == facets
    for rows in tables.lower_groups["upper_bottom"]:
        x = tables.points[rows].reshape(-1, mesh.dim)
        np.testing.assert_allclose(x[:, -1], x[0, -1], atol=1e-12)


@parallel
def test_cells_of_an_overlap_count_once():
    """A box of PETSc's with cells of other ranks around those of each."""
    dm = box(3, True, False)
    dm.distribute(overlap=1)
    tables = read_plex(dm)
    if WORLD.rank == 0:
        assert volumes(tables) == pytest.approx(1.0) and len(tables.cells["hexahedron"]) == 12
        assert sum(len(some) for some in tables.cell_groups["volume_7"].values()) == 6


@parallel
def test_what_has_no_element_is_refused():
    """On every rank, with words."""
    n = int(WORLD.rank == 0)
    cells, points = np.array([[0, 1]] * n, dtype=PETSc.IntType).reshape(n, 2), np.arange(2.0 * n)[:, None]
    dm = PETSc.DMPlex().createFromCellList(1, cells, points, comm=WORLD)
    with pytest.raises(InputError, match="2 vertices in 1 dimensions"):
        read_plex(dm)
