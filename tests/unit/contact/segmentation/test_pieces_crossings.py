"""Cuts in the plane are those that plain bisection of the partners finds, with a few searches."""

import numpy as np
import pytest

from drivers._common import make_mesh
from meshes import two_blocks
from pcontact.contact.segmentation import pieces
from pcontact.contact.segmentation.pieces import SAMPLES, SLIVER, _apart, _Partners, cuts
from pcontact.contact.surface.sides import FACETS, target_surface
from pcontact.runtime.petsc import MPI
from tests.support.small import SELF, make_space

WORLD = MPI.COMM_WORLD
RADIUS = 0.3
# share of the largest height, moved, that points 0.2 and more from the two surfaces have
FADES = 0.2


def flat(x, y):
    return 0.0 * x


def folded(x, y):
    """Sharp convex and concave vertices; of curved facets, vertices between facets that bend to both sides."""
    return 0.02 * np.sin(61.0 * x + y)


def crowned(x, y):
    """Two smooth crowns, the upper one in the lower one at the ends."""
    return np.where(y < 1.02, -0.1, -0.4) * (x - 0.5) ** 2


def arched(x, y):
    """The upper surface in a hollow of nearly the same shape."""
    return np.where(y < 1.02, 0.5, 0.55) * (x - 0.45) ** 2


SHAPES = {"flat": flat, "folded": folded, "crowned": crowned, "arched": arched}


def moved(shape):
    """Blocks whose surfaces are bent."""

    def change(points):
        out = np.array(points)
        fades = np.maximum(1.0 - np.abs(out[:, 1] - 1.02) / FADES, 0.0)
        out[:, 1] += fades * SHAPES[shape](out[:, 0], out[:, 1])
        return out

    return change


def bisected(partners, n):
    """Facets and places (m,) of all changes of the partners of points of n facets, by bisection alone."""
    grid = np.linspace(-1.0 + 1e-9, 1.0 - 1e-9, SAMPLES + 1)
    label = partners(np.repeat(np.arange(n), SAMPLES + 1), np.tile(grid, n)).label.reshape(n, SAMPLES + 1)
    f, k = np.nonzero(label[:, 1:] != label[:, :-1])
    a, b, at_a, at_b = grid[k], grid[k + 1], label[f, k], label[f, k + 1]
    for _ in range(52):
        middle = 0.5 * (a + b)
        at = partners(f, middle).label
        left, right = np.flatnonzero(at != at_a), np.flatnonzero(at != at_b)
        f = np.concatenate([f[left], f[right]])
        a, b = np.concatenate([a[left], middle[right]]), np.concatenate([middle[left], b[right]])
        at_a, at_b = np.concatenate([at_a[left], at[right]]), np.concatenate([at[left], at_b[right]])
    return f, 0.5 * (a + b)


def inner_cuts(facet, at):
    """Sorted rows (m, 2) of facets and places, without those that are no pieces' ends."""
    order = np.lexsort((at, facet))
    facet, at = _apart(facet[order], at[order])
    inside = np.abs(at) < 1.0 - SLIVER
    return np.column_stack([facet[inside], at[inside]])


def found_cuts(comm, path, order, shape, method):
    """Cuts inside the source facets of all ranks, rows (m, 2) of the facets' numbers and places; how many searches it
    took; and on one rank those that bisection finds."""
    space = make_space(comm, path, ["lower", "upper"], order, moved(shape))
    parts, target = space.mesh.facet_groups.get("upper_bottom", []), target_surface(space, "lower_top")
    search, counts = (target, RADIUS, method), []

    class Counted(_Partners):
        def __call__(self, *points):
            counts.append(len(points[0]))
            return super().__call__(*points)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pieces, "_Partners", Counted)
        _, _, facet, a, _ = cuts(space, parts, search)
    ids = [space.mesh.blocks[f.block].ids[f.cells] * FACETS + f.local for f in parts]
    ids = np.concatenate([np.zeros(0, dtype=np.int64), *ids])
    inner = a > -1.0
    rows = np.concatenate(comm.allgather(np.column_stack([ids[facet[inner]], a[inner]])))
    if comm.size > 1 or comm is SELF:
        return rows[np.lexsort(rows.T[::-1])], len(counts), None
    expected = inner_cuts(*bisected(_Partners(space, parts, search), len(ids)))
    expected[:, 0] = ids[expected[:, 0].astype(int)]
    return rows[np.lexsort(rows.T[::-1])], len(counts), expected[np.lexsort(expected.T[::-1])]


@pytest.mark.parallel
@pytest.mark.parametrize("method", ["closest_point", "ray_tracing"])
@pytest.mark.parametrize("shape", list(SHAPES))
@pytest.mark.parametrize("order", [1, 2])
def test_cuts_are_those_of_bisection(shared_tmp, shape, order, method):
    """A source that is coarser or finer than its target, hangs over its end and is cut up to twenty times; on several
    ranks the cuts are those of one."""
    # bisection puts cuts as far beside a node as it holds, and between the two places to which rays pass facets' ends
    beside = 1e-11 if method == "closest_point" else 1e-9
    for lower, upper in ((41, 3), (7, 10)):
        path = make_mesh(
            two_blocks, shared_tmp / "blocks.msh", 2, [lower, 1], [upper, 1], "quadrilateral",
            order=order, gap=0.05, widths=(0.8, 1.0), offset=-0.1,
        )  # fmt: skip
        found, searches, expected = found_cuts(WORLD, path, order, shape, method)
        if WORLD.size > 1:
            expected, beside = found_cuts(SELF, path, order, shape, method)[0], 1e-14
        assert len(found) > lower / 2 and searches <= 4
        assert np.array_equal(found[:, 0], expected[:, 0])
        assert found[:, 1] == pytest.approx(expected[:, 1], abs=beside)
