"""From a mesh file, or slices of a mesh wherever they are, to one :class:`Mesh` per rank.
"""

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.mesh.hdf5 import ConvertedMesh, is_converted
from pcontact.mesh.mesh import CellBlock, Facets, Mesh, as_met, z_order
from pcontact.mesh.partition import WEIGHT, partition
from pcontact.mesh.parts import KEPT, PartMesh
from pcontact.mesh.plex import is_petsc_file
from pcontact.mesh.raw import facet_multiplicity, raised, say_lost
from pcontact.mesh.read import read_mesh
from pcontact.mesh.slices import bits, fetch, has_bit, means, nodes_of, places, to_owners, whole
from pcontact.mesh.topology import cell_name, components
from pcontact.runtime import profile
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import written_aside
from pcontact.runtime.parallel import Exchanger, agree, on_root, rows_of, together
from pcontact.runtime.petsc import MPI, PETSc, has_package


def _kinds(piece):
    """(cell name, body) of every block to make, and the widths of their node tables. *Collective.*"""
    n_bodies = piece.comm.allreduce(int(piece.body.max(initial=-1)) + 1, op=MPI.MAX)
    there = np.zeros((len(piece.blocks), n_bodies), dtype=bool)
    for k, (block, first) in enumerate(zip(piece.blocks, piece.starts[:-1], strict=True)):
        there[k, piece.body[first : first + len(block.nodes)]] = True
    piece.comm.Allreduce(MPI.IN_PLACE, there, op=MPI.LOR)
    kinds = {}
    for k, body in zip(*np.nonzero(there), strict=True):
        kinds.setdefault((piece.blocks[k].cell, int(body)), piece.blocks[k].nodes.shape[1])
    return kinds


def _own_cells(exchanger, piece, ranks):
    """Rows (number, component, groups, values, nodes) of the cells of this rank, a table per kind, and the number of
    columns of groups and of values. *Collective.*

    The slice loses its cells.
    """
    kinds, starts = _kinds(piece), piece.starts
    groups = bits(piece.cell_groups, len(piece.ids))
    n_bits = groups.shape[1]
    if piece.cell_values is not None:
        groups = np.column_stack([groups, piece.cell_values])
    tables = {key: [] for key in kinds}
    for block, first in zip(piece.blocks, starts[:-1], strict=True):
        cells = slice(first, first + len(block.nodes))
        for key, width in kinds.items():
            if key[0] != block.cell:
                continue
            chosen = np.flatnonzero(piece.body[cells] == key[1])

            def table(part, block=block, chosen=chosen, first=first):
                at, rows = chosen[part] + first, block.nodes[chosen[part]]
                return np.column_stack([piece.ids[at], piece.component[at], groups[at], rows])

            width += 2 + groups.shape[1]
            tables[key].append(to_owners(exchanger, ranks[cells][chosen], table, width))
        block.nodes = block.nodes[:0]
    result = {}
    for key in list(tables):
        parts = tables.pop(key)
        # two types of a file can be one here: complete cells, and those that have been filled
        table = parts[0] if len(parts) == 1 else np.concatenate(parts)
        del parts
        if np.any(np.diff(table[:, 0]) < 0):
            table = table[np.argsort(table[:, 0])]
        result[key] = table
    return result, n_bits, groups.shape[1] - n_bits


def _own_facets(exchanger, piece, ranks):
    """Rows (cell number, local facet number, group) of the facets of this rank's cells, by group. *Collective.*"""
    none = np.zeros(0, dtype=np.int64)
    parts = [(none, none, none)]
    for k, (rows, local) in enumerate(piece.facet_groups.values()):
        parts.append((rows, local, np.full(len(rows), k)))
    rows, local, group = (np.concatenate(column) for column in zip(*parts, strict=True))
    table = to_owners(
        exchanger, ranks[rows], lambda part: np.column_stack([piece.ids[rows[part]], local[part], group[part]]), 3
    )
    return table[np.lexsort(table.T)]


def _own_nodes(piece, tables):
    """Nodes of this rank's cells: places, coordinates, numbers, columns of groups and of values. *Collective.*"""
    nodes = nodes_of(tables, piece.n_nodes_total)
    points = fetch(piece.comm, piece.point_starts, piece.points, nodes)
    if not piece.node_groups and piece.node_ids is None and piece.node_values is None:
        return nodes, points, nodes, np.zeros((len(nodes), 0), dtype=np.int64), None
    first = piece.point_starts[piece.comm.rank]
    ids = piece.node_ids if piece.node_ids is not None else first + np.arange(len(piece.points))
    groups = bits(piece.node_groups, len(piece.points))
    columns = [ids, groups] if piece.node_values is None else [ids, groups, piece.node_values]
    known = fetch(piece.comm, piece.point_starts, np.column_stack(columns), nodes)
    end = 1 + groups.shape[1]
    values = None if piece.node_values is None else known[:, end:]
    return nodes, points, np.ascontiguousarray(known[:, 0]), known[:, 1:end], values


def _own_edges(piece, ids):
    """Edges of groups whose vertices are both among some nodes (n,), by numbers, each once. *Collective.*"""
    result = {}
    for name, edges in piece.edge_groups.items():
        every = np.unique(np.sort(np.concatenate(piece.comm.allgather(edges)), axis=1), axis=0)
        result[name] = every[(rows_of(ids, every) >= 0).all(axis=1)]
    return result


def _blocks(cells, n_more, tables, points):
    """Blocks of cells along a Z curve, and the columns of their groups and values. Cells and tables are used up."""
    blocks, groups = [], []
    for cell, body in list(cells):
        rows, nodes = cells.pop((cell, body)), tables.pop(0)
        if len(nodes):
            centre = np.empty((len(nodes), points.shape[1]))
            means(points, np.ascontiguousarray(nodes[:, : CELLS[cell].n_vertices]), centre)
            order = z_order(centre)
        else:
            order = np.zeros(0, dtype=np.int64)
        rest = rows[:, : 2 + n_more].copy()
        del rows
        nodes = np.ascontiguousarray(nodes[order])
        rest = rest[order]
        blocks.append(CellBlock(cell, body, nodes, rest[:, 0].copy(), rest[:, 1].copy()))
        groups.append(rest[:, 2:])
    return blocks, groups


def _locate(blocks, ids):
    """Block and row of global cell ids that are on this rank."""
    every = np.concatenate([b.ids for b in blocks])
    number = np.concatenate([np.full(len(b.ids), k) for k, b in enumerate(blocks)])
    row = np.concatenate([np.arange(len(b.ids)) for b in blocks])
    at = rows_of(every, ids)
    return number[at], row[at]


def _name_groups(mesh, piece, cell_bits, facets, node_bits, file_order):
    """Fill the groups of the mesh; facets in the order of cells, nodes in that of their numbers."""
    for k, name in enumerate(piece.cell_groups):
        mesh.cell_groups[name] = [np.flatnonzero(has_bit(columns, k)) for columns in cell_bits]
    ends = np.searchsorted(facets[:, 2], np.arange(len(piece.facet_groups) + 1))
    number, row = _locate(mesh.blocks, facets[:, 0])
    for k, name in enumerate(piece.facet_groups):
        mine = slice(ends[k], ends[k + 1])
        block, cells, local = number[mine], row[mine], facets[mine, 1]
        mesh.facet_groups[name] = [
            part for b, one in enumerate(mesh.blocks)
            for part in Facets.of(b, one, cells[block == b], local[block == b])
        ]  # fmt: skip
    for k, name in enumerate(piece.node_groups):
        mesh.node_groups[name] = file_order[has_bit(node_bits, k)[file_order]]


def deal(piece, pairs=(), weight=WEIGHT, method="bisection"):
    """Partition a mesh and give every rank its cells. *Collective.*

    Parameters
    ----------
    piece : pcontact.mesh.slices.MeshSlice
        Loses its cells.
    pairs, weight, method
        See :func:`pcontact.mesh.partition.partition`.

    Returns
    -------
    Mesh
    """
    exchanger = Exchanger(piece.comm)
    ranks = partition(piece, pairs, weight, method)
    facets = _own_facets(exchanger, piece, ranks)
    cells, n_bits, n_values = _own_cells(exchanger, piece, ranks)
    head = {
        "comm": piece.comm, "dim": piece.dim, "degree": piece.degree, "curved": piece.curved,
        "n_nodes_total": piece.n_nodes_total, "n_cells_total": piece.n_cells_total,
        "n_components": piece.n_components,
    }  # fmt: skip
    tables = [rows[:, 2 + n_bits + n_values :] for rows in cells.values()]
    nodes, points, ids, node_bits, values = _own_nodes(piece, tables)
    exchanger.free()
    piece.points = piece.points[:0]
    tables = list(places(nodes, tables, piece.n_nodes_total))
    blocks, columns = _blocks(cells, n_bits + n_values, tables, points)
    order, _ = as_met([block.nodes for block in blocks], len(nodes))
    mesh = Mesh(points=np.ascontiguousarray(points[order]), file_nodes=ids[order], blocks=blocks, **head)
    _name_groups(mesh, piece, columns, facets, node_bits[order], np.argsort(ids[order], kind="stable"))
    mesh.edge_groups = _own_edges(piece, mesh.file_nodes)
    if n_values:
        mesh.cell_values = np.concatenate([rows[:, n_bits:] for rows in columns])
    if values is not None:
        mesh.node_values = values[order]
    return mesh


def _refuse(piece, rows, message):
    """Raise an InputError about the first of the rows of all ranks and their number, if there are any."""
    total = piece.comm.allreduce(len(rows))
    if total:
        agree(piece.comm, message(int(rows[0]), total) if len(rows) else None)


def _set_bodies(piece, regions, named):
    """Give the cells their bodies, numbers of cell groups; a cell in no body or in two is an error. *Collective.*"""
    body = np.full(len(piece.ids), -1, dtype=np.int64)
    for number, region in enumerate(regions):
        cells = piece.cell_groups[region]
        _refuse(piece, cells[body[cells] >= 0], lambda row, n, region=region: (
            f"{piece.path}: {named(row)} of body {region!r} is also in body {regions[body[row]]!r} ({n} in all); "
            "allowed: every cell in one body"
        ))  # fmt: skip
        body[cells] = number

    def homeless(row, n):
        names = [name for name, cells in piece.cell_groups.items() if np.isin(row, cells)]
        where = f"of group {names[0]!r}" if names else "of no group"
        return (f"{piece.path}: {named(row)} {where} is in no body ({n} in all); "
                "allowed: every cell in the region of one of the [[bodies]]")  # fmt: skip

    _refuse(piece, np.flatnonzero(body < 0), homeless)
    piece.body = body


def _check_surfaces(piece, between, named):
    """Refuse contact surfaces with facets between two cells: bool (n,) of those of each surface. *Collective.*"""
    for name, inside in between.items():
        _refuse(piece, piece.facet_groups[name][0][inside], lambda row, n, name=name: (
            f"{piece.path}: contact surface {name!r} has {n} facets between two cells, the first one at {named(row)}; "
            "allowed: facets on the boundary of a body (bodies in contact must not share nodes)"
        ))  # fmt: skip


def _component_names(piece, regions):
    """Body, or bodies, of every connected component. *Collective.*"""
    there = np.zeros((piece.n_components, len(regions)), dtype=bool)
    there[piece.component, piece.body] = True
    piece.comm.Allreduce(MPI.IN_PLACE, there, op=MPI.LOR)
    return [" + ".join(regions[b] for b in np.flatnonzero(row)) for row in there]


def _read_whole(comm, path, order, serendipity, surfaces, check):
    """All of a mesh on rank 0: slices, facets between two cells by surface, and a cell in words. *Collective.*"""

    def prepare():
        raw = read_mesh(path)
        check(raw)
        say_lost(raw.path, raw.lost)
        between = {name: facet_multiplicity(raw, *raw.facet_groups[name]) > 1 for name in surfaces}
        raw, curved = raised(raw, order(raw) if callable(order) else order, serendipity)
        return raw, curved, components(raw), between

    raw, curved, component, between = on_root(comm, prepare) or (None, False, None, dict.fromkeys(surfaces, []))
    between = {name: np.asarray(inside, dtype=bool) for name, inside in between.items()}
    piece = whole(comm, raw, curved, component)
    return piece, between, lambda cell: cell_name(raw.points, raw.blocks, raw.tags, cell)


def _read_slices(stored, surfaces, check, pairs):
    """The same of a mesh of which every rank has a slice, or a part. *Collective.*"""
    together(stored.comm, check, stored.summary(pairs))
    say_lost(stored.path, stored.lost)
    return stored.piece, {name: stored.between[name] for name in surfaces}, stored.named


def load_plain(comm, raw):
    """Distribute a mesh that rank 0 has read as one body, without regard to a scene. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    raw : pcontact.mesh.raw.RawMesh or None
        On rank 0.

    Returns
    -------
    Mesh
    """

    def prepare():
        full, curved = raised(raw, 1)
        return full, curved, components(full)

    return deal(whole(comm, *(on_root(comm, prepare) or (None,) * 3)))


def write_plex(target, raw, order=1):
    """Write a mesh that has been read as PETSc's HDF5 viewer writes a DMPlex, and return it. Serial.

    Parameters
    ----------
    target : pathlib.Path
    raw : pcontact.mesh.raw.RawMesh
    order : int
        As of :func:`pcontact.mesh.hdf5.convert`.

    Raises
    ------
    InputError
        The mesh has degree 2, or this PETSc has no HDF5.
    OutputError
    """
    if order == 2 or any(block.degree == 2 for block in raw.blocks):
        raise InputError(f"{raw.path}: found cells of degree 2; allowed: degree 1 in a file of PETSc")
    if not has_package("hdf5"):
        raise InputError("command line: -petsc: found a PETSc without HDF5; allowed: one that was built with it")
    mesh = load_plain(MPI.COMM_SELF, raw)
    with written_aside(target, "-o") as part:
        viewer = PETSc.ViewerHDF5().create(str(part), "w", comm=MPI.COMM_SELF)
        mesh.dm.view(viewer)
        viewer.destroy()
    return raw


def load_mesh(comm, path, order, regions, pairs, check, dealing=(WEIGHT, "bisection"), serendipity=False):
    """Read, check and distribute a mesh. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    path : str or pathlib.Path
    order : int, None or callable
        Degree of the displacement; None: that of the mesh; or what says so of a :class:`pcontact.mesh.raw.RawMesh`.
    regions : list of str
        Cell group of each body.
    pairs : list of (str, str or None, float or None)
        Contact pairs: source and target surfaces and search radius, see
        :func:`pcontact.mesh.partition.contact_facets`.
    check : callable
        Called before anything else is done with the mesh; may raise InputError, and cut a mesh that is whole. Its
        argument is a :class:`pcontact.mesh.raw.RawMesh`, on rank 0; or a
        :class:`pcontact.mesh.hdf5.Summary`, on every rank.
    dealing : (float, str)
        Weight and method, see :func:`pcontact.mesh.partition.partition`.
    serendipity : bool
        Quadrilaterals and hexahedra of degree 2 have no nodes in the middles of faces and cells.

    Returns
    -------
    Mesh

    Raises
    ------
    InputError
        On every rank.
    """
    weight, method = dealing
    if not 0.0 <= weight < np.inf:
        raise InputError(f"command line: -partition_weight: found {weight:g}; allowed: a number >= 0")
    surfaces = sorted({name for source, target, _ in pairs for name in (source, target) if name is not None})
    with profile.phase("read"):
        spread = path in KEPT or (comm.size > 1 and is_petsc_file(path))
        if spread or is_converted(path):
            degree = None if callable(order) else order
            stored = (PartMesh if spread else ConvertedMesh)(comm, path, degree, serendipity)
            piece, between, named = _read_slices(stored, surfaces, check, pairs)
        else:
            piece, between, named = _read_whole(comm, path, order, serendipity, surfaces, check)
        _set_bodies(piece, regions, named)
        _check_surfaces(piece, between, named)
        names = _component_names(piece, regions)
        del named
    profile.give_back()
    profile.mark("read")
    with profile.phase("distribute"):
        mesh = deal(piece, pairs, weight, method)
    profile.give_back()
    profile.mark("distribute")
    mesh.component_names = names
    return mesh
