"""Pressure that follows its surface: forces against numpy, their derivative, resultants, symmetry."""

import numpy as np
import pytest

from pcontact.assembly.follower import FollowerPressure
from pcontact.assembly.loads import load_vector
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import CELLS, shape, shape_gradient
from pcontact.scene.amplitude import amplitude
from pcontact.scene.functions import Prescribed
from pcontact.scene.model import Load
from pcontact.space.space import Space
from tests.support.small import SELF, bend, block_file, dense, make_space, vector_of

CASES = [(cell, degree) for cell in ("triangle", "quadrilateral", "tetrahedron", "hexahedron") for degree in (1, 2)]
PRESSURE = 0.7


def space_of(folder, cell, degree, ring=False):
    """A bent block, off the axis of symmetry; with degree 2 its sides are curved."""
    path = block_file(folder / f"{cell}{degree}.msh", cell, 2 if degree == 1 else 1, degree)
    space = make_space(SELF, path, ["block"], degree, lambda x: bend(x) + 1.0)
    return Space(space.mesh, degree, "axisymmetric") if ring else space


def sides(space):
    return ["left", "right", "bottom", "top", *(["front", "back"] if space.dim == 3 else [])]


def item_of(space, region, fixed=None):
    held = np.zeros((space.n_local, space.dim), dtype=bool) if fixed is None else fixed
    item = FollowerPressure(space, region, Prescribed(PRESSURE), amplitude([(0, 0), (1, 1)], 1.0), held, "p")
    item.detect(None, 1.0)
    return item


def moved(space, size=0.1, seed=0):
    """Displacement (n_owned, d) on one rank, in which local nodes are owned ones."""
    return size * np.random.default_rng(seed).normal(size=(space.n_owned, space.dim))


def forces(items, u):
    out = np.zeros(u.shape)
    for item in items:
        item.residual(vector_of(item.space, u), out)
    return out


def places(space):
    """Reference places (n_owned, d)."""
    return space.points[space.owned_local]


def twin(space, region, u):
    """p int N c, point by point with numpy's cross product, on a rule that is finer than it need be."""
    out, places = np.zeros(u.shape), space.points.copy()
    places[space.owned_local] += u
    row = np.empty(space.n_local, dtype=np.int64)
    row[space.owned_local] = np.arange(space.n_owned)
    for facets in space.mesh.facet_groups[region]:
        kind = CELLS[space.mesh.blocks[facets.block].cell].facet
        xi, weights = quadrature(kind, 8)
        for nodes in space.facet_nodes(facets):
            x = places[nodes]
            for n, dn, w in zip(shape(kind, space.degree, xi), shape_gradient(kind, space.degree, xi), weights,
                                strict=True):  # fmt: skip
                t = dn.T @ x
                c = np.cross(*t) if space.dim == 3 else np.array([t[0, 1], -t[0, 0]])
                out[row[nodes]] += PRESSURE * w * np.outer(n, c) * space.circumference((n @ x)[None])
    return out


@pytest.mark.parametrize("ring", [False, True])
@pytest.mark.parametrize("cell, degree", CASES)
def test_forces_and_their_derivative(tmp_path, cell, degree, ring):
    space = space_of(tmp_path, cell, degree)
    if ring and space.dim == 3:
        pytest.skip("rings are of the plane")
    space = space_of(tmp_path, cell, degree, ring)
    item, u = item_of(space, "top"), moved(space)
    np.testing.assert_allclose(forces([item], u), twin(space, "top", u), atol=1e-14)
    # forces are polynomials of the third degree at most: central differences of them, extrapolated, are exact
    way = moved(space, 1.0, 1)
    wide, narrow = ((forces([item], u + h * way) - forces([item], u - h * way)) / (2.0 * h) for h in (0.2, 0.1))
    matrix = dense(*item.pattern(), item.tangent(vector_of(space, u)), space.n_owned)
    exact = (4.0 * narrow - wide) / 3.0
    np.testing.assert_allclose(matrix @ way.ravel(), exact.ravel(), atol=1e-12 * np.abs(exact).max())
    magnitude = np.zeros(u.shape)
    item.add_magnitude(vector_of(space, u), magnitude)
    assert np.all(magnitude >= np.abs(forces([item], u)) * (1.0 - 1e-12)) and magnitude.any()


@pytest.mark.parametrize("cell, degree", CASES)
def test_undeformed_it_is_a_dead_pressure(tmp_path, cell, degree):
    for ring in ([False] if cell in ("tetrahedron", "hexahedron") else [False, True]):
        space = space_of(tmp_path, cell, degree, ring)
        dead = load_vector(space, Load("right", pressure=PRESSURE))
        item, u = item_of(space, "right"), np.zeros((space.n_owned, space.dim))
        np.testing.assert_allclose(forces([item], u), -dead, atol=1e-12)
        out = np.zeros(u.shape)
        item.external(vector_of(space, u), out)
        np.testing.assert_allclose(out, dead, atol=1e-12)


@pytest.mark.parametrize("cell, degree", CASES)
def test_closed_surfaces(tmp_path, cell, degree):
    """No resultant, no moment, a symmetric tangent, and the work of the pressure is that of the volume."""
    space = space_of(tmp_path, cell, degree)
    items = [item_of(space, side) for side in sides(space)]
    u = moved(space, 0.05)
    f, x = forces(items, u), places(space) + u
    scale = np.abs(f).sum()
    np.testing.assert_allclose(f.sum(axis=0), 0.0, atol=1e-14 * scale)
    np.testing.assert_allclose(np.einsum("ni,nj->ij", x, f), np.einsum("ni,nj->ji", x, f), atol=1e-14 * scale)
    # x.f is d p times the volume inside the surface, a moment as large of each of its directions
    np.testing.assert_allclose(np.einsum("ni,nj->ij", x, f), np.eye(space.dim) * np.sum(x * f) / space.dim,
                               atol=1e-13 * scale)  # fmt: skip
    matrix = sum(dense(*item.pattern(), item.tangent(vector_of(space, u)), space.n_owned) for item in items)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-14 * np.abs(matrix).max())


@pytest.mark.parametrize("cell, degree", CASES)
def test_forces_turn_with_the_surface(tmp_path, cell, degree):
    space = space_of(tmp_path, cell, degree)
    item, u = item_of(space, "left"), moved(space)
    q, r = np.linalg.qr(np.random.default_rng(3).normal(size=(space.dim, space.dim)))
    q *= np.sign(np.diag(r))
    q[:, 0] *= np.linalg.det(q)
    x = places(space)
    turned = (x + u) @ q.T - x
    np.testing.assert_allclose(forces([item], turned), forces([item], u) @ q.T, atol=1e-14)


@pytest.mark.parametrize("cell, degree", CASES)
def test_symmetry_is_that_of_the_rim(tmp_path, cell, degree):
    """A rim that is held, or that stays in planes that it lies in, leaves the tangent symmetric."""
    space = space_of(tmp_path, cell, degree)
    free = np.zeros((space.n_local, space.dim), dtype=bool)
    flat = make_space(SELF, tmp_path / f"{cell}{degree}.msh", ["block"], degree)
    for one in (space, flat):
        assert not item_of(one, "top", free).symmetric
    held, within = free.copy(), free.copy()
    for side, axis in (("left", 0), ("right", 0), ("front", 1), ("back", 1)):
        if side in sides(space):
            held[space.region(side)] = True
            within[flat.region(side), axis] = True
    assert item_of(space, "top", held).symmetric and item_of(flat, "top", within).symmetric
    within[flat.region("left")] = False
    assert not item_of(flat, "top", within).symmetric


def test_the_factor_is_that_of_the_time(tmp_path):
    space = space_of(tmp_path, "quadrilateral", 1)
    item, u = item_of(space, "top"), moved(space)
    whole = forces([item], u)
    item.detect(None, 0.25)
    np.testing.assert_allclose(forces([item], u), 0.25 * whole)
