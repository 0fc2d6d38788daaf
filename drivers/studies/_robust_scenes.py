"""Scenes on which Newton's method is hard put to it: what `drivers/studies/robustness.py` runs.

Every function writes a mesh into a folder and returns a scene. Four of them are cases of the literature:

* receding contact: an elastic layer (height 1, half length 16) lies loose on a large base and is pressed by a strip
  load of half width 0.1 in its middle. It lifts off at once, wherever it does not end up in contact, and half the
  length of contact is 2.70, 1.335, 0.924 for a base 0.1, 1, 10 times as stiff as the layer, whatever the load.
* roller: half a cylinder of radius 50 (E 210e3) pressed with 35e3 per length on a block of 200 (E 70e3), friction 0.1,
  half of both (NAFEMS, Advanced Finite Element Contact Benchmarks, CGS-1).
* squeezed plate: half of a plate, 40 x 40, plane strain, E 130e3, nu 0.2, pressed on a rigid plane by 50 from above and
  pushed along it by 150 from its side, friction 1 (M. Raous et al., 1988): it opens, slips and sticks.
* pin: a loose pin in the hole of a plate, smaller than it by a thousandth of its radius, loaded sideways in five steps.
"""

from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import gmsh
import numpy as np

from drivers._common import make_mesh
from drivers.cases import clip as clips
from drivers.cases import indent as indents
from drivers.cases import ironing as irons
from drivers.cases import large_sliding as slides
from drivers.cases import slider as sliders
from drivers.cases import spring as springs
from drivers.cases import stack as heaps
from drivers.studies import _extreme_scenes as extremes
from drivers.studies import _extreme_shapes as shapes
from drivers.studies._harness import composed
from drivers.studies._press import make_scene as make_press
from meshes import (
    ball_on_block,
    beam,
    clip,
    cylinder_on_block,
    heap,
    indent,
    ironing,
    ironing_slab,
    layer_on_base,
    one_block,
    round_bar,
    thick_cylinder,
    two_blocks,
)
from meshes.bricks import Brick, bricks
from meshes.tools import gmsh_model, group, write
from pcontact.scene.model import Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps

FREE = "free"
THETAS = (-1.0, 0.0, 1.0)


@dataclass(frozen=True)
class Case:
    """A scene of the study.

    Attributes
    ----------
    name : str
    family : str
    make : callable
        From a folder to a scene. *Collective.*
    large : bool
        Whether it takes more than some ten seconds.
    """

    name: str
    family: str
    make: Callable[[Path], Scene]
    large: bool = False


SOFT = Material(1000.0, 0.3)


def _scene(path, *parts, **keys):
    return composed(MeshSpec(path, order=1), *parts, **keys)


def _plane(point, normal, **more):
    return Obstacle("plane", point=point, normal=normal, **more)


# -- cases of the literature -----------------------------------------------------------------------------------------


def receding(folder, stiffness=1.0, n=10):
    """The layer on its base; `n` cells over its height."""
    path = make_mesh(layer_on_base, folder / "mesh.msh", n)
    return _scene(
        path, {"layer": Material(1.0e4, 0.3), "base": Material(1.0e4 * stiffness, 0.3)},
        {"symmetry": [0.0, FREE], "base_bottom": [FREE, 0.0]}, loads=[Load("strip", pressure=1.0)],
        contacts=[Contact("layer_bottom", "base_top", name="pair")],
    )  # fmt: skip


def roller(folder, h=2.0, friction=0.1):
    """The roller on its block, in one load step."""
    path = make_mesh(
        cylinder_on_block, folder / "mesh.msh", h, radius=50.0, width=200.0, depth=200.0, half=True, contact_radius=9.0
    )
    return _scene(
        path, {"cylinder": Material(210e3, 0.3), "block": Material(70e3, 0.3)},
        {"symmetry_x": [0.0, FREE], "block_bottom": [FREE, 0.0]}, loads=[Load("cylinder_flat", pressure=350.0)],
        contacts=[Contact("cylinder_skin", "block_top", name="pair", friction=friction)],
    )  # fmt: skip


def squeezed(folder, n=16, friction=1.0):
    """The plate on its rigid plane, in one load step; `n` cells along each side."""
    path = make_mesh(one_block, folder / "mesh.msh", 2, n, size=40.0)
    floor = Contact("bottom", obstacle=_plane([0.0, 0.0], [0.0, 1.0]), name="pair", friction=friction)
    loads = [Load("top", pressure=50.0), Load("left", pressure=150.0)]
    return _scene(path, {"block": Material(130e3, 0.2)}, {"right": [0.0, FREE]}, contacts=[floor], loads=loads)


def _bent(inner, outer):
    """From (part of the radius, part of half a turn) to a half ring."""

    def bend(x):
        radius, angle = inner + (outer - inner) * x[:, 0], np.pi * x[:, 1]
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])

    return bend


def pin(folder, n=24, friction=0.3):
    """The loose pin in its hole, half of both; `n` facets along half the circle."""
    parts = [
        Brick("pin", [0.0, 0.0], [1.0, 1.0], [n // 4, n], "quadrilateral", 2, _bent(0.2, 0.999)),
        Brick("plate", [0.0, 0.0], [1.0, 1.0], [n // 3, n], "quadrilateral", 2, _bent(1.0, 3.0)),
    ]
    path = make_mesh(bricks, folder / "mesh.msh", parts)
    return _scene(
        path, {"pin": Material(210e3, 0.3), "plate": Material(70e3, 0.3)},
        {"plate_right": [0.0, 0.0], "bottom": [FREE, 0.0], "top": [FREE, 0.0]},
        contacts=[Contact("pin_right", "plate_left", name="pair", friction=friction)],
        loads=[Load("pin", body_force=[66.0, 0.0])], steps=Steps(1.0, 5),
    )  # fmt: skip


# -- those of the tests ----------------------------------------------------------------------------------------------


def jaws(folder, dim=2, theta=0.0):
    """No support at all: two rigid jaws close on a block, then its weight comes on."""
    path = make_mesh(one_block, folder / "mesh.msh", dim, 6 if dim == 2 else 3)

    def along(axis, value):
        return [value if k == axis else 0.0 for k in range(dim)]

    def jaw(name, at, towards):
        moves = {"displacement": along(0, 0.005 * towards), "amplitude": [(0, 0), (0.2, 1), (1, 1)]}
        obstacle = _plane(along(0, at), along(0, towards), **moves)
        return Contact(name, obstacle=obstacle, name=name, friction=0.5, theta=theta)

    weight = Load("block", body_force=along(dim - 1, -3.0), amplitude=[(0, 0), (0.2, 0), (1, 1)])
    pairs = [jaw("left", 0.0, 1.0), jaw("right", 1.0, -1.0)]
    return _scene(path, {"block": SOFT}, contacts=pairs, loads=[weight], steps=Steps(1.0, 5))


def kink(folder, friction=0.9, theta=0.0):
    """Matching blocks that touch without force for two load steps, then are pressed."""
    path = make_mesh(two_blocks, folder / "mesh.msh", 2, 4, 4)
    press = Displacement("upper_top", [FREE, -0.01], [(0, 0), (0.5, 0), (1, 1)])
    pair = Contact("upper_bottom", "lower_top", friction=friction, theta=theta, name="pair")
    supports = [Displacement("lower_bottom", [0, 0]), press]
    return _scene(path, {"lower": SOFT, "upper": SOFT}, supports, contacts=[pair], steps=Steps(1.0, 4))


def reversal(folder, friction=0.3, theta=0.0, n=12):
    """Dragged to full slip, then back in a single load step, again and again."""
    path = make_mesh(one_block, folder / "mesh.msh", 2, (n, n // 4))
    drag = Displacement("top", [0.1, FREE], [(0, 0), (0.2, 1), (0.4, -1), (0.6, 1), (0.8, -1), (1, 1)])
    press = Displacement("top", [FREE, -0.004], [(0, 0), (0.2, 1), (1, 1)])
    floor = Contact("bottom", obstacle=_plane([0, 0], [0, 1]), name="floor", friction=friction, theta=theta)
    return _scene(path, {"block": SOFT}, [drag, press], contacts=[floor], steps=Steps(1.0, 5))


def over_the_edge(folder, theta=0.0):
    """A block slides over the edge of another one until nothing touches."""
    path = make_mesh(two_blocks, folder / "mesh.msh", 2, 5, 4)
    drag = Displacement("upper_top", [1.2, -0.02], [(0, 0), (0.1, 0.01), (1, 1)])
    pair = Contact("upper_bottom", "lower_top", friction=0.3, theta=theta, name="pair")
    supports = [Displacement("lower_bottom", [0, 0]), drag]
    return _scene(path, {"lower": SOFT, "upper": SOFT}, supports, contacts=[pair], steps=Steps(1.0, 4))


def too_far(folder, theta=0.0):
    """One load step instead of ten, with a search radius that admits a tenth."""
    path = make_mesh(one_block, folder / "mesh.msh", 2, 6)
    floor = Contact("bottom", obstacle=_plane([0, -0.5], [0, 1]), name="floor", friction=0.9, theta=theta,
                    search_radius=0.15)  # fmt: skip
    return _scene(path, {"block": SOFT}, {"top": [0.1, -0.52]}, contacts=[floor])


def lid(folder, dim=2, count=1, friction=0.3):
    """Loose blocks between a floor and a lid that presses and drags them, and goes up again."""
    n = 6 if dim == 2 else 3
    path = make_mesh(*((one_block, folder / "mesh.msh", dim, n) if count == 1 else
                       (two_blocks, folder / "mesh.msh", dim, n, n + 1)))  # fmt: skip

    def along(value, sideways=0.0):
        return [sideways, *[0.0] * (dim - 2), value]

    moves = {"displacement": along(-0.02, 0.004), "amplitude": [(0, 0), (0.5, 1), (1, -1)]}
    bodies = ["block"] if count == 1 else ["lower", "upper"]
    bottom, top = ("bottom", "top") if count == 1 else ("lower_bottom", "upper_top")
    contacts = [
        Contact(bottom, obstacle=_plane(along(0.0), along(1.0)), name="floor", friction=friction),
        Contact(top, obstacle=_plane(along(float(count)), along(-1.0), **moves), name="lid", friction=friction),
    ]
    if count > 1:
        contacts.append(Contact("upper_bottom", "lower_top", name="pair", friction=friction))
    return _scene(path, dict.fromkeys(bodies, SOFT), contacts=contacts, steps=Steps(1.0, 4, 0.1))


# -- those of the drivers --------------------------------------------------------------------------------------------


def heaped(folder, dim=2, count=20, h=None, **keys):
    """Disks or balls in a box."""
    h = h or heaps.SIZES[dim]
    overlap = heaps.default_overlap(dim, h)
    path = make_mesh(heap, folder / "mesh.msh", dim, count, h, 0.0, None, 1, overlap)
    return heaps.scene(path, dim, count, overlap=overlap, **keys)


def clipped(folder, h=0.2, count=30, friction=0.2, **keys):
    """The clip that snaps in."""
    path = make_mesh(clip, folder / "mesh.msh", 2, h, 1, clips.CELL[2], width=clips.WIDTH)
    return clips.scene(path, 2, friction, count=count, **keys)


def sprung(folder, **keys):
    """The spring whose coils close."""
    args = Namespace(
        **{"coils": 2.5, "radius": 3.0, "top": None, "wire": 1.0, "pitch": 1.4, "h": 0.5, "along": 2.0, "order": 1,
           "friction": 0.0, "yield_stress": 0.0, "hardening": 2000.0, "travel": 1.0, "steps": 4} | keys
    )  # fmt: skip
    path = springs.mesh(folder / "mesh.msh", args)
    return springs.scene(path, args, springs.closing_travel(args) * args.travel)


def indented(folder, dim=2, h=0.1, yields=300.0, **keys):
    """A ball pressed into a block, and taken off."""
    size = {"fine": 0.5, "length": 5.0, "radius": indents.RADIUS if keys.get("ball") else None}
    path = make_mesh(indent, folder / "mesh.msh", dim, h, 1, indents.CELLS[dim][0], **size)
    return indents.scene(path, dim, material=indents.metal(yields), **({"steps": 4, "unload": 2} | keys))


def ironed(folder, h=0.2, count=20, mu=0.3, **keys):
    """A round foot pressed into a slab and drawn along it."""
    return irons.scene(make_mesh(ironing, folder / "mesh.msh", 2, h), 2, mu, count=count, **keys)


def dragged(folder, dim=2, law="coulomb", mu=0.5, **keys):
    """The sliding block."""
    path = sliders.make(folder / "mesh.msh", dim, 12 if dim == 2 else 6)
    return sliders.scene(path, dim, sliders.law_keys(law, mu), count=20, **keys)


def pressed(folder, unknowns=50_000, friction=0.0, yield_stress=None, strain="small"):
    """A ball on a block in space, in one load step."""
    path = make_mesh(ball_on_block, folder / "mesh.msh", unknowns=unknowns)
    case = make_press(path, "plastic" if yield_stress else "elastic", yield_stress=yield_stress or 5.0)
    case = replace(case, mesh=replace(case.mesh, strain=strain))
    contacts = [replace(contact, friction=friction) for contact in case.contacts]
    return replace(case, contacts=contacts)


def large(folder, make, mesh, arguments, **keys):
    """Bodies with finite strain that turn and slide far, see `drivers/cases/large_sliding.py`."""
    scene = make(make_mesh(mesh[0], folder / "mesh.msh", *mesh[1:], **arguments), **keys)
    return replace(scene, output=Output(fields=False))


def ironed_slab(folder, n, search, order=1):
    """The slab that irons a foundation, in short load steps, on a coarse mesh: past vertices and sharp edges."""
    scene = slides.ironing_scene(make_mesh(ironing_slab, folder / "mesh.msh", n, order), 1.0, 2.0, 20, 40)
    contacts = [replace(scene.contacts[0], search=search)]
    return replace(scene, mesh=replace(scene.mesh, order=order), contacts=contacts, output=Output(fields=False))


def flattened(folder, depth=0.8, count=20):
    """A quarter of a slender elastic ring, pressed nearly flat."""
    path = make_mesh(thick_cylinder, folder / "mesh.msh", 2, (2, 40), inner=0.92, outer=1.0)
    scene = slides.ring_scene(path, 0.2, depth, count)
    return replace(scene, materials={"rubber": Material(1.0, 0.3)}, output=Output(fields=False))


def snapping(folder, load=0.5, count=20):
    """A flat arch, clamped at both ends: a pressure makes it snap to the other side, onto a floor."""

    def bend(x):
        return np.column_stack([2.0 * x[:, 0] - 1.0, 0.2 * (1.0 - (2.0 * x[:, 0] - 1.0) ** 2) + 0.02 * x[:, 1]])

    arch = Brick("arch", [0.0, 0.0], [1.0, 1.0], [48, 2], "quadrilateral", 2, bend)
    path = make_mesh(bricks, folder / "mesh.msh", [arch])
    floor = _plane([0.0, -0.15], [0.0, 1.0])
    return composed(
        MeshSpec(path, order=2, strain="finite"), {"arch": Material(1.0e4, 0.3)},
        {"arch_left": [0.0, 0.0], "arch_right": [0.0, 0.0]}, loads=[Load("arch_top", pressure=load)],
        contacts=[Contact("arch_bottom", obstacle=floor, name="floor", friction=0.2, search_radius=0.5)],
        steps=Steps(count=count),
    )  # fmt: skip


def drawn(folder, deep=0.3, count=30, cells=(40, 2)):
    """A thin round sheet that yields, drawn by a ball over the round edge of a die, under a holder."""
    sheet = Brick("sheet", [0.0, 0.0], [1.0, 0.04], [*cells], "quadrilateral")
    path = make_mesh(bricks, folder / "mesh.msh", [sheet])
    punch = Obstacle("sphere", center=[0.0, 0.44], radius=0.4, displacement=[0.0, -deep])
    tools = (
        ("punch", "sheet_top", punch),
        ("die", "sheet_bottom", Obstacle("sphere", center=[0.6, -0.15], radius=0.15)),
        ("holder", "sheet_top", _plane([0.0, 0.042], [0.0, -1.0])),
    )
    return composed(
        MeshSpec(path, kinematics="axisymmetric", strain="finite", mean_dilatation=True),
        {"sheet": Material(210e3, 0.3, yield_stress=200.0, hardening=1000.0)}, {"sheet_left": [0.0, FREE]},
        contacts=[Contact(region, obstacle=tool, name=name, friction=0.1) for name, region, tool in tools],
        steps=Steps(count=count),
    )  # fmt: skip


def bent(folder, load=1.0, count=4, held=("left",), thin=0.5, back=0, **keys):
    """A strip of length 20, a cantilever or clamped at both ends, finite strain: a force on its end, or a pressure, of
    ``load`` times E I / L^2, goes up in some steps, and back to nothing in others, after which nothing acts."""
    path, young = make_mesh(beam, folder / "mesh.msh", (40, 1), length=20.0, height=thin, order=2), 1.2e4
    force = load * young * thin**3 / 12.0 / 20.0**2
    amplitude = [[0.0, 0.0], [1.0, 1.0], [2.0, 0.0], [3.0, 0.0]] if back else None
    where = {"region": "top", "pressure": force / 20.0} if len(held) > 1 else {"region": "right", "force": [0.0, force]}
    return composed(
        MeshSpec(path, order=2, strain="finite", kinematics="plane_stress"), {"beam": Material(young, 0.0)},
        dict.fromkeys(held, [0.0, 0.0]), loads=[Load(**where, amplitude=amplitude)],
        steps=Steps(3.0 if back else 1.0, count), **keys,
    )  # fmt: skip


def section(path):
    """Section of an O-ring, of quadrilaterals that follow no pattern."""
    with gmsh_model("ring"):
        occ, option = gmsh.model.occ, gmsh.option.setNumber
        disk = occ.addDisk(52.7, 0.0, 0.0, 2.665, 2.665)
        occ.synchronize()
        group(2, "ring", [disk])
        group(1, "skin", [tag for _, tag in gmsh.model.getBoundary([(2, disk)], oriented=False)])
        for key, value in (("MeshSizeMax", 0.5), ("RecombineAll", 1), ("Algorithm", 8), ("RecombinationAlgorithm", 3)):
            option(f"Mesh.{key}", value)
        gmsh.model.mesh.generate(2)
        return write(path)


def squeezed_ring(folder, nu=0.4995, strain="small", **keys):
    """An O-ring of rubber between a shaft and a bore that closes on it by a fifth, with friction."""
    walls = {"groove": _plane([50.035, 0.0], [1.0, 0.0]),
             "bore": _plane([55.365, 0.0], [-1.0, 0.0], displacement=[-1.07, 0.0], amplitude=[(0.0, 0.0), (1.0, 1.0)])}
    law = {"law": "neo_hooke"} if strain == "finite" else {}
    return composed(
        MeshSpec(section(folder / "mesh.msh"), kinematics="axisymmetric", strain=strain),
        {"ring": Material(6.0, nu, **law)}, steps=Steps(count=10),
        contacts=[Contact("skin", obstacle=wall, name=name, friction=0.15, **keys) for name, wall in walls.items()],
    )  # fmt: skip


def extreme(folder, build, **keys):
    """A cell of the matrix of extremes, see `drivers/studies/extremes.py`."""
    return build(folder, **keys)[0]


# -- all of them -----------------------------------------------------------------------------------------------------


def _cases():
    """Family, what is said of the scene, function and its arguments."""
    solid = {"dim": 3, "cell": "hexahedron", "n": ((2, 2, 2), (3, 3, 2))}
    for stiffness in (0.1, 1.0, 10.0):
        for n in (10, 20, 40):
            yield "receding", f"base {stiffness:g}, {n} cells", receding, {"stiffness": stiffness, "n": n}
    for h in (2.0, 1.0, 0.5):
        yield "roller", f"h {h:g}", roller, {"h": h}
    for n in (16, 32, 64):
        yield "squeezed plate", f"{n} cells", squeezed, {"n": n}
    for n in (24, 48, 96):
        yield "pin", f"{n} facets", pin, {"n": n}
    for theta in THETAS:
        yield "jaws", f"2D, theta {theta:g}", jaws, {"theta": theta}
    yield "jaws", "3D", jaws, {"dim": 3}
    for theta in THETAS:
        yield "kink", f"theta {theta:g}", kink, {"theta": theta}
    for friction in (0.3, 0.9):
        for theta in THETAS:
            keys = {"friction": friction, "theta": theta}
            yield "reversal", f"friction {friction:g}, theta {theta:g}", reversal, keys
    yield "reversal", "friction 0.9, fine", reversal, {"friction": 0.9, "n": 48}
    for theta in THETAS:
        yield "over the edge", f"theta {theta:g}", over_the_edge, {"theta": theta}
    yield "too far", "one load step", too_far, {}
    for dim, count in ((2, 1), (3, 1), (2, 2)):
        yield "lid", f"{dim}D, {count} loose", lid, {"dim": dim, "count": count}
    yield "heap", "2D", heaped, {}
    yield "heap", "2D, no friction", heaped, {"friction": 0.0}
    yield "heap", "2D, yields", heaped, {"yield_stress": 20.0}
    yield "heap", "2D, one load step", heaped, {"steps": 1}
    yield "heap", "3D", heaped, {"dim": 3, "count": 5}
    yield "heap", "3D, yields", heaped, {"dim": 3, "count": 5, "yield_stress": 20.0}
    yield "clip", "elastic", clipped, {"yield_stress": 0.0}
    yield "clip", "yields, in and out", clipped, {"pull": True}
    yield "clip", "friction 0.5", clipped, {"friction": 0.5, "yield_stress": 0.0}
    yield "spring", "elastic", sprung, {}
    yield "spring", "friction, yields", sprung, {"friction": 0.2, "yield_stress": 150.0}
    for friction in (0.0, 0.3):
        yield "indentation", f"axisymmetric, friction {friction:g}", indented, {"friction": friction}
    yield "indentation", "axisymmetric, one load step", indented, {"friction": 0.3, "steps": 1, "unload": 1}
    yield "indentation", "meshed ball", indented, {"friction": 0.3, "ball": 210e3}
    yield "indentation", "3D", indented, {"dim": 3, "h": 0.15, "friction": 0.3}
    for theta in THETAS:
        yield "ironing", f"theta {theta:g}", ironed, {"theta": theta}
    yield "ironing", "friction 1", ironed, {"mu": 1.0}
    for law in sliders.LAWS:
        yield "slider", law, dragged, {"law": law}
    yield "slider", "3D", dragged, {"dim": 3}
    quarter, ring = (thick_cylinder, 2, (4, 32)), {"inner": 0.7, "outer": 1.0}
    for friction in (0.0, 0.5):
        keys = {"make": slides.ring_scene, "friction": friction, "depth": 0.5, "count": 10}
        yield "finite", f"ring, friction {friction:g}", large, {"mesh": quarter, "arguments": ring, **keys}
    keys = {"make": slides.ironing_scene, "down": 1.0, "way": 2.0, "press": 20, "drag": 20}
    yield "finite", "ironing", large, {"mesh": (ironing_slab, 3), "arguments": {}, **keys}
    keys = {"make": slides.upsetting_scene, "most": 0.4, "count": 20}
    billet = {"radius": 10.0, "length": 30.0, "waist": 1.0}
    yield "finite", "upsetting", large, {"mesh": (round_bar, (8, 12)), "arguments": billet, **keys}
    for friction in (0.0, 0.3):
        keys = {"unknowns": 12_000, "friction": friction, "strain": "finite"}
        yield "finite", f"ball on block, friction {friction:g}", pressed, keys
    for n, search, order in ((2, "closest_point", 1), (2, "closest_point", 2), (3, "ray_tracing", 1)):
        keys = {"n": n, "search": search, "order": order}
        yield "finite", f"ironing in short steps, {search}, {n}, degree {order}", ironed_slab, keys
    yield "finite", "slender ring pressed flat", flattened, {}
    yield "finite", "arch that snaps", snapping, {}
    yield "finite", "drawn sheet", drawn, {}
    for load in (1.0, 2.0, 4.0):
        yield "bending", f"cantilever, load {load:g}", bent, {"load": load}
    yield "bending", "cantilever, one load step", bent, {"count": 1}
    yield "bending", "cantilever, unloaded to nothing", bent, {"back": 1, "count": 12}
    for load in (10.0, 1000.0):
        yield "bending", f"clamped plate, load {load:g}", bent, {"load": load, "held": ("left", "right"), "thin": 0.1}
    for nu in (0.49, 0.4999):
        for strain in ("small", "finite"):
            yield "rubber", f"ring, nu {nu:g}, {strain} strain", squeezed_ring, {"nu": nu, "strain": strain}
    yield "rubber", "ring, penalty", squeezed_ring, {"formulation": "penalty"}
    stack, bars = extremes.stack, extremes.bars
    for word, build, keys in (
        ("nu 0.49999", stack, {**solid, "nu": (0.49999, 0.49999)}),
        ("a million times as stiff", stack, {"youngs": (1e9, 1e3)}),
        ("a million times as stiff, friction", stack, {"youngs": (1e3, 1e9), "friction": 0.3}),
        ("gamma0 1e6", stack, {"gamma0": 1e6}),
        ("penalty", stack, {"formulation": "penalty", "friction": 0.3}),
        ("augmented Lagrangian", stack, {"formulation": "augmented_lagrangian", "friction": 0.3}),
        ("unbiased", stack, {"unbiased": True, "friction": 0.3}),
        ("friction 3, stick", extremes.shear, {"friction": 3.0, "ratio": 2.7}),
        ("friction 1, slip", extremes.shear, {"friction": 1.0, "ratio": 1.5}),
        ("near the limit load", bars, {"hardening": 0.0}),
        ("flowing", extremes.flowing, {"level": 0.99}),
        ("corner on face", shapes.pointed, {}),
        ("corner on face, friction, 3D", shapes.pointed, {"dim": 3, "cell": "hexahedron", "n": 3, "friction": 0.3}),
        ("edge on edge", shapes.pointed, {"kind": "edge on edge", "dim": 3, "cell": "hexahedron", "n": 3}),
        ("parabola on a plane", shapes.touching, {"load": 1.0}),
        ("wave pressed flat", shapes.wave, {"cell": "quadrilateral", "n": (16, 10), "part": 1.5}),
        ("wave half flat, 3D", shapes.wave, {"cell": "tetrahedron", "n": (10, 6), "part": 0.5}),
    ):
        yield "extremes", word, extreme, {"build": build, **keys}
    for unknowns in (50_000, 200_000):
        for friction, bound in ((0.0, None), (0.3, None), (0.0, 5.0), (0.3, 5.0)):
            word = f"{unknowns}, friction {friction:g}{', yields' if bound else ''}"
            keys = {"unknowns": unknowns, "friction": friction, "yield_stress": bound}
            yield "ball on block", word, pressed, keys


def _is_large(family, keys):
    return family == "ball on block" or (family == "receding" and keys["n"] > 10)


CASES = [Case(word, family, partial(make, **keys), _is_large(family, keys)) for family, word, make, keys in _cases()]
