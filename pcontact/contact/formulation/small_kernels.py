"""Contact at small strain: compiled kernels at the quadrature points of the source.

Tractions count in m directions e_k: all d of space with friction, the contact normal alone (m = 1) without. Notation of
every kernel, one row per quadrature point p on facet f = facet[p]; what points get that are not ``wanted`` (np,) is
zero, and all vectors but nodal ones have their m components along the e_k:

* jump  [[u]] = u(X) - u(Y),  gap  g = g0 - [[u]] . n,  slip  D_T = (I - n n)([[u]] - w) with w the jump at the end of
  the last load step on the same pair of points, plus what a rigid obstacle has moved since
* traction  t, linear in the displacements of the cells it is taken from, T = dt/du, plus what is in excess of that
* G = gamma (n n + alpha (I - n n)),  augmented traction  tau = t + gamma g n - alpha gamma D_T,  P = project(tau)

    residual   R  = - int P . [[v]] + theta int (P - t) . G^-1 T[v]
    tangent    K  = int [[v]] . D (G [[w]] - S[w]) - theta T[v] . G^-1 (D G [[w]] + (I - D) S[w]),   D = dP/dtau

with S = dt/du, which is T unless cells yield, as in Chouly, Mlika, Renard (2018), with the matrix G^-1 as the weight of
the adjoint term, so that theta = 1 stays symmetric when alpha is not 1. P (np, m), D (np, m, m) and the status (np,)
come from the law between these kernels, see `pcontact.contact.law`; a point without partner has P = 0. Nodes are
numbers into ``u`` (n, d). Where the operator of the traction has width 0 there is none, t = S = 0 at theta = 0: the
penalty method, see `pcontact.contact.formulation.methods`.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import find
from pcontact.runtime.jit import njit, njit_inner


@njit
def evaluate(u, source, partner, operator, wanted, traction, jump):
    """Traction t (np, m) [stress], without what is in excess, and jump [[u]] (np, m) [length] at u (n, d).

    Parameters
    ----------
    u : ndarray (n, d)
    source : pcontact.contact.points.SourcePoints
    partner : pcontact.contact.points.PartnerPoints
    operator : pcontact.contact.points.TractionOperator
    wanted : ndarray (np,) of bool
    traction, jump : ndarray (np, m)
        Out.
    """
    facet, cells, shape, nodes = source.facet, source.cells, source.shape, partner.nodes
    rows, axes, nn, d, last = operator.rows, operator.axes, cells.shape[1], u.shape[1], len(operator.axes) - 1
    apart = np.zeros(d)
    for p in range(len(facet)):
        f, e = facet[p], min(p, last)
        traction[p], jump[p] = 0.0, 0.0
        if not wanted[p]:
            continue
        apart[:] = 0.0
        for a in range(nn):
            for i in range(d):
                apart[i] += shape[p, a] * u[cells[f, a], i]
        for m in range(partner.shape.shape[1]):
            for i in range(d):
                apart[i] -= partner.shape[p, m] * u[nodes[p, m], i]
        for k in range(axes.shape[1]):
            for i in range(d):
                jump[p, k] += axes[e, k, i] * apart[i]
        for r in range(min(operator.width[p], rows.shape[1])):
            node = cells[f, r] if r < nn else nodes[p, r - nn]
            for k in range(axes.shape[1]):
                for i in range(d):
                    traction[p, k] += rows[p, r, k, i] * u[node, i]


@njit_inner
def augment(parameters, operator, gap0, traction, jump, before, wanted, tau):
    """Augmented traction tau (np, m) [stress]; ``before`` (np, m) is the jump from which slip counts."""
    gamma, alpha, normal = parameters.gamma, parameters.alpha, operator.normal
    m = normal.shape[1]
    for p in range(len(gap0)):
        for k in range(m):
            tau[p, k] = 0.0
        if not wanted[p]:
            continue
        along, along_slip = 0.0, 0.0
        for k in range(m):
            along += jump[p, k] * normal[p, k]
            along_slip += (jump[p, k] - before[p, k]) * normal[p, k]
        for k in range(m):
            slip = jump[p, k] - before[p, k] - along_slip * normal[p, k]
            tau[p, k] = traction[p, k] + gamma[p] * ((gap0[p] - along) * normal[p, k] - alpha[p] * slip)


@njit
def add_residual(parameters, source, partner, operator, traction, force, status, out):
    """Add the residual of the pair to ``out`` (n, d) [force].

    Parameters
    ----------
    parameters : pcontact.contact.formulation.methods.Parameters
    source : pcontact.contact.points.SourcePoints
    partner : pcontact.contact.points.PartnerPoints
    operator : pcontact.contact.points.TractionOperator
    traction, force : ndarray (np, m)
        t and P [stress].
    status : ndarray (np,)
        Points that are open have P = 0.
    out : ndarray (n, d)
    """
    theta, alpha, gamma = parameters.theta, parameters.alpha, parameters.gamma
    facet, cells, shape, jxw, nodes = source.facet, source.cells, source.shape, source.jxw, partner.nodes
    rows, axes, nn, d, last = operator.rows, operator.axes, cells.shape[1], out.shape[1], len(operator.axes) - 1
    m = axes.shape[1]
    weight, push = np.zeros(m), np.zeros(d)
    for p in range(len(facet)):
        f, e = facet[p], min(p, last)
        if theta != 0.0:
            _weigh(force[p], traction[p], operator.normal[p], gamma[p], alpha[p], theta * jxw[p], weight)
            for r in range(operator.width[p]):
                node = cells[f, r] if r < nn else nodes[p, r - nn]
                for k in range(m):
                    for i in range(d):
                        out[node, i] += weight[k] * rows[p, r, k, i]
        if status[p] == 0:
            continue
        push[:] = 0.0
        for k in range(m):
            for i in range(d):
                push[i] += jxw[p] * force[p, k] * axes[e, k, i]
        for a in range(nn):
            for i in range(d):
                out[cells[f, a], i] -= shape[p, a] * push[i]
        for a in range(partner.shape.shape[1]):
            for i in range(d):
                out[nodes[p, a], i] += partner.shape[p, a] * push[i]


@njit_inner
def _weigh(force, traction, normal, gamma, alpha, factor, out):
    """out = factor G^-1 (P - t)."""
    along = 0.0
    for k in range(len(normal)):
        along += (force[k] - traction[k]) * normal[k]
    for k in range(len(normal)):
        across = force[k] - traction[k] - along * normal[k]
        out[k] = factor / gamma * (along * normal[k] + across / alpha)


class _Work(NamedTuple):
    """What is computed anew for each point, of its nr = nn + nt nodes.

    Attributes
    ----------
    part : ndarray (nr,)
        N: shape functions of the nodes of its parent cell, minus those of the nodes of its partner.
    real : ndarray (nr, m, d)
        S [stress/length].
    stiff, inverse : ndarray (m, m)
        D G [stress/length], G^-1.
    pull, weak : ndarray (nr, m, d)
        D (G N - S) [stress/length], G^-1 (D G N + (I - D) S).
    push : ndarray (nr, d, d)
        The first one in all directions of space.
    """

    part: np.ndarray
    real: np.ndarray
    stiff: np.ndarray
    inverse: np.ndarray
    pull: np.ndarray
    weak: np.ndarray
    push: np.ndarray


@njit
def add_tangent(parameters, source, partner, operator, excess, status, slope, blocks):
    """Add the generalised Jacobian of the pair to block values; returns how many entries had no place.

    Parameters
    ----------
    parameters : pcontact.contact.formulation.methods.Parameters
    source : pcontact.contact.points.SourcePoints
    partner : pcontact.contact.points.PartnerPoints
    operator : pcontact.contact.points.TractionOperator
    excess : pcontact.contact.points.Excess
        What is added to T in S, in the m directions, and from which row on S stands in the place of T.
    status : ndarray (np,)
    slope : ndarray (np, m, m)
        D, zero where points are open.
    blocks : pcontact.assembly.graph.BlockRows
    """
    m, d = operator.axes.shape[1], operator.axes.shape[2]
    n = source.cells.shape[1] + partner.nodes.shape[1]
    work = _Work(
        np.zeros(n), np.zeros((n, m, d)), np.zeros((m, m)), np.zeros((m, m)), np.zeros((n, m, d)),
        np.zeros((n, m, d)), np.zeros((n, d, d)),
    )  # fmt: skip
    theta, alpha, gamma = parameters.theta, parameters.alpha, parameters.gamma
    part, real, weak, push = work.part, work.real, work.weak, work.push
    facet, cells, shape, jxw, nodes, at = source.facet, source.cells, source.shape, source.jxw, partner.nodes, excess.at
    rows, axes, last = operator.rows, operator.axes, len(operator.axes) - 1
    rowptr, columns, values = blocks.rowptr, blocks.columns, blocks.values
    nn, on, missing = cells.shape[1], partner.shape.shape[1], 0
    for p in range(len(facet)):
        f = facet[p]
        touches = status[p] > 0
        if not touches and theta == 0.0:
            continue
        _stiffness(slope[p], operator.normal[p], gamma[p], alpha[p], work.stiff, work.inverse)
        # other nodes of the partner's cell count where it has a part in the traction
        width = max(operator.width[p], nn + on) if touches else operator.width[p]
        exceeds = len(at) > 0 and at[p] >= 0
        for r in range(width):
            part[r] = shape[p, r] if r < nn else -partner.shape[p, r - nn] if r < nn + on else 0.0
            for k in range(m):
                for j in range(d):
                    own = rows[p, r, k, j] if r < rows.shape[1] else 0.0
                    real[r, k, j] = own + (excess.rows[at[p], r, k, j] if exceeds and r < excess.rows.shape[1] else 0.0)
        _columns(theta, width, slope[p], axes[min(p, last)], work)
        # the adjoint operator is T, or S
        consistent = exceeds and at[p] >= excess.adjoint
        for r in range(width):
            # nodes of the cells that are not on their facets feel nothing at theta = 0
            if theta == 0.0 and part[r] == 0.0:
                continue
            row = cells[f, r] if r < nn else nodes[p, r - nn]
            adjoint, tested = 0.0, real[r]
            if theta != 0.0 and (consistent or r < rows.shape[1]):
                adjoint = theta
                if not consistent:
                    tested = rows[p, r]
            for c in range(width):
                column = cells[f, c] if c < nn else nodes[p, c - nn]
                k = find(columns, rowptr[row], rowptr[row + 1], column)
                if k < 0:
                    missing += 1
                    continue
                for i in range(d):
                    for j in range(d):
                        value = part[r] * push[c, i, j]
                        if adjoint != 0.0:
                            for n in range(m):
                                value -= adjoint * tested[n, i] * weak[c, n, j]
                        values[k, i, j] += jxw[p] * value
    return missing


@njit_inner
def _stiffness(slope, normal, gamma, alpha, stiff, inverse):
    """stiff = D G,  inverse = G^-1."""
    m = len(normal)
    for k in range(m):
        along = 0.0
        for n in range(m):
            along += slope[k, n] * normal[n]
        for n in range(m):
            nn = normal[k] * normal[n]
            unit = 1.0 if k == n else 0.0
            stiff[k, n] = gamma * (alpha * slope[k, n] + (1.0 - alpha) * along * normal[n])
            inverse[k, n] = (nn + (unit - nn) / alpha) / gamma


@njit_inner
def _columns(theta, width, slope, axes, work):
    """For the first nodes: pull = D (G N - S),  weak = G^-1 (D G N + (I - D) S),  push = pull in space."""
    part, real, stiff, inverse, pull, weak, push = (
        work.part, work.real, work.stiff, work.inverse, work.pull, work.weak, work.push
    )  # fmt: skip
    m, d = axes.shape
    for c in range(width):
        for k in range(m):
            for j in range(d):
                value = 0.0
                for n in range(m):
                    value += part[c] * stiff[k, n] * axes[n, j] - slope[k, n] * real[c, n, j]
                pull[c, k, j] = value
        for i in range(d):
            for j in range(d):
                push[c, i, j] = 0.0
                for k in range(m):
                    push[c, i, j] += axes[k, i] * pull[c, k, j]
        if theta == 0.0:
            continue
        for k in range(m):
            for j in range(d):
                value = 0.0
                for n in range(m):
                    value += inverse[k, n] * (pull[c, n, j] + real[c, n, j])
                weak[c, k, j] = value
