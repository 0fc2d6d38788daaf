"""Scenes with known answers that bear extremes: what `drivers/studies/extremes.py` runs.

Every function writes a mesh into a folder and returns a scene with the function that measures a finished run: the
largest deviation from the known answer, relative to its largest value. A `Frame` holds units and place of the model.
"""

from dataclasses import dataclass

import numpy as np

from drivers._common import make_mesh
from drivers.studies._harness import composed
from meshes.bricks import Brick, bricks
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Steps

E = 1000.0


@dataclass(frozen=True)
class Frame:
    """Units and place: lengths and stresses are multiplied, the model is moved by `shift` of its own lengths."""

    length: float = 1.0
    stress: float = 1.0
    shift: float = 0.0

    def place(self, x):
        """Points of the mesh."""
        return self.length * (x + self.shift)

    def local(self, x):
        """Points of the mesh (n, d) back as they were in the closed form."""
        return x / self.length - self.shift


PLAIN = Frame()


def meshed(folder, parts, frame=PLAIN):
    """The mesh of bricks in a frame. *Collective.*"""
    return make_mesh(bricks, folder / "mesh.msh", parts, frame.place)


def largest(comm, *values):
    """Largest magnitude of arrays of all ranks; infinite where one is not a number. *Collective.*"""
    own = [float(np.max(np.abs(value), initial=0.0)) for value in values]
    own = max((value if np.isfinite(value) else np.inf for value in own), default=0.0)
    return comm.allreduce(own, op=MPI.MAX)


def nodal(simulation):
    """Undeformed points (n, d) and displacements (n, d) of the local nodes. *Collective.*"""
    space = simulation.problem.space
    return space.points, space.local.gather(simulation.stepper.u)


def pairs(simulation):
    """States of all pairs. *Collective.*"""
    return [contact.state(simulation.stepper.u) for contact in simulation.problem.contacts]


def modulus(dim, youngs, nu):
    """Stress over strain of a block that is free to the sides, in plane strain if plane."""
    return youngs / (1.0 - nu**2) if dim == 2 else youngs


def swell(dim, nu):
    """Strain to the side over pressure times Young's modulus, likewise."""
    return nu * (1.0 + nu) if dim == 2 else nu


def stack(
    folder, dim=2, cell="quadrilateral", order=1, n=((3, 2), (4, 2)), youngs=(E, E), nu=(0.3, 0.3), push=0.02,
    pressure=None, gap=0.0, sizes=(1.0, 1.0, 1.0), bends=(None, None), geometry=1, frame=PLAIN, count=1, petsc=None,
    plane_stress=False, **contact,
):  # fmt: skip
    """Two blocks, one on the other, free to the sides: each is under uniform pressure.

    Parameters
    ----------
    folder : pathlib.Path
    dim, cell, order, n : the mesh; divisions of the lower and the upper block
    youngs, nu : of the lower and the upper block
    push : displacement of the top
    pressure : instead of it, on the top
    gap : between the blocks, negative: overlap
    sizes : width, height of the lower, height of the upper block
    bends : of the two bricks
    geometry : degree of the geometry
    contact : further keys of the contact
    """
    width, low, high = sizes
    side = [width] * (dim - 1)
    parts = [
        Brick("lower", [0.0] * dim, [*side, low], n[0], cell, geometry, bends[0]),
        Brick("upper", [*[0.0] * (dim - 1), low + gap], [*side, low + gap + high], n[1], cell, geometry, bends[1]),
    ]
    path = meshed(folder, parts, frame)
    free = ["free"] * (dim - 1)
    supports = [Displacement("lower_bottom", [*free, 0.0]), Displacement("left", [0.0, *free])]
    if dim == 3:
        supports.append(Displacement("front", ["free", 0.0, "free"]))
    if pressure is None:
        supports.append(Displacement("upper_top", [*free, -push * frame.length]))
    case = composed(
        MeshSpec(path, order=order, kinematics="plane_stress" if plane_stress else "plane_strain"),
        {part.name: Material(e * frame.stress, v) for part, e, v in zip(parts, youngs, nu, strict=True)},
        supports,
        title="Two blocks",
        contacts=[Contact(**{"source": "upper_bottom", "target": "lower_top", "name": "pair", **contact})],
        loads=[] if pressure is None else [Load("upper_top", pressure=pressure * frame.stress)],
        steps=Steps(1.0, count, 0.25 / count),
        output=Output(probes=["upper_top"]),
        petsc=petsc,
    )
    flat = 3 if plane_stress else dim
    moduli = [modulus(flat, e, v) for e, v in zip(youngs, nu, strict=True)]

    def measure(simulation, records):
        comm, item = simulation.comm, simulation.problem.contacts[0]
        soft, closing = low / moduli[0] + high / moduli[1], gap
        if contact.get("formulation") == "penalty":
            stiff = comm.allreduce(float(np.max(item.method.gamma, initial=0.0)), op=MPI.MAX)
            soft += frame.stress / frame.length / stiff
        if contact.get("interference") == "adjust":
            closing = max(gap, 0.0)
        known = pressure if pressure is not None else (push - closing) / soft
        pressures = np.concatenate([state["pressure"] / frame.stress for state in pairs(simulation)])
        if known <= 0.0:
            # apart: nothing touches
            return {"pressure": largest(comm, pressures) / E}
        error = {"pressure": largest(comm, pressures / known - 1.0)}
        if contact.get("formulation") is None:
            points, u = nodal(simulation)
            x, upper = frame.local(points), body_of(simulation) == "upper"
            strains = [known / m for m in moduli]
            exact = np.empty_like(x)
            sides = np.where(upper, *[known * swell(flat, v) / e for e, v in zip(youngs[::-1], nu[::-1], strict=True)])
            exact[:, :-1] = sides[:, None] * x[:, :-1]
            above = -strains[0] * low - closing - strains[1] * (x[:, -1] - low - gap)
            exact[:, -1] = np.where(upper, above, -strains[0] * x[:, -1])
            error["displacement"] = deviation(comm, u / frame.length, exact)
        return error

    return case, measure


def deviation(comm, values, exact):
    """Largest difference relative to the largest exact value. *Collective.*"""
    return largest(comm, values - exact) / max(largest(comm, exact), 1e-300)


def body_of(simulation):
    """Region of the body of every local node."""
    space = simulation.problem.space
    return np.asarray(space.mesh.component_names)[space.component]


def shear(
    folder, dim=2, cell="quadrilateral", order=1, n=(4, 2), friction=0.3, ratio=0.2, pressure=10.0, theta=0.0,
    frame=PLAIN, count=2, petsc=None, **contact,
):  # fmt: skip
    """A block pressed and sheared on a rigid plane, with what its ends bear: stress is uniform, stick or slip.

    Parameters
    ----------
    ratio : shear over normal stress if the block sticks; it slips where that exceeds `friction`
    others : as for :func:`stack`
    """
    height, size = 0.5, [1.0] * (dim - 1)
    divisions = [n[0], *[2] * (dim - 2), n[1]]
    path = meshed(folder, [Brick("block", [0.0] * dim, [*size, height], divisions, cell)], frame)
    tau = pressure * min(ratio, friction)
    drag, depth = ratio * pressure * height / (0.5 * E), pressure * height / E
    zeros = [0.0] * (dim - 2)
    up = [0.0] * (dim - 1)
    bottom = (np.zeros(dim) + frame.shift) * frame.length
    floor = Obstacle("plane", point=bottom.tolist(), normal=[*up, 1.0])
    case = composed(
        MeshSpec(path, order=order),
        {"block": Material(E * frame.stress, 0.0)},
        {"top": [drag * frame.length, *zeros, -depth * frame.length]},
        title="Sheared block",
        contacts=[Contact("bottom", obstacle=floor, name="pair", friction=friction, theta=theta, **contact)],
        loads=[
            Load(side, traction=[*up, sign * tau * frame.stress]) for side, sign in (("left", -1.0), ("right", 1.0))
        ],
        steps=Steps(1.0, count, 0.25 / count),
        petsc=petsc,
    )

    def measure(simulation, records):
        comm = simulation.comm
        state = pairs(simulation)[0]
        tangential = np.linalg.norm(state["traction"][:, : dim - 1], axis=1) / frame.stress
        points, u = nodal(simulation)
        exact = np.zeros_like(points)
        y = frame.local(points)[:, -1]
        exact[:, -1] = -pressure / E * y
        exact[:, 0] = drag - tau / (0.5 * E) * (height - y)
        scale = pressure or E
        return {
            "pressure": largest(comm, state["pressure"] / frame.stress - pressure) / scale,
            "friction": largest(comm, tangential - tau) / max(tau, scale),
            "displacement": deviation(comm, u / frame.length, exact),
        }

    return case, measure


def ring(
    folder, cell="quadrilateral", order=2, n=(4, 8), nu=0.3, fit=1e-3, frame=PLAIN, geometry=2, petsc=None, **contact
):
    """A ring shrunk on a rigid shaft, a quarter of it in plane strain: Lame's solution."""
    a, b = 1.0, 2.0

    def bend(x):
        r, angle = x[:, 0], x[:, 1]
        return np.column_stack([r * np.cos(angle), r * np.sin(angle)])

    path = meshed(folder, [Brick("ring", [a, 0.0], [b, 0.5 * np.pi], n, cell, geometry, bend)], frame)
    centre = (np.zeros(2) + frame.shift) * frame.length
    shaft = Obstacle("sphere", center=centre.tolist(), radius=(a + fit) * frame.length)
    case = composed(
        MeshSpec(path, order=order),
        {"ring": Material(E * frame.stress, nu)},
        {"bottom": ["free", 0.0], "top": [0.0, "free"]},
        title="Ring on a shaft",
        contacts=[Contact("left", obstacle=shaft, name="pair", **contact)],
        petsc=petsc,
    )
    known = fit * E * (b**2 - a**2) / ((1.0 + nu) * a * ((1.0 - 2.0 * nu) * a**2 + b**2))
    # u_r = (1 + nu) / E a^2 p / (b^2 - a^2) ((1 - 2 nu) r + b^2 / r)
    factor = (1.0 + nu) / E * a**2 * known / (b**2 - a**2)

    def measure(simulation, records):
        comm, state = simulation.comm, pairs(simulation)[0]
        own = np.array([np.sum(state["weight"] * state["pressure"]), np.sum(state["weight"])])
        force, area = comm.allreduce(own, op=MPI.SUM)
        points, u = nodal(simulation)
        x = frame.local(points)
        r = np.linalg.norm(x, axis=1)
        exact = (factor * ((1.0 - 2.0 * nu) * r + b**2 / r) / r)[:, None] * x
        return {
            "pressure": abs(force / area / frame.stress / known - 1.0),
            "displacement": deviation(comm, u / frame.length, exact),
        }

    return case, measure


YIELD = 1.0  # of the weaker of two bars, 1e-3 of Young's modulus


def bars(
    folder, dim=3, hardening=0.0, level=0.99, order=1, cell="hexahedron", frame=PLAIN, count=4, petsc=None, **contact
):
    """Two bars side by side, one of them twice as strong, squeezed by a rigid plate to a part of their limit load.

    `level` is the force over that at which both flow, for bars without hardening.
    """
    side = [1.0] * (dim - 1)
    far = [2.0, *[0.0] * (dim - 2)]
    n = [2] * dim
    parts = [
        Brick("weak", [0.0] * dim, [*side, 1.0], n, cell),
        Brick("strong", [*far, 0.0], [3.0, *side[1:], 1.0], n, cell),
    ]
    path = meshed(folder, parts, frame)
    strain = (3.0 * level - 1.0) * YIELD / E
    free = ["free"] * (dim - 1)
    supports = [Displacement("bottom", [*free, 0.0])]
    supports += [Displacement(f"{name}_left", [0.0, *free]) for name in ("weak", "strong")]
    if dim == 3:
        supports.append(Displacement("front", ["free", 0.0, "free"]))
    up, top = np.eye(dim)[-1], (np.eye(dim)[-1] + frame.shift) * frame.length
    plate = Obstacle(
        "plane", point=top.tolist(), normal=(-up).tolist(), displacement=(-strain * frame.length * up).tolist()
    )
    scale = frame.stress
    kinds = {
        name: Material(E * scale, 0.3, yield_stress=bound * scale, hardening=hardening * E * scale)
        for name, bound in (("weak", YIELD), ("strong", 2.0 * YIELD))
    }
    case = composed(
        MeshSpec(path, order=order, kinematics="plane_stress" if dim == 2 else "plane_strain"),
        kinds,
        supports,
        title="Two bars",
        contacts=[Contact("top", obstacle=plate, name="pair", **contact)],
        steps=Steps(1.0, count, 0.25 / count),
        petsc=petsc,
    )
    soft = hardening / (1.0 + hardening) * E
    known = [min(E * strain, bound + soft * max(strain - bound / E, 0.0)) for bound in (YIELD, 2.0 * YIELD)]

    def measure(simulation, records):
        comm, state = simulation.comm, pairs(simulation)[0]
        weak = frame.local(state["x"])[:, 0] < 1.5
        wanted = np.where(weak, *known)
        points, u = nodal(simulation)
        y = frame.local(points)[:, -1]
        return {
            "pressure": largest(comm, state["pressure"] / scale / wanted - 1.0),
            "displacement": largest(comm, u[:, -1] / frame.length + strain * y) / strain,
        }

    return case, measure


def flowing_strain(load, nu, hardening):
    """Strain of a block in plane strain, free to the side, at a pressure beyond its first yielding.

    d sigma_z = nu d sigma_y - E n_z dp and the condition that the point stays on the yield surface,
    n_y d sigma_y + n_z d sigma_z = H dp, integrated by the classical Runge-Kutta method; n = 3/2 s / sigma_eq.
    All stresses over the yield stress, all strains over yield stress over E.
    """

    def slopes(y, z):
        mean, size = (y + z) / 3.0, np.sqrt(y * y - y * z + z * z)
        ny, nz = 1.5 * (y - mean) / size, 1.5 * (z - mean) / size
        flow = (ny + nu * nz) / (hardening + nz * nz)
        dz = nu - nz * flow
        return np.array([dz, 1.0 - nu * dz + ny * flow])

    first, limit = 1.0 / np.sqrt(1.0 - nu + nu**2), 2.0 / np.sqrt(3.0)
    if 0.0 < hardening < 1e-4 and load > limit:
        # far on the straight line of hardening, n_y = sqrt(3) / 2; what came before is a few parts in 1e4 of it
        return (load / limit - 1.0) / hardening / limit
    if load <= first:
        return load * (1.0 - nu**2)
    state, steps = np.array([nu * first, first * (1.0 - nu**2)]), 4000
    h, y = (load - first) / steps, first
    for _ in range(steps):
        a = slopes(y, state[0])
        b = slopes(y + 0.5 * h, state[0] + 0.5 * h * a[0])
        c = slopes(y + 0.5 * h, state[0] + 0.5 * h * b[0])
        d = slopes(y + h, state[0] + h * c[0])
        state, y = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d), y + h
    return float(state[1])


def flowing(
    folder, hardening=0.0, level=0.99, cell="quadrilateral", order=1, count=24, frame=PLAIN, petsc=None, **contact
):
    """A block in plane strain on a rigid plane under a pressure near its limit load 2 / sqrt(3) of the yield stress."""
    path = meshed(folder, [Brick("block", [0.0, 0.0], [1.0, 1.0], (3, 3), cell)], frame)
    floor = Obstacle("plane", point=((np.zeros(2) + frame.shift) * frame.length).tolist(), normal=[0.0, 1.0])
    load, first = level * 2.0 / np.sqrt(3.0), 1.0 / np.sqrt(0.79)
    # elastic at once, then in steps
    path_of = [(0, 0), (0.125, min(first / load, 1.0)), (1, 1)]
    material = Material(
        E * frame.stress, 0.3, yield_stress=YIELD * frame.stress, hardening=hardening * E * frame.stress
    )
    case = composed(
        MeshSpec(path, order=order),
        {"block": material},
        {"left": [0.0, "free"]},
        title="Flowing block",
        contacts=[Contact("bottom", obstacle=floor, name="pair", **contact)],
        loads=[Load("top", pressure=load * YIELD * frame.stress, amplitude=path_of)],
        steps=Steps(1.0, count, 0.25 / count),
        output=Output(probes=["top"]),
        petsc=petsc,
    )

    def measure(simulation, records):
        known = flowing_strain(load, 0.3, hardening) * YIELD / E
        down = -records[-1]["probes"]["top"]["mean"][1] / frame.length
        force = -records[-1]["contacts"]["pair"]["force"][1] / frame.length / frame.stress
        return {"displacement": abs(down / known - 1.0), "force": abs(force / (load * YIELD) - 1.0)}

    return case, measure
