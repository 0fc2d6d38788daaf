"""From the scene to the rooms below: mesh, space, items, problem."""

import numpy as np

from pcontact.assembly.bulk import ElasticBulk
from pcontact.assembly.geometry import chunks
from pcontact.assembly.loads import load_vector, lumped_volume
from pcontact.assembly.plastic import PlasticBulk
from pcontact.contact.augmented import AugmentedFrictionalItem, AugmentedItem
from pcontact.contact.frictional import FrictionalItem
from pcontact.contact.item import ContactItem
from pcontact.contact.laws import friction_law
from pcontact.contact.obstacle import RigidObstacle
from pcontact.contact.penalty import without_traction
from pcontact.contact.pieces import cut_source
from pcontact.contact.plastic_trace import PlasticTrace
from pcontact.contact.self_surface import self_surface
from pcontact.contact.surface import source_surface, target_surface
from pcontact.contact.unbiased import (
    UnbiasedFrictionalItem,
    UnbiasedItem,
    contacts_of_halves,
    halved,
    is_unbiased,
)
from pcontact.element.reference import CELLS
from pcontact.material.elastic import in_plane, lame
from pcontact.material.hardening import hardening_curve, hardening_table
from pcontact.material.plastic import plastic_constants
from pcontact.mesh.load import load_mesh
from pcontact.mesh.mesh import bounding_box, size_of
from pcontact.mesh.partition import METHODS, WEIGHT
from pcontact.runtime import log, profile
from pcontact.runtime.parallel import agree
from pcontact.runtime.petsc import MPI
from pcontact.scene import (
    amplitude,
    check_apart,
    check_dimension,
    check_radius,
    check_regions,
    obstacle_functions,
    resolve_contacts,
    validate,
)
from pcontact.solve.problem import Problem
from pcontact.space.modes import colour, component_frames, floating
from pcontact.space.space import AXIS, Space
from pcontact.space.supports import Supports

# items of the formulations: without friction, with it
ITEMS = {
    "nitsche": (ContactItem, FrictionalItem),
    "penalty": (ContactItem, FrictionalItem),
    "augmented_lagrangian": (AugmentedItem, AugmentedFrictionalItem),
}
# stiffness of the aid for bodies that nothing holds, as a part of the P-wave modulus over size squared, per volume
AID = 1e-6


def override(scene, options):
    """The scene with what the command line says. Options of the scene enter the database unless the user set them.

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    options : pcontact.runtime.options.Options

    Returns
    -------
    Scene
        Valid, with the numerics of all contacts resolved, and nothing in it that is not modelled.
    """
    validate(scene)
    options.propose(scene.petsc)
    get = options.get
    scene.mesh.order = get("mesh_order", scene.mesh.order, int, (1, 2), "degree of the displacement")
    count, shortest = scene.steps.count, scene.steps.min_step
    scene.steps.count = get("steps_count", count, int, text="equal load steps to start with", positive=True)
    scene.steps.min_step = get("steps_min", shortest, float, text="smallest load step [time]", positive=True)
    scene.output.fields = get("output_fields", scene.output.fields, bool, text="write fields of every step")
    text = "write fields of the cells averaged at the nodes too"
    scene.output.smooth = get("output_smooth", scene.output.smooth, bool, text=text)
    text = "load steps between two checkpoints"
    scene.output.checkpoint_every = get("checkpoint_every", scene.output.checkpoint_every, int, text=text)
    numerics = {
        "formulation": (str, "nitsche, penalty or augmented_lagrangian"),
        "theta": (float, "variant of Nitsche's method: 1, 0, -1"),
        "gamma0": (float, "dimensionless parameter of the formulation"),
        "alpha": (float, "tangential over normal parameter"),
        "adjoint": (str, "elastic or consistent: adjoint operator of theta = 1, -1 where cells yield"),
        "quadrature": (int, "degree of the quadrature on source facets"),
        "search": (str, "closest_point or ray_tracing"),
    }
    said = {key: get(f"contact_{key}", None, kind, text=text) for key, (kind, text) in numerics.items()}
    validate(scene)
    return resolve_contacts(scene, {key: value for key, value in said.items() if value is not None})


def _pairs(scene):
    """Source, target (None: an obstacle) and search radius of all contacts, both ways where both sides are sources."""
    pairs = []
    for contact in scene.contacts:
        pairs.append((contact.source, contact.target, contact.search_radius))
        if contact.unbiased and contact.target not in (None, contact.source):
            pairs.append((contact.target, contact.source, contact.search_radius))
    return pairs


def read(scene, comm, options):
    """The distributed mesh of a scene. *Collective.*"""
    pairs = _pairs(scene)
    weight = options.get("partition_weight", WEIGHT, float, text="work of a contact facet in units of a cell's")
    given = "graph" if options.given("petscpartitioner_type") else "bisection"
    method = options.get("partition", given, str, METHODS, "who cuts the mesh")

    def check(mesh):
        check_dimension(scene, mesh.dim)
        if scene.mesh.kinematics == "axisymmetric":
            check_radius(scene, mesh.points, mesh.path)
        check_regions(scene, mesh.cell_groups, mesh.facet_groups, mesh.node_groups, mesh.path)
        check_apart(scene, getattr(mesh, "common", {}))

    regions = [b.region for b in scene.bodies]
    return load_mesh(comm, scene.mesh_path, scene.mesh.order, regions, pairs, check, weight, method)


def _radius(space, contact, floats):
    """Search radius [length]. *Collective.*

    The user's; or 0.15 of the extent of the smaller surface, the farthest that bodies may move in a load step. A body
    that nothing holds may have to look farther for a partner: half the extent.
    """
    if contact.search_radius is not None:
        return contact.search_radius
    mesh, extents = space.mesh, []
    if contact.target is None:
        return size_of(mesh)
    for name in (contact.source, contact.target):
        nodes = [mesh.facet_nodes(f).ravel() for f in mesh.facet_groups.get(name, [])]
        nodes = np.concatenate(nodes) if nodes else np.zeros(0, dtype=np.int64)
        low, high = bounding_box(mesh.comm, mesh.points[nodes])
        extents.append(float(np.linalg.norm(high - low)))
    return (0.5 if floats else 0.15) * min(extents)


def _components(space, side):
    """Connected components that a surface belongs to. *Collective.*"""
    return set().union(*space.comm.allgather(set(np.unique(side.components).tolist())))


def _require_area(scene, space, contact, source):
    """Refuse a source on the axis of symmetry: its facets have no area. *Collective.*"""
    if not space.axisymmetric:
        return
    largest = space.comm.allreduce(float(np.max(space.points[:, 0], initial=0.0)), op=MPI.MAX)
    count = len(np.unique(source.facet[source.x[:, 0] <= AXIS * largest]))
    message = (
        f"{scene.where}: contacts ({contact.name}).source: found {contact.source!r} with {count} facets on the axis of "
        "symmetry, where they have no area; allowed: facets with x > 0"
    )
    agree(space.comm, message if count else None)


def bulk_item(scene, space, constants):
    """The item of all bodies: an elastic one unless a body may yield. *Collective.*"""
    materials = []
    for body in scene.bodies:
        material = scene.materials[body.material]
        if not material.plastic:
            materials.append(None)
            continue
        row = plastic_constants(*lame(material.E, material.nu), material.kinematic_hardening)
        if material.hardening_curve is not None:
            materials.append((row, hardening_table(material.hardening_curve)))
        else:
            materials.append((row, hardening_curve(material.yield_stress, material.hardening)))
    with profile.phase("bulk_assembly"):
        if not any(materials):
            return ElasticBulk(space, constants)
        return PlasticBulk(space, constants, materials)


def _trace(space, bulk, source, contact):
    """What plasticity adds to the traction of a source; None where its cells cannot yield. *Collective.*"""
    if not isinstance(bulk, PlasticBulk):
        return None
    trace = PlasticTrace(space, bulk, source, contact.source)
    return trace if space.comm.allreduce(trace.parts, op=MPI.SUM) else None


def pair_item(space, bulk, contact, source, target, radius, floats=False):
    """The item of a contact in its formulation. *Collective.*

    Parameters
    ----------
    bulk : ElasticBulk or PlasticBulk
    others
        See `pcontact.contact.item.ContactItem`.
    """
    law, trace = friction_law(contact), None
    if contact.formulation == "nitsche":
        trace = _trace(space, bulk, source, contact)
    else:
        source = without_traction(source)
    frictionless, frictional = ITEMS[contact.formulation]
    if law is None:
        return frictionless(space, contact, source, target, radius, floats, trace)
    return frictional(space, contact, source, target, radius, law, contact.alpha, floats, trace)


def _fitted(space, contact, source, target, radius):
    """Source and target as they see each other: in the plane, facets are cut at the nodes they face. *Collective.*"""
    if space.dim == 3 or contact.target is None:
        return source, target
    source = cut_source(space, source, contact.source, target, radius, contact.search, contact.quadrature)
    return source, target.seen_from(source.facet, source.x)


def _unbiased_item(scene, space, bulk, contact, radius, floats):
    """The item of a pair both surfaces of which are source and target, or of self contact. *Collective.*"""
    halves = []
    for one in contacts_of_halves(contact):
        source = source_surface(space, one.source, bulk.constants, one.quadrature)
        _require_area(scene, space, one, source)
        target = target_surface(space, one.target)
        if one.source == one.target:
            target = self_surface(space, target, source)
        source, target = _fitted(space, one, source, target, radius)
        halves.append(pair_item(space, bulk, one, halved(source), target, radius, floats))
    kind = UnbiasedItem if friction_law(contact) is None else UnbiasedFrictionalItem
    return kind(contact, halves)


def contact_items(scene, space, constants, free, bulk):
    """One item per contact pair, and which components can meet. *Collective.*

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    space : pcontact.space.space.Space
    constants : list of (float, float)
        Lame constants of each body [stress].
    free : dict of int to int
        Components that the supports do not hold.
    bulk : ElasticBulk or PlasticBulk

    Returns
    -------
    items : list of ContactItem
    edges : set of (int, int)
        Pairs of components.
    """
    items, edges, touching = [], set(), set()
    for number, contact in enumerate(scene.contacts):
        source = source_surface(space, contact.source, constants, contact.quadrature)
        _require_area(scene, space, contact, source)
        sides = [_components(space, source)]
        if contact.target is not None:
            target = target_surface(space, contact.target)
            sides.append(_components(space, target))
            edges |= {(a, b) for a in sides[0] for b in sides[1] if a != b}
        else:
            obstacle = contact.obstacle
            functions = obstacle_functions(scene, number) if obstacle.shape == "level_set" else None
            target = RigidObstacle(
                obstacle, amplitude(obstacle.amplitude, scene.steps.end), size_of(space.mesh), functions
            )
        if contact.target != contact.source or len(sides[0]) > 1:
            touching.update(*sides)
        floats = bool(set().union(*sides) & set(free))
        radius = _radius(space, contact, floats)
        if is_unbiased(contact):
            items.append(_unbiased_item(scene, space, bulk, contact, radius, floats))
        else:
            source, target = _fitted(space, contact, source, target, radius)
            items.append(pair_item(space, bulk, contact, source, target, radius, floats))
    for k in sorted(set(free) - touching):
        name = space.mesh.component_names[k]
        log.warning("body %s: no contact pair can hold the %d rigid modes that no support holds", name, free[k])
    return items, edges


def _aid(space, scene, constants, free):
    """Diagonal aid (n_owned,) on the bodies that the supports leave free. *Collective.*"""
    if not free:
        return np.zeros(space.n_owned)
    _, scale = component_frames(space)
    modulus = np.zeros(space.mesh.n_components)
    for block in space.mesh.blocks:
        lam, mu = constants[block.body]
        modulus[block.components] = lam + 2.0 * mu
    modulus = np.array(space.comm.allgather(modulus)).max(axis=0)
    stiffness = np.zeros(space.mesh.n_components)
    for k in free:
        stiffness[k] = AID * modulus[k] / scale[k] ** 2
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


def _warn_of_locking(scene, space):
    """Say which bodies are too stiff because their simplices of degree 1 lock. *Collective.*"""
    mine = {block.body for block in space.mesh.blocks if len(block.nodes) and not CELLS[block.cell].is_tensor}
    bodies = set().union(*space.comm.allgather(mine)) if space.degree == 1 else set()
    for number in sorted(bodies):
        body = scene.bodies[number]
        cause = f"nu = {scene.materials[body.material].nu:g} makes" if scene.locks(body) else None
        if cause is None and scene.yields(body) and space.kinematics != "plane_stress":
            cause = "plastic flow, which keeps the volume, makes"
        if cause is not None:
            log.warning(
                "body %s: %s triangles and tetrahedra of degree 1 much too stiff (locking); remedy: "
                "order = 2, or quadrilaterals or hexahedra",
                body.region, cause,
            )  # fmt: skip


def assemble(scene, mesh):
    """The problem of a scene on its mesh. *Collective.*

    Returns
    -------
    problem : Problem
    colours : ndarray (n_components,)
        Bodies that can touch have different ones.
    floating : dict of int to int
        Components that nothing holds, and how many rigid modes they have left.
    """
    end = scene.steps.end
    kinematics, materials = scene.mesh.kinematics, [scene.materials[b.material] for b in scene.bodies]
    constants = [in_plane(*lame(material.E, material.nu), kinematics) for material in materials]
    averaged = [number for number, body in enumerate(scene.bodies) if scene.averages(body)]
    space = Space(mesh, scene.mesh.order, kinematics, averaged)
    _warn_of_locking(scene, space)
    supports = Supports(
        space, scene.displacements, [amplitude(d.amplitude, end) for d in scene.displacements], scene.where
    )
    forces = [(load_vector(space, load), amplitude(load.amplitude, end)) for load in scene.loads]
    free = floating(space, supports)
    bulk = bulk_item(scene, space, constants)
    contacts, edges = contact_items(scene, space, constants, free, bulk)
    for k, modes in free.items():
        log.info("body %s: %d rigid modes that no support holds", mesh.component_names[k], modes)
    items = [bulk, *contacts]
    problem = Problem(space, items, supports, forces, _aid(space, scene, constants, free))
    # modes of their own cost a set-up that grows with their square; only bodies that nothing holds are worth it
    loose = {(a, b) for a, b in edges if a in free or b in free}
    return problem, colour(mesh.n_components, loose), free
