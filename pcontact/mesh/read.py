"""Reading of a mesh file, serially, into a checked `RawMesh`.

Files of gmsh, MED and Exodus are read by the program itself, old ones of gmsh with its help; all others by meshio.
Groups keep their names; a group that has only a number is called "point_5", "curve_7", "surface_12" or
"volume_3", after the dimension of its elements. A name may stand for groups of several dimensions.

Surfaces without cells: facets of a mesh file, joined by their nodes and turned one way.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.mesh.formats import from_meshio, instead, read_exodus, read_med, read_meshio
from pcontact.mesh.msh import read_gmsh, read_unv
from pcontact.mesh.plex import read_petsc_file
from pcontact.mesh.raw import (
    KINDS,
    Block,
    RawMesh,
    cell_groups,
    complete,
    facet_multiplicity,
    fill,
    lower_groups,
    number_rows,
    numbered,
    sorted_rows,
    with_gaps,
)
from pcontact.mesh.topology import cell_name, components, orient
from pcontact.runtime import log
from pcontact.runtime.errors import InputError, coordinates, input_error, listed, unknown_name
from pcontact.runtime.jit import njit_exact

__all__ = ["Block", "RawMesh", "complete", "components", "facet_multiplicity", "from_meshio", "read_mesh"]


# formats that are not left to meshio
READERS = {".msh": read_gmsh, ".unv": read_unv, ".med": read_med, ".h5": read_petsc_file,
           **dict.fromkeys((".e", ".exo", ".ex2"), read_exodus)}  # fmt: skip
# [extent of the surface] Nodes that are nearer are one: files of surfaces alone may have those of each facet. From: the
# six digits of single precision, in which such files are written.
SAME = 1e-6
# rows of a facet's nodes in the other direction, by its number of corners; of degree 1 the first ones
REVERSED = {2: [1, 0, 2], 3: [0, 2, 1, 5, 4, 3], 4: [0, 3, 2, 1, 7, 6, 5, 4, 8]}
CORNERS = {"segment": 2, "triangle": 3, "quadrilateral": 4}
WIDTH = 9  # most nodes of a facet


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
    return build(read_file(path), path)


def read_file(path):
    """Read what a mesh file holds: a :class:`FileMesh`, from a file of any format.

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


def build(file, path):
    """Blocks, groups and checks of a FileMesh, in the order in which a message helps most: a RawMesh."""
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
            f"(gmsh saves only what is in a physical group){instead(path)}"
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
    for block, own in numbered(blocks):
        nodes = sorted_rows(block.nodes)
        same = (nodes[:, 1:] == nodes[:, :-1]) & (nodes[:, 1:] >= 0)
        rows = np.flatnonzero(same.any(axis=1))
        if len(rows):
            node = file.tags[nodes[rows[0], 1:][same[rows[0]]][0]]
            named = cell_name(file.points, blocks, tags, own.start + rows[0])
            raise InputError(
                f"{path}: {named} is degenerate: it has node {node} more than once ({len(rows)} in all); "
                "allowed: different nodes"
            )


def _same_vertices(blocks, n_points):
    """For every cell the first cell that has the same vertices, (n_cells,)."""
    first = np.arange(sum(len(block.nodes) for block in blocks))
    for cell in dict.fromkeys(block.cell for block in blocks):
        mine = [(block, first[own]) for block, own in numbered(blocks) if block.cell == cell]
        ids = np.concatenate([own for _, own in mine])
        earliest, number = number_rows(np.concatenate([block.vertices for block, _ in mine]), n_points)
        first[ids] = ids[earliest[number]]
    return first


def _drop_repeats(blocks, tags, groups):
    """Keep one of the cells that a file lists once for each of several groups."""
    first = _same_vertices(blocks, 1 + max(int(block.nodes.max()) for block in blocks))
    keep = first == np.arange(len(first))
    if keep.all() or any(len(np.unique(first[cells])) < len(cells) for cells in groups.values()):
        return blocks, tags, groups  # no cell is repeated, or without reason: left to be refused
    grouped = np.zeros(len(first), dtype=bool)
    for cells in groups.values():
        grouped[cells] = True
    keep |= ~grouped
    number = np.cumsum(keep) - 1
    kept = [Block(block.cell, block.degree, block.nodes[keep[own]]) for block, own in numbered(blocks)]
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
    return f"node {file.tags[node]} at {coordinates(file.points[node])}"


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


class FacetSurface(NamedTuple):
    """A surface of facets, which face one way.

    Attributes
    ----------
    points : ndarray (n, d)
        [length]
    nodes : ndarray (nf, 9)
        Of each facet in VTK's order; short rows are filled up with the first one.
    kinds : list of (str, int)
        Cell and degree of each facet.
    """

    points: np.ndarray
    nodes: np.ndarray
    kinds: list


def read_surface(path, dim, region, where):
    """Read a surface, serially.

    Parameters
    ----------
    path : str or pathlib.Path
    dim : int
        Of the space, 2 or 3.
    region : str or None
        Group of facets; None: all of them.
    where : (str, str)
        Scene and key of the obstacle, for messages.

    Returns
    -------
    FacetSurface
        Normals of closed parts look outwards; those of an open one to where that of its first facet looks in the file,
        by the right hand, in the plane to the right of the line.

    Raises
    ------
    InputError
        No such file, group, or facets; facets of which more than two meet, or which cannot face one way.
    """
    file = read_file(Path(path))
    tables = [(k, one) for k, one in enumerate(file.tables) if one.dim == dim - 1 and one.kind in KINDS]
    if region is not None:
        rows = dict(file.groups.get((dim - 1, region), []))
        if not rows:
            names = sorted(name for kind, name in file.groups if kind == dim - 1)
            found = unknown_name(region, "no such group of facets", names)
            raise input_error(where[0], f"{where[1]}.region", found, listed(names) or "a file with groups of facets")
        tables = [(k, replace(table, nodes=table.nodes[np.unique(rows[k])])) for k, table in tables if k in rows]
    if not any(len(table.nodes) for _, table in tables):
        what = "triangles and quadrilaterals" if dim == 3 else "segments"
        raise input_error(where[0], f"{where[1]}.file", f"{path}, without facets", f"a file with {what}")
    kinds, nodes = [], []
    for _, table in tables:
        kinds += [KINDS[table.kind]] * len(table.nodes)
        nodes.append(_filled(table, file))
    points, nodes = _joined(file.points[:, :dim], np.vstack(nodes))
    if not np.isfinite(points).all():
        raise input_error(where[0], f"{where[1]}.file", f"{path}, with a node that is no place", "finite numbers")
    corners = np.array([CORNERS[cell] for cell, _ in kinds])
    neighbour, agrees = _neighbours(points, nodes, corners, (path, *where))
    sign, part = np.zeros(len(nodes), dtype=np.int64), np.full(len(nodes), -1, dtype=np.int64)
    wrong = _spread(neighbour, agrees, sign, part)
    if wrong >= 0:
        found = f"{path}, whose facets at {coordinates(points[nodes[wrong, 0]])} face both ways at once"
        raise input_error(where[0], f"{where[1]}.file", found, "a surface with two sides")
    _outwards(points, nodes, corners, neighbour, sign, part)
    for count in REVERSED:
        turned = (corners == count) & (sign < 0)
        nodes[turned] = _reversed(nodes[turned], count)
    return FacetSurface(points, nodes, kinds)


def _filled(table, file):
    """Nodes (n, 9) of a table; eight-node quadrilaterals get their middles, which are added to the points."""
    nodes = table.nodes
    if table.kind == "quad8":
        weights = np.array([-0.25] * 4 + [0.5] * 4)
        middles = np.einsum("i,nid->nd", weights, file.points[nodes])
        nodes = np.column_stack([nodes, len(file.points) + np.arange(len(nodes))])
        file.points = np.vstack([file.points, middles])
    return np.column_stack([nodes, np.repeat(nodes[:, :1], WIDTH - nodes.shape[1], axis=1)])


def _joined(points, nodes):
    """Points that the facets have, those in the same place once."""
    used, nodes = np.unique(nodes, return_inverse=True)
    nodes, points = nodes.reshape(-1, WIDTH), points[used]
    cells = np.round((points - points.min(axis=0)) / (SAME * max(np.ptp(points, axis=0).max(), 1e-300)))
    _, first, number = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return points[first], number.ravel()[nodes]


def _neighbours(points, nodes, corners, where):
    """Facet beside each side (nf, 4), -1 for none, and whether both face one way there: side i of facets in space is
    the edge from corner i to the next one, in the plane it is end i."""
    n, dim = len(nodes), points.shape[1]
    facet, side, ends, way = [], [], [], []
    for count in np.unique(corners):
        rows = np.flatnonzero(corners == count)
        for i in range(count):
            a, b = nodes[rows, i], nodes[rows, (i + 1) % count]
            # in the plane facets meet at nodes, one where it begins, the other where it ends
            pair = np.sort(np.column_stack([a, b]), axis=1) if dim == 3 else np.column_stack([a, a])
            facet.append(rows)
            side.append(np.full(len(rows), i))
            ends.append(pair)
            way.append((a < b) if dim == 3 else np.full(len(rows), i == 0))
    facet, side, ends, way = (np.concatenate(one) for one in (facet, side, ends, way))
    order = np.lexsort((facet, ends[:, 1], ends[:, 0]))
    same = np.all(ends[order[1:]] == ends[order[:-1]], axis=1)
    if np.any(same[1:] & same[:-1]):
        at = order[np.flatnonzero(same[1:] & same[:-1])[0]]
        count = int(np.sum(np.all(ends == ends[at], axis=1)))
        found = f"{count} facets of {where[0]} that meet at {coordinates(points[ends[at]].mean(axis=0))}"
        raise input_error(where[1], f"{where[2]}.file", found, "a surface, of which no more than two meet")
    neighbour, agrees = np.full((n, 4), -1, dtype=np.int64), np.ones((n, 4), dtype=bool)
    first, second = order[:-1][same], order[1:][same]
    neighbour[facet[first], side[first]], neighbour[facet[second], side[second]] = facet[second], facet[first]
    agrees[facet[first], side[first]] = agrees[facet[second], side[second]] = way[first] != way[second]
    return neighbour, agrees


@njit_exact
def _spread(neighbour, agrees, sign, part):
    """Write to sign (nf,) which facets face the way of the first one of their part, and the number of the part;
    returns a facet that cannot, or -1."""
    n, stack, count = len(sign), np.empty(len(sign), dtype=np.int64), 0
    for seed in range(n):
        if part[seed] >= 0:
            continue
        sign[seed], part[seed], stack[0], depth = 1, count, seed, 1
        while depth > 0:
            depth -= 1
            facet = stack[depth]
            for i in range(neighbour.shape[1]):
                other = neighbour[facet, i]
                if other < 0:
                    continue
                wanted = sign[facet] if agrees[facet, i] else -sign[facet]
                if part[other] >= 0:
                    if sign[other] != wanted:
                        return other
                    continue
                sign[other], part[other] = wanted, count
                stack[depth] = other
                depth += 1
        count += 1
    return -1


def _outwards(points, nodes, corners, neighbour, sign, part):
    """Turn closed parts so that they look outwards, in place: by the volume, or the area, that they enclose."""
    sides = np.arange(4)[None] < corners[:, None]
    is_open = np.bincount(part, np.any(sides & (neighbour < 0), axis=1)) > 0.0
    x = points[nodes[:, :4]] - points.mean(axis=0)
    if points.shape[1] == 2:
        content = x[:, 0, 0] * x[:, 1, 1] - x[:, 0, 1] * x[:, 1, 0]
    else:
        content = np.einsum("ni,ni->n", x[:, 0], np.cross(x[:, 1], x[:, 2]))
        last = np.einsum("ni,ni->n", x[:, 0], np.cross(x[:, 2], x[:, 3]))
        content = content + np.where(corners == 4, last, 0.0)
    inside_out = ~is_open & (np.bincount(part, sign * content) < 0.0)
    sign[inside_out[part]] *= -1


def _reversed(nodes, count):
    """Nodes (n, 9) of facets with some corners in the other direction."""
    out = nodes.copy()
    order = REVERSED[count]
    out[:, : len(order)] = nodes[:, order]
    # where a row has no middle nodes, it is filled up with its first node
    short = nodes[:, count] == nodes[:, 0]
    out[short] = nodes[short][:, [*order[:count], *[order[0]] * (WIDTH - count)]]
    out[~short, len(order) :] = out[~short, :1]
    return out
