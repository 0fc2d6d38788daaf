"""Source facets in space divided where they are larger than the target's, so that their quadrature resolves these.

Facets are not cut along the edges of the target in space: the trace of the target's displacement has kinks within a
source facet, and the quadrature across them leaves an error in the nodal forces of the target. It is small where the
target's facets are as large as the source's or larger. In unbiased contact the coarser of the two surfaces is a source,
too; its rule is repeated on equal parts of the facet, as many along an edge as facets of the target are.
"""

import dataclasses

import numpy as np

from pcontact.contact.exchange import find_partners
from pcontact.contact.surface import default_quadrature
from pcontact.element.geometry import facet_geometry
from pcontact.element.quadrature import composite
from pcontact.element.reference import CELLS

# an edge of the source that is longer than that of the target by this part of it is not divided
SLACK = 0.25
# points of the other surface cost what they cost there; beyond that many parts along an edge, facets have other faults
MOST = 16


def _edges(x):
    """Lengths (n,) of an edge of facets with corners x (n, >= 3, 3): of the square with their area, or twice theirs."""
    return np.sqrt(np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1))


def _positions(space, nodes):
    """Reference positions (n, m, 3) of global nodes (n, m). *Collective.*"""
    own = space.vector()
    own.setArray(space.points[space.owned_local].ravel())
    unique, place = np.unique(nodes, return_inverse=True)
    found = space.exchange(unique).gather(own)
    own.destroy()
    return found.reshape(-1, space.dim)[place.reshape(nodes.shape)]


def parts_of(space, source, edges, target, radius, method):
    """Parts along an edge of each source facet (nf,): as many as edges of the facets that it faces. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Three-dimensional.
    source : SourceSurface
        With its points before the division.
    edges : ndarray (nf,)
        Of the source facets [length].
    target, radius, method
        See `pcontact.contact.exchange.find_partners`.
    """
    nodal = np.zeros((space.n_local, space.dim))
    found = find_partners(space, target, nodal, source.x, source.normal, radius, method)
    met = found.id >= 0
    x = _positions(space, found.nodes[met][:, :3])
    facet = source.facet[met]
    ratio = edges[facet] / np.maximum(_edges(x), 1e-300)
    count, total = (np.bincount(facet, weights, minlength=len(edges)) for weights in (None, ratio))
    return np.clip(np.ceil(total / np.maximum(count, 1.0) - SLACK), 1, MOST).astype(np.int64)


def divided_source(space, source, name, target, radius, method, degree=None):
    """The source surface with a quadrature rule on every part of its facets. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Three-dimensional.
    source : SourceSurface
    name : str
        Its facet group.
    target : TargetSurface
    radius : float
        Search radius [length].
    method : {"closest_point", "ray_tracing"}
    degree : int, optional
        Of the rule on each part.

    Returns
    -------
    SourceSurface
        The same facets; the parts are those that the undeformed bodies ask for.
    """
    groups = space.mesh.facet_groups.get(name, [])
    corners = [space.mesh.points[space.mesh.facet_nodes(facets)[:, :3]] for facets in groups]
    edges = _edges(np.concatenate(corners)) if groups else np.zeros(0)
    parts = parts_of(space, source, edges, target, radius, method)
    if not np.any(parts > 1):
        return source
    pieces, first = [], 0
    for facets in groups:
        mine = parts[first : first + len(facets.cells)]
        for k in np.unique(mine):
            rows = np.flatnonzero(mine == k)
            pieces.append(_points(space, facets, rows, int(k), degree, source.shape.shape[1], first))
        first += len(mine)
    facet = np.concatenate([piece["facet"] for piece in pieces])
    order = np.argsort(facet, kind="stable")
    joined = {key: np.ascontiguousarray(np.concatenate([p[key] for p in pieces])[order]) for key in pieces[0]}
    return dataclasses.replace(source, **joined)


def _points(space, facets, rows, k, degree, width, first):
    """Points of some facets of a block, each with k parts along an edge; see `SourceSurface`."""
    mesh, block = space.mesh, space.mesh.blocks[facets.block]
    table, geometry_degree = mesh.geometry_nodes(block)
    kind = CELLS[block.cell].facet
    xi, weights = composite(kind, degree or default_quadrature(kind, space.degree), k)
    x, local = mesh.points[table[facets.cells[rows]]], facets.local[rows]
    at = facet_geometry(block.cell, x, local, geometry_degree, space.degree, xi, weights)
    n, nn = len(rows) * len(weights), at.shape.shape[-1]
    values, grad = np.zeros((n, width)), np.zeros((n, width, space.dim))
    values[:, :nn], grad[:, :nn] = at.shape.reshape(n, nn), at.gradients.reshape(n, nn, space.dim)
    return {
        "facet": np.repeat(first + rows, len(weights)), "x": at.points.reshape(n, -1),
        "normal": at.normals.reshape(n, -1), "jxw": at.jxw.ravel(), "shape": values, "grad": grad,
    }  # fmt: skip
