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
partner is held at an edge, or faces it so much askew that J says little, w1 = 1.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.contact.search.table import EDGE
from pcontact.contact.surface.sides import at_places, source_surface
from pcontact.contact.traction.small import FacetCells
from pcontact.contact.unbiased import is_unbiased
from pcontact.element.reference import facet_nodes
from pcontact.runtime.parallel import split_by_rank
from pcontact.runtime.petsc import MPI

# [-] Ratio of areas, or its inverse, beyond which the partner has no part in the traction. From: chosen; facets that
# face each other at 75 degrees.
ASKEW = 4.0


class Weighted(NamedTuple):
    """The sides of the points (np) of a source.

    Attributes
    ----------
    cells : pcontact.contact.traction.small.FacetCells
        Of the partners.
    own, other : ndarray (np,)
        w1 and -w2 J.
    trace : ndarray (np,)
        w1^2 l1 + w2^2 J l2 [stress/length].
    shear : ndarray (np,) or None
        Part of it that tangential tractions need, where points stick.
    """

    cells: FacetCells
    own: np.ndarray
    other: np.ndarray
    trace: np.ndarray
    shear: np.ndarray | None


class TargetTraction:
    """Stress of the cells of a target at partners. The constructor is *Collective*.

    Parameters
    ----------
    space : pcontact.space.space.Space
    name : str
        Facet group of the target.
    constants : list of (float, float)
        Lame constants of each body.
    sticks : bool
        Whether tangential tractions need a part of the trace constant only.
    """

    def __init__(self, space, name, constants, sticks):
        self._space, self._sticks = space, sticks
        self._groups = space.mesh.facet_groups.get(name, [])
        self._side = source_surface(space, name, constants, 1, sticks=sticks)
        self._width = space.comm.allreduce(self._side.cells.shape[1], op=MPI.MAX)

    def _columns(self):
        """How many numbers each quantity of an answer has: nodes, shape functions, gradients, volumetric operator,
        normal, area vector, and modulus, trace constant, its part in shear, radius."""
        n, d = self._width, self._space.dim
        return [n, n, n * d, n * d, d, d, 4]

    def _answer(self, rows, xi, nodal):
        """Those numbers (n, columns) at reference points xi (n, d - 1) of facets of this rank (n,)."""
        space, side, d, n = self._space, self._side, self._space.dim, len(rows)
        x, normal, shape = np.empty((n, d)), np.empty((n, d)), np.zeros((n, side.cells.shape[1]))
        slope, grad = np.zeros((2, *shape.shape, d))
        cells, first = side.cells[rows], 0
        for facets in self._groups:
            c = np.flatnonzero((rows >= first) & (rows < first + len(facets.cells)))
            x[c], normal[c], _, *tables = at_places(space, facets, rows[c] - first, xi[c])
            # the nodes of the facet are the first ones
            on = facet_nodes(facets.cell, space.degree)
            order = np.array([[*own, *np.setdiff1d(np.arange(tables[0].shape[1]), own)] for own in on])
            order = order[facets.local[rows[c] - first]]
            for whole, part in zip((cells, shape, slope, grad), (cells[c], *tables), strict=True):
                index = order if part.ndim == 2 else order[:, :, None]
                whole[c, : order.shape[1]] = np.take_along_axis(part, index, axis=1)
            first += len(facets.cells)
        # its volumetric operator follows from the others
        at = replace(side, facet=rows, x=x, normal=normal, jxw=np.ones(n), shape=shape, grad=grad, slope=None)
        numbers = np.column_stack([side.mu[rows], side.trace[rows], side.shear[rows], x[:, 0]])
        parts = space.nodes[cells], shape, grad, at.volumetric
        wide = [np.zeros((n, self._width, *part.shape[2:])) for part in parts]
        wide[0] += space.nodes[cells[:, :1]]
        for whole, part in zip(wide, parts, strict=True):
            whole[:, : part.shape[1]] = part
        vector = area_vectors(slope, nodal[cells], normal)
        return np.column_stack([*(part.reshape(n, np.prod(part.shape[1:], dtype=int)) for part in wide), normal, vector,
                                numbers])  # fmt: skip

    def _ask(self, place, nodal):
        """Answers (n, columns) at places (n, 1 + d): rank, row of the facet there, reference point. *Collective.*"""
        columns, size = sum(self._columns()), place.shape[1] - 1
        sends, order = split_by_rank(place[:, 0].astype(np.int64), place[:, 1:])
        asked = self._space.exchanger(sends, np.float64, size)
        joined = np.concatenate([np.zeros((0, size)), *asked.values()])
        answers = self._answer(joined[:, 0].astype(np.int64), joined[:, 1:], nodal)
        ends = np.cumsum([len(one) for one in asked.values()])
        replies = dict(zip(asked, np.split(answers, ends[:-1]), strict=True)) if asked else {}
        back = self._space.exchanger(replies, np.float64, columns)
        out = np.empty((len(place), columns))
        out[order] = np.concatenate([np.zeros((0, columns)), *(back[r] for r in sorted(sends))])
        return out

    def weigh(self, found, source, nodal):
        """What the sides of the points of a source say. *Collective.*

        Parameters
        ----------
        found : pcontact.contact.search.partners.Partners
        source : pcontact.contact.surface.sides.SourceSurface
        nodal : ndarray (n_local, d)
            Displacements at which partners were found [length].

        Returns
        -------
        found : pcontact.contact.search.partners.Partners
            With the other nodes of the cells behind those of the facets.
        Weighted
        """
        d, n, rows = self._space.dim, self._width, np.flatnonzero(found.paired)
        answers = self._ask(found.place[rows], nodal)
        whole = np.zeros((len(found.paired), answers.shape[1]))
        whole[rows] = answers
        nodes, shape, grad, volumetric, normal, area, numbers = np.split(whole, np.cumsum(self._columns())[:-1], axis=1)
        modulus, l2, shear2, radius = numbers.T
        l1, shear1 = source.trace[source.facet], source.shear[source.facet]
        slope = source.grad if source.slope is None else source.slope
        faces = area_vectors(slope, nodal[source.cells[source.facet]], source.normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(np.einsum("pd,pd->p", faces, found.normal) / np.einsum("pd,pd->p", area, found.normal))
            if self._space.axisymmetric:
                ratio *= radius / source.x[:, 0]
            both = found.paired & (found.held < EDGE) & (ratio <= ASKEW) & (ratio >= 1.0 / ASKEW)
        ratio, l2 = np.where(both, ratio, 1.0), np.where(both, l2, 1.0)
        own = np.where(both, ratio * l2 / (l1 + ratio * l2), 1.0)
        other = 1.0 - own
        parts = own**2 * l1, other**2 * ratio * l2
        trace = parts[0] + parts[1]
        cells = FacetCells(grad.reshape(-1, n, d), volumetric.reshape(-1, n, d), modulus.copy(), normal.copy())
        part = (parts[0] * shear1 + parts[1] * shear2) / trace if self._sticks else None
        width = found.nodes.shape[1]
        found = found._replace(nodes=nodes.astype(np.int64), shape=np.ascontiguousarray(shape), width=width)
        return found, Weighted(cells, own, -other * ratio, trace, part)


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


def target_traction(space, bulk, contact):
    """The `TargetTraction` of a contact; None where the traction is that of the source alone. *Collective.*

    It is that of both for two surfaces of bodies that are elastic, isotropic, at one temperature and there from the
    beginning; where points of both surfaces look for partners, each side has its own.
    """
    sided = contact.target is not None and contact.target != contact.source and not is_unbiased(contact)
    if not sided or contact.all:
        return None
    groups = [space.mesh.facet_groups.get(name, []) for name in (contact.source, contact.target)]
    numbers = {facets.block for group in groups for facets in group if len(facets.cells)}
    other = {number for number, block in enumerate(space.mesh.blocks) if block.body in bulk.orthotropic}
    other |= set(bulk.states) | set(bulk.parts) | set(bulk.added)
    if not space.comm.allreduce(bulk.heat is None and not numbers & other, op=MPI.LAND):
        return None
    return TargetTraction(space, contact.target, bulk.constants, contact.alpha is None)
