"""The scene file and the scene objects: what is read, what is refused and in which words."""

import re
import tomllib

import numpy as np
import pytest

from pcontact.runtime.errors import InputError
from pcontact.scene.describe import describe
from pcontact.scene.model import Body, Contact, Displacement, Load, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.scene.reader import read_scene
from pcontact.scene.validate import resolve_contacts, validate
from tests.support.scenes import FULL, PLAIN, value_cases


def built(tmp_path, **keys):
    """A small scene built in Python."""
    (tmp_path / "mesh.msh").write_text("")
    parts = {
        "mesh": MeshSpec(tmp_path / "mesh.msh"),
        "materials": {"rubber": Material(E=1, nu=0.25)},
        "bodies": [Body("block", "rubber")],
    }
    return Scene(**(parts | keys))


def refused(call, *parts):
    """The call raises one line with all the parts."""
    with pytest.raises(InputError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    assert "found" in message and "allowed" in message
    for part in parts:
        assert part in message, f"{part!r} is not in: {message}"
    return message


def changed(text, old, new):
    assert text.count(old) >= 1
    return text.replace(old, new, 1)


# ---------------------------------------------------------------- what is read


def test_full_scene(full, write, tmp_path):
    assert full.title == "Half ball on a block"
    assert full.mesh == MeshSpec("ball_on_block.msh", 1, "plane_strain")
    assert full.mesh_path == tmp_path / "ball_on_block.msh" and full.where == str(tmp_path / "scene.toml")
    assert full.materials == {
        "steel": Material(210e3, 0.3),
        "aluminium": Material(70e3, 0.3, 250.0, 1000.0, 0.0),
    }
    assert full.bodies == [Body("block", "aluminium"), Body("ball", "steel")]
    assert full.steps == Steps(2.0, 5, 1e-4)
    assert full.output == Output(True, True, probes=("ball_top", "tip"))
    assert full.petsc == {"snes_rtol": "1e-08", "ksp_type": "cg", "snes_monitor": "true", "ksp_max_it": "200"}
    assert full.displacements == [Displacement("ball_top", ("free", "free", -0.02), ((0.0, 0.0), (1.0, 1.0)))]
    assert full.loads == [
        Load("block_top", pressure=10.0),
        Load("block_left", traction=(1.0, 0.0, 0.0), amplitude=((0.0, 1.0),)),
        Load("ball", body_force=(0.0, 0.0, -9.81)),
    ]


def test_full_contacts(full):
    pair, floor, ball, pipe = full.contacts
    assert pair == Contact(
        "ball_skin", "block_top", name="ball-block", friction=0.3, formulation="nitsche", theta=0.0,
        gamma0=10.0, quadrature=7, search="closest_point", search_radius=2.0, interference="resolve",
    )  # fmt: skip
    assert floor == Contact("block_bottom", name="floor", obstacle=floor.obstacle)
    assert floor.obstacle == Obstacle("plane", point=(0.0, 0.0, -1.0), normal=(0.0, 0.0, 1.0))
    assert ball.name == "block_left-sphere" and ball.tresca == 5.0 and ball.obstacle.inside
    assert ball.obstacle.displacement == (0.0, 0.0, 0.1) and ball.obstacle.amplitude == (
        (0.0, 0.0),
        (0.5, 1.0),
    )
    assert pipe.obstacle == Obstacle("cylinder", point=(3.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0), radius=1.5)


def test_numbers_become_float(full):
    values = [full.materials["aluminium"].E, full.contacts[0].theta, full.contacts[0].gamma0, full.steps.end]
    assert all(type(value) is float for value in values)
    assert type(full.steps.count) is int


def test_plain_scene_has_defaults(write):
    scene = read_scene(write(PLAIN))
    assert scene.title == "" and scene.petsc == {} and scene.loads == [] and scene.displacements == []
    assert scene.steps == Steps(1.0, 1, None) and scene.output == Output(True)
    assert scene.contacts[0].name == "ball_skin-block_top"


def test_contact_numerics_are_not_said(write):
    contact = read_scene(write(PLAIN)).contacts[0]
    keys = ("formulation", "theta", "gamma0", "quadrature", "search", "search_radius", "interference")
    assert [getattr(contact, key) for key in keys] == [None] * 7


def test_smallest_step():
    assert Steps(2.0, 4).smallest_step == 2.0 / 4 / 1024
    assert Steps(2.0, 4, 0.1).smallest_step == 0.1


def test_byte_order_mark_and_dos_lines(write):
    assert (
        read_scene(write(b"\xef\xbb\xbf" + PLAIN.replace("\n", "\r\n").encode())).bodies[0].region == "block"
    )


@pytest.mark.parametrize("kinematics", ["plane_strain", "plane_stress", "axisymmetric"])
def test_kinematics(write, kinematics):
    text = changed(PLAIN, 'block.msh"', f'block.msh"\nkinematics = "{kinematics}"\norder = 2')
    assert read_scene(write(text)).mesh == MeshSpec("ball_on_block.msh", 2, kinematics)


@pytest.mark.parametrize("formulation", ["penalty", "augmented_lagrangian"])
def test_formulations_are_read(write, formulation):
    more = (
        f'formulation = "{formulation}"\nsearch = "ray_tracing"\nunbiased = true\ninterference = "adjust"\n'
    )
    contact = read_scene(write(PLAIN + more)).contacts[0]
    assert (contact.formulation, contact.search, contact.interference) == (
        formulation,
        "ray_tracing",
        "adjust",
    )
    assert contact.unbiased is True


def test_petsc_options_become_strings(write):
    text = '[petsc]\nrho = 0.5\nlist = [1, 2.5, "a"]\nflag = ""\nno = false\n"-dash" = 1\n'
    expected = {"rho": "0.5", "list": "1,2.5,a", "flag": "", "no": "false", "dash": "1"}
    assert read_scene(write(PLAIN + text)).petsc == expected


# ---------------------------------------------------------------- keys and tables of the file


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("title", "titel", ("titel: found", "'title' in the scene")),
        ("[steps]", "[step]", ("step: found", "'steps'")),
        ("order", "ordre", ("mesh.ordre", "'order' in [mesh]", "kinematics")),
        ("E = 210e3", "Emod = 210e3", ("materials.steel.Emod", "'E' in [materials.NAME]", "yield_stress")),
        ("E = 210e3", "e = 210e3", ("materials.steel.e", "'E' in [materials.NAME]")),
        ("friction", "frictoin",
         ("contacts[0] (ball-block).frictoin", "'friction' in [[contacts]]", "tresca")),
        ("friction = 0.3", "pressure = 1", ("contacts[0] (ball-block).pressure", "'pressure' in [[loads]]")),
        ("inside", "insde", ("contacts[2].obstacle.insde", "'inside' in obstacle")),
        ("point = [0", "piont = [0", ("contacts[1] (floor).obstacle.piont", "'point' in obstacle")),
        ("value", "values", ("displacements[0] (ball_top).values", "'value' in [[displacements]]")),
        ("traction", "tracton", ("loads[1] (block_left).tracton", "'traction' in [[loads]]")),
        ('material = "steel"', 'materials = "steel"',
         ("bodies[1] (ball).materials", "'material' in [[bodies]]")),
        ("min_step", "minstep", ("steps.minstep", "'min_step' in [steps]")),
        ("probes", "probe", ("output.probe", "'probes' in [output]")),
        ("title", "path", ("path: found an unknown key", "bodies, contacts")),
    ],
)  # fmt: skip
def test_unknown_key(write, old, new, parts):
    message = refused(
        lambda: read_scene(write(changed(FULL, old, new))), "scene.toml: ", "unknown key", *parts
    )
    assert "path" not in message.split("allowed: ")[1]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (changed(PLAIN, "[[contacts]]", "[contacts]"), ("contacts: found a table", "[[contacts]]")),
        (changed(PLAIN, "[[bodies]]", "[bodies]"), ("bodies: found a table", "[[bodies]]")),
        (changed(PLAIN, "[mesh]", "[[mesh]]"), ("mesh: found a list", "a table [mesh]")),
        (changed(PLAIN, "[materials.steel]", "[[materials]]"),
         ("materials: found a list", "[materials.NAME]")),
        (changed(PLAIN, "[materials.steel]", "[materials]"), ("materials.E: found a number 1.0", "a table")),
        ("steps = 3\n" + PLAIN, ("steps: found an integer 3", "a table [steps]")),
        ("loads = [1]\n" + PLAIN, ("loads[0]: found an integer 1", "a table [[loads]]")),
        ("petsc = 'x'\n" + PLAIN, ("petsc: found a string 'x'", "a table of option names")),
        ("title = 3\n" + PLAIN, ("title: found an integer 3", "a string")),
        (PLAIN + "obstacle = 3\n", ("contacts[0].obstacle: found an integer 3", "a table obstacle")),
        (PLAIN + "[petsc]\na = {b = 1}\n", ("petsc.a: found a table", "a string, a boolean")),
        (PLAIN + "[petsc]\na = inf\n", ("petsc.a: found a number inf", "a finite number")),
        (PLAIN + "[petsc]\n'a b' = 1\n", ("petsc: found an option named 'a b'", "without blanks")),
        ("", ("mesh.file: found nothing", "the name of a mesh file")),
        (changed(PLAIN, "E = 1.0", ""), ("materials.steel.E: found nothing", "a number > 0")),
        (changed(PLAIN, 'region = "block"', ""), ("bodies[0].region: found nothing", "a string")),
        (changed(PLAIN, 'source = "ball_skin"', ""), ("contacts[0].source: found nothing", "a string")),
        (PLAIN + "[[displacements]]\nregion='a'\n", ("displacements[0] (a).value: found nothing", '"free"')),
        (PLAIN + "obstacle.point = [0, 0]\n",
         ("contacts[0] (ball_skin-block_top).obstacle.shape: found nothing", '"plane" | "sphere"')),
    ],
)  # fmt: skip
def test_shape_of_the_file(write, text, parts):
    refused(lambda: read_scene(write(text)), "scene.toml: ", *parts)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[mesh\n", ("line 1, column 6: found expected ']'", "in '[mesh'", "allowed: TOML")),
        ("a = 1\r\n  b = \r\n", ("line 2, column 7: found invalid value in 'b ='",)),
        ("a = [1, 2", ("end of document: found",)),
        ("a = 1\na = 2\n", ("line 2, column 6: found cannot overwrite a value in 'a = 2'",)),
        ("o = {a = 1}\no.b = 2\n", ("line 2, column", "inside the braces")),
        (b"title = '\xff'\n", ("byte 9: found text that is not UTF-8", "UTF-8")),
        ("b = 1\n" + "a." * 100000 + "a = 1\n", ("line 2", "more than 30 parts", "allowed: keys of a scene")),
        ("b = 1\n[" + "'a b' . " * 100000 + "a]\n", ("line 2", "more than 30 parts")),
        ("a = " + "[" * 5000, ("scene.toml: somewhere: found",)),
        ("a = " + "9" * 5000, ("scene.toml: somewhere: found",)),
    ],
)  # fmt: skip
def test_text_that_is_not_toml(write, text, parts):
    refused(lambda: read_scene(write(text)), "scene.toml: ", *parts)


def test_no_scene_file(tmp_path):
    refused(lambda: read_scene(tmp_path / "none.toml"), "none.toml: file: found no such file", "a scene file")
    refused(lambda: read_scene(tmp_path), "file: found a directory", "a scene file")


def test_keys_with_strange_characters_stay_on_one_line(write):
    refused(lambda: read_scene(write('"a\\nb" = 1\n' + PLAIN)), "a\\nb: found an unknown key")


def test_an_obstacle_with_a_mass(write):
    """It says what moves freely instead."""
    text = PLAIN + '[[contacts]]\nsource = "a"\nobstacle = { shape = "plane", mass = 3.0 }\n'
    refused(lambda: read_scene(write(text)), "obstacle.mass: found a key that there is not",
            "group of [[couplings]]")  # fmt: skip


# ---------------------------------------------------------------- values


@pytest.mark.parametrize(("old", "new", "key", "found", "allowed"), value_cases())
def test_bad_value(write, old, new, key, found, allowed):
    path = write(changed(FULL, old, new))
    tomllib.loads(path.read_text())  # the case is about a value, not about TOML
    message = refused(lambda: read_scene(path))
    file, _, rest = message.partition(": ")
    where, _, rest = rest.partition(": found ")
    what, _, may = rest.partition("; allowed: ")
    assert file == str(path) and where == key
    assert found in what
    assert allowed in may


def test_no_bodies(write):
    text = re.sub(r"\[\[bodies\]\]\n.*\n.*\n", "", PLAIN)
    refused(lambda: read_scene(write(text)), "scene.toml: bodies: found no body", "at least one [[bodies]]")


def test_same_direction_prescribed_twice(write):
    text = PLAIN + '[[displacements]]\nregion = "a"\nvalue = [0, "free"]\n'
    assert read_scene(
        write(text + text.split("]\n")[0][:0] + '[[displacements]]\nregion = "a"\nvalue = ["free", 0]\n')
    )
    again = text + '[[displacements]]\nregion = "a"\nvalue = [0, 0]\n'
    refused(lambda: read_scene(write(again)), "displacements[1] (a).value", "direction 0", "once")


# ---------------------------------------------------------------- from Python


def test_built_in_python(tmp_path):
    scene = built(
        tmp_path,
        contacts=[Contact("a", obstacle=Obstacle("plane", point=np.zeros(2), normal=np.array([0, 1])))],
        displacements=[Displacement("top", ["free", np.float64(1.0)], amplitude=np.array([[0, 0], [1, 2]]))],
        steps=Steps(count=np.int64(3)),
        petsc={"snes_rtol": 1e-8},
    )
    validate(scene)
    validate(scene)  # a second time changes nothing
    assert scene.contacts[0].name == "a-plane" and scene.contacts[0].obstacle.normal == (0.0, 1.0)
    assert scene.displacements[0] == Displacement("top", ("free", 1.0), ((0.0, 0.0), (1.0, 2.0)))
    assert type(scene.steps.count) is int and scene.petsc == {"snes_rtol": "1e-08"}
    assert scene.where == "scene" and type(scene.materials["rubber"].E) is float


@pytest.mark.parametrize(
    ("keys", "parts"),
    [
        ({"materials": {"rubber": Material(-1, 0.3)}},
         ("materials.rubber.E: found an integer -1", "a number > 0")),
        ({"materials": [Material(1, 0.3)]}, ("materials: found a list", "a dict")),
        ({"materials": {1: Material(1, 0.3)}}, ("materials: found an integer 1", "a string")),
        ({"materials": {"rubber": {"E": 1}}}, ("materials.rubber: found a table", "Material")),
        ({"bodies": Body("block", "rubber")}, ("bodies: found a value of type Body", "a list")),
        ({"bodies": [("block", "rubber")]}, ("bodies[0]: found a list", "Body")),
        ({"bodies": []}, ("bodies: found no body", "at least one")),
        ({"mesh": "mesh.msh"}, ("mesh: found a string 'mesh.msh'", "MeshSpec")),
        ({"mesh": MeshSpec("nowhere/mesh.msh")},
         ("mesh.file: found 'nowhere/mesh.msh', no such file", "beside")),
        ({"contacts": [Contact("a", "b", theta=2)]},
         ("contacts[0] (a-b).theta: found an integer 2", "1 | 0 | -1")),
        ({"contacts": [Contact("a", "b"), Contact("a", "b")]}, ("contacts[1] (a-b).name", "a second time")),
        ({"contacts": [Contact("a", obstacle={"shape": "plane"})]},
         ("contacts[0].obstacle: found a table", "Obstacle")),
        ({"contacts": [Contact(None, "b")]}, ("contacts[0].source: found nothing", "a string")),
        ({"steps": None}, ("steps: found nothing", "Steps")),
        ({"petsc": ["-snes_monitor"]}, ("petsc: found a list", "a table")),
        ({"petsc": {"a": None}}, ("petsc.a: found nothing", "a string")),
        ({"output": Output(fields=np.bool_(True), probes="tip")},
         ("output.probes: found a string 'tip'", "a list")),
        ({"loads": [Load("a", pressure=float("nan"))]},
         ("loads[0] (a).pressure: found a number nan", "finite")),
    ],
)  # fmt: skip
def test_bad_scene_in_python(tmp_path, keys, parts):
    refused(lambda: validate(built(tmp_path, **keys)), "scene: ", *parts)


# ---------------------------------------------------------------- numerics: command line, scene, default


def test_resolve_contacts(write):
    scene = read_scene(write(PLAIN + "theta = 1\nquadrature = 5\n"))
    by_scene = resolve_contacts(scene, {}).contacts[0]
    assert (by_scene.theta, by_scene.formulation, by_scene.quadrature) == (1.0, "nitsche", 5)
    assert (by_scene.gamma0, by_scene.search, by_scene.interference) == (None, "closest_point", "resolve")
    by_line = resolve_contacts(scene, {"theta": -1, "gamma0": 3, "search": None}).contacts[0]
    assert (by_line.theta, by_line.gamma0, by_line.search, by_line.quadrature) == (
        -1.0,
        3.0,
        "closest_point",
        5,
    )
    assert scene.contacts[0].gamma0 is None and scene.contacts[0].theta == 1.0


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        ({"theta": 3}, ("command line: -contact_theta: found an integer 3", "1 | 0 | -1")),
        ({"formulation": "none"}, ("command line: -contact_formulation: found a string 'none'", '"penalty"')),
        ({"formulation": "penalty"},
         ("contacts[0] (ball_skin-block_top).theta", '1 with formulation "penalty"')),
    ],
)  # fmt: skip
def test_resolve_contacts_refuses(write, overrides, parts):
    scene = read_scene(write(PLAIN + "theta = 1\n"))
    refused(lambda: resolve_contacts(scene, overrides), *parts)


def test_resolve_contacts_knows_numerics_only(full):
    with pytest.raises(KeyError, match="friction"):
        resolve_contacts(full, {"friction": 0.1})


@pytest.mark.parametrize(("old", "new", "left"), [
    ("", "unbiased = true", "self contact"), ('"block_top"', '"ball_skin"', "unbiased contact"),
])  # fmt: skip
def test_unbiased_and_self_contact(write, old, new, left):
    scene = read_scene(write(changed(PLAIN, old, new) if old else PLAIN + new))
    active, left_out = describe(scene, 2)
    assert left in left_out and not {"self contact", "unbiased contact"} <= set(left_out)
    said = "weight 1/2" if left == "self contact" else "ball_skin with itself"
    assert said in active[2]
