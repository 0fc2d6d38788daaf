"""Orthotropic materials of a deck: constants, and the local axes of sections (*ORIENTATION)."""

import numpy as np

from pcontact.scene.orthotropic import PAIRS, indefinite

# words of TYPE with nine constants along three axes: a stiffness, or moduli and ratios of contraction
STIFFNESS, MODULI = ("ORTHO", "ORTHOTROPIC"), ("ENGINEERINGCONSTANTS",)
# constants of a temperature, on two lines; those of the first one
CONSTANTS, FIRST = 9, 8
# cosine from which an axis is across the plane
ACROSS = 1.0 - 1e-9
_AXES = ("1", "2", "3")


def constant_rows(rows):
    """Nine constants, and the temperature where it is said, of each pair of lines; None where they are too few."""
    pairs = list(zip(rows[::2], rows[1::2], strict=False))
    if not rows or len(rows) % 2 or any(len(a) < FIRST or not b for a, b in pairs):
        return None
    return [[*a[:FIRST], *b] for a, b in pairs]


def from_stiffness(constants):
    """E, nu and G from D1111, D1122, D2222, D1133, D2233, D3333, D1212, D1313, D2323; None where some strain has no
    positive energy."""
    d11, d12, d22, d13, d23, d33, *shear = constants
    normal = np.array([[d11, d12, d13], [d12, d22, d23], [d13, d23, d33]])
    if np.linalg.eigvalsh(normal)[0] <= 0.0 or min(shear) <= 0.0:
        return None
    compliance = np.linalg.inv(normal)
    young = (1.0 / np.diag(compliance)).tolist()
    return young, [float(-compliance[i, j] * young[i]) for i, j in PAIRS], shear


def from_moduli(constants):
    """The same from E1, E2, E3, nu12, nu13, nu23, G12, G13, G23."""
    young, poisson, shear = (list(constants[k : k + 3]) for k in (0, 3, 6))
    if min(*young, *shear) <= 0.0 or indefinite(young, poisson) is not None:
        return None
    return young, poisson, shear


def promote(table, cards, findings):
    """One kind of constants for elasticity and expansion; without what an orthotropic material does not have.

    Parameters
    ----------
    table : dict
        Of a material; changed.
    cards : list of Card
        Its cards.
    findings : Findings
    """
    several = isinstance(table.get("expansion"), list)
    if several and not isinstance(table["E"], list):
        if {"law", "yield_stress", "hardening_curve"} & table.keys():
            card = next(card for card in cards if card.key == "EXPANSION")
            findings.leave(card, "an expansion that differs along the axes, of a material that yields, or rubber")
            del table["expansion"]
            return
        young, nu = table["E"], table["nu"]
        table |= {"E": [young] * 3, "nu": [nu] * 3, "G": [0.5 * young / (1.0 + nu)] * 3}
    if not isinstance(table["E"], list):
        return
    if "expansion" in table and not several:
        table["expansion"] = [table["expansion"]] * 3
    if {"yield_stress", "hardening_curve"} & table.keys():
        for key in ("yield_stress", "hardening_curve", "kinematic_hardening"):
            table.pop(key, None)
        card = next(card for card in cards if card.key == "PLASTIC")
        findings.leave(card, "an orthotropic material does not yield")


class Orientations:
    """Local axes of the sections with an orthotropic material.

    Parameters
    ----------
    deck : Deck
    findings : Findings
    plane : bool
        Whether the cells are those of a plane mesh.
    rings : bool
        Whether they are axisymmetric.
    """

    def __init__(self, deck, findings, plane, rings):
        self._findings, self._plane, self._rings, self._used = findings, plane, rings, set()
        self._cards = {card.need("NAME").upper(): card for card in deck.model if card.key == "ORIENTATION"}

    def keys(self, section):
        """Keys of the material of a section: `axes`, `point`, `axis`.

        Raises
        ------
        InputError
            The section names an orientation that the deck does not have.
        """
        name = section.need("ORIENTATION").upper()
        if name not in self._cards:
            raise section.refuse(f"the unknown orientation {section.get('ORIENTATION')!r}", ", ".join(self._cards))
        self._used.add(name)
        card = self._cards[name]
        self._findings.know(card, "NAME", "SYSTEM", "DEFINITION")
        found = self._read(card)
        if found is not None:
            self._findings.take(card)
        return found or {}

    def _read(self, card):
        kind, rows = card.word("SYSTEM", "RECTANGULAR"), [(place, words) for place, words in card.rows if any(words)]
        if card.word("DEFINITION", "COORDINATES") != "COORDINATES" or not rows or not _number(rows[0][1][0]):
            self._findings.leave(card, "allowed: axes by coordinates of points")
            return None
        numbers = (card.numbers(*rows[0]) + [0.0] * FIRST)[: max(6, len(rows[0][1]))]
        a, b, origin = np.array(numbers[:3]), np.array(numbers[3:6]), np.array((numbers[6:] + [0.0] * 3)[:3])
        turn = _turned(card, rows[1:])
        if kind in ("CYLINDRICAL", "C"):
            return self._around(card, a, b, turn)
        if kind not in ("RECTANGULAR", "R", "ZRECTANGULAR"):
            self._findings.leave(card, "allowed: SYSTEM=RECTANGULAR, Z RECTANGULAR, CYLINDRICAL")
            return None
        a, b = a - origin, b - origin
        third = np.cross(a, b)
        if np.linalg.norm(third) <= 1e-9 * np.linalg.norm(a) * np.linalg.norm(b):
            raise card.refuse("points on one line", "points that span a plane")
        # of the first system a is along the first axis, of the other one along the third
        second = np.cross(third, a)
        frame = [second, third, a] if kind == "ZRECTANGULAR" else [a, second, third]
        axes = turn @ np.array([one / np.linalg.norm(one) for one in frame])
        if self._plane and np.abs(axes[:, 2]).max() < ACROSS:
            self._findings.leave(card, "axes of which none is across the plane of the mesh")
            return None
        return {"axes": [_round(one) for one in axes[:2]]}

    def _around(self, card, a, b, turn):
        if np.linalg.norm(b - a) == 0.0:
            raise card.refuse("points in one place", "two points of the axis")
        axis = (b - a) / np.linalg.norm(b - a)
        if self._rings or (self._plane and min(abs(axis[2]), np.abs(turn[:, 2]).max()) < ACROSS):
            self._findings.leave(card, "axes around a line of which none is across the plane of the mesh")
            return None
        if self._plane and axis[2] < 0.0:
            # hoop and axis the other way
            turn = turn @ np.diag([1.0, -1.0, -1.0])
        found = {"axes": [_round(one) for one in turn[:2]]} if not np.allclose(turn, np.eye(3)) else {}
        if self._plane:
            return {**found, "point": _round(a[:2])}
        return {**found, "point": _round(a), "axis": _round(axis)}

    def unused(self):
        """Say what orientations do that no orthotropic material has."""
        for name, card in self._cards.items():
            if name not in self._used:
                self._findings.skip(card, "no orthotropic material has it")


def _number(word):
    try:
        float(word.lower().replace("d", "e") or 0.0)
    except ValueError:
        return False
    return True


def _turned(card, rows):
    """Axes (3, 3), in rows, of a turn about one of them, in degrees: number of the axis, angle."""
    if not rows:
        return np.eye(3)
    place, words = rows[0]
    if words[0] and words[0] not in _AXES:
        raise card.refuse(words[0], "1, 2, 3", place)
    k = int(words[0] or 1) - 1
    angle = np.radians(card.number(place, words[1]) if len(words) > 1 else 0.0)
    i, j = (k + 1) % 3, (k + 2) % 3
    axes = np.eye(3)
    axes[i, i] = axes[j, j] = np.cos(angle)
    axes[i, j], axes[j, i] = np.sin(angle), -np.sin(angle)
    return axes


def _round(vector):
    """Numbers without the rounding errors of sines."""
    return [float(round(one, 12)) + 0.0 for one in vector]
