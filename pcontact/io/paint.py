"""Triangles with values to pixels with colours."""

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import ListedColormap, Normalize, to_rgb

from pcontact.io import raster, skin

FINE = 2  # pixels computed per pixel shown, in each direction
INK = np.array(to_rgb("#1c2733"), dtype=np.float32)
GREYS = np.array([to_rgb(name) for name in ("#c6cdd4", "#ddd6ca", "#cbd5c8", "#d8cdd4")], dtype=np.float32)
# amounts that start at nothing
_COLOURS = {"contact_pressure": "YlOrRd", "pressure": "YlOrRd", "equivalent_plastic_strain": "magma_r"}
_KINDS = (
    "#d8dde2",
    "#2a9d8f",
    "#e76f51",
    "#457b9d",
    "#e9c46a",
    "#8e6c8a",
    "#81b29a",
    "#bc6c25",
    "#5c677d",
    "#c1666b",
)


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
    edges : ndarray of int64 (nt, 3)
        Which sides are edges of the mesh, as in `Triangles`.
    body : ndarray of int64 (nt,)
        The body each belongs to, for its grey and its outline.
    lit : ndarray of bool (nt,)
        Is it shaded by its slope. What is flat is not: its colours are those of the colour bar.
    """

    corners: np.ndarray
    values: np.ndarray
    beyond: np.ndarray | None
    edges: np.ndarray
    body: np.ndarray
    lit: np.ndarray

    def visible(self):
        """Corners of the triangles that are not cut away altogether.

        Returns
        -------
        ndarray (n, 3)
        """
        corners = self.corners if self.beyond is None else self.corners[(self.beyond <= 0).any(axis=1)]
        return corners.reshape(-1, 3)


def body_layer(piece, positions, values, plane=None):
    """The bodies: plane cells, or the skin of solid ones and their section.

    Parameters
    ----------
    piece : Piece
    positions : ndarray (n, 3)
        Points as they are drawn.
    values : callable or None
        ``values(triangles, section)`` gives the values at their corners; None: grey.
    plane : tuple of (ndarray (3,), float), optional
        Normal and offset: what is beyond is cut away (solids only).

    Returns
    -------
    Layer
    """
    if skin.dimension(piece) < 3:
        parts = [(skin.surface(piece), positions, None, None)]
    elif plane is None:
        parts = [(skin.skin(piece), positions, None, None)]
    else:
        distance = positions @ plane[0] - plane[1]
        cut = skin.section(piece, distance)
        parts = [
            (skin.skin(piece), positions, distance, None),
            (cut.triangles, cut.interpolate(positions), np.full(len(cut.ends), -1.0), cut),
        ]
    body = np.concatenate([np.zeros(0), *piece.cell_data.get("body", [])]).astype(np.int64)
    layers = []
    for triangles, points, beyond, cut in parts:
        shown = values(triangles, cut) if values else np.full(triangles.nodes.shape, np.nan)
        owner = body[triangles.owner] if len(body) else np.zeros(len(triangles.owner), dtype=np.int64)
        beyond = None if beyond is None else beyond[triangles.nodes]
        lit = np.full(len(owner), cut is None and skin.dimension(piece) == 3)
        layers.append(Layer(points[triangles.nodes], shown, beyond, triangles.edges, owner, lit))
    return stack(layers)


def stack(layers):
    """Several layers as one.

    Parameters
    ----------
    layers : list of Layer

    Returns
    -------
    Layer
    """
    uncut = all(layer.beyond is None for layer in layers)
    beyond = [np.full(layer.edges.shape, -1.0) if layer.beyond is None else layer.beyond for layer in layers]
    return Layer(
        *(np.concatenate([getattr(layer, name) for layer in layers]) for name in ("corners", "values")),
        None if uncut else np.concatenate(beyond),
        *(np.concatenate([getattr(layer, name) for layer in layers]) for name in ("edges", "body", "lit")),
    )


@dataclass
class ColourScale:
    """What colour a number has.

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


def colour_scale(quantity, colormaps):
    """Colours that fit the numbers: kinds, amounts of one sign, or of both.

    A few numbers at singular corners may be far beyond all others; then the scale ends at the 99.8th
    percentile.

    Parameters
    ----------
    quantity : Quantity
    colormaps : mapping of str to matplotlib.colors.Colormap
        matplotlib's.

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
        return ColourScale(colormaps["RdBu_r"], Normalize(-limit, limit), extend, [])
    # an amount that is nearly the same everywhere is shown as that
    if low >= 0 and (low < 0.5 * high or quantity.name in _COLOURS):
        low = 0.0
    if high <= 0 and high > 0.5 * low:
        high = 0.0
    high = high if high > low else low + max(abs(low), 1.0) * 1e-3
    return ColourScale(colormaps[_COLOURS.get(quantity.name, "Spectral_r")], Normalize(low, high), extend, [])


def fit(points, camera, shape, margin=0.05):
    """The part of the view that holds the points, in the proportions of the picture.

    Parameters
    ----------
    points : ndarray (n, 3)
    camera : Camera
    shape : tuple of int
        Height and width in pixels.
    margin : float
        Empty border, as a fraction of the size.

    Returns
    -------
    tuple of 4 floats
        Left, right, bottom, top [length].
    """
    seen = camera.project(points)[:, :2] if len(points) else np.zeros((1, 2))
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2 * (1 + 2 * margin)
    pixel = max(half[0] / shape[1], half[1] / shape[0], 1e-12)
    return (
        middle[0] - pixel * shape[1], middle[0] + pixel * shape[1],
        middle[1] - pixel * shape[0], middle[1] + pixel * shape[0],
    )  # fmt: skip


def image(layer, camera, window, shape, scale, ghost=None):
    """Draw a layer.

    Parameters
    ----------
    layer : Layer
    camera : Camera
    window : tuple of 4 floats
        Left, right, bottom, top in the view [length].
    shape : tuple of int
        Height and width in pixels.
    scale : ColourScale
    ghost : Layer, optional
        Drawn as if of glass over what it hides.

    Returns
    -------
    ndarray (height, width, 4)
        Red, green, blue, opacity; row 0 at the bottom.
    """
    fine = (shape[0] * FINE, shape[1] * FINE)
    pixels, depth = _colours(layer, camera, window, fine, scale)
    if ghost is not None:
        glass, front = _colours(ghost, camera, window, fine, scale)
        size = window[1] - window[0]
        before = (glass[..., 3] > 0) & (front > depth + 1e-6 * size)
        share = np.where(pixels[before, 3:] > 0, np.float32(0.30), np.float32(0.62))
        behind = np.where(pixels[before, 3:] > 0, pixels[before, :3], np.float32(1))
        pixels[before, :3] = share * glass[before, :3] + (1 - share) * behind
        pixels[before, 3] = 1
    return raster.reduce(pixels, FINE)


def _colours(layer, camera, window, shape, scale):
    """Colours and depth of the fine pixels."""
    corners = camera.project(layer.corners)
    seen = raster.render(corners, layer.values, layer.beyond, layer.edges, window, shape)
    hit = seen.triangle >= 0
    number, value = seen.triangle[hit], seen.value[hit]
    rgb = GREYS[layer.body[number] % len(GREYS)]
    known = np.isfinite(value)
    rgb[known] = scale.rgb(value[known])
    light = np.where(layer.lit, raster.shading(corners), 1.0).astype(np.float32)
    rgb *= light[number, None]
    # lines about a pixel wide; fainter where cells are only a few pixels large, lest they cover the colours
    pixel = (window[1] - window[0]) / shape[1]
    sides = (
        np.linalg.norm(np.diff(corners[number[:: max(1, len(number) // 20000)], :2, :2], axis=1), axis=2)
        / pixel
    )
    strength = 0.5 * np.clip((np.median(sides) / FINE - 3) / 15, 0, 1) if sides.size else 0.0
    share = (strength * np.clip(0.55 * FINE + 0.5 - seen.line[hit], 0, 1)).astype(np.float32)[:, None]
    rgb += share * (INK - rgb)
    labels = np.full(shape, -1, dtype=np.int64)
    labels[hit] = layer.body[number]
    border = raster.outlines(labels, FINE) | raster.creases(seen.triangle, raster.slopes(corners), FINE)
    border = border[hit]
    rgb[border] += np.float32(0.75) * (INK - rgb[border])
    pixels = np.zeros((*shape, 4), dtype=np.float32)
    pixels[hit, :3] = rgb
    pixels[hit, 3] = 1
    return pixels, seen.depth
