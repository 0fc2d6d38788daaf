"""`pcontact import`: small decks with known answers, run; what is left out is said, with its line."""

import numpy as np
import pytest

from pcontact.runtime.errors import InputError
from pcontact.scene.model import Displacement
from pcontact.scene.reader import read_scene
from tests.support.commands import execute
from tests.support.decks import BLOCKS, BRICK, PAIR, STEEL, bricks, imported, solved


@pytest.mark.parametrize("quadratic", [False, True])
def test_a_bar_that_is_drawn(tmp_path, quadratic):
    """By pressure on a face: u = p L / E, whatever the degree."""
    deck = (
        bricks(((0, 0, 0), (1, 1, 2)), quadratic=quadratic)
        + STEEL
        + """
*NSET, NSET=foot, GENERATE
1, 4
9, 12
*NSET, NSET=top, GENERATE
5, 8
*BOUNDARY
foot, 3
1, 1, 2
2, 2
*STEP
*STATIC
*DLOAD
EALL, P2, -100.
*END STEP
"""
    )
    deck = deck if quadratic else deck.replace("9, 12\n", "")
    status, words, scene = imported(tmp_path, deck)
    assert status == 0 and "left out" not in words and scene.mesh.serendipity == quadratic
    assert scene.mesh.strain == "small" and scene.mesh.order == (2 if quadratic else None)
    step = solved(scene, ["top"])[-1]
    assert step["probes"]["top"]["mean"][2] == pytest.approx(100.0 * 2.0 / 200000.0, rel=1e-9)


@pytest.mark.parametrize(("word", "other", "integration"), [
    ("C3D20R", "C3D20R", "reduced"), ("C3D20R", "C3D20", "full"), ("C3D20", "C3D20", "full"),
])  # fmt: skip
def test_reduced_integration_is_that_of_the_body(tmp_path, word, other, integration):
    """Half a body of each: where types differ the import says which integration all cells have."""
    deck = bricks(((0, 0, 0), (1, 1, 1)), ((2, 0, 0), (1, 1, 1)), quadratic=True)
    deck = deck.replace("TYPE=C3D20", f"TYPE={word}")
    deck = deck.replace("\n2, 101", f"\n*ELEMENT, TYPE={other}, ELSET=EALL\n2, 101")
    hold = "\n*NSET, NSET=foot\n1, 2, 3, 4, 101, 102, 103, 104\n*BOUNDARY\nfoot, 1, 3\n"
    status, words, scene = imported(tmp_path, deck + STEEL + hold + "*STEP\n*STATIC\n*DLOAD\n1, P2, 1.\n*END STEP\n")
    assert status == 0 and [body.integration for body in scene.bodies] == [integration]
    assert ("all of them with full integration" in words) == (word != other)


def test_a_held_element_of_degree_1_beside_one_of_degree_2_stays_rigid(tmp_path):
    """The lower block is held at its eight vertices, the upper one, of degree 2, is pressed onto it: u = -p L / E."""
    boxes = ((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (1, 1, 1))
    low, high = bricks(*boxes), bricks(*boxes, quadratic=True)
    nodes = [line for line in high.partition("*ELEMENT")[0].splitlines() if line.startswith(("10", "11", "12"))]
    upper = high[high.index("\n2, 101") :]
    lines = ["*NODE", *nodes, low.replace("\n2, 101", "\n*ELEMENT, TYPE=C3D8, ELSET=unused\n2, 101").partition(
        "\n*ELEMENT, TYPE=C3D8, ELSET=unused")[0], "*ELEMENT, TYPE=C3D20, ELSET=EALL" + upper]  # fmt: skip
    steps = """
*NSET, NSET=block, GENERATE
1, 8
*SURFACE, NAME=lower
1, S2
*SURFACE, NAME=upper
2, S1
*BOUNDARY
block, 1, 3
101, 1, 2
102, 2
"""
    press = "*STEP\n*STATIC\n*DLOAD\n2, P2, 100.\n*END STEP\n"
    status, words, scene = imported(tmp_path, "\n".join(lines) + STEEL + steps + PAIR.lstrip("\n") + press)
    assert status == 0 and "changed (in the scene, in another way):" in words and scene.mesh.order == 2
    assert sorted(body.order or 2 for body in scene.bodies) == [1, 2]
    probes = solved(scene, ["lower", "upper"])[-1]["probes"]
    assert np.abs(probes["lower"]["mean"]).max() < 1e-15 and abs(probes["upper"]["mean"][2]) < 2e-5


def test_two_blocks_pressed_by_nodal_forces_in_two_steps(tmp_path):
    """Forces of a step are ramps from those of the step before; contact passes them on."""
    status, words, scene = imported(
        tmp_path,
        BLOCKS
        + PAIR
        + """
*STEP, INC=100
*STATIC
0.5, 1.0
*CLOAD
105, 3, -100.
106, 3, -100.
107, 3, -100.
108, 3, -100.
*END STEP
*STEP
*STATIC
1.0, 2.0
*CLOAD
105, 3, -50.
106, 3, -50.
107, 3, -50.
108, 3, -50.
*END STEP
""",
    )
    assert status == 0 and "line" in words
    assert scene.steps.end == 3.0 and scene.steps.count == 6 and scene.contacts[0].friction == 0.25
    assert scene.contacts[0].source == "upper" and scene.contacts[0].target == "lower"
    (load,) = scene.loads
    assert load.force == (0.0, 0.0, -400.0) and [row[1] for row in load.amplitude] == [0.0, 1.0, 0.5]
    steps = solved(scene)
    forces = [step["contacts"]["upper-lower"]["force"][2] for step in steps]
    np.testing.assert_allclose(forces, [-200.0, -400.0, -350.0, -300.0, -250.0, -200.0], rtol=1e-8)


def test_tied_blocks_hang(tmp_path):
    status, words, scene = imported(
        tmp_path,
        BLOCKS
        + """
*TIE, NAME=glue, ADJUST=NO, POSITION TOLERANCE=0.01
upper, lower
*AMPLITUDE, NAME=up and down
0., 0., 0.5, 2., 1., 1.
*STEP
*STATIC
0.5, 1.
*BOUNDARY, AMPLITUDE=up and down
105, 3, 3, 0.001
106, 3, 3, 0.001
107, 3, 3, 0.001
108, 3, 3, 0.001
*END STEP
""",
    )
    assert status == 0
    (tie,) = scene.contacts
    assert tie.tied and tie.search_radius == 0.01
    forces = [step["contacts"]["upper-lower"]["force"][2] for step in solved(scene)]
    np.testing.assert_allclose(np.abs(forces), [200.0, 100.0], rtol=1e-8)


def test_supports_friction_and_contacts_that_change_are_phases(tmp_path):
    """The upper block is held and pressed; it lets go and presses the lower one; then its contact is taken away."""
    status, _, scene = imported(
        tmp_path,
        BLOCKS
        + """101, 3
102, 3
103, 3
104, 3
*NSET, NSET=top, GENERATE
105, 108
"""
        + PAIR
        + """*STEP
*STATIC
1., 2.
*BOUNDARY
top, 3, 3, -0.001
*END STEP
*STEP
*STATIC
*CHANGE FRICTION, INTERACTION=si
*FRICTION
0.5
*BOUNDARY, OP=NEW
foot, 1, 3
sides, 1, 2
top, 3, 3, -0.001
*END STEP
*STEP
*STATIC
*MODEL CHANGE, TYPE=CONTACT PAIR, REMOVE
upper, lower
*END STEP
""",
    )
    assert status == 0
    assert [(phase.name, phase.duration, phase.count) for phase in scene.phases] == [
        ("step_1", 2.0, 2), ("step_2", 1.0, 1), ("step_3", 1.0, 1)]  # fmt: skip
    assert scene.phases[1].friction == {"upper-lower": 0.5} and scene.contacts[0].phases == ("step_1", "step_2")
    assert [one.phases for one in scene.displacements].count(("step_1",)) == 1
    steps = solved(scene)
    # held as it is, the surface of the source has forces of its own in the first phase
    assert steps[2]["contacts"]["upper-lower"]["force"][2] == pytest.approx(-100.0, rel=1e-8)
    assert "upper-lower" not in steps[3]["contacts"] and abs(steps[3]["reactions"]["foot"][2]) < 1e-6


def test_thermal_strain_of_the_plane(tmp_path):
    """A square that is heated grows; the temperature is a linear function of the place."""
    status, words, scene = imported(
        tmp_path,
        """*NODE, NSET=ALL
1, 0, 0
2, 1, 0
3, 1, 1
4, 0, 1
*ELEMENT, TYPE=CAX4, ELSET=E
1, 1, 2, 3, 4
*MATERIAL, NAME=M
*ELASTIC
1000., .25
*EXPANSION, ZERO=5.
1e-3
*SOLID SECTION, ELSET=E, MATERIAL=M
*INITIAL CONDITIONS, TYPE=TEMPERATURE
ALL, 20.
*BOUNDARY
1, 2
2, 2
*STEP
*STATIC
*TEMPERATURE
1, 30.
2, 30.
3, 50.
4, 50.
*END STEP
""",
    )
    assert status == 0 and scene.mesh.kinematics == "axisymmetric"
    (heat,) = scene.temperatures
    assert heat.reference == 20.0 and "y" in heat.value
    assert len(solved(scene)) == 1


@pytest.mark.parametrize(
    ("more", "at", "words"),
    [
        ("*EQUATION\n2\n1, 1, 1., 2, 6, -1.\n", "2\n1, 1, 1., 2, 6", "degree of freedom beyond 3"),
        ("*SPRING, ELSET=S\n1., 2.\n", "*SPRING", "not known"),
        ("*STEP\n*DYNAMIC\n1., 1.\n*END STEP\n", "*DYNAMIC", "static"),
        ("*STEP\n*STATIC\n*DLOAD\nEALL, HYDRO, 1.\n*END STEP\n", "EALL, HYDRO", "HYDRO"),
        ("*STEP, PERTURBATION\n*STATIC\n*END STEP\n", "*STEP, PERT", "linear step"),
        ("*STEP\n*STATIC\n*CLOAD, LOAD CASE=2\n5, 1, 3.\n*END STEP\n", "*CLOAD", "LOADCASE=2"),
    ],
)
def test_what_is_left_out_is_said_with_its_line(tmp_path, more, at, words):
    text = BLOCKS + PAIR + more
    status, listed, _ = imported(tmp_path, text)
    part, line = listed.split("\nleft out (")[1].split("\nchanged (")[0], text[: text.index(at)].count("\n") + 1
    assert status == 1
    assert any(f"line {line}:" in row and words in row for row in part.splitlines()), part
    assert words in (tmp_path / "out" / "scene.toml").read_text()


def test_what_is_changed_is_said(tmp_path):
    text = (
        BLOCKS.replace("C3D8", "C3D8R") + PAIR.replace("HARD", "LINEAR\n1.e7") + "*STEP, NLGEOM\n*STATIC\n*END STEP\n"
    )
    status, listed, scene = imported(tmp_path, text)
    part = listed.split("\nchanged (")[1].split("\ntaken (")[0]
    assert status == 0 and scene.mesh.strain == "finite"
    assert all(word in part for word in ("reduced integration", "springs of 1e+07", "logarithmic strain"))


@pytest.mark.parametrize("row, pulled", [("1.e3, 0.5", True), ("1.e3", False)])
def test_springs_that_pull_are_told(tmp_path, row, pulled):
    """The second number of linear springs is a tension that a soft layer does not have."""
    status, listed, scene = imported(tmp_path, BLOCKS + PAIR.replace("HARD", f"LINEAR\n{row}"))
    part = listed.split("\nchanged (")[1].split("\ntaken (")[0]
    assert status == 0 and scene.contacts[0].pressure_overclosure == 1e3
    assert ("pull across a gap with up to 0.5" in part) is pulled


def test_every_card_is_in_the_list(tmp_path):
    text = BLOCKS + PAIR + "*NOVELTY, A=1\n1, 2\n*STEP\n*STATIC\n*NODE FILE\nU\n*NOVELTY\n*END STEP\n"
    _, listed, _ = imported(tmp_path, text)
    lines = text.splitlines()
    cards = [n for n, line in enumerate(lines, 1) if line.startswith("*")]
    ranges = [range(a, b) for a, b in zip(cards, [*cards[1:], len(lines) + 1], strict=True)]
    assert len(cards) == 20 and not [r[0] for r in ranges if not any(f"line {n}:" in listed for n in r)]


def test_a_deck_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError, match="line 3"):
        imported(tmp_path, "*NODE\n1, 0, 0, 0\nx, 1, 0, 0\n")


def test_nodes_that_move_alike_and_a_sector(tmp_path):
    """*EQUATION: a force at one of the upper nodes draws all of them by F L / (E A)."""
    alike = "".join(f"2\n{node}, 3, 1., 5, 3, -1.\n" for node in (6, 7, 8))
    deck = (
        bricks(((0, 0, 0), (1, 1, 1)))
        + STEEL
        + "*NSET, NSET=foot\n1, 2, 3, 4\n*BOUNDARY\nfoot, 3\n1, 1, 2\n2, 2\n*EQUATION\n"
        + alike
        + "*STEP\n*STATIC\n*CLOAD\n7, 3, 80.\n*END STEP\n"
    )
    status, words, scene = imported(tmp_path, deck)
    assert status == 0 and "left out" not in words and len(scene.equations) == 3
    assert scene.equations[0].terms == (("node_6", "z", 1.0), ("node_5", "z", -1.0))
    assert solved(scene, ["node_6"])[-1]["probes"]["node_6"]["mean"][2] == pytest.approx(80.0 / 200000.0, rel=1e-9)


def test_a_quarter_that_repeats(tmp_path):
    """*TIE, CYCLIC SYMMETRY: a brick between two planes through the axis is one of four."""
    deck = (
        bricks(((0, 0, 0), (1, 1, 1)))
        + STEEL
        + """
*SURFACE, NAME=along_x
1, S3
*SURFACE, NAME=along_y
1, S6
*TIE, NAME=cs, CYCLIC SYMMETRY
along_y, along_x
*CYCLIC SYMMETRY MODEL, N=4, TIE=cs
0., 0., 0., 0., 0., 1.
*NSET, NSET=foot
1, 2, 3, 4
*BOUNDARY
foot, 3
*STEP
*STATIC
*DLOAD
EALL, P4, -100.
EALL, P5, -100.
*END STEP
"""
    )
    status, words, scene = imported(tmp_path, deck)
    (pair,) = scene.periodic
    assert status == 0 and (pair.region, pair.partner) == ("along_y", "along_x") and abs(pair.angle) == 90.0
    # drawn alike in both directions: u = p / E (x, y), but for a turn about the axis
    scene.petsc = {}
    step = solved(scene, ["along_x", "along_y"])[-1]
    low, high = (np.array(step["probes"][name]["mean"]) for name in ("along_x", "along_y"))
    np.testing.assert_allclose([high[0], high[1]], [-low[1], low[0]], atol=1e-12)
    assert low[0] == pytest.approx(0.5 * 100.0 / 200000.0, rel=1e-9)


def test_a_support_that_begins_late_counts_from_the_undeformed_place(tmp_path):
    deck = (
        bricks(((0, 0, 0), (1, 1, 1)))
        + STEEL
        + """
*NSET, NSET=foot
1, 2, 3, 4
*NSET, NSET=top
5, 6, 7, 8
*BOUNDARY
foot, 1, 3
top, 1, 2
*STEP
*STATIC
*CLOAD
top, 3, 100.
*END STEP
*STEP
*STATIC
0.5, 1.
*BOUNDARY
top, 3, 3, -0.01
*END STEP
"""
    )
    status, _, scene = imported(tmp_path, deck)
    assert status == 0 and [one.absolute for one in scene.displacements].count(True) == 1
    drawn = 400.0 / 200000.0
    steps = solved(scene, ["top"])
    means = [step["probes"]["top"]["mean"][2] for step in steps]
    np.testing.assert_allclose(means, [drawn, 0.5 * drawn - 0.005, -0.01], rtol=1e-9)


SOFT = """
*SURFACE INTERACTION, NAME=si
*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR
1000.,
*CONTACT PAIR, INTERACTION=SI, TYPE=SURFACE TO SURFACE{more}
upper, lower
"""
PRESS = "*STEP\n*STATIC\n*DLOAD\n2, P2, 100.\n*END STEP\n"


def test_springs_between_surfaces(tmp_path):
    """Softer than a layer of elements: u = -p (2 L / E + 1 / k) at the top."""
    text = BLOCKS + "*NSET, NSET=top\n105, 106, 107, 108\n" + SOFT.format(more="") + PRESS
    status, words, scene = imported(tmp_path, text)
    assert status == 0 and "times a layer of elements" in words and scene.contacts[0].pressure_overclosure == 1000.0
    mean = solved(scene, ["top"])[-1]["probes"]["top"]["mean"][2]
    assert mean == pytest.approx(-100.0 * (2.0 / 200000.0 + 1.0 / 1000.0), rel=1e-6)


def test_gaps_that_are_closed_or_said(tmp_path):
    """ADJUST=0.02 takes a gap of 0.01 as closed, *CLEARANCE says another one."""
    high = BLOCKS.replace(bricks(((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (1, 1, 1))),
                          bricks(((0, 0, 0), (1, 1, 1)), ((0, 0, 1.01), (1, 1, 1))))  # fmt: skip
    high += "*NSET, NSET=top\n105, 106, 107, 108\n"
    status, words, scene = imported(tmp_path, high + SOFT.format(more=", ADJUST=0.02") + PRESS)
    assert status == 0 and "are closed at points" in words and scene.contacts[0].adjust_within == 0.02
    assert solved(scene, ["top"])[-1]["probes"]["top"]["mean"][2] == pytest.approx(-0.101, rel=1e-6)
    said = "*CLEARANCE, MASTER=lower, SLAVE=upper, VALUE=0.001\n"
    status, _, scene = imported(tmp_path, high + SOFT.format(more="") + said + PRESS)
    assert status == 0 and scene.contacts[0].clearance == 0.001
    assert solved(scene, ["top"])[-1]["probes"]["top"]["mean"][2] == pytest.approx(-0.102, rel=1e-6)


@pytest.mark.parametrize("law_first", [True, False])
@pytest.mark.parametrize(
    ("law", "stick", "stiffness", "left_out"),
    [
        ("LINEAR\n1.e7", "1.e5", 1e5, False),
        ("LINEAR\n1.e7", "1.e6", 1e6, False),
        ("LINEAR\n1.e7", "1.e7", None, False),
        ("LINEAR\n1000.", "1.e7", 1e7, False),
        ("HARD", "1.e5", None, True),
        ("TIED", "1.e5", None, False),
    ],
)
def test_springs_where_points_stick(tmp_path, law, stick, stiffness, left_out, law_first):
    """Kept where they yield as the bodies do, in whatever order the cards stand; a layer of elements has 2e5."""
    cards = [f"*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE={law}\n", f"*FRICTION\n0.25, {stick}\n"]
    text = PAIR.replace("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=HARD\n*FRICTION\n0.25,\n",
                        "".join(cards if law_first else cards[::-1]))  # fmt: skip
    status, words, scene = imported(tmp_path, BLOCKS + text)
    assert status == left_out and ("left out (" in words) is left_out
    assert scene.contacts[0].stick_stiffness == stiffness
    assert (scene.contacts[0].pressure_overclosure is None) is (stiffness is None)


@pytest.mark.parametrize("more", ["", ", NO SEPARATION"])
def test_tied_surfaces_with_what_means_nothing_there(tmp_path, more):
    """ADJUST says from how far surfaces are tied."""
    high = BLOCKS.replace(bricks(((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (1, 1, 1))),
                          bricks(((0, 0, 0), (1, 1, 1)), ((0, 0, 1.01), (1, 1, 1))))  # fmt: skip
    law = SOFT.format(more=", ADJUST=0.02").replace("LINEAR", f"TIED{more}").replace(
        "*CONTACT PAIR", "*FRICTION, TAUMAX=3.\n0.3\n*CONTACT PAIR")  # fmt: skip
    pull = "*NSET, NSET=top\n105, 106, 107, 108\n" + PRESS.replace("100.", "-100.")
    status, _, scene = imported(tmp_path, high + law + pull)
    assert status == 0 and scene.contacts[0].tied and scene.contacts[0].search_radius == 0.02
    assert solved(scene, ["top"])[-1]["probes"]["top"]["mean"][2] == pytest.approx(0.001, rel=1e-3)


def test_a_contact_pair_of_the_first_step_is_there_all_the_time(tmp_path):
    cards, pair = PAIR.split("*CONTACT PAIR")
    status, words, scene = imported(tmp_path, f"{BLOCKS}{cards}*STEP\n*STATIC\n*CONTACT PAIR{pair}*END STEP\n")
    assert status == 0, words
    assert [(one.source, one.target, one.phases) for one in scene.contacts] == [("upper", "lower", None)]


def test_names_of_materials_that_need_quotes(tmp_path):
    _, _, scene = imported(tmp_path, BLOCKS.replace("Steel", 'S\\b"t').replace("steel", 's\\b"T'))
    assert list(scene.materials) == ['S\\b"t']


def test_surfaces_that_are_tied_and_let_go(tmp_path):
    """Drawn apart in the first step, the upper block is without stress after the second one."""
    text = (
        BLOCKS
        + "*NSET, NSET=top\n105, 106, 107, 108\n*NSET, NSET=low\n101, 102, 103, 104\n"
        + SOFT.format(more="").replace("LINEAR", "TIED")
        + "*STEP\n*STATIC\n*BOUNDARY\ntop, 3, 3, 0.01\n*END STEP\n*STEP\n*STATIC\n"
        + "*CHANGE SURFACE BEHAVIOR, INTERACTION=si\n*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=HARD\n*END STEP\n"
    )
    status, _, scene = imported(tmp_path, text)
    assert status == 0 and [one.phases for one in scene.contacts] == [("step_1",), ("step_2",)]
    first, second = (step["probes"]["low"]["mean"][2] for step in solved(scene, ["low"]))
    assert (first, second) == pytest.approx((0.005, 0.01), rel=1e-3)


def test_elements_that_are_taken_away_first(tmp_path):
    removed = "*STEP\n*STATIC\n*MODEL CHANGE, TYPE=ELEMENT, REMOVE\n1,\n*DLOAD\n2, P2, 100.\n*BOUNDARY\n"
    more = "101, 3\n102, 3\n103, 3\n104, 3\n*END STEP\n"
    status, words, scene = imported(tmp_path, BLOCKS + "*NSET, NSET=top\n105, 106, 107, 108\n" + PAIR + removed + more)
    assert status == 0 and "not there from the beginning" in words and not scene.contacts
    mean = solved(scene, ["top"])[-1]["probes"]["top"]["mean"][2]
    assert mean == pytest.approx(-100.0 / 200000.0, rel=1e-9)


BESIDE = """*NODE, NSET=NALL
1, 0, 0, 0\n2, 2, 0, 0\n3, 2, 1, 0\n4, 0, 1, 0\n5, 0, 0, 1\n6, 2, 0, 1\n7, 2, 1, 1\n8, 0, 1, 1
9, 2, 2, 0\n10, 0, 2, 0\n11, 2, 2, 1\n12, 0, 2, 1
*ELEMENT, TYPE=C3D8, ELSET=EALL
1, 1, 2, 3, 4, 5, 6, 7, 8
2, 4, 3, 9, 10, 8, 7, 11, 12
*NSET, NSET=held
1, 4, 5, 8, 10, 12
*NSET, NSET=drawn
2, 3, 6, 7, 9, 11
*BOUNDARY
held, 1, 3
*STEP
*STATIC
*MODEL CHANGE, TYPE=ELEMENT, REMOVE
2,
*BOUNDARY
drawn, 1, 1, 0.001
*END STEP
*STEP
*STATIC
*MODEL CHANGE, TYPE=ELEMENT, ADD{how}
2,
*BOUNDARY
drawn, 1, 1, 0.002
*END STEP
"""


@pytest.mark.parametrize("how, left_out", [("", 0), ("=STRAIN FREE", 0), ("=WITH STRAIN", 1)])
def test_elements_that_are_added_later(tmp_path, how, left_out):
    """A bar that is drawn; one beside it, that comes later, bears what is drawn from then on."""
    text = BESIDE.replace("*NSET, NSET=held", STEEL.strip() + "\n*NSET, NSET=held").format(how=how)
    status, words, scene = imported(tmp_path, text)
    assert status == left_out and ("WITH STRAIN: the elements begin without" in words) == bool(left_out)
    assert [body.phases for body in scene.bodies] == [None, ("step_2",)]
    forces = [sum(force[0] for name, force in step["reactions"].items() if name.startswith("drawn"))
              for step in solved(scene)]  # fmt: skip
    # E A times the strain of each: 200000 * 0.001 / 2
    np.testing.assert_allclose(forces, [100.0, 300.0], rtol=1e-9)


def test_two_wedges_and_a_pyramid(tmp_path):
    """A brick of two wedges, drawn along x: by p / E; a pyramid on one of its sides holds it back."""
    pyramid = "*NODE\n9, 0.5, -1., 0.5\n*ELEMENT, TYPE=C3D5, ELSET=EALL\n3, 2, 1, 5, 6, 9\n"
    deck = (
        "*NODE, NSET=NALL\n"
        + "".join(f"{k}, {', '.join(f'{x:g}' for x in p)}\n" for k, p in enumerate(BRICK, 1))
        + "*ELEMENT, TYPE=C3D6, ELSET=EALL\n1, 1, 2, 3, 5, 6, 7\n2, 1, 3, 4, 5, 7, 8\n"
        + pyramid
        + STEEL
        + "*SURFACE, NAME=pulled\n1, S4\n*SURFACE, NAME=held\n2, S5\n*NSET, NSET=foot\n1, 4, 5, 8\n"
        + "*BOUNDARY\nfoot, 1\n1, 2, 3\n5, 2\n*STEP\n*STATIC\n*DSLOAD\npulled, P, -50.\n*END STEP\n"
    )
    status, words, scene = imported(tmp_path, deck)
    assert status == 0 and "changed (" not in words and "8 nodes" not in words
    (tmp_path / "alone").mkdir()
    _, _, alone = imported(tmp_path / "alone", deck.replace(pyramid, ""))
    held, free = (solved(one, ["pulled"])[-1]["probes"]["pulled"]["mean"][0] for one in (scene, alone))
    assert free == pytest.approx(50.0 / 200000.0, rel=1e-9) and 0.5 * free < held < 0.99 * free


def test_supports_in_directions_that_are_none_of_the_mesh(tmp_path):
    """A brick whose sides x = 1 slide on a plane at 30 degrees, pressed down by 0.1, goes aside by 0.1 tan(30)."""
    deck = (
        bricks(((0, 0, 0), (1, 1, 1)))
        + STEEL
        + """
*NSET, NSET=top
5, 6, 7, 8
*TRANSFORM, NSET=NALL, TYPE=R
0.866025403784439, 0., 0.5, 0., 1., 0.
*BOUNDARY
NALL, 2
NALL, 1
*STEP
*STATIC
*CLOAD
{load}
*END STEP
"""
    )
    status, words, scene = imported(tmp_path, deck.format(load="7, 3, 0."))
    assert status == 0 and "8 supports in directions" in words and len(scene.equations) == 8
    assert [list(one.value) for one in scene.displacements] == [["free", 0.0, "free"]]
    scene.displacements.append(Displacement("top", ["free", "free", -0.1]))
    mean = solved(scene, ["top"])[-1]["probes"]["top"]["mean"]
    np.testing.assert_allclose(mean, [0.1 * np.tan(np.pi / 6), 0.0, -0.1], rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize(("said", "drawn"), [("*CLOAD\n99, 1, 400.", 400.0), ("*BOUNDARY\n99, 1, 1, 0.002", 400.0)])
@pytest.mark.parametrize("normal", ["0., 0., 1.", "0., 0., -1."])
def test_a_bolt_that_is_drawn(tmp_path, said, drawn, normal):
    """A bar of length 1 between two supports, cut in its middle: tension F, or E A s / L."""
    deck = (
        bricks(((0, 0, 0), (1, 1, 0.5)))
        + "\n*NODE, NSET=NALL\n9, 0, 0, 1\n10, 1, 0, 1\n11, 1, 1, 1\n12, 0, 1, 1\n"
        + "*ELEMENT, TYPE=C3D8, ELSET=EALL\n2, 5, 6, 7, 8, 9, 10, 11, 12\n*NODE\n99, 0, 0, 0"
        + STEEL
        + "*SURFACE, NAME=middle\n1, S2\n*PRE-TENSION SECTION, SURFACE=middle, NODE=99\n"
        + normal
        + "\n*NSET, NSET=ends\n1, 2, 3, 4, 9, 10, 11, 12\n*BOUNDARY\nNALL, 1, 2\nends, 3\n*STEP\n*STATIC\n"
        + said
        + "\n*END STEP\n"
    )
    status, words, scene = imported(tmp_path, deck)
    assert status == 0 and len(scene.pretensions) == 1, words
    (record,) = solved(scene)[-1]["pretensions"].values()
    sign = 1.0 if normal.endswith("1.") and "-" not in normal else -1.0
    assert record["force"] == pytest.approx(sign * drawn, rel=1e-9)
    assert record["shortening"] == pytest.approx(sign * 0.002, rel=1e-9)


def test_a_section_that_nothing_draws_is_left_out(tmp_path):
    text = BLOCKS + "*NODE\n99, 0, 0, 0\n*PRE-TENSION SECTION, SURFACE=lower, NODE=99\n\n*STEP\n*STATIC\n*END STEP\n"
    status, words, scene = imported(tmp_path, text)
    assert status == 1 and "a section that nothing draws" in words and not scene.pretensions


@pytest.mark.parametrize(("chosen", "left"), [("101, 102", False), ("103, 104", True)])
def test_gaps_of_some_nodes_are_closed(tmp_path, chosen, left):
    """The lower side of the upper block is tilted: ADJUST takes the nodes nearest to the other surface, or says so."""
    text = BLOCKS.replace("103, 1, 1, 1\n104, 0, 1, 1", "103, 1, 1, 1.1\n104, 0, 1, 1.1")
    text = text.replace("101, 0, 0, 1\n102, 1, 0, 1", "101, 0, 0, 1.01\n102, 1, 0, 1.01")
    assert text.count("1.1\n") == 2
    text += f"*NSET, NSET=some\n{chosen}\n" + PAIR.replace("SI, TYPE", "SI, ADJUST=some, TYPE")
    status, words, scene = imported(tmp_path, text + "*STEP\n*STATIC\n*END STEP\n")
    assert status == int(left) and ("are not the nearest ones" in words) == left
    if not left:
        assert scene.contacts[0].adjust_within == pytest.approx(0.01, rel=1e-3)


def test_surfaces_of_faces_and_of_nodes_with_one_name(tmp_path):
    """The faces count where both are meant."""
    both = "*SURFACE, NAME=upper, TYPE=NODE\n101, 102\n"
    status, _, scene = imported(tmp_path, BLOCKS + both + PAIR + "*STEP\n*STATIC\n*END STEP\n")
    assert status == 0 and (scene.contacts[0].source, scene.contacts[0].target) == ("upper", "lower")


def test_a_node_on_the_axis_of_cylindrical_axes(tmp_path):
    """Its third direction is that of the axis, the first the next one of the mesh: across y that is z."""
    frame = "*TRANSFORM, NSET=NALL, TYPE=C\n0., 0., 0., 0., 1., 0.\n*BOUNDARY\n1, 3, 3, 0.5\n1, 1, 1, 0.25\n1, 2\n"
    deck = bricks(((0, 0, 0), (1, 1, 1))) + STEEL + frame + "*STEP\n*STATIC\n*END STEP\n"
    status, _, scene = imported(tmp_path, deck)
    values = np.zeros(3)
    for one in scene.displacements:
        values += [0.0 if value == "free" else value for value in one.value]
    assert status == 0
    np.testing.assert_allclose(values, [0.0, 0.5, 0.25])


def test_a_tie_of_surfaces_that_look_the_same_way_is_left_out(tmp_path):
    tie = "*SURFACE, NAME=top\n2, S2\n*TIE, NAME=glue\ntop, lower\n*STEP\n*STATIC\n*END STEP\n"
    status, words, scene = imported(tmp_path, BLOCKS + tie)
    assert status == 1 and "surfaces that look the same way: top, lower" in words and not scene.contacts


def test_the_command_imports(tmp_path):
    """`pcontact import DECK -o DIR`, in a process of its own."""
    (tmp_path / "deck.inp").write_text(BLOCKS)
    done = execute(tmp_path, ["import", "deck.inp", "-o", "out"])
    assert done.returncode == 0, done.stderr
    assert read_scene(tmp_path / "out" / "scene.toml").bodies and "import.txt" in done.stdout
