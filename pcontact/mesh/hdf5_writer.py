"""A mesh of any format, checked and ordered, as one HDF5 file from which every rank can read a part.

The layout is described in docs/files.md.
"""

from pathlib import Path

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.mesh.complete import complete
from pcontact.mesh.components import components
from pcontact.mesh.curve import as_met, z_order
from pcontact.mesh.groups import facet_multiplicity, say_lost
from pcontact.mesh.plex_reader import is_petsc_file
from pcontact.mesh.reader import read_mesh
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import Hdf5Aside

FORMAT, VERSION = "pcontact mesh", 1
SUFFIX = ".h5"


def _small(numbers):
    """Whole numbers in 32 bits where these do."""
    numbers = np.asarray(numbers)
    fits = numbers.size == 0 or (-(2**31) <= numbers.min() and numbers.max() < 2**31)
    return numbers.astype(np.int32) if fits else numbers.astype(np.int64)


def _inverse(order):
    out = np.empty(len(order), dtype=np.int64)
    out[order] = np.arange(len(order))
    return out


def _ordered(raw):
    """Cells along a Z curve, block by block, and nodes as they meet them.

    Returns
    -------
    tables : list of ndarray
        Nodes by their places in the file.
    cells, nodes : ndarray
        Numbers in ``raw`` of the cells and nodes in the order of the file.
    """
    tables, cells = [], []
    for block, first in zip(raw.blocks, raw.offsets[:-1], strict=True):
        order = z_order(raw.points[block.nodes[:, : CELLS[block.cell].n_vertices]].mean(axis=1))
        tables.append(np.ascontiguousarray(block.nodes[order]))
        cells.append(first + order)
    nodes, _ = as_met(tables, len(raw.points))
    return tables, np.concatenate(cells), nodes


def _write_groups(file, raw, cell_at, node_at):
    """Groups by the places of their cells and nodes, ascending."""

    def make(kind, number, name, **columns):
        group = file.create_group(f"groups/{kind}/{number}")
        group.attrs["name"] = name
        for key, values in columns.items():
            group.create_dataset(key, data=values)

    for kind in ("cells", "facets", "nodes", "edges"):
        file.create_group(f"groups/{kind}")
    for k, (name, cells) in enumerate(raw.cell_groups.items()):
        make("cells", k, name, cells=_small(np.sort(cell_at[cells])))
    for k, (name, (cells, local)) in enumerate(raw.facet_groups.items()):
        order = np.lexsort((local, cell_at[cells]))
        between = facet_multiplicity(raw, cells, local) > 1
        make("facets", k, name, cells=_small(cell_at[cells][order]), local=local[order].astype(np.int8),
             between=between[order].astype(np.int8))  # fmt: skip
    for k, (name, nodes) in enumerate(raw.node_groups.items()):
        make("nodes", k, name, nodes=_small(np.sort(node_at[nodes])))
    for k, (name, edges) in enumerate(raw.edge_groups.items()):
        make("edges", k, name, nodes=_small(node_at[edges]))
    for k, (name, why) in enumerate(raw.lost.items()):
        make("lost", k, name)
        file[f"groups/lost/{k}"].attrs["found"] = why


def _write(file, raw, curved):
    component = components(raw)
    tables, cells, nodes = _ordered(raw)
    file.attrs.update(
        format=FORMAT, version=VERSION, dim=raw.dim, degree=raw.blocks[0].degree, curved=int(curved),
        components=int(component.max()) + 1, cells=len(cells), nodes=len(nodes), source=raw.path.name, checksums=1,
    )  # fmt: skip
    file.create_dataset("points", data=raw.points[nodes])
    file.create_dataset("node_ids", data=_small(nodes))
    file.create_dataset("cells/ids", data=_small(cells))
    tags = np.arange(1, len(cells) + 1) if raw.tags is None else raw.tags
    file.create_dataset("cells/tags", data=_small(tags[cells]))
    file.create_dataset("cells/components", data=_small(component[cells]))
    for k, (block, table) in enumerate(zip(raw.blocks, tables, strict=True)):
        file.create_dataset(f"blocks/{k}", data=_small(table)).attrs["cell"] = block.cell
    _write_groups(file, raw, _inverse(cells), _inverse(nodes))
    # the last thing to be written: a file without it is cut short
    file.attrs["complete"] = 1


def mesh_sizes(raw):
    """What a mesh holds, in the words of a message."""
    kinds = ", ".join(f"{len(block.nodes)} cells ({block.cell})" for block in raw.blocks)
    groups = len({*raw.cell_groups, *raw.facet_groups, *raw.node_groups})
    return f"{len(raw.points)} nodes, {kinds}, degree {raw.blocks[0].degree}, {groups} groups"


def convert(path, target=None, order=1):
    """Read a mesh, check it, and write it as HDF5.

    Parameters
    ----------
    path : str or pathlib.Path
    target : str or pathlib.Path, optional
        Beside the mesh if absent.
    order : int
        2: cells are completed to degree 2, for a displacement of that degree.

    Returns
    -------
    target : pathlib.Path
    raw : RawMesh
        What was written.

    Raises
    ------
    InputError, OutputError
    """
    path = Path(path)
    target = path.with_suffix(SUFFIX) if target is None else Path(target)
    if target.suffix.lower() != SUFFIX:
        raise InputError(f"command line: -o: found {str(target)!r}; allowed: a name that ends with {SUFFIX}")
    if path.suffix.lower() == SUFFIX and (target.resolve() == path.resolve() or not is_petsc_file(path)):
        raise InputError(f"{path}: found a file that ends with {SUFFIX}; allowed: the mesh that it was made from")
    raw = read_mesh(path)
    say_lost(path, raw.lost)
    return target, write(target, raw, order)


def write(target, raw, order=1, curved=None):
    """Write a mesh that has been read, and return it as it was written; parameters as of :func:`convert`, and whether
    its cells are curved: absent, as those of a file of degree 2."""
    curved = any(block.degree == 2 for block in raw.blocks) if curved is None else curved
    if curved or order == 2:
        raw = complete(raw, 2)
    aside = Hdf5Aside(target, "-o")
    try:
        _write(aside.file, raw, curved)
        aside.place()
    finally:
        aside.discard()
    return raw
