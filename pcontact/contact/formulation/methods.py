"""The formulations: what stands where the traction of the source does, and the parameters of the terms around it.

* Nitsche's method: the traction t of the source's stress; theta = 1, 0, -1.
* The penalty method: nothing, theta = 0. Its residual R = - int P . [[v]] with tau = gamma g n - alpha gamma D_T is
  Nitsche's with t = 0. A source without an operator for its traction (:func:`without_traction`) is all it takes: of
  the parent cells the nodes on their facets remain, so that the pattern is smaller, too, and stress and internal
  variables of the cells do not enter. The traction follows from the motion of the bodies: where they touch the gap is
  -p / gamma, where they stick the slip is traction over alpha gamma, and the next load step begins with that traction
  (see `pcontact.contact.formulation.small`).
* The augmented Lagrangian method: a multiplier, see below; theta = 0.

A formulation of one's own is a subclass of :class:`Method` and an entry in :data:`METHODS`.

Parameters of a pair, and the dimensionless ones that it takes when the scene does not say them.

gamma = gamma0 times the constant of the trace inequality of the parent cell [stress/length], in every formulation. That
constant has lam + 2 mu, which bounds the normal traction. The tangential one is bounded by the shear modulus alone,

    t_n^2 / (lam + 2 mu) + |t_T|^2 / mu <= sigma : eps,

so on simplices alpha gamma may be as small as mu / (lam + 2 mu) times gamma: with the same gamma0 the method is
coercive. Four times that, min(1, 4 mu / (lam + 2 mu)), which is 1 up to a Poisson's ratio of 1/3, is taken unless alpha
is said, and the trace constant of other cells is that of the traction whose tangential part counts over it.
Near Poisson's ratio 0.5, lam is hundreds of times mu: with alpha = 1 points would stick by springs hundreds of times as
stiff as the body is in shear, and Newton's method would not find which of them slip.

Unbiased contact: both surfaces are source and target, half and half (Chouly, Mlika, Renard 2017).

A pair of bodies has two halves: the points of each surface look for partners on the other, and all integrals of a
half, those of the theta terms too, have the weight 1/2. Each half has the tractions, normals, gaps and the gamma of its
own source; forces balance since every half acts on the jump. Self contact has one half: all points of the surface look
for partners on it, so that both of two places that touch have theirs.

Where the traction of a half is that of its source, the residual is monotone for gamma > (1 + theta)^2 / 8 times the
constant of the trace inequality, half of what contact with a source and a target needs; the default gamma0 is half as
large, too. Where it is the weighted one of both sides, both halves use the energy of both bodies, and nothing changes.

Each half is a :class:`pcontact.contact.pair.ContactPair` of its own; `pcontact.contact.report` makes one of their
reports.

Augmented Lagrangian: the penalty method with multipliers, updated around Newton's method (Uzawa).

Each quadrature point has a multiplier lam [stress], which stands where Nitsche's method has the traction of the body:

    tau = lam + gamma g n - alpha gamma D_T,   update  lam <- M P(tau)  at the solution of Newton's method

M takes the local mean over the closed points, see `pcontact.contact.formulation.small`. At a fixed point of the
update gap and slip have no local mean where points are closed or stick, and what is left, (P - M P) / gamma, is small
with the mesh and zero for a uniform traction. With lam <- P(tau) they would be zero at every point: more conditions
than displacements can meet. The pressure then sits on a few points, and an update takes away little (cylinder on a
block, 10 facets in the half width: error of the pressure in L2 92 % after 33 updates instead of 7 % after 5).

Let H be the compliance of the bodies, the gap that a traction at the points opens. While no point changes its status
an update multiplies the error of the multipliers by M (1 + gamma H)^-1, and neither factor makes anything larger. A
traction that changes from point to point is taken away by M. One that is smooth moves the bodies farther than it
presses a layer of their cells: gamma H is large, and the second factor takes it away.

Unbiased contact and self contact have two points at each place, one on either surface, each with a multiplier. Equal
and opposite changes of the two press nothing (gamma H = 0), and a mean over the points of one surface keeps them if
they are smooth: they fade as slowly as heat, or grow where points slip, and the pressures of the two surfaces drift
apart. There M is the mean over the points of both surfaces, see :func:`local_means`: what they differ by is gone at
once. Largest eigenvalue of an update, two blocks with 6 and 8 facets: 1, the next 0.96 and 0.98 with degree 1 and 2,
where each surface is alone; 0.15 and 0.10 with both.

gamma says how fast multipliers settle, nothing else: where it is smaller than the default one it grows with every
update, up to that. Each attempt of a load step starts with the gamma that the scene says. An update is by gamma times
the gap: with a small gamma it is small whatever the gap, and counts as that of the default gamma.

Committed multipliers belong to the end of the last load step; an attempt starts from them, and one that is cut back
leaves nothing behind.
"""

import dataclasses
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.contact.formulation.small import Acting, local_means
from pcontact.contact.law import OPEN
from pcontact.runtime.parallel import kept_rows, take_rows
from pcontact.runtime.petsc import MPI

# by theta. theta = -1 is coercive for any value; below 1 multigrid fails for quadratic hexahedra
GAMMA0 = {1.0: 2.0, 0.0: 1.0, -1.0: 1.0}
# bodies enter each other by p / gamma, a third of what the pressure does to a layer of cells: the error falls with the
# mesh. On curved surfaces a larger number makes the gap small at every point and spoils the pressure (cylinder on a
# block, 10 facets in the half width, error in L2: 19 % with 3, 49 % with 10, 138 % with 100). Multipliers take the
# penetration away in a few updates, and leave the smaller number
TRACELESS = {"penalty": 3.0, "augmented_lagrangian": 1.0}


class Parameters(NamedTuple):
    """Weights of the terms of a pair.

    Attributes
    ----------
    theta : float
        Of the adjoint term: 1, 0, -1.
    alpha : ndarray (np,)
        Of the tangential part over that of the normal one.
    gamma : ndarray (np,)
        Of the points of the source [stress/length].
    """

    theta: float
    alpha: np.ndarray
    gamma: np.ndarray


def coercive(theta):
    """gamma0 above which Nitsche's method is coercive on any mesh, for a source and a target: (1 + theta)^2 / 4."""
    return 0.25 * (1.0 + theta) ** 2


def parameter(contact):
    """gamma0 of a contact.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        With its numerics resolved; a formulation that is not said is Nitsche's.

    Returns
    -------
    float
    """
    if contact.gamma0 is not None:
        return contact.gamma0
    return TRACELESS.get(contact.formulation) or GAMMA0[float(contact.theta)]


# shape functions below this are those of nodes off the facet
OFF = 1e-12
# times the default, beyond which multigrid needs more than twice the iterations of one with a filter
STIFF = 30.0


class Method:
    """Nitsche's method, and the parameters that all formulations have.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    trace : ndarray (np,)
        Constant of the trace inequality of the parent cells of the points [stress/length].
    shape : tuple (np, d), optional
        Of the points: what a formulation keeps at them.

    Attributes
    ----------
    theta, gamma0 : float
    alpha : ndarray (np,)
        Of the tangential part over that of the normal one; 1 unless the contact says it, or it is taken.
    gamma : ndarray (np,)
        gamma0 times that constant [stress/length].
    """

    # whether the source's stress enters
    has_traction = True
    # gap below which there may be a pressure [length]
    begins = 0.0

    def __init__(self, contact, trace, shape=None):
        self.theta = float(contact.theta) if self.has_traction else 0.0
        self.take_alpha(np.full_like(trace, 1.0 if contact.alpha is None else contact.alpha))
        self.gamma0 = parameter(contact)
        self.take_trace(trace)

    def take_alpha(self, alpha):
        """Take alpha (np,) of the undeformed bodies."""
        self._alpha = self.alpha = alpha

    def take_trace(self, trace):
        """Take another constant (np,) of the trace inequality."""
        self._default = self.gamma = self.gamma0 * trace

    @property
    def parameters(self):
        """Weights as kernels take them."""
        return Parameters(self.theta, self.alpha, self.gamma)

    @property
    def firmest(self):
        """The largest stiffness (np,) between a gap and its traction [stress/length]."""
        return self.gamma

    @property
    def stiff(self):
        """Return True if multigrid alone fares badly: gamma0 far above its default, or the skew tangent of theta -1."""
        return self.theta < 0.0 or self.gamma0 > STIFF * GAMMA0[self.theta]

    def source(self, source):
        """The source surface as the method needs it."""
        return source if self.has_traction else without_traction(source)

    def normal_traction(self, traction, normal):
        """Normal traction (np,) in the place of the source's, along contact normals (np, d) [stress]."""
        return traction

    def traction(self, traction):
        """Traction in the place of the source's (np, d) [stress]."""
        return traction

    def begin(self, growth=None):
        """A load step is tried: what it changes is that of the last one.

        Parameters
        ----------
        growth : ndarray (np, 2), optional
            Of gamma, where the cells behind the facets have become stiffer, and of the part that tangential tractions
            need: where that grows more, alpha grows, too, up to 1.
        """
        self.gamma, self.alpha = self._default, self._alpha
        if growth is not None:
            along, across = growth.T
            self.gamma = self._default * along
            self.alpha = np.maximum(self._alpha, np.minimum(1.0, self._alpha * across / along))

    def commit(self):
        """The load step has ended."""

    def memory(self, keys):
        """Tables for a checkpoint, of points with keys (np,), see `pcontact.assembly.item.Item.memory`."""
        return {}

    def recall(self, name, keys, chunks):
        """Take a table back, see `pcontact.assembly.item.Item.recall`."""
        return None


class Penalty(Method):
    """The penalty method."""

    has_traction = False


def facet_columns(source):
    """Nodes of the parent cells that are on the facets of a source.

    Parameters
    ----------
    source : pcontact.contact.surface.sides.SourceSurface

    Returns
    -------
    columns : ndarray (nf, m)
        Of ``cells``; where a facet has fewer than m nodes the row ends with some that are off it.
    kept : ndarray (nf, m) of bool
        Whether they are on it.
    """
    largest = np.zeros(source.cells.shape)
    np.maximum.at(largest, source.facet, np.abs(source.shape))
    on = largest > OFF
    columns = np.argsort(~on, axis=1, kind="stable")[:, : int(on.sum(axis=1).max(initial=1))]
    return columns, np.take_along_axis(on, columns, axis=1)


def without_traction(source):
    """The source surface without what its traction is made from.

    Parameters
    ----------
    source : pcontact.contact.surface.sides.SourceSurface

    Returns
    -------
    SourceSurface
        The same points; ``cells`` (nf, m) and ``shape`` (np, m) have the nodes of the facets alone, ``grad`` and
        ``volumetric`` are of width 0.
    """
    columns, kept = facet_columns(source)
    every = columns[source.facet]
    shape = np.where(kept[source.facet], np.take_along_axis(source.shape, every, axis=1), 0.0)
    return dataclasses.replace(
        source,
        cells=np.ascontiguousarray(np.take_along_axis(source.cells, columns, axis=1)),
        shape=np.ascontiguousarray(shape),
        grad=np.zeros((len(source.facet), 0, source.x.shape[1])),
        shared=None,
        axisymmetric=False,
        slope=None,
    )


WEIGHT = 0.5


def is_unbiased(contact):
    """Return True if a contact is made of halves: it says so, or it is self contact."""
    return contact.unbiased or contact.target == contact.source


def halved(source):
    """A source surface (SourceSurface) whose quadrature weights are halved, and with them all terms."""
    return replace(source, jxw=WEIGHT * source.jxw)


def contacts_of_halves(contact, both):
    """The contacts (one or two) that make up an unbiased one: from each surface to the other.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
        With its numerics resolved.
    both : bool
        Whether the traction of a half is that of both sides.
    """
    gamma0 = contact.gamma0
    if gamma0 is None and not both and contact.formulation in (None, "nitsche"):
        gamma0 = WEIGHT * parameter(contact)
    forth = replace(contact, gamma0=gamma0)
    if contact.source == contact.target:
        return [forth]
    return [forth, replace(forth, source=contact.target, target=contact.source)]


# of gamma, at once
GROWTH = 10.0


class AugmentedLagrangian(Penalty):
    """Multipliers in the place of the source's traction.

    Parameters
    ----------
    contact, trace, shape
        See `pcontact.contact.formulation.methods.Method`; of the shape are the multipliers.

    Attributes
    ----------
    multiplier : ndarray (np, d)
        Of the load step that is being solved [stress]; without friction its normal part alone counts.
    """

    def __init__(self, contact, trace, shape):
        super().__init__(contact, trace, shape)
        self.multiplier = np.zeros(shape)
        self._kept, self._first, self._grown = self.multiplier, self.gamma, 1.0

    def short(self):
        """The default gamma over that which acts; 1 where that is no smaller."""
        return max(TRACELESS["augmented_lagrangian"] / (self._grown * self.gamma0), 1.0)

    def stiffen(self):
        """Let gamma grow, not beyond the default one."""
        self._grown *= min(GROWTH, self.short())
        self.gamma = self._grown * self._first

    def begin(self, growth=None):
        """Start from the multipliers of the last load step, with the gamma that the scene says."""
        super().begin(growth)
        self.multiplier, self._first, self._grown = self._kept, self.gamma, 1.0

    def commit(self):
        """Keep the multipliers for the next load step."""
        self._kept = self.multiplier

    def normal_traction(self, traction, normal):
        """See :meth:`Method.normal_traction`."""
        return np.einsum("pd,pd->p", self.multiplier, normal)

    def traction(self, traction):
        """See :meth:`Method.traction`."""
        return self.multiplier.copy()

    def memory(self, keys):
        """See :meth:`Method.memory`."""
        return {"multiplier": kept_rows(keys, self._kept)}

    def recall(self, name, keys, chunks):
        """See :meth:`Method.recall`."""
        if name != "multiplier":
            return None
        self._kept = np.zeros_like(self._kept)
        return take_rows(keys, chunks, self._kept)


def acting(pair, u):
    """Traction at ``u`` of the points of a pair that are closed. *Collective.*

    Returns
    -------
    pcontact.contact.formulation.small.Acting
    """
    traction, status = pair.forces(u)
    return Acting(pair.pairing, pair.source, traction, status > OPEN, pair.target_shape(u))


def update_multipliers(parts, u, rtol):
    """Replace the multipliers of a pair by means of the traction that acts at ``u``, unless they have settled.
    *Collective.*

    Parameters
    ----------
    parts : list of pcontact.contact.pair.ContactPair
        With multipliers: the pair of a contact, or the two of an unbiased one.
    u : PETSc.Vec
        Where the residual is zero.
    rtol : float
        Multipliers that change by no more stay as they are: state and equilibrium remain those of ``u``.

    Returns
    -------
    change : float
        Norm of the change over the surfaces, by the default gamma if that is larger, relative to that of the
        multipliers; 0 where nothing touches, and where rounding errors of the gap make as much.
    size : float
        The norm itself, by the gamma that acts [stress length^((d - 1) / 2)].
    """
    first, found = parts[0], [acting(part, u) for part in parts]
    means = local_means(first.space, found, both=is_unbiased(first.contact))
    updates = [np.where(one.chosen[:, None], mean, 0.0) for one, mean in zip(found, means, strict=True)]
    sums = np.zeros(4)
    for part, one, new in zip(parts, found, updates, strict=True):
        old = part.method.multiplier
        rounding = (part.method.gamma * part.search.rounding * one.chosen)[:, None]
        for k, size in enumerate((new - old, new, old, rounding)):
            sums[k] += np.einsum("p,pd,pd->", part.source.jxw, size, size)
    sums = first.space.comm.allreduce(sums, op=MPI.SUM)
    scale = float(max(sums[1], sums[2]))
    change = float(np.sqrt(sums[0] / scale)) * first.method.short() if sums[0] > sums[3] and scale > 0.0 else 0.0
    if change > rtol:
        for part, new in zip(parts, updates, strict=True):
            part.method.multiplier = new
    return change, float(np.sqrt(sums[0]))
