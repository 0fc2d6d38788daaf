"""Supports and loads of the steps of a deck, as histories over the run."""

from dataclasses import dataclass, field

import numpy as np

from pcontact.importer.deck import faces
from pcontact.importer.history import Amplitude, History, amplitude_key, factors
from pcontact.material.orthotropic import frame

# degrees of freedom of supports by name; from 4 on rotations
_NAMED = {"XSYMM": (1, 5, 6), "YSYMM": (2, 4, 6), "ZSYMM": (3, 4, 5), "XASYMM": (2, 3, 4), "YASYMM": (1, 3, 5),
          "ZASYMM": (1, 2, 6), "ENCASTRE": (1, 2, 3, 4, 5, 6), "PINNED": (1, 2, 3)}  # fmt: skip
# degrees of freedom of rotation, which nodes of solids do not have
_ROTATIONS = (4, 5, 6)
_AXES = np.eye(3)
# components of directions that are none
STRAIGHT = 1e-9
# [length] nodes that are on the axis of cylindrical coordinates
ON_AXIS = 1e-10
# digits of equal numbers
_DIGITS = 12


@dataclass
class Definition:
    """A value that a card gives, and how it goes.

    Attributes
    ----------
    value : float
    amplitude : Amplitude or None
    card : Card
    fresh : bool
        Given in this step.
    """

    value: float
    amplitude: Amplitude | None
    card: object
    fresh: bool = True


@dataclass
class Values:
    """Values of one kind, by what they belong to, with their histories."""

    now: dict = field(default_factory=dict)
    histories: dict = field(default_factory=dict)

    def give(self, key, definition, add=False):
        """A card says a value; loads of one step add up."""
        old = self.now.get(key)
        if add and old is not None and old.fresh and old.amplitude is definition.amplitude:
            definition.value += old.value
        self.now[key] = definition
        self.histories.setdefault(key, History())

    def pass_step(self, begin, end, steps):
        """Go on to the end of a step; `steps`: what is given jumps at its begin."""
        for key, one in self.now.items():
            history = self.histories[key]
            if one.amplitude is not None:
                history.follow(begin, end, one.value, one.amplitude)
            elif one.fresh and (steps or end == begin):
                history.jump(begin, end, one.value)
            elif one.fresh:
                history.ramp(begin, end, one.value)
            one.fresh = False

    def drop(self):
        """Forget what holds; what it was."""
        old, self.now = self.now, {}
        return old


def _word(words, k):
    """A word of a line, empty beyond its end."""
    return words[k] if k < len(words) else ""


def amplitudes(deck, findings):
    """Amplitudes by name in capitals."""
    found = {}
    for card in deck.cards_of("AMPLITUDE"):
        findings.know(card, "NAME", "TIME", "DEFINITION", "VALUE", "SHIFTX", "SHIFTY")
        if card.word("DEFINITION", "TABULAR") != "TABULAR" or card.word("VALUE", "RELATIVE") != "RELATIVE":
            findings.leave(card, "allowed: a table of relative values")
            continue
        shifts = [card.number(card.place, card.get(name, "")) for name in ("SHIFTX", "SHIFTY")]
        numbers = []
        for place, words in card.rows:
            while words and not words[-1]:
                words = words[:-1]
            numbers += card.numbers(place, words)
        if not numbers or len(numbers) % 2:
            raise card.refuse(f"{len(numbers)} numbers", "pairs of time and factor")
        points = list(zip([t + shifts[0] for t in numbers[::2]], [f + shifts[1] for f in numbers[1::2]], strict=True))
        if any(b[0] <= a[0] for a, b in zip(points, points[1:], strict=False)):
            raise card.refuse("times that do not increase", "increasing times")
        found[card.need("NAME").upper()] = Amplitude(points, card.word("TIME", "STEPTIME") == "TOTALTIME")
        findings.take(card)
    return found


class Frames:
    """Local axes of nodes (*TRANSFORM)."""

    def __init__(self, deck, findings):
        self.deck, self.of_node, self.card = deck, {}, {}
        for card in deck.cards_of("TRANSFORM"):
            findings.know(card, "NSET", "TYPE")
            row = (card.numbers(*card.rows[0]) + [0.0] * 6)[:6] if card.rows else [0.0] * 6
            for node in deck.nodes_of(card, card.place, card.need("NSET")):
                self.of_node[node] = card.word("TYPE", "R"), np.array(row[:3]), np.array(row[3:])
                self.card[node] = card
            findings.take(card)

    def axes(self, node):
        """Local axes in rows, (3, 3); None where they are those of the mesh."""
        if node not in self.of_node:
            return None
        kind, a, b = self.of_node[node]
        if kind.startswith("C"):
            axial = (b - a) / np.linalg.norm(b - a)
            arm = np.array(self.deck.nodes[node]) - a
            arm -= (arm @ axial) * axial
            if np.linalg.norm(arm) < ON_AXIS:
                # any direction across the axis, the one that CalculiX takes
                k = next(k for k in range(3) if abs(axial[k]) > ON_AXIS)
                arm = np.zeros(3)
                arm[(k + 1) % 3] = 1.0
                arm[k] = -axial[(k + 1) % 3] / axial[k]
            return frame(arm, np.cross(axial, arm))
        return frame(a, b)


class Supports:
    """Supports and loads of the nodes, faces and cells of a deck, from step to step.

    Parameters
    ----------
    deck : Deck
    findings : Findings
    nodes : set of int
        Nodes of cells.
    dim : int
    references : dict of (int, int) to (int, int)
        Degrees of freedom, from 0, of nodes that sections of bolts and groups hang on: as the deck has them, and
        whose they are.
    """

    def __init__(self, deck, findings, nodes, dim, references=None):
        self.deck, self.findings, self.nodes, self.dim, self.references = deck, findings, nodes, dim, references or {}
        self._hanging = {node for node, _ in self.references}
        self.amplitudes, self.frames = amplitudes(deck, findings), Frames(deck, findings)
        self.held, self.forces, self.pressures, self.volumes = Values(), Values(), Values(), Values()
        self.temperatures, self.tractions, self.initial = Values(), Values(), {}
        self.follower, self.count = False, 0
        self.active, self.card_of, self._tilted = {}, {}, []

    def before(self):
        """Supports and temperatures before the first step."""
        for card in self.deck.model:
            if card.key == "BOUNDARY":
                self._read(card)
            elif card.key == "INITIALCONDITIONS" and card.word("TYPE") == "TEMPERATURE":
                self.findings.know(card, "TYPE")
                for place, words in card.rows:
                    value = card.number(place, _word(words, 1))
                    self.initial |= dict.fromkeys(self.deck.nodes_of(card, place, words[0]), value)
                self.findings.take(card)
        self.held.pass_step(0.0, 0.0, True)

    def step(self, step, begin, end):
        """Take the cards of a step."""
        renewed = set()
        for card in step.cards:
            if card.key not in _CARDS:
                continue
            kind = "DLOAD" if card.key == "DSLOAD" else card.key
            if card.word("OP", "MOD") == "NEW" and kind not in renewed:
                self._renew(kind)
            renewed.add(kind)
            self._read(card)
        for key in self.held.now:
            self.active.setdefault(key, []).append(self.count)
        self.count += 1
        steps = step.card.word("AMPLITUDE", "RAMP") == "STEP"
        for values in (self.held, self.forces, self.pressures, self.tractions, self.volumes, self.temperatures):
            values.pass_step(begin, end, steps)

    def _renew(self, kind):
        """OP=NEW: what held before lets go, loads end along a ramp."""
        if kind == "BOUNDARY":
            self.held.drop()
            return
        if kind == "TEMPERATURE":
            return
        for values in (self.forces,) if kind == "CLOAD" else (self.pressures, self.tractions, self.volumes):
            for key, old in values.drop().items():
                if values.histories[key].last != 0.0:
                    values.give(key, Definition(0.0, None, old.card))
                    self.findings.change(old.card, "ends along a ramp over the step that does not say it")

    def _read(self, card):
        """Take a card."""
        read, known = _CARDS[card.key]
        self.findings.know(card, *known)
        read(self, card, self._amplitude(card))

    def _amplitude(self, card):
        name = card.get("AMPLITUDE")
        if name and name.upper() not in self.amplitudes:
            self.findings.leave(card, f"amplitude {name} is not known: a ramp in its place")
            return None
        return self.amplitudes[name.upper()] if name else None

    def _boundary(self, card, amplitude):
        if card.word("TYPE", "DISPLACEMENT") != "DISPLACEMENT" or "FIXED" in card.parameters:
            self.findings.leave(card, "allowed: prescribed displacements with values")
            return
        self.findings.take(card)
        for place, words in card.rows:
            nodes = self.deck.nodes_of(card, place, words[0])
            first = _word(words, 1)
            if first.upper() in _NAMED:
                dofs, value = _NAMED[first.upper()], 0.0
            else:
                low = card.integer(place, first)
                high = card.integer(place, _word(words, 2)) if _word(words, 2) else low
                dofs, value = range(low, high + 1), card.number(place, _word(words, 3))
            self._prescribe(card, place, nodes, dofs, Definition(value, amplitude, card))

    def _prescribe(self, card, place, nodes, dofs, one):
        hanging = [n for n in nodes if n in self._hanging]
        own = [n for n in nodes if n in self.nodes and n not in self._hanging]
        if not own and not hanging:
            self.findings.skip(card, "nodes of no cell", place)
        for node in hanging:
            for dof in dofs:
                key = self.references.get((node, dof - 1))
                if key is not None:
                    self.held.give(key, Definition(one.value, one.amplitude, card))
                    self.card_of[key] = card
        for dof in dofs if own else ():
            if dof in _ROTATIONS or (dof == 3 and self.dim == 2 and one.value == 0.0):
                continue
            if dof > self.dim or dof < 1:
                self.findings.leave(card, f"degree of freedom {dof}", place)
                continue
            for node in own:
                self.held.give((node, dof - 1), Definition(one.value, one.amplitude, card))
                self.card_of[node, dof - 1] = card

    def _cload(self, card, amplitude):
        self.findings.take(card)
        for place, words in card.rows:
            dof, value = card.integer(place, _word(words, 1)), card.number(place, _word(words, 2))
            nodes = self.deck.nodes_of(card, place, words[0])
            keys = {n: (n, dof - 1) for n in nodes if n in self.nodes and n not in self._hanging and dof <= self.dim}
            keys |= {n: self.references[n, dof - 1] for n in nodes if (n, dof - 1) in self.references}
            lost = [n for n in nodes if n not in keys]
            if value and lost:
                words = f"node {lost[0]}, of no cell" if lost[0] not in self.nodes else f"degree of freedom {dof}"
                self.findings.leave(card, f"{words} ({len(lost)} in all)", place)
            for key in set(keys.values()) if dof > 0 else ():
                self.forces.give(key, Definition(value, amplitude, card), add=True)

    def _dload(self, card, amplitude):
        self.findings.take(card)
        for place, words in card.rows:
            label, numbers = _word(words, 1).upper(), card.numbers(place, words[2:])
            if words[0]:
                elements = self.deck.elements_of(card, place, words[0])
            else:
                elements = self.deck.cells()
            if label[:1] == "P" and label[1:].isdigit():
                for key in faces(self.deck, card, place, label, elements):
                    self.pressures.give(key, Definition(numbers[0], amplitude, card), add=True)
            elif label in ("GRAV", "CENTRIF", "BX", "BY", "BZ") and numbers:
                key = (label, tuple(numbers[1:]), tuple(elements))
                self.volumes.give(key, Definition(numbers[0], amplitude, card), add=True)
            else:
                self.findings.leave(card, f"{label}; allowed: P1 to P6, GRAV, CENTRIF, BX, BY, BZ", place)

    def _dsload(self, card, amplitude):
        self.findings.take(card)
        for place, words in card.rows:
            surface = self.deck.surface_of(card, place, words[0])
            label = _word(words, 1).upper()
            if label not in ("P", "TRVEC") or surface.nodes:
                self.findings.leave(card, f"{label}; allowed: P, TRVEC on faces", place)
                continue
            if label == "TRVEC":
                way = np.array((card.numbers(place, words[3:6]) + [0.0] * 3)[:3])
                if not np.any(way):
                    raise card.refuse("a direction of no length", "size and direction of the traction", place)
                if card.word("FOLLOWER", "YES") == "YES":
                    self.findings.change(card, "with NLGEOM: it keeps its direction", place)
                key = surface.name, tuple((way / np.linalg.norm(way)).tolist())
                self.tractions.give(key, Definition(card.number(place, _word(words, 2)), amplitude, card), add=True)
                continue
            for key in surface.faces:
                self.pressures.give(key, Definition(card.number(place, _word(words, 2)), amplitude, card), add=True)

    def _temperature(self, card, amplitude):
        if card.get("FILE"):
            return
        self.findings.take(card)
        for place, words in card.rows:
            value = card.number(place, _word(words, 1))
            for node in self.deck.nodes_of(card, place, words[0]):
                self.temperatures.give(node, Definition(value, amplitude, card))
                if self.temperatures.histories[node].points == [(0.0, 0.0)]:
                    self.temperatures.histories[node] = History([(0.0, self.initial.get(node, 0.0))])

    # ------------------------------------------------------------ tables

    @property
    def changes(self):
        """Return whether a support begins or ends with a step but the first and the last one."""
        return any(len(steps) != self.count for steps in self.active.values())

    def pushed(self):
        """Nodes with forces."""
        return {node for (node, _), history in self.forces.histories.items() if history.most != 0.0}

    def displacements(self, groups, end, phases=()):
        """Tables [[displacements]] with the cards that they come from.

        Parameters
        ----------
        groups : Groups
        end : float
            Of the run; infinite where every table is to say its amplitude.
        phases : sequence of str
            Names of the phases, a step each; none: supports hold all the time.
        """
        self._turn()
        classes = {}
        for (node, dof), history in self.held.histories.items():
            steps = tuple(self.active.get((node, dof), ()))
            if self.count and not steps:
                # taken away before anything happened
                continue
            classes.setdefault((dof, history.key(), steps if phases else ()), []).append(node)
        merged = {}
        for (dof, points, steps), nodes in classes.items():
            most = max((value for _, value in points), key=abs)
            table = factors(points, most, end)
            key = frozenset(nodes), table, most == 0.0, steps
            merged.setdefault(key, (nodes, {}))[1][dof] = most
        for (_, table, _, steps), (nodes, values) in merged.items():
            cards = {self.card_of[n, dof] for n in nodes for dof in values}
            name = groups.add("nodes", self._name(nodes, "support"), nodes)
            one = {"region": name, "value": [values.get(dof, "free") for dof in range(self.dim)]}
            if phases and len(steps) != len(phases):
                one["phases"] = [phases[k] for k in steps]
                if steps[0] > 0:
                    one["absolute"] = True
            yield one | amplitude_key(table), min(cards, key=lambda card: card.place)

    def _name(self, nodes, word):
        """Name of the set of just these nodes, or of none."""
        inside = set(nodes)
        for key, members in self.deck.node_sets.items():
            if len(members) >= len(inside) and inside == set(members) & self.nodes:
                return self.deck.spelling[key]
        return f"node_{nodes[0]}" if len(inside) == 1 else word

    def _turn(self):
        """Supports along local axes as ones along those of the mesh, where they are the same; others are equations."""
        for node in {node for node, _ in self.held.histories} & set(self.frames.of_node):
            axes = self.frames.axes(node)
            own = {dof: self.held.histories.pop((node, dof)) for dof in range(3) if (node, dof) in self.held.histories}
            cards = {dof: self.card_of.pop((node, dof)) for dof in own}
            active = {dof: self.active.pop((node, dof), None) for dof in own}
            if axes is None:
                axes = _AXES
            if len(own) == self.dim and all(history.most == 0.0 for history in own.values()):
                axes = _AXES
            for dof, history in own.items():
                direction = int(np.argmax(np.abs(axes[dof])))
                size = axes[dof][direction]
                if abs(size) < 1.0 - STRAIGHT:
                    self._tilt(node, axes[dof], history, active[dof], cards[dof])
                    continue
                turned = History([(t, value * float(np.sign(size))) for t, value in history.points])
                self.held.histories[node, direction] = turned
                self.card_of[node, direction] = cards[dof]
                if active[dof] is not None:
                    self.active[node, direction] = active[dof]

    def _tilt(self, node, direction, history, steps, card):
        """A support in a direction that is none of the mesh's: an equation, where it is zero all the time."""
        if history.most != 0.0 or (self.count and len(steps or ()) != self.count):
            words = "displacements, or supports that begin or end, in directions that are none of the mesh's"
            self.findings.leave(self.frames.card[node], words)
            return
        self._tilted.append((node, direction[: self.dim], card))

    def tilted(self, groups):
        """Tables [[equations]] of supports in directions that are none of the mesh's; after :meth:`displacements`."""
        tables = []
        for node, direction, card in self._tilted:
            name = groups.add("nodes", f"node_{node}", [node])
            terms = [[name, "xyz"[k], float(c)] for k, c in enumerate(direction) if abs(c) > STRAIGHT]
            tables.append(({"terms": terms}, card))
        if tables:
            words = f"{len(tables)} supports in directions that are none of the mesh's: equations"
            self.findings.change(self.frames.card[self._tilted[0][0]], words)
        return tables

    def loads(self, groups, end, thickness):
        """Tables [[loads]] with the cards that they come from."""
        return [*self._forces(groups, end, thickness), *self._pressures(groups, end), *self._tractions(groups, end),
                *self._volumes(groups, end)]  # fmt: skip

    def _forces(self, groups, end, thickness):
        """Forces at nodes: those of equal vectors and amplitudes together."""
        nodes, cards = {}, {}
        for (node, dof), history in self.forces.histories.items():
            most = history.most
            if most == 0.0:
                continue
            axes = self.frames.axes(node)
            key = history.amplitude(end)
            vector = most / thickness * (_AXES if axes is None else axes)[dof]
            rows = nodes.setdefault(node, {})
            rows[key] = rows.get(key, np.zeros(3)) + vector
            cards.setdefault(node, self.forces.now[node, dof].card)
        same = {}
        for node, rows in nodes.items():
            for key, vector in rows.items():
                scale = np.abs(vector).max()
                digits = tuple(float(f"{x:.{_DIGITS}g}") if abs(x) > 1e-14 * scale else 0.0 for x in vector)
                same.setdefault((key, digits), []).append(node)
        tables = []
        for (table, vector), members in same.items():
            name = groups.add("nodes", self._name(members, "forces"), members)
            one = {"region": name, "force": [len(members) * x for x in vector[: self.dim]]}
            if any(load["region"] == name for load, _ in tables):
                one["name"] = f"{name}_{len(tables) + 1}"
            tables.append((one | amplitude_key(table), cards[members[0]]))
        return tables

    def _pressures(self, groups, end):
        classes = {}
        for key, history in self.pressures.histories.items():
            if history.most != 0.0:
                classes.setdefault(history.key(), []).append(key)
        for points, members in classes.items():
            most = max((value for _, value in points), key=abs)
            one = {"region": groups.add("facets", self._surface(members), members), "pressure": most}
            one |= amplitude_key(factors(points, most, end))
            if self.follower:
                one["follower"] = True
            yield one, self.pressures.now[members[0]].card

    def _tractions(self, groups, end):
        for (name, way), history in self.tractions.histories.items():
            if history.most == 0.0:
                continue
            region = groups.add("facets", name, self.deck.surfaces[name.upper()].faces)
            one = {"region": region, "traction": [history.most * x for x in way[: self.dim]]}
            yield one | amplitude_key(history.amplitude(end)), self.tractions.now[name, way].card

    def _surface(self, members):
        inside = set(members)
        for surface in self.deck.surfaces.values():
            if inside == set(surface.faces):
                return surface.name
        return "pressure"

    def _volumes(self, groups, end):
        for (label, numbers, elements), history in self.volumes.histories.items():
            if history.most == 0.0:
                continue
            card = self.volumes.now[label, numbers, elements].card
            cells = [e for e in elements if e in set(self.deck.cells())]
            one = {"region": groups.add("cells", "loaded_cells", cells)}
            if label == "GRAV":
                one["acceleration"] = [history.most * x for x in (list(numbers) + [0.0] * 3)[: self.dim]]
            elif label == "CENTRIF":
                one["angular_speed"] = float(np.sqrt(history.most))
                if self.dim == 3:
                    one |= {"point": list(numbers[:3]), "axis": list(numbers[3:6])}
                self.findings.change(card, "the ramp is one of the speed, not of its square")
            else:
                one["body_force"] = [history.most if axis == label[1] else 0.0 for axis in "XYZ"[: self.dim]]
            table = history.amplitude(end)
            if label == "CENTRIF" and table is not None:
                table = [(time, float(np.sqrt(max(factor, 0.0)))) for time, factor in table]
            yield one | amplitude_key(table), card


# how cards are read, and parameters that they may have
_CARDS = {
    "BOUNDARY": (Supports._boundary, ("OP", "AMPLITUDE", "FIXED", "TYPE")),
    "CLOAD": (Supports._cload, ("OP", "AMPLITUDE")), "DLOAD": (Supports._dload, ("OP", "AMPLITUDE")),
    "DSLOAD": (Supports._dsload, ("OP", "AMPLITUDE", "FOLLOWER")),
    "TEMPERATURE": (Supports._temperature, ("OP", "AMPLITUDE")),
}  # fmt: skip
