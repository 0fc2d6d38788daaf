"""Nodes and elements that a deck counts out (*NGEN, *NFILL, *NCOPY, *ELGEN, *ELCOPY)."""

import numpy as np

from pcontact.importer.systems import Motion, turned

# numbers of a line of *ELGEN: one element, and three rows of count and increments
_ELGEN = 10
# of *NGEN: ends and increment
_ENDS = 2


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
