"""Which point touches which."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Pairing:
    """Partners of the source points, frozen until the next search.

    Attributes
    ----------
    exchange : pcontact.runtime.parallel.NodeExchange
        Brings the displacement of all nodes of the pair.
    cells (nf, nn), targets (np, m) : ndarray
        Numbers into these nodes.
    paired : ndarray (np,) of bool
    ids : ndarray (np,)
        Target facets, for the pattern.
    normal : ndarray (np, d)
    b : ndarray (np, nn, d)
        Operator of the normal traction; with friction, where all of the traction counts, of width 0.
    target_shape : ndarray (np, m)
    gap0 : ndarray (np,)
        Gap at zero displacement of the frozen linear gap [length].
    acts : ndarray (np,) of bool
        Points that add to residual and tangent. Without a partner there is no pressure, and only the adjoint term of
        theta = 1, -1 asks for the traction.
    every : ndarray (np,) of bool
        All of them.
    """

    exchange: object
    cells: np.ndarray
    targets: np.ndarray
    paired: np.ndarray
    ids: np.ndarray
    normal: np.ndarray
    b: np.ndarray
    target_shape: np.ndarray
    gap0: np.ndarray
    acts: np.ndarray
    every: np.ndarray

    def touched(self, space, facet, points):
        """Owned nodes (n,), global numbers, of the source cells and target facets of some points. *Collective.*

        Parameters
        ----------
        space : pcontact.space.space.Space
        facet : ndarray (np,)
            Source facet of every point.
        points : ndarray (np,) of bool
        """
        local = np.zeros((len(self.exchange.nodes), space.dim))
        local[self.cells[facet[points]].ravel(), 0] = 1.0
        local[self.targets[points].ravel(), 0] = 1.0
        return space.start + np.flatnonzero(space.summed(self.exchange, local)[:, 0] > 0.5)
