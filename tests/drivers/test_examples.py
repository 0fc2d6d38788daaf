"""The examples that a newcomer copies run by the commands of their head comments and give the numbers named there."""

import json
import re
import shlex
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

import drivers
from drivers._common import running
from meshes.__main__ import main as write_mesh
from pcontact.scene.reader import read_scene

pytestmark = pytest.mark.slow
FOLDER = Path(drivers.__path__[0]) / "examples"
SCENES = sorted(FOLDER.glob("*.toml"))
MESH = re.compile(r"^#     python -m meshes (.+) -o drivers/examples/(\S+)$", re.MULTILINE)
RUN = re.compile(r"^#     scripts/pcontact\.sh run drivers/examples/(\S+) -o results/(\S+)$", re.MULTILINE)
NUMBER = re.compile(r"^# The last load step in results/(\S+)/report\.json has, within (\S+) %.*\n"
                    r"#     (\S+) = (\S+)$", re.MULTILINE)  # fmt: skip


class Head(NamedTuple):
    """What the head comment of an example says."""

    words: list[str]  # of the mesh generator
    mesh: str
    where: list[str | int]  # of the number, in a load step of the report
    number: float
    tolerance: float  # relative


def head_of(path):
    """Read the head comment; its file names have to be those of the example."""
    text = path.read_text()
    words, mesh = MESH.search(text).groups()
    report, percent, where, number = NUMBER.search(text).groups()
    assert (mesh, *RUN.search(text).groups(), report) == (f"{path.stem}.msh", path.name, path.stem, path.stem)
    keys = [int(key) if key.isdigit() else key for key in re.split(r"\.|\[", where.replace("]", ""))]
    return Head(shlex.split(words), mesh, keys, float(number), 1e-2 * float(percent))


def test_there_are_examples():
    assert 8 <= len(SCENES) <= 16


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_the_number_of_the_head_comment(tmp_path, path):
    head = head_of(path)
    assert write_mesh([*head.words, "-o", str(tmp_path / head.mesh)]) == 0
    scene = read_scene(shutil.copy(path, tmp_path))
    with running(scene, tmp_path / "out") as (_, converged):
        assert converged
    value = json.loads((tmp_path / "out" / "report.json").read_text())["steps"][-1]
    for key in head.where:
        value = value[key]
    assert value == pytest.approx(head.number, rel=head.tolerance)
