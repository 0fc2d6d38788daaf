"""Contact pairs: a pair is a search, a traction, a formulation and a law, put together as one item (`pair.py`).

Knows what the assembly of bodies knows, and the exchange between ranks; nothing of Newton's method and load steps.
"""
