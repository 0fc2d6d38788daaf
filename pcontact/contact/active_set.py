"""Points of a pair that open and close, for Newton's method and the stepper, and how far they go.

Where a contact recedes what opens are the points in tension, and the edge of what is left, by its pressures alone. A
Newton step ends where the pair no longer makes sense; after a load step, the motion of the points says whether their
partners still mean something.
"""

from dataclasses import replace

import numpy as np

from pcontact.assembly.item import ActiveSet
from pcontact.contact.law import OPEN
from pcontact.mesh.mesh import bounding_box
from pcontact.runtime.jit import njit
from pcontact.runtime.petsc import MPI

# [-] Area that opens, in parts of that which a full Newton step finds in tension. Row: opening. From: where the contact
# is taken too wide by d, the pressure near its edge is that of the edge sought plus that of a rigid punch, proportional
# to sqrt(x) - d / 2 / sqrt(x) at the distance x: it is a tension up to d / 2 only.
AGAIN = 2.0
# [-] Part of the force of the points without tension that those may bear which open nevertheless. Row: opening.
BORNE = 0.1
# [bins] Of equal ratio, by which pressures are told apart. From: chosen; a bin is 3 % of a pressure.
BINS = 1000
# [decades] Of the bins below the largest pressure. From: chosen; smaller pressures open together.
DECADES = 12.0


def weakest(pressure, area, opened, comm):
    """Points with the smallest pressures, as large an area as (AGAIN - 1) times one that opens. *Collective.*

    Parameters
    ----------
    pressure : ndarray (n,)
        Of the points of this rank that remain closed [stress].
    area : ndarray (n,)
        [length^(d - 1)]
    opened : float
        Area, on all ranks, of the points in tension [length^(d - 1)].
    comm : MPI.Comm

    Returns
    -------
    ndarray (n,) of bool
        Points whose pressures lie in the lowest bins; they bear at most `BORNE` of the force.
    """
    largest = comm.allreduce(float(pressure.max(initial=0.0)), op=MPI.MAX)
    if largest <= 0.0:
        return np.zeros(len(pressure), dtype=bool)
    ratio = np.maximum(pressure / largest, 10.0**-DECADES)
    place = np.minimum(BINS * (1.0 + np.log10(ratio) / DECADES), BINS - 1).astype(np.int64)
    sums = [np.bincount(place, area * values, minlength=BINS) for values in (np.ones(len(area)), pressure)]
    areas, forces = np.cumsum(comm.allreduce(np.stack(sums), op=MPI.SUM), axis=1)
    opens = (areas <= (AGAIN - 1.0) * opened) & (forces <= BORNE * forces[-1])
    return place < np.count_nonzero(opens)


def turned(closed, paired, tau, area):
    """Return :meth:`PairActiveSet.turned` of points with augmented tractions tau (n,) [stress]."""
    opens, closes = closed & (tau > 0.0), paired & ~closed & (tau <= 0.0)
    return np.array([area[closed].sum(), area[opens].sum(), area[closes].sum(), np.count_nonzero(opens)])


def still_closed(closed, tau, area, comm):
    """Points (n,) that remain closed of those that are: without the ones in tension, and the `weakest`. *Collective.*

    Parameters
    ----------
    closed : ndarray (n,) of bool
    tau : ndarray (n,)
        Augmented normal traction [stress].
    area : ndarray (n,)
        [length^(d - 1)]
    comm : MPI.Comm
    """
    opened = comm.allreduce(float(area[closed & (tau > 0.0)].sum()), op=MPI.SUM)
    left = closed & (tau <= 0.0)
    rows = np.flatnonzero(left)
    left[rows[weakest(-tau[rows], area[rows], opened, comm)]] = False
    return left


class PairActiveSet(ActiveSet):
    """The active set of a pair (`pcontact.contact.pair.ContactPair`)."""

    def __init__(self, pair):
        self._pair = pair

    def closed_area(self):
        """Area of the points of this rank that were closed in the last tangent [length^(d - 1)]."""
        pair = self._pair
        return float(np.sum(pair.source.jxw[pair.status > OPEN])) if pair.status is not None else 0.0

    def active_nodes(self):
        """Owned nodes, global numbers, of the pair at points that were closed in the last tangent. *Collective.*"""
        pair = self._pair
        closed = pair.status > OPEN if pair.status is not None else np.zeros(len(pair.source.facet), dtype=bool)
        return pair.pairing.touched(pair.space, pair.pairing.paired & closed)

    def closed_count(self):
        """Points of this rank that were closed at the end of the last load step."""
        pair = self._pair
        return 0 if pair.law.tied else int(np.sum(pair.history.closed))

    def closed_areas(self):
        """Closed area (n_components,) at the end of the last load step, of this rank. *Collective.*"""
        pair = self._pair
        return borne(pair.space, pair.pairing, pair.source, pair.history.closed.astype(float))

    def bonds(self):
        """Forces (n_components,) that adhesion may exert without pressure, of this rank; any where contact bears
        tension. *Collective.*"""
        pair = self._pair
        bond = np.inf if pair.bilateral else pair.law.bond
        return borne(pair.space, pair.pairing, pair.source, np.where(pair.pairing.paired, bond, 0.0))

    def area_changed_by_supports(self, before, u):
        """Area of the points of this rank that ``u``, in which only supports have moved, opens or closes. *Collective.*

        Obstacles have moved already: against them the comparison is with the last load step, else with the
        displacement ``before``.
        """
        pair = self._pair
        now = pair.pressed(u)
        then = np.where(pair.history.closed, -1.0, 1.0) if pair.rigid else pair.pressed(before)
        # surfaces that just touch are closed, and remain so
        return float(np.sum(pair.source.jxw[(now * then < 0.0) & pair.pairing.paired]))

    @property
    def _recedes(self):
        """Return whether the pressure says what is open, and a tangent has been asked for."""
        pair = self._pair
        return not pair.bilateral and pair.law.follows_pressure and pair.status is not None

    def turned(self, u):
        """See :meth:`pcontact.assembly.item.ActiveSet.turned`. *Collective.*"""
        pair = self._pair
        if not pair.law.follows_pressure:
            return np.full(4, np.inf)
        if not self._recedes:
            return np.zeros(4)
        p = pair.pairing
        return turned(pair.status > OPEN, p.paired, pair.pressed(u, p.acts), pair.source.jxw)

    def recede(self, u, rule):
        """Keep open what is open in the last tangent or in tension in ``u``, and the edge of the rest, see
        :func:`still_closed`. *Collective.*
        """
        pair = self._pair
        if not self._recedes:
            return rule
        comm, closed = pair.space.comm, pair.status > OPEN
        left = still_closed(closed, pair.pressed(u, pair.pairing.acts), pair.source.jxw, comm)
        before, after = comm.allreduce(np.array([closed.sum(), left.sum()]), op=MPI.SUM)
        return None if after == 0 < before else replace(rule, opened=~left)

    def step_limit(self, u, y, falls=None):
        """See :func:`step_limit`. *Collective.*"""
        pair = self._pair
        return step_limit(pair, u, y, falls) if pair.floats and not pair.law.tied else None

    def clearance(self, u, fields, beyond=False):
        """See :func:`clearance`. *Collective.*"""
        return clearance(self._pair, u, fields, beyond)

    def force_magnitudes(self, u):
        """Magnitudes of the forces on every component, see :func:`borne`. *Collective.*"""
        pair = self._pair
        return borne(pair.space, pair.pairing, pair.source, np.linalg.norm(pair.state(u)["traction"], axis=1))


# [-] How deep a loose body goes that is brought to where it touches, in parts of the step. From: the step is what the
# load does to what the body is given to lean on, a millionth of its own stiffness (`pcontact.build`); so deep is ten
# times what it does to the body.
GENTLE = 1e-5
# [facet sizes] The same where the step is short. Row: step_limit.
TOUCHED = 0.1
# [steps] Way to where it touches from which on a prolonged step ends before. Row: step_limit.
LONG = 30.0
# [-] Part of the way after which it ends then. Row: step_limit.
SHORT_OF = 0.99
# [facet sizes] Depth beyond the known one from which on a point counts as lost. From: chosen.
DEEPER = 0.1
# [-] Difference from a former normal, in parts of that from the present one, up to which a point goes back to it.
# From: chosen.
RETURNED = 0.1
# [-] Part of the way to a gap that is found again which a point goes at least. From: chosen.
DAMPED = 0.25


def components_of(space, pairing, source):
    """Connected components of the points of a source and of their partners: (np,), (np,). *Collective.*

    Returns
    -------
    tuple of ndarray of int
        -1 for points without a partner that is a body.
    """
    numbers = np.zeros((space.n_owned, space.dim))
    numbers[:, 0] = space.component[space.owned_local]
    of_node = np.rint(space.at_nodes(numbers, pairing.exchange)[:, 0]).astype(np.int64)
    own = of_node[pairing.cells[source.facet, 0]]
    other = np.full(len(own), -1, dtype=np.int64)
    if pairing.targets.shape[1]:
        other[pairing.paired] = of_node[pairing.targets[pairing.paired, 0]]
    return own, other


def borne(space, pairing, source, traction):
    """Forces of contact with others on every connected component. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    pairing : pcontact.contact.pair.Pairing
    source : pcontact.contact.surface.sides.SourceSurface
    traction : ndarray (np,)
        Magnitude of a traction at the points [stress].

    Returns
    -------
    ndarray (n_components,)
        Sum of the magnitudes of the forces at the points of this rank [force]: forces that balance count, too.
    """
    own, other = components_of(space, pairing, source)
    force = np.where(own == other, 0.0, traction * source.jxw)
    total = np.bincount(own, force, minlength=space.mesh.n_components)
    return total + np.bincount(other[other >= 0], force[other >= 0], minlength=space.mesh.n_components)


def step_limit(pair, u, y, falls=None):
    """Part of the Newton step ``-y`` to take so that the pair makes sense after it. *Collective.*

    While no point is closed, a body that nothing holds goes until its nearest point has just closed (a tenth of a facet
    deep), be that less or more than the step, in which what it is given to lean on is of no size; afterwards its points
    may move by a search radius, beyond which their partners mean nothing. Where open points bear a tangential traction,
    as by Tresca's law, a body may hang on that: its step has a size, and is not prolonged. A body may fall in spite of
    it: where the traction has hardly a part along the way. A pair that such a body moves away from has no say.

    Parameters
    ----------
    pair : pcontact.contact.pair.ContactPair
    u, y : PETSc.Vec
    falls : ndarray (n_components,) of bool, optional
        Bodies that nothing but the stabilisation holds back in the step.

    Returns
    -------
    float or None
        At most 1 once a point bears a traction; None for no say.
    """
    p, source, comm = pair.pairing, pair.source, pair.space.comm
    traction, gap = pair.terms.normal_state(p, p.exchange.gather(u), p.acts)
    overclosed = traction + pair.method.gamma * gap
    gap = gap - pair.method.begins
    approach = pair.terms.approach(p, u, y)
    part = pair.radius / max(float(np.max(np.abs(approach), initial=0.0)), 1e-300)
    closed = p.paired & (overclosed <= 0.0)
    bearing, falling = pair.forces(u)[1] > OPEN, np.zeros(len(gap), dtype=bool)
    if falls is not None and falls.any():
        # the last place is that of an obstacle
        falling = np.append(falls, False)[np.column_stack(components_of(pair.space, p, source))].any(axis=1)
    bears = comm.allreduce(bool(np.any(bearing & ~falling)), op=MPI.LOR)
    sized = bears or (falls is not None and not comm.allreduce(bool(falling.any()), op=MPI.LOR))
    if not comm.allreduce(bool(closed.any()), op=MPI.LOR):
        coming = p.paired & (approach > 0.0)
        depth, gap, approach = TOUCHED * source.size[source.facet[coming]], gap[coming], approach[coming]
        touch = comm.allreduce(float(np.min((gap + depth) / approach, initial=np.inf)), op=MPI.MIN)
        if sized:
            touch = min(touch, 1.0)
        if 1.0 < touch < np.inf:
            # the less the load, and the step, the less deep: else what has just closed springs back
            depth = np.minimum(depth, GENTLE * approach)
            touch = max(1.0, comm.allreduce(float(np.min((gap + depth) / approach, initial=np.inf)), op=MPI.MIN))
            # what the load has bent is prolonged, too: to be put right before anything touches
            touch *= 1.0 if touch < LONG else SHORT_OF
        part = comm.allreduce(part, op=MPI.MIN)
        if touch == np.inf and part > 1.0 and comm.allreduce(bool(np.all(falling[p.paired])), op=MPI.LAND):
            return None
        return min(touch, part) if touch < np.inf else min(1.0, part)
    return min(1.0, comm.allreduce(part, op=MPI.MIN))


def lost(gap, paired, closed, size):
    """Points of this rank that the partners of the last load step have misled, by the gaps (np,) of a new search.

    Parameters
    ----------
    gap : ndarray (np,)
        [length]
    paired : ndarray (np,) of bool
    closed : ndarray (np,) of bool
        At the end of the last load step.
    size : ndarray (np,)
        Of the facets [length].

    Returns
    -------
    passed : int
        Open at the end of the last load step, and now inside their partner by more than a tenth of their facet.
    left : int
        Closed at the end of the last load step, and now without a partner.
    """
    passed = paired & ~closed & (gap < -DEEPER * size)
    return int(np.sum(passed)), int(np.sum(closed & ~paired))


def lost_by_obstacle(pair, u, values):
    """The same by the frozen normals of an obstacle: its distance is known. What is inside without a partner has
    passed, too. *Collective.*"""
    search, source = pair.search, pair.source
    gap, _ = search.among.distance(search.deformed(pair.space.local.gather(u)), pair.history.time, search.origin)
    gap = gap + search.offset
    near, wrong = pair.pairing.paired, DEEPER * source.size[source.facet]
    linear = np.where(near, pair.terms.gap(pair.pairing, values), 0.0)
    passed, left = gap < np.minimum(linear, 0.0) - wrong, near & pair.history.closed & (gap > linear + wrong)
    return int(np.sum(passed)), int(np.sum(left))


def normal_motion(pair, u, before):
    """Largest motion of a source point along its normal against the target between two displacements [length]: the
    target's is that of the partner or, where there is none, that of any of its places. Of points without a partner it
    is a bound as long as that is no more than the search radius. *Collective.*"""
    p, gap, comm = pair.pairing, pair.terms.gap, pair.space.comm
    change = gap(p, p.exchange.gather(u)) - gap(p, p.exchange.gather(before))
    if not pair.rigid:
        nodes, local = np.unique(pair.search.target.nodes), pair.space.local
        moved = local.gather(u)[nodes] - local.gather(before)[nodes]
        alone = np.flatnonzero(~p.paired)
        low, high = bounding_box(comm, moved)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        bound = np.abs(change[alone] + p.normal[alone] @ middle) + np.abs(p.normal[alone]) @ half
        # the box depends on the axes: what goes too far is decided by the motions themselves
        far = np.flatnonzero(bound > pair.radius)
        if comm.allreduce(bool(len(far)), op=MPI.LOR):
            moved = np.concatenate(comm.allgather(moved))
            exact = np.empty(len(far))
            farthest(change[alone[far]], p.normal[alone[far]], moved, exact)
            bound[far] = exact
        change[alone] = bound
    return comm.allreduce(float(np.max(np.abs(change), initial=0.0)), op=MPI.MAX)


@njit
def farthest(change, normal, moved, out):
    """Largest magnitude out (np,) of change (np,) plus the part along normals (np, d) of any motion (n, d)."""
    d = normal.shape[1]
    for p in range(len(change)):
        most = 0.0
        for k in range(len(moved)):
            along = change[p]
            for i in range(d):
                along += normal[p, i] * moved[k, i]
            most = max(most, abs(along))
        out[p] = most


def misled(pair, u, found, normal, time, keeps=0.0, former=None):
    """Part by which contact forces at a solution ``u`` would be others among the partners that a search finds there.

    Stiff points make much of small changes of their gap: the forces of the bodies change by as much of themselves as
    the change of the gap is of the way by which the bodies have been pressed together, however large gamma is. The mean
    over the closed points, weighted with their pressures, of the change of the gap counts over that of the
    :func:`closing_motion`, and the angle by which their normals turn the resultant. *Collective.*

    Parameters
    ----------
    pair : pcontact.contact.pair.ContactPair
    u : PETSc.Vec
    found : pcontact.contact.search.partners.Partners
    normal : ndarray (np, d)
        By which the load step has gone at ``u``.
    time : float
        Of the solution.
    keeps : float
        Part of the answer that a point between two facets may change.
    former : ndarray (np, d), optional
        Normals before those by which the load step has gone. A point that would go back to them may keep what it has if
        it changes the answer by less than `keeps`: at the edge between two facets each solution finds the other one.

    Returns
    -------
    part : float
        Points that have lost their partner count as if they had moved all that way. At most all of the answer changes.
    deciding : float
        The same without the points that may keep what they have.
    lost : bool
        Whether there are such points, or open ones that are inside a partner, deeper than any closed point.
    way : float
        Mean of the ways by which the bodies have been pressed together [length]; 0 where nothing is closed.
    """
    p, comm, jxw, gap = pair.pairing, pair.space.comm, pair.source.jxw, found.gap
    values = p.exchange.gather(u)
    traction, linear = pair.terms.normal_state(p, values)
    bears = pair.forces(u)[1] > OPEN
    closed, misses = p.paired & bears & found.paired, p.paired & bears & ~found.paired
    force = np.where(bears, jxw * np.abs(traction + pair.method.gamma * linear), 0.0)
    change = np.where(closed, np.abs(gap - linear), 0.0)
    # rounding errors of a gap are no change
    change[change <= pair.search.rounding] = 0.0
    way = closing_motion(pair, u, values, time) @ np.where(closed, force, 0.0)
    deepest = comm.allreduce(float(np.max(-linear[closed], initial=0.0)), op=MPI.MAX)
    inside = found.paired & ~bears & (gap - pair.method.begins < -max(deepest, pair.search.rounding))
    # what its own tension holds open would be open with the gap of the search, too
    inside &= traction + pair.method.gamma * gap <= 0.0
    # what a phase ties stays as it is, and so does what is open between it
    inside &= not pair.law.held
    counts, areas = (np.sum(misses), np.sum(inside)), (jxw[bears].sum(), jxw[inside] @ -gap[inside])
    sums = [force.sum(), force[misses].sum(), *counts, *areas, *way, *(force @ normal)]
    total, missed, misses, inside, area, depth, *sums = comm.allreduce(np.array(sums), op=MPI.SUM)
    lost = bool(misses + inside > 0)
    if total == 0.0:
        return float(lost), float(lost), lost, 0.0
    way, resultant, turn = sum(np.abs(sums[:2])), np.array(sums[2:]), found.normal - normal
    returned = np.zeros(len(closed), dtype=bool)
    if former is not None:
        # each solution finds the partner of the other one
        returned = np.linalg.norm(found.normal - former, axis=1) <= RETURNED * np.linalg.norm(turn, axis=1)
        returned &= force * change <= keeps * way
    along = resultant / max(np.linalg.norm(resultant), 1e-300)
    parts = []
    for some in (closed, closed & ~returned):
        bent = np.where(some[:, None], turn, 0.0)
        changed, *bent = comm.allreduce(np.array([force[some] @ change[some], *(force @ bent)]), op=MPI.SUM)
        # what is inside without a word will bear as others do
        changed += total / area * depth
        # normals that spread or gather leave the force where it points
        turned = np.linalg.norm(bent - (bent @ along) * along) / total
        part = changed / max(way, changed) if changed > 0.0 else 0.0
        parts.append(float(max(part, turned) + missed / total))
    return *parts, lost, float(way / total)


def damped(way, last=None):
    """Parts of their ways to gaps that are found again which points go: less where these lie beyond by turns.

    A partner that stays takes along a gap whose derivative is that along the normal. Where the normal is not that of
    the partner's facet the true one is larger, by a ray at 45 degrees twice as large, and the gap that is found goes to
    and fro. Aitken's rule at each point.

    Parameters
    ----------
    way : ndarray (np,)
        From the gaps as they are to those that are found [length].
    last : (ndarray (np,), ndarray (np,)), optional
        What this has said in the last search of the load step.

    Returns
    -------
    way, part : ndarray (np,)
    """
    if last is None:
        return way, np.ones(len(way))
    before, part = last
    with np.errstate(divide="ignore", invalid="ignore"):
        part = part * before / (before - way)
    return way, np.where((part > 0.0) & (part < 1.0), np.maximum(part, DAMPED), 1.0)


def closing_motion(pair, u, values, time):
    """Ways (2, np) that the bodies have been pressed together at each point, along its normal, elastic or plastic
    [length].

    Each side has moved by so much against the mean motion of the other body: bodies that move as one are not pressed,
    and those whose surfaces move as one have each been pressed by what lies behind them. *Collective.*
    """
    here, there, mean, back = _motions(pair, u, values, time)
    return np.array([here - back, mean - there])


def compression(pair, u, values, time):
    """The same (2, np) against the mean motion of the side's own body: without the ways before bodies have touched.
    *Collective.*"""
    here, there, mean, back = _motions(pair, u, values, time)
    return np.array([there - back, mean - here])


def _motions(pair, u, values, time):
    """Motions (4, np) along the normals of the points and their partners, and the mean ones of their bodies, from
    source to target [length]. *Collective.*"""
    p, space, source, n_bodies = pair.pairing, pair.space, pair.source, pair.space.mesh.n_components
    own, other = components_of(space, p, source)
    moved, where = space.of_owned(u), space.component[space.owned_local]
    sums = [np.bincount(where, column, minlength=n_bodies) for column in (*moved.T, np.ones(len(moved)))]
    sums = space.comm.allreduce(np.array(sums), op=MPI.SUM)
    mean = (sums[:-1] / np.maximum(sums[-1], 1.0)).T
    here = np.einsum("pa,pad->pd", source.shape, values[p.cells[source.facet]])
    if pair.rigid:
        origin = pair.search.origin
        there = back = np.broadcast_to(pair.search.among.moved(source.x - origin, 0.0, time, origin), here.shape)
    else:
        there, back = np.einsum("pm,pmd->pd", p.target_shape, values[p.targets]), mean[other]
    return np.array([np.einsum("pd,pd->p", way, p.normal) for way in (here, there, mean[own], back)])


def clearance(pair, u, fields, beyond):
    """Distances of points from contact, and their change by motions of whole bodies, see
    :meth:`pcontact.assembly.item.Item.clearance`. *Collective.*"""
    p, source = pair.pairing, pair.source
    own, other = components_of(pair.space, p, source)
    some = np.flatnonzero(p.paired & (own != other))
    distance = (pair.pressed(u) - (pair.law.reach if beyond else 0.0)) / pair.method.gamma
    rows = np.empty((len(some), 2, len(fields)))
    for k, field in enumerate(fields):
        values = p.exchange.gather(field)
        jumps = np.einsum("pa,pad->pd", source.shape[some], values[p.cells[source.facet[some]]])
        rows[:, 0, k] = -np.einsum("pd,pd->p", jumps, p.normal[some])
        jumps = np.einsum("pm,pmd->pd", p.target_shape[some], values[p.targets[some]])
        rows[:, 1, k] = np.einsum("pd,pd->p", jumps, p.normal[some])
    return distance[some], np.column_stack([own, other])[some], rows
