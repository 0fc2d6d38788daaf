"""Scenes drawn from seeds, for the study of named errors.

A seed gives the same scene everywhere. Bodies are polygons whose edges may be arcs. They are drawn in the plane; some
have a depth then, between two planes across which nothing moves: their solution is the one in the plane. The mesh to
begin with has cells of a drawn kind and size, from one cell along an edge to sizes that jump from vertex to vertex.
:meth:`Drawn.graded` makes meshes of references: triangles that grow with the distance from vertices and given places.
"""

from dataclasses import dataclass

import gmsh
import numpy as np

from meshes.tools import gmsh_model, group, use_fields, write
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Output, Scene, Steps
from pcontact.scene.target import QUANTITIES

FREE = "free"
SIZES = ("one cell", "coarse", "coarse", "fair", "badly graded", "badly graded")
CELLS = ("triangles", "triangles", "triangles", "quadrilaterals", "mixed", "grid", "grid of triangles")
# [-] Cells of references: on contact surfaces over the smallest width of a body, and in the middle of bodies over the
# largest one, both times the growth of cells with the distance. From: chosen.
ALONG, FAR = 0.25, 0.6
# [-] Cells at vertices and at edges of contact areas, over those on contact surfaces, as powers of the growth. From:
# cells have errors of the growth squared, and singularities there powers of 0.3 or more, and of 1.5, of the distance.
AT_VERTICES, AT_EDGES = 10.0, 3.0


# Of cells that are turned inside out, at most. From: chosen.
HALVINGS = 4
# [rad] Facets of arcs, by the degree of the mesh, at most, where the program is not given the geometry: larger ones are
# the shape, not what stands for it. From: chosen.
ARC = {1: 0.5, 2: 0.8}


@dataclass
class Shape:
    """A body: vertices (n, 2) in counterclockwise order; of every edge from there its name and the centre of its arc
    (None: straight)."""

    name: str
    points: np.ndarray
    edges: list

    @property
    def width(self):
        """The smaller side of its box."""
        return float(np.ptp(self.points, axis=0).min())


@dataclass
class Drawn:
    """A scene that was drawn: `kind` in words, the geometry, the scene without its mesh, the quantities whose errors
    are named, and the mesh to begin with: cells and sizes of `CELLS` and `SIZES`, its degree, its depth (0: in the
    plane) with layers of cells across it (0: tetrahedra), and whether the program is given the geometry; words of edges
    that all bodies are mirrored at."""

    seed: int
    kind: str
    shapes: list
    scene: Scene
    quantities: list
    cells: str
    sizes: str
    order: int
    depth: float
    layers: int
    geometry: bool
    mirrored: tuple = ()

    @property
    def rests(self):
        """Whether the answer depends on load steps."""
        return any(one.friction for one in self.scene.contacts) or any(
            one.plastic for one in self.scene.materials.values()
        )

    @property
    def known(self):
        """Quantities, but for the energy, that the program names errors of."""
        return [of for of in self.quantities if of.partition(":")[0] in QUANTITIES and of != "energy"]

    def begun(self, folder):
        """The scene on its mesh to begin with, which is written into a folder: the first one without a cell that is
        turned inside out, of cells half as large each time."""
        path = folder / f"start_{self.seed}.msh"
        for halvings in range(HALVINGS + 1):
            with gmsh_model("start"):
                self._start(0.5**halvings)
                if self.geometry:
                    gmsh.write(str(path.with_suffix(".brep")))
                gmsh.model.mesh.generate(3 if self.depth else 2)
                if self.order == 2:
                    gmsh.model.mesh.setOrder(2)
                try:
                    write(path)
                    break
                except RuntimeError:
                    # curved facets of few cells may go through the other side of a thin ring
                    if halvings == HALVINGS:
                        raise
        scene = self._on(path)
        scene.mesh.geometry = path.with_suffix(".brep") if self.geometry else None
        if self.depth:
            for one in scene.displacements:
                one.value = [*one.value, FREE]
            for one in scene.loads:
                one.traction = None if one.traction is None else [*one.traction, 0.0]
            scene.displacements += [Displacement(side, [FREE, FREE, 0.0]) for side in ("front", "back")]
        return scene

    def graded(self, folder, growth, places=()):
        """The scene in the plane on the mesh of a reference, whose cells grow with the distance from vertices, and from
        places (n, 2) on contact surfaces; of degree 2."""
        path = folder / f"graded_{self.seed}.msh"
        with gmsh_model("graded"):
            curves, corners = self._draw()
            # the bodies go on beyond these edges: nothing is singular at their ends
            edges = [edge.partition("_")[2] for shape in self.shapes for edge, _ in shape.edges]
            ends = [before for shape in self.shapes for before in np.roll([e for e, _ in shape.edges], 1)]
            vertices = [corner for corner, edge, before in zip(corners, edges, ends, strict=True)
                        if not {edge, before.partition("_")[2]} & set(self.mirrored)]  # fmt: skip
            extra = [gmsh.model.occ.addPoint(*place, 0.0) for place in places]
            gmsh.model.occ.synchronize()
            touched = {name for one in self.scene.contacts for name in (one.source, one.target)}
            on_contact = [curve for name in touched for curve in curves[name]]
            widest = max(one.width for one in self.shapes)
            narrow = min(one.width for one in self.shapes)
            along, far = ALONG * growth * narrow, FAR * growth * widest
            fields = [
                _growing("PointsList", vertices, along * growth**AT_VERTICES, growth, far),
                _growing("PointsList", extra, along * growth**AT_EDGES, growth, far),
                _growing("CurvesList", on_contact, along, growth, far),
            ]
            use_fields([one for one in fields if one])
            gmsh.model.mesh.generate(2)
            gmsh.model.mesh.setOrder(2)
            write(path)
        scene = self._on(path)
        scene.mesh.order = 2
        return scene

    def _on(self, path):
        scene = self.scene.copy()
        scene.mesh.file = path
        scene.output.probes = sorted({of.partition(":")[2] for of in self.quantities if of.startswith(PROBED)})
        return scene

    def _draw(self, sizes=None):
        """Draw the shapes, and name their groups: curves by their names, and vertices. `sizes`: at those of a shape."""
        occ, curves, every, bodies = gmsh.model.occ, {}, [], {}
        for number, shape in enumerate(self.shapes):
            h = np.full(len(shape.points), 1.0) if sizes is None else sizes[number]
            corners = [occ.addPoint(*x, 0.0, size) for x, size in zip(shape.points, h, strict=True)]
            every += corners
            lines = []
            for k, (name, centre) in enumerate(shape.edges):
                ends = corners[k], corners[(k + 1) % len(corners)]
                if centre is None:
                    lines.append(occ.addLine(*ends))
                else:
                    lines.append(occ.addCircleArc(ends[0], occ.addPoint(*centre, 0.0), ends[1]))
                curves.setdefault(name, []).append(lines[-1])
            bodies[shape.name] = occ.addPlaneSurface([occ.addCurveLoop(lines)]), lines
        self._bodies = bodies
        if sizes is None or not self.depth:
            occ.synchronize()
            for name, (surface, _) in bodies.items():
                group(2, name, [surface])
            for name, lines in curves.items():
                group(1, name, lines)
        return curves, every

    def _start(self, scale=1.0):
        """Draw the mesh to begin with, with cells of sizes times a number."""
        rng, sizes = np.random.default_rng([21, self.seed]), []
        for shape in self.shapes:
            size = {"one cell": 10.0, "coarse": 0.7, "fair": 0.3, "badly graded": 0.7}[self.sizes] * shape.width * scale
            spread = np.exp(rng.uniform(-2.0, 0.5, len(shape.points))) if self.sizes == "badly graded" else 1.0
            sizes.append(size * spread * np.ones(len(shape.points)))
            for k, (_, centre) in enumerate(shape.edges if not self.geometry else ()):
                if centre is not None:
                    ends = [k, (k + 1) % len(shape.points)]
                    radius = np.linalg.norm(shape.points[k] - centre)
                    sizes[-1][ends] = np.minimum(sizes[-1][ends], ARC[self.order] * radius)
        curves, _ = self._draw(sizes)
        occ, solids, across, ends, mesh = gmsh.model.occ, {}, {}, [[], []], gmsh.model.mesh
        for name, (surface, lines) in self._bodies.items() if self.depth else ():
            more = {"numElements": [self.layers], "recombine": True} if self.layers else {}
            (_, top), (_, solids[name]), *lateral = occ.extrude([(2, surface)], 0.0, 0.0, self.depth, **more)
            ends[0].append(surface)
            ends[1].append(top)
            across.update(zip(lines, (tag for _, tag in lateral), strict=True))
        occ.synchronize()
        for name, solid in solids.items():
            group(3, name, [solid])
        if self.depth:
            for name, lines in curves.items():
                group(2, name, [across[line] for line in lines])
            group(2, "back", ends[0])
            group(2, "front", ends[1])
        for (surface, lines), shape, size in zip(self._bodies.values(), self.shapes, sizes, strict=True):
            if len(lines) == 4 and self.cells.startswith("grid"):
                for k, line in enumerate(lines):
                    length = min(np.linalg.norm(shape.points[(k + j + 1) % 4] - shape.points[k + j]) for j in (0, -2))
                    mesh.setTransfiniteCurve(line, max(1, round(length / min(size.mean(), shape.width))) + 1)
                mesh.setTransfiniteSurface(surface)
            if self.cells in ("quadrilaterals", "mixed", "grid"):
                mesh.setRecombine(2, surface)
        for option, value in {"MeshSizeFromPoints": 1, "MeshSizeExtendFromBoundary": 1, "Algorithm": 6,
                              "SubdivisionAlgorithm": int(self.cells == "quadrilaterals")}.items():  # fmt: skip
            gmsh.option.setNumber(f"Mesh.{option}", value)


PROBED = ("displacement:", "stress:")


def _growing(kind, tags, least, growth, most):
    """Size field: of cells that grow with the distance from points or curves; None without any."""
    if not tags:
        return None
    field = gmsh.model.mesh.field
    distance, sizes = field.add("Distance"), field.add("Threshold")
    field.setNumbers(distance, kind, tags)
    field.setNumber(distance, "Sampling", 400)
    for key, value in {"InField": distance, "SizeMin": least, "SizeMax": most, "DistMin": least / growth,
                       "DistMax": most / growth}.items():  # fmt: skip
        field.setNumber(sizes, key, value)
    return sizes


class _Draw:
    """Random numbers, and what families are drawn with. `half`: only the right half of what is symmetric;
    `away`: distance of the middle from the axis."""

    def __init__(self, seed):
        self.rng = np.random.default_rng([20, seed])
        self.half, self.away = self.often(0.5), 0.0

    def between(self, low, high):
        return round(float(self.rng.uniform(low, high)), 4)

    def power(self, low, high):
        return float(f"{np.exp(self.rng.uniform(np.log(low), np.log(high))):.4g}")

    def one(self, *choices):
        return choices[int(self.rng.integers(len(choices)))]

    def often(self, part):
        return bool(self.rng.random() < part)

    def shape(self, name, points, edges):
        """A body; edges are words, or words with the centres of their arcs."""
        move, arcs = np.array([self.away, 0.0]), [(one, None) if isinstance(one, str) else one for one in edges]
        return Shape(name, np.asarray(points, dtype=float) + move,
                     [(f"{name}_{word}", None if c is None else np.asarray(c) + move) for word, c in arcs])  # fmt: skip

    def box(self, name, left, right, bottom, top):
        """A rectangle; without its left half where that is mirrored."""
        left = 0.0 if self.half else left
        return self.shape(name, [(left, bottom), (right, bottom), (right, top), (left, top)],
                          ["bottom", "right", "top", "left"])  # fmt: skip

    def place(self):
        """The first coordinate from the middle, in an expression."""
        return f"(x - {self.away})"

    def contact(self, source, target, *kinds):
        """A contact of one of some kinds."""
        kind = self.one(*kinds or ("frictionless", "frictionless", "friction", "tied"))
        one = Contact(source, target, name=source.partition("_")[0], tied=kind == "tied")
        if kind == "friction":
            one.friction = self.between(0.1, 0.6)
        return one

    def material(self, strain, scale=1.0):
        """A material; `strain`: what it is expected to have."""
        young, nu = round(scale * self.power(0.3, 3.0), 6), self.one(0.0, 0.2, 0.3, 0.3, 0.4)
        kind = self.rng.random()
        if kind < 0.15:
            second, shear = round(self.power(0.1, 0.8) * young, 6), round(self.between(0.15, 0.4) * young, 6)
            return Material([young, second, second], [0.25, 0.25, 0.3], G=[shear, shear, second / 2.6],
                            angle=0.0 if self.half else self.between(-90.0, 90.0))  # fmt: skip
        if kind < 0.27:
            return Material(young, nu, yield_stress=self.between(1.0, 3.0) * strain * young,
                            hardening=self.between(0.1, 0.5) * young)  # fmt: skip
        return Material(young, nu)


# A family draws shapes, materials, contacts, displacements, loads, and quantities to choose from.


def _beam(draw):
    """A cantilever under a traction, that may close on a stop."""
    thick, gap, closes = draw.between(0.06, 0.25), draw.between(0.005, 0.03), draw.often(0.6)
    material = draw.material(0.03)
    load = gap * draw.between(1.5, 4.0) * float(np.ravel(material.E)[0]) * thick**3 / 1.5
    shapes, displacements = [draw.box("beam", 0.0, 1.0, 0.0, thick)], [Displacement("beam_left", [0.0, 0.0])]
    of = ["support:beam_left", "support:beam_left.x", "displacement:beam_right", "stress:beam_left"]
    contacts, loads = [], [Load("beam_top", traction=[draw.one(0.0, 0.2) * load, -load])]
    if closes:
        shapes.append(draw.shape("stop", [(a, b) for b in (-gap - 0.2, -gap) for a in ((0.6, 1.2) if b < -gap else
                                 (1.2, 0.6))], ["bottom", "right", "top", "left"]))  # fmt: skip
        contacts = [draw.contact("beam_bottom", "stop_top", "frictionless", "frictionless", "friction")]
        displacements.append(Displacement("stop_bottom", [0.0, 0.0]))
        of += ["force:beam", "force:beam.y"]
    return shapes, [material, draw.material(0.03)][: len(shapes)], contacts, displacements, loads, of


def _wedge(draw):
    """A punch with sharp edges, which widens or narrows upwards, on a block."""
    face, top, high, left = draw.between(0.2, 0.5), draw.between(0.3, 0.9), draw.between(0.3, 0.8), -1.0 + draw.half
    wide, press = draw.between(1.0, 1.6), draw.between(0.005, 0.03)
    punch = draw.shape("punch", [(left * face, 0.0), (face, 0.0), (top, high), (left * top, high)],
                       ["bottom", "right", "top", "left"])  # fmt: skip
    shapes = [punch, draw.box("block", -wide, wide, -draw.between(0.6, 1.2), 0.0)]
    push = 0.0 if draw.half else draw.one(0.0, 0.2, 0.5) * press
    displacements = [Displacement("block_bottom", [0.0, 0.0]), Displacement("punch_top", [push, -press])]
    of = ["force:punch", "force:punch.y", "support:punch_top.y", "displacement:block_right", "stress:block_bottom"]
    return shapes, [draw.material(press, draw.one(1.0, 10.0)), draw.material(2.0 * press)], \
        [draw.contact("punch_bottom", "block_top")], displacements, [], of  # fmt: skip


def _notch(draw):
    """A bar with a notch that is pulled along its base."""
    high, deep, wide = draw.between(0.3, 0.6), draw.between(0.3, 0.6), draw.between(0.02, 0.3)
    bar = draw.shape("bar", [(-1.0, 0.0), (1.0, 0.0), (1.0, high), (wide, high), (0.0, (1.0 - deep) * high),
                             (-wide, high), (-1.0, high)],
                     ["bottom", "right", "top", "flank", "flank", "top", "left"])  # fmt: skip
    pull, press = draw.between(0.002, 0.01), draw.power(1e-3, 5e-3)
    displacements = [Displacement("base_bottom", [0.0, 0.0]), Displacement("bar_left", [0.0, FREE]),
                     Displacement("bar_right", [pull, FREE])]  # fmt: skip
    of = ["support:bar_right", "force:bar", "force:bar.y", "displacement:bar_top", "stress:bar_flank"]
    return [bar, draw.box("base", -1.3, 1.3, -draw.between(0.4, 0.8), 0.0)], \
        [draw.material(2.0 * pull), draw.material(pull)], [draw.contact("bar_bottom", "base_top")], displacements, \
        [Load("bar_top", pressure=press)], of  # fmt: skip


def _roller(draw):
    """A round body on a block, perhaps pushed."""
    wide, press, skin = draw.between(1.2, 2.0), draw.between(0.005, 0.03), ("skin", (0.0, 1.0))
    if draw.half:
        roller = draw.shape("roller", [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0)], [skin, "top", "left"])
    else:
        roller = draw.shape("roller", [(-1.0, 1.0), (0.0, 0.0), (1.0, 1.0)], [skin, skin, "top"])
    push = 0.0 if draw.half else draw.one(0.0, 0.1, 0.3) * press
    displacements = [Displacement("block_bottom", [0.0, 0.0]), Displacement("roller_top", [push, -press])]
    of = ["force:roller", "force:roller.y", "support:block_bottom", "displacement:block_right", "stress:roller_top"]
    shapes = [roller, draw.box("block", -wide, wide, -draw.between(0.8, 1.5), 0.0)]
    materials = [draw.material(3.0 * press, draw.one(1.0, 10.0)), draw.material(3.0 * press)]
    contact = draw.contact("roller_skin", "block_top", "frictionless", "frictionless", "friction")
    return shapes, materials, [contact], displacements, [], of


def _rings(draw):
    """A quarter of two rings, one in the other, under a pressure that is not the same everywhere."""
    radii = draw.between(0.2, 0.5), draw.between(0.6, 0.75), 1.0
    shapes = [draw.shape(name, [(a, 0.0), (b, 0.0), (0.0, b), (0.0, a)],
                         ["low", ("skin", (0.0, 0.0)), "side", ("hole", (0.0, 0.0))])
              for name, a, b in zip(("inner", "outer"), radii[:2], radii[1:], strict=True)]  # fmt: skip
    displacements = [Displacement(f"{name}_{side}", value) for name in ("inner", "outer")
                     for side, value in (("low", [FREE, 0.0]), ("side", [0.0, FREE]))]  # fmt: skip
    pressure = draw.power(3e-3, 3e-2)
    load = Load("inner_hole", pressure=f"{pressure}*(1 + {draw.between(0.0, 1.5)}*x)")
    of = ["force:inner", "force:inner.x", "displacement:outer_skin", "support:outer_low", "stress:outer_hole"]
    return shapes, [draw.material(pressure), draw.material(pressure, draw.one(1.0, 5.0))], \
        [draw.contact("inner_skin", "outer_hole")], displacements, [load], of  # fmt: skip


def _layer(draw):
    """A layer on a block, pressed in its middle; its ends may lift off."""
    thick, wide, pressure = draw.between(0.06, 0.3), draw.between(0.8, 1.5), draw.power(3e-3, 3e-2)
    displacements = [Displacement("block_bottom", [0.0, 0.0])]
    if not draw.half:
        displacements.append(Displacement("layer_left", [0.0, FREE]))
    load = Load("layer_top", pressure=f"{pressure}*exp(-({draw.place()}/{draw.between(0.1, 0.4)})**2)")
    of = ["force:layer", "force:layer.y", "displacement:layer_top", "support:block_bottom", "stress:block_bottom"]
    return [draw.box("layer", -wide, wide, 0.0, thick), draw.box("block", -1.3 * wide, 1.3 * wide, -0.8, 0.0)], \
        [draw.material(pressure, draw.power(1.0, 10.0)), draw.material(pressure)], \
        [draw.contact("layer_bottom", "block_top")], displacements, [load], of  # fmt: skip


def _stack(draw):
    """Blocks one on the other, pressed and sheared."""
    shapes, bottom, press = [], 0.0, draw.between(0.005, 0.02)
    for name in ("low", "mid", "top"):
        high, wide = draw.between(0.2, 0.6), draw.between(0.5, 1.0)
        shapes.append(draw.box(name, -wide, wide, round(bottom, 4), round(bottom + high, 4)))
        bottom += high
    # without its mirror image what is in the middle is held by contact alone
    kinds = () if draw.half else ("friction", "tied", "tied")
    contacts = [draw.contact("mid_bottom", "low_top", *kinds), draw.contact("top_bottom", "mid_top", *kinds)]
    push = 0.0 if draw.half else draw.one(0.1, 0.3) * press
    displacements = [Displacement("low_bottom", [0.0, 0.0]), Displacement("top_top", [push, -press])]
    of = ["force:mid", "force:top.y", "support:top_top", "displacement:mid_right", "stress:low_bottom"]
    return shapes, [draw.material(press / bottom) for _ in shapes], contacts, displacements, [], of


MIRRORED = (_wedge, _roller, _layer, _stack)
FAMILIES = (_beam, _notch, _rings, *MIRRORED)


def drawn(seed):
    """The scene of a seed, an integer: a :class:`Drawn`."""
    draw = _Draw(seed)
    family = draw.one(*FAMILIES)
    kinematics = draw.one("plane_strain", "plane_strain", "plane_stress", "axisymmetric", "axisymmetric")
    draw.half = draw.half and family in MIRRORED
    if kinematics == "axisymmetric" and not draw.half and family is not _rings:
        draw.away = draw.between(1.8, 3.0)
    shapes, materials, contacts, displacements, loads, of = family(draw)
    if draw.half:
        displacements += [Displacement(f"{one.name}_left", [0.0, FREE]) for one in shapes]
    scene = Scene(
        title=f"seed {seed}",
        mesh=MeshSpec("", kinematics=kinematics),
        materials={one.name: material for one, material in zip(shapes, materials, strict=True)},
        bodies=[Body(one.name, one.name) for one in shapes],
        contacts=contacts,
        displacements=displacements,
        loads=loads,
        steps=Steps(count=draw.one(1, 2, 4)),
        output=Output(fields=False),
    )
    curved = any(centre is not None for one in shapes for _, centre in one.edges)
    depth = draw.between(0.2, 0.5) if draw.often(0.4) and kinematics == "plane_strain" else 0.0
    one = Drawn(seed, "", shapes, scene, [], draw.one(*CELLS), draw.one(*SIZES), draw.one(1, 2) if curved else
                draw.one(1, 1, 2), depth, draw.one(0, 1, 2), curved and draw.often(0.4))  # fmt: skip
    if depth and not one.layers:
        one.cells = "triangles"
    one.mirrored = ("left",) if draw.half else ("low", "side") if family is _rings else ()
    one.scene.steps.count = scene.steps.count if one.rests else 1
    one.quantities = ["energy", *sorted(draw.rng.permutation(of)[:2].tolist())]
    words = [family.__name__[1:], "in space" if depth else kinematics.replace("_", " ")]
    words += ["tied" if one.tied else "friction" if one.friction else "frictionless" for one in contacts]
    words += [word for word in ("plastic", "orthotropic") if any(getattr(m, word) for m in materials)]
    words += ["tetrahedra" if depth and not one.layers else one.cells, one.sizes, f"degree {one.order}"]
    one.kind = ", ".join(dict.fromkeys(words + ["geometry"] * one.geometry))
    return one
