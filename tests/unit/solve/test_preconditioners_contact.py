"""The filter at closed points: its formula, its choice of unknowns, and what it does to Krylov counts."""

import numpy as np
import pytest

import pcontact.solve.preconditioners as filter_module
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, PETSc
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation
from pcontact.solve.preconditioners import ContactPreconditioner, preconditioner
from tests.support.small import blocks_file

COMM = MPI.COMM_WORLD
LOCAL = 12
parallel = pytest.mark.parallel
# nothing can slip
STUCK = 1e6


def dense_matrix(symmetric):
    """Banded, diagonally dominant, the same on all ranks."""
    n = LOCAL * COMM.size
    values = np.random.default_rng(3).uniform(-1.0, 1.0, (n, n))
    values[np.abs(np.subtract.outer(np.arange(n), np.arange(n))) > 5] = 0.0
    if symmetric:
        values = 0.5 * (values + values.T)
    return values + np.diag(np.abs(values).sum(axis=1) + 1.0)


def distributed(values):
    """A dense matrix as a distributed one."""
    mine = values[COMM.rank * LOCAL : (COMM.rank + 1) * LOCAL]
    n = len(values)
    rowptr = np.arange(0, mine.size + 1, n, dtype=PETSc.IntType)
    columns = np.tile(np.arange(n, dtype=PETSc.IntType), LOCAL)
    return PETSc.Mat().createAIJ(((LOCAL, n), (LOCAL, n)), csr=(rowptr, columns, mine.ravel()), comm=COMM)


def action(context, values):
    """The preconditioner as a dense matrix, column after column; Jacobi is the inner one. Collective."""
    options = PETSc.Options("twin_")
    options["pc_type"] = "jacobi"
    matrix, ksp = distributed(values), PETSc.KSP().create(comm=COMM)
    context.attach(ksp, "twin_")
    ksp.setOperators(matrix, matrix)
    ksp.getPC().setUp()
    x, y = matrix.createVecRight(), matrix.createVecLeft()
    columns = []
    for unit in np.eye(len(values)):
        x.setArray(unit[COMM.rank * LOCAL : (COMM.rank + 1) * LOCAL])
        ksp.getPC().apply(x, y)
        columns.append(np.concatenate(COMM.allgather(y.getArray().copy())))
    assert preconditioner(ksp).getType() == "jacobi"
    context.detach(ksp)
    assert preconditioner(ksp).getType() == ksp.getPC().getType() == "jacobi"
    options.delValue("pc_type")
    return np.array(columns).T


def own(rows):
    """Those that this rank owns."""
    return rows[(rows >= LOCAL * COMM.rank) & (rows < LOCAL * (COMM.rank + 1))]


ROWS = {
    "first rank": np.array([2, 3, 7, 11]),
    "last rank": LOCAL * COMM.size - np.array([9, 5, 4]),
    "all ranks": np.arange(1, LOCAL * COMM.size, 2),
    "all rows": np.arange(LOCAL * COMM.size),
    "none": np.zeros(0, dtype=np.int64),
}


@parallel
@pytest.mark.parametrize("mumps", [True, False])
@pytest.mark.parametrize("where", ROWS)
@pytest.mark.parametrize("symmetric", [True, False])
def test_the_filter_is_its_formula(where, symmetric, mumps, monkeypatch):
    if not mumps:
        monkeypatch.setattr(filter_module, "has_package", lambda name: False)
    a, rows = dense_matrix(symmetric), ROWS[where]
    found = action(ContactPreconditioner(lambda: own(rows)), a)
    one = np.eye(len(a))
    b, s = np.diag(1.0 / np.diag(a)), np.zeros_like(a)
    s[np.ix_(rows, rows)] = np.linalg.inv(a[np.ix_(rows, rows)])
    error = (one - b @ a) @ (one - s @ a) @ (one - b @ a) if len(rows) else one - b @ a
    np.testing.assert_allclose(one - found @ a, error, atol=1e-12)
    if symmetric:
        np.testing.assert_allclose(found, found.T, atol=1e-13)


@parallel
def test_the_direct_solve_follows_the_matrix_and_the_rows():
    """Also where the inner preconditioner is kept, and other ranks take part."""
    a, chosen = dense_matrix(True), {}
    context = ContactPreconditioner(lambda: own(chosen["rows"]))
    b = np.diag(1.0 / np.diag(a))
    matrix, ksp = distributed(a), PETSc.KSP().create(comm=COMM)
    PETSc.Options("twin_")["pc_type"] = "jacobi"
    context.attach(ksp, "twin_")
    ksp.setOperators(matrix, matrix)
    x, y = matrix.createVecRight(), matrix.createVecLeft()
    for step, where in enumerate(["first rank", "all ranks", "none", "last rank", "last rank"]):
        chosen["rows"] = rows = ROWS[where]
        matrix.scale(2.0 if step else 1.0)
        now = a * 2.0**step
        context.keep(step > 0)
        ksp.setUp()
        x.setArray(np.cos(np.arange(LOCAL * COMM.size))[COMM.rank * LOCAL : (COMM.rank + 1) * LOCAL])
        ksp.getPC().apply(x, y)
        # Jacobi is kept as it was for the first matrix
        r = np.cos(np.arange(LOCAL * COMM.size))
        expected = b @ r
        if len(rows):
            part = np.linalg.solve(now[np.ix_(rows, rows)], (r - now @ expected)[rows])
            expected[rows] += part
            expected += b @ (r - now @ expected)
        np.testing.assert_allclose(np.concatenate(COMM.allgather(y.getArray())), expected, rtol=1e-9, atol=1e-12)
    context.detach(ksp)
    PETSc.Options("twin_").delValue("pc_type")


# -- runs -----------------------------------------------------------------------------------------------------------


def in_order(simulation):
    """The displacement of all nodes in the order of the file, whatever the partition. *Collective.*"""
    space = simulation.problem.space
    keys = space.mesh.file_nodes[space.mesh_nodes[space.owned_local]]
    values = simulation.stepper.u.getArray(readonly=True).reshape(len(keys), -1)
    parts = COMM.allgather((keys, values))
    order = np.argsort(np.concatenate([part[0] for part in parts]))
    return np.concatenate([part[1] for part in parts])[order]


@pytest.fixture
def solve(shared_tmp):
    """Runs two blocks pressed together; gives the simulation, Krylov counts of the solves, and the displacement."""
    path = shared_tmp / "blocks.msh"
    if COMM.rank == 0:
        blocks_file(path, "hexahedron", 6, 4)
    COMM.Barrier()

    def run(theta=0.0, friction=None, gamma0=None, lower=1.0, upper=1.0, shift=0.0, reuse=False, **petsc):
        scene = Scene(
            mesh=MeshSpec(path),
            materials={"l": Material(1000.0 * lower, 0.3), "u": Material(1000.0 * upper, 0.3)},
            bodies=[Body("lower", "l"), Body("upper", "u")],
            displacements=[Displacement("lower_bottom", [0.0] * 3), Displacement("upper_top", [shift, 0.0, -0.01])],
            contacts=[Contact("upper_bottom", "lower_top", theta=theta, gamma0=gamma0, friction=friction)],
            allow_unsafe=["friction"],
            output=Output(fields=False),
            petsc={"snes_ksp_ew": "false", "ksp_rtol": "1e-8", "snes_rtol": "1e-11", **petsc},
        )
        if not reuse:
            scene.petsc["newton_without"] = "reuse"
        simulation, counts = Simulation(scene), []
        snes = simulation.newton.snes
        snes.setMonitor(lambda _, it, norm: counts.append(snes.getKSP().getIterationNumber()))
        converged = simulation.run(None)
        simulation.close()
        assert converged
        return simulation, counts[1:], in_order(simulation)

    return run


ALONE = {
    "theta 0": {},
    "theta 1": {"theta": 1.0},
    "slip": {"friction": 0.3},
    "source": {"upper": 100.0, "friction": STUCK},
    "target": {"lower": 100.0, "friction": STUCK},
}
STIFF = {
    "gamma0": {"gamma0": 100.0, "friction": STUCK},
    "gamma0, theta 1": {"gamma0": 200.0, "theta": 1.0, "friction": STUCK},
    "gamma0, frictionless, theta 1": {"gamma0": 200.0, "theta": 1.0},
    "theta -1, gamma0 .1": {"theta": -1.0, "gamma0": 0.1, "friction": STUCK},
}


@parallel
@pytest.mark.parametrize("name", STIFF)
def test_stiff_pairs_need_few_iterations(solve, name):
    simulation, counts, found = solve(**STIFF[name])
    assert simulation.newton._filter.size > 0
    assert counts and max(counts) <= 25
    _, _, expected = solve(**STIFF[name], pc_type="lu", **{"pc_factor_mat_solver_type": "mumps"})
    np.testing.assert_allclose(found, expected, atol=1e-8)


@parallel
@pytest.mark.parametrize("case", ALONE)
def test_multigrid_alone_where_that_is_enough(solve, case):
    simulation, counts, _ = solve(**ALONE[case])
    assert simulation.newton._filter is None
    assert counts and max(counts) <= 40


@parallel
@pytest.mark.parametrize("mode", ["true", "false", ""])
def test_the_option_decides(solve, mode):
    simulation, counts, _ = solve(pc_contact_filter=mode)
    if mode == "false":
        assert simulation.newton._filter is None
    else:
        assert simulation.newton._filter.size > 0 and max(counts) <= 15


def test_a_wrong_value(solve):
    with pytest.raises(InputError, match=r"pc_contact_filter: found 'maybe'; allowed: auto \| true \| false"):
        solve(pc_contact_filter="maybe")


@parallel
@pytest.mark.parametrize("kind", ["hypre", "ml"])
def test_around_other_preconditioners(solve, kind):
    if not PETSc.Sys.hasExternalPackage(kind):
        pytest.skip(f"PETSc has no {kind}")
    case = {"pc_type": kind, "gamma0": 100.0, "friction": STUCK}
    simulation, counts, _ = solve(**case, pc_contact_filter="true")
    _, alone, _ = solve(**case, pc_contact_filter="false")
    assert simulation.newton.snes.getKSP().getPC().getType() == kind
    assert max(counts) < 0.7 * max(alone)


@parallel
def test_a_kept_multigrid_with_points_that_change(solve):
    """Points slip and open from one iteration to the next; the hierarchy stays, the direct solve follows."""
    # partners stay: others would be another matrix
    case = {"friction": 0.3, "shift": 0.02, "gamma0": 50.0, "contact_search_again": "0"}
    simulation, counts, found = solve(**case, reuse=True)
    assert len(counts) > 2 and simulation.newton._filter.size > 0
    assert max(counts) <= 45
    _, _, expected = solve(**case, pc_type="lu", **{"pc_factor_mat_solver_type": "mumps"})
    np.testing.assert_allclose(found, expected, atol=1e-8)
