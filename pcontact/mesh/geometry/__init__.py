"""The geometry that a mesh was made of: on which of its curves and surfaces nodes belong, and how they get there.

gmsh reads the geometry; only meshes whose scene names one come here. Knows the rest of `pcontact.mesh`.
"""
