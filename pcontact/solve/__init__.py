"""The nonlinear problem of a load step and its solution: the sum of all items, Newton's method and its line search,
Krylov's method and preconditioners.

Asks items by their base class; knows no load steps before this one, and nothing of files.
"""
