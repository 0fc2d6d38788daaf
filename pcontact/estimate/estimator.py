"""Estimate of the error of a displacement in the energy norm, from local problems on every cell.

With u_h the computed displacement, P the traction that contact exerts on the bodies and t = sigma(u_h) n, the error is
driven by residuals: of equilibrium inside cells, f + div sigma; of the traction between cells, which jumps; on the
boundary, what loads prescribe and t does not meet, g - t; on surfaces of contact P - t, in the direction of contact and
across it. These are the residuals of Chouly, Fabre, Hild, Pousin, Renard (2018); there their norms are weighted with
the size of the cell, here each is measured by the elastic displacement that it brings about in the cell (Bank and
Weiser 1985): on every cell K find e in the space of `pcontact.estimate.points` with

    int_K sigma(e) : eps(v) = int_K f . v - sigma(u_h) : eps(v) + int_dK s . v

where s is g on loaded facets, P on surfaces of contact (on the target what the source's points pass on), and between
cells one traction common to both: that of the stress averaged at the nodes. The mean of both sides' own tractions does
as well in the plane, but not on tetrahedra of degree 1, where it makes the estimate three times the error. Where
materials meet, each side has averages of its own, and a side takes of their difference the part that its stiffness is
of the sum of both. No constant is left to choose. Integration by parts stands in for second derivatives:

    interior   f + div sigma   as   int_K f . v - sigma(u_h) : eps(v) + int_dK t . v
    jumps      s - t           on facets between cells, and both sides of tied surfaces
    neumann    g - t           on the free and loaded boundary
    contact    P - t           along the direction of contact, without friction also across it
    friction   P - t           across it
"""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from pcontact.estimate.facets import FacetPairs
from pcontact.estimate.interiors import Held, Interiors
from pcontact.estimate.loads import Given
from pcontact.estimate.local import energies, products
from pcontact.estimate.points import INTERIOR, PARTS, number_of
from pcontact.estimate.residuals import ContactResiduals, FacetResiduals, stiffness
from pcontact.estimate.springs import Springs
from pcontact.estimate.stress import BlockStress, softening
from pcontact.estimate.tractions import Cells
from pcontact.runtime.petsc import MPI
from pcontact.space.space import ROOM, Kept


@dataclass
class Estimate:
    """Of one displacement, the same on every rank but for the cells.

    Attributes
    ----------
    absolute : float
        Energy norm of the error, sqrt(int sigma(e) : eps(e)).
    energy : float
        The same norm of the displacement, that of elasticity where bodies have yielded, too.
    parts : dict of str to float
        What each kind of residual brings about alone.
    surfaces : dict of str to dict of str to float
        For each pair of Nitsche's method the residual P - t on the source, ``contact`` along and ``friction`` across
        its direction, in the norm sqrt(int |.|^2 / lambda) with the constant lambda of the trace inequality
        [sqrt(energy)].
    cells : list of ndarray (nc,)
        Contribution of every cell of each block; their squares sum to that of ``absolute``.
    """

    absolute: float
    energy: float
    parts: dict
    surfaces: dict
    cells: list


class Tested(NamedTuple):
    """Knowledge of a displacement before any cell is looked at by itself.

    Attributes
    ----------
    nodal : ndarray (n_local, d)
    tested : list of ndarray (nc, n_parts, nb, d)
        Residuals of every block, but for what its cells' interiors add [force].
    surfaces : dict
        See :class:`Estimate`.
    """

    nodal: np.ndarray
    tested: list
    surfaces: dict


class Dual(NamedTuple):
    """A dual displacement.

    Attributes
    ----------
    nodal : ndarray (n_local, d)
    tested : ndarray (nc, n_parts, nb, d)
        Residuals of a block, but for what its cells' interiors add.
    loads : list of pcontact.estimate.loads.Given
    """

    nodal: np.ndarray
    tested: np.ndarray
    loads: list


class Steady:
    """The amplitude of a dual load."""

    @staticmethod
    def factor(_):
        """1."""
        return 1.0


class Estimator:
    """Estimates the error of displacements of one problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    loads : list of pcontact.estimate.loads.Given or pcontact.estimate.loads.Spread
    again : bool
        Whether several displacements are to come.

    Attributes
    ----------
    space : pcontact.space.space.Space
    cells : pcontact.estimate.tractions.Cells
        Of the surfaces of contact.

    Notes
    -----
    The constructor is *Collective*, and so are the calls.
    """

    def __init__(self, problem, loads, again=False):
        self.space, self._bulk, self._contacts, self._loads = problem.space, problem.bulk, problem.contacts, loads
        kept, pairs, self._springs = Kept(at_once=again), FacetPairs(self.space), Springs(problem)
        surfaces = [pair.contact for contact in self._contacts for pair in contact.pairs]
        names = {name for one in surfaces for name in (one.source, one.target)} - {None}
        self.cells = Cells(self.space, sorted(names))
        held = Held(problem, pairs)
        self._facets = FacetResiduals(problem, pairs, self._springs, kept)
        self._exerted = ContactResiduals(problem, self.cells)
        self._interiors = Interiors(problem, self._springs, held, kept)
        # what yields under the last displacement; and time, displacement and residuals (all parts together) of the last
        # call, with which a quantity of the same solution begins
        self._found, self._last = {}, None

    def __call__(self, u, time, holding=()):
        """An :class:`Estimate` of the error of a displacement at the end of a load step. `holding`: what holds groups
        that move on average, a list of :class:`pcontact.estimate.loads.Spread`. *Collective.*"""
        space, loads = self.space, [*self._loads, *holding]
        known = self._tested(u, time, loads)
        self._remember(time, known)
        squares = [self._solve(number, known.nodal, time, t, loads) for number, t in enumerate(known.tested)]
        total = sum((s.sum(axis=0) for s in squares), np.zeros(len(PARTS) + 1))
        total = np.sqrt(space.comm.allreduce(total, op=MPI.SUM))
        parts = dict(zip(PARTS, total[:-1].tolist(), strict=True))
        return Estimate(float(total[-1]), self.norm(u), parts, known.surfaces, [np.sqrt(own[:, -1]) for own in squares])

    def _tested(self, u, time, loads):
        """A :class:`Tested`. *Collective.*"""
        nodal, tested, surfaces = self.space.local.gather(u), self._untested(), {}
        self._found = {}
        self._facets.add(nodal, time, tested, self._bulk, loads, self._found)
        for contact in self._contacts:
            states = contact.states(u)
            self._exerted.add(contact, states, tested)
            if contact.contact.formulation == "nitsche":
                surfaces[contact.name] = self._exerted.on_surface(contact, states)
        return Tested(nodal, tested, surfaces)

    def _remember(self, time, known):
        """Keep what a quantity of the same solution begins with, where it is not much."""
        last = [one.sum(axis=1, keepdims=True) for one in known.tested]
        small = sum(one.nbytes for one in last) <= ROOM
        self._last = (time, known.nodal, last) if small else None

    def _tested_before(self, u, time, loads):
        """Displacement and residuals of :meth:`_tested`, the latter as their sum if the last call has had the same
        displacement. *Collective.*"""
        nodal = self.space.local.gather(u)
        same = self._last is not None and self._last[0] == time and np.array_equal(self._last[1], nodal)
        if self.space.comm.allreduce(same, op=MPI.LAND):
            return self._last[1:]
        return self._tested(u, time, loads)[:2]

    def _untested(self):
        """Room for the residuals of every block."""
        def width(block):
            return number_of(block.cell, self.space.degree_of(block)), self.space.dim

        return [np.zeros((len(b.nodes), len(PARTS), *width(b))) for b in self.space.mesh.blocks]

    def weighted(self, u, time, z, goal, holding=((), ()), rules=None):
        """The residual of a dual displacement `z` of a goal, weighted with the error of the displacement `u` that the
        cells know, see `pcontact.estimate.goal`: (nc, 2) of the cells of each block, the second one being the squared
        energy norm of the dual displacement's own error [energy]. *Collective.*

        `holding` is what holds groups that move on average, of both displacements; `rules` those of pairs by which `z`
        has been found, see :func:`pcontact.estimate.goal.rules`.
        """
        own = [*self._loads, *holding[0]]
        nodal, tested = self._tested_before(u, time, own)
        loads = [*([] if goal.load is None else [Given(goal.load, Steady)]), *holding[1]]
        other, against = self.space.local.gather(z), self._untested()
        self._facets.add(other, time, against, self._elastic, loads)
        zero, shifted = self.space.vector(), z.copy()
        if goal.shift is not None:
            shifted.setArray(shifted.getArray(readonly=True) - goal.shift.ravel())
        for contact in self._contacts:
            of = shifted if contact.name == goal.contact else z
            self._exerted.add_dual(contact, u, of, zero, against, rules)
        return [self._solve(number, nodal, time, t, own, Dual(other, against[number], loads))[:, :2]
                for number, t in enumerate(tested)]  # fmt: skip

    def _solve(self, number, nodal, time, tested, own_loads, weight=None):
        """Squared energies (nc, n_parts + 1) of a block's local problems; or, with a :class:`Dual` as weight, their
        energy products with its local problems, and energies of these."""
        space, block, interiors = self.space, self.space.mesh.blocks[number], self._interiors
        out, tables = np.zeros((len(block.nodes), len(PARTS) + 1)), interiors.tables(number)
        for rows, volume in interiors.chunks(number, tables):
            stress = BlockStress(space, self._bulk, number, rows, nodal, self._found)
            loads = tested[rows].copy()
            loads[:, INTERIOR] += interiors.residual(number, rows, volume, tables, stress, time, own_loads)
            functions, moduli = interiors.local(block, volume)
            softer = softening(space, self._bulk, number, rows, nodal, tables.xi)
            bound = self._springs.bound(number, rows, (tables.tests, volume.jxw))
            if weight is None:
                energies(functions, moduli, softer, bound, loads, volume.fixed, out[rows])
                continue
            stress = BlockStress(space, self._elastic, number, rows, weight.nodal)
            others = weight.tested[rows].sum(axis=1)
            others += interiors.residual(number, rows, volume, tables, stress, time, weight.loads)
            products(functions, moduli, softer, bound, loads.sum(axis=1), others, volume.fixed, out[rows])
        return out

    @property
    def _elastic(self):
        """The bodies as if none had yielded."""
        return SimpleNamespace(materials=self._bulk.materials, heat=None)

    def averaged_stress(self, nodal):
        """Stress (nc, nn, d, d) at the nodes of each block's cells, averaged in each body. *Collective.*"""
        return self._facets.recovery(self._bulk, nodal)

    def stiffness(self, block):
        """Share of a jump that the cells of a block take, beside those of others [stress]."""
        return stiffness(self.space, self._bulk, block)

    def norm(self, v):
        """Energy norm of a displacement, that of elasticity. *Collective.*"""
        out = np.zeros((self.space.n_owned, self.space.dim))
        self._bulk.elastic_forces(v, out)
        return self._root(v, out)

    def _root(self, u, out):
        work = float(np.vdot(out, u.getArray(readonly=True)))
        return float(np.sqrt(max(self.space.comm.allreduce(work, op=MPI.SUM), 0.0)))
