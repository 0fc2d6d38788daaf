"""Meshes as they are read: two boxes on each other, their volume, normals and cells."""

import gmsh
import numpy as np

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_kinds, facet_nodes, reference_nodes, shape, shape_gradient

CELL_TYPES = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]


def entities(dim, low, high):
    e = 1e-6
    low, high = np.array(low) - e, np.array(high) + e
    return [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*low, *high, dim)]


def stack(cell):
    """Two unit boxes on top of each other, which share the nodes of the face between them; with groups."""
    model, dim, tensor = gmsh.model.geo, CELLS[cell].dim, CELLS[cell].is_tensor
    gmsh.model.add("stack")
    base = (0, model.addPoint(0, 0, 0))
    for step in np.eye(3)[:dim]:
        # an extrusion returns its far end, then what it swept; triangles that are swept are wedges
        whole = tensor or (cell == "wedge" and step[2] > 0)
        end, base, *_ = model.extrude([base], *step, numElements=[2], recombine=whole)
    model.extrude([end], *step, numElements=[2], recombine=whole)
    model.synchronize()
    up, top = np.eye(3)[dim - 1], 1.0 * (np.arange(3) < dim - 1)
    add = gmsh.model.addPhysicalGroup
    lower, upper = entities(dim, [0, 0, 0], top + up), entities(dim, up, top + 2 * up)
    add(dim, lower, 7, "lower")
    add(dim, upper, 8)
    add(dim - 1, entities(dim - 1, [0, 0, 0], top), 11, "bottom")
    add(dim - 1, entities(dim - 1, up, top + up), 12, "interface")
    add(dim - 1, entities(dim - 1, 2 * up, top + 2 * up), 13)
    add(0, entities(0, [0, 0, 0], [0, 0, 0]), 14, "corner")
    if dim == 3:
        add(1, entities(1, [0, 0, 2], [1, 0, 2]), 15, "rim")
    gmsh.model.mesh.generate(dim)


def determinants(raw):
    """Determinants at quadrature points times weights, block by block."""
    for block in raw.blocks:
        xi, weights = quadrature(block.cell, 4)
        jacobian = np.einsum(
            "cai,qaj->cqij", raw.points[block.nodes], shape_gradient(block.cell, block.degree, xi)
        )
        yield np.linalg.det(jacobian) * weights


def volume(raw):
    return sum(d.sum() for d in determinants(raw))


def check_straight(raw):
    """Nodes of straight cells lie where the reference cell says."""
    for block in raw.blocks:
        where = shape(block.cell, 1, reference_nodes(block.cell, block.degree))
        expected = np.einsum("na,cai->cni", where, raw.points[block.vertices])
        np.testing.assert_allclose(raw.points[block.nodes], expected, atol=1e-12)


def corners(raw, name):
    cells, local = raw.facet_groups[name]
    (block,) = raw.blocks
    kind = next(kind for kind, rows in facet_kinds(block.cell) if np.isin(local, rows).all())
    return raw.points[block.nodes[cells[:, None], facet_nodes(kind, 1)[local]]]


def normals(raw, name):
    x = corners(raw, name)
    if raw.dim == 2:
        t = x[:, 1] - x[:, 0]
        return np.stack([t[:, 1], -t[:, 0]], axis=1)
    return np.cross(x[:, 1] - x[:, 0], x[:, -1] - x[:, 0]) / (2 if x.shape[1] == 3 else 1)


def check_line(error, path):
    """One line that names the file and says what is allowed."""
    assert str(error).startswith(f"{path}: ") and "; allowed: " in str(error) and "\n" not in str(error)
