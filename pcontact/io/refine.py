"""``pcontact refine``: a better mesh from the error estimate of a finished run."""

import json
from pathlib import Path

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes
from pcontact.estimate.size import at_vertices, edge_lengths, largest_contributions, new_sizes
from pcontact.io.result import load_result
from pcontact.mesh.raw import KINDS
from pcontact.mesh.read import read_mesh
from pcontact.mesh.refinement.gather import halved_where
from pcontact.mesh.remesh import remesh, write_refined, write_sizes
from pcontact.runtime.declared import ERROR, PART, REFINE, read_all
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI

NOT_MATCHING = 1e-6


def refine_run(directory, options, comm=MPI.COMM_SELF):
    """Make the mesh that a command line asks for. *Collective.*

    Parameters
    ----------
    directory : str
        The output directory of a run with an estimate.
    options : dict of str to str
        Without dashes; keys of `pcontact.runtime.declared.REFINE`.
    comm : MPI.Comm, optional
        Its ranks cut the cells together; rank 0 alone reads and writes files, and has gmsh make meshes of geometries.

    Returns
    -------
    str
        What was written; on rank 0.

    Raises
    ------
    InputError
        On every rank.
    """
    found = on_root(comm, _prepared, Path(directory), options)
    told, raw, marked, target, divide = found or (None,) * 5
    if comm.bcast(told is not None):
        return told
    new = halved_where(comm, raw, marked, directory, comm.bcast(divide))
    on_root(comm, write_refined, target, new)
    return f"{target}: {new.offsets[-1]} cells from {len(marked)}, {marked.sum()} of them marked" if new else None


def _prepared(directory, options):
    """Return what was written with a geometry; or else None, the mesh, the cells to cut, the file to write, and
    whether the cells are divided first."""
    values = read_all("refine", REFINE, options)
    raw, estimates, degree = read_estimate(directory, values.get("step", -1))
    target = Path(values.get("o") or directory / "refined.msh")
    if target.suffix != ".msh":
        raise InputError(f"command line: -o: found {str(target)!r}; allowed: {REFINE['o'].allowed}")
    if not target.parent.is_dir():
        raise InputError(f"command line: -o: found no directory {str(target.parent)!r}; allowed: one that exists")
    if "geometry" in values:
        for name in ("part", "divide"):
            if name in values:
                raise InputError(f"command line: -{name} with -geometry; allowed: -error")
        return _new_mesh(raw, estimates, degree, target, values), None, None, None, False
    if "error" in values:
        raise InputError("command line: -error without -geometry; allowed: -part, or -geometry and -error")
    marked = largest_contributions(estimates, values.get("part", PART))
    return None, raw, marked, target, values.get("divide", False)


def _new_mesh(raw, estimates, degree, target, values):
    """Mesh the geometry anew; what was written."""
    lengths, tables, first = [], [], 0
    for block in raw.blocks:
        lengths.append(edge_lengths(raw.points, block.vertices, edge_nodes(block.cell)))
        tables.append((block.cell, block.vertices))
    sizes, predicted = new_sizes(estimates, np.concatenate(lengths), degree, raw.dim, values.get("error", ERROR))
    parts = []
    for _, table in tables:
        parts.append(sizes[first : first + len(table)])
        first += len(table)
    field = target.with_name(f"{target.stem}_size.pos")
    write_sizes(field, raw.points, tables, at_vertices(len(raw.points), [t for _, t in tables], parts))
    groups = {(raw.dim, name) for name in raw.cell_groups} | {(raw.dim - 1, name) for name in raw.facet_groups}
    groups |= {(1, name) for name in raw.edge_groups}
    groups |= {(0, name) for name in raw.node_groups if name not in raw.edge_groups}
    order = max(block.degree for block in raw.blocks)
    cells = remesh(target, values["geometry"], field, raw.dim, order, groups)
    return f"{target}: {cells} cells from {len(estimates)}, error expected {predicted:.3g} times that of now; {field}"


def read_estimate(directory, step=-1):
    """The mesh of a run and the estimate of its cells. Serial.

    Parameters
    ----------
    directory : pathlib.Path
    step : int
        See :func:`pcontact.io.result.load_result`.

    Returns
    -------
    raw : pcontact.mesh.raw.RawMesh
    estimates : ndarray (n_cells,)
        Of every cell of the mesh [sqrt(energy)].
    degree : int
        Of the displacement.

    Raises
    ------
    InputError
    """
    if step == 0:
        raise InputError("command line: -step: found 0, the undeformed bodies; allowed: a load step")
    result = load_result(directory, step)
    data = result.bodies.cell_data
    if "error_estimate" not in data:
        raise InputError(f"{directory}: found no error estimate; allowed: a run with estimate = true in [output]")
    try:
        mesh = Path(json.loads((directory / "report.json").read_text(encoding="utf-8"))["mesh"])
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{directory / 'report.json'}: found no mesh file in it ({error})") from None
    if (directory / "adapted.h5").exists():
        allowed = f"pcontact run {directory / 'adapted.toml'} -error, which goes on from its mesh"
        raise InputError(f"{directory}: found a run that has refined its mesh itself; allowed: {allowed}")
    if mesh.suffix == ".h5":
        raise InputError(f"{mesh}: found a converted mesh; allowed: a run of the mesh that it was made from")
    raw = read_mesh(mesh)
    number = np.concatenate(data["cell_number"])
    n = sum(len(block.nodes) for block in raw.blocks)
    estimates, centre = np.zeros(n), np.full((n, raw.dim), np.inf)
    corners = [table[:, : CELLS[KINDS[name][0]].n_vertices] for name, table in result.bodies.cells]
    middle = np.concatenate([result.bodies.points[table].mean(axis=1) for table in corners])
    if len(number) == n and number.max() < n:
        estimates[number] = np.concatenate(data["error_estimate"])
        centre[number] = middle[:, : raw.dim]
    own = np.concatenate([raw.points[block.vertices].mean(axis=1) for block in raw.blocks])
    if not np.abs(centre - own).max() <= NOT_MATCHING * max(float(np.ptp(raw.points, axis=0).max()), 1e-300):
        raise InputError(f"{mesh}: found another mesh than that of the run in {directory}; allowed: the same file")
    return raw, estimates, KINDS[result.bodies.cells[0][0]][1]
