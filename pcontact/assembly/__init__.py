"""Sums over the cells: the pattern and values of the sparse matrix, elastic and plastic bodies, loads, error norms;
and `Item`, the base class of all that adds terms to residual and tangent.

Knows the space, the mesh, reference cells and materials; nothing of contact and of how equations are solved.
"""
