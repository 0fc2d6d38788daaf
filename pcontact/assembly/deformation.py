"""How bodies are stretched and turned, cell by cell, for reports and pictures."""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import chunks, hoop, points_of
from pcontact.material.log_strain import compose, eigenpairs, twice_green
from pcontact.runtime.jit import njit

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
            i, j = (k, k) if k < 3 else ((0, 1) if k == 3 else ((1, 2) if k == 4 else (0, 2)))
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
    """How far bodies are stretched and turned. *Collective.*

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
