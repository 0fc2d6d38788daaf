"""Level sets as expressions: values and slopes, the same runs as with functions, and what is refused."""

import json
import time

import numpy as np
import pytest

from meshes import one_block
from pcontact.runtime.errors import InputError
from pcontact.runtime.parallel import on_root
from pcontact.runtime.petsc import MPI
from pcontact.scene.expressions import FUNCTIONS, Condition, Expression
from pcontact.scene.functions import obstacle_functions
from pcontact.scene.model import Body, Contact, Displacement, Material, MeshSpec, Obstacle, Output, Scene, Steps
from pcontact.simulation import Simulation

WORLD = MPI.COMM_WORLD
parallel = pytest.mark.parallel
POINTS = np.random.default_rng(3).uniform(0.1, 0.9, (40, 3))
# text, and the same in Python
TWINS = [
    ("sqrt(x**2 + y**2) - 1 + 0.1*t", lambda x, y, z, t: np.sqrt(x**2 + y**2) - 1 + 0.1 * t),
    ("-(x - 2.5e-1) / +y ** z", lambda x, y, z, t: -(x - 0.25) / y**z),
    ("x if x*t < y else z - pi", lambda x, y, z, t: np.where(x * t < y, x, z - np.pi)),
    ("z if 0.3 >= x else (y if x <= 0.6 else 1)",
     lambda x, y, z, t: np.where(x <= 0.3, z, np.where(x <= 0.6, y, 1))),
    ("min(x, y, z, 0.5) + max(x - y, y - x)",
     lambda x, y, z, t: np.min([x, y, z, 0 * x + 0.5], axis=0) + np.abs(x - y)),
    ("2 ** x - x ** 0 + y ** -1.5", lambda x, y, z, t: 2**x - 1 + y**-1.5),
    ("hypot(x, y - t) + atan2(z, x)", lambda x, y, z, t: np.hypot(x, y - t) + np.arctan2(z, x)),
    ("z\n  - 0.01*\n sin(2*pi*x)", lambda x, y, z, t: z - 0.01 * np.sin(2 * np.pi * x)),
    *((f"{name}({', '.join('xyz'[: FUNCTIONS[name][0]])})", None) for name in FUNCTIONS),
]  # fmt: skip


@pytest.mark.parametrize("text, twin", TWINS)
def test_values_and_slopes(text, twin):
    """Values are those of numpy, slopes those of the values."""
    function = Expression(text)
    if twin is not None:
        np.testing.assert_allclose(function(POINTS, 0.7), twin(*POINTS.T, 0.7), rtol=1e-14, atol=1e-15)
    h = 1e-6
    for axis, shift in enumerate(h * np.eye(3)):
        slope = (function(POINTS + shift, 0.7) - function(POINTS - shift, 0.7)) / (2 * h)
        np.testing.assert_allclose(function.gradient(POINTS, 0.7)[:, axis], slope, rtol=1e-7, atol=1e-8)


def test_slopes_on_a_ridge():
    """They have no direction there, and are no infinities."""
    zero = np.zeros((2, 2))
    for text in ("sqrt(x**2 + y**2)", "hypot(x, y)", "abs(x)", "atan2(y, x)", "(x**2 + y**2)**0.5", "x**0"):
        np.testing.assert_array_equal(Expression(text).gradient(zero, 0.0), zero)


@pytest.mark.parametrize("text, found", [
    ("x.__class__", "an attribute at character 1"),
    ("(lambda: x)()", "a call of something that is none of the functions at character 2"),
    ("x + eval(y)", "none of the functions at character 5"),
    ("x if x else y", "one comparison"),
    ("x if 0 < y < 1 else y", "one comparison"),
    ("[x for x in y]", "ListComp"),
    ("x < y", "a comparison that is no part"),
    ("x // y", "an operator other than"),
    ("x and y", "BoolOp"),
    ("x[0]", "an index"),
    ("sin(x, y)", "sin with other arguments than 1"),
    ("min(x)", "min with other arguments than 2 or more"),
    ("max(x, *y)", "Starred"),
    ("hypot(x, y=1)", "hypot with other arguments"),
    ("'x'", "not a number"),
    ("x + True", "not a number at character 5"),
    ("1j", "not a number"),
    ("1e999", "not finite"),
    ("9" * 1000, "not finite"),
    ("x = 1", "invalid syntax"),
    ("(x := 1)", "NamedExpr"),
    ("x\0", "null"),
    ("x, y", "Tuple"),
    ("u + x", "the name 'u' at character 1"),
    ("(" * 900 + "x" + ")" * 900, "nested|too deep"),
    ("-" * 1999 + "x", "nested|too deep"),
    ("x" + "**x" * 600, "nested|too deep"),
    ("x" * 2001, "2001 characters, at most 2000"),
])  # fmt: skip
def test_what_is_refused(text, found):
    """At once, with the reason and the place."""
    start = time.monotonic()
    with pytest.raises(ValueError, match=found):
        Expression(text)
    assert time.monotonic() - start < 1.0


def test_no_expression_takes_long():
    """The longest ones: as many operations as are allowed, on numbers of any size."""
    longest = "min(" + "x," * 490 + "y)", "9**9**9**9**9", "+".join(["x**1e300"] * 90), "exp(" * 90 + "x" + ")" * 90
    for text in longest:
        function = Expression(text)
        start = time.monotonic()
        assert function(POINTS, 0.0).shape == (40,) and function.gradient(POINTS, 0.0).shape == (40, 3)
        assert time.monotonic() - start < 1.0


@pytest.mark.parametrize(("text", "times"), [
    ("min(t, 0.2)", [0.2]), ("2*x*max(0.2, t)", [0.2]), ("min(t, 0.2, 1.3 - t)", [0.2, 1.1]), ("abs(t - 1)", [1.0]),
    ("1 if t < 0.3 else 2", [0.3]), ("max(0, max(0, t - 1.25))", [1.25]), ("max(0, 1 - abs(t - 1.1)/2**-20)",
    [1.1 - 2**-20, 1.1, 1.1 + 2**-20]), ("abs(sin(4*t))", [0.0, np.pi / 4, np.pi / 2]), ("sin(4*t) + t**3", []),
    ("max(0, 40*t - y)", []), ("max(x, 0)*t", []), ("sqrt(t - 1)*abs(t - 1.5)", [1.5]), ("max(0, t - 3)", []),
])  # fmt: skip
def test_where_it_turns(text, times):
    """To the last digits, between 0 and 2, however short the pulse; not where a place says when."""
    assert Expression(text).corners(2.0) == pytest.approx(times, rel=1e-15, abs=1e-15)
    # a step that ends at a jump has it
    jump = Expression("1 if t <= 0.3 else 2")
    assert jump(np.zeros((1, 2)), jump.corners(2.0)[0]) == 2.0


def test_what_is_not_finite_is_named(tmp_path):
    """Of the value and of its gradient."""
    obstacle = Obstacle("level_set", expression="log(x) + sqrt(y - 0.5)")
    scene = Scene(MeshSpec("m.msh"), {}, [], [Contact("a", obstacle=obstacle)])
    function, gradient = obstacle_functions(scene, 0)
    where = r"contacts\[0\] \(a-level_set\)\.obstacle\.expression"
    with pytest.raises(InputError, match=rf"{where}: found 'log.* - 0.5\)', the value -inf at the point \(0, 1\)"):
        function(np.array([[0.0, 1.0]]), 0.0)
    with pytest.raises(InputError, match=rf"{where}, its gradient: found .* the value \[ ?1., *inf\] at the point"):
        gradient(np.array([[1.0, 0.5]]), 0.0)


def pressed(path, obstacle):
    """A block pressed on a hill that rises."""
    return Scene(
        mesh=MeshSpec(path), materials={"m": Material(1000.0, 0.3)}, bodies=[Body("block", "m")],
        contacts=[Contact("bottom", obstacle=obstacle, name="hill", friction=0.2)],
        displacements=[Displacement("top", [0.02, -0.01])], steps=Steps(1.0, 3), output=Output(fields=False),
    )  # fmt: skip


def phi(x, t):
    return x[:, 1] + 0.3 * (x[:, 0] - 0.4) ** 2 - 0.02 * t


def slope(x, t):
    return np.column_stack([0.6 * (x[:, 0] - 0.4), np.ones(len(x))])


@parallel
def test_a_run_with_an_expression(shared_tmp):
    """The same as with a function and its gradient, on any number of ranks."""
    path = shared_tmp / "block.msh"
    on_root(WORLD, lambda: one_block(path, 2, 4, "quadrilateral") and None)
    forces = {}
    text = "y + 0.3*(x - 0.4)**2 - 0.02*t"
    for name, said in (("expression", {"expression": text}), ("function", {"function": phi, "gradient": slope})):
        simulation = Simulation(pressed(path, Obstacle("level_set", **said)))
        try:
            assert simulation.run(shared_tmp / name)
        finally:
            simulation.close()
        WORLD.Barrier()
        steps = json.loads((shared_tmp / name / "report.json").read_text())["steps"]
        forces[name] = [step["contacts"]["hill"]["force"] for step in steps]
    assert np.abs(forces["expression"]).max() > 1.0
    np.testing.assert_allclose(forces["expression"], forces["function"], rtol=1e-9, atol=1e-9)


def test_conditions():
    """Joined by and, or, not; == up to a part of the size; normals where there are some."""
    x, normal = np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 1.0 + 1e-8]]), np.array([[0.0, 1.0], [1.0, 0.0], [0.0, -1.0]])
    for text, flags in (
        ("x < 1", [1, 0, 0]), ("0 < x < 2", [0, 1, 0]), ("y == 1", [0, 0, 1]), ("not y == 1", [1, 1, 0]),
        ("x == 0 or ny < -0.5", [1, 0, 1]), ("nx > 0.5 and x >= 1 and y < 1", [0, 1, 0]),
        ("hypot(x, y) <= 1.2", [1, 1, 0]),
        ("1 < 2", [1, 1, 1]), ("(x if y < 0.2 else 5) > 1", [0, 1, 1]), ("not (x < 1 or y > 0.9)", [0, 1, 0]),
        ("z == 0 and nz == 0", [1, 1, 1]),
    ):  # fmt: skip
        assert Condition(text)(x, normal, 1.0).tolist() == [bool(flag) for flag in flags], text
    assert Condition("y == 1")(x, None, 1e-3).tolist() == [False] * 3
    assert Condition("x < nx").names == {"x", "nx"}


@pytest.mark.parametrize(
    ("text", "said"),
    [("x", "no comparison"), ("x and y < 1", "no comparison"), ("(x < 1) + 1 > 0", "a comparison that is no part"),
     ("x != 1", "other than"), ("t < 1", "the name 't'"), ("x.y < 1", "an attribute"), ("x <", "invalid syntax"),
     ("not " * 200 + "x < 1", "nested deeper"), (" or ".join(["x < 1"] * 200), "more than")],
)  # fmt: skip
def test_what_is_no_condition(text, said):
    with pytest.raises(ValueError, match=said):
        Condition(text)
