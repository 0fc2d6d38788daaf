"""Residuals on the facets of cells: jumps between cells, and what loads do not meet; and
the continuous stress that they are compared with, the means of what cells say at their common nodes. Then what contact
exerts.
"""

from functools import partial

import numpy as np

from pcontact.assembly.item import LAW
from pcontact.assembly.strains import cell_points
from pcontact.contact.traction.small import FacetPoints, traction_rows
from pcontact.element.dilatation import factors
from pcontact.element.geometry import every_facet, gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, facet_points, reference_nodes, shape, shape_gradient
from pcontact.estimate.facets import facet_rule
from pcontact.estimate.interiors import chunks
from pcontact.estimate.loads import force_density
from pcontact.estimate.points import (
    CONTACT,
    FRICTION,
    JUMPS,
    NEUMANN,
    Sides,
    add_at,
    bubbles,
    of_nodes_on_normals,
    on_normals,
    weigh_facets,
)
from pcontact.estimate.stress import BlockStress, own_nodes
from pcontact.estimate.tractions import on_source, on_target, source_facets
from pcontact.material.elastic import isotropic
from pcontact.material.orthotropic import traction_matrix
from pcontact.runtime.petsc import MPI

# upper triangle of a symmetric tensor
UPPER = {2: ((0, 0), (0, 1), (1, 1)), 3: ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))}


class Recovery:
    """Nodal means of the stress.

    Parameters
    ----------
    space : pcontact.space.space.Space

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space):
        self.space = space
        body = np.full(space.n_local, -1, dtype=np.int64)
        clash = False
        for block, cells in zip(space.mesh.blocks, space.cells, strict=True):
            clash |= bool(np.any((body[cells] >= 0) & (body[cells] != block.body)))
            body[cells] = block.body
        # ranks may meet in a node with different bodies, too: its owner's number has to be everybody's
        numbers, one = np.zeros((space.n_local, space.dim)), np.zeros((space.n_local, space.dim))
        numbers[:, 0], one[:, 0] = body, 1.0
        mean = space.together(numbers)[:, 0] / np.maximum(space.together(one)[:, 0], 1.0)
        clash |= bool(np.any(np.abs(mean - body) > 1e-9))
        bodies = sorted(set().union(*space.comm.allgather({block.body for block in space.mesh.blocks})))
        clash = space.comm.allreduce(clash, op=MPI.LOR)
        self._groups = [{number} for number in bodies] if clash else [set(bodies)]

    def __call__(self, bulk, nodal, found=None):
        """Stress (nc, nn, d, d) at the nodes of each block's cells under a displacement (n_local, d); `found` as of
        :class:`pcontact.estimate.stress.BlockStress`. *Collective.*"""
        space, d = self.space, self.space.dim
        upper, result = UPPER[d], [None] * len(space.mesh.blocks)
        for group in self._groups:
            sums = np.zeros((space.n_local, d * -(-(len(upper) + 1) // d)))
            for number, block in enumerate(space.mesh.blocks):
                if block.body in group:
                    self._add(BlockStress(space, bulk, number, slice(None), nodal, found), number, sums)
            sums = np.concatenate([self.space.together(sums[:, k : k + d]) for k in range(0, sums.shape[1], d)], axis=1)
            mean = sums[:, : len(upper)] / np.where(sums[:, len(upper)] > 0.0, sums[:, len(upper)], 1.0)[:, None]
            tensor = np.empty((space.n_local, d, d))
            for k, (i, j) in enumerate(upper):
                tensor[:, i, j] = tensor[:, j, i] = mean[:, k]
            for number, block in enumerate(space.mesh.blocks):
                if block.body in group:
                    result[number] = tensor[own_nodes(space, number)]
        return result

    def _add(self, stress, number, sums):
        """Add stress times volume, and volume, of a block's cells at their nodes."""
        space, upper = self.space, UPPER[self.space.dim]
        grad, values, radius, nodes, weight, cells = space.kept(("averaged", number), partial(self._at_nodes, number))
        tensor, _ = stress(grad, values, radius, nodes)
        for k, (i, j) in enumerate(upper):
            sums[:, k] += np.bincount(cells, (weight[:, None] * tensor[:, :, i, j]).ravel(), len(sums))
        sums[:, len(upper)] += np.bincount(cells, np.repeat(weight, len(nodes)), len(sums))

    def _at_nodes(self, number):
        """Of a block's cells at their nodes: gradients and values of shape functions, radii or None, reference nodes;
        volumes (nc,) and nodes (nc nn,) of the cells."""
        space, mesh, block = self.space, self.space.mesh, self.space.mesh.blocks[number]
        table, geometry_degree = mesh.geometry_nodes(block)
        xi, weights = quadrature(block.cell, 2)
        degree = space.degree_of(block)
        nodes = reference_nodes(block.cell, degree)
        x = np.ascontiguousarray(mesh.points[table])
        dshape = np.ascontiguousarray(shape_gradient(block.cell, degree, nodes))
        grad, jxw = np.empty((len(x), *dshape.shape)), np.empty((len(x), len(nodes)))
        dgeo = np.ascontiguousarray(shape_gradient(block.cell, geometry_degree, nodes))
        gradients(x, dgeo, dshape, np.ones(len(nodes)), grad, jxw)
        radius = x[:, :, 0] @ shape(block.cell, geometry_degree, nodes).T if space.axisymmetric else None
        one, volume = np.empty((len(x), len(weights), 1, mesh.dim)), np.empty((len(x), len(weights)))
        dgeo = np.ascontiguousarray(shape_gradient(block.cell, geometry_degree, xi))
        gradients(x, dgeo, np.ascontiguousarray(dgeo[:, :1]), weights, one, volume)
        cells = own_nodes(space, number).ravel()
        return grad, shape(block.cell, degree, nodes), radius, nodes, volume.sum(axis=1), cells


# [-] Stiffness beside which that of others does not count
TAKES_ALL = 1e12


def parts_of(contact):
    """Parts of the residual along and across the direction of contact."""
    if contact.law.tied:
        return JUMPS, JUMPS
    return (CONTACT, FRICTION) if contact.law.tangential else (CONTACT, CONTACT)


def tests_of(space, number, xi):
    """Test functions (n, nb) of a block at reference points (n, d)."""
    block = space.mesh.blocks[number]
    return bubbles(block.cell, space.degree_of(block), xi)[0]


def stiffness(space, bulk, block):
    """Share of a jump that the cells of a block take, beside those of others [stress]."""
    lam, mu = bulk.constants[block.body]
    # the functions that are missing where cells of both degrees meet are those of the lower one
    return (lam + 2.0 * mu) * (TAKES_ALL if space.degree_of(block) < space.degree else 1.0)


class FacetResiduals:
    """Residuals on the facets of one problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    pairs : pcontact.estimate.facets.FacetPairs
    springs : pcontact.estimate.springs.Springs
    kept : pcontact.space.space.Kept

    Attributes
    ----------
    kinds : list of ndarray (nc, nf, 2) of int
        For each block, whose residual (normal, tangential) a facet's is, of `pcontact.estimate.points`.
    recovery : pcontact.estimate.residuals.Recovery

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, problem, pairs, springs, kept):
        self._space, self._bulk, self._pairs = problem.space, problem.bulk, pairs
        self._springs, self._kept = springs, kept
        self.kinds, self.recovery = self._kinds(problem.contacts), Recovery(problem.space)
        # test functions of a block's cells at all points of their facets; what share of a jump a facet's cell takes
        self._on_facets, self._share = {}, self._shares()

    def _kinds(self, contacts):
        """For each block, whose residual (normal, tangential) a facet's is."""
        space, result = self._space, []
        for block in space.mesh.blocks:
            result.append(np.full((len(block.nodes), len(CELLS[block.cell].facets), 2), NEUMANN, dtype=np.int64))
        for contact in contacts:
            for pair in contact.pairs:
                for name in (pair.contact.source, pair.contact.target):
                    facets = source_facets(space, name) if name is not None else np.zeros((0, 3), np.int64)
                    for number in np.unique(facets[:, 0]):
                        _, cells, local = facets[facets[:, 0] == number].T
                        result[number][cells, local] = parts_of(contact)
        return result

    def _shares(self):
        """For each block, what share (nc, nf) of a jump its cells take. *Collective.*"""
        first, blocks = self._pairs.first, self._space.mesh.blocks
        own = np.zeros((first[-1], 1))
        for number, block in enumerate(blocks):
            own[first[number] : first[number + 1]] = stiffness(self._space, self._bulk, block)
        share = (own / (own + self._pairs.other_side(own)))[:, 0]
        of_blocks = [share[first[number] : first[number + 1]] for number in range(len(blocks))]
        return [some.reshape(len(block.nodes), len(CELLS[block.cell].facets))
                for some, block in zip(of_blocks, blocks, strict=True)]  # fmt: skip

    def add(self, nodal, time, tested, bulk, loads, found=None):
        """Add the residuals of all facets but for the tractions of contact to those (nc, n_parts, nb, d) of every block
        [force], under a displacement (n_local, d) and with the stresses of `bulk`; `found` as of
        :class:`pcontact.estimate.stress.BlockStress`. *Collective.*"""
        pairs = self._pairs
        own = [self._tractions(number, nodal, bulk, found) for number in range(len(self._space.mesh.blocks))]
        flux = self._flux(nodal, own, bulk, found)
        for number, (traction, normal, jxw) in enumerate(own):
            first, last = pairs.first[number : number + 2]
            inner = pairs.inner[first:last].reshape(traction.shape[:2])
            outer = self._outer(number, time, traction, normal, inner, loads)
            self._springs.add(number, nodal, outer, traction, normal)
            sides = Sides(traction, flux, pairs.other, self._share[number])
            self._test(number, sides, outer, jxw, tested[number])

    def _tractions(self, number, nodal, bulk, found):
        """sigma n (nc, nf, nq, d) and quadrature weights (nc, nf, nq), normals (nc, nf, nq, d) of a block's facets."""
        space, d = self._space, self._space.dim
        block = space.mesh.blocks[number]
        points = self._points(block)
        nc, n = len(block.nodes), len(points)
        values, parts = shape(block.cell, space.degree_of(block), points), []
        if not nc:
            parts.append((np.zeros((0, n, d)), np.zeros((0, n, d)), np.zeros((0, n))))
        for rows in chunks(space, number, n * space.cells[number].shape[1] * d):
            grad, normals, jxw, radius = self._kept(("facets", number, rows.start), partial(self._made, number, rows))
            sigma, _ = BlockStress(space, bulk, number, rows, nodal, found)(grad, values, radius, points)
            traction = np.empty_like(normals)
            on_normals(sigma, normals, traction)
            parts.append((traction, normals, jxw))
        traction, normals, jxw = parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
        shape_ = nc, len(CELLS[block.cell].facets), n // len(CELLS[block.cell].facets)
        return traction.reshape(*shape_, d), normals.reshape(*shape_, d), jxw.reshape(shape_)

    def _points(self, block):
        """Reference points (nf nq, d) of all facets of the cells of a block."""
        points = facet_points(block.cell, facet_rule(block.cell, self._space.degree)[0])
        return points.reshape(-1, self._space.dim)

    def _made(self, number, rows):
        """Of some of a block's cells at the points of their facets: gradients (nc, nf nq, nn, d), normals, quadrature
        weights, radii or None."""
        space, block = self._space, self._space.mesh.blocks[number]
        table, geometry_degree = space.mesh.geometry_nodes(block)
        x, rule = space.mesh.points[table[rows]], facet_rule(block.cell, space.degree)
        at, nc = every_facet(block.cell, x, geometry_degree, space.degree_of(block), *rule), len(x)
        jxw = at.jxw * space.circumference(at.points) if space.axisymmetric else at.jxw
        radius = at.points[:, :, 0].reshape(nc, -1) if space.axisymmetric else None
        grad = at.gradients.reshape(nc, -1, *at.gradients.shape[2:])
        return grad, at.normals.reshape(nc, -1, space.dim), jxw.reshape(nc, -1), radius

    def _flux(self, nodal, own, bulk, found):
        """Tractions of the averaged stress at the points of all facets, see `pcontact.estimate.facets.FacetPairs.room`.
        *Collective.*"""
        space, table = self._space, self._pairs.room(self._space.dim)
        for number, sigma in enumerate(self.recovery(bulk, nodal, found)):
            block, normals = space.mesh.blocks[number], own[number][1]
            values = shape(block.cell, space.degree_of(block), self._points(block))
            first, last = self._pairs.points[number : number + 2]
            flat = normals.reshape(len(normals), len(values), space.dim)
            of_nodes_on_normals(values, np.ascontiguousarray(sigma), flat, table[first:last].reshape(flat.shape))
        self._pairs.meet(table)
        return table

    def _outer(self, number, time, traction, normal, inner, loads):
        """Residual g - t of the facets on the boundary: cells (n,) that have some, and by parts (n, nf, nq, d)."""
        space, touched, result = self._space, ~inner.all(axis=1), {}
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
                on = (self.kinds[number][rows, :, k] == part) & outside
                if on.any():
                    result[part] = result.get(part, 0.0) + value * on[:, :, None, None]
        for load, facets in loaded:
            where, body = (np.searchsorted(rows, facets.cells), facets.local), space.mesh.blocks[number].body
            places = self._places(number, facets.cells, facets.local)
            value = force_density(space, load, places, normal[where], body, time)
            result.setdefault(NEUMANN, np.zeros_like(traction))[where] += value
        return rows, result

    def _places(self, number, cells, local):
        """Points (n, nq, d) of facets of a block [length]."""
        mesh, block = self._space.mesh, self._space.mesh.blocks[number]
        table, geometry_degree = mesh.geometry_nodes(block)
        points = facet_points(block.cell, facet_rule(block.cell, self._space.degree)[0])
        values = np.stack([shape(block.cell, geometry_degree, at) for at in points])
        return np.einsum("fqa,fad->fqd", values[local], mesh.points[table[cells]])

    def _test(self, number, sides, outer, jxw, tested):
        """Test the residuals of a block's facets with the functions on them."""
        if number not in self._on_facets:
            block = self._space.mesh.blocks[number]
            self._on_facets[number] = tests_of(self._space, number, self._points(block))
        values, (rows, outer) = self._on_facets[number], outer
        weigh_facets(values.reshape(*jxw.shape[1:], -1), jxw, sides, self._pairs.points[number], tested)
        for part, residual in outer.items():
            tested[rows, part] += _integrals(values, residual, jxw[rows])


def _integrals(values, residual, jxw):
    """int residual . v (nc, nb, d) over all facets of cells, for test functions of values (nf nq, nb)."""
    (n, nb), nc, d = values.shape, len(jxw), residual.shape[3]
    weighted = (jxw[:, :, :, None] * residual).reshape(nc, n, d)
    flat = np.ascontiguousarray(weighted.transpose(0, 2, 1)).reshape(nc * d, n)
    return (flat @ values).reshape(nc, d, nb).transpose(0, 2, 1)


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

    def add(self, contact, states, tested):
        """Add the tractions of a contact, from the states of its pairs, to the residuals (nc, n_parts, nb, d) of every
        block [force]. *Collective.*"""
        normal_part, across_part = parts_of(contact)
        for pair, state in zip(contact.pairs, states, strict=True):
            sides = [on_source(self._space, pair, state)]
            if not pair.rigid:
                sides.append(on_target(self._space, pair, state, self._cells, contact.weight))
            for number, forces in ((n, f) for side in sides for n, f in side.items()):
                values = tests_of(self._space, number, forces.xi)
                along = np.sum(forces.force * forces.normal, axis=1)[:, None] * forces.normal
                for part, force in ((normal_part, along), (across_part, forces.force - along)):
                    add_at(forces.rows, part, values[:, :, None] * force[:, None, :], tested[number])

    def add_dual(self, contact, u, z, zero, tested, rules=None):
        """Forces that contact exerts on a dual displacement. *Collective.*

        With D the derivative of the law at the displacement u, or by the rules that some pairs have, the tangent has
        the terms  - int theta t(w) . G^-1 t(z)  and  - int D (t(w) - G [[w]]) . G^-1 (G [[z]] - theta t(z))  for a
        displacement w. Tests of cells are no displacements of the space: that their tractions t(w) meet a [[z]] which
        is not zero where surfaces are closed, counts. Where they slip, D has the friction that follows the pressure: a
        [[z]] along the slip, which nothing keeps small, meets the pressure of w.
        """
        for pair, state, rest in zip(contact.pairs, contact.states(z), contact.states(zero), strict=True):
            normal, theta, gamma = state["normal"], pair.method.theta, pair.method.gamma
            alpha = pair.method.alpha
            # gaps of points without a partner are infinite
            known = np.where(state["paired"], [rest["gap"], state["gap"]], 0.0)
            jump = (known[0] - known[1])[:, None] * normal
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
