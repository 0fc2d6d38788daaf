"""What is known of the estimate: its range over the error, by the class of a scene."""

from typing import NamedTuple


class Range(NamedTuple):
    """Estimate over error.

    Attributes
    ----------
    least, most : float
    words : str
        Of which scenes.
    dim : int
        Of space.
    """

    least: float
    most: float
    words: str
    dim: int


# by simplices or not, dimension and degree. From: drivers/studies/effectivity.py and adapt.py, docs/estimate.md; the
# least of triangles of degree 2 from named_error.py (0.85)
MEASURED = {
    (True, 2, 1): (0.95, 1.45),
    (True, 2, 2): (0.8, 1.25),
    (True, 3, 1): (1.2, 2.4),
    (True, 3, 2): (1.0, 1.6),
    (False, 2, 1): (0.98, 1.1),
    (False, 2, 2): (0.8, 1.1),
    (False, 3, 1): (1.0, 1.15),
    (False, 3, 2): (0.9, 1.15),
}
# [-] Of both ends where friction or plastic flow are in the scene. From: no proof, and fewer scenes.
WITHOUT_PROOF = 0.9


# [-] Of the lower end where bodies have different degrees. From: blocks that share nodes, one 1000 times as
# stiff; those of degree 2 lack functions there that their estimate takes as given.
JOINED = 0.9

# of quantities: from rings, punch, Hertz, and a load that the first mesh hardly sees (0.44), named_error.py
QUANTITIES = {"pressure": (0.6, 2.5)}
OTHERS = (0.4, 2.0)


def of_quantity(quantity, dim):
    """The range of the estimate of a quantity."""
    least, most = QUANTITIES.get(quantity, OTHERS)
    return Range(least, most, f"{quantity} by a dual problem" if quantity != "pressure" else "pressure in L2", dim)


def effectivity(scene, simplices, dim, degree):
    """The range of the estimate of the energy norm for a class of scenes.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    simplices : bool
        Whether there are triangles or tetrahedra.
    dim, degree : int
        Of space and of the displacement.

    Returns
    -------
    Range
    """
    degrees = sorted({degree} | {1 for body in scene.bodies if scene.lower(body)})
    ranges = [MEASURED[simplices, dim, one] for one in degrees]
    least, most = min(one[0] for one in ranges), max(one[1] for one in ranges)
    words = f"{'triangles' if dim == 2 else 'tetrahedra'}" if simplices else "quadrilaterals, hexahedra"
    words += f" of degree {' and '.join(map(str, degrees))}"
    if degrees[0] < degree:
        least *= JOINED
    if scene.remembers:
        return Range(WITHOUT_PROOF * least, most / WITHOUT_PROOF, f"{words}, with friction or plastic flow", dim)
    return Range(least, most, f"{words}, elastic without friction", dim)
