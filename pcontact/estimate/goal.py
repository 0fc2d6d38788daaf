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
    displacement  the mean over the region

each in its own direction d, or one component of it.

The pressure of a contact has its values at the points of its sources, a norm in L2, and a distance to another one: that
the norms of two pressures hardly differ says little of how far they are apart: what waves along a contact leaves the
norm as it is.

The active set of the dual problem is which points of contact count as closed in it.

From u_h to u the pressure P(tau) of Nitsche's method changes by H (tau - tau_h), H being the mean of the law's
derivative between both: 1 where a point stays closed, 0 where it stays open. A dual problem with another H than this
mean misses

    int (H - H_mean) (tau - tau_h) [[z]]

of the error of its quantity, [[z]] being the jump of the dual displacement along the normal. Where H = 1 the jump falls
with the mesh. Where H = 0 nothing keeps it small, and between both the dual displacement has kinks, which the cells do
not follow. So points that are open count as closed where the bodies are pressed on each other around them: where the
source's stress averaged at the nodes is pressure, and not much less than what opens the point. Gaps between the facets
of two meshes open such points. With the averaged normal traction in the place of tau H_mean is tau / (tau - tau_h)
there. In space that is not done: on coarse meshes the averaged stress is pressure far beyond the edge of what is
closed. The support of a roller that is pushed across a block, 11,319 unknowns: estimated with 0.01 % so, where 1.4 %
are true.
"""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.item import LAW, StatusRule
from pcontact.assembly.loads import region_weights
from pcontact.contact.law import OPEN
from pcontact.element.reference import shape
from pcontact.estimate.tractions import source_points
from pcontact.runtime.petsc import LEAST_PIVOT, MPI, PETSc, can_factorise
from pcontact.scene.model import Load

# [-] H_mean from which a point counts as closed. From: a laminate wound around wood (wound of named_error.py) on 6 and
# 12 facets in a quarter, cells halved up to three times: 0.1 leaves points open that spoil the estimate, 0.02 closes
# hardly any more.
LEAST = 0.05


def rules(estimator, problem, u):
    """The rules of pairs (a dict of :class:`pcontact.assembly.item.StatusRule`) in whose dual problems more points are
    closed than at the solution `u`. *Collective.*"""
    space, found, averaged = problem.space, {}, None
    if space.dim == 3:
        return found
    for contact in problem.contacts:
        if contact.contact.formulation != "nitsche" or contact.contact.bilateral or contact.law.tied:
            continue
        for pair, state in zip(contact.pairs, contact.states(u), strict=True):
            open_ = state["paired"] & (state["status"] == OPEN)
            if not space.comm.allreduce(bool(open_.any()), op=MPI.LOR):
                continue
            averaged = estimator.averaged_stress(space.local.gather(u)) if averaged is None else averaged
            tau = state["normal_stress"] + pair.method.gamma * state["gap"]
            closes = open_ & closing(tau, _normal_traction(space, pair, state, averaged))
            if space.comm.allreduce(bool(closes.any()), op=MPI.LOR):
                found[pair] = StatusRule(closed=closes | (state["status"] > OPEN))
    return found


def closing(tau, true):
    """Points (n,) that count as closed, of open ones with augmented normal tractions `tau` (n,), which are not
    negative, and those of the averaged stress `true` (n,)."""
    return (true < 0.0) & (-true >= LEAST * (tau - true))


def _normal_traction(space, pair, state, averaged):
    """Normal traction (np,) of the averaged stress at the points of the source [stress]."""
    result = np.zeros(len(state["weight"]))
    for number, (p, rows, xi) in source_points(space, pair).items():
        block = space.mesh.blocks[number]
        at = shape(block.cell, space.degree_of(block), xi)
        stress = np.einsum("pn,pnij->pij", at, averaged[number][rows])
        result[p] = np.einsum("pi,pij,pj->p", state["normal"][p], stress, pair.source.normal[p])
    return result


class SourcePressure(NamedTuple):
    """On the source of a pair.

    Attributes
    ----------
    x : ndarray (np, d)
        Reference positions of its points [length].
    weight, value : ndarray (np,)
        Area of the points, times the weight of the pair, and pressure [stress].
    """

    x: np.ndarray
    weight: np.ndarray
    value: np.ndarray


def of_contact(contact, u):
    """The pressure of a contact: a list of :class:`SourcePressure`, of its pairs. *Collective.*"""
    return [SourcePressure(state["x"], state["weight"], state["pressure"]) for state in contact.states(u)]


def named(problem, name, u):
    """That of the contact of a name. *Collective.*"""
    return of_contact(next(one for one in problem.contacts if one.name == name), u)


def norm(comm, pressures):
    """Norm in L2 of a list of :class:`SourcePressure`. *Collective.*"""
    own = sum(float(one.weight @ one.value**2) for one in pressures)
    return float(np.sqrt(comm.allreduce(own, op=MPI.SUM)))


def apart(comm, one, other):
    """Distance of two pressures, lists of :class:`SourcePressure`, in L2; nan where their points are not the same.
    *Collective.*"""
    total, same = 0.0, True
    for a, b in zip(one, other, strict=True):
        same &= a.x.shape == b.x.shape and np.allclose(a.x, b.x, rtol=1e-9, atol=0.0)
        total += float(a.weight @ (a.value - b.value) ** 2) if same else 0.0
    if not comm.allreduce(bool(same), op=MPI.LAND):
        return float("nan")
    return float(np.sqrt(comm.allreduce(total, op=MPI.SUM)))


# [-] Of the dual solve. From: a laminate that is wound around wood; with 1e-5 the parts that cells have in the error of
# a force differ by 0.3 % between one rank and two, whose preconditioners differ, and with them the next mesh; with 1e-7
# by less than 0.01 %.
DUAL_RTOL = 1e-7
# [iterations] Of the dual solve at most. From: chosen.
DUAL_ITERATIONS = 400
# by quantity, the table of a load step's record that has its names
RECORDS = {"force": "contacts", "support": "reactions", "displacement": "probes"}


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
    bound : float
        The product of the estimates of both displacements in the energy norm: contributions of cells may cancel by
        chance, or lie far from where the other displacement has its error, and this does not.
    """

    value: float
    error: float
    cells: list
    loads: float = 0.0
    algebraic: float = 0.0
    bound: float = np.inf


def place_of(target, record):
    """Name of the contact, region or probe of a target, and the axis of its component or None."""
    return target.of_known(record[RECORDS[target.quantity]])


def _direction(vector, axis=None):
    """Direction of an axis, or of the vector; along the first axis where there is none."""
    if axis is not None:
        return np.eye(len(vector))[axis]
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


def contact_force(problem, contact, force, u, rules=None, axis=None):
    """The force of a contact on its source, along itself or an axis, from that of the report; `rules` of pairs are
    those of :func:`rules`. *Collective.*"""
    space, direction = problem.space, _direction(force, axis)
    phi = _beside(space, contact.contact)[space.owned_local][:, None] * direction
    if problem.features.lower is not None:
        problem.features.lower.follow(phi)
    # the residual has the force on the source with the other sign, and so has the report, on the target
    slope = transposed(space, contact.pairs, u, phi, rules)
    return Goal(float(direction @ force), slope, contact=contact.name, shift=phi)


def support_force(problem, region, force, u, rules=None, axis=None):
    """The force of a support; see :func:`contact_force`. *Collective.*"""
    space, supports = problem.space, problem.conditions.supports
    names = [number for number, name in enumerate(supports.regions) if name == region]
    held = np.isin(supports.which[space.owned_local], names)
    direction = _direction(force, axis)
    phi = held * direction
    for group in problem.conditions.groups:
        group.follow(phi)
    slope = transposed(space, problem.items, u, phi, rules)
    return Goal(float(direction @ force), -slope, phi, -1.0)


def probe(problem, region, u, axis=None):
    """The mean displacement of a region, over its area or volume, in its direction or along an axis. *Collective.*"""
    space, d = problem.space, problem.space.dim
    values = u.getArray(readonly=True).reshape(-1, d)
    weights, total, key = region_weights(space, region)
    mean = space.comm.allreduce(weights @ values / total, op=MPI.SUM)
    direction = _direction(mean, axis)
    slope = weights[:, None] * direction / total
    load = None if key is None else Load(region, **{key: (direction / total).tolist()})
    return Goal(float(mean @ direction), slope, load=load)


def value(problem, target, record, u):
    """A quantity of a load step with a record, as it is named with an error to reach; of the pressure its norm in L2.
    *Collective.*"""
    if target.quantity == "pressure":
        return norm(problem.space.comm, named(problem, target.name, u))
    name, axis = place_of(target, record)
    if target.quantity == "displacement":
        return probe(problem, name, u, axis).value
    force = record["contacts"][name]["force"] if target.quantity == "force" else record["reactions"][name]
    return float(_direction(force, axis) @ force)


def dual(problem, goal, preconditioner):
    """The dual displacement (n_owned, d) of a goal of a problem whose matrix holds the tangent at the solution.
    *Collective.*"""
    space, matrix = problem.space, problem.matrix.matrix
    right, z = space.vector(), space.vector()
    problem.as_residual(goal.slope.copy(), right)
    if right.norm() > 0.0:
        solve(space, matrix, preconditioner, right, z, transposed=True)
    problem.conditions.follow(z)
    values = z.getArray(readonly=True).reshape(-1, space.dim).copy()
    return values if goal.lift is None else values + goal.lift


def solve(space, matrix, preconditioner, right, z, transposed=False):
    """Solve a linear system so well that what follows does not depend on how ranks share the mesh. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    matrix : PETSc.Mat
    preconditioner : PETSc.PC
        Of Newton's method: its factors serve a tangent that is nearly the same. Where it has none, factors in the plane
        take less than many iterations; of a body that nothing holds there are none.
    right, z : PETSc.Vec
        `z` is set.
    transposed : bool
        Whether the matrix is to be transposed.
    """
    ksp = PETSc.KSP().create(comm=space.comm)
    ksp.setType("gmres")
    ksp.setTolerances(rtol=DUAL_RTOL, max_it=DUAL_ITERATIONS)

    def converges(pc, operator, run):
        ksp.setPC(pc)
        ksp.setOperators(operator, operator)
        run(right, z)
        return ksp.getConvergedReason() > 0

    run, made = ksp.solveTranspose if transposed else ksp.solve, []
    if preconditioner.getType() != "lu" or not converges(preconditioner, matrix, run):
        factors = _factors(space, matrix)
        made += [] if factors is None else [factors]
        if factors is None or not converges(factors, matrix, run):
            if transposed:
                near, matrix = matrix.getNearNullSpace(), matrix.transpose(PETSc.Mat())
                matrix.setBlockSize(space.dim)
                matrix.setNearNullSpace(near)
                made.append(matrix)
            converges(preconditioner, matrix, ksp.solve)
    for one in (ksp, *made):
        one.destroy()


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
