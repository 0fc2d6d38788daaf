"""A second reader of scenes and meshes, which shares nothing with the program's, and what it expects of a report.

It reads less than the program does. What it reads, it writes anew in the plainest form; that must give the same
numbers as the file as it was. From the mesh and the scene alone it counts cells and unknowns, and knows where
supports move and what pushes the bodies.
"""

import struct
import tomllib

import numpy as np
from grids import FACETS, GMSH, MIDDLES, VERTICES, Elements, Mesh, facet_nodes

KIND = {number: (cell, degree) for cell, row in GMSH.items() for degree, number in enumerate(row, 1)}
DIMENSION = {"segment": 1, "triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3, "vertex": 0}
NAMES = ("point", "curve", "surface", "volume")

# rounding errors of sums of some hundred terms
ROUNDING = 1e-13


class Unread(Exception):
    """The file is not of the plain kind that this reader knows."""


# -- meshes ------------------------------------------------------------------------------------------------


def sections(data):
    """Names and contents of the sections of a .msh file."""
    out, at = {}, 0
    while True:
        start = data.find(b"$", at)
        if start < 0:
            return out
        end = data.find(b"\n", start)
        name = data[start + 1 : end].strip()
        stop = data.find(b"$End" + name, end)
        if end < 0 or stop < 0 or not name:
            raise Unread(f"section {name!r}")
        out.setdefault(name.decode("latin-1"), data[end + 1 : stop])
        at = stop + 4 + len(name)


def read_msh(data):
    """Points by tag, elements as (dimension, group, type, nodes), names of groups; of versions 2.2 and 4.1.

    Raises
    ------
    Unread
    """
    try:
        parts = sections(data)
        version, binary, _ = parts["MeshFormat"].split(None, 3)[:3]
        names = _names(parts.get("PhysicalNames", b""))
        if version == b"2.2":
            points, elements = (_read2_binary if binary == b"1" else _read2)(parts)
        elif version == b"4.1":
            points, elements = (_read4_binary if binary == b"1" else _read4)(parts)
        else:
            raise Unread(f"version {version!r}")
    except (KeyError, ValueError, IndexError, struct.error, OverflowError, MemoryError) as error:
        raise Unread(f"{type(error).__name__}: {error}") from None
    return points, elements, names


def _names(text):
    names = {}
    for line in text.decode("utf-8", "replace").splitlines()[1:]:
        dim, tag, name = line.strip().split(None, 2)
        names[int(dim), int(tag)] = name.strip().strip('"')
    return names


def _read2(parts):
    lines = parts["Nodes"].splitlines()
    points = {}
    for line in lines[1 : 1 + int(lines[0])]:
        tag, *x = line.split()
        points[int(tag)] = [float(c) for c in x]
    lines, elements = parts["Elements"].splitlines(), []
    for line in lines[1 : 1 + int(lines[0])]:
        row = [int(word) for word in line.split()]
        group = row[3] if row[2] else 0
        elements.append((group, row[1], row[3 + row[2] :]))
    return points, elements


def _read2_binary(parts):
    data = parts["Nodes"]
    head, _, data = data.partition(b"\n")
    points = {}
    for k in range(int(head)):
        tag, *x = struct.unpack_from("<i3d", data, 28 * k)
        points[tag] = x
    head, _, data = parts["Elements"].partition(b"\n")
    elements, at, count = [], 0, 0
    while count < int(head):
        kind, n, tags = struct.unpack_from("<3i", data, at)
        at, nodes = at + 12, _size(kind)
        for _ in range(n):
            row = struct.unpack_from(f"<{1 + tags + nodes}i", data, at)
            at += 4 * len(row)
            elements.append((row[1] if tags else 0, kind, list(row[1 + tags :])))
        count += n
    return points, elements


def _size(kind):
    if kind == 15:
        return 1
    cell, degree = KIND[kind]
    return len(VERTICES[cell]) + (len(MIDDLES[cell]) if degree == 2 else 0)


def _read4(parts):
    words = parts["Entities"].split()
    counts, at, physical = [int(w) for w in words[:4]], 4, {}
    for dim, count in enumerate(counts):
        for _ in range(count):
            tag = int(words[at])
            at += 4 if dim == 0 else 7
            n = int(words[at])
            physical[dim, tag] = [abs(int(w)) for w in words[at + 1 : at + 1 + n]]
            at += 1 + n
            if dim:
                at += 1 + int(words[at])
    words = iter(parts["Nodes"].split())
    blocks, points = [int(next(words)) for _ in range(4)][0], {}
    for _ in range(blocks):
        _, _, parametric, n = (int(next(words)) for _ in range(4))
        if parametric:
            raise Unread("parametric nodes")
        tags = [int(next(words)) for _ in range(n)]
        for tag in tags:
            points[tag] = [float(next(words)) for _ in range(3)]
    words = iter(parts["Elements"].split())
    blocks, elements = [int(next(words)) for _ in range(4)][0], []
    for _ in range(blocks):
        dim, entity, kind, n = (int(next(words)) for _ in range(4))
        for _ in range(n):
            next(words)
            nodes = [int(next(words)) for _ in range(_size(kind))]
            elements += [(group, kind, nodes) for group in physical.get((dim, entity)) or [0]]
    return points, elements


def _read4_binary(parts):
    data, at, physical = parts["Entities"], 32, {}
    for dim, count in enumerate(struct.unpack_from("<4Q", data)):
        for _ in range(count):
            tag = struct.unpack_from("<i", data, at)[0]
            at += 4 + (24 if dim == 0 else 48)
            for k in range(1 if dim == 0 else 2):
                n = struct.unpack_from("<Q", data, at)[0]
                if k == 0:
                    physical[dim, tag] = [abs(p) for p in struct.unpack_from(f"<{n}i", data, at + 8)]
                at += 8 + 4 * n
    data, at, points = parts["Nodes"], 32, {}
    for _ in range(struct.unpack_from("<Q", data)[0]):
        _, _, parametric, n = struct.unpack_from("<3iQ", data, at)
        if parametric:
            raise Unread("parametric nodes")
        tags = struct.unpack_from(f"<{n}Q", data, at + 20)
        x = struct.unpack_from(f"<{3 * n}d", data, at + 20 + 8 * n)
        points.update({tag: list(x[3 * k : 3 * k + 3]) for k, tag in enumerate(tags)})
        at += 20 + 32 * n
    data, at, elements = parts["Elements"], 32, []
    for _ in range(struct.unpack_from("<Q", data)[0]):
        dim, entity, kind, n = struct.unpack_from("<3iQ", data, at)
        width = 1 + _size(kind)
        rows = np.frombuffer(data, "<u8", n * width, at + 20).reshape(n, width)
        at += 20 + 8 * n * width
        for group in physical.get((dim, entity)) or [0]:
            elements += [(group, kind, row[1:].tolist()) for row in rows]
    return points, elements


def mesh_of(data):
    """The Mesh of a .msh file, without what belongs to no group.

    Raises
    ------
    Unread
    """
    points, elements, names = read_msh(data)
    try:
        dim = max(DIMENSION[KIND[kind][0]] for _, kind, _ in elements if kind != 15)
    except (KeyError, ValueError) as error:
        raise Unread(f"element type {error}") from None
    order = sorted(points)
    number = {tag: k for k, tag in enumerate(order)}
    out = Mesh(np.array([points[tag][:dim] for tag in order]))
    rows = {}
    for group, kind, nodes in elements:
        cell, degree = ("vertex", 1) if kind == 15 else KIND[kind]
        d = DIMENSION[cell]
        name = names.get((d, group)) or f"{NAMES[d]}_{group}"
        if any(node not in number for node in nodes):
            raise Unread("a node that is not there")
        rows.setdefault((d, name, cell, degree), []).append([number[node] for node in nodes])
    for (d, name, cell, degree), nodes in rows.items():
        if len({len(row) for row in nodes}) != 1:
            raise Unread("nodes of an element")
        nodes = np.array(nodes)
        if d == 0:
            out.vertices[name] = np.unique(nodes[:, 0])
            continue
        if degree == 2:
            raise Unread("degree 2")
        if d in (dim, dim - 1):
            groups = out.bodies if d == dim else out.facets
            groups.setdefault(name, []).append(Elements(cell, degree, nodes))
    return out


# -- scenes ------------------------------------------------------------------------------------------------


def read_toml(data):
    """The scene as a dict.

    Raises
    ------
    Unread
    """
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise Unread(str(error)) from None


def factor(table, end, time):
    """An amplitude at a time; a ramp over the run without one."""
    rows = table.get("amplitude")
    if rows is None:
        return time / end
    return float(np.interp(time, [row[0] for row in rows], [row[1] for row in rows]))


# -- what a report has to say ------------------------------------------------------------------------------


def count(scene, mesh):
    """Cells and unknowns, counted from the mesh of degree 1 alone."""
    regions = [body["region"] for body in scene["bodies"]]
    blocks = [e for region in regions for e in mesh.bodies[region]]
    nodes = {int(n) for e in blocks for n in e.nodes.ravel()}
    total = len(nodes)
    if scene["mesh"].get("order", 1) == 2:
        groups = [(e, list(group)) for e in blocks for group in MIDDLES[e.cell]]
        total += len({frozenset(row[group].tolist()) for e, group in groups for row in e.nodes})
    return {"cells": sum(len(e.nodes) for e in blocks), "dofs": total * mesh.dim}


def _triangles(e):
    """Facets as segments or triangles with flat corners (m, d)."""
    if e.cell != "quadrilateral":
        return [row for row in e.nodes]
    return [row[list(corners)] for row in e.nodes for corners in ((0, 1, 2), (0, 2, 3))]


def area_vectors(mesh, name):
    """Sum of the outward area vectors, and the area, of a group of flat facets."""
    inside = {}
    for groups in mesh.bodies.values():
        for e in groups:
            for local in facet_nodes(e.cell, 1)[1]:
                for row in e.nodes:
                    inside[frozenset(row[local].tolist())] = mesh.points[row].mean(axis=0)
    total, area = np.zeros(mesh.dim), 0.0
    for e in mesh.facets[name]:
        assert e.cell in {kind for kind, _ in FACETS.values()}
        for whole in e.nodes:
            centre = inside[frozenset(whole.tolist())]
            for row in _triangles(Elements(e.cell, 1, whole[None])):
                x = mesh.points[row]
                if mesh.dim == 2:
                    normal = np.array([x[1, 1] - x[0, 1], x[0, 0] - x[1, 0]])
                else:
                    normal = 0.5 * np.cross(x[1] - x[0], x[2] - x[0])
                normal *= np.sign(normal @ (x.mean(axis=0) - centre)) or 1.0
                total, area = total + normal, area + np.linalg.norm(normal)
    return total, area


def volume(mesh, name):
    """Volume of a group of cells."""
    total = 0.0
    for e in mesh.bodies[name]:
        for row in e.nodes:
            x = mesh.points[row]
            total += abs(_volume(e.cell, x))
    return total


def _volume(cell, x):
    if cell in ("triangle", "tetrahedron"):
        return np.linalg.det(x[1:] - x[0]) / (2.0 if cell == "triangle" else 6.0)
    if cell == "quadrilateral":
        a, b = x[2] - x[0], x[3] - x[1]
        return 0.5 * (a[0] * b[1] - a[1] * b[0])
    g, total = 0.5 - 0.5 / np.sqrt(3.0), 0.0
    for p in np.array(np.meshgrid([g, 1 - g], [g, 1 - g], [g, 1 - g])).reshape(3, -1).T:
        rows = []
        for k in range(3):
            step = 1e-3 * np.eye(3)[k]
            # exact: the map is linear in each coordinate
            rows.append((_at(x, p + step) - _at(x, p - step)) / 2e-3)
        total += np.linalg.det(np.array(rows)) / 8.0
    return total


def _at(x, p):
    weights = [np.prod(np.where(corner, p, 1.0 - p)) for corner in np.array(VERTICES["hexahedron"])]
    return np.array(weights) @ x


def pushed(scene, mesh, time):
    """Sum of all loads at a time."""
    total, end = np.zeros(mesh.dim), scene.get("steps", {}).get("end", 1.0)
    for load in scene.get("loads", []):
        if "body_force" in load:
            force = np.array(load["body_force"]) * volume(mesh, load["region"])
        else:
            normal, area = area_vectors(mesh, load["region"])
            force = -load["pressure"] * normal if "pressure" in load else area * np.array(load["traction"])
        total = total + factor(load, end, time) * force
    return total


def lost(scene, mesh):
    """Forces that may be lost in the rounding errors of the stresses of the stiffest body."""
    strained = np.ptp(mesh.points, axis=0).max() ** (mesh.dim - 2) * max(m["E"] for m in scene["materials"].values())
    moved = [abs(v) for table in scene.get("displacements", []) for v in table["value"] if v != "free"]
    return ROUNDING * strained * max(moved, default=0.0)


def complaints(scene, mesh, report):
    """What in a report contradicts the scene and the mesh; empty if nothing does."""
    out = []
    for key, value in count(scene, mesh).items():
        if report[key] != value:
            out.append(f"{key}: {report[key]} in the report, {value} in the mesh")
    end = scene.get("steps", {}).get("end", 1.0)
    rigid = {c.get("name") for c in scene.get("contacts", []) if "obstacle" in c}
    unnamed = any("obstacle" in c and "name" not in c for c in scene.get("contacts", []))
    largest, floor = 0.0, lost(scene, mesh)
    for step in report["steps"]:
        forces = [np.array(f, dtype=float) for f in step["reactions"].values()]
        forces += [-np.array(c["force"], dtype=float) for name, c in step["contacts"].items() if name in rigid]
        forces.append(pushed(scene, mesh, step["time"]))
        largest = max([largest, *[float(np.abs(f).max()) for f in forces]])
        rest = float(np.abs(sum(forces)).max())
        if not unnamed and rest > 1e-5 * largest + floor:
            out.append(f"time {step['time']:g}: forces out of balance by {rest:g} of {largest:g}")
        for table in scene.get("displacements", []):
            probe = step["probes"].get(table["region"])
            for k, value in enumerate(table["value"]):
                if probe is None or value == "free":
                    continue
                wanted = factor(table, end, step["time"]) * value
                for which in ("min", "max"):
                    if abs(probe[which][k] - wanted) > 1e-9 * max(abs(wanted), abs(value)):
                        out.append(f"{table['region']} is at {probe[which][k]:g} and should be at {wanted:g}")
    return out


