"""PETSc's options for the mesh of a run: views, checks, partitioners."""

import pytest

from tests.support.bad_input import SCENE, mesh_text
from tests.support.commands import execute


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "mesh.msh").write_text(mesh_text())
    return tmp_path


def test_views_checks_and_partitioners(folder):
    """They act, and none is told to be unknown; the text names cells, vertices and groups."""
    words = ["-dm_view", "-dm_plex_check_all", "-petscpartitioner_type", "simple", "-o", "out"]
    done = execute(folder, ["run", "scene.toml", *words], ranks=2)
    assert done.returncode == 0, done.stderr
    said = done.stdout + done.stderr
    for line in ("DM Object: mesh 2 MPI processes", "Number of 0-cells per rank: 4 4", "upper_bottom"):
        assert line in said
    assert "petscpartitioner_type" not in said and "dm_plex_check_all" not in said


def test_the_mesh_in_a_file_of_petsc(folder):
    """The HDF5 viewer writes it."""
    done = execute(folder, ["run", "scene.toml", "-dm_view", "hdf5:mesh.h5", "-o", "out"])
    assert done.returncode == 0, done.stderr
    assert (folder / "mesh.h5").stat().st_size > 1000


def test_a_partitioner_that_is_not_there(folder):
    """One line, status 2, on all ranks."""
    done = execute(folder, ["run", "scene.toml", "-petscpartitioner_type", "scissors"], ranks=2)
    ours = [line for line in done.stderr.splitlines() if line.startswith("pcontact: error: ")]
    assert done.returncode == 2 and len(ours) == 1, done.stderr
    assert "-petscpartitioner_type scissors" in ours[0]
