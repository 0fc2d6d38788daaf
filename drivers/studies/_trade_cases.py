"""The scenes of the trade of speed for accuracy, each with its answer: meshes, scenes, errors.

Errors are relative. ``energy``: energy norm of the displacement's error; ``pressure``: contact pressure in L2;
``peak``: largest pressure; ``area``: in contact; ``force``: through the contact. Cattaneo and Mindlin have ``shear``
(tangential traction in L2) and ``stick`` (half width of the stick zone) as well; Hill's cylinder has no contact, and
``outer``, the displacement of the outer face. The last three of the five are single numbers: they cross their exact
values between one mesh and the next, and are small there by luck.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from types import SimpleNamespace

import numpy as np

from drivers._common import contact_points, make_mesh
from drivers.cases import cattaneo_mindlin, hertz, indent, rings, thick_cylinder
from drivers.error_norms import bulk_error
from drivers.studies._overkill import total
from meshes import indent as indent_mesh
from meshes import rings as rings_mesh
from pcontact.material.elastic import lame
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Displacement, Load, Material, Scene

NORMS = ("energy", "pressure")
CONTACT_SCALARS = ("peak", "area", "force")
SCALARS = (*CONTACT_SCALARS, "stick", "outer")
RELATIVE_FLOOR = 1e-6  # a single number that is nearer to the exact one than this is there by luck


@dataclass(frozen=True)
class Case:
    """A scene of the sweep.

    Attributes
    ----------
    title : str
    kind : str
        Class of scenes that it stands for, under which its promises are found.
    sizes : dict of int to tuple
        By degree: mesh sizes, coarse to fine, in the words of `mesh`.
    base : dict of int to (int or float)
        By degree: the mesh on which one setting after the other is changed.
    unit : int or float
        The mesh (degree 1) whose linear elastic solve is the unit of cost.
    steps : int
        Load steps of the base, in the words of `scene`.
    mesh : callable
        ``mesh(directory, size, degree)`` gives the file. *Collective.*
    scene : callable
        ``scene(path, degree, steps)``
    errors : callable
        ``errors(simulation, reference)`` gives a dict. *Collective.*
    knobs : dict of str to tuple
        Further values of settings beside those common to all, or in their place.
    overkill : (size, degree, steps) or None
        The run that the energy norm needs.
    loose : tuple of str
        Regions that the linear elastic reference holds, where contact is what holds a body.
    quantities : tuple of str
    finer : tuple of dict
        Settings that make load steps more accurate; on all meshes.
    promised : dict of str to (size, degree)
        The mesh of each preset's promise.
    """

    title: str
    kind: str
    sizes: dict
    base: dict
    unit: float
    steps: int
    mesh: Callable
    scene: Callable
    errors: Callable
    knobs: dict = field(default_factory=dict)
    overkill: tuple | None = None
    loose: tuple = ()
    quantities: tuple = (*NORMS, *CONTACT_SCALARS)
    finer: tuple = ({"partners": 1e-4}, {"steps": 4})
    promised: dict = field(default_factory=dict)


def linear(scene: Scene, loose: tuple = ()) -> Scene:
    """The linear elastic reference: the scene's bodies, elastic, under body forces, one solve to 1e-8.

    Parameters
    ----------
    scene : Scene
    loose : tuple of str
        Regions to hold in all directions.
    """
    materials = {name: Material(one.E, one.nu) for name, one in scene.materials.items()}
    displacements = [
        Displacement(one.region, ["free" if value == "free" else 0.0 for value in one.value])
        for one in scene.displacements
    ]
    dim = len(displacements[0].value)
    displacements += [Displacement(region, [0.0] * dim) for region in loose]
    # a body force about as large as what bends a body of unit size by a thousandth
    force = [1e-3 * next(iter(materials.values())).E * part for part in (0.3, -0.2, 1.0)[:dim]]
    return replace(
        scene, title="linear elastic reference", materials=materials, contacts=[], displacements=displacements,
        loads=[Load(body.region, body_force=force) for body in scene.bodies],
        steps=replace(scene.steps, end=1.0, count=1), petsc={"ksp_rtol": "1e-8", "snes_type": "ksponly"},
    )  # fmt: skip


def relative(found: float, exact: float) -> float:
    """Relative error of a single number, not below `RELATIVE_FLOOR`."""
    return max(abs(found / exact - 1.0), RELATIVE_FLOOR)


def energy(simulation, reference) -> float:
    """Energy norm of the error over that of the reference. *Collective.*"""
    scene, space = simulation.scene, simulation.problem.space
    materials = [scene.materials[body.material] for body in scene.bodies]
    constants = [lame(one.E, one.nu) for one in materials]
    error = bulk_error(space, constants, simulation.stepper.u, reference, 2 * space.degree)
    return error.energy / error.energy_of_exact


def contact_errors(simulation, pressure: Callable, peak: float, area: float, force: float) -> dict[str, float]:
    """Errors of the contact pressure. *Collective.*

    Parameters
    ----------
    simulation : Simulation
    pressure : callable
        Exact pressure at points x (n, d) of the source [stress].
    peak, area, force : float
        Exact; of what is modelled, not of whole bodies.
    """
    item, comm = simulation.problem.contacts[0], simulation.comm
    state = item.state(simulation.stepper.u)
    weight, exact = state["weight"], pressure(state["x"])
    off, norm = (total(comm, weight @ value**2) for value in (state["pressure"] - exact, exact))
    largest = comm.allreduce(float(np.max(state["pressure"], initial=0.0)), op=MPI.MAX)
    found = total(comm, -np.sum(weight * np.einsum("nd,nd->n", state["traction"], state["normal"])))
    closed = total(comm, weight[state["status"] > 0].sum())
    return {
        "pressure": float(np.sqrt(off / norm)), "peak": relative(largest, peak), "area": relative(closed, area),
        "force": relative(found, force),
    }  # fmt: skip


# -- rings ----------------------------------------------------------------------------------------------------------


def _rings_mesh(delta, cell, directory, n, degree):
    # circles of degree 2 for both degrees: with chords the gaps between them are all that is seen
    return make_mesh(rings_mesh, directory / f"rings_{cell}_{delta:g}_{n}.msh", n=n, cell=cell, order=2, delta=delta)


def _rings_scene(pressure, path, degree, steps):
    scene = rings.ring_scene(path, degree, 0.0, pressure=pressure, gamma0=None)
    # a preset may say otherwise
    scene.contacts[0].theta, scene.steps.count = None, steps
    return scene


def _rings_errors(pressure, delta, simulation, reference):
    p, radius = rings.interface_pressure(pressure, delta), rings.MIDDLE + delta
    length = 0.5 * np.pi * radius
    exact = partial(rings.exact, constants=rings.ring_constants(pressure, delta))
    found = contact_errors(simulation, lambda x: np.full(len(x), p), p, length, p * length)
    return {"energy": energy(simulation, exact), **found}


def rings_case(title, pressure, delta, cell="quadrilateral") -> Case:
    """Two rings under a pressure, or shrunk onto each other."""
    return Case(
        title, "smooth", {1: (8, 16, 32, 64), 2: (8, 16, 32)}, {1: 32, 2: 16}, 32, 1, partial(_rings_mesh, delta, cell),
        partial(_rings_scene, pressure), partial(_rings_errors, pressure, delta), {"steps": (2, 4), "straight": ()},
        finer=({"partners": 1e-4},), promised={"draft": (16, 1), "standard": (16, 2), "fine": (32, 2)},
    )  # fmt: skip


# -- Hertz ----------------------------------------------------------------------------------------------------------


def _hertz_mesh(case, base, directory, facets, degree):
    path = directory / f"{case.generator.__name__}_{facets}_{degree}.msh"
    return hertz.generate(case, path, case.half_width / facets, degree, finer=facets / base)


def _hertz_scene(name, path, degree, steps):
    case = hertz.CASES[name]
    drive = "force" if case.force else "displacement"
    args = SimpleNamespace(case=name, order=degree, theta=None, gamma0=None, drive=drive, steps=steps, hold=0,
                           fields=False)  # fmt: skip
    return hertz.make_scene(case, path, args)


def _profile(case, force):
    """Pressure of Hertz at points, its peak, area and force in the part that is modelled."""
    a, p0 = case.from_force(force)
    area = 2.0 * a if case.dim == 2 else np.pi * a**2

    def pressure(x):
        r = np.linalg.norm(x[:, : case.dim - 1], axis=1)
        return p0 * np.sqrt(np.maximum(1.0 - (r / a) ** 2, 0.0))

    return pressure, p0, area / case.copies, force / case.copies


def _hertz_errors(name, simulation, reference):
    case = hertz.CASES[name]
    # where the displacement is prescribed, the finest mesh tells the force
    force = case.force or case.copies * float((reference.points["pressure"] * reference.points["weight"]).sum())
    found = contact_errors(simulation, *_profile(case, force))
    return {"energy": energy(simulation, reference), **found}


def hertz_case(title, name, sizes, base, unit, overkill, promised) -> Case:
    """A case of :mod:`drivers.cases.hertz`."""
    case = hertz.CASES[name]
    loose = (case.driven,) if case.force else ()
    return Case(
        title, "point" if case.dim == 3 else "line", sizes, base, unit, 1, partial(_hertz_mesh, case, unit),
        partial(_hertz_scene, name), partial(_hertz_errors, name), {"steps": (2, 4)}, overkill, loose,
        promised=promised,
    )  # fmt: skip


# -- Cattaneo and Mindlin -------------------------------------------------------------------------------------------

SHEARS = 2  # load steps of the tangential force


def _shear_scene(mu, path, degree, steps):
    args = SimpleNamespace(order=degree, mu=mu, gamma0=None, displacement=cattaneo_mindlin.DISPLACEMENT, press=steps,
                           steps=SHEARS, fields=False)  # fmt: skip
    return cattaneo_mindlin.make_scene(path, args, None)


def _shear_mesh(directory, facets, degree):
    args = SimpleNamespace(h=cattaneo_mindlin.CASE.half_width / facets, order=degree)
    return cattaneo_mindlin.generate(directory / f"sheared_{facets}_{degree}.msh", args, facets / 20)


def _shear_errors(mu, simulation, reference):
    case, shear = cattaneo_mindlin.CASE, cattaneo_mindlin.FORCE
    load = float((reference.points["pressure"] * reference.points["weight"]).sum())
    a, p0 = case.from_force(load)
    found = contact_errors(
        simulation, lambda x: p0 * np.sqrt(np.maximum(1.0 - (x[:, 0] / a) ** 2, 0.0)), p0, 2.0 * a, load
    )
    points = simulation.comm.bcast(cattaneo_mindlin.points_of(simulation))
    c, _, exact = cattaneo_mindlin.closed_form(points["x"], load, shear, mu)
    weight = points["weight"]
    off, norm = (float(weight @ value**2) for value in (points["tangential"] - exact, exact))
    stick = cattaneo_mindlin.stick_fit(points, mu)[0]
    found |= {"shear": float(np.sqrt(off / norm)), "stick": relative(stick, c)}
    return {"energy": energy(simulation, reference), **found}


# -- Hill -----------------------------------------------------------------------------------------------------------


def _hill_mesh(directory, n, degree):
    return thick_cylinder.make(directory / f"hill_{n}_{degree}.msh", "plane", "quadrilateral", degree, n)


def _hill_scene(pressure, path, degree, steps):
    return thick_cylinder.scene(path, "plane", degree, (pressure,), steps=steps)


def _hill_errors(pressure, simulation, reference):
    outer = rings.meanradial_displacement(simulation, "outer")
    exact = thick_cylinder.CONVERGED[pressure]
    return {"energy": energy(simulation, reference), "outer": relative(outer, exact)}


# -- indentation ----------------------------------------------------------------------------------------------------


RING, RINGS = 0.05, 0.5  # width of a ring, radius of all [length]


def _indent_mesh(directory, facets, degree):
    return make_mesh(indent_mesh, directory / f"indent_{facets}_{degree}.msh", 2, 0.5 / facets, degree,
                     growth=5.0 / facets)  # fmt: skip


def _indent_scene(hardening, path, degree, steps):
    return indent.scene(path, 2, material=indent.metal(hardening=hardening), unload=0, order=degree, steps=steps)


def _rings_of(points, values):
    """Sums over rings a facet of a coarse mesh wide: where a cell yields, its traction at single points scatters."""
    place = np.linalg.norm(points["x"][:, :-1], axis=1) / RING
    return np.bincount(place.astype(np.int64), values, round(RINGS / RING))[: round(RINGS / RING)]


def _overkill_errors(simulation, reference):
    """Errors where all that is known is the finest mesh."""
    points, exact = simulation.comm.bcast(contact_points(simulation)), reference.points
    sums = [(_rings_of(one, one["weight"] * one["pressure"]), _rings_of(one, one["weight"])) for one in (points, exact)]
    area = sums[1][1]
    found, exact_means = (force / np.where(size > 0.0, size, 1.0) for force, size in sums)
    off, norm = (float(np.sqrt(area @ value**2)) for value in (found - exact_means, exact_means))
    closed = [float(one["weight"][one["status"] > 0].sum()) for one in (points, exact)]
    return {
        "energy": energy(simulation, reference), "pressure": off / norm,
        "peak": relative(found.max(), exact_means.max()), "area": relative(*closed),
        "force": relative(*(float(force.sum()) for force, _ in sums)),
    }  # fmt: skip


# -- all of them ----------------------------------------------------------------------------------------------------

LINE = {"draft": (10, 1), "standard": (10, 2), "fine": (20, 2)}
POINT = {"draft": (8, 1), "standard": (4, 2), "fine": (8, 2)}


def shear_case(title, mu, overkill) -> Case:
    """Cattaneo and Mindlin with a coefficient of friction."""
    return Case(
        title, "friction", {1: (6, 11, 22), 2: (6, 11)}, {1: 11, 2: 6}, 11, 5, _shear_mesh, partial(_shear_scene, mu),
        partial(_shear_errors, mu), {"steps": (3, 10, 20), "partners": (1e-4,)}, overkill,
        quantities=(*NORMS, "shear", *CONTACT_SCALARS, "stick"), finer=({"steps": 10},),
        promised={"draft": (6, 1), "standard": (6, 2), "fine": (11, 2)},
    )  # fmt: skip


def hill_case(title, pressure) -> Case:
    """Hill's cylinder under a pressure."""
    return Case(
        title, "plastic", {1: (4, 8, 16, 32), 2: (4, 8, 16)}, {1: 16, 2: 8}, 16, 8, _hill_mesh,
        partial(_hill_scene, pressure), partial(_hill_errors, pressure),
        {"steps": (2, 4, 16), "quadrature": (), "theta": (), "gamma0": (), "partners": ()}, (32, 2, 32),
        quantities=("energy", "outer"), finer=({"steps": 16},),
        promised={"draft": (8, 1), "standard": (8, 2), "fine": (16, 2)},
    )  # fmt: skip


def indent_case(title, hardening, overkill) -> Case:
    """A ball pressed into a block with some hardening, axially symmetric."""
    return Case(
        title, "plastic contact", {1: (5, 10, 20, 40), 2: (5, 10, 20)}, {1: 20, 2: 10}, 20, 10, _indent_mesh,
        partial(_indent_scene, hardening), _overkill_errors, {"steps": (5, 20, 40)}, overkill,
        finer=({"steps": 20}, {"steps": 40}), promised={"draft": (10, 1), "standard": (10, 2), "fine": (20, 2)},
    )  # fmt: skip


CASES = {
    "rings": rings_case("rings, Lame", rings.PRESSURE, 0.0),
    "shrink_fit": rings_case("rings shrunk onto each other, Lame", 0.0, 6e-4),
    "hertz2d": hertz_case(
        "cylinders, Hertz", "cylinders", {1: (5, 10, 20, 40), 2: (5, 10, 20)}, {1: 20, 2: 10}, 20, (40, 2, 4), LINE
    ),
    "hertz3d": hertz_case(
        "ball on block, Hertz", "ball_on_block", {1: (4, 8, 16), 2: (4, 8)}, {1: 8, 2: 4}, 8, (12, 2, 2), POINT
    ),
    "cattaneo": shear_case("Cattaneo and Mindlin", 0.2, (22, 2, 20)),
    "hill": hill_case("thick cylinder, Hill", thick_cylinder.CHECKED),
    "indent": indent_case("indentation", indent.HARDENING, (80, 1, 40)),
}
# scenes that no setting was chosen on, one of every class
HELD_OUT = {
    "rings_of_triangles": rings_case("rings of triangles, shrunk on and pressed", 5e6, 3e-4, "triangle"),
    "cylinder_on_block": hertz_case(
        "cylinder on block, Hertz", "cylinder_on_block", {1: (10,), 2: (10, 20)}, {}, 20, (40, 2, 4), LINE
    ),
    "two_balls": hertz_case("two balls, Hertz", "two_balls", {1: (8,), 2: (4, 8)}, {}, 8, (12, 2, 2), POINT),
    "rougher": shear_case("Cattaneo and Mindlin, friction 0.3", 0.3, (16, 2, 20)),
    "hill_less": hill_case("thick cylinder, Hill, less pressure", 0.16),
    "perfect": indent_case("indentation, no hardening", 0.0, (40, 1, 40)),
}


def tiny(case: Case) -> Case:
    """The case on its coarsest meshes."""
    sizes = {degree: some[:1] for degree, some in case.sizes.items()}
    base = {degree: some[0] for degree, some in sizes.items()}
    promised = {name: (base[degree], degree) for name, (_, degree) in case.promised.items()}
    overkill = None if case.overkill is None else (case.sizes[2][1], 2, case.steps)
    return replace(case, sizes=sizes, base=base, unit=base[1], promised=promised, overkill=overkill, finer=())
