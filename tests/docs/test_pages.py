"""The pages: links lead somewhere, keys and options exist, the map has every page, the scene of the README runs."""

import re
import tomllib
from pathlib import Path

import pytest

import drivers
import pcontact as pc
from drivers._common import running
from drivers.gallery import make as gallery
from meshes.__main__ import main as write_mesh
from pcontact.io.names import known
from pcontact.scene.keys import keys
from pcontact.scene.model import (
    HEADERS,
    LIST_TABLES,
    OPTIONAL_TABLES,
    SINGLE_TABLES,
    Contact,
    Material,
    Obstacle,
    Scene,
)
from pcontact.scene.reader import read_scene
from pcontact.scene.target import Budget, Target
from pcontact.usage import COMMANDS, run_options

ROOT = Path(drivers.__path__[0]).parent
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md"), *ROOT.glob("drivers/**/*.md")])
SOURCES = sorted(path for folder in ("pcontact", "drivers", "meshes", "scripts", "tests")
                 for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".sh", ".toml"))  # fmt: skip
LINK = re.compile(r"\]\(([^)\s]+)\)")
DRIVER = re.compile(r"\bdrivers/[\w/]+\.(?:py|toml|md)\b")
MODULE = re.compile(r"\b(?:pcontact|meshes|scripts|tests)/[\w/]+\.(?:py|sh)\b")
# bytes of the first page
SHORT = 8000


def name_of(path):
    return str(path.relative_to(ROOT))


def links(page):
    """Files that a page links to."""
    found = [link.partition("#")[0] for link in LINK.findall(page.read_text())]
    return [(page.parent / link).resolve() for link in found if link and "://" not in link]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files(page):
    assert not [str(path) for path in links(page) if not path.exists()]


def test_drivers_that_are_named_exist():
    named = {name: path for path in [*PAGES, *SOURCES] for name in DRIVER.findall(path.read_text())}
    missing = {name: name_of(path) for name, path in named.items() if not (ROOT / name).exists()}
    # what stands for any of them
    assert set(missing) <= {"drivers/cases/NAME.py"}, missing


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_files_that_pages_name_exist(page):
    assert not [name for name in MODULE.findall(page.read_text()) if not (ROOT / name).exists()]


def test_the_map_has_every_page():
    own = {path.resolve() for path in ROOT.glob("docs/**/*.md")} - {ROOT / "docs" / "index.md"}
    assert own <= set(links(ROOT / "docs" / "index.md"))


def test_the_first_page_is_short():
    assert (ROOT / "README.md").stat().st_size <= SHORT


COUNTS = {"seven": 7, "fifteen": 15, "sixteen": 16, "twenty": 20, "twenty-one": 21, "twenty-two": 22}


@pytest.mark.parametrize("words, files", [
    ("scenes to copy", "drivers/examples/*.toml"), ("tutorials by", "docs/tutorials/*.md"),
    ("short answers", "docs/howto/*.md"), ("pictures, each", "docs/gallery/*.jpg")])  # fmt: skip
def test_what_the_first_page_counts(words, files):
    found = re.findall(rf"([\w-]+) {words}", (ROOT / "README.md").read_text())
    assert [COUNTS[word.lower()] for word in found] == [len(list(ROOT.glob(files)))]


def test_the_scene_of_the_first_page(tmp_path):
    text = (ROOT / "README.md").read_text()
    (tmp_path / "scene.toml").write_text(re.search(r"```toml\n(.*?)```", text, re.DOTALL).group(1))
    words = re.search(r"# python -m meshes (.+) -o blocks\.msh", text).group(1).split()
    assert write_mesh([*words, "-o", str(tmp_path / "blocks.msh")]) == 0
    with running(read_scene(tmp_path / "scene.toml")) as (_, converged):
        assert converged


# ---------------------------------------------------------------- names of keys, options and the API

KINDS = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
CODE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
OPTION = re.compile(r"(?<![\w-])-([a-z]\w*)")
# options of PETSc begin so
PETSC = ("snes_", "ksp_", "pc_", "mat_", "vec_", "mg_levels_", "mg_coarse_", "log_view", "matptap_", "contact_filter_",
         "rigid_bodies_", "petscpartitioner_type", "dm_", "help", "version", "options_", "info")  # fmt: skip
ALL_OPTIONS = {"o", "json", "set", "count", *{option.name for options in run_options().values() for option in options},
               *{name for one in COMMANDS.values() for name in one.options or {}}}  # fmt: skip


SINGLES = {**SINGLE_TABLES, **OPTIONAL_TABLES}


def unknown_keys(data):
    """Keys of a scene, or of a part of one, that no table has."""
    wrong = [name for name in data if name not in {*keys(Scene), *SINGLES, *LIST_TABLES, "materials", "petsc"}]
    tables = [(cls, data[name]) for name, cls in SINGLES.items() if name in data]
    tables += [(cls, one) for name, cls in LIST_TABLES.items() for one in data.get(name, [])]
    tables += [(Material, one) for one in data.get("materials", {}).values()]
    if isinstance(data.get("accuracy"), dict):
        tables += [(Target, data["accuracy"]), (Budget, data["accuracy"].get("budget", {}))]
    tables += [(Obstacle, one["obstacle"]) for _, one in tables if "obstacle" in one]
    others = {Contact: {"obstacle"}, Target: {"budget"}}
    return wrong + [name for cls, one in tables for name in one if name not in {*keys(cls), *others.get(cls, ())}]


def words_of(page):
    """Commands of the blocks and of the text of a page."""
    text = page.read_text()
    commands = [line for kind, block in KINDS.findall(text) if kind in ("sh", "bash")
                for line in block.replace("\\\n", " ").splitlines()]  # fmt: skip
    return commands, CODE.findall(KINDS.sub("", text))


def unknown_options(page):
    """Options of pcontact's commands, and options in the text, that neither the program nor PETSc has."""
    commands, codes = words_of(page)
    wrong = []
    for line in [*commands, *codes]:
        found = re.search(r"(?<!import )\bpcontact ([a-z]+)\b(.*)", line.partition("  #")[0])
        if found and found[1] not in COMMANDS:
            wrong.append(line)
        if not found and (line in commands or not line.startswith("-") or line.startswith("-m ")):
            continue
        own = COMMANDS[found[1]].options if found and found[1] in COMMANDS else None
        known = ALL_OPTIONS if own is None else {*own, "o"}
        rest = re.sub(r"\"[^\"]*\"", "", found[2] if found else line)
        wrong += [f"{line}: {name}" for name in OPTION.findall(rest)
                  if name not in known and not (own is None and name.startswith(PETSC))]  # fmt: skip
    return wrong


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_keys_of_scenes_exist(page):
    scenes = [tomllib.loads(block) for kind, block in KINDS.findall(page.read_text()) if kind == "toml"]
    assert not [(name, list(data)) for data in scenes for name in unknown_keys(data)]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_keys_in_the_text_exist(page):
    """Such as `order = 2`."""
    found = [re.match(r"([a-z_]\w*) = (\[?[\d\"{[]|true|false)", code) for code in words_of(page)[1]]
    everything = {name for cls in HEADERS for name in keys(cls)} | {"obstacle", "budget", *SINGLES, *LIST_TABLES}
    assert not [one.string for one in found if one and not (one[1] in everything or one[1].startswith(PETSC))]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_options_exist(page):
    assert not unknown_options(page)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_fields_exist(page):
    """Those that pages ask pictures for."""
    asked = [name for line in [*words_of(page)[0], *words_of(page)[1]]
             for names in re.findall(r"-field ([\w,]+)", line) for name in names.split(",")]  # fmt: skip
    assert not [name for name in asked if not (known(name) or name == "NAME")]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_python_of_pages(page):
    """It compiles, and what it takes from the package is there."""
    for kind, block in KINDS.findall(page.read_text()):
        if kind == "python":
            compile(block, name_of(page), "exec")
            assert not [name for name in re.findall(r"\bpc\.([A-Za-z]\w*)", block) if name not in pc._HOMES]


def test_a_wrong_name_is_seen(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("Say `-steps_coun 3` or `-snes_rtol 1`.\n\n```sh\npcontact view DIR -feld x\npcontact rum\n```\n")
    assert len(unknown_options(page)) == 3
    scene = "[mesh]\nordre = 2\n[[contacts]]\nobstacle = { radus = 1 }"
    assert unknown_keys(tomllib.loads(scene)) == ["ordre", "radus"]


def test_the_gallery():
    """Twenty pictures that are small, of scenes whose heads have the commands of their meshes."""
    assert gallery.page() == (ROOT / "docs" / "gallery.md").read_text()
    pictures = {one.name: ROOT / "docs" / "gallery" / f"{one.name}.jpg" for one in gallery.PICTURES}
    assert len(pictures) >= 20 and set(pictures.values()) == set((ROOT / "docs" / "gallery").iterdir())
    assert all(path.stat().st_size < gallery.BYTES for path in pictures.values())
