"""Values of scene keys that are more than a number, a word or a name."""

from collections.abc import Mapping

from pcontact.runtime.rules import NON_NEGATIVE, TEXT, Rule, either, entries, number, sequence, text
from pcontact.scene.called import Called
from pcontact.scene.expression import ALLOWED, CONDITION, Condition, Expression


def _function(value):
    if callable(value):
        return value
    module, _, name = TEXT.accept(value).rpartition(":")
    if not module.endswith(".py") or not name.isidentifier():
        raise ValueError
    return value


def _expression(value):
    Expression(TEXT.accept(value))
    return value


def _condition(value):
    Condition(TEXT.accept(value))
    return value


def _pairs(allowed, test):
    """A list of at least one pair of numbers."""

    def accept(value):
        rows = entries(value, sequence("", number(), (2,)), None)
        if not rows:
            raise ValueError
        test(rows)
        return rows

    row = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
    return Rule(allowed, accept, {"type": "array", "items": row, "minItems": 1})


def _check_growing(rows, words, where=""):
    """The first numbers of pairs increase."""
    for index in range(1, len(rows)):
        if rows[index][0] <= rows[index - 1][0]:
            raise ValueError(f"whose {words} do not increase{where and f' {where} {index}'}")


def _check_amplitude(rows):
    _check_growing(rows, "times")


def _check_hardening(rows):
    if rows[0][0] != 0:
        raise ValueError(f"whose first strain is {rows[0][0]:g}")
    if rows[0][1] <= 0:
        raise ValueError(f"whose first stress is {rows[0][1]:g}")
    _check_growing(rows, "strains", "in entry")
    for index in range(1, len(rows)):
        if rows[index][1] < rows[index - 1][1]:
            raise ValueError(f"whose stresses decrease in entry {index}")


def _check_overclosure(rows):
    if len(rows) < 2:
        raise ValueError("of one pair")
    if rows[0][1] != 0:
        raise ValueError(f"whose first pressure is {rows[0][1]:g}")
    _check_growing(rows, "overclosures", "in entry")
    for index in range(1, len(rows)):
        if rows[index][1] <= 0 or rows[index][1] < rows[index - 1][1]:
            raise ValueError(f"whose pressure {rows[index][1]:g} in entry {index} is not positive, or decreases")


def _check_ogden(rows):
    for index, (modulus, power) in enumerate(rows):
        if modulus * power == 0.0:
            raise ValueError(f"whose entry {index} has no stiffness")
    if sum(modulus * power for modulus, power in rows) <= 0:
        raise ValueError("whose shear modulus sum(mu alpha) / 2 is not positive")


def _or_list(allowed, single, several):
    """What one rule accepts, or of lists another one."""
    return Rule(
        allowed, lambda value: (several if isinstance(value, list | tuple) else single).accept(value),
        {"anyOf": [single.schema, several.schema]},
    )  # fmt: skip


def _or_expression(rule, words=()):
    """What a rule accepts, the text of an expression, or from Python a function; `words` are for the rule."""

    def accept(value):
        if isinstance(value, Called):
            return value
        if callable(value) and not isinstance(value, type):
            return Called(value)
        text = isinstance(value, str) and value not in words
        return _expression(value) if text else rule.accept(value)

    return Rule(rule.allowed, accept, {"anyOf": [rule.schema, {"type": "string", "pattern": r"\S"}]})


COEFFICIENT = _or_expression(NON_NEGATIVE)._replace(allowed=f"a number >= 0, or {ALLOWED}")


def _coefficients(value):
    if not isinstance(value, Mapping):
        raise ValueError
    return {TEXT.accept(name): COEFFICIENT.accept(one) for name, one in value.items()}


COEFFICIENTS = Rule(
    f"a table of names and numbers >= 0 or expressions, {ALLOWED}", _coefficients,
    {"type": "object", "additionalProperties": COEFFICIENT.schema},
)  # fmt: skip
SCALAR = _or_expression(number())._replace(allowed=f"a finite number, or {ALLOWED}")
VECTOR = sequence("a list of one finite number per direction (2 or 3)", number(), (2, 3))
STIFFNESSES = sequence(
    "a list of one number >= 0 per direction (2 or 3), not all zero", number(least=0), (2, 3), any
)
STIFFNESSES.schema["contains"] = {"not": {"const": 0}}
MOMENT = _or_list(
    "a finite number in the plane, a list of 3 finite numbers in space", number(), sequence("", number(), (3,))
)
ROTATION = _or_list(
    'a finite number or "free" in the plane, a list of 3 of them in space', either("", "free", number()),
    sequence("", either("", "free", number()), (3,)),
)  # fmt: skip
INERTIA = _or_list(
    "a number >= 0 in the plane, a list of 3 of them about the axes of the mesh in space", number(least=0),
    sequence("", number(least=0), (3,)),
)  # fmt: skip
WAYS = sequence('a list of one finite number or "free" per direction (2 or 3)', either("", "free", number()), (2, 3))
FOUNDATION = _or_list(f"a number > 0, along the normal, or {STIFFNESSES.allowed}", number(above=0), STIFFNESSES)
VECTORS = sequence(
    f"a list of one finite number or expression per direction (2 or 3), {ALLOWED}", _or_expression(number()), (2, 3)
)
COMPONENTS = sequence(
    f'a list of one finite number, "free" or expression per direction (2 or 3), {ALLOWED}',
    _or_expression(either("", "free", number()), ("free",)), (2, 3),
)  # fmt: skip
DIRECTION = sequence("a list of one finite number per direction (2 or 3), not all zero", number(), (2, 3), any)
DIRECTION.schema["contains"] = {"not": {"const": 0}}
FUNCTION = text('"FILE.py:NAME", a function in a Python file beside the scene', _function, r"\.py:[^:]+$")
EXPRESSION = text(ALLOWED, _expression)
PLACE_CONDITION = text(CONDITION, _condition)


def _term(value):
    """A group, a direction, a coefficient."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise ValueError
    region, direction, factor = value
    if not isinstance(region, str) or not region.strip() or direction not in ("x", "y", "z"):
        raise ValueError
    factor = number().accept(factor)
    if factor == 0.0:
        raise ValueError("whose coefficient is zero")
    return region, direction, factor


TERMS = sequence(
    'a list of at least one [group, "x" | "y" | "z", number that is not 0]',
    Rule("", _term, {"type": "array", "minItems": 3, "maxItems": 3}), None, bool,
)  # fmt: skip
TERMS.schema["minItems"] = 1
AMPLITUDE = _pairs("a list of [time, factor] pairs of finite numbers, times increasing", _check_amplitude)
HARDENING_CURVE = _pairs(
    "a list of [equivalent plastic strain, yield stress] pairs, the first strain 0, strains increasing, stresses > 0 "
    "and not decreasing",
    _check_hardening,
)
_OVERCLOSURES = _pairs(
    "a list of at least two [overclosure, pressure] pairs, overclosures increasing, the first pressure 0, all others "
    "> 0 and not decreasing",
    _check_overclosure,
)
_OVERCLOSURES.schema["minItems"] = 2
PRESSURE_OVERCLOSURE = _or_list(f"a number > 0, or {_OVERCLOSURES.allowed}", number(above=0), _OVERCLOSURES)
OGDEN = _pairs("a list of [mu, alpha] pairs, not zero, sum(mu alpha) > 0", _check_ogden)
MOONEY_RIVLIN = sequence("a list of two numbers c10, c01 with c10 + c01 > 0", number(), (2,), lambda c: sum(c) > 0)


def _or_three(rule, words, item):
    """A number, or three along the axes of an orthotropic material."""
    return _or_list(f"{rule.allowed}; {words}", rule, sequence("", item, (3,)))


YOUNG = _or_three(number(above=0), "orthotropic: a list of 3 such numbers, E1, E2, E3", number(above=0))
POISSON = _or_three(
    number(above=-1, below=0.5, words="a number with -1 < nu < 0.5; nearly incompressible: use e.g. 0.4999"),
    "orthotropic: a list of 3 numbers, nu12, nu13, nu23", number(),
)  # fmt: skip
EXPANSION = _or_three(number(), "orthotropic: a list of 3 such numbers, along axes 1, 2, 3", number())
SHEAR = sequence("a list of 3 numbers > 0, G12, G13, G23", number(above=0), (3,))
LAW = TEXT._replace(allowed='"hencky" | "neo_hooke" | "mooney_rivlin" | "ogden", or the name of a law that was added')
NUMBERS = sequence("a list of finite numbers", number(), None)
AXES = sequence(
    "a list of two vectors of 3 numbers, not zero", sequence("", number(), (3,), any), (2,)
)  # fmt: skip
