"""Reading of .msh files: those of today by the program itself, others, and .unv, after gmsh has translated them."""

import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

from pcontact.mesh.msh import read_msh
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import SCRIPTS

# A process of its own: gmsh may crash on a damaged file. An entity whose elements are of several groups, which versions
# before 4 may have, would get all groups for all elements.
_TRANSLATE = """
import sys
import gmsh
gmsh.initialize(readConfigFiles=False, interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
if gmsh.model.getNumberOfPartitions():
    gmsh.model.mesh.unpartition()
seen = set()
for dim, tag in gmsh.model.getPhysicalGroups():
    members = {(dim, abs(int(e))) for e in gmsh.model.getEntitiesForPhysicalGroup(dim, tag)}
    if sys.argv[3] == "old" and members & seen:
        raise SystemExit(f"elementary entity {min(members & seen)[1]} is in several physical groups")
    seen |= members
for name, value in (("Mesh.MshFileVersion", 4.1), ("Mesh.Binary", 1), ("Mesh.SaveAll", 1)):
    gmsh.option.setNumber(name, value)
gmsh.write(sys.argv[2])
"""
# datasets of groups that gmsh does not know, of which the newest has the same lines
_GROUPS = re.compile(rb"(?m)^( *-1 *\r?\n) *(?:2435|2452|2467) *(\r?)$")
# what a program started by mpirun must not take itself for
_LAUNCHER = ("PMIX_", "PMI_", "PRTE_", "OMPI_", "OPAL_", "MPI_", "HYDRA_")
# longest time [s] that gmsh may take to translate a file
_PATIENCE = 1800.0


def available():
    """Whether gmsh's Python module is installed."""
    return importlib.util.find_spec("gmsh") is not None


def read_gmsh(path):
    """Read a .msh file of any version.

    Parameters
    ----------
    path : Path

    Returns
    -------
    FileMesh

    Raises
    ------
    InputError
        The file is damaged, or gmsh is needed and not installed.
    """
    file = read_msh(path)
    if file is not None:
        return file
    if not available():
        words = path.read_bytes()[:1000].split()
        version = words[1].decode("latin-1") if words[0] == b"$MeshFormat" else "1"
        raise InputError(
            f"{path}: found version {version} of the format, or parts of a partition, without the Python package gmsh; "
            "allowed: version 2.1 to 2.2 and 4.1, or that package installed"
        )
    data = path.read_bytes()
    # gmsh takes a file for a script whose first line it does not know
    return _translated(path, data[max(data.find(b"$MeshFormat"), 0) :].lstrip())


def read_unv(path):
    """Read a universal file (I-DEAS, Salome), which gmsh translates; its groups are groups.

    Parameters
    ----------
    path : Path

    Returns
    -------
    FileMesh

    Raises
    ------
    InputError
        The file is damaged, or gmsh is not installed.
    """
    if not available():
        allowed = "another file type, or that package installed"
        raise InputError(f'{path}: needs the Python package "gmsh"; allowed: {allowed}')
    return _translated(path, _GROUPS.sub(rb"\g<1>  2477\2", path.read_bytes()))


@contextmanager
def apart(path, data=None):
    """A file as gmsh may open it, so that nothing runs: alone in a folder, for gmsh runs what has the same name and
    `.opt` behind it, and with an ending in small letters, for gmsh runs what it does not know by its ending.

    Parameters
    ----------
    path : Path
        A script of gmsh stays where it is: it is run anyway, and may speak of files beside it.
    data : bytes, optional
        What is in the file; absent: what is in that of `path`.

    Yields
    ------
    Path
    """
    if path.suffix.lower() in SCRIPTS:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"file{path.suffix.lower()}"
        if data is None:
            file.symlink_to(path.absolute())
        else:
            file.write_bytes(data)
        yield file


def _translated(path, data):
    """What gmsh reads out of the contents of a file."""
    words = data[:1000].split()
    old = "new" if words[:1] == [b"$MeshFormat"] and words[1:2] and words[1][:1] == b"4" else "old"
    with apart(path, data) as file:
        target = file.with_name("translated.msh")
        _convert(path, file, target, old)
        return read_msh(path, target)


def _convert(path, file, target, old):
    """Have gmsh write a file as one of version 4.1; messages have the name of the `path` that it is a copy of."""
    keep = {name: value for name, value in os.environ.items() if not name.startswith(_LAUNCHER)}
    # -P: no module of the working directory, which may be that of somebody's scene
    command = [sys.executable, "-P", "-c", _TRANSLATE, str(file), str(target), old]
    try:
        done = subprocess.run(
            command, env=keep, capture_output=True, text=True, errors="replace", timeout=_PATIENCE,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        reason = (done.stderr.strip().splitlines() or [""])[-1] if done.returncode else ""
        if done.returncode < 0:
            reason = f"it ends with signal {-done.returncode}"
        if done.returncode == 0 and target.is_file():
            return
    except (OSError, subprocess.TimeoutExpired) as error:
        reason = str(error)
    words = f"gmsh cannot read it: {reason or 'no reason given'}; allowed: a complete {path.suffix} file"
    raise InputError(f"{path}: {words}")
