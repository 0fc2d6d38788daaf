"""Meshes of hexahedra cut into wedges, pyramids and tetrahedra."""

import numpy as np

from pcontact.element.reference import CELLS, facet_kinds, facet_nodes
from pcontact.mesh.raw import facet_vertices
from pcontact.mesh.read import read_mesh

# gmsh's types
_TYPES = {"vertex": 15, "triangle": 2, "quadrilateral": 3, "tetrahedron": 4, "hexahedron": 5, "wedge": 6, "pyramid": 7}
_HALVES = ((0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7))


def _cut(nodes, kind, centre, split):
    """Cells (kind, nodes) that make up a hexahedron; of pyramids those with all base nodes in `split` become two
    tetrahedra."""
    if kind == "hexahedron":
        return [(kind, list(nodes))]
    if kind == "wedge":
        return [(kind, [nodes[k] for k in half]) for half in _HALVES]
    cells = []
    for facet in facet_nodes("hexahedron", 1):
        # outward facets seen from the inside are the bases
        base = [nodes[k] for k in facet[::-1]]
        if split.issuperset(base):
            cells += [("tetrahedron", [base[k] for k in three] + [centre]) for three in ((0, 1, 2), (0, 2, 3))]
        else:
            cells.append(("pyramid", [*base, centre]))
    return cells


def cut_mesh(path, target, kinds, split="none", bend=None):
    """Write a mesh of hexahedra of degree 1 again, its cells cut.

    Parameters
    ----------
    path, target : Path
    kinds : sequence of str
        Of "hexahedron", "wedge" (with their axes along z), "pyramid": column after column of cells along z.
    split : str
        Group of facets on which pyramids become tetrahedra.
    bend : callable, optional
        Of points (n, 3).

    Returns
    -------
    Path
    """
    raw = read_mesh(path)
    cells, points = raw.blocks[0].nodes, [list(point) for point in raw.points]
    middles = raw.points[cells].mean(axis=1)
    columns = {key: k for k, key in enumerate(sorted({tuple(row) for row in np.round(middles[:, :2], 6)}))}
    on_split = set()
    if split in raw.facet_groups:
        on_split = {int(n) for _, rows in facet_vertices(raw, *raw.facet_groups[split]) for n in rows.ravel()}
    parts = []
    for nodes, middle in zip(cells.tolist(), middles, strict=True):
        # gmsh's hexahedra stand anyhow: their lower sides first
        nodes = _upright(raw.points, nodes)
        kind = kinds[columns[tuple(np.round(middle[:2], 6))] % len(kinds)]
        if kind == "pyramid":
            points.append(list(middle))
        parts.append(_cut(nodes, kind, len(points) - 1, on_split))
    facets = {}
    for kind, nodes in (cell for part in parts for cell in part):
        for view, rows in facet_kinds(kind):
            for facet in facet_nodes(view, 1)[rows]:
                facets.setdefault(frozenset(nodes[k] for k in facet), (CELLS[view].facet, [nodes[k] for k in facet]))
    names, lines = [], []

    def add(dim, name, kind, nodes):
        if (dim, name) not in names:
            names.append((dim, name))
        tag = names.index((dim, name)) + 1
        lines.append(f"{len(lines) + 1} {_TYPES[kind]} 2 {tag} {tag} {' '.join(str(n + 1) for n in nodes)}")

    for name, members in raw.cell_groups.items():
        for cell in members:
            for kind, nodes in parts[cell]:
                add(3, name, kind, nodes)
    for name, (owners, local) in raw.facet_groups.items():
        for _, rows in facet_vertices(raw, owners, local):
            for row in rows.tolist():
                for key in [frozenset(row)] if frozenset(row) in facets else [k for k in facets if k < frozenset(row)]:
                    add(2, name, *facets[key])
    for name, members in raw.node_groups.items():
        for node in members:
            add(0, name, "vertex", [node])
    points = np.array(points) if bend is None else bend(np.array(points))
    text = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names))]
    text += [f'{dim} {k} "{name}"' for k, (dim, name) in enumerate(names, 1)]
    text += ["$EndPhysicalNames", "$Nodes", str(len(points))]
    text += [f"{k} {' '.join(map(repr, point))}" for k, point in enumerate(points.tolist(), 1)]
    text += ["$EndNodes", "$Elements", str(len(lines)), *lines, "$EndElements", ""]
    target.write_text("\n".join(text))
    return target


def _upright(points, nodes):
    """Nodes of a brick along the axes, those below first, counter-clockwise from the least corner."""
    x = points[nodes]
    middle = x.mean(axis=0)
    at = {tuple((row > middle).tolist()): node for row, node in zip(x, nodes, strict=True)}
    square = ((False, False), (True, False), (True, True), (False, True))
    return [at[(*corner, up)] for up in (False, True) for corner in square]
