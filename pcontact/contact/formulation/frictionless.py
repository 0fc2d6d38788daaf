"""The terms of a pair without friction: normal tractions alone."""

import numpy as np

from pcontact.contact.formulation.frictionless_kernels import add_residual, add_tangent, evaluate
from pcontact.contact.law import OPEN, SLIP


class FrictionlessTerms:
    """Residual and tangent of a pair at its points, as functions of nodal values (n, d) and the view of a rule.

    Parameters
    ----------
    space : pcontact.space.space.Space
    source : pcontact.contact.surface.sides.SourceSurface
    method : pcontact.contact.formulation.methods.Method
    traction : pcontact.contact.traction.elastic.ElasticTraction
    law : pcontact.contact.law.Frictionless
    """

    def __init__(self, space, source, method, traction, law):
        self.space, self.source, self.method, self.traction, self.law = space, source, method, traction, law

    # -- a load step ----------------------------------------------------------------------------------------------

    def operator(self, normal, last):
        """Operator b (np, nn, d) of the normal traction, from that of the last pairing where normals are the same."""
        return self.traction.normal_operator(normal, last)

    def begin(self, p, values, moved, turned):
        """A load step begins, with a pairing and displacements (n, d).

        Parameters
        ----------
        p : pcontact.contact.pairing.Pairing
        values : ndarray (n, d)
        moved : ndarray (np, d) or (d,), or zero
            What an obstacle moves in it [length].
        turned : callable
            Vectors (np, d) that turn with the obstacle, at the end of it.
        """
        self.method.begin()

    def commit(self, p, values, view):
        """The load step has ended; returns the status (np,) of the points. *Collective.*"""
        _, status = self.forces(p, values, view)
        self.method.commit()
        return status

    def memory(self, keys):
        """Tables for a checkpoint, see `pcontact.assembly.item.Item.memory`."""
        return self.method.memory(keys)

    def recall(self, name, keys, chunks):
        """Take a table back, see `pcontact.assembly.item.Item.recall`."""
        return self.method.recall(name, keys, chunks)

    # -- at the points --------------------------------------------------------------------------------------------

    def gap(self, p, values):
        """Gap (np,) [length]."""
        return self._evaluate(p, values)[1]

    def approach(self, p, u, y):
        """How far a step -y from u (distributed vectors) closes the gap (np,) [length]. *Collective.*"""
        return self.gap(p, p.exchange.gather(y)) - p.gap0

    def _evaluate(self, p, values):
        traction, gap = np.empty(len(p.paired)), np.empty(len(p.paired))
        evaluate(values, p.source, p.partner, p.b, traction, gap)
        return traction, gap

    def normal_state(self, p, values, wanted=None):
        """Normal traction and gap (np,), at least of the points that are wanted (np,)."""
        traction, gap = self._evaluate(p, values)
        self.traction.add_normal_excess(values, p, traction)
        return self.method.normal_traction(traction, p.normal), gap

    def _pressed(self, p, values):
        traction, gap = self.normal_state(p, values)
        return traction, traction + self.method.gamma[self.source.facet] * gap

    def forces(self, p, values, view):
        """Tractions P (np, d) that act on the source, and status (np,)."""
        _, tau = self._pressed(p, values)
        closed = self.law.closed(view, tau)
        return np.where(closed, tau, 0.0)[:, None] * p.normal, self._status(closed)

    @staticmethod
    def _status(closed):
        return np.where(closed, SLIP, OPEN)

    def slopes(self, p, values, view):
        """What :meth:`add_tangent` needs of the law, and status (np,)."""
        closed = self.law.closed(view, self._pressed(p, values)[1])
        return closed, self._status(closed)

    def derivative(self, p, values, view):
        """Derivative (np, d, d) of the tractions of :meth:`forces` in the augmented ones."""
        return self.slopes(p, values, view)[0][:, None, None] * p.normal[:, :, None] * p.normal[:, None, :]

    # -- residual and tangent -------------------------------------------------------------------------------------

    def add_residual(self, p, values, view, local):
        """Add to forces ``local`` (n, d)."""
        traction, tau = self._pressed(p, values)
        pressure = np.where(self.law.closed(view, tau), tau, 0.0)
        add_residual(self.method.parameters, p.source, p.partner, p.b, traction, pressure, local)
        if self.traction.consistent:
            self.traction.add_adjoint(values, p, self._weights(p, traction, pressure), local)

    def _weights(self, p, traction, pressure):
        """What the adjoint operator is tested with: theta G^-1 (P - t) (np, d), times the weights of the points."""
        factor = self.method.theta / self.method.gamma[self.source.facet] * self.source.jxw
        return (factor * (pressure - traction))[:, None] * p.normal

    def add_tangent(self, p, values, view, slopes, blocks):
        """Add to blocks (BlockRows); returns how many entries had no place."""
        excess = self.traction.excess(values, p)
        points = np.flatnonzero(excess.at >= 0)
        across = np.einsum("kaij,ki->kaj", excess.rows, p.normal[points[np.argsort(excess.at[points])]])
        across = np.ascontiguousarray(across)
        missing = add_tangent(self.method.parameters, p.source, p.partner, p.b, excess, across, slopes, blocks)
        if self.traction.consistent:
            traction, tau = self._pressed(p, values)
            pressure = np.where(self.law.closed(view, tau), tau, 0.0)
            missing += self.traction.add_curvature(values, p, self._weights(p, traction, pressure), blocks)
        return missing

    # -- report ---------------------------------------------------------------------------------------------------

    def state(self, p, values, view):
        """What the points say beyond pressure and gap, see `pcontact.contact.pair.ContactPair.state`."""
        return {}
