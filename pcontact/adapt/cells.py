"""Whether a mesh of quadrilaterals or hexahedra is halved as a whole, or divided into simplices that are cut where it
pays.

Halving all cells keeps them what they are, which for degree 1 have smaller errors than simplices with the same nodes,
and no locking; simplices can be cut where the error is. What the estimates of the cells say of either is compared: the
entries of the tangent that bring the error down as far as the most halvings of a pass do, whatever the target.
"""

import numpy as np

from pcontact.adapt.budget import FOLLOWERS
from pcontact.adapt.mark import AT_ONCE, Contributions, cuts, degrees
from pcontact.element.reference import CELLS
from pcontact.mesh.refinement.split import folded
from pcontact.runtime import log

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
        """Whether a mesh is divided. *Collective.*

        Parameters
        ----------
        scene : pcontact.scene.model.Scene
        space : pcontact.space.space.Space
            On a mesh of cells that can be halved.
        last : pcontact.adapt.passes.Pass
            On it.
        squares : ndarray (n_cells,)
            What its cells have in the squared error.
        fits : bool
            Whether the budget allows the cells to be halved.

        Returns
        -------
        bool
        """
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
