"""The extra `view`: is pyvista there, can it be installed, and how does VTK draw on this machine."""

import ctypes
import os
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from pcontact.runtime import log, process
from pcontact.runtime.errors import InputError

PACKAGES = ("pyvista>=0.44", "matplotlib", "trame-vtk", "imageio-ffmpeg")  # as the extra `view` of pyproject.toml
MODULES = ("pyvista", "vtkmodules", "matplotlib")
_WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
# how VTK may draw without a display, best first
OFF_SCREEN = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
_PROBE = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64))
plotter.add_mesh(pyvista.Sphere(), color="red")
pixels = plotter.screenshot(None, return_img=True)
print(type(plotter.render_window).__name__ if pixels.std() > 1 else "")
"""
_PATIENCE = 120.0  # [s] the first import of VTK from a slow disk


def missing(modules=MODULES):
    """Return those of some modules that cannot be imported."""
    return [name for name in modules if find_spec(name) is None]


def require(modules=MODULES):
    """See to it that modules of the extra are there; in a venv of the set-up a terminal is asked to install them.

    Parameters
    ----------
    modules : sequence of str

    Raises
    ------
    InputError
        They are not, and are not to be installed, or cannot: one line that says what to do.
    """
    if not missing(modules):
        return
    ours = (Path(sys.prefix) / "pcontact-setup").exists() and os.access(sys.prefix, os.W_OK)
    if not ours or not _agreed(f"{_lost(modules)}. Install it into {sys.prefix}, about 600 MB?"):
        raise InputError(f"{_lost(modules)}; allowed: the extra `view`: {shlex.join(_command())} (about 600 MB)")
    install(modules)


def install(modules=MODULES):
    """Install what draws into the environment, unless it is there.

    Raises
    ------
    InputError
        It cannot be had.
    """
    if not missing(modules):
        return
    log.info("installing what draws, once (about 600 MB): %s", " ".join(PACKAGES))
    quietly = ["-q", "--disable-pip-version-check", "--no-input"]
    done = subprocess.run([*_command(), *quietly], capture_output=True, text=True)
    if done.returncode or missing(modules):
        last = (done.stderr.strip().splitlines() or ["it is still missing"])[-1]
        raise InputError(f"{_lost(modules)}, and pip could not install it ({last}); allowed: {shlex.join(_command())}")


def _lost(modules):
    """Return the modules that are missing, for messages."""
    return f"pcontact view: found no Python package {', '.join(missing(modules))}"


def _command():
    """The words that install the extra, at the versions of the set-up where it has said some."""
    constraints = Path(sys.prefix) / "pcontact-constraints.txt"
    given = ["-c", str(constraints)] if constraints.exists() else []
    return [sys.executable, "-m", "pip", "install", *given, *PACKAGES]


def _agreed(question):
    """Return whether somebody at a terminal says yes."""
    if not (process.is_terminal(sys.stdin) and process.is_terminal(sys.stderr)):
        return False
    sys.stderr.write(f"{question} [y/N] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _works(window):
    """Return whether VTK draws with such a window, tried in a process of its own: with a library missing it crashes."""
    environment = {**os.environ, _WINDOW: window} if window else {k: v for k, v in os.environ.items() if k != _WINDOW}
    try:
        done = subprocess.run([sys.executable, "-P", "-c", _PROBE], env=environment, capture_output=True, text=True,
                              timeout=_PATIENCE)  # fmt: skip
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0 and bool(done.stdout.strip())


def has_display():
    """Return whether windows can be opened: the X server that DISPLAY names answers. VTK opens no others on Linux."""
    if not os.environ.get("DISPLAY"):
        return False
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return False
    x11.XOpenDisplay.restype, x11.XOpenDisplay.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    # stays open: some servers begin anew when the last of their clients leaves, and do not answer meanwhile
    return bool(x11.XOpenDisplay(None))


def prepare_off_screen():
    """Choose how VTK draws without a window, before it is imported.

    Raises
    ------
    InputError
        It cannot: one line that says what to install.
    """
    if os.environ.get(_WINDOW):
        return
    for window in OFF_SCREEN:
        if _works(window):
            os.environ[_WINDOW] = window
            return
    if has_display() and _works(""):
        return
    raise InputError(
        "pcontact view: found no library with which VTK draws without a display; allowed: one of EGL and OSMesa "
        "(Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri)"
    )
