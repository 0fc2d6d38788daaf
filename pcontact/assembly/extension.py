"""Where the nodes of bodies that begin in a phase are put: they go along with the bodies that they share nodes with.

A body that begins has no strain wherever its nodes are put. They are put where they make it an elastic body that the
shared nodes move: one on a body that has moved as a rigid one moves with it. Bodies that share no nodes stay where the
mesh has them.
"""

import numpy as np

from pcontact.assembly.matrix import GlobalMatrix
from pcontact.runtime.petsc import PETSc

# [-] Reduction of the residual. From: ranks are to agree to many digits; what is left strains no body.
SMALL = 1e-12
# Krylov iterations at most. From: chosen, far more than layers of a hundred cells take.
MOST = 20_000


def extend(problem, values, fresh, time):
    """Put nodes that are there from now on where the others draw them.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
        Whose bodies count their strain from the undeformed ones yet.
    values : ndarray (n_owned, d)
        Displacement [length]; of those nodes it is overwritten.
    fresh : ndarray (n_owned,) of bool
        Those nodes.
    time : float

    Notes
    -----
    *Collective.*
    """
    space = problem.space
    if not space.comm.allreduce(int(fresh.sum())):
        return
    held = ~fresh
    brought = [group for group in problem.conditions.groups if group.bring(values, fresh)]
    for group in brought:
        held[group.rows] = True
    vector = space.vector()
    vector.setArray(np.repeat(held, space.dim).astype(float))
    fixed = space.local.gather(vector) > 0.5
    bulk = getattr(problem.bulk, "small", problem.bulk)
    forces = np.zeros_like(values)
    vector.setArray(values.ravel())
    bulk.elastic_forces(vector, forces)
    forces[held] = 0.0
    if space.comm.allreduce(float(np.sum(forces**2))) > 0.0:
        values += _solved(space, bulk, fixed, -forces)
    for group in problem.conditions.groups:
        if group not in brought:
            entered = values.copy()
            group.enter(entered, time)
            values[fresh] = entered[fresh]


def _solved(space, bulk, fixed, forces):
    """Displacement (n_owned, d) of elastic bodies under forces, nodes (n_local, d) held. *Collective.*"""
    d, n = space.dim, space.n_owned
    whole, none = GlobalMatrix(space, fixed), (np.zeros(n + 1, dtype=np.int64), np.zeros(0, dtype=np.int64))
    whole.renew(bulk.pattern(), none)
    whole.write(bulk.values, np.zeros((0, d, d)), np.zeros(n))
    whole.matrix.assemble()
    # bodies that nothing draws have a zero right-hand side: these iterations leave them where they are
    krylov = PETSc.KSP().create(comm=space.comm)
    krylov.setOperators(whole.matrix)
    krylov.setType("cg")
    krylov.getPC().setType("jacobi")
    krylov.setTolerances(rtol=SMALL, max_it=MOST)
    right, solution = space.vector(), space.vector()
    right.setArray(forces.ravel())
    krylov.solve(right, solution)
    result = solution.getArray(readonly=True).reshape(n, d).copy()
    for one in (krylov, right, solution, whole.matrix):
        one.destroy()
    return result
