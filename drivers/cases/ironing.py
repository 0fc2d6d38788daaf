"""Ironing: a stiff foot with a round sole is pressed into an elastic slab and dragged along it.

Contact with Coulomb's friction between two deformable bodies whose meshes move over each other: the foot goes down
by a small part of its radius in some load steps, then along half the slab. Once it slides, the tangential force of
the pair is nearly mu times the normal force. Not exactly: both are taken along the axes, and the sole is tilted where
it is pressed against. What is left of the mesh is a ripple in both forces with the length of a facet; the table tells
its size, without the slow change on the way between the ends of the slab. What is left of the load steps is seen with
several ``--count``. Small strains.
"""

from itertools import product

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, picture, print_table, running, write_json
from meshes import ironing
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps

E_SLAB, E_FOOT, NU = 1.0, 100.0, 0.3
PRESSED = 0.2  # part of the run that presses; the rest drags
WAY = 2.0  # half the slab
STEADY = 0.4  # part of the way after which the forces count as those of steady sliding


def scene(path, dim=2, mu=0.3, *, depth=0.04, way=WAY, count=100, source="slab", fields=False, order=1, petsc=None,
          **contact):  # fmt: skip
    """The scene on a mesh of :func:`meshes.ironing`.

    Parameters
    ----------
    path : mesh file
    dim : int
    mu : float
        Coefficient of friction.
    depth, way : float
        What the top of the foot goes down, then along [length].
    count : int
        Load steps, a fifth of them press.
    source : "slab" or "foot"
        Where the integrals are taken.
    fields : bool
        Whether fields are written.
    order : int
        Degree of the displacement.
    petsc : dict of str to str, optional
    contact : further keys of :class:`pcontact.scene.model.Contact`
    """
    sides = ("slab_top", "indenter_skin")
    free = ["free"] * (dim - 1)
    return Scene(
        title=f"Ironing, {dim}D, friction {mu:g}",
        mesh=MeshSpec(path, order=order),
        materials={"soft": Material(E_SLAB, NU), "stiff": Material(E_FOOT, NU)},
        bodies=[Body("slab", "soft"), Body("indenter", "stiff")],
        contacts=[Contact(*(sides if source == "slab" else sides[::-1]), name="sole", friction=mu, **contact)],
        displacements=[
            Displacement("slab_bottom", [0.0] * dim),
            Displacement("indenter_top", [*free, -depth], [(0, 0), (PRESSED, 1), (1, 1)]),
            Displacement("indenter_top", [way, *[0.0] * (dim - 2), "free"], [(0, 0), (PRESSED, 0), (1, 1)]),
        ],
        steps=Steps(count=count),
        output=Output(fields=fields, probes=["indenter_top"]),
        petsc=petsc or {},
    )


class Forces(Observer):
    """Observer: rows (a dict per load step) of what acts between foot and slab, along x and along the last axis.

    Parameters
    ----------
    source : "slab" or "foot"
    """

    def __init__(self, source="slab"):
        self.rows, self._sign = [], 1.0 if source == "foot" else -1.0

    def step(self, step, u, record):
        """Keep the step's numbers."""
        sole, reactions = record["contacts"]["sole"], record["reactions"]
        # on the slab: along the way and downwards
        force = self._sign * np.asarray(sole["force"])
        support, guide = np.asarray(reactions["slab_bottom"]), np.asarray(reactions["indenter_top"])
        row = {"time": step.time, "way": record["probes"]["indenter_top"]["mean"][0]}
        row.update(normal=-force[-1], tangential=force[0], side=float(np.abs(force[1:-1]).sum()))
        row["imbalance"] = float(max(np.linalg.norm(force + support), np.linalg.norm(guide - force)))
        row.update({key: sole[key] for key in ("open", "stick", "slip", "area", "max_pressure")})
        row.update(newton=step.newton, krylov=step.krylov, cutbacks=step.cutbacks)
        self.rows.append(row)


def ripple(way, force):
    """Peak to peak of a force about its parabola, over its mean."""
    smooth = np.polyval(np.polyfit(way, force, 2), way)
    return float(np.ptp(force - smooth) / np.mean(force))


def measure(rows):
    """Numbers of a run: steady sliding, and Newton's iterations. Nan without steps of steady sliding."""
    steady = [row for row in rows if row["time"] > PRESSED + STEADY * (1.0 - PRESSED)]
    newton = np.array([row["newton"] for row in rows])
    result = {"newton": float(newton.mean()), "newton_max": int(newton.max()), "newton_sum": int(newton.sum())}
    result["cutbacks"] = sum(row["cutbacks"] for row in rows)
    result["imbalance"] = max(row["imbalance"] for row in rows) / max(row["normal"] for row in rows)
    if len(steady) < 4:
        nothing = dict.fromkeys(("ratio", "normal", "tangential", "ripple_n", "ripple_t"), float("nan"))
        return {**result, **nothing}
    way, normal, tangential = (np.array([row[key] for row in steady]) for key in ("way", "normal", "tangential"))
    result.update(normal=float(normal.mean()), tangential=float(tangential.mean()))
    result["ratio"] = float(tangential.mean() / normal.mean())
    result.update(ripple_n=ripple(way, normal), ripple_t=ripple(way, tangential))
    return result


def cases(args):
    """Mesh size, quadrature, theta and number of load steps of every case of the command line."""
    sizes, counts, thetas = ([0.2], [20], [0.0]) if args.tiny else (args.h, args.count, args.theta)
    for h, quadrature, theta, count in product(sizes, args.quadrature, thetas, counts):
        yield {"h": h, "quadrature": quadrature or None, "theta": theta, "count": count}


def _plot(runs, mu):
    def paint(axes):
        for label, rows in runs:
            time, normal, tangential = (
                np.array([row[key] for row in rows]) for key in ("time", "normal", "tangential")
            )
            line = axes[0].plot(time, normal, lw=1, label=label)
            axes[0].plot(time, tangential, "--", lw=1, color=line[0].get_color())
            moving = time > PRESSED
            axes[1].plot(time[moving], tangential[moving] / normal[moving], lw=1, label=label)
        axes[1].axhline(mu, color="k", lw=0.8, ls=":", label="friction")
        axes[0].set_ylabel("force on the slab: normal, tangential (dashed)")
        axes[1].set_ylabel("tangential / normal force")
        for ax in axes:
            ax.axvline(PRESSED, color="0.8", lw=0.8)
            ax.set_xlabel("time: pressed, then dragged")
            ax.legend(fontsize="x-small")

    return paint


def _pictures(directory, rows):
    """The foot just moved, and at the end of its way, coloured by the equivalent stress. Rank 0."""
    first = sum(row["time"] <= PRESSED for row in rows)
    for name, step in (("begin", first + 2), ("end", len(rows))):
        picture(directory, field="equivalent_stress", step=min(step, len(rows)), output=directory / f"{name}.png")


def solve(args, case, directory, fields):
    """Whether all steps of a case converged, and its rows. *Collective.*"""
    path = make_mesh(ironing, args.o / f"ironing_{case['h']:g}.msh", args.dim, case["h"], cell=args.cell)
    said = {"depth": args.depth, "way": args.way, "source": args.source, "order": args.order}
    keys = {key: case[key] for key in ("theta", "quadrature", "count")}
    forces = Forces(args.source)
    with running(scene(path, args.dim, args.mu, fields=fields, **said, **keys), directory, [forces]) as (_, converged):
        return converged, forces.rows


def run(args):
    """Every case; 1 when a step fails or the forces do not balance."""
    results, runs = [], []
    for case in cases(args):
        label = ", ".join(f"{key} {value:g}" for key, value in case.items() if value is not None)
        directory = args.o / label.replace(", ", "_").replace(" ", "")
        converged, rows = solve(args, case, directory, fields=not runs)
        if not runs and rows:
            columns = ["time", "way", "normal", "tangential", "open", "stick", "slip", "newton", "cutbacks"]
            print_table(f"ironing, {label}", columns, [[row[key] for key in columns] for row in rows])
            on_root(MPI.COMM_WORLD, _pictures, directory, rows)
        results.append({**case, "converged": converged, **(measure(rows) if rows else {"imbalance": np.inf})})
        runs.append((label, rows))
    columns = ["h", "quadrature", "theta", "count", "converged", "newton", "newton_max", "cutbacks", "normal",
               "tangential", "ratio", "ripple_n", "ripple_t", "imbalance"]  # fmt: skip
    nothing = float("nan")
    table = [[row.get(key, nothing) for key in columns] for row in results]
    print_table("ironing, steady sliding; newton: iterations per load step", columns, table)
    draw(args.o / "ironing.png", _plot(runs, args.mu), columns=2)
    write_json(args.o / "ironing.json", {"cases": results, "rows": dict(runs)})
    log.info("plots and pictures in %s", args.o)
    return 0 if all(row["converged"] and row["imbalance"] < 1e-5 for row in results) else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "ironing_results")
    parser.add_argument("--dim", type=int, default=2, choices=[2, 3], help="dimension")
    parser.add_argument("--h", type=float, nargs="+", default=[0.1, 0.05], help="element sizes of the slab")
    parser.add_argument("--cell", default=None, help="quadrilateral, triangle, hexahedron, tetrahedron")
    parser.add_argument("--order", type=int, default=1, choices=[1, 2], help="degree of the displacement")
    parser.add_argument("--theta", type=float, nargs="+", default=[1.0, 0.0, -1.0], help="variants of the method")
    parser.add_argument("--quadrature", type=int, nargs="+", default=[0], help="degrees on source facets; 0: default")
    parser.add_argument("--source", default="slab", choices=["slab", "foot"], help="where the integrals are taken")
    parser.add_argument("--mu", type=float, default=0.3, help="coefficient of friction")
    parser.add_argument("--depth", type=float, default=0.04, help="how far the foot goes down")
    parser.add_argument("--way", type=float, default=WAY, help="how far the foot is dragged")
    parser.add_argument("--count", type=int, nargs="+", default=[100], help="load steps, a fifth of them press")
    main(run, parser)
