"""When writing fails: one line, exit status 3, the same on every rank, and nothing lost that was written before."""

import re
import sys
from contextlib import nullcontext

import h5py
import numpy as np
import pytest

from pcontact.cli import guarded
from pcontact.io.fields import FieldWriter, Piece
from pcontact.io.result import load_result
from pcontact.mesh.hdf5 import convert
from pcontact.mesh.read import read_mesh
from pcontact.mesh.refinement.gather import halved_where
from pcontact.mesh.remesh import write_refined, write_sizes
from pcontact.runtime import log
from pcontact.runtime.errors import InputError, OutputError
from pcontact.runtime.files import Hdf5Aside, append_text, replace_file, written_aside
from pcontact.runtime.parallel import agree, on_root, together
from pcontact.runtime.petsc import MPI
from pcontact.view.show import show
from tests.support.bad_input import SCENE, Case
from tests.support.commands import check_whole, launch, lay_out
from tests.support.disk import full
from tests.support.small import block_file

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel


@pytest.fixture(autouse=True)
def log_afterwards():
    """Whatever a test does to the log, or to the stream that it goes to."""
    yield
    log.setup(WORLD.rank)
    log.forget_warnings()


def stops(error):
    """Raise an error, if there is one."""
    if error is not None:
        raise error


@parallel
def test_every_rank_learns_of_an_error_of_output(capfd):
    """Whichever rank fails; the error keeps its kind, and ends the program with status 3."""
    failing = WORLD.size - 1
    mine = OutputError("x: full") if WORLD.rank == failing else None
    for call in (lambda: together(WORLD, stops, mine), lambda: agree(WORLD, mine)):
        with pytest.raises(OutputError, match="x: full"):
            call()
        assert guarded(call) == 3
    with pytest.raises(OutputError, match="x: full"):
        on_root(WORLD, stops, OutputError("x: full"))
    with pytest.raises(InputError, match="wrong"):
        agree(WORLD, "wrong" if WORLD.rank == failing else None)
    lines = capfd.readouterr().err.splitlines()
    assert lines == (["pcontact: error: x: full"] * 2 if WORLD.rank == 0 else [])


def test_the_end_of_memory_is_one_line(capfd):
    """On one rank; on several the one that has none left stops all."""

    def most():
        return np.empty(1 << 55)

    assert guarded(most) == 1
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("pcontact: error: out of memory: Unable to allocate") and "remedy" in line


# -- a disk that is full ----------------------------------------


def test_files_are_whole_or_not_there(tmp_path):
    """What cannot be written leaves the file of before and nothing aside."""
    path = tmp_path / "a.txt"
    replace_file(path, "before\n")
    append_text(path, "more\n")
    append_text(path, "and ", "more\n")
    with full(1000):
        for change in (replace_file, append_text, lambda path, text: append_text(path, text, "more\n")):
            with pytest.raises(OutputError, match=r"a\.txt: cannot be written \(file too large\)"):
                change(path, "x" * 2000)
        with pytest.raises(OutputError, match=r"no/b: cannot be written \(no such file or directory\)"):
            replace_file(tmp_path / "no" / "b", "")
        with pytest.raises(OutputError, match="file too large"), written_aside(path) as part, open(part, "w") as stream:
            stream.write("x" * 2000)
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"] and path.read_text() == "before\nand more\n"
    with pytest.raises(OutputError):
        append_text(tmp_path / "vanished", "a row without a head")


def fill(aside, seed, rows=500):
    """Groups, attributes, and datasets in parts."""
    values = np.random.default_rng(seed).normal(size=(rows, 3))
    for k in range(4):
        group = aside.file.create_group(f"group {k}")
        group.attrs["number"] = k
        table = group.create_dataset("table", values.shape, values.dtype)
        table[: rows // 2], table[rows // 2 :] = values[: rows // 2], values[rows // 2 :]
    return values


@pytest.mark.parametrize("size", [0, 100, 3000, 20000, 45000])
def test_hdf5_on_a_full_disk(tmp_path, size):
    """HDF5 crashes at the end of the process if it cannot close a file; here it always can."""
    path = tmp_path / "a.h5"
    aside = Hdf5Aside(path)
    before = fill(aside, 1, 100)
    aside.place()
    with full(size):
        aside = Hdf5Aside(path)
        fill(aside, 2)
        assert aside.failed
        with pytest.raises(OutputError, match=r"a\.h5: cannot be written \(file too large\)"):
            aside.place()
    assert not aside.file and [p.name for p in tmp_path.iterdir()] == ["a.h5"]
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["group 3/table"][:], before)
        assert file["group 2"].attrs["number"] == 2


@parallel
@pytest.mark.parametrize("failing", [0, -1])
def test_every_rank_learns_of_a_full_disk(shared_tmp, failing):
    """Only one of them cannot write; the fields of the step before stay as they are."""
    piece = Piece(np.eye(3)[:, :2] + WORLD.rank, [("triangle", [[0, 1, 2]])], {"u": np.ones((3, 2))})
    writer = FieldWriter(shared_tmp, WORLD)
    writer.write(1, 0.5, piece)
    with full(100) if WORLD.rank == failing % WORLD.size else nullcontext():
        with pytest.raises(OutputError, match=rf"bodies_000002_000{failing % WORLD.size}.*file too large"):
            writer.write(2, 1.0, piece)
        WORLD.Barrier()
    assert load_result(shared_tmp).times == [0.5] and not list(shared_tmp.rglob("*.part"))


@pytest.mark.parametrize("name", ["mesh.h5", "picture.png", "mesh.msh", "sizes.pos"])
def test_other_files_on_a_full_disk(tmp_path, name):
    """Meshes and pictures; gmsh does not notice by itself that a file is cut short."""
    if name.endswith(".png"):
        pytest.importorskip("pyvista")
    mesh, target = block_file(tmp_path / "block.msh", "triangle"), tmp_path / name
    raw = read_mesh(mesh)
    tables = [(block.cell, block.vertices) for block in raw.blocks]
    piece = Piece(raw.points, [("triangle", tables[0][1])], {"displacement": np.zeros_like(raw.points)})
    FieldWriter(tmp_path, MPI.COMM_SELF).write(1, 1.0, piece)
    refined = halved_where(MPI.COMM_SELF, raw, np.ones(len(tables[0][1]), bool), mesh)
    write = {
        ".h5": lambda: convert(mesh, target),
        ".png": lambda: show(str(tmp_path), {"field": "displacement", "o": str(target), "size": "300x200"}),
        ".msh": lambda: write_refined(target, refined),
        ".pos": lambda: write_sizes(target, raw.points, tables, np.ones(len(raw.points))),
    }[target.suffix]
    write()
    before, there = target.read_bytes(), sorted(tmp_path.iterdir())
    with full(len(before) // 2), pytest.raises(OutputError, match=rf"{name}: cannot be written \(file too large\)"):
        write()
    assert target.read_bytes() == before and sorted(tmp_path.iterdir()) == there


# MPI needs files of its own to start
LIMITED = """\
import resource, sys
from pcontact.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), resource.RLIM_INFINITY))
main(sys.argv[2:])
"""
STEPS = Case([], scene=SCENE + "[steps]\ncount = 6\n[output]\ncheckpoint = true\n")


def ours(done):
    """The lines that tell the user what is wrong."""
    for word in ("Traceback", "PETSC ERROR", "Segmentation", "MPI_ABORT"):
        assert word not in done.stderr, done.stderr
    return [line for line in done.stderr.splitlines() if line.startswith("pcontact: error: ")]


@pytest.mark.slow
@pytest.mark.parametrize("ranks, size, file", [(1, 12_000, "checkpoint"), (3, 15_500, "report")])
def test_a_run_on_a_full_disk(tmp_path, ranks, size, file):
    """Status 3 and one line; what was written before is whole."""
    # reports grow with the load steps, checkpoints do not
    lay_out(tmp_path / "case", Case([], scene=STEPS.scene.replace("count = 6", "count = 14")))
    start = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
    words = [sys.executable, "-c", LIMITED, str(size), "run", "scene.toml", "-o", "out"]
    done = launch([*start, *words], tmp_path / "case")
    assert done.returncode == 3, done.stderr
    (line,) = ours(done)
    assert re.search(rf"out/{file}.*: cannot be written \(file too large\); what was written before is whole", line)
    if file == "report":
        check_whole(tmp_path / "case" / "out", done.stdout.count("newton"))
