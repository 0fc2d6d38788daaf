"""Contacts of a scene that are refused once their surfaces are there."""

from functools import partial

import pytest

from meshes import c_strip, one_block, thick_cylinder, two_blocks
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD


def built(path, body, group, held, **contact):
    scene = Scene(
        MeshSpec(path), {"m": Material(1.0, 0.3)}, [Body(body, "m")], [Contact(group, group, **contact)],
        [Displacement(held, [0.0, 0.0])], output=Output(fields=False),
    )  # fmt: skip
    Simulation(scene).free()


@pytest.mark.parallel
def test_a_surface_that_cannot_meet_itself(shared_tmp):
    """Flat, or round and looking outwards; a hole and a slot can, and where the user says so."""
    block, ring, strip = (shared_tmp / name for name in ("block.msh", "ring.msh", "strip.msh"))
    on_root(WORLD, partial(one_block, block, 2, 4))
    on_root(WORLD, partial(thick_cylinder, ring, n=(2, 24)))
    on_root(WORLD, partial(c_strip, strip, (2, 8), gap=2.0))
    for refused in ((block, "block", "top", "bottom"), (ring, "body", "outer", "inner")):
        with pytest.raises(InputError, match="the source itself, a surface that is flat.*self_contact = true"):
            built(*refused)
        built(*refused, self_contact=True)
    built(ring, "body", "inner", "outer")
    built(strip, "strip", "skin", "back")


@pytest.mark.parametrize(("said", "bound"), [
    ({}, 0.25), ({"traction": "source"}, 0.25), ({"unbiased": True}, 0.25),
    ({"unbiased": True, "traction": "source"}, 0.125), ({"pressure_overclosure": 1.0}, 0.0),
    ({"unbiased": True, "traction": "source", "pressure_overclosure": 1.0}, 0.0),
])  # fmt: skip
def test_bound_of_gamma0(shared_tmp, said, bound):
    """Half where both sides take their own stress alone; none where the pressure is said by the closure."""
    path = shared_tmp / "blocks.msh"
    on_root(WORLD, partial(two_blocks, path, 2, 2))
    for gamma0 in (0.99 * bound, 1.01 * bound + 1e-3):
        scene = Scene(
            MeshSpec(path), {"m": Material(1.0, 0.3)}, [Body("lower", "m"), Body("upper", "m")],
            [Contact("upper_bottom", "lower_top", gamma0=max(gamma0, 1e-3), theta=0.0, **said)],
            [Displacement("lower_bottom", [0.0, 0.0])], output=Output(fields=False),
        )  # fmt: skip
        if gamma0 < bound:
            with pytest.raises(InputError, match=f"gamma0: found .*>= {bound:g}"):
                Simulation(scene)
        else:
            Simulation(scene).free()
