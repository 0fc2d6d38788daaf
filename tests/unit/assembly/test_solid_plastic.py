"""Bodies that yield: forces and stiffness against plain numpy, tangents against differences."""

import numpy as np
import pytest

from pcontact.assembly.geometry import bulk_degree
from pcontact.element.quadrature import quadrature
from pcontact.element.reference import shape
from pcontact.material.elastic import in_plane
from pcontact.space.space import Space
from tests.support.plastic import LAME, MATERIALS, YIELD_STRAIN, Point, mandel, solid, tensor
from tests.support.small import (
    DIMENSION,
    SELF,
    bend,
    blocks_file,
    dense_item,
    elastic_solid,
    elasticity,
    magnitude_of,
    make_space,
    numpy_gradients,
    vector_of,
)

MATERIAL = "table+kinematic"
# cell, degree, kinematics, mean dilatation
CASES = [
    ("triangle", 1, "plane_strain", False),
    ("triangle", 2, "plane_stress", False),
    ("triangle", 2, "axisymmetric", False),
    ("quadrilateral", 1, "plane_strain", True),
    ("quadrilateral", 1, "plane_stress", False),
    ("quadrilateral", 1, "axisymmetric", True),
    ("quadrilateral", 2, "plane_strain", False),
    ("tetrahedron", 1, "plane_strain", False),
    ("tetrahedron", 2, "plane_strain", False),
    ("hexahedron", 1, "plane_strain", True),
    ("hexahedron", 1, "plane_strain", False),
    ("hexahedron", 2, "plane_strain", False),
]
every_case = pytest.mark.parametrize("bulk", CASES, indirect=True, ids=lambda case: "-".join(map(str, case)))


def body_of(space, number):
    return space.mesh.blocks[number].body


@pytest.fixture(scope="module")
def bulk(request, tmp_path_factory):
    """An elastic box below, one that may yield above; no cell is a parallelepiped."""
    cell, degree, kinematics, averaged = request.param
    path, n = tmp_path_factory.mktemp("b") / "b.msh", 1 if DIMENSION[cell] == 3 else 2
    blocks_file(path, cell, 1, n)
    shift = np.zeros(DIMENSION[cell])
    shift[0] = 0.5 if kinematics == "axisymmetric" else 0.0
    flat = make_space(SELF, path, ["lower", "upper"], degree, lambda x: bend(x, 0.04) + shift)
    space = Space(flat.mesh, degree, kinematics, [0, 1] if averaged else [])
    item = solid(space, LAME, [None, MATERIALS[MATERIAL]])
    assert [body_of(space, number) for number in item.states] == [1]
    assert all(space.averages(space.mesh.blocks[number]) == averaged for number in item.states)
    return item


def fresh(item):
    """Virgin again."""
    for state in item.states.values():
        state.values[:] = 0.0
    return item


def motion(space, size, seed):
    """Displacements (n_owned, d) with strains of about ``size`` yield strains, half of them smooth."""
    rng, x = np.random.default_rng(seed), space.points[space.owned_local]
    slopes = rng.normal(size=(space.dim, space.dim))
    return size * YIELD_STRAIN * (x @ slopes.T + 0.1 / space.degree * rng.normal(size=x.shape))


def commit(item, u):
    item.commit(vector_of(item.space, u), 1.0)


def residual(item, u):
    """(n_owned, d)"""
    out = np.zeros_like(u)
    item.residual(vector_of(item.space, u), out)
    return out


def state(item):
    return {number: (s.values[..., :-1].copy(), s.p.copy()) for number, s in item.states.items()}


def assert_same(first, second):
    for number in first:
        for a, b in zip(first[number], second[number], strict=True):
            np.testing.assert_array_equal(a, b)


# -- the twin: strains and forces as tensors, in three dimensions


def geometry(space, number):
    """Full gradients of the displacement (nc, nq, nn, d, 3, 3) per nodal value, and weights (nc, nq)."""
    block = space.mesh.blocks[number]
    table, degree = space.mesh.geometry_nodes(block)
    points, weights = quadrature(block.cell, bulk_degree(block.cell, space.degree, degree, space.axisymmetric))
    grad, jxw, values = numpy_gradients(space, number, points, weights)
    d = space.dim
    out = np.zeros((*grad.shape[:3], d, 3, 3))
    for i in range(d):
        out[..., i, i, :d] = grad
    if space.axisymmetric:
        radius = space.mesh.points[table, 0] @ shape(block.cell, degree, points).T
        out[..., 0, 2, 2] = values[None] / radius[:, :, None]
        jxw = jxw * 2.0 * np.pi * radius
    return out, jxw


def elastic_forces(space, number, grad, jxw, u):
    """(nc, nn, d), with the mean of the cell's dilatation where it is asked for."""
    slope = np.einsum("cqadij,cad->cqij", grad, u)
    strain = 0.5 * (slope + slope.transpose(0, 1, 3, 2))
    lam, mu = in_plane(*LAME, space.kinematics)
    operator = np.einsum("cqadii->cqad", grad)
    if space.averages(space.mesh.blocks[number]):
        mean = np.einsum("cq,cqad->cad", jxw, operator) / jxw.sum(axis=1)[:, None, None]
        stress = np.einsum("ijkl,cqkl->cqij", elasticity(-2.0 / 3.0 * mu, mu, 3), strain)
        pressure = (lam + 2.0 / 3.0 * mu) * np.einsum("cad,cad->c", mean, u)
        forces = np.einsum("c,c,cad->cad", jxw.sum(axis=1), pressure, mean)
    else:
        stress, forces = np.einsum("ijkl,cqkl->cqij", elasticity(lam, mu, 3), strain), 0.0
    return np.einsum("cq,cqadij,cqij->cad", jxw, grad, stress) + forces


class Twin:
    """One `test_plastic.Point` for every quadrature point of a block."""

    def __init__(self, space, number):
        self.space, self.number = space, number
        self.grad, self.jxw = geometry(space, number)
        modes = {"plane_strain": "plane strain", "plane_stress": "plane stress", "axisymmetric": "axisymmetric"}
        mode = "3D" if space.dim == 3 else modes[space.kinematics]
        self.points = [[Point(MATERIAL, mode) for _ in row] for row in self.jxw]
        self.m = self.points[0][0].m

    def strains(self, u):
        slope = np.einsum("cqadij,cad->cqij", self.grad, u[self.space.cells[self.number]])
        return 0.5 * (slope + slope.transpose(0, 1, 3, 2))

    def each(self, u, what):
        pairs = zip(self.strains(u), self.points, strict=True)
        return np.array([[what(point, mandel(e, self.m)) for e, point in zip(*row, strict=True)] for row in pairs])

    def excess(self, u):
        """(nc, nq, 3, 3)"""
        return self.each(u, lambda point, strain: tensor(point.raw(strain)[0]))

    def move(self, u):
        return self.each(u, lambda point, strain: point.move(strain)[1])


def local(space, u):
    """Nodal values of one rank in the order of its local nodes."""
    out = np.empty_like(u)
    out[space.owned_local] = u
    return out


def twin_residual(item, twins, u):
    space, nodal_u = item.space, local(item.space, u)
    out = np.zeros_like(nodal_u)
    for number in range(len(space.mesh.blocks)):
        cells = space.cells[number]
        grad, jxw = geometry(space, number)
        forces = elastic_forces(space, number, grad, jxw, nodal_u[cells])
        if number in twins:
            forces += np.einsum("cq,cqadij,cqij->cad", jxw, grad, twins[number].excess(nodal_u))
        np.add.at(out, cells, forces)
    return out[space.owned_local]


@every_case
def test_strain_from_an_origin(bulk):
    """Bodies whose strain counts from a displacement are as at the difference; each block from its own."""
    space = fresh(bulk).space
    commit(bulk, motion(space, 3.0, 1))
    u, origin = motion(space, 4.0, 2), motion(space, 1.0, 3)

    def answers(values):
        x = vector_of(space, values)
        stress = [one for one, _ in bulk.stress(x)]
        return [residual(bulk, values), bulk.tangent(x), *stress, np.array(bulk.energies(x)), [bulk.flowing(x)]]

    expected, before = answers(u - origin), state(bulk)
    commit(bulk, u - origin)
    committed = state(bulk)
    for number, (strain, p) in before.items():
        bulk.states[number].values[..., :-1], bulk.states[number].p[:] = strain, p
    some = {number: local(space, origin) for number in range(len(space.mesh.blocks))}
    bulk.count_from(some)
    try:
        for found, one in zip(answers(u), expected, strict=True):
            np.testing.assert_allclose(found, one, rtol=1e-9, atol=1e-10 * np.abs(one).max())
        commit(bulk, u)
        for number, (strain, p) in committed.items():
            np.testing.assert_allclose(bulk.states[number].values[..., :-1], strain, atol=1e-12)
            np.testing.assert_allclose(bulk.states[number].p, p, atol=1e-12)
        fresh(bulk).count_from({0: some[0]})
        forces = residual(bulk, u)
    finally:
        bulk.count_from({})
    own = np.isin(space.owned_local, space.cells[0])
    np.testing.assert_allclose(forces[own], residual(bulk, u - origin)[own], atol=1e-10 * np.abs(forces).max())
    np.testing.assert_allclose(forces[~own], residual(bulk, u)[~own], atol=1e-10 * np.abs(forces).max())


@every_case
def test_against_numpy(bulk):
    """Forces, mean stress, state of every point through a history of random steps, some of them elastic."""
    space, twins = fresh(bulk).space, {number: Twin(bulk.space, number) for number in bulk.states}
    seen = set()
    for seed, size in enumerate([0.1, 2.0, 0.5, 3.0, 6.0, 0.2]):
        u = motion(space, size, seed)
        expected, before = twin_residual(bulk, twins, u), state(bulk)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(residual(bulk, u), expected, rtol=0, atol=1e-12 * scale)
        assert_same(before, state(bulk))
        elastic = elastic_solid(space, bulk.constants).stress(vector_of(space, u))
        stress, (number, twin) = bulk.stress(vector_of(space, u)), *twins.items()
        mean = np.einsum("cq,cqij->cij", twin.jxw, twin.excess(local(space, u))) / twin.jxw.sum(axis=1)[:, None, None]
        added = stress[number][0] - elastic[number][0]
        of_tensor = np.stack([mean[:, i, j] for i, j in [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]], axis=1)
        np.testing.assert_allclose(added, of_tensor, rtol=0, atol=1e-12 * np.abs(stress[number][0]).max())
        for other in range(len(space.mesh.blocks)):
            if other != number:
                np.testing.assert_array_equal(stress[other][0], elastic[other][0])
        seen |= set(twin.move(local(space, u)).ravel().tolist())
        commit(bulk, u)
        p = np.array([[point.p for point in row] for row in twin.points])
        np.testing.assert_allclose(bulk.states[number].p, p, rtol=1e-10, atol=1e-16)
        found = np.array([[point.plastic for point in row] for row in twin.points])
        size = max(np.abs(found).max(), YIELD_STRAIN)
        np.testing.assert_allclose(bulk.states[number].values[..., :-1], found, rtol=0, atol=1e-11 * size)
        largest, volume = bulk.plasticity()
        assert largest == bulk.states[number].p.max()
        assert volume == pytest.approx(twin.jxw[bulk.states[number].p > 0.0].sum(), rel=1e-12)
        average = (twin.jxw * p).sum(axis=1) / twin.jxw.sum(axis=1)
        np.testing.assert_allclose(bulk.plastic_strain()[number], average, rtol=1e-9, atol=1e-16)
    assert seen == {True, False}


def remainders(item, u, v, steps):
    """|R(u + h v) - R(u) - h K v| over |h K v|."""
    slope = (dense_item(item, vector_of(item.space, u)) @ v.ravel()).reshape(v.shape)
    start = residual(item, u)
    scale = np.abs(slope).max()
    return [np.abs(residual(item, u + h * v) - start - h * slope).max() / (h * scale) for h in steps]


@every_case
def test_tangent(bulk):
    """Loading, unloading and exactly at the yield surface, from a state that has yielded."""
    space = fresh(bulk).space
    first = motion(space, 4.0, 1)
    # on the surface: elastic towards the inside, and not towards the outside
    commit(bulk, first)
    assert bulk.tangent(vector_of(space, first)) is bulk.values
    assert max(remainders(bulk, first, -first, [1e-2, 1e-3])) < 1e-10
    assert min(remainders(bulk, first, first, [1e-2, 1e-3])) > 1e-2
    # unloading: linear
    u = 0.95 * first
    assert bulk.tangent(vector_of(space, u)) is bulk.values
    assert max(remainders(bulk, u, -first, [1e-2, 1e-3])) < 1e-10
    # loading, everywhere or not
    commit(bulk, motion(space, 3.0, 2))
    for size, seed in ((6.0, 3), (2.0, 4)):
        u, before = motion(space, size, seed), state(bulk)
        errors = remainders(bulk, u, motion(space, 1.0, 5), [2e-4, 1e-4, 5e-5])
        assert errors[0] > 1e-9
        assert np.divide(errors[:-1], errors[1:]) == pytest.approx(2.0, rel=0.02)
        k = dense_item(bulk, vector_of(space, u))
        np.testing.assert_allclose(k, k.T, rtol=0, atol=1e-13 * np.abs(k).max())
        assert_same(before, state(bulk))
        np.testing.assert_array_equal(dense_item(bulk, vector_of(space, u)), k)


@every_case
def test_commit(bulk):
    """The state is that of the committed displacement, whatever was evaluated before; a second time changes nothing."""
    space = fresh(bulk).space
    u, other = motion(space, 4.0, 1), motion(space, 9.0, 2)
    commit(bulk, u)
    expected, forces = state(bulk), residual(bulk, u)
    fresh(bulk)
    for x in (other, u, 2.0 * u, other):
        residual(bulk, x)
        bulk.tangent(vector_of(space, x))
        magnitude_of(bulk, vector_of(space, x))
    commit(bulk, u)
    assert_same(expected, state(bulk))
    commit(bulk, u)
    assert_same(expected, state(bulk))
    np.testing.assert_array_equal(residual(bulk, u), forces)


@every_case
def test_nothing_yields(bulk):
    """Bit by bit the elastic item: forces, stiffness, magnitude."""
    space = fresh(bulk).space
    u, elastic = motion(space, 0.1, 1), elastic_solid(space, bulk.constants)
    np.testing.assert_array_equal(residual(bulk, u), residual(elastic, u))
    np.testing.assert_array_equal(magnitude_of(bulk, vector_of(space, u)), magnitude_of(elastic, vector_of(space, u)))
    assert bulk.tangent(vector_of(space, u)) is bulk.values
    np.testing.assert_array_equal(bulk.values, elastic.values)
    commit(bulk, u)
    assert all(not s.values.any() for s in bulk.states.values())
    assert bulk.plasticity() == (0.0, 0.0) and all(len(rows) == 0 for rows, _ in bulk.memory().values())


@every_case
def test_a_point_that_cannot_be_integrated(bulk):
    fresh(bulk)
    u = motion(bulk.space, 3.0, 1)
    (only,) = bulk.states.values()
    only.p[0, 0] = np.nan
    assert np.isnan(residual(bulk, u)).any()
