"""Where the work that loads and supports do goes: stored, dissipated by plastic flow, lost in contact.

Works are sums over the load steps of forces times motions of nodes, by the trapezoidal rule: with forces R at both ends
of a load step and the motion du in it, 1/2 (R_k + R_k+1) . du. What bodies store, and what their plastic flow has
dissipated, are functions of their state; so the balance

    loads + supports + obstacles + heat = stored + plastic + contacts + springs + viscous + snaps

and with inertia

    initial + loads + ... = kinetic + damping + numerical + stored + ...

holds as far as load steps are short and equations are solved. Heat supplies what temperature changes of the elastic
energy 1/2 (eps - alpha dT) C (eps - alpha dT) while nothing moves: with the thermal forces f and the energy c of cells
that are kept from expanding, -1/2 (u_k + u_k+1) . (f_k+1 - f_k) + c_k+1 - c_k in a load step, and where laws depend on
temperatures what these supply to the stress that is not linear (:meth:`Solid.heat_beyond`). What inertia and damping
take up in the same sums is kinetic energy, a function of the state, the damping, and what the integrator dissipates
(numerical): none with the trapezoidal rule, whose sums these are.
"""

import numpy as np

from pcontact.assembly.item import Sum
from pcontact.runtime import profile
from pcontact.runtime.parallel import kept_rows, take_rows
from pcontact.runtime.petsc import MPI

# prefix of names in a checkpoint
CARRIED = "energy_"
# what takes energy, beside the bodies and contacts
TAKEN = ("springs", "viscous", "snaps", "kinetic", "damping", "numerical", "gone")


class EnergyBalance:
    """Works and energies of a run, summed up load step by load step.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    before : sequence of pcontact.scene.model.Scene
        Of the phases before, whose works stay in the balance.
    changing : bool
        Whether bodies come and go.

    Attributes
    ----------
    name : str
        In checkpoints.
    sums : dict of str to Sum
        Works so far [force * length]: ``loads``, ``supports`` and ``obstacles`` do them on the bodies, which do those
        of ``bodies`` (against their stresses), ``springs``, ``viscous``, ``snaps`` and ``contact NAME`` (what is lost
        there); ``heat`` without the energy of cells kept from expanding; with inertia ``initial``, the energy that
        is there at the beginning, ``damping``, and ``inertia``: with it, kinetic energy and what the integrator
        dissipates; ``gone``, what bodies held that are there no more.
    """

    name = "energy"

    def __init__(self, problem, before=(), changing=False):
        self._problem, space = problem, problem.space
        self._others = self._others_of(problem)
        kinds = ["loads", "supports", "bodies", *dict.fromkeys(kind for *_, kind in self._others)]
        if any(pair.rigid for contact in problem.contacts for pair in contact.pairs):
            kinds.append("obstacles")
        for scene in before:
            kinds += ["springs"] if scene.springs else []
            kinds += [f"contact {contact.name}" for contact in scene.contacts]
            kinds += ["obstacles"] if any(contact.obstacle for contact in scene.contacts) else []
        kinds += ["heat"] if problem.bulk.heat is not None else []
        if problem.features.inertia is not None or any(scene.dynamics is not None for scene in before):
            kinds += ["initial", "inertia", "damping"]
        kinds += ["gone"] if changing else []
        self.sums = {kind: Sum() for kind in dict.fromkeys(kinds)}
        # forces at the end of the last load step, with the sign of the residual: of loads, supports, bodies, items
        names = ["loads", "supports", "bodies", *(name for name, *_ in self._others)]
        names += ["heat"] if "heat" in self.sums else []
        self._last = {name: np.zeros((space.n_owned, space.dim)) for name in names}
        self._record = None

    @staticmethod
    def _others_of(problem):
        """Items but the bodies: what their forces are called in checkpoints, they, and to which sums these add."""
        of_contacts = {id(pair): f"contact {contact.name}" for contact in problem.contacts for pair in contact.pairs}
        springs = {id(spring) for spring in problem.features.springs}
        result = []
        for k, item in enumerate(problem.others):
            kind = "springs" if id(item) in springs else "viscous" if item is problem.features.viscous else "loads"
            kind = "inertia" if item is problem.features.inertia else "snaps" if item is problem.features.snap else kind
            result.append((f"item {k}", item, of_contacts.get(id(item), kind)))
        return result

    @property
    def carried(self):
        """What a restarted run goes on with."""
        return {f"{CARRIED}{kind.replace(' ', '_')}": one for kind, one in self.sums.items()}

    def account(self, u, before, begin, end):
        """Add the works of a load step from ``before`` to ``u``, which are not committed yet. *Collective.*

        Parameters
        ----------
        u, before : PETSc.Vec
        begin, end : float
            Of the load step [time].

        Returns
        -------
        ndarray (n_owned, d)
            Internal plus contact minus external forces, see :meth:`pcontact.solve.problem.Problem.unbalanced`.
        """
        problem, forces = self._problem, self._forces(u)
        values, start = map(problem.space.of_owned, (u, before))
        moved, own = values - start, dict.fromkeys(self.sums, 0.0)

        def work(name, motion):
            return 0.5 * float(np.sum((self._last[name] + forces[name]) * motion))

        for name, sign in (("loads", -1.0), ("supports", -1.0), ("bodies", 1.0)):
            own[name] += sign * work(name, moved)
        if "heat" in own:
            own["heat"] -= 0.5 * float(np.sum((forces["heat"] - self._last["heat"]) * (values + start)))
            own["heat"] += problem.bulk.heat_beyond(u, before, begin)
        for name, item, kind in self._others:
            if kind == "loads":
                own[kind] -= work(name, moved)
                continue
            own[kind] += work(name, moved)
            if kind.startswith("contact") and item.rigid:
                given = -work(name, self._with_obstacle(item, start, values, begin, end))
                own["obstacles"] += given
                own[kind] += given
        if problem.features.inertia is not None:
            own["damping"] += problem.features.inertia.damped(u)
        total = problem.space.comm.allreduce(np.array([own[kind] for kind in self.sums]), op=MPI.SUM)
        for one, number in zip(self.sums.values(), total, strict=True):
            one.carried += float(number)
        self._last = forces
        return -forces["supports"]

    def _forces(self, u):
        """Those at ``u`` (n_owned, d), as of `_last`. *Collective.*"""
        problem = self._problem
        forces = {"loads": -problem.forces.external()}
        for name, item, _ in (("bodies", problem.bulk, ""), *self._others):
            with profile.phase("bulk_assembly" if item is problem.bulk else "contact_assembly"):
                forces[name] = np.zeros_like(forces["loads"])
                item.residual(u, forces[name])
        forces["supports"] = -np.sum(list(forces.values()), axis=0)
        return forces | ({"heat": problem.bulk.heat.forces} if "heat" in self.sums else {})

    def begin(self, u):
        """Begin a phase at ``u``, with the forces that its items exert there. *Collective.*"""
        self._last = self._forces(u)

    def held(self, u):
        """What bodies hold at a committed displacement, of which none of it goes with a phase: elastic and dissipated
        energy less what heat has supplied for it, and kinetic energy. *Collective.*"""
        problem = self._problem
        heat = 0.0 if problem.bulk.heat is None else problem.bulk.heat.energy()
        return sum(problem.bulk.energies(u)) - heat, problem.features.inertia.kinetic() if self._moves() else 0.0

    def _moves(self):
        inertia = self._problem.features.inertia
        return inertia is not None and inertia.begun

    def part_with(self, before, u):
        """Count as gone what bodies :meth:`held` at the end of the phase before and do not at the beginning ``u`` of
        this one: that of others. *Collective.*"""
        inner, kinetic = self.held(u)
        self.sums["gone"].carried += before[0] - inner
        if self._moves():
            self.sums["gone"].carried += before[1] - kinetic
            self.sums["inertia"].carried -= before[1] - kinetic

    def set_off(self, u, first):
        """Begin at ``u`` with inertia: what moves there, and what is strained at the beginning of a run (`first`), is
        energy that nobody has supplied. *Collective.*"""
        kinetic = self._problem.features.inertia.kinetic()
        self.sums["inertia"].carried += kinetic
        self.sums["initial"].carried += kinetic + (self._problem.bulk.energies(u)[0] if first else 0.0)
        self.begin(u)

    def take_impulse(self, u, before):
        """Supports have changed the kinetic energy from `before`, by impulses, at ``u``; only the forces of inertia are
        others than at the end of the last load step, and what bears them. *Collective.*"""
        inertia, forces = self._problem.features.inertia, np.zeros_like(self._last["supports"])
        for kind in ("inertia", "supports"):
            self.sums[kind].carried += inertia.kinetic() - before
        name = next(name for name, item, _ in self._others if item is inertia)
        inertia.residual(u, forces)
        self._last["supports"] -= forces - self._last[name]
        self._last[name] = forces

    def _with_obstacle(self, pair, start, values, begin, end):
        """How nodes (n_owned, d) would move with the obstacle of a pair [length]."""
        space, search = self._problem.space, pair.search
        x = space.points[space.owned_local] - search.origin
        there = search.target.moved(x + start, begin, end, search.origin)
        back = search.target.moved(x + values, end, begin, search.origin)
        return np.broadcast_to(0.5 * (np.asarray(there) - np.asarray(back)), start.shape)

    def record(self, u):
        """For the report, at a committed displacement. *Collective.*

        Returns
        -------
        dict
            The sums, those of contacts under ``contacts``; ``stored`` and, where bodies may yield, ``plastic``
            [force * length], and ``defect``, what is missing in the balance over the largest part of it. With inertia
            ``kinetic`` and ``numerical``, too.
        """
        result = {kind: one.carried for kind, one in self.sums.items() if not kind.startswith("contact ")}
        contacts = {kind[len("contact ") :]: one.carried for kind, one in self.sums.items() if kind not in result}
        if contacts:
            result["contacts"] = contacts
        stored, plastic = self._problem.bulk.energies(u)
        result["stored"] = stored
        if self._problem.bulk.yields:
            result["plastic"] = plastic
        if self._problem.features.snap is not None:
            # steps of motions are long: it knows better than the trapezoidal rule
            result["snaps"] = self._problem.features.snap.taken.carried
        if "heat" in result:
            result["heat"] += self._problem.bulk.heat.energy()
        if "inertia" in result:
            inertia = self._problem.features.inertia
            result["kinetic"] = 0.0 if inertia is None else inertia.kinetic()
            result["numerical"] = result.pop("inertia") - result["kinetic"] - result["damping"]
        taken = [stored, plastic, *contacts.values()]
        taken += [result[kind] for kind in TAKEN if kind in result]
        given = [result[kind] for kind in ("loads", "supports", "obstacles", "heat", "initial") if kind in result]
        most = max(abs(number) for number in [*taken, *given])
        result["defect"] = (sum(given) - sum(taken)) / most if most > 0.0 else 0.0
        return result

    # -- a checkpoint ---------------------------------------------------------------------------------------------

    def memory_keys(self):
        """Numbers (n_owned,) of the owned nodes."""
        return self._problem.space.keys

    def memory(self):
        """Forces at the end of the last load step."""
        return {name: kept_rows(self.memory_keys(), force) for name, force in self._last.items()}

    def recall(self, name, chunks):
        """See :meth:`pcontact.assembly.item.Item.recall`."""
        if name not in self._last:
            return None
        values = np.zeros_like(self._last[name])
        count = take_rows(self.memory_keys(), chunks, values)
        self._last[name] = values
        return count

    def counters(self):
        """Nothing is kept at points."""
        return {"points": 0, "work": 0}
