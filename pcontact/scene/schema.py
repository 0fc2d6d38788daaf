"""The JSON Schema of a scene file (draft 2020-12), with which editors complete and check it.

It refuses nothing that the program reads; what the values of several keys must be together it says in part only.
"""

from dataclasses import MISSING

from pcontact.runtime.rules import PETSC_VALUE
from pcontact.scene.keys import Key, between, keys
from pcontact.scene.model import (
    HEADERS,
    LIST_TABLES,
    OBSTACLE_KEYS,
    OPTIONAL_TABLES,
    RENAMED,
    SINGLE_TABLES,
    Contact,
    Load,
    Material,
    Obstacle,
    Scene,
)
from pcontact.scene.target import Budget, Target

# what rules between keys do not say: surfaces of a contact, places of a load, shapes of obstacles
MORE = {
    Contact: [{"anyOf": [{"required": [name]} for name in (*names, "all", "surfaces")]}
              for names in (("source",), ("target", "obstacle"))],
    Load: [{"anyOf": [{"required": [name]} for name in ("region", "at")]}],
    Obstacle: [{"if": {"properties": {"shape": {"const": shape}}}, "then": {"required": list(needed)}}
               for shape, (needed, _) in OBSTACLE_KEYS.items()],
}  # fmt: skip


def _value(one: Key) -> dict:
    default = {} if one.default in (None, MISSING) else {"default": one.default}
    return {"description": one.text.replace("`", ""), **one.rule.schema, **default}


def _table(cls: type, **more) -> dict:
    properties = {name: _value(one) for name, one in keys(cls).items()}
    for old, new in ((old, new) for (table, old), new in RENAMED.items() if table is cls):
        properties[old] = {**properties[new], "deprecated": True}
    required = [name for name, one in keys(cls).items() if one.default is MISSING]
    words = {"type": "object", "description": (cls.__doc__ or "").partition("\n")[0]}
    rules = [*MORE.get(cls, []), *between(cls)]
    return {
        **words, "properties": {**properties, **more}, "required": required, "additionalProperties": False,
        **({"allOf": rules} if rules else {}),
    }  # fmt: skip


def schema() -> dict[str, object]:
    """The schema, in the types of JSON."""
    tables = {Contact: {"obstacle": {"$ref": "#/$defs/obstacle"}}}
    lists = {
        name: {"type": "array", "description": f"tables {HEADERS[cls]}", "items": _table(cls, **tables.get(cls, {}))}
        for name, cls in LIST_TABLES.items()
    }
    lists["bodies"]["minItems"] = 1
    petsc = {
        "type": "object", "description": "options of pcontact and PETSc without the dash; the command line wins",
        "propertyNames": {"pattern": r"^-*[^-\s]\S*$"}, "additionalProperties": PETSC_VALUE.schema,
    }  # fmt: skip
    materials = {
        "type": "object", "description": f"tables {HEADERS[Material]}", "additionalProperties": _table(Material),
        "propertyNames": {"pattern": r"\S"},
    }  # fmt: skip
    target = {"anyOf": [keys(Scene)["accuracy"].said.schema, _table(Target, budget=_table(Budget))]}
    accuracy = {**_value(keys(Scene)["accuracy"]), **target}
    single = {name: _table(cls) for name, cls in {**SINGLE_TABLES, **OPTIONAL_TABLES}.items()}
    scene = _table(Scene, accuracy=accuracy, **single, materials=materials, **lists, petsc=petsc)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema", "title": "Scene of pcontact", **scene,
        "required": ["mesh", "materials", "bodies"], "$defs": {"obstacle": _table(Obstacle)},
    }  # fmt: skip
