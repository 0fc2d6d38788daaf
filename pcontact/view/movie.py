"""All load steps one after the other: an animated picture, or a film."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
from PIL import Image

from pcontact.io.result import load_result
from pcontact.runtime.errors import InputError
from pcontact.runtime.files import written_aside
from pcontact.view.colours import colour_scale
from pcontact.view.picture import Look, compose, staged
from pcontact.view.quantity import Quantity, find

LENGTH, SLOWEST, FASTEST = 6.0, 0.5, 0.04  # [s] of all, and how long one load step is shown at most and at least
LAST = 4  # how often the last one is shown


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
        There are no fields, no field of that name, or no ffmpeg for .mp4.
    OutputError
        The file cannot be written.
    """
    output, look = Path(output), Look(**{"size": (1280, 800), **look})
    coder = _coder() if output.suffix.lower() == ".mp4" else None
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
        if coder is None:
            first, *rest = (Image.fromarray(frame).quantize(256, dither=Image.Dither.NONE) for frame in frames)
            first.save(part, "GIF", save_all=True, append_images=rest, duration=int(1000 * seconds), loop=0)
        else:
            _film(coder, frames, seconds, part)
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
        values = {str(k): quantity.all_values for k, quantity in enumerate(every)}
        stage.colours = colour_scale(_of_all(stage.quantity, values), _maps())
        ends = [_corners(stage.at(result, quantity, None).positions)
                for result, quantity in ((results[0], every[0]), (results[-1], every[-1]))]  # fmt: skip
        window = np.concatenate(ends)
        found.append([stage.at(result, quantity, window) for result, quantity in zip(results, every, strict=True)])
    return found


def _maps():
    import matplotlib

    return matplotlib.colormaps


def _of_all(quantity, values):
    """The quantity of all load steps, for its colours."""
    return Quantity(quantity.name, quantity.place, quantity.at, values, quantity.whole)


def _corners(points):
    """Few points with the same extent from nearly any side: those that are outermost in some directions."""
    directions = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z])
    more = np.array([[x, y, z] for x in (-2, -1, 1, 2) for y in (-2, -1, 1, 2) for z in (-2, -1, 1, 2)])
    return points[np.unique(np.argmax(points @ np.concatenate([directions, more]).T, axis=0))]


def _coder():
    """The program that codes films."""
    found = shutil.which("ffmpeg")
    if found is None:
        try:
            from imageio_ffmpeg import get_ffmpeg_exe

            found = get_ffmpeg_exe()
        except (ModuleNotFoundError, RuntimeError):
            raise InputError(
                "pcontact view: -o: found no ffmpeg, which makes .mp4; allowed: .gif, or pip install imageio-ffmpeg"
            ) from None
    return found


def _film(coder, frames, seconds, path):
    """Code frames as H.264, which needs even numbers of pixels."""
    height, width = (n - n % 2 for n in frames[0].shape[:2])
    command = [coder, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
               "-r", f"{1 / seconds:.6g}", "-i", "-", "-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-r", "25",
               "-movflags", "+faststart", "-f", "mp4", str(path)]  # fmt: skip
    pixels = b"".join(np.ascontiguousarray(frame[:height, :width]).tobytes() for frame in frames)
    done = subprocess.run(command, input=pixels, capture_output=True)
    if done.returncode:
        raise InputError(f"{path}: ffmpeg could not code the film: {done.stderr.decode(errors='replace').strip()}")
