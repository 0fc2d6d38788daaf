"""Results of the trade of speed for accuracy: fronts, promises, tables, plots."""

from pathlib import Path

import numpy as np

from drivers._common import draw, log
from drivers.studies._pareto import cheapest, front, rounded_up
from drivers.studies._trade_cases import SCALARS, Case
from drivers.studies._trade_runs import PRESETS

MARGIN = 2.0  # promises are this much above what the sweep found, and rounded up
SAME = 0.01  # errors that differ by less than this part are the same
ALL = "all norms"
ALLOWED = 1.5  # cost of `standard` over the least cost that the sweep found for the same error
COLOURS = {"draft": "#d9a441", "standard": "#c8553d", "fine": "#8a6bbf"}


def good(rows: list[dict]) -> list[dict]:
    """Rows of runs that converged."""
    return [row for row in rows if row["converged"]]


def cost(row: dict, clock: str, own: bool = False) -> float:
    """Seconds over those of the linear elastic solve on the mesh of the scene's unit, or on the row's own mesh."""
    return row[clock] / row[f"{'own' if own else 'unit'}_{clock}"]


def fronts(rows: list[dict], quantities: tuple, clock: str) -> dict[str, list[dict]]:
    """Return by quantity the rows that no other beats in cost and error, by growing cost."""
    rows, found = good(rows), {}
    for key in quantities:
        costs, errors = [cost(row, clock) for row in rows], [row["errors"][key] for row in rows]
        found[key] = [rows[k] for k in front(costs, errors, SAME)]
    return found


def norms(quantities: tuple) -> tuple:
    """Those that are norms: single numbers are small by luck where they cross their exact value."""
    return tuple(key for key in quantities if key not in SCALARS)


def preset_of(row: dict) -> str | None:
    """The preset of a row that has nothing but one."""
    return row["knobs"].get("accuracy") if len(row["knobs"]) == 1 else None


def judged(rows: list[dict], quantities: tuple, clock: str, name: str = "standard") -> list[dict]:
    """A preset on every mesh against the cheapest setting of the sweep with the same errors in norms, or smaller ones.

    Returns
    -------
    list of dict
        ``label``, ``quantity`` (a norm, or `ALL` of them at once), ``error``, ``cost``, ``best`` (its label),
        ``best_cost``, ``ratio``.
    """
    table, everything = [], good(rows)
    costs, keys = [cost(row, clock) for row in everything], norms(quantities)
    for row in everything:
        if preset_of(row) != name:
            continue
        for quantity, some in ((ALL, keys), *((key, (key,)) for key in keys)):
            # how much larger than those of the preset the errors of the others are
            larger = [max(one["errors"][key] / row["errors"][key] for key in some) for one in everything]
            best = everything[cheapest(costs, larger, 1.0 + SAME)]
            own, least = cost(row, clock), cost(best, clock)
            table.append({
                "label": row["label"], "size": row["size"], "degree": row["degree"], "quantity": quantity,
                "error": row["errors"].get(quantity, float("nan")), "cost": own, "best": best["label"],
                "best_cost": least, "ratio": own / least,
            })  # fmt: skip
    return table


def promises(case: Case, rows: list[dict], quantities: tuple, clock: str) -> dict[str, dict]:
    """Return the promises of each preset for a class of scenes: on its mesh, errors and cost, see `MARGIN`.

    Returns
    -------
    dict of str to dict
        By preset ``size``, ``degree``, ``errors`` (by quantity), ``cost`` in linear elastic solves on the same mesh.
    """
    result, single = {}, [key for key in quantities if key in SCALARS]
    for row in good(rows):
        name = preset_of(row)
        if name is None or case.promised.get(name) != (row["size"], row["degree"]):
            continue
        result[name] = {
            "size": row["size"], "degree": row["degree"], "cost": rounded_up(MARGIN * cost(row, clock, own=True)),
            "errors": {key: rounded_up(MARGIN * row["errors"][key]) for key in quantities},
        }  # fmt: skip
        # a single number may be right by luck; what is promised of it is no less than of the norm that it hangs on
        errors = result[name]["errors"]
        for key in single:
            norm = {"outer": "energy", "stick": "shear"}.get(key, "pressure")
            # the largest pressure is farther off than the pressure in the mean
            least = errors.get(norm, 0.0) if key != "peak" else rounded_up(2.0 * errors.get(norm, 0.0))
            errors[key] = max(errors[key], least)
    return {name: result[name] for name in PRESETS if name in result}


def of_class(found: list[dict[str, dict]]) -> dict[str, dict]:
    """Promises of a class from those of its scenes: the largest."""
    result = {}
    for name in PRESETS:
        some = [one[name] for one in found if name in one]
        if some:
            errors = {key: max(one["errors"][key] for one in some) for key in some[0]["errors"]}
            result[name] = {**some[0], "cost": max(one["cost"] for one in some), "errors": errors}
    return result


def by_class(cases: dict[str, Case], rows: dict[str, list[dict]], clock: str) -> dict[str, dict[str, dict]]:
    """Promises by class and preset."""
    kinds = {}
    for name, case in cases.items():
        kinds.setdefault(case.kind, []).append(promises(case, rows[name], case.quantities, clock))
    return {kind: of_class(found) for kind, found in kinds.items()}


# -- tables ---------------------------------------------------------------------------------------------------------


def _number(value):
    return "-" if value is None or not np.isfinite(value) else f"{value:.3g}"


def markdown(header: list[str], rows: list[list]) -> list[str]:
    """Lines of a table."""
    words = [[_number(cell) if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    return ["| " + " | ".join(row) + " |" for row in [header, ["---"] * len(header), *words]]


def _front_lines(found, clock):
    lines = []
    for key, rows in found.items():
        if key not in SCALARS:
            table = [
                [row["label"], cost(row, clock), cost(row, clock, own=True), row["errors"][key], row["unknowns"],
                 float(row["memory_mb"]), row["newton"], row["krylov"]]
                for row in rows
            ]  # fmt: skip
            header = [f"front, {key}", "cost", "to its own mesh", "error", "unknowns", "memory, MB", "Newton", "Krylov"]
            lines += [*markdown(header, table), ""]
    return lines


def _change_lines(case, rows, quantities, clock):
    """One setting at a time: factors on cost and errors."""
    lines = []
    for degree, size in case.base.items():
        own = [row for row in rows if (row["size"], row["degree"]) == (size, degree)]
        base = next((row for row in good(own) if not row["knobs"]), None)
        if base is None:
            continue
        table = []
        for row in own:
            if len(row["knobs"]) == 1 and "accuracy" not in row["knobs"]:
                word = row["label"].split(", ", 2)[2]
                if row["converged"]:
                    factors = [row["errors"][key] / base["errors"][key] for key in quantities]
                    table.append([word, row[clock] / base[clock], *factors, row["newton"], row["krylov"]])
                else:
                    table.append([word, "did not converge", *[""] * len(quantities), row["newton"], row["krylov"]])
        errors = ", ".join(f"{key} {base['errors'][key]:.2g}" for key in quantities)
        lines += [f"One setting changed at a time, factors on the base: {base['label']} (cost {cost(base, clock):.3g}; "
                  f"{errors}; {base['newton']} Newton, {base['krylov']} Krylov).", ""]  # fmt: skip
        lines += [*markdown(["changed", "cost", *quantities, "Newton", "Krylov"], table), ""]
    return lines


def _preset_lines(rows, quantities, clock):
    table = [
        [preset_of(row), f"{row['size']:g} facets, degree {row['degree']}", cost(row, clock),
         cost(row, clock, own=True), *(row["errors"][key] for key in quantities), row["newton"], row["krylov"]]
        for name in PRESETS for row in good(rows) if preset_of(row) == name
    ]  # fmt: skip
    header = ["preset", "mesh", "cost", "to its own mesh", *quantities, "Newton", "Krylov"]
    return [*markdown(header, table), ""] if table else []


def _judged_lines(table):
    rows = [[f"{row['size']:g} facets, degree {row['degree']}", row["quantity"], row["error"], row["cost"], row["best"],
             row["best_cost"], row["ratio"]] for row in table]  # fmt: skip
    header = ["`standard` on", "norm", "error", "cost", "cheapest with that error", "its cost", "ratio"]
    return [*markdown(header, rows), ""] if rows else []


def promise_lines(found: dict[str, dict[str, dict]]) -> list[str]:
    """The promises of all classes: lines of a table."""
    names = list(dict.fromkeys(key for one in found.values() for p in one.values() for key in p["errors"]))
    table = [
        [kind, name, f"{one['size']:g} facets, degree {one['degree']}", one["cost"],
         *(one["errors"].get(key, float("nan")) for key in names)]
        for kind, presets in found.items() for name, one in presets.items()
    ]  # fmt: skip
    return markdown(["class", "preset", "mesh", "cost, its own mesh", *names], table) if table else []


def tables(cases: dict[str, Case], rows: dict[str, list[dict]], data: dict, pictures: str) -> str:
    """All tables as Markdown, as they stand in docs/tables/accuracy.md.

    Parameters
    ----------
    cases : dict of str to Case
    rows : dict of str to list of dict
    data : dict
        ``clock``, ``ranks``, ``command``; ``promise``, where that has been run: its header and rows.
    pictures : str
        What the names of the plots begin with.
    """
    clock = data["clock"]
    lines = [f"`{data['command']}`, {'processor' if clock == 'cpu' else 'wall'} time, {data['ranks']} ranks.", ""]
    lines += ["## Promises", "", *promise_lines(by_class(cases, rows, clock)), ""]
    if data.get("promise"):
        lines += ["On scenes that are not in the sweep (`--promise`):", "", *markdown(*data["promise"]), ""]
    for name, case in cases.items():
        unit = next((row[f"unit_{clock}"] for row in rows[name]), float("nan"))
        lines += [f"## {case.title} (`{name}`)", "", f"![]({pictures}{name}.png)", ""]
        failed = len(rows[name]) - len(good(rows[name]))
        lines += [f"Unit of cost: {unit:.3g} s, a linear elastic solve with {case.unit:g} facets, degree 1. "
                  f"{len(rows[name])} runs, {failed} did not converge.", ""]  # fmt: skip
        lines += _front_lines(fronts(rows[name], case.quantities, clock), clock)
        lines += _preset_lines(rows[name], case.quantities, clock)
        lines += _judged_lines(judged(rows[name], case.quantities, clock))
        lines += _change_lines(case, rows[name], case.quantities, clock)
    return "\n".join(lines).rstrip() + "\n"


def tell(row: dict, quantities: tuple, clock: str) -> None:
    """Log a row."""
    errors = (
        " ".join(f"{key} {row['errors'][key]:.2e}" for key in quantities) if row["converged"] else "did not converge"
    )
    log.info("%s: %s | cost %.3g (%.3g to its own mesh) newton %d krylov %d | %s", row["scene"], row["label"],
             cost(row, clock), cost(row, clock, own=True), row["newton"], row["krylov"], errors)  # fmt: skip


# -- plots ----------------------------------------------------------------------------------------------------------


def plot(path: Path, case: Case, rows: list[dict], clock: str, quantities: tuple) -> None:
    """Error over cost of all settings, the front in colour, its points numbered and named."""
    found, rows = fronts(rows, case.quantities, clock), good(rows)

    def paint(axes):
        for axis, key in zip(np.atleast_1d(axes), quantities, strict=True):
            axis.loglog([cost(row, clock) for row in rows], [row["errors"][key] for row in rows], "o", ms=3,
                        color="#b8bec4")  # fmt: skip
            for name, colour in COLOURS.items():
                own = [row for row in rows if preset_of(row) == name]
                axis.loglog([cost(row, clock) for row in own], [row["errors"][key] for row in own], "*", ms=9,
                            color=colour, label=name)  # fmt: skip
            line = found[key]
            axis.loglog([cost(row, clock) for row in line], [row["errors"][key] for row in line], "o-", ms=4, lw=1,
                        color="#2f6690", label="front")  # fmt: skip
            for k, row in enumerate(line, 1):
                axis.annotate(str(k), (cost(row, clock), row["errors"][key]), xytext=(3, 4), fontsize=6,
                              textcoords="offset points")  # fmt: skip
            names = "\n".join(f"{k} {row['label']}" for k, row in enumerate(line, 1))
            axis.text(0.0, -0.2, names, transform=axis.transAxes, fontsize=5.5, va="top")
            axis.set(xlabel="cost / linear elastic solve", ylabel="relative error")
            axis.set_title(f"{case.title}: {key}", fontsize=8)
            axis.legend(fontsize=6, frameon=False)
            axis.grid(alpha=0.2)

    draw(path, paint, columns=len(quantities), size=(4.2, 5.4))
