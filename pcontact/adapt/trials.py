"""What other settings than those of a run change in its solution: runs on the same mesh, and changes to first order."""

from dataclasses import dataclass

import numpy as np

from pcontact.adapt import linearised, roughness, variants
from pcontact.adapt.passes import said_of
from pcontact.adapt.settings import FACETS, SHARE, STEPS_RATE, STEPS_SHARE
from pcontact.runtime import log

# [-] Part of what an error beside that of the mesh may have, up to which all of them are known well enough from one run
# with half the load steps. From: sheared blocks, where twice as many change the solution as much as half as many do.
ROUGHLY = 0.5
# [-] Part of the load steps that must have been left out for it. From: chosen.
FEWER = 0.75
# [-] Part of the error of load steps that twice as many take away.
DOUBLED = 1.0 - 0.5**STEPS_RATE


@dataclass
class Change:
    """What another setting changes.

    Attributes
    ----------
    value : float
        How large it is, relative.
    sign : float or None
        Of a number: toward what is more exact; None where that is not known, and of norms.
    joint : bool
        Whether it is that of several settings together, which stands for each of them.
    """

    value: float
    sign: float | None = None
    joint: bool = False


def sign_of(value, target):
    """The sign of a change, where the target names a number; None where it names a norm."""
    return None if target.quantity in ("energy", "pressure") else float(np.sign(value))


class Trials:
    """Tries other settings on the mesh of a run.

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run; its files are closed.
    target : pcontact.scene.target.Target
        Of what changes count.
    settings : pcontact.adapt.settings.Settings
    watch : pcontact.adapt.watch.Watch
    size : float
        What changes are divided by.

    Attributes
    ----------
    other : pcontact.adapt.variants.Answer or None
        Of another number of load steps and nothing else, where that has been tried.
    """

    def __init__(self, simulation, target, settings, watch, size):
        self._simulation, self._target, self._settings = simulation, target, settings
        self._watch, self._size, self.other = watch, size, None
        simulation.close()
        self._scene = settings.scene()
        self._scene.output.estimate = self._scene.output.checkpoint = False

    def all(self):
        """What each setting changes that leaves an error, by its name: :class:`Change`. *Collective.*"""
        tried = self._tried()
        known, signed = self._bounds(tried)
        return {"load_steps": Change(0.0)} | {name: self._change(name, tried[name], known, signed) for name in tried}

    def _tried(self):
        """Scenes with other settings, by the names of errors of `pcontact.adapt.passes.NAMES`. *Collective.*"""
        simulation, scene, tried = self._simulation, self._scene, {}
        if simulation.scene.remembers:
            tried["load_steps"] = variants.with_steps(scene, 2 * scene.steps.count)
        if any(not contact.tied for contact in scene.contacts):
            tried["frozen_partners"] = variants.searching(scene)
            tried["quadrature"] = variants.finer_quadrature(scene, simulation.problem.space.degree)
            if variants.bent(simulation):
                name = "curved_facets" if simulation.mesh.curved else "straight_facets"
                tried[name] = variants.smooth_facets(scene)
        return tried

    def _change(self, name, other, known, signed):
        """What a setting, that of a scene `other`, changes: as `known`, or by a run of its own where that is much.
        *Collective.*"""
        stays = name == "curved_facets" and bool(self._settings.staying)
        if stays and self._target.quantity == "pressure":
            # gaps times gamma, which the pressure of the first mesh has in it, are its own error
            return Change(roughness.pressure(self._simulation, self._watch, self._target.name) / self._size)
        value = known.get(name, np.inf) / self._size
        told = name == "load_steps" and self.other is not None
        if told or abs(value) <= SHARE * self._target.error:
            joint = self._simulation.scene.remembers and name != "load_steps"
            change = Change(abs(value), sign_of(value, self._target) if signed or told else None, joint)
        else:
            change = self._alone(name, other)
        if stays and self._target.quantity == "energy":
            # what curved facets change on the mesh and, by the gaps that it does not follow, on finer ones
            rest = roughness.energy(self._simulation, self._watch) / self._size
            change.value = float(np.hypot(change.value, rest))
        if name == "load_steps":
            # of what twice as many have changed, and what is left then
            change.value /= DOUBLED
        return change

    def facets(self, name):
        """What smooth surfaces change that facets stand for, by a run of its own: a :class:`Change`. *Collective.*"""
        return self._alone(name, variants.smooth_facets(self._scene))

    def _bounds(self, tried):
        """What settings of the contacts change, good enough where it is small, by their names, and whether the signs of
        numbers are known. *Collective.*

        To first order, see `pcontact.adapt.linearised`; where something remembers what has happened, what all of them
        change in one run stands for each, and for load steps, too, where half of them change hardly anything more.
        """
        simulation, scene = self._simulation, self._scene
        names = [name for name in tried if name != "load_steps" and not self._rough(name)]
        if not (scene.remembers or scene.temperatures):
            return linearised.changes(simulation, self._target, self._watch, names), True
        if self._target.quantity == "pressure":
            # pressures can be compared where surfaces are the same
            names = [name for name in names if name not in FACETS]
        other = scene
        if names:
            other = variants.finer_quadrature(variants.searching(scene), simulation.problem.space.degree)
        if set(names) & set(FACETS):
            other = variants.smooth_facets(other)
        known = self._of_fewer_steps(other, names) if "load_steps" in tried else {}
        if known or len(names) < 2:
            return known, False
        return dict.fromkeys(names, variants.difference(simulation, other, self._target, self._watch)), True

    def _of_fewer_steps(self, other, names):
        """What all settings together and half the load steps change, for each and for twice the load steps; empty where
        that is too much to be known so. Where there are no other settings it tells the load steps, however much, and
        with their sign. *Collective.*"""
        simulation, steps = self._simulation, other.steps.count
        fewer = -(-steps // 2)
        if fewer == steps:
            return {}
        answer = variants.answer(simulation, variants.with_steps(other, fewer), self._target, self._watch.known)
        if answer is None:
            return {}
        moved = variants.change_to(simulation, answer, self._target, self._watch)
        change = abs(moved)
        # corners of amplitudes are met, however few load steps are planned: then the change is that of the others
        if answer.number > FEWER * simulation.stepper.number:
            return dict.fromkeys(names, change)
        # of the error that falls from one to the other number, what is left
        _, times = variants.followed(simulation.stepper.number, answer.number, simulation.stepper.number)
        left = times * change
        if not names and np.isfinite(left):
            # more load steps change a number as fewer of them do, the other way round
            self.other = answer
            return {"load_steps": -np.copysign(left, moved) * DOUBLED}
        if not left + len(names) * change <= ROUGHLY * SHARE * self._target.error * self._size:
            return {}
        return dict.fromkeys(names, change) | {"load_steps": left * DOUBLED}

    def _rubs_otherwise(self):
        """Whether twice the load steps have been tried, and change so much that the next pass takes more, where bodies
        rub: then these tell what other settings change. Few load steps may rub otherwise with other facets. A lug on a
        loose pin: 3.1 % of the energy norm with three of them, 0.39 % with six and with twelve."""
        other, simulation = self.other, self._simulation
        if not simulation.scene.frictional or self._target.quantity == "pressure":
            return False
        if other is None or other.number <= simulation.stepper.number:
            return False
        change = abs(variants.change_to(simulation, other, self._target, self._watch)) / self._size
        return bool(change / DOUBLED > STEPS_SHARE * self._target.error)

    def _rough(self, name):
        """Whether a part is that of facets that finer cells of degree 1 do not tell."""
        return name in self._settings.staying and self._simulation.problem.space.degree == 1

    def _alone(self, name, other):
        """What a scene `other` changes, by a run of its own; nothing where that is not known. *Collective.*"""
        simulation, target, watch = self._simulation, self._target, self._watch
        if self._rough(name):
            value = variants.of_facets(simulation, self._settings.scene(), target)
        elif name == "load_steps":
            self.other = variants.answer(simulation, other, target, watch.known)
            value = variants.change_to(simulation, self.other, target, watch)
        elif self._rubs_otherwise():
            more = variants.with_steps(other, 2 * self._scene.steps.count)
            there = variants.answer(simulation, more, target, watch.known)
            value = variants.change_between(simulation, self.other, there, target)
        else:
            value = variants.difference(simulation, other, target, watch)
        if not np.isfinite(value):
            log.warning("not known: how much of the error is that of %s", said_of(name))
            value = 0.0
        return Change(abs(value) / self._size, sign_of(value, self._target))
