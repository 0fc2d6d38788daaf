"""Results that move: load steps as an animated picture or a film; and results to be turned by hand, in a window, or in
a page of their own that a browser shows without a network.
"""

import base64
import html
import io
import json
import zipfile
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyvista
from PIL import Image

from pcontact.io.result import load_result
from pcontact.runtime.files import written_aside
from pcontact.view import extra, shapes
from pcontact.view.colours import colour_scale
from pcontact.view.picture import Look, around_contact, compose, staged
from pcontact.view.quantity import available, find

LENGTH, SLOWEST, FASTEST = 6.0, 0.5, 0.04  # [s] of all, and how long one load step is shown at most and at least
LAST = 4  # how often the last one is shown
_GLASS = 0.35  # opacity of bodies that hide what lies between them
_ROOM = 0.8  # [-] of a panel for the bodies: the colour bar stands beside them
_LINE = 6.0  # [pixels] width of the contact surfaces of plane bodies
# fields that a page offers where none is named, after that which a picture would show
_OFFERED = ("contact_pressure", "equivalent_stress", "displacement", "equivalent_plastic_strain")
# Scenes of a page, one for each field and load step, at most: load steps are left out evenly. From: chosen.
_SCENES = 24


def movie(directory, field=None, output="movie.gif", **look):
    """Draw all load steps in the same colours, from the same place. Serial.

    Parameters
    ----------
    directory : str or Path
        The output directory of a run.
    field : str, optional
        As of :func:`pcontact.view.picture.picture`.
    output : str or Path
        .gif or .mp4.
    **look
        See :class:`pcontact.view.picture.Look`.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        There are no fields, no field of that name, or no imageio-ffmpeg for .mp4.
    OutputError
        The file cannot be written.
    """
    output, look = Path(output), Look(**{"size": (1280, 800), **look})
    film = output.suffix.lower() == ".mp4"
    if film:
        extra.require(("imageio_ffmpeg",))
    last = load_result(directory)
    results = [load_result(directory, step + 1) for step in range(len(last.times))]
    stages = in_the_same_colours(staged(last, field, look), results)
    frames = []
    for row in zip(*stages, strict=True):
        figure = compose(list(row), look)
        figure.canvas.draw()
        frames.append(np.asarray(figure.canvas.buffer_rgba())[..., :3].copy())
    seconds = float(np.clip(LENGTH / len(frames), FASTEST, SLOWEST))
    frames += frames[-1:] * LAST
    with written_aside(output, "-o") as part:
        if film:
            _film(frames, seconds, part)
        else:
            first, *rest = (Image.fromarray(frame).quantize(256, dither=Image.Dither.NONE) for frame in frames)
            first.save(part, "GIF", save_all=True, append_images=rest, duration=int(1000 * seconds), loop=0)
    return output


def in_the_same_colours(stages, results):
    """Stages of all load steps in the same colours, from the same place.

    Parameters
    ----------
    stages : list of pcontact.view.picture.Stage
        Of one of them: what is drawn, and from where.
    results : list of pcontact.io.result.Result
        Of each load step.

    Returns
    -------
    list of list of pcontact.view.picture.Stage
        For each of the stages, of each load step.
    """
    found = []
    for stage in stages:
        every = [find(result, stage.quantity.name) for result in results]
        # colours of the quantity of all load steps
        values = {str(k): quantity.all_values for k, quantity in enumerate(every)}
        stage.colours = colour_scale(replace(stage.quantity, values=values))
        ends = [_corners(stage.at(result, quantity, None).positions)
                for result, quantity in ((results[0], every[0]), (results[-1], every[-1]))]  # fmt: skip
        window = np.concatenate(ends)
        found.append([stage.at(result, quantity, window) for result, quantity in zip(results, every, strict=True)])
    return found


def _corners(points):
    """Few points with the same extent from nearly any side: those that are outermost in some directions."""
    directions = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z])
    more = np.array([[x, y, z] for x in (-2, -1, 1, 2) for y in (-2, -1, 1, 2) for z in (-2, -1, 1, 2)])
    return points[np.unique(np.argmax(points @ np.concatenate([directions, more]).T, axis=0))]


def _film(frames, seconds, path):
    """Code frames as H.264, which needs even numbers of pixels."""
    from imageio_ffmpeg import write_frames

    height, width = (n - n % 2 for n in frames[0].shape[:2])
    coder = write_frames(str(path), (width, height), fps=1 / seconds, codec="libx264", macro_block_size=2,
                         ffmpeg_log_level="error", output_params=["-r", "25", "-movflags", "+faststart"])  # fmt: skip
    coder.send(None)
    for frame in frames:
        coder.send(np.ascontiguousarray(frame[:height, :width]))
    coder.close()


def _plotted(stages, look, off_screen):
    """Stages and views side by side, in a plotter, and the words above them."""
    panels = [(stage, view) for stage in stages for view in (look.views or ("whole",))]
    titles = []
    plotter = pyvista.Plotter(shape=(1, len(panels)), off_screen=off_screen, window_size=look.size, border=False)
    for column, (stage, view) in enumerate(panels):
        plotter.subplot(0, column)
        plotter.set_background("white")
        plane, eye = stage.cut(view)
        between = stage.quantity.place == "surfaces"
        lift = shapes.LIFT * np.ptp(stage.positions, axis=0).max() * eye.axes[2]
        shape = stage.body_shape(plane)
        # surfaces of plane bodies are lines, which nothing hides
        glass = _GLASS if between and stage.solid else 1.0
        shapes.add(plotter, shape, stage.colours, opacity=glass, lift=lift)
        if between:
            facets = stage.contact_shape(stage.quantity.values, "drop" if stage.none_if_open else "keep")
            shapes.add(plotter, facets, stage.colours, lift=lift, thick=_LINE)
        enlarged = "true to scale" if stage.factor == 1 else f"displacements x {stage.factor:g}"
        named = f" ({view})" if len(look.views) > 1 else ""
        words = f"{stage.quantity.label.capitalize()}{named}\ntime {stage.result.time:g}, {enlarged}"
        titles.append(words.replace("\n", ": "))
        plotter.add_text(words, position="upper_left", font_size=10, color="#1c2733")
        _bar(plotter, stage, column)
        plotter.view_vector(eye.axes[2], viewup=eye.axes[1])
        plotter.enable_parallel_projection()
        if view == "near":
            box = around_contact(stage, shape.points())
            plotter.reset_camera(bounds=np.column_stack([box.min(axis=0), box.max(axis=0)]).ravel())
        else:
            plotter.reset_camera()
        plotter.camera.zoom(_ROOM)
    if len(panels) > 1 and len(set(look.views)) < 2:
        plotter.link_views()
    return plotter, "; ".join(titles)


def _bar(plotter, stage, column):
    """The colour bar of a stage; points of quadrature are dots."""
    scale, quantity = stage.colours, stage.quantity
    if quantity.place == "points":
        clouds = [stage.result.points[name] for name in quantity.values]
        dots = pyvista.PolyData(np.concatenate([cloud.points for cloud in clouds]))
        dots["value"] = np.concatenate(list(quantity.values.values()))
        plotter.add_mesh(dots, scalars="value", cmap=scale.colours, clim=(scale.norm.vmin, scale.norm.vmax),
                         point_size=6, render_points_as_spheres=True, show_scalar_bar=False)  # fmt: skip
    coloured = [actor for actor in plotter.renderer.actors.values()
                if getattr(getattr(actor, "mapper", None), "scalar_visibility", False)
                and tuple(actor.mapper.scalar_range) == (scale.norm.vmin, scale.norm.vmax)]  # fmt: skip
    if coloured:
        plotter.add_scalar_bar(
            # pyvista tells bars apart by their titles
            f"{quantity.label}\n{' ' * column}", mapper=coloured[-1].mapper, color="#1c2733", fmt="%.3g", vertical=True,
            title_font_size=14, label_font_size=12, height=0.5, position_y=0.25, position_x=0.88, width=0.05,
        )  # fmt: skip


def window(directory, field=None, step=-1, **look):
    """Open a window and wait till it is closed; the parameters are those of :func:`pcontact.view.picture.picture`."""
    look = Look(**look)
    plotter, _ = _plotted(staged(load_result(directory, step), field, look), look, off_screen=False)
    plotter.show(title=str(directory))


def page(directory, field=None, output="page.html", step=None, **look):
    """Write a page with a slider over load steps and a choice of fields, as :func:`pcontact.view.picture.picture`.

    Named fields stand side by side instead, and a `step` that is given is the only one.

    Returns
    -------
    Path
    """
    output, look = Path(output), Look(**look)
    last = load_result(directory, -1 if step is None else step)
    first = find(last).name
    fields = [field] if field is not None else [first, *(name for name in _OFFERED if name in available(last)
                                                        and name != first)]  # fmt: skip
    results = [last]
    if step is None:
        count = len(last.times)
        numbers = np.linspace(count, 1, min(count, max(1, _SCENES // len(fields)))).round().astype(int)
        results = [load_result(directory, number) for number in np.unique(numbers).tolist()]
    scenes = []
    for name in fields:
        stages = in_the_same_colours(staged(last, name, look), results)
        scenes.append([_scene([row[k] for row in stages], look) for k in range(len(results))])
    content = {
        "fields": [", ".join(find(last, one.strip()).label.capitalize() for one in name.split(",")) for name in fields],
        "steps": [f"time {result.time:g}" for result in results],
        "titles": [[title for title, _ in row] for row in scenes],
        "scenes": [[data for _, data in row] for row in scenes],
        # the page of vtk.js that shows a scene, all in one file
        "viewer": (files("trame_vtk.tools") / "static_viewer.html").read_text(encoding="utf-8"),
    }
    head, tail = (files("pcontact.view") / "page.html").read_text(encoding="utf-8").split("{{content}}")
    name = html.escape(f"{Path(directory).resolve().name}: {content['fields'][0]}")
    # whatever stands in it, no mark of HTML
    words = head.replace("{{title}}", name) + json.dumps(content).replace("<", "\\u003c") + tail
    with written_aside(output, "-o") as part:
        part.write_text(words, encoding="utf-8")
    return output


def _scene(stages, look):
    """The words above some stages, and what vtk.js shows of them, packed as text."""
    plotter, title = _plotted(stages, look, off_screen=True)
    try:
        plotter.render()
        return title, base64.b64encode(embedded(plotter.render_window)).decode()
    finally:
        plotter.close()


def embedded(render_window):
    """Return what a window shows as a scene for vtk.js, a packed archive.

    Parameters
    ----------
    render_window : vtkRenderWindow

    Returns
    -------
    bytes
    """
    from trame_vtk.modules.vtk import serializers

    serializers.initialize_serializers()
    context = serializers.SynchronizationContext()
    context.set_ignore_last_dependencies(True)
    name = serializers.reference_id(render_window)
    scene = serializers.serialize(None, render_window, name, context, 1)
    eye = render_window.GetRenderers().GetFirstRenderer().GetActiveCamera()
    scene["extra"] = {"vtkRefId": name, "centerOfRotation": eye.GetFocalPoint(),
                      "camera": serializers.reference_id(eye)}  # fmt: skip
    scene["behaviors"] = {"autoOrientation": 1}
    arrays = {
        entry["hash"]: {**entry, "content": context.get_cached_data_array(entry["hash"], False)}
        for entry in serializers.extract_array_hash(scene)
    }
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("index.json", json.dumps({"hashes": arrays, "scene": scene}))
    return packed.getvalue()
