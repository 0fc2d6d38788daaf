"""Stiffness and stress of orthotropic bodies against numpy, and against isotropic bodies."""

import numpy as np
import pytest

from pcontact.assembly.graph import BlockRows, node_graph
from pcontact.assembly.solid import Solid
from pcontact.assembly.strains import NO_RING, CellPoints, add_means, add_stiffness, strains
from pcontact.material.elastic import FLOWS, in_plane, lame
from pcontact.space.space import Space
from tests.support.orthotropic import LAMINATE, SKEW, isotropic, law_of, plane_axes, tensor_of
from tests.support.small import DIMENSION, SELF, bend, block_file, elastic_solid, make_space, vector_of

CASES = [("triangle", 2, "plane_strain"), ("quadrilateral", 1, "plane_stress"), ("quadrilateral", 2, "axisymmetric"),
         ("tetrahedron", 1, "plane_strain"), ("hexahedron", 2, "plane_strain")]  # fmt: skip


@pytest.mark.parametrize("each", [False, True])
def test_kernels_add_what_numpy_adds(each):
    """Random gradients and stiffnesses; one for all points, and one for each."""
    rng = np.random.default_rng(1)
    n, nc, nq, nn, d = 7, 5, 2, 4, 3
    cells = np.array([rng.permutation(n)[:nn] for _ in range(nc)])
    grad, jxw, nodal = rng.normal(size=(nc, nq, nn, d)), rng.random((nc, nq)), rng.normal(size=(n, d))
    root = rng.normal(size=(nc * nq if each else 1, 6, 6))
    moduli = root @ root.transpose(0, 2, 1)
    tensors = np.array([tensor_of(one) for one in moduli])
    tensors = (tensors if each else np.repeat(tensors, nc * nq, axis=0)).reshape(nc, nq, 3, 3, 3, 3)
    rowptr, columns = node_graph([cells], n)
    values, points = np.zeros((len(columns), d, d)), CellPoints(cells, grad, NO_RING)
    flows = np.full(len(moduli), FLOWS)
    assert add_stiffness(points, jxw, moduli, flows, BlockRows(rowptr, columns, values)) == (nc, 0)
    local = np.einsum("cq,cqaj,cqijkl,cqbl->caibk", jxw, grad, tensors, grad, optimize=True)
    full = np.zeros((n, n, d, d))
    i, j = np.broadcast_arrays(cells[:, :, None], cells[:, None, :])
    np.add.at(full, (i, j), local.transpose(0, 1, 3, 2, 4))
    np.testing.assert_allclose(values, full[np.repeat(np.arange(n), np.diff(rowptr)), columns], atol=1e-11)
    stress = np.ones((nc, 6))
    add_means(jxw, np.einsum("...ij,...j->...i", moduli, strains(points, nodal)), stress)
    mean = np.einsum("cq,cqijkl,cqal,cak->cij", jxw, tensors, grad, nodal[cells]) / jxw.sum(axis=1)[:, None, None]
    expected = np.stack([mean[:, a, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))], axis=1)
    np.testing.assert_allclose(stress - 1.0, expected, atol=1e-12)


@pytest.mark.parametrize("around", [False, True])
@pytest.mark.parametrize("cell, degree, kinematics", CASES)
def test_isotropic_body_split_in_another_way(tmp_path, cell, degree, kinematics, around):
    """C_iso of any constants, and the rest as C_dev: the stiffness and the stress of the body as it is."""
    dim = DIMENSION[cell]
    path = block_file(tmp_path / "block.msh", cell, 1 if dim == 3 else 2)
    space = Space(make_space(SELF, path, ["block"], degree, bend).mesh, degree, kinematics)
    centre = (np.full(dim, -0.5), np.eye(3)[2]) if around and kinematics != "axisymmetric" else None
    law = law_of(isotropic(7.0, 0.3), plane_axes(20.0) if dim == 2 else SKEW, dim, kinematics, split=(1.0, 4.0),
                 around=centre)  # fmt: skip
    found = Solid(space, [law])
    known = elastic_solid(space, [in_plane(*lame(7.0, 0.3), kinematics)])
    np.testing.assert_allclose(found.values, known.values, atol=1e-12 * np.abs(known.values).max())
    u = vector_of(space, np.random.default_rng(3).normal(size=(space.n_owned, dim)))
    for one, other in zip(found.stress(u), known.stress(u), strict=True):
        np.testing.assert_allclose(one[0], other[0], atol=1e-11)
    # what is said of small strain
    same = [np.hstack(bulk.distortions(u, np.ones(1, dtype=bool))[0]) for bulk in (found, known)]
    np.testing.assert_allclose(*same, rtol=1e-9)


def test_energy_and_stress_of_a_uniform_strain(tmp_path):
    space = make_space(SELF, block_file(tmp_path / "block.msh", "hexahedron", 2), ["block"], 1, bend)
    law, gradient = law_of(LAMINATE, SKEW, 3), np.random.default_rng(4).normal(size=(3, 3))
    bulk = Solid(space, [law])
    u = vector_of(space, space.points[space.owned_local] @ gradient.T)
    stress = np.einsum("ijkl,kl->ij", tensor_of(law.moduli(np.zeros((1, 3)))[0]), gradient)
    (found, volume), = bulk.stress(u)
    expected = [stress[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
    np.testing.assert_allclose(found, np.tile(expected, (len(found), 1)), rtol=1e-12)
    assert bulk.energies(u)[0] == pytest.approx(0.5 * volume.sum() * np.sum(stress * gradient))
