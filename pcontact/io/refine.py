"""``pcontact refine``: a better mesh from the error estimate of a finished run."""

import json
from pathlib import Path

import numpy as np

from pcontact.element.reference import CELLS, edge_nodes
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
# a cell becomes at most so much smaller or larger at once: estimates of a coarse mesh know only so much
SMALLEST, LARGEST = 0.25, 2.0


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


def largest_contributions(estimates, part):
    """The fewest cells whose estimates make up a part of the whole (Doerfler 1996).

    Parameters
    ----------
    estimates : ndarray (n,)
        Of every cell, squares sum to that of the whole.
    part : float
        Of the sum of the squares, 0 to 1.

    Returns
    -------
    ndarray (n,) of bool
    """
    squares = np.asarray(estimates, dtype=float) ** 2
    order = np.argsort(-squares, kind="stable")
    count = np.searchsorted(np.cumsum(squares[order]), part * squares.sum() * (1.0 - 1e-12)) + 1
    marked = np.zeros(len(squares), dtype=bool)
    marked[order[:count]] = True
    return marked & (squares > 0.0)


def new_sizes(estimates, sizes, degree, dim, factor):
    """Sizes of cells that bring the error down with the fewest cells.

    A cell's part of the error falls with the size to the power of the degree p, the number of cells that take its place
    grows with its inverse to the power of the dimension: sizes are best in proportion to estimate^(-2 / (2 p + dim)).

    Parameters
    ----------
    estimates, sizes : ndarray (n,)
        Of the cells [sqrt(energy)], [length].
    degree, dim : int
    factor : float
        Error wanted over the estimate.

    Returns
    -------
    sizes : ndarray (n,)
        [length]
    predicted : float
        Error that they promise over the estimate.
    """
    squares = np.asarray(estimates, dtype=float) ** 2
    total = squares.sum()
    if total == 0.0:
        return sizes * LARGEST, 0.0
    # nothing is gained from cells without any error
    shape = np.maximum(squares / total, 1e-12) ** (-1.0 / (2 * degree + dim))

    def tried(scale):
        ratio = np.clip(scale * shape, SMALLEST, LARGEST)
        return ratio, float(np.sqrt(np.sum(squares * ratio ** (2 * degree)) / total))

    low, high = SMALLEST / shape.max(), LARGEST / shape.min()
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if tried(middle)[1] < factor else (low, middle)
    ratio, predicted = tried(low)
    return sizes * ratio, predicted


def edge_lengths(points, cells, edges):
    """Mean length (n,) of the edges (m, 2 local vertices) of cells (n, nodes) [length]."""
    ends = points[cells[:, edges]]
    return np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2).mean(axis=1)


def at_vertices(n_points, cells, sizes):
    """Sizes (n_points,) at the vertices of cells (n, k): geometric means of those of the cells around.

    Parameters
    ----------
    n_points : int
    cells : list of ndarray
        Vertices, one table for each kind of cell.
    sizes : list of ndarray
        [length]
    """
    total, count = np.zeros(n_points), np.zeros(n_points)
    for table, values in zip(cells, sizes, strict=True):
        np.add.at(total, table, np.log(values)[:, None])
        np.add.at(count, table, 1.0)
    return np.exp(total / np.maximum(count, 1.0))
