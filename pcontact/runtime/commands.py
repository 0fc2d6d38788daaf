"""The options of commands, beside those of a run (`pcontact.runtime.declared`) and the keys of a scene.

Neither solver nor MPI is needed to know them: ``--help`` is quick.
"""

from dataclasses import replace

from pcontact.runtime.declared import STEP, WORDS, Option, listed
from pcontact.runtime.rules import ANY_TEXT, BOOLEAN, choice, integer, number, text

MOVIES, PAGES = (".gif", ".mp4"), (".html", ".htm")
VIEWS = ("whole", "cut", "near", "surface", "profile", "unrolled")
TURNED = VIEWS[:3]  # that windows and pages have
# part of the squared error whose cells are refined; error wanted of a new mesh over the old one
PART, ERROR = 0.5, 0.5


def _size(value):
    """Width and height from a text such as 1600x1000."""
    size = tuple(int(part) for part in value.lower().split("x"))
    if len(size) != 2 or not all(200 <= n <= 8000 for n in size):
        raise ValueError
    return size


def _cut(value):
    """Whether to cut at the contact, or (axis, coordinate or None)."""
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
