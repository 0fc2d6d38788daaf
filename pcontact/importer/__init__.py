"""Decks of other programs, and meshes, made into a scene with its mesh.

`cards` reads the keywords of a deck, `deck` makes a model of them that knows neither program, `translate` (with
`history`, `supports`, `groups`) makes tables of a scene of that, `findings` keeps what became of every card.
"""
