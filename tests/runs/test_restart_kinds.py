"""Restart of every kind of contact and body: the run goes on as if nothing had happened, on any number of ranks."""

import shutil

import h5py
import numpy as np
import pytest

from drivers._common import make_mesh
from meshes import c_strip, two_blocks
from pcontact.io.checkpoint import NAME
from pcontact.runtime.checksum import append_checksums
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Scene,
    Steps,
)
from pcontact.simulation import Simulation

WORLD, SELF = MPI.COMM_WORLD, MPI.COMM_SELF
COUNT, STOP = 6, 3
UP_AND_DOWN = [(0, 0), (0.5, 1), (1, 0.4)]
TO_AND_FRO = [(0, 0), (0.3, 0), (0.7, 1), (1, -0.5)]
PAIR = {"source": "upper_bottom", "target": "lower_top", "name": "pair"}


def stacked(folder, dim=2, degree=1, cell=None, overlap=0.0, material=None, **said):
    """Two boxes: pressed, sheared, sheared back while the pressure falls."""
    cell = cell or ("quadrilateral" if dim == 2 else "hexahedron")
    path = make_mesh(two_blocks, folder / "b.msh", dim, 3 if dim == 2 else 2, 4 if dim == 2 else 3, cell, gap=-overlap)
    moved = [0.1] + [0.0] * (dim - 2)
    return Scene(
        mesh=MeshSpec(path, order=degree),
        materials={"m": material or Material(1000.0, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=[Contact(**{**PAIR, **said})],
        displacements=[
            Displacement("lower_bottom", [0.0] * dim),
            Displacement("upper_top", [*moved, "free"], TO_AND_FRO),
        ],
        loads=[Load("upper_top", pressure=12.0, amplitude=UP_AND_DOWN)],
        steps=Steps(count=COUNT),
        output=Output(fields=False, checkpoint=True, probes=["upper_top"]),
        petsc={"snes_rtol": "1e-12"},
    )


def on_obstacle(folder, obstacle, **said):
    case = stacked(folder, **said)
    case.contacts.append(Contact("lower_bottom", obstacle=obstacle, name="floor", friction=0.4))
    case.displacements[0] = Displacement("lower_left", [0.0, "free"])
    return case


def loose(folder):
    """The upper box lies on the lower one, held by friction alone."""
    case = stacked(folder, friction=0.5)
    case.displacements.pop()
    case.loads = [Load("upper_top", pressure=12.0, amplitude=UP_AND_DOWN),
                  Load("upper_left", traction=[3.5, 0.0], amplitude=TO_AND_FRO)]
    return case


def turned(folder):
    """Rings around the axis of symmetry."""
    path = make_mesh(two_blocks, folder / "b.msh", 2, 3, 4, "quadrilateral")
    case = stacked(folder, friction=0.3)
    case.mesh = MeshSpec(path, kinematics="axisymmetric")
    case.displacements = [Displacement("lower_bottom", ["free", 0.0])]
    case.loads.append(Load("upper_right", pressure=8.0, amplitude=TO_AND_FRO))
    return case


def lips(folder, **said):
    """The lips of a ring that is cut open."""
    path = make_mesh(c_strip, folder / "c.msh", (2, 16), 1, "quadrilateral", gap=2.0, split=False)
    contact = {"friction": 0.3, "search_radius": 1.0, "name": "pair", **said}
    if not contact.get("all"):
        contact.update(source="lips", target="lips")
    return Scene(
        mesh=MeshSpec(path),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("strip", "m")],
        contacts=[Contact(**contact)],
        displacements=[Displacement("back", [0.0, 0.0])],
        loads=[Load("strip_outer", pressure=1.4, amplitude=UP_AND_DOWN)],
        steps=Steps(count=COUNT),
        output=Output(fields=False, checkpoint=True, probes=["lip_upper", "lip_lower"]),
        petsc={"snes_rtol": "1e-12"},
    )


PLANE = Obstacle("plane", point=[0, 0], normal=[0, 1])
MOVING = Obstacle("plane", point=[0, -0.01], normal=[0, 1], displacement=[0.02, 0.02], amplitude=UP_AND_DOWN)
BALL = Obstacle("sphere", center=[0.5, -5.0], radius=5.0)
SOFT = {"material": Material(1000.0, 0.3, yield_stress=12.0, hardening=50.0)}
KINDS = {
    "frictionless": lambda f: stacked(f),
    "Coulomb": lambda f: stacked(f, friction=0.3),
    "Coulomb, theta 1": lambda f: stacked(f, friction=0.3, theta=1.0),
    "Coulomb, theta -1": lambda f: stacked(f, friction=0.3, theta=-1.0),
    "Coulomb, rays": lambda f: stacked(f, friction=0.3, search="ray_tracing"),
    "Tresca": lambda f: stacked(f, tresca=5.0),
    "capped": lambda f: stacked(f, friction=0.5, friction_limit=6.0),
    "adhesion": lambda f: stacked(f, friction=0.2, adhesion=3.0),
    "bilateral": lambda f: stacked(f, friction=0.3, bilateral=True),
    "tied": lambda f: stacked(f, tied=True),
    "tied, penalty": lambda f: stacked(f, tied=True, formulation="penalty"),
    "tied, multipliers": lambda f: stacked(f, tied=True, formulation="augmented_lagrangian"),
    "unbiased": lambda f: stacked(f, friction=0.3, unbiased=True),
    "penalty": lambda f: stacked(f, friction=0.3, formulation="penalty"),
    "multipliers": lambda f: stacked(f, formulation="augmented_lagrangian"),
    "multipliers, Coulomb": lambda f: stacked(f, friction=0.3, formulation="augmented_lagrangian"),
    "multipliers, small gamma": lambda f: stacked(f, friction=0.3, formulation="augmented_lagrangian", gamma0=0.01),
    "overlap resolved": lambda f: stacked(f, friction=0.3, overlap=0.01),
    "overlap adjusted": lambda f: stacked(f, friction=0.3, overlap=0.01, interference="adjust"),
    "all": lambda f: stacked(f, friction=0.3, all=True, source=None, target=None),
    "self contact": lips,
    "all of one body": lambda f: lips(f, all=True, self_contact=True),
    "plane": lambda f: on_obstacle(f, PLANE, friction=0.3),
    "moving plane": lambda f: on_obstacle(f, MOVING, friction=0.3),
    "ball": lambda f: on_obstacle(f, BALL, friction=0.3),
    "isotropic hardening": lambda f: stacked(f, friction=0.3, **SOFT),
    "multipliers, hardening": lambda f: stacked(f, friction=0.3, formulation="augmented_lagrangian", **SOFT),
    "hardening curve": lambda f: stacked(
        f, friction=0.3, material=Material(1000.0, 0.3, hardening_curve=[(0, 12.0), (0.005, 13.0), (1, 80.0)])
    ),
    "kinematic hardening": lambda f: stacked(
        f, friction=0.3, material=Material(1000.0, 0.3, yield_stress=12.0, kinematic_hardening=100.0)
    ),
    "axisymmetric": turned,
    "degree 2": lambda f: stacked(f, friction=0.3, degree=2),
    "loose": loose,
    "space": lambda f: stacked(f, 3, friction=0.3),
    "space, tied": lambda f: stacked(f, 3, tied=True, cell="tetrahedron"),
}


class Watch:
    """Observer: keeps the records, and the checkpoint of a step as a run that died after it would leave it."""

    def __init__(self, source=None, target=None, comm=WORLD):
        self.source, self.target, self.comm, self.records = source, target, comm, []

    def step(self, step, u, record):
        self.records.append(record)
        if step.number == STOP and self.target is not None and self.comm.rank == 0:
            self.target.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.source / NAME, self.target / NAME)

    def cut(self, target, outcome):
        pass

    def end(self, converged):
        pass


def run(case, comm, directory, kept=None, restart=None):
    """Records of the load steps. Collective on `comm`."""
    watch = Watch(directory, kept, comm)
    if restart is not None:
        PETSc.Options().setValue("restart", str(restart))
    simulation = Simulation(case, comm)
    try:
        assert simulation.run(directory, [watch])
    finally:
        simulation.close()
        PETSc.Options().delValue("restart")
    comm.Barrier()
    return watch.records


def numbers(value, prefix=""):
    """All numbers of a record by their place in it."""
    if isinstance(value, dict):
        return {k: v for key, part in value.items() for k, v in numbers(part, f"{prefix}.{key}").items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        # names of bodies
        value = [part for part in value if not isinstance(part, str)]
        if value and isinstance(value[0], dict):
            return {k: v for n, part in enumerate(value) for k, v in numbers(part, f"{prefix}.{n}").items()}
        return {prefix: np.asarray(value, dtype=float)}
    return {prefix: np.asarray(value, dtype=float)} if isinstance(value, (int, float, np.number)) else {}


def worst(a, b, left_out=()):
    """Largest difference of the numbers of two lists of records, relative to the largest of its kind, and where.

    The imbalance is relative to a force already.
    """
    found = 0.0, ""
    scale = {}
    for x in map(numbers, a):
        for key, v in x.items():
            scale[key] = max(scale.get(key, 0.0), float(np.max(np.abs(v), initial=0.0)))
    for x, y in zip(map(numbers, a), map(numbers, b), strict=True):
        assert x.keys() == y.keys()
        for key in x:
            if any(word in key for word in left_out) or scale[key] == 0.0:
                continue
            size = 1.0 if key == ".imbalance" else scale[key]
            found = max(found, (float(np.max(np.abs(x[key] - y[key]))) / size, key))
    return found


# differ by rounding errors where the answers are the same: places and numbers of what ties, sums that are zero
COUNTED = ("newton", "krylov", "imbalance", "flipped", "uzawa", "deepest", "bodies")
PARALLEL = ["tied", "unbiased", "self contact"]
SERIAL = ["tied, multipliers", "multipliers, small gamma", "moving plane", "kinematic hardening", "space, tied"]


@pytest.mark.parametrize("kind", [*SERIAL, *(pytest.param(kind, marks=pytest.mark.parallel) for kind in PARALLEL)])
def test_same_numbers_on_the_same_ranks(shared_tmp, kind):
    """All of them, on one rank those of the solver too. Two runs on three ranks differ in the last bits, and a Krylov
    method makes 1e-11 of that, whether a restart is between them or not."""
    case = KINDS[kind]
    full = run(case(shared_tmp), WORLD, shared_tmp / "full", shared_tmp / "kept")
    again = run(case(shared_tmp), WORLD, shared_tmp / "again", restart=shared_tmp / "kept")
    difference, where = worst(full[STOP:], again, COUNTED if WORLD.size > 1 else ())
    assert difference <= (1e-12 if WORLD.size == 1 else 1e-9), where


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["tied", "Tresca"])
def test_same_numbers_on_other_ranks(shared_tmp, kind):
    """Written by all ranks and read by one."""
    case = KINDS[kind]
    full = run(case(shared_tmp), WORLD, shared_tmp / "full", shared_tmp / "kept")
    alone = run(case(shared_tmp), SELF, shared_tmp / f"alone{WORLD.rank}", restart=shared_tmp / "kept")
    WORLD.Barrier()
    difference, where = worst(full[STOP:], alone, COUNTED)
    assert difference <= 1e-7, where


def with_estimate(folder):
    case = lips(folder)
    case.output.estimate = True
    return case


def with_weak_solver(folder):
    """A Krylov method that fails: the run turns to a direct solver."""
    case = stacked(folder, friction=0.3)
    case.petsc["ksp_max_it"] = "3"
    return case


@pytest.mark.parametrize("case, carried", [(with_estimate, "largest_energy"), (with_weak_solver, "direct")])
def test_what_a_run_carries_on(tmp_path, case, carried):
    """Largest force and energy so far, which errors are relative to, and the solver that it has turned to."""
    full = run(case(tmp_path), WORLD, tmp_path / "full", tmp_path / "kept")
    again = run(case(tmp_path), WORLD, tmp_path / "again", restart=tmp_path / "kept")
    assert worst(full[STOP:], again)[0] <= 1e-12
    with h5py.File(tmp_path / "kept" / NAME, "r+") as file:
        assert file["carried"].attrs[carried] > 0.0 and file["carried"].attrs["largest_force"] > 0.0
        file["carried"].attrs[carried] = 0.0
    append_checksums(tmp_path / "kept" / NAME)
    without = run(case(tmp_path), WORLD, tmp_path / "without", restart=tmp_path / "kept")
    assert worst(full[STOP:], without)[0] > 0.0
