"""Frictional contact between elastic bodies with Nitsche's method, in parallel on PETSc."""

__version__ = "0.1.0"
