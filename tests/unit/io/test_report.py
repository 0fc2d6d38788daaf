"""report.json."""

import json
import math

import numpy as np
import pytest

from pcontact.io.report import Report
from tests.support.records import step_row


def test_report_is_plain_json_after_every_step(tmp_path):
    report = Report(tmp_path / "report.json")
    report.data.update(title="Kugel auf Block: µ", ranks=np.int32(2))
    report.add_step(step_row(0.1, force=math.inf))
    data = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert data["title"] == "Kugel auf Block: µ" and data["ranks"] == 2 and data["converged"] is False
    assert data["steps"][0]["reactions"]["base"] == [0.0, 0.0, None]
    assert data["steps"][0]["plastic"]["yielded_volume"] is None
    assert set(data) == {
        "format",
        "title",
        "version",
        "ranks",
        "dofs",
        "cells",
        "converged",
        "model",
        "steps",
        "timing",
        "parallel",
        "memory",
    }
    report.add_step(step_row(0.2))
    assert [step["time"] for step in Report(report.path, resume_time=0.1).data["steps"]] == [0.1]
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
