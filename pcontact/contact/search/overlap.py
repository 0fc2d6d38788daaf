"""Depth of bodies in each other before anything is deformed."""

from dataclasses import replace

import numpy as np

from pcontact.contact.search.partners import PartnerSearch
from pcontact.contact.search.projection import QueryPoints
from pcontact.contact.surface.sides import surface_of
from pcontact.mesh.topology import outer_facets
from pcontact.runtime.petsc import MPI

# [cosine] Smallest one between the normal of a point and that of the nearest facet: any.
ANY = -2.0


def overlap(space, source, target, method, bodies):
    """Largest depth of points of a source inside bodies, to their partners on a target there. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    source : pcontact.contact.surface.sides.SourceSurface
    target : pcontact.contact.surface.sides.TargetSurface
        Of these bodies.
    method : str
        closest_point or ray_tracing.
    bodies : set of int
        Connected components, none of which the source belongs to.

    Returns
    -------
    float
        [length]; 0 where no point is inside.
    """
    still = np.zeros_like(space.points)
    outer = [_of_bodies(space, facets, bodies) for facets in outer_facets(space.mesh, space.exchanger)]
    nearest = PartnerSearch(space, surface_of(space, outer), still, "closest_point", facing=ANY)
    found = nearest(QueryPoints(source.x, source.normal, np.inf))
    inside = (found.id >= 0) & (found.gap < 0.0)
    found = PartnerSearch(space, target, still, method)(QueryPoints(source.x[inside], source.normal[inside], np.inf))
    depth = float(np.max(-found.gap[found.id >= 0], initial=0.0))
    return space.comm.allreduce(depth, op=MPI.MAX)


def _of_bodies(space, facets, bodies):
    """Those of some facets that belong to connected components."""
    rows = np.isin(space.mesh.blocks[facets.block].components[facets.cells], list(bodies))
    return replace(facets, cells=facets.cells[rows], local=facets.local[rows])
