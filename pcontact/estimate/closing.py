"""Which points of contact count as closed in a dual problem.

From u_h to u the pressure P(tau) of Nitsche's method changes by H (tau - tau_h), H being the mean of the law's
derivative between both: 1 where a point stays closed, 0 where it stays open. A dual problem with another H than this
mean misses

    int (H - H_mean) (tau - tau_h) [[z]]

of the error of its quantity, [[z]] being the jump of the dual displacement along the normal. Where H = 1 the jump falls
with the mesh. Where H = 0 nothing keeps it small, and between both the dual displacement has kinks, which the cells do
not follow. So points that are open count as closed where the bodies are pressed on each other around them: where the
source's stress averaged at the nodes is pressure, and not much less than what opens the point. Gaps between the
facets of two meshes open such points. With the averaged normal traction in the place of tau H_mean is
tau / (tau - tau_h) there. In space that is not done: on coarse meshes the averaged stress is pressure far beyond the
edge of what is closed. The support of a roller that is pushed across a block, 11,319 unknowns: estimated with 0.01 %
so, where 1.4 % are true.
"""

import numpy as np

from pcontact.assembly.item import StatusRule
from pcontact.contact.law import OPEN
from pcontact.element.shape import shape
from pcontact.estimate.tractions import source_points
from pcontact.runtime.petsc import MPI

# [-] H_mean from which a point counts as closed. From: a laminate wound around wood (wound of named_error.py) on 6 and
# 12 facets in a quarter, cells halved up to three times: 0.1 leaves points open that spoil the estimate, 0.02 closes
# hardly any more.
LEAST = 0.05


def rules(estimator, problem, u):
    """The rules of pairs in whose dual problems more points are closed than at the solution. *Collective.*

    Parameters
    ----------
    estimator : pcontact.estimate.estimator.Estimator
    problem : pcontact.solve.problem.Problem
    u : PETSc.Vec
        The solution.

    Returns
    -------
    dict of pcontact.contact.pair.ContactPair to pcontact.assembly.item.StatusRule
    """
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
