"""``pcontact import``: from a deck to a scene with its mesh, and what became of every card."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pcontact.importer.constraints import Cyclic, Pretensions, References, equated, equations
from pcontact.importer.contacts import Contacts, name_of
from pcontact.importer.deck import EDGES, in_plane, read_deck
from pcontact.importer.groups import Groups, counted, write_mesh
from pcontact.importer.history import amplitude_key, factors
from pcontact.importer.materials import bodies, integration_of, materials, order_of, straighten
from pcontact.importer.steps import OUTPUT, Presence, read_steps
from pcontact.importer.supports import Supports
from pcontact.importer.tools import ANALYTICAL, Tools
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import make_directory, replace_file
from pcontact.scene.reader import read_scene
from pcontact.scene.writer import text, toml_key

TAKEN, CHANGED, LEFT_OUT, NO_EFFECT = "taken", "changed", "left out", "without effect"
# in the order of their weight, with what they mean
KINDS = {
    LEFT_OUT: "not in the scene: its answer is that of another problem",
    CHANGED: "in the scene, in another way",
    TAKEN: "in the scene",
    NO_EFFECT: "has no influence on the answer",
}
# thermal strain up to which small strain stands for any: its square is what it leaves out
SMALL = 0.01
# cards that the mesh consists of, with parameters that they have beside those of sets
STRUCTURE = {
    "NODE": (), "NSET": (), "ELSET": (), "INCLUDE": (), "SYSTEM": (), "PART": ("NAME",), "ENDPART": (),
    "INSTANCE": ("NAME", "PART"), "ENDINSTANCE": (), "ASSEMBLY": ("NAME",), "ENDASSEMBLY": (), "NGEN": ("LINE",),
    "NFILL": ("BIAS",), "NCOPY": ("OLDSET", "NEWSET", "CHANGENUMBER", "SHIFT"), "ELGEN": (),
    "ELCOPY": ("OLDSET", "NEWSET", "ELEMENTSHIFT", "SHIFTNODES"),
}  # fmt: skip
# part of the range by which temperatures may be off a linear function of the place
_LINEAR = 1e-9
SCENE, MESH, LIST = "scene.toml", "mesh.msh", "import.txt"
DECKS = (".inp",)


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


@dataclass
class Translated:
    """A scene in the making.

    Attributes
    ----------
    deck : Deck
    findings : Findings
    groups : Groups
    tables : list of (str, dict, str)
        See `pcontact.importer.translate.text`.
    tools : list of pcontact.importer.tools.Tool
        Rigid surfaces.
    """

    deck: object
    findings: Findings
    groups: Groups
    tables: list = field(default_factory=list)
    tools: list = field(default_factory=list)


def translate(path, mesh_name):
    """Read a deck and make tables of a scene of it.

    Parameters
    ----------
    path : pathlib.Path
    mesh_name : str
        Name of the mesh file, beside the scene.

    Returns
    -------
    Translated

    Raises
    ------
    InputError
        The deck cannot be read.
    """
    deck, findings, groups = read_deck(path), Findings(), Groups()
    done = Translated(deck, findings, groups)
    for card in deck.cards:
        _say(card, findings)
    for card, place, words in deck.lost:
        findings.leave(card, words, place)
    for card, place, words in deck.again:
        findings.change(card, words, place)
    presence = Presence(deck, findings)
    known = materials(deck, findings)
    parts, plane, thickness = bodies(deck, findings, known)
    parts = presence.split(parts)
    names = {material: deck.spelling[material] for _, material, _ in parts}
    nodes = {node for _, _, cells in parts for e in cells for node in deck.elements[e][1]}
    if not nodes:
        raise InputError(f"{path}: found no element of a solid with a section; allowed: *SOLID SECTION of elements")
    dim = 3 if any(not in_plane(deck.elements[e][0]) for _, _, cells in parts for e in cells) else 2
    if thickness != 1.0:
        card = deck.cards_of("SOLIDSECTION")[0]
        findings.change(card, f"forces at nodes are those of a thickness of 1, divided by {thickness:g}")
    regions = [(groups.add("cells", name, cells), material) for name, material, cells in parts]
    tools = Tools(deck, float(np.ptp([deck.nodes[n] for n in nodes], axis=0).max()), mesh_name)
    pairs = Contacts(deck, findings, groups, known, parts, tools)
    contacts = pairs.tables()
    drawn = Pretensions(deck, findings, groups)
    hung = References(deck, findings, groups, {e for _, _, cells in parts for e in cells}, tools)
    references = {(node, 0): (node, 0) for node in drawn.nodes - nodes} | hung.dofs()
    supports = Supports(deck, findings, nodes, dim, references)
    run = read_steps(deck, findings, supports, pairs, presence.changes)
    linear = list(equations(deck, findings, groups, supports, dim))
    cyclic = list(Cyclic(deck, findings, groups).tables())
    pairs.press(supports.pushed() | equated(deck))
    end, finite = run.ramp_end, run.finite
    sections, hanging = list(drawn.tables(supports, end, run.names)), hung.tables(supports, run, dim, thickness)
    contacts += [(table, card) for _, table, card in pairs.begun]
    for table, _ in contacts:
        table |= run.acting(name_of(table))
    heat = _temperatures(deck, findings, groups, supports, parts, known, end)
    finite = _strain(finite, findings, (known, parts, heat), plane, supports)
    for key, table in known.items():
        straighten(deck, findings, key, table, finite is not None)
    if finite is not None:
        for _, card in sections:
            findings.leave(card, "NLGEOM: sections of bolts are those of small strain")
    held = list(supports.displacements(groups, end, run.names))
    linear += supports.tilted(groups)
    title = next((" ".join(words) for card in deck.cards if card.key == "HEADING" for _, words in card.rows), "")
    mesh = _mesh(deck, mesh_name, plane, finite is not None)
    done.tables = [("", {"title": title or path.name}, ""), ("[mesh]", mesh, "")]
    for key, name in names.items():
        table = {k: v for k, v in known[key].items() if k != "expansion" or heat}
        done.tables.append((f"[materials.{toml_key(name)}]", table, _at(deck.materials[key][0])))
    for (name, m), (_, _, cells) in zip(regions, parts, strict=True):
        body = {"region": name, "material": names[m]}
        if integration_of(deck, findings, cells) == "reduced":
            body["integration"] = "reduced"
        if mesh.get("order") == 2 and deck.elements[cells[0]][0] not in EDGES:
            body["order"] = 1
        body |= presence.keys(cells, run.names, finite is not None, findings)
        done.tables.append(("[[bodies]]", body, ""))
    for header, found in (
        ("[[contacts]]", contacts), ("[[displacements]]", held + hanging["[[displacements]]"]),
        ("[[couplings]]", hanging["[[couplings]]"]),
        ("[[loads]]", supports.loads(groups, end, thickness) + hanging["[[loads]]"]), ("[[temperatures]]", heat),
        ("[[pretensions]]", sections), ("[[equations]]", linear), ("[[periodic]]", cyclic),
    ):  # fmt: skip
        done.tables += [(header, table, _at(card)) for table, card in found]
    done.tables += run.tables()
    for key, members in deck.node_sets.items():
        if deck.spelling[key] not in groups.members and nodes > set(members) and members:
            groups.add("nodes", deck.spelling[key], members)
    findings.unsaid(deck.cards)
    done.tools = list(tools.used.values())
    return done


def _mesh(deck, name, plane, finite):
    """Table [mesh]."""
    mesh = {"file": name}
    order, serendipity = order_of(deck)
    if order == 2:
        mesh["order"] = 2
    if serendipity:
        mesh["serendipity"] = True
    if plane is not None and plane != "plane_strain":
        mesh["kinematics"] = plane
    if finite:
        mesh["strain"] = "finite"
    return mesh


def _strain(card, findings, of_bodies, plane, supports):
    """The card that asks for finite strain, None if it cannot be had; pressures follow it."""
    known, parts, heat = of_bodies
    if card is not None:
        turned = any(isinstance(known[material]["E"], list) for _, material, _ in parts)
        card = _finite(card, findings, heat, _thermal(heat, known), turned)
    supports.follower = card is not None and plane != "plane_stress"
    if card is not None and plane == "plane_stress" and supports.pressures.now:
        findings.leave(next(iter(supports.pressures.now.values())).card, "a pressure that turns with the surface")
    return card


def _at(card):
    return f"{card.title}, {card.place}"


def _say(card, findings):
    """Say what can be said of a card by its keyword alone."""
    if card.key in OUTPUT:
        findings.skip(card)
    elif card.key in STRUCTURE:
        findings.know(card, "NSET", "ELSET", "GENERATE", "INPUT", "UNSORTED", "FREQUENCY", "INTERNAL", "INSTANCE",
                      *STRUCTURE[card.key])  # fmt: skip
        findings.take(card)
    elif card.key == "SURFACE":
        findings.know(card, "NAME", "TYPE", "INTERNAL")
        if card.word("TYPE", "ELEMENT") not in ("ELEMENT", "NODE", *ANALYTICAL):
            findings.leave(card, f"allowed: TYPE=ELEMENT, NODE, {', '.join(ANALYTICAL)}")
        else:
            findings.take(card)


def _thermal(heat, known):
    """Largest strain of temperatures that are uniform; infinite where one is not."""
    rises = [abs(one["value"] - one["reference"]) if not isinstance(one["value"], str) else np.inf for one, _ in heat]
    expansion = max((float(np.max(np.abs(table.get("expansion") or 0.0))) for table in known.values()), default=0.0)
    return expansion * max(rises, default=0.0)


def _finite(card, findings, heat, strain, turned):
    """The card that asks for finite strain, if it can be had."""
    if turned:
        findings.leave(card, "NLGEOM with an orthotropic material: small strain")
        return None
    if heat and strain <= SMALL:
        findings.change(card, f"NLGEOM with temperatures: small strain; they strain by {100 * strain:.2g} %")
        return None
    if heat:
        findings.leave(card, "NLGEOM with temperatures: small strain")
        return None
    findings.change(card, "NLGEOM: finite strain, Hooke's law of logarithmic strain; the same where strains are small")
    return card


def _temperatures(deck, findings, groups, supports, parts, known, end):
    """Tables [[temperatures]] of the bodies that expand."""
    tables = []
    for name, material, cells in parts:
        if not np.any(known[material].get("expansion") or 0.0):
            continue
        of_node = {}
        for node in sorted({node for e in cells for node in deck.elements[e][1]}):
            history, start = supports.temperatures.histories.get(node), supports.initial.get(node, 0.0)
            of_node[node] = start, history.key() if history else ((0.0, start),)
        card = next((one.card for one in supports.temperatures.now.values()), None)
        for members, keys in _alike(deck, cells, of_node):
            if all({value for _, value in points} == {start} for start, points in keys):
                continue
            region = groups.add("cells", name if members == cells else f"{name}_heated", members)
            found = _temperature(deck, keys, end)
            if found is None:
                findings.leave(card, f"temperatures of {name} that are no linear function of the place")
                continue
            tables.append(({"region": region, **found}, card))
    return tables


def _alike(deck, cells, of_node):
    """Cells of one temperature, and those in which it varies; with the nodes by their start and history."""
    parts = {}
    for element in cells:
        keys = {of_node[node] for node in deck.elements[element][1]}
        parts.setdefault(keys.pop() if len(keys) == 1 else None, []).append(element)
    for members in parts.values():
        nodes = {}
        for node in sorted({node for e in members for node in deck.elements[e][1]}):
            nodes.setdefault(of_node[node], []).append(node)
        yield members, nodes


def _temperature(deck, keys, end):
    """Value, reference and amplitude of the temperature of a body, from the nodes by start and history; or None."""
    starts = {start for start, _ in keys}
    if len(starts) > 1:
        return None
    start = starts.pop()
    shapes, rows, values = set(), [], []
    for (_, points), nodes in keys.items():
        rise = [(time, value - start) for time, value in points]
        most = max((value for _, value in rise), key=abs)
        if most != 0.0:
            table = factors(tuple(rise), most, end)
            shapes.add(None if table is None else tuple((t, round(f, 12)) for t, f in table))
        rows += [deck.nodes[n] for n in nodes]
        values += [most] * len(nodes)
    if len(shapes) != 1:
        return None
    table = shapes.pop()
    more = {"reference": start} | amplitude_key(table)
    if len(set(values)) == 1:
        return {"value": start + values[0], **more}
    matrix = np.hstack([np.ones((len(rows), 1)), np.array(rows)])
    solved, *_ = np.linalg.lstsq(matrix, np.array(values), rcond=None)
    if np.abs(matrix @ solved - values).max() > _LINEAR * np.ptp(values):
        return None
    terms = [f"{c!r}*{axis}" for c, axis in zip(solved[1:].tolist(), "xyz", strict=True) if abs(c) > 0.0]
    return {"value": " + ".join([repr(start + float(solved[0])), *terms]), **more}


def import_file(path, directory=None):
    """Make a scene and its mesh of a deck. Serial.

    Parameters
    ----------
    path : str or pathlib.Path
    directory : str or pathlib.Path, optional
        Where `scene.toml`, `mesh.msh` and `import.txt` go; absent: a directory with the name of the file.

    Returns
    -------
    int
        Exit status: 0, or 1 where something of the deck was left out.

    Raises
    ------
    InputError
        The deck cannot be read.
    OutputError
    """
    path = Path(path)
    if path.suffix.lower() not in DECKS:
        raise InputError(f"{path}: found {path.suffix!r} as the type of the file; allowed: {', '.join(DECKS)}")
    directory = path.with_suffix("") if directory is None else Path(directory)
    done = translate(path, MESH)
    findings = done.findings
    make_directory(directory)
    write_mesh(directory / MESH, done.deck, done.groups)
    for tool in done.tools:
        tool.write(directory)
    scene = directory / SCENE
    head = [f"From {path.name} by pcontact import; {LIST} says what became of every line."]
    if not findings.complete:
        head += ["Not all of the deck is here:"]
        head += [f"  {place}: {title}: {words}" for _, place, title, words in findings.of(LEFT_OUT)]
    replace_file(scene, text(done.tables, head))
    replace_file(directory / LIST, "\n".join([f"{path}", "", *findings.lines(), ""]))
    read_scene(scene)
    for line in findings.lines((LEFT_OUT, CHANGED)):
        log.info("%s", line)
    counts = ", ".join(f"{len(findings.of(kind))} {kind}" for kind in (TAKEN, NO_EFFECT, CHANGED, LEFT_OUT))
    mesh = counted(done.deck, done.groups)
    log.info("wrote %s, %s (%s), %s: %s", scene, directory / MESH, mesh, directory / LIST, counts)
    return 0 if findings.complete else 1
