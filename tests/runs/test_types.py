"""-mat_type and -vec_type: the answer is that of AIJ, on any number of ranks; what is not there is refused."""

import numpy as np
import pytest

from meshes.blocks import two_blocks
from pcontact.assembly.matrix import AIJ, BESIDE
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, PETSc, has_package, known_types
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Output, Scene
from pcontact.simulation import Simulation
from tests.support.types import DEVICES, KINDS

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel
THERE = known_types(PETSc.Mat, (*AIJ, *BESIDE))
TIGHT = {"snes_rtol": "1e-12", "ksp_rtol": "1e-12", "snes_ksp_ew": "false"}


@pytest.fixture
def blocks(shared_tmp):
    path = shared_tmp / "blocks.msh"
    if WORLD.rank == 0:
        two_blocks(path, 3, 2, 3, "tetrahedron")
    WORLD.Barrier()
    return path


def pressed(path, options, theta=1.0, **contact):
    """Two blocks pressed together."""
    moved = [Displacement("lower_bottom", [0.0] * 3), Displacement("upper_top", [0.0, 0.0, -0.02])]
    return Scene(
        MeshSpec(path), {"m": Material(1000.0, 0.3)}, [Body("lower", "m"), Body("upper", "m")],
        [Contact("upper_bottom", "lower_top", name="pair", theta=theta, **contact)], moved,
        output=Output(fields=False), petsc={**TIGHT, **options},
    )  # fmt: skip


def solved(scene):
    """Displacement (n_owned, d), and types of the two matrices and the filter that the linear systems had."""
    simulation = Simulation(scene)
    try:
        assert simulation.run(None)
        ksp = simulation.newton.snes.getKSP()
        kinds = [matrix.getType() for matrix in ksp.getOperators()]
        d = simulation.problem.space.dim
        return simulation.stepper.u.getArray().reshape(-1, d).copy(), (*kinds, simulation.newton.solver["filter"])
    finally:
        simulation.close()


def close(values, reference):
    """Whether displacements are those of a reference, to what rounding errors leave. *Collective.*"""
    size = WORLD.allreduce(np.abs(reference).max(initial=0.0), op=MPI.MAX)
    return WORLD.allreduce(np.abs(values - reference).max(initial=0.0), op=MPI.MAX) < 1e-9 * size


@parallel
def test_multigrid(blocks):
    """It stays on AIJ beside every other type; without a word the operator is BAIJ."""
    reference, types = solved(pressed(blocks, {"mat_type": "aij"}))
    assert types[0] == types[1] and types[0].endswith("aij")
    for kind in (None, *KINDS):
        found, types = solved(pressed(blocks, {"mat_type": kind} if kind else {}))
        assert types[0][3:] == (kind or "baij")
        assert types[1][3:] == (kind if kind in AIJ else "aij")
        assert close(found, reference), kind


@parallel
@pytest.mark.parametrize("more, name", [({"pc_contact_filter": "true"}, "contact"), ({}, "none")])
def test_around_multigrid(blocks, more, name):
    """The filter, and preconditioners that know nothing of types, with a tangent that is not symmetric."""
    law = {"theta": 0.0, "friction": 0.3}
    reference, _ = solved(pressed(blocks, {"mat_type": "aij", **more}, **law))
    for kind in ("baij", "sell"):
        found, types = solved(pressed(blocks, {"mat_type": kind, **more}, **law))
        assert types[2] == name and types[0].endswith(kind)
        assert close(found, reference), kind


@parallel
@pytest.mark.parametrize("kind, pc", [("baij", "bjacobi"), ("baij", "lu"), ("sbaij", "cholesky"), ("sell", "jacobi")])
def test_factors_follow_the_type(blocks, kind, pc):
    if WORLD.size > 1 and pc in ("lu", "cholesky") and not has_package("mumps"):
        pytest.skip("PETSc has no factors on several ranks")
    options = {"pc_type": pc}
    if pc in ("lu", "cholesky") and has_package("mumps"):
        options["pc_factor_mat_solver_type"] = "mumps"
    reference, _ = solved(pressed(blocks, {"mat_type": "aij"}))
    found, types = solved(pressed(blocks, {"mat_type": kind, **options}))
    assert types[0][3:] == kind
    assert types[1][3:] == ("aij" if kind == "sell" else kind)
    assert close(found, reference)


def test_what_is_not_there(blocks):
    """One message, with what is allowed."""
    there = r" \| ".join(kind for kind in THERE if kind != "sbaij")
    with pytest.raises(InputError, match=rf"-mat_type: found 'nonsense'; allowed: .*{THERE[-1]}"):
        Simulation(pressed(blocks, {"mat_type": "nonsense"}))
    with pytest.raises(InputError, match=rf"'sbaij'; allowed: {there}; sbaij where tangents are symmetric"):
        Simulation(pressed(blocks, {"mat_type": "sbaij"}, theta=0.0))
    with pytest.raises(InputError, match="-vec_type: found 'nonsense'; allowed: standard"):
        Simulation(pressed(blocks, {"vec_type": "nonsense"}))


@pytest.mark.parametrize("kind", DEVICES)
def test_accelerators_that_are_not_there(blocks, kind):
    """One message too, whether PETSc lacks the type or the machine the device."""
    if kind in KINDS:
        pytest.skip("there is one")
    with pytest.raises(InputError, match=f"-mat_type: found '{kind}'; allowed: aij"):
        Simulation(pressed(blocks, {"mat_type": kind}))


@parallel
def test_vectors(blocks):
    """`standard` is what the program's own vectors are."""
    simulation = Simulation(pressed(blocks, {"vec_type": "standard"}))
    try:
        assert simulation.run(None)
        assert simulation.newton.snes.getSolution().getType() == ("seq" if WORLD.size == 1 else "mpi")
    finally:
        simulation.close()
