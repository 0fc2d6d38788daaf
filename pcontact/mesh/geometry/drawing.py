"""Curves and surfaces of a geometry that gmsh reads, and the points on them that are nearest to others."""

import importlib
import os
import sys
from contextlib import contextmanager

import numpy as np

from pcontact.mesh.gmsh_reader import apart
from pcontact.runtime import signals
from pcontact.runtime.errors import InputError

# kinds of curves and surfaces that cells of degree 1 follow by themselves, as gmsh calls them
FLAT = ("Line", "Plane")
# [-] Room around the box of a curve or surface, over its diagonal. From: gmsh's boxes are those of samples of it where
# its own kernel made it.
ROOM = 0.05


class Drawing:
    """A geometry, as long as it is open; see :func:`opened`.

    Parameters
    ----------
    model : module
        gmsh.model
    dim : int
        Of the mesh.

    Attributes
    ----------
    boundary, curves : range
        Numbers of the curves (plane meshes) or surfaces (meshes in space) that bound bodies; in space, numbers of
        curves.
    entities : list of (int, int)
        Dimension and gmsh's tag, by number.
    flat : ndarray (n,) of bool
        Straight lines and planes.
    low, high : ndarray (n, 3)
        Corners of boxes around them [length].
    """

    def __init__(self, model, dim):
        self._model, self.entities = model, [(dim - 1, tag) for _, tag in model.getEntities(dim - 1)]
        self.boundary = range(len(self.entities))
        if dim == 3:
            self.entities += [(1, tag) for _, tag in model.getEntities(1)]
        self.curves = range(len(self.boundary), len(self.entities))
        self.flat = np.array([model.getType(*one) in FLAT for one in self.entities], dtype=bool)
        boxes = np.reshape([model.getBoundingBox(*one) for one in self.entities], (-1, 6))
        room = ROOM * np.linalg.norm(boxes[:, 3:] - boxes[:, :3], axis=1)[:, None]
        self.low, self.high = boxes[:, :3] - room, boxes[:, 3:] + room

    @property
    def size(self):
        """float : diagonal of the box around everything [length]."""
        box = np.array(self._model.getBoundingBox(-1, -1))
        return float(np.linalg.norm(box[3:] - box[:3]))

    def closest(self, number, points):
        """The points of a curve or surface that are nearest to others.

        Parameters
        ----------
        number : int
        points : ndarray (n, d)

        Returns
        -------
        places : ndarray (n, d)
        distances : ndarray (n,)
            Infinite where the curve is a single point.
        """
        if not len(points):
            return np.array(points), np.zeros(0)
        full = np.zeros((len(points), 3))
        full[:, : points.shape[1]] = points
        try:
            found = np.reshape(self._model.getClosestPoint(*self.entities[number], full.ravel())[0], (-1, 3))
        except Exception:  # gmsh knows no other class; the seam of a sphere ends in points that are curves to it
            return np.array(points), np.full(len(points), np.inf)
        return found[:, : points.shape[1]].copy(), np.linalg.norm(found - full, axis=1)

    def contains(self, number, point):
        """Whether a point (d,) of the carrier of a curve or surface is within its ends or edges."""
        full = np.zeros(3)
        full[: len(point)] = point
        return self._model.isInside(*self.entities[number], full) > 0


@contextmanager
def opened(path, dim):
    """A geometry, for meshes of a dimension. Serial.

    Parameters
    ----------
    path : pathlib.Path
    dim : int

    Yields
    ------
    Drawing

    Raises
    ------
    InputError
        What is wrong with the file, in a few words.
    """
    try:
        # no run without a geometry waits for it
        gmsh = importlib.import_module("gmsh")
    except (ImportError, OSError):  # not installed, or a system library that it needs is missing
        raise InputError("without the Python package gmsh") from None
    # somebody who calls the program from Python may have gmsh open, with models of his own
    before = gmsh.model.getCurrent() if gmsh.isInitialized() else None
    if before is None:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        signals.take_back()
    terminal = gmsh.option.getNumber("General.Terminal")
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        try:
            with _silent(), apart(path) as file:
                gmsh.open(str(file))
        except Exception as error:  # gmsh knows no other class
            raise InputError(f"a file that gmsh cannot read: {' '.join(str(error).split())}") from None
        drawing = Drawing(gmsh.model, dim)
        if not drawing.entities:
            raise InputError(f"a file without {'curves' if dim == 2 else 'surfaces'}")
        yield drawing
    finally:
        if before is None:
            gmsh.finalize()
        else:
            gmsh.option.setNumber("General.Terminal", terminal)
            gmsh.model.remove()
            if before in gmsh.model.list():
                gmsh.model.setCurrent(before)


@contextmanager
def _silent():
    """Keep what a library prints off the standard output: readers of STEP files say there what they do not like."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
