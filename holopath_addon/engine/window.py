"""The grid that rays are traced through: of square pixels, and maybe wider than the picture.

Pixels that are not square record the round cone that the larger pitch has, see `pixels`. A grid of squares of that
pitch records the same light from fewer pixels (`Hologram.picture`), and the display's own pixels sample its wave.

Light from beside the picture crosses the SLM's aperture, too: it blurs into the border of a picture that is focused
elsewhere. On a recording plane at a distance z from the SLM it passes up to slope times z beside the aperture.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from .pixels import Line, Pitch, axes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .camera import Camera
    from .hologram import Hologram

MAX_SHARE = 0.25  # of the picture's pixels: far from the SLM most of what more rays bring misses the aperture


def squared(camera: Camera, hologram: Hologram) -> tuple[Camera, Hologram]:
    """Camera and grid of pictures, `Hologram.picture`: they see what a hologram's pixels do, and at most a pixel more.

    With square pixels both come back as they are.

    Parameters
    ----------
    camera : Camera
    hologram : Hologram
    """
    if hologram.square:
        return camera, hologram
    picture = hologram.picture
    return _seen_over(camera, picture.width * picture.pitch_x / (hologram.width * hologram.pitch_x)), picture


def places(hologram: Hologram, shape: Sequence[int], pitch: Pitch) -> list[Line]:
    """Where the rows and the columns of a hologram lie on another grid around the same middle.

    Parameters
    ----------
    hologram : Hologram
    shape : (int, int)
        Rows and columns of the grid.
    pitch : float or (float, float)
        Of the grid, meters.
    """
    lines = []
    sizes = (hologram.height, hologram.pitch_y), (hologram.width, hologram.pitch_x)
    for n, other, (count, own) in zip(shape, axes(pitch), sizes, strict=True):
        step = own / other
        lines.append(Line((n - 1) / 2 - step * (count - 1) / 2, step, count))
    return lines


def pixels_beside(hologram: Hologram) -> int:
    """Pixels beyond each edge through which light of the volume crosses the aperture; 0 where they are too many.

    Parameters
    ----------
    hologram : Hologram
    """
    farthest = max(abs(hologram.depth_far), abs(hologram.depth_near))
    beside = math.ceil(hologram.widest_slope * farthest / hologram.pitch)
    pixels = (hologram.width + 2 * beside) * (hologram.height + 2 * beside)
    return beside if pixels <= (1 + MAX_SHARE) * hologram.width * hologram.height else 0


def widened(camera: Camera, hologram: Hologram, beside: int) -> tuple[Camera, Hologram]:
    """Camera and grid that see so many pixels more beyond each edge, and the rest where it was.

    Parameters
    ----------
    camera : Camera
    hologram : Hologram
    beside : int
        Pixels.
    """
    if not beside:
        return camera, hologram
    wide = replace(hologram, width=hologram.width + 2 * beside, height=hologram.height + 2 * beside)
    return _seen_over(camera, wide.width / hologram.width), wide


def _seen_over(camera, times):
    """A camera that sees so many times as wide, and the rest where it was."""
    fov = 2 * math.atan(times * math.tan(camera.fov_x / 2))
    shifts = camera.shift_x / times, camera.shift_y / times  # in image widths
    return replace(camera, fov_x=fov, shift_x=shifts[0], shift_y=shifts[1])
