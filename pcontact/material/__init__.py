"""Elasticity and von Mises plasticity at a point: moduli, hardening, return mapping and consistent tangent.

Arrays only: knows neither meshes nor MPI nor PETSc.
"""
