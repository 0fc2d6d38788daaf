"""Thermal strain of bodies with small strain: the stress -beta dT I that heated cells have at zero strain.

The stress is  C : (eps - alpha dT I) = C : eps - beta dT I,  beta = (3 lam + 2 mu) alpha, in plane stress
(2 lam + 2 mu) alpha with the lam of plane stress. Yielding is a matter of the deviator, which beta dT I does not have.
Where cells take their mean dilatation, beta dT is projected as the dilatation is (`pcontact.element.dilatation`): a
temperature that varies within a cell then strains it as far as its mean dilatation can follow.

Of an orthotropic body beta is a tensor, C : alpha (`pcontact.material.orthotropic`), which may vary with the place.
What is called beta dT is the difference of temperature dT alone there, and beta comes with the operators.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import chunks, hoop, points_of, some_cells_weighted
from pcontact.element.dilatation import components, dilatation, linear
from pcontact.material.mandel import HALF
from pcontact.material.orthotropic import traction_matrix
from pcontact.runtime.parallel import agree, together
from pcontact.runtime.petsc import MPI
from pcontact.scene.prescribed import Prescribed


class Heating(NamedTuple):
    """What heats a group of cells.

    Attributes
    ----------
    region : str or None
        Group of cells; None: all.
    prescribed : pcontact.scene.prescribed.Prescribed or callable
        Temperature at factor 1; or what makes a `NodalField` of it, from which cells of the blocks need it.
    reference : float
        Temperature without thermal strain.
    amplitude : pcontact.scene.amplitude.Amplitude
        Factor of the difference.
    key : str
        For messages.
    """

    region: str | None
    prescribed: object
    reference: float
    amplitude: object
    key: str


def _fit(space, block, jxw, points, values):
    """Projection of values (nc, nq) as that of the mean dilatation, a function of points (n, m, d) and their cells."""
    basis, volume, centre, inverse = components(jxw, points if linear(block.cell, space.degree_of(block)) else None)
    parts = np.einsum("cq,cqb,cq->cb", jxw, basis, values) / volume[:, None]

    def at(x, cells):
        if inverse is None:
            return np.repeat(parts[cells], x.shape[1], axis=1)
        slopes = np.einsum("ck,ckl->cl", parts[cells, 1:], inverse[cells])
        return parts[cells, :1] + np.einsum("cqk,ck->cq", x - centre[cells][:, None], slopes)

    return at


class Heat:
    """Thermal stress beta dT [stress] of the cells, at a time.

    Parameters
    ----------
    space : pcontact.space.space.Space
    heatings : list of Heating
    materials : list of pcontact.material.elastic.Elastic
        Of each body.
    source : str
        Name of the scene, for messages.

    Attributes
    ----------
    forces : ndarray (n_owned, d)
        int beta dT div v of the owned nodes [force].
    means : list of ndarray (nc,) or (nc, 6)
        Mean of beta dT over the cells of each block; of an orthotropic body the tensor, as stresses are.

    Raises
    ------
    InputError
        On every rank: two heatings have a cell in common, or none heats a cell that expands.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, heatings, materials, source):
        self.space, self._heatings, self._materials = space, heatings, materials
        self._time, self._traces, self.forces = None, [], np.zeros((space.n_owned, space.dim))
        self._which = [np.full(len(block.nodes), -1, dtype=np.int64) for block in space.mesh.blocks]
        self.means = self._no_means()
        message = None
        for number, one in enumerate(heatings):
            groups = [np.arange(len(w)) for w in self._which]
            groups = groups if one.region is None else space.mesh.cell_groups.get(one.region, [])
            for which, rows in zip(self._which, groups, strict=False):
                twice = which[rows] >= 0
                if twice.any():
                    other = heatings[int(which[rows][twice][0])].key
                    message = (f"{source}: {one.key}.region: found {int(twice.sum())} cells that {other} heats, too; "
                               "allowed: one temperature in each cell")  # fmt: skip
                which[rows] = number
        agree(space.comm, message)
        for number, one in enumerate(heatings):
            if not isinstance(one.prescribed, Prescribed):
                heatings[number] = one._replace(prescribed=one.prescribed([w == number for w in self._which]))
        expands = any((which >= 0).any() and (materials[block.body].beta or materials[block.body].reads_temperature)
                      for which, block in zip(self._which, space.mesh.blocks, strict=True))  # fmt: skip
        if not space.comm.allreduce(expands, op=MPI.LOR):
            agree(space.comm, f"{source}: {heatings[0].key}: found no cell of a material with expansion; allowed: "
                              "materials of heated bodies with expansion")  # fmt: skip

    def stress(self, number, rows, points):
        """beta dT (n, nq) at points (n, nq, d) of cells (n,) of a block, as the temperature says."""
        return self._material(number).beta * self.temperatures(number, rows, points)[0]

    def temperatures(self, number, rows, points):
        """dT, and the temperature itself, (n, nq) at points (n, nq, d) of cells (n,) of a block; 0 where nothing heats
        them."""
        out, which, reference = np.zeros(points.shape[:2]), self._which[number][rows], np.zeros((len(rows), 1))
        for k in np.unique(which[which >= 0]):
            one, own = self._heatings[k], which == k
            if isinstance(one.prescribed, Prescribed):
                values = one.prescribed(points[own].reshape(-1, points.shape[2]), self._time)[:, 0]
            else:
                values = one.prescribed.at(number, rows[own], points[own])
            out[own] = one.amplitude.factor(self._time) * (values.reshape(-1, points.shape[1]) - one.reference)
            reference[own] = one.reference
        return out, reference + out

    def detect(self, time):
        """Take the temperatures of a time. *Collective.*"""
        if time == self._time:
            return
        self._time = time
        local, self.means = together(self.space.comm, self._integrated)
        self.forces = self.space.summed(self.space.local, local)
        together(self.space.comm, self._tell)

    def _tell(self):
        for trace in self._traces:
            trace.take(self)

    def heated(self, number):
        """Whether a block has cells that are heated and expand."""
        return bool((self._which[number] >= 0).any() and self._material(number).beta)

    def _material(self, number):
        return self._materials[self.space.mesh.blocks[number].body]

    def _chunks(self):
        """Block, rows, gradients, weights, hoop operators and beta dT (nc, nq) of the chunks of heated cells."""
        space = self.space
        for number, block in enumerate(space.mesh.blocks):
            for rows, grad, jxw, shapes in chunks(space, number) if self.heated(number) else ():
                points = points_of(space, number, rows)
                some = np.arange(rows.start, rows.stop)
                values = self.stress(number, some, points)
                if space.averages(block):
                    values = _fit(space, block, jxw, points, values)(points, np.arange(len(some)))
                yield number, rows, grad, jxw, hoop(space, number, rows, shapes), values

    def law(self, number):
        """The orthotropic law of a block, None where it is isotropic."""
        material = self._material(number)
        return material if material.anisotropic else None

    def _no_means(self):
        return [np.zeros(len(which) if self.law(number) is None else (len(which), 6))
                for number, which in enumerate(self._which)]  # fmt: skip

    def _integrated(self):
        """Forces at local nodes (n_local, d), and means of the cells."""
        space = self.space
        local, means = np.zeros((space.n_local, space.dim)), self._no_means()
        for number, rows, grad, jxw, ring, values in self._chunks():
            law, volume = self.law(number), jxw.sum(axis=1)
            if law is None:
                operator = dilatation(grad, ring)
                means[number][rows] = np.sum(jxw * values, axis=1) / volume
            else:
                beta = self.directions(number, rows, values.shape)
                operator = _pulled(beta, grad, ring)
                # components of tensors, not those of Mandel
                parts = np.einsum("cq,cq,cqk->ck", jxw, values, beta) / volume[:, None]
                means[number][rows, : parts.shape[1]] = parts * ([1.0] * 3 + [HALF] * (parts.shape[1] - 3))
            np.add.at(local, space.cells[number][rows], np.einsum("cq,cq,cqad->cad", jxw, values, operator))
        return local, means

    def take_off(self, stress, number):
        """Take the means off the stresses (nc, 6) of the cells of a block."""
        mean = self.means[number]
        if mean.ndim > 1:
            stress -= mean
        else:
            stress[:, : 2 if self.space.kinematics == "plane_stress" else 3] -= mean[:, None]

    def directions(self, number, rows, shape):
        """beta (nc, nq, m) of an orthotropic body at the points of cells, in Mandel components [stress/temperature]."""
        beta = self.law(number).thermal(points_of(self.space, number, rows).reshape(-1, self.space.dim))
        return np.broadcast_to(beta, (shape[0] * shape[1], beta.shape[1])).reshape(*shape, -1)

    def onto(self, number, x, normal):
        """beta n (n, d) of an orthotropic body at points x (n, d); None where a block is isotropic."""
        law = self.law(number)
        return None if law is None else np.einsum("nik,nk->ni", traction_matrix(normal), np.broadcast_to(
            law.thermal(x), (len(x), law.size)))  # fmt: skip

    def energy(self):
        """What heated cells would store if they were kept from expanding [force * length]. *Collective.*"""
        own = 0.0
        for number, _, _, jxw, _, values in self._chunks():
            own += 0.5 * np.sum(jxw * values**2) / self._material(number).bulk
        return float(self.space.comm.allreduce(own, op=MPI.SUM))

    def trace(self, source, name):
        """The thermal stress at the points of a source surface; None where it has none. *Collective.*

        Parameters
        ----------
        source : pcontact.contact.surface.sides.SourceSurface
        name : str
            Its facet group.

        Returns
        -------
        HeatTrace or None
        """
        trace = HeatTrace(self, source, name)
        if not self.space.comm.allreduce(bool(trace.parts), op=MPI.LOR):
            return None
        self._traces.append(trace)
        return trace

    def facets(self, name):
        """Block, rows of the cells and first number of the facets of a group whose cells are heated."""
        first = 0
        for facets in self.space.mesh.facet_groups.get(name, []):
            if self.heated(facets.block):
                yield facets.block, facets.cells, first
            first += len(facets.cells)

    def on_cells(self, number, rows, cells, points):
        """beta dT (n, m) at points (n, m, d) of cells, of which ``cells`` (n,) says the place in ``rows``."""
        space, block = self.space, self.space.mesh.blocks[number]
        if not space.averages(block):
            return self.stress(number, rows[cells], points)
        _, jxw, shapes, _ = some_cells_weighted(space, number, rows)
        own = points_of(space, number, rows)
        return _fit(space, block, jxw, own, self.stress(number, rows, own))(points, cells)


def _pulled(beta, grad, ring):
    """beta : B (nc, nq, nn, d) of gradients (nc, nq, nn, d), N / r or None, and Mandel components (nc, nq, m)."""
    d = grad.shape[3]
    tensor = np.zeros((*beta.shape[:2], d, d))
    for i in range(d):
        tensor[..., i, i] = beta[..., i]
    for k, (i, j) in enumerate(((0, 1), (1, 2), (0, 2))[: 3 if d == 3 else 1], start=3):
        tensor[..., i, j] = tensor[..., j, i] = HALF * beta[..., k]
    out = grad @ tensor
    if ring is not None:
        out[..., 0] += ring * beta[..., 2:3]
    return out


class HeatTrace:
    """beta dT at the points of a source surface.

    Parameters
    ----------
    heat : Heat
    source : pcontact.contact.surface.sides.SourceSurface
    name : str
        Its facet group.

    Attributes
    ----------
    values : ndarray (np,)
        Of the time that the heat has been told last [stress].
    onto : ndarray (np, d)
        What they are multiplied with: the normal; beta n where cells are orthotropic.
    parts : list
        Points and parent cells, by block.
    """

    def __init__(self, heat, source, name):
        self.values, self.onto, self.parts = np.zeros(len(source.facet)), source.normal, []
        # facets without a shear modulus take part without their traction
        speaks = source.mu[source.facet] > 0.0
        for number, rows, first in heat.facets(name):
            points = np.flatnonzero((source.facet >= first) & (source.facet < first + len(rows)) & speaks)
            self.parts.append((number, rows, points, source.facet[points] - first, source.x[points][:, None]))
            onto = heat.onto(number, source.x[points], source.normal[points])
            if onto is not None:
                self.onto = self.onto.copy() if self.onto is source.normal else self.onto
                self.onto[points] = onto

    def tractions(self, rest):
        """-beta dT n_X (np, d) at the points of the source [stress]."""
        return -self.values[:, None] * self.onto

    def take(self, heat):
        """Take the temperatures that the heat has."""
        for number, rows, points, cells, x in self.parts:
            self.values[points] = heat.on_cells(number, rows, cells, x)[:, 0]
