"""Runs scenes one after the other in one process (per rank): ``[mpirun -n N] python worker.py JOBS``.

JOBS is a file with one JSON object per line: `folder` (scene.toml is there), `options`, `restart` (a load step of
another folder, `of`) or null, `checkpoint`, `tangent`. What came out goes to result.pkl in the folder, what the
program said to log.txt there; JOBS.done has the number of the job that has begun and of those that have ended, so
that whoever waits knows which one did not.
"""

import json
import os
import pickle
import shutil
import sys
import time
import traceback
from pathlib import Path

import numpy as np

from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD


class Watch(Observer):
    """Keeps what every load step has to show, and the checkpoints."""

    def __init__(self, folder, checkpoint, tangent):
        self.folder, self.checkpoint, self.tangent = folder, checkpoint, tangent
        self.steps, self.simulation, self.cuts = [], None, []

    def step(self, step, u, record):
        """*Collective.*"""
        problem = self.simulation.problem
        space = problem.space
        force = np.zeros((space.n_owned, space.dim))
        problem.items[0].residual(u, force)
        nodes = space.mesh.file_nodes[space.mesh_nodes[space.owned_local]]
        mine = nodes, u.getArray(readonly=True).reshape(-1, space.dim).copy(), space.points[space.owned_local]
        energy = 0.5 * WORLD.allreduce(float(np.sum(force * mine[1])))
        parts = WORLD.gather(mine)
        row = {"number": step.number, "record": record, "energy": energy, "cutbacks": step.cutbacks}
        # forces of rounding errors that Newton's method takes for zero
        row["floor"] = 8.0 * problem.forces.roundoff(u)
        row["applied"] = WORLD.allreduce(problem.forces.applied(u).sum(axis=0))
        row["points"] = {contact.name: points_of(contact, u) for contact in problem.contacts}
        if self.tangent:
            row["singular"] = singular(self.simulation)
        if WORLD.rank == 0:
            row["nodes"], row["u"], row["x"] = (np.concatenate(part) for part in zip(*parts, strict=True))
            if self.checkpoint:
                kept = self.folder / f"kept_{step.number}"
                kept.mkdir()
                shutil.copy(self.folder / "out" / "checkpoint.h5", kept / "checkpoint.h5")
        self.steps.append(row)

    def cut(self, target, outcome):
        """Why a load step was cut."""
        self.cuts.append((target, outcome.reason))

    def end(self, converged):
        """Nothing is left to do."""


def points_of(contact, u):
    """Sums over the quadrature points of a contact, of all ranks: forces on the partners of every half, and the largest
    traction of open points. *Collective.*
    """
    forces, most = [], 0.0
    for state in contact.states(u):
        forces.append(WORLD.allreduce(-(state["traction"] * state["weight"][:, None]).sum(axis=0)))
        still = np.linalg.norm(state["traction"][state["status"] == 0], axis=1)
        most = max(most, WORLD.allreduce(float(np.max(still, initial=0.0)), op=MPI.MAX))
    return {"forces": forces, "open": most}


def singular(simulation):
    """Smallest singular value of the tangent without what steadies loose bodies, over its largest entry.

    On one rank. It is 0 where the solution is not unique: a body that nothing holds, one that slides freely.
    """
    jacobian, problem = simulation.newton.snes.getJacobian()[0], simulation.problem
    n = jacobian.getSize()[0]
    dense = np.array(jacobian.getValues(range(n), range(n)))
    free = ~problem.conditions.fixed.ravel()
    dense[np.diag_indices(n)] -= np.repeat(problem.stabilisation, problem.space.dim) * free
    dense = dense[np.ix_(free, free)]
    return float(np.linalg.svd(dense, compute_uv=False)[-1] / np.abs(dense).max())


def execute(job):
    """What came out of one job, on rank 0. *Collective.*"""
    folder = Path(job["folder"])
    options = PETSc.Options()
    result = {"status": "crashed", "text": "", "steps": [], "warnings": []}
    watch, simulation = Watch(folder, job["checkpoint"], job["tangent"]), None
    begin = time.perf_counter()
    try:
        for name, value in job["options"].items():
            options.setValue(name, value)
        if job["restart"] is not None:
            # the middle of the other run; one load step has none
            kept = len(list(Path(job["of"]).glob("kept_*")))
            result["restarted"] = kept // 2 if kept > 1 else None
        if result.get("restarted"):
            options.setValue("restart", str(Path(job["of"]) / f"kept_{kept // 2}"))
        simulation = Simulation(read_scene(folder / "scene.toml"), WORLD)
        watch.simulation = simulation
        out = folder / "out" if job["checkpoint"] or job["write"] else None
        converged = simulation.run(out, [watch])
        result["status"] = "converged" if converged else "stopped"
        mesh, problem = simulation.mesh, simulation.problem
        result["sizes"] = {"dofs": problem.space.n_dofs, "cells": mesh.n_cells_total}
        result["floating"] = dict(simulation.floating)
    except InputError as error:
        result.update(status="refused", text=str(error))
    except Exception:
        result["text"] = traceback.format_exc()
        if WORLD.size > 1:
            sys.stderr.write(f"rank {WORLD.rank}: {result['text']}\n")
    finally:
        if simulation is not None:
            simulation.close()
        for name in options.getAll():
            options.delValue(name)
    result.update(steps=watch.steps, cuts=watch.cuts, warnings=log.warnings(), seconds=time.perf_counter() - begin)
    watch.simulation = None
    return result


def main(path):
    """All jobs of a file."""
    jobs = [json.loads(line) for line in Path(path).read_text().splitlines()]
    for number, job in enumerate(jobs):
        if WORLD.rank == 0:
            with open(f"{path}.done", "a") as stream:
                stream.write(f"begin {number}\n")
        folder = Path(job["folder"])
        with open(folder / "log.txt" if WORLD.rank == 0 else os.devnull, "w") as stream:
            log.setup(WORLD.rank, stream)
            result = execute(job)
            log.setup(WORLD.rank, sys.stderr)
        statuses = WORLD.gather(result["status"])
        if WORLD.rank == 0:
            if len(set(statuses)) > 1:
                result.update(status="crashed", text=f"ranks ended as {statuses}")
            (folder / "result.tmp").write_bytes(pickle.dumps(result))
            (folder / "result.tmp").rename(folder / "result.pkl")
            with open(f"{path}.done", "a") as stream:
                stream.write(f"end {number}\n")
        WORLD.Barrier()


if __name__ == "__main__":
    main(sys.argv[1])
