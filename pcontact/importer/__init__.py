"""Decks of other programs, and meshes, made into a scene with its mesh.

`cards` reads the keywords of a deck, in the coordinates of one mesh, `deck` makes a model of them that knows neither
program, `translate` (with `materials`, `contacts`, `tools`, `constraints`, `supports`, `steps`, `groups`) makes tables
of a scene of that, and keeps what became of every card.
"""
