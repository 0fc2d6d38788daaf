"""The scenes on which errors are named and reached: coarse meshes to begin with.

`HELD_BACK` are scenes that no choice of the loop was made on: they were not run before all choices had been made.
`LATE` of them were written when the others had been looked at often, without a look at what the loop makes of them:
they had not been run with an error named before they stood here. They are what engineers build, and differ from all
others:

    lug         a lug pulled off its axis by a loose pin, with friction and in plane stress. No symmetry; the bore
                conforms nearly to the pin, so that contact begins at a point and closes over an arc that is not known;
                another peak of the stress is at the fillets, away from the contact.
    roller      a crowned roller pressed on a block, then pushed across it: tetrahedra, an ellipse of contact that is
                four times as long as wide and sticks in its middle. The path has a corner, the end of the roller stays
                free.
    disc_press  a copper disc with hardening between a stamp with a round edge and an anvil, in axial symmetry: three
                bodies, two contacts with friction, one of which recedes while the other one grows over yielding cells.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from types import SimpleNamespace

import numpy as np

from drivers._common import make_mesh
from drivers.cases import cattaneo_mindlin, disk_on_block, hertz, indent, rings, thick_cylinder
from drivers.studies._block_scenes import DIRECT, blocks, laminates, loaded
from drivers.studies._harness import composed
from drivers.studies._round_bodies import (
    LARGE,
    MIDDLE,
    SMALL,
    round_scene,
    shell_exact,
    shell_pressure,
    wound_pressure,
    wound_rings,
)
from drivers.studies.adapt import STIFF, STROKE, gentle_scene, punch_scene
from meshes import crowned_roller, disc_in_press, lug_on_pin, two_blocks
from meshes import disk_on_block as disk_mesh
from meshes import indent as indent_mesh
from meshes import rings as rings_mesh
from meshes.punch import cube_on_block, punch
from meshes.shells import shells
from pcontact.scene.model import Contact, Displacement, Load, Material, MeshSpec, Output, Steps


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
    exact : callable or None
        Displacement and gradient at points of a body; None: a finer solution stands for it.
    known : dict of str to float
        Quantities whose values are known.
    reference, pressure : float
        Errors that are named of the finer solutions: of the energy norm, and of the pressure in L2.
    steps, after : int
        Load steps that these begin with, at least, and those of one more run on their last mesh; 0: none.
    """

    title: str
    scene: Callable
    quantities: tuple = ("energy",)
    exact: Callable | None = None
    known: dict = field(default_factory=dict)
    reference: float = 0.002
    pressure: float = 0.003
    steps: int = 1
    after: int = 0


def _shells(folder):
    path = make_mesh(shells, folder / "shells.msh", (LARGE, MIDDLE, SMALL), h=0.2, order=2)
    return round_scene(path, 2, 0.0, "shells")


def _disk(folder):
    path = make_mesh(disk_mesh, folder / "disk.msh", 0.1, 2)
    return disk_on_block.scene(path, 0.0, order=2)


def _sheared(folder):
    path = make_mesh(two_blocks, folder / "sheared.msh", 2, 3, 5, "triangle")
    return composed(
        path,
        dict.fromkeys(("lower", "upper"), Material(10.0, 0.3)),
        {"lower_bottom": [0.0, 0.0], "upper_top": [0.02, -0.05]},
        title="blocks pressed and sheared",
        contacts=[Contact("upper_bottom", "lower_top", name="face", friction=0.3)],
        steps=Steps(count=4),
    )


def _lug(folder):
    return composed(
        MeshSpec(make_mesh(lug_on_pin, folder / "lug.msh"), 2, "plane_stress"),
        {"lug": Material(70e3, 0.33), "pin": Material(210e3, 0.3)},
        {"pin_hole": [0.0, 0.0], "lug_end": [0.09, 0.02]},
        title="a lug pulled off its axis by a loose pin",
        contacts=[Contact("pin_skin", "lug_bore", name="bore", friction=0.2)],
        steps=Steps(count=3),
    )


def _roller(folder):
    return composed(
        MeshSpec(make_mesh(crowned_roller, folder / "roller.msh"), 2),
        {"roller": Material(210e3, 0.3), "block": Material(110e3, 0.34)},
        [
            Displacement("block_bottom", [0.0, 0.0, 0.0]),
            Displacement("symmetry_y", ["free", 0.0, "free"]),
            Displacement("roller_top", ["free", "free", -0.05], [(0.0, 0.0), (1.0, 1.0)]),
            Displacement("roller_top", [0.015, "free", "free"], [(1.0, 0.0), (2.0, 1.0)]),
        ],
        title="a crowned roller pressed on a block and pushed across it",
        contacts=[Contact("roller_tread", "block_top", name="tread", friction=0.3)],
        steps=Steps(2.0, 4),
    )


def _disc_press(folder):
    return composed(
        MeshSpec(make_mesh(disc_in_press, folder / "disc_press.msh"), 2, "axisymmetric"),
        {
            "stamp": Material(210e3, 0.3),
            "disc": Material(120e3, 0.34, yield_stress=100.0, hardening=2000.0),
            "anvil": Material(210e3, 0.3),
        },
        {"anvil_bottom": ["free", 0.0], "stamp_top": ["free", -0.02]},
        title="a copper disc between a stamp and an anvil",
        contacts=[
            Contact("disc_top", "stamp_skin", name="stamp", friction=0.1),
            Contact("disc_bottom", "anvil_top", name="anvil", friction=0.1),
        ],
        steps=Steps(count=4),
        petsc=DIRECT,
    )


def _rings(pressure, delta, n, folder):
    path = make_mesh(rings_mesh, folder / f"rings_{delta:g}.msh", n=n, cell="triangle", order=2, delta=delta)
    return rings.ring_scene(path, 1, 0.0, pressure=pressure, gamma0=None)


def _hertz(name, facets, folder):
    case = hertz.CASES[name]
    path = hertz.generate(case, folder / f"{name}.msh", case.half_width / facets, 2, finer=0.5)
    drive = "force" if case.force else "displacement"
    args = SimpleNamespace(case=name, order=2, theta=None, gamma0=None, drive=drive, steps=1, hold=0, fields=False)
    return hertz.make_scene(case, path, args)


def _cattaneo(folder):
    args = SimpleNamespace(h=cattaneo_mindlin.CASE.half_width / 4, order=2, mu=0.2, gamma0=None, press=3, steps=2,
                           displacement=cattaneo_mindlin.DISPLACEMENT, fields=False)  # fmt: skip
    return cattaneo_mindlin.make_scene(cattaneo_mindlin.generate(folder / "cattaneo.msh", args, 0.5), args, None)


def _hill(folder):
    path = thick_cylinder.make(folder / "hill.msh", "plane", "triangle", 2, 3)
    return thick_cylinder.scene(path, "plane", 2, (thick_cylinder.CHECKED,), steps=4)


def _indent(folder):
    path = make_mesh(indent_mesh, folder / "indent.msh", 2, 0.15, 2, "triangle")
    # hundreds of load steps on some thousand unknowns: a factorisation takes less than multigrid
    return indent.scene(path, 2, material=indent.metal(hardening=indent.HARDENING), unload=0, order=2, steps=10,
                        petsc=DIRECT)


def _punch(folder):
    scene = punch_scene(make_mesh(punch, folder / "punch.msh", h=0.5, order=2), 2, 0.0)
    scene.output, scene.petsc = Output(fields=False), {}
    return scene


def _cube(folder):
    path = make_mesh(cube_on_block, folder / "cube.msh", h=0.5)
    return composed(
        MeshSpec(path, order=2),
        {"punch": Material(STIFF, 0.3), "block": Material(1.0, 0.3)},
        {
            "symmetry_x": [0.0, "free", "free"],
            "symmetry_y": ["free", 0.0, "free"],
            "block_bottom": ["free", "free", 0.0],
            "punch_top": ["free", "free", STROKE],
        },
        title="a stiff cube with sharp edges pressed on a block",
        contacts=[Contact("block_under", "punch_face", name="face")],
    )


def _soft_punch(folder):
    scene = gentle_scene(folder, 2)
    scene.output = Output(fields=False)
    return scene


def _receding(folder):
    path = make_mesh(two_blocks, folder / "receding.msh", 2, 4, 5, "triangle", order=2)
    return composed(
        MeshSpec(path, order=2),
        dict.fromkeys(("lower", "upper"), Material(10.0, 0.3)),
        {"lower_bottom": [0.0, 0.0], "upper_top": [0.0, "free"]},
        title="a block pressed in its middle, whose ends lift off",
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
        loads=[Load("upper_top", traction=[0.0, "-0.5*exp(-100*(x-0.5)**2)"])],
    )


def _wound(folder):
    path = make_mesh(rings_mesh, folder / "wound.msh", n=12, cell="triangle", order=2)
    return wound_rings(path, 1, 0.0)[0]


def _wound_known(x, body):
    return wound_rings("", 1, 0.0)[1](x, body)


def _laminate(folder):
    path = make_mesh(two_blocks, folder / "laminate.msh", 2, 3, 5, "triangle")
    return composed(
        path,
        laminates(),
        {"lower_bottom": [0.0, 0.0], "upper_top": [0.02, -0.05]},
        title="blocks of laminates pressed and sheared",
        contacts=[Contact("upper_bottom", "lower_top", name="face", friction=0.3)],
        steps=Steps(count=4),
    )


def _loaded(kind, folder):
    scene = loaded("plane", kind, 3, 2, folder)
    scene.petsc = {}
    return scene


def _degrees(folder):
    scene = blocks("plane", "joined", 3, 2, None, folder)
    scene.petsc = {}
    return scene


def ring_force(pressure):
    """Of the inner ring on the outer one, a quarter of each: their pressure, on both projections of the arc."""
    return np.sqrt(2.0) * rings.MIDDLE * pressure


def shell_force():
    """The same of an eighth of two shells: on three projections of its surface."""
    return np.sqrt(3.0) * 0.25 * np.pi * MIDDLE**2 * shell_pressure()


# an interference of 6e-4, and fibres that hardly stretch, need circles that are known well: twelve curved cells in a
# quarter, not four
SCENES = {
    "rings": NamedScene("rings, Lame", partial(_rings, rings.PRESSURE, 0.0, 4),
                        ("energy", "force:circle", "pressure:circle"),
                        partial(rings.exact, constants=rings.ring_constants()),
                        {"force:circle": ring_force(rings.interface_pressure()),
                         "pressure:circle": rings.interface_pressure()}),
    "shrink_fit": NamedScene("rings shrunk onto each other, Lame", partial(_rings, 0.0, 6e-4, 12),
                             ("energy", "pressure:circle"),
                             partial(rings.exact, constants=rings.ring_constants(0.0, 6e-4)),
                             {"pressure:circle": rings.interface_pressure(0.0, 6e-4)}),
    "wound": NamedScene("a laminate wound around wood, Lekhnitskii", _wound, ("energy", "force:circle"), _wound_known,
                         {"force:circle": ring_force(wound_pressure())}),
    "laminate": NamedScene("laminates pressed and sheared, Coulomb", _laminate, ("energy", "support:upper_top")),
    "weight": NamedScene("a block under its weight", partial(_loaded, "weight")),
    "heat": NamedScene("a block with a hot spot", partial(_loaded, "heat"), ("energy", "displacement:right")),
    "springs": NamedScene("a block on springs", partial(_loaded, "springs"), ("energy", "displacement:top")),
    "rigid": NamedScene("a block, an end moved as a rigid body", partial(_loaded, "rigid"), ("energy", "support:left")),
    "average": NamedScene("a block, an end moved on average", partial(_loaded, "average"), ("energy", "support:left")),
    "degrees": NamedScene("blocks of degree 1 and 2 with common nodes", _degrees, ("energy", "support:upper_top")),
    "hertz2d": NamedScene("cylinder on block, Hertz", partial(_hertz, "cylinder_on_block", 3),
                          ("energy", "support:block_bottom", "pressure:cylinder_skin-block_top"), pressure=0.005),
    "hertz3d": NamedScene("ball on block, Hertz", partial(_hertz, "ball_on_block", 2),
                          ("energy", "pressure:ball_skin-block_top"), reference=0.006, pressure=0.03),
    "cattaneo": NamedScene("Cattaneo and Mindlin", _cattaneo, ("energy", "pressure:skins"), pressure=0.009),
    "hill": NamedScene("thick cylinder, Hill", _hill, ("energy", "displacement:outer")),
    "indent": NamedScene("indentation", _indent, ("energy", "force:ball"), reference=0.05),
    "punch": NamedScene("re-entrant punch", _punch, ("energy", "support:punch_top", "force:face")),
    "cube": NamedScene("a cube with sharp edges on a block", _cube, reference=0.05),
    "soft_punch": NamedScene("punch as soft as the block", _soft_punch, ("pressure:face",), pressure=0.006),
    "receding": NamedScene("receding contact", _receding,
                           ("energy", "force:face", "displacement:upper_top", "pressure:face"), pressure=0.0015),
    "shells": NamedScene("spherical shells, Lame", _shells, ("energy", "force:round", "pressure:round"), shell_exact,
                         {"force:round": shell_force(), "pressure:round": shell_pressure()}),
}  # fmt: skip
HELD_BACK = {
    "disk": NamedScene("disk resting on a block", _disk, ("energy", "force:disk-block", "pressure:disk-block"),
                       pressure=0.012),
    "sheared": NamedScene("blocks pressed and sheared, Coulomb", _sheared, ("energy", "support:upper_top")),
}
LATE = {
    # the facets of the bore are 1 % of the energy norm: no reference has less than twice that
    "lug": NamedScene("a lug on a loose pin", _lug, ("energy", "support:lug_end", "pressure:bore"), reference=0.03,
                      pressure=0.03, steps=24),
    "roller": NamedScene("a crowned roller on a block", _roller, ("energy", "support:roller_top"), reference=0.07),
    # load steps cost more than the mesh: hundreds of them are taken once
    "disc_press": NamedScene("a disc between a stamp and an anvil", _disc_press,
                             ("energy", "force:stamp", "displacement:disc_rim"), reference=0.02, after=128),
}
HELD_BACK |= LATE
