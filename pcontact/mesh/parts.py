"""A mesh of which every rank has some cells from the beginning: a DMPlex of the user's, or a file of PETSc.

Every rank checks its own cells as if they were a mesh, and completes them to degree 2 where that is asked for. Of what
several ranks have nodes become one: vertices by their numbers, others by those of the vertices around them.
"""

from dataclasses import replace
from functools import cached_property
from types import SimpleNamespace

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.mesh.hdf5 import ConvertedMesh
from pcontact.mesh.mesh import mixed
from pcontact.mesh.plex import read_petsc_file
from pcontact.mesh.raw import facet_multiplicity, facets_among, raised
from pcontact.mesh.read import build
from pcontact.mesh.refinement.numbering import number_nodes
from pcontact.mesh.slices import SliceBlock, bits, has_bit, level, whole
from pcontact.mesh.topology import cell_name, connected, nowhere_else
from pcontact.runtime.parallel import Exchanger, together
from pcontact.runtime.petsc import MPI

# parts of meshes from memory, by the names that scenes have for them
KEPT = {}


class PartMesh(ConvertedMesh):
    """A mesh of which this rank has a part, one of :data:`KEPT` or a file of PETSc; parameters and attributes as of a
    converted one. *Collective.*"""

    def __init__(self, comm, path, order, serendipity=False):
        self.comm, self.path, self._degree = comm, path, (order, serendipity)
        self._file = KEPT.get(path) or read_petsc_file(path, comm)
        # of the vertices, which come first
        self._numbers, self._exchanger = self._file.tags[: len(self._file.shared)] - 1, Exchanger(comm)
        self.held = raw = level(comm, together(comm, self._build))
        self.lost, self.between, self._elsewhere = raw.lost, {}, self._shared_facets()
        groups = {kind: getattr(raw, f"{kind[:-1]}_groups").items() for kind in ("cells", "facets", "nodes")}
        self._sizes = {kind: {name: self.settle(kind, name, made, name in self._file.outer) for name, made in some}
                       for kind, some in groups.items()}  # fmt: skip

    def _build(self):
        return build(self._file, self.path) if self._file.tables else None

    def _shared_facets(self):
        """Facets of own cells that a cell of another rank has, too, by eight times the cell and the facet."""
        keys, facets = [np.zeros(0, dtype=np.uint64)], [np.zeros(0, dtype=np.int64)]
        for count in (2,) if self.held.dim == 2 else (3, 4):
            corners, cells, local = facets_among(self.held.blocks, self._file.shared, count)
            keys.append(mixed(self._numbers)[corners].sum(axis=1, dtype=np.uint64))
            facets.append(8 * cells + local)
        return np.concatenate(facets)[~nowhere_else(self._exchanger, np.concatenate(keys))]

    def settle(self, kind, name, made, outer=True):
        """Have a group with members on this rank, of facets those on the boundary of the mesh; how many all ranks have.
        *Collective.*"""
        if kind == "facets":
            between = (facet_multiplicity(self.held, *made) > 1) | np.isin(8 * made[0] + made[1], self._elsewhere)
            made = tuple(rows[~(between & outer)] for rows in made)
            self.between[name] = between[~(between & outer)]
        getattr(self.held, f"{kind[:-1]}_groups")[name] = made
        return self.comm.allreduce(len(made[0] if kind == "facets" else made))

    def summary(self, pairs):
        """As of a converted mesh; groups by place can be added to it. *Collective.*"""
        return replace(super().summary(pairs), parts=self)

    def named(self, row):
        """A cell of this rank in the words of a message."""
        return cell_name(self.held.points, self.held.blocks, self.held.tags, row)

    @cached_property
    def piece(self):
        """The slices of the mesh. *Collective.*"""
        comm, (raw, curved) = self.comm, raised(self.held, *self._degree)
        rows = np.column_stack([np.full(len(raw.points), comm.rank), raw.points.view(np.int64)])
        own, numbers = self._numbers, np.full(len(rows), -1, dtype=np.int64)
        numbers[: len(own)] = own
        base = SimpleNamespace(n_nodes_total=1 + comm.allreduce(int(own.max(initial=-1)), op=MPI.MAX))
        home, ids = number_nodes(self._exchanger, base, numbers, _keys(raw, own), rows, fewer=True)
        places = home.places[:, 0]
        component = connected(comm, [block.vertices for block in raw.blocks], ids, home.total)
        piece = replace(
            whole(comm, raw, curved, component),
            blocks=[SliceBlock(block.cell, places[block.nodes]) for block in raw.blocks],
            points=np.ascontiguousarray(home.table[:, 1:]).view(np.float64), point_starts=home.starts,
            n_nodes_total=home.total, node_ids=home.numbers, node_groups=self._node_groups(raw.node_groups, home),
            edge_groups={name: ids[edges] for name, edges in raw.edge_groups.items()},
        )  # fmt: skip
        self._exchanger.free()
        return piece

    def _node_groups(self, groups, home):
        """Groups of nodes where the nodes are kept: what any rank has in them. *Collective.*"""
        members, first = bits(groups, len(home.places)), home.starts[self.comm.rank]
        known = np.column_stack([home.places[:, 0], members])[members.any(axis=1)]
        heard = self._exchanger.deliver(np.searchsorted(home.starts, known[:, 0], side="right") - 1, known)
        found = np.zeros((len(home.table), members.shape[1]), dtype=np.int64)
        np.bitwise_or.at(found, heard[:, 0] - first, heard[:, 1:])
        return {name: np.flatnonzero(has_bit(found, k)) for k, name in enumerate(groups)}


def _keys(raw, numbers):
    """Keys (n,) uint64 of nodes: of vertices by their numbers, of others the sum of those of the vertices around."""
    keys = np.zeros(len(raw.points), dtype=np.uint64)
    keys[: len(numbers)] = mixed(numbers)
    for block in raw.blocks:
        cell, n = CELLS[block.cell], block.nodes.shape[1]
        around = [*cell.edges, *cell.faces, range(cell.n_vertices)]
        for column, corners in zip(range(cell.n_vertices, n), around, strict=False):
            keys[block.nodes[:, column]] = keys[block.nodes[:, list(corners)]].sum(axis=1, dtype=np.uint64)
    return keys
