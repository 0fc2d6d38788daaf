"""Points toward which the solution is singular, told by how the estimates around vertices have fallen.

Around a point where the displacement goes like r^a, the squared error of the cells that touch it falls with h^(2 a),
where h is their size; around others with h^(2 p + d). Two meshes, one of them finer there, tell the power. A coarse
mesh knows little of a smooth solution that is steep along a curve, say around a hole: squares fall slowly there, too,
but at one vertex after the other, while points toward which a solution is singular stand alone.

A contact pressure goes like r^(a - 1) there, and in the plane the square of its error in L2 falls with h^(2 a - 1), the
power of the energy less one. What the smallest cells that there may be leave of it is told ahead.

In space it is edges that are looked for, see `pcontact.adapt.edges`.
"""

from typing import NamedTuple

import numpy as np

from pcontact.adapt import edges
from pcontact.adapt.mark import degrees, of_parts
from pcontact.element.reference import CELLS
from pcontact.mesh.refinement.numbering import marks, tree_points
from pcontact.mesh.refinement.refine import Rise
from pcontact.mesh.refinement.simplices import WISHED
from pcontact.runtime.petsc import MPI

# [-] Part of the power of smooth solutions below which a point is singular, and the least power. From: the punch, and
# powers of smooth solutions on coarse meshes, which scatter by a fifth.
SINGULAR, LEAST = 0.7, 0.5
# Vertices of one body that are found within a distance, and that distance over the size of cells of the last mesh, with
# which they are no points. From: two edges of right-angled triangles (2.83); on coarse meshes all vertices of a hole.
ROW, WITHIN = 2, 2.85
# [-] Power of the energy around points below which a pressure is singular there. From: it is 2 where the pressure goes
# like log r, as at kinks, and 3 at edges of contacts, which need not be at a vertex.
BOUNDED = 1.9
# [-] Sizes of cells of the last mesh over those of now, from which on the power is known well. From: punches whose
# powers are 1 and 1.54 had 0.9 to 1.3 and 1.2 to 1.5 with sizes over each other of 3 to 6, kinks and edges 1.5 to 3;
# 1.00 and 1.52 to 1.58 with 1,000 and more.
SURE = 16.0
# [-] The least power of the square of a pressure's error. From: smaller ones leave much of it on any mesh.
LEAST_OF_PRESSURE = 0.1


class PressureError(NamedTuple):
    """Parts of the cells in the error of a contact pressure.

    Attributes
    ----------
    squares : ndarray (n_cells,)
        Of the error in L2, relative.
    touched : ndarray (n_nodes,) of bool
        Nodes of the mesh that are on the contact.
    ends : ndarray (n_nodes,) of bool
        Those at which one of its surfaces ends or turns: elsewhere no pressure is singular, but for kinks and edges of
        what is closed.
    """

    squares: np.ndarray
    touched: np.ndarray
    ends: np.ndarray

    @classmethod
    def of(cls, space, squares, groups):
        """With the facet groups of a contact in the plane. *Collective.*"""
        own = [space.facet_nodes(facets) for name in groups for facets in space.mesh.facet_groups.get(name, [])]
        normals, counts = np.zeros((2, space.n_local, 2))
        for nodes in own:
            along = space.points[nodes[:, 1]] - space.points[nodes[:, 0]]
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            for vertex in nodes[:, :2].T:
                np.add.at(normals, vertex, np.column_stack([along[:, 1], -along[:, 0]]))
                np.add.at(counts[:, 0], vertex, 1.0)
        normals, counts = space.together(normals), space.together(counts)[:, 0]
        # the mean of two normals is as long as the cosine of half of the angle between them
        turned = np.linalg.norm(normals, axis=1) < np.sqrt(0.5 + 0.5 * edges.TURN) * counts
        ends = (counts == 1.0) | ((counts > 0.0) & turned)
        of_mesh = np.zeros((2, len(space.mesh.points)), dtype=bool)
        on = space.flag(np.unique(np.concatenate([np.zeros(0, np.int64), *(nodes.ravel() for nodes in own)])))
        for some, found in zip(of_mesh, (on, ends), strict=True):
            some[space.mesh_nodes[found]] = True
        return cls(squares, *of_mesh)


class Wall(NamedTuple):
    """A point toward which a pressure is singular.

    Attributes
    ----------
    point : tuple of float
        [length]
    power : float
        Of the distance to it, that the pressure goes with.
    left : float
        Of the error of the pressure in L2, relative, with the smallest cells that there may be.
    """

    point: tuple
    power: float
    left: float


def around_vertices(space, squares):
    """Squared estimates of the triangles around the vertices of a mesh in the plane, and their size; those of the
    triangles that quadrilaterals would be divided into. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    squares : ndarray (n_cells,)

    Returns
    -------
    ndarray (n_nodes, 3)
        Of all nodes of the mesh of this rank: sums of squares, a length that goes with the size of the largest cells, a
        mark of the node that no interpolation gives; zeros where the node is no vertex.
    """
    mesh = space.mesh
    own, volumes = np.zeros((space.n_local, 2)), np.zeros((space.n_local, 2))
    first = 0
    for number, block in enumerate(mesh.blocks):
        some, corners = squares[first : first + len(block.nodes)], CELLS[block.cell].n_vertices
        first += len(block.nodes)
        x, times = mesh.points[block.nodes[:, :corners]], 1.0
        if corners == 3:
            one, other = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
        else:
            # two triangles, of which a vertex has three in two cells
            one, other = 0.5 * (x[:, 2] - x[:, 0]), x[:, 3] - x[:, 1]
            some, times = of_parts(some, 2, 2, space.degree), 1.5
        volume = np.abs(np.linalg.det(np.stack([one, other], axis=1)))
        for corner in space.cells[number][:, :corners].T:
            np.add.at(own[:, 0], corner, times * some)
            np.add.at(volumes, corner, times * np.column_stack([volume, volume**2]))
    own, (volume, square) = space.together(own)[:, 0], space.together(volumes).T
    found, vertex = np.zeros((len(mesh.points), 3)), volume > 0.0
    rows = space.mesh_nodes[vertex]
    found[rows] = np.column_stack([own[vertex], np.sqrt(square[vertex] / volume[vertex]), marks(mesh)[rows]])
    return found


def powers(space, now, before, pressure=None):
    """Power (n_nodes,) with which the squares around the nodes of a mesh of triangles have fallen, that of smooth
    solutions where there is no singular point, and sizes of cells of the last mesh over those of now, 1 where nothing
    is told. *Collective.*

    `now` and `before` (n_nodes, 3) are those of :func:`around_vertices`, on this mesh and, interpolated, on the last
    one.
    """
    mesh, smooth = space.mesh, _smooth(space)
    told = (now[:, :2] > 0.0).all(axis=1) & (before[:, :2] > 0.0).all(axis=1) & (now[:, 2] == before[:, 2])
    told[told] = before[told, 1] > edges.FINER * now[told, 1]
    power, finer = smooth.copy(), np.ones(len(smooth))
    fallen, finer[told] = (before[told, k] / now[told, k] for k in range(2))
    power[told] = np.log(fallen) / np.log(finer[told])
    some = power <= SINGULAR * smooth
    if pressure is not None:
        some &= ~pressure.touched | (pressure.ends & (power < BOUNDED))
    some, alone = np.flatnonzero(some), np.zeros(len(smooth), dtype=bool)
    alone[some] = _alone(space.comm, now[some, 2], _bodies(mesh)[some], tree_points(mesh)[some], before[some, 1])
    return np.where(alone, power, smooth), finer


def singular(space, of_node, of_pressure=None):
    """The cells that touch a point toward which the solution is singular: the power (n_cells,) with which their squares
    fall, 2 p + d where there is no such point, and the rise that makes all squares around the point alike.

    `of_node` is that of :func:`powers`, `of_pressure` that of :func:`powers_of_pressure`.
    """
    mesh, d, smooth = space.mesh, space.dim, _smooth(space)
    falls = np.maximum(of_node, LEAST)
    falls = falls if of_pressure is None else np.fmin(falls, of_pressure)
    vertices = edges.vertices_of(mesh)
    corner, rows = (of_node / smooth)[vertices].argmin(axis=1), np.arange(len(vertices))
    corner = vertices[rows, corner]
    own = 2.0 * np.broadcast_to(degrees(space), len(vertices)) + d
    power = np.where(of_node[corner] < smooth[corner], falls[corner], own)
    points = tree_points(mesh)
    point, middle = points[corner], points[vertices].mean(axis=1)
    distance = np.linalg.norm(middle - point, axis=1)
    return power, Rise(d * (1.0 - power / own), point, np.zeros_like(point), distance, np.full(len(power), np.inf))


def powers_of_pressure(space, pressure, of_node, finer, sizes):
    """With which the squared errors of a pressure fall around nodes (n_nodes,) of singular points that are known well,
    nan elsewhere: those of both bodies at one point have one, so that their cells become smaller alike. Cells that are
    smaller than those on the other body toward a point that is none make the pressure wrong. `of_node` and `finer` are
    those of :func:`powers`, `sizes` those of the cells around nodes. *Collective.*"""
    some = np.flatnonzero(pressure.touched & (of_node < _smooth(space)))
    points = tree_points(space.mesh)[some]
    own = np.column_stack([of_node[some], finer[some] >= SURE, points])
    every, power = np.concatenate(space.comm.allgather(own)), np.full(len(of_node), np.nan)
    for node, point in zip(some, points, strict=True):
        here = every[np.linalg.norm(every[:, 2:] - point, axis=1) <= 0.5 * sizes[node]]
        if here[:, 1].any():
            power[node] = max(here[:, 0].min() - 1.0, LEAST_OF_PRESSURE)
    return power


def wall(space, pressure, of_node, finer):
    """The point toward which a pressure is most singular, of those that are known well, with the results of
    :func:`powers`: a :class:`Wall` or None. *Collective.*"""
    mesh, d, found = space.mesh, space.dim, None
    square = around_vertices(space, pressure.squares)[:, 0]
    level = np.zeros(len(mesh.points), dtype=np.int64)
    if mesh.origin is not None:
        vertices = edges.vertices_of(mesh)
        np.maximum.at(level, vertices, mesh.origin.level[:, None])
    known = pressure.touched & (of_node < _smooth(space)) & (finer >= SURE)
    power = np.maximum(of_node - 1.0, 0.0)
    left = np.sqrt(square) * 2.0 ** (-0.5 * power * np.maximum(WISHED - level, 0) / d)
    if known.any():
        node = int(np.where(known, -of_node, -np.inf).argmax())
        found = Wall(tuple(tree_points(mesh)[node].tolist()), 0.5 * float(of_node[node]) - 1.0, float(left[node]))
    every = [one for one in space.comm.allgather(found) if one is not None]
    return min(every, key=lambda one: one.power, default=None)


def _bodies(mesh):
    """The first body (n_nodes,) that each node of a mesh belongs to on this rank; nodes of no cell: a large number."""
    bodies = np.full(len(mesh.points), np.iinfo(np.int64).max)
    for block in mesh.blocks:
        bodies[block.nodes] = np.minimum(bodies[block.nodes], block.body)
    return bodies


def _alone(comm, marks, bodies, points, sizes):
    """Return True if vertices that have been found are points: not several of them in a row. *Collective.*

    Their marks, bodies, places and sizes of cells on the last mesh; other ranks may have the same vertices.
    """
    own = np.column_stack([marks, bodies, sizes, points])
    found = np.concatenate(comm.allgather(own))
    found = found[np.lexsort((found[:, 1], found[:, 0]))]
    found = found[np.concatenate([[True], found[1:, 0] != found[:-1, 0]])] if len(found) else found
    alone = np.zeros(len(own), dtype=bool)
    for k, (mark, x) in enumerate(zip(marks, points, strict=True)):
        _, body, size = found[np.searchsorted(found[:, 0], mark), :3]
        near = np.linalg.norm(found[:, 3:] - x, axis=1) <= WITHIN * size
        alone[k] = np.count_nonzero(near & (found[:, 1] == body)) - 1 < ROW
    return alone


def _smooth(space):
    """Power (n_nodes,) with which squares around the nodes of a mesh fall where the solution is smooth: that of the
    lowest degree around them."""
    power = np.full(len(space.mesh.points), 2.0 * space.degree + space.dim)
    for block in space.mesh.blocks:
        if space.degree_of(block) < space.degree:
            power[block.nodes] = 2.0 * space.degree_of(block) + space.dim
    return power


class Corners:
    """Singular points on the meshes of a loop, one after the other, in the plane, and singular edges in space.

    Parameters
    ----------
    comm : MPI.Comm

    Attributes
    ----------
    sought : bool
        Whether there may be any: where bodies yield, cells have their largest estimates at other times, and squares
        fall less than those of smooth solutions wherever the edge of a contact or of a plastic zone has passed.
    explain : bool
        Whether they have been found on the last mesh, and were not known before: that the error has fallen less than
        was expected says nothing of the next mesh then.
    edges : pcontact.adapt.edges.Edges or None
        Those of the last mesh, in space.
    wall : Wall or None
        What the last mesh has told of a pressure that no mesh reaches.
    """

    def __init__(self, comm):
        self._comm, self._before, self._known, self.explain, self.sought = comm, None, False, False, True
        self.wall, self.edges = None, None

    def look(self, space, squares, alike=True, pressure=None):
        """Findings on a mesh from squared estimates: power and rise of :func:`singular`, None where nothing is known,
        and what :meth:`take` is to have, interpolated. *Collective.*

        `alike`: whether the last mesh is one of the same bodies; `pressure`: a :class:`PressureError` in the plane, a
        :class:`pcontact.adapt.edges.Front` in space, where it is the error of one that counts.
        """
        if space.dim == 3:
            return self._look_in_space(space, squares, alike, pressure)
        if not self.sought:
            return None, None, ()
        around, power, rise, found = around_vertices(space, squares), None, None, False
        if self._before is not None and alike:
            of_node, finer = powers(space, around, self._before, pressure)
            falls = None if pressure is None else powers_of_pressure(space, pressure, of_node, finer, around[:, 1])
            power, rise = singular(space, of_node, falls)
            self.wall = None if pressure is None else wall(space, pressure, of_node, finer)
            found = self._comm.allreduce(bool((rise.rise > 0.0).any()), op=MPI.LOR)
        self.explain, self._known = found and not self._known, found
        return power, rise, (around,)

    def _look_in_space(self, space, squares, alike, front):
        """The same in space. *Collective.*"""
        self.edges = None
        if not self.sought or not edges.of_tetrahedra(space):
            return None, None, ()
        smooth = np.broadcast_to(2.0 * degrees(space) + space.dim, (len(squares),))
        if front is not None:
            self.edges = edges.look_at_front(space, front, smooth)
            return (None, None, ()) if self.edges is None else (self.edges.power, self.edges.rise, ())
        before = self._before if alike else None
        self.edges, around, most = edges.look(space, squares, before, smooth)
        found = self.edges is not None
        self.explain, self._known = most and not self._known, found
        return (self.edges.power, self.edges.rise, (around,)) if found else (None, None, (around,))

    def take(self, around):
        """Take what was known on the last mesh, at the nodes of the next one."""
        self._before = around[0] if around else None
