"""From where a result is looked at, where it is cut open, and how much its deformation is enlarged."""

from dataclasses import dataclass

import numpy as np

from pcontact.view import cells

_AXES = np.eye(3)


@dataclass
class Camera:
    """An orthographic view.

    Parameters
    ----------
    axes : ndarray (3, 3)
        Rows: to the right, upward, toward the viewer; unit vectors.
    """

    axes: np.ndarray

    def project(self, points):
        """Coordinates in the view: right, up, nearness [length].

        Parameters
        ----------
        points : ndarray (..., 3)

        Returns
        -------
        ndarray (..., 3)
        """
        return points @ self.axes.T


def look(toward, up):
    """The view from a direction.

    Parameters
    ----------
    toward : array_like (3,)
        From the object to the viewer.
    up : array_like (3,)
        Shown upward as far as possible; not parallel to `toward`.

    Returns
    -------
    Camera
    """
    toward = np.asarray(toward, dtype=float) / np.linalg.norm(toward)
    right = np.cross(up, toward)
    right /= np.linalg.norm(right)
    return Camera(np.array([right, np.cross(toward, right), toward]))


def fit(points, camera, shape, margin=0.05):
    """The part of the view that holds the points, in the proportions of the picture.

    Parameters
    ----------
    points : ndarray (n, 3)
    camera : Camera
    shape : tuple of int
        Height and width in pixels.
    margin : float
        Empty border, as a fraction of the size.

    Returns
    -------
    tuple of 4 floats
        Left, right, bottom, top [length].
    """
    seen = camera.project(points)[:, :2] if len(points) else np.zeros((1, 2))
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2 * (1 + 2 * margin)
    pixel = max(half[0] / shape[1], half[1] / shape[0], 1e-12)
    return (
        middle[0] - pixel * shape[1], middle[0] + pixel * shape[1],
        middle[1] - pixel * shape[0], middle[1] + pixel * shape[0],
    )  # fmt: skip


@dataclass
class Patch:
    """Patch on which the bodies touch.

    Parameters
    ----------
    points : ndarray (n, 3)
        Middles of the facets under pressure.
    normal : ndarray (3,)
        Their mean normal, not oriented; zero where they look in all directions.
    """

    points: np.ndarray
    normal: np.ndarray


def deformation_scale(result):
    """Return the factor that enlarges displacements: not at all if they are seen as they are.

    Nor where bodies of different shape touch: with the gap between them left as it is, enlarged displacements would
    push one into the other. Surfaces that fit each other everywhere have gaps no larger than the displacements.

    Parameters
    ----------
    result : Result

    Returns
    -------
    float
        1, or a round number that makes the largest displacement about a twentieth of the size.
    """
    displacement = result.bodies.point_data.get("displacement")
    if displacement is None or not len(displacement):
        return 1.0
    size = np.linalg.norm(np.ptp(result.bodies.points, axis=0))
    largest = np.linalg.norm(displacement, axis=1).max()
    met = [cloud.point_data for cloud in result.points.values() if "gap" in cloud.point_data]
    # where there is no partner the gap is not known
    gaps = np.concatenate([np.zeros(1), *(data["gap"][data.get("paired", data["gap"] * 0 + 1) > 0] for data in met)])
    if not 0 < largest < 0.01 * size or np.nanmax(gaps) > 0.5 * largest:
        return 1.0
    wanted = 0.05 * size / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return max(1.0, float(power * max(digit for digit in (1, 2, 5) if digit * power <= wanted)))


def deformed(piece, scale):
    """Points of a piece with its displacement added.

    Parameters
    ----------
    piece : Piece
    scale : float
        Factor of the displacement.

    Returns
    -------
    ndarray (n, 3)
    """
    return piece.points + scale * piece.point_data.get("displacement", np.zeros(3))


def contact_patch(surfaces, positions):
    """The facets under pressure of all pairs; all facets if there is no pressure.

    Parameters
    ----------
    surfaces : dict of str to Piece
    positions : dict of str to ndarray (n, 3)
        Their points as they are drawn.

    Returns
    -------
    Patch or None
        None without facets.
    """
    middles, areas, pressures = [], [], []
    for name, piece in surfaces.items():
        middle, area, owner = cells.middles(piece, positions[name])
        blocks = piece.cell_data.get("contact_pressure")
        pressure = np.concatenate(blocks) if blocks else np.zeros(owner.max(initial=-1) + 1)
        middles.append(middle)
        areas.append(area)
        pressures.append(pressure[owner])
    if not sum(len(part) for part in middles):
        return None
    middle, area, pressure = (np.concatenate(part) for part in (middles, areas, pressures))
    touching = pressure > 0
    if not touching.any():
        touching[:] = True
        pressure[:] = 1.0
    force = (pressure[:, None] * area)[touching]
    total, parts = np.linalg.norm(force.sum(axis=0)), np.linalg.norm(force, axis=1).sum()
    normal = force.sum(axis=0) / total if total > 0.2 * parts else np.zeros(3)
    return Patch(middle[touching], normal)


def touched(pieces, positions):
    """Ends (n, 3) of the segments of plane contact surfaces, and of those under pressure; all if there is no pressure.

    Parameters
    ----------
    pieces : dict of str to Piece
    positions : dict of str to ndarray (n, 3)
    """
    every, near = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for name, piece in pieces.items():
        nodes, owner = cells.segments(piece)
        corners = positions[name][nodes]
        every.append(corners.reshape(-1, 3))
        blocks = piece.cell_data.get("contact_pressure")
        if blocks and len(nodes):
            near.append(corners[np.concatenate(blocks)[owner] > 0].reshape(-1, 3))
    every, near = np.concatenate(every), np.concatenate(near)
    return every, near if len(near) else every


def along(pieces, positions):
    """The coordinate along which contact surfaces of plane bodies extend, and the part of it under pressure.

    Parameters
    ----------
    pieces : dict of str to Piece
    positions : dict of str to ndarray (n, 3)
        Their points as they are drawn.

    Returns
    -------
    axis : int
        0 or 1.
    ends : tuple of 2 floats
        The part under pressure with a border of half its length, but not beyond the surfaces; all of them if there
        is no pressure [length].
    """
    all_, near = touched(pieces, positions)
    axis = int(np.argmax(np.ptp(near, axis=0)[:2]))
    low, high = near[:, axis].min(), near[:, axis].max()
    border = 0.5 * (high - low)
    return axis, (max(low - border, all_[:, axis].min()), min(high + border, all_[:, axis].max()))


def up_axis(patch):
    """The coordinate direction shown upward: z, unless the bodies are pressed together along y.

    Parameters
    ----------
    patch : Patch or None

    Returns
    -------
    int
    """
    return 1 if patch is not None and abs(patch.normal[1]) > 0.9 else 2


def overview(patch):
    """The view of the whole.

    Parameters
    ----------
    patch : Patch or None

    Returns
    -------
    Camera
    """
    up = up_axis(patch)
    toward = (0.50, -0.80, 0.38) if up == 2 else (0.55, 0.38, 0.80)
    return look(toward, _AXES[up])


def from_above(patch, positions):
    """The view of the contact surface along its mean normal, the longer side of the patch to the right.

    Parameters
    ----------
    patch : Patch
    positions : ndarray (n, 3)
        The points to be seen.

    Returns
    -------
    Camera
    """
    if not patch.normal.any():
        return overview(patch)
    normal = patch.normal if patch.normal @ np.ones(3) > 0 else -patch.normal
    sizes = np.ptp(positions, axis=0)
    flat = np.argsort(np.abs(normal))[:2]
    # nearly as long as wide: keep the coordinates in their order
    upward = flat[np.argmin(sizes[flat])] if np.ptp(sizes[flat]) > 0.2 * sizes[flat].max() else max(flat)
    camera = look(normal, _AXES[upward])
    right = camera.axes[0]
    if right[np.argmax(np.abs(right))] < 0:
        camera = look(normal, -_AXES[upward])
    return camera


def cut_open(patch, positions):
    """The plane through the middle of the contact patch that shows most of it, and the view upon it.

    The plane contains the direction in which the bodies are pressed together and cuts the patch across its
    length. A patch that reaches the outer face of the bodies on one side only belongs to a model of one half
    or one quarter: that face is the section, and nothing is cut away.

    Parameters
    ----------
    patch : Patch
    positions : ndarray (n, 3)
        Points of the bodies.

    Returns
    -------
    normal : ndarray (3,)
        From the plane toward the viewer.
    offset : float or None
        Position of the plane along it; None: nothing is to be cut away.
    camera : Camera
    """
    up = up_axis(patch)
    pressed = int(np.argmax(np.abs(patch.normal))) if patch.normal.any() else up
    axes = [axis for axis in (1, 0, 2) if axis not in (pressed, up)]
    low, high = positions.min(axis=0), positions.max(axis=0)
    first, last = patch.points.min(axis=0), patch.points.max(axis=0)
    # facets' middles stay off the face by part of a facet: allow for it by the patch's own length
    slack = 0.15 * (last - first) + 0.01 * (high - low)
    at_low, at_high = first - low < slack, high - last < slack
    halves = [axis for axis in axes if at_low[axis] != at_high[axis]]
    # across the longer side; of two that are about equal, the one looked along in the usual front view
    longest = max(last[axis] - first[axis] for axis in axes)
    long = [axis for axis in axes if last[axis] - first[axis] > 0.8 * longest]
    axis = (halves or long or axes)[0]
    sign = (1.0 if at_high[axis] else -1.0) if halves else (-1.0 if axis == 1 and up == 2 else 1.0)
    normal = sign * _AXES[axis]
    offset = None if halves else sign * (first[axis] + last[axis]) / 2
    side = np.cross(_AXES[up], normal)
    return normal, offset, look(normal + 0.35 * side + 0.35 * _AXES[up], _AXES[up])


def across(axis, where):
    """A plane across an axis, and the view upon it.

    Parameters
    ----------
    axis : int
    where : float
        Coordinate of the plane [length].

    Returns
    -------
    plane : tuple of (ndarray (3,), float)
        Normal, toward the viewer, and offset.
    camera : Camera
    """
    sign = -1.0 if axis == 1 else 1.0
    normal, up = sign * _AXES[axis], _AXES[1 if axis == 2 else 2]
    side = np.cross(up, normal)
    return (normal, sign * where), look(normal + 0.35 * side + 0.35 * up, up)
