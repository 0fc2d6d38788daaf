"""Quadrature points of groups: what is distributed over facets, cells or nodes is summed over them."""

from typing import NamedTuple

import numpy as np

from pcontact.assembly.geometry import CHUNK
from pcontact.element.geometry import cell_geometry, facet_geometry
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import facet_nodes, shape
from pcontact.runtime.petsc import MPI


class Patch(NamedTuple):
    """Elements of one kind of a group, with their quadrature points.

    Attributes
    ----------
    nodes : ndarray (n, nn)
        Local nodes.
    shape : ndarray (n, nq, nn)
    weight : ndarray (n, nq)
        Area, volume, or 1 for nodes; with axial symmetry of the whole circumference.
    points : ndarray (n, nq, d)
        [length]
    normals : ndarray (n, nq, d) or None
        Outward normals of facets.
    body : int
        Of cells.
    block : int
        Of facets and cells.
    cells : ndarray (n,) or None
        Cells of the block: the elements, or the parents of facets.
    """

    nodes: np.ndarray
    shape: np.ndarray
    weight: np.ndarray
    points: np.ndarray
    normals: np.ndarray | None = None
    body: int = -1
    block: int = -1
    cells: np.ndarray | None = None

    def forces(self, density):
        """Forces (n, nn, d) of a density (n, nq, d)."""
        return np.einsum("nq,nqa,nqd->nad", self.weight, self.shape, density)

    def values(self, nodal):
        """Values (n, nq, d) at the points of values (n_local, d) at the nodes."""
        return np.einsum("nqa,nad->nqd", self.shape, nodal[self.nodes])


def facet_patches(space, region, more=0):
    """Patches of a group of facets, exact for products of two displacements and a polynomial of the degree `more`."""
    mesh = space.mesh
    for facets in mesh.facet_groups.get(region, []):
        block = mesh.blocks[facets.block]
        table, geometry_degree = mesh.geometry_nodes(block)
        xi, weights = quadrature(facets.kind, 2 * space.degree + 2 * (geometry_degree - 1) + more)
        x = np.ascontiguousarray(mesh.points[table[facets.cells]])
        at = facet_geometry(facets.cell, x, facets.local, geometry_degree, space.degree, xi, weights)
        weight = at.jxw * space.circumference(at.points)
        # of the cell's nodes those of the facet: the others' shape functions are zero there
        own = facet_nodes(facets.cell, space.degree)[facets.local]
        shapes = np.take_along_axis(at.shape, own[:, None, :], axis=2)
        yield Patch(space.facet_nodes(facets), shapes, weight, at.points, at.normals, -1, facets.block, facets.cells)


def cell_patches(space, region, more=0):
    """Patches of a group of cells, exact for products of two displacements and a polynomial of the degree `more`."""
    mesh = space.mesh
    for number, rows in enumerate(mesh.cell_groups.get(region, [])):
        if not len(rows):
            continue
        block = mesh.blocks[number]
        table, geometry_degree = mesh.geometry_nodes(block)
        degree = 2 * space.degree + more + (geometry_degree - 1) * mesh.dim + space.axisymmetric
        xi, weights = quadrature(block.cell, degree)
        geo, values = (shape(block.cell, k, xi) for k in (geometry_degree, space.degree))
        for first in range(0, len(rows), CHUNK):
            some = rows[first : first + CHUNK]
            x = mesh.points[table[some]]
            _, jxw, _ = cell_geometry(block.cell, x, geometry_degree, 1, xi, weights)
            points = geo @ x
            shapes = np.broadcast_to(values, (len(some), *values.shape))
            weight = jxw * space.circumference(points)
            yield Patch(space.cells[number][some], shapes, weight, points, None, block.body, number, some)


def node_patches(space, nodes):
    """The owned ones of some nodes (n,), each with the weight 1."""
    nodes = nodes[np.isin(nodes, space.owned_local)]
    if len(nodes):
        ones = np.ones((len(nodes), 1))
        yield Patch(nodes[:, None], ones[:, :, None], ones, space.points[nodes][:, None])


def kind_of(space, region):
    """Kind of a group: "facets", or without any "cells", or "nodes". *Collective.*"""
    mesh = space.mesh
    facets = sum(len(one.cells) for one in mesh.facet_groups.get(region, []))
    cells = sum(len(rows) for rows in mesh.cell_groups.get(region, []))
    facets, cells = space.comm.allreduce(np.array([facets, cells]), op=MPI.SUM)
    return "facets" if facets else "cells" if cells else "nodes"


def group_patches(space, region):
    """Patches of a group: of its facets, or without any of its cells, or of its nodes. *Collective.*"""
    kind = kind_of(space, region)
    if kind == "facets":
        return list(facet_patches(space, region))
    return list(cell_patches(space, region) if kind == "cells" else node_patches(space, space.region(region)))


def assembled(space, parts):
    """Forces (n_owned, d) of the owned nodes from those (n, nn, d) of elements with local nodes (n, nn). *Collective.*

    Parameters
    ----------
    space : pcontact.space.space.Space
    parts : iterable of (ndarray (n, nn), ndarray (n, nn, d))
    """
    local = np.zeros((space.n_local, space.dim))
    for nodes, forces in parts:
        np.add.at(local, nodes, forces)
    return space.summed(space.local, local)
