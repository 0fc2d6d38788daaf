"""Marking of how often each cell is to be cut: the fewest cells that bring the error down to a part of what it is.

Meshes of quadrilaterals or hexahedra are halved as a whole, or divided into simplices that are cut where it pays.
Halving all cells keeps them what they are, which for degree 1 have smaller errors than simplices with the same nodes,
and no locking; simplices can be cut where the error is. What the estimates of the cells say of either is compared: the
entries of the tangent that bring the error down as far as the most halvings of a pass do, whatever the target.
"""

from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.mesh.refinement.simplices import WISHED
from pcontact.mesh.refinement.split import folded
from pcontact.runtime import log
from pcontact.runtime.petsc import MPI

# [bisections per dimension] Of a cell at once: three make it an eighth as long. From: estimates of a coarse mesh know
# only so much.
AT_ONCE = 3
# [-] Growth of the number of cells that is enough for one pass, where the rate is not known yet at which the error
# falls, and where the error cannot be had at once. From: whatever the target, the first meshes are the same then, and a
# smaller target ends with no larger error; all passes together take a seventh more than the last one.
LEAP = 2.0**AT_ONCE
# [-] Growth of the cells from one pass to the next at least. From: scenes of seeds 20 to 30 at 5 %; with 1.5 more
# meshes just miss their target, with 3 all loops together take a tenth longer.
LEAST_GROWTH = 2.0
# [-] Part of their squares by which cells that are alike differ. From: a mesh and its mirror image, whose squares
# differ by what the solver leaves.
SAME = 1e-4
# [-] Cells per cell on a singular edge that are made by a halving of it; and the square of a cell beside it over that
# of one on it. From: bisection of a tetrahedron into eight, two of which have the edge; a stiff cube on a block.
COST, BESIDE = 7.0, 0.004
# [-] The neighbours of the cells that are cut follow: unknowns over those expected, before it has been seen.
# From: named_error.py.
FOLLOWERS = 1.4
# [halvings] Rounding.
ROUNDED = 1e-9


class Cuts(NamedTuple):
    """Refinement that is asked of the cells.

    Attributes
    ----------
    more : ndarray (n,) of int
        Bisections of the cells of this rank; below zero: it may be larger by so many.
    part : float
        Of the error that is expected to be left.
    growth : float
        Cells that are expected over those of now.
    deep : ndarray (n,) or None
        Bisections more of the parts of cells on singular edges that touch these; None: there are none.
    within : ndarray (n,) or None
        Sizes of cells, from which distance to the edge on other parts of them have more bisections.
    """

    more: np.ndarray
    part: float
    growth: float
    deep: np.ndarray | None = None
    within: np.ndarray | None = None


class Contributions(NamedTuple):
    """Contributions of the cells of this rank to the error.

    Attributes
    ----------
    squares : ndarray (n,)
        Squared contributions.
    degree : int or ndarray (n,) of int
        Of the displacement: of all cells, or of each.
    dim : int
        Of space.
    count : ndarray (n,) or None
        Of cells that have these squares each; None: one.
    power : ndarray (n,) or None
        With which the squares around a vertex of the cell fall, see `pcontact.adapt.singularities`; 2 p + d, and None,
        where the solution is smooth.
    whole : bool
        Whether all cells are halved together.
    level : ndarray (n,) of int or None
        Bisections that have made the cells, and may be taken back; None: none.
    touches : ndarray (n,) of int or None
        See :class:`pcontact.adapt.edges.Edges`; None: there are no singular edges.
    shared : ndarray (n,) or None
        Of cells that touch edges, the squares that they are cut for.
    """

    squares: np.ndarray
    degree: int
    dim: int
    count: np.ndarray | None = None
    power: np.ndarray | None = None
    whole: bool = False
    level: np.ndarray | None = None
    touches: np.ndarray | None = None
    shared: np.ndarray | None = None


def degrees(space, whole=False):
    """Degree of the displacement of all cells, or (n,) of each cell of this rank where bodies differ: where all cells
    are cut alike (`whole`) the lowest, with which the error falls in the end."""
    if not space.lower:
        return space.degree
    own = [np.full(len(block.nodes), space.degree_of(block)) for block in space.mesh.blocks]
    return 1 if whole else np.concatenate([np.zeros(0, np.int64), *own])


def next_cuts(comm, errors, part, most=np.inf, known=False):
    """Cuts for the next mesh: as of :func:`cuts`, at most `LEAP` where the rate is not `known`. *Collective.*"""
    most = most if known else min(most, LEAP)
    return halvings(errors, part, most) if errors.whole else cuts(comm, errors, part, most, LEAST_GROWTH)


def halvings(errors, part, most=np.inf):
    """Cuts of all cells alike that leave a part of the error, as of :func:`cuts`; of growth 1 where one halving is too
    much."""
    number = max(int(np.ceil(np.log2(1.0 / part) / errors.degree - ROUNDED)), 1)
    while number and 2.0 ** (errors.dim * number) > most:
        number -= 1
    more = np.full(len(errors.squares), errors.dim * number)
    return Cuts(more, 0.5 ** (errors.degree * number), 2.0 ** (errors.dim * number))


def cuts(comm, errors, part, most=np.inf, least=0.0):
    """Cuts that leave a part of the error. *Collective.*

    A cell's part of the squared error falls with 2^(-2 p / d) per bisection, the cells double: the fewest have sizes in
    proportion to estimate^(-2 / (2 p + d)). Around a point toward which the solution is singular, squares of cells of
    size h at a distance r go with h^(2 p + d) r^(e - 2 p - d), and the fewest cells have sizes in proportion to
    r^(1 - e / (2 p + d)): the parts of a cell there are more by a geometric series. Cells that earlier meshes have made
    smaller than that become larger again, by whole bisections, so that the next mesh need not cut them once more.

    Parameters
    ----------
    comm : MPI.Comm
    errors : Contributions
    part : float
        Of the error, to be left.
    most, least : float
        Growth of the number of cells at most, and at least where that allows it.

    Returns
    -------
    Cuts
    """
    squares, degree, dim, count, power, _, level, touches, _ = errors
    number = np.ones(len(squares)) if count is None else count
    # cells that grow smaller toward a point, over those that are alike
    series = np.ones(len(squares))
    if power is not None and touches is None:
        singular = power < 2.0 * degree + dim
        series = np.where(singular, 1.0 / (1.0 - 0.5 ** (dim * power / (2.0 * degree + dim))), 1.0)
    back = 0 if level is None else -np.minimum(level, dim)
    total, count, low, high = _sums(comm, squares, number)
    if total == 0.0:
        return Cuts(np.zeros(len(squares), dtype=np.int64), 1.0, 1.0)
    most_degree = comm.allreduce(int(np.max(degree, initial=1)), op=MPI.MAX)

    def tried(scale):
        with np.errstate(divide="ignore"):
            wanted = dim / (2.0 * degree + dim) * np.log2(squares / scale)
        more = np.clip(np.where(wanted > 0.0, np.rint(wanted), np.ceil(wanted)), back, AT_ONCE * dim).astype(np.int64)
        if touches is not None:
            return _toward_edges(comm, errors, scale, more, (total, count))
        parts = np.where(more > 0, number * series, number)
        own, both = np.array([(parts * squares) @ 0.25 ** (degree * more / dim), parts @ 2.0**more]), np.empty(2)
        comm.Allreduce(own, both, op=MPI.SUM)
        left, cells = both
        return Cuts(more, float(np.sqrt(left / total)), float(cells / count))

    # cells as large as this become as small as may be; below, those with smaller contributions catch up
    cut_most = high / 2.0 ** ((2.0 * most_degree + dim) * AT_ONCE)
    low, high = low / 4.0 ** ((most_degree + dim) * AT_ONCE), 2.0 * high
    at_low, at_high = tried(low), tried(high)
    while high > (1.0 + SAME) * low:
        middle = np.sqrt(low * high)
        found = tried(middle)
        enough = found.part < part and found.growth >= least
        if enough or found.growth > most or (middle < cut_most and found.growth > LEAP):
            low, at_low = middle, found
        else:
            high, at_high = middle, found
    return at_high if at_low.growth > most else at_low


def _toward_edges(comm, errors, scale, more, sums):
    """Cuts of a scale, the squares that other cells are to have, where cells have singular edges; `more` (n,):
    bisections of others, `sums`: sum of the squares, and number of the cells of all ranks. *Collective.*

    A halving of the cells on an edge leaves 2^(1 - e) of their squares, of which there are twice as many, and makes
    `COST` cells: with the fewest cells, theirs are so much larger than those of others.
    """
    squares, dim, on = errors.squares, errors.dim, np.flatnonzero(errors.touches)
    degree = np.broadcast_to(errors.degree, len(squares))
    power, smooth, edge = errors.power[on], 2.0 * degree[on] + dim, errors.touches[on] == 2
    with np.errstate(divide="ignore"):
        over = np.maximum(np.log2(errors.shared[on] / (COST * scale)), 0.0)
    deepest = WISHED // dim
    halvings = np.minimum(over / power, deepest)
    left = np.where(edge, 2.0**halvings, 1.0) * 2.0 ** (-halvings * power)
    for k in range(deepest):
        # beside those that have been halved k times
        beside = np.minimum(BESIDE * 2.0 ** (-k * power), 2.0**-over / COST)
        left += (COST - 1.0) * 2.0**k * beside * np.clip(halvings - k, 0.0, 1.0)
    outer = dim / smooth * (over + np.log2(COST * BESIDE))
    first = np.maximum(np.rint(outer), 0.0).astype(np.int64)
    more, parts, rest = more.copy(), 2.0**more, 0.25 ** (degree * more / dim)
    more[on], rest[on] = first, left
    parts[on] = 2.0**first * np.where(edge, COST * 2.0**halvings - COST + 1.0, COST * halvings + 1.0)
    deep, within = np.zeros(len(squares)), np.ones(len(squares))
    deep[on] = np.where(edge, np.maximum(dim * halvings - first, 0.0), 0.0)
    within[on] = 2.0 ** ((outer - first) / (dim * (1.0 - power / smooth)))
    own, both = np.array([squares @ rest, parts.sum()]), np.empty(2)
    comm.Allreduce(own, both, op=MPI.SUM)
    return Cuts(more, float(np.sqrt(both[0] / sums[0])), float(both[1] / sums[1]), deep, within)


def _sums(comm, squares, number):
    """Sum, count, least positive and largest of the squares of all ranks. *Collective.*"""
    total, count = comm.allreduce(np.array([number @ squares, number.sum()]), op=MPI.SUM)
    least = comm.allreduce(float(np.min(squares[squares > 0.0], initial=np.inf)), op=MPI.MIN)
    return float(total), float(count), least, comm.allreduce(float(np.max(squares, initial=0.0)), op=MPI.MAX)


# [-] By dimension and degree: error that is named with simplices over that with the cells they were made of, with the
# same nodes; and entries of the tangent, the same. From: drivers/studies/cells.py.
MEASURED = {(2, 1): (1.75, 0.8), (2, 2): (1.15, 0.73), (3, 1): (1.7, 0.62), (3, 2): (1.35, 0.49)}
# simplices of a cell, by its vertices and dimension
PARTS = {(3, 2): 1, (4, 2): 2, (4, 3): 1, (5, 3): 2, (6, 3): 3, (8, 3): 6}
NAMES = {2: "triangles", 3: "tetrahedra"}
_PLURALS = {"tetrahedron": "tetrahedra", "hexahedron": "hexahedra", "hexahedron20": "hexahedra with 20 nodes",
            "quadrilateral8": "quadrilaterals with 8 nodes"}  # fmt: skip


def parts_of(mesh):
    """Simplices (n_cells,) that the cells of this rank are divided into."""
    counts = [np.full(len(block.nodes), PARTS[CELLS[block.cell].n_vertices, mesh.dim]) for block in mesh.blocks]
    return np.concatenate([np.zeros(0), *counts])


def of_parts(squares, parts, dim, degree):
    """Squares (n_cells,) of each of the simplices that cells are divided into; degree: of all, or (n_cells,)."""
    more = np.where(np.asarray(degree) == 1, MEASURED[dim, 1][0], MEASURED[dim, 2][0])
    return more**2 * squares / parts


def locking(scene, degree):
    """The body whose triangles or tetrahedra of a degree would be too stiff, or None."""
    if scene.mesh.kinematics == "plane_stress":
        return None
    for body in scene.bodies:
        low = degree == 1 or scene.lower(body)
        if low and (scene.locks(body) or scene.yields(body)):
            return body.region
    return None


def said_of(kinds):
    """Kinds of cells in words."""
    return ", ".join(_PLURALS.get(kind, f"{kind}s") for kind in sorted(kinds))


class Choice:
    """The choice, which is made again after each pass on cells that are no simplices.

    Parameters
    ----------
    comm : MPI.Comm

    Attributes
    ----------
    made : dict or None
        For the report: ``chosen``, ``why``, ``entries`` of the tangents of a mesh with a part of the error, by what is
        chosen.
    """

    def __init__(self, comm):
        self._comm, self.made = comm, None

    def divides(self, scene, space, last, squares, fits=True):
        """Return True if a mesh of cells that can be halved is divided, from what its cells have in the squared error
        of the last pass; `fits`: whether the budget allows the cells to be halved. *Collective.*"""
        mesh, dim, degree = space.mesh, space.dim, last.degree
        stiff, name = locking(scene, degree), NAMES[dim]
        kinds = self._kinds(mesh)
        if stiff is not None:
            return self._take(False, kinds, name, f"{name} of degree {degree} would be too stiff in {stiff} (locking)")
        own, parts, (more, ratio) = degrees(space), parts_of(mesh), MEASURED[dim, degree]
        errors = Contributions(of_parts(squares, parts, dim, own), own, dim, parts)
        part = 0.5 ** float(AT_ONCE * np.min(degrees(space, True)))
        grown = cuts(self._comm, errors, part / more).growth * FOLLOWERS
        entries = {kinds: 2.0 ** (AT_ONCE * dim) * last.entries, name: ratio * grown * last.entries}
        cheaper = entries[name] < entries[kinds] or not fits
        if cheaper and folded(mesh):
            return self._take(False, kinds, name, f"some {name} in curved cells would fold over", entries)
        if not fits:
            return self._take(True, kinds, name, f"the budget does not allow all {kinds} to be halved", entries)
        why = (f"{part:.2g} times the error takes {entries[kinds]:.2g} entries of the tangent with all {kinds} halved, "
               f"about {entries[name]:.2g} with {name} cut where it pays")  # fmt: skip
        return self._take(cheaper, kinds, name, why, entries)

    def once(self, mesh):
        """Note that one halving is enough, and return that no cell is divided. *Collective.*"""
        return self._take(False, self._kinds(mesh), NAMES[mesh.dim], "one halving is enough")

    def _kinds(self, mesh):
        kinds = {block.cell for block in mesh.blocks if len(block.nodes)}
        return said_of(set().union(*self._comm.allgather(kinds)))

    def _take(self, divides, kinds, name, why, entries=None):
        chosen = name if divides else kinds
        if self.made is None or (self.made["chosen"], self.made["why"]) != (chosen, why):
            log.info("%s: %s", chosen, why)
        self.made = {"chosen": chosen, "why": why} | ({} if entries is None else {"entries": entries})
        return divides

    def must(self, kinds, dim):
        """Note that a mesh is divided because cells of some kinds cannot be judged, or not be halved."""
        self._take(True, "", NAMES[dim], f"error estimate and halving do not know all of {said_of(kinds)}")
