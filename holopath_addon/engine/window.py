"""The window that rays are traced through, which may be wider than the picture.

Light from beside the picture crosses the SLM's aperture, too: it blurs into the border of a picture that is focused
elsewhere. On a recording plane at a distance z from the SLM it passes up to slope times z beside the aperture.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .camera import Camera
    from .hologram import Hologram, Picture

MAX_SHARE = 0.25  # of the picture's pixels: far from the SLM most of what more rays bring misses the aperture


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


def filled(camera: Camera, picture: Picture) -> tuple[Camera, Picture]:
    """Camera and grid of a picture of one wavelength alone, on pixels of which that fills the band.

    It sees as much more than the picture that all wavelengths share as this one's light reaches farther.

    Parameters
    ----------
    camera : Camera
    picture : Picture
        Of one wavelength.
    """
    (wavelength,) = picture.wavelengths
    times = wavelength / picture.shortest
    return _seen_over(camera, times), replace(picture, pitch=picture.pitch * times, shortest=wavelength)


def _seen_over(camera, times):
    """A camera that sees so many times as wide, and the rest where it was."""
    fov = 2 * math.atan(times * math.tan(camera.fov_x / 2))
    shifts = camera.shift_x / times, camera.shift_y / times  # in image widths
    return replace(camera, fov_x=fov, shift_x=shifts[0], shift_y=shifts[1])
