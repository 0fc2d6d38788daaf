"""A hollow rubber seal is squeezed into a groove until it is closed: self contact, large strain, friction.

Half of the section (meshes/seal.py), plane strain, neo-Hooke of E 1: its flat bottom is bonded to the floor of the
groove, whose lid goes down by 1.3 of the seal's height of 2. Its round side folds onto floor and lid and spreads
until it meets the wall at x = 1.9, then top and bottom of the hole meet: lid, wall and floor are rigid, the hole is
in contact with itself, all with friction. Two materials: nu 0.49 and 0.499.

Force on the lid over its travel on several meshes and with several numbers of load steps: the difference in L2 from the
finest mesh (of as many load steps), and from most load steps (of the same mesh), over the norm of that. No setting of
solver or contact is chosen by the scene but the tolerance of Newton's method.
"""

from itertools import product

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, picture, print_table, running, write_json
from drivers.cases._known import Rows, tail
from meshes import seal
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps

DEPTH, WALL, HEIGHT = 1.3, 1.9, 2.0
SAMPLES = 1000


def scene(path, nu=0.49, friction=0.3, *, count=40, depth=DEPTH, fields=False, petsc=None):
    """The scene on a mesh of :func:`meshes.seal`.

    Parameters
    ----------
    path : mesh file
    nu, friction : float
    count : int
        Load steps.
    depth : float
        What the lid goes down [length].
    fields : bool
        Whether fields are written.
    petsc : dict of str to str, optional
    """
    sides = {
        "lid": Obstacle("plane", point=[0.0, HEIGHT], normal=[0.0, -1.0], displacement=[0.0, -depth]),
        "wall": Obstacle("plane", point=[WALL, 0.0], normal=[-1.0, 0.0]),
        "floor": Obstacle("plane", point=[0.0, 0.0], normal=[0.0, 1.0]),
    }
    return Scene(
        title=f"A seal in a groove, nu {nu:g}, friction {friction:g}",
        mesh=MeshSpec(path, strain="finite"),
        materials={"rubber": Material(1.0, nu, law="neo_hooke")},
        bodies=[Body("seal", "rubber")],
        contacts=[
            *(Contact("outside", obstacle=side, name=name, friction=friction) for name, side in sides.items()),
            Contact("inside", "inside", name="hole", friction=friction),
        ],
        displacements=[Displacement("symmetry", [0.0, "free"]), Displacement("base", [0.0, 0.0])],
        steps=Steps(count=count),
        output=Output(fields=fields),
        petsc={"snes_rtol": "1e-9", **(petsc or {})},
    )


def forces(records, depth=DEPTH):
    """Travel of the lid and forces of lid and wall on the seal by load step, (n,) each; they begin with zeros."""
    travel = depth * np.array([0.0, *(record["time"] for record in records)])
    lid = [abs(record["contacts"]["lid"]["force"][1]) for record in records]
    wall = [abs(record["contacts"]["wall"]["force"][0]) for record in records]
    return travel, np.array([0.0, *lid]), np.array([0.0, *wall])


def distance(records, others, depth=DEPTH):
    """Difference of the lid's force over the travel in L2, relative to the second one."""
    travel = np.linspace(0.0, depth, SAMPLES)
    a, b = (np.interp(travel, *forces(some, depth)[:2]) for some in (records, others))
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def solve(args, case, fields):
    """Whether all load steps of a case converged, records, and norms of the residual in the last one. *Collective.*"""
    nu, cells, count = case
    path = make_mesh(seal, args.o / f"seal_{cells}.msh", (cells, 10 * cells))
    depth = 0.3 if args.tiny else DEPTH
    rows = Rows()
    one = scene(path, nu, args.friction, count=count, depth=depth, fields=fields)
    with running(one, args.o / f"nu{nu:g}_{cells}_{count}", [rows]) as (simulation, converged):
        return converged, rows.records, list(simulation.newton.norms)


def _plot(runs):
    def paint(axes):
        for (nu, cells, count), records in runs.items():
            travel, lid, wall = forces(records)
            label = f"nu {nu:g}, {cells} cells, {count} load steps"
            axes[0].plot(travel, lid, lw=1, label=label)
            axes[1].plot(travel, wall, lw=1, label=label)
        for ax, text in zip(axes, ("force on the lid", "force on the wall"), strict=True):
            ax.set(xlabel="travel of the lid", ylabel=text)
            ax.legend(frameon=False, fontsize="x-small")
            ax.grid(alpha=0.3)

    return paint


def compare(runs, cells, counts):
    """By case: how far its force is from that of the finest mesh, and from that of most load steps; NaN for these."""
    found = {}
    for (nu, n, count), records in runs.items():
        finest, most = runs.get((nu, max(cells), count)), runs.get((nu, n, max(counts)))
        found[nu, n, count] = [
            distance(records, other) if other is not None and other is not records else float("nan")
            for other in (finest, most)
        ]
    return found


def run(args):
    """Every case; 1 when a load step fails."""
    cells, counts, nus = ([2], [4], [0.49]) if args.tiny else (args.n, args.count, args.nu)
    runs, ends, status = {}, {}, 0
    for case in product(nus, cells, counts):
        fields = args.fields and case == (nus[0], max(cells), min(counts))
        converged, records, norms = solve(args, case, fields)
        if not converged:
            log.error_line("not converged: nu {:g}, {} cells, {} load steps".format(*case))
            status = 1
            continue
        runs[case], ends[case] = records, norms
        if fields:
            for name, step in (("folded", 2 * len(records) // 3), ("closed", len(records))):
                view = {"field": "equivalent_stress", "step": step, "output": args.o / f"{name}.png"}
                where = args.o / "nu{:g}_{}_{}".format(*case)
                on_root(MPI.COMM_WORLD, lambda where=where, view=view: picture(where, **view))
    away = compare(runs, cells, counts)
    table = []
    for case, records in runs.items():
        newton = [record["newton"] for record in records]
        _, lid, wall = forces(records)
        table.append((*case, float(np.mean(newton)), max(newton), sum(record["cutbacks"] for record in records),
                      lid[-1], wall[-1], *away[case], tail(ends[case])))  # fmt: skip
    header = ("nu", "cells", "load steps", "Newton", "most", "cut", "lid", "wall", "from finest",
              "from most load steps", "last residuals")  # fmt: skip
    print_table("seal", header, table)
    draw(args.o / "seal.png", _plot(runs), columns=2, size=(4.5, 3.4), dpi=110)
    write_json(args.o / "seal.json", {"header": header, "rows": table})
    return status


if __name__ == "__main__":
    parser = make_parser(__doc__, "seal_results")
    parser.add_argument("--n", type=int, nargs="+", default=[4, 8, 16], help="cells across the wall of the seal")
    parser.add_argument("--count", type=int, nargs="+", default=[40, 80, 160], help="load steps")
    parser.add_argument("--nu", type=float, nargs="+", default=[0.49, 0.499], help="Poisson's ratios")
    parser.add_argument("--friction", type=float, default=0.3, help="coefficient of friction")
    parser.add_argument("--fields", action="store_true", help="fields and pictures of the finest mesh")
    main(run, parser)
