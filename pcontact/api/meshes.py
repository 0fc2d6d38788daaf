"""Meshes from memory: arrays, meshio, pyvista, a DMPlex, a model of gmsh; and files with further groups."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.io.vtu import CELL_NAMES
from pcontact.mesh.formats import from_meshio
from pcontact.mesh.msh import write_file
from pcontact.mesh.parts import KEPT
from pcontact.mesh.plex import file_of
from pcontact.mesh.raw import KINDS, LOWER, Block, FileMesh, RawMesh, Table, facet_vertices, facets_of_nodes
from pcontact.mesh.read import read_file
from pcontact.runtime.errors import InputError, call_in_messages
from pcontact.runtime.parallel import together
from pcontact.scene.model import MeshSpec

_folder: list[Path] = []


def mesh_from(
    source: Any,
    groups: Mapping[str, Any] | None = None,
    facets: Mapping[str, Any] | None = None,
    **keys: Any,
) -> MeshSpec:
    """The mesh of a scene, from a file or from memory.

    Parameters
    ----------
    source : str, pathlib.Path, meshio.Mesh, pyvista dataset, PETSc.DMPlex, the module gmsh, or (points, cells)
        Of a DMPlex (or what has one as ``topology_dm``, as Firedrake's meshes), with faces or without, on any number of
        ranks, the labels are the groups; *collective* then. Of gmsh, its current model with its physical groups; of
        arrays, points (n, d) and a dict from types of cells as
        meshio calls them to nodes (nc, nn) in VTK's order. Cells and groups of files and of meshio are kept.
    groups : dict, optional
        Further groups of cells: numbers (k,) or a mask (n_cells,) over all cells, block after block; "all" names them
        all.
    facets : dict, optional
        Further groups of facets: their corners (k, 2 to 4) as rows of the points, or a function of points (n, d) that
        says (n,) which of them are on it: facets of the boundary with all corners there belong to it.
    **keys
        Other keys of ``[mesh]``: `order`, `kinematics`, `strain`, ...

    Returns
    -------
    pcontact.scene.MeshSpec

    Raises
    ------
    InputError
        It is nothing of these, or a group has no facets.
    """
    if isinstance(source, MeshSpec):
        return source
    if isinstance(source, (str, Path)) and not groups and not facets:
        return MeshSpec(file=source, **keys)
    return MeshSpec(file=_written(source, groups or {}, facets or {}), **keys)


def own_folder() -> Path:
    """A new directory of this process's own, that goes when it ends."""
    if not _folder:
        _folder.append(Path(tempfile.mkdtemp(prefix="pcontact_")))
        atexit.register(shutil.rmtree, _folder[0], ignore_errors=True)
    return Path(tempfile.mkdtemp(dir=_folder[0]))


def _written(source: Any, groups: Mapping[str, Any], facets: Mapping[str, Any]) -> Path:
    path = own_folder() / "mesh.msh"
    call_in_messages(str(path), "the mesh in memory")
    if getattr(source, "__name__", "") == "gmsh" and not groups and not facets:
        source.option.setNumber("Mesh.MshFileVersion", 4.1)
        source.write(str(path))
        return path
    source = getattr(source, "topology_dm", source)
    if not hasattr(source, "getHeightStratum"):
        _write(path, _file(source), groups, facets)
        return path
    file, comm = file_of(source, "mesh"), source.comm.tompi4py()
    if comm.size == 1:
        _write(path, file, groups, facets)
        return path
    path = comm.bcast(path)
    call_in_messages(str(path), "the mesh in memory")
    path.touch()  # stands for what is in memory
    together(comm, lambda: _add(file, groups, facets) if file.tables else None)
    KEPT[path] = file
    return path


def _file(source: Any) -> FileMesh:
    """Return the mesh as a file has it: points, tables of elements, groups."""
    if isinstance(source, (str, Path)):
        return read_file(Path(source))
    if hasattr(source, "cell_sets"):
        return from_meshio(source, "mesh")
    if hasattr(source, "cast_to_unstructured_grid"):
        grid = source.cast_to_unstructured_grid()
        points, cells = grid.points, {CELL_NAMES.get(int(kind), ("vertex",))[0]: nodes
                                      for kind, nodes in grid.cells_dict.items()}  # fmt: skip
        cells.pop("vertex", None)
    elif isinstance(source, tuple) and len(source) == 2:
        points, cells = source[0], dict(source[1])
    else:
        raise InputError(
            f"mesh: found {type(source).__name__}; allowed: a file, meshio.Mesh, a pyvista dataset, a DMPlex, the "
            "module gmsh, or (points, cells)"
        )
    file = FileMesh.of(np.asarray(points, dtype=float))
    for kind, nodes in cells.items():
        file.add_elements("mesh", kind, _dim(kind), np.asarray(nodes, dtype=np.int64))
    return file


def _write(path: Path, file: FileMesh, groups: Mapping[str, Any], facets: Mapping[str, Any]) -> None:
    """Write a .msh file with the groups that are added."""
    _add(file, groups, facets)
    write_file(path, file)


def _add(file: FileMesh, groups: Mapping[str, Any], facets: Mapping[str, Any]) -> None:
    """Add groups to a mesh, or to what this rank has of it."""
    top, tables = max((table.dim for table in file.tables), default=0), list(file.tables)
    flat = file.points if top == 3 or np.ptp(file.points[:, 2]) else file.points[:, :2]
    first = np.cumsum([0, *(len(table.nodes) for table in tables)])
    for name, chosen in groups.items():
        whole = isinstance(chosen, str) and chosen == "all"
        rows = np.arange(first[-1]) if whole else np.asarray(chosen)
        rows = np.flatnonzero(rows) if rows.dtype == bool else rows
        for dim in range(top + 1):
            file.groups.pop((dim, name), None)
        for k, table in enumerate(tables):
            own = rows[(rows >= first[k]) & (rows < first[k + 1])] - first[k]
            if len(own) and not (whole and table.dim < top):
                file.add(table.dim, name, k, own)
    for name, chosen in facets.items():
        found = _facets(chosen, flat, [table for table in tables if table.dim == top])
        if not found and file.shared is None:
            raise InputError(f"mesh: facets {name!r}: found no facet of the boundary there; allowed: a group with some")
        for kind, nodes in found:
            number = file.add_elements("mesh", kind, _dim(kind), nodes)
            file.add(_dim(kind), name, number, np.arange(len(nodes)))
        file.outer |= {name} if callable(chosen) else set()


def _dim(kind: str) -> int:
    """Dimension of cells, by meshio's name."""
    return CELLS[KINDS[kind][0]].dim if kind in KINDS else 0


def _facets(chosen: Any, points: np.ndarray, tables: Sequence[Table]) -> list[tuple[str, np.ndarray]]:
    """Facets of a group by their corners."""
    if not callable(chosen):
        corners = np.atleast_2d(np.asarray(chosen, dtype=np.int64))
        return [(LOWER[corners.shape[1]][0], corners)]
    blocks = [Block(*KINDS[one.kind], one.nodes) for one in tables if one.kind in KINDS]
    raw = RawMesh(Path("mesh"), tables[0].dim, points, blocks)
    cells, local = facets_of_nodes(raw, np.flatnonzero(np.asarray(chosen(points), dtype=bool)))
    return [(LOWER[nodes.shape[1]][0], nodes) for _, nodes in facet_vertices(raw, cells, local)]
