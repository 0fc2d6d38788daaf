"""The trace constant lambda_F that scales Nitsche's parameter, gamma = gamma0 lambda_F.

lambda_F = max over v of int_F |sigma(v) n|^2 / int_E sigma(v) : eps(v)        [stress / length]

with the elastic stress of the parent cell E of facet F: what coercivity needs, whatever the shape of the cell
and the moduli (Warburton and Hesthaven 2003 for the polynomial inequality on simplices). With axial symmetry both
integrals have the weight r, the energy has the hoop strain, and nodes on the axis do not move along r; with mean
dilatation stress and energy are those of `pcontact.element.dilatation`, with reduced integration those of
`pcontact.element.quadrature`. Where points stick by alpha gamma, |sigma n|^2 is (n . sigma n)^2 + |P sigma n|^2 /
alpha, with P = I - n n: the closed form is the same with alpha >= mu / (lam + 2 mu), for (n . sigma n)^2 / (lam + 2 mu)
+ |P sigma n|^2 / mu <= sigma : eps.

Of an orthotropic body lam and mu are those of the nearest isotropic one, and C_dev is added, see
`pcontact.material.orthotropic`. |sigma n|^2 <= a sigma : eps with a the largest eigenvalue of the acoustic tensor
n . C . n, which is lam + 2 mu of an isotropic body: it stands in its place in the closed form.
"""

from functools import partial

import numpy as np

from pcontact.element.dilatation import PLAIN, dilatation, factors, hoop_operator, linear, mean_dilatation, squares
from pcontact.element.geometry import cell_geometry, facet_geometry
from pcontact.element.quadrature import DEGREE, quadrature, reduced_gradients
from pcontact.element.reference import CELLS, facet_nodes, facet_points, n_nodes, reference_nodes, shape
from pcontact.runtime.jit import njit

# A cell is straight if its degree-2 nodes are off the middles by less than this fraction of its extent.
_STRAIGHT = 1e-8
# A rigid mode is one whose energy is below this fraction of the stiffness.
_RIGID = 1e-12
# A pivot is at least this fraction of its diagonal entry.
_ROUNDING = np.finfo(float).eps
# A node is on the axis of symmetry if its radius is below this fraction of the cell's extent.
_AXIS = 1e-8
# A shear component of a tensor is this part of Mandel's.
_HALF = np.sqrt(0.5)
# Facets treated at once: their local matrices stay in the cache.
_BATCH = 256


def trace_constant(cell, x, local_facet, geometry_degree, degree, lam, mu, kind=PLAIN):
    """Trace constant of facets.

    Parameters
    ----------
    cell : str
        Parent cell, of dimension 2 (plane strain; plane stress with its own lam) or 3.
    x : ndarray, (nf, ng, d)
        Coordinates of the geometry nodes of each facet's parent cell [length].
    local_facet : ndarray, (nf,) int
        Local number of each facet in its parent cell.
    geometry_degree, degree : int
        Degree of the geometry and of the displacement.
    lam, mu : float or ndarray, (nf,)
        Lame constants [stress].
    kind : pcontact.element.dilatation.Dilatation

    Returns
    -------
    ndarray, (nf,) float64
        lambda_F [stress / length]. On straight simplices in closed form, p (p + d - 1) / d (lam + 2 mu) |F| /
        |E| with p the degree, unless there is axial symmetry; elsewhere the largest eigenvalue of the local problem,
        without its rigid modes. A mean dilatation M does not raise the closed form: with degree 2 it is that of
        polynomials of the same degree, and |sigma n|^2 <= (lam + 2 mu) (lam |M . u|^2 + 2 mu |eps|^2).

    Raises
    ------
    ValueError
        If a cell that is not a straight simplex is inverted or degenerate.
    """
    x = np.ascontiguousarray(x, dtype=np.float64)
    local_facet = np.ascontiguousarray(local_facet, dtype=np.int64)
    lam, mu = (np.broadcast_to(np.asarray(value, dtype=np.float64), len(x)) for value in (lam, mu))
    straight = _straight(cell, x, geometry_degree)
    result = np.empty(len(x))
    for members, on_degree in ((straight, 1), (~straight, geometry_degree)):
        kept = np.flatnonzero(members)
        nodes = x[kept, : n_nodes(cell, on_degree)]
        # where the stiffness varies within the cell there is no closed form
        law, uniform = kind.law, kind.law is None or kind.law.uniform
        if on_degree == 1 and CELLS[cell].is_simplex and not kind.axisymmetric and uniform:
            modulus = (lam + 2.0 * mu)[kept] if law is None else law.acoustic(_normals(cell, nodes, local_facet[kept]))
            result[kept] = _closed_form(cell, nodes, local_facet[kept], degree) * modulus
        else:
            arguments = cell, nodes, local_facet[kept], on_degree, degree, lam[kept], mu[kept], _of(kind, kept)
            result[kept] = _in_batches(*arguments)
    return result


def _straight(cell, x, geometry_degree):
    """Flags of the cells with the geometry of their vertices alone, (nf,) bool."""
    if geometry_degree == 1:
        return np.ones(len(x), dtype=bool)
    corners = x[:, : CELLS[cell].n_vertices]
    middles = np.einsum("na,cai->cni", shape(cell, 1, reference_nodes(cell, geometry_degree)), corners)
    extent = np.ptp(corners, axis=1).max(axis=1)
    return np.abs(x - middles).max(axis=(1, 2)) <= _STRAIGHT * extent


def _closed_form(cell, x, local_facet, degree):
    """C_p / h_F of straight simplices, with C_p = p (p + d - 1) / d and h_F = |E| / |F|."""
    dim = CELLS[cell].dim
    facet = np.take_along_axis(x, facet_nodes(cell, 1)[local_facet][:, :, None], axis=1)
    edges = facet[:, 1:] - facet[:, :1]
    # the Gram determinant gives the facet's measure in both dimensions: |F| = root / (d - 1)!, |E| = det / d!
    root = np.sqrt(np.linalg.det(edges @ edges.transpose(0, 2, 1)))
    det = np.abs(np.linalg.det(x[:, 1:] - x[:, :1]))
    return degree * (degree + dim - 1) * root / det


def _normals(cell, x, local_facet):
    """Outward unit normals (nf, d) of facets of straight simplices."""
    xi, weights = quadrature(CELLS[cell].facet, 1)
    return facet_geometry(cell, np.ascontiguousarray(x), local_facet, 1, 1, xi, weights).normals[:, 0]


def _of(kind, rows):
    """The kind of some of the facets."""
    return kind if kind.shear is None else kind._replace(shear=kind.shear[rows])


def _in_batches(cell, x, local_facet, geometry_degree, degree, lam, mu, kind):
    """`_largest` of a few facets at a time, (nf,)."""
    result = np.empty(len(x))
    for start in range(0, len(x), _BATCH):
        part = slice(start, start + _BATCH)
        arguments = x[part], local_facet[part], geometry_degree, degree, lam[part], mu[part], _of(kind, part)
        result[part] = _largest(cell, *arguments)
    return result


def _largest(cell, x, local_facet, geometry_degree, degree, lam, mu, kind=PLAIN):
    """Largest eigenvalue of the local problem, (nf,).

    With K the stiffness of the cell and H the weighted tractions, max |H v|^2 / v.K v = max eigenvalue of
    H K^+ H^T. As H vanishes on the rigid modes, K^+ may be replaced by the inverse of K plus any stiffness on
    them. Coordinates and moduli are scaled to one first, so that nothing depends on the units.
    """
    extent, modulus = np.ptp(x, axis=1).max(axis=1), lam + 2.0 * mu
    middle = x.mean(axis=1, keepdims=True)  # the rotations below turn about this point
    if kind.axisymmetric:
        middle[:, :, 0] = 0.0  # radii stay what they are
    x, lam, mu = (x - middle) / extent[:, None, None], lam / modulus, mu / modulus
    rest = None if kind.law is None else partial(_deviation, kind.law, middle, extent[:, None, None], modulus)
    # exact on parallelepipeds; one point more per direction where the Jacobian varies
    order = 2 * degree + 2 * (geometry_degree - 1)
    stiffness = _stiffness((cell, geometry_degree, degree, DEGREE if kind.reduced else order), x, lam, mu, kind, rest)
    tractions = _tractions((cell, geometry_degree, degree, order), x, local_facet, lam, mu, kind, rest)
    nodes = np.einsum("na,cai->cni", shape(cell, geometry_degree, reference_nodes(cell, degree)), x)
    if kind.axisymmetric:
        _hold_axis(nodes[:, :, 0] <= _AXIS, stiffness, tractions)
        nodes -= nodes.mean(axis=1, keepdims=True)
    stiffness += _without_energy(stiffness) if kind.reduced else _rigid_stiffness(nodes, stiffness)
    compliance = np.empty((len(x), tractions.shape[1], tractions.shape[1]))
    _compliance(stiffness, np.ascontiguousarray(tractions.transpose(0, 2, 1)), compliance)
    return np.linalg.eigvalsh(compliance)[:, -1] * modulus / extent


def _hold_axis(held, stiffness, tractions):
    """Take the radial displacement of nodes (nf, nn) on the axis out of both operators."""
    nf, nn = held.shape
    free = np.ones((nf, nn, 2))
    free[:, :, 0] = ~held
    free = free.reshape(nf, 2 * nn)
    diagonal = np.einsum("cii->ci", stiffness)
    kept = np.where(free > 0.0, 0.0, diagonal)
    stiffness *= free[:, :, None] * free[:, None, :]
    diagonal += kept
    tractions *= free[:, None, :]


def _deviation(law, middle, extent, modulus, points):
    """C_dev (nf, nq, m, m) over a modulus (nf,) at points (nf, nq, d) of cells that were moved and scaled."""
    moduli = law.deviation((points * extent + middle).reshape(-1, points.shape[2]))
    shape = (1, 1) if len(moduli) == 1 else points.shape[:2]
    return moduli.reshape(*shape, *moduli.shape[1:]) / modulus[:, None, None, None]


def _strains(grad, hoop):
    """Strain operator (nf, nq, m, nn d) in Mandel components, of gradients (nf, nq, nn, d) and N / r or None."""
    *shape, nn, d = grad.shape
    out = np.zeros((*shape, 6 if d == 3 else 4, nn, d))
    for i in range(d):
        out[..., i, :, i] = grad[..., i]
    for k, (i, j) in enumerate(((0, 1), (1, 2), (0, 2))[: 3 if d == 3 else 1], start=3):
        out[..., k, :, i], out[..., k, :, j] = _HALF * grad[..., j], _HALF * grad[..., i]
    if hoop is not None:
        out[..., 2, :, 0] = hoop
    return out.reshape(*shape, -1, nn * d)


def _stiffness(layout, x, lam, mu, kind, rest=None):
    """Elastic stiffness, (nf, nn d, nn d), node by node; `rest` gives what is added to that of the constants."""
    cell, geometry_degree, degree, order = layout
    axisymmetric, averaged = kind.axisymmetric, kind.averaged
    points, weights = quadrature(cell, order)
    grad, jxw, least = cell_geometry(cell, x, geometry_degree, degree, points, weights)
    if not least > 0.0:
        raise ValueError(f"trace constant: a {cell} is inverted or degenerate")
    size = grad.shape[2] * grad.shape[3]
    hoop, plain = None, not (axisymmetric or averaged)
    if axisymmetric:
        radius = x[:, :, 0] @ shape(cell, geometry_degree, points).T
        jxw, hoop = jxw * radius, hoop_operator(shape(cell, degree, points), radius)
    stiffness = _elastic(grad, jxw, lam if plain else 0.0 * lam, mu)
    if not plain:
        at = shape(cell, geometry_degree, points) @ x if averaged and linear(cell, degree) else None
        operators, factor = squares(grad, jxw, hoop, averaged, degree, lam, mu, at)
        operators = operators.reshape(len(x), -1, size)
        stiffness += operators.transpose(0, 2, 1) @ (factor[:, :, None] * operators)
    if rest is not None:
        strain = _strains(grad, hoop)
        pulled = jxw[:, :, None, None] * (rest(shape(cell, geometry_degree, points) @ x) @ strain)
        rows = strain.shape[1] * strain.shape[2]
        stiffness += strain.reshape(len(x), rows, size).transpose(0, 2, 1) @ pulled.reshape(len(x), rows, size)
    return stiffness


def _tractions(layout, x, local_facet, lam, mu, kind, rest=None):
    """Tractions of the shape functions at facet points times the root of the weight, (nf, nq d, nn d)."""
    cell, geometry_degree, degree, order = layout
    axisymmetric, averaged, reduced = kind.axisymmetric, kind.averaged, kind.reduced
    xi, weights = quadrature(CELLS[cell].facet, order)
    facets = facet_geometry(cell, x, local_facet, geometry_degree, degree, xi, weights)
    normals, grad, weight, hoop = facets.normals, facets.gradients, facets.jxw, None
    if reduced:
        grad = reduced_gradients(cell, x, geometry_degree, facet_points(cell, xi)[local_facet])
    nf, nq, nn, dim = grad.shape
    if axisymmetric:
        radius = facets.points[..., 0]
        weight, hoop = weight * radius, hoop_operator(facets.shape, radius)
    own, shared = factors(lam[:, None, None, None], mu[:, None, None, None], averaged, degree)
    volumetric = own * dilatation(grad, hoop)
    if averaged:
        middle = mean_dilatation(cell, x, geometry_degree, degree, DEGREE if reduced else order, axisymmetric)
        volumetric = volumetric + shared * middle.at(facets.points)
    root = np.sqrt(weight)[:, :, None, None]
    mu = mu[:, None, None, None]
    result = np.empty((nf, nq, dim, nn, dim))
    along = root * mu * np.einsum("fqai,fqi->fqa", grad, normals)[..., None]
    for k in range(dim):
        result[:, :, k] = root * normals[:, :, k, None, None] * volumetric
        result[:, :, k] += root * mu * grad[..., k, None] * normals[:, :, None, :]
        result[:, :, k, :, k] += along[..., 0]
    if rest is not None:
        stress = rest(facets.points) @ _strains(grad, hoop)
        result += root[..., None] * _onto(stress, normals).reshape(result.shape)
    if kind.shear is not None:
        along = normals[..., None, None] * np.einsum("fqi,fqiak->fqak", normals, result)[:, :, None]
        result = along + (result - along) / np.sqrt(kind.shear)[:, None, None, None, None]
    return result.reshape(nf, nq * dim, nn * dim)


def _onto(stress, normals):
    """Tractions (nf, nq, d, n) on normals (nf, nq, d) of stresses (nf, nq, m, n) in Mandel components."""
    dim = normals.shape[2]
    out = normals[..., None] * stress[:, :, :dim]
    for k, (i, j) in enumerate(((0, 1), (1, 2), (0, 2))[: 3 if dim == 3 else 1], start=3):
        out[:, :, i] += _HALF * normals[:, :, j, None] * stress[:, :, k]
        out[:, :, j] += _HALF * normals[:, :, i, None] * stress[:, :, k]
    return out


def _rigid_stiffness(nodes, stiffness):
    """Stiffness on the rigid modes only, (nf, nn d, nn d).

    On a curved cell with displacements of lower degree than the geometry, rotations are no rigid modes: only
    what has no energy is stiffened.
    """
    nf, nn, dim = nodes.shape
    pairs = [(i, j) for i in range(dim) for j in range(i)]
    modes = np.zeros((nf, nn, dim, dim + len(pairs)))
    for i in range(dim):
        modes[:, :, i, i] = 1.0
    for k, (i, j) in enumerate(pairs, start=dim):
        modes[:, :, i, k] = nodes[:, :, j]
        modes[:, :, j, k] = -nodes[:, :, i]
    return _without_energy(stiffness, np.linalg.qr(modes.reshape(nf, nn * dim, -1))[0])


def _without_energy(stiffness, basis=None):
    """Stiffness on all that has no energy, (nf, n, n), among the orthonormal columns of a basis (nf, n, k) if there is
    one: with reduced integration it is more than the rigid modes."""
    energy, vectors = np.linalg.eigh(stiffness if basis is None else basis.transpose(0, 2, 1) @ stiffness @ basis)
    vectors = vectors if basis is None else basis @ vectors
    scale = np.trace(stiffness, axis1=1, axis2=2)[:, None]
    added = np.where(energy < _RIGID * scale, scale / stiffness.shape[1], 0.0)
    return (vectors * added[:, None, :]) @ vectors.transpose(0, 2, 1)


def _elastic(grad, jxw, lam, mu):
    """Elastic stiffness (nf, nn d, nn d) of cells from gradients (nf, nq, nn, d)."""
    nf, nq, nn, dim = grad.shape
    rows = grad.reshape(nf, nq, nn * dim)
    # products[a, i, b, j] = int dN_a/dx_i dN_b/dx_j
    products = ((jxw[:, :, None] * rows).transpose(0, 2, 1) @ rows).reshape(nf, nn, dim, nn, dim)
    direct, swapped = (value[:, None, None, None, None] for value in (lam, mu))
    stiffness = direct * products + swapped * products.transpose(0, 1, 4, 3, 2)
    laplacian = mu[:, None, None] * np.einsum("caibi->cab", products)
    for i in range(dim):
        stiffness[:, :, i, :, i] += laplacian
    return stiffness.reshape(nf, nn * dim, nn * dim)


@njit
def _compliance(stiffness, loads, compliance):
    """B^T K^{-1} B for K (nf, n, n) symmetric positive definite and B (nf, n, m), into (nf, m, m).

    By Cholesky's K = L L^T and Y = L^{-1} B; the lower triangle of K and all of B are overwritten by L and Y. Of flat
    cells a pivot may be nothing but rounding errors, of either sign: no less is taken than they are.
    """
    for c in range(stiffness.shape[0]):
        lower, y, out = stiffness[c], loads[c], compliance[c]
        size, m = y.shape
        for i in range(size):
            for j in range(i + 1):
                rest = lower[i, j]
                for k in range(j):
                    rest -= lower[i, k] * lower[j, k]
                lower[i, j] = np.sqrt(max(rest, _ROUNDING * lower[i, i])) if i == j else rest / lower[j, j]
            for k in range(i):
                for n in range(m):
                    y[i, n] -= lower[i, k] * y[k, n]
            for n in range(m):
                y[i, n] /= lower[i, i]
        out[:] = 0.0
        for i in range(size):
            for n in range(m):
                for k in range(m):
                    out[n, k] += y[i, n] * y[i, k]
