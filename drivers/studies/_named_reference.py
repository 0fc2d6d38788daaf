"""Reference in place of the exact solution of a scene of `named_error.py`: one solution that all its rows share.

It is that of a loop with a target of its own, smaller than those of the rows, degree 2 and a small tolerance. It is
kept as values at the quadrature points of its cells: there it is smooth, and so is a row's solution on the larger cells
of a coarser mesh. What the solution itself lacks is part of it, so that the rows can allow for it:

    mesh, quadrature, ...   as the loop names them, but for facets, which both meshes share
    load steps              the change when their number is halved: an error that falls as 1 / number has as much left.
                            Where they cost more than the mesh, the last mesh is run once more with many of them
    quantities              twice the error that the dual problem tells, where nothing yields; else the change of the
                            loop's last two meshes, as the squared estimates say that it goes on
"""

import json
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from drivers._common import log
from drivers.error_norms import Displacements, energy_density
from drivers.studies._harness import solved as ran
from pcontact.adapt.effectivity import State, left_after
from pcontact.adapt.loop import Loop
from pcontact.adapt.passes import Watch
from pcontact.adapt.secondary import solved
from pcontact.adapt.settings import FACETS, FALLING
from pcontact.element.geometry import gradients
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import shape, shape_gradient
from pcontact.estimate.goal import value
from pcontact.runtime.errors import StepFailure
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.scene.target import Budget, Target

# [-] Tolerance of Newton's method. From: it is the smallest that the loop takes.
RTOL = 1e-9
# [-] The error of a quantity over what the dual problem tells, at most. From: docs/tables/named_error.md
DUAL = 2.0
# what a loop may cost, whatever else the machine is doing at the moment
BUDGET = Budget(memory=16.0 * 2.0**30)
# cells whose points are made at once, and points at which another displacement is evaluated at once
CHUNK, POINTS = 4096, 2**17


class Cloud(NamedTuple):
    """A displacement at points of a body.

    Attributes
    ----------
    x, u : ndarray (n, d)
        [length]
    slope : ndarray (n, d, d)
        Entry [i, j]: derivative of component i in direction j.
    weight : ndarray (n,)
        Of the points in an integral over the body.
    """

    x: np.ndarray
    u: np.ndarray
    slope: np.ndarray
    weight: np.ndarray

    def distance(self, other, axisymmetric, constants, law):
        """int sigma(e) : eps(e), e being the difference to another displacement.

        Parameters
        ----------
        other : callable
            ``other(x)`` gives displacement and gradient.
        axisymmetric : bool
        constants, law
            As for :func:`drivers.error_norms.energy_density`.
        """
        total = 0.0
        for first in range(0, len(self.x), POINTS):
            x, u, slope, weight = (one[first : first + POINTS] for one in self)
            there = other(x)
            rest = Displacements(u - there[0], slope - there[1])
            if axisymmetric:
                rest = rest.with_hoop(x[:, 0])
            total += float(weight @ energy_density(rest.slope, x, constants, law))
        return total


class Reference(NamedTuple):
    """The solution, and what it may lack.

    Attributes
    ----------
    clouds : list of Cloud
        Of the bodies.
    norm : float
        Energy norm [sqrt(energy)].
    error : float
        Of the energy norm, relative.
    values : dict of str to (float, float)
        Quantities, and their errors, relative.
    unknowns, steps : int
    """

    clouds: list
    norm: float
    error: float
    values: dict
    unknowns: int
    steps: int

    def distance(self, other, axisymmetric, laws):
        """Energy norm of the difference to another displacement, relative.

        Parameters
        ----------
        other : callable
            ``other(x, body)`` gives displacement and gradient.
        axisymmetric : bool
        laws : list of tuple
            Of the bodies, as for :func:`drivers.error_norms.energy_density`.
        """
        squares = [cloud.distance(partial(other, body=body), axisymmetric, *law)
                   for body, (cloud, law) in enumerate(zip(self.clouds, laws, strict=True))]  # fmt: skip
        return float(np.sqrt(sum(squares))) / self.norm

    def write(self, path):
        """Keep it in a file."""
        said = json.dumps({**self._asdict(), "clouds": len(self.clouds)})
        arrays = {f"{name}_{k}": part for k, cloud in enumerate(self.clouds) for name, part in cloud._asdict().items()}
        np.savez(path, said=said, **arrays)

    @classmethod
    def read(cls, path):
        """That of a file."""
        with np.load(path) as data:
            said = json.loads(str(data["said"]))
            clouds = [Cloud(*(data[f"{name}_{k}"] for name in Cloud._fields)) for k in range(said["clouds"])]
        return cls(**{**said, "clouds": clouds})


def clouds_of(simulation):
    """The solution of a run on one rank at quadrature points of its cells: a list of Cloud."""
    space, mesh = simulation.problem.space, simulation.mesh
    nodal, parts = space.local.gather(simulation.stepper.u), {}
    for number, block in enumerate(mesh.blocks):
        table, geometry_degree = mesh.geometry_nodes(block)
        # gradients are of a degree less, on straight cells
        xi, weights = quadrature(block.cell, 2 * space.degree)
        dgeo = np.ascontiguousarray(shape_gradient(block.cell, geometry_degree, xi))
        dshape = np.ascontiguousarray(shape_gradient(block.cell, space.degree, xi))
        at, values = shape(block.cell, geometry_degree, xi), shape(block.cell, space.degree, xi)
        for first in range(0, len(block.nodes), CHUNK):
            x = np.ascontiguousarray(mesh.points[table[first : first + CHUNK]])
            grad, jxw = np.empty((len(x), *dshape.shape)), np.empty((len(x), len(weights)))
            gradients(x, dgeo, dshape, weights, grad, jxw)
            own = nodal[space.cells[number][first : first + CHUNK]]
            points = np.einsum("qa,cad->cqd", at, x).reshape(jxw.size, -1)
            weight = jxw.ravel() * (2.0 * np.pi * points[:, 0] if space.axisymmetric else 1.0)
            slope = np.einsum("cai,cqaj->cqij", own, grad).reshape(*points.shape, -1)
            u = np.einsum("qa,cad->cqd", values, own).reshape(points.shape)
            parts.setdefault(block.body, []).append((points, u, slope, weight))
    return [Cloud(*(np.concatenate(some) for some in zip(*parts[body], strict=True))) for body in sorted(parts)]


class _Goals(Observer):
    """Observer: quantities at the end, dicts of str to GoalError and to State."""

    def __init__(self, simulation, wanted):
        self._simulation, self._wanted, self.found, self.states = simulation, wanted, {}, {}

    def step(self, step, u, record):
        """Find them after the last load step."""
        simulation = self._simulation
        if step.time < simulation.scene.steps.end * (1.0 - 1e-9):
            return
        for of in self._wanted:
            found = simulation.error_estimate.of_quantity(Target(0.1, of), record, u, step.time, step.unbalanced)
            self.found[of] = found._replace(cells=[])
            self.states[of] = State.of(simulation, found.value)


def finer(scene, steps):
    """A scene with a small tolerance, degree 2 and as many load steps at least."""
    scene = scene.copy()
    scene.mesh.order, scene.steps.count = 2, max(scene.steps.count, steps)
    scene.petsc = {**scene.petsc, "snes_rtol": f"{RTOL:g}"}
    return scene


def made(scene, target, quantities, steps=1, after=0):
    """The reference of a scene, on one rank.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    target : float
        Its own, of the energy norm.
    quantities : list of str
        That it is to know, too.
    steps : int
        Load steps that it begins with, at least.
    after : int
        Load steps of one more run on the last mesh, where these are more than it has had.

    Raises
    ------
    StepFailure
        A load step did not converge.
    """
    scene, goals = replace(finer(scene, steps), accuracy=Target(target, budget=BUDGET)), []

    def watch(simulation):
        goals.append(_Goals(simulation, quantities))
        return goals[-1:]

    def take(simulation, converged):
        if not converged:
            return None
        u = simulation.stepper.u
        return clouds_of(simulation), simulation.error_estimate.norm(u), u.getArray(readonly=True).copy()

    loop = Loop(scene, take=take, observers=watch)
    outcome = loop.run()
    if outcome.failure is not None:
        raise outcome.failure
    clouds, norm, u = outcome.kept
    last, goals, beside = loop.passes[loop.best - 1], goals[: loop.best], {}
    parts = {name: part for name, part in last.parts.items() if name not in FACETS}
    goals, yields, taken = goals[-2:], any(scene.yields(body) for body in scene.bodies), last.steps
    if after > taken:
        (clouds, norm, u), ratio = _again(loop, after, watch, take)
        goals, taken = [goals[0], goals[-1]], after
        parts |= {name: ratio * part for name, part in parts.items() if name in FALLING}
    if parts.pop("load_steps", 0.0) > 0.0:
        beside = _halved(loop, u, quantities, taken)
    values = {of: _value(of, goals, yields, beside.get(of, 0.0)) for of in quantities}
    error = sum(parts.values()) + beside.get("energy", 0.0) / norm
    log.info("reference: %d unknowns, %d load steps, error %.3g", last.unknowns, taken, error)
    return Reference(clouds, norm, error, values, last.unknowns, taken)


def _again(loop, steps, watch, take):
    """Run the best mesh with other load steps, watched as passes are: what is taken of it, and how many times as large
    the estimate of the mesh is then. *Collective.*"""
    scene, best = loop.best_scene(), loop.passes[loop.best - 1]
    scene.steps.count = steps
    seen = []

    def observers(simulation):
        seen.append(Watch(simulation))
        return [*seen, *watch(simulation)]

    with ran(scene, loop.mesh, observers=observers) as (simulation, _):
        return take(simulation, True), seen[0].absolute / seen[0].norm / (best.estimate * best.part)


def _halved(loop, u, quantities, steps):
    """Return the change by half of so many steps: of the displacement [sqrt(energy)] and quantities, by their names."""
    scene, found = loop.best_scene(), {}
    scene.steps.count = max(steps // 2, 1)
    with solved(scene, MPI.COMM_WORLD, "command line", loop.mesh) as (run, record):
        if record is None:
            raise StepFailure("the reference with half of its load steps does not converge")
        change = run.stepper.u.copy()
        change.setArray(change.getArray(readonly=True) - u)
        found["energy"] = run.error_estimate.norm(change)
        for of in quantities:
            found[of] = value(run.problem, Target(0.1, of), record, run.stepper.u)
    return found


def _value(of, goals, yields, halved):
    """A quantity and its error, relative."""
    last = goals[-1].found[of]
    error = DUAL * abs(last.error)
    if yields:
        error = abs(left_after(goals[0].states[of], goals[-1].states[of]))
    error += abs(last.loads) + abs(last.algebraic) + (abs(halved - last.value) if halved else 0.0)
    return last.value, error / abs(last.value)
