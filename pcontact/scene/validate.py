"""Checks of a whole scene, whoever wrote it: every value, and the values against each other.

Rules between the keys of a table are declared with them (`pcontact.scene.keys`); those that ask for more are here, by
table. Each says of what is wrong: the key, what was found, what is allowed.
Settings whose answers may be wrong are refused, or run with a warning where the scene says so.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from pcontact.runtime import log
from pcontact.runtime.errors import CONTROL, closeness, input_error, listed, nearest, shown, unknown_name
from pcontact.runtime.files import GEOMETRIES
from pcontact.runtime.rules import PETSC_VALUE, TEXT, apply
from pcontact.scene.functions import expressions
from pcontact.scene.keys import choice_of, conflicts, holds, keys
from pcontact.scene.model import (
    CONTACT_DEFAULTS,
    LIST_TABLES,
    MOTION_KEYS,
    OBSTACLE_KEYS,
    OPTIONAL_TABLES,
    OUTER,
    PLANE_STRESS,
    RINGS,
    RUBBER,
    SINGLE_TABLES,
    Body,
    Contact,
    Coupling,
    Displacement,
    Found,
    Load,
    Material,
    MeshSpec,
    Obstacle,
    Output,
    Phase,
    Pretension,
    Scene,
    Steps,
    Temperature,
    place,
    refuse,
    tables,
)
from pcontact.scene.orthotropic import indefinite, parallel
from pcontact.scene.phases import PHASED, acts, begun, come_and_go, scene_of
from pcontact.scene.target import AXES, BEST, Budget, Target

ALIKE = 0.5  # likeness of two file names above which one may be meant by the other
ALIKE_MODULI = 1e-3  # relative difference of Young's modulus and that of the terms of rubber
MOST_PAIRS = 26  # of two surfaces beside a contact of all: a bit for each surface fits into the digits of a number
SMALLEST = 1e-12  # of the run: the shortest step
# keys of materials that are orthotropic
ORTHOTROPIC = ("G", "axes", "angle", "point", "axis")


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
    refuse(scene, "", _scene(scene))
    for where, table in tables(scene):
        check = CHECKS.get(type(table))
        refuse(scene, where, conflicts(table, scene))
        refuse(scene, where, check(scene, table) if check is not None else ())
    refuse(scene, "", _names(scene))
    refuse(scene, "", _motion(scene))
    if scene.phases:
        refuse(scene, "", _phases(scene))
        for number in range(len(scene.phases)):
            validate(scene_of(scene, number))
        return
    refuse(scene, "", _directions(scene))


def check_masses(scene: Scene, why: str = "") -> None:
    """Check that every body which is there has a density.

    Raises
    ------
    InputError
    """
    refuse(scene, "", (
        (f"materials.{body.material}.density", f"nothing{why} (body {body.region})", "a number > 0, mass per volume")
        for body in scene.bodies if scene.materials[body.material].density is None and not body.absent
    ))  # fmt: skip


def check_degrees(scene: Scene) -> None:
    """Check that no body has more than the degree of the displacement, where that is known, and serendipity cells 2.

    Raises
    ------
    InputError
    """
    refuse(scene, "", (
        (f"{place('bodies', k, body.region)}.order", f"{body.order} without order = 2 in [mesh]",
         "1, or order = 2 there")
        for k, body in enumerate(scene.bodies)
        if None not in (body.order, scene.mesh.order) and body.order > scene.mesh.order
    ))  # fmt: skip
    if scene.mesh.serendipity and scene.mesh.order == 1:
        raise input_error(scene.where, "mesh.serendipity", "true with a displacement of degree 1", "order = 2")


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
        if isinstance(table, Contact):
            refuse(resolved, where, (*(_all(resolved, table) if table.all else ()), *_theta(resolved, table)))
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


# -- the whole scene ---------------------------------------------------------------------------------------------------


def _scene(scene) -> Found:
    """Check what other checks take for granted: the mesh is there, bodies have materials; degrees, names of phases."""
    yield from _missing(scene, "mesh.file", scene.mesh.file, "a mesh file")
    if not scene.bodies:
        yield "bodies", "no body", "at least one [[bodies]] with region and material"
    yield from _twice(scene, "bodies", "region")
    for index, body in enumerate(scene.bodies):
        if body.material not in scene.materials:
            found = unknown_name(body.material, "no such material", scene.materials)
            yield f"bodies[{index}] ({body.region}).material", found, listed(scene.materials)
    check_degrees(scene)
    names = [phase.name for phase in scene.phases]
    yield from _twice(scene, "phases", "name")
    for where, one in tables(scene):
        for name in getattr(one, "phases", None) or () if names else ():
            if name not in names:
                yield f"{where}.phases", unknown_name(name, "no such phase", names), listed(names)


def _twice(scene, key, attribute, entries=None) -> Found:
    """Names in a list of tables, in the report too, are unique, whether they are said or those of groups."""
    seen = {}
    for index, item in enumerate(getattr(scene, key)) if entries is None else entries:
        name = getattr(item, attribute) or item.region
        if name is not None and name in seen:
            where = place(key, index, getattr(item, "region", name))
            yield f"{where}.{attribute}", f"{name!r} a second time, as in {key}[{seen[name]}]", "each once"
        seen[name] = index


def _names(scene) -> Found:
    yield from _twice(scene, "loads", "name", [(k, one) for k, one in enumerate(scene.loads) if one.total])
    for key in ("springs", "couplings", "pretensions", "contacts", "regions"):
        yield from _twice(scene, key, "name")
    yield from _twice(scene, "pretensions", "region")


def _missing(scene, key, name, what) -> Found:
    """A file is not there. Its folder may be one that cannot be looked into."""
    path, best, found = scene.folder / name, None, "no such file"
    try:
        if path.is_file():
            return
        if path.exists():
            found = "a directory" if path.is_dir() else "not a file"
        else:
            files = [file.name for file in path.parent.iterdir() if file.is_file() and file != scene.path]
            best = nearest(path.name, files)
    except OSError as error:
        found = error.strerror.lower()
    if best is not None and closeness(best, path.name) >= ALIKE:
        found += f", the nearest is {best!r}"
    yield key, f"{str(name)!r}, {found}", f"{what} beside the scene, in {path.parent.absolute()}"


def _directions(scene) -> Found:
    """Each direction of a region is prescribed once."""
    seen = {}
    for index, item in enumerate(scene.displacements):
        for direction in (direction for direction, entry in enumerate(item.value) if entry != "free"):
            first = seen.setdefault((item.region, direction), index)
            if first != index:
                found = f"direction {direction} prescribed a second time, as in displacements[{first}]"
                yield f"displacements[{index}] ({item.region}).value", found, "each direction of a region once"


def _motion(scene) -> Found:
    """Every body that moves has a mass, and damping that is defined."""
    if scene.steps.through_snaps is not None:
        check_masses(scene, ", with through_snaps")
    if scene.dynamics is None:
        return
    check_masses(scene, ", with [dynamics]")
    for number, body in enumerate(scene.bodies):
        where, material = place("bodies", number, body.region), scene.materials[body.material]
        for words, bad in (("finite strain", scene.finite(body)), ("an orthotropic material", material.orthotropic)):
            if body.stiffness_damping and bad:
                yield (f"{where}.stiffness_damping", f"{body.stiffness_damping:g} of a body with {words}",
                       "0: take mass_damping, or what the integrator damps")  # fmt: skip
        first = scene.phases[0].name if scene.phases else None
        if body.initial_displacement is not None and first not in (scene.dynamics.phases or (first,)):
            found = f"a displacement, and the phase {first!r} without inertia before"
            yield f"{where}.initial_displacement", found, "nothing, or inertia from the first"


# -- phases ------------------------------------------------------------------------------------------------------------


def _phases(scene) -> Found:
    """Check what acts in some phases only; bodies that come and go: some is there in each phase."""
    last = len(scene.phases) - 1
    for key in PHASED:
        for index, one in enumerate(getattr(scene, key)):
            first = next((k for k, phase in enumerate(scene.phases) if acts(one, phase.name)), 0)
            if isinstance(one, Displacement) and one.turns and (first or begun(scene, one, last) > first):
                # arms of a turn are those of the undeformed bodies
                yield (f"{place(key, index, one.region)}.phases", f"{list(one.phases)} with an angle",
                       "phases from the first one on, without a gap")  # fmt: skip
    if not come_and_go(scene):
        return
    for number, phase in enumerate(scene.phases):
        if not any(acts(body, phase.name) for body in scene.bodies):
            where = f"{place('phases', number, phase.name)}.name"
            yield where, f"{phase.name!r}, in which no body is there", "a phase with a body"
    for index, body in enumerate(scene.bodies):
        there = [acts(body, phase.name) for phase in scene.phases]
        where = f"{place('bodies', index, body.region)}.phases"
        if not any(there):
            yield where, "no phase", "at least one phase, or no such body"
        # what begins without strain has small strain
        if scene.finite(body) and any(now and not before for before, now in zip(there, there[1:], strict=False)):
            found = f"{list(body.phases)} of a body with finite strain, which begins in a later phase than the first"
            yield where, found, 'strain = "small" of this body, or phases from the first one'


def _phase(scene, phase) -> Found:
    """Check that what a phase says of a contact is about one that acts, and has the law that changes."""
    contacts, number = {one.name: one for one in scene.contacts}, scene.phases.index(phase)
    for key in ("friction", "tied"):
        for name in getattr(phase, key) or ():
            if name not in contacts:
                yield key, unknown_name(name, "no such contact", contacts), listed(contacts)
            contact = contacts[name]
            if not acts(contact, phase.name):
                yield key, f"{name!r}, which does not act in this phase", "one that acts"
            if contact.tied or (key == "friction" and (contact.tresca or contact.law)):
                law = "tied" if contact.tied else "of another law of friction"
                yield key, f"{name!r}, which is {law}", "a contact with friction or without"
            if key == "tied" and begun(scene, contact, number) == number:
                found = f"{name!r}, which does not act in the phase before"
                yield key, found, "a contact whose points have closed in the phase before"


# -- an error to reach, or to estimate ---------------------------------------------------------------------------------


def _unestimated(scene):
    """Return the places of what the estimate of the error does not know."""
    strange = [place("loads", k, one.region) + ".at" for k, one in enumerate(scene.loads) if one.at is not None]
    for key in ("pretensions", "equations", "periodic"):
        strange += [place(key, k, one.region) for k, one in enumerate(getattr(scene, key))]
    return strange + ["mesh.serendipity"] * scene.mesh.serendipity


def _output(scene, output) -> Found:
    if not output.estimate:
        return
    for body in scene.bodies:
        if scene.finite(body):
            found = f"true with finite strain (body {body.region})"
            yield "estimate", found, "false: the estimate is one of small strain"
    for index, one in enumerate(scene.contacts):
        if one.pressure_overclosure is not None:
            found = f"true together with {place('contacts', index, one.name)}.pressure_overclosure"
            yield "estimate", found, "false: the estimate is one of hard surfaces"
    for strange in _unestimated(scene):
        yield "estimate", f"true together with {strange}", "false, or a scene without: its error is not known"


def known_names(scene: Scene) -> dict[str, list[str]]:
    """Return by quantity the names that it may be of."""
    contacts = [contact.name for contact in scene.contacts]
    return {"force": contacts, "pressure": contacts, "support": [one.region for one in scene.displacements],
            "displacement": list(scene.output.probes)}  # fmt: skip


def check_component(scene: Scene, dim: int) -> None:
    """Refuse a component of `accuracy.of` that vectors on a mesh of a dimension do not have.

    Raises
    ------
    InputError
    """
    for target in scene.accuracy.each:
        _, axis = target.of_known(known_names(scene).get(target.quantity, ()))
        if axis is not None and axis >= dim:
            allowed = f"components {', '.join(AXES[:dim])}, the mesh is {dim}D"
            raise input_error(scene.where, "accuracy.of", f"'{target.of}'", allowed)


def _target(scene, target) -> Found:
    """An error to reach is estimated, and of something that is there."""
    budget = target.budget
    if target.best and budget.unknowns is budget.memory is budget.time is None:
        yield "error", f'"{BEST}" without a budget', "unknowns, memory or time in accuracy.budget"
    found = [f"finite strain (body {body.region})" for body in scene.bodies if scene.finite(body)]
    found += ["phases"] if scene.phases else _unestimated(scene)
    found += [f"{place('temperatures', k, one.region)}.file, of nodes that other meshes do not have"
              for k, one in enumerate(scene.temperatures) if one.file is not None]  # fmt: skip
    found += [f"{place('couplings', k, one.region)} without point: the mean place of nodes is another on each mesh"
              for k, one in enumerate(scene.couplings) if not one.average and one.point is None]  # fmt: skip
    known = "small strain, no phases, forces at nodes, equations or sections: their errors are not known"
    found = [(words, known) for words in found]
    found += [("[dynamics]", "no [dynamics]: the error of motions is not estimated")] * (scene.dynamics is not None)
    for c in scene.contacts:
        if c.formulation not in (None, "nitsche"):
            known = '"nitsche": what other formulations put wrong is not estimated'
            found.append((f'formulation = "{c.formulation}"', known))
        if c.pressure_overclosure is not None:
            known = "hard surfaces: what soft layers put wrong is not estimated"
            found.append((f"pressure_overclosure (contact {c.name})", known))
        if c.smooth_geometry:
            known = "false: facets that are cut are pieces of what they stand for"
            found.append((f"smooth_geometry = true (contact {c.name})", known))
    for words, known in found:
        yield "error", f"{target.words} together with {words}", known
    for one in target.each:
        known = known_names(scene).get(one.quantity)
        if known is not None and one.of_known(known)[0] not in known:
            words = [f"{one.quantity}:{name}" for name in known]
            probes = "; probes of [output] are groups whose displacement is known" * (one.quantity == "displacement")
            yield "of", unknown_name(one.of, f"of no {one.quantity}", words), listed(words) + probes


# -- tables ------------------------------------------------------------------------------------------------------------


def _mesh(scene, mesh) -> Found:
    """A geometry is a file that gmsh knows by its name."""
    name = mesh.geometry
    if name is None:
        return
    if Path(name).suffix.lower() not in GEOMETRIES:
        yield "geometry", repr(str(name)), f"a file {', '.join(GEOMETRIES)}"
    if scene.pretensions:
        section = place("pretensions", 0, scene.pretensions[0].region)
        yield "geometry", f"{str(name)!r} together with {section}, whose two sides are not on it", "either of them"
    yield from _missing(scene, "geometry", name, "a geometry")


def _body(scene, body) -> Found:
    """Serendipity cells alone have reduced integration."""
    if body.integration == "reduced" and not (scene.mesh.serendipity and not holds(RINGS, body, scene)):
        found = "without mesh.serendipity = true" if not scene.mesh.serendipity else "with axial symmetry"
        yield "integration", f'"reduced" {found}', '"full"'


def _material(scene, material) -> Found:
    """Laws of rubber are for finite strain, those of programs for small strain; constants go with their law."""
    yield from _orthotropic(scene, material)
    law = f'"{material.law}"'
    for body in scene.bodies:
        if scene.materials[body.material] is not material:
            continue
        if material.law in RUBBER and not scene.finite(body):
            where = place("bodies", scene.bodies.index(body), body.region)
            yield "law", f"{law} in body {body.region} with small strain", f'{where}.strain = "finite"'
        if material.added and scene.finite(body):
            allowed = " | ".join(f'"{name}"' for name in ("hencky", *RUBBER))
            yield ("law", f"{law} in body {body.region} with finite strain",
                   f'{allowed}; with strain = "small" a law that was added')  # fmt: skip
        if material.law in RUBBER and holds(PLANE_STRESS, body, scene):
            yield "law", f'{law} with kinematics = "plane_stress"', '"hencky"'
    if material.split == "multiplicative" and material.kinematic_hardening > 0:
        yield "split", "multiplicative with kinematic_hardening", '"additive"'
    if material.law in ("mooney_rivlin", "ogden") and getattr(material, material.law) is None:
        yield material.law, "nothing", f"{material.law} together with law = {law}"
    if material.law != "hencky" and material.plastic:
        yield "law", f"{law} of what may yield", '"hencky"'
    if material.law in RUBBER:
        young = (1.0 + material.nu) * sum(modulus * power for modulus, power in material.terms)
        if abs(young - material.E) > ALIKE_MODULI * young:
            yield "E", f"{material.E:g} with a law = {law} of other stiffness", f"{young:.6g}, that of its terms"


def _orthotropic(scene, material) -> Found:
    """Constants along three axes belong together, give every strain an energy, and are those of small strain."""
    if not material.orthotropic:
        three = [key for key in ("nu", "expansion") if isinstance(getattr(material, key), tuple)]
        for key in three + [key for key in ORTHOTROPIC if getattr(material, key) is not None]:
            value = getattr(material, key)
            found = f"{shown(list(value) if isinstance(value, tuple) else value)} without Young's moduli of three axes"
            yield key, found, "E = [E1, E2, E3] as well"
        return
    for key in ("nu", "G", "expansion"):
        value = getattr(material, key)
        if not isinstance(value, tuple) and not (key == "expansion" and value is None):
            found = f"{'nothing' if value is None else shown(value)} together with E of three axes"
            yield key, found, keys(Material)[key].rule.allowed
    wrong = indefinite(material.E, material.nu)
    if wrong is not None:
        yield "nu", *wrong
    if material.axes is not None and parallel(*material.axes):
        found = f"{[list(one) for one in material.axes]}, which are parallel"
        yield "axes", found, "two vectors that span a plane"
    for key in ("yield_stress", "hardening_curve"):
        if getattr(material, key) is not None:
            yield key, f"{key} of an orthotropic material", "nothing: it is elastic, or E a number"
    if material.law != "hencky":
        yield "law", f'"{material.law}" of an orthotropic material', "nothing: it has small strain, or E a number"
    for body in scene.bodies:
        if scene.finite(body):
            found = f"three of an orthotropic material, and body {body.region} with finite strain"
            yield "E", found, "a number, or small strain of all bodies"
    if scene.mesh.mean_dilatation:
        name = next(name for name, one in scene.materials.items() if one is material)
        found = f"true with the orthotropic material {name}"
        raise input_error(scene.where, "mesh.mean_dilatation", found, "nothing: orthotropic bodies go without")


def _contact(scene, contact) -> Found:
    yield from _surfaces(contact)
    if contact.all:
        yield from _all(scene, contact)
    else:
        yield from choice_of(contact, scene, ("target", "obstacle"))
    if isinstance(contact.friction, str):
        for key in ("law", "adhesion"):
            if getattr(contact, key):
                words = "friction that is an expression"
                yield key, f"{key} together with {words}", f"at most one of {key}, {words}"
    if contact.self_contact is not None and (contact.obstacle or not (contact.all or contact.target == contact.source)):
        found = f"{str(contact.self_contact).lower()} with {'an obstacle' if contact.obstacle else 'two surfaces'}"
        yield "self_contact", found, "all = true, or the same source and target"
    if contact.tied and contact.target == contact.source:
        yield "target", f"{contact.target!r} with tied = true", "another surface"
    grows = contact.interference_amplitude is not None and not contact.bilateral
    if grows and (contact.clearance or 0.0) > 0.0:
        found = f"an amplitude of the overlap together with clearance = {contact.clearance:g}, which leaves none"
        yield "interference_amplitude", found, "clearance < 0, none, or bilateral"
    if contact.clearance is not None and (contact.meets_itself or (contact.all and contact.obstacle is None)):
        yield "clearance", f"{contact.clearance:g} of surfaces that meet anywhere", "pairs of two surfaces"
    if contact.pressure_overclosure is not None and contact.formulation not in (None, "penalty"):
        yield "formulation", f'"{contact.formulation}" with pressure_overclosure', 'nothing, or "penalty"'
    yield from _theta(scene, contact)


def _surfaces(contact) -> Found:
    """They stand alone; what the scene itself says of source and target is theirs."""
    named = {contact.source, contact.target}
    if contact.surfaces is not None and (contact.obstacle or contact.all or named != set(contact.surfaces)):
        other = "obstacle" if contact.obstacle else "all" if contact.all else "source or target"
        yield "surfaces", f"surfaces together with {other}", f"at most one of surfaces, {other}"


def _all(scene, contact) -> Found:
    """All surfaces need no name of any, and can hold together as little as one body can be tied to itself."""
    for key in ("source", "target"):
        value = getattr(contact, key)
        if value not in (None, OUTER):
            yield key, f"{shown(value)} together with all = true", "all, or source with target or obstacle"
    for key in ("bilateral", "tied"):
        if getattr(contact, key) and contact.obstacle is None:
            yield key, "true together with all = true", "pairs of two surfaces"
    if contact.theta and len(scene.contacts) > 1:
        # what other pairs do to a facet would be missing in the adjoint term
        yield "theta", f"{contact.theta:g} beside other contacts", "0"
    pairs = sum(other.target is not None and not other.all for other in scene.contacts)
    if pairs > MOST_PAIRS:
        yield "all", f"true beside {pairs} other pairs", f"at most {MOST_PAIRS}"
    first = next((k for k, other in enumerate(scene.contacts) if other.all and other.obstacle is None), None)
    if contact.obstacle is None and scene.contacts[first] is not contact:
        yield "all", f"true a second time, as in contacts[{first}]", "once"


def _theta(scene, contact) -> Found:
    """Penalty and augmented Lagrangian have no adjoint term that theta could weigh."""
    used = contact.formulation or ("penalty" if contact.pressure_overclosure is not None else "nitsche")
    if used == "nitsche" and contact.pressure_overclosure is None:
        return
    said = f'with formulation "{used}"'
    if contact.theta:
        yield "theta", f"{contact.theta:g} {said}", '0, or formulation "nitsche"'
    if contact.adjoint == "consistent":
        yield "adjoint", f"'consistent' {said}, which has no adjoint", 'nothing, or formulation "nitsche"'


def _obstacle(scene, obstacle) -> Found:
    needed, possible = OBSTACLE_KEYS[obstacle.shape]
    allowed, declared = (*needed, *possible, *MOTION_KEYS), keys(Obstacle)
    said = [key for key in declared if key != "shape" and getattr(obstacle, key) not in (None, False)]
    for key in said:
        if key not in allowed:
            yield key, f'a key that shape "{obstacle.shape}" does not have', ", ".join(("shape", *allowed))
    for key in needed:
        if key not in said:
            yield key, "nothing", declared[key].rule.allowed
    yield from {"level_set": _level_set, "punch": _punch}.get(obstacle.shape, lambda *_: ())(scene, obstacle)
    if obstacle.shape == "mesh":
        yield from _missing(scene, "file", obstacle.file, "a mesh file")
    if obstacle.shape == "torus" and obstacle.radius > obstacle.ring_radius:
        # tubes are thinner than their rings
        yield "radius", f"{obstacle.radius:g}, more than ring_radius", f"at most ring_radius = {obstacle.ring_radius:g}"


def _punch(scene, obstacle) -> Found:
    """Edges are not rounder than the face."""
    yield from choice_of(obstacle, scene, ("radius", "width"))
    half = obstacle.radius if obstacle.width is None else 0.5 * obstacle.width
    if (obstacle.edge_radius or 0.0) > half:
        yield "edge_radius", f"{obstacle.edge_radius:g}, more than half of the face", f"at most {half:g}"
    if obstacle.axis is not None and obstacle.width is None:
        yield "axis", "an axis of a round punch", "width instead of radius"


def _level_set(scene, obstacle) -> Found:
    declared = keys(Obstacle)
    if obstacle.expression is None and obstacle.function is None:
        yield "function", "nothing", f"{declared['function'].rule.allowed}; or expression"
    for key in ("function", "gradient"):
        reference = getattr(obstacle, key)
        if isinstance(reference, str) and not (scene.folder / reference.rpartition(":")[0]).is_file():
            yield key, f"{reference!r}, no such file", f"{declared[key].rule.allowed}, in {scene.folder.absolute()}"
    if obstacle.angle is not None and obstacle.pivot is None:
        yield "pivot", "nothing", declared["pivot"].rule.allowed


def _load(scene, load) -> Found:
    if load.region is None and load.at is None:
        more = "; or at, the place of a node" if load.total else ""
        yield "region", "nothing", f"{keys(Load)['region'].rule.allowed}{more}"
    if load.angular_speed is not None and not holds(RINGS, load, scene) and load.point is None:
        yield "point", "nothing", keys(Load)["point"].rule.allowed


def _temperature(scene, item) -> Found:
    """Thermal strain is one of small strain."""
    if item.file is not None:
        yield from _missing(scene, "file", item.file, "a file")
    for body in scene.bodies:
        if scene.finite(body):
            yield "", f"body {body.region} with finite strain", "thermal strain with small strain of all bodies"


def _displacement(scene, item) -> Found:
    if item.angle is not None and expressions(item.value):
        yield "value", f"{shown(list(item.value))} together with angle", "numbers, it moves as a rigid body"


def _coupling(scene, item) -> Found:
    """Rigid groups turn by small angles; rings do not turn in their plane, and do not widen as rigid ones."""
    first = item.displacement[0] if item.displacement else "free"
    if holds(RINGS, item, scene):
        if item.rotation not in (None, "free") or first != "free":
            found = f'{"rotation" if first == "free" else "a radial displacement"} with kinematics = "axisymmetric"'
            yield "", found, 'displacement = ["free", ...] alone: a rigid ring'
        return
    held = all(one == 0.0 for one in (item.rotation if isinstance(item.rotation, tuple) else (item.rotation,)))
    for body in scene.bodies:
        if scene.finite(body) and not held:
            yield ("", f"body {body.region} with finite strain, and a group that turns",
                   "small strain; or rotation = 0 in all directions; or displacements with an angle")  # fmt: skip


def _pretension(scene, item) -> Found:
    """Sides of sections are no surfaces that may meet, and turn little."""
    if any(scene.finite(body) for body in scene.bodies):
        yield "", "bodies with finite strain", "small strain of all bodies"
    if any(contact.all for contact in scene.contacts):
        found = "a contact of all surfaces, which the sides of the section are, too"
        yield "", found, "contacts with source and target"


def _steps(scene, steps) -> Found:
    if scene.phases:
        return
    if steps.smallest_step > steps.end / steps.count:
        allowed = f"at most end / count = {steps.end / steps.count:g}"
        yield "min_step", f"{steps.min_step!r}, longer than a step", allowed
    if steps.max_step is not None and steps.max_step < steps.smallest_step:
        yield "max_step", f"{steps.max_step:g}", f"at least min_step = {steps.smallest_step:g}"
    if steps.smallest_step < SMALLEST * steps.end:
        # shorter ones drown in the rounding error of the time: a run would not get on
        yield "min_step", f"{steps.smallest_step!r}", f"at least {SMALLEST:g} end = {SMALLEST * steps.end:g}"


CHECKS = {
    MeshSpec: _mesh, Body: _body, Material: _material, Contact: _contact, Obstacle: _obstacle, Load: _load,
    Temperature: _temperature, Displacement: _displacement, Coupling: _coupling, Pretension: _pretension,
    Phase: _phase, Steps: _steps, Output: _output, Target: _target,
}  # fmt: skip


def unsafe(scene: Scene, word: str, key: str, found: str, allowed: str) -> None:
    """Refuse a setting, or warn of it if ``allow_unsafe`` has the word. All ranks must agree on the setting.

    Parameters
    ----------
    scene : Scene
    word : str
        Of `pcontact.scene.model.UNSAFE`.
    key : str
        Where it stands in the scene.
    found, allowed : str
        What the message says.

    Raises
    ------
    InputError
        Unless it is allowed.
    """
    if word not in scene.allow_unsafe:
        raise input_error(scene.where, key, found, f"{allowed}; -allow_unsafe {word} runs it all the same")
    log.warning("%s: found %s; safe: %s", key, found, allowed)
