"""The error estimate: local problems on cells, recovered stresses, and the cell sizes of a better mesh.

Knows the stresses of bodies and contact pairs at a solution, and changes nothing of it.
"""
