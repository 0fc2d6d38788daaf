"""What a scene says of the physics, as a table that a checkpoint keeps, and where two of them differ.

Steps, output, solver options and the name of the mesh file are not physics, nor are materials without a body. Numerics
of contacts are: what points remember belongs to them.
"""

import hashlib
from dataclasses import fields
from pathlib import Path

import numpy as np

from pcontact.runtime.messages import shown
from pcontact.scene.amplitude import MULTIPLIED, Amplitude, amplitude_of
from pcontact.scene.called import text_of
from pcontact.scene.model import (
    CONTACT_DEFAULTS,
    OPTIONAL_TABLES,
    Contact,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
    Steps,
    Temperature,
)
from pcontact.scene.phases import PHASED
from pcontact.scene.places import tables

# keys that are names of places, or tables of their own
LEFT_OUT = {MeshSpec: ("file", "geometry"), Contact: ("name", "obstacle")}
AMPLITUDE, FUNCTIONS = "amplitude", ("function", "gradient")
# two amplitudes that differ by less, in parts of the largest factor, are the same
SAME = 1e-12


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
    """Whether there is anything that an amplitude multiplies: supports that stand still have none to compare."""
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
    """Where the physics of a scene is not that of a checkpoint.

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
    """Whether two amplitudes (rows of time, factor) are the same up to a time: they are linear between their rows."""
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
