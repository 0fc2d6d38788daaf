"""Forces on the bodies of a problem: loads, reactions, resultants, and how large they and their rounding errors are."""

import numpy as np

from pcontact.runtime.petsc import MPI

# [-] So many rounding errors of the sum of magnitudes, an exact solution would leave. From: sums of
# some eighty terms, whose rounding errors add up as the square root of their number.
ROUNDINGS = 8.0


class Forces:
    """Forces on the bodies of a problem at its time.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    loads : list of (ndarray (n_owned, d), callable)
        Nodal forces at factor 1 and their factor of time.

    Notes
    -----
    Whatever sums over nodes or components is the same on every rank.
    """

    def __init__(self, problem, loads):
        self._problem, self._space, self.loads = problem, problem.space, loads

    def _zero(self):
        return np.zeros((self._space.n_owned, self._space.dim))

    def external(self, time=None):
        """Nodal external forces (n_owned, d) at a time, or that of the problem [force]. *Collective.*"""
        total, time = self._zero(), self._problem.time if time is None else time
        for force, amplitude in self.loads:
            total += amplitude.factor(time) * force
        for load in self._problem.features.timed:
            total += load.at(time)
        return total

    def applied(self, u, springs=True):
        """Nodal external forces (n_owned, d), with those that depend on the displacement, of springs or without them
        [force]. *Collective.*"""
        total, left_out = self.external(), () if springs else self._problem.features.springs
        for item in self._problem.others:
            if item not in left_out:
                item.external(u, total)
        return total

    def _drag(self, u):
        """Forces (n_owned, d) on the bodies that answer their motions [force]. *Collective.*"""
        out = self._zero()
        for item in self._problem.others:
            item.drag(u, out)
        return out

    def norm(self, forces):
        """Norm over all ranks of forces (n_owned, d) [force]. *Collective.*"""
        return float(np.sqrt(self._space.comm.allreduce(float(np.sum(forces**2)))))

    def _magnitude(self, u):
        """Sums of the absolute terms of the residual at ``u`` (n_owned, d) [force]. *Collective.*"""
        size = self._zero()
        for item in self._problem.items:
            item.add_magnitude(u, size)
        return size

    def roundoff(self, u):
        """Norm of the rounding errors that the residual at ``u`` may carry [force]. *Collective.*"""
        return np.finfo(float).eps * self.norm(self._magnitude(u))

    def roundoff_of(self, u):
        """The same for the forces on every component (n_components,) [force]. *Collective.*"""
        return np.finfo(float).eps * self._space.norms(self._magnitude(u))

    def rounding_of_sum(self, u):
        """Rounding errors that the sum of all forces at ``u`` may carry [force]. *Collective.*"""
        return np.finfo(float).eps * float(np.linalg.norm(self._space.comm.allreduce(self._magnitude(u).sum(axis=0))))

    def loaded(self, u, springs=True):
        """Norm of :meth:`applied` at ``u`` [force]. *Collective.*"""
        return self.norm(self.applied(u, springs))

    def acting(self, u):
        """Largest of the norms of the external forces, and of those of the stresses at ``u`` where nodes are supported
        and where they are free [force]. *Collective.*

        At equilibrium supports and contact bear them. What contact says at ``u`` is no measure: it is gamma times a
        gap, of which rounding errors may be all.
        """
        external, stresses = self.applied(u), self._zero()
        self._problem.bulk.residual(u, stresses)
        held = np.where(self._problem.conditions.fixed, stresses, 0.0)
        return max(self.norm(external), self.norm(held), self.norm(stresses - held))

    def stiffness_scale(self, u):
        """Norm of the sums of the absolute terms of the bodies' forces at ``u`` [force]: residuals that are small
        against it leave displacements open that are small against ``u``. *Collective.*"""
        size = self._zero()
        self._problem.bulk.add_magnitude(u, size)
        return self.norm(size)

    def by_component(self, u):
        """Sums of the magnitudes of the external forces on every component (n_components,) at ``u`` [force].
        *Collective.*
        """
        space, size = self._space, np.linalg.norm(self.applied(u), axis=1)
        own = np.bincount(space.component[space.owned_local], size, minlength=space.mesh.n_components)
        return space.comm.allreduce(own, op=MPI.SUM)

    def worst(self, f):
        """Where a residual vector is largest. *Collective.*

        Parameters
        ----------
        f : PETSc.Vec

        Returns
        -------
        value : float
            [force]
        point : ndarray (d,)
            Reference position [length].
        body : str
        """
        space, mesh = self._space, self._space.mesh
        size = np.linalg.norm(f.getArray(readonly=True).reshape(-1, space.dim), axis=1)
        size = np.where(np.isfinite(size), size, np.inf)
        own, k = (-1.0, None, ""), int(np.argmax(size)) if len(size) else -1
        if k >= 0:
            node = space.owned_local[k]
            own = (float(size[k]), space.points[node], mesh.component_names[space.component[node]])
        return max(space.comm.allgather(own), key=lambda entry: entry[0])

    def resultant(self, record, u):
        """Norm of the sum of all forces on the bodies at ``u`` [force]: zero at equilibrium. *Collective.*

        Parameters
        ----------
        record : dict
            With ``reactions`` and ``contacts`` of a step, and ``couplings`` and ``equations`` where there are some.
        u : PETSc.Vec
        """
        total = self._space.comm.allreduce((self.applied(u) + self._drag(u)).sum(axis=0))
        obstacles = {contact.name for contact in self._problem.contacts if contact.rigid}
        forces = [*record["reactions"].values()]
        forces += [-np.asarray(pair["force"]) for name, pair in record["contacts"].items() if name in obstacles]
        forces += [group["force"] for group in record.get("couplings", {}).values()]
        forces += [record["equations"]["force"]] if "equations" in record else []
        total = total + np.sum(forces, axis=0)
        if self._space.axisymmetric:
            total[0] = 0.0  # radial forces are borne by the ring
        return float(np.linalg.norm(total))

    def sum_of_magnitudes(self, u, borne):
        """Sum of the magnitudes of all forces on the bodies at ``u`` [force]: what their resultant is compared with,
        for forces that balance each other, of rings, shrink fits, clamped bodies, leave no resultant. *Collective.*

        They are those of supports and groups at their nodes, those of contact at its points, on both bodies, those of
        loads, springs and dashpots at nodes; where nothing is applied and nothing touches, those of thermal stress.

        Parameters
        ----------
        u : PETSc.Vec
        borne : ndarray (n_owned, d)
            By supports and groups [force].
        """
        acting, answers = [self.external()], [borne, self._drag(u)]
        for item in self._problem.others:
            forces = answers if item in self._problem.features.springs else acting
            forces.append(np.zeros_like(borne))
            item.external(u, forces[-1])
        heat = [] if self._problem.bulk.heat is None else [self._problem.bulk.heat.forces]
        own = [sum(float(np.linalg.norm(one, axis=1).sum()) for one in forces) for forces in (acting, answers, heat)]
        acts, answer, thermal = self._space.comm.allreduce(np.array(own))
        acts += float(np.sum(self._problem.active.borne(u)))
        return float(acts + answer + (thermal if acts == 0.0 else 0.0))

    def acts(self, u, borne, roundings):
        """Whether loads act on the bodies, or forces of supports and groups that are no rounding errors. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        borne : ndarray (n_owned, d)
            By supports and groups [force].
        roundings : float
            So many rounding errors are no force.
        """
        return self.loaded(u) > 0.0 or self.norm(borne) > roundings * self.roundoff(u)

    def reactions(self, u, unbalanced=None):
        """Support forces that the surroundings exert, by region. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        unbalanced : ndarray (n_owned, d), optional
            What the problem's `unbalanced` said of it before the state was committed [force].

        Returns
        -------
        dict of str to list of float
        """
        problem, own = self._problem, self._space.owned_local
        supports = problem.conditions.supports
        forces = problem.unbalanced(u) if unbalanced is None else unbalanced
        which = supports.which[own]
        table = np.zeros((len(supports.regions), self._space.dim))
        for number in range(len(supports.regions)):
            table[number] = np.where(which == number, forces, 0.0).sum(axis=0)
        table = self._space.comm.allreduce(table)
        result = {}
        for region, row in zip(supports.regions, table, strict=True):
            result[region] = (np.asarray(result.get(region, 0.0)) + row).tolist()
        return result

    def moments(self, u, unbalanced):
        """Moments of the reactions of supports that turn, about their centres, by region. *Collective.*

        Parameters
        ----------
        u : PETSc.Vec
        unbalanced : ndarray (n_owned, d)
            As for :meth:`reactions`.

        Returns
        -------
        dict of str to float or list of float
            [force * length]
        """
        moved = u.getArray(readonly=True).reshape(unbalanced.shape)
        supports = self._problem.conditions.supports
        own = supports.moments(self._problem.time, self._space.owned_local, moved, unbalanced)
        return {supports.regions[k]: self._space.comm.allreduce(value).tolist() for k, value in own.items()}
