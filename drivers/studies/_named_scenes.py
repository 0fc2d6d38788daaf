"""The scenes on which errors are named and reached: coarse meshes to begin with.

`HELD_BACK` are scenes that no choice of the loop was made on: they were not run before all choices had been made.
"""

from collections.abc import Callable
from dataclasses import dataclass

from drivers._common import make_mesh
from drivers.cases import disk_on_block
from drivers.studies.effectivity import LARGE, MIDDLE, SMALL, _round_scene
from meshes import disk_on_block as disk_mesh
from meshes import two_blocks
from meshes.shells import shells
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene, Steps


@dataclass(frozen=True)
class NamedScene:
    """A scene of the study.

    Attributes
    ----------
    title : str
    scene : callable
        ``scene(folder)`` writes the mesh to begin with, and gives the scene. *Collective.*
    quantities : tuple of str
        Whose errors are named, in the words of ``-error_of``.
    """

    title: str
    scene: Callable
    quantities: tuple = ("energy",)


def _shells(folder):
    path = make_mesh(shells, folder / "shells.msh", (LARGE, MIDDLE, SMALL), h=0.25, order=2)
    return _round_scene(path, 2, 0.0, "shells")


def _disk(folder):
    path = make_mesh(disk_mesh, folder / "disk.msh", 0.1, 2)
    return disk_on_block.scene(path, 0.0, order=2)


def _sheared(folder):
    path = make_mesh(two_blocks, folder / "sheared.msh", 2, 3, 5, "triangle")
    return Scene(
        title="blocks pressed and sheared",
        mesh=MeshSpec(path),
        materials={"soft": Material(10.0, 0.3)},
        bodies=[Body("lower", "soft"), Body("upper", "soft")],
        contacts=[Contact("upper_bottom", "lower_top", name="face", friction=0.3)],
        displacements=[Displacement("lower_bottom", [0.0, 0.0]), Displacement("upper_top", [0.02, -0.05])],
        steps=Steps(count=4),
        output=Output(fields=False),
    )


HELD_BACK = {
    "shells": NamedScene("spherical shells, Lame", _shells, ("energy", "force:round")),
    "disk": NamedScene("disk resting on a block", _disk, ("energy", "force:disk-block")),
    "sheared": NamedScene("blocks pressed and sheared, Coulomb", _sheared, ("energy", "support:upper_top")),
}
