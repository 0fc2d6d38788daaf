"""The error that a run is to reach, what is known of its passes, and what follows from them for reports."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from pcontact.element.reference import reference_nodes, shape
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.scene.keys import options as key_options
from pcontact.scene.target import BEST, Budget, Target
from pcontact.scene.validate import validate


def wanted(scene, options):
    """The scene with the error to reach that the user wants; None where there is none to reach.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        Left as it is.
    options : pcontact.runtime.options.Options

    Returns
    -------
    pcontact.scene.model.Scene or None
        Its `accuracy` is a :class:`pcontact.scene.target.Target`.

    Raises
    ------
    InputError
        On every rank.
    """
    said = {cls: {key: options.get(one, None) for key, one in key_options(cls).items()} for cls in (Target, Budget)}
    said = {cls: {key: value for key, value in some.items() if value is not None} for cls, some in said.items()}
    target = scene.accuracy if isinstance(scene.accuracy, Target) else None
    # a word of the command line is another wish than the scene's error
    if options.given("accuracy"):
        if "error" in said[Target]:
            found = "a preset beside an error to reach, which chooses what presets do"
            raise InputError(f"{options.said}: -accuracy: found {found}; allowed: -accuracy or -error")
        target = None
    if target is None and "error" not in said[Target]:
        if any(said.values()):
            name = next(key for some in said.values() for key in some)
            raise InputError(f"{options.said}: -error_{name}: found no error to reach; allowed: together with -error")
        return None
    if options.given("restart"):
        raise InputError(f"{options.said}: -restart: found an error to reach; allowed: runs on the mesh given")
    if target is None:
        target = Target(said[Target]["error"])
    budget = replace(target.budget, **said[Budget])
    scene = replace(scene.copy(), accuracy=replace(target, budget=budget, **said[Target]))
    validate(scene)
    return scene


# [passes] That errors are judged by, as they fall irregularly. From: chosen.
PATIENCE = 3
# [bytes] That an unknown more takes, by the dimension, where it has not been measured; and growth of the memory that
# tells it. From: scenes of named_error.py with 20,000 to 76,000 unknowns took 3,900 to 5,000, 10,600; interpreter and
# compiled kernels grow by less than that.
BYTES, TOLD = {2: 5e3, 3: 1.1e4}, 2e8
NAMES = {
    "mesh": "the mesh", "load_steps": "the load steps", "quadrature": "the quadrature of contact",
    "loads": "the quadrature of loads", "straight_facets": "straight facets of curved surfaces",
    "curved_facets": "curved facets of surfaces that curve otherwise", "algebraic": "Newton's and Krylov's methods",
}  # fmt: skip


@dataclass
class Pass:
    """A run on one mesh.

    Attributes
    ----------
    unknowns, cells, degree : int
    estimate : float
        Of the error of the mesh, relative.
    known : pcontact.adapt.effectivity.Range
        Of the estimate over the error.
    parts : dict of str to float
        The error by what brings it about, relative; names are keys of `NAMES`.
    error : float
        Their sum: the error that is named.
    expected : float
        The error that is expected, relative.
    steps : int
        Load steps that were planned.
    seconds, solve : float
        Of the whole pass, and of its load steps.
    memory : float
        Peak of all ranks together [bytes].
    entries : float
        Of the tangent, stored.
    quantity : dict or None
        Value, error, what it is extrapolated to, uncertainty; None for the energy norm.
    trials : float
        Seconds that were spent on errors that the mesh has no part in.
    next : dict or None
        What was decided: ``unknowns``, ``mesh`` (its part of the error then), ``load_steps`` and ``degree`` that are
        expected; None of what is not known. ``divided``: the cells are divided into simplices.
    part : float
        Of the error of the displacement that the estimate is seen to be.
    of : str
        What it is the error of: where several are named, that with the largest one.
    each : list of Pass
        The same of each of several; empty: of one.
    confirmed : bool
        Whether the error would be below the target, too, if cells had what they have in a quantity with one sign, or
        another mesh has told it: a dual problem on one mesh alone may miss what that is too coarse for.
    """

    unknowns: int
    cells: int
    degree: int
    estimate: float
    known: object
    parts: dict = field(default_factory=dict)
    error: float = 0.0
    expected: float = 0.0
    steps: int = 1
    seconds: float = 0.0
    solve: float = 0.0
    memory: float = 0.0
    entries: float = 0.0
    quantity: dict | None = None
    trials: float = 0.0
    next: dict | None = None
    part: float = 1.0
    of: str = "energy"
    each: list = field(default_factory=list)
    confirmed: bool = True

    @property
    def power(self):
        """Power of the error of the energy norm that the error falls with: quantities have products of two of them."""
        return 2 if self.quantity is not None and "extrapolated" in self.quantity else 1

    def alike(self, other):
        """Return True if the errors of two passes are those of one thing and degree."""
        return (self.of, self.degree) == (other.of, other.degree)

    def at_least(self, error):
        """Take notice that the mesh has an error, relative, that was not seen on it: what was expected of the next mesh
        was a part of that."""
        old = self.parts["mesh"]
        self.parts["mesh"] = new = max(old, float(error))
        if old > 0.0:
            self.part *= old / new
            if self.next is not None and self.next["mesh"] is not None:
                self.next = {**self.next, "mesh": self.next["mesh"] * new / old}
        self.error = sum(self.parts.values())

    def report(self):
        """Its entry of the report."""
        names = ("unknowns", "cells", "degree", "error", "expected", "estimate", "parts", "steps", "seconds", "solve",
                 "trials", "next")  # fmt: skip
        quantity = {} if self.quantity is None else {"quantity": self.quantity}
        quantity |= {"of": self.of, "errors": {one.of: one.error for one in self.each}} if self.each else {}
        return {name: getattr(self, name) for name in names} | quantity | {"memory_mb": self.memory / 2.0**20}


def said_of(part):
    """A part of the error in words."""
    return NAMES[part]


def line(passes, target):
    """A line for the terminal: the last pass, and what has most of its error."""
    last = passes[-1]
    parts = ", ".join(f"{name.replace('_', ' ')} {100.0 * value:.2g} %" for name, value in last.parts.items()
                      if value > 0.0)  # fmt: skip
    most = max(last.parts, key=last.parts.get)
    most = f"{said_of(most)}: {100.0 * last.parts[most]:.2g} %" if len(last.parts) > 1 else ""
    return (f"pass {len(passes)}  {last.unknowns} unknowns  degree {last.degree}  error {100.0 * last.error:.3g} % of "
            f"{last.of} ({parts if target.details else most})  {last.seconds:.1f} s")  # fmt: skip


def ended(passes, number, target, why):
    """The last line: what has been found on the best pass (its number, from 1), how exactly, for what, what half the
    error would take, and why there is no other pass."""
    best, seconds = passes[number - 1], sum(one.seconds for one in passes)
    found = ", ".join(_found(one) for one in best.each or [best])
    half = seconds + cost_of(passes, 0.5 * best.error)["seconds"]
    of = "" if number == len(passes) else f" (of pass {number})"
    return f"{found}{of}, {len(passes)} passes, {seconds:.2g} s; half the error would take about {half:.2g} s; {why}"


def _found(done):
    """A quantity and its error in words."""
    named = f"{100.0 * done.error:.3g} %"
    if done.quantity is None:
        return f"{done.of}: error {named}"
    value = done.quantity["value"]
    return f"{done.of} = {value:.5g} +- {abs(value) * done.error:.2g} ({named})"


def report(passes, number, target, reached):
    """Section `accuracy` of the report, of the pass of a number, from 1, whose answer is given."""
    best = passes[number - 1]
    return {
        "target": {"error": BEST if target.best else target.error, "of": target.of}, "reached": reached,
        "error": best.error, "expected": best.expected, "estimate": best.estimate, "parts": best.parts,
        "effectivity": {"least": best.known.least, "most": best.known.most, "of": best.known.words},
        **({} if best.quantity is None else {"quantity": best.quantity}),
        **({"each": {one.of: _entry(one) for one in best.each}} if best.each else {}), "rate": rate(passes),
        "half": cost_of(passes, 0.5 * best.error), "target_cost": cost_of(passes, target.error or 0.5 * best.error),
        "best": number, "passes": [one.report() for one in passes],
    }  # fmt: skip


def _entry(done):
    """Entry of one of several quantities in the report."""
    quantity = {} if done.quantity is None else {"quantity": done.quantity}
    return {"error": done.error, "expected": done.expected, "estimate": done.estimate, "parts": done.parts} | quantity


def rate(passes):
    """Power of the unknowns with which the error falls: as seen in the last passes, or as smooth solutions have."""
    new, smooth = passes[-1], passes[-1].power * passes[-1].degree / passes[-1].known.dim
    old = next((one for one in passes[-PATIENCE:-1] if one.unknowns < new.unknowns and one.alike(new)), None)
    if old is None:
        return smooth
    seen = np.log(old.parts["mesh"] / new.parts["mesh"]) / np.log(new.unknowns / old.unknowns)
    return float(np.clip(seen, 0.1 * smooth, 2.0 * smooth))


def cost_of(passes, error):
    """Unknowns and seconds that an error would take, from the last pass by the rate seen."""
    last = passes[-1]
    growth = max((last.error / error) ** (1.0 / rate(passes)), 1.0) if last.error > 0.0 else 1.0
    return {"error": error, "unknowns": last.unknowns * growth, "seconds": last.seconds * growth}


def memory_each(passes):
    """Bytes of all ranks together that an unknown more takes, as the passes have shown it."""
    first, last = passes[0], passes[-1]
    if last.unknowns > first.unknowns and last.memory - first.memory > TOLD:
        return (last.memory - first.memory) / (last.unknowns - first.unknowns)
    return BYTES[last.known.dim]


# [bytes] What a rank keeps of the displacements of load steps for the next mesh. From: chosen; a ball pressed into
# metal at 5 % has 167 load steps of 11,020 unknowns, 15 MB.
ROOM = 2**26
# [-] Part of the time by which two ends of load steps may differ. From: rounding.
SAME_TIME = 1e-9


class Known(NamedTuple):
    """Places of the bodies, at all nodes of a mesh of this rank.

    Attributes
    ----------
    times : list of float
        Ends of load steps.
    fields : list of ndarray (n_nodes, d)
        Displacements then [length].
    every : bool
        Whether these are all load steps.
    """

    times: list
    fields: list
    every: bool = True


class Watch(Observer):
    """Observer of one run: what its load steps say.

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation

    Attributes
    ----------
    times, fields
        As of :class:`Known`; where there is no room for all of them, of every other load step, or fewer, but always the
        last.
    squares : ndarray (n_cells,)
        Largest squared estimates of the cells of this rank over the load steps, block after block [energy].
    absolute, norm, algebraic : float
        Largest of the load steps [sqrt(energy)].
    record, time, unbalanced : dict, float, ndarray (n_owned, d)
        Of the last load step; forces that the solver has left unbalanced.
    """

    def __init__(self, simulation):
        self._simulation, self.times, self.fields, self._every = simulation, [], [], True
        self.squares, self.absolute, self.norm, self.algebraic = None, 0.0, 0.0, 0.0
        self.record, self.time, self.unbalanced = None, 0.0, None
        # the same on every rank
        space = simulation.problem.space
        self._most = max(ROOM * space.comm.size // (8 * space.n_dofs), 1)

    @property
    def known(self):
        """Knowledge for another run."""
        return Known(self.times, self.fields, self._every)

    def step(self, step, u, record):
        """Take what the load step says. *Collective.*"""
        estimate = self._simulation.error_estimate
        self.times.append(step.time)
        self.fields.append(at_nodes(self._simulation.problem.space, u))
        if len(self.times) > self._most:
            # counted from the end: what bodies do between two of them is a straight line for the next mesh
            self.times, self.fields, self._every = self.times[::-2][::-1], self.fields[::-2][::-1], False
        self.record, self.time, self.unbalanced = record, step.time, step.unbalanced
        self.squares = estimate.squares
        self.absolute = max(self.absolute, estimate.over_steps)
        self.algebraic = max(self.algebraic, estimate.last["algebraic"])
        self.norm = max(self.norm, estimate.last["energy_norm"])


def at_nodes(space, u):
    """A displacement (n_nodes, d) at all nodes of the mesh of this rank, whatever its degree. *Collective.*"""
    nodal, mesh = space.local.gather(u), space.mesh
    values = np.zeros((len(mesh.points), space.dim))
    for block, cells in zip(mesh.blocks, space.cells, strict=True):
        weights = shape(block.cell, space.degree, reference_nodes(block.cell, mesh.degree))
        values[block.nodes] = np.matmul(weights, nodal[cells])
    return values


class Beginning:
    """Expected places of the bodies, for :class:`pcontact.stepping.stepper.Stages`: they move on as on the last mesh.

    Where something remembers what has happened, the displacement of the other mesh itself is farther from the solution
    than that of the last load step: friction and plastic flow of the two meshes differ by more than they change in a
    load step. Where only some load steps are known, the way between them is no straight line, and the bodies are
    expected where they go on by themselves.

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That begins there.
    known : Known
        At the nodes of its mesh.
    """

    def __init__(self, simulation, known):
        space = simulation.problem.space
        rows = space.mesh_nodes[space.owned_local]
        self._simulation, self._times, self._every = simulation, np.array([0.0, *known.times]), known.every
        self._fields = [np.zeros((len(rows), space.dim)), *(field[rows] for field in known.fields)]

    def __call__(self, time):
        """The displacement (n_owned, d) at the end of a load step; None where that of the last mesh is not known."""
        stepper = self._simulation.stepper
        if not self._every:
            return None
        before, then = self.at(stepper.schedule.time), self.at(time)
        if before is None or then is None:
            return None
        return stepper.u.getArray(readonly=True).reshape(then.shape) + (then - before)

    def at(self, time):
        """The displacement of the last mesh; between ends of load steps the mean."""
        after = int(np.searchsorted(self._times, time * (1.0 - SAME_TIME)))
        if after == len(self._times):
            return None
        if after == 0:
            return self._fields[0]
        begin, end = self._times[after - 1 : after + 1]
        part = min((time - begin) / (end - begin), 1.0)
        return part * self._fields[after] + (1.0 - part) * self._fields[after - 1]
