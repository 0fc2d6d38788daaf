"""Marking of how often each cell is to be cut: the fewest cells that bring the error down to a part of what it is.

Meshes of quadrilaterals or hexahedra are halved as a whole, or divided into simplices that are cut where it pays.
Halving all cells keeps them what they are, which for degree 1 have smaller errors than simplices with the same nodes,
and no locking; simplices can be cut where the error is. What the estimates of the cells say of either is compared: the
entries of the tangent that bring the error down as far as the most halvings of a pass do, whatever the target.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pcontact import build
from pcontact.element.reference import CELLS
from pcontact.mesh.refinement.refine import HALVED, SIMPLICES, Balance, Refined, refine
from pcontact.mesh.refinement.split import folded, split
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
# [-] The same at most, where the error falls slowly: cells become smaller toward singular points from mesh to mesh, as
# far as they may in any case. From: punches and a cube with sharp edges, whose errors fall by as much in a pass with
# 1.25 and 2, by less with 1.1.
SLOW_GROWTH = 1.25
# [-] Part of their squares by which cells that are alike differ. From: a mesh and its mirror image, whose squares
# differ by what the solver leaves.
SAME = 1e-4
# [-] The neighbours of the cells that are cut follow: unknowns over those expected, before it has been seen.
# From: named_error.py.
FOLLOWERS = 1.4
# [halvings] Rounding.
ROUNDED = 1e-9


class Cuts(NamedTuple):
    """Refinement that is asked of the cells, or of the simplices that each of them is divided into.

    Attributes
    ----------
    more : ndarray (n,) of int
        Bisections of the cells of this rank; below zero: it may be larger by so many.
    part : float
        Of the error that is expected to be left.
    growth : float
        Cells that are expected over those of now.
    divided : bool
        Whether the cells are divided into simplices first.
    """

    more: np.ndarray
    part: float
    growth: float
    divided: bool = False


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
    level : ndarray (n,) of int or None
        Bisections that have made the cells, and may be taken back; None: none.
    """

    squares: np.ndarray
    degree: int
    dim: int
    count: np.ndarray | None = None
    level: np.ndarray | None = None


def degrees(space, whole=False):
    """Degree of the displacement of all cells, or (n,) of each cell of this rank where bodies differ: where all cells
    are cut alike (`whole`) the lowest, with which the error falls in the end."""
    if not space.lower:
        return space.degree
    own = [np.full(len(block.nodes), space.degree_of(block)) for block in space.mesh.blocks]
    return 1 if whole else np.concatenate([np.zeros(0, np.int64), *own])


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
    proportion to estimate^(-2 / (2 p + d)). Toward points where the solution is singular estimates stay large, and the
    cells become smaller from mesh to mesh. Cells that earlier meshes have made smaller than that become larger again,
    by whole bisections, so that the next mesh need not cut them once more.

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
    squares, degree, dim, count, level = errors
    number = np.ones(len(squares)) if count is None else count
    back = 0 if level is None else -np.minimum(level, dim)
    total, count, low, high = _sums(comm, squares, number)
    if total == 0.0:
        return Cuts(np.zeros(len(squares), dtype=np.int64), 1.0, 1.0)
    most_degree = comm.allreduce(int(np.max(degree, initial=1)), op=MPI.MAX)

    def tried(scale):
        with np.errstate(divide="ignore"):
            wanted = dim / (2.0 * degree + dim) * np.log2(squares / scale)
        more = np.clip(np.where(wanted > 0.0, np.rint(wanted), np.ceil(wanted)), back, AT_ONCE * dim).astype(np.int64)
        own = np.array([(number * squares) @ 0.25 ** (degree * more / dim), number @ 2.0**more])
        both = np.empty(2)
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


class Refining:
    """Refines the meshes of a loop: where it pays, or, of cells that are no simplices, as a whole.

    Parameters
    ----------
    comm : MPI.Comm
    settings : pcontact.adapt.settings.Settings
    options : pcontact.runtime.options.Options

    Attributes
    ----------
    whole : bool
        Whether the cells of the last mesh are no simplices.
    choice : pcontact.adapt.mark.Choice
        Of what becomes of them.
    """

    def __init__(self, comm, settings, options):
        self._comm, self._settings, self._options = comm, settings, options
        self.whole, self.choice = False, Choice(comm)

    def first(self, scene):
        """The mesh of the file, divided where it has cells that the estimate does not know, or that nothing halves.
        *Collective.*

        Parameters
        ----------
        scene : pcontact.scene.model.Scene
            Its order becomes 2 where the user does not say, and so many unknowns are few, or simplices of degree 1
            would be too stiff.

        Raises
        ------
        InputError
        """
        said = self._settings.degree.now
        # read as the user says: with a geometry cells are to be curved with either degree
        mesh = build.read(replace(scene, mesh=replace(scene.mesh, order=said)), self._comm, self._options,
                          lambda raw: 2 if self._settings.degree.few(raw.dim, 2**raw.dim * len(raw.points)) else 1)
        own = {block.cell for block in mesh.blocks if len(block.nodes)}
        kinds = set().union(*self._comm.allgather(own))
        self.whole = not kinds <= set(SIMPLICES)
        stiff = locking(scene, 1) if self.whole and not mesh.curved else None
        why = self._settings.degree.few(mesh.dim, mesh.n_nodes_total * (1 if mesh.degree == 2 else 2**mesh.dim))
        if stiff is not None:
            why = f"{NAMES[mesh.dim]} of degree 1 would be too stiff in {stiff} (locking)"
        if said is None and why:
            scene.mesh.order = self._settings.degree.take(2, why)
            mesh = build.read(scene, self._comm, self._options) if mesh.degree == 1 else mesh
        if not self.whole or kinds <= set(HALVED):
            return mesh
        self.choice.must(kinds, mesh.dim)
        self.whole = False
        return split(mesh, (), Balance(*build.balance(scene, self._options))).mesh

    def step(self, space, squares, wanted, most, divided=False):
        """Way to cut the cells of the last pass: :class:`Cuts`. *Collective.*

        `squares` is what they have in the squared error, `wanted` the part of the error in the energy norm to be left
        (where cells are `divided` first, of that of the simplices), `most` the growth of the number of cells at most.
        """
        degree, dim = degrees(space, self.whole and not divided), space.dim
        if divided:
            parts = parts_of(space.mesh)
            errors = Contributions(of_parts(squares, parts, dim, degree), degree, dim, parts)
        else:
            level = None if space.mesh.origin is None else space.mesh.origin.level
            errors = Contributions(squares, degree, dim, level=level)
        if self.whole and not divided:
            return halvings(errors, wanted, most)
        return cuts(self._comm, errors, wanted, most, min(LEAST_GROWTH, most))._replace(divided=divided)

    def cut(self, mesh, step, fields, scene):
        """The next mesh with fields at its nodes, spread over the ranks for a scene: a
        :class:`pcontact.mesh.refinement.refine.Refined`. *Collective.*"""
        balance, more = Balance(*build.balance(scene, self._options)), step.more
        if self.whole and not step.divided:
            for _ in range(round(np.log2(step.growth) / mesh.dim)):
                n = sum(len(block.nodes) for block in mesh.blocks)
                mesh, fields = refine(mesh, np.ones(n, dtype=np.int64), fields, balance)
            return Refined(mesh, fields)
        if step.divided:
            mesh, fields, more = split(mesh, fields, balance, cells=more)
        return refine(mesh, more, fields, balance)
