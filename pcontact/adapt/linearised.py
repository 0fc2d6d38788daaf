"""What another setting of the contacts changes in a solution, to first order.

With R the forces of the solution u and R' those of the other setting at the same u, the change is what the tangent
answers to R - R': one search, one residual and one linear solve, where a run begins anew. It holds where nothing
remembers what has happened, so that the last load step alone tells the change.
"""

from dataclasses import replace

import numpy as np

from pcontact.adapt.variants import finer_quadrature, smooth_facets
from pcontact.estimate.goal import DUAL_ITERATIONS, DUAL_RTOL
from pcontact.pairs import contact_reports
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD
from pcontact.runtime.petsc import MPI

# [-] Of the linear solve for the energy norm. From: to first order the change is hardly known better; in quantities its
# parts cancel, and they take the tolerance of dual problems.
RTOL = 0.01


def reports_of(simulation, scene, watch):
    """The contacts of a scene where the bodies of a run have ended, with the partners there. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run.
    scene : pcontact.scene.model.Scene
        Its own, with other settings of the contacts.
    watch : pcontact.adapt.watch.Watch
        Of `simulation`.

    Returns
    -------
    list of pcontact.contact.report.ContactReport
    """
    problem, u = simulation.problem, simulation.stepper.u
    tied = {number: one.pairs[0] for number, one in enumerate(problem.contacts) if one.law.tied}
    free = {number: range(modes) for number, modes in simulation.floating.items()}
    with log.quiet():
        reports, _ = contact_reports(scene, problem.space, problem.supports, free, problem.bulk, tied)
        for pair in (pair for report in reports if not report.law.tied for pair in report.pairs):
            # an initial overlap is that of the first search
            begin = problem.undeformed(pair)
            pair.detect(begin, watch.times[0])
            pair.commit(begin, 0.0)
            pair.detect(u, watch.time)
    return reports


def forces_of(simulation, scene, watch):
    """Forces (n_owned, d) of the contacts of a scene, by their names; see :func:`reports_of`. *Collective.*"""
    problem, u = simulation.problem, simulation.stepper.u
    return {report.name: _forces(problem, report, u) for report in reports_of(simulation, scene, watch)}


def own_forces(simulation):
    """Forces of the contacts of a run as they are, see :func:`forces_of`. *Collective.*"""
    problem, u = simulation.problem, simulation.stepper.u
    return {report.name: _forces(problem, report, u) for report in problem.contacts}


def _forces(problem, report, u):
    out = np.zeros((problem.space.n_owned, problem.space.dim))
    for pair in report.pairs:
        pair.residual(u, out)
    return out


def change(simulation, target, watch, before, after):
    """What the change of the forces of contacts brings about. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run, with an estimate.
    target : pcontact.scene.target.Target
        Of what the change counts; not of the pressure.
    watch : pcontact.adapt.watch.Watch
    before, after : dict of str to ndarray (n_owned, d)
        Of :func:`forces_of`.

    Returns
    -------
    float
        As of :func:`pcontact.adapt.variants.difference`.
    """
    forces = {name: after[name] - before[name] for name in before}
    total, estimate = sum(forces.values()), simulation.error_estimate
    step = estimate.answer(-total, RTOL if target.quantity == "energy" else DUAL_RTOL, DUAL_ITERATIONS)
    if target.quantity == "energy":
        return 0.0 if step is None else estimate.norm(step)
    goal = estimate.goal(target, watch.record, simulation.stepper.u)
    moved = 0.0 if step is None else np.vdot(goal.slope, step.getArray(readonly=True).reshape(total.shape))
    if goal.lift is not None:
        # the slope is that of the dual problem, which has the support's forces with the other sign
        moved -= np.vdot(goal.lift, total)
    if goal.shift is not None:
        moved += np.vdot(goal.shift, forces[goal.contact])
    return abs(simulation.comm.allreduce(float(moved), op=MPI.SUM))


def changes(simulation, target, watch, names):
    """What settings change to first order, by their names; nan where one is none for the scene. *Collective.*

    Parameters
    ----------
    simulation, target, watch
        As for :func:`change`.
    names : sequence of str
        Of `pcontact.adapt.passes.NAMES`: the search, the quadrature, the facets.

    Returns
    -------
    dict of str to float
    """
    scene, degree = replace(simulation.scene), simulation.problem.space.degree
    others = {"quadrature": finer_quadrature(scene, degree), "straight_facets": smooth_facets(scene),
              "curved_facets": smooth_facets(scene)}  # fmt: skip
    try:
        here = forces_of(simulation, scene, watch)
        found = {}
        for name in names:
            if name == "frozen_partners":
                found[name] = change(simulation, target, watch, own_forces(simulation), here)
            else:
                found[name] = change(simulation, target, watch, here, forces_of(simulation, others[name], watch))
        return found
    except TOLD:
        return dict.fromkeys(names, float("nan"))
