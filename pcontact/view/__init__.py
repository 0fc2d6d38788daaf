"""Pictures, windows, pages and animations of the results of a run: VTK draws, by pyvista.

Reads what `io` has written and is used by nothing that computes: only here is VTK imported, and matplotlib with it,
when the first picture is asked for.
"""
