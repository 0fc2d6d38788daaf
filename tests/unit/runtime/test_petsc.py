"""What differs between versions of PETSc."""

import shutil
import sys

import numpy as np
import pytest

from pcontact.runtime.errors import InputError, SolverError
from pcontact.runtime.options import Options
from pcontact.runtime.petsc import (
    LONG,
    MPI,
    PETSc,
    diverged_nan,
    forget_pattern,
    graph_of_blocks,
    graph_of_long_rows,
    keep_communicator,
    known_types,
    own_options,
)
from tests.support.commands import launch

COMM = MPI.COMM_WORLD
ROWS = 40


def fill(matrix, width):
    """Diagonally dominant, each row with `width` entries from the diagonal on; as `assembly.matrix` preallocates."""
    total = ROWS * COMM.size
    first = np.arange(ROWS)[:, None] + ROWS * COMM.rank
    columns = np.sort((first + np.arange(width)) % total, axis=1)
    values = np.where(columns == first, 2.0 * width, -1.0)
    rowptr = np.arange(0, columns.size + 1, width, dtype=PETSc.IntType)
    matrix.setPreallocationCSR((rowptr, columns.ravel().astype(PETSc.IntType), values.ravel()))


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["asm", "gamg"])
def test_a_preconditioner_follows_a_new_pattern(kind):
    total = ROWS * COMM.size
    matrix = PETSc.Mat().create(comm=COMM)
    matrix.setSizes(((ROWS, total), (ROWS, total)))
    matrix.setType("mpiaij" if COMM.size > 1 else "seqaij")
    ksp = PETSc.KSP().create(comm=COMM)
    ksp.setType("gmres")
    ksp.setTolerances(rtol=1e-10, max_it=100)
    ksp.getPC().setType(kind)
    for width in (2, 5, 9, 3, 20):
        fill(matrix, width)
        forget_pattern(ksp)
        ksp.setOperators(matrix, matrix)
        b, x = matrix.createVecLeft(), matrix.createVecRight()
        b.setArray(1.0 + np.arange(ROWS) % 3)
        ksp.solve(b, x)
        norm = b.norm()
        b.axpy(-1.0, matrix * x)
        assert ksp.getConvergedReason() > 0
        assert b.norm() < 1e-8 * norm


def test_the_reason_for_what_is_not_finite():
    assert isinstance(diverged_nan, int) and diverged_nan < 0


def arrow(nodes, size):
    """A chain of nodes, blocks of `size` rows, the first of which is coupled to all others; diagonally dominant."""
    first, end = nodes * COMM.rank // COMM.size, nodes * (COMM.rank + 1) // COMM.size
    count, columns, values = [], [], []
    for row in range(first, end):
        near = np.unique(np.clip([0, row - 1, row, row + 1], 0, nodes - 1)) if row else np.arange(nodes)
        column = (near[:, None] * size + np.arange(size)).ravel()
        for k in range(size):
            values.append(np.where(column == row * size + k, 0.1 * len(column) + 0.01, -0.1 - 0.01 * k))
            columns.append(column)
            count.append(len(column))
    matrix, own = PETSc.Mat().create(comm=COMM), (end - first) * size
    matrix.setSizes(((own, nodes * size), (own, nodes * size)), bsize=size)
    matrix.setType("mpiaij" if COMM.size > 1 else "seqaij")
    csr = np.concatenate([[0], np.cumsum(count)]), np.concatenate(columns)
    matrix.setPreallocationCSR((*(part.astype(PETSc.IntType) for part in csr), np.concatenate(values)))
    return matrix


@pytest.mark.parallel
def test_the_graph_of_blocks():
    matrix = arrow(12, 3)
    graph = graph_of_blocks(matrix)
    rows, columns, values = graph.getValuesCSR()
    found, (first, end) = np.zeros((len(rows) - 1, 12)), graph.getOwnershipRange()
    found[np.repeat(np.arange(len(rows) - 1), np.diff(rows)), columns] = values
    dense = matrix.convert("dense").getDenseArray() if COMM.size == 1 else None
    every = np.concatenate(COMM.allgather(found))
    np.testing.assert_allclose(every[5, [0, 4, 6]], 9 * 0.1 + 3 * (0.01 + 0.02), rtol=1e-14)
    assert np.count_nonzero(every[5]) == 4 and np.count_nonzero(every[0]) == 12
    if dense is not None:
        np.testing.assert_allclose(every, np.abs(dense).reshape(12, 3, 12, 3).sum(axis=(1, 3)), rtol=1e-14)
    assert end - first == len(rows) - 1


@pytest.mark.parallel
def test_multigrid_of_a_node_with_thousands_of_neighbours():
    # on several ranks it is only said that there are so many
    matrix = arrow(LONG + 4 if COMM.size == 1 else 300, 2)
    graph_of_long_rows(matrix, LONG + 4)
    with own_options():
        for name in ("pc_gamg_aggressive_coarsening", "pc_gamg_agg_nsmooths"):
            PETSc.Options().setValue(name, 0)
        ksp = PETSc.KSP().create(comm=COMM)
        ksp.setType("gmres")
        ksp.setTolerances(rtol=1e-9)
        ksp.getPC().setType("gamg")
        ksp.setFromOptions()
        ksp.setOperators(matrix, matrix)
        b, x = matrix.createVecLeft(), matrix.createVecRight()
        b.set(1.0)
        ksp.solve(b, x)
    assert ksp.getConvergedReason() > 0
    b.axpy(-1.0, matrix * x)
    assert b.norm() < 1e-4 * np.sqrt(b.getSize())


class Complaint:
    """What petsc4py raises: a code, and where PETSc was."""

    def __init__(self, code, *said):
        self.ierr, self._said = code, (f"error code {code}", *(f"[0] {one}" for one in said))

    def __str__(self):
        return "\n".join(self._said)


def test_what_petsc_complains_about():
    places = "PCSetUp() at ./src/precon.c:994", "MatCreateGraph_Simple_AIJ() at ./src/mpiaij.c:7804"
    limit = Complaint(83, *places, "Buffer 4500 too small 4096.")
    options = Options()
    assert options.fault(limit) is None
    told = options.unsolved(limit, MPI.COMM_SELF)
    assert isinstance(told, SolverError) and told.status == 1
    assert "MatCreateGraph_Simple_AIJ: Buffer 4500 too small 4096)" in str(told) and "-pc_type lu" in str(told)
    value = Complaint(83, *places, "Unknown enum value 'zz' for -pc_mg_cycle_type")
    with own_options():
        PETSc.Options().setValue("pc_mg_cycle_type", "zz")
        told = Options().fault(value)
    assert isinstance(told, InputError)
    assert "found -pc_mg_cycle_type zz: Unknown enum value" in str(told)


def test_types_that_there_are():
    """Names are looked up, as a type whose accelerator is missing cannot be made."""
    assert known_types(PETSc.Mat, ("aij", "nonsense", "baij", "sell")) == ["aij", "baij", "sell"]
    assert known_types(PETSc.Vec, ("standard", "nonsense")) == ["standard"]


@pytest.mark.parallel
@pytest.mark.parametrize("keeps", [True, False])
def test_the_communicator_of_petsc_outlives_its_objects(keeps):
    """Else the ranks would have to make it anew together, though they let go of the last object at different times."""
    comm, mark = COMM.Dup(), MPI.Comm.Create_keyval()
    if keeps:
        keep_communicator(comm)

    def inner():
        vector = PETSc.Vec().createMPI(comm.size, comm=comm)
        own = vector.getComm().tompi4py()
        before = own.Get_attr(mark)
        own.Set_attr(mark, True)
        vector.destroy()
        return before

    assert [inner() for _ in range(3)] == [None, keeps or None, keeps or None]
    comm.Free()
    MPI.Comm.Free_keyval(mark)


OTHERS = """if True:
    import sys
    from pcontact.runtime.petsc import MPI, PETSc, free_garbage
    comm = MPI.COMM_WORLD
    free_garbage(comm)
    vector = PETSc.Vec().createMPI(comm.size, comm=comm)
    if comm.rank:
        vector.destroy()
    # longer than the variables of modules
    sys.held = vector
"""


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="there is no mpirun")
def test_programs_end_whose_ranks_hold_other_objects(tmp_path):
    """As after an exception: PETSc's last clean-up is one of all ranks, whatever they have."""
    done = launch(["mpirun", "-n", "2", sys.executable, "-c", OTHERS], tmp_path)
    assert done.returncode == 0, done.stderr
