"""The same bodies described another way: nodes, cells and vertices numbered anew, mirrored, turned and moved."""

import itertools
from dataclasses import replace

import numpy as np

from pcontact.element.reference import CELLS, facet_nodes, reference_nodes, shape
from pcontact.mesh.read import read_mesh

# gmsh's element types, and where its node order has VTK's nodes
TYPES = {
    ("segment", 1): 1, ("triangle", 1): 2, ("quadrilateral", 1): 3, ("tetrahedron", 1): 4, ("hexahedron", 1): 5,
    ("segment", 2): 8, ("triangle", 2): 9, ("quadrilateral", 2): 10, ("tetrahedron", 2): 11, ("hexahedron", 2): 12,
}  # fmt: skip
_EDGES = [8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15]
VTK_PLACES = {11: [0, 1, 2, 3, 4, 5, 6, 7, 9, 8], 12: [*range(8), *_EDGES, 22, 23, 21, 24, 20, 25, 26]}
POINT = 15


def turn(d, angle=0.7319, axis=(0.3, -0.5, 0.8)):
    """Rotation matrix (d, d) by an angle, in space about an axis."""
    c, s = np.cos(angle), np.sin(angle)
    if d == 2:
        return np.array([[c, -s], [s, c]])
    a = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])
    return np.eye(3) + s * cross + (1.0 - c) * cross @ cross


def mirror(d, axis=0):
    """Reflection matrix (d, d)."""
    matrix = np.eye(d)
    matrix[axis, axis] = -1.0
    return matrix


def orders(cell, degree, mirrored=False):
    """Orders (n, n_nodes) of the nodes of a cell that keep its orientation, or all that reverse it."""
    vertices = reference_nodes(cell, 1)
    n, d = vertices.shape
    if CELLS[cell].is_tensor:
        turns = itertools.product(itertools.permutations(range(d)), itertools.product((1.0, -1.0), repeat=d))
        images = [vertices[:, list(axes)] * signs for axes, signs in turns]
    else:
        images = [vertices[list(p)] for p in itertools.permutations(range(n))]
    nodes, found = reference_nodes(cell, degree), []
    inner = shape(cell, 1, nodes)
    for image in images:
        along = [1, 3, 4][:d] if CELLS[cell].is_tensor else list(range(1, n))
        if (np.linalg.det(image[along] - image[0]) < 0.0) == mirrored:
            found.append(np.argmin(np.linalg.norm((inner @ image)[:, None] - nodes, axis=2), axis=1))
    return np.array(found)


def image(source, path, seed=None, matrix=None, shift=None, change=None):
    """Write another description of a mesh.

    Parameters
    ----------
    source, path : mesh file, and the .msh file to write
    seed : int, optional
        Of the numbering; without it the numbers stay.
    matrix : (d, d), optional
        What points are multiplied by; cells are put right where it mirrors.
    shift : (d,), optional
        What is added then [length].
    change : callable, optional
        Of the points (n, d), before all that.

    Returns
    -------
    ndarray (n,)
        Number in the image of each node of the source.
    """
    raw = read_mesh(source)
    random = np.random.default_rng(seed)
    matrix = np.eye(raw.dim) if matrix is None else np.asarray(matrix)
    points = (raw.points if change is None else change(raw.points)) @ matrix.T
    points = points if shift is None else points + np.asarray(shift)
    node = np.arange(len(points)) if seed is None else random.permutation(len(points))
    tables, names, rows = [], {}, []
    for block in raw.blocks:
        table, mirrored = block.nodes, np.linalg.det(matrix) < 0.0
        allowed = orders(block.cell, block.degree, mirrored)
        if seed is not None:
            chosen = allowed[random.integers(len(allowed), size=len(table))]
            table = np.take_along_axis(table, chosen, axis=1)
        elif mirrored:
            table = table[:, allowed[0]]
        tables.append(table)

    def add(dim, name, cell, degree, nodes):
        tag = names.setdefault((dim, name), len(names) + 1)
        kind = TYPES[cell, degree] if cell else POINT
        gmsh_nodes = np.empty_like(nodes)
        gmsh_nodes[:, VTK_PLACES.get(kind, range(nodes.shape[1]))] = nodes
        rows.extend((kind, tag, *(node[n] + 1 for n in line)) for line in gmsh_nodes)

    for name, cells in raw.cell_groups.items():
        for block, table, first in zip(raw.blocks, tables, raw.offsets[:-1], strict=True):
            own = cells[(cells >= first) & (cells < first + len(table))] - first
            own = own if seed is None else random.permutation(own)
            add(raw.dim, name, block.cell, block.degree, table[own])
    for name, (cells, local) in raw.facet_groups.items():
        for block, first in zip(raw.blocks, raw.offsets[:-1], strict=True):
            own = np.flatnonzero((cells >= first) & (cells < first + len(block.nodes)))
            own = own if seed is None else random.permutation(own)
            table = facet_nodes(block.cell, block.degree)[local[own]]
            nodes = np.take_along_axis(block.nodes[cells[own] - first], table, axis=1)
            add(raw.dim - 1, name, CELLS[block.cell].facet, block.degree, nodes)
    for name, members in raw.node_groups.items():
        add(0, name, None, None, members[:, None])
    _write(path, points, node, names, rows)
    return node


def _write(path, points, node, names, rows):
    """A file of gmsh's format 2.2; every group is an entity of its own."""
    x = np.zeros((len(points), 3))
    x[node, : points.shape[1]] = points
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names))]
    lines += [f'{dim} {tag} "{name}"' for (dim, name), tag in names.items()]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(x))]
    lines += [f"{k + 1} {p[0]:.17g} {p[1]:.17g} {p[2]:.17g}" for k, p in enumerate(x)]
    lines += ["$EndNodes", "$Elements", str(len(rows))]
    lines += [f"{k + 1} {r[0]} 2 {r[1]} {r[1]} {' '.join(map(str, r[2:]))}" for k, r in enumerate(rows)]
    path.write_text("\n".join([*lines, "$EndElements", ""]))


def scene_image(scene, path, matrix=None, shift=None):
    """The scene on the image of its mesh; "free" components only where the axes stay axes."""
    d = len(scene.displacements[0].value)
    matrix, shift = np.eye(d) if matrix is None else np.asarray(matrix), np.zeros(d) if shift is None else shift

    def vector(value):
        if value is None or "free" not in value:
            return None if value is None else (matrix @ np.asarray(value, dtype=float)).tolist()
        place = np.argmax(np.abs(matrix), axis=1)
        return [v if v == "free" else float(matrix[i, place[i]] * v)
                for i, v in enumerate(value[place[i]] for i in range(d))]  # fmt: skip

    def moved(obstacle):
        if obstacle is None:
            return None
        said = {k: vector(getattr(obstacle, k)) for k in ("normal", "axis", "displacement")}
        for k in ("point", "center"):
            place = getattr(obstacle, k)
            said[k] = None if place is None else (matrix @ np.asarray(place) + shift).tolist()
        return replace(obstacle, **said)

    return replace(
        scene,
        mesh=replace(scene.mesh, file=path),
        contacts=[replace(c, obstacle=moved(c.obstacle)) for c in scene.contacts],
        displacements=[replace(s, value=vector(s.value)) for s in scene.displacements],
        loads=[replace(s, traction=vector(s.traction), body_force=vector(s.body_force)) for s in scene.loads],
        path=None,
    )
