"""The error that a run is to reach: how much of it is allowed, of what, and what that may cost."""

import re
from collections.abc import Iterable
from dataclasses import field, replace

from pcontact.runtime.rules import BOOLEAN, Rule, number
from pcontact.scene.keys import key, table

# what the error may be of, and whether a name belongs to it
QUANTITIES = {"energy": False, "force": True, "support": True, "displacement": True, "pressure": True}
OF = "energy | force:CONTACT | support:REGION | displacement:PROBE | pressure:CONTACT, or several: energy,force:CONTACT"
# components of forces and displacements, named after a dot: force:CONTACT.x
AXES = "xyz"
# [bytes], [seconds]
SIZES = {"": 1.0, "kb": 2.0**10, "mb": 2.0**20, "gb": 2.0**30, "tb": 2.0**40}
TIMES = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
# [-] An error of more than half is none; one below the other is out of reach of load steps and tolerances.
# From: chosen.
LARGEST, SMALLEST = 0.5, 1e-6
# the least error that the budget allows
BEST = "best"


def _number(value, units):
    """A number, or a text with a number and a unit."""
    if not isinstance(value, str):
        return value
    found = re.fullmatch(r"\s*([0-9.eE+-]+)\s*([A-Za-z%]*)\s*", value)
    if found is None or found[2].lower() not in units:
        raise ValueError
    return float(found[1]) * units[found[2].lower()]


def _error(value):
    """A part, or 0 for the word `BEST`."""
    return 0.0 if value == BEST or (type(value) is float and value == 0.0) else SHARE.accept(value)


def _measured(units, allowed, rule):
    return Rule(allowed, lambda value: rule.accept(_number(value, units)), {"type": ["number", "string"]})


def _of(value):
    if not isinstance(value, str):
        raise ValueError
    each = [one.strip() for one in value.split(",")]
    for one in each:
        word, colon, name = one.partition(":")
        if word not in QUANTITIES or not bool(colon) == bool(name.strip()) == QUANTITIES[word] or each.count(one) > 1:
            raise ValueError
    return ",".join(each)


SHARE = _measured(
    {"": 1.0, "%": 0.01}, f"a part, as 0.02 or 2%, from {SMALLEST:g} to {LARGEST:g}",
    number(least=SMALLEST, most=LARGEST),
)  # fmt: skip
ERROR = Rule(f"{SHARE.allowed}, or {BEST}: the least that the budget allows", _error, SHARE.schema)
QUANTITY = Rule(OF, _of, {"type": "string"})
COUNT = _measured({"": 1.0}, "a number >= 1", number(least=1))
MEMORY = _measured(SIZES, "a number of bytes, or as 16GB", number(above=0))
TIME = _measured(TIMES, "a number of seconds, or as 10min", number(above=0))


def _worded(rule):
    """The rule for an option of the command line, which is a text."""
    return rule._replace(schema={"type": "string"})


@table
class Budget:
    """Most that reaching an error may cost; then the run ends with the best answer it has, and exit status 4."""

    unknowns: float | None = key(
        COUNT, "most unknowns of a mesh", default=None, otherwise="none", option="error_unknowns", said=_worded(COUNT)
    )
    memory: float | None = key(
        MEMORY, "memory of all ranks together", default=None, unit="bytes",
        otherwise="four fifths of what the machine has free", option="error_memory", said=_worded(MEMORY),
    )  # fmt: skip
    time: float | None = key(
        TIME, "time of the run, all meshes together", default=None, unit="s", otherwise="none",
        option="error_time", said=_worded(TIME),
    )  # fmt: skip


@table
class Target:
    """An error to reach, by refining the mesh where it pays."""

    error: float = key(ERROR, "relative error to reach", option="error", said=_worded(ERROR))
    of: str = key(
        QUANTITY, "what it is the error of", default="energy", option="error_of", said=_worded(QUANTITY),
        more="the energy norm of the displacement, or a contact's force, a support's force, the mean displacement of a "
        "probe, the contact pressure in L2; of a force or displacement one component: force:CONTACT.x; or several of "
        "these, with commas between them",
    )  # fmt: skip
    pictures: bool = key(
        BOOLEAN, "the estimate on the last mesh, that mesh, and the errors of all meshes are drawn beside the results",
        default=False, option="error_pictures",
    )  # fmt: skip
    details: bool = key(
        BOOLEAN, "all lines of all meshes are shown, and what the error of each consists of", default=False,
        option="error_details",
    )  # fmt: skip
    budget: Budget = field(default_factory=Budget)

    @property
    def words(self) -> str:
        """The error as a scene file has it."""
        return BEST if self.best else f"{self.error:g}"

    @property
    def best(self) -> bool:
        """Return whether it is the least error that the budget allows; `error` is 0 then."""
        return self.error == 0.0

    @property
    def each(self) -> list["Target"]:
        """The same of each thing alone, where it is the error of several."""
        return [replace(self, of=of) for of in self.of.split(",")]

    @property
    def numbers(self) -> bool:
        """Return True if it is the error of a number, and not of norms alone."""
        return any(one.quantity not in ("energy", "pressure") for one in self.each)

    @property
    def quantity(self) -> str:
        """The word of `QUANTITIES`, of the error of one thing."""
        return self.of.partition(":")[0]

    @property
    def name(self) -> str:
        """Of the contact, region or probe, with the component where there is one; empty: of none."""
        return self.of.partition(":")[2]

    def of_known(self, known: Iterable[str]) -> tuple[str, int | None]:
        """The name without its component, and the axis of that; None: the whole vector, along itself.

        The suffix is a component unless one of the `known` names has it.
        """
        name, dot, axis = self.name.rpartition(".")
        if not dot or self.name in known or self.quantity == "pressure" or len(axis) != 1 or axis not in AXES:
            return self.name, None
        return name, AXES.index(axis)


def preset_or_target(words: Rule) -> Rule:
    """The rule of the key `accuracy`: a word, or a table."""

    def accept(value):
        return value if isinstance(value, Target) else words.accept(value)

    return Rule(f"{words.allowed} | {{ error = 0.02, ... }}", accept, {"anyOf": [words.schema, {"type": "object"}]})
