"""The words of ``pcontact demo``: what the numbers of a run mean, and where they are."""

from pcontact.io.examples import head, scenes
from pcontact.io.report import read_report
from pcontact.io.report_schema import STEP
from pcontact.view import extra, show

# of those that each contact has in a load step
_SHOWN = ("force", "max_pressure", "max_penetration", "area")


def explain(path):
    """Explain the results beside a scene of :func:`pcontact.io.examples.lay_out`, and draw them if that is possible.
    Serial.

    Parameters
    ----------
    path : pathlib.Path
        The scene.

    Returns
    -------
    list of str
        Lines to show.
    """
    results = path.parent / "results"
    last = read_report(results)["steps"][-1]
    words = STEP["properties"]["contacts"]["additionalProperties"]["properties"]
    lines = ["what the numbers mean, in the units of the scene (it names none: any that are consistent):"]
    for name, contact in last["contacts"].items():
        for key in _SHOWN:
            values = contact[key] if isinstance(contact[key], list) else [contact[key]]
            number = " ".join(f"{0.0 + value:.4g}" for value in values)
            lines.append(f"  {name}.{key:<16} {number:<28} {words[key]['description']}")
    if path.read_bytes() in (one.read_bytes() for one in scenes()):
        said = head(path)
        lines.append(f"expected: {said.key} = {said.number:g} within {100 * said.tolerance:g} %, as on a finer mesh; "
                     f"found {said.of(last):.4g}")  # fmt: skip
    files = {"report.json": "all of every load step", "history.csv": "a row for every load step",
             "fields.pvd": "displacement, stress, pressure, ... for ParaView"}  # fmt: skip
    lines += ["where they are:", *(f"  {results}/{file:<12} {what}" for file, what in files.items())]
    return [*lines, _picture(path.parent), "next: change a number of the scene and run it again; docs/quick.md"]


def _picture(folder):
    """Draw the contact pressure; a line that says where it is, or what is needed."""
    results = folder / "results"
    if extra.missing():
        return f"a picture: pcontact view {results} asks whether to install what draws (VTK, about 600 MB)"
    try:
        return f"a picture: {show.show(results, {'o': str(folder / 'pressure.png')})}"
    except extra.InputError as problem:
        return f"no picture: {problem}"
