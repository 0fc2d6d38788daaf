"""The errors that the mesh has no part in: measured once, on the first mesh, and followed to the finer ones."""

import time as clock
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from pcontact.adapt import linearised
from pcontact.adapt.settings import FACETS, FALLING, SHARE, STEPS_RATE
from pcontact.adapt.trials import Change, Trials, sign_of

# [-] Of the error of a number that load steps are named to leave, what is expected, and how far off that is, where
# bodies yield and elsewhere: it falls with `STEPS_RATE`, or faster. From: all of a range are as likely; runs with twice
# and half as many leave 0.6 to 1 of it for a disc between a stamp and an anvil and for a ball pressed into metal, 0 to
# 0.43 for a lug on a loose pin.
LIKELY, OFF = {True: 0.8, False: 0.5}, {True: 0.4 / 12.0**0.5, False: 1.0 / 12.0**0.5}
# [-] Power of the unknowns with which the error of load steps grows at most, and growth of the unknowns that tells it.
# From: a disc between a stamp and an anvil, 1.3 % with 1,114 unknowns and 6.9 % with 18,208: 0.6.
MOST_GROWTH, APART = 0.6, 1.5


@dataclass
class Part:
    """What is known of one of these errors.

    Attributes
    ----------
    name : str
        A key of `pcontact.adapt.passes.NAMES`.
    change : pcontact.adapt.trials.Change
    mesh : float
        The error of the mesh that has told it, relative.
    steps, unknowns : int
        Load steps there, and unknowns.
    grows : float
        Power of the unknowns with which it has grown, of load steps where bodies yield.
    """

    name: str
    change: Change
    mesh: float
    steps: int
    unknowns: int = 1
    grows: float = 0.0

    def left(self, mesh, steps, unknowns=1):
        """How large it is on a mesh with an error, and with so many load steps and unknowns, relative."""
        if self.name == "load_steps":
            finer = max(unknowns / self.unknowns, 1.0) ** self.grows
            return self.change.value * (self.steps / steps) ** STEPS_RATE * finer
        # what a finer rule changes falls as fast as what a finer mesh does, what straight facets do stays
        falls = self.name in FALLING and self.mesh > 0.0
        return self.change.value * (min(mesh / self.mesh, 1.0) if falls else 1.0)


class Beside:
    """What is known of these errors.

    Parameters
    ----------
    target : pcontact.scene.target.Target
        Of what they are the error.
    settings : pcontact.adapt.settings.Settings

    Attributes
    ----------
    other : pcontact.adapt.variants.Answer or None
        Of another number of load steps on the first mesh.
    follows : bool
        Whether two meshes have told the error of load steps, and so how it follows from one to the next.
    """

    def __init__(self, target, settings):
        self._target, self._settings, self.other = target, settings, None
        # by what brings them about; None before they have been measured
        self._parts, self._yields, self._touch, self.follows = None, False, False, False

    def parts(self, simulation, done, size, watch):
        """Them, relative, by what brings them about. *Collective.*

        Parameters
        ----------
        simulation : pcontact.simulation.Simulation
            That has run; its files are closed where they are measured.
        done : pcontact.adapt.passes.Pass
            With the part of the mesh; its `trials` are set.
        size : float
            What errors are divided by.
        watch : pcontact.adapt.watch.Watch

        Returns
        -------
        parts, toward : dict of str to float
            How large they are; of numbers, those whose signs are known: the change toward what is more exact.
        """
        if self._parts is None:
            self._measure(simulation, size, watch, done)
        else:
            if not self._settings.staying or self._told_by_fewer_steps(done):
                self._facets_anew(simulation, size, watch, done)
            self._quadrature_anew(simulation, size, watch, done)
        given = done.parts["mesh"], done.steps, done.unknowns
        parts = {name: one.left(*given) for name, one in self._parts.items()}
        done.steps_grow = self.grows
        if self._settings.searches:
            parts["frozen_partners"] = 0.0
        return parts, self.toward(parts)

    def once(self, parts):
        """Parts of the error, where what one run has shown of several settings together counts once: as the largest of
        theirs, the others as zero."""
        joint = [name for name in parts if name in self._parts and self._parts[name].change.joint]
        rest = set(joint) - {max(joint, key=parts.get, default=None)}
        return {name: 0.0 if name in rest else value for name, value in parts.items()}

    def toward(self, parts):
        """Of parts of the error of a number, those whose signs are known: the change toward what is more exact, as it
        is expected; see :meth:`once`."""
        signs = {name: one.change.sign for name, one in self._parts.items() if one.change.sign is not None}
        own = {name: signs[name] * value for name, value in self.once(parts).items() if name in signs}
        return own | {name: LIKELY[self._yields] * value for name, value in own.items() if name == "load_steps"}

    def unsure(self, parts):
        """How far off what :meth:`toward` has of load steps is, relative."""
        one = self._parts.get("load_steps")
        return 0.0 if one is None or one.change.sign is None else OFF[self._yields] * parts["load_steps"]

    def of_steps(self, count):
        """The error that so many load steps leave on the last mesh that has told it, relative."""
        one = self._parts.get("load_steps")
        return 0.0 if one is None else one.left(one.mesh, count)

    @property
    def grows(self):
        """Power of the unknowns with which the error of load steps has grown from mesh to mesh."""
        one = self._parts.get("load_steps")
        return 0.0 if one is None else one.grows

    def may_have_grown(self, unknowns):
        """Times as large as it is known to be the error of load steps may be on a mesh with so many unknowns: contacts
        that move over yielding cells leave more of it on finer meshes, and one mesh does not tell how much more. The
        force on a disc between a stamp and an anvil: 0.14 % with 1,114 unknowns, 0.99 % with 4,442."""
        if self.follows or not (self._yields and self._touch):
            return 1.0
        return max(unknowns / self.told_by(), 1.0) ** MOST_GROWTH

    def told_by(self):
        """Unknowns of the last mesh that has told the error of load steps."""
        return self._parts["load_steps"].unknowns

    def with_steps(self, left, done, sign):
        """Take notice of the error of load steps that a finer mesh than the first one tells.

        Parameters
        ----------
        left : float
            Relative.
        done : pcontact.adapt.passes.Pass
            Whose load steps leave it.
        sign : float or None
            Of what more load steps change in a number.
        """
        if not np.isfinite(left):
            return
        before = self._parts["load_steps"]
        self._tell("load_steps", Change(left, sign), done)
        now, known = self._parts["load_steps"], before.left(before.mesh, done.steps)
        self.follows = True
        now.grows, finer = before.grows, done.unknowns / before.unknowns
        if self._yields and finer > APART and known > 0.0 and left > 0.0:
            now.grows = float(np.clip(np.log(left / known) / np.log(finer), 0.0, MOST_GROWTH))
        done.steps_grow = now.grows

    def _tell(self, name, change, done):
        """A pass has told a part."""
        self._parts[name] = Part(name, change, done.parts["mesh"], done.steps, done.unknowns)

    def _measure(self, simulation, size, watch, done):
        """Measure them on the first mesh. *Collective.*"""
        self._parts, self._yields, self._touch = {}, simulation.scene.plastic, bool(simulation.problem.others)
        if simulation.problem.linear:
            return
        with _trying(done):
            trials = Trials(simulation, self._target, self._settings, watch, size)
            for name, change in trials.all().items():
                self._tell(name, change, done)
            self.other = trials.other

    def _told_by_fewer_steps(self, done):
        """Whether what facets change in a number has been told by fewer load steps than those of a pass: these may have
        rubbed otherwise. A lug on a loose pin: 0.6 % with three of them, 0.01 % with twelve."""
        facets = [one for name, one in self._parts.items() if name in FACETS and one.change.sign is not None]
        return not self._yields and any(one.steps < done.steps for one in facets)

    def _facets_anew(self, simulation, size, watch, done):
        """Measure what facets do anew, as long as it is much. *Collective.*"""
        wanted = SHARE * self._target.error
        large = [name for name in FACETS if name in self._parts and self._parts[name].change.value > wanted]
        if not large:
            return
        with _trying(done):
            trials = Trials(simulation, self._target, self._settings, watch, size)
            for name in large:
                self._tell(name, trials.facets(name), done)

    def _quadrature_anew(self, simulation, size, watch, done):
        """Measure to first order what a finer rule changes, as long as it is much: a first mesh that has met hardly a
        contact point tells nothing of others. The disc between a stamp and an anvil: 9 % of the force on the first
        mesh, 0.1 % on the third one. *Collective.*"""
        name, own = "quadrature", self._parts.get("quadrature")
        if self._target.quantity == "pressure" or own is None:
            return
        if own.left(done.parts["mesh"], done.steps) <= SHARE * self._target.error:
            return
        with _trying(done):
            value = linearised.changes(simulation, self._target, watch, [name])[name] / size
            if np.isfinite(value):
                # where something remembers, the last load step alone does not tell the sign
                sign = None if simulation.scene.remembers else sign_of(value, self._target)
                self._tell(name, Change(abs(value), sign), done)


@contextmanager
def _trying(done):
    """Count the seconds among those of the trials of a pass."""
    begun = clock.perf_counter()
    yield
    done.trials += clock.perf_counter() - begun
