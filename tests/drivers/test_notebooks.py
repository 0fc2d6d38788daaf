"""The notebooks of the examples: their cells run one after the other, as in a kernel."""

import ast
import io
import json
import os
import re
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest

import drivers

FOLDER = Path(drivers.__path__[0]) / "examples"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def code_of(path):
    """Source of the code cells; the notebook is one of version 4, kept with what its cells show."""
    book = json.loads(path.read_text(encoding="utf-8"))
    assert book["nbformat"] == 4 and len({cell["id"] for cell in book["cells"]}) == len(book["cells"])
    code = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    for cell in code:
        source = "".join(cell["source"])
        assert bool(cell["outputs"]) == ("print(" in source or isinstance(ast.parse(source).body[-1], ast.Expr))
    return ["".join(cell["source"]) for cell in code]


def printed(path):
    """What the cells print, as it is kept."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    kept = [one for cell in cells for one in cell.get("outputs", []) if one["output_type"] == "stream"]
    return "".join(line for one in kept for line in one["text"])


def numbers(text):
    return np.array([float(word) for word in re.findall(r"-?\d+(?:\.\d*)?(?:e[-+]?\d+)?", text)])


def executed(path, monkeypatch):
    """Names that the cells leave, and what each of them shows at its end; they print what is kept."""
    pytest.importorskip("matplotlib")
    monkeypatch.setitem(os.environ, "MPLBACKEND", "agg")
    names, shown = {}, []
    said = io.StringIO()
    for source in code_of(path):
        cell = ast.parse(source)
        last = cell.body.pop() if isinstance(cell.body[-1], ast.Expr) else None
        with redirect_stdout(said):
            exec(compile(cell, path.name, "exec"), names)
            shown.append(None if last is None else eval(compile(ast.Expression(last.value), path.name, "eval"), names))
    now, kept = numbers(said.getvalue()), numbers(printed(path))
    assert len(now) and now == pytest.approx(kept, rel=1e-3, abs=1e-4), "python scripts/notebooks.py writes them"
    return names, shown


def test_there_are_notebooks():
    assert {path.stem for path in NOTEBOOKS} == {"first_run", "from_arrays", "study"}


@pytest.mark.slow
def test_a_parameter_study_of_ten_lines(monkeypatch):
    assert len(code_of(FOLDER / "study.ipynb")[0].splitlines()) <= 10
    names, shown = executed(FOLDER / "study.ipynb", monkeypatch)
    force = names["force"]
    assert abs(force[0]) < 1e-3 * force[1] and np.all(np.diff(force) > 0.0)
    # a third of the stiffness, a third of the pressure
    table = {(row["contacts['foot'].friction"], row["materials.steel.E"]): row for row in names["several"].rows}
    soft, hard = (table[0.1, modulus]["contacts.foot.max_pressure"] for modulus in (70e3, 210e3))
    assert len(table) == 4 and soft == pytest.approx(hard / 3.0, rel=1e-6)
    assert set(shown[0]) >= {"converged", "contacts.foot.force_x"}


@pytest.mark.slow
def test_a_first_run(monkeypatch):
    pytest.importorskip("pyvista")
    names, shown = executed(FOLDER / "first_run.ipynb", monkeypatch)
    assert names["run"].converged and [one._repr_png_()[:4] for one in shown[1:3]] == [b"\x89PNG"] * 2
    watched = names["watched"]
    assert watched.stopped and watched.steps[-1]["contacts"]["foot"]["slip"] >= 80
    assert np.diff(watched.history["time"])[-1] == pytest.approx(0.1)


def test_mesh_and_scene_from_arrays(monkeypatch):
    names, _ = executed(FOLDER / "from_arrays.ipynb", monkeypatch)
    contact = names["contact"]
    assert contact.force[1] == pytest.approx(-np.sum(contact.pressure * contact.weight), rel=1e-9)
    assert {"stick", "slip"} >= set(contact.status_names) - {"open"}
