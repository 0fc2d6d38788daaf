"""Comparison of the formulations: what is measured, and what each of them is good for on one mesh."""

from types import SimpleNamespace

import numpy as np
import pytest

from drivers._common import make_directory, parse
from drivers.cases import cattaneo_mindlin as mindlin
from drivers.cases.hertz import generate
from drivers.studies._compare_report import causes
from drivers.studies.compare import (
    CASE,
    FRICTION,
    MARK,
    METHODS,
    make_options,
    measure,
    measure_sheared,
    run,
    solve,
)
from pcontact.runtime.errors import InputError

pytestmark = pytest.mark.slow
RECORD = {"contacts": {"pair": {"force": [0.0, -0.5 * CASE.force]}}, "probes": {CASE.driven: {"mean": [0.0, -0.1]}}}


def test_hertz_has_no_error():
    a, p0 = CASE.from_force(CASE.force)
    x = np.linspace(0.0, 1.5 * a, 3001)
    pressure = p0 * np.sqrt(np.maximum(1.0 - (x / a) ** 2, 0.0))
    points = {"x": np.column_stack([x, 0.0 * x]), "pressure": pressure, "weight": np.full(len(x), x[1]),
              "status": 2 * (pressure > 0), "gap": np.where(pressure > 0, -0.002, 0.1)}  # fmt: skip
    found = measure(points, RECORD)
    assert found["penetration"] == pytest.approx(0.02)
    assert max(found["error"], found["oscillation"], found["balance"]) < 1e-10
    wavy = {**points, "pressure": pressure * (1.0 + 0.1 * np.sign(np.sin(300.0 * x)))}
    found = measure(wavy, RECORD)
    assert found["error"] == pytest.approx(0.1, rel=1e-3) and 0.05 < found["oscillation"] < 0.1


def test_cattaneo_has_no_error():
    load = mindlin.CASE.force
    a, p0 = mindlin.CASE.from_force(load)
    x = np.linspace(-1.5 * a, 1.5 * a, 6001)
    tangential = mindlin.closed_form(x, load, mindlin.FORCE, FRICTION)[2]
    points = {"x": x, "pressure": p0 * np.sqrt(np.maximum(1.0 - (x / a) ** 2, 0.0)), "tangential": tangential,
              "weight": np.full(len(x), x[1] - x[0])}  # fmt: skip
    record = {"reactions": {"upper_flat": [0.0, -load]}, "contacts": {"skins": {"force": [mindlin.FORCE, -load]}}}
    assert max(measure_sheared(points, record).values()) < 1e-10
    wavy = {**points, "tangential": tangential * (1.0 + 0.1 * np.sign(np.sin(300.0 * x)))}
    found = measure_sheared(wavy, record)
    assert found["tangential"] == pytest.approx(0.1, rel=1e-3) and 0.05 < found["ripple"] < 0.1
    assert found["oscillation"] < 1e-10


def test_formulations_with_friction(tmp_path):
    """All balance; the pressure of the penalty method oscillates more than that of Nitsche's at the same gamma0."""
    fine = SimpleNamespace(h=mindlin.CASE.half_width / 5, order=1)
    mesh = mindlin.generate(tmp_path / "cylinders.msh", fine)
    rows = {name: solve(mesh, name, 1.0, 1, True) for name in ("theta 0", "penalty")}
    assert all(row["converged"] and row["balance"] < 1e-7 and row["tangential"] < 0.4 for row in rows.values())
    assert rows["penalty"]["oscillation"] > 1.2 * rows["theta 0"]["oscillation"]


@pytest.mark.parallel(2, 3)
def test_formulations_on_one_mesh(shared_tmp):
    """Forces balance in all; multipliers do away with the penetration of the penalty method, at a better pressure."""
    mesh = generate(CASE, shared_tmp / "cylinder.msh", CASE.half_width / 5, 1)
    rows = {name: solve(mesh, name, 1.0, 1) for name in METHODS}
    for row in rows.values():
        assert 1e3 < row["condition"] < 1e6
        assert row["converged"] and row["balance"] < 1e-7 and row["error"] < 0.15
    deep = {name: row["penetration"] for name, row in rows.items()}
    assert deep["penalty"] > 5.0 * deep["theta 0"] > 4.0 * deep["augmented"]
    assert rows["augmented"]["error"] < rows["theta 0"]["error"] < rows["penalty"]["error"] * 1.1
    assert 0 < rows["augmented"]["updates"] < 15


def test_tiny(tmp_path):
    args = parse(make_options(), ["--tiny", "-o", str(tmp_path / "out")])
    make_directory(args.o)
    assert run(args) == 0
    args.publish = paper = tmp_path / "paper.md"
    paper.write_text(f"# Head\n\n{MARK}\n\nold")
    assert run(args) == 0
    assert (args.o / "compare.json").exists()
    for name in ("formulations_1.png", "formulations_1_effort.png"):
        assert 1000 < (args.o / name).stat().st_size < 150_000
    text = paper.read_text()
    assert text.startswith("# Head") and "formulations_1.png" in text and "old" not in text
    assert (tmp_path / "formulations_1_effort.png").exists() and "| penalty | 5 |" in text
    with pytest.raises(InputError, match="--decades"):
        run(parse(make_options(), ["--decades", "0"]))


@pytest.mark.parallel(2, 3)
def test_what_fails_is_a_row_with_its_cause(shared_tmp):
    mesh = generate(CASE, shared_tmp / "cylinder.msh", CASE.half_width / 3, 1)
    row = solve(mesh, "penalty", -1.0, 1)
    assert not row["converged"] and "gamma0" in row["cause"] and np.isnan(row["error"])
    row.update(order=1, facets=3)
    assert causes([row])[0].startswith("penalty, gamma0 -1, 3 facets of degree 1: refused")
