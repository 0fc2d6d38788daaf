"""Round bodies whose displacement is known: shells and cylinders of Lame, rings and cylinders that are wound."""

from functools import partial

import numpy as np

from drivers.cases import rings, thick_cylinder
from drivers.studies._harness import composed
from pcontact.material.orthotropic import stiffness
from pcontact.scene.model import Body, Contact, Load, Material, MeshSpec

LARGE, MIDDLE, SMALL = 1.0, 0.6, 0.3
E, NU, PRESSURE = 1e9, 0.2, 1e7
WOUND = ([10.0, 140.0, 10.0], [0.3 / 14.0, 0.45, 0.3], [5.0, 3.448, 5.0])
TRUNK = ([0.8, 0.45, 10.0], [0.47, 0.0296, 0.0189], [0.05, 0.65, 0.6])


def _shell(a, b, p_in, p_out):
    """Constants A, B [stress], [stress length^3] of a shell: sigma_rr = A - B / r^3."""
    return (p_in * a**3 - p_out * b**3) / (b**3 - a**3), (p_in - p_out) * (a * b) ** 3 / (b**3 - a**3)


def _stretch(constants, r):
    """Radial displacement over radius."""
    a, b = constants
    return ((1.0 - 2.0 * NU) * a + 0.5 * (1.0 + NU) * b / r**3) / E


def shell_constants():
    """Of the outer and the inner shell, whose contact pressure closes the gap."""
    opened = _stretch(_shell(MIDDLE, LARGE, 0.0, PRESSURE), MIDDLE)
    outer, inner = _stretch(_shell(MIDDLE, LARGE, 1.0, 0.0), MIDDLE), _stretch(_shell(SMALL, MIDDLE, 0.0, 1.0), MIDDLE)
    p = -opened / (outer - inner)
    return _shell(MIDDLE, LARGE, p, PRESSURE), _shell(SMALL, MIDDLE, 0.0, p)


def shell_pressure():
    """Contact pressure of the shells [stress]."""
    (a, b), _ = shell_constants()
    return b / MIDDLE**3 - a


def shell_exact(x, body):
    """Displacement (n, 3) and its gradient (n, 3, 3) at points x (n, 3)."""
    constants, r = shell_constants()[body], np.linalg.norm(x, axis=1)
    value, slope = _stretch(constants, r), -1.5 * (1.0 + NU) * constants[1] / (E * r**5)
    return value[:, None] * x, value[:, None, None] * np.eye(3) + slope[:, None, None] * x[:, :, None] * x[:, None, :]


def in_space(exact):
    """A plane displacement as one in space."""

    def full(x, body):
        u, slope = exact(np.ascontiguousarray(x[:, :2]), body)
        wide = np.zeros((len(x), 3, 3))
        wide[:, :2, :2] = slope
        return np.column_stack([u, np.zeros(len(x))]), wide

    return full


def round_scene(path, degree, theta, title):
    """Two round bodies in space under an outer pressure."""
    sides = [[0.0 if i == k else "free" for i in range(3)] for k in range(3)]
    return composed(
        MeshSpec(path, order=degree),
        dict.fromkeys(("outer", "inner"), Material(E, NU)),
        {f"symmetry_{axis}": side for axis, side in zip("xyz", sides, strict=True)},
        title=f"{title}, degree {degree}, theta {theta:g}",
        contacts=[Contact("inner_outer_skin", "outer_inner_skin", name="round", theta=theta)],
        loads=[Load("outer_skin", pressure=PRESSURE)],
    )


def cylinder_exact(form, pressure, dim, x, body):
    """Lame's displacement (n, d) and its gradient; with axial symmetry (dim 1) x is the radius."""
    factor = pressure * form.a**2 * (1.0 + form.nu) / (form.E * (form.b**2 - form.a**2))
    plane = 1 if dim == 1 else 2
    r2 = np.sum(x[:, :plane] ** 2, axis=1)
    d = x.shape[1]
    u, slope = np.zeros_like(x), np.zeros((len(x), d, d))
    value = factor * (1.0 - 2.0 * form.nu + form.b**2 / r2)
    u[:, :plane] = value[:, None] * x[:, :plane]
    outer = x[:, :plane, None] * x[:, None, :plane]
    slope[:, :plane, :plane] = value[:, None, None] * np.eye(plane)
    slope[:, :plane, :plane] -= (2.0 * factor * form.b**2 / r2**2)[:, None, None] * outer
    return u, slope


def _powers(constants):
    """Power k of the radial displacement A r^k + B r^-k of an orthotropic ring, and its stiffness (6, 6)."""
    moduli = stiffness(*constants)
    return np.sqrt(moduli[1, 1] / moduli[0, 0]), moduli


def _wound(constants, a, b, p_in, p_out):
    """A and B of a ring with radii a < b under pressures inside and outside."""
    k, moduli = _powers(constants)
    slopes = [[(moduli[0, 0] * n + moduli[0, 1]) * r ** (n - 1.0) for n in (k, -k)] for r in (a, b)]
    return np.linalg.solve(slopes, [-p_in, -p_out])


def _wound_exact(rings, dim, x, body):
    """Displacement (n, d) and its gradient; with axial symmetry (dim 1) x is the radius.

    Parameters
    ----------
    rings : sequence of (tuple, ndarray (2,))
        Constants, A and B of each body.
    dim : int
    x : ndarray (n, d)
    body : int
    """
    constants, (rise, fall) = rings[body]
    k, plane = _powers(constants)[0], 1 if dim == 1 else 2
    r = np.linalg.norm(x[:, :plane], axis=1)
    stretch = rise * r ** (k - 1.0) + fall * r ** (-k - 1.0)
    slope = rise * (k - 1.0) * r ** (k - 3.0) - fall * (k + 1.0) * r ** (-k - 3.0)
    u, full = np.zeros_like(x), np.zeros((len(x), x.shape[1], x.shape[1]))
    u[:, :plane] = stretch[:, None] * x[:, :plane]
    full[:, :plane, :plane] = stretch[:, None, None] * np.eye(plane)
    full[:, :plane, :plane] += slope[:, None, None] * x[:, :plane, None] * x[:, None, :plane]
    return u, full


def _wound_rings(p, pressure):
    """Constants A and B of two orthotropic rings, with a pressure between them and one on the outer one."""
    middle = rings.MIDDLE
    return (_wound(WOUND, middle, rings.LARGE, p, pressure), _wound(TRUNK, rings.SMALL, middle, 0.0, p))


def wound_pressure(pressure=1e-2):
    """Contact pressure of two orthotropic rings under an outer pressure [stress]."""

    def gap(p):
        powers = [_powers(constants)[0] for constants in (WOUND, TRUNK)]
        outer, inner = (rise * rings.MIDDLE**k + fall * rings.MIDDLE**-k
                        for k, (rise, fall) in zip(powers, _wound_rings(p, pressure), strict=True))  # fmt: skip
        return outer - inner

    return -gap(0.0) / (gap(1.0) - gap(0.0))


def wound_rings(path, degree, theta, pressure=1e-2):
    """Scene and exact solution of two orthotropic rings under an outer pressure."""
    kinds, known = (WOUND, TRUNK), _wound_rings(wound_pressure(pressure), pressure)
    scene = rings.ring_scene(path, degree, theta, pressure=pressure, gamma0=None)
    scene.materials = {name: Material(one[0], one[1], G=one[2], point=[0.0, 0.0])
                       for name, one in zip(("wound", "trunk"), kinds, strict=True)}  # fmt: skip
    scene.bodies = [Body("outer", "wound"), Body("inner", "trunk")]
    return scene, partial(_wound_exact, tuple(zip(kinds, known, strict=True)), 2)


def wound_cylinder(kinematics, cell, size, degree, folder):
    """Scene and exact solution of a thick cylinder that is wound, under an inner pressure."""
    form = thick_cylinder.Cylinder(10.0, 20.0, 210e3, 0.3, 1e9)
    path = thick_cylinder.make(folder / f"cylinder-{kinematics}-{cell}_{size}.msh", kinematics, cell, 2, size, form)
    scene = thick_cylinder.scene(path, kinematics, degree, [0.1], form, 1, elastic=True)
    (er, eh, ea), (rh, ra, ha), (g_rh, g_ra, g_ha) = WOUND
    more = {"point": [0.0, 0.0, 0.0], "axis": [0.0, 0.0, 1.0]}
    young, poisson, shear = WOUND
    if kinematics == "axisymmetric":
        # axes are radius, axis and hoop there
        young, poisson, shear, more = [er, ea, eh], [ra, rh, ha * ea / eh], [g_ra, g_rh, g_ha], {}
    scene.materials = {name: Material(young, poisson, G=shear, **more) for name in scene.materials}
    known = ((WOUND, _wound(WOUND, form.a, form.b, 0.1, 0.0)),)
    return scene, partial(_wound_exact, known, 1 if kinematics == "axisymmetric" else 3)
