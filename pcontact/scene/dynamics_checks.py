"""Checks of inertia: every body has a mass, and nothing is asked for that knows of statics alone."""

from pcontact.runtime.messages import input_error
from pcontact.scene.integrators import INTEGRATORS
from pcontact.scene.model import Body, Coupling, Scene
from pcontact.scene.phases import DAMPING, STARTS
from pcontact.scene.places import place
from pcontact.scene.target import Target

# keys of couplings that go with [dynamics]
OF_POINTS = ("mass", "inertia")


def check_dynamics(scene: Scene) -> None:
    """What a scene says of inertia.

    Raises
    ------
    InputError
    """
    _check_points(scene)
    if scene.dynamics is None:
        for number, body in enumerate(scene.bodies):
            for key in (key for key in (*STARTS, *DAMPING) if getattr(body, key) != getattr(Body, key)):
                where = f"{place('bodies', number, body.region)}.{key}"
                raise input_error(scene.where, where, f"{key} without [dynamics]", "[dynamics] as well")
        return
    known = INTEGRATORS[scene.dynamics.integrator].alpha
    if scene.dynamics.alpha is not None and known is None:
        found = f'{scene.dynamics.alpha:g} with integrator = "{scene.dynamics.integrator}"'
        allowed = " or ".join(f'"{name}"' for name, one in INTEGRATORS.items() if one.alpha is not None)
        raise input_error(scene.where, "dynamics.alpha", found, f"nothing, or integrator = {allowed}")
    if scene.dynamics.step_error is not None and scene.steps.control != "auto":
        found = f'{scene.dynamics.step_error:g} with control = "{scene.steps.control}"'
        raise input_error(scene.where, "dynamics.step_error", found, '[steps] control = "auto", or nothing')
    check_masses(scene, ", with [dynamics]")
    for number, body in enumerate(scene.bodies):
        _check_body(scene, place("bodies", number, body.region), body)
    if isinstance(scene.accuracy, Target):
        found = f"{scene.accuracy.error:g} together with [dynamics]"
        raise input_error(scene.where, "accuracy.error", found, "no [dynamics]: the error of motions is not estimated")
    if scene.output.estimate:
        found = "true together with [dynamics]"
        raise input_error(scene.where, "output.estimate", found, "false: the error of motions is not estimated")


def _check_points(scene):
    """Points of couplings have masses where they move as rigid bodies that have some."""
    for number, one in enumerate(scene.couplings):
        for key in (key for key in OF_POINTS if getattr(one, key) != getattr(Coupling, key)):
            where = f"{place('couplings', number, one.region)}.{key}"
            if scene.dynamics is None and not scene.phases:
                raise input_error(scene.where, where, f"{key} without [dynamics]", "[dynamics] as well")
            if one.average:
                raise input_error(scene.where, where, f"{key} with average = true", "a rigid group, or no such key")
            if key == "inertia" and scene.mesh.kinematics == "axisymmetric":
                found = 'inertia with kinematics = "axisymmetric"'
                raise input_error(scene.where, where, found, "nothing: rings do not turn in their plane")


def check_masses(scene: Scene, why: str = "") -> None:
    """Every body that is there has a density.

    Raises
    ------
    InputError
    """
    for body in scene.bodies:
        if scene.materials[body.material].density is None and not body.absent:
            found = f"nothing{why} (body {body.region})"
            raise input_error(scene.where, f"materials.{body.material}.density", found, "a number > 0, mass per volume")


def _check_body(scene, where, body):
    """A body has damping that is defined."""
    material = scene.materials[body.material]
    for key, bad in (("finite strain", scene.finite(body)), ("an orthotropic material", material.orthotropic)):
        if body.stiffness_damping and bad:
            found = f"{body.stiffness_damping:g} of a body with {key}"
            allowed = "0: take mass_damping, or what the integrator damps"
            raise input_error(scene.where, f"{where}.stiffness_damping", found, allowed)
    if body.initial_displacement is not None and scene.dynamics.phases is not None:
        first = scene.phases[0].name if scene.phases else None
        if first not in scene.dynamics.phases:
            found = f"a displacement, and the phase {first!r} without inertia before"
            raise input_error(scene.where, f"{where}.initial_displacement", found, "nothing, or inertia from the first")
