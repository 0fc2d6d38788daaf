"""Stretch and rotation of bodies, cell by cell, for reports and pictures.

Compiled kernel that says how far bodies with small strain are from what small strain represents.

With the displacement gradient H at a place in a cell, small strain e = sym H and the rotation w, the axial vector of
skew H, the strain that leaves rigid motions out is

    e + 1/2 (|w|^2 I - w w) + O(e^2)

What small strain leaves out of it does the work  1/2 s : (|w|^2 I - w w)  with the stress s, and beyond  s : O(e^2),
which is |e| / 2 times the work  s : e  or less.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import chunks, hoop, points_of
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import shape, shape_gradient
from pcontact.material.elastic import indices
from pcontact.material.hardening import RADIUS
from pcontact.material.log_strain import compose, eigenpairs, twice_green
from pcontact.runtime.jit import njit
from pcontact.runtime.petsc import MPI

# sums of `add_distortion`, one after the other
VOLUME, WORK, STRAIN, TURN, TURN_WORK, STIFFENING = range(6)
SUMS = 6
ROOT = np.sqrt(2.0)


class Places(NamedTuple):
    """Cells of a block with what takes nodes to one place in each of them.

    Attributes
    ----------
    places : ndarray (n, d)
        Of the nodes of the geometry [length].
    table : ndarray (nc, ng)
        Nodes of the geometry.
    cells : ndarray (nc, nn)
        Nodes of the displacement.
    geo, dgeo : ndarray (ng,), (ng, d)
        Shape functions of the geometry there, and their reference gradients.
    shape, dshape : ndarray (nn,), (nn, d)
        The same of the displacement.
    weight : float
        Volume of the reference cell that the place stands for.
    ring : bool
        Whether x is the radius of an axisymmetric body.
    """

    places: np.ndarray
    table: np.ndarray
    cells: np.ndarray
    geo: np.ndarray
    dgeo: np.ndarray
    shape: np.ndarray
    dshape: np.ndarray
    weight: float
    ring: bool


class Stiffness(NamedTuple):
    """Stiffness of cells, by which a strain stands for work.

    Attributes
    ----------
    lam, mu : float
        Lame constants [stress].
    limit : float
        Size of the strain beyond which stresses do not grow; infinite where nothing yields.
    rest : ndarray (k, 6, 6)
        What an orthotropic stiffness differs by, in Mandel components [stress]: of all cells (k = 1), or of each of
        them; k = 0 of an isotropic one.
    """

    lam: float
    mu: float
    limit: float
    rest: np.ndarray


@njit
def add_distortion(centres, nodal, stiffness, held, sums, largest):
    """Add what the cells of a block say of small strain to ``sums``.

    Parameters
    ----------
    centres : Places
    nodal : ndarray (n, d)
        Displacement [length].
    stiffness : Stiffness
    held : ndarray (nc,) of bool
        Whether a support holds the body of a cell: what stiffens others lets them go elsewhere.
    sums : ndarray (6,)
        Integrals of 1, of the work density W = s : e, of W |e|, |w|^2, W |w|^2, and of
        1/2 s : (|w|^2 I - w w) where held.
    largest : ndarray (2,)
        Overwritten: largest of the errors |e| / 2 and |w|^2 / 2 of a cell, and its number; -1, -1 without cells.
    """
    places, table, cells, dgeo, dshape = centres.places, centres.table, centres.cells, centres.dgeo, centres.dshape
    lam, mu, limit = stiffness.lam, stiffness.mu, stiffness.limit
    d, rest = nodal.shape[1], stiffness.rest
    strain, stress = np.zeros(6), np.zeros(6)
    jacobian, inverse, reference, h = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    largest[:] = -1.0
    for c in range(cells.shape[0]):
        jacobian[:, :] = 0.0
        reference[:, :] = 0.0
        h[:, :] = 0.0
        jacobian[2, 2] = 1.0 if d == 2 else 0.0
        radius, across = 0.0, 0.0
        for a in range(table.shape[1]):
            node = table[c, a]
            radius += centres.geo[a] * places[node, 0]
            for i in range(d):
                for j in range(d):
                    jacobian[i, j] += places[node, i] * dgeo[a, j]
        for a in range(cells.shape[1]):
            node = cells[c, a]
            across += centres.shape[a] * nodal[node, 0]
            for i in range(d):
                for j in range(d):
                    reference[i, j] += nodal[node, i] * dshape[a, j]
        for i in range(3):
            k, m = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                p, q = (j + 1) % 3, (j + 2) % 3
                inverse[j, i] = jacobian[k, p] * jacobian[m, q] - jacobian[k, q] * jacobian[m, p]
        det = jacobian[0, 0] * inverse[0, 0] + jacobian[0, 1] * inverse[1, 0] + jacobian[0, 2] * inverse[2, 0]
        scale = 1.0 / det
        for i in range(d):
            for j in range(d):
                for k in range(d):
                    h[i, j] += reference[i, k] * inverse[k, j] * scale
        volume = centres.weight * det
        if centres.ring:
            h[2, 2] = across / radius
            volume *= 2.0 * np.pi * radius
        yz, xz, xy = 0.5 * (h[1, 2] + h[2, 1]), 0.5 * (h[0, 2] + h[2, 0]), 0.5 * (h[0, 1] + h[1, 0])
        wx, wy, wz = 0.5 * (h[2, 1] - h[1, 2]), 0.5 * (h[0, 2] - h[2, 0]), 0.5 * (h[1, 0] - h[0, 1])
        xx, yy, zz = h[0, 0], h[1, 1], h[2, 2]
        trace = xx + yy + zz
        square = xx * xx + yy * yy + zz * zz + 2.0 * (yz * yz + xz * xz + xy * xy)
        size, turn = np.sqrt(square), wx * wx + wy * wy + wz * wz
        part = volume if size <= limit else volume * limit / size
        work = part * (2.0 * mu * square + lam * trace * trace)
        if len(rest) > 0:
            strain[0], strain[1], strain[2] = xx, yy, zz
            strain[3], strain[4], strain[5] = ROOT * xy, ROOT * yz, ROOT * xz
            for i in range(6):
                stress[i] = 0.0
                for j in range(6):
                    stress[i] += rest[c if len(rest) > 1 else 0, i, j] * strain[j]
                work += part * stress[i] * strain[i]
        sums[VOLUME] += volume
        sums[WORK] += work
        sums[STRAIN] += work * size
        sums[TURN] += volume * turn
        sums[TURN_WORK] += work * turn
        if held[c]:
            # the stress across the plane of a rotation, if it has one, cancels
            along = xx * wx * wx + yy * wy * wy + zz * wz * wz + 2.0 * (yz * wy * wz + xz * wx * wz + xy * wx * wy)
            sums[STIFFENING] += part * ((lam + mu) * turn * trace - mu * along)
            if len(rest) > 0:
                across = stress[3] * wx * wy + stress[4] * wy * wz + stress[5] * wx * wz
                along = stress[0] * wx * wx + stress[1] * wy * wy + stress[2] * wz * wz + ROOT * across
                sums[STIFFENING] += 0.5 * part * (turn * (stress[0] + stress[1] + stress[2]) - along)
        error = 0.5 * max(size, turn)
        if error > largest[0]:
            largest[0], largest[1] = error, c


# [degrees] Turn of bodies with small strain that needs no word. From: they shrink by less than 0.1 %, 1 - cos.
SLIGHT = 2.5


class Distortion(NamedTuple):
    """Of one body.

    Attributes
    ----------
    strain : float
        Mean size of the strain, sqrt(e : e), by the work that it takes.
    rotation : float
        Root of the mean square, by volume or by that work, whichever is larger [degrees].
    stiffening : float
        Work of the stresses along what the rotation makes of lengths, over that along the strain; without supports 0.
    place : tuple of float
        Reference position where the strain or the rotation is largest [length].
    """

    strain: float
    rotation: float
    stiffening: float
    place: tuple

    @property
    def errors(self):
        """Parts by which strain, rotation, and the rotation against the strain put results wrong, about."""
        turn = 0.5 * np.radians(self.rotation) ** 2
        return 0.5 * self.strain, turn, self.stiffening if self.rotation > SLIGHT else 0.0


def _places(space, number):
    """Places in the cells of a block, one after the other: the centre where the displacement is of degree 1; of degree
    2 the strain of a single cell across a body bends it, and is none at the centre."""
    mesh, block = space.mesh, space.mesh.blocks[number]
    table, degree = mesh.geometry_nodes(block)
    points, weights = quadrature(block.cell, space.degree)
    if space.degree == 1:
        points, weights = (weights @ points / weights.sum())[None, :], weights.sum(keepdims=True)
    for xi, weight in zip(points[:, None, :], weights, strict=True):
        yield Places(
            mesh.points, table, space.cells[number],
            shape(block.cell, degree, xi)[0], np.ascontiguousarray(shape_gradient(block.cell, degree, xi)[0]),
            shape(block.cell, space.degree, xi)[0],
            np.ascontiguousarray(shape_gradient(block.cell, space.degree, xi)[0]),
            float(weight), space.axisymmetric,
        )  # fmt: skip


def _rest(law, centres):
    """Difference of the stiffness of a law from an isotropic one at places of cells (k, 6, 6); k = 0 without."""
    if not law.anisotropic:
        return np.zeros((0, 6, 6))
    some = centres.table[:1] if law.uniform else centres.table
    deviation = law.deviation(np.einsum("a,cad->cd", centres.geo, centres.places[some]))
    out = np.zeros((len(deviation), 6, 6))
    out[:, : law.size, : law.size] = deviation
    return out


def distortions(bulk, u, held):
    """Of all bodies with small strain. *Collective.*

    Parameters
    ----------
    bulk : pcontact.assembly.solid.Solid
        Bodies without stiffness in it are left out: another item has them.
    u : PETSc.Vec
    held : ndarray (n_components,) of bool
        Connected components that a support holds.

    Returns
    -------
    dict of int to Distortion
        By body of the scene, the same on every rank.
    """
    space, comm = bulk.space, bulk.space.comm
    nodal = space.local.gather(u)
    bodies = [body for body, (_, mu) in enumerate(bulk.constants) if mu > 0.0]
    sums, largest = np.zeros((len(bulk.constants), SUMS)), [(-1.0, ())] * len(bulk.constants)
    for number, block in enumerate(space.mesh.blocks):
        lam, mu = bulk.constants[block.body]
        if mu == 0.0:
            continue
        material, moved, worst = bulk.materials[block.body], bulk.moved(nodal, number), np.zeros(2)
        for at in _places(space, number):
            stiffness = Stiffness(lam, mu, RADIUS * material.limit / (2.0 * mu), _rest(material, at))
            add_distortion(at, moved, stiffness, held[block.components], sums[block.body], worst)
            if worst[0] >= 0.0:
                place = at.geo @ at.places[at.table[int(worst[1])]]
                largest[block.body] = max(largest[block.body], (float(worst[0]), tuple(place.tolist())))
    sums = comm.allreduce(sums, op=MPI.SUM)
    places = [max(found)[1] for found in zip(*comm.allgather(largest), strict=True)]
    # bodies that are absent have no cells
    return {body: _of(sums[body], places[body]) for body in bodies if sums[body][VOLUME] > 0.0}


def _of(sums, place):
    work, volume = max(sums[WORK], 1e-300), max(sums[VOLUME], 1e-300)
    rotation = np.degrees(np.sqrt(max(sums[TURN] / volume, sums[TURN_WORK] / work)))
    return Distortion(float(sums[STRAIN] / work), float(rotation), float(abs(sums[STIFFENING]) / work), place)


# [-] sine of an angle below which the axis of a turn by about 180 degrees is that of the largest diagonal entry. From:
# chosen; the axial vector has lost four digits there.
FLAT = 1e-4


@njit
def principal_stretches(strain, m, out):
    """exp of the principal values of logarithmic strains (nc, 6) into ``out`` (nc, 3), the largest first.

    With m = 4 the third direction stands alone. Components XX, YY, ZZ, XY, YZ, XZ of the tensors.
    """
    tensor, values, vectors = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
    for c in range(len(strain)):
        for k in range(6):
            i, j = indices(k)
            tensor[i, j] = strain[c, k]
            tensor[j, i] = strain[c, k]
        eigenpairs(tensor, m, values, vectors)
        values.sort()
        for i in range(3):
            out[c, i] = np.exp(values[2 - i])


@njit
def rotation_vectors(h, m, out):
    """Rotation vectors [degrees] of displacement gradients.

    Parameters
    ----------
    h : ndarray (nc, 3, 3)
    m : int
        6; 4 where the third direction stands alone.
    out : ndarray (nc, 3)
        Overwritten: axis times angle, at most 180 degrees, of the rotation R of F = R U.
    """
    twice, root, values, vectors = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3))
    r = np.zeros((3, 3))
    for c in range(len(h)):
        twice_green(h[c], twice)
        eigenpairs(twice, m, values, vectors)
        for i in range(3):
            values[i] = 1.0 / np.sqrt(1.0 + values[i])
        compose(values, vectors, root)
        for i in range(3):
            for j in range(3):
                r[i, j] = root[i, j]
                for k in range(3):
                    r[i, j] += h[c, i, k] * root[k, j]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            out[c, i] = 0.5 * (r[k, j] - r[j, k])
        sine = np.sqrt(out[c, 0] ** 2 + out[c, 1] ** 2 + out[c, 2] ** 2)
        cosine = 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0)
        angle = np.degrees(np.arctan2(sine, cosine))
        if cosine < 0.0 and sine < FLAT:
            # 1/2 (R + R^T) = cos I + (1 - cos) a a, with the axis a
            most = np.argmax(np.diag(r))
            sign = -1.0 if out[c, most] < 0.0 else 1.0
            for i in range(3):
                values[i] = 0.5 * (r[i, most] + r[most, i]) - (cosine if i == most else 0.0)
            length = np.sqrt(values[0] ** 2 + values[1] ** 2 + values[2] ** 2)
            for i in range(3):
                out[c, i] = sign * angle * values[i] / length
        elif sine > 0.0:
            for i in range(3):
                out[c, i] *= angle / sine


def mean_gradients(space, nodal, number):
    """Mean displacement gradient (nc, 3, 3) over every undeformed cell of a block, of nodal values (n, d)."""
    d, cells = space.dim, space.cells[number]
    result = np.zeros((len(cells), 3, 3))
    for rows, grad, jxw, shapes in chunks(space, number):
        values, weight = nodal[cells[rows]], jxw / jxw.sum(axis=1)[:, None]
        result[rows, :d, :d] = np.einsum("cq,cqaj,cai->cij", weight, grad, values, optimize=True)
        ring = hoop(space, number, rows, shapes)
        if ring is not None:
            result[rows, 2, 2] = np.einsum("cq,cqa,ca->c", weight, ring, values[:, :, 0])
    return result


def deformation_fields(space, nodal, strains):
    """Fields of cells: logarithmic strain, principal stretches, rotation vector.

    Parameters
    ----------
    space : pcontact.space.space.Space
    nodal : ndarray (n, d)
        Displacement of local nodes [length].
    strains : list of ndarray (nc, 6)
        Mean logarithmic strain of the cells of each block.

    Returns
    -------
    dict of str to list of ndarray
        ``log_strain``; ``stretch_1`` >= ``stretch_2`` >= ``stretch_3`` (nc,), exp of its principal values; ``rotation``
        (nc, 3), of the mean displacement gradient [degrees].
    """
    m, result = 6 if space.dim == 3 else 4, {"log_strain": strains}
    stretches = [np.zeros((len(strain), 3)) for strain in strains]
    for strain, out in zip(strains, stretches, strict=True):
        principal_stretches(strain, m, out)
    for k in range(3):
        result[f"stretch_{k + 1}"] = [np.ascontiguousarray(out[:, k]) for out in stretches]
    result["rotation"] = [np.zeros((len(strain), 3)) for strain in strains]
    for number, out in enumerate(result["rotation"]):
        rotation_vectors(mean_gradients(space, nodal, number), m, out)
    return result


class Deformation(NamedTuple):
    """Of one body, by the means over its cells.

    Attributes
    ----------
    largest_stretch, smallest_stretch : float
    rotation : float
        Largest angle [degrees].
    place : tuple of float
        Middle, in the undeformed body, of the cell whose stretch is farthest from 1 [length].
    """

    largest_stretch: float
    smallest_stretch: float
    rotation: float
    place: tuple


def deformations(space, fields, numbers):
    """Largest stretches and rotations of bodies. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    fields : dict of str to list of ndarray
        See :func:`deformation_fields`.
    numbers : iterable of int
        Blocks.

    Returns
    -------
    dict of int to Deformation
        By body of the scene, the same on every rank.
    """
    own = {}
    for number in numbers:
        high, low = fields["stretch_1"][number], fields["stretch_3"][number]
        if len(high) == 0:
            continue
        far = np.maximum(high, 1.0 / low)
        cell = int(np.argmax(far))
        place = points_of(space, number, slice(cell, cell + 1))[0].mean(axis=0)
        turned = np.linalg.norm(fields["rotation"][number], axis=1)
        found = high.max(), -low.min(), turned.max(), (far[cell], tuple(place.tolist()))
        body = space.mesh.blocks[number].body
        own[body] = [max(pair) for pair in zip(own.get(body, found), found, strict=True)]
    every = space.comm.allgather(own)
    result = {}
    for body in sorted(set().union(*every)):
        high, low, turn, far = (max(parts) for parts in zip(*(one[body] for one in every if body in one), strict=True))
        result[body] = Deformation(float(high), float(-low), float(turn), far[1])
    return result
