"""What the gaps between facets and the surfaces that they stand for do to bodies on any mesh.

Nodes of finer meshes lie on the facets of the first one: a finer mesh follows its gaps and overlaps ever better, and
closes them, as if the bodies were rough. Where a contact is closed, two half spaces that are pressed together until a
gap d of wave number k is closed have the pressure E* k d / 2 beside the one they had (Johnson 1985, 13.2), and

    |u|^2 = int p d = E* / 2 int k d^2

in the energy norm, and of the pressure in L2

    |p|^2 = (E* / 2)^2 int k^2 d^2 = (E* / 2)^2 int |grad d|^2,

with 1 / E* the sum of (1 - nu^2) / E of both bodies. The gap that counts is what its mean over the
contact leaves: a mean is followed on the first mesh as well. Curved facets make two arcs of gap each, which no
displacement of degree 2 follows on them, k = 4 pi / L with the diameter L of the facet; their slopes, which are largest
where facets meet, make it 4.72 pi / L for the pressure. Where the pressure that there is closes less of the gap than
that, it is what counts. Straight ones make one, which a displacement of degree 2 does
follow: there the change of the solution is 0.85 to 0.95 of what the gaps do on finer meshes.

`drivers/studies/facets.py` compares it with what is left on ever finer meshes on the facets of the first one.
"""

from dataclasses import replace

import numpy as np

from pcontact.contact.law import OPEN
from pcontact.contact.surface.smooth_geometry import smooth_surface
from pcontact.element.reference import CELLS, reference_nodes
from pcontact.element.shape import shape_gradient
from pcontact.estimate.tractions import source_facets
from pcontact.mesh.topology import jacobians, outer_facets
from pcontact.pairs import contact_reports
from pcontact.runtime import log
from pcontact.runtime.errors import TOLD
from pcontact.runtime.petsc import MPI

# [-] Wave numbers of the gaps of curved facets, times the diameters of these: of the energy, and of the pressure. From:
# two arcs, and the root mean square slope of s^2 (1 - s^2), -1 < s < 1, over its root mean square.
ENERGY, PRESSURE = 4.0 * np.pi, 14.832
# Facet group of the whole outer surface, which no user can name.
OUTER = "\nouter"


def smooth_facets(scene, _=None):
    """The scene with the gaps of the smooth surfaces that facets stand for."""
    contacts = [one if one.tied else replace(one, smooth_geometry=True) for one in scene.contacts]
    return replace(scene, contacts=contacts)


def bent(simulation):
    """Whether the facets of a contact stand for a smooth surface that they are not. *Collective.*"""
    names = {name for one in simulation.scene.contacts if not one.tied for name in (one.source, one.target)} - {None}
    return any([smooth_surface(simulation.problem.space, name, True) is not None for name in sorted(names)])


def outer_surface(space):
    """All outer facets of a mesh, free ones, loaded ones and those of contacts, and the smooth surface that they stand
    for or None. *Collective.*"""
    groups, facets = space.mesh.facet_groups, outer_facets(space.mesh, space.exchanger)
    groups[OUTER] = facets
    surface = smooth_surface(space, OUTER, True)
    del groups[OUTER]
    return facets, surface


def rounded(space):
    """The mesh with the nodes in the middles of straight edges on the smooth surface that outer facets stand for.
    *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Of degree 2, on a mesh with straight cells.

    Returns
    -------
    pcontact.mesh.mesh.Mesh or None
        The same cells and numbers; None where a cell would be folded.
    """
    facets, surface = outer_surface(space)
    steps, count, first = *np.zeros((2, space.n_local, space.dim)), 0
    for some in facets:
        nodes, kind = space.facet_nodes(some), CELLS[some.kind]
        weights, rows = np.zeros((len(nodes), surface.normals.shape[1])), first + np.arange(len(nodes))
        first += len(nodes)
        for middle, edge in zip(nodes[:, kind.n_vertices :].T, kind.edges, strict=False):
            weights[:] = 0.5 * np.isin(np.arange(weights.shape[1]), edge)
            np.add.at(steps, middle, surface.offset(rows, weights))
            np.add.at(count, middle, 1.0)
    steps = space.together(steps) / np.maximum(space.together(count), 1.0)
    mesh, folded = replace(space.mesh, points=space.mesh.points.copy(), curved=True), False
    for block, cells in zip(mesh.blocks, space.cells, strict=True):
        own, cell = steps[cells], CELLS[block.cell]
        halves = slice(cell.n_vertices, cell.n_vertices + len(cell.edges))
        # nodes in the middles of faces and cells follow those of edges
        for k, face in enumerate(cell.faces):
            own[:, halves.stop + k] = 0.5 * own[:, halves][:, np.isin(cell.edges, face).all(axis=1)].sum(axis=1)
        for k in range(halves.stop + len(cell.faces), own.shape[1]):
            own[:, k] = (0.5 if cell.dim == 2 else 0.25) * own[:, halves].sum(axis=1)
        mesh.points[block.nodes] = space.mesh.points[block.nodes] + own
        folded |= bool((jacobians(mesh.points, block.cell, 2, block.nodes) <= 0.0).any())
    return None if space.comm.allreduce(folded, op=MPI.LOR) else mesh


def at_places(space, u, places):
    """A displacement on rounded cells, at the places of straight ones, to first order: (n_owned d,). *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
        Of degree 2, on a mesh of :func:`rounded`.
    u : PETSc.Vec
    places : ndarray (n_nodes, d)
        Of the nodes of the straight mesh [length].
    """
    nodal, mesh = space.local.gather(u), space.mesh
    change, count = np.zeros((2, space.n_local, space.dim))
    for block, cells in zip(mesh.blocks, space.cells, strict=True):
        slopes = shape_gradient(block.cell, 2, reference_nodes(block.cell, 2))
        own, jacobian = (np.einsum("qaj,cai->cqij", slopes, some) for some in (nodal[cells], mesh.points[block.nodes]))
        step = np.linalg.solve(jacobian, (places - mesh.points)[block.nodes][..., None])
        np.add.at(change, cells, np.matmul(own, step)[..., 0])
        np.add.at(count, cells, 1.0)
    moved = nodal + space.together(change) / space.together(count)
    return moved[space.owned_local].ravel()


def reports_of(simulation, scene, watch):
    """The contacts of a scene where the bodies of a run have ended, with the partners there. *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run.
    scene : pcontact.scene.model.Scene
        Its own, with other settings of the contacts.
    watch : pcontact.adapt.history.Watch
        Of `simulation`.

    Returns
    -------
    list of pcontact.contact.report.ContactReport
    """
    problem, u = simulation.problem, simulation.stepper.u
    tied = {number: one.pairs[0] for number, one in enumerate(problem.contacts) if one.law.tied}
    free = {number: range(modes) for number, modes in simulation.floating.items()}
    with log.quiet():
        reports, _ = contact_reports(scene, problem.space, problem.conditions.supports, free, problem.bulk, tied)
        for pair in (pair for report in reports if not report.law.tied for pair in report.pairs):
            # an initial overlap is that of the first search
            begin = problem.undeformed(pair)
            pair.detect(begin, watch.times[0])
            pair.commit(begin, 0.0)
            pair.detect(u, watch.time)
    return reports


def energy(simulation, watch):
    """Energy norm of the displacement that closes the gaps of curved facets [sqrt(energy)]; 0 where they are not known.
    *Collective.*

    Parameters
    ----------
    simulation : pcontact.simulation.Simulation
        That has run.
    watch : pcontact.adapt.history.Watch
        Of it.
    """

    def density(gap, wave, modulus, pressure):
        return np.minimum(0.5 * modulus * ENERGY * wave * np.abs(gap), pressure) * np.abs(gap)

    return _norm(simulation, watch, simulation.problem.contacts, density)


def pressure(simulation, watch, name):
    """What closes the gaps of the curved facets of a contact, as a pressure in L2; 0 where they are not known.
    *Collective.*

    Parameters
    ----------
    simulation, watch
        As of :func:`energy`.
    name : str
        Of the contact.
    """

    def density(gap, wave, modulus, pressure):
        return np.minimum(0.5 * modulus * PRESSURE * wave * np.abs(gap), pressure) ** 2

    return _norm(simulation, watch, [one for one in simulation.problem.contacts if one.name == name], density)


def _norm(simulation, watch, contacts, density):
    """Root of the integral of what gaps of some contacts count, but for their means. *Collective.*

    Parameters
    ----------
    simulation, watch
        As of :func:`energy`.
    contacts : list of pcontact.contact.report.ContactReport
    density : callable
        ``density(gap, wave, modulus, pressure)``: what gaps count per area, from the waves per facet [1/length], E* and
        the mean pressure of the facets, all (np,).
    """
    problem, u, square, names = simulation.problem, simulation.stepper.u, 0.0, {one.name for one in contacts}
    try:
        plain = reports_of(simulation, simulation.scene, watch)
        smooth = reports_of(simulation, smooth_facets(simulation.scene), watch)
    except TOLD:
        return 0.0
    for one, other in zip(plain, smooth, strict=True):
        if one.law.tied or one.name not in names:
            continue
        sums, parts = np.zeros(2), []
        for pair, states in zip(one.pairs, zip(one.states(u), other.states(u), strict=True), strict=True):
            # a facet that is closed somewhere would be so everywhere, but for its gaps
            facet, closed = pair.source.facet, (states[0]["status"] > OPEN) | (states[1]["status"] > OPEN)
            counts = states[0]["paired"] & states[1]["paired"] & np.isin(facet, facet[closed])
            gap = np.where(counts, states[0]["gap"] - states[1]["gap"], 0.0)
            weight = np.where(counts, states[0]["weight"], 0.0)
            sums += [weight.sum(), weight @ gap]
            wave, given = _waves(problem, pair, states[0]["normal"], gap), weight * states[0]["pressure"]
            area = np.bincount(facet, weight, len(pair.source.size))
            mean = np.bincount(facet, given, len(area)) / np.where(area > 0.0, area, 1.0)
            parts.append((weight, gap, wave, _modulus(problem, pair), mean[facet]))
        area, first = problem.space.comm.allreduce(sums, op=MPI.SUM)
        mean = first / area if area > 0.0 else 0.0
        square += sum(float(weight @ density(gap - mean, *rest)) for weight, gap, *rest in parts)
    return float(np.sqrt(problem.space.comm.allreduce(square, op=MPI.SUM)))


def _waves(problem, pair, normal, gap):
    """One over the diameter (np,) of the facets at the points of the source of a pair [1/length]: of those of either
    side, by what they have in the gap (np,). *Collective.*"""
    space, source = problem.space, pair.source
    size = np.repeat(source.size[source.facet][:, None], 2, axis=1)
    if not pair.rigid:
        size[:, 1] = _target_sizes(space, pair.pairing, size[:, 1])
    own = smooth_surface(space, pair.contact.source, True)
    height = np.zeros_like(gap) if own is None else np.sum(normal * own.at_source(space, pair.contact.source, source),
                                                           axis=1)  # fmt: skip
    share = np.column_stack([height, height - gap]) ** 2 + np.finfo(float).tiny
    return np.sum(share / size, axis=1) / share.sum(axis=1)


def _target_sizes(space, pairing, size):
    """Largest distance (np,) of the vertices of the partners' facets, of triangles and of three of four vertices;
    `size` (np,) where there is no partner [length]. *Collective.*"""
    places, d = space.vector(), space.dim
    places.setArray(space.points[space.owned_local].ravel())
    x = pairing.exchange.gather(places)[pairing.targets[:, :d]]
    places.destroy()
    return np.where(pairing.paired, np.linalg.norm(x[:, :, None] - x[:, None], axis=3).max(axis=(1, 2)), size)


def _modulus(problem, pair):
    """E* (np,) at the points of the source of a pair [stress]; of the bodies of a target the stiffest. *Collective.*"""
    space, constants = problem.space, problem.bulk.constants
    moduli = np.array([4.0 * mu * (lam + mu) / (lam + 2.0 * mu) for lam, mu in constants])
    bodies = np.array([block.body for block in space.mesh.blocks], dtype=np.int64)
    place = source_facets(space, pair.contact.source)[pair.source.facet]
    compliance = 1.0 / moduli[bodies[place[:, 0]]]
    if not pair.rigid:
        own = moduli[bodies[source_facets(space, pair.contact.target)[:, 0]]]
        compliance = compliance + 1.0 / space.comm.allreduce(float(np.max(own, initial=0.0)), op=MPI.MAX)
    return 1.0 / compliance
