"""What a random scene may have beside bodies, contacts and what drives them; each is drawn and put into the scene.

Lengths and the softest Young's modulus are of the order of 1 here, strains of a few percent.
"""

import numpy as np
from formulas import Formula

UP = {2: "y", 3: "z"}


def formula(draw, name, d, value, end, timed=True):
    """An expression that is the value about, over place and time; between a third and twice of it."""
    texts = ["1 + 0.3*x", "1 + 0.2*sin(2*y)", "exp(-0.3*x)", "1/(1 + 0.2*x**2)"]
    text = draw.one(f"{name}.formula", texts)
    part = f"(t/{end!r})"
    time = draw.one(f"{name}.time", [part, f"{part}**2", f"sin(1.5*{part})"]) if timed else "1"
    return Formula.of(f"({text})*{time}", d, value)


def said_as_formulas(draw, scene, d, end):
    """Numbers of loads, supports and friction as expressions, now and then."""
    for number, load in enumerate(scene["loads"]):
        key = next((k for k in ("pressure", "traction", "body_force") if k in load), None)
        if key is None or not draw.chance(f"load{number}.said", 0.25):
            continue
        value = load[key]
        load[key] = ([v and formula(draw, f"load{number}", d, v, end) for v in value] if isinstance(value, list)
                     else formula(draw, f"load{number}", d, value, end))  # fmt: skip
        load.pop("amplitude", None)
    for number, table in enumerate(scene["displacements"]):
        moves = [v for v in table["value"] if v not in (0.0, "free")]
        # what goes far goes as one
        if moves and max(map(abs, moves)) < 0.1 and "angle" not in table and draw.chance(f"support{number}.said", 0.15):
            table["value"] = [v if v in (0.0, "free") else formula(draw, f"support{number}", d, v, end)
                              for v in table["value"]]  # fmt: skip
            table.pop("amplitude", None)
    for number, contact in enumerate(scene["contacts"]):
        varies = "friction" in contact and "adhesion" not in contact
        if varies and draw.chance(f"contact{number}.said", 0.2):
            contact["friction"] = formula(draw, f"contact{number}", d, contact["friction"], end, timed=False)


def springs(draw, scene, region, d, stiffness, name):
    """Springs to the ground on a group, instead of a support."""
    kind = draw.one(f"{name}.springs", ["alike", "each", "total"])
    value = [stiffness] * d if kind == "alike" else [stiffness * f for f in (1.0, 2.0, 1.5)[:d]]
    key = "stiffness" if kind == "total" else "per_area"
    scene.setdefault("springs", []).append({"name": f"{name} springs", "region": region, key: value})


def coupling(draw, scene, region, d, value, flat):
    """A group that moves with a point, instead of a displacement."""
    axial = scene["mesh"].get("kinematics") == "axisymmetric"
    table = {"name": "grip", "region": region}
    if axial:
        table["displacement"] = ["free", *value[1:]]
    else:
        table["displacement"] = value
        rest = "free" if flat and draw.chance("grip.tilts", 0.3) else 0.0
        table["rotation"] = rest if d == 2 else [rest, rest, 0.0]
    scene.setdefault("couplings", []).append(table)
    return table


def bolt(draw, scene, name, d, depth, drive):
    """A section across a body, whose sides are drawn into each other, or pushed apart by a force."""
    table = {"name": "bolt", "region": f"{name}_section"}
    if drive == "moved" and draw.chance("bolt.force said", 0.4):
        table["force"] = -draw.uniform("bolt.force", 0.2, 1.0) * depth
    else:
        table["shortening"] = draw.uniform("bolt.shortening", 0.1, 0.4) * depth
    scene.setdefault("pretensions", []).append(table)


def pushed_sideways(draw, scene, name, d, depth, end):
    """A pressure on a side of a body, which may follow the surface."""
    load = {"region": f"{name}_x1", "pressure": draw.uniform("side.pressure", 0.1, 0.4) * depth}
    if draw.chance("side.follows", 0.6) and scene["mesh"].get("kinematics") != "plane_stress":
        load["follower"] = True
    scene["loads"].append(load)


def heated(draw, scene, d, end):
    """Temperatures of bodies that expand by some thousandths."""
    scene["temperatures"] = []
    for body in scene["bodies"]:
        material = scene["materials"][body["material"]]
        orthotropic = isinstance(material["E"], list)
        material["expansion"] = [1e-3, 5e-4, 2e-4] if orthotropic else 1e-3
        warm = draw.uniform(f"{body['region']}.warm", -2.0, 5.0)
        value = formula(draw, f"{body['region']}.warm", d, warm, end) if draw.chance(
            f"{body['region']}.warm said", 0.4) else warm  # fmt: skip
        scene["temperatures"].append({"region": body["region"], "value": value, "reference": 0.5})


def orthotropic(draw, name, d, axial, E):
    """A material of its own along three axes."""
    table = {
        "E": [E * draw.uniform(f"{name}.E{k}", 1.0, 3.0) for k in range(3)],
        "nu": [draw.uniform(f"{name}.nu{k}", 0.1, 0.3) for k in range(3)],
        "G": [E * draw.uniform(f"{name}.G{k}", 0.3, 1.0) for k in range(3)],
    }
    kinds = ["none", "angle", "axes"] + ([] if axial else ["around"])
    kind = draw.one(f"{name}.frame", kinds)
    if kind in ("angle", "around"):
        table["angle"] = draw.uniform(f"{name}.angle", -80.0, 80.0)
    if kind == "around":
        table["point"] = [-1.5] * d
        if d == 3:
            table["axis"] = [0.2, 0.1, 1.0]
    if kind == "axes":
        table["axes"] = [[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]] if d == 2 else [[0.6, 0.8, 0.1], [-0.2, 0.5, 0.7]]
    return table


def rubber(draw, name, material):
    """A law of rubber of the same Young's modulus."""
    E, nu = material["E"], material["nu"]
    mu = E / (2.0 * (1.0 + nu))
    law = draw.one(f"{name}.rubber", ["neo_hooke", "mooney_rivlin", "ogden"])
    table = {"E": E, "nu": nu, "law": law}
    if law == "mooney_rivlin":
        table["mooney_rivlin"] = [0.35 * mu, 0.15 * mu]
    if law == "ogden":
        # sum(mu alpha) is 2 mu
        table["ogden"] = [[1.2 * mu / 1.5, 1.5], [-0.8 * mu / 2.0, -2.0]]
    return table


# -- inertia -----------------------------------------------------------------------------------------------


def inertia(draw, scene, d, depth, end, finite):
    """Mass, damping and velocities of bodies, and more load steps: waves cross a body in a time of the order of 1."""
    materials, axial = scene["materials"].values(), scene["mesh"].get("kinematics") == "axisymmetric"
    softest = float(min(np.min(one["E"]) for one in materials))
    # supports move a tenth as fast as waves do, at most
    ways = [abs(v) for one in scene["displacements"] for v in one["value"] if v != "free" and np.isscalar(v)]
    light = min(1.0, 0.1 / (2.0 * max(ways, default=0.0) / end + 1e-9)) ** 2
    for name, material in scene["materials"].items():
        material["density"] = softest * light * draw.uniform(f"{name}.density", 0.1, 1.0)
    table = {"integrator": draw.one("integrator", ["hht", "bossak", "trapezoidal", "euler"], [45, 20, 25, 10])}
    if table["integrator"] in ("hht", "bossak") and draw.chance("integrator.said", 0.3):
        table["alpha"] = draw.one("integrator.alpha", [-0.3, -0.05, 0.0])
    if draw.chance("lumped", 0.3):
        table["mass"] = "lumped"
    count = draw.whole("inertia.count", 4, 9)
    for one in scene.get("phases", [scene["steps"]]):
        one["count"] = count
    begins = bool(scene.get("phases")) and draw.chance("inertia.late", 0.4)
    if begins:
        table["phases"] = [one["name"] for one in scene["phases"][1:]]
    elif draw.chance("inertia.auto", 0.15):
        scene["steps"]["control"] = "auto"
        table["step_error"] = draw.one("inertia.error", [0.01, 0.1])
    slow = draw.uniform("damping", 0.1, 2.0) if draw.chance("damped", 0.3) else None
    stiff = not finite and not any(isinstance(one["E"], list) for one in materials) and draw.chance("drags", 0.25)
    for body in scene["bodies"]:
        name = body["region"]
        if slow is not None:
            # the same of all, so that it is known what it takes of the momentum
            body["mass_damping"] = slow
        if stiff:
            body["stiffness_damping"] = draw.uniform(f"{name}.drag", 0.01, 0.2)
        if draw.chance(f"{name}.flies", 0.4):
            fast = [depth / end * draw.uniform(f"{name}.velocity{k}", -2.0, 2.0) for k in range(d)]
            if axial:
                fast[0] = 0.0
            said = draw.chance(f"{name}.velocity said", 0.3)
            body["initial_velocity"] = [
                formula(draw, f"{name}.velocity", d, v, end, timed=False) if said and v else v for v in fast
            ]  # fmt: skip
    if not begins and "phases" not in scene["bodies"][0] and not finite and draw.chance("strained", 0.15):
        value = formula(draw, "strained", d, 0.2 * depth, end, timed=False)
        scene["bodies"][0]["initial_displacement"] = [*[0.0] * (d - 1), value]
    for coupling_ in scene.get("couplings", []):
        if not coupling_.get("average") and draw.chance("heavy", 0.5):
            coupling_["mass"] = 0.5 * light * softest
            if not axial:
                coupling_["inertia"] = 0.1 * light * softest if d == 2 else [0.1 * light * softest] * 3
    scene["dynamics"] = table


# -- phases ------------------------------------------------------------------------------------------------


def phases(draw, scene, names, d, depth, alone):
    """Two or three phases instead of one; in some of them something else acts. `alone`: whether all bodies are held
    without the last one, and without its contact.
    """
    count = draw.one("phases", [2, 3])
    ends = np.linspace(0.0, scene["steps"].pop("end"), count + 1)
    steps = draw.whole("phase.count", 1, 3)
    scene["phases"] = [
        {"name": f"p{k}", "duration": float(b - a), "count": steps}
        for k, (a, b) in enumerate(zip(ends, ends[1:], strict=False))
    ]
    every = [one["name"] for one in scene["phases"]]
    pairs = [c for c in scene["contacts"] if "target" in c and not c.get("tied") and c["source"] != c["target"]]
    kinds = ["load", "spring", "none"]
    kinds += ["friction"] * any("tresca" not in c for c in pairs) + ["tied"] * bool(pairs)
    kinds += ["begins"] * (bool(pairs) and alone) + ["comes", "goes"] * (alone and not scene.get("pretensions"))
    kinds += ["locked"] * bool(scene.get("pretensions"))
    kind = draw.one("phase.kind", kinds)
    if kind == "load":
        force = [0.02 * depth, *[0.0] * (d - 2), -0.1 * depth]
        if scene["mesh"].get("kinematics") == "axisymmetric":
            force[0] = 0.0
        some = [every[-1]] if draw.chance("phase.late", 0.5) else every[:1]
        scene["loads"].append({"region": names[0], "body_force": force, "phases": some})
    elif kind == "spring":
        springs(draw, scene, f"{names[0]}_x1", d, 0.3, "late")
        scene["springs"][-1]["phases"] = every[1:] if draw.chance("phase.late", 0.5) else every[:1]
    elif kind == "friction":
        contact = next(c for c in pairs if "tresca" not in c)
        value = draw.one("phase.friction", [0.0, 0.1, 0.5])
        scene["phases"][1]["friction"] = {contact["name"]: value}
    elif kind == "tied":
        scene["phases"][1]["tied"] = [pairs[0]["name"]]
    elif kind == "begins":
        # the bodies are as far from each other as they are, or overlap
        pairs[-1]["phases"] = every[1:]
    elif kind in ("comes", "goes"):
        body = next(b for b in scene["bodies"] if b["region"] == names[-1])
        body["phases"] = every[1:] if kind == "comes" else every[:-1]
    elif kind == "locked":
        scene["pretensions"][0]["phases"] = every[:1]
    return kind
