"""Source facets cut where the target facet changes, so that no quadrature rule straddles a kink of the target.

The trace of the target's displacement along a source facet has a kink (and its gap a corner) wherever the partner moves
from one target facet to the next. A Gauss rule across such kinks leaves an error in the nodal forces of the target that
does not shrink relative to them when the mesh is refined, which limits the energy norm to order 1/2. In the plane the
partners of some points of each source facet are searched. Between two whose partners are on other facets these facets
tell where the partner changes (`.crossings`), and one more search around there whether it does. What is left, such as
facets between the two that no point has met, is divided further, and halved in the end, with the search itself, so
that every method of search, curved facets and partners on other ranks need nothing of their own.

A convex vertex of the target is the nearest point of all source points between the normals of the two facets that meet
there. The partner enters it from one facet and leaves it to the other: both places are kinks, and the source is cut at
both. Which of the two facets the search names in between, by their numbers, does not matter. At the end of a target
there is no other facet, and no cut.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from pcontact.contact.search.partners import PartnerSearch
from pcontact.contact.search.projection import FACING, Criteria, QueryPoints
from pcontact.contact.segmentation.crossings import crossings
from pcontact.contact.segmentation.overlaps import tiles
from pcontact.contact.surface.sides import at_places, default_quadrature
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import facet_nodes
from pcontact.element.shape import shape, shape_gradient
from pcontact.runtime.petsc import MPI

# intervals that each source facet starts with: a target facet shorter than one of them may be missed
SAMPLES = 8
# in the reference segment: how far on both sides of a place the partners are looked at, to tell whether it is a cut;
# more than what a node of the target holds to itself (`AT_NODE`) and what rays may pass beyond a facet, unless facets
# are ten times as large as the source's
AROUND = 1e-8
# width of an interval with a cut that is known to the last digit
LAST_DIGIT = 2.0**-52
# bisections that one search of more points stands for, at most, and how many points it may have; from: a search takes
# 0.6 ms, and 2 microseconds a point more
AT_ONCE, POINTS = 6, 5000
# shortest piece, in the reference segment
SLIVER = 1e-7
# shape function of a node that a partner sits on, but for rounding
AT_NODE = 1.0 - 1e-12


def _ends(space, target):
    """Global numbers (n,) of the nodes at the ends of a target in the plane: they are of one facet. *Collective.*"""
    node, count = np.unique(space.nodes[target.nodes[:, :2]], return_counts=True)
    # few are left of a rank's facets
    once = np.concatenate(space.comm.allgather(node[count == 1]))
    node, count = np.unique(once, return_counts=True)
    return node[count == 1]


class _Seen(NamedTuple):
    """Partners of points (n) of a source.

    Attributes
    ----------
    label : ndarray (n,) int64
        Number of the facet, -1: no partner, -2 and below: between two facets, on the node -2 minus this.
    id : ndarray (n,) int64
        Number of the facet, -1: no partner.
    ends : ndarray (n, 2) int64
        Numbers of the nodes at its ends.
    x : ndarray (n, m, 2)
        Its nodes [length].
    """

    label: np.ndarray
    id: np.ndarray
    ends: np.ndarray
    x: np.ndarray


class _Partners:
    """Places on the target of the partners of points of a source in the plane, in the undeformed bodies.

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : list of pcontact.mesh.mesh.Facets
        The source facets of this rank.
    search : (TargetSurface, float, str)
        Target, search radius [length] and method.

    Notes
    -----
    The constructor is *Collective*, and so are the calls.
    """

    def __init__(self, space, parts, search):
        self._target, self._radius, method = search
        still = np.zeros((space.n_local, space.dim))
        self._search = PartnerSearch(space, self._target, still, method, facets=True)
        self._criteria = Criteria(method == "ray_tracing", FACING, False)
        self._ends = _ends(space, self._target)
        none = np.zeros((0, 3, 2))
        self._nodes = np.concatenate([none, *(_nodes(space, facets) for facets in parts)])

    def __call__(self, facet, s):
        """Of points s (n,) on facets (n,): a :class:`_Seen`. *Collective.*"""
        some = self._nodes[facet]
        x = np.einsum("pa,pai->pi", shape("segment", 2, s[:, None]), some)
        along = np.einsum("pa,pai->pi", shape_gradient("segment", 2, s[:, None])[:, :, 0], some)
        normal = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
        found = self._search(QueryPoints(x, normal, self._radius), self._target.seen_from(facet, x).about)
        # the first two are the ends of a facet: its middle is no place to cut
        ends, weights = found.nodes[:, :2], found.shape[:, :2]
        second = weights[:, 1] > weights[:, 0]
        node = np.where(second, ends[:, 1], ends[:, 0])
        held = (found.id >= 0) & (weights.max(axis=1) > AT_NODE)
        held[held] = ~np.isin(node[held], self._ends)
        return _Seen(np.where(held, -2 - node, found.id), found.id, ends, found.facets)

    def between(self, facet, interval, seen, at):
        """Places (n, m) inside intervals (n, 2) of facets (n,) where the partner may change, or nan, from the partners
        of the points `at` (n, 2) of those seen: those of the ends of the intervals."""
        partners = seen.id[at], seen.ends[at], seen.x[at]
        return crossings(self._nodes[facet], interval, partners, self._criteria, self._radius)


def _nodes(space, facets):
    """Nodes (n, 3, 2) of facets of one part in the plane, of degree 2."""
    table, degree = space.mesh.geometry_nodes(space.mesh.blocks[facets.block])
    columns = facet_nodes(facets.cell, degree)[facets.local]
    x = space.mesh.points[table[facets.cells[:, None], columns]]
    return x if degree == 2 else np.concatenate([x, x.mean(axis=1, keepdims=True)], axis=1)


def _apart(facet, at):
    """Cuts of facets (n,), sorted, without slivers: cuts next to an end are left out, and several become their mean."""
    if not len(at):
        return facet, at
    new = (np.diff(facet, prepend=-1) != 0) | (np.diff(at, prepend=-np.inf) > SLIVER)
    cluster = np.cumsum(new) - 1
    mean = np.bincount(cluster, at) / np.bincount(cluster)
    lowest, highest = at[new], at[np.append(np.flatnonzero(new)[1:], len(at)) - 1]
    return facet[new], np.where(lowest == -1.0, -1.0, np.where(highest == 1.0, 1.0, mean))


def _at_once(n):
    """Bisections of n intervals that one search is to stand for."""
    return max([bits for bits in range(2, AT_ONCE + 1) if n * 4**bits <= POINTS], default=1)


class _Intervals(NamedTuple):
    """Intervals (n) of source facets at whose ends the partners are on other facets.

    Attributes
    ----------
    facet : ndarray (n,)
    a, b : ndarray (n,)
        Ends in the reference segment.
    at : ndarray (n, 2)
        The ends among the points that have been seen.
    """

    facet: np.ndarray
    a: np.ndarray
    b: np.ndarray
    at: np.ndarray

    def chosen(self, rows):
        """Some of them."""
        return _Intervals(*(column[rows] for column in self))


def _changes(partners, n, comm):
    """Places where the partners of points of n source facets change. *Collective.*

    Parameters
    ----------
    partners : _Partners
    n : int
        Facets of this rank.

    Returns
    -------
    facet, place : ndarray (m,)
        The place is in the reference segment.
    """
    # just inside the facet: at its ends the partner is a matter of rounding
    grid = np.linspace(-1.0 + 1e-9, 1.0 - 1e-9, SAMPLES + 1)
    facet, s = np.repeat(np.arange(n), SAMPLES + 1), np.tile(grid, n)
    seen, known, found = partners(facet, s), 0, []
    intervals = _changing(facet, s, np.arange(len(s)), seen.label)
    while True:
        width = intervals.b - intervals.a
        places = partners.between(intervals.facet, np.column_stack(intervals[1:3]), seen, intervals.at)
        several = ~np.isnan(places)
        near = (width <= 3.0 * AROUND) & several.any(axis=1)
        halved = (width <= LAST_DIGIT) & ~near
        k, j = np.nonzero(several & near[:, None])
        found.append((intervals.facet[k], places[k, j]))
        found.append((intervals.facet[halved], 0.5 * (intervals.a + intervals.b)[halved]))
        left = np.flatnonzero(~near & ~halved)
        most = comm.allreduce(len(left), op=MPI.MAX)
        if not most:
            break
        intervals, places = intervals.chosen(left), places[left]
        # where nothing is said, or was said twice and is not so, all of the interval is looked at
        lost = np.ones(len(left), dtype=bool) if known > 1 else np.isnan(places).all(axis=1)
        which, s = _inside(intervals, places, lost, _at_once(most))
        more = partners(intervals.facet[which], s)
        first, known = len(seen.label), known + 1
        seen = _Seen(*(np.concatenate(columns) for columns in zip(seen, more, strict=True)))
        # with the ends that were there
        which = np.concatenate([which, np.tile(np.arange(len(left)), 2)])
        s = np.concatenate([s, intervals.a, intervals.b])
        at = np.concatenate([first + np.arange(len(more.label)), *intervals.at.T])
        order = np.lexsort((s, which))
        intervals = _changing(which[order], s[order], at[order], seen.label[at[order]], intervals.facet)
    return tuple(np.concatenate(columns) for columns in zip(*found, strict=True))


def _changing(group, s, at, label, facet=None):
    """Intervals between points s (n,) of the same group, one after the other, with other labels (n,)."""
    k = np.flatnonzero((group[1:] == group[:-1]) & (label[1:] != label[:-1]))
    rows = group[k] if facet is None else facet[group[k]]
    return _Intervals(rows, s[k], s[k + 1], np.column_stack([at[k], at[k + 1]]))


def _inside(intervals, places, lost, bits):
    """Points to look at: on both sides of some places (n, m) in intervals (n), and all over those that are lost (n,).

    Returns
    -------
    which : ndarray (k,)
        The interval.
    s : ndarray (k,)
        In the reference segment.
    """
    around = np.concatenate([places - AROUND, places + AROUND], axis=1)
    k, j = np.nonzero((around > intervals.a[:, None]) & (around < intervals.b[:, None]))
    rows = np.flatnonzero(lost)
    a, b = intervals.a[rows, None], intervals.b[rows, None]
    inner = a + (b - a) * (np.arange(1, 2**bits) / 2**bits)
    # of the narrowest there may be no number in between
    row, column = np.nonzero((inner > a) & (inner < b))
    return np.concatenate([k, rows[row]]), np.concatenate([around[k, j], inner[row, column]])


def cuts(space, parts, search):
    """Pieces of all source facets, sorted. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : list of pcontact.mesh.mesh.Facets
        The source facets of this rank.
    search : (TargetSurface, float, str)
        Target, search radius [length] and method.

    Returns
    -------
    part, row, facet : ndarray (n,)
        Part, row in it, and running number of each piece's facet.
    a, b : ndarray (n,)
        Ends of the piece in the facet's reference segment.
    """
    count = np.array([len(f.cells) for f in parts], dtype=np.int64)
    part = np.repeat(np.arange(len(parts)), count)
    row = np.concatenate([np.arange(n) for n in count]) if len(count) else np.zeros(0, dtype=np.int64)
    n = len(part)
    f, places = _changes(_Partners(space, parts, search), n, space.comm)
    facet = np.concatenate([np.arange(n), np.arange(n), f])
    at = np.concatenate([np.full(n, -1.0), np.full(n, 1.0), places])
    order = np.lexsort((at, facet))
    facet, at = _apart(facet[order], at[order])
    start = np.flatnonzero(facet[1:] == facet[:-1])
    return part[facet[start]], row[facet[start]], facet[start], at[start], at[start + 1]


def _in_plane(space, parts, search, degree, key):
    """Points of all pieces of this rank in the plane, see :func:`_in_space`. *Collective.*"""
    known = {} if key is None else space.mesh.pieces
    if key not in known:
        known[key] = cuts(space, parts, search)
    part, row, _, a, b = known[key]
    xi, weights = quadrature("segment", degree or default_quadrature("segment", space.degree))
    s = 0.5 * (a + b)[:, None] + 0.5 * (b - a)[:, None] * xi[:, 0]
    n = len(weights)
    return np.repeat(part, n), np.repeat(row, n), s.reshape(-1, 1), (0.5 * (b - a)[:, None] * weights).ravel()


def _in_space(space, parts, target, degree):
    """Points of all tiles of this rank, of the facets that are cut. *Collective.*

    Returns
    -------
    part, row : ndarray (n,)
        Part, and row in it, of each point's facet.
    s : ndarray (n, d - 1)
        Reference coordinates.
    w : ndarray (n,)
        Weights.
    """
    part, row, kinds, corners = tiles(space, parts, target)
    columns, degree = [], degree or 2 * space.degree
    for sides, name, origin, unit in ((3, "triangle", 0.0, 1.0), (4, "quadrilateral", 1.0, 0.5)):
        xi, weights = quadrature(name, degree)
        chosen = np.flatnonzero(kinds == sides)
        # from the reference domain to shares of the two sides
        share, a = unit * (xi + origin), corners[chosen]
        along = a[:, 1:] - a[:, :1]
        s = a[:, :1] + np.einsum("qk,pki->pqi", share, along)
        size = along[:, 0, 0] * along[:, 1, 1] - along[:, 0, 1] * along[:, 1, 0]
        w = size[:, None] * (unit**2 * weights)
        n = len(weights)
        columns.append((np.repeat(part[chosen], n), np.repeat(row[chosen], n), s.reshape(-1, 2), w.ravel()))
    return tuple(np.concatenate(several) for several in zip(*columns, strict=True))


def cut_source(space, source, name, target, radius, method, degree=None, onto=None):
    """The source surface with a quadrature rule on every piece. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    source : SourceSurface
    name : str
        Its facet group.
    target : TargetSurface
    radius : float
        Search radius [length].
    method : {"closest_point", "ray_tracing"}
    degree : int, optional
        Of the rule on each piece.
    onto : str, optional
        Facet group of the target, where it is another surface: pieces in the plane are then kept with the mesh, for
        other settings and other runs.

    Returns
    -------
    SourceSurface
        The same facets; the cuts are those of the undeformed bodies. Facets that are not cut keep their points.
    """
    parts = space.mesh.facet_groups.get(name, [])
    if space.dim == 2:
        key = None if onto is None else (name, onto, radius, method, space.degree)
        part, row, s, w = _in_plane(space, parts, (target, radius, method), degree, key)
    else:
        part, row, s, w = _in_space(space, parts, target, degree)
    n, nn, d = len(w), source.shape.shape[1], space.dim
    facet = np.cumsum([0, *(len(facets.cells) for facets in parts)], dtype=np.int64)[part] + row
    x, normal, jxw = np.empty((n, d)), np.empty((n, d)), np.empty(n)
    values, slope, grad = np.zeros((n, nn)), np.zeros((n, nn, d)), np.zeros((n, nn, d))
    for k, facets in enumerate(parts):
        c = np.flatnonzero(part == k)
        x[c], normal[c], area, v, g, strain = at_places(space, facets, row[c], s[c])
        values[c, : v.shape[1]], slope[c, : v.shape[1]], grad[c, : v.shape[1]] = v, g, strain
        jxw[c] = w[c] * area * space.circumference(x[c])
    whole = ~np.isin(source.facet, facet)
    columns = {"facet": facet, "x": x, "normal": normal, "jxw": jxw, "shape": values, "grad": grad}
    if source.slope is not None:
        columns["slope"] = slope
    columns = {key: np.concatenate([getattr(source, key)[whole], value]) for key, value in columns.items()}
    order = np.argsort(columns["facet"], kind="stable")
    return dataclasses.replace(source, **{key: value[order] for key, value in columns.items()})
