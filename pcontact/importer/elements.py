"""Elements of decks: which cells they are, and their faces."""

import re
from typing import NamedTuple

# faces of Abaqus and CalculiX, by the number of vertices and the dimension; vertices from 0
FACES = {
    (2, 3): ((0, 1), (1, 2), (2, 0)),
    (2, 4): ((0, 1), (1, 2), (2, 3), (3, 0)),
    (3, 4): ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    (3, 5): ((0, 1, 2, 3), (0, 4, 1), (1, 4, 2), (2, 4, 3), (3, 4, 0)),
    (3, 6): ((0, 1, 2), (3, 5, 4), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    (3, 8): ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
}
# meshio's names by dimension and number of nodes; node orders are the same
_NAMES = {
    (2, 3): "triangle", (2, 6): "triangle6", (2, 4): "quad", (2, 8): "quad8",
    (3, 4): "tetra", (3, 10): "tetra10", (3, 6): "wedge", (3, 15): "wedge15", (3, 8): "hexahedron",
    (3, 20): "hexahedron20", (3, 5): "pyramid",
}  # fmt: skip
# vertices of cells by meshio's names
VERTICES = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "tetra": 4, "tetra10": 4, "pyramid": 5, "wedge": 6,
            "wedge15": 6, "hexahedron": 8, "hexahedron20": 8}  # fmt: skip
# edges of cells with nodes in their middles, in the order of these
EDGES = {
    "triangle6": ((0, 1), (1, 2), (2, 0)),
    "quad8": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetra10": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
    "hexahedron20": ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)),
    "wedge15": ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
}
# cells that have reduced integration, and all without nodes in the middles of their faces
REDUCED = ("quad8", "hexahedron20")
SERENDIPITY = (*REDUCED, "wedge15")
_TYPE = re.compile(r"(C3D|CPE|CPS|CAX)(\d+)([A-Z]*)")
# nodes of elements that are no cells of a solid
_OTHERS = {"S3": 3, "S6": 6, "S4": 4, "S4R": 4, "S8": 8, "S8R": 8, "M3D3": 3, "M3D4": 4, "M3D4R": 4, "M3D6": 6,
           "M3D8": 8, "M3D8R": 8, "B31": 2, "B31R": 2, "B32": 3, "B32R": 3, "T3D2": 2, "T2D2": 2, "T3D3": 3,
           "SPRINGA": 2, "SPRING1": 1, "SPRING2": 2, "DASHPOTA": 2, "GAPUNI": 2, "MASS": 1, "DCOUP3D": 1, "R3D4": 4,
           "R3D3": 3, "R2D2": 2, "RAX2": 2, "SFM3D4": 4, "F3D4": 4}  # fmt: skip
# elements of rigid surfaces
RIGID = ("R3D3", "R3D4", "R2D2", "RAX2")
KINEMATICS = {"CPE": "plane_strain", "CPS": "plane_stress", "CAX": "axisymmetric"}
_REMARKS = {
    "R": "all its quadrature points in place of reduced integration",
    "I": "no incompatible modes",
    "H": "no pressure of its own; mean dilatation where nu is near 0.5",
    "RH": "all its quadrature points in place of reduced integration, no pressure of its own",
    "M": "as it is without M",
    "T": "no temperature of its own",
}


class Kind(NamedTuple):
    """A type of elements.

    Attributes
    ----------
    n_nodes : int or None
        None: not known.
    dim : int
        2 or 3; 0: no cell of a solid.
    cell : str or None
        Meshio's name.
    family : str
        C3D, CPE, CPS, CAX; "" for others.
    remark : str
        What the cells do not have of the element; "": nothing.
    reduced : bool
        Whether it has the reduced integration of the program's cells of 8 and 20 nodes.
    """

    n_nodes: int | None
    dim: int
    cell: str | None
    family: str
    remark: str
    reduced: bool = False


def kind_of(word):
    """The type of elements that a deck names."""
    found = _TYPE.fullmatch(word)
    if found is None:
        return Kind(_OTHERS.get(word), 0, None, "", "")
    family, count, letters = found.group(1), int(found.group(2)), found.group(3)
    dim = 3 if family == "C3D" else 2
    cell = _NAMES.get((dim, count))
    reduced = cell in REDUCED and family != "CAX" and letters in ("R", "RH")
    letters = letters.removeprefix("R") if reduced else letters
    return Kind(count, dim, cell, family, _REMARKS.get(letters, letters), reduced)


def in_plane(cell):
    """Whether a cell is one of the plane."""
    return cell.startswith(("tri", "quad"))


def faces_of(cell):
    """Vertices of the faces of a cell, in the deck's numbering from S1 on."""
    dim = 2 if in_plane(cell) else 3
    return FACES[dim, VERTICES[cell]]


def face_nodes(cell, face):
    """Local numbers of all nodes of a face, those in the middles of edges too."""
    corners = faces_of(cell)[face]
    inside = set(corners)
    middles = [VERTICES[cell] + k for k, edge in enumerate(EDGES.get(cell, ())) if set(edge) <= inside]
    return [*corners, *middles]
