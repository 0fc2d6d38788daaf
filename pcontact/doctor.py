"""``pcontact doctor``: what is installed, how fast this machine is, and what to do."""

import os
import platform
import sys
import tempfile
import time as clock
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from pcontact.io.examples import write_template
from pcontact.runtime import log
from pcontact.runtime.errors import InputError
from pcontact.runtime.petsc import MPI, has_package
from pcontact.runtime.petsc import version as petsc_version
from pcontact.scene.reader import read_scene
from pcontact.simulation import Simulation
from pcontact.view import extra

_NEEDED = ("numpy", "numba", "mpi4py", "petsc4py", "h5py", "tqdm")
_OPTIONAL = {
    "meshio": "reads meshes that are no .msh", "gmsh": "makes meshes",
    "matplotlib": "curves of `pcontact plot`", "pyvista": "pictures; `pcontact view` says how to install it",
    "pandas": "tables in Python",
}  # fmt: skip
_SOLVERS = {
    "mumps": "direct solver for several ranks: hard scenes fall back on it", "hypre": "another multigrid",
    "ml": "another multigrid", "ptscotch": "graph partitioner",
}  # fmt: skip
_TRIAD = 20_000_000  # [numbers] of each of three vectors: beyond all caches


def examine():
    """Find out. *Collective*: rank 0 looks, all solve.

    Returns
    -------
    list of str
        Lines to show.
    """
    lines = [f"python {platform.python_version()} ({sys.executable}), {platform.platform()}"]
    library = MPI.Get_library_version().splitlines()[0].strip("\0")
    petsc = ".".join(map(str, petsc_version))
    lines.append(f"PETSc {petsc}, {library}, {MPI.COMM_WORLD.size} ranks, {os.cpu_count()} cores")
    advice = []
    for name in _NEEDED:
        found = _version(name)
        lines.append(f"  {name:<12} {found or 'missing'}")
        if found is None:
            advice.append(f"install {name}: . scripts/env.sh does it, or pip install {name}")
    for name, use in _OPTIONAL.items():
        lines.append(f"  {name:<12} {_version(name) or 'missing'}{'' if _version(name) else f': {use}'}")
    for name, use in _SOLVERS.items():
        there = has_package(name)
        lines.append(f"  {name:<12} {'in PETSc' if there else f'not in PETSc: {use}'}")
        if name == "mumps" and not there and MPI.COMM_WORLD.size > 1:
            advice.append("a PETSc with MUMPS helps where multigrid does not converge on several ranks")
    if not extra.missing():
        try:
            extra.prepare_off_screen()
            lines.append(f"pictures without a display: {os.environ.get('VTK_DEFAULT_OPENGL_WINDOW', 'by the display')}")
        except InputError as problem:
            advice.append(str(problem))
    if MPI.COMM_WORLD.size > (os.cpu_count() or 1):
        advice.append("there are more ranks than cores: export OMPI_MCA_mpi_yield_when_idle=1, or take fewer")
    lines.append(f"memory bandwidth of rank 0: {_bandwidth():.1f} GB/s (triad)")
    lines.append(_solved())
    return [*lines, *(f"to do: {line}" for line in advice)] + ["all that a run needs is there"] * (not advice)


def _version(name):
    try:
        return version(name)
    except PackageNotFoundError:
        module = sys.modules.get(name)
        if module is None:
            try:
                module = __import__(name)
            except ImportError:
                return None
        return getattr(module, "__version__", "there")


def _bandwidth():
    """Of a = b + c [GB/s], the best of three."""
    a, b, c = (np.ones(_TRIAD) for _ in range(3))
    best = np.inf
    for _ in range(3):
        start = clock.perf_counter()
        np.add(b, c, out=a)
        best = min(best, clock.perf_counter() - start)
    return 3 * a.nbytes / best / 1e9


def _solved():
    """The scene of `pcontact new`, run without files; twice, since the first run compiles."""
    comm = MPI.COMM_WORLD
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(comm.bcast(scratch))
        path = Path(comm.bcast(str(write_template(folder / "new")) if comm.rank == 0 else None))
        seconds = []
        for _ in range(2):
            start = clock.perf_counter()
            with log.quiet():
                simulation = Simulation(read_scene(path))
                unknowns, converged = simulation.problem.space.n_dofs, simulation.run()
                simulation.close()
            seconds.append(clock.perf_counter() - start)
        comm.Barrier()
    state = "" if converged else ", which did not converge"
    first, second = seconds
    return f"the scene of `pcontact new`: {unknowns} unknowns in {second:.1f} s{state}; the first time {first:.1f} s"
