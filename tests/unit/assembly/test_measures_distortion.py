"""How far bodies are from small strain: the kernel against numpy, homogeneous motions, ranks."""

import numpy as np
import pytest

from meshes import one_block
from pcontact.assembly.geometry import some_cells_weighted
from pcontact.assembly.measures import (
    MEMBRANE,
    STIFFENING,
    STRETCH,
    Relief,
    Stiffness,
    _places,
    add_distortion,
    distortions,
)
from pcontact.assembly.solid import Solid
from pcontact.material.elastic import lame
from pcontact.material.hardening import hardening_curve
from pcontact.material.plastic import Plastic
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.space.space import Space
from tests.support.small import SELF, bend, block_file, elastic_solid, make_space

WORLD = MPI.COMM_WORLD
CONSTANTS = lame(10.0, 0.3)
HELD = np.array([True])


def displaced(space, motion):
    """A displacement as a vector: `motion` takes places to it. *Collective.*"""
    u = space.vector()
    u.setArray(motion(space.points[space.owned_local]).ravel())
    return u


def linear(gradient):
    """The motion with a displacement gradient."""
    return lambda x: x @ np.asarray(gradient).T


def found(space, motion, held=HELD, bulk=None):
    (one,) = distortions(bulk or elastic_solid(space, [CONSTANTS]), displaced(space, motion), held).values()
    return one


def turn(d, angle):
    """What small strain takes for a turn in the first plane."""
    h = np.zeros((d, d))
    h[0, 1], h[1, 0] = -angle, angle
    return h


def expected(space, u, lam, mu, limit):
    """Strain, mean squares of the rotation by volume and by work, stiffening: of homogeneous cells, with numpy."""
    totals = np.zeros(6)
    for number, block in enumerate(space.mesh.blocks):
        grad, jxw, _, _ = some_cells_weighted(space, number, np.arange(len(block.nodes)))
        for gradients, weights, cell in zip(grad, jxw, space.cells[number], strict=True):
            h = np.zeros((3, 3))
            h[: space.dim, : space.dim] = np.einsum("qaj,ai,q->ij", gradients, u[cell], weights) / weights.sum()
            e, w = 0.5 * (h + h.T), 0.5 * (h - h.T)
            size = np.linalg.norm(e)
            stress = min(1.0, limit / size) * (2.0 * mu * e + lam * np.trace(e) * np.eye(3))
            work = weights.sum() * np.sum(stress * e)
            square = 0.5 * np.sum(w * w)
            missing = 1.5 * weights.sum() * np.sum(stress * (e @ w - w @ e - w @ w))
            totals += [weights.sum(), work, work * size, weights.sum() * square, work * square, missing]
    volume, work, strain, turned, weighted, missing = totals
    return strain / work, np.degrees(np.sqrt(max(turned / volume, weighted / work))), abs(missing) / work


def test_one_cell_across_a_beam(tmp_path):
    """Bent in pure bending: no strain at its centre, and rotations that stiffen nothing, as its ends are free."""
    one_block(tmp_path / "beam.msh", 2, (20, 1), size=(20.0, 1.0), lower=(0.0, -0.5))
    space, curvature = make_space(SELF, tmp_path / "beam.msh", ["block"], 2), 4e-3
    one = found(space, lambda x: curvature * np.column_stack([-x[:, 0] * x[:, 1], 0.5 * x[:, 0] ** 2]))
    assert 0.2 * curvature < one.strain < 0.5 * curvature and one.rotation > 2.5
    assert one.stiffening < 1e-9 and max(one.errors) < 0.01


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
@pytest.mark.parametrize("limit", [np.inf, 0.02])
def test_against_numpy(tmp_path, cell, limit):
    """Cells of one strain each, whose means are those of their centres."""
    space = make_space(SELF, block_file(tmp_path / "block.msh", cell), ["block"], 1, bend)
    rng = np.random.default_rng(3)
    u = displaced(space, lambda x: 0.05 * rng.standard_normal(x.shape) + 0.1 * x)
    bulk = elastic_solid(space, [CONSTANTS])
    if np.isfinite(limit):
        curve = hardening_curve(2.0 * CONSTANTS[1] * limit * np.sqrt(1.5))
        bulk = Solid(space, [Plastic(*CONSTANTS, curve, dim=space.dim)])
    (one,) = distortions(bulk, u, HELD).values()
    np.testing.assert_allclose(one[:3], expected(space, space.local.gather(u), *CONSTANTS, limit), rtol=1e-10)


@pytest.mark.parametrize("cell, degree", [("quadrilateral", 1), ("triangle", 2), ("hexahedron", 2)])
def test_the_force_in_a_bar_is_wrong_by_one_and_a_half_times_its_strain(tmp_path, cell, degree):
    space = make_space(SELF, block_file(tmp_path / "block.msh", cell), ["block"], degree, bend)
    stretch = np.zeros((space.dim, space.dim))
    stretch[1, 1] = -0.03
    one = found(space, linear(stretch))
    np.testing.assert_allclose(one[:3], [0.03, 0.0, 0.0], atol=1e-12)
    assert abs(max(one.errors) - 0.045) < 1e-12


def test_a_turn_against_a_strain(tmp_path):
    """A body that is pressed along y and turned by 5 degrees in small strain has its work wrong by the strain of the
    turn over its own, unless nothing holds it: then it is wrong by its strain alone."""
    space = make_space(SELF, block_file(tmp_path / "block.msh", "quadrilateral"), ["block"])
    lam, mu = CONSTANTS
    angle, e = np.radians(5.0), 0.01
    h = turn(2, angle) + np.diag([lam / (lam + 2.0 * mu) * e, -e])
    one = found(space, linear(h))
    # along y alone there is a stress; the force along the motion goes with the derivative of its square
    np.testing.assert_allclose([one.rotation, one.stiffening], [5.0, 1.5 * angle**2 / e], rtol=1e-10)
    assert max(one.errors) == one.stiffening
    loose = found(space, linear(h), ~HELD)
    assert loose.stiffening == 0.0 and abs(max(loose.errors) - 1.5 * e) < 1e-12


@pytest.mark.parametrize("cell, degree", [("triangle", 1), ("quadrilateral", 2), ("tetrahedron", 1), ("hexahedron", 2)])
@pytest.mark.parametrize("kinematics", ["plane_strain", "axisymmetric"])
def test_the_second_order_against_numpy(tmp_path, cell, degree, kinematics):
    """s : (e(v) + q), 1/2 C (e(v) + q) : (e(v) + q), -1/2 s : e e, and the forces of C q, which are a slope."""
    if cell in ("tetrahedron", "hexahedron") and kinematics == "axisymmetric":
        return
    space = make_space(SELF, block_file(tmp_path / "block.msh", cell), ["block"], degree, lambda x: bend(x) + 1.0)
    space = Space(space.mesh, degree, kinematics)
    rng, (lam, mu), d = np.random.default_rng(5), CONSTANTS, space.dim
    u, v = 0.05 * rng.standard_normal((2, len(space.points), d))
    sums, worst, forces, none = np.zeros(8), np.zeros(2), np.zeros_like(u), np.zeros((0, d))
    stiffness, expected = Stiffness(lam, mu, np.inf, np.zeros((0, 6, 6)), np.zeros((0, 6))), np.zeros(3)
    table = space.mesh.geometry_nodes(space.mesh.blocks[0])[0]
    for at in _places(space, 0):
        add_distortion(at, u, v, stiffness, sums, worst, forces)
        for nodes, cells in zip(table, space.cells[0], strict=True):
            jacobian = space.mesh.points[nodes].T @ at.dgeo
            slopes, radius = at.dshape @ np.linalg.inv(jacobian), at.geo @ space.mesh.points[nodes, 0]
            volume, h = at.weight * np.linalg.det(jacobian), np.zeros((2, 3, 3))
            for one, values in zip(h, (u, v), strict=True):
                one[:d, :d] = values[cells].T @ slopes
                if space.axisymmetric:
                    one[2, 2] = at.shape @ values[cells, 0] / radius
            volume *= 2.0 * np.pi * radius if space.axisymmetric else 1.0
            e, w = 0.5 * (h[0] + h[0].T), 0.5 * (h[0] - h[0].T)
            beyond = 0.5 * (e @ w - w @ e - w @ w + h[1] + h[1].T)
            stress, more = (2.0 * mu * one + lam * np.trace(one) * np.eye(3) for one in (e, beyond))
            terms = np.sum(stress * beyond), 0.5 * np.sum(more * beyond), -0.5 * np.sum(stress * (e @ e))
            expected += volume * np.array(terms)
    np.testing.assert_allclose(sums[[STIFFENING, MEMBRANE, STRETCH]], expected, rtol=1e-11)
    ends = []
    for size in (1e-3, -1e-3):
        again = np.zeros(8)
        for at in _places(space, 0):
            add_distortion(at, u, size * v, stiffness, again, worst, none)
        ends.append(again[MEMBRANE])
    np.testing.assert_allclose(np.sum(forces * v), (ends[0] - ends[1]) / 2e-3, rtol=1e-9)


def test_what_bodies_give_way_to_is_asked_for_as_it_grows():
    asked, relief = [], Relief(None, 1)
    for most in (1.0, 1.9, 2.1, 4.0, 1.0, 0.9):
        bound = np.array([most, 0.5])
        found = relief(bound, lambda bound=bound: asked.append(bound[0]) or 0.1 * bound)
        np.testing.assert_allclose(found, 0.1 * bound)
    assert asked == [1.0, 2.1, 1.0]


def test_a_strain_in_a_corner_is_no_matter(tmp_path):
    """One cell in 256 is strained five times as much as the others."""
    space = make_space(SELF, block_file(tmp_path / "block.msh", "quadrilateral", 16), ["block"])
    corner = 1.0 / 16.0

    def motion(x):
        return 0.01 * x + 0.1 * corner * np.all(x == 0.0, axis=1)[:, None]

    one = found(space, motion)
    assert max(one.place) < corner and max(one.errors) < 0.02


def test_axial_symmetry(tmp_path):
    """The hoop strain counts, and rings by their volume."""
    path = block_file(tmp_path / "block.msh", "quadrilateral")
    space = make_space(SELF, path, ["block"], 1, lambda x: x + [1.0, 0.0])
    space = Space(space.mesh, 1, "axisymmetric")
    one = found(space, linear([[0.02, 0.0], [0.0, 0.02]]))
    np.testing.assert_allclose(one[:3], [0.02 * np.sqrt(3.0), 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(found(space, linear(turn(2, 0.1))).rotation, np.degrees(0.1), rtol=1e-10)


@pytest.mark.parallel(3)
def test_ranks(shared_tmp):
    path = shared_tmp / "block.msh"
    on_root(WORLD, block_file, path, "hexahedron", 4)

    def motion(x):
        return np.column_stack([0.1 * x[:, 1] ** 2, 0.05 * np.sin(3.0 * x[:, 0]), 0.02 * x[:, 2] * x[:, 0]])

    one, alone = found(make_space(WORLD, path, ["block"]), motion), found(make_space(SELF, path, ["block"]), motion)
    np.testing.assert_allclose(one[:3], alone[:3], rtol=1e-12)
    assert one.place == alone.place and one.rotation > 0.0
