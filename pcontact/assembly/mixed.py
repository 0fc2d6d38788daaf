"""The bulk item of scenes in which some bodies have finite strain and others do not: the sum of two."""

import numpy as np

from pcontact.assembly.deformation import deformation_fields, mean_gradients
from pcontact.assembly.finite import FiniteBulk
from pcontact.assembly.item import LAW, Bulk
from pcontact.assembly.pattern import positions
from pcontact.assembly.solid import Solid
from pcontact.material.elastic import Elastic


class MixedBulk(Bulk):
    """Item of all bodies, of which some have finite strain.

    Parameters
    ----------
    space : pcontact.space.space.Space
    laws : list of pcontact.material.elastic.Elastic
        Of small strain, of each body of the scene.
    finite : list of pcontact.material.finite.FiniteMaterial or None
        See :class:`FiniteBulk`; None for bodies without finite strain.

    Attributes
    ----------
    small : Solid
        In which bodies with finite strain have no stiffness.
    finite : FiniteBulk

    Notes
    -----
    *Collective.*
    """

    symmetric, extrapolates = False, True

    def __init__(self, space, laws, finite):
        self.space, self.constants = space, [law.constants for law in laws]
        nothing = Elastic(0.0, 0.0)
        self.small = Solid(space, [nothing if other else law for law, other in zip(laws, finite, strict=True)])
        self.finite = FiniteBulk(space, self.constants, finite)
        self.yields, self.states = self.small.yields or self.finite.yields, self.small.states
        self.parts, self.origins = self.finite.parts, {}
        self._place = positions(*self.finite.pattern(), *self.small.pattern())

    def count_from(self, origins):
        """See :meth:`pcontact.assembly.item.Bulk.count_from`: of blocks without finite strain. *Collective.*"""
        self.origins = origins
        self.small.count_from(origins)

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self.small.pattern()

    def residual(self, u, out, rule=LAW):
        """Add the internal forces of the owned nodes to ``out`` (n_owned, d). *Collective.*"""
        self.small.residual(u, out)
        self.finite.residual(u, out)

    def detect(self, u, time, motion=0.0, ahead=None):
        """See :meth:`pcontact.assembly.solid.Solid.detect`. *Collective.*"""
        self.small.detect(u, time)

    def predict(self, u, base, out):
        """Add the forces at ``u`` as those of each kind of body are predicted from ``base``. *Collective.*"""
        self.small.predict(u, base, out)
        self.finite.predict(u, base, out)

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        self.small.add_magnitude(u, out)
        self.finite.add_magnitude(u, out)

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`. *Collective.*"""
        values = self.small.tangent(u).copy()
        values[self._place] += self.finite.tangent(u)
        return values

    def commit(self, u, time):
        """Take the internal variables to a displacement. *Collective.*"""
        self.small.commit(u, time)
        self.finite.commit(u, time)

    def flowing(self, u):
        """The larger of the parts of the volume that may yield, of both kinds of bodies, which yields. *Collective.*"""
        return max(self.small.flowing(u), self.finite.flowing(u))

    def counters(self):
        """Quadrature points with internal variables."""
        return {"points": sum(part.counters()["points"] for part in (self.small, self.finite)), "work": 0}

    def memory(self):
        """Internal variables by block, see :meth:`pcontact.assembly.solid.Solid.memory`."""
        return {**self.small.memory(), **self.finite.memory()}

    def memory_keys(self):
        """Keys (n,) of all rows that :meth:`memory` may have."""
        parts = [part.memory_keys() for part in (self.small, self.finite)]
        return np.concatenate([np.zeros(0, dtype=np.int64), *(keys for keys in parts if keys is not None)])

    def recall(self, name, chunks):
        """Take back what :meth:`memory` gave, see `pcontact.assembly.item.Item.recall`."""
        return (self.finite if int(name) in self.finite.parts else self.small).recall(name, chunks)

    # -- report -----------------------------------------------------------------------------------------------------

    def _joined(self, small, finite):
        """Values of each block, from the item that has its cells."""
        return [finite[number] if number in self.finite.parts else values for number, values in enumerate(small)]

    def stress(self, u):
        """Mean stress, Cauchy's with finite strain, and undeformed volume of the cells of each block. *Collective.*"""
        return self._joined(self.small.stress(u), self.finite.stress(u))

    def fields(self, u):
        """See :func:`pcontact.assembly.deformation.deformation_fields`; bodies with small strain have theirs instead of
        a logarithmic one. *Collective.*"""
        nodal, space = self.space.local.gather(u), self.space
        result = [np.zeros((len(cells), 6)) for cells in space.cells]
        for number in set(range(len(result))) - set(self.finite.parts):
            h = mean_gradients(space, self.small.moved(nodal, number), number)
            result[number][:] = 0.5 * (h + h.transpose(0, 2, 1))[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
        return deformation_fields(space, nodal, self._joined(result, self.finite.log_strain(u)))

    def deformations(self, u):
        """Of the bodies with finite strain, see :func:`pcontact.assembly.deformation.deformations`. *Collective.*"""
        return self.finite.deformations(u)

    def energies(self, u):
        """See :meth:`pcontact.assembly.item.Bulk.energies`. *Collective.*"""
        return tuple(sum(parts) for parts in zip(self.small.energies(u), self.finite.energies(u), strict=True))

    def plastic_strain(self):
        """Mean equivalent plastic strain (nc,) of the cells of each block; None where nothing may yield."""
        found = [values for values in (self.small.plastic_strain(), self.finite.plastic_strain()) if values is not None]
        return [sum(parts) for parts in zip(*found, strict=True)] if found else None

    def distortions(self, u, held):
        """Of the bodies without finite strain, see :func:`pcontact.assembly.distortion.distortions`. *Collective.*"""
        return self.small.distortions(u, held)

    def plasticity(self):
        """Largest equivalent plastic strain, and volume that has yielded [length^d]. *Collective.*"""
        parts = [self.small.plasticity(), self.finite.plasticity()]
        return max(strain for strain, _ in parts), sum(volume for _, volume in parts)
