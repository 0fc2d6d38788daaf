"""PETSc's options for the mesh of a run: views, checks, partitioners."""

import h5py
import pytest

from pcontact.io.report import read_report
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
    """The HDF5 viewer writes it, and another run reads it, with its groups: the same forces."""
    done = execute(folder, ["run", "scene.toml", "-dm_view", "hdf5:mesh.h5", "-o", "out"], ranks=2)
    assert done.returncode == 0, done.stderr
    # for reading by all ranks, and not in its own place
    assert execute(folder, ["convert", "mesh.h5"]).returncode == 2
    assert execute(folder, ["convert", "mesh.h5", "-o", "all.h5"]).returncode == 0
    wanted = read_report(folder / "out")["steps"][-1]["contacts"]["pair"]["force"]
    for name in ("mesh", "all"):
        again = execute(folder, ["run", "scene.toml", "-set", f"mesh.file='{name}.h5'", "-o", name], ranks=2)
        assert again.returncode == 0, again.stderr
        found = read_report(folder / name)["steps"][-1]["contacts"]["pair"]["force"]
        assert found == pytest.approx(wanted, rel=1e-6) and abs(wanted[1]) > 1.0


def test_a_file_of_petsc_that_is_cut_short(folder):
    """One line, status 2."""
    with h5py.File(folder / "mesh.h5", "w") as file:
        file.create_group("topology")
    done = execute(folder, ["run", "scene.toml", "-set", "mesh.file='mesh.h5'", "-o", "out"])
    ours = [line for line in done.stderr.splitlines() if line.startswith("pcontact: error: ")]
    assert done.returncode == 2 and len(ours) == 1 and "mesh.h5" in ours[0], done.stderr


def test_a_partitioner_that_is_not_there(folder):
    """One line, status 2, on all ranks."""
    done = execute(folder, ["run", "scene.toml", "-petscpartitioner_type", "scissors"], ranks=2)
    ours = [line for line in done.stderr.splitlines() if line.startswith("pcontact: error: ")]
    assert done.returncode == 2 and len(ours) == 1, done.stderr
    assert "-petscpartitioner_type scissors" in ours[0]
