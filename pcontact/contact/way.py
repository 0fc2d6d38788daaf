"""How far the points of a contact pair go: part of a Newton step that makes sense, and motion in a load step."""

import numpy as np

from pcontact.contact.laws import OPEN
from pcontact.contact.summary import components_of
from pcontact.runtime.parallel import together
from pcontact.runtime.petsc import MPI

# how deep a loose body goes that is brought to where it touches, in parts of a step on what it is given to lean on, a
# millionth of its own stiffness (`pcontact.build`)
GENTLE = 1e-5
# steps prolonged more than this end before it touches, after this part of the way
FAR, NEARLY = 30.0, 0.99
# part of a facet by which a point may be deeper in its partner than was known without being counted as lost
DEEPER = 0.1


class Way:
    """Part of :class:`pcontact.contact.item.ContactItem`."""

    def reach(self, u, y):
        """Part of the Newton step ``-y`` to take so that the pair makes sense after it. *Collective.*

        While no point is closed, a body that nothing holds goes until its nearest point has just closed (a tenth of
        a facet deep), be that less or more than the step, in which what it is given to lean on is of no size;
        afterwards its points may move by a search radius, beyond which their partners mean nothing.

        Returns
        -------
        float or None
            At most 1 once a point is closed; None, no say, for pairs of bodies that supports hold.
        """
        if not self.floats:
            return None
        p, source, comm = self.pairing, self.source, self.space.comm
        traction, gap = self._contact(p.exchange.gather(u), p.acts)
        moved = self._gap(p.exchange.gather(y))
        approach = moved - p.gap0
        part = self.radius / max(float(np.max(np.abs(approach), initial=0.0)), 1e-300)
        closed = p.paired & (traction + self.gamma[source.facet] * gap <= 0.0)
        if not comm.allreduce(bool(closed.any()), op=MPI.LOR):
            coming = p.paired & (approach > 0.0)
            depth, gap, approach = 0.1 * source.size[source.facet[coming]], gap[coming], approach[coming]
            touch = comm.allreduce(float(np.min((gap + depth) / approach, initial=np.inf)), op=MPI.MIN)
            if 1.0 < touch < np.inf:
                # the less the load, and the step, the less deep: else what has just closed springs back
                depth = np.minimum(depth, GENTLE * approach)
                touch = max(1.0, comm.allreduce(float(np.min((gap + depth) / approach, initial=np.inf)), op=MPI.MIN))
                # what the load has bent is prolonged, too: to be put right before anything touches
                touch *= 1.0 if touch < FAR else NEARLY
            part = comm.allreduce(part, op=MPI.MIN)
            return min(touch, part) if touch < np.inf else min(1.0, part)
        return min(1.0, comm.allreduce(part, op=MPI.MIN))

    def _lost(self, gap, paired):
        """Points of this rank that the partners of the last load step have misled, by the gaps (np,) of a new search.

        Returns
        -------
        passed : int
            Open at the end of the last load step, and now inside their partner by more than a tenth of their facet.
        left : int
            Closed at the end of the last load step, and now without a partner.
        """
        size = self.source.size[self.source.facet]
        passed = paired & ~self.closed & (gap < -DEEPER * size)
        return int(np.sum(passed)), int(np.sum(self.closed & ~paired))

    def _compare_with_obstacle(self, u, values):
        """Count the points that the frozen normals of an obstacle have misled: its distance is known. *Collective.*"""
        x, source = self._deformed(self.space.local.gather(u)), self.source
        gap, _ = together(self.space.comm, self.target.gap, x, self.time, self._origin)
        gap, linear = gap + (0.0 if self.offset is None else self.offset), self._gap(values)
        near, wrong = self.pairing.paired, DEEPER * source.size[source.facet]
        passed, left = near & (gap < np.minimum(linear, 0.0) - wrong), near & self.closed & (gap > linear + wrong)
        self.lost = int(np.sum(passed)), int(np.sum(left))

    def motion(self, u, before):
        """Largest motion of a source point along its normal against the target between two displacements [length]: the
        target's is that of the partner or, where there is none, that of any of its places. *Collective.*"""
        p = self.pairing
        change = self._gap(p.exchange.gather(u)) - self._gap(p.exchange.gather(before))
        if not self.rigid:
            middle, half = self._target_motion(u, before)
            alone = ~p.paired
            change[alone] = np.abs(change[alone] + p.normal[alone] @ middle) + np.abs(p.normal[alone]) @ half
        return self.space.comm.allreduce(float(np.max(np.abs(change), initial=0.0)), op=MPI.MAX)

    def _target_motion(self, u, before):
        """Middle and half extent (d,) of the box of what the target's nodes move between two displacements [length].
        *Collective.*"""
        comm, nodes = self.space.comm, self.target.nodes
        moved = self.space.local.gather(u)[nodes] - self.space.local.gather(before)[nodes]
        axes = tuple(range(moved.ndim - 1))
        low = np.array(np.min(moved, axis=axes, initial=np.inf))
        high = np.array(np.max(moved, axis=axes, initial=-np.inf))
        comm.Allreduce(MPI.IN_PLACE, low, op=MPI.MIN)
        comm.Allreduce(MPI.IN_PLACE, high, op=MPI.MAX)
        return 0.5 * (low + high), 0.5 * (high - low)

    def strayed(self, u, since):
        """How far closed points have gone along or across their partners between two displacements. *Collective.*

        Returns
        -------
        float
            The largest relative displacement, in sizes of the source facets.
        """
        p, source = self.pairing, self.source
        change = p.exchange.gather(u) - p.exchange.gather(since)
        _, status = self._augmented(p.exchange.gather(u))
        closed = np.flatnonzero((status > OPEN) & p.paired)
        facet = source.facet[closed]
        jump = np.einsum("pa,pad->pd", source.shape[closed], change[p.cells[facet]])
        jump -= np.einsum("pa,pad->pd", p.target_shape[closed], change[p.targets[closed]])
        parts = np.linalg.norm(jump, axis=1) / source.size[facet]
        return self.space.comm.allreduce(float(np.max(parts, initial=0.0)), op=MPI.MAX)

    def clearance(self, u, fields):
        """How far points are from contact, and what motions of whole bodies would change. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        fields : list of PETSc.Vec
            Displacements of m motions of every body at once.

        Returns
        -------
        distance : ndarray (n,)
            Of the points of this rank that have a partner other than their own body: by so much the gap has to shrink
            until they are closed [length].
        bodies : ndarray (n, 2)
            Components of points and partners; -1 for an obstacle.
        rows : ndarray (n, 2, m)
            What the motions of the two bodies add to the distance.
        """
        p, source = self.pairing, self.source
        own, other = components_of(self.space, p, source)
        some = np.flatnonzero(p.paired & (own != other))
        distance = self._pressed(u) / self.gamma[source.facet]
        rows = np.empty((len(some), 2, len(fields)))
        for k, field in enumerate(fields):
            values = p.exchange.gather(field)
            jumps = np.einsum("pa,pad->pd", source.shape[some], values[p.cells[source.facet[some]]])
            rows[:, 0, k] = -np.einsum("pd,pd->p", jumps, p.normal[some])
            jumps = np.einsum("pm,pmd->pd", p.target_shape[some], values[p.targets[some]])
            rows[:, 1, k] = np.einsum("pd,pd->p", jumps, p.normal[some])
        return distance[some], np.column_stack([own, other])[some], rows
