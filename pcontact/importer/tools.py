"""Rigid surfaces of a deck, of rigid elements or of lines and arcs, as obstacles whose surface is a mesh file."""

from dataclasses import dataclass, field
from itertools import chain, count

import numpy as np

from pcontact.importer.deck import outward
from pcontact.mesh.msh import write_msh
from pcontact.mesh.raw import LOWER

# kinds of surfaces that are lines and arcs
ANALYTICAL = ("SEGMENTS", "CYLINDER", "REVOLUTION")
# [degrees] of an arc, or of a turn about an axis, that a facet of degree 2 spans at most
ARC = 5.0
# [bodies' extents] on both sides of the profile of a cylinder
_BEYOND = 1.0
# kinds of facets of degree 2 by their number of nodes
_CURVED = {3: "line3", 6: "triangle6", 9: "quad9"}
# corners of facets of degree 2, by their number of nodes
_CORNERS = {3: 2, 6: 3, 9: 4}
_TWO = 2
# [extents] places that are one
_SAME = 1e-9


@dataclass(eq=False)
class Tool:
    """A rigid surface.

    Attributes
    ----------
    name : str
    nodes : ndarray (n, 3)
    facets : list of list of int
        Rows of nodes; of an open surface the first one looks into the free space: counterclockwise seen from there, in
        the plane with the free space to the right.
    curved : bool
        Whether facets have degree 2.
    table : dict
        Of the obstacle; its `file` is the name of the mesh file.
    """

    name: str
    nodes: np.ndarray
    facets: list
    curved: bool = False
    table: dict = field(default_factory=dict)

    def write(self, directory):
        """Write the mesh file. Serial."""
        kinds = _CURVED if self.curved else {n: name for n, (name, _) in LOWER.items()}
        facets = [(k, kinds[len(one)], 1, [n + 1 for n in one]) for k, one in enumerate(self.facets, 1)]
        write_msh(directory / self.table["file"], enumerate(self.nodes.tolist(), 1), facets)


class Tools:
    """Rigid surfaces of a deck.

    Parameters
    ----------
    deck : Deck
    size : float
        Extent of the bodies [length].
    mesh_name : str
        Name of the file of the bodies' mesh, beside which those of the tools lie.
    """

    def __init__(self, deck, size, mesh_name):
        self._deck, self._size, self._mesh_name, self.used = deck, size, mesh_name, {}

    @staticmethod
    def rigid(surface):
        """Return whether a surface is one."""
        return bool(surface.sides) or surface.card.word("TYPE") in ANALYTICAL

    def of(self, surface, faces=()):
        """The tool of a rigid surface.

        Parameters
        ----------
        surface : pcontact.importer.deck.Surface
        faces : list of (int, int)
            Of solids that it meets: the tool looks at them.

        Raises
        ------
        InputError
            Lines of an analytical surface that cannot be read.
        """
        key = surface.name.upper()
        if key not in self.used:
            made = self._of_elements(surface) if surface.sides else self._analytical(surface)
            made.table |= {"shape": "mesh", "file": self._file(surface.name)}
            self._face(made, faces)
            self.used[key] = made
        return self.used[key]

    def _file(self, name):
        """A name of a mesh file that no other one has, also where capitals do not count."""
        stem = "".join(c if c.isalnum() or c in "_-" else "_" for c in name)
        taken = {file.lower() for file in (self._mesh_name, *(tool.table["file"] for tool in self.used.values()))}
        files = (f"{stem}{more}.msh" for more in chain([""], map("_{}".format, count(2))))
        return next(file for file in files if file.lower() not in taken)

    def _of_elements(self, surface):
        numbers = {}
        facets = [[numbers.setdefault(n, len(numbers)) for n in self._deck.elements[element][1]]
                  for element in surface.sides]  # fmt: skip
        return Tool(surface.name, np.array([self._deck.nodes[n] for n in numbers]), facets)

    def _face(self, tool, faces):
        """Let a tool look at the nearest of the faces that it meets."""
        if not faces:
            return
        corners = [tool.nodes[facet[: _CORNERS[len(facet)] if tool.curved else len(facet)]] for facet in tool.facets]
        middles = np.array([x.mean(axis=0) for x in corners])
        centres = np.array([np.mean([self._deck.nodes[n] for n in self._deck.corners(*row)], axis=0) for row in faces])
        away = np.array([np.linalg.norm(middles - centre, axis=1) for centre in centres])
        face, facet = np.unravel_index(int(np.argmin(away)), away.shape)
        x = corners[facet]
        way = x[1] - x[0]
        normal = np.array([way[1], -way[0], 0.0]) if len(x) == _TWO else np.cross(way, x[-1] - x[0])
        back = normal @ outward(self._deck, faces[face]) > 0.0
        if self._closed(tool, corners):
            # the program has a closed surface look outwards, whatever its order of nodes
            tool.table |= {"inside": True} if back == (_content(corners) > 0.0) else {}
            return
        # an open one looks where its first facet does
        first = tool.facets.pop(facet)
        tool.facets.insert(0, _turned(first, tool.curved) if back else first)

    def _closed(self, tool, corners):
        """Return whether every edge, or in the plane every end, belongs to two facets."""
        digits = int(np.ceil(-np.log10(_SAME * max(self._size, np.ptp(tool.nodes))))) if len(tool.nodes) else 0
        ends = {}
        for x in corners:
            places = [tuple(np.round(p, digits) + 0.0) for p in x]
            edges = zip(places, places[1:] + places[:1], strict=True)
            for one in places if len(x) == _TWO else map(frozenset, edges):
                ends[one] = ends.get(one, 0) + 1
        return set(ends.values()) == {2}

    def _analytical(self, surface):
        """Profiles as curved segments; in space drawn along a direction, or turned about an axis."""
        kind, rows = surface.card.word("TYPE"), list(surface.card.rows)
        frame = []
        while kind != "SEGMENTS" and rows and rows[0][1][0].upper() != "START":
            frame.append(surface.card.numbers(*rows.pop(0)))
        points = _profile(surface.card, rows)
        if kind == "SEGMENTS":
            nodes = np.column_stack([points, np.zeros(len(points))])
            facets = [[k, k + 2, k + 1] for k in range(0, len(points) - 2, 2)]
            return Tool(surface.name, nodes, facets, curved=True)
        numbers = [x for row in frame for x in row]
        wanted = 9 if kind == "CYLINDER" else 6
        if len(numbers) != wanted:
            raise surface.card.refuse(f"{len(numbers)} numbers before START", f"{wanted} of the points of its axes")
        return self._swept(surface, kind, np.array(numbers).reshape(-1, 3), points)

    def _swept(self, surface, kind, frame, points):
        a, b = frame[:2]
        if kind == "CYLINDER":
            x = (b - a) / np.linalg.norm(b - a)
            way = frame[2] - a
            way -= (way @ x) * x
            way /= np.linalg.norm(way)
            y = np.cross(x, way)
            along = np.array([-_BEYOND, 0.0, _BEYOND]) * self._size
            grid = [[a + p * x + q * y + s * way for s in along] for p, q in points]
        else:
            axis = (b - a) / np.linalg.norm(b - a)
            side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
            side /= np.linalg.norm(side)
            other, steps = np.cross(axis, side), _TWO * int(np.ceil(360.0 / ARC))
            turns = 2.0 * np.pi * np.arange(steps + 1) / steps
            grid = [[a + q * axis + p * (np.cos(t) * side + np.sin(t) * other) for t in turns] for p, q in points]
        return Tool(surface.name, *_facets(grid), curved=True)


def _content(corners):
    """Area or volume within facets, times 2 or 6; negative where they look inwards."""
    if len(corners[0]) == _TWO:
        return sum(a[0] * b[1] - a[1] * b[0] for a, b in corners)
    return sum(x[0] @ np.cross(x[k], x[k + 1]) for x in corners for k in range(1, len(x) - 1))


def _profile(card, rows):
    """Ends and middles of curved segments, (2 n + 1, 2), along the lines and arcs of a profile."""
    points = []
    for place, words in rows:
        kind, numbers = words[0].upper(), card.numbers(place, words[1:])
        wanted = {"START": 2, "LINE": 2, "CIRCL": 4, "PARAB": 4}.get(kind)
        if wanted is None or len(numbers) < wanted or (not points) != (kind == "START"):
            raise card.refuse(", ".join(words), "START, then LINE, CIRCL or PARAB with their points", place)
        end = np.array(numbers[:2])
        if kind == "START":
            points.append(end)
            continue
        begin = points[-1]
        if kind == "LINE":
            points += [0.5 * (begin + end), end]
        elif kind == "PARAB":
            # the first two numbers are the middle, the others the end
            points += [end, np.array(numbers[2:4])]
        else:
            points += _arc(begin, end, np.array(numbers[2:4]))
    if len(points) < _TWO:
        raise card.refuse("no lines", "START, then LINE, CIRCL or PARAB with their points")
    return np.array(points)


def _arc(begin, end, centre):
    """Middles and ends of curved segments along an arc of less than half a circle."""
    first, last = begin - centre, end - centre
    turn = np.arctan2(first[0] * last[1] - first[1] * last[0], first @ last)
    count = max(1, int(np.ceil(abs(np.degrees(turn)) / ARC)))
    angles = turn * np.arange(1, 2 * count + 1) / (2 * count)
    turns = [np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]]) for t in angles[:-1]]
    return [*(centre + q @ first for q in turns), end]


def _facets(grid):
    """Nodes and quadrilaterals of degree 2 of a grid of points [along the profile][across it]."""
    rows, columns = len(grid), len(grid[0])
    nodes = np.array(grid).reshape(-1, 3)
    facets = []
    for i in range(0, rows - 2, 2):
        for j in range(0, columns - 2, 2):
            a, b, c = ([(i + r) * columns + j + k for k in range(3)] for r in range(3))
            if np.array_equal(grid[i][j], grid[i][j + 2]):
                # on the axis of a turn
                facets.append([a[0], c[0], c[2], b[0], c[1], b[2]])
            elif np.array_equal(grid[i + 2][j], grid[i + 2][j + 2]):
                facets.append([a[0], c[0], a[2], b[0], b[2], a[1]])
            else:
                facets.append([a[0], c[0], c[2], a[2], b[0], c[1], b[2], a[1], b[1]])
    return nodes, facets


def _turned(facet, curved):
    """The same facet, looking to the other side."""
    if not curved:
        return facet[::-1]
    corners, middles = facet[: _CORNERS[len(facet)]], facet[_CORNERS[len(facet)] :]
    if len(corners) == _TWO:
        return [*corners[::-1], *middles]
    edges = middles[: len(corners)]
    # edges of the corners turned about the first one
    return [corners[0], *corners[:0:-1], *edges[::-1], *middles[len(corners) :]]
