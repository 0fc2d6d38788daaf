"""Decks: keywords, continued lines, included files, sets, faces, and what is wrong with them."""

import pytest

from pcontact.importer.deck import read_deck
from pcontact.runtime.errors import InputError

SQUARE = """*node, nset=ALL
1, 0, 0
2, 1d0, 0
3, 1, 1.
4, , 1
*element, type=CPE4,
 elset=Square
1, 1, 2,
3, 4
"""


def deck(tmp_path, text):
    (tmp_path / "deck.inp").write_text(text)
    return read_deck(tmp_path / "deck.inp")


def test_keywords_and_lines_go_on(tmp_path):
    found = deck(tmp_path, "** a comment\n" + SQUARE + "*Nset, NSET = some, generate\n1, 4, 2\n*NSET,NSET=SOME\nall,\n")
    assert found.nodes[2] == [1.0, 0.0, 0.0] and found.nodes[4] == [0.0, 1.0, 0.0]
    assert found.elements == {1: ("quad", [1, 2, 3, 4])} and found.element_sets["SQUARE"] == [1]
    assert found.node_sets["SOME"] == [1, 3, 2, 4] and found.spelling["SOME"] == "some"
    assert [str(card.place) for card in found.cards] == ["line 2", "line 7", "line 11", "line 13"]


def test_the_last_of_two_counts(tmp_path):
    """Which is told where they differ."""
    found = deck(tmp_path, SQUARE + "*NODE\n1, 0, 0\n2, 1, 5\n*ELEMENT, TYPE=CPE4\n1, 1, 2, 3, 4\n1, 2, 3, 4, 1\n")
    assert found.nodes[2] == [1.0, 5.0, 0.0] and found.elements == {1: ("quad", [2, 3, 4, 1])}
    assert [(str(place), words.split()[0]) for _, place, words in found.again] == [("line 12", "2"), ("line 15", "1")]


def test_included_files_have_lines_of_their_own(tmp_path):
    (tmp_path / "part.inc").write_text(SQUARE)
    found = deck(tmp_path, "*INCLUDE, INPUT=part.inc\n*SURFACE, NAME=top\nSquare, S3\n*SURFACE, NAME=rim\nSquare\n")
    assert str(found.cards[1].place) == "part.inc line 1"
    assert found.surfaces["TOP"].faces == [(1, 2)] and len(found.surfaces["RIM"].faces) == 4


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("*NSET, NSET=a\nb,\n", ("line 11", "'b'")),
        ("*NSET, NSET=a, GENERATE\n1, 4, 0\n", ("line 11", "1, 4, 0")),
        ("*SURFACE, NAME=s\nSquare, S5\n", ("line 11", "'S5'", "S1 to S4")),
        ("*SURFACE, NAME=s\nround, S1\n", ("line 11", "'round'", "SQUARE")),
        ("*ELEMENT, TYPE=CPE4\n2, 1, 2, 3\n", ("line 11", "3 nodes of element 2", "4 for CPE4")),
        ("*ELEMENT, TYPE=CPE4\n2, 1, 2, 3, 9\n", ("line 11", "node 9")),
        ("*ELEMENT\n2, 1, 2, 3, 4\n", ("line 10", "no TYPE=")),
        ("*NODE\n5, one, 2\n", ("line 11", "'one'", "a finite number")),
        ("*INCLUDE, INPUT=nothing.inp\n", ("line 10: *INCLUDE", "nothing.inp", "no such file")),
        ("*INCLUDE, INPUT=deck.inp\n", ("deck.inp", "include each other")),
        ("*INCLUDE, INPUT=/dev/zero\n", ("/dev/zero", "no regular file")),
        ("*INCLUDE, INPUT=.\n", ("no regular file",)),
        ("*NSET, NSET=a\ab\n1\n", ("line 10", r"'*NSET, NSET=a\x07b'", "a control character")),
        ("*NSET, NSET=a\n\x00\n", ("line 11", "a control character")),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, more, words):
    with pytest.raises(InputError) as error:
        deck(tmp_path, SQUARE + more)
    assert all(word in str(error.value) for word in (*words, "allowed")) and "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "nothing\n", "*NODE\n1, 0, 0\n"])
def test_files_without_a_model_are_refused(tmp_path, text):
    with pytest.raises(InputError, match="allowed"):
        deck(tmp_path, text)
