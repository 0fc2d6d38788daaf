"""Multigrid for displacements of degree 2: those of degree 1 on the vertices are its next level.

The rows of a matrix of degree 2 have 80 to 190 entries of either sign, and aggregates made of them are poor and dear.
The functions of degree 1 are among those of degree 2: with P their values at all nodes, P^T A P is the matrix of degree
1, of an eighth of the unknowns, which algebraic multigrid is made for. PETSc's PCMG has the two levels; what solves on
the lower one is a preconditioner of its own, gamg by default.
"""

import numpy as np

from pcontact.element.reference import CELLS, reference_nodes
from pcontact.element.shape import shape
from pcontact.runtime.petsc import PETSc, forget_pattern

# [-] A weight is none below it. From: chosen; weights are at least 1/8.
LEAST_WEIGHT = 1e-9


class LowerDegree:
    """The level of degree 1 below that of degree 2.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
        Of degree 2, no component of which follows others.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, problem):
        space = problem.space
        self._space, self._vertex = space, _vertices(space)
        self._interpolation = _interpolation(space, problem.conditions.supports.fixed, self._vertex)
        self._product = None

    def attach(self, pc):
        """Give a new preconditioner its levels. *Collective.*"""
        self.forget_pattern()
        pc.setType("mg")
        pc.setMGLevels(2)
        pc.setMGInterpolation(1, self._interpolation)
        pc.setFromOptions()

    def forget_pattern(self):
        """Have the next product be one of a new pattern."""
        if self._product is not None:
            self._product.destroy()
        self._product = None

    def renew(self, pc, matrix):
        """Take the values of a matrix, before the preconditioner is set up with it. *Collective.*

        Parameters
        ----------
        pc : PETSc.PC
            That has been attached.
        matrix : PETSc.Mat
            Of degree 2, AIJ, with its near-null space.
        """
        lower = pc.getMGCoarseSolve()
        if self._product is not None:
            matrix.ptap(self._interpolation, result=self._product)
        else:
            self._product = matrix.ptap(self._interpolation)
            self._product.setBlockSize(self._space.dim)
            forget_pattern(lower)
        self._product.setNearNullSpace(self._modes(matrix))
        lower.setOperators(self._product, self._product)

    def _modes(self, matrix):
        """The near-null space of a matrix at the vertices. *Collective.*"""
        vectors = []
        for mode in matrix.getNearNullSpace().getVecs():
            vector = self._interpolation.createVecRight()
            values = mode.getArray(readonly=True).reshape(-1, self._space.dim)
            vector.setArray(values[self._vertex[self._space.owned_local]].ravel())
            for other in vectors:
                vector.axpy(-vector.dot(other), other)
            # bodies are the same at their vertices: none is a combination of others
            vector.normalize()
            vectors.append(vector)
        return PETSc.NullSpace().create(constant=False, vectors=vectors, comm=self._space.comm)


def _vertices(space):
    """Flags (n_local,) of the nodes that are vertices of cells. *Collective.*"""
    found = [table[:, : CELLS[block.cell].n_vertices].ravel() for block, table in _blocks(space)]
    return space.flag(np.concatenate([np.zeros(0, dtype=np.int64), *found]))


def _blocks(space):
    return zip(space.mesh.blocks, space.cells, strict=True)


def _weights(space, vertex):
    """Values of the functions of degree 1 at the owned nodes: rows, local vertices and values (n,) each, a node from
    the first cell that has it."""
    own = space.owned_local[vertex[space.owned_local]]
    parts, known = [(own, own, np.ones(len(own)))], vertex | ~space.owns(slice(None))
    for block, table in _blocks(space):
        n = CELLS[block.cell].n_vertices
        for a, row in enumerate(shape(block.cell, 1, reference_nodes(block.cell, 2)[n:]), start=n):
            nodes, first = np.unique(table[:, a], return_index=True)
            nodes, first = nodes[~known[nodes]], first[~known[nodes]]
            known[nodes] = True
            for k in np.flatnonzero(row > LEAST_WEIGHT):
                parts.append((nodes, table[first, k], np.full(len(nodes), row[k])))
    return (np.concatenate(part) for part in zip(*parts, strict=True))


def _interpolation(space, fixed, vertex):
    """P, without what moves prescribed components or what these move, but for the vertices' own rows. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    fixed : ndarray (n_local, d) of bool
        Prescribed components.
    vertex : ndarray (n_local,) of bool

    Returns
    -------
    PETSc.Mat
    """
    d, rows = space.dim, space.n_owned * space.dim
    own = vertex[space.owned_local]
    count = int(own.sum())
    start = space.comm.scan(count) - count
    numbers = np.zeros((space.n_owned, d))
    numbers[own, 0] = start + np.arange(count)
    numbers = np.rint(space.at_nodes(numbers)[:, 0]).astype(np.int64)
    node, parent, value = _weights(space, vertex)
    kept = (node == parent)[:, None] | ~(fixed[node] | fixed[parent])
    row = ((space.nodes[node] - space.start)[:, None] * d + np.arange(d))[kept]
    column = (numbers[parent][:, None] * d + np.arange(d))[kept]
    value = np.broadcast_to(value[:, None], kept.shape)[kept]
    order = np.lexsort((column, row))
    first = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=rows))])
    sizes = ((rows, space.n_dofs), (count * d, space.comm.allreduce(count) * d))
    matrix = PETSc.Mat().create(comm=space.comm)
    matrix.setSizes(sizes)
    matrix.setBlockSizes(d, d)
    matrix.setType("aij")
    matrix.setPreallocationCSR((first.astype(PETSc.IntType), column[order].astype(PETSc.IntType), value[order]))
    matrix.assemble()
    return matrix


def lower_degree(problem, options):
    """The level of degree 1 where multigrid has one: the user chose no other preconditioner; else None. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    options : pcontact.runtime.options.Options
    """
    if options.get("pc_type") != "mg" or not has_lower_degree(problem):
        return None
    return LowerDegree(problem)


def has_lower_degree(problem):
    """Whether there is a level of degree 1: a component that leads others may be none of a vertex."""
    return problem.space.degree == 2 and problem.conditions.followers is None
