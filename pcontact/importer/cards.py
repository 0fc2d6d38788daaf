"""Keyword decks (.inp of Abaqus and CalculiX): cards with their parameters, data and lines, in one mesh.

Places given in other coordinates (*SYSTEM, *NODE with SYSTEM) become those of the mesh. Of parts and instances (*PART,
*INSTANCE, *ASSEMBLY) every instance is a copy of its part, moved to its place; its sets and surfaces are called
"INSTANCE.NAME", and its nodes and elements have numbers of their own (Abaqus, Analysis User's Guide, "Assembly
definition").
"""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pcontact.material.orthotropic import frame
from pcontact.runtime.errors import CONTROL, InputError, input_error
from pcontact.space.supports import Turn

# files that include each other
DEEPEST = 20
# numbers of a line of *SYSTEM
_POINTS = 6
# parameters whose values are names of what a part or an instance defines
_NAMES = ("NSET", "ELSET", "SURFACE", "ORIENTATION", "REFNODE", "ROTNODE", "NODE", "ORIGIN", "ANALYTICALSURFACE",
          "OLDSET", "NEWSET")  # fmt: skip
# cards that define a name, with the parameter that has it
_DEFINES = {"NSET": "NSET", "ELSET": "ELSET", "NODE": "NSET", "ELEMENT": "ELSET", "NGEN": "NSET", "NFILL": "NSET",
            "ELGEN": "ELSET", "NCOPY": "NEWSET", "ELCOPY": "NEWSET", "SURFACE": "NAME",
            "ORIENTATION": "NAME"}  # fmt: skip
# axes of analytical surfaces of parts that do not say them
_FRAMES = {"CYLINDER": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0], "REVOLUTION": [0.0, 0.0, 0.0, 0.0, 1.0, 0.0]}
# lines of an instance that is turned; numbers of the second: two points of the axis, and the angle
_LINES, _TURN = 2, 7
# base of the numbers: those of instances have digits before those of their part
_BASE = 10


@dataclass(frozen=True, order=True)
class Place:
    """A line of a deck.

    Attributes
    ----------
    file : str
        Name of an included file; empty: the deck itself.
    line : int
        From 1.
    """

    file: str
    line: int

    def __str__(self):
        return f"{self.file} line {self.line}" if self.file else f"line {self.line}"


@dataclass(eq=False)
class Card:
    """A keyword with its parameters and the lines of data that follow.

    Attributes
    ----------
    key : str
        The keyword in capitals, without blanks and star, such as "CONTACTPAIR"; "" of what stands before any.
    title : str
        As it stands in the deck, without its parameters.
    parameters : dict of str to str
        Values as they stand there, by names in capitals without blanks; "" for those without a value.
    place : Place
    rows : list of (Place, list of str)
        Lines of data, cut at commas.
    path : pathlib.Path
        The file, for messages.
    """

    key: str
    title: str
    parameters: dict
    place: Place
    path: Path
    rows: list = field(default_factory=list)

    def get(self, name, default=None):
        """A parameter."""
        return self.parameters.get(name, default)

    def word(self, name, default=""):
        """A parameter in capitals without blanks."""
        return "".join(self.parameters.get(name, default).split()).upper()

    def refuse(self, found, allowed, place=None):
        """The error of a card that cannot be read."""
        return InputError(f"{self.path} {place or self.place}: {self.title}: found {found}; allowed: {allowed}")

    def need(self, name):
        """A parameter that must be there.

        Raises
        ------
        InputError
        """
        value = self.parameters.get(name, "")
        if not value:
            raise self.refuse(f"no {name}=", f"{self.title}, {name}=...")
        return value

    def numbers(self, place, words):
        """Words of a line as numbers; an empty one is 0.

        Raises
        ------
        InputError
        """
        return [self.number(place, word) for word in words]

    def number(self, place, word):
        """A word as a number, with Fortran's exponents; an empty one is 0.

        Raises
        ------
        InputError
        """
        try:
            value = float(word.lower().replace("d", "e")) if word else 0.0
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.refuse(repr(word), "a finite number", place)
        return value

    def integer(self, place, word):
        """A word as an integer.

        Raises
        ------
        InputError
        """
        try:
            return int(word)
        except ValueError:
            raise self.refuse(repr(word), "an integer", place) from None


def read_cards(path):
    """The cards of a deck, in their order, with those of the files that it includes.

    Parameters
    ----------
    path : pathlib.Path

    Returns
    -------
    list of Card

    Raises
    ------
    InputError
        A file cannot be read, has no keyword, or includes itself.
    """
    cards = []
    _read(Path(path), "", cards, 0, Path(path))
    if not any(card.key for card in cards):
        raise InputError(f"{path}: found no keyword; allowed: a deck, whose keywords begin with *")
    return cards


def _read(path, name, cards, depth, deck):
    if depth > DEEPEST:
        raise InputError(f"{deck}: {name}: found files that include each other; allowed: at most {DEEPEST} deep")
    lines, number = _lines(path), 0
    while number < len(lines):
        text, place = lines[number].strip(), Place(name, number + 1)
        number += 1
        if not text or text.startswith("**"):
            continue
        if CONTROL.search(text.replace("\t", " ")):
            raise input_error(f"{deck} {place}", "text", f"{text[:40]!r}, with a control character", "text")
        if not text.startswith("*"):
            if not cards:
                cards.append(Card("", text[:40], {}, place, deck))
            cards[-1].rows.append((place, [word.strip().strip('"') for word in text.split(",")]))
            continue
        while text.endswith(",") and number < len(lines):
            text += lines[number].strip()
            number += 1
        card = _card(text, place, deck)
        cards.append(card)
        if card.key == "INCLUDE":
            inner = card.need("INPUT").strip('"')
            if not (path.parent / inner).exists():
                raise card.refuse(f"{inner!r}, no such file", f"a file beside {path.name}")
            _read(path.parent / inner, inner, cards, depth + 1, deck)


def _lines(path):
    """Lines of a deck; what has no end, such as a device, is none."""
    try:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: found no regular file; allowed: a deck that can be read")
        return path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"{path}: found {str(error.strerror).lower()}; allowed: a deck that can be read") from None


def _card(text, place, path):
    title, *words = [word.strip() for word in text.split(",")]
    parameters = {}
    for word in filter(None, words):
        name, _, value = word.partition("=")
        parameters["".join(name.split()).upper()] = value.strip().strip('"')
    title = " ".join(title.split())
    return Card("".join(title[1:].split()).upper(), title, parameters, place, path)


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
        """Return the place that a point (3,) comes to."""
        moved = np.asarray(x) + self._shift
        return moved if self._turn is None else moved + self._turn.displacement(moved, 1.0)

    def direction(self, x):
        """Return what a direction (3,) becomes."""
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
    if not np.any(np.cross(along, towards)):
        raise card.refuse("points on one line", "three points that span a plane")
    return origin, frame(along, towards)


def _motion(card):
    """Return the place of an instance, from the lines of *INSTANCE: a translation, and a turn that follows it."""
    rows = [card.numbers(place, words) for place, words in card.rows if any(words)]
    shift = (rows[0] + [0.0] * 3)[:3] if rows else [0.0] * 3
    if len(rows) < _LINES:
        return Motion(shift)
    if len(rows[1]) != _TURN:
        raise card.refuse(f"{len(rows[1])} numbers", "two points of an axis and an angle", card.rows[1][0])
    return turned(card, card.rows[1][0], shift, rows[1])


class _Instance:
    """The cards of an instance, with its numbers and names.

    Parameters
    ----------
    card : Card
        *INSTANCE.
    cards : list of Card
        Of its part, and its own.
    offset : int
        What its numbers have more than those of its part.
    """

    def __init__(self, card, cards, offset):
        self.name, self.place, self.offset, self._cards = card.need("NAME"), _motion(card), offset, cards
        self.names = {one.get(_DEFINES[one.key]).upper() for one in cards
                      if one.key in _DEFINES and one.get(_DEFINES[one.key])}  # fmt: skip

    def word(self, word):
        """A name or a number in the instance as the assembly has it."""
        if word.upper() in self.names:
            return f"{self.name}.{word}"
        return str(int(word) + self.offset) if word.isdigit() else word

    def cards(self):
        """Cards of the instance as those of the assembly."""
        return [self._card(card) for card in self._cards]

    def rows(self, card):
        """Lines of a card, as the assembly has them."""
        if card.key in _ROWS:
            return _ROWS[card.key](self, card)
        ranges = "GENERATE" in card.parameters and card.key in ("NSET", "ELSET")
        return self._named(card, 2 if ranges else _NAMED[card.key]) if card.key in _NAMED else self._sets(card)

    def _card(self, card):
        parameters = {name: self.word(value) if name in _NAMES or name == _DEFINES.get(card.key) else value
                      for name, value in card.parameters.items()}  # fmt: skip
        return replace(card, parameters=parameters, rows=self.rows(card))

    def _sets(self, card):
        """Sets alone: numbers of other cards are values."""
        return [(place, [self.word(w) if not w.isdigit() else w for w in words]) for place, words in card.rows]

    def _named(self, card, count):
        """The first words of each line name nodes or elements, or all of them: None."""
        end = slice(None) if count is None else slice(count)
        return [(place, [*map(self.word, words[end]), *words[len(words[end]) :]]) for place, words in card.rows]

    def _node(self, card):
        rows = []
        for place, words in card.rows:
            x = (card.numbers(place, words[1:4]) + [0.0] * 3)[:3]
            rows.append((place, [self.word(words[0]), *map(repr, self.place.point(x).tolist())]))
        return rows

    def _equation(self, card):
        """Terms have three words each, a line with one word is their number."""
        return [(place, words if len([w for w in words if w]) == 1 else
                 [self.word(w) if k % 3 == 0 else w for k, w in enumerate(words)])
                for place, words in card.rows]  # fmt: skip

    def _surface(self, card):
        """Rows of elements; of an analytical surface points, in the plane or of its axes, as the part has them."""
        kind = card.word("TYPE", "ELEMENT")
        if kind == "SEGMENTS":
            return [(place, [words[0], *self._pairs(card, place, words)]) for place, words in card.rows]
        if kind not in _FRAMES:
            return self._named(card, 1)
        rows = [(place, words) for place, words in card.rows if any(words)]
        begin = next((k for k, (_, words) in enumerate(rows) if words[0].upper() == "START"), len(rows))
        numbers = [x for place, words in rows[:begin] for x in card.numbers(place, words)] or _FRAMES[kind]
        if len(numbers) % 3:
            raise card.refuse(f"{len(numbers)} numbers before START", "three of each point of its axes")
        points = [self.place.point(numbers[k : k + 3]).tolist() for k in range(0, len(numbers), 3)]
        return [(card.place, [repr(x) for x in point]) for point in points] + rows[begin:]

    def _pairs(self, card, place, words):
        """Points of the plane as the assembly has them."""
        numbers = card.numbers(place, words[1:-1] if words[-1:] == [""] else words[1:])
        if len(numbers) % 2:
            raise card.refuse(", ".join(words), "START, LINE, CIRCL or PARAB and two numbers a point", place)
        points = [self.place.point([*numbers[k : k + 2], 0.0])[:2] for k in range(0, len(numbers), 2)]
        return [repr(float(x)) for point in points for x in point]

    def _orientation(self, card):
        """Points of a cylinder's axis, or directions."""
        cylindrical = card.word("SYSTEM", "RECTANGULAR").startswith("C") or card.word("TYPE", "R").startswith("C")
        turn, rows = self.place.point if cylindrical else self.place.direction, list(card.rows)
        if rows:
            place, words = rows[0]
            numbers = card.numbers(place, words)
            points = [turn((numbers[k : k + 3] + [0.0] * 3)[:3]).tolist() for k in range(0, len(numbers), 3)]
            rows[0] = place, [repr(x) for point in points for x in point]
        return rows


# how lines of cards that speak of nodes or elements are read; names of sets are in any
_ROWS = {"NODE": _Instance._node, "SURFACE": _Instance._surface, "EQUATION": _Instance._equation,
         "ORIENTATION": _Instance._orientation, "TRANSFORM": _Instance._orientation}  # fmt: skip
# how many words of their lines do
_NAMED = {"ELEMENT": None, "NSET": None, "ELSET": None, "NGEN": 2, "ELGEN": 1, "BOUNDARY": 1}


def flat(cards):
    """Cards of one mesh.

    Parameters
    ----------
    cards : list of Card

    Returns
    -------
    list of Card
        The same where the deck has no instances. *PART, *INSTANCE and their ends stay, without what they hold.

    Raises
    ------
    InputError
        A part is not known, or something does not end.
    """
    if not any(card.key == "INSTANCE" for card in cards):
        return cards
    parts, found, own = {}, [], _Own(cards)
    rest = iter(cards)
    for card in rest:
        if card.key == "PART":
            parts[card.need("NAME").upper()] = list(_until(rest, card, "ENDPART", found))
        elif card.key == "INSTANCE":
            name = card.need("PART").upper()
            if name not in parts:
                raise card.refuse(f"the unknown part {card.get('PART')!r}", ", ".join(parts) or "a *PART before it")
            inner = [*parts[name], *_until(rest, card, "ENDINSTANCE", found)]
            found += own.instance(card, inner).cards()
        else:
            found.append(own.card(card))
    return found


def _until(rest, card, key, found):
    """Cards up to the one that ends; both go to the list."""
    found.append(replace(card, rows=[]))
    for one in rest:
        if one.key == key:
            found.append(one)
            return
        yield one
    raise card.refuse("no end of it", f"*{key.replace('END', 'END ')}")


class _Own:
    """Cards of the assembly and of the model, which speak of instances by name."""

    def __init__(self, cards):
        self.instances = {}
        numbers = [abs(int(words[0])) for card in cards if card.key in ("NODE", "ELEMENT") for _, words in card.rows
                   if words[0].isdigit()]  # fmt: skip
        self._step = _BASE ** len(str(max(numbers, default=1)))
        # nodes of the assembly keep their numbers, where there are any
        inside, self._count = False, 0
        for card in cards:
            inside = inside or card.key in ("PART", "INSTANCE")
            inside = inside and card.key not in ("ENDPART", "ENDINSTANCE")
            if not inside and card.key in ("NODE", "ELEMENT"):
                self._count = 1

    def instance(self, card, cards):
        """An instance."""
        one = _Instance(card, cards, self._count * self._step)
        self._count += 1
        self.instances[one.name.upper()] = one
        return one

    def _word(self, word):
        """INSTANCE.5 as the number of that node."""
        name, dot, number = word.rpartition(".")
        if dot and number.isdigit() and name.upper() in self.instances:
            return self.instances[name.upper()].word(number)
        return word

    def card(self, card):
        """A card of the assembly, or after it."""
        within = self.instances.get(card.get("INSTANCE", "").upper())
        if within is not None:
            inner = within.rows(card)
            return replace(card, rows=inner)
        if "INSTANCE" in card.parameters and card.key in ("NSET", "ELSET", "SURFACE"):
            raise card.refuse(f"the unknown instance {card.get('INSTANCE')!r}", ", ".join(self.instances))
        parameters = {name: self._word(value) if name in _NAMES else value for name, value in card.parameters.items()}
        return replace(card, parameters=parameters,
                       rows=[(place, [self._word(word) for word in words]) for place, words in card.rows])  # fmt: skip
