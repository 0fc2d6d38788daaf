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
    """Work arrays of a kernel: of each point with its nr nodes, and the sum over points of the same nodes.

    Attributes
    ----------
    part : ndarray (nr,)
        N: shape functions of the nodes of its parent cell, minus those of the nodes of its partner.
    real : ndarray (m, nr d)
        S [stress/length].
    stiff, inverse : ndarray (m, m)
        D G [stress/length], G^-1.
    left, right : ndarray (2 m, nr d)
        The tangent is left^T right: N along the axes and -theta T, times D (G N - S) [stress/length] and
        G^-1 (D G N + (I - D) S).
    total : ndarray (nr d, nr d)
        Of the points so far.
    felt : ndarray (nr,) of bool
        Nodes that they test: those of the cells that are not on their facets feel nothing at theta = 0.
    """

    part: np.ndarray
    real: np.ndarray
    stiff: np.ndarray
    inverse: np.ndarray
    left: np.ndarray
    right: np.ndarray
    total: np.ndarray
    felt: np.ndarray


@njit
def add_tangent(parameters, source, partner, operator, excess, status, slope, blocks):
    """Add the generalised Jacobian of the pair to block values; returns how many entries had no place.

    Points in a row that have the same nodes are added to each other first.

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
        np.zeros(n), np.zeros((m, n * d)), np.zeros((m, m)), np.zeros((m, m)), np.zeros((2 * m, n * d)),
        np.zeros((2 * m, n * d)), np.zeros((n * d, n * d)), np.zeros(n, np.bool_),
    )  # fmt: skip
    theta, alpha, gamma = parameters.theta, parameters.alpha, parameters.gamma
    nn, on, missing, first, most = source.cells.shape[1], partner.shape.shape[1], 0, -1, 0
    for p in range(len(source.facet)):
        touches = status[p] > 0
        if not touches and theta == 0.0:
            continue
        if first < 0 or not _alike(source.facet, partner.nodes, first, p):
            if first >= 0:
                missing += _scatter(source.cells[source.facet[first]], partner.nodes[first], most, work, blocks)
            first, most = p, 0
        _stiffness(slope[p], operator.normal[p], gamma[p], alpha[p], work.stiff, work.inverse)
        # other nodes of the partner's cell count where it has a part in the traction
        width = max(operator.width[p], nn + on) if touches else operator.width[p]
        most = max(most, width)
        for r in range(width):
            work.part[r] = source.shape[p, r] if r < nn else -partner.shape[p, r - nn] if r < nn + on else 0.0
        _factors(theta, p, width, source.jxw[p], operator, excess, work)
        _right(theta, width, slope[p], operator.axes[min(p, len(operator.axes) - 1)], work)
        for a in range(width * d):
            # with D = 0 the first right factors are zero
            for k in range(0 if touches else m, 2 * m if theta != 0.0 else m):
                left = work.left[k, a]
                for b in range(width * d):
                    work.total[a, b] += left * work.right[k, b]
    if first >= 0:
        missing += _scatter(source.cells[source.facet[first]], partner.nodes[first], most, work, blocks)
    return missing


@njit_inner
def _alike(facet, nodes, p, q):
    """Return True if two points have the same nodes."""
    if facet[p] != facet[q]:
        return False
    for a in range(nodes.shape[1]):
        if nodes[p, a] != nodes[q, a]:
            return False
    return True


@njit_inner
def _factors(theta, p, width, jxw, operator, excess, work):
    """S and the left factors of the first nodes of a point."""
    rows, axes, part, m, d = operator.rows, operator.axes, work.part, operator.axes.shape[1], operator.axes.shape[2]
    e, row = min(p, len(axes) - 1), excess.at[p] if len(excess.at) > 0 else -1
    # the adjoint operator is T, or S
    consistent = row >= 0 and row >= excess.adjoint
    for r in range(width):
        for k in range(m):
            for j in range(d):
                own = rows[p, r, k, j] if r < rows.shape[1] else 0.0
                real = own + (excess.rows[row, r, k, j] if row >= 0 and r < excess.rows.shape[1] else 0.0)
                work.real[k, r * d + j] = real
                work.left[k, r * d + j] = jxw * part[r] * axes[e, k, j]
                work.left[m + k, r * d + j] = -theta * jxw * (real if consistent else own)
        work.felt[r] = work.felt[r] or part[r] != 0.0 or theta != 0.0


@njit_inner
def _scatter(cell, partner, width, work, blocks):
    """Add the total of points whose nodes are those of a cell and of a partner to blocks, and begin anew; returns how
    many of its entries had no place."""
    nn, d, missing, total = len(cell), blocks.values.shape[1], 0, work.total
    for r in range(width):
        row = cell[r] if r < nn else partner[r - nn]
        for c in range(width if work.felt[r] else 0):
            column = cell[c] if c < nn else partner[c - nn]
            k = find(blocks.columns, blocks.rowptr[row], blocks.rowptr[row + 1], column)
            if k < 0:
                missing += 1
                continue
            for i in range(d):
                for j in range(d):
                    blocks.values[k, i, j] += total[r * d + i, c * d + j]
        work.felt[r] = False
    total[: width * d, : width * d] = 0.0
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
def _right(theta, width, slope, axes, work):
    """The right factors of the first nodes: D (G N - S),  G^-1 (D G N + (I - D) S)."""
    part, real, stiff, inverse, right = work.part, work.real, work.stiff, work.inverse, work.right
    m, d = axes.shape
    for k in range(m):
        for c in range(width):
            for j in range(d):
                value = 0.0
                for n in range(m):
                    value += part[c] * stiff[k, n] * axes[n, j] - slope[k, n] * real[n, c * d + j]
                right[k, c * d + j] = value
    if theta == 0.0:
        return
    for k in range(m):
        for b in range(width * d):
            value = 0.0
            for n in range(m):
                value += inverse[k, n] * (right[n, b] + real[n, b])
            right[m + k, b] = value
