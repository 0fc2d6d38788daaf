"""What a scene models, and what it leaves out."""

import dataclasses

from pcontact.scene.describe import describe
from pcontact.scene.reader import read_scene
from tests.support.scenes import PLAIN


def described(lines, *words):
    """Whether one line has all the words."""
    return sum(all(word in line for word in words) for line in lines) == 1


def test_describe_full(full):
    active, left_out = describe(full, 3)
    assert described(active, "elasticity", "block, ball")
    assert described(active, "plasticity", "block", "isotropic")
    assert described(active, "pressure", "block_top") and described(active, "body force", "ball")
    assert described(active, "ball_skin", "block_top", "Coulomb", "0.3", "nitsche", "theta 0", "gamma0 10")
    assert described(active, "block_left", "moving", "sphere", "Tresca", "5")
    assert left_out == [
        "self contact", "contact of all surfaces", "tied surfaces", "unbiased contact", "finite strain", "inertia",
    ]  # fmt: skip


def test_describe_plain(write):
    scene = read_scene(write(PLAIN))
    active, left_out = describe(scene, 2)
    assert "elasticity" in active[0] and "block" in active[0] and active[1] == "plane strain"
    assert "frictionless" in active[2] and "gamma0" in active[2] and len(active) == 3
    assert {"friction", "plasticity", "rigid obstacles"} <= set(left_out)
    assert describe(dataclasses.replace(scene, contacts=[]))[1][0] == "contact"
    scene.mesh.geometry = "parts/block.step"
    assert described(describe(scene, 2)[0], "nodes on the geometry block.step")
