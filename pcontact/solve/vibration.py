"""Small free vibrations of bodies at a committed state: K x = w^2 M x by subspace iteration.

K is the tangent with the status of points frozen: closed ones stay so, and stick, all others are open. Iterates are
solutions of (K + s M) y = M x, s > 0 far below the frequencies of interest, so that bodies which nothing holds have
their rigid modes, of frequency zero.
"""

import numpy as np

from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import PETSc

# [-] Shift over the largest ratio of diagonals of K and M. From: a tenth of the square of the lowest frequency of a
# body a thousand cells long, and far above rounding errors.
SHIFT = 1e-8
# [-] Vectors beyond those that are wanted, and at least. From: Bathe, twice as many or eight more.
MORE_VECTORS = 8
# [-] Relative change of w^2 at which an iteration ends. From: chosen, well below what meshes leave open.
SETTLED = 1e-10
# [iterations] At most. From: chosen; a fresh subspace needs some ten.
MOST_ITERATIONS = 200
# [-] Part of the largest w^2 found below which a mode is a rigid one. From: chosen, above the rounding errors of K.
RIGID = 1e-9


def frequencies(problem, mass, u, count):
    """The lowest modes. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
        Whose items have the committed state.
    mass : pcontact.assembly.mass.Mass
    u : PETSc.Vec
        The committed displacement.
    count : int

    Returns
    -------
    squares : ndarray (count,)
        w^2 [radian^2 / time^2], ascending; not more than there are. Negative: the state is unstable.
    shapes : list of ndarray (n_owned, d)
        With x M x = 1.
    """
    conditions, space = problem.conditions, problem.space
    free = ~conditions.fixed if conditions.followers is None else ~(conditions.fixed | conditions.followers)
    total = space.comm.allreduce(int(free.sum()))
    count = min(count, total)
    problem.tangent(u, problem.active.frozen(), added=np.zeros_like(problem.stabilisation))
    stiffness, weights = problem.matrix.matrix, mass.matrix(problem).matrix
    ratio = stiffness.getDiagonal().getArray()[free.ravel()] / weights.getDiagonal().getArray()[free.ravel()]
    shift = SHIFT * max(space.comm.allgather(float(np.max(ratio, initial=0.0))))
    shifted = stiffness.copy()
    shifted.axpy(shift, weights, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    ksp = _direct(shifted)
    vectors = _start(space, free, min(max(2 * count, count + MORE_VECTORS), total))
    before = None
    for _ in range(MOST_ITERATIONS):
        solved = []
        for x in vectors:
            y = x.duplicate()
            ksp.solve(weights * x, y)
            y.getArray()[~free.ravel()] = 0.0
            solved.append(y)
        squares, vectors = _ritz(solved, stiffness, weights)
        bound = SETTLED * (np.abs(squares[:count]) + shift)
        if before is not None and np.all(np.abs(squares - before)[:count] <= bound):
            break
        before = squares
    ksp.destroy()
    squares = np.where(np.abs(squares) < RIGID * np.abs(squares).max(), 0.0, squares)[:count]
    for x in vectors[:count]:
        problem.conditions.follow(x)
    return squares, [space.of_owned(x).copy() for x in vectors[:count]]


def _direct(matrix):
    """A direct solver. *Collective.*"""
    ksp = PETSc.KSP().create(comm=matrix.getComm())
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    if matrix.getComm().getSize() > 1:
        ksp.getPC().setFactorSolverType("mumps")
    ksp.setOperators(matrix)
    try:
        ksp.setUp()
    except PETSc.Error:
        found = "modes: found no direct solver for several ranks"
        raise InputError(f"{found}; allowed: PETSc with MUMPS, or one rank") from None
    return ksp


def _start(space, free, n):
    """Vectors (n) that are the same on any ranks, zero at components that are not free. *Collective.*"""
    keys = space.keys[:, None] * space.dim + np.arange(space.dim)
    # of all wave lengths, and of none alone
    waves = (np.sin((keys + 1.0) * (k + 1.0) ** 2 * 0.7310585) for k in range(n))
    return [space.vector(np.where(free, wave, 0.0)) for wave in waves]


def _ritz(vectors, stiffness, weights):
    """Ritz values (n,), ascending, and vectors in the span of some."""
    products = [(stiffness * x, weights * x) for x in vectors]
    inner, mass = (np.array([[x.dot(one[k]) for one in products] for x in vectors]) for k in (0, 1))
    scale = 1.0 / np.sqrt(np.diag(mass))
    inner, mass = scale[:, None] * inner * scale, scale[:, None] * mass * scale
    # directions that hardly differ are left to the next iteration
    values, axes = np.linalg.eigh(0.5 * (mass + mass.T))
    axes = axes / np.sqrt(np.maximum(values, 1e-14 * values.max()))
    squares, ways = np.linalg.eig(axes.T @ inner @ axes)
    order = np.argsort(squares.real)
    ways = scale[:, None] * (axes @ ways.real[:, order])
    found = []
    for k in range(len(vectors)):
        x = vectors[0].duplicate()
        x.set(0.0)
        x.maxpy(ways[:, k], vectors)
        x.scale(1.0 / np.sqrt((weights * x).dot(x)))
        found.append(x)
    return squares.real[order], found
