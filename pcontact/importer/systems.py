"""Places of a deck that are given in other coordinates (*SYSTEM, *NODE with SYSTEM), or moved, as ones of the mesh."""

from dataclasses import replace

import numpy as np

from pcontact.space.turn import Turn

# numbers of a line of *SYSTEM
_POINTS = 6


class Motion:
    """A translation, and a turn that follows it.

    Parameters
    ----------
    shift : sequence of float (3,)
        [length]
    turn : sequence of float (7,), optional
        Two points of the axis [length], and the angle [degree].
    """

    def __init__(self, shift, turn=None):
        self._shift, self._turn = np.array(shift), None
        if turn is not None:
            first, second = np.array(turn[:3]), np.array(turn[3:6])
            self._turn = Turn(first, second - first, np.radians(turn[6]))

    def point(self, x):
        """Where a point (3,) comes to."""
        moved = np.asarray(x) + self._shift
        return moved if self._turn is None else moved + self._turn.displacement(moved, 1.0)

    def direction(self, x):
        """Where a direction (3,) comes to."""
        x = np.asarray(x)
        return x if self._turn is None else x + self._turn.displacement(self._turn.point + x, 1.0)


def turned(card, place, shift, turn):
    """The motion of a translation and a turn that a line of a card says.

    Raises
    ------
    InputError
        The points of the axis are the same.
    """
    if turn[:3] == turn[3:6]:
        raise card.refuse("an axis of no length", "two points that differ", place)
    return Motion(shift, turn)


def rectangular(cards):
    """The same cards, all nodes in Cartesian coordinates of the mesh, without *SYSTEM.

    Parameters
    ----------
    cards : list of Card

    Returns
    -------
    list of Card

    Raises
    ------
    InputError
        A system that is none.
    """
    found, origin, axes = [], np.zeros(3), np.eye(3)
    for card in cards:
        if card.key == "SYSTEM":
            origin, axes = _system(card)
            found.append(card)
            continue
        if card.key in ("PART", "ENDPART", "INSTANCE", "ENDINSTANCE"):
            origin, axes = np.zeros(3), np.eye(3)
        kind = card.word("SYSTEM", "R")
        if card.key != "NODE" or (kind == "R" and not np.any(origin) and np.array_equal(axes, np.eye(3))):
            found.append(card)
            continue
        if kind not in _LOCAL:
            raise card.refuse(f"SYSTEM={card.get('SYSTEM')}", ", ".join(_LOCAL))
        rows = []
        for place, words in card.rows:
            local = _LOCAL[kind](*(card.numbers(place, words[1:4]) + [0.0] * 3)[:3])
            rows.append((place, [words[0], *map(repr, (origin + np.array(local) @ axes).tolist())]))
        parameters = {name: value for name, value in card.parameters.items() if name != "SYSTEM"}
        found.append(replace(card, rows=rows, parameters=parameters))
    return found


def _cylindrical(radius, angle, z):
    angle = np.radians(angle)
    return radius * np.cos(angle), radius * np.sin(angle), z


def _spherical(radius, angle, height):
    """Angles in degrees: about the axis, and above the plane across it (Abaqus, Keywords Guide, *NODE)."""
    angle, height = np.radians((angle, height))
    return radius * np.cos(height) * np.cos(angle), radius * np.cos(height) * np.sin(angle), radius * np.sin(height)


_LOCAL = {"R": lambda x, y, z: (x, y, z), "C": _cylindrical, "S": _spherical}


def _system(card):
    """Origin (3,) and axes (3, 3), in rows: the first through a point, the second towards another."""
    rows = [card.numbers(place, words) for place, words in card.rows]
    first = (rows[0] + [0.0] * _POINTS)[:_POINTS] if rows else [0.0] * _POINTS
    origin, along = np.array(first[:3]), np.array(first[3:]) - np.array(first[:3])
    if not rows or len(rows[0]) <= _POINTS // 2:
        return origin, np.eye(3)
    towards = (np.array((rows[1] + [0.0] * 3)[:3]) if len(rows) > 1 else origin + [-along[1], along[0], 0.0]) - origin
    third = np.cross(along, towards)
    if not np.any(third):
        raise card.refuse("points on one line", "three points that span a plane")
    axes = [along / np.linalg.norm(along), third / np.linalg.norm(third)]
    return origin, np.array([axes[0], np.cross(axes[1], axes[0]), axes[1]])
