"""Indentation: a ball is pressed into an elastoplastic block and taken off again, with or without friction.

The ball is rigid (an obstacle), or elastic and meshed (``--ball``). Axial symmetry (``--dim 2``) or a quarter in space.
The block yields below the surface first; the zone grows until it is as wide as the contact, and from E* a / (R yield
stress) of about 40 on the mean pressure stays near 2.8 to 3 times the yield stress (fully plastic: K. L. Johnson,
Contact Mechanics, 1985, section 6.3). Taking the ball off is elastic, and an imprint stays.

All forces and areas are those of the whole ball. Contact radius: of the disk with the closed area. The last load step
takes the ball up half as far again as those before. Small strains: the imprint must be shallow.
"""

from itertools import pairwise

import numpy as np

from drivers._common import (
    contact_points,
    draw,
    log,
    main,
    make_mesh,
    make_parser,
    observed_rates,
    picture,
    print_table,
    running,
    write_json,
)
from meshes import indent
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps

E_MODULUS, NU, YIELD, HARDENING = 210e3, 0.3, 300.0, 1000.0
RADIUS, DEPTH = 5.0, 0.02
CELLS = {2: ("quadrilateral", "triangle"), 3: ("hexahedron", "tetrahedron")}
AWAY = 1.5  # way back in the end, over that of the load steps up
COUNTS = ("newton", "krylov", "cutbacks")


def metal(yield_stress=YIELD, hardening=HARDENING, kinematic=0.0, E=E_MODULUS):
    """Material of the block; a yield stress of zero stands for none."""
    if not yield_stress:
        return Material(E, NU)
    return Material(E, NU, yield_stress=yield_stress, hardening=hardening, kinematic_hardening=kinematic)


def path_of(steps, unload, back, grading=1.5):
    """Amplitude of the ball's motion and number of load steps.

    The ball goes down with a power of time: the first load step from the untouched surface is the hardest one, and the
    block yields at a depth that is small against all others.

    Parameters
    ----------
    steps : int
        Load steps down; a step is a unit of time.
    unload : int
        Load steps up by `back`, and one more by half of that; zero: the ball stays.
    back : float
        Part of the depth.
    grading : float
        1: equal steps down; 2: equal steps of the contact radius.
    """
    table = [(float(k), (k / steps) ** grading) for k in range(steps + 1)]
    if unload:
        table += [(float(steps + unload), 1.0 - back), (steps + unload + 1.0, 1.0 - AWAY * back)]
    return table, steps + (unload + 1 if unload else 0)


def scene(path, dim=2, *, friction=0.0, material=None, radius=RADIUS, depth=DEPTH, ball=None, source="block", steps=10,
          unload=5, back=0.25, grading=1.5, order=1, fields=False, petsc=None, **contact):  # fmt: skip
    """The scene on a mesh of :func:`meshes.indent`.

    Parameters
    ----------
    path : mesh file
    dim : int
        2: axial symmetry.
    friction : float
        Coulomb's coefficient.
    material : Material, optional
        Of the block, see :func:`metal`.
    radius, depth : float
        Of the ball; of its way down [length].
    ball : float, optional
        Young's modulus of a ball that is in the mesh; None: a rigid obstacle.
    source : "block" or "ball"
        Where the integrals are taken, with a ball in the mesh.
    steps, unload, back, grading
        See :func:`path_of`.
    order : int
        Degree of the displacement.
    fields : bool
        Whether fields are written.
    petsc : dict of str to str, optional
    contact : further keys of :class:`pcontact.scene.model.Contact`
    """
    amplitude, count = path_of(steps, unload, back, grading)
    across, free = [0.0] * (dim - 1), ["free"] * (dim - 1)
    held = [Displacement("block_bottom", [0.0] * dim)]
    if dim == 3:
        held += [Displacement("side_x", [0.0, "free", "free"]), Displacement("side_y", ["free", 0.0, "free"])]
    materials, bodies = {"metal": material or metal()}, [Body("block", "metal")]
    said = {"name": "ball", "friction": friction or None, **contact}
    if ball is None:
        rigid = Obstacle("sphere", center=[*across, radius], radius=radius, displacement=[*across, -depth],
                         amplitude=amplitude)  # fmt: skip
        pair = Contact("block_top", obstacle=rigid, **said)
    else:
        materials["ball"] = Material(ball, NU)
        bodies.append(Body("ball", "ball"))
        sides = ("block_top", "ball_skin")
        pair = Contact(*(sides if source == "block" else sides[::-1]), **said)
        held.append(Displacement("ball_top", [*free, -depth], amplitude))
    return Scene(
        title=f"Indentation, {dim}D, friction {friction:g}",
        mesh=MeshSpec(path, order, "axisymmetric" if dim == 2 else "plane_strain"),
        materials=materials,
        bodies=bodies,
        contacts=[pair],
        displacements=held,
        steps=Steps(float(count), count),
        output=Output(fields=fields, probes=[]),
        petsc=petsc or {},
    )


class Press(Observer):
    """Observer: rows (a dict per load step) of what presses the ball into the block.

    Parameters
    ----------
    case : Scene
    depth, yield_stress : float
        Way down [length]; zero when the block is elastic [stress].
    """

    def __init__(self, case, depth, yield_stress=YIELD):
        obstacle = case.contacts[0].obstacle
        moved = obstacle if obstacle is not None else case.displacements[-1]
        self.rows, self._table, self._depth, self._yield = [], np.array(moved.amplitude), depth, yield_stress
        self._copies = 4.0 if len(case.displacements[0].value) == 3 else 1.0

    def step(self, step, u, record):
        """Keep the step's numbers."""
        pair = record["contacts"]["ball"]
        force, area = self._copies * abs(pair["force"][-1]), self._copies * pair["area"]
        row = {"time": step.time, "depth": float(self._depth * np.interp(step.time, *self._table.T)), "force": force}
        row |= {"radius": float(np.sqrt(area / np.pi)), "area": area, "max_pressure": pair["max_pressure"]}
        row["mean_pressure"] = force / area if area > 0.0 else 0.0
        row["over_yield"] = row["mean_pressure"] / self._yield if self._yield else float("nan")
        row |= {key: pair[key] for key in ("open", "stick", "slip", "max_penetration")}
        row |= {"imbalance": record["imbalance"], **record["plastic"]}
        self.rows.append({**row, "newton": step.newton, "krylov": step.krylov, "cutbacks": step.cutbacks})


def hertz(depth, radius, ball=None):
    """Hertz's force and contact radius for a depth on an elastic block; `ball`: Young's modulus of the ball."""
    compliance = (1.0 - NU**2) * (1.0 / E_MODULUS + (0.0 if ball is None else 1.0 / ball))
    depth = np.maximum(depth, 0.0)
    return 4.0 / 3.0 / compliance * np.sqrt(radius) * depth**1.5, np.sqrt(radius * depth)


def surface(simulation):
    """Distance from the axis, height, of the nodes of the block's top, on rank 0. *Collective.*"""
    space = simulation.problem.space
    nodes = space.region("block_top")
    x, u = space.points[nodes], space.local.gather(simulation.stepper.u)[nodes]
    parts = simulation.comm.gather(np.column_stack([np.linalg.norm(x[:, :-1], axis=1), u[:, -1]]), root=0)
    if parts is None:
        return None
    table = np.unique(np.concatenate(parts), axis=0)
    return table[np.argsort(table[:, 0], kind="stable")]


def measure(rows, profile, steps):
    """Numbers of a run (rank 0): at the full depth, and of the imprint."""
    top = max((row for row in rows if row["time"] <= steps), key=lambda row: row["time"])
    result = {key: top[key] for key in ("depth", "force", "radius", "mean_pressure", "over_yield", "max_pressure")}
    down = [row for row in rows if row["time"] <= steps]
    result["newton_max"], result["newton_down"] = max(r["newton"] for r in rows), max(r["newton"] for r in down)
    result |= {key: sum(row[key] for row in rows) for key in COUNTS}
    result["imbalance"] = max(row["imbalance"] for row in rows)
    if profile is not None and rows[-1]["time"] > steps:
        result["residual_depth"] = float(-profile[0, 1])
        result["pile_up"] = float(profile[:, 1].max())
        result["last_force"] = rows[-1]["force"]
        result["released"] = _released(rows, steps)
    return result


def _released(rows, steps):
    """Depth of the ball where the force ends, from the last two load steps with one (it is nearly linear in depth)."""
    pressed = [row for row in rows if row["time"] >= steps and row["force"] > 0.0]
    last = pressed[-1]
    for a, b in pairwise(pressed):
        if b is last and a["force"] > b["force"]:
            return float(b["depth"] - b["force"] * (a["depth"] - b["depth"]) / (a["force"] - b["force"]))
    return float("nan")


def _plot(rows, profile, args):
    """Force over depth, mean pressure, imprint."""

    def paint(axes):
        down = [row for row in rows if row["time"] <= args.steps]
        up = [row for row in rows if row["time"] >= args.steps and row["depth"] >= 0.0]
        depth = np.linspace(0.0, args.depth, 100)
        force, _ = hertz(depth, args.radius, args.ball)
        origin = [{"depth": 0.0, "force": 0.0}]
        for part, text, colour in ((origin + down, "pressed", "#c8553d"), (up, "taken off", "#2c5aa0")):
            axes[0].plot(*np.array([[row["depth"], row["force"]] for row in part]).T, "o-", ms=3, color=colour,
                         label=text)  # fmt: skip
        axes[0].plot(depth, force, "k--", lw=0.8, label="elastic (Hertz)")
        axes[0].set(xlabel="depth of the ball", ylabel="force", ylim=(0.0, 1.6 * max(row["force"] for row in rows)))
        modulus = E_MODULUS / (1.0 - NU**2)
        x = [modulus * row["radius"] / (args.radius * (args.yield_stress or 1.0)) for row in down]
        axes[1].plot(x, [row["over_yield"] for row in down], "o-", ms=3, color="#c8553d", label="computed")
        for value in (2.8, 3.0):
            axes[1].axhline(value, color="k", ls=":", lw=0.8)
        x = np.linspace(0.0, max(x), 100)
        axes[1].plot(x, 4.0 / (3.0 * np.pi) * x, "k--", lw=0.8, label="elastic (Hertz)")
        axes[1].set(xlabel="E* a / (R yield stress)", ylabel="mean pressure / yield stress", ylim=(0.0, 3.6))
        near = profile[profile[:, 0] < 3.0 * max(row["radius"] for row in down)]
        axes[2].plot(*near.T, ".", ms=3, color="#c8553d", label="at the end")
        r = near[near[:, 0] ** 2 < 2.0 * args.radius * args.depth, 0]
        axes[2].plot(r, r**2 / (2.0 * args.radius) - args.depth, "k--", lw=0.8, label="ball at its deepest")
        axes[2].set(xlabel="distance from the axis", ylabel="height of the surface")
        for ax in axes:
            ax.grid(alpha=0.3)
            ax.locator_params(axis="x", nbins=5)
            ax.legend(fontsize="small")

    return paint


def _pictures(directory, rows, steps):
    """Equivalent stress at the full depth, and the enlarged imprint. Rank 0."""
    full = sum(row["time"] <= steps for row in rows)
    picture(directory, field="equivalent_stress", step=full, output=directory / "pressed.png")
    picture(directory, field="equivalent_plastic_strain", output=directory / "imprint.png", scale=10.0, cut=False)


def make(args, dim, h, name):
    """The mesh."""
    cell = args.cell if args.cell in CELLS[dim] else CELLS[dim][0]
    said = {"fine": args.fine, "length": args.length, "radius": args.radius if args.ball else None}
    return make_mesh(indent, args.o / name, dim, h, args.order, cell, **said)


def said_of(args):
    """Keys of :func:`scene` from the command line."""
    material = metal(args.yield_stress, args.hardening, args.kinematic)
    keys = ("friction", "radius", "depth", "ball", "source", "steps", "grading", "order", "theta")
    return {"material": material, **{key: getattr(args, key) for key in keys}}


def solve(args, dim, h):
    """One indentation: numbers, rows; files in ``-o``. *Collective.*"""
    directory = args.o / f"{dim}d"
    case = scene(make(args, dim, h, f"indent_{dim}d.msh"), dim, unload=args.unload, back=args.back, **said_of(args),
                 fields=not args.no_fields)  # fmt: skip
    press = Press(case, args.depth, args.yield_stress)
    with running(case, directory, [press]) as (simulation, converged):
        rows, profile = press.rows, surface(simulation)
        unknowns = simulation.problem.space.n_dofs
    if not rows:
        return {"dim": dim, "h": h, "unknowns": unknowns, "converged": False, "rows": []}
    columns = ["depth", "force", "radius", "over_yield", "max_pressure", "open", "stick", "slip", *COUNTS]
    print_table(f"indentation, {dim}D, {unknowns} unknowns", columns, [[row[key] for key in columns] for row in rows])
    result = MPI.COMM_WORLD.bcast(measure(rows, profile, args.steps) if profile is not None else None)
    draw(args.o / f"indent_{dim}d.png", _plot(rows, profile, args), columns=3)
    if not args.no_fields:
        on_root(MPI.COMM_WORLD, _pictures, directory, rows, args.steps)
    keys = ("radius", "over_yield", "residual_depth", "pile_up", "newton_down", "newton_max", "cutbacks", "imbalance")
    print_table("at the full depth, and the imprint", keys, [[result.get(key, float("nan")) for key in keys]])
    profile = None if profile is None else profile[profile[:, 0] < args.fine * 3.0]
    return {"dim": dim, "h": h, "unknowns": unknowns, "converged": converged, **result, "rows": rows,
            "imprint": profile}  # fmt: skip


def pressures(args, h, edges, yields):
    """Mean contact pressure of the rings between some radii at the full depth, and where the top begins to be elastic.

    Parameters
    ----------
    h : float
        Element size.
    edges : ndarray (n + 1,)
        Radii, ends of facets of this mesh.
    yields : bool
        Or the block is elastic.

    Returns
    -------
    pressure : ndarray (n,)
    plastic : float
        Radius up to which cells of the top have yielded since they were pressed; zero: none. *Collective.*
    """
    said = said_of(args)
    said["material"] = said["material"] if yields else metal(0.0)
    case = scene(make(args, 2, h, f"refine_{h:g}.msh"), 2, unload=0, **said)
    with running(case) as (simulation, converged):
        points = contact_points(simulation)
        outer = _yielded_radius(simulation) if yields else 0.0
    if not converged:
        raise InputError("command line: --refine: a load step did not converge; allowed: more --steps")
    if points is None:
        return np.zeros(len(edges) - 1), outer
    place = np.searchsorted(edges, points["x"][:, 0]) - 1
    inside = place < len(edges) - 1
    weight, place = points["weight"][inside], place[inside]
    sums = [np.bincount(place, value, len(edges) - 1) for value in (weight * points["pressure"][inside], weight)]
    return sums[0] / sums[1], outer


def _yielded_radius(simulation):
    """Largest distance from the axis of a cell at the block's top that has yielded. *Collective.*"""
    mesh, largest = simulation.mesh, 0.0
    height = -1e-9 * float(np.ptp(mesh.points[:, 1])) if len(mesh.points) else 0.0
    for block, strain in zip(mesh.blocks, simulation.problem.items[0].plastic_strain(), strict=True):
        x = mesh.points[block.nodes]
        some = (x[:, :, 1] >= height).any(axis=1) & (strain > 0.0)
        largest = max(largest, float(x[some, :, 0].max(initial=0.0)))
    return simulation.comm.allreduce(largest, op=MPI.MAX)


def refine(args):
    """Contact pressure on finer and finer meshes against the finest, of the block and of an elastic one. *Collective.*

    Differences are of the means over rings one facet of the coarsest mesh wide, weighted by area, relative to the norm
    of the finest: in the whole contact, and in the quarter of its radius at the edge.
    """
    coarse = args.h or 0.05
    edges = coarse * np.arange(round(args.fine / coarse) + 1)
    sizes, table = [coarse / 2**k for k in range(args.levels)], []
    for name, yields in (("yields", True), ("elastic", False)):
        runs = [pressures(args, h, edges, yields) for h in sizes]
        profiles = MPI.COMM_WORLD.bcast(np.array([p for p, _ in runs]))
        area = np.diff(edges**2)
        edge = edges[1:][profiles[-1] > 0.0].max()
        parts = {"whole": np.ones(len(area), dtype=bool), "edge": (edges[:-1] >= 0.75 * edge) & (edges[:-1] < edge)}
        scale = np.sqrt(np.sum(area * profiles[-1] ** 2))
        errors = {
            key: [float(np.sqrt(np.sum((area * (p - profiles[-1]) ** 2)[part])) / scale) for p in profiles[:-1]]
            for key, part in parts.items()
        }
        for k, h in enumerate(sizes[:-1]):
            row = {"block": name, "h": h, "contact": float(edge), "yielded": runs[k][1]}
            for key, values in errors.items():
                row |= {key: values[k], f"{key}_rate": observed_rates(sizes[:-1], values)[k]}
            table.append(row)
    columns = list(table[0])
    rows = [[row[key] for key in columns] for row in table]
    print_table(f"contact pressure against h = {sizes[-1]:g}", columns, rows)
    write_json(args.o / "refine.json", {"sizes": sizes, "table": table})
    return 0


def run(args):
    """All dimensions, or the refinement; 1 when a step fails or the forces do not balance."""
    if args.steps < 1 or args.levels < 3 or args.unload < 0 or not 0.0 < args.back:
        raise InputError("command line: --steps, --levels, --unload, --back: allowed: at least 1, 3, 0, above 0")
    if args.refine:
        return refine(args)
    if args.tiny:
        args.dim, args.h, args.steps, args.unload, args.no_fields = [2], 0.1, 4, 2, True
    results = [solve(args, dim, args.h or (0.025 if dim == 2 else 0.06)) for dim in args.dim]
    write_json(args.o / "indent.json", {"options": vars(args), "cases": results})
    log.info("plots and pictures in %s", args.o)
    return 0 if all(case["converged"] and case["imbalance"] < 1e-5 for case in results) else 1


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "indent_results")
    add = parser.add_argument
    add("--dim", type=int, nargs="+", default=[2, 3], choices=[2, 3], help="2: axial symmetry; 3: a quarter in space")
    add("--cell", choices=sum(CELLS.values(), ()), help="kind of cells (quadrilateral, hexahedron)")
    add("--order", type=int, default=1, choices=[1, 2], help="degree of displacement and geometry")
    add("--h", type=float, help="element size below the ball (2D: 0.025, 3D: 0.06)")
    add("--fine", type=float, default=0.5, help="size of the zone with that element size (0.5)")
    add("--length", type=float, default=5.0, help="size of the block (5)")
    add("--friction", type=float, default=0.3, help="Coulomb's coefficient (0.3)")
    add("--theta", type=float, default=0.0, choices=[1.0, 0.0, -1.0], help="variant of the method")
    add("--radius", type=float, default=RADIUS, help="of the ball (5)")
    add("--depth", type=float, default=DEPTH, help="way of the ball (0.02)")
    add("--yield_stress", type=float, default=YIELD, help="of the block (300); 0: elastic")
    add("--hardening", type=float, default=HARDENING, help="isotropic hardening (1000)")
    add("--kinematic", type=float, default=0.0, help="kinematic hardening (0)")
    add("--ball", type=float, help="Young's modulus of a meshed ball (absent: rigid)")
    add("--source", default="block", choices=["block", "ball"], help="where integrals are taken, with --ball")
    add("--steps", type=int, default=10, help="load steps down (10)")
    add("--grading", type=float, default=1.5, help="power of the way over the load steps down (1.5); 1: equal")
    add("--unload", type=int, default=5, help="load steps up, before one that takes the ball away (5); 0: none")
    add("--back", type=float, default=0.25, help="part of the depth that the ball goes up in these (0.25)")
    add("--no_fields", action="store_true", help="write no fields and pictures")
    add("--refine", action="store_true", help="contact pressure with axial symmetry on refined meshes, nothing else")
    add("--levels", type=int, default=4, help="with --refine: meshes, each of half the size (4)")
    return parser


if __name__ == "__main__":
    main(run, make_options())
