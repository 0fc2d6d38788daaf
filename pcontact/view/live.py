"""Results to be turned by hand: in a window, or in a page of their own that a browser shows without a network."""

import html
import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pyvista

from pcontact.io.result import load_result
from pcontact.runtime.files import written_aside
from pcontact.view import render
from pcontact.view.picture import Look, around_contact, staged

_GLASS = 0.35  # opacity of bodies that hide what lies between them
_ROOM = 0.8  # [-] of a panel for the bodies: the colour bar stands beside them
_LINE = 6.0  # [pixels] width of the contact surfaces of plane bodies


def _plotter(directory, field, step, look, off_screen):
    """All fields and views side by side, in a plotter, and the words above them."""
    stages = staged(load_result(directory, step), field, look)
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


def page(directory, field, output, step=-1, **look):
    """Write a page; the parameters are those of :func:`pcontact.view.picture.picture`.

    Returns
    -------
    Path
    """
    output = Path(output)
    plotter, title = _plotter(directory, field, step, Look(**look), off_screen=True)
    try:
        plotter.render()
        words = embedded(plotter.render_window)
    finally:
        plotter.close()
    # the page shows no letters of VTK's
    title = html.escape(title)
    head = f'<div style="position:fixed;top:8px;left:12px;font:15px sans-serif;color:#1c2733">{title}</div>'
    words = words.replace("</body>", head + "</body>", 1)
    with written_aside(output, "-o") as part:
        part.write_text(words, encoding="utf-8")
    return output


def embedded(render_window):
    """What a window shows as a page for vtk.js, all in one file.

    Parameters
    ----------
    render_window : vtkRenderWindow

    Returns
    -------
    str
    """
    from trame_vtk.modules.vtk import serializers
    from trame_vtk.tools.vtksz2html import write_html

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
    packed, words = io.BytesIO(), io.StringIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("index.json", json.dumps({"hashes": arrays, "scene": scene}))
    write_html(packed.getvalue(), words)
    return words.getvalue()
