"""The matrix of extremes: all cells, family by family. For `drivers/studies/extremes.py`."""

import numpy as np

from drivers.studies._extreme_runs import Cell
from drivers.studies._extreme_scenes import E, Frame, bars, flowing, ring, shear, stack
from drivers.studies._extreme_shapes import pointed, touching, wave

THETAS = (0.0, 1.0, -1.0)
PLANE, SPACE = ("quadrilateral", "triangle"), ("hexahedron", "tetrahedron")
SOLID = {2: ((3, 2), (4, 2)), 3: ((2, 2, 2), (2, 2, 2))}

# why a bound is what it is
REASONS = {
    "exact": "the answer is in the space; Newton's method ends at 1e-8 of the first residual "
    "and 1e-7 of the forces at work (nu: at 1e-12 of the first residual)",
    "mesh": "discretisation error of this mesh",
    "stiff": "rounding errors of the stress of the stiffer body: 1e-13 times the ratio, or gamma0 times 1e-12",
    "condition": "what the residual leaves open: 1e-8 times the square of the aspect over 1e3",
    "digits": "digits of the coordinates in the file",
    "loose": "a load of 1e-12 on a body that first falls by 1e-4: 16 digits of the stress leave so much of it",
    "steps": "backward Euler with this number of load steps",
    "updates": "updates of the multipliers end at a change of 1e-4",
    "statics": "the force is in balance with the load",
    "zero": "exactly zero",
}


def _dim(cell):
    return 2 if cell in PLANE else 3


def _block(cell, order=1):
    """Arguments of `stack` for a kind of cell."""
    dim = _dim(cell)
    return {"dim": dim, "cell": cell, "order": order, "n": SOLID[dim]}


def nu_cells():
    """Poisson's ratio up to 0.49999."""
    for nu in (0.3, 0.45, 0.49, 0.499, 0.4999, 0.49999):
        for cell, order in [("quadrilateral", 1), ("triangle", 2), ("hexahedron", 1), ("tetrahedron", 2)]:
            # the pressure is 1 / (1 - 2 nu) times as sensitive as the forces that the default tolerance is for
            keys = {**_block(cell, order), "nu": (nu, nu), "petsc": {"snes_rtol": 1e-12}}
            yield Cell("nu", f"{nu:g}", f"blocks, {cell} {order}", stack, keys)
        fine = 0.003 if nu < 0.49 else 0.02
        for cell, order, bound in [("quadrilateral", 1, 0.03), ("quadrilateral", 2, fine), ("triangle", 2, fine)]:
            keys = {"cell": cell, "order": order, "nu": nu}
            yield Cell("nu", f"{nu:g}", f"ring, {cell} {order}", ring, keys, bound, "mesh")
        keys, cause = {"cell": "triangle", "order": 1, "nu": nu}, "locking" if nu > 0.45 else None
        yield Cell("nu", f"{nu:g}", "ring, triangle 1", ring, keys, 0.08, "mesh", cause)


def stiffness_cells():
    """One body stiffer than the other."""
    for ratio in (1.0, 1e3, 1e6, 1e9):
        for soft in ("source", "target") if ratio > 1 else ("neither",):
            bound = (max(1e-6, 1e-13 * ratio), "stiff" if ratio > 1e8 else "exact")
            youngs = (E * ratio, E) if soft == "source" else (E, E * ratio)
            for theta in THETAS:
                keys = {"youngs": youngs, "theta": theta}
                yield Cell("stiffness", f"{ratio:.0e}", f"{soft} soft, theta {theta:g}", stack, keys, *bound)
            for more in ({"dim": 3, "cell": "hexahedron", "n": SOLID[3]}, {"unbiased": True}, {"pressure": 10.0}):
                word = " ".join(f"{key} {value}" for key, value in more.items() if key not in ("cell", "n"))
                yield Cell(
                    "stiffness", f"{ratio:.0e}", f"{soft} soft, {word}", stack, {"youngs": youngs, **more}, *bound
                )


def gamma_cells():
    """The dimensionless parameter, and the penalty method whose penetration is known."""
    for gamma0 in (1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9, 1e12, 1e15, 1e18):
        # rounding errors that hide more than a thousandth of the forces, in their norm, are refused
        bound = (min(max(1e-6, 1e-12 * gamma0), 5e-3), "stiff" if gamma0 > 1e6 else "exact")
        large = "gamma0 is too large" if gamma0 > 1e9 else None
        for theta in THETAS:
            keys = {"gamma0": gamma0, "theta": theta}
            limit = 0.25 * (1.0 + theta) ** 2
            cause = "coerciv" if gamma0 < limit else large
            yield Cell("gamma0", f"{gamma0:.0e}", f"blocks, theta {theta:g}", stack, keys, *bound, cause)
            yield Cell("gamma0", f"{gamma0:.0e}", f"ring, theta {theta:g}", ring, keys, 0.01, "mesh", cause)
        keys = {"gamma0": gamma0, "formulation": "penalty"}
        yield Cell("gamma0", f"{gamma0:.0e}", "blocks, penalty", stack, keys, *bound, large)
        yield Cell(
            "gamma0", f"{gamma0:.0e}", "blocks, augmented Lagrangian", stack,
            {"gamma0": gamma0, "formulation": "augmented_lagrangian"}, 1e-3, "updates", large,
        )  # fmt: skip


def friction_cells():
    """Coefficients up to 10: stick at 90 % of the bound, and slip."""
    for friction in (0.0, 1e-9, 0.1, 0.3, 1.0, 3.0, 10.0):
        for theta in THETAS:
            for word, ratio in (("stick", 0.9 * friction), ("slip", 1.5 * friction)):
                if friction == 0.0 and word == "stick":
                    continue
                keys = {"friction": friction, "ratio": ratio if friction else 0.1, "theta": theta}
                several = "several solutions" if friction > 3.0 else None
                yield Cell("friction", f"{friction:g}", f"{word}, theta {theta:g}", shear, keys, cause=several)
        if friction:
            several = "several solutions" if friction > 3.0 else None
            keys = {"dim": 3, "cell": "tetrahedron", "n": (2, 2), "friction": friction, "ratio": 0.9 * friction}
            yield Cell("friction", f"{friction:g}", "stick, tetrahedron", shear, keys, cause=several)


def hardening_cells():
    """Hardening from E to nothing, at 99 % of a limit load."""
    for hardening in (1.0, 0.1, 1e-2, 1e-3, 1e-6, 1e-9, 0.0):
        word = f"{hardening:.0e} E" if hardening else "0"
        yield Cell("hardening", word, "bars, hexahedron 1", bars, {"hardening": hardening})
        yield Cell(
            "hardening", word, "bars, tetrahedron 2", bars, {"hardening": hardening, "cell": "tetrahedron", "order": 2}
        )
        yield Cell(
            "hardening", word, "bars, plane stress", bars, {"hardening": hardening, "dim": 2, "cell": "quadrilateral"}
        )
        yield Cell("hardening", word, "flowing block", flowing, {"hardening": hardening}, 0.02, "steps")
        beyond = "limit load" if hardening < 1e-3 else None
        keys = {"hardening": hardening, "level": 1.01}
        yield Cell("hardening", word, "flowing block, 101 %", flowing, keys, 0.02, "steps", beyond)


def _frames(name, length, stress, shift, bounds=None):
    """All closed forms in other units or at another place."""
    frame = Frame(length, stress, shift)
    bound = {"bound": 1e-6, "reason": "exact"} | (bounds or {})
    loose = max(bound["bound"], 0.003)
    word = f"shift {shift:.0e}" if shift else f"length {length:.0e}, stress {stress:.0e}"
    for variant, build, keys in [
        ("blocks", stack, {}),
        ("blocks, ray tracing", stack, {"search": "ray_tracing", "theta": 1.0}),
        ("blocks with gap, hexahedron", stack, {"dim": 3, "cell": "hexahedron", "n": SOLID[3], "gap": 1e-3}),
        ("stick", shear, {}),
        ("slip", shear, {"ratio": 0.5, "theta": -1.0}),
        ("bars", bars, {"hardening": 0.01}),
    ]:
        yield Cell(name, word, variant, build, {**keys, "frame": frame}, **bound)
    yield Cell(name, word, "ring", ring, {"frame": frame}, loose, "mesh")


def unit_cells():
    """Units of length and stress."""
    for length, stress in [(1e-12, 1.0), (1e12, 1.0), (1.0, 1e-12), (1.0, 1e12), (1e-12, 1e12), (1e12, 1e-12)]:
        yield from _frames("units", length, stress, 0.0)


def place_cells():
    """Far from the origin: coordinates have 1e6 * 1e-16 = 1e-10 of the size left; forces from 1e-3 of it."""
    for shift in (1e3, 1e6):
        yield from _frames("place", 1.0, 1.0, shift, {"bound": 1e-6, "reason": "digits"})


def _collapse(axis, height):
    """Move the middle layer of nodes of a brick near its lower side: cells of height `height`."""

    def bend(x):
        moved = x.copy()
        low, high = x[:, axis].min(), x[:, axis].max()
        part = (x[:, axis] - low) / (high - low)
        moved[:, axis] = low + (high - low) * np.interp(part, [0.0, 0.5, 1.0], [0.0, height, 1.0])
        return moved

    return bend


def _slant(thin):
    """Move the inner nodes of a brick of 2 x 2 cells next to its diagonal: slivers beside fat cells."""

    def bend(x):
        moved = x.copy()
        low, high = x.min(axis=0), x.max(axis=0)
        middle = np.abs(x - 0.5 * (low + high)).max(axis=1) < 1e-9
        moved[middle] = low + (high - low) * np.array([1.0 - thin, *[0.5] * (x.shape[1] - 1)])
        return moved

    return bend


def shape_cells():
    """Cells of aspect 1e4, slivers."""
    thin = 1e-4
    for cell in (*PLANE, *SPACE):
        dim = _dim(cell)
        n = ([2] * dim, [2] * dim)
        order = 1 if cell in ("quadrilateral", "hexahedron") else 2
        keys = {"dim": dim, "cell": cell, "order": order, "n": n}
        flat = {"sizes": (1.0, thin, thin), "push": 0.02 * thin}
        yield Cell("shape", "aspect 1e4", f"flat, {cell} {order}", stack, {**keys, **flat}, 1e-3, "condition")
        yield Cell("shape", "aspect 1e4", f"upright, {cell} {order}", stack, {**keys, "sizes": (thin, 1.0, 1.0)})
        layers = (_collapse(dim - 1, thin),) * 2
        yield Cell("shape", "aspect 1e4", f"a thin layer, {cell} {order}", stack, {**keys, "bends": layers})
        # in space surfaces match: the quadrature does not resolve edges of the target, see the mesh sizes
        strips = (_collapse(0, thin), None if dim == 2 else _collapse(0, thin))
        yield Cell("shape", "aspect 1e4", f"a thin strip, {cell} {order}", stack, {**keys, "bends": strips})
    for cell, thinness in [("triangle", 1e-4), ("triangle", 1e-8), ("tetrahedron", 1e-4), ("tetrahedron", 1e-8)]:
        dim = _dim(cell)
        keys = {"dim": dim, "cell": cell, "n": ([2] * dim, [2] * dim), "bends": (_slant(thinness),) * 2}
        yield Cell("shape", f"slivers of {thinness:.0e}", cell, stack, keys)


def size_cells():
    """Mesh sizes of source and target 1 : 100, either way."""
    fine, coarse = 200, 2
    for word, n in (("source fine", ((coarse, 2), (fine, 2))), ("target fine", ((fine, 2), (coarse, 2)))):
        for theta in THETAS:
            yield Cell("mesh sizes", "1 : 100", f"{word}, theta {theta:g}", stack, {"n": n, "theta": theta})
        yield Cell("mesh sizes", "1 : 100", f"{word}, triangle 2", stack, {"n": n, "cell": "triangle", "order": 2})
        keys = {"dim": 3, "cell": "hexahedron", "n": tuple((m, 1, 1) for m, _ in n)}
        cause = "quadrature" if word == "target fine" else None
        yield Cell("mesh sizes", "1 : 100", f"{word}, hexahedron", stack, keys, cause=cause)


def gap_cells():
    """Gaps and overlaps of 1e-15 to 1e-1 of the size."""
    for size in (1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1e-1):
        for sign, word in ((1.0, "gap"), (-1.0, "overlap")):
            gap, push = sign * size, 0.02 + max(sign * size, 0.0)
            keys = {"gap": gap, "push": push}
            yield Cell("gaps", f"{word} {size:.0e}", "pushed", stack, keys)
            keys = {**keys, "dim": 3, "cell": "tetrahedron", "n": SOLID[3], "theta": 1.0}
            yield Cell("gaps", f"{word} {size:.0e}", "pushed, tetrahedron, theta 1", stack, keys)
        yield Cell("gaps", f"overlap {size:.0e}", "adjusted", stack, {"gap": -size, "interference": "adjust"})
        if size >= 1e-12:
            # rounding of coordinates near 1: 1e-16; touching surfaces are those nearer than 64 of these
            keys = {"gap": -size, "push": 0.0}
            digits = max(1e-6, 1.5e-14 / size)
            yield Cell("gaps", f"overlap {size:.0e}", "resolved", stack, keys, digits, "digits")
            yield Cell("gaps", f"gap {size:.0e}", "not closed", stack, {"gap": size, "push": 0.5 * size}, 1e-12, "zero")


def point_cells():
    """A single point in contact; edges and corners; tangential touch."""
    for theta in THETAS:
        keys = {"n": ((1, 1), (1, 1)), "quadrature": 1, "theta": theta}
        yield Cell("few points", "a single one", f"a facet with one point, theta {theta:g}", stack, keys)
        keys = {"load": 1e-3, "n": 4, "theta": theta, "quadrature": 2, "order": 1}
        yield Cell(
            "few points", "a single one", f"parabola on a plane, theta {theta:g}", touching, keys, reason="statics"
        )
    for kind, dim in [
        ("corner on face", 2),
        ("corner on corner", 2),
        ("corner on face", 3),
        ("edge on edge", 3),
        ("edge along edge", 3),
    ]:
        for source in ("upper", "lower"):
            cell = {2: "quadrilateral", 3: "hexahedron"}[dim]
            for more in ({}, {"theta": 1.0}, {"friction": 0.3}, {"search": "ray_tracing"}, {"order": 2}):
                word = ", ".join([f"{dim}D", f"{source} is source", *(f"{key} {value}" for key, value in more.items())])
                keys = {"kind": kind, "dim": dim, "cell": cell, "source": source, "n": 4 if dim == 2 else 3, **more}
                # an edge that sinks in between points of the other one: which flank they find changes with the solution
                cause = "other partners" if kind == "edge on edge" and source == "lower" else None
                yield Cell("few points", kind, word, pointed, keys, reason="statics", cause=cause)
    for target in ("plane", "block"):
        for load in (0.0, 1e-12, 1e-10, 1.0):
            word = f"{target}, load {load:g}"
            zero = {"bound": 0.0, "reason": "zero"} if load == 0.0 else {"reason": "statics"}
            if 0.0 < load < 1e-9:
                zero = {"bound": 1e-2, "reason": "loose", "cause": "rounding errors"}
            yield Cell("few points", "tangential touch", word, touching, {"load": load, "target": target}, **zero)


def zero_cells():
    """Closed with exactly zero force."""
    for theta in THETAS:
        for cell in (*PLANE, *SPACE):
            for friction in (0.0, 0.3):
                keys = {**_block(cell), "push": 0.0, "theta": theta, "friction": friction}
                yield Cell(
                    "zero force", "closed", f"{cell}, theta {theta:g}, friction {friction:g}", stack, keys, 0.0, "zero"
                )


def load_cells():
    """Loads of 0, of 1e-12 and of 1e6 times a sensible one."""
    for factor in (1e-12, 1.0, 1e6):
        cause = "limit load|small strains|search radius" if factor > 1.0 else None
        for variant, build, keys in [
            ("push", stack, {"push": 0.02 * factor}),
            ("pressure", stack, {"pressure": 10.0 * factor}),
            ("pressure, theta 1, hexahedron", stack, {**_block("hexahedron"), "pressure": 10.0 * factor, "theta": 1.0}),
            ("push, friction", shear, {"pressure": 10.0 * factor}),
            ("shrink fit", ring, {"fit": 1e-3 * factor}),
            ("weight on a corner", pointed, {"load": factor}),
            ("flowing block", flowing, {"level": 0.99 * factor}),
        ]:
            bound, reason = {ring: (0.003, "mesh"), pointed: (1e-6, "statics"), flowing: (0.02, "steps")}.get(
                build, (1e-6, "exact")
            )
            if build is pointed and factor < 1.0:
                bound, reason, cause = 1e-2, "loose", "rounding errors"
            if build is ring and factor < 1.0:
                continue  # smaller than what the curved cells miss of the circle
            yield Cell("loads", f"{factor:.0e}", variant, build, keys, bound, reason, cause)
    for build, keys in [
        (stack, {"pressure": 0.0}),
        (stack, {"push": 0.0}),
        (shear, {"pressure": 0.0}),
        (pointed, {"load": 0.0}),
    ]:
        yield Cell("loads", "0", f"{build.__name__}, {next(iter(keys))}", build, keys, 0.0, "zero")


def curved_cells():
    """Curved cells of degree 2 pressed flat, and nearly flat."""
    for cell, n in [
        ("quadrilateral", (16, 10)),
        ("triangle", (16, 10)),
        ("hexahedron", (10, 6)),
        ("tetrahedron", (10, 6)),
    ]:
        for part in (0.5, 1.5):
            for theta in THETAS:
                keys = {"cell": cell, "n": n, "part": part, "theta": theta}
                word = "flat" if part > 1 else "half flat"
                yield Cell("curved", word, f"{cell}, theta {theta:g}", wave, keys, 0.03, "mesh")


FAMILIES = {
    "nu": nu_cells,
    "stiffness": stiffness_cells,
    "gamma0": gamma_cells,
    "friction": friction_cells,
    "hardening": hardening_cells,
    "units": unit_cells,
    "place": place_cells,
    "shape": shape_cells,
    "mesh sizes": size_cells,
    "gaps": gap_cells,
    "few points": point_cells,
    "zero force": zero_cells,
    "loads": load_cells,
    "curved": curved_cells,
}
