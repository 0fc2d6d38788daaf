"""The verification manual: cases hold on their coarsest meshes, misses are seen, pages are those of the driver."""

from pathlib import Path

import pytest

import drivers
from drivers.studies._manual import need
from drivers.studies.verification import CASES, OVERVIEW, overview_row, page, verify

PAGES = Path(drivers.__path__[0]).parent / "docs" / "verification"
# those of a second
QUICK = [name for name, case in CASES.items() if case.tiny]


@pytest.mark.slow
@pytest.mark.parallel(2)
@pytest.mark.parametrize("name", QUICK)
def test_coarsest_mesh(shared_tmp, name):
    rows, held = verify(name, shared_tmp, tiny=True)
    assert held and len(rows) == 1


@pytest.mark.parametrize("value, holds", [(1.004, True), (0.99, False), (None, False)])
def test_a_miss_is_seen(tmp_path, monkeypatch, value, holds):
    case = CASES["shrink_fit"]

    def solve(folder, level):
        need(value is not None)
        return value * case.reference

    monkeypatch.setitem(CASES, "shrink_fit", case._replace(solve=solve))
    assert verify("shrink_fit", tmp_path, tiny=True)[1] is holds


@pytest.mark.parametrize("name", CASES)
def test_pages_are_those_of_the_cases(name):
    """All but the numbers of the table, of which there is one row for each mesh."""
    text = (PAGES / f"{name}.md").read_text()

    def words(text):
        return [line for line in text.splitlines() if not line.startswith("| ") or line.startswith("| n")]

    assert words(page(name, [])) == words(text)
    assert len([line for line in text.splitlines() if line.startswith("| ")]) == 1 + len(CASES[name].levels)


def test_the_overview_links_all_cases():
    """The row of docs/index.md is the one that --publish writes."""
    rows = [line for line in (PAGES.parent / "index.md").read_text().splitlines() if line.startswith(OVERVIEW)]
    assert rows == [overview_row()]


@pytest.mark.parametrize("name", CASES)
def test_pictures_are_small(name):
    assert 0 < (PAGES / f"{name}.png").stat().st_size < 40_000
