"""Level sets given as expressions: parsed into a tree of numpy operations, never executed as Python.

Whatever is not listed here is refused when the scene is read. Numbers are floats, the size of the tree is bounded, and
each node costs one operation per point, so that no expression can take long.

Functions of place and time that a Python program gives in the place of expressions, and the watch over them.
"""

import ast
import hashlib
import inspect
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pcontact.runtime.errors import coordinates, input_error

# letters; nodes of the tree; nodes from the root to a leaf
LONGEST, MOST, DEEPEST = 2000, 500, 100
VARIABLES = ("x", "y", "z", "t")
CONSTANTS = {"pi": np.pi}
# variables of conditions: place, and outward normal
NORMAL = ("nx", "ny", "nz")
PLACES = ("x", "y", "z", *NORMAL)
# [sizes of the mesh] Difference of two numbers that are equal in a condition
EQUAL = 1e-6
# [parts of the run] In each of which a comparison turns once at most, or else something in it does. From: chosen.
PARTS = 1000
# [-] How often one of them is halved to find where. From: doubles have 53 digits.
HALVINGS = 60
# operations that are smooth but where their argument, or the difference of both, is zero
TURNING = (np.abs, np.minimum, np.maximum)
# kinds of numpy's types that are no real numbers: complex numbers and booleans
NOT_REAL = "cb"


def _over(a, b):
    """a / b, and zero where b is zero: slopes have no direction there."""
    return np.where(b != 0.0, a / np.where(b != 0.0, b, 1.0), 0.0)


def _power(u, v):
    """Slopes of u^v; that in v is asked for where the exponent varies only."""
    return np.where(v == 0.0, 0.0, v * u ** (v - 1.0)), lambda: u**v * np.log(u)


# name: number of arguments, value, slope in each argument
FUNCTIONS = {
    "sqrt": (1, np.sqrt, lambda u: (0.5 / np.sqrt(u),)),
    "exp": (1, np.exp, lambda u: (np.exp(u),)),
    "log": (1, np.log, lambda u: (1.0 / u,)),
    "abs": (1, np.abs, lambda u: (np.sign(u),)),
    "sin": (1, np.sin, lambda u: (np.cos(u),)),
    "cos": (1, np.cos, lambda u: (-np.sin(u),)),
    "tan": (1, np.tan, lambda u: (1.0 + np.tan(u) ** 2,)),
    "asin": (1, np.arcsin, lambda u: (1.0 / np.sqrt(1.0 - u**2),)),
    "acos": (1, np.arccos, lambda u: (-1.0 / np.sqrt(1.0 - u**2),)),
    "atan": (1, np.arctan, lambda u: (1.0 / (1.0 + u**2),)),
    "sinh": (1, np.sinh, lambda u: (np.cosh(u),)),
    "cosh": (1, np.cosh, lambda u: (np.sinh(u),)),
    "tanh": (1, np.tanh, lambda u: (1.0 - np.tanh(u) ** 2,)),
    "hypot": (2, np.hypot, lambda u, v: (_over(u, np.hypot(u, v)), _over(v, np.hypot(u, v)))),
    "atan2": (2, np.arctan2, lambda u, v: (_over(v, u**2 + v**2), -_over(u, u**2 + v**2))),
    "min": (2, np.minimum, lambda u, v: (np.where(u <= v, 1.0, 0.0), np.where(u <= v, 0.0, 1.0))),
    "max": (2, np.maximum, lambda u, v: (np.where(u >= v, 1.0, 0.0), np.where(u >= v, 0.0, 1.0))),
}
# those that take more arguments, too, two at a time
MANY = ("min", "max")
OPERATORS = {
    ast.Add: (np.add, lambda u, v: (1.0, 1.0)),
    ast.Sub: (np.subtract, lambda u, v: (1.0, -1.0)),
    ast.Mult: (np.multiply, lambda u, v: (v, u)),
    ast.Div: (np.divide, lambda u, v: (1.0 / v, -u / v**2)),
    ast.Pow: (np.power, _power),
    ast.USub: (np.negative, lambda u: (-1.0,)),
    ast.UAdd: (np.positive, lambda u: (1.0,)),
}
# what Python calls some of the things that are refused
WORDS = {
    ast.BinOp: "an operator other than + - * / **",
    ast.UnaryOp: "a sign other than + -",
    ast.Compare: "a comparison that is no part of A if B < C else D",
    ast.Attribute: "an attribute",
    ast.Subscript: "an index",
}
COMPARISONS = {ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal}
ALLOWED = (
    "an expression of x, y, z, t, pi, numbers, + - * / **, A if B < C else D (< <= > >=), and the functions "
    f"{', '.join(FUNCTIONS)}"
)

CONDITION = (
    "a condition on x, y, z and, of facets, the outward normal nx, ny, nz: comparisons < <= > >= == of expressions of "
    f"these, pi, numbers, + - * / **, and the functions {', '.join(FUNCTIONS)}; joined by and, or, not"
)


class Expression:
    """A function of place and time, with its gradient in closed form.

    Parameters
    ----------
    text : str

    Attributes
    ----------
    names : set of str
        Variables that it has.

    Raises
    ------
    ValueError
        What is wrong, and where in the text.
    """

    variables = VARIABLES

    def __init__(self, text):
        if len(text) > LONGEST:
            raise ValueError(f"{len(text)} characters, at most {LONGEST}")
        self.names, self._count = set(), 0
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                tree = ast.parse(" ".join(text.split()), mode="eval").body
        except SyntaxError as error:
            raise ValueError(f"{error.msg} at character {error.offset or 1}") from None
        except (RecursionError, MemoryError):
            raise ValueError("brackets or signs that are nested too deep") from None
        self._root = self._top(tree)

    def __call__(self, x, time):
        """Values (n,) at points x (n, d) [length]."""
        with np.errstate(all="ignore"):  # who asks finds what is not finite
            value = _value(self._root, _places(x, time))
        return np.broadcast_to(value, len(x)).astype(float)

    def gradient(self, x, time):
        """Gradient (n, d) at points x (n, d) [length]: derivatives go along with the values, from the leaves on."""
        places = _places(x, time)
        slopes = {name: np.eye(x.shape[1])[axis][:, None] for axis, name in enumerate(VARIABLES[: x.shape[1]])}
        with np.errstate(all="ignore"):
            slope = _slope(self._root, places, slopes)[1]
        return np.zeros(x.shape) if slope is None else np.broadcast_to(slope.T, x.shape).astype(float)

    def corners(self, end):
        """Times (n,) from 0 to an end at which ``min``, ``max``, ``abs`` and ``if`` go over to another branch: those
        that the time alone says."""
        if "t" not in self.names:
            return np.zeros(0)
        with np.errstate(all="ignore"):
            return np.unique(_corners(self._root, np.linspace(0.0, end, PARTS + 1)))

    def _top(self, tree):
        return self._node(tree, 0)

    def _counted(self, depth):
        """Count a node of the tree, and refuse what is too long or too deep."""
        self._count += 1
        if self._count > MOST or depth > DEEPEST:
            raise ValueError(f"more than {MOST} operations, or nested deeper than {DEEPEST}")

    def _node(self, tree, depth):
        """A node of ours for one of Python's: (kind, ...), with nodes in it."""
        self._counted(depth)

        def inner(*trees):
            return tuple(self._node(one, depth + 1) for one in trees)

        if isinstance(tree, ast.Constant):
            return ("number", _number(tree))
        if isinstance(tree, ast.Name):
            return self._name(tree)
        if isinstance(tree, ast.UnaryOp | ast.BinOp) and type(tree.op) in OPERATORS:
            parts = (tree.operand,) if isinstance(tree, ast.UnaryOp) else (tree.left, tree.right)
            return ("operation", *OPERATORS[type(tree.op)], inner(*parts))
        if isinstance(tree, ast.Call):
            arity, value, slope = _function(tree)
            nodes = inner(*tree.args)
            while len(nodes) > arity:
                pairs = [nodes[k : k + 2] for k in range(0, len(nodes), 2)]
                nodes = [("operation", value, slope, pair) if len(pair) == 2 else pair[0] for pair in pairs]
            return ("operation", value, slope, tuple(nodes))
        if isinstance(tree, ast.IfExp):
            test = tree.test
            if not isinstance(test, ast.Compare) or len(test.ops) != 1 or type(test.ops[0]) not in COMPARISONS:
                raise _refused(test, "a condition other than one comparison with < <= > >=")
            parts = inner(test.left, test.comparators[0], tree.body, tree.orelse)
            return ("choice", COMPARISONS[type(test.ops[0])], parts)
        raise _refused(tree, WORDS.get(type(tree), f"{type(tree).__name__}, which is no part of an expression"))

    def _name(self, tree):
        if tree.id in CONSTANTS:
            return ("number", CONSTANTS[tree.id])
        if tree.id not in self.variables:
            raise _refused(tree, f"the name {tree.id[:40]!r}")
        self.names.add(tree.id)
        return ("place", tree.id)


def _refused(tree, what):
    return ValueError(f"{what} at character {tree.col_offset + 1}")


def _number(tree):
    value = tree.value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _refused(tree, "something that is not a number")
    try:
        value = float(value)
    except OverflowError:
        value = np.inf
    if not np.isfinite(value):
        raise _refused(tree, "a number that is not finite")
    return value


def _function(tree):
    """Number of arguments, value and slope of what is called."""
    name = tree.func.id if isinstance(tree.func, ast.Name) else None
    if name not in FUNCTIONS:
        raise _refused(tree.func, "a call of something that is none of the functions")
    arity = FUNCTIONS[name][0]
    given = len(tree.args)
    if tree.keywords or given < arity or (given > arity and name not in MANY):
        more = " or more" if name in MANY else ""
        raise _refused(tree, f"{name} with other arguments than {arity}{more}")
    return FUNCTIONS[name]


def _places(x, time):
    """Values of the variables; z is zero in the plane."""
    places = dict(zip(VARIABLES, (*x.T, *[np.zeros(len(x))] * (3 - x.shape[1])), strict=False))
    return {**places, "t": np.float64(time)}


def _value(node, places):
    kind, *rest = node
    if kind == "number":
        return np.float64(rest[0])
    if kind == "place":
        return places[rest[0]]
    if kind == "operation":
        return rest[0](*(_value(one, places) for one in rest[2]))
    left, right, yes, no = (_value(one, places) for one in rest[1])
    return np.where(rest[0](left, right), yes, no)


def _corners(node, times):
    """Times (n,) at which a node of an expression turns, each to the last digit: between those at which its parts do it
    turns once at most where these are linear, and so nothing is missed."""
    kind, *rest = node
    if kind in ("number", "place"):
        return np.zeros(0)
    parts = rest[1] if kind == "choice" else rest[2]
    inner = np.concatenate([_corners(one, times) for one in parts])
    if kind != "choice" and rest[0] not in TURNING:
        return inner

    def side(time):
        values = [_value(one, {"t": time}) for one in parts[:2]]
        if kind == "choice":
            return np.where(rest[0](*values), 1.0, -1.0)
        return np.nan_to_num(np.sign(values[0] if len(values) == 1 else np.subtract(*values)))

    times = np.union1d(times, inner)
    try:
        sides = np.broadcast_to(side(times), times.shape)
    except KeyError:
        # it is told by the place, too: the time is another one at every point
        return inner
    before = np.flatnonzero(sides[1:] != sides[:-1])
    low, high, first = times[before], times[before + 1], sides[before]
    for _ in range(HALVINGS):
        middle = low + 0.5 * (high - low)
        same = side(middle) == first
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    # what is zero to the last is smooth from there on, what is not turns with the first that is something else
    return np.concatenate([inner, np.where(first == 0.0, low, high)])


def _slope(node, places, slopes):
    """Value, and slope (d, n) or (d, 1); None where nothing varies."""
    kind, *rest = node
    if kind in ("number", "place"):
        return _value(node, places), slopes.get(rest[0]) if kind == "place" else None
    if kind == "choice":
        (left, _), (right, _), (yes, up), (no, down) = (_slope(one, places, slopes) for one in rest[1])
        chosen = rest[0](left, right)
        if up is None and down is None:
            return np.where(chosen, yes, no), None
        return np.where(chosen, yes, no), np.where(chosen, 0.0 if up is None else up, 0.0 if down is None else down)
    values, inner = zip(*(_slope(one, places, slopes) for one in rest[2]), strict=True)
    total = None
    for outer, own in zip(rest[1](*values), inner, strict=True):
        if own is not None:
            outer = outer() if callable(outer) else outer
            # the root of zero has an infinite slope; what does not vary there stays so
            part = np.where(own == 0.0, 0.0, outer * own)
            total = part if total is None else total + part
    return rest[0](*values), total


class Condition(Expression):
    """A condition on places and outward normals of a mesh.

    Parameters
    ----------
    text : str
        Comparisons of expressions of `PLACES`, such as ``0 < x < 1``, joined by ``and``, ``or``, ``not``.

    Attributes
    ----------
    names : set of str
        Variables that it has.

    Raises
    ------
    ValueError
        What is wrong, and where in the text.
    """

    variables = PLACES

    def __call__(self, x, normal, size):
        """Flags (n,) of points x (n, d) [length] with normals (n, d) or None; a size of the mesh [length] says what ==
        means."""
        places = {**_places(x, 0.0), **({} if normal is None else dict(zip(NORMAL, normal.T, strict=False)))}
        places.setdefault("nz", np.zeros(len(x)))
        with np.errstate(all="ignore"):
            return np.broadcast_to(_holds(self._root, places, EQUAL * size), len(x))

    def _top(self, tree):
        return self._test(tree, 0)

    def _test(self, tree, depth):
        """A condition: ("test", comparison or None for ==, both sides), or ("all" | "any" | "not", conditions)."""
        self._counted(depth)
        if isinstance(tree, ast.BoolOp):
            kind = "all" if isinstance(tree.op, ast.And) else "any"
            return (kind, [self._test(one, depth + 1) for one in tree.values])
        if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.Not):
            return ("not", [self._test(tree.operand, depth + 1)])
        if not isinstance(tree, ast.Compare):
            raise _refused(tree, "something that is no comparison")
        if not all(type(one) in COMPARISONS or isinstance(one, ast.Eq) for one in tree.ops):
            raise _refused(tree, "a comparison other than < <= > >= ==")
        parts = [self._node(one, depth + 1) for one in (tree.left, *tree.comparators)]
        return ("all", [("test", COMPARISONS.get(type(op)), parts[k : k + 2]) for k, op in enumerate(tree.ops)])


def _holds(node, places, near):
    kind, *rest = node
    if kind == "test":
        left, right = (_value(one, places) for one in rest[1])
        return np.abs(left - right) <= near if rest[0] is None else rest[0](left, right)
    parts = [_holds(one, places, near) for one in rest[0]]
    if kind == "not":
        return np.logical_not(parts[0])
    return (np.logical_and if kind == "all" else np.logical_or).reduce(np.broadcast_arrays(*parts))


def text_of(function: Callable) -> str:
    """Name of a function and a hash of the text that defines it, where there is one: what tells it from others."""
    name = getattr(function, "__qualname__", type(function).__name__)
    try:
        text = inspect.getsource(function).encode()
    except (OSError, TypeError):
        return name
    return f"{name}, text {hashlib.sha256(text).hexdigest()[:16]}"


class Called(str):
    """A function in the place of an expression: its text is what messages and checkpoints call it.

    Parameters
    ----------
    function : callable
        (x (n, d), t) -> (n,).
    """

    def __new__(cls, function: Callable) -> "Called":
        """The text of the function, which it keeps."""
        one = super().__new__(cls, text_of(function))
        one.function = function
        return one

    def __reduce__(self):
        return Called, (self.function,)

    # what its values depend on: it may be the time, too
    names = frozenset("t")

    def corners(self, end: float) -> np.ndarray:
        """None: nobody knows where it has some."""
        return np.zeros(0)

    def __call__(self, x: np.ndarray, time: float) -> np.ndarray:
        """Values (n,) at points x (n, d) [length]."""
        return self.watched("scene", "value")(x, time)

    def watched(self, file: str, key: str) -> "Watched":
        """The function, with the scene and the key for messages."""
        return Watched(self.function, file, key, str(self), False, "one number")


class Watched:
    """A function of the user's; what it must not do becomes an input error.

    Parameters
    ----------
    function : callable
        (x (n, d), t) -> array.
    file, key : str
        Scene and key, for messages.
    name : str
        What the scene calls the function.
    vector : bool
        It returns (n, d) values rather than (n,).
    what : str
        What it returns.
    """

    def __init__(self, function: Callable, file: str, key: str, name: str, vector: bool, what: str = "one distance"):
        self.function, self.file, self.key, self.name, self.vector = function, file, key, name, vector
        self._what = "a gradient" if vector else what

    def __call__(self, x, time):
        """Values of the function.

        Parameters
        ----------
        x : ndarray (n, d)
            Points [length].
        time : float

        Returns
        -------
        ndarray (n,) or (n, d)

        Raises
        ------
        InputError
            On the rank where it happens: the function stops, its values have the wrong shape or are not finite.
        """
        shape = x.shape if self.vector else x.shape[:1]
        allowed = f"{self._what} per point, an array of shape {shape}"
        at = f"at time {time:g}"
        try:
            with np.errstate(all="ignore"):  # what is not finite is found below
                value = self.function(x.copy(), time)
            value = np.asarray(value)
            # converted, complex numbers would lose a part without a word
            value = value if value.dtype.kind in NOT_REAL else value.astype(float, copy=False)
        except (Exception, SystemExit) as error:  # whatever the user's function raises is a fault of the input
            raise self._error(f"{_stop(error)} {at}", allowed) from None
        if value.dtype.kind in NOT_REAL:
            raise self._error(f"values of type {value.dtype} {at}", f"{allowed} of real numbers")
        if value.shape != shape:
            raise self._error(f"an array of shape {value.shape} {at}", allowed)
        bad = np.flatnonzero(~np.isfinite(value.reshape(len(x), -1)).all(axis=1))
        if len(bad):
            first = np.array2string(value[bad[0]], separator=", ")
            raise self._error(f"the value {first} at the point {coordinates(x[bad[0]])} {at}", "finite numbers")
        # on a ridge of the distance it may vanish, but not at every point
        if self.vector and len(x) > 1 and not value.any():
            raise self._error(f"zero at all {len(x)} points {at}", "a gradient, which points into free space")
        return value

    def _error(self, found, allowed):
        return input_error(self.file, self.key, f"{self.name!r}, {found}", allowed)


def _stop(error):
    """Return what ended the user's code, and in which of its lines."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename != __file__]
    line = f" in line {frames[-1].lineno} of {Path(frames[-1].filename).name}" if frames else ""
    return f"{type(error).__name__}{f': {error}' if str(error) else ''}{line}"
