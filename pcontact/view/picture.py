"""A picture of the deformed bodies: VTK draws them, matplotlib puts titles, coordinates and colour bars around."""

import textwrap
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from pcontact.io.result import load_result
from pcontact.runtime.errors import InputError
from pcontact.view import camera, cells, curves, shapes
from pcontact.view.colours import DPI, INK, PALE, STYLE, colour_scale, save
from pcontact.view.quantity import find

# pixels per inch of pictures that are as wide as this [pixels] or wider; letters of narrower ones are smaller
NARROW = 1200
_WHOLE, _LEFT = (0.02, 0.03, 0.85, 0.84), (0.02, 0.03, 0.51, 0.84)
_RIGHT, _BAR = (0.60, 0.27, 0.265, 0.424), (0.895, 0.27, 0.016, 0.424)
_CLOSE = 0.4  # border around the contact in a near view, in its own lengths


@dataclass
class Look:
    """Way in which results are looked at.

    Parameters
    ----------
    scale : float or None
        Factor of the displacements; None: 1, or a round number that makes small ones seen.
    size : tuple of int
        Width and height in pixels.
    cut : bool, tuple of (int, float or None) or None
        Solids only: take away what is before a plane through the contact, or before a plane across an axis, at a
        coordinate or through the middle. None: done for fields of the bodies when there is contact.
    smooth : bool
        Fields of cells are averaged at the nodes of each body; otherwise every cell has one colour.
    views : tuple of str
        Some of those of `pcontact.view.show`, side by side; empty: what shows the field best.
    """

    scale: float | None = None
    size: tuple = (1600, 1000)
    cut: object = None
    smooth: bool = True
    views: tuple = ()


def picture(directory, field=None, output=None, step=-1, **look):
    """Draw the deformed bodies, coloured by one field or several. Serial.

    Parameters
    ----------
    directory : str or Path
        The output directory of a run.
    field : str, optional
        A field of bodies, contact surfaces or quadrature points, or a component of it (stress_xx); several with
        commas, each in a row of its own. If absent: the contact pressure if there is any, else the equivalent stress.
    output : str or Path, optional
        The picture, of a type that matplotlib writes (without an ending: PNG); DIRECTORY/FIELD.png if absent.
    step : int
        Which of the steps that are there, from 1; negative numbers count from the last one.
    **look
        See :class:`Look`.

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
    stages = staged(result, field, Look(**look))
    output = Path(output or Path(directory) / f"{'_'.join(stage.quantity.name for stage in stages)}.png")
    output = output if output.suffix else output.with_suffix(".png")
    save(compose(stages, Look(**look)), output)
    return output


def staged(result, field, look):
    """Return what is to be drawn of a result: a stage for each field."""
    if cells.dimension(result.bodies) < 2:
        raise InputError(f"{result.directory}: there are no bodies to draw")
    names = [None] if field is None else [name.strip() for name in field.split(",")]
    return [Stage(result, find(result, name), look) for name in names]


def compose(stages, look):
    """All stages, one below the other.

    Returns
    -------
    matplotlib.figure.Figure
    """
    with matplotlib.rc_context(STYLE):
        dpi = DPI * min(1.0, look.size[0] / NARROW)
        figure = Figure(figsize=(look.size[0] / dpi, look.size[1] / dpi), dpi=dpi, facecolor="white")
        FigureCanvasAgg(figure)
        height = 1 / len(stages)
        for row, stage in enumerate(stages):
            _Row(figure, stage, (0.0, 1 - (row + 1) * height, 1.0, height)).draw()
    return figure


class Stage:
    """A field of a result where it is drawn: deformed bodies, contact, colours.

    Parameters
    ----------
    result : pcontact.io.result.Result
    quantity : pcontact.view.quantity.Quantity
    look : Look

    Attributes
    ----------
    bodies : pcontact.io.fields.Piece
        Without nodes in common.
    positions, surfaces : ndarray (n, 3), dict of str to ndarray (n, 3)
        Points of bodies and contact surfaces as they are drawn.
    patch : pcontact.view.camera.Patch or None
        Where solids touch.
    colours : pcontact.view.colours.ColourScale
    factor : float
        Of the displacements.
    """

    def __init__(self, result, quantity, look):
        self.result, self.quantity, self.look = result, quantity, look
        self.on_bodies = quantity.place == "bodies"
        self.smooth = look.smooth and self.on_bodies and quantity.at == "cell" and not quantity.whole
        self.solid = cells.dimension(result.bodies) == 3
        self.factor = camera.deformation_scale(result) if look.scale is None else float(look.scale)
        whole = self.on_bodies and quantity.at == "point"
        self.bodies = result.bodies if whole else cells.apart(result.bodies)
        self.positions = camera.deformed(self.bodies, self.factor)
        self.surfaces = {name: camera.deformed(piece, self.factor) for name, piece in result.surfaces.items()}
        self.patch = camera.contact_patch(result.surfaces, self.surfaces) if self.solid else None
        self.colours = colour_scale(quantity)
        self.window = None
        """Points that are always in the picture; None: those that are drawn."""

    def at(self, result, quantity, window):
        """The same of another load step, in the same colours and from the same place."""
        other = Stage(result, quantity, self.look)
        other.factor, other.colours, other.patch, other.window = self.factor, self.colours, self.patch, window
        other.positions = camera.deformed(other.bodies, self.factor)
        other.surfaces = {name: camera.deformed(piece, self.factor) for name, piece in result.surfaces.items()}
        return other

    @property
    def views(self):
        """Return what is drawn side by side."""
        if self.look.views:
            return self.look.views
        return ("whole",) if self.on_bodies else ("whole", "detail")

    def cut(self, view):
        """Plane (normal, offset or None) and camera of a view, for solids.

        Returns
        -------
        plane : tuple or None
        camera : pcontact.view.camera.Camera
        """
        if not self.solid:
            return None, camera.Camera(np.eye(3))
        wanted = self.look.cut
        if isinstance(wanted, tuple):
            axis, where = wanted
            low, high = self.positions[:, axis].min(), self.positions[:, axis].max()
            return camera.across(axis, (low + high) / 2 if where is None else where)
        wanted = self.on_bodies if wanted is None else wanted
        if self.patch is None or not (wanted or view == "cut"):
            return None, camera.overview(self.patch)
        normal, offset, eye = camera.cut_open(self.patch, self.positions)
        return (None if offset is None else (normal, offset)), eye

    def body_shape(self, plane):
        """The bodies, coloured if the field is theirs."""
        values = self.quantity.values[""] if self.on_bodies else None
        return shapes.bodies(self.bodies, self.positions, values, self.quantity.at, self.smooth, plane)

    def contact_shape(self, names, idle):
        """The facets of some contact pairs."""
        return shapes.join([
            shapes.contact(self.result.surfaces[name], self.surfaces[name], self.quantity.values[name],
                           self.quantity.at, idle)
            for name in names
        ])  # fmt: skip

    def leading(self):
        """The contact pair with the largest number in it."""
        return max(self.quantity.values, key=lambda name: np.max(np.abs(self.quantity.values[name]), initial=-1.0))

    @property
    def none_if_open(self):
        """Return whether facets without a positive value say nothing."""
        return self.quantity.name in ("contact_pressure", "status")


def around_contact(stage, points):
    """Corners (8, 3) of a box around the contact, within that of some points; without contact these (n, 3)."""
    touching = curves.touching(stage)
    if not len(touching):
        return points
    low, high = touching.min(axis=0), touching.max(axis=0)
    border = _CLOSE * (high - low).max() + 1e-12
    low, high = np.maximum(low - border, points.min(axis=0)), np.minimum(high + border, points.max(axis=0))
    return np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T


class _Row:
    """The parts of a picture of one field, and where they go in a rectangle of the figure."""

    def __init__(self, figure, stage, rectangle):
        self.figure, self.stage, self.quantity = figure, stage, stage.quantity
        self.rectangle = np.asarray(rectangle)
        self.is_cut = False

    def draw(self):
        """Draw everything."""
        views = self.stage.views
        if views == ("whole",):
            spots = [_WHOLE]
        elif views == ("whole", "detail"):
            spots = [_LEFT, _RIGHT]
        else:
            width, top = 0.85 / len(views), 1 - 0.16 / self.rectangle[3] ** 0.5
            spots = [(0.02 + k * width, 0.05, width - 0.03, top - 0.05) for k in range(len(views))]
        for view, spot in zip(views, spots, strict=True):
            self._view(view, spot, named=len(views) > 1 and view != "detail" and bool(self.stage.look.views))
        self._titles()
        self._colour_bar()

    def _view(self, view, spot, named):
        stage = self.stage
        if view in ("whole", "cut", "near"):
            self._bodies(view, spot, named)
            return
        place = self.quantity.place
        if place == "points":
            self._cloud(self._axes(spot), alone=True)
        elif place == "bodies":
            raise InputError(
                f"-views: found {view!r} of {self.quantity.name}, a field of the bodies; allowed: whole, cut, near"
            )
        elif stage.solid and view in ("detail", "surface"):
            self._surface_alone(self._axes(spot))
        else:
            inset = np.array(spot) + (0.05, 0.06, -0.06, -0.10) if view != "detail" else spot
            axes = self._axes(inset)
            curved = curves.is_curved(stage) if view == "detail" else view == "unrolled"
            curves.draw(axes, stage, curved)
            if named:
                axes.set_title(view, fontsize=9, loc="left")

    def _bodies(self, view, spot, named):
        """The bodies, with what is between them."""
        stage = self.stage
        plane, eye = stage.cut(view)
        self.is_cut |= plane is not None
        left, bottom, width, height = spot
        # coordinates are written beside plane bodies, as large in a low row as in a high one, and not into its titles
        border, row = 0.0 if stage.solid else 0.04, self.rectangle[3]
        top = bottom + height if stage.solid or row == 1.0 else min(bottom + height, 1 - 0.13 / row**0.5)
        bottom += border / row
        axes = self._axes((left + border, bottom, width - border, top - bottom))
        size = self._shape(axes)
        shape = stage.body_shape(plane)
        seen = shape.points() if stage.window is None else stage.window
        if view == "near":
            seen = around_contact(stage, seen)
        window = camera.fit(seen, eye, size)
        pixels = shapes.image(shape, eye, window, size, stage.colours)
        if self.quantity.place == "surfaces" and stage.solid:
            facets = stage.contact_shape(self.quantity.values, "drop" if stage.none_if_open else "keep")
            pixels = shapes.through_glass(shapes.image(facets, eye, window, size, stage.colours), pixels)
        axes.imshow(np.clip(pixels, 0, 1), extent=window, origin="upper", interpolation="none", aspect="auto")
        axes.set_axis_off()
        if self.quantity.place == "points":
            self._cloud(axes, eye)
        elif self.quantity.place == "surfaces" and not stage.solid:
            curves.on_bodies(axes, stage)
        if stage.solid:
            self._triad(eye, spot)
        else:
            _ticks(axes, "x", "y")
        if named:
            axes.set_title(view, fontsize=9, loc="left")

    def _surface_alone(self, axes):
        """A solid's contact surface seen along its mean normal, the patch filling the panel."""
        stage, name = self.stage, self.stage.leading()
        patch = camera.contact_patch({name: stage.result.surfaces[name]}, stage.surfaces)
        if patch is None:
            axes.set_axis_off()
            return
        idle = "grey" if stage.none_if_open and not self.quantity.whole else "keep"
        shape = stage.contact_shape([name], idle)
        eye = camera.from_above(patch, patch.points)
        size = self._shape(axes)
        window = self._close(shape, patch, eye, size)
        pixels = shapes.image(shape, eye, window, size, stage.colours)
        axes.imshow(np.clip(pixels, 0, 1), extent=window, origin="upper", interpolation="none", aspect="auto")
        axes.set_title(name, fontsize=9, loc="left")
        across = [int(np.argmax(np.abs(row))) for row in eye.axes[:2]]
        along = [row[axis] > 0.99 for row, axis in zip(eye.axes[:2], across, strict=True)]
        _ticks(axes, *("xyz"[axis] if straight else None for axis, straight in zip(across, along, strict=True)))

    @staticmethod
    def _close(shape, patch, eye, size):
        """The window around the patch: with a border of about a third, but not beyond the surface."""
        near, all_ = eye.project(patch.points)[:, :2], eye.project(shape.points())[:, :2]
        border = 0.3 * np.ptp(near, axis=0).max() + 1e-12
        low = np.maximum(near.min(axis=0) - border, all_.min(axis=0))
        high = np.minimum(near.max(axis=0) + border, all_.max(axis=0))
        ends = np.column_stack([np.array([low, high]), np.zeros(2)]) @ eye.axes
        return camera.fit(ends, eye, size, margin=0.02)

    def _cloud(self, axes, eye=None, alone=False):
        """Quadrature points as dots, in the whole or alone."""
        stage = self.stage
        names = [stage.leading()] if alone else list(self.quantity.values)
        points = np.concatenate([camera.deformed(stage.result.points[name], stage.factor) for name in names])
        values = np.concatenate([self.quantity.values[name] for name in names])
        if alone:
            patch = stage.patch or camera.Patch(points, np.zeros(3))
            eye = camera.from_above(patch, points) if stage.solid else camera.Camera(np.eye(3))
        across = eye.project(points)
        colours = stage.colours.rgb(values)
        axes.scatter(*across[:, :2].T, s=9.0 if alone else 4.0, c=colours, lw=0.15, edgecolors=INK)
        if alone:
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_title(names[0], fontsize=9, loc="left")
            _ticks(axes, None, None)

    def _axes(self, spot):
        """Axes that are whole pixels large, so that images are shown pixel by pixel."""
        x, y, width, height = self.rectangle
        spot = np.array([x + spot[0] * width, y + spot[1] * height, spot[2] * width, spot[3] * height])
        size = np.rint(self.figure.get_size_inches() * self.figure.dpi)
        corner, extent = np.rint(spot[:2] * size), np.rint(spot[2:] * size)
        return self.figure.add_axes((*(corner / size), *(extent / size)))

    def _shape(self, axes):
        """Height and width of axes in pixels."""
        width, height = np.rint(axes.get_position().size * self.figure.get_size_inches() * self.figure.dpi).astype(int)
        return int(height), int(width)

    def _text(self, x, y, words, **how):
        left, bottom, width, height = self.rectangle
        self.figure.text(left + x * width, bottom + y * height, words, **how)

    def _triad(self, eye, spot):
        """The directions of the coordinates, in the lower left corner."""
        axes = self._axes((spot[0] - 0.005, spot[1] - 0.01, 0.075, 0.12))
        axes.set(xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), aspect="equal")
        axes.set_axis_off()
        for name, colour, (x, y, _) in zip("xyz", ("#c0392b", "#2e8b57", "#2c5aa0"), eye.axes.T, strict=True):
            axes.annotate("", (x, y), (0, 0), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.2,
                                                           "shrinkA": 0, "shrinkB": 0})  # fmt: skip
            if np.hypot(x, y) > 0.15:
                axes.text(1.3 * x, 1.3 * y, name, color=colour, ha="center", va="center", fontsize=8)

    def _titles(self):
        """Return titles: what is shown, when, and what was done to it."""
        stage, height = self.stage, self.rectangle[3]
        kind = " magnitude" if self._is_magnitude() else ""
        title = (self.quantity.label + kind).capitalize()
        large = 14 if height > 0.6 else 11
        self._text(0.03, 1 - 0.055 / height**0.5, title, fontsize=large, weight="bold", va="center")
        enlarged = "true to scale" if stage.factor == 1 else f"displacements × {stage.factor:g}"
        notes = [f"time {stage.result.time:g}", enlarged]
        if self.is_cut:
            wanted = stage.look.cut
            where = f"across {'xyz'[wanted[0]]}" if isinstance(wanted, tuple) else "at the contact"
            notes.append(f"cut open {where}")
        notes += ["cells averaged at the nodes"] * stage.smooth
        self._text(0.03, 1 - 0.095 / height**0.5, "  ·  ".join(notes), fontsize=9, color=PALE, va="center")

    def _is_magnitude(self):
        """Return whether the quantity is the length of a vector."""
        result = self.stage.result
        pieces = [result.bodies, *result.points.values()]
        return any(np.ndim(one.point_data.get(self.quantity.name, 0.0)) == 2 for one in pieces)

    def _colour_bar(self):
        """The colours and what they mean."""
        scale, axes = self.stage.colours, self._axes(_BAR)
        bar = self.figure.colorbar(ScalarMappable(scale.norm, scale.colours), cax=axes, extend=scale.extend)
        bar.outline.set_linewidth(0.5)
        name = textwrap.fill(self.quantity.label, 16)
        # above the power of ten that the numbers may have
        self._text(0.985, sum(_BAR[1::2]) + 0.05, name, fontsize=8, color=PALE, ha="right", va="bottom")
        if scale.kinds:
            kinds = scale.kinds if len(scale.kinds) <= 16 else scale.kinds[:: len(scale.kinds) // 8]
            bar.set_ticks(kinds, labels=[self.quantity.word(kind) for kind in kinds])
            axes.tick_params(length=0)
            return
        bar.formatter.set_powerlimits((-3, 5))
        values = self.quantity.all_values
        if len(values):
            ends = f"max {values.max():.4g}\nmin {values.min():.4g}"
            self._text(0.985, 0.205, ends, fontsize=8, color=PALE, va="center", ha="right", linespacing=1.5)


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
            axis.labelpad = 0.5
