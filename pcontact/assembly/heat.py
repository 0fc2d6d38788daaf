"""Thermal strain of bodies with small strain: the stress -C : alpha dT that heated cells have at zero strain.

C : alpha is what the law of a cell says (:meth:`pcontact.material.elastic.Elastic.thermal`), and may vary with the
place. Where cells take their mean dilatation, dT is projected as the dilatation is (`pcontact.element.dilatation`): a
temperature that varies within a cell then strains it as far as its mean dilatation can follow.
"""

from contextlib import contextmanager
from typing import NamedTuple
from weakref import WeakSet

import numpy as np

from pcontact.assembly.geometry import chunks, hoop, points_of, some_cells_weighted
from pcontact.assembly.strains import add_forces, add_means, cell_points
from pcontact.element.dilatation import components, linear
from pcontact.material.elastic import LOADED
from pcontact.material.orthotropic import traction_matrix
from pcontact.runtime.parallel import agree, together
from pcontact.runtime.petsc import MPI
from pcontact.scene.functions import Prescribed


class Heating(NamedTuple):
    """Temperature field and expansion of a group of cells.

    Attributes
    ----------
    region : str or None
        Group of cells; None: all.
    prescribed : pcontact.scene.functions.Prescribed or callable
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
    """Temperatures of the cells, and their thermal stress C : alpha dT [stress], at a time.

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
        That of the owned nodes [force].
    means : list of ndarray (nc, 6)
        Its mean over the cells of each block, components as those of stresses.

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
        # those of a target are made anew in every search
        self._time, self._traces, self.forces = None, WeakSet(), np.zeros((space.n_owned, space.dim))
        self._which = [np.full(len(block.nodes), -1, dtype=np.int64) for block in space.mesh.blocks]
        self.means = [np.zeros((len(which), 6)) for which in self._which]
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
        heated = [self._material(number) for number, which in enumerate(self._which) if (which >= 0).any()]
        expands = any(law.expansion_energy or law.reads_temperature for law in heated)
        if not space.comm.allreduce(expands, op=MPI.LOR):
            agree(space.comm, f"{source}: {heatings[0].key}: found no cell of a material with expansion; allowed: "
                              "materials of heated bodies with expansion")  # fmt: skip

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

    @contextmanager
    def at(self, time):
        """For a while temperatures are those of another time, unless it is None."""
        kept, self._time = self._time, self._time if time is None else time
        try:
            yield
        finally:
            self._time = kept

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
        """Return True if a block has cells that are heated and expand."""
        return bool((self._which[number] >= 0).any() and self._material(number).expansion_energy)

    def _material(self, number):
        return self._materials[self.space.mesh.blocks[number].body]

    def _chunks(self):
        """Block, rows, points as kernels want them, weights, places, and dT (nc, nq) of the chunks of heated cells."""
        space = self.space
        for number, block in enumerate(space.mesh.blocks):
            for rows, grad, jxw, shapes in chunks(space, number) if self.heated(number) else ():
                x, some = points_of(space, number, rows), np.arange(rows.start, rows.stop)
                values = self.temperatures(number, some, x)[0]
                if space.averages(block):
                    values = _fit(space, block, jxw, x, values)(x, np.arange(len(some)))
                points = cell_points(space.cells[number][rows], grad, hoop(space, number, rows, shapes))
                yield number, rows, points, np.ascontiguousarray(jxw), x, values

    def stress(self, number, x, values):
        """C : alpha dT (n, m) of a block at points x (..., d) with dT (...) there, Mandel components."""
        return values.reshape(-1, 1) * self._material(number).thermal(x.reshape(-1, x.shape[-1]))

    def _integrated(self):
        """Forces at local nodes (n_local, d), and means of the cells."""
        local, means = np.zeros((self.space.n_local, self.space.dim)), [np.zeros_like(mean) for mean in self.means]
        for number, rows, points, jxw, x, values in self._chunks():
            stress = self.stress(number, x, values)
            add_forces(points, jxw, stress, np.full(len(stress), LOADED), False, local)
            add_means(jxw, stress, means[number][rows])
        return local, means

    def energy(self):
        """Energy that heated cells would store if they were kept from expanding [force * length]. *Collective.*"""
        own = 0.0
        for number, _, _, jxw, _, values in self._chunks():
            own += 0.5 * self._material(number).expansion_energy * np.sum(jxw * values**2)
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
        self._traces.add(trace)
        if self._time is not None:
            together(self.space.comm, trace.take, self)
        return trace

    def on_cells(self, number, rows, cells, points):
        """C : alpha dT (n, m, k) at points (n, m, d) of cells, of which ``cells`` (n,) says the place in ``rows``."""
        space, block = self.space, self.space.mesh.blocks[number]
        if space.averages(block):
            _, jxw, _, _ = some_cells_weighted(space, number, rows)
            own = points_of(space, number, rows)
            values = _fit(space, block, jxw, own, self.temperatures(number, rows, own)[0])(points, cells)
        else:
            values = self.temperatures(number, rows[cells], points)[0]
        stress = self.stress(number, points, values)
        return stress.reshape(*points.shape[:2], stress.shape[1])


class HeatTrace:
    """Thermal stress at the points of a source surface.

    Parameters
    ----------
    heat : Heat
    source : pcontact.contact.surface.sides.SourceSurface
    name : str
        Its facet group.

    Attributes
    ----------
    values : ndarray (np, d)
        Its traction, of the time that the heat has been told last [stress].
    parts : list
        Points and parent cells, by block.
    """

    def __init__(self, heat, source, name):
        self.values, self.parts = np.zeros_like(source.normal), []
        # facets without a shear modulus take part without their traction
        speaks = source.mu[source.facet] > 0.0
        for facets, which in heat.space.mesh.facets_of(name):
            if not heat.heated(facets.block):
                continue
            points = np.flatnonzero((source.facet >= which.start) & (source.facet < which.stop) & speaks)
            onto, x = traction_matrix(source.normal[points]), source.x[points][:, None]
            self.parts.append((facets.block, facets.cells, points, source.facet[points] - which.start, x, onto))

    def tractions(self, traction):
        """Minus the traction of the thermal stress (np, d) at the points of the source [stress]."""
        return -self.values

    def take(self, heat):
        """Take the temperatures that the heat has."""
        for number, rows, points, cells, x, onto in self.parts:
            self.values[points] = np.einsum("nik,nk->ni", onto, heat.on_cells(number, rows, cells, x)[:, 0])
