"""Checks of a whole scene, whoever wrote it: every value, and the values against each other."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from pcontact.runtime.files import GEOMETRIES
from pcontact.runtime.messages import CONTROL, closeness, input_error, listed, nearest, shown, unknown_name
from pcontact.runtime.rules import PETSC_VALUE, TEXT, apply
from pcontact.scene.dynamics_checks import check_dynamics
from pcontact.scene.keys import keys
from pcontact.scene.model import (
    CONTACT_DEFAULTS,
    LIST_TABLES,
    LOADS,
    MOTION_KEYS,
    OBSTACLE_KEYS,
    OF_TOTALS,
    OPTIONAL_TABLES,
    OUTER,
    RUBBER,
    SINGLE_TABLES,
    TOTALS,
    Contact,
    Displacement,
    Load,
    Material,
    Obstacle,
    Scene,
    Spring,
)
from pcontact.scene.orthotropic import indefinite, parallel
from pcontact.scene.phase_checks import check_phase_names, check_phases
from pcontact.scene.phases import scene_of
from pcontact.scene.places import place, tables
from pcontact.scene.prescribed import expressions
from pcontact.scene.target import Budget, Target
from pcontact.scene.target_checks import check_target, unestimated

ALIKE = 0.5  # likeness of two file names above which one may be meant by the other
ALIKE_MODULI = 1e-3  # relative difference of Young's modulus and that of the terms of rubber
MOST_PAIRS = 26  # of two surfaces beside a contact of all: a bit for each surface fits into the digits of a number
SMALLEST = 1e-12  # of the run: the shortest step
# keys of materials that are orthotropic
ORTHOTROPIC = ("G", "axes", "angle", "point", "axis")
# keys of contacts that mean nothing where surfaces are tied
NOT_TIED = (
    "friction", "tresca", "bilateral", "unbiased", "obstacle", "interference", "smooth_geometry", "adjust_within",
    "clearance", "interference_amplitude", "pressure_overclosure", "kinetic_friction",
)  # fmt: skip


def validate(scene: Scene) -> None:
    """Check every value of a scene, in place: numbers become float, lists tuples, options strings.

    Parameters
    ----------
    scene : Scene
        From the reader or from Python. Groups and the dimension are checked once the mesh is there
        (`pcontact.scene.regions`).

    Raises
    ------
    InputError
        One line: file, key path, what was found, what is allowed.
    """
    _check_types(scene)
    _check_values(scene)
    _check_file(scene, scene.mesh_path, "mesh.file", "a mesh file")
    _check_geometry(scene)
    if scene.mesh.mean_dilatation and scene.mesh.kinematics == "plane_stress":
        found = 'true with kinematics = "plane_stress"'
        raise input_error(scene.where, "mesh.mean_dilatation", found, "false, plane stress does not lock")
    _check_bodies(scene)
    _check_output(scene)
    _check_strain(scene)
    check_phase_names(scene)
    for where, table in tables(scene):
        if isinstance(table, Material):
            _check_material(scene, where, table)
        elif isinstance(table, Contact):
            _check_contact(scene, where, table)
        elif isinstance(table, Obstacle):
            _check_obstacle(scene, where, table)
        elif isinstance(table, Load):
            _check_load(scene, where, table)
        elif isinstance(table, Spring):
            _check_spring(scene, where, table)
    _check_names(scene, "loads", [(k, one) for k, one in enumerate(scene.loads) if one.total])
    _check_names(scene, "springs", enumerate(scene.springs))
    _check_names(scene, "couplings", enumerate(scene.couplings))
    _check_names(scene, "pretensions", enumerate(scene.pretensions))
    _check_couplings(scene)
    _check_serendipity(scene)
    _check_pretensions(scene)
    _check_periodic(scene)
    _check_estimate(scene)
    _check_temperatures(scene)
    check_dynamics(scene)
    _check_unique(scene, "contacts", "name")
    _check_unique(scene, "regions", "name")
    if isinstance(scene.accuracy, Target):
        check_target(scene)
    if scene.phases:
        check_phases(scene)
        for number in range(len(scene.phases)):
            validate(scene_of(scene, number))
        return
    _check_displacements(scene)
    _check_steps(scene)


def resolve_contacts(scene: Scene, overrides: Mapping[str, object], said: str = "command line") -> Scene:
    """Fill in the numerics of every pair: the command line wins over the scene, the scene over the defaults.

    Parameters
    ----------
    scene : Scene
        A valid scene; it is left as it is.
    overrides : mapping of str to value
        What the command line says, for all pairs: keys of `CONTACT_DEFAULTS` (``{"theta": -1}`` for
        ``-contact_theta -1``). None is "not said".
    said : str
        What messages call it.

    Returns
    -------
    Scene
        With new contacts; what the defaults leave to the element (gamma0, quadrature) may still be None.

    Raises
    ------
    InputError
        The command line gives a value that is not allowed.
    KeyError
        A key is no numerics of a contact.
    """
    if not overrides.keys() <= CONTACT_DEFAULTS.keys():
        raise KeyError(f"not numerics of a contact: {sorted(overrides.keys() - CONTACT_DEFAULTS.keys())}")
    given = {
        key: apply(keys(Contact)[key].rule, value, said, f"-contact_{key}")
        for key, value in overrides.items()
        if value is not None
    }
    contacts = [replace(contact, **_numerics(scene, contact, given)) for contact in scene.contacts]
    resolved = replace(scene, contacts=contacts)
    for where, table in tables(resolved):
        if isinstance(table, Contact) and table.all:
            _check_all(resolved, where, table)
        if isinstance(table, Contact):
            _check_theta(resolved, where, table)
    return resolved


def _numerics(scene, contact, said):
    values = {"source": OUTER, "target": OUTER if contact.obstacle is None else None} if contact.all else {}
    for key, default in CONTACT_DEFAULTS.items():
        own = getattr(contact, key)
        values[key] = said.get(key, default if own is None else own)
    if scene.dynamics is not None and "theta" not in said and contact.theta is None:
        # the variant whose contact gives no energy to bodies that move; of bodies that yield its adjoint term does
        alone = not contact.all or len(scene.contacts) == 1
        values["theta"] = 1.0 if values["formulation"] == "nitsche" and alone and not scene.plastic else 0.0
    if contact.pressure_overclosure is not None:
        # what the command line says of formulations is about hard surfaces
        own = 0.0 if contact.theta is None else contact.theta
        values |= {"formulation": "penalty", "theta": own, "adjoint": "elastic"}
    return values


def _check_types(scene):
    """Reading TOML builds these types; a driver may have put something else there."""
    if not isinstance(scene.materials, dict):
        raise input_error(scene.where, "materials", shown(scene.materials), "a dict of name to Material")
    for name in scene.materials:
        apply(TEXT, name, scene.where, "materials")
    if not isinstance(scene.petsc, dict):
        raise input_error(scene.where, "petsc", shown(scene.petsc), "a table of option names and values")
    for key in LIST_TABLES:
        if not isinstance(getattr(scene, key), list | tuple):
            raise input_error(scene.where, key, shown(getattr(scene, key)), "a list")
    expected = [(key, getattr(scene, key), cls) for key, cls in SINGLE_TABLES.items()]
    expected += [(key, one, cls) for key, cls in OPTIONAL_TABLES.items() if (one := getattr(scene, key)) is not None]
    expected += [(f"materials.{name}", material, Material) for name, material in scene.materials.items()]
    for key, cls in LIST_TABLES.items():
        expected += [(f"{key}[{index}]", item, cls) for index, item in enumerate(getattr(scene, key))]
    expected += [
        (f"contacts[{index}].obstacle", contact.obstacle, Obstacle)
        for index, contact in enumerate(scene.contacts)
        if isinstance(contact, Contact) and contact.obstacle is not None
    ]
    if isinstance(scene.accuracy, Target):
        expected.append(("accuracy.budget", scene.accuracy.budget, Budget))
    for where, item, cls in expected:
        if not isinstance(item, cls):
            raise input_error(scene.where, where, shown(item), f"a table ({cls.__name__})")


def _check_values(scene):
    for where, table in tables(scene):
        if isinstance(table, Contact) and table.source is None and not table.all:
            apply(TEXT, None, scene.where, f"{where}.source")
    for where, table in (("", scene), *tables(scene)):
        for key, declared in keys(type(table)).items():
            value = apply(declared.rule, getattr(table, key), scene.where, f"{where}.{key}" if where else key)
            setattr(table, key, value)
    for name in scene.petsc:
        if not isinstance(name, str) or not name.strip("-") or any(c.isspace() or CONTROL.match(c) for c in name):
            raise input_error(
                scene.where, "petsc", f"an option named {name!r}", "names of options without blanks"
            )
    scene.petsc = {
        name.lstrip("-"): apply(PETSC_VALUE, value, scene.where, f"petsc.{name}")
        for name, value in scene.petsc.items()
    }


def _check_geometry(scene):
    """A geometry is a file that gmsh knows by its name."""
    name = scene.mesh.geometry
    if name is None:
        return
    if Path(name).suffix.lower() not in GEOMETRIES:
        raise input_error(scene.where, "mesh.geometry", repr(str(name)), f"a file {', '.join(GEOMETRIES)}")
    if scene.pretensions:
        section = place("pretensions", 0, scene.pretensions[0].region)
        found = f"{str(name)!r} together with {section}, whose two sides are not on it"
        raise input_error(scene.where, "mesh.geometry", found, "either of them")
    _check_file(scene, scene.folder / name, "mesh.geometry", "a geometry")


def _check_file(scene, path, key, what):
    """The file is there. Its folder may be one that cannot be looked into."""
    folder, best, found = path.parent, None, "no such file"
    try:
        if path.is_file():
            return
        if path.exists():
            found = "a directory" if path.is_dir() else "not a file"
        else:
            files = [file.name for file in folder.iterdir() if file.is_file() and file != scene.path]
            best = nearest(path.name, files)
    except OSError as error:
        found = error.strerror.lower()
    if best is not None and closeness(best, path.name) >= ALIKE:
        found += f", the nearest is {best!r}"
    name = getattr(scene.mesh, key.partition(".")[2])
    raise input_error(scene.where, key, f"{name!r}, {found}", f"{what} beside the scene, in {folder.absolute()}")


def _check_bodies(scene):
    if not scene.bodies:
        raise input_error(
            scene.where, "bodies", "no body", "at least one [[bodies]] with region and material"
        )
    _check_unique(scene, "bodies", "region")
    for index, body in enumerate(scene.bodies):
        if body.material not in scene.materials:
            found = unknown_name(body.material, "no such material", scene.materials)
            key = f"bodies[{index}] ({body.region}).material"
            raise input_error(scene.where, key, found, listed(scene.materials))


def _check_output(scene):
    """Pieces have a compression of their own."""
    if scene.output.compression and scene.output.format != "vtkhdf":
        found = f'{scene.output.compression} with format = "{scene.output.format}"'
        raise input_error(scene.where, "output.compression", found, '0, or format = "vtkhdf"')


def _check_strain(scene):
    """Laws of rubber are for finite strain, which some parts of the program do not have."""
    for index, body in enumerate(scene.bodies):
        material, where = scene.materials[body.material], f"bodies[{index}] ({body.region})"
        if material.law in RUBBER and not scene.finite(body):
            found = f'"{material.law}" in body {body.region} with small strain'
            raise input_error(scene.where, f"materials.{body.material}.law", found, f'{where}.strain = "finite"')
        if material.added and scene.finite(body):
            found = f'"{material.law}" in body {body.region} with finite strain'
            allowed = f'"hencky" | {" | ".join(map(repr, RUBBER))}; with strain = "small" a law that was added'
            raise input_error(scene.where, f"materials.{body.material}.law", found, allowed.replace("'", '"'))
        if material.law in RUBBER and scene.mesh.kinematics == "plane_stress":
            found = f'"{material.law}" with kinematics = "plane_stress"'
            raise input_error(scene.where, f"materials.{body.material}.law", found, '"hencky"')
        if scene.output.estimate and scene.finite(body):
            found = f"true with finite strain (body {body.region})"
            raise input_error(scene.where, "output.estimate", found, "false: the estimate is one of small strain")


def _check_unique(scene, key, attribute):
    seen = {}
    for index, item in enumerate(getattr(scene, key)):
        name = getattr(item, attribute)
        if name in seen:
            where = f"{key}[{index}] ({name}).{attribute}"
            raise input_error(
                scene.where, where, f"{name!r} a second time, as in {key}[{seen[name]}]", "each once"
            )
        seen[name] = index


def _check_orthotropic(scene, where, material):
    """Constants along three axes belong together, give every strain an energy, and are those of small strain."""
    if not material.orthotropic:
        said = [key for key in ("nu", "expansion") if isinstance(getattr(material, key), tuple)]
        for key in said + [key for key in ORTHOTROPIC if getattr(material, key) is not None]:
            value = getattr(material, key)
            found = f"{shown(list(value) if isinstance(value, tuple) else value)} without Young's moduli of three axes"
            raise input_error(scene.where, f"{where}.{key}", found, "E = [E1, E2, E3] as well")
        return
    for key in ("nu", "G", "expansion"):
        value = getattr(material, key)
        if not isinstance(value, tuple) and not (key == "expansion" and value is None):
            found = f"{'nothing' if value is None else shown(value)} together with E of three axes"
            raise input_error(scene.where, f"{where}.{key}", found, keys(Material)[key].rule.allowed)
    wrong = indefinite(material.E, material.nu)
    if wrong is not None:
        raise input_error(scene.where, f"{where}.nu", *wrong)
    if material.axes is not None and material.angle is not None:
        raise input_error(scene.where, f"{where}.angle", "angle together with axes", "at most one of axes, angle")
    if material.axes is not None and parallel(*material.axes):
        found = f"{[list(one) for one in material.axes]}, which are parallel"
        raise input_error(scene.where, f"{where}.axes", found, "two vectors that span a plane")
    if material.axis is not None and material.point is None:
        raise input_error(scene.where, f"{where}.axis", "an axis without point", "point as well")
    if material.point is not None and scene.mesh.kinematics == "axisymmetric":
        found = 'a point with kinematics = "axisymmetric"'
        allowed = "nothing: x, y, z of the axes are the radial, axial and hoop direction there"
        raise input_error(scene.where, f"{where}.point", found, allowed)
    for key in ("yield_stress", "hardening_curve"):
        if getattr(material, key) is not None:
            found = f"{key} of an orthotropic material"
            raise input_error(scene.where, f"{where}.{key}", found, "nothing: it is elastic, or E a number")
    if material.law != "hencky":
        found = f'"{material.law}" of an orthotropic material'
        raise input_error(scene.where, f"{where}.law", found, "nothing: it has small strain, or E a number")
    finite = [body for body in scene.bodies if scene.finite(body)]
    if finite:
        found = f"three of an orthotropic material, and body {finite[0].region} with finite strain"
        raise input_error(scene.where, f"{where}.E", found, "a number, or small strain of all bodies")
    if scene.mesh.mean_dilatation:
        found = f"true with the orthotropic material {where.partition('.')[2]}"
        raise input_error(scene.where, "mesh.mean_dilatation", found, "nothing: orthotropic bodies go without")


def _check_material(scene, where, material):
    _check_orthotropic(scene, where, material)
    if material.hardening_curve is not None:
        for key in ("yield_stress", "hardening"):
            if getattr(material, key):
                found = f"{getattr(material, key)!r} together with hardening_curve"
                allowed = "either hardening_curve, or yield_stress with or without hardening"
                raise input_error(scene.where, f"{where}.{key}", found, allowed)
    elif not material.plastic:
        for key, or_else in (("hardening", ""), ("kinematic_hardening", " or hardening_curve")):
            if getattr(material, key) > 0:
                found = f"{getattr(material, key)!r} without yield_stress{or_else}"
                raise input_error(scene.where, f"{where}.{key}", found, f"{key} together with yield_stress{or_else}")


    _check_law(scene, where, material)
    if material.split == "multiplicative" and material.kinematic_hardening > 0:
        found = "multiplicative with kinematic_hardening"
        raise input_error(scene.where, f"{where}.split", found, '"additive"')


def _check_law(scene, where, material):
    """Constants of rubber go with their law, and with Young's modulus."""
    for law in ("mooney_rivlin", "ogden"):
        said = getattr(material, law) is not None
        if said != (material.law == law):
            found = f'{law} without law = "{law}"' if said else "nothing"
            raise input_error(scene.where, f"{where}.{law}", found, f'{law} together with law = "{law}"')
    if material.law == "hencky":
        return
    if material.plastic:
        raise input_error(scene.where, f"{where}.law", f'"{material.law}" of what may yield', '"hencky"')
    if material.added:
        return
    young = (1.0 + material.nu) * sum(modulus * power for modulus, power in material.terms)
    if abs(young - material.E) > ALIKE_MODULI * young:
        found = f'{material.E:g} with a law = "{material.law}" of other stiffness'
        raise input_error(scene.where, f"{where}.E", found, f"{young:.6g}, that of its terms")


def _check_contact(scene, where, contact):
    if contact.all:
        _check_all(scene, where, contact)
    elif (contact.target is None) == (contact.obstacle is None):
        found = "neither target nor obstacle" if contact.target is None else "both target and obstacle"
        raise input_error(scene.where, where, found, "exactly one of target, obstacle")
    if contact.friction is not None and contact.tresca is not None:
        raise input_error(scene.where, where, "both friction and tresca", "at most one of friction, tresca")
    for key in ("tresca", "tied"):
        if contact.law is not None and getattr(contact, key):
            raise input_error(scene.where, f"{where}.{key}", f"{key} together with law", f"at most one of {key}, law")
    for key in ("friction_limit", "adhesion"):
        if getattr(contact, key) is not None and contact.friction is None and contact.law is None:
            raise input_error(scene.where, f"{where}.{key}", f"{key} without friction", "friction as well")
    _check_coefficients(scene, where, contact)
    named = {contact.source, contact.target}
    if contact.surfaces is not None and (contact.obstacle or contact.all or named != set(contact.surfaces)):
        other = "obstacle" if contact.obstacle else "all" if contact.all else "source or target"
        found = f"surfaces together with {other}"
        raise input_error(scene.where, f"{where}.surfaces", found, f"at most one of surfaces, {other}")
    if contact.unbiased and contact.obstacle is not None:
        raise input_error(
            scene.where, f"{where}.unbiased", "true with an obstacle", "false, an obstacle has no facets"
        )
    if contact.self_contact is not None and (contact.obstacle or not (contact.all or contact.target == contact.source)):
        found = f"{str(contact.self_contact).lower()} with {'an obstacle' if contact.obstacle else 'two surfaces'}"
        raise input_error(scene.where, f"{where}.self_contact", found, "all = true, or the same source and target")
    if contact.tied:
        _check_tied(scene, where, contact)
    _check_initial(scene, where, contact)
    _check_layer(scene, where, contact)
    _check_theta(scene, where, contact)


def _check_coefficients(scene, where, contact):
    """Two coefficients go with what leads from one to the other; what varies is Coulomb's law."""
    for key, other in (("kinetic_friction", "friction"), ("kinetic_friction", "friction_decay"),
                       ("friction_decay", "kinetic_friction")):  # fmt: skip
        if getattr(contact, key) is not None and getattr(contact, other) is None:
            raise input_error(scene.where, f"{where}.{key}", f"{key} without {other}", f"{other} as well")
    if contact.kinetic_friction is None and not isinstance(contact.friction, str):
        return
    what = "kinetic_friction" if contact.kinetic_friction is not None else "friction that is an expression"
    for key in ("law", "adhesion"):
        if getattr(contact, key):
            found = f"{key} together with {what}"
            raise input_error(scene.where, f"{where}.{key}", found, f"at most one of {key}, {what}")


def _check_initial(scene, where, contact):
    """One word on the gap between the undeformed bodies, and an overlap for its amplitude."""
    adjusts = contact.interference == "adjust"
    if contact.adjust_within is not None and not adjusts:
        found = f"{contact.adjust_within:g} without interference = \"adjust\""
        raise input_error(scene.where, f"{where}.adjust_within", found, 'interference = "adjust" as well')
    for key in ("clearance", "interference_amplitude"):
        if getattr(contact, key) is not None and adjusts:
            found = f'{key} together with interference = "adjust"'
            raise input_error(scene.where, f"{where}.{key}", found, f"at most one of {key}, interference = \"adjust\"")
    grows = contact.interference_amplitude is not None and not contact.bilateral
    if grows and (contact.clearance or 0.0) > 0.0:
        found = f"an amplitude of the overlap together with clearance = {contact.clearance:g}, which leaves none"
        raise input_error(scene.where, f"{where}.interference_amplitude", found, "clearance < 0, none, or bilateral")
    if contact.clearance is not None and (contact.meets_itself or (contact.all and contact.obstacle is None)):
        found = f"{contact.clearance:g} of surfaces that meet anywhere"
        raise input_error(scene.where, f"{where}.clearance", found, "pairs of two surfaces")


def _check_layer(scene, where, contact):
    """A layer is a formulation of its own, between surfaces that are not glued."""
    if contact.stick_stiffness is not None:
        if contact.pressure_overclosure is None:
            found, allowed = "stick_stiffness without pressure_overclosure", "pressure_overclosure as well"
            raise input_error(scene.where, f"{where}.stick_stiffness", found, allowed)
        if not any((contact.friction, contact.tresca, contact.adhesion, contact.law, scene.phases)):
            found = "stick_stiffness without friction"
            raise input_error(scene.where, f"{where}.stick_stiffness", found, "friction as well")
    if contact.pressure_overclosure is None:
        return
    if contact.formulation not in (None, "penalty"):
        found = f'"{contact.formulation}" with pressure_overclosure'
        raise input_error(scene.where, f"{where}.formulation", found, 'nothing, or "penalty"')
    if scene.output.estimate:
        found = f"true together with {where}.pressure_overclosure"
        raise input_error(scene.where, "output.estimate", found, "false: the estimate is one of hard surfaces")


def _check_all(scene, where, contact):
    """All surfaces need no name of any, and can hold together as little as one body can be tied to itself."""
    for key in ("source", "target"):
        value = getattr(contact, key)
        if value not in (None, OUTER):
            found = f"{shown(value)} together with all = true"
            raise input_error(scene.where, f"{where}.{key}", found, "all, or source with target or obstacle")
    for key in ("bilateral", "tied"):
        if getattr(contact, key) and contact.obstacle is None:
            raise input_error(scene.where, f"{where}.{key}", "true together with all = true", "pairs of two surfaces")
    if contact.theta and len(scene.contacts) > 1:
        # what other pairs do to a facet would be missing in the adjoint term
        raise input_error(scene.where, f"{where}.theta", f"{contact.theta:g} beside other contacts", "0")
    pairs = sum(other.target is not None and not other.all for other in scene.contacts)
    if pairs > MOST_PAIRS:
        raise input_error(scene.where, f"{where}.all", f"true beside {pairs} other pairs", f"at most {MOST_PAIRS}")
    if contact.obstacle is not None:
        return
    first = next(k for k, other in enumerate(scene.contacts) if other.all and other.obstacle is None)
    if scene.contacts[first] is not contact:
        raise input_error(scene.where, f"{where}.all", f"true a second time, as in contacts[{first}]", "once")


def _check_tied(scene, where, contact):
    """What is glued neither slides nor opens, and needs two surfaces."""
    for key in NOT_TIED:
        value = getattr(contact, key)
        if value not in (None, False, 0.0) and value != CONTACT_DEFAULTS.get(key):
            found = f"{'an obstacle' if key == 'obstacle' else shown(value)} together with tied = true"
            raise input_error(scene.where, f"{where}.{key}", found, "nothing: tied surfaces stay as they are")
    if contact.target == contact.source:
        raise input_error(scene.where, f"{where}.target", f"{contact.target!r} with tied = true", "another surface")


def _check_theta(scene, where, contact):
    """Penalty and augmented Lagrangian have no adjoint term that theta could weigh."""
    layer = contact.pressure_overclosure is not None
    if contact.formulation in (None, "nitsche") and not layer:
        return
    if layer and contact.formulation is None:
        contact = replace(contact, formulation="penalty")
    said = f'with formulation "{contact.formulation}"'
    if contact.theta:
        raise input_error(scene.where, f"{where}.theta", f"{contact.theta:g} {said}", '0, or formulation "nitsche"')
    if contact.adjoint == "consistent":
        allowed = 'nothing, or formulation "nitsche"'
        raise input_error(scene.where, f"{where}.adjoint", f"'consistent' {said}, which has no adjoint", allowed)


def _check_obstacle(scene, where, obstacle):
    needed, possible = OBSTACLE_KEYS[obstacle.shape]
    allowed = (*needed, *possible, *MOTION_KEYS)
    said = [key for key in keys(Obstacle) if key != "shape" and getattr(obstacle, key) not in (None, False)]
    for key in said:
        if key not in allowed:
            found = f'a key that shape "{obstacle.shape}" does not have'
            raise input_error(scene.where, f"{where}.{key}", found, ", ".join(("shape", *allowed)))
    for key in needed:
        if key not in said:
            raise input_error(scene.where, f"{where}.{key}", "nothing", keys(Obstacle)[key].rule.allowed)
    if obstacle.shape == "level_set":
        _check_level_set(scene, where, obstacle)
    if obstacle.shape == "mesh" and not (scene.folder / obstacle.file).is_file():
        allowed = f"a mesh file beside the scene, in {scene.folder.absolute()}"
        raise input_error(scene.where, f"{where}.file", f"{str(obstacle.file)!r}, no such file", allowed)
    if obstacle.shape in ("punch", "torus"):
        _check_radii(scene, where, obstacle)
    if obstacle.amplitude is not None and obstacle.displacement is None and obstacle.angle is None:
        found = "an amplitude without displacement or angle"
        raise input_error(scene.where, f"{where}.amplitude", found, "displacement or angle as well")
    # the moment on a mesh is about its pivot, whether it turns or not
    _check_angle(scene, where, obstacle, ("turn_axis",) if obstacle.shape == "mesh" else ("pivot", "turn_axis"))
    if obstacle.angle is not None and obstacle.shape == "level_set" and obstacle.pivot is None:
        raise input_error(scene.where, f"{where}.pivot", "nothing", keys(Obstacle)["pivot"].rule.allowed)


def _check_radii(scene, where, obstacle):
    """Edges are rounder than no shape, tubes are thinner than their rings."""
    if obstacle.shape == "torus":
        if obstacle.radius > obstacle.ring_radius:
            found = f"{obstacle.radius:g}, more than ring_radius"
            raise input_error(scene.where, f"{where}.radius", found, f"at most ring_radius = {obstacle.ring_radius:g}")
        return
    if (obstacle.radius is None) == (obstacle.width is None):
        found = "neither radius nor width" if obstacle.width is None else "both radius and width"
        raise input_error(scene.where, where, found, "exactly one of radius, width")
    half = obstacle.radius if obstacle.width is None else 0.5 * obstacle.width
    if (obstacle.edge_radius or 0.0) > half:
        found = f"{obstacle.edge_radius:g}, more than half of the face"
        raise input_error(scene.where, f"{where}.edge_radius", found, f"at most {half:g}")
    if obstacle.axis is not None and obstacle.width is None:
        raise input_error(scene.where, f"{where}.axis", "an axis of a round punch", "width instead of radius")


def _check_level_set(scene, where, obstacle):
    if obstacle.expression is not None:
        for key in ("function", "gradient"):
            if getattr(obstacle, key) is not None:
                found = "together with expression, whose gradient is known"
                raise input_error(scene.where, f"{where}.{key}", found, "expression, or function and gradient")
    elif obstacle.function is None:
        allowed = f"{keys(Obstacle)['function'].rule.allowed}; or {where}.expression"
        raise input_error(scene.where, f"{where}.function", "nothing", allowed)
    for key in ("function", "gradient"):
        reference = getattr(obstacle, key)
        if isinstance(reference, str) and not (scene.folder / reference.rpartition(":")[0]).is_file():
            allowed_text = f"{keys(Obstacle)[key].rule.allowed}, in {scene.folder.absolute()}"
            raise input_error(scene.where, f"{where}.{key}", f"{reference!r}, no such file", allowed_text)


def _check_load(scene, where, load):
    said = [key for key in LOADS if getattr(load, key) is not None]
    totals = [key for key in TOTALS if getattr(load, key) is not None]
    if len(said) + bool(totals) != 1:
        found = " and ".join([*said, *totals]) or "no value"
        raise input_error(scene.where, where, found, f"exactly one of {', '.join(LOADS)}, or force and moment")
    for key in OF_TOTALS:
        turns = key == "point" and load.angular_speed is not None
        if getattr(load, key) is not None and not totals and not turns:
            raise input_error(scene.where, f"{where}.{key}", f"{key} with {said[0]}", "force or moment with it")
    if load.region is None and load.at is None:
        more = "; or at, the place of a node" if totals else ""
        raise input_error(scene.where, f"{where}.region", "nothing", f"{keys(Load)['region'].rule.allowed}{more}")
    if load.axis is not None and load.angular_speed is None:
        raise input_error(scene.where, f"{where}.axis", "axis without angular_speed", "angular_speed as well")
    if load.angular_speed is not None and scene.mesh.kinematics != "axisymmetric" and load.point is None:
        raise input_error(scene.where, f"{where}.point", "nothing", keys(Load)["point"].rule.allowed)
    for key in ("moment", "point"):
        if load.at is not None and getattr(load, key) is not None:
            raise input_error(scene.where, f"{where}.{key}", f"{key} together with at", "force alone, at a node")
        if getattr(load, key) is not None and scene.mesh.kinematics == "axisymmetric":
            found = f'{key} with kinematics = "axisymmetric"'
            raise input_error(scene.where, f"{where}.{key}", found, "nothing: rings do not turn in their plane")
    if load.within is not None and load.at is None:
        raise input_error(scene.where, f"{where}.within", "within without at", "at as well")
    if load.follower and load.pressure is None:
        found = f"true with {(said or totals)[0]}"
        raise input_error(scene.where, f"{where}.follower", found, "pressure instead, or false")
    if load.follower and scene.mesh.kinematics == "plane_stress":
        found = 'true with kinematics = "plane_stress"'
        raise input_error(scene.where, f"{where}.follower", found, "false: the thickness is not followed")


def _check_spring(scene, where, spring):
    if (spring.per_area is None) == (spring.stiffness is None):
        found = "neither per_area nor stiffness" if spring.stiffness is None else "both per_area and stiffness"
        raise input_error(scene.where, where, found, "exactly one of per_area, stiffness")


def _check_temperatures(scene):
    """Thermal strain is one of small strain."""
    for index, item in enumerate(scene.temperatures):
        where = place("temperatures", index, item.region)
        if (item.value is None) == (item.file is None):
            found = "neither value nor file" if item.file is None else "both value and file"
            raise input_error(scene.where, where, found, "exactly one of value, file")
        for key, other in (("file", "field"), ("field", "file")):
            if getattr(item, key) is not None and getattr(item, other) is None:
                raise input_error(scene.where, f"{where}.{key}", f"{key} without {other}", f"{other} as well")
        if item.file is not None and not (scene.folder / item.file).is_file():
            allowed = f"a file beside the scene, in {scene.folder.absolute()}"
            raise input_error(scene.where, f"{where}.file", f"{str(item.file)!r}, no such file", allowed)
        for body in scene.bodies:
            if scene.finite(body):
                found = f"body {body.region} with finite strain"
                raise input_error(scene.where, where, found, "thermal strain with small strain of all bodies")


def _check_serendipity(scene):
    """Serendipity cells are of degree 2, and alone have reduced integration; no body has more than the mesh."""
    reduced = [k for k, body in enumerate(scene.bodies) if body.integration == "reduced"]
    if reduced and not (scene.mesh.serendipity and scene.mesh.kinematics != "axisymmetric"):
        where = f"{place('bodies', reduced[0], scene.bodies[reduced[0]].region)}.integration"
        found = "without mesh.serendipity = true" if not scene.mesh.serendipity else "with axial symmetry"
        raise input_error(scene.where, where, f'"reduced" {found}', '"full"')
    check_degrees(scene)


def check_degrees(scene):
    """Check that no body has more than the degree of the displacement, where that is known, and serendipity cells 2.

    Raises
    ------
    InputError
    """
    for k, body in enumerate(scene.bodies):
        if None not in (body.order, scene.mesh.order) and body.order > scene.mesh.order:
            where = f"{place('bodies', k, body.region)}.order"
            raise input_error(scene.where, where, f"{body.order} without order = 2 in [mesh]", "1, or order = 2 there")
    if scene.mesh.serendipity and scene.mesh.order == 1:
        raise input_error(scene.where, "mesh.serendipity", "true with a displacement of degree 1", "order = 2")


def _check_couplings(scene):
    """Rigid groups turn by small angles; rings do not turn in their plane, and do not widen as rigid ones."""
    finite = [body for body in scene.bodies if scene.finite(body)]
    for index, item in enumerate(scene.couplings):
        where, first = place("couplings", index, item.region), item.displacement[0] if item.displacement else "free"
        if finite and scene.mesh.kinematics != "axisymmetric" and not _held(item.rotation):
            found = f"body {finite[0].region} with finite strain, and a group that turns"
            raise input_error(scene.where, where, found,
                              "small strain; or rotation = 0 in all directions; or displacements with an angle")
        if scene.mesh.kinematics == "axisymmetric" and (item.rotation not in (None, "free") or first != "free"):
            found = f'{"rotation" if first == "free" else "a radial displacement"} with kinematics = "axisymmetric"'
            raise input_error(scene.where, where, found, 'displacement = ["free", ...] alone: a rigid ring')


def _held(rotation):
    """Whether a rotation is prescribed to be zero, in all directions."""
    return all(one == 0.0 for one in (rotation if isinstance(rotation, tuple) else (rotation,)))


def _check_pretensions(scene):
    """One value of each section; sides are no surfaces that may meet, and turn little."""
    for index, item in enumerate(scene.pretensions):
        where = place("pretensions", index, item.region)
        if (item.force is None) == (item.shortening is None):
            found = "neither force nor shortening" if item.force is None else "both force and shortening"
            raise input_error(scene.where, where, found, "exactly one of force, shortening")
        if item.region in [other.region for other in scene.pretensions[:index]]:
            raise input_error(scene.where, f"{where}.region", f"{item.region!r} a second time", "each section once")
        if any(scene.finite(body) for body in scene.bodies):
            raise input_error(scene.where, where, "bodies with finite strain", "small strain of all bodies")
        if any(contact.all for contact in scene.contacts):
            found = "a contact of all surfaces, which the sides of the section are, too"
            raise input_error(scene.where, where, found, "contacts with source and target")


def _check_periodic(scene):
    """A motion from the partner to the group; parts of rings have no neighbours."""
    for index, item in enumerate(scene.periodic):
        where = place("periodic", index, item.region)
        if item.translation is None and item.angle is None:
            raise input_error(scene.where, where, "neither translation nor angle", "one of translation, angle, or both")
        if (item.angle is None) != (item.point is None):
            key, found = ("point", "nothing") if item.point is None else ("angle", "nothing")
            raise input_error(scene.where, f"{where}.{key}", found, "angle and point together")
        if item.axis is not None and item.angle is None:
            raise input_error(scene.where, f"{where}.axis", "an axis without angle", "angle as well")
        if scene.mesh.kinematics == "axisymmetric" and item.angle is not None:
            raise input_error(scene.where, f"{where}.angle", 'a turn with kinematics = "axisymmetric"', "a translation")


def _check_names(scene, key, tables):
    """Names in the report are unique, whether they are said or those of groups."""
    seen = {}
    for index, item in tables:
        name = item.name or item.region
        if name is not None and name in seen:
            found = f"{name!r} a second time, as in {key}[{seen[name]}]"
            raise input_error(scene.where, f"{place(key, index, item.region)}.name", found, "a name of its own")
        seen[name] = index


def _check_estimate(scene):
    """What the estimate of the error does not know."""
    strange = unestimated(scene)
    if scene.output.estimate and strange:
        allowed = "false, or a scene without: its error is not known"
        raise input_error(scene.where, "output.estimate", f"true together with {strange[0]}", allowed)


def _check_displacements(scene):
    seen = {}
    for index, item in enumerate(scene.displacements):
        for direction, entry in enumerate(item.value):
            if entry == "free":
                continue
            first = seen.setdefault((item.region, direction), index)
            if first != index:
                key = f"displacements[{index}] ({item.region}).value"
                found = f"direction {direction} prescribed a second time, as in displacements[{first}]"
                raise input_error(scene.where, key, found, "each direction of a region once")
        _check_turn(scene, f"displacements[{index}] ({item.region})", item)


def _check_turn(scene, where, item):
    """Keys of an axis go with an angle, and the other way round; expressions do not go with it."""
    _check_angle(scene, where, item, ("point", "axis"))
    if item.angle is None:
        return
    if expressions(item.value):
        found = f"{shown(list(item.value))} together with angle"
        raise input_error(scene.where, f"{where}.value", found, "numbers, it moves as a rigid body")
    if item.point is None:
        raise input_error(scene.where, f"{where}.point", "nothing", keys(Displacement)["point"].rule.allowed)


def _check_angle(scene, where, item, needing):
    """Some keys need an angle, which rings do not have."""
    for key in needing:
        if item.angle is None and getattr(item, key) is not None:
            raise input_error(scene.where, f"{where}.{key}", f"{key} without angle", "angle as well")
    if item.angle is not None and scene.mesh.kinematics == "axisymmetric":
        found = 'an angle with kinematics = "axisymmetric"'
        raise input_error(scene.where, f"{where}.angle", found, "nothing: rings do not turn in their plane")


def _check_steps(scene):
    steps = scene.steps
    if steps.smallest_step > steps.end / steps.count:
        found = f"{steps.min_step!r}, longer than a step"
        raise input_error(
            scene.where, "steps.min_step", found, f"at most end / count = {steps.end / steps.count:g}"
        )
    if steps.max_step is not None and steps.control != "auto":
        raise input_error(
            scene.where, "steps.max_step", f'{steps.max_step:g} with control = "{steps.control}"', 'control = "auto"'
        )
    if steps.max_step is not None and steps.max_step < steps.smallest_step:
        raise input_error(
            scene.where, "steps.max_step", f"{steps.max_step:g}", f"at least min_step = {steps.smallest_step:g}"
        )
    if steps.smallest_step < SMALLEST * steps.end:
        # shorter ones drown in the rounding error of the time: a run would not get on
        found = f"{steps.smallest_step!r}"
        raise input_error(
            scene.where, "steps.min_step", found, f"at least {SMALLEST:g} end = {SMALLEST * steps.end:g}"
        )
