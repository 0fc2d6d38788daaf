"""Which point touches which."""

from dataclasses import dataclass

import numpy as np

from pcontact.contact.points import PartnerPoints, SourcePoints, TractionOperator


@dataclass
class Pairing:
    """Partners of the source points, frozen until the next search.

    Attributes
    ----------
    exchange : pcontact.runtime.parallel.NodeExchange
        Brings the displacement of all nodes of the pair.
    source : pcontact.contact.points.SourcePoints
        With numbers into these nodes, as the partners.
    partner : pcontact.contact.points.PartnerPoints
    paired : ndarray (np,) of bool
    ids : ndarray (np,)
        Target facets, for the pattern.
    operator : pcontact.contact.points.TractionOperator or None
        Derivative of the traction; None at finite motion, where it is not the same at all displacements.
    acts : ndarray (np,) of bool
        Points that add to residual and tangent. Without a partner there is no pressure, and only the adjoint term of
        theta = 1, -1 asks for the traction.
    every : ndarray (np,) of bool
        All of them.
    """

    exchange: object
    source: SourcePoints
    partner: PartnerPoints
    paired: np.ndarray
    ids: np.ndarray
    operator: TractionOperator | None
    acts: np.ndarray
    every: np.ndarray

    @property
    def cells(self):
        """Nodes (nf, nn) of the parent cells."""
        return self.source.cells

    @property
    def targets(self):
        """Nodes (np, m) of the partners' facets."""
        return self.partner.nodes[:, : self.partner.shape.shape[1]]

    @property
    def target_shape(self):
        """Shape functions (np, m) there."""
        return self.partner.shape

    @property
    def normal(self):
        """Contact normals (np, d)."""
        return self.partner.normal

    @property
    def gap0(self):
        """Gap (np,) at zero displacement [length]."""
        return self.partner.gap0

    def touched(self, space, points):
        """Owned nodes (n,), global numbers, of the cells and target facets of some points (np,). *Collective.*"""
        local = np.zeros((len(self.exchange.nodes), space.dim))
        local[self.cells[self.source.facet[points]].ravel(), 0] = 1.0
        local[self.targets[points].ravel(), 0] = 1.0
        return space.start + np.flatnonzero(space.summed(self.exchange, local)[:, 0] > 0.5)
