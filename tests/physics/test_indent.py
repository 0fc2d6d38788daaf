"""A ball pressed into an elastoplastic block and taken off: forces, imprint, iterations, ranks."""

import numpy as np
import pytest

from drivers._common import make_mesh
from drivers.cases import indent
from meshes import indent as indent_mesh
from pcontact.runtime.petsc import MPI
from pcontact.simulation import Simulation

pytestmark = pytest.mark.slow
WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
H = {2: 0.05, 3: 0.125}


def mesh(folder, dim=2, h=None, order=1, cell=None, ball=False, length=5.0):
    radius = indent.RADIUS if ball else None
    return make_mesh(indent_mesh, folder / "indent.msh", dim, h or H[dim], order, cell, radius=radius, length=length)


def press(path, dim=2, comm=WORLD, good=True, **said):
    """Rows and the final surface (rank 0). Collective on `comm`."""
    case = indent.scene(path, dim, **said)
    watch = indent.Press(case, said.get("depth", indent.DEPTH))
    simulation = Simulation(case, comm)
    try:
        assert simulation.run(None, [watch]) == good
        return watch.rows, indent.surface(simulation)
    finally:
        simulation.close()


def test_way_of_the_ball():
    table, count = indent.path_of(4, 2, 0.2)
    assert count == 7 and table[0] == (0.0, 0.0) and table[4] == (4.0, 1.0)
    assert [time for time, _ in table] == [0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 7.0]
    assert table[5][1] == pytest.approx(0.8) and table[6][1] == pytest.approx(0.7)
    assert indent.path_of(4, 0, 0.2)[1] == 4


@pytest.mark.parametrize(("depth", "tolerance"), [(indent.DEPTH, 0.03), (0.25 * indent.DEPTH, 0.015)])
def test_elastic_is_hertz_and_leaves_nothing(tmp_path, depth, tolerance):
    """Hertz's ball is shallow: the difference is about a third of contact radius over radius."""
    path = mesh(tmp_path, h=0.0125, length=40.0)
    elastic = indent.metal(0.0)
    rows, top = press(path, material=elastic, depth=depth, friction=0.0, steps=4, unload=2, back=0.9)
    force, radius = indent.hertz(depth, indent.RADIUS)
    assert rows[3]["force"] == pytest.approx(force, rel=tolerance)
    assert rows[3]["radius"] == pytest.approx(radius, rel=0.05)
    assert rows[-1]["force"] == 0.0
    assert np.abs(top[:, 1]).max() < 1e-6 * depth


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize(("cell", "order"), [("quadrilateral", 1), ("quadrilateral", 2), ("triangle", 2)])
def test_fully_plastic(tmp_path, cell, order, friction):
    """Mean pressure of about three yield stresses, an imprint nearly as deep as the ball went, no load step cut."""
    rows, top = press(mesh(tmp_path, order=order, cell=cell), order=order, friction=friction, steps=8)
    full = rows[7]
    assert 2.6 < full["over_yield"] < 3.4
    assert sum(row["cutbacks"] for row in rows[:8]) == 0
    assert max(row["imbalance"] for row in rows) < 1e-6
    assert full["slip"] == 0 if friction == 0.0 and full["stick"] else full["stick"] + full["slip"] > 0
    # unloading stiffer than loading; no force is left
    assert rows[8]["force"] < 0.75 * full["force"]
    assert rows[-1]["force"] == 0.0
    assert 0.78 * indent.DEPTH < -top[0, 1] < 0.9 * indent.DEPTH
    assert top[:, 1].max() > 0.05 * indent.DEPTH


@pytest.mark.parametrize("source", ["block", "ball"])
def test_elastic_ball(tmp_path, source):
    """Softer than the rigid one; either side may be the source."""
    keys = {"friction": 0.3, "steps": 6, "unload": 0}
    rigid, _ = press(mesh(tmp_path), **keys)
    rows, _ = press(mesh(tmp_path, ball=True), ball=indent.E_MODULUS, source=source, **keys)
    assert 0.75 * rigid[-1]["force"] < rows[-1]["force"] < 0.95 * rigid[-1]["force"]
    assert sum(row["cutbacks"] for row in rows) == 0


def test_hardening(tmp_path):
    """More hardening, more force; the kinematic kind is the isotropic one while the load grows."""
    path = mesh(tmp_path)
    forces = []
    for isotropic, kinematic in ((0.0, 0.0), (3000.0, 0.0), (0.0, 3000.0)):
        material = indent.metal(hardening=isotropic, kinematic=kinematic)
        forces.append(press(path, material=material, steps=6, unload=0)[0][-1]["force"])
    assert forces[1] > 1.05 * forces[0]
    assert forces[2] == pytest.approx(forces[1], rel=0.05)


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize(("dim", "friction"), [(2, 0.0), (2, 0.3), (3, 0.3)])
def test_ranks_do_not_matter(shared_tmp, dim, friction):
    """Force and imprint of one rank, down and up again."""
    path, said = mesh(shared_tmp, dim), {"friction": friction, "steps": 4, "unload": 2}
    # inexact linear solves would make Newton's path another on every number of ranks
    tight = {"snes_rtol": "1e-11", "snes_ksp_ew": "false", "ksp_rtol": "1e-10"}
    one, first = press(path, dim, SELF, petsc=tight, **said)
    WORLD.Barrier()
    all_, other = press(path, dim, WORLD, petsc=tight, **said)
    for a, b in zip(one, all_, strict=True):
        assert [b[key] for key in ("open", "stick", "slip")] == [a[key] for key in ("open", "stick", "slip")]
        assert b["force"] == pytest.approx(a["force"], abs=1e-7 * max(row["force"] for row in one))
    if WORLD.rank == 0:
        assert other[:, 1].min() == pytest.approx(first[:, 1].min(), abs=1e-7 * indent.DEPTH)
