"""Scene files."""

import pytest

from pcontact.scene.reader import read_scene
from tests.support.scenes import FULL


@pytest.fixture
def write(tmp_path):
    """Write a scene file beside an (unread) mesh file, and return its path."""
    (tmp_path / "ball_on_block.msh").write_text("")

    def _write(text):
        path = tmp_path / "scene.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return _write


@pytest.fixture
def full(write):
    return read_scene(write(FULL))
