"""Who is the partner of a source point: a facet of a target surface, or a rigid obstacle."""

from typing import NamedTuple

import numpy as np

from pcontact.contact.search.exchange import find_partners
from pcontact.contact.search.query import QueryPoints
from pcontact.runtime.parallel import together
from pcontact.runtime.petsc import MPI

# [cosine] Smallest one between the normals of a source point and its obstacle.
FACING = 0.1
# [iterations] Of Newton's method along a way out of an obstacle. From: chosen; a way that crosses the surface at that
# angle takes less than ten.
TRACE = 30
# [search radii] Distance from the surface at which the way ends. From: chosen, far below what gaps are asked for.
REACHED = 1e-10


class Partners(NamedTuple):
    """What a search finds for the points (np) of a source.

    Attributes
    ----------
    gap : ndarray (np,)
        [length]; means nothing without a partner.
    normal : ndarray (np, d)
        From source to target.
    paired : ndarray (np,) of bool
    ids : ndarray (np,)
        Target facets; -1 without a partner.
    nodes : ndarray (np, m)
        Global nodes of these facets, or, behind them, of their cells, too; of width 0 for an obstacle.
    shape : ndarray (np, m)
        Their shape functions at the partner.
    offset : ndarray (np, d) or None
        Of the target's smooth surface there, see `pcontact.contact.surface.smooth_geometry`.
    place, held : ndarray or None
        Of target facets, see `pcontact.contact.search.exchange.Found`.
    """

    gap: np.ndarray
    normal: np.ndarray
    paired: np.ndarray
    ids: np.ndarray
    nodes: np.ndarray
    shape: np.ndarray
    offset: np.ndarray | None
    place: np.ndarray | None = None
    held: np.ndarray | None = None


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
        return Partners(
            found.gap, found.normal, found.id >= 0, found.id, found.nodes, found.shape, found.offset, found.place,
            found.held,
        )  # fmt: skip

    def moved(self, x, start, end, origin):
        """What partners at places (np, d), relative to the origin, move between two times apart from the displacements:
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
        return Partners(gap, away, paired, ids, nodes, np.zeros((n, 0)), None)

    def _ways_out(self, rows, x, normal, time, about):
        """Which of some points (n,) have a way out of the obstacle against their normals, and where it ends (m, d).
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
