"""Pressures as functions of place in the study of named errors."""

import numpy as np
import pytest

from drivers.studies._named_pressure import Pressure


def line(cells, points, value):
    """A pressure on the axis from 0 to 1, at Gauss points of its facets."""
    s, w = np.polynomial.legendre.leggauss(points)
    ends = np.linspace(0.0, 1.0, cells + 1)
    x = (ends[:-1, None] + 0.5 * (s + 1.0) * np.diff(ends)[:, None]).ravel()
    weight = (0.5 * w * np.diff(ends)[:, None]).ravel()
    corners = np.column_stack([ends, np.zeros(cells + 1)])
    facets = np.stack([corners[:-1], corners[1:]], axis=1)
    return Pressure(np.column_stack([x, 0.0 * x]), value(x, np.repeat(np.arange(cells), points)), weight,
                    np.repeat(np.arange(cells), points), facets)  # fmt: skip


def test_distance_of_pressures_on_nested_facets(tmp_path):
    """Jumps between facets are theirs, and lines are met exactly up to the ends of facets; with points in any order."""
    rough = line(4, 3, lambda x, facet: 1.0 + x + 0.1 * facet)
    mixed = np.random.default_rng(1).permutation(len(rough.x))
    rough = Pressure(rough.x[mixed], rough.value[mixed], rough.weight[mixed], rough.facet[mixed], rough.ends)
    fine = line(16, 5, lambda x, _: 1.0 + x)
    assert rough.at(fine.x) == pytest.approx(1.0 + fine.x[:, 0] + 0.1 * (fine.facet // 4), abs=1e-12)
    # the mean of the squares of 0, 1, 2, 3, and of 1 + x
    assert fine.distance(rough) == pytest.approx(0.1 * np.sqrt(3.5 / (7.0 / 3.0)))
    assert line(3, 4, lambda x, _: 1.0 + 0.2 * x).off(1.0) == pytest.approx(0.2 / np.sqrt(3.0))
    fine.write(tmp_path / "kept.npz", 0.01)
    again, error = Pressure.read(tmp_path / "kept.npz")
    assert error == 0.01 and again.distance(rough) == fine.distance(rough)


def sheet(cells, value):
    """A pressure on the slanted square of two triangles, each divided into smaller ones, at three points of each."""
    n, corners = np.arange(cells), []
    for i, j in np.stack(np.meshgrid(n, n), axis=-1).reshape(-1, 2):
        a, b, c, d = (np.array(one) / cells for one in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)))
        corners += [[a, b, c], [a, c, d]]
    corners = np.array(corners)
    ends = np.concatenate([corners, 0.5 * corners[:, :, :1]], axis=2)
    points = np.einsum("qk,fkd->fqd", np.full((3, 3), 1.0 / 6.0) + 0.5 * np.eye(3), ends).reshape(-1, 3)
    facet = np.repeat(np.arange(len(ends)), 3)
    return Pressure(points, value(points, facet), np.full(len(points), np.sqrt(1.25) / len(points)), facet, ends)


def test_distance_of_pressures_in_space():
    """Planes are met exactly on the facet of a point, also where its neighbours have others."""
    fine = sheet(6, lambda x, _: 1.0 + x[:, 0])
    rough = sheet(2, lambda x, _: 1.1 + x[:, 0])
    assert fine.distance(rough) == pytest.approx(0.1 / np.sqrt(7.0 / 3.0), rel=1e-3)
    steps = sheet(3, lambda x, facet: 1.0 + x[:, 1] + 0.1 * facet)
    assert steps.on_facets(steps.x) == pytest.approx(steps.value)
