"""Snap-fit: a clip with a hook is pushed over a catch and snaps in behind it.

Friction, large sliding, corners that pass each other, and a root that yields: the clip's root is moved along x by the
travel of :data:`meshes.CLIP` and the catch's base is held, so that the force is what comes out. It grows while the hook
rides up the ramp of the catch, falls to the friction of the crests, pulls the clip in behind them, and is zero after
the snap. ``--pull`` pulls the clip back out afterwards and shows the force that holds it.

The table compares the histories of several meshes and numbers of load steps: the difference in L2 over the travel from
that of the finest mesh with most load steps, over the norm of that. The meshes are of degree 2, for round corners; with
straight facets the force jumps from facet to facet. Partners are frozen during a load step, where it is expected to
end: where a corner passes another, that is not foreseen. Plane strain, or a clip of width 3 in space.

``--strain small finite`` runs every case with small and with finite strain, whose partners and normals move within a
load step, and has the difference of the two in the table. Finite strain wants the displacement of degree 2 on these
meshes, which is then the default, and looks for partners along the normals of the clip.
"""

from itertools import product

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, picture, print_table, running, write_json
from drivers.cases._known import tail
from meshes import CLIP, clip
from pcontact.runtime.observer import Observer
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps

E_MODULUS, NU = 2000.0, 0.35
WIDTH = 3.0  # in space
CELL = {2: "quadrilateral", 3: "hexahedron"}
STRAINS = ("small", "finite")
STAGES = ("before", "ramp", "top", "snapped")
# of the largest force: what counts as none
NO_FORCE = 1e-6
SAMPLES = 2000


def scene(path, dim=2, friction=0.2, *, yield_stress=25.0, hardening=50.0, count=120, pull=False, order=1, fields=False,
          petsc=None, strain="small", **contact):  # fmt: skip
    """The scene on a mesh of :func:`meshes.clip`.

    Parameters
    ----------
    path : mesh file
    dim : int
    friction : float
    yield_stress : float
        Zero: elastic.
    hardening : float
    count : int
        Load steps of the way in.
    pull : bool
        Whether the clip is pulled out again, in as many load steps.
    order : int
        Degree of the displacement.
    fields : bool
        Whether fields are written.
    petsc : dict of str to str, optional
    strain : small or finite
    contact : further keys of :class:`pcontact.scene.model.Contact`
    """
    zeros = [0.0] * (dim - 1)
    plastic = {"yield_stress": yield_stress, "hardening": hardening} if yield_stress else {}
    if strain == "finite":
        # corners have no normal that a closest point could follow
        contact = {"search": "ray_tracing", **contact}
    amplitude = [(0.0, 0.0), (0.5, 1.0), (1.0, 0.0)] if pull else [(0.0, 0.0), (1.0, 1.0)]
    return Scene(
        title=f"Snap-fit, {dim}D, friction {friction:g}",
        mesh=MeshSpec(path, order=order, strain=strain),
        materials={"plastic": Material(E_MODULUS, NU, **plastic)},
        bodies=[Body("clip", "plastic"), Body("catch", "plastic")],
        contacts=[Contact("clip_skin", "catch_skin", name="hook", friction=friction, **contact)],
        displacements=[
            Displacement("clip_root", [CLIP.travel, *zeros], amplitude),
            Displacement("catch_base", [0.0] * dim),
        ],
        steps=Steps(count=2 * count if pull else count),
        output=Output(fields=fields, probes=["clip_root", "clip_skin"]),
        # Newton's tolerance is a part of the first residual of a load step, some 400 times the forces
        petsc={"snes_rtol": "1e-9", **(petsc or {})},
    )


class History(Observer):
    """Observer: rows (a dict per load step) of the forces, norms of the residual, and the attempts that failed.

    Parameters
    ----------
    width : float
        Forces are divided by it: those of a plane clip are per unit of width.
    """

    def __init__(self, width=1.0):
        self.rows, self.cuts, self.norms, self._width = [], [], [], width

    def step(self, step, u, record):
        """Keep the step's numbers."""
        pair, reactions = record["contacts"]["hook"], record["reactions"]
        root, base = (np.asarray(reactions[name]) for name in ("clip_root", "catch_base"))
        force = np.asarray(pair["force"])  # on the catch
        row = {"time": step.time, "travel": record["probes"]["clip_root"]["mean"][0]}
        row.update(push=root[0] / self._width, vertical=root[1] / self._width)
        row["imbalance"] = max(np.linalg.norm(root - force), np.linalg.norm(base + force)) / self._width
        row.update({key: pair[key] for key in ("open", "stick", "slip", "area", "max_pressure", "max_penetration")})
        row["rise"] = record["probes"]["clip_skin"]["max"][1]
        row["plastic_strain"] = record["plastic"]["max_equivalent_strain"]
        row.update(newton=step.newton, krylov=step.krylov, cutbacks=step.cutbacks)
        self.rows.append({key: float(value) if isinstance(value, np.generic) else value for key, value in row.items()})
        self.norms.append(step.norms)

    def cut(self, target, result):
        """Keep why."""
        failed = {"time": target, "reason": result.reason, "newton": result.newton, "detail": result.detail}
        self.cuts.append(failed)


def way_in(rows):
    """The rows before the clip is pulled."""
    turn = int(np.argmax([row["travel"] for row in rows]))
    return rows[: turn + 1]


def column(rows, key):
    """A column of the rows, (n,)."""
    return np.array([row[key] for row in rows])


def measure(rows):
    """Numbers of a run: peaks, where it snaps, what is left, Newton's iterations."""
    inward, newton = way_in(rows), column(rows, "newton")
    push, vertical, travel = (column(inward, key) for key in ("push", "vertical", "travel"))
    size = np.hypot(push, vertical)
    result = {"steps": len(rows), "newton": float(newton.mean()), "newton_max": int(newton.max())}
    result.update(newton_sum=int(newton.sum()), cutbacks=int(column(rows, "cutbacks").sum()))
    result.update(peak=float(push.max()), peak_travel=float(travel[np.argmax(push)]))
    result["peak_vertical"] = float(np.abs(vertical).max())
    acting = np.flatnonzero(size > NO_FORCE * size.max())
    # the last travel at which the hook is held
    result["snap"] = float(travel[acting[-1]]) if len(acting) else float("nan")
    result["left"] = float(size[-1] / size.max()) if size.max() > 0.0 else 0.0
    result["retention"] = float(-column(rows, "push").min()) if len(inward) < len(rows) else float("nan")
    result["imbalance"] = float(column(rows, "imbalance").max() / size.max()) if size.max() > 0.0 else 0.0
    result["plastic_strain"] = float(column(rows, "plastic_strain").max())
    return result


def sampled(rows, key="push"):
    """A force of the way in at equal distances of travel, linear between the load steps."""
    inward = way_in(rows)
    travel = np.linspace(0.0, CLIP.travel, SAMPLES)
    # the bodies are apart at first
    return np.interp(travel, np.append(0.0, column(inward, "travel")), np.append(0.0, column(inward, key)))


def distance(rows, others, key="push"):
    """Difference of two histories in L2, relative to the second."""
    a, b = sampled(rows, key), sampled(others, key)
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def stages(rows):
    """Numbers of the load steps (from 1) of the pictures, by name."""
    inward = way_in(rows)
    travel, push = column(inward, "travel"), column(inward, "push")
    top = int(np.argmax(column(inward, "vertical") ** 2))
    ramp = int(np.argmin(np.abs(travel[: top + 1] - 0.5 * (CLIP.first_touch + travel[top]))))
    before = max(int(np.argmax(np.abs(push) > 0.0)) - 1, 0)
    return dict(zip(STAGES, (before + 1, ramp + 1, top + 1, len(inward)), strict=True))


def _pictures(directory, rows):
    for name, step in stages(rows).items():
        picture(directory, field="equivalent_stress", step=step, scale=1.0, output=directory / f"{name}.png")


def _plot(runs):
    def paint(axes):
        for label, rows in runs:
            for ax, key in zip(axes, ("push", "vertical"), strict=True):
                ax.plot(column(rows, "travel"), column(rows, key), ".-", lw=1, ms=3, label=label)
        for ax, text in zip(axes, ("push force", "vertical force at the root"), strict=True):
            ax.set_xlabel("travel")
            ax.set_ylabel(f"{text}, per width")
            ax.axvline(CLIP.first_touch, color="0.8", lw=0.8)
            ax.grid(alpha=0.3)
            ax.legend(fontsize="x-small")

    return paint


def cases(args):
    """Dimension, mesh size, load steps and strain of every case of the command line."""
    if args.tiny:
        return [(2, 0.2, 30, strain) for strain in STRAINS]
    sizes = {2: args.h or [0.1, 0.05, 0.025], 3: args.h or [0.2]}
    return [case for dim in args.dim for case in product([dim], sizes[dim], args.steps, args.strain)]


def solve(args, case, directory, fields):
    """Whether all steps of a case converged, and its history. *Collective.*"""
    dim, h, count, strain = case
    cell = args.cell if args.cell and len(args.dim) == 1 else CELL[dim]
    path = make_mesh(clip, args.o / f"clip_{dim}d_{h:g}.msh", dim, h, args.geometry, cell, width=WIDTH)
    history = History(1.0 if dim == 2 else WIDTH)
    order = args.order or (args.geometry if "finite" in args.strain else 1)
    keys = {"yield_stress": args.yield_stress, "hardening": args.hardening, "order": order, "pull": args.pull}
    one = scene(path, dim, args.friction, count=count, fields=fields, strain=strain, **keys)
    with running(one, directory, [history]) as (simulation, converged):
        return converged, history, simulation.problem.space.n_dofs


def _compare(results, runs):
    """Adds to every result how far its histories are from those of the finest mesh, and of small strain."""
    for result, rows in zip(results, runs, strict=True):
        same = [k for k, other in enumerate(results) if all(other[key] == result[key] for key in ("dim", "strain"))]
        finest = min(same, key=lambda k: (results[k]["h"], -results[k]["count"]))
        small = [k for k, other in enumerate(results) if other["strain"] == "small" != result["strain"]
                 and all(other[key] == result[key] for key in ("dim", "h", "count"))]  # fmt: skip
        for key in ("push", "vertical"):
            for name, others in (("l2", [finest] if len(same) > 1 else []), ("small", small)):
                done = others and result["converged"] and results[others[0]]["converged"]
                result[f"{key}_{name}"] = distance(rows, runs[others[0]], key) if done else float("nan")


def _show(label, directory, rows):
    """The table of a history, and the pictures of its fields."""
    columns = ["travel", "push", "vertical", "open", "stick", "slip", "max_pressure", "newton", "cutbacks"]
    print_table(f"snap-fit, {label}", columns, [[row[key] for key in columns] for row in rows])
    on_root(MPI.COMM_WORLD, _pictures, directory, rows)


def run(args):
    """Every case; 1 when a step fails, the forces do not balance, or the hook does not come free."""
    results, runs, drawn = [], {}, set()
    if args.tiny:
        args.geometry, args.order = 1, 1
    for case in cases(args):
        dim, h, count, strain = case
        label = f"{dim}D, h {h:g}, {count} steps, {strain} strain"
        directory = args.o / "_".join([f"{dim}d", f"h{h:g}", str(count), strain])
        fields = not args.tiny and (dim, strain) not in drawn
        converged, history, unknowns = solve(args, case, directory, fields)
        rows = history.rows
        if fields and rows:
            _show(label, directory, rows)
            drawn.add((dim, strain))
        found = measure(rows) if rows else {"imbalance": np.inf, "left": np.inf}
        head = {"dim": dim, "h": h, "strain": strain, "count": count, "unknowns": unknowns, "converged": converged}
        results.append({**head, **found, "cuts": history.cuts, "residuals": history.norms})
        runs[label] = rows
        if rows:
            most = int(np.argmax(column(rows, "push")))
            log.info("%s: last residuals at the peak %s", label, tail(history.norms[most]))
    _compare(results, list(runs.values()))
    columns = [*head, "steps", "cutbacks", "newton", "newton_max", "peak", "peak_vertical", "snap", "left",
               "retention", "imbalance", "push_l2", "vertical_l2", "push_small", "vertical_small"]  # fmt: skip
    nothing = float("nan")
    table = [[row.get(key, nothing) for key in columns] for row in results]
    print_table("snap-fit, forces per width; newton: iterations per load step", columns, table)
    draw(args.o / "clip.png", _plot(runs.items()), columns=2)
    write_json(args.o / "clip.json", {"shape": CLIP.__dict__, "cases": results, "rows": runs})
    log.info("plots and pictures in %s", args.o)
    good = all(row["converged"] and row["imbalance"] < 1e-5 and row["left"] < NO_FORCE for row in results)
    return 0 if good else 1


if __name__ == "__main__":
    parser = make_parser(__doc__, "clip_results")
    parser.add_argument("--dim", type=int, nargs="+", default=[2, 3], choices=[2, 3], help="dimensions")
    text = "element sizes of the surfaces (default: 0.1 0.05 0.025 in the plane, 0.2 in space)"
    parser.add_argument("--h", type=float, nargs="+", default=None, help=text)
    parser.add_argument("--cell", default=None, help="quadrilateral, triangle, hexahedron, tetrahedron")
    text = "degree of the displacement (default: 1, with finite strain that of the mesh)"
    parser.add_argument("--order", type=int, default=None, choices=[1, 2], help=text)
    parser.add_argument("--geometry", type=int, default=2, choices=[1, 2], help="degree of the mesh")
    parser.add_argument("--friction", type=float, default=0.2, help="coefficient of friction")
    parser.add_argument("--yield-stress", type=float, default=25.0, help="0: elastic")
    parser.add_argument("--hardening", type=float, default=50.0, help="d(yield stress) / d(plastic strain)")
    parser.add_argument("--steps", type=int, nargs="+", default=[120], help="load steps of the way in")
    parser.add_argument("--strain", nargs="+", choices=STRAINS, default=["small"], help="small, finite, or both")
    parser.add_argument("--pull", action="store_true", help="pull the clip back out afterwards")
    main(run, parser)
