"""What a scene switches on and what it leaves out, in words."""

from collections.abc import Sequence
from pathlib import Path

from pcontact.scene.integrators import INTEGRATORS
from pcontact.scene.model import LOADS, Contact, Dynamics, Scene
from pcontact.scene.validate import resolve_contacts


def _plastic(scene, finite=None):
    """Bodies that may yield, and how each hardens: all, or those with finite strain or without."""
    return [
        f"{body.region} ({_hardening(scene.materials[body.material])})"
        for body in scene.bodies
        if scene.materials[body.material].plastic and finite in (None, scene.finite(body))
    ]


def _strains(scene):
    """Elasticity and plasticity of the bodies, in lines."""
    lines = []
    for finite, words in ((False, "small strain"), (True, "finite strain")):
        bodies = [(one.region, scene.materials[one.material]) for one in scene.bodies if scene.finite(one) == finite]
        lines += _listed({
            f"{words} elasticity": {f"{name} ({one.law.replace('_', '-')})" if finite else name: 0
                                    for name, one in bodies},
            "orthotropic": [f"{name} ({_axes(one)})" for name, one in bodies if one.orthotropic],
            "laws that the program has added": [f"{name} ({one.law})" for name, one in bodies if one.added],
            f"{words} von Mises plasticity": _plastic(scene, finite),
        })  # fmt: skip
    return lines


def _listed(names):
    """A line of each piece of physics that has names."""
    return [f"{words}: {', '.join(some)}" for words, some in names.items() if some]


def _axes(material):
    """Where the axes of an orthotropic material are."""
    first = " ".join(f"{value:.4g}" for value in material.frame[0])
    around = "" if material.point is None else f" of radius, hoop and axis around {list(material.point)}"
    return f"axis 1 along {first}{around}"


def _hardening(material):
    kinds = {
        "tabulated": material.hardening_curve is not None,
        "isotropic": material.hardening > 0,
        "kinematic": material.kinematic_hardening > 0,
    }
    return (" and ".join(kind for kind, has in kinds.items() if has) or "no") + " hardening"


def _is_unbiased(contact):
    return contact.unbiased or (contact.all and contact.obstacle is None)


# physics that a scene may or may not ask for, and whether it does
_FEATURES = (
    ("contact", lambda scene: bool(scene.contacts)),
    ("friction", lambda scene: scene.frictional),
    ("plasticity", lambda scene: bool(_plastic(scene))),
    ("rigid obstacles", lambda scene: any(contact.obstacle is not None for contact in scene.contacts)),
    ("self contact", lambda scene: any(contact.meets_itself for contact in scene.contacts)),
    ("contact of all surfaces", lambda scene: any(contact.all and not contact.obstacle for contact in scene.contacts)),
    ("tied surfaces", lambda scene: any(contact.tied for contact in scene.contacts)),
    ("unbiased contact", lambda scene: any(_is_unbiased(contact) for contact in scene.contacts)),
    ("finite strain", lambda scene: any(scene.finite(body) for body in scene.bodies)),
    ("inertia", lambda scene: scene.dynamics is not None),
)


def describe(
    scene: Scene, dim: int | None = None, averaged: Sequence[str] = ()
) -> tuple[list[str], list[str]]:
    """What is modelled and what is left out.

    Parameters
    ----------
    scene : Scene
        A valid scene; numerics that it does not say are described by their defaults.
    dim : int or None
        Space dimension of the mesh, where it is known.
    averaged : sequence of str
        Bodies that have cells with mean dilatation.

    Returns
    -------
    active, left_out : list of str
        One entry per piece of physics.
    """
    active = _strains(scene)
    if scene.mesh.kinematics != "plane_strain" or dim == 2:
        active.append(scene.mesh.kinematics.replace("_", " "))
    active += _listed({"degree 1": [body.region for body in scene.bodies if scene.lower(body)]})
    if scene.mesh.geometry is not None:
        active.append(f"new nodes on the geometry {Path(scene.mesh.geometry).name}")
    active += ["serendipity cells"] * scene.mesh.serendipity
    active += _listed({
        "reduced integration": [body.region for body in scene.bodies if body.integration == "reduced"],
        "mean dilatation": averaged,
    })  # fmt: skip
    active += [_contact(contact) for contact in resolve_contacts(scene, {}).contacts]
    loads, supports = scene.loads, scene.displacements
    dead = [load for load in loads if not load.follower]
    active += _listed({
        "pressure on the deformed surface": [load.region for load in loads if load.follower],
        **{key.replace("_", " "): [load.region for load in dead if getattr(load, key) is not None] for key in LOADS},
        "total force": [load.name or load.region or f"at {list(load.at)}" for load in loads if load.total],
        "thermal strain": [one.region or "all bodies" for one in scene.temperatures],
        "rigid groups": [one.name or one.region for one in scene.couplings if not one.average],
        "groups that move on average": [one.name or one.region for one in scene.couplings if one.average],
        "pre-tension": [one.name or one.region for one in scene.pretensions],
        "linear equations": [str(len(scene.equations))] * bool(scene.equations),
        "periodic groups": [f"{one.region} as {one.partner}" for one in scene.periodic],
        "springs to the ground": [spring.name or spring.region for spring in scene.springs],
        "prescribed displacement": dict.fromkeys(item.region for item in supports),
        "supports that turn": dict.fromkeys(item.region for item in supports if item.turns),
    })  # fmt: skip
    if scene.steps.viscous_stabilisation is not None:
        active.append(f"viscous stabilisation: {scene.steps.viscous_stabilisation:g}")
    if scene.dynamics is not None:
        active.append(f"inertia: {_dynamics(scene.dynamics)}")
    active += _listed({"phases": [phase.name for phase in scene.phases]})
    some = [f"{body.region} in {', '.join(body.phases)}" for body in scene.bodies if body.phases is not None]
    active += [f"bodies in some phases: {'; '.join(some)}"] * bool(some)
    active += ["error estimate of every step"] * scene.output.estimate
    return active, [name for name, asked in _FEATURES if not asked(scene)]


def _dynamics(dynamics: Dynamics) -> str:
    """Integrator and mass, and where there is inertia."""
    default = INTEGRATORS[dynamics.integrator].alpha
    alpha = default if dynamics.alpha is None else dynamics.alpha
    words = f"integrator {dynamics.integrator}" + ("" if alpha is None else f", alpha {alpha:g}")
    where = "" if dynamics.phases is None else f", in {', '.join(dynamics.phases)}"
    return f"{words}, {dynamics.mass} mass{where}"


def _initial(contact: Contact) -> str:
    """The gap between the undeformed bodies."""
    if contact.clearance is not None:
        words = f"initial clearance {contact.clearance:g}"
    else:
        words = f"initial overlap: {contact.interference}"
        words += f", gaps within {contact.adjust_within:g} too" if contact.adjust_within else ""
    return f"{words} by an amplitude" if contact.interference_amplitude is not None else words


def _coefficient(value: float | str) -> str:
    """A number or an expression."""
    return value if isinstance(value, str) else f"{value:g}"


def _contact(contact: Contact) -> str:
    """One line: partners, law, numerics."""
    if contact.obstacle is not None:
        moving = "moving " if contact.obstacle.displacement is not None else ""
        moving += "turning " if contact.obstacle.turns else ""
        source = "every body" if contact.all else contact.source
        partners = f"{source} -> {moving}rigid {contact.obstacle.shape.replace('_', ' ')}"
    elif contact.all:
        partners = f"every body with every other one{' and itself' if contact.meets_itself else ''}"
    elif contact.target == contact.source:
        partners = f"{contact.source} with itself"
        partners += "" if contact.meets_itself else ", bodies with others only"
    else:
        between = "<->" if contact.unbiased else "and" if contact.surfaces else "->"
        partners = f"{contact.source} {between} {contact.target}"
    law = "tied" if contact.tied else "frictionless"
    if contact.law:
        law = f"law {contact.law}"
    elif contact.friction:
        law = f"Coulomb friction {_coefficient(contact.friction)}"
        if contact.kinetic_friction is not None:
            law += f", {_coefficient(contact.kinetic_friction)} at large speeds"
        if contact.friction_limit is not None:
            law += f" up to {contact.friction_limit:g}"
        if contact.adhesion:
            law += f" plus adhesion {contact.adhesion:g}"
    elif contact.tresca:
        law = f"Tresca friction {contact.tresca:g}"
    layer = contact.pressure_overclosure is not None
    words = [partners, law, "pressure over overclosure" if layer else contact.formulation.replace("_", " ")]
    if contact.formulation == "nitsche":
        words.append(f"theta {contact.theta:g}")
    words.append("gamma0 from the element" if contact.gamma0 is None else f"gamma0 {contact.gamma0:g}")
    words += [contact.search.replace("_", " ")]
    words += ["gap or overlap stay"] if contact.tied else [_initial(contact)]
    if contact.smooth_geometry and not contact.tied:
        words.append("gaps of the smooth surfaces of straight facets")
    if contact.meets_itself:
        words.append("no partners in the same cell, across a shared node or through the material")
    if _is_unbiased(contact):
        words.append("unbiased: both sides are source and target with weight 1/2")
    return f"contact {contact.name}: " + ", ".join(words)
