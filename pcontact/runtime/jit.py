"""The decorators of compiled kernels, and how often each was called."""

from collections import Counter

import numba
from numba.core.registry import CPUDispatcher

# calls from Python, by "module.function"; what a kernel calls itself is a part of it
CALLS = Counter()


class _Counted(CPUDispatcher):
    """A kernel that counts its calls: a third of a microsecond each."""

    def __call__(self, *arguments, **named):
        CALLS[self.title] += 1
        return super().__call__(*arguments, **named)


def _compiled(**options):
    def decorate(function):
        kernel = numba.njit(cache=True, error_model="numpy", **options)(function)
        # numba makes its own class of dispatchers; this one is nothing but that, with another call
        kernel.__class__ = _Counted
        kernel.title = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
        return kernel

    return decorate


# error_model="numpy": a division by zero gives inf, not an exception, and the loops vectorise
njit = _compiled(fastmath={"contract", "reassoc", "nsz", "arcp"})
# said explicitly: what is not said is taken over from the kernel that calls first
njit_exact = _compiled(fastmath=False)
# For what is called at every point and does little: a call takes longer than a few operations, since numba counts the
# references of every array handed over. The code becomes part of the caller, and takes its arithmetic.
njit_inline = _compiled(inline="always")
