"""The last lines of a run."""

from pcontact.io.summary import summary


def report(**more):
    pair = {"force": [0.0, -2.5], "max_pressure": 3.0, "max_penetration": 1e-4}
    steps = [{"time": 1.0, "contacts": {"a": {**pair, "max_pressure": 7.0}}}, {"time": 2.0, "contacts": {"a": pair}}]
    return {"steps": steps, "converged": True, "warnings": [], "timing": {"total": 1.5}, "memory": {}, **more}


def test_what_came_out_and_where_it_is():
    first, pair, last = summary(report(), "out")
    assert first == "done: 2 load steps to time 2 in 1.5 s"
    assert "force 0 -2.5" in pair and "largest pressure 3 (of all load steps 7)" in pair
    assert "pcontact view out" in last
    lines = summary(report(converged=False, warnings=["w"], memory={"read": {"peak_mb_largest": 12.0}}), "out")
    assert lines[0].startswith("ended early") and "12 MB" in lines[0] and "1 warnings" in lines[2]
    compiled = report(timing={"total": 9.5, "compile": 8.25})
    assert summary(compiled, "out")[0] == "done: 2 load steps to time 2 in 9.5 s (8.2 s of it compiled kernels, once)"
    assert "no load step converged" in summary(report(steps=[]), "out")[0]
