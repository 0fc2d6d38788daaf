"""Compiled kernels: their decorators, how often each was called, the messages of their compilation, and one cache of
each user, on disk, by what the sources say.

A kernel lies in a directory that is called after its module and a checksum of the module and of all that it imports
from: the code of a kernel contains that of the kernels it calls, and the values of the constants it names. Neither the
date of a file nor its place counts: another copy of the program, or one that goes back to an earlier revision, finds
what it had compiled. Of several processes that need a kernel, one compiles it under a lock, and the others load it.
"""

import fcntl
import gc
import hashlib
import os
import pickle
import re
import resource
import shutil
import sys
import threading
import time as clock
import zlib
from collections import Counter
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from pathlib import Path

import numba
from numba.core import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.cpu import CPUTargetOptions
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys

from pcontact.runtime import log

# [s] How often the line of a terminal changes. From: chosen; somebody who looks at it sees that it goes on.
ON_TERMINAL = 0.5

# [-] Numbers of new objects after which Python looks for cycles, while kernels are compiled. From: scenes in the plane:
# with its own, 700, it spends 12 % of a compilation on that, with these 7 %, for 16 MB.
CYCLES = 20_000, 10, 10


class _State:
    """Of this process: seconds, bytes and kernels so far; whether one is compiled, since when; what was said."""

    seconds, bytes, kernels, busy, start, said, told_at, teller = 0.0, 0, 0, False, 0.0, False, 0.0, None


def seconds():
    """Seconds that this process has compiled kernels so far, or waited for another one that did."""
    return _State.seconds


def memory():
    """Return the growth of this process so far where it compiled or loaded kernels [byte]."""
    return _State.bytes


def resident():
    """Present resident set of this process [byte]; 0 if the system does not say it."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except OSError:
        return 0


def missed(folder):
    """A kernel is compiled, and kept in a folder (None: it is not kept). It is said once."""
    if not _State.said:
        _State.said = True
        kept = "" if folder is None else f", the first run of this kind on this machine; they are kept in {folder}"
        log.notice(f"compiling kernels{kept}")
    _State.kernels += 1
    if _State.busy and _State.teller is None:
        _State.teller = _Teller()


class _Teller(threading.Thread):
    """Says that it goes on while this process is busy: a kernel takes up to ten seconds, without a word of Python."""

    def __init__(self):
        super().__init__(daemon=True)
        self._line, self._end = log.Line(), threading.Event()
        self._say()
        self.start()

    def run(self):
        """Tell until the end."""
        while not self._end.wait(ON_TERMINAL):
            self._say()

    def _say(self):
        took = _State.seconds + clock.perf_counter() - _State.start
        text = f"compiling kernels: {_State.kernels} in {took:.0f} s"
        self._line.say(text)
        if not self._line.shown and took - _State.told_at >= log.IN_FILE:
            _State.told_at = took
            log.info("%s", text)

    def close(self):
        """Say no more."""
        self._end.set()
        self.join()
        self._line.close()


@contextmanager
def timed():
    """Count the seconds inside, if kernels are compiled there, and the bytes."""
    if _State.busy:
        yield
        return
    _State.start, _State.busy, own, before = clock.perf_counter(), True, gc.get_threshold(), resident()
    gc.set_threshold(*CYCLES)
    try:
        yield
    finally:
        _State.busy = False
        gc.set_threshold(*own)
        _State.bytes += resident() - before
        if _State.teller is not None:
            _State.seconds += clock.perf_counter() - _State.start
            _State.teller.close()
            _State.teller = None


# where modules lie whose kernels others call; of these packages, one module alone has a part in kernels
PACKAGE, FOREIGN, OWN = Path(__file__).resolve().parents[1], ("runtime.",), "runtime.jit"
IMPORT = re.compile(r"^[ \t]*from[ \t]+([\w.]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
# [-] Versions of a module whose kernels are kept. From: chosen; a few branches and what was before them.
VERSIONS = 8
NO_PLACE = "the user's cache cannot be written to"


class _Uncached:
    """Reason for which compiled kernels are not kept on disk; None if they are."""

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
            missed(folder())
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
        missed(None)

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


# calls from Python, by "module.function"; what a kernel calls itself is a part of it
CALLS = Counter()


class _Flags(Flags):
    """Options of a compilation. numba compares them at each call of a function of its own: a seventh of all time, the
    way it does so."""

    _DEFAULTS = {name: option.default for name, option in Flags.options.items()}
    _HASH = hash(Flags())

    def __eq__(self, other):
        return self._values == other._values or self._DEFAULTS | self._values == self._DEFAULTS | other._values

    def __hash__(self):
        return self._HASH


# whether what kernels call is compiled by itself: earlier versions of numba have other libraries of code
PARTS = numba.version_info.short >= (0, 62)


class _KernelLibrary(JITCodeLibrary):
    """Code of a kernel."""

    def _optimize_functions(self, ll_module):
        """Each that has a body. numba sets up the same passes anew for each name, of functions elsewhere, too: a
        twentieth of a compilation."""
        ll_module.data_layout = self._codegen._data_layout
        passes = self._codegen._function_pass_manager()
        for function in ll_module.functions:
            if not function.is_declaration:
                passes[0].run(function, passes[1])


class _KernelCompiler(Compiler):
    _library = _KernelLibrary

    def __init__(self, typingctx, targetctx, library, args, return_type, flags, locals):
        if PARTS:
            library = self._library(targetctx.codegen(), "kernel")
            library.enable_object_caching()
        super().__init__(typingctx, targetctx, library, args, return_type, _Flags(flags), locals)


class _PartLibrary(_KernelLibrary):
    """Code that goes into the kernels that call it: they optimise it and make it machine code, once for all."""

    @property
    def codegen(self):
        return self

    def set_env(self, env_name, env):
        """Nothing: objects of Python have no part in kernels."""

    def _optimize_final_module(self):
        """Once, that callers see how small it is; they do it thoroughly."""
        codegen = self._codegen
        passes = codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=codegen._opt_level, cost="cheap"
        )
        # its builder comes along in later versions of numba
        passes, *builder = passes if isinstance(passes, tuple) else (passes,)
        passes.run(self._final_module, *builder)

    def _finalize_final_module(self):
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name):
        """None: Python does not call it."""
        self._ensure_finalized()
        return 0

    def serialize_using_object_code(self):
        """There is none."""
        return self.serialize_using_bitcode()


class _PartCompiler(_KernelCompiler):
    _library = _PartLibrary


# of what only kernels call: nothing by which Python calls it
PART = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": _PartCompiler}


def _plain(kind):
    """Type of an argument without its value: a constant in a call makes no copy of the kernel that is called."""
    if isinstance(kind, types.BaseAnonymousTuple):
        return types.Tuple([_plain(one) for one in kind])
    return types.unliteral(kind)


class _Kernel(CPUDispatcher):
    """A kernel, kept on disk."""

    @cached_property
    def _cache(self):
        """Cache that keeps it: of several hundred kernels a run calls a few dozen."""
        return cache_of(self.py_func)

    def compile(self, sig):
        with timed(), self._cache.held():
            return super().compile(sig)


class _Counted(_Kernel):
    """A kernel that counts its calls from Python: a third of a microsecond each."""

    def __call__(self, *arguments, **named):
        CALLS[self.title] += 1
        return super().__call__(*arguments, **named)

    @property
    def _apart(self):
        return PARTS and "inline" not in self.options

    @cached_property
    def _part(self):
        """The same for kernels that call it."""
        part = numba.njit(**self.options, **PART)(self.py_func)
        part.__class__ = _Kernel
        part._cache = cache_of(self.py_func, part=True)
        return part

    def get_call_template(self, args, kws):
        """Tell numba the types of a call in a kernel."""
        if not self._apart:
            return super().get_call_template(args, kws)
        return self._part.get_call_template([_plain(one) for one in args], {k: _plain(v) for k, v in kws.items()})

    def get_overload(self, sig):
        """Give numba the code of a call in a kernel."""
        return self._part.get_overload(sig) if self._apart else super().get_overload(sig)


# numba's word for a function that does not count references to the arrays it handles; not all of its versions have it
UNCOUNTED = {"_nrt": False} if hasattr(CPUTargetOptions, "_nrt") else {}


def _compiled(**options):
    # error_model="numpy": a division by zero gives inf, not an exception, and the loops vectorise
    options = {"error_model": "numpy", **options}
    # nobody calls kernels from C; numba writes, optimises and compiles a function for that: an eighth of a compilation
    unwanted = {} if "inline" in options else {"no_cfunc_wrapper": True}

    def decorate(function):
        kernel = numba.njit(**options, **unwanted, pipeline_class=_KernelCompiler)(function)
        # numba makes its own class of dispatchers; this one is nothing but that, with another call
        kernel.__class__ = _Counted
        del kernel.__dict__["_cache"]
        kernel.options = options
        kernel.title = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
        return kernel

    return decorate


FAST = {"contract", "reassoc", "nsz", "arcp"}
njit = _compiled(fastmath=FAST)
# said explicitly: what is not said is taken over from the kernel that calls first
njit_exact = _compiled(fastmath=False)
# For what kernels call, or all of a kernel but the scratch arrays it makes: may make none itself. To count the
# references of every array that is handed over, or of which a row is taken, takes longer than a few operations: half of
# the time of a search.
njit_inner = _compiled(fastmath=FAST, **UNCOUNTED)
njit_inner_exact = _compiled(fastmath=False, **UNCOUNTED)
# For what is called at every point and does much, in kernels that take most of the time: a call that hands over all
# scratch arrays of a cell takes longer than what is computed after it. The compiler has more to do.
njit_within = _compiled(fastmath=FAST, forceinline=True, **UNCOUNTED)
njit_within_exact = _compiled(fastmath=False, forceinline=True, **UNCOUNTED)
# For what is called at every point and does little. The code becomes part of the caller, and takes its arithmetic.
njit_inline = _compiled(inline="always")
