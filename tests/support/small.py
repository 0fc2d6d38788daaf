"""What several tests of the core share: small spaces, and block patterns as dense matrices."""

import numpy as np

from meshes.blocks import one_block, two_blocks
from pcontact.assembly.matrix import JoinedPattern
from pcontact.assembly.solid import Solid
from pcontact.contact.report import ContactReport
from pcontact.element.reference import shape, shape_gradient
from pcontact.material.elastic import Elastic
from pcontact.mesh.raw import complete
from pcontact.mesh.read import read_mesh
from pcontact.mesh.topology import components
from pcontact.runtime.petsc import MPI
from pcontact.space.space import Space
from tests.support.dealt import distribute

SELF = MPI.COMM_SELF
DIMENSION = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}


def block_file(path, cell, n=2, order=1):
    """A unit box."""
    return one_block(path, DIMENSION[cell], n, cell, order=order)


def blocks_file(path, cell, n_lower=2, n_upper=2, **more):
    """Two stacked boxes."""
    return two_blocks(path, DIMENSION[cell], n_lower, n_upper, cell, **more)


def bend(points, amount=0.08):
    """Points moved smoothly and slightly, so that no cell is a parallelepiped."""
    x = np.asarray(points)
    moved = x.copy()
    for axis in range(x.shape[1]):
        other = (axis + 1) % x.shape[1]
        moved[:, axis] += amount * np.sin(2.1 * x[:, other] + 0.7 * x[:, axis] + axis)
    return moved


def elastic_solid(space, constants):
    """The item of elastic bodies with these Lame constants, in plane stress those of the plane."""
    laws = [Elastic(*pair) for pair in constants]
    for law in laws:
        law.plane_stress = space.kinematics == "plane_stress"
    return Solid(space, laws)


def make_space(comm, path, regions, degree=1, change=None):
    """Space on the mesh of a file whose points were changed before the mesh was completed. Collective.

    Parameters
    ----------
    comm : MPI.Comm
    path : pathlib.Path
    regions : list of str
    degree : int
    change : callable, optional
        Of the points of the file.
    """
    arguments = (None,) * 4
    if comm.rank == 0:
        raw = read_mesh(path)
        raw.points = raw.points if change is None else np.ascontiguousarray(change(raw.points))
        curved = any(b.degree == 2 for b in raw.blocks)
        if curved or degree == 2:
            raw = complete(raw, 2)
        body = np.zeros(sum(len(b.nodes) for b in raw.blocks), dtype=np.int64)
        for number, region in enumerate(regions):
            body[raw.cell_groups[region]] = number
        arguments = (raw, curved, body, components(raw))
    mesh = distribute(comm, *arguments)
    mesh.component_names = [f"part {k}" for k in range(mesh.n_components)]
    return Space(mesh, degree)


def keys(space):
    """Node numbers of the file of the local nodes."""
    return space.mesh.file_nodes[space.mesh_nodes]


def dense(rowptr, columns, values, n_columns):
    """Block rows as a dense matrix (n_rows d, n_columns d)."""
    d = values.shape[1]
    out = np.zeros((len(rowptr) - 1, n_columns, d, d))
    out[np.repeat(np.arange(len(rowptr) - 1), np.diff(rowptr)), columns] = values
    return out.transpose(0, 2, 1, 3).reshape((len(rowptr) - 1) * d, n_columns * d)


def dense_item(item, u):
    """The tangent of an item on one rank as a dense matrix."""
    values = item.tangent(u)
    return dense(*item.pattern(), values, item.space.numbering.n_total)


def vector_of(space, array):
    """Distributed vector from an array (n_owned, d)."""
    vector = space.vector()
    vector.setArray(np.ascontiguousarray(array).ravel())
    return vector


def numpy_gradients(space, number, xi, weights):
    """Physical gradients (nc, nq, nn, d) and weights (nc, nq) of a block's cells, without compiled code."""
    mesh, block = space.mesh, space.mesh.blocks[number]
    table, geometry_degree = mesh.geometry_nodes(block)
    x = mesh.points[table]
    jacobian = np.einsum("cnd,qne->cqde", x, shape_gradient(block.cell, geometry_degree, xi))
    inverse = np.linalg.inv(jacobian)
    grad = np.einsum("qne,cqed->cqnd", shape_gradient(block.cell, space.degree, xi), inverse)
    return grad, np.linalg.det(jacobian) * weights, shape(block.cell, space.degree, xi)


def elasticity(lam, mu, d):
    """The elasticity tensor (d, d, d, d)."""
    one = np.eye(d)
    return (
        lam * np.einsum("ij,kl->ijkl", one, one)
        + mu * np.einsum("ik,jl->ijkl", one, one)
        + mu * np.einsum("il,jk->ijkl", one, one)
    )


def magnitude_of(item, u):
    """Sum of the absolute terms of an item's residual (n_owned, d)."""
    out = np.zeros((item.space.n_owned, item.space.dim))
    item.add_magnitude(u, out)
    return out


def summary_of(pair, u):
    """Numbers of a contact pair for the report."""
    return ContactReport(pair.contact, [pair]).summary(u)


class Together:
    """Several contact pairs as one item, as a contact reports them.

    Parameters
    ----------
    contact : pcontact.scene.model.Contact
    pairs : list of pcontact.contact.pair.ContactPair
    """

    def __init__(self, contact, pairs):
        self.pairs, self.report, self.space = pairs, ContactReport(contact, pairs), pairs[0].space
        self.state, self.summary = self.report.state, self.report.summary
        self.memory, self.recall = self.report.memory, self.report.recall

    def detect(self, u, time):
        for pair in self.pairs:
            pair.detect(u, time)

    def commit(self, u, time):
        for pair in self.pairs:
            pair.commit(u, time)

    def residual(self, u, out):
        for pair in self.pairs:
            pair.residual(u, out)

    def tangent(self, u):
        values = [pair.tangent(u) for pair in self.pairs]
        self._joined = JoinedPattern([pair.pattern() for pair in self.pairs], self.space.n_owned)
        return self._joined.sum(values)

    def pattern(self):
        return self._joined.rowptr, self._joined.columns

    @property
    def source(self):
        return self.report.source

    @property
    def closed(self):
        return self.report.closed
