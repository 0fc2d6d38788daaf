"""The examples that a newcomer copies run by the commands of their head comments and give the numbers named there."""

import json

import pytest

from drivers._common import running
from pcontact.io.examples import head, lay_out, scenes
from pcontact.scene.reader import read_scene

pytestmark = pytest.mark.slow
def test_there_are_examples():
    """Each with a command for its mesh and one for its run, which name files that are called after it."""
    assert 8 <= len(scenes()) <= 16
    for path in scenes():
        assert head(path).names == (f"{path.stem}.msh", path.name, path.stem, path.stem)


@pytest.mark.parametrize("path", scenes(), ids=lambda path: path.stem)
def test_the_number_of_the_head_comment(tmp_path, path):
    said = head(path)
    with running(read_scene(lay_out(path.stem, tmp_path)), tmp_path / "out") as (_, converged):
        assert converged
    last = json.loads((tmp_path / "out" / "report.json").read_text())["steps"][-1]
    assert said.of(last) == pytest.approx(said.number, rel=said.tolerance)
