"""Contact without friction: compiled kernels at the quadrature points of the source.

Notation of every kernel, one row per quadrature point p on facet f = facet[p]:

* jump operator along the normal  N = n (x) [shape, -target_shape]
* normal traction of the source   t_n = b . u_cell,  b = n . d(sigma(u) n_X)/du
* gap  g = g0 - N u,  augmented traction  tau = t_n + gamma g,  P = min(tau, 0)

    residual   R  = - int P N . v + (theta / gamma) int (P - t_n) b . v
    tangent    K  = int H (gamma N N^T - N c^T - theta b N^T) - theta / gamma (1 - H) b c^T,   H = 1 where tau <= 0

with c = dt_n/du, which is b unless the cell yields; this is (R) and its generalised derivative with the normal parts
alone (Chouly, Hild 2013). P (np,) and H (np,) come from the law, see `pcontact.contact.law`: a point without partner
has P = 0 and H = 0, bilateral contact (no separation) P = tau and H = 1 always. Nodes are numbers into ``u`` (n, d).
Where ``b`` has width 0 there is no traction of the source, t_n = c = 0 at theta = 0: the penalty method, see
`pcontact.contact.formulation.methods`.
"""

import numpy as np

from pcontact.assembly.graph import find
from pcontact.runtime.jit import njit


@njit
def evaluate(u, source, partner, b, traction, gap):
    """Normal traction t_n (np,) and gap (np,) at the displacement u (n, d).

    Parameters
    ----------
    u : ndarray (n, d)
    source : pcontact.contact.points.SourcePoints
    partner : pcontact.contact.points.PartnerPoints
    b : ndarray (np, nn, d)
    traction, gap : ndarray (np,)
        Out [stress], [length].
    """
    facet, cells, shape = source.facet, source.cells, source.shape
    nodes, normal = partner.nodes, partner.normal
    d = normal.shape[1]
    for p in range(len(facet)):
        f = facet[p]
        t = 0.0
        g = partner.gap0[p]
        for a in range(b.shape[1]):
            node = cells[f, a]
            for i in range(d):
                t += b[p, a, i] * u[node, i]
                g -= shape[p, a] * normal[p, i] * u[node, i]
        for a in range(b.shape[1], cells.shape[1]):
            node = cells[f, a]
            for i in range(d):
                g -= shape[p, a] * normal[p, i] * u[node, i]
        for m in range(nodes.shape[1]):
            node = nodes[p, m]
            for i in range(d):
                g += partner.shape[p, m] * normal[p, i] * u[node, i]
        traction[p] = t
        gap[p] = g


@njit
def add_residual(parameters, source, partner, b, traction, pressure, out):
    """Add the residual of the pair to ``out`` (n, d) [force]; ``pressure`` (np,) is P [stress]."""
    theta, gamma = parameters.theta, parameters.gamma
    facet, cells, shape, jxw = source.facet, source.cells, source.shape, source.jxw
    nodes, normal = partner.nodes, partner.normal
    d, traces = normal.shape[1], b.shape[1] if theta != 0.0 else 0
    for p in range(len(facet)):
        f = facet[p]
        if pressure[p] == 0.0 and theta == 0.0:
            continue
        weight = theta / gamma[f] * (pressure[p] - traction[p]) * jxw[p]
        push = pressure[p] * jxw[p]
        for a in range(traces):
            node = cells[f, a]
            for i in range(d):
                out[node, i] += weight * b[p, a, i] - push * shape[p, a] * normal[p, i]
        for a in range(traces, cells.shape[1]):
            node = cells[f, a]
            for i in range(d):
                out[node, i] -= push * shape[p, a] * normal[p, i]
        for m in range(nodes.shape[1]):
            node = nodes[p, m]
            for i in range(d):
                out[node, i] += push * partner.shape[p, m] * normal[p, i]


@njit
def add_tangent(parameters, source, partner, b, excess, across, closed, blocks):
    """Add the generalised Jacobian of the pair to block values; returns how many entries had no place.

    Parameters
    ----------
    parameters : pcontact.contact.formulation.parameters.Parameters
    source : pcontact.contact.points.SourcePoints
    partner : pcontact.contact.points.PartnerPoints
    b : ndarray (np, nn, d)
    excess : pcontact.contact.points.Excess
        What is added to c, and from which row on c stands in the place of b.
    across : ndarray (n, nn, d)
        Its rows along the contact normal.
    closed : ndarray (np,) of bool
        H.
    blocks : pcontact.assembly.graph.BlockRows
    """
    theta, gamma = parameters.theta, parameters.gamma
    facet, cells, shape, jxw = source.facet, source.cells, source.shape, source.jxw
    nodes, normal, at = partner.nodes, partner.normal, excess.at
    rowptr, columns, values = blocks.rowptr, blocks.columns, blocks.values
    d, nn, nt = normal.shape[1], cells.shape[1], nodes.shape[1]
    # the block of rows r and columns c is w (jump[r] (x) push[c] - trac[r] (x) pull[c])
    jump, push = np.zeros((nn + nt, d)), np.zeros((nn + nt, d))
    trac, pull = np.zeros((nn + nt, d)), np.zeros((nn + nt, d))
    missing = 0
    for p in range(len(facet)):
        f, touches = facet[p], closed[p]
        if not touches and theta == 0.0:
            continue
        w, g = jxw[p], gamma[f]
        for a in range(nn):
            for i in range(d):
                jump[a, i] = w * shape[p, a] * normal[p, i] if touches else 0.0
        for m in range(nt):
            for i in range(d):
                jump[nn + m, i] = -w * partner.shape[p, m] * normal[p, i] if touches else 0.0
        for r in range(nn + nt):
            for i in range(d):
                slope, adjoint = 0.0, 0.0
                if r < b.shape[1]:
                    slope = adjoint = b[p, r, i]
                    if len(at) > 0 and at[p] >= 0:
                        slope += across[at[p], r, i]
                        if at[p] >= excess.adjoint:
                            adjoint = slope
                push[r, i] = g * jump[r, i] / w - slope
                trac[r, i] = theta * adjoint
                pull[r, i] = jump[r, i] if touches else w / g * slope
        width = nn + nt if touches else nn
        for r in range(width):
            row = cells[f, r] if r < nn else nodes[p, r - nn]
            if theta == 0.0:
                # nodes of the cell that are not on the facet feel nothing
                still = True
                for i in range(d):
                    still = still and jump[r, i] == 0.0
                if still:
                    continue
            for c in range(width):
                column = cells[f, c] if c < nn else nodes[p, c - nn]
                k = find(columns, rowptr[row], rowptr[row + 1], column)
                if k < 0:
                    missing += 1
                    continue
                for i in range(d):
                    for j in range(d):
                        values[k, i, j] += jump[r, i] * push[c, j] - trac[r, i] * pull[c, j]
    return missing
