"""Bolts of a deck that are drawn across a surface (*PRE-TENSION SECTION), as tables [[pretensions]]."""

import numpy as np

from pcontact.importer.faces import outward
from pcontact.importer.history import factors

# degree of freedom of the reference node along the normal
ALONG = 0


class Pretensions:
    """Sections, with the reference nodes whose forces and displacements are those along their normals.

    Parameters
    ----------
    deck : Deck
    findings : Findings
    groups : pcontact.importer.groups.Groups
    """

    def __init__(self, deck, findings, groups):
        self.deck, self.findings, self.groups = deck, findings, groups
        self.sections = {}
        for card in deck.model:
            if card.key == "PRE-TENSIONSECTION":
                self._read(card)

    def _read(self, card):
        self.findings.know(card, "SURFACE", "NODE")
        if not card.get("SURFACE"):
            self.findings.leave(card, "allowed: a section across a surface")
            return
        surface = self.deck.surface_of(card, card.place, card.need("SURFACE"))
        node = card.integer(card.place, card.need("NODE"))
        if node not in self.deck.nodes:
            raise card.refuse(f"node {node}, which the deck does not have", "a node of the deck")
        if not surface.faces:
            self.findings.leave(card, f"surface {surface.name} has no facets of solids")
            return
        self.sections[node] = card, surface
        self.findings.take(surface.card)

    @property
    def nodes(self):
        """Reference nodes."""
        return set(self.sections)

    def _sign(self, card, surface):
        """1 where the normal of the deck points out of the elements whose faces these are, else -1.

        A force along it then draws both sides together; without one the normal is that of the surface.
        """
        if not card.rows or not any(card.rows[0][1]):
            return 1.0
        normal = np.array((card.numbers(*card.rows[0]) + [0.0] * 3)[:3])
        return 1.0 if normal @ np.mean([outward(self.deck, row) for row in surface.faces], axis=0) > 0.0 else -1.0

    def tables(self, supports, end, phases=()):
        """Tables [[pretensions]], with the card that each comes from.

        Parameters
        ----------
        supports : pcontact.importer.supports.Supports
        end : float
            Of the run; infinite where every table is to say its amplitude.
        phases : sequence of str
            Names of the phases, a step each.

        Returns
        -------
        list of (dict, Card)
        """
        found = []
        for node, (card, surface) in self.sections.items():
            kinds = {"force": supports.forces, "shortening": supports.held}
            histories = {key: of.histories.pop((node, ALONG), None) for key, of in kinds.items()}
            said = {key: one for key, one in histories.items() if one is not None and one.most != 0.0}
            supports.card_of.pop((node, ALONG), None)
            steps = supports.active.pop((node, ALONG), None)
            if len(said) > 1 or (steps is not None and phases and len(steps) != len(phases)):
                self.findings.leave(card, "a section that a force draws in one step, and a length in another")
                continue
            if not said and histories["shortening"] is None:
                self.findings.leave(card, "a section that nothing draws: its sides part freely")
                continue
            key, history = next(iter(said.items()), ("shortening", None))
            most = 0.0 if history is None else history.most
            one = {"region": self.groups.add("facets", surface.name, surface.faces)}
            one[key] = self._sign(card, surface) * most
            table = None if history is None else factors(history.key(), most, end)
            if table is not None:
                one["amplitude"] = [list(row) for row in table]
            self.findings.take(card)
            found.append((one, card))
        return found
