"""How far bodies with small strain are from what small strain represents."""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.distortion_kernels import (
    STIFFENING,
    STRAIN,
    SUMS,
    TURN,
    TURN_WORK,
    VOLUME,
    WORK,
    Centres,
    Stiffness,
    add_distortion,
)
from pcontact.element.quadrature import quadrature
from pcontact.element.shape import shape, shape_gradient
from pcontact.material.hardening import RADIUS
from pcontact.runtime.petsc import MPI

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


def _centres(space, number):
    mesh, block = space.mesh, space.mesh.blocks[number]
    table, degree = mesh.geometry_nodes(block)
    xi, weights = quadrature(block.cell, 1)
    xi = (weights @ xi / weights.sum())[None, :]
    return Centres(
        mesh.points, table, space.cells[number],
        shape(block.cell, degree, xi)[0], np.ascontiguousarray(shape_gradient(block.cell, degree, xi)[0]),
        shape(block.cell, space.degree, xi)[0],
        np.ascontiguousarray(shape_gradient(block.cell, space.degree, xi)[0]),
        float(weights.sum()), space.axisymmetric,
    )  # fmt: skip


def _rest(law, centres):
    """What the stiffness of a law differs by at the centres of cells (k, 6, 6); k = 0 without."""
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
        material, centres, worst = bulk.materials[block.body], _centres(space, number), np.zeros(2)
        stiffness = Stiffness(lam, mu, RADIUS * material.limit / (2.0 * mu), _rest(material, centres))
        moved = bulk.moved(nodal, number)
        add_distortion(centres, moved, stiffness, held[block.components], sums[block.body], worst)
        if worst[0] >= 0.0:
            place = centres.geo @ centres.places[centres.table[int(worst[1])]]
            largest[block.body] = max(largest[block.body], (float(worst[0]), tuple(place.tolist())))
    sums = comm.allreduce(sums, op=MPI.SUM)
    places = [max(found)[1] for found in zip(*comm.allgather(largest), strict=True)]
    # bodies that are absent have no cells
    return {body: _of(sums[body], places[body]) for body in bodies if sums[body][VOLUME] > 0.0}


def _of(sums, place):
    work, volume = max(sums[WORK], 1e-300), max(sums[VOLUME], 1e-300)
    rotation = np.degrees(np.sqrt(max(sums[TURN] / volume, sums[TURN_WORK] / work)))
    return Distortion(float(sums[STRAIN] / work), float(rotation), float(abs(sums[STIFFENING]) / work), place)
