"""report.json and steps.jsonl."""

import json
import math

import numpy as np
import pytest

from pcontact.io.names import CHECKPOINT
from pcontact.io.report import Report, read_report, read_steps
from tests.support.records import step_row

KEYS = {"format", "title", "version", "ranks", "dofs", "cells", "converged", "model", "steps", "timing", "parallel",
        "memory"}  # fmt: skip


def report_of(folder, times, **more):
    """A report with load steps at some times."""
    report = Report(folder, **more)
    report.begin()
    for time in times:
        report.add_step(step_row(time))
    return report


def times_of(steps):
    return [step["time"] for step in steps]


def test_report_is_plain_json(tmp_path):
    report = report_of(tmp_path, [])
    report.data.update(title="Kugel auf Block: µ", ranks=np.int32(2))
    report.add_step(step_row(0.1, force=math.inf))
    report.add_step(step_row(0.2))
    report.write()
    data = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert data["title"] == "Kugel auf Block: µ" and data["ranks"] == 2 and data["converged"] is False
    assert data["steps"][0]["reactions"]["base"] == [0.0, 0.0, None]
    assert data["steps"][0]["plastic"]["yielded_volume"] is None
    assert set(data) == KEYS and data == read_report(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"report.json", "steps.jsonl"}


def test_a_load_step_is_added_and_nothing_else_is_written(tmp_path):
    """What is written of a load step does not grow with the load steps before it; memory does not, either."""
    report, written = report_of(tmp_path, [0.1], keep=False), (tmp_path / "report.json").stat().st_mtime_ns
    sizes = []
    for _ in range(3):
        report.add_step(step_row(0.5))
        sizes.append((tmp_path / "steps.jsonl").stat().st_size)
    assert np.diff(sizes)[0] == np.diff(sizes)[1] and (tmp_path / "report.json").stat().st_mtime_ns == written
    assert report.steps is None and len(report.whole()["steps"]) == 4


def test_the_checkpoint_of_an_earlier_run_goes(tmp_path):
    """With the first load step, as other results do; a run that goes on from it keeps it."""
    old = tmp_path / CHECKPOINT
    report_of(tmp_path, [0.5])
    old.write_text("")
    report_of(tmp_path, [1.0], resume_time=0.5)
    report_of(tmp_path, [])
    assert old.exists()
    report_of(tmp_path, [0.25])
    assert not old.exists()


def test_a_run_that_was_killed_is_read(tmp_path):
    """The head is there from the beginning on, load steps as they end; one that was cut off by the kill is left out."""
    report = report_of(tmp_path, [])
    assert set(read_report(tmp_path)) == KEYS and not read_report(tmp_path)["steps"]
    report.data.update(title="killed", estimate={"label": "a"})
    report.write()
    report.add_step(step_row(0.1))
    report.add_step({**step_row(0.2), "estimate": {"relative": 0.5}})
    with open(tmp_path / "steps.jsonl", "ab") as stream:
        stream.write('{"time": 0.3, "titel": "µ"'.encode()[:-2])
    data = read_report(tmp_path)
    assert data["title"] == "killed" and times_of(data["steps"]) == [0.1, 0.2]
    assert data["estimate"] == {"label": "a", "relative": 0.5}
    report_of(tmp_path, [0.25], resume_time=0.2)
    assert times_of(read_steps(tmp_path)) == [0.1, 0.2, 0.25]


def test_a_run_that_goes_on_keeps_the_steps_before(tmp_path):
    """Also those of a report that has no steps.jsonl beside it; a run that begins anew keeps none."""
    report_of(tmp_path, [0.1, 0.2, 0.3]).write()
    going_on = report_of(tmp_path, [0.22], resume_time=0.2)
    assert times_of(going_on.steps) == times_of(read_steps(tmp_path)) == [0.1, 0.2, 0.22]
    going_on.write()
    (tmp_path / "steps.jsonl").unlink()
    assert times_of(read_report(tmp_path)["steps"]) == [0.1, 0.2, 0.22]
    report_of(tmp_path, [0.15], resume_time=0.1)
    assert times_of(read_steps(tmp_path)) == [0.1, 0.15]
    begun_anew = report_of(tmp_path, [])
    assert times_of(read_report(tmp_path)["steps"]) == [0.1, 0.15], "as long as nothing takes their place"
    begun_anew.add_step(step_row(0.7))
    assert times_of(read_report(tmp_path)["steps"]) == [0.7]


def test_what_is_left_where_a_run_ends_early(tmp_path):
    """All load steps so far; nothing where the input is wrong before the first one; what was there before stays."""
    report_of(tmp_path, []).leave(True)
    assert not list(tmp_path.iterdir())
    report_of(tmp_path, [0.1]).leave(True)
    assert times_of(json.loads((tmp_path / "report.json").read_text())["steps"]) == [0.1]
    for refused in (True, False):
        report_of(tmp_path, []).leave(refused)
        assert times_of(json.loads((tmp_path / "report.json").read_text())["steps"]) == [0.1]
