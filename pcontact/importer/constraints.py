"""Ties of a deck, as tables of a scene: equations, cyclic symmetry, sections of bolts (*PRE-TENSION SECTION)
and groups that hang on a reference node (*RIGID BODY, *COUPLING and their older forms).
"""

from dataclasses import dataclass

import numpy as np

from pcontact.importer.deck import RIGID as ELEMENTS
from pcontact.importer.deck import outward, surface_faces
from pcontact.importer.history import amplitude_key
from pcontact.space.supports import Turn

# numbers of a term: node, degree of freedom, coefficient
_TERM = 3
# [extents of the surface] How far nodes may be from their partners where the deck does not say it
_NEAR = 1e-3
# degree of freedom of the reference node along the normal
ALONG = 0
RIGID, MEAN, TOOL = "rigid", "mean", "tool"
# degrees of freedom of a node with rotations; translations come first
ALL, MOVES = tuple(range(6)), 3
# the rotation in the plane
_IN_PLANE = 5


def equations(deck, findings, groups, supports, dim):
    """Tables [[equations]], with the card that each comes from.

    Parameters
    ----------
    deck : Deck
    findings : Findings
    groups : pcontact.importer.groups.Groups
    supports : pcontact.importer.supports.Supports
    dim : int

    Yields
    ------
    dict, Card
    """
    for card in _cards(deck):
        findings.know(card, "INPUT", "REMOVE")
        if card.parameters:
            findings.leave(card, "allowed: the terms of equations, without parameters")
            continue
        findings.take(card)
        for place, terms in read_equations(card):
            for row in _one_by_one(deck, card, place, terms):
                table = _table(findings, card, place, row, (groups, supports, dim))
                if table is not None:
                    yield table, card


def _cards(deck):
    """All cards of equations."""
    return [card for card in (*deck.model, *(card for step in deck.steps for card in step.cards))
            if card.key == "EQUATION"]  # fmt: skip


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
    return {node for card in _cards(deck) if not card.parameters
            for place, terms in read_equations(card) for word, *_ in terms
            for node in deck.nodes_of(card, place, word)}  # fmt: skip


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
        self.models = {one.need("TIE").upper(): one for one in deck.cards_of("CYCLICSYMMETRYMODEL") if one.get("TIE")}

    def tables(self):
        """Tables [[periodic]], with the card that each comes from."""
        for card in self.deck.cards_of("TIE"):
            if "CYCLICSYMMETRY" not in card.parameters:
                continue
            model = self.models.get(card.need("NAME").upper())
            if model is None:
                self.findings.leave(card, "cyclic symmetry without its *CYCLIC SYMMETRY MODEL")
                continue
            self.findings.know(model, "N", "NGRAPH", "TIE", "ELSET")
            for place, words in card.rows:
                table = self._table(card, model, place, words)
                if table is not None:
                    yield table, card

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
        for card in deck.cards_of("PRE-TENSIONSECTION"):
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

        Yields
        ------
        dict, Card
        """
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
            self.findings.take(card)
            yield one | amplitude_key(None if history is None else history.amplitude(end)), card


@dataclass(eq=False)
class Reference:
    """A reference node.

    Attributes
    ----------
    node : int
    kind : str
        `RIGID`, `MEAN` or `TOOL`.
    card : Card
    name : str
        In the report.
    group : str
        Name of the set or surface.
    members : tuple of (str, list)
        Kind of a group, and its members: see :meth:`pcontact.importer.groups.Groups.add`; of a tool its obstacles.
    turn : int or None
        Node whose translations are the rotations, in decks of CalculiX.
    """

    node: int
    kind: str
    card: object
    name: str
    group: str
    members: tuple
    turn: int | None = None

    def dofs(self):
        """Degrees of freedom of the deck (node, number) that prescribe and load it, to its own, from 0."""
        own = {(self.node, k): k for k in ALL}
        return own | ({} if self.turn is None else {(self.turn, k): MOVES + k for k in range(MOVES)})


class References:
    """Reference nodes of a deck.

    Parameters
    ----------
    deck : Deck
    findings : Findings
    groups : pcontact.importer.groups.Groups
    solids : set of int
        Elements that are cells of bodies.
    tools : pcontact.importer.tools.Tools
        Rigid surfaces that are in contact.
    """

    def __init__(self, deck, findings, groups, solids, tools):
        self._tools = tools
        self.deck, self.findings, self.groups, self._solids = deck, findings, groups, solids
        self._nodes = {node for e in solids for node in deck.elements[e][1]}
        self.all = []
        rest = [*deck.model, None]
        for card, following in zip(rest, rest[1:], strict=False):
            if card.key == "RIGIDBODY":
                self._rigid(card)
            elif card.key == "COUPLING":
                self._coupling(card, following)
            elif card.key == "KINEMATICCOUPLING":
                self._old(card)
            elif card.key == "DISTRIBUTINGCOUPLING":
                self._distributing(card)

    def dofs(self):
        """Degrees of freedom of all of them: (node, degree of freedom) of the deck to (node, its own), from 0."""
        return {key: (one.node, own) for one in self.all for key, own in one.dofs().items()}

    def _add(self, card, kind, node, names, members):
        """Another one, with its name and that of its group."""
        if not members[1]:
            self.findings.leave(card, f"{names[1]}: no nodes of solids")
            return None
        one = Reference(node, kind, card, *names, members)
        self.all.append(one)
        return one

    def _node(self, card, name):
        nodes = self.deck.nodes_of(card, card.place, card.need(name))
        if len(nodes) != 1:
            raise card.refuse(f"{name} = {card.get(name)!r} with {len(nodes)} nodes", "one node")
        return nodes[0]

    def _set(self, card):
        """Name of the set in the only line, or of none."""
        word = card.rows[0][1][0] if len(card.rows) == 1 else ""
        return self.deck.name(word) if word.upper() in self.deck.node_sets else "coupling"

    def _rigid(self, card):
        self.findings.know(card, "REFNODE", "ROTNODE", "NSET", "ELSET", "TIENSET", "PINNSET", "POSITION",
                           "ANALYTICALSURFACE")  # fmt: skip
        if self._tool(card):
            return
        if card.word("POSITION", "INPUT") != "INPUT":
            self.findings.leave(card, "POSITION: the reference node stays where it is")
        name = next((name for name in ("ELSET", "NSET", "TIENSET", "PINNSET") if name in card.parameters), None)
        if name is None:
            self.findings.leave(card, "allowed: ELSET, NSET, TIE NSET, PIN NSET")
            return
        word, node = card.need(name), self._node(card, "REFNODE")
        if name == "ELSET":
            cells = [e for e in self.deck.elements_of(card, card.place, word) if e in self._solids]
            members = ("cells", cells)
        else:
            members = ("nodes", [n for n in self.deck.nodes_of(card, card.place, word) if n in self._nodes])
        one = self._add(card, RIGID, node, [self.deck.name(word)] * 2, members)
        if one is not None and "ROTNODE" in card.parameters:
            one.turn = self._node(card, "ROTNODE")

    def _tool(self, card):
        """Return whether a rigid body is a rigid surface."""
        tables, name = [], card.get("ANALYTICALSURFACE", "")
        if name:
            tables += [self._tools.used[name.upper()].table] if name.upper() in self._tools.used else []
        if card.get("ELSET"):
            own = {e for e in self.deck.elements_of(card, card.place, card.need("ELSET"))
                   if self.deck.elements[e][0] in ELEMENTS}  # fmt: skip
            name = name or (card.get("ELSET") if own else "")
            tables += [tool.table for key, tool in self._tools.used.items() if own & set(self.deck.surfaces[key].sides)]
        if not name:
            return False
        if tables:
            one = Reference(self._node(card, "REFNODE"), TOOL, card, name, name, ("tools", tables))
            if "ROTNODE" in card.parameters:
                one.turn = self._node(card, "ROTNODE")
            self.all.append(one)
        else:
            self.findings.skip(card, f"{name} is in no contact")
        return True

    def _coupling(self, card, following):
        self.findings.know(card, "CONSTRAINTNAME", "REFNODE", "SURFACE", "ORIENTATION", "INFLUENCERADIUS")
        self.findings.take(card)
        if following is None or following.key not in ("KINEMATIC", "DISTRIBUTING"):
            raise card.refuse("no card that says its kind", "*KINEMATIC or *DISTRIBUTING after it")
        for name in ("ORIENTATION", "INFLUENCERADIUS"):
            if name in card.parameters:
                self.findings.leave(card, f"{name}: directions are those of the mesh, and the whole surface is coupled")
        surface = self.deck.surface_of(card, card.place, card.need("SURFACE"))
        faces = [row for row in surface_faces(self.deck, surface) if row[0] in self._solids]
        whole = not surface.nodes or {n for row in faces for n in self.deck.face_nodes(*row)} >= set(surface.nodes)
        nodes = [n for n in surface.nodes if n in self._nodes]
        members = ("facets", faces) if faces and whole else ("nodes", nodes)
        kind = RIGID if following.key == "KINEMATIC" else MEAN
        self._said(following, kind, self._dofs(following))
        names = card.get("CONSTRAINTNAME") or surface.name, surface.name
        self._add(card, kind, self._node(card, "REFNODE"), names, members)
        self.findings.take(surface.card)

    def _dofs(self, card):
        """Degrees of freedom of lines of first and last one."""
        found = []
        for place, words in card.rows:
            ends = [card.integer(place, word) for word in words if word]
            found += range(ends[0], ends[-1] + 1) if ends else ()
        return found

    def _said(self, card, kind, dofs):
        """Return the degrees of freedom that are coupled: all that solids have, or it is another coupling."""
        self.findings.know(card, "COUPLING", "WEIGHTINGMETHOD", "REFNODE")
        wanted = set(range(1, MOVES + 1))
        if dofs and not wanted <= set(dofs):
            words = f"degrees of freedom {', '.join(map(str, dofs))} alone: all of them are coupled here"
            self.findings.leave(card, words)
        elif kind == MEAN:
            self.findings.take(card, "on average, by area")
        else:
            self.findings.take(card, "rigid")

    def _old(self, card):
        """*KINEMATIC COUPLING: rows of nodes with first and last degree of freedom."""
        nodes, dofs = [], set()
        for place, words in card.rows:
            nodes += [n for n in self.deck.nodes_of(card, place, words[0]) if n in self._nodes]
            ends = [card.integer(place, word) for word in words[1:3] if word]
            dofs |= set(range(ends[0], ends[-1] + 1)) if ends else set(range(1, MOVES + 1))
        self._said(card, RIGID, sorted(dofs))
        self._add(card, RIGID, self._node(card, "REFNODE"), [self._set(card)] * 2, ("nodes", nodes))

    def _distributing(self, card):
        """*DISTRIBUTING COUPLING: an element of one node, and rows of nodes with weights."""
        self.findings.know(card, "ELSET")
        elements = self.deck.elements_of(card, card.place, card.need("ELSET"))
        nodes, weights = [], []
        for place, words in card.rows:
            own = [n for n in self.deck.nodes_of(card, place, words[0]) if n in self._nodes]
            nodes += own
            weights += [card.number(place, words[1]) if len(words) > 1 else 1.0] * len(own)
        if len(set(weights)) > 1:
            self.findings.leave(card, "weights that differ: all nodes have the same")
        self.findings.take(card, "on average, every node by the same part")
        self._add(card, MEAN, self.deck.elements[elements[0]][1][0], [self._set(card)] * 2, ("nodes", nodes))

    def tables(self, supports, run, dim, thickness):
        """Tables of the scene by their headers, with the card that each comes from.

        Parameters
        ----------
        supports : pcontact.importer.supports.Supports
            Which lose what they have of the reference nodes.
        run : pcontact.importer.steps.Run
        dim : int
        thickness : float
            Of a plane mesh.

        Returns
        -------
        dict of str to list of (dict, Card)
        """
        found = {"[[couplings]]": [], "[[loads]]": [], "[[displacements]]": []}
        for one in self.all:
            held = {k: supports.held.histories.pop((one.node, k), None) for k in ALL}
            active = [supports.active.pop((one.node, k), ()) for k in ALL if held[k] is not None]
            forces = {k: supports.forces.histories.pop((one.node, k), None) for k in ALL}
            for k in ALL:
                supports.card_of.pop((one.node, k), None)
            if any(len(steps) != supports.count for steps in active):
                self.findings.leave(one.card, "a reference node whose supports begin or end with a step")
            if one.kind == TOOL:
                self._move(one, held, forces, (dim, run.ramp_end))
                continue
            group = self.groups.add(one.members[0], one.group, one.members[1])
            point = self.deck.nodes[one.node][:dim]
            most, table = self._shape(one, held, run.ramp_end)
            base = {"region": group, "point": list(point)}
            if one.name != group:
                base["name"] = one.name
            motion = _components(most, dim)
            amplitude = amplitude_key(table)
            if one.kind == RIGID:
                header, made = self._rigid_table(one, base, motion, amplitude, run.finite is not None)
                found[header].append((made, one.card))
            elif any(value is not None for value in most.values()):
                made = self._rigid_table(one, base, motion, amplitude, False)[1]
                found["[[couplings]]"].append(({**made, "average": True}, one.card))
            cards = [supports.forces.now[one.node, k].card for k in ALL if forces[k] is not None]
            for history in filter(None, forces.values()):
                history.points = [(time, value / thickness) for time, value in history.points]
            loads = self._loads(one, base, forces, dim, run.ramp_end)
            found["[[loads]]"] += [(load, cards[0]) for load in loads]
            if one.kind == RIGID:
                self.findings.take(one.card)
        return found

    def _move(self, one, held, forces, scene):
        """Displacement and turn of obstacles; a turn is about the reference node, which moves along."""
        dim, end = scene
        most, table = self._shape(one, held, end)
        moves, turns = _components(most, dim)
        free = [f"direction {'xyz'[k]}" for k in range(dim) if moves[k] == "free"]
        if free or any(history is not None and history.most != 0.0 for history in forces.values()):
            words = f"a rigid surface that is free in {', '.join(free)}" if free else "forces on a rigid surface"
            self.findings.leave(one.card, f"{words}: it moves as it is prescribed, and stands still where it is not")
        turn = np.array([0.0 if angle == "free" else angle for angle in turns])
        motion = {"displacement": [0.0 if x == "free" else x for x in moves]}
        if not any(motion["displacement"]):
            motion = {}
        if np.any(turn):
            size = float(np.linalg.norm(turn)) if dim > 2 else float(turn[0])
            motion |= {"angle": float(np.degrees(size)), "pivot": list(self.deck.nodes[one.node][:dim])}
            motion |= {"turn_axis": (turn / size).tolist()} if dim > 2 else {}
        motion |= amplitude_key(table) if motion else {}
        for obstacle in one.members[1]:
            obstacle |= motion
        self.findings.take(one.card, "a rigid surface")

    def _rigid_table(self, one, base, motion, amplitude, finite):
        """Header and table of a rigid group; with finite strain it does not turn, or all of its motion is given."""
        moves, turns = motion
        # what is free is true
        small = finite and any(turns) and "free" in (*moves, *turns)
        if small:
            self.findings.leave(one.card, "NLGEOM: a rigid group that turns freely turns by small angles")
        if small or not finite or not any(turns):
            table = {**base, "displacement": moves, "rotation": turns if len(turns) > 1 else turns[0], **amplitude}
            return "[[couplings]]", table
        turn = np.array(turns if len(turns) > 1 else [0.0, 0.0, turns[0]])
        angle = float(np.linalg.norm(turn))
        table = {"region": base["region"], "value": moves, "point": base["point"], **amplitude}
        if len(turns) > 1:
            return "[[displacements]]", table | {"angle": float(np.degrees(angle)), "axis": (turn / angle).tolist()}
        return "[[displacements]]", table | {"angle": float(np.degrees(turns[0]))}

    def _shape(self, one, histories, end):
        """Largest values, and the one amplitude that they have."""
        most = {k: None if history is None else history.most for k, history in histories.items()}
        moving = [history for history in histories.values() if history is not None and history.most != 0.0]
        kinds = dict.fromkeys(history.amplitude(end) for history in moving)
        if len(kinds) > 1:
            self.findings.leave(one.card, "components that move each by its own amplitude: that of the first")
        return most, next(iter(kinds), None)

    def _loads(self, one, base, forces, dim, end):
        """Forces and moments on the point, together where their amplitudes are the same."""
        same = {}
        for k, history in forces.items():
            if history is not None and history.most != 0.0:
                same.setdefault(history.amplitude(end), dict.fromkeys(ALL, 0.0))[k] = history.most
        loads = []
        for table, values in same.items():
            load = {"region": base["region"], "point": base["point"], "name": f"{one.name}_{len(loads) + 1}"}
            if any(values[k] for k in range(dim)):
                load["force"] = [values[k] for k in range(dim)]
            turn = [values[k] for k in range(MOVES, len(ALL))]
            if any(turn):
                load["moment"] = turn if dim > 2 else values[_IN_PLANE]
            loads.append(load | amplitude_key(table))
        return loads


def _components(most, dim):
    """Components of displacement and rotation, numbers or "free"."""
    words = ["free" if most[k] is None else most[k] for k in ALL]
    return words[:dim], words[MOVES:] if dim > 2 else [words[_IN_PLANE]]
