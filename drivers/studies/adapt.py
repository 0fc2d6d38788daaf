"""A flat punch with sharp corners on a block: meshes refined everywhere, and where the error estimate is large.

The stress is singular at the corner of the punch, so uniform refinement gains little, whatever the degree. Refinement
after the estimate restores the rate N^(-p/2) of smooth solutions, with N unknowns and degree p in the plane.

The error of a displacement-driven, frictionless problem is that of its potential, error^2 = 2 (Pi_h - Pi), for
theta = 1 the one that Nitsche's method makes stationary,

    Pi_h = 1/2 int sigma : eps + 1/2 int (P^2 - t^2) / gamma,

against that of a much finer run: the last of a series of degree 2, refined after its estimate.

``--pressure`` follows the contact pressure in L2 instead, on meshes that are halved and on the first and the last ones
of runs that name its error, on one rank. It is compared with that of a run that names a smaller error, and may be that
wrong itself: the errors drawn are the roots of the sums of both squares.

There the punch is as soft as the block and is pressed by far less: its pressure goes like r^-0.23 at the corner then,
and the block does not slip off it by more than the smallest cells.
"""

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, print_table, running, write_json
from drivers.studies._harness import composed, solved
from drivers.studies._named_pressure import Pressure
from drivers.studies._named_pressure import made as made_pressure
from meshes.punch import punch
from pcontact.adapt.loop import Loop, reach
from pcontact.io.refine import largest_contributions, read_estimate
from pcontact.mesh.refinement.gather import halved_where
from pcontact.mesh.refinement.refine import refine
from pcontact.mesh.remesh import write_refined
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Contact, Displacement, Material, MeshSpec, Output
from pcontact.scene.target import Target
from pcontact.view.show import show

FREE = "free"
STROKE, STIFF = -0.02, 100.0
WAYS = ("uniform", "adaptive")
# [-] Error of the mesh that is drawn.
NAMED = 0.01
# Stroke of the soft punch, errors of the pressure that are named, that of the reference, tolerance.
GENTLE, TARGETS, FINEST, RTOL = -2e-9, (0.3, 0.1, 0.05, 0.02, 0.01), 0.005, "1e-10"


def punch_scene(path, degree, theta=1.0):
    """The scene of a stiff punch on a block.

    Parameters
    ----------
    path : mesh of :func:`meshes.punch.punch`, or one refined from it
    degree : int
    theta : float
    """
    return composed(
        MeshSpec(path, order=degree),
        {"punch": Material(STIFF, 0.3), "block": Material(1.0, 0.3)},
        {"symmetry": [0.0, FREE], "block_bottom": [FREE, 0.0], "punch_top": [FREE, STROKE]},
        title=f"flat punch, degree {degree}",
        contacts=[Contact("block_under", "punch_face", name="face", theta=theta)],
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
    own += 0.5 * float(state["weight"] @ (squares / item.method.gamma))
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


def gentle_scene(folder, degree):
    """The scene of a punch that is as soft as the block."""
    scene = punch_scene(make_mesh(punch, folder / "gentle.msh", h=0.5, order=2), degree, 0.0)
    scene.materials["punch"] = scene.materials["block"]
    scene.displacements[2] = Displacement("punch_top", [FREE, GENTLE])
    scene.output, scene.petsc = Output(fields=False, estimate=True), {"snes_rtol": RTOL, "snes_atol": "1e-20"}
    return scene


def pressures_of_loops(scene, errors):
    """Unknowns, pressures and errors named of runs that name the error of their pressure: of their first mesh, and of
    the last one of each."""
    found = []
    for error in errors:
        kept = []
        loop = Loop(replace(scene, accuracy=Target(error, "pressure:face")),
                    take=lambda run, converged, kept=kept: kept.append(Pressure.of(run, "face")))  # fmt: skip
        loop.run()
        own = [(done.unknowns, pressure, done.error) for done, pressure in zip(loop.passes, kept, strict=True)]
        found += own[-1:] if found else own[:1] + own[-1:]
    return found


def pressures_of_halved(scene, most):
    """Unknowns and pressures of runs on halved meshes, which name no error."""
    found, mesh = [], None
    while True:
        with solved(scene.copy(), mesh) as (simulation, _):
            mesh, unknowns = simulation.mesh, simulation.problem.space.n_dofs
            found.append((unknowns, Pressure.of(simulation, "face"), float("nan")))
        if 4 * unknowns > most:
            return found
        mesh = refine(mesh, np.full(sum(len(block.nodes) for block in mesh.blocks), mesh.dim)).mesh


def follow_pressure(args):
    """Errors of the pressure on both kinds of meshes, for all degrees; exit status."""
    if MPI.COMM_WORLD.size > 1:
        raise InputError(f"command line: --pressure: found {MPI.COMM_WORLD.size} ranks; allowed: one")
    targets, finest = ((0.7,), 0.65) if args.tiny else (TARGETS, FINEST)
    (reference, lacks), curves, rates = made_pressure(gentle_scene(args.o, 2), finest, "face"), {}, {}
    for degree in args.degree:
        scene = gentle_scene(args.o, degree)
        found = {"uniform": pressures_of_halved(scene, 200 if args.tiny else args.most),
                 "adaptive": pressures_of_loops(scene, targets)}  # fmt: skip
        for way, runs in found.items():
            # where one has larger facets than the other, it is smooth between its points
            sides = [sorted((reference, one), key=lambda side: len(side.x)) for _, one, _ in runs]
            off = [float(np.hypot(fine.distance(coarse), lacks)) for coarse, fine in sides]
            rows = sorted(({"unknowns": run[0], "norm": 1.0, "error": error, "named": run[2]}
                           for run, error in zip(runs, off, strict=True)), key=lambda row: row["unknowns"])  # fmt: skip
            curves[degree, way], rates[degree, way] = rows, [_rate(rows, key) for key in ("error", "named")]
            keys = ("unknowns", "error", "named")
            print_table(f"pressure, degree {degree}, {way}", keys, [[row[key] for key in keys] for row in rows])
            log.info("  rate N^(%.3f), named N^(%.3f)", *rates[degree, way])
    data = [{"degree": d, "way": w, "rate": rates[d, w], "meshes": rows} for (d, w), rows in curves.items()]
    write_json(args.o / "pressure.json", {"reference": lacks, "series": data})
    draw(args.o / "pressure.png", partial(_paint, curves=curves, keys={"error": "-", "named": ":"}, norm="norm",
                                          of="contact pressure of the soft punch in L2"))  # fmt: skip
    if args.publish is not None:
        shutil.copy(args.o / "pressure.png", args.publish / "accuracy_pressure.png")
    return 0


def _rate(rows, key):
    """The power of the unknowns that errors fall with."""
    if len(rows) < 2:
        return float("nan")
    n, error = np.log([[row["unknowns"], row[key]] for row in rows]).T
    return float(np.polyfit(n, error, 1)[0])


def _paint(axes, curves, keys=None, norm="energy_norm", of="flat punch"):
    for (degree, way), rows in curves.items():
        n, style = [row["unknowns"] for row in rows], {"uniform": "o", "adaptive": "s"}[way]
        colour = f"C{degree - 1}"
        for key, line in (keys or {"error": "-", "estimate": ":"}).items():
            values = [row[key] / row[norm] for row in rows]
            if not np.any(np.isfinite(values)):
                continue
            axes.loglog(n, values, line, marker=style, mfc="none", color=colour, label=f"{way}, degree {degree}: {key}")
    axes.set(xlabel="unknowns", ylabel=f"relative to the {norm.replace('_', ' ')}", title=of)
    axes.legend(fontsize=6)


def run(args):
    """Both ways, all degrees; exit status."""
    if args.pressure:
        return follow_pressure(args)
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
    add("--pressure", action="store_true", help="follow the contact pressure of a soft punch instead of the energy")
    add("--part", type=float, default=0.5, help="of the squared estimate, whose cells are refined (0.5)")
    return p


if __name__ == "__main__":
    main(run, parser())
