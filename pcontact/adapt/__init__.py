"""The loop that reaches an error: runs a scene on one mesh after the other, refined where the estimate says it pays.

Knows whole runs (`pcontact.simulation`) and what they say of their errors; nothing below knows of it.
"""
