"""A load step as PETSc objects: SNES, residual, Jacobian, DM, for scripts that solve by themselves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pcontact.api.scenes import scene_of
from pcontact.runtime.errors import InputError
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene import model
from pcontact.simulation import Simulation


def problem(
    scene: model.Scene | Mapping[str, Any] | str | Path,
    options: Mapping[str, Any] | str | None = None,
    comm: Any = None,
) -> Problem:
    """The first load step of a scene, ready to be solved. *Collective* on the ranks of `comm`.

    Parameters
    ----------
    scene, options, comm
        As of :func:`pcontact.run`, but for options of the process: they act here, as in any program of PETSc.

    Returns
    -------
    Problem
        To be closed, as by ``with``.

    Raises
    ------
    InputError
        The scene, the mesh or an option is wrong, or the scene has inertia; on every rank.
    """
    scene = scene_of(scene)
    if scene.dynamics is not None:
        raise InputError("problem: found [dynamics]; allowed: a scene without inertia")
    before = PETSc.Options().getAll()
    Options("options").give(options or {})
    given = [name for name in PETSc.Options().getAll() if name not in before]
    return Problem(Simulation(scene, MPI.COMM_WORLD if comm is None else comm, "options"), given)


class Problem:
    """One load step after the other, which the caller solves.

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
    given : sequence of str
        Options that are taken back at the end.

    Attributes
    ----------
    u : PETSc.Vec
        Displacement: what ``snes.solve(None, u)`` begins with and finds [length].
    snes : PETSc.SNES
        With the program's globalisation, convergence test, preconditioner and near-null space.
    dm : PETSc.DMPlex
        With the displacement of degree 1 as its section, whose numbers are those of ``u``; of degree 2, without one.
    fields : dict of str to PETSc.IS
        Unknowns of every body, by its region: what ``PC.setFieldSplitIS`` takes.
    time : float
        At which the load step ends.
    """

    def __init__(self, simulation: Any, given: Any = ()) -> None:
        self._simulation, self._given = simulation, given
        self._problem, self._newton = simulation.problem, simulation.newton
        space = self._problem.space
        self.u, self.snes = space.vector(), self._newton.snes
        self.dm = space.dm if space.degree == 1 else space.mesh.dm
        own = space.component[space.owned_local]
        self.fields = {}
        for name in dict.fromkeys(space.mesh.component_names):
            parts = [k for k, one in enumerate(space.mesh.component_names) if one == name]
            nodes = (space.start + np.flatnonzero(np.isin(own, parts))).astype(PETSc.IntType)
            self.fields[name] = PETSc.IS().createBlock(space.dim, nodes, comm=space.comm)
        self._newton.stand_alone()
        self.begin(simulation.part.steps.end / simulation.part.steps.count)

    @property
    def time(self) -> float:
        return float(self._problem.time)

    def begin(self, time: float) -> None:
        """Begin the load step to a time from the committed displacement ``u``: points look for their partners,
        prescribed displacements are entered. *Collective.*"""
        self._problem.time = float(time)
        motion = self._problem.conditions.imposed(self.u, time)
        for item in self._problem.items:
            item.detect(self.u, time, motion, None)
        self._problem.prediction.begin(self.u, time)
        self._newton.begin_alone(self.u)

    def commit(self) -> None:
        """Take ``u`` for the state at the end of the load step: slip, plastic strain. *Collective.*"""
        for item in self._problem.items:
            item.commit(self.u, self.time)

    def residual(self, u: Any, f: Any = None) -> Any:
        """Residual [force] at a displacement, a vector: where it is prescribed, the diagonal of the Jacobian times the
        distance from what is prescribed. *Collective.*"""
        f = self.u.duplicate() if f is None else f
        self.snes.computeFunction(u, f)
        return f

    def jacobian(self, u: Any) -> Any:
        """The matrix of the derivative of the residual at a displacement [force/length], which the next call
        overwrites. *Collective.*"""
        self._problem.tangent(u)
        return self._problem.matrix.matrix

    def close(self) -> None:
        """Give back what PETSc has of it, and take its options out of the database. *Collective.*"""
        self._simulation.free()
        for name in self._given:
            PETSc.Options().delValue(name)

    def __enter__(self) -> Problem:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
