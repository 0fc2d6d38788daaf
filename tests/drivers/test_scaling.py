"""Scaling driver: rows of several runs come together, efficiencies, and a small run; phases of a profile."""

import json

import numpy as np
import pytest

from drivers._common import parse
from drivers.studies._press import CASES
from drivers.studies._scaling import PHASES, efficiencies, plot, series
from drivers.studies.scaling import keep, load, make_options, merged, run, sizes_of
from pcontact.runtime import profile
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI

pytestmark = pytest.mark.slow
WORLD = MPI.COMM_WORLD


def row(ranks, size, case="elastic", solve=1.0, converged=True, cells="tetrahedra"):
    """A row with what the series look at."""
    seconds = {"solve": solve}
    return {"ranks": ranks, "size": size, "cells": cells, "case": case, "converged": converged, "seconds": seconds}


def test_rows_come_together():
    old = [row(2, 1000, solve=9.0), row(1, 1000), row(1, 1000, "plastic")]
    rows = merged(old, [row(2, 1000, solve=3.0), row(4, 500)])
    assert [(r["case"], r["size"], r["ranks"]) for r in rows] == [
        ("elastic", 500, 4), ("elastic", 1000, 1), ("elastic", 1000, 2), ("plastic", 1000, 1),
    ]  # fmt: skip
    assert rows[2]["seconds"]["solve"] == 3.0


def test_efficiencies():
    rows = [row(1, 1000, solve=8.0), row(2, 1000, solve=5.0), row(2, 2000, solve=10.0), row(4, 1000, solve=1.0)]
    rows.append(row(8, 1000, converged=False))
    strong, weak = series(rows, False), series(rows, True)
    assert list(strong) == [("elastic", 1000)] and list(weak) == [("elastic", 1000)]
    assert efficiencies(strong["elastic", 1000], False) == pytest.approx([1.0, 0.8, 2.0])
    assert efficiencies(weak["elastic", 1000], True) == pytest.approx([1.0, 0.8])


@pytest.mark.parametrize(
    "words, expected", [([], [20_000]), (["--unknowns", "5000", "2000"], [2000, 5000]),
                        (["--per-rank", "1000", "--unknowns", "4000"], [3000, 4000]), (["--tiny"], [1500])]
)  # fmt: skip
def test_sizes(words, expected):
    assert sizes_of(parse(make_options(), words), 3) == expected


def test_refuses_sizes():
    with pytest.raises(InputError, match="--per-rank: found 10, allowed"):
        sizes_of(parse(make_options(), ["--per-rank", "10"]), 1)


def test_refuses_other_files(tmp_path):
    assert load(tmp_path / "scaling.json") == []
    (tmp_path / "scaling.json").write_text('{"steps": []}')
    with pytest.raises(InputError, match="allowed: a file that this driver wrote"):
        load(tmp_path / "scaling.json")


@pytest.mark.parallel(2, 3)
def test_small_run(shared_tmp):
    """A row of this run stands beside one of another number of ranks, with all that it promises."""
    path = shared_tmp / "scaling.json"
    args = parse(make_options(), ["--tiny", "--cases", "frictional", "-o", str(shared_tmp)])
    assert run(args) == 0
    rows = load(path)
    assert len(rows) == 1
    mine = rows[0]
    assert mine["ranks"] == WORLD.size and mine["case"] in CASES and mine["converged"]
    assert mine["unknowns"] == pytest.approx(1500, rel=0.1)
    assert set(PHASES) < set(mine["seconds"]) and min(mine["seconds"].values()) >= 0.0
    assert mine["seconds"]["krylov"] > 0.0 and mine["seconds"]["preconditioner"] > 0.0
    parts = sum(value for name, value in mine["seconds"].items() if name not in ("solve", "total"))
    # of one rank they are the whole; the slowest ranks of each phase together take longer
    assert parts > 0.9 * mine["seconds"]["total"]
    assert mine["candidates_per_point"] > 0.0 and mine["imbalance"]["contact"] >= 1.0
    assert (mine["messages"] > 0) == (mine["bytes"] > 0) == (WORLD.size > 1)
    other = {**mine, "ranks": WORLD.size + 1}
    rows = keep(path, other)
    plot(shared_tmp / "two.png", rows)
    WORLD.Barrier()
    assert [r["ranks"] for r in rows] == [WORLD.size, WORLD.size + 1]
    assert json.loads(path.read_text())["rows"] == rows and (shared_tmp / "two.png").exists()


class Clock:
    """Goes on only when told to."""

    now = 0.0

    def perf_counter(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


def test_phases_nest(monkeypatch):
    """A phase does not count what an inner one takes, also when an error ends them; together they are the whole."""
    clock = Clock()
    monkeypatch.setattr(profile, "clock", clock)
    record = profile.Profile()
    with profile.recording(record):
        clock.sleep(1.0)
        with pytest.raises(ValueError), profile.phase("search"):
            clock.sleep(2.0)
            with profile.phase("exchange"):
                clock.sleep(4.0)
                profile.sent(2, 100)
                raise ValueError
        with profile.phase("solve"):
            clock.sleep(8.0)
            profile.sent(1, 10)
            profile.count(points=3)
            profile.count(points=4)
    with profile.phase("search"):
        clock.sleep(16.0)
    seconds = record.phases()
    assert sum(seconds.values()) == 15.0
    assert (seconds["search"], seconds["exchange"]) == (2.0, 4.0)
    assert seconds["preconditioner"] + seconds["krylov"] == 8.0
    assert record.sent == {"search": [2, 100], "solve": [1, 10]} and record.counts == {"solve": {"points": 7}}


@pytest.mark.parallel(2, 3)
def test_largest_and_sum():
    largest, total = profile.largest_and_sum(WORLD, ("a", "b"), {"a": WORLD.rank})
    assert largest == {"a": WORLD.size - 1, "b": 0.0}
    assert total == {"a": np.arange(WORLD.size).sum(), "b": 0.0}
