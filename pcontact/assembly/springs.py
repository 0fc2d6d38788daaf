"""The item of springs between a group and the ground: R += K u, K = int N k N^T."""

import numpy as np

from pcontact.assembly.graph import multiply, node_graph
from pcontact.assembly.item import LAW, Item
from pcontact.assembly.patches import facet_patches, group_patches
from pcontact.assembly.pattern import OwnedRows


class GroundSprings(Item):
    """Springs between a group and the ground, linear in the displacement.

    Parameters
    ----------
    space : pcontact.space.space.Space
    spring : pcontact.scene.model.Spring

    Notes
    -----
    The constructor is *Collective*.
    """

    changes = False

    def __init__(self, space, spring):
        self.space, self.name = space, spring.name or spring.region
        patches = list(facet_patches(space, spring.region)) if spring.per_area else group_patches(space, spring.region)
        self._stiffness = self._tensor(spring, patches)
        nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *(patch.nodes.ravel() for patch in patches)]))
        numbers = np.full(space.n_local, -1, dtype=np.int64)
        numbers[nodes] = np.arange(len(nodes))
        tables = [np.ascontiguousarray(numbers[patch.nodes]) for patch in patches]
        rowptr, columns = node_graph(tables, len(nodes))
        values = np.zeros((len(columns), space.dim, space.dim))
        # sorted: columns are sorted in each row
        place = np.repeat(np.arange(len(nodes)), np.diff(rowptr)) * len(nodes) + columns
        for table, patch in zip(tables, patches, strict=True):
            entries = table[:, :, None] * len(nodes) + table[:, None, :]
            np.add.at(values, np.searchsorted(place, entries), self._blocks(patch))
        self._local = nodes, rowptr, columns, values
        owned = OwnedRows(space.numbering, space.exchanger, space.nodes[nodes], rowptr, columns)
        self._rowptr, self._columns, self._values = owned.rowptr, owned.columns, owned.sum(values)
        needed, self._column = np.unique(self._columns, return_inverse=True)
        self._exchange = space.exchange(needed)

    def _tensor(self, spring, patches):
        """A number along the normal, or a stiffness (d,) in each direction, per measure. *Collective.*"""
        if spring.per_area is not None:
            return spring.per_area if np.ndim(spring.per_area) == 0 else np.array(spring.per_area)
        total = self.space.comm.allreduce(float(sum(patch.weight.sum() for patch in patches)))
        return np.array(spring.stiffness) / total

    def _blocks(self, patch):
        """Stiffness (n, nn, nn, d, d) of the elements of a patch."""
        products = np.einsum("nq,nqa,nqb->nqab", patch.weight, patch.shape, patch.shape)
        if np.ndim(self._stiffness):
            return products.sum(axis=1)[..., None, None] * np.diag(self._stiffness)
        return self._stiffness * np.einsum("nqab,nqi,nqj->nabij", products, patch.normals, patch.normals)

    def hold(self, modes):
        """Work of motions (n_modes, n_local, d) of the bodies against each other (n_components, n_modes, n_modes), of
        this rank, in parts of the largest stiffness.
        """
        nodes, rowptr, columns, values = self._local
        rows = np.repeat(np.arange(len(nodes)), np.diff(rowptr))
        work = np.einsum("mki,kij,nkj->kmn", modes[:, nodes[rows]], values, modes[:, nodes[columns]])
        held = np.zeros((self.space.mesh.n_components, len(modes), len(modes)))
        np.add.at(held, self.space.component[nodes[rows]], work)
        return held / self._scale

    @property
    def _scale(self):
        """Largest stiffness of a direction, so that what holds does not depend on units."""
        return float(np.max(self._stiffness))

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self._rowptr, self._columns

    def _product(self, values, u):
        y = np.empty((self.space.n_owned, self.space.dim))
        multiply(self._rowptr, self._column, values, u, y)
        return y

    def residual(self, u, out, rule=LAW):
        """Add the forces of the springs to ``out`` (n_owned, d). *Collective.*"""
        out += self._product(self._values, self._exchange.gather(u))

    def external(self, u, out):
        """Add the forces of the springs on the bodies to ``out`` (n_owned, d) [force]. *Collective.*"""
        out -= self._product(self._values, self._exchange.gather(u))

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        out += self._product(np.abs(self._values), np.abs(self._exchange.gather(u)))

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`."""
        return self._values

    def record(self, u):
        """Force of the springs on the bodies, for the report. *Collective.*"""
        own = np.zeros((self.space.n_owned, self.space.dim))
        self.external(u, own)
        return {"force": self.space.comm.allreduce(own.sum(axis=0)).tolist()}
