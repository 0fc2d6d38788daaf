"""Reference cells: shape functions, quadrature, geometry maps, traces on facets, mean dilatation.

Arrays only: knows neither meshes nor MPI nor PETSc.
"""
