"""The scene as plain dataclasses: the reader fills them from TOML, drivers fill them in Python.

Each key is declared here, and nowhere else, see `pcontact.scene.keys`. Nothing is checked here;
`pcontact.scene.validate.validate` checks every value, whoever wrote it, and turns numbers into float and lists into
tuples. Units are the user's own and must be consistent. None means "not said".
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

from pcontact.runtime.errors import input_error
from pcontact.runtime.files import GEOMETRIES
from pcontact.runtime.presets import PRESETS
from pcontact.runtime.rules import (
    ANY_TEXT,
    BOOLEAN,
    NON_NEGATIVE,
    POSITIVE,
    TEXT,
    Rule,
    choice,
    file,
    integer,
    number,
    one_of,
    sequence,
)
from pcontact.scene.integrators import INTEGRATORS, LEAST_ALPHA
from pcontact.scene.keys import (
    AMPLITUDE,
    AXES,
    COEFFICIENT,
    COEFFICIENTS,
    COMPONENTS,
    DIRECTION,
    EXPANSION,
    EXPRESSION,
    FOUNDATION,
    FUNCTION,
    HARDENING_CURVE,
    INERTIA,
    LAW,
    MOMENT,
    MOONEY_RIVLIN,
    NUMBERS,
    OGDEN,
    PLACE_CONDITION,
    POISSON,
    PRESSURE_OVERCLOSURE,
    ROTATION,
    SCALAR,
    SHEAR,
    STIFFNESSES,
    TERMS,
    VECTOR,
    VECTORS,
    WAYS,
    YOUNG,
    closed,
    key,
    keys,
    table,
)
from pcontact.scene.orthotropic import equivalent_poisson
from pcontact.scene.target import Budget, Target, preset_or_target

# Poisson's ratio above which cells are too stiff, or lose the digits of the stress, as they are: those of degree 1, and
# quadrilaterals and hexahedra of degree 2 (pressure of a surface pressed flat, 8 cells in the half width: error in L2
# 0.8 % at 0.46, 13 % at 0.499; 0.4 % with the mean dilatation)
LOCKING = 0.45
# the same of triangles and tetrahedra of degree 2, whose mean dilatation is but constant (3, 5, 9 and 39 % at 0.46,
# 0.48, 0.49, 0.499; 5.5 % with it; with 16 cells 1.3, 2.0, 3.4 and 19 %; 2.8 %)
POOR = 0.49
# planned load steps in the longest one, where their iterations say how long they are
LONGER = 4
# the smallest load step in parts of the planned one
SHORTEST = 1.0 / 1024.0
# settings whose answers may be wrong, which `Scene.allow_unsafe` lets run: gamma0 below the bound of coercivity,
# triangles and tetrahedra of degree 1 near nu = 0.5, a coarse source on a fine target in space, friction with several
# solutions, a mesh whose bodies are cut where cells do not meet facet to facet, supports that turn small strain far
UNSAFE = ("gamma0", "locking", "facet_sizes", "friction", "mesh", "turn")

# group of facets that a contact of all surfaces takes: the whole boundary of all bodies
OUTER = "outer surfaces"

Table = Sequence[Sequence[float]]  # rows of (time, factor), or of (strain, stress)
Function = str | Callable  # "module.py:name" beside the scene, or the function itself
Value = float | str | Callable  # a number, an expression, from Python a function of place and time

REGION = "name of a group of"
# conditions that forbid keys, and why
PLANE_STRESS, RINGS = '[mesh] kinematics = "plane_stress"', '[mesh] kinematics = "axisymmetric"'
NO_TURN = {RINGS: "rings do not turn in their plane"}
OF_RIGID = {"average = true": "a group on average has no mass of its own"}
ADJUSTED = {'interference = "adjust"': "it is adjusted to what the mesh has"}


def phases(what: str):
    """The key for the phases in which something acts."""
    names = sequence("a list of names of phases", TEXT)
    return key(names, f"phases in which {what}", default=None, otherwise="all", more="see [phases.md](phases.md)",
               requires=("[[phases]]",))  # fmt: skip


def amplitude(what: str = "factor of the value", timed: bool = False, requires=()):
    """The key for how a value goes over the time of the run; `timed`: of what may have expressions."""
    more = "; 1 where an expression has `t`" if timed else ""
    return key(AMPLITUDE, f"{what} over the time", default=None, otherwise=f"a ramp from 0 to 1 over the run{more}",
               requires=requires)  # fmt: skip


def of_angle(rule: Rule, what: str, unit: str = "", in_space: str = ""):
    """The key for a part of the axis of an angle."""
    return key(rule, what, default=None, unit=unit, otherwise="must be said", requires=("angle",), in_space=in_space)


# of a geometry; a file where gmsh's way to read it is told by its name
GEOMETRY = file(f"the name of a file {', '.join(GEOMETRIES)} beside the scene")


@table
class MeshSpec:
    """The mesh and its use."""

    file: str | Path = key(
        file("the name of a mesh file beside the scene"), "mesh file, beside the scene", option="mesh",
        more="`.msh` (gmsh), `.med`, Exodus, what meshio reads, or `.h5` from `pcontact convert`, which all ranks read "
        "together, see [mesh.md](mesh.md)",
    )  # fmt: skip
    order: int | None = key(
        integer(1, 2), "degree of the displacement", default=None,
        otherwise="that of the mesh, or what `accuracy` chooses", option="mesh_order",
        more="A mesh of degree 2 keeps its curved cells with either; with `geometry` it is of degree 2. 2 with a "
        "converted mesh needs `pcontact convert --order 2`",
    )  # fmt: skip
    kinematics: str = key(
        choice("plane_strain", "plane_stress", "axisymmetric"), "plane meshes only: what happens across the plane",
        default="plane_strain", more="see below; axisymmetric: x is the radius, y the axis",
    )  # fmt: skip
    mean_dilatation: bool | None = key(
        BOOLEAN, "cells take their mean volume change (B-bar), the cure for locking",
        default=None, otherwise="automatic", unless={PLANE_STRESS: "plane stress does not lock"},
        more="its mean in quadrilaterals and hexahedra of degree 1 and in triangles and tetrahedra of degree 2, its "
        "best linear function in quadrilaterals and hexahedra of degree 2. Automatic: quadrilaterals and hexahedra "
        f"in bodies with nu > {LOCKING:g} (those of degree 1 also where bodies may yield), triangles and tetrahedra of "
        f"degree 2 with nu > {POOR:g}; `pcontact check` says which bodies. Triangles and tetrahedra of degree 1 have "
        "no mean other than what they have",
    )  # fmt: skip
    serendipity: bool = key(
        BOOLEAN, "with a displacement of degree 2: quadrilaterals and hexahedra with 8 and 20 nodes", default=False,
        more="without those in the middles of faces and cells, as other programs have them; see [mesh.md](mesh.md)",
    )  # fmt: skip
    strain: str = key(
        choice("small", "finite"), "strain of the bodies that do not say it themselves", default="small",
        more="see [finite_strain.md](finite_strain.md)",
    )  # fmt: skip
    geometry: str | Path | None = key(
        GEOMETRY, "the geometry that the mesh was made of: new nodes come onto it", default=None, otherwise="none",
        more="in the units of the mesh. New nodes of meshes that `accuracy` refines come onto it and, unless "
        "`order = 1`, straight cells become curved; see [mesh.md](mesh.md#the-geometry-of-a-mesh)",
    )  # fmt: skip


# laws of finite strain
RUBBER = ("neo_hooke", "mooney_rivlin", "ogden")


@table
class Material:
    """Isotropic elasticity, or orthotropic where `E` is a list; von Mises plasticity as well where `yield_stress` or
    `hardening_curve` is given."""

    E: float | Sequence[float] = key(
        YOUNG, "Young's modulus; of an orthotropic material one along each axis", unit="stress"
    )
    nu: float | Sequence[float] = key(
        POISSON, "Poisson's ratio; of an orthotropic material nu12 is the contraction along axis 2 over the extension "
        "along axis 1, under a stress along axis 1",
    )  # fmt: skip
    yield_stress: float | None = key(
        POSITIVE, "yield stress of a uniaxial test: the material yields (von Mises)", default=None, unit="stress",
        otherwise="elastic, or see `hardening_curve`",
        more="With finite strain it is a Kirchhoff stress, over the logarithmic plastic strain",
    )  # fmt: skip
    hardening: float = key(
        NON_NEGATIVE, "with `yield_stress`: isotropic, d(yield stress) / d(equivalent plastic strain)",
        default=0.0, unit="stress", requires=("yield_stress | hardening_curve",),
    )  # fmt: skip
    kinematic_hardening: float = key(
        NON_NEGATIVE, "Prager: d(uniaxial back stress) / d(equivalent plastic strain)", default=0.0, unit="stress",
        requires=("yield_stress | hardening_curve",),
    )  # fmt: skip
    hardening_curve: Table | None = key(
        HARDENING_CURVE, "instead of `yield_stress` and `hardening`: yield stress over the equivalent plastic strain",
        default=None, unit="stress", otherwise="none", more="linear between the points, constant beyond the last",
        excludes=("yield_stress", "hardening"),
    )  # fmt: skip
    law: str = key(
        LAW, "with finite strain: elasticity; with small strain: the name of a law that a Python program has added",
        default="hencky",
        more="`hencky`: Hooke's law, with finite strain of logarithmic strain; the next three are rubber, see "
        "[finite_strain.md](finite_strain.md). `E` and `nu` are those of small strain with all of them. Laws that "
        "programs add: see [extending.md](extending.md)",
    )  # fmt: skip
    parameters: Sequence[float] | None = key(
        NUMBERS, "numbers for a law that a program has added", default=None, otherwise="none",
    )  # fmt: skip
    mooney_rivlin: Sequence[float] | None = key(
        MOONEY_RIVLIN, "with `law = \"mooney_rivlin\"`: c10 and c01", default=None, unit="stress", otherwise="none",
        requires=('law = "mooney_rivlin"',), more="`E` must be 4 (1 + nu) (c10 + c01)",
    )  # fmt: skip
    ogden: Table | None = key(
        OGDEN, "with `law = \"ogden\"`: mu [stress] and alpha of every term", default=None, otherwise="none",
        requires=('law = "ogden"',), more="`E` must be (1 + nu) sum(mu alpha)",
    )  # fmt: skip
    split: str | None = key(
        choice("multiplicative", "additive"), "with finite strain: of elastic and plastic strain", default=None,
        otherwise="multiplicative, with `kinematic_hardening` additive",
        more="Additive is right for plastic strains up to some 0.3, and the only one with kinematic hardening",
    )  # fmt: skip
    expansion: float | Sequence[float] | None = key(
        EXPANSION, "thermal expansion, for `[[temperatures]]`",
        default=None, unit="1 / temperature", otherwise="0", more="with small strain"
    )
    density: float | None = key(
        POSITIVE, "mass per volume, for `acceleration` and `angular_speed` of loads, and `[dynamics]`",
        default=None, unit="mass / length^3", otherwise="none"
    )
    G: Sequence[float] | None = key(
        SHEAR, "orthotropic: shear moduli", default=None, unit="stress", otherwise="must be said where `E` is a list",
    )  # fmt: skip
    axes: Sequence[Sequence[float]] | None = key(
        AXES, "orthotropic: a vector along axis 1, and one that spans with it the plane of axes 1 and 2", default=None,
        otherwise="[[1, 0, 0], [0, 1, 0]], the directions of the mesh", more="see below", excludes=("angle",),
    )  # fmt: skip
    angle: float | None = key(
        number(), "orthotropic, instead of `axes`: from x to axis 1, about z", default=None, unit="degrees",
        otherwise="0", more="positive: counterclockwise, from x to y",
    )  # fmt: skip
    point: Sequence[float] | None = key(
        VECTOR, "orthotropic: the axes go around an axis through this point", default=None, unit="length",
        otherwise="they are the same everywhere", more="x, y, z of `axes` and `angle` are then the radial, the hoop "
        "and the axial direction", unless={RINGS: "x, y, z of the axes are the radial, axial and hoop direction there"},
    )  # fmt: skip
    axis: Sequence[float] | None = key(
        DIRECTION, "with `point`, in space: direction of that axis, of any length", default=None,
        otherwise="must be said with `point`", requires=("point",), in_space="point",
    )  # fmt: skip

    @property
    def orthotropic(self) -> bool:
        """Return whether it has constants of its own along three axes."""
        return isinstance(self.E, list | tuple)

    @property
    def frame(self) -> Sequence[Sequence[float]]:
        """Vectors along axis 1, and in the plane of axes 1 and 2."""
        if self.angle is not None:
            cosine, sine = math.cos(math.radians(self.angle)), math.sin(math.radians(self.angle))
            return (cosine, sine, 0.0), (-sine, cosine, 0.0)
        return self.axes or ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))

    @property
    def poisson(self) -> float:
        """Poisson's ratio; of an orthotropic material that of the nearest isotropic one."""
        return equivalent_poisson(self.E, self.nu, self.G) if self.orthotropic else self.nu

    @property
    def plastic(self) -> bool:
        """Return whether it may yield."""
        return self.yield_stress is not None or self.hardening_curve is not None

    @property
    def added(self) -> bool:
        """Return whether its law is one that a program has added."""
        return self.law not in ("hencky", *RUBBER)

    @property
    def multiplicative(self) -> bool:
        """Return whether finite elastic and plastic strain are split multiplicatively."""
        return self.split == "multiplicative" if self.split is not None else self.kinematic_hardening == 0.0

    @property
    def terms(self) -> Table:
        """Terms (mu, alpha) of rubber in the form of Ogden; none for Hencky's law."""
        if self.law == "ogden":
            return self.ogden
        if self.law == "mooney_rivlin":
            first, second = self.mooney_rivlin
            return [(2.0 * first, 2.0), (-2.0 * second, -2.0)]
        return [(self.E / (2.0 * (1.0 + self.nu)), 2.0)] if self.law == "neo_hooke" else []


@table
class Body:
    """A group of cells and the name of the material it is made of."""

    region: str = key(TEXT, f"{REGION} cells", group="cells")
    material: str = key(TEXT, "name of a material")
    strain: str | None = key(
        choice("small", "finite"), "small strain, or any", default=None, otherwise="that of `[mesh]`",
        more="see [finite_strain.md](finite_strain.md)",
    )  # fmt: skip
    integration: str = key(
        choice("full", "reduced"), "cells of 8 and 20 nodes: integrals at 3 points in each direction, or at 2",
        default="full", more="reduced: with `serendipity = true`, not with axial symmetry; see [mesh.md](mesh.md)",
    )  # fmt: skip
    order: int | None = key(
        integer(1, 2), "degree of the displacement", default=None, otherwise="that of `[mesh]`",
        more="1 in a scene with `order = 2`: nodes in the middles follow the vertices; see [mesh.md](mesh.md)",
    )  # fmt: skip
    phases: Sequence[str] | None = phases("it is there; in a later one than the first it begins without strain")
    initial_velocity: Sequence[Value] | None = key(
        VECTORS, "with `[dynamics]`: velocity at the beginning", default=None, kw_only=True, unit="length / time",
        requires=("[dynamics]",), otherwise="at rest", more="see [dynamics.md](dynamics.md)",
    )  # fmt: skip
    initial_displacement: Sequence[Value] | None = key(
        VECTORS, "with `[dynamics]`: displacement at the beginning", default=None, kw_only=True, unit="length",
        requires=("[dynamics]",), otherwise="none", more="whatever holds it there has let go of it",
    )  # fmt: skip
    mass_damping: float = key(
        NON_NEGATIVE, "with `[dynamics]`: damping over mass (Rayleigh), of slow motions", default=0.0, kw_only=True,
        unit="1 / time", more="it resists rigid motions, too", requires=("[dynamics]",),
    )  # fmt: skip
    stiffness_damping: float = key(
        NON_NEGATIVE, "with `[dynamics]`: damping over elastic stiffness (Rayleigh), of fast motions", default=0.0,
        kw_only=True, unit="time", more="with small strain", requires=("[dynamics]",),
    )  # fmt: skip
    # of a scene of one phase (`pcontact.scene.phases`): not there; number of the phase since which it has been
    absent: bool = False
    since: int = 0


@table
class Obstacle:
    """A rigid body without a mesh; points are vectors of the mesh dimension d."""

    shape: str = key(
        choice("plane", "sphere", "cylinder", "punch", "wedge", "cone", "torus", "mesh", "level_set"),
        "shape; a sphere in the plane is a circle, cylinder, cone and torus are for space only", more="see below",
    )  # fmt: skip
    point: Sequence[float] | None = key(
        VECTOR, "plane: a point of it; cylinder: a point of its axis; punch: middle of its face; wedge and cone: the "
        "tip", default=None, unit="length",
    )  # fmt: skip
    normal: Sequence[float] | None = key(
        DIRECTION, "plane, punch, wedge, cone: where the plane, the face or the tip looks, into the free space; of any "
        "length", default=None,
    )  # fmt: skip
    center: Sequence[float] | None = key(VECTOR, "sphere and torus: the centre", default=None, unit="length")
    axis: Sequence[float] | None = key(
        DIRECTION, "cylinder and torus: direction of the axis; punch with `width` and wedge, in space: that of the "
        "edge, square to `normal`; of any length", default=None,
    )  # fmt: skip
    radius: float | None = key(
        POSITIVE, "sphere, cylinder, round punch, tube of a torus", default=None, unit="length",
    )  # fmt: skip
    width: float | None = key(
        POSITIVE, "punch: instead of `radius`, one that is as wide everywhere along `axis`",
        default=None, kw_only=True, unit="length",
    )  # fmt: skip
    ring_radius: float | None = key(
        POSITIVE, "torus: of the middle of the tube", default=None, kw_only=True, unit="length"
    )
    half_angle: float | None = key(
        number(above=0, below=90), "wedge and cone: between `normal` and a flank", default=None, kw_only=True,
        unit="degrees",
    )  # fmt: skip
    edge_radius: float | None = key(
        NON_NEGATIVE, "punch: of the rounded edge of the face; wedge and cone: of the rounded tip",
        default=None, kw_only=True, unit="length", otherwise="0: sharp",
    )  # fmt: skip
    file: str | Path | None = key(
        file("the name of a mesh file beside the scene"), "mesh: file with the facets of a surface", default=None,
        kw_only=True,
        more="in space triangles and quadrilaterals, in the plane segments, of degree 1 or 2; of any format of meshes, "
        "and `.stl`",
    )  # fmt: skip
    region: str | None = key(
        TEXT, f"mesh: {REGION} facets in the file", default=None, kw_only=True, otherwise="all facets in it"
    )
    inside: bool = key(BOOLEAN, "sphere, cylinder, mesh: the free space is inside, or on the other side", default=False)
    function: Function | None = key(
        FUNCTION, "level set: instead of `expression` a program, beside the scene", default=None,
        more="[running.md](running.md) says when; `function(x, t)` is the signed distance (n,) of points x (n, d) at "
        "time t, positive in the free space",
    )  # fmt: skip
    gradient: Function | None = key(
        FUNCTION, "level set: gradient of `function`", default=None, otherwise="left to the program",
        more="`gradient(x, t)` is (n, d)",
    )  # fmt: skip
    expression: str | None = key(
        EXPRESSION, "level set: signed distance, positive in the free space", default=None,
        more='an expression of `x`, `y`, `z` and the time `t`, such as `"sqrt(x**2 + y**2) - 1 + 0.1*t"`, see below',
        excludes=("function", "gradient"),
    )  # fmt: skip
    displacement: Sequence[float] | None = key(
        VECTOR, "translation at factor 1", default=None, unit="length", otherwise="it stands still"
    )
    amplitude: Table | None = amplitude("factor of `displacement` and `angle`", requires=("displacement | angle",))
    angle: float | None = key(
        number(), "it turns by this angle at factor 1", default=None, unit="degrees", otherwise="none", unless=NO_TURN,
        more="see below. Positive: counterclockwise, seen from where `turn_axis` points to",
    )  # fmt: skip
    pivot: Sequence[float] | None = key(
        VECTOR, "with `angle`: a point of the axis that it turns about; in the plane the centre",
        default=None, unit="length",
        otherwise="`point` or `center`; of a mesh the mean place of its nodes, of a level set it must be said",
        requires=('angle | shape = "mesh"',),  # the moment on a mesh is about its pivot, whether it turns or not
    )  # fmt: skip
    turn_axis: Sequence[float] | None = key(
        DIRECTION, "with `angle`, in space: direction of the axis that it turns about, of any length", default=None,
        otherwise="of a cylinder its `axis`; else it must be said", requires=("angle",),
    )  # fmt: skip

    @property
    def turns(self) -> bool:
        """Return whether it turns."""
        return bool(self.angle)

    @property
    def moves(self) -> bool:
        """Return whether it is displaced or turns."""
        return self.turns or (self.displacement is not None and any(self.displacement))


@table
class Contact:
    """A contact pair: a source surface, a target surface or an obstacle, the law, and the numerics.

    Numerics are None when not said, so that the command line comes before the scene and the scene before
    `CONTACT_DEFAULTS`; `pcontact.scene.validate.resolve_contacts` applies that order.
    """

    source: str | None = key(
        TEXT, f"{REGION} facets on the boundary of a body: the integrals are taken here", default=None, group="facets",
        otherwise="must be said, unless `surfaces` or `all`",
    )  # fmt: skip
    target: str | None = key(
        TEXT, f"{REGION} facets: the points are projected here", default=None, otherwise="must be said, or `obstacle`",
        group="facets",
        more="Bodies in contact do not share nodes. The same group as `source`: self contact, see below",
    )  # fmt: skip
    obstacle: Obstacle | None = field(default=None, metadata={"table": Obstacle})
    name: str | None = key(
        TEXT, "name of the contact, unique", default=None, otherwise="source-target; of `all`: `all`",
    )  # fmt: skip
    friction: Value | None = key(
        COEFFICIENT, "Coulomb's coefficient, or an expression of the place in the undeformed source and the time",
        default=None, otherwise="0", more="With `kinetic_friction`: the static one",
    )  # fmt: skip
    kinetic_friction: Value | None = key(
        COEFFICIENT, "with `friction`: the coefficient of points that slip fast",
        default=None, kw_only=True, otherwise="that of `friction`", more="see below",
        requires=("friction", "friction_decay"), excludes=("law", "adhesion"),
    )  # fmt: skip
    friction_decay: float | None = key(
        POSITIVE, "with `kinetic_friction`: how the coefficient goes there with the speed of slip", default=None,
        kw_only=True, unit="time / length", otherwise="must be said", requires=("kinetic_friction",),
    )  # fmt: skip
    tresca: float | None = key(
        NON_NEGATIVE, "instead of `friction`: a fixed bound of the tangential traction, on the whole surface",
        default=None, unit="stress", otherwise="none", excludes=("friction",),
    )  # fmt: skip
    friction_limit: float | None = key(
        POSITIVE, "with `friction`: the tangential traction is never larger",
        default=None, unit="stress", otherwise="none", requires=("friction | law",),
    )  # fmt: skip
    adhesion: float | None = key(
        NON_NEGATIVE, "with `friction`: tangential traction that closed points bear without pressure",
        default=None, unit="stress", otherwise="0", requires=("friction | law",),
    )  # fmt: skip
    law: str | None = key(
        TEXT, "instead of `friction` and `tresca`: the name of a law of friction that a Python program has added",
        default=None, excludes=("tresca", "tied"), otherwise="none",
        more="`friction`, `friction_limit` and `adhesion` may be numbers of it; see [extending.md](extending.md)",
    )  # fmt: skip
    bilateral: bool = key(
        BOOLEAN, "no separation: the gap is closed, and stays so, in tension too", default=False,
        more="Places of the source that jut out over the border of the target are free",
    )  # fmt: skip
    unbiased: bool = key(
        BOOLEAN, "both surfaces are source and target", default=False, more="see below. Self contact always is",
        unless={"obstacle": "an obstacle has no facets"},
    )  # fmt: skip
    all: bool = key(
        BOOLEAN, "instead of `source` and `target`: every body against every other one", default=False,
        more="see below. With `obstacle`, instead of `source`: every body against the obstacle",
    )  # fmt: skip
    self_contact: bool | None = key(
        BOOLEAN, "whether a body is its own partner, too", default=None,
        otherwise="of `all`: false, of a surface with itself: true",
        more="where such a surface is flat or bulges everywhere it must be said",
    )  # fmt: skip
    tied: bool = key(
        BOOLEAN, "the surfaces are glued together as they are", default=False, more="see below",
        excludes=("friction", "tresca", "bilateral", "unbiased", "obstacle", "interference", "smooth_geometry",
                  "adjust_within", "clearance", "interference_amplitude", "pressure_overclosure", "kinetic_friction"),
    )  # fmt: skip
    formulation: str | None = key(
        choice("nitsche", "penalty", "augmented_lagrangian"), "formulation of the contact conditions",
        default="nitsche", option="contact_formulation", resolved=True, more="see below; pairs of one scene may differ",
    )  # fmt: skip
    theta: float | None = key(
        one_of(1, 0, -1), "variant of Nitsche's method: 1 (symmetric), 0 (fewest terms), -1 (stable for every gamma0)",
        default=0.0, option="contact_theta", resolved=True, more="with `[dynamics]` 1 where it is not said and no body "
        "may yield, see [dynamics.md](dynamics.md)",
    )  # fmt: skip
    gamma0: float | None = key(
        POSITIVE, "dimensionless parameter of the formulation; larger: stiffer contact", default=None,
        otherwise="2, 1, 1 for theta 1, 0, -1 (half where `unbiased` has the traction of each source alone); "
        "penalty 3, augmented Lagrangian 1", option="contact_gamma0", resolved=True,
    )  # fmt: skip
    alpha: float | None = key(
        POSITIVE, "with friction: parameter of the tangential terms over that of the normal ones", default=None,
        otherwise="theta 0: 4 mu / (lambda + 2 mu) of the source, at most 1; else 1", option="contact_alpha",
        resolved=True,
    )  # fmt: skip
    adjoint: str | None = key(
        choice("elastic", "consistent"), "with theta = 1 or -1, where source cells yield: operator of the adjoint term",
        default="elastic", option="contact_adjoint", resolved=True,
        more="that of elasticity, or `consistent` with the traction's derivative",
    )  # fmt: skip
    traction: str | None = key(
        choice("both", "source"), "with Nitsche's method: whose stress the traction is taken from", default="both",
        option="contact_traction", resolved=True, kw_only=True, otherwise="both; with `-error` of a pressure source",
        more="`both` sides, see [formulations.md](formulations.md)",
    )  # fmt: skip
    quadrature: int | None = key(
        integer(1, 20), "degree of the quadrature on source facets", default=None, otherwise="from the element",
        option="contact_quadrature", resolved=True,
    )  # fmt: skip
    cut: bool | None = key(
        BOOLEAN, "whether source facets are cut along the edges of the target", default=None,
        otherwise="from the element", option="contact_cut", resolved=True, more="see below",
    )  # fmt: skip
    search: str | None = key(
        choice("closest_point", "ray_tracing"), "how a source point finds its partner", default="closest_point",
        option="contact_search", resolved=True, more="`ray_tracing`: along the normal of the source",
    )  # fmt: skip
    search_radius: float | None = key(
        POSITIVE, "largest distance at which a partner is looked for", default=None, unit="length",
        otherwise="from the surfaces", resolved=True,
        more="From the surfaces: 0.15 of the extent of the smaller surface (half of it where a body is not held), "
        "and as much more as the undeformed bodies overlap if that is deeper; `all`: 0.15 of the extent of the "
        "smallest body; `tied`: the largest facet. The extent is the length of a straight line that is as wide "
        "spread, such as the diagonal of a square: it does not depend on directions",
    )  # fmt: skip
    interference: str | None = key(
        choice("resolve", "adjust"), "what an initial overlap means", default="resolve", resolved=True,
        more="it is pushed apart (`resolve`: a shrink fit), or taken as the unloaded state (`adjust`)",
    )  # fmt: skip
    adjust_within: float | None = key(
        NON_NEGATIVE, "with `interference = \"adjust\"`: gaps of the undeformed bodies up to this are closed as well",
        default=None, unit="length", otherwise="0", more="without strain; see below",
        requires=('interference = "adjust"',),
    )  # fmt: skip
    clearance: float | None = key(
        number(), "gap of the undeformed bodies wherever they face each other, whatever the mesh has",
        default=None, unit="length", otherwise="that of the mesh",
        more="Negative: an overlap, which is pushed apart; see below", unless=ADJUSTED,
    )  # fmt: skip
    interference_amplitude: Table | None = key(
        AMPLITUDE, "factor of the initial overlap, and of the gap that `bilateral` closes, over the time",
        default=None, otherwise="all of it acts from the beginning, with `[dynamics]` over the first load step",
        more="see below", unless=ADJUSTED,
    )  # fmt: skip
    pressure_overclosure: float | Table | None = key(
        PRESSURE_OVERCLOSURE, "a soft layer between the surfaces: contact pressure over overclosure, the negative gap",
        default=None, unit="stress / length, or length and stress", otherwise="none, the surfaces are hard",
        more="see below",
    )  # fmt: skip
    stick_stiffness: float | None = key(
        POSITIVE, "with `pressure_overclosure` and friction: tangential traction over slip where points stick",
        default=None, unit="stress / length", otherwise="from the element, as of the penalty method",
        requires=("pressure_overclosure", "friction | tresca | adhesion | law | [[phases]]"),
    )  # fmt: skip
    smooth_geometry: bool | None = key(
        BOOLEAN, "gaps are those of the smooth surfaces that facets stand for", default=False,
        option="contact_smooth_geometry", resolved=True, more="see below",
    )  # fmt: skip
    phases: Sequence[str] | None = phases("it acts")
    surfaces: Sequence[str] | None = key(
        sequence("a list of two names of regions of facets", TEXT, (2,)),
        "instead of `source` and `target`: two surfaces, of which the program takes one as the source", default=None,
        kw_only=True, otherwise="none", more="see below",
    )  # fmt: skip
    # of a scene of one phase (`pcontact.scene.phases`): points that are closed stay as they are
    held: bool = False

    def __post_init__(self):
        if isinstance(self.surfaces, list | tuple) and len(self.surfaces) == 2 and self.source is self.target is None:
            # which is which is known with the mesh, see `pcontact.pairs.oriented`
            self.source, self.target = self.surfaces
        if self.name is None and self.all:
            self.name = "all" if self.obstacle is None else f"all-{getattr(self.obstacle, 'shape', 'obstacle')}"
        elif self.name is None and isinstance(self.source, str):
            partner = self.target if self.target is not None else getattr(self.obstacle, "shape", "obstacle")
            self.name = f"{self.source}-{partner}"

    @property
    def meets_itself(self) -> bool:
        """Return whether a body is its own partner."""
        return bool(self.self_contact if self.all or self.self_contact is not None else self.target == self.source)


# numerics of a contact: what a key is where neither the command line nor the scene says it
CONTACT_DEFAULTS = {name: one.default for name, one in keys(Contact).items() if one.resolved}


@table
class Displacement:
    """Prescribed displacement of a group of cells, facets, edges or vertices; with `angle` a turn as well."""

    region: str = key(TEXT, f"{REGION} cells, facets, edges or vertices", group="any")
    value: Sequence[Value] = key(
        COMPONENTS, 'a number, `"free"`, or an expression of the place in the mesh, for each of the d directions',
        unit="length", more="see below",
    )  # fmt: skip
    amplitude: Table | None = amplitude("factor of `value` and `angle`", True)
    angle: float | None = key(
        number(), "the group turns by this angle, as a rigid body", default=None, unit="degrees", otherwise="none",
        requires=("point",), unless=NO_TURN,
        more="see below. Positive: counterclockwise, seen from where `axis` points to",
    )  # fmt: skip
    point: Sequence[float] | None = of_angle(
        VECTOR, "with `angle`: a point of the axis; in the plane the centre", "length"
    )
    axis: Sequence[float] | None = of_angle(
        DIRECTION, "with `angle`, in space: direction of the axis, of any length", in_space="angle"
    )
    phases: Sequence[str] | None = phases("it holds")
    absolute: bool = key(
        BOOLEAN, "where it begins with a later phase: `value` counts from the undeformed place", default=False,
        more="nodes go there from where they are along a ramp over that phase. Otherwise it counts from where they are",
    )  # fmt: skip

    @property
    def turns(self) -> bool:
        """Return whether it turns what it holds."""
        return bool(self.angle)


@table
class Load:
    """Pressure or traction on facets, forces in cells, or a total force and moment on any group."""

    region: str | None = key(
        TEXT, f"{REGION} facets (`pressure`, `traction`), of any kind (`force`, `moment`), or of cells", default=None,
        otherwise="must be said, unless `at`", group=lambda load: load.kinds,
    )  # fmt: skip
    pressure: Value | None = key(
        SCALAR, "positive in compression", default=None, unit="stress", more="Exactly one must be said: of this, "
        "`traction`, `body_force`, `acceleration`, `angular_speed`, or `force` and `moment`",
        one_of=("traction", "body_force", "acceleration", "angular_speed", "force | moment"),
    )  # fmt: skip
    traction: Sequence[Value] | None = key(VECTORS, "force per area", default=None, unit="stress")
    body_force: Sequence[Value] | None = key(VECTORS, "force per volume", default=None, unit="stress / length")
    amplitude: Table | None = amplitude(timed=True)
    follower: bool = key(
        BOOLEAN, "with `pressure`: it acts on the deformed surface, along its normal there", default=False,
        requires=("pressure",), unless={PLANE_STRESS: "the thickness is not followed"},
        more="see below. Otherwise forces are those of the undeformed surface, whatever becomes of it",
    )  # fmt: skip
    force: Sequence[float] | None = key(
        VECTOR, "total force on the group, spread evenly, or at a node, see `at`",
        default=None, unit="force", more="see below"
    )
    moment: float | Sequence[float] | None = key(
        MOMENT, "total moment on the group, about its centroid", default=None, unit="force length",
        more="with `force` or alone; see below", unless=NO_TURN,
    )  # fmt: skip
    point: Sequence[float] | None = key(
        VECTOR, "with `force` or `moment`: where the force acts, and of what point the report says displacement and "
        "rotation; with `angular_speed`: a point of the axis", default=None, unit="length",
        otherwise="the centroid of the group", requires=("force | moment | angular_speed",), unless=NO_TURN,
    )  # fmt: skip
    at: Sequence[float] | None = key(
        VECTOR, "with `force`: it acts at the node that is nearest to this place, of the group or of the mesh",
        default=None, unit="length", otherwise="on the whole group", requires=("force | moment",),
        excludes=("moment", "point"),
    )  # fmt: skip
    within: float | None = key(
        POSITIVE, "with `at`: how far the node may be from there",
        default=None, unit="length", otherwise="1e-6 of the size of the mesh", requires=("at",),
    )  # fmt: skip
    acceleration: Sequence[Value] | None = key(
        VECTORS, "force per mass, such as that of gravity, times the `density` of the bodies",
        default=None, unit="length / time^2"
    )
    angular_speed: float | None = key(
        number(), "the centrifugal force of bodies that turn about an axis, seen by who turns with them", default=None,
        unit="radian / time", more="The amplitude is a factor of the speed, the force goes with its square; see below",
    )  # fmt: skip
    axis: Sequence[float] | None = key(
        DIRECTION, "with `angular_speed`, in space: direction of the axis through `point`, of any length", default=None,
        otherwise="must be said", requires=("angular_speed",), in_space="angular_speed",
    )  # fmt: skip
    name: str | None = key(
        TEXT, "with `force` or `moment`: its name in report and history, unique",
        default=None, otherwise="that of the group", requires=("force | moment",),
    )  # fmt: skip
    phases: Sequence[str] | None = phases("it acts")

    @property
    def total(self) -> bool:
        """Return whether its resultant is given."""
        return self.force is not None or self.moment is not None

    @property
    def kinds(self) -> str:
        """Of what its group is."""
        on_facets = self.pressure is not None or self.traction is not None
        return "any" if self.total else "facets" if on_facets else "cells"


@table
class Coupling:
    """A group that moves with a reference point, as a rigid body or on average, with small turns."""

    region: str = key(TEXT, f"{REGION} facets, cells, edges or vertices, not in a line", group="any")
    point: Sequence[float] | None = key(
        VECTOR, "the reference point", default=None, unit="length", otherwise="the mean place of the nodes of the group"
    )
    displacement: Sequence[float | str] | None = key(
        WAYS, 'of the point: a number, or `"free"`, for each of the d directions',
        default=None, unit="length", otherwise="free"
    )
    rotation: float | str | Sequence[float | str] | None = key(
        ROTATION, "of the group, about the axes of the mesh", default=None, unit="radian", otherwise="free"
    )
    amplitude: Table | None = amplitude("factor of `displacement` and `rotation`")
    name: str | None = key(TEXT, "its name in report and history, unique", default=None, otherwise="that of the group")
    mass: float = key(
        NON_NEGATIVE, "with `[dynamics]`: of the point, beside that of its cells", default=0.0, kw_only=True,
        unit="mass", more="no load per mass acts on it", requires=("[dynamics]",), unless=OF_RIGID,
    )  # fmt: skip
    inertia: float | Sequence[float] = key(
        INERTIA, "with `[dynamics]`: moment of inertia about the point, beside that of its cells", default=0.0,
        kw_only=True, unit="mass length^2", requires=("[dynamics]",), unless={**OF_RIGID, **NO_TURN},
    )  # fmt: skip
    average: bool = key(
        BOOLEAN, "the group moves so on average alone, and is free to deform", default=False, more="see below"
    )


@table
class Pretension:
    """A section across a bolt, whose sides are drawn together by a force or by a length."""

    region: str = key(
        TEXT, f"{REGION} facets in a plane across a body, from one side of it to the other", group="facets"
    )
    force: float | None = key(
        number(), "tension of the section",
        default=None, unit="force", more="Exactly one must be said: of this and `shortening`", one_of=("shortening",),
    )  # fmt: skip
    shortening: float | None = key(
        number(), "by which the sides are drawn into each other", default=None, unit="length",
    )  # fmt: skip
    amplitude: Table | None = amplitude()
    name: str | None = key(TEXT, "its name in report and history, unique", default=None, otherwise="that of the group")
    phases: Sequence[str] | None = phases("it draws; in all others the sides stay as near as they are")
    # of a scene of one phase (`pcontact.scene.phases`): the sides stay
    locked: bool = False


@table
class Equation:
    """A linear equation between components of the displacement: the sum of its terms is zero."""

    terms: Sequence[tuple[str, str, float]] = key(
        TERMS, "a group of one node, a direction, and the coefficient of the displacement there", more="see below"
    )

    @property
    def region(self) -> str:
        """Group of the first term; empty where that is not one, before it has been checked."""
        first = self.terms[0] if isinstance(self.terms, list | tuple) and self.terms else None
        return first[0] if isinstance(first, list | tuple) and first else ""


@table
class Periodic:
    """Two groups of nodes in pairs: those of one move as their partners do, turned with them."""

    region: str = key(TEXT, f"{REGION} any kind, whose nodes follow", group="any")
    partner: str = key(TEXT, f"{REGION} any kind: each node of `region` is where one of these comes to", group="any")
    translation: Sequence[float] | None = key(
        VECTOR, "from `partner` to `region`", default=None, unit="length", more="This, `angle`, or both must be said",
        any_of=("angle",),
    )  # fmt: skip
    angle: float | None = key(
        number(), "`partner` comes to `region` by this turn", default=None, unit="degrees", otherwise="none",
        requires=("point",), unless=NO_TURN, more="Positive: counterclockwise, seen from where `axis` points to",
    )  # fmt: skip
    point: Sequence[float] | None = of_angle(
        VECTOR, "with `angle`: a point of the axis; in the plane the centre", "length"
    )
    axis: Sequence[float] | None = of_angle(
        DIRECTION, "with `angle`, in space: direction of the axis, of any length", in_space="angle"
    )
    within: float | None = key(
        POSITIVE, "how far a node may be from where its partner comes to", default=None, unit="length",
        otherwise="1e-4 of the extent of `region`",
    )  # fmt: skip


@table
class Temperature:
    """Temperature of cells, for the thermal strain of bodies with `expansion`."""

    value: Value | None = key(
        SCALAR, "temperature, or an expression of the place in the undeformed mesh and the time", default=None,
        unit="temperature", more="Exactly one must be said: of this, and `file` with `field`", one_of=("file",),
    )  # fmt: skip
    region: str | None = key(TEXT, f"{REGION} cells", default=None, otherwise="all cells", group="cells")
    reference: float = key(number(), "temperature without thermal strain", default=0.0, unit="temperature")
    amplitude: Table | None = amplitude("factor of the difference of temperature and `reference`", True)
    file: str | Path | None = key(
        file("the name of a file beside the scene"), "file with temperatures of the nodes of the mesh", default=None,
        otherwise="none", more="of any format whose fields meshio reads, such as `.vtu`, `.vtk` or gmsh's `.msh`",
        requires=("field",),
    )  # fmt: skip
    field: str | None = key(
        TEXT, "with `file`: name of the field of numbers at nodes", default=None, otherwise="must be said",
        requires=("file",),
    )  # fmt: skip


@table
class Spring:
    """Springs between a group and the ground, without force in the undeformed state."""

    region: str = key(
        TEXT, f"{REGION} facets; with `stiffness` of any kind",
        group=lambda spring: "any" if spring.per_area is None else "facets",
    )  # fmt: skip
    per_area: float | Sequence[float] | None = key(
        FOUNDATION, "stiffness per area of facets, along their undeformed normal or in each direction", default=None,
        unit="stress / length", more="Exactly one of the two must be said", one_of=("stiffness",),
    )  # fmt: skip
    stiffness: Sequence[float] | None = key(
        STIFFNESSES, "stiffness of the whole group in each direction, spread evenly",
        default=None, unit="force / length"
    )
    name: str | None = key(TEXT, "its name in report and history, unique", default=None, otherwise="that of the group")
    phases: Sequence[str] | None = phases("they act")


@table
class Region:
    """A group that the mesh does not have, by where its members are."""

    name: str = key(TEXT, "its name, for `region`, `source`, ... of other tables; none that the mesh has")
    kind: str = key(
        choice("cells", "facets", "nodes"), "of what it is", default="facets",
        more="cells by their middles, facets of the boundary by all of their vertices",
    )  # fmt: skip
    where: str | None = key(
        PLACE_CONDITION, "which of them belong to it, in the undeformed mesh", default=None, otherwise="all",
        more="== is meant up to 1e-6 of the extent of the mesh; see below",
    )  # fmt: skip
    of: str | None = key(
        TEXT, "name of a group of cells, such as that of a body, whose cells, facets or nodes they are", default=None,
        otherwise="of all cells",
    )  # fmt: skip


@table
class Phase:
    """A part of the run, with load steps of its own."""

    name: str = key(TEXT, "its name in report and history, unique")
    duration: float = key(POSITIVE, "it takes so long; the run ends with the last phase", default=1.0, unit="time")
    count: int | None = key(
        integer(1, 1_000_000), "equal load steps to start with", default=None, otherwise="`count` of `[steps]`"
    )
    friction: Mapping[str, Value] | None = key(
        COEFFICIENTS, "Coulomb's coefficient of contacts in this phase, by their names",
        default=None, otherwise="their own",
    )  # fmt: skip
    tied: Sequence[str] = key(
        sequence("a list of names of contacts", TEXT), "contacts whose closed points stay as they are", default=(),
        otherwise="none", more="see [phases.md](phases.md)",
    )  # fmt: skip


@table
class Steps:
    """The run from time 0 to `end` in `count` equal steps to start with."""

    end: float = key(
        POSITIVE, "time at the end of the run", default=1.0, unit="time",
        more="not with `[[phases]]`, which have durations", unless={"[[phases]]": "the run ends with the last phase"},
    )  # fmt: skip
    count: int = key(
        integer(1, 1_000_000), "equal load steps to start with", default=1, option="steps_count",
        more="corners of amplitudes and expressions are met",
    )  # fmt: skip
    min_step: float | None = key(
        POSITIVE, "smallest load step: a step that fails is halved down to this", default=None, unit="time",
        otherwise="end / count / 1024", option="steps_min",
    )  # fmt: skip
    control: str = key(
        choice("fixed", "auto"), "how long load steps are", default="fixed", option="steps_control",
        more="`fixed`: as planned, shorter only after one that failed; `auto`: begins so, and then makes the next one "
        "shorter where Newton's method took many iterations, and longer where it took few",
    )  # fmt: skip
    max_step: float | None = key(
        POSITIVE, "with `control = \"auto\"`: longest load step",
        default=None, unit="time", otherwise="4 end / count", option="steps_max", requires=('control = "auto"',),
    )  # fmt: skip
    viscous_stabilisation: float | None = key(
        POSITIVE, "viscosity that resists every motion, for bodies that snap", default=None,
        unit="stress time / length^2", otherwise="none", option="steps_viscous_stabilisation",
        more="see below. The report has its work, which is to be small against that of the stresses",
    )  # fmt: skip
    through_snaps: str | None = key(
        choice("dynamic"), "what becomes of bodies that find no equilibrium at the smallest load step", default=None,
        otherwise="the run ends", more="`dynamic`: they go on with inertia, which a `density` gives them, until they "
        "rest; see below", unless={"[dynamics]": "bodies have inertia anyway"},
    )  # fmt: skip

    @property
    def smallest_step(self) -> float:
        """`min_step`, or what stands for it when it is not said [time]."""
        return self.end / self.count * SHORTEST if self.min_step is None else self.min_step

    @property
    def longest_step(self) -> float | None:
        """`max_step`, or what stands for it when it is not said [time]; None where load steps are as planned."""
        if self.control != "auto":
            return None
        return min(LONGER * self.end / self.count, self.end) if self.max_step is None else self.max_step


@table
class Dynamics:
    """Inertia: load steps are steps of time, and bodies have mass. Without this table bodies have none."""

    integrator: str = key(
        choice(*INTEGRATORS), "how the motion goes on from step to step", default="hht",
        more="; ".join(f"`{name}`: {one.help}" for name, one in INTEGRATORS.items())
        + "; see [dynamics.md](dynamics.md)",
    )  # fmt: skip
    alpha: float | None = key(
        number(least=LEAST_ALPHA, most=0, words="a number from -1/3 to 0"),
        "with `hht` and `bossak`: 0 damps nothing, less damps more", default=None, otherwise="-0.1",
        requires=(" | ".join(f'integrator = "{name}"' for name, one in INTEGRATORS.items() if one.alpha is not None),),
    )  # fmt: skip
    mass: str = key(
        choice("consistent", "lumped"), "of cells: as the displacement has it, or at their nodes", default="consistent",
        more="lumped: the diagonal of the consistent one, scaled to the mass of the cell",
    )  # fmt: skip
    step_error: float | None = key(
        POSITIVE, "with `control = \"auto\"` of `[steps]`: local error that the length of steps follows", default=None,
        requires=('[steps] control = "auto"',),
        otherwise="none", more="of the velocity, as a part of the largest one so far; see [dynamics.md](dynamics.md)",
    )  # fmt: skip
    phases: Sequence[str] | None = phases("bodies have inertia; in all others they stand still at once")


@table
class Output:
    """Choice of what is written."""

    fields: bool = key(
        BOOLEAN, "fields of every step", default=True, option="output_fields", more="for `pcontact view` and ParaView"
    )
    checkpoint: bool | None = key(
        BOOLEAN, "write `checkpoint.h5`, for `-restart DIR`", default=None,
        otherwise="false; true with `checkpoint_every`", more="see [restart.md](restart.md)",
    )  # fmt: skip
    checkpoint_every: int | None = key(
        integer(1), "load steps between two checkpoints", default=None, otherwise="1", option="checkpoint_every",
        more="the option writes checkpoints whatever `checkpoint` says",
    )  # fmt: skip
    probes: Sequence[str] = key(
        sequence("a list of names of groups", TEXT), "groups whose displacement is reported: mean, least, largest",
        default=(), otherwise="none",
    )  # fmt: skip
    smooth: bool = key(
        BOOLEAN, "with them the fields of the cells averaged at the nodes", default=False, option="output_smooth",
        more="stress, equivalent stress and equivalent plastic strain, in each body for itself, see below",
    )  # fmt: skip
    energy: bool = key(
        BOOLEAN, "works of loads, supports and obstacles, and what became of them, in the report and the history",
        default=False, option="output_energy", more="with `[dynamics]` always; see [results.md](results.md)",
    )  # fmt: skip
    slip: bool = key(
        BOOLEAN, "slip of contacts with friction, and the pressure over it (wear), in the fields, the report and the "
        "history", default=False, option="output_slip", kw_only=True, more="see [results.md](results.md)",
    )  # fmt: skip
    estimate: bool = key(
        BOOLEAN, "estimate of the error of every step, in the report and the fields",
        default=False, option="output_estimate", more="see [estimate.md](estimate.md)",
        unless={"[dynamics]": "the error of motions is not estimated",
                "[[phases]]": "what ramps down in a phase is not in the estimate"},
    )  # fmt: skip
    format: str = key(
        choice("vtu", "vtkhdf"), "files of the fields: `fields.pvd` with pieces of every step and rank, or "
        "`fields.vtkhdf.series` with a file of every step", default="vtu", option="output_format",
        more="see [results.md](results.md)",
    )  # fmt: skip
    compression: int = key(
        integer(0, 9), "of `.vtkhdf`: level of deflate, 0 none", default=0, option="output_compression",
        requires=('format = "vtkhdf"',), more="`.vtu` is always compressed, with level 1",
    )  # fmt: skip


SINGLE_TABLES = {"mesh": MeshSpec, "steps": Steps, "output": Output}
# those that may be absent
OPTIONAL_TABLES = {"dynamics": Dynamics}
LIST_TABLES = {"bodies": Body, "contacts": Contact, "displacements": Displacement, "loads": Load,
               "springs": Spring, "temperatures": Temperature,
               "couplings": Coupling, "pretensions": Pretension, "equations": Equation, "periodic": Periodic,
               "phases": Phase, "regions": Region}  # fmt: skip
# those whose tables go by their names, all others by their regions
NAMED = (Contact, Phase, Region)


@closed
@dataclass
class Scene:
    """Everything the user describes.

    Parameters
    ----------
    mesh, materials, bodies, contacts, displacements, loads, springs, temperatures, couplings, pretensions, equations,
    periodic, phases, regions : the tables
    steps, output : the tables
    dynamics : Dynamics or None
        None: bodies have no inertia.
    petsc : dict of str to str
        Options of this scene, without the leading dash; the command line wins.
    title, accuracy, allow_unsafe : keys, see the declarations
    path : pathlib.Path or None
        The scene file; None when the scene was built in Python.
    beside : pathlib.Path or None
        Folder of the files of a scene without a file; None: the working directory.
    """

    mesh: MeshSpec
    materials: dict[str, Material]
    bodies: list[Body]
    contacts: list[Contact] = field(default_factory=list)
    displacements: list[Displacement] = field(default_factory=list)
    loads: list[Load] = field(default_factory=list)
    steps: Steps = field(default_factory=Steps)
    output: Output = field(default_factory=Output)
    petsc: dict[str, str] = field(default_factory=dict)
    title: str = key(ANY_TEXT, "what the report and the pictures are called", default="")
    accuracy: str | Target | None = key(
        preset_or_target(choice(*PRESETS)), "preset of what scene and options leave open", default=None,
        otherwise="none", option="accuracy", said=choice(*PRESETS),
        more="a preset sets tolerances, searches and, on a mesh of degree 2, the degree of the displacement; the "
        "table names an error to reach, by refining the mesh; see [accuracy.md](accuracy.md)",
    )  # fmt: skip
    allow_unsafe: Sequence[str] = key(
        sequence("a list of " + choice(*UNSAFE).allowed, choice(*UNSAFE)),
        "settings that run with a warning instead of being refused", default=(), otherwise="none",
        option="allow_unsafe", more="see [options.md](options.md)",
    )  # fmt: skip
    path: Path | None = None
    beside: Path | None = None
    springs: list[Spring] = field(default_factory=list)
    temperatures: list[Temperature] = field(default_factory=list)
    couplings: list[Coupling] = field(default_factory=list)
    phases: list[Phase] = field(default_factory=list)
    pretensions: list[Pretension] = field(default_factory=list)
    equations: list[Equation] = field(default_factory=list)
    periodic: list[Periodic] = field(default_factory=list)
    regions: list[Region] = field(default_factory=list)
    dynamics: Dynamics | None = None

    @property
    def where(self) -> str:
        """Name of the scene in messages: its file, or "scene"."""
        return "scene" if self.path is None else str(self.path)

    @property
    def folder(self) -> Path:
        """Folder that the scene's files are in, see `path` and `beside`."""
        if self.path is not None:
            return Path(self.path).parent
        return Path() if self.beside is None else Path(self.beside)

    @property
    def mesh_path(self) -> Path:
        """The mesh file."""
        return self.folder / self.mesh.file

    def copy(self) -> "Scene":
        """The same in tables of its own; values that are no tables are shared."""
        return _own(self)

    def finite(self, body: Body) -> bool:
        """Return whether a body has finite strain."""
        return (self.mesh.strain if body.strain is None else body.strain) == "finite"

    def lower(self, body: Body) -> bool:
        """Return whether the displacement of a body has a lower degree than that of the mesh."""
        return body.order is not None and body.order < (self.mesh.order or 1)

    def yields(self, body: Body) -> bool:
        """Return whether a body may yield, or has a law that a program has added."""
        return self.materials[body.material].plastic or self.materials[body.material].added

    @property
    def plastic(self) -> bool:
        """bool : whether some body may yield."""
        return any(self.yields(body) for body in self.bodies)

    @property
    def frictional(self) -> bool:
        """bool : whether some contact has friction."""
        return any(contact.friction or contact.tresca or contact.law for contact in self.contacts)

    @property
    def remembers(self) -> bool:
        """bool : whether what happens depends on what has happened: friction and plastic flow."""
        return self.plastic or self.frictional

    def locks(self, body: Body) -> bool:
        """Return whether cells are too stiff in a body: Poisson's ratio is near 0.5, and not in plane stress."""
        return self.mesh.kinematics != "plane_stress" and self.materials[body.material].poisson > LOCKING

    def averages(self, body: Body, simplices: bool = False) -> bool:
        """Tell whether a body's quadrilaterals and hexahedra, or triangles and tetrahedra, take the mean dilatation.

        Triangles and tetrahedra of degree 1 cannot: their dilatation is constant as it is.
        """
        degree = 1 if self.lower(body) else self.mesh.order
        if self.mesh.kinematics == "plane_stress" or (simplices and degree != 2):
            return False
        if self.materials[body.material].orthotropic:
            return False
        if self.mesh.mean_dilatation is not None:
            return self.mesh.mean_dilatation
        if simplices:
            return self.materials[body.material].nu > POOR
        return self.locks(body) or (self.yields(body) and degree != 2)


def _own(value):
    """Tables anew, alone or in lists and dicts."""
    if isinstance(value, tuple(HEADERS)):
        return replace(value, **{one.name: _own(getattr(value, one.name)) for one in fields(value)})
    if isinstance(value, dict):
        return {name: _own(one) for name, one in value.items()}
    return [_own(one) for one in value] if isinstance(value, list) else value


# what messages and pages call the tables
HEADERS = {
    Scene: "the scene",
    Material: "[materials.NAME]",
    Obstacle: "obstacle",
    Target: "accuracy",
    Budget: "budget",
    **{cls: f"[{name}]" for name, cls in {**SINGLE_TABLES, **OPTIONAL_TABLES}.items()},
    **{cls: f"[[{name}]]" for name, cls in LIST_TABLES.items()},
}
# per obstacle shape: the keys that must be there, the keys that may be there; every shape may move
OBSTACLE_KEYS = {
    "plane": (("point", "normal"), ()),
    "sphere": (("center", "radius"), ("inside",)),
    "cylinder": (("point", "axis", "radius"), ("inside",)),
    "punch": (("point", "normal"), ("radius", "width", "axis", "edge_radius")),
    "wedge": (("point", "normal", "half_angle"), ("axis", "edge_radius")),
    "cone": (("point", "normal", "half_angle"), ("edge_radius",)),
    "torus": (("center", "axis", "radius", "ring_radius"), ()),
    "mesh": (("file",), ("region", "inside")),
    "level_set": ((), ("expression", "function", "gradient")),
}
MOTION_KEYS = ("displacement", "amplitude", "angle", "pivot", "turn_axis")
# what a load may be beside a total force and moment
LOADS = ("pressure", *keys(Load)["pressure"].one_of[:-1])
# old names of keys: (table, old name) -> new name; the old one is still read, and warned of once
RENAMED: dict[tuple[type, str], str] = {}
# keys that tables lack, and what does instead
INSTEAD = {
    (Obstacle, key): "none of an obstacle, which moves as it is told; what is rigid and moves freely is a body with a "
    "mesh, all of it a group of [[couplings]], which has the mass of its cells, and mass and inertia of its point"
    for key in ("mass", "inertia")
}


# what is wrong in a table: the key (empty: the table), what was found, what is allowed
Found = Iterator[tuple[str, str, str]]


def refuse(scene: Scene, where: str, found: Iterable[tuple[str, str, str]]) -> None:
    """Raise the first of what is wrong in the table at a key path.

    Raises
    ------
    InputError
    """
    for name, what, allowed in found:
        raise input_error(scene.where, ".".join(filter(None, (where, name))), what, allowed)


def place(list_: str, index: int, name: object) -> str:
    """Key path of an entry of a list of tables, such as ``contacts[0] (ball-block)``."""
    return f"{list_}[{index}] ({name})" if isinstance(name, str) and name else f"{list_}[{index}]"


def tables(scene: Scene) -> Iterator[tuple[str, object]]:
    """All tables of a scene with their key paths, in the order of a scene file, obstacles included."""
    if isinstance(scene.accuracy, Target):
        yield "accuracy", scene.accuracy
        yield "accuracy.budget", scene.accuracy.budget
    yield "mesh", scene.mesh
    for name, material in scene.materials.items():
        yield f"materials.{name}", material
    for name in LIST_TABLES:
        for index, item in enumerate(getattr(scene, name)):
            where = place(name, index, item.name if isinstance(item, NAMED) else item.region)
            yield where, item
            if isinstance(item, Contact) and item.obstacle is not None:
                yield f"{where}.obstacle", item.obstacle
    yield "steps", scene.steps
    yield "output", scene.output
    yield from ((name, one) for name in OPTIONAL_TABLES if (one := getattr(scene, name)) is not None)


def groups_named(one: object) -> Iterator[tuple[str, str, str]]:
    """Groups that a table names: the key, the name, and of what they are, see `pcontact.scene.keys.Key.group`."""
    if isinstance(one, Equation):
        yield from ((f"terms[{index}]", name, "any") for index, (name, *_) in enumerate(one.terms))
    if isinstance(one, Contact) and one.all:
        return
    for attribute, declared in keys(type(one)).items():
        kind, name = declared.group, getattr(one, attribute)
        if kind and name is not None:
            attribute = "surfaces" if getattr(one, "surfaces", None) else attribute
            yield attribute, name, kind(one) if callable(kind) else kind
