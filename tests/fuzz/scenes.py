"""Random scenes: a seed becomes a scene (a dict as in the TOML file) and a mesh, both in units of the order of 1.

A scene is sensible: bodies strain by a few percent at most, every body is held by supports or pressed on something
that is, friction is small enough for one solution. What a scene has is drawn in :func:`scene_of`; `plan`, a dict,
fixes some of the draws (the shrinking and the tests use that).
"""

import copy
import tomllib
from dataclasses import dataclass, field

import features
import numpy as np
from checks import phases_of
from formulas import Formula
from grids import Mesh, block, jittered, joined, read_msh, sectioned

CELLS = {2: ["triangle", "quadrilateral", "mixed"], 3: ["tetrahedron", "hexahedron"]}
FACTORS = (
    None,
    [[0.0, 0.0], [0.5, 1.0], [1.0, 0.5]],
    [[0.0, 0.0], [0.4, 1.0], [0.7, 0.3], [1.0, 1.2]],
    [[0.0, 0.0], [0.25, 0.8], [1.0, 1.0]],
)

# a plan without what readers of their own do not know (independent.py)
PLAIN = {
    **dict.fromkeys(("phased", "springs", "bolt", "heated", "side", "weight.mass", "floor.turns", "inertia"), False),
    **{f"{table}{k}.said": False for table in ("load", "support", "contact") for k in range(5)},
    **{f"{body}.{what}": False for body in ("low", "middle", "high", "body")
       for what in ("orthotropic", "is rubber", "on springs")},
    "floor.expression": False, "strain": "small",
}  # fmt: skip


@dataclass
class Case:
    """A scene and its mesh.

    Attributes
    ----------
    seed : int
    scene : dict
        As in the TOML file; an obstacle of shape "level_set" has the key `of`, the obstacle whose distance it is.
    mesh : Mesh
    length, stress : float
        Size of the bodies, and of Young's modulus, in the scene's units.
    """

    seed: int
    scene: dict
    mesh: Mesh
    length: float = 1.0
    stress: float = 1.0
    tags: set = field(default_factory=set)

    @property
    def dim(self):
        """Dimension of the space."""
        return self.mesh.dim

    @property
    def axial(self):
        """Whether x is a radius."""
        return self.scene["mesh"].get("kinematics") == "axisymmetric"

    @property
    def finite(self):
        """Whether a body has finite strain."""
        return any(part.get("strain") == "finite" for part in (self.scene["mesh"], *self.scene["bodies"]))

    def copy(self):
        """With a scene of its own; the mesh is shared."""
        return Case(self.seed, copy.deepcopy(self.scene), self.mesh, self.length, self.stress, set(self.tags))


class Draw:
    """Named draws from one generator: the plan's value, where it has one.

    Every name has a stream of its own, so that what a plan fixes does not change the others.
    """

    def __init__(self, seed, plan):
        self.seed, self.plan, self.drawn = seed, {} if plan is None else plan, {}

    def rng(self, name):
        """The stream of a name."""
        return np.random.default_rng([self.seed, *name.encode()])

    def one(self, name, options, weights=None):
        """One of some options."""
        p = None if weights is None else np.array(weights) / np.sum(weights)
        value = options[int(self.rng(name).choice(len(options), p=p))]
        self.drawn[name] = self.plan.get(name, value)
        return self.drawn[name]

    def uniform(self, name, low, high):
        """A number between two."""
        self.drawn[name] = self.plan.get(name, float(self.rng(name).uniform(low, high)))
        return self.drawn[name]

    def whole(self, name, low, high):
        """A whole number, both ends included."""
        self.drawn[name] = self.plan.get(name, int(self.rng(name).integers(low, high + 1)))
        return self.drawn[name]

    def chance(self, name, part):
        """True in a part of the draws."""
        self.drawn[name] = self.plan.get(name, bool(self.rng(name).random() < part))
        return self.drawn[name]


# -- bodies ------------------------------------------------------------------------------------------------


def _counts(draw, name, d, cell, fine, section=None):
    """Cubes along the axes: few; an even number across a section."""
    most = {(2, False): 5, (2, True): 3, (3, False): 3, (3, True): 2}[d, fine]
    if cell == "tetrahedron":
        most -= 1
    counts = [draw.whole(f"{name}.n{axis}", 1 if fine else 2, max(most, 1 + (not fine))) for axis in range(d)]
    if d == 3 and not fine:
        counts[1] = min(counts[1], 2)
    if section is not None:
        counts[section] = 2
    return counts


def _body(draw, name, d, low, high, bulges, degree, order, section=None, counts=None):
    """A block between two corners; `bulges`: heights of the middle of the bottom and of the top; `section`: the axis
    of a bolt; `counts`: cubes along the axes.
    """
    cell = draw.one(f"{name}.cell", CELLS[d])
    counts = counts or _counts(draw, name, d, cell, max(degree, order) == 2, section)
    cells = ["triangle", "quadrilateral"] if cell == "mixed" else cell
    if cell == "mixed":
        counts[0] = max(counts[0], 2)
    flip = draw.chance(f"{name}.flip", 0.5)
    mesh = block(name, cells, degree, counts, flip=(lambda cube: sum(cube) % 2 == 1) if flip and d == 2 else None)
    if section is None:
        jittered(mesh, counts, draw.rng(f"{name}.jitter"), draw.one(f"{name}.jitter", [0.0, 0.2]))
    else:
        sectioned(mesh, name, section)
    grade = draw.one(f"{name}.grade", [0.0, 0.3])
    s = mesh.points
    s[:, : d - 1] = s[:, : d - 1] + grade * s[:, : d - 1] * (1.0 - s[:, : d - 1])
    return _placed(mesh, low, high, bulges, draw.drawn.get("axis", False))


def _placed(mesh, low, high, bulges, axis=False):
    """Reference points to the box, and its bottom and top bulged; around the axis x = 0 where the body is there."""
    s, low, high = mesh.points, np.array(low), np.array(high)
    middle = np.array([0.0 if axis else 0.5])
    bump = np.ones(len(s))
    for k in range(mesh.dim - 1):
        bump -= (s[:, k] - (middle if k == 0 else 0.5)) ** 2 * (1.0 if axis else 4.0) / (mesh.dim - 1)
    x = low + s * (high - low)
    x[:, -1] += (1.0 - s[:, -1]) * bulges[0] * (1.0 - bump) + s[:, -1] * bulges[1] * (bump - 1.0)
    mesh.points = x
    return mesh


def _material(draw, name, cells, order, drive, where):
    """Elastic, or one that yields; what locks is left out. `where`: dimension, and whether x is a radius."""
    nu = draw.uniform(f"{name}.nu", 0.0, 0.4)
    tensor = cells in ("quadrilateral", "hexahedron")
    if draw.chance(f"{name}.orthotropic", 0.12):
        return features.orthotropic(draw, name, *where, draw.one(f"{name}.E", [1.0, 1.0, 3.0, 10.0]))
    if draw.chance(f"{name}.stiff volume", 0.1) and (tensor or order == 2):
        nu = 0.49
    if draw.chance(f"{name}.auxetic", 0.05):
        nu = -0.3
    E = draw.one(f"{name}.E", [1.0, 1.0, 3.0, 0.3, 10.0])
    table = {"E": E, "nu": nu}
    if draw.chance(f"{name}.is rubber", 0.15):
        table["law"] = "rubber"
    elif draw.chance(f"{name}.yields", 0.3):
        table.update(_plasticity(draw, name, E, drive))
    return table


def _plasticity(draw, name, E, drive):
    y = E * draw.uniform(f"{name}.yield", 0.006, 0.02)
    kinds = ["isotropic", "kinematic", "both", "curve", "curve and kinematic"]
    kind = draw.one(f"{name}.hardening", [*kinds, "perfect"] if drive == "moved" else kinds)
    table = {}
    if "curve" in kind:
        table["hardening_curve"] = [[0.0, y], [0.01, 1.3 * y], [0.05, 1.3 * y + 0.01 * E], [10.0, 1.3 * y + 2.0 * E]]
    else:
        table["yield_stress"] = y
    if kind in ("isotropic", "both"):
        table["hardening"] = E * draw.one(f"{name}.H", [0.05, 0.3])
    if "kinematic" in kind or kind == "both":
        table["kinematic_hardening"] = E * draw.one(f"{name}.K", [0.05, 0.3])
    return table


# -- contacts ----------------------------------------------------------------------------------------------


def _law(draw, name):
    """Keys of a law of friction."""
    law = draw.one(f"{name}.law", ["none", "coulomb", "capped", "adhesion", "tresca"], [35, 30, 10, 10, 15])
    if law == "none":
        return {}
    if law == "tresca":
        return {"tresca": draw.uniform(f"{name}.tresca", 0.0005, 0.005)}
    keys = {"friction": draw.uniform(f"{name}.friction", 0.05, 0.6)}
    if law == "capped":
        keys["friction_limit"] = draw.uniform(f"{name}.limit", 0.0005, 0.005)
    if law == "adhesion":
        keys["adhesion"] = draw.uniform(f"{name}.adhesion", 0.0005, 0.003)
    return keys


def _numerics(draw, name, d, order, obstacle=False, several=False):
    """Keys of the formulation and the search."""
    keys = {}
    kind = draw.one(f"{name}.formulation", ["nitsche", "penalty", "augmented_lagrangian"], [65, 20, 15])
    if kind != "nitsche":
        keys["formulation"] = kind
    elif not several:
        keys["theta"] = draw.one(f"{name}.theta", [1, 0, -1])
        if keys["theta"] and draw.chance(f"{name}.consistent", 0.3):
            keys["adjoint"] = "consistent"
    if draw.chance(f"{name}.gamma0 said", 0.2):
        # from the bound of coercivity of every variant on
        keys["gamma0"] = draw.one(f"{name}.gamma0", [2.0, 10.0, 100.0])
    if draw.chance(f"{name}.alpha said", 0.1):
        keys["alpha"] = draw.one(f"{name}.alpha", [0.5, 2.0])
    if draw.chance(f"{name}.quadrature said", 0.2):
        keys["quadrature"] = draw.whole(f"{name}.quadrature", 2 * order + 1, 8)
    if not obstacle:
        if draw.chance(f"{name}.ray", 0.25):
            keys["search"] = "ray_tracing"
        cut = draw.one(f"{name}.cut", [None, True, False], [60, 20, 20])
        if cut is not None:
            keys["cut"] = cut
    return keys


def _obstacle(draw, name, d, where, low=True):
    """A rigid body under (`low`) a bottom whose middle is at `where`, that touches it there."""
    sign = 1.0 if low else -1.0
    shapes = ["plane", "sphere", "inside", "level_set"] + (["cylinder"] if d == 3 else [])
    shape, up, at = draw.one(f"{name}.shape", shapes), np.eye(d)[-1], np.array(where)
    radius = draw.uniform(f"{name}.radius", 1.0, 3.0)
    table = {"shape": "plane", "point": at.tolist(), "normal": (sign * up).tolist()}
    if shape == "cylinder":
        axis = [1.0, draw.uniform(f"{name}.axis", -0.5, 0.5), 0.0]
        point = (at - sign * radius * up).tolist()
        table = {"shape": "cylinder", "point": point, "axis": axis, "radius": radius}
    elif shape in ("sphere", "level_set"):
        table = {"shape": "sphere", "center": (at - sign * radius * up).tolist(), "radius": radius}
    elif shape == "inside":
        table = {"shape": "sphere", "center": (at + sign * radius * up).tolist(), "radius": radius, "inside": True}
    if shape == "level_set" and draw.chance(f"{name}.expression", 0.5):
        squares = " + ".join(f"({x} - {c!r})**2" for x, c in zip("xyz", table["center"], strict=False))
        table = {"shape": "level_set", "expression": Formula.of(f"sqrt({squares}) - {radius!r}", d)}
    elif shape == "level_set":
        table = {"shape": "level_set", "of": table}
        if draw.chance(f"{name}.gradient", 0.5):
            table["gradient"] = True
    return table


def _moving(draw, table, name, d, value, end, axial=False, pivot=None):
    """An obstacle that moves, and may turn."""
    table.update({"displacement": value, **_factor(draw, name, end)})
    if axial or not draw.chance(f"{name}.turns", 0.5):
        return
    round_ = table["shape"] in ("sphere", "cylinder")
    table["angle"] = draw.uniform(f"{name}.angle", -8.0, 8.0) * (1.0 if round_ else 0.1)
    if table["shape"] == "level_set":
        table["pivot"] = pivot
    if d == 3 and table["shape"] != "cylinder":
        table["turn_axis"] = [0.3, 1.0, 0.1]


# -- scenes ------------------------------------------------------------------------------------------------


def _factor(draw, name, end):
    """An amplitude, or none."""
    rows = draw.one(f"{name}.amplitude", FACTORS)
    return {} if rows is None else {"amplitude": [[t * end, f] for t, f in rows]}


def _driven(draw, scene, name, d, depth, end, flat, area):
    """What moves or loads the top of a body (`area`); says which. `flat`: its bottom is."""
    side, axial = f"{name}_{'xyz'[d - 1]}1", scene["mesh"].get("kinematics") == "axisymmetric"
    drives = ["moved", "split", "pressed", "pulled along", "coupled", "averaged", "forced"]
    drive = draw.one("drive", drives, [30, 15, 20, 10, 10, 8, 7])
    shear = [0.0] * (d - 1) if axial or draw.chance("no shear", 0.4) else [
        depth * draw.uniform(f"shear{k}", -1.0, 1.0) for k in range(d - 1)
    ]  # fmt: skip
    if drive == "moved":
        scene["displacements"].append({"region": side, "value": [*shear, -depth], **_factor(draw, "press", end)})
        return "moved"
    if drive == "split":
        scene["displacements"] += [
            {"region": side, "value": [*["free"] * (d - 1), -depth], **_factor(draw, "press", end)},
            {"region": side, "value": [*shear, "free"], **_factor(draw, "shear", end)},
        ]
        return "moved"
    if drive in ("coupled", "averaged"):
        table = features.coupling(draw, scene, side, d, [*shear, -depth], flat)
        table.update({**_factor(draw, "press", end), **({"average": True} if drive == "averaged" else {})})
        return "moved"
    if drive == "forced":
        features.coupling(draw, scene, side, d, [*[0.0] * (d - 1), "free"], False)
        force = [*[0.0] * (d - 1), -area * depth * draw.uniform("load", 0.3, 1.0)]
        scene["loads"].append({"name": "push", "region": side, "force": force, **_factor(draw, "press", end)})
        return "loaded"
    _rollers(scene, name, d, axial)
    # what presses never lets go
    load, pushed = {"region": side}, draw.uniform("load", 0.3, 1.0) * depth
    if drive == "pressed":
        load["pressure"] = pushed
    else:
        load["traction"] = [*[0.2 * pushed] * (d - 1), -pushed]
    scene["loads"].append({**load, **_factor(draw, "press", end)})
    return "loaded"


def _rollers(scene, name, d, axial):
    """A body in the middle of a stack keeps its place sideways and does not turn."""
    for k in range(d - 1):
        if not (axial and k == 0):
            value = ["free"] * d
            value[k] = 0.0
            scene["displacements"].append({"region": f"{name}_{'xyz'[k]}0", "value": value})


def _empty(draw, d, order, kinds=("plane_strain", "plane_stress", "axisymmetric")):
    end = draw.one("end", [1.0, 1.0, 3.5])
    scene = {
        "mesh": {"file": "mesh.msh", "order": order},
        "materials": {}, "bodies": [], "contacts": [], "displacements": [], "loads": [],
        "steps": {"end": end, "count": draw.whole("count", 1, 5)},
        "output": {"fields": False, "probes": []},
    }  # fmt: skip
    if d == 2:
        kinematics = draw.one("kinematics", list(kinds), [60, 20, 20][: len(kinds)])
        if kinematics != "plane_strain" or draw.chance("kinematics said", 0.2):
            scene["mesh"]["kinematics"] = kinematics
    return scene, end


def _stack(draw, d, degree, order):
    """Blocks on one another, the lowest one on its support or on an obstacle, the uppermost one driven."""
    scene, end = _empty(draw, d, order)
    axial = scene["mesh"].get("kinematics") == "axisymmetric"
    n = draw.one("bodies", [1, 2, 3], [20, 65, 15])
    floor = n == 1 or draw.chance("floor", 0.2)
    depth = draw.uniform("depth", 0.01, 0.04)
    inner = draw.one("inner radius", [0.0, 0.7]) if axial else draw.uniform("place", -0.3, 0.3)
    draw.drawn["axis"] = axial and inner == 0.0
    names, meshes, level, tops = ["low", "middle", "high"][:n], [], 0.0, []
    bolted = names[-1] if not axial and draw.chance("bolt", 0.12) else None
    options = ["pair", "unbiased", "all", "tied", "bilateral"]
    kinds = [draw.one(f"kind{k}", options, [45, 15, 15, 13, 12]) for k in range(n)]
    one = kinds[0] == "all"
    for k, name in enumerate(names):
        gap, width = 0.0, 1.0 if k == 0 else draw.one(f"{name}.width", [1.0, 0.7, 0.5])
        if k:
            where = draw.one(f"gap{k}", ["none", "open", "overlap"], [60, 20, 20])
            gap = {"none": 0.0, "open": 0.3 * depth, "overlap": -0.3 * depth}[where]
            if not one and kinds[k] in ("tied", "bilateral"):
                gap = 0.0
        curved = draw.one(f"{name}.curved", [(0, 0), (1, 0), (0, 1)], [50, 30, 20])
        bulges = [0.1 * curved[0] * (k > 0 or floor), 0.1 * curved[1] * (k < n - 1)]
        if name == bolted:
            bulges = [0.0, 0.0]
        start = inner if axial else inner + 0.5 * (1.0 - width) + (draw.uniform(f"{name}.off", -0.2, 0.2) if k else 0.0)
        low = [start, *[0.5 * (1.0 - width)] * (d - 2), level + gap]
        high = [start + width, *[0.5 * (1.0 + width)] * (d - 2), level + gap + draw.one(f"{name}.height", [0.6, 1.0])]
        section = d - 1 if name == bolted else None
        meshes.append(_body(draw, name, d, low, high, bulges, degree, order, section))
        level = high[-1]
        scene["bodies"].append({"region": name, "material": name})
        tops.append((low, high))
    area = _area(*tops[-1], axial)
    drive = _driven(draw, scene, names[-1], d, depth, end, not bulges[0], area)
    for name in names:
        cells = draw.drawn[f"{name}.cell"]
        scene["materials"][name] = _material(draw, name, cells, order, drive, (d, axial))
    _eased(scene, area)
    # contact of all surfaces would hold the two sides of the section
    if bolted and not one and draw.drawn["drive"] not in ("pulled along", "pressed"):
        features.bolt(draw, scene, bolted, d, depth, drive)
    vertical = "xyz"[d - 1]
    loose = names[:-1] if floor else names[1:-1]
    if not floor and draw.chance("springs", 0.15):
        features.springs(draw, scene, f"low_{vertical}0", d, draw.uniform("low.spring", 1.0, 5.0), "low")
    elif not floor:
        scene["displacements"].append({"region": f"low_{vertical}0", "value": [0.0] * d})
    for name in loose:
        if draw.chance(f"{name}.on springs", 0.12):
            features.springs(draw, scene, f"{name}_x0", d, draw.uniform(f"{name}.spring", 0.3, 2.0), name)
        else:
            _rollers(scene, name, d, axial)
    if one and n > 1:
        numerics = _numerics(draw, "all", d, order, several=floor)
        scene["contacts"].append({"all": True, **_law(draw, "all"), **numerics})
    for k in range(1, n):
        if not one:
            surfaces = f"{names[k]}_{vertical}0", f"{names[k - 1]}_{vertical}1"
            scene["contacts"].append(_pair(draw, kinds[k], *surfaces, d, order, k))
    if floor:
        low, high = tops[0]
        middle = [0.5 * (a + b) for a, b in zip(low, high, strict=True)][:-1]
        if axial:
            middle = [0.0]
        table = _obstacle(draw, "floor", d, [*middle, 0.0])
        if axial and inner > 0.0 and table["shape"] != "plane":
            # a ball around the axis does not reach a ring at its highest point
            table = {"shape": "plane", "point": [0.0, 0.0], "normal": [0.0, 1.0]}
        if draw.chance("floor.moves", 0.3):
            up = [*[0.0] * (d - 1), 0.3 * depth]
            _moving(draw, table, "floor", d, up, end, axial, [*middle, -1.0])
        contact = {"name": "floor", "source": f"low_{vertical}0", "obstacle": table, **_law(draw, "floor")}
        several = bool(scene["contacts"])
        contact.update(_numerics(draw, "floor", d, order, obstacle=True, several=several))
        if one and draw.chance("floor.all", 0.5):
            del contact["source"]
            contact["all"] = True
        scene["contacts"].append(contact)
    scene["output"]["probes"] = [f"{names[-1]}_{vertical}1", f"{names[-1]}_{vertical}0", f"{names[0]}_corner"]
    if draw.chance("weight", 0.2):
        force = [0.0] * (d - 1) + [-0.1 * depth]
        if draw.chance("weight.mass", 0.4):
            for material in scene["materials"].values():
                material["density"] = 1.0
            scene["loads"].append({"region": names[0], "acceleration": force, **_factor(draw, "weight", end)})
        else:
            scene["loads"].append({"region": names[0], "body_force": force, **_factor(draw, "weight", end)})
    if draw.chance("side", 0.1) and not axial and not floor:
        features.pushed_sideways(draw, scene, names[0], d, depth, end)
    if draw.chance("phased", 0.2):
        features.phases(draw, scene, names, d, depth, n == 2 and not floor and drive == "moved")
    return scene, joined(meshes)


def _area(low, high, axial):
    """Of a block's top, in space, per thickness, or on the whole circumference."""
    if axial:
        return float(np.pi * (high[0] ** 2 - low[0] ** 2))
    return float(np.prod(np.array(high[:-1]) - np.array(low[:-1])))


def _eased(scene, area):
    """Loads that the softest body bears, and that stay near the yield stress of the weakest."""
    materials = scene["materials"].values()
    most = min(np.min(m["E"]) for m in materials)
    yields = [m.get("yield_stress") or m["hardening_curve"][0][1] for m in materials
              if {"yield_stress", "hardening_curve"} & m.keys()]  # fmt: skip
    for load in scene["loads"]:
        pushed = abs(load["pressure"] if "pressure" in load else load["traction"][-1] if "traction" in load
                     else load["force"][-1] / area)  # fmt: skip
        factor = float(min([most, *[1.2 * y / pushed for y in yields]]))
        for key in set(load) & {"pressure", "traction", "force"}:
            value = load[key]
            load[key] = [factor * v for v in value] if isinstance(value, list) else factor * value


def _pair(draw, kind, source, target, d, order, k):
    """Two surfaces."""
    contact = {"name": f"pair {k}", "source": source, "target": target}
    if draw.chance(f"pair{k}.swap", 0.4):
        contact.update(source=target, target=source)
    numerics = _numerics(draw, f"pair{k}", d, order)
    if kind == "tied":
        return {**contact, "tied": True, **numerics}
    contact.update(_law(draw, f"pair{k}"))
    contact.update(numerics)
    if kind in ("unbiased", "bilateral"):
        contact[kind] = True
    if draw.chance(f"pair{k}.adjust", 0.3):
        contact["interference"] = "adjust"
    return contact


def _slot(draw, d, degree, order):
    """A body with a slot that closes on itself: self contact, or contact of all surfaces with it."""
    scene, end = _empty(draw, d, order)
    axial = scene["mesh"].get("kinematics") == "axisymmetric"
    cell = draw.one("body.cell", CELLS[d][:2])
    fine = max(degree, order) == 2
    across = draw.whole("body.n0", 2, 3 if fine or d == 3 else 5)
    counts = [across, *[1] * (d - 2), 3]
    mesh = block("body", cell, degree, counts, keep=lambda cube: cube[-1] != 1 or cube[0] == 0)
    jittered(mesh, counts, draw.rng("body.jitter"), draw.one("body.jitter", [0.0, 0.15]))
    opening = draw.uniform("opening", 0.02, 0.04)
    levels = [0.0, 0.4, 0.4 + opening, 0.8 + opening]
    s = mesh.points
    s[:, -1] = np.interp(s[:, -1], [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0], levels)
    s[:, 0] += 0.5 if axial else 0.0
    up = "xyz"[d - 1]
    scene["bodies"].append({"region": "body", "material": "body"})
    scene["materials"]["body"] = _material(draw, "body", cell, order, "moved", (d, axial))
    scene["displacements"] += [
        {"region": f"body_{up}0", "value": [0.0] * d},
        {"region": f"body_{up}1", "value": [*[0.0] * (d - 1), -opening * draw.uniform("close", 1.1, 1.6)],
         **_factor(draw, "press", end)},
    ]  # fmt: skip
    numerics = _numerics(draw, "slot", d, order)
    if draw.chance("all", 0.4):
        contact = {"all": True, "self_contact": True}
    else:
        contact = {"name": "slot", "source": "body_inner", "target": "body_inner"}
    scene["contacts"].append({**contact, "search_radius": 2.0 * opening, **_law(draw, "slot"), **numerics})
    scene["output"]["probes"] = [f"body_{up}1", "body_x1", "body_corner"]
    return scene, mesh


def _flight(draw, d, degree, order):
    """A body in free flight, which hits another one that nothing holds, or an obstacle."""
    scene, end = _empty(draw, d, order)
    axial = scene["mesh"].get("kinematics") == "axisymmetric"
    n, gap = draw.one("bodies", [1, 2], [30, 70]), draw.uniform("gap", 0.005, 0.02)
    draw.drawn["axis"] = axial
    start, bulge, meshes, level = 0.0 if axial else -0.5, draw.one("bulge", [0.0, 0.1]), [], 0.0
    for k, name in enumerate(("low", "middle")[:n]):
        width = 1.0 if k == 0 else draw.one(f"{name}.width", [1.0, 0.6])
        low = [start * width, *[-0.5 * width] * (d - 2), level]
        high = [(1.0 + start) * width, *[0.5 * width] * (d - 2), level + draw.one(f"{name}.height", [0.6, 1.0])]
        meshes.append(_body(draw, name, d, low, high, [bulge * (k == n - 1), 0.0], degree, order))
        level = high[-1] + gap
        scene["bodies"].append({"region": name, "material": name})
        scene["materials"][name] = _material(draw, name, draw.drawn[f"{name}.cell"], order, "moved", (d, axial))
    up = features.UP[d]
    if n == 2:
        kind = draw.one("kind1", ["pair", "unbiased"])
        contact = _pair(draw, kind, f"middle_{up}0", f"low_{up}1", d, order, 1)
        contact.pop("interference", None)
    else:
        table = _obstacle(draw, "floor", d, [*[0.0] * (d - 1), -gap])
        contact = {"name": "floor", "source": f"low_{up}0", "obstacle": table, **_law(draw, "floor")}
        contact.update(_numerics(draw, "floor", d, order, obstacle=True))
    # multipliers of the last load step are no beginning of an impact
    if contact.get("formulation") == "augmented_lagrangian":
        del contact["formulation"]
    scene["contacts"].append(contact)
    scene["output"]["probes"] = [f"low_{up}1", "low_corner"]
    return scene, joined(meshes)


def _flies(draw, scene, d, end):
    """The velocity of the body that hits the other one, with some spin."""
    # what damping takes up does not keep it from getting there
    slowed = 1.0 + end * scene["bodies"][-1].get("mass_damping", 0.0)
    speed = draw.uniform("speed", 1.5, 4.0) * draw.drawn["gap"] / end * slowed
    velocity = [*[0.0] * (d - 1), -speed]
    if scene["mesh"].get("kinematics") != "axisymmetric":
        along, spin = speed * draw.uniform("along", -0.5, 0.5), 0.5 * speed * draw.one("spin", [0.0, 1.0, -1.0])
        velocity[0] = features.Formula.of(f"{along!r} + {spin!r}*{features.UP[d]}", d) if spin else along
        velocity[-1] = features.Formula.of(f"{-speed!r} - {spin!r}*x", d) if spin else -speed
    scene["bodies"][-1]["initial_velocity"] = velocity


# -- bodies that go far --------------------------------------------------------------------------------------


def _plank(draw, d, degree, order, most):
    """A scene with a body that is held at its bottom, long enough to go along; its mesh, its box, depth and end."""
    scene, end = _empty(draw, d, order, ["plane_strain", "plane_stress"])
    scene["steps"]["count"] = draw.whole("steps", 1, most)
    depth = draw.uniform("depth", 0.01, 0.03)
    high = [2.0, *[1.0] * (d - 2), draw.one("low.height", [0.5, 0.8])]
    curved = draw.one("low.curved", [(0, 0), (0, 1)])
    counts = [draw.whole("low.n0", 2, 4 if d == 3 else 6), *[1] * (d - 2), draw.whole("low.n1", 1, 2)]
    counts[0] += counts[0] % 2 * curved[1]  # a node where it is highest
    mesh = _body(draw, "low", d, [0.0] * d, high, [0.0, 0.1 * curved[1]], degree, order, counts=counts)
    # as high as its highest node
    high[-1] = float(mesh.points[:, -1].max())
    scene["bodies"].append({"region": "low", "material": "low"})
    scene["displacements"].append({"region": f"low_{features.UP[d]}0", "value": [0.0] * d})
    scene["output"]["probes"] = [f"low_{features.UP[d]}1"]
    return scene, mesh, high, depth, end


def _upper(draw, scene, d, degree, order, low, width, bulge):
    """A body above a plank, its lowest corner at `low`."""
    high = [a + b for a, b in zip(low, [width, *[0.6] * (d - 2), draw.one("middle.height", [0.3, 0.6])], strict=True)]
    # a node where a curved bottom is lowest
    counts = [2 if bulge else draw.whole("middle.n0", 1, 3), *[1] * (d - 2), draw.whole("middle.n1", 1, 2)]
    mesh = _body(draw, "middle", d, low, high, [bulge, 0.0], degree, order, counts=counts)
    mesh.points[:, -1] += low[-1] - mesh.points[:, -1].min()
    scene["bodies"].append({"region": "middle", "material": "middle"})
    scene["output"]["probes"].append("middle_corner")
    return mesh


def _materials(draw, scene, d, order, drive="moved"):
    for body in scene["bodies"]:
        name = body["region"]
        scene["materials"][name] = _material(draw, name, draw.drawn[f"{name}.cell"], order, drive, (d, False))


def _across(draw, scene, d, order, several=False):
    """The contact of the two bodies; surfaces that go far."""
    kind = draw.one("kind1", ["pair", "unbiased", "all"], [60, 25, 15])
    numerics = _numerics(draw, "pair1", d, order)
    if kind == "all":
        contact = {"name": "all", "all": True, **_law(draw, "pair1"), **numerics}
    else:
        up = features.UP[d]
        contact = _pair(draw, kind, f"middle_{up}0", f"low_{up}1", d, order, 1)
        contact.pop("interference", None)
    scene["contacts"].append(contact)


def _slide(draw, d, degree, order):
    """A short body that is pressed on a plank and goes along it, its corners over many facets or over the end."""
    scene, mesh, top, depth, end = _plank(draw, d, degree, order, 8)
    up = features.UP[d]
    width, bulge = draw.one("middle.width", [0.4, 0.7]), 0.1 * draw.chance("middle.bulge", 0.3)
    other = _upper(draw, scene, d, degree, order, [0.1, *[0.2] * (d - 2), top[-1]], width, bulge)
    _materials(draw, scene, d, order)
    way = draw.uniform("way", 0.3, 1.9 - width) if draw.chance("stays on", 0.7) else draw.uniform("way", 1.5, 1.8)
    press, go = [[0.0, 0.0], [0.25 * end, 1.0]], [[0.25 * end, 0.0], [end, 1.0]]
    along = [way, *[draw.one("slant", [0.0, 0.1])] * (d - 2), "free"]
    scene["displacements"] += [
        {"region": f"middle_{up}1", "value": [*["free"] * (d - 1), -depth], "amplitude": press},
        {"region": f"middle_{up}1", "value": along, "amplitude": go},
    ]
    _across(draw, scene, d, order)
    return scene, joined([mesh, other])


def _pass(draw, d, degree, order):
    """A body that goes by above another one, without touching it or over its bump."""
    scene, mesh, top, depth, end = _plank(draw, d, degree, order, 8)
    up, touches = features.UP[d], draw.chance("touches", 0.5)
    # both are highest in the middle, where they meet
    gap = -0.5 * depth if touches else draw.uniform("clear", 0.02, 0.1)
    width = draw.one("middle.width", [0.4, 0.7])
    other = _upper(draw, scene, d, degree, order, [-width - 0.3, *[0.2] * (d - 2), top[-1] + gap], width, 0.05)
    _materials(draw, scene, d, order)
    way = 2.6 + width if draw.chance("all the way", 0.7) else draw.uniform("way", 0.5, 2.5)
    value = [way, *[0.0] * (d - 1)]
    if draw.chance("as a tool", 0.4):
        scene["displacements"].append({"region": "middle", "value": value})
    else:
        scene["displacements"].append({"region": f"middle_{up}1", "value": value})
    _across(draw, scene, d, order)
    return scene, joined([mesh, other])


def _tool(draw, d, degree, order):
    """A meshed body, all of whose nodes are prescribed, that comes down on another one from a distance."""
    scene, mesh, top, depth, end = _plank(draw, d, degree, order, 5)
    gap = draw.one("gap", [0.0, 0.5 * depth, 3.0 * depth, 10.0 * depth])
    width = draw.one("middle.width", [0.4, 0.7])
    bulge = 0.1 * draw.chance("middle.bulge", 0.6)
    other = _upper(draw, scene, d, degree, order, [0.7, *[0.2] * (d - 2), top[-1] + gap], width, bulge)
    _materials(draw, scene, d, order)
    value = [draw.one("aside", [0.0, 0.5]) * depth, *[0.0] * (d - 2), -gap - depth]
    table = {"region": "middle", "value": value, **_factor(draw, "press", end)}
    if draw.chance("turns", 0.3):
        table.update(angle=draw.uniform("turn", -1.5, 1.5), point=[1.0, *[0.5] * (d - 2), top[-1] + gap])
        if d == 3:
            table["axis"] = [0.1, 1.0, 0.0]
    scene["displacements"].append(table)
    _across(draw, scene, d, order)
    return scene, joined([mesh, other])


def _press(draw, d, degree, order):
    """A rigid body above a plank, that comes down, goes along and turns."""
    scene, mesh, top, depth, end = _plank(draw, d, degree, order, 5)
    up, at = np.eye(d)[-1], [draw.uniform("at", 0.7, 1.3), *[0.5] * (d - 2), top[-1]]
    gap = draw.one("gap", [0.0, 0.5 * depth, 3.0 * depth])
    at[-1] += gap
    shape = draw.one("tool", ["round", "punch", "wedge"] + (["cone", "torus"] if d == 3 else []))
    table = {"shape": shape, "point": at, "normal": (-up).tolist()}
    if shape == "round":
        table = _obstacle(draw, "tool", d, at, low=False)
    elif shape == "punch":
        table.update({"width": 0.6, "edge_radius": 0.15, **({"axis": [0.0, 1.0, 0.0]} if d == 3 else {})})
    elif shape == "wedge":
        table.update({"half_angle": 70.0, "edge_radius": 0.3, **({"axis": [0.0, 1.0, 0.0]} if d == 3 else {})})
    elif shape == "cone":
        table.update(half_angle=70.0, edge_radius=0.3)
    elif shape == "torus":
        center = (np.array(at) + [0.0, 0.0, 0.7]).tolist()
        table = {"shape": "torus", "center": center, "axis": [0.0, 1.0, 0.0], "ring_radius": 0.5, "radius": 0.2}
    along = draw.one("way", [0.0, 0.1, 0.5])
    pivot = [*at[:-1], at[-1] + 1.0]
    _moving(draw, table, "tool", d, [along, *[0.0] * (d - 2), -gap - depth], end, pivot=pivot)
    _materials(draw, scene, d, order)
    contact = {"name": "tool", "source": f"low_{features.UP[d]}1", "obstacle": table, **_law(draw, "tool")}
    contact.update(_numerics(draw, "tool", d, order, obstacle=True))
    scene["contacts"].append(contact)
    return scene, mesh


def scene_of(seed, plan=None):
    """The random scene of a seed.

    Parameters
    ----------
    seed : int
    plan : dict of str to value, optional
        Draws that are fixed, by name.

    Returns
    -------
    Case
        In units of the order of 1.
    """
    draw = Draw(seed, plan)
    d = draw.one("dim", [2, 3], [60, 40])
    degree, order = draw.one("degree", [1, 2], [70, 30]), draw.one("order", [1, 2], [65, 35])
    makes = {"stack": _stack, "slot": _slot, "slide": _slide, "pass": _pass, "tool": _tool, "press": _press}
    make = draw.one("arrangement", list(makes), [55, 9, 10, 8, 10, 8])
    moves = draw.chance("inertia", 0.15)
    flies = moves and draw.chance("flight", 0.35)
    scene, mesh = (_flight if flies else makes[make])(draw, d, degree, order)
    if draw.chance("mean", 0.15) and scene["mesh"].get("kinematics") != "plane_stress":
        scene["mesh"]["mean_dilatation"] = draw.chance("mean.value", 0.5)
    _strained(draw, scene)
    end = phases_of(scene)[-1][2]
    features.said_as_formulas(draw, scene, d, end)
    case = Case(seed, scene, mesh)
    _sensible(case, draw)
    if not case.finite and draw.chance("heated", 0.12):
        features.heated(draw, scene, d, end)
        _cooled(scene)
    if moves:
        features.inertia(draw, scene, d, draw.drawn["gap" if flies else "opening" if make == "slot" else "depth"], end,
                         case.finite)  # fmt: skip
    if flies:
        _flies(draw, scene, d, end)
    for key in ("contacts", "displacements", "loads"):
        if not scene[key]:
            del scene[key]
    return case


def _begins_late(scene):
    """Whether a body begins after the first phase."""
    return any(body.get("phases", ["p0"])[0] != "p0" for body in scene["bodies"])


def _strained(draw, scene):
    """Finite strain of all bodies, or of some of them, where all else that is there allows it."""
    kind = draw.one("strain", ["small", "finite", "both"], [60, 28, 12])
    if any(isinstance(m["E"], list) for m in scene["materials"].values()) or scene.get("pretensions"):
        kind = "small"
    if _begins_late(scene):
        kind = "small"
    if kind == "finite":
        scene["mesh"]["strain"] = "finite"
    elif kind == "both":
        for number, body in enumerate(scene["bodies"]):
            body["strain"] = ["finite", "small"][number % 2]


def _cooled(scene):
    """Temperatures of bodies that yield in plane stress are refused."""
    yields = any({"yield_stress", "hardening_curve"} & m.keys() for m in scene["materials"].values())
    if scene["mesh"].get("kinematics") == "plane_stress" and yields:
        del scene["temperatures"]


def _sensible(case, draw):
    """Keys that exclude each other."""
    scene = case.scene
    if case.finite:
        # curved facets of pairs that move need their nodes in the middle
        scene["mesh"]["order"] = max(scene["mesh"]["order"], draw.drawn["degree"])
        for table in scene.get("couplings", []):
            if "rotation" in table:
                table["rotation"] = 0.0 if case.dim == 2 else [0.0] * 3
    if any(isinstance(m["E"], list) for m in scene["materials"].values()):
        scene["mesh"].pop("mean_dilatation", None)
    for body in scene["bodies"]:
        cells = {e.cell for e in case.mesh.bodies[body["region"]]}
        material, name = scene["materials"][body["material"]], body["material"]
        if cells & {"triangle", "tetrahedron"} and scene["mesh"]["order"] == 1 and not isinstance(material["nu"], list):
            material["nu"] = min(material["nu"], 0.4)
        if material.get("law") == "rubber":
            finite = "finite" in (scene["mesh"].get("strain"), body.get("strain"))
            if finite and scene["mesh"].get("kinematics") != "plane_stress":
                scene["materials"][name] = {**features.rubber(draw, name, material),
                                            **{k: material[k] for k in ("density",) if k in material}}  # fmt: skip
            else:
                del material["law"]
    for contact in scene.get("contacts", []):
        if contact.get("cut") is False and case.dim == 3:
            # a coarse source on a fine target is refused
            del contact["cut"]
        if not any(m.get("yield_stress") or m.get("hardening_curve") for m in scene["materials"].values()):
            contact.pop("adjoint", None)


# -- writing -----------------------------------------------------------------------------------------------


def toml(value):
    """A value in TOML."""
    if isinstance(value, Formula):
        return f'"{value.text()}"'
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        keys = {key: key if key.isidentifier() else f'"{key}"' for key in value}
        return "{ " + ", ".join(f"{keys[key]} = {toml(part)}" for key, part in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(value)


LEVEL_SET = '''\
"""Distances of obstacles."""
import numpy as np
{parts}
'''
OF_PLANE = '''
def phi{k}(x, t):
    return (x - np.array({point})) @ np.array({normal}) / np.linalg.norm({normal})

def phi{k}_gradient(x, t):
    return np.tile(np.array({normal}) / np.linalg.norm({normal}), (len(x), 1))
'''
OF_SPHERE = '''
def phi{k}(x, t):
    return {sign} * (np.linalg.norm(x - np.array({center}), axis=1) - {radius})

def phi{k}_gradient(x, t):
    y = x - np.array({center})
    return {sign} * y / np.linalg.norm(y, axis=1)[:, None]
'''


def _functions(number, of):
    if of["shape"] == "plane":
        return OF_PLANE.format(k=number, point=of["point"], normal=of["normal"])
    sign = -1.0 if of.get("inside") else 1.0
    return OF_SPHERE.format(k=number, sign=sign, center=of["center"], radius=of["radius"])


def texts(case):
    """Names and contents of the files of a scene but for its mesh."""
    lines, functions = [], []
    for key, value in case.scene.items():
        if not isinstance(value, (dict, list)):
            lines.append(f"{key} = {toml(value)}")
    for key, value in case.scene.items():
        if key == "materials":
            for name, table in value.items():
                lines += ["", f"[materials.{name}]", *[f"{k} = {toml(v)}" for k, v in table.items()]]
        elif isinstance(value, dict):
            lines += ["", f"[{key}]", *[f"{k} = {toml(v)}" for k, v in value.items()]]
        elif isinstance(value, list):
            for number, table in enumerate(value):
                table = dict(table)
                obstacle = dict(table.pop("obstacle", {}))
                if "of" in obstacle:
                    functions.append(_functions(number, obstacle.pop("of")))
                    obstacle["function"] = f"functions.py:phi{number}"
                    if obstacle.pop("gradient", False):
                        obstacle["gradient"] = f"functions.py:phi{number}_gradient"
                lines += ["", f"[[{key}]]", *[f"{k} = {toml(v)}" for k, v in table.items()]]
                if obstacle:
                    lines.append(f"obstacle = {toml(obstacle)}")
    files = {"scene.toml": "\n".join([*lines, ""])}
    if functions:
        files["functions.py"] = LEVEL_SET.format(parts="\n".join(functions))
    return files


SAID_AS_FORMULAS = ("pressure", "traction", "body_force", "acceleration", "value", "friction", "expression",
                    "initial_velocity", "initial_displacement")  # fmt: skip


def _formulas(value, d, key=None):
    """A value of a scene file with expressions as formulas."""
    if isinstance(value, dict):
        return {name: _formulas(part, d, name) for name, part in value.items()}
    if isinstance(value, list):
        return [_formulas(part, d, key) for part in value]
    said = isinstance(value, str) and value != "free" and key in SAID_AS_FORMULAS
    return Formula.of(value, d) if said else value


def kept(folder):
    """The case of a scene that was kept in a folder named by its seed: scene.toml and mesh.msh, no other files."""
    mesh = read_msh((folder / "mesh.msh").read_text())
    scene = _formulas(tomllib.loads((folder / "scene.toml").read_text()), mesh.dim)
    length = float(np.ptp(mesh.points, axis=0).max())
    return Case(int(folder.name), scene, mesh, length, max(float(np.max(m["E"])) for m in scene["materials"].values()))
