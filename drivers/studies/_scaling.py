"""Tables and plots of rows that `drivers/studies/scaling.py` measured."""

from pathlib import Path

import numpy as np

from drivers._common import draw, markdown, print_table
from drivers.studies._press import CASES
from pcontact.runtime.petsc import MPI

KEY = ("ranks", "size", "cells", "case")
PHASES = ("read", "distribute", "set_up", "search", "bulk_assembly", "contact_assembly", "matrix", "exchange",
          "preconditioner", "krylov")  # fmt: skip
COLOURS = dict(zip(
    CASES, ("#8a949c", "#2f6690", "#c8553d", "#588b3f", "#7fb2d6", "#e39a7c", *["#b08a3e"] * 4), strict=True
))  # fmt: skip


def name_of(row: dict) -> str:
    """The case of a row, and its cells where they are not tetrahedra of degree 1."""
    return row["case"] if row["cells"] == "tetrahedra" else f"{row['case']}, {row['cells']}"


def growth(rows: list[dict]) -> list[dict]:
    """Measure how a case grows with its size, on a number of ranks: from the smallest to the largest.

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
    """Return what a row has in common with the linear elastic solve on the same mesh and ranks."""
    return tuple(row[key] for key in KEY if key != "case")


def assembly(row: dict) -> float:
    """Seconds of the solve that are neither search nor linear solves."""
    return row["seconds"]["solve"] - row["linear_seconds"] - row["seconds"]["search"]


def ratio(row: dict, linear: dict[tuple, float]) -> str:
    """Seconds of a solve over those of the linear elastic solve on the same mesh and ranks, where that was run."""
    unit = linear.get(key_of(row))
    return f"{row['seconds']['solve'] / unit:.2f}" if unit else "-"


def _work(rows):
    """Iterations, seconds and memory of every row."""
    linear = {key_of(row): row["linear_seconds"] for row in rows if row["case"] == "linear"}
    header = ["ranks", "unknowns", "case", "Newton", "Krylov", "per solve", "at most", "solve [s]", "to linear",
              "assembly", "search", "total [s]", "memory [MB]", "B/unknown"]  # fmt: skip
    table = []
    for row in rows:
        seconds = row["seconds"]
        shares = [f"{100.0 * part / seconds['solve']:.1f} %" for part in (assembly(row), seconds["search"])]
        table.append([
            row["ranks"], row["unknowns"], name_of(row), row["newton"], row["krylov"], f"{row['krylov_per_solve']:.1f}",
            row.get("krylov_most", "-"), f"{seconds['solve']:.2f}",
            *(["-"] * 3 if row["case"] == "linear" else [ratio(row, linear), *shares]),
            f"{seconds['total']:.2f}", f"{row['memory_mb']:.0f}", f"{row['bytes_per_unknown']:.0f}",
        ])  # fmt: skip
    return "work and memory; Krylov iterations in all, per linear solve, and of the hardest", header, table


def _parallel(rows):
    """Describe what ranks tell each other, and how work is spread."""
    header = ["ranks", "unknowns", "case", "messages", "MB sent", "candidates", "asked", "imb. cells", "contact"]
    table = [
        [row["ranks"], row["unknowns"], name_of(row), row["messages"], f"{row['bytes'] / 1e6:.1f}",
         f"{row['candidates_per_point']:.2f}", f"{row['ranks_per_point']:.2f}",
         f"{row['imbalance']['cells']:.2f}", f"{row['imbalance']['contact']:.2f}"]
        for row in rows
    ]  # fmt: skip
    return "messages; candidates and ranks asked are per point, imbalance is largest over mean", header, table


def _growth(rows):
    table = [
        [entry["case"], entry["ranks"], *entry["sizes"], f"{entry['exponent']:.2f}", f"{entry['newton']:+d}",
         f"{entry['krylov']:.2f}"]
        for entry in growth(rows)
    ]  # fmt: skip
    header = ["case", "ranks", "from", "to unknowns", "time exponent", "Newton", "Krylov per solve, times"]
    return "growth with the size", header, table


def _scaling(rows, weak):
    table = [
        [case, size, row["ranks"], f"{row['seconds']['solve']:.3f}", f"{100.0 * part:.0f} %"]
        for (case, size), group in series(rows, weak).items()
        for row, part in zip(group, efficiencies(group, weak), strict=True)
    ]
    header = ["case", "unknowns per rank" if weak else "unknowns", "ranks", "solve [s]", "efficiency"]
    return "weak scaling" if weak else "strong scaling", header, table


def report(path: Path, rows: list[dict]) -> None:
    """Log the tables of all rows, and write them in Markdown (rank 0)."""
    phases = [
        [row["ranks"], row["unknowns"], name_of(row), *(f"{row['seconds'][phase]:.3f}" for phase in PHASES)]
        for row in rows
    ]
    tables = [
        _work(rows), _parallel(rows), ("seconds of the phases", ["ranks", "unknowns", "case", *PHASES], phases),
        _growth(rows), _scaling(rows, False), _scaling(rows, True),
    ]  # fmt: skip
    lines = []
    for title, header, table in tables:
        if table:
            print_table(title, header, table)
            lines += [f"{title[0].upper()}{title[1:]}:", "", *markdown(header, table), ""]
    if MPI.COMM_WORLD.rank == 0:
        path.write_text("\n".join(lines))


def plot(path: Path, rows: list[dict]) -> None:
    """Seconds of the solve over the ranks: strong scaling with its ideal, and weak scaling."""

    def paint(axes):
        marks = "osv^D<>"
        for one, weak in zip(axes, (False, True), strict=True):
            groups = series(rows, weak)
            sizes = sorted({size for _, size in groups})
            for (case, size), group in groups.items():
                ranks, seconds = [r["ranks"] for r in group], [r["seconds"]["solve"] for r in group]
                mark = marks[sizes.index(size) % len(marks)]
                colour = COLOURS[case.split(",")[0]]
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


def plot_growth(path: Path, rows: list[dict]) -> None:
    """Seconds of the solve, and Krylov iterations per linear solve, over the unknowns, per case and number of ranks."""
    groups = {}
    for row in rows:
        if row["converged"]:
            groups.setdefault((name_of(row), row["ranks"]), []).append(row)
    groups = {key: sorted(g, key=lambda row: row["unknowns"]) for key, g in groups.items() if len(g) > 1}

    def paint(axes):
        for (case, ranks), group in groups.items():
            unknowns = [row["unknowns"] for row in group]
            style = {"color": COLOURS.get(case.split(",")[0], "k"), "lw": 1, "ms": 4, "marker": "osv^D<>"[ranks % 7]}
            label = f"{case}, {ranks} rank{'s' * (ranks > 1)}"
            axes[0].loglog(unknowns, [row["seconds"]["solve"] for row in group], label=label, **style)
            axes[1].semilogx(unknowns, [row["krylov_per_solve"] for row in group], label=label, **style)
        axes[0].set(xlabel="unknowns", ylabel="solve [s]")
        axes[1].set(xlabel="unknowns", ylabel="Krylov iterations per linear solve")
        axes[1].set_ylim(bottom=0.0)
        if groups:
            axes[0].legend(frameon=False, fontsize=7)

    draw(path, paint, columns=2)
