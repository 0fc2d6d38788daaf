"""Decks of parts and instances (*PART, *INSTANCE, *ASSEMBLY) as decks of one mesh.

Every instance is a copy of its part, moved to its place. Its sets and surfaces are called "INSTANCE.NAME", and its
nodes and elements have numbers of their own (Abaqus, Analysis User's Guide, "Assembly definition").
"""

from dataclasses import replace

from pcontact.importer.systems import Motion, turned

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


def _motion(card):
    """Where an instance stands, from the lines of *INSTANCE: a translation, and a turn that follows it."""
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
        return _ROWS.get(card.key, _Instance._sets)(self, card)

    def _card(self, card):
        parameters = {name: self.word(value) if name in _NAMES or name == _DEFINES.get(card.key) else value
                      for name, value in card.parameters.items()}  # fmt: skip
        return replace(card, parameters=parameters, rows=self.rows(card))

    def _sets(self, card):
        """Sets alone: numbers of other cards are values."""
        return [(place, [self.word(w) if not w.isdigit() else w for w in words]) for place, words in card.rows]

    def _first(self, card):
        return [(place, [self.word(words[0]), *words[1:]]) for place, words in card.rows]

    def _node(self, card):
        rows = []
        for place, words in card.rows:
            x = (card.numbers(place, words[1:4]) + [0.0] * 3)[:3]
            rows.append((place, [self.word(words[0]), *map(repr, self.place.point(x).tolist())]))
        return rows

    def _element(self, card):
        return [(place, [self.word(w) for w in words]) for place, words in card.rows]

    def _set(self, card):
        return self._range(card) if "GENERATE" in card.parameters else self._element(card)

    def _range(self, card):
        return [(place, [*map(self.word, words[:2]), *words[2:]]) for place, words in card.rows]

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
            return self._first(card)
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
_ROWS = {"NODE": _Instance._node, "ELEMENT": _Instance._element, "NSET": _Instance._set, "ELSET": _Instance._set,
         "NGEN": _Instance._range, "ELGEN": _Instance._first, "SURFACE": _Instance._surface,
         "BOUNDARY": _Instance._first, "EQUATION": _Instance._equation, "ORIENTATION": _Instance._orientation,
         "TRANSFORM": _Instance._orientation}  # fmt: skip


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
