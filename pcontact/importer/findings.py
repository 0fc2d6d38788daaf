"""What became of every card of a deck: taken, changed, left out, or without effect on the answer."""

from dataclasses import dataclass, field

TAKEN, CHANGED, LEFT_OUT, NO_EFFECT = "taken", "changed", "left out", "without effect"
# in the order of their weight, with what they mean
KINDS = {
    LEFT_OUT: "not in the scene: its answer is that of another problem",
    CHANGED: "in the scene, in another way",
    TAKEN: "in the scene",
    NO_EFFECT: "has no influence on the answer",
}


@dataclass
class Findings:
    """Findings, by the line of the deck.

    Attributes
    ----------
    rows : list of (str, Place, str, str)
        Kind, line, what stands there, what was made of it, or why not.
    """

    rows: list = field(default_factory=list)

    def add(self, kind, card, words="", place=None):
        """Say what became of a card, or of a line of it."""
        row = (kind, place or card.place, card.title, words)
        if row not in self.rows:
            self.rows.append(row)

    def take(self, card, words="", place=None):
        """It is in the scene as it stands in the deck."""
        self.add(TAKEN, card, words, place)

    def change(self, card, words, place=None):
        """It is in the scene in another way."""
        self.add(CHANGED, card, words, place)

    def leave(self, card, words, place=None):
        """It is not in the scene."""
        self.add(LEFT_OUT, card, words, place)

    def skip(self, card, words="", place=None):
        """It has no influence on the answer."""
        self.add(NO_EFFECT, card, words, place)

    def know(self, card, *names):
        """Parameters of a card that are understood; each other one is left out."""
        for name, value in card.parameters.items():
            if name not in names:
                self.leave(card, f"{name}={value}" if value else name)

    def unsaid(self, cards):
        """Cards of which nothing has been said: nothing is dropped without a word."""
        said = {(row[1], row[2]) for row in self.rows}
        titles = {row[1] for row in self.rows}
        for card in cards:
            places = {place for place, _ in card.rows} | {card.place}
            if (card.place, card.title) not in said and not places & titles:
                self.leave(card, "not known")

    @property
    def complete(self):
        """bool : whether nothing was left out."""
        return not self.of(LEFT_OUT)

    def of(self, kind):
        """Rows of a kind, by line."""
        return sorted((row for row in self.rows if row[0] == kind), key=lambda row: row[1])

    def lines(self, kinds=tuple(KINDS)):
        """The list in words, heaviest first."""
        words = []
        for kind in kinds:
            rows = self.of(kind)
            if rows:
                words += [f"{kind} ({KINDS[kind]}):"]
                words += [f"  {place}: {title}" + (f": {text}" if text else "") for _, place, title, text in rows]
        return words
