"""Description of what a scene switches on and leaves out, in words.

What a scene says of the physics, as a table that a checkpoint keeps, and where two of them differ.

Steps, output, solver options and the name of the mesh file are not physics, nor are materials without a body. Numerics
of contacts are: what points remember belongs to them.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from pcontact.runtime.errors import shown
from pcontact.scene.amplitude import MULTIPLIED, Amplitude, amplitude_of
from pcontact.scene.expressions import text_of
from pcontact.scene.integrators import INTEGRATORS
from pcontact.scene.model import (
    CONTACT_DEFAULTS,
    LOADS,
    OPTIONAL_TABLES,
    Contact,
    Dynamics,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
    Steps,
    Temperature,
    tables,
)
from pcontact.scene.phases import PHASED
from pcontact.scene.validate import resolve_contacts

# keys that are names of places, or tables of their own
LEFT_OUT = {MeshSpec: ("file", "geometry"), Contact: ("name", "obstacle")}
AMPLITUDE, FUNCTIONS = "amplitude", ("function", "gradient")
# two amplitudes that differ by less, in parts of the largest factor, are the same
SAME = 1e-12


def _plastic(scene, finite=None):
    """Bodies that may yield, and how each hardens: all, or those with finite strain or without."""
    return [
        f"{body.region} ({_hardening(scene.materials[body.material])})"
        for body in scene.bodies
        if scene.materials[body.material].plastic and finite in (None, scene.finite(body))
    ]


def _strains(scene):
    """Elasticity and plasticity of the bodies, in lines."""
    lines = []
    for finite, words in ((False, "small strain"), (True, "finite strain")):
        bodies = [(one.region, scene.materials[one.material]) for one in scene.bodies if scene.finite(one) == finite]
        lines += _listed({
            f"{words} elasticity": {f"{name} ({one.law.replace('_', '-')})" if finite else name: 0
                                    for name, one in bodies},
            "orthotropic": [f"{name} ({_axes(one)})" for name, one in bodies if one.orthotropic],
            "laws that the program has added": [f"{name} ({one.law})" for name, one in bodies if one.added],
            f"{words} von Mises plasticity": _plastic(scene, finite),
        })  # fmt: skip
    return lines


def _listed(names):
    """A line of each piece of physics that has names."""
    return [f"{words}: {', '.join(some)}" for words, some in names.items() if some]


def _axes(material):
    """Describe the axes of an orthotropic material."""
    first = " ".join(f"{value:.4g}" for value in material.frame[0])
    around = "" if material.point is None else f" of radius, hoop and axis around {list(material.point)}"
    return f"axis 1 along {first}{around}"


def _hardening(material):
    kinds = {
        "tabulated": material.hardening_curve is not None,
        "isotropic": material.hardening > 0,
        "kinematic": material.kinematic_hardening > 0,
    }
    return (" and ".join(kind for kind, has in kinds.items() if has) or "no") + " hardening"


def _is_unbiased(contact):
    return contact.unbiased or (contact.all and contact.obstacle is None)


# physics that a scene may or may not ask for, and whether it does
_FEATURES = (
    ("contact", lambda scene: bool(scene.contacts)),
    ("friction", lambda scene: scene.frictional),
    ("plasticity", lambda scene: bool(_plastic(scene))),
    ("rigid obstacles", lambda scene: any(contact.obstacle is not None for contact in scene.contacts)),
    ("self contact", lambda scene: any(contact.meets_itself for contact in scene.contacts)),
    ("contact of all surfaces", lambda scene: any(contact.all and not contact.obstacle for contact in scene.contacts)),
    ("tied surfaces", lambda scene: any(contact.tied for contact in scene.contacts)),
    ("unbiased contact", lambda scene: any(_is_unbiased(contact) for contact in scene.contacts)),
    ("finite strain", lambda scene: any(scene.finite(body) for body in scene.bodies)),
    ("inertia", lambda scene: scene.dynamics is not None),
)


def describe(
    scene: Scene, dim: int | None = None, averaged: Sequence[str] = ()
) -> tuple[list[str], list[str]]:
    """Describe what is modelled and what is left out.

    Parameters
    ----------
    scene : Scene
        A valid scene; numerics that it does not say are described by their defaults.
    dim : int or None
        Space dimension of the mesh, where it is known.
    averaged : sequence of str
        Bodies that have cells with mean dilatation.

    Returns
    -------
    active, left_out : list of str
        One entry per piece of physics.
    """
    active = _strains(scene)
    if scene.mesh.kinematics != "plane_strain" or dim == 2:
        active.append(scene.mesh.kinematics.replace("_", " "))
    active += _listed({"degree 1": [body.region for body in scene.bodies if scene.lower(body)]})
    if scene.mesh.geometry is not None:
        active.append(f"new nodes on the geometry {Path(scene.mesh.geometry).name}")
    active += ["serendipity cells"] * scene.mesh.serendipity
    active += _listed({
        "reduced integration": [body.region for body in scene.bodies if body.integration == "reduced"],
        "mean dilatation": averaged,
    })  # fmt: skip
    active += [_contact(contact) for contact in resolve_contacts(scene, {}).contacts]
    loads, supports = scene.loads, scene.displacements
    dead = [load for load in loads if not load.follower]
    active += _listed({
        "pressure on the deformed surface": [load.region for load in loads if load.follower],
        **{key.replace("_", " "): [load.region for load in dead if getattr(load, key) is not None] for key in LOADS},
        "total force": [load.name or load.region or f"at {list(load.at)}" for load in loads if load.total],
        "thermal strain": [one.region or "all bodies" for one in scene.temperatures],
        "rigid groups": [one.name or one.region for one in scene.couplings if not one.average],
        "groups that move on average": [one.name or one.region for one in scene.couplings if one.average],
        "pre-tension": [one.name or one.region for one in scene.pretensions],
        "linear equations": [str(len(scene.equations))] * bool(scene.equations),
        "periodic groups": [f"{one.region} as {one.partner}" for one in scene.periodic],
        "springs to the ground": [spring.name or spring.region for spring in scene.springs],
        "prescribed displacement": dict.fromkeys(item.region for item in supports),
        "supports that turn": dict.fromkeys(item.region for item in supports if item.turns),
    })  # fmt: skip
    if scene.steps.viscous_stabilisation is not None:
        active.append(f"viscous stabilisation: {scene.steps.viscous_stabilisation:g}")
    if scene.dynamics is not None:
        active.append(f"inertia: {_dynamics(scene.dynamics)}")
    active += _listed({"phases": [phase.name for phase in scene.phases]})
    some = [f"{body.region} in {', '.join(body.phases)}" for body in scene.bodies if body.phases is not None]
    active += [f"bodies in some phases: {'; '.join(some)}"] * bool(some)
    active += ["error estimate of every step"] * scene.output.estimate
    return active, [name for name, asked in _FEATURES if not asked(scene)]


def _dynamics(dynamics: Dynamics) -> str:
    """Integrator and mass, and where there is inertia."""
    default = INTEGRATORS[dynamics.integrator].alpha
    alpha = default if dynamics.alpha is None else dynamics.alpha
    words = f"integrator {dynamics.integrator}" + ("" if alpha is None else f", alpha {alpha:g}")
    where = "" if dynamics.phases is None else f", in {', '.join(dynamics.phases)}"
    return f"{words}, {dynamics.mass} mass{where}"


def _initial(contact: Contact) -> str:
    """The gap between the undeformed bodies."""
    if contact.clearance is not None:
        words = f"initial clearance {contact.clearance:g}"
    else:
        words = f"initial overlap: {contact.interference}"
        words += f", gaps within {contact.adjust_within:g} too" if contact.adjust_within else ""
    return f"{words} by an amplitude" if contact.interference_amplitude is not None else words


def _coefficient(value: float | str) -> str:
    """A number or an expression."""
    return value if isinstance(value, str) else f"{value:g}"


def _contact(contact: Contact) -> str:
    """One line: partners, law, numerics."""
    if contact.obstacle is not None:
        moving = "moving " if contact.obstacle.displacement is not None else ""
        moving += "turning " if contact.obstacle.turns else ""
        source = "every body" if contact.all else contact.source
        partners = f"{source} -> {moving}rigid {contact.obstacle.shape.replace('_', ' ')}"
    elif contact.all:
        partners = f"every body with every other one{' and itself' if contact.meets_itself else ''}"
    elif contact.target == contact.source:
        partners = f"{contact.source} with itself"
        partners += "" if contact.meets_itself else ", bodies with others only"
    else:
        between = "<->" if contact.unbiased else "and" if contact.surfaces else "->"
        partners = f"{contact.source} {between} {contact.target}"
    law = "tied" if contact.tied else "frictionless"
    if contact.law:
        law = f"law {contact.law}"
    elif contact.friction:
        law = f"Coulomb friction {_coefficient(contact.friction)}"
        if contact.kinetic_friction is not None:
            law += f", {_coefficient(contact.kinetic_friction)} at large speeds"
        if contact.friction_limit is not None:
            law += f" up to {contact.friction_limit:g}"
        if contact.adhesion:
            law += f" plus adhesion {contact.adhesion:g}"
    elif contact.tresca:
        law = f"Tresca friction {contact.tresca:g}"
    layer = contact.pressure_overclosure is not None
    words = [partners, law, "pressure over overclosure" if layer else contact.formulation.replace("_", " ")]
    if contact.formulation == "nitsche":
        words.append(f"theta {contact.theta:g}")
    words.append("gamma0 from the element" if contact.gamma0 is None else f"gamma0 {contact.gamma0:g}")
    words += [contact.search.replace("_", " ")]
    words += ["gap or overlap stay"] if contact.tied else [_initial(contact)]
    if contact.smooth_geometry and not contact.tied:
        words.append("gaps of the smooth surfaces of straight facets")
    if contact.meets_itself:
        words.append("no partners in the same cell, across a shared node or through the material")
    if _is_unbiased(contact):
        words.append("unbiased: both sides are source and target with weight 1/2")
    return f"contact {contact.name}: " + ", ".join(words)


def physics(scene: Scene) -> dict[str, dict[str, object]]:
    """Physics of a valid scene, with what the command line has changed in it.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    dict of str to dict of str to value
        By the key path of a table, such as ``materials.soft``: its keys and values, in the types of JSON. Amplitudes
        are rows of (time, factor), written out where the scene has none; functions are given by their text.
    """
    used = {body.material for body in scene.bodies}
    result = {}
    for where, table in tables(scene):
        if isinstance(table, Steps | Output) or (isinstance(table, Material) and where.partition(".")[2] not in used):
            continue
        left_out = (*LEFT_OUT.get(type(table), ()), *(() if _acts(table) else (AMPLITUDE,)))
        # keys that are not said are not kept: those that are new in a later version of the program are not missed
        said = [
            field.name
            for field in fields(table)
            if field.name not in left_out and (field.name == AMPLITUDE or getattr(table, field.name) != field.default)
        ]
        result[where] = {key: _plain(scene, table, key, getattr(table, key)) for key in said}
    return result


def physics_so_far(scenes: list[Scene]) -> dict[str, dict[str, object]]:
    """Physics of the phases of a run up to the present one, which end with the steps of their scenes.

    Parameters
    ----------
    scenes : list of Scene
        One of a run without phases.

    Returns
    -------
    dict of str to dict of str to value
        As :func:`physics`; of later phases what may act in some of them, with the number of the phase.
    """
    result = physics(scenes[0])
    if scenes[1:]:
        result["phases[0]"] = {"end": scenes[0].steps.end}
    for number, scene in enumerate(scenes[1:], 1):
        result[f"phases[{number}]"] = {"end": scene.steps.end}
        result |= {f"phases[{number}]: {where}": table for where, table in physics(scene).items()
                   if where.partition("[")[0] in PHASED or table.keys() & {"absent", "since"}
                   or where in OPTIONAL_TABLES}  # fmt: skip
    return result


def _acts(table):
    """Return whether there is anything that an amplitude multiplies: supports that stand still have none to compare."""
    if isinstance(table, Temperature) and table.file is not None:
        return True
    values = [getattr(table, key) for key in MULTIPLIED.get(type(table), ())]
    numbers = [number for value in values for number in (value if isinstance(value, list | tuple) else [value])]
    return any(number not in (None, "free") and number for number in numbers)


def _plain(scene, table, key, value):
    """A value of a table in the types of JSON."""
    if key == AMPLITUDE:
        rows = amplitude_of(table, scene.steps.end)
        return np.column_stack([rows.times, rows.factors]).tolist()
    if key in FUNCTIONS and value is not None:
        return _text(scene, value)
    if isinstance(table, Obstacle | Temperature) and key == "file" and value is not None:
        text = hashlib.sha256((scene.folder / value).read_bytes()).hexdigest()[:16]
        return f"{Path(value).name}, text {text}"
    return [_plain(scene, table, None, part) for part in value] if isinstance(value, list | tuple) else value


def _text(scene, reference):
    """Name of a function and a hash of the text that defines it: that of its file, or its own."""
    if callable(reference):
        return text_of(reference)
    name, path = reference, scene.folder / reference.rpartition(":")[0]
    if not path.is_file():
        return name
    text = path.read_bytes()
    return f"{name}, text {hashlib.sha256(text).hexdigest()[:16]}"


def differences(then: dict, now: dict, time: float) -> list[tuple[str, str, str]]:
    """Return the points in which the physics of a scene is not that of a checkpoint.

    Parameters
    ----------
    then, now : dict
        Of :func:`physics`.
    time : float
        Of the checkpoint. Amplitudes may differ after it: what has happened so far is the same.

    Returns
    -------
    list of (str, str, str)
        Key path, what the scene has there, what the checkpoint has.
    """
    found = []
    for where in dict.fromkeys([*now, *then]):
        if where not in then or where not in now:
            has, had = ("such a table" if where in side else "no such table" for side in (now, then))
            found.append((where, has, had))
            continue
        for key in dict.fromkeys([*now[where], *then[where]]):
            # numerics of contacts are kept whether they are said or not; those that are new have been the default
            new, old = (side[where].get(key, CONTACT_DEFAULTS.get(key)) for side in (now, then))
            same = _same_so_far(new, old, time) if key == AMPLITUDE and new and old else new == old
            if not same:
                found.append((f"{where}.{key}", *_said(key, new, old, time)))
    return found


def _shown(value):
    if value is None:
        return "nothing (the default)"
    return str(value) if isinstance(value, int | float | str) else shown(value)


def _same_so_far(new, old, time):
    """Tell whether two amplitudes (rows of time, factor) are the same up to a time: they are linear between rows."""
    new, old = (Amplitude(*np.array(rows, dtype=np.float64).T) for rows in (new, old))
    times = np.concatenate([new.times, old.times, [0.0, time]])
    times = times[times <= time]
    a, b = new.factor(times), old.factor(times)
    return bool(np.max(np.abs(a - b)) <= SAME * max(np.max(np.abs(a)), np.max(np.abs(b))))


def _said(key, new, old, time):
    """The two values in the words of a message."""
    if key != AMPLITUDE:
        return tuple(_shown(value) for value in (new, old))
    factors = [f"{Amplitude(*np.array(rows, dtype=np.float64).T).factor(time):g}" for rows in (new, old) if rows]
    return (f"a factor of {factors[0]} at time {time:g}, or another one before", f"{factors[-1]}")
