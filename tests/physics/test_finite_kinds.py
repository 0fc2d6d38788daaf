"""Every kind of contact with finite strain: as small strain where motions are small, and whole where they are not."""

import numpy as np
import pytest

from drivers._common import running
from meshes.blocks import one_block, two_blocks
from pcontact.runtime.observer import Observer
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps
from tests.support.kinematics import mesh

COULOMB = {"friction": 0.3}
# what the contact says
KINDS = {
    "theta 0": {},
    "theta -1": {"theta": -1.0},
    "theta 1": {"theta": 1.0, "gamma0": 10.0},
    "theta 0, Coulomb": COULOMB,
    "theta -1, Coulomb": {"theta": -1.0, **COULOMB},
    "theta 1, Coulomb": {"theta": 1.0, "gamma0": 10.0, **COULOMB},
    "Tresca": {"tresca": 0.5},
    "adhesion": {"friction": 0.2, "adhesion": 0.1},
    "penalty": {"formulation": "penalty"},
    "penalty, Coulomb": {"formulation": "penalty", **COULOMB},
    "multipliers": {"formulation": "augmented_lagrangian"},
    "multipliers, Coulomb": {"formulation": "augmented_lagrangian", **COULOMB},
    "unbiased": {"unbiased": True},
    "unbiased, Coulomb": {"unbiased": True, **COULOMB},
    "unbiased, penalty": {"unbiased": True, "formulation": "penalty", **COULOMB},
    "tied": {"tied": True},
    "tied, theta -1": {"tied": True, "theta": -1.0},
    "tied, penalty": {"tied": True, "formulation": "penalty"},
    "bilateral": {"bilateral": True},
    "all surfaces": {"all": True},
    "all surfaces, Coulomb": {"all": True, **COULOMB},
    "closest point": {"search": "closest_point", **COULOMB},
    "ray tracing": {"search": "ray_tracing", **COULOMB},
    "plane": {"obstacle": "plane", **COULOMB},
    "ball": {"obstacle": "ball", **COULOMB},
    "ball, multipliers": {"obstacle": "ball", "formulation": "augmented_lagrangian", **COULOMB},
    "ball, theta -1": {"obstacle": "ball", "theta": -1.0},
}
SPACES = {
    "plane": (2, "quadrilateral", "plane_strain"),
    "plane stress": (2, "quadrilateral", "plane_stress"),
    "ring": (2, "quadrilateral", "axisymmetric"),
    "space": (3, "hexahedron", "plane_strain"),
}
MATERIALS = {"elastic": Material(200.0, 0.3), "metal": Material(200.0, 0.3, yield_stress=8.0, hardening=20.0)}


class Steady(Observer):
    """Forces of load steps none of which may be cut."""

    def __init__(self, top):
        self.top, self.forces, self.newton = top, [], []

    def step(self, step, u, record):
        (contact,) = record["contacts"].values()
        self.forces.append([contact["force"], record["reactions"][self.top]])
        self.newton.append(record["newton"])

    def cut(self, target, result):
        raise AssertionError(result.reason)


def obstacle(name, dim, axial, press):
    """What a block of height 1 stands on, which comes up and, but for a plane, is a ball."""
    up, side = np.eye(dim)[-1], np.eye(dim)[0]
    move = (press * (up + 0.3 * side * (not axial))).tolist()
    if name == "plane":
        return Obstacle("plane", point=[0.0] * dim, normal=up.tolist(), displacement=move)
    radius = 0.3 / press
    center = (0.5 * (1.0 - up) * (not axial) - radius * up).tolist()
    return Obstacle("sphere", center=center, radius=radius, displacement=move)


def pressed(folder, space, kind, press, strain, material):
    """Forces on a block that is pressed on another one, or by an obstacle, with two load steps; Newton iterations."""
    dim, cell, kinematics = SPACES[space]
    said, axial = dict(KINDS[kind]), kinematics == "axisymmetric"
    shape = said.pop("obstacle", None)
    shift = [0.0] if axial else [0.3 * press] + [0.0] * (dim - 2)
    if shape is None:
        path = mesh(two_blocks, folder / f"{space}_two.msh", dim, 2, 3, cell)
        if "all" not in said:
            said.update(source="upper_bottom", target="lower_top")
        bodies, top, low = ["lower", "upper"], "upper_top", [Displacement("lower_bottom", [0.0] * dim)]
        value = [*shift, -press]
    else:
        path = mesh(one_block, folder / f"{space}_one.msh", dim, 3, cell)
        said.update(source="bottom", obstacle=obstacle(shape, dim, axial, press))
        bodies, top, low, value = ["block"], "top", [], [0.0] * dim
    scene = Scene(
        MeshSpec(path, strain=strain, kinematics=kinematics), {"m": MATERIALS[material]},
        [Body(name, "m") for name in bodies], contacts=[Contact(name="contact", **said)],
        displacements=[*low, Displacement(top, value)], steps=Steps(count=2), output=Output(fields=False),
        # at what rounding errors of places leave of small displacements; those of a ball that is nearly flat are larger
        petsc={"snes_rtol": "1e-7" if shape == "ball" else "1e-8", "pc_type": "lu", "ksp_type": "preonly"},
    )  # fmt: skip
    look = Steady(top)
    with running(scene, None, [look]) as (_, converged):
        assert converged
    return np.array(look.forces), look.newton


# two of the four are enough for the fast tests
CHOSEN = [pytest.param(name, marks=[pytest.mark.slow] * (name in ("plane stress", "ring"))) for name in SPACES]


@pytest.mark.parametrize("space", CHOSEN)
@pytest.mark.parametrize("kind", KINDS)
def test_small_motions(tmp_path, space, kind):
    """Forces of both kinds of strain differ by a part of the order of the strain."""
    press = 1e-4 if KINDS[kind].get("obstacle") == "ball" else 1e-5
    small, finite = (pressed(tmp_path, space, kind, press, strain, "elastic")[0] for strain in ("small", "finite"))
    assert np.abs(small).max() > 1e-4
    np.testing.assert_allclose(finite, small, atol=20.0 * press * np.abs(small).max())


@pytest.mark.parametrize("space", CHOSEN)
@pytest.mark.parametrize("kind", KINDS)
def test_large_motions(tmp_path, space, kind):
    """A metal block is pressed by a tenth of its height in two load steps, none of which is cut; forces balance."""
    forces, _ = pressed(tmp_path, space, kind, 0.1, "finite", "metal")
    assert np.abs(forces).max() > 1.0
    if "all" not in KINDS[kind]:
        contact, top = forces[:, 0], forces[:, 1]
        axes = slice(1, None) if space == "ring" else slice(None)
        np.testing.assert_allclose(np.abs(contact[:, axes]), np.abs(top[:, axes]), atol=1e-5 * np.abs(top).max())
