"""A helical spring is compressed between two plates until its coils close on each other.

The wire is round, its end coils are closed and ground flat; ``--top`` makes a cone of the helix. The ground faces sit
on their plates and the upper one comes down. The plates, rigid planes, press on the rest of the skin as well: end coils
roll up on them, and coils meet by self contact. The force grows slowly at first, by the textbook's k = G d^4 / (8 D^3
n), and steeply once the coils are closed (solid length). ``--friction`` acts between the coils and at the plates,
``--yield-stress`` and ``--hardening`` make the wire yield.

n counts the turns between the closed ones, which are taken as the only ones that give way. Until they touch, those
parts of the closed ones that do not lie on the plates give way as well: the initial stiffness is that of the formula
with all free turns, and approaches the other one when the gap between the end coils (a tenth of a wire) has closed.
The table has both.

The travel ends where the coils are closed: between the parts of the wire that lie on the plates no gap is left, and the
force turns upwards. Load steps get shorter on the way, as that is where it happens.

Small strain, unless ``--strain`` says finite, or both to compare them. With small strain the wire is twisted by
(pitch - wire) / (coil radius) per turn until the coils close, 0.08 by default; the helix neither widens nor unwinds as
it is compressed, and coils meet where the undeformed helix puts them. With finite strain it does both. Long springs
would buckle; here they do not.

The table has for every load step the largest penetration at a quadrature point over the diameter of the wire. As
partners are those at the end that was expected for the load step, they are looked for once more at the end of the run.
"""

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, picture, print_table, running, write_json
from drivers.cases._known import tail
from meshes import spring
from meshes.spring import Helix
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps

E_MODULUS, NU = 206e3, 0.3
# A coil is so much softer than its wire that multigrid needs hundreds of iterations, and that the first residual of a
# load step, that of moved ends, is a million times the forces. The fronts of a direct solver are as small as a section.
PETSC = {"pc_type": "lu", "pc_factor_mat_solver_type": "mumps", "snes_rtol": "1e-11"}
FINEST = 0.1  # last load step in units of the first
STRAINS = ("small", "finite")
CLOSED, GAP = 1.0, 0.1  # turns at each end that are closed, and the gap between them in wires


def helix(args):
    """The centre line of the spring."""
    top = None if args.top is None else 2.0 * args.top
    return Helix(args.wire, 2.0 * args.radius, args.coils, args.pitch, "ground", CLOSED, GAP, top)


def ground(args):
    """Turns at each end that lie on the plate: up to where the round wire would be clear of it."""
    whole = helix(args)
    return (0.5 * args.wire - whole.start) / whole.closed_pitch


def sides(args):
    """Facets on a quarter of the section, an odd number: coils then meet flat on flat, not edge on edge.

    Along edges the contact is narrower than a facet whatever the mesh, its pressure is missed by the stress of the
    cells, and Nitsche's method leaves pressure / gamma of penetration, the more the finer it is resolved.
    """
    return max(3, 2 * round(0.125 * np.pi * args.wire / args.h - 0.5) + 1)


def closing_travel(args):
    """Travel at which the coils lie on each other [length]: the spring has its solid length.

    Where the wire is ground it lies on its plate. Between such places of both ends, one above the other, the wire can
    go down by no more than the sum of the gaps: the smallest one counts. The wire is as thick as between two flats of
    its section; coils of a cone lie beside each other by what the radius loses in a turn.
    """
    whole = helix(args)
    t = np.linspace(0.0, args.coils, 50 * int(np.ceil(args.coils)) + 1)
    held = t[t <= ground(args)]
    thickness = args.wire if args.order == 2 else args.wire * np.cos(0.25 * np.pi / sides(args))
    aside = 0.0 if args.top is None else (args.radius - args.top) / args.coils
    high = np.sqrt(max(thickness**2 - aside**2, 0.0))
    sums = []
    for turns in range(1, int(args.coils) + 1):
        below = held[(held + turns >= args.coils - held[-1]) & (held + turns <= args.coils)]
        sums += list(whole.rise(below + turns)[0] - whole.rise(below)[0] - turns * high)
    return float(min(sums))


def mesh(path, args):
    """Mesh of the spring with an odd number of flats on a quarter of its section. *Collective.*"""
    sizes = {key: getattr(args, key) for key in ("wire", "coils", "pitch", "along")}
    return make_mesh(
        spring, path, 0.25 * np.pi * args.wire / sides(args), 2 if args.order == 2 else 1, closed=CLOSED, gap=GAP,
        diameter=2.0 * args.radius, ends="ground", top=None if args.top is None else 2.0 * args.top, **sizes,
    )  # fmt: skip


def textbook(args, closed=CLOSED):
    """Stiffness by the formula [force/length], without so many turns at each end; for a cone with the mean of D^3."""
    turns = np.linspace(closed, args.coils - closed, 201)
    cubes = helix(args).width(0.5 * (turns[1:] + turns[:-1])) ** 3
    shear = E_MODULUS / (2.0 * (1.0 + NU))
    return float(shear * args.wire**4 / (8.0 * cubes.mean() * (args.coils - 2.0 * closed)))


def graded(count, finest=FINEST):
    """Times and factors (count + 1, 2) of the travel: load steps shrink evenly, the last one to `finest` of the first.

    The force is a straight line until coils meet, and turns upwards where they close.
    """
    size = np.linspace(1.0, finest, count)
    return [(k / count, float(part)) for k, part in enumerate([0.0, *np.cumsum(size) / size.sum()])]


def reach(args, travel):
    """Search radius [length]: the widest gap between coils, and not less than what the plate moves in a load step.

    The default, a part of the extent of the spring, has every point look at the coils beyond its neighbours.
    """
    first = graded(args.steps)[1][1] * travel
    return max(args.pitch - args.wire, 2.0 * first)


def scene(path, args, travel, fields=False, strain="small"):
    """The scene on a mesh of :func:`meshes.spring` with ground ends.

    Parameters
    ----------
    path : mesh file
    args : argparse.Namespace
        Of the command line.
    travel : float
        Of the upper plate [length].
    fields : bool
        Whether fields are written.
    strain : small or finite
    """
    plastic = {"yield_stress": args.yield_stress, "hardening": args.hardening} if args.yield_stress else {}
    height, friction, moved = helix(args).height, args.friction or None, graded(args.steps)
    lower = Obstacle("plane", point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])
    upper = Obstacle(
        "plane", point=[0.0, 0.0, height], normal=[0.0, 0.0, -1.0], displacement=[0.0, 0.0, -travel], amplitude=moved
    )
    return Scene(
        title=f"Helical spring, {args.coils:g} turns",
        mesh=MeshSpec(path, order=args.order, strain=strain),
        materials={"steel": Material(E_MODULUS, NU, **plastic)},
        bodies=[Body("spring", "steel")],
        contacts=[
            Contact("spring_skin", obstacle=lower, name="lower plate", friction=friction),
            Contact("spring_skin", obstacle=upper, name="upper plate", friction=friction),
            Contact("skin", "skin", name="coils", friction=friction, search_radius=reach(args, travel)),
        ],
        displacements=[
            Displacement("end_bottom", [0.0, 0.0, 0.0]),
            Displacement("end_top", [0.0, 0.0, -travel], moved),
        ],
        steps=Steps(count=args.steps),
        output=Output(fields=fields, probes=["end_top"]),
        petsc=dict(PETSC),
    )


class History(Observer):
    """Observer: rows (a dict per load step), norms of the residual, and the attempts that failed.

    Parameters
    ----------
    travel, wire : float
        Travel at the end of the run and diameter of the wire [length].
    count : int
        Load steps.
    """

    def __init__(self, travel, wire, count):
        self.rows, self.cuts, self.norms, self._travel, self._wire = [], [], [], travel, wire
        self._times, self._factors = zip(*graded(count), strict=True)

    def step(self, step, u, record):
        """Keep the step's numbers."""
        # plates act on what is not held, supports on the ground faces
        pairs = record["contacts"]
        force = pairs["upper plate"]["force"][2] - record["reactions"]["end_top"][2]
        below = record["reactions"]["end_bottom"][2] - pairs["lower plate"]["force"][2]
        moved = np.interp(step.time, self._times, self._factors) * self._travel
        row = {"time": step.time, "travel": moved, "force": force}
        row["imbalance"] = abs(force - below) / max(abs(force), 1e-300)
        row["penetration"] = max(pair["max_penetration"] for pair in pairs.values()) / self._wire
        row.update(area=pairs["coils"]["area"], between=pairs["coils"]["force"][2])
        row.update(closed=pairs["coils"]["stick"] + pairs["coils"]["slip"])
        row["plastic_strain"] = record["plastic"]["max_equivalent_strain"] if record.get("plastic") else 0.0
        row.update(newton=step.newton, krylov=step.krylov, cutbacks=step.cutbacks)
        self.rows.append({key: float(value) if isinstance(value, np.generic) else value for key, value in row.items()})
        self.norms.append(step.norms)

    def cut(self, target, result):
        """Keep why."""
        self.cuts.append({"time": target, "reason": result.reason, "newton": result.newton, "detail": result.detail})


def left_inside(simulation):
    """Largest penetration of all pairs among the partners of the end of the run [length]. *Collective.*"""
    deepest, u = 0.0, simulation.stepper.u
    for item in simulation.problem.others:
        item.detect(u, simulation.problem.time)
        gap = item.state(u)["gap"]
        deepest = max(deepest, float(np.nanmax(-gap, initial=0.0)) if np.isfinite(gap).any() else 0.0)
    return simulation.comm.allreduce(deepest, op=MPI.MAX)


def _pictures(directory, rows):
    """Before and closed, coloured by the equivalent stress. Rank 0."""
    for name, step in (("open", 1), ("closed", len(rows))):
        picture(directory, field="equivalent_stress", step=step, scale=1.0, cut=False, output=directory / f"{name}.png")


def _plot(runs, args):
    """Soft part to scale; all of it, with the penetration, in powers of ten."""
    begun, solid = np.array([0.0, closing_travel(args) * args.travel]), closing_travel(args)
    free = textbook(args, ground(args))
    formulas = ((textbook(args), "k:", "turns between the closed ones"), (free, "k--", "free turns"))

    def paint(axes):
        soft, whole = axes
        for strain, rows in runs.items():
            travel, force, depth = (np.array([row[key] for row in rows]) for key in ("travel", "force", "penetration"))
            soft.plot([0.0, *travel], [0.0, *force], ".-", lw=1, label=f"{strain} strain")
            whole.semilogy(travel, force, ".-", lw=1, label=f"force, {strain} strain")
            touched = depth > 0.0
            whole.semilogy(travel[touched], depth[touched], "s-", ms=3, lw=1, label=f"penetration / wire, {strain}")
        for stiffness, style, name in formulas:
            soft.plot(begun, stiffness * begun, style, lw=1, label=f"G d^4 / (8 D^3 n), {name}")
        soft.set_ylim(0.0, 1.5 * formulas[0][0] * begun[-1])
        soft.set_ylabel("force")
        whole.axhline(1e-3, color="k", ls=":", lw=1, label="1e-3")
        for one in axes:
            one.axvline(solid, color="0.5", lw=1, label="coils closed")
            one.set_xlim(0.0, None)
            one.set_xlabel("travel")
            one.legend(fontsize=8)
            one.grid(alpha=0.3)

    return paint


def measure(rows, args):
    """Numbers of a run."""
    formula, free, first = textbook(args), textbook(args, ground(args)), rows[0]
    initial = first["force"] / first["travel"]
    last = (rows[-1]["force"] - rows[-2]["force"]) / (rows[-1]["travel"] - rows[-2]["travel"]) if rows[1:] else initial
    result = {"textbook": formula, "textbook, free turns": free, "initial": initial}
    result.update({"initial / textbook": initial / formula, "initial / textbook, free turns": initial / free})
    result["last / initial"] = last / initial
    result.update(force=rows[-1]["force"], area=rows[-1]["area"])
    result["penetration"] = max(row["penetration"] for row in rows)
    result.update({key: sum(row[key] for row in rows) for key in ("newton", "krylov", "cutbacks")})
    result["newton_max"] = max(row["newton"] for row in rows)
    result["imbalance"] = max(row["imbalance"] for row in rows)
    return result


def _run(args, path, travel, strain):
    """What a run with one kind of strain gave. *Collective.*"""
    history = History(travel, args.wire, args.steps)
    folder = args.o / ("run" if len(args.strain) == 1 else strain)
    with running(scene(path, args, travel, not args.no_fields, strain), folder, [history]) as (simulation, converged):
        unknowns = simulation.problem.space.vector().getSize()
        left = left_inside(simulation) / args.wire
    rows = history.rows
    columns = ["travel", "force", "newton", "krylov", "cutbacks", "penetration", "area", "plastic_strain"]
    title = f"spring, {strain} strain, {unknowns} unknowns"
    print_table(title, columns, [[row[key] for key in columns] for row in rows])
    result = {"unknowns": unknowns, "travel": travel, "converged": converged, "left": left}
    if rows:
        result.update(measure(rows, args))
        log.info("last residuals: first load step %s, last one %s", *(tail(history.norms[k]) for k in (0, -1)))
        if not args.no_fields:
            on_root(MPI.COMM_WORLD, _pictures, folder, rows)
    print_table("the run", ["", ""], [[key, value] for key, value in result.items()])
    return {"result": result, "rows": rows, "cuts": history.cuts, "residuals": history.norms}


def _compare(runs):
    """Forces with finite and with small strain at the same travel."""
    small, finite = ({row["travel"]: row["force"] for row in runs[strain]["rows"]} for strain in STRAINS)
    rows = [(travel, small[travel], finite[travel], 100.0 * (finite[travel] / small[travel] - 1.0))
            for travel in small if travel in finite]  # fmt: skip
    print_table("force over travel", ["travel", "small strain", "finite strain", "difference [%]"], rows)


def run(args):
    """One run for each kind of strain; 1 when a step fails."""
    if args.tiny:
        args.coils, args.h, args.along, args.steps, args.radius, args.strain = 2.5, 0.5, 2.0, 2, 3.0, list(STRAINS)
    travel = closing_travel(args) * args.travel
    path = mesh(args.o / "spring.msh", args)
    runs = {strain: _run(args, path, travel, strain) for strain in args.strain}
    if len(runs) == len(STRAINS):
        _compare(runs)
    if all(one["rows"] for one in runs.values()):
        draw(args.o / "spring.png", _plot({strain: one["rows"] for strain, one in runs.items()}, args), 2)
    write_json(args.o / "spring.json", {**runs[args.strain[0]], "runs": runs})
    log.info("plot and pictures in %s", args.o)
    return 0 if all(one["result"]["converged"] for one in runs.values()) else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "spring_results")
    parser.add_argument("--coils", type=float, default=5.0, help="all turns, two of them closed at the ends")
    parser.add_argument("--radius", type=float, default=5.0, help="of the centre line of the coils")
    parser.add_argument("--top", type=float, default=None, help="of the uppermost coil: a cone")
    parser.add_argument("--wire", type=float, default=1.0, help="diameter of the wire")
    parser.add_argument("--pitch", type=float, default=1.4, help="rise per turn between the closed coils")
    parser.add_argument("--h", type=float, default=0.25, help="element size in the section of the wire")
    parser.add_argument("--along", type=float, default=None, help="element size along the wire; default 2 h")
    parser.add_argument("--order", type=int, default=1, choices=[1, 2], help="degree of the displacement")
    parser.add_argument("--friction", type=float, default=0.0, help="between coils and at the plates")
    parser.add_argument("--yield-stress", type=float, default=0.0, help="of the wire; 0: elastic")
    parser.add_argument("--hardening", type=float, default=2000.0, help="of a wire that yields")
    parser.add_argument("--travel", type=float, default=1.0, help="in units of that which closes the coils")
    parser.add_argument("--steps", type=int, default=16, help="load steps, which get shorter")
    parser.add_argument("--strain", nargs="+", choices=STRAINS, default=["small"], help="small, finite, or both")
    parser.add_argument("--no-fields", action="store_true", help="write neither fields nor pictures")
    main(run, parser)
