"""Points toward which the solution is singular, told by how the estimates around vertices have fallen.

Around a point where the displacement goes like r^a, the squared error of the cells that touch it falls with h^(2 a),
where h is their size; around others with h^(2 p + d). Two meshes, one of them finer there, tell the power. A coarse
mesh knows little of a smooth solution that is steep along a curve, say around a hole: squares fall slowly there, too,
but at one vertex after the other, while points toward which a solution is singular stand alone.
"""

import numpy as np

from pcontact.adapt.cells import of_parts
from pcontact.adapt.sizes import degrees
from pcontact.element.reference import CELLS
from pcontact.mesh.refinement.keys import vertex_keys
from pcontact.mesh.refinement.origin import tree_points
from pcontact.mesh.refinement.refine import Rise
from pcontact.runtime.petsc import MPI

# [-] Sizes of cells of the last mesh over those of now, from which on the power is told. From: chosen; closures alone
# make cells that much smaller.
FINER = 1.5
# [-] Part of the power of smooth solutions below which a point is singular, and the least power. From: the punch, and
# powers of smooth solutions on coarse meshes, which scatter by a fifth.
SINGULAR, LEAST = 0.7, 0.5
# Vertices of one body that are found within a distance, and that distance over the size of cells of the last mesh, with
# which they are no points. From: two edges of right-angled triangles (2.83); on coarse meshes all vertices of a hole.
ROW, WITHIN = 2, 2.85


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
    own, (volume, square) = _summed(space, own)[:, 0], _summed(space, volumes).T
    found, vertex = np.zeros((len(mesh.points), 3)), volume > 0.0
    rows = space.mesh_nodes[vertex]
    found[rows] = np.column_stack([own[vertex], np.sqrt(square[vertex] / volume[vertex]), _marks(mesh)[rows]])
    return found


def _summed(space, values):
    """Values (n_local, 2) of nodes, of all ranks together. *Collective.*"""
    total = space.vector()
    space.local.add(values, total)
    result = space.local.gather(total)
    total.destroy()
    return result


def _marks(mesh):
    """A number (n_nodes,) between 0 and 1 of each node, the same on all meshes of one base."""
    keys = np.empty(len(mesh.points), dtype=np.uint64)
    if mesh.origin is None:
        vertex_keys(mesh.file_nodes, keys)
    else:
        keys[:] = mesh.origin.keys
    return (keys >> np.uint64(11)).astype(float) * 2.0**-53


def singular(space, now, before):
    """The cells that touch a point toward which the solution is singular. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Of triangles.
    now, before : ndarray (n_nodes, 3)
        Of :func:`around_vertices`, on this mesh and on the last one; `before` interpolated.

    Returns
    -------
    power : ndarray (n_cells,)
        With which their squares fall; 2 p + d where there is no such point.
    rise : pcontact.mesh.refinement.refine.Rise
        That makes all squares around the point alike.
    """
    mesh, d, smooth = space.mesh, space.dim, _smooth(space)
    told = (now[:, :2] > 0.0).all(axis=1) & (before[:, :2] > 0.0).all(axis=1) & (now[:, 2] == before[:, 2])
    told[told] = before[told, 1] > FINER * now[told, 1]
    fallen, finer = (before[told, k] / now[told, k] for k in range(2))
    of_node = smooth.copy()
    of_node[told] = np.log(fallen) / np.log(finer)
    some = np.flatnonzero(of_node <= SINGULAR * smooth)
    alone = np.zeros(len(of_node), dtype=bool)
    alone[some] = _alone(space.comm, now[some, 2], _bodies(mesh)[some], tree_points(mesh)[some], before[some, 1])
    of_node = np.where(alone, of_node, smooth)
    vertices = np.concatenate([np.zeros((0, 3), np.int64), *(block.nodes[:, :3] for block in mesh.blocks)])
    corner, rows = (of_node / smooth)[vertices].argmin(axis=1), np.arange(len(vertices))
    corner = vertices[rows, corner]
    own = 2.0 * np.broadcast_to(degrees(space), len(vertices)) + d
    power = np.where(of_node[corner] < smooth[corner], np.maximum(of_node[corner], LEAST), own)
    points = tree_points(mesh)
    point, middle = points[corner], points[vertices].mean(axis=1)
    return power, Rise(d * (1.0 - power / own), point, np.linalg.norm(middle - point, axis=1))


def _bodies(mesh):
    """The first body (n_nodes,) that each node of a mesh belongs to on this rank; nodes of no cell: a large number."""
    bodies = np.full(len(mesh.points), np.iinfo(np.int64).max)
    for block in mesh.blocks:
        bodies[block.nodes] = np.minimum(bodies[block.nodes], block.body)
    return bodies


def _alone(comm, marks, bodies, points, sizes):
    """Whether vertices that have been found are points: not several of them in a row. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    marks : ndarray (n,)
        Of vertices of this rank, which others may have, too; see :func:`around_vertices`.
    bodies : ndarray (n,) of int
    points : ndarray (n, d)
        [length]
    sizes : ndarray (n,)
        Of the cells around them on the last mesh [length].

    Returns
    -------
    ndarray (n,) of bool
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
    """Singular points on the meshes of a loop, one after the other: in the plane; edges in space take too many cells.

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
    """

    def __init__(self, comm):
        self._comm, self._before, self._known, self.explain, self.sought = comm, None, False, False, True

    def look(self, space, squares, alike=True):
        """What is found on a mesh. *Collective.*

        Parameters
        ----------
        space : pcontact.space.space.Space
        squares : ndarray (n_cells,)
            Squared estimates.
        alike : bool
            Whether the last mesh is one of the same bodies.

        Returns
        -------
        power : ndarray (n_cells,) or None
        rise : pcontact.mesh.refinement.refine.Rise or None
            See :func:`singular`; None where nothing is known.
        around : sequence of ndarray (n_nodes, 3)
            For :meth:`take`, to be interpolated.
        """
        if space.dim != 2 or not self.sought:
            return None, None, ()
        around, power, rise, found = around_vertices(space, squares), None, None, False
        if self._before is not None and alike:
            power, rise = singular(space, around, self._before)
            found = self._comm.allreduce(bool((rise.rise > 0.0).any()), op=MPI.LOR)
        self.explain, self._known = found and not self._known, found
        return power, rise, (around,)

    def take(self, around):
        """Take what was known on the last mesh, at the nodes of the next one."""
        self._before = around[0] if around else None
