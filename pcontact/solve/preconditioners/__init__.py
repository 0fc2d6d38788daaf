"""What precedes Krylov's method: multigrid around a direct solve of what contact makes stiff, deflation of the rigid
motions of loose bodies, and the direct solver that takes over where multigrid fails.

Knows matrices, the space and PETSc; nothing of Newton's method and of contact but which unknowns it makes stiff.
"""
