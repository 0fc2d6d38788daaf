"""The scalars of a load step: what the report and the history hold."""

import numpy as np

from pcontact.assembly.loads import region_weights
from pcontact.assembly.measures import Relief
from pcontact.contact.active_set import DEEPER
from pcontact.material.elastic import equivalent_stress
from pcontact.mesh.mesh import bounding_box
from pcontact.runtime import log
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.solve.convergence import MOVED, NEARLY
from pcontact.solve.problem import ROUNDINGS
from pcontact.stepping.loose import Announcer

# [-] Part of the forces of the run that may be out of balance without a word. From: chosen, as BALANCED of
# convergence.py.
UNBALANCED = 1e-3
# [-] Part of the forces at work that rounding errors may be without a word. From: two blocks pressed together, one 1e8
# to 1e12 times as stiff as the other and the more movable one: the pressure is wrong by a fifth to all of that part.
ROUNDING_PART = 1e-4
# [-] Part of the work of the stresses that a viscous stabilisation may take up without a word. From: chosen, as
# UNBALANCED.
VISCOUS = 1e-3
# [-] Part of the energy that there is which may be missing, or come from nowhere in a motion, without a word.
# From: chosen, of the order of what integrators dissipate in an impact.
ENERGY_PART = 1e-2
# [-] What bodies give way to is asked of the tangent to this part. From: what is said of it then depends on the number
# of ranks by no more than other numbers do.
SECOND_RTOL = 1e-11
# [-] Iterations that it may take. From: chosen, some times as many as a linear solve takes.
SECOND_ITERATIONS = 400
# [load steps] For so long all points have been open where what contact stores is nothing. From: chosen, longer than
# points of bodies that part open and close.
PARTED = 10


class Recorder:
    """Collects the record of a step from the problem.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    probes : list of str
        Regions whose displacement is recorded.
    bodies : sequence of str, optional
        Their regions. Absent: nothing is said of where small strain ends, and how far finite strain goes.
    phase : str, optional
        Name of the phase of the run.
    absent : list of str, optional
        Bodies that are not there in it, in a run in which some come or go.
    energy : pcontact.stepping.energy.EnergyBalance, optional
    newton : pcontact.solve.newton.Newton, optional
        It says what bodies give way to; absent: nothing is known of that.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, problem, probes, bodies=(), phase=None, absent=None, energy=None, newton=None):
        self._phase, self._absent, self._energy = phase, absent, energy
        # the largest sum of magnitudes of the run so far, which a restarted run goes on with
        self._problem, self.carried, self._told = problem, 0.0, set()
        # the largest of the norms of the forces at work so far
        self._acting, self._parted = 0.0, 0
        self._announce = Announcer(problem.space.mesh.component_names)
        space = problem.space
        self._bodies, self._held = bodies, _held(problem) if bodies else None
        # the tangent of a motion has the masses in it
        known = newton is not None and problem.features.inertia is None
        self._newton, self._relief = newton, Relief(self._answer, len(bodies)) if known else None
        owned = np.zeros(space.n_local, dtype=bool)
        owned[space.owned_local] = True
        self._probes = {}
        for name in probes:
            nodes, (weights, total, _) = space.region(name), region_weights(space, name)
            self._probes[name] = nodes[owned[nodes]], weights / (total or 1.0)

    @property
    def relieved(self):
        """What a restarted run goes on with of what its bodies give way to."""
        return {} if self._relief is None else {f"relief_{k}": one for k, one in enumerate(self._relief.sums)}

    def __call__(self, step, u):
        """Record of a converged step, the same on every rank. *Collective.*

        Parameters
        ----------
        step : pcontact.stepping.stepper.Step
        u : PETSc.Vec

        Returns
        -------
        dict
            As in ``report.json``.
        """
        problem, unbalanced = self._problem, step.unbalanced
        features = problem.features
        if features.lower is not None:
            # bodies of degree 1: what is on nodes that follow is on the vertices
            unbalanced = unbalanced.copy()
            features.lower.lead(unbalanced)
        found = {}
        for part in problem.parts:
            for section, entries in part.report(u).items():
                found[section] = {**found.get(section, {}), **entries}
        record = {"time": step.time, **({} if self._phase is None else {"phase": self._phase})}
        record |= {} if self._absent is None else {"absent": list(self._absent)}
        record |= {
            "newton": step.newton,
            "krylov": step.krylov,
            "krylov_most": step.hardest,
            "cutbacks": step.cutbacks,
            "reactions": problem.forces.reactions(u, unbalanced),
            "contacts": found.pop("contacts", {}),
            "probes": {name: self._probe(*probe, u) for name, probe in self._probes.items()},
            "plastic": self._plastic(),
            "largest": largest(problem, u),
        }
        if self._bodies:
            record["small_strain"] = self._distortions(u)
            stretched = problem.bulk.deformations(u)
            if stretched:
                record["finite_strain"] = {self._bodies[body]: one._asdict() for body, one in stretched.items()}
        if problem.conditions.supports.turns:
            record["moments"] = problem.forces.moments(u, unbalanced)
        if "viscous" in found:
            self._warn_of_viscosity(step.time, found["viscous"]["ratio"])
        if self._energy is not None:
            record["energy"] = self._energy.record(u)
        record |= found
        if "energy" in record:
            self._warn_of_energy(step.time, record)
        if features.total:
            record["loads"] = {load.name: load.record(u, step.time) for load in features.total}
        moved = problem.space.of_owned(u)
        averages = {one.name: one.record(moved, unbalanced) for one in features.averages}
        if features.equations is not None and features.equations.said:
            # those of mean motions are among them
            force = np.array(features.equations.record(unbalanced)["force"])
            own = sum((np.array(one["force"]) for one in averages.values()), np.zeros_like(force))
            record["equations"] = {"force": (force - own).tolist()}
        groups = problem.conditions.groups
        couplings = [one for one in groups if one not in features.sections and one is not features.equations]
        if couplings:
            averages |= {group.name: group.record(moved, unbalanced) for group in couplings}
        if averages:
            record["couplings"] = averages
        if features.sections:
            forces = unbalanced.copy()
            if features.release is not None:
                features.release.draw(forces)
            record["pretensions"] = {one.name: one.record(moved, forces, step.time) for one in features.sections}
        if problem.space.axisymmetric:
            _name_components(record)
        self._warn_of_lost(step, record["contacts"])
        if step.uzawa is not None:
            record["uzawa"] = step.uzawa
        if any(item.verifies for item in problem.others):
            record["partners"] = step.partners or {"searches": 0}
        if step.free is not None:
            record["free"] = self._announce(step.time, step.free, step.number == 1)
            record["free_bodies"] = len(step.free)
        return {**record, "imbalance": self._imbalance(step.time, u, record, unbalanced)}

    def _imbalance(self, time, u, record, unbalanced):
        """Resultant of all forces over the sum of their magnitudes; warn where it, or the residual, is not small.
        *Collective.*

        Residuals of rings, and of all that is symmetric, have no resultant.
        """
        problem, left = self._problem, unbalanced.copy()
        problem.conditions.condense(left)
        borne = unbalanced - left
        total, residual = problem.forces.resultant(record, u), problem.forces.norm(left)
        # the largest sum of the run: bodies that have parted leave nothing to compare with
        self.carried = max(self.carried, problem.forces.sum_of_magnitudes(u, borne))
        imbalance = total / self.carried if self.carried > 0.0 else 0.0
        if max(total, residual) <= UNBALANCED * self.carried:
            if problem.forces.acts(u, borne, NEARLY * ROUNDINGS):
                self._warn_of_rounding(time, u)
            return imbalance
        acts = problem.forces.loaded(u) > 0.0 or any(c["stick"] + c["slip"] for c in record["contacts"].values())
        if not acts and max(total, residual) <= MOVED * problem.forces.stiffness_scale(u):
            # bodies that move and do not touch: what Newton's method leaves is no part of any force
            return 0.0
        rounded = NEARLY * ROUNDINGS * problem.forces.roundoff(u)
        if total > ROUNDINGS * problem.forces.rounding_of_sum(u) or residual > rounded:
            why = "the residual that the tolerances leave does: smaller ones (-snes_rtol), or smaller load steps"
        elif problem.forces.acts(u, borne, NEARLY * ROUNDINGS):
            why = "rounding errors of the stresses hide them, the displacements are right only where they are imposed"
        else:
            # bodies that move, or touch, without any force leave rounding errors alone
            return 0.0
        log.warning("time %g: the forces are out of balance by %.2g %% of those of the run: %s", time,
                    100.0 * max(total, residual) / max(self.carried, np.finfo(float).tiny), why)  # fmt: skip
        return imbalance

    def _warn(self, key, text, *values):
        """Warn of what a key stands for, once in a run."""
        if key not in self._told:
            self._told.add(key)
            log.warning(text, *values)

    def _warn_of_lost(self, step, contacts):
        """Say once of every contact that its points were misled by partners that stay during a load step."""
        time, unverified = step.time, step.partners is None and any(one.verifies for one in self._problem.others)
        for name, contact in contacts.items():
            passed, left = contact["passed"], contact["left"]
            if passed or left:
                self._warn(
                    (name, "lost"), "time %g: contact %s: %d points are inside their partner that were open, %d that "
                    "were closed have left theirs: bodies went far in a load step; smaller load steps%s",
                    time, name, passed, left, ", or no -contact_search_again 0" if unverified else "",
                )  # fmt: skip
        for name in (step.partners or {}).get("unsettled", ()):
            self._warn(
                (name, "unsettled"), "time %g: contact %s: points at edges between facets find either by turns, which "
                "changes contact forces by up to %.2g %%, more than -contact_partner_rtol; remedy: more load steps, "
                "smaller cells there, or a larger -contact_partner_rtol",
                time, name, 100.0 * step.partners["change"],
            )  # fmt: skip
        for contact in self._problem.contacts:
            if contact.overlap > DEEPER:
                self._warn(
                    (contact.name, "overlap"), "time %g: contact %s: points are inside their partner by %.2g of the "
                    "size of their facet: the mesh does not resolve the contact, and there may be more than one "
                    "solution; remedy: smaller cells, smaller overlaps or loads, or a larger gamma0",
                    time, contact.name, contact.overlap,
                )  # fmt: skip
            if contact.sinks:
                depth = contacts[contact.name]["target_penetration"]
                self._warn(
                    (contact.name, "sinks"), "time %g: contact %s: a corner of %s is %.3g deep in %s, between its "
                    "points: forces are wrong; remedy: unbiased = true, or source and target exchanged",
                    time, contact.name, contact.contact.target, depth, contact.contact.source,
                )  # fmt: skip

    def _warn_of_viscosity(self, time, ratio):
        """Warn once where the work of the viscous stabilisation is not small beside that of the stresses."""
        if ratio > VISCOUS:
            self._warn(
                "viscous", "time %g: the viscous stabilisation has taken up %.2g %% of the work of the stresses "
                "(small: %g %%); where no body snaps or floats, a smaller viscous_stabilisation makes forces more "
                "accurate",
                time, 100.0 * ratio, 100.0 * VISCOUS,
            )  # fmt: skip

    def _warn_of_energy(self, time, record):
        """Say once that the energies do not add up, and once that contact and the integrator of a motion, which can but
        take some, have made some. What is closed may store some, and give it back."""
        energy = record["energy"]
        there = max(abs(value) for value in energy.values() if not isinstance(value, dict))
        missing = "is missing in their balance: remedy: smaller load steps"
        self._warn_of_part(time, missing, abs(energy["defect"]))
        inertia, methods = self._problem.features.inertia, [one.method for one in self._problem.contacts]
        closed = any(contact["stick"] or contact["slip"] for contact in record["contacts"].values())
        self._parted = 0 if closed else self._parted + 1
        if inertia is None or self._parted <= PARTED:
            return
        made = -sum(energy.get("contacts", {}).values()) - energy["numerical"]
        remedies = ["load steps that resolve the impact" + ("" if inertia.controls else " (step_error)")]
        if any(one.has_traction and one.theta != 1.0 for one in methods):
            remedies.append("theta = 1")
        remedies += ["smaller cells where bodies meet", *([] if inertia.damps else ['integrator = "hht"'])]
        words = f"has come from nowhere, by contact and integrator: remedy: {', '.join(remedies)}"
        self._warn_of_part(time, words, made / max(there, np.finfo(float).tiny))

    def _warn_of_part(self, time, words, part):
        if part > ENERGY_PART:
            self._warn(words, "time %g: %.2g %% of the energy of the bodies %s", time, 100.0 * part, words)

    def _warn_of_rounding(self, time, u):
        """Say once that a body is so stiff, and has moved so far, that rounding errors of its displacement show in the
        stresses. *Collective.*"""
        if "rounding" in self._told:
            return
        problem = self._problem
        self._acting = max(self._acting, problem.forces.acting(u))
        errors = problem.forces.roundoff_of(u)
        part = np.linalg.norm(errors) / self._acting if self._acting > 0.0 else 0.0
        if part > ROUNDING_PART:
            name = problem.space.mesh.component_names[int(np.argmax(errors))]
            self._warn(
                "rounding", "time %g: rounding errors of the displacement of %s, which moves and is far stiffer than "
                "the others, may make %.2g %% of the forces: stresses and contact pressures are no more accurate",
                time, name, 100.0 * part,
            )  # fmt: skip

    def _plastic(self):
        strain, volume = self._problem.bulk.plasticity()
        return {"max_equivalent_strain": float(strain), "yielded_volume": float(volume)}

    def _distortions(self, u):
        """Measure how far the bodies with small strain are from what it represents, by region. *Collective.*"""
        result = {}
        for number, found in self._problem.bulk.distortions(u, self._held, self._relief).items():
            result[self._bodies[number]] = {
                "error": float(max(found.errors)), "strain": found.strain, "rotation": found.rotation,
                "stiffening": found.stiffening, "place": list(found.place),
            }  # fmt: skip
        return result

    def _answer(self, u, forces):
        """The displacement that forces (n_owned, d) make beside those at work, and the loads (n_owned, d); None where
        the linear solver does not find it. *Collective.*"""
        try:
            answer, converged = self._newton.answer(forces, SECOND_RTOL, SECOND_ITERATIONS)
        except PETSc.Error:
            return None
        return (answer, self._problem.forces.applied(u)) if converged and answer is not None else None

    def _probe(self, nodes, weights, u):
        """Mean over the region, least and largest displacement of its nodes. *Collective.*"""
        space = self._problem.space
        comm, values = space.comm, space.local.gather(u)[nodes]
        low, high = bounding_box(comm, values)
        mean = comm.allreduce(weights @ space.of_owned(u), op=MPI.SUM)
        return {"mean": mean.tolist(), "min": low.tolist(), "max": high.tolist()}


def largest(problem, u):
    """Largest equivalent stress, equivalent plastic strain and displacement, and where they are. *Collective.*

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    u : PETSc.Vec

    Returns
    -------
    dict of str to dict
        ``value``, ``place`` in the undeformed bodies [length] and ``body``, the same on every rank: of cells their
        means and middles.
    """
    space, bulk = problem.space, problem.bulk
    moved = np.linalg.norm(space.of_owned(u), axis=1)
    node, component = space.owned_local, space.component
    own = {"displacement": _top(moved, lambda row: (space.points[node[row]], component[node[row]]))}
    cells = [(block.components, table) for block, table in zip(space.mesh.blocks, space.cells, strict=True)]
    fields = {"equivalent_stress": [equivalent_stress(values) for values, _ in bulk.stress(u)]}
    strain = bulk.plastic_strain()
    fields |= {} if strain is None else {"equivalent_plastic_strain": strain}
    for name, values in fields.items():
        tops = [_top(one, lambda row, at=at: (space.points[at[1][row]].mean(axis=0), at[0][row]))
                for one, at in zip(values, cells, strict=True)]  # fmt: skip
        own[name] = max(tops, key=lambda top: top[0], default=(0.0, None, 0))
    every, result = space.comm.allgather(own), {}
    for name in own:
        value, place, body = max((one[name] for one in every), key=lambda top: top[0])
        result[name] = {"value": value, "place": place, "body": space.mesh.component_names[body]}
    return result


def _top(values, where):
    """Largest of some values (n,), and what a function says of its row: place (d,) and component."""
    if not len(values):
        return -1.0, None, 0
    row = int(np.argmax(values))
    place, component = where(row)
    return float(values[row]), place.tolist(), int(component)


def _name_components(record):
    """With axial symmetry the first component of a force is no resultant: give it, and the other one, a name."""
    for contact in record["contacts"].values():
        contact["radial_sum"], contact["axial_force"] = contact["force"]
    record["radial_sums"] = {name: force[0] for name, force in record["reactions"].items()}


def _held(problem):
    """Flags (n_components,) of the connected components of which a displacement is prescribed. *Collective.*"""
    space, held = problem.space, np.zeros(problem.space.mesh.n_components, dtype=bool)
    held[space.component[problem.conditions.supports.fixed.any(axis=1)]] = True
    return space.comm.allreduce(held.astype(np.int64), op=MPI.SUM) > 0
