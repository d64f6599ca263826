"""Light field of a scene: pinhole images from points of the pupil, in which everything is sharp."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..hologram import channel
from ..mapping import squared
from .preview import Preview

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..mapping import DepthMapping
    from ..optics import Pupil
    from ..progress import Progress

PATHS_PER_STEP = 16  # for each pixel, between two calls of progress


def pupil_points(
    count: int, hologram: Hologram, mapping: DepthMapping, pupil: Pupil | None = None
) -> np.ndarray:
    """Square grid of points, the largest in the disk of the pupil that all wavelengths fill.

    Parameters
    ----------
    count : int
        Number of points in a row and in a column; 1 is the center.
    hologram : Hologram
    mapping : DepthMapping
    pupil : Pupil, optional
        Part of the pupil to take points from.

    Returns
    -------
    numpy.ndarray, shape (v, u, 2)
        Meters to the right and up of the axis; v runs down, like the rows of an image.
    """
    center, radius = _disk(hologram, mapping, pupil)
    half = radius / np.sqrt(2)
    steps = np.linspace(-half, half, count) if count > 1 else np.zeros(1)
    u, v = np.meshgrid(center[0] + steps, center[1] - steps)
    return np.stack([u, v], axis=-1)


def pupil_row(
    count: int, hologram: Hologram, mapping: DepthMapping, pupil: Pupil | None = None
) -> np.ndarray:
    """Points from the left of the pupil to its right, in the middle of even parts; parameters as of `pupil_points`.

    Returns
    -------
    numpy.ndarray, shape (count, 2)
        Meters to the right and up of the axis.
    """
    (x, y), radius = _disk(hologram, mapping, pupil)
    steps = radius * ((2 * np.arange(count) + 1) / count - 1)
    return np.stack([x + steps, np.full(count, y)], axis=-1)


def _disk(hologram, mapping, pupil):
    """Center and radius of the disk that points come from, meters."""
    radius = min(mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths)
    x, y, opening = hologram.optics.stop_circle
    if pupil is None:
        return (radius * x, radius * y), radius * opening
    return (pupil.x, pupil.y), min(radius, pupil.diameter / 2)


def quilt(views: np.ndarray, columns: int) -> np.ndarray:
    """All views in one image, as Looking Glass displays read it: in rows from the lower left one, upwards.

    Parameters
    ----------
    views : numpy.ndarray, shape (view, y, x, ...)
        From the leftmost to the rightmost. Their number must be a multiple of `columns`.
    columns : int
        Number of views in a row.

    Returns
    -------
    numpy.ndarray, shape (rows * y, columns * x, ...)
    """
    _, height, width, *channels = views.shape
    rows = views.reshape(-1, columns, height, width, *channels)[::-1]
    return rows.swapaxes(1, 2).reshape(-1, columns * width, *channels)


def pinhole_pictures(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    points: Sequence | np.ndarray,
    spp: int = 256,
    max_depth: int = 8,
    progress: Progress | None = None,
    focus: float | None = None,
) -> np.ndarray:
    """Images from points of the pupil, by Mitsuba's path tracer.

    Without a focus all cameras look in the same direction: from X meters to the right, an object at depth D appears
    X width / (2 D tan(fov_x / 2)) pixels to the left of its place in the camera's image.

    Parameters
    ----------
    scene, camera, hologram :
        As for `render`.
    points : sequence of (float, float)
        Meters to the right and up of the camera's axis.
    spp : int
        Number of paths for each pixel, rounded up to a multiple of 16.
    max_depth : int
        As in `Settings`.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.
    focus : float, optional
        World depth in meters at which all images coincide. Default: infinity.

    Returns
    -------
    numpy.ndarray, float32, shape (point, y, x, wavelength)
        Linear radiance, row 0 is the top.

    Raises
    ------
    BackendUnavailable
        If Mitsuba cannot compute on this machine.
    Cancelled
        If `progress` raised it.
    """
    progress = progress or (lambda done, message: None)
    camera, hologram = squared(camera, hologram)
    size = hologram.width, hologram.height
    channels = [channel(w) for w in hologram.wavelengths]
    preview = Preview(scene, camera, *size, max_depth=max_depth)
    images = np.empty((len(points), *reversed(size), len(channels)), np.float32)
    steps = -(-spp // PATHS_PER_STEP)
    for k, point in enumerate(points):
        preview.look(camera, *size, focus, center=tuple(point))
        for step in range(steps):
            done = (k * steps + step) / (len(points) * steps)
            light = preview.refine(PATHS_PER_STEP, lambda part, message, done=done: progress(done, "Views"))
            images[k] = light[..., channels]  # the mean of all paths so far
    return images
