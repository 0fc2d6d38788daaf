"""From the contacts of a scene to items: surfaces, search radii, formulations."""

from dataclasses import replace

import numpy as np

from pcontact.contact.active_set import components_of as components_at
from pcontact.contact.finite_pair import finite_pair
from pcontact.contact.formulation.methods import coercive, contacts_of_halves, halved, is_unbiased, parameter
from pcontact.contact.law import ADDED, contact_law, sticks_by_shear
from pcontact.contact.pair import NOTHING_MORE, Setting, contact_pair
from pcontact.contact.report import ContactReport
from pcontact.contact.search.partners import overlap
from pcontact.contact.search.self_contact import burdened, meetings, outer_surfaces, paired_elsewhere, self_surface
from pcontact.contact.segmentation.pieces import cut_source
from pcontact.contact.surface.facet_maps import KIND
from pcontact.contact.surface.obstacle import RigidObstacle, RigidSurface
from pcontact.contact.surface.sides import components_of, diameters, extents, source_surface, target_surface
from pcontact.contact.surface.smooth_geometry import Chords, has_corner, smooth_surface
from pcontact.contact.traction.small import is_two_sided
from pcontact.mesh.mesh import size_of
from pcontact.mesh.read import read_surface
from pcontact.runtime import log
from pcontact.runtime.errors import input_error
from pcontact.runtime.parallel import agree, on_root, together
from pcontact.runtime.petsc import MPI
from pcontact.scene.amplitude import amplitude
from pcontact.scene.functions import obstacle_functions
from pcontact.scene.model import OUTER
from pcontact.scene.validate import unsafe
from pcontact.space.modes import component_boxes, join, near_pairs
from pcontact.space.space import AXIS

# coefficient of friction up to which a solution is unique in most problems (of a half space in plane strain: up to
# sqrt(3 - 4 nu) / (2 - 2 nu), 0.87 to 1)
UNIQUE = 1.0
# and up to which a block sheared on a plane has one: others are found from 5 on
SEVERAL = 3.0
# facets of a source in space that are larger than the target's by this factor spoil the quadrature
COARSE = 3.0
# factor from which on they are cut, unless the user says otherwise
COARSER = 1.25
# [-] Constant of the trace inequality, modulus over depth of a cell, of the source over that of the target, from which
# on the pressure is better with the two exchanged. From: blocks and rollers drawn at random in the plane. Of forty, 29
# are beyond, and 28 of them better exchanged, by a factor of 14 in the median; of forty others 32 of 33.
STIFFER = 5.0
# [-] Part by which sizes of facets differ that count as the same. From: chosen, above what rounding and mesh generators
# do to regular meshes.
EVEN = 0.01
# [-] Depth of a valley over the extent of the surface below which its sides do not meet. From: small against the depth
# of a slot whose sides come together, large against the waves of curved facets.
VALLEY = 1e-3
# [-] Facets of a rank whose planes are compared with all points of a surface. From: some 0.1 s for 100,000 points.
PLANES = 1000


def _radius(space, bulk, contact, sides, floats):
    """Search radius [length]. *Collective.*

    The user's; or 0.15 of the extent of the smaller surface, the farthest that bodies may move in a load step. A body
    that nothing holds may have to look farther for a partner: half the extent. What lies deeper in the other body at
    first has as far to go besides. Where all surfaces may meet, 0.15 of the extent of the smallest body: the search
    takes longer the farther it goes.
    """
    if contact.target is None:
        return contact.search_radius or size_of(space.mesh)
    if contact.all:
        return contact.search_radius or 0.15 * float(np.min(extents(space, OUTER, bodies=True)))
    radius, names = contact.search_radius, (contact.source, contact.target)
    if radius is None:
        radius = (0.5 if floats else 0.15) * min(float(extents(space, name)[0]) for name in names)
    depth = _overlap(space, bulk, contact, sides, radius)
    if depth <= radius:
        return radius
    if contact.search_radius is None:
        return radius + depth
    log.warning(
        "contact %s: the undeformed bodies overlap by %.4g, deeper than search_radius = %.4g: what is so deep has no "
        "partner; remedy: a larger search_radius, or none",
        contact.name, depth, radius,
    )  # fmt: skip
    return radius


def _overlap(space, bulk, contact, sides, radius):
    """Depth of the undeformed source in bodies of the target [length], 0 where boxes around the bodies tell that
    it is no deeper than a radius. *Collective.*"""
    own, other = sides[0] - sides[-1], sides[-1] - sides[0]
    deep = near_pairs(*component_boxes(space), -radius).tolist()
    if not any((a in own and b in other) or (b in own and a in other) for a, b in deep):
        return 0.0
    source = _points(space, bulk, contact)
    return overlap(space, source, target_surface(space, contact.target), contact.search, other)


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


def _require_valley(scene, space, contact, source):
    """Refuse a surface with itself that lies behind each of its tangent planes, flat or bulging: no two places of it
    face each other. Those of a closed crack do. *Collective.*"""
    points, normals = (np.concatenate(space.comm.allgather(rows)) for rows in (source.x, source.normal))
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    facets = np.unique(source.facet, return_index=True)[1]
    meets = False
    for row in facets[:: len(facets) // PLANES + 1]:
        height = (points - source.x[row]) @ source.normal[row] / extent
        # a side of a crack, and what stands out
        meets = meets or bool(np.any(height > np.where(normals @ source.normal[row] < 0.0, -VALLEY, VALLEY)))
    message = (
        f"{scene.where}: contacts ({contact.name}).target: found {contact.target!r}, the source itself, a surface that "
        "is flat or bulges everywhere and cannot meet itself; allowed: another surface; or self_contact = true where "
        "it is to be folded"
    )
    agree(space.comm, None if space.comm.allreduce(meets, op=MPI.LOR) else message)


def _moves(space, bulk, source, target):
    """Return whether a body of a pair has finite strain. *Collective.*"""
    finite = [block.components for number, block in enumerate(space.mesh.blocks) if number in bulk.parts]
    finite = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *finite]))
    sides = [source.components] + ([] if isinstance(target, RigidObstacle) else [target.components])
    return space.comm.allreduce(any(bool(np.isin(side, finite).any()) for side in sides), op=MPI.LOR)


def pair_of(space, bulk, contact, source, target, radius, setting=NOTHING_MORE):
    """The pair of a contact in its formulation. *Collective.*

    Parameters
    ----------
    bulk : pcontact.assembly.solid.Bulk
    others
        See :func:`pcontact.contact.pair.contact_pair`.
    """
    if bulk.finite is not None and _moves(space, bulk, source, target):
        return finite_pair(space, bulk, contact, source, target, radius, setting)
    return contact_pair(space, contact, source, target, radius, setting, bulk)


def _cuts(space, contact, source, target):
    """Return whether the source's facets are cut along the edges of the target. *Collective.*

    The user's word; or always in the plane, and in space where it pays: with degree 2, and where the source, or one of
    two that are both, is the coarser side. Else the points of whole facets resolve the target well enough for degree 1.
    Where bodies meet anywhere, the undeformed ones say little.
    """
    if contact.target is None:
        return False
    if contact.cut is not None or space.dim == 2:
        return contact.cut is not False
    if contact.all or contact.target == contact.source:
        return False
    return space.degree == 2 or is_unbiased(contact) or _coarseness(space, source, target) > COARSER


def _fitted(space, contact, source, target, radius):
    """Source and target as they see each other. *Collective.*"""
    if not _cuts(space, contact, source, target):
        return source, target
    # surfaces that are all of the boundary are not the same in every phase
    onto = None if contact.all or contact.target == contact.source else contact.target
    source = cut_source(space, source, contact.source, target, radius, contact.search, contact.quadrature, onto)
    return source, target.seen_from(source.facet, source.x)


def _muted(scene, space, supports, contact, source):
    """The source of a contact of all surfaces; facets with a load or support take part without their traction."""
    # groups of cells have no facets
    burdens = [one.region for one in (*scene.loads, *scene.springs)]
    return source.mute(burdened(space, supports, burdens, source, contact_law(contact).tangential))


def _halves(scene, space, bulk, contact, supports, radius, floats, smooth):
    """The pairs of a contact both surfaces of which are source and target, or of self contact. *Collective.*"""
    halves = []
    for one in contacts_of_halves(contact, is_two_sided(space, bulk, contact)):
        source = _points(space, bulk, one)
        _require_area(scene, space, one, source)
        target = target_surface(space, one.target, rim=one.source != one.target)
        if one.source == one.target:
            if not (contact.all or contact.self_contact):
                _require_valley(scene, space, one, source)
            sides = paired_elsewhere(space, scene.contacts, target.ids) if contact.all else None
            target = self_surface(space, target, source, contact.meets_itself, sides)
        source, target = _fitted(space, one, source, target, radius)
        if contact.all:
            source = _muted(scene, space, supports, contact, source)
        setting = Setting(floats, _chords(space, one, source, target, smooth), scene.output.slip)
        halves.append(pair_of(space, bulk, one, halved(source), target, radius, setting))
    return halves


def _chords(space, contact, source, target, known):
    """Change of the gap of a pair by straight facets, :class:`Chords`; None where there is none. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    contact : pcontact.scene.model.Contact
        Of the pair, with its numerics resolved.
    source : SourceSurface
        With the shape functions of whole cells.
    target : TargetSurface or RigidObstacle
    known : dict of (str, bool) to SmoothSurface or None
        Of the groups seen before; grows.
    """
    fitted = contact.smooth_geometry
    if contact.clearance is not None and not fitted:
        # a gap that is said is not that between the facets
        return None
    for name in (contact.source, contact.target):
        if name is not None and (name, fitted) not in known:
            # means do for a warning
            known[name, fitted] = smooth_surface(space, name, fitted)
    surfaces = known[contact.source, fitted], known.get((contact.target, fitted))
    if all(surface is None for surface in surfaces):
        return None
    return Chords(space, contact, source, None if contact.target is None else target, surfaces)


def _tied_radius(space, source, target):
    """Largest extent of a facet [length]: what is farther away is not tied. *Collective.*"""
    own = max(float(np.max(sizes, initial=0.0)) for sizes in (source.size, diameters(target.x)))
    return space.comm.allreduce(own, op=MPI.MAX)


def oriented(scene, space, bulk):
    """The contacts of a scene, those that say two surfaces with one of them as the source, or with both. *Collective.*

    A convex corner of the target sinks into the facets of the source, unseen between its points: a surface with corners
    is the source, and where both have some contact is unbiased. Else, where the traction is that of both sides, or
    none, it is the finer one, whose points see all facets of the other; where the traction is that of the source alone,
    and one side is much softer, the softer one.
    """
    contacts = []
    for contact in scene.contacts:
        if contact.surfaces is None:
            contacts.append(contact)
            continue
        # in an order of their own, so that it does not matter in which they are said
        names = sorted(contact.surfaces)
        sides = [source_surface(space, name, bulk.constants, 1, bulk.orthotropic) for name in names]
        sizes, stiff = ([_typical(space, getattr(side, key)) for side in sides] for key in ("size", "trace"))
        alone = _is_alone(space, bulk, contact)
        corners = [not contact.tied and has_corner(space, name) for name in names]
        if all(corners) and contact.pressure_overclosure is None:
            log.info("contact %s: unbiased, both surfaces have corners, which points of the other one do not see",
                     contact.name)  # fmt: skip
            contacts.append(replace(contact, source=names[0], target=names[1], unbiased=True))
            continue
        if any(corners):
            first, why = corners[1], "has corners, which points of the other one do not see"
        elif alone and max(stiff) > STIFFER * min(stiff):
            first, why = stiff[1] < stiff[0], "is softer, modulus over depth of a cell, and its stress alone counts"
        else:
            first, why = sizes[1] < (1.0 - EVEN) * sizes[0], "has the smaller facets, or facets of the same size"
        source, target = names[int(first)], names[1 - int(first)]
        log.info("contact %s: %s is the source: it %s", contact.name, source, why)
        contacts.append(replace(contact, source=source, target=target))
    return contacts


def tied_pairs(scene, space, bulk):
    """The tied pairs. Bodies that they join are one connected component from here on. *Collective.*

    Parameters
    ----------
    scene, space, bulk
        As in :func:`contact_reports`.

    Returns
    -------
    dict of int to ContactPair
        By the number of the contact in the scene.
    """
    pairs, joined = {}, []
    for number, contact in enumerate(scene.contacts):
        if not contact.tied:
            continue
        late = [body for body in _bodies_of(space, contact) if scene.bodies[body].since]
        if late:
            found = f"true with body {scene.bodies[late[0]].region}, which begins in a later phase than the first"
            allowed = "nodes in common, or false and tied of [[phases]]"
            raise input_error(scene.where, f"contacts[{number}] ({contact.name}).tied", found, allowed)
        source = _points(space, bulk, contact)
        _require_area(scene, space, contact, source)
        _check_source(space, bulk, contact, source)
        target = target_surface(space, contact.target)
        radius = contact.search_radius or _tied_radius(space, source, target)
        source, target = _fitted(space, contact, source, target, radius)
        pair = pair_of(space, bulk, contact, source, target, radius)
        pair.detect(space.vector(), 0.0)
        counts = np.array([np.sum(pair.pairing.paired), len(pair.source.facet)])
        tied, points = (int(n) for n in space.comm.allreduce(counts, op=MPI.SUM))
        if not tied:
            raise input_error(
                scene.where, f"contacts[{number}] ({contact.name}).tied",
                f"no point of {contact.source!r} with a partner on {contact.target!r} within {radius:.4g}",
                "surfaces that face each other, or a larger search_radius",
            )  # fmt: skip
        log.info("contact %s: %d of %d points are tied", contact.name, tied, points)
        pairs[number] = pair
        joined.append(_joined(pair))
    if pairs:
        join(space, np.concatenate(joined))
    return pairs


def _bodies_of(space, contact):
    """Bodies that the surfaces of a contact belong to. *Collective.*"""
    own = {space.mesh.blocks[facets.block].body for name in (contact.source, contact.target)
           for facets in space.mesh.facet_groups.get(name, []) if len(facets.cells)}  # fmt: skip
    return sorted(set().union(*space.comm.allgather(own)))


def since_of(scene, space):
    """Number of the phase since which both bodies of a contact have been there, by the name of the contact.
    *Collective.*

    Contacts of all surfaces are those of the first phase.
    """
    bodies = {contact.name: [] if contact.all else _bodies_of(space, contact) for contact in scene.contacts}
    return {name: max((scene.bodies[body].since for body in some), default=0) for name, some in bodies.items()}


def _joined(pair):
    """Pairs (n, 2) of connected components with a tied point between them, on all ranks. *Collective.*"""
    own, other = components_at(pair.space, pair.pairing, pair.source)
    numbers = np.unique(np.column_stack([own, other])[pair.pairing.paired], axis=0)
    return np.unique(np.concatenate(pair.space.comm.allgather(numbers)), axis=0)


def _check_numbers(scene, space, bulk, number, contact):
    """Refuse what makes the answer of a pair doubtful whatever the mesh, unless the scene allows it. *Collective.*"""
    where = f"contacts[{number}] ({contact.name})"
    if contact.law is not None and contact.law not in ADDED:
        allowed = " | ".join(map(repr, ADDED)) or "none: this program has added no law (pcontact.contact.law.add_law)"
        raise input_error(scene.where, f"{where}.law", repr(contact.law), allowed)
    # each half of an unbiased pair bears half the traction of its side, and half the default gamma0 is enough
    half = is_unbiased(contact) and not is_two_sided(space, bulk, contact)
    bound = coercive(float(contact.theta)) * (0.5 if half else 1.0)
    if contact.formulation == "nitsche" and parameter(contact) < bound:
        unsafe(
            scene, "gamma0", f"{where}.gamma0",
            f"{parameter(contact):g}, below the bound above which theta = {contact.theta:g} is coercive: the pressure "
            "may be wrong",
            f">= {bound:g}, or theta = -1, which has no bound",
        )  # fmt: skip
    if isinstance(contact.friction, float):
        _check_coefficient(scene, where, contact, contact.friction)


def _check_coefficient(scene, where, contact, largest):
    """Refuse, or warn of, a coefficient of friction with which Coulomb's law may have several solutions."""
    if largest > SEVERAL:
        unsafe(
            scene, "friction", f"{where}.friction",
            f"{largest:g}, with which Coulomb's law may have several solutions, or none",
            f"<= {SEVERAL:g}, or tied = true for surfaces that do not part",
        )  # fmt: skip
    elif largest > UNIQUE:
        log.warning(
            "contact %s: friction = %g: beyond about %g Coulomb's law may have several solutions, or none; this is one",
            contact.name, largest, UNIQUE,
        )  # fmt: skip


def _name_coefficients(scene, space, reports):
    """Say what messages call coefficients of friction that vary, and check those of the beginning. *Collective.*"""
    for number, report in enumerate(reports):
        where = f"contacts[{number}] ({report.name})"
        for pair in (pair for pair in report.pairs if pair.law.varies):
            pair.law.named(scene.where, where)
            own = together(space.comm, pair.law.begin, pair.source.x, 0.0)
            _check_coefficient(scene, where, report.contact, space.comm.allreduce(own, op=MPI.MAX))


def _check_geometry(scene, space, bulk, number, contact):
    """Refuse facets whose places their nodes do not carry, where partners move on them."""
    if bulk.finite is not None and contact.obstacle is None and space.mesh.curved and space.degree == 1:
        raise input_error(
            scene.where, f"contacts[{number}] ({contact.name})",
            "bodies with finite strain, order = 1, and a mesh of degree 2", "order = 2, or a mesh of degree 1",
        )  # fmt: skip


def _check_sizes(scene, space, number, contact, pair):
    """Refuse a source in space too coarse for its target, unless the scene allows it. *Collective.*"""
    if space.dim == 2 or contact.obstacle is not None or is_unbiased(contact) or contact.all:
        return
    ratio = _coarseness(space, pair.source, pair.search.target)
    if contact.cut is False and ratio > COARSE:
        unsafe(
            scene, "facet_sizes", f"contacts[{number}] ({contact.name}).cut",
            f"false, and facets of the source {contact.source!r} {ratio:.0f} times as large as those of the target "
            f"{contact.target!r}, whose edges the quadrature does not resolve: the pressure may be wrong",
            f"cut = true, or at most {COARSE:g} times, such as with source and target exchanged",
        )  # fmt: skip


def _is_alone(space, bulk, contact):
    """Return whether the stress of the source alone says what the pressure of a contact is. *Collective.*"""
    nitsche = contact.formulation in (None, "nitsche") and contact.pressure_overclosure is None
    return nitsche and not is_two_sided(space, bulk, contact)


def _check_source(space, bulk, contact, source):
    """Warn of a source much stiffer than its target, if its stress alone says what the pressure is; how many times as
    stiff it is then, else 0. *Collective.*"""
    sided = contact.obstacle is None and contact.target != contact.source and not is_unbiased(contact)
    if not sided or contact.all or not _is_alone(space, bulk, contact):
        return 0.0
    # a point for each facet
    other = source_surface(space, contact.target, bulk.constants, 1, bulk.orthotropic)
    stiff, soft = _typical(space, source.trace), _typical(space, other.trace)
    if not 0.0 < STIFFER * soft < stiff:
        return 0.0
    log.warning(
        "contact %s: the source %r is %.0f times as stiff as the target %r, modulus over depth of a cell: the "
        "pressure may be wrong; remedy: source = %r, target = %r",
        contact.name, contact.source, stiff / soft, contact.target, contact.target, contact.source,
    )  # fmt: skip
    return stiff / soft


def _coarseness(space, source, target):
    """Ratio of the sizes of facets of the source to those of the target in space; 0 without any. *Collective.*"""
    x = target.x
    spanned = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    triangles = np.isin(target.kinds, [KIND["triangle", degree] for degree in (1, 2)])
    spanned = np.where(triangles, 0.5, 1.0) * spanned
    areas = np.bincount(source.facet, source.jxw, minlength=len(source.cells))
    sizes = [_typical(space, np.sqrt(values)) for values in (areas, spanned)]
    return sizes[0] / sizes[1] if sizes[1] > 0.0 else 0.0


def _typical(space, sizes):
    """Geometric mean of positive sizes of facets of all ranks [length]. *Collective.*"""
    sizes = sizes[sizes > 0.0]
    total, count = space.comm.allreduce(np.array([np.sum(np.log(sizes)), len(sizes)]), op=MPI.SUM)
    return float(np.exp(total / count)) if count else 0.0


def _sides(space, contact):
    """Connected components of the surfaces of a contact, one set for each surface. *Collective.*"""
    return [components_of(space, name) for name in (contact.source, contact.target) if name is not None]


def _rigid(scene, space, number):
    """The obstacle of a contact. *Collective.*"""
    contact, comm = scene.contacts[number], space.comm
    obstacle, factor = contact.obstacle, amplitude(contact.obstacle.amplitude, scene.steps.end)
    functions = obstacle_functions(scene, number) if obstacle.shape == "level_set" else None
    if obstacle.shape != "mesh":
        return RigidObstacle(obstacle, factor, size_of(space.mesh), functions)
    where = scene.where, f"contacts[{number}] ({contact.name}).obstacle"
    path = scene.folder / obstacle.file
    surface = comm.bcast(on_root(comm, read_surface, path, space.dim, obstacle.region, where))
    return RigidObstacle(obstacle, factor, size_of(space.mesh), surface=RigidSurface(surface, obstacle.inside))


def _points(space, bulk, contact):
    """The source of a contact, whatever else acts on it. *Collective.*"""
    constants, laws = bulk.constants, bulk.orthotropic
    return source_surface(space, contact.source, constants, contact.quadrature, laws, sticks_by_shear(contact))


def _source(scene, space, bulk, supports, contact, known):
    """The source of a contact; obstacles around the same bodies share one, by what it depends on. *Collective.*"""
    key = contact.all, contact.source, contact.quadrature, contact_law(contact).tangential, sticks_by_shear(contact)
    if contact.obstacle is not None and key in known:
        return known[key]
    source = _points(space, bulk, contact)
    _require_area(scene, space, contact, source)
    if contact.all:
        source = _muted(scene, space, supports, contact, source)
    if contact.obstacle is not None:
        known[key] = source
    return source


def contact_reports(scene, space, supports, free, bulk, tied):
    """The pairs of all contacts, and which components can meet. *Collective.*

    Parameters
    ----------
    scene : pcontact.scene.model.Scene
    space : pcontact.space.space.Space
    supports : pcontact.space.supports.Supports
    free : dict of int to ndarray (m, n_modes)
        Components that the supports do not hold, and the rigid motions left to them.
    bulk : pcontact.assembly.solid.Bulk
    tied : dict of int to ContactPair
        Of :func:`tied_pairs`.

    Returns
    -------
    reports : list of ContactReport
    edges : set of (int, int)
        Pairs of components.
    """
    reports, edges, touching, sources, smooth = [], set(), set(), {}, {}
    if any(contact.all for contact in scene.contacts):
        space.mesh.facet_groups[OUTER] = outer_surfaces(space)
    for number, contact in enumerate(scene.contacts):
        _check_numbers(scene, space, bulk, number, contact)
        _check_geometry(scene, space, bulk, number, contact)
        if contact.tied:
            reports.append(ContactReport(contact, [tied[number]]))
            continue
        sides = _sides(space, contact)
        floats = bool(set().union(*sides) & set(free))
        radius = _radius(space, bulk, contact, sides, floats)
        if contact.obstacle is None:
            near = meetings(space, sides, radius)
            edges |= near
        if contact.all and contact.obstacle is None:
            touching.update(*near)
        elif contact.target != contact.source or len(sides[0]) > 1:
            touching.update(*sides)
        if is_unbiased(contact):
            halves = _halves(scene, space, bulk, contact, supports, radius, floats, smooth)
            reports.append(ContactReport(contact, halves))
            continue
        source = _source(scene, space, bulk, supports, contact, sources)
        target = target_surface(space, contact.target) if contact.obstacle is None else _rigid(scene, space, number)
        stiffer = _check_source(space, bulk, contact, source)
        source, target = _fitted(space, contact, source, target, radius)
        setting = Setting(floats, _chords(space, contact, source, target, smooth), scene.output.slip)
        pair = pair_of(space, bulk, contact, source, target, radius, setting)
        _check_sizes(scene, space, number, contact, pair)
        reports.append(ContactReport(contact, [pair], stiffer))
    for k in sorted(set(free) - touching):
        name = space.mesh.component_names[k]
        text = "body %s: no contact pair can hold the %d rigid modes that no support holds"
        if any(contact.all for contact in scene.contacts):
            text += " (or nothing is near enough: a larger search_radius)"
        log.warning(text, name, len(free[k]))
    _warn_of_jumps(reports)
    _name_coefficients(scene, space, reports)
    return reports, edges


def _warn_of_jumps(reports):
    """Say which contacts have a residual that jumps: sources that may yield, with the consistent adjoint."""
    for report in reports:
        if any(pair.terms.traction.consistent for pair in report.pairs):
            log.warning(
                'contact %s: adjoint = "consistent": the residual jumps where a cell yields, a load step may have more '
                "than one solution, or none; this is one; remedy: smaller load steps, or the elastic adjoint",
                report.name,
            )  # fmt: skip
