"""Decks with lines lost, doubled, cut off or changed: each is imported, or refused with one message."""

import random

import pytest

from pcontact.importer.translate import import_file
from pcontact.runtime.errors import InputError
from tests.support.decks import BLOCKS, PAIR, STEEL, bricks

COUNT, SEEDS = 60, (1, 2)
WORDS = ("", "-1", "0", "1e30", "nan", "abc", "7.5", "ALL", "999999")
DECKS = (
    BLOCKS + PAIR + "*STEP\n*STATIC\n0.5, 1.\n*CLOAD\n105, 3, -100.\n*DLOAD\n1, P2, 1.\n*END STEP\n",
    bricks(((0, 0, 0), (1, 1, 1))) + STEEL + """
*NODE
9, 0.5, 0.5, 2.
*SURFACE, NAME=head
1, S2
*COUPLING, CONSTRAINT NAME=c, REF NODE=9, SURFACE=head
*KINEMATIC
*NODE
211, -1., -1., 0.
212, 2., -1., 0.
213, 2., 2., 0.
*ELEMENT, TYPE=R3D3, ELSET=r
9, 211, 212, 213
*RIGID BODY, ELSET=r, REF NODE=211
*SURFACE, NAME=tool
r, SPOS
*SURFACE, NAME=low
1, S1
*SURFACE INTERACTION, NAME=law
*CONTACT PAIR, INTERACTION=law
low, tool
*EQUATION
2
1, 1, 1., 2, 1, -1.
*STEP, NLGEOM
*STATIC
*BOUNDARY
9, 1, 6
*END STEP
""",
)  # fmt: skip


def mutated(text, chance):
    """A deck with one to three changes."""
    lines = text.splitlines()
    for _ in range(chance.randint(1, 3)):
        i, kind = chance.randrange(len(lines)), chance.randrange(5)
        if kind == 0:
            lines.insert(i, lines[chance.randrange(len(lines))])
        elif kind == 1 and len(lines) > 1:
            del lines[i]
        elif kind == 2:
            words = lines[i].split(",")
            words[chance.randrange(len(words))] = chance.choice(WORDS)
            lines[i] = ",".join(words)
        elif kind == 3:
            lines[i] = lines[i][: chance.randrange(len(lines[i]) + 1)]
        else:
            lines[i] += "," + chance.choice(("1", "x", "NAME=q", ""))
    return "\n".join(lines)


@pytest.mark.parametrize("seed", SEEDS)
def test_mutated_decks(tmp_path, seed):
    chance, taken = random.Random(seed), 0
    for _ in range(COUNT):
        (tmp_path / "deck.inp").write_text(mutated(chance.choice(DECKS), chance))
        try:
            taken += import_file(tmp_path / "deck.inp", tmp_path / "out") in (0, 1)
        except InputError as error:
            assert "\n" not in str(error)
    assert 0 < taken < COUNT
