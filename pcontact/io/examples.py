"""The small scenes of ``drivers/examples``, which lie in the repository beside the program, and their heads."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from pcontact.io.template import write_template
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import make_directory
from pcontact.runtime.process import environment_outside

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "drivers" / "examples"
_MESH = re.compile(r"^#     python -m meshes (.+) -o drivers/examples/(\S+)$", re.MULTILINE)
_RUN = re.compile(r"^#     scripts/pcontact\.sh run drivers/examples/(\S+) -o results/(\S+)$", re.MULTILINE)
_NUMBER = re.compile(r"^# The last load step in results/(\S+)/report\.json has, within (\S+) %.*\n"
                     r"#     (\S+) = (\S+)$", re.MULTILINE)  # fmt: skip


class Head(NamedTuple):
    """What the head comment of an example says.

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
