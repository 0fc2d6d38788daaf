"""What bodies with finite strain store: the forces are its derivative, and closed forms hold."""

import numpy as np
import pytest

from tests.support.finite import LAM, LAWS, MU, deformed, finite_bulk, finite_grid, finite_space, forces_of, history
from tests.support.small import elastic_solid, vector_of

CASES = [
    ("quadrilateral", 1, "plane_strain", True), ("quadrilateral", 2, "axisymmetric", True),
    ("triangle", 2, "plane_stress", False), ("quadrilateral", 1, "axisymmetric", False),
    ("hexahedron", 1, "plane_strain", True), ("tetrahedron", 2, "plane_strain", False),
]  # fmt: skip
RUBBER = LAWS[4:]


@pytest.mark.parametrize("cell, degree, kinematics, averaged", CASES)
def test_forces_are_its_derivative(tmp_path, cell, degree, kinematics, averaged):
    """Of what is stored and dissipated, from a state with a history on: the return mapping minimises the sum."""
    rng, h = np.random.default_rng(8), 1e-4
    space = finite_space(finite_grid(tmp_path, cell, degree), degree, kinematics, averaged)
    for law in LAWS:
        if law in RUBBER and kinematics == "plane_stress":
            continue
        bulk = history(finite_bulk(space, law), rng)
        u, way = deformed(space, rng)[space.owned_local], rng.standard_normal((space.n_owned, space.dim))
        ends = [sum(bulk.energies(vector_of(space, u + k * h * way))) for k in (-2, -1, 1, 2)]
        change = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
        assert change == pytest.approx(np.sum(forces_of(bulk, u) * way), rel=1e-7), law
        assert not bulk.yields or bulk.energies(vector_of(space, u))[1] > 0.0


@pytest.mark.parametrize("law", ["hencky", *RUBBER])
def test_small_strain_is_the_limit(tmp_path, law):
    """No digit of a small strain is lost: 1e-9 squared is far below the rounding errors of 1."""
    space = finite_space(finite_grid(tmp_path, "quadrilateral", 1), 1, "plane_strain", True)
    bulk, u = finite_bulk(space, law), deformed(space, np.random.default_rng(4))[space.owned_local]
    for s in (1e-3, 1e-6, 1e-9):
        x = vector_of(space, s * u)
        expected = elastic_solid(space, bulk.constants).energies(x)[0]
        assert bulk.energies(x)[0] == pytest.approx(expected, rel=10.0 * s + 1e-9)


def test_a_stretched_block(tmp_path):
    """Uniform: Hencky's quadratic form of the logarithms, and neo-Hooke's formula, whatever the turn."""
    space = finite_space(finite_grid(tmp_path, "hexahedron", 1), 1, "plane_strain", True)
    x, (a, b, c) = space.points[space.owned_local], (1.7, 0.8, 0.9)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    u = vector_of(space, x @ (turn @ np.diag([a, b, c])).T - x)
    e, volume = np.log([a, b, c]), np.prod([a, b, c])
    size = sum(values.sum() for _, values in elastic_solid(space, finite_bulk(space, "hencky").constants).stress(u))
    stored, dissipated = finite_bulk(space, "hencky").energies(u)
    assert stored / size == pytest.approx(0.5 * LAM * e.sum() ** 2 + MU * e @ e, rel=1e-12) and dissipated == 0.0
    bulk = LAM + 2.0 / 3.0 * MU
    expected = 0.5 * MU * (volume ** (-2.0 / 3.0) * (a**2 + b**2 + c**2) - 3.0)
    expected += 0.25 * bulk * (volume**2 - 1.0 - 2.0 * np.log(volume))
    assert finite_bulk(space, "neo_hooke").energies(u)[0] / size == pytest.approx(expected, rel=1e-12)


def test_inside_out_is_no_number(tmp_path):
    space = finite_space(finite_grid(tmp_path, "quadrilateral", 1), 1, "plane_strain", True)
    u = vector_of(space, -2.0 * space.points[space.owned_local] * [1.0, 0.0])
    assert np.isnan(finite_bulk(space, "neo_hooke").energies(u)[0])
