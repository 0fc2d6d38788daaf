"""Contact at finite motion: residual and tangent at the quadrature points of the source, over its undeformed surface.

With normal n, gap g and tangential slip s_T = (I - n n) s of `pcontact.contact.formulation.finite_geometry`, and the
nominal traction t = P1 N of the source (force per undeformed area),

    tau = t + gamma (g n - alpha s_T),    P = project(tau, n)
    R   = - int P . [[v]] + theta int (P - t) . G^-1 T[v],    G^-1 = (n n + (I - n n) / alpha) / gamma

T[v] is the derivative of t in the committed state with elastic moduli: linear in v and constant. Without friction s
does not exist, and 1 / alpha is 0. The tangent is exact; partner, gap and normal move with the bodies:

    dtau = dt + gamma (n dg + g dn - alpha ds_T),    ds_T = (I - n n) ds - (n . s) dn - n (s . dn)
    dP   = D dtau + P_n dn - n (P . dn) - D (tau_n dn - n (tau . dn)),    D = dP/dtau
    dR   = - int dP . [[v]] + int (P . v_T,i) dxi_i + theta int (G^-1 (dP - dt) + dG^-1 (P - t)) . T[v]
    dG^-1 = (1 - 1 / alpha) / gamma (dn n + n dn)

What n does to P at a fixed tau follows from D, whatever the law: turning tau and n together turns P.

Where the traction is that of both sides, t = w1 t1 - w2 J t2 with the nominal traction t2 of the partner's cell per its
own undeformed area, at the partner, and J of `finite_geometry`, it moves with the partner, too:

    dt = w1 dt1 - w2 J (dt2 + t2,i dxi_i) - w2 t2 dJ

The weights do not change in a load step; T[v] is that of the partner and the J of the last search. Without a partner
t = w1 t1.

Terms with dn and dxi in them have no sign, and are of the order of |P| / size of the facet, where those with dg are of
the order of gamma. At a solution, where g is small, they are small beside these. At an iterate in which bodies overlap
by a good part of a facet they are not: the tangent would be indefinite and say nothing of what comes after the overlap.
So dn and dxi are scaled by depth / |g| where the overlap is beyond a depth that solutions do not reach. What they make
of ds is as large, and scaled by the same: at g = 0 ds_T is the relative displacement along the surface.

Parameters of kernels not told there: `source`, `partner`, `motion` as in `finite_geometry`.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.graph import find
from pcontact.contact.formulation.finite_geometry import (
    NONE,
    PointWork,
    derive_point,
    derive_ratio,
    dot,
    place_point,
    point_work,
)
from pcontact.contact.surface.facet_maps import NODE_COUNTS
from pcontact.runtime.jit import njit, njit_inner


class FiniteParameters(NamedTuple):
    """Weights of the terms of a pair.

    Attributes
    ----------
    theta : float
    alpha, inverse : ndarray (np,)
        alpha and 1 / alpha; both 0 without friction.
    gamma : ndarray (np,)
        [stress/length]
    adjoint : ndarray (np, nr, d, d)
        T, row i of it the traction t_i, of the nodes of the source's cell or of both cells [stress/length]; of length 0
        where theta = 0.
    depth : ndarray (nf,)
        Overlap beyond which the tangent turns normals and moves partners in part only [length].
    """

    theta: float
    alpha: np.ndarray
    inverse: np.ndarray
    gamma: np.ndarray
    adjoint: np.ndarray
    depth: np.ndarray


class Acting(NamedTuple):
    """Tractions of the points (np).

    Attributes
    ----------
    traction, tau, force : ndarray (np, d)
        t, tau and P [stress].
    status : ndarray (np,)
        0 where P = 0.
    slope : ndarray (np, d, d)
        D, zero where points are open; of length 0 where it is not asked for.
    """

    traction: np.ndarray
    tau: np.ndarray
    force: np.ndarray
    status: np.ndarray
    slope: np.ndarray


class Sides(NamedTuple):
    """The part of partners in the tractions of the points (np).

    Attributes
    ----------
    weight : ndarray (np,)
        -w2; of length 0 where all tractions are those of the source.
    traction : ndarray (np, d)
        t2 [stress].
    along : ndarray (np, 2, d)
        t2,i [stress].
    axis : float
        Where the axis of symmetry is, relative to the origin; infinite without one [length].
    """

    weight: np.ndarray
    traction: np.ndarray
    along: np.ndarray
    axis: float


ALONE = Sides(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0, 0)), np.inf)


class Slopes(NamedTuple):
    """Derivatives of tractions of some points.

    Attributes
    ----------
    at : ndarray (np,)
        Row of each point in ``rows``, -1 where the traction is constant.
    rows : ndarray (n, nn or nr, d, d)
        dt_i / du_aj at a partner and J that do not move, of the nodes of the source's cell or of both cells
        [stress/length].
    sides : Sides
    """

    at: np.ndarray
    rows: np.ndarray
    sides: Sides = ALONE


@njit
def augment(parameters, placed, traction, tau):
    """tau (np, d) of points with the traction (np, d), where they are `Placed`; 0 without partner."""
    for p in range(len(tau)):
        gamma, alpha = parameters.gamma[p], parameters.alpha[p]
        for i in range(tau.shape[1]):
            tau[p, i] = 0.0
            if placed.live[p]:
                pushed = placed.gap[p] * placed.normal[p, i] - alpha * placed.slip[p, i]
                tau[p, i] = traction[p, i] + gamma * pushed


@njit_inner
def _weigh(gamma, inverse, n, v, out):
    """out = G^-1 v."""
    along = dot(v, n)
    for i in range(len(n)):
        out[i] = (along * n[i] + (v[i] - along * n[i]) * inverse) / gamma


@njit_inner
def _node(source, partner, p, c):
    """Node c of a point: those of the source's cell, of the partner's facet, and the others of its cell."""
    nn, mt = source.cells.shape[1], partner.nodes.shape[1]
    if c < nn:
        return source.cells[source.facet[p], c]
    return partner.nodes[p, c - nn] if c < nn + mt else partner.others[p, c - nn - mt]


@njit
def add_residual(parameters, source, partner, placed, acting, out):
    """Add the residual to ``out`` (n, d) [force]; ``placed`` is what `evaluate` says."""
    normal, force, adjoint, d = placed.normal, acting.force, parameters.adjoint, placed.normal.shape[1]
    rest, weight = np.zeros(d), np.zeros(d)
    for p in range(len(source.facet)):
        f, w = source.facet[p], source.jxw[p]
        if parameters.theta != 0.0:
            for i in range(d):
                rest[i] = force[p, i] - acting.traction[p, i]
            _weigh(parameters.gamma[p], parameters.inverse[p], normal[p], rest, weight)
            for a in range(adjoint.shape[1]):
                node = _node(source, partner, p, a)
                for j in range(d):
                    value = 0.0
                    for i in range(d):
                        value += weight[i] * adjoint[p, a, i, j]
                    out[node, j] += parameters.theta * w * value
        if acting.status[p] == 0:
            continue
        for a in range(source.on.shape[1]):
            for i in range(d):
                out[source.cells[f, source.on[f, a]], i] -= w * source.shape[p, a] * force[p, i]
        for m in range(partner.nodes.shape[1]):
            for i in range(d):
                out[partner.nodes[p, m], i] += w * placed.shape[p, m] * force[p, i]


class TangentWork(NamedTuple):
    """Scratch of the tangent, with columns for the displacements of all nodes of a cell and its partner.

    Attributes
    ----------
    dt, dtau, dforce, weak : ndarray (d, n)
        dt; dtau, later without what turns; dP; G^-1 (dP - dt) + dG^-1 (P - t).
    dn : ndarray (d, n)
    rest, turned : ndarray (d,)
    point : pcontact.contact.formulation.finite_geometry.PointWork
        For the nodes of both facets.
    """

    dt: np.ndarray
    dtau: np.ndarray
    dforce: np.ndarray
    weak: np.ndarray
    dn: np.ndarray
    rest: np.ndarray
    turned: np.ndarray
    point: PointWork


def tangent_work(d, nn, ms, mt, others=0):
    """Scratch for cells of nn nodes, ms of which are on the facet, and partners of mt nodes and others of the cell."""
    wide = (np.zeros((d, (nn + mt + others) * d)) for _ in range(5))
    return TangentWork(*wide, np.zeros(d), np.zeros(d), point_work(d, ms + mt))


@njit_inner
def _fill_dt(slopes, ratio, p, places, work, out):
    """dt, with J ratio where the point has a partner, else 0; ``places`` are ms, nn, mt and the facet's nodes."""
    d, row, (ms, nn, mt, on), sides = len(work.n), slopes.at[p], places, slopes.sides
    out.dt[:, :] = 0.0
    if row >= 0:
        for a in range(slopes.rows.shape[1]):
            for i in range(d):
                for j in range(d):
                    out.dt[i, a * d + j] = slopes.rows[row, a, i, j]
    if ratio == 0.0:
        return
    factor = sides.weight[p] * ratio
    for slot in range(ms + mt):
        place = on[slot] if slot < ms else nn + slot - ms
        for j in range(d):
            k, column = slot * d + j, place * d + j
            for i in range(d):
                moved = sides.traction[p, i] * work.dj[k]
                for q in range(d - 1):
                    moved += sides.along[p, q, i] * work.dxi[q, k]
                out.dt[i, column] += factor * moved


@njit_inner
def _fill_dtau(gamma, alpha, ms, nn, mt, on, work, out):
    """dt + gamma (n dg + g dn - alpha ds_T), and dn in the columns of the nodes of both facets."""
    d, n, g, s = len(work.n), work.n, work.gap[0], work.slip
    across = dot(n, s)
    out.dn[:, :] = 0.0
    for k in range(out.dt.shape[1]):
        for i in range(d):
            out.dtau[i, k] = out.dt[i, k]
    for slot in range(ms + mt):
        place = on[slot] if slot < ms else nn + slot - ms
        for j in range(d):
            k, column = slot * d + j, place * d + j
            slides, turns = 0.0, 0.0
            if alpha != 0.0:
                for i in range(d):
                    slides += n[i] * work.ds[i, k]
                    turns += s[i] * work.dn[i, k]
            for i in range(d):
                dn = work.dn[i, k]
                value = n[i] * work.dg[k] + g * dn
                if alpha != 0.0:
                    slip = work.ds[i, k] - n[i] * slides - across * dn - n[i] * turns
                    value -= alpha * slip
                out.dtau[i, column] += gamma * value
                out.dn[i, column] += dn


@njit_inner
def _fill_dforce(n, tau, force, slope, columns, out):
    """dP = D (dtau - tau_n dn + n (tau . dn)) + P_n dn - n (P . dn)."""
    d = len(n)
    tau_n, force_n = dot(tau, n), dot(force, n)
    for k in range(columns):
        along, pushed = 0.0, 0.0
        for i in range(d):
            along += tau[i] * out.dn[i, k]
            pushed += force[i] * out.dn[i, k]
        for i in range(d):
            out.turned[i] = out.dtau[i, k] - tau_n * out.dn[i, k] + n[i] * along
        for i in range(d):
            value = force_n * out.dn[i, k] - n[i] * pushed
            for q in range(d):
                value += slope[i, q] * out.turned[q]
            out.dforce[i, k] = value


@njit_inner
def _fill_weak(gamma, inverse, n, columns, out):
    """G^-1 (dP - dt) + dG^-1 (P - t) with P - t in out.rest."""
    d = len(n)
    factor, along = (1.0 - inverse) / gamma, dot(out.rest, n)
    for k in range(columns):
        turn = 0.0
        for i in range(d):
            out.turned[i] = out.dforce[i, k] - out.dt[i, k]
            turn += out.dn[i, k] * out.rest[i]
        between = dot(out.turned, n)
        for i in range(d):
            value = (between * n[i] + (out.turned[i] - between * n[i]) * inverse) / gamma
            out.weak[i, k] = value + factor * (out.dn[i, k] * along + n[i] * turn)


@njit_inner
def _damp(depth, shape, count, work):
    """Scale dn and d xi, and ds beside [[du]], of a point whose overlap is beyond a depth; ``shape`` (ms,) is that of
    the source, ``count`` nodes are on the target."""
    if -work.gap[0] <= depth:
        return
    d, part, ms = len(work.n), -depth / work.gap[0], len(shape)
    for k in range((ms + count) * d):
        slot, j = k // d, k % d
        for i in range(d):
            work.dn[i, k] *= part
            work.ds[i, k] *= part
        work.ds[j, k] += (1.0 - part) * (shape[slot] if slot < ms else -work.shapes[0, slot - ms])
        work.dxi[0, k] *= part
        work.dxi[1, k] *= part


@njit
def add_tangent(parameters, source, partner, motion, acting, slopes, out, blocks):
    """Add the tangent to block rows; returns how many entries had no place.

    Parameters
    ----------
    acting : Acting
    slopes : Slopes
    out : TangentWork
    blocks : pcontact.assembly.graph.BlockRows
    """
    theta, adjoint, work, sides = parameters.theta, parameters.adjoint, out.point, slopes.sides
    d, nn, ms, mt = motion.u.shape[1], source.cells.shape[1], source.on.shape[1], partner.nodes.shape[1]
    missing = 0
    for p in range(len(source.facet)):
        force = acting.force[p]
        if acting.status[p] == 0 and theta == 0.0:
            continue
        f = source.facet[p]
        gamma, alpha = parameters.gamma[p], parameters.alpha[p]
        slides = alpha != 0.0
        found = place_point(source, partner, motion, p, slides, work)
        # what is open does not depend on its partner, but for the normal of the closest point
        mode = partner.mode[p] if found else NONE
        derive_point(source, partner, p, mode, slides, work)
        _damp(parameters.depth[f], source.shape[p], min(mt, NODE_COUNTS[partner.kind[p]]), work)
        both, ratio = len(sides.weight) > 0 and sides.weight[p] != 0.0, 0.0
        if both and found:
            ratio = derive_ratio(source, partner, motion, p, sides.axis, work)
        columns = (nn + mt + (partner.others.shape[1] if both else 0)) * d
        _fill_dt(slopes, ratio, p, (ms, nn, mt, source.on[f]), work, out)
        _fill_dtau(gamma if found else 0.0, alpha, ms, nn, mt, source.on[f], work, out)
        _fill_dforce(work.n, acting.tau[p], force, acting.slope[p], columns, out)
        if theta != 0.0:
            for i in range(d):
                out.rest[i] = force[i] - acting.traction[p, i]
            _fill_weak(gamma, parameters.inverse[p], work.n, columns, out)
            rows = columns // d if both else nn
            missing += _add_weak(theta * source.jxw[p], source, partner, p, adjoint[p, :rows], columns, out, blocks)
        if acting.status[p] > 0:
            missing += _add_pressed(source.jxw[p], source, partner, p, force, columns, out, blocks)
    return missing


@njit_inner
def _add_pressed(weight, source, partner, p, force, columns, out, blocks):
    """- int dP . [[v]] + int (P . v_T,i) dxi_i"""
    f, d, work = source.facet[p], len(force), out.point
    ms, mt = source.on.shape[1], partner.nodes.shape[1]
    missing, mt = 0, min(mt, NODE_COUNTS[partner.kind[p]])
    for r in range(ms + mt):
        m = r - ms
        row = partner.nodes[p, m] if m >= 0 else source.cells[f, source.on[f, r]]
        part = work.shapes[0, m] if m >= 0 else -source.shape[p, r]
        for c in range(columns // d):
            column = _node(source, partner, p, c)
            k = find(blocks.columns, blocks.rowptr[row], blocks.rowptr[row + 1], column)
            if k < 0:
                missing += 1
                continue
            for i in range(d):
                for j in range(d):
                    blocks.values[k, i, j] += weight * part * out.dforce[i, c * d + j]
        if m < 0:
            continue
        for s in range(ms + mt):
            column = source.cells[f, source.on[f, s]] if s < ms else partner.nodes[p, s - ms]
            k = find(blocks.columns, blocks.rowptr[row], blocks.rowptr[row + 1], column)
            if k < 0:
                missing += 1
                continue
            for j in range(d):
                moved = work.shapes[1, m] * work.dxi[0, s * d + j] + work.shapes[2, m] * work.dxi[1, s * d + j]
                for i in range(d):
                    blocks.values[k, i, j] += weight * moved * force[i]
    return missing


@njit_inner
def _add_weak(weight, source, partner, p, adjoint, columns, out, blocks):
    """theta int (G^-1 (dP - dt) + dG^-1 (P - t)) . T[v]; a node that nothing depends on needs no place."""
    d, missing = adjoint.shape[1], 0
    for c in range(columns // d):
        still = True
        for j in range(d):
            for i in range(d):
                still = still and out.weak[i, c * d + j] == 0.0
        if still:
            continue
        column = _node(source, partner, p, c)
        for r in range(len(adjoint)):
            row = _node(source, partner, p, r)
            k = find(blocks.columns, blocks.rowptr[row], blocks.rowptr[row + 1], column)
            if k < 0:
                missing += 1
                continue
            for i in range(d):
                for j in range(d):
                    value = 0.0
                    for q in range(d):
                        value += adjoint[r, q, i] * out.weak[q, c * d + j]
                    blocks.values[k, i, j] += weight * value
    return missing
