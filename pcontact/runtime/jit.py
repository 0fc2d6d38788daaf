"""The one decorator of every compiled kernel."""

import numba

# error_model="numpy": a division by zero gives inf, not an exception, and the loops vectorise
njit = numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
njit_exact = numba.njit(cache=True, error_model="numpy")
