"""Partners of source points, facets of a target surface or a rigid obstacle, and the gaps between them.

Source points go to the ranks whose target facets are near, partners come back.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.contact.points import interpolate
from pcontact.contact.search.projection import (
    EVEN,
    GIVEN_UP,
    ROUNDING,
    TIE,
    QueryPoints,
    TargetFacets,
    closest_points,
    ray_tracing,
)
from pcontact.contact.search.tree import build_tree, normal_cones
from pcontact.contact.surface.facet_maps import facet_boxes, padded
from pcontact.contact.surface.sides import surface_of
from pcontact.mesh.mesh import bounding_box
from pcontact.mesh.topology import outer_facets
from pcontact.runtime import profile
from pcontact.runtime.jit import njit_exact
from pcontact.runtime.parallel import Asked, together
from pcontact.runtime.petsc import MPI


class Partners(NamedTuple):
    """Result of a search for the points (np) of a source; the last entries are of target facets alone.

    Attributes
    ----------
    gap : ndarray (np,)
        [length]; means nothing without a partner.
    normal : ndarray (np, d)
        From source to target.
    paired : ndarray (np,) of bool
    ids : ndarray (np,)
        Global numbers of the target facets; -1 without a partner.
    nodes : ndarray (np, m)
        Global nodes of these facets, or, behind them, of their cells, too; of width 0 for an obstacle.
    shape : ndarray (np, m)
        Their shape functions at the partner.
    offset : ndarray (np, d) or None
        How far the target's smooth surface stands off the partner, where the target knows it [length], see
        `pcontact.contact.surface.smooth_geometry`.
    place : ndarray (np, 1 + d)
        Rank that has the facet, its row there, and the reference point on it.
    held : ndarray (np,)
        How the projection is held, see `pcontact.contact.search.projection.Projections`.
    y : ndarray (np, d)
        Point on the deformed target, relative to the origin of the search [length].
    candidates : int
        Facets that this rank tried.
    facets : ndarray (np, n, d) or None
        Nodes of the target facets as they were searched, where the search is to tell of them [length].
    """

    gap: np.ndarray
    normal: np.ndarray
    paired: np.ndarray
    ids: np.ndarray
    nodes: np.ndarray
    shape: np.ndarray
    offset: np.ndarray | None = None
    place: np.ndarray | None = None
    held: np.ndarray | None = None
    y: np.ndarray | None = None
    candidates: int = 0
    facets: np.ndarray | None = None


# boxes around the facets of a rank: the rank with the nearest one is asked first, and should have the partner
BOXES = 128
# facets tried for a point before others are asked: more than meet at a node. A rank with the partner tries two on
# average, and one without it all within the radius, as nothing ends its search
PATIENCE = 8


def _boxes(low, high):
    """Up to ``BOXES`` boxes around the boxes (nf, d) of facets, by bisection of their centres, shape (BOXES, 2 d)."""
    d = low.shape[1]
    out = np.full((BOXES, 2 * d), np.nan)
    if not len(low):
        return out
    centre = 0.5 * (low + high)
    groups = [np.arange(len(centre))]
    while len(groups) < BOXES and any(len(g) > 1 for g in groups):
        halves = []
        for group in groups:
            axis = int(np.argmax(np.ptp(centre[group], axis=0)))
            order = group[np.argsort(centre[group, axis], kind="stable")]
            halves += [h for h in np.array_split(order, 2) if len(h)]
        groups = halves
    for k, group in enumerate(groups):
        out[k, :d] = low[group].min(axis=0)
        out[k, d:] = high[group].max(axis=0)
    return out


def _near(boxes, points, radius):
    """Ranks with a box within the radius of the box around all points: most ranks of many are not looked at again."""
    if not len(points):
        return np.zeros(0, dtype=np.int64)
    d = points.shape[1]
    apart = np.maximum(boxes[..., :d] - points.max(axis=0), points.min(axis=0) - boxes[..., d:])
    # boxes that are not there hold NaN, which is not below anything
    return np.flatnonzero(np.any(np.all(apart <= radius, axis=2), axis=1))


@njit_exact
def nearest_box(boxes, points, radius, out):
    """Distance (np,) of each point (np, d) to the nearest of some boxes (n, 2 d), inf beyond the radius."""
    d = points.shape[1]
    for p in range(points.shape[0]):
        nearest = np.inf
        for b in range(boxes.shape[0]):
            square = 0.0
            for i in range(d):
                away = max(boxes[b, i] - points[p, i], points[p, i] - boxes[b, d + i], 0.0)
                square += away * away
            if square < nearest:
                nearest = square
        out[p] = np.sqrt(nearest) if nearest <= radius * radius else np.inf


def route(comm, low, high, points, radius):
    """Ranks that may hold a partner of each point. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    low, high : ndarray (nf, d)
        Boxes of the deformed target facets of this rank [length].
    points : ndarray (np, d)
    radius : float
        Search radius [length].

    Returns
    -------
    ranks : ndarray (n,)
        The ranks near any of the points, this one first if it is among them.
    distance : ndarray (n, np)
        How far the nearest of their boxes is from each point [length]; beyond the radius inf.
    """
    d = points.shape[1]
    boxes = np.empty((comm.size, BOXES, 2 * d))
    with profile.phase("exchange"):
        comm.Allgather(_boxes(low, high), boxes)
    profile.count(gathered_bytes=boxes.nbytes)
    ranks = _near(boxes, points, radius)
    ranks = ranks[np.argsort(ranks != comm.rank, kind="stable")]
    distance = np.empty((len(ranks), len(points)))
    points = np.ascontiguousarray(points)
    for rank, row in zip(ranks, distance, strict=True):
        there = boxes[rank][~np.isnan(boxes[rank, :, 0])]
        nearest_box(there, points, float(radius), row)
    return ranks, distance


class _Searched:
    """Facets of this rank under a displacement, with what a search needs and all rounds of it share."""

    def __init__(self, target, x_facets, method, space, criteria, facets):
        self._rank, numbers = space.comm.rank, space.nodes
        self._target, self._numbers, self._criteria, self._tell = target, numbers, criteria, facets
        x, kinds, ids, own, corners = target.around(x_facets)
        tree, cones = build_tree(*facet_boxes(x, kinds), target.bodies()), None
        self._exclusion = target.exclusion(tree)
        self._search = closest_points if method == "closest_point" else ray_tracing
        if corners is not None and len(kinds) and self._search is closest_points:
            cones = normal_cones(tree, x, kinds, corners, self._exclusion)
        self._facets = TargetFacets(tree, x, kinds, ids, own, cones)

    def project(self, asked, radius, patience):
        """Answers of this rank for some points, and how many facets were tried.

        Returns
        -------
        rows : ndarray (n,)
            The points with a partner here, and those that were given up, whose facet id is `GIVEN_UP`.
        answers : ndarray (n, columns)
            Of those: facet id, distance, gap, how it is held, facet size, y, normal, nodes, shape, rank, row and
            reference point, offset and facet if asked for.
        candidates : int
        """
        target, d = self._target, self._facets.x.shape[2]
        query, about = QueryPoints(asked[:, :d], asked[:, d : 2 * d], radius, patience), asked[:, 2 * d :]
        exclusion = None if self._exclusion is None else target.placed(self._exclusion, about)
        p = self._search(self._facets, query, exclusion=exclusion, **self._criteria)
        rows = np.flatnonzero(p.facet != -1)
        facet = np.maximum(p.facet[rows], 0)
        weights, nodes = target.shape(facet, p.xi[rows]), self._numbers[target.nodes[facet]]
        parts = [p.id, p.distance, p.gap, p.held, p.size, p.y, p.normal]
        smooth = [] if target.smooth is None else [target.smooth.at_target(target, facet, p.xi[rows])]
        facets = [self._facets.x[facet].reshape(len(facet), d * self._facets.x.shape[1])] if self._tell else []
        place = np.full(len(rows), self._rank), facet, p.xi[rows, : d - 1]
        out = np.column_stack([*(part[rows] for part in parts), nodes, weights, *place, *smooth, *facets])
        out = out.astype(float, copy=False)
        out[p.facet[rows] == GIVEN_UP, 0] = GIVEN_UP
        return rows, out, int(p.candidates.sum())


def _best(points, answers, n_points, d):
    """Row of ``answers`` that wins for every point (-1: none).

    The rule of the search within one rank (`pcontact.contact.search.projection`), so that the result does not depend on
    how facets are spread.
    """
    winner = np.full(n_points, -1, dtype=np.int64)
    if not len(points) or np.max(np.bincount(points)) == 1:
        winner[points] = np.arange(len(points))
        return winner
    number, distance, _, held, size = answers[:, :5].T
    rounding = ROUNDING * np.max(np.abs(answers[:, 5 : 5 + d]), axis=1)
    rows = np.arange(len(points))
    even = EVEN * (distance + 0.1 * size) + rounding
    for key, slack in ((distance, TIE * size), (held, np.zeros(len(rows))), (distance, even)):
        least = np.full(n_points, np.inf)
        np.minimum.at(least, points[rows], key[rows])
        rows = rows[key[rows] <= least[points[rows]] + slack[rows]]
    order = rows[np.lexsort((number[rows], points[rows]))]
    unique, first = np.unique(points[order], return_index=True)
    winner[unique] = order[first]
    return winner


def find_partners(space, target, nodal, query, method, origin=0.0, opposite=False):
    """Partner of every source point of this rank among the target facets of all ranks. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    target : pcontact.contact.surface.sides.TargetSurface
    nodal : ndarray (n_local, d)
        Displacement of the local nodes [length].
    query : pcontact.contact.search.projection.QueryPoints
        Deformed source points, relative to the origin, with one radius for all.
    method : {"closest_point", "ray_tracing"}
    origin : ndarray (d,), optional
        Near the surfaces: the sum of a displacement and a position far from it loses the digits of the displacement.
    opposite : bool, optional
        See `pcontact.contact.search.projection.closest_points`.

    Returns
    -------
    Partners
    """
    return PartnerSearch(space, target, nodal, method, origin, opposite=opposite)(query, target.about)


class PartnerSearch:
    """The target facets of all ranks under one displacement, for several searches; as :func:`find_partners`.

    Parameters
    ----------
    space, target, nodal, method, origin
        See :func:`find_partners`.
    facets : bool, optional
        Whether searches tell the nodes of the facets that they find, as many on all ranks.
    criteria
        ``facing`` and ``opposite`` of :func:`pcontact.contact.search.projection.closest_points`.

    Notes
    -----
    The constructor is *Collective*, and so are the calls.
    """

    def __init__(self, space, target, nodal, method, origin=0.0, facets=False, **criteria):
        x_facets = np.ascontiguousarray(target.deformed(nodal, origin))
        self._space, self._target = space, target
        self._width = int(space.comm.allreduce(target.nodes.shape[1], op=MPI.MAX))
        target.nodes = padded(target.nodes, self._width)
        self._searched = _Searched(target, x_facets, method, space, criteria, facets)
        # columns of an answer beyond those that all have: offset, facet
        self._columns = (target.smooth is not None) * space.dim, facets * space.dim * target.x.shape[1]
        self._boxes = None if space.comm.size == 1 else facet_boxes(x_facets, target.kinds)

    def __call__(self, query, about=None):
        """A :class:`Partners` of points of this rank; of points on the target itself with what they tell about
        themselves. *Collective.*"""
        space, d, width, n_points = self._space, self._space.dim, self._width, len(query.x)
        asking = np.column_stack([query.x, query.normal, *([] if about is None else [about])])
        if space.comm.size == 1:
            count = n_points
            found, answers, candidates = self._searched.project(asking, query.radius, query.patience)
        else:
            found, answers, candidates, count = _remote(space, self._searched, self._boxes, asking, query.radius)
        profile.count(searches=1, points=n_points, asked=count, candidates=candidates)
        winner = _best(found, answers, n_points, d)
        rows, sizes = np.flatnonzero(winner >= 0), [5, d, d, width, width, 1 + d, *self._columns]
        table = np.zeros((n_points, sum(sizes)))
        table[:, 0] = -1.0
        table[rows] = answers[winner[rows]]
        parts = [np.ascontiguousarray(part) for part in np.split(table, np.cumsum(sizes)[:-1], axis=1)]
        (ids, _, gap, held, _), (y, normal, nodes, shape, place, offset, facets) = parts[0].T.copy(), parts[1:]
        ids, told = ids.astype(np.int64), [bool(columns) for columns in self._columns]
        return Partners(
            gap, normal, ids >= 0, ids, nodes.astype(np.int64), shape, offset if told[0] else None, place, held, y,
            candidates, facets.reshape(n_points, self._target.x.shape[1], d) if told[1] else None,
        )  # fmt: skip


def _remote(space, searched, boxes, asking, radius):
    """Ask the ranks whose boxes are near, answer those who ask here. *Collective.*

    First each point asks the rank with the nearest box, then those others whose boxes are nearer than the partner that
    it has heard of: most points ask one rank, however many have facets within the search radius. Ranks that have given
    a point up are asked again last, when the partner that others have bounds what they look at.
    """
    ranks, away = route(space.comm, *boxes, asking[:, : space.dim], radius)
    first, left = np.zeros(away.shape, dtype=bool), np.zeros(away.shape, dtype=bool)
    if len(ranks):
        # among equals this rank, then the smallest
        first[np.argmin(away, axis=0), np.arange(len(asking))] = True
    farthest, everything = np.full(len(asking), float(radius)), QueryPoints(None, None, radius).patience
    found, answers, candidates, count = [], [], 0, 0
    for which, patience in ((first, PATIENCE), (~first, PATIENCE), (left, everything)):
        k, point = np.nonzero(which & (away <= farthest) & (away < np.inf))
        rows, table, tried = _ask(space, searched, (asking[point], farthest[point], patience), ranks[k])
        unknown = table[:, 0] == GIVEN_UP
        left[k[rows[unknown]], point[rows[unknown]]] = True
        rows, table = point[rows[~unknown]], table[~unknown]
        # what is as near, up to rounding, may still win: as an interior projection, or by its smaller number
        np.minimum.at(farthest, rows, table[:, 1] * (1.0 + 1e-12) + 1e-9 * table[:, 4])
        found.append(rows)
        answers.append(table)
        candidates, count = candidates + tried, count + len(point)
    return np.concatenate(found), np.concatenate(answers), candidates, count


def _ask(space, searched, asked, rank):
    """Send points to ranks and bring back the answers. *Collective.*

    Parameters
    ----------
    asked : (ndarray (n, m), ndarray (n,), int)
        What is to be known of the points, their search radii [length], and how patient the search is.
    rank : ndarray (n,)
        Whom each point asks.

    Returns
    -------
    rows : ndarray (m,)
        Points with an answer, one entry for each.
    answers, candidates
        See :meth:`_Searched.project`.
    """
    asking, radius, patience = asked
    asked = Asked(space.exchanger, rank, np.column_stack([asking, radius]))
    rows, answers, candidates = searched.project(asked.rows[:, :-1], np.ascontiguousarray(asked.rows[:, -1]), patience)
    return *asked.reply_some(rows, answers), candidates


# [cosine] Smallest one between the normals of a source point and its obstacle.
FACING = 0.1
# [iterations] Of Newton's method along a way out of an obstacle. From: chosen; a way that crosses the surface at that
# angle takes less than ten.
TRACE = 30
# [search radii] Distance from the surface at which the way ends. From: chosen, far below what gaps are asked for.
REACHED = 1e-10


class TargetSearch:
    """Partners on a target surface.

    Parameters
    ----------
    space : pcontact.space.space.Space
    target : pcontact.contact.surface.sides.TargetSurface
    method : str
        closest_point or ray_tracing.
    opposite : bool
        Whether points beside the border of the target have no partner: where contact bears tension.

    Attributes
    ----------
    rigid : bool
    too_deep : int
        Points of this rank deeper in an obstacle than the radius.
    candidates : int
        Facets that the searches of this rank tried.
    """

    rigid, too_deep = False, 0

    def __init__(self, space, target, method, opposite=False):
        self.space, self.target, self.method, self.opposite = space, target, method, opposite
        self.candidates = 0

    def find(self, nodal, x, normal, time, radius, origin):
        """Partners of points. *Collective.*

        Parameters
        ----------
        nodal : ndarray (n_local, d)
            Displacements of the nodes of this rank [length].
        x : ndarray (np, d)
            Points under them, relative to the origin [length].
        normal : ndarray (np, d)
            Outward normals of the source.
        time : float
        radius : float
            How far partners are looked for [length].
        origin : ndarray (d,)

        Returns
        -------
        Partners
        """
        query = QueryPoints(x, normal, radius)
        found = find_partners(self.space, self.target, nodal, query, self.method, origin, self.opposite)
        self.candidates += found.candidates
        return found

    def moved(self, x, start, end, origin):
        """Motion of partners at places (np, d), relative to the origin, between two times apart from displacements:
        (np, d), (d,) or zero [length]."""
        return 0.0

    def turned(self, vectors, start, end):
        """Vectors (np, d) that turn with the partners between two times, apart from the displacements."""
        return vectors


class ObstacleSearch:
    """Every point against a rigid obstacle; parameters and attributes as of `TargetSearch`.

    The partner of a point is the nearest place of the obstacle if that faces it. A point behind the middle of the
    obstacle, whose nearest way out is not into its body, is left to the points that face the obstacle as long as one of
    them is as deep: what pushes them out takes it along, such as the upper side of a sheet. Else the obstacle lies in
    the body, and the partner is where the way into the body, against the normal of the point, leaves the obstacle.

    Parameters
    ----------
    space : pcontact.space.space.Space
    target : pcontact.contact.surface.obstacle.RigidObstacle
    """

    rigid, candidates = True, 0

    def __init__(self, space, target):
        self.space, self.target = space, target
        self.too_deep, self._behind = 0, None

    def distance(self, x, time, origin):
        """Signed distance (np,) [length] and contact normal (np, d) of points relative to the origin. *Collective.*"""
        # a level set of the user's may fail on some ranks only
        return together(self.space.comm, self.target.gap, x, time, origin)

    def gap(self, x, time, origin):
        """The same of points that move from where they were searched: those that were behind the obstacle see the plane
        of their partner until they are out of it or face it. *Collective.*"""
        gap, away = self.distance(x, time, origin)
        rows, at, normal, own = self._behind
        still = (gap[rows] < 0.0) & (np.einsum("pd,pd->p", away[rows], own) < FACING)
        rows, at, normal = rows[still], at[still], normal[still]
        gap[rows], away[rows] = np.einsum("pd,pd->p", at - x[rows], normal), normal
        return gap, away

    def find(self, nodal, x, normal, time, radius, origin):
        """See :meth:`TargetSearch.find`. *Collective.*"""
        gap, away = self.distance(x, time, origin)
        paired = np.einsum("pd,pd->p", away, normal) >= FACING
        deepest = self.space.comm.allreduce(float(np.min(gap[paired], initial=0.0)), op=MPI.MIN)
        rows = np.flatnonzero(~paired & (gap < min(deepest, -REACHED * radius)))
        rows, at = self._ways_out(rows, x, normal, time, (REACHED * radius, origin))
        paired[rows], away[rows] = True, self.distance(at, time, origin)[1]
        gap[rows] = np.einsum("pd,pd->p", at - x[rows], away[rows])
        self._behind = rows, at, away[rows], normal[rows]
        self.too_deep = int(np.sum(paired & (gap < -radius)))
        paired &= np.abs(gap) <= radius
        n = len(gap)
        ids, nodes = np.zeros(n, dtype=np.int64), np.zeros((n, 0), dtype=np.int64)
        return Partners(gap, away, paired, ids, nodes, np.zeros((n, 0)))

    def _ways_out(self, rows, x, normal, time, about):
        """Rows of points (n,) that have a way out of the obstacle against their normals, and where it ends (m, d).
        *Collective.*"""
        tolerance, origin = about
        way, ended = np.zeros(len(rows)), np.zeros(len(rows), dtype=bool)
        for _ in range(TRACE):
            if not self.space.comm.allreduce(bool(np.any(~ended)), op=MPI.LOR):
                break
            at = x[rows] - way[:, None] * normal[rows]
            gap, away = self.distance(at, time, origin)
            slope = np.einsum("pd,pd->p", away, normal[rows])
            ended = (slope >= FACING) & (np.abs(gap) <= tolerance)
            # beside the border of a surface there is no distance
            goes = np.isfinite(gap)
            rows, way, ended = rows[goes], way[goes], ended[goes]
            way += np.where(ended, 0.0, -gap[goes] / np.where(slope[goes] >= FACING, slope[goes], 1.0))
        rows, way = rows[ended], way[ended]
        return rows, x[rows] - way[:, None] * normal[rows]

    def moved(self, x, start, end, origin):
        """See :meth:`TargetSearch.moved`."""
        return self.target.moved(x, start, end, origin)

    def turned(self, vectors, start, end):
        """See :meth:`TargetSearch.turned`."""
        return self.target.turned(vectors, start, end)


class Detection:
    """Looks for the partners of the points of a source.

    Parameters
    ----------
    space : pcontact.space.space.Space
    contact : pcontact.scene.model.Contact
    source : pcontact.contact.surface.sides.SourceSurface
    among : pcontact.contact.search.partners.TargetSearch or ObstacleSearch
        Says who the partner of a point is.
    radius : float
        How far partners are looked for [length].
    chords : pcontact.contact.surface.smooth_geometry.Chords, optional
        What straight facets do to the gap.

    Attributes
    ----------
    normals : ndarray (np, d)
        Outward normals of the source by which partners are looked for: those of the undeformed one.
    origin : ndarray (d,)
        To which places of points are relative, so that they lose no digits [length].
    rounding : float
        Rounding errors that a gap may carry [length].
    offset : float or ndarray (np,)
        What the last search has added to gaps for those that the undeformed bodies are given, see
        :class:`InitialGap` [length].
    """

    def __init__(self, space, contact, source, among, radius, chords=None):
        self._space, self._source, self.among, self.radius, self.chords = space, source, among, radius, chords
        self.normals, self._initial, self.offset = source.normal, initial_gap(contact), 0.0
        low, high = bounding_box(space.comm, space.points)
        # of few digits, so that subtracting it rounds nothing
        self.origin = (0.5 * (low + high)).astype(np.float32).astype(float)
        self.rounding = np.finfo(float).eps * (4.0 * np.max(np.abs([low, high])) + 64.0 * np.max(high - low))

    @property
    def target(self):
        """Target surface or obstacle."""
        return self.among.target

    def interpolated(self, nodal):
        """Values (np, d) at the points of a field of the nodes (n_local, d)."""
        source = self._source
        values = np.empty_like(source.x)
        interpolate(nodal, source.cells, source.facet, source.shape, values)
        return values

    def deformed(self, nodal):
        """Points (np, d) under displacements (n_local, d), relative to the origin: no digits are lost."""
        space = self._space
        # the geometry is of the degree of the displacement at most, which interpolates it
        if space.mesh.curved and space.degree == 1:
            return (self._source.x - self.origin) + self.interpolated(nodal)
        return self.interpolated(space.points - self.origin + nodal)

    def turn(self, nodal):
        """Take the normals of the source under displacements (n_local, d): those of the undeformed one stay."""

    def find(self, u, time, radius=None):
        """Partners of the points among the bodies at ``u``, and obstacles at a time, within the radius or another one.
        *Collective.*

        Returns
        -------
        pcontact.contact.search.partners.Partners
            With the gap between the surfaces that the facets stand for, if they are to be told apart, and with what is
            added for the gap that the undeformed bodies are given.
        """
        found = self._found(u, time, radius)
        if self._initial is None:
            return found
        self.offset = self._initial.offset(time)
        return found._replace(gap=found.gap + self.offset)

    def _found(self, u, time, radius=None):
        nodal = self._space.local.gather(u)
        self.turn(nodal)
        radius = self.radius if radius is None else radius
        found = self.among.find(nodal, self.deformed(nodal), self.normals, time, radius, self.origin)
        gap = found.gap
        if self.chords is not None:
            gap = self.chords(gap, found.normal, found.paired, found.offset)
        # surfaces that touch are closed in the first tangent, whatever the rounding of their coordinates says
        return found._replace(gap=np.where(found.paired & (np.abs(gap) > self.rounding), gap, 0.0))

    def waiting(self, time):
        """See :meth:`InitialGap.waiting`; 0 where all of the gap between the undeformed bodies acts at once."""
        return 0.0 if self._initial is None else self._initial.waiting(time)

    def measure(self, u, time):
        """Take the gap between the undeformed bodies, from which the first load step begins at ``u``, with an obstacle
        where it is before it moves, at a time; once. *Collective.*"""
        if self._initial is not None and not self._initial.known:
            found = self._found(u, time)
            self._initial.take(found.gap, found.paired)


class InitialGap:
    """The gap that the undeformed bodies are given, and what is added to gaps for it.

    With the gap g of the first search, the bodies are given g' = 0 where they are adjusted, the clearance where it is
    said, or g. Of an overlap, g' < 0, the part f(t) acts: to all gaps there is added g' - g + (f - 1) min(g', 0). Of
    a gap that a bilateral contact closes that part does, too: g' stands in the place of min(g', 0).

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
    """

    def __init__(self, contact):
        self._within = (contact.adjust_within or 0.0) if contact.interference == "adjust" else None
        self._clearance, self._table = contact.clearance, contact.interference_amplitude
        self._bilateral, self._base, self._overlap = contact.bilateral, None, None

    @property
    def known(self):
        """Return True if the gap between the undeformed bodies is known."""
        return self._base is not None

    def take(self, gap, paired):
        """Take the gap (np,) of the undeformed bodies [length], at points (np,) that have a partner."""
        given = gap
        if self._within is not None:
            given = np.where(gap <= self._within, 0.0, gap)
        elif self._clearance is not None:
            given = np.full_like(gap, self._clearance)
        self._base = np.where(paired, given - gap, 0.0)
        self._overlap = np.where(paired, given if self._bilateral else np.minimum(given, 0.0), 0.0)

    def offset(self, time):
        """Addend of gaps (np,) at a time [length]."""
        return self._base - self.waiting(time)

    def waiting(self, time):
        """The part of overlaps and gaps (np,) that does not act yet at a time [length]."""
        if self._table is None:
            return np.zeros_like(self._base)
        times, factors = np.transpose(self._table)
        return (1.0 - np.interp(time, times, factors)) * self._overlap


def initial_gap(contact):
    """The :class:`InitialGap` of a contact; None where the bodies are as they are in the mesh."""
    said = contact.clearance is not None or contact.interference_amplitude is not None
    return InitialGap(contact) if said or contact.interference == "adjust" else None


# [cosine] Smallest one between the normal of a point and that of the nearest facet: any.
ANY = -2.0


def overlap(space, source, target, method, bodies):
    """Largest depth of points of a source inside bodies, to their partners on a target there. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    source : pcontact.contact.surface.sides.SourceSurface
    target : pcontact.contact.surface.sides.TargetSurface
        Of these bodies.
    method : str
        closest_point or ray_tracing.
    bodies : set of int
        Connected components, none of which the source belongs to.

    Returns
    -------
    float
        [length]; 0 where no point is inside.
    """
    still = np.zeros_like(space.points)
    outer = [_of_bodies(space, facets, bodies) for facets in outer_facets(space.mesh, space.exchanger)]
    nearest = PartnerSearch(space, surface_of(space, outer), still, "closest_point", facing=ANY)
    found = nearest(QueryPoints(source.x, source.normal, np.inf))
    inside = found.paired & (found.gap < 0.0)
    found = PartnerSearch(space, target, still, method)(QueryPoints(source.x[inside], source.normal[inside], np.inf))
    depth = float(np.max(-found.gap[found.paired], initial=0.0))
    return space.comm.allreduce(depth, op=MPI.MAX)


def _of_bodies(space, facets, bodies):
    """Those of some facets that belong to connected components."""
    rows = np.isin(space.mesh.blocks[facets.block].components[facets.cells], list(bodies))
    return replace(facets, cells=facets.cells[rows], local=facets.local[rows])
