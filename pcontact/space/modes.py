"""Rigid-body modes of every body: the near-null space, and which of them the supports leave free."""

import numpy as np

from pcontact.mesh.topology import merged
from pcontact.runtime.petsc import MPI, PETSc

# by the dimension, of each turn the directions of its plane: it leads from the first to the second
TURNS = {2: ((0, 1),), 3: ((1, 2), (2, 0), (0, 1))}


def rigid_motions(arms, scale):
    """Displacements (n, d, k) of translations and of turns by 1 / scale, at the ends of arms (n, d): k = 3 or 6."""
    n, d = arms.shape
    turns = np.zeros((n, d, len(TURNS[d])))
    for k, (a, b) in enumerate(TURNS[d]):
        turns[:, a, k], turns[:, b, k] = -arms[:, b], arms[:, a]
    return np.concatenate([np.broadcast_to(np.eye(d), (n, d, d)), turns / scale], axis=2)


def rigid_modes(points, centre, scale):
    """Rigid-body modes at points.

    Parameters
    ----------
    points : ndarray (n, d)
    centre : ndarray (d,) or (n, d)
    scale : float
        Length that makes rotations comparable to translations.

    Returns
    -------
    ndarray (n_modes, n, d)
        Translations, then rotations, those in space about z, x, y: 3 modes in 2D, 6 in 3D.
    """
    modes = rigid_motions(points - centre, scale).transpose(2, 0, 1)
    return np.ascontiguousarray(modes if points.shape[1] == 2 else modes[[0, 1, 2, 5, 3, 4]])


def component_boxes(space):
    """Corners (n_components, d), (n_components, d) of the box around every connected component. *Collective.*"""
    mesh, d = space.mesh, space.dim
    low = np.full((mesh.n_components, d), np.inf)
    high = np.full((mesh.n_components, d), -np.inf)
    np.minimum.at(low, space.component, space.points)
    np.maximum.at(high, space.component, space.points)
    space.comm.Allreduce(MPI.IN_PLACE, low, op=MPI.MIN)
    space.comm.Allreduce(MPI.IN_PLACE, high, op=MPI.MAX)
    return low, high


def component_frames(space):
    """Centre (n_components, d) and size (n_components,) of every connected component. *Collective.*"""
    low, high = component_boxes(space)
    return 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)


def near_pairs(low, high, distance):
    """Pairs (n, 2) of boxes that are no farther apart than a distance.

    Parameters
    ----------
    low, high : ndarray (m, d)
        Corners [length].
    distance : float
        [length]

    Notes
    -----
    Boxes are swept along their first direction: the cost is that of the boxes side by side, not of all pairs.
    """
    order = np.argsort(low[:, 0], kind="stable")
    low, high = low[order], high[order]
    end = np.searchsorted(low[:, 0], high[:, 0] + distance, side="right")
    count = np.maximum(end - np.arange(len(low)) - 1, 0)
    first = np.repeat(np.arange(len(low)), count)
    start = np.cumsum(count) - count
    second = first + 1 + np.arange(len(first)) - start[first]
    apart = np.maximum(low[second] - high[first], low[first] - high[second])
    near = np.all(apart <= distance, axis=1)
    return np.sort(np.column_stack([order[first[near]], order[second[near]]]), axis=1)


def join(space, pairs):
    """From here on, connected components that are tied to each other are one.

    Parameters
    ----------
    space : Space
        Its components and those of its mesh get new numbers and names.
    pairs : ndarray (n, 2)
        The same on all ranks.
    """
    mesh = space.mesh
    n = mesh.n_components
    number = merged(n, pairs)
    names = [dict.fromkeys([]) for _ in range(int(number.max(initial=-1)) + 1)]
    for old, new in enumerate(number):
        names[new].update(dict.fromkeys(mesh.component_names[old].split(" + ")))
    mesh.n_components, mesh.component_names = len(names), [" + ".join(words) for words in names]
    space.component = number[space.component]
    for block in mesh.blocks:
        block.components = number[block.components]


def colour(n_components, edges):
    """Greedy colouring: components that meet in a contact pair get different colours.

    Parameters
    ----------
    n_components : int
    edges : set of (int, int)

    Returns
    -------
    ndarray (n_components,)
    """
    colours = np.zeros(n_components, dtype=np.int64)
    neighbours = [set() for _ in range(n_components)]
    for a, b in edges:
        if a != b:
            neighbours[a].add(b)
            neighbours[b].add(a)
    for k in range(n_components):
        taken = {int(colours[j]) for j in neighbours[k] if j < k}
        colours[k] = next(c for c in range(n_components + 1) if c not in taken)
    return colours


def near_null_space(space, colours, u=None, followers=None):
    """Rigid modes of every body, bodies of one colour sharing vectors. *Collective.*

    Parameters
    ----------
    space : Space
    colours : ndarray (n_components,)
        Bodies that can touch have different colours, so that relative rigid motion across a contact is in the span.
    u : PETSc.Vec, optional
        Displacement, where turns are those of the places that it leads to.
    followers : ndarray (n_owned, d) of bool, optional
        Components that are none of the system's, see :class:`pcontact.space.constraints.RigidGroup`.

    Returns
    -------
    PETSc.NullSpace
        Orthonormal vectors. With axial symmetry those of the plane: smooth, though only one of them costs no energy.
    """
    own = space.owned_local
    component = space.component[own]
    modes = body_modes(space, own, 0.0 if u is None else space.of_owned(u))
    if followers is not None:
        modes *= ~followers
    vectors = []
    for c in range(int(colours.max()) + 1 if len(colours) else 0):
        mask = (colours[component] == c)[:, None]
        for mode in modes:
            vector = space.vector(mode * mask)
            for other in vectors:
                vector.axpy(-vector.dot(other), other)
            norm = vector.norm()
            if norm > 1e-12:
                vector.scale(1.0 / norm)
                vectors.append(vector)
    return PETSc.NullSpace().create(constant=False, vectors=vectors, comm=space.comm)


def body_modes(space, nodes, moved=0.0):
    """Rigid modes (n_modes, n, d) of the plane or of space at local nodes, moved by so much (n, d) [length], each about
    the centre of the node's body; turns in units of its size. *Collective.*

    With axial symmetry only some of them are motions without strain, see :func:`strain_free`.
    """
    centre, scale = component_frames(space)
    component = space.component[nodes]
    modes = rigid_modes(space.points[nodes] + moved, centre[component], 1.0)
    modes[space.dim :] /= np.where(scale > 0, scale, 1.0)[component][None, :, None]
    return modes


def strain_free(space):
    """Those of :func:`body_modes` that strain nothing: with axial symmetry the translation along the axis."""
    return slice(1, 2) if space.axisymmetric else slice(None)


def free_motions(space, supports, springs=()):
    """Rigid motions that supports leave to each component; components without any are left out. *Collective.*

    Parameters
    ----------
    space : Space
    supports : pcontact.space.supports.Supports
    springs : sequence
        What else holds bodies to the ground: has `hold`, see :class:`pcontact.assembly.springs.GroundSprings`.

    Returns
    -------
    dict of int to ndarray (m, n_modes)
        Orthonormal combinations of :func:`body_modes` that are :func:`strain_free`.
    """
    nodes, axes = np.nonzero(supports.fixed)
    modes = body_modes(space, np.arange(space.n_local))
    gram = np.zeros((space.mesh.n_components, len(modes), len(modes)))
    rows = modes[:, nodes, axes].T
    np.add.at(gram, space.component[nodes], rows[:, :, None] * rows[:, None, :])
    for spring in springs:
        gram += spring.hold(modes)
    space.comm.Allreduce(MPI.IN_PLACE, gram, op=MPI.SUM)
    free, some = {}, strain_free(space)
    for k, g in enumerate(gram):
        values, vectors = np.linalg.eigh(g[some, some])
        # what holds other motions, too, says what is a rounding error
        left = values <= 1e-10 * max(np.trace(g), 1e-300)
        if left.any():
            free[k] = vectors[:, left].T
    return free


class RigidBodies:
    """Rigid motions of some bodies, orthonormal in a weighted mean square. *Collective.*

    Parameters
    ----------
    space : Space
    weight : ndarray (n_owned,)
        Weights of the nodes, positive on these bodies.
    motions : dict of int to ndarray (m, n_modes)
        The bodies and what they may do, of :func:`free_motions`.

    Attributes
    ----------
    bodies : list of int
        Connected components.
    fields : ndarray (n_modes, n_owned, d)
        Motion k of each body at its nodes; zero on other bodies, and where a body has fewer motions.
    """

    def __init__(self, space, weight, motions):
        own = space.owned_local
        self.space, self.bodies, self._weight = space, sorted(motions), weight
        modes = body_modes(space, own)[strain_free(space)]
        place = np.full(space.mesh.n_components, -1, dtype=np.int64)
        place[self.bodies] = np.arange(len(self.bodies))
        self._place = place[space.component[own]]
        self.fields = modes * (self._place >= 0)[:, None]
        turned = np.zeros((len(self.bodies), len(modes), len(modes)))
        gram = self._sums(np.einsum("n,ind,jnd->nij", weight, self.fields, self.fields))
        for k, body in enumerate(self.bodies):
            rows = motions[body]
            root = np.linalg.cholesky(rows @ gram[k] @ rows.T)
            turned[k, : len(rows)] = np.linalg.solve(root, rows)
        self.fields = np.einsum("nij,jnd->ind", turned[self._place], self.fields)

    def _sums(self, values):
        """Sums (n_bodies, ...) of values (n_owned, ...) of the nodes. *Collective.*"""
        sums = np.zeros((len(self.bodies), *values.shape[1:]))
        some = self._place >= 0
        np.add.at(sums, self._place[some], values[some])
        return self.space.comm.allreduce(sums, op=MPI.SUM)

    def amounts(self, values):
        """Amounts (n_bodies, n_modes) of the motions nearest to a displacement (n_owned, d). *Collective.*"""
        return self._sums(np.einsum("n,ind,nd->ni", self._weight, self.fields, values))

    def sums_along(self, forces):
        """Sums (n_bodies, n_modes) of forces (n_owned, d) along the motions. *Collective.*"""
        return self._sums(np.einsum("ind,nd->ni", self.fields, forces))

    def field(self, amounts):
        """Displacement (n_owned, d) of amounts of the motions."""
        return np.einsum("ni,ind->nd", amounts[self._place], self.fields)
