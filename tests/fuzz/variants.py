"""Other ways to say the same scene, and how their numbers come back to the first one's.

A :class:`Motion` is x' = length R x + shift with R orthogonal, and stresses in other units. What a variant does to a
:class:`scenes.Case`, it undoes for a result.
"""

from dataclasses import dataclass

import numpy as np
from grids import renumbered, turned

TIGHT = {"snes_rtol": "1e-12", "pc_type": "lu"}


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
    if "free" not in value:
        return (motion.R @ np.array(value, dtype=float)).tolist()
    out = [None] * len(value)
    for i, row in enumerate(motion.R):
        j = int(np.argmax(np.abs(row)))
        out[i] = "free" if value[j] == "free" else float(row[j] * value[j])
    return out


def _times(factor, value):
    return [v if v == "free" else factor * v for v in value] if isinstance(value, list) else factor * value


def _point(motion, value):
    return (motion.length * (motion.R @ np.array(value, dtype=float)) + motion.shift).tolist()


def _obstacle(motion, table):
    for key in set(table) & {"point", "center"}:
        table[key] = _point(motion, table[key])
    for key in set(table) & {"normal", "axis"}:
        table[key] = _direction(motion, table[key])
    if "displacement" in table:
        table["displacement"] = _times(motion.length, _direction(motion, table["displacement"]))
    if "radius" in table:
        table["radius"] *= motion.length
    if "of" in table:
        _obstacle(motion, table["of"])


STRESSES = ("E", "yield_stress", "hardening", "kinematic_hardening", "tresca", "friction_limit", "adhesion", "pressure")


def _stresses(table, factor):
    for key in set(table) & set(STRESSES):
        table[key] *= factor
    if "hardening_curve" in table:
        table["hardening_curve"] = [[strain, factor * stress] for strain, stress in table["hardening_curve"]]


def moved(case, motion):
    """The case after a motion."""
    out = case.copy()
    out.mesh = case.mesh if np.linalg.det(motion.R) > 0.0 else turned(case.mesh)
    out.mesh = out.mesh.copy(motion.length * (case.mesh.points @ motion.R.T) + motion.shift)
    out.length, out.stress = case.length * motion.length, case.stress * motion.stress
    scene = out.scene
    for table in [*scene["materials"].values(), *scene.get("contacts", []), *scene.get("loads", [])]:
        _stresses(table, motion.stress)
    for contact in scene.get("contacts", []):
        if "search_radius" in contact:
            contact["search_radius"] *= motion.length
        if "obstacle" in contact:
            _obstacle(motion, contact["obstacle"])
    for table in scene.get("displacements", []):
        table["value"] = _times(motion.length, _direction(motion, table["value"]))
    for load in scene.get("loads", []):
        for key, factor in (("traction", motion.stress), ("body_force", motion.stress / motion.length)):
            if key in load:
                load[key] = _times(factor, _direction(motion, load[key]))
    return out


def rotation(case, rng, mirror):
    """An orthogonal matrix that the scene's supports and symmetry allow."""
    d = case.dim
    if case.axial:
        return np.diag([1.0, -1.0 if mirror else 1.0])
    partly = any("free" in table["value"] for table in case.scene.get("displacements", []))
    if partly:
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
        Variant("plain", case, {}, tolerance=1e-5),
        Variant("renumbered", numbered, TIGHT, number=number),
        Variant("mirrored", moved(case, mirror), TIGHT, motion=mirror),
        Variant("rotated", moved(case, rotate), TIGHT, motion=rotate),
        Variant("units", moved(case, units), TIGHT, motion=units),
        Variant("restarted", case, TIGHT, restart=1),
        Variant("ranks", case, mumps, ranks=ranks),
    ]
    if not case.finite:
        # an estimate is refused there
        out.append(Variant("estimated", _estimated(case), {}, against="plain"))
    # multigrid in parallel costs most
    if case.seed % 2 == 0:
        out.append(Variant("ranks, plain", case, {}, ranks=ranks, against="plain", tolerance=1e-5))
    if case.seed % 4 == 0:
        out.append(Variant("renumbered, plain", numbered, {}, number=number, against="plain", tolerance=1e-5))
    swap = _swapped(case)
    if swap is not None:
        out.append(Variant("swapped", swap[0], TIGHT, swapped=swap[1]))
    return out
