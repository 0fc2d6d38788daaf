"""Cases of the verification manual that others have published with numbers: NAFEMS, code_aster, a patch test."""

from functools import partial

import numpy as np

from drivers._common import make_mesh
from drivers.cases import nafems
from drivers.studies._harness import composed
from drivers.studies._manual import Case, points_of, record_of
from meshes import cylinder_on_block, rounded_punch, sphere_stack, two_blocks
from meshes.grid import name_boundary, near
from meshes.patches import patches, rectangle
from pcontact.scene.model import (
    Contact,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Steps,
)

SIDE = 0.04
# of the plate's lower edge
GRECO_POINTS = {"A": 0.0, "C": 0.005, "S": SIDE}


def patch(folder, n):
    """Largest difference of the pressure from the exact one, over it, plus 1. *Collective.*"""
    path = make_mesh(two_blocks, folder / "blocks.msh", 2, (3 * n, n), (4 * n, n), size=2.0)
    scene = composed(
        MeshSpec(path, order=1),
        dict.fromkeys(("lower", "upper"), Material(2e6, 0.0)),
        {"lower_bottom": ["free", 0.0], "upper_top": ["free", -0.1], "left": [0.0, "free"]},
        contacts=[Contact("upper_bottom", "lower_top", name="patch")],
        petsc={"pc_type": "lu", "snes_rtol": "1e-13"},
    )
    points = points_of(scene, folder)
    return float(points["pressure"][np.abs(points["pressure"] / 1e5 - 1.0).argmax()])


def plate(path, n):
    """A square plate, n cells along it, with the points A to E of its lower edge."""
    line = np.linspace(0.0, SIDE, n + 1)
    with patches(path, {name: ("plate", (x, 0.0)) for name, x in GRECO_POINTS.items()}) as bodies:
        bodies["plate"] = name_boundary(rectangle(line, line), bottom=near(1, 0.0), top=near(1, SIDE),
                                        left=near(0, 0.0), right=near(0, SIDE))  # fmt: skip


def greco(folder, n):
    """Displacement of the corner of a plate that slides on a rigid plane. *Collective.*"""
    floor = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0])
    scene = composed(
        MeshSpec(make_mesh(plate, folder / "plate.msh", n), order=2),
        {"plate": Material(1.3e11, 0.2)},
        {"right": [0.0, "free"]},
        contacts=[Contact("bottom", obstacle=floor, name="plane", friction=1.0)],
        loads=[Load("top", pressure=5e7), Load("left", pressure=15e7)],
        steps=Steps(count=5),
        output=Output(probes=["A"]),
    )
    record = record_of(scene, folder)
    return float(record["probes"]["A"]["mean"][0])


def spheres(what, folder, n):
    """Force on the rim of the lower plate, or how far it sags, n cells in a unit of length. *Collective.*"""
    pairs = (("small_upper", "top_under"), ("large_upper", "small_lower"), ("large_lower", "bottom_over"))
    scene = composed(
        MeshSpec(make_mesh(sphere_stack, folder / "stack.msh", 1.0 / n, 2), order=2, kinematics="axisymmetric"),
        dict.fromkeys(("top_plate", "small", "large", "bottom_plate"), Material(2e5, 0.3)),
        {"bottom_rim": [0.0, 0.0], "top": ["free", -2.0], "axis": [0.0, "free"]},
        contacts=[Contact(*pair, name=pair[0]) for pair in pairs],
        steps=Steps(count=10),
        output=Output(probes=["bottom_centre"]),
        petsc={"pc_type": "lu"},
    )
    record = record_of(scene, folder)
    if what == "sag":
        return -float(record["probes"]["bottom_centre"]["mean"][1])
    return abs(float(record["reactions"]["bottom_rim"][1])) / (2.0 * np.pi)


def roller(folder, n):
    """Return the way down of the middle of the block, CGS-1, n cells in the half width of the contact. *Collective.*"""
    path = make_mesh(cylinder_on_block, folder / "roller.msh", 6.2146 / n, 2, "quadrilateral", radius=50.0, width=200.0,
                     depth=200.0, half=True, contact_radius=9.0)  # fmt: skip
    more = {"steps": Steps(count=2), "output": Output(probes=["block_origin"])}
    record = record_of(nafems.roller_scene(path, 0.0, "small", **more), folder)
    return -float(record["probes"]["block_origin"]["mean"][1])


def punch(friction, folder, n):
    """Return the way down of the middle of the block of CGS-2, cells of 100 / n. *Collective.*"""
    path = make_mesh(rounded_punch, folder / "punch.msh", 100.0 / n, 2, "quadrilateral")
    more = {"steps": Steps(count=2), "output": Output(probes=["block_centre"])}
    record = record_of(nafems.punch_scene(path, friction, "small", **more), folder)
    return -float(record["probes"]["block_centre"]["mean"][1])



KONTER = "A. W. A. Konter, *Advanced Finite Element Contact Benchmarks*, NAFEMS 2006 (R0094)"
ROLLER = r"""     |  o       cylinder, pressed
     |    \\
     |____/______  x
     |   block   |
     |___________|  held"""

ROLLER_LAW = (
    "The reference is not that of small strain: the runs quoted (GROT_GDEP) have a stress that is linear in Green and "
    "Lagrange's strain, which is softer under compression. CalculiX, with 328 cells of 8 nodes, comes to 1.3090 with "
    "that law and to 1.2725 with small strain, 0.2 % from ours."
)
UNCONVERGED = (
    "The reference is not converged: with cells of degree 1 on the same mesh it is {}, and on finer meshes ours goes "
    "away from both."
)

CASES = {
    "patch": Case(
        "Contact patch test",
        "Plane strain, two blocks of 2 by 1 each, E = 2e6, nu = 0, no friction. The lower one is held below, the "
        "upper one is pressed down by 0.1. Quadrilaterals of degree 1, 3 n and 4 n of them along the blocks: meshes "
        "do not match.",
        "     _____v_____\n    |___upper___|\n    |___lower___|",
        "N. El-Abbasi, K. J. Bathe, Computers & Structures 79 (2001) 1473-1486; code_aster SSNP121",
        "the pressure that is farthest from it [stress]", 1e5, (1, 2, 4), patch, (1e-9, 1e-9),
    ),
    "greco": Case(
        "A plate that slides on a rigid plane",
        f"GRECO's benchmark, code_aster SSNV128. Plane strain, a square plate of {SIDE:g}, E = 1.3e11, nu = 0.2, on a "
        "rigid plane, friction 1. A pressure of 5e7 on its upper side, of 15e7 on its left one; the right one is held "
        "along x. Cells of degree 2, n of them along a side.",
        "      | | | 5e7\n  ->  _______\n  -> |       |o\n  -> |_______|o\n  A  ---------  plane",
        "code_aster V6.04.128, numbers of GRECO, to three digits", "displacement of the corner A along x [length]",
        2.86e-5, (8, 16, 32), greco, (3e-2, 1.5e-2),
        "code_aster's own results are between 2.85e-5 and 2.87e-5; it allows 5 %.",
    ),
    "sphere_stack_force": Case(
        "Spheres between plates: force",
        "code_aster SSNA102. Axial symmetry, spheres of the radii 5 and 10 between a plate of radius 20 and thickness "
        "4 that is held at its rim, and one of 10 and 2, whose upper side goes down by 2. E = 2e5, nu = 0.3, no "
        "friction, small strain. Cells of degree 2, n of them in a unit of length where bodies touch.",
        "     |____|      upper plate\n     |  )\n     |_)         small sphere\n     |   )\n     |___)       "
        "large sphere\n     |_________| rim is held",
        "code_aster V6.01.102, the mean of Abaqus, Systus and Samcef", "force per radian [force]", 17229.58, (2, 3, 5),
        partial(spheres, "force"), (5e-2, 3e-2),
        "code_aster's own meshes give 17497 to 17501, 1.6 % above.", tiny=False,
    ),
    "sphere_stack_sag": Case(
        "Spheres between plates: deflection",
        "The data of [the force](sphere_stack_force.md).", "     see there",
        "code_aster V6.01.102, the mean of Abaqus, Systus and Samcef", "deflection of the lower plate's middle "
        "[length]", 0.81,
        (2, 3, 5), partial(spheres, "sag"), (6e-2, 5e-2),
        "code_aster's own meshes give 0.8413; it allows 4 %.", tiny=False,
    ),
    "nafems_roller": Case(
        "NAFEMS CGS-1: a roller on a block",
        "Plane strain, a cylinder of radius 50, E = 210e3, is pressed with 35e3 on a block of 200 by 200, E = 70e3, "
        "both nu = 0.3, no friction; data of `drivers/cases/nafems.py`. Cells of degree 2, n of them in the half "
        "width of the contact.",
        ROLLER, f"{KONTER}, as code_aster V6.03.154 quotes it", "how far the middle of the block's upper side goes "
        "down [length]", 1.308, (4, 8, 12), roller,
        (4e-2, 3.5e-2), ROLLER_LAW, tiny=False,
    ),
    "nafems_punch": Case(
        "NAFEMS CGS-2: a punch with a rounded edge",
        "Axial symmetry, a punch of radius 50, E = 210e3, whose edge is rounded by 10, is pressed by 100 per area on "
        "a block of radius 100 and height 200, E = 70e3, both nu = 0.3, no friction; data of "
        "`drivers/cases/nafems.py`. Cells of degree 2, "
        "n of them in 100.", ROLLER.replace("cylinder", "punch"),
        f"{KONTER}, cells of degree 2, as code_aster V6.01.122 quotes it", "how far the middle of the block's upper "
        "side goes "
        "down [length]", 0.13294, (10, 20, 40), partial(punch, 0.0), (2e-2, 1e-2),
        UNCONVERGED.format(0.13073), tiny=False,
    ),
    "nafems_punch_friction": Case(
        "NAFEMS CGS-2 with friction",
        "The data of [CGS-2](nafems_punch.md), with friction 0.1.", ROLLER.replace("cylinder", "punch"),
        f"{KONTER}, cells of degree 2, as code_aster V6.01.122 quotes it", "how far the middle of the block's upper "
        "side goes "
        "down [length]", 0.13079, (10, 20, 40), partial(punch, 0.1), (2e-2, 1e-2),
        UNCONVERGED.format(0.12858), tiny=False,
    ),
}  # fmt: skip
