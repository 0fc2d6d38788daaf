"""Input and output of a run beside its mesh: fields, history, report, checkpoint; most of it as observers
of the load steps.

Asks items by their base class and the problem for its state; never changes either.
"""
