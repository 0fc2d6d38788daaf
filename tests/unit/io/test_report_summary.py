"""The last lines of a run."""

import math

from pcontact.io.report import summary


def report(**more):
    pair = {"force": [0.0, -2.5], "max_pressure": 3.0, "max_penetration": 1e-4, "open": 0}
    steps = [{"time": 1.0, "contacts": {"a": {**pair, "max_pressure": 7.0}}}, {"time": 2.0, "contacts": {"a": pair}}]
    return {"steps": steps, "converged": True, "warnings": [], "timing": {"total": 1.5}, "memory": {}, **more}


def test_a_contact_area_of_few_facets():
    """Of those that are closed at the largest pressure; all of a surface, and a named error, need no word."""
    pair = {"force": [0.0, -2.5], "max_pressure": 7.0, "max_penetration": 1e-4, "open": 3, "facets": 4}
    less = {**pair, "max_pressure": 3.0, "facets": 20}

    def lines(one, **more):
        steps = [{"time": 1.0, "contacts": {"a": one}}, {"time": 2.0, "contacts": {"a": less}}]
        return [line for line in summary(report(steps=steps, **more), "out") if "not resolved" in line]

    (line,) = lines(pair)
    assert "a: the contact area is about 4 facets across" in line and "-error_of pressure:a" in line
    assert "about 4 facets across" in lines({**pair, "force": [0.0, 0.0, -1.0], "facets": 16})[0]
    assert not lines({**pair, "open": 0}) and not lines({**pair, "facets": 6})
    assert not lines({**pair, "force": [0.0, 0.0, -1.0], "facets": 36}) and not lines(pair, accuracy={"target": {}})


def test_parts_of_a_force():
    pair = {"force": [0.6, -2.5], "max_pressure": 7.0, "max_penetration": 1e-4, "open": 0, "normal_force": [0.0, -2.5],
            "friction_force": [0.6, 0.0], "centre": [0.25, -0.0]}  # fmt: skip

    def line(**more):
        return summary(report(steps=[{"time": 1.0, "contacts": {"a": {**pair, **more}}}]), "out")[1]

    assert "force 0.6 -2.5 (normal 2.5, friction 0.6, at 0.25 0)," in line()
    assert "(normal 2.5, at 0.25 0)," in line(friction_force=[0.0, 0.0])
    assert "(" not in line(centre=[None, None]).partition(", largest")[0]
    assert "(" not in line(centre=[math.nan] * 2).partition(", largest")[0]


def test_the_largest_values_and_their_places():
    step = {"time": 1.0, "largest": {
        "displacement": {"value": 0.5, "place": [1.0, -0.0], "body": "lid"},
        "equivalent_stress": {"value": 2.0, "place": [0.25, 2.0], "body": "box"},
    }}  # fmt: skip
    line = summary(report(steps=[step]), "out")[1]
    assert line == "  largest equivalent stress 2 in box at (0.25, 2); displacement 0.5 in lid at (1, 0)"
    step["largest"]["displacement"]["value"] = 0.0
    assert "all displacements are 0" in summary(report(steps=[step]), "out")[1]


def test_what_came_out_and_where_it_is():
    first, pair, last = summary(report(), "out")
    assert first == "done: 2 load steps to time 2 in 1.5 s"
    assert "force 0 -2.5" in pair and "largest pressure 3 (of all load steps 7)" in pair
    assert "pcontact view out" in last
    lines = summary(report(converged=False, warnings=["w"], memory={"read": {"peak_mb_largest": 12.0}}), "out")
    assert lines[0].startswith("ended early") and "12 MB" in lines[0] and "1 warning, above" in lines[2]
    compiled = report(timing={"total": 9.5, "compile": 8.25})
    assert summary(compiled, "out")[0] == "done: 2 load steps to time 2 in 9.5 s (8.2 s of it compiled kernels, once)"
    took = {"total": 9.5, "compile": 8.25, "kernels_mb": 143.2}
    compiled = report(timing=took, memory={"a": {"peak_mb_largest": 340.0}})
    assert summary(compiled, "out")[0].endswith("once), 340 MB on the largest rank (143 MB of it for kernels)")
    assert "no load step converged" in summary(report(steps=[], converged=False), "out")[0]
    assert "no load step was left after the checkpoint" in summary(report(steps=[]), "out")[0]
