"""VTK draws: shapes into pixels, without a display, or into a plotter that people turn."""

import numpy as np
import pyvista
from matplotlib.colors import ListedColormap

from pcontact.view.colours import GREYS, INK
from pcontact.view.shapes import BODY, VALUE

FINE = 2  # pixels computed per pixel shown, in each direction
THIN, THICK = 0.8, 1.2  # [pixels] lines of the mesh, outlines
LIFT = 2e-3  # [extent of what is drawn] lines above their faces
_LAMP = (-0.35, 0.55, 0.76)  # right, up, toward the viewer


def add(plotter, shape, scale, pixel=0.0, opacity=1.0, width=1.0, lift=(0.0, 0.0, 0.0), thick=1.0):
    """Add a shape to a plotter.

    Parameters
    ----------
    plotter : pyvista.Plotter
    shape : pcontact.view.shapes.Shape
    scale : pcontact.view.colours.ColourScale
    pixel : float
        Size of a pixel shown: lines are fainter where cells are only a few pixels large, lest they cover the colours;
        0: not known [length].
    opacity : float
    width : float
        Factor of the widths of lines.
    lift : array_like (3,)
        Lines are drawn by this nearer to the viewer than the faces that they are on [length].
    thick : float
        Width of faces that are lines: contact surfaces of plane bodies [pixels].
    """
    colours = ListedColormap(scale.table(256))
    for mesh, lit in shape.faces:
        if not mesh.n_cells:
            continue
        ambient, diffuse = (0.55, 0.5) if lit else (0.0, 1.0)
        look = {"lighting": lit, "ambient": ambient, "diffuse": diffuse, "specular": 0.0, "opacity": opacity,
                "show_scalar_bar": False, "smooth_shading": False, "line_width": thick}  # fmt: skip
        if np.isnan(np.asarray(mesh[VALUE])).all():
            grey = np.array([_rgb(name) for name in GREYS], dtype=np.uint8)
            mesh = mesh.copy(deep=False)
            mesh.clear_point_data()
            mesh.cell_data["grey"] = grey[np.asarray(mesh.cell_data[BODY]) % len(grey)]
            plotter.add_mesh(mesh, scalars="grey", rgb=True, **look)
        else:
            plotter.add_mesh(
                mesh, scalars=VALUE, cmap=colours, clim=(scale.norm.vmin, scale.norm.vmax), nan_color=GREYS[0],
                interpolate_before_map=True, copy_mesh=True, **look,
            )  # fmt: skip
    strength = 0.5 if not pixel else 0.5 * np.clip((shape.size / pixel - 3) / 15, 0, 1)
    for meshes, share, size in ((shape.lines, strength, THIN), (shape.outlines, 0.75, THICK)):
        for mesh in meshes:
            if mesh.n_cells and share > 0.02:
                plotter.add_mesh(
                    mesh.translate(lift, inplace=False), color=INK, line_width=size * width,
                    opacity=float(share) * opacity, lighting=False,
                    show_scalar_bar=False,
                )  # fmt: skip


def _rgb(name):
    return [int(name[k : k + 2], 16) for k in (1, 3, 5)]


def aim(plotter, camera, window):
    """Have the plotter's current view look through a window, without perspective; a lamp at the left shoulder."""
    middle = np.array([(window[0] + window[1]) / 2, (window[2] + window[3]) / 2, 0.0])
    focus = middle @ camera.axes
    points = np.array(plotter.bounds).reshape(3, 2)
    far = 2 * np.linalg.norm(np.ptp(points, axis=1)) + np.abs(points).max() + 1e-12
    plotter.camera.focal_point, plotter.camera.position = focus, focus + far * camera.axes[2]
    plotter.camera.up = camera.axes[1]
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = (window[3] - window[2]) / 2
    plotter.reset_camera_clipping_range()
    plotter.remove_all_lights()
    plotter.add_light(pyvista.Light(position=focus + far * (np.array(_LAMP) @ camera.axes), focal_point=focus,
                                    light_type="scene light", intensity=1.0))  # fmt: skip


def image(shape, camera, window, size, scale):
    """Draw a shape.

    Parameters
    ----------
    shape : pcontact.view.shapes.Shape
    camera : pcontact.view.camera.Camera
    window : tuple of 4 floats
        Left, right, bottom, top in the view [length].
    size : tuple of int
        Height and width in pixels.
    scale : pcontact.view.colours.ColourScale

    Returns
    -------
    ndarray of float32 (height, width, 4)
        Red, green, blue, opacity, 0 to 1; row 0 at the top.
    """
    height, width = size
    plotter = pyvista.Plotter(off_screen=True, window_size=(width * FINE, height * FINE), lighting="none")
    plotter.set_background("white")
    try:
        extent = np.ptp(shape.points(), axis=0).max(initial=0.0) if len(shape.points()) else 0.0
        add(plotter, shape, scale, (window[1] - window[0]) / width, width=FINE, lift=LIFT * extent * camera.axes[2])
        if not plotter.actors:
            return np.zeros((height, width, 4), dtype=np.float32)
        aim(plotter, camera, window)
        pixels = plotter.screenshot(None, return_img=True, transparent_background=True)
    finally:
        plotter.close()
    pixels = pixels.astype(np.float32) / 255
    return _reduced(pixels[: height * FINE, : width * FINE])


def _reduced(pixels):
    """Blocks of pixels averaged: lines and borders become smooth."""
    height, width, _ = pixels.shape
    pixels[..., :3] *= pixels[..., 3:]
    mean = pixels.reshape(height // FINE, FINE, width // FINE, FINE, 4).mean(axis=(1, 3))
    mean[..., :3] /= np.maximum(mean[..., 3:], 1e-6)
    return mean


def through_glass(inside, glass):
    """What lies between bodies, seen through them.

    Parameters
    ----------
    inside, glass : ndarray (height, width, 4)
        Pixels of what lies between, and of the bodies.

    Returns
    -------
    ndarray (height, width, 4)
    """
    body, seen = glass[..., 3:], inside[..., 3:]
    pale = glass[..., :3] * 0.62 + 0.38
    rgb = (1 - seen) * pale + seen * (0.3 * glass[..., :3] + 0.7 * inside[..., :3])
    rgb = np.where(body > 0, rgb, inside[..., :3])
    return np.concatenate([rgb, np.maximum(body, seen)], axis=2)
