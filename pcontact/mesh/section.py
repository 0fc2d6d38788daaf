"""Cutting a mesh across a body: nodes of a plane group of facets are doubled, so that its two sides may part."""

import itertools

import numpy as np

from pcontact.element.reference import facet_kinds, facet_nodes
from pcontact.runtime.errors import InputError

# what the other side of a section is called
OTHER = "{} (other side)"
# [-] Distance of nodes from the plane of a section, in parts of its extent. From: far above what files round.
PLANE = 1e-6


def cut(raw, name):
    """Double the nodes of a group of facets inside a body, in place. The group is its lower side from then on.

    Parameters
    ----------
    raw : pcontact.mesh.groups.RawMesh
    name : str
        Group of facets in a plane. The other side, to which the normal of :func:`plane` points, gets the name
        :data:`OTHER`.

    Raises
    ------
    InputError
        Facets are on the boundary, or not in a plane.
    """
    cells, local = raw.facet_groups[name]
    nodes = _nodes(raw, cells, local)
    centre, normal, off = plane(raw.points[nodes])
    if off > PLANE:
        raise InputError(f"{raw.path}: section {name!r}: found nodes that are not in a plane; allowed: a plane section")
    first, count = 0, len(raw.points)
    twin = np.arange(count)
    twin[nodes] = count + np.arange(len(nodes))
    sides, upper = {False: [], True: []}, []
    for block in raw.blocks:
        touching = np.flatnonzero(np.isin(block.nodes, nodes).any(axis=1))
        above = (raw.points[block.vertices[touching]].mean(axis=1) - centre) @ normal > 0.0
        for side, (kind, numbers) in itertools.product(sides, facet_kinds(block.cell)):
            own, table = touching[above == side], facet_nodes(kind, block.degree)[numbers]
            inside = np.isin(block.nodes[own][:, table], nodes).all(axis=2)
            row, facet = np.nonzero(inside)
            sides[side].append((first + own[row], numbers[facet]))
        upper.append(touching[above])
        first += len(block.nodes)
    sides = {side: tuple(np.concatenate(parts) for parts in zip(*rows, strict=True)) for side, rows in sides.items()}
    if not len(cells) == len(sides[False][0]) == len(sides[True][0]):
        raise InputError(
            f"{raw.path}: section {name!r}: found {len(cells)} facets, {len(sides[False][0])} on one side of their "
            f"plane and {len(sides[True][0])} on the other; allowed: all facets of a plane across a body"
        )
    for group, edges in raw.edge_groups.items():
        raw.edge_groups[group] = _edges(edges, twin, (raw.points - centre) @ normal > 0.0)
    for block, rows in zip(raw.blocks, upper, strict=True):
        block.nodes[rows] = twin[block.nodes[rows]]
    raw.points = np.concatenate([raw.points, raw.points[nodes]])
    raw.facet_groups[name], raw.facet_groups[OTHER.format(name)] = sides[False], sides[True]
    for group, members in raw.node_groups.items():
        raw.node_groups[group] = np.unique(np.concatenate([members, twin[members]]))


def _edges(edges, twin, above):
    """Edges (n, 2) after their ends in the section are doubled, those within it on both sides."""
    doubled = twin[edges] != edges
    high = above[edges] & ~doubled
    moved = np.where(doubled & high.any(axis=1)[:, None], twin[edges], edges)
    within = doubled.all(axis=1)
    return np.concatenate([moved, twin[edges[within]]])


def _nodes(raw, cells, local):
    """Nodes of facets given by the numbers of their cells and their own in these."""
    found, first = [np.zeros(0, dtype=np.int64)], 0
    for block in raw.blocks:
        for kind, numbers in facet_kinds(block.cell):
            own = (cells >= first) & (cells < first + len(block.nodes)) & np.isin(local, numbers)
            rows = block.nodes[cells[own] - first]
            found.append(np.take_along_axis(rows, facet_nodes(kind, block.degree)[local[own]], axis=1).ravel())
        first += len(block.nodes)
    return np.unique(np.concatenate(found))


def plane(points):
    """Centre (d,), unit normal (d,) of the plane (in the plane: line) through points (n, d), and how far points are off
    it in parts of their extent. The largest component of the normal is positive."""
    centre = points.mean(axis=0)
    _, sizes, ways = np.linalg.svd(points - centre, full_matrices=False)
    normal = ways[-1]
    normal = normal * np.sign(normal[np.argmax(np.round(np.abs(normal), 6))])
    extent = max(float(np.ptp(points - centre, axis=0).max()), 1e-300)
    return centre, normal, float(np.abs((points - centre) @ normal).max()) / extent
