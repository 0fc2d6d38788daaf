"""Colours of numbers, the style of figures, and how they are written."""

from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.colors import ListedColormap, Normalize

from pcontact.runtime.errors import InputError
from pcontact.runtime.files import written_aside

DPI, INK, PALE = 150, "#1c2733", "#5b6773"
STYLE = {"font.family": "DejaVu Sans", "font.size": 9, "axes.linewidth": 0.6, "text.color": INK,
         "axes.edgecolor": PALE, "axes.labelcolor": PALE, "xtick.color": PALE,
         "ytick.color": PALE, "xtick.major.width": 0.6, "ytick.major.width": 0.6}  # fmt: skip
# lines and letters stay sharp
_SAVE = dict.fromkeys((".jpg", ".jpeg", ".webp"), {"pil_kwargs": {"quality": 90}})
GREYS = ("#c6cdd4", "#ddd6ca", "#cbd5c8", "#d8cdd4")  # of one body after the other
# amounts that start at nothing
_COLOURS = {"contact_pressure": "YlOrRd", "pressure": "YlOrRd", "equivalent_plastic_strain": "magma_r"}
_KINDS = ("#d8dde2", "#2a9d8f", "#e76f51", "#457b9d", "#e9c46a", "#8e6c8a", "#81b29a", "#bc6c25",
          "#5c677d", "#c1666b")  # fmt: skip


@dataclass
class ColourScale:
    """Scale of colours for numbers.

    Parameters
    ----------
    colours : matplotlib.colors.Colormap
    norm : matplotlib.colors.Normalize
    extend : {"neither", "min", "max", "both"}
        Are there numbers beyond the ends of the scale.
    kinds : list of int
        The numbers, if they stand for kinds of things; else empty.
    """

    colours: object
    norm: object
    extend: str
    kinds: list

    def table(self, n=512):
        """Colours at equal distances over the scale.

        Parameters
        ----------
        n : int

        Returns
        -------
        ndarray of float32 (n, 3)
        """
        return self.colours(np.linspace(0, 1, n))[:, :3].astype(np.float32)

    def rgb(self, values):
        """Colours of numbers.

        Parameters
        ----------
        values : ndarray (n,)
            Finite.

        Returns
        -------
        ndarray of float32 (n, 3)
        """
        table = self.table()
        place = (values - self.norm.vmin) / (self.norm.vmax - self.norm.vmin)
        return table[np.clip(place * len(table), 0, len(table) - 1).astype(np.int64)]


def colour_scale(quantity):
    """Colours that fit the numbers: kinds, amounts of one sign, or of both.

    A few numbers at singular corners may be far beyond all others; then the scale ends at the 99.8th
    percentile.

    Parameters
    ----------
    quantity : Quantity

    Returns
    -------
    ColourScale
    """
    values = quantity.all_values
    values = values if len(values) else np.zeros(1)
    if quantity.whole and values.max() - values.min() < 64:
        last = max(int(values.max()), 2 if quantity.name == "status" else 0)
        first = min(int(values.min()), 0)
        colours = ListedColormap([_KINDS[kind % len(_KINDS)] for kind in range(last - first + 1)])
        return ColourScale(
            colours, Normalize(first - 0.5, last + 0.5), "neither", list(range(first, last + 1))
        )
    low, high = float(values.min()), float(values.max())
    usual_low, usual_high = np.percentile(values, [0.2, 99.8])
    top, bottom = high > 2 * max(usual_high, 0) > 0, low < 2 * min(usual_low, 0) < 0
    low, high = usual_low if bottom else low, usual_high if top else high
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[
        bottom, top
    ]
    if low < 0 < high and min(-low, high) > 0.02 * (high - low):
        limit = max(-low, high)
        return ColourScale(matplotlib.colormaps["RdBu_r"], Normalize(-limit, limit), extend, [])
    # an amount that is nearly the same everywhere is shown as that
    if low >= 0 and (low < 0.5 * high or quantity.name in _COLOURS):
        low = 0.0
    if high <= 0 and high > 0.5 * low:
        high = 0.0
    high = high if high > low else low + max(abs(low), 1.0) * 1e-3
    colours = matplotlib.colormaps[_COLOURS.get(quantity.name, "Spectral_r")]
    return ColourScale(colours, Normalize(low, high), extend, [])


def save(figure, output):
    """Write a figure; what it cannot be written as is the user's error."""
    with matplotlib.rc_context(STYLE):
        try:
            with written_aside(output, "-o") as part:
                figure.savefig(part, dpi=figure.dpi, **_SAVE.get(output.suffix.lower(), {}))
        except ValueError as problem:
            raise InputError(f"{output}: the picture cannot be written: {problem}") from problem
