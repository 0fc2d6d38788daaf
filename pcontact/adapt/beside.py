"""The errors that the mesh has no part in: measured once, on the first mesh, and followed to the finer ones."""

import time as clock

import numpy as np

from pcontact.adapt import linearised, roughness, variants
from pcontact.adapt.passes import said_of
from pcontact.adapt.settings import FACETS, FALLING, SHARE, STEPS_RATE
from pcontact.runtime import log

# [-] Part of what an error beside that of the mesh may have, up to which all of them are known well enough from one run
# with half the load steps. From: sheared blocks, where twice as many change the solution as much as half as many do.
ROUGHLY = 0.5
# [-] Part of the load steps that must have been left out for it. From: chosen.
FEWER = 0.75
# [-] Of the error of a number that load steps are named to leave, what is expected, where bodies yield and elsewhere:
# it falls with `STEPS_RATE`, or faster. From: runs with twice and half as many leave 0.6 to 1 of it for a disc between
# a stamp and an anvil and for a ball pressed into metal, 0 to 0.43 for a lug on a loose pin.
LIKELY = {True: 0.8, False: 0.6}


class Beside:
    """What is known of these errors.

    Parameters
    ----------
    target : pcontact.scene.target.Target
        Of what they are the error.
    settings : pcontact.adapt.settings.Settings

    Attributes
    ----------
    doubled : pcontact.adapt.variants.Answer or None
        Of twice the load steps on the first mesh.
    """

    def __init__(self, target, settings):
        self._target, self._settings, self._found, self.doubled = target, settings, None, None
        # of changes of numbers, as far as they are known; parts that one run with all settings stands for; the part of
        # the mesh that has told a part, where it is not the first one; and whether bodies yield
        self._signs, self._together, self._anew, self._yields = {}, [], {}, False

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
        if self._found is None:
            begun = clock.perf_counter()
            self._found = self._measure(simulation, size, watch)
            self._of, self._steps, self._yields = done.parts["mesh"], done.steps, simulation.scene.plastic
            done.trials = clock.perf_counter() - begun
        else:
            if not self._settings.staying:
                self._facets_anew(simulation, size, watch, done)
            self._quadrature_anew(simulation, size, watch, done)
        # what a finer rule changes falls as fast as what a finer mesh does, what straight facets do stays
        parts = {name: self._finer(name, done) * value for name, value in self._found.items()}
        if "load_steps" in parts:
            parts["load_steps"] = self.of_steps(done.steps)
        if self._settings.searches:
            parts["frozen_partners"] = 0.0
        return parts, self.toward(parts)

    def _finer(self, name, done):
        """What a finer mesh leaves of a part."""
        of = self._anew.get(name, self._of)
        return min(done.parts["mesh"] / of, 1.0) if name in FALLING and of > 0.0 else 1.0

    def once(self, parts):
        """Parts of the error, where what one run has shown of several settings together counts once: as the largest of
        theirs, the others as zero."""
        together = [name for name in self._together if name in parts]
        rest = set(together) - {max(together, key=parts.get, default=None)}
        return {name: 0.0 if name in rest else value for name, value in parts.items()}

    def toward(self, parts):
        """Of parts of the error of a number, those whose signs are known: the change toward what is more exact, as it
        is expected; see :meth:`once`."""
        own = {name: self._signs[name] * value for name, value in self.once(parts).items() if name in self._signs}
        return own | {name: LIKELY[self._yields] * value for name, value in own.items() if name == "load_steps"}

    def of_steps(self, count):
        """The error that so many load steps leave, relative."""
        return self._found.get("load_steps", 0.0) * (self._steps / count) ** STEPS_RATE

    def with_steps(self, left, steps, sign):
        """Take notice of the error of load steps that a finer mesh than the first one tells.

        Parameters
        ----------
        left : float
            Relative.
        steps : int
            Load steps that leave it.
        sign : float
            Of what more load steps change in a number.
        """
        if np.isfinite(left):
            self._found["load_steps"], self._steps = left, steps
            self._sign("load_steps", sign)

    def _measure(self, simulation, size, watch):
        if simulation.problem.linear:
            return {}
        simulation.close()
        scene, tried = self._settings.scene(), {}
        scene.output.estimate = scene.output.checkpoint = False
        if simulation.scene.remembers:
            tried["load_steps"] = variants.with_steps(scene, 2 * scene.steps.count)
        if any(not contact.tied for contact in scene.contacts):
            tried["frozen_partners"] = variants.searching(scene)
            tried["quadrature"] = variants.finer_quadrature(scene, simulation.problem.space.degree)
            if variants.bent(simulation):
                name = "curved_facets" if simulation.mesh.curved else "straight_facets"
                tried[name] = variants.smooth_facets(scene)
        found = {"load_steps": 0.0}
        known, signed = self._bounds(simulation, scene, tried, size, watch)
        for name, other in tried.items():
            if name == "curved_facets" and self._settings.staying and self._target.quantity == "pressure":
                # gaps times gamma, which the pressure of the first mesh has in it, are its own error
                found[name] = roughness.pressure(simulation, watch, self._target.name) / size
                continue
            value = known.get(name, np.inf) / size
            alone = not abs(value) <= SHARE * self._target.error
            if alone:
                value = self._tried(simulation, name, other, size, watch)
            if alone or signed:
                self._sign(name, value)
            if not alone and simulation.scene.remembers and name != "load_steps":
                self._together.append(name)
            value = abs(value)
            # what curved facets change on the mesh and, by the gaps that it does not follow, on finer ones; where nodes
            # come onto a geometry, finer meshes have smaller gaps to follow
            if name == "curved_facets" and self._settings.staying and self._target.quantity == "energy":
                value = float(np.hypot(value, roughness.energy(simulation, watch) / size))
            # of what twice as many have changed, and what is left then
            found[name] = value / (1.0 - 0.5**STEPS_RATE) if name == "load_steps" else value
        return found

    def _sign(self, name, value):
        """Keep the sign of a change, where it is one of a number."""
        if self._target.quantity not in ("energy", "pressure"):
            self._signs[name] = float(np.sign(value))

    def _bounds(self, simulation, scene, tried, size, watch):
        """What settings of the contacts change, good enough where it is small, by their names, and whether the signs of
        numbers are known. *Collective.*

        To first order, see `pcontact.adapt.linearised`; where something remembers what has happened, what all of them
        change in one run stands for each, and for load steps, too, where half of them change hardly anything more.
        """
        space = simulation.problem.space
        names = [name for name in tried if name != "load_steps" and not self._rough(simulation, name)]
        if not (scene.remembers or scene.temperatures):
            return linearised.changes(simulation, self._target, watch, names), True
        if self._target.quantity == "pressure":
            # pressures can be compared where surfaces are the same
            names = [name for name in names if name not in FACETS]
        other = variants.finer_quadrature(variants.searching(scene), space.degree) if names else scene
        other = variants.smooth_facets(other) if set(names) & set(FACETS) else other
        known = self._of_fewer_steps(simulation, other, names, size, watch) if "load_steps" in tried else {}
        if known or len(names) < 2:
            return known, False
        return dict.fromkeys(names, variants.difference(simulation, other, self._target, watch)), True

    def _of_fewer_steps(self, simulation, other, names, size, watch):
        """What all settings together and half the load steps change, for each and for twice the load steps; empty where
        that is too much to be known so. *Collective.*"""
        steps = other.steps.count
        fewer = -(-steps // 2)
        if fewer == steps:
            return {}
        answer = variants.answer(simulation, variants.with_steps(other, fewer), self._target, watch.known)
        if answer is None:
            return {}
        change = abs(variants.change_to(simulation, answer, self._target, watch))
        # corners of amplitudes are met, however few load steps are planned: then the change is that of the others
        if answer.number > FEWER * simulation.stepper.number:
            return dict.fromkeys(names, change)
        # of the error that falls from one to the other number, what is left
        left = change / ((simulation.stepper.number / answer.number) ** STEPS_RATE - 1.0)
        if not left + len(names) * change <= ROUGHLY * SHARE * self._target.error * size:
            return {}
        return dict.fromkeys(names, change) | {"load_steps": left * (1.0 - 0.5**STEPS_RATE)}

    def _rough(self, simulation, name):
        """Whether a part is that of facets that finer cells of degree 1 do not tell."""
        return name in self._settings.staying and simulation.problem.space.degree == 1

    def _tried(self, simulation, name, other, size, watch):
        """What a scene `other` changes, relative, of numbers with its sign; 0 where that is not known. *Collective.*"""
        if self._rough(simulation, name):
            value = variants.of_facets(simulation, self._settings.scene(), self._target) / size
        elif name == "load_steps":
            self.doubled = variants.answer(simulation, other, self._target, watch.known)
            value = variants.change_to(simulation, self.doubled, self._target, watch) / size
        else:
            value = variants.difference(simulation, other, self._target, watch) / size
        if not np.isfinite(value):
            log.warning("not known: how much of the error is that of %s", said_of(name))
            return 0.0
        return value

    def _facets_anew(self, simulation, size, watch, done):
        """Measure what facets do that have come onto the geometry, as long as it is much. *Collective.*"""
        large = [name for name in FACETS if self._found.get(name, 0.0) > SHARE * self._target.error]
        if not large:
            return
        begun = clock.perf_counter()
        simulation.close()
        scene = self._settings.scene()
        scene.output.estimate = scene.output.checkpoint = False
        for name in large:
            value = self._tried(simulation, name, variants.smooth_facets(scene), size, watch)
            self._sign(name, value)
            self._found[name] = abs(value)
        done.trials += clock.perf_counter() - begun

    def _quadrature_anew(self, simulation, size, watch, done):
        """Measure to first order what a finer rule changes, as long as it is much: a first mesh that has met hardly a
        contact point tells nothing of others. The disc between a stamp and an anvil: 9 % of the force on the first
        mesh, 0.1 % on the third one. *Collective.*"""
        left = self._finer("quadrature", done) * self._found.get("quadrature", 0.0)
        if self._target.quantity == "pressure" or left <= SHARE * self._target.error:
            return
        begun = clock.perf_counter()
        value = linearised.changes(simulation, self._target, watch, ["quadrature"])["quadrature"] / size
        if np.isfinite(value):
            self._found["quadrature"], self._anew["quadrature"] = abs(value), done.parts["mesh"]
            self._together = [name for name in self._together if name != "quadrature"]
            self._sign("quadrature", value)
            if simulation.scene.remembers:
                # the last load step alone does not tell it
                self._signs.pop("quadrature", None)
        done.trials += clock.perf_counter() - begun
