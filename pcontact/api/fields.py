"""Fields at the end of a load step as arrays, of this rank or of all."""

from __future__ import annotations

from typing import Any

import numpy as np

from pcontact.api.tables import Named, html, lost
from pcontact.io.fields import NODE_NUMBER
from pcontact.mesh.raw import distinct


class Fields:
    """Fields at the end of a load step, with d the dimension of space. Arrays are not to be written to.

    Attributes
    ----------
    number, time : int, float
        Of the load step.
    points : ndarray (n, d)
        Coordinates of the nodes in the undeformed state [length].
    node_numbers : ndarray (n,)
        Place of each node in the mesh file, from 0, without nodes that no cell has; nodes that the program has added
        to cells of degree 1 come after.
    cells : list of (str, ndarray (nc, nn))
        Blocks of cells: the type as meshio calls it, nodes as rows of `points`, in VTK's order.
    cell_numbers : ndarray (n_cells,)
        Place of each cell in the mesh file, block after block.
    point_data : dict of str to ndarray (n,) or (n, k)
        ``displacement`` (n, d), with ``smooth = true`` the fields of the cells averaged, ``stress_smooth``, ...
    cell_data : dict of str to ndarray (n_cells,) or (n_cells, k)
        ``stress`` (components XX, YY, ZZ, XY, YZ, XZ), ``equivalent_stress``, ``equivalent_plastic_strain`` where
        bodies may yield, ``body`` (number in the scene), ``rank``, ...
    contacts : dict of str to dict of str to ndarray
        By the name of the contact, at its quadrature points: ``x`` and ``displacement`` (np, d), ``pressure``, ``gap``,
        ``traction`` (np, d), ``normal``, ``status`` (0 open, 1 stick, 2 slip), ``weight`` (area), ``paired``,
        ``number`` (the same on any ranks).
    """

    def __init__(
        self, number: int, time: float, points: np.ndarray, cells: list[tuple[str, np.ndarray]], data: tuple[Any, ...],
        contacts: dict[str, dict[str, np.ndarray]],
    ) -> None:  # fmt: skip
        self.number, self.time, self.points, self.cells = number, time, points, cells
        self.contacts = Named({name: Named(one) for name, one in contacts.items()})
        self.node_numbers, self.cell_numbers = data[:2]
        self.point_data, self.cell_data = Named(data[2]), Named(data[3])

    @classmethod
    def of(cls, taken: Any) -> Fields:
        """Those that a run has at hand.

        Parameters
        ----------
        taken : pcontact.io.snapshot.Taken
        """
        piece, contacts = taken.bodies, dict[str, dict[str, np.ndarray]]()
        point_data = dict(piece.point_data)
        numbers = point_data.pop(NODE_NUMBER)
        cell_data = {name: np.concatenate(arrays) for name, arrays in piece.cell_data.items()}
        for name, cloud in taken.points.items():
            contacts[name] = {"x": cloud.points, **cloud.point_data, "number": taken.point_numbers[name]}
        found = cls(
            taken.number, taken.time, piece.points, list(piece.cells),
            (numbers, np.concatenate(taken.cell_numbers), point_data, cell_data), contacts,
        )  # fmt: skip
        found._lock()
        return found

    def _lock(self) -> None:
        """Views that cannot be written to: the run goes on with the same arrays."""
        self.points, self.node_numbers, self.cell_numbers = map(
            _locked, (self.points, self.node_numbers, self.cell_numbers)
        )
        self.cells = [(kind, _locked(table)) for kind, table in self.cells]
        for data in (self.point_data, self.cell_data, *self.contacts.values()):
            data.update({name: _locked(array) for name, array in data.items()})

    def __getitem__(self, name: str) -> np.ndarray:
        """A field of the nodes or of the cells by its name."""
        for data in (self.point_data, self.cell_data):
            if name in data:
                return data[name]
        raise lost(name, [*self.point_data, *self.cell_data])

    def __repr__(self) -> str:
        fields, contacts = ", ".join([*self.point_data, *self.cell_data]), ", ".join(self.contacts) or "none"
        return (
            f"<Fields of load step {self.number}, time {self.time:g}: {len(self.points)} nodes, "
            f"{len(self.cell_numbers)} cells; fields {fields}; contacts {contacts}>"
        )

    def _repr_html_(self) -> str:
        data = [("nodes", self.point_data), ("cells", self.cell_data)]
        data += [(f"points of {name}", one) for name, one in self.contacts.items()]
        rows = [
            [name, place, " x ".join(map(str, values.shape)), *(extremes(values))]
            for place, some in data for name, values in some.items()
        ]  # fmt: skip
        return f"<p>load step {self.number}, time {self.time:g}</p>" + html(
            ("field", "of the", "shape", "least", "largest"), rows
        )

    @property
    def displacement(self) -> np.ndarray:
        """Displacement of the nodes (n, d) [length]."""
        return self.point_data["displacement"]

    @property
    def stress(self) -> np.ndarray:
        """Mean stress of the cells (n_cells, 6): XX, YY, ZZ, XY, YZ, XZ [stress]."""
        return self.cell_data["stress"]

    def gather(self, comm: Any, everywhere: bool = False) -> Fields | None:
        """Those of all ranks in one, see :meth:`Run.gather`. *Collective.*"""
        parts = comm.allgather(self) if everywhere else comm.gather(self)
        return None if parts is None else _joined(parts)


def extremes(values: np.ndarray) -> list[Any]:
    """Least and largest entry of an array; none of an empty one."""
    return [float(np.min(values)), float(np.max(values))] if values.size else [None, None]


def _locked(array: Any) -> np.ndarray:
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view


def _joined(parts: list[Fields]) -> Fields:
    """The parts of all ranks in one: each node once, nodes, cells and points by their numbers."""
    numbers = np.concatenate([part.node_numbers for part in parts])
    bodies = np.concatenate([_body_of_nodes(part) for part in parts])
    kept, place = distinct(numbers, bodies)
    point_data = {name: np.concatenate([part.point_data[name] for part in parts])[kept] for name in parts[0].point_data}
    points = np.concatenate([part.points for part in parts])[kept]
    cells, rows = _joined_cells(parts, place)
    cell_numbers = np.concatenate([part.cell_numbers for part in parts])
    filled = [part for part in parts if len(part.cell_numbers)] or parts[:1]
    cell_data = {name: np.concatenate([part.cell_data[name] for part in filled])[rows] for name in filled[0].cell_data}
    contacts = {name: _joined_points([part.contacts[name] for part in parts]) for name in parts[0].contacts}
    data = numbers[kept], cell_numbers[rows], point_data, cell_data
    return Fields(parts[0].number, parts[0].time, points, cells, data, contacts)


def _body_of_nodes(part: Fields) -> np.ndarray:
    """Return what tells nodes of one number apart: bodies that share them have their own where fields are averaged."""
    body, first = np.zeros(len(part.points), dtype=np.int64), 0
    if not any(name.endswith("_smooth") for name in part.point_data):
        return body
    for _, table in part.cells:
        body[table] = part.cell_data["body"][first : first + len(table), None]
        first += len(table)
    return body


def _joined_cells(parts: list[Fields], place: np.ndarray) -> tuple[list[tuple[str, np.ndarray]], np.ndarray]:
    """One block for each type, by the numbers of the cells, and their rows among the cells of all ranks."""
    blocks: dict[str, list[Any]] = {}
    node = cell = 0
    for part in parts:
        for kind, table in part.cells:
            blocks.setdefault(kind, []).append((place[node + table], np.arange(cell, cell + len(table))))
            cell += len(table)
        node += len(part.points)
    numbers = np.concatenate([part.cell_numbers for part in parts])
    cells, rows = [], []
    for kind, found in blocks.items():
        tables, own = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
        order = np.argsort(numbers[own], kind="stable")
        cells.append((kind, tables[order]))
        rows.append(own[order])
    return cells, np.concatenate(rows)


def _joined_points(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Quadrature points of all ranks, by their numbers."""
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.argsort(joined["number"], kind="stable")
    return {name: array[order] for name, array in joined.items()}
