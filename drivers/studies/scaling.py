"""Strong and weak scaling of a ball pressed into a block: time by phase, memory, messages, balance.

    for n in 1 2 4 8; do mpirun -n $n python drivers/studies/scaling.py -o scaling --unknowns 50000 100000 200000; done

Each run solves the sizes given for its number of ranks and puts its rows into scaling.json in the output directory, in
place of older ones of the same ranks, size and case. Tables and plot are then made of all rows there: sizes solved on
several numbers of ranks show strong scaling, rows with equal unknowns per rank (--per-rank gives these) weak scaling.

The cases: linear (elastic bodies under body forces, no contact), elastic, frictional, plastic (frictionless contact;
perfect plasticity of both bodies), finite and finite_frictional (elastic and frictional with finite strain), stick
(nothing slips), and stick with the source or the target 100 times stiffer, or
100 times the default gamma0. The cells: tetrahedra of degree 1 (the default), tetrahedra of degree 2, hexahedra
of degree 1 and 2; hexahedra make a block with a domed underside instead of the ball. Seconds are those of the slowest
rank; seconds of a phase leave out the phases in it; "exchange" is the time in messages of pcontact, waiting for others
included (those of the solver count there). Tables are written to scaling.md too.
"""

import gc
import json
from pathlib import Path

import numpy as np

from drivers._common import log, main, make_mesh, make_parser, running, write_json
from drivers.studies._harness import Counts
from drivers.studies._press import CASES, CELLS, make_scene
from drivers.studies._scaling import KEY, plot, plot_growth, report, series
from meshes import ball_on_block, dome_on_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI

LARGE = 1_500_000  # unknowns from which a mesh of tetrahedra is halved once after meshing
WARM = 1500  # unknowns of the mesh on which kernels compile (or load) outside the clock


def triad(comm, n: int = 20_000_000) -> float:
    """Memory bandwidth of all ranks together [GB/s]: a = b + s c, best of five. *Collective.*"""
    a, b, c = np.zeros(n), np.ones(n), np.ones(n)
    best = np.inf
    for _ in range(5):
        comm.Barrier()
        start = MPI.Wtime()
        np.multiply(c, 3.0, out=a)
        np.add(a, b, out=a)
        best = min(best, comm.allreduce(MPI.Wtime() - start, op=MPI.MAX))
    # numpy makes two passes of it: two arrays and three
    return comm.size * 5 * 8 * n / best / 1e9


def solve(mesh: Path, args, size: int, case: str, cells: str = "tetrahedra") -> dict:
    """One row. *Collective.*

    Returns
    -------
    dict
        ``ranks``, ``size`` (unknowns asked for), ``unknowns``, ``cells``, ``case``, ``converged``, ``newton``,
        ``krylov`` and per linear solve (mean, and ``krylov_most``), ``seconds`` by phase and of the ``solve`` (search,
        assembly, linear) and in ``total``, ``linear_seconds`` (preconditioner and Krylov), ``triad_gb_per_s`` (memory
        bandwidth of all ranks), ``memory_mb`` (peak, all ranks), ``bytes_per_unknown``, ``messages`` and ``bytes`` of
        all ranks, ``candidates_per_point``, ``ranks_per_point``, ``imbalance`` of ``cells`` and ``contact``.
    """
    # what the last run left behind is not memory of this one
    gc.collect()
    counts = Counts()
    scene = make_scene(mesh, case, args.theta, args.friction, args.yield_stress, cells)
    with running(scene, None, [counts]) as (simulation, converged):
        timing, costs = simulation.times(), simulation.costs
        parallel, memory = costs.parallel(), costs.memory()["solve"]
        row = {"ranks": simulation.comm.size, "size": size, "cells": cells, "case": case, "converged": converged}
        row["unknowns"] = simulation.problem.space.n_dofs
    row.update(newton=counts.newton, krylov=counts.krylov, krylov_per_solve=counts.krylov / max(counts.newton, 1))
    row["krylov_most"] = counts.hardest
    row["seconds"] = {**timing["phases"], "total": timing["total"]}
    row["linear_seconds"] = timing["linear"]
    row["seconds"]["solve"] = timing["search"] + timing["assembly"] + timing["linear"]
    row.update(memory_mb=memory["peak_mb"], bytes_per_unknown=memory["peak_bytes_per_unknown"])
    row.update({key: sum(entry[key] for entry in parallel["exchange"].values()) for key in ("messages", "bytes")})
    row.update({key: parallel["search"][key] for key in ("candidates_per_point", "ranks_per_point")})
    row["imbalance"] = {key: parallel["imbalance"][key] for key in ("cells", "contact")}
    return row


def merged(old: list[dict], new: list[dict]) -> list[dict]:
    """Rows, newer ones in place of older ones with the same `KEY`, sorted by cells, case, size and ranks."""
    rows = {tuple(row[key] for key in KEY): row for row in [*old, *new]}
    places = {"case": CASES.index, "cells": list(CELLS).index}
    order = ("cells", "case", "size", "ranks")
    return sorted(rows.values(), key=lambda row: [places.get(key, int)(row[key]) for key in order])


def load(path: Path) -> list[dict]:
    """Rows found in a file, on every rank. *Collective.*

    Raises
    ------
    InputError
        When the file is there and is not one of this driver.
    """

    def read():
        if not path.exists():
            return []
        try:
            return merged(json.loads(path.read_text())["rows"], [])
        except (ValueError, KeyError, TypeError) as error:
            text = f"{path}: found {type(error).__name__} ({error}), allowed: a file that this driver wrote"
            raise InputError(text) from None

    return MPI.COMM_WORLD.bcast(on_root(MPI.COMM_WORLD, read))


def keep(path: Path, row: dict) -> list[dict]:
    """Put a row into the file, at once: a run that is killed leaves what it has. Returns all rows. *Collective.*"""
    rows = merged(load(path), [row])
    write_json(path, {"rows": rows})
    MPI.COMM_WORLD.Barrier()
    return rows


def sizes_of(args, ranks: int) -> list[int]:
    """Unknowns to solve, ascending.

    Raises
    ------
    InputError
        No positive numbers.
    """
    if args.tiny:
        return [WARM]
    for name, values in (("unknowns", args.unknowns or []), ("per-rank", args.per_rank or [])):
        if any(value < 1000 for value in values):
            raise InputError(f"command line: --{name}: found {min(values)}, allowed: at least 1000")
    chosen = {*(args.unknowns or []), *(ranks * value for value in args.per_rank or [])}
    return sorted(chosen) or [20_000]


def mesh_of(args, size: int, cells: str = "tetrahedra") -> Path:
    """The mesh of a size; runs on other numbers of ranks find it there. *Collective.*"""
    cell, order = CELLS[cells]
    name = {"tetrahedron": "ball", "hexahedron": "dome"}[cell]
    path = args.o / (f"{name}_{size}.msh" if order == 1 else f"{name}{order}_{size}.msh")
    make = {"tetrahedron": ball_on_block, "hexahedron": dome_on_block}[cell]
    there = MPI.COMM_WORLD.bcast(path.exists())
    # gmsh cannot make the largest ones in the memory of a small machine
    more = {"halvings": 1} if cells == "tetrahedra" and size > LARGE else {}
    return path if there else make_mesh(make, path, unknowns=size, order=order, **more)


def run(args) -> int:
    """All sizes, cells and cases on these ranks; the exit status."""
    ranks, good, rows = MPI.COMM_WORLD.size, True, load(args.o / "scaling.json")
    bandwidth = triad(MPI.COMM_WORLD, 20_000 if args.tiny else 20_000_000)
    sizes, cases = sizes_of(args, ranks), args.cases or list(CASES[1:])
    for cells in args.cells:
        if not args.tiny:
            warm = mesh_of(args, WARM, cells)
            for case in cases:
                solve(warm, args, WARM, case, cells)
        for size in sizes:
            mesh = mesh_of(args, size, cells)
            for case in cases:
                row = {**solve(mesh, args, size, case, cells), "triad_gb_per_s": bandwidth}
                good = good and row["converged"]
                rows = keep(args.o / "scaling.json", row)
    report(args.o / "scaling.md", rows)
    plot(args.o / "scaling.png", rows)
    plot_growth(args.o / "growth.png", rows)
    if not any(series(rows, weak) for weak in (False, True)):
        log.info("one number of ranks so far; run again with others and the same -o")
    return 0 if good else 1


def make_options():
    """The parser of this driver."""
    parser = make_parser(__doc__, "scaling_results")
    add = parser.add_argument
    add("--unknowns", type=int, nargs="+", metavar="N", help="sizes (20000)")
    add("--per-rank", type=int, nargs="+", metavar="N", help="sizes for weak scaling: unknowns per rank")
    add("--cases", nargs="+", choices=CASES, help="elastic frictional plastic if absent")
    add("--cells", nargs="+", choices=CELLS, default=["tetrahedra"], help="(tetrahedra)")
    add("--theta", type=float, choices=(1.0, 0.0, -1.0), default=0.0, help="variant of Nitsche's method (0)")
    add("--friction", type=float, default=0.3, help="coefficient of the frictional case (0.3)")
    add("--yield-stress", type=float, default=5.0, help="of the plastic case (5)")
    return parser


if __name__ == "__main__":
    main(run, make_options())
