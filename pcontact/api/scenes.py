"""Scenes in Python: the tables of a scene file as classes, taken in short forms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from pcontact.api.meshes import mesh_from, own_folder
from pcontact.api.tables import Named, Tables
from pcontact.io.examples import write_template
from pcontact.runtime.errors import InputError
from pcontact.scene import model
from pcontact.scene.model import Body, Material, MeshSpec, Output, Steps
from pcontact.scene.reader import built, read_scene, scene_from

_TABLES, _OPTIONAL = {**model.LIST_TABLES}, {**model.OPTIONAL_TABLES}


class Scene(model.Scene):
    """A scene: what a scene file says, in Python.

    Parameters
    ----------
    mesh : path, MeshSpec, dict, meshio.Mesh, pyvista dataset, PETSc.DMPlex, the module gmsh, or (points, cells)
        See :func:`pcontact.mesh_from`, which also names groups.
    materials : dict of str to Material or dict
        ``{"steel": {"E": 210e3, "nu": 0.3}}``.
    bodies : dict of str to str, or list of Body or dict
        ``{"lower": "steel"}``: material of each group of cells.
    contacts : list of Contact or dict
        ``pc.Contact("skin", "top", friction=0.3)``.
    displacements : dict of str to sequence, or list of Displacement or dict
        ``{"bottom": [0, 0]}``: value on each group.
    steps : int, Steps or dict
        Their number, or the table.
    output : Output or dict
    **tables
        All other tables and keys of a scene file by their names: `loads`, `springs`, `phases`, `petsc`, `title`, ...

    Notes
    -----
    Its attributes are the keys of the file and may be changed; a run checks them, and leaves the scene as it is. Lists
    of tables go by number, and by name or region: ``scene.contacts["press"].friction = 0.3``.
    """

    def __init__(
        self, mesh: Any, materials: Mapping[str, Any], bodies: Any, contacts: Any = (), displacements: Any = (),
        steps: Any = None, output: Any = None, **tables: Any,
    ) -> None:  # fmt: skip
        known = {field.name for field in fields(model.Scene)}
        for name in tables:
            if name not in known:
                raise InputError(f"scene: found the unknown table {name!r}; allowed: {', '.join(sorted(known))}")
        if isinstance(bodies, Mapping):
            bodies = [Body(region, material) for region, material in bodies.items()]
        if isinstance(displacements, Mapping):
            displacements = [{"region": region, "value": value} for region, value in displacements.items()]
        lists = {"bodies": bodies, "contacts": contacts, "displacements": displacements,
                 **{name: tables.pop(name) for name in list(tables) if name in _TABLES}}  # fmt: skip
        steps = Steps(count=steps) if isinstance(steps, int) else steps
        made: dict[str, Any] = {
            name: [_made(_TABLES[name], one) for one in many] for name, many in lists.items()
        }
        super().__init__(
            mesh=MeshSpec(**mesh) if isinstance(mesh, Mapping) else mesh_from(mesh),
            materials={name: _made(Material, one) for name, one in materials.items()},
            steps=Steps() if steps is None else _made(Steps, steps),
            output=Output() if output is None else _made(Output, output),
            **made,
            **{name: _made(_OPTIONAL[name], one) if name in _OPTIONAL else one for name, one in tables.items()},
        )

    @classmethod
    def of(cls, scene: model.Scene) -> Scene:
        """The same scene as one of this class."""
        made = cls.__new__(cls)
        for name, value in scene.__dict__.items():
            setattr(made, name, value)
        return made

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _TABLES and isinstance(value, list):
            value = Tables(value)
        elif name == "materials" and isinstance(value, dict):
            value = Named(value)
        super().__setattr__(name, value)


def _made(kind: type, value: Any) -> Any:
    """A table from a dict."""
    return built(kind, dict(value), "scene", model.HEADERS[kind].strip("[]")) if isinstance(value, Mapping) else value


def scene_of(scene: model.Scene | Mapping[str, Any] | str | Path) -> model.Scene:
    """A scene, or what stands for one: its tables, or a scene file."""
    if isinstance(scene, Mapping):
        return from_dict(scene)
    return scene if isinstance(scene, model.Scene) else read(scene)


def read(path: str | Path, **changes: Any) -> Scene:
    """Read and check a scene file.

    Parameters
    ----------
    path : str or pathlib.Path
        A TOML file.
    **changes
        Keys of the scene with other values: ``steps={"count": 4}``, ``materials={"soft": {"E": 3.0}}``. Tables are
        merged, None takes a key out; in lists of tables a dict names those that change, contacts by ``name``, the
        others by ``region``: ``contacts={"ball-block": {"friction": 0.3}}``.

    Returns
    -------
    Scene
        Its attributes are the keys of the file and may be changed; :func:`run` checks them again.

    Raises
    ------
    InputError
        One line: the file, the key, what was found, what is allowed.
    """
    return Scene.of(read_scene(path, changes))


def new(directory: str | Path | None = None) -> Scene:
    """The small scene that ``pcontact new`` writes, to start from: a block that is pressed on another one and drawn.

    Parameters
    ----------
    directory : str or pathlib.Path, optional
        A new directory for scene and mesh; absent: one of this process's own, that goes when it ends.

    Returns
    -------
    Scene
        As :func:`read`.

    Raises
    ------
    InputError
        The directory is there already.
    """
    return read(write_template(str(own_folder() / "new" if directory is None else directory)))


def from_dict(data: Mapping[str, Any], folder: str | Path | None = None) -> Scene:
    """A scene from a dict with the keys of a scene file, with the same checks.

    Parameters
    ----------
    data : dict
        Dicts for tables, lists for lists of tables; arrays and numbers of numpy and paths are taken as well.
    folder : str or pathlib.Path, optional
        Where the mesh and other files are; absent: the working directory.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
    """
    return Scene.of(scene_from(data, folder))
