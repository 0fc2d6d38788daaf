"""Compiled kernels kept on disk: one cache of each user, by what the sources say.

A kernel lies in a directory that is called after its module and a checksum of the module and of all that it imports
from: the code of a kernel contains that of the kernels it calls, and the values of the constants it names. Neither the
date of a file nor its place counts: another copy of the program, or one that goes back to an earlier revision, finds
what it had compiled. Of several processes that need a kernel, one compiles it under a lock, and the others load it.
"""

import fcntl
import hashlib
import os
import pickle
import re
import shutil
import sys
import zlib
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache
from numba.core.runtime import rtsys

from pcontact.runtime import compiling, log

# where modules lie whose kernels others call; of these packages, one module alone has a part in kernels
PACKAGE, FOREIGN, OWN = Path(__file__).resolve().parents[1], ("runtime.",), "runtime.jit"
IMPORT = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
# [-] Versions of a module whose kernels are kept. From: chosen; a few branches and what was before them.
VERSIONS = 8
NO_PLACE = "the user's cache cannot be written to"


class _Uncached:
    """Why compiled kernels are not kept on disk; None if they are."""

    reason = None


def tell_uncached():
    """Warn of kernels that every run has to compile anew, if there is no place to keep them."""
    if _Uncached.reason is None and not can_keep(folder()):
        _Uncached.reason = NO_PLACE
    if _Uncached.reason is not None:
        log.warning(
            "compiled kernels cannot be kept (%s): every run compiles them anew, for half a minute; NUMBA_CACHE_DIR "
            "names a directory for them",
            _Uncached.reason,
        )  # fmt: skip


def folder():
    """The directory of all kernels: NUMBA_CACHE_DIR, or one in the user's cache."""
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(numba.config.CACHE_DIR or os.path.join(base, "pcontact", "numba")).expanduser()


@cache
def can_keep(path):
    """Return whether the directory of all kernels is there, or can be made, for this user alone."""
    with suppress(OSError):
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    return path.is_dir()


@cache
def _file_of(module):
    """The source of a module of this package, by its name below the package; None if there is none."""
    path = PACKAGE.joinpath(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


@cache
def _read(path):
    """Checksum of a source, and the modules of this package from which it imports names."""
    text = path.read_text(encoding="utf-8")
    found, prefix = set(), f"{PACKAGE.name}."
    for module, names in IMPORT.findall(text):
        if f"{module}.".startswith(prefix):
            home = module[len(prefix) :]
            found.add(home)
            found |= {f"{home}.{name}".lstrip(".") for name in re.findall(r"\w+", names)}
    known = {name for name in found if name and _file_of(name) is not None}
    return zlib.crc32(text.encode()), {name for name in known if name == OWN or not name.startswith(FOREIGN)}


@cache
def sources(path):
    """Checksums of all modules of this package that a source imports from, directly or not, by name.

    Parameters
    ----------
    path : pathlib.Path

    Returns
    -------
    dict of str to int
    """
    found, left = {}, list(_read(path)[1])
    while left:
        name = left.pop()
        if name not in found:
            found[name], more = _read(_file_of(name))
            left += more
    return found


@cache
def _stamp(path):
    """Return what kernels of a source depend on, as sixteen letters."""
    parts = numba.__version__, sys.version_info[:3], path.read_bytes(), sorted(sources(path).items())
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def directories():
    """Names of the directories, there or not, of the kernels of all modules of the program as it is."""
    files = {file.relative_to(PACKAGE).with_suffix("").parts: file for file in PACKAGE.rglob("*.py")}
    return sorted(f"{'.'.join((PACKAGE.name, *parts))}-{_stamp(file)}" for parts, file in files.items())


def count():
    """Compiled kernels that are kept, of all versions of the program."""
    return sum(1 for _ in folder().glob("*/*.nbc"))


class _Locator:
    """The directory of the kernels of a module, by its content; the class that numba has for it changes its name."""

    def __init__(self, py_func, py_file):
        self._module, self._line = py_func.__module__, py_func.__code__.co_firstlineno
        self._cache_path = str(folder() / f"{self._module}-{_stamp(Path(py_file))}")

    @classmethod
    def from_function(cls, py_func, py_file):
        """None: there is no such source, as of what is typed in, or no place to keep anything."""
        if not os.path.isfile(py_file) or not can_keep(folder()):
            return None
        return cls(py_func, py_file)

    def get_cache_path(self):
        """The directory."""
        return self._cache_path

    def ensure_cache_path(self):
        """Nothing: it is made with the first kernel."""

    def make(self):
        """Make the directory; those of versions long ago go."""
        path = Path(self._cache_path)
        path.mkdir(exist_ok=True)
        versions = sorted(path.parent.glob(f"{self._module}-*"), key=lambda one: one.stat().st_mtime)
        for old in versions[:-VERSIONS]:
            shutil.rmtree(old, ignore_errors=True)

    def get_source_stamp(self):
        """None: the directory says it."""

    def get_disambiguator(self):
        """The line on which the kernel begins."""
        return str(self._line)


class _Kept(CompileResultCacheImpl):
    _locator_classes = (_Locator,)


class _KeptPart(_Kept):
    """Part that kernels call, which lies beside a kernel of the same name that Python calls."""

    def get_filename_base(self, fullname, abiflags):
        return f"{super().get_filename_base(fullname, abiflags)}-part"


class _Cache(FunctionCache):
    """Kernels kept on disk, unless the disk is full; what was cut off is none."""

    _impl_class = _Kept
    _lock = None

    def load_overload(self, sig, target_context):
        """A kernel that was kept, or None: then it is for this process to compile it."""
        found = self._load(sig, target_context)
        if found is None:
            compiling.missed(folder())
            self._wait()
            found = self._load(sig, target_context)
        return found

    def _load(self, sig, target_context):
        try:
            # numba loads what it compiles with before each kernel, a tenth of a second: machine code needs this alone
            rtsys.initialize(target_context)
            with self._guard_against_spurious_io_errors():
                return self._load_overload(sig, target_context)
        except (AttributeError, ImportError, pickle.UnpicklingError, EOFError, ValueError, TypeError, KeyError):
            # names of types that this version does not have, or a file that was cut off
            with suppress(OSError):
                self.flush()
            return None

    def _wait(self):
        """Lock the kernel. On a file system without locks, or one that is full, several processes compile it."""
        with suppress(OSError):
            self._impl.locator.make()
            self._lock = os.open(Path(self.cache_path) / f"{self._impl.filename_base}.lock", os.O_RDWR | os.O_CREAT)
            fcntl.flock(self._lock, fcntl.LOCK_EX)

    @contextmanager
    def held(self):
        """While this lasts, the kernel is loaded, or compiled and kept."""
        try:
            yield
        finally:
            if self._lock is not None:
                os.close(self._lock)
                self._lock = None

    def save_overload(self, sig, data):
        """Keep a kernel."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            if _Uncached.reason is None:
                _Uncached.reason = (error.strerror or str(error)).lower()
                tell_uncached()


class _PartCache(_Cache):
    _impl_class = _KeptPart


class _Nowhere(NullCache):
    """No cache."""

    def load_overload(self, sig, target_context):
        """None."""
        compiling.missed(None)

    @contextmanager
    def held(self):
        """Nothing."""
        yield


def cache_of(function, part=False):
    """The cache of a kernel.

    Parameters
    ----------
    function : callable
        That is compiled.
    part : bool
        Whether kernels alone call it.
    """
    try:
        return (_PartCache if part else _Cache)(function)
    except RuntimeError:
        _Uncached.reason = NO_PLACE
        return _Nowhere()
