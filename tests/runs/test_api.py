"""Runs in memory: the same numbers as on the command line, nothing left behind, errors as exceptions."""

import ctypes
import gc
import io
import json
import logging
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pcontact as pc
from drivers.examples.friction import drag
from meshes.__main__ import main as write_mesh
from pcontact.io.result import load_result
from pcontact.runtime import log
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import MPI, PETSc, option_used, own_options
from tests.support.bad_input import SCENE, Case, mesh_text
from tests.support.commands import ENDLESS, LATE, ROOT, TIMEOUT, environment, lay_out
from tests.support.small import blocks_file

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
parallel = pytest.mark.parallel(2, 3)
# one iteration of a weak linear solver is not enough for anything that moves, which it does from 0.5 on
WEAK = {"snes_max_it": 1, "ksp_max_it": 1, "pc_type": "jacobi", "steps_count": 4, "steps_min": 0.1}
# what a run takes, not what it finds
COSTS = ("timing", "parallel", "memory", "counters")


def tables(**more):
    """Two blocks pressed together, sliding and yielding, in three load steps."""
    return {
        "title": "two blocks",
        "mesh": {"file": "blocks.msh", "order": 1},
        "materials": {"soft": {"E": 10.0, "nu": 0.3, "yield_stress": 0.2, "hardening": 1.0},
                      "hard": {"E": 30.0, "nu": 0.2}},
        "bodies": [{"region": "lower", "material": "hard"}, {"region": "upper", "material": "soft"}],
        "contacts": [{"name": "pair", "source": "upper_bottom", "target": "lower_top", "friction": 0.3}],
        "displacements": [{"region": "lower_bottom", "value": [0.0, 0.0]},
                          {"region": "upper_top", "value": [0.02, -0.03]}],
        "steps": {"count": 3},
        "output": {"probes": ["upper_top"]},
        **more,
    }  # fmt: skip


@pytest.fixture
def folder(shared_tmp):
    """With the mesh of the blocks in it. *Collective.*"""
    if WORLD.rank == 0:
        blocks_file(shared_tmp / "blocks.msh", "quadrilateral", 3, 4)
    WORLD.Barrier()
    return shared_tmp


@pytest.fixture
def squares(shared_tmp):
    """Scene file of two squares. *Collective.*"""
    if WORLD.rank == 0:
        (shared_tmp / "scene.toml").write_text(SCENE)
        (shared_tmp / "mesh.msh").write_text(mesh_text())
    WORLD.Barrier()
    return shared_tmp / "scene.toml"


def same(one, other, rtol=1e-6, atol=1e-9):
    """Two runs have found the same."""
    assert one.history.keys() == other.history.keys()
    for name in ("time", "contacts.pair.force_y", "contacts.pair.area"):
        np.testing.assert_allclose(one.history[name], other.history[name], rtol=rtol, atol=atol, err_msg=name)


# -- the same as on the command line ----------------------------------------

IN_MEMORY = """\
import json, os, sys
import numpy as np
import pcontact as pc
assert "mpi4py" not in sys.modules and "petsc4py" not in sys.modules
before = sorted(os.listdir("."))
steps = []
run = pc.run(pc.read("case/scene.toml"), on_step=lambda step: steps.append(step.report))
from mpi4py import MPI
MPI.COMM_WORLD.Barrier()
assert sorted(os.listdir(".")) == before and sorted(os.listdir("case")) == ["mesh.msh", "scene.toml"]
assert steps == run.report["steps"]
reports = MPI.COMM_WORLD.allgather(run.report)
assert all(report == reports[0] for report in reports)
whole = run.gather()
if whole is not None:
    fields = {name: values.tolist() for name, values in (whole.point_data | whole.cell_data).items() if name != "rank"}
    fields |= {f"pair.{name}": values.tolist() for name, values in whole.contacts["pair"].items()}
    fields |= {"nodes": whole.node_numbers.tolist(), "numbers": whole.cell_numbers.tolist()}
    fields |= {"points": whole.points.tolist(), "cells": [(kind, table.tolist()) for kind, table in whole.cells]}
    found = {"report": run.report, "history": {k: v.tolist() for k, v in run.history.items()}, "fields": fields}
    with open("found.json", "w") as stream:
        json.dump(found, stream)
    sys.stdout.write("the command line:\\n")
from pcontact.cli import main
main(["run", "case/scene.toml", "-o", "out"])
"""
RUBBISH = ["-snes_max_it", "0", "-pc_type", "nonsense", "-contact_theta", "7", "-help", "--no", "run"]


def toml(data):
    """The tables as a scene file: values of JSON are values of TOML, and tables can stand in one line."""
    def text(value):
        if isinstance(value, dict):
            return "{" + ", ".join(f"{key} = {text(part)}" for key, part in value.items()) + "}"
        return "[" + ", ".join(map(text, value)) + "]" if isinstance(value, list) else json.dumps(value)

    return "".join(f"{key} = {text(value)}\n" for key, value in data.items())


@pytest.fixture(scope="module")
def on_ranks(tmp_path_factory):
    """Runs the blocks on some ranks, in memory and by the command line, once: folder and what was found."""
    made = {}

    def start(ranks):
        if ranks not in made:
            folder = tmp_path_factory.mktemp(f"ranks{ranks}")
            (folder / "case").mkdir()
            # partners are those of the solution, not of the iterates before it, which depend on the ranks
            partners = {"contact_partner_rtol": "1e-8"}
            (folder / "case" / "scene.toml").write_text(toml(tables(mesh={"file": "mesh.msh"}, petsc=partners)))
            blocks_file(folder / "case" / "mesh.msh", "quadrilateral", 3, 4)
            first = [] if ranks == 1 else ["mpirun", "-n", str(ranks)]
            words = [*first, sys.executable, "-c", IN_MEMORY, *RUBBISH]
            done = subprocess.run(words, cwd=folder, env=environment(), capture_output=True, text=True, timeout=TIMEOUT)
            assert done.returncode == 0, done.stderr
            # nothing of the run in memory
            assert done.stdout.startswith("the command line:\npcontact ") and done.stderr == ""
            made[ranks] = folder, json.loads((folder / "found.json").read_text())
        return made[ranks]

    return start


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_report_and_history_are_those_of_the_files(on_ranks, ranks):
    """Whatever stands on the command line of the caller; nothing is written, nothing shown.

    On several ranks sums depend on the order in which messages come.
    """
    folder, found = on_ranks(ranks)
    report = json.loads((folder / "out" / "report.json").read_text())
    assert report["converged"] and len(report["steps"]) == 3 and report["ranks"] == ranks
    assert found["report"].keys() == report.keys()
    exact = {"rtol": 0.0} if ranks == 1 else {"rtol": 1e-7, "atol": 1e-9}
    for name in report.keys() - {*COSTS, *(["steps"] if ranks > 1 else [])}:
        assert found["report"][name] == report[name], name
    assert [step.keys() for step in found["report"]["steps"]] == [step.keys() for step in report["steps"]]
    for name in COSTS:
        assert found["report"][name].keys() == report[name].keys()
    head, *rows = (folder / "out" / "history.csv").read_text().splitlines()
    assert head.split(",") == list(found["history"])
    table = np.array([row.split(",") for row in rows], dtype=float)
    np.testing.assert_allclose(np.array(list(found["history"].values())).T, table, **exact)


@pytest.mark.slow
def test_fields_are_those_of_the_files(on_ranks):
    """On one rank to the last digit."""
    folder, found = on_ranks(1)
    fields, written = found["fields"], load_result(folder / "out")
    (_, table), = fields["cells"]
    points = np.array(fields["points"])
    for name in ("stress", "equivalent_plastic_strain", "body"):
        np.testing.assert_array_equal(np.concatenate(written.bodies.cell_data[name])[np.argsort(_file_order(folder))],
                                      fields[name])  # fmt: skip
    ((_, nodes),) = written.bodies.cells
    order = np.argsort(_file_order(folder))
    np.testing.assert_array_equal(written.bodies.points[nodes[order]][..., :2], points[np.array(table)])
    moved = np.array(fields["displacement"])[np.array(table)]
    np.testing.assert_array_equal(written.bodies.point_data["displacement"][nodes[order]][..., :2], moved)
    cloud = written.points["pair"]
    for name in ("pressure", "gap", "traction"):
        shown = cloud.point_data[name][..., :2] if cloud.point_data[name].ndim == 2 else cloud.point_data[name]
        np.testing.assert_array_equal(np.sort(shown, axis=0), np.sort(np.array(fields[f"pair.{name}"]), axis=0))


def _file_order(folder):
    """Numbers of the cells in the order of the blocks."""
    return pc.run(folder / "case" / "scene.toml", comm=SELF).fields().cell_numbers


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [2, 3])
def test_gathered_fields_do_not_depend_on_the_ranks(on_ranks, ranks):
    """Nodes, cells and quadrature points have the places that they have on one rank."""
    one, several = on_ranks(1)[1]["fields"], on_ranks(ranks)[1]["fields"]
    assert one.keys() == several.keys()
    for name in ("nodes", "numbers", "points", "cells", "body", "pair.number", "pair.status"):
        assert one[name] == several[name], name
    assert one["nodes"] == sorted(one["nodes"]) and one["numbers"] == sorted(one["numbers"])
    for name in one.keys() - {"cells"}:
        np.testing.assert_allclose(several[name], one[name], rtol=1e-6, atol=1e-8, err_msg=name)


# -- what a run leaves behind ----------------------------------------


@parallel
def test_options_are_of_one_run(squares):
    """They do not reach the next run, nor the options of the process, which do not reach them."""
    options, before = PETSc.Options(), PETSc.Options().getAll()
    options.setValue("snes_max_it", 0)
    try:
        first = pc.run(squares)
        other = pc.run(squares, options={"steps_count": 3, "contact_theta": -1, "-contact_gamma0": np.float64(2.0)})
        again = pc.run(squares, options="-snes_rtol 1e-10")
        assert options.getAll() == {**before, "snes_max_it": "0"}
    finally:
        options.delValue("snes_max_it")
    assert [len(run.history["time"]) for run in (first, other, again)] == [1, 3, 1]
    assert any("theta -1, gamma0 2" in text for text in other.report["model"]["active"])
    assert first.report["model"] == again.report["model"] != other.report["model"]
    same(first, again)
    assert first.unused == other.unused == again.unused == []


@parallel
def test_a_scene_is_left_as_it_is(squares):
    """Options of a run do not get into it; its attributes may be changed."""
    scene = pc.read(squares)
    pc.run(scene, options={"steps_count": 3, "mesh_order": 2, "contact_theta": 1})
    assert scene.steps.count == 1 and scene.mesh.order is None and scene.contacts[0].theta is None
    scene.steps.count = 2
    assert len(pc.run(scene).history["time"]) == 2
    scene.steps.count = -1
    with pytest.raises(pc.InputError, match="steps.count: found an integer -1"):
        pc.run(scene)


@parallel
def test_options_that_nothing_asked_for(squares):
    """They are named, to who has given them."""
    with pytest.warns(UserWarning) if WORLD.rank == 0 else _nothing() as told:
        run = pc.run(squares, options={"contact_tehta": 1})
    line = "option -contact_tehta: neither pcontact nor PETSc has it; the nearest is -contact_theta"
    assert run.unused == [line] and run.converged
    if WORLD.rank == 0:
        assert [str(one.message) for one in told] == [line] and told[0].filename == __file__


class _nothing:  # noqa: N801
    def __enter__(self):
        return []

    def __exit__(self, *exception):
        return False


@pytest.mark.slow
@parallel
def test_a_run_leaves_nothing_behind(squares, monkeypatch):
    """Communicators, signals, log and working directory are as before, after failures, too."""
    monkeypatch.chdir(squares.parent)
    files, handlers = sorted(squares.parent.rglob("*")), [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    state = list(log.LOGGER.handlers), log.LOGGER.level, log.LOGGER.propagate, log.LOGGER.disabled

    def probe():
        comm = WORLD.Dup()
        number = comm.py2f()
        comm.Free()
        return number

    pc.run(squares)
    free = probe()
    for options in ({}, {"snes_rtol": "nonsense"}, {"contact_theta": 7}, {"snes_rtol": 2.0}):
        for _ in range(3):
            if options:
                with pytest.raises(pc.InputError, match="^(PETSc )?options: "):
                    pc.run(squares, options=options)
            else:
                pc.run(squares, options={"pc_contact_filter": True, "pc_type": "gamg"})
    with pytest.raises(pc.NotConverged):
        pc.run(squares, options=WEAK)
    assert probe() == free
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == handlers
    assert (list(log.LOGGER.handlers), log.LOGGER.level, log.LOGGER.propagate, log.LOGGER.disabled) == state
    WORLD.Barrier()
    assert sorted(squares.parent.rglob("*")) == files


class MemoryInUse(ctypes.Structure):
    """What glibc has handed out [byte]."""

    _fields_ = [(name, ctypes.c_size_t) for name in ("arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks",
                                                     "fsmblks", "uordblks", "fordblks", "keepcost")]  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="needs glibc 2.33")
def test_memory_is_given_back(folder):
    """Solver, matrices, mesh, and the local parts of exchanges die with their run, or sooner."""
    mallinfo = ctypes.CDLL(None).mallinfo2
    mallinfo.restype = MemoryInUse

    def in_use():
        gc.collect()
        found = mallinfo()
        return found.uordblks + found.hblkhd

    blocks_file(folder / "blocks.msh", "quadrilateral", 40, 42)
    plain = {name: {"E": 10.0, "nu": 0.3} for name in ("soft", "hard")}
    scene = pc.from_dict(tables(steps={"count": 1}, materials=plain), folder)
    for _ in range(2):
        pc.run(scene)
    before = in_use()
    for _ in range(4):
        pc.run(scene)
    # one vector of the 3500 nodes has 55 kB, all that a run holds some 10 MB
    assert (in_use() - before) / 4 < 40e3


@parallel
def test_output_where_asked(squares):
    """The files of the command line, and the directory is free again."""
    out = squares.parent / "out"
    for _ in range(2):
        run = pc.run(squares, output=out)
        WORLD.Barrier()
        assert json.loads((out / "report.json").read_text()) == run.report
        names = {path.name for path in out.iterdir()}
        assert names == {"report.json", "steps.jsonl", "history.csv", "fields.pvd", "fields"}
        WORLD.Barrier()
    with pytest.raises(pc.InputError, match=f"^output {squares}: found .*not a directory"):
        pc.run(squares, output=squares)


@pytest.mark.slow
def test_nothing_is_shown_unless_asked(squares, capfd, caplog):
    """Lines go to standard output, or to the caller's own logging."""
    with pytest.raises(pc.NotConverged):
        pc.run(squares, options=WEAK)
    assert capfd.readouterr() == ("", "")
    pc.run(squares, level="info")
    shown = capfd.readouterr()
    assert "step 1  time 1" in shown.out and shown.err == ""
    with pytest.raises(ValueError, match="log level 'loud'"):
        pc.run(squares, level="loud")
    code = """if True:
        import logging
        import pcontact as pc
        logging.basicConfig(level=logging.INFO, format="%(name)s %(levelname)s: %(message)s")
        pc.run("scene.toml")
    """
    done = subprocess.run([sys.executable, "-c", code], cwd=squares.parent, env=environment(), capture_output=True,
                          text=True, timeout=TIMEOUT)  # fmt: skip
    assert "pcontact INFO: step 1  time 1" in done.stderr and done.stdout == ""


# -- what goes wrong ----------------------------------------


@parallel
def test_wrong_input_is_an_exception(squares):
    """On every rank, and a run after it finds what it always does."""
    right = pc.run(squares)
    with pytest.raises(pc.InputError, match=r"scene\.toml: steps\.cuont: found an unknown key"):
        pc.read(squares, steps={"cuont": 3})
    with pytest.raises(pc.InputError, match="nowhere.*found no such file"):
        pc.run(squares.parent / "nowhere.toml")
    with pytest.raises(pc.InputError, match=r"contacts\[0\] \(pair\)\.target: found 'roof'"):
        pc.run(pc.read(squares, contacts={"pair": {"target": "roof"}}))
    with pytest.raises(pc.InputError, match="options: found 7"):
        pc.run(squares, options=7)
    with pytest.raises(pc.InputError, match="options: snes_rtol: found a value of type object <object"):
        pc.run(squares, options={"snes_rtol": object()})
    same(right, pc.run(squares))


@parallel
def test_a_step_that_does_not_converge(shared_tmp):
    """The exception carries the run up to there; a run after it is none the worse."""
    if WORLD.rank == 0:
        lay_out(shared_tmp / "case", LATE)
    WORLD.Barrier()
    path = shared_tmp / "case" / "scene.toml"
    with pytest.raises(pc.NotConverged, match=r"0\.5 to 0\.625") as caught:
        pc.run(path, options=WEAK)
    run = caught.value.run
    assert not run.converged and not run.stopped and run.report["converged"] is False
    np.testing.assert_array_equal(run.history["time"], [0.25, 0.5])
    assert run.fields().time == 0.5 and not np.any(run.fields().displacement)
    run = pc.run(path, options=WEAK, check=False)
    assert not run.converged and len(run.report["steps"]) == 2
    run = pc.run(path)
    assert run.converged and run.history["contacts.pair.force_y"][-1] < 0.0
    # nothing has converged at all
    with pytest.raises(pc.NotConverged) as caught:
        pc.run(pc.read(path, displacements=[{"region": "lower_bottom", "value": [0, 0]},
                                            {"region": "upper_top", "value": [0, -0.05]}]), options=WEAK)  # fmt: skip
    assert caught.value.run.history == {} and caught.value.run.report["steps"] == []
    with pytest.raises(LookupError, match="no load step"):
        caught.value.run.fields()


def test_the_first_search_for_modules_does_not_start_mpi():
    """Neither does a kernel, nor an error."""
    code = """if True:
        import sys
        import pcontact as pc
        from pcontact.contact.formulation.small_kernels import __name__
        assert issubclass(pc.InputError, Exception) and "run" in dir(pc)
        assert not {"mpi4py.MPI", "petsc4py.PETSc", "pcontact.api"} & set(sys.modules)
        try:
            pc.rnu
        except AttributeError as error:
            assert "rnu" in str(error)
        else:
            raise AssertionError
    """
    subprocess.run([sys.executable, "-c", code], check=True, env=environment(), cwd=ROOT, timeout=TIMEOUT)


# -- load steps ----------------------------------------


@parallel
def test_on_step_sees_each_step_and_ends_the_run(folder):
    """After it has been committed; any rank may end the run."""
    scene, seen = pc.from_dict(tables(), folder), []
    whole = pc.run(scene, on_step=seen.append)
    assert [step.number for step in seen] == [1, 2, 3] and whole.converged and not whole.stopped
    assert [step.report for step in seen] == whole.report["steps"]
    assert [step.newton for step in seen] == whole.history["newton"].tolist()
    # the fields of each step are its own
    top = [step.fields().displacement.min() for step in seen]
    assert np.all(np.diff(WORLD.allgather(top), axis=1) < 0.0)
    np.testing.assert_array_equal(seen[-1].fields().stress, whole.fields().stress)

    def enough(step):
        return step.number < 2 if WORLD.rank == WORLD.size - 1 else None

    out = folder / "out"
    run = pc.run(scene, on_step=enough, output=out)
    WORLD.Barrier()
    assert run.stopped and not run.converged and len(run.report["steps"]) == 2
    assert json.loads((out / "report.json").read_text()) == run.report
    np.testing.assert_allclose(run.fields().displacement, seen[1].fields().displacement, rtol=1e-9, atol=1e-12)


@parallel
def test_on_step_says_how_long_the_next_load_step_is(folder):
    """The smallest that any rank says; the one after that is as planned."""
    def change(step):
        if step.number == 1:
            step.next_size = 0.5 if WORLD.rank == WORLD.size - 1 else 0.6

    scene = pc.from_dict(tables(), folder)
    assert pc.run(scene, on_step=change).history["time"] == pytest.approx([1 / 3, 5 / 6, 1.0])

    def wrong(step):
        step.next_size = -1.0

    with pytest.raises(ValueError, match="next load step: found -1.0; allowed: a number >= "):
        pc.run(scene, on_step=wrong)


@pytest.mark.slow
@parallel
def test_a_run_that_was_ended_goes_on(folder):
    """From its checkpoint; in its own directory with the load steps of before."""
    scene, out = pc.from_dict(tables(output={"checkpoint": True, "fields": False}), folder), folder / "out"
    whole = pc.run(scene)
    assert not out.exists()
    pc.run(scene, output=out, on_step=lambda step: step.number < 2)
    rest = pc.run(scene, options={"restart": str(out)})
    np.testing.assert_allclose(rest.history["time"], whole.history["time"][2:])
    first = [name for name in rest.history if name.startswith(("contacts", "reactions"))]
    for name in first:
        np.testing.assert_allclose(rest.history[name], whole.history[name][2:], rtol=1e-6, atol=1e-8, err_msg=name)
    np.testing.assert_allclose(rest.fields().stress, whole.fields().stress, rtol=1e-6, atol=1e-8)
    both = pc.run(scene, options={"restart": str(out)}, output=out)
    assert both.converged and len(both.report["steps"]) == 3
    assert both.history.keys() == whole.history.keys()
    for name in first:
        np.testing.assert_allclose(both.history[name], whole.history[name], rtol=1e-6, atol=1e-8, err_msg=name)


@parallel
@pytest.mark.parametrize("kind", [ZeroDivisionError, SystemExit, KeyboardInterrupt])
def test_on_step_that_fails(squares, kind):
    """Its own error where it failed, one that tells of it elsewhere; the next run is none the worse."""
    failing = WORLD.size - 1

    def fail(step):
        if WORLD.rank == failing:
            raise kind("by my own hand")

    expected, text = (kind, "^by my own hand") if WORLD.rank == failing else (
        RuntimeError, f"on_step failed on rank {failing}: {kind.__name__}: by my own hand")  # fmt: skip
    with pytest.raises(expected, match=text):
        pc.run(squares, on_step=fail)
    assert pc.run(squares).converged


@parallel
def test_a_run_within_a_run(squares):
    """Options and warnings of both are their own."""
    inner = []

    def within(step):
        inner.append(pc.run(squares, options={"contact_theta": -1, "steps_count": 3}))

    run, alone = pc.run(squares, on_step=within), pc.run(squares)
    same(run, alone)
    assert run.report["model"] == alone.report["model"] and len(inner[0].history["time"]) == 3


@pytest.mark.slow
def test_an_interrupt(squares):
    """It comes through PETSc as itself, and the next run is none the worse."""
    def stop(number, frame):
        raise KeyboardInterrupt("from outside")

    before = signal.signal(signal.SIGALRM, stop)
    try:
        signal.setitimer(signal.ITIMER_REAL, 1.0)
        with pytest.raises(KeyboardInterrupt, match="from outside"):
            pc.run(squares, options=" ".join(ENDLESS))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert pc.run(squares).converged


# -- the page ----------------------------------------


@pytest.fixture
def dragged(tmp_path, monkeypatch):
    """The example that the page is about, beside the working directory."""
    folder = tmp_path / "drivers" / "examples"
    folder.mkdir(parents=True)
    text = Path(shutil.copy(ROOT / "drivers" / "examples" / "drag.toml", folder)).read_text()
    words = re.search(r"python -m meshes (.+) -o drivers", text).group(1).split()
    assert write_mesh([*words, "-o", str(folder / "drag.msh")]) == 0
    monkeypatch.chdir(tmp_path)
    return folder / "drag.toml"


@pytest.mark.slow
def test_the_code_of_the_page(dragged, capsys):
    """All pieces do what they say."""
    text = (ROOT / "docs" / "python.md").read_text()
    first, _, functions, watch, second = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    found = {}
    exec(first, found)
    assert found["run"].history["contacts.drag.force_x"][-1] == pytest.approx(0.2, rel=1e-3)
    assert len([line for line in first.splitlines() if line]) <= 10
    other = {**found, "np": np, "scene": found["scene"].copy()}
    exec(functions, other)
    (load,), (top,) = other["scene"].loads, other["scene"].displacements
    assert load.pressure(np.array([[0.0, 10.0]]), 1.0) == pytest.approx([9.81e-6 * 30.0]) and top.value[1] == "free"
    exec(watch, found)
    force = -found["run"].history["contacts.drag.force_y"]
    assert found["run"].stopped and force[-1] >= 0.9 > force[-2]
    assert np.diff(found["run"].history["time"])[[1, -1]] == pytest.approx([0.05, 0.2])
    exec(second, found)
    assert found["whole"].displacement.shape == found["whole"].points.shape
    assert "[[" in capsys.readouterr().out


def test_the_study_of_friction(dragged):
    """Coulomb's law, and a run that ends early."""
    time, tangential, normal = drag(dragged, 0.1)
    assert 1.0 < time < 2.0 and normal == pytest.approx(1.0, rel=1e-6)
    # as near as the scene itself promises
    assert tangential == pytest.approx(0.1 * normal, rel=1e-3)


# -- fields and scenes ----------------------------------------


@parallel
@pytest.mark.parametrize("smooth", [False, True])
def test_fields_of_all_ranks(folder, smooth):
    """Those of a run on one rank alone, on every rank; the local ones are a part of them."""
    # partners are those of the solution, not of the iterates before it, which depend on the ranks
    data = tables(output={"smooth": smooth}, petsc={"contact_partner_rtol": "1e-8"})
    run, alone = (pc.run(pc.from_dict(data, folder), comm=comm) for comm in (WORLD, SELF))
    whole, one = run.gather(everywhere=True), alone.gather()
    assert (run.gather() is None) == (WORLD.rank > 0)
    assert len(whole.points) == 2 * 16 + 9 + 0 * smooth or len(whole.points) == 16 + 25
    np.testing.assert_array_equal(whole.node_numbers, one.node_numbers)
    np.testing.assert_array_equal(whole.points, one.points)
    np.testing.assert_array_equal(whole.cell_numbers, one.cell_numbers)
    assert [kind for kind, _ in whole.cells] == ["quad"]
    np.testing.assert_array_equal(whole.cells[0][1], one.cells[0][1])
    assert ("stress_smooth" in whole.point_data) == smooth
    for name in (whole.point_data | whole.cell_data).keys() - {"rank"}:
        np.testing.assert_allclose(whole[name], one[name], rtol=1e-6, atol=1e-8, err_msg=name)
    for name, values in whole.contacts["pair"].items():
        np.testing.assert_allclose(values, one.contacts["pair"][name], rtol=1e-6, atol=1e-8, err_msg=name)
    mine = run.fields()
    place = np.searchsorted(whole.node_numbers, mine.node_numbers)
    np.testing.assert_array_equal(mine.displacement, whole.displacement[place])
    force = np.sum(whole.contacts["pair"]["weight"][:, None] * whole.contacts["pair"]["traction"], axis=0)
    np.testing.assert_allclose(-force, run.report["steps"][-1]["contacts"]["pair"]["force"], rtol=1e-10)
    with pytest.raises(ValueError, match="read-only"):
        mine.displacement[:] = 0.0
    with pytest.raises(KeyError, match="'strain', no such name, .*; there are displacement"):
        mine["strain"]


@parallel
def test_bodies_that_share_nodes_keep_their_own_means(folder):
    """Means of cells at the nodes that two bodies share are two, and stay so when all ranks are gathered."""
    if WORLD.rank == 0:
        lines = mesh_text([(0, 0), (1, 0), (1, 1), (0, 1), (1, 2), (0, 2)],
                          [(3, 1, (1, 2, 3, 4)), (3, 2, (4, 3, 5, 6)), (1, 3, (1, 2)), (1, 6, (5, 6))])  # fmt: skip
        (folder / "joined.msh").write_text(lines)
    WORLD.Barrier()
    data = tables(mesh={"file": "joined.msh"}, contacts=[], output={"smooth": True})
    whole = pc.run(pc.from_dict(data, folder)).gather(everywhere=True)
    np.testing.assert_array_equal(whole.node_numbers, [0, 1, 2, 2, 3, 3, 4, 5])
    assert abs(whole["equivalent_plastic_strain_smooth"][2] - whole["equivalent_plastic_strain_smooth"][3]) > 1e-4


def test_scenes_from_dicts_and_changes(folder, monkeypatch):
    """The same scene from a file and a dict; changes merge into tables, those of lists by their names."""
    (folder / "scene.toml").write_text(toml(tables()))
    data = tables(displacements=[{"region": "lower_bottom", "value": np.zeros(2)},
                                 {"region": "upper_top", "value": (np.float64(0.02), -0.03)}])  # fmt: skip
    data["mesh"]["file"] = Path("blocks.msh")
    scene, read = pc.from_dict(data, folder), pc.read(folder / "scene.toml")
    assert scene.bodies == read.bodies and scene.displacements == read.displacements
    assert scene.mesh == read.mesh and scene.mesh_path == read.mesh_path
    assert data["displacements"][0]["value"].shape == (2,)
    monkeypatch.chdir(folder)
    assert pc.from_dict(data).mesh_path.exists()
    changed = pc.read(folder / "scene.toml", title="other", materials={"soft": {"E": 3.0, "hardening": None}},
                      contacts={"pair": {"friction": 0.1}}, displacements={"upper_top": {"value": np.array([0, -1])}},
                      bodies=[{"region": "lower", "material": "hard"}])  # fmt: skip
    assert changed.title == "other" and changed.steps == read.steps and len(changed.bodies) == 1
    assert (changed.materials["soft"].E, changed.materials["soft"].nu) == (3.0, 0.3)
    assert (changed.materials["soft"].yield_stress, changed.materials["soft"].hardening) == (0.2, 0.0)
    assert changed.contacts[0].friction == 0.1 and changed.contacts[0].source == "upper_bottom"
    assert changed.displacements[1].value == (0.0, -1.0)
    with pytest.raises(pc.InputError, match="contacts: found 'pear'.*'pair'.*; allowed"):
        pc.read(folder / "scene.toml", contacts={"pear": {"friction": 0.1}})
    twice = [tables()["bodies"][0]] * 2
    (folder / "twice.toml").write_text(toml(tables(bodies=twice)))
    with pytest.raises(pc.InputError, match="bodies: found 2 tables with region 'lower'"):
        pc.read(folder / "twice.toml", bodies={"lower": {"material": "soft"}})
    with pytest.raises(pc.InputError, match=r"^scene: materials.soft.E: found .*no key|^scene: materials.soft.E"):
        pc.from_dict(tables(materials={"soft": {"E": -1.0, "nu": 0.3}}), folder)
    with pytest.raises(pc.InputError, match="^scene: contact: .*'contacts'"):
        pc.from_dict({**tables(), "contact": []}, folder)
    with pytest.raises(pc.InputError, match="a dict with the tables"):
        pc.from_dict([1], folder)


@parallel
def test_many_runs_on_communicators_of_the_caller(squares):
    """Ranks run scenes of their own at the same time; their communicators can be freed afterwards."""
    part = WORLD.Split(WORLD.rank % 2, WORLD.rank)
    runs = [pc.run(pc.read(squares, steps={"count": 1 + WORLD.rank % 2}), comm=part) for _ in range(2)]
    assert [len(run.history["time"]) for run in runs] == [1 + WORLD.rank % 2] * 2
    assert runs[0].report["ranks"] == part.size
    part.Free()
    alone = pc.run(squares)
    np.testing.assert_allclose(alone.history["contacts.pair.force_y"][-1],
                               runs[0].history["contacts.pair.force_y"][-1], rtol=1e-7)  # fmt: skip


# -- the parts ----------------------------------------


def test_databases_of_options_are_nested():
    """Each is empty at first, and the one before comes back as it was."""
    outside = PETSc.Options()
    before = outside.getAll()
    with own_options():
        assert PETSc.Options().getAll() == {}
        Options("options").give({"-one": 1, "two": None, "three": [1, 2.5], "four": False, "five": np.bool_(True)})
        own = {"one": "1", "two": None, "three": "1,2.5", "four": "false", "five": "true"}
        assert PETSc.Options().getAll() == own
        assert PETSc.Options().getInt("one") == 1 and option_used("one") and not option_used("three")
        with pytest.raises(ZeroDivisionError), own_options():
            Options("options").give("-six 6 -one -2")
            assert PETSc.Options().getAll() == {"six": "6", "one": "-2"}
            raise ZeroDivisionError
        assert PETSc.Options().getAll() == own
        for wrong in ({"a b": 1}, {3: 1}, {"": 1}):
            with pytest.raises(pc.InputError, match="options: found an option named"):
                Options("options").give(wrong)
    assert outside.getAll() == before


def test_the_log_of_a_library():
    """It speaks through the caller's logging, and what was said before counts again."""
    records = []
    handler = logging.Handler()
    handler.emit = records.append
    stream = io.StringIO()
    log.setup(0, stream)
    before = list(log.LOGGER.handlers)
    log.forget_warnings()
    log.warning("before")
    shown = stream.tell()
    with log.of_a_library(0):
        log.warning("inside")
        assert log.warnings() == ["inside"]
    assert stream.tell() == shown
    log.LOGGER.addHandler(handler)
    with log.of_a_library(0):
        log.warning("heard")
    log.LOGGER.removeHandler(handler)
    with log.of_a_library(1):
        log.LOGGER.addHandler(handler)
        log.warning("on another rank")
    assert log.warnings() == ["before"] and log.LOGGER.handlers == before and not log.LOGGER.disabled
    assert [record.getMessage() for record in records] == ["heard"]
    log.setup(WORLD.rank)
    log.forget_warnings()


def test_a_case_needs_no_file_of_its_own(shared_tmp):
    """A dict in place of a scene is taken as one, beside the working directory."""
    lay_out(shared_tmp / "case", Case([]))
    with pytest.raises(pc.InputError, match="mesh.file: found .*mesh.msh"):
        pc.run({"mesh": {"file": "mesh.msh"}, "materials": {}, "bodies": []})
