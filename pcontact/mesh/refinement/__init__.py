"""Refinement on any number of ranks: cells are cut where they are wanted smaller, others as far as they must follow.

Every refined mesh is made anew from the mesh of the file, the base. Knows the rest of `pcontact.mesh`; of fields, their
values at nodes.
"""
