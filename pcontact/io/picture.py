"""A picture of the deformed bodies, without a display and without ParaView."""

import textwrap
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from pcontact.io import paint, raster, skin, view
from pcontact.io.quantity import NodeAverages, find
from pcontact.io.result import load_result
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import written_aside

DPI = 150
# lines and letters stay sharp
_SAVE = dict.fromkeys((".jpg", ".jpeg", ".webp"), {"pil_kwargs": {"quality": 90}})
_INK, _PALE = "#1c2733", "#5b6773"
_STYLE = {"font.family": "DejaVu Sans", "font.size": 9, "axes.linewidth": 0.6, "text.color": _INK,
          "axes.edgecolor": _PALE, "axes.labelcolor": _PALE, "xtick.color": _PALE,
          "ytick.color": _PALE, "xtick.major.width": 0.6, "ytick.major.width": 0.6}  # fmt: skip
_WHOLE, _LEFT = (0.02, 0.03, 0.85, 0.84), (0.02, 0.03, 0.51, 0.84)
_RIGHT, _BAR = (0.60, 0.27, 0.265, 0.424), (0.895, 0.27, 0.016, 0.424)
_NONE_IF_OPEN = ("contact_pressure", "status")


def picture(
    directory, field=None, output=None, step=-1, scale=None, size=(1600, 1000), cut=None, smooth=True
):
    """Draw the deformed bodies, coloured by a field. Serial.

    Parameters
    ----------
    directory : str or Path
        The output directory of a run.
    field : str, optional
        A field of bodies, contact surfaces or quadrature points, or a component of it (stress_xx). If absent:
        the contact pressure if there is any, else the equivalent stress.
    output : str or Path, optional
        The picture, of a type that matplotlib writes (without an ending: PNG); DIRECTORY/FIELD.png if absent.
    step : int
        Which of the steps that are there, from 1; negative numbers count from the last one.
    scale : float, optional
        Factor of the displacements; if absent 1, or a round number that makes small ones seen.
    size : tuple of int
        Width and height in pixels.
    cut : bool, optional
        Solids only: take away what is before a plane through the contact patch. If absent: done for fields of
        the bodies when there is contact.
    smooth : bool
        Fields of cells are averaged at the nodes of each body; otherwise every cell has one colour.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    InputError
        There are no fields, no such step, no field of that name, or no picture can have that name.
    OutputError
        The picture cannot be written.
    """
    result = load_result(directory, step)
    quantity = find(result, field)
    if skin.dimension(result.bodies) < 2:
        raise InputError(f"{directory}: there are no bodies to draw")
    output = Path(output or Path(directory) / f"{quantity.name}.png")
    output = output if output.suffix else output.with_suffix(".png")
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(size[0] / DPI, size[1] / DPI), dpi=DPI, facecolor="white")
        FigureCanvasAgg(figure)
        _Composition(figure, result, quantity, scale, smooth).draw(cut)
        try:
            with written_aside(output, "-o") as part:
                figure.savefig(part, dpi=DPI, **_SAVE.get(output.suffix.lower(), {}))
        except ValueError as problem:
            raise InputError(f"{output}: the picture cannot be written: {problem}") from problem
    return output


class _Composition:
    """The parts of one picture and where they go."""

    def __init__(self, figure, result, quantity, scale, smooth):
        self.figure, self.result, self.quantity = figure, result, quantity
        smooth = smooth and quantity.place == "bodies" and quantity.at == "cell" and not quantity.whole
        self.averages = NodeAverages(result.bodies, quantity.values[""]) if smooth else None
        self.solid = skin.dimension(result.bodies) == 3
        self.factor = view.deformation_scale(result) if scale is None else float(scale)
        self.positions = view.deformed(result.bodies, self.factor)
        self.surfaces = {name: view.deformed(piece, self.factor) for name, piece in result.surfaces.items()}
        self.patch = view.contact_patch(result.surfaces, self.surfaces) if self.solid else None
        self.colours = paint.colour_scale(quantity, matplotlib.colormaps)

    def draw(self, cut):
        """Draw everything."""
        on_bodies = self.quantity.place == "bodies"
        cut = self.solid and self.patch is not None and (on_bodies if cut is None else cut)
        camera, plane = raster.Camera(np.eye(3)), None
        if cut:
            normal, offset, camera = view.cut_open(self.patch, self.positions)
            plane = None if offset is None else (normal, offset)
        elif self.solid:
            camera = view.overview(self.patch)
        bodies = paint.body_layer(
            self.result.bodies, self.positions, self._body_values if on_bodies else None, plane
        )
        left, bottom, width, height = _WHOLE if on_bodies else _LEFT
        # coordinates are written beside plane bodies
        border = 0.0 if self.solid else 0.04
        axes = self._axes((left + border, bottom + border, width - border, height - border))
        window = paint.fit(bodies.visible(), camera, self._shape(axes))
        if self.quantity.place == "surfaces" and self.solid:
            layer = self._surface_layer(self.quantity.values, plane)
            self._show(axes, layer, camera, window, bodies)
        else:
            self._show(axes, bodies, camera, window)
        if not on_bodies:
            self._detail(axes, camera)
        if self.solid:
            self._triad(camera)
        else:
            _ticks(axes, "x", "y")
        self._titles(plane is not None)
        self._colour_bar()

    def _body_values(self, triangles, cut):
        """Values at the corners of the skin or of a section."""
        if self.averages is not None:
            return self.averages.corners(triangles, cut)
        if cut is None or self.quantity.at == "cell":
            return self.quantity.corners("", triangles)
        return cut.interpolate(self.quantity.values[""])[triangles.nodes]

    def _surface_layer(self, names, plane=None, alone=False):
        """The facets of some contact pairs; alone they are not shaded, and those without pressure grey.

        Between the bodies these are left out: an open facet is part of the skin, not of what it hides.
        """
        layers = []
        for name in names:
            triangles, points = skin.surface(self.result.surfaces[name]), self.surfaces[name]
            values = self.quantity.corners(name, triangles)
            idle = (values <= 0).all(axis=1) & (self.quantity.name in _NONE_IF_OPEN)
            if alone:
                values[idle & (not self.quantity.whole)] = np.nan
            else:
                keep = ~idle
                triangles = skin.Triangles(
                    triangles.nodes[keep], triangles.owner[keep], triangles.edges[keep]
                )
                values = values[keep]
            beyond = None if plane is None else (points @ plane[0] - plane[1])[triangles.nodes]
            body = np.zeros(len(triangles.owner), dtype=np.int64)
            lit = np.full(len(body), not alone)
            layers.append(paint.Layer(points[triangles.nodes], values, beyond, triangles.edges, body, lit))
        return paint.stack(layers)

    def _detail(self, axes, camera):
        """What lies between the bodies, once more and alone."""
        panel = self._axes(_RIGHT)
        if self.quantity.place == "points":
            self._cloud(axes, panel, camera)
        elif self.solid:
            self._surface_alone(panel)
        else:
            self._profile(axes, panel)

    def _leading(self):
        """The contact pair with the largest number in it."""
        return max(
            self.quantity.values, key=lambda name: np.max(np.abs(self.quantity.values[name]), initial=-1.0)
        )

    def _surface_alone(self, panel):
        """A solid's contact surface seen along its mean normal, the patch filling the panel."""
        name = self._leading()
        layer = self._surface_layer([name], alone=True)
        surfaces = {name: self.result.surfaces[name]}
        patch = view.contact_patch(surfaces, self.surfaces)
        if patch is None:
            panel.set_axis_off()
            return
        camera = view.from_above(patch, patch.points)
        window = self._close(layer, patch, camera, panel)
        self._show(panel, layer, camera, window)
        panel.set_title(name, fontsize=9, loc="left")
        across = [int(np.argmax(np.abs(row))) for row in camera.axes[:2]]
        along = [row[axis] > 0.99 for row, axis in zip(camera.axes[:2], across, strict=True)]
        _ticks(
            panel, *("xyz"[axis] if straight else None for axis, straight in zip(across, along, strict=True))
        )

    def _close(self, layer, patch, camera, panel):
        """The window around the patch: with a border of about a third, but not beyond the surface."""
        near = camera.project(patch.points)[:, :2]
        all_ = camera.project(layer.corners.reshape(-1, 3))[:, :2]
        border = 0.3 * np.ptp(near, axis=0).max() + 1e-12
        low = np.maximum(near.min(axis=0) - border, all_.min(axis=0))
        high = np.minimum(near.max(axis=0) + border, all_.max(axis=0))
        ends = np.column_stack([np.array([low, high]), np.zeros(2)]) @ camera.axes
        return paint.fit(ends, camera, self._shape(panel), margin=0.02)

    def _profile(self, axes, panel):
        """Plane bodies: the contact surfaces as coloured lines, and the values over their length."""
        pieces = {name: self.result.surfaces[name] for name in self.quantity.values}
        across, window = view.along(pieces, self.surfaces)
        for name in self.quantity.values:
            nodes, owner = skin.lines(pieces[name])
            ends = self.surfaces[name][nodes]
            values = self.quantity.values[name]
            values = (
                values[nodes] if self.quantity.at == "point" else np.repeat(values[owner, None], 2, axis=1)
            )
            colours = self.colours.rgb(values.mean(axis=1))
            shown = (values > 0).any(axis=1) | (self.quantity.name not in _NONE_IF_OPEN)
            for width, colour in ((5.0, _INK), (3.5, colours[shown])):
                lines = LineCollection(
                    ends[shown, :, :2], colors=colour, linewidths=width, capstyle="projecting"
                )
                axes.add_collection(lines)
            bars = np.stack([ends[..., across], values], axis=2)
            feet = np.stack([ends[:, ::-1, across], np.zeros_like(values)], axis=2)
            panel.add_collection(
                PolyCollection(np.concatenate([bars, feet], axis=1), facecolors=colours, lw=0)
            )
            panel.add_collection(LineCollection(bars, colors=_INK, linewidths=1.1))
        panel.autoscale_view()
        panel.set_xlim(*window)
        if self.colours.kinds:
            panel.set_yticks(self.colours.kinds, labels=map(self.quantity.word, self.colours.kinds))
        panel.set_xlabel("xy"[across])
        panel.set_ylabel(self.quantity.label)
        panel.spines[["top", "right"]].set_visible(False)

    def _cloud(self, axes, panel, camera):
        """Quadrature points as dots, in the whole and alone."""
        name = self._leading()
        for part, target in ((list(self.quantity.values), axes), ([name], panel)):
            points = np.concatenate([view.deformed(self.result.points[key], self.factor) for key in part])
            values = np.concatenate([self.quantity.values[key] for key in part])
            across = camera.project(points)
            if target is panel and self.solid:
                patch = self.patch or view.Patch(points, np.zeros(3))
                across = view.from_above(patch, points).project(points)
            size = 9.0 if target is panel else 4.0
            target.scatter(*across[:, :2].T, s=size, c=self.colours.rgb(values), lw=0.15, edgecolors=_INK)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_title(name, fontsize=9, loc="left")
        _ticks(panel, None, None)

    def _axes(self, rectangle):
        """Axes that are whole pixels large, so that images are shown pixel by pixel."""
        size = np.rint(self.figure.get_size_inches() * DPI)
        corner, extent = np.rint(rectangle[:2] * size), np.rint(rectangle[2:] * size)
        return self.figure.add_axes((*(corner / size), *(extent / size)))

    def _shape(self, axes):
        """Height and width of axes in pixels."""
        width, height = np.rint(axes.get_position().size * self.figure.get_size_inches() * DPI).astype(int)
        return int(height), int(width)

    def _show(self, axes, layer, camera, window, ghost=None):
        """Draw triangles into axes, whose coordinates become those of the view."""
        pixels = paint.image(layer, camera, window, self._shape(axes), self.colours, ghost)
        axes.imshow(np.clip(pixels, 0, 1), extent=window, origin="lower", interpolation="none", aspect="auto")
        axes.set_axis_off()

    def _triad(self, camera):
        """The directions of the coordinates, in the lower left corner."""
        axes = self._axes((0.015, 0.02, 0.075, 0.12))
        axes.set(xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), aspect="equal")
        axes.set_axis_off()
        for name, colour, (x, y, _) in zip(
            "xyz", ("#c0392b", "#2e8b57", "#2c5aa0"), camera.axes.T, strict=True
        ):
            axes.annotate("", (x, y), (0, 0), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.2,
                                                           "shrinkA": 0, "shrinkB": 0})  # fmt: skip
            if np.hypot(x, y) > 0.15:
                axes.text(1.3 * x, 1.3 * y, name, color=colour, ha="center", va="center", fontsize=8)

    def _titles(self, cut):
        """What is shown, when, and what was done to it."""
        kind = " magnitude" if self._is_magnitude() else ""
        self.figure.text(
            0.03, 0.945, (self.quantity.label + kind).capitalize(), fontsize=14, weight="bold", va="center"
        )
        enlarged = "true to scale" if self.factor == 1 else f"displacements × {self.factor:g}"
        notes = [f"time {self.result.time:g}", enlarged] + ["cut open at the contact"] * cut
        notes += ["cells averaged at the nodes"] * (self.averages is not None)
        self.figure.text(0.03, 0.905, "  ·  ".join(notes), fontsize=9, color=_PALE, va="center")

    def _is_magnitude(self):
        """Is the quantity the length of a vector."""
        data = [self.result.bodies.point_data, *(cloud.data for cloud in self.result.points.values())]
        return any(np.ndim(part.get(self.quantity.name, 0.0)) == 2 for part in data)

    def _colour_bar(self):
        """The colours and what they mean."""
        scale, axes = self.colours, self._axes(_BAR)
        mappable = ScalarMappable(scale.norm, scale.colours)
        bar = self.figure.colorbar(mappable, cax=axes, extend=scale.extend)
        bar.outline.set_linewidth(0.5)
        name = textwrap.fill(self.quantity.label, 16)
        self.figure.text(0.985, sum(_BAR[1::2]) + 0.025, name, fontsize=8, color=_PALE, ha="right", va="bottom")
        if scale.kinds:
            kinds = scale.kinds if len(scale.kinds) <= 16 else scale.kinds[:: len(scale.kinds) // 8]
            bar.set_ticks(kinds, labels=[self.quantity.word(kind) for kind in kinds])
            axes.tick_params(length=0)
            return
        bar.formatter.set_powerlimits((-3, 5))
        values = self.quantity.all_values
        if len(values):
            ends = f"max {values.max():.4g}\nmin {values.min():.4g}"
            self.figure.text(_BAR[0], 0.205, ends, fontsize=8, color=_PALE, va="center", linespacing=1.5)


def _ticks(axes, across, upward):
    """A frame with coordinates; None: a direction that is not along a coordinate gets none."""
    axes.set_axis_on()
    axes.spines[:].set_visible(False)
    axes.tick_params(length=2.5, labelsize=7.5)
    for axis, name in ((axes.xaxis, across), (axes.yaxis, upward)):
        if name is None:
            axis.set_visible(False)
        else:
            axis.set_label_text(name)
