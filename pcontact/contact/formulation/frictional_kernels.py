"""Contact with friction: compiled kernels at the quadrature points of the source.

Notation of every kernel, one row per quadrature point p on facet f = facet[p]; what points get that are not ``wanted``
(np,) is zero:

* jump  [[u]] = u(X) - u(Y),  gap  g = g0 - [[u]] . n,  slip  D_T = (I - n n)([[u]] - w) with w the jump at the end of
  the last load step on the same pair of points, plus what a rigid obstacle has moved since
* traction of the source  t = sigma(u) n_X,  T[v] = sigma(v) n_X
* G = gamma (n n + alpha (I - n n)),  augmented traction  tau = t + gamma g n - alpha gamma D_T,  P = project(tau)

    residual   R  = - int P . [[v]] + theta int (P - t) . G^-1 T[v]
    tangent    K  = int [[v]] . D (G [[w]] - S[w]) - theta T[v] . G^-1 (D G [[w]] + (I - D) S[w]),   D = dP/dtau

with S = dt/du, which is T unless the cell yields, as in Chouly, Mlika, Renard (2018), with the matrix G^-1 as the
weight of the adjoint term, so that theta = 1 stays symmetric when alpha is not 1. P (np, d), D (np, d, d) and the
status (np,) come from the law between these kernels, see `pcontact.contact.law`; a point without partner has P = 0.
Nodes are numbers into ``u`` (n, d). Where the gradients have width 0 there is no traction of the source, t = S = 0 at
theta = 0: the penalty method, see `pcontact.contact.formulation.methods`.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import find
from pcontact.runtime.jit import njit, njit_inner


@njit_inner
def jumps(u, source, partner, wanted, out):
    """Jump [[u]] (np, d) [length] of the displacement u (n, d)."""
    facet, cells, shape, nodes = source.facet, source.cells, source.shape, partner.nodes
    d = u.shape[1]
    for p in range(len(facet)):
        f = facet[p]
        for i in range(d):
            out[p, i] = 0.0
        if not wanted[p]:
            continue
        for a in range(cells.shape[1]):
            for i in range(d):
                out[p, i] += shape[p, a] * u[cells[f, a], i]
        for m in range(nodes.shape[1]):
            for i in range(d):
                out[p, i] -= partner.shape[p, m] * u[nodes[p, m], i]


@njit_inner
def augment(parameters, source, partner, traction, jump, before, wanted, tau):
    """Augmented traction tau (np, d) [stress]; ``before`` (np, d) is the jump from which slip counts."""
    gamma, alpha, facet = parameters.gamma, parameters.alpha, source.facet
    normal, gap0 = partner.normal, partner.gap0
    d = normal.shape[1]
    for p in range(len(facet)):
        for i in range(d):
            tau[p, i] = 0.0
        if not wanted[p]:
            continue
        stiff = gamma[facet[p]]
        along, along_slip = 0.0, 0.0
        for i in range(d):
            along += jump[p, i] * normal[p, i]
            along_slip += (jump[p, i] - before[p, i]) * normal[p, i]
        for i in range(d):
            slip = jump[p, i] - before[p, i] - along_slip * normal[p, i]
            tau[p, i] = traction[p, i] + stiff * ((gap0[p] - along) * normal[p, i] - alpha[facet[p]] * slip)


@njit_inner
def _node_operator(grad, volumetric, mu, normal_x, out):
    """out[i, j] = d t_i / d u_j of one node, from its shape gradient and volumetric operator (d,)."""
    d = len(normal_x)
    along = 0.0
    for i in range(d):
        along += grad[i] * normal_x[i]
    for i in range(d):
        for j in range(d):
            out[i, j] = normal_x[i] * volumetric[j] + mu * grad[i] * normal_x[j]
        out[i, i] += mu * along


@njit
def add_residual(parameters, source, partner, traction, force, status, out):
    """Add the residual of the pair to ``out`` (n, d) [force].

    Parameters
    ----------
    parameters : pcontact.contact.formulation.parameters.Parameters
    source : pcontact.contact.points.SourcePoints
    partner : pcontact.contact.points.PartnerPoints
    traction, force : ndarray (np, d)
        t and P [stress].
    status : ndarray (np,)
        Points that are open have P = 0.
    out : ndarray (n, d)
    """
    d = partner.normal.shape[1]
    _add_forces(parameters, source, partner, traction, force, status, out, np.zeros((d + 1, d)))


@njit_inner
def _add_forces(parameters, source, partner, traction, force, status, out, work):
    theta, alpha, gamma = parameters.theta, parameters.alpha, parameters.gamma
    weight, operator = work[0], work[1:]
    facet, cells, shape, jxw = source.facet, source.cells, source.shape, source.jxw
    grad, nodes, normal = source.grad, partner.nodes, partner.normal
    d = normal.shape[1]
    for p in range(len(facet)):
        f = facet[p]
        if theta != 0.0:
            _weigh(force[p], traction[p], normal[p], gamma[f], alpha[f], theta * jxw[p], weight)
            for a in range(grad.shape[1]):
                node = cells[f, a]
                _node_operator(grad[p, a], source.volumetric[p, a], source.mu[f], source.normal[p], operator)
                for j in range(d):
                    for i in range(d):
                        out[node, j] += weight[i] * operator[i, j]
        if status[p] == 0:
            continue
        for a in range(cells.shape[1]):
            for i in range(d):
                out[cells[f, a], i] -= jxw[p] * shape[p, a] * force[p, i]
        for m in range(nodes.shape[1]):
            for i in range(d):
                out[nodes[p, m], i] += jxw[p] * partner.shape[p, m] * force[p, i]


@njit_inner
def _weigh(force, traction, normal, gamma, alpha, factor, out):
    """out = factor G^-1 (P - t)."""
    d = len(normal)
    along = 0.0
    for i in range(d):
        along += (force[i] - traction[i]) * normal[i]
    for i in range(d):
        across = force[i] - traction[i] - along * normal[i]
        out[i] = factor / gamma * (along * normal[i] + across / alpha)


class _Operators(NamedTuple):
    """Operators of one point, computed anew for each.

    Attributes
    ----------
    part : ndarray (nn + nt,)
        N: shape functions of the nodes of its parent cell, minus those of the nodes of its partner.
    elastic, real : ndarray (nn + nt, d, d)
        T and S [stress/length].
    stiff, inverse : ndarray (d, d)
        D G [stress/length], G^-1.
    pull, weak : ndarray (nn + nt, d, d)
        D (G N - S) [stress/length], G^-1 (D G N + (I - D) S).
    """

    part: np.ndarray
    elastic: np.ndarray
    real: np.ndarray
    stiff: np.ndarray
    inverse: np.ndarray
    pull: np.ndarray
    weak: np.ndarray


@njit
def add_tangent(parameters, source, partner, excess, status, slope, blocks):
    """Add the generalised Jacobian of the pair to block values; returns how many entries had no place.

    Parameters
    ----------
    parameters : pcontact.contact.formulation.parameters.Parameters
    source : pcontact.contact.points.SourcePoints
    partner : pcontact.contact.points.PartnerPoints
    excess : pcontact.contact.points.Excess
        What is added to T in S, and from which row on S stands in the place of T.
    status : ndarray (np,)
    slope : ndarray (np, d, d)
        D, zero where points are open.
    blocks : pcontact.assembly.graph.BlockRows
    """
    d, n = partner.normal.shape[1], source.cells.shape[1] + partner.nodes.shape[1]
    operators = _Operators(
        np.zeros(n), np.zeros((n, d, d)), np.zeros((n, d, d)), np.zeros((d, d)), np.zeros((d, d)),
        np.zeros((n, d, d)), np.zeros((n, d, d)),
    )  # fmt: skip
    return _add_blocks(parameters, source, partner, excess, status, slope, operators, blocks)


@njit_inner
def _add_blocks(parameters, source, partner, excess, status, slope, operators, blocks):
    theta, alpha, gamma = parameters.theta, parameters.alpha, parameters.gamma
    part, elastic, real = operators.part, operators.elastic, operators.real
    pull, weak = operators.pull, operators.weak
    facet, cells, shape, jxw = source.facet, source.cells, source.shape, source.jxw
    grad, nodes, normal, at = source.grad, partner.nodes, partner.normal, excess.at
    rowptr, columns, values = blocks.rowptr, blocks.columns, blocks.values
    d, nn, nt = normal.shape[1], cells.shape[1], nodes.shape[1]
    missing = 0
    for p in range(len(facet)):
        f = facet[p]
        touches = status[p] > 0
        if not touches and theta == 0.0:
            continue
        _stiffness(slope[p], normal[p], gamma[f], alpha[f], operators.stiff, operators.inverse)
        width = nn + nt if touches else nn
        exceeds = len(at) > 0 and at[p] >= 0
        adjoint = real if exceeds and at[p] >= excess.adjoint else elastic
        for a in range(nn):
            part[a] = shape[p, a]
        for a in range(grad.shape[1]):
            _node_operator(grad[p, a], source.volumetric[p, a], source.mu[f], source.normal[p], elastic[a])
            for i in range(d):
                for j in range(d):
                    real[a, i, j] = elastic[a, i, j] + (excess.rows[at[p], a, i, j] if exceeds else 0.0)
        for m in range(nt):
            part[nn + m] = -partner.shape[p, m]
        _columns(theta, width, slope[p], operators)
        for r in range(width):
            row = cells[f, r] if r < nn else nodes[p, r - nn]
            for c in range(width):
                column = cells[f, c] if c < nn else nodes[p, c - nn]
                k = find(columns, rowptr[row], rowptr[row + 1], column)
                if k < 0:
                    missing += 1
                    continue
                for i in range(d):
                    for j in range(d):
                        value = part[r] * pull[c, i, j]
                        if theta != 0.0:
                            for m in range(d):
                                value -= theta * adjoint[r, m, i] * weak[c, m, j]
                        values[k, i, j] += jxw[p] * value
    return missing


@njit_inner
def _stiffness(slope, normal, gamma, alpha, stiff, inverse):
    """stiff = D G,  inverse = G^-1."""
    d = len(normal)
    for i in range(d):
        along = 0.0
        for m in range(d):
            along += slope[i, m] * normal[m]
        for j in range(d):
            nn = normal[i] * normal[j]
            unit = 1.0 if i == j else 0.0
            stiff[i, j] = gamma * (alpha * slope[i, j] + (1.0 - alpha) * along * normal[j])
            inverse[i, j] = (nn + (unit - nn) / alpha) / gamma


@njit_inner
def _columns(theta, width, slope, operators):
    """For the first nodes: pull = D (G N - S),  weak = G^-1 (D G N + (I - D) S)."""
    part, operator, stiff, inverse = operators.part, operators.real, operators.stiff, operators.inverse
    pull, weak = operators.pull, operators.weak
    d = slope.shape[0]
    for c in range(width):
        for i in range(d):
            for j in range(d):
                through = 0.0
                for m in range(d):
                    through += slope[i, m] * operator[c, m, j]
                pull[c, i, j] = part[c] * stiff[i, j] - through
        if theta == 0.0:
            continue
        for i in range(d):
            for j in range(d):
                value = 0.0
                for m in range(d):
                    value += inverse[i, m] * (pull[c, m, j] + operator[c, m, j])
                weak[c, i, j] = value
