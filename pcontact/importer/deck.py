"""The model of a deck: nodes, elements, sets, surfaces, and the cards of materials, contact and steps.

Nodes and elements that a deck counts out (*NGEN, *NFILL, *NCOPY, *ELGEN, *ELCOPY) are ones like all others.

Names are compared without regard to capitals, as the decks' own programs do; they keep the spelling of their first
occurrence.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcontact.element.reference import CELLS
from pcontact.importer.cards import Card, Motion, flat, read_cards, rectangular, turned
from pcontact.mesh.raw import KINDS, NAMED
from pcontact.runtime.errors import InputError

# faces of Abaqus and CalculiX, by the number of vertices and the dimension; vertices from 0
FACES = {
    (2, 3): ((0, 1), (1, 2), (2, 0)),
    (2, 4): ((0, 1), (1, 2), (2, 3), (3, 0)),
    (3, 4): ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    (3, 5): ((0, 1, 2, 3), (0, 4, 1), (1, 4, 2), (2, 4, 3), (3, 4, 0)),
    (3, 6): ((0, 1, 2), (3, 5, 4), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    (3, 8): ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
}
# vertices of cells by meshio's names, whose node orders are the same
VERTICES = {name: CELLS[KINDS[name][0]].n_vertices for (dim, _), name in NAMED.items()
            if dim > 1 and name not in ("quad9", "hexahedron27", "wedge18", "pyramid13", "pyramid14")}  # fmt: skip
# edges of cells with nodes in their middles, in the order of these
EDGES = {name: CELLS[KINDS[name][0]].edges for name in VERTICES if KINDS[name][1] == 2}
# cells that have reduced integration, and all without nodes in the middles of their faces
REDUCED = ("quad8", "hexahedron20")
SERENDIPITY = (*REDUCED, "wedge15")
_TYPE = re.compile(r"(C3D|CPE|CPS|CAX)(\d+)([A-Z]*)")
# nodes of elements that are no cells of a solid
_OTHERS = {"S3": 3, "S6": 6, "S4": 4, "S4R": 4, "S8": 8, "S8R": 8, "M3D3": 3, "M3D4": 4, "M3D4R": 4, "M3D6": 6,
           "M3D8": 8, "M3D8R": 8, "B31": 2, "B31R": 2, "B32": 3, "B32R": 3, "T3D2": 2, "T2D2": 2, "T3D3": 3,
           "SPRINGA": 2, "SPRING1": 1, "SPRING2": 2, "DASHPOTA": 2, "GAPUNI": 2, "MASS": 1, "DCOUP3D": 1, "R3D4": 4,
           "R3D3": 3, "R2D2": 2, "RAX2": 2, "SFM3D4": 4, "F3D4": 4}  # fmt: skip
# elements of rigid surfaces
RIGID = ("R3D3", "R3D4", "R2D2", "RAX2")
KINEMATICS = {"CPE": "plane_strain", "CPS": "plane_stress", "CAX": "axisymmetric"}
_REMARKS = {
    "R": "all its quadrature points in place of reduced integration",
    "I": "no incompatible modes",
    "H": "no pressure of its own; mean dilatation where nu is near 0.5",
    "RH": "all its quadrature points in place of reduced integration, no pressure of its own",
    "M": "as it is without M",
    "T": "no temperature of its own",
}
# numbers of a line of *ELGEN: one element, and three rows of count and increments
_ELGEN = 10
# largest number that a generated set may count to
_MOST = 100_000_000
# words of a generated set without its step
_ENDS = 2
# cosine of the angle from which faces face each other
FACING = 0.5
# nodes of a line
_LINE = 2


class Kind(NamedTuple):
    """A type of elements.

    Attributes
    ----------
    n_nodes : int or None
        None: not known.
    dim : int
        2 or 3; 0: no cell of a solid.
    cell : str or None
        Meshio's name.
    family : str
        C3D, CPE, CPS, CAX; "" for others.
    remark : str
        What the cells do not have of the element; "": nothing.
    reduced : bool
        Whether it has the reduced integration of the program's cells of 8 and 20 nodes.
    """

    n_nodes: int | None
    dim: int
    cell: str | None
    family: str
    remark: str
    reduced: bool = False


def kind_of(word):
    """The type of elements that a deck names."""
    found = _TYPE.fullmatch(word)
    if found is None:
        return Kind(_OTHERS.get(word), 0, None, "", "")
    family, count, letters = found.group(1), int(found.group(2)), found.group(3)
    dim = 3 if family == "C3D" else 2
    cell = NAMED.get((dim, count))
    cell = cell if cell in VERTICES else None
    reduced = cell in REDUCED and family != "CAX" and letters in ("R", "RH")
    letters = letters.removeprefix("R") if reduced else letters
    return Kind(count, dim, cell, family, _REMARKS.get(letters, letters), reduced)


def in_plane(cell):
    """Return whether a cell is one of the plane."""
    return cell.startswith(("tri", "quad"))


def faces_of(cell):
    """Vertices of the faces of a cell, in the deck's numbering from S1 on."""
    dim = 2 if in_plane(cell) else 3
    return FACES[dim, VERTICES[cell]]


def face_nodes(cell, face):
    """Local numbers of all nodes of a face, those in the middles of edges too."""
    corners = faces_of(cell)[face]
    inside = set(corners)
    middles = [VERTICES[cell] + k for k, edge in enumerate(EDGES.get(cell, ())) if set(edge) <= inside]
    return [*corners, *middles]


def _places(deck, card, nodes):
    unknown = [n for n in nodes if n not in deck.nodes]
    if unknown:
        raise card.refuse(f"node {unknown[0]}", "nodes that stand before it")
    return np.array([deck.nodes[n] for n in nodes])


def ngen(deck, card):
    """Nodes on a line, or with LINE=C on an arc, between two nodes; their numbers.

    Raises
    ------
    InputError
        Ends that are no nodes, or numbers that do not fit.
    """
    made = []
    for place, words in card.rows:
        numbers = [card.integer(place, word) for word in words[:3] if word]
        first, last, step = (*numbers, 1)[:3] if len(numbers) >= _ENDS else (0, 0, 0)
        if step == 0 or (last - first) % step or (last - first) // step < 1:
            raise card.refuse(", ".join(words), "first node, last node, increment", place)
        ends, between = _places(deck, card, (first, last)), range(first, last + np.sign(step), step)
        parts = np.linspace(0.0, 1.0, len(between))
        if card.word("LINE", "L") == "L":
            points = ends[0] + parts[:, None] * (ends[1] - ends[0])
        elif card.word("LINE") == "C":
            points = _on_arc(deck, card, place, words, (ends, parts))
        else:
            raise card.refuse(f"LINE={card.get('LINE')}", "lines and arcs: LINE=C", place)
        for number, x in zip(between, points, strict=True):
            deck.nodes.setdefault(number, x.tolist())
        made += between
    return made


def _on_arc(deck, card, place, words, line):
    """Points of an arc about a centre, a node or a place; seven numbers and more: with the normal of its plane."""
    ends, parts = line
    more = words[3:]
    if more and more[0]:
        centre = _places(deck, card, [card.integer(place, more[0])])[0]
    else:
        centre = np.array((card.numbers(place, more[1:4]) + [0.0] * 3)[:3])
    normal = np.array((card.numbers(place, more[4:7]) + [0.0] * 3)[:3])
    a, b = ends - centre
    if not np.any(normal):
        normal = np.cross(a, b)
    if not np.any(normal):
        raise card.refuse("an arc of half a circle", "the normal of its plane after the centre", place)
    normal /= np.linalg.norm(normal)
    angle = np.arctan2(np.cross(a, b) @ normal, a @ b) % (2.0 * np.pi)
    size = np.linalg.norm(a) + parts * (np.linalg.norm(b) - np.linalg.norm(a))
    first = a / np.linalg.norm(a)
    second = np.cross(normal, first)
    turns = parts * angle
    return centre + size[:, None] * (np.cos(turns)[:, None] * first + np.sin(turns)[:, None] * second)


def nfill(deck, card):
    """Nodes between those of two sets, with the numbers of the first and an increment.

    Raises
    ------
    InputError
        Sets of different sizes.
    """
    made, bias = [], card.number(card.place, card.get("BIAS", "1")) or 1.0
    for place, words in card.rows:
        low, high = (deck.nodes_of(card, place, word) for word in words[:2])
        count, step = (card.integer(place, word or "1") for word in (*words[2:4], "1", "1")[:2])
        if len(low) != len(high) or count < 1:
            raise card.refuse(f"sets of {len(low)} and {len(high)} nodes", "two sets of one size, and a count", place)
        sizes = bias ** -np.arange(count, dtype=float)
        parts = np.concatenate([[0.0], np.cumsum(sizes) / sizes.sum()])
        for a, b in zip(low, high, strict=True):
            ends = _places(deck, card, (a, b))
            for k in range(1, count):
                deck.nodes.setdefault(a + k * step, (ends[0] + parts[k] * (ends[1] - ends[0])).tolist())
            made += range(a, a + count * step, step)
        made += high
    return made


def ncopy(deck, card):
    """Copies of nodes that are shifted, or turned about a line.

    Raises
    ------
    InputError
        Other copies.
    """
    old = deck.nodes_of(card, card.place, card.need("OLDSET"))
    change = card.integer(card.place, card.need("CHANGENUMBER"))
    if "SHIFT" not in card.parameters or not card.rows:
        raise card.refuse(", ".join(card.parameters), "SHIFT, with a translation and a turn")
    shift = (card.numbers(*card.rows[0]) + [0.0] * 3)[:3]
    turn = (card.numbers(*card.rows[1]) + [0.0] * 7)[:7] if len(card.rows) > 1 else [0.0] * 7
    motion, made = turned(card, card.rows[1][0], shift, turn) if turn[6] else Motion(shift), []
    for node in old:
        deck.nodes[node + change] = motion.point(deck.nodes[node]).tolist()
        made.append(node + change)
    return made


def elgen(deck, card):
    """Copies of elements in rows, layers and stacks; their numbers.

    Raises
    ------
    InputError
        An element or a node that the deck does not have.
    """
    made = []
    for place, words in card.rows:
        numbers = [card.integer(place, word or "1") for word in words]
        numbers += [1] * (_ELGEN - len(numbers))
        first, rows = numbers[0], np.array(numbers[1:_ELGEN]).reshape(3, 3)
        if first not in deck.elements:
            raise card.refuse(f"element {first}", "an element that stands before it", place)
        for k in range(rows[2, 0]):
            for j in range(rows[1, 0]):
                for i in range(rows[0, 0]):
                    steps = np.array([i, j, k])
                    number = first + int(steps @ rows[:, 2])
                    _copy(deck, card, (first, number), int(steps @ rows[:, 1]))
                    made.append(number)
    return made


def elcopy(deck, card):
    """Copies of a set of elements whose numbers and nodes are shifted."""
    change, nodes = (card.integer(card.place, card.need(name)) for name in ("ELEMENTSHIFT", "SHIFTNODES"))
    old = deck.elements_of(card, card.place, card.need("OLDSET"))
    for element in old:
        _copy(deck, card, (element, element + change), nodes)
    return [element + change for element in old]


def _copy(deck, card, pair, shift):
    """An element with the nodes of another one, shifted."""
    kind, nodes = deck.elements[pair[0]]
    moved = [n + shift for n in nodes]
    _places(deck, card, moved)
    deck.elements[pair[1]] = kind, moved
    if pair[0] in deck.reduced:
        deck.reduced.add(pair[1])


@dataclass
class Surface:
    """Faces of elements, or nodes.

    Attributes
    ----------
    name : str
    card : Card
    faces : list of (int, int)
        Element and local face, from 0.
    nodes : list of int
        Of a surface of nodes.
    sides : list of int
        Elements of a rigid surface.
    """

    name: str
    card: Card
    faces: list = field(default_factory=list)
    nodes: list = field(default_factory=list)
    sides: list = field(default_factory=list)


@dataclass
class Step:
    """A step.

    Attributes
    ----------
    card : Card
    cards : list of Card
        What stands between *STEP and *END STEP.
    """

    card: Card
    cards: list = field(default_factory=list)


@dataclass
class Deck:
    """Contents of a deck.

    Attributes
    ----------
    path : pathlib.Path
    cards : list of Card
        All of them.
    nodes : dict of int to list of float
        Three coordinates each.
    elements : dict of int to (str, list of int)
        Meshio's name of the cell, or the deck's type where it is none; nodes.
    reduced : set of int
        Elements with reduced integration that cells of the program have, too.
    element_cards : dict of str to Card
        First card of every type of element of the deck.
    node_sets, element_sets : dict of str to list of int
        By name in capitals, each number once.
    surfaces : dict of str to Surface
        By name in capitals.
    spelling : dict of str to str
        Of names, by name in capitals.
    materials : dict of str to list of Card
        Cards of a material, by name in capitals; the first is *MATERIAL.
    interactions : dict of str to list of Card
        The same of *SURFACE INTERACTION.
    model : list of Card
        All other cards before the first step.
    steps : list of Step
    lost : list of (Card, Place, str)
        Lines that speak of what is no cell of a solid, and how.
    again : list of (Card, Place, str)
        Lines of nodes and elements that take the place of others.
    removed : Card or None
        Which takes elements away before anything happens.
    """

    path: Path
    cards: list
    nodes: dict = field(default_factory=dict)
    elements: dict = field(default_factory=dict)
    reduced: set = field(default_factory=set)
    element_cards: dict = field(default_factory=dict)
    node_sets: dict = field(default_factory=dict)
    element_sets: dict = field(default_factory=dict)
    surfaces: dict = field(default_factory=dict)
    spelling: dict = field(default_factory=dict)
    materials: dict = field(default_factory=dict)
    interactions: dict = field(default_factory=dict)
    model: list = field(default_factory=list)
    steps: list = field(default_factory=list)
    lost: list = field(default_factory=list)
    again: list = field(default_factory=list)
    removed: Card | None = None

    def name(self, name):
        """A name as it was first written."""
        return self.spelling.setdefault(name.upper(), name)

    def nodes_of(self, card, place, word):
        """Nodes of a set, or the one with a number.

        Raises
        ------
        InputError
        """
        return self._members(card, place, word, (self.node_sets, self.nodes, "node"))

    def elements_of(self, card, place, word):
        """Elements of a set, or the one with a number.

        Raises
        ------
        InputError
        """
        return self._members(card, place, word, (self.element_sets, self.elements, "element"))

    def surface_of(self, card, place, word):
        """A surface.

        Raises
        ------
        InputError
        """
        if word.upper() not in self.surfaces:
            raise card.refuse(f"the unknown surface {word!r}", _listed(self.surfaces), place)
        return self.surfaces[word.upper()]

    @staticmethod
    def _members(card, place, word, kind):
        sets, known, what = kind
        if word.upper() in sets:
            return sets[word.upper()]
        if not word.isdigit():
            raise card.refuse(f"the unknown set of {what}s {word!r}", _listed(sets), place)
        if int(word) not in known:
            raise card.refuse(f"{what} {word}, which the deck does not have", f"one of its {len(known)} {what}s", place)
        return [int(word)]

    def face_nodes(self, element, face):
        """All nodes of a face of an element."""
        cell, nodes = self.elements[element]
        return [nodes[k] for k in face_nodes(cell, face)]

    def corners(self, element, face):
        """Vertices of a face of an element."""
        cell, nodes = self.elements[element]
        return [nodes[k] for k in faces_of(cell)[face]]

    def cards_of(self, *keys):
        """Cards of the model with some keywords."""
        return [card for card in self.model if card.key in keys]

    def cells(self):
        """Numbers of the elements that are cells."""
        return [number for number, (kind, _) in self.elements.items() if kind in VERTICES]

    def remove(self, elements):
        """Forget elements, and their faces."""
        gone = set(elements)
        self.elements = {number: one for number, one in self.elements.items() if number not in gone}
        for name, members in self.element_sets.items():
            self.element_sets[name] = [number for number in members if number not in gone]
        for surface in self.surfaces.values():
            surface.faces = [row for row in surface.faces if row[0] not in gone]

    def free_faces(self):
        """Faces of cells that belong to one cell only, [(element, face)]."""
        owners = {}
        for element in self.cells():
            for face in range(len(faces_of(self.elements[element][0]))):
                owners.setdefault(frozenset(self.corners(element, face)), []).append((element, face))
        return [rows[0] for rows in owners.values() if len(rows) == 1]


def _listed(names):
    return ", ".join(list(names)[:8]) + (" ..." if len(names) > 8 else "") if names else "none is known"


# what belongs to the material, or to the interaction, before it
_OF_MATERIAL = ("ELASTIC", "PLASTIC", "EXPANSION", "DENSITY", "CONDUCTIVITY", "SPECIFICHEAT", "HYPERELASTIC", "CREEP",
                "DAMPING", "USERMATERIAL", "DEPVAR", "CYCLICHARDENING", "HYPERFOAM", "VISCOELASTIC")  # fmt: skip
_OF_INTERACTION = ("SURFACEBEHAVIOR", "FRICTION", "GAPCONDUCTANCE", "GAPHEATGENERATION", "CONTACTDAMPING", "COHESIVE")


def read_deck(path):
    """Read a deck.

    Parameters
    ----------
    path : str or pathlib.Path

    Returns
    -------
    Deck

    Raises
    ------
    InputError
        A line cannot be read, or refers to what the deck does not have.
    """
    deck = Deck(Path(path), flat(rectangular(read_cards(path))))
    block, step, last = None, None, None
    for card in deck.cards:
        if card.key == "STEP":
            step = Step(card)
            deck.steps.append(step)
        elif card.key == "ENDSTEP":
            step = None
        elif card.key in _READ:
            _READ[card.key](deck, card)
        elif card.key in ("MATERIAL", "SURFACEINTERACTION"):
            held = deck.materials if card.key == "MATERIAL" else deck.interactions
            last = held
            block = held.setdefault(deck.name(card.need("NAME")).upper(), [])
            block.append(card)
        elif step is None and card.key in _OF_MATERIAL and last is deck.materials and block is not None:
            block.append(card)
        elif step is None and card.key in _OF_INTERACTION and last is deck.interactions and block is not None:
            block.append(card)
        elif step is not None and not (card.key == "CONTACTPAIR" and len(deck.steps) == 1):
            # what begins with the first step is there all the time
            step.cards.append(card)
        elif card.key != "INCLUDE":
            deck.model.append(card)
    if not deck.cells():
        raise InputError(f"{path}: found no element of a solid; allowed: C3D, CPE, CPS, CAX elements")
    return deck


def _node(deck, card):
    members = []
    for place, words in card.rows:
        number = card.integer(place, words[0])
        _put(deck, deck.nodes, number, (card.numbers(place, words[1:4]) + [0.0] * 3)[:3], card, place)
        members.append(number)
    _join(deck, deck.node_sets, card.get("NSET"), members)


def _put(deck, held, number, value, card, place):
    """Keep a node or an element; the last of two different ones with a number counts, as in the other programs."""
    if held.get(number, value) != value:
        deck.again.append((card, place, f"{number} a second time, and not as before: the last one counts"))
    held[number] = value


def _element(deck, card):
    word = card.need("TYPE").upper()
    kind = kind_of(word)
    deck.element_cards.setdefault(word, card)
    held, members, place = [], [], card.place
    for row, words in card.rows:
        place = row if not held else place
        held += [card.integer(row, w) for w in words if w]
        if kind.n_nodes is None and words[-1]:
            _put(deck, deck.elements, held[0], (word, held[1:]), card, place)
        elif kind.n_nodes is not None and len(held) > kind.n_nodes:
            if len(held) > 1 + kind.n_nodes:
                raise card.refuse(f"{len(held) - 1} nodes of element {held[0]}", f"{kind.n_nodes} for {word}", place)
            _put(deck, deck.elements, held[0], (kind.cell or word, held[1:]), card, place)
            if kind.reduced:
                deck.reduced.add(held[0])
        else:
            continue
        members.append(held[0])
        unknown = [n for n in held[1:] if n not in deck.nodes and (kind.cell or word in RIGID)]
        if unknown:
            raise card.refuse(f"node {unknown[0]} of element {held[0]}", "nodes that stand before it", place)
        held = []
    if held:
        raise card.refuse(f"{len(held) - 1} nodes of element {held[0]}", f"{kind.n_nodes} for {word}", place)
    _join(deck, deck.element_sets, card.get("ELSET"), members)


def _set(deck, card):
    of_nodes = card.key == "NSET"
    sets, known = (deck.node_sets, deck.nodes) if of_nodes else (deck.element_sets, deck.elements)
    name = card.need("NSET" if of_nodes else "ELSET")
    members = []
    for place, words in card.rows:
        words = [word for word in words if word]
        if "GENERATE" in card.parameters:
            if len(words) not in (_ENDS, _ENDS + 1):
                raise card.refuse(", ".join(words), "first, last, step", place)
            first, last, *step = [card.integer(place, word) for word in words]
            if abs(last) > _MOST or (step and step[0] == 0):
                raise card.refuse(", ".join(words), "first, last, step", place)
            members += [n for n in range(first, last + 1, *step) if n in known]
            continue
        for word in words:
            if word.upper() in sets:
                members += sets[word.upper()]
            elif word.isdigit():
                members.append(int(word))
            else:
                raise card.refuse(repr(word), f"a number, or a set that stands before: {_listed(sets)}", place)
    if of_nodes and "ELSET" in card.parameters:
        for number in deck.elements_of(card, card.place, card.need("ELSET")):
            members += deck.elements[number][1]
    _join(deck, sets, name, [number for number in members if number in known])


def _join(deck, sets, name, members):
    if name:
        key = deck.name(name).upper()
        sets[key] = list(dict.fromkeys([*sets.get(key, []), *members]))


def _surface(deck, card):
    name = deck.name(card.need("NAME"))
    surface = deck.surfaces.setdefault(name.upper(), Surface(name, card))
    free, kind = None, card.word("TYPE", "ELEMENT")
    for place, words in card.rows if kind in ("ELEMENT", "NODE") else ():
        words = [word for word in words if word]
        if kind == "NODE":
            for word in words:
                surface.nodes += deck.nodes_of(card, place, word)
            continue
        members = deck.elements_of(card, place, words[0])
        surface.sides += [e for e in members if deck.elements[e][0] in RIGID]
        members = [e for e in members if deck.elements[e][0] not in RIGID]
        if len(words) > 1:
            surface.faces += faces(deck, card, place, words[1], members)
            continue
        free = deck.free_faces() if free is None else free
        inside = set(members)
        surface.faces += [row for row in free if row[0] in inside]


def faces(deck, card, place, label, elements):
    """Faces of elements by their label, S1 or P1 being face 0; those of elements that are no cells are lost.

    Returns
    -------
    list of (int, int)

    Raises
    ------
    InputError
    """
    found = []
    for element in elements:
        cell = deck.elements[element][0]
        if cell not in VERTICES:
            deck.lost.append((card, place, f"{label} of {cell} elements, which are no cells of a solid"))
            continue
        count, digits = len(faces_of(cell)), label[1:]
        if label[:1].upper() not in "SP" or not digits.isdigit() or not 1 <= int(digits) <= count:
            raise card.refuse(f"face {label!r} of element {element}", f"S1 to S{count} of a {cell}", place)
        found.append((element, int(digits) - 1))
    return found


def _made(deck, card):
    """Nodes or elements that are counted out, and the set that they make."""
    make, name, sets = _GENERATED[card.key]
    _join(deck, getattr(deck, sets), card.get(name), make(deck, card))


# what counts them out, the parameter that names their set, and where sets are
_GENERATED = {"NGEN": (ngen, "NSET", "node_sets"), "NFILL": (nfill, "NSET", "node_sets"),
              "NCOPY": (ncopy, "NEWSET", "node_sets"), "ELGEN": (elgen, "ELSET", "element_sets"),
              "ELCOPY": (elcopy, "NEWSET", "element_sets")}  # fmt: skip
_READ = {"NODE": _node, "ELEMENT": _element, "NSET": _set, "ELSET": _set, "SURFACE": _surface,
         **dict.fromkeys(_GENERATED, _made)}  # fmt: skip


def surface_faces(deck, surface):
    """Faces of a surface; of one of nodes alone, the free faces whose nodes are all in it."""
    if surface.faces or not surface.nodes:
        return surface.faces
    inside = set(surface.nodes)
    return [row for row in deck.free_faces() if inside.issuperset(deck.corners(*row))]


def facing_faces(deck, nodes, others):
    """Free faces with one of some nodes, and of these those that face the other faces, on the whole."""
    against = np.mean([outward(deck, row) for row in others], axis=0)
    inside = set(nodes)
    found = [row for row in deck.free_faces() if inside & set(deck.corners(*row))]
    return [row for row in found if outward(deck, row) @ against < -FACING]


def outward(deck, row):
    """Unit normal (3,) of a face (element, local face), out of its element."""
    points = np.array([deck.nodes[n] for n in deck.corners(*row)])
    ends = points[1] - points[0]
    normal = np.array([ends[1], -ends[0], 0.0]) if len(points) == _LINE else np.cross(ends, points[-1] - points[0])
    centre = np.mean([deck.nodes[n] for n in deck.elements[row[0]][1]], axis=0)
    normal *= np.sign(normal @ (points.mean(axis=0) - centre))
    size = np.linalg.norm(normal)
    return normal / size if size > 0.0 else normal


def distances(deck, nodes, faces):
    """Distances of nodes from the nearest point of faces, (n,), whose edges are straight.

    Parameters
    ----------
    deck : Deck
    nodes : list of int
    faces : list of (int, int)

    Returns
    -------
    list of float
    """
    fans = []
    for row in faces:
        corners = np.array([deck.nodes[n] for n in deck.corners(*row)])
        # a line is a triangle whose last two vertices are the same
        fans += [corners[[0, k, min(k + 1, len(corners) - 1)]] for k in range(1, max(_LINE, len(corners) - 1))]
    fans = np.array(fans)
    return [float(_away(np.array(deck.nodes[node]), fans).min()) for node in nodes]


def _away(point, triangles):
    """Distances (n,) of a point (3,) from triangles (n, 3, 3)."""
    best = np.full(len(triangles), np.inf)
    for k in range(3):
        a, edge = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        size = np.einsum("ni,ni->n", edge, edge)
        along = np.einsum("ni,ni->n", point - a, edge) / np.where(size > 0.0, size, 1.0)
        best = np.minimum(best, np.linalg.norm(point - a - np.clip(along, 0.0, 1.0)[:, None] * edge, axis=1))
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inside = np.linalg.norm(normal, axis=1) > 0.0
    for k in range(3):
        edge = triangles[:, (k + 1) % 3] - triangles[:, k]
        inside &= np.einsum("ni,ni->n", np.cross(edge, point - triangles[:, k]), normal) >= 0.0
    height = np.einsum("ni,ni->n", point - triangles[inside, 0], normal[inside])
    best[inside] = np.abs(height) / np.linalg.norm(normal[inside], axis=1)
    return best
