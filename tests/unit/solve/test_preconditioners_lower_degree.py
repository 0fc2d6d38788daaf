"""Multigrid between degree 2 and degree 1: its interpolation, its lower matrix, and what it saves."""

import numpy as np
import pytest

from meshes.blocks import two_blocks
from pcontact.runtime.petsc import MPI
from pcontact.scene.model import Body, Contact, Coupling, Displacement, Load, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation
from pcontact.solve.preconditioners import LowerDegree
from tests.support.small import DIMENSION
from tests.support.wedges import cut_mesh

COMM = MPI.COMM_WORLD
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron", "wedges and pyramids", "serendipity")
parallel = pytest.mark.parallel


@pytest.fixture
def solve(shared_tmp):
    """Presses two blocks together; gives the simulation and the Krylov iterations of its first linear solve."""

    def run(cell, n=(2, 1), order=2, contact=True, **more):
        kind = cell if cell in DIMENSION else "hexahedron"
        dim, path = DIMENSION[kind], shared_tmp / f"{cell}_{n[0]}.msh"
        if COMM.rank == 0 and not path.exists():
            two_blocks(path, dim, *n, kind)
            if cell.startswith("wedges"):
                cut_mesh(path, path, ("hexahedron", "wedge", "pyramid"), split="upper_top")
        COMM.Barrier()
        petsc = {"pc_direct_below": "0", "snes_ksp_ew": "false", "ksp_rtol": "1e-8", **more.pop("petsc", {})}
        held = [Displacement("lower_bottom", [0.0] * dim), Displacement("upper_top", [0.0] * (dim - 1) + [-0.01])]
        push = [0.1] + [0.0] * (dim - 2) + [-0.01]
        scene = Scene(
            mesh=MeshSpec(path, order, serendipity=cell == "serendipity"),
            materials={"m": Material(1000.0, 0.3)},
            bodies=[Body("lower", "m"), Body("upper", "m")],
            displacements=more.pop("displacements", held),
            contacts=[Contact("upper_bottom", "lower_top", theta=0.0)] if contact else [],
            loads=[] if contact else [Load("lower", body_force=push)],
            output=Output(fields=False), petsc=petsc, **more,
        )  # fmt: skip
        simulation, counts = Simulation(scene), []
        snes = simulation.newton.snes
        snes.setMonitor(lambda _, it, norm: counts.append(snes.getKSP().getIterationNumber()))
        assert simulation.run(None)
        simulation.close()
        return simulation, counts[1]

    return run


def in_order(space, values, chosen=slice(None)):
    """Values (n_owned, ...) of the chosen owned nodes of all ranks, by their numbers in the file. *Collective.*"""
    keys = space.mesh.file_nodes[space.mesh_nodes[space.owned_local]][chosen]
    order = np.argsort(np.concatenate(COMM.allgather(keys)))
    return np.concatenate(COMM.allgather(values[chosen]))[order], order


def dense(matrix, order, dim):
    """A matrix whose nodes are taken in an order. *Collective.*"""
    rowptr, columns, values = matrix.getValuesCSR()
    mine = np.zeros((len(rowptr) - 1, matrix.getSize()[1]))
    mine[np.repeat(np.arange(len(mine)), np.diff(rowptr)), columns] = values
    order = (order[:, None] * dim + np.arange(dim)).ravel()
    return np.concatenate(COMM.allgather(mine))[np.ix_(order, order)]


@parallel
@pytest.mark.parametrize("cell", CELLS)
def test_what_is_linear_is_interpolated_as_it_is(solve, cell):
    """In each body, and zero where displacements are prescribed."""
    problem = solve(cell, contact=False)[0].problem
    level, space, own = LowerDegree(problem), problem.space, problem.space.owned_local
    height = space.points[own, -1]
    ends = COMM.allreduce(height.max(initial=0.0), op=MPI.MAX)
    upper = np.array(["upper" in space.mesh.component_names[k] for k in space.component[own]])
    field = np.where(upper, ends - height, height)[:, None] * (1.0 + np.arange(space.dim))
    at, found = level._interpolation.createVecRight(), level._interpolation.createVecLeft()
    at.setArray(field[level._vertex[own]].ravel())
    level._interpolation.mult(at, found)
    assert level._interpolation.getSize()[1] < space.n_dofs
    np.testing.assert_allclose(found.getArray().reshape(field.shape), field, atol=1e-12)


@parallel
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_the_lower_matrix_is_that_of_degree_1(solve, cell):
    """Integrated exactly in cells that no map bends; where nothing is prescribed."""
    fine, coarse = (solve(cell, order=order, contact=False)[0].problem for order in (2, 1))
    level, d = LowerDegree(fine), fine.space.dim
    vertex = level._vertex[fine.space.owned_local]
    product = fine.matrix.matrix.ptap(level._interpolation)
    found = dense(product, in_order(fine.space, fine.conditions.fixed, vertex)[1], d)
    fixed, order = in_order(coarse.space, coarse.conditions.fixed)
    free = ~fixed.ravel()
    assert 0 < free.sum() < len(free) and found.shape == 2 * (len(free),)
    expected = dense(coarse.matrix.matrix, order, d)
    np.testing.assert_allclose(found[np.ix_(free, free)], expected[np.ix_(free, free)], atol=1e-9)
    # prescribed components are nobody's neighbours
    assert not found[np.ix_(~free, free)].any() and not found[np.ix_(free, ~free)].any()


@parallel
@pytest.mark.parametrize("cell", CELLS)
def test_it_takes_fewer_iterations_than_multigrid_of_the_whole_matrix(solve, cell):
    n = (12, 9) if DIMENSION.get(cell) == 2 else (4, 3)
    found, few = solve(cell, n)
    _, many = solve(cell, n, petsc={"pc_type": "gamg"})
    assert found.newton.solver["preconditioner"] == "mg" and few <= 0.8 * many


def test_what_is_said_of_multigrid_is_said_of_the_lower_level(solve):
    simulation, _ = solve("triangle", (12, 9), petsc={"pc_gamg_threshold": "0.01", "mg_levels_ksp_max_it": "3"})
    # others are words of the process that runs the tests
    assert not [line for line in simulation.unused() if "pc_gamg" in line or "mg_levels" in line]
    pc = simulation.newton.last_preconditioner()
    lower = pc.getMGCoarseSolve().getPC()
    assert (pc.getType(), lower.getType()) == ("mg", "gamg")
    smoothers = pc.getMGSmoother(1), lower.getMGSmoother(lower.getMGLevels() - 1)
    assert [one.getTolerances()[3] for one in smoothers] == [3, 3]
    assert [one.getPC().getType() for one in smoothers] == ["pbjacobi", "jacobi"]
    assert simulation.newton.applied["mg_coarse_pc_gamg_threshold"] == "0.01"


def test_components_that_follow_others_leave_multigrid_to_the_whole_matrix(solve):
    couplings = [Coupling("upper_top", displacement=[0.0, -0.01], rotation=0.0)]
    simulation, _ = solve("triangle", couplings=couplings, displacements=[Displacement("lower_bottom", [0.0, 0.0])])
    assert simulation.newton.solver["preconditioner"] == "gamg"


def test_a_load_step_without_an_iteration_leaves_a_preconditioner(solve):
    """The estimate of the error asks for one of the tangent at the solution."""
    simulation, _ = solve("triangle", (4, 3), contact=False)
    newton, u = simulation.newton, simulation.stepper.u
    newton._renew_preconditioner()
    newton._linearised = False
    pc = newton.last_preconditioner()
    pc.setOperators(*newton._operators)
    x = u.duplicate()
    pc.apply(u, x)
    assert x.norm() > 0.0
