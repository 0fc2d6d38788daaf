"""What contact exerts on the bodies, in the residuals of their cells."""

import numpy as np

from pcontact.assembly.item import LAW
from pcontact.assembly.strains import cell_points
from pcontact.contact.traction.small import FacetPoints, traction_rows
from pcontact.element.dilatation import factors
from pcontact.element.shape import shape, shape_gradient
from pcontact.estimate.bubbles import bubbles
from pcontact.estimate.points import CONTACT, add_at
from pcontact.estimate.residuals import parts_of, tests_of
from pcontact.estimate.tractions import on_source, on_target
from pcontact.material.elastic import isotropic
from pcontact.material.orthotropic import traction_matrix
from pcontact.runtime.petsc import MPI


class ContactResiduals:
    """Tractions of the contacts of one problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    cells : pcontact.estimate.tractions.Cells
        Of the surfaces of contact.
    """

    def __init__(self, problem, cells):
        self._space, self._bulk, self._cells = problem.space, problem.bulk, cells

    def add(self, contact, states, tested, pressed):
        """Add the tractions of a contact. *Collective.*

        Parameters
        ----------
        contact : pcontact.contact.report.ContactReport
        states : list of dict
            Of its pairs.
        tested : list of ndarray (nc, n_parts, nb, d)
            Residuals of every block [force]; changed.
        pressed : list of ndarray (nc,) of bool
            Cells of every block on which contact acts; changed.
        """
        normal_part, across_part = parts_of(contact)
        for pair, state in zip(contact.pairs, states, strict=True):
            sides = [on_source(self._space, pair, state)]
            if not pair.rigid:
                sides.append(on_target(self._space, pair, state, self._cells, contact.weight))
            for number, forces in ((n, f) for side in sides for n, f in side.items()):
                pressed[number][forces.rows[forces.force.any(axis=1)]] = True
                values = tests_of(self._space, number, forces.xi)
                along = np.sum(forces.force * forces.normal, axis=1)[:, None] * forces.normal
                for part, force in ((normal_part, along), (across_part, forces.force - along)):
                    add_at(forces.rows, part, values[:, :, None] * force[:, None, :], tested[number])

    def add_dual(self, contact, u, z, zero, tested, rules=None):
        """What contact exerts on a dual displacement. *Collective.*

        With D the derivative of the law at the displacement u, or by the rules that some pairs have, the tangent has
        the terms  - int theta t(w) . G^-1 t(z)  and  - int D (t(w) - G [[w]]) . G^-1 (G [[z]] - theta t(z))  for a
        displacement w. Tests of cells are no displacements of the space: that their tractions t(w) meet a [[z]] which
        is not zero where surfaces are closed, counts. Where they slip, D has the friction that follows the pressure: a
        [[z]] along the slip, which nothing keeps small, meets the pressure of w.
        """
        for pair, state, rest in zip(contact.pairs, contact.states(z), contact.states(zero), strict=True):
            normal, theta, gamma = state["normal"], pair.method.theta, pair.method.gamma
            alpha = pair.method.alpha
            jump = np.where(state["paired"], rest["gap"] - state["gap"], 0.0)[:, None] * normal
            own = (state["normal_stress"] - rest["normal_stress"])[:, None] * normal
            if "slip" in state:
                jump += _along(state["slip"] - rest["slip"], normal)
                own += _along(state["own_traction"] - rest["own_traction"], normal)
            own = _scaled(own, normal, theta / gamma, theta / (alpha * gamma))
            across = np.einsum("pij,pi->pj", pair.derivative(u, (rules or {}).get(pair, LAW)), jump - own)
            forces = {"traction": -_scaled(across, normal, gamma, alpha * gamma), "weight": state["weight"]}
            sides = [on_source(self._space, pair, forces)]
            if not pair.rigid:
                sides.append(on_target(self._space, pair, forces, self._cells, contact.weight))
            for number, one in ((n, f) for side in sides for n, f in side.items()):
                values = tests_of(self._space, number, one.xi)
                add_at(one.rows, CONTACT, values[:, :, None] * one.force[:, None, :], tested[number])
            tests, parts = across + own, pair.terms.traction.weighted
            first = tests if parts is None else parts.own[:, None] * tests
            sides = [on_source(self._space, pair, {**forces, "traction": first})]
            if parts is not None:
                second = {**forces, "traction": -parts.other[:, None] * tests}
                sides.append(on_target(self._space, pair, second, self._cells, contact.weight, parts.normal))
            for number, one in ((n, f) for side in sides for n, f in side.items()):
                add_at(one.rows, CONTACT, self._stresses(number, one), tested[number])

    def _stresses(self, number, points):
        """Work (n, nb, d) of the stresses of the test functions of cells on vectors at points of their facets."""
        mesh, block = self._space.mesh, self._space.mesh.blocks[number]
        degree = self._space.degree_of(block)
        law, vector, normal = self._bulk.materials[block.body], points.force, points.normal
        table, geometry_degree = mesh.geometry_nodes(block)
        x, geo = mesh.points[table[points.rows]], shape_gradient(block.cell, geometry_degree, points.xi)
        values, slopes = bubbles(block.cell, degree, points.xi)
        slopes = np.matmul(slopes, np.linalg.inv(np.einsum("nad,nae->nde", x, geo)))
        at = np.einsum("na,nad->nd", shape(block.cell, geometry_degree, points.xi), x)
        ring = (values / at[:, :1])[:, None] if self._space.axisymmetric else None
        cells = cell_points(np.zeros((0, 0), np.int64), np.ascontiguousarray(slopes[:, None]), ring)
        own = factors(*law.constants, self._space.averages(block), degree)[0] - law.constants[0]
        moduli = law.stiffness(at) + isotropic(own, 0.0, 6 if at.shape[1] == 3 else 4, law.plane_stress)
        alone = FacetPoints(np.arange(len(at)), np.arange(len(at)), np.ones((len(at), 1)))
        rows = np.empty((*slopes.shape, slopes.shape[2]))
        traction_rows(cells, moduli, alone, traction_matrix(normal), rows)
        return np.einsum("ni,nbij->nbj", vector, rows)

    def on_surface(self, contact, states):
        """The residual P - t of a pair, weighted; see :class:`pcontact.estimate.estimator.Estimate`. *Collective.*"""
        sums = np.zeros(2)
        for pair, state in zip(contact.pairs, states, strict=True):
            source, normal = pair.source, pair.pairing.normal
            parts = pair.terms.traction.weighted
            weight = state["weight"] / (source.trace[source.facet] if parts is None else parts.trace)
            sums[0] += weight @ (state["pressure"] + state["normal_stress"]) ** 2
            if "own_traction" in state:
                rest = state["traction"] - state["own_traction"]
                sums[1] += weight @ (np.sum(rest**2, axis=1) - np.sum(rest * normal, axis=1) ** 2)
        contact, friction = np.sqrt(np.maximum(self._space.comm.allreduce(sums, op=MPI.SUM), 0.0)).tolist()
        return {"contact": contact, "friction": friction}


def _along(vectors, normal):
    """Tangential part (np, d) of vectors."""
    return vectors - np.sum(vectors * normal, axis=1, keepdims=True) * normal


def _scaled(vectors, normal, normally, across):
    """Vectors (np, d) whose parts along the normals and across them are taken times numbers (np,)."""
    along = np.sum(vectors * normal, axis=1, keepdims=True) * normal
    return normally[:, None] * along + across[:, None] * (vectors - along)
