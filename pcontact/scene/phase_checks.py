"""Checks of the phases of a scene, and of what acts in some of them."""

from pcontact.runtime.messages import input_error, listed, unknown_name
from pcontact.scene.model import Displacement, Scene, Steps
from pcontact.scene.phases import PHASED, acts, begun, come_and_go
from pcontact.scene.places import place


def _entries(scene):
    """Key path and table of all that may act in some phases only."""
    for key in ("bodies", *PHASED):
        for index, one in enumerate(getattr(scene, key)):
            yield place(key, index, one.name if key == "contacts" else one.region), one
    if scene.dynamics is not None:
        yield "dynamics", scene.dynamics


def check_phase_names(scene: Scene) -> None:
    """Names of phases are those of the scene, each once.

    Raises
    ------
    InputError
    """
    names = [phase.name for phase in scene.phases]
    for index, name in enumerate(names):
        if name in names[:index]:
            found = f"{name!r} a second time, as in phases[{names.index(name)}]"
            raise input_error(scene.where, f"{place('phases', index, name)}.name", found, "each once")
    for where, one in _entries(scene):
        if one.phases is not None and not names:
            found = f"{list(one.phases)} without [[phases]]"
            raise input_error(scene.where, f"{where}.phases", found, "[[phases]] as well, or no such key")
        for name in one.phases or ():
            if name not in names:
                found = unknown_name(name, "no such phase", names)
                raise input_error(scene.where, f"{where}.phases", found, listed(names))


def check_phases(scene: Scene) -> None:
    """What phases say of contacts.

    Raises
    ------
    InputError
    """
    contacts = {one.name: one for one in scene.contacts}
    if scene.steps.end != Steps().end:
        found = f"{scene.steps.end:g} together with [[phases]]"
        raise input_error(scene.where, "steps.end", found, "no such key: the run ends with the last phase")
    for number, phase in enumerate(scene.phases):
        for key in ("friction", "tied"):
            for name in getattr(phase, key) or ():
                where = f"{place('phases', number, phase.name)}.{key}"
                if name not in contacts:
                    found = unknown_name(name, "no such contact", contacts)
                    raise input_error(scene.where, where, found, listed(contacts))
                _check_change(scene, number, key, contacts[name], where)
    for where, one in _entries(scene):
        first = next((k for k, phase in enumerate(scene.phases) if acts(one, phase.name)), 0)
        if isinstance(one, Displacement) and one.turns and (first or begun(scene, one, len(scene.phases) - 1) > first):
            _check_turn(scene, where, one)
    if come_and_go(scene):
        _check_bodies(scene)
    if scene.output.estimate:
        allowed = "false: what ramps down in a phase is not in the estimate"
        raise input_error(scene.where, "output.estimate", "true together with phases", allowed)


def _check_change(scene, number, key, contact, where):
    """What a phase says of a contact is about one that acts, and has the law that changes."""
    phase = scene.phases[number]
    if not acts(contact, phase.name):
        raise input_error(scene.where, where, f"{contact.name!r}, which does not act in this phase", "one that acts")
    if contact.tied or (key == "friction" and (contact.tresca or contact.law)):
        law = "tied" if contact.tied else "of another law of friction"
        raise input_error(scene.where, where, f"{contact.name!r}, which is {law}", "a contact with friction or without")
    if key == "tied" and begun(scene, contact, number) == number:
        found = f"{contact.name!r}, which does not act in the phase before"
        raise input_error(scene.where, where, found, "a contact whose points have closed in the phase before")


def _check_bodies(scene):
    """Bodies that come and go: some body is there in each phase, and what begins without strain has small strain."""
    for number, phase in enumerate(scene.phases):
        if not any(acts(body, phase.name) for body in scene.bodies):
            where = f"{place('phases', number, phase.name)}.name"
            raise input_error(scene.where, where, f"{phase.name!r}, in which no body is there", "a phase with a body")
    for index, body in enumerate(scene.bodies):
        there = [acts(body, phase.name) for phase in scene.phases]
        where = f"{place('bodies', index, body.region)}.phases"
        if not any(there):
            raise input_error(scene.where, where, "no phase", "at least one phase, or no such body")
        comes = any(now and not before for before, now in zip(there, there[1:], strict=False))
        if comes and scene.finite(body):
            found = f"{list(body.phases)} of a body with finite strain, which begins in a later phase than the first"
            raise input_error(scene.where, where, found, 'strain = "small" of this body, or phases from the first one')


def _check_turn(scene, where, one):
    """Arms of a turn are those of the undeformed bodies."""
    found = f"{list(one.phases)} with an angle"
    raise input_error(scene.where, f"{where}.phases", found, "phases from the first one on, without a gap")
