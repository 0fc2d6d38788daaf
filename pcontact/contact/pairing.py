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
        Traction operator.
    target_shape : ndarray (np, m)
    gap0 : ndarray (np,)
        Gap at zero displacement of the frozen linear gap [length].
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
