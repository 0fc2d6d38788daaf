"""Which triangle is seen at each pixel: a depth buffer, exact where sorting by depth is not.

Painting facets from back to front goes wrong where large facets meet small ones, as two bodies in contact do.
"""

from dataclasses import dataclass

import numpy as np

from pcontact.runtime.jit import njit

FAR = 1e30
SHARP = np.cos(np.radians(40.0))  # cosine of the angle between facets from which on their common edge is a crease


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


@dataclass
class Buffers:
    """What is seen at the pixels, row 0 at the bottom.

    Parameters
    ----------
    triangle : ndarray of int64 (height, width)
        Number of the triangle, -1 where there is none.
    depth : ndarray (height, width)
        Nearness of the point seen [length].
    value : ndarray (height, width)
        The value there.
    line : ndarray (height, width)
        Distance from the nearest drawn side of that triangle, in pixels.
    """

    triangle: np.ndarray
    depth: np.ndarray
    value: np.ndarray
    line: np.ndarray


def render(corners, values, beyond, edges, window, shape):
    """Find what is seen.

    Parameters
    ----------
    corners : ndarray (nt, 3, 3)
        Corners of the triangles in the view: right, up, nearness.
    values : ndarray (nt, 3)
        Values at the corners, interpolated between them.
    beyond : ndarray (nt, 3) or None
        What lies where this is positive, interpolated likewise, is cut away.
    edges : ndarray of int (nt, 3)
        1: side k, from corner k to corner k + 1, is to be drawn; 2: its corner k is, which is on a neighbour's line.
    window : tuple of 4 floats
        Left, right, bottom, top of the picture in the view [length].
    shape : tuple of int
        Height and width in pixels.

    Returns
    -------
    Buffers
    """
    left, right, bottom, top = window
    scale = np.array([shape[1] / (right - left), shape[0] / (top - bottom), 1.0])
    buffers = Buffers(np.full(shape, -1, dtype=np.int64), *(np.full(shape, x) for x in (-FAR, np.nan, FAR)))
    _draw(
        np.ascontiguousarray((corners - [left, bottom, 0.0]) * scale),
        np.ascontiguousarray(values, dtype=float),
        np.full(edges.shape, -1.0) if beyond is None else np.ascontiguousarray(beyond, dtype=float),
        np.ascontiguousarray(edges, dtype=np.int64),
        buffers.triangle, buffers.depth, buffers.value, buffers.line,
    )  # fmt: skip
    return buffers


@njit
def _draw(corners, values, beyond, edges, triangle, depth, value, line):
    """Pixel by pixel, inside each triangle's bounding box.

    At the centre of a pixel the weight of corner k is the area of the triangle it forms with the side
    opposite, over the whole area; weight times height is the distance from that side.
    """
    height, width = triangle.shape
    for t in range(len(corners)):
        ax, ay, az = corners[t, 0]
        bx, by, bz = corners[t, 1]
        cx, cy, cz = corners[t, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-12:
            continue
        first_x, last_x = max(0, int(min(ax, bx, cx) - 0.5)), min(width - 1, int(max(ax, bx, cx) + 0.5))
        first_y, last_y = max(0, int(min(ay, by, cy) - 0.5)), min(height - 1, int(max(ay, by, cy) + 0.5))
        height_a = abs(area) / max(np.hypot(cx - bx, cy - by), 1e-12)
        height_b = abs(area) / max(np.hypot(ax - cx, ay - cy), 1e-12)
        height_c = abs(area) / max(np.hypot(bx - ax, by - ay), 1e-12)
        for row in range(first_y, last_y + 1):
            y = row + 0.5
            for column in range(first_x, last_x + 1):
                x = column + 0.5
                a = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                b = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                c = 1.0 - a - b
                if a < -1e-9 or b < -1e-9 or c < -1e-9:
                    continue
                z = a * az + b * bz + c * cz
                if z <= depth[row, column]:
                    continue
                if a * beyond[t, 0] + b * beyond[t, 1] + c * beyond[t, 2] > 0.0:
                    continue
                depth[row, column] = z
                triangle[row, column] = t
                value[row, column] = a * values[t, 0] + b * values[t, 1] + c * values[t, 2]
                distance = FAR
                if edges[t, 0] == 1:
                    distance = c * height_c
                if edges[t, 1] == 1:
                    distance = min(distance, a * height_a)
                if edges[t, 2] == 1:
                    distance = min(distance, b * height_b)
                if edges[t, 0] == 2:
                    distance = min(distance, np.hypot(x - ax, y - ay))
                if edges[t, 1] == 2:
                    distance = min(distance, np.hypot(x - bx, y - by))
                if edges[t, 2] == 2:
                    distance = min(distance, np.hypot(x - cx, y - cy))
                line[row, column] = distance


def shading(corners):
    """How bright each triangle is, by its slope to a lamp above the viewer's left shoulder.

    Parameters
    ----------
    corners : ndarray (nt, 3, 3)
        Corners in the view.

    Returns
    -------
    ndarray (nt,)
        0.62 to 1.
    """
    lamp = np.array([-0.35, 0.55, 0.76])
    return 0.62 + 0.38 * np.clip(slopes(corners) @ (lamp / np.linalg.norm(lamp)), 0.0, 1.0)


def slopes(corners):
    """Unit normals of triangles, turned toward the viewer.

    Parameters
    ----------
    corners : ndarray (nt, 3, 3)
        Corners in the view.

    Returns
    -------
    ndarray (nt, 3)
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    normal /= np.where(length > 0, length, 1)[:, None]
    return normal * np.where(normal[:, 2:] < 0, -1.0, 1.0)


def outlines(labels, width):
    """Pixels at the border between different labels, on the side of the larger one.

    Parameters
    ----------
    labels : ndarray of int (height, width)
    width : int
        Width of the border in pixels.

    Returns
    -------
    ndarray of bool (height, width)
    """
    border = np.zeros(labels.shape, dtype=bool)
    for step in range(1, width + 1):
        border[:, step:] |= labels[:, step:] > labels[:, :-step]
        border[:, :-step] |= labels[:, :-step] > labels[:, step:]
        border[step:] |= labels[step:] > labels[:-step]
        border[:-step] |= labels[:-step] > labels[step:]
    return border


def creases(triangle, normals, width):
    """Pixels at sharp edges: the rim of a lid, the edges of a block.

    Parameters
    ----------
    triangle : ndarray of int64 (height, width)
        As in `Buffers`.
    normals : ndarray (nt, 3)
        Of the triangles, from `slopes`.
    width : int
        Width of the line in pixels.

    Returns
    -------
    ndarray of bool (height, width)
    """
    border = np.zeros(triangle.shape, dtype=bool)
    for step in range(1, width + 1):
        for one, other in (((slice(None), slice(step, None)), (slice(None), slice(None, -step))),
                           ((slice(step, None),), (slice(None, -step),))):  # fmt: skip
            a, b = triangle[one], triangle[other]
            near = (a != b) & (a >= 0) & (b >= 0)
            near[near] = np.einsum("ni,ni->n", normals[a[near]], normals[b[near]]) < SHARP
            border[one] |= near
    return border


def reduce(pixels, factor):
    """Average blocks of pixels: lines and borders become smooth.

    Parameters
    ----------
    pixels : ndarray (height, width, 4)
        Red, green, blue, opacity, 0 to 1; height and width are multiples of `factor`.
    factor : int

    Returns
    -------
    ndarray (height / factor, width / factor, 4)
    """
    height, width, _ = pixels.shape
    weighted = pixels.copy()
    weighted[..., :3] *= pixels[..., 3:]
    mean = weighted.reshape(height // factor, factor, width // factor, factor, 4).mean(axis=(1, 3))
    mean[..., :3] /= np.maximum(mean[..., 3:], 1e-6)
    return mean
