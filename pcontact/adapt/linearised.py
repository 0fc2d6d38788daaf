"""What another setting of the contacts changes in a solution, to first order.

With R the forces of the solution u and R' those of the other setting at the same u, the change is what the tangent
answers to R - R': one search, one residual and one linear solve, where a run begins anew. It holds where nothing
remembers what has happened, so that the last load step alone tells the change.
"""

from dataclasses import replace

import numpy as np

from pcontact.adapt.variants import finer_quadrature, smooth_facets
from pcontact.estimate import pressures
from pcontact.pairs import contact_reports
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD
from pcontact.runtime.petsc import MPI


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


def own_reports(simulation, watch):
    """The same of the scene of the run itself, which are made once. *Collective.*"""
    if watch.reports is None:
        watch.reports = reports_of(simulation, simulation.scene, watch)
    return watch.reports


def forces_of(simulation, reports):
    """Forces (n_owned, d) of contacts in the solution of a run, by their names. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run.
    reports : list of pcontact.contact.report.ContactReport
        Of :func:`reports_of`, or its own.
    """
    space, u, forces = simulation.problem.space, simulation.stepper.u, {}
    for report in reports:
        forces[report.name] = np.zeros((space.n_owned, space.dim))
        for pair in report.pairs:
            pair.residual(u, forces[report.name])
    return forces


def change(simulation, target, watch, before, after):
    """What another setting of contacts brings about. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run, with an estimate.
    target : pcontact.scene.target.Target
        Of what the change counts.
    watch : pcontact.adapt.watch.Watch
    before, after : list of pcontact.contact.report.ContactReport
        The contacts with both settings.

    Returns
    -------
    float
        As of :func:`pcontact.adapt.variants.difference`, with its sign.
    """
    one, other = (forces_of(simulation, reports) for reports in (before, after))
    forces = {name: other[name] - one[name] for name in one}
    total, estimate = sum(forces.values()), simulation.error_estimate
    step = estimate.answer(-total)
    if target.quantity == "energy":
        return 0.0 if step is None else estimate.norm(step)
    if target.quantity == "pressure":
        return _of_pressure(simulation, target.name, before, after, step)
    goal = estimate.goal(target, watch.record, simulation.stepper.u)
    moved = 0.0 if step is None else np.vdot(goal.slope, step.getArray(readonly=True).reshape(total.shape))
    if goal.lift is not None:
        # the slope is that of the dual problem, which has the support's forces with the other sign
        moved -= np.vdot(goal.lift, total)
    if goal.shift is not None:
        moved += np.vdot(goal.shift, forces[goal.contact])
    # the dual problem of a support has its force with the other sign
    return goal.sign * simulation.comm.allreduce(float(moved), op=MPI.SUM)


def _of_pressure(simulation, name, before, after, step):
    """The change of a pressure in L2; where the points of the settings differ, at those of the setting before.
    *Collective.*"""
    u, moved = simulation.stepper.u, simulation.stepper.u.copy()
    if step is not None:
        moved.axpy(1.0, step)
    one, other = (next(report for report in reports if report.name == name) for reports in (before, after))
    own = pressures.of_contact(one, u)
    for report in (other, one):
        distance = pressures.apart(simulation.comm, own, pressures.of_contact(report, moved))
        if np.isfinite(distance):
            break
    return distance


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
        here = own_reports(simulation, watch)
        found = {}
        for name in names:
            if name == "frozen_partners":
                before, after = simulation.problem.contacts, here
            else:
                before, after = here, reports_of(simulation, others[name], watch)
            found[name] = change(simulation, target, watch, before, after)
        return found
    except TOLD:
        return dict.fromkeys(names, float("nan"))
