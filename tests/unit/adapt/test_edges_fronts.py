"""Edges of what is closed, in space: where they are, and which cells they cross."""

from functools import partial

import numpy as np
import pytest

from meshes import two_blocks
from pcontact.adapt.edges import POWER, at_corners, front_of, zero_line
from pcontact.adapt.history import Watch
from pcontact.adapt.singularities import Corners
from pcontact.element.reference import CELLS
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

COMM = MPI.COMM_WORLD


def test_the_line_between_points_that_are_closed_and_open():
    """Exact where a linear function gives the values; its ends are on the sides of the triangle."""
    rng = np.random.default_rng(2)
    corners, facet = rng.normal(size=(5, 3, 3)), np.repeat(np.arange(5), 7)
    at, wanted = rng.dirichlet(np.ones(3), 35), rng.normal(size=(5, 3))
    x = np.einsum("pk,pkd->pd", at, corners[facet])
    found = at_corners(facet, corners, x, np.sum(at * wanted[facet], axis=1), rng.uniform(0.5, 1.0, 35))
    np.testing.assert_allclose(found, wanted, atol=1e-10)
    ends = zero_line(np.array([[1.0, -1.0, -3.0], [-1.0, 2.0, 2.0], [3.0, 1.0, 2.0]]))
    np.testing.assert_allclose(ends[0], [[0.5, 0.5, 0.0], [0.75, 0.0, 0.25]])
    np.testing.assert_allclose(ends[1], [[2 / 3, 1 / 3, 0.0], [2 / 3, 0.0, 1 / 3]])
    np.testing.assert_allclose(ends[2], [[0.0, 1.0, 0.0]] * 2)


def tilted(path):
    """A block whose top is turned: it opens on one side along a straight line, nearly."""
    return Scene(
        mesh=MeshSpec(path),
        materials={"soft": Material(10.0, 0.0)},
        bodies=[Body("lower", "soft"), Body("upper", "soft")],
        contacts=[Contact("upper_bottom", "lower_top", name="face")],
        displacements=[Displacement("lower_bottom", [0.0, 0.0, 0.0]),
                       Displacement("upper_top", [0.0, 0.0, "0.035-0.1*x"])],
        output=Output(fields=False, estimate=True),
    )  # fmt: skip


def crossed(path, comm):
    """Rows of the cells that the edge crosses, of all ranks: number, body, ends; what cells have to do with it, in
    which squares are those of the volume there; and the closed part of the surface. *Collective.*"""
    simulation = Simulation(tilted(path), comm)
    watch = Watch(simulation)
    assert simulation.run(None, [watch], keep=True)
    space, contact, u = simulation.problem.space, simulation.problem.contacts[0], simulation.stepper.u
    mesh = space.mesh
    ids = np.concatenate([block.ids for block in mesh.blocks])
    bodies = np.concatenate([np.full(len(block.nodes), block.body) for block in mesh.blocks])
    vertices = np.concatenate([block.nodes[:, :4] for block in mesh.blocks])
    front = front_of(space, contact, u, np.ones(len(ids)))
    corners = np.array(CELLS["tetrahedron"].facets)[front.local]
    ends = np.matmul(front.ends, mesh.points[vertices[front.cells[:, None], corners]])
    rows = np.column_stack([ids[front.cells], bodies[front.cells], ends.reshape(-1, 6)])
    some = np.isin(ids, np.concatenate(comm.allgather(ids[front.cells])))
    looks = Corners(comm), front._replace(squares=np.where(some, 1.0, 1e-3)), front._replace(squares=1.0 - some)
    power, rise, around = looks[0].look(space, watch.squares, True, looks[1])
    edges = looks[0].edges
    assert around == () and not looks[0].explain
    assert (edges.touches[front.cells] == 2).all() and np.count_nonzero(edges.touches == 2) == len(set(front.cells))
    assert (power == np.where(edges.touches > 0, POWER, 2.0 + 3.0)).all() and edges.on.any(axis=1)[some].all()
    np.testing.assert_allclose(np.sort(rise.toward[front.cells, 0]), np.sort(ends[:, 0, 0]))
    # little of the squares is at the edge
    assert looks[0].look(space, watch.squares, True, looks[2])[0] is None and looks[0].edges is None
    area = sum(float(s["weight"] @ (s["pressure"] > 0.0)) for s in contact.states(u))
    rows, area = np.concatenate(comm.allgather(rows)), comm.allreduce(area)
    touching = comm.allreduce(int(edges.touches.sum()))
    simulation.free()
    return rows[np.argsort(rows[:, 0])], area, touching


@pytest.mark.parallel
def test_where_a_block_opens(shared_tmp):
    """Cells of both bodies are crossed, by a line across the whole block that has the closed part on one side; the
    same on one rank."""
    path = shared_tmp / "tilted.msh"
    on_root(COMM, partial(two_blocks, path, 3, 3, 4, "tetrahedron"))
    rows, area, touching = crossed(path, COMM)
    assert 0.3 < area < 0.9
    for body, size in ((0, 1.0 / 3.0), (1, 0.25)):
        own = rows[rows[:, 1] == body, 2:].reshape(-1, 2, 3)
        assert np.abs(own[:, :, 0] - (1.0 - area)).max() < size and np.abs(own[:, :, 2] - 1.0).max() < 1e-12
        # of facets whose corners alone are cut off it is one of these
        assert 0.6 < np.abs(own[:, 1, 1] - own[:, 0, 1]).sum() < 1.0 + 1e-9
    if COMM.size > 1:
        alone = crossed(path, MPI.COMM_SELF)
        np.testing.assert_allclose(rows, alone[0], atol=1e-6)
        assert touching == alone[2]
