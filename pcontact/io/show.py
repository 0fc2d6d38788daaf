"""``pcontact view``: what its options mean. Only here is the code that draws imported, and matplotlib with it."""

from pathlib import Path

from pcontact.runtime.declared import STEP, Option, listed, read_all
from pcontact.runtime.errors import InputError
from pcontact.runtime.rules import BOOLEAN, number, text


def _size(value):
    """Width and height from a text such as 1600x1000."""
    size = tuple(int(part) for part in value.lower().split("x"))
    if len(size) != 2 or not all(200 <= n <= 8000 for n in size):
        raise ValueError
    return size


OPTIONS = listed(
    Option(
        "field", text("the name of a field"), "contact_pressure, equivalent_stress, displacement, displacement_z, "
        "stress_xx, equivalent_plastic_strain, gap, ...; a wrong name lists them all", value="NAME",
    ),
    STEP,
    Option("scale", number(least=0), "factor of the displacements", otherwise="1, or a round number"),
    Option("cut", BOOLEAN, "solids cut open at the contact", otherwise="for fields of the bodies"),
    Option("smooth", BOOLEAN, "fields of cells averaged at the nodes, or as they are", True),
    Option(
        "size", text("WIDTHxHEIGHT in pixels, 200 to 8000 each", _size), "width and height in pixels", value="1600x1000"
    ),
    Option("o", text("a file"), ".png, .jpg, .svg, .pdf, ...", otherwise="DIR/NAME.png", value="FILE"),
)  # fmt: skip


def show(directory, options):
    """Draw the picture that a command line asks for. Serial.

    Parameters
    ----------
    directory : str
        The output directory of a run.
    options : dict of str to str
        Without dashes; keys of `OPTIONS`.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    InputError
        An option is not known or has a value that is not allowed, there is no matplotlib, or what
        :func:`pcontact.io.picture.picture` raises.
    """
    values = read_all("view", OPTIONS, options)
    if not Path(directory).is_dir() and Path(directory).suffix in (".toml", ".pvd"):
        raise InputError(f"command line: pcontact view: found {directory}; allowed: the output directory of a run")
    try:
        from pcontact.io.picture import picture
    except ModuleNotFoundError as error:
        if error.name != "matplotlib":
            raise
        raise InputError("pcontact view: found no Python package matplotlib; allowed: pip install matplotlib") from None
    values["output"] = values.pop("o", None)
    return picture(directory, **values)
