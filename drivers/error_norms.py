"""Distance to a known solution: energy and L2 norm in the bodies, weighted and plain L2 norm on surfaces."""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import CHUNK
from pcontact.element.dilatation import components, factors, linear
from pcontact.element.geometry import gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import shape, shape_gradient
from pcontact.material.elastic import HALF
from pcontact.runtime.petsc import MPI


class BulkError(NamedTuple):
    """Norms over all bodies.

    Attributes
    ----------
    energy, energy_of_exact : float
        sqrt(int sigma(e) : eps(e)) of the error e, and of the exact solution itself [sqrt(energy)].
    displacement, displacement_of_exact : float
        L2 norms [length^(1 + d/2)].
    """

    energy: float
    energy_of_exact: float
    displacement: float
    displacement_of_exact: float


class SurfaceError(NamedTuple):
    """Norms over a surface of what is given at its quadrature points.

    Attributes
    ----------
    weighted : float
        sqrt(int h |v|^2), the norm of Nitsche's method on the contact surface.
    plain : float
        sqrt(int |v|^2).
    largest : float
        Largest absolute value.
    """

    weighted: float
    plain: float
    largest: float


def _energy_density(gradient, lam, mu, mean=None):
    """2 x elastic energy density (n,) [stress] of displacement gradients (n, d, d).

    Plane strain in 2D, plane stress with its own lam, axial symmetry with the hoop strain as the third diagonal entry.
    With weights (nc, nq) of the points, points (nc, nq, d) or None, and the degree of the displacement, in `mean`, the
    mean dilatation of a cell stands for the dilatation at its points; the linear one where there are points.
    """
    strain = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    trace = np.trace(strain, axis1=1, axis2=2)
    density = lam * trace**2 + 2.0 * mu * np.einsum("nij,nij->n", strain, strain)
    if mean is not None:
        weight, points, degree = mean
        own = trace.reshape(weight.shape)
        basis, volume, _, _ = components(weight, points)
        middle = np.einsum("cqb,cb->cq", basis, np.einsum("cq,cqb,cq->cb", weight, basis, own) / volume[:, None])
        density += factors(lam, mu, True, degree)[1] * (middle**2 - own**2).ravel()
    return density


class Displacements(NamedTuple):
    """Displacements at points.

    Attributes
    ----------
    u : ndarray (n, d)
        [length]
    slope : ndarray (n, d, d)
        Gradients, entry [i, j] the derivative of component i in direction j.
    """

    u: np.ndarray
    slope: np.ndarray

    def with_hoop(self, radius):
        """With gradients (n, 3, 3) that have the hoop strain, at radii (n,)."""
        full = np.zeros((len(self.u), 3, 3))
        full[:, :2, :2], full[:, 2, 2] = self.slope, self.u[:, 0] / radius
        return Displacements(self.u, full)


def _deviation(gradient, points, law):
    """What an orthotropic law adds to the density (n,) at points (n, d), see :func:`_energy_density`."""
    strain, d = np.zeros((len(gradient), law.size)), gradient.shape[1]
    for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))[: law.size]):
        if j < d:
            strain[:, k] = gradient[:, i, i] if i == j else HALF * (gradient[:, i, j] + gradient[:, j, i])
    return np.einsum("nk,nkl,nl->n", strain, np.broadcast_to(law.deviation(points), (len(strain),) + 2 * (law.size,)),
                     strain)  # fmt: skip


def energy_density(gradient, points, constants, law=None):
    """2 x elastic energy density (n,) [stress]: sigma : eps, at points (n, d) of a body.

    Parameters
    ----------
    gradient : ndarray (n, d, d)
        Of the displacement; with the hoop strain under axial symmetry, see :meth:`Displacements.with_hoop`.
    points : ndarray (n, d)
    constants : (float, float)
        Lame constants [stress].
    law : pcontact.material.orthotropic.Orthotropic, optional
        What is to be added to their stiffness.
    """
    density = _energy_density(gradient, *constants)
    return density if law is None else density + _deviation(gradient, points, law)


def _squares(points, jxw, found, exact, constants, axisymmetric, kind, law=None):
    """The four squares summed over the points (n, d) of a chunk of cells, with weights (nc, nq)."""
    averaged, on_linear, degree = kind
    if axisymmetric:
        radius = points[:, 0]
        found, exact = found.with_hoop(radius), exact.with_hoop(radius)
        jxw = 2.0 * np.pi * jxw * radius.reshape(jxw.shape)
    mean = (jxw, points.reshape(*jxw.shape, points.shape[1]) if on_linear else None, degree) if averaged else None
    energies = [
        _energy_density(found.slope - exact.slope, *constants, mean),
        _energy_density(exact.slope, *constants),
    ]
    if law is not None:
        energies[0] += _deviation(found.slope - exact.slope, points, law)
        energies[1] += _deviation(exact.slope, points, law)
    integrands = (
        *energies,
        np.sum((found.u - exact.u) ** 2, axis=1),
        np.sum(exact.u**2, axis=1),
    )
    return np.array([jxw.ravel() @ integrand for integrand in integrands])


def bulk_error(space, constants, u, exact, degree=None, averaged=False, orthotropic=None):
    """Error of a displacement in the bodies. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    constants : list of (float, float)
        Lame constants of each body of the scene [stress].
    u : PETSc.Vec
    exact : callable
        ``exact(x, body)`` with points x (n, d) and the number of the body gives the displacement (n, d) and
        its gradient (n, d, d), entry [i, j] the derivative of component i in direction j.
    degree : int, optional
        Of the quadrature; absent: twice the degree of the displacement, plus 4, so that the error of the
        quadrature is of higher order than what it measures.
    averaged : bool
        Cells that take their mean dilatation are measured by it, too: in the norm of their own energy.
    orthotropic : dict of int to pcontact.material.orthotropic.Orthotropic, optional
        By body, what is to be added to the stiffness of its constants.

    Returns
    -------
    BulkError
    """
    mesh, nodal = space.mesh, space.local.gather(u)
    sums, d = np.zeros(4), space.dim
    for number, block in enumerate(mesh.blocks):
        table, geometry_degree = mesh.geometry_nodes(block)
        xi, weights = quadrature(block.cell, degree or 2 * space.degree + 4)
        dgeo = np.ascontiguousarray(shape_gradient(block.cell, geometry_degree, xi))
        dshape = np.ascontiguousarray(shape_gradient(block.cell, space.degree, xi))
        at, values = shape(block.cell, geometry_degree, xi), shape(block.cell, space.degree, xi)
        kind = averaged and space.averages(block), linear(block.cell, space.degree_of(block)), space.degree_of(block)
        for first in range(0, len(block.nodes), CHUNK):
            rows = slice(first, first + CHUNK)
            x = np.ascontiguousarray(mesh.points[table[rows]])
            grad, jxw = np.empty((len(x), *dshape.shape)), np.empty((len(x), len(weights)))
            gradients(x, dgeo, dshape, weights, grad, jxw)
            points, u = np.einsum("qa,cad->cqd", at, x).reshape(jxw.size, d), nodal[space.cells[number][rows]]
            found = Displacements(
                np.einsum("qa,cad->cqd", values, u).reshape(jxw.size, d),
                np.einsum("cai,cqaj->cqij", u, grad).reshape(jxw.size, d, d),
            )
            known = Displacements(*exact(points, block.body))
            sums += _squares(points, jxw, found, known, constants[block.body], space.axisymmetric, kind,
                             (orthotropic or {}).get(block.body))  # fmt: skip
    return BulkError(*np.sqrt(space.comm.allreduce(sums, op=MPI.SUM)).tolist())


def surface_error(comm, difference, weight, size):
    """Norms of values at the quadrature points of a surface. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm
    difference : ndarray (n,)
        On this rank, such as a contact pressure minus the exact one.
    weight : ndarray (n,)
        Quadrature weight times area element.
    size : ndarray (n,)
        Diameter h of the facet of each point [length].

    Returns
    -------
    SurfaceError
    """
    square = difference**2
    sums = comm.allreduce(np.array([weight @ (size * square), weight @ square]), op=MPI.SUM)
    largest = comm.allreduce(float(np.max(np.abs(difference), initial=0.0)), op=MPI.MAX)
    return SurfaceError(float(np.sqrt(sums[0])), float(np.sqrt(sums[1])), largest)
