"""What studies share: rows that are kept, results of earlier runs, pages."""

import numpy as np
import pytest

from drivers.studies._harness import Rows, joined, publish
from pcontact.runtime.errors import InputError


def test_rows_are_kept(tmp_path):
    """Rows of an earlier run are there again; a line that was cut off is not."""
    rows = Rows(tmp_path / "rows.jsonl", ("seed",))
    rows.add({"seed": 1, "true": 0.5})
    with open(tmp_path / "rows.jsonl", "a") as file:
        file.write('{"seed": 2, "tr')
    again = Rows(tmp_path / "rows.jsonl", ("seed",))
    assert {"seed": 1} in again and {"seed": 2} not in again
    again.add({"seed": 2, "true": 1.0})
    assert [row["seed"] for row in Rows(tmp_path / "rows.jsonl", ("seed",))] == [1, 2]


def test_rows_are_made_once(tmp_path):
    """A row that is there is not made again, unless the study begins anew."""
    for kept, times in ((True, 1), (True, 0), (False, 1)):
        made = []
        rows = Rows(tmp_path / "rows.jsonl", ("seed",), kept)
        row = rows.get({"seed": 3}, lambda made=made: made.append(1) or {"true": np.float64(0.25)})
        assert row == {"seed": 3, "true": 0.25}
        assert len(made) == times


def test_rows_of_several_runs(tmp_path):
    """Of rows with the same keys the later one counts, at the place of the first; other files are refused."""
    for name, text in (("a", '[{"of": 1, "x": 1}, {"of": 2, "x": 2}]'), ("b", '[{"of": 1, "x": 3}]'), ("c", "{")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "rows.json").write_text(text)
    found = joined([tmp_path / "a", tmp_path / "b"], "rows.json", ("of",))
    assert found == [{"of": 1, "x": 3}, {"of": 2, "x": 2}]
    with pytest.raises(InputError, match="--join"):
        joined([tmp_path / "c"], "rows.json", ("of",))


def test_pages(tmp_path):
    """What follows the line is replaced; a document without it is refused."""
    page = tmp_path / "page.md"
    page.write_text("head\n\n<!-- here -->\n\nold")
    publish(page, "<!-- here -->", "new\n")
    assert page.read_text() == "head\n\n<!-- here -->\n\nnew\n"
    with pytest.raises(InputError, match="found no line"):
        publish(page, "<!-- there -->", "")
