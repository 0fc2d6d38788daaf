"""The ground floor: PETSc and the differences between its versions, MPI, options, messages, log, profile, signals,
files, and the compilation of kernels.

Knows nothing of mechanics; every other package may use it.
"""
