"""The error that a run is to reach, from the scene and from what the user says beside it."""

from dataclasses import replace

from pcontact.runtime.errors import InputError
from pcontact.scene import validate
from pcontact.scene.keys import options as key_options
from pcontact.scene.target import Budget, Target

# free memory that a run may take, where the user does not say
FREE = 0.8


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
        return FREE * 1024.0 * float(found["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        return None
