"""Strong and weak scaling of a ball pressed into a block: time by phase, memory, messages, balance.

    for n in 1 2 4 8; do mpirun -n $n python drivers/scaling.py -o scaling --unknowns 50000 100000 200000 400000; done

Each run solves the sizes given for its number of ranks and puts its rows into scaling.json in the output directory, in
place of older ones of the same ranks, size and case. Tables and plot are then made of all rows there: sizes solved on
several numbers of ranks show strong scaling, rows with equal unknowns per rank (--per-rank gives these) weak scaling.

The cases: linear (elastic bodies under body forces, no contact), elastic, frictional, plastic (frictionless contact;
perfect plasticity of both bodies). The cells: tetrahedra of degree 1 (the default), tetrahedra of degree 2, hexahedra
of degree 1 and 2; hexahedra make a block with a domed underside instead of the ball. Seconds are those of the slowest
rank; seconds of a phase leave out the phases in it; "exchange" is the time in messages of pcontact, waiting for others
included (those of the solver count there).
"""

import gc
import json
from pathlib import Path

import numpy as np

from drivers._common import draw, log, main, make_mesh, make_parser, print_table, running, write_json
from meshes import ball_on_block, dome_on_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps

CASES = ("linear", "elastic", "frictional", "plastic")
DEPTH = 0.02  # that the ball is pressed down [length]
# cell and degree of the displacement
CELLS = {
    "tetrahedra": ("tetrahedron", 1),
    "tetrahedra2": ("tetrahedron", 2),
    "hexahedra": ("hexahedron", 1),
    "hexahedra2": ("hexahedron", 2),
}
KEY = ("ranks", "size", "cells", "case")
LARGE = 1_500_000  # unknowns from which a mesh of tetrahedra is halved once after meshing
WARM = 1500  # unknowns of the mesh on which kernels compile (or load) outside the clock
PHASES = ("read", "distribute", "set_up", "search", "bulk_assembly", "contact_assembly", "matrix", "exchange",
          "preconditioner", "krylov")  # fmt: skip


def press(
    mesh: Path,
    theta: float,
    contact: bool,
    friction: float | None = None,
    yield_stress: float | None = None,
    order: int = 1,
) -> Scene:
    """The ball on the block, in contact or (a linear reference) under body forces; friction and yielding if given."""
    result = Scene(
        mesh=MeshSpec(mesh, order),
        title="ball on block" if contact else "linear elastic reference",
        materials={"material": Material(1000.0, 0.3, yield_stress=yield_stress)},
        bodies=[Body("ball", "material"), Body("block", "material")],
        displacements=[
            Displacement("block_bottom", [0.0, 0.0, 0.0]),
            Displacement("ball_top", [0.0, 0.0, -DEPTH if contact else 0.0]),
        ],
        steps=Steps(),
        output=Output(fields=False),
    )
    if contact:
        result.contacts = [Contact("ball_skin", "block_top", name="ball-block", theta=theta, friction=friction)]
    else:
        result.loads = [Load(region, body_force=[0.3, -0.2, 1.0]) for region in ("ball", "block")]
        result.petsc = {"ksp_rtol": "1e-8", "snes_type": "ksponly"}
    return result


def make_scene(mesh: Path, args, case: str, cells: str = "tetrahedra") -> Scene:
    """The scene of a case; `args` has theta, friction, yield_stress."""
    scene = press(
        mesh, args.theta, case != "linear", args.friction if case == "frictional" else None,
        args.yield_stress if case == "plastic" else None, CELLS[cells][1],
    )  # fmt: skip
    if case == "linear" and args.theta != 1.0:
        # the Krylov method of the others
        scene.petsc.update(ksp_type="gmres", ksp_pc_side="right")
    return scene


class Counts:
    """Observer: iterations of all load steps.

    Attributes
    ----------
    newton, krylov : int
    """

    def __init__(self):
        self.newton = self.krylov = 0

    def step(self, step, u, record):
        """Add the step."""
        self.newton += step.newton
        self.krylov += step.krylov

    def cut(self, target, outcome):
        """Add what the attempt took."""
        self.newton += outcome.newton
        self.krylov += outcome.krylov

    def end(self, converged):
        """Nothing is left to do."""


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
        ``krylov`` and per linear solve, ``seconds`` by phase and of the ``solve`` (search, assembly, linear) and in
        ``total``, ``linear_seconds`` (preconditioner and Krylov), ``triad_gb_per_s`` (memory bandwidth of all ranks),
        ``memory_mb`` (peak, all ranks), ``bytes_per_unknown``, ``messages`` and ``bytes`` of all ranks,
        ``candidates_per_point``, ``ranks_per_point``, ``imbalance`` of ``cells`` and ``contact``.
    """
    # what the last run left behind is not memory of this one
    gc.collect()
    counts = Counts()
    with running(make_scene(mesh, args, case, cells), None, [counts]) as (simulation, converged):
        timing, costs = simulation.times(), simulation.costs
        parallel, memory = costs.parallel(), costs.memory()["solve"]
        row = {"ranks": simulation.comm.size, "size": size, "cells": cells, "case": case, "converged": converged}
        row["unknowns"] = simulation.problem.space.n_dofs
    row.update(newton=counts.newton, krylov=counts.krylov, krylov_per_solve=counts.krylov / max(counts.newton, 1))
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


def name_of(row: dict) -> str:
    """The case of a row, and its cells where they are not tetrahedra of degree 1."""
    return row["case"] if row["cells"] == "tetrahedra" else f"{row['case']}, {row['cells']}"


def growth(rows: list[dict]) -> list[dict]:
    """How a case grows with its size, on a number of ranks: from the smallest to the largest.

    Returns
    -------
    list of dict
        ``case``, ``ranks``, ``sizes`` (two), ``exponent`` (of the seconds of the solve over the unknowns), ``newton``
        (iterations more), ``krylov`` (iterations per linear solve: largest over that of the smallest).
    """
    groups, result = {}, []
    for row in rows:
        if row["converged"]:
            groups.setdefault((name_of(row), row["ranks"]), []).append(row)
    for (case, ranks), group in groups.items():
        group.sort(key=lambda row: row["unknowns"])
        first, last = group[0], group[-1]
        if last["unknowns"] > first["unknowns"]:
            times = [row["seconds"]["solve"] for row in (last, first)]
            result.append({
                "case": case, "ranks": ranks, "sizes": [first["unknowns"], last["unknowns"]],
                "exponent": float(np.log(times[0] / times[1]) / np.log(last["unknowns"] / first["unknowns"])),
                "newton": last["newton"] - first["newton"],
                "krylov": max(row["krylov_per_solve"] for row in group) / max(first["krylov_per_solve"], 1e-300),
            })  # fmt: skip
    return result


def series(rows: list[dict], weak: bool) -> dict[tuple, list[dict]]:
    """Converged rows that belong together, by name and size, or (weak scaling) by name and size per rank.

    The name is that of the case, and of the cells where they are not tetrahedra of degree 1.

    Only those with two numbers of ranks at least; sorted by ranks.
    """
    groups = {}
    for row in rows:
        size = round(row["size"] / row["ranks"]) if weak else row["size"]
        if row["converged"]:
            groups.setdefault((name_of(row), size), []).append(row)
    return {key: sorted(group, key=lambda row: row["ranks"]) for key, group in groups.items() if len(group) > 1}


def efficiencies(group: list[dict], weak: bool) -> list[float]:
    """Parallel efficiency of the solve of a series, that of its fewest ranks being 1."""
    first = group[0]
    return [
        first["seconds"]["solve"] / row["seconds"]["solve"] * (1.0 if weak else first["ranks"] / row["ranks"])
        for row in group
    ]


def key_of(row: dict) -> tuple:
    """What a row has in common with the linear elastic solve on the same mesh and ranks."""
    return tuple(row[key] for key in KEY if key != "case")


def ratio(row: dict, linear: dict[tuple, float]) -> str:
    """Seconds of a solve over those of the linear elastic solve on the same mesh and ranks, where that was run."""
    unit = linear.get(key_of(row))
    return f"{row['seconds']['solve'] / unit:.2f}" if unit else "-"


def report(rows: list[dict]) -> None:
    """Tables of all rows."""
    header = ["ranks", "unknowns", "case", "Newton", "Krylov", "per solve", "solve [s]", "to linear", "total [s]",
              "memory [MB]", "B/unknown", "messages", "MB sent", "candidates", "asked", "imb. cells",
              "contact"]  # fmt: skip
    linear = {key_of(row): row["linear_seconds"] for row in rows if row["case"] == "linear"}
    table = [
        [row["ranks"], row["unknowns"], name_of(row), row["newton"], row["krylov"], f"{row['krylov_per_solve']:.1f}",
         f"{row['seconds']['solve']:.2f}", ratio(row, linear), f"{row['seconds']['total']:.2f}",
         f"{row['memory_mb']:.0f}",
         f"{row['bytes_per_unknown']:.0f}", row["messages"], f"{row['bytes'] / 1e6:.1f}",
         f"{row['candidates_per_point']:.2f}", f"{row['ranks_per_point']:.2f}", f"{row['imbalance']['cells']:.2f}",
         f"{row['imbalance']['contact']:.2f}"]
        for row in rows
    ]  # fmt: skip
    title = "work and memory; candidates and ranks asked are per point, imbalance is largest over mean"
    print_table(title, header, table)
    table = [
        [row["ranks"], row["unknowns"], name_of(row), *(f"{row['seconds'][phase]:.3f}" for phase in PHASES)]
        for row in rows
    ]
    print_table("seconds of the phases", ["ranks", "unknowns", "case", *PHASES], table)
    table = [
        [entry["case"], entry["ranks"], *entry["sizes"], f"{entry['exponent']:.2f}", f"{entry['newton']:+d}",
         f"{entry['krylov']:.2f}"]
        for entry in growth(rows)
    ]  # fmt: skip
    if table:
        header = ["case", "ranks", "from", "to unknowns", "time exponent", "Newton", "Krylov per solve, times"]
        print_table("growth with the size", header, table)
    for weak in (False, True):
        table = [
            [case, size, row["ranks"], f"{row['seconds']['solve']:.3f}", f"{100.0 * part:.0f} %"]
            for (case, size), group in series(rows, weak).items()
            for row, part in zip(group, efficiencies(group, weak), strict=True)
        ]
        if table:
            header = ["case", "unknowns per rank" if weak else "unknowns", "ranks", "solve [s]", "efficiency"]
            print_table("weak scaling" if weak else "strong scaling", header, table)


def plot(path: Path, rows: list[dict]) -> None:
    """Seconds of the solve over the ranks: strong scaling with its ideal, and weak scaling."""

    def paint(axes):
        colours, marks = dict(zip(CASES, ("#8a949c", "#2f6690", "#c8553d", "#588b3f"), strict=True)), "osv^D<>"

        for one, weak in zip(axes, (False, True), strict=True):
            groups = series(rows, weak)
            sizes = sorted({size for _, size in groups})
            for (case, size), group in groups.items():
                ranks, seconds = [r["ranks"] for r in group], [r["seconds"]["solve"] for r in group]
                mark = marks[sizes.index(size) % len(marks)]
                colour = colours[case.split(",")[0]]
                one.loglog(ranks, seconds, "-" + mark, ms=4, lw=1, color=colour, label=f"{case}, {size}")
                ideal = [seconds[0] if weak else seconds[0] * ranks[0] / n for n in ranks]
                one.loglog(ranks, ideal, ":", lw=0.8, color=colour)
            one.set(xlabel="ranks", ylabel="solve [s]")
            one.set_title("equal unknowns per rank" if weak else "equal unknowns", fontsize=9)
            if groups:
                one.set_xticks(sorted({r["ranks"] for group in groups.values() for r in group}))
                one.xaxis.set_major_formatter("{x:g}")
                one.minorticks_off()
                one.legend(frameon=False, fontsize=7)

    draw(path, paint, columns=2)


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
    report(rows)
    plot(args.o / "scaling.png", rows)
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
