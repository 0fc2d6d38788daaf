"""history.csv: a row for every load step."""

import csv

import numpy as np

from pcontact.io.report import History, flatten
from pcontact.view.curves import table
from tests.support.records import step_row


def test_history_has_a_row_per_step_and_the_columns_of_the_first(tmp_path):
    history = History(tmp_path / "history.csv")
    history.append(step_row(0.1, force=1 / 3))
    history.append({"time": 0.2, "new": 1.0})
    with open(tmp_path / "history.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0])[:5] == ["time", "newton", "krylov", "cutbacks", "reactions.base_x"]
    assert float(rows[0]["contacts.pair.force_z"]) == -1 / 3 and rows[0]["newton"] == "5"
    assert rows[0]["probes.tip.mean_y"] == "0.5"
    assert rows[1]["time"] == "0.2" and rows[1]["newton"] == "" and "new" not in rows[1]


def test_history_of_a_resumed_run_goes_on(tmp_path):
    for time in (0.1, 0.2, 0.3):
        history = History(tmp_path / "history.csv", resume_time=0.25)
        history.append(step_row(time))
    History(tmp_path / "history.csv", resume_time=0.2).append(step_row(0.22))
    with open(tmp_path / "history.csv", newline="") as stream:
        assert [float(row["time"]) for row in csv.DictReader(stream)] == [0.1, 0.2, 0.22]
    with open(tmp_path / "history.csv", "a") as stream:
        stream.write(",".join(["0.23"] * len(table(tmp_path))))
    assert table(tmp_path)["time"].tolist() == [0.1, 0.2, 0.22], "a row that was cut off is none"
    History(tmp_path / "history.csv", resume_time=0.24).append(step_row(0.25))
    assert table(tmp_path)["time"].tolist() == [0.1, 0.2, 0.22, 0.25]
    History(tmp_path / "history.csv").append({"time": 5})
    assert (tmp_path / "history.csv").read_text().split() == ["time", "5"]


def test_flatten_names_say_where_a_number_comes_from():
    assert flatten({"a": {"b": [1, 2]}, "c": range(0), "d": np.arange(4)}) == {
        "a.b_x": 1, "a.b_y": 2, "c": range(0), "d_0": 0, "d_1": 1, "d_2": 2, "d_3": 3,
    }  # fmt: skip
