"""Springs to the ground in the estimate: what they exert on a displacement, and what they add to the local problems.

A spring of stiffness k per area is a boundary condition, sigma n = -k u, whose residual is -k u - t. Test functions
stretch the spring as well: without k in the local problems the estimate would grow with k where the error does not.
"""

import numpy as np

from pcontact.assembly.patches import kind_of
from pcontact.element.geometry import facet_geometry
from pcontact.element.reference import facet_points, shape
from pcontact.estimate.facets import facet_rule
from pcontact.estimate.local import Bound
from pcontact.estimate.points import NEUMANN, bubbles
from pcontact.estimate.stress import own_nodes


class Springs:
    """All springs of a problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, problem):
        self._space = space = problem.space
        self._springs = [(one, kind_of(space, one.region) == "facets") for one in problem.features.springs]
        self._of_facets = {}

    def facets(self, number):
        """Springs, and cells and local numbers of their facets, in a block."""
        for spring, on_facets in self._springs:
            for facets in self._space.mesh.facet_groups.get(spring.region, []) if on_facets else []:
                if facets.block == number and len(facets.cells):
                    yield spring, facets.cells, facets.local

    def _cells(self, number):
        """Springs, and flags of their cells, in a block."""
        mesh = self._space.mesh
        for spring, on_facets in self._springs:
            groups = mesh.cell_groups.get(spring.region, []) if not on_facets else []
            if number < len(groups) and len(groups[number]):
                chosen = np.zeros(len(mesh.blocks[number].nodes), dtype=bool)
                chosen[groups[number]] = True
                yield spring, chosen

    def add(self, number, nodal, outer, traction, normal):
        """Add the tractions of springs to the residuals of a block's facets: `outer` has the cells (n,), those of
        :meth:`facets` among them, and what they have by part, (n, nf, nq, d)."""
        space, block, (rows, parts) = self._space, self._space.mesh.blocks[number], outer
        points = facet_points(block.cell, facet_rule(block.cell, space.degree)[0])
        for spring, cells, local in self.facets(number):
            values = np.stack([shape(block.cell, space.degree_of(block), at) for at in points])[local]
            u = np.einsum("fqa,fad->fqd", values, nodal[own_nodes(space, number)[cells]])
            own = np.einsum("...ij,...j->...i", spring.tensor(normal[cells, local]), u)
            where = np.searchsorted(rows, cells), local
            np.subtract.at(parts.setdefault(NEUMANN, np.zeros_like(traction[rows])), where, own)

    def force(self, number, rows, values, nodal):
        """Force density (n, nq, d) of springs at points of some of a block's cells, None where there is none, from
        shape functions (nq, nn) and the displacement (n, nn, d) at the nodes of the cells."""
        total = None
        for spring, chosen in self._cells(number):
            u = np.einsum("qa,cad->cqd", values, nodal)
            total = np.zeros_like(u) if total is None else total
            total -= chosen[rows][:, None, None] * (u @ spring.tensor(None))
        return total

    def bound(self, number, rows, functions):
        """Addend of springs to the stiffness of some of a block's cells, a :class:`pcontact.estimate.local.Bound`, for
        test functions (nq, nb) and weights (nc, nq) of the points of the cells."""
        if number not in self._of_facets:
            self._of_facets[number] = self._on_facets(number)
        (tests, jxw), all_cells = functions, self._of_facets[number]
        n = tests.shape[1] * self._space.dim
        at, matrices = all_cells.at[rows].copy(), [all_cells.matrices]
        for spring, chosen in self._cells(number):
            some = np.flatnonzero(chosen[rows])
            own = np.einsum("cq,qa,qb,ij->caibj", jxw[some], tests, tests, spring.tensor(None)).reshape(len(some), n, n)
            has = at[some] >= 0
            own[has] += np.concatenate(matrices)[at[some[has]]]
            at[some] = sum(map(len, matrices)) + np.arange(len(some))
            matrices.append(own)
        return Bound(at, np.concatenate(matrices))

    def _on_facets(self, number):
        """:class:`Bound` of all cells of a block, by springs on facets."""
        space, block = self._space, self._space.mesh.blocks[number]
        xi, weights = facet_rule(block.cell, space.degree)
        points = facet_points(block.cell, xi)
        tests = np.stack([bubbles(block.cell, space.degree_of(block), at)[0] for at in points])
        table, geometry_degree = space.mesh.geometry_nodes(block)
        n = tests.shape[2] * space.dim
        every = [np.zeros(0, np.int64), *(cells for _, cells, _ in self.facets(number))]
        rows = np.unique(np.concatenate(every))
        at, matrices = np.full(len(block.nodes), -1, dtype=np.int64), np.zeros((len(rows), n, n))
        at[rows] = np.arange(len(rows))
        for spring, cells, local in self.facets(number):
            x = np.ascontiguousarray(space.mesh.points[table[cells]])
            place = facet_geometry(block.cell, x, np.ascontiguousarray(local, dtype=np.int64), geometry_degree,
                                   space.degree, xi, weights)  # fmt: skip
            jxw = place.jxw * space.circumference(place.points)
            tensor = np.broadcast_to(spring.tensor(place.normals), (*jxw.shape, space.dim, space.dim))
            values = tests[local]
            own = np.einsum("fq,fqa,fqb,fqij->faibj", jxw, values, values, tensor, optimize=True)
            np.add.at(matrices, at[cells], own.reshape(len(cells), n, n))
        return Bound(at, matrices)
