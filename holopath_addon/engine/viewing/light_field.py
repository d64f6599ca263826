"""A scene's light field: pictures through points of the pupil, in which everything is sharp."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..hologram import channel
from .preview import Preview

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..mapping import DepthMapping
    from ..progress import Progress
    from ..pupil import Pupil

AT_ONCE = 16  # paths a pixel, between two looks at progress and cancel


def pupil_points(
    count: int, hologram: Hologram, mapping: DepthMapping, pupil: Pupil | None = None
) -> np.ndarray:
    """A square grid of points of the pupil, as large as the disc has room for that all wavelengths fill.

    Parameters
    ----------
    count : int
        Points in a row and in a column; 1 is the middle.
    hologram : Hologram
    mapping : DepthMapping
    pupil : Pupil, optional
        Part of the pupil that is looked through.

    Returns
    -------
    numpy.ndarray, shape (v, u, 2)
        Metres to the right and up of the axis; v runs down, as the rows of a picture do.
    """
    radius = min(mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths)
    centre = (0.0, 0.0) if pupil is None else (pupil.x, pupil.y)
    half = (radius if pupil is None else min(radius, pupil.diameter / 2)) / np.sqrt(2)
    steps = np.linspace(-half, half, count) if count > 1 else np.zeros(1)
    u, v = np.meshgrid(centre[0] + steps, centre[1] - steps)
    return np.stack([u, v], axis=-1)


def pinhole_pictures(
    scene: mi.Scene,
    camera: Camera,
    hologram: Hologram,
    points: Sequence | np.ndarray,
    spp: int = 256,
    max_depth: int = 8,
    seed: int = 0,
    progress: Progress | None = None,
) -> np.ndarray:
    """Pictures through points of the pupil, by Mitsuba's path tracer.

    All look in the same direction: seen from X metres to the right, a thing at depth D lies
    X width / (2 D tan(fov_x / 2)) pixels to the left of where the camera sees it.

    Parameters
    ----------
    scene, camera, hologram :
        As for `render`.
    points : sequence of (float, float)
        Metres to the right and up of the camera's axis.
    spp : int
        Paths a pixel, in steps of 16.
    max_depth, seed : int
        As of `Settings`.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    numpy.ndarray, float32, shape (point, y, x, wavelength)

    Raises
    ------
    BackendUnavailable, Cancelled
    """
    progress = progress or (lambda done, message: None)
    size = hologram.width, hologram.height
    channels = [channel(w) for w in hologram.wavelengths]
    preview = Preview(scene, camera, *size, max_depth=max_depth, seed=seed)
    pictures = np.empty((len(points), *reversed(size), len(channels)), np.float32)
    steps = -(-spp // AT_ONCE)
    for k, point in enumerate(points):
        preview.look(camera, *size, centre=tuple(point))
        for step in range(steps):
            done = (k * steps + step) / (len(points) * steps)
            light = preview.refine(AT_ONCE, lambda part, message, done=done: progress(done, "Views"))
            pictures[k] = light[..., channels]  # the mean of all so far
    return pictures
