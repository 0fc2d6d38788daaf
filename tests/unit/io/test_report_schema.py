"""The schema of report.json, and that forces with axial symmetry are called what they are."""

import json

import numpy as np
import pytest

import pcontact as pc
from drivers._common import make_mesh
from meshes import one_block
from pcontact.io.report import summary
from pcontact.io.report_schema import described, report_schema, unknown


@pytest.fixture(scope="module")
def ring(tmp_path_factory):
    """A ring pressed on a rigid plane, and widened by an inner support."""
    path = tmp_path_factory.mktemp("ring") / "ring.msh"
    make_mesh(one_block, path, 2, (3, 3), size=[1.0, 1.0], lower=[2.0, 0.0])
    return pc.run(pc.from_dict({
        "mesh": {"file": str(path), "kinematics": "axisymmetric"}, "materials": {"m": {"E": 100.0, "nu": 0.25}},
        "bodies": [{"region": "block", "material": "m"}],
        "contacts": [{"name": "ground", "source": "bottom",
                      "obstacle": {"shape": "plane", "point": [0.0, 0.0], "normal": [0.0, 1.0]}}],
        "displacements": [{"region": "top", "value": ["free", -0.01]}, {"region": "left", "value": [0.02, "free"]}],
        "steps": {"count": 2}, "output": {"probes": ["right"]},
    }))  # fmt: skip


def test_reports_are_what_the_schema_says(ring):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(json.dumps(report_schema()))
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    report = json.loads(json.dumps(ring.report))
    assert not list(validator.iter_errors(report)) and not unknown(report)
    for change in ({"format": 1}, {"converged": "yes"}, {"steps": [{"time": "soon"}]}, {"dofs": 1.5}):
        assert list(validator.iter_errors({**report, **change})), change
    assert unknown({**report, "colour": 1}) == ["colour"]
    lacking = {**report, "steps": [{**report["steps"][0], "contacts": {"a": {}}}]}
    assert unknown(lacking)[0] == "steps.[].contacts.a.force is missing"


def test_every_key_is_described():
    keys = dict(described())
    assert len(keys) > 100 and all(keys.values()) and "steps[].contacts.NAME.max_pressure" in keys


def test_forces_of_the_whole_circumference(ring):
    """The inner support widens the ring: its radial forces sum up to that of the stresses; the axial one balances."""
    assert ring.report["forces"] == {"per": "whole circumference", "components": ["radial_sum", "axial_force"]}
    assert ring.report["status"] == ["open", "stick", "slip"]
    step, contact = ring.steps[-1], ring.steps[-1]["contacts"]["ground"]
    assert contact["axial_force"] == contact["force"][1] and contact["radial_sum"] == contact["force"][0]
    assert contact["axial_force"] == pytest.approx(step["reactions"]["top"][1], rel=1e-9)
    assert step["radial_sums"] == {name: force[0] for name, force in step["reactions"].items()}
    assert step["radial_sums"]["left"] > 0.0 and "contacts.ground.axial_force" in ring.history
    points = ring.contact["ground"]
    assert points.weight.sum() == pytest.approx(np.pi * (3.0**2 - 2.0**2), rel=1e-9)
    assert -contact["axial_force"] == pytest.approx(np.sum(points.pressure * points.weight), rel=1e-9)
    # without friction closed points slip, and the normal points from the ring to the plane
    assert set(points.status_names) == {"slip"} and np.all(points.normal == [0.0, -1.0])
    assert "axial force -" in summary(ring.report, "out")[1] and "radial sum" in summary(ring.report, "out")[1]
