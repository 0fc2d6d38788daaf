"""The decorators of compiled kernels, and how often each was called."""

from collections import Counter
from functools import cached_property

import numba
from numba.core import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.cpu import CPUTargetOptions
from numba.core.registry import CPUDispatcher

from pcontact.runtime.compiling import timed
from pcontact.runtime.kernel_cache import cache_of

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
# For what is called at every point and does little. The code becomes part of the caller, and takes its arithmetic.
njit_inline = _compiled(inline="always")
