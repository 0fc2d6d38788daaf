"""Source facets cut where their partner changes, so that quadrature rules straddle no kink of the target.

Knows surfaces and searches; nothing of tractions, laws and formulations.
"""
