"""Cases of the verification manual with concentric bodies: shrink fits, spheres, tied beams, a plastic cylinder."""

from dataclasses import replace

import numpy as np

from drivers._common import make_mesh
from drivers.cases import thick_cylinder
from drivers.cases.rings import LARGE, MIDDLE, NU, SMALL, E, interface_pressure, measure, ring_scene
from drivers.studies._harness import composed
from drivers.studies._manual import TIMOSHENKO, Case, points_of, record_of, solved
from meshes import rings, two_blocks
from meshes.grid import name_boundary, near
from meshes.patches import patches, sector
from pcontact.scene.model import (
    Contact,
    Load,
    Material,
    MeshSpec,
    Output,
    Temperature,
)

OVERLAP, DENSITY, SPEED = 6e-4, 1.0e3, 20.0
EXPANSION, WARMER = 1.2e-5, 40.0
# code_aster SSNP173's data; the radii are ours
SHELLS, SHELL_E, SHELL_NU, OUTSIDE = (1.0, 0.6, 0.2), 2000.0, 0.3, 25.0
CURVED, MOVED = 1e4, -0.01
STRIP, METAL, PAIR = (20.0, 0.6, 0.4), (200e3, 100e3), (12e-6, 30e-6)
HILL = thick_cylinder.Cylinder(nu=0.4999)
HILL_PRESSURE = 0.18


def _mean_pressure(scene, folder, pressure, delta):
    with solved(scene, folder) as (simulation, _):
        return measure(simulation, pressure, delta)["mean_pressure"]


def _rings(folder, n, pressure=0.0):
    return ring_scene(make_mesh(rings, folder / "rings.msh", n=n, order=2), 2, 0.0, pressure=pressure)


def pressed_rings(folder, n):
    """Mean contact pressure of rings that are pressed from outside. *Collective.*"""
    return _mean_pressure(_rings(folder, n, 1e7), folder, 1e7, 0.0)


def _shrunk(folder, n):
    """Rings that touch in the mesh, with an overlap that the scene says."""
    scene = _rings(folder, n)
    return replace(scene, contacts=[replace(scene.contacts[0], clearance=-OVERLAP)])


def shrink_fit(folder, n):
    """Mean contact pressure of rings with an interference. *Collective.*"""
    return _mean_pressure(_shrunk(folder, n), folder, 0.0, OVERLAP)


def rotating_shrink_fit(folder, n):
    """The same of rings that turn about their axis. *Collective.*"""
    scene = _shrunk(folder, n)
    scene.materials["ring"] = replace(scene.materials["ring"], density=DENSITY)
    scene.loads = [Load(name, angular_speed=SPEED, point=(0.0, 0.0)) for name in ("outer", "inner")]
    return _mean_pressure(scene, folder, 0.0, OVERLAP)


def warm_shrink_fit(folder, n):
    """The same of an inner ring that is warmer than the outer one. *Collective.*"""
    scene = _rings(folder, n)
    scene.materials["ring"] = replace(scene.materials["ring"], expansion=EXPANSION)
    scene.temperatures = [Temperature(WARMER, region="inner")]
    return _mean_pressure(scene, folder, 0.0, EXPANSION * WARMER)


def flung(a, b, r):
    """Radial displacement [length] at r of a ring in plane strain, of the radii a and b, that turns."""
    modulus, ratio = E / (1.0 - NU**2), NU / (1.0 - NU)
    factor, part = (3.0 + ratio) / 8.0 * DENSITY * SPEED**2, (a * b / r) ** 2
    radial = factor * (a**2 + b**2 - part - r**2)
    hoop = factor * (a**2 + b**2 + part - (1.0 + 3.0 * ratio) / (3.0 + ratio) * r**2)
    return r / modulus * (hoop - ratio * radial)


def rotating_pressure():
    """Contact pressure of the rings that turn: what they open is missing in the interference [stress]."""
    opened = flung(MIDDLE, LARGE, MIDDLE) - flung(SMALL, MIDDLE, MIDDLE)
    return interface_pressure(0.0, 1e-6 * (OVERLAP - opened)) * 1e6


def layer(low, high, across, around, name, **sides):
    """A quarter of a ring whose round faces are called NAME_hole and NAME_skin."""
    middle = 0.5 * (low + high)
    grid = sector(np.linspace(low, high, across + 1), np.linspace(0.0, 90.0, around + 1))
    return name_boundary(
        grid, **sides,
        **{f"{name}_skin": lambda x: np.hypot(x[..., 0], x[..., 1]).min(axis=1) > middle,
           f"{name}_hole": lambda x: np.hypot(x[..., 0], x[..., 1]).max(axis=1) < middle},
    )  # fmt: skip


def shells(path, n):
    """A quarter of the section of two hollow spheres whose meshes do not match."""
    large, middle, small = SHELLS
    sides = {"axis": near(0, 0.0), "plane": near(1, 0.0)}
    with patches(path) as bodies:
        bodies["outer"] = layer(middle, large, max(2, n // 2), n, "outer", **sides)
        bodies["inner"] = layer(small, middle, max(2, n // 2), round(1.4 * n), "inner", **sides)


def hollow_spheres(folder, n):
    """Mean contact pressure of hollow spheres that are pressed from outside. *Collective.*"""
    scene = composed(
        MeshSpec(make_mesh(shells, folder / "shells.msh", n), order=2, kinematics="axisymmetric"),
        dict.fromkeys(("outer", "inner"), Material(SHELL_E, SHELL_NU)),
        {"axis": [0.0, "free"], "plane": ["free", 0.0]},
        contacts=[Contact("inner_skin", "outer_hole", name="spheres")],
        loads=[Load("outer_skin", pressure=OUTSIDE)],
    )
    points = points_of(scene, folder)
    return float(np.average(points["pressure"], weights=points["weight"]))


def sphere_pressure():
    """Contact pressure of the hollow spheres [stress]: Lame's u(r) of each is the same where they touch."""
    large, middle, small = SHELLS

    def moved(a, b, inside, outside, r):
        cube = (1.0 - 2.0 * SHELL_NU) * r * (inside * a**3 - outside * b**3)
        return (cube + 0.5 * (1.0 + SHELL_NU) * (inside - outside) * (a * b) ** 3 / r**2) / (b**3 - a**3)

    # linear in the pressure
    gap = [moved(middle, large, p, OUTSIDE, middle) - moved(small, middle, 0.0, p, middle) for p in (0.0, 1.0)]
    return gap[0] / (gap[0] - gap[1])


def half_arcs(path, n):
    """A quarter of a ring 5 <= r <= 10, in two layers whose meshes do not match."""
    sides = {"root": near(0, 0.0), "end": near(1, 0.0)}
    with patches(path, {"pin": ("inner", (0.0, 5.0))}) as bodies:
        bodies["outer"] = layer(7.5, 10.0, n, 2 * n, "outer", **sides)
        bodies["inner"] = layer(5.0, 7.5, n, round(2.8 * n), "inner", **sides)


def curved_beam(folder, n):
    """Force on the end of a curved beam of two layers that are tied. *Collective.*"""
    scene = composed(
        MeshSpec(make_mesh(half_arcs, folder / "arcs.msh", n), order=2, kinematics="plane_stress"),
        dict.fromkeys(("outer", "inner"), Material(CURVED, 0.25)),
        {"end": [MOVED, "free"], "root": [0.0, "free"], "pin": ["free", 0.0]},
        contacts=[Contact("inner_skin", "outer_hole", name="seam", tied=True)],
    )
    record = record_of(scene, folder)
    return -float(record["reactions"]["end"][0])


def bimetal(folder, n):
    """Deflection of the end of a strip of two metals that is warmed. *Collective.*"""
    length, *heights = STRIP
    path = make_mesh(two_blocks, folder / "strip.msh", 2, (10 * n, n), (13 * n, n), size=length, heights=heights,
                     order=2)  # fmt: skip
    metals = [Material(modulus, 0.3, expansion=alpha) for modulus, alpha in zip(METAL, PAIR, strict=True)]
    scene = composed(
        MeshSpec(path, order=2, kinematics="plane_stress"),
        dict(zip(("lower", "upper"), metals, strict=True)),
        {"left": [0.0, "free"], "lower_origin": ["free", 0.0]},
        contacts=[Contact("upper_bottom", "lower_top", name="seam", tied=True)],
        temperatures=[Temperature(WARMER)],
        output=Output(probes=["lower_corner_10"]),
    )
    record = record_of(scene, folder)
    return -float(record["probes"]["lower_corner_10"]["mean"][1])


def bimetal_deflection():
    """Of the strip, half of which is computed."""
    length, low, high = STRIP
    m, n = low / high, METAL[0] / METAL[1]
    bend = 6.0 * (PAIR[1] - PAIR[0]) * WARMER * (1.0 + m) ** 2
    bend /= (low + high) * (3.0 * (1.0 + m) ** 2 + (1.0 + m * n) * (m**2 + 1.0 / (m * n)))
    return 0.5 * bend * length**2


def plastic_cylinder(folder, n):
    """Displacement of the outer face of a cylinder that yields. *Collective.*"""
    path = thick_cylinder.make(folder / "cylinder.msh", "plane", "quadrilateral", 2, n, HILL)
    table = [HILL.first_yield, HILL_PRESSURE]
    scene = thick_cylinder.scene(path, "plane", 2, table, HILL, steps=4, petsc={"pc_type": "lu"})
    record = record_of(scene, folder)
    return float(record["probes"]["outer"]["max"][0])


RINGS = f"""    outer ring {MIDDLE:g} <= r <= {LARGE:g}, inner ring {SMALL:g} <= r <= {MIDDLE:g}
    a quarter, symmetry on x = 0 and y = 0
    y|--__
     |    -_   outer
     |-_    \\
     |  \\ inner
     '---|---|--- x"""
RING_DATA = (
    f"Plane strain, E = {E:g}, nu = {NU:g} of both rings, no friction. Curved cells of degree 2, n of them around the "
    "outer ring; the meshes of the rings do not match."
)
BEAM = """    y|--__     outer layer
     |    -_
     |-_ seam\\
       \\  \\   \\
        `--'---' -> moved    x"""
LAME = f"Lame's ring, {TIMOSHENKO}, chapter 4"

CASES = {
    "pressed_rings": Case(
        "Concentric rings under pressure", f"{RING_DATA} A pressure of 1e7 on the outer circle.", RINGS,
        f"{LAME}; the data are those of code_aster's test SSNP167", "mean contact pressure [stress]",
        interface_pressure(1e7, 0.0), (4, 8, 16), pressed_rings, (5e-3, 2e-4),
    ),
    "shrink_fit": Case(
        "Shrink fit", f"{RING_DATA} The rings touch in the mesh; the contact has `clearance = {-OVERLAP:g}`.", RINGS,
        f"{LAME}, for a small interference", "mean contact pressure [stress]",
        interface_pressure(0.0, 1e-6 * OVERLAP) * 1e6, (4, 8, 16), shrink_fit, (5e-3, 2e-4),
    ),
    "rotating_shrink_fit": Case(
        "Rotating shrink fit",
        f"{RING_DATA} An interference of {OVERLAP:g}, density {DENSITY:g}, angular speed {SPEED:g}.", RINGS,
        f"superposition of Lame's and of rotating rings, {TIMOSHENKO}, chapter 4", "mean contact pressure [stress]",
        rotating_pressure(), (4, 8, 16), rotating_shrink_fit, (7e-3, 5e-4),
    ),
    "warm_shrink_fit": Case(
        "Shrink fit by temperature",
        f"{RING_DATA} The inner ring is warmer by {WARMER:g}, expansion {EXPANSION:g}.", RINGS,
        f"{LAME}, for the interference (1 + nu) alpha dT r", "mean contact pressure [stress]",
        interface_pressure(0.0, 1e-6 * (1.0 + NU) * EXPANSION * WARMER * MIDDLE) * 1e6, (8, 16, 32), warm_shrink_fit,
        (5e-3, 2e-4),
    ),
    "hollow_spheres": Case(
        "Hollow spheres under pressure",
        f"Axial symmetry, radii {', '.join(map(str, SHELLS))}, E = {SHELL_E:g}, nu = {SHELL_NU:g}, a pressure of "
        f"{OUTSIDE:g} on the outer sphere, no friction. Curved cells of degree 2, n of them around the outer sphere; "
        "the meshes do not match.", RINGS.replace("ring", "sphere"),
        f"Lame's hollow sphere, {TIMOSHENKO}, chapter 12", "mean contact pressure [stress]", sphere_pressure(),
        (4, 8, 16), hollow_spheres, (2e-2, 5e-4),
        "Moduli and pressure are those of code_aster's test SSNP173; the radii are ours.",
    ),
    "curved_beam": Case(
        "A curved beam of two layers that are tied",
        f"Plane stress, a quarter of a ring 5 <= r <= 10, E = {CURVED:g}, nu = 0.25; two layers with meshes that do "
        f"not match are tied. The end on y = 0 moves along x by {MOVED:g}, the other one is held along x and in one "
        "point "
        "along y. Curved cells of degree 2, n across a layer.", BEAM,
        f"Golovin's curved bar: P = E u (ln 2 - 3/5) / pi for these radii, {TIMOSHENKO}, chapter 4", "force [force]",
        CURVED * abs(MOVED) * (np.log(2.0) - 0.6) / np.pi, (2, 4, 8), curved_beam, (1e-2, 1e-4),
    ),
    "bimetal": Case(
        "A bimetallic strip",
        f"Plane stress, half a strip of the length {2.0 * STRIP[0]:g}; heights {STRIP[1]:g}, {STRIP[2]:g}, moduli "
        f"{METAL[0]:g}, {METAL[1]:g}, expansion {PAIR[0]:g}, {PAIR[1]:g}, nu = 0.3, warmed by {WARMER:g}. The metals "
        "are tied; their meshes do not match. Cells of degree 2, n over the height of a metal.",
        "    |______________________\n    |_____________upper____|\n    |_____________lower____|  warm: its end goes "
        "down",
        "S. P. Timoshenko, J. Opt. Soc. Am. 11 (1925) 233-255", "deflection of the end [length]", bimetal_deflection(),
        (1, 2, 4), bimetal, (2e-2, 1e-2),
        "The reference is that of a slender strip; near its end the strip is straight.",
    ),
    "plastic_cylinder": Case(
        "A thick cylinder that yields",
        f"Plane strain, radii {HILL.a:g}, {HILL.b:g}, E = {HILL.E:g}, nu = {HILL.nu:g}, perfectly plastic, yield "
        f"stress {HILL.yield_stress:g}, an inner pressure of {HILL_PRESSURE:g}; data of "
        "`drivers/cases/thick_cylinder.py`. "
        "Curved cells of degree 2, n across the wall.", RINGS.split("\n", 1)[1],
        "R. Hill, *The Mathematical Theory of Plasticity*, Clarendon Press 1950, chapter 5",
        "displacement of the outer face [length]", HILL.displacement(HILL_PRESSURE), (4, 8, 16), plastic_cylinder,
        (2e-2, 1e-3),
        "The closed form is that of an incompressible material.",
    ),
}  # fmt: skip
