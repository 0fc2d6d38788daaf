"""Residuals on the facets of cells, but for what contact exerts: jumps between cells, and what loads do not meet."""

from functools import partial

import numpy as np

from pcontact.element.geometry import facet_geometry
from pcontact.element.reference import CELLS, facet_points
from pcontact.element.shape import shape
from pcontact.estimate.bubbles import bubbles
from pcontact.estimate.facets import facet_rule
from pcontact.estimate.interiors import chunks
from pcontact.estimate.loads import force_density
from pcontact.estimate.parts import CONTACT, FRICTION, INTERIOR, JUMPS, NEUMANN
from pcontact.estimate.points import of_nodes_on_normals, on_normals
from pcontact.estimate.recovery import Recovery
from pcontact.estimate.stress import BlockStress
from pcontact.estimate.tractions import source_facets
from pcontact.runtime.petsc import MPI

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
    """What share of a jump the cells of a block take, beside those of others [stress]."""
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
    kept : pcontact.space.kept.Kept

    Attributes
    ----------
    kinds : list of ndarray (nc, nf, 2) of int
        For each block, whose residual (normal, tangential) a facet's is, of `pcontact.estimate.parts`.
    recovery : pcontact.estimate.recovery.Recovery

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, problem, pairs, springs, kept):
        self._space, self._bulk, self._pairs = problem.space, problem.bulk, pairs
        self._springs, self._kept = springs, kept
        self.kinds, self.recovery = self._kinds(problem.contacts), Recovery(problem.space)
        # test functions of a block's cells at all points of their facets
        self._on_facets = {}

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

    def add(self, nodal, time, tested, bulk, loads, found=None):
        """Add the residuals of all facets but for the tractions of contact. *Collective.*

        Parameters
        ----------
        nodal : ndarray (n_local, d)
            Displacement.
        time : float
        tested : list of ndarray (nc, n_parts, nb, d)
            Of every block [force]; changed.
        bulk : object
            Whose stresses count, see :class:`pcontact.estimate.stress.BlockStress`.
        loads : list of pcontact.estimate.loads.Given or pcontact.estimate.loads.Spread
        found : dict, optional
            As of :class:`pcontact.estimate.stress.BlockStress`.

        Returns
        -------
        list of (ndarray (n,), ndarray (n, nf, nq, d))
            Of every block cells that have facets on the boundary, and g - t of all but contact there [stress].
        """
        space, mesh, result = self._space, self._space.mesh, []
        own = [self._tractions(number, nodal, bulk, found) for number in range(len(mesh.blocks))]
        stiff = [stiffness(space, self._bulk, block) for block in mesh.blocks]
        flat, width = [], max([0, *(t.shape[2] * t.shape[3] for t, _, _ in own)])
        width = space.comm.allreduce(width, op=MPI.MAX)
        flux = self._flux(nodal, own, bulk, found)
        for number in range(len(own)):
            values = self._pairs.canonical(number, flux[number])
            table = np.zeros((values.shape[0] * values.shape[1], width + 1))
            table[:, 0] = stiff[number]
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
            share = stiff[number] / (stiff[number] + other[first:last, 0])
            share = share.reshape(inner.shape)[:, :, None, None]
            jump = ((1.0 - share) * flux[number] - share * theirs - traction) * inner[:, :, None, None]
            outer = self._outer(number, time, traction, normal, inner, loads)
            self._springs.add(number, nodal, outer, traction, normal)
            self._test(number, traction, jump, outer, jxw, tested[number])
            rows, parts = outer
            result.append((rows, sum(parts.values(), np.zeros_like(traction[rows]))))
        return result

    def _tractions(self, number, nodal, bulk, found):
        """sigma n (nc, nf, nq, d) and quadrature weights (nc, nf, nq), normals (nc, nf, nq, d) of a block's facets."""
        space, mesh = self._space, self._space.mesh
        block = mesh.blocks[number]
        table, geometry_degree = mesh.geometry_nodes(block)
        xi, weights = facet_rule(block.cell, space.degree)
        on_cell = facet_points(block.cell, xi)
        shape_ = len(block.nodes), len(on_cell), len(weights)
        traction, normal, jxw = np.empty((*shape_, mesh.dim)), np.empty((*shape_, mesh.dim)), np.empty(shape_)
        degree = space.degree_of(block)
        for rows in chunks(space, number, len(weights) * space.cells[number].shape[1] * mesh.dim):
            x = np.ascontiguousarray(mesh.points[table[rows]])
            stress = BlockStress(space, bulk, number, rows, nodal, found)
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

    def _flux(self, nodal, own, bulk, found):
        """Traction (nc, nf, nq, d) of the averaged stress at each block's facets. *Collective.*"""
        result = []
        for number, sigma in enumerate(self.recovery(bulk, nodal, found)):
            block = self._space.mesh.blocks[number]
            points = facet_points(block.cell, facet_rule(block.cell, self._space.degree)[0])
            values = shape(block.cell, self._space.degree_of(block), points.reshape(-1, self._space.dim))
            normals = own[number][1]
            flat = normals.reshape(len(normals), len(values), self._space.dim)
            at = np.empty_like(flat)
            of_nodes_on_normals(values, np.ascontiguousarray(sigma), flat, at)
            result.append(at.reshape(normals.shape))
        return result

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

    def _test(self, number, traction, jump, outer, jxw, tested):
        """Test the residuals of a block's facets with the functions on them."""
        block = self._space.mesh.blocks[number]
        points = facet_points(block.cell, facet_rule(block.cell, self._space.degree)[0])
        if number not in self._on_facets:
            self._on_facets[number] = np.concatenate([tests_of(self._space, number, at) for at in points])
        values, (rows, outer) = self._on_facets[number], outer
        for part, residual in ((INTERIOR, traction), (JUMPS, jump)):
            tested[:, part] += _integrals(values, residual, jxw)
        for part, residual in outer.items():
            tested[rows, part] += _integrals(values, residual, jxw[rows])


def _integrals(values, residual, jxw):
    """int residual . v (nc, nb, d) over all facets of cells, for test functions of values (nf nq, nb)."""
    (n, nb), nc, d = values.shape, len(jxw), residual.shape[3]
    weighted = (jxw[:, :, :, None] * residual).reshape(nc, n, d)
    flat = np.ascontiguousarray(weighted.transpose(0, 2, 1)).reshape(nc * d, n)
    return (flat @ values).reshape(nc, d, nb).transpose(0, 2, 1)
