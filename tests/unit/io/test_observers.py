"""What watches a run: when its report is written."""

import json
from collections import namedtuple

import pytest
from mpi4py import MPI

from pcontact.io.observers import Records
from pcontact.io.report import read_report
from pcontact.runtime.errors import InputError, OutputError
from tests.support.records import step_row

Step = namedtuple("Step", "number")


def records(folder, **more):
    return Records(folder, MPI.COMM_SELF, {"estimate": {}}, dict, **more)


def add(watch, numbers):
    for number in numbers:
        watch.step(Step(number), None, step_row(0.1 * number))


def test_what_is_written_grows_with_the_load_steps_and_not_with_their_square(tmp_path):
    """All that is written of the report, over the report at the end; and the load steps are not kept."""
    watch, path, written, last = records(tmp_path, keep=False), tmp_path / "report.json", 0, None
    with pytest.raises(OutputError), watch.kept():
        for number in range(1, 601):
            add(watch, [number])
            now = path.stat()
            if last is None or (now.st_ino, now.st_mtime_ns) != (last.st_ino, last.st_mtime_ns):
                written += now.st_size
            last = now
        raise OutputError("full")
    assert written < 10 * path.stat().st_size and watch.report.steps is None
    report = json.loads(path.read_text())
    assert len(report["steps"]) == 600 and report == read_report(tmp_path)
    assert len((tmp_path / "history.csv").read_text().splitlines()) == 601


@pytest.mark.parametrize("error", [OutputError("full"), InputError("wrong"), KeyboardInterrupt()])
def test_whatever_ends_a_run_leaves_all_load_steps_in_the_report(tmp_path, error):
    watch = records(tmp_path)
    with pytest.raises(type(error)), watch.kept():
        add(watch, range(1, 39))
        assert len(json.loads((tmp_path / "report.json").read_text())["steps"]) < 38
        assert len(read_report(tmp_path)["steps"]) == 38
        raise error
    assert len(json.loads((tmp_path / "report.json").read_text())["steps"]) == 38


def test_the_head_is_there_before_the_first_load_step(tmp_path):
    """But where the input is wrong nothing stays."""
    watch = records(tmp_path)
    with pytest.raises(InputError), watch.kept():
        assert read_report(tmp_path)["steps"] == [] and not read_report(tmp_path)["converged"]
        raise InputError("wrong")
    assert not list(tmp_path.iterdir())
