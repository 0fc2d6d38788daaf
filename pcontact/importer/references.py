"""Groups that hang on a reference node (*RIGID BODY, *COUPLING and their older forms) as tables of a scene."""

from dataclasses import dataclass

import numpy as np

from pcontact.importer.elements import RIGID as ELEMENTS
from pcontact.importer.faces import surface_faces
from pcontact.importer.history import factors

RIGID, MEAN, TOOL = "rigid", "mean", "tool"
# degrees of freedom of a node with rotations; translations come first
ALL, MOVES = tuple(range(6)), 3
# the rotation in the plane
_IN_PLANE = 5


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
        """What prescribes and loads it: (node, degree of freedom) of the deck to its own degree of freedom, from 0."""
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
        """Whether a rigid body is a rigid surface."""
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
        """Which degrees of freedom are coupled: all that solids have, or it is another coupling."""
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
            amplitude = {} if table is None else {"amplitude": [list(row) for row in table]}
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
        if motion and table is not None:
            motion["amplitude"] = [list(row) for row in table]
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
        moving = {k: history for k, history in histories.items() if history is not None and history.most != 0.0}
        tables = {k: factors(history.key(), history.most, end) for k, history in moving.items()}
        kinds = {None if table is None else tuple(map(tuple, table)) for table in tables.values()}
        if len(kinds) > 1:
            self.findings.leave(one.card, "components that move each by its own amplitude: that of the first")
        return most, next(iter(tables.values()), None)

    def _loads(self, one, base, forces, dim, end):
        """Forces and moments on the point, together where their amplitudes are the same."""
        same = {}
        for k, history in forces.items():
            if history is not None and history.most != 0.0:
                table = factors(history.key(), history.most, end)
                key = None if table is None else tuple(map(tuple, table))
                same.setdefault(key, dict.fromkeys(ALL, 0.0))[k] = history.most
        loads = []
        for key, values in same.items():
            load = {"region": base["region"], "point": base["point"], "name": f"{one.name}_{len(loads) + 1}"}
            if any(values[k] for k in range(dim)):
                load["force"] = [values[k] for k in range(dim)]
            turn = [values[k] for k in range(MOVES, len(ALL))]
            if any(turn):
                load["moment"] = turn if dim > 2 else values[_IN_PLANE]
            if key is not None:
                load["amplitude"] = [list(row) for row in key]
            loads.append(load)
        return loads


def _components(most, dim):
    """Components of displacement and rotation, numbers or "free"."""
    words = ["free" if most[k] is None else most[k] for k in ALL]
    return words[:dim], words[MOVES:] if dim > 2 else [words[_IN_PLANE]]
