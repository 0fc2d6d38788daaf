"""Scenes of one and of two blocks."""

from drivers._common import make_mesh
from drivers.cases.patch import scene as patch_scene
from meshes import one_block
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene
from tests.support.small import DIMENSION

YOUNG, POISSON, DEPTH = 1000.0, 0.3, 0.01
TIGHT = {"snes_rtol": "1e-12"}


def scene_of(path, cell, theta=0.0, **more):
    """Two blocks pressed together by a displacement; the lower one is held at its bottom."""
    d = DIMENSION[cell]
    said = {
        "contacts": [Contact("upper_bottom", "lower_top", name="pair", theta=theta)],
        "displacements": [
            Displacement("lower_bottom", [0.0] * d),
            Displacement("upper_top", [0.0] * (d - 1) + [-0.02]),
            Displacement("left", [0.0, *["free"] * (d - 1)]),
        ],
        "output": Output(fields=False, probes=["upper_top", "lower_top", "upper_origin"]),
        "petsc": TIGHT,
        **more,
    }
    return Scene(
        title="two blocks",
        mesh=MeshSpec(path),
        materials={"soft": Material(10.0, 0.3), "hard": Material(30.0, 0.2)},
        bodies=[Body("lower", "hard"), Body("upper", "soft")],
        **said,
    )


def blocks(path, contacts, dim=2, loads=(), order=1):
    """Two stacked boxes, pressed."""
    return Scene(
        mesh=MeshSpec(path, order=order),
        materials={"m": Material(1000.0, 0.3)},
        bodies=[Body("lower", "m"), Body("upper", "m")],
        contacts=contacts,
        displacements=[Displacement("lower_bottom", [0.0] * dim),
                       Displacement("upper_top", [0.02] + [0.0] * (dim - 2) + [-0.05])],
        loads=list(loads),
        output=Output(fields=False),
        petsc={"snes_rtol": "1e-10"},
    )  # fmt: skip


def pressed(path, d, formulation, order=1, petsc=None, kinematics="plane_strain", **numerics):
    """A unit block pressed on a rigid plane by a displacement; its sides are free."""
    obstacle = Obstacle("plane", point=[0.0] * d, normal=[0.0] * (d - 1) + [1.0])
    held = [Displacement("left", [0.0] + ["free"] * (d - 1))]
    held += [Displacement("front", ["free", 0.0, "free"])] if d == 3 else []
    return Scene(
        mesh=MeshSpec(path, order=order, kinematics=kinematics),
        materials={"m": Material(YOUNG, POISSON)},
        bodies=[Body("block", "m")],
        contacts=[Contact("bottom", obstacle=obstacle, name="floor", formulation=formulation, **numerics)],
        displacements=[Displacement("top", ["free"] * (d - 1) + [-DEPTH]), *held],
        output=Output(fields=False),
        petsc={**TIGHT, **(petsc or {})},
    )


def made(folder, cell, n=3):
    """Path of the mesh of a unit box and its dimension. Collective."""
    d = DIMENSION[cell]
    return make_mesh(one_block, folder / "block.msh", d, n, cell), d


def dragged(path, dim, order, **more):
    """Blocks of unlike meshes and widths, whose bottom and top are held: pressed and dragged."""
    case = patch_scene(path, dim, order, formulation="augmented_lagrangian", unbiased=True, **more)
    case.displacements = case.displacements[:2]
    case.displacements[0].value = [0.0] * dim
    case.displacements[1].value = [0.05, *[0.0] * (dim - 2), -0.1]
    case.materials["elastic"].nu, case.petsc = 0.3, {}
    return case
