"""Distance from a rigid surface of facets, all of which every rank has.

It is the closest point of the search between bodies (`pcontact.contact.search.projection`), of any direction and
however far: normals at edges and corners tell the sides of the surface apart.
"""

import numpy as np

from pcontact.contact.search.projection import closest_points, surface_tree
from pcontact.contact.search.query import QueryPoints, TargetFacets
from pcontact.contact.surface.facet_maps import KIND

# [cosine] Smallest one between the normal of a point and that of its partner: any.
ANY = -2.0


class RigidSurface:
    """A surface of facets as a function: signed distance and its gradient.

    Parameters
    ----------
    surface : pcontact.mesh.read.FacetSurface
    inside : bool
        The free space is on the other side than that where normals look to.

    Attributes
    ----------
    place : ndarray (d,)
        Mean of the nodes, to which the places of points are relative [length].
    """

    def __init__(self, surface, inside):
        self.place, self._sign = surface.points.mean(axis=0), -1.0 if inside else 1.0
        x = np.ascontiguousarray((surface.points - self.place)[surface.nodes])
        kinds = np.array([KIND[one] for one in surface.kinds], dtype=np.int64)
        self._facets = TargetFacets(surface_tree(x, kinds), x, kinds, np.arange(len(kinds)))

    def __call__(self, x, time):
        """Distance (n,) [length] and gradient (n, d) at places x (n, d) relative to `place`; it stands still."""
        # their own normals do not matter
        normal = np.zeros_like(x)
        normal[:, 0] = 1.0
        found = closest_points(self._facets, QueryPoints(x, normal, np.inf), ANY)
        return self._sign * found.gap, -self._sign * found.normal
