"""Reading of a mesh file, serially, into a checked `RawMesh`.

Files of gmsh, MED and Exodus are read by the program itself, old ones of gmsh with its help; all others by meshio.
Groups keep their names; a group that has only a number is called "point_5", "curve_7", "surface_12" or
"volume_3", after the dimension of its elements. A name may stand for groups of several dimensions.
"""

from pathlib import Path

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.mesh.complete import complete, fill, number_rows, sorted_rows, with_gaps
from pcontact.mesh.components import cell_name, components, orient
from pcontact.mesh.exodus import read_exodus
from pcontact.mesh.gmsh_reader import read_gmsh, read_unv
from pcontact.mesh.groups import (
    KINDS,
    Block,
    RawMesh,
    cell_groups,
    facet_multiplicity,
    lower_groups,
)
from pcontact.mesh.med import read_med
from pcontact.mesh.meshio_reader import from_meshio, read_meshio
from pcontact.mesh.plex_reader import read_petsc_file
from pcontact.runtime import log
from pcontact.runtime.errors import InputError

__all__ = ["Block", "RawMesh", "complete", "components", "facet_multiplicity", "from_meshio", "read_mesh"]


# formats that are not left to meshio
READERS = {".msh": read_gmsh, ".unv": read_unv, ".med": read_med, ".h5": read_petsc_file,
           **dict.fromkeys((".e", ".exo", ".ex2"), read_exodus)}  # fmt: skip


def read_mesh(path):
    """Read a mesh and check it.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    RawMesh

    Raises
    ------
    InputError
        The file is missing, unreadable or of unknown type; it holds no cells, cells of an unsupported type,
        cells that are degenerate, inverted or repeated, coordinates that are not finite; or it is two-dimensional
        and not in a plane z = const.
    """
    path = Path(path)
    return _build(read_file(path), path)


def read_file(path):
    """What a mesh file holds: a :class:`FileMesh`, from a file of any format.

    Raises
    ------
    InputError
        The file is missing, unreadable or of unknown type.
    """
    try:
        if path.exists() and not path.is_file():
            # a device or a pipe may have no end
            raise InputError(f"{path}: found no regular file; allowed: a mesh file that can be read")
        with open(path, "rb"):
            pass
    except OSError as error:
        raise InputError(f"{path}: found {error.strerror.lower()}; allowed: a mesh file that can be read") from None
    read = READERS.get(path.suffix.lower())
    return from_meshio(read_meshio(path), path) if read is None else read(path)


def _build(file, path):
    """Blocks, groups and checks, in the order in which a message helps most."""
    dim = _dimension(file, path)
    _check_points(file, path)
    blocks, tags, start = _blocks(file, dim)
    groups = cell_groups(file, start, dim)
    _check_repeated_nodes(file, path, blocks, tags)
    if file.repeats:
        blocks, tags, groups = _drop_repeats(blocks, tags, groups)
    _check_duplicates(path, blocks, tags, len(file.points))
    used = np.zeros(len(file.points), dtype=bool)
    for block in blocks:
        used[block.nodes[block.nodes >= 0]] = True
    _leave_out(file, path, used, dim)
    new_number = np.where(used, np.cumsum(used) - 1, -1)
    for block in blocks:
        block.nodes = np.where(block.nodes >= 0, new_number[block.nodes], -1)
    points = file.points[used] if dim == 3 else _plane(path, file.points[used])
    quadratic = [block for block in blocks if block.degree == 2]
    if any(np.any(block.nodes < 0) for block in quadratic):
        points = fill(points, quadratic)[0]
    orient(path, points, blocks, tags)
    raw = RawMesh(path, dim, np.ascontiguousarray(points), blocks, groups, tags=tags)
    lower_groups(file, raw, new_number)
    _empty_groups(file, raw)
    return raw


def _empty_groups(file, raw):
    """Groups that have a name and nothing else, so that a scene that uses them hears what they are."""
    for dim, name in file.declared:
        if name in raw.lost:
            continue
        none = np.zeros(0, dtype=np.int64)
        if dim == raw.dim:
            raw.cell_groups.setdefault(name, none)
        elif dim == raw.dim - 1:
            raw.facet_groups.setdefault(name, (none, none))
        elif dim < raw.dim:
            raw.node_groups.setdefault(name, none)


def _dimension(file, path):
    """The highest dimension of the elements, of which all must be supported."""
    counts = {}
    for table in file.tables:
        counts[table.dim, table.kind] = counts.get((table.dim, table.kind), 0) + len(table.tags)
    dim = max((d for (d, _), n in counts.items() if n), default=0)
    if dim < 2:
        held = ", ".join(f"{n} of type {kind}" for (_, kind), n in counts.items()) or "nothing"
        raise InputError(
            f"{path}: the elements of the file are {held}; allowed: cells of dimension 2 or 3 "
            "(gmsh saves only what is in a physical group)"
        )
    grouped = {(d, file.tables[k].kind) for (d, _), parts in file.groups.items() for k, _ in parts}
    for (d, kind), n in sorted(counts.items(), reverse=True):
        if n and kind not in KINDS and (d == dim or (d == dim - 1 and (d, kind) in grouped)):
            allowed = ", ".join(k for k, (cell, _) in KINDS.items() if CELLS[cell].dim == d)
            raise InputError(f'{path}: {n} elements of the unsupported type "{kind}"; allowed: {allowed}')
    return dim


def _check_points(file, path):
    bad = np.flatnonzero(~np.isfinite(file.points).all(axis=1))
    if len(bad):
        raise InputError(
            f"{path}: {_node(file, bad[0])} has a coordinate that is not a finite number "
            f"({len(bad)} in all); allowed: finite coordinates"
        )


def _blocks(file, dim):
    """Cells of all tables of a kind in one block; their file numbers; first cell of every table."""
    kinds = []
    for table in file.tables:
        if table.dim == dim and table.kind not in kinds and len(table.tags):
            kinds.append(table.kind)
    blocks, tags, start, count = [], [], {}, 0
    for kind in kinds:
        cell, degree = KINDS[kind]
        members = [
            (k, table) for k, table in enumerate(file.tables) if (table.kind, table.dim) == (kind, dim)
        ]
        for k, table in members:
            start[k] = count
            count += len(table.tags)
            tags.append(table.tags)
        nodes = np.concatenate([table.nodes for _, table in members])
        blocks.append(Block(cell, degree, with_gaps(cell, nodes) if degree == 2 else nodes))
    return blocks, np.concatenate(tags), start


def _check_repeated_nodes(file, path, blocks, tags):
    first = 0
    for block in blocks:
        nodes = sorted_rows(block.nodes)
        same = (nodes[:, 1:] == nodes[:, :-1]) & (nodes[:, 1:] >= 0)
        rows = np.flatnonzero(same.any(axis=1))
        if len(rows):
            node = file.tags[nodes[rows[0], 1:][same[rows[0]]][0]]
            raise InputError(
                f"{path}: {cell_name(file.points, blocks, tags, first + rows[0])} is degenerate: it has node {node} "
                f"more than once ({len(rows)} in all); allowed: different nodes"
            )
        first += len(block.nodes)


def _same_vertices(blocks, n_points):
    """For every cell the first cell that has the same vertices, (n_cells,)."""
    first = np.arange(sum(len(block.nodes) for block in blocks))
    offsets = np.cumsum([0] + [len(block.nodes) for block in blocks])
    for cell in dict.fromkeys(block.cell for block in blocks):
        mine = [(b, o) for b, o in zip(blocks, offsets[:-1], strict=True) if b.cell == cell]
        ids = np.concatenate([np.arange(o, o + len(b.nodes)) for b, o in mine])
        earliest, number = number_rows(np.concatenate([b.vertices for b, _ in mine]), n_points)
        first[ids] = ids[earliest[number]]
    return first


def _drop_repeats(blocks, tags, groups):
    """Keep one of the cells that a file lists once for each of several groups."""
    offsets = np.cumsum([0] + [len(block.nodes) for block in blocks])
    first = _same_vertices(blocks, 1 + max(int(block.nodes.max()) for block in blocks))
    keep = first == np.arange(len(first))
    if keep.all() or any(len(np.unique(first[cells])) < len(cells) for cells in groups.values()):
        return blocks, tags, groups  # no cell is repeated, or without reason: left to be refused
    grouped = np.zeros(len(first), dtype=bool)
    for cells in groups.values():
        grouped[cells] = True
    keep |= ~grouped
    number = np.cumsum(keep) - 1
    pieces = np.split(keep, offsets[1:-1])
    kept = [Block(b.cell, b.degree, b.nodes[piece]) for b, piece in zip(blocks, pieces, strict=True)]
    groups = {name: np.sort(number[first[cells]]) for name, cells in groups.items()}
    return kept, tags[keep], groups


def _check_duplicates(path, blocks, tags, n_points):
    first = _same_vertices(blocks, n_points)
    rows = np.flatnonzero(first != np.arange(len(first)))
    if len(rows):
        raise InputError(
            f"{path}: cell {tags[rows[0]]} has the same nodes as cell {tags[first[rows[0]]]} "
            f"({len(rows)} in all); allowed: each cell once"
        )


def _leave_out(file, path, used, dim):
    """Nodes that belong to no cell (not `used`, (n,) bool) are left out, and so are the groups that they are in."""
    members = [(name, nodes) for name, nodes in file.point_groups.items()]
    for (group_dim, name), parts in file.groups.items():
        if group_dim < dim:
            members += [(name, file.tables[table].nodes[rows].ravel()) for table, rows in parts]
    for name, nodes in members:
        lost = nodes[~used[nodes]]
        if len(lost):
            file.lost[name] = (
                f"{_node(file, lost[0])} belongs to no cell of dimension {dim} ({len(np.unique(lost))} in all); "
                "allowed: groups of nodes of cells"
            )
            file.free[lost] = True  # said with the group
    for name in file.lost:
        file.point_groups.pop(name, None)
        for group_dim in range(dim):
            file.groups.pop((group_dim, name), None)
    lost = np.flatnonzero(~used & ~file.free)
    if len(lost):
        what = "belongs to no cell" if len(lost) == 1 else f"and {len(lost) - 1} more belong to no cell"
        log.warning("%s: %s %s of dimension %d: left out", path, _node(file, lost[0]), what, dim)


def _node(file, node):
    return f"node {file.tags[node]} at ({', '.join(f'{x:g}' for x in file.points[node])})"


def _plane(path, points):
    """First two coordinates of points that lie in a plane z = const."""
    span = np.ptp(points, axis=0)
    if span[2] > 1e-9 * max(span[0], span[1]):
        raise InputError(
            f"{path}: the cells are two-dimensional and z goes from {points[:, 2].min():g} to "
            f"{points[:, 2].max():g}; allowed: a plane z = const "
            "(a three-dimensional mesh needs its volumes in a physical group)"
        )
    return np.ascontiguousarray(points[:, :2])
