"""One cell of the matrix of extremes: run, compare with the known answer, judge. For `drivers/studies/extremes.py`."""

import csv
import faulthandler
import io
import json
import logging
import re
import shutil
import time
import traceback
from collections.abc import Callable
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers._common import make_directory, running
from drivers.studies._harness import Counts
from pcontact.io.vtu import read_vtu
from pcontact.runtime.errors import InputError
from pcontact.runtime.log import LOGGER
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI

RIGHT, REFUSED, WRONG, HANG = "right", "refused", "WRONG", "HANG"
LIMIT = 120.0  # seconds after which a cell hangs


@dataclass(frozen=True)
class Cell:
    """One setting of one scene.

    Attributes
    ----------
    family, setting, variant : what it is
    build : of :mod:`drivers.studies._extreme_scenes`; called as ``build(folder, **arguments)``
    arguments : of the scene
    bound : largest relative deviation from the known answer
    reason : for the bound, a key of `REASONS`
    cause : what a refusal must name (a regular expression); None: the answer has to be right
    """

    family: str
    setting: str
    variant: str
    build: Callable
    arguments: dict = field(default_factory=dict)
    bound: float = 1e-6
    reason: str = "exact"
    cause: str | None = None

    @property
    def name(self):
        """Family, setting and variant in a line."""
        return f"{self.family}, {self.setting}, {self.variant}"


class _Warnings(logging.Handler):
    """Keeps warnings."""

    def __init__(self):
        super().__init__(logging.WARNING)
        self.lines = []

    def emit(self, record):
        self.lines.append(record.getMessage())


@contextmanager
def _listening(limit):
    """Collect what a run says: warnings (list) and errors (stream), not shown; the process ends if it hangs."""
    warnings, errors = _Warnings(), io.StringIO()
    handlers, level = list(LOGGER.handlers), LOGGER.level
    LOGGER.handlers[:] = [warnings]
    LOGGER.setLevel(logging.WARNING)
    faulthandler.dump_traceback_later(limit, exit=True)
    try:
        with redirect_stderr(errors):
            yield warnings.lines, errors
    finally:
        faulthandler.cancel_dump_traceback_later()
        LOGGER.handlers[:] = handlers
        LOGGER.setLevel(level)


def not_numbers(directory):
    """Files of a run that hold a number which is not finite, but the centre of a force that is none. Serial.

    Returns
    -------
    list of str
        File and key.
    """
    found, directory = [], Path(directory)
    for path in sorted(directory.rglob("*.vtu")):
        grid = read_vtu(path)
        arrays = {"points": grid.points, **grid.point_data, **grid.cell_data}
        found += [f"{path.name}: {key}" for key, array in arrays.items() if not np.isfinite(array).all()]
    report = directory / "report.json"
    if report.exists():
        # a number that is not finite is written as null
        steps = re.sub(r'"centre": \[[^]]*\]', "", json.dumps(json.loads(report.read_text())["steps"]))
        found += ["report.json"] if re.search(r"null|NaN|Infinity", steps) else []
    history = directory / "history.csv"
    if history.exists():
        head, *rows = list(csv.reader(history.read_text().splitlines()))
        for row in rows:
            found += [
                f"history.csv: {key}"
                for key, value in zip(head, row, strict=True)
                if not (np.isfinite(float(value or 0)) or ".centre_" in key)
            ]
    return found


def run_cell(cell, folder, limit=LIMIT):
    """Run a cell. *Collective.*

    Parameters
    ----------
    cell : Cell
    folder : pathlib.Path
        For its mesh and results; emptied first.
    limit : float
        Seconds after which the process ends, with a traceback.

    Returns
    -------
    dict
        A row of the table, the same on every rank.
    """
    comm, steps = MPI.COMM_WORLD, Counts()
    on_root(comm, shutil.rmtree, folder, True)
    make_directory(folder)
    start, errors, refusal, converged = time.process_time(), {}, "", False
    with _listening(limit) as (warnings, stream):
        try:
            scene, measure = cell.build(folder, **cell.arguments)
            with running(scene, folder / "run", [steps]) as (simulation, converged):
                if converged:
                    errors = measure(simulation, steps.records)
                unbalanced = steps.records[-1]["imbalance"] if steps.records else 0.0
        except InputError as error:
            refusal, unbalanced = str(error), 0.0
        except Exception:
            refusal, unbalanced = "exception " + traceback.format_exc().strip().splitlines()[-1], 0.0
    refusal = comm.bcast(refusal or stream.getvalue().strip())
    warnings = comm.bcast(list(dict.fromkeys(warnings)))
    bad = on_root(comm, not_numbers, folder / "run") if (folder / "run").exists() else []
    bad = comm.bcast(bad)
    verdict, text = judge(cell, converged, errors, refusal, bad)
    return {
        "family": cell.family,
        "setting": cell.setting,
        "variant": cell.variant,
        "deviation": max(errors.values()) if errors else None,
        "of": max(errors, key=errors.get) if errors else "",
        "errors": errors,
        "bound": cell.bound,
        "reason": cell.reason,
        "verdict": verdict,
        "text": text,
        "newton": steps.newton,
        "krylov": steps.krylov,
        "cutbacks": steps.cuts,
        "imbalance": unbalanced,
        "warnings": warnings,
        "seconds": comm.allreduce(time.process_time() - start, op=MPI.MAX),
    }


def judge(cell, converged, errors, refusal, bad):
    """Verdict on a run, and the sentence that goes with it."""
    if bad:
        return WRONG, f"not a number in {', '.join(bad)}"
    if not converged:
        named = cell.cause is not None and re.search(cell.cause, refusal)
        return (REFUSED if named else WRONG), refusal or "no convergence, and no word about it"
    if errors and max(errors.values()) <= cell.bound:
        return RIGHT, ""
    return WRONG, "; ".join(f"{key} {value:.2e}" for key, value in errors.items())
