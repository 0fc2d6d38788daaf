"""The cells and vertices of a mesh as a DMPlex, and which rank owns what several ranks have.

The Plex has no faces and no edges: they take 570 bytes a cell, and whoever needs them calls ``dm.interpolate()`` on a
clone. Points 0 to n - 1 are the cells of this rank, all blocks one after the other; the vertices follow, in the order
of the nodes.
"""

import ctypes

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.runtime.petsc import MPI, Integer, PETSc, call, handle

_TYPE = PETSc.DMPlex.PolytopeType
# by dimension and number of vertices: type in PETSc, and its vertices in the order of VTK (PETSc takes the outside of a
# solid for its inside; the permutations are their own inverses)
POLYTOPES = {
    (2, 3): (_TYPE.TRIANGLE, [0, 1, 2]),
    (2, 4): (_TYPE.QUADRILATERAL, [0, 1, 2, 3]),
    (3, 4): (_TYPE.TETRAHEDRON, [0, 2, 1, 3]),
    (3, 5): (_TYPE.PYRAMID, [0, 3, 2, 1, 4]),
    (3, 6): (_TYPE.TRI_PRISM, [0, 2, 1, 3, 4, 5]),
    (3, 8): (_TYPE.HEXAHEDRON, [0, 3, 2, 1, 4, 5, 6, 7]),
}
# strata of the label of a group: its cells and vertices; cells whose facet k is in the group are in FACETS + k
MEMBERS, FACETS = 1, 100
# labels that PETSc keeps by itself
RESERVED = ("celltype", "depth")

_UNITS = {"l": MPI.INT64_T, "q": MPI.INT64_T, "d": MPI.DOUBLE}
# options that ask for something of the mesh of a run
CHECKS = "dm_plex_check"
VIEWS = ("dm_view", CHECKS)


def owners(comm, keys, n_keys, first=0):
    """Which rank owns what several ranks have, spread evenly, the same in every run. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    keys : ndarray (n,) int64
        Each once on this rank, below ``n_keys``; equal ones on two ranks are the same thing.
    n_keys : int
    first : int
        Points of this rank alone that come before these.

    Returns
    -------
    PETSc.SF or None
        From the first + n points of this rank to those of their owners: its leaves are what other ranks own. None on
        one rank.
    """
    if comm.size == 1:
        return None
    starts = np.arange(comm.size + 1) * n_keys // comm.size
    share = starts[comm.rank + 1] - starts[comm.rank]
    rank = np.searchsorted(starts, keys, side="right") - 1
    remote = np.empty((first + len(keys), 2), dtype=PETSc.IntType)
    remote[:first, 0], remote[:first, 1] = comm.rank, share + np.arange(first)
    remote[first:, 0], remote[first:, 1] = rank, keys - starts[rank]
    homes, bare, found = PETSc.SF().create(comm=comm), PETSc.DMPlex().create(comm=comm), ctypes.c_void_p()
    homes.setGraph(share + first, None, remote)
    bare.setChart(0, len(remote))
    call("DMPlexSetPartitionBalance", handle(bare), ctypes.c_int(1))
    call("DMPlexCreatePointSF", handle(bare), handle(homes), ctypes.c_int(1), ctypes.byref(found))
    bare_sf = _taken(bare, found)
    homes.destroy()
    bare.destroy()
    return bare_sf


def _taken(dm, found):
    """A star forest that PETSc has made, as petsc4py knows it; the Plex has it, too."""
    call("DMSetPointSF", handle(dm), found)
    call("PetscSFDestroy", ctypes.byref(found))
    return dm.getPointSF()


def leaves(sf):
    """Points (m,) that other ranks own."""
    if sf is None:
        return np.zeros(0, dtype=np.int64)
    _, local, remote = sf.getGraph()
    return np.arange(len(remote)) if local is None else np.asarray(local)


def told(sf, values):
    """Values (n,) or (n, k) of points, where other ranks own them those of their owners. *Collective.*"""
    if sf is None:
        return values
    values = np.ascontiguousarray(values)
    result, width = values.copy(), int(np.prod(values.shape[1:], dtype=np.int64))
    unit = _UNITS[values.dtype.char].Create_contiguous(width).Commit()
    sf.bcastBegin(unit, values, result, MPI.REPLACE)
    sf.bcastEnd(unit, values, result, MPI.REPLACE)
    unit.Free()
    return result


def least_told(sf, values):
    """Values (n,) of points, the least that any rank has. *Collective.*"""
    if sf is None:
        return values
    result, unit = values.copy(), _UNITS[values.dtype.char]
    sf.reduceBegin(unit, values, result, MPI.MIN)
    sf.reduceEnd(unit, values, result, MPI.MIN)
    return told(sf, result)


def plex(comm, dim, cells, points, sf):
    """A DMPlex of cells and vertices. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    dim : int
    cells : list of (str, ndarray (n, k))
        Name in :data:`pcontact.element.reference.CELLS`, and vertices (at least; more columns are left out) of its
        cells by rows of ``points``.
    points : ndarray (n_vertices, dim)
        [length]
    sf : PETSc.SF or None
        Of cells and vertices, see :func:`owners`.

    Returns
    -------
    PETSc.DMPlex
    """
    kinds = [(*POLYTOPES[dim, CELLS[name].n_vertices], table) for name, table in cells]
    counts, n_vertices = [len(table) for *_, table in kinds], len(points)
    n = sum(counts)
    dm = PETSc.DMPlex().create(comm=comm)
    dm.setName("mesh")
    dm.setDimension(dim)
    dm.setChart(0, n + n_vertices)
    _set_cone_sizes(dm, [*(len(order) for _, order, _ in kinds), 0], [*counts, n_vertices])
    dm.setUp()
    flat, end = cones(dm, sum(table[:, : len(order)].size for _, order, table in kinds)), 0
    for _, order, table in kinds:
        part = flat[end : end + len(table) * len(order)].reshape(len(table), len(order))
        np.add(table[:, order], n, out=part, casting="unsafe")
        end += part.size
    call("DMPlexSymmetrize", handle(dm))
    dm.stratify()
    _set_types(dm, [*(kind for kind, *_ in kinds), _TYPE.POINT], [*counts, n_vertices])
    if sf is not None:
        dm.setPointSF(sf)
    own = _to_self(np.arange(n_vertices), n_vertices)
    points = np.ascontiguousarray(points, dtype=np.float64)
    call("DMPlexBuildCoordinatesFromCellListParallel", handle(dm), dim, handle(own), points)
    own.destroy()
    if sf is not None:
        dm.getCoordinateDM().setPointSF(sf)
    return dm


def _to_self(roots, n_roots):
    """A star forest on this rank alone, with leaves one after the other."""
    sf, remote = PETSc.SF().create(comm=MPI.COMM_SELF), np.zeros((len(roots), 2), dtype=PETSc.IntType)
    remote[:, 1] = roots
    sf.setGraph(n_roots, None, remote)
    return sf


def _set_cone_sizes(dm, sizes, counts):
    """Sizes of the cones of runs of points; a call for each point would take longer than all the rest."""
    kinds, target = PETSc.Section().create(comm=MPI.COMM_SELF), ctypes.c_void_p()
    kinds.setChart(0, len(sizes))
    for kind, size in enumerate(sizes):
        kinds.setDof(kind, size)
    kinds.setUp()
    sf = _to_self(np.repeat(np.arange(len(sizes)), counts), len(sizes))
    call("DMPlexGetConeSection", handle(dm), ctypes.byref(target))
    call("PetscSFDistributeSection", handle(sf), handle(kinds), None, target)
    kinds.destroy()
    sf.destroy()


def cones(dm, size):
    """All cones one after the other (size,), in PETSc's memory."""
    found = ctypes.POINTER(Integer)()
    call("DMPlexGetCones", handle(dm), ctypes.byref(found))
    return np.ctypeslib.as_array(found, (size,)) if size else np.zeros(0, dtype=PETSc.IntType)


def _set_types(dm, types, counts):
    """Types of runs of points."""
    dm.createLabel("celltype")
    label, ends = dm.getLabel("celltype"), np.cumsum([0, *counts])
    for kind in sorted(set(types)):
        runs = [(a, b) for one, a, b in zip(types, ends[:-1], ends[1:], strict=True) if one == kind and b > a]
        if len(runs) == 1:
            rows = PETSc.IS().createStride(runs[0][1] - runs[0][0], runs[0][0], 1, comm=MPI.COMM_SELF)
            label.setStratumIS(kind, rows)
            rows.destroy()
        elif runs:
            _set_stratum(label, kind, np.concatenate([np.arange(a, b) for a, b in runs]))


def _set_stratum(label, value, points):
    """Points (n,), ascending, of a stratum of a label."""
    rows = PETSc.IS().createGeneral(np.ascontiguousarray(points, dtype=PETSc.IntType), comm=MPI.COMM_SELF)
    label.setStratumIS(value, rows)
    rows.destroy()


def parts_of(dm):
    """Rank of every cell (n,) of this rank, by the partitioner of a Plex. *Collective.*

    Raises
    ------
    PETSc.Error
        The user's options of the partitioner are wrong.
    """
    sizes, found = PETSc.Section().create(comm=dm.comm), ctypes.c_void_p()
    call("PetscPartitionerDMPlexPartition", handle(dm.getPartitioner()), handle(dm), None, handle(sizes),
         ctypes.byref(found))  # fmt: skip
    return taken_parts(sizes, found, dm.getHeightStratum(0)[1])


def taken_parts(sizes, found, n):
    """Part of each of n cells, of what a partitioner has found: sizes of the parts (a section), and their cells one
    part after the other (an index set, by its address). Both are used up."""
    pointer, (first, end) = ctypes.POINTER(Integer)(), sizes.getChart()
    call("ISGetIndices", found, ctypes.byref(pointer))
    cells = np.ctypeslib.as_array(pointer, (n,)) if n else np.zeros(0, dtype=PETSc.IntType)
    parts = np.empty(n, dtype=np.int64)
    parts[cells] = np.repeat(np.arange(first, end), [sizes.getDof(part) for part in range(first, end)])
    call("ISRestoreIndices", found, ctypes.byref(pointer))
    call("ISDestroy", ctypes.byref(found))
    sizes.destroy()
    return parts


def mesh_plex(mesh):
    """The DMPlex of a mesh, with its groups as labels. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh

    Returns
    -------
    PETSc.DMPlex
    """
    number, n = np.full(len(mesh.points), -1, dtype=np.int64), sum(len(block.nodes) for block in mesh.blocks)
    for block in mesh.blocks:
        number[block.nodes[:, : CELLS[block.cell].n_vertices]] = 0
    vertices = np.flatnonzero(number == 0)
    number[vertices] = np.arange(len(vertices))
    whole = len(vertices) == len(number)
    cells = [(block.cell, block.nodes if whole else number[block.nodes]) for block in mesh.blocks]
    sf = owners(mesh.comm, mesh.file_nodes[vertices], mesh.n_nodes_total, n)
    dm = plex(mesh.comm, mesh.dim, cells, mesh.points[vertices], sf)
    _set_labels(dm, mesh, number)
    return dm


def view(mesh):
    """View and check the DMPlex of a mesh as the options database asks: ``-dm_view``, ``-dm_plex_check_all`` and the
    like. Checks see it with its faces. *Collective.*

    Raises
    ------
    PETSc.Error
        The mesh does not pass a check, or an option is wrong.
    """
    asked = [name for name in PETSc.Options().getAll() if name.startswith(VIEWS)]
    if not asked:
        return
    mesh.dm.viewFromOptions("-dm_view")
    if any(name.startswith(CHECKS) for name in asked):
        faces = mesh.dm.clone()
        faces.distributeSetDefault(False)
        faces.interpolate()
        faces.setFromOptions()
        faces.destroy()


def _set_labels(dm, mesh, number):
    """The groups of a mesh; number (n_nodes,): of the vertices, -1 for other nodes."""
    first = np.cumsum([0, *(len(block.nodes) for block in mesh.blocks)])
    names = dict.fromkeys([*mesh.cell_groups, *mesh.facet_groups, *mesh.node_groups])
    for name in names:
        if name in RESERVED:
            continue
        dm.createLabel(name)
        label = dm.getLabel(name)
        members = [first[k] + rows for k, rows in enumerate(mesh.cell_groups.get(name, []))]
        if name in mesh.node_groups:
            nodes = number[mesh.node_groups[name]]
            members.append(first[-1] + np.sort(nodes[nodes >= 0]))
        if members:
            _set_stratum(label, MEMBERS, np.concatenate(members))
        parts = mesh.facet_groups.get(name, [])
        cells = np.concatenate([np.zeros(0, np.int64), *(first[part.block] + part.cells for part in parts)])
        local = np.concatenate([np.zeros(0, np.int64), *(part.local for part in parts)])
        for facet in np.unique(local):
            _set_stratum(label, FACETS + int(facet), np.unique(cells[local == facet]))
