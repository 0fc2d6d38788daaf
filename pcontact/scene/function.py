"""Level sets of a scene: functions named as "FILE.py:NAME", or expressions, and the watch over what they return."""

import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from pcontact.runtime.files import GEOMETRIES, SCRIPTS
from pcontact.runtime.messages import input_error, shown
from pcontact.scene.called import Watched
from pcontact.scene.expression import Expression
from pcontact.scene.model import Scene
from pcontact.scene.places import place

# characters of an expression in a message
SHOWN = 80
# numba reads it where it starts; it may say where compiled kernels are, which are pickled objects
NUMBA = ".numba_config.yaml"
# a value of an option of PETSc that names neither a file, which it may write or run, nor a command; hypre has words
# such as SOR/Jacobi
PLAIN = re.compile(r"[\w.,+-]*|\w[\w+-]*(/\w[\w+-]*)+", re.ASCII)


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
    function : Watched
        phi(x (n, d), t) -> (n,) signed distance, positive in free space [length].
    gradient : Watched or None
        (x (n, d), t) -> (n, d).

    Raises
    ------
    InputError
        The file cannot be run, or holds no such function.
    """
    contact = scene.contacts[index]
    where = f"{place('contacts', index, contact.name)}.obstacle"
    gradient = contact.obstacle.gradient
    if contact.obstacle.expression is not None:
        text, key = contact.obstacle.expression, f"{where}.expression"
        function, name = Expression(text), text if len(text) <= SHOWN else f"{text[:SHOWN]}..."
        return (
            Watched(function, scene.where, key, name, False),
            Watched(function.gradient, scene.where, f"{key}, its gradient", name, True),
        )
    return (
        _load(scene, f"{where}.function", contact.obstacle.function, False),
        None if gradient is None else _load(scene, f"{where}.gradient", gradient, True),
    )


def require_no_code(scene: Scene) -> None:
    """Refuse a scene that could run a program: of Python, of gmsh, or through settings of PETSc or numba.

    Raises
    ------
    InputError
    """
    if Path(NUMBA).exists():
        raise input_error(NUMBA, "file", "settings of numba in the working directory, with -no_code", "no such file")
    for key, found, allowed in _programs(scene):
        raise input_error(scene.where, key, f"{found!r}, a program, with -no_code", allowed)


def _programs(scene):
    """Keys that run something, their values, and what is allowed in their place."""
    for index, contact in enumerate(scene.contacts):
        for key in ("function", "gradient"):
            reference = None if contact.obstacle is None else getattr(contact.obstacle, key)
            if isinstance(reference, str):
                yield f"{place('contacts', index, contact.name)}.obstacle.{key}", reference, "expression"
    geometry = scene.mesh.geometry
    if geometry is not None and Path(geometry).suffix.lower() in SCRIPTS:
        yield "mesh.geometry", str(geometry), f"a file {', '.join(one for one in GEOMETRIES if one not in SCRIPTS)}"
    for name, value in scene.petsc.items():
        if "python" in f"{name} {value}".lower() or not PLAIN.fullmatch(value):
            yield f"petsc.{name}", value, "numbers and words that name no file and nothing of Python"


def _load(scene, key, reference, vector):
    if callable(reference):
        name = getattr(reference, "__name__", type(reference).__name__)
        return Watched(reference, scene.where, key, name, vector)
    file, _, name = reference.rpartition(":")
    path = scene.folder / file
    module = ModuleType(path.stem)
    module.__file__ = str(path)
    try:
        # an import would leave compiled code beside the scene, and several ranks would write it
        exec(compile(path.read_bytes(), str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:  # whatever the user's file raises is a fault of the input
        found = f"{reference!r}, the file stops with {type(error).__name__}: {error}"
        raise input_error(scene.where, key, found, "a Python file that can be imported") from error
    function = getattr(module, name, None)
    if not callable(function):
        found = f"{reference!r}, where {name} is {shown(function)}"
        raise input_error(scene.where, key, found, f"a function {name}(x, t) in {path}")
    return Watched(function, scene.where, key, reference, vector)
