"""A field that a file gives at the nodes of the mesh, at any place of a cell."""

import numpy as np

from pcontact.element.reference import CELLS, reference_nodes, shape, shape_gradient
from pcontact.mesh.formats import read_meshio
from pcontact.runtime.errors import coordinates, input_error, listed, shown, unknown_name
from pcontact.runtime.parallel import agree, on_root

# [extent of the file's nodes] So near to a node of the file a node of the mesh is the same. From: the digits of single
# precision.
SAME = 1e-6
# [reference coordinates], [-] Steps of Newton's method end below this; most of them.
SETTLED, MOST = 1e-12, 50


def read_field(path, name, where):
    """Places (n, 3) and values (n,) of a field at the nodes of a file, serially.

    Parameters
    ----------
    path : pathlib.Path
    name : str
    where : (str, str)
        Scene and key path, for messages.

    Raises
    ------
    InputError
        The file cannot be read, or has no such field of finite numbers.
    """
    mesh = read_meshio(path)
    if name not in mesh.point_data:
        found = unknown_name(name, "no such field at nodes", mesh.point_data)
        allowed = listed(mesh.point_data) or "a file with fields at nodes"
        raise input_error(where[0], f"{where[1]}.field", found, allowed)
    values = np.asarray(mesh.point_data[name])
    if values.size != len(mesh.points) or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        what = f"values of shape {values.shape}" if values.size != len(mesh.points) else shown(values.dtype.name)
        found = f"{name!r} in {path}, {what}, or not finite"
        raise input_error(where[0], f"{where[1]}.field", found, "one finite number at each node")
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    return points, values.ravel().astype(float)


def matched(points, others, within):
    """Row of the other points (m, d) that is at each point (n, d) to a length, -1 where none is.

    Both are sorted into boxes of four times the length, which are shifted by half a box in no, some, all directions:
    in one of these grids two places that are the same are in the same box.
    """
    n, d = points.shape
    rows, both = np.full(n, -1, dtype=np.int64), np.concatenate([points, others])
    for shift in np.ndindex(*[2] * d):
        boxes = np.floor(both / (4.0 * within) + 0.5 * np.array(shift)).astype(np.int64)
        _, number = np.unique(boxes, axis=0, return_inverse=True)
        number = number.ravel()
        at = np.full(number.max(initial=-1) + 1, -1, dtype=np.int64)
        at[number[n:]] = np.arange(len(others))
        found = at[number[:n]]
        near = (found >= 0) & (np.abs(points - others[found]).max(axis=1) <= within)
        rows[near] = found[near]
    return rows


class NodalField:
    """A field at the nodes of the cells' geometry.

    Parameters
    ----------
    space : pcontact.space.space.Space
    which : list of ndarray of bool
        Cells that need it, of each block.
    path : pathlib.Path
    name : str
        Of the field in the file.
    where : (str, str)
        Scene and key path, for messages.

    Raises
    ------
    InputError
        On every rank: see :func:`read_field`; or a vertex of these cells is no node of the file.

    Notes
    -----
    The constructor is *Collective*. Curved cells whose middle nodes are in the file, too, take all of them; all others
    the vertices alone.
    """

    def __init__(self, space, which, path, name, where):
        mesh, comm = space.mesh, space.comm
        places, values = comm.bcast(on_root(comm, read_field, path, name, where))
        places = places[:, : space.dim]
        within = SAME * max(float(np.ptp(places, axis=0).max(initial=0.0)), 1e-300)
        rows, self._mesh = matched(mesh.points, places, within), mesh
        needed, vertices = np.zeros((2, len(mesh.points)), dtype=bool)
        for block, own in zip(mesh.blocks, which, strict=True):
            needed[mesh.geometry_nodes(block)[0][own]] = True
            vertices[block.nodes[own][:, : CELLS[block.cell].n_vertices]] = True
        lost = np.flatnonzero(vertices & (rows < 0))
        message = None
        if len(lost):
            found = f"{path}, which has no node at {coordinates(mesh.points[lost[0]])}, one of {len(lost)}"
            message = f"{where[0]}: {where[1]}.file: found {found}; allowed: the nodes of the mesh"
        agree(comm, message)
        self._whole = not comm.allreduce(int(np.sum(needed & (rows < 0))))
        self._values = np.where(rows >= 0, values[rows], 0.0)

    def at(self, number, rows, points):
        """Values (n, m) at points (n, m, d) of cells (n,) of a block."""
        mesh, block = self._mesh, self._mesh.blocks[number]
        table, degree = mesh.geometry_nodes(block)
        xi = reference_places(block.cell, degree, mesh.points[table[rows]], points)
        if not self._whole:
            table, degree = table[:, : CELLS[block.cell].n_vertices], 1
        weights = shape(block.cell, degree, xi.reshape(-1, xi.shape[2]))
        weights = weights.reshape(*xi.shape[:2], weights.shape[1])
        return np.einsum("nma,na->nm", weights, self._values[table[rows]])


def reference_places(cell, degree, nodes, points):
    """Reference coordinates (n, m, d) of points (n, m, d) in cells of nodes (n, a, d), by Newton's method."""
    (n, m, d), origin = points.shape, nodes[:, :1]
    nodes, target = nodes - origin, points - origin
    xi = np.tile(reference_nodes(cell, 1).mean(axis=0), (n, m, 1))
    for _ in range(MOST):
        flat = xi.reshape(-1, d)
        values = shape(cell, degree, flat).reshape(n, m, -1)
        slopes = shape_gradient(cell, degree, flat).reshape(n, m, -1, d)
        rest = target - np.einsum("nma,nad->nmd", values, nodes)
        step = np.linalg.solve(np.einsum("nmae,nad->nmde", slopes, nodes), rest[..., None])[..., 0]
        xi = xi + step
        if np.max(np.abs(step), initial=0.0) < SETTLED:
            break
    return xi

