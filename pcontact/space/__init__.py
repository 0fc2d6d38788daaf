"""Degrees of freedom: their numbers, which rank owns them, supports, and rigid motions of the bodies.

Knows the mesh; nothing of materials and of contact.
"""
