"""What the change of the solution from one mesh to a finer one says of the estimate, where theory says nothing.

With u_1 on a mesh and u_2 on a finer one, the errors e_1 and e_2 have  e_1^2 = e_2^2 + |u_2 - u_1|^2  if the solutions
are projections. Of estimates that are the same part k of the error then

    k^2 = (estimate_1^2 - estimate_2^2) / |u_2 - u_1|^2

Where bodies yield without hardening, what one cell lacks makes cells far from it flow more, or less, and this part of
the error is in no residual of theirs. The dual problem of a quantity knows nothing of it, either, and has the tangent
of the last load step alone, in which bodies that yield may be as soft as can be. There the error of a quantity is told
by how the quantity changes from mesh to mesh: of errors that fall to a part f of what they were, a change of
(1 - f) e_1 = e_1 - e_2 leaves e_2 = f / (1 - f) of it. They fall with the square of the error of the displacement, but
no faster than on the best meshes for smooth solutions, with N^(-2 p / d). Elsewhere dual problems of two meshes
foretell this change: where they have not, it counts as well.
"""

from typing import NamedTuple

import numpy as np

from pcontact import build
from pcontact.adapt.history import at_nodes
from pcontact.adapt.secondary import beyond, solved
from pcontact.estimate.goal import value
from pcontact.mesh.refinement.refine import Balance, refine
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD

# [-] Estimates over each other that count at most, and the part that counts at least. From: the difference of two that
# hardly differ says nothing.
ALIKE, LEAST = 0.8, 0.25
# [-] Part of the squared change that load steps may have, above which it says nothing of meshes. From: chosen; a ball
# pressed into metal, 160 load steps on one mesh and 406 on the next.
STEPS = 0.5
# [-] Part of the change of a quantity by which the one that dual problems have foretold may be off. From: chosen, half:
# then the estimates are right to a factor of two.
AGREE = 0.5
# [-] The part that is expected before meshes have been compared. From: Hill's cylinder, 0.62 to 0.64.
EXPECTED = 0.6


def part_of(coarse, fine, change):
    """The part of the error that estimates are, at most 1.

    Parameters
    ----------
    coarse, fine : float
        Estimates on both meshes [sqrt(energy)].
    change : float
        Energy norm of the difference of the displacements [sqrt(energy)].
    """
    if not (coarse > 0.0 and change > 0.0):
        return 1.0
    return float(np.clip(coarse * np.sqrt(1.0 - min(fine / coarse, ALIKE) ** 2) / change, LEAST, 1.0))


def between(simulation, before, coarse, steps=0.0):
    """The part that the last two passes have seen; None where load steps may have changed as much as meshes.
    *Collective.*

    Errors of load steps do not only become smaller when there are more of them: each step leaves its own trace in
    bodies that yield, where the edge of the contact was at its end.

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        Of the finer mesh, that has run.
    before : ndarray (n_owned, d)
        Displacement on the coarser mesh [length].
    coarse : float
        The estimate there [sqrt(energy)].
    steps : float
        Errors of the load steps of both, where these are others [sqrt(energy)].
    """
    size = simulation.error_estimate.norm(beyond(simulation, before.ravel()))
    if steps**2 > STEPS * size**2:
        return None
    return part_of(coarse, simulation.error_estimate.over_steps, np.sqrt(size**2 - steps**2))


class Parts(NamedTuple):
    """The parts of the error that pairs of meshes have shown estimates to be.

    Where the estimate has not fallen from one mesh to the other, the coarser one has not seen what the finer one sees,
    as a contact that begins between its nodes: the pair tells of its own estimate, and counts until it is known how the
    finer ones fall. A copper disc between a stamp and an anvil, 1,114, 2,190 and 4,938 unknowns: the estimate rises by
    a sixth, and then falls to two fifths; the parts are 0.25 and 0.47.

    Attributes
    ----------
    fallen, others : float
        The least of those pairs whose estimate has fallen, and of the others since the last of these; 1: none. A mesh
        that has changed the solution little says little.
    known : bool
        Whether there has been any.
    """

    fallen: float = 1.0
    others: float = 1.0
    known: bool = False

    def with_pair(self, part, fell):
        """These and that of a pair whose estimate fell, or did not."""
        if fell:
            return Parts(min(self.fallen, part), 1.0, True)
        return Parts(self.fallen, min(self.others, part), True)

    @property
    def least(self):
        """The part that is counted with."""
        return min(self.fallen, self.others) if self.known else EXPECTED


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
    """The error of a quantity on a finer mesh, over that on a coarser one; see the head of this module.

    Parameters
    ----------
    coarse, fine : State

    Returns
    -------
    float
        At most the square of `ALIKE`.
    """
    square = (fine.estimate / coarse.estimate) ** 2 if coarse.estimate > 0.0 else 0.0
    best = (coarse.unknowns / fine.unknowns) ** (2.0 * fine.degree / fine.dim)
    return min(max(square, best), ALIKE**2)


def left_after(coarse, fine):
    """The error of a quantity on the finer of two meshes, with its sign.

    Of what the change says and of what is left of the error on the coarser mesh the larger one: changes may be small by
    chance.

    Parameters
    ----------
    coarse, fine : State

    Returns
    -------
    float
    """
    part = fallen(coarse, fine)
    return max((fine.value - coarse.value) * part / (1.0 - part), coarse.left * part, key=abs)


def likely_after(coarse, fine):
    """The same as it is expected, not as large as it may be: the mean size of both, with the sign of the change.

    What is left of the error on the coarser mesh was told by meshes that are coarser still. Where cells lie better and
    are no more, the error falls between the squares of the estimates and what so few more unknowns bring.
    """
    part, square = fallen(coarse, fine), (fine.estimate / (coarse.estimate or 1.0)) ** 2
    between = np.sqrt(part * min(square, part))
    change = (fine.value - coarse.value) * between / (1.0 - between)
    return float(np.copysign(0.5 * (abs(change) + abs(coarse.left) * part), change))


def on_halved(simulation, scene, options, found):
    """What is found on the mesh with all cells halved; None where the run there does not converge. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run.
    scene : pcontact.scene.model.Scene
        To be run.
    options : pcontact.runtime.options.Options
    found : callable
        ``found(run, record, before)`` with the simulation there, the record of its last load step and the displacement
        (n_owned, d) of `simulation`.

    Returns
    -------
    object or None
    """
    mesh, space = simulation.mesh, simulation.problem.space
    scene.output.estimate, scene.output.checkpoint, scene.mesh.order = True, False, space.degree
    cells = sum(len(block.nodes) for block in mesh.blocks)
    more, balance = np.full(cells, mesh.dim), Balance(*build.balance(scene, options))
    finer, fields = refine(mesh, more, [at_nodes(space, simulation.stepper.u)], balance)
    try:
        with solved(scene, simulation.comm, simulation.options.said, finer) as (run, record):
            if record is None:
                return None
            own = run.problem.space
            return found(run, record, fields[0][own.mesh_nodes[own.owned_local]])
    except TOLD:
        return None


class Seen:
    """What the meshes of a loop have shown of the estimate.

    Parameters
    ----------
    target : pcontact.scene.target.Target
    settings : pcontact.adapt.settings.Settings
    options : pcontact.runtime.options.Options
    """

    def __init__(self, target, settings, options):
        self._target, self._settings, self._options = target, settings, options
        # estimate and degree of the last pass, or its State, and what part of the error estimates have been seen to be;
        # what has told the error of a quantity
        self._before, self._parts, self.told = None, Parts(), ""

    def part(self, simulation, watch, far, steps):
        """What part of the error of the displacement the estimate is: 1 but where bodies yield. *Collective.*

        Parameters
        ----------
        simulation : pcontact.simulation.Simulation
            That has run.
        watch : pcontact.adapt.history.Watch
        far : bool
            Whether there is another pass, whatever the part: that one tells it, too.
        steps : float
            Errors of the load steps of this pass and the last one, where these are others [sqrt(energy)].
        """
        own, degree = simulation.error_estimate.over_steps, simulation.problem.space.degree
        if not simulation.scene.plastic:
            return 1.0
        old, self._before, pair = self._before, (own, degree), None

        def seen(run, before, coarse, steps=0.0):
            return between(run, before, coarse, steps), run.error_estimate.over_steps <= ALIKE * coarse

        if (old is None or old[1] != degree) and far:
            return EXPECTED
        if old is None or old[1] != degree:
            pair = self._on_halved(simulation, lambda run, _, before: seen(run, before, own))
        elif simulation.begin.at(watch.time) is not None:
            pair = seen(simulation, simulation.begin.at(watch.time), old[0], steps)
        if pair is not None and pair[0] is not None:
            self._parts = self._parts.with_pair(*pair)
        return self._parts.least

    @property
    def by_meshes(self):
        """Whether it is meshes alone that tell the error of the quantity."""
        return isinstance(self._before, State) and self.told == "meshes"

    def error(self, simulation, found):
        """The error of a quantity, with its sign: as estimated; where bodies yield, as meshes show it. *Collective.*

        Parameters
        ----------
        simulation : pcontact.simulation.Simulation
            That has run.
        found : pcontact.estimate.goal.GoalError

        Returns
        -------
        left, likely : float
            Of what meshes tell, see :func:`left_after`, and as it is expected. Else the larger one of what cells tell
            one by one and together, and the mean of both: the former is too large where cells of both signs cancel,
            the latter too small on coarse meshes and where the solution is singular. Or twice the same. Where the dual
            problem has not foretold how the quantity changed from the last mesh, the larger one of both.
        """
        together = found.error if found.together is None else found.together
        dual, likely = max(found.error, together, key=abs), 0.5 * (found.error + together)
        if self._target.quantity == "pressure":
            return dual, likely
        own, old = State.of(simulation, found.value), self._before
        if not simulation.scene.plastic:
            left, self.told = dual, "dual problem"
            if old is not None:
                change, foretold = own.value - old.value, old.dual - dual
                if abs(change - foretold) > AGREE * max(abs(change), abs(foretold)):
                    left, self.told = max(dual, left_after(old, own), key=abs), "dual problem and meshes"
            self._before = own._replace(left=left, dual=dual)
            return left, likely
        self.told = "meshes"
        if old is None or old.degree != own.degree:
            best = self._on_halved(simulation, lambda run, record, _: State.of(run, self._value(run, record)))
            left = likely = found.error
            if best is not None:
                left = likely = (best.value - own.value) / (1.0 - fallen(own, best))
        else:
            left, likely = left_after(old, own), likely_after(old, own)
        self._before = own._replace(left=left)
        return left, likely

    def _value(self, run, record):
        return value(run.problem, self._target, record, run.stepper.u)

    def _on_halved(self, simulation, found):
        simulation.close()
        result = on_halved(simulation, self._settings.scene(), self._options, found)
        if result is None:
            log.warning("not known: what part of the error the estimate is where bodies yield")
        return result
