"""Formulations of contact: the terms at the points of a pair, with and without friction, and what stands in them.

Kernels, and classes around them that hand over arrays; knows tractions and laws, nothing of searches.
"""
