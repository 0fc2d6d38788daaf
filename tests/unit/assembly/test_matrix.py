"""Patterns, numbering, exchange, the global matrix, supports, near-null space, on one and on several ranks.

The reference of the parallel tests is the same mesh on one rank; nodes are told apart by their number in
the file.
"""

import numpy as np
import pytest

from pcontact.assembly.graph import find, node_graph
from pcontact.assembly.matrix import GlobalMatrix, OwnedRows
from pcontact.contact.pair import contact_pair
from pcontact.contact.surface.sides import source_surface, target_surface
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Contact, Displacement
from pcontact.solve.problem import Problem
from pcontact.space.modes import free_motions, near_null_space, rigid_modes
from pcontact.space.supports import Supports
from tests.support.small import (
    DIMENSION,
    SELF,
    bend,
    block_file,
    blocks_file,
    elastic_solid,
    keys,
    magnitude_of,
    make_space,
    summary_of,
    vector_of,
)

WORLD = MPI.COMM_WORLD
CONSTANTS = [(3.0, 2.0), (1.0, 5.0)]
parallel = pytest.mark.parallel


def field(space, seed=0):
    """Displacement (n_owned, d) that depends on the node of the file alone."""
    table = np.random.default_rng(seed).normal(size=(space.mesh.n_nodes_total, space.dim))
    return table[keys(space)[space.owned_local]]


def by_key(space, owned):
    """Owned rows (n_owned, d) of all ranks in the order of the file, on every rank."""
    out = np.zeros((space.mesh.n_nodes_total, space.dim))
    out[keys(space)[space.owned_local]] = owned
    space.comm.Allreduce(MPI.IN_PLACE, out, op=MPI.SUM)
    return out


def supports_of(space, *displacements):
    """Supports without a scene."""
    return Supports(space, list(displacements), [amplitude(d.amplitude, 1.0) for d in displacements])


@pytest.fixture(
    params=[("quadrilateral", 1), ("triangle", 2), ("tetrahedron", 1), ("hexahedron", 2)],
    ids=lambda p: f"{p[0]}{p[1]}",
)
def both(request, shared_tmp):
    """The space of two blocks on all ranks, and on one."""
    cell, degree = request.param
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, cell, 2, 1 if (cell, degree) == ("hexahedron", 2) else 3)
    WORLD.Barrier()
    return tuple(make_space(comm, path, ["lower", "upper"], degree, bend) for comm in (WORLD, SELF))


@pytest.fixture
def tiny(shared_tmp):
    """Two cells, one in each body: some ranks of four have none."""
    path = shared_tmp / "tiny.msh"
    if WORLD.rank == 0:
        blocks_file(path, "quadrilateral", 1, 1)
    WORLD.Barrier()
    return tuple(make_space(comm, path, ["lower", "upper"], 1) for comm in (WORLD, SELF))


def contact_item(space, theta=0.0, radius=0.5, **more):
    contact = Contact("upper_bottom", "lower_top", theta=theta, search="closest_point", **more)
    source, target = source_surface(space, contact.source, CONSTANTS), target_surface(space, contact.target)
    return contact_pair(space, contact, source, target, radius)


# -- rows that several ranks add to ----------------------------------------


@parallel
def test_owned_rows_sum_all_contributions(both):
    """Ones in every block of every cell: the sum counts the cells that two nodes share."""
    space, serial = both
    result = []
    for s in (space, serial):
        rowptr, columns = node_graph(s.cells, s.n_local)
        rows = OwnedRows(s.numbering, s.exchanger, s.nodes, rowptr, columns)
        local = np.zeros((len(columns), s.dim, s.dim))
        for table in s.cells:
            for a in range(table.shape[1]):
                for b in range(table.shape[1]):
                    pair = [find(columns, rowptr[i], rowptr[i + 1], j) for i, j in table[:, [a, b]]]
                    np.add.at(local, np.array(pair, dtype=np.int64), 1.0)
        total = rows.sum(local)
        assert np.all(np.diff(rows.rowptr) > 0) and total.min() >= 1.0
        for r in range(len(rows.rowptr) - 1):
            assert np.all(np.diff(rows.columns[rows.rowptr[r] : rows.rowptr[r + 1]]) > 0)
        number_to_key = np.zeros(s.numbering.n_total, dtype=np.int64)
        number_to_key[s.nodes] = keys(s)
        number_to_key = np.max(s.comm.allgather(number_to_key), axis=0)
        row = np.repeat(keys(s)[s.owned_local], np.diff(rows.rowptr))
        entries = np.column_stack([row, number_to_key[rows.columns], total[:, 0, 0].astype(int)])
        entries = np.concatenate(s.comm.allgather(entries))
        result.append(entries[np.lexsort((entries[:, 1], entries[:, 0]))])
    np.testing.assert_array_equal(*result)


@parallel
def test_bulk_is_the_same_on_any_ranks(both):
    space, serial = both
    forces, sizes = [], []
    for s in both:
        bulk = elastic_solid(s, CONSTANTS)
        u, out = vector_of(s, field(s)), np.ones((s.n_owned, s.dim))
        bulk.residual(u, out)
        forces.append(by_key(s, out))
        sizes.append(by_key(s, magnitude_of(bulk, u)))
    np.testing.assert_allclose(*forces, atol=1e-11)
    np.testing.assert_allclose(*sizes, rtol=1e-12)


def global_matrix(space, supports, contact=None, u=None, extra=0.0):
    """Matrix of bulk and an optional contact item."""
    bulk, matrix = elastic_solid(space, CONSTANTS), GlobalMatrix(space, supports.fixed)
    none = np.zeros(space.n_owned + 1, dtype=np.int64), np.zeros(0, dtype=np.int64)
    values = np.zeros((0, space.dim, space.dim)) if contact is None else contact.tangent(u)
    matrix.renew(bulk.pattern(), none if contact is None else contact.pattern())
    matrix.write(bulk.tangent(u), values, np.full(space.n_owned, extra))
    return matrix


def times(space, matrix, values):
    """Matrix times (n_owned, d)."""
    y = space.vector()
    matrix.mult(vector_of(space, values), y)
    return y.getArray().reshape(-1, space.dim).copy()


@parallel
def test_global_matrix_without_supports(both):
    """It is the bulk item; the rigid modes of each body are in its kernel; the stabilisation goes to the diagonal."""
    space, serial = both
    matrix = global_matrix(space, supports_of(space)).matrix
    values = field(space)
    product = by_key(space, times(space, matrix, values))
    reference = np.zeros((serial.n_owned, serial.dim))
    elastic_solid(serial, CONSTANTS).residual(vector_of(serial, field(serial)), reference)
    np.testing.assert_allclose(product, by_key(serial, reference), atol=1e-11)
    assert matrix.isSymmetric(1e-12)
    scale = matrix.norm(PETSc.NormType.NORM_INFINITY)
    for body in range(space.mesh.n_components):
        for mode in rigid_modes(space.points, np.zeros(space.dim), 1.0):
            own = (mode * (space.component == body)[:, None])[space.owned_local]
            size = space.comm.allreduce(np.abs(own).max(initial=0.0), op=MPI.MAX)
            rest = space.comm.allreduce(np.abs(times(space, matrix, own)).max(initial=0.0), op=MPI.MAX)
            assert rest < 1e-13 * scale * size
    more = global_matrix(space, supports_of(space), extra=0.5).matrix
    np.testing.assert_allclose(
        times(space, more, values) - times(space, matrix, values), 0.5 * values, atol=1e-11
    )


def some_supports(space):
    """Bottom held in all directions, top of the upper block moved, one side held in x."""
    d = space.dim
    return supports_of(
        space,
        Displacement("lower_bottom", [0.0] * d),
        Displacement("upper_top", ["free"] * (d - 1) + [-0.1]),
        Displacement("left", [0.0] + ["free"] * (d - 1)),
    )


@parallel
@pytest.mark.parametrize("theta", [1.0, 0.0])
def test_supports_keep_the_matrix_symmetric(both, theta):
    """Prescribed rows and columns: the diagonal of the bulk and nothing else, with and without contact."""
    for space in both:
        supports = some_supports(space)
        item = contact_item(space, theta)
        u = vector_of(space, 0.01 * field(space))
        item.detect(space.vector(), 1.0)
        held = global_matrix(space, supports, item, u).matrix
        free = global_matrix(space, supports_of(space), item, u).matrix
        assert held.isSymmetric(1e-12) == (theta == 1.0)
        assert free.isSymmetric(1e-12) == (theta == 1.0)
        fixed = supports.fixed[space.owned_local]
        assert space.comm.allreduce(int(fixed.sum())) > 0
        values = field(space, 5)
        diagonal = (
            global_matrix(space, supports_of(space)).matrix.getDiagonal().getArray().reshape(fixed.shape)
        )
        expected = np.where(fixed, diagonal * values, times(space, free, np.where(fixed, 0.0, values)))
        np.testing.assert_allclose(times(space, held, values), expected, atol=1e-11)


@parallel
def test_supports_agree_between_ranks(both):
    """Which components are prescribed, to what values, at which times, does not depend on the ranks."""
    tables = []
    for space in both:
        supports = some_supports(space)
        own = space.owned_local
        tables.append(
            [by_key(space, supports.fixed[own].astype(float))]
            + [by_key(space, supports.values(t)[own]) for t in (0.0, 0.3, 1.0)]
        )
        assert np.all(supports.values(0.7)[~supports.fixed] == 0.0)
        values = np.concatenate(space.comm.allgather(supports.values(0.5).ravel()))
        np.testing.assert_allclose(np.unique(values), [-0.05, 0.0])
    for a, b in zip(*tables, strict=True):
        np.testing.assert_array_equal(a, b)


@parallel
def test_conflicting_supports_are_refused_on_every_rank(both):
    space, _ = both
    d = space.dim
    first = Displacement("lower_bottom", [0.0] * d)
    with pytest.raises(
        InputError, match=r"displacements\[1\].*left.*direction 0.*displacements\[0\].*allowed"
    ) as info:
        supports_of(space, first, Displacement("left", [0.1] + ["free"] * (d - 1)))
    assert len(set(WORLD.allgather(str(info.value)))) == 1
    # the same value twice is no conflict, another history of the same value is
    supports_of(space, first, Displacement("left", [0.0] * d))
    with pytest.raises(InputError, match="in direction 0 at the point"):
        supports_of(
            space,
            Displacement("lower_bottom", [1.0] * d),
            Displacement("left", [1.0] + ["free"] * (d - 1), [(0, 0), (0.5, 1), (1, 1)]),
        )


@parallel
@pytest.mark.parametrize("theta", [1.0, 0.0, -1.0])
def test_contact_is_the_same_on_any_ranks(both, theta):
    """Forces, tangent times vector, and the summary of a pair that is partly open."""
    results = []
    for space in both:
        item = contact_item(space, theta, gamma0=1.0)
        item.detect(vector_of(space, 0.001 * field(space, 2)), 1.0)
        u, out = vector_of(space, 0.2 * field(space)), np.zeros((space.n_owned, space.dim))
        item.residual(u, out)
        matrix = global_matrix(space, some_supports(space), item, u).matrix
        results.append(
            (by_key(space, out), by_key(space, times(space, matrix, field(space, 3))), summary_of(item, u))
        )
    for a, b in zip(results[0][:2], results[1][:2], strict=True):
        assert np.abs(b).max() > 1e-3
        np.testing.assert_allclose(a, b, atol=1e-11)
    first, second = results[0][2], results[1][2]
    assert second["open"] > 0 and second["slip"] > 0
    for key, value in second.items():
        np.testing.assert_allclose(first[key], value, atol=1e-11)
    assert len({str(s) for s in WORLD.allgather(first)}) == 1


# -- near-null space, floating bodies ----------------------------------------


@parallel
@pytest.mark.parametrize("colours", [(0, 0), (0, 1)])
def test_near_null_space(both, colours):
    """Orthonormal; spans the bodies' rigid modes, apart where colours differ; K times it vanishes."""
    space, _ = both
    vectors = near_null_space(space, np.array(colours)).getVecs()
    n_modes = 3 if space.dim == 2 else 6
    assert len(vectors) == n_modes * len(set(colours))
    gram = np.array([[a.dot(b) for b in vectors] for a in vectors])
    np.testing.assert_allclose(gram, np.eye(len(vectors)), atol=1e-12)
    matrix = global_matrix(space, supports_of(space)).matrix
    y = space.vector()
    for vector in vectors:
        matrix.mult(vector, y)
        assert y.norm() < 1e-12 * matrix.norm(PETSc.NormType.NORM_INFINITY)
    # relative motion of the bodies is in the span only if the colours differ
    mode = np.zeros((space.n_owned, space.dim))
    mode[space.component[space.owned_local] == 1, -1] = 1.0
    rest = vector_of(space, mode)
    for vector in vectors:
        rest.axpy(-rest.dot(vector), vector)
    assert (rest.norm() < 1e-10) == (colours[0] != colours[1])


@parallel
def floating(space, supports):
    """Bodies that the supports do not hold, with the number of rigid modes left."""
    return {k: len(motions) for k, motions in free_motions(space, supports).items()}


def test_floating_bodies(both):
    """How many rigid modes are left, for supports from none to all."""
    space, _ = both
    d = space.dim
    all_modes = 3 if d == 2 else 6
    assert floating(space, supports_of(space)) == {0: all_modes, 1: all_modes}
    held = Displacement("lower_bottom", [0.0] * d)
    assert floating(space, supports_of(space, held)) == {1: all_modes}
    vertical = Displacement("upper_top", ["free"] * (d - 1) + [0.0])
    # a line held vertically in 2D leaves one mode, a plane in 3D three
    assert floating(space, supports_of(space, held, vertical)) == {1: 1 if d == 2 else 3}
    point = Displacement("upper_origin", [0.0] * d)
    assert floating(space, supports_of(space, held, point)) == {1: 1 if d == 2 else 3}
    assert floating(space, supports_of(space, held, Displacement("upper_top", [0.0] * d))) == {}


# -- the problem ----------------------------------------


@parallel
def test_the_matrix_gets_a_new_pattern_when_far_points_close(shared_tmp):
    """The object stays, products are those of a matrix that was made for the closed state."""
    path = shared_tmp / "apart.msh"
    if WORLD.rank == 0:
        blocks_file(path, "quadrilateral", 3, 4, gap=0.5)
    WORLD.Barrier()
    space = make_space(WORLD, path, ["lower", "upper"])
    supports = some_supports(space)
    item = contact_item(space, radius=1.0)
    problem = Problem(space, [elastic_solid(space, CONSTANTS), item], supports, [], np.zeros(space.n_owned))
    zero = space.vector()
    item.detect(zero, 1.0)
    problem.tangent(zero)
    matrix, entries = problem.matrix.matrix, problem.matrix.matrix.getInfo()["nz_used"]
    assert problem.pattern_changes == 1
    problem.tangent(zero)
    assert problem.pattern_changes == 1
    closed = np.zeros((space.n_owned, 2))
    closed[space.component[space.owned_local] == 1, 1] = -0.6
    u = vector_of(space, closed)
    problem.tangent(u)
    assert problem.pattern_changes == 2
    assert problem.matrix.matrix is matrix
    assert WORLD.allreduce(matrix.getInfo()["nz_used"]) > WORLD.allreduce(entries)
    fresh = contact_item(space, radius=1.0)
    fresh.detect(zero, 1.0)
    values = field(space)
    expected = times(space, global_matrix(space, supports, fresh, u).matrix, values)
    np.testing.assert_allclose(times(space, matrix, values), expected, atol=1e-12)
    # opening again keeps the entries
    problem.tangent(zero)
    assert problem.pattern_changes == 2
    without = times(space, global_matrix(space, supports).matrix, values)
    np.testing.assert_allclose(times(space, matrix, values), without, atol=1e-12)


@parallel
@pytest.mark.parametrize("theta", [0.0, 1.0])
def test_tangent_of_the_problem_is_the_derivative_of_its_residual(both, theta):
    """With supports, several items, forces."""
    space, _ = both
    supports = some_supports(space)
    items = [
        elastic_solid(space, CONSTANTS),
        contact_item(space, theta),
        contact_item(space, theta, bilateral=True),
    ]
    rng = np.random.default_rng(7)
    force = rng.normal(size=(space.n_owned, space.dim))
    problem = Problem(space, items, supports, [(force, amplitude(None, 1.0))], np.zeros(space.n_owned))
    u = vector_of(space, 0.01 * field(space))
    for item in items[1:]:
        item.detect(space.vector(), 1.0)
    problem.time = 0.5
    problem.prediction.begin(u, 0.5)
    fixed = problem.conditions.fixed
    v = np.where(fixed, 0.0, 1e-6 * field(space, 4))
    residuals = []
    for shift in (0.0, 1.0):
        f = space.vector()
        problem.residual(vector_of(space, u.getArray().reshape(v.shape) + shift * v), f)
        residuals.append(f.getArray().reshape(v.shape).copy())
    problem.tangent(u)
    slope = times(space, problem.matrix.matrix, v)
    top = WORLD.allreduce(np.abs(slope).max(initial=0.0), op=MPI.MAX)
    np.testing.assert_allclose(residuals[1] - residuals[0], slope, atol=1e-8 * top)
    assert np.all(residuals[0][fixed] == 0.0)
    unbalanced = problem.unbalanced(u)
    np.testing.assert_allclose(unbalanced[~fixed], residuals[0][~fixed], atol=1e-13)
    reactions = problem.forces.reactions(u)
    total = WORLD.allreduce(np.where(fixed, unbalanced, 0.0).sum(axis=0))
    np.testing.assert_allclose(sum(np.array(r) for r in reactions.values()), total, atol=1e-11)


@parallel
def test_ranks_without_cells(tiny):
    """Two cells on up to four ranks: everything works and equals the serial result."""
    results = []
    for space in tiny:
        supports = some_supports(space)
        assert floating(space, supports) == {}
        item = contact_item(space, theta=1.0)
        item.detect(space.vector(), 1.0)
        u = vector_of(space, 0.01 * field(space))
        matrix = global_matrix(space, supports, item, u).matrix
        assert matrix.isSymmetric(1e-12)
        out = np.zeros((space.n_owned, 2))
        item.residual(u, out)
        elastic_solid(space, CONSTANTS).residual(u, out)
        vectors = near_null_space(space, np.array([0, 1])).getVecs()
        assert len(vectors) == 6
        results.append(
            (by_key(space, out), by_key(space, times(space, matrix, field(space, 3))), summary_of(item, u))
        )
    for a, b in zip(results[0][:2], results[1][:2], strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)
    for key, value in results[1][2].items():
        np.testing.assert_allclose(results[0][2][key], value, atol=1e-12)


@parallel
@pytest.mark.parametrize("cell", DIMENSION)
def test_a_body_without_contact_and_more_ranks_than_facets(shared_tmp, cell):
    """One cell (or a cut cube): no contact facet anywhere on most ranks, obstacle items included."""
    path = shared_tmp / "one.msh"
    if WORLD.rank == 0:
        block_file(path, cell, 1)
    WORLD.Barrier()
    space = make_space(WORLD, path, ["block"])
    surface = source_surface(space, "bottom", CONSTANTS)
    assert WORLD.allreduce(len(surface.cells)) == (2 if cell == "tetrahedron" else 1)
    assert surface.grad.shape[2] == space.dim
    target = target_surface(space, "top")
    x = target.deformed(np.zeros((space.n_local, space.dim)))
    assert x.shape[0] == len(target.kinds)
    item = contact_pair(space, Contact("bottom", "top", theta=0.0, search="ray_tracing"), surface, target, 0.1)
    item.detect(space.vector(), 1.0)
    assert not np.any(item.pairing.paired)
    assert summary_of(item, space.vector())["slip"] == 0
    out = np.zeros((space.n_owned, space.dim))
    item.residual(vector_of(space, field(space)), out)
    assert np.all(out == 0.0)
