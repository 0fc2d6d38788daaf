"""Groups of the mesh that a scene names, and files of meshes."""

from pcontact.importer.deck import VERTICES, in_plane
from pcontact.mesh.msh import write_msh
from pcontact.mesh.raw import LOWER

KINDS = ("cells", "facets", "nodes")


class Groups:
    """Named groups: cells, facets [(element, face)], nodes."""

    def __init__(self):
        self.members, self._names = {}, {}

    def add(self, kind, name, members):
        """The name under which members are known; the wanted one, or with a number if another group has it.

        Parameters
        ----------
        kind : str
            Of `KINDS`.
        name : str
        members : iterable

        Returns
        -------
        str
        """
        members = list(dict.fromkeys(members))
        key = kind, frozenset(members)
        if key not in self._names:
            free, number = name, 2
            while free in self.members:
                free, number = f"{name}_{number}", number + 1
            self.members[free] = kind, members
            self._names[key] = free
        return self._names[key]

    def of(self, kind):
        """Names and members of the groups of a kind."""
        return {name: members for name, (one, members) in self.members.items() if one == kind}


def write_mesh(path, deck, groups):
    """Write the cells of all groups of cells, and the groups, with the deck's numbers of nodes and cells. Serial.

    Parameters
    ----------
    path : pathlib.Path
        A .msh file, of gmsh's version 2.2, in which an element stands once for each of its groups.
    deck : Deck
    groups : Groups
    """
    numbers = {name: number for number, name in enumerate(groups.members, 1)}
    cells = {element for members in groups.of("cells").values() for element in members}
    dim = 2 if all(in_plane(deck.elements[element][0]) for element in cells) else 3
    elements = []
    for name, members in groups.of("cells").items():
        elements += [(dim, numbers[name], element, *deck.elements[element]) for element in members]
    other = max(cells, default=0)

    def add(d, name, kind, nodes):
        elements.append((d, numbers[name], other + len(elements) + 1, kind, nodes))

    for name, members in groups.of("facets").items():
        for element, face in members:
            corners = deck.corners(element, face)
            add(dim - 1, name, LOWER[len(corners)][0], corners)
    for name, members in groups.of("nodes").items():
        for node in members:
            add(0, name, "vertex", [node])
    used = sorted({node for element in cells for node in deck.elements[element][1]})
    of_number = {number: name for name, number in numbers.items()}
    names = [(d, number, of_number[number]) for d, number in sorted({(d, number) for d, number, *_ in elements})]
    rows = [(tag, kind, number, nodes) for _, number, tag, kind, nodes in elements]
    write_msh(path, ((n, deck.nodes[n]) for n in used), rows, names)


def counted(deck, groups):
    """Cells and nodes of the mesh in words."""
    cells = {element for members in groups.of("cells").values() for element in members}
    nodes = {node for element in cells for node in deck.elements[element][1]}
    kinds = {}
    for element in cells:
        kinds[deck.elements[element][0]] = kinds.get(deck.elements[element][0], 0) + 1
    known = [f"{n} {kind}" for kind, n in kinds.items() if kind in VERTICES]
    return f"{len(nodes)} nodes, cells: {', '.join(known)}"
