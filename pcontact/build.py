"""From the scene to the rooms below: mesh, space, items, problem."""

import math
from functools import partial
from pathlib import Path

import numpy as np

from pcontact.assembly.coupling import AverageCoupling, TotalLoad
from pcontact.assembly.finite import FiniteSolid, MixedSolid
from pcontact.assembly.follower import FollowerPressure
from pcontact.assembly.geometry import chunks
from pcontact.assembly.heat import Heat, Heating
from pcontact.assembly.inertia import Inertia, Snap
from pcontact.assembly.loads import TimedLoad, load_vector, lumped_volume, value_of
from pcontact.assembly.mass import Mass
from pcontact.assembly.nodal_field import NodalField
from pcontact.assembly.patches import kind_of
from pcontact.assembly.phases import Release
from pcontact.assembly.solid import Solid
from pcontact.assembly.springs import GroundSprings, SpinForces
from pcontact.assembly.viscous import ViscousStabilisation
from pcontact.contact.search.unjoined import unjoined
from pcontact.element.reference import CELLS, facet_kinds
from pcontact.material.elastic import Elastic
from pcontact.material.finite import FiniteMaterial
from pcontact.material.laws import ADDED, small_strain
from pcontact.mesh.distribute import load_mesh
from pcontact.mesh.geometry.moving import put_on
from pcontact.mesh.hdf5 import is_converted
from pcontact.mesh.mesh import bounding_box
from pcontact.mesh.raw import BY_PLACE, RawMesh
from pcontact.mesh.topology import OTHER, cut, missing, without
from pcontact.pairs import contact_reports, oriented, since_of, tied_pairs
from pcontact.runtime import log, profile
from pcontact.runtime.errors import TOLD, counted, input_error
from pcontact.runtime.parallel import together
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.amplitude import Squared, amplitude, amplitude_of
from pcontact.scene.expressions import Condition
from pcontact.scene.functions import Prescribed, require_no_code
from pcontact.scene.integrators import INTEGRATORS
from pcontact.scene.keys import options as key_options
from pcontact.scene.model import LOCKING, POOR, RUBBER, Contact, place
from pcontact.scene.phases import groups_of, left, scene_of
from pcontact.scene.regions import check_apart, check_dimension, check_lost, check_radius, check_region, check_regions
from pcontact.scene.target import Budget, Target
from pcontact.scene.validate import resolve_contacts, unsafe, validate
from pcontact.solve.preconditioners import MOST_COLOURS
from pcontact.solve.problem import Features, Problem
from pcontact.space.constraints import Equations, PretensionSection, RigidGroup, linear_rows, pair_rows, term_rows
from pcontact.space.modes import colour, component_frames, free_motions, join
from pcontact.space.space import Space
from pcontact.space.supports import Supports, Turn

# [modulus / size^2, per volume] What is added to the diagonal of the tangent, never to the residual, for bodies that no
# support holds. Each Newton iteration reduces the error of such a body's position only to the ratio of this stiffness
# to that of what the body rests on, which may be the softest body. Row: stabilisation.
STABILISATION = 1e-6
# [-] A modulus counts up to so many times that of the softest body only. Row: stabilisation.
CONTRAST = 100.0
# [modulus / size^2, per volume] So much of a body's own modulus counts nevertheless. From: 5000 rounding errors of the
# diagonal.
LEAST = 1e-12
# [degrees] Turn of bodies with small strain that is refused. From: the strain of the turn, 1.5 % and more, is larger
# than any that small strain is for.
FAR = 10.0
# [-] Part of the magnitudes of a load below which a component of it is but rounding. From: sums of some thousand terms.
IDLE = 1e-9


def override(scene, options, accuracy):
    """The scene with what the command line says. Options of the scene enter the database unless the user set them.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    options : pcontact.runtime.options.Options
    accuracy : pcontact.runtime.presets.Choice
        Told the preset.

    Returns
    -------
    Scene
        A new one, valid, with the numerics of all contacts resolved, and nothing in it that is not modelled.
    """
    validate(scene)
    # the caller may run it again, with other options
    scene = scene.copy()
    if options.get("no_code"):
        require_no_code(scene)
    options.propose(scene.petsc)
    changed = False
    for table in (scene, scene.mesh, scene.steps, scene.output):
        for key, option in key_options(type(table)).items():
            before = getattr(table, key)
            after = options.get(option, before)
            changed = changed or after is not before
            setattr(table, key, after)
    output = scene.output
    if output.checkpoint is None or options.given("checkpoint_every"):
        output.checkpoint = output.checkpoint_every is not None
    output.checkpoint_every = output.checkpoint_every or 1
    output.energy = output.energy or scene.dynamics is not None
    if options.given("mesh"):
        # named from where the command line is
        scene.mesh.file = Path(scene.mesh.file).absolute()
    # those of an error to reach have been asked for by the loop
    options.known |= {one.name: one for cls in (Target, Budget) for one in key_options(cls).values()}
    accuracy.name = scene.accuracy if isinstance(scene.accuracy, str) else None
    said = {key: options.get(option, None) for key, option in key_options(Contact).items()}
    if changed:
        validate(scene)
    return resolve_contacts(scene, {key: value for key, value in said.items() if value is not None}, options.said)


def _pairs(scene):
    """Source, target (None: an obstacle) and search radius of all contacts, both ways where both sides are sources."""
    pairs = []
    for contact in scene.contacts:
        if contact.all:
            continue
        pairs.append((contact.source, contact.target, contact.search_radius))
        if contact.unbiased and contact.target not in (None, contact.source):
            pairs.append((contact.target, contact.source, contact.search_radius))
    return pairs


def balance(scene, options):
    """Return what the partition of a scene's mesh depends on: pairs of surfaces, weight of their facets, method."""
    method = options.get("partition", "graph" if options.given("petscpartitioner_type") else "bisection")
    return _pairs(scene), options.get("partition_weight"), method


def read(scene, comm, options, degree=None):
    """The distributed mesh of a scene. *Collective.*

    `degree`: of the displacement, by a mesh that is whole, where the scene does not say.
    """
    pairs, weight, method = balance(scene, options)

    def check(mesh):
        check_dimension(scene, mesh.dim)
        _select(scene, mesh)
        if scene.mesh.kinematics == "axisymmetric":
            check_radius(scene, mesh.points, mesh.path)
        check_lost(scene, mesh.lost, mesh.path)
        whole = isinstance(mesh, RawMesh)
        box = (mesh.points.min(axis=0), mesh.points.max(axis=0)) if whole else None
        check_regions(scene, mesh.cell_groups, mesh.facet_groups, mesh.node_groups, mesh.path, box)
        check_apart(scene, getattr(mesh, "common", {}))
        _cut(scene, mesh)

    regions, order, serendipity = [b.region for b in scene.bodies], scene.mesh.order, scene.mesh.serendipity
    if order is None and scene.mesh.geometry is not None and not is_converted(scene.mesh_path):
        # cells that are to curve have nodes in the middles of their edges
        order = 2
    order = degree if order is None else order
    try:
        mesh = load_mesh(comm, scene.mesh_path, order, regions, pairs, check, (weight, method), serendipity)
    except PETSc.Error as error:
        # of the partitioner
        raise options.fault(error) or error from error
    if scene.mesh.geometry is not None:
        put_on(mesh, scene.folder / scene.mesh.geometry, scene.where)
    return mesh


def _select(scene, mesh):
    """Make the groups that the scene makes by place."""
    groups = {"cells": mesh.cell_groups, "facets": mesh.facet_groups, "nodes": mesh.node_groups}
    if all(one.name in groups[one.kind] for one in scene.regions) and not isinstance(mesh, RawMesh):
        # an adapted mesh has them
        return
    parts = None if isinstance(mesh, RawMesh) else mesh.parts
    raw = mesh if parts is None else parts.held
    if not isinstance(raw, RawMesh):
        found = f"groups by place with the converted mesh {mesh.path}"
        raise input_error(scene.where, "regions", found, "the file that it was converted from, or groups in that")
    size = float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
    for number, one in enumerate(scene.regions):
        check_region(scene, number, mesh.dim, groups, mesh.path)
        test = Condition("x == x" if one.where is None else one.where)
        made = BY_PLACE[one.kind](raw, partial(test, size=size), raw.cell_groups.get(one.of))
        if one.kind == "nodes":
            made, raw.edge_groups[one.name] = made
        groups[one.kind][one.name] = made = made if parts is None else parts.settle(one.kind, one.name, made)
        if not (made if isinstance(made, int) else len(made[0] if one.kind == "facets" else made)):
            found = f"{one.where!r}, where there are no {one.kind}{f' of {one.of}' if one.of else ''}"
            low, high = (corner.tolist() for corner in (mesh.points.min(axis=0), mesh.points.max(axis=0)))
            allowed = f"a condition that some fulfil; the mesh goes from {low} to {high}"
            raise input_error(scene.where, f"{place('regions', number, one.name)}.where", found, allowed)


def _cut(scene, mesh):
    """Cut bolts at their sections."""
    for number, one in enumerate(scene.pretensions):
        if not isinstance(mesh, RawMesh):
            found = f"a section of the converted mesh {mesh.path}, whose nodes cannot be doubled"
            where = f"{place('pretensions', number, one.region)}.region"
            raise input_error(scene.where, where, found, "the file that it was converted from")
        cut(mesh, one.region)


def present(scene, mesh):
    """A scene of one phase, and the mesh, without the bodies that are absent. *Collective.*

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        Of the phase.
    mesh : pcontact.mesh.mesh.Mesh
        With all bodies; left as it is where some are absent.

    Returns
    -------
    scene : pcontact.scene.model.Scene
        Without what is on absent bodies alone.
    mesh : pcontact.mesh.mesh.Mesh

    Raises
    ------
    InputError
        On every rank: the phase names a contact that has a surface no more.
    """
    absent = {number for number, body in enumerate(scene.bodies) if body.absent}
    if not absent:
        return scene, mesh
    mesh = without(mesh, absent, [body.region for body in scene.bodies])
    return left(scene, missing(mesh, groups_of(scene))), mesh


def check_present(scene, mesh):
    """Refuse what phases say of contacts whose bodies are not there. *Collective.*

    Raises
    ------
    InputError
        On every rank.
    """
    for number, phase in enumerate(scene.phases):
        said = {name: key for key in ("friction", "tied") for name in getattr(phase, key) or ()}
        there = {one.name for one in present(scene_of(scene, number), mesh)[0].contacts} if said else set()
        for name in sorted(said.keys() - there):
            where = f"{place('phases', number, phase.name)}.{said[name]}"
            found = f"{name!r}, of which a body is absent in this phase"
            raise input_error(scene.where, where, found, "contacts of bodies that are there")


def _laws(scene, dim):
    """Laws of small strain of the bodies. Refused are those that this program has not added, and those that do not say
    what they store where that is asked for."""
    laws = []
    for body in scene.bodies:
        material, where = scene.materials[body.material], f"materials.{body.material}.law"
        if material.added and material.law not in ADDED:
            added = " | ".join(map(repr, ADDED)) or "none: this program has added no material (pcontact.add_material)"
            allowed = f'"hencky" | {" | ".join(map(repr, RUBBER))}, or a law that was added, {added}'
            raise input_error(scene.where, where, repr(material.law), allowed)
        laws.append(small_strain(material, dim, scene.mesh.kinematics))
        if scene.output.energy and material.added and getattr(laws[-1], "energy", None) is None:
            found = f"true with the law {material.law!r}, which does not say what it stores"
            raise input_error(scene.where, "output.energy", found, "false, or a law with a method energy")
    return laws


def bulk_item(scene, space, laws):
    """The item of all bodies: one of small strain, of finite strain, or of both. *Collective.*

    Parameters
    ----------
    laws : list of pcontact.material.elastic.Elastic
        Of small strain, of each body.
    """
    materials = [scene.materials[body.material] for body in scene.bodies]
    finite = [FiniteMaterial.of(material, scene.mesh.kinematics) if scene.finite(body) else None
              for body, material in zip(scene.bodies, materials, strict=True)]  # fmt: skip
    with profile.phase("bulk_assembly"):
        if all(finite):
            return FiniteSolid(space, [law.constants for law in laws], finite)
        if any(finite):
            return MixedSolid(space, laws, finite)
        return Solid(space, laws, _heat(scene, space, laws))


def _stabilisation(space, laws, free):
    """Diagonal (n_owned,) that stabilises components, free as far as supports go. *Collective.*"""
    if not free:
        return np.zeros(space.n_owned)
    _, scale = component_frames(space)
    modulus = np.zeros(space.mesh.n_components)
    for block in space.mesh.blocks:
        lam, mu = laws[block.body].constants
        # the P-wave modulus, unless the body is nearly incompressible
        modulus[block.components] = min(lam + 2.0 * mu, 4.0 * mu)
    modulus = np.array(space.comm.allgather(modulus)).max(axis=0)
    softest = np.min(modulus)
    stiffness = np.zeros(space.mesh.n_components)
    for k in free:
        added = max(STABILISATION * min(modulus[k], CONTRAST * softest), LEAST * modulus[k])
        stiffness[k] = added / scale[k] ** 2
    return lumped_volume(space) * stiffness[space.component[space.owned_local]]


def averaged_bodies(scene, space):
    """Regions of the bodies that have cells with mean dilatation. *Collective.*"""
    mine = {block.body for block in space.mesh.blocks if len(block.nodes) and space.averages(block)}
    bodies = set().union(*space.comm.allgather(mine))
    return [body.region for number, body in enumerate(scene.bodies) if number in bodies]


def yielding_volume(scene, space):
    """Volume of the bodies that may yield [length^d]. *Collective.*"""
    own = [
        float(jxw.sum())
        for number, block in enumerate(space.mesh.blocks)
        if scene.yields(scene.bodies[block.body])
        for _, _, jxw, _ in chunks(space, number)
    ]
    return space.comm.allreduce(sum(own))


def _check_estimate(scene, space):
    """Refuse an estimate of the error with cells that it does not know. *Collective.*"""
    if not scene.output.estimate:
        return
    mine = {block.cell for block in space.mesh.blocks if len(block.nodes)}
    kinds = sorted(cell for cell in set().union(*space.comm.allgather(mine)) if len(facet_kinds(cell)) > 1)
    if kinds:
        allowed = "false, or cells that are neither wedges nor pyramids"
        raise input_error(scene.where, "output.estimate", f"true with cells of the kind {kinds[0]}", allowed)
    spread = [("loads", one, False) for one in scene.loads if one.total]
    spread += [("springs", one, False) for one in scene.springs]
    spread += [("couplings", one, not one.average) for one in scene.couplings]
    for key, one, rigid in spread:
        kind = kind_of(space, one.region)
        if kind == "nodes" or (rigid and kind == "cells"):
            where = place(key, [one is other for other in getattr(scene, key)].index(True), one.region)
            allowed = f"false and no error to reach, or a group of facets{'' if rigid else ' or cells'}"
            raise input_error(scene.where, "output.estimate", f"true with {where}, a group of {kind}", allowed)


def _check_locking(scene, space):
    """Refuse, or warn of, bodies that are too stiff because their simplices of degree 1 lock, or all of their cells of
    degree 1 where they have no mean dilatation. *Collective.*"""
    mine = {block.body for block in space.mesh.blocks if len(block.nodes) and (
        CELLS[block.cell].is_simplex or scene.materials[scene.bodies[block.body].material].orthotropic)}  # fmt: skip
    bodies = set().union(*space.comm.allgather(mine))
    for number in sorted(bodies):
        body = scene.bodies[number]
        if space.degree == 2 and not scene.lower(body):
            continue
        if scene.locks(body):
            unsafe(
                scene, "locking", f"materials.{body.material}.nu",
                _stiff(scene, body), f"order = 2, or quadrilaterals or hexahedra, or nu <= {LOCKING:g}",
            )  # fmt: skip
        elif scene.yields(body) and space.kinematics != "plane_stress":
            log.warning(
                "body %s: plastic flow, which keeps the volume, makes triangles and tetrahedra of degree 1 much too "
                "stiff (locking); remedy: order = 2, or quadrilaterals or hexahedra",
                body.region,
            )  # fmt: skip
    if space.degree == 2 and space.kinematics != "plane_stress":
        _warn_of_stress(scene)


def _stiff(scene, body):
    """Reason for which a body of degree 1 is too stiff."""
    material = scene.materials[body.material]
    if material.orthotropic:
        return (f"{list(material.nu)} in cells of degree 1 (body {body.region}), as nu = {material.poisson:.4g} of an "
                "isotropic body: much too stiff (locking)")  # fmt: skip
    return f"{material.nu:g} in triangles or tetrahedra of degree 1 (body {body.region}), much too stiff then (locking)"


def _followers(scene, space, supports):
    """The items of the pressures that follow their surfaces. *Collective.*"""
    return [
        FollowerPressure(space, load.region, _prescribed(scene, number), amplitude_of(load, scene.steps.end),
                         supports.fixed, f"loads[{number}] ({load.region})")
        for number, load in enumerate(scene.loads) if load.follower
    ]  # fmt: skip


def _prescribed(scene, number):
    """The value of a load, as a function of place and time."""
    load = scene.loads[number]
    key, value = value_of(load)
    return Prescribed(value, scene.where, f"{place('loads', number, load.region)}.{key}")


def _forces(scene, space, supports):
    """Nodal forces at factor 1 with their amplitudes, loads whose expressions have the time, and those of which the
    report has the resultant. *Collective.*"""
    forces, timed, total = [], [], []
    for number, load in enumerate(scene.loads):
        if load.follower:
            continue
        factor, where = amplitude_of(load, scene.steps.end), place("loads", number, load.region)
        if load.total:
            total.append(TotalLoad(space, load, number, factor, (scene.where, where)))
            forces.append((total[-1].vector, factor))
            _warn_of_idle(space, supports, forces[-1], where)
            continue
        prescribed = _prescribed(scene, number)
        if prescribed.timed:
            timed.append(TimedLoad(space, load, prescribed, factor, _masses(scene, space, load, where)))
        else:
            factor = factor if load.angular_speed is None else Squared(factor.times, factor.factors)
            vector = load_vector(space, load, prescribed, 0.0, _masses(scene, space, load, where))
            forces.append((vector, factor))
            _warn_of_idle(space, supports, forces[-1], where)
    return forces, timed, total


def _warn_of_idle(space, supports, force, where):
    """Say of a load that it moves nothing: its factor is always zero, or supports take all of a component.
    *Collective.*"""
    vector, factor = force
    if not factor.factors.any():
        log.warning("%s: its amplitude is zero at all times: it does nothing", where)
        return
    size = np.abs(vector).reshape(-1, space.dim)
    free = np.where(supports.fixed[space.owned_local], 0.0, size)
    every, left = space.comm.allreduce(np.array([size.sum(axis=0), free.sum(axis=0)]), op=MPI.SUM)
    # a component that is but rounding of the others is none
    idle = [axis for k, axis in enumerate("xyz"[: space.dim]) if every[k] > IDLE * every.sum() and left[k] == 0.0]
    if idle:
        log.warning("%s: in direction %s all its nodes have a prescribed displacement: there it does nothing", where,
                    ", ".join(idle))  # fmt: skip


def _masses(scene, space, load, where):
    """Density of the bodies, of a load per mass; refuse it in bodies that have none. *Collective.*"""
    if load.acceleration is None and load.angular_speed is None:
        return ()
    masses = [scene.materials[body.material].density for body in scene.bodies]
    groups = space.mesh.cell_groups.get(load.region, [])
    own = {block.body for block, rows in zip(space.mesh.blocks, groups, strict=False) if len(rows)}
    for body in sorted(set().union(*space.comm.allgather(own))):
        if masses[body] is None:
            found = f"body {scene.bodies[body].region} without density"
            allowed = f"density of [materials.{scene.bodies[body].material}]"
            raise input_error(scene.where, f"{where}.{value_of(load)[0]}", found, allowed)
    return masses


def _spinning(scene, space):
    """Return what the displacement adds to centrifugal forces in bodies with finite strain. *Collective.*"""
    finite = {number: scene.materials[body.material].density
              for number, body in enumerate(scene.bodies) if scene.finite(body)}  # fmt: skip
    result = []
    for number, load in enumerate(scene.loads):
        if load.angular_speed is not None and finite:
            factor, name = amplitude_of(load, scene.steps.end), place("loads", number, load.region)
            result.append(SpinForces(space, load, name, finite, Squared(factor.times, factor.factors)))
    return result


def _heat(scene, space, laws):
    """Thermal stress of the bodies, None without temperatures. *Collective.*"""
    if not scene.temperatures:
        return None
    absent = any(body.absent for body in scene.bodies)
    if absent and not any(scene.materials[one.material].expansion for one in scene.bodies if not one.absent):
        return None
    heatings = []
    for number, one in enumerate(scene.temperatures):
        where = place("temperatures", number, one.region)
        value = Prescribed(one.value, scene.where, f"{where}.value") if one.file is None else partial(
            NodalField, space, path=scene.folder / one.file, name=one.field, where=(scene.where, where))  # fmt: skip
        heatings.append(Heating(one.region, value, one.reference, amplitude_of(one, scene.steps.end), where))
    return Heat(space, heatings, laws, scene.where)


def _rigid_groups(scene, space, supports):
    """The groups that move as rigid bodies; bodies that one joins are one from here on. *Collective.*"""
    groups = []
    for one, factor, where in _moved(scene, "couplings"):
        if not one.average:
            groups.append(RigidGroup(space, one, factor, supports.fixed | _nodes_of(space, groups), where))
            _join(space, groups[-1].nodes)
    return groups


def _moved(scene, key):
    """Tables of a list that have amplitudes: the table, its factor, and scene and key path for messages."""
    for number, one in enumerate(getattr(scene, key)):
        yield one, amplitude(one.amplitude, scene.steps.end), (scene.where, place(key, number, one.region))


def _averages(scene, space, supports, groups):
    """The groups whose mean motion is prescribed; bodies that one joins are one from here on. *Collective.*"""
    taken, found = _nodes_of(space, groups), []
    for one, factor, where in _moved(scene, "couplings"):
        if not one.average:
            continue
        found.append(AverageCoupling(space, one, factor, supports.fixed, where))
        clash = space.comm.allreduce(bool(taken[found[-1].nodes].any()), op=MPI.LOR)
        if clash and found[-1].rows:
            said = f"{one.region!r}, of which nodes are in another coupling, or in a section"
            raise input_error(where[0], f"{where[1]}.region", said, "a group of its own")
        if found[-1].rows:
            taken[found[-1].nodes] = True
            _join(space, found[-1].nodes)
    return found


def _nodes_of(space, groups):
    """Components (n_local, d) of the nodes of some groups."""
    taken = np.zeros((space.n_local, space.dim), dtype=bool)
    for group in groups:
        taken[group.nodes] = True
    return taken


def _join(space, nodes):
    """Bodies that have some of local nodes are one from here on. *Collective.*"""
    bodies = sorted(set().union(*space.comm.allgather(set(space.component[nodes].tolist()))))
    if len(bodies) > 1:
        join(space, np.column_stack([bodies[:-1], bodies[1:]]))


def _sections(scene, space, fixed):
    """The sections that are drawn together; bodies on both sides of one are one from here on. *Collective.*"""
    sections = []
    for one, factor, where in _moved(scene, "pretensions"):
        sections.append(PretensionSection(space, one, factor, fixed, where))
        _join(space, sections[-1].nodes)
    return sections


def _drawn(space, sections):
    """Components whose two sides of a section a force draws together, and nothing but contact holds. *Collective.*"""
    own = {int(c) for section in sections if section.free for c in space.component[section.nodes]}
    return set().union(*space.comm.allgather(own))


def _equations(scene, space, supports, groups, averages, lower):
    """Linear equations between components of the displacement, with the rows of bodies of degree 1; None without any.
    *Collective.*"""
    if not (scene.equations or scene.periodic or lower or any(one.rows for one in averages)):
        return None
    paths = [place("equations", number, one.region) for number, one in enumerate(scene.equations)]
    rows = term_rows(space, scene.equations, (scene.where, paths))
    for number, one in enumerate(scene.periodic):
        path = place("periodic", number, one.region)
        found = pair_rows(space, one, _motion(one, space.dim), (scene.where, path))
        rows, paths = rows + found, paths + [path] * len(found)
    given = _given(space, averages, rows, paths, scene.where)
    if lower:
        first = next(number for number, body in enumerate(scene.bodies) if scene.lower(body))
        # they are the last: what equations say of nodes in the middles they say of the vertices
        rows, paths = rows + lower, paths + [f"{place('bodies', first, scene.bodies[first].region)}.order"] * len(lower)
    said = bool(scene.equations or scene.periodic)
    return Equations(space, rows, supports.fixed, _nodes_of(space, groups), (scene.where, paths), said, given)


def _given(space, averages, rows, paths, source):
    """Add the equations of mean motions to others, which have none of their components; the values that they are
    given, functions of time, by their numbers."""
    given, others = {}, {component for row in rows for component in row}
    for one in averages:
        for value, row in zip(one.values, one.rows, strict=True):
            if others & row.keys():
                found = f"the group of the coupling {one.name!r}, of which nodes are in an equation or a periodic group"
                raise input_error(source, f"couplings ({one.name}).region", found, "a group without them")
            number = space.n_dofs + len(given)
            given[number] = lambda time, value=value, factor=one.amplitude.factor: value * factor(time)
            rows.append({**row, number: -1.0})
            paths.append(f"couplings ({one.name})")
    return given


def _lower_rows(scene, space):
    """Rows of the equations of nodes in the middles of bodies of degree 1. *Collective.*"""
    lower = {number for number, body in enumerate(scene.bodies) if scene.lower(body)}
    return linear_rows(space, lower) if lower else []


def _lower(scene, space, rows):
    """These equations as if nothing were prescribed, or None. *Collective.*"""
    none = np.zeros((space.n_local, space.dim), dtype=bool)
    return Equations(space, rows, none, none, (scene.where, [""] * len(rows))) if rows else None


def _motion(periodic, dim):
    """Q and s of the motion x -> Q x + s of a periodic pair."""
    shift = np.zeros(dim) if periodic.translation is None else np.array(periodic.translation)
    if periodic.angle is None:
        return np.eye(dim), shift
    turn = Turn(periodic.point, periodic.axis, np.radians(periodic.angle))
    matrix = np.eye(dim) + turn.displacement(turn.point + np.eye(dim), 1.0).T
    return matrix, shift + turn.point - matrix @ turn.point


# [degrees] Turn of bodies with small strain that needs no word. From: they shrink by less than 0.1 %, 1 - cos.
UNTURNED = 2.5


def _check_turns(scene, space, supports):
    """Refuse, or warn of, supports that turn bodies with small strain farther than it represents. *Collective.*"""
    for number in supports.turns:
        nodes, angle = supports.nodes[number], np.degrees(supports.largest_turn(number))
        own = {block.body for block, cells in zip(space.mesh.blocks, space.cells, strict=True)
               if np.isin(nodes, cells).any()}  # fmt: skip
        bodies = sorted(set().union(*space.comm.allgather(own)))
        small = [scene.bodies[body].region for body in bodies if not scene.finite(scene.bodies[body])]
        if not small or angle <= UNTURNED:
            continue
        where, names = f"displacements[{number}] ({supports.regions[number]}).angle", ", ".join(small)
        strain = 100.0 * (1.0 - np.cos(np.radians(angle)))
        found = f"a turn by {angle:g} degrees of bodies with small strain ({names}), which shrink by {strain:.2g} %"
        if angle > FAR:
            unsafe(scene, "turn", where, found, f'strain = "finite" of these bodies, or at most {FAR:g} degrees')
        else:
            log.warning('%s: %s; remedy: strain = "finite"', where, found)


def _check_joined(scene, space):
    """Refuse, or warn of, boundary facets inside a body; warn of bodies that touch without contact. *Collective.*"""
    every = [contact for contact in scene.contacts if contact.all and contact.obstacle is None]
    if any(contact.self_contact for contact in every):
        return
    mesh = space.mesh
    used = {one.region for one in (*scene.displacements, *scene.loads, *scene.springs, *scene.couplings)} - {None}
    used |= {name for one in scene.pretensions for name in (one.region, OTHER.format(one.region))}
    used |= {name for contact in scene.contacts for name in (contact.source, contact.target) if name is not None}
    found = unjoined(mesh, space.exchanger, used, not every)
    if found.doubled or found.hanging:
        kinds = {"with nodes that are there twice": found.doubled, "with hanging nodes": found.hanging}
        counts = " and ".join(f"{count} {words}" for words, count in kinds.items() if count)
        unsafe(
            scene, "mesh", "mesh.file",
            f"{scene.mesh.file}, which has facets inside a connected body that lie on each other without being joined, "
            f"{counts}, the first at {', '.join(found.places)}: the body is cut there",
            "nodes in the same place merged; cells that meet facet to facet, or two bodies and a tied pair of them; "
            "for a crack, contact of its sides, or a group of their facets",
        )  # fmt: skip
    if found.named:
        log.warning(
            "%d facets inside a connected body lie on others without being joined, groups of the mesh have them, and "
            "the scene does not name these: a crack whose sides may pass through each other", found.named,
        )  # fmt: skip
    names = []
    for both in found.bodies:
        one, other = sorted(mesh.component_names[each] for each in both)
        names.append(f"{one} - {other}" if one != other else f"pieces of {one} (nodes in the same place, not merged?)")
    if names:
        log.warning("bodies touch and no contact is between their facets: %s; they may pass through each other",
                    counted(names))  # fmt: skip


def _warn_of_stress(scene):
    """Say in which bodies the pressure is much less accurate than the displacement."""
    for body in scene.bodies:
        material = scene.materials[body.material]
        nu = material.poisson
        if nu > POOR and material.orthotropic:
            log.warning(
                "body %s: the orthotropic material is nearly incompressible, as nu = %.4g of an isotropic one: stress "
                "and contact pressure are less accurate (locking); remedy: smaller cells", body.region, nu,
            )  # fmt: skip
        elif nu > POOR and scene.mesh.mean_dilatation is False:
            log.warning(
                "body %s: nu = %g: without mean dilatation cells of degree 2 multiply errors of the volume change by "
                "%.0f in stress and contact pressure (locking); remedy: no mean_dilatation = false",
                body.region, nu, nu / (1.0 - 2.0 * nu),
            )  # fmt: skip


def _rigid_nodes(space, supports, groups):
    """Nodes (n_local,) that have no motion of their own: held in all directions, of a rigid group, or between such
    nodes of a cell of degree 1."""
    rigid = supports.fixed.all(axis=1)
    for group in groups:
        rigid[group.nodes] = True
    for block, cells in zip(space.mesh.blocks, space.cells, strict=True):
        if space.degree_of(block) < space.degree:
            corners = cells[:, : CELLS[block.cell].n_vertices]
            rigid[cells[rigid[corners].all(axis=1)].ravel()] = True
    return rigid


def _inertia(scene, space, laws, groups):
    """The item of inertia; None without. *Collective.*"""
    said = scene.dynamics
    if said is None:
        return None
    mass, damping = mass_of(scene, space, groups), None
    densities = _densities(scene)
    slow = {body.region: body.mass_damping * densities[body.region] for body in scene.bodies
            if body.mass_damping and body.region in densities}  # fmt: skip
    if slow:
        damping = Mass(space, slow, said.mass == "lumped").values
    times = [body.stiffness_damping for body in scene.bodies]
    if any(times):
        # the pattern is that of all cells, too
        pairs = zip(times, (law.constants for law in laws), strict=True)
        scaled = [Elastic(time * lam, time * mu) for time, (lam, mu) in pairs]
        damping = Solid(space, scaled).values + (0.0 if damping is None else damping)
    row = INTEGRATORS[said.integrator]
    weights = row.weights(row.alpha if said.alpha is None else said.alpha)
    return Inertia(space, mass, damping, weights, partial(_initial_motion, scene, space), said.step_error)


def _snap(scene, space, groups, bulk):
    """The item that leads bodies through snaps; its motions begin with a step in which waves cross them all.
    *Collective.*"""
    used = [scene.materials[body.material] for body in scene.bodies if not body.absent]
    slowness = max(math.sqrt(one.density / np.max(one.E)) for one in used)
    low, high = bounding_box(space.comm, space.mesh.points)
    return Snap(space, mass_of(scene, space, groups), slowness * float(np.linalg.norm(high - low)), bulk)


def _densities(scene):
    """Densities of the bodies that are there, by region [mass / length^3]."""
    return {body.region: scene.materials[body.material].density for body in scene.bodies if not body.absent}


def mass_of(scene, space, groups):
    """The mass of the bodies of a scene, which have densities, and of the points of its rigid groups. *Collective.*"""
    couplings = [one for one in scene.couplings if not one.average]
    points = [(group, group.inertia(one.mass, one.inertia)) for one, group in zip(couplings, groups, strict=False)
              if one.mass or np.any(one.inertia)]  # fmt: skip
    return Mass(space, _densities(scene), scene.dynamics is not None and scene.dynamics.mass == "lumped", points)


def _initial_motion(scene, space, time):
    """Displacement, or None without any, and velocity of the owned nodes (n_owned, d), the mean where several bodies
    have them. *Collective.*"""
    result = []
    for key in ("initial_displacement", "initial_velocity"):
        said = {k: getattr(body, key) for k, body in enumerate(scene.bodies) if getattr(body, key) is not None}
        values, count = np.zeros((space.n_local, space.dim)), np.zeros((space.n_local, space.dim))
        for number, body in enumerate(scene.bodies):
            tables = [cells.ravel() for block, cells in zip(space.mesh.blocks, space.cells, strict=True)
                      if block.body == number]  # fmt: skip
            nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *tables]))
            count[nodes] += 1.0
            if number in said:
                where = f"{place('bodies', number, body.region)}.{key}"
                value = Prescribed(said[number], scene.where, where)
                values[nodes] += together(space.comm, value, space.points[nodes], time)
        sums, counts = (space.summed(space.local, one) for one in (values, count))
        result.append(sums / np.maximum(counts, 1.0) if said or key == "initial_velocity" else None)
    return result


def _begun(scene, space):
    """Blocks of the bodies that have begun in a later phase than the first, by the number of the phase."""
    begun = {}
    for number, block in enumerate(space.mesh.blocks):
        since = scene.bodies[block.body].since
        if since and not scene.bodies[block.body].absent:
            begun.setdefault(since, []).append(number)
    return begun


def _announce(mesh, free):
    """Say which bodies no support holds, and with how many modes."""
    kinds = {}
    for k, motions in free.items():
        kinds.setdefault((mesh.component_names[k], len(motions)), []).append(k)
    for (name, modes), parts in kinds.items():
        times = f", {len(parts)} times" if len(parts) > 1 else ""
        log.info("body %s: %d rigid modes that no support holds%s", name, modes, times)


def assemble(scene, mesh, span=None, more=(), stabilises=True):
    """The problem of a scene on its mesh. *Collective.*

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
        Without phases, or that of a phase.
    mesh : pcontact.mesh.mesh.Mesh
    span : pcontact.scene.phases.Span, optional
        Of a phase that goes on from another.
    more : sequence of callable
        From the space to items of the caller's own.
    stabilises : bool
        Whether bodies that nothing holds are steadied.

    Returns
    -------
    problem : Problem
    colours : ndarray (n_components,)
        Bodies that can touch have different ones.
    floating : dict of int to ndarray (m, n_modes)
        Components that nothing holds, and the rigid motions that they have left.
    """
    averaged = [
        [number for number, body in enumerate(scene.bodies) if scene.averages(body, simplices)]
        for simplices in (False, True)
    ]
    reduced = [number for number, body in enumerate(scene.bodies) if body.integration == "reduced"]
    lower = [number for number, body in enumerate(scene.bodies) if scene.lower(body)]
    space = Space(mesh, scene.mesh.order, scene.mesh.kinematics, *averaged, reduced, lower)
    try:
        return _assemble(scene, space, span, more, stabilises)
    except TOLD:
        space.exchanger.free()
        raise


def _assemble(scene, space, span, more, stabilises):
    """See :func:`assemble`. *Collective.*"""
    end, mesh = scene.steps.end, space.mesh
    laws = _laws(scene, mesh.dim)
    _check_estimate(scene, space)
    _check_locking(scene, space)
    _check_joined(scene, space)
    supports = Supports(
        space, scene.displacements, [amplitude_of(d, end) for d in scene.displacements], scene.where
    )
    couplings = _rigid_groups(scene, space, supports)
    sections = _sections(scene, space, supports.fixed | _nodes_of(space, couplings))
    averages = _averages(scene, space, supports, [*couplings, *sections])
    lower = _lower_rows(scene, space)
    equations = _equations(scene, space, supports, [*couplings, *sections], averages, lower)
    supports.groups = [*couplings, *sections, *([] if equations is None else [equations])]
    forces, timed, total = _forces(scene, space, supports)
    forces += [section.force for section in sections if section.free]
    springs = [GroundSprings(space, spring) for spring in scene.springs]
    _check_turns(scene, space, supports)
    bulk = bulk_item(scene, space, laws)
    begun = _begun(scene, space)
    bulk.added = frozenset(number for blocks in begun.values() for number in blocks)
    bulk.rigid = _rigid_nodes(space, supports, couplings)
    scene.contacts = oriented(scene, space, bulk)
    tied = tied_pairs(scene, space, bulk)
    eta = scene.steps.viscous_stabilisation
    # dashpots hold every body: where it goes is no longer open
    inertia = _inertia(scene, space, laws, couplings)
    # and so does mass
    held = eta is not None or inertia is not None
    free = {} if held else free_motions(space, supports, [*springs, *supports.groups])
    contacts, edges = contact_reports(scene, space, supports, free, bulk, tied)
    _announce(mesh, free)
    items = [bulk, *(pair for contact in contacts for pair in contact.pairs), *_followers(scene, space, supports)]
    items += [*springs, *_spinning(scene, space), *(make(space) for make in more)]
    snap = None if scene.steps.through_snaps is None else _snap(scene, space, couplings, bulk)
    release = None if span is None else Release(space, span.begin, span.end, begun)
    viscous = None if eta is None else ViscousStabilisation(space, eta, bulk)
    items += [one for one in (inertia, snap, release, viscous) if one is not None]
    stabilised = set(free)
    if not held and any(item.changes for item in items):
        # one linear solve has to be exact
        stabilised |= _drawn(space, sections)
    if release is not None:
        release.absolute = supports.absolute[space.owned_local]
    # modes of their own cost a set-up that grows with their square; only bodies that nothing holds are worth it
    colours, loose = colour(mesh.n_components, {(a, b) for a, b in edges if a in free or b in free}), []
    if colours.max(initial=0) >= MOST_COLOURS:
        colours, loose = np.zeros_like(colours), sorted(free)
    since = since_of(scene, space) if release is not None and begun else {}
    features = Features(timed, total, springs, sections, averages, equations, _lower(scene, space, lower), release,
                        inertia, viscous, since, loose, stabilises, snap)  # fmt: skip
    stabilisation = _stabilisation(space, laws, stabilised)
    return Problem(space, items, supports, forces, stabilisation, contacts, features), colours, free
