"""``pcontact view`` and ``pcontact plot``: what their options mean. Only here is the code that draws imported."""

from pathlib import Path

from pcontact.io.result import has_fields
from pcontact.runtime.declared import STEP, WORDS, Option, listed, read_all
from pcontact.runtime.errors import InputError
from pcontact.runtime.rules import BOOLEAN, number, text
from pcontact.view import extra

MOVIES, PAGES = (".gif", ".mp4"), (".html", ".htm")
VIEWS = ("whole", "cut", "near", "surface", "profile", "unrolled")
TURNED = VIEWS[:3]  # that windows and pages have


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


OPTIONS = listed(
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
        "o", text("a file"), ".png, .jpg, .svg, .pdf: a picture; .html: a page to turn the bodies in; .gif, .mp4: all "
        "load steps", otherwise="a window, or without a display DIR/NAME.png", value="FILE",
    ),
)  # fmt: skip
PLOT = listed(
    Option(
        "size", text("WIDTHxHEIGHT in pixels, 200 to 8000 each", _size), "width and height in pixels", value="1000x700"
    ),
    Option("o", text("a file"), ".png, .svg, .pdf, ...", otherwise="DIR/Y_over_X.png", value="FILE"),
)  # fmt: skip


def show(directory, options):
    """Draw the picture, page, animation or window that a command line asks for. Serial.

    Parameters
    ----------
    directory : str
        The output directory of a run.
    options : dict of str to str
        Without dashes; keys of `OPTIONS`.

    Returns
    -------
    Path or None
        What was written; None: a window was shown.

    Raises
    ------
    InputError
        An option is not known or has a value that is not allowed, what draws is not there, or what
        :func:`pcontact.view.picture.picture` raises.
    """
    values = read_all("view", OPTIONS, options)
    if not Path(directory).is_dir() and Path(directory).suffix in (".toml", ".pvd", ".vtkhdf"):
        raise InputError(f"command line: pcontact view: found {directory}; allowed: the output directory of a run")
    output, step, field = values.pop("o", None), values.pop("step", -1), values.pop("field", None)
    suffix = Path(output).suffix.lower() if output else ""
    extra.require((*extra.MODULES, *(("trame_vtk",) if suffix in PAGES else ())))
    turned = set(values.get("views", ())) <= set(TURNED)
    if suffix in PAGES and not turned:
        found = ", ".join(values["views"])
        raise InputError(f"command line: -views: found {found} in a page; allowed: {', '.join(TURNED)}")
    if output is None and turned and extra.has_display():
        from pcontact.view.live import window

        window(directory, field, step, **values)
        return None
    extra.prepare_off_screen()
    if suffix in PAGES:
        from pcontact.view.live import page

        return page(directory, field, output, step, **values)
    if suffix in MOVIES:
        from pcontact.view.movie import movie

        return movie(directory, field, output, **values)
    from pcontact.view.picture import picture

    return picture(directory, field, output, step, **values)


def draw_errors(directory):
    """Draw what a run that has reached an error says of it: ``error_mesh.png``, the estimate of the cells and the last
    mesh, where fields were written, and ``errors.png``, the errors of all meshes. Serial.

    Parameters
    ----------
    directory : pathlib.Path
        The output directory of the run.

    Raises
    ------
    InputError, OutputError
    """
    from pcontact.view.plot import plot_errors

    plot_errors(directory, directory / "errors.png")
    if has_fields(directory):
        show(str(directory), {"field": "error_estimate,mesh", "o": str(directory / "error_mesh.png")})


def plot_history(operands, options):
    """Plot columns of a run's history over another one. Serial.

    Parameters
    ----------
    operands : list of str
        The directory, the column across, and those upward.
    options : dict of str to str
        Keys of `PLOT`.

    Returns
    -------
    Path

    Raises
    ------
    InputError
    """
    values = read_all("plot", PLOT, options)
    extra.require(("matplotlib",))
    from pcontact.view.plot import plot

    return plot(operands[0], operands[1:], values.get("o"), values.get("size", (1000, 700)))
