"""Prescribed displacements: rows of the system that are known beforehand; places that turn about an axis."""

import numpy as np

from pcontact.runtime.errors import InputError, coordinates
from pcontact.runtime.parallel import agree, together
from pcontact.scene.functions import Prescribed


class Turn:
    """Turns about an axis through a point; in the plane about the point.

    Parameters
    ----------
    point : sequence of float (d,)
        [length]
    axis : sequence of float (3,) or None
        Of any length; None in the plane.
    angle : float
        At factor 1 [radian].

    Attributes
    ----------
    point : ndarray (d,)
    """

    def __init__(self, point, axis, angle):
        self.point, self._angle = np.asarray(point, dtype=float), angle
        if axis is None:
            self._across = np.array([[0.0, -1.0], [1.0, 0.0]])
        else:
            x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
            self._across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])

    def displacement(self, points, factor):
        """(Q - I) (x - point) of points (n, d) [length], small angles without lost digits (Rodrigues)."""
        angle = factor * self._angle
        moved = np.sin(angle) * self._across + 2.0 * np.sin(0.5 * angle) ** 2 * self._across @ self._across
        return (points - self.point) @ moved.T

    def angle(self, factor):
        """Angle [radian] at a factor, or at an array of them."""
        return factor * self._angle


def moments(arms, forces):
    """Sum of the moments of forces (n, d) at the ends of arms (n, d): a number in the plane, (3,) in space."""
    products = np.cross(arms, forces) if arms.shape[1] == 3 else arms[:, 0] * forces[:, 1] - arms[:, 1] * forces[:, 0]
    return products.sum(axis=0)


# two supports that turn agree at a node where they are no farther apart than this part of its distance from the axis
SAME = 1e-12
# [parts of the run] Times at which two supports with expressions are compared. From: chosen.
LOOKS = 16


class Supports:
    """Prescribed components of the displacement.

    Parameters
    ----------
    space : Space
    displacements : list of pcontact.scene.model.Displacement
    amplitudes : list of pcontact.scene.amplitude.Amplitude
        Factor of each displacement.
    source : str
        Name of the scene for messages.

    Attributes
    ----------
    which : ndarray (n_local, d)
        Number of the displacement that prescribes the component, -1 where it is free. On the axis of symmetry the
        radial component is held at zero; what no displacement prescribes there has the number after the last.
    regions : list of str
        Region of each displacement.
    turns : dict of int to pcontact.space.supports.Turn
        Of the displacements that turn what they hold.
    groups : sequence of pcontact.space.constraints.RigidGroup
        That move as rigid bodies; whoever builds the problem adds them.

    Raises
    ------
    InputError
        When two displacements want different values of the same component at the same node, or one wants another
        radial displacement than zero on the axis of symmetry.

    Notes
    -----
    The constructor is *Collective*. Rows and columns of prescribed components are replaced by a multiple
    of the identity and the displacement satisfies them before each solve, so the matrix stays symmetric.
    """

    def __init__(self, space, displacements, amplitudes, source="scene"):
        self._displacements, self._amplitudes = displacements, amplitudes
        self.groups = ()
        self.regions = [d.region for d in displacements]
        self._points, self._comm = space.points, space.comm
        self.turns = {
            number: Turn(one.point, one.axis, np.radians(one.angle))
            for number, one in enumerate(displacements) if one.turns
        }  # fmt: skip
        self.which = np.full((space.n_local, space.dim), -1, dtype=np.int64)
        self.nodes = []
        values = [Prescribed(d.value, source, f"displacements[{number}] ({d.region}).value")
                  for number, d in enumerate(displacements)]  # fmt: skip
        self._table = np.array([[0.0 if isinstance(v, str) else float(v) for v in d.value] for d in displacements]
                               + [[0.0] * space.dim])  # fmt: skip
        # of those with expressions, which the table has as zero
        self._varying = {number: one for number, one in enumerate(values) if one.varies}
        message = None
        for number, displacement in enumerate(displacements):
            nodes = space.region(displacement.region)
            self.nodes.append(nodes)
            for axis, value in enumerate(displacement.value):
                if value == "free":
                    continue
                before = self.which[nodes, axis]
                for other in np.unique(before[before >= 0]):
                    common = nodes[before == other]
                    try:
                        differ = self._differ(number, int(other), axis, common)
                    except InputError as error:
                        message, differ = message or str(error), False
                    if differ:
                        at = coordinates(space.points[common[0]])
                        message = message or (
                            f"{source}: displacements[{number}] ({displacement.region}).value: found "
                            f"{self._said(number, axis)} in direction {axis} at the point {at}, where "
                            f"displacements[{other}] ({displacements[other].region}) prescribes "
                            f"{self._said(int(other), axis)}; "
                            "allowed: one value (and one amplitude) per point and direction"
                        )
                self.which[nodes, axis] = number
        off_axis = self._hold_axis(space, source)
        agree(space.comm, message or off_axis)

    def _hold_axis(self, space, source):
        """Radial displacement zero on the axis of symmetry; returns what is wrong with it, or None. *Collective.*"""
        axis = space.on_axis()
        prescribed = np.unique(self.which[axis, 0])
        self.which[axis & (self.which[:, 0] < 0), 0] = len(self.regions)
        for number in prescribed[prescribed >= 0]:
            varies = number in self._varying and self._varying[number].has(0)
            try:
                moves = varies and self._moves(number, np.flatnonzero(axis & (self.which[:, 0] == number)))
            except InputError as error:
                return str(error)
            if moves or self._table[number, 0] != 0.0:
                return (
                    f"{source}: displacements[{number}] ({self.regions[number]}).value: found "
                    f"{self._said(number, 0)} in direction 0 on the axis of symmetry; allowed: 0 or 'free', x is "
                    "the radius"
                )
        return None

    def _moves(self, number, nodes):
        """Return whether a displacement with expressions moves nodes in direction 0."""
        return any(self._value(number, time, nodes)[:, 0].any() for time in self._times(number))

    def _times(self, *numbers):
        """Times at which displacements that are not linear between the corners of amplitudes are compared."""
        times = np.unique(np.concatenate([self._amplitudes[k].times for k in numbers]))
        if any(k in self._varying and self._varying[k].timed for k in numbers):
            return np.union1d(times, np.linspace(times[0], times[-1], LOOKS))
        return np.concatenate([times, 0.5 * (times[1:] + times[:-1])])

    def _said(self, number, axis):
        """Return what a displacement prescribes in a direction, in words."""
        one = self._displacements[number]
        value = one.value[axis]
        said = f"{value!r}" if isinstance(value, str) else f"{value:g}"
        return said + (f" and a turn by {one.angle:g} degrees" if one.turns else "")

    def _differ(self, first, second, axis, nodes):
        if {first, second} & (self.turns.keys() | self._varying.keys()):
            return self._part(first, second, axis, nodes)
        pair = [(self._displacements[k].value[axis], self._amplitudes[k]) for k in (first, second)]
        times = np.concatenate([amplitude.times for _, amplitude in pair])
        a, b = (value * amplitude.factor(times) for value, amplitude in pair)
        return bool(np.any(a != b))

    def _part(self, first, second, axis, nodes):
        """Return whether two displacements, of which one turns or varies, differ at nodes that both prescribe."""
        for time in self._times(first, second):
            a, b = (self._value(k, time, nodes)[:, axis] for k in (first, second))
            arms = [np.linalg.norm(self._points[nodes] - self.turns[k].point, axis=1)
                    for k in (first, second) if k in self.turns]  # fmt: skip
            # an expression that is zero here has the rounding errors of what it is elsewhere
            arms += [np.full(len(nodes), np.abs(self._value(k, time, self.nodes[k])).max(initial=0.0))
                     for k in (first, second) if k in self._varying]  # fmt: skip
            if np.any(np.abs(a - b) > SAME * np.maximum.reduce([*arms, np.abs(a), np.abs(b)])):
                return True
        return False

    def _value(self, number, time, nodes):
        """Return what a displacement wants of nodes (n,): (n, d) [length]."""
        factor, turn = self._amplitudes[number].factor(time), self.turns.get(number)
        turned = 0.0 if turn is None else turn.displacement(self._points[nodes], factor)
        varying = self._varying.get(number)
        value = self._table[number] if varying is None else varying(self._points[nodes], time)
        return value * factor + np.zeros((len(nodes), 1)) + turned

    @property
    def absolute(self):
        """Flags (n_local, d) of components whose values count from the undeformed place whenever they begin."""
        flags = np.array([one.absolute for one in self._displacements] + [False])
        return (self.which >= 0) & flags[self.which]

    @property
    def fixed(self):
        """Flags (n_local, d) of prescribed components."""
        return self.which >= 0

    def values(self, time):
        """Prescribed values (n_local, d) [length] at a time, zero where free. *Collective* with expressions.

        Raises
        ------
        InputError
            On every rank: the value of an expression is not finite.
        """
        out = np.zeros(self.which.shape)
        for axis in range(out.shape[1]):
            on = self.which[:, axis] >= 0
            number = self.which[on, axis]
            factors = np.array([*(a.factor(time) for a in self._amplitudes), 0.0])
            out[on, axis] = self._table[number, axis] * factors[number]
        for number, turn in self.turns.items():
            nodes = self.nodes[number]
            turned = turn.displacement(self._points[nodes], self._amplitudes[number].factor(time))
            out[nodes] += np.where(self.which[nodes] == number, turned, 0.0)
        if self._varying:
            together(self._comm, self._add_varying, time, out)
        return out

    def _add_varying(self, time, out):
        """Add what expressions say; the table has zeros there."""
        for number, one in self._varying.items():
            factor = self._amplitudes[number].factor(time)
            for axis in range(out.shape[1]):
                nodes = np.flatnonzero(self.which[:, axis] == number) if one.has(axis) else self.nodes[number][:0]
                out[nodes, axis] += factor * one.entry(axis, self._points[nodes], time)

    def turned(self, begin, end):
        """Largest angle by which one turns between two times, linear between its corners [radian]."""
        angles = [
            abs(float(turn.angle(self._amplitudes[k].factor(end) - self._amplitudes[k].factor(begin))))
            for k, turn in self.turns.items()
        ]
        return max(angles, default=0.0)

    def largest_turn(self, number):
        """Largest angle of a displacement that turns, over all times [radian]."""
        return float(np.max(np.abs(self.turns[number].angle(self._amplitudes[number].factors))))

    def moments(self, time, owned, u, forces):
        """Moments of forces about the centres of the supports that turn, in the places of ``u``, on this rank.

        Parameters
        ----------
        time : float
        owned : ndarray (n_owned,)
            Local numbers of the owned nodes.
        u, forces : ndarray (n_owned, d)
            Displacement [length]; forces [force].

        Returns
        -------
        dict of int to ndarray ()  or (3,)
            By number of the displacement: about the centre that has moved with it [force * length].
        """
        result = {}
        for number, turn in self.turns.items():
            centre = turn.point + self._table[number] * self._amplitudes[number].factor(time)
            own = np.where(self.which[owned] == number, forces, 0.0)
            result[number] = moments(self._points[owned] + u - centre, own)
        return result


