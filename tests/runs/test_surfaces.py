"""Contacts that say two surfaces: which one is the source, whatever the order, and what is refused."""

import json
from dataclasses import replace
from functools import partial

import gmsh
import numpy as np
import pytest

import pcontact as pc
from meshes.blocks import two_blocks
from meshes.tools import finish, gmsh_model, group
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD
NAMES = "upper_bottom", "lower_top"


class Last(Observer):
    """Observer: the record of the last load step."""

    def step(self, step, u, record):
        self.record = record


def scene(path, surfaces, young=(1.0, 1.0), **more):
    """Two blocks, the lower one first, pressed and sheared."""
    return Scene(
        mesh=MeshSpec(path),
        materials={name: Material(E, 0.3) for name, E in zip(("a", "b"), young, strict=True)},
        bodies=[Body("lower", "a"), Body("upper", "b")],
        contacts=[Contact(surfaces=surfaces, friction=0.3, **more)],
        displacements=[Displacement("upper_top", [0.001, -0.01]), Displacement("lower_bottom", [0.0, 0.0])],
        output=Output(fields=False),
        petsc={"snes_rtol": "1e-11", "ksp_rtol": "1e-12"},
    )


def run(scene):
    """The report of the contact in the last load step. Collective."""
    last, simulation = Last(), Simulation(scene)
    try:
        assert simulation.run(None, [last])
    finally:
        simulation.close()
    ((name, contact),) = last.record["contacts"].items()
    return name, contact


@pytest.mark.parallel
@pytest.mark.parametrize(("young", "traction", "source"), [
    ((1.0, 100.0), "both", "upper_bottom"), ((100.0, 1.0), "both", "upper_bottom"),
    ((1.0, 100.0), "source", "lower_top"), ((100.0, 1.0), "source", "upper_bottom"),
    ((1.0, 1.2), "source", "upper_bottom"),
])  # fmt: skip
def test_the_order_does_not_matter(shared_tmp, young, traction, source):
    """The finer side is the source; where its stress alone counts, the softer one."""
    path = shared_tmp / "b.msh"
    on_root(WORLD, partial(two_blocks, path, 2, 4, 7, widths=(1.6, 1.0)))
    (one, first), (other, second) = (run(scene(path, some, young, traction=traction)) for some in (NAMES, NAMES[::-1]))
    assert (one, other) == ("upper_bottom-lower_top", "lower_top-upper_bottom")
    assert first["source"] == second["source"] == source
    np.testing.assert_allclose(first["force"], second["force"], atol=1e-9 * np.abs(first["force"]).max())


@pytest.mark.parametrize(("more", "found"), [
    ({"source": "upper_bottom", "target": "other"}, "together with source or target"),
    ({"all": True}, "together with all"),
    ({"surfaces": ["lower_top"], "source": "lower_top", "target": "upper_bottom"}, "two names"),
])  # fmt: skip
def test_what_is_refused(tmp_path, more, found):
    path = two_blocks(tmp_path / "b.msh", 2, 2)
    case = scene(path, list(NAMES))
    case.contacts = [Contact(**{"surfaces": list(NAMES), **more})]
    with pytest.raises(InputError) as caught:
        Simulation(case)
    assert found in str(caught.value)


def test_in_a_file(tmp_path):
    """Source and target need not be said; names, `check` and the report know the two."""
    two_blocks(tmp_path / "b.msh", 2, 4, 7)
    text = f"""
[mesh]
file = "b.msh"
[materials.m]
E = 1.0
nu = 0.3
[[bodies]]
region = "lower"
material = "m"
[[bodies]]
region = "upper"
material = "m"
[[contacts]]
surfaces = {json.dumps(NAMES[::-1])}
[[displacements]]
region = "upper_top"
value = [0, -0.01]
[[displacements]]
region = "lower_bottom"
value = [0, 0]
"""
    (tmp_path / "scene.toml").write_text(text)
    result = pc.run(pc.read(tmp_path / "scene.toml"))
    assert result.report["steps"][-1]["contacts"]["lower_top-upper_bottom"]["source"] == "upper_bottom"
    assert result.report["steps"][-1]["contacts"]["lower_top-upper_bottom"]["force"][1] < 0.0


def roofs(path, lower, tip=0.25):
    """A body of height 2 below y = 0, its top flat or with a ridge, and a square above that stands on a corner."""
    with gmsh_model("roofs"):
        occ, line = gmsh.model.occ, []
        ridge = [(4.0, 0.0)] if lower == "ridge" else []
        below = [(0.0, -2.0), (8.0, -2.0), (8.0, -1.5 if ridge else 0.0), *ridge, (0.0, -1.5 if ridge else 0.0)]
        for corners in (below, [(4.0, 0.0), (5.0, 1.0), (4.0, 2.0), (3.0, 1.0)]):
            points = [occ.addPoint(*xy, 0.0) for xy in corners]
            line.append([occ.addLine(a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)])
        bodies = [occ.addPlaneSurface([occ.addCurveLoop(lines)]) for lines in line]
        occ.synchronize()
        for name, body in zip(("lower", "upper"), bodies, strict=True):
            group(2, name, [body])
        group(1, "lower_bottom", line[0][:1])
        group(1, "lower_top", line[0][2:-1])
        group(1, "upper_bottom", [line[1][0], line[1][3]])
        group(1, "upper_top", line[1][1:3])
        for name, lines in (("lower", line[0]), ("upper", line[1])):
            for one in lines:
                length = gmsh.model.occ.getMass(1, one)
                gmsh.model.mesh.setTransfiniteCurve(one, round(length / (0.2 if name == "lower" else tip)) + 1)
        return finish(path, 2, 1)


@pytest.mark.parallel
@pytest.mark.parametrize("lower", ["flat", "ridge"])
def test_corners_are_on_the_source(shared_tmp, lower):
    """A square that stands on its corner, of coarser facets; on a ridge the contact is unbiased."""
    path = shared_tmp / "r.msh"
    on_root(WORLD, partial(roofs, path, lower))
    case = scene(path, NAMES)
    case.contacts[0].friction = None
    name, found = run(case)
    other = run(replace(case, contacts=[Contact(*NAMES, unbiased=True)]))[1]
    assert name == "upper_bottom-lower_top"
    if lower == "flat":
        assert found["source"] == "upper_bottom"
        assert found["force"][1] == pytest.approx(other["force"][1], rel=0.02)
    else:
        assert abs(found["force"][1]) == pytest.approx(abs(other["force"][1]), rel=1e-6)
    assert found.get("target_penetration", 0.0) <= 2.0 * found["max_penetration"]
