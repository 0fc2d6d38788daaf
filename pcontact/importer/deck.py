"""The model of a deck: nodes, elements, sets, surfaces, and the cards of materials, contact and steps.

Names are compared without regard to capitals, as the decks' own programs do; they keep the spelling of their first
occurrence.
"""

from dataclasses import dataclass, field
from pathlib import Path

from pcontact.importer.assembly import flat
from pcontact.importer.cards import Card, read_cards
from pcontact.importer.elements import RIGID, VERTICES, face_nodes, faces_of, kind_of
from pcontact.importer.generate import elcopy, elgen, ncopy, nfill, ngen
from pcontact.importer.systems import rectangular
from pcontact.runtime.errors import InputError

# largest number that a generated set may count to
_MOST = 100_000_000
# words of a generated set without its step
_ENDS = 2


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
    """What a deck holds.

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
        if word.upper() in self.node_sets:
            return self.node_sets[word.upper()]
        if not word.isdigit():
            raise card.refuse(f"the unknown set of nodes {word!r}", _listed(self.node_sets), place)
        return self._one(card, place, word, self.nodes, "node")

    def elements_of(self, card, place, word):
        """Elements of a set, or the one with a number.

        Raises
        ------
        InputError
        """
        if word.upper() in self.element_sets:
            return self.element_sets[word.upper()]
        if not word.isdigit():
            raise card.refuse(f"the unknown set of elements {word!r}", _listed(self.element_sets), place)
        return self._one(card, place, word, self.elements, "element")

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
    def _one(card, place, word, known, what):
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
# cards whose first line is no data of their keyword
_TITLES = ("HEADING",)


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
        deck.nodes[number] = (card.numbers(place, words[1:4]) + [0.0] * 3)[:3]
        members.append(number)
    _join(deck, deck.node_sets, card.get("NSET"), members)


def _element(deck, card):
    word = card.need("TYPE").upper()
    kind = kind_of(word)
    deck.element_cards.setdefault(word, card)
    held, members, place = [], [], card.place
    for row, words in card.rows:
        place = row if not held else place
        held += [card.integer(row, w) for w in words if w]
        if kind.n_nodes is None and words[-1]:
            deck.elements[held[0]] = word, held[1:]
        elif kind.n_nodes is not None and len(held) > kind.n_nodes:
            if len(held) > 1 + kind.n_nodes:
                raise card.refuse(f"{len(held) - 1} nodes of element {held[0]}", f"{kind.n_nodes} for {word}", place)
            deck.elements[held[0]] = kind.cell or word, held[1:]
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
