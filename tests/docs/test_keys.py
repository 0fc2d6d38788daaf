"""Every key of a scene has an example that runs, or a page with it, and a test of bad input."""

import ast
import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

import drivers
from pcontact.runtime.errors import InputError
from pcontact.runtime.rules import apply
from pcontact.scene.keys import keys
from pcontact.scene.model import (
    HEADERS,
    LIST_TABLES,
    OPTIONAL_TABLES,
    SINGLE_TABLES,
    Body,
    Contact,
    Coupling,
    Displacement,
    Dynamics,
    Equation,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Periodic,
    Phase,
    Pretension,
    Region,
    Scene,
    Spring,
    Steps,
    Temperature,
)
from pcontact.scene.target import Budget, Target
from pcontact.scene.validate import validate

ROOT = Path(drivers.__path__[0]).parent
BLOCK = re.compile(r"^```toml\n(.*?)^```", re.DOTALL | re.MULTILINE)
TABLES = {cls.__name__: cls for cls in HEADERS}
EVERY = [(cls, key) for cls in HEADERS for key in keys(cls)]


def texts():
    """Scenes, and parts of scenes, that a reader may copy."""
    for path in sorted((ROOT / "drivers" / "examples").glob("*.toml")):
        yield path.read_text()
    for path in sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]):
        yield from BLOCK.findall(path.read_text())


def tables_in(text):
    """Tables of a scene in TOML: class, and keys with their values."""
    found = tomllib.loads(text)
    top = {name: found[name] for name in found.keys() & keys(Scene).keys()}
    yield Scene, top
    if isinstance(top.get("accuracy"), dict):
        yield Target, {key: one for key, one in top["accuracy"].items() if key != "budget"}
        yield Budget, top["accuracy"].get("budget", {})
    for name, cls in {**SINGLE_TABLES, **OPTIONAL_TABLES}.items():
        yield cls, found.get(name, {})
    yield from ((Material, one) for one in found.get("materials", {}).values())
    for name, cls in LIST_TABLES.items():
        for one in found.get(name, []):
            yield cls, {key: value for key, value in one.items() if key != "obstacle"}
            yield Obstacle, one.get("obstacle", {})


def in_program(path):
    """Tables and keys that a driver makes."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in TABLES:
            cls = TABLES[node.func.id]
            names = [field.name for field in fields(cls) if not field.kw_only]
            said = [*names[: len(node.args)], *(one.arg for one in node.keywords)]
            yield from ((cls, name) for name in said if name in keys(cls))


def test_every_key_has_an_example():
    shown = {(cls, key) for text in texts() for cls, said in tables_in(text) for key in said}
    # a case of the manual is an example, too
    programs = [*(ROOT / "drivers" / "cases").glob("*.py"), ROOT / "drivers" / "studies" / "verification.py"]
    shown |= {pair for path in programs for pair in in_program(path)}
    missing = [f"{HEADERS[cls]}: {key}" for cls, key in EVERY if (cls, key) not in shown]
    assert not missing, "no example in drivers/examples, docs, or the manual: " + ", ".join(missing)


@pytest.mark.parametrize("text", list(texts()))
def test_values_of_the_examples_are_allowed(text):
    """Parts of scenes on pages, too: every key is one, and takes its value."""
    for cls, said in tables_in(text):
        for key, value in said.items():
            if (cls, key) != (Scene, "accuracy"):
                apply(keys(cls)[key].rule, value, "page", key)


def whole(folder):
    """A scene that has every table."""
    (folder / "mesh.msh").write_text("")
    return Scene(
        MeshSpec("mesh.msh"), {"m": Material(1.0, 0.3)}, [Body("lower", "m")],
        contacts=[Contact("top", obstacle=Obstacle("plane", [0, 0], [0, 1]), name="pair")],
        displacements=[Displacement("bottom", [0, 0])], loads=[Load("top", pressure=1.0)],
        steps=Steps(), output=Output(), accuracy=Target(0.02, budget=Budget()), beside=folder,
        springs=[Spring("top", per_area=1.0)], temperatures=[Temperature(1.0)], couplings=[Coupling("side")],
        phases=[Phase("on")], pretensions=[Pretension("cut", force=1.0)], equations=[Equation([("a", "x", 1.0)])],
        periodic=[Periodic("left", "right", [1, 0])], regions=[Region("top")], dynamics=Dynamics(),
    )  # fmt: skip


def table_of(scene, cls):
    """A table of a scene, by its class."""
    every = [scene, scene.mesh, scene.steps, scene.output, scene.dynamics, scene.accuracy, scene.accuracy.budget,
             scene.materials["m"],
             scene.contacts[0].obstacle, *(one for name in LIST_TABLES for one in getattr(scene, name))]  # fmt: skip
    return next(one for one in every if type(one) is cls)


@pytest.mark.parametrize("cls, key", EVERY, ids=lambda one: one if isinstance(one, str) else one.__name__)
def test_no_key_takes_anything(tmp_path, cls, key):
    """One line that names the key, what was found, and what is allowed."""
    scene = whole(tmp_path)
    table = table_of(scene, cls)
    for value in (object(), {"no": "value"}, float("nan")):
        setattr(table, key, value)
        with pytest.raises(InputError, match=rf"(^|[. ]){key}.*: found .*; allowed: ."):
            validate(scene)
