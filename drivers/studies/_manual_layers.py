"""A case of the verification manual with a layer that lifts off its base: receding contact."""

from functools import partial

import numpy as np

from drivers._common import make_mesh
from drivers.studies._harness import composed
from drivers.studies._manual import Case, points_of
from meshes import layer_on_base
from pcontact.scene.model import Contact, Load, Material, MeshSpec

# of both bodies; half width of the strip that is loaded, in heights of the layer
MODULUS, NU, STRIP = 1e4, 0.3, 0.1
# terms of the pressure, points of the integrals over it and over wave numbers, largest wave number
TERMS, ALONG, WAVES, LARGEST = 10, 64, 96, 20.0
GOLDEN = 0.5 * (3.0 - np.sqrt(5.0))


def layer_equation(a):
    """Coefficients of the pressure for a half width a of the contact, and what is left of the equation.

    The pressure is sqrt(1 - t^2) times Chebyshev's polynomials U_2n of t = x / a. Layer (height 1, no friction) and
    half plane of one material have the same slope where they touch; all is in units of the load and of the plane
    modulus.
    """
    x, weight = np.polynomial.legendre.leggauss(WAVES)
    k, weight = 0.5 * LARGEST * (x + 1.0), 0.5 * LARGEST * weight
    # displacement of a face under equal pressures on both, and under opposite ones
    squeezed = 4.0 / k * np.sinh(0.5 * k) ** 2 / (k + np.sinh(k))
    bent = 4.0 / k * np.cosh(0.5 * k) ** 2 / (np.sinh(k) - k)
    angle, n = np.pi * np.arange(1, ALONG + 1) / (ALONG + 1), np.arange(TERMS)[:, None]
    polynomials = np.sin((2 * n + 1) * angle) * np.sin(angle) * np.pi / (ALONG + 1)
    # less the value at k = 0, which is that of the load: what both have in common would bend the layer without end
    transforms = a * polynomials @ (np.cos(a * np.outer(np.cos(angle), k)) - 1.0)
    load = np.sinc(k * STRIP / np.pi)
    place = np.pi * np.arange(1, 2 * TERMS) / (4.0 * TERMS)
    waves = np.sin(a * np.outer(np.cos(place), k)) * k * weight / np.pi
    # of what is beyond a half plane; that of two half planes is known
    own = 0.5 * (squeezed + bent) - 2.0 / k
    rows = -4.0 * np.cos((2 * n + 1) * place) - (waves @ (transforms * own).T).T
    right = waves @ (own * (1.0 - load) + (squeezed - 2.0 / k) * load)
    balance = 0.5 * np.pi * a * (np.arange(TERMS) == 0)
    table, right = np.vstack([rows.T, balance]), np.append(right, 1.0)
    found = np.linalg.lstsq(table, right, rcond=None)[0]
    return found, float(np.linalg.norm(table @ found - right))


def receding_contact():
    """Half width of the contact, and largest pressure over the mean one of the load on the height of the layer."""
    low, high = 1.2, 1.5
    while high - low > 1e-6:
        first, second = low + GOLDEN * (high - low), high - GOLDEN * (high - low)
        low, high = (low, second) if layer_equation(first)[1] < layer_equation(second)[1] else (first, high)
    width = 0.5 * (low + high)
    return width, float(layer_equation(width)[0] @ (-1.0) ** np.arange(TERMS))


def receding(what, folder, n):
    """Half width of the contact, or pressure in its middle, n cells in the height of the layer. *Collective.*"""
    scene = composed(
        MeshSpec(make_mesh(layer_on_base, folder / "layer.msh", n), order=2),
        dict.fromkeys(("layer", "base"), Material(MODULUS, NU)),
        {"symmetry": [0.0, "free"], "base_bottom": ["free", 0.0]},
        contacts=[Contact("layer_bottom", "base_top", name="pair")],
        loads=[Load("strip", pressure=1.0)],
        petsc={"pc_type": "lu"},
    )
    points = points_of(scene, folder)
    if what == "width":
        return float(points["weight"][points["status"] > 0].sum())
    x, pressure = points["x"][:, 0], points["pressure"]
    # even in x
    inner = x < 3.0 * STRIP
    return float(np.polynomial.polynomial.polyfit(x[inner] ** 2, pressure[inner], 2)[0] / (2.0 * STRIP))


WIDTH, LARGEST_PRESSURE = receding_contact()
DATA = (
    f"Plane strain. A layer of height 1 lies loose on a base, both E = {MODULUS:g}, nu = {NU:g}, no friction; a strip "
    f"of its upper side, {2.0 * STRIP:g} wide, is pressed by 1. The layer is 32 long, the base 120 wide and 60 deep, "
    "the half x >= 0 is computed. Cells of degree 2, n of them in the height of the layer, larger ones in the base: "
    "meshes do not match."
)
SKETCH = r"""            v v
    ______________________  layer
    `--___        ___--'
    ------`------'--------  base"""
SOURCE = (
    "the integral equation of L. M. Keer, J. Dundurs, K. C. Tsai, J. Appl. Mech. 39 (1972) 1115-1120, for equal "
    "materials and this strip, solved with polynomials of Chebyshev in the driver"
)
CASES = {
    "receding_width": Case(
        "A layer that lifts off its base: half width of the contact", DATA, SKETCH, SOURCE,
        "half width of the contact over the height of the layer", WIDTH, (10, 20, 40), partial(receding, "width"),
        (2e-2, 5e-3), "The width does not depend on the load. It is that of the points that are closed.", tiny=False,
    ),
    "receding_pressure": Case(
        "A layer that lifts off its base: pressure", f"The data of [the half width](receding_width.md): {DATA}", SKETCH,
        SOURCE, "pressure in the middle, fitted, times the height of the layer over the load", LARGEST_PRESSURE,
        (10, 20, 40), partial(receding, "pressure"), (1e-2, 3e-3), tiny=False,
    ),
}  # fmt: skip
