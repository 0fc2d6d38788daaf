"""Connected parts of a mesh, the sense in which cells are numbered, outer facets, and what stays of a mesh without some
bodies or across a section.

Cells of bodies that are absent in a phase of the run are not there; blocks keep their numbers, and those of absent
bodies are empty. Facets of groups that belong to an absent cell belong to the cell on their other side, where that is
there.

At a section across a body the nodes of a plane group of facets are doubled, so that its two sides may part.
"""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_kinds, facet_nodes, n_nodes, reference_nodes, shape_gradient
from pcontact.mesh.mesh import Facets, mixed
from pcontact.mesh.plex import owners, told
from pcontact.mesh.raw import Block, facet_vertices, facets_among, find_facets, number_rows, numbered
from pcontact.runtime import log
from pcontact.runtime.errors import InputError, coordinates
from pcontact.runtime.jit import njit
from pcontact.runtime.parallel import rows_of

# how the determinant of a cell's map behaves: what `_senses` returns
POSITIVE, REVERSED, MIXED, FLAT = 0, 1, 2, 3
# what the other side of a section is called
OTHER = "{} (other side)"
# [-] Distance of nodes from the plane of a section, in parts of its extent. From: far above what files round.
PLANE = 1e-6


@njit
def _find(parent, node):
    """Root of a node; the path to it is halved on the way."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@njit
def _join(parent, vertices):
    """Join the trees of the vertices (nc, nv) of every cell; the lowest node becomes the root."""
    for cell in range(vertices.shape[0]):
        root = _find(parent, vertices[cell, 0])
        for k in range(1, vertices.shape[1]):
            other = _find(parent, vertices[cell, k])
            if other < root:
                parent[root] = other
                root = other
            else:
                parent[other] = root


@njit
def _roots(parent, nodes, roots):
    """Root of each of some nodes (n,)."""
    for k in range(nodes.shape[0]):
        roots[k] = _find(parent, nodes[k])


def label(tables, n_points):
    """Number the connected parts of cells given by their vertices.

    Parameters
    ----------
    tables : list of ndarray, (n_cells, n_vertices) int64
    n_points : int

    Returns
    -------
    ndarray, (n_cells in all tables,) int64
        Part of every cell, from 0 in the order of their first cells.
    """
    parent = np.arange(n_points, dtype=np.int64)
    for vertices in tables:
        _join(parent, np.ascontiguousarray(vertices, dtype=np.int64))
    nodes = np.concatenate([np.zeros(0, dtype=np.int64), *(vertices[:, 0] for vertices in tables)])
    roots = np.empty_like(nodes)
    _roots(parent, nodes, roots)
    _, first, part = np.unique(roots, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[part]


def merged(n, pairs):
    """Numbers (n,) of things of which pairs (m, 2) are one, from 0 in the order of the first ones."""
    return label([np.arange(n)[:, None].repeat(2, axis=1), pairs], n)[:n]


class Numbers(NamedTuple):
    """The connected components of a distributed mesh as they are, before bodies are joined.

    Attributes
    ----------
    names : list of str
    cells : list of ndarray (nc,)
        Component of the cells of each block.
    """

    names: list
    cells: list

    @classmethod
    def of(cls, mesh):
        """Those of a mesh."""
        return cls(list(mesh.component_names), [block.components.copy() for block in mesh.blocks])

    def give(self, mesh):
        """Let a mesh have them again."""
        mesh.n_components, mesh.component_names = len(self.names), list(self.names)
        for block, cells in zip(mesh.blocks, self.cells, strict=True):
            block.components = cells.copy()


def components(raw):
    """Connected component of every cell: cells that share a node are connected.

    Parameters
    ----------
    raw : RawMesh

    Returns
    -------
    ndarray, (n_cells,) int64
        Numbered from 0 in the order of their first cells.
    """
    return label([block.vertices for block in raw.blocks], len(raw.points))


@njit
def _ranges(points, nodes, slopes, low, high, scale):
    """Smallest and largest determinant of the map of every cell, and the rounding error to expect in it.

    points (n, d), nodes (nc, nn), slopes (nq, nn, d): reference gradients; out: low, high, scale (nc,).
    """
    d = points.shape[1]
    jacobian = np.zeros((3, 3))
    for cell in range(nodes.shape[0]):
        low[cell], high[cell] = np.inf, -np.inf
        size, far = 0.0, 0.0
        for i in range(d):
            smallest, largest = np.inf, -np.inf
            for a in range(nodes.shape[1]):
                x = points[nodes[cell, a], i]
                smallest, largest = min(smallest, x), max(largest, x)
            size = max(size, largest - smallest)
            far = max(far, abs(smallest), abs(largest))
        # a determinant is a sum of products of d lengths, each known to the rounding error of the coordinates
        scale[cell] = far * size ** (d - 1)
        for q in range(slopes.shape[0]):
            jacobian[:] = 0.0
            for a in range(nodes.shape[1]):
                for i in range(d):
                    # relative to the first node: a mesh far from the origin keeps its digits
                    x = points[nodes[cell, a], i] - points[nodes[cell, 0], i]
                    for j in range(d):
                        jacobian[i, j] += x * slopes[q, a, j]
            det = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
            if d == 3:
                det = (
                    jacobian[0, 0] * (jacobian[1, 1] * jacobian[2, 2] - jacobian[1, 2] * jacobian[2, 1])
                    - jacobian[0, 1] * (jacobian[1, 0] * jacobian[2, 2] - jacobian[1, 2] * jacobian[2, 0])
                    + jacobian[0, 2] * (jacobian[1, 0] * jacobian[2, 1] - jacobian[1, 1] * jacobian[2, 0])
                )
            low[cell], high[cell] = min(low[cell], det), max(high[cell], det)


def _determinants(points, cell, degree, nodes, at):
    """Least and largest determinant of the map of cells (n,) at places and quadrature points, and their scale."""
    xi = np.vstack([at, quadrature(cell, 2 * degree)[0]])
    if degree == 1 and CELLS[cell].is_simplex:
        xi = xi[:1]  # the map is affine
    low, high, scale = np.empty((3, len(nodes)))
    slopes = np.ascontiguousarray(shape_gradient(cell, degree, xi))
    _ranges(np.ascontiguousarray(points), np.ascontiguousarray(nodes, dtype=np.int64), slopes, low, high, scale)
    return low, high, scale


def jacobians(points, cell, degree, nodes):
    """Smallest determinant of the map of cells (n,) at their nodes and quadrature points.

    Parameters
    ----------
    points : ndarray (n_points, d)
    cell : str
    degree : int
        Of the map.
    nodes : ndarray (n, n_nodes)
    """
    return _determinants(points, cell, degree, nodes, reference_nodes(cell, degree))[0]


def _senses(points, block):
    """Sense of every cell of a block, from its vertices and quadrature points: (n_cells,) int64."""
    vertices = reference_nodes(block.cell, 1)
    low, high, scale = _determinants(points, block.cell, block.degree, block.nodes, vertices)
    noise = 64.0 * np.finfo(float).eps * scale
    sense = np.full(len(low), MIXED, dtype=np.int64)
    sense[low >= -noise] = POSITIVE
    sense[high <= noise] = REVERSED
    sense[(low >= -noise) & (high <= noise)] = FLAT
    return sense


def _collapsed(points, block):
    """Cells of a block (n_cells,) bool with an edge that is no longer than the rounding errors of its coordinates."""
    bad = np.zeros(len(block.nodes), dtype=bool)
    for one, other in CELLS[block.cell].edges:
        a, b = points[block.nodes[:, one]], points[block.nodes[:, other]]
        far = np.maximum(np.abs(a), np.abs(b)).max(axis=1)
        bad |= np.abs(b - a).max(axis=1) <= 64.0 * np.finfo(float).eps * far
    return bad


def mirror(cell, degree):
    """Permutation of a cell's nodes that turns its sense around.

    Parameters
    ----------
    cell : str
    degree : int

    Returns
    -------
    ndarray, (n_nodes,) int64
    """
    vertices = {3: [0, 2, 1], 4: [0, 2, 1, 3], 5: [0, 3, 2, 1, 4], 6: [0, 2, 1, 3, 5, 4], 8: [0, 3, 2, 1, 4, 7, 6, 5]}
    reference = CELLS[cell]
    swap = [0, 3, 2, 1] if cell == "quadrilateral" else vertices[reference.n_vertices]
    if degree == 1:
        return np.array(swap, dtype=np.int64)
    entities = [frozenset(entity) for entity in reference.edges + reference.faces]
    moved = [entities.index(frozenset(swap[v] for v in entity)) for entity in entities]
    order = [*swap, *(reference.n_vertices + m for m in moved)]
    return np.array([*order, *range(len(order), n_nodes(cell, degree))], dtype=np.int64)


def orient(path, points, blocks, tags):
    """Turn around the cells that are numbered in the reverse sense, and say how many; refuse bad cells.

    Parameters
    ----------
    path : Path
        For messages.
    points : ndarray, (n_points, d) float64
    blocks : list of Block
        Their nodes are changed in place.
    tags : ndarray, (n_cells,) int64
        The file's own cell numbers.

    Raises
    ------
    InputError
        Cells without volume; cells whose Jacobian changes sign; cells with an edge without length; cells that are on
        the same side of a facet as their neighbour: they are not only numbered in another sense, but folded over it.
    """
    sense = np.concatenate([_senses(points, block) for block in blocks])
    _refuse(path, points, blocks, tags, sense == FLAT, "has no volume", "cells with a volume")
    collapsed = np.concatenate([_collapsed(points, block) for block in blocks])
    what = "has an edge without length: its ends are at the same place"
    _refuse(path, points, blocks, tags, collapsed, what, "vertices apart from each other")
    what = "is inverted: its Jacobian changes sign"
    _refuse(path, points, blocks, tags, sense == MIXED, what, "cells that are not folded or twisted")
    turned = sense == REVERSED
    if not turned.any():
        return
    for block, own in numbered(blocks):
        rows = np.flatnonzero(turned[own])
        block.nodes[rows] = block.nodes[rows][:, mirror(block.cell, block.degree)]
    what = "is inverted: it lies on the same side of a facet as its neighbour"
    bad = _folded(blocks, len(points), turned)
    _refuse(path, points, blocks, tags, bad, what, "cells that lie beside each other")
    log.info("%s: %d of %d cells were numbered in the opposite sense: turned", path, turned.sum(), len(turned))


def _folded(blocks, n_points, turned):
    """Cells (n,) bool that are on the same side of a facet as a neighbour.

    turned (n,): their numbering has been turned. Of two such cells the one is meant that differs from most others.
    """
    wanted = np.zeros(n_points, dtype=bool)
    for block, own in numbered(blocks):
        wanted[block.vertices[turned[own]]] = True
    few = turned if 2 * turned.sum() <= len(turned) else ~turned
    bad = np.zeros(len(turned), dtype=bool)
    kinds = {kind for block in blocks for kind, _ in facet_kinds(block.cell)}
    for n_vertices in sorted({CELLS[CELLS[kind].facet].n_vertices for kind in kinds}):
        corners, cells, _ = facets_among(blocks, wanted, n_vertices)
        _, number = number_rows(corners, n_points)
        order = np.argsort(number, kind="stable")
        pair = np.flatnonzero(np.diff(number[order]) == 0)
        one, other = order[pair], order[pair + 1]
        # the vertex that follows the least one, going around
        lead = np.argmin(corners, axis=1)
        following = np.take_along_axis(corners, ((lead + 1) % n_vertices)[:, None], axis=1)[:, 0]
        same = following[one] == following[other] if n_vertices > 2 else lead[one] == lead[other]
        one, other = cells[one[same]], cells[other[same]]
        bad[np.where(few[other] & ~few[one], other, one)] = True
    return bad


def cell_name(points, blocks, tags, number):
    """A cell in the words of a message, such as ``cell 7 (quadrilateral at (0.5, 1.5))``.

    Parameters
    ----------
    points : ndarray, (n_points, d) float64
    blocks : list of Block
    tags : ndarray, (n_cells,) int64, or None
        The file's own cell numbers; None: numbered from 1.
    number : int

    Returns
    -------
    str
    """
    block, own = next(one for one in numbered(blocks) if number < one[1].stop)
    centroid = coordinates(points[block.vertices[number - own.start]].mean(axis=0))
    return f"cell {number + 1 if tags is None else tags[number]} ({block.cell} at {centroid})"


def _refuse(path, points, blocks, tags, bad, what, allowed):
    """Raise an InputError naming the first bad cell, its centroid and the number of bad cells."""
    if bad.any():
        named = cell_name(points, blocks, tags, int(np.flatnonzero(bad)[0]))
        raise InputError(f"{path}: {named} {what} ({bad.sum()} in all); allowed: {allowed}")


def once(keys):
    """Tell which of some keys (n,) are there once: ndarray (n,) of bool.

    Keys are random numbers already: each goes to the place of a table that its last bits name, or to the next that is
    free. That takes a tenth of the time of sorting.
    """
    keys = np.ascontiguousarray(keys).view(np.uint64)
    single = np.ones(len(keys), dtype=np.bool_)
    # two places for each key at least; -1 is free
    table = np.full(2 << max(len(keys), 1).bit_length(), -1, dtype=np.int64)
    _mark_repeated(keys, table, single)
    return single


@njit
def _mark_repeated(keys, table, single):
    last = len(table) - 1
    for k in range(len(keys)):
        place = np.int64(keys[k] & np.uint64(last))
        while table[place] >= 0 and keys[table[place]] != keys[k]:
            place = (place + 1) & last
        if table[place] < 0:
            table[place] = k
        else:
            single[table[place]] = False
            single[k] = False


def outer_facets(mesh, exchanger, of_bodies=False):
    """Facets of this rank's cells that no other cell of any rank has. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    exchanger : pcontact.runtime.parallel.Exchanger
    of_bodies : bool
        Those that no other cell of the same body has: with them facets that two bodies share, for either of them.

    Returns
    -------
    list of Facets

    Notes
    -----
    A facet is known by the sum of its vertices' mixed numbers: no sorting, and 64 bits are enough for billions of
    facets. What is single on this rank is asked for at the rank that its key falls to; that is the surface of the part,
    not its volume.
    """
    keys, owners = [np.zeros(0, dtype=np.uint64)], []
    for number, block in enumerate(mesh.blocks):
        for kind, rows in facet_kinds(block.cell):
            table = facet_nodes(kind, 1)[rows]
            with np.errstate(over="ignore"):
                marks = mixed(mesh.file_nodes)[block.nodes[:, table]].sum(axis=2)
            if of_bodies:
                marks ^= mixed(np.array([block.body]))
            keys.append(marks.ravel())
            owners.append((number, kind, rows, len(marks)))
    keys = np.concatenate(keys)
    outer = once(keys)
    chosen = np.flatnonzero(outer)
    outer[chosen] = nowhere_else(exchanger, keys[chosen])
    result, first = [], 0
    for number, kind, rows, n_cells in owners:
        part = outer[first : first + n_cells * len(rows)].reshape(n_cells, len(rows))
        first += part.size
        cells, local = np.nonzero(part)
        if len(cells):
            result.append(Facets(number, kind, cells, rows[local]))
    return result


def nowhere_else(exchanger, keys):
    """Tell which of some keys (n,) no other rank has. *Collective.*"""
    home = (keys % np.uint64(exchanger.comm.size)).astype(np.int64)
    single = exchanger.ask(home, keys.view(np.int64)[:, None], lambda rows: once(rows[:, 0])[:, None].astype(np.int64))
    return single[:, 0] > 0


def without(mesh, bodies, regions):
    """The mesh without some bodies. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
        It is left as it is.
    bodies : set of int
        Those that are absent.
    regions : list of str
        Of all bodies, for the names of components.

    Returns
    -------
    pcontact.mesh.mesh.Mesh
        With the same nodes and other cells, groups and connected components.
    """
    gone = {number for number, block in enumerate(mesh.blocks) if block.body in bodies}
    blocks = [
        replace(block, nodes=block.nodes[:0], ids=block.ids[:0], components=block.components[:0])
        if number in gone else replace(block) for number, block in enumerate(mesh.blocks)
    ]  # fmt: skip
    facet_groups = {name: [one for one in parts if one.block not in gone] for name, parts in mesh.facet_groups.items()}
    lost = {name: _corners(mesh, [one for one in parts if one.block in gone])
            for name, parts in mesh.facet_groups.items()}  # fmt: skip
    for name, corners in _of_all_ranks(mesh.comm, lost).items():
        found = [one for rows in corners.values() for one in _other_side(mesh, blocks, rows)]
        if found:
            facet_groups[name] = [*facet_groups.get(name, []), *found]
    cell_groups = {
        name: [rows[:0] if number in gone else rows for number, rows in enumerate(parts)]
        for name, parts in mesh.cell_groups.items()
    }
    present = replace(mesh, blocks=blocks, facet_groups=facet_groups, cell_groups=cell_groups)
    present.n_components, present.component_names = _connected(present, regions)
    return present


def _corners(mesh, facets):
    """Numbers (n, k) of the vertices of facets, sorted in each row, by how many there are."""
    found = {}
    for one in facets:
        block = mesh.blocks[one.block]
        rows = block.nodes[one.cells[:, None], facet_nodes(one.cell, 1)[one.local]]
        found.setdefault(rows.shape[1], []).append(np.sort(mesh.file_nodes[rows], axis=1))
    return {count: np.concatenate(parts) for count, parts in found.items()}


def _of_all_ranks(comm, lost):
    """The same, of all ranks together."""
    result = {}
    for one in comm.allgather({name: corners for name, corners in lost.items() if corners}):
        for name, corners in one.items():
            for count, rows in corners.items():
                result.setdefault(name, {}).setdefault(count, []).append(rows)
    return {name: {count: np.unique(np.concatenate(parts), axis=0) for count, parts in sorted(result[name].items())}
            for name in sorted(result)}  # fmt: skip


def _other_side(mesh, blocks, corners):
    """Those of the facets with some vertices (n, k) that a cell of this rank has, a list of Facets."""
    local = rows_of(mesh.file_nodes, corners)
    local = local[(local >= 0).all(axis=1)]
    if not len(local):
        return []
    tables = [Block(block.cell, mesh.degree, block.nodes) for block in blocks]
    cells, numbers, _ = find_facets(tables, len(mesh.points), local)
    cells, numbers = cells[cells >= 0], numbers[cells >= 0]
    first = np.cumsum([0, *(len(block.nodes) for block in blocks)])
    owner = np.searchsorted(first, cells, side="right") - 1
    found = []
    for number in np.unique(owner):
        own = owner == number
        found += Facets.of(int(number), blocks[number], cells[own] - first[number], numbers[own])
    return found


def _connected(mesh, regions):
    """Number the connected components of a mesh whose cells have changed; how many there are, and their names.
    *Collective.*"""
    tables, cells = [block.nodes[:, : CELLS[block.cell].n_vertices] for block in mesh.blocks], mesh.of_cells("ids")
    number = connected(mesh.comm, tables, mesh.file_nodes, mesh.n_nodes_total, cells)
    for block, rows in numbered(mesh.blocks):
        block.components = number[rows]
    names, bodies = {}, zip(number.tolist(), mesh.of_cells("body").tolist(), strict=True)
    for k, body in sorted(set().union(*mesh.comm.allgather(set(bodies)))):
        names.setdefault(k, []).append(regions[body])
    return len(names), [" + ".join(some) for some in names.values()]


def connected(comm, tables, numbers, n_total, cells=None):
    """Connected component of every cell of this rank (n,), numbered in the order of their first cells. *Collective.*

    tables (n_cells, n_vertices) by nodes of this rank, whose numbers (n_nodes,) are below n_total; cells (n,): their
    numbers, absent: rank by rank.
    """
    own = label(tables, len(numbers))
    counts = comm.allgather(int(own.max(initial=-1)) + 1)
    own += sum(counts[: comm.rank])
    least, n = np.full(sum(counts), np.iinfo(np.int64).max), sum(counts)
    np.minimum.at(least, own, own if cells is None else cells)
    least = np.array(comm.allgather(least)).min(axis=0)
    pairs = _joints(comm, tables, numbers, n_total, own)
    # the component with the cell of the lowest number is the first
    order = np.argsort(least)
    whole = label([order[:, None].repeat(2, axis=1), pairs], n)[:n]
    number = np.empty(n, dtype=np.int64)
    number[order] = whole
    return number[own]


def _joints(comm, tables, numbers, n_total, own):
    """Pairs (n, 2) of connected parts of ranks that have a node in common, on all ranks. *Collective.*"""
    none = np.zeros((0, 2), dtype=np.int64)
    if comm.size == 1:
        return none
    part, end = np.full(len(numbers), -1, dtype=np.int64), 0
    for table in tables:
        part[table], end = own[end : end + len(table), None], end + len(table)
    nodes = np.flatnonzero(part >= 0)
    own = part[nodes]
    theirs = told(owners(comm, numbers[nodes], n_total), own)
    pairs = np.unique(np.column_stack([own, theirs])[own != theirs], axis=0)
    return np.unique(np.concatenate(comm.allgather(pairs)), axis=0)


def missing(mesh, names):
    """Those of some groups of which nothing is left in a mesh without some bodies. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    names : iterable of str
        The same on all ranks.

    Returns
    -------
    set of str
    """
    used, names = np.zeros(len(mesh.points), dtype=bool), sorted(names)
    for block in mesh.blocks:
        used[block.nodes] = True
    own = np.array([
        sum(len(one.cells) for one in mesh.facet_groups.get(name, []))
        + sum(len(rows) for rows in mesh.cell_groups.get(name, []))
        + int(used[mesh.node_groups.get(name, np.zeros(0, dtype=np.int64))].sum()) for name in names
    ], dtype=np.int64)  # fmt: skip
    total = mesh.comm.allreduce(own)
    return {name for name, count in zip(names, total, strict=True) if not count}


def cut(raw, name):
    """Double the nodes of a group of facets inside a body, in place. The group is its lower side from then on.

    Parameters
    ----------
    raw : pcontact.mesh.raw.RawMesh
    name : str
        Group of facets in a plane. The other side, to which the normal of :func:`plane` points, gets the name
        :data:`OTHER`.

    Raises
    ------
    InputError
        Facets are on the boundary, or not in a plane.
    """
    cells, local = raw.facet_groups[name]
    nodes = [rows.ravel() for _, rows in facet_vertices(raw, cells, local, raw.blocks[0].degree)]
    nodes = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *nodes]))
    centre, normal, off = plane(raw.points[nodes])
    if off > PLANE:
        raise InputError(f"{raw.path}: section {name!r}: found nodes that are not in a plane; allowed: a plane section")
    count = len(raw.points)
    twin = np.arange(count)
    twin[nodes] = count + np.arange(len(nodes))
    sides, upper = {False: [], True: []}, []
    for block, cells_of in numbered(raw.blocks):
        touching = np.flatnonzero(np.isin(block.nodes, nodes).any(axis=1))
        above = (raw.points[block.vertices[touching]].mean(axis=1) - centre) @ normal > 0.0
        for side, (kind, numbers) in itertools.product(sides, facet_kinds(block.cell)):
            own, table = touching[above == side], facet_nodes(kind, block.degree)[numbers]
            inside = np.isin(block.nodes[own][:, table], nodes).all(axis=2)
            row, facet = np.nonzero(inside)
            sides[side].append((cells_of.start + own[row], numbers[facet]))
        upper.append(touching[above])
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


def plane(points):
    """Centre (d,), unit normal (d,) of the plane (in the plane: line) through points (n, d), and how far points are off
    it in parts of their extent. The largest component of the normal is positive."""
    centre = points.mean(axis=0)
    _, sizes, ways = np.linalg.svd(points - centre, full_matrices=False)
    normal = ways[-1]
    normal = normal * np.sign(normal[np.argmax(np.round(np.abs(normal), 6))])
    extent = max(float(np.ptp(points - centre, axis=0).max()), 1e-300)
    return centre, normal, float(np.abs((points - centre) @ normal).max()) / extent
