"""Checks of a scene against the mesh: the dimension, and the groups it names."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pcontact.runtime.errors import InputError, input_error, listed, unknown_name
from pcontact.scene.expressions import NORMAL, PLACES, Condition
from pcontact.scene.functions import names
from pcontact.scene.keys import holds, keys
from pcontact.scene.model import (
    Contact,
    Displacement,
    Equation,
    Material,
    MeshSpec,
    Obstacle,
    Scene,
    groups_named,
    place,
    refuse,
    tables,
)
from pcontact.scene.orthotropic import across_plane

# obstacles that are none in the plane; those that have an axis to turn about
SPATIAL, AXES = ("cylinder", "cone", "torus"), ("cylinder", "torus")
# largest cosine between directions that are square to each other
SQUARE = 1e-6
# part of the largest radius by which rounding may put a node on the wrong side of the axis
ROUNDING = 1e-9
_KINDS = {"cells": "a group of cells", "facets": "a group of facets", "nodes": "a group of edges or vertices"}


class Groups(dict):
    """Groups by what they are groups of, and what messages say where there is none of a name."""

    advice = ""


def check_dimension(scene: Scene, dim: int) -> None:
    """Check that the scene fits the dimension of the mesh.

    Parameters
    ----------
    scene : Scene
        A valid scene.
    dim : int
        Space dimension of the mesh, 2 or 3.

    Raises
    ------
    InputError
        A vector has another number of entries, 2D kinematics of a 3D mesh, a cylinder in 2D.
    """
    for where, table in tables(scene):
        check = _CHECKS.get(type(table))
        refuse(scene, where, _of_dimension(scene, table, dim))
        refuse(scene, where, check(table, dim) if check is not None else ())


def _of_dimension(scene, table, dim):
    """Entries and directions that the mesh does not have, or has and are missing."""
    for key, one in keys(type(table)).items():
        value = getattr(table, key)
        if one.per_direction and isinstance(value, tuple) and len(value) != dim:
            yield key, f"{len(value)} entries, {list(value)}", f"{dim} entries, the mesh is {dim}D"
        if one.in_space and holds(one.in_space, table, scene) and (value is None) != (dim == 2):
            yield key, *_one_in_space(value, one, dim)
        if one.per_turn and value != one.default and isinstance(value, tuple) != (dim == 3):
            yield key, f"{value}", f"{one.rule.allowed}; the mesh is {dim}D"
        if one.varies and dim == 2 and "z" in names(value):
            yield key, "z with a 2D mesh", "x, y, t"


def _one_in_space(value, declared, dim):
    """Return what is wrong with a direction that is missing in space, or is there in the plane."""
    found = "nothing" if value is None else f"{list(value)} with a 2D mesh"
    return found, declared.rule.allowed if dim == 3 else "nothing, it is known in the plane"


def _mesh(mesh, dim):
    if mesh.kinematics != "plane_strain" and dim == 3:
        yield "kinematics", f'"{mesh.kinematics}" with a 3D mesh', "no such key, it is for 2D meshes only"


def _material(material, dim):
    if material.orthotropic and dim == 2 and not across_plane(*material.frame):
        found = f"{[list(one) for one in material.frame]} with a 2D mesh"
        yield "axes", found, "one of the three axes across the plane, along z"


def _equation(equation, dim):
    if dim == 2 and any(way == "z" for _, way, _ in equation.terms):
        yield "terms", "direction z with a 2D mesh", "x, y"


def _displacement(item, dim):
    """Components that a turn changes are prescribed."""
    axis = np.abs(item.axis) if item.angle is not None and dim == 3 else np.zeros(3)
    for direction, entry in enumerate(item.value if item.angle is not None else ()):
        along = axis[direction] ** 2 >= (1.0 - ROUNDING) * (axis @ axis) if dim == 3 else False
        if entry == "free" and not along:
            found = f'"free" in direction {direction}, in which the turn moves nodes'
            yield "value", found, 'a number; "free" along an axis in a direction of the mesh only'


def _obstacle(obstacle, dim):
    """The edge of a punch or a wedge in space is square to where it looks; a punch in the plane has a width."""
    if obstacle.shape == "punch" and obstacle.width is None and dim == 2:
        yield "radius", "a round punch with a 2D mesh", "width"
    if obstacle.shape == "wedge" or (obstacle.shape == "punch" and obstacle.width is not None):
        if (obstacle.axis is None) != (dim == 2):
            yield "axis", *_one_in_space(obstacle.axis, keys(Obstacle)["axis"], dim)
        if dim == 3:
            along, across = np.array(obstacle.axis), np.array(obstacle.normal)
            cosine = abs(along @ across) / (np.linalg.norm(along) * np.linalg.norm(across))
            if cosine > SQUARE:
                found = f"{list(obstacle.axis)}, at {np.degrees(np.arccos(min(cosine, 1.0))):.6g} degrees with normal"
                yield "axis", found, "a direction square to normal"
    has = obstacle.turn_axis is not None or (dim == 3 and obstacle.shape in AXES)
    if obstacle.angle is not None and has != (dim == 3):
        yield "turn_axis", *_one_in_space(obstacle.turn_axis, keys(Obstacle)["turn_axis"], dim)
    if obstacle.shape in SPATIAL and dim == 2:
        allowed = '"plane" | "sphere" (a circle) | "punch" | "wedge" | "level_set"'
        yield "shape", f'"{obstacle.shape}" with a 2D mesh', allowed


_CHECKS = {
    MeshSpec: _mesh, Material: _material, Equation: _equation,
    Displacement: _displacement, Obstacle: _obstacle,
}  # fmt: skip


def check_radius(scene: Scene, points: np.ndarray, mesh_path: str | Path) -> None:
    """Check that the mesh of a scene with axial symmetry lies on one side of its axis.

    Parameters
    ----------
    scene : Scene
        A valid scene.
    points : ndarray (n, d)
        Nodes of the cells.
    mesh_path : str or pathlib.Path
        For the message.

    Raises
    ------
    InputError
        A node has x < 0.
    """
    wrong = points[:, 0] < -ROUNDING * np.abs(points[:, 0]).max(initial=0.0)
    if wrong.any():
        found = f'"axisymmetric" with {wrong.sum()} nodes of {mesh_path} at x < 0, down to {points[:, 0].min():g}'
        raise input_error(scene.where, "mesh.kinematics", found, "a mesh in x >= 0: x is the radius, y the axis")


def check_regions(
    scene: Scene,
    cell_groups: Mapping[str, object],
    facet_groups: Mapping[str, object],
    node_groups: Mapping[str, object],
    mesh_path: str | Path,
    box: Sequence[Sequence[float]] | None = None,
) -> None:
    """Check that every group the scene names is in the mesh, is of the right kind and is not empty.

    Parameters
    ----------
    scene : Scene
        A valid scene.
    cell_groups, facet_groups, node_groups : mapping of str to ids
        As in RawMesh: ids (n,) of cells and nodes, for facets the pair (cells (n,), local facets (n,)).
        A plain count n is taken too.
    mesh_path : str or pathlib.Path
        For the messages.
    box : (corner, corner), optional
        Least and largest coordinates of the mesh [length]: messages about groups that are not there have them.

    Raises
    ------
    InputError
        Names the groups there are, and the nearest one.
    """
    groups = Groups({"cells": cell_groups, "facets": facet_groups, "nodes": node_groups})
    if box is not None:
        low, high = ([float(f"{value:.6g}") for value in corner] for corner in box)
        groups.advice = f"; or one of a table [[regions]], by place: the mesh goes from {low} to {high}"
    for where, table in tables(scene):
        for key, name, kind in groups_named(table):
            kinds = tuple(groups) if kind == "any" else (kind,)
            _require(scene, f"{where}.{key}", name, groups, kinds, mesh_path)
        if isinstance(table, Contact) and not table.all and table.target is not None:
            _check_apart(scene, where, table, facet_groups)
    for index, probe in enumerate(scene.output.probes):
        _require(scene, f"output.probes[{index}]", probe, groups, tuple(groups), mesh_path)


def check_region(
    scene: Scene, number: int, dim: int, groups: Mapping[str, Mapping[str, object]], mesh_path: str | Path
) -> None:
    """Check what a region by place names.

    Parameters
    ----------
    scene : Scene
        A valid scene.
    number : int
        Of the region.
    dim : int
        Space dimension of the mesh.
    groups : mapping of str to mapping
        Cells, facets and nodes of the mesh and of the regions before, as in :func:`check_regions`.
    mesh_path : str or pathlib.Path
        For the messages.

    Raises
    ------
    InputError
        The mesh has a group of that name, there is no such body, or no such variable.
    """
    one = scene.regions[number]
    where = place("regions", number, one.name)
    if any(one.name in some for some in groups.values()):
        raise input_error(scene.where, f"{where}.name", f"{one.name!r}, a group that is there already", "another name")
    if one.of is not None:
        _require(scene, f"{where}.of", one.of, groups, ("cells",), mesh_path)
    used = Condition(one.where).names if one.where is not None else set()
    wrong = used & ({"z", "nz"} if dim == 2 else set()) or used & (set() if one.kind == "facets" else set(NORMAL))
    if wrong:
        found = f"{min(wrong)} {'with a 2D mesh' if dim == 2 and wrong & {'z', 'nz'} else f'of {one.kind}'}"
        names = [name for name in PLACES if name not in ({"z", "nz"} if dim == 2 else ())]
        allowed = ", ".join(name for name in names if one.kind == "facets" or name not in NORMAL)
        raise input_error(scene.where, f"{where}.where", found, allowed)


def check_lost(scene: Scene, lost: Mapping[str, str], mesh_path: str | Path) -> None:
    """Refuse a scene that names a group of nodes or facets that belong to no cell.

    Parameters
    ----------
    scene : Scene
        A valid scene.
    lost : mapping of str to str
        Such groups, and what is found and allowed, see `pcontact.mesh.raw.RawMesh`.
    mesh_path : str or pathlib.Path
        For the messages.

    Raises
    ------
    InputError
    """
    named = {name for _, table in tables(scene) for _, name, _ in groups_named(table)} | set(scene.output.probes)
    for name in lost:
        if name in named:
            raise InputError(f'{mesh_path}: group "{name}": {lost[name]}')


def _size(ids):
    if isinstance(ids, int):
        return ids
    return len(ids[0]) if isinstance(ids, tuple) else len(ids)


def _require(scene, key, name, groups, kinds, mesh_path):
    known = {}
    for kind in kinds:
        for group, ids in groups[kind].items():
            known[group] = known.get(group, 0) + _size(ids)
    words, advice = "a group" if len(kinds) == len(groups) else _KINDS[kinds[0]], getattr(groups, "advice", "")
    allowed = f"the name of {words} of {mesh_path}: {listed(group for group, size in known.items() if size)}"
    if name not in known:
        other = next((_KINDS[kind] for kind in groups if name in groups[kind]), None)
        if other is not None:
            raise input_error(scene.where, key, f"{name!r}, {other}", allowed)
        none = "" if known else f": {mesh_path} has none (in gmsh they are physical groups)"
        raise input_error(scene.where, key, unknown_name(name, f"no such group in {mesh_path}", known),
                          f"the name of {words}{none}{advice}" if none else allowed + advice)  # fmt: skip
    if known[name] == 0:
        raise input_error(scene.where, key, f"{name!r}, an empty group", allowed)


def _check_apart(scene, where, contact, facet_groups):
    """Source and target have no facet in common, unless they are the same."""
    source, target = facet_groups[contact.source], facet_groups[contact.target]
    if contact.source == contact.target or isinstance(source, int) or isinstance(target, int):
        return
    _refuse_common(scene, where, contact, int(np.isin(_keys(*source), _keys(*target)).sum()))


def _refuse_common(scene, where, contact, common):
    if common:
        found = f"{contact.target!r}, which has {common} of the facets of {contact.source!r}"
        allowed = f"a surface that shares no facet with {contact.source!r}: the mesh of each body has nodes of its own"
        raise input_error(scene.where, f"{where}.{'surfaces' if contact.surfaces else 'target'}", found, allowed)


def check_apart(scene: Scene, common: Mapping[tuple[str, str], int]) -> None:
    """Check that source and target have no facet in common, where that has been counted.

    Parameters
    ----------
    scene : Scene
        A valid scene.
    common : mapping of (source, target) to int

    Raises
    ------
    InputError
    """
    for where, table in tables(scene):
        if isinstance(table, Contact):
            _refuse_common(scene, where, table, common.get((table.source, table.target), 0))


def _keys(cells, local):
    """A number for every facet of a surface; a cell has fewer than eight."""
    return np.asarray(cells) * 8 + np.asarray(local)
