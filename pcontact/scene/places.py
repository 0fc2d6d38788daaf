"""The tables of a scene and what they are called in messages."""

from collections.abc import Iterable, Iterator

from pcontact.runtime.errors import input_error
from pcontact.scene.keys import keys
from pcontact.scene.model import LIST_TABLES, NAMED, OPTIONAL_TABLES, Contact, Equation, Scene
from pcontact.scene.target import Target

# what is wrong in a table: the key (empty: the table), what was found, what is allowed
Found = Iterator[tuple[str, str, str]]


def refuse(scene: Scene, where: str, found: Iterable[tuple[str, str, str]]) -> None:
    """Raise the first of what is wrong in the table at a key path.

    Raises
    ------
    InputError
    """
    for key, what, allowed in found:
        raise input_error(scene.where, ".".join(filter(None, (where, key))), what, allowed)


def place(key: str, index: int, name: object) -> str:
    """Key path of an entry of a list of tables, such as ``contacts[0] (ball-block)``."""
    return f"{key}[{index}] ({name})" if isinstance(name, str) and name else f"{key}[{index}]"


def tables(scene: Scene) -> Iterator[tuple[str, object]]:
    """All tables of a scene with their key paths, in the order of a scene file, obstacles included."""
    if isinstance(scene.accuracy, Target):
        yield "accuracy", scene.accuracy
        yield "accuracy.budget", scene.accuracy.budget
    yield "mesh", scene.mesh
    for name, material in scene.materials.items():
        yield f"materials.{name}", material
    for key in LIST_TABLES:
        for index, item in enumerate(getattr(scene, key)):
            where = place(key, index, item.name if isinstance(item, NAMED) else item.region)
            yield where, item
            if isinstance(item, Contact) and item.obstacle is not None:
                yield f"{where}.obstacle", item.obstacle
    yield "steps", scene.steps
    yield "output", scene.output
    yield from ((key, one) for key in OPTIONAL_TABLES if (one := getattr(scene, key)) is not None)


def groups_named(table: object) -> Iterator[tuple[str, str, str]]:
    """Groups that a table names: the key, the name, and of what they are, see `pcontact.scene.keys.Key.group`."""
    if isinstance(table, Equation):
        yield from ((f"terms[{index}]", name, "any") for index, (name, *_) in enumerate(table.terms))
    if isinstance(table, Contact) and table.all:
        return
    for key, declared in keys(type(table)).items():
        kind, name = declared.group, getattr(table, key)
        if kind and name is not None:
            yield key, name, kind(table) if callable(kind) else kind
