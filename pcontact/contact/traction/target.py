"""The traction of both sides of a pair, weighted by their stiffness.

At a point X of the source with the partner Y the traction is

    t = w1 t1 - w2 J t2,    t1 = sigma(u)(X) n_X,    t2 = sigma(u)(Y) n_Y,    w1 + w2 = 1,

with the ratio J of the areas of target and source that face each other, both undeformed. With the constants l1, l2 of
the trace inequality of the two cells

    |t|^2 <= (w1^2 l1 + w2^2 J l2) (|t1|^2 / l1 + J |t2|^2 / l2),

and the integral of the last bracket over the source is bounded by the energy of the cells of both sides. So gamma =
gamma0 (w1^2 l1 + w2^2 J l2) makes the method coercive as it does with the traction of one side, and the weights that
make it least are w1 = J l2 / (l1 + J l2): the traction is mostly that of the softer side, which knows it better
(Annavarapu, Hautefeuille, Dolbow 2012). The same holds of tangential tractions with the part of the constants that
these need.

The partner sits where the search finds it: along a direction m from X, areas are as the cosines of their normals with
it, J = (s_X |n_X . m|) / (s_Y |n_Y . m|) with the current over the undeformed areas s of the two facets. Where the
partner is held at an edge, or faces it so much askew that J says little, w1 = 1. A cell whose nodes are all held has no
stress, however stiff it is: the traction is that of the other side.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.contact.search.table import EDGE
from pcontact.contact.surface.sides import at_places, source_surface
from pcontact.contact.traction.small import Traction
from pcontact.contact.unbiased import is_unbiased
from pcontact.element.reference import CELLS, facet_nodes
from pcontact.element.shape import shape as shape_at
from pcontact.runtime.parallel import split_by_rank
from pcontact.runtime.petsc import MPI

# [facet sizes] Gap up to which the partner of a point has a part in the traction. From: chosen, as far as facets get
# their place in the pattern before they close; nothing is asked of most points of most surfaces.
NEAR = 4.0
# [-] Ratio of areas, or its inverse, beyond which the partner has no part in the traction. From: chosen; facets that
# face each other at 75 degrees.
ASKEW = 4.0


class Weighted(NamedTuple):
    """The sides of the points (np) of a source.

    Attributes
    ----------
    rows : ndarray (np, nn, m, d)
        Derivative of t2 by displacements of the nodes of the partners' cells [stress/length].
    own, other : ndarray (np,)
        w1 and -w2 J.
    trace : ndarray (np,)
        w1^2 l1 + w2^2 J l2 [stress/length].
    shear : ndarray (np,) or None
        Part of it that tangential tractions need, where points stick.
    normal : ndarray (np, d)
        n_Y.
    """

    rows: np.ndarray | None
    own: np.ndarray
    other: np.ndarray
    trace: np.ndarray
    shear: np.ndarray | None
    normal: np.ndarray


class TargetTraction:
    """Stress of the cells of a target at partners. The constructor is *Collective*.

    Parameters
    ----------
    space : pcontact.space.space.Space
    bulk : pcontact.assembly.bulk.Bulk
        Has the materials.
    name : str
        Facet group of the target.
    sticks : bool
        Whether tangential tractions need a part of the trace constant only.
    """

    def __init__(self, space, bulk, name, sticks):
        self._space, self._bulk, self._name, self._sticks = space, bulk, name, sticks
        self._groups = space.mesh.facet_groups.get(name, [])
        self._side = source_surface(space, name, bulk.constants, 1, bulk.orthotropic, sticks)
        self._width = space.comm.allreduce(self._side.cells.shape[1], op=MPI.MAX)
        self._stiff = np.where(self._is_rigid(self._side.cells), np.inf, self._side.trace)

    def _is_rigid(self, cells):
        """Which of some cells (n, nn) have no node that is free to move."""
        rigid = self._bulk.rigid
        return np.zeros(len(cells), dtype=bool) if rigid is None else rigid[cells].all(axis=1)

    def _answer(self, asked, nodal, m):
        """What partners say, a list of arrays of n rows: nodes, derivative of the traction; trace constant, its part in
        shear, area vector along the contact normal, radius, normal.

        Parameters
        ----------
        asked : ndarray (n, 2 d)
            Row of the facet on this rank, reference point on it, contact normal.
        nodal : ndarray (n_local, d)
        m : int
            Directions in which tractions count.
        """
        space, side, d, n = self._space, self._side, self._space.dim, len(asked)
        rows, xi, contact = asked[:, 0].astype(np.int64), asked[:, 1:d], np.ascontiguousarray(asked[:, d:])
        x, normal, shape = np.empty((n, d)), np.empty((n, d)), np.zeros((n, side.cells.shape[1]))
        slope, grad = np.zeros((2, *shape.shape, d))
        order, first = np.tile(np.arange(shape.shape[1]), (n, 1)), 0
        for facets in self._groups:
            c = np.flatnonzero((rows >= first) & (rows < first + len(facets.cells)))
            on, local = facet_nodes(facets.cell, space.degree), facets.local[rows[c] - first]
            x[c], normal[c], v, g, strain = self._places(facets, rows[c], first, xi[c])
            nn = v.shape[1]
            shape[c, :nn], slope[c, :nn], grad[c, :nn] = v, g, strain
            own = np.array([[*nodes, *np.setdiff1d(np.arange(nn), nodes)] for nodes in on])
            order[c, :nn] = own[local]
            first += len(facets.cells)
        # its volumetric operator follows from the others
        at = replace(side, facet=rows, x=x, normal=normal, jxw=np.ones(n), shape=shape, grad=grad, slope=None)
        traction = Traction(at).with_linear(space, self._bulk, self._name)
        out = np.empty((*grad.shape[:2], m, d))
        traction.derivative(np.arange(n), np.eye(d)[None] if m == d else contact[:, None], np.ones(n), out)
        faces = np.einsum("pd,pd->p", area_vectors(slope, nodal[side.cells[rows]], normal), contact)
        numbers = np.column_stack([self._stiff[rows], side.shear[rows], faces, x[:, 0], normal])
        # the nodes of the facets are the first ones
        every = np.arange(n)[:, None]
        return [space.nodes[side.cells[rows]][every, order], out[every, order], numbers]

    def _places(self, facets, rows, first, xi):
        """Places, normals, shape functions and gradients of :func:`at_places`, of facets of this rank (n,)."""
        space, side = self._space, self._side
        block = space.mesh.blocks[facets.block]
        table, degree = space.mesh.geometry_nodes(block)
        if not CELLS[block.cell].is_simplex or degree * space.degree > 1:
            x, normal, _, *others = at_places(space, facets, rows - first, xi)
            return x, normal, *others
        # gradients and normals do not change along the facet
        nn = table.shape[1]
        v, on = np.zeros((len(rows), nn)), facet_nodes(facets.cell, 1)[facets.local[rows - first]]
        np.put_along_axis(v, on, shape_at(facets.kind, 1, xi), axis=1)
        x = np.einsum("pa,pai->pi", v, space.mesh.points[table[facets.cells[rows - first]]])
        return x, side.normal[rows], v, side.grad[rows, :nn], side.grad[rows, :nn]

    def _ask(self, place, normal, nodal, m):
        """Answers at places (n, 1 + d), rank, row of the facet there, reference point, with contact normals (n, d):
        the arrays of :meth:`_answer`, with as many columns on all ranks. *Collective.*"""
        d, width, size = self._space.dim, self._width, 2 * self._space.dim
        sends, order = split_by_rank(place[:, 0].astype(np.int64), np.column_stack([place[:, 1:], normal]))
        asked = self._space.exchanger(sends, np.float64, size)
        answers = self._answer(np.concatenate([np.zeros((0, size)), *asked.values()]), nodal, m)
        n, shapes = len(answers[0]), [(width,), (width, m, d), (4 + d,)]
        wide = [np.zeros((n, *shape)) for shape in shapes]
        for whole, part in zip(wide, answers, strict=True):
            whole[:, : part.shape[1]] = part
        wide[0][:, answers[0].shape[1] :] = answers[0][:, :1]
        table = np.concatenate([part.reshape(n, math.prod(part.shape[1:])) for part in wide], axis=1)
        ends = np.cumsum([len(one) for one in asked.values()])
        replies = dict(zip(asked, np.split(table, ends[:-1]), strict=True)) if asked else {}
        back = self._space.exchanger(replies, np.float64, table.shape[1])
        out = np.empty((len(place), table.shape[1]))
        out[order] = np.concatenate([np.zeros((0, table.shape[1])), *(back[r] for r in sorted(sends))])
        parts = np.split(out, np.cumsum([math.prod(shape) for shape in shapes])[:-1], axis=1)
        return [part.reshape(len(place), *shape) for part, shape in zip(parts, shapes, strict=True)]

    def weigh(self, found, source, nodal, law):
        """What the sides of the points of a source say. *Collective.*

        Parameters
        ----------
        found : pcontact.contact.search.partners.Partners
        source : pcontact.contact.surface.sides.SourceSurface
        nodal : ndarray (n_local, d)
            Displacements at which partners were found [length].
        law : pcontact.contact.law.Frictionless
            Says whether tractions count in all directions, or along the contact normal alone.

        Returns
        -------
        found : pcontact.contact.search.partners.Partners
            With the other nodes of the cells behind those of the facets.
        Weighted
        """
        d, near = self._space.dim, found.gap <= (np.inf if law.tied else NEAR * source.size[source.facet])
        rows = np.flatnonzero(found.paired & near)
        answers = self._ask(found.place[rows], found.normal[rows], nodal, d if law.tangential else 1)
        nodes, derivative, numbers = (np.zeros((len(found.paired), *one.shape[1:])) for one in answers)
        for whole, one in zip((nodes, derivative, numbers), answers, strict=True):
            whole[rows] = one
        l2, shear2, area, radius = numbers[:, :4].T
        l1, shear1 = source.trace[source.facet], source.shear[source.facet]
        slope = source.grad if source.slope is None else source.slope
        faces = area_vectors(slope, nodal[source.cells[source.facet]], source.normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(np.einsum("pd,pd->p", faces, found.normal) / area)
            if self._space.axisymmetric:
                ratio *= radius / source.x[:, 0]
            both = found.paired & near & (found.held < EDGE) & (ratio <= ASKEW) & (ratio >= 1.0 / ASKEW)
        alone = ~both | np.isinf(l2)
        ratio, l2 = np.where(both, ratio, 1.0), np.where(alone, 1.0, l2)
        harmonic = np.where(self._is_rigid(source.cells)[source.facet], 0.0, ratio * l2 / (l1 + ratio * l2))
        own = np.where(alone, 1.0, harmonic)
        other = 1.0 - own
        parts = own**2 * l1, other**2 * ratio * l2
        trace = parts[0] + parts[1]
        part = (parts[0] * shear1 + parts[1] * shear2) / trace if self._sticks else None
        nodes = nodes.astype(np.int64)
        # those that are asked nothing have their facets
        rest, width = found.paired & ~near, found.nodes.shape[1]
        nodes[rest, :width], nodes[rest, width:] = found.nodes[rest], found.nodes[rest, :1]
        found = found._replace(nodes=nodes)
        return found, Weighted(derivative, own, -other * ratio, trace, part, numbers[:, 4:].copy())


def area_vectors(slope, values, normal):
    """Current over undeformed area times the current normal (n, d) of facets, from gradients of shape functions
    (n, nn, d), displacements of nodes (n, nn, d), and undeformed normals (n, d)."""
    turn = np.eye(normal.shape[1]) + np.einsum("pai,paj->pij", values, slope)
    if normal.shape[1] == 2:
        # its cofactors
        turn = turn[:, ::-1, ::-1] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    else:
        turn = np.cross(np.roll(turn, -1, axis=1), np.roll(turn, -2, axis=1))
    return np.einsum("pij,pj->pi", turn, normal)


def is_two_sided(space, bulk, contact):
    """Whether the traction of a contact by Nitsche's method is the weighted one of both sides. *Collective.*

    It is, unless the contact says otherwise, for two surfaces of bodies that are elastic, at one temperature and there
    from the beginning; where points of both surfaces look for partners, each side has its own.
    """
    sided = contact.target is not None and contact.target != contact.source and not is_unbiased(contact)
    if not sided or contact.all or contact.traction == "source":
        return False
    groups = [space.mesh.facet_groups.get(name, []) for name in (contact.source, contact.target)]
    numbers = {facets.block for group in groups for facets in group if len(facets.cells)}
    linear = bulk.heat is None and not numbers & (set(bulk.states) | set(bulk.parts) | set(bulk.added))
    return space.comm.allreduce(linear, op=MPI.LAND)


def target_traction(space, bulk, contact):
    """The `TargetTraction` of a contact; None where the traction is that of the source alone. *Collective.*"""
    if not is_two_sided(space, bulk, contact):
        return None
    return TargetTraction(space, bulk, contact.target, contact.alpha is None)
