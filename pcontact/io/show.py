"""``pcontact view``: what its options mean. Only here is the code that draws imported, and matplotlib with it."""

import difflib
import math
from pathlib import Path

from pcontact.runtime.errors import InputError

OPTIONS = {
    "o": "a file",
    "field": "the name of a field",
    "step": "a whole number: 1 is the first step, -1 the last",
    "scale": "a number >= 0",
    "cut": "true | false",
    "smooth": "true | false",
    "size": "WIDTHxHEIGHT in pixels, 200 to 8000 each",
}
_WORDS = {"": True, "true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}


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
    for name in options:
        if name not in OPTIONS:
            near = difflib.get_close_matches(name, OPTIONS, 1)
            hint = f"; the nearest is -{near[0]}" if near else ""
            allowed = ", ".join(f"-{key}" for key in OPTIONS)
            raise InputError(f"command line: -{name}: no such option of pcontact view; allowed: {allowed}{hint}")
    values = {name: _value(name, text) for name, text in options.items()}
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


def _value(name, text):
    """The value of an option as `picture` takes it."""
    try:
        if name == "step":
            value = int(text)
        elif name == "scale":
            value = float(text)
            value = value if value >= 0 and math.isfinite(value) else None
        elif name in ("cut", "smooth"):
            value = _WORDS.get(text.lower())
        elif name == "size":
            value = tuple(int(part) for part in text.lower().split("x"))
            value = value if len(value) == 2 and all(200 <= n <= 8000 for n in value) else None
        else:
            value = text or None
    except ValueError:
        value = None
    if value is None:
        found = repr(text) if text else "nothing"
        raise InputError(f"command line: -{name}: found {found}; allowed: {OPTIONS[name]}")
    return value
