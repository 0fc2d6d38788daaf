"""How accurate a displacement is: an estimate of its error in the energy norm, from local problems on every cell.

With u_h the computed displacement, P the traction that contact exerts on the bodies and t = sigma(u_h) n, the error is
driven by residuals: of equilibrium inside cells, f + div sigma; of the traction between cells, which jumps; on the
boundary, what loads prescribe and t does not meet, g - t; on surfaces of contact P - t, in the direction of contact and
across it. These are the residuals of Chouly, Fabre, Hild, Pousin, Renard (2018); there their norms are weighted with
the size of the cell, here each is measured by the elastic displacement that it brings about in the cell (Bank and
Weiser 1985): on every cell K find e in the space of `pcontact.estimate.bubbles` with

    int_K sigma(e) : eps(v) = int_K f . v - sigma(u_h) : eps(v) + int_dK s . v

where s is g on loaded facets, P on surfaces of contact (on the target what the source's points pass on), and between
cells one traction common to both: that of the stress averaged at the nodes. The mean of both sides' own tractions does
as well in the plane, but not on tetrahedra of degree 1, where it makes the estimate three times the error. Where
materials meet, each side has averages of its own, and a side takes of their difference the part that its stiffness is
of the sum of both. No constant is left to choose. What no degree follows is found by problems on all cells around a
vertex, see `pcontact.estimate.singular`. Integration by parts stands in for second derivatives:

    interior   f + div sigma   as   int_K f . v - sigma(u_h) : eps(v) + int_dK t . v
    jumps      s - t           on facets between cells, and both sides of tied surfaces
    neumann    g - t           on the free and loaded boundary
    contact    P - t           along the direction of contact, without friction also across it
    friction   P - t           across it
"""

from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from pcontact.assembly.bulk import ElasticBulk
from pcontact.assembly.patches import Patch
from pcontact.assembly.plastic import NO_RING
from pcontact.assembly.plastic_kernels import CellPoints
from pcontact.contact.law import OPEN, STICK
from pcontact.contact.traction.orthotropic import traction_rows
from pcontact.element.dilatation import components, factors, hoop_operator, linear
from pcontact.element.geometry import facet_geometry, gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_nodes, facet_points
from pcontact.element.shape import shape, shape_gradient
from pcontact.estimate.bubbles import bubbles, number_of, supports
from pcontact.estimate.facets import FacetPairs, facet_rule
from pcontact.estimate.loads import Given
from pcontact.estimate.local import NO_REST, LocalFunctions, Moduli, energies, products, stiffnesses
from pcontact.estimate.points import of_nodes_on_normals, on_normals
from pcontact.estimate.recovery import Recovery
from pcontact.estimate.singular import SingularPoints
from pcontact.estimate.springs import Springs
from pcontact.estimate.stress import BlockStress, own_nodes, turned
from pcontact.estimate.toward import NUMBER, held, inside, rule, side_rule, sides
from pcontact.estimate.tractions import Cells, on_source, on_target, source_facets
from pcontact.estimate.yielding import softening
from pcontact.material.orthotropic import traction_matrix
from pcontact.runtime.petsc import MPI
from pcontact.space.kept import Kept
from pcontact.space.rigid import RigidGroup

PARTS = ("interior", "jumps", "neumann", "contact", "friction")
INTERIOR, JUMPS, NEUMANN, CONTACT, FRICTION = range(len(PARTS))
# [-] Stiffness beside which that of others does not count
TAKES_ALL = 1e12
# numbers per cell and quadrature point in one chunk
CHUNK = 2**21


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
    """What is known of a displacement before any cell is looked at by itself.

    Attributes
    ----------
    nodal : ndarray (n_local, d)
    tested : list of ndarray (nc, n_parts, nb, d)
        Residuals of every block, but for what its cells' interiors add [force].
    surfaces : dict
        See :class:`Estimate`.
    outer : list of (ndarray (n,), ndarray (n, nf, nq, d))
        Of every block cells that have facets on the boundary, and g - t of all but contact there [stress].
    pressed : list of ndarray (nc,) of bool
        Cells of every block on which contact acts.
    """

    nodal: np.ndarray
    tested: list
    surfaces: dict
    outer: list
    pressed: list


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


class Volume(NamedTuple):
    """Some cells of a block at the points of the local problems.

    Attributes
    ----------
    grad, test : ndarray (n, nq, nn, d)
        Gradients of the shape functions and of the tests [1/length].
    jxw : ndarray (n, nq)
        Weights, with axial symmetry times 2 pi r.
    ring : ndarray (n, nq, nb)
        Tests over r with axial symmetry [1/length], else empty.
    radius : ndarray (n, nq) or None
    places : ndarray (n, nq, d)
        The points [length].
    fixed : ndarray (n, nb, d) or None
        Components of tests that supports hold.
    """

    grad: np.ndarray
    test: np.ndarray
    jxw: np.ndarray
    ring: np.ndarray
    radius: np.ndarray | None
    places: np.ndarray
    fixed: np.ndarray | None


class Steady:
    """The amplitude of a dual load."""

    @staticmethod
    def factor(_):
        """1."""
        return 1.0


def volume_rule(cell, geometry_degree, degree, axisymmetric):
    """Quadrature that integrates the energy of the test functions."""
    simplex = not CELLS[cell].is_tensor
    return quadrature(cell, 2 * degree + 2 * (geometry_degree - 1) * simplex + (2 - 2 * simplex) + 2 * axisymmetric)


class Estimator:
    """Estimates the error of displacements of one problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    loads : list of pcontact.estimate.loads.Given or pcontact.estimate.loads.Spread

    Notes
    -----
    The constructor is *Collective*, and so are the calls.
    """

    def __init__(self, problem, loads):
        self.problem, self.space, self._loads = problem, problem.space, loads
        self.bulk, self.contacts = problem.bulk, problem.contacts
        self._springs = Springs(problem)
        # test functions of a block's cells at all points of their facets; what yields under the last displacement
        self._on_facets, self._found, self._kept = {}, {}, Kept()
        # what moves as a rigid body is as much held as what is prescribed
        self._held = problem.supports.fixed.copy()
        for group in problem.groups:
            if isinstance(group, RigidGroup):
                self._held[group.nodes] = True
        self._pairs = FacetPairs(self.space)
        self._recovery = Recovery(self.space)
        pairs = [pair.contact for contact in self.contacts for pair in contact.pairs]
        names = {name for one in pairs for name in (one.source, one.target)} - {None}
        self.cells = Cells(self.space, sorted(names))
        self._kind = self._kinds()
        # time, displacement and residuals (all parts together) of the last call, with which a quantity of the same
        # solution begins
        self._last = None
        self._singular = SingularPoints(self.space, self._pairs, set(getattr(self.bulk, "states", {})))

    # -- set-up ---------------------------------------------------------------------------------------------------

    def _kinds(self):
        """For each block, whose residual (normal, tangential) a facet's is, as parts (nc, nf, 2); -1: none."""
        space, result = self.space, []
        for block in space.mesh.blocks:
            result.append(np.full((len(block.nodes), len(CELLS[block.cell].facets), 2), NEUMANN, dtype=np.int64))
        for contact in self.contacts:
            for pair in contact.pairs:
                for name in (pair.contact.source, pair.contact.target):
                    facets = source_facets(space, name) if name is not None else np.zeros((0, 3), np.int64)
                    for number in np.unique(facets[:, 0]):
                        _, cells, local = facets[facets[:, 0] == number].T
                        result[number][cells, local] = self._parts_of(contact)
        return result

    @staticmethod
    def _parts_of(contact):
        """Parts of the residual along and across the direction of contact."""
        if contact.law.tied:
            return JUMPS, JUMPS
        return (CONTACT, FRICTION) if contact.law.tangential else (CONTACT, CONTACT)

    # -- residuals ------------------------------------------------------------------------------------------------

    def __call__(self, u, time, holding=()):
        """Estimate the error of a displacement at the end of a load step. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        time : float
        holding : list of pcontact.estimate.loads.Spread
            What holds groups that move on average.

        Returns
        -------
        Estimate
        """
        space, loads = self.space, [*self._loads, *holding]
        known = self._tested(u, time, loads)
        self._last = time, known.nodal, [one.sum(axis=1, keepdims=True) for one in known.tested]
        squares = [self._solve(number, known.nodal, time, t, loads) for number, t in enumerate(known.tested)]
        whole = [own[:, -1] for own in squares]
        self._singular.improve(whole, lambda *some: self._around(known, time, loads, *some))
        total = sum((s.sum(axis=0) for s in squares), np.zeros(len(PARTS) + 1))
        total = np.sqrt(space.comm.allreduce(total, op=MPI.SUM))
        parts = dict(zip(PARTS, total[:-1].tolist(), strict=True))
        return Estimate(float(total[-1]), self.norm(u), parts, known.surfaces, [np.sqrt(own) for own in whole])

    def _tested(self, u, time, loads):
        """A :class:`Tested`. *Collective.*"""
        nodal, tested, surfaces = self.space.local.gather(u), self._untested(), {}
        self._found = {}
        outer = self._add_facets(nodal, time, tested, self.bulk, loads)
        pressed = [np.zeros(len(block.nodes), dtype=bool) for block in self.space.mesh.blocks]
        for contact in self.contacts:
            states = contact.states(u)
            self._add_contact(contact, states, tested, pressed)
            if contact.contact.formulation == "nitsche":
                surfaces[contact.name] = self._on_surface(contact, states)
        return Tested(nodal, tested, surfaces, outer, pressed)

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
        return [np.zeros((len(b.nodes), len(PARTS), *self._width(b))) for b in self.space.mesh.blocks]

    def weighted(self, u, time, z, goal, holding=((), ())):
        """The residual of a dual displacement, weighted with the error of the displacement that the cells know, see
        `pcontact.estimate.goal`. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        time : float
        z : PETSc.Vec
        goal : pcontact.estimate.goal.Goal
        holding : (list, list) of pcontact.estimate.loads.Spread
            What holds groups that move on average, of both displacements.

        Returns
        -------
        list of ndarray (nc,)
            Of the cells of each block [energy].
        """
        own = [*self._loads, *holding[0]]
        nodal, tested = self._tested_before(u, time, own)
        loads = [*([] if goal.load is None else [Given(goal.load, Steady)]), *holding[1]]
        other, against = self.space.local.gather(z), self._untested()
        self._add_facets(other, time, against, self._elastic, loads)
        zero, shifted = self.space.vector(), z.copy()
        if goal.shift is not None:
            shifted.setArray(shifted.getArray(readonly=True) - goal.shift.ravel())
        for contact in self.contacts:
            self._add_dual_contact(contact, shifted if contact.name == goal.contact else z, zero, against)
        return [
            self._solve(number, nodal, time, t, own, Dual(other, against[number], loads))[:, 0]
            for number, t in enumerate(tested)
        ]

    @property
    def _elastic(self):
        """The bodies as if none had yielded."""
        return SimpleNamespace(constants=self.bulk.constants, orthotropic=self.bulk.orthotropic, heat=None)

    def averaged_stress(self, nodal):
        """Stress (nc, nn, d, d) at the nodes of each block's cells, averaged in each body. *Collective.*"""
        return self._recovery(self.bulk, nodal)

    def _width(self, block):
        return number_of(block.cell, self.space.degree_of(block)), self.space.dim

    def norm(self, v):
        """Energy norm of a displacement, that of elasticity. *Collective.*"""
        out = np.zeros((self.space.n_owned, self.space.dim))
        ElasticBulk.residual(self.bulk, v, out)
        return self._root(v, out)

    def _root(self, u, out):
        work = float(np.vdot(out, u.getArray(readonly=True)))
        return float(np.sqrt(max(self.space.comm.allreduce(work, op=MPI.SUM), 0.0)))

    def _parts(self, number, points):
        """Chunks of a block's cells."""
        n, size = len(self.space.mesh.blocks[number].nodes), max(CHUNK // points, 1)
        return [slice(first, min(first + size, n)) for first in range(0, n, size)]

    def _tractions(self, number, nodal, bulk):
        """sigma n (nc, nf, nq, d) and quadrature weights (nc, nf, nq), normals (nc, nf, nq, d) of a block's facets."""
        space, mesh = self.space, self.space.mesh
        block = mesh.blocks[number]
        table, geometry_degree = mesh.geometry_nodes(block)
        xi, weights = facet_rule(block.cell, space.degree)
        on_cell = facet_points(block.cell, xi)
        shape_ = len(block.nodes), len(on_cell), len(weights)
        traction, normal, jxw = np.empty((*shape_, mesh.dim)), np.empty((*shape_, mesh.dim)), np.empty(shape_)
        degree = space.degree_of(block)
        for rows in self._parts(number, len(weights) * space.cells[number].shape[1] * mesh.dim):
            x = np.ascontiguousarray(mesh.points[table[rows]])
            stress = BlockStress(space, bulk, number, rows, nodal, self._found_by(bulk))
            for f, at_xi in enumerate(on_cell):
                local = np.full(len(x), f, dtype=np.int64)
                make = partial(facet_geometry, block.cell, x, local, geometry_degree, degree, xi, weights)
                at = self._kept(("facets", number, rows.start, f), make)
                radius = at.points[:, :, 0] if space.axisymmetric else None
                sigma, _ = stress(at.gradients, shape(block.cell, degree, at_xi), radius, at_xi)
                on_normals(sigma, at.normals, traction[rows, f])
                normal[rows, f] = at.normals
                jxw[rows, f] = at.jxw * space.circumference(at.points)
        return traction, normal, jxw

    def _found_by(self, bulk):
        """What has been found of the cells that yield under the last displacement; None for another bulk."""
        return self._found if bulk is self.bulk else None

    def _add_facets(self, nodal, time, tested, bulk, loads):
        """Residuals of all facets but for the tractions of contact; returns `outer` of :class:`Tested`.
        *Collective.*"""
        space, mesh, result = self.space, self.space.mesh, []
        own = [self._tractions(number, nodal, bulk) for number in range(len(mesh.blocks))]
        stiffness = [self.stiffness(block) for block in mesh.blocks]
        flat, width = [], max([0, *(t.shape[2] * t.shape[3] for t, _, _ in own)])
        width = space.comm.allreduce(width, op=MPI.MAX)
        flux = self._flux(nodal, own, bulk)
        for number in range(len(own)):
            values = self._pairs.canonical(number, flux[number])
            table = np.zeros((values.shape[0] * values.shape[1], width + 1))
            table[:, 0] = stiffness[number]
            n = values.shape[2] * values.shape[3]
            table[:, 1 : 1 + n] = values.reshape(len(table), n)
            flat.append(table)
        other = self._pairs.other_side(np.concatenate([np.zeros((0, width + 1)), *flat]))
        for number, (traction, normal, jxw) in enumerate(own):
            first, last = self._pairs.first[number : number + 2]
            n = traction.shape[2] * traction.shape[3]
            theirs = other[first:last, 1 : 1 + n].reshape(traction.shape)
            theirs = self._pairs.canonical(number, theirs, back=True)
            inner = self._pairs.inner[first:last].reshape(traction.shape[:2])
            share = stiffness[number] / (stiffness[number] + other[first:last, 0])
            share = share.reshape(inner.shape)[:, :, None, None]
            jump = ((1.0 - share) * flux[number] - share * theirs - traction) * inner[:, :, None, None]
            outer = self._outer(number, time, traction, normal, inner, loads)
            self._springs.add(number, nodal, outer, traction, normal)
            self._test(number, traction, jump, outer, jxw, tested[number])
            rows, parts = outer
            result.append((rows, sum(parts.values(), np.zeros_like(traction[rows]))))
        return result

    def stiffness(self, block):
        """What share of a jump the cells of a block take, beside those of others [stress]."""
        lam, mu = self.bulk.constants[block.body]
        # the functions that are missing where cells of both degrees meet are those of the lower one
        return (lam + 2.0 * mu) * (TAKES_ALL if self.space.degree_of(block) < self.space.degree else 1.0)

    def _flux(self, nodal, own, bulk):
        """Traction (nc, nf, nq, d) of the averaged stress at each block's facets. *Collective.*"""
        result = []
        for number, sigma in enumerate(self._recovery(bulk, nodal, self._found_by(bulk))):
            block = self.space.mesh.blocks[number]
            points = facet_points(block.cell, facet_rule(block.cell, self.space.degree)[0])
            values = shape(block.cell, self.space.degree_of(block), points.reshape(-1, self.space.dim))
            normals = own[number][1]
            flat = normals.reshape(len(normals), len(values), self.space.dim)
            found = np.empty_like(flat)
            of_nodes_on_normals(values, np.ascontiguousarray(sigma), flat, found)
            result.append(found.reshape(normals.shape))
        return result

    def _outer(self, number, time, traction, normal, inner, loads):
        """Residual g - t of the facets on the boundary: cells (n,) that have some, and by parts (n, nf, nq, d)."""
        space, touched, result = self.space, ~inner.all(axis=1), {}
        loaded = [
            (load, facets) for load in loads if load.on_facets
            for facets in space.mesh.facet_groups.get(load.region, []) if facets.block == number and len(facets.cells)
        ]  # fmt: skip
        sprung = (cells for _, cells, _ in self._springs.facets(number))
        for cells in (*(facets.cells for _, facets in loaded), *sprung):
            touched[cells] = True
        rows = np.flatnonzero(touched)
        traction, normal, outside = traction[rows], normal[rows], ~inner[rows]
        along = np.sum(traction * normal, axis=3, keepdims=True) * normal
        for k, value in ((0, -along), (1, along - traction)):
            for part in (JUMPS, NEUMANN, CONTACT, FRICTION):
                on = (self._kind[number][rows, :, k] == part) & outside
                if on.any():
                    result[part] = result.get(part, 0.0) + value * on[:, :, None, None]
        for load, facets in loaded:
            where, body = (np.searchsorted(rows, facets.cells), facets.local), space.mesh.blocks[number].body
            value = self._density(load, self._places(number, facets.cells, facets.local), normal[where], body, time)
            result.setdefault(NEUMANN, np.zeros_like(traction))[where] += value
        return rows, result

    def _places(self, number, cells, local):
        """Points (n, nq, d) of facets of a block [length]."""
        mesh, block = self.space.mesh, self.space.mesh.blocks[number]
        table, geometry_degree = mesh.geometry_nodes(block)
        points = facet_points(block.cell, facet_rule(block.cell, self.space.degree)[0])
        values = np.stack([shape(block.cell, geometry_degree, at) for at in points])
        return np.einsum("fqa,fad->fqd", values[local], mesh.points[table[cells]])

    def _density(self, load, points, normals, body, time):
        """Force (n, nq, d) of a load per area or volume; where it is not finite the run has said so."""
        none = np.zeros((len(points), 0), dtype=np.int64)
        patch = Patch(none, np.zeros((*points.shape[:2], 0)), np.zeros(points.shape[:2]), points, normals, body)
        return load.factor(time) * load.density(self.space, patch, time)

    def _test(self, number, traction, jump, outer, jxw, tested):
        """Test the residuals of a block's facets with the functions on them."""
        block = self.space.mesh.blocks[number]
        points = facet_points(block.cell, facet_rule(block.cell, self.space.degree)[0])
        if number not in self._on_facets:
            self._on_facets[number] = np.concatenate([self._tests(number, at) for at in points])
        values, (rows, outer) = self._on_facets[number], outer
        for part, residual in ((INTERIOR, traction), (JUMPS, jump)):
            tested[:, part] += _integrals(values, residual, jxw)
        for part, residual in outer.items():
            tested[rows, part] += _integrals(values, residual, jxw[rows])

    def _tests(self, number, xi):
        """Test functions (n, nb) of a block at reference points (n, d)."""
        block = self.space.mesh.blocks[number]
        return bubbles(block.cell, self.space.degree_of(block), xi)[0]

    def _add_contact(self, contact, states, tested, pressed):
        """Tractions of contact, and flags of the cells that they press. *Collective.*"""
        normal_part, across_part = self._parts_of(contact)
        for pair, state in zip(contact.pairs, states, strict=True):
            sides = [on_source(self.space, pair, state)]
            if not pair.rigid:
                sides.append(on_target(self.space, pair, state, self.cells, contact.weight))
            for number, forces in ((n, f) for side in sides for n, f in side.items()):
                pressed[number][forces.rows[forces.force.any(axis=1)]] = True
                values = self._tests(number, forces.xi)
                along = np.sum(forces.force * forces.normal, axis=1)[:, None] * forces.normal
                for part, force in ((normal_part, along), (across_part, forces.force - along)):
                    np.add.at(tested[number], (forces.rows, part), values[:, :, None] * force[:, None, :])

    def _add_dual_contact(self, contact, z, zero, tested):
        """What contact exerts on a dual displacement. *Collective.*

        With D the derivative of the law, the tangent has the terms  - int theta t(w) . G^-1 t(z)  and
        - int D(t(w) - G [[w]]) . G^-1 (G [[z]] - theta t(z))  for a displacement w. Tests of cells are no displacements
        of the space: that their tractions t(w) meet a [[z]] which is not zero where surfaces are closed, counts.
        """
        for pair, state, rest in zip(contact.pairs, contact.states(z), contact.states(zero), strict=True):
            closed, normal = (pair.committed > OPEN) & state["paired"], state["normal"]
            theta, gamma = pair.method.theta, pair.gamma_points
            own = state["normal_stress"] - rest["normal_stress"]
            jump = np.where(state["paired"], rest["gap"] - state["gap"], 0.0)
            across = np.where(closed, jump - theta * own / gamma, 0.0)
            traction, weight = -gamma * across, across + theta * own / gamma
            traction, weight = traction[:, None] * normal, weight[:, None] * normal
            if "slip" in state:
                stick = (closed & (pair.committed == STICK))[:, None]
                gamma = pair.method.alpha * gamma[:, None]
                own = _along(state["own_traction"] - rest["own_traction"], normal)
                across = np.where(stick, _along(state["slip"] - rest["slip"], normal) - theta * own / gamma, 0.0)
                traction, weight = traction - gamma * across, weight + across + theta * own / gamma
            forces = {"traction": traction, "weight": state["weight"]}
            sides = [on_source(self.space, pair, forces)]
            if not pair.rigid:
                sides.append(on_target(self.space, pair, forces, self.cells, contact.weight))
            for number, one in ((n, f) for side in sides for n, f in side.items()):
                values = self._tests(number, one.xi)
                np.add.at(tested[number], (one.rows, CONTACT), values[:, :, None] * one.force[:, None, :])
            weighted = {"traction": weight, "weight": state["weight"]}
            for number, one in on_source(self.space, pair, weighted).items():
                np.add.at(tested[number], (one.rows, CONTACT), self._stresses(number, one))

    def _stresses(self, number, points):
        """Work (n, nb, d) of the stresses of the test functions of cells on vectors at points of their facets."""
        mesh, block = self.space.mesh, self.space.mesh.blocks[number]
        degree = self.space.degree_of(block)
        (lam, mu), vector, normal = self.bulk.constants[block.body], points.force, points.normal
        lam = factors(lam, mu, self.space.averages(block), degree)[0]
        table, geometry_degree = mesh.geometry_nodes(block)
        x, geo = mesh.points[table[points.rows]], shape_gradient(block.cell, geometry_degree, points.xi)
        values, slopes = bubbles(block.cell, degree, points.xi)
        slopes = np.matmul(slopes, np.linalg.inv(np.einsum("nad,nae->nde", x, geo)))
        dot = np.sum(vector * normal, axis=1)
        work = lam * dot[:, None, None] * slopes
        work += mu * np.einsum("nbd,nd->nb", slopes, normal)[:, :, None] * vector[:, None]
        work += mu * np.einsum("nbd,nd->nb", slopes, vector)[:, :, None] * normal[:, None]
        if self.space.axisymmetric:
            radius = np.einsum("na,na->n", shape(block.cell, geometry_degree, points.xi), x[:, :, 0])
            work[:, :, 0] += (lam * dot / radius)[:, None] * values
        law = self.bulk.orthotropic.get(block.body)
        if law is not None:
            ring = (values / radius[:, None])[:, None] if self.space.axisymmetric else NO_RING
            at = np.einsum("na,nad->nd", shape(block.cell, geometry_degree, points.xi), x)
            rows = np.empty((*slopes.shape, slopes.shape[2]))
            some = CellPoints(np.zeros((0, 0), np.int64), np.ascontiguousarray(slopes[:, None]), ring)
            traction_rows(some, law.deviation(at[:1] if law.uniform else at), traction_matrix(normal), rows)
            work += np.einsum("ni,nbij->nbj", vector, rows)
        return work

    def _on_surface(self, contact, states):
        """The residual P - t of a pair, weighted; see :class:`Estimate`. *Collective.*"""
        sums = np.zeros(2)
        for pair, state in zip(contact.pairs, states, strict=True):
            source, normal = pair.source, pair.pairing.normal
            weight = state["weight"] / source.trace[source.facet]
            sums[0] += weight @ (state["pressure"] + state["normal_stress"]) ** 2
            if "own_traction" in state:
                rest = state["traction"] - state["own_traction"]
                sums[1] += weight @ (np.sum(rest**2, axis=1) - np.sum(rest * normal, axis=1) ** 2)
        contact, friction = np.sqrt(np.maximum(self.space.comm.allreduce(sums, op=MPI.SUM), 0.0)).tolist()
        return {"contact": contact, "friction": friction}

    # -- local problems -------------------------------------------------------------------------------------------

    def _fixed(self, number, rows):
        """Components (n, nb, d) of test functions that supports hold."""
        block = self.space.mesh.blocks[number]
        on = supports(block.cell, self.space.degree_of(block))
        return np.einsum("bf,cfi->cbi", on.astype(float), self._fixed_facets(number, rows).astype(float)) > 0.5

    def _fixed_facets(self, number, rows):
        """Components (n, nf, d) of the displacement of facets that supports hold."""
        space, block = self.space, self.space.mesh.blocks[number]
        held, degree = self._held[own_nodes(space, number)[rows]], space.degree_of(block)
        first, last = self._pairs.first[number : number + 2]
        outer = ~self._pairs.inner[first:last].reshape(len(block.nodes), -1)[rows]
        facets = held[:, facet_nodes(block.cell, degree)].all(axis=2)
        return facets & (outer[:, :, None] | held.all(axis=1)[:, None, :])

    def _solve(self, number, nodal, time, tested, own_loads, weight=None):
        """Squared energies (nc, n_parts + 1) of a block's local problems; or, with a :class:`Dual` as weight, their
        energy products (nc, 1) with its local problems."""
        space, block = self.space, self.space.mesh.blocks[number]
        degree, geometry_degree = space.degree_of(block), space.mesh.geometry_nodes(block)[1]
        xi, weights = volume_rule(block.cell, geometry_degree, degree, space.axisymmetric)
        dshape = np.ascontiguousarray(shape_gradient(block.cell, degree, xi))
        tests, dtests = bubbles(block.cell, degree, xi)
        at = xi, shape(block.cell, degree, xi), tests
        out = np.zeros((len(block.nodes), len(PARTS) + 1))
        for rows in self._parts(number, dtests.size + dshape.size):
            make = partial(self._volume, number, rows, (xi, weights, dshape, tests, np.ascontiguousarray(dtests)))
            volume = self._kept(("cells", number, rows.start), make)
            stress = BlockStress(space, self.bulk, number, rows, nodal, self._found)
            loads = tested[rows].copy()
            loads[:, INTERIOR] += self._inside(number, rows, volume, at, stress, time, own_loads)
            functions, moduli = self._local(block, volume)
            softer = softening(space, self.bulk, number, rows, nodal, xi)
            bound = self._springs.bound(number, rows, (tests, volume.jxw))
            if weight is None:
                energies(functions, moduli, softer, bound, loads, volume.fixed, out[rows])
                continue
            stress = BlockStress(space, self._elastic, number, rows, weight.nodal)
            others = weight.tested[rows].sum(axis=1)
            others += self._inside(number, rows, volume, at, stress, time, weight.loads)
            products(functions, moduli, softer, bound, loads.sum(axis=1), others, volume.fixed, out[rows, 0])
        return out if weight is None else out[:, :1]

    def _local(self, block, volume):
        """Test functions and moduli of the local problems of some cells of a block."""
        (lam, mu), degree = self.bulk.constants[block.body], self.space.degree_of(block)
        averaged = self.space.averages(block)
        basis = np.zeros((0, 0, 0))
        if averaged:
            basis = components(volume.jxw, volume.places if linear(block.cell, degree) else None)[0]
        functions = LocalFunctions(volume.test, volume.ring, volume.jxw, basis)
        return functions, Moduli(*factors(lam, mu, averaged, degree), mu, self._rest(block, volume.places))

    def _inside(self, number, rows, volume, at, stress, time, loads):
        """What the interiors of some cells of a block add to their residuals (n, nb, d): with reference points, shape
        functions and tests there, and the stress."""
        xi, values, tests = at
        result = -_work(*stress(volume.grad, values, volume.radius, xi), volume.test, volume.ring, volume.jxw)
        force = self._body_force(number, rows, volume.places, time, loads, (values, stress.u))
        if force is not None:
            result += np.einsum("cq,qb,cqd->cbd", volume.jxw, tests, force)
        return result

    def _around(self, known, time, loads, number, rows, corners, half):
        """Stiffness, what springs add, residuals and what is held of the functions around corners of some cells, see
        :class:`pcontact.estimate.singular.Around`.

        Parameters
        ----------
        known : Tested
        time : float
        loads : list
        number : int
            Block.
        rows, corners : ndarray (n,) of int
            Cells, and which corner of each.
        half : int
            Which of their triangles there, see `pcontact.estimate.toward.n_halves`.
        """
        block = self.space.mesh.blocks[number]
        (xi, weights), (tests, dtests) = rule(block.cell, half), inside(block.cell, half)
        degree, size = self.space.degree_of(block), NUMBER * self.space.dim
        dshape, values = shape_gradient(block.cell, degree, xi), shape(block.cell, degree, xi)
        volume = self._volume(number, rows, (xi, weights, np.ascontiguousarray(dshape), tests, dtests), corners)
        stiffness = np.empty((len(rows), size, size))
        stiffnesses(*self._local(block, volume), stiffness)
        bound = self._springs.around(number, rows, corners, half, (tests, volume.jxw))
        stress = BlockStress(self.space, self.bulk, number, rows, known.nodal, corners=corners)
        tested = self._inside(number, rows, volume, (xi, values, tests), stress, time, loads)
        self._add_sides(known, number, rows, corners, half, tested)
        # displacements that contact admits
        pressed = (self._kind[number][rows, :, 0] != NEUMANN) & known.pressed[number][rows, None]
        fixed, every = self._fixed_facets(number, rows) | pressed[:, :, None], np.arange(len(rows))
        on_sides = np.zeros((len(rows), 2, self.space.dim), dtype=bool)
        vertex = self._held[self.space.cells[number][rows, corners]]
        for side, facet in sides(block.cell, half):
            facets = (corners + facet) % fixed.shape[1]
            on_sides[:, side] = fixed[every, facets]
            vertex |= pressed[every, facets][:, None]
        return stiffness, bound, tested.reshape(len(rows), size), held(vertex, on_sides).reshape(len(rows), size)

    def _add_sides(self, known, number, rows, corners, half, tested):
        """Add what acts on outer facets beside contact, tested with the functions around corners: with a rule of their
        own, as g is large where the residual is small."""
        space, block = self.space, self.space.mesh.blocks[number]
        table, geometry_degree = space.mesh.geometry_nodes(block)
        degree, (first, last) = space.degree_of(block), self._pairs.first[number : number + 2]
        inner, (touched, rest) = self._pairs.inner[first:last].reshape(len(block.nodes), -1), known.outer[number]
        for side, facet in sides(block.cell, half):
            xi, weights, tests = side_rule(side)
            outer = np.flatnonzero(~inner[rows, (corners + facet) % inner.shape[1]])
            cells, corner = rows[outer], corners[outer]
            x, local = space.mesh.points[turned(table[cells], corner)], np.full(len(cells), facet)
            at = facet_geometry(block.cell, x, local, geometry_degree, degree, xi, weights)
            at_xi = facet_points(block.cell, xi)[facet]
            radius = at.points[:, :, 0] if space.axisymmetric else None
            stress = BlockStress(space, self.bulk, number, cells, known.nodal, corners=corner)
            sigma, _ = stress(at.gradients, shape(block.cell, degree, at_xi), radius, at_xi)
            force = np.matmul(sigma, at.normals[:, :, :, None])[:, :, :, 0]
            # g - t is known at the points of the facets' own rule
            force += _through(facet_rule(block.cell, space.degree)[0], xi) @ rest[
                np.searchsorted(touched, cells), (corner + facet) % inner.shape[1]]  # fmt: skip
            force *= (at.jxw * space.circumference(at.points))[:, :, None]
            tested[outer] += np.matmul(tests.T, force)

    def _volume(self, number, rows, tables, corners=None):
        """A :class:`Volume`, from points and weights, gradients of the shape functions, tests and their gradients; with
        corners (n,) of the plane cells that count as the first, without what is fixed."""
        space, block, (xi, weights, dshape, tests, dtests) = self.space, self.space.mesh.blocks[number], tables
        table, geometry_degree = space.mesh.geometry_nodes(block)
        dgeo = np.ascontiguousarray(shape_gradient(block.cell, geometry_degree, xi))
        x = np.ascontiguousarray(space.mesh.points[turned(table[rows], corners)])
        places, jxw, radius = shape(block.cell, geometry_degree, xi) @ x, np.empty((len(x), len(weights))), None
        grad, test = np.empty((len(x), *dshape.shape)), np.empty((len(x), *dtests.shape))
        gradients(x, dgeo, dshape, weights, grad, jxw)
        gradients(x, dgeo, dtests, weights, test, jxw)
        ring = np.zeros((0, 0, 0))
        if space.axisymmetric:
            radius = np.ascontiguousarray(places[:, :, 0])
            jxw *= 2.0 * np.pi * radius
            ring = np.ascontiguousarray(hoop_operator(tests, radius))
        fixed = self._fixed(number, rows) if corners is None else None
        return Volume(grad, test, jxw, ring, radius, places, fixed)

    def _rest(self, block, points):
        """What the stiffness of a block differs by from the isotropic one at points (nc, nq, d)."""
        law = self.bulk.orthotropic.get(block.body)
        if law is None:
            return NO_REST
        points = points.reshape(-1, points.shape[2])
        return law.deviation(points[:1] if law.uniform else points)

    def _body_force(self, number, rows, points, time, loads, displacement):
        """Force density at points (n, nq, d) of some of a block's cells, None where there is none in the block, at a
        displacement: shape functions (nq, nn) and values at the nodes of the cells (n, nn, d)."""
        block = self.space.mesh.blocks[number]
        total = self._springs.force(number, rows, *displacement)
        for load in loads:
            groups = self.space.mesh.cell_groups.get(load.region, []) if not load.on_facets else []
            if number < len(groups) and len(groups[number]):
                chosen = np.zeros(len(block.nodes), dtype=bool)
                chosen[groups[number]] = True
                total, own = np.zeros(points.shape) if total is None else total, chosen[rows]
                total[own] += self._density(load, points[own], None, block.body, time)
        return total


def _through(points, others):
    """Values (n, k) at others (n, 1) of the polynomials that are 1 at one of the points (k, 1), 0 at the rest."""
    count = len(points)
    return np.vander(others[:, 0], count) @ np.linalg.inv(np.vander(points[:, 0], count))


def _integrals(values, residual, jxw):
    """int residual . v (nc, nb, d) over all facets of cells, for test functions of values (nf nq, nb)."""
    (n, nb), nc, d = values.shape, len(jxw), residual.shape[3]
    weighted = (jxw[:, :, :, None] * residual).reshape(nc, n, d)
    flat = np.ascontiguousarray(weighted.transpose(0, 2, 1)).reshape(nc * d, n)
    return (flat @ values).reshape(nc, d, nb).transpose(0, 2, 1)


def _along(vectors, normal):
    """Tangential part (np, d) of vectors."""
    return vectors - np.sum(vectors * normal, axis=1, keepdims=True) * normal


def _work(sigma, around, test, ring, jxw):
    """int sigma : eps(v) (nc, nb, d) for all test functions."""
    nc, nq, nb, d = test.shape
    weighted = (jxw[:, :, None, None] * sigma).transpose(0, 1, 3, 2).reshape(nc, nq * d, d)
    work = np.matmul(test.transpose(0, 2, 1, 3).reshape(nc, nb, nq * d), weighted)
    if around is not None:
        work[:, :, 0] += np.einsum("cq,cq,cqb->cb", jxw, around, ring)
    return work
