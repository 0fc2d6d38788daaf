"""The pages: links and names of drivers lead somewhere, the map has every page, the scene of the README runs."""

import re
from pathlib import Path

import pytest

import drivers
from drivers._common import running
from meshes.__main__ import main as write_mesh
from pcontact.scene.reader import read_scene

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


def test_the_scene_of_the_first_page(tmp_path):
    text = (ROOT / "README.md").read_text()
    (tmp_path / "scene.toml").write_text(re.search(r"```toml\n(.*?)```", text, re.DOTALL).group(1))
    words = re.search(r"# python -m meshes (.+) -o blocks\.msh", text).group(1).split()
    assert write_mesh([*words, "-o", str(tmp_path / "blocks.msh")]) == 0
    with running(read_scene(tmp_path / "scene.toml")) as (_, converged):
        assert converged
