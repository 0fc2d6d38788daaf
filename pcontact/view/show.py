"""``pcontact view`` and ``pcontact plot``: what their options mean. Only here is the code that draws imported."""

from pathlib import Path

from pcontact.io.result import has_fields
from pcontact.runtime.declared import MOVIES, PAGES, PLOT, TURNED, VIEW, read_all
from pcontact.runtime.errors import InputError
from pcontact.view import extra


def _require_directory(command, path):
    """Refuse what is no directory, before what draws is looked for."""
    if not Path(path).is_dir():
        found = f"{path}, no {'' if Path(path).exists() else 'such '}directory"
        raise InputError(f"command line: pcontact {command}: found {found}; allowed: the output directory of a run")


def show(directory, options):
    """Draw the picture, page, animation or window that a command line asks for. Serial.

    Parameters
    ----------
    directory : str
        The output directory of a run.
    options : dict of str to str
        Without dashes; keys of `pcontact.runtime.declared.VIEW`.

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
    values = read_all("view", VIEW, options)
    _require_directory("view", directory)
    output, step, field = values.pop("o", None), values.pop("step", None), values.pop("field", None)
    suffix = Path(output).suffix.lower() if output else ""
    extra.require((*extra.MODULES, *(("trame_vtk",) if suffix in PAGES else ())))
    turned = set(values.get("views", ())) <= set(TURNED)
    if suffix in PAGES and not turned:
        found = ", ".join(values["views"])
        raise InputError(f"command line: -views: found {found} in a page; allowed: {', '.join(TURNED)}")
    if output is None and turned and extra.has_display():
        from pcontact.view.export import window

        window(directory, field, -1 if step is None else step, **values)
        return None
    extra.prepare_off_screen()
    if suffix in PAGES:
        from pcontact.view.export import page

        return page(directory, field, output, step, **values)
    step = -1 if step is None else step
    if suffix in MOVIES:
        from pcontact.view.export import movie

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
    from pcontact.view.curves import plot_errors

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
        Keys of `pcontact.runtime.declared.PLOT`.

    Returns
    -------
    Path

    Raises
    ------
    InputError
    """
    values = read_all("plot", PLOT, options)
    _require_directory("plot", operands[0])
    extra.require(("matplotlib",))
    from pcontact.view.curves import plot

    return plot(operands[0], operands[1:], values.get("o"), values.get("size", (1000, 700)))
