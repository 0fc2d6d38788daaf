"""Likely reasons of a load step that has failed: what a user can see only with difficulty."""

import numpy as np

from pcontact.mesh.mesh import size_of
from pcontact.runtime.petsc import PETSc
from pcontact.solve.convergence import BALANCED
from pcontact.solve.preconditioners import FAILED
from pcontact.solve.problem import ROUNDINGS

# [-] Part of the volume that may yield from which on a limit load is near. From: chosen; a sentence depends on it, no
# iteration.
YIELDED = 0.5


def diagnose(problem, u, reason, norm, loose=(), direct=False):
    """Sentences on the state in which Newton's method has ended without success. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    u : PETSc.Vec
    reason : str
        Of SNES.
    norm : float
        Of the residual [force].
    loose : collection of int
        Connected components that supports leave free.
    direct : bool
        Whether linear systems are factorised.

    Returns
    -------
    list of str
    """
    found = []
    size = size_of(problem.space.mesh)
    moved = u.norm(PETSc.NormType.NORM_INFINITY)
    if problem.bulk.extrapolates and not problem.integrable(u):
        found.append("cells are turned inside out: smaller load steps, or a prescribed displacement instead of a load")
    elif not problem.bulk.extrapolates and not moved <= size:
        found.append(
            f"displacements of {moved:.3g}, more than the size of the bodies ({size:.3g}): the load is too large for "
            f"small strains, or {_unheld(problem, u, loose) or 'nothing holds a body'}"
        )
    elif min(norm, problem.forces.loaded(u) or norm) <= ROUNDINGS * problem.forces.roundoff(u):
        found.append("rounding errors of the stresses hide the rest: the load is too small for these displacements")
    errors, acting = _rounding_of_contacts(problem, u), problem.forces.acting(u)
    worst = max(errors, key=errors.get, default=None)
    if worst is not None and errors[worst] > BALANCED * acting > 0.0:
        found = [
            f"rounding errors of the gap of contact {worst}, times its gamma, are {errors[worst]:.2g}, and the forces "
            f"{acting:.2g}: its gamma0 is too large"
        ]
    for one in problem.contacts:
        ratio, source, target = one.stiffer, one.contact.source, one.contact.target
        if ratio > 0.0 and one.law.can_slip:
            found.append(
                f"contact {one.name}: friction, and a source that is {ratio:.0f} times as stiff as the target: "
                f"Newton's method may go to and fro; remedy: source = {target!r}, target = {source!r}"
            )
    part = problem.bulk.flowing(u)
    if part >= YIELDED:
        found.append(f"{100.0 * part:.0f} % of what may yield does: the load may be beyond the limit load")
    if reason == FAILED:
        causes = [_unheld(problem, u, loose) or "bodies that nothing holds", "a limit load"]
        # theta = -1 is coercive for every gamma0, and springs are
        if any(one.method.has_traction and one.method.theta > -1.0 for one in problem.contacts):
            causes.append("a gamma0 below the bound of coercivity")
        words = f"the tangent is singular or nearly so: {', '.join(causes[:-1])} or {causes[-1]}"
        found.append(words + ("" if direct else "; another solver: -pc_type lu"))
    if not found and loose:
        found += [words for words in [_unheld(problem, u, loose)] if words]
    return found


def _unheld(problem, u, loose):
    """Words on bodies that no support holds, first those without a contact force in ``u``; empty without any.
    *Collective.*"""
    if not loose:
        return ""
    names, borne = problem.space.mesh.component_names, problem.active.borne(u)
    lost = [k for k in loose if borne[k] <= ROUNDINGS * problem.forces.roundoff(u)]
    listed = ", ".join(dict.fromkeys(names[k] for k in lost or loose))
    if not lost:
        return f"contact alone holds {listed}, and may not be able to: a support is missing"
    before = "contact has let go" if problem.active.touched()[lost].any() else "no contact held before this load step"
    return f"no support holds {listed}, which {before}: a support is missing, or a load that presses it on another body"


def _rounding_of_contacts(problem, u):
    """Norm of the rounding errors of the forces of every contact at ``u`` [force], by name. *Collective.*"""
    errors = {}
    for contact in problem.contacts:
        size = np.zeros((problem.space.n_owned, problem.space.dim))
        for pair in contact.pairs:
            pair.add_magnitude(u, size)
        errors[contact.name] = np.finfo(float).eps * problem.forces.norm(size)
    return errors
