"""The verification manual: cases with a reference that is not ours, under refinement, each with a bound.

    mpirun -n 2 python drivers/studies/verification.py -o DIR                               # all cases, all meshes
    python drivers/studies/verification.py --cases rotating_shrink_fit -o DIR               # one of them
    python drivers/studies/verification.py -o DIR --publish docs/verification               # and their pages

The exit status is 1 where a case misses its bound on its finest mesh; `--tiny` takes the coarsest one, with a bound of
its own.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers._common import main, make_mesh, make_parser, print_table, running, write_json
from drivers.cases import cattaneo_mindlin, hertz
from drivers.cases.rings import LARGE, MIDDLE, NU, SMALL, E, interface_pressure, measure, ring_scene
from meshes import indent, one_block, rings
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene

TIMOSHENKO = "S. P. Timoshenko, J. N. Goodier, *Theory of Elasticity*, 3rd ed., McGraw-Hill 1970, chapter 4"
JOHNSON = "K. L. Johnson, *Contact Mechanics*, Cambridge University Press 1985, section 4.3 (elastic foundation)"
JOHNSON_CONE = "K. L. Johnson, *Contact Mechanics*, Cambridge University Press 1985, section 5.2"
JOHNSON_HERTZ = "K. L. Johnson, *Contact Mechanics*, Cambridge University Press 1985, chapter 4"
JOHNSON_MINDLIN = "K. L. Johnson, *Contact Mechanics*, Cambridge University Press 1985, chapter 7"
OVERLAP, DENSITY, SPEED = 6e-4, 1.0e3, 20.0
BALL, DEPTH, SLOPE = 100.0, 0.004, 100.0
CONE = 0.01


class Case(NamedTuple):
    """A case of the manual.

    Attributes
    ----------
    title, data, sketch, source : str
        What its page says; ``source``: of the reference.
    quantity : str
        What is compared, with its unit.
    reference : float
    levels : tuple of int
        Of the meshes, the coarsest first.
    solve : callable
        From a folder and a level to the value; None where a load step did not converge. *Collective.*
    bounds : (float, float)
        Of the relative error on the coarsest and on the finest mesh.
    remark : str
    """

    title: str
    data: str
    sketch: str
    source: str
    quantity: str
    reference: float
    levels: tuple
    solve: Callable
    bounds: tuple
    remark: str = ""


def _mean_pressure(scene, pressure, delta):
    with running(scene) as (simulation, converged):
        return measure(simulation, pressure, delta)["mean_pressure"] if converged else None


def pressed_rings(folder, n):
    """Mean contact pressure of rings that are pressed from outside. *Collective.*"""
    path = make_mesh(rings, folder / f"rings_{n}.msh", n=n, order=2)
    return _mean_pressure(ring_scene(path, 2, 0.0), 1e7, 0.0)


def _shrunk(folder, n):
    """Rings that touch in the mesh, with an overlap that the scene says."""
    scene = ring_scene(make_mesh(rings, folder / f"rings_{n}.msh", n=n, order=2), 2, 0.0, pressure=0.0)
    return replace(scene, contacts=[replace(scene.contacts[0], clearance=-OVERLAP)])


def shrink_fit(folder, n):
    """Mean contact pressure of rings with an interference. *Collective.*"""
    return _mean_pressure(_shrunk(folder, n), 0.0, OVERLAP)


def rotating_shrink_fit(folder, n):
    """The same of rings that turn about their axis. *Collective.*"""
    scene = _shrunk(folder, n)
    scene.materials["ring"] = replace(scene.materials["ring"], density=DENSITY)
    scene.loads = [Load(name, angular_speed=SPEED, point=(0.0, 0.0)) for name in ("outer", "inner")]
    return _mean_pressure(scene, 0.0, OVERLAP)


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


def ball_on_foundation(folder, n):
    """Force of a rigid ball on a soft layer, on a body a million times as stiff. *Collective.*"""
    path = make_mesh(one_block, folder / f"bed_{n}.msh", dim=2, n=(2 * n, 2), size=(2.0, 0.5), lower=(0.0, -0.5))
    ball = Obstacle("sphere", center=[0.0, BALL], radius=BALL, displacement=[0.0, -DEPTH])
    scene = Scene(
        mesh=MeshSpec(path, kinematics="axisymmetric"),
        materials={"base": Material(1e8, 0.3)},
        bodies=[Body("block", "base")],
        contacts=[Contact("top", obstacle=ball, name="ball", pressure_overclosure=SLOPE)],
        displacements=[Displacement("bottom", [0.0, 0.0]), Displacement("left", [0.0, "free"])],
        output=Output(fields=False),
    )
    with running(scene) as (simulation, converged):
        if not converged:
            return None
        state = simulation.problem.contacts[0].state(simulation.stepper.u)
        return float(-simulation.comm.allreduce(state["traction"][:, 1] @ state["weight"], op=MPI.SUM))


def cone(folder, n):
    """Mean pressure under a rigid cone, n cells in the radius of the contact. *Collective.*"""
    path = make_mesh(indent, folder / f"cone_{n}.msh", h=1.0 / n, order=2, fine=1.5, length=20.0)
    tip = Obstacle("level_set", expression=f"{CONE}*x - y", displacement=[0.0, -0.5 * np.pi * CONE])
    scene = Scene(
        mesh=MeshSpec(path, order=2, kinematics="axisymmetric"),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("block", "m")],
        contacts=[Contact("block_top", obstacle=tip, name="cone")],
        displacements=[Displacement("block_bottom", [0.0, 0.0]), Displacement("axis", [0.0, "free"])],
        output=Output(fields=False),
    )
    with running(scene) as (simulation, converged):
        if not converged:
            return None
        state = simulation.problem.contacts[0].state(simulation.stepper.u)
        force, area = -state["traction"][:, 1] @ state["weight"], state["weight"][state["status"] > 0].sum()
        force, area = simulation.comm.allreduce(np.array([force, area]), op=MPI.SUM)
        return float(force / area)


def hertz_peak(name, folder, n):
    """Peak pressure over that of Hertz for the computed force, n facets in the half width. *Collective.*"""
    args = hertz.make_options().parse_args(["--case", name, "--order", "2"])
    case = hertz.check(args)
    mesh = hertz.generate(case, folder / f"{name}_{n}.msh", case.half_width / n, 2, None)
    row, _, converged = hertz.solve(case, mesh, args)
    return row["p0_fit"] / row["p0_hertz"] if converged else None


def sheared(folder, n):
    """Half width of the part that sticks over its closed form, n facets in that of the contact. *Collective.*"""
    args = cattaneo_mindlin.make_options().parse_args(["--order", "2"])
    args.h = cattaneo_mindlin.CASE.half_width / n
    cattaneo_mindlin.check(args)
    row, _, converged = cattaneo_mindlin.solve(cattaneo_mindlin.generate(folder / f"sheared_{n}.msh", args), args, 0.0)
    return row["c_fit"] / row["c_exact"] if converged else None


CYLINDERS = r"""     \   upper   /
      \_       _/
     ___`-----'___  x
     _-' lower '-_
    /             `"""
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

CASES = {
    "pressed_rings": Case(
        "Concentric rings under pressure", f"{RING_DATA} A pressure of 1e7 on the outer circle.", RINGS,
        f"Lame's ring, {TIMOSHENKO}", "mean contact pressure [stress]",
        interface_pressure(1e7, 0.0), (4, 8, 16), pressed_rings, (5e-3, 2e-4),
    ),
    "shrink_fit": Case(
        "Shrink fit", f"{RING_DATA} The rings touch in the mesh; the contact has `clearance = {-OVERLAP:g}`.", RINGS,
        f"Lame's rings for a small interference, {TIMOSHENKO}", "mean contact pressure [stress]",
        interface_pressure(0.0, 1e-6 * OVERLAP) * 1e6, (4, 8, 16), shrink_fit, (5e-3, 2e-4),
    ),
    "rotating_shrink_fit": Case(
        "Rotating shrink fit",
        f"{RING_DATA} An interference of {OVERLAP:g}, density {DENSITY:g}, angular speed {SPEED:g}.", RINGS,
        f"superposition of Lame's and of rotating rings, {TIMOSHENKO}", "mean contact pressure [stress]",
        rotating_pressure(), (4, 8, 16), rotating_shrink_fit, (5e-3, 5e-4),
    ),
    "ball_on_foundation": Case(
        "A rigid ball on an elastic foundation",
        f"Axial symmetry. A ball of radius {BALL:g} goes down by {DEPTH:g}; `pressure_overclosure = {SLOPE:g}` between "
        "it and a base with E = 1e8. n cells in a unit of length.",
        "     |     _-\n     | __--     ball\n     |==========|  layer, no mesh\n     |__________|  base",
        f"P = pi K R d^2 of a bed of springs of the stiffness K, {JOHNSON}", "force [force]",
        np.pi * SLOPE * BALL * DEPTH**2, (4, 8, 16, 32), ball_on_foundation, (2e-2, 2e-3),
        "The closed form is that of a paraboloid: a ball has about 0.005 % less.",
    ),
    "cone": Case(
        "A rigid cone on a half space",
        f"Axial symmetry. A cone whose flank falls by {CONE:g} towards its tip goes down until the radius of the "
        "contact is about 1; block of 20 by 20, E = 1000, nu = 0.3, no friction. Cells of degree 2, n in that radius.",
        "     |       _--  cone\n     |   _---\n   __|_--____________  r\n     |\n     |  block",
        "p = E / (2 (1 - nu^2)) tan(angle of the flank), I. N. Sneddon, Int. J. Engng. Sci. 3 (1965) 47-57; "
        f"{JOHNSON_CONE}", "mean contact pressure [stress]",
        0.5 * CONE * 1000.0 / 0.91, (5, 10, 20), cone, (1e-1, 2e-2),
        "The radius is that of the points that are closed.",
    ),
    "hertz_cylinders": Case(
        "Two cylinders", "Plane strain, half cylinders pressed by a force, no friction; data of "
        "`drivers/cases/hertz.py --case cylinders`. Cells of degree 2, n facets in the half width of the contact.",
        CYLINDERS, f"Hertz, {JOHNSON_HERTZ}", "peak pressure, fitted, over that of the closed form for the force", 1.0,
        (5, 10, 20), partial(hertz_peak, "cylinders"), (2e-2, 3e-3),
    ),
    "hertz_ball": Case(
        "A ball on a block", "A quarter of an elastic ball on an elastic block, no friction; data of "
        "`drivers/cases/hertz.py --case ball_on_block`. Cells of degree 2, n facets in the radius of the contact.",
        CYLINDERS.replace("lower", "block"), f"Hertz, {JOHNSON_HERTZ}",
        "peak pressure, fitted, over that of the closed form for the force", 1.0, (3, 5, 8),
        partial(hertz_peak, "ball_on_block"), (3e-2, 6e-3),
    ),
    "cattaneo_mindlin": Case(
        "Cattaneo and Mindlin", "Cylinders in plane strain, pressed, then sheared by less than friction bears; data of "
        "`drivers/cases/cattaneo_mindlin.py`. Cells of degree 2, n facets in the half width of the contact.",
        CYLINDERS, f"Cattaneo 1938, Mindlin 1949; {JOHNSON_MINDLIN}",
        "half width of the part that sticks, fitted, over the closed form", 1.0, (6, 11, 22), sheared, (1e-1, 2e-2),
        "The closed form is that of half planes; cylinders are none, and the width that sticks is fitted to tractions "
        "at the points: the error does not go on to fall with the mesh.",
    ),
}  # fmt: skip


def verify(name, folder, tiny=False):
    """Rows (level, value, relative error) of a case, and whether it meets its bound. *Collective.*"""
    case = CASES[name]
    rows = []
    for level in case.levels[:1] if tiny else case.levels:
        value = case.solve(folder, level)
        if value is None:
            return rows, False
        rows.append((level, value, value / case.reference - 1.0))
    return rows, bool(abs(rows[-1][2]) <= case.bounds[0 if tiny else 1])


def page(name, rows):
    """The page of a case."""
    case = CASES[name]
    table = [f"| {level} | {value:.6g} | {100.0 * error:+.3g} % |" for level, value, error in rows]
    return "\n".join([
        f"# {case.title}", "", *_wrapped(case.data), "", "```", case.sketch, "```", "",
        *_wrapped(f"Compared: {case.quantity}. Reference: {case.reference:.6g}, {case.source}."), "",
        "| n | computed | error |", "|---|---|---|", *table, "",
        *([*_wrapped(case.remark), ""] if case.remark else []),
        f"Bound of the finest mesh: {100.0 * case.bounds[1]:g} %. The command:", "",
        f"    python drivers/studies/verification.py --cases {name} -o DIR", "",
    ])  # fmt: skip


def _wrapped(text):
    """Lines of at most 120 characters."""
    lines = [""]
    for word in text.split():
        lines = [*lines[:-1], f"{lines[-1]} {word}".strip()] if len(lines[-1]) + len(word) < 120 else [*lines, word]
    return lines


def publish(folder, results):
    """Write the pages of some cases, and the list of all that have one."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in results.items():
        (folder / f"{name}.md").write_text(page(name, rows))
    listed = [f"| [{case.title}]({name}.md) | {case.quantity} | {case.source} |"
              for name, case in CASES.items() if (folder / f"{name}.md").is_file()]  # fmt: skip
    (folder / "index.md").write_text("\n".join([
        "# Verification manual", "",
        "Cases with a reference that is not ours, one page each, made by",
        "`python drivers/studies/verification.py -o DIR --publish docs/verification`. The driver is a test, too: its",
        "exit status is 1 where a case misses its bound. More cases are in [verification.md](../verification.md).", "",
        "| case | compared | reference |", "|---|---|---|", *listed, "",
    ]))  # fmt: skip


def run(args):
    """All cases that are asked for."""
    for name in args.cases:
        if name not in CASES:
            raise InputError(f"command line: --cases: found {name!r}, allowed: {', '.join(CASES)}")
    results, good = {}, True
    for name in args.cases:
        rows, held = verify(name, args.o, args.tiny)
        results[name], good = rows, good and held
        title = f"{CASES[name].title}: reference {CASES[name].reference:.6g}, {'held' if held else 'MISSED'}"
        print_table(title, ["n", "computed", "error"], rows)
    write_json(args.o / "verification.json", results)
    if args.publish is not None and not args.tiny:
        on_root(MPI.COMM_WORLD, publish, args.publish, results)
    return 0 if good else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "verification_results")
    parser.add_argument("--cases", nargs="+", default=list(CASES), metavar="NAME", help="default: all")
    parser.add_argument("--publish", type=Path, metavar="DIR", help="write the pages there")
    main(run, parser)
