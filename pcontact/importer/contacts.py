"""Contacts and ties of a deck as tables of a scene."""

import numpy as np

from pcontact.importer.deck import FACING, distances, facing_faces, outward, surface_faces

# coefficient of friction from which nothing slips, and what stands for it: the largest that is not refused
ROUGH, LARGEST = 100.0, 3.0
# springs of contact that are stiffer than a layer of elements are a numerical means; softer ones are a soft layer
HARD = 1.0
# [layers of elements] From which on springs where points stick stand for none. From: they are 2 % of what yields of two
# bodies of one layer each, whose shear modulus is E / 2.6.
RIGID_STICK = 10.0
# [lengths of an edge] gaps that ADJUST closes of a set of nodes, and those of surfaces that touch
WHATEVER, TOUCHING = 0.1, 1e-6
# rows of a table for exponential springs, and from where on they have no pressure [distances at which it is 1 %]
ROWS, BEGIN = 40, 1.0
# parameter of a penalty that leaves little overlap
STIFF = 1000.0
# parameters of a pair that say how a program searches and iterates
_ITERATION = ("EXTENSIONZONE", "HCRIT", "TRACKING", "SMOOTH", "MECHANICALCONSTRAINT", "CPSET", "NOTHICKNESS", "WEIGHT",
              "SUPPLEMENTARYCONSTRAINTS", "GEOMETRICCORRECTION", "SLIDINGTRANSITION")  # fmt: skip
# surfaces of a pair
_TWO = 2


def name_of(table):
    """Name of a contact that does not say its own."""
    return table.get("name") or ("all" if table.get("all") else f"{table['source']}-{table['target']}")


class Contacts:
    """Contacts and ties of a deck.

    Parameters
    ----------
    deck : Deck
    findings : Findings
    groups : pcontact.importer.groups.Groups
    tables : dict of str to dict
        Of `materials`.
    bodies : list
        Of `bodies`.
    tools : pcontact.importer.tools.Tools
    """

    def __init__(self, deck, findings, groups, tables, bodies, tools):
        self._tools = tools
        self.deck, self.findings, self.groups, self._used = deck, findings, groups, set()
        self._pairs, self._cards, self._loose, self.begun = {}, {}, {}, []
        moduli = {name: float(np.mean(table["E"])) for name, table in tables.items()}
        self.modulus = {e: moduli[material] for _, material, cells in bodies for e in cells}

    def tables(self):
        """Tables [[contacts]], with the card that each comes from.

        Returns
        -------
        list of (dict, Card)
        """
        found = []
        for card in self.deck.model:
            if card.key == "CONTACTPAIR":
                self.findings.know(card, "INTERACTION", "TYPE", "ADJUST", "SMALLSLIDING", *_ITERATION)
                for place, words in card.rows:
                    found.append((self._pair(card, place, words), card))
            elif card.key == "TIE" and "CYCLICSYMMETRY" not in card.parameters:
                self.findings.know(card, "NAME", "POSITIONTOLERANCE", "ADJUST", "TYPE", "MULTISTAGE")
                for place, words in card.rows:
                    found.append((self._tie(card, place, words), card))
        found += self._general()
        for card in self.deck.cards_of("CLEARANCE"):
            self._clearance(card)
        for cards in self.deck.interactions.values():
            if cards[0].place not in self._used:
                for card in cards:
                    self.findings.skip(card, "no contact has it")
        return [(table, card) for table, card in found if table is not None]

    def _general(self):
        """Tables of *CONTACT: all exterior surfaces, or pairs of them; a surface alone is that with itself."""
        laws, pairs, every = {}, [], None
        for card in self.deck.model:
            if card.key == "CONTACT":
                self.findings.take(card)
            elif card.key == "CONTACTPROPERTYASSIGNMENT":
                self.findings.take(card)
                laws |= {tuple((*words, "", "")[:2]): (words[2].upper(), place, card) for place, words in card.rows
                         if len(words) > _TWO}  # fmt: skip
            elif card.key == "CONTACTINCLUSIONS":
                self.findings.know(card, "ALLEXTERIOR")
                every = card if "ALLEXTERIOR" in card.parameters else every
                pairs += [(card, place, words) for place, words in card.rows if any(words)]
        found, used = [], set()
        if every is not None:
            table = {"all": True, "self_contact": True}
            used.add(("", ""))
            self._assigned(laws, ("", ""), table, [], every)
            self.findings.change(every, "Nitsche's method on all surfaces, each against all others and itself")
            found.append((table, every))
        for card, place, words in pairs:
            one, other = (*words, "")[:2]
            table, faces = self._sides(card, place, [one, other or one])
            if table is not None:
                used |= {(one, other), ("", "")}
                self._assigned(laws, (one, other) if (one, other) in laws else ("", ""), table, faces, card)
                self.findings.change(card, "Nitsche's method on the facets of the first surface", place)
                found.append((table, card))
        for sides in set(laws) - used:
            _, place, card = laws[sides]
            self.findings.leave(card, f"a law of its own for {', '.join(sides)}", place)
        return found

    def _assigned(self, laws, sides, table, faces, card):
        """The law of surfaces in general contact."""
        if sides not in laws:
            return
        name, place, assigned = laws[sides]
        if name not in self.deck.interactions:
            raise assigned.refuse(f"the unknown interaction {name!r}", ", ".join(self.deck.interactions), place)
        self._interaction(self.deck.interactions[name], table, faces)
        self._pairs.setdefault(name, []).append((table, faces))
        self._cards[id(table)] = card

    def press(self, nodes):
        """Pairs on whose slave's faces forces and equations act, which its stress knows nothing of: a stiff penalty.

        Parameters
        ----------
        nodes : set of int
            Nodes with forces or equations.
        """
        for table, faces in (pair for pairs in self._pairs.values() for pair in pairs):
            if {"tied", "pressure_overclosure"} & table.keys():
                continue
            if any(nodes.issuperset(self.deck.corners(*row)) for row in faces):
                table |= {"formulation": "penalty", "gamma0": STIFF}
                words = "forces or equations act on the faces of the slave: a stiff penalty, no Nitsche's method"
                self.findings.change(self._cards[id(table)], words)

    def change(self, card, following):
        """Another friction or behaviour from a step on.

        Parameters
        ----------
        card : Card
            *CHANGE FRICTION or *CHANGE SURFACE BEHAVIOR.
        following : Card or None
            The one that says it.

        Returns
        -------
        dict of str to float
            Coefficients of friction of contacts, by their names.
        """
        self.findings.know(card, "INTERACTION")
        wanted = {"CHANGEFRICTION": "FRICTION", "CHANGESURFACEBEHAVIOR": "SURFACEBEHAVIOR"}[card.key]
        name = card.need("INTERACTION").upper()
        if following is None or following.key != wanted or name not in self.deck.interactions:
            raise card.refuse("no interaction, or no card that says it", f"INTERACTION=, and *{wanted} after it")
        values = [following.numbers(place, words) for place, words in following.rows]
        pairs = self._pairs.get(name, [])
        self.findings.take(card)
        if wanted == "SURFACEBEHAVIOR":
            pair, faces = pairs[0] if pairs else ({}, [])
            other = {"pressure_overclosure": None}
            stay = "stick_stiffness" in pair
            tied = self._behavior(following, values, (faces, stay), other) if pairs else False
            if not pairs or tied != ("tied" in pair):
                self._let_go(card, following, pairs, other["pressure_overclosure"])
            elif other["pressure_overclosure"] != pair.get("pressure_overclosure"):
                self.findings.leave(following, "softer or stiffer springs from a step on")
            return {}
        table = {}
        self._friction(following, values, table)
        return {name_of(pair): table["friction"] for pair, _ in pairs}

    def _let_go(self, card, following, pairs, law):
        """Tied surfaces are in contact from a step on: other contacts in their place."""
        if not pairs or "tied" not in pairs[0][0]:
            self.findings.leave(following, "ties from a step on")
            return
        for table, _ in pairs:
            other = {"name": f"{name_of(table)}-let-go", "source": table["source"], "target": table["target"]}
            other |= {} if law is None else {"pressure_overclosure": law}
            self.begun.append((table, {**other, **self._loose[id(table)]}, card))
        self.findings.change(following, "another contact from this step on, in place of the tied surfaces")

    def switch(self, card):
        """*MODEL CHANGE of contact pairs.

        Returns
        -------
        list of (str, bool)
            Names of contacts, and whether they act from here on.
        """
        if card.word("TYPE") == "ELEMENT":
            return []
        self.findings.know(card, "TYPE", "ADD", "REMOVE")
        if card.word("TYPE") != "CONTACTPAIR" or not {"ADD", "REMOVE"} & set(card.parameters):
            self.findings.leave(card, "allowed: TYPE=CONTACT PAIR with ADD or REMOVE")
            return []
        known = {name_of(pair) for pairs in self._pairs.values() for pair, _ in pairs}
        found = []
        for place, words in card.rows:
            sides, _ = self._sides(card, place, words)
            if sides is None or name_of(sides) not in known:
                raise card.refuse(", ".join(words), "the surfaces of a contact pair", place)
            found.append((name_of(sides), "ADD" in card.parameters))
        self.findings.take(card)
        return found

    def _side(self, card, place, word, other=None):
        """Name of the group of facets of a surface, its faces; None where there are none.

        Nodes that are no whole facet stand for the facets around them that face the `other` surface.
        """
        surface = self.deck.surface_of(card, place, word)
        faces = surface_faces(self.deck, surface)
        if not faces and surface.nodes and other is not None:
            others = surface_faces(self.deck, self.deck.surface_of(card, place, other))
            faces = facing_faces(self.deck, surface.nodes, others) if others else []
            if faces:
                self.findings.change(surface.card, f"the {len(faces)} facets around its {len(surface.nodes)} nodes")
                return self.groups.add("facets", surface.name, faces), faces
        faces = [row for row in faces if row[0] in self.modulus]
        if not faces and self.deck.removed is not None and not surface.nodes:
            self.findings.skip(card, f"surface {surface.name} is that of elements that are not there", place)
            return None, []
        if not faces:
            self.findings.leave(card, f"surface {surface.name} has no facets of solids", place)
            return None, []
        if surface.nodes and not surface.faces:
            covered = {n for row in faces for n in self.deck.face_nodes(*row)}
            words = "the facets between its nodes"
            if set(surface.nodes) - covered:
                words += f"; {len(set(surface.nodes) - covered)} nodes are in none"
            self.findings.change(surface.card, words)
        else:
            self.findings.take(surface.card)
        return self.groups.add("facets", surface.name, faces), faces

    def _sides(self, card, place, words):
        if len(words) < _TWO or not words[1]:
            raise card.refuse(", ".join(words) or "nothing", "two surfaces", place)
        if self._tools.rigid(self.deck.surface_of(card, place, words[0])):
            self.findings.change(card, "the solid is the source", place)
            words = [words[1], words[0]]
        surface = self.deck.surface_of(card, place, words[1])
        if self._tools.rigid(surface):
            source, faces = self._side(card, place, words[0])
            self.findings.take(surface.card)
            tool = self._tools.of(surface, faces)
            table = {"name": f"{source}-{surface.name}", "source": source, "obstacle": tool.table}
            return (None if source is None else table), faces
        source, faces = self._side(card, place, words[0], words[1])
        target, _ = self._side(card, place, words[1])
        if source is None or target is None:
            return None, faces
        table = {"source": source, "target": target}
        return table, faces

    def _pair(self, card, place, words_of):
        table, faces = self._sides(card, place, words_of)
        if table is None:
            return None
        kind = card.word("TYPE", "NODETOSURFACE")
        words = f"{card.get('TYPE') or 'contact'}: Nitsche's method on the facets of the slave"
        self.findings.change(card, words, place)
        if kind == "MASSLESS":
            self.findings.leave(card, "massless contact is for dynamics", place)
        if "SMALLSLIDING" in card.parameters:
            self.findings.change(card, "small sliding: partners are found in every load step", place)
        interaction = self.deck.interactions.get(card.need("INTERACTION").upper())
        if interaction is None:
            raise card.refuse(f"the unknown interaction {card.get('INTERACTION')!r}", ", ".join(self.deck.interactions))
        self._interaction(interaction, table, faces)
        if "ADJUST" in card.parameters:
            self._adjust(card, place, words_of[1], (table, faces))
        self._pairs.setdefault(card.need("INTERACTION").upper(), []).append((table, faces))
        self._cards[id(table)] = card
        return table

    def _adjust(self, card, place, other, pair):
        """ADJUST of a pair, the `other` of whose surfaces is the master."""
        table, faces = pair
        if "obstacle" in table:
            self.findings.change(card, "ADJUST: gaps and overlaps with a rigid surface stay as they are", place)
            return
        if "tied" in table:
            word = card.need("ADJUST")
            distance = 0.0 if word.upper() in self.deck.node_sets else card.number(place, word)
            table["search_radius"] = distance or WHATEVER * self._edge(faces)
            words = f"tied as the surfaces lie, up to {table['search_radius']:.3g} from each other: nodes are not moved"
            self.findings.change(card, words, place)
            return
        target = surface_faces(self.deck, self.deck.surface_of(card, place, other))
        table |= {"interference": "adjust", "adjust_within": self._adjusted(card, place, faces, target)}
        words = f"gaps up to {table['adjust_within']:.3g} and overlaps are closed at points, no node is moved"
        self.findings.change(card, words, place)

    def _adjusted(self, card, place, faces, target):
        """Return the width of gaps that ADJUST closes: a distance, or a set of nodes whatever their gap."""
        word = card.need("ADJUST")
        if word.upper() not in self.deck.node_sets:
            return max(card.number(place, word), TOUCHING * self._edge(faces))
        chosen = set(self.deck.node_sets[word.upper()])
        nodes = {node for row in faces for node in self.deck.face_nodes(*row)}
        others = sorted(nodes - chosen)
        if not others:
            return WHATEVER * self._edge(faces)
        inside, outside = (distances(self.deck, some, target) for some in (sorted(nodes & chosen), others))
        # gaps are closed by their width: that is the same where those of the set are the narrowest
        widest = max(inside, default=0.0) + TOUCHING * self._edge(faces)
        if min(outside) < widest:
            self.findings.leave(card, f"ADJUST for nodes of the slave that are not the nearest ones: {word}", place)
        return widest

    def _edge(self, faces):
        """Mean length of the edges of faces."""
        sizes = []
        for row in faces:
            points = np.array([self.deck.nodes[n] for n in self.deck.corners(*row)])
            sizes.append(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).mean())
        return float(np.mean(sizes))

    def _clearance(self, card):
        """*CLEARANCE: gaps that are said."""
        self.findings.know(card, "MASTER", "SLAVE", "VALUE")
        sides = [self.deck.surface_of(card, card.place, card.need(name)).name for name in ("SLAVE", "MASTER")]
        pair = next((pair for pairs in self._pairs.values() for pair, _ in pairs
                     if [pair.get("source"), pair.get("target")] == sides), None)  # fmt: skip
        if pair is None or {"interference", "tied"} & pair.keys():
            self.findings.leave(card, "of surfaces that are no contact pair, or with ADJUST, or tied")
            return
        pair["clearance"] = card.number(card.place, card.need("VALUE"))
        self.findings.take(card)

    def _interaction(self, cards, table, faces):
        self._used.add(cards[0].place)
        self.findings.know(cards[0], "NAME")
        self.findings.take(cards[0])
        tied, sticks = False, self._sticks(cards, faces)
        # what friction is depends on how surfaces press on each other
        for card in sorted(cards[1:], key=lambda card: card.key == "FRICTION"):
            values = [card.numbers(place, words) for place, words in card.rows]
            if card.key == "SURFACEBEHAVIOR":
                self.findings.know(card, "PRESSURE-OVERCLOSURE", "PENALTY", "AUGMENTEDLAGRANGE", "DIRECT",
                                   "NOSEPARATION")  # fmt: skip
                if "NOSEPARATION" in card.parameters:
                    table["bilateral"] = True
                    self.findings.take(card, "surfaces do not part")
                tied = self._behavior(card, values, (faces, sticks > 0.0), table)
            elif card.key == "FRICTION":
                self._friction(card, values, table, 0.0 if tied else sticks)
            elif card.key in ("GAPCONDUCTANCE", "GAPHEATGENERATION", "CONTACTDAMPING"):
                self.findings.skip(card, "no static solution depends on it")
            else:
                self.findings.leave(card, "not known")
        if tied and table.get("target") in (None, table.get("source")):
            self.findings.leave(cards[0], "tied to a rigid surface, to itself, or all surfaces: contact instead")
        elif tied:
            self._loose[id(table)] = {key: table[key] for key in ("friction",) if key in table}
            # nothing else means anything where surfaces are tied
            for key in table.keys() - {"source", "target"}:
                del table[key]
            table["tied"] = True

    def _sticks(self, cards, faces):
        """Springs that hold where points stick, if they yield as the bodies do; else 0."""
        card = next((card for card in cards if card.key == "FRICTION" and card.rows), None)
        if card is None or not faces:
            return 0.0
        slope = (card.numbers(*card.rows[0]) + [0.0])[1]
        return slope if slope < RIGID_STICK * self._layer(faces) else 0.0

    def _behavior(self, card, values, pair, table):
        """Pressure over overclosure; whether the surfaces are tied.

        Parameters
        ----------
        card : Card
        values : list of list of float
            Its lines.
        pair : (list of (int, int), bool)
            Faces of the source; whether springs stay, however stiff they are: others hold beside them.
        table : dict
        """
        (faces, stay), kind = pair, card.word("PRESSURE-OVERCLOSURE", "HARD")
        if kind == "HARD":
            self.findings.take(card, "no overlap is left")
            return False
        first = values[0][0] if values and values[0] else 0.0
        if kind == "TIED":
            self.findings.change(card, f"glued without the springs of {first:g}")
            return True
        if kind == "TABULAR":
            table["pressure_overclosure"] = [[row[1], row[0]] for row in values]
            self.findings.take(card)
            return False
        slope = first
        if kind == "EXPONENTIAL":
            # the slope where surfaces touch, -ln(0.01) p0 / c0
            slope = 4.605 * (values[0][1] / first) if len(values[0]) > 1 and first else 0.0
        if kind not in ("LINEAR", "EXPONENTIAL") or slope <= 0.0:
            self.findings.leave(card, f"{kind.lower()}: no overlap is left, whatever the pressure")
            return False
        if not faces:
            self.findings.change(card, f"springs of {slope:g}: here no overlap is left")
            return False
        part = slope / self._layer(faces)
        words = f"springs of {slope:g}, {part:.2g} times a layer of elements"
        if part >= HARD and not stay:
            self.findings.change(card, f"{words}: here no overlap is left")
        elif kind == "LINEAR":
            table["pressure_overclosure"] = slope
            pull = values[0][1] if len(values[0]) > 1 else 0.0
            if pull:
                pulled = f"those of CalculiX pull across a gap with up to {pull:g}"
                self.findings.change(card, f"{words}; they push only, {pulled}")
            else:
                self.findings.take(card, words)
        else:
            table["pressure_overclosure"] = _exponential(first, values[0][1])
            self.findings.change(card, f"{words}, as a table of {ROWS} rows")
        return False

    def _layer(self, faces):
        """Stiffness of the elements of a surface per area: modulus over the length of their faces, the mean."""
        return float(np.mean([self.modulus[e] for e, _ in faces])) / self._edge(faces)

    def _friction(self, card, values, table, sticks=0.0):
        self.findings.know(card, "ROUGH", "TAUMAX", "SLIPTOLERANCE", "ELASTICSLIP")
        first = values[0] if values and values[0] else [0.0]
        value = float("inf") if "ROUGH" in card.parameters else first[0]
        table["friction"] = value
        if value >= ROUGH:
            table["friction"] = LARGEST
            self.findings.change(card, f"nothing slips in the deck; here a friction of {LARGEST:g}")
        elif value > LARGEST:
            table["friction"] = LARGEST
            self.findings.leave(card, f"a friction of {value:g}; here {LARGEST:g}")
        elif len(first) > 1 and first[1]:
            if "pressure_overclosure" in table:
                table["stick_stiffness"] = first[1]
                self.findings.take(card, f"{value:g}")
            elif sticks:
                words = f"springs of {sticks:g} where it sticks: they need *SURFACE BEHAVIOR with springs"
                self.findings.leave(card, words)
            else:
                self.findings.change(card, f"{value:g}, without the springs of {first[1]:g} where it sticks")
        else:
            self.findings.take(card, f"{value:g}")
        if "TAUMAX" in card.parameters and value < ROUGH:
            table["friction_limit"] = card.number(card.place, card.need("TAUMAX"))

    def _tie(self, card, place, words):
        if "MULTISTAGE" in card.parameters:
            self.findings.leave(card, "a tie of stages of different cyclic symmetry", place)
            return None
        table, faces = self._sides(card, place, words)
        if table is not None and table.get("target") in (None, table["source"]):
            self.findings.leave(card, f"a tie to a rigid surface, or of one with itself: {', '.join(words[:2])}", place)
            return None
        if table is None:
            return None
        others = surface_faces(self.deck, self.deck.surface_of(card, place, words[1]))
        one, other = (np.mean([outward(self.deck, row) for row in rows], axis=0) for rows in (faces, others))
        if one @ other > FACING * np.linalg.norm(one) * np.linalg.norm(other) > 0.0:
            self.findings.leave(card, f"a tie of surfaces that look the same way: {', '.join(words[:2])}", place)
            return None
        table["tied"] = True
        if card.get("POSITIONTOLERANCE"):
            value = card.number(card.place, card.need("POSITIONTOLERANCE"))
            if value > 0.0:
                table["search_radius"] = value
        if card.word("ADJUST", "YES") == "NO":
            self.findings.take(card, "tied as the surfaces lie", place)
        else:
            self.findings.change(card, "tied as the surfaces lie: nodes are not moved", place)
        return table


def _exponential(distance, pressure):
    """Rows (overclosure, pressure) of springs with p0 where surfaces touch, and 1 % of it at a distance."""
    gaps = np.linspace(-BEGIN, BEGIN, ROWS) * distance
    rows = pressure * np.exp(4.605 * gaps / distance)
    return [[float(gap), float(row)] for gap, row in zip(gaps, rows - rows[0], strict=True)]
