"""Keyword decks (.inp of Abaqus and CalculiX): cards with their parameters, data and lines."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from pcontact.runtime.errors import InputError
from pcontact.runtime.messages import CONTROL, input_error

# files that include each other
DEEPEST = 20


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
