"""The decorators of compiled kernels, and how often each was called."""

import pickle
import re
import zlib
from collections import Counter
from contextlib import suppress
from functools import cache
from pathlib import Path

import numba
from numba.core.caching import FunctionCache
from numba.core.cpu import CPUTargetOptions
from numba.core.registry import CPUDispatcher

from pcontact.runtime import log

# where modules lie whose kernels others call; of these packages, one module alone has a part in kernels
PACKAGE, FOREIGN, OWN = Path(__file__).resolve().parents[1], ("runtime.",), "runtime.jit"
IMPORT = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)

# calls from Python, by "module.function"; what a kernel calls itself is a part of it
CALLS = Counter()


class _Uncached:
    """Why compiled kernels are not kept on disk; None if they are."""

    reason = None


def tell_uncached():
    """Warn of kernels that every run has to compile anew, if there is no place to keep them."""
    if _Uncached.reason is not None:
        log.warning(
            "compiled kernels cannot be kept (%s): every run compiles them anew, for half a minute; NUMBA_CACHE_DIR "
            "names a directory for them",
            _Uncached.reason,
        )  # fmt: skip


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

    The code of a kernel contains that of the kernels it calls, and the values of the constants it names.

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


class _Cache(FunctionCache):
    """Kernels kept on disk, unless the disk is full; what another version left and this one cannot read is none."""

    def __init__(self, function):
        """Kernels are those of a source and of what it imports from, whereas numba looks at the one file only."""
        super().__init__(function)
        path = Path(function.__code__.co_filename)
        # what is typed in has no source
        called = sorted(sources(path).items()) if path.is_file() else []
        stamp = zlib.crc32(repr(called).encode())
        self._cache_file._source_stamp = (self._cache_file._source_stamp, stamp)

    def load_overload(self, sig, target_context):
        """A kernel that was kept, or None."""
        try:
            return super().load_overload(sig, target_context)
        except (AttributeError, ImportError, pickle.UnpicklingError, EOFError, ValueError, TypeError, KeyError):
            # names of types that this version does not have, or a file that was cut off
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig, data):
        """Keep a kernel."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            if _Uncached.reason is None:
                _Uncached.reason = (error.strerror or str(error)).lower()
                tell_uncached()


class _Counted(CPUDispatcher):
    """A kernel that counts its calls: a third of a microsecond each."""

    def enable_caching(self):
        """Keep the kernel beside its source or in the user's cache; go without if neither can be written."""
        try:
            self._cache = _Cache(self.py_func)
        except RuntimeError:
            _Uncached.reason = "neither the installation nor the user's cache can be written to"

    def __call__(self, *arguments, **named):
        CALLS[self.title] += 1
        return super().__call__(*arguments, **named)


# numba's word for a function that does not count references to the arrays it handles; not all of its versions have it
UNCOUNTED = {"_nrt": False} if hasattr(CPUTargetOptions, "_nrt") else {}


def _compiled(**options):
    def decorate(function):
        kernel = numba.njit(error_model="numpy", **options)(function)
        # numba makes its own class of dispatchers; this one is nothing but that, with another call
        kernel.__class__ = _Counted
        kernel.enable_caching()
        kernel.title = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
        return kernel

    return decorate


FAST = {"contract", "reassoc", "nsz", "arcp"}
# error_model="numpy": a division by zero gives inf, not an exception, and the loops vectorise
njit = _compiled(fastmath=FAST)
# said explicitly: what is not said is taken over from the kernel that calls first
njit_exact = _compiled(fastmath=False)
# For what kernels call, or all of a kernel but the scratch arrays it makes: may make none itself. To count the
# references of every array that is handed over, or of which a row is taken, takes longer than a few operations: half of
# the time of a search.
njit_inner = _compiled(fastmath=FAST, **UNCOUNTED)
njit_inner_exact = _compiled(fastmath=False, **UNCOUNTED)
# For what is called at every point and does little. The code becomes part of the caller, and takes its arithmetic.
njit_inline = _compiled(inline="always")
