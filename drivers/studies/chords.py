"""Straight facets on curved surfaces: what their gaps do to the contact pressure, and what smooth_geometry takes back.

    python drivers/studies/chords.py -o chords                    # rings, shells in space, Hertz contact

Concentric rings and shells under an outer pressure (Lame) have surfaces that conform; cylinders and a cylinder on a
block (Hertz) have not. Every case is solved on straight cells as they are, on the same cells with the gaps of the
smooth surfaces, and on cells of degree 2. Errors of the pressure are relative, in L2 at the quadrature points of the
source. `facet_error` is what a run on straight cells says of itself.
"""

from types import SimpleNamespace

import numpy as np

from drivers._common import contact_points, main, make_mesh, make_parser, print_table, running, write_json
from drivers.cases import hertz, rings
from drivers.studies._harness import Counts, composed
from meshes.rings import rings as ring_mesh
from meshes.shells import shells
from pcontact.material.elastic import lame
from pcontact.scene.model import Contact, Load, Material, MeshSpec, Scene

RADII = (1.0, 0.6, 0.3)
# geometry of the cells, smooth_geometry
KINDS = {"straight": (1, False), "smooth": (1, True), "curved": (2, False)}


def shell_pressure(pressure: float = rings.PRESSURE, radii=RADII) -> float:
    """Contact pressure between two shells of the rings' material, under a pressure on the outer one.

    Displacement a r + b / r^2 in each, radial stress (3 lambda + 2 mu) a - 4 mu b / r^3; the unknowns are a and b of
    the outer shell, those of the inner one, and the contact pressure.
    """
    lam, mu = lame(rings.E, rings.NU)
    large, middle, small = radii

    def stress(r):
        return [3.0 * lam + 2.0 * mu, -4.0 * mu / r**3]

    none = [0.0, 0.0]
    rows = [
        [*stress(large), *none, 0.0],
        [*stress(middle), *none, 1.0],
        [*none, *stress(middle), 1.0],
        [*none, *stress(small), 0.0],
        [middle, middle**-2, -middle, -(middle**-2), 0.0],
    ]
    return float(np.linalg.solve(rows, [-pressure, 0.0, 0.0, 0.0, 0.0])[4])


def shell_scene(path, degree: int, **numerics) -> Scene:
    """The scene of two shells; further keys of the contact in `numerics`."""
    planes = [[0.0 if k == axis else "free" for k in range(3)] for axis in range(3)]
    return composed(
        MeshSpec(path, order=degree),
        dict.fromkeys(("outer", "inner"), Material(rings.E, rings.NU)),
        {f"symmetry_{'xyz'[k]}": value for k, value in enumerate(planes)},
        title=f"concentric shells, degree {degree}",
        contacts=[Contact("inner_outer_skin", "outer_inner_skin", name="sphere", **numerics)],
        loads=[Load("outer_skin", pressure=rings.PRESSURE)],
    )


def _ring(args, n, degree, geometry, smooth):
    path = make_mesh(ring_mesh, args.o / f"rings_{n}_{geometry}.msh", n=n, order=geometry)
    scene = rings.ring_scene(path, degree, 0.0, gamma0=None, smooth_geometry=smooth)
    return scene, lambda points: np.full(len(points["x"]), rings.interface_pressure())


def _shell(args, n, degree, geometry, smooth):
    path = make_mesh(shells, args.o / f"shells_{n}_{geometry}.msh", h=RADII[1] / n, order=geometry)
    scene = shell_scene(path, degree, smooth_geometry=smooth)
    return scene, lambda points: np.full(len(points["x"]), shell_pressure())


def _hertz(name):
    def build(args, n, degree, geometry, smooth):
        case = hertz.CASES[name]
        mesh = hertz.generate(case, args.o / f"{name}_{n}_{geometry}.msh", case.half_width / n, geometry)
        options = SimpleNamespace(case=name, order=degree, theta=None, gamma0=None, drive="force", steps=1, hold=2,
                                  fields=False)  # fmt: skip
        scene = hertz.make_scene(case, mesh, options)
        scene.contacts[0].smooth_geometry = smooth
        a, p0 = case.from_force(case.force)
        return scene, lambda points: p0 * np.sqrt(np.maximum(1.0 - (points["x"][:, 0] / a) ** 2, 0.0))

    return build


# scene of a mesh and exact pressure at its points; meshes: facets in a quarter, in a radius, in the half width
CASES = {
    "rings": (_ring, [8, 16, 32, 64]),
    "shells": (_shell, [3, 6]),
    "cylinders": (_hertz("cylinders"), [4, 8, 16]),
    "cylinder_on_block": (_hertz("cylinder_on_block"), [4, 8, 16]),
}


def solve(scene, exact) -> dict:
    """Run a scene. *Collective.*

    Parameters
    ----------
    scene : Scene
    exact : callable
        Pressure (np,) at the points of a contact (dict of arrays).

    Returns
    -------
    dict
        ``error`` of the pressure, ``estimate`` of what straight facets add to it (None where they are not asked),
        ``newton`` and ``krylov`` iterations of the run, ``converged``.
    """
    counts = Counts()
    with running(scene, None, [counts]) as (simulation, converged):
        points, error = contact_points(simulation), None
        if points is not None:
            weight, p = points["weight"], exact(points)
            error = float(np.sqrt(weight @ (points["pressure"] - p) ** 2 / (weight @ p**2)))
        error = simulation.comm.bcast(error, root=0)
        estimate = simulation.problem.contacts[0].summary(simulation.stepper.u).get("facet_error")
    return {"error": error, "estimate": estimate, "converged": converged, "newton": counts.newton,
            "krylov": counts.krylov}  # fmt: skip


def run(args) -> int:
    """All cases; the exit status."""
    data, rows, good = {}, [], True
    for name in args.case:
        build, sizes = CASES[name]
        for n in sizes[:1] if args.tiny else sizes:
            for degree in args.degree[:1] if args.tiny else args.degree:
                found = {kind: solve(*build(args, n, degree, *said)) for kind, said in KINDS.items()}
                data[f"{name}_{n}_{degree}"] = found
                good &= all(one["converged"] for one in found.values())
                iterations = [", ".join(str(one[key]) for one in found.values()) for key in ("newton", "krylov")]
                errors = [one["error"] for one in found.values()]
                rows.append([name, n, degree, *errors, found["straight"]["estimate"] or 0.0, *iterations])
    header = ["case", "facets", "degree", *KINDS, "facet_error", "newton", "krylov"]
    print_table("relative error of the contact pressure in L2, iterations of the three runs", header, rows)
    write_json(args.o / "chords.json", data)
    return 0 if good else 1


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "chords_results")
    add = parser.add_argument
    add("--case", nargs="+", choices=list(CASES), default=list(CASES))
    add("--degree", type=int, nargs="+", choices=(1, 2), default=[1, 2], help="of the displacement")
    return parser


if __name__ == "__main__":
    main(run, make_options())
