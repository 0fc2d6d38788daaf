"""Elements that steps take away and add: bodies that are there in some phases."""

from pcontact.importer.steps import is_static

# how elements may be added; without a word without strain
STRAIN_FREE, WITH_STRAIN = ("", "STRAINFREE"), "WITHSTRAIN"


class Presence:
    """Which elements are there in which static step.

    Elements that are there in none of them are taken out of the deck.

    Parameters
    ----------
    deck : pcontact.importer.deck.Deck
    findings : pcontact.importer.findings.Findings

    Attributes
    ----------
    gone : list of set of int
        Elements that are absent in each step.
    added : dict of int to Card
        What adds elements.
    """

    def __init__(self, deck, findings):
        self.gone, self.added, cards, absent = [], {}, [], set()
        for step in filter(is_static, deck.steps):
            absent = set(absent)
            for card in step.cards:
                if card.key == "MODELCHANGE" and card.word("TYPE") == "ELEMENT":
                    cards.append((card, self._take(deck, findings, card, absent, bool(self.gone))))
            self.gone.append(absent)
        never = set.intersection(*self.gone) if self.gone else set()
        for card, elements in cards:
            if elements and elements <= never:
                findings.change(card, "not there from the beginning; the surfaces that they have are in no contact")
            elif elements:
                findings.change(card, "what they have borne ramps to zero" if "REMOVE" in card.parameters else
                                "what else begins with the step does so along a ramp")  # fmt: skip
        if never:
            deck.remove(never)
            deck.removed = next(card for card, elements in cards if elements & never)

    def _take(self, deck, findings, card, absent, later):
        """Take elements out of those that are absent, or into them; the elements of the card."""
        findings.know(card, "TYPE", "ADD", "REMOVE")
        if not {"ADD", "REMOVE"} & set(card.parameters):
            findings.leave(card, "allowed: ADD or REMOVE")
            return set()
        elements = {e for place, words in card.rows for word in words if word
                    for e in deck.elements_of(card, place, word)}  # fmt: skip
        if "REMOVE" in card.parameters:
            absent |= elements
            return elements
        how = card.word("ADD")
        if how == WITH_STRAIN:
            findings.leave(card, "WITH STRAIN: the elements begin without strain")
        elif how not in STRAIN_FREE:
            findings.leave(card, f"ADD={card.get('ADD')}; allowed: STRAIN FREE")
        if later:
            self.added |= dict.fromkeys(elements & absent, card)
        absent -= elements
        return elements

    @property
    def changes(self):
        """Whether elements are there in some steps only."""
        return any(one != self.gone[0] for one in self.gone)

    def split(self, parts):
        """Parts (name, material, elements) of which all elements are there in the same steps."""
        if not self.changes:
            return parts
        found = []
        for name, material, cells in parts:
            kinds = {}
            for e in cells:
                kinds.setdefault(tuple(e in gone for gone in self.gone), []).append(e)
            found += [(name if k == 0 else f"{name}_{k + 1}", material, some) for k, some in enumerate(kinds.values())]
        return found

    def keys(self, cells, names, finite, findings):
        """Keys of the body of some elements that are there in the same steps.

        Parameters
        ----------
        cells : list of int
        names : list of str
            Of the phases.
        finite : bool
            Whether bodies have finite strain.
        findings : pcontact.importer.findings.Findings
        """
        there = [name for name, gone in zip(names, self.gone, strict=False) if cells[0] not in gone]
        if len(there) == len(names):
            return {}
        if finite and cells[0] in self.added:
            findings.change(self.added[cells[0]], "NLGEOM: elements that are added have small strain")
            return {"phases": there, "strain": "small"}
        return {"phases": there}
