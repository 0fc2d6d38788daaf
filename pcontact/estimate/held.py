"""What supports hold of the displacements that the estimate tests with."""

import numpy as np

from pcontact.element.reference import facet_nodes
from pcontact.estimate.bubbles import supports
from pcontact.estimate.stress import own_nodes
from pcontact.space.constraints import RigidGroup


class Held:
    """Components that supports hold.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    pairs : pcontact.estimate.facets.FacetPairs

    Attributes
    ----------
    nodes : ndarray (n_local, d) of bool
        Of nodes.
    """

    def __init__(self, problem, pairs):
        self._space, self._pairs = problem.space, pairs
        # what moves as a rigid body is as much held as what is prescribed
        self.nodes = problem.conditions.supports.fixed.copy()
        for group in problem.conditions.groups:
            if isinstance(group, RigidGroup):
                self.nodes[group.nodes] = True

    def of_tests(self, number, rows):
        """Components (n, nb, d) of the test functions of some cells of a block."""
        block = self._space.mesh.blocks[number]
        on = supports(block.cell, self._space.degree_of(block))
        return np.einsum("bf,cfi->cbi", on.astype(float), self.of_facets(number, rows).astype(float)) > 0.5

    def of_facets(self, number, rows):
        """Components (n, nf, d) of the displacement of the facets of some cells of a block."""
        space, block = self._space, self._space.mesh.blocks[number]
        held, degree = self.nodes[own_nodes(space, number)[rows]], space.degree_of(block)
        first, last = self._pairs.first[number : number + 2]
        outer = ~self._pairs.inner[first:last].reshape(len(block.nodes), -1)[rows]
        facets = held[:, facet_nodes(block.cell, degree)].all(axis=2)
        return facets & (outer[:, :, None] | held.all(axis=1)[:, None, :])
