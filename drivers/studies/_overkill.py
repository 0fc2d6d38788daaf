"""A solution on a much finer mesh as a function of position: what others are measured against."""

import numpy as np

from drivers._common import contact_points
from pcontact.contact.search.tree import build_tree
from pcontact.element.reference import shape, shape_gradient
from pcontact.runtime.jit import njit
from pcontact.runtime.petsc import MPI

CANDIDATES = 64  # cells that are tried per point: boxes of tetrahedra overlap
SLACK = 0.05  # by which the boxes of the cells are larger than these: points of a coarser, straighter boundary
ITERATIONS = 12
CLOSE = 1e-9
NEAREST = 10**7  # distances of middles that are taken at once


@njit
def _near_cells(x, lower, upper, child, first, last, order, cell_lower, cell_upper, found):
    """Cells whose boxes hold each point, at most as many as there are columns, those first whose middle is near it; -1
    where there are fewer."""
    stack, away = np.empty(128, dtype=np.int64), np.empty(found.shape[1])
    for q in range(x.shape[0]):
        count, depth = 0, 1
        stack[0] = 0
        while depth > 0:
            depth -= 1
            node = stack[depth]
            inside = True
            for k in range(x.shape[1]):
                inside = inside and lower[node, k] <= x[q, k] <= upper[node, k]
            if not inside:
                continue
            if child[node] >= 0:
                stack[depth], stack[depth + 1] = child[node], child[node] + 1
                depth += 2
                continue
            for i in range(first[node], last[node]):
                inside, off = count < found.shape[1], 0.0
                for k in range(x.shape[1]):
                    inside = inside and cell_lower[i, k] <= x[q, k] <= cell_upper[i, k]
                    off = max(off, abs(2.0 * x[q, k] - cell_lower[i, k] - cell_upper[i, k])
                              / max(cell_upper[i, k] - cell_lower[i, k], 1e-300))  # fmt: skip
                if inside:
                    at = count
                    while at > 0 and away[at - 1] > off:
                        found[q, at], away[at] = found[q, at - 1], away[at - 1]
                        at -= 1
                    found[q, at], away[at] = order[i], off
                    count += 1


def _outside(cell, xi):
    """Return the distances of reference points (n, d) outside of the reference cell; negative inside."""
    if cell in ("triangle", "tetrahedron"):
        return np.maximum(-xi.min(axis=1), xi.sum(axis=1) - 1.0)
    return np.abs(xi).max(axis=1) - 1.0


class _Cells:
    """All cells of one kind in a body, on every rank, and the tree of their boxes."""

    def __init__(self, cell, degree, geometry_degree, corners, values):
        self.cell, self.degree, self.geometry_degree = cell, degree, geometry_degree
        self.x, self.u = corners, values
        low, high = corners.min(axis=1), corners.max(axis=1)
        margin = SLACK * (high - low).max(axis=1, keepdims=True)
        self._tree = build_tree(low - margin, high + margin)

    def _inverse(self, cells, x):
        """Reference coordinates (n, d) of points in cells, by Newton's method from the middle."""
        middle = 1.0 / (x.shape[1] + 1) if self.cell in ("triangle", "tetrahedron") else 0.0
        xi, corners = np.full_like(x, middle), self.x[cells]
        scale = np.ptp(corners, axis=1).max(axis=1)
        for _ in range(ITERATIONS):
            off = np.einsum("na,nad->nd", shape(self.cell, self.geometry_degree, xi), corners) - x
            jacobian = np.einsum("nad,nae->nde", corners, shape_gradient(self.cell, self.geometry_degree, xi))
            # a point far outside of a curved cell need not have coordinates in it
            step = np.linalg.solve(jacobian + 1e-14 * scale[:, None, None] * np.eye(x.shape[1]), off[:, :, None])
            xi = np.clip(xi - step[:, :, 0], -3.0, 3.0)
            if np.all(np.abs(off).max(axis=1) <= CLOSE * scale):
                break
        return xi

    def locate(self, x):
        """Cell, reference coordinates, and how far outside of it (inf: no cell) of points (n, d)."""
        tree, found = self._tree, np.full((len(x), CANDIDATES), -1, dtype=np.int64)
        _near_cells(x, tree.lower, tree.upper, tree.child, tree.first, tree.last, tree.order, tree.facet_lower,
                    tree.facet_upper, found)  # fmt: skip
        cell, best = np.zeros(len(x), dtype=np.int64), np.full(len(x), np.inf)
        xi = np.zeros_like(x)
        for column in found.T:
            some = np.flatnonzero((column >= 0) & (best > 1e-6))
            if not len(some):
                break
            at = self._inverse(column[some], x[some])
            off = _outside(self.cell, at)
            better = off < best[some]
            rows = some[better]
            cell[rows], xi[rows], best[rows] = column[rows], at[better], off[better]
        return cell, xi, best

    def nearest(self, x):
        """The cell whose middle is nearest to each point (n, d), coordinates in it, and the distance of its middle."""
        middles = self.x.mean(axis=1)
        cell = np.concatenate([
            np.argmin(((some[:, None] - middles) ** 2).sum(axis=2), axis=1)
            for some in np.array_split(x, len(x) * len(middles) // NEAREST + 1)
        ])  # fmt: skip
        return cell, self._inverse(cell, x), np.linalg.norm(middles[cell] - x, axis=1)

    def values(self, cell, xi):
        """Displacement (n, d) and its gradient (n, d, d)."""
        u, corners = self.u[cell], self.x[cell]
        jacobian = np.einsum("nad,nae->nde", corners, shape_gradient(self.cell, self.geometry_degree, xi))
        slope = np.einsum("nae,ned->nad", shape_gradient(self.cell, self.degree, xi), np.linalg.inv(jacobian))
        return np.einsum("na,nad->nd", shape(self.cell, self.degree, xi), u), np.einsum("nai,naj->nij", u, slope)


class Overkill:
    """Displacement in all bodies, and pressure along the contact, of a finished run. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        Its solution is gathered on every rank.

    Attributes
    ----------
    points : dict or None
        Values at the contact's quadrature points, on every rank, see :func:`drivers._common.contact_points`; None
        without contact.
    """

    def __init__(self, simulation):
        space, comm = simulation.problem.space, simulation.comm
        nodal, self._bodies, parts, self._known = space.local.gather(simulation.stepper.u), {}, {}, {}
        for number, block in enumerate(space.mesh.blocks):
            table, geometry_degree = space.mesh.geometry_nodes(block)
            key = (block.body, block.cell, geometry_degree)
            parts.setdefault(key, []).append((space.mesh.points[table], nodal[space.cells[number]]))
        for key in sorted(set().union(*comm.allgather(set(parts)))):
            body, cell, geometry_degree = key
            pieces = [piece for part in comm.allgather(parts.get(key, [])) for piece in part]
            corners, values = (np.concatenate([piece[k] for piece in pieces]) for k in (0, 1))
            cells = _Cells(cell, space.degree, geometry_degree, corners, values)
            self._bodies.setdefault(body, []).append(cells)
        contact = bool(simulation.problem.contacts)
        self.points = comm.bcast(contact_points(simulation), root=0) if contact else None

    def __call__(self, x, body):
        """Displacement (n, d) and its gradient (n, d, d) at points x (n, d) of a body; what was asked is kept."""
        x = np.ascontiguousarray(x)
        key = (body, x.tobytes())
        key = (body, len(x), hash(key))
        if key not in self._known:
            self._known[key] = self.at(x, body)
        return self._known[key]

    def at(self, x, body, near=False):
        """The same, and nothing is kept. `near`: points outside of all cells are taken into the nearest one."""
        u, slope = np.zeros_like(x), np.zeros((*x.shape, x.shape[1]))
        best = np.full(len(x), np.inf)
        for cells in self._bodies[body]:
            cell, xi, off = cells.locate(x)
            better = off < best
            u[better], slope[better] = cells.values(cell[better], xi[better])
            best[better] = off[better]
        lost = np.flatnonzero(~np.isfinite(best)) if near else []
        for cells in self._bodies[body] if len(lost) else ():
            cell, xi, far = cells.nearest(x[lost])
            better = far < best[lost]
            rows = lost[better]
            u[rows], slope[rows] = cells.values(cell[better], xi[better])
            best[rows] = far[better]
        if not np.all(np.isfinite(best)):
            raise RuntimeError(f"{np.sum(~np.isfinite(best))} points are outside of the overkill mesh")
        return u, slope


def total(comm, value):
    """Sum over the ranks. *Collective.*"""
    return float(comm.allreduce(float(value), op=MPI.SUM))
