"""The mesh: readers of its formats, checks, completion to degree 2, refinement, partition, distribution over the ranks.

Knows reference cells and MPI; nothing of materials, scenes and displacements.
"""
