"""Source facets in 2D cut where the target facet changes, so that no quadrature rule straddles a kink of the target.

The trace of the target's displacement along a source facet has a kink (and its gap a corner) wherever the partner moves
from one target facet to the next. A Gauss rule across such kinks leaves an error in the nodal forces of the target that
does not shrink relative to them when the mesh is refined, which limits the energy norm to order 1/2. The cuts are
found by bisection of the partner's facet number, with the search itself, so that every method of search, curved facets
and partners on other ranks need nothing of their own.
"""

import dataclasses

import numpy as np

from pcontact.contact.exchange import find_partners
from pcontact.contact.surface import default_quadrature
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import facet_points
from pcontact.element.shape import shape, shape_gradient

# intervals that each source facet starts with: a target facet shorter than one of them may be missed
SAMPLES = 8
# bisections: cuts are known to 2^-30 of a facet
BISECTIONS = 27
# shortest piece, in the reference segment
SLIVER = 1e-7


def _at(space, facets, rows, s):
    """Points s (n,) of facets `rows` of one part: position, normal, |dx/ds|, shape and gradients of the parent cell."""
    mesh, block = space.mesh, space.mesh.blocks[facets.block]
    table, degree = mesh.geometry_nodes(block)
    local, every = facets.local[rows], np.arange(len(rows))
    ends = facet_points(block.cell, np.array([[-1.0], [1.0]]))[local]
    xi = np.ascontiguousarray(facet_points(block.cell, s[:, None])[local, every])
    x = mesh.points[table[facets.cells[rows]]]
    jacobian = np.einsum("pai,paj->pij", x, shape_gradient(block.cell, degree, xi))
    tangent = np.einsum("pij,pj->pi", jacobian, 0.5 * (ends[:, 1] - ends[:, 0]))
    length = np.linalg.norm(tangent, axis=1)
    grad = np.einsum("paj,pji->pai", shape_gradient(block.cell, space.degree, xi), np.linalg.inv(jacobian))
    position = np.einsum("pa,pai->pi", shape(block.cell, degree, xi), x)
    normal = np.column_stack([tangent[:, 1], -tangent[:, 0]]) / length[:, None]
    return position, normal, length, shape(block.cell, space.degree, xi), grad


def _partners(space, parts, part, row, s, search):
    """Target facet (n,) of points s (n,) on facets `row` of parts `part`. *Collective.*"""
    x, normal = np.zeros((len(s), space.dim)), np.zeros((len(s), space.dim))
    for k, facets in enumerate(parts):
        chosen = np.flatnonzero(part == k)
        if len(chosen):
            x[chosen], normal[chosen] = _at(space, facets, row[chosen], s[chosen])[:2]
    target, radius, method = search
    first = np.cumsum([0, *(len(facets.cells) for facets in parts)], dtype=np.int64)
    target = target.seen_from(first[part] + row, x)
    nodal = np.zeros((space.n_local, space.dim))
    return find_partners(space, target, nodal, x, normal, radius, method).id


def cuts(space, parts, search):
    """Pieces of all source facets, sorted. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : list of pcontact.mesh.mesh.Facets
        The source facets of this rank.
    search : (TargetSurface, float, str)
        Target, search radius [length] and method.

    Returns
    -------
    part, row, facet : ndarray (n,)
        Part, row in it, and running number of each piece's facet.
    a, b : ndarray (n,)
        Ends of the piece in the facet's reference segment.
    """
    count = np.array([len(f.cells) for f in parts], dtype=np.int64)
    part = np.repeat(np.arange(len(parts)), count)
    row = np.concatenate([np.arange(n) for n in count]) if len(count) else np.zeros(0, dtype=np.int64)
    n = len(part)
    # just inside the facet: at its ends the partner is a matter of rounding
    grid = np.linspace(-1.0 + 1e-9, 1.0 - 1e-9, SAMPLES + 1)
    ids = _partners(space, parts, np.repeat(part, SAMPLES + 1), np.repeat(row, SAMPLES + 1), np.tile(grid, n), search)
    ids = ids.reshape(n, SAMPLES + 1)
    f, k = np.nonzero(ids[:, 1:] != ids[:, :-1])
    a, b, ia, ib = grid[k], grid[k + 1], ids[f, k], ids[f, k + 1]
    for _ in range(BISECTIONS):
        m = 0.5 * (a + b)
        im = _partners(space, parts, part[f], row[f], m, search)
        left, right = ia != im, im != ib
        f = np.concatenate([f[left], f[right]])
        a, b = np.concatenate([a[left], m[right]]), np.concatenate([m[left], b[right]])
        ia, ib = np.concatenate([ia[left], im[right]]), np.concatenate([im[left], ib[right]])
    facet = np.concatenate([np.arange(n), np.arange(n), f])
    at = np.concatenate([np.full(n, -1.0), np.full(n, 1.0), 0.5 * (a + b)])
    order = np.lexsort((at, facet))
    facet, at = facet[order], at[order]
    # a cut next to an end or to another cut is left out: its sliver stays with the neighbour
    first = np.concatenate([[True], facet[1:] != facet[:-1]]) if n else np.zeros(0, dtype=bool)
    apart = np.diff(at, prepend=-np.inf) > SLIVER
    keep = first | (at == 1.0) | (apart & (np.abs(at) < 1.0 - SLIVER))
    facet, at = facet[keep], at[keep]
    start = np.flatnonzero(facet[1:] == facet[:-1])
    return part[facet[start]], row[facet[start]], facet[start], at[start], at[start + 1]


def cut_source(space, source, name, target, radius, method, degree=None):
    """The source surface with a quadrature rule on every piece. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Two-dimensional.
    source : SourceSurface
    name : str
        Its facet group.
    target : TargetSurface
    radius : float
        Search radius [length].
    method : {"closest_point", "ray_tracing"}
    degree : int, optional
        Of the rule on each piece.

    Returns
    -------
    SourceSurface
        The same facets; the cuts are those of the undeformed bodies.
    """
    parts = space.mesh.facet_groups.get(name, [])
    part, row, facet, a, b = cuts(space, parts, (target, radius, method))
    xi, weights = quadrature("segment", degree or default_quadrature("segment", space.degree))
    nq, nn = len(weights), source.shape.shape[1]
    s = (0.5 * (a + b)[:, None] + 0.5 * (b - a)[:, None] * xi[:, 0]).ravel()
    w = (0.5 * (b - a)[:, None] * weights).ravel()
    part, row, facet = np.repeat(part, nq), np.repeat(row, nq), np.repeat(facet, nq)
    n, d = len(s), space.dim
    x, normal, jxw = np.empty((n, d)), np.empty((n, d)), np.empty(n)
    values, grad = np.zeros((n, nn)), np.zeros((n, nn, d))
    for k, facets in enumerate(parts):
        c = np.flatnonzero(part == k)
        x[c], normal[c], length, v, g = _at(space, facets, row[c], s[c])
        values[c, : v.shape[1]], grad[c, : v.shape[1]] = v, g
        jxw[c] = w[c] * length * space.circumference(x[c])
    return dataclasses.replace(source, facet=facet, x=x, normal=normal, jxw=jxw, shape=values, grad=grad)
