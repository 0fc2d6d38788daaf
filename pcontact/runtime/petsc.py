"""PETSc, started once, with the command line of a program, and what differs between its versions (3.18 to 3.26).

Every other module takes ``PETSc`` and ``MPI`` from here.
"""

import ctypes
import difflib
import glob
import mmap
import re
import traceback
import weakref
from contextlib import contextmanager
from functools import cache

import numpy as np

from pcontact.runtime import process
from pcontact.runtime.errors import NoPetsc

# where Debian and Ubuntu have the one that is on no Python's way
_DEBIAN = "/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages"
# before anything opens a file that stays open
process.reserve()


def no_petsc(error):
    """The error that says so.

    Parameters
    ----------
    error : Exception
        Of the import.

    Returns
    -------
    NoPetsc
    """
    reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    if re.search(r"numpy|multiarray|_ARRAY_API", str(error)):
        # compiled code that was built with numpy 2 runs with numpy 1, too, but not the other way round
        remedy = "pip install 'numpy<2'" if np.lib.NumpyVersion(np.__version__) >= "2.0.0" else "pip install -U numpy"
        return NoPetsc(f"petsc4py was built for another numpy than {np.__version__}, which is here ({reason}); "
                       f"remedy: {remedy}")  # fmt: skip
    found = sorted(glob.glob(f"{_DEBIAN}/petsc4py"))
    debian = "apt-get install python3-petsc4py-real python3-mpi4py"
    if found:
        debian = f"/usr/bin/python3 with PYTHONPATH={found[-1].rpartition('/')[0]}"
    return NoPetsc(
        f"no petsc4py and mpi4py that work ({reason}); remedy, one of: Debian, Ubuntu: {debian}; "
        "conda: conda install -c conda-forge petsc4py mpi4py; spack: spack load py-petsc4py py-mpi4py; PETSc of your "
        "own, PETSC_DIR set: pip install mpi4py && pip install --no-build-isolation petsc4py==<version of that PETSc>"
    )


try:
    import petsc4py

    petsc4py.init(process.petsc_words())

    from mpi4py import MPI
    from petsc4py import PETSc
# numpy and MPI that do not fit give the last two
except (ImportError, ValueError, RuntimeError) as error:
    raise no_petsc(error) from error

process.take_back()

__all__ = [
    "MPI", "Integer", "PETSc", "call", "handle", "has_package", "known_types", "line_search_limit", "local_values",
    "matrix_parts", "unknown_options", "version",
]  # fmt: skip

version = PETSc.Sys.getVersion()[:2]

_lib = ctypes.CDLL(PETSc.__file__)

# [bytes] From which on a piece of memory goes back to the system when it is freed. From: the largest bound that glibc
# takes by itself
MAPPED = 2**25
# what glibc's mallopt calls the top of the heap that goes back, that bound, and how many such pieces there are at most
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _MMAP_MAX = -1, -3, -4
# SuperLU_DIST, which PETSc loads, has the C library keep all that is freed, and each large array would leave a hole
if hasattr(ctypes.CDLL(None), "mallopt"):
    for _what, _value in ((_MMAP_MAX, 2**16), (_MMAP_THRESHOLD, MAPPED), (_TRIM_THRESHOLD, 2 * MAPPED)):
        ctypes.CDLL(None).mallopt(_what, _value)

# newer versions list unused options when they end, also those that are pcontact's own; pcontact names the others itself
# (in a library the database is the caller's)
_options = PETSc.Options()
if not process.is_library():
    if not _options.hasName("options_left"):
        _options.setValue("options_left", False)
    _options.getBool("options_left", False)


# packages that cut graphs
PETSC_GRAPHS = ("ptscotch", "parmetis", "chaco")


# PETSc's own factors take pivots below 2e-14 for zero, whatever the units: a matrix that is small all over is none
LEAST_PIVOT = 1e-300
# [unknowns] So many at most for which the program turns to a direct solver by itself, by the dimension of space. From:
# factors of about 1 GB. Row: direct.
MOST_UNKNOWNS = {2: 400_000, 3: 60_000}


def can_factorise(ranks, dim, unknowns):
    """Tell whether a system of this size may be factorised unasked: PETSc has factors of its own on one rank only."""
    return (ranks == 1 or has_package("mumps")) and unknowns <= MOST_UNKNOWNS[dim]


def has_package(name):
    """Return whether this PETSc was built with an external package.

    Parameters
    ----------
    name : str
        "hypre", "mumps", "ml", ...
    """
    return bool(PETSc.Sys.hasExternalPackage(name))


# option for the longest step of a line search
full_steps = "none" if version >= (3, 26) else "basic"
line_search_limit = "snes_linesearch_maxlambda" if version >= (3, 24) else "snes_linesearch_maxstep"

# reason of SNES for a residual that is not finite; the name changed between 3.22 and 3.26
diverged_nan = getattr(PETSc.SNES.ConvergedReason, "DIVERGED_FNORM_NAN", None) or (
    PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_NANORINF
)

# what ended Newton's method, in words
newton_reasons = {
    value: name.lower().replace("_", " ")
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int)
}


# PETSc's integer, for arguments and results
Integer = np.ctypeslib.as_ctypes_type(PETSc.IntType)


def handle(thing):
    """A PETSc object as an argument of :func:`call`."""
    return ctypes.c_void_p(thing.handle)


def call(name, *args):
    """Call a function of PETSc's that petsc4py does not pass on.

    Parameters
    ----------
    name : str
    *args
        Of ctypes; arrays stand for their memory, whole numbers for PETSc's, None for a null pointer.

    Raises
    ------
    PETSc.Error
    """
    code = getattr(_lib, name)(*map(_argument, args))
    if code:
        raise PETSc.Error(code)


def _argument(value):
    if isinstance(value, np.ndarray):
        return value.ctypes.data_as(ctypes.c_void_p)
    return Integer(value) if isinstance(value, (int, np.integer)) else value


def _storage(matrix):
    """Return what PETSc's functions call the storage of a matrix."""
    return "BAIJ" if matrix.getType().endswith("baij") else "AIJ"


def matrix_parts(matrix):
    """The two local matrices of a distributed AIJ or BAIJ matrix.

    Parameters
    ----------
    matrix : PETSc.Mat
        Assembled, of one of these types, or of one that builds on AIJ.

    Returns
    -------
    list of int
        Handles of the sequential matrices: owned columns, and (several ranks) the other columns.
    """
    if matrix.getComm().size == 1:
        return [matrix.handle]
    own, other, columns = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()
    name = "MatMPI{0}GetSeq{0}".format(_storage(matrix))
    call(name, handle(matrix), *map(ctypes.byref, (own, other, columns)))
    return [own.value, other.value]


class local_values:  # noqa: N801
    """Context that lends the value arrays of a matrix's local parts, to be written in place.

    Parameters
    ----------
    matrix : PETSc.Mat
        Assembled AIJ or BAIJ matrix.
    sizes : sequence of int
        Number of nonzeros of each part.

    Notes
    -----
    Entering gives a list of two arrays (the second empty in serial). Leaving tells PETSc that the values changed.
    *Collective* (the matrix is assembled at the end).
    """

    def __init__(self, matrix, sizes):
        self.matrix, self.sizes = matrix, sizes
        self._functions = [f"MatSeq{_storage(matrix)}{verb}Array" for verb in ("Get", "Restore")]

    def __enter__(self):
        self.parts, self.pointers, arrays = matrix_parts(self.matrix), [], []
        for handle, size in zip(self.parts, self.sizes, strict=False):
            pointer = ctypes.POINTER(ctypes.c_double)()
            self._call(0, handle, pointer)
            self.pointers.append(pointer)
            arrays.append(np.ctypeslib.as_array(pointer, (size,)) if size else np.zeros(0))
        while len(arrays) < 2:
            arrays.append(np.zeros(0))
        return arrays

    def __exit__(self, *exc):
        for handle, pointer in zip(self.parts, self.pointers, strict=True):
            self._call(1, handle, pointer)
        self.matrix.assemble()
        return False

    def _call(self, which, handle, pointer):
        name = self._functions[which]
        call(name, ctypes.c_void_p(handle), ctypes.byref(pointer))


def preallocate_sell(matrix, own, other):
    """Tell a matrix of type sell how long its rows are, which petsc4py does not.

    Parameters
    ----------
    matrix : PETSc.Mat
    own, other : ndarray (n,)
        Entries of each owned row: in owned columns, and in others.
    """
    own, other = (np.ascontiguousarray(part, dtype=PETSc.IntType) for part in (own, other))
    own, other = ((int(part.max(initial=0)), part) for part in (own, other))
    call("MatSeqSELLSetPreallocation", handle(matrix), *own)
    call("MatMPISELLSetPreallocation", handle(matrix), *own, *other)


def known_types(make, names):
    """Those of some types of matrices or vectors that this PETSc has, whether or not the machine has what they need.

    Parameters
    ----------
    make : type
        ``PETSc.Mat`` or ``PETSc.Vec``.
    names : sequence of str
        Without ``seq`` or ``mpi``.
    """
    # the first one of a class fills the table of its types
    make().create(comm=MPI.COMM_SELF).destroy()
    table, found = ctypes.c_void_p.in_dll(_lib, f"{make.__name__}List"), ctypes.c_void_p()

    def known(name):
        call("PetscFunctionListFind_Private", table, name.encode(), ctypes.byref(found))
        return bool(found.value)

    return [name for name in names if known(f"seq{name}") or known(name)]


# [blocks] In a row of either local part of a matrix, from which on 3.18 cannot make its graph by itself: a buffer of
# `MatCreateGraph_Simple_AIJ`, which 3.19 allocates as long as it has to be
LONG = 4096
# place of `creategraph` among the operations of a matrix in 3.18, which its header does not name; its signature, and
# what PETSc calls an error in a library
_GRAPH, _GRAPH_TYPE, _ERR_LIB = 148, ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.c_int, ctypes.c_double, ctypes.c_void_p
), 76  # fmt: skip


def graph_of_long_rows(matrix, longest):
    """Have multigrid make the graph of a matrix whose rows may be long: that of its nodes. *Collective.*

    Parameters
    ----------
    matrix : PETSc.Mat
        AIJ, of dense blocks, with its pattern.
    longest : int
        Blocks in a row of a local part of it, at most.
    """
    if version >= (3, 19):
        return
    own = matrix.getAttr("graph")
    if own is None and matrix.getComm().tompi4py().allreduce(longest, op=MPI.MAX) < LONG:
        return
    if own is None:
        reference = weakref.ref(matrix)

        def make(_, symmetric, scaled, threshold, found):
            try:
                graph = graph_of_blocks(reference())
                code = _lib.MatCreateGraph(
                    ctypes.c_void_p(graph.handle), symmetric, scaled, ctypes.c_double(threshold), ctypes.c_void_p(found)
                )
                graph.destroy()
            except Exception:
                traceback.print_exc()
                return _ERR_LIB
            return code

        own = _GRAPH_TYPE(make)
        # it is called as long as there is the matrix
        matrix.setAttr("graph", own)
        call("MatSetOperation", handle(matrix), ctypes.c_int(_GRAPH), own)


def graph_of_blocks(matrix):
    """The matrix of the sums of what is in the blocks of another one, without signs. *Collective.*

    Parameters
    ----------
    matrix : PETSc.Mat
        AIJ, of dense blocks.

    Returns
    -------
    PETSc.Mat
        To be destroyed by the caller.
    """
    size, (n, total) = matrix.getBlockSize(), (part // matrix.getBlockSize() for part in matrix.getSizes()[0])
    rowptr, columns, values = matrix.getValuesCSR()
    count = np.diff(rowptr)[::size] // size
    first = np.concatenate([[0], np.cumsum(count)])
    row, parts = np.repeat(np.arange(n), count), np.abs(values).reshape(-1, size).sum(axis=1)
    at = np.arange(first[-1]) + (size - 1) * first[row]
    sums = sum(parts[at + k * count[row]] for k in range(size))
    nodes = columns.reshape(-1, size)[at, 0] // size
    csr = (first.astype(PETSc.IntType), nodes.astype(PETSc.IntType), sums)
    graph = PETSc.Mat().createAIJ(((n, total), (n, total)), csr=csr, comm=matrix.getComm())
    call("MatPropagateSymmetryOptions", handle(matrix), handle(graph))
    return graph


def keep_preconditioner(snes, keep):
    """Return whether the linear solves of SNES keep their preconditioner. To be called while the Jacobian is computed.

    Parameters
    ----------
    snes : PETSc.SNES
    keep : bool

    Notes ----- SNES itself tells its Krylov method after every Jacobian, by its lag; petsc4py does not reach the lag
    in all versions.
    """
    call("SNESSetLagPreconditioner", handle(snes), -1 if keep else 1)


def forget_pattern(ksp):
    """Have the preconditioner of a Krylov method take its matrix for a new one at its next set-up.

    Parameters
    ----------
    ksp : PETSc.KSP
        Its operators must be set again before it is used (SNES does so after every Jacobian).

    Notes
    -----
    A preconditioner knows a new pattern by a counter of the matrix. In 3.22 and 3.26 that counter starts at the same
    number whenever a distributed matrix is preallocated again, and factorisations and products of the old pattern
    would be filled with the new values, beyond their ends.
    """
    ksp.getPC().setOperators(None, None)


# what marks a communicator whose PETSc has one of its own for good
_KEPT = MPI.Comm.Create_keyval()


def keep_communicator(comm):
    """Keep the communicator that PETSc has of its own for one. *Collective.*

    PETSc gives it up with the last object on it, of which ranks let go at different times, above all after an
    exception. To make it anew is collective: a rank that has to would wait for ever for those that still have theirs.
    So is what PETSc does as it ends, with what was put aside there, but ranks that have none do not take part: it stays
    when Python lets go of everything.
    """
    if comm.Get_attr(_KEPT) is None:
        comm.Set_attr(_KEPT, True)
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(PETSc.Comm(comm).duplicate()))


def free_garbage(comm):
    """Destroy PETSc's objects that Python has let go of. *Collective.*

    Parameters
    ----------
    comm : MPI.Comm

    Notes
    -----
    Ranks let go of an object at different times, and its destruction is collective: petsc4py therefore only puts it
    aside (in 3.18 on one rank, too), and without this call the memory is never given back. Objects of one rank alone,
    such as the local parts of exchanges, are put aside elsewhere.
    """
    keep_communicator(comm)
    if hasattr(PETSc, "garbage_cleanup"):
        PETSc.garbage_cleanup(comm)
        PETSc.garbage_cleanup(MPI.COMM_SELF)


def reset_partitioner():
    """Make the graph partitioner forget earlier calls, whose random numbers PT-Scotch would continue."""
    reset = getattr(_lib, "SCOTCH_randomReset", None)
    if reset is not None:
        reset()


def set_section(dm, section):
    """Attach a local section to a DM (``setLocalSection`` since 3.19)."""
    (dm.setLocalSection if hasattr(dm, "setLocalSection") else dm.setSection)(section)


@contextmanager
def own_options():
    """While this lasts, PETSc has an options database of its own, empty at first, in the place of the present one.

    What was in that one before is neither seen nor changed. May be nested.
    """
    database = ctypes.c_void_p()
    call("PetscOptionsCreate", ctypes.byref(database))
    call("PetscOptionsPush", database)
    try:
        yield
    finally:
        call("PetscOptionsPop")
        call("PetscOptionsDestroy", ctypes.byref(database))


def _library():
    """The bytes of PETSc's library, in which its options are texts; None where the system does not say where it is."""
    try:
        with open("/proc/self/maps") as maps:
            path = next((line.split()[-1] for line in maps if "libpetsc" in line), None)
        with open(path or "", "rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError):
        return None


def unknown_options(names):
    """Those of some names that PETSc has no option for, each with the nearest one that it has, or None.

    Parameters
    ----------
    names : sequence of str
        With or without the prefix of a solver inside another one.

    Notes
    -----
    PETSc has no list of its options: a solver asks for its own when it is set up, some of them late. All of them are
    texts in its library, the last part of a name with a prefix as well as a name without one. A number at the end may
    have been put there.
    """
    library = _library() if names else None
    if library is None:
        return {}
    strange = [name for name in names if not _is_text_of_petsc(name)]
    there = {found.decode() for found in re.findall(rb"-([a-z][a-z0-9_]{3,})\0", library)} if strange else ()
    return {name: next(iter(difflib.get_close_matches(name, there, 1)), None) for name in strange}


@cache
def _is_text_of_petsc(name):
    """Return whether the name of an option is a text in PETSc's library, which is megabytes to look through."""
    library, parts = _library(), name.split("_")
    for k in range(len(parts)):
        rest = "_".join(parts[k:])
        text = f"-{rest}".encode()
        # one word alone is the end of many names
        if (k == 0 or "_" in rest) and library.find(text + b"\0") >= 0:
            return True
        if "_" in rest and rest[-1].isdigit() and library.find(text.rstrip(b"0123456789")) >= 0:
            return True
    return False


def option_used(name):
    """Return whether anything asked the options database for an option."""
    used = ctypes.c_int(0)
    call("PetscOptionsUsed", None, name.encode(), ctypes.byref(used))
    return bool(used.value)
