"""The cells and vertices of a mesh as a DMPlex, and which rank owns what several ranks have.

The Plex has no faces and no edges: they take 570 bytes a cell, and whoever needs them calls ``dm.interpolate()`` on a
clone. Points 0 to n - 1 are the cells of this rank, all blocks one after the other; the vertices follow, in the order
of the nodes.

Of a DMPlex of the user's, as it is or spread over ranks, each rank has its own cells as a mesh file has them.
"""

import ctypes

import h5py
import numpy as np

from pcontact.element.reference import CELLS, MESHIO_NAMES, facet_kinds, facet_nodes, n_nodes
from pcontact.mesh.raw import DIMENSION_NAMES, LOWER, FileMesh
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import agree
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


def told(sf, values, result=None):
    """Values (n,) or (n, k) of points, where other ranks own them those of their owners; written to the result (m,) or
    (m, k), if leaves are not among the points. *Collective.*"""
    if sf is None:
        return values
    values = np.ascontiguousarray(values)
    result, width = values.copy() if result is None else result, int(np.prod(values.shape[1:], dtype=np.int64))
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


def file_of(dm, path):
    """The cells of a Plex that this rank owns, as a mesh file has them. *Collective.*

    Groups are called as their labels: "Cell Sets" and "Face Sets" as the groups of a file that have numbers alone
    (``volume_3``, ``surface_7``), a label with one value as the label itself, one with several ``label_value``. Of a
    stratum the points of the highest dimension count.

    Parameters
    ----------
    dm : PETSc.DMPlex
        With faces or without, on any number of ranks; cells of an overlap are left out.
    path : pathlib.Path or str
        For messages.

    Returns
    -------
    FileMesh

    Raises
    ------
    InputError
        On every rank: coordinates are not continuous, of degree 1 or 2; cells of a type that has no element.
    """
    reader = _Reader(dm)
    agree(reader.comm, reader.error and f"{path}: {reader.error}")
    return reader.file(path)


class _Reader:
    """Reads what one rank has of a Plex. *Collective.*"""

    def __init__(self, dm):
        self.dm, self.comm, self.dim, self.error = dm, dm.comm.tompi4py(), dm.getDimension(), None
        flat, self.depth = dm.clone(), self.comm.allreduce(dm.getDepth(), op=MPI.MAX)
        if self.depth > 1:
            flat.uninterpolate()
        (self.c0, self.c1), (self.v0, self.v1) = flat.getHeightStratum(0), flat.getDepthStratum(0)
        self.sizes = np.array([flat.getConeSize(cell) for cell in range(self.c0, self.c1)], dtype=np.int64)
        self.cones = np.array(cones(flat, int(self.sizes.sum())), dtype=np.int64)
        self.offsets = np.cumsum([0, *self.sizes])
        flat.destroy()
        wrong = sorted({int(n) for n in self.sizes if (self.dim, int(n)) not in POLYTOPES})
        if wrong:
            self.error = f"found cells of a DMPlex with {wrong[0]} vertices in {self.dim} dimensions; allowed: "
            self.error += ", ".join(CELLS_OF.values())
        self._number()
        self._place()

    def _number(self):
        """Numbers of the vertices, and which points are owned here, and which may be on other ranks."""
        comm, end = self.comm, self.dm.getChart()[1]
        sf = self.dm.getPointSF()
        try:
            known = sf.getGraph()[0] >= 0
        except ValueError:
            # PETSc's graph has no size before somebody sets one
            known = False
        sf = sf if comm.allreduce(int(known)) == comm.size else None
        self.mine, self.shared = np.ones(end, dtype=bool), np.zeros(end, dtype=bool)
        self.mine[leaves(sf)] = False
        if sf is not None:
            self.shared[: len(self.mine)] = ~self.mine | (sf.computeDegree()[:end] > 0)
        own = self.mine[self.v0 : self.v1]
        n = int(own.sum())
        numbers = np.zeros(end, dtype=np.int64)
        numbers[self.v0 : self.v1][own] = (comm.exscan(n) or 0) + np.arange(n)
        self.number = told(sf, numbers)
        self.kept = np.flatnonzero(self.mine[self.c0 : self.c1])

    def _place(self):
        """Coordinates, and the row of each point that has some."""
        section, width, end = self.dm.getCoordinateSection(), self.dm.getCoordinateDim(), self.dm.getChart()[1]
        x, self.row = self.dm.getCoordinatesLocal().getArray(readonly=True), np.full(end, -1, dtype=np.int64)
        for point in range(*section.getChart()):
            if section.getDof(point):
                self.row[point] = section.getOffset(point) // width
        here = self.row >= 0
        if here.sum() * width != len(x) or not here[self.v0 : self.v1].all():
            self.error = f"found a DMPlex with {len(x) // max(width, 1)} points of {self.v1 - self.v0} vertices; "
            self.error += "allowed: continuous coordinates of degree 1 or 2"
        self.x, self.tables = x.reshape(-1, width)[:, : max(self.dim, 2)], {}
        self.degree = 2 if self.comm.allreduce(int(here.sum()) - (self.v1 - self.v0)) else 1
        for size in np.unique(self.sizes[self.kept]) if self.error is None else ():
            rows, (_, order) = self.kept[self.sizes[self.kept] == size], POLYTOPES[self.dim, int(size)]
            nodes = self.cones[self.offsets[rows][:, None] + order]
            self.tables[CELLS_OF[self.dim, int(size)]] = rows, nodes if self.degree == 1 else self._middles(rows, nodes)

    def _middles(self, cells, nodes):
        """Vertices (n, k) of cells of one kind, and the points whose coordinates are in the middle of them: PETSc has
        the points around all cells of a kind in one order."""
        kind, around = CELLS_OF[self.dim, nodes.shape[1]], [self.dm.getTransitiveClosure(self.c0 + c)[0] for c in cells]
        first, place = nodes[0].tolist(), {}
        for k, point in enumerate(around[0]):
            if self.row[point] >= 0:
                place[frozenset(first.index(v) for v in self._closure(point))] = k
        entities = [*CELLS[kind].edges, *CELLS[kind].faces, range(len(first))][: n_nodes(kind, 2) - len(first)]
        columns = [place.get(frozenset(entity)) for entity in entities]
        if None in columns:
            self.error = f"found a DMPlex without coordinates in the middle of an edge, a face or a {kind}; allowed: "
            self.error += "degree 1 or 2 in all directions"
            return nodes
        return np.hstack([nodes, np.array(around)[:, columns]])

    def vertices(self, cell):
        """Vertices of a cell in the order of VTK, as points."""
        rows = self.cones[self.offsets[cell] : self.offsets[cell + 1]]
        return rows[POLYTOPES[self.dim, len(rows)][1]]

    def file(self, path):
        """Points, cells and groups of this rank."""
        tables = [nodes.ravel() for _, nodes in self.tables.values()]
        points = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *tables]))
        vertex = (points >= self.v0) & (points < self.v1)
        used, points = points[vertex], np.concatenate([points[vertex], points[~vertex]])
        self.at = np.full(len(self.row), -1, dtype=np.int64)
        self.at[points] = np.arange(len(points))
        file, place = FileMesh.of(self.x[self.row[points]]), np.full((len(self.sizes), 2), -1, dtype=np.int64)
        file.tags[: len(used)], first = 1 + self.number[used], self.comm.exscan(len(self.kept)) or 0
        file.shared = None if self.comm.size == 1 else self.shared[used]
        for kind, (rows, nodes) in self.tables.items():
            place[rows, 0] = file.add_elements(path, MESHIO_NAMES[kind, self.degree], self.dim, self.at[nodes])
            place[rows, 1] = np.arange(len(rows))
        for table in file.tables:
            table.tags += first
        for name, facets, below, points in self._strata():
            if facets is None and not below:
                own = place[points - self.c0]
                for k in np.unique(own[own[:, 0] >= 0, 0]).tolist():
                    file.add(self.dim, name, k, own[own[:, 0] == k, 1])
                continue
            if facets is not None:
                rows = [self._facet(p - self.c0, facets) for p in points[self.mine[points]]]
            else:
                # of facets between two ranks that of the owner, which has a cell there
                rows = [self._closure(p) for p in (points[self.mine[points]] if below == 1 < self.depth else points)]
            self._add(path, file, name, rows)
            if self.degree == 2 and facets is None and 1 < below == self.depth - 1:
                # edges of a group in space, with their middles
                middles = self.at[points[self.row[points] >= 0]]
                file.point_groups[name] = np.union1d(file.point_groups.get(name, middles), middles[middles >= 0])
        return file

    def _add(self, path, file, name, rows):
        """Add facets, edges and vertices of own cells to a group, by their vertices."""
        rows = [row for row in (self.at[list(row)] for row in rows) if row.min() >= 0]
        for n in sorted({len(row) for row in rows}):
            (kind, below), nodes = LOWER[n], np.array([row for row in rows if len(row) == n])
            if below:
                file.add(below, name, file.add_elements(path, kind, below, nodes), np.arange(len(nodes)))
            else:
                file.point_groups[name] = np.union1d(file.point_groups.get(name, nodes[:0, 0]), nodes[:, 0])

    def _strata(self):
        """Group, facet of the cells or None, height, and points of this rank, of every stratum of every label; the
        height is that of the highest dimension on any rank."""
        own = {}
        for k in range(self.dm.getNumLabels()):
            name = self.dm.getLabelName(k)
            if name in RESERVED:
                continue
            label = self.dm.getLabel(name)
            for value in label.getValueIS().getIndices() if label.getNumValues() else ():
                rows = label.getStratumIS(int(value))
                points = rows.getIndices().astype(np.int64) if rows is not None and rows.handle else np.zeros(0, int)
                own[name, int(value)] = [points[(points >= start) & (points < end)] for start, end in
                                         map(self.dm.getHeightStratum, range(self.depth + 1))]  # fmt: skip
        there = [(key, height) for key, some in own.items() for height, points in enumerate(some) if len(points)]
        heights, values = {}, {}
        for key, height in sorted(set().union(*self.comm.allgather(there))):
            heights.setdefault(key, height)
            values.setdefault(key[0], set()).add(key[1])
        for (name, value), height in heights.items():
            facet = value - FACETS if FACETS <= value < FACETS + 6 and self.depth == 1 else None
            group = _named(name, None if facet is not None else value, values, self.dim)
            yield group, facet, height, own[name, value][height] if (name, value) in own else np.zeros(0, np.int64)

    def _facet(self, cell, local):
        """Vertices of a facet of a cell."""
        nodes = self.vertices(cell)
        view = next(view for view, rows in facet_kinds(CELLS_OF[self.dim, len(nodes)]) if local in rows)
        return nodes[facet_nodes(view, 1)[local]]

    def _closure(self, point):
        """Vertices of a point."""
        return [p for p in self.dm.getTransitiveClosure(point)[0] if self.v0 <= p < self.v1]


def is_petsc_file(path):
    """Return whether an HDF5 file is one that PETSc has written of a Plex."""
    try:
        with h5py.File(path, "r") as file:
            return "topology" in file or "topologies" in file
    except OSError:
        return False


def read_petsc_file(path, comm=MPI.COMM_SELF):
    """Read what PETSc's HDF5 viewer has written of a Plex (``-dm_view hdf5:FILE``): see :func:`file_of`. *Collective.*

    Raises
    ------
    InputError
        This PETSc cannot read it.
    """
    # createFromFile leaves a bad file open, which MPI ends the process for
    viewer, dm = PETSc.ViewerHDF5().create(str(path), "r", comm=comm), PETSc.DMPlex().create(comm=comm)
    with h5py.File(path, "r") as file:
        # later versions look for a mesh by its name
        dm.setName(next(iter(file.get("topologies", [])), "mesh"))
    try:
        dm.load(viewer)
    except PETSc.Error as error:
        what = str(error).strip().splitlines()[-1]
        raise InputError(f"{path}: found {what!r}; allowed: a mesh that this PETSc can read") from None
    finally:
        viewer.destroy()
    file = file_of(dm, path)
    dm.destroy()
    return file


def _named(name, value, values, dim):
    """The group of a stratum."""
    if name in SETS:
        return f"{DIMENSION_NAMES[dim - SETS[name]]}_{value}"
    if name == "Vertex Sets":
        return f"point_{value}"
    several = {one for one in values[name] if one < FACETS}
    return name if value is None or len(several) <= 1 else f"{name}_{value}"
