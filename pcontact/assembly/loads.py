"""External forces: pressures and tractions on facets, forces in bodies."""

import numpy as np

from pcontact.assembly.geometry import chunks
from pcontact.element.geometry import facet_geometry
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS


def _facet_force(space, facets, load):
    """Nodes (n, nn) and forces (n, nn, d) of the facets of one block under a unit load factor."""
    mesh, block = space.mesh, space.mesh.blocks[facets.block]
    table, geometry_degree = mesh.geometry_nodes(block)
    xi, weights = quadrature(CELLS[block.cell].facet, 2 * space.degree + 2 * (geometry_degree - 1))
    x = np.ascontiguousarray(mesh.points[table[facets.cells]])
    at = facet_geometry(block.cell, x, facets.local, geometry_degree, space.degree, xi, weights)
    weight = at.jxw * space.circumference(at.points)
    if load.pressure is not None:
        density = -float(load.pressure) * at.normals
    else:
        density = np.broadcast_to(np.asarray(load.traction, dtype=float), at.normals.shape)
    return space.cells[facets.block][facets.cells], np.einsum("fq,fqn,fqd->fnd", weight, at.shape, density)


def load_vector(space, load):
    """Nodal forces of a load at factor 1. *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    load : pcontact.scene.model.Load
        ``pressure`` acts against the outward normal, ``traction`` [stress] and ``body_force`` [force/volume] as given.

    Returns
    -------
    ndarray (n_owned, d)
        Forces [force] of the owned nodes (of the whole circumference with axial symmetry), and nothing for prescribed
        components is taken out here.
    """
    local = np.zeros((space.n_local, space.dim))
    if load.body_force is not None:
        density = np.asarray(load.body_force, dtype=float)
        groups = space.mesh.cell_groups[load.region]
        for number, cells in enumerate(space.cells):
            if number >= len(groups) or not len(groups[number]):
                continue
            chosen = np.zeros(len(cells), dtype=bool)
            chosen[groups[number]] = True
            for rows, _, jxw, values in chunks(space, number):
                weight = (jxw @ values) * chosen[rows][:, None]
                np.add.at(local, cells[rows], weight[:, :, None] * density)
    else:
        for facets in space.mesh.facet_groups.get(load.region, []):
            nodes, force = _facet_force(space, facets, load)
            np.add.at(local, nodes, force)
    total = space.vector()
    space.local.add(local, total)
    return total.getArray().reshape(-1, space.dim).copy()


def lumped_volume(space):
    """Volume that belongs to each owned node (n_owned,), positive. *Collective.*"""
    local = np.zeros((space.n_local, space.dim))
    for number, cells in enumerate(space.cells):
        for rows, _, jxw, _ in chunks(space, number):
            # equal shares: row sums of the mass matrix are not positive at the vertices of quadratic simplices
            share = jxw.sum(axis=1) / cells.shape[1]
            np.add.at(local[:, 0], cells[rows], share[:, None])
    total = space.vector()
    space.local.add(local, total)
    return total.getArray().reshape(-1, space.dim)[:, 0].copy()
