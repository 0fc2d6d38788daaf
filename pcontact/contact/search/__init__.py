"""Searches: who is the partner of a point of the source.

Knows surfaces, space and the exchange between ranks; nothing of tractions, laws and formulations.
"""
