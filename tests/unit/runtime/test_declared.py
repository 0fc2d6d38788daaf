"""What follows from the declarations of keys and options: defaults, help, pages, schema; old names."""

import importlib.util
import json
import re
import tomllib
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

import drivers
from pcontact import __version__
from pcontact.runtime import declared, log, options
from pcontact.runtime.declared import OPTIONS, Option, read_all
from pcontact.runtime.errors import InputError
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import PETSc, own_options
from pcontact.runtime.rules import POSITIVE, choice
from pcontact.scene.keys import keys
from pcontact.scene.model import HEADERS, RENAMED, Body, Contact, Material, Obstacle, Pretension, Scene, Steps
from pcontact.scene.reader import read_scene, scene_from
from pcontact.scene.schema import schema
from pcontact.scene.target import Budget, Target
from pcontact.usage import COMMANDS, answer, parse, run_options, usage
from tests.support.bad_input import CASES
from tests.support.bad_input import SCENE as SQUARES
from tests.support.scenes import FULL, LEVEL_SET, PLAIN, value_cases

ROOT = Path(drivers.__path__[0]).parent
TABLES = list(HEADERS)


# ---------------------------------------------------------------- declarations


@pytest.mark.parametrize("cls", TABLES)
def test_every_key_is_declared(cls):
    """Every field of a table but tables and places, with a help; its default is allowed."""
    others = {field.name for field in fields(cls) if field.name not in keys(cls)}
    tables = {"mesh", "materials", "bodies", "contacts", "displacements", "loads", "couplings", "springs",
              "temperatures", "phases", "regions", "pretensions", "equations", "periodic", "dynamics",
              "steps", "output", "petsc"}  # fmt: skip
    known = {Scene: tables | {"path", "beside"}, Contact: {"obstacle", "held"}, Pretension: {"locked"},
             Body: {"absent", "since"}, Target: {"budget"}}  # fmt: skip
    assert others == known.get(cls, set())
    for name, one in keys(cls).items():
        assert one.help and one.rule.allowed
        if one.default is not MISSING:
            assert one.rule.accept(one.default) == one.default, name


def test_defaults_of_options_are_allowed():
    for option in OPTIONS.values():
        if option.default is not None:
            assert option.rule.accept(option.default) == option.default
            assert option.read(declared.shown(option.default)) == option.default


@pytest.mark.parametrize(
    ("option", "text", "value"),
    [
        (OPTIONS["no_code"], "", True), (OPTIONS["no_code"], "OFF", False), (OPTIONS["pc_direct_below"], "7", 7),
        (OPTIONS["pc_contact_filter"], "", "true"), (OPTIONS["contact_uzawa_rtol"], "1e-3", 1e-3),
    ],
)  # fmt: skip
def test_options_read(option, text, value):
    assert option.read(text) == value and type(option.read(text)) is type(value)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("no_code", "maybe", "command line: -no_code: found 'maybe'; allowed: true | false"),
        ("pc_direct_below", "1.5", "command line: -pc_direct_below: found '1.5'; allowed: an integer >= 0"),
        ("pc_contact_filter", "on", "command line: -pc_contact_filter: found 'on'; allowed: auto | true | false"),
        ("contact_uzawa_rtol", "nan", "command line: -contact_uzawa_rtol: found 'nan'; allowed: a number > 0"),
        ("contact_uzawa_rtol", "", "command line: -contact_uzawa_rtol: found nothing; allowed: a number > 0"),
    ],
)
def test_options_refuse(name, text, message):
    with pytest.raises(InputError) as caught:
        OPTIONS[name].read(text)
    assert str(caught.value) == message


def test_a_command_that_knows_its_options():
    known = COMMANDS["view"].options
    assert read_all("view", known, {"step": "2", "size": "300x200"}) == {"step": 2, "size": (300, 200)}
    with pytest.raises(InputError, match="-stp: no such option of pcontact view; .*; the nearest is -step"):
        read_all("view", known, {"stp": "2"})
    with pytest.raises(InputError, match="-size: found '300'; allowed: WIDTHxHEIGHT"):
        read_all("view", known, {"size": "300"})


# ---------------------------------------------------------------- help and pages


def test_help_has_all_options():
    words = usage()
    for option in [*OPTIONS.values(), *(one for cls in TABLES for one in keys(cls).values() if one.option)]:
        name = option.option if hasattr(option, "option") else option.name
        assert re.search(rf"^  -{name} ", words, re.MULTILINE), name
    assert sorted(o.name for group in run_options().values() for o in group) == sorted(
        {*OPTIONS, *(one.option for cls in TABLES for one in keys(cls).values() if one.option)}
    )
    assert max(map(len, words.splitlines())) <= 120
    for command in COMMANDS:
        assert parse([command, "--help"]) == ("help", command, {})
        assert f"pcontact {command}" in usage(command)
    assert "-restart_anyway" in usage("run") and "-restart_anyway" not in usage("view")
    assert "force:CONTACT" in words and "locking" in words and "a string" not in words
    assert parse(["help", "view"]) == ("help", "view", {}) and "Options of doctor" not in words
    assert answer(*parse(["--version"])[:2]) == f"pcontact {__version__}" and answer("run") is None


@pytest.mark.parametrize(("word", "allowed"), [("--error", "-error"), ("-error=5%", "-error 5%")])
def test_words_that_petsc_takes_for_others(word, allowed):
    with pytest.raises(InputError, match=f"command line: found '{word}'; allowed: {allowed}$"):
        parse(["run", "scene.toml", word])
    assert parse(["run", "scene.toml", "--json", "--snes_monitor"]) == (
        "run", "scene.toml", {"json": "", "snes_monitor": ""}
    )  # fmt: skip


def test_pages_are_up_to_date(capsys):
    """Otherwise: python scripts/reference.py."""
    spec = importlib.util.spec_from_file_location("reference", ROOT / "scripts" / "reference.py")
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    assert reference.main(["--check"]) == 0, capsys.readouterr().out
    pages = "".join(page.read_text() for page in ROOT.glob("docs/**/*.md"))
    missing = [name for name in reference.tables() if f"<!-- table: {name} -->" not in pages]
    assert not missing


# ---------------------------------------------------------------- the schema


@pytest.fixture(scope="module")
def validator():
    jsonschema = pytest.importorskip("jsonschema")
    plain = json.loads(json.dumps(schema()))
    jsonschema.Draft202012Validator.check_schema(plain)
    return jsonschema.Draft202012Validator(plain)


def tables_of(value):
    """A scene of Python as the tables of a file: what is not said is left out."""
    if is_dataclass(value):
        named = {one.name: getattr(value, one.name) for one in fields(value) if one.name not in ("path", "beside")}
        default = {one.name: one.default for one in fields(value)}
        return {name: tables_of(one) for name, one in named.items() if one is not None and one != default[name]}
    if isinstance(value, dict):
        return {name: tables_of(one) for name, one in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [tables_of(one) for one in (value.tolist() if isinstance(value, np.ndarray) else value)]
    return str(value) if isinstance(value, Path) else value


def texts():
    """Scenes in files, pages and tests."""
    found = {str(path.relative_to(ROOT)): path.read_text() for path in ROOT.glob("drivers/**/*.toml")}
    for page in [ROOT / "README.md", *ROOT.glob("docs/*.md")]:
        for number, text in enumerate(re.findall(r"```toml\n(.*?)```", page.read_text(), re.DOTALL)):
            if "[mesh]" in text:
                found[f"{page.name} {number}"] = text
    return {**found, "full": FULL, "plain": PLAIN, "squares": SQUARES, "level set": LEVEL_SET % "hill.py:phi"}


def test_scenes_of_files_and_pages(validator):
    assert len(texts()) >= 14
    for name, text in texts().items():
        errors = [error.message for error in validator.iter_errors(tomllib.loads(text))]
        assert not errors, (name, errors)


def test_schema_lists_every_key():
    """No other keys, and a description, range and default of every one."""
    found = schema()
    target = found["properties"]["accuracy"]["anyOf"][1]
    tables = {cls: header.strip("[]") for cls, header in HEADERS.items() if cls not in (Target, Budget)}
    homes = {
        Scene: found, Material: found["properties"]["materials"]["additionalProperties"],
        Obstacle: found["$defs"]["obstacle"], Target: target, Budget: target["properties"]["budget"],
        **{cls: found["properties"][name].get("items", found["properties"][name])
           for cls, name in tables.items() if name in found["properties"]},
    }  # fmt: skip
    assert set(homes) == set(TABLES)
    for cls, home in homes.items():
        assert home["additionalProperties"] is False
        for name, one in keys(cls).items():
            words = home["properties"][name]
            assert words["description"] and ("type" in words or "anyOf" in words)
            assert one.unit in words["description"]
    assert homes[Material]["properties"]["yield_stress"]["exclusiveMinimum"] == 0
    assert homes[Contact]["properties"]["formulation"]["default"] == "nitsche"
    assert homes[Material]["required"] == ["E", "nu"]


def places(table, where=()):
    """Paths of all values of a scene."""
    for key, value in table.items() if isinstance(table, dict) else enumerate(table):
        yield (*where, key)
        if isinstance(value, (dict, list)):
            yield from places(value, (*where, key))


def put(table, path, value):
    """A copy with another value at a path."""
    copy = json.loads(json.dumps(table))
    inner = copy
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return copy


VALUES = (0, 1, -1, 2, 0.4, 3.5, -2.5, 10**7, "", " ", "x", "nitsche", "a.py:b", "x - t", "free", True, False, [], [1],
          [0, 1], [0, 0, 0], [0, 1, 2, 3], [[0, 1], [1, 2]], [[0, 1], [0]], ["a"], [""], {}, {"a": 1})  # fmt: skip


@pytest.mark.slow
def test_what_the_schema_refuses_the_program_refuses(validator, tmp_path):
    """Any value in the place of any other one; and of what the program refuses for one value, the schema sees most."""
    (tmp_path / "ball_on_block.msh").write_text("")
    (tmp_path / "hill.py").write_text("")
    refused = seen = 0
    for text in (FULL, LEVEL_SET % "hill.py:phi", PLAIN + "[steps]\n[output]\nsmooth = true\n"):
        scene = tomllib.loads(text)
        for path in places(scene):
            for value in VALUES:
                changed = put(scene, path, value)
                valid = validator.is_valid(changed)
                try:
                    scene_from(changed, tmp_path)
                except InputError:
                    refused, seen = refused + 1, seen + (not valid)
                else:
                    assert valid, (path, value)
    assert refused > 2000 and seen > 0.85 * refused, (refused, seen)


def test_bad_scenes(validator):
    """What the other tests have the program refuse: the schema sees those that lie in one value or key."""
    texts = [FULL.replace(old, new, 1) for old, new, *_ in (case.values for case in value_cases())]
    texts += [case.scene for case in CASES.values() if case.scene not in (None, SQUARES)]
    seen = 0
    for text in texts:
        try:
            seen += not validator.is_valid(tomllib.loads(text))
        except tomllib.TOMLDecodeError:
            continue
    assert seen >= 70, (seen, len(texts))


def test_scenes_at_random(validator, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tests" / "fuzz")
    scenes = importlib.import_module("scenes")
    for seed in range(40):
        scene = tomllib.loads(scenes.texts(scenes.scene_of(seed))["scene.toml"])
        assert not [error.message for error in validator.iter_errors(scene)]


def test_scenes_of_python(validator, tmp_path):
    (tmp_path / "ball_on_block.msh").write_text("")
    (tmp_path / "scene.toml").write_text(FULL)
    again = tables_of(read_scene(tmp_path / "scene.toml"))
    assert not [error.message for error in validator.iter_errors(again)]
    assert again["steps"] == {"end": 2.0, "count": 5, "min_step": 1e-4}


# ---------------------------------------------------------------- old names


@pytest.fixture
def renamed(monkeypatch):
    monkeypatch.setitem(RENAMED, (Contact, "mu"), "friction")
    monkeypatch.setitem(RENAMED, (Obstacle, "size"), "radius")
    monkeypatch.setitem(RENAMED, (Scene, "name"), "title")
    log.forget_warnings()
    yield
    log.forget_warnings()


def test_keys_under_their_old_names(renamed, tmp_path):
    (tmp_path / "ball_on_block.msh").write_text("")
    text = FULL.replace("friction =", "mu =").replace("title =", "name =").replace("radius = 2\nins", "size = 2\nins")
    path = tmp_path / "scene.toml"
    path.write_text(text)
    scene = read_scene(path)
    assert scene.contacts[0].friction == 0.3 and scene.title == "Half ball on a block"
    assert scene.contacts[2].obstacle.radius == 2.0
    read_scene(path)
    said = log.warnings()
    assert len(said) == 3 and said[0].endswith(": the key name of the scene is now called title; the old name will go")
    path.write_text(text.replace("mu = 0.3", "mu = 0.3\nfriction = 0.2"))
    with pytest.raises(InputError, match=r"\(ball-block\)\.mu: .*friction"):
        read_scene(path)
    assert schema()["properties"]["contacts"]["items"]["properties"]["mu"]["deprecated"] is True


def test_options_under_their_old_names(monkeypatch):
    option = Option("better", POSITIVE, "an option", 1.0)
    monkeypatch.setitem(options.OPTIONS, "better", option)
    monkeypatch.setitem(options.RENAMED, "worse", "better")
    log.forget_warnings()
    with own_options():
        database = PETSc.Options()
        assert Options().get("better") == 1.0 and not log.warnings()
        # the scene under an old name, against the command line under either
        database.setValue("worse", 2)
        ours = Options()
        assert ours.propose({"better": 5}) == ({}, {"better": "2"}) and ours.propose({"worse": 5})[1] == {"better": "2"}
        assert ours.get("better") == 2.0 and ours.get("better") == 2.0 and ours.given("better")
        assert len(log.warnings()) == 1 and re.search("-worse .*-better", log.warnings()[0])
        assert "worse" not in ours.unused()
        database.setValue("better", 3)
        assert Options().get("better") == 3.0
        database.delValue("better")
        database.delValue("worse")
        ours = Options()
        assert ours.propose({"worse": 5}) == ({"better": 5}, {}) and ours.get("better") == 5.0
    log.forget_warnings()


def test_an_option_that_is_not_declared():
    with pytest.raises(KeyError):
        Options().get("contact_tehta")


def test_choice_and_steps_in_docstrings():
    """The docstring of a table has its keys."""
    assert "count : an integer from 1 to 1000000" in Steps.__doc__ and "[time]" in Steps.__doc__
    assert choice("a", "b").schema == {"type": "string", "enum": ["a", "b"]}
