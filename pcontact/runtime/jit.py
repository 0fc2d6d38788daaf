"""The decorators of compiled kernels."""

import numba

# error_model="numpy": a division by zero gives inf, not an exception, and the loops vectorise
njit = numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
# said explicitly: what is not said is taken over from the kernel that calls first
njit_exact = numba.njit(cache=True, error_model="numpy", fastmath=False)
# For what is called at every point and does little: a call takes longer than a few operations, since numba counts the
# references of every array handed over. The code becomes part of the caller, and takes its arithmetic.
njit_inline = numba.njit(cache=True, error_model="numpy", inline="always")
