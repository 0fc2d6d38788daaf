"""The wheel has all that a run needs, and packages agree with pyproject.toml."""

import re
import subprocess
import sys
import tomllib
import zipfile

import pytest

from pcontact.view import extra
from tests.support.commands import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.mark.slow
def test_the_wheel(tmp_path):
    pip = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation"]
    done = subprocess.run([*pip, "-w", str(tmp_path), "."], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "pcontact").rglob("*.py")}
    assert modules | {"pcontact/py.typed", "pcontact/__init__.pyi"} <= names
    assert not [name for name in names if name.startswith(("tests/", "drivers/"))]


def test_one_version_everywhere():
    version = PROJECT["version"]
    for name in ("CITATION.cff", "packaging/conda/recipe.yaml", "CHANGELOG.md", "pcontact/__init__.py"):
        assert re.search(rf"\b{re.escape(version)}\b", (ROOT / name).read_text()), name


def test_what_view_installs_is_the_extra():
    extras = PROJECT["optional-dependencies"]
    assert list(extra.PACKAGES) == extras["view"] and {"mesh", "docs", "dev"} <= set(extras)


def test_recipes_have_all_dependencies():
    recipe = (ROOT / "packaging/conda/recipe.yaml").read_text()
    spack = (ROOT / "packaging/spack/package.py").read_text()
    for name in PROJECT["dependencies"]:
        assert name in recipe and name in spack, name
