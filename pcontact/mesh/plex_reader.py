"""A DMPlex of the user's, as it is or spread over ranks, as tables of a mesh on rank 0."""

from typing import NamedTuple

import h5py
import numpy as np

from pcontact.element.reference import MESHIO_NAMES, facet_kinds, facet_nodes
from pcontact.mesh.plex import FACETS, POLYTOPES, RESERVED, cones, leaves, told
from pcontact.mesh.raw import DIMENSION_NAMES, FileMesh
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, PETSc

# labels whose values are the numbers of groups, and the dimension of these, below that of the mesh
SETS = {"Cell Sets": 0, "Face Sets": 1, "Edge Sets": 2}
# cells by dimension and vertices
CELLS = {(2, 3): "triangle", (2, 4): "quadrilateral", (3, 4): "tetrahedron", (3, 5): "pyramid", (3, 6): "wedge",
         (3, 8): "hexahedron"}  # fmt: skip

# the same as meshio calls them; facets, edges and nodes by the number of their vertices, with their dimension
LOWER = {1: ("vertex", 0), 2: ("line", 1), 3: ("triangle", 2), 4: ("quad", 2)}


class Tables(NamedTuple):
    """What a Plex holds.

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
    """What one rank has of a Plex. *Collective.*"""

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
            self.error += ", ".join(CELLS.values())
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
            cells[CELLS[self.dim, int(size)]] = self.number[self.cones[at]]
            place[rows] = np.arange(len(rows))
        groups, lower, strata = {}, {}, list(self._strata())
        for name, value, points in strata:
            key = (name, value)
            if FACETS <= value < FACETS + 6 and self.depth == 1:
                lower.setdefault((name, None), []).extend(self._facet(p - self.c0, value - FACETS) for p in points)
            elif self.c0 <= points.min() and points.max() < self.c1:
                own = points[place[points - self.c0] >= 0] - self.c0
                groups[key] = {CELLS[self.dim, int(size)]: place[own[self.sizes[own] == size]]
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
        kind = CELLS[self.dim, len(nodes)]
        view = next(view for view, rows in facet_kinds(kind) if local in rows)
        return tuple(self.number[nodes[facet_nodes(view, 1)[local]]])

    def _closure(self, point):
        """Numbers of the vertices of a point."""
        points, _ = self.dm.getTransitiveClosure(point)
        return tuple(self.number[[p for p in points if self.v0 <= p < self.v1]])


def is_petsc_file(path):
    """Whether an HDF5 file is one that PETSc has written of a Plex."""
    try:
        with h5py.File(path, "r") as file:
            return "topology" in file or "topologies" in file
    except OSError:
        return False


def read_petsc_file(path):
    """What PETSc's HDF5 viewer has written of a Plex (``-dm_view hdf5:FILE``), on this process alone: a FileMesh.

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
