"""The decorators of compiled kernels, and how often each was called."""

from collections import Counter

import numba
from numba.core.cpu import CPUTargetOptions
from numba.core.registry import CPUDispatcher

# calls from Python, by "module.function"; what a kernel calls itself is a part of it
CALLS = Counter()


class _Counted(CPUDispatcher):
    """A kernel that counts its calls: a third of a microsecond each."""

    def __call__(self, *arguments, **named):
        CALLS[self.title] += 1
        return super().__call__(*arguments, **named)


# numba's word for a function that does not count references to the arrays it handles; not all of its versions have it
UNCOUNTED = {"_nrt": False} if hasattr(CPUTargetOptions, "_nrt") else {}


def _compiled(**options):
    def decorate(function):
        kernel = numba.njit(cache=True, error_model="numpy", **options)(function)
        # numba makes its own class of dispatchers; this one is nothing but that, with another call
        kernel.__class__ = _Counted
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
