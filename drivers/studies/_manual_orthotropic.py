"""Cases of the verification manual on orthotropic bodies: a rigid cylinder on a half plane."""

import numpy as np

from drivers._common import make_mesh
from drivers.studies._harness import composed
from drivers.studies._manual import JOHNSON, Case, points_of, share
from meshes.grid import name_boundary, near
from meshes.patches import growing, patches, rectangle
from pcontact.scene.model import Contact, Material, MeshSpec, Obstacle

# a laminate of carbon fibres [MPa], which lie at this angle to the surface [degrees]
YOUNG, POISSON, SHEAR, ANGLE = (140e3, 10e3, 10e3), (0.3, 0.3, 0.45), (5e3, 5e3, 3448.0), 30.0
RADIUS, SINK, SIZE = 100.0, 0.026, 60.0
# cells are alike up to here; the half width is about 1
ALIKE = 1.4
INNER = 0.9  # part of the half width in which the profile is fitted


def whole_block(path, n):
    """A block [-SIZE, SIZE] x [-SIZE, 0], cells of 1 / n around the middle of its top, beyond growing by 1 + 3 / n."""
    factor = 1.0 + 3.0 / n
    inner = np.linspace(0.0, ALIKE, round(ALIKE * n) + 1)
    half = np.concatenate([inner[:-1], ALIKE + growing(1.0 / n, SIZE - ALIKE, factor)])
    with patches(path) as bodies:
        grid = rectangle(np.concatenate([-half[:0:-1], half]), -growing(1.0 / n, SIZE, factor)[::-1])
        bodies["block"] = name_boundary(grid, "sides", top=near(1, 0.0), bottom=near(1, -SIZE, 1e-9 * SIZE))


def compliance():
    """Of the surface: E* = 2 / L, slope of the surface = -L / pi times the finite Hilbert transform of the pressure.

    L = -b22 Im(1 / mu1 + 1 / mu2) with the compliance b of plane strain in the directions of the surface, and the roots
    mu of positive imaginary part of  b11 mu^4 - 2 b16 mu^3 + (2 b12 + b66) mu^2 - 2 b26 mu + b22 = 0.
    """
    (e1, e2, e3), (nu12, nu13, nu23) = YOUNG, POISSON
    s13, s23 = -nu13 / e1, -nu23 / e2
    b = np.diag([1.0 / e1 - s13**2 * e3, 1.0 / e2 - s23**2 * e3, 1.0 / SHEAR[0]])
    b[0, 1] = b[1, 0] = -nu12 / e1 - s13 * s23 * e3
    c, s = np.cos(np.radians(ANGLE)), np.sin(np.radians(ANGLE))
    turn = np.array([[c * c, s * s, 2 * c * s], [s * s, c * c, -2 * c * s], [-c * s, c * s, c * c - s * s]])
    b = turn.T @ b @ turn
    roots = np.roots([b[0, 0], -2 * b[0, 2], 2 * b[0, 1] + b[2, 2], -2 * b[1, 2], b[1, 1]])
    return float(-b[1, 1] * np.sum(1.0 / roots[roots.imag > 0.0]).imag)


def scene(path):
    """A rigid cylinder that sinks into the block, whose bottom is held."""
    cylinder = Obstacle("sphere", center=[0.0, RADIUS], radius=RADIUS, displacement=[0.0, -SINK])
    return composed(
        MeshSpec(path, order=2),
        {"block": Material(YOUNG, POISSON, G=SHEAR, angle=ANGLE)},
        {"bottom": [0.0, 0.0]},
        contacts=[Contact("top", obstacle=cylinder, name="cylinder")],
        petsc={"pc_type": "lu"},
    )


def half_width(folder, n):
    """Half width of the contact over its closed form for the force, n facets in it. *Collective.*"""
    path = make_mesh(whole_block, folder / "block.msh", n)
    points = points_of(scene(path), folder)
    force = share(points, slice(None), [0.0, -1.0])[1]
    closed, x = points["status"] > 0, points["x"][:, 0]
    middle, edge = 0.5 * (x[closed].max() + x[closed].min()), 0.5 * np.ptp(x[closed])
    inner = closed & (np.abs(x - middle) < INNER * edge)
    # p^2 is a parabola, whose zeros are the ends of the contact
    ends = np.roots(np.polyfit(x[inner], points["pressure"][inner] ** 2, 2))
    found = 0.5 * float(np.ptp(ends.real))
    return found / np.sqrt(2.0 * force * RADIUS * compliance() / np.pi)


CASES = {
    "orthotropic_half_plane": Case(
        "A rigid cylinder on an orthotropic half plane",
        f"Plane strain, a rigid cylinder of radius {RADIUS:g} sinks by {SINK:g} into a laminate, no friction: E = "
        f"{list(YOUNG)}, nu = {list(POISSON)}, G = {list(SHEAR)}, its fibres at {ANGLE:g} degrees to the surface. A "
        f"block of {2 * SIZE:g} by {SIZE:g}; cells of degree 2, n in the half width of the contact, which is about 1.",
        r"""     \ cylinder  /
      \_       _/
    ____`-----'____  x
      /  /  /  /
     /  /  /  /   fibres""",
        "S. G. Lekhnitskii, *Theory of Elasticity of an Anisotropic Body*, Mir 1981: the pressure is that of Hertz, "
        f"{JOHNSON}, section 4.2, with a^2 = 2 P R L / pi, L = -b22 Im(1 / mu1 + 1 / mu2), mu the roots of the "
        "characteristic equation of the compliance b of the half plane", "half width, fitted, over that of the closed "
        "form for the force",
        1.0, (5, 10, 20), half_width, (2e-2, 3e-3),
    ),
}  # fmt: skip
