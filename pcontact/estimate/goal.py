"""The error of a quantity, by the problem that is dual to it (dual weighted residual, Becker and Rannacher 2001).

With N(u; v) the forces of all items on a displacement v, N(u; v) = 0 for all admissible v at the solution, and a
quantity J(u), the dual displacement z is found with the transposed tangent at u_h,

    N'(u_h)(w, z) = J'(u_h)(w)   for all admissible w,

and J(u) - J(u_h) = rho(z_h) + rho*(u - u_h) but for terms of higher order, with the residuals rho = -N(u_h; .) and
rho* = J'(u_h)(.) - N'(u_h)(., z_h). Of u - u_h each cell knows a part, the one whose energy is the estimate of the
energy norm (`pcontact.estimate.estimator`), and rho* is tested with it. It consists as rho does of what z_h does in
cells, between them and on the boundary, with the averaged stress between cells; but it is not rho with another
displacement: unless theta = 1 Nitsche's method does not make [[z_h]] vanish where surfaces are closed, and there the
tractions of u - u_h meet it. Where quadrature or the solver leave forces out, rho(z_h) is not zero: it is the work of
these forces on z_h.

    force         F . d = C(u; d on the source), of the force on the target, C being the part of N that contact has
    support       R . d = N(u; d on the support): z is d there, and J(u) - J(u_h) = -rho(z - z_h)
    displacement  the mean over the region, in its direction
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.item import LAW
from pcontact.assembly.loads import load_vector
from pcontact.estimate.pressures import named, norm
from pcontact.runtime.petsc import LEAST_PIVOT, MPI, PETSc, can_factorise
from pcontact.scene.model import Load

# [-] Of the dual solve. From: a laminate that is wound around wood; with 1e-5 the parts that cells have in the error of
# a force differ by 0.3 % between one rank and two, whose preconditioners differ, and with them the next mesh; with 1e-7
# by less than 0.01 %.
DUAL_RTOL = 1e-7
# [iterations] Of the dual solve at most. From: chosen.
DUAL_ITERATIONS = 400


class Goal(NamedTuple):
    """A quantity of a solution.

    Attributes
    ----------
    value : float
        J(u_h).
    slope : ndarray (n_owned, d)
        J'(u_h), for all nodes.
    lift : ndarray (n_owned, d) or None
        What z is at supports; None: nothing.
    sign : float
        Of rho* in the error.
    load : pcontact.scene.model.Load or None
        Whose work on a displacement J' is, but for what contact and supports have in it.
    contact : str or None
        The contact whose forces J is a sum of,
    shift : ndarray (n_owned, d) or None
        and the displacement that these work on.
    """

    value: float
    slope: np.ndarray
    lift: np.ndarray | None = None
    sign: float = 1.0
    load: Load | None = None
    contact: str | None = None
    shift: np.ndarray | None = None


class GoalError(NamedTuple):
    """The error of a quantity.

    Attributes
    ----------
    value : float
        Of the quantity.
    error : float
        J(u) - J(u_h), as far as the mesh has brought it about.
    cells : list of ndarray (nc,)
        What the cells of each block have in it, with signs.
    loads, algebraic : float
        J(u) - J(u_h), as far as the quadrature of loads and the solver have.
    together : float or None
        The error as one problem on all cells tells it, where there is one.
    """

    value: float
    error: float
    cells: list
    loads: float = 0.0
    algebraic: float = 0.0
    together: float | None = None


def _direction(vector):
    """The vector's direction; along the first axis where there is none."""
    vector = np.asarray(vector, dtype=float)
    size = np.linalg.norm(vector)
    return vector / size if size > 0.0 else np.eye(len(vector))[0]


def transposed(space, items, u, phi, rules=None):
    """phi . N'(u) of some items for a field phi (n_owned, d), as forces (n_owned, d), by the law or by the rules that
    some items have. *Collective.*"""
    total, d = space.vector(), space.dim
    for item in items:
        rowptr, columns = item.pattern()
        values = item.tangent(u, (rules or {}).get(item, LAW))
        rows = np.repeat(np.arange(space.n_owned), np.diff(rowptr))
        some = np.flatnonzero(phi[rows].any(axis=1))
        forces = np.einsum("eij,ei->ej", values[some], phi[rows[some]])
        total.setValuesBlocked(columns[some].astype(PETSc.IntType), forces.ravel(), PETSc.InsertMode.ADD)
    total.assemble()
    return total.getArray(readonly=True).reshape(-1, d).copy()


def _beside(space, contact):
    """Nodes (n_local,) of the cells on the source of a contact, but for those of its target alone. *Collective.*

    A displacement that these have in common is rigid there: unless theta = 0 contact does work on its traction, too.
    """
    names = (contact.source, contact.target)
    every, source, target = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for name, on in zip(names, (source, target), strict=True):
        for facets in space.mesh.facet_groups.get(name, []):
            on.append(space.facet_nodes(facets).ravel())
            if on is source:
                every.append(space.cells[facets.block][facets.cells].ravel())
    every, source, target = (space.flag(np.unique(np.concatenate(some))) for some in (every, source, target))
    return every & (source | ~target)


def contact_force(problem, contact, force, u, rules=None):
    """The force of a contact on its source, along itself. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    contact : pcontact.contact.report.ContactReport
    force : sequence of float
        Of the report [force].
    u : PETSc.Vec
    rules : dict, optional
        Of pairs, see :func:`pcontact.estimate.closing.rules`.
    """
    space, direction = problem.space, _direction(force)
    phi = _beside(space, contact.contact)[space.owned_local][:, None] * direction
    if problem.lower is not None:
        problem.lower.follow(phi)
    # the residual has the force on the source with the other sign, and so has the report, on the target
    slope = transposed(space, contact.pairs, u, phi, rules)
    return Goal(float(np.linalg.norm(force)), slope, contact=contact.name, shift=phi)


def support_force(problem, region, force, u, rules=None):
    """The force of a support, along itself; see :func:`contact_force`. *Collective.*"""
    space, supports = problem.space, problem.supports
    names = [number for number, name in enumerate(supports.regions) if name == region]
    held = np.isin(supports.which[space.owned_local], names)
    phi = held * _direction(force)
    for group in problem.groups:
        group.follow(phi)
    slope = transposed(space, problem.items, u, phi, rules)
    return Goal(float(np.linalg.norm(force)), -slope, phi, -1.0)


def probe(problem, region, u):
    """The mean displacement of a region, over its area or volume, in its direction. *Collective.*"""
    space, d = problem.space, problem.space.dim
    values = u.getArray(readonly=True).reshape(-1, d)
    weights, key = _weights(space, region)
    total = space.comm.allreduce(np.concatenate([weights @ values, [weights.sum()]]), op=MPI.SUM)
    direction = _direction(total[:d])
    slope = weights[:, None] * direction / total[d]
    load = None if key is None else Load(region, **{key: (direction / total[d]).tolist()})
    return Goal(float(total[:d] @ direction / total[d]), slope, load=load)


def value(problem, target, record, u):
    """A quantity of a load step, as it is named with an error to reach. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    target : pcontact.scene.target.Target
    record : dict
    u : PETSc.Vec

    Returns
    -------
    float
        Of the pressure its norm in L2.
    """
    if target.quantity == "force":
        return float(np.linalg.norm(record["contacts"][target.name]["force"]))
    if target.quantity == "support":
        return float(np.linalg.norm(record["reactions"][target.name]))
    if target.quantity == "displacement":
        return probe(problem, target.name, u).value
    return norm(problem.space.comm, named(problem, target.name, u))


def _weights(space, region):
    """Weights (n_owned,) of the nodes of a region in its mean, and the key of a load that has them; None for points.
    *Collective.*
    """
    kinds = [space.mesh.facet_groups, space.mesh.cell_groups]
    found = [space.comm.allreduce(region in groups, op=MPI.LOR) for groups in kinds]
    unit = [1.0] + [0.0] * (space.dim - 1)
    if found[0]:
        return load_vector(space, Load(region, traction=unit))[:, 0], "traction"
    if found[1]:
        return load_vector(space, Load(region, body_force=unit))[:, 0], "body_force"
    weights = np.zeros(space.n_local)
    weights[space.region(region)] = 1.0
    return weights[space.owned_local], None


def dual(problem, goal, preconditioner):
    """The dual displacement. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
        Its matrix holds the tangent at the solution.
    goal : Goal
    preconditioner : PETSc.PC

    Returns
    -------
    ndarray (n_owned, d)
    """
    space, matrix = problem.space, problem.matrix.matrix
    right, z = space.vector(), space.vector()
    problem.as_residual(goal.slope.copy(), right)
    if right.norm() > 0.0:
        transpose = matrix.transpose(PETSc.Mat())
        near = matrix.getNearNullSpace()
        transpose.setBlockSize(space.dim)
        transpose.setNearNullSpace(near)
        solve(space, transpose, preconditioner, right, z)
        transpose.destroy()
    problem.follow(z)
    values = z.getArray(readonly=True).reshape(-1, space.dim).copy()
    return values if goal.lift is None else values + goal.lift


def solve(space, matrix, preconditioner, right, z):
    """Solve a linear system so well that what follows does not depend on how ranks share the mesh. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    matrix : PETSc.Mat
    preconditioner : PETSc.PC
        Where factors would take more than many iterations.
    right, z : PETSc.Vec
        `z` is set.
    """
    ksp = PETSc.KSP().create(comm=space.comm)
    ksp.setType("gmres")
    ksp.setTolerances(rtol=DUAL_RTOL, max_it=DUAL_ITERATIONS)
    factors = _factors(space, matrix)
    for one in filter(None, (factors, preconditioner)):
        ksp.setPC(one)
        ksp.setOperators(matrix, matrix)
        ksp.solve(right, z)
        # of a body that nothing holds there are no factors
        if ksp.getConvergedReason() > 0:
            break
    ksp.destroy()
    if factors is not None:
        factors.destroy()


def _factors(space, matrix):
    """Factors of a matrix as a preconditioner, where they take less than many iterations to `DUAL_RTOL`: in the plane;
    else None. *Collective.*

    A punch on 17,254 unknowns takes 0.25 s so, and 1.7 s with the multigrid of Newton's method.
    """
    if space.dim != 2 or not can_factorise(space.comm.size, space.dim, space.n_dofs):
        return None
    pc = PETSc.PC().create(comm=space.comm)
    pc.setType("lu")
    if space.comm.size > 1:
        pc.setFactorSolverType("mumps")
    pc.setFactorPivot(LEAST_PIVOT)
    pc.setOperators(matrix, matrix)
    return pc
