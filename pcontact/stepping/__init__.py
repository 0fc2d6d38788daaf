"""Load steps: the schedule, the attempt at one and its cut back, updates of multipliers and searches around Newton's
method, the places of loose bodies.

The only package that commits a state; tells observers what has happened, and writes nothing itself.
"""
