"""The cells and vertices of a mesh as a DMPlex, and which rank owns what several ranks have.

The Plex has no faces and no edges: they take 570 bytes a cell, and whoever needs them calls ``dm.interpolate()`` on a
clone. Points 0 to n - 1 are the cells of this rank, all blocks one after the other; the vertices follow, in the order
of the nodes.

A DMPlex of the user's, as it is or spread over ranks, becomes tables of a mesh on rank 0.
"""

import ctypes
from typing import NamedTuple

import h5py
import numpy as np

from pcontact.element.reference import CELLS, MESHIO_NAMES, facet_kinds, facet_nodes
from pcontact.mesh.raw import DIMENSION_NAMES, LOWER, FileMesh
from pcontact.runtime.errors import InputError
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
# labels whose values are the numbers of groups, and the dimension of these, below that of the mesh
SETS = {"Cell Sets": 0, "Face Sets": 1, "Edge Sets": 2}
# cells by dimension and vertices
CELLS_OF = {(2, 3): "triangle", (2, 4): "quadrilateral", (3, 4): "tetrahedron", (3, 5): "pyramid", (3, 6): "wedge",
         (3, 8): "hexahedron"}  # fmt: skip



def owners(comm, keys, n_keys, first=0):
    """Return the ranks that own what several ranks have, spread evenly, the same in every run. *Collective.*

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
    first = mesh.starts
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


class Tables(NamedTuple):
    """Contents of a Plex.

    Attributes
    ----------
    points : ndarray (n, d)
        [length]
    cells : dict of str to ndarray (n, k)
        Vertices of the cells of each type, in the order of VTK.
    cell_groups : dict of str to dict of str to ndarray
        Rows of these tables, by group and type.
    lower_groups : dict of str to list of ndarray (n, k)
        Vertices of facets, edges (k = 2) and nodes (k = 1), by group.
    """

    points: np.ndarray
    cells: dict
    cell_groups: dict
    lower_groups: dict


def read_plex(dm):
    """Cells, vertices and labels of a Plex, on rank 0; None elsewhere. *Collective.*

    Groups are called as their labels: "Cell Sets" and "Face Sets" as the groups of a file that have numbers alone
    (``volume_3``, ``surface_7``), a label with one value as the label itself, one with several ``label_value``. Of a
    stratum the points of the highest dimension count.

    Parameters
    ----------
    dm : PETSc.DMPlex
        With faces or without, on any number of ranks; cells of an overlap are left out.

    Returns
    -------
    Tables or None

    Raises
    ------
    InputError
        Coordinates are not one point for each vertex; cells of a type that has no element.
    """
    comm, part = dm.comm.tompi4py(), _Part(dm)
    found = comm.gather(part.error or part.tables())
    error = comm.bcast(next((one for one in found if isinstance(one, str)), None) if found else None)
    if error is not None:
        raise InputError(error)
    return _joined(found) if comm.rank == 0 else None


class _Part:
    """Part that one rank has of a Plex. *Collective.*"""

    def __init__(self, dm):
        self.dm, self.dim, self.error = dm, dm.getDimension(), None
        flat, self.depth = dm.clone(), dm.comm.tompi4py().allreduce(dm.getDepth(), op=MPI.MAX)
        if self.depth > 1:
            flat.uninterpolate()
        (self.c0, self.c1), (self.v0, self.v1) = flat.getHeightStratum(0), flat.getDepthStratum(0)
        self.sizes = np.array([flat.getConeSize(cell) for cell in range(self.c0, self.c1)], dtype=np.int64)
        self.cones = np.array(cones(flat, int(self.sizes.sum())), dtype=np.int64)
        self.offsets = np.cumsum([0, *self.sizes])
        flat.destroy()
        wrong = sorted({int(n) for n in self.sizes if (self.dim, int(n)) not in POLYTOPES})
        if wrong:
            self.error = f"mesh: found cells of a DMPlex with {wrong[0]} vertices in {self.dim} dimensions; allowed: "
            self.error += ", ".join(CELLS_OF.values())
        self._number()
        self._place()

    def _number(self):
        """Numbers of the vertices, and which vertices and cells are owned here."""
        comm, end = self.dm.comm.tompi4py(), self.dm.getChart()[1]
        sf = self.dm.getPointSF()
        try:
            known = sf.getGraph()[0] >= 0
        except ValueError:
            # PETSc's graph has no size before somebody sets one
            known = False
        sf = sf if comm.allreduce(int(known)) == comm.size else None
        mine = np.ones(end, dtype=bool)
        mine[leaves(sf)] = False
        self.own = mine[self.v0 : self.v1]
        n = int(self.own.sum())
        numbers = np.zeros(end, dtype=np.int64)
        numbers[self.v0 : self.v1][self.own] = (comm.exscan(n) or 0) + np.arange(n)
        self.number = told(sf, numbers)
        self.kept = np.flatnonzero(mine[self.c0 : self.c1])

    def _place(self):
        """Coordinates of the vertices."""
        x, width = self.dm.getCoordinatesLocal().getArray(readonly=True), self.dm.getCoordinateDim()
        n = self.v1 - self.v0
        if len(x) != n * width:
            self.error = f"mesh: found a DMPlex with {len(x) // max(width, 1)} points for {n} vertices; allowed: "
            self.error += "coordinates of degree 1, one point for each vertex"
            return
        self.x = x.reshape(n, width)[:, : max(self.dim, 2)].copy()
        section = self.dm.getCoordinateSection()
        order = np.array([section.getOffset(v) for v in range(self.v0, self.v1)], dtype=np.int64) // max(width, 1)
        self.x = self.x[order]

    def vertices(self, cell):
        """Vertices of a cell in the order of VTK, as points."""
        rows = self.cones[self.offsets[cell] : self.offsets[cell + 1]]
        return rows[POLYTOPES[self.dim, len(rows)][1]]

    def tables(self):
        """Points, cells and groups of this rank, by the numbers of the vertices."""
        cells, place = {}, np.full(len(self.sizes), -1, dtype=np.int64)
        for size in np.unique(self.sizes[self.kept]):
            rows = self.kept[self.sizes[self.kept] == size]
            at = self.offsets[rows][:, None] + np.array(POLYTOPES[self.dim, int(size)][1])
            cells[CELLS_OF[self.dim, int(size)]] = self.number[self.cones[at]]
            place[rows] = np.arange(len(rows))
        groups, lower, strata = {}, {}, list(self._strata())
        for name, value, points in strata:
            key = (name, value)
            if FACETS <= value < FACETS + 6 and self.depth == 1:
                lower.setdefault((name, None), []).extend(self._facet(p - self.c0, value - FACETS) for p in points)
            elif self.c0 <= points.min() and points.max() < self.c1:
                own = points[place[points - self.c0] >= 0] - self.c0
                groups[key] = {CELLS_OF[self.dim, int(size)]: place[own[self.sizes[own] == size]]
                               for size in np.unique(self.sizes[own])}  # fmt: skip
            else:
                lower.setdefault(key, []).extend(self._closure(p) for p in points)
        return self.x[self.own], cells, groups, lower, [stratum[:2] for stratum in strata]

    def _strata(self):
        """Name, value and points of the highest dimension of every stratum of every label."""
        for k in range(self.dm.getNumLabels()):
            name = self.dm.getLabelName(k)
            if name in RESERVED:
                continue
            label = self.dm.getLabel(name)
            for value in label.getValueIS().getIndices() if label.getNumValues() else ():
                rows = label.getStratumIS(int(value))
                points = rows.getIndices().astype(np.int64) if rows is not None and rows.handle else np.zeros(0, int)
                for height in range(self.depth + 1):
                    start, end = self.dm.getHeightStratum(height)
                    here = points[(points >= start) & (points < end)]
                    if len(here):
                        yield name, int(value), here
                        break

    def _facet(self, cell, local):
        """Numbers of the vertices of a facet of a cell."""
        nodes = self.vertices(cell)
        kind = CELLS_OF[self.dim, len(nodes)]
        view = next(view for view, rows in facet_kinds(kind) if local in rows)
        return tuple(self.number[nodes[facet_nodes(view, 1)[local]]])

    def _closure(self, point):
        """Numbers of the vertices of a point."""
        points, _ = self.dm.getTransitiveClosure(point)
        return tuple(self.number[[p for p in points if self.v0 <= p < self.v1]])


def is_petsc_file(path):
    """Return whether an HDF5 file is one that PETSc has written of a Plex."""
    try:
        with h5py.File(path, "r") as file:
            return "topology" in file or "topologies" in file
    except OSError:
        return False


def read_petsc_file(path):
    """Read what PETSc's HDF5 viewer has written of a Plex (``-dm_view hdf5:FILE``), on this process alone: a FileMesh.

    Raises
    ------
    InputError
        This PETSc cannot read it.
    """
    try:
        dm = PETSc.DMPlex().createFromFile(str(path), interpolate=False, comm=MPI.COMM_SELF)
    except PETSc.Error as error:
        what = str(error).strip().splitlines()[-1]
        raise InputError(f"{path}: found {what!r}; allowed: a mesh that this PETSc can read") from None
    tables = read_plex(dm)
    dm.destroy()
    return file_of(tables, path)


def file_of(tables, path):
    """The FileMesh of the tables of a Plex; messages name a path."""
    file, dim = FileMesh.of(tables.points), tables.points.shape[1]
    place = {kind: file.add_elements(path, MESHIO_NAMES[kind, 1], dim, nodes) for kind, nodes in tables.cells.items()}
    for name, rows in tables.cell_groups.items():
        for kind, some in rows.items():
            file.add(dim, name, place[kind], some)
    for name, parts in tables.lower_groups.items():
        for nodes in parts:
            kind, below = LOWER[nodes.shape[1]]
            if below:
                file.add(below, name, file.add_elements(path, kind, below, nodes), np.arange(len(nodes)))
            else:
                file.point_groups[name] = nodes[:, 0]
    return file


def _joined(parts):
    """The tables of all ranks as one."""
    points = np.concatenate([part[0] for part in parts])
    kinds = list(dict.fromkeys(kind for part in parts for kind in part[1]))
    cells = {kind: np.concatenate([part[1][kind] for part in parts if kind in part[1]]) for kind in kinds}
    values = {}
    for name, value in (one for part in parts for one in part[4]):
        values.setdefault(name, set()).add(value)
    starts, groups, lower = dict.fromkeys(kinds, 0), {}, {}
    for _, own, chosen, low, _ in parts:
        for key, rows in chosen.items():
            group = groups.setdefault(_named(*key, values, points.shape[1]), {})
            for kind, some in rows.items():
                group.setdefault(kind, []).append(starts[kind] + some)
        for key, rows in low.items():
            lower.setdefault(_named(*key, values, points.shape[1]), []).extend(rows)
        for kind, table in own.items():
            starts[kind] += len(table)
    groups = {name: {kind: np.concatenate(rows) for kind, rows in group.items()} for name, group in groups.items()}
    return Tables(points, cells, groups, {name: _by_width(rows) for name, rows in lower.items()})


def _by_width(rows):
    """Tables of equally many vertices each; of what two ranks have once."""
    once = list({tuple(sorted(row)): row for row in rows}.values())
    return [np.array([row for row in once if len(row) == n]) for n in sorted({len(row) for row in once})]


def _named(name, value, values, dim):
    """The group of a stratum."""
    if name in SETS:
        return f"{DIMENSION_NAMES[dim - SETS[name]]}_{value}"
    if name == "Vertex Sets":
        return f"point_{value}"
    several = {one for one in values[name] if one < FACETS}
    return name if value is None or len(several) <= 1 else f"{name}_{value}"
