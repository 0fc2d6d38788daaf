"""Cases of the verification manual with friction: cylinders that are sheared, a belt."""


import numpy as np

from drivers._common import make_mesh
from drivers.cases import cattaneo_mindlin
from drivers.studies._harness import composed
from drivers.studies._manual import JOHNSON, RUN, Case, need, record_of
from drivers.studies._manual_half_space import CYLINDERS
from meshes.grid import name_boundary, near
from meshes.patches import patches, rectangle, sector
from pcontact.scene.model import Contact, Load, Material, MeshSpec, Obstacle, Output, Steps

# of half of a bar between two jaws: height, modulus; friction, part of it that slips; clamped by a pressure of 1
THIN, STIFF, HELD, SLIPS = 5e-3, 1e4, 0.5, 0.6
# of the belt: thickness, friction, angle [degrees]
BELT, GRIP, WRAP = 4e-3, 0.3, 90.0


def sheared(folder, n):
    """Half width of the part that sticks over its closed form, n facets in that of the contact. *Collective.*"""
    args = cattaneo_mindlin.make_options().parse_args(["--order", "2", "--fields"])
    args.h = cattaneo_mindlin.CASE.half_width / n
    cattaneo_mindlin.check(args)
    mesh = cattaneo_mindlin.generate(folder / "cylinders.msh", args)
    row, _, converged = cattaneo_mindlin.solve(mesh, args, 0.0, folder / RUN)
    need(converged)
    return row["c_fit"] / row["c_exact"]


def belt(path, n):
    """A quarter of a thin ring of the inner radius 1, n cells along it."""
    with patches(path) as bodies:
        grid = sector([1.0, 1.0 + BELT], np.linspace(0.0, WRAP, n + 1))
        inside = lambda x: np.hypot(x[..., 0], x[..., 1]).max(axis=1) < 1.0 + 0.5 * BELT  # noqa: E731
        bodies["belt"] = name_boundary(grid, "outside", held=near(1, 0.0), drawn=near(0, 0.0), inside=inside)


def capstan(folder, n):
    """Ratio of the forces at the ends of a belt around a rigid drum. *Collective.*"""
    drum = Obstacle("sphere", center=[0.0, 0.0], radius=1.0)
    scene = composed(
        MeshSpec(make_mesh(belt, folder / "belt.msh", n), order=2),
        {"belt": Material(1e4, 0.0)},
        {"held": ["free", 0.0]},
        contacts=[Contact("inside", obstacle=drum, name="drum", friction=GRIP)],
        loads=[Load("drawn", traction=[-1.0, 0.0])],
        steps=Steps(count=4),
    )
    record = record_of(scene, folder)
    return BELT / abs(float(record["reactions"]["held"][1]))


def half_bar(path, n):
    """The lower half of a bar of length 1, n cells along it."""
    with patches(path) as bodies:
        grid = rectangle(np.linspace(0.0, 1.0, n + 1), np.linspace(0.0, THIN, 3))
        bodies["bar"] = name_boundary(grid, "end", clamped=near(1, 0.0), middle=near(1, THIN), drawn=near(0, 1.0))


def lap_joint(folder, n):
    """Shift of the drawn end of a bar between two jaws over its closed form. *Collective.*"""
    jaw = Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0], displacement=[0.0, THIN / STIFF],
                   amplitude=[[0.0, 0.0], [1.0, 1.0]])  # fmt: skip
    scene = composed(
        MeshSpec(make_mesh(half_bar, folder / "bar.msh", n), order=2),
        {"bar": Material(STIFF, 0.0)},
        {"middle": ["free", 0.0]},
        contacts=[Contact("clamped", obstacle=jaw, name="jaw", friction=HELD)],
        loads=[Load("drawn", traction=[SLIPS * HELD / THIN, 0.0], amplitude=[[1.0, 0.0], [4.0, 1.0]])],
        steps=Steps(end=4.0, count=4),
        output=Output(probes=["drawn"]),
        petsc={"pc_type": "lu"},
    )
    exact = (SLIPS * HELD) ** 2 / (2.0 * STIFF * THIN * HELD)
    return float(record_of(scene, folder)["probes"]["drawn"]["mean"][0]) / exact


MINDLIN = f"C. Cattaneo 1938, R. D. Mindlin 1949; {JOHNSON}, chapter 7"

CASES = {
    "cattaneo_mindlin": Case(
        "Cattaneo and Mindlin", "Cylinders in plane strain, pressed, then sheared by less than friction bears; data of "
        "`drivers/cases/cattaneo_mindlin.py`. Cells of degree 2, n facets in the half width of the contact.",
        CYLINDERS, MINDLIN, "half width of the part that sticks, fitted, over the closed "
        "form", 1.0, (6, 11, 22), sheared,
        (1e-1, 2e-2),
        "The closed form is that of half planes, cylinders are none: with a quarter of displacement and shear, which "
        "halves the contact, and 22 facets in it the error is -0.49 %, with a 16th -0.48 %. What is left there is the "
        "fit to tractions at the points: over the inner 50, 70, 80 (as here) and 90 % of the part that sticks it gives "
        "+0.97, +0.22, -0.48 and -0.37 %, while the half width of the contact is off by -0.04 %.", tiny=False,
    ),
    "capstan": Case(
        "A belt around a drum",
        f"Plane strain, a belt of thickness {BELT:g}, E = 1e4, nu = 0, around a quarter of a rigid drum of radius 1, "
        f"friction {GRIP:g}. One end is held along the belt, a traction draws the other one. Curved cells of degree "
        "2, n "
        "along the belt.", """  <-- drawn
       ---__
             `-.   belt
       drum     \\
                |
              held""",
        "exp(mu angle), L. Euler 1769, J. A. Eytelwein 1808", "ratio of the forces at the ends",
        float(np.exp(GRIP * np.radians(WRAP))), (10, 20, 40), capstan, (2e-2, 3e-3),
        f"The friction acts at the radius 1, the force of the belt in its middle: its ratio is less by "
        f"{BELT / 2 * GRIP * np.radians(WRAP):.1%}.",
    ),
    "lap_joint": Case(
        "A clamped joint that slips in part",
        f"Plane strain, a bar of length 1 and thickness {2.0 * THIN:g}, E = {STIFF:g}, nu = 0, between two rigid jaws "
        f"that press it by 1, friction {HELD:g}; one end is drawn by {SLIPS:g} of what friction bears. The lower half "
        "is computed, cells of degree 2, n along it.",
        "    ======================  jaw\n    |         bar        |-->  drawn\n    ======================  jaw",
        "shift F^2 / (2 E A mu p), a slip of the length F / (mu p): the force in a thin bar falls by mu p in a unit of "
        "length; A. F. Metherell, S. V. Diller, J. Appl. Mech. 35 (1968) 123-128, a lap joint under uniform pressure",
        "shift of the drawn end over the closed form", 1.0, (50, 100, 200), lap_joint, (5e-3, 4e-3),
        "The closed form is that of a thin bar: with four times the thickness the error is -1.05 %.",
    ),
}  # fmt: skip
