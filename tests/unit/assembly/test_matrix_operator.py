"""The operator of other types than AIJ has the values of the AIJ matrix, whatever of it was written last."""

import numpy as np
import pytest

from pcontact.assembly.matrix import ConstrainedMatrix, GlobalMatrix, Operator
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.amplitude import amplitude
from pcontact.scene.model import Displacement
from pcontact.space.supports import Supports
from tests.support.small import blocks_file, elastic_solid, make_space
from tests.support.types import KINDS

WORLD = MPI.COMM_WORLD
CONSTANTS = [(3.0, 2.0), (1.0, 5.0)]
parallel = pytest.mark.parallel
types = pytest.mark.parametrize("kind", KINDS)


@pytest.fixture(params=[("quadrilateral", 1), ("tetrahedron", 1)], ids=lambda p: p[0])
def space(request, shared_tmp):
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        blocks_file(path, request.param[0], 2, 3)
    WORLD.Barrier()
    return make_space(WORLD, path, ["lower", "upper"], request.param[1])


def held(space):
    """Bottom held, so that rows and columns of prescribed components are among the values."""
    moved = Displacement("lower_bottom", [0.0] * space.dim)
    return Supports(space, [moved], [amplitude(moved.amplitude, 1.0)]).fixed


def pairs(space, step):
    """Pattern and symmetric blocks that couple every owned node with the one `step` nodes further."""
    total, first = space.numbering.n_total, int(space.start)
    rows = np.arange(first, first + space.n_owned)
    columns = np.sort(np.column_stack([rows, (rows + step) % total, (rows - step) % total]), axis=1)
    blocks = np.broadcast_to(np.eye(space.dim) + 0.1, (columns.size, space.dim, space.dim)).copy()
    return (3 * np.arange(space.n_owned + 1), columns.ravel()), blocks


def products(space, matrix):
    """A vector times the operator, and times AIJ."""
    x = matrix.matrix.createVecRight()
    x.setArray(np.random.default_rng(space.comm.rank).normal(size=x.getLocalSize()))
    results = [one * x for one in (matrix.operator, matrix.matrix)]
    return [result.getArray() for result in results]


@parallel
@types
def test_values_follow(space, kind):
    """The first values, others of the pairs alone, a pattern that changes, and values of the bodies."""
    bulk = elastic_solid(space, CONSTANTS)
    matrix, seen = GlobalMatrix(space, held(space)), []
    matrix.choose(kind)
    assert kind in matrix.operator.getType()
    bodies, extra = bulk.tangent(space.vector()), np.full(space.n_owned, 0.5)
    for step in (1, 3):
        pattern, blocks = pairs(space, step)
        matrix.renew(bulk.pattern(), pattern)
        for first, factor in ((bodies, 1.0), (bodies, 2.0), (bodies * 1.5, 2.0)):
            matrix.write(first, factor * blocks, extra)
            seen.append(products(space, matrix))
            np.testing.assert_allclose(*seen[-1], rtol=1e-12, atol=1e-11)
    changes = [space.comm.allreduce(np.abs(a[1] - b[1]).sum()) for a, b in zip(seen, seen[1:], strict=False)]
    assert min(changes) > 0.1


class Group:
    """The first component of the last node of all follows that of the node 0."""

    def __init__(self, space):
        self._row, self._here = (space.numbering.n_total - 1) * space.dim, False
        self._local = self._row - space.start * space.dim
        self._here = 0 <= self._local < space.n_owned * space.dim
        self.leading = np.array([0])

    def followers(self):
        return np.array([self._local] if self._here else [], dtype=np.int64)

    def ways(self):
        n = int(self._here)
        return self.followers(), np.zeros(n, dtype=np.int64), np.ones(n)


@parallel
@types
def test_values_follow_with_groups(space, kind):
    bulk = elastic_solid(space, CONSTANTS)
    matrix = ConstrainedMatrix(space, held(space), [Group(space)])
    matrix.choose(kind)
    for step in (1, 2):
        pattern, blocks = pairs(space, step)
        matrix.renew(bulk.pattern(), pattern)
        for factor in (1.0, 2.0):
            matrix.write(bulk.tangent(space.vector()), factor * blocks, np.zeros(space.n_owned))
            np.testing.assert_allclose(*products(space, matrix), rtol=1e-12, atol=1e-11)


@pytest.mark.parallel(3, 4)
@pytest.mark.parametrize("kind", ["baij", "sbaij"])
def test_ranks_without_rows(kind):
    """They assemble with the others, which do not wait for them."""
    n = WORLD.rank % 2
    base = PETSc.Mat().create(comm=WORLD)
    base.setSizes([(2 * n, None)] * 2, bsize=2)
    base.setType("aij")
    base.setUp()
    operator, start = Operator(base, kind), base.getOwnershipRange()[0] // 2
    operator.preallocate(np.arange(n + 1), np.arange(start, start + n), start)
    values = np.tile(np.eye(2).ravel(), n)
    operator.take(np.arange(n), (np.arange(n + 1), np.zeros(n + 1, dtype=np.int64)), (values, np.zeros(0)))
    ones = operator.matrix.createVecRight()
    ones.set(1.0)
    assert (operator.matrix * ones).sum() == 2.0 * (WORLD.size // 2)
