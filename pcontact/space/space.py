"""The displacement: which nodes carry it, their global numbers (those of a PetscSection on a DMPlex), vectors of it.
"""

from functools import cached_property

import numpy as np

from pcontact.element.reference import CELLS, facet_nodes, n_nodes
from pcontact.mesh.plex import leaves, owners, told
from pcontact.runtime.parallel import Exchanger, NodeExchange
from pcontact.runtime.petsc import MPI, PETSc, set_section

# [bytes] That a rank keeps at most. From: of a cell that yields, in space and of degree 2, 1.2 kB are kept, a tenth of
# what its rows of the tangent take; so meshes of half a million unknowns are kept.
ROOM = 2**27
# a node is on the axis of symmetry if its radius is below this part of the largest
AXIS = 1e-9


class Kept:
    """Arrays by keys.

    Parameters
    ----------
    room : int
        [bytes]
    at_once : bool
        Whether what is made will be asked for again.

    Attributes
    ----------
    room : int
        That is left.
    """

    def __init__(self, room=ROOM, at_once=False):
        self.room, self._made, self._asked, self._at_once = room, {}, set(), at_once

    def get(self, key):
        """Return what is kept under a key, or None."""
        return self._made.get(key)

    def __call__(self, key, make):
        """Return what ``make()`` gives, a tuple of arrays and of what is no array. It is kept when it is asked for
        again, or at once, and made anew where there is no room for it."""
        found = self._made.get(key)
        if found is not None:
            return found
        found, again = make(), self._at_once or key in self._asked
        self._asked.add(key)
        return self.keep(key, found) if again else found

    def keep(self, key, found):
        """Keep a tuple under a key, where there is room; returns it."""
        size = sum(part.nbytes for part in found if isinstance(part, np.ndarray))
        if size <= self.room:
            self._made[key], self.room = found, self.room - size
        return found


class Numbering:
    """Global numbers of the nodes of one rank. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    n : int
        Nodes of this rank, in the order wanted for owned nodes.
    sf : PETSc.SF or None
        From points to their owners, see :func:`pcontact.mesh.plex.owners`.

    Attributes
    ----------
    numbers : ndarray (n,)
        Global number of each node.
    n_owned, start, n_total : int
    ranges : ndarray (size + 1,)
    """

    def __init__(self, comm, n, sf):
        self.rank = comm.rank
        mine = np.ones(n, dtype=bool)
        mine[leaves(sf)] = False
        self.n_owned = int(mine.sum())
        counts = np.array(comm.allgather(self.n_owned), dtype=np.int64)
        self.ranges = np.concatenate([[0], np.cumsum(counts)])
        self.start, self.n_total = int(self.ranges[comm.rank]), int(self.ranges[-1])
        numbers = np.zeros(n, dtype=np.int64)
        numbers[mine] = self.start + np.arange(self.n_owned)
        self.numbers = told(sf, numbers)

    def owner(self, numbers):
        """Rank that owns each global number."""
        return np.searchsorted(self.ranges, numbers, side="right") - 1

    def places(self, numbers):
        """Nodes of which each of some global numbers (n,) is one, those of this rank first, and its place (n,) in
        them."""
        place = numbers - self.start
        away = np.flatnonzero((place < 0) | (place >= self.n_owned))
        others, number = np.unique(numbers[away], return_inverse=True)
        place[away] = self.n_owned + number
        return np.concatenate([self.start + np.arange(self.n_owned), others]), place


class Space:
    """Continuous Lagrange displacement of degree 1 or 2 on the mesh of one rank.

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    degree : int
        At most the degree of the mesh's node layout.
    kinematics : {"plane_strain", "plane_stress", "axisymmetric"}
        How a plane mesh stands for a body; a mesh in space has nothing but the default. With axial symmetry x is the
        radius, y the axis, and all integrals go around the whole circumference.
    averaged : sequence of int
        Bodies whose cells other than triangles and tetrahedra take their mean dilatation.
    averaged_simplices : sequence of int
        Bodies whose triangles and tetrahedra do; with degree 2.
    reduced : sequence of int
        Bodies whose serendipity cells have reduced integration, see `pcontact.element.quadrature`.
    lower : sequence of int
        Bodies whose displacement is of degree 1, where the others have degree 2: equations see to that.

    Attributes
    ----------
    axisymmetric : bool
    cells : list of ndarray (n_cells, n_nodes)
        For each block of the mesh, local space nodes.
    mesh_nodes : ndarray (n_local,)
        Mesh node of every space node; ``of_mesh`` is the inverse (-1 where there is none).
    points : ndarray (n_local, d)
    component : ndarray (n_local,)
        Connected component of each node.
    numbering : Numbering
    nodes : ndarray (n_local,)
        Global node numbers.
    kept : pcontact.space.space.Kept
        What others have made of the mesh, and use again.

    Notes
    -----
    The constructor is *Collective*. Degrees of freedom are interlaced: dof = d * node + direction.
    """

    def __init__(
        self, mesh, degree, kinematics="plane_strain", averaged=(), averaged_simplices=(), reduced=(), lower=()
    ):
        self.kinematics, self.axisymmetric = kinematics, kinematics == "axisymmetric"
        self._averaged = {False: frozenset(averaged), True: frozenset(averaged_simplices)}
        self._reduced, self.lower = frozenset(reduced), frozenset(lower)
        self.mesh, self.comm, self.dim, self.degree = mesh, mesh.comm, mesh.dim, degree
        self.exchanger = Exchanger(mesh.comm)
        tables = [b.nodes[:, : n_nodes(b.cell, degree)] for b in mesh.blocks]
        used = np.zeros(len(mesh.points), dtype=bool)
        for table in tables:
            used[table.ravel()] = True
        self.mesh_nodes = np.flatnonzero(used)
        self.of_mesh = np.full(len(mesh.points), -1, dtype=np.int64)
        self.of_mesh[self.mesh_nodes] = np.arange(len(self.mesh_nodes))
        # where every node of the mesh carries a displacement, the tables are those of the mesh: no copies
        self.cells = [np.ascontiguousarray(t if used.all() else self.of_mesh[t]) for t in tables]
        self.points = mesh.points[self.mesh_nodes]
        self.component = np.zeros(len(self.mesh_nodes), dtype=np.int64)
        for table, block in zip(self.cells, mesh.blocks, strict=True):
            self.component[table] = block.components[:, None]
        # of degree 1 the nodes are the vertices of the mesh's Plex, of which PETSc numbers a section the same way
        sf = owners(mesh.comm, mesh.file_nodes[self.mesh_nodes], mesh.n_nodes_total)
        self.numbering = Numbering(mesh.comm, len(self.mesh_nodes), sf)
        self.nodes = self.numbering.numbers
        self.n_owned, self.start = self.numbering.n_owned, self.numbering.start
        owned = self.owns(slice(None))
        self.owned_local = np.flatnonzero(owned)[np.argsort(self.nodes[owned])]
        self._template, self.kept = self.vector(), Kept()
        self.local = self.exchange(self.nodes)

    @property
    def keys(self):
        """Numbers (n_owned,) of the owned nodes in the mesh file: they do not depend on the ranks."""
        return self.mesh.file_nodes[self.mesh_nodes[self.owned_local]]

    @property
    def n_local(self):
        """Number of nodes of this rank's cells."""
        return len(self.mesh_nodes)

    @property
    def n_dofs(self):
        """Unknowns of the whole problem, prescribed ones included."""
        return self.numbering.n_total * self.dim

    def averages(self, block):
        """Return whether the cells of a block take their mean dilatation."""
        return block.body in self._averaged[CELLS[block.cell].is_simplex]

    def reduces(self, block):
        """Return whether the cells of a block have reduced integration."""
        return block.body in self._reduced and CELLS[block.cell].complete is not None and CELLS[block.cell].is_tensor

    def degree_of(self, block):
        """Degree of the displacement of the cells of a block."""
        return 1 if block.body in self.lower else self.degree

    def circumference(self, points):
        """Length 2 pi r of the circles through points (..., d) with axial symmetry, 1 otherwise."""
        return 2.0 * np.pi * points[..., 0] if self.axisymmetric else 1.0

    def on_axis(self):
        """Flags (n_local,) of the nodes on the axis of symmetry; none without one. *Collective.*"""
        if not self.axisymmetric:
            return np.zeros(self.n_local, dtype=bool)
        radius = self.points[:, 0]
        largest = self.comm.allreduce(float(np.max(radius, initial=0.0)), op=MPI.MAX)
        return radius <= AXIS * largest

    @cached_property
    def dm(self):
        """PETSc.DMPlex : the mesh's with the displacement of degree 1 as its section: vectors and matrices that it
        makes have the numbers of this space. *Collective* when it is asked for first."""
        if self.degree > 1:
            raise ValueError("found a displacement of degree 2; allowed: degree 1, whose nodes are points of the Plex")
        dm, section = self.mesh.dm.clone(), self.mesh.dm.getCoordinateSection().clone()
        section.setFieldName(0, "displacement")
        set_section(dm, section)
        return dm

    def vector(self, values=None):
        """A distributed vector of zeros, or of values (n_owned, d) of owned nodes, block size d. *Collective.*"""
        d = self.dim
        vector = PETSc.Vec().create(comm=self.comm)
        vector.setSizes((self.n_owned * d, self.numbering.n_total * d), bsize=d)
        vector.setType("mpi" if self.comm.size > 1 else "seq")
        vector.set(0.0)
        if values is not None:
            vector.setArray(np.ravel(values))
        return vector

    def of_owned(self, vector):
        """Values (n_owned, d) that a vector has at the owned nodes, which are not to be written to."""
        return vector.getArray(readonly=True).reshape(-1, self.dim)

    def longest(self, values):
        """Length of the longest of the vectors (n_owned, d) of all owned nodes; no axis counts more. *Collective.*"""
        own = np.max(np.linalg.norm(values, axis=1), initial=0.0)
        return self.comm.allreduce(float(own), op=MPI.MAX)

    def norms(self, values):
        """Norms (n_components,) of vectors (n_owned, d) of all owned nodes of every component. *Collective.*"""
        return np.sqrt(self.by_component(np.sum(values**2, axis=1)))

    def by_component(self, values=None):
        """Sums (n_components,) of values (n_owned,) of all owned nodes, or how many nodes there are. *Collective.*"""
        own = np.bincount(self.component[self.owned_local], values, minlength=self.mesh.n_components)
        return self.comm.allreduce(own, op=MPI.SUM)

    def exchange(self, nodes):
        """Plan for the values of any global nodes. *Collective.*"""
        return NodeExchange(self._template, nodes, self.dim)

    def summed(self, plan, values):
        """Values (n, d) of the nodes of a plan, of all ranks, summed at the owned nodes (n_owned, d). *Collective.*"""
        total = self.vector()
        plan.add(values, total)
        result = self.of_owned(total).copy()
        # let go of alone, it would stay until the end of the load step
        total.destroy()
        return result

    def together(self, values):
        """Values (n_local, d) of nodes, those of all ranks summed, at all nodes of this rank. *Collective.*"""
        total = self.vector()
        self.local.add(values, total)
        result = self.local.gather(total)
        total.destroy()
        return result

    def at_nodes(self, values, plan=None):
        """Values (n_owned, d) of owned nodes, at all nodes of this rank (n_local, d), or at those (n, d) of a plan.
        *Collective.*"""
        vector = self.vector(values)
        result = (self.local if plan is None else plan).gather(vector)
        vector.destroy()
        return result

    def flag(self, local_nodes):
        """Flags (n_local,) of nodes that any rank names, so that shared nodes agree. *Collective.*

        Parameters
        ----------
        local_nodes : ndarray
            Local space nodes that this rank knows to be meant.
        """
        values = np.zeros((self.n_local, self.dim))
        values[local_nodes, 0] = 1.0
        return self.together(values)[:, 0] > 0.5

    def owns(self, nodes):
        """Flags (n,) of local nodes that this rank owns."""
        return (self.nodes[nodes] >= self.start) & (self.nodes[nodes] < self.start + self.n_owned)

    def region(self, name):
        """Local space nodes of a region of facets, edges, vertices or cells, sorted. *Collective.*"""
        nodes = self.of_mesh[self.mesh.region_nodes(name)]
        return np.flatnonzero(self.flag(nodes[nodes >= 0]))

    def facet_nodes(self, facets):
        """Local space nodes (n, n_facet_nodes) of facets, outward order."""
        table = facet_nodes(facets.cell, self.degree)
        return self.cells[facets.block][facets.cells[:, None], table[facets.local]]


def carried(space, keys, values):
    """Values at the owned nodes of a space. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    keys : ndarray (n,)
        Numbers of nodes of the mesh file, each on one rank.
    values : ndarray (n, k)
        At these nodes.

    Returns
    -------
    ndarray (n_owned, k)
        Zero at nodes of which no rank has a value.
    """
    size, total = space.comm.size, max(space.mesh.n_nodes_total, 1)
    own = space.keys
    bits = np.ascontiguousarray(values, dtype=np.float64).view(np.int64)
    known, found = space.exchanger.look_up((keys * size // total, keys), bits, (own * size // total, own))
    return np.where(known[:, None], np.ascontiguousarray(found).view(np.float64), 0.0)
