"""Cases of the verification manual with friction: cylinders and a ball that are sheared, a belt."""

import numpy as np

from drivers._common import make_mesh
from drivers.cases import cattaneo_mindlin
from drivers.studies._manual import JOHNSON, RUN, Case, points_everywhere, solved
from drivers.studies._manual_half_space import CYLINDERS
from meshes import indent
from meshes.grid import name_boundary, near
from meshes.patches import patches, sector
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Scene, Steps

# of the rigid ball: radius, depth, friction, way along the block, Poisson's ratio of the block
BALL, DEPTH, MU, ALONG, RATIO = 100.0, 0.01, 0.3, 1.6e-3, 0.45
# of the belt: thickness, friction, angle [degrees]
BELT, GRIP, WRAP = 4e-3, 0.3, 90.0


def sheared(folder, n):
    """Half width of the part that sticks over its closed form, n facets in that of the contact. *Collective.*"""
    args = cattaneo_mindlin.make_options().parse_args(["--order", "2", "--fields"])
    args.h = cattaneo_mindlin.CASE.half_width / n
    cattaneo_mindlin.check(args)
    mesh = cattaneo_mindlin.generate(folder / "cylinders.msh", args)
    row, _, converged = cattaneo_mindlin.solve(mesh, args, 0.0, folder / RUN)
    return row["c_fit"] / row["c_exact"] if converged else None


def ball(path):
    """A rigid ball is pressed on an elastic half space, then moved along it by less than friction bears."""
    press, shear = 10, 10
    end = float(press + shear)
    # one amplitude moves the ball, the other one the block
    rigid = Obstacle("sphere", center=[0.0, 0.0, BALL], radius=BALL, displacement=[0.0, 0.0, -DEPTH],
                     amplitude=[(0.0, 0.0), (press, 1.0), (end, 1.0)])  # fmt: skip
    return Scene(
        mesh=MeshSpec(path, order=1, mean_dilatation=True),
        materials={"m": Material(1.0, RATIO)},
        bodies=[Body("block", "m")],
        contacts=[Contact("block_top", obstacle=rigid, name="ball", friction=MU)],
        displacements=[
            Displacement("block_bottom", [-ALONG, 0.0, 0.0], [(0.0, 0.0), (press, 0.0), (end, 1.0)]),
            Displacement("side_y", ["free", 0.0, "free"]),
        ],
        steps=Steps(end=end, count=press + shear),
    )


def dragged_ball(what, folder, n):
    """Radius that sticks, or way of the ball, over Mindlin's, n cells in the radius of the contact. *Collective.*"""
    path = make_mesh(indent, folder / "block.msh", 3, 1.0 / n, 1, fine=1.5, length=60.0, growth=0.5, mirrored=True)
    with solved(ball(path), folder) as (simulation, record):
        points = points_everywhere(simulation)
    if record is None:
        return None
    force = 2.0 * np.abs(points["weight"] @ points["traction"])
    rest = 1.0 - force[0] / (MU * force[2])
    modulus, shear = 1.0 / (1.0 - RATIO**2), 0.5 / (1.0 + RATIO)
    radius = np.cbrt(0.75 * force[2] * BALL / modulus)
    if what == "stick":
        return float(np.sqrt(2.0 * points["weight"][points["status"] == 1].sum() / np.pi) / (radius * np.cbrt(rest)))
    way = 3.0 * MU * force[2] * (2.0 - RATIO) / (16.0 * shear * radius) * (1.0 - rest ** (2.0 / 3.0))
    return float(ALONG / way)


def belt(path, n):
    """A quarter of a thin ring of the inner radius 1, n cells along it."""
    with patches(path) as bodies:
        grid = sector([1.0, 1.0 + BELT], np.linspace(0.0, WRAP, n + 1))
        inside = lambda x: np.hypot(x[..., 0], x[..., 1]).max(axis=1) < 1.0 + 0.5 * BELT  # noqa: E731
        bodies["belt"] = name_boundary(grid, "outside", held=near(1, 0.0), drawn=near(0, 0.0), inside=inside)


def capstan(folder, n):
    """Ratio of the forces at the ends of a belt around a rigid drum. *Collective.*"""
    drum = Obstacle("sphere", center=[0.0, 0.0], radius=1.0)
    scene = Scene(
        mesh=MeshSpec(make_mesh(belt, folder / "belt.msh", n), order=2),
        materials={"m": Material(1e4, 0.0)},
        bodies=[Body("belt", "m")],
        contacts=[Contact("inside", obstacle=drum, name="drum", friction=GRIP)],
        displacements=[Displacement("held", ["free", 0.0])],
        loads=[Load("drawn", traction=[-1.0, 0.0])],
        steps=Steps(count=4),
    )
    with solved(scene, folder) as (_, record):
        return None if record is None else BELT / abs(float(record["reactions"]["held"][1]))


MINDLIN = f"C. Cattaneo 1938, R. D. Mindlin 1949; {JOHNSON}, chapter 7"
BALL_DATA = (
    f"A rigid ball of radius {BALL:g} is pressed by {DEPTH:g} into an elastic block, E = 1, nu = {RATIO:g}, friction "
    f"{MU:g}, in ten load steps; then it is moved along the block by {ALONG:g}, in ten more. Half of the block is "
    "computed, 120 wide and 60 deep; hexahedra of degree 1, n of them in the unit of length, which is about the "
    "radius of the contact."
)
BALL_SKETCH = """       \\  ball  /  -->
        \\_     _/
    ______`---'______  x
    |  block        |"""

CASES = {
    "cattaneo_mindlin": Case(
        "Cattaneo and Mindlin", "Cylinders in plane strain, pressed, then sheared by less than friction bears; data of "
        "`drivers/cases/cattaneo_mindlin.py`. Cells of degree 2, n facets in the half width of the contact.",
        CYLINDERS, MINDLIN, "half width of the part that sticks, fitted, over the closed "
        "form", 1.0, (6, 11, 22), sheared,
        (1e-1, 2e-2),
        "The closed form is that of half planes; cylinders are none, and the width that sticks is fitted to tractions "
        "at the points: the error does not go on to fall with the mesh.", tiny=False,
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
}  # fmt: skip
