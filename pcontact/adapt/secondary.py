"""Errors that the mesh has no part in: what finer settings change on the mesh of a pass.

Where bodies remember, twice the load steps are taken; where the geometry is known, gaps of smooth surfaces in the place
of those of facets; where the user has chosen the quadrature of a contact, a finer one. The difference to the run
without is a part of the error, by the name of the setting; load steps are refined where it is more than a third of the
target. It is measured on the first mesh after which the next one may be the last, and again as long as it is large:
nothing follows it from one mesh to another but the law that errors of load steps fall with their number.

Not measured are partners that are frozen in a load step, whose part in the forces is limited to `NOTICED` of the
target, and the usual quadrature of contacts: at the edge of what is closed its error is that of the cells over the
square of the points on a facet, and so one of the parts that safety factors are for. On meshes of scenes of seeds
0 to 25 (`drivers/studies/random_errors.py`) each changed at most a tenth of what the mesh was named with.

Facets of the first mesh, which finer ones keep, are a part of their own: it is measured once, on that mesh. Where they
are straight, on the outer surface of all bodies. Nodes of finer meshes lie on the facets of the first one: what these
are off the surface stays. Straight facets are chords; with the nodes in the middles of edges on the surface they have
the error of an interpolation of degree 2. Gaps between curved facets in contact are taken off by their smooth surfaces,
`pcontact.contact.surface.smooth_geometry`.

`drivers/studies/facets.py` compares what changes on the first mesh with what is left on ever finer ones.
"""

import time as clock
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact import build
from pcontact.adapt.mark import LEAP
from pcontact.adapt.passes import Beginning, said_of
from pcontact.adapt.settings import NOTICED, THIRD
from pcontact.contact.surface.smooth_geometry import smooth_surface
from pcontact.element.reference import CELLS, reference_nodes, shape_gradient
from pcontact.estimate import goal
from pcontact.estimate.goal import value
from pcontact.mesh.refinement.refine import HALVED, Balance
from pcontact.mesh.refinement.split import split
from pcontact.mesh.topology import jacobians, outer_facets
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD
from pcontact.runtime.observer import Observer
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation

# Facet group of the whole outer surface, which no user can name.
OUTER = "\nouter"


def smooth_facets(scene, _=None):
    """The scene with the gaps of the smooth surfaces that facets stand for."""
    contacts = [one if one.tied else replace(one, smooth_geometry=True) for one in scene.contacts]
    return replace(scene, contacts=contacts)


def bent(simulation):
    """Return True if the facets of a contact stand for a smooth surface that they are not. *Collective.*"""
    names = {name for one in simulation.scene.contacts if not one.tied for name in (one.source, one.target)} - {None}
    return any([smooth_surface(simulation.problem.space, name, True) is not None for name in sorted(names)])


def outer_surface(space):
    """All outer facets of a mesh, free ones, loaded ones and those of contacts, and the smooth surface that they stand
    for or None. *Collective.*"""
    groups, facets = space.mesh.facet_groups, outer_facets(space.mesh, space.exchanger)
    groups[OUTER] = facets
    surface = smooth_surface(space, OUTER, True)
    del groups[OUTER]
    return facets, surface


def rounded(space):
    """The mesh with the nodes in the middles of straight edges on the smooth surface that outer facets stand for.
    *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Of degree 2, on a mesh with straight cells.

    Returns
    -------
    pcontact.mesh.mesh.Mesh or None
        The same cells and numbers; None where a cell would be folded.
    """
    facets, surface = outer_surface(space)
    steps, count, first = *np.zeros((2, space.n_local, space.dim)), 0
    for some in facets:
        nodes, kind = space.facet_nodes(some), CELLS[some.kind]
        weights, rows = np.zeros((len(nodes), surface.normals.shape[1])), first + np.arange(len(nodes))
        first += len(nodes)
        for middle, edge in zip(nodes[:, kind.n_vertices :].T, kind.edges, strict=False):
            weights[:] = 0.5 * np.isin(np.arange(weights.shape[1]), edge)
            np.add.at(steps, middle, surface.offset(rows, weights))
            np.add.at(count, middle, 1.0)
    steps = space.together(steps) / np.maximum(space.together(count), 1.0)
    mesh, folded = replace(space.mesh, points=space.mesh.points.copy(), curved=True), False
    for block, cells in zip(mesh.blocks, space.cells, strict=True):
        own, cell = steps[cells], CELLS[block.cell]
        halves = slice(cell.n_vertices, cell.n_vertices + len(cell.edges))
        # nodes in the middles of faces and cells follow those of edges
        for k, face in enumerate(cell.faces):
            own[:, halves.stop + k] = 0.5 * own[:, halves][:, np.isin(cell.edges, face).all(axis=1)].sum(axis=1)
        for k in range(halves.stop + len(cell.faces), own.shape[1]):
            own[:, k] = (0.5 if cell.dim == 2 else 0.25) * own[:, halves].sum(axis=1)
        mesh.points[block.nodes] = space.mesh.points[block.nodes] + own
        folded |= bool((jacobians(mesh.points, block.cell, 2, block.nodes) <= 0.0).any())
    return None if space.comm.allreduce(folded, op=MPI.LOR) else mesh


def at_places(space, u, places):
    """A displacement on cells of :func:`rounded`, at the places (n_nodes, d) of the nodes of straight ones, to first
    order: (n_owned d,). *Collective.*"""
    nodal, mesh = space.local.gather(u), space.mesh
    change, count = np.zeros((2, space.n_local, space.dim))
    for block, cells in zip(mesh.blocks, space.cells, strict=True):
        slopes = shape_gradient(block.cell, 2, reference_nodes(block.cell, 2))
        own, jacobian = (np.einsum("qaj,cai->cqij", slopes, some) for some in (nodal[cells], mesh.points[block.nodes]))
        step = np.linalg.solve(jacobian, (places - mesh.points)[block.nodes][..., None])
        np.add.at(change, cells, np.matmul(own, step)[..., 0])
        np.add.at(count, cells, 1.0)
    moved = nodal + space.together(change) / space.together(count)
    return moved[space.owned_local].ravel()


# [-] Power of their number that errors of load steps are named with: that without regularity in time, the least.
# From: Han and Reddy, Plasticity, 12.2: 1/2, and 1 with it; 4 to 64 load steps of sheared blocks have 0.7.
STEPS_RATE = 0.5
# [-] What facets change on fine meshes over what they change on the first one, in the energy norm. From: random scenes
# of seeds 0 to 99, 1.3 to 2.1, as coarse cells do not see the kinks between straight facets; drivers/studies/facets.py,
# 2.4 to 3.1, as displacements of degree 2 follow the gaps between curved ones on finer cells alone.
FINER_SEE = {"straight_facets": 2.0, "curved_facets": 3.0}


@contextmanager
def solved(scene, comm, said, mesh, known=None):
    """A run in memory whose lines are not shown, and the record of its last load step; None where it does not converge.
    It begins where the bodies are known to be, see :class:`pcontact.adapt.passes.Beginning`. *Collective.*
    """
    simulation = Simulation(scene, comm, said, mesh)
    # estimates are those of all load steps
    simulation.newton.lasting, simulation.every = True, scene.output.estimate
    if known is not None:
        simulation.begin = Beginning(simulation, known)
    try:
        with log.quiet():
            last = Last()
            converged = simulation.run(None, [last])
        yield simulation, last.record if converged else None
    finally:
        simulation.free()


class Last(Observer):
    """Observer that keeps the record of the last load step."""

    def __init__(self):
        self.record = None

    def step(self, step, u, record):
        """Keep it."""
        self.record = record


def more_steps(scene, _):
    """The scene with twice the load steps."""
    return replace(scene, steps=replace(scene.steps, count=2 * scene.steps.count))


def finer_quadrature(scene, degree):
    """The scene with the quadrature on its contacts that displacements of twice the degree have."""
    usual = 2 * degree + 5
    contacts = [replace(one, quadrature=(one.quadrature or usual) + 2 * degree) for one in scene.contacts]
    return replace(scene, contacts=contacts)


class Answer(NamedTuple):
    """Answer of a run with other settings.

    Attributes
    ----------
    number : int
        Load steps that it has taken.
    u : ndarray (n_owned d,)
        Displacement at its end [length].
    value : float or None
        Of the quantity, where there is one.
    pressure : list of pcontact.estimate.goal.SourcePressure or None
        Where it is that of a contact.
    """

    number: int
    u: np.ndarray
    value: float | None
    pressure: list | None = None

    @classmethod
    def of(cls, run, record, target):
        """That of a simulation, and the record of its last load step. *Collective.*"""
        u = run.stepper.u
        own = None if target.quantity == "energy" else value(run.problem, target, record, u)
        pressure = goal.named(run.problem, target.name, u) if target.quantity == "pressure" else None
        return cls(run.stepper.number, u.getArray(readonly=True).copy(), own, pressure)


def answers(simulation, scene, target, known=None):
    """Answers of a scene on the same mesh, an :class:`Answer` by what a target is the error of; empty where that is not
    known. *Collective.*"""
    try:
        with solved(scene, simulation.comm, simulation.options.said, simulation.mesh, known) as (run, record):
            return {} if record is None else {one.of: Answer.of(run, record, one) for one in target.each}
    except TOLD:
        # a setting that the scene does not take
        return {}


class Runs:
    """Runs with other settings on the mesh of a pass, each made once for all that the error is named of.

    Parameters
    ----------
    target : pcontact.scene.target.Target
    """

    def __init__(self, target):
        self._target, self._of, self._found = target, None, {}

    def __call__(self, simulation, scene, known, name):
        """Answers of the scene of a name on the mesh of a pass, as of :func:`answers`. *Collective.*"""
        if self._of is not simulation:
            self._of, self._found = simulation, {}
        if name not in self._found:
            self._found[name] = answers(simulation, scene, self._target, known)
        return self._found[name]


def change_to(simulation, other, target, record, one=None):
    """Distance of an :class:`Answer`, or None, from `one`, or else from that of a simulation. *Collective.*

    Returns
    -------
    float
        In the energy norm [sqrt(energy)], of the pressure in L2, or of another quantity, then with its sign: the value
        of the other less that of the simulation; nan where it is not known.
    """
    if other is None:
        return float("nan")
    if target.quantity not in ("energy", "pressure"):
        own = value(simulation.problem, target, record, simulation.stepper.u) if one is None else one.value
        return other.value - own
    u, problem = simulation.stepper.u, simulation.problem
    if one is not None:
        u = u.copy()
        u.setArray(one.u)
    if target.quantity == "energy":
        change = u.copy()
        change.setArray(u.getArray(readonly=True) - other.u)
        return simulation.error_estimate.norm(change)
    own = goal.named(problem, target.name, u)
    distance = goal.apart(simulation.comm, own, other.pressure)
    if np.isfinite(distance):
        return distance
    # where the points of the contact are others, the contact of the simulation has both displacements
    moved = u.copy()
    moved.setArray(other.u)
    return goal.apart(simulation.comm, own, goal.named(problem, target.name, moved))


def beyond(simulation, values):
    """The displacement of a simulation less that of another run, values (n_owned d,): a PETSc.Vec."""
    change = simulation.stepper.u.copy()
    change.setArray(change.getArray(readonly=True) - values)
    return change


def of_facets(simulation, scene, target, record):
    """Change by the smooth surfaces that straight facets stand for, all those of the bodies, in a solution of degree
    2 on the mesh of the file, which is that of a simulation with a record where this has degree 2; as of
    :func:`change_to`. *Collective.*"""
    comm, options = simulation.comm, simulation.options
    output = replace(scene.output, estimate=True, checkpoint=False)
    scene = replace(scene, mesh=replace(scene.mesh, order=2), output=output)

    def read(scene):
        mesh = build.read(scene, comm, options)
        kinds = set().union(*comm.allgather({block.cell for block in mesh.blocks if len(block.nodes)}))
        return mesh if kinds <= set(HALVED) else split(mesh, (), Balance(*build.balance(scene, options))).mesh

    own = simulation.problem.space.degree == 2
    try:
        with nullcontext((simulation, record)) if own else solved(scene, comm, options.said, read) as (run, record):
            mesh = None if record is None else rounded(run.problem.space)
            if mesh is None:
                return float("nan")
            with solved(scene, comm, options.said, mesh) as (other, its):
                if its is None:
                    return float("nan")
                found = Answer.of(other, its, target)
                there = at_places(other.problem.space, other.stepper.u, run.mesh.points)
            return change_to(run, found._replace(u=there), target, record)
    except TOLD:
        return float("nan")


class Told(NamedTuple):
    """Findings of a mesh.

    Attributes
    ----------
    parts : dict of str to float
        Parts of the error, relative, by what brings them about.
    toward : float
        What finer settings change in a number, relative, with its sign.
    steps : int
        Load steps of the pass.
    """

    parts: dict
    toward: float
    steps: int


class Secondary:
    """Knowledge of these errors.

    Parameters
    ----------
    target : pcontact.scene.target.Target
        Of what they are the error.
    settings : pcontact.adapt.settings.Settings
    runs : Runs, optional
        Shared with others that are of the same passes.
    """

    def __init__(self, target, settings, runs=None):
        self._target, self._settings, self._told, self._facets = target, settings, None, None
        self._runs = runs or Runs(target)
        # scene and answer with more load steps, on the mesh of a pass
        self._finer = None

    @property
    def known(self):
        """Return True if a mesh has told them."""
        return self._told is not None

    def parts(self, simulation, watch, done, size, last=False):
        """Them, relative to a size, by what brings them about, and what finer settings change in a number, with its
        sign: those of facets alone until a pass is near the target, or there is no further pass (`last`). *Collective.*

        The simulation has run; its files are closed where they are measured. The `trials` of the pass are set.
        """
        begun, told, self._finer = clock.perf_counter(), self._told, None
        # what is large is measured again: where it is all that misses the target, or much of what does
        own, goal = sum(done.parts.values()), self._settings.goal
        large = THIRD * own if own > goal else max(THIRD * goal, goal - own)
        new = told is None or sum(self._now(told, done).values()) > large
        if new and (last or self._near(simulation, done)):
            told = self._told = self._measured(simulation, watch, done, size)
        if self._facets is None:
            self._facets = self._of_facets(simulation, watch, done, size)
        done.trials += clock.perf_counter() - begun
        if told is None:
            return dict(self._facets), 0.0
        parts = self._now(told, done)
        scale = sum(parts.values()) / (sum(told.parts.values()) or 1.0)
        return parts | self._facets, scale * told.toward

    def _near(self, simulation, done):
        """Return True if the next mesh may be the last one, as the first ones grow; or if curved facets, which the
        first mesh tells alone, may rub otherwise with few load steps."""
        if self._facets is None and self._settings.staying and simulation.mesh.curved and simulation.scene.remembers:
            return True
        power = done.degree * (2 if self._target.numbers else 1) / simulation.mesh.dim
        near = self._target.best or done.unknowns * LEAP > (self._target.budget.unknowns or np.inf)
        return near or done.parts["mesh"] <= LEAP**power * self._settings.goal

    def of_steps(self, count):
        """The error that so many load steps leave on the last mesh that has told it, relative."""
        told = self._told
        return 0.0 if told is None else told.parts.get("load_steps", 0.0) * told.steps / count

    def _now(self, told, done):
        """Parts with the settings of a pass: errors of load steps fall with their number."""
        parts = dict(told.parts)
        if "load_steps" in parts:
            parts["load_steps"] = self.of_steps(done.steps)
        return parts

    def _variants(self, simulation):
        """By the names of errors of `pcontact.adapt.passes.NAMES`, what makes a scene one of finer settings."""
        scene, found = simulation.scene, {}
        if scene.remembers:
            found["load_steps"] = more_steps
        if any(contact.quadrature for contact in scene.contacts):
            found["quadrature"] = finer_quadrature
        if not self._settings.staying and bent(simulation):
            found["curved_facets" if simulation.mesh.curved else "straight_facets"] = smooth_facets
        return found

    def _measured(self, simulation, watch, done, size):
        """What the mesh of a pass tells. *Collective.*"""
        variants = {} if simulation.problem.linear else self._variants(simulation)
        if not variants:
            return Told({}, 0.0, done.steps)
        simulation.close()
        scene, degree = self._settings.scene(), simulation.problem.space.degree
        scene.output.estimate = scene.output.checkpoint = False
        scene.petsc["snes_rtol"] = f"{NOTICED * self._settings.goal:.3g}"
        parts, toward = {}, 0.0
        for name, finer in variants.items():
            other = finer(scene, degree)
            found = self._runs(simulation, other, watch.known, name).get(self._target.of)
            moved = change_to(simulation, found, self._target, watch.record) / size
            if not np.isfinite(moved):
                log.warning("not known: how much of the error is that of %s", said_of(name))
                continue
            if name == "load_steps":
                self._finer, times = (other, found), found.number / simulation.stepper.number
                # of errors that fall with the number of load steps, what the pass has left
                moved /= 1.0 - times**-STEPS_RATE if times > 1.0 else 1.0
            parts[name], toward = abs(moved), toward + moved
        return Told(parts, toward, done.steps)

    def _of_facets(self, simulation, watch, done, size):
        """The part of facets that all meshes keep, by its name. *Collective.*"""
        if not self._settings.staying:
            return {}
        scene, target, space = self._settings.scene(), self._target, simulation.problem.space
        if not simulation.mesh.curved:
            if outer_surface(space)[1] is None:
                return {}
            simulation.close()
            name, found = "straight_facets", of_facets(simulation, scene, target, watch.record)
        else:
            free = any(not contact.tied for contact in simulation.scene.contacts)
            if not free or simulation.problem.linear or not bent(simulation):
                return {}
            simulation.close()
            scene.output.estimate = scene.output.checkpoint = False
            # few load steps may rub otherwise with other facets: beside the run with more of them, where there is one
            scene, finer = self._finer or (scene, None)
            other = self._runs(simulation, smooth_facets(scene), watch.known, "smooth").get(target.of)
            name, found = "curved_facets", change_to(simulation, other, target, watch.record, finer)
        if not np.isfinite(found):
            log.warning("not known: how much of the error is that of %s", said_of(name))
            found = 0.0
        return {name: FINER_SEE[name] * abs(found) / size}
