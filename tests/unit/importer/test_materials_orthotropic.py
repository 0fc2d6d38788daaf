"""Orthotropic materials of decks: constants and axes of sections, what is left out."""

import numpy as np
import pytest

from pcontact.material.orthotropic import frame, stiffness
from tests.support.decks import bricks, imported, solved
from tests.support.orthotropic import LAMINATE

BOX = bricks(((0, 0, 0), (1, 1, 1)))
(E1, E2, E3), (NU12, NU13, NU23), (G12, G13, G23) = LAMINATE
MODULI = "\n".join([
    "\n*MATERIAL, NAME=Ply", "*ELASTIC, TYPE=ENGINEERING CONSTANTS", f"{E1},{E2},{E3},{NU12},{NU13},{NU23},{G12},{G13}",
    f"{G23}\n",
])  # fmt: skip
SECTION = "*SOLID SECTION, ELSET=EALL, MATERIAL=Ply"
END = "\n*STEP\n*STATIC\n*END STEP\n"


def material_of(scene):
    return scene.materials[scene.bodies[0].material]


def test_moduli_and_stiffness_are_the_same(tmp_path):
    """ENGINEERING CONSTANTS, and the D of ORTHO that follow from them."""
    d = stiffness(*LAMINATE)
    numbers = [d[0, 0], d[0, 1], d[1, 1], d[0, 2], d[1, 2], d[2, 2], G12, G13]
    card = f"\n*MATERIAL, NAME=Ply\n*ELASTIC, TYPE=ORTHO\n{', '.join(map(repr, map(float, numbers)))}\n{G23}, 20.\n"
    for text in (MODULI, card):
        status, _, scene = imported(tmp_path, BOX + text + SECTION + END)
        found = material_of(scene)
        assert status == 0 and found.axes is None
        np.testing.assert_allclose([found.E, found.nu, found.G], LAMINATE, rtol=1e-9)


@pytest.mark.parametrize("system, rows, axes, around", [
    ("RECTANGULAR", "1, 1, 0, -1, 1, 0", [[1, 1, 0], [-1, 1, 0], [0, 0, 1]], None),
    ("RECTANGULAR", "2, 1, 0, 1, 5, 0, 1, 1, 0", [[1, 0, 0], [0, 1, 0], [0, 0, 1]], None),
    ("RECTANGULAR", "1, 0, 0, 0, 1, 0\n1, 90.", [[1, 0, 0], [0, 0, 1], [0, -1, 0]], None),
    ("RECTANGULAR", "0, 1, 0, 0, 0, 1\n3, 90.", [[0, 0, 1], [0, -1, 0], [1, 0, 0]], None),
    ("Z RECTANGULAR", "0, 1, 0, 1, 1, 0", [[1, 0, 0], [0, 0, -1], [0, 1, 0]], None),
    ("CYLINDRICAL", "1, 2, 3, 1, 2, 5", [[1, 0, 0], [0, 1, 0], [0, 0, 1]], ([1, 2, 3], [0, 0, 1])),
    ("CYLINDRICAL", "0, 0, 0, 1, 0, 0\n1, 90.", [[1, 0, 0], [0, 0, 1], [0, -1, 0]], ([0, 0, 0], [1, 0, 0])),
])  # fmt: skip
def test_orientations(tmp_path, system, rows, axes, around):
    card = f"*ORIENTATION, NAME=Or, SYSTEM={system}\n{rows}\n"
    status, words, scene = imported(tmp_path, BOX + MODULI + card + SECTION + ", ORIENTATION=or" + END)
    found, lengths = material_of(scene), np.linalg.norm(axes, axis=1)[:, None]
    assert status == 0 and "ORIENTATION" in words
    np.testing.assert_allclose(frame(*found.frame), np.array(axes) / lengths, atol=1e-12)
    assert (found.point, found.axis) == ((None, None) if around is None else tuple(map(tuple, around)))


def test_a_bar_with_turned_fibres(tmp_path):
    """Drawn along z, the fibres at 20 degrees to it in the plane of x and z: Lekhnitskii's modulus."""
    c, s = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
    card = f"*ORIENTATION, NAME=Or\n{s}, 0, {c}, {c}, 0, {-s}\n"
    hold = "*NSET, NSET=top, GENERATE\n5, 8\n*BOUNDARY\n1, 1, 3\n2, 2, 3\n4, 3\n3, 3\n"
    text = BOX + MODULI + card + SECTION + ", ORIENTATION=Or\n" + hold
    status, _, scene = imported(tmp_path, text + "*STEP\n*STATIC\n*DLOAD\nEALL, P2, -1.\n*END STEP\n")
    assert status == 0
    expected = c**4 / E1 + s**4 / E2 + c**2 * s**2 * (1.0 / G12 - 2.0 * NU12 / E1)
    scene.petsc = {}
    assert solved(scene, ["top"])[-1]["probes"]["top"]["mean"][2] == pytest.approx(expected, rel=1e-9)


def test_two_sections_of_one_material(tmp_path):
    """Each has the axes of its section."""
    two = bricks(((0, 0, 0), (1, 1, 1)), ((0, 0, 1), (1, 1, 1))) + "\n*ELSET, ELSET=low\n1\n*ELSET, ELSET=high\n2\n"
    turns = "*ORIENTATION, NAME=a\n1, 0, 0, 0, 1, 0\n*ORIENTATION, NAME=b\n0, 1, 0, 0, 0, 1\n"
    sections = "".join(f"*SOLID SECTION, ELSET={name}, MATERIAL=ply, ORIENTATION={one}\n"
                       for name, one in (("low", "a"), ("high", "b")))  # fmt: skip
    status, _, scene = imported(tmp_path, two + MODULI + turns + sections + END)
    assert status == 0 and [body.material for body in scene.bodies] == ["Ply-a", "Ply-b"]
    assert scene.materials["Ply-b"].axes == ((0, 1, 0), (0, 0, 1)) and scene.materials["Ply-a"].E == (E1, E2, E3)


HEAT = "*INITIAL CONDITIONS, TYPE=TEMPERATURE\nNALL, 20.\n*STEP\n*STATIC\n*TEMPERATURE\nNALL, 30.\n*END STEP\n"


@pytest.mark.parametrize("elastic, expansion", [
    (MODULI, "*EXPANSION, TYPE=ORTHO\n1e-5, 2e-5, 3e-5\n"), (MODULI, "*EXPANSION\n2e-5\n"),
    ("\n*MATERIAL, NAME=Ply\n*ELASTIC\n100., 0.3\n", "*EXPANSION, TYPE=ORTHO\n1e-5, 2e-5, 3e-5\n"),
])  # fmt: skip
def test_expansion_along_the_axes(tmp_path, elastic, expansion):
    status, _, scene = imported(tmp_path, BOX + elastic + expansion + SECTION + "\n" + HEAT)
    found = material_of(scene)
    assert status == 0 and found.expansion == ((1e-5, 2e-5, 3e-5) if "ORTHO" in expansion else (2e-5,) * 3)
    assert found.E == ((E1, E2, E3) if elastic == MODULI else (100.0,) * 3)


@pytest.mark.parametrize("text, words", [
    (MODULI.replace(f"\n{G23}\n", "\n"), "nine constants on two lines"),
    (MODULI.replace(f",{NU12},", ",9.0,"), "no positive energy"),
    ("\n*MATERIAL, NAME=Ply\n*ELASTIC, TYPE=ANISOTROPIC\n1, 2\n", "ENGINEERING CONSTANTS"),
    (MODULI + "*PLASTIC\n1., 0.\n", "does not yield"),
    (MODULI + "*ORIENTATION, NAME=Or, SYSTEM=SPHERICAL\n0,0,0,1,0,0\n", "CYLINDRICAL"),
    (MODULI + "*ORIENTATION, NAME=Or, DEFINITION=NODES\n1, 2\n", "axes by coordinates"),
    ("\n*MATERIAL, NAME=Ply\n*ELASTIC\n9., 0.3\n*PLASTIC\n1., 0.\n*EXPANSION, TYPE=ORTHO\n1e-5, 2e-5, 3e-5\n",
     "differs along the axes"),
])  # fmt: skip
def test_what_is_left_out_is_said(tmp_path, text, words):
    section = SECTION + (", ORIENTATION=Or" if "*ORIENTATION" in text else "")
    status, said, _ = imported(tmp_path, BOX + text + section + END)
    assert status == 1 and words in said


def test_finite_strain_is_left_out(tmp_path):
    status, said, scene = imported(tmp_path, BOX + MODULI + SECTION + "\n*STEP, NLGEOM\n*STATIC\n*END STEP\n")
    assert status == 1 and "NLGEOM with an orthotropic material" in said and scene.mesh.strain == "small"


def test_an_orientation_of_no_orthotropic_material_has_no_effect(tmp_path):
    steel = "\n*MATERIAL, NAME=Ply\n*ELASTIC\n100., 0.3\n*ORIENTATION, NAME=Or\n0, 1, 0, 0, 0, 1\n"
    status, said, scene = imported(tmp_path, BOX + steel + SECTION + ", ORIENTATION=Or" + END)
    assert status == 0 and material_of(scene).E == 100.0 and "no orthotropic material has it" in said
