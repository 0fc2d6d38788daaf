"""Geometric error of facets: the surfaces that the facets of a mesh stand for.

Nodes of finer meshes lie on the facets of the first one: what these are off the surface stays. Straight facets are
chords; with the nodes in the middles of edges on the surface they have the error of an interpolation of degree 2. Gaps
between curved facets in contact are taken off by their smooth surfaces, `pcontact.contact.surface.smooth_geometry`.

`drivers/studies/facets.py` compares what changes on the first mesh with what is left on ever finer ones.
"""

from dataclasses import replace

import numpy as np

from pcontact.contact.surface.smooth_geometry import smooth_surface
from pcontact.element.reference import CELLS, reference_nodes
from pcontact.element.shape import shape_gradient
from pcontact.mesh.topology import jacobians, outer_facets
from pcontact.runtime.petsc import MPI

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
