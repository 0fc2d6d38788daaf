"""Cases of the verification manual: a ball on a block in space, pressed and then sheared, after Mindlin."""

import shutil
from dataclasses import replace
from functools import partial

import numpy as np

from drivers._common import make_mesh
from drivers.studies._harness import composed
from drivers.studies._manual import JOHNSON, RUN, Case, points_of
from drivers.studies._manual_half_space import CYLINDERS
from meshes.grid import add, join, lattice, name_boundary, near, refined, split_group, sweep
from meshes.patches import growing
from meshes.tools import gmsh_model, group, write
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Displacement, Material, MeshSpec, Steps

# Young's modulus, Poisson's ratio, friction, radius of the ball, radius and height of both bodies; contact radius: 1
MODULUS, NU, GRIP, RADIUS, SIZE = 1.0, 0.3, 0.5, 1000.0, 100.0
SHEAR = MODULUS / (2.0 * (1.0 + NU))
REDUCED = MODULUS / (2.0 * (1.0 - NU**2))
# tangential force that is asked for, in parts of friction times the normal one
PART = 0.6
# half width of the square core of the sections, cells that grow from one to the next by a factor
CORE, FACTOR = 0.5, 1.5
# radius of the surfaces that may touch, and by how much the block's cells are larger
SKIN, LARGER = {"ball": 1.7, "block": 2.4}, 1.15
STICK = 1
# runs of this process: folder and values, by the folder of all cases and the mesh
DONE = {}


def half_disk(radii, m):
    """Half a disk: a core of 2 m by m cells, 4 m cells around it between each two radii, the first one ``CORE``."""
    along, up = np.linspace(-1.0, 1.0, 4 * m + 1), np.linspace(0.0, 1.0, 2 * m + 1)
    ends = refined(radii, 2)[:, None, None]
    # from the hull of the core (0) to circles (1)
    part = np.minimum((ends - CORE) / (1.0 - CORE), 1.0)

    def core(u, v):
        bulged = [u * np.sqrt(1.0 - 0.25 * v**2), v * np.sqrt(1.0 - 0.25 * u**2), 0.0 * (u + v)]
        return CORE * np.stack(np.broadcast_arrays(*bulged), axis=-1)

    def side(inner, first, last):
        angle = np.radians(np.linspace(first, last, len(inner)))
        circle = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
        return (1.0 - part) * inner + part * np.maximum(ends, 1.0) * circle

    patches = [
        core(*np.meshgrid(along, up, indexing="ij")),
        side(core(np.ones_like(up), up), 0.0, 45.0),
        side(core(-along, np.ones_like(along)), 45.0, 135.0),
        side(core(-np.ones_like(up), up[::-1]), 135.0, 180.0),
    ]
    return join([lattice(patch, 2, "quadrilateral") for patch in patches])


def half_body(n, body):
    """Half a ball or a block, y >= 0, n cells in the radius of the contact.

    Towards the outside cells grow in all directions alike: lines through the fine ones open like rays.
    """
    scale = LARGER if body == "block" else 1.0
    fine, size = 1.0 / n, SIZE / scale
    inner = np.concatenate([np.linspace(CORE, 1.0, n // 2 + 1), 1.0 + fine * np.arange(1, round(0.3 * n) + 1)])
    radii = np.concatenate([inner, inner[-1] + growing(1.3 * fine, size - inner[-1], FACTOR)[1:]])
    disk = half_disk(radii, n // 2)
    lines = growing(scale * fine, SIZE, FACTOR)
    depth, even = refined(lines, 2)[:, None], refined(np.linspace(0.0, SIZE, len(lines)), 2)[:, None]
    radius = np.hypot(*disk.points[:, :2].T)
    spread = SIZE * np.log1p(scale * radius) / np.log1p(SIZE)

    def place(x, _):
        far, deep = scale * radius / SIZE, depth / SIZE
        r = (1.0 - deep) * scale * radius + deep * spread
        points = np.empty((*r.shape, 3))
        points[..., :2] = x * (r / np.where(radius > 0.0, radius, 1.0))[..., None]
        points[..., 2] = (1.0 - far) * depth + far * even
        if body == "ball":
            points[..., 2] += (1.0 - deep) * r**2 / (2.0 * RADIUS)
            return points
        points[..., 2] *= -1.0
        return points[::-1]

    ends = ("skin", "far") if body == "ball" else ("far", "skin")
    grid = sweep(disk, len(lines) - 1, place, *ends)
    named = name_boundary(grid, **{f"{body}_symmetry": near(1, 0.0)})
    inside = lambda x: np.hypot(x[..., 0], x[..., 1]) < SKIN[body]  # noqa: E731
    named = split_group(named, "skin", **{f"{body}_skin": inside})
    kept = {key: found for key, found in named.groups.items() if key.startswith(body)}
    return replace(grid, groups={**kept, f"{body}_far": grid.groups["far"]})


def ball_and_block(path, n):
    """Half of both bodies, which touch at the origin. Groups: ball, block, and of each _skin, _far, _symmetry."""
    with gmsh_model("mindlin"):
        for body in ("ball", "block"):
            tag, facets = add(half_body(n, body))
            group(3, body, [tag])
            for name, found in facets.items():
                group(2, name, [found])
        write(path)


def closed_form(normal, tangential):
    """Radius of the contact and of the part that sticks, and the shift of distant points of both bodies."""
    a = (0.75 * normal * RADIUS / REDUCED) ** (1.0 / 3.0)
    left = 1.0 - tangential / (GRIP * normal)
    shift = 3.0 * (2.0 - NU) * GRIP * normal / (8.0 * SHEAR * a) * (1.0 - left ** (2.0 / 3.0))
    return a, a * left ** (1.0 / 3.0), shift


def stick_radius(points):
    """From (mu p - tau)^2, which is linear in r^2 where points stick."""
    weight, stick = points["weight"], points["status"] == STICK
    r = np.hypot(points["x"][:, 0], points["x"][:, 1])
    inner = stick & (r < 0.8 * np.sqrt(2.0 * weight[stick].sum() / np.pi))
    left = (GRIP * points["pressure"] - np.abs(points["traction"][:, 0]))[inner] ** 2
    slope, top = np.polyfit(r[inner] ** 2, left, 1, w=np.sqrt(weight[inner]))
    return float(np.sqrt(-top / slope))


def shear_ball(folder, n):
    """Radius of the part that sticks, and the shift, over their closed forms for the forces. *Collective.*"""
    path = make_mesh(ball_and_block, folder / "bodies.msh", n)
    # what a contact of the radius 1 has
    shift = closed_form(4.0 / 3.0 * REDUCED / RADIUS, PART * GRIP * 4.0 / 3.0 * REDUCED / RADIUS)[2]
    scene = composed(
        MeshSpec(path, order=2, serendipity=True),
        dict.fromkeys(("ball", "block"), Material(MODULUS, NU)),
        [
            Displacement("ball_far", ["free", 0.0, -1.0 / RADIUS], [[0.0, 0.0], [1.0, 1.0]]),
            Displacement("ball_far", [shift, "free", "free"], [[1.0, 0.0], [3.0, 1.0]]),
            Displacement("block_far", [0.0, 0.0, 0.0]),
            *(Displacement(f"{body}_symmetry", ["free", 0.0, "free"]) for body in ("ball", "block")),
        ],
        contacts=[Contact("ball_skin", "block_skin", name="pair", friction=GRIP)],
        steps=Steps(end=3.0, count=3),
    )
    points = points_of(scene, folder)
    tangential, _, normal = 2.0 * np.abs(points["weight"] @ points["traction"])
    _, stuck, moved = closed_form(normal, tangential)
    return stick_radius(points) / stuck, shift / moved


def sheared_ball(which, folder, n):
    """One of the values of :func:`shear_ball`; one run serves the cases of all values. *Collective.*"""
    key = folder.parents[1], n
    if key not in DONE:
        DONE[key] = folder, shear_ball(folder, n)
    first, values = DONE[key]
    if first != folder:
        on_root(MPI.COMM_WORLD, partial(shutil.copytree, dirs_exist_ok=True), first / RUN, folder / RUN)
    return values[which]


DATA = (
    f"A paraboloid of the radius {RADIUS:g} is pressed on a block until the radius of the contact is about 1, then its "
    f"far side is shifted until the tangential force is about {PART:g} of what friction bears. E = {MODULUS:g}, nu = "
    f"{NU:g} of both, friction {GRIP:g}; half of both bodies, which are {SIZE:g} high and wide. Cells of 20 nodes, n "
    "of them in the radius of the contact."
)
MINDLIN = (
    f"R. D. Mindlin, J. Appl. Mech. 16 (1949) 259-268; {JOHNSON}, section 7.2; for the forces that were computed"
)
SKETCH = CYLINDERS.replace("lower", "block").replace("upper", "ball ")
LEVELS = (4, 6, 8)
CASES = {
    "mindlin_stick": Case(
        "Mindlin: a ball that is sheared, radius of stick", DATA, SKETCH,
        f"c / a = (1 - T / (mu P))^(1/3), {MINDLIN}",
        "radius of the part that sticks, fitted, over the closed form", 1.0, LEVELS, partial(sheared_ball, 0),
        (2e-2, 1.5e-2),
        "The closed form has all tractions along the force; with nu > 0 they turn a little where points slip. The "
        "radius is fitted to tractions at the points that stick.", tiny=False,
    ),
    "mindlin_shift": Case(
        "Mindlin: a ball that is sheared, shift", f"The data of [the radius](mindlin_stick.md): {DATA}",
        SKETCH,
        f"3 (2 - nu) mu P / (8 G a) (1 - (1 - T / (mu P))^(2/3)) for two bodies, {MINDLIN}",
        "tangential shift of distant points over the closed form", 1.0, LEVELS, partial(sheared_ball, 1),
        (2e-2, 1.5e-2), "Bodies of 100 contact radii give way by about 1 % less than half spaces.", tiny=False,
    ),
}  # fmt: skip
