"""A picture of the deformed bodies, without a display and without ParaView."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, Normalize, TwoSlopeNorm, to_rgb
from matplotlib.figure import Figure

from pcontact.io import raster, skin, view
from pcontact.io.quantity import find
from pcontact.io.result import load_result
from pcontact.runtime.errors import InputError

DPI = 150
FINE = 3  # pixels drawn per pixel shown, in each direction
INK = np.array(to_rgb("#1c2733"))
GREYS = np.array([to_rgb(colour) for colour in ("#c3cad1", "#dcd6cb", "#c9d3c6", "#d6cbd2")])
COLOURS = {"contact_pressure": "YlOrRd", "pressure": "YlOrRd", "equivalent_plastic_strain": "magma_r"}
STATUS = ListedColormap(["#d8dde2", "#2a9d8f", "#e76f51"])


@dataclass
class Layer:
    """Triangles in the model's space, ready to be looked at.

    Parameters
    ----------
    corners : ndarray (nt, 3, 3)
        Corners as they are drawn [length].
    values : ndarray (nt, 3)
        What is shown at them; NaN: grey.
    beyond : ndarray (nt, 3) or None
        Positive where it is cut away.
    edges : ndarray of bool (nt, 3)
        Sides that are edges of the mesh.
    body : ndarray of int64 (nt,)
        The body each belongs to.
    """

    corners: np.ndarray
    values: np.ndarray
    beyond: np.ndarray | None
    edges: np.ndarray
    body: np.ndarray


def picture(directory, field=None, output=None, step=-1, scale=None, size=(1600, 1000), cut=None):
    """Draw the deformed bodies, coloured by a field. Serial.

    Parameters
    ----------
    directory : str or Path
        The output directory of a run.
    field : str, optional
        A field of bodies, contact surfaces or quadrature points, or a component of it (stress_xx). If absent: the
        contact pressure if there is any, else the equivalent stress.
    output : str or Path, optional
        The picture, of a type that matplotlib writes; DIRECTORY/FIELD.png if absent.
    step : int
        Which of the steps that are there, from 0; negative numbers count from the last one.
    scale : float, optional
        Factor of the displacements; if absent 1, or a round number that makes small ones seen.
    size : tuple of int
        Width and height in pixels.
    cut : bool, optional
        Solids only: take away what is before a plane through the contact patch. If absent: done for fields of the
        bodies when there is contact.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    InputError
        There are no fields, no such step, no field of that name, or the picture cannot be written there.
    """
    result = load_result(directory, step)
    quantity = find(result, field)
    if not skin.dimension(result.bodies) in (2, 3):
        raise InputError(f"{directory}: there are no bodies to draw")
    scale = view.deformation_scale(result) if scale is None else float(scale)
    output = Path(output or Path(directory) / f"{quantity.name}.png")
    figure = Figure(figsize=(size[0] / DPI, size[1] / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    with matplotlib.rc_context({"font.family": "DejaVu Sans", "font.size": 9, "axes.linewidth": 0.6}):
        _compose(figure, result, quantity, scale, cut)
        try:
            figure.savefig(output, dpi=DPI)
        except (OSError, ValueError) as problem:
            raise InputError(f"{output}: the picture cannot be written: {problem}") from problem
    return output
