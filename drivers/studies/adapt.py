"""A flat punch with sharp corners on a block: meshes refined everywhere, and where the error estimate is large.

The stress is singular at the corner of the punch, so uniform refinement gains little, whatever the degree. Refinement
after the estimate restores the rate N^(-p/2) of smooth solutions, with N unknowns and degree p in the plane.

The error of a displacement-driven, frictionless problem is that of its potential, error^2 = 2 (Pi_h - Pi), for
theta = 1 the one that Nitsche's method makes stationary,

    Pi_h = 1/2 int sigma : eps + 1/2 int (P^2 - t^2) / gamma,

against that of a much finer run: the last of a series of degree 2, refined after its estimate.
"""

import shutil
from functools import partial
from pathlib import Path

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, print_table, running, write_json
from meshes.punch import punch
from pcontact.adapt.loop import reach
from pcontact.estimate.size import largest_contributions
from pcontact.io.refine import read_estimate
from pcontact.mesh.refinement.gather import halved_where
from pcontact.mesh.remesh import write_refined
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.scene.target import Target
from pcontact.view.show import show

FREE = "free"
STROKE, STIFF = -0.02, 100.0
WAYS = ("uniform", "adaptive")
# [-] Error of the mesh that is drawn.
NAMED = 0.01


def punch_scene(path, degree, theta=1.0):
    """The scene of a stiff punch on a block.

    Parameters
    ----------
    path : mesh of :func:`meshes.punch.punch`, or one refined from it
    degree : int
    theta : float
    """
    return Scene(
        title=f"flat punch, degree {degree}",
        mesh=MeshSpec(path, order=degree),
        materials={"punch": Material(STIFF, 0.3), "block": Material(1.0, 0.3)},
        bodies=[Body("punch", "punch"), Body("block", "block")],
        contacts=[Contact("block_under", "punch_face", name="face", theta=theta)],
        displacements=[
            Displacement("symmetry", [0.0, FREE]),
            Displacement("block_bottom", [FREE, 0.0]),
            Displacement("punch_top", [FREE, STROKE]),
        ],
        output=Output(fields=True, estimate=True),
        petsc={"pc_type": "lu", "ksp_type": "preonly", "pc_factor_mat_solver_type": "mumps"},
    )


def potential(simulation):
    """Pi_h [energy]. *Collective.*"""
    problem, u = simulation.problem, simulation.stepper.u
    forces = np.zeros((problem.space.n_owned, problem.space.dim))
    problem.items[0].residual(u, forces)
    own = 0.5 * float(np.vdot(forces, u.getArray(readonly=True)))
    item = problem.contacts[0]
    state = item.state(u)
    squares = state["pressure"] ** 2 - state["normal_stress"] ** 2
    own += 0.5 * float(state["weight"] @ (squares / item.gamma[item.source.facet]))
    return simulation.comm.allreduce(own, op=MPI.SUM)


def next_mesh(directory, path, way, part):
    """Refine after the estimate of a run, or everywhere. *Collective.*"""

    def marked():
        raw, estimates, _ = read_estimate(Path(directory))
        return raw, np.ones(len(estimates), bool) if way == "uniform" else largest_contributions(estimates, part)

    comm = MPI.COMM_WORLD
    raw, cells = on_root(comm, marked) or (None, None)
    on_root(comm, write_refined, path, halved_where(comm, raw, cells, path))
    return path


def series(args, degree, way, most):
    """Runs on finer and finer meshes up to a number of unknowns: a dict for each, and whether all converged."""
    path = make_mesh(punch, args.o / "start.msh", h=args.h)
    rows = []
    while True:
        directory = args.o / f"{way}{degree}_{len(rows)}"
        with running(punch_scene(path, degree), directory) as (simulation, converged):
            if not converged:
                return rows, False
            estimate = simulation.error_estimate.last
            rows.append({"unknowns": simulation.problem.space.n_dofs, "cells": simulation.mesh.n_cells_total,
                         "potential": potential(simulation), "estimate": estimate["absolute"],
                         "energy_norm": estimate["energy_norm"], "algebraic": estimate["algebraic"]})  # fmt: skip
        if rows[-1]["unknowns"] * (4 if way == "uniform" else 1) > most:
            return rows, True
        path = next_mesh(directory, args.o / f"{way}{degree}_{len(rows)}.msh", way, args.part)


def add_errors(rows, reference):
    """Errors, effectivity and rates beside the potentials; the rate from the first half of the meshes on."""
    for row in rows:
        row["error"] = float(np.sqrt(max(2.0 * (row["potential"] - reference), 0.0)))
        row["effectivity"] = row["estimate"] / row["error"] if row["error"] > 0.0 else float("nan")
    half = [row for row in rows[len(rows) // 2 :] if row["error"] > 0.0]
    if len(half) < 2:
        return {"error": float("nan"), "estimate": float("nan")}
    n, error, estimate = (np.log([row[key] for row in half]) for key in ("unknowns", "error", "estimate"))
    return {"error": float(np.polyfit(n, error, 1)[0]), "estimate": float(np.polyfit(n, estimate, 1)[0])}


def _paint(axes, curves):
    for (degree, way), rows in curves.items():
        n, style = [row["unknowns"] for row in rows], {"uniform": "o", "adaptive": "s"}[way]
        colour = f"C{degree - 1}"
        for key, line in (("error", "-"), ("estimate", ":")):
            values = [row[key] / row["energy_norm"] for row in rows]
            axes.loglog(n, values, line, marker=style, mfc="none", color=colour, label=f"{way}, degree {degree}: {key}")
    axes.set(xlabel="unknowns", ylabel="relative to the energy norm", title="flat punch")
    axes.legend(fontsize=6)


def run(args):
    """Both ways, all degrees; exit status."""
    if args.tiny:
        args.h, args.most, args.finest, args.part = 0.5, 200, 800, 0.8
    if args.finest < 2 * args.most:
        raise InputError(f"command line: --finest: found {args.finest}; allowed: at least twice --most")
    finest, good = series(args, 2, "adaptive", args.finest)
    reference, curves, rates = finest[-1]["potential"], {}, {}
    for degree in args.degree:
        for way in WAYS:
            rows, converged = series(args, degree, way, args.most)
            good &= converged
            rates[degree, way] = add_errors(rows, reference)
            curves[degree, way] = rows
            keys = ("cells", "unknowns", "error", "estimate", "effectivity", "algebraic")
            print_table(f"degree {degree}, {way}", keys, [[row[k] for k in keys] for row in rows])
            log.info("  rate N^(%.3f), of the estimate N^(%.3f)", *rates[degree, way].values())
    data = [{"degree": d, "way": w, "rates": rates[d, w], "meshes": rows} for (d, w), rows in curves.items()]
    write_json(args.o / "adapt.json", {"reference": reference, "reference_meshes": finest, "series": data})
    draw(args.o / "adapt.png", partial(_paint, curves=curves))
    if args.publish is not None:
        publish(args)
    return 0 if good else 1


def publish(args):
    """Draw the pictures of docs/accuracy.md: the curves, and the last mesh of a run that reaches 1 %. *Collective.*"""
    scene = punch_scene(make_mesh(punch, args.o / "coarse.msh", h=0.5, order=2), 2)
    scene.accuracy = Target(NAMED)
    reach(scene, directory=args.o / "named")

    def work():
        shutil.copy(args.o / "adapt.png", args.publish / "accuracy_rate.png")
        look = {"field": "error_estimate", "smooth": "false", "size": "1000x640"}
        show(str(args.o / "named"), {**look, "o": str(args.publish / "accuracy_mesh.png")})

    on_root(MPI.COMM_WORLD, work)


def parser():
    """The driver's options."""
    p = make_parser(__doc__, "adapt_results")
    add = p.add_argument
    add("--degree", type=int, nargs="+", default=[1, 2], choices=[1, 2], help="of the displacement")
    add("--h", type=float, default=0.25, help="element size of the first mesh (0.25)")
    add("--most", type=int, default=20000, help="unknowns at which a series ends (20000)")
    add("--finest", type=int, default=100000, help="unknowns of the reference (100000)")
    add("--publish", type=type(p.get_default("o")), metavar="DIR", help="where the pictures of docs/accuracy.md go")
    add("--part", type=float, default=0.5, help="of the squared estimate, whose cells are refined (0.5)")
    return p


if __name__ == "__main__":
    main(run, parser())
