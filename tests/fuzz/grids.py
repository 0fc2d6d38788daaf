"""Small meshes made with numpy alone: blocks of a lattice, their surfaces, and the writing of gmsh's format.

Nothing here comes from the program that is tested: the numbering of cells and facets is stated anew, so that a
mistake in it would show.
"""

import itertools
import re
from dataclasses import dataclass, field
from functools import cache

import numpy as np

# nodes of the cells on [0, 1]^d or the unit simplex, vertices first, in VTK's order
_C2 = [(0, 0), (1, 0), (1, 1), (0, 1)]
_C3 = [(*p, z) for z in (0, 1) for p in _C2]
_T2 = [(0, 0), (1, 0), (0, 1)]
_T3 = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
_E2 = [(0, 1), (1, 2), (2, 3), (3, 0)]
_E3 = [*_E2, (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
_F3 = [(0, 4, 7, 3), (1, 2, 6, 5), (0, 1, 5, 4), (3, 2, 6, 7), (0, 1, 2, 3), (4, 5, 6, 7)]
_ET2, _ET3 = [(0, 1), (1, 2), (2, 0)], [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]

VERTICES = {"segment": [(0,), (1,)], "triangle": _T2, "quadrilateral": _C2, "tetrahedron": _T3, "hexahedron": _C3}
# vertices whose mean is a node of degree 2, in order
MIDDLES = {
    "segment": [(0, 1)],
    "triangle": _ET2,
    "quadrilateral": [*_E2, (0, 1, 2, 3)],
    "tetrahedron": _ET3,
    "hexahedron": [*_E3, *_F3, tuple(range(8))],
}
FACETS = {
    "triangle": ("segment", _ET2),
    "quadrilateral": ("segment", _E2),
    "tetrahedron": ("triangle", [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]),
    "hexahedron": ("quadrilateral", _F3),
}
DIM = {"segment": 1, "triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
# gmsh's number of a type by degree, and where gmsh's nodes are in VTK's order
GMSH = {"segment": (1, 8), "triangle": (2, 9), "quadrilateral": (3, 10), "tetrahedron": (4, 11), "hexahedron": (5, 12)}
_GMSH_EDGES = [(0, 1), (0, 3), (0, 4), (1, 2), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 7), (5, 6), (6, 7)]
_GMSH_FACES = [(0, 1, 2, 3), (0, 1, 4, 5), (0, 3, 4, 7), (1, 2, 5, 6), (2, 3, 6, 7), (4, 5, 6, 7)]
_GMSH_TET = [(0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3)]


def reference(cell, degree):
    """Nodes (n, d) of a cell in its own coordinates."""
    x = np.array(VERTICES[cell], dtype=float)
    if degree == 1:
        return x
    return np.vstack([x, [x[list(group)].mean(axis=0) for group in MIDDLES[cell]]])


def facet_nodes(cell, degree):
    """Type of the facets and the local nodes of each."""
    kind, facets = FACETS[cell]
    if degree == 1:
        return kind, [list(facet) for facet in facets]
    first, places = len(VERTICES[cell]), [frozenset(group) for group in MIDDLES[cell]]
    rows = []
    for facet in facets:
        more = [first + places.index(frozenset(facet[k] for k in group)) for group in MIDDLES[kind]]
        rows.append([*facet, *more])
    return kind, rows


@cache
def symmetries(cell, degree, turned=False):
    """Permutations of the nodes that number the same cell in another way, in the same sense or (`turned`) the other."""
    x, d = reference(cell, degree), DIM[cell]
    corners, found = np.array(VERTICES[cell], dtype=float), []
    for image in itertools.permutations(range(len(corners)), d + 1):
        base = corners[image[0]]
        matrix = np.array([corners[k] - base for k in image[1:]]).T
        if abs(abs(np.linalg.det(matrix)) - 1.0) > 1e-9 or (np.linalg.det(matrix) < 0.0) != turned:
            continue
        y = x @ matrix.T + base
        match = np.abs(y[:, None] - x[None]).max(axis=2) < 1e-9
        if match.any(axis=1).all():
            found.append(match.argmax(axis=1))
    return found


@dataclass
class Elements:
    """Cells or facets of one type: `nodes` (n, k) in VTK's order."""

    cell: str
    degree: int
    nodes: np.ndarray


@dataclass
class Mesh:
    """Points (n, d), and groups by name: cells and facets as lists of Elements, vertices as numbers of points."""

    points: np.ndarray
    bodies: dict = field(default_factory=dict)
    facets: dict = field(default_factory=dict)
    vertices: dict = field(default_factory=dict)

    @property
    def dim(self):
        """Dimension of the space."""
        return self.points.shape[1]

    def copy(self, points=None):
        """With other points."""
        new = self.points if points is None else points

        def same(groups):
            return {k: [Elements(e.cell, e.degree, e.nodes.copy()) for e in v] for k, v in groups.items()}

        return Mesh(new.copy(), same(self.bodies), same(self.facets), {k: v.copy() for k, v in self.vertices.items()})


# -- blocks --------------------------------------------------------------------------------------------------


def _simplices(d, flip):
    """Kuhn's simplices of the unit cube, as corners (k, d + 1, d), of positive volume; `flip` mirrors the cube."""
    out = []
    for order in itertools.permutations(range(d)):
        corners = np.vstack([np.zeros(d), np.cumsum(np.eye(d)[list(order)], axis=0)])
        if flip:
            corners[:, 0] = 1.0 - corners[:, 0]
        if np.linalg.det(corners[1:] - corners[0]) < 0.0:
            corners[[-2, -1]] = corners[[-1, -2]]
        out.append(corners)
    return out


def _pieces(cell, flip):
    """Nodes of degree 2 of the cells of a unit cube, doubled: whole numbers (k, nodes, d)."""
    x, d = reference(cell, 2), DIM[cell]
    if cell in ("quadrilateral", "hexahedron"):
        return np.rint(2.0 * x[None]).astype(int)
    rows = [corners[0] + x @ (corners[1:] - corners[0]) for corners in _simplices(d, flip)]
    return np.rint(2.0 * np.array(rows)).astype(int)


def block(name, cell, degree, counts, keep=None, flip=None):
    """A lattice of cells on [0, 1]^d as a Mesh, with its sides as groups NAME_x0, NAME_x1, ..., others as NAME_inner.

    Parameters
    ----------
    name : str
    cell : str or list of str
        Type; two in the plane: the left half and the right half.
    degree : {1, 2}
        Of the geometry.
    counts : sequence of int
        Cubes along each axis.
    keep : callable, optional
        Of the numbers (d,) of a cube: whether it is there.
    flip : callable, optional
        Of these: which diagonal is cut.
    """
    counts, cells = np.array(counts), [cell] if isinstance(cell, str) else list(cell)
    d = len(counts)
    shape, tables = 2 * counts + 1, {}
    for cube in itertools.product(*map(range, counts)):
        if keep is not None and not keep(cube):
            continue
        kind = cells[min(cube[0] * len(cells) // counts[0], len(cells) - 1)]
        places = _pieces(kind, bool(flip and flip(cube))) + 2 * np.array(cube)
        tables.setdefault(kind, []).append(np.ravel_multi_index(np.moveaxis(places, -1, 0), shape))
    elements = []
    for kind, rows in tables.items():
        nodes = np.concatenate(rows)
        elements.append(Elements(kind, degree, nodes if degree == 2 else nodes[:, : len(VERTICES[kind])]))
    used = np.unique(np.concatenate([e.nodes.ravel() for e in elements]))
    number = np.full(np.prod(shape), -1)
    number[used] = np.arange(len(used))
    for e in elements:
        e.nodes = number[e.nodes]
    lattice = np.array(np.unravel_index(used, shape)).T
    mesh = Mesh(lattice / (2.0 * counts), {name: elements})
    _sides(mesh, name, elements, lattice, shape)
    corner = np.flatnonzero((lattice == np.where(np.arange(d) == d - 1, shape - 1, 0)).all(axis=1))
    mesh.vertices = {f"{name}_corner": corner}
    return mesh


def _sides(mesh, name, elements, lattice, shape):
    """Facets of one cell only, by where they are."""
    count = {}
    for e in elements:
        for row in facet_nodes(e.cell, e.degree)[1]:
            n = DIM[e.cell] if e.cell in ("triangle", "tetrahedron") else 2 ** (DIM[e.cell] - 1)
            for nodes in e.nodes[:, row]:
                key = frozenset(nodes[:n].tolist())
                count.setdefault(key, []).append((FACETS[e.cell][0], e.degree, nodes))
    d = lattice.shape[1]
    for found in count.values():
        if len(found) > 1:
            continue
        kind, degree, nodes = found[0]
        at, side = lattice[nodes], f"{name}_inner"
        for axis in range(d):
            for end, value in enumerate((0, shape[axis] - 1)):
                if (at[:, axis] == value).all():
                    side = f"{name}_{'xyz'[axis]}{end}"
        groups = mesh.facets.setdefault(side, [])
        if not groups or groups[-1].cell != kind:
            groups.append(Elements(kind, degree, []))
        groups[-1].nodes.append(nodes)
    for groups in mesh.facets.values():
        for e in groups:
            e.nodes = np.array(e.nodes)


def sectioned(mesh, name, axis):
    """The facets inside a block that lie in the middle plane of its lattice across an axis, as the group NAME_section.

    The block is as :func:`block` has left it, with an even number of cubes along the axis.
    """
    groups = []
    for e in mesh.bodies[name]:
        kind, rows = facet_nodes(e.cell, e.degree)
        facets = np.concatenate([e.nodes[:, row] for row in rows])
        inside = (np.abs(mesh.points[facets][:, :, axis] - 0.5) < 1e-9).all(axis=1)
        groups += [(kind, e.degree, nodes) for nodes in facets[inside]]
    once = {frozenset(nodes.tolist()): (kind, degree, nodes) for kind, degree, nodes in groups}
    kinds = {(kind, degree) for kind, degree, _ in once.values()}
    mesh.facets[f"{name}_section"] = [
        Elements(kind, degree, np.array([nodes for k, g, nodes in once.values() if (k, g) == (kind, degree)]))
        for kind, degree in sorted(kinds)
    ]
    return mesh


def jittered(mesh, counts, rng, amount):
    """Points of a block on [0, 1]^d moved where they are inside, by a part of the distance of the lattice's."""
    x = mesh.points
    inside = ((x > 1e-9) & (x < 1.0 - 1e-9)).all(axis=1)
    if all(e.degree == 1 for groups in mesh.bodies.values() for e in groups):
        x[inside] += rng.uniform(-amount, amount, (inside.sum(), x.shape[1])) / np.array(counts)
        return mesh
    # curved cells: a smooth map, 0 on the boundary
    bump = np.prod(np.sin(np.pi * x), axis=1)
    for axis in range(x.shape[1]):
        x[:, axis] += 0.5 * amount / max(counts) * bump * np.cos(3.0 * x[:, (axis + 1) % x.shape[1]] + axis)
    return mesh


def joined(meshes):
    """Several meshes as one; nothing is shared."""
    first, out = 0, Mesh(np.vstack([m.points for m in meshes]))
    for m in meshes:
        for mine, other in ((out.bodies, m.bodies), (out.facets, m.facets)):
            for name, groups in other.items():
                moved = [Elements(e.cell, e.degree, e.nodes + first) for e in groups]
                mine.setdefault(name, []).extend(moved)
        for name, nodes in m.vertices.items():
            out.vertices[name] = nodes + first
        first += len(m.points)
    return out


def renumbered(mesh, rng):
    """Other numbers of points, cells and facets, other first vertices; returns the new number of every point, too."""
    number = rng.permutation(len(mesh.points))
    points = np.empty_like(mesh.points)
    points[number] = mesh.points
    out = mesh.copy(points)
    for groups in (out.bodies, out.facets):
        for name in list(groups):
            for e in groups[name]:
                same = symmetries(e.cell, e.degree)
                if groups is out.facets:
                    same = same + symmetries(e.cell, e.degree, turned=True)
                which = rng.integers(len(same), size=len(e.nodes))
                rows = np.array([row[same[k]] for row, k in zip(e.nodes, which, strict=True)])
                e.nodes = number[rng.permutation(rows)]
            groups[name] = groups[name][::-1]
    for groups in (out.bodies, out.facets):
        names = rng.permutation(list(groups))
        copy = {str(name): groups[str(name)] for name in names}
        groups.clear()
        groups.update(copy)
    out.vertices = {name: number[nodes] for name, nodes in out.vertices.items()}
    return out, number


def turned(mesh):
    """Cells whose vertices go the other way around, for points that have been mirrored."""
    out = mesh.copy()
    for groups in out.bodies.values():
        for e in groups:
            e.nodes = e.nodes[:, symmetries(e.cell, e.degree, turned=True)[0]]
    return out


# -- gmsh's format ------------------------------------------------------------------------------------------


def _gmsh_order(cell, degree):
    """Where gmsh's nodes are in VTK's order; None: the same."""
    if degree == 1 or cell not in ("tetrahedron", "hexahedron"):
        return None
    first = len(VERTICES[cell])
    places = {frozenset(group): first + k for k, group in enumerate(MIDDLES[cell])}
    groups = _GMSH_TET if cell == "tetrahedron" else [*_GMSH_EDGES, *_GMSH_FACES, range(8)]
    return [*range(first), *[places[frozenset(group)] for group in groups]]


def groups_of(mesh):
    """(dimension, name, elements) of all groups; vertices as tables of one column."""
    rows = [(mesh.dim, name, groups) for name, groups in mesh.bodies.items()]
    rows += [(mesh.dim - 1, name, groups) for name, groups in mesh.facets.items()]
    return rows + [(0, name, [Elements("vertex", 1, nodes[:, None])]) for name, nodes in mesh.vertices.items()]


def msh_text(mesh):
    """The mesh in gmsh's format, version 2.2, text. Points are numbered from 1 on."""
    rows = groups_of(mesh)
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(rows))]
    lines += [f'{dim} {k + 1} "{name}"' for k, (dim, name, _) in enumerate(rows)]
    lines += ["$EndPhysicalNames", "$Nodes", str(len(mesh.points))]
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.dim] = mesh.points
    lines += [f"{k + 1} {x!r} {y!r} {z!r}" for k, (x, y, z) in enumerate(points.tolist())]
    elements = []
    for k, (_, _, groups) in enumerate(rows):
        for e in groups:
            kind = 15 if e.cell == "vertex" else GMSH[e.cell][e.degree - 1]
            order = None if e.cell == "vertex" else _gmsh_order(e.cell, e.degree)
            for nodes in e.nodes if order is None else e.nodes[:, order]:
                elements.append(f"{kind} 2 {k + 1} {k + 1} {' '.join(str(n + 1) for n in nodes)}")
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    lines += [f"{k + 1} {text}" for k, text in enumerate(elements)]
    return "\n".join([*lines, "$EndElements", ""])


def read_msh(text):
    """The mesh that :func:`msh_text` has written."""
    parts = dict(re.findall(r"^\$(\w+)\n(.*?)\n\$End\1$", text, re.M | re.S))
    rows = [line.split(maxsplit=2) for line in parts["PhysicalNames"].splitlines()[1:]]
    names = {int(number): (int(dim), name.strip('"')) for dim, number, name in rows}
    dim = max(d for d, _ in names.values())
    points = np.array([line.split()[1 : 1 + dim] for line in parts["Nodes"].splitlines()[1:]], dtype=float)
    kinds = {number: (cell, k + 1) for cell, pair in GMSH.items() for k, number in enumerate(pair)}
    found, mesh = {}, Mesh(points)
    for line in parts["Elements"].splitlines()[1:]:
        _, kind, _, group, _, *nodes = map(int, line.split())
        found.setdefault((group, kind), []).append(np.array(nodes) - 1)
    for (group, kind), nodes in found.items():
        d, name = names[group]
        if d == 0:
            mesh.vertices[name] = np.concatenate(nodes)
            continue
        cell, degree = kinds[kind]
        order = _gmsh_order(cell, degree)
        table = np.array(nodes)
        if order is not None:
            table = table[:, np.argsort(order)]
        (mesh.bodies if d == dim else mesh.facets).setdefault(name, []).append(Elements(cell, degree, table))
    return mesh
