"""A scene against the mesh."""

import dataclasses

import numpy as np
import pytest

from pcontact.runtime.errors import InputError
from pcontact.scene.model import Body, Material, MeshSpec, Scene
from pcontact.scene.reader import read_scene
from pcontact.scene.regions import check_dimension, check_regions
from tests.support.scenes import FULL, PLAIN

CELLS = {"block": np.arange(4), "ball": np.arange(4, 9), "lonely": np.arange(9, 10)}
FACETS = {
    name: (np.arange(3), np.full(3, local))
    for local, name in enumerate(("ball_skin", "block_top", "block_bottom", "block_left", "block_right", "ball_top"))
} | {"nobody": (np.arange(0), np.arange(0)), "skin_again": (np.arange(9), np.zeros(9, dtype=np.int64))}
NODES = {"tip": np.array([7])}


def built(tmp_path, **keys):
    """A small scene built in Python."""
    (tmp_path / "mesh.msh").write_text("")
    parts = {
        "mesh": MeshSpec(tmp_path / "mesh.msh"),
        "materials": {"rubber": Material(E=1, nu=0.25)},
        "bodies": [Body("block", "rubber")],
    }
    return Scene(**(parts | keys))


def refused(call, *parts):
    """The call raises one line with all the parts."""
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    assert "found" in message and "allowed" in message
    for part in parts:
        assert part in message, f"{part!r} is not in: {message}"
    return message


def changed(text, old, new):
    assert text.count(old) >= 1
    return text.replace(old, new, 1)


def test_dimension(full):
    check_dimension(full, 3)
    refused(
        lambda: check_dimension(full, 2), "contacts[1] (floor).obstacle.point: found 3 entries", "2 entries"
    )


@pytest.mark.parametrize(
    ("more", "dim", "parts"),
    [
        ("[[displacements]]\nregion='a'\nvalue=[1, 2]", 3,
         ("displacements[0] (a).value: found 2 entries", "3 entries")),
        ("[[loads]]\nregion='a'\ntraction=[1, 2]", 3,
         ("loads[0] (a).traction: found 2 entries", "3 entries")),
        ("[[loads]]\nregion='a'\nbody_force=[1, 2, 3]", 2,
         ("loads[0] (a).body_force: found 3", "the mesh is 2D")),
        ("[[contacts]]\nsource='a'\nobstacle={shape='plane',point=[0,0],normal=[0,1],displacement=[0,0,1]}",
         2, ("contacts[1] (a-plane).obstacle.displacement: found 3 entries", "2 entries")),
        ("[[contacts]]\nsource='a'\nobstacle={shape='cylinder',point=[0,0],axis=[0,1],radius=1}", 2,
         ('contacts[1] (a-cylinder).obstacle.shape: found "cylinder" with a 2D mesh', "(a circle)")),
    ],
)  # fmt: skip
def test_dimension_refuses(write, more, dim, parts):
    scene = read_scene(write(PLAIN + more))
    check_dimension(dataclasses.replace(scene, displacements=[], loads=[], contacts=[]), dim)
    refused(lambda: check_dimension(scene, dim), "scene.toml: ", *parts)


@pytest.mark.parametrize("kinematics", ["plane_stress", "axisymmetric"])
def test_kinematics_need_two_dimensions(write, kinematics):
    scene = read_scene(write(changed(PLAIN, 'block.msh"', f'block.msh"\nkinematics = "{kinematics}"')))
    check_dimension(scene, 2)
    found = f'mesh.kinematics: found "{kinematics}" with a 3D mesh'
    refused(lambda: check_dimension(scene, 3), found, "2D meshes only")


def test_regions(full):
    check_regions(full, CELLS, FACETS, NODES, "a.msh")
    counts = {name: len(ids[0]) for name, ids in FACETS.items()}
    check_regions(full, {name: len(ids) for name, ids in CELLS.items()}, counts, {"tip": 1}, "a.msh")


@pytest.mark.parametrize(
    ("old", "new", "key", "found", "allowed"),
    [
        ('n = "ball"', 'n = "bal"', "bodies[1] (bal).region", "the nearest is 'ball'",
         "cells of a.msh: ball, block"),
        ('n = "ball"', 'n = "ball_top"', "bodies[1] (ball_top).region", "a group of facets",
         "a group of cells"),
        ('"ball_skin"', '"ball_skn"', "contacts[0] (ball-block).source", "the nearest is 'ball_skin'",
         "block_top"),
        ('"ball_skin"', '"ball"', "contacts[0] (ball-block).source", "'ball', a group of cells", "ball_skin"),
        ('"ball_skin"', '"tip"', "contacts[0] (ball-block).source", "a group of edges or vertices",
         "ball_skin"),
        ('"block_top"\nfric', '"skin_again"\nfric', "contacts[0] (ball-block).target",
         "'skin_again', which has 3 of the facets of 'ball_skin'", "shares no facet with 'ball_skin'"),
        ('"ball_skin"', '"nobody"', "contacts[0] (ball-block).source", "an empty group", "ball_skin"),
        ('"block_top"', '"nobody"', "contacts[0] (ball-block).target", "an empty group", "ball_skin"),
        ('"block_top"\nfric', '"blocktop"\nfric', "contacts[0] (ball-block).target", "'block_top'",
         "a group of facets"),
        ('source = "ball_skin"\ntarget = "block_top"', 'surfaces = ["ball_skn", "block_top"]',
         "contacts[0] (ball-block).surfaces", "the nearest is 'ball_skin'", "block_top"),
        ('n = "ball_top"', 'n = "bell"', "displacements[0] (bell).region", "the nearest is 'ball'",
         "a group of a.msh"),
        ('"block_top"\npre', '"block"\npre', "loads[0] (block).region", "a group of cells",
         "a group of facets"),
        ('"block_left"\ntra', '"left"\ntra', "loads[1] (left).region", "'block_left'", "a group of facets"),
        ('"ball"\nbody_f', '"ball_top"\nbody_f', "loads[2] (ball_top).region", "a group of facets",
         "a group of cells"),
        ('"tip"]', '"tap"]', "output.probes[1]", "the nearest is 'tip'", "ball_top"),
    ],
)  # fmt: skip
def test_regions_refuses(write, old, new, key, found, allowed):
    scene = read_scene(write(changed(FULL, old, new)))
    message = refused(lambda: check_regions(scene, CELLS, FACETS, NODES, "a.msh"), "scene.toml: ")
    _, _, rest = message.partition(": ")
    assert rest.startswith(f"{key}: found ")
    assert found in rest.partition("; allowed: ")[0] and allowed in rest.partition("; allowed: ")[2]


def test_regions_of_a_mesh_without_groups(full):
    refused(lambda: check_regions(full, {}, {}, {}, "a.msh"), "bodies[0] (block).region", "a.msh has none (in gmsh")
