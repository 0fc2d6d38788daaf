"""The extra `view`: is pyvista there, can it be installed, and how does VTK draw on this machine."""

import ctypes
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from pcontact.runtime import log
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
    """Which of some modules cannot be imported."""
    return [name for name in modules if find_spec(name) is None]


def require(modules=MODULES):
    """See to it that modules of the extra are there; install it into an environment that the set-up has made.

    Parameters
    ----------
    modules : sequence of str

    Raises
    ------
    InputError
        They are not, and cannot be installed: one line that says what to do.
    """
    if not missing(modules):
        return
    words = f"pcontact view: found no Python package {', '.join(missing(modules))}"
    by_hand = f"{sys.executable} -m pip install {' '.join(repr(name) for name in PACKAGES)}"
    stamp = Path(sys.prefix) / "pcontact-setup"
    if not stamp.exists() or not os.access(sys.prefix, os.W_OK):
        raise InputError(f"{words}; allowed: the extra `view`: {by_hand}")
    log.info("installing what draws, once (about 600 MB): %s", " ".join(PACKAGES))
    constraints = Path(sys.prefix) / "pcontact-constraints.txt"
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-input",
         *(["-c", str(constraints)] if constraints.exists() else []), *PACKAGES],
        capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode or missing(modules):
        last = (done.stderr.strip().splitlines() or ["it is still missing"])[-1]
        raise InputError(f"{words}, and pip could not install it ({last}); allowed: {by_hand}")


def _works(window):
    """Whether VTK draws with such a window, tried in a process of its own: with a library missing it crashes."""
    environment = {**os.environ, _WINDOW: window} if window else {k: v for k, v in os.environ.items() if k != _WINDOW}
    try:
        done = subprocess.run([sys.executable, "-P", "-c", _PROBE], env=environment, capture_output=True, text=True,
                              timeout=_PATIENCE)  # fmt: skip
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0 and bool(done.stdout.strip())


def has_display():
    """Whether windows can be opened: the X server that DISPLAY names answers. VTK opens no others on Linux."""
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
