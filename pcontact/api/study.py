"""Parameter studies: a scene run again and again with other values."""

from __future__ import annotations

import copy
import itertools
import pickle
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from pcontact.api.running import run
from pcontact.api.scenes import read
from pcontact.api.tables import Table, Tables, lost, there
from pcontact.io.report import column
from pcontact.runtime.errors import TOLD, InputError, NotConverged, unknown_name
from pcontact.runtime.petsc import MPI
from pcontact.runtime.process import environment_outside
from pcontact.scene import model

_STEP = re.compile(r"([A-Za-z_][\w-]*)|\[(\d+)\]|\[['\"]([^'\"]+)['\"]\]")


class Study:
    """The cases of a study.

    Attributes
    ----------
    rows : list of dict
        Of every case its parameters, `converged`, `error` (a line, empty where all went well), and the history of its
        last load step.
    """

    def __init__(self, rows: list[dict[str, Any]]) -> None:
        self.rows = rows

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> np.ndarray:
        """A column, NaN where a case has no number."""
        if not any(name in row for row in self.rows):
            raise lost(name, self.columns)
        return column([row.get(name) for row in self.rows])

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return list(dict.fromkeys(name for row in self.rows for name in row))

    def table(self) -> Table:
        """All columns; ``table().to_pandas()`` is a pandas.DataFrame."""
        return Table({name: self[name] for name in self.columns})

    def __repr__(self) -> str:
        failed = sum(not row["converged"] for row in self.rows)
        return f"<Study: {len(self)} cases, {failed} failed; columns {', '.join(self.columns)}>"

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()


def study(
    scene: model.Scene | str | Path,
    parameters: Mapping[str, Sequence[Any]],
    options: Mapping[str, Any] | str | None = None,
    ranks: int | None = None,
    jobs: int = 1,
) -> Study:
    """Run a scene with all combinations of some values. A case that fails is a row with its error; the others go on.

    Parameters
    ----------
    scene : Scene, str or pathlib.Path
    parameters : dict of str to sequence
        Places in the scene and their values: ``{"contacts[0].friction": [0, 0.1, 0.3], "materials.steel.E": [1, 2]}``;
        contacts also by their names, ``contacts['press'].friction``.
    options : dict or str, optional
        As of :func:`run`.
    ranks : int, optional
        Every case in a process of its own, on so many ranks of mpirun. Absent, with one job: in this process; under
        mpirun *collective*, one case after the other.
    jobs : int
        Cases at the same time, in processes of their own.

    Returns
    -------
    Study

    Raises
    ------
    InputError
        The scene has no such place.
    """
    scene = scene if isinstance(scene, model.Scene) else read(scene)
    names = list(parameters)
    for name, values in parameters.items():
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise InputError(f"study: {name}: found {values!r}; allowed: a list of values, one for each case")
    cases = [dict(zip(names, values, strict=True)) for values in itertools.product(*parameters.values())]
    scenes = [_changed(scene, case) for case in cases]
    if ranks is None and jobs == 1:
        return Study([{**case, **_case(one, options)} for case, one in zip(cases, scenes, strict=True)])
    if MPI.COMM_WORLD.size > 1:
        raise InputError("study: found ranks or jobs under mpirun; allowed: neither, the cases use all ranks together")
    with ThreadPoolExecutor(jobs) as pool:
        found = pool.map(lambda one: _apart(one, options, ranks or 1), scenes)
        return Study([{**case, **row} for case, row in zip(cases, found, strict=True)])


def _changed(scene: model.Scene, case: Mapping[str, Any]) -> model.Scene:
    """A copy of the scene with some values replaced."""
    made = copy.deepcopy(scene)
    for where, value in case.items():
        steps = [name or quoted or int(number) for name, number, quoted in _STEP.findall(where)]
        one: Any = made
        at: Any = where
        try:
            for at in steps[:-1]:
                one = _part(one, at)
            at = steps[-1]
            _part(one, at)
            if isinstance(one, (dict, list)):
                one[at] = value
            else:
                setattr(one, str(at), value)
        except (AttributeError, KeyError, IndexError, TypeError):
            names = there(one)
            found = f"no {where!r} in the scene: {unknown_name(str(at), 'which is not there', names)}"
            allowed = ", ".join(names) or "places as contacts[0].friction, materials.NAME.E"
            raise InputError(f"study: found {found}; allowed: {allowed}") from None
    return made


def _part(one: Any, step: Any) -> Any:
    if isinstance(one, list):
        return Tables(one)[step]
    return one[step] if isinstance(one, dict) else getattr(one, str(step))


def _case(scene: model.Scene, options: Any) -> dict[str, Any]:
    """A case run in this process. *Collective.*"""
    try:
        done, error = run(scene, options), ""
    except NotConverged as problem:
        done, error = problem.run, str(problem)
    except TOLD as problem:
        return {"converged": False, "error": str(problem)}
    last = {name: values[-1].item() for name, values in done.history.items() if len(values)}
    return {"converged": done.converged, "error": error, **last}


def _apart(scene: model.Scene, options: Any, ranks: int) -> dict[str, Any]:
    """A case run in processes of its own."""
    with tempfile.TemporaryDirectory() as scratch:
        given, found = Path(scratch) / "scene", Path(scratch) / "row"
        given.write_bytes(pickle.dumps((scene, options)))
        start = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        command = [*start, sys.executable, "-m", "pcontact.api.worker", str(given), str(found)]
        done = subprocess.run(command, capture_output=True, text=True, env=environment_outside())
        if not found.exists():
            lines = done.stderr.strip().splitlines() or [f"it ended with status {done.returncode}"]
            return {"converged": False, "error": lines[-1]}
        return pickle.loads(found.read_bytes())
