"""Observer that estimates the error of every step: that of the mesh, and apart from it that of the solver."""

import numpy as np

from pcontact.assembly.item import LAW
from pcontact.estimate import goal
from pcontact.estimate.estimator import Estimator
from pcontact.estimate.goal import rules
from pcontact.estimate.loads import applied, held, missing
from pcontact.estimate.pressure_error import pressure_error
from pcontact.estimate.stress import Retained, mean_flow
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI

# one more Newton step is solved to this part of its right-hand side, with so many iterations at most
STEP_RTOL, STEP_ITERATIONS = 0.1, 50
# [-] Of the estimate: what the solver has left is known well enough where one application of the preconditioner says
# less. From: of eleven scenes of named_error.py, where one says 0.08 to 1.5 times as much as that Newton step.
LITTLE = 1e-3


def label(scene):
    """Return what the estimate of a scene's run is, and where theory ends.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        With the numerics of its contacts resolved.

    Returns
    -------
    str
    """
    words = ["error of the displacement in the energy norm, from the mesh alone"]
    if scene.plastic:
        words.append("indicator: no proof under yielding")
    if any(contact.friction for contact in scene.contacts):
        words.append("Coulomb friction: the proof is for Tresca friction")
    others = {c.formulation for c in scene.contacts if c.formulation != "nitsche"}
    if "penalty" in others:
        words.append("penalty: the penetration that it admits is not in it")
    if "augmented_lagrangian" in others:
        words.append("augmented Lagrangian: what multipliers lack is not in it")
    return "; ".join(words)


class ErrorEstimate(Observer):
    """Adds ``estimate`` to the record of every step. It has to be the first observer.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    scene : pcontact.scene.model.Scene
    newton : pcontact.solve.newton.Newton
        Its last linear system tells what Newton's iteration has left over.

    Attributes
    ----------
    cells : list of ndarray (nc,)
        Estimate of every cell of each block after the last step [sqrt(energy)].
    squares : ndarray (n_cells,)
        Squared estimates of the cells of this rank from all steps so far, block after block [energy]: the largest ones;
        where bodies yield, see :class:`pcontact.estimate.stress.Retained`.
    last : dict or None
        What was added to the record of the last step.

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, problem, scene, newton):
        self._problem, self._newton, self._loads, self.cells = problem, newton, applied(problem, scene), []
        self._plastic = scene.plastic
        # the largest norm of the run so far, which a restarted run goes on with
        self.last, self.carried = None, 0.0
        self.squares = np.zeros(sum(len(block.nodes) for block in problem.space.mesh.blocks))
        self._retained = Retained(len(self.squares)) if scene.plastic else None
        self._estimator = Estimator(problem, self._loads, scene.steps.count > 1)

    def step(self, step, u, record):
        """Estimate. *Collective.*"""
        estimate = self._estimator(u, step.time, held(self._problem, step.unbalanced))
        self.cells = estimate.cells
        own = np.concatenate([np.zeros(0), *self.cells])
        if self._retained is None:
            self.squares = np.maximum(self.squares, own**2)
        else:
            flow = mean_flow(self._problem.space.mesh.blocks, self._problem.bulk)
            self.squares = np.maximum(own, self._retained.after(own, flow)) ** 2
        # relative to the largest norm of the run: bodies that have been let go have none, but stresses that remain
        self.carried = max(self.carried, estimate.energy)
        self.last = record["estimate"] = {
            "absolute": estimate.absolute,
            "relative": estimate.absolute / self.carried if self.carried > 0.0 else float("nan"),
            "energy_norm": estimate.energy,
            "algebraic": self._left(step.unbalanced, LITTLE * estimate.absolute),
            "parts": estimate.parts,
            "surfaces": estimate.surfaces,
        }

    @property
    def over_steps(self):
        """Of the last step, from all steps so far [sqrt(energy)]. *Collective.*

        Where bodies yield, what a cell has missed in a step stays in its plastic strain, as far as it has flowed there:
        it counts where that is more than what the cell misses now.
        """
        if not self._plastic:
            return self.last["absolute"]
        return float(np.sqrt(self._problem.space.comm.allreduce(float(self.squares.sum()), op=MPI.SUM)))

    def of_loads(self, time, least=np.inf):
        """Energy norm of what the quadrature of loads leaves out of the displacement [sqrt(energy)], and the squared
        forces (nc,) that it leaves out of the cells of each block. *Collective.*

        The norm is known roughly, from `least` on well.
        """
        forces, cells = missing(self._problem.space, self._loads, time)
        rough = 0.0 if forces is None else self._answer(forces)
        return self._answer(forces, well=True) if rough > least else rough, cells

    def of_quantity(self, target, record, u, time, unbalanced):
        """The error of a quantity of the last load step, see `pcontact.estimate.goal`. *Collective.*

        Parameters
        ----------
        target : pcontact.scene.target.Target
        record : dict
            Of the load step.
        u : PETSc.Vec
        time : float
        unbalanced : ndarray (n_owned, d)
            Of the load step [force].

        Returns
        -------
        pcontact.estimate.goal.GoalError
        """
        problem = self._problem
        if target.quantity == "pressure":
            contact = next((one for one in problem.contacts if one.name == target.name), None)
            return pressure_error(self._estimator, contact, u)
        closing = rules(self._estimator, problem, u)
        found = self.goal(target, record, u, closing)
        z = problem.space.vector()
        if closing:
            problem.tangent(u, tuple(closing.get(item, LAW) for item in problem.others))
        z.setArray(goal.dual(problem, found, self._newton.last_preconditioner()).ravel())
        holding = held(problem, unbalanced), self._held(u, z, found, closing)
        known = self._estimator.weighted(u, time, z, found, holding, closing)
        cells = [found.sign * own[:, 0] for own in known]
        if closing:
            # what settings change is asked of the tangent at the solution
            problem.tangent(u)
        dual = z.getArray(readonly=True).reshape(unbalanced.shape)
        forces, _ = missing(problem.space, self._loads, time)
        left = problem.space.vector()
        problem.as_residual(unbalanced.copy(), left)
        work = [sum(own.sum() for own in cells), 0.0 if forces is None else found.sign * np.vdot(dual, forces),
                -found.sign * np.vdot(dual, left.getArray(readonly=True).reshape(dual.shape)),
                sum(own[:, 1].sum() for own in known)]  # fmt: skip
        *work, square = problem.space.comm.allreduce(np.array(work, dtype=float), op=MPI.SUM).tolist()
        error, loads, algebraic = work
        return goal.GoalError(found.value, error, cells, loads, algebraic, self.last["absolute"] * square**0.5)

    def _held(self, u, z, found, closing):
        """Return what holds groups that move on average in a dual displacement. *Collective.*"""
        problem = self._problem
        if not problem.features.averages:
            return []
        phi = z.getArray(readonly=True).reshape(problem.conditions.fixed.shape)
        forces = goal.transposed(problem.space, problem.items, u, phi, closing)
        return held(problem, forces if found.lift is not None else forces - found.slope)

    def goal(self, target, record, u, closing=None):
        """A quantity of the last load step that is no norm, a :class:`pcontact.estimate.goal.Goal`; parameters as of
        :meth:`of_quantity`, and the rules that pairs go by. *Collective.*"""
        problem, (name, axis) = self._problem, goal.place_of(target, record)
        if target.quantity == "force":
            contact = next(one for one in problem.contacts if one.name == name)
            return goal.contact_force(problem, contact, record["contacts"][name]["force"], u, closing, axis)
        if target.quantity == "support":
            return goal.support_force(problem, name, record["reactions"][name], u, closing, axis)
        return goal.probe(problem, name, u, axis)

    def norm(self, v):
        """Energy norm of a displacement of elastic bodies [sqrt(energy)]. *Collective.*"""
        return self._estimator.norm(v)

    def _left(self, forces, little):
        """Energy norm of what forces (n_owned, d) that the solver has left would change; only roughly where that is
        less than `little`. *Collective.*"""
        residual, step = self._problem.space.vector(), self._problem.space.vector()
        self._problem.as_residual(forces.copy(), residual)
        if residual.norm() == 0.0:
            return 0.0
        preconditioner, matrix = self._newton.last_preconditioner(), self._problem.matrix.matrix
        preconditioner.setOperators(matrix, matrix)
        preconditioner.apply(residual, step)
        self._problem.conditions.follow(step)
        size = self._estimator.norm(step)
        return size if size < little else self._answer(forces)

    def _answer(self, forces, well=False):
        """Energy norm of what the tangent answers to forces (n_owned, d). *Collective.*"""
        step = self.answer(forces, well)
        return 0.0 if step is None else self._estimator.norm(step)

    def answer(self, forces, well=True):
        """The displacement that the tangent of the last load step answers to forces. *Collective.*

        Parameters
        ----------
        forces : ndarray (n_owned, d)
            [force]
        well : bool
            Whether it decides on meshes, which are not to depend on how ranks share them; else it is solved roughly.

        Returns
        -------
        PETSc.Vec or None
            None where there are no forces.
        """
        problem = self._problem
        if not well:
            return self._newton.answer(forces, STEP_RTOL, STEP_ITERATIONS)[0]
        residual, step = problem.space.vector(), problem.space.vector()
        problem.as_residual(forces.copy(), residual)
        if residual.norm() == 0.0:
            return None
        goal.solve(problem.space, problem.matrix.matrix, self._newton.last_preconditioner(), residual, step)
        problem.conditions.follow(step)
        return step
