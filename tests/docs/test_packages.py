"""The wheel has all that a run needs, and packages agree with pyproject.toml."""

import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

from pcontact.view import extra
from tests.support.commands import ROOT, environment

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
    assert modules | {"pcontact/py.typed", "pcontact/__init__.pyi", "pcontact/io/new.toml",
                      "pcontact/view/page.html"} <= names  # fmt: skip
    assert not [name for name in names if name.startswith(("tests/", "drivers/", "meshes/"))]
    assert {"pcontact/examples/press.toml", "pcontact/examples/meshes/__main__.py"} <= names
    installed(wheel, tmp_path)


def installed(wheel, folder):
    """The wheel runs from a fresh venv, beside the petsc4py that is there."""
    venv.create(folder / "fresh", system_site_packages=True)
    python = folder / "fresh" / "bin" / "python"
    # what pip would download is taken from the environment of the tests
    (site,) = (folder / "fresh").glob("lib/python3*/site-packages")
    (site / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    paths = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if Path(path).resolve() != ROOT]
    alone = {**environment(), "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "-q", "--no-deps", "--no-index"]
    asked = "import pcontact as pc; assert pc.new().steps.count == 8; print(pc.__file__)"
    for command in ([*pip, "--ignore-installed", str(wheel)], [str(python), "-c", asked],
                    [str(python.with_name("pcontact")), "--help"],
                    [str(python.with_name("pcontact")), "new", "first", "-example", "press"]):  # fmt: skip
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=alone)
        assert done.returncode == 0, done.stderr
        assert command[-1] != asked or done.stdout.startswith(str(site))
    assert (folder / "first/press.toml").exists() and (folder / "first/meshes/hertz.py").exists()


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
    for name in PROJECT["dependencies"] + PROJECT["optional-dependencies"]["mesh"]:
        assert name in recipe and name in spack, name


def test_what_draws_and_makes_meshes_are_extras():
    """As the pages say: a run needs neither."""
    extras = PROJECT["optional-dependencies"]
    assert not {"gmsh", "meshio", "matplotlib"} & set(PROJECT["dependencies"])
    assert {"gmsh", "meshio"} <= set(extras["mesh"]) and "matplotlib" in extras["view"]
