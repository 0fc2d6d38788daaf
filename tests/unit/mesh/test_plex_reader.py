"""Meshes that come as a DMPlex: PETSc's own, with and without faces, distributed or on one rank; ours handed back."""

import numpy as np
import pytest

from pcontact.api import mesh_from
from pcontact.cli import convert_mesh
from pcontact.element.reference import facet_nodes
from pcontact.mesh.distribute import load_mesh
from pcontact.mesh.parts import PartMesh
from pcontact.mesh.plex import file_of
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


def volume(file, dim):
    """By the edges of bricks that meet in their first vertex, in the order of VTK; of this rank's."""
    total = 0.0
    for table in file.tables:
        if table.dim == dim:
            x = file.points[table.nodes][:, :, :dim]
            total += np.sum(np.linalg.det(x[:, [1, 3] if dim == 2 else [1, 3, 4]] - x[:, :1]))
    return total


def sizes(file):
    """Number of members of the groups by dimension and name, of all ranks."""
    counts = {}
    for own in WORLD.allgather({key: sum(len(rows) for _, rows in parts) for key, parts in file.groups.items()}):
        for key, n in own.items():
            counts[key] = counts.get(key, 0) + n
    return counts


@parallel
@pytest.mark.parametrize("distribute", [True, False])
@pytest.mark.parametrize("interpolate", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_box_of_petsc(dim, interpolate, distribute):
    """All cells once, of positive volume, with the groups of "Cell Sets" and "Face Sets"; each rank has its own."""
    dm = box(dim, interpolate, distribute)
    file, n = file_of(dm, "box"), 6 * (2 if dim == 3 else 1)
    assert WORLD.allreduce(volume(file, dim)) == pytest.approx(1.0)
    cells = [len(table.nodes) for table in file.tables if table.dim == dim]
    assert WORLD.allreduce(sum(cells)) == n
    assert sum(cells) == dm.getHeightStratum(0)[1] and (not distribute or WORLD.size > 4 or cells)
    tags = np.unique(np.concatenate(WORLD.allgather(file.tags)))
    np.testing.assert_array_equal(tags, 1 + np.arange(3 * 4 * (3 if dim == 3 else 1)))
    if WORLD.size > 1:
        everywhere = np.concatenate(WORLD.allgather(file.tags))
        twice = np.isin(file.tags, [tag for tag in tags if np.sum(everywhere == tag) > 1])
        np.testing.assert_array_equal(file.shared, twice)
    counts, word = sizes(file), "volume" if dim == 3 else "surface"
    for number, half in ((7, 0.25), (8, 0.75)):
        assert counts[dim, f"{word}_{number}"] == n / 2
        for k, rows in file.groups.get((dim, f"{word}_{number}"), []):
            middles = file.points[file.tables[k].nodes[rows]].mean(axis=1)
            np.testing.assert_allclose(middles[:, 0], half, atol=0.13)
    if interpolate:
        faces = "surface" if dim == 3 else "curve"
        found = {name for _, name in counts if name.startswith(faces)}
        assert found == {f"{faces}_{k}" for k in range(1, 2 * dim + 1)}
        for k, rows in file.groups.get((dim - 1, f"{faces}_1"), []):
            # a side of the box
            assert np.ptp(file.points[file.tables[k].nodes[rows], :dim].reshape(-1, dim), axis=0).min() == 0.0


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
    counts = sizes(file_of(of_gmsh(path, distribute, regions), path))
    n = WORLD.allreduce(sum(len(part.cells) for part in mesh.facet_groups["upper_bottom"]))
    if regions:
        assert {(3, "lower"), (3, "upper")} <= set(counts) and counts[2, "upper_bottom"] == n
        assert counts[3, "lower"] + counts[3, "upper"] == mesh.n_cells_total
    else:
        assert len([name for dim, name in counts if dim == 3 and name.startswith("volume_")]) == 2
        assert n in [count for (dim, name), count in counts.items() if dim == 2 and name.startswith("surface_")]


def of_gmsh(path, distribute=True, regions=True):
    """A file that PETSc has read, on rank 0 alone or distributed."""
    options = PETSc.Options()
    options.setValue("dm_plex_gmsh_use_regions", regions)
    try:
        dm = PETSc.DMPlex().createFromFile(str(path), interpolate=True, comm=WORLD)
    finally:
        options.delValue("dm_plex_gmsh_use_regions")
    if distribute:
        dm.distribute()
    return dm


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("cell", ["tetrahedron", "quadrilateral", "mixed"])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("distribute", [True, False])
def test_the_mesh_of_a_plex_is_that_of_its_file(shared_tmp, cell, order, distribute):
    """Cells, nodes, surfaces and components, wherever PETSc has left them; of degree 2, too."""
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, "hexahedron" if cell == "mixed" else cell, 4, 3)
        if cell == "mixed":
            cut_mesh(path, path, ("hexahedron", "wedge", "pyramid"), split="upper_top")
    WORLD.Barrier()
    regions, pairs = ["lower", "upper"], [("upper_bottom", "lower_top", None)]

    def load(path, order):
        return load_mesh(WORLD, path, order, regions, pairs, lambda mesh: None)

    # PETSc does not read all kinds of cells in one file
    dm = load(path, 1).dm if cell == "mixed" else of_gmsh(path, distribute)
    wanted = load(path, order)
    top = WORLD.allreduce(wanted.points[:, -1].max(initial=0.0), op=MPI.MAX)
    found = load(mesh_from(dm, facets={"top": lambda x: x[:, -1] == top}).file, order)
    assert found.n_nodes_total == wanted.n_nodes_total and found.n_cells_total == wanted.n_cells_total
    assert found.n_components == 2 and sorted(found.component_names) == regions
    for name in ("upper_bottom", "lower_top", "lower_bottom"):
        assert places(found, name) == places(wanted, name) != []
    assert places(found, "top") == places(wanted, "upper_top")
    assert nodes(found) == nodes(wanted)


@parallel
@pytest.mark.parametrize("order", [1, 2])
def test_groups_of_edges(order):
    """They have the nodes of their edges, middles too, on whatever rank the edges are; others may have their ends."""
    dm = box(3, True, True)
    dm.createLabel("rim")
    v0, v1 = dm.getDepthStratum(0)
    x = dm.getCoordinatesLocal().getArray(readonly=True).reshape(-1, 3)
    for edge in range(*dm.getDepthStratum(1)):
        if np.all(x[dm.getCone(edge) - v0][:, [0, 2]] == 0.0):
            dm.setLabelValue("rim", edge, 1)
    mesh = load_mesh(WORLD, mesh_from(dm).file, order, ["volume_7", "volume_8"], [], lambda mesh: None)
    there = np.flatnonzero(np.all(mesh.points[:, [0, 2]] == 0.0, axis=1))
    np.testing.assert_array_equal(np.sort(mesh.node_groups["rim"]), there)
    assert len(set().union(*WORLD.allgather(set(mesh.file_nodes[there].tolist())))) == (4 if order == 1 else 7)


@parallel
@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron", "triangle", "tetrahedron"])
def test_coordinates_of_degree_2(shared_tmp, cell):
    """Nodes are those of the file; where PETSc has them once for each cell, it is told what is allowed."""
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, cell, 3, 2, order=2)
    WORLD.Barrier()
    dm = of_gmsh(path)
    if cell in ("triangle", "tetrahedron") and PETSc.Sys.getVersion() < (3, 20):
        with pytest.raises(InputError, match="allowed: continuous coordinates of degree 1 or 2"):
            mesh_from(dm)
        return
    if cell == "hexahedron":
        dm.createLabel("rim")
        section, x = dm.getCoordinateSection(), dm.getCoordinatesLocal().getArray(readonly=True)
        for edge in range(*dm.getDepthStratum(1)):
            if all(np.all(x[section.getOffset(int(v)) :][:2] == 0.0) for v in dm.getCone(edge)):
                dm.setLabelValue("rim", edge, 1)
    wanted, found = (load_mesh(WORLD, one, None, ["lower", "upper"], [], lambda mesh: None)
                     for one in (path, mesh_from(dm).file))  # fmt: skip
    assert found.degree == 2 and found.curved and nodes(found) == nodes(wanted)
    assert places(found, "upper_top") == places(wanted, "upper_top")
    if cell == "hexahedron":
        there = np.flatnonzero(np.all(found.points[:, :2] == 0.0, axis=1))
        np.testing.assert_array_equal(np.sort(found.node_groups["rim"]), there)
        assert WORLD.allreduce(len(there)) >= 12


def rounded(x):
    return [tuple(row) for row in np.round(x, 9).tolist()]


def places(mesh, name):
    """Middles of the facets of a group, of all ranks, sorted."""
    own = []
    for part in mesh.facet_groups[name]:
        corners = mesh.blocks[part.block].nodes[part.cells[:, None], facet_nodes(part.cell, 1)[part.local]]
        own.append(rounded(mesh.points[corners].mean(axis=1)))
    return sorted(row for some in WORLD.allgather(own) for one in some for row in one)


def nodes(mesh):
    """Places of all nodes by their numbers, of which each has one place."""
    own = set(zip(mesh.file_nodes.tolist(), rounded(mesh.points), strict=True))
    every = set().union(*WORLD.allgather(own))
    assert sorted(number for number, _ in every) == list(range(mesh.n_nodes_total))
    return sorted(place for _, place in every)


@pytest.mark.parallel(2, 3, 4)
def test_a_surface_between_cells():
    """Its facets are there once, and none is on the boundary, also where its two cells are on two ranks; a function
    names those on the boundary of the whole mesh alone."""
    if WORLD.size == 1:
        return
    dm = box(3, True, True)
    dm.createLabel("inside")
    v0, v1 = dm.getDepthStratum(0)
    x = dm.getCoordinatesLocal().getArray(readonly=True).reshape(-1, 3)
    for facet in range(*dm.getHeightStratum(1)):
        if np.all(x[[p - v0 for p in dm.getTransitiveClosure(facet)[0] if v0 <= p < v1], 0] == 0.5):
            dm.setLabelValue("inside", facet, 1)
    part = PartMesh(WORLD, mesh_from(dm, facets={"skin": lambda x: x[:, 0] >= 0.0}).file, 1)
    between = {name: WORLD.allreduce(int(some.sum())) for name, some in part.between.items()}
    counts = part.summary([]).facet_groups
    assert between.pop("inside") == counts["inside"] == 6 and not any(between.values())
    assert counts["skin"] == 32


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
    counts = sizes(file_of(mesh.dm, "mesh"))
    members = {name: WORLD.allreduce(sum(len(rows) for rows in parts)) for name, parts in mesh.cell_groups.items()}
    facets = {
        name: WORLD.allreduce(sum(len(part.cells) for part in parts)) for name, parts in mesh.facet_groups.items()
    }
    assert {name: n for (dim, name), n in counts.items() if dim == mesh.dim} == members
    assert {name: n for (dim, name), n in counts.items() if dim == mesh.dim - 1} == facets
    again = load_mesh(WORLD, mesh_from(mesh.dm).file, 1, ["lower", "upper"], [], lambda raw: None)
    assert nodes(again) == nodes(mesh) and places(again, "upper_bottom") == places(mesh, "upper_bottom")


@parallel
def test_cells_of_an_overlap_count_once():
    """A box of PETSc's with cells of other ranks around those of each."""
    dm = box(3, True, False)
    dm.distribute(overlap=1)
    file = file_of(dm, "box")
    assert WORLD.allreduce(volume(file, 3)) == pytest.approx(1.0)
    counts = sizes(file)
    assert counts[3, "volume_7"] == 6 and counts[2, "surface_1"] == 6


@parallel
def test_what_has_no_element_is_refused():
    """On every rank, with words."""
    n = int(WORLD.rank == 0)
    cells, points = np.array([[0, 1]] * n, dtype=PETSc.IntType).reshape(n, 2), np.arange(2.0 * n)[:, None]
    dm = PETSc.DMPlex().createFromCellList(1, cells, points, comm=WORLD)
    with pytest.raises(InputError, match="2 vertices in 1 dimensions"):
        file_of(dm, "mesh")
