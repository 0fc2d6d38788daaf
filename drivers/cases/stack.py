"""A heap of disks, tubes or balls in a rigid box, pressed by a plate or by its weight; contact alone holds the bodies.

Every body rests on those below it in full layers, and no support holds any. All of them are one region of the mesh,
and one contact of all surfaces (``all = true``) finds who touches whom: the number of items, matrices and searches is
that of two bodies. Neighbours overlap by a per cent or so of their diameter to begin with, which is the unloaded
state (``interference = "adjust"``): they start with a small patch of contact.
"""

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, picture, print_table, running, write_json
from meshes import heap
from meshes.heap import RADIUS, layers
from pcontact.runtime.errors import InputError
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps

E_MODULUS, NU, HARDENING = 1000.0, 0.3, 20.0
# of the cells [radii]
SIZES = {2: 0.26, 3: 0.35}
# largest force on a body that may be left, relative to the force of the floor
BALANCE = 1e-5


def walls(dim, size, friction, press, radius):
    """The contacts of all bodies with the sides of the box and, if it presses, the plate.

    Parameters
    ----------
    dim : int
    size : ndarray (dim,)
        Of the box [length].
    friction : float
    press : float
        Travel of the plate [length]; 0: there is none.
    radius : float
        Search radius: points farther from a wall cost nothing [length].
    """
    found = []
    for axis in range(dim):
        unit = np.eye(dim)[axis]
        names = ("floor", "plate") if axis == dim - 1 else (f"wall_{axis}_low", f"wall_{axis}_high")
        for name, point, normal in zip(names, (0.0 * size, size), (unit, -unit), strict=True):
            moves = {"displacement": [0.0] * (dim - 1) + [-press]} if name == "plate" else {}
            if name != "plate" or press:
                found.append(Contact(
                    all=True, name=name, friction=friction, interference="adjust", search_radius=radius,
                    obstacle=Obstacle("plane", point=point.tolist(), normal=normal.tolist(), **moves),
                ))  # fmt: skip
    return found


def scene(path, dim, count, friction=0.2, press=0.05, weight=0.0, yield_stress=0.0, steps=5, order=1, overlap=0.01,
          fields=False, petsc=None, **said):  # fmt: skip
    """The scene on a mesh of :func:`meshes.heap`.

    Parameters
    ----------
    path : mesh file
    dim, count, overlap : as for the mesh
    friction : float
        Coulomb's, between bodies and with the box.
    press : float
        Travel of the plate [length].
    weight : float
        Body force [stress/length].
    yield_stress : float
        0: elastic.
    steps, order : int
    fields : bool
    petsc : dict of str to str, optional
    said : further keys of the contact of all surfaces
    """
    _, size = layers(dim, count, overlap)
    # bodies do not move farther in a load step; a search takes longer the farther it goes
    said = {"search_radius": max(0.1 * RADIUS, 4.0 * press / steps), **said}
    more = {"yield_stress": yield_stress, "hardening": HARDENING} if yield_stress else {}
    load = Load("heap", body_force=[0.0] * (dim - 1) + [-weight])
    return Scene(
        title=f"{dim}D heap, friction {friction:g}",
        mesh=MeshSpec(path, order=order),
        materials={"body": Material(E_MODULUS, NU, **more)},
        bodies=[Body("heap", "body")],
        contacts=[Contact(all=True, friction=friction, interference="adjust", **said),
                  *walls(dim, size, friction, press, said["search_radius"])],
        loads=[load] if weight else [],
        steps=Steps(count=steps),
        output=Output(fields=fields),
        petsc=petsc or {},
    )  # fmt: skip


class History(Observer):
    """Observer: rows (a dict per load step) of the forces on box and plate and of the work."""

    def __init__(self, dim, press):
        self.dim, self.press, self.rows, self.cuts = dim, press, [], 0

    def step(self, step, u, record):
        """Keep the step's numbers."""
        pairs = record["contacts"]
        vertical = {name: -pair["force"][-1] for name, pair in pairs.items() if name in ("floor", "plate")}
        inner = np.array([body["force"] for body in pairs["all"]["bodies"]]).reshape(-1, self.dim)
        self.rows.append({
            "time": step.time, "travel": self.press * step.time, "floor": vertical["floor"],
            "plate": -vertical.get("plate", 0.0), "bodies": len(inner), "sum": float(np.abs(inner.sum(axis=0)).max()),
            **{key: pairs["all"][key] for key in ("area", "max_pressure", "open", "stick", "slip")},
            "newton": step.newton, "krylov": step.krylov, "cutbacks": step.cutbacks, "imbalance": record["imbalance"],
        })  # fmt: skip

    def cut(self, target, result):
        """Count it, and say what failed."""
        self.cuts += 1
        log.info("step to %g: %s, residual %.2e after %d iterations", target, result.reason, result.residual,
                 result.newton)  # fmt: skip


def costs(simulation):
    """What the run took, for the table. *Collective.*

    Returns
    -------
    dict
        ``bodies``, ``unknowns``, ``items``, ``points``, ``candidates`` per point, ``search`` as part of the time
        (percent), ``messages`` and ``bytes`` of the search and of all, those of the rank with most.
    """
    times, block = simulation.times(), simulation.costs.parallel()
    found, exchange = block["search"], block["exchange"]
    searching = exchange.get("search", {"messages_largest": 0, "bytes_largest": 0})
    total = times["setup"] + times["search"] + times["solve"]
    own = float(simulation.profile.counts.get("search", {}).get("candidates", 0))
    largest = simulation.comm.allreduce(own, op=MPI.MAX)
    return {
        "bodies": simulation.mesh.n_components,
        "unknowns": simulation.problem.space.n_dofs,
        "items": len(simulation.problem.items),
        "points": found["points"] // max(found["searches"], 1),
        "candidates": found["candidates_per_point"],
        "ranks_per_point": found["ranks_per_point"],
        "candidates_largest": largest / max(found["searches"], 1),
        "search_percent": 100.0 * times["search"] / total,
        "search_seconds": times["search"],
        "setup_seconds": times["setup"],
        "solve_seconds": times["solve"],
        "search_messages": searching["messages_largest"] / max(found["searches"], 1),
        "search_bytes": searching["bytes_largest"] / max(found["searches"], 1),
        "messages": sum(entry["messages_largest"] for entry in exchange.values()),
        "bytes": sum(entry["bytes_largest"] for entry in exchange.values()),
        "near_null": len(simulation.problem.matrix.matrix.getNearNullSpace().getVecs()),
    }


def default_overlap(dim, h):
    """Overlap [diameters] with which facets of the size h, which are inside the circle or sphere, touch well."""
    return max(0.01, h**2 / 6.0) if dim == 2 else max(0.01, h**2 / 4.0)


def check(args):
    """Refuse what no heap can be made of."""
    if args.hollow and 3 in args.dim:
        raise InputError("command line: --hollow: found tubes with --dim 3; allowed: --dim 2")
    if not args.press > 0.0 and not args.weight > 0.0:
        raise InputError("command line: --press: found no travel and no weight; allowed: --press > 0 or --weight > 0")


def _picture(directory):
    picture(directory, field="equivalent_stress", scale=1.0, output=directory.with_suffix(".png"))


def solve(args, dim, count):
    """One heap: its history and costs. *Collective.*"""
    name = f"{dim}d_{count}"
    h = args.h or SIZES[dim]
    overlap = default_overlap(dim, h) if args.overlap is None else args.overlap
    path = make_mesh(heap, args.o / f"{name}.msh", dim, count, h, args.hollow, None, args.geometry, overlap)
    case = scene(path, dim, count, args.friction, args.press, args.weight, args.yield_stress, args.steps, args.order,
                 overlap, fields=not args.tiny)  # fmt: skip
    history = History(dim, args.press)
    with running(case, args.o / name, [history]) as (simulation, converged):
        found = {"dim": dim, "converged": converged, "cutbacks": history.cuts, **costs(simulation)}
    for key in ("newton", "krylov"):
        found[key] = sum(row[key] for row in history.rows)
    if not args.tiny and history.rows:
        on_root(MPI.COMM_WORLD, _picture, args.o / name)
    return found, history.rows


def _plot(runs):
    def paint(axes):
        for label, rows in runs.items():
            travel = [row["travel"] or row["time"] for row in rows]
            axes[0].plot(travel, [row["plate"] or row["floor"] for row in rows], "o-", ms=3, label=label)
            axes[1].plot(travel, [row["area"] for row in rows], "o-", ms=3, label=label)
        for ax, text in zip(axes, ("force of the plate", "area of contact between bodies"), strict=True):
            ax.set(xlabel="travel of the plate", ylabel=text)
            ax.grid(alpha=0.3)
            ax.legend(fontsize="small")

    return paint


def run(args):
    """Every heap; 1 when a step fails or the forces do not balance."""
    check(args)
    if args.tiny:
        args.dim, args.count, args.steps = args.dim[:1], [5], min(args.steps, 2)
    results, runs = [], {}
    for dim in args.dim:
        for count in args.count:
            found, rows = solve(args, dim, count)
            columns = ["travel", "floor", "plate", "area", "max_pressure", "open", "stick", "slip"]
            columns += ["newton", "krylov", "cutbacks", "imbalance"]
            print_table(f"{dim}D heap of {found['bodies']}", columns, [[row[key] for key in columns] for row in rows])
            results.append({**found, "imbalance": max((row["imbalance"] for row in rows), default=np.inf)})
            runs[f"{dim}D, {found['bodies']} bodies"] = rows
    columns = ["dim", "bodies", "unknowns", "items", "newton", "krylov", "cutbacks", "points", "candidates"]
    columns += ["search_percent", "search_messages", "search_bytes", "messages", "bytes", "imbalance"]
    title = "search_percent: of the run; messages and bytes: of the rank with most, in one search and in all"
    print_table(title, columns, [[row[key] for key in columns] for row in results])
    draw(args.o / "stack.png", _plot(runs), columns=2)
    write_json(args.o / "stack.json", {"radius": RADIUS, "cases": results, "rows": runs})
    return 0 if all(row["converged"] and row["imbalance"] < BALANCE for row in results) else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "stack_results")
    parser.add_argument("--dim", type=int, nargs="+", default=[2, 3], choices=[2, 3], help="dimensions")
    parser.add_argument("--count", type=int, nargs="+", default=[20], help="bodies, at least; layers are full")
    parser.add_argument("--h", type=float, default=None, help="size of the cells (default: 0.26 or 0.35 radii)")
    parser.add_argument("--hollow", type=float, default=0.0, help="in the plane: inner over outer radius of tubes")
    text = "of neighbours to begin with, in diameters (default: a small patch of contact)"
    parser.add_argument("--overlap", type=float, default=None, help=text)
    parser.add_argument("--order", type=int, default=1, choices=[1, 2], help="degree of the displacement")
    parser.add_argument("--geometry", type=int, default=1, choices=[1, 2], help="degree of the mesh")
    parser.add_argument("--friction", type=float, default=0.2, help="coefficient of friction")
    parser.add_argument("--press", type=float, default=0.05, help="travel of the plate, in radii; 0: no plate")
    parser.add_argument("--weight", type=float, default=0.0, help="force per volume")
    parser.add_argument("--yield-stress", type=float, default=0.0, help="0: elastic")
    parser.add_argument("--steps", type=int, default=5, help="load steps")
    main(run, parser)
