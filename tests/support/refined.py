"""What tests of refined and divided meshes measure."""

import numpy as np

from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, shape_gradient
from pcontact.mesh.distribute import load_mesh
from pcontact.mesh.mesh import Mesh
from pcontact.mesh.raw import facet_multiplicity, facet_vertices
from pcontact.runtime.petsc import MPI

COMM = MPI.COMM_WORLD


def load(path, order, comm=COMM, regions=("lower", "upper"), serendipity=False) -> Mesh:
    return load_mesh(comm, path, order, list(regions), [], lambda mesh: None, serendipity=serendipity)


def chosen(mesh, seed, part, value):
    """A wish for a random part of the cells, by their numbers: the same on any number of ranks."""
    ids = np.concatenate([block.ids for block in mesh.blocks])
    lucky = np.random.default_rng(seed).uniform(size=mesh.n_cells_total) < part
    return np.where(lucky[ids], value, 0)


def volume(mesh):
    total = 0.0
    for block in mesh.blocks:
        nodes, degree = mesh.geometry_nodes(block)
        xi, weights = quadrature(block.cell, mesh.dim * (degree - 1) + 2)
        slopes = shape_gradient(block.cell, degree, xi)
        jacobian = np.linalg.det(np.einsum("cni,qnj->cqij", mesh.points[nodes], slopes))
        assert jacobian.min(initial=1.0) > 0.0
        total += float((jacobian @ weights).sum())
    return mesh.comm.allreduce(total)


def quality(mesh):
    """Least volume^(2 / d) over the mean square of the edges, that of the regular simplex being 1."""
    worst, d = 1.0, mesh.dim
    for block in mesh.blocks:
        x = mesh.points[block.nodes[:, : d + 1]]
        i, j = np.triu_indices(d + 1, 1)
        square = ((x[:, i] - x[:, j]) ** 2).sum(axis=2).mean(axis=1)
        volumes = np.linalg.det(x[:, 1:] - x[:, :1])
        regular = (np.sqrt(d + 1) / 2 ** (d / 2)) ** (2 / d)
        worst = min(worst, float((volumes ** (2 / d) / square).min(initial=worst * regular)) / regular)
    return mesh.comm.allreduce(worst, op=MPI.MIN)


def conforms(raw):
    """Area of the facets that one cell has alone: that of the outside if cells meet; no facet has more than two
    cells."""
    n_facets = len(CELLS[raw.blocks[0].cell].facets)
    cells = np.repeat(np.arange(raw.offsets[-1]), n_facets)
    local = np.tile(np.arange(n_facets), raw.offsets[-1])
    count = facet_multiplicity(raw, cells, local)
    assert count.max() <= 2
    return area(raw, cells[count == 1], local[count == 1])


def area(raw, cells, local):
    total = 0.0
    for _, vertices in facet_vertices(raw, cells, local):
        x = raw.points[vertices]
        sides = x[:, 1:3] - x[:, :1] if raw.dim == 3 else x[:, 1:2] - x[:, :1]
        gram = np.einsum("fij,fkj->fik", sides, sides)
        # triangles; parallelograms where facets have four vertices
        total += float(np.sqrt(np.linalg.det(gram)).sum()) * (0.5 if vertices.shape[1] == 3 else 1.0)
    return total
