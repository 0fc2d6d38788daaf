"""Scenes of every kind of contact and body for restarts, and how far the numbers of two runs differ."""

import numpy as np

from drivers._common import make_mesh
from meshes import c_strip, two_blocks
from pcontact.scene.model import (
    Body,
    Contact,
    Displacement,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Phase,
    Scene,
    Steps,
)
from tests.support.dynamics import collision

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


def staying(case):
    """Partners of a load step stay: the last point of a facet goes over the border of the other block, to and fro."""
    case.petsc["contact_search_again"] = "0"
    return case


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


def large(case, E=100.0, **said):
    """The same of softer bodies, with finite strain."""
    case.mesh.strain = "finite"
    case.materials = {"m": Material(E, 0.3, **said)}
    return case


def impact(folder):
    """A body that turns as it flies, and hits one that is at rest, with friction and finite strain."""
    case = collision(folder, 0.04, 0.04 * COUNT)
    case.output, case.petsc = Output(fields=False, checkpoint=True), {"snes_rtol": "1e-12"}
    return case


def in_phases(case, second=4, **said):
    """The same in two phases, of three load steps and of some more."""
    case.phases = [Phase("first", 0.5, STOP), Phase("second", 0.5, second, **said)]
    return case


PLANE = Obstacle("plane", point=[0, 0], normal=[0, 1])
MOVING = Obstacle("plane", point=[0, -0.01], normal=[0, 1], displacement=[0.02, 0.02], amplitude=UP_AND_DOWN)
BALL = Obstacle("sphere", center=[0.5, -5.0], radius=5.0)
ROLL = Obstacle("sphere", center=[0.5, -5.0], radius=5.0, angle=8.0, displacement=[0.0, 0.02], amplitude=TO_AND_FRO)
SOFT = {"material": Material(1000.0, 0.3, yield_stress=12.0, hardening=50.0)}
KINDS = {
    "impact": impact,
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
    "friction that slows": lambda f: stacked(f, friction="0.3 + 0.1*x", kinetic_friction=0.1, friction_decay=5.0),
    "finite strain, friction that slows": lambda f: large(
        stacked(f, friction=0.3, kinetic_friction="0.1 + 0.05*t", friction_decay=5.0)
    ),
    "layer": lambda f: stacked(f, friction=0.3, pressure_overclosure=[(-0.01, 0.0), (0.01, 20.0), (0.02, 60.0)]),
    "finite strain, layer": lambda f: large(stacked(f, friction=0.3, pressure_overclosure=2e3, stick_stiffness=900.0)),
    "layer, phases": lambda f: staying(in_phases(
        stacked(f, friction=0.3, pressure_overclosure=[(-0.01, 0.0), (0.01, 20.0)]), friction={"pair": "0.1 + 0.1*x"}
    )),
    "layer that is tied, phases": lambda f: in_phases(
        stacked(f, friction=0.3, pressure_overclosure=[(-0.01, 0.0), (0.01, 20.0)]), tied=["pair"]
    ),
    "friction that slows, phases": lambda f: in_phases(
        stacked(f, friction=0.3, kinetic_friction=0.1, friction_decay=5.0)
    ),
    "clearance by an amplitude": lambda f: stacked(
        f, friction=0.3, clearance=-0.01, interference_amplitude=[(0, 0), (0.8, 1)]
    ),
    "adjusted within": lambda f: stacked(f, friction=0.3, overlap=-0.002, interference="adjust", adjust_within=0.01),
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
    "finite strain": lambda f: large(stacked(f, friction=0.3, search="ray_tracing")),
    "finite strain, tied": lambda f: large(stacked(f, tied=True)),
    "finite strain, rubber, theta -1": lambda f: large(stacked(f, friction=0.3, theta=-1.0), law="neo_hooke"),
    "finite strain, multipliers": lambda f: large(stacked(f, friction=0.3, formulation="augmented_lagrangian")),
    "finite strain, unbiased, hardening": lambda f: large(
        stacked(f, friction=0.3, unbiased=True), yield_stress=10.0, hardening=20.0
    ),
    "finite strain, self contact": lambda f: large(lips(f), 2000.0),
    "finite strain, roll": lambda f: large(on_obstacle(f, ROLL, friction=0.3)),
    "finite strain, space": lambda f: large(stacked(f, 3, friction=0.3, search="ray_tracing")),
}


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
COUNTED = ("newton", "krylov", "imbalance", "flipped", "uzawa", "partners", "deepest", "place", "bodies")
