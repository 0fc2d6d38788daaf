"""The fields of the last load step that converged, as arrays of this rank."""

import time as clock
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.contact.law import OPEN, SLIP, STICK
from pcontact.element.reference import MESHIO_NAMES
from pcontact.io.fields import NODE_NUMBER, Piece
from pcontact.io.names import BEGIN
from pcontact.io.vtu import CELL_TYPES, STORED
from pcontact.material.elastic import equivalent_stress
from pcontact.runtime.observer import Observer


class NodeMeans:
    """Volume-weighted means of the cells around every node, in each body for itself and over all ranks.

    Bodies that share nodes keep their own values there: the nodes are doubled.

    Parameters
    ----------
    space : pcontact.space.space.Space

    Attributes
    ----------
    nodes : ndarray (n,)
        Local space node of every point that has means; each node once, in order, where bodies do not share any.
    cells : list of ndarray (nc, nn)
        For each block, points in place of local nodes.

    Notes
    -----
    The constructor is *Collective*, and so are the calls.
    """

    def __init__(self, space):
        self._space = space
        self._layers, n_layers = _layers(space)
        self._point = np.full((n_layers, space.n_local), -1, dtype=np.int64)
        for layer, table in zip(self._layers, space.cells, strict=True):
            self._point[layer[:, None], table] = 0
        self._used = self._point == 0
        self._point[self._used] = np.arange(self._used.sum())
        self.nodes = np.nonzero(self._used)[1]
        tables = zip(self._layers, space.cells, strict=True)
        self.cells = [self._point[layer[:, None], table] for layer, table in tables]

    def __call__(self, fields, volumes):
        """Means of cell fields. *Collective.*

        Parameters
        ----------
        fields : dict of str to list of ndarray (nc,) or (nc, k)
            One array per block; the same names and k on every rank.
        volumes : list of ndarray (nc,)
            Volumes of the cells.

        Returns
        -------
        dict of str to ndarray (n,) or (n, k)
            At the points.
        """
        means, volume = {}, self._sums([v[:, None] for v in volumes])[:, 0]
        for name, blocks in fields.items():
            columns = [block if block.ndim == 2 else block[:, None] for block in blocks]
            mean = self._sums([v[:, None] * c for v, c in zip(volumes, columns, strict=True)]) / volume[:, None]
            means[name] = mean if any(block.ndim == 2 for block in blocks) else mean[:, 0]
        return means

    def _sums(self, blocks):
        """Sums (n, k) over the cells around the points, of values (nc, k)."""
        space, d = self._space, self._space.dim
        k = max((block.shape[1] for block in blocks), default=0)
        out = np.empty((len(self.nodes), k))
        for layer, used in enumerate(self._used):
            place = self._point[layer, used]
            # vectors have d values per node: a few columns at a time
            for first in range(0, k, d):
                local = self._local([block[:, first : first + d] for block in blocks], layer)
                width = min(d, k - first)
                out[place, first : first + width] = space.together(local)[used, :width]
        return out

    def _local(self, blocks, layer):
        """This rank's sums (n_local, d) of the cells of a layer."""
        space = self._space
        local = np.zeros((space.n_local, space.dim))
        for block, layers, table in zip(blocks, self._layers, space.cells, strict=True):
            rows = layers == layer
            nodes = table[rows].ravel()
            for column in range(block.shape[1]):
                values = np.repeat(block[rows, column], table.shape[1])
                local[:, column] += np.bincount(nodes, values, minlength=space.n_local)
        return local


def _layers(space):
    """Layer (nc,) of the cells of each block, and the number of layers. *Collective.*

    Bodies of one connected component may share nodes: each has its own layer.
    """
    blocks = space.mesh.blocks
    mine = {(int(c), block.body) for block in blocks for c in np.unique(block.components)}
    pairs = sorted(set().union(*space.comm.allgather(mine)))
    first = {component: number for number, (component, _) in reversed(list(enumerate(pairs)))}
    layer = {(component, body): number - first[component] for number, (component, body) in enumerate(pairs)}
    layers = []
    for block in blocks:
        table = np.zeros(space.mesh.n_components, dtype=np.int64)
        for component in np.unique(block.components).tolist():
            table[component] = layer[component, block.body]
        layers.append(table[block.components])
    return layers, max(layer.values(), default=0) + 1


def facet_status(facet, status, weight, n):
    """Return what most of the closed points of a facet do, by their area: stick or slip; open where none is closed.

    Parameters
    ----------
    facet : ndarray of int (np,)
        Of each point.
    status : ndarray of int (np,)
    weight : ndarray (np,)
        Area of each point.
    n : int
        Facets.

    Returns
    -------
    ndarray of int (n,)
    """
    stick, slip = (np.bincount(facet, weight * (status == which), minlength=n) for which in (STICK, SLIP))
    return np.where(stick + slip > 0, np.where(stick > slip, STICK, SLIP), OPEN)


class Taken(NamedTuple):
    """The fields of a load step on this rank.

    Attributes
    ----------
    number, time : int, float
        Of the step.
    bodies : pcontact.io.fields.Piece
        The cells that this rank owns.
    cell_numbers : list of ndarray (nc,)
        Of the cells of each block, the same on any ranks.
    surfaces : dict of str to Piece
        The source facets of each contact pair.
    points : dict of str to Piece
        Its quadrature points.
    point_numbers : dict of str to ndarray (np,)
        Numbers of these, the same on any ranks.
    """

    number: int
    time: float
    bodies: Piece
    cell_numbers: list
    surfaces: dict
    points: dict
    point_numbers: dict


class Snapshot(Observer):
    """Observer that evaluates the fields of every step, for those that come after it, and keeps them till the next.

    Parameters
    ----------
    problem : pcontact.solve.problem.Problem
    timing : dict
        ``output`` seconds are added.
    smooth : bool
        The fields of the cells averaged at the nodes, too.
    estimate : pcontact.io.error_estimate.ErrorEstimate, optional
        Observer that has estimated the error of the step before.

    Attributes
    ----------
    taken : Taken or None
        None before the first step.
    """

    def __init__(self, problem, timing, smooth=False, estimate=None):
        self._problem, self._timing, self._estimate = problem, timing, estimate
        self._means = NodeMeans(problem.space) if smooth else None
        self.taken = None

    def step(self, step, u, record):
        """Take the fields of the step. *Collective.*"""
        start, contacts, surfaces, points = clock.perf_counter(), self._problem.contacts, {}, {}
        for contact in contacts:
            surfaces[contact.name], points[contact.name] = self._contact(contact, u)
        point_numbers = {contact.name: contact.memory_keys() for contact in contacts}
        cell_numbers = [block.ids for block in self._problem.space.mesh.blocks]
        self.taken = Taken(step.number, step.time, self._bodies(u), cell_numbers, surfaces, points, point_numbers)
        self._timing["output"] += clock.perf_counter() - start

    def undeformed(self):
        """The fields of the bodies before the first load step, which was the last one taken: all but the places are 0,
        stretches 1, and gaps and normals are those of its partners. *Collective.*

        Returns
        -------
        Taken
        """
        taken, start = self.taken, self._problem.space.vector()
        bodies = replace(taken.bodies, point_data=_begun(taken.bodies.point_data),
                         cell_data=_begun(taken.bodies.cell_data))  # fmt: skip
        surfaces, points = {}, {}
        for contact in self._problem.contacts:
            piece, cloud = self._contact(contact, start)
            surfaces[contact.name] = replace(piece, cell_data=_begun(piece.cell_data))
            points[contact.name] = replace(cloud, point_data=_begun(cloud.point_data))
        return taken._replace(number=0, bodies=bodies, surfaces=surfaces, points=points)

    def _bodies(self, u):
        space, bulk = self._problem.space, self._problem.bulk
        blocks, stress = space.mesh.blocks, bulk.stress(u)
        data = {
            "stress": [values for values, _ in stress],
            "equivalent_stress": [equivalent_stress(values) for values, _ in stress],
        }
        data.update(bulk.fields(u))
        strain = bulk.plastic_strain()
        if strain is not None:
            data["equivalent_plastic_strain"] = strain
        points, tables, nodal = space.points, space.cells, {"displacement": space.local.gather(u)}
        for item in self._problem.others:
            nodal.update({name: space.at_nodes(values) for name, values in item.fields_of_nodes().items()})
        numbers = space.mesh.file_nodes[space.mesh_nodes]
        if self._means is not None:
            means = self._means(data, [volume for _, volume in stress])
            nodes, tables = self._means.nodes, self._means.cells
            points, numbers = points[nodes], numbers[nodes]
            nodal = {name: values[nodes] for name, values in nodal.items()}
            nodal.update({f"{name}_smooth": values for name, values in means.items()})
        # by which the pieces of several ranks are put together, where other nodes are in the same place, too
        nodal[NODE_NUMBER] = numbers.astype(np.int32 if space.mesh.n_nodes_total < 2**31 else np.int64)
        if self._estimate is not None:
            data["error_estimate"] = self._estimate.cells
            data["cell_number"] = [block.ids for block in blocks]
        data["body"] = [np.full(len(block.nodes), block.body, dtype=np.int32) for block in blocks]
        data["rank"] = [np.full(len(block.nodes), space.comm.rank, dtype=np.int32) for block in blocks]
        names = [MESHIO_NAMES[(block.cell, space.degree)] for block in blocks]
        cells = [(STORED.get(name, name), table) for name, table in zip(names, tables, strict=True)]
        return Piece(points, [(name, table[:, : CELL_TYPES[name][1]]) for name, table in cells], nodal, data)

    def _contact(self, contact, u):
        """Source facets, and their quadrature points."""
        paths = contact.paths()
        state = {**contact.state(u), **paths}
        return self._surface(contact, state, u, paths), _cloud(state, contact.displacement(u), paths)

    def _surface(self, contact, state, u, more):
        """Source facets with the means of their quadrature points."""
        space, mesh = self._problem.space, self._problem.space.mesh
        source = contact.source
        facet, n = source.facet, len(source.cells)
        area = np.bincount(facet, state["weight"], minlength=n)
        mean = {}
        for name, key in (("contact_pressure", "pressure"), ("gap", "gap"), *zip(more, more, strict=True)):
            mean[name] = np.bincount(facet, state["weight"] * state[key], minlength=n) / area
        mean["status"] = facet_status(facet, state["status"], state["weight"], n)
        mean["area"] = area
        cells, data, first = [], {name: [] for name in mean}, 0
        for facets in (part for name in contact.groups for part in mesh.facet_groups.get(name, [])):
            table = space.facet_nodes(facets)
            cells.append((MESHIO_NAMES[(facets.kind, space.degree)], table))
            for name, values in mean.items():
                data[name].append(values[first : first + len(table)])
            first += len(table)
        nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *(table.ravel() for _, table in cells)]))
        cells = [(kind, np.searchsorted(nodes, table)) for kind, table in cells]
        return Piece(space.points[nodes], cells, {"displacement": space.local.gather(u)[nodes]}, data)


def _begun(data):
    """Fields of the undeformed bodies, from those of a load step: dict of arrays, or of lists of one for each block."""

    def begun(name, array):
        value = BEGIN.get(name, 0.0)
        return array if value is None else np.full_like(array, value)

    return {name: [begun(name, one) for one in values] if isinstance(values, list) else begun(name, values)
            for name, values in data.items()}  # fmt: skip


def _cloud(state, displacement, more):
    keys = ("pressure", "gap", "traction", "normal", "status", "weight", "paired", *more)
    return Piece(state["x"], [], {"displacement": displacement, **{key: state[key] for key in keys}})
