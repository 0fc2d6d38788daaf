"""Problems on the cells around vertices: functions, kernel, and a corner whose exact solution is known."""

from itertools import pairwise

import gmsh
import numpy as np
import pytest

from drivers.error_norms import bulk_error
from meshes.tools import finish, gmsh_model, group, unstructured
from pcontact.estimate.singular import SingularPoints
from pcontact.estimate.toward import ANGULAR, NUMBER, POWERS, held, inside, patches, rule, side_rule, toward
from pcontact.material.elastic import lame
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation

E, NU = 10.0, 0.3
DIRECT = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}


def test_functions():
    """Gradients are those of the values; zero on the opposite side; sides of one cell meet those of the next."""
    xi = np.random.default_rng(3).dirichlet(np.ones(3), 40)[:, 1:]
    values, gradients = toward(xi)
    assert values.shape == (40, NUMBER) and np.linalg.matrix_rank(values) == NUMBER
    for axis in range(2):
        step = 1e-6 * np.eye(2)[axis]
        slope = (toward(xi + step)[0] - toward(xi - step)[0]) / 2e-6
        assert np.abs(slope - gradients[:, :, axis]).max() < 1e-6 * np.abs(gradients).max()
    s = np.linspace(0.1, 1.0, 5)
    assert np.abs(toward(np.column_stack([0.3 * np.ones(5), 0.7 * np.ones(5)]))[0]).max() < 1e-15
    first, last = (toward(np.column_stack(one))[0] for one in ((s, 0.0 * s), (0.0 * s, s)))
    on = held(np.zeros((1, 2), bool), np.array([[[True, True], [False, False]]]))[0, :, 0]
    other = held(np.zeros((1, 2), bool), np.array([[[False, False], [True, True]]]))[0, :, 0]
    assert on.sum() == other.sum() == len(POWERS) and np.abs(first[:, on] - last[:, other]).max() < 1e-15
    assert np.abs(first[:, ~on][:, 1:]).max() < 1e-15


def test_rules():
    """Products of gradients of functions, as a rule of many points integrates them; a root on a side."""
    weights, (_, gradients) = rule("triangle")[1], inside("triangle", 0)
    root, own = np.polynomial.legendre.leggauss(40)
    s, t = (one.ravel() for one in np.meshgrid((0.5 * (root + 1.0)) ** 2, 0.5 * (root + 1.0), indexing="ij"))
    many = np.outer(0.125 * own * (root + 1.0) ** 3, 0.5 * own).ravel()
    _, fine = toward(np.column_stack([s * (1.0 - t), s * t]))
    for i, j in ((0, 0), (0, 1), (1, 1)):
        found = np.einsum("q,qa,qb->ab", weights, gradients[:, :, i], gradients[:, :, j])
        known = np.einsum("q,qa,qb->ab", many, fine[:, :, i], fine[:, :, j])
        assert np.abs(found - known).max() < 1e-12 * np.abs(known).max()
    for side, sign in enumerate((1.0, -1.0)):
        points, weights, _ = side_rule(side)
        away = 0.5 * (1.0 + sign * points[:, 0])
        assert weights @ np.sqrt(away) == pytest.approx(2.0 * 2.0 / 3.0, rel=1e-13)
    # a quadrilateral is two triangles: a polynomial on both, and the slopes of the functions on each
    whole = [rule("quadrilateral", half) for half in (0, 1)]
    assert sum(w @ ((1.0 + x[:, 0]) * x[:, 1] ** 2) for x, w in whole) == pytest.approx(4.0 / 3.0, rel=1e-13)
    step = 1e-7 * np.array([0.3, 1.0])
    for half, (xi, _) in enumerate(whole):
        slopes = np.array([[2.0, 2.0], [0.0, 2.0]]) if half == 0 else np.array([[2.0, 0.0], [2.0, 2.0]])
        values = [toward(np.linalg.solve(slopes, (xi + sign * step + 1.0).T).T)[0] for sign in (1.0, -1.0)]
        known = inside("quadrilateral", half)[1] @ step
        assert np.abs(0.5 * (values[0] - values[1]) - known).max() < 1e-6 * np.abs(known).max()


def test_kernel():
    """Against dense matrices: two vertices, with cells that share a side, and one that goes around."""
    rng, m = np.random.default_rng(4), 2 * NUMBER
    first, ends = np.array([0, 2, 5]), np.array([[7, 3], [3, 9], [1, 2], [2, 4], [4, 1]])
    stiffness = rng.normal(size=(5, m, m))
    stiffness = stiffness @ stiffness.transpose(0, 2, 1)
    bound = np.zeros((5, m, m))
    bound[1] = np.diag(rng.uniform(size=m))
    loads, fixed, out = rng.normal(size=(5, m)), np.zeros((5, m), dtype=bool), np.empty(5)
    fixed[1, 0] = fixed[3, 5] = True
    patches(first, ends, stiffness, bound, loads, fixed, out)
    for low, high in pairwise(first):
        names = {}
        for c in range(low, high):
            for a in range(m):
                k, i = divmod(a, 2)
                p, j = divmod(k - 1, ANGULAR + 1)
                where = "vertex" if k == 0 else (p, ends[c, j // ANGULAR]) if j in (0, ANGULAR) else (p, j, "in", c)
                names[c, a] = (where, i)
        number = {name: n for n, name in enumerate(dict.fromkeys(names.values()))}
        spread = np.zeros((high - low, m, len(number)))
        for (c, a), name in names.items():
            spread[c - low, a, number[name]] = 1.0
        some = slice(low, high)
        matrix = np.einsum("cai,cab,cbj->ij", spread, stiffness[some] + bound[some], spread)
        free = ~(np.einsum("cai,ca->i", spread, fixed[some].astype(float)) > 0.0)
        e = np.zeros(len(number))
        e[free] = np.linalg.solve(matrix[np.ix_(free, free)], np.einsum("cai,ca->i", spread, loads[some])[free])
        local = spread @ e
        assert out[some] == pytest.approx(np.einsum("ca,cab,cb->c", local, stiffness[some], local), rel=1e-9)


def crack(x, _):
    """Displacement and gradient of a crack that opens: it ends at the origin, and x is ahead of it."""
    _, mu = lame(E, NU)
    r, half = np.hypot(x[:, 0], x[:, 1]), 0.5 * np.arctan2(x[:, 1], x[:, 0])
    sin, cos, kappa = np.sin(half), np.cos(half), 3.0 - 4.0 * NU
    u = np.sqrt(r)[:, None] / mu * np.column_stack([cos * (kappa - 1.0 + 2.0 * sin**2),
                                                    sin * (kappa + 1.0 - 2.0 * cos**2)])  # fmt: skip
    # u = sqrt(r) f(half): in polar coordinates u / (2 r) and f' / (2 sqrt(r))
    slope = np.column_stack([-sin * (kappa - 1.0 + 2.0 * sin**2) + 4.0 * sin * cos**2,
                             cos * (kappa + 1.0 - 2.0 * cos**2) + 4.0 * cos * sin**2])  # fmt: skip
    slope *= 0.5 / mu / np.sqrt(r)[:, None]
    along, across = x / r[:, None], np.column_stack([-x[:, 1], x[:, 0]]) / r[:, None]
    return u, u[:, :, None] / (2.0 * r)[:, None, None] * along[:, None] + slope[:, :, None] * across[:, None]


def half(path, cell):
    """Half of a square with a crack to its middle."""
    with gmsh_model("crack"):
        occ = gmsh.model.occ
        parts = [(2, occ.addRectangle(x, 0.0, 0.0, 1.0, 1.0)) for x in (-1.0, 0.0)]
        occ.fragment(parts[:1], parts[1:])
        occ.synchronize()
        group(2, "body", [tag for _, tag in gmsh.model.getEntities(2)])
        lines = {tag: np.array(occ.getCenterOfMass(1, tag)) for _, tag in gmsh.model.getEntities(1)}
        group(1, "ahead", [tag for tag, at in lines.items() if np.hypot(at[0] - 0.5, at[1]) < 0.1])
        group(1, "around", [tag for tag, at in lines.items() if at[1] > 0.1 and abs(at[0]) > 0.1])
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        unstructured(cell)
        return finish(path, 2, 1)


@pytest.mark.parametrize("cell, degree", [("triangle", 1), ("triangle", 2), ("quadrilateral", 2)])
def test_crack(tmp_path, monkeypatch, cell, degree):
    """Estimate over error of a displacement that goes like the root of r: with degree 2 near 1, a fourth less without
    the problems around vertices."""
    mu = lame(E, NU)[1]
    r, angle, kappa = "sqrt(sqrt(x**2+y**2))", "(0.5*atan2(y,x))", 3.0 - 4.0 * NU
    prescribed = [f"{r}/{mu}*cos{angle}*({kappa - 1.0}+2*sin{angle}**2)",
                  f"{r}/{mu}*sin{angle}*({kappa + 1.0}-2*cos{angle}**2)"]  # fmt: skip
    scene = Scene(
        mesh=MeshSpec(half(tmp_path / "crack.msh", cell), order=degree),
        materials={"m": Material(E, NU)},
        bodies=[Body("body", "m")],
        displacements=[Displacement("ahead", ["free", 0.0]), Displacement("around", prescribed)],
        output=Output(fields=False, estimate=True),
        petsc=DIRECT,
    )

    def effectivity():
        simulation = Simulation(scene.copy(), MPI.COMM_SELF)
        try:
            assert simulation.run(None)
            space, u = simulation.problem.space, simulation.stepper.u
            error = bulk_error(space, [lame(E, NU)], u, crack, 20).energy
            return simulation.error_estimate.last["absolute"] / error
        finally:
            simulation.close()

    found = effectivity()
    monkeypatch.setattr(SingularPoints, "improve", lambda *_: None)
    without = effectivity()
    assert 0.9 < found < 1.05
    assert without < (0.8 if degree == 2 else 0.95)
