"""Items of forces that are linear in the displacement of a group: springs to the ground, R += K u, K = int N k N^T."""

import numpy as np

from pcontact.assembly.graph import Product, node_graph
from pcontact.assembly.item import LAW, Item
from pcontact.assembly.loads import across
from pcontact.assembly.matrix import OwnedRows
from pcontact.assembly.patches import cell_patches, facet_patches, group_patches


class LinearForces(Item):
    """Forces R += f K u of a group that follow from the displacement there, K constant and f a factor of time.

    Parameters
    ----------
    space : pcontact.space.space.Space
    name : str
    patches : list of pcontact.assembly.patches.Patch
        Their elements.
    blocks : callable
        Stiffness (n, nn, nn, d, d) of the elements of a patch.

    Notes
    -----
    The constructor is *Collective*.
    """

    changes = False

    def __init__(self, space, name, patches, blocks):
        self.space, self.name, self._factor = space, name, 1.0
        nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *(patch.nodes.ravel() for patch in patches)]))
        tables = [np.searchsorted(nodes, patch.nodes) for patch in patches]
        rowptr, columns = node_graph(tables, len(nodes))
        values = np.zeros((len(columns), space.dim, space.dim))
        # sorted: columns are sorted in each row
        place = np.repeat(np.arange(len(nodes)), np.diff(rowptr)) * len(nodes) + columns
        for table, patch in zip(tables, patches, strict=True):
            entries = table[:, :, None] * len(nodes) + table[:, None, :]
            np.add.at(values, np.searchsorted(place, entries), blocks(patch))
        self._local = nodes, rowptr, columns, values
        owned = OwnedRows(space.numbering, space.exchanger, space.nodes[nodes], rowptr, columns)
        self._rowptr, self._columns, self._values = owned.rowptr, owned.columns, owned.sum(values)
        self._product = Product(space, self._rowptr, self._columns)

    def pattern(self):
        """Owned block rows: rowptr (n_owned + 1,), columns (nnz,)."""
        return self._rowptr, self._columns

    def residual(self, u, out, rule=LAW):
        """Add the forces of the owned nodes to ``out`` (n_owned, d). *Collective.*"""
        out += self._factor * self._product(self._values, u)

    def external(self, u, out):
        """Add the forces on the bodies to ``out`` (n_owned, d) [force]. *Collective.*"""
        out -= self._factor * self._product(self._values, u)

    def add_magnitude(self, u, out):
        """Add the sum of the absolute terms of :meth:`residual` to ``out`` (n_owned, d). *Collective.*"""
        out += np.abs(self._factor * self._product(self._values, u, magnitudes=True))

    def tangent(self, u, rule=LAW):
        """Values (nnz, d, d) on :meth:`pattern`."""
        return self._factor * self._values


class GroundSprings(LinearForces):
    """Springs between a group and the ground, linear in the displacement.

    Parameters
    ----------
    space : pcontact.space.space.Space
    spring : pcontact.scene.model.Spring

    Notes
    -----
    The constructor is *Collective*.
    """

    def __init__(self, space, spring):
        self.region = spring.region
        patches = list(facet_patches(space, spring.region)) if spring.per_area else group_patches(space, spring.region)
        self._stiffness = self._tensor(space, spring, patches)
        super().__init__(space, spring.name or spring.region, patches, self._blocks)

    @staticmethod
    def _tensor(space, spring, patches):
        """A number along the normal, or a stiffness (d,) in each direction, per measure. *Collective.*"""
        if spring.per_area is not None:
            return spring.per_area if np.ndim(spring.per_area) == 0 else np.array(spring.per_area)
        total = space.comm.allreduce(float(sum(patch.weight.sum() for patch in patches)))
        return np.array(spring.stiffness) / total

    def tensor(self, normals):
        """Stiffness (..., d, d) per measure at points with unit normals (..., d); None in cells."""
        if np.ndim(self._stiffness):
            return np.diag(self._stiffness)
        return self._stiffness * normals[..., :, None] * normals[..., None, :]

    def _blocks(self, patch):
        """Stiffness (n, nn, nn, d, d) of the elements of a patch."""
        products = np.einsum("nq,nqa,nqb->nqab", patch.weight, patch.shape, patch.shape)
        if np.ndim(self._stiffness):
            return products.sum(axis=1)[..., None, None] * np.diag(self._stiffness)
        return self._stiffness * np.einsum("nqab,nqi,nqj->nabij", products, patch.normals, patch.normals)

    def hold(self, modes):
        """Work of motions (n_modes, n_local, d) of the bodies, translations first, against each other (n_components,
        n_modes, n_modes), of this rank, in parts of that of all translations. *Collective.*
        """
        nodes, rowptr, columns, values = self._local
        rows = np.repeat(np.arange(len(nodes)), np.diff(rowptr))
        work = np.einsum("mki,kij,nkj->kmn", modes[:, nodes[rows]], values, modes[:, nodes[columns]])
        held = np.zeros((self.space.mesh.n_components, len(modes), len(modes)))
        np.add.at(held, self.space.component[nodes[rows]], work)
        # so that what holds does not depend on units
        ways = range(self.space.dim)
        return held / self.space.comm.allreduce(float(held[:, ways, ways].sum()))

    def report(self, u):
        """Force of the springs on the bodies. *Collective.*"""
        own = np.zeros((self.space.n_owned, self.space.dim))
        self.external(u, own)
        return {"springs": {self.name: {"force": self.space.comm.allreduce(own.sum(axis=0)).tolist()}}}


class SpinForces(LinearForces):
    """Part of the displacement in the centrifugal force of bodies with finite strain: -K = rho w^2 int N P N^T.

    Parameters
    ----------
    space : pcontact.space.space.Space
    load : pcontact.scene.model.Load
        With an angular speed w.
    name : str
    masses : dict of int to float
        Density of the bodies with finite strain, by number.
    amplitude : pcontact.scene.amplitude.Squared

    Notes
    -----
    The constructor is *Collective*.
    """

    changes = True

    def __init__(self, space, load, name, masses, amplitude):
        self._masses, self._amplitude = masses, amplitude
        self._across = -(load.angular_speed**2) * across(space, load)
        patches = [patch for patch in cell_patches(space, load.region) if patch.body in masses]
        super().__init__(space, name, patches, self._blocks)

    def _blocks(self, patch):
        products = np.einsum("nq,nqa,nqb->nab", patch.weight, patch.shape, patch.shape)
        return self._masses[patch.body] * products[..., None, None] * self._across

    def detect(self, u, time, motion=0.0, ahead=None):
        """The speed is that of the end of the load step."""
        self._factor = float(self._amplitude.factor(time))
