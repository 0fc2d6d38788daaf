"""The stress of the source at its points: linear elasticity, and what yielding cells add to it.

Knows bulk items and materials; nothing of gaps, partners and laws.
"""
