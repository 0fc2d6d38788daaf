#!/usr/bin/env python3
"""Refine a deck uniformly: every cell becomes 8 (in the plane 4) cells of its kind, wedges too.

    python scripts/refine_deck.py DECK.inp -o FINER.inp [--times N]

Nodes and their numbers stay, new ones come after them, where the shape functions of their cell have them: curved edges
stay curved. A new node belongs to a set, or to the nodes that a line lists with the same values, if all nodes of the
edge, the face or the cell in which it lies do. Faces of surfaces and of pressures become the faces of the cells within
them. Forces at nodes and equations stay at the nodes that have them, but where equations say that all nodes of an edge
or a face move alike in a direction, new nodes there do too.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np

from pcontact.importer.constraints import read_equations
from pcontact.importer.deck import EDGES, VERTICES, faces, faces_of, kind_of, read_deck
from pcontact.runtime.errors import InputError

# reference vertices of cells
_SQUARE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=float)
_TRIANGLE = np.array([[0, 0], [1, 0], [0, 1]], dtype=float)


def _prism(base):
    return np.vstack([np.column_stack([base, np.full(len(base), z)]) for z in (-1.0, 1.0)])


_CORNERS = {
    "tri": _TRIANGLE, "qua": _SQUARE, "hex": _prism(_SQUARE), "wed": _prism(_TRIANGLE),
    "tet": np.vstack([np.zeros(3), np.eye(3)]),
}  # fmt: skip
WIDTH = 12  # digits after the point that tell places in a cell
PAIR = 2  # terms of an equation that says that two nodes move alike
PER_LINE = 8  # numbers in a line of a deck


def corners(cell):
    """Reference vertices (n, d) of a cell by meshio's name."""
    return _CORNERS[cell[:3]]


def linear(cell, points):
    """Shape functions of degree 1 (n, n_vertices) at points (n, d)."""
    kind, x = cell[:3], np.atleast_2d(points)
    if kind in ("tri", "tet"):
        return np.column_stack([1.0 - x.sum(axis=1), x])
    if kind == "wed":
        base = np.column_stack([1.0 - x[:, :2].sum(axis=1), x[:, :2]])
        return np.hstack([base * (0.5 * (1.0 - x[:, 2:])), base * (0.5 * (1.0 + x[:, 2:]))])
    return np.prod(0.5 * (1.0 + x[:, None, :] * corners(cell)[None]), axis=2)


def nodes_of(cell):
    """Reference places (n, d) of all nodes of a cell."""
    vertices = corners(cell)
    middles = [0.5 * (vertices[a] + vertices[b]) for a, b in EDGES.get(cell, ())]
    return np.vstack([vertices, *middles]) if middles else vertices


def _monomials(cell, points):
    """Values (n, n_nodes) of functions that span what the nodes of a cell of degree 2 can tell."""
    x, d = np.atleast_2d(points), corners(cell).shape[1]
    powers = list(itertools.product(range(3), repeat=d))
    if cell[:3] in ("tri", "tet"):
        powers = [p for p in powers if sum(p) <= 2]
    elif cell[:3] == "wed":
        powers = [p for p in powers if p[0] + p[1] <= 2 and (p[0] + p[1] < 2 or p[2] < 2)]
    else:
        # those of serendipity: squares in one direction only
        powers = [p for p in powers if sum(k == 2 for k in p) <= 1]
    return np.column_stack([np.prod(x ** np.array(p), axis=1) for p in powers])


def shapes(cell, points):
    """Shape functions (n, n_nodes) of a cell at points (n, d)."""
    if cell not in EDGES:
        return linear(cell, points)
    return _monomials(cell, points) @ np.linalg.inv(_monomials(cell, nodes_of(cell)))


def children(cell):
    """Affine parts of a cell: reference vertices (n_parts, n_vertices, d) of cells of the same kind."""
    vertices, kind = corners(cell), cell[:3]
    middle = {frozenset((a, b)): 0.5 * (vertices[a] + vertices[b]) for a in range(len(vertices)) for b in range(a)}

    def at(a, b=None):
        return vertices[a] if b is None else middle[frozenset((a, b))]

    if kind == "tet":
        first = [[at(k) if k == j else at(j, k) for j in range(4)] for k in range(4)]
        a, b, c, d, e, f = (at(*pair) for pair in ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)))
        return np.array(first + [[a, b, c, e], [a, c, d, e], [c, e, b, f], [c, d, e, f]])
    if kind == "tri":
        return np.array(_triangles())
    if kind == "wed":
        parts = []
        for z in (-1.0, 0.0):
            for base in _triangles():
                parts.append(np.vstack([np.column_stack([base, np.full(3, z + dz)]) for dz in (0.0, 1.0)]))
        return np.array(parts)
    d = vertices.shape[1]
    return np.array([0.5 * (vertices + np.array(way)) for way in itertools.product((-1.0, 1.0), repeat=d)])


def _triangles():
    a, b, c = _TRIANGLE
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    return [np.array(rows) for rows in ([a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab])]


class Pattern:
    """How the cells of a kind are cut.

    Attributes
    ----------
    places : ndarray (n, d)
        Reference places of all nodes of all parts, each once.
    parts : ndarray (n_parts, n_nodes)
        Rows of them.
    own : list of int
        Local node of the whole cell at each place, -1 where there is none.
    entity : list of tuple of int
        Local nodes of the whole cell on the edge, face or cell in which each place lies.
    key : list of tuple
        (vertex, weight) of each place, by which neighbours know it.
    faces : dict of int to list of (int, int)
        Part and its face, of each face of the whole cell.
    """

    def __init__(self, cell):
        whole, unit = children(cell), nodes_of(cell)
        # straight parts: their nodes lie where degree 1 has them
        every = np.array([linear(cell, unit) @ part for part in whole])
        flat = np.round(every.reshape(-1, every.shape[2]), WIDTH) + 0.0
        self.places, rows = np.unique(flat, axis=0, return_inverse=True)
        self.parts = rows.reshape(len(whole), -1)
        weights = np.round(linear(cell, self.places), WIDTH)
        nodes = linear(cell, unit) > 1e-9
        self.own = [self._same(unit, place) for place in self.places]
        inside = weights > 1e-9
        self.key = [tuple((int(v), float(row[v])) for v in np.flatnonzero(row)) for row in weights]
        self.entity = [tuple(np.flatnonzero(~(nodes & ~row).any(axis=1))) for row in inside]
        self.values, self.faces = shapes(cell, self.places), {}
        for number, face in enumerate(faces_of(cell)):
            outside = [v for v in range(len(corners(cell))) if v not in face]
            on = ~inside[:, outside].any(axis=1)
            self.faces[number] = [
                (part, k) for part, nodes in enumerate(self.parts)
                for k, local in enumerate(faces_of(cell)) if on[nodes[list(local)]].all()
            ]  # fmt: skip

    @staticmethod
    def _same(unit, place):
        at = np.flatnonzero(np.abs(unit - place).max(axis=1) < 1e-9)
        return int(at[0]) if len(at) else -1


class Finer:
    """The cells of a deck, each cut once.

    Attributes
    ----------
    nodes : dict of int to list of float
    types : dict of str to list of (int, list of int)
        Elements by the deck's type.
    parts : dict of int to list of int
        Elements that an element has become; of what is no cell: itself.
    """

    def __init__(self, deck):
        self.deck, self.nodes, self._number, self._members = deck, dict(deck.nodes), {}, {}
        self._patterns, self.types, self.parts = {}, {}, {}
        self._next, element = max(deck.nodes) + 1, max(deck.elements) + 1
        types = _types(deck)
        for number, (cell, nodes) in deck.elements.items():
            if cell not in VERTICES:
                self.types.setdefault(types[number], []).append((number, nodes))
                self.parts[number] = [number]
                continue
            if cell not in self._patterns:
                self._patterns[cell] = Pattern(cell)
            pattern = self._patterns[cell]
            rows = self._place(pattern, nodes)
            self.parts[number] = list(range(element, element + len(pattern.parts)))
            element += len(pattern.parts)
            for part, local in zip(self.parts[number], pattern.parts, strict=True):
                self.types.setdefault(types[number], []).append((part, [rows[k] for k in local]))

    def _place(self, pattern, nodes):
        """Numbers of the nodes at all places of a cell."""
        found, points = [], None
        for k, own in enumerate(pattern.own):
            if own >= 0:
                found.append(nodes[own])
                continue
            key = tuple(sorted((nodes[v], weight) for v, weight in pattern.key[k]))
            if key not in self._number:
                if points is None:
                    points = pattern.values @ np.array([self.deck.nodes[n] for n in nodes])
                self._number[key] = self._next
                self.nodes[self._next] = points[k].tolist()
                self._members[self._next] = frozenset(nodes[n] for n in pattern.entity[k])
                self._next += 1
            found.append(self._number[key])
        return found

    def with_new(self, nodes):
        """Nodes, and the new ones in edges, faces and cells all of whose nodes are among them."""
        inside = set(nodes)
        return [*nodes, *(new for new, of in self._members.items() if of <= inside)]

    def faces(self, rows):
        """Faces [(element, face)] of the parts within faces of cells."""
        found = []
        for element, face in rows:
            pattern = self._patterns[self.deck.elements[element][0]]
            found += [(self.parts[element][part], k) for part, k in pattern.faces[face]]
        return found


def _types(deck):
    """Types of all elements, by their numbers."""
    found = {}
    for card in deck.cards:
        if card.key == "ELEMENT":
            word, held = card.need("TYPE").upper(), []
            width = kind_of(word).n_nodes
            for place, words in card.rows:
                held += [card.integer(place, w) for w in words if w]
                if width is None or len(held) > width:
                    found[held[0]] = word
                    held = []
    return found


def _lists(numbers):
    numbers = list(numbers)
    return [", ".join(map(str, numbers[k : k + PER_LINE])) + "," for k in range(0, len(numbers), PER_LINE)]


class Writer:
    """Lines of the refined deck."""

    # what a line says of nodes: rows with the same values are one
    _OF_NODES = ("BOUNDARY", "TEMPERATURE", "INITIALCONDITIONS")

    def __init__(self, deck):
        self.deck, self.finer, self.lines, self._sets = deck, Finer(deck), [], 0
        self._done = set()
        for card in deck.cards:
            self._card(card)

    def _title(self, card, **changed):
        words = [card.title]
        for name, value in {**card.parameters, **changed}.items():
            words.append(f"{name}={value}" if value else name)
        return ", ".join(words)

    def _card(self, card):
        if card.key in ("NODE", "ELEMENT", "NSET", "ELSET"):
            if card.key in ("NODE", "ELEMENT") and card.key not in self._done:
                self._done.add(card.key)
                (self._nodes if card.key == "NODE" else self._elements)()
        elif card.key == "SURFACE":
            self._surface(card)
        elif card.key == "CLOAD":
            self._say(card, [(n, words[1:]) for place, words in card.rows
                             for n in self.deck.nodes_of(card, place, words[0])])  # fmt: skip
        elif card.key in self._OF_NODES and card.rows:
            self._values(card)
        elif card.key == "DLOAD":
            self._pressures(card)
        elif card.key == "EQUATION":
            self._equations(card)
        elif card.key and card.key != "INCLUDE":
            self.lines.append(self._title(card))
            self.lines += [", ".join(words) for _, words in card.rows]

    def _say(self, card, rows):
        self.lines.append(self._title(card))
        self.lines += [", ".join([str(name), *words]) for name, words in rows]

    def _nodes(self):
        self.lines.append("*NODE")
        self.lines += [f"{n}, {', '.join(map(repr, x))}" for n, x in self.finer.nodes.items()]

    def _elements(self):
        for word, rows in self.finer.types.items():
            self.lines.append(f"*ELEMENT, TYPE={word}")
            for number, nodes in rows:
                self.lines += self._cut([number, *nodes])
        for name, members in self.deck.node_sets.items():
            self._set("NSET", name, self.finer.with_new(members))
        for name, members in self.deck.element_sets.items():
            self._set("ELSET", name, [part for e in members for part in self.finer.parts[e]])

    @staticmethod
    def _cut(numbers):
        rows = [", ".join(map(str, numbers[k : k + PER_LINE])) for k in range(0, len(numbers), PER_LINE)]
        return [row + "," for row in rows[:-1]] + rows[-1:]

    def _set(self, kind, name, members):
        self.lines.append(f"*{kind}, {kind}={name}")
        self.lines += _lists(members)

    def _new_set(self, members):
        self._sets += 1
        name = f"REFINED{self._sets}"
        self._set("NSET", name, members)
        return name

    def _surface(self, card):
        surface = self.deck.surfaces[card.need("NAME").upper()]
        if card.word("TYPE", "ELEMENT") == "NODE":
            members = [n for place, words in card.rows for w in words if w
                       for n in self.deck.nodes_of(card, place, w)]  # fmt: skip
            name = self._new_set(self.finer.with_new(list(dict.fromkeys(members))))
            self._say(card, [(name, [])])
        elif surface.card is card:
            self._say(card, [(e, [f"S{face + 1}"]) for e, face in self.finer.faces(surface.faces)])

    def _values(self, card):
        """Rows that say the same of their nodes, as one of a set."""
        groups = {}
        for place, words in card.rows:
            groups.setdefault(tuple(words[1:]), []).extend(self.deck.nodes_of(card, place, words[0]))
        rows = [(self._new_set(self.finer.with_new(list(dict.fromkeys(members)))), list(words))
                for words, members in groups.items()]  # fmt: skip
        self._say(card, rows)

    def _equations(self, card):
        """The equations, and those of new nodes in edges and faces whose nodes move alike."""
        self.lines.append(self._title(card))
        self.lines += [", ".join(words) for _, words in card.rows]
        alike = {}
        for _, terms in read_equations(card):
            if len(terms) == PAIR and terms[0][1] == terms[1][1] and terms[0][2] == -terms[1][2]:
                a, b = (self.deck.nodes_of(card, card.place, word)[0] for word, *_ in terms)
                sets = [members for members in alike.setdefault(terms[0][1], []) if members & {a, b}]
                alike[terms[0][1]] = [one for one in alike[terms[0][1]] if one not in sets]
                alike[terms[0][1]].append(set().union({a, b}, *sets))
        for dof, sets in alike.items():
            for members in sets:
                for new in self.finer.with_new(members):
                    if new not in members:
                        self.lines += [f"{PAIR}", f"{new}, {dof}, 1., {min(members)}, {dof}, -1."]

    def _pressures(self, card):
        rows = []
        for place, words in card.rows:
            elements = self.deck.elements_of(card, place, words[0])
            if words[1][:1].upper() == "P" and words[1][1:].isdigit():
                found = self.finer.faces(faces(self.deck, card, place, words[1], elements))
                rows += [(e, [f"P{face + 1}", *words[2:]]) for e, face in found]
            else:
                rows += [(part, words[1:]) for e in elements for part in self.finer.parts[e]]
        self._say(card, rows)


def refine(path, target):
    """Write a deck with its cells cut once.

    Parameters
    ----------
    path, target : pathlib.Path

    Raises
    ------
    InputError
        It has pyramids.
    """
    deck = read_deck(path)
    if any(cell == "pyramid" for cell, _ in deck.elements.values()):
        raise InputError(f"{path}: found pyramids; allowed: cells that are cut into cells of their own kind")
    target.write_text("\n".join([*Writer(deck).lines, ""]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("deck", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--times", type=int, default=1, help="how often every cell is cut")
    options = parser.parse_args()
    source = options.deck
    for _ in range(options.times):
        refine(source, options.output)
        source = options.output


if __name__ == "__main__":
    main()
