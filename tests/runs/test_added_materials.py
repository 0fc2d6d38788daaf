"""Runs of materials with a law that a program has added: in bodies, in the traction at contact, in energy."""

from dataclasses import replace

import numpy as np
import pytest

import pcontact as pc
from meshes.blocks import one_block, two_blocks
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Material,
    MeshSpec,
    Output,
    Scene,
    Steps,
    Temperature,
)
from pcontact.simulation import Simulation
from tests.support.point_laws import add_all, remove_all
from tests.support.records import Log
from tests.support.restarts import STOP, Keep
from tests.support.restarts import run as resumed

WORLD = MPI.COMM_WORLD
YOUNG, POISSON, LIMIT, HARDENING = 1000.0, 0.3, 4.0, 100.0
KNOWN = Material(YOUNG, POISSON, yield_stress=LIMIT, hardening=HARDENING)
ADDED = Material(YOUNG, POISSON, law="mises", parameters=[LIMIT, HARDENING])
TIGHT = {"snes_rtol": "1e-12"}


@pytest.fixture(autouse=True)
def added():
    add_all()
    yield
    remove_all()


def solved(scene, comm=WORLD):
    """Displacement of the nodes by their number in the file, stress of cells, and records. *Collective.*"""
    simulation, records = Simulation(scene, comm), Log()
    try:
        assert simulation.run(None, [records])
        space, u = simulation.problem.space, simulation.stepper.u
        numbers = space.mesh.file_nodes[space.mesh_nodes[space.owned_local]]
        values = u.getArray(readonly=True).reshape(-1, space.dim).copy()
        stress = np.concatenate([one for one, _ in simulation.problem.bulk.stress(u)])
        ids = np.concatenate([block.ids for block in space.mesh.blocks])
        rows, values, ids, stress = (np.concatenate(comm.allgather(x)) for x in (numbers, values, ids, stress))
        return values[np.argsort(rows)], stress[np.argsort(ids)], records
    finally:
        simulation.close()


def pressed(path, material, dim, kinematics, **contact):
    """A block pressed on another one with friction, both of a material."""
    down = [0.0] * (dim - 1)
    aside = [0.02, 0.0][: dim - 1] if kinematics != "axisymmetric" else down
    return Scene(
        mesh=MeshSpec(path, kinematics=kinematics),
        materials={"m": material},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact("upper_bottom", "lower_top", name="pair", friction=0.3, **contact)],
        displacements=[Displacement("lower_bottom", [0.0] * dim), Displacement("upper_top", [*aside, -0.03])],
        steps=Steps(count=3),
        output=Output(fields=False, energy=True),
        petsc=TIGHT,
    )


@pytest.mark.parallel(2, 3)
@pytest.mark.parametrize("case", ["plane_strain", "plane_stress", "axisymmetric", "space", "consistent"])
def test_von_mises_written_anew(shared_tmp, case):
    """Contact of bodies that yield is that of the law in the package: displacement, stress, forces, energy."""
    dim = 3 if case == "space" else 2
    kinematics = case if case in ("plane_stress", "axisymmetric") else "plane_strain"
    path, n = shared_tmp / "blocks.msh", 2 if dim == 3 else 3
    on_root(WORLD, two_blocks, path, dim, n, n + 1, "hexahedron" if dim == 3 else "quadrilateral")
    more = {"theta": 1.0, "adjoint": "consistent"} if case == "consistent" else {}
    (u, stress, records), (known_u, known_stress, known) = (
        solved(pressed(path, material, dim, kinematics, **more)) for material in (ADDED, KNOWN)
    )
    size = np.abs(known_stress).max()
    np.testing.assert_allclose(u, known_u, atol=1e-8 * np.abs(known_u).max())
    np.testing.assert_allclose(stress, known_stress, atol=1e-7 * size)
    last, expected = records.records[-1], known.records[-1]
    assert expected["plastic"]["max_equivalent_strain"] > 0.005
    for section in ("plastic", "energy"):
        for key, value in expected[section].items():
            if isinstance(value, float) and key != "defect":
                assert last[section][key] == pytest.approx(value, rel=1e-6, abs=1e-9), key
    assert last["contacts"]["pair"]["force"] == pytest.approx(expected["contacts"]["pair"]["force"], rel=1e-6, abs=1e-9)


def bar(path, material, dim, kinematics, strain, steps, **more):
    """A unit box, free to contract, extended along its last axis at once."""
    sides = [("left", 0), ("front", 1)][: dim - 1]
    supports = [Displacement(name, [0.0 if k == axis else "free" for k in range(dim)]) for name, axis in sides]
    supports.append(Displacement("bottom", [*["free"] * (dim - 1), 0.0]))
    supports.append(Displacement("top", [*["free"] * (dim - 1), strain], more.pop("amplitude", None)))
    return Scene(
        mesh=MeshSpec(path, kinematics=kinematics), materials={"m": material}, bodies=[Body("block", "m")],
        displacements=supports, steps=steps, output=Output(fields=False, **more.pop("output", {})),
        petsc={**TIGHT, "ksp_rtol": "1e-12"}, **more,
    )  # fmt: skip


CASES = [("plane_stress", 2), ("axisymmetric", 2), ("plane_strain", 3)]


def box(shared_tmp, dim):
    path = shared_tmp / f"box{dim}.msh"
    on_root(WORLD, one_block, path, dim, 2)
    return path


@pytest.mark.parallel(2)
@pytest.mark.parametrize("kinematics, dim", CASES)
@pytest.mark.parametrize("warm", [0.0, 2.0])
def test_relaxation_by_creep(shared_tmp, kinematics, dim, warm):
    """The stress of a bar that is held falls as backward Euler says in one dimension; in a warm one faster."""
    rate, n, c, strain, count = 2e-4, 3.0, 0.4, 0.01, 5
    material = Material(YOUNG, POISSON, law="norton", parameters=[rate, n, c])
    amplitude = [[0.0, 0.0], [1e-9, 1.0], [1.0, 1.0]]
    scene = bar(box(shared_tmp, dim), material, dim, kinematics, strain, Steps(count=count), amplitude=amplitude)
    if warm:
        scene.temperatures = [Temperature(warm, amplitude=[[0.0, 1.0], [1.0, 1.0]])]
    _, stress, _ = solved(scene)
    known, step = YOUNG * strain, 1.0 / count
    for _ in range(count):
        begin = known
        for _ in range(50):
            speed = YOUNG * step * rate * np.exp(c * warm)
            known -= (known + speed * known**n - begin) / (1.0 + n * speed * known ** (n - 1.0))
    assert known < (0.6 if warm else 0.8) * YOUNG * strain
    axis = 1 if dim == 2 else 2
    np.testing.assert_allclose(stress[:, axis], known, rtol=1e-7)
    np.testing.assert_allclose(np.delete(stress, axis, axis=1), 0.0, atol=1e-7 * known)


@pytest.mark.parametrize("kinematics, dim", CASES)
def test_ramberg_and_osgood(shared_tmp, kinematics, dim):
    """A bar has the strain of its stress, and stores the work that was done on it."""
    alpha, limit, n, strain = 0.4, 2.0, 5.0, 0.006
    material = Material(YOUNG, POISSON, law="ramberg_osgood", parameters=[alpha, limit, n])
    scene = bar(box(shared_tmp, dim), material, dim, kinematics, strain, Steps(count=200), output={"energy": True})
    _, stress, records = solved(scene)
    sigma = stress[:, 1 if dim == 2 else 2]
    np.testing.assert_allclose(sigma / YOUNG * (1.0 + alpha * (sigma / limit) ** (n - 1.0)), strain, rtol=1e-8)
    q, volume = sigma[0], np.pi if kinematics == "axisymmetric" else 1.0
    stored = q * strain - (0.5 * q**2 + alpha * q**2 * (q / limit) ** (n - 1.0) / (n + 1.0)) / YOUNG
    energy = records.records[-1]["energy"]
    assert energy["stored"] == pytest.approx(volume * stored, rel=1e-7)
    assert energy["supports"] == pytest.approx(energy["stored"], rel=1e-4)


@pytest.mark.parametrize("law", ["mises", None])
def test_heated_plate_that_is_held_yields(shared_tmp, law):
    """Its stress is uniform in the plane, and zero across: E alpha dT / (1 - nu) until it yields."""
    material = replace(ADDED if law else KNOWN, expansion=1e-3)
    path = shared_tmp / "plate.msh"
    one_block(path, 2, 2)
    scene = Scene(
        mesh=MeshSpec(path, kinematics="plane_stress"), materials={"m": material}, bodies=[Body("block", "m")],
        displacements=[Displacement(name, [0.0, 0.0]) for name in ("left", "right", "bottom", "top")],
        temperatures=[Temperature(10.0)], steps=Steps(count=2), output=Output(fields=False, energy=True), petsc=TIGHT,
    )  # fmt: skip
    _, stress, records = solved(scene)
    # equibiaxial: p = plastic strain across, 2 nu and E / (1 - nu) of the plane
    modulus = YOUNG / (1.0 - POISSON)
    p = (modulus * 0.01 - LIMIT) / (0.5 * modulus + HARDENING)
    np.testing.assert_allclose(stress[:, :2], -(LIMIT + HARDENING * p), rtol=1e-9)
    assert records.records[-1]["plastic"]["max_equivalent_strain"] == pytest.approx(p, rel=1e-9)


def test_a_restarted_run_goes_on(tmp_path):
    """State and time increment are those of a run that was not stopped."""
    material = Material(YOUNG, POISSON, law="norton", parameters=[2e-4, 3.0, 0.0])
    path, count = tmp_path / "box.msh", STOP + 2
    one_block(path, 2, 2)

    def scene():
        case = bar(path, material, 2, "plane_stress", 0.01, Steps(count=count), output={"checkpoint": True})
        return case

    full = resumed(scene(), WORLD, tmp_path / "out", [Keep(tmp_path / "out", tmp_path / "dead", WORLD)])
    again = resumed(scene(), WORLD, tmp_path / "again", restart=tmp_path / "dead")
    assert len(again) == count - STOP
    for one, other in zip(full[STOP:], again, strict=True):
        np.testing.assert_allclose(one["reactions"]["top"], other["reactions"]["top"], rtol=1e-10)
        assert one["newton"] == other["newton"]


def test_messages(tmp_path):
    path = tmp_path / "box.msh"
    one_block(path, 2, 2)
    unknown = Material(YOUNG, POISSON, law="nortn")
    with pytest.raises(InputError, match="materials.m.law.*nortn.*allowed.*hencky.*'norton'"):
        Simulation(bar(path, unknown, 2, "plane_stress", 0.01, Steps()))
    creeps = Material(YOUNG, POISSON, law="norton", parameters=[1e-4, 3.0, 0.0])
    with pytest.raises(InputError, match="output.energy.*does not say what it stores"):
        Simulation(bar(path, creeps, 2, "plane_stress", 0.01, Steps(), output={"energy": True}))
    finite = bar(path, creeps, 2, "plane_strain", 0.01, Steps())
    finite.mesh.strain = "finite"
    with pytest.raises(InputError, match="materials.m.law.*finite strain"):
        Simulation(finite)
    assert pc.PointLaw is not None
