"""Effectivity: the estimate over the error, as the meshes of a loop show it, and safety factors for what they do not.

With u_1 on a mesh and u_2 on a finer one, the errors e_1 and e_2 have  e_1^2 = e_2^2 + |u_2 - u_1|^2  if the solutions
are projections. Of estimates that are the same part k of the error then

    k^2 = (estimate_1^2 - estimate_2^2) / |u_2 - u_1|^2

Toward singular points, where bodies are orthotropic, or yield without hardening, this part is less than local problems
promise: what one cell lacks is error in cells far from it, which no residual of theirs tells.

The dual problem of a quantity has the tangent of the last load step alone, in which bodies that yield may be as soft as
can be. Dual problems of two meshes foretell how the quantity changes from one to the other: where they have not, the
change itself counts as well. Of errors that fall to a part f of what they were, a change of (1 - f) e_1 = e_1 - e_2
leaves e_2 = f / (1 - f) of it. They fall with the square of the error of the displacement, but no faster than on the
best meshes for smooth solutions, with N^(-2 p / d).
"""

from typing import NamedTuple

import numpy as np

from pcontact.adapt.secondary import beyond
from pcontact.runtime.petsc import MPI

# [-] Estimates over each other that count at most, and the part that counts at least. From: the difference of two that
# hardly differ says nothing.
ALIKE, LEAST = 0.8, 0.25
# [-] Part of the change of a quantity by which the one that dual problems have foretold may be off, and of the squared
# change of the displacement that load steps may have. From: chosen, half: then the estimates are right to a factor of
# two.
AGREE = 0.5
# [-] Safety factors: least and largest effectivity, by the dimension and degree, of meshes that none has been compared
# with; of a pressure in L2, and of quantities by dual problems. From: all but one (0.48, one that yields) of 20 first
# meshes of degree 2 in the plane whose error is below 10 %, of scenes of seeds 0 to 67 (`drivers/studies/
# random_errors.py`), have 0.55 at least; the least values of docs/estimate.md for degree 1 and in space.
UNSEEN = {(2, 1): (0.8, 1.25), (2, 2): (0.55, 1.1), (3, 1): (0.9, 2.4), (3, 2): (0.8, 1.6)}
PRESSURE, QUANTITY = (0.6, 2.5), (0.4, 2.0)
# [-] The least effectivity of a mesh of degree 2 over that which it shows with the one before. From: all but one (0.56)
# of 88 such meshes of scenes of seeds 0 to 97 have more, and so 95 % of all with 94 % certainty (order statistics). It
# is near one where the estimate has fallen little; where it has fallen to less than half, both show what the coarser
# one has. Of degree 1, in the plane, 33 have 0.99 at least: `UNSEEN` is enough.
SEEN = 0.6
# [-] The same of meshes that none has been compared with, where bodies yield. From: Hill's cylinder, 0.62 to 0.64.
YIELDING = 0.6


class Range(NamedTuple):
    """Estimate over error.

    Attributes
    ----------
    least, most : float
    words : str
        Of which scenes.
    dim : int
        Of space.
    """

    least: float
    most: float
    words: str
    dim: int


def unseen(space):
    """What is known of estimates of the energy norm on a mesh that none has been compared with. *Collective.*"""
    degree = min([space.degree, *(space.degree_of(block) for block in space.mesh.blocks)])
    words = f"degree {space.degree} in {'the plane' if space.dim == 2 else 'space'}"
    return Range(*UNSEEN[space.dim, space.comm.allreduce(degree, op=MPI.MIN)], words, space.dim)


def part_of(coarse, fine, change):
    """The part of the error that estimates on a coarse and a fine mesh are, at most 1, from the energy norm of the
    change of the displacements."""
    if not (coarse > 0.0 and change > 0.0):
        return 1.0
    return float(np.clip(coarse * np.sqrt(1.0 - min(fine / coarse, ALIKE) ** 2) / change, LEAST, 1.0))


def between(simulation, before, coarse, steps=0.0):
    """The part that the last two passes have seen, None where load steps may have changed as much as meshes, and the
    energy norm of what meshes have changed [sqrt(energy)]. *Collective.*

    `simulation` is that of the finer mesh, `before` (n_owned, d) and `coarse` are displacement and estimate on the
    coarser one. Errors of load steps do not only become smaller when there are more of them: each step leaves its own
    trace in bodies that yield, where the edge of the contact was at its end. `steps`: those of both, where these are
    others.
    """
    size = simulation.error_estimate.norm(beyond(simulation, before.ravel()))
    if steps**2 > AGREE * size**2:
        return None, size
    change = float(np.sqrt(size**2 - steps**2))
    return part_of(coarse, simulation.error_estimate.over_steps, change), change


class State(NamedTuple):
    """A mesh and its solution, as far as quantities are told by them.

    Attributes
    ----------
    unknowns, degree, dim : int
    estimate : float
        Of the energy norm.
    value : float
        Of the quantity.
    left, dual : float
        The error that it is thought to have, and that of the dual problem.
    """

    unknowns: int
    degree: int
    dim: int
    estimate: float
    value: float
    left: float = 0.0
    dual: float = 0.0

    @classmethod
    def of(cls, simulation, value):
        """That of a run, and a quantity. *Collective.*"""
        space = simulation.problem.space
        return cls(space.n_dofs, space.degree, space.dim, simulation.error_estimate.over_steps, value)


def fallen(coarse, fine):
    """The error of a quantity on a finer mesh over that on a coarser one (:class:`State`), at most the square of
    `ALIKE`; see the head of this module."""
    square = (fine.estimate / coarse.estimate) ** 2 if coarse.estimate > 0.0 else 0.0
    best = (coarse.unknowns / fine.unknowns) ** (2.0 * fine.degree / fine.dim)
    return min(max(square, best), ALIKE**2)


def left_after(coarse, fine):
    """The error of a quantity on the finer of two meshes, with its sign: of what the change says and of what is left of
    the error on the coarser mesh the larger one, as changes may be small by chance."""
    part = fallen(coarse, fine)
    return max((fine.value - coarse.value) * part / (1.0 - part), coarse.left * part, key=abs)


class Effectivity:
    """Knowledge of the estimates of a loop.

    Parameters
    ----------
    target : pcontact.scene.target.Target

    Attributes
    ----------
    told : str
        What has told the error of the quantity.
    unforeseen : float
        Change of the quantity from the mesh before that its dual problem has not foretold, or of the displacement, in
        the energy norm, from a mesh of the same degree; 0: it has, or there is none.
    """

    def __init__(self, target):
        self._target, self.told, self.unforeseen = target, "", 0.0
        # estimate and degree of the last pass, or its State, and the part that the last pair of meshes has shown
        self._before, self._part = None, None

    def part(self, simulation, watch, steps):
        """The part of the error of the displacement that the estimate is seen to be, and what is known of it beyond
        that: a :class:`Range`. *Collective.*

        `steps`: errors of the load steps of this pass and the last one, where these are others [sqrt(energy)].
        """
        own, space, old = simulation.error_estimate.over_steps, simulation.problem.space, self._before
        self._before = own, space.degree
        begun = None if simulation.begin is None else simulation.begin.at(watch.time)
        self.unforeseen = 0.0
        if old is not None and old[1] == space.degree and begun is not None:
            pair, change = between(simulation, begun, old[0], steps)
            self._part, self.unforeseen = (self._part, 0.0) if pair is None else (pair, change)
        known = unseen(space)
        if self._part is None:
            return YIELDING if simulation.scene.plastic else 1.0, known
        least = SEEN if space.degree == 2 else known.least
        return self._part, Range(least, 1.0 / least, "meshes that have been compared", space.dim)

    def of_quantity(self, dim):
        """Range of the error of the quantity: a :class:`Range`."""
        if self._target.quantity == "pressure":
            return Range(*PRESSURE, "pressure in L2", dim)
        return Range(*QUANTITY, f"{self._target.quantity} by a dual problem", dim)

    def error(self, simulation, found):
        """The error of a quantity, with its sign, from a :class:`pcontact.estimate.goal.GoalError`: what is left of it,
        and what is likely. *Collective.*

        Both are that of the dual problem. Where it has not foretold how the quantity changed from the last mesh, the
        larger one of it and :func:`left_after` is what is left; so where bodies yield, whatever it has foretold, for
        both.
        """
        dual = likely = found.error
        if self._target.quantity == "pressure":
            return dual, likely
        own, old, left = State.of(simulation, found.value), self._before, dual
        self.told, self.unforeseen = "dual problem", 0.0
        if old is not None:
            change, foretold = own.value - old.value, old.dual - dual
            apart = abs(change - foretold) > AGREE * max(abs(change), abs(foretold))
            if simulation.scene.plastic or apart:
                left, self.told = max(dual, left_after(old, own), key=abs), "dual problem and meshes"
                self.unforeseen = abs(change)
        elif simulation.scene.plastic:
            left = dual / YIELDING**2
        likely = left if simulation.scene.plastic else likely
        self._before = own._replace(left=left, dual=dual)
        return left, likely
