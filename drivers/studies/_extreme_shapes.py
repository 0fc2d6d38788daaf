"""Curved and pointed bodies with known answers, and scenes that must be refused: for `drivers/studies/extremes.py`."""

import numpy as np

from drivers._common import make_mesh
from drivers.studies._extreme_scenes import E, largest, meshed, nodal, pairs
from drivers.studies._harness import composed
from meshes.bricks import Brick, bricks
from pcontact.scene.model import Contact, Displacement, Load, Material, MeshSpec, Obstacle, Steps


def wave(
    folder, cell="quadrilateral", part=1.5, n=(16, 10), order=2, geometry=2, nu=0.3, height=1e-3, petsc=None, **contact
):
    """Half a wave of an elastic surface pressed on a rigid plane: Westergaard's solution (Johnson, 13.2).

    With crests `height` above the mean line and a wave length of 2 the surface is pressed flat by the mean pressure
    p* = pi E* height / 2; `part` is the mean pressure over p*. Beyond it p = mean + p* cos(pi x).
    """
    dim = 3 if cell in ("tetrahedron", "hexahedron") else 2
    depth = 2.0

    def bend(x):
        moved = x.copy()
        moved[:, -1] += height * (1.0 - np.cos(np.pi * x[:, 0])) * (1.0 - x[:, -1] / depth)
        return moved

    # cells grow with the distance from the surface
    levels = np.linspace(0.0, 1.0, n[1] + 1) ** 2
    flat = [0.0] * (dim - 2)
    divisions = [n[0], *[1] * (dim - 2), levels]
    brick = Brick("block", [0.0] * dim, [1.0, *[2.0 / n[0]] * (dim - 2), depth], divisions, cell, geometry, bend)
    path = meshed(folder, [brick])
    free = ["free"] * (dim - 1)
    stiff = E / (1.0 - nu**2)
    star = 0.5 * np.pi * stiff * height
    up = [*[0.0] * (dim - 1), 1.0]
    supports = [Displacement(side, [0.0, *free]) for side in ("left", "right")]
    supports += [Displacement(side, ["free", 0.0, "free"]) for side in ("front", "back")[: 2 * (dim - 2)]]
    case = composed(
        MeshSpec(path, order=order),
        {"block": Material(E, nu)},
        supports,
        title="Pressed flat",
        contacts=[
            Contact("bottom", obstacle=Obstacle("plane", point=[0.0, *flat, 0.0], normal=up), name="pair", **contact),
        ],
        loads=[Load("top", pressure=part * star)],
        petsc=petsc,
    )

    def measure(simulation, records):
        comm, state = simulation.comm, pairs(simulation)[0]
        x, p, w = state["x"][:, 0], state["pressure"] / star, state["weight"]
        if part >= 1.0:
            exact = part + np.cos(np.pi * x)
        else:
            inside = np.maximum(part - np.sin(0.5 * np.pi * x) ** 2, 0.0)
            exact = 2.0 * np.cos(0.5 * np.pi * x) * np.sqrt(inside)
        sums = comm.allreduce(np.array([np.sum(w * (p - exact) ** 2), np.sum(w * exact**2), np.sum(w * p), np.sum(w)]))
        return {"pressure, L2": float(np.sqrt(sums[0] / sums[1])), "force": abs(sums[2] / sums[3] / part - 1.0)}

    return case, measure


def turned(angle, axes, about):
    """A rotation of points in the plane of two axes about a point."""

    def bend(x):
        moved, (i, j) = x - about, axes
        out = moved.copy()
        out[:, i] = np.cos(angle) * moved[:, i] - np.sin(angle) * moved[:, j]
        out[:, j] = np.sin(angle) * moved[:, i] + np.cos(angle) * moved[:, j]
        return out + about

    return bend


def on_corner(size):
    """A cube with its lowest corner at the origin, its diagonal upright."""
    z = np.ones(3) / np.sqrt(3.0)
    x = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    axes = np.stack([x, np.cross(z, x), z])
    return lambda points: size * (points @ axes.T)


def pointed(
    folder, kind="corner on face", dim=2, cell="quadrilateral", load=1.0, n=4, order=1, source="upper", gap=0.0,
    petsc=None, **contact,
):  # fmt: skip
    """Bodies that touch at a point or along a line, pressed by their weight: the force is the weight.

    Parameters
    ----------
    kind : "corner on face", "corner on corner" (plane); "corner on face", "edge on edge" (crossed), "edge along edge"
    load : weight, of the order of 1 where it makes displacements of 1e-3
    """
    upper, lower = _bends(kind, dim)
    ones = [1.0] * dim
    base = [-0.5] * (dim - 1)
    parts = [
        Brick("lower", [*base, -1.0], [*[0.5] * (dim - 1), 0.0], [n] * dim, cell, 1, lower),
        Brick("upper", [0.0] * dim, ones, [n] * dim, cell, 1, lambda x: upper(x) + gap * np.eye(dim)[-1]),
    ]
    faces = ("left", "bottom") if dim == 2 or kind.startswith("edge") else ("left", "front", "bottom")
    below = ("top",) if kind == "corner on face" else ("top", "right")
    skins = {"upper_skin": [f"upper_{f}" for f in faces], "lower_skin": [f"lower_{f}" for f in below]}
    path = make_mesh(bricks, folder / "mesh.msh", parts, None, skins)
    sides = ("upper_skin", "lower_skin") if source == "upper" else ("lower_skin", "upper_skin")
    contacts = [Contact(*sides, name="pair", **contact)]
    hold = ["upper_top", "upper_right", *(["upper_back"] if dim == 3 else [])]
    supports = [Displacement(name, [*[0.0] * (dim - 1), "free"]) for name in hold]
    bottom = ["lower_bottom"] if kind == "corner on face" else ["lower_bottom", "lower_left"]
    supports += [Displacement(name, [0.0] * dim) for name in bottom]
    case = composed(
        MeshSpec(path, order=order),
        dict.fromkeys(("lower", "upper"), Material(E, 0.3)),
        supports,
        title=kind,
        contacts=contacts,
        loads=[Load("upper", body_force=[*[0.0] * (dim - 1), -load])],
        steps=Steps(1.0, 1, 0.1),
        petsc=petsc,
    )

    def measure(simulation, records):
        sign = 1.0 if source == "upper" else -1.0
        force = sum(np.array(pair["force"]) for pair in records[-1]["contacts"].values()) * sign
        return {"force": abs(force[-1] / -load - 1.0)} if load else {"force": float(np.abs(force).max())}

    return case, measure


def _bends(kind, dim):
    """Return the maps that bend the upper cube [0, 1]^d and the lower one, whose top is at 0."""
    down = np.zeros(dim)
    if dim == 2:
        upper = turned(0.25 * np.pi, (0, 1), down)
        ridge = turned(-0.25 * np.pi, (0, 1), down)
        return upper, (lambda x: ridge(x + [-0.5, 0.0])) if kind == "corner on corner" else (lambda x: x)
    if kind == "corner on face":
        return on_corner(1.0), lambda x: x
    roof = turned(0.25 * np.pi, (0, 2), down)
    along = lambda x: roof(x - [0.0, 0.5, 0.0])  # noqa: E731
    below = turned(-0.25 * np.pi, (0, 2), down)
    ridge = lambda x: below(x + [-0.5, 0.0, 0.0])  # noqa: E731
    if kind == "edge along edge":
        return along, ridge
    return along, lambda x: ridge(x)[:, [1, 0, 2]] * [1.0, -1.0, 1.0]


def touching(folder, cell="quadrilateral", load=0.0, n=8, order=2, target="plane", petsc=None, **contact):
    """A block whose bottom is a parabola touches a plane, or a flat block, at a single point; pressed by its weight."""

    def bend(x):
        moved = x.copy()
        moved[:, 1] += 0.25 * x[:, 0] ** 2 * (1.0 - x[:, 1])
        return moved

    parts = [Brick("upper", [-1.0, 0.0], [1.0, 1.0], (n, n // 2), cell, 2, bend)]
    if target != "plane":
        parts.append(Brick("lower", [-1.0, -1.0], [1.0, 0.0], (n, n // 2), cell, 2))
        pair = Contact("upper_bottom", "lower_top", name="pair", **contact)
    else:
        floor = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
        pair = Contact("upper_bottom", obstacle=floor, name="pair", **contact)
    path = meshed(folder, parts)
    supports = {"upper_top": [0.0, "free"], "lower_bottom": [0.0, 0.0]}
    case = composed(
        MeshSpec(path, order=order),
        {part.name: Material(E, 0.3) for part in parts},
        dict(list(supports.items())[: len(parts)]),
        title="Tangential touch",
        contacts=[pair],
        loads=[Load("upper_top", traction=[0.0, -0.5 * load])],
        steps=Steps(1.0, 1, 0.1),
        petsc=petsc,
    )

    def measure(simulation, records):
        force = -records[-1]["contacts"]["pair"]["force"][1]
        u = largest(simulation.comm, nodal(simulation)[1])
        if load == 0.0:
            return {"force": abs(force), "displacement": u}
        return {"force": abs(force / load - 1.0)}

    return case, measure
