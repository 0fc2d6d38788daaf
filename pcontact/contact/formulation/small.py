"""The terms of a pair at small strain, with friction and without.

With friction all of the traction counts, without it the normal one alone: the kernels take the directions in which
tractions count, see `pcontact.contact.formulation.small_kernels`.

The slip of a load step counts from the tangential jump of the committed displacement on the present pair of points
(plus what a rigid obstacle has moved since the committed time), so a point that is handed to another target facet
loses nothing. Traction and law agree weakly: at a point that sticks the jump differs from its reference by

    lag = (t_T - P_T) / (alpha gamma),

small with the mesh. The lag is taken off the next reference. Each load step would otherwise start from the jump as it
is, and stick would creep by the lag in every step. Points that stick carry the lag's local average, over the patches of
the shape functions: its changes from point to point are those of the stress of the cells and of meshes that do not
match, and would add up from step to step. Points that slip carry their own: they stay at their bound. Without a
traction of the source (penalty) the lag is that of the spring which bears the traction, exact at a point.

A tied point obeys the law of stick without a bound: the projection is the identity, P = tau, and Nitsche's method
becomes that of an interface condition [[u]] = 0,

    R  = - int tau . [[v]] + theta int (tau - t) . G^-1 T[v],   tau = t - G [[u]],

without a gap: what lies between the surfaces at the beginning, or how far they overlap, stays there without any force.
The condition is linear. Partners are found once, in the undeformed bodies, and the jump counts from there.

Local means of what quadrature points hold are what the displacements of the bodies can feel of it. The mean of a node
is that of the points around it, weighted with their areas and with the size of its shape function. A point takes the
mean of the nodes around it, weighted with that size. Weights are positive and add up to one: what is uniform is kept,
nothing grows, and what changes from point to point is taken away.
"""

from typing import NamedTuple

import numpy as np

from pcontact.contact.formulation.small_kernels import add_residual, add_tangent, augment, evaluate
from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.contact.points import TractionOperator
from pcontact.runtime.jit import njit_inner
from pcontact.runtime.parallel import kept_rows, take_rows


@njit_inner
def add_at_nodes(weight, nodes, facet, density, out):
    """Add weight (np, m) times density (np, d) at the nodes (nf, m) of the facet of each point to ``out`` (n, d)."""
    for p in range(len(facet)):
        for a in range(nodes.shape[1]):
            for i in range(density.shape[1]):
                out[nodes[facet[p], a], i] += weight[p, a] * density[p, i]


class Acting(NamedTuple):
    """Values that act at the points of a source.

    Attributes
    ----------
    pairing : pcontact.contact.pair.Pairing
    source : pcontact.contact.surface.sides.SourceSurface
    values : ndarray (np, d)
    chosen : ndarray (np,) of bool
        Points that count.
    target_shape : ndarray (np, m)
        Shape functions of the partners' facets where the partners are.
    """

    pairing: object
    source: object
    values: np.ndarray
    chosen: np.ndarray
    target_shape: np.ndarray


class _Around(NamedTuple):
    """Nodes around the points: share (np, m) of each, nodes (n, m), the row (np,) of ``nodes`` of each point, and
    whether what acts at a point acts there (1.0) or its reaction (-1.0).
    """

    share: np.ndarray
    nodes: np.ndarray
    row: np.ndarray
    sign: float


def _around(part, both):
    """The nodes of the source around the points of an :class:`Acting` and, of `both` sides, those of the target."""
    pairing, source = part.pairing, part.source
    # shape functions of degree 2 change their sign
    sides = [_Around(np.abs(source.shape), pairing.cells, source.facet, 1.0)]
    if both:
        sides.append(_Around(np.abs(part.target_shape), pairing.targets, np.arange(len(source.facet)), -1.0))
    return sides


def _at_nodes(space, parts, arounds):
    """Means at the nodes of all parts, a distributed vector. *Collective.*"""
    sums, weights = space.vector(), space.vector()
    for part, sides in zip(parts, arounds, strict=True):
        area = np.where(part.chosen, part.source.jxw, 0.0)[:, None]
        for total, density in ((sums, part.values), (weights, None)):
            local = np.zeros((len(part.pairing.exchange.nodes), space.dim))
            for share, nodes, row, sign in sides:
                values = np.ones_like(part.values) if density is None else sign * density
                add_at_nodes(area * share, nodes, row, values, local)
            part.pairing.exchange.add(local, total)
    weight = weights.getArray(readonly=True)
    sums.setArray(sums.getArray(readonly=True) / np.where(weight > 0.0, weight, 1.0))
    weights.destroy()
    return sums


def local_means(space, parts, both=False):
    """Means of values over the patches of the nodes, interpolated to the points. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : list of Acting
        One, or the two halves of unbiased contact.
    both : bool
        Whether each point counts on both sides, at the nodes of its source with its value and at those of its partner's
        facet with the negative one, and takes the mean of the two.

    Returns
    -------
    list of ndarray (np, d)
        For each part at all points; where `both`, they have a meaning at points with a partner.
    """
    arounds = [_around(part, both) for part in parts]
    total, means = _at_nodes(space, parts, arounds), []
    for part, sides in zip(parts, arounds, strict=True):
        nodal, mean = part.pairing.exchange.gather(total), np.zeros_like(part.values)
        for share, nodes, row, sign in sides:
            whole = share.sum(axis=1)
            own = np.einsum("pa,pad->pd", share, nodal[nodes[row]])
            mean += sign / len(sides) * own / np.where(whole > 0.0, whole, 1.0)[:, None]
        means.append(mean)
    total.destroy()
    return means


def patch_means(space, pairing, source, values, chosen):
    """Means of values (np, d) of a source of which some points (np,) are chosen, see :func:`local_means`. *Collective.*

    Returns
    -------
    ndarray (np, d)
        At all points.
    """
    return local_means(space, [Acting(pairing, source, values, chosen, pairing.target_shape)])[0]


def across(vectors, normal):
    """Tangential part (np, d) of vectors."""
    return vectors - np.einsum("pd,pd->p", vectors, normal)[:, None] * normal


class Terms:
    """Residual and tangent of a pair at its points, as functions of nodal values (n, d) and the view of a rule.

    Parameters
    ----------
    space : pcontact.space.space.Space
    source : pcontact.contact.surface.sides.SourceSurface
    method : pcontact.contact.formulation.methods.Method
    traction : pcontact.contact.traction.small.Traction or pcontact.contact.traction.finite.FiniteTraction
    law : pcontact.contact.law.Frictionless

    Attributes
    ----------
    repeats : bool
        Whether the tangent among the same partners is the same wherever its slopes are.
    """

    repeats = False

    def __init__(self, space, source, method, traction, law):
        self.space, self.source, self.method, self.traction, self.law = space, source, method, traction, law
        if self._lags:
            self._lag = np.zeros_like(source.x)

    @property
    def _lags(self):
        return self.law.tangential and not self.law.tied

    def _end_step(self, p, normal, traction, force, status):
        """Keep by how much the jump lags behind the law at the end of a load step, of points with tractions t and P
        (np, d). *Collective.*"""
        if self._lags:
            lag = (traction - force) / (self.method.alpha * self.method.gamma)[:, None]
            stick = status == STICK
            if self.method.has_traction:
                lag = np.where(stick[:, None], patch_means(self.space, p, self.source, lag, stick), lag)
            self._lag = np.where((status > OPEN)[:, None], across(lag, normal), 0.0)
        self.method.commit()

    def memory(self, keys):
        """Tables for a checkpoint, see `pcontact.assembly.item.Item.memory`."""
        if not self._lags:
            return self.method.memory(keys)
        return {"lag": kept_rows(keys, self._lag), **self.method.memory(keys)}

    def recall(self, name, keys, chunks):
        """Take a table back, see `pcontact.assembly.item.Item.recall`."""
        if name != "lag" or not self._lags:
            return self.method.recall(name, keys, chunks)
        self._lag = np.zeros_like(self.source.x)
        return take_rows(keys, chunks, self._lag)


class SmallTerms(Terms):
    """Those of small strain; parameters as for `Terms`."""

    def __init__(self, space, source, method, traction, law):
        super().__init__(space, source, method, traction, law)
        if self._lags:
            self._start = self._before = self._lag

    @property
    def repeats(self):
        """See :class:`Terms`."""
        return self.traction.symmetric

    @property
    def _directions(self):
        """Directions in which tractions count."""
        return self.space.dim if self.law.tangential else 1

    def wide(self, p):
        """Points (np,) whose traction is that of the cells of their partners, too."""
        return p.operator.width > self.source.shape.shape[1]

    # -- a load step ----------------------------------------------------------------------------------------------

    def weigh(self, found, nodal):
        """Partners (`pcontact.contact.search.partners.Partners`) on the nodes of their cells, where those have a part
        in the traction: weights, gamma and alpha are those of the two sides at displacements (n_local, d).
        *Collective.*
        """
        found, weighted = self.traction.weigh(found, nodal, self._directions), self.traction.weighted
        if weighted is not None:
            self.method.take_trace(weighted.trace)
            if weighted.shear is not None:
                self.method.take_alpha(weighted.shear)
        return found

    def operator(self, normal, last):
        """The derivative of the traction, a :class:`pcontact.contact.points.TractionOperator`.

        Parameters
        ----------
        normal : ndarray (np, d)
            Contact normals.
        last : pcontact.contact.pair.Pairing or None
            Of the last search, whose operator is overwritten.
        """
        d = normal.shape[1]
        axes, along = (np.eye(d)[None], normal) if self.law.tangential else (normal[:, None], np.ones((len(normal), 1)))
        return TractionOperator(axes, along, *self.traction.rows(axes, normal, last))

    def begin(self, p, values, moved, turned):
        """A load step begins, with a pairing and displacements (n, d): remember the jump, and the one from which the
        law counts slip.

        Parameters
        ----------
        p : pcontact.contact.pair.Pairing
        values : ndarray (n, d)
        moved : ndarray (np, d) or (d,), or zero
            What an obstacle moves in it [length].
        turned : callable
            Vectors (np, d) that turn with the obstacle, at the end of it.
        """
        self.method.begin()
        if self._lags:
            self._start = self._jump(p, values, p.acts) + moved
            self._before = self._start - turned(self._lag)

    def commit(self, p, values, view):
        """The load step has ended; returns the status (np,) of the points. *Collective.*"""
        traction, tau = self._augmented(p, values, p.acts)
        force, status = self._projected(p, view, tau)
        self._end_step(p, p.normal, traction, force, status)
        return status

    # -- at the points, in the directions in which tractions count ------------------------------------------------

    def _evaluate(self, p, values, wanted, operator=None):
        """Linear traction and jump (np, m) of the points that are wanted (np,)."""
        traction, jump = np.empty((2, len(p.paired), self._directions))
        evaluate(values, p.source, p.partner, p.operator if operator is None else operator, wanted, traction, jump)
        return traction, jump

    def _jump(self, p, values, wanted=None):
        """The jump alone."""
        without = p.operator._replace(rows=p.operator.rows[:, :0])
        return self._evaluate(p, values, p.every if wanted is None else wanted, without)[1]

    def _traction(self, p, values, wanted):
        """Traction that the law is given, and jump (np, m)."""
        traction, jump = self._evaluate(p, values, wanted)
        if self.law.tangential:
            self.traction.add_excess(values, p, traction)
            return self.method.traction(traction), jump
        self.traction.add_normal_excess(values, p, traction[:, 0])
        return self.method.normal_traction(traction[:, 0], p.normal)[:, None], jump

    def _augmented(self, p, values, wanted):
        """Traction and augmented traction (np, m) of the points that are wanted (np,)."""
        traction, jump = self._traction(p, values, wanted)
        tau, before = np.empty_like(traction), self._before if self._lags else np.zeros_like(jump)
        augment(self.method.parameters, p.operator, p.gap0, traction, jump, before, wanted, tau)
        return traction, tau

    def _projected(self, p, view, tau, slope=None):
        """Traction P (np, m) and status (np,) by the law; fills its derivative (np, m, m)."""
        if self.law.tangential:
            return self.law.project(view, p.normal, tau, slope)
        closed = self.law.closed(view, tau[:, 0])
        if slope is not None:
            slope[closed] = 1.0
        return np.where(closed[:, None], tau, 0.0), np.where(closed, SLIP, OPEN)

    def _in_space(self, p, vectors):
        """Vectors (np, m) as vectors (np, d)."""
        return vectors if self.law.tangential else vectors * p.normal

    # -- at the points --------------------------------------------------------------------------------------------

    def gap(self, p, values, wanted=None):
        """Gap (np,) [length], of the points that are wanted (np,)."""
        return p.gap0 - np.einsum("pm,pm->p", self._jump(p, values, wanted), p.operator.normal)

    def approach(self, p, u, y):
        """Closing of the gap (np,) by a step -y from u (distributed vectors) [length]. *Collective.*"""
        return self.gap(p, p.exchange.gather(y)) - p.gap0

    def normal_state(self, p, values, wanted=None):
        """Normal traction and gap (np,), at least of the points that are wanted (np,)."""
        traction, jump = self._evaluate(p, values, p.every if wanted is None else wanted)
        traction, gap = (np.einsum("pm,pm->p", one, p.operator.normal) for one in (traction, jump))
        self.traction.add_normal_excess(values, p, traction)
        return self.method.normal_traction(traction, p.normal), p.gap0 - gap

    def forces(self, p, values, view):
        """Tractions P (np, d) that act on the source, and status (np,)."""
        force, status = self._projected(p, view, self._augmented(p, values, p.acts)[1])
        return self._in_space(p, force), status

    def slopes(self, p, values, view):
        """Derivatives of the law that :meth:`add_tangent` needs, and status (np,)."""
        tau = self._augmented(p, values, p.acts)[1]
        slope = np.zeros((*tau.shape, tau.shape[1]))
        _, status = self._projected(p, view, tau, slope)
        return (status, slope), status

    def derivative(self, p, values, view):
        """Derivative (np, d, d) of the tractions of :meth:`forces` in the augmented ones."""
        slope, axes = self.slopes(p, values, view)[0][1], p.operator.axes
        return slope if self.law.tangential else slope * axes.transpose(0, 2, 1) * axes

    # -- residual and tangent -------------------------------------------------------------------------------------

    def add_residual(self, p, values, view, local):
        """Add to forces ``local`` (n, d)."""
        traction, tau = self._augmented(p, values, p.acts)
        force, status = self._projected(p, view, tau)
        add_residual(self.method.parameters, p.source, p.partner, p.operator, traction, force, status, local)
        if self.traction.consistent:
            self.traction.add_adjoint(values, p, self._weights(p, traction, force), local)

    def _weights(self, p, traction, force):
        """Factor of the adjoint operator: theta G^-1 (P - t) (np, d), times the weights of the points."""
        rest, method = force - traction, self.method
        tangential = across(rest, p.operator.normal)
        factor = (method.theta * self.source.jxw / method.gamma)[:, None]
        return self._in_space(p, factor * (rest - tangential + tangential / method.alpha[:, None]))

    def _excess(self, values, p):
        excess = self.traction.excess(values, p)
        if self.law.tangential or not len(excess.rows):
            return excess._replace(rows=excess.rows[:, :, : self._directions])
        points = np.flatnonzero(excess.at >= 0)
        normal = p.normal[points[np.argsort(excess.at[points])]]
        return excess._replace(rows=np.ascontiguousarray(np.einsum("kaij,ki->kaj", excess.rows, normal)[:, :, None]))

    def add_tangent(self, p, values, view, slopes, blocks):
        """Add to blocks (BlockRows); returns how many entries had no place."""
        arguments = p.source, p.partner, p.operator, self._excess(values, p), *slopes, blocks
        missing = add_tangent(self.method.parameters, *arguments)
        if self.traction.consistent:
            traction, tau = self._augmented(p, values, p.acts)
            force, _ = self._projected(p, view, tau)
            missing += self.traction.add_curvature(values, p, self._weights(p, traction, force), blocks)
        return missing

    def slip(self, p, values):
        """Tangential slip (np, d) of the load step [length], zero without a partner."""
        start = self._start if self._lags else 0.0
        slip = across(self._jump(p, values) - start, p.normal)
        return np.where(p.paired[:, None], slip, 0.0)

    # -- report ---------------------------------------------------------------------------------------------------

    def state(self, p, values, view):
        """State of the points beyond pressure and gap, see `pcontact.contact.pair.ContactPair.state`: with friction
        ``traction`` with its tangential part, ``status``, ``slip`` of the load step (np, d) [length], and
        ``own_traction`` (np, d), that of the stress."""
        if not self.law.tangential:
            return {}
        own, tau = self._augmented(p, values, p.every)
        traction, status = self._projected(p, view, tau)
        return {"traction": traction, "own_traction": own, "slip": self.slip(p, values), "status": status}
