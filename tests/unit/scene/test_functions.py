"""Level sets from files and from Python."""

import numpy as np
import pytest

from pcontact.runtime.errors import InputError
from pcontact.scene.functions import obstacle_functions, require_no_code
from pcontact.scene.model import Body, Contact, Material, MeshSpec, Obstacle, Scene
from pcontact.scene.reader import read_scene
from pcontact.scene.validate import validate
from tests.support.scenes import LEVEL_SET


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


def test_level_set_from_file(write, tmp_path):
    (tmp_path / "hill.py").write_text(
        "import numpy as np\n"
        "def phi(x, t):\n    return x[:, 1] - t\n"
        "def slope(x, t):\n    return np.tile([0.0, 1.0], (len(x), 1))\n"
    )
    text = LEVEL_SET.replace('"%s"', '"hill.py:phi", gradient = "hill.py:slope"')
    function, gradient = obstacle_functions(read_scene(write(text)), 0)
    x = np.array([[1.0, 2.0], [3.0, 5.0]])
    np.testing.assert_array_equal(function(x, 0.5), [1.5, 4.5])
    np.testing.assert_array_equal(gradient(x, 0.5), [[0, 1], [0, 1]])


def test_level_set_from_python(tmp_path):
    scene = built(
        tmp_path, contacts=[Contact("a", obstacle=Obstacle("level_set", function=lambda x, t: x[:, 0]))]
    )
    validate(scene)
    function, gradient = obstacle_functions(scene, 0)
    assert function.function is scene.contacts[0].obstacle.function and gradient is None
    np.testing.assert_array_equal(function(np.array([[1.0, 2.0]]), 0.0), [1.0])


@pytest.mark.parametrize(
    ("reference", "found"),
    [
        ("hill", "a string 'hill'"),
        ("hill.py", "a string"),
        ("hill.py:1a", "a string"),
        ("gone.py:phi", "no such file"),
    ],
)  # fmt: skip
def test_level_set_reference(write, reference, found):
    key = "contacts[0] (hill).obstacle.function"
    refused(lambda: read_scene(write(LEVEL_SET % reference)), "scene.toml", key, found, "FILE.py:NAME")


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("phi = 3\n", "where phi is an integer 3"),
        ("def psi(x, t): pass\n", "where phi is nothing"),
        ("1 / 0\n", "the file stops with ZeroDivisionError"),
        ("def phi(:\n", "the file stops with SyntaxError"),
        ("import sys\nsys.exit(3)\n", "the file stops with SystemExit: 3"),
    ],
)  # fmt: skip
def test_level_set_file(write, tmp_path, code, found):
    (tmp_path / "hill.py").write_text(code)
    scene = read_scene(write(LEVEL_SET % "hill.py:phi"))
    refused(lambda: obstacle_functions(scene, 0), "scene.toml", "contacts[0] (hill).obstacle.function", found)


@pytest.mark.parametrize(
    ("body", "parts"),
    [
        ("raise KeyError('k')", ("KeyError: 'k' in line 3 of hill.py at time 0.5", "one distance per point")),
        ("import sys; sys.exit(1)", ("SystemExit: 1 in line 3 of hill.py", "one distance per point")),
        ("return x", ("an array of shape (2, 2)", "an array of shape (2,)")),
        ("return 1.0", ("an array of shape ()", "an array of shape (2,)")),
        ("return None", ("an array of shape ()", "an array of shape (2,)")),
        ("return 'far'", ("ValueError: could not convert", "one distance per point")),
        ("return np.sqrt(x[:, 1] - 3)", ("the value nan at the point (1, 2) at time 0.5", "finite numbers")),
        ("x[:] = 0; return x[:, 0] / 0", ("the value nan", "finite numbers")),
    ],
)  # fmt: skip
def test_level_set_that_misbehaves(write, tmp_path, body, parts):
    (tmp_path / "hill.py").write_text(f"import numpy as np\ndef phi(x, t):\n    {body}\n")
    function, _ = obstacle_functions(read_scene(write(LEVEL_SET % "hill.py:phi")), 0)
    x = np.array([[1.0, 2.0], [3.0, 5.0]])
    refused(lambda: function(x, 0.5), "contacts[0] (hill).obstacle.function: found 'hill.py:phi', ", *parts)
    assert x[1, 1] == 5.0


def test_gradient_that_misbehaves(tmp_path):
    obstacle = Obstacle("level_set", function=lambda x, t: x[:, 0], gradient=lambda x, t: x[:, 0])
    _, gradient = obstacle_functions(built(tmp_path, contacts=[Contact("a", obstacle=obstacle)]), 0)
    key = "contacts[0] (a-level_set).obstacle.gradient: found '<lambda>'"
    refused(lambda: gradient(np.ones((3, 2)), 0.0), key, "shape (3,)", "a gradient per point", "(3, 2)")
    obstacle.gradient = lambda x, t: 0 * x
    _, gradient = obstacle_functions(built(tmp_path, contacts=[Contact("a", obstacle=obstacle)]), 0)
    refused(lambda: gradient(np.ones((3, 2)), 0.0), key, "zero at all 3 points", "free space")


@pytest.mark.parametrize(
    ("more", "key"),
    [
        ('[petsc]\npc_type = "python"\n', "petsc.pc_type: found 'python'"),
        ('[petsc]\nmg_levels_pc_Python_type = "evil.PC"\n', "petsc.mg_levels_pc_Python_type"),
        ('[petsc]\npc_composite_pcs = ["jacobi", "python"]\n', "petsc.pc_composite_pcs: found 'jacobi,python'"),
        ('[petsc]\noptions_view = "ascii:evil.sh"\n', "petsc.options_view"),
        ('[petsc]\ndraw_save = "a; evil"\n', "petsc.draw_save"),
        ('[petsc]\nviewer_binary_filename = "../.profile"\n', "petsc.viewer_binary_filename"),
        ('[petsc]\nviewer_binary_filename = "/etc/a"\n', "petsc.viewer_binary_filename"),
    ],
)  # fmt: skip
def test_options_that_are_programs(write, more, key):
    text = LEVEL_SET.replace('function = "%s"', 'expression = "y"')
    scene = read_scene(write(text + more))
    refused(lambda: require_no_code(scene), "scene.toml", key, "with -no_code")


@pytest.mark.parametrize("name", ["a.geo", "a.GEO", "a.geo_unrolled"])
def test_geometries_that_are_programs(tmp_path, name):
    scene = built(tmp_path, mesh=MeshSpec(tmp_path / "mesh.msh", geometry=name))
    refused(lambda: require_no_code(scene), f"mesh.geometry: found {name!r}", "with -no_code", ".step")


def test_settings_of_numba_are_a_program(tmp_path, monkeypatch):
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: kernels\n")
    monkeypatch.chdir(tmp_path)
    refused(lambda: require_no_code(built(tmp_path)), ".numba_config.yaml", "with -no_code")


def test_data_are_no_programs(tmp_path):
    words = {"pc_type": "hypre", "snes_rtol": "1e-08", "ksp_monitor": "", "relax": "l1scaled-SOR/Jacobi", "on": "0,1"}
    require_no_code(built(tmp_path, mesh=MeshSpec(tmp_path / "mesh.msh", geometry="a.step"), petsc=words))
