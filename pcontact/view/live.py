"""Results to be turned by hand: in a window, or in a page of their own that a browser shows without a network."""

import base64
import html
import io
import json
import zipfile
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyvista

from pcontact.io.result import load_result
from pcontact.runtime.files import written_aside
from pcontact.view import render
from pcontact.view.movie import in_the_same_colours
from pcontact.view.picture import Look, around_contact, staged
from pcontact.view.quantity import available, find

_GLASS = 0.35  # opacity of bodies that hide what lies between them
_ROOM = 0.8  # [-] of a panel for the bodies: the colour bar stands beside them
_LINE = 6.0  # [pixels] width of the contact surfaces of plane bodies
# fields that a page offers where none is named, after that which a picture would show
_OFFERED = ("contact_pressure", "equivalent_stress", "displacement", "equivalent_plastic_strain")
# Scenes of a page, one for each field and load step, at most: load steps are left out evenly. From: chosen.
_SCENES = 24


def _plotter(directory, field, step, look, off_screen):
    """All fields and views side by side, in a plotter, and the words above them."""
    return _plotted(staged(load_result(directory, step), field, look), look, off_screen)


def _plotted(stages, look, off_screen):
    """The same of stages."""
    panels = [(stage, view) for stage in stages for view in (look.views or ("whole",))]
    titles = []
    plotter = pyvista.Plotter(shape=(1, len(panels)), off_screen=off_screen, window_size=look.size, border=False)
    for column, (stage, view) in enumerate(panels):
        plotter.subplot(0, column)
        plotter.set_background("white")
        plane, eye = stage.cut(view)
        between = stage.quantity.place == "surfaces"
        lift = render.LIFT * np.ptp(stage.positions, axis=0).max() * eye.axes[2]
        shape = stage.body_shape(plane)
        # surfaces of plane bodies are lines, which nothing hides
        glass = _GLASS if between and stage.solid else 1.0
        render.add(plotter, shape, stage.colours, opacity=glass, lift=lift)
        if between:
            facets = stage.contact_shape(stage.quantity.values, "drop" if stage.none_if_open else "keep")
            render.add(plotter, facets, stage.colours, lift=lift, thick=_LINE)
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
    plotter, _ = _plotter(directory, field, step, Look(**look), off_screen=False)
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
        "viewer": _viewer(),
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


def _viewer():
    """The page of vtk.js that shows a scene, all in one file."""
    return (files("trame_vtk.tools") / "static_viewer.html").read_text(encoding="utf-8")


def embedded(render_window):
    """What a window shows as a scene for vtk.js, a packed archive.

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
