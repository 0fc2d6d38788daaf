"""The pages that a new user copies from do what they say: five minutes, and the tutorials."""

import re

import pytest

from tests.support.commands import ROOT
from tests.support.pages import blocks, run_page

DOCS = ROOT / "docs"
# what takes the place of what, so that a page takes seconds
COARSER = {
    "press": [("--h 0.12", "--h 0.3"), ("count = 2", "count = 1")],
    "friction": [("--n-lower 30,10 --n-upper 14,4", "--n-lower 9,3 --n-upper 5,1"), ("count = 42", "count = 11"),
                 ("-step 9", "-step 3")],
    "imprint": [("--h 0.05", "--h 0.2")],
    "self_contact": [("--n 3,30", "--n 1,10"), ("count = 40", "count = 2"),
                     ("displacement = [0, -1.3]", "displacement = [0, -0.2]")],
    "deck": [("--times 3", "--times 1")],
    "study": [("[0.0, 0.1, 0.2, 0.4, 0.8]", "[0.2]"), ('"count": 32', '"count": 8')],
    "cluster": [("--h 0.12", "--h 0.3"), ("count = 4", "count = 1"), ("-steps_count 2", "-steps_count 1")],
}  # fmt: skip
# what a page leaves behind, beside pictures
LEFT = {"press": "press_results/report.json", "friction": "energy_results/history.csv", "imprint": "imprint.jpg",
        "self_contact": "seal.gif", "deck": "finer/results/report.json", "study": "study/stopped/report.json",
        "cluster": "results/checkpoint.h5"}  # fmt: skip


@pytest.fixture(autouse=True)
def drawing(monkeypatch):
    """Pictures need no display."""
    pytest.importorskip("pyvista")
    monkeypatch.setenv("MPLBACKEND", "agg")


@pytest.mark.slow
def test_five_minutes(tmp_path, capfd):
    page = DOCS / "quick.md"
    assert [kind for kind, _ in blocks(page)] == ["sh", "sh", "python"]
    run_page(page, tmp_path)
    for name in ("pressure.png", "force.png", "pressed.gif", "pressed.html", "stress.png"):
        assert (tmp_path / "first" / name).stat().st_size > 1000
    said = capfd.readouterr().out
    forces = [float(line.split()[-1]) for line in said.splitlines() if line.startswith("coefficient")]
    assert len(forces) == 4 and abs(forces[0]) < 1e-3 * forces[1] and forces == sorted(forces)
    assert re.search(r"times 1167", page.read_text()) and "-1166.8 " in said


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(path.stem for path in (DOCS / "tutorials").glob("*.md")))
def test_tutorial(name, tmp_path):
    run_page(DOCS / "tutorials" / f"{name}.md", tmp_path, COARSER[name])
    assert (tmp_path / LEFT[name]).stat().st_size > 0
