"""Functions that a scene names as "FILE.py:NAME"."""

import importlib.util
from collections.abc import Callable

from pcontact.scene.messages import input_error, shown
from pcontact.scene.model import Scene, place


def obstacle_functions(scene: Scene, index: int) -> tuple[Callable, Callable | None]:
    """Functions of the level set obstacle of a contact.

    Parameters
    ----------
    scene : Scene
        A valid scene.
    index : int
        Number of the contact in `scene.contacts`; its obstacle is a level set.

    Returns
    -------
    function : callable
        phi(x (n, d), t) -> (n,) signed distance, positive in free space [length].
    gradient : callable or None
        (x (n, d), t) -> (n, d).

    Raises
    ------
    InputError
        The file cannot be run, or holds no such function.
    """
    contact = scene.contacts[index]
    where = f"{place('contacts', index, contact.name)}.obstacle"
    gradient = contact.obstacle.gradient
    return (
        _load(scene, f"{where}.function", contact.obstacle.function),
        None if gradient is None else _load(scene, f"{where}.gradient", gradient),
    )


def _load(scene, key, reference):
    if callable(reference):
        return reference
    file, _, name = reference.rpartition(":")
    path = scene.folder / file
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the user's file raises is a fault of the input
        found = f"{reference!r}, the file stops with {type(error).__name__}: {error}"
        raise input_error(scene.where, key, found, "a Python file that can be imported") from error
    function = getattr(module, name, None)
    if not callable(function):
        found = f"{reference!r}, where {name} is {shown(function)}"
        raise input_error(scene.where, key, found, f"a function {name}(x, t) in {path}")
    return function
