"""Modes of vibrations on disk: modes.json, and their shapes as fields."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from pcontact.io.fields import FieldWriter
from pcontact.io.snapshot import Snapshot
from pcontact.mesh.mesh import size_of
from pcontact.runtime.files import make_directory, replace_file
from pcontact.runtime.parallel import on_root

# [sizes of the mesh] Largest displacement of a shape. From: chosen, to be seen without a scale.
LARGEST = 0.05


def write_modes(directory, simulation, squares, shapes):
    """Write ``modes.json`` and, in the folder ``modes``, shapes as steps whose times are frequencies. *Collective.*

    Parameters
    ----------
    directory : pathlib.Path
    simulation : pcontact.simulation.Simulation
    squares : ndarray (n,)
        Of the angular frequencies.
    shapes : list of ndarray (n_owned, d)

    Returns
    -------
    list of dict
        ``frequency`` [1 / time], that of growth where the state is not ``stable``.
    """
    rows = [{"frequency": float(np.sqrt(abs(one)) / (2.0 * np.pi)), "stable": bool(one >= 0.0)} for one in squares]
    on_root(simulation.comm, make_directory, directory)
    on_root(simulation.comm, replace_file, directory / "modes.json", json.dumps({"modes": rows}, indent=1) + "\n")
    problem = simulation.problem
    snapshot, writer = Snapshot(problem, simulation.timing), FieldWriter(directory / "modes", simulation.comm, None)
    u, size = problem.space.vector(), size_of(problem.space.mesh)
    for number, (row, shape) in enumerate(zip(rows, shapes, strict=True), 1):
        u.setArray((LARGEST * size / max(problem.space.longest(shape), np.finfo(float).tiny) * shape).ravel())
        snapshot.step(SimpleNamespace(number=number, time=row["frequency"]), u, {})
        bodies = snapshot.taken.bodies
        kept = {"displacement": bodies.point_data["displacement"]}
        writer.write(number, row["frequency"], replace(bodies, point_data=kept, cell_data={}), {}, {})
    return rows
