"""Cases of the verification manual on half planes and half spaces: punches, a cone, a wave, Hertz, a foundation."""

from functools import partial

import numpy as np

from drivers._common import make_mesh
from drivers.cases import hertz
from drivers.studies._harness import composed
from drivers.studies._manual import JOHNSON, RUN, Case, need, points_of, share
from meshes import indent, one_block
from meshes.grid import name_boundary, near, split_group
from meshes.patches import growing, patches, rectangle
from pcontact.scene.model import Contact, Material, MeshSpec, Obstacle

SNEDDON = "I. N. Sneddon, Int. J. Engng. Sci. 3 (1965) 47-57"
BALL, DEPTH, SLOPE = 100.0, 0.004, 100.0
CONE = 0.01
NU, SINK = 0.3, 1e-3
# of a wave of length 1, which touches in about a third of it
HEIGHT, PRESSED = 2e-3, 2e-3


def half_block(path, n, size):
    """Half a block [0, size] x [-size, 0], below a punch [0, 1]; cells of 1 / n^2 at its end grow by 1 + 3 / n.

    Groups: block; under (below the punch), top, bottom, side, axis.
    """
    step, factor = 1.0 / n**2, 1.0 + 3.0 / n
    inner = 1.0 - growing(step, 0.5, factor)[::-1]
    middle = np.linspace(0.0, 0.5, max(1, round(0.5 / (inner[1] - inner[0]))) + 1)
    lines = np.concatenate([middle[:-1], inner[:-1], 1.0 + growing(step, size - 1.0, factor)])
    with patches(path) as bodies:
        grid = rectangle(lines, -growing(step, size, factor)[::-1])
        grid = name_boundary(grid, top=near(1, 0.0), bottom=near(1, -size, 1e-9 * size),
                             side=near(0, size, 1e-9 * size), axis=near(0, 0.0))  # fmt: skip
        bodies["block"] = split_group(grid, "top", under=lambda x: x[..., 0] < 1.0 + 1e-9)


def pressed_block(path, kinematics, bonded):
    """A rigid flat punch of half width 1 sinks into a block by ``SINK``, E = 1."""
    plane = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, -1.0], displacement=[0.0, -SINK])
    law = {"bilateral": True, "tresca": 1e3} if bonded else {}
    return composed(
        MeshSpec(path, order=2, kinematics=kinematics),
        {"block": Material(1.0, NU)},
        {"bottom": [0.0, 0.0], "axis": [0.0, "free"]},
        contacts=[Contact("under", obstacle=plane, name="punch", **law)],
        petsc={"pc_type": "lu"},
    )


def flat_punch(kinematics, bonded, what, folder, n):
    """Force of a flat punch, or the part of it in the inner half. *Collective.*"""
    path = make_mesh(half_block, folder / "block.msh", n, 60.0 if kinematics == "plane_strain" else 1000.0)
    points = points_of(pressed_block(path, kinematics, bonded), folder)
    part, force = share(points, points["x"][:, 0] < 0.5, [0.0, -1.0])
    return part if what == "part" else force


def bonded_part():
    """Part of the force of a bonded punch on a half plane within half of its half width."""
    eta = np.log(3.0 - 4.0 * NU) / (2.0 * np.pi)
    x, w = np.polynomial.legendre.leggauss(60)

    def over(end):
        angle = 0.5 * end * (x + 1.0)
        return 0.5 * end * w @ np.cos(eta * np.log((1.0 + np.sin(angle)) / (1.0 - np.sin(angle))))

    return 2.0 * (1.0 - NU) / np.sqrt(3.0 - 4.0 * NU) * over(np.pi / 6.0) * 2.0 / np.pi


def wavy_block(path, n):
    """Half a period [0, 1/2] x [-1, 0], n cells along it."""
    with patches(path) as bodies:
        grid = rectangle(np.linspace(0.0, 0.5, n + 1), -growing(0.5 / n, 1.0, 1.2)[::-1])
        bodies["block"] = name_boundary(grid, "sides", top=near(1, 0.0), bottom=near(1, -1.0))


def wave(folder, n):
    """Largest pressure below a wave over its closed form for the mean pressure, n cells in half of it. *Collective.*"""
    path = make_mesh(wavy_block, folder / "block.msh", n)
    shape = Obstacle("level_set", expression=f"{HEIGHT}*(1 - cos(2*pi*x)) - y")
    scene = composed(
        MeshSpec(path, order=2),
        {"block": Material(1.0, NU)},
        {"bottom": [0.0, PRESSED], "sides": [0.0, "free"]},
        contacts=[Contact("top", obstacle=shape, name="wave")],
    )
    points = points_of(scene, folder)
    mean = 2.0 * float(points["pressure"] @ points["weight"])
    edge = points["weight"][points["status"] > 0].sum()
    x = points["x"][:, 0]
    inner = x < 0.8 * edge
    # (p / cos)^2 is linear in sin^2 of pi x
    square = (points["pressure"] / np.cos(np.pi * x)) ** 2
    slope, top = np.polyfit(np.sin(np.pi * x[inner]) ** 2, square[inner], 1)
    return float(np.sqrt(top) / (2.0 * np.sqrt(mean * np.pi * HEIGHT / (1.0 - NU**2))))


def ball_on_foundation(folder, n):
    """Force of a rigid ball on a soft layer, on a body a million times as stiff. *Collective.*"""
    path = make_mesh(one_block, folder / "bed.msh", dim=2, n=(2 * n, 2), size=(2.0, 0.5), lower=(0.0, -0.5))
    ball = Obstacle("sphere", center=[0.0, BALL], radius=BALL, displacement=[0.0, -DEPTH])
    scene = composed(
        MeshSpec(path, kinematics="axisymmetric"),
        {"block": Material(1e8, 0.3)},
        {"bottom": [0.0, 0.0], "left": [0.0, "free"]},
        contacts=[Contact("top", obstacle=ball, name="ball", pressure_overclosure=SLOPE)],
    )
    points = points_of(scene, folder)
    return share(points, slice(None), [0.0, -1.0])[1]


def cone(folder, n):
    """Mean pressure under a rigid cone, n cells in the radius of the contact. *Collective.*"""
    path = make_mesh(indent, folder / "cone.msh", h=1.0 / n, order=2, fine=1.5, length=20.0)
    tip = Obstacle("level_set", expression=f"{CONE}*x - y", displacement=[0.0, -0.5 * np.pi * CONE])
    scene = composed(
        MeshSpec(path, order=2, kinematics="axisymmetric"),
        {"block": Material(1000.0, 0.3)},
        {"block_bottom": [0.0, 0.0], "axis": [0.0, "free"]},
        contacts=[Contact("block_top", obstacle=tip, name="cone")],
    )
    points = points_of(scene, folder)
    force = share(points, slice(None), [0.0, -1.0])[1]
    return float(force / points["weight"][points["status"] > 0].sum())


def hertz_case(name, what, folder, n):
    """Peak pressure or half width over those of Hertz, n facets in the half width. *Collective.*"""
    args = hertz.make_options().parse_args(["--case", name, "--order", "2", "--fields"])
    case = hertz.check(args)
    mesh = hertz.generate(case, folder / "bodies.msh", case.half_width / n, 2, None)
    row, _, converged = hertz.solve(case, mesh, args, folder / RUN)
    need(converged)
    return row[f"{what}_fit"] / row[f"{what}_hertz"]


CYLINDERS = r"""     \   upper   /
      \_       _/
     ___`-----'___  x
     _-' lower '-_
    /             `"""
ON_BLOCK = r"""     \   upper   /
      \_       _/
    ____`-----'____  x
         block"""
PUNCH = """    |  punch  |
    |    |    |
    |____v____|________  x
    |<- 1 ->|
    |        block"""
BLOCK = (
    f"A rigid punch of half width 1 with a flat end sinks by {SINK:g} into a block, E = 1, nu = {NU:g}. Cells of "
    "degree 2, of the size 1 / n^2 at the end of the punch, grow by 1 + 3 / n from one to the next."
)

CASES = {
    "flat_punch": Case(
        "A flat punch on a half plane",
        f"{BLOCK} Plane strain, no friction, a block of 120 by 60, of which the half x >= 0 is computed.", PUNCH,
        f"p = P / (pi sqrt(a^2 - x^2)), {JOHNSON}, section 2.8", "part of the force within half of the half width",
        1.0 / 3.0, (6, 10, 16), partial(flat_punch, "plane_strain", False, "part"), (5e-3, 3e-3),
    ),
    "bonded_punch": Case(
        "A flat punch, bonded to a half plane",
        f"{BLOCK} Plane strain; a Tresca bound of 1000 and `bilateral` hold all points where they are. A block of 120 "
        "by 60, of which the half x >= 0 is computed.", PUNCH,
        "N. I. Muskhelishvili's solution: p = 2 (1 - nu) / sqrt(3 - 4 nu) P / (pi sqrt(a^2 - x^2)) cos(eta ln((a + x) "
        "/ "
        f"(a - x))), eta = ln(3 - 4 nu) / (2 pi), {JOHNSON}, section 2.8", "part of the force within half of the half "
        "width", bonded_part(), (6, 10, 16), partial(flat_punch, "plane_strain", True, "part"), (5e-3, 3e-3),
        "What is left is the size of the block: in one of 480 by 240 the error with n = 6 is -0.011 %.",
    ),
    "round_punch": Case(
        "A circular punch on a half space",
        f"{BLOCK} Axial symmetry, no friction, a block of radius and height 1000.", PUNCH,
        f"P = 2 a E delta / (1 - nu^2), J. Boussinesq 1885; {SNEDDON}; {JOHNSON}, section 3.4", "force [force]",
        2.0 * SINK / (1.0 - NU**2), (6, 9, 14), partial(flat_punch, "axisymmetric", False, "force"), (5e-3, 2e-3),
        "A block of this size gives way by 0.06 % less than a half space.",
    ),
    "bonded_round_punch": Case(
        "A circular punch, bonded to a half space",
        f"{BLOCK} Axial symmetry; a Tresca bound of 1000 and `bilateral` hold all points where they are. A block of "
        "radius and height 1000.", PUNCH,
        "P = 4 G a delta ln(3 - 4 nu) / (1 - 2 nu), V. I. Mossakovskii 1954, D. A. Spence, Proc. R. Soc. A 305 (1968) "
        "55-80", "force [force]",
        2.0 / (1.0 + NU) * SINK * np.log(3.0 - 4.0 * NU) / (1.0 - 2.0 * NU), (6, 9, 14),
        partial(flat_punch, "axisymmetric", True, "force"), (5e-3, 2e-3),
    ),
    "wave": Case(
        "A wavy surface",
        f"Plane strain. A half plane, E = 1, nu = {NU:g}, is pressed on a rigid wave {HEIGHT:g} (1 - cos(2 pi x)), no "
        "friction; half a period and a depth of 1 are computed, cells of degree 2, n of them along it. The mean "
        f"pressure is that of a bottom that moves up by {PRESSED:g}.",
        r"""     -.          .-
       `-.____.-'    wave
     ----------------  x
        half plane""",
        f"p(0) = 2 sqrt(mean pressure * p*), p* = pi E d / (1 - nu^2), d the amplitude, H. M. Westergaard 1939; "
        f"{JOHNSON},"
        " section 13.2", "largest pressure, fitted, over the closed form for the mean pressure", 1.0, (8, 16, 32), wave,
        (5e-3, 2e-3),
    ),
    "ball_on_foundation": Case(
        "A rigid ball on an elastic foundation",
        f"Axial symmetry. A ball of radius {BALL:g} goes down by {DEPTH:g}; `pressure_overclosure = {SLOPE:g}` between "
        "it and a base with E = 1e8. n cells in a unit of length.",
        "     |     _-\n     | __--     ball\n     |==========|  layer, no mesh\n     |__________|  base",
        f"P = pi K R d^2 of a bed of springs of the stiffness K, {JOHNSON}, section 4.3 (elastic foundation)",
        "force [force]",
        np.pi * SLOPE * BALL * DEPTH**2, (4, 8, 16, 32), ball_on_foundation, (2e-2, 2e-3),
        "The closed form is that of a paraboloid: a ball has about 0.005 % less.",
    ),
    "cone": Case(
        "A rigid cone on a half space",
        f"Axial symmetry. A cone whose flank falls by {CONE:g} towards its tip goes down until the radius of the "
        "contact is about 1; block of 20 by 20, E = 1000, nu = 0.3, no friction. Cells of degree 2, n in that radius.",
        "     |       _--  cone\n     |   _---\n   __|_--____________  r\n     |\n     |  block",
        f"p = E / (2 (1 - nu^2)) tan(angle of the flank), {SNEDDON}; {JOHNSON}, section 5.2",
        "mean contact pressure [stress]",
        0.5 * CONE * 1000.0 / 0.91, (5, 10, 20), cone, (1e-1, 2e-2),
        "The radius is that of the points that are closed.",
    ),
    "hertz_cylinders": Case(
        "Two cylinders", "Plane strain, half cylinders pressed by a force, no friction; data of "
        "`drivers/cases/hertz.py --case cylinders`. Cells of degree 2, n facets in the half width of the contact.",
        CYLINDERS, f"Hertz, {JOHNSON}, chapter 4", "peak pressure, fitted, over that of the closed form for the force",
        1.0, (5, 10, 20), partial(hertz_case, "cylinders", "p0"), (2e-2, 3e-3),
    ),
    "hertz_cylinder_on_block": Case(
        "A cylinder on a block", "Plane strain, a half cylinder pressed by a force on a block, no friction; data of "
        "`drivers/cases/hertz.py --case cylinder_on_block`. Cells of degree 2, n facets in the half width of the "
        "contact.",
        ON_BLOCK, f"Hertz, {JOHNSON}, chapter 4", "half width, fitted, over that of the closed form for the force",
        1.0, (5, 10, 20), partial(hertz_case, "cylinder_on_block", "a"), (2e-2, 3e-3), tiny=False,
    ),
    "hertz_ball": Case(
        "A ball on a block", "A quarter of an elastic ball on an elastic block, no friction; data of "
        "`drivers/cases/hertz.py --case ball_on_block`. Cells of degree 2, n facets in the radius of the contact.",
        CYLINDERS.replace("lower", "block"), f"Hertz, {JOHNSON}, chapter 4",
        "peak pressure, fitted, over that of the closed form for the force", 1.0, (3, 5, 8),
        partial(hertz_case, "ball_on_block", "p0"), (3e-2, 6e-3), tiny=False,
    ),
}  # fmt: skip
