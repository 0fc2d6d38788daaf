"""Checks of a scene against the mesh: the dimension, and the groups it names."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pcontact.runtime.errors import InputError
from pcontact.runtime.messages import input_error, listed, unknown_name
from pcontact.scene.expression import NORMAL, PLACES, Condition
from pcontact.scene.keys import keys
from pcontact.scene.model import (
    Contact,
    Coupling,
    Displacement,
    Equation,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Periodic,
    Scene,
    Spring,
    Temperature,
)
from pcontact.scene.orthotropic import across_plane
from pcontact.scene.places import groups_named, place, tables
from pcontact.scene.prescribed import names

# obstacles that are none in the plane; those that have an axis to turn about
SPATIAL, AXES = ("cylinder", "cone", "torus"), ("cylinder", "torus")
# largest cosine between directions that are square to each other
SQUARE = 1e-6
# part of the largest radius by which rounding may put a node on the wrong side of the axis
ROUNDING = 1e-9
_EXPRESSIONS = {
    Displacement: ("value",),
    Load: ("pressure", "traction", "body_force", "acceleration"),
    Temperature: ("value",),
    Obstacle: ("expression",),
    Contact: ("friction", "kinetic_friction"),
}
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
        for key in (key for key, one in keys(type(table)).items() if one.per_direction):
            vector = getattr(table, key)
            if vector is not None and len(vector) != dim:
                found = f"{len(vector)} entries, {list(vector)}"
                raise input_error(scene.where, f"{where}.{key}", found, f"{dim} entries, the mesh is {dim}D")
        if isinstance(table, MeshSpec) and table.kinematics != "plane_strain" and dim == 3:
            found = f'"{table.kinematics}" with a 3D mesh'
            raise input_error(scene.where, "mesh.kinematics", found, "no such key, it is for 2D meshes only")
        if isinstance(table, Material) and table.orthotropic:
            _check_frame(scene, where, table, dim)
        if isinstance(table, Spring) and isinstance(table.per_area, tuple) and len(table.per_area) != dim:
            found = f"{len(table.per_area)} entries, {list(table.per_area)}"
            raise input_error(scene.where, f"{where}.per_area", found, f"a number, or {dim} entries: it is {dim}D")
        if isinstance(table, Load) and table.moment is not None and isinstance(table.moment, tuple) != (dim == 3):
            allowed = "a list of 3 numbers, the mesh is 3D" if dim == 3 else "a number, the mesh is 2D"
            raise input_error(scene.where, f"{where}.moment", f"{table.moment}", allowed)
        if isinstance(table, Load) and table.angular_speed is not None and (table.axis is None) != (dim == 2):
            found = "nothing" if table.axis is None else f"{list(table.axis)} with a 2D mesh"
            allowed = keys(Load)["axis"].rule.allowed if dim == 3 else "nothing, the axis is known"
            raise input_error(scene.where, f"{where}.axis", found, allowed)
        if isinstance(table, Coupling) and table.inertia and isinstance(table.inertia, tuple) != (dim == 3):
            allowed = "a number >= 0" if dim == 2 else "a list of 3 numbers >= 0"
            raise input_error(scene.where, f"{where}.inertia", f"{table.inertia}", allowed)
        turns = isinstance(table, Coupling) and table.rotation is not None
        if turns and isinstance(table.rotation, tuple) != (dim == 3):
            allowed = "a list of 3, the mesh is 3D" if dim == 3 else 'a number or "free", the mesh is 2D'
            raise input_error(scene.where, f"{where}.rotation", f"{table.rotation}", allowed)
        if isinstance(table, Equation) and dim == 2 and any(way == "z" for _, way, _ in table.terms):
            raise input_error(scene.where, f"{where}.terms", "direction z with a 2D mesh", "x, y")
        if isinstance(table, Periodic) and table.angle is not None:
            _check_axis(scene, f"{where}.axis", table, table.axis, (table.axis is None) == (dim == 2))
        if isinstance(table, Displacement) and table.angle is not None:
            _check_turn(scene, where, table, dim)
        for key in _EXPRESSIONS.get(type(table), ()) if dim == 2 else ():
            if "z" in names(getattr(table, key)):
                raise input_error(scene.where, f"{where}.{key}", "z with a 2D mesh", "x, y, t")
        if isinstance(table, Obstacle):
            _check_edge(scene, where, table, dim)
        if isinstance(table, Obstacle) and table.angle is not None:
            has = table.turn_axis is not None or (dim == 3 and table.shape in AXES)
            _check_axis(scene, f"{where}.turn_axis", table, table.turn_axis, has == (dim == 3))
        if isinstance(table, Obstacle) and table.shape in SPATIAL and dim == 2:
            allowed = '"plane" | "sphere" (a circle) | "punch" | "wedge" | "level_set"'
            raise input_error(scene.where, f"{where}.shape", f'"{table.shape}" with a 2D mesh', allowed)


def _check_frame(scene, where, material, dim):
    """An axis in space, and none in the plane, across which one of the axes of the material is."""
    if material.point is not None and (material.axis is None) != (dim == 2):
        found = "nothing" if material.axis is None else f"{list(material.axis)} with a 2D mesh"
        allowed = keys(Material)["axis"].rule.allowed if dim == 3 else "nothing, it is across the plane"
        raise input_error(scene.where, f"{where}.axis", found, allowed)
    if dim == 2 and not across_plane(*material.frame):
        found = f"{[list(one) for one in material.frame]} with a 2D mesh"
        raise input_error(scene.where, f"{where}.axes", found, "one of the three axes across the plane, along z")


def _check_edge(scene, where, obstacle, dim):
    """The edge of a punch or a wedge in space, square to where it looks; a punch in the plane has a width."""
    if obstacle.shape == "punch" and obstacle.width is None and dim == 2:
        raise input_error(scene.where, f"{where}.radius", "a round punch with a 2D mesh", "width")
    if obstacle.shape != "wedge" and (obstacle.shape != "punch" or obstacle.width is None):
        return
    if (obstacle.axis is None) != (dim == 2):
        found = "nothing" if obstacle.axis is None else f"{list(obstacle.axis)} with a 2D mesh"
        allowed = keys(Obstacle)["axis"].rule.allowed if dim == 3 else "nothing, the edge is a point"
        raise input_error(scene.where, f"{where}.axis", found, allowed)
    if dim == 3:
        along, across = np.array(obstacle.axis), np.array(obstacle.normal)
        cosine = abs(along @ across) / (np.linalg.norm(along) * np.linalg.norm(across))
        if cosine > SQUARE:
            found = f"{list(obstacle.axis)}, at {np.degrees(np.arccos(min(cosine, 1.0))):.6g} degrees with normal"
            raise input_error(scene.where, f"{where}.axis", found, "a direction square to normal")


def _check_axis(scene, where, table, axis, fits):
    """An axis in space and none in the plane."""
    if not fits:
        found = "nothing" if axis is None else f"{list(axis)} with a 2D mesh"
        allowed = keys(type(table))["axis"].rule.allowed if axis is None else "nothing, it turns about the point"
        raise input_error(scene.where, where, found, allowed)


def _check_turn(scene, where, displacement, dim):
    """An axis in space and none in the plane; components that the turn changes are prescribed."""
    _check_axis(scene, f"{where}.axis", displacement, displacement.axis, (displacement.axis is None) == (dim == 2))
    axis = np.zeros(3) if dim == 2 else np.abs(displacement.axis)
    for direction, entry in enumerate(displacement.value):
        along = axis[direction] ** 2 >= (1.0 - ROUNDING) * (axis @ axis) if dim == 3 else False
        if entry == "free" and not along:
            found = f'"free" in direction {direction}, in which the turn moves nodes'
            allowed = 'a number; "free" along an axis in a direction of the mesh only'
            raise input_error(scene.where, f"{where}.value", found, allowed)


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
        Such groups, and what is found and allowed, see `pcontact.mesh.groups.RawMesh`.
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
        found = unknown_name(name, f"no such group in {mesh_path}{'' if known else ', which has none of these'}", known)
        raise input_error(scene.where, key, found, allowed + advice)
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
        allowed = f"a surface that shares no facet with {contact.source!r}"
        raise input_error(scene.where, f"{where}.target", found, allowed)


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
