"""Digest of a mesh: numbers that tell two meshes apart, the same on any number of ranks and however cells are dealt.

Every row (a cell with its nodes, a node with its coordinates, a member of a group) has a hash, and a digest is the sum
of the hashes modulo 2^64.
"""

import numpy as np

from pcontact.runtime.petsc import MPI

FACETS = 64  # more than a cell has
CELL, FACET, NODE = range(3)  # members of groups
# the numbers are in checkpoints
KINDS = {"hexahedron": 0, "quadrilateral": 1, "segment": 2, "tetrahedron": 3, "triangle": 4, "quadrilateral8": 5,
         "hexahedron20": 6, "wedge": 7, "wedge15": 8, "pyramid": 9, "pyramid13": 10}  # fmt: skip


def _scattered(h):
    """Finaliser of the generator SplitMix64 (Steele, Lea, Flood 2014)."""
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


def hashes(*columns):
    """Hashes (n,) uint64 of rows.

    Parameters
    ----------
    columns : ndarray (n,) or (n, k)
        Whole numbers, or floats: 0.0 and -0.0 are the same.
    """
    columns = [column if column.ndim == 2 else column[:, None] for column in columns]
    h = np.full(len(columns[0]), 0x9E3779B97F4A7C15, dtype=np.uint64)
    for table in columns:
        for k in range(table.shape[1]):
            column = table[:, k] + 0.0 if table.dtype.kind == "f" else table[:, k].astype(np.int64)
            h = _scattered(h + column.view(np.uint64) + np.uint64(0x9E3779B97F4A7C15))
    return h


def total(comm, h):
    """Sum of hashes (n,) of all ranks, as text. *Collective.*"""
    sums = np.array([np.sum(h, dtype=np.uint64)], dtype=np.uint64)
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    return f"{int(sums[0]):016x}"


def mesh_digest(mesh, owned, names):
    """Digest of what a run takes from a mesh. *Collective.*

    Parameters
    ----------
    mesh : pcontact.mesh.mesh.Mesh
    owned : ndarray
        Local nodes, each on one rank only.
    names : iterable of str
        Groups that the run uses, the same on all ranks.

    Returns
    -------
    dict of str to str
        ``points``, ``cells`` and, for every group, ``groups.NAME``.
    """
    comm = mesh.comm
    digest = dict(zip(("points", "cells"), _parts(mesh), strict=True))
    digest["cells"] += ", curved" if mesh.curved else ""
    mine = np.zeros(len(mesh.points), dtype=bool)
    mine[owned] = True
    for name in sorted(set(names)):
        digest[f"groups.{name}"] = total(comm, _group(mesh, mine, name))
    return digest


def _parts(mesh):
    """Digests of the points and of the cells. *Collective.*"""
    # a node counts once for every cell that it is in: ranks share nodes, but no cells
    count, cells = np.zeros(len(mesh.points), dtype=np.uint64), [np.zeros(0, dtype=np.uint64)]
    for block in mesh.blocks:
        count += np.bincount(block.nodes.ravel(), minlength=len(count)).astype(np.uint64)
        kind = np.full(len(block.ids), KINDS[block.cell])
        cells.append(hashes(kind, block.ids, mesh.file_nodes[block.nodes]))
    points = count * hashes(mesh.file_nodes, mesh.points)
    return total(mesh.comm, points), total(mesh.comm, np.concatenate(cells))


def _group(mesh, mine, name):
    """Hashes of the members of a group on this rank: cells, facets and nodes of that name."""
    parts = [np.zeros(0, dtype=np.uint64)]
    for block, rows in zip(mesh.blocks, mesh.cell_groups.get(name, []), strict=False):
        parts.append(hashes(np.full(len(rows), CELL), block.ids[rows]))
    for facets in mesh.facet_groups.get(name, []):
        ids = mesh.blocks[facets.block].ids[facets.cells] * FACETS + facets.local
        parts.append(hashes(np.full(len(ids), FACET), ids))
    nodes = mesh.node_groups.get(name, np.zeros(0, dtype=np.int64))
    nodes = nodes[mine[nodes]]
    parts.append(hashes(np.full(len(nodes), NODE), mesh.file_nodes[nodes]))
    return np.concatenate(parts)
