"""The two sides of a contact pair: facets, their maps and normals, quadrature points, rigid obstacles.

Knows meshes, space and the exchange between ranks; nothing of searches, tractions, laws and formulations.
"""
