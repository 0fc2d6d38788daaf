"""The fields of the last load step that converged, as arrays of this rank."""

import time as clock
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact.element.reference import MESHIO_NAMES
from pcontact.io.names import BEGIN
from pcontact.io.parts import NODE_NUMBER, Cloud, Piece
from pcontact.io.smooth import NodeMeans
from pcontact.io.vtu import CELL_TYPES, STORED
from pcontact.material.elastic import equivalent_stress
from pcontact.runtime.observer import Observer

# status of a point, as files and pictures have it
OPEN, STICK, SLIP = 0, 1, 2


def facet_status(facet, status, weight, n):
    """What most of the closed points of a facet do, by their area: stick or slip; open where none is closed.

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
    points : dict of str to pcontact.io.fields.Cloud
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
            points[contact.name] = replace(cloud, data=_begun(cloud.data))
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
    return Cloud(state["x"], {"displacement": displacement, **{key: state[key] for key in keys}})
