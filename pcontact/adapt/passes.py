"""The error that a run is to reach, what is known of its passes, and what follows from them for reports."""

from dataclasses import dataclass, field, replace

import numpy as np

from pcontact.adapt.settings import FULL
from pcontact.runtime.errors import InputError
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


def free_memory():
    """Memory that this machine has free [bytes]; None where it does not say."""
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            found = dict(line.split(":", 1) for line in lines)
        return FULL * 1024.0 * float(found["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        return None


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
    """Power of the unknowns with which the error falls: as seen in the last two passes, or as smooth solutions have."""
    smooth = passes[-1].power * passes[-1].degree / passes[-1].known.dim
    if len(passes) < 2 or passes[-1].unknowns <= passes[-2].unknowns or not passes[-1].alike(passes[-2]):
        return smooth
    old, new = passes[-2:]
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
