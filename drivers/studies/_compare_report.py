"""Tables and plots of `drivers/studies/compare.py`."""

from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D
from PIL import Image

from drivers._common import draw, log, markdown, print_table

# formulation, theta, colour
METHODS = {
    "theta 1": ("nitsche", 1.0, "#1b5e8a"),
    "theta 0": ("nitsche", 0.0, "#4c9a6b"),
    "theta -1": ("nitsche", -1.0, "#8a6bbf"),
    "penalty": ("penalty", 0.0, "#c8553d"),
    "augmented": ("augmented_lagrangian", 0.0, "#d9a441"),
}
LINES = (":", "--", "-")
ANSWER = {
    "penetration": "penetration / approach",
    "error": "error of the pressure in L2 / norm",
    "oscillation": "oscillation of the pressure / norm",
    "balance": "contact force: out of balance / applied",
}
# ending of files, and of commands, of the runs with friction
SHEARED = "_friction"
TANGENTIAL = {
    "tangential": "error of the tangential traction in L2 / norm",
    "ripple": "oscillation of the tangential traction / norm",
    "oscillation": "oscillation of the pressure / norm",
    "newton": "Newton iterations",
}
EFFORT = {
    "newton": "Newton iterations",
    "krylov": "Krylov iterations",
    "condition": "condition of the tangent",
    "cpu": "seconds of the processor",
}
COLUMNS = (
    "method", "gamma0", "penetration", "error", "oscillation", "balance", "tangential", "ripple", "newton", "krylov",
    "updates", "condition", "seconds", "cpu",
)  # fmt: skip
# of the smallest error: how far gamma0 may go without harm
HARM = 2.0
# below that, a balance is rounding and what Newton's tolerance leaves
FLOOR = 1e-16


def select(rows: list[dict], **said) -> list[dict]:
    """Rows with these values."""
    return [row for row in rows if all(row[key] == value for key, value in said.items())]


def causes(rows: list[dict]) -> list[str]:
    """A line for each run that did not converge."""
    return [
        f"{row['method']}, gamma0 {row['gamma0']:g}, {row['facets']} facets of degree {row['order']}: {row['cause']}"
        for row in rows if not row["converged"]
    ]  # fmt: skip


def report(rows: list[dict]) -> None:
    """The table of each mesh."""
    for facets in sorted({row["facets"] for row in rows}):
        some = select(rows, facets=facets)
        print_table(f"{facets} facets in the half width", COLUMNS, [[row[key] for key in COLUMNS] for row in some])
    for text in causes(rows):
        log.info("%s", text)


def plots(directory: Path, rows: list[dict]) -> list[Path]:
    """A picture of the answer and one of the effort for each degree, in a directory. Rank 0 only.

    Returns
    -------
    list of Path
        formulations_1.png, formulations_1_effort.png, formulations_1_friction.png, ...
    """
    paths = []
    for order, case in sorted({(row["order"], row["case"]) for row in rows}):
        some = select(rows, order=order, case=case)
        for end, panels in ((SHEARED, TANGENTIAL),) if case else (("", ANSWER), ("_effort", EFFORT)):
            paths.append(directory / f"formulations_{order}{end}.png")
            draw(paths[-1], _painter(some, panels, order), columns=2, rows=2, size=(4.6, 3.5), dpi=110)
            _reduce(paths[-1])
    return paths


def _reduce(path):
    """Few colours: a quarter of the size."""
    with Image.open(path) as image:
        few = image.convert("RGB").quantize(64)
    few.save(path, optimize=True)


def _painter(rows, panels, order):
    def paint(axes):
        levels = sorted({row["facets"] for row in rows})
        for one, (key, title) in zip(axes.ravel(), panels.items(), strict=True):
            for name in METHODS:
                for style, facets in zip(LINES[-len(levels) :], levels, strict=True):
                    _curve(one, select(rows, method=name, facets=facets), key, METHODS[name][-1], style)
            _failures(one, rows)
            one.set_title(title, fontsize=10)
            one.set_xscale("log")
            one.set_yscale("log")
            one.grid(alpha=0.25, lw=0.5)
        for one in axes[-1]:
            one.set_xlabel("gamma0")
        _legend(axes, levels, rows, order)

    return paint


def _curve(axes, rows, key, colour, style):
    """A curve with hollow points below the bound of coercivity."""
    x = np.array([row["gamma0"] for row in rows])
    y = np.array([row[key] for row in rows], dtype=float)
    if key == "balance":
        y = np.maximum(y, FLOOR)
    safe = np.array([row["coercive"] for row in rows])
    axes.plot(x, y, style, color=colour, lw=1.2)
    axes.plot(x[safe], y[safe], "o", ms=2.5, color=colour)
    axes.plot(x[~safe], y[~safe], "o", ms=5, mfc="white", mec=colour, mew=1.0)


def _failures(axes, rows):
    """A cross at the upper edge for each run that failed, those of a formulation one below the other."""
    for k, name in enumerate(METHODS):
        x = sorted({row["gamma0"] for row in rows if row["method"] == name and not row["converged"]})
        axes.plot(x, [0.97 - 0.04 * k] * len(x), "x", ms=5, color=METHODS[name][-1],
                  transform=axes.get_xaxis_transform())  # fmt: skip


def _legend(axes, levels, rows, order):
    handles = [Line2D([], [], color=colour, label=name) for name, (*_, colour) in METHODS.items()]
    handles += [
        Line2D([], [], color="#555555", ls=style, label=f"{facets} facets")
        for style, facets in zip(LINES[-len(levels) :], levels, strict=True)
    ]
    handles.append(Line2D([], [], ls="", marker="o", mfc="white", mec="#555555", label="below coercivity"))
    if any(not row["converged"] for row in rows):
        handles.append(Line2D([], [], ls="", marker="x", color="#555555", label="failed"))
    axes[0, 0].figure.legend(
        handles=handles, loc="outside upper center", ncols=5, frameon=False, fontsize=8.5,
        title=f"degree {order}; facets in the half width of the contact", title_fontsize=9,
    )  # fmt: skip


def _few(value):
    return "-" if not np.isfinite(value) else f"{value:.2g}"


def _percent(value):
    return "-" if not np.isfinite(value) else f"{100.0 * value:.3g}"


def _decades(values):
    """`0.1 to 1`, or one value."""
    low, high = min(values), max(values)
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def best_rows(rows: list[dict]) -> list[list[str]]:
    """One row per formulation and mesh: the gamma0 with the smallest error, and what it brings and costs."""
    table = []
    for name in METHODS:
        for facets in sorted({row["facets"] for row in rows}):
            some = [row for row in select(rows, method=name, facets=facets) if row["converged"]]
            if not some:
                continue
            best = min(some, key=lambda row: row["error"])
            near = [row["gamma0"] for row in some if row["error"] <= HARM * best["error"]]
            table.append([
                name, str(facets), f"{best['gamma0']:g}", _percent(best["error"]), _decades(near),
                _few(best["penetration"]), _percent(best["oscillation"]), str(int(best["newton"])),
                str(int(best["krylov"])), _few(best["condition"]), f"{best['cpu']:.2g}",
            ])  # fmt: skip
    return table


def over_gamma0(rows: list[dict], key: str, text) -> list[list[str]]:
    """One row per formulation, one column per gamma0, of the finest mesh."""
    finest = select(rows, facets=max(row["facets"] for row in rows))
    table = []
    for name in METHODS:
        some = select(finest, method=name)
        cells = [text(row[key]) if row["converged"] else "failed" for row in some]
        table.append([name, *(cell if row["coercive"] else f"({cell})" for cell, row in zip(cells, some, strict=True))])
    return table


def document(data: dict) -> str:
    """Return what is published: by degree the pictures, the best gamma0, quantities over gamma0, and all runs of the
    finest mesh.

    Parameters
    ----------
    data : dict
        Of compare.json: ``commands``, ``ranks``, ``runs``.
    """
    lines = []
    for order in sorted({row["order"] for row in select(data["runs"], case="")}):
        rows = select(data["runs"], order=order, case="")
        lines += [f"## Degree {order}", "", f"`{data['commands'][str(order)]}`, {data['ranks']} ranks.", ""]
        picture = f"formulations_{order}"
        lines += [f"![Penetration, error, oscillation, balance over gamma0, degree {order}]({picture}.png)", ""]
        lines += [f"![Newton, Krylov, condition, seconds over gamma0, degree {order}]({picture}_effort.png)", ""]
        lines += [f"The smallest error of each formulation and mesh; range: gamma0 of {HARM:g} times that at most.", ""]
        header = ["", "facets", "gamma0", "error, %", "range", "penetration", "oscillation, %", "Newton", "Krylov",
                  "condition", "processor, s"]  # fmt: skip
        lines += [*markdown(header, best_rows(rows)), ""]
        facets = max(row["facets"] for row in rows)
        values = sorted({row["gamma0"] for row in rows})
        for key, title, text in (
            ("error", "Error of the pressure in L2, percent", _percent),
            ("penetration", "Penetration / approach", _few),
            ("krylov", "Krylov iterations of the run", lambda n: str(int(n))), ("condition", "Condition", _few),
        ):  # fmt: skip
            lines += [f"{title}, {facets} facets, over gamma0 (in brackets: below the bound of coercivity):", ""]
            lines += [*markdown(["", *(f"{value:g}" for value in values)], over_gamma0(rows, key, text)), ""]
        failed = causes(rows)
        lines += ["Runs that failed:", "", *(f"* {text}" for text in failed), ""] if failed else []
        lines += ["<details><summary>All runs of the finest mesh</summary>", ""]
        finest = [[f"{row[key]:.3g}" if isinstance(row[key], float) else str(row[key]) for key in COLUMNS]
                  for row in select(rows, facets=facets)]  # fmt: skip
        lines += [*markdown(COLUMNS, finest), "", "</details>", ""]
    return "\n".join([*lines, *sheared(data)])


def sheared(data: dict) -> list[str]:
    """Lines on the runs with friction: for each degree the picture, and quantities over gamma0, mesh by mesh."""
    lines = []
    for order in sorted({row["order"] for row in select(data["runs"], case=SHEARED)}):
        rows = select(data["runs"], order=order, case=SHEARED)
        values, counts = (sorted({row[key] for row in rows}) for key in ("gamma0", "facets"))
        lines += [f"## With friction, degree {order}", "",
                  f"`{data['commands'][f'{order}{SHEARED}']}`, {data['ranks']} ranks.", "",
                  f"![Tangential traction over gamma0, degree {order}](formulations_{order}{SHEARED}.png)", ""]
        for key, title in TANGENTIAL.items():
            percent, table = key != "newton", []
            for name in METHODS:
                cells = [" / ".join(_cell(row, key, percent) for row in select(rows, method=name, gamma0=value))
                         for value in values]  # fmt: skip
                table.append([name, *cells])
            head, meshes = title.replace(" / norm", ", percent of its norm"), " / ".join(map(str, counts))
            lines += [f"{head[:1].upper()}{head[1:]}, with {meshes} facets in the half width:", "",
                      *markdown(["", *(f"{value:g}" for value in values)], table), ""]  # fmt: skip
        lines += [f"* {text}" for text in causes(rows)] + [""]
    return lines


def _cell(row, key, percent):
    if not row["converged"]:
        return "failed"
    return _percent(row[key]) if percent else str(int(row[key]))

