"""scripts/refine_deck.py: what a refined deck has of nodes, sets, faces and equations."""

import sys
from pathlib import Path

import numpy as np
import pytest

from pcontact.importer.deck import EDGES, VERTICES, read_deck
from pcontact.runtime.errors import InputError

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
from compare_ccx import matched  # noqa: E402
from refine_deck import Pattern, children, linear, nodes_of, refine, shapes  # noqa: E402

BRICK = """*NODE, NSET=all
1, 0, 0, 0
2, 1, 0, 0
3, 1, 1, 0
4, 0, 1, 0
5, 0, 0, 1
6, 1, 0, 1
7, 1, 1, 1
8, 0, 1, 1
*ELEMENT, TYPE=C3D8, ELSET=brick
1, 1, 2, 3, 4, 5, 6, 7, 8
*NSET, NSET=foot
1, 2, 3, 4
*SURFACE, NAME=top
brick, S2
*EQUATION
2
6, 3, 1., 5, 3, -1.
2
7, 3, 1., 5, 3, -1.
2
8, 3, 1., 5, 3, -1.
*STEP
*STATIC
*BOUNDARY
foot, 3
1, 1, 2
*DLOAD
brick, P2, 5.
*CLOAD
foot, 1, 2.
*END STEP
"""


@pytest.mark.parametrize("cell", [cell for cell in VERTICES if cell != "pyramid"])
def test_parts_fill_the_cell(cell):
    """They have the place of the whole, the same sense, and their faces cover its faces."""
    whole, parts = nodes_of(cell), children(cell)
    random = np.random.default_rng(1).dirichlet(np.ones(VERTICES[cell]), 200) @ whole[: VERTICES[cell]]
    assert len(parts) == 2 ** whole.shape[1]

    def volume(points):
        edges = {"hex": (1, 3, 4), "wed": (1, 2, 3), "qua": (1, 3)}.get(cell[:3], range(1, whole.shape[1] + 1))
        return np.linalg.det([points[k] - points[0] for k in edges])

    sizes = [volume(part) for part in parts]
    assert min(sizes) > 0.0 and sum(sizes) == pytest.approx(volume(whole))
    assert linear(cell, random).min() > -1e-12 and shapes(cell, whole) == pytest.approx(np.eye(len(whole)), abs=1e-12)
    pattern = Pattern(cell)
    assert {len(rows) for rows in pattern.faces.values()} == {2 ** (whole.shape[1] - 1)}
    assert pattern.parts.shape[1] == len(whole) and (cell in EDGES) == (len(whole) > VERTICES[cell])


def test_a_brick(tmp_path):
    (tmp_path / "deck.inp").write_text(BRICK)
    refine(tmp_path / "deck.inp", tmp_path / "finer.inp")
    deck = read_deck(tmp_path / "finer.inp")
    assert len(deck.nodes) == 27 and len(deck.elements) == 8 and deck.nodes[3] == [1.0, 1.0, 0.0]
    assert sorted(deck.nodes[n][2] for n in deck.node_sets["FOOT"]) == 9 * [0.0] and len(deck.node_sets["ALL"]) == 27
    top = {n for row in deck.surfaces["TOP"].faces for n in deck.corners(*row)}
    assert len(deck.surfaces["TOP"].faces) == 4 and {deck.nodes[n][2] for n in top} == {1.0}
    (cards,) = (step.cards for step in deck.steps)
    loads = {card.key: card for card in cards}
    assert len(loads["DLOAD"].rows) == 4 and [words[0] for _, words in loads["CLOAD"].rows] == ["1", "2", "3", "4"]
    held = {tuple(words[1:]): deck.nodes_of(loads["BOUNDARY"], None, words[0]) for _, words in loads["BOUNDARY"].rows}
    assert len(held["3",]) == 9 and held["1", "2"] == [1]
    equations = next(card for card in deck.model if card.key == "EQUATION")
    follow = {words[0] for _, words in equations.rows if len(words) > 1}
    assert {int(node) for node in follow} == top - {5}


def test_pyramids_are_refused(tmp_path):
    path = tmp_path / "deck.inp"
    path.write_text("*NODE\n1, 0, 0, 0\n2, 1, 0, 0\n3, 1, 1, 0\n4, 0, 1, 0\n5, 0, 0, 1\n"
                    "*ELEMENT, TYPE=C3D5, ELSET=e\n1, 1, 2, 3, 4, 5\n")  # fmt: skip
    with pytest.raises(InputError, match="found pyramids"):
        refine(path, tmp_path / "finer.inp")


def test_nodes_in_one_place_are_told_apart(tmp_path):
    """Two bricks of one set touch, a third one of another set shares nodes with the second."""
    path = tmp_path / "deck.inp"
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    nodes = [(*c, z) for z in (0, 1, 1, 2, 3) for c in corners]
    cells = [(1, "a", 0, 1), (2, "a", 2, 3), (3, "b", 3, 4)]
    path.write_text(
        "*NODE\n" + "".join(f"{k}, {x}, {y}, {z}\n" for k, (x, y, z) in enumerate(nodes, 1))
        + "".join(f"*ELEMENT, TYPE=C3D8, ELSET={name}\n{k}, "
                  + ", ".join(str(4 * layer + n) for layer in (low, high) for n in (1, 2, 3, 4)) + "\n"
                  for k, name, low, high in cells)
        + "*MATERIAL, NAME=m\n*ELASTIC\n1., 0.\n*SOLID SECTION, ELSET=a, MATERIAL=m\n"
        "*SOLID SECTION, ELSET=b, MATERIAL=m\n"
    )  # fmt: skip
    # as results have them: by body, then by number; nodes of layer 3 count as those of the second body
    order = [*range(12), *range(12, 20)]
    points, body = np.array(nodes, dtype=float)[order], np.repeat([0, 1], [12, 8])
    assert matched(read_deck(path), points, body) == {k + 1: k for k in range(20)}
    assert matched(read_deck(path), points + 0.5, body) is None
