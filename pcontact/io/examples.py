"""``pcontact new``: a commented scene with its mesh, or an example with what makes its mesh. The small scenes of
``drivers/examples``, which lie in the repository beside the program, and their heads.
"""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcontact.mesh.msh import write_msh
from pcontact.runtime.errors import InputError, nearby
from pcontact.runtime.files import make_directory, replace_file
from pcontact.runtime.process import environment_outside

_HEAD = """\
# The commands below are typed in this directory; the one that makes the mesh needs gmsh (pip install gmsh).
#
"""
ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "drivers" / "examples"
_MESH = re.compile(r"^#     python -m meshes (.+) -o drivers/examples/(\S+)$", re.MULTILINE)
_RUN = re.compile(r"^#     scripts/pcontact\.sh run drivers/examples/(\S+) -o results/(\S+)$", re.MULTILINE)
_NUMBER = re.compile(r"^# The last load step in results/(\S+)/report\.json has, within (\S+) %.*\n"
                     r"#     (\S+) = (\S+)$", re.MULTILINE)  # fmt: skip


def write_template(name):
    """Write a scene and its mesh into a new directory. Serial.

    Parameters
    ----------
    name : str
        The directory, which must not be there, or be empty.

    Returns
    -------
    Path
        The scene.

    Raises
    ------
    InputError
        There is something already.
    OutputError
        It cannot be written.
    """
    folder = _made(name)
    _write_mesh(folder / "blocks.msh")
    text = Path(__file__).with_name("new.toml").read_text(encoding="utf-8")
    replace_file(folder / "scene.toml", text.format(name=name))
    return folder / "scene.toml"


def write_example(name, example):
    """Write one of the examples into a new directory, with the package that makes its mesh. Serial.

    Parameters
    ----------
    name : str
        As of :func:`write_template`.
    example : str
        Its name, without ``.toml``.

    Returns
    -------
    Path
        The scene; the commands in its head comment are those to type in the directory.

    Raises
    ------
    InputError
        There is no such example, or something in the directory already.
    OutputError
        It cannot be written.
    """
    scenes, meshes = _examples()
    names = sorted(path.stem for path in scenes.glob("*.toml"))
    if example not in names:
        allowed = f"{', '.join(names)}{nearby(example, names)}"
        raise InputError(f"command line: -example: found {example!r}; allowed: {allowed}")
    folder = _made(name)
    make_directory(folder / "meshes")
    for path in sorted(meshes.glob("*.py")):
        replace_file(folder / "meshes" / path.name, path.read_text(encoding="utf-8"))
    text = (scenes / f"{example}.toml").read_text(encoding="utf-8")
    for there, here in (("drivers/examples/", ""), ("scripts/pcontact.sh ", "pcontact "),
                        (f"results/{example}", "results")):  # fmt: skip
        text = text.replace(there, here)
    replace_file(folder / f"{example}.toml", _HEAD + text)
    return folder / f"{example}.toml"


def _examples():
    """Return the folder of examples, and the package that makes their meshes: in the wheel, or in the repository."""
    package = Path(__file__).resolve().parents[1]
    if (package / "examples").is_dir():
        return package / "examples", package / "examples" / "meshes"
    return package.parent / "drivers" / "examples", package.parent / "meshes"


def _made(name):
    """A new directory."""
    folder = Path(name)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"command line: pcontact new: found {name}, which is there already; allowed: a new directory")
    make_directory(folder)
    return folder


def _write_mesh(path):
    """Write two blocks of quadrilaterals whose meshes do not match, with their groups."""
    names = {"lower": 2, "upper": 2, "lower_bottom": 1, "lower_top": 1, "upper_bottom": 1, "upper_top": 1}
    numbers = {name: k + 1 for k, name in enumerate(names)}
    points, rows = [], []
    for body, (nx, ny), (x0, y0), (width, height) in (("lower", (24, 8), (0.0, 0.0), (3.0, 1.0)),
                                                      ("upper", (14, 7), (0.75, 1.0), (1.4, 0.7))):  # fmt: skip
        first = len(points) + 1
        points += [(x, y) for y in np.linspace(y0, y0 + height, ny + 1) for x in np.linspace(x0, x0 + width, nx + 1)]
        row = first + np.arange(nx + 1)
        top = row + ny * (nx + 1)
        rows += [("quad", body, (k, k + 1, k + nx + 2, k + nx + 1)) for j in range(ny) for k in row[:-1] + j * (nx + 1)]
        for side, line in (("bottom", row), ("top", top)):
            rows += [("line", f"{body}_{side}", pair) for pair in zip(line[:-1], line[1:], strict=True)]
    elements = [(k, kind, numbers[name], nodes) for k, (kind, name, nodes) in enumerate(rows, 1)]
    write_msh(path, enumerate(points, 1), elements, [(dim, numbers[name], name) for name, dim in names.items()])


class Head(NamedTuple):
    """Contents of the head comment of an example.

    Attributes
    ----------
    words : list of str
        Of the mesh generator.
    names : tuple of str
        Mesh, scene, results and results again, as its commands name them.
    key : str
        Of a number in a load step of the report.
    number, tolerance : float
        The value to expect, and how far from it one may be, relative.
    """

    words: list[str]
    names: tuple[str, str, str, str]
    key: str
    number: float
    tolerance: float

    def of(self, step):
        """The number in a load step of a report."""
        for word in re.split(r"\.|\[", self.key.replace("]", "")):
            step = step[int(word) if word.isdigit() else word]
        return step


def head(path):
    """Read the head comment of an example.

    Parameters
    ----------
    path : pathlib.Path
        The scene.
    """
    text = path.read_text(encoding="utf-8")
    (words, mesh), (report, percent, key, number) = _MESH.search(text).groups(), _NUMBER.search(text).groups()
    return Head(shlex.split(words), (mesh, *_RUN.search(text).groups(), report), key, float(number),
                1e-2 * float(percent))  # fmt: skip


def scenes():
    """Paths of all examples.

    Returns
    -------
    list of pathlib.Path
        Empty in an installation without the repository.
    """
    return sorted(FOLDER.glob("*.toml"))


def lay_out(name, folder):
    """Put a scene with its mesh into a folder; what is there already stays as it is. Serial.

    Parameters
    ----------
    name : str
        Of an example; in an installation without examples it is the scene of ``pcontact new``.
    folder : pathlib.Path

    Returns
    -------
    pathlib.Path
        The scene.

    Raises
    ------
    InputError
        The mesh cannot be made.
    OutputError
        The folder cannot be written.
    """
    if not scenes():
        path = folder / name / "scene.toml"
        return path if path.exists() else write_template(folder / name)
    make_directory(folder)
    path, mesh = folder / f"{name}.toml", folder / f"{name}.msh"
    if not path.exists():
        shutil.copyfile(FOLDER / path.name, path)
    if not mesh.exists():
        command = [sys.executable, "-m", "meshes", *head(path).words, "-o", str(mesh.resolve())]
        done = subprocess.run(command, cwd=ROOT, env=environment_outside(), capture_output=True, text=True)
        if done.returncode:
            said = (done.stderr.strip().splitlines() or ["nothing"])[-1]
            raise InputError(f"{mesh}: found no mesh, and its generator says: {said}; allowed: {' '.join(command[1:])}")
    return path
