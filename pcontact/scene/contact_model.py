"""Contacts and obstacles of a scene as plain dataclasses; see `pcontact.scene.model`, which has the other tables."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

# group of facets that a contact of all surfaces takes: the whole boundary of all bodies
OUTER = "outer surfaces"

Table = Sequence[Sequence[float]]  # rows of (time, factor), or of (strain, stress)
Function = str | Callable  # "module.py:name" beside the scene, or the function itself


@dataclass
class Obstacle:
    """A rigid body without a mesh; points are vectors of the mesh dimension d.

    Parameters
    ----------
    shape : str
        "plane" (point, normal into the free space), "sphere" (center, radius; a circle in 2D), "cylinder"
        (point, axis, radius; 3D only), "level_set" (expression or function).
    point, normal, center, axis : sequence of float or None
        (d,) vectors; normal and axis of any length but zero.
    radius : float or None
        [length].
    inside : bool
        Sphere and cylinder: the free space is inside.
    function : str, callable or None
        Level set: phi(x, t) -> (n,), signed distance of points x (n, d) at time t, positive in free space.
    gradient : str, callable or None
        Level set: gradient of phi, (x, t) -> (n, d); absent: left to the program.
    expression : str or None
        Level set: phi as an expression of x, y, z, t, see `pcontact.scene.expression`; instead of `function`.
    displacement : sequence of float or None
        (d,) translation at factor 1; None stands still.
    amplitude : sequence of (time, factor) or None
        Factor of `displacement`; None is a ramp from 0 to 1 over the run.
    """

    shape: str
    point: Sequence[float] | None = None
    normal: Sequence[float] | None = None
    center: Sequence[float] | None = None
    axis: Sequence[float] | None = None
    radius: float | None = None
    inside: bool = False
    function: Function | None = None
    gradient: Function | None = None
    expression: str | None = None
    displacement: Sequence[float] | None = None
    amplitude: Table | None = None


@dataclass
class Contact:
    """A contact pair: a source surface, a target surface or an obstacle, the law, and the numerics.

    Parameters
    ----------
    source : str or None
        Group of facets where the integrals are taken; None with `all`.
    target : str or None
        Group of facets where points are projected; the same name as `source` is self contact.
    obstacle : Obstacle or None
        Instead of `target`.
    name : str or None
        Unique; None becomes "source-target" or "source-shape".
    friction : float or None
        Coulomb coefficient; None or 0 is frictionless.
    tresca : float or None
        Instead of `friction`: a fixed bound of the tangential traction, on the whole surface [stress].
    friction_limit : float or None
        With `friction`: the tangential traction is never larger [stress].
    adhesion : float or None
        With `friction`: tangential traction that closed points bear without any pressure [stress].
    bilateral : bool
        No separation: the gap stays closed, in tension too.
    unbiased : bool
        Both sides are source and target.
    all : bool
        The boundary of every body against that of every other one or, with `obstacle`, against that.
    self_contact : bool or None
        Whether a body is its own partner, too; None: yes where `target` is `source`, no with `all`.
    tied : bool
        The surfaces are glued together as they are.
    formulation : str or None
        "nitsche", "penalty" or "augmented_lagrangian".
    theta : float or None
        Nitsche variant 1, 0 or -1.
    gamma0 : float or None
        Dimensionless parameter; None is chosen from the material and the element.
    alpha : float or None
        Parameter of the tangential terms over that of the normal ones.
    adjoint : str or None
        "elastic" or "consistent": operator of the theta terms where source cells yield.
    quadrature : int or None
        Degree of the facet quadrature; None is chosen from the element.
    cut : bool or None
        Whether source facets are cut along the edges of the target; None is chosen from the element.
    search : str or None
        "closest_point" or "ray_tracing".
    search_radius : float or None
        Largest distance at which a partner is looked for [length]; None is chosen from the mesh.
    interference : str or None
        What an initial overlap means: "resolve" or "adjust".
    smooth_geometry : bool or None
        Whether gaps are those of the smooth surfaces that straight facets stand for.

    Notes
    -----
    The last eleven are None when not said, so that the command line comes before the scene and the scene
    before `CONTACT_DEFAULTS`; `pcontact.scene.validate.resolve_contacts` applies that order.
    """

    source: str | None = None
    target: str | None = None
    obstacle: Obstacle | None = None
    name: str | None = None
    friction: float | None = None
    tresca: float | None = None
    friction_limit: float | None = None
    adhesion: float | None = None
    bilateral: bool = False
    unbiased: bool = False
    all: bool = False
    self_contact: bool | None = None
    tied: bool = False
    formulation: str | None = None
    theta: float | None = None
    gamma0: float | None = None
    alpha: float | None = None
    adjoint: str | None = None
    quadrature: int | None = None
    cut: bool | None = None
    search: str | None = None
    search_radius: float | None = None
    interference: str | None = None
    smooth_geometry: bool | None = None

    def __post_init__(self):
        if self.name is None and self.all:
            self.name = "all" if self.obstacle is None else f"all-{getattr(self.obstacle, 'shape', 'obstacle')}"
        elif self.name is None and isinstance(self.source, str):
            partner = self.target if self.target is not None else getattr(self.obstacle, "shape", "obstacle")
            self.name = f"{self.source}-{partner}"

    @property
    def meets_itself(self) -> bool:
        """Whether a body is its own partner."""
        return bool(self.self_contact if self.all or self.self_contact is not None else self.target == self.source)


CONTACT_DEFAULTS = {
    "formulation": "nitsche",
    "theta": 0.0,
    "gamma0": None,
    "alpha": 1.0,
    "adjoint": "elastic",
    "quadrature": None,
    "cut": None,
    "search": "closest_point",
    "search_radius": None,
    "interference": "resolve",
    "smooth_geometry": False,
}
