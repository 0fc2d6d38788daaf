"""The table and the picture of `named_error.py`, from the rows of one or several runs."""

import numpy as np

from drivers._common import draw, log, markdown, print_table
from drivers.studies import _harness as harness
from drivers.studies._named_scenes import HELD_BACK, SCENES
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI

FILE = "named_error.json"
KEYS = ("scene", "of", "target")
HEAD = ("scene", "of", "target", "reached", "named", "found", "reference", "true", "true/named", "estimate/true",
        "unknowns", "passes", "seconds")  # fmt: skip
# [-] Relative errors below count as those of rounding: neither the reference nor the solver knows more of them.
ROUNDING = 1e-7
# Errors below are not drawn.
SEEN = 1e-4
ABOUT = """# Errors that were named, and true ones

`python drivers/studies/named_error.py` writes this page (`--scene` by `--scene`, then `--join` and `--publish`). It
runs the scenes of `drivers/studies/_named_scenes.py` on one rank with the error that a row has as `target`, from a
coarse mesh. `found` is the distance of the answer to an exact solution (the energy of rings, shrink_fit, wound and
shells, the forces of rings, wound and shells, the pressures of rings, shrink_fit and shells), or to a solution on
another mesh of degree 2 that all rows of a scene share. That one comes from a run which names a several times smaller
error (of the pressure, for pressures), with a tolerance of 1e-9, and `reference` is what it may lack itself: the error
that it names, with the change when its load steps are halved as that of the load steps. `true` is the root of the sum
of both squares: the error of a solution is at right angles to what finer meshes add. The shared solution has the facets
of the rows' meshes: what these lack is in `named`, but not in `true`.

All errors are relative, those of the energy norm in that of elasticity. `estimate` is what the program expects the
error to be; `named` is larger, as it allows for the smallest effectivity that is known. Seconds are those of a busy
machine, of all passes together. Where the true error is below 1e-7 it is that of rounding, and `estimate/true` says
nothing.

All of these scenes were looked at while the program was made; [random_errors.md](random_errors.md) has scenes that were
not. In `receding` the corner of one block comes to lie beside that of the other by a thousandth of its width: the
pressure is singular there, which only meshes with such cells see, as that of the reference.
"""


def joined(places):
    """Rows (dicts) of earlier runs in the order of the scenes; of rows that are there twice the later one.

    Parameters
    ----------
    places : list of pathlib.Path
        Directories of runs.
    """
    rows = harness.joined(places, FILE, KEYS)
    order = [*SCENES, *HELD_BACK]
    quantities = {name: one.quantities for name, one in (SCENES | HELD_BACK).items()}
    return sorted(rows, key=lambda row: (order.index(row["scene"]),
                  quantities[row["scene"]].index(row["of"]), -row["target"]))  # fmt: skip


def line(row):
    """A row (dict) as one of the table."""
    if "true" not in row:
        return [row["scene"], row["of"], row["target"], row["reached"], *["-"] * (len(HEAD) - 4)]
    ratios = [row["true"] / row["named"], row["estimate"] / row["true"]]
    named, found, true, over, effectivity, seconds = (
        float(f"{value:.3g}") for value in (row["named"], row["found"], row["true"], *ratios, row["seconds"])
    )
    if row["true"] < ROUNDING:
        effectivity = "-"
    reference = float(f"{row['reference']:.2g}")
    return [row["scene"], row["of"], row["target"], row["reached"], named, found, reference, true, over, effectivity,
            row["unknowns"], row["passes"], seconds]  # fmt: skip


def summary(rows):
    """Sum up the rows in sentences."""
    found = [row for row in rows if "true" in row]
    ratios = np.array([row["true"] / row["named"] for row in found])
    words = [f"The true error is below the one named in {int(np.sum(ratios <= 1.0))} of {len(rows)} rows, and at most "
             f"{ratios.max():.3g} times as large."]  # fmt: skip
    sums = sum(row["found"] + row["reference"] <= row["named"] for row in found)
    words.append(f"Even the sum of `found` and `reference` is below it in {sums}.")
    for kind, what in (("energy", "the energy norm"), ("pressure", "pressures in L2"), ("", "other quantities")):
        some = [row["estimate"] / row["true"] for row in found if _kind(row) == kind and row["true"] >= ROUNDING]
        if some:
            words.append(f"Of {what} the estimate is {min(some):.3g} to {max(some):.3g} times the true error.")
    return words


def _kind(row):
    """The word of the quantity of a row; empty but for the energy norm and pressures."""
    word = row["of"].partition(":")[0]
    return word if word in ("energy", "pressure") else ""


def _paint(axes, rows):
    rows = [row for row in rows if "true" in row and row["true"] >= SEEN]
    for kind, style, text in (("energy", "o", "energy norm"), ("", "s", "forces, displacements"),
                              ("pressure", "^", "pressures")):  # fmt: skip
        some = [row for row in rows if _kind(row) == kind]
        axes.loglog([row["named"] for row in some], [row["true"] for row in some], style, mfc="none", label=text)
    ends = np.array([row[key] for row in rows for key in ("named", "true")])
    ends = np.array([ends.min(), ends.max()]) if len(ends) else np.array([SEEN, 1.0])
    axes.loglog(ends, ends, "k:", label="as named")
    axes.set(xlabel="error named", ylabel="true error")
    axes.legend()


def judged(args, rows):
    """Print, publish and draw the rows; exit status 1 where more than one in twenty is beyond what was named."""
    lines = [line(row) for row in rows]
    print_table("named errors", HEAD, lines)
    for sentence in summary(rows):
        log.info("%s", sentence)
    if args.publish is not None:
        text = "\n".join([ABOUT, " ".join(summary(rows)), "", *markdown(HEAD, lines), ""])
        on_root(MPI.COMM_WORLD, args.publish.write_text, text)
    if args.picture is not None:
        draw(args.picture, lambda axes: _paint(axes, rows), size=(6.4, 4.4), dpi=100)
    beyond = [row for row in rows if "true" not in row or not row["true"] <= row["named"]]
    return 0 if len(beyond) <= 0.05 * len(rows) else 1
