"""The phases of a run: what a scene is in each of them, a scene of its own that knows of no others."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.scene.amplitude import MULTIPLIED, corners, timed
from pcontact.scene.keys import keys
from pcontact.scene.model import LIST_TABLES, LONGER, SHORTEST, Body, Contact, Equation, Scene, groups_named

# tables of which some may act in some phases only, and those that are on groups, bodies left aside
PHASED = tuple(name for name, cls in LIST_TABLES.items() if "phases" in keys(cls) and cls is not Body)
GROUPED = tuple(name for name, cls in LIST_TABLES.items() if cls is Equation or (
    cls is not Body and any(one.group for one in keys(cls).values())))  # fmt: skip
# keys of bodies that mean nothing without inertia: how they begin to move, and what resists that
STARTS = ("initial_velocity", "initial_displacement")
DAMPING = ("mass_damping", "stiffness_damping")
# tables with amplitudes
MOVED = tuple(name for name, cls in LIST_TABLES.items() if "amplitude" in keys(cls))


class Span(NamedTuple):
    """A phase in the time of the run.

    Attributes
    ----------
    name : str
    begin, end : float
        [time]
    """

    name: str
    begin: float
    end: float


def spans(scene: Scene) -> list[Span]:
    """The phases of a scene one after the other; none where the run has no phases."""
    if not scene.phases:
        return []
    ends = np.cumsum([phase.duration for phase in scene.phases]).tolist()
    return [Span(phase.name, begin, end)
            for phase, begin, end in zip(scene.phases, [0.0, *ends[:-1]], ends, strict=True)]  # fmt: skip


def phase_at(scene: Scene, time: float) -> int:
    """Number of the phase in which a time is; that of an end belongs to the phase that ends."""
    ends = [span.end for span in spans(scene)]
    return min(int(np.searchsorted(np.array(ends) * (1.0 + 1e-12), time)), len(ends) - 1)


def acts(one: object, name: str) -> bool:
    """Return whether something acts in a phase."""
    return one.phases is None or name in one.phases


def moves(scene: Scene, number: int) -> bool:
    """Return whether bodies have inertia in a phase."""
    return scene.dynamics is not None and acts(scene.dynamics, scene.phases[number].name)


def begun(scene: Scene, one: object, number: int) -> int:
    """Number of the phase since which something has acted that acts in a phase."""
    while number > 0 and acts(one, scene.phases[number - 1].name):
        number -= 1
    return number


def scene_of(scene: Scene, number: int) -> Scene:
    """The scene in one of its phases.

    Parameters
    ----------
    scene : Scene
        It is left as it is.
    number : int
        Of the phase, from 0.

    Returns
    -------
    Scene
        Without phases: with what acts in this one, and steps that end with it. What has no amplitude is a ramp over
        the first phase in which it acts.
    """
    every, phase = spans(scene), scene.phases[number]

    def rising(one, first):
        if one.amplitude is not None or (type(one) in MULTIPLIED and timed(one)):
            return one
        return replace(one, amplitude=((every[first].begin, 0.0), (every[first].end, 1.0)))

    lists = {key: [one for one in getattr(scene, key) if acts(one, phase.name)] for key in PHASED}
    # sections that do not draw stay as they are
    lists["pretensions"] = [replace(one, locked=not acts(one, phase.name)) for one in scene.pretensions]
    lists |= {key: list(getattr(scene, key)) for key in MOVED if key not in PHASED}
    for key in MOVED:
        lists[key] = [rising(one, begun(scene, one, number) if key in PHASED else 0) for one in lists[key]]
    for k, one in enumerate(lists["contacts"]):
        if one.obstacle is not None and one.obstacle.moves:
            one = replace(one, obstacle=rising(one.obstacle, begun(scene, one, number)))
        lists["contacts"][k] = _contact(one, phase)
    for key in PHASED:
        lists[key] = [replace(one, phases=None) for one in lists[key]]
    # bodies keep their numbers
    lists["bodies"] = [_body(scene, one, number) for one in scene.bodies]
    lists["dynamics"] = replace(scene.dynamics, phases=None) if moves(scene, number) else None
    if lists["dynamics"] is None:
        lists["couplings"] = [replace(one, mass=0.0, inertia=0.0) for one in lists["couplings"]]
    count, span, steps = phase.count or scene.steps.count, every[number], scene.steps
    longest = None
    if steps.control == "auto":
        longest = min(LONGER * phase.duration / count, phase.duration) if steps.max_step is None else steps.max_step
    shortest = phase.duration / count * SHORTEST if steps.min_step is None else steps.min_step
    return replace(scene, **lists, phases=[], steps=replace(
        steps, end=span.end, count=count, min_step=shortest, max_step=longest))  # fmt: skip


def closing(scene: Scene, number: int) -> Scene:
    """The scene in one of its phases, or the scene of a run without any, in which gaps that are closed by `bilateral`
    close over the first load step: a shorter one, after a cut, closes less of them. So do overlaps where bodies have
    inertia from the beginning on: all at once they would set free an energy that gamma0 and the cells decide."""
    part, begin = (scene_of(scene, number), spans(scene)[number].begin) if scene.phases else (scene, 0.0)
    planned = begin + (part.steps.end - begin) / part.steps.count
    first = min([planned, *(time for time in corners(part) if time > begin)])
    new = {one.name for one in scene.contacts if not scene.phases or begun(scene, one, number) == number}
    flung = part.dynamics is not None and number == 0

    def gradual(one):
        return one.bilateral or (flung and not one.tied and one.pressure_overclosure is None)

    return replace(part, contacts=[
        replace(one, interference_amplitude=((begin, 0.0), (first, 1.0)))
        if gradual(one) and one.interference_amplitude is None and one.name in new else one for one in part.contacts
    ])  # fmt: skip


def _body(scene: Scene, body: Body, number: int) -> Body:
    """A body as a phase has it; without phases of its own it says what it says in a run without any."""
    if scene.dynamics is not None and (any(moves(scene, k) for k in range(number)) or not moves(scene, number)):
        # they have begun to move, or do not yet
        gone = STARTS if moves(scene, number) else (*STARTS, *DAMPING)
        body = replace(body, **{key: getattr(Body, key) for key in gone})
    if body.phases is None:
        return body
    there = acts(body, scene.phases[number].name)
    return replace(body, phases=None, absent=not there, since=begun(scene, body, number) if there else 0)


def groups_of(scene: Scene) -> set[str]:
    """Groups that what acts in a scene is on, and those that are probed."""
    named = {name for key in GROUPED for one in getattr(scene, key) for _, name, _ in groups_named(one)}
    return named | set(scene.output.probes)


def left(scene: Scene, missing: set[str]) -> Scene:
    """A scene without what is on groups of which nothing is left."""
    lists = {key: [one for one in getattr(scene, key) if not missing & {name for _, name, _ in groups_named(one)}]
             for key in GROUPED}  # fmt: skip
    probes = [name for name in scene.output.probes if name not in missing]
    return replace(scene, **lists, output=replace(scene.output, probes=probes))


def come_and_go(scene: Scene) -> bool:
    """Return whether bodies are there in some phases only."""
    return any(body.phases is not None for body in scene.bodies)


def _contact(contact: Contact, phase) -> Contact:
    """A contact as a phase has it; the coefficient of a phase is the same at all speeds of slip."""
    if contact.name in (phase.friction or {}):
        contact = replace(contact, friction=phase.friction[contact.name], kinetic_friction=None, friction_decay=None)
    return replace(contact, held=contact.name in phase.tied)
