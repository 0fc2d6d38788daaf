"""Areas that forces of contact act on: of the source, where they are integrated, and of the target.

Areas are those of the bodies as they are given, as the strains are small ones, but partners are those of surfaces that
have moved: where one body is stretched along the surface more than the other, or where round surfaces are pressed flat,
a force acts on another area of the target than of the source. The partners themselves tell it: on a facet of the source
their places are taken as a linear function of those of its points.
"""

import numpy as np

# [-] Least extent of the points of a facet in a direction, over the largest one, with which they tell an area. From:
# chosen; points on a line tell none.
LEAST = 1e-3


def areas(space, pair, some, weight):
    """Area of the target over that of the source at points of a pair. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    pair : pcontact.contact.pair.ContactPair
    some : ndarray (n,) of int
        The points, which have partners.
    weight : ndarray (np,)
        Areas of all of them on the source.

    Returns
    -------
    ndarray (n,)
        1 where those of a facet do not tell.
    """
    pairing, source = pair.pairing, pair.source
    places = space.vector()
    places.setArray(space.points[space.owned_local].ravel())
    nodes = pairing.exchange.gather(places)[pairing.targets]
    places.destroy()
    x, y = source.x[some], np.einsum("pa,pad->pd", pairing.target_shape[some], nodes[some])
    facets, facet = np.unique(source.facet[some], return_inverse=True)
    ratio = stretched(facet, len(facets), weight[some], x, y)[facet]
    return ratio * y[:, 0] / x[:, 0] if space.axisymmetric else ratio


def stretched(facet, count, weight, x, y):
    """Areas of what becomes of facets, over their own: of the linear function of their points that is nearest.

    Parameters
    ----------
    facet : ndarray (n,) of int
        Facet of each point.
    count : int
        Of facets.
    weight : ndarray (n,)
    x, y : ndarray (n, d)
        Points, and what becomes of them [length].

    Returns
    -------
    ndarray (count,)
        1 where points do not tell.
    """
    d = x.shape[1]
    whole = np.bincount(facet, weight, minlength=count)
    middle = [np.stack([np.bincount(facet, weight * row, minlength=count) for row in some.T], axis=1) / whole[:, None]
              for some in (x, y)]  # fmt: skip
    x, y = x - middle[0][facet], y - middle[1][facet]
    own, both = np.zeros((2, count, d, d))
    np.add.at(own, facet, weight[:, None, None] * x[:, :, None] * x[:, None, :])
    np.add.at(both, facet, weight[:, None, None] * y[:, :, None] * x[:, None, :])
    # directions in which points are spread, the last ones most: along the facet
    spread, along = np.linalg.eigh(own)
    spread, along = spread[:, 1:], along[:, :, 1:]
    told = spread[:, 0] > LEAST**2 * spread[:, -1]
    slopes = np.matmul(both, along) / np.where(told[:, None], spread, 1.0)[:, None, :]
    squares = np.matmul(slopes.transpose(0, 2, 1), slopes)
    area = np.sqrt(np.maximum(np.linalg.det(squares), 0.0))
    return np.where(told & (area > 0.0), area, 1.0)
