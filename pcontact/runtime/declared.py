"""Options of the command line, each declared once.

From a declaration follow what the program takes for the option, the message about a wrong value, ``--help`` and the
tables of docs/options.md and docs/command_line.md (``scripts/reference.py``). Options that replace a key of the scene
follow from the key, see `pcontact.scene.keys`. Those of a run come first, then those of the commands. Neither solver
nor MPI is needed to know them: ``--help`` is quick.
"""

import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from pcontact.runtime.errors import InputError, nearby
from pcontact.runtime.rules import (
    ANY_TEXT,
    BOOLEAN,
    NON_NEGATIVE,
    POSITIVE,
    Rule,
    choice,
    integer,
    number,
    sequence,
    text,
)

WORDS = dict.fromkeys(("", "true", "yes", "on", "1"), True) | dict.fromkeys(("false", "no", "off", "0"), False)
KINDS = {"string": "a word", "integer": "an integer", "number": "a number", "boolean": "true | false"}
MOVIES, PAGES = (".gif", ".mp4"), (".html", ".htm")
VIEWS = ("whole", "cut", "near", "surface", "profile", "unrolled")
TURNED = VIEWS[:3]  # that windows and pages have
# part of the squared error whose cells are refined; error wanted of a new mesh over the old one
PART, ERROR = 0.5, 0.5


@dataclass(frozen=True)
class Option:
    """An option.

    Attributes
    ----------
    name : str
        Without the dash.
    rule : pcontact.runtime.rules.Rule
        Type and range of its values.
    help : str
        One line.
    default : object
        What holds without it; None: see `otherwise`.
    otherwise : str
        What holds without it, in words.
    value : str
        What stands for its value in ``--help``; absent: of the rule.
    flag : str
        What it means without a value.
    more : str
        What the docs say beyond `help`.
    section : str
        Of `SECTIONS`.
    checked : bool
        Whether the rule decides here; otherwise the type alone.
    key : str
        Key of the scene that it replaces.
    """

    name: str
    rule: Rule
    help: str
    default: object = None
    otherwise: str = ""
    value: str = ""
    flag: str = ""
    more: str = ""
    section: str = ""
    checked: bool = True
    key: str = ""

    @property
    def kind(self) -> str:
        """Type of its values in the words of JSON Schema."""
        return self.rule.schema["type"]

    @property
    def allowed(self) -> str:
        """Values that messages say are allowed."""
        if self.kind == "array":
            return f"some of {', '.join(self.rule.schema['items']['enum'])}"
        if not self.checked:
            return KINDS[self.kind]
        return " | ".join(map(str, self.rule.schema.get("enum", []))) or self.rule.allowed

    @property
    def words(self) -> str:
        """What ``--help`` says of values whose type alone does not tell how they are written."""
        plain = self.value or self.rule.schema.get("enum") or self.rule.schema["type"] not in ("string", "array")
        return "" if plain or self.allowed.startswith(("a string", "the name of")) else f": {self.allowed}"

    @property
    def usage(self) -> str:
        """The option as ``--help`` shows it, with what stands for its value."""
        words = self.rule.schema.get("enum", [])
        kinds = {"boolean": "true|false", "integer": "N", "number": "X", "array": "WORD,WORD", "string": "TEXT"}
        return f"-{self.name} {self.value or '|'.join(map(str, words)) or kinds[self.kind]}"

    def refusal(self, text: str, said: str = "command line") -> InputError:
        """The error to raise: who said it, the option, what was found, what is allowed."""
        return InputError(f"{said}: -{self.name}: found {repr(text) if text else 'nothing'}; allowed: {self.allowed}")

    def read(self, text: str, said: str = "command line") -> object:
        """The value that a text on the command line stands for.

        Raises
        ------
        InputError
        """
        text = text or self.flag
        try:
            if self.kind == "array":
                return self._list([word.strip() for word in text.split(",")], said)
            value = self._converted(text)
            return self.rule.accept(value) if self.checked else value
        except (ValueError, KeyError, OverflowError):
            raise self.refusal(text, said) from None

    def _converted(self, text):
        if self.kind == "boolean":
            return WORDS[text.lower()]
        return {"integer": int, "number": float, "string": str}[self.kind](text)

    def _list(self, words, said):
        wrong = [word for word in words if word not in self.rule.schema["items"]["enum"]]
        if wrong:
            raise InputError(f"{said}: -{self.name}: found {wrong[0]!r}; allowed: {self.allowed}")
        return self.rule.accept(words)


def listed(*options: Option) -> dict[str, Option]:
    """Options by their names."""
    return {option.name: option for option in options}


def read_all(command: str, options: Mapping[str, Option], words: Mapping[str, str]) -> dict[str, object]:
    """The values of all options that a command line gives to a command which knows no others.

    Raises
    ------
    InputError
        One is not known, or has a value that is not allowed.
    """
    for name in words:
        if name not in options:
            hint = nearby(name, options, "-{}".format)
            allowed = ", ".join(f"-{known}" for known in options)
            raise InputError(f"command line: -{name}: no such option of pcontact {command}; allowed: {allowed}{hint}")
    return {name: options[name].read(text) for name, text in words.items()}


def help_lines(options: Iterable[Option], column: int = 51, width: int = 120) -> list[str]:
    """Return the lines of ``--help`` on options: one line each, two where the usage is long."""
    lines = []
    for option in options:
        said = option.otherwise or (option.default not in (None, (), "") and shown(option.default))
        default = f" ({said})" if said else ""
        usage, indent = f"  {option.usage}".ljust(column), " " * column
        if len(usage) > column or usage[-1] != " ":
            lines.append(usage.rstrip())
            usage = indent
        lines += textwrap.wrap((option.help + option.words + default).replace("`", ""), width, initial_indent=usage,
                               subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)  # fmt: skip
    return lines


def shown(value: object) -> str:
    """A default as the user would write it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


# what --help and the docs put together, and how they call it
SECTIONS = {
    "scene": "Instead of keys of the scene",
    "contact": "Contact within a load step",
    "solver": "Solver",
    "mesh": "Partition of the mesh",
    "run": "Restart and programs in scenes",
}
# of Newton's method, each of which may be left out
HEURISTICS = (
    "prediction", "opening", "half_step", "line_search", "correction", "step_limit", "stabilisation", "direct",
    "reuse",
)  # fmt: skip
# those of earlier versions: left out anyway, and a warning says so
FORMER_HEURISTICS = ("stick_first", "cycles", "waiting")
OPTIONS = listed(
    Option(
        "contact_search_again", integer(0),
        "searches for partners of a load step where Newton's method has ended, at most; 0: with small strain partners "
        "are not verified", 8, section="contact", more="see below",
    ),
    Option(
        "contact_partner_rtol", POSITIVE,
        "part of the contact forces that a last search for partners may change at the end of a load step", 2e-3,
        section="contact", more="see below",
    ),
    Option(
        "contact_uzawa_rtol", POSITIVE,
        "augmented Lagrangian: change of the multipliers relative to the traction at which a load step ends", 1e-4,
        section="contact",
    ),
    Option(
        "contact_uzawa_max_it", integer(1), "augmented Lagrangian: updates of the multipliers in a load step at most",
        30, section="contact",
        more="then a warning says what is left. Beyond a change of 1e-2 the load step has not converged; as a "
        "shorter one would settle no faster, the run ends (after one cut, where the changes do not tell the rate)",
    ),
    Option(
        "newton_without", sequence("a list of " + choice(*HEURISTICS).allowed, choice(*HEURISTICS, *FORMER_HEURISTICS)),
        "heuristics of Newton's method to leave out", otherwise="none", section="solver",
        more="see [robustness.md](robustness.md)",
    ),
    Option(
        "pc_direct_below", integer(0),
        "unknowns below which linear systems of the plane are factorised, on any number of ranks", 0, section="solver",
        more="only if the user chose no preconditioner; up to 400,000, and on several ranks with MUMPS. In space on "
        "one rank, 500 at most. Where an error is named of bodies that rub or yield, 400,000; of others, on one rank, "
        "30,000",
    ),
    Option(
        "pc_contact_filter", choice("auto", "true", "false"),
        "direct solve at closed points between two cycles of the preconditioner", "auto", flag="true", section="solver",
        more="see below",
    ),
    Option(
        "partition", choice("bisection", "graph"),
        "who cuts the mesh for the ranks: planes that spread cells and contact, or PETSc's graph partitioner",
        otherwise="bisection; graph if a -petscpartitioner_type is given", section="mesh",
        more="see [mesh.md](mesh.md)",
    ),
    Option(
        "partition_weight", NON_NEGATIVE, "bisection: work of a contact facet in units of a cell's; 0: contact is not "
        "spread", 4.0, section="mesh",
    ),
    Option(
        "restart", ANY_TEXT, "go on from the checkpoint in DIR", value="DIR", section="run",
        more="see [restart.md](restart.md)",
    ),
    Option(
        "restart_anyway", BOOLEAN,
        "with other physics than the checkpoint's, or nodes at other places, a warning takes the place of the refusal",
        False, section="run",
    ),
    Option(
        "no_code", BOOLEAN, "refuse scenes that may run a program of Python, of gmsh or of PETSc", False, section="run",
        more="see [running.md](running.md)",
    ),
)  # fmt: skip
# options that are no run's, not even unused
COMMAND_LINE = ("o", "help", "h", "field", "step", "scale", "json", "set", "count")
# what the program asks PETSc's options for, which PETSc takes itself
PETSC = listed(
    Option("pc_type", ANY_TEXT, "preconditioner", "gamg"),
    Option("ksp_type", ANY_TEXT, "Krylov method"),
    Option("mat_type", ANY_TEXT, "type of the matrix that linear systems are solved with"),
    Option("vec_type", ANY_TEXT, "type of the vectors that they are solved for"),
)
# old names of options -> new names; the old ones still do, and are warned of once
RENAMED: dict[str, str] = {"pc_direct_plane": "pc_direct_below"}
# options of earlier versions, and what takes their place
FORMER = {
    "contact_search_every": "partners are found again in every load step",
    "contact_uzawa_accept": "a load step whose multipliers are far from settled has not converged; "
    "-contact_uzawa_max_it N",
    "contact_uzawa_grow": "a gamma0 below the default always grows from update to update",
    "pc_patience": "-newton_without reuse sets the preconditioner up for every tangent",
    "pc_rescue": "-newton_without direct keeps multigrid where it fails",
}
# of commands that look at the results of a run
STEP = Option(
    "step", Rule("a whole number: 1 is the first step, -1 the last, 0 undeformed", int, {"type": "integer"}),
    "1 is the first load step, -1 the last, 0 the undeformed bodies", -1,
)  # fmt: skip


def _size(value):
    """Width and height from a text such as 1600x1000."""
    size = tuple(int(part) for part in value.lower().split("x"))
    if len(size) != 2 or not all(200 <= n <= 8000 for n in size):
        raise ValueError
    return size


def _cut(value):
    """Return whether to cut at the contact, or (axis, coordinate or None)."""
    if value.lower() in WORDS:
        return WORDS[value.lower()]
    axis, _, where = value.partition("=")
    return "xyz".index(axis.strip().lower() or "?"), float(where) if where else None


def _views(value):
    """Names of views from a text such as cut,surface."""
    words = tuple(word.strip() for word in value.split(","))
    if not set(words) <= set(VIEWS):
        raise ValueError
    return words


CONVERT = listed(
    Option("order", integer(1, 2), "2: cells completed to degree 2, for a displacement of that degree", 1),
    Option(
        "o", text("a file"), 'to be named in the scene: [mesh] file = "FILE.h5"', otherwise="beside MESH",
        value="FILE.h5",
    ),
    Option("petsc", BOOLEAN, "write what PETSc loads, a DMPlex with the groups as labels, of degree 1", False),
)  # fmt: skip
MODES = listed(Option("count", integer(1, 1000), "how many modes", 10))
IMPORT = listed(
    Option("o", text("a directory"), "where scene, mesh and list go", otherwise="beside the file, by its name",
           value="DIR"),
)  # fmt: skip
REFINE = listed(
    Option(
        "part", number(above=0, most=1),
        "triangles, tetrahedra: cells with this part of the squared error are refined", PART,
    ),
    Option(
        "divide", BOOLEAN,
        "quadrilaterals, hexahedra: divided into triangles, tetrahedra, which are refined alone; else all are halved",
        False,
    ),
    Option("geometry", text("a file .geo"), "instead, gmsh makes a new mesh of this geometry", value="FILE.geo"),
    Option("error", number(above=0, below=1), "with -geometry: error of the new mesh over the one of now", ERROR),
    replace(STEP, help="whose estimate: 1 is the first load step, -1 the last"),
    Option("o", text("a file .msh"), "the new mesh", otherwise="DIR/refined.msh", value="FILE.msh"),
)  # fmt: skip
VIEW = listed(
    Option(
        "field", text("the name of a field"), "contact_pressure, equivalent_stress, displacement, displacement_z, "
        "stress_xx, equivalent_plastic_strain, gap, mesh, ..., or several: NAME,NAME; a wrong name lists them all",
        value="NAME",
    ),
    STEP,
    Option("scale", number(least=0), "factor of the displacements", otherwise="1, or a round number"),
    Option(
        "cut", text("true | false | x | y | z | x=NUMBER", _cut), "solids cut open at the contact, or across an axis, "
        "at a coordinate or through the middle", otherwise="for fields of the bodies", value="true|false|x=0.3",
        flag="true",
    ),
    Option("smooth", BOOLEAN, "fields of cells averaged at the nodes, or as they are", True),
    Option(
        "views", text("some of " + ", ".join(VIEWS), _views), "side by side, some of " + ", ".join(VIEWS),
        otherwise="what shows the field best", value="VIEW,VIEW",
    ),
    Option(
        "size", text("WIDTHxHEIGHT in pixels, 200 to 8000 each", _size), "width and height in pixels", value="1600x1000"
    ),
    Option(
        "o", text("a file"), ".png, .jpg, .svg, .pdf: a picture; .html: a page to turn the bodies in, with all load "
        "steps and a choice of fields; .gif, .mp4: all load steps", otherwise="a window, or without a display "
        "DIR/NAME.png", value="FILE",
    ),
)  # fmt: skip
PLOT = listed(
    Option(
        "size", text("WIDTHxHEIGHT in pixels, 200 to 8000 each", _size), "width and height in pixels", value="1000x700"
    ),
    Option("o", text("a file"), ".png, .svg, .pdf, ...", otherwise="DIR/Y_over_X.png", value="FILE"),
)  # fmt: skip
SCHEMA = listed(
    Option("of", choice("scene", "report"), "a scene file, or report.json", "scene"),
    Option("o", text("a file"), "where it goes", otherwise="standard output", value="FILE.json"),
)
NEW = listed(
    Option("example", text("the name of an example"), "press, drag, ...: an example with what makes its mesh, which "
           "needs gmsh; a wrong name lists them all", otherwise="two blocks with their mesh", value="EXAMPLE"),
)  # fmt: skip
DEMO = listed(Option("o", text("a directory"), "scene, mesh and results", otherwise="demo", value="DIR"))
WARM = listed(Option("jobs", integer(1), "processes that compile at the same time", otherwise="one for each core"))
SET = listed(
    Option(
        "set", ANY_TEXT, "any key of the scene, with a value as in the file: -set steps.count=4; as often as wanted. "
        "Tables of lists by their name, region or number from 0: -set contacts.NAME.friction=0.3", value="KEY=VALUE",
    )
)  # fmt: skip
JSON = listed(
    Option("json", BOOLEAN, "a line of JSON for every load step, cut and the end instead of text", False, flag="true")
)
