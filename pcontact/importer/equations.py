"""Linear equations and cyclic symmetry of a deck as tables of a scene."""

import numpy as np

from pcontact.importer.faces import surface_faces
from pcontact.space.turn import Turn

# numbers of a term: node, degree of freedom, coefficient
_TERM = 3
# [extents of the surface] How far nodes may be from their partners where the deck does not say it
_NEAR = 1e-3


def equations(deck, findings, groups, supports, dim):
    """Tables [[equations]], with the card that each comes from.

    Parameters
    ----------
    deck : Deck
    findings : Findings
    groups : pcontact.importer.groups.Groups
    supports : pcontact.importer.supports.Supports
    dim : int

    Returns
    -------
    list of (dict, Card)
    """
    tables = []
    for card in [*deck.model, *(card for step in deck.steps for card in step.cards)]:
        if card.key != "EQUATION":
            continue
        findings.know(card, "INPUT", "REMOVE")
        if card.parameters:
            findings.leave(card, "allowed: the terms of equations, without parameters")
            continue
        findings.take(card)
        for place, terms in read_equations(card):
            for row in _one_by_one(deck, card, place, terms):
                table = _table(findings, card, place, row, (groups, supports, dim))
                tables += [] if table is None else [(table, card)]
    return tables


def read_equations(card):
    """Terms [(node or set, degree of freedom, coefficient)] of every equation of a card, with its place."""
    rows = iter([(place, [w for w in words if w]) for place, words in card.rows])
    for place, words in rows:
        if len(words) != 1 or not words[0].isdigit():
            raise card.refuse(", ".join(words), "the number of terms in a line of its own", place)
        wanted, held = _TERM * int(words[0]), []
        while len(held) < wanted:
            where, more = next(rows, (place, None))
            if more is None:
                raise card.refuse(f"{len(held) // _TERM} terms", f"{wanted // _TERM} terms", place)
            held += more
        if len(held) != wanted:
            raise card.refuse(f"{len(held)} numbers", f"{wanted}, three for each term", where)
        yield place, [(node, card.integer(place, dof), card.number(place, factor))
                      for node, dof, factor in zip(held[::3], held[1::3], held[2::3], strict=True)]  # fmt: skip


def equated(deck):
    """Nodes of all equations of a deck."""
    found = set()
    for card in [*deck.model, *(card for step in deck.steps for card in step.cards)]:
        if card.key == "EQUATION" and not card.parameters:
            found |= {node for place, terms in read_equations(card) for word, *_ in terms
                      for node in deck.nodes_of(card, place, word)}  # fmt: skip
    return found


def _one_by_one(deck, card, place, terms):
    """An equation of sets of nodes as equations of their nodes."""
    nodes = [deck.nodes_of(card, place, word) for word, _, _ in terms]
    count = max(map(len, nodes), default=0)
    if count == 0 or any(len(members) not in (1, count) for members in nodes):
        raise card.refuse("sets of different sizes, or of none", "nodes, or sets of one size", place)
    for k in range(count):
        yield [(members[k if len(members) > 1 else 0], dof, factor)
               for members, (_, dof, factor) in zip(nodes, terms, strict=True)]  # fmt: skip


def _table(findings, card, place, terms, scene):
    groups, supports, dim = scene
    lost = [node for node, dof, _ in terms if node not in supports.nodes or not 1 <= dof <= dim]
    if lost:
        findings.leave(card, f"node {lost[0]}, of no cell, or a degree of freedom beyond {dim}", place)
        return None
    if any(supports.frames.axes(node) is not None for node, *_ in terms):
        findings.leave(card, "nodes with local axes", place)
        return None
    named = [[groups.add("nodes", f"node_{node}", [node]), "xyz"[dof - 1], factor] for node, dof, factor in terms]
    return {"terms": [term for term in named if term[2] != 0.0]}


class Cyclic:
    """Parts of a deck that repeat about an axis (*TIE, CYCLIC SYMMETRY with *CYCLIC SYMMETRY MODEL)."""

    def __init__(self, deck, findings, groups):
        self.deck, self.findings, self.groups = deck, findings, groups
        self.models = {card.need("TIE").upper(): card for card in deck.model if card.key == "CYCLICSYMMETRYMODEL"
                       and card.get("TIE")}  # fmt: skip

    def tables(self):
        """Tables [[periodic]], with the card that each comes from."""
        found = []
        for card in self.deck.model:
            if card.key != "TIE" or "CYCLICSYMMETRY" not in card.parameters:
                continue
            model = self.models.get(card.need("NAME").upper())
            if model is None:
                self.findings.leave(card, "cyclic symmetry without its *CYCLIC SYMMETRY MODEL")
                continue
            self.findings.know(model, "N", "NGRAPH", "TIE", "ELSET")
            for place, words in card.rows:
                table = self._table(card, model, place, words)
                found += [] if table is None else [(table, card)]
        return found

    def _nodes(self, card, place, word):
        surface = self.deck.surface_of(card, place, word)
        nodes = surface.nodes or [n for row in surface_faces(self.deck, surface) for n in self.deck.face_nodes(*row)]
        self.findings.take(surface.card)
        return list(dict.fromkeys(nodes)), surface.name

    def _table(self, card, model, place, words):
        (dependent, name), (leading, other) = (self._nodes(card, place, word) for word in words[:2])
        first, second = np.array(model.numbers(*model.rows[0])[:6]).reshape(2, 3)
        axis = (second - first) / np.linalg.norm(second - first)
        count = model.number(model.place, model.need("N"))
        own, others = (np.array([self.deck.nodes[n] for n in nodes]) for nodes in (dependent, leading))
        value = card.number(place, card.get("POSITIONTOLERANCE", ""))
        within = value if value > 0.0 else _NEAR * float(np.ptp(own, axis=0).max())
        for angle in (360.0 / count, -360.0 / count):
            if _off(own, others, (first, axis), angle) <= within:
                self.findings.take(card, f"{name} as {other}, turned by {angle:g} degrees", place)
                self.findings.take(model)
                return {
                    "region": self.groups.add("nodes", name, dependent),
                    "partner": self.groups.add("nodes", other, leading),
                    "angle": angle, "point": first.tolist(), "axis": axis.tolist(), "within": within,
                }  # fmt: skip
        self.findings.leave(card, f"cyclic symmetry of nodes that are no pairs within {within:.3g}", place)
        return None


def _off(points, others, line, angle):
    """Largest distance of points (n, 3) from the nearest of others, turned about a line by degrees."""
    origin, axis = line
    turned = others + Turn(origin, axis, np.radians(angle)).displacement(others, 1.0)
    return max(float(np.linalg.norm(turned - point, axis=1).min()) for point in points)
