"""Decks of parts and instances, reference nodes and general contact, run against known answers."""

import numpy as np
import pytest

from pcontact.importer.cards import read_cards, rectangular
from pcontact.importer.deck import read_deck
from pcontact.mesh.read import read_file
from pcontact.runtime.errors import InputError
from tests.support.decks import BLOCKS, PAIR, STEEL, bricks, imported, solved

PARTS = """*Heading
*Part, name=Block
*Node
1, 0., 0., 0.
2, 1., 0., 0.
3, 1., 1., 0.
4, 0., 1., 0.
5, 0., 0., 1.
6, 1., 0., 1.
7, 1., 1., 1.
8, 0., 1., 1.
*Element, type=C3D8, elset=all
1, 1, 2, 3, 4, 5, 6, 7, 8
*Nset, nset=foot, generate
1, 4, 1
*Solid Section, elset=all, material=Steel
,
*End Part
*Assembly, name=Assembly
*Instance, name=low, part=Block
*End Instance
*Instance, name=high, part=BLOCK
0., 0., 1.
0.5, 0.5, 1., 0.5, 0.5, 2., 90.
*End Instance
*Node
1, 0.5, 0.5, 2.
*Nset, nset=point
1,
*Nset, nset=corner, instance=high
5,
*Elset, elset=_up, internal, instance=high
1,
*Surface, type=ELEMENT, name=up
_up, S1
*Surface, type=ELEMENT, name=top
_up, S2
*Surface, type=ELEMENT, name=down
low.all, S2
*Coupling, constraint name=head, ref node=point, surface=top
*Kinematic
*End Assembly
*Material, name=Steel
*Elastic
200000., 0.0
*Surface Interaction, name=law
1.,
*Friction, slip tolerance=0.005
0.1,
*Surface Behavior, pressure-overclosure=HARD
*Contact Pair, interaction=law, type=SURFACE TO SURFACE
up, down
*Step, name=press, nlgeom=NO
*Static
1., 1.
*Boundary
low.foot, ENCASTRE
point, 1, 2
point, 4, 6
*Cload
point, 3, -2000.
*Output, field, variable=PRESELECT
*End Step
"""


@pytest.mark.parametrize("finite", [False, True])
def test_an_assembly_of_two_instances_of_a_part(tmp_path, finite):
    """A rigid head presses two blocks: u = F L / (E A); with finite strain E log s = F s / A, with the stretch s."""
    status, words, scene = imported(tmp_path, PARTS.replace("nlgeom=NO", "nlgeom=YES" if finite else "nlgeom=NO"))
    assert status == 0, words
    assert [body.region for body in scene.bodies] == ["low.all", "high.all"]
    step = solved(scene)[-1]
    force = -2000.0 / 200000.0
    stretch = 1.0 + force
    for _ in range(20 if finite else 0):
        stretch = np.exp(force * stretch)
    assert step["couplings"]["head"]["displacement"][2] == pytest.approx(2.0 * (stretch - 1.0), rel=1e-9)
    assert step["contacts"]["up-down"]["force"][2] == pytest.approx(-2000.0, rel=1e-9)
    assert np.abs(step["couplings"]["head"]["moment"]).max() < 1e-6


def test_nodes_of_an_instance_are_where_it_stands(tmp_path):
    """The corner (0, 0, 1) of a part, shifted by (0, 0, 1) and turned by 90 degrees about (0.5, 0.5)."""
    (tmp_path / "deck.inp").write_text(PARTS)
    deck = read_deck(tmp_path / "deck.inp")
    (corner,) = deck.node_sets["CORNER"]
    np.testing.assert_allclose(deck.nodes[corner], [1.0, 0.0, 2.0], atol=1e-15)
    # nodes of the assembly keep their numbers, those of instances end with those of the part
    assert deck.nodes[1] == [0.5, 0.5, 2.0] and corner % 10 == 5
    assert deck.node_sets["LOW.FOOT"] != deck.node_sets["HIGH.FOOT"]


@pytest.mark.parametrize(("old", "new", "message"), [
    ("part=BLOCK", "part=Rock", r"line 22: \*Instance: found the unknown part 'Rock'; allowed: BLOCK"),
    ("0.5, 0.5, 1., 0.5, 0.5, 2., 90.", "0.5, 0.5, 1., 0.5, 0.5, 1., 90.", "line 24: .*axis of no length"),
    ("0.5, 0.5, 1., 0.5, 0.5, 2., 90.", "0.5, 0.5", "line 24: .*found 2 numbers"),
    ("instance=high\n5", "instance=mid\n5", "found the unknown instance 'mid'; allowed: LOW, HIGH"),
    ("*End Part\n", "", r"line 2: \*Part: found no end of it"),
])  # fmt: skip
def test_what_is_wrong_with_an_assembly(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message):
        imported(tmp_path, PARTS.replace(old, new))


@pytest.mark.parametrize(("system", "nodes", "point"), [
    ("", ", SYSTEM=C\n1, 2., 90., 3.", (0.0, 2.0, 3.0)),
    ("", ", SYSTEM=S\n1, 2., 90., 30.", (0.0, 3.0**0.5, 1.0)),
    ("*SYSTEM\n1., 1., 1.\n", "\n1, 2., 0., 0.", (3.0, 1.0, 1.0)),
    ("*SYSTEM\n1., 0., 0., 1., 1., 0.\n0., 0., 0.\n", "\n1, 2., 1., 0.", (0.0, 2.0, 0.0)),
])  # fmt: skip
def test_nodes_in_other_coordinates(tmp_path, system, nodes, point):
    """Cylinders, spheres, another origin, other axes: the second one runs towards the third point."""
    (tmp_path / "deck.inp").write_text(f"{system}*NODE{nodes}\n")
    (card,) = [card for card in rectangular(read_cards(tmp_path / "deck.inp")) if card.key == "NODE"]
    np.testing.assert_allclose([float(word) for word in card.rows[0][1][1:]], point, atol=1e-15)


def hung(tmp_path, kind, steps):
    """A bar, 2 high, held at its foot, with a node 9 above it that its top hangs on; the last load step."""
    top = "*NODE\n9, 0.5, 0.5, 2.\n10, 0., 0., 0.\n*NSET, NSET=top, GENERATE\n5, 8\n*SURFACE, NAME=head\n1, S2\n"
    hold = "*NSET, NSET=foot, GENERATE\n1, 4\n*BOUNDARY\nfoot, 1, 3\n"
    deck = bricks(((0, 0, 0), (1, 1, 2))) + STEEL + top + hold + kind + "*STEP\n*STATIC\n" + steps + "*END STEP\n"
    status, words, scene = imported(tmp_path, deck)
    assert status == 0, words
    return solved(scene, ["top"])[-1]


RIGID = "*RIGID BODY, NSET=top, REF NODE=9, ROT NODE=10\n"
TURNED = "*BOUNDARY\n9, 1, 3, 0.\n10, 1, 2, 0.\n10, 3, 3, 0.01\n"


def test_a_rigid_body_turns(tmp_path):
    """Rotations of CalculiX are the translations of a second node; the moment about the axis is that of the motion."""
    step = hung(tmp_path, RIGID, TURNED)
    (found,) = step["couplings"].values()
    np.testing.assert_allclose(found["rotation"], [0.0, 0.0, 0.01], atol=1e-14)
    other = hung(tmp_path, RIGID.replace(", ROT NODE=10", ""), TURNED.replace("10, 3, 3", "9, 6, 6").replace("10", "9"))
    assert found["moment"][2] > 1.0
    assert next(iter(other["couplings"].values()))["moment"][2] == pytest.approx(found["moment"][2], rel=1e-12)


@pytest.mark.parametrize("kind", [
    "*COUPLING, CONSTRAINT NAME=c, REF NODE=9, SURFACE=head\n*DISTRIBUTING\n1, 3\n",
    "*ELEMENT, TYPE=DCOUP3D, ELSET=e\n77, 9\n*DISTRIBUTING COUPLING, ELSET=e\ntop, 1.\n",
    "*COUPLING, CONSTRAINT NAME=c, REF NODE=9, SURFACE=head\n*KINEMATIC\n1, 6\n",
    "*KINEMATIC COUPLING, REF NODE=9\ntop, 1, 3\n",
    RIGID,
])  # fmt: skip
def test_a_force_on_a_reference_node(tmp_path, kind):
    """Whatever hangs it: the mean of the top goes up by F L / (E A)."""
    step = hung(tmp_path, kind, "*CLOAD\n9, 3, 500.\n")
    assert step["probes"]["top"]["mean"][2] == pytest.approx(500.0 * 2.0 / 200000.0, rel=1e-9)


def test_a_motion_of_a_reference_node_on_average(tmp_path):
    """The force that holds the mean displacement of the top: E A u / L."""
    kind = "*COUPLING, CONSTRAINT NAME=c, REF NODE=9, SURFACE=head\n*DISTRIBUTING\n1, 3\n"
    (found,) = hung(tmp_path, kind, "*BOUNDARY\n9, 3, 3, 0.005\n")["couplings"].values()
    np.testing.assert_allclose([found["displacement"][2], found["force"][2]], [0.005, 500.0], rtol=1e-9)


@pytest.mark.parametrize("inclusions", [
    "*CONTACT INCLUSIONS, ALL EXTERIOR\n", "*CONTACT INCLUSIONS\nupper, lower\n",
])  # fmt: skip
def test_general_contact(tmp_path, inclusions):
    """Two blocks without their pair, pressed by displacements: E u / L of one after the other."""
    law = PAIR[: PAIR.index("*CONTACT PAIR")]
    contact = "*CONTACT\n" + inclusions + "*CONTACT PROPERTY ASSIGNMENT\n, , SI\n"
    press = "".join(f"{k}, 3, 3, -0.001\n{k}, 1, 2\n" for k in range(105, 109))
    blocks = BLOCKS.replace("sides, 1, 2\n", "")
    status, words, scene = imported(
        tmp_path, blocks + law + contact + "*STEP\n*STATIC\n*BOUNDARY\n" + press + "*END STEP\n"
    )
    assert status == 0, words
    assert scene.contacts[0].friction == 0.25 and scene.contacts[0].all == ("ALL" in inclusions)
    scene.steps.count = 3
    forces = [abs(found["force"][2]) for step in solved(scene) for found in step["contacts"].values()]
    np.testing.assert_allclose(forces, [100.0 / 3.0, 200.0 / 3.0, 100.0], rtol=1e-8)


def test_surfaces_that_do_not_part(tmp_path):
    """NO SEPARATION: the upper block draws the lower one."""
    pair = PAIR.replace("OVERCLOSURE=HARD", "OVERCLOSURE=HARD, NO SEPARATION")
    draw = "".join(f"{k}, 3, 3, 0.001\n" for k in range(105, 109))
    status, words, scene = imported(tmp_path, BLOCKS + pair + "*STEP\n*STATIC\n*BOUNDARY\n" + draw + "*END STEP\n")
    assert status == 0, words
    assert solved(scene)[-1]["contacts"]["upper-lower"]["force"][2] == pytest.approx(100.0, rel=1e-8)


# -- rigid surfaces -----------------------------------------------------------------------------------------------

PUNCH = "*NODE\n201, 0.5, 0.5, 2.\n"
FLAT = "*NODE\n211, -1., -1., 1.\n212, 2., -1., 1.\n213, 2., 2., 1.\n214, -1., 2., 1.\n"
LAW = "*SURFACE INTERACTION, NAME=si\n*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=HARD\n"
MOVE = "*STEP\n*STATIC\n*BOUNDARY\n201, 1, 2\n201, 3, 3, -0.001\n201, 4, 6\n*END STEP\n"


def pressed(tmp_path, tool, pair="top, tool"):
    """A cube of one element under a rigid surface that comes down by 0.001; the last load step, and the scene."""
    block = bricks(((0, 0, 0), (1, 1, 1))) + STEEL
    hold = "*SURFACE, NAME=top\n1, S2\n*NSET, NSET=foot, GENERATE\n1, 4\n*BOUNDARY\nfoot, 1, 3\n"
    contact = LAW + f"*CONTACT PAIR, INTERACTION=si, TYPE=SURFACE TO SURFACE\n{pair}\n"
    status, words, scene = imported(tmp_path, block + hold + PUNCH + tool + contact + MOVE)
    assert status == 0, words
    return solved(scene)[-1], scene


@pytest.mark.parametrize(("side", "pair"), [("SPOS", "top, tool"), ("SNEG", "top, tool"), ("SNEG", "tool, top")])
def test_a_tool_of_rigid_elements(tmp_path, side, pair):
    """A flat one, whichever way its nodes run and whichever side is named: E u / L."""
    rigid = FLAT + "*ELEMENT, TYPE=R3D4, ELSET=r\n9, 211, 212, 213, 214\n*RIGID BODY, ELSET=r, REF NODE=201\n"
    step, scene = pressed(tmp_path, rigid + f"*SURFACE, NAME=tool\nr, {side}\n", pair)
    assert scene.contacts[0].obstacle.shape == "mesh"
    assert step["contacts"]["top-tool"]["force"][2] == pytest.approx(200.0, rel=1e-8)


@pytest.mark.parametrize(("kind", "lines", "force"), [
    ("CYLINDER", "0., 0., 1., 1., 0., 1.\n0., 0.5, 1.\nSTART, -1., 0.\nLINE, 2., 0.\n", 200.0),
    # an arc of radius 100
    ("CYLINDER", "0., 0., 1., 1., 0., 1.\n0., 0.5, 1.\nSTART, 2., 0.\nCIRCL, -1., 0., 0.5, 99.98875\n", None),
    ("REVOLUTION", "0.5, 0.5, 1., 0.5, 0.5, 2.\nSTART, 0., 0.\nLINE, 3., 0.\n", 200.0),
])  # fmt: skip
def test_a_tool_of_lines_and_arcs(tmp_path, kind, lines, force):
    tool = f"*SURFACE, NAME=tool, TYPE={kind}\n{lines}*RIGID BODY, ANALYTICAL SURFACE=tool, REF NODE=201\n"
    step, _ = pressed(tmp_path, tool)
    found = step["contacts"]["top-tool"]["force"][2]
    # the bulging one is 0.01 (at the sides of the block) to 0.01125 lower than the flat one
    assert found == pytest.approx(force, rel=1e-6) if force else 2200.0 < found < 2450.0


DIE = """*Part, name=die
*Surface, type=SEGMENTS, name=line
START, -1., 0.
LINE, 2., 0.
*Rigid Body, ref node=ref, analytical surface=line
*Node, nset=ref
1, 0., 0.
*End Part
*Part, name=block
*Node
1, 0., 0.
2, 1., 0.
3, 1., 1.
4, 0., 1.
*Element, type=CPE4, elset=all
1, 1, 2, 3, 4
*Solid Section, elset=all, material=Steel
1.,
*Surface, name=top
all, S3
*End Part
*Assembly, name=A
*Instance, name=d, part=die
0., 1., 0.
0.5, 1., 0., 0.5, 1., 1., 180.
*End Instance
*Instance, name=b, part=block
*End Instance
*End Assembly
*Material, name=Steel
*Elastic
200000., 0.0
*Surface Interaction, name=si
*Contact Pair, interaction=si
b.top, d.line
*Step
*Static
*Boundary
b.1, 1, 2
b.2, 1, 2
d.ref, 1, 1
d.ref, 2, 2, -0.001
d.ref, 6, 6
*End Step
"""


def test_a_tool_in_the_plane(tmp_path):
    """Segments of an instance that is turned upside down and stands above the block."""
    status, words, scene = imported(tmp_path, DIE)
    assert status == 0, words
    (contact,) = solved(scene)[-1]["contacts"].values()
    assert contact["force"][1] == pytest.approx(200.0, rel=1e-8)


def test_files_of_tools_are_theirs_alone(tmp_path):
    """Neither that of the bodies nor that of a tool whose name differs in capitals or signs."""
    names = "mesh", "a.b", "A_b", "a b"
    tools = "".join(
        f"*Surface, type=SEGMENTS, name={name}\nSTART, -1., {k + 3}.\nLINE, 2., {k + 3}.\n"
        f"*Rigid Body, ref node=d.ref, analytical surface={name}\n" for k, name in enumerate(names)
    )  # fmt: skip
    pairs = "".join(f"*Contact Pair, interaction=si\nb.top, {name}\n" for name in names)
    text = DIE.replace("*End Assembly", f"{tools}*End Assembly").replace("*Step", f"{pairs}*Step", 1)
    _, words, scene = imported(tmp_path, text)
    files = [contact.obstacle.file.lower() for contact in scene.contacts]
    assert len({"mesh.msh", *files}) == 6, words
    meshes = [read_file(tmp_path / "out" / contact.obstacle.file) for contact in scene.contacts]
    assert [mesh.points[0, 1] for mesh in meshes] == pytest.approx([1.0, 3.0, 4.0, 5.0, 6.0])


@pytest.mark.parametrize("line", ["2, 0.5, 0.0, 0.", "START, 1.", "LINE, 1., 2."])
def test_a_profile_that_cannot_be_read_is_refused(tmp_path, line):
    with pytest.raises(InputError, match=f"line 3.*found {line[:4]}.*START"):
        imported(tmp_path, DIE.replace("START, -1., 0.", line))


@pytest.mark.parametrize("pair", ["*Tie, name=t\nb.top, d.line\n", "*Tie, name=t\nb.top, b.top\n"])
def test_ties_to_nothing_that_strains_are_left_out(tmp_path, pair):
    status, words, scene = imported(tmp_path, DIE.replace("*Contact Pair, interaction=si\nb.top, d.line\n", pair))
    assert status == 1 and "a tie to a rigid surface" in words and not scene.contacts


# -- counted meshes, rubber, tractions -----------------------------------------------------------------------------

COUNTED = """*NODE
1, 0., 0.
5, 2., 0.
101, 0., 1.
105, 2., 1.
*NGEN, NSET=low
1, 5, 1
*NGEN, NSET=high
101, 105, 1
*NFILL, NSET=all
low, high, 4, 25
*ELEMENT, TYPE=CPE4
1, 1, 2, 27, 26
*ELGEN, ELSET=e
1, 4, 1, 1, 4, 25, 4
*SOLID SECTION, ELSET=e, MATERIAL=steel
1.,
*MATERIAL, NAME=steel
*ELASTIC
200000., 0.
*NSET, NSET=left, GENERATE
1, 101, 25
*SURFACE, NAME=right
e, S2
*BOUNDARY
left, 1, 1
1, 2, 2
"""


def test_a_mesh_that_is_counted_out(tmp_path):
    """4 x 4 elements of a plate, 2 long: a traction draws it by p L / E."""
    deck = COUNTED.replace("e, S2", "4, S2\n8, S2\n12, S2\n16, S2")
    steps = "*STEP\n*STATIC\n*DSLOAD, FOLLOWER=NO\nright, TRVEC, 100., 2., 0., 0.\n*END STEP\n"
    status, words, scene = imported(tmp_path, deck + steps)
    assert status == 0, words
    (load,) = scene.loads
    assert load.traction == (100.0, 0.0)
    step = solved(scene, ["right"])[-1]
    assert step["probes"]["right"]["mean"][0] == pytest.approx(100.0 * 2.0 / 200000.0, rel=1e-9)


def test_nodes_on_an_arc_and_copies(tmp_path):
    text = "*NODE\n1, 1., 0.\n7, 0., 1.\n9, 0., 0.\n*NGEN, LINE=C, NSET=arc\n1, 7, 1, 9\n"
    text += "*NCOPY, OLD SET=arc, NEW SET=up, CHANGE NUMBER=100, SHIFT\n0., 0., 2.\n0., 0., 0., 0., 0., 1., 90.\n"
    text += "*ELEMENT, TYPE=C3D4\n1, 1, 4, 7, 101\n*ELCOPY, ELEMENT SHIFT=10, SHIFT NODES=0, OLD SET=s, NEW SET=t\n"
    text = text.replace("*ELCOPY", "*ELSET, ELSET=s\n1,\n*ELCOPY")
    (tmp_path / "deck.inp").write_text(text)
    deck = read_deck(tmp_path / "deck.inp")
    np.testing.assert_allclose(deck.nodes[4], [0.5**0.5, 0.5**0.5, 0.0], atol=1e-15)
    np.testing.assert_allclose(deck.nodes[104], [-(0.5**0.5), 0.5**0.5, 2.0], atol=1e-15)
    assert deck.node_sets["UP"] == list(range(101, 108)) and deck.element_sets["T"] == [11]


@pytest.mark.parametrize(("card", "constants"), [
    ("NEO HOOKE", "0.5, 0.01"), ("MOONEY-RIVLIN", "0.3, 0.2, 0.01"), ("OGDEN, N=1", "1.0, 2.0, 0.01"),
])  # fmt: skip
def test_rubber(tmp_path, card, constants):
    """Three laws with the shear modulus 1 and K = 200, drawn to 5/4 in plane strain: mu (s - s^-3) if K is large."""
    deck = COUNTED.replace("e, S2", "4, S2").replace("*ELASTIC\n200000., 0.", f"*HYPERELASTIC, {card}\n{constants}")
    deck = deck.replace("*BOUNDARY", "*NSET, NSET=end, GENERATE\n5, 105, 25\n*BOUNDARY")
    steps = "*STEP, NLGEOM=YES\n*STATIC\n*BOUNDARY\nend, 1, 1, 0.5\n*END STEP\n"
    status, words, scene = imported(tmp_path, deck + steps)
    assert status == 0, words
    (material,) = scene.materials.values()
    assert material.law == card.split(",")[0].lower().replace("-", "_").replace(" ", "_")
    shear, bulk = material.E / (2 + 2 * material.nu), material.E / (3 - 6 * material.nu)
    assert shear == pytest.approx(1.0) and bulk == pytest.approx(200.0)
    assert abs(solved(scene)[-1]["reactions"]["left"][0]) == pytest.approx(1.25 - 1.25**-3, rel=0.01)
    _, words, scene = imported(tmp_path, deck + steps.replace("=YES", "=NO"))
    assert next(iter(scene.materials.values())).law == "hencky" and "as stiff as it is at its beginning" in words
