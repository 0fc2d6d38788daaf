"""The mesh without some bodies, as it is in a phase of the run in which they are absent.

Cells of absent bodies are not there; blocks keep their numbers, and those of absent bodies are empty. Facets of groups
that belong to an absent cell belong to the cell on their other side, where that is there.
"""

from dataclasses import replace

import numpy as np

from pcontact.element.reference import CELLS, facet_nodes
from pcontact.mesh.components import label
from pcontact.mesh.groups import Block, find_facets
from pcontact.mesh.mesh import Facets
from pcontact.mesh.plex import owners, told


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
    order = np.argsort(mesh.file_nodes)
    at = np.minimum(np.searchsorted(mesh.file_nodes[order], corners), max(len(order) - 1, 0))
    if not len(order):
        return []
    local = order[at]
    local = local[(mesh.file_nodes[local] == corners).all(axis=1)]
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
    comm, tables = mesh.comm, [block.nodes[:, : CELLS[block.cell].n_vertices] for block in mesh.blocks]
    own = label(tables, len(mesh.points))
    count = int(own.max(initial=-1)) + 1
    counts = comm.allgather(count)
    own += sum(counts[: comm.rank])
    cells = np.concatenate([np.zeros(0, dtype=np.int64), *(block.ids for block in mesh.blocks)])
    bodies = np.concatenate([np.zeros(0, np.int64), *(np.full(len(one.ids), one.body) for one in mesh.blocks)])
    least, n = np.full(sum(counts), np.iinfo(np.int64).max), sum(counts)
    np.minimum.at(least, own, cells)
    least = np.array(comm.allgather(least)).min(axis=0)
    pairs = _joints(mesh, tables, own)
    # the component with the cell of the lowest number is the first
    order = np.argsort(least)
    whole = label([order[:, None].repeat(2, axis=1), pairs], n)[:n]
    number = np.empty(n, dtype=np.int64)
    number[order] = whole
    start, names = 0, [set() for _ in range(int(number.max(initial=-1)) + 1)]
    for block in mesh.blocks:
        block.components = number[own[start : start + len(block.ids)]]
        start += len(block.ids)
    for k, body in sorted(set().union(*comm.allgather(set(zip(number[own].tolist(), bodies.tolist(), strict=True))))):
        names[k].add(body)
    return len(names), [" + ".join(regions[body] for body in sorted(some)) for some in names]


def _joints(mesh, tables, own):
    """Pairs (n, 2) of connected parts of ranks that have a node in common, on all ranks. *Collective.*"""
    comm, none = mesh.comm, np.zeros((0, 2), dtype=np.int64)
    if comm.size == 1:
        return none
    part, first = np.full(len(mesh.points), -1, dtype=np.int64), 0
    for table in tables:
        part[table] = own[first : first + len(table), None]
        first += len(table)
    nodes = np.flatnonzero(part >= 0)
    own = part[nodes]
    theirs = told(owners(comm, mesh.file_nodes[nodes], mesh.n_nodes_total), own)
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
