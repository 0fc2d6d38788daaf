"""Materials and bodies of a deck as tables of a scene, with the local axes of sections (*ORIENTATION)."""

import numpy as np

from pcontact.importer.deck import EDGES, KINEMATICS, REDUCED, RIGID, SERENDIPITY, kind_of
from pcontact.material.orthotropic import frame
from pcontact.runtime.rules import is_number
from pcontact.scene.orthotropic import PAIRS, indefinite

# words of TYPE with nine constants along three axes: a stiffness, or moduli and ratios of contraction
STIFFNESS, MODULI = ("ORTHO", "ORTHOTROPIC"), ("ENGINEERINGCONSTANTS",)
# constants of a temperature, on two lines; those of the first one
CONSTANTS, FIRST = 9, 8
# cosine from which an axis is across the plane
ACROSS = 1.0 - 1e-9
_AXES = ("1", "2", "3")
# Poisson's ratio of what keeps its volume
FIRM = 0.4999
# rows of kinematic hardening; numbers of elasticity
_TWO = 2


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
        self._cards = {card.need("NAME").upper(): card for card in deck.cards_of("ORIENTATION")}

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
        first = rows[0][1][0].lower().replace("d", "e") or "0" if rows else ""
        if card.word("DEFINITION", "COORDINATES") != "COORDINATES" or not is_number(first):
            self._findings.leave(card, "allowed: axes by coordinates of points")
            return None
        numbers = (card.numbers(*rows[0]) + [0.0] * FIRST)[: max(6, len(rows[0][1]))]
        a, b, origin = np.array(numbers[:3]), np.array(numbers[3:6]), np.array((numbers[6:] + [0.0] * 3)[:3])
        turn = _turned_material(card, rows[1:])
        if kind in ("CYLINDRICAL", "C"):
            return self._around(card, a, b, turn)
        if kind not in ("RECTANGULAR", "R", "ZRECTANGULAR"):
            self._findings.leave(card, "allowed: SYSTEM=RECTANGULAR, Z RECTANGULAR, CYLINDRICAL")
            return None
        a, b = a - origin, b - origin
        if np.linalg.norm(np.cross(a, b)) <= 1e-9 * np.linalg.norm(a) * np.linalg.norm(b):
            raise card.refuse("points on one line", "points that span a plane")
        # of the first system a is along the first axis, of the other one along the third
        axes = turn @ frame(a, b)[[1, 2, 0] if kind == "ZRECTANGULAR" else [0, 1, 2]]
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


def _turned_material(card, rows):
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


def materials(deck, findings):
    """Tables [materials.NAME], by the deck's name in capitals.

    Parameters
    ----------
    deck : Deck
    findings : Findings

    Returns
    -------
    dict of str to dict
    """
    tables = {}
    for name, cards in deck.materials.items():
        table = tables[name] = {}
        findings.know(cards[0], "NAME")
        findings.take(cards[0])
        for card in cards[1:]:
            if card.key in _READ:
                read, known = _READ[card.key]
                findings.know(card, *known or card.parameters)
                read(card, table, findings)
            elif card.key in ("CONDUCTIVITY", "SPECIFICHEAT", "DAMPING"):
                findings.skip(card, "no static solution depends on it")
            else:
                findings.leave(card, "allowed: *ELASTIC, *HYPERELASTIC, *PLASTIC, *EXPANSION, *DENSITY")
        if "E" not in table:
            findings.leave(cards[0], "has no elasticity that is known; E = 1 and nu = 0.3 stand in its place")
            table |= {"E": 1.0, "nu": 0.3}
        promote(table, cards, findings)
    return tables


def _rows(card):
    return [card.numbers(place, words) for place, words in card.rows if any(words)]


def _alike(card, rows, width, findings):
    """The rows of one temperature: the first one, if temperatures differ."""
    temperatures = list(dict.fromkeys(row[width] if len(row) > width else 0.0 for row in rows))
    same = [[row[:width] for row in rows if (row[width] if len(row) > width else 0.0) == t] for t in temperatures]
    if any(part != same[0] for part in same):
        findings.leave(card, f"its dependence on the temperature; taken at {temperatures[0]:g}")
    return same[0] if same else []


def _elastic(card, table, findings):
    rows = _rows(card)
    if card.word("TYPE") in STIFFNESS + MODULI:
        _orthotropic(card, rows, table, findings)
        return
    if card.word("TYPE", "ISO") not in ("ISO", "ISOTROPIC") or not rows or len(rows[0]) < _TWO:
        findings.leave(card, "allowed: TYPE=ISO with E and nu, ORTHO, ENGINEERING CONSTANTS")
        return
    first = _alike(card, rows, 2, findings)[0]
    table["E"], table["nu"] = first
    findings.take(card, f"E = {first[0]:g}, nu = {first[1]:g}")


def _orthotropic(card, rows, table, findings):
    rows = constant_rows(rows)
    if rows is None:
        findings.leave(card, "allowed: nine constants on two lines, for each temperature")
        return
    constants = _alike(card, rows, CONSTANTS, findings)[0]
    found = (from_stiffness if card.word("TYPE") in STIFFNESS else from_moduli)(constants)
    if found is None:
        findings.leave(card, "constants with which some strain has no positive energy")
        return
    table["E"], table["nu"], table["G"] = found
    findings.take(card, "E = " + ", ".join(f"{one:g}" for one in table["E"]))


def _plastic(card, table, findings):
    rows = _alike(card, [(row + [0.0])[:3] if len(row) < _TWO else row for row in _rows(card)], 2, findings)
    kind = card.word("HARDENING", "ISOTROPIC")
    if not rows or kind not in ("ISOTROPIC", "KINEMATIC") or (kind == "KINEMATIC" and len(rows) != _TWO):
        findings.leave(card, "allowed: isotropic hardening, or kinematic with two rows")
        return
    start, curve = rows[0][1], [[row[1] - rows[0][1], row[0]] for row in rows]
    if start != 0.0:
        findings.change(card, f"plastic strains begin at {start:g} in the deck, here at 0")
    if kind == "KINEMATIC":
        table["yield_stress"] = curve[0][1]
        table["kinematic_hardening"] = (curve[1][1] - curve[0][1]) / curve[1][0]
        findings.change(card, "linear kinematic hardening, which goes on beyond the last row")
        return
    table["hardening_curve"] = curve
    findings.take(card, f"{len(curve)} rows of isotropic hardening")


def _expansion(card, table, findings):
    rows = _rows(card)
    kind = card.word("TYPE", "ISO")
    count = 3 if kind in STIFFNESS else 1
    if kind not in ("ISO", *STIFFNESS) or not rows or len(rows[0]) < count:
        findings.leave(card, "allowed: TYPE=ISO with one coefficient, ORTHO with three")
        return
    first = _alike(card, rows, count, findings)[0]
    table["expansion"] = first if count > 1 else first[0]
    findings.take(card, ", ".join(f"{one:g}" for one in first))


def _density(card, table, findings):
    rows = _rows(card)
    if rows:
        table["density"] = rows[0][0]
    findings.take(card, "for weight and centrifugal force")


def _hyperelastic(card, table, findings):
    """Rubber, from its energy; D of zero is a material that keeps its volume (Abaqus, Theory Guide, 4.6.1)."""
    terms = card.integer(card.place, card.get("N", "1"))
    law = next((name for name in ("NEOHOOKE", "MOONEY-RIVLIN", "OGDEN") if name in card.parameters), None)
    numbers = [x for place, words in card.rows for x in card.numbers(place, words)]
    count = {"NEOHOOKE": 1, "MOONEY-RIVLIN": 2, "OGDEN": 2 * terms}.get(law, 0)
    if law is None or len(numbers) < count:
        findings.leave(card, "allowed: NEO HOOKE, MOONEY-RIVLIN, OGDEN, with their constants")
        return
    own, last = numbers[:count], (numbers[count:] + [0.0])[0]
    shear = sum(own[::2]) if law == "OGDEN" else 2.0 * sum(own)
    if last > 0.0:
        bulk = 2.0 / last
        nu = (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))
        findings.change(card, f"K = {bulk:g}, in another function of the volume; the same where it changes little")
    else:
        nu = FIRM
        findings.change(card, f"it keeps its volume in the deck, here nu = {FIRM}")
    table |= {"E": 2.0 * shear * (1.0 + nu), "nu": nu, "law": law.lower().replace("-", "_").replace("neoh", "neo_h")}
    if law == "MOONEY-RIVLIN":
        table["mooney_rivlin"] = own
    elif law == "OGDEN":
        table["ogden"] = [[2.0 * mu / alpha, alpha] for mu, alpha in zip(own[::2], own[1::2], strict=True)]


def straighten(deck, findings, key, table, finite):
    """With small strain rubber is as stiff as it is at its beginning."""
    if not finite and table.pop("law", None) is not None:
        for name in ("mooney_rivlin", "ogden"):
            table.pop(name, None)
        card = next(card for card in deck.materials[key] if card.key == "HYPERELASTIC")
        findings.change(card, "without NLGEOM: linear, as stiff as it is at its beginning")


# how cards are read, and parameters that they may have; none: any
_READ = {"ELASTIC": (_elastic, ("TYPE",)), "PLASTIC": (_plastic, ("HARDENING",)), "DENSITY": (_density, ()),
         "HYPERELASTIC": (_hyperelastic, ("NEOHOOKE", "MOONEY-RIVLIN", "OGDEN", "N", "MODULI")),
         "EXPANSION": (_expansion, ("TYPE", "ZERO"))}  # fmt: skip


def bodies(deck, findings, tables):
    """Cells of every section.

    Parameters
    ----------
    deck : Deck
    findings : Findings
    tables : dict of str to dict
        Of :func:`materials`; grows by those whose axes a section turns.

    Returns
    -------
    list of (str, str, list of int)
        Name, material in capitals, elements.
    kinematics : str or None
        Of a plane mesh.
    thickness : float
        Of a plane mesh.
    """
    owner, names, widths = {}, [], {}
    dims, plane = _families(deck, findings)
    turns = Orientations(deck, findings, dims == {2}, plane == "axisymmetric")
    for card in deck.cards_of("SOLIDSECTION", "MEMBRANESECTION"):
        findings.know(card, "ELSET", "MATERIAL", "ORIENTATION", "CONTROLS")
        material = card.need("MATERIAL").upper()
        if material not in deck.materials:
            raise card.refuse(f"the unknown material {card.get('MATERIAL')!r}", ", ".join(deck.materials))
        if "ORIENTATION" in card.parameters:
            material = _turned(deck, findings, tables, turns, card)
        for element in deck.elements_of(card, card.place, card.need("ELSET")):
            owner[element] = len(names)
        names.append((deck.name(card.need("ELSET")), material))
        width = card.numbers(*card.rows[0])[0] if card.rows and card.rows[0][1][0] else 1.0
        widths[width] = card
        findings.take(card)
    found = [(name, material, []) for name, material in names]
    homeless = set()
    for element in deck.cells():
        if element in owner:
            found[owner[element]][2].append(element)
        else:
            homeless.add(deck.elements[element][0])
    _say_types(deck, findings, homeless)
    turns.unused()
    if dims == {2} and len(widths) > 1:
        card = list(widths.values())[-1]
        findings.leave(card, f"thicknesses that differ ({', '.join(f'{w:g}' for w in widths)})")
    # cells of degree 1 beside others are a body of their own
    parts = [(name, material, [e for e in cells if (deck.elements[e][0] in EDGES) == quadratic])
             for name, material, cells in found for quadratic in (True, False)]  # fmt: skip
    return [one for one in parts if one[2]], plane, next(iter(widths), 1.0) if dims == {2} else 1.0


def _turned(deck, findings, tables, turns, section):
    """Key of the material of a section with an orientation: one of its own where the material has axes."""
    material = section.need("MATERIAL").upper()
    if not isinstance(tables[material]["E"], list):
        findings.skip(section, "the orientation of a material that has none")
        return material
    name = f"{deck.spelling[material]}-{section.need('ORIENTATION')}"
    if name.upper() not in tables:
        tables[deck.name(name).upper()] = {**tables[material], **turns.keys(section)}
        deck.materials[name.upper()] = deck.materials[material]
    return name.upper()


def _say_types(deck, findings, homeless):
    for word, card in deck.element_cards.items():
        kind = kind_of(word)
        if kind.cell is None and (word == "DCOUP3D" or word in RIGID):
            findings.take(card, "a rigid surface" if word in RIGID else "a reference node")
        elif kind.cell is None:
            findings.leave(card, f"elements of type {word}, which are no cells of a solid")
        elif kind.cell in homeless:
            findings.leave(card, f"elements of type {word} without a section")
        elif kind.remark:
            findings.change(card, f"type {word} as {kind.cell}: {kind.remark}")
        else:
            findings.take(card, f"type {word}")
    for card in deck.cards:
        if card.key == "ELEMENT":
            findings.know(card, "TYPE", "ELSET")
            if card is not deck.element_cards[card.need("TYPE").upper()]:
                findings.take(card, "as the others of its type")


def _families(deck, findings):
    """Dimensions of the cells; kinematics of a plane mesh."""
    kinds = [(kind_of(word), card) for word, card in deck.element_cards.items() if kind_of(word).cell]
    dims = {kind.dim for kind, _ in kinds}
    if len(dims) > 1:
        card = next(card for kind, card in kinds if kind.dim == 2)
        findings.leave(card, "cells of the plane beside cells of space")
    families = list(dict.fromkeys(kind.family for kind, _ in kinds if kind.family in KINEMATICS))
    if len(families) > 1:
        card = next(card for kind, card in kinds if kind.family == families[1])
        findings.leave(card, f"{families[1]} beside {families[0]}: there is one kinematics of the mesh")
    return dims, KINEMATICS[families[0]] if families and dims == {2} else None


def integration_of(deck, findings, cells):
    """Integration of a body, "full" or "reduced": where its cells of 8 and 20 nodes differ, that of most of them."""
    able = [e for e in cells if deck.elements[e][0] in REDUCED]
    count = sum(e in deck.reduced for e in able)
    if 0 < count < len(able):
        word, card = next((w, c) for w, c in deck.element_cards.items() if kind_of(w).reduced)
        other = "reduced" if 2 * count > len(able) else "full"
        findings.change(card, f"type {word} beside others of its body: all of them with {other} integration")
    return "reduced" if 2 * count > len(able) else "full"


def order_of(deck):
    """Degree of the displacement, and whether quadrilaterals and hexahedra have no nodes in their middles."""
    kinds = {deck.elements[element][0] for element in deck.cells()}
    return 2 if any(kind in EDGES for kind in kinds) else 1, bool(kinds.intersection(SERENDIPITY))
