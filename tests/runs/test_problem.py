"""``pc.problem``: a load step as PETSc objects, which a script of the caller's own solves."""

import numpy as np
import pytest

import pcontact as pc
from meshes.blocks import two_blocks
from pcontact.runtime.petsc import MPI, PETSc, own_options

WORLD = MPI.COMM_WORLD
pytestmark = pytest.mark.parallel


@pytest.fixture
def scene(shared_tmp):
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        two_blocks(path, 2, 3, 4, "quadrilateral")
    WORLD.Barrier()
    return pc.Scene(
        mesh=path, materials={"m": {"E": 1000.0, "nu": 0.3}}, bodies={"lower": "m", "upper": "m"},
        contacts=[pc.Contact("upper_bottom", "lower_top", name="pair", friction=0.3)],
        displacements={"lower_bottom": [0, 0], "upper_top": [0.002, -0.02]},
        steps=pc.Steps(count=2), petsc={"snes_rtol": 1e-12},
    )  # fmt: skip


@pytest.fixture(autouse=True)
def options():
    with own_options():
        yield


def largest(values):
    return WORLD.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def test_load_steps_of_a_script(scene):
    """The load steps of a run, solved by the caller, whose monitor is called: the same displacement but for what a run
    gains as it looks for partners again within a load step."""
    heard = []
    with pc.problem(scene) as problem:
        problem.snes.setMonitor(lambda snes, iteration, norm: heard.append(norm))
        for time in (0.5, 1.0):
            problem.begin(time)
            problem.snes.solve(None, problem.u)
            assert problem.snes.getConvergedReason() > 0
            problem.commit()
        norm, longest = problem.u.norm(), largest(problem.u.getArray())
    run = pc.run(scene)
    fields = run.gather(everywhere=True).displacement
    assert heard and abs(longest - np.abs(fields).max()) < 1e-9
    assert abs(norm - np.linalg.norm(fields)) < 1e-6 * norm


def test_jacobian_is_the_derivative(scene):
    """Also at prescribed components, at a state where points stick."""
    with pc.problem(scene) as problem:
        problem.snes.solve(None, problem.u)
        matrix = problem.jacobian(problem.u)
        step = problem.u.duplicate()
        step.setRandom()
        there, back = (problem.u.copy() for _ in range(2))
        there.axpy(1e-7, step)
        back.axpy(-1e-7, step)
        difference = problem.residual(there)
        difference.axpy(-1.0, problem.residual(back))
        difference.scale(0.5e7)
        product = matrix.createVecLeft()
        matrix.mult(step, product)
        size = product.norm()
        product.axpy(-1.0, difference)
        assert product.norm() < 1e-6 * size


def test_vectors_of_the_dm_and_fields(scene):
    """The DM has the numbers of the displacement, the fields all unknowns once; they serve a split by bodies."""
    with pc.problem(scene, {"ksp_type": "gmres", "pc_type": "fieldsplit", "fieldsplit_pc_type": "bjacobi"}) as problem:
        assert problem.dm.createGlobalVec().getOwnershipRange() == problem.u.getOwnershipRange()
        assert sorted(problem.fields) == ["lower", "upper"]
        own = np.concatenate([one.getIndices() for one in problem.fields.values()])
        assert np.array_equal(np.sort(own), np.arange(*problem.u.getOwnershipRange()))
        problem.snes.getKSP().getPC().setFieldSplitIS(*problem.fields.items())
        problem.snes.solve(None, problem.u)
        assert problem.snes.getConvergedReason() > 0
    assert "pc_type" not in PETSc.Options().getAll()


def test_inertia_is_refused(scene):
    scene.dynamics = pc.Dynamics()
    with pytest.raises(pc.InputError, match="without inertia"):
        pc.problem(scene)
