"""Other ways to say the same scene, and how their numbers come back to the first one's.

A :class:`Motion` is x' = length R x + shift with R orthogonal, and stresses in other units. What a variant does to a
:class:`scenes.Case`, it undoes for a result.
"""

from dataclasses import dataclass

import numpy as np
from formulas import combined, moved_value
from grids import renumbered, turned

PLAIN = {"contact_partner_rtol": "1e-5"}
TIGHT = {"snes_rtol": "1e-12", "pc_type": "lu", **PLAIN}


@dataclass
class Motion:
    """Orthogonal R (d, d), shift (d,), unit of length and of stress."""

    R: np.ndarray
    shift: np.ndarray
    length: float = 1.0
    stress: float = 1.0


@dataclass
class Variant:
    """A case to run, and what its numbers mean for the first one.

    Attributes
    ----------
    name : str
    case : scenes.Case
    options : dict of str to str
    ranks : int
    motion : Motion or None
    number : ndarray or None
        New number of every point of the first mesh.
    against : str
        Variant whose numbers it has to have.
    tolerance : float
    swapped : tuple of str
        Contacts whose source and target changed places: their force changes its sign.
    restart : int or None
        It goes on from the checkpoint of this load step of `against`.
    """

    name: str
    case: object
    options: dict
    ranks: int = 1
    motion: Motion | None = None
    number: np.ndarray | None = None
    against: str = "tight"
    tolerance: float = 1e-9
    swapped: tuple = ()
    restart: int | None = None


# -- scenes that are moved ---------------------------------------------------------------------------------


def _direction(motion, value):
    """A vector without length, or one in which components may be "free" (R then permutes the axes)."""
    rows = []
    for row in motion.R:
        j = int(np.argmax(np.abs(row)))
        free = "free" in value and value[j] == "free"
        rows.append("free" if free else combined(row, [0.0 if v == "free" else v for v in value]))
    return rows


def _turn(motion, value):
    """A rotation or a moment, a number in the plane: mirrors turn its sense."""
    sense = float(np.sign(np.linalg.det(motion.R)))
    if isinstance(value, list):
        return _times(sense, _direction(motion, value))
    return _times(sense, value)


def _times(factor, value):
    if isinstance(value, list):
        return [_times(factor, v) for v in value]
    return value if value == "free" else factor * value


def _point(motion, value):
    return (motion.length * (motion.R @ np.array(value, dtype=float)) + motion.shift).tolist()


def _along(motion, value):
    """Magnitudes in the directions of the axes, which R permutes unless they are alike."""
    if np.ptp(value) == 0.0:
        return value
    return (np.abs(motion.R).round(12) @ np.array(value)).tolist()


def _frame(motion, table):
    """The axes of an orthotropic material. Around an axis they are of radius and hoop, which a mirror turns around."""
    sense = float(np.sign(np.linalg.det(motion.R)))
    if "point" in table:
        if "axis" in table:
            table["axis"] = _direction(motion, table["axis"])
        table["point"] = _point(motion, table["point"])
        if "angle" in table:
            table["angle"] *= sense
        return
    R = np.eye(3)
    R[: len(motion.R), : len(motion.R)] = motion.R
    if "angle" in table:
        angle = np.radians(table.pop("angle"))
        table["axes"] = [[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0]]
    axes = [(R @ one).tolist() for one in table.get("axes", np.eye(3)[:2].tolist())]
    if len(motion.R) == 2 and axes[0][2] == axes[1][2] == 0.0:
        table.pop("axes", None)
        table["angle"] = float(np.degrees(np.arctan2(axes[0][1], axes[0][0])))
    else:
        table["axes"] = axes


# what a motion does to a key of any table, obstacles among them: its kind
VECTORS = ("normal", "axis")
POINTS = ("point", "center", "pivot")
TURNS = {"rotation": 0, "moment": 1}
UNITS = {
    # powers of the unit of stress and of length
    **dict.fromkeys(("E", "G", "yield_stress", "hardening", "kinematic_hardening", "mooney_rivlin"), (1, 0)),
    **dict.fromkeys(("tresca", "friction_limit", "adhesion", "pressure"), (1, 0)),
    **dict.fromkeys(("search_radius", "clearance", "adjust_within", "radius", "ring_radius"), (0, 1)),
    **dict.fromkeys(("width", "edge_radius", "shortening"), (0, 1)),
    "per_area": (1, -1), "density": (1, -2), "friction_decay": (0, -1), "viscous_stabilisation": (1, -2),
    "traction": (1, 0), "body_force": (1, -1), "acceleration": (0, 1), "displacement": (0, 1), "value": (0, 1),
    "initial_velocity": (0, 1), "initial_displacement": (0, 1),
}  # fmt: skip
DIRECTED = ("traction", "body_force", "acceleration", "displacement", "force", "initial_velocity",
            "initial_displacement")  # fmt: skip


def _moved_table(motion, table, size):
    """A table of a scene in place; forces are stresses times a length to the power of `size`."""
    powers = {**UNITS, "force": (1, size), "moment": (1, size + 1), "stiffness": (1, size - 1),
              "mass": (1, size - 1), "inertia": (1, size + 1)}  # fmt: skip
    for key, value in table.items():
        value = moved_value(motion, value)
        if key in DIRECTED and isinstance(value, list):
            value = _direction(motion, value)
        if key in ("per_area", "stiffness") and isinstance(value, list):
            value = _along(motion, value)
        if key in VECTORS:
            value = _direction(motion, value)
        if key == "turn_axis":
            value = _turn(motion, value)
        if key in POINTS:
            value = _point(motion, value)
        if key in TURNS:
            value = _turn(motion, value)
        if key in powers:
            stress, length = powers[key]
            value = _times(motion.stress**stress * motion.length**length, value)
        table[key] = value
    if "angle" in table and ("axis" not in table or "shape" in table) and "turn_axis" not in table:
        # in the plane, or about the axis of a cylinder: a direction that a mirror does not turn around
        table["angle"] *= float(np.sign(np.linalg.det(motion.R)))
    elif "angle" in table and "shape" not in table:
        table["axis"] = _times(float(np.sign(np.linalg.det(motion.R))), table["axis"])


def _obstacle(motion, table, size):
    of = table.pop("of", None)
    _moved_table(motion, table, size)
    if "expression" in table:
        table["expression"] *= motion.length
    if of is not None:
        _obstacle(motion, of, size)
        table["of"] = of


def moved(case, motion):
    """The case after a motion."""
    out = case.copy()
    out.mesh = case.mesh if np.linalg.det(motion.R) > 0.0 else turned(case.mesh)
    out.mesh = out.mesh.copy(motion.length * (case.mesh.points @ motion.R.T) + motion.shift)
    out.length, out.stress = case.length * motion.length, case.stress * motion.stress
    scene, size = out.scene, 2 if case.axial or case.dim == 3 else 1
    for table in scene["materials"].values():
        frame = {key: table.pop(key) for key in ("axes", "angle", "point", "axis") if key in table}
        _moved_table(motion, table, size)
        if "hardening_curve" in table:
            table["hardening_curve"] = [[strain, motion.stress * one] for strain, one in table["hardening_curve"]]
        if "ogden" in table:
            table["ogden"] = [[motion.stress * mu, power] for mu, power in table["ogden"]]
        if isinstance(table["E"], list):
            _frame(motion, frame)
            table.update(frame)
    for contact in scene.get("contacts", []):
        obstacle = contact.pop("obstacle", None)
        _moved_table(motion, contact, size)
        if obstacle is not None:
            _obstacle(motion, obstacle, size)
            contact["obstacle"] = obstacle
    for table in scene.get("displacements", []):
        table["value"] = _direction(motion, table["value"])
        _moved_table(motion, table, size)
    for key in ("bodies", "loads", "springs", "couplings", "pretensions"):
        for table in scene.get(key, []):
            _moved_table(motion, table, size)
    for table in scene.get("temperatures", []):
        table["value"] = moved_value(motion, table["value"])
    for phase in scene.get("phases", []):
        if "friction" in phase:
            phase["friction"] = {k: moved_value(motion, v) for k, v in phase["friction"].items()}
    return out


def _permuted(scene):
    """Whether a scene has words about the axes, which are then permuted at most."""
    tables = [*scene.get("displacements", []), *scene.get("couplings", [])]
    words = [one for table in tables for key in ("value", "displacement", "rotation") for one in table.get(key) or []
             if isinstance(table.get(key), list)]  # fmt: skip
    along = [table[key] for table in scene.get("springs", []) for key in ("per_area", "stiffness")
             if isinstance(table.get(key), list)]  # fmt: skip
    return "free" in words or any(np.ptp(value) > 0.0 for value in along)


def rotation(case, rng, mirror):
    """An orthogonal matrix that the scene's supports and symmetry allow."""
    d = case.dim
    if case.axial:
        return np.diag([1.0, -1.0 if mirror else 1.0])
    if _permuted(case.scene):
        R = np.eye(d)[rng.permutation(d)] * rng.choice([-1.0, 1.0], d)[:, None]
    else:
        R = np.linalg.qr(rng.normal(size=(d, d)))[0]
    if (np.linalg.det(R) < 0.0) != mirror:
        R[0] *= -1.0
    return R


def shift(case, rng, factor=3.0):
    """A translation that the symmetry allows."""
    move = rng.normal(size=case.dim) * factor * case.length
    if case.axial:
        move[0] = 0.0
    return move


# -- all variants of a case --------------------------------------------------------------------------------


def in_units(case, rng):
    """The case in units drawn at random."""
    length, stress = 10.0 ** rng.integers(-6, 7), 10.0 ** rng.integers(-6, 13)
    return moved(case, Motion(np.eye(case.dim), np.zeros(case.dim), float(length), float(stress)))


def _swapped(case):
    """Unbiased pairs with source and target in each other's place; None where there is none."""
    out, names = case.copy(), []
    for contact in out.scene.get("contacts", []):
        if contact.get("unbiased"):
            contact["source"], contact["target"] = contact["target"], contact["source"]
            names.append(contact["name"])
    return (out, tuple(names)) if names else None


def _estimated(case):
    out = case.copy()
    out.scene["output"].update({"estimate": True, "fields": True, "smooth": True})
    return out


def variants_of(case, rng, ranks=3):
    """The first runs and what is compared with them.

    Returns
    -------
    list of Variant
        "tight" has a direct solver and a small tolerance, "plain" the options that the program proposes; every one but
        the first names the one it is compared with, which comes before it.
    """
    d = case.dim
    mesh, number = renumbered(case.mesh, rng)
    numbered = case.copy()
    numbered.mesh = mesh
    mirror = Motion(rotation(case, rng, True), np.zeros(d))
    rotate = Motion(rotation(case, rng, False), shift(case, rng))
    units = Motion(np.eye(d), np.zeros(d), 10.0 ** rng.integers(-6, 7), 10.0 ** rng.integers(-6, 7))
    mumps = {**TIGHT, "pc_factor_mat_solver_type": "mumps"}
    out = [
        Variant("tight", case, TIGHT, against=""),
        Variant("plain", case, PLAIN, tolerance=1e-5),
        Variant("renumbered", numbered, TIGHT, number=number),
        Variant("mirrored", moved(case, mirror), TIGHT, motion=mirror),
        Variant("rotated", moved(case, rotate), TIGHT, motion=rotate),
        Variant("units", moved(case, units), TIGHT, motion=units),
        Variant("restarted", case, TIGHT, restart=1),
        Variant("ranks", case, mumps, ranks=ranks),
    ]
    if not (case.finite or {"phases", "pretensions", "dynamics"} & case.scene.keys()):
        # an estimate is refused there
        out.append(Variant("estimated", _estimated(case), PLAIN, against="plain"))
    # multigrid in parallel costs most
    if case.seed % 2 == 0:
        out.append(Variant("ranks, plain", case, PLAIN, ranks=ranks, against="plain", tolerance=1e-5))
    if case.seed % 4 == 0:
        out.append(Variant("renumbered, plain", numbered, PLAIN, number=number, against="plain", tolerance=1e-5))
    swap = _swapped(case)
    if swap is not None:
        out.append(Variant("swapped", swap[0], TIGHT, swapped=swap[1]))
    return out
