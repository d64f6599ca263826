"""World space to hologram space and back: the transform T of the paper (section 4.2, eq. 3), and the grid of its rays.

Rays are traced through squares of the larger pitch, `Hologram.picture`: they record the same light as pixels that are
not square, from fewer of them, and the display's own pixels sample its wave, in each color where they lie for it.
The grid may be wider than the picture, for light from beside it crosses the SLM's aperture, too: it blurs into the
border of a picture that is focused elsewhere. On a recording plane at a distance z from the SLM it passes up to slope
times z beside the aperture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .errors import InvalidInput
from .hologram import AerialImage

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike

    from .camera import Camera
    from .hologram import Hologram

MAX_SHARE = 0.25  # of the picture's pixels: far from the SLM most of what more rays bring misses the aperture


@dataclass(frozen=True)
class DepthMapping:
    """The projective map x_h = F X / D, z_h = z_far + beta / D (paper eq. 3; D is depth along the axis).

    A straight line of hologram space is a straight line of the world: the line through (x0, y0) on the
    plane z_p with slopes (sx, sy) leaves the pupil at X = sx beta / F in the direction
    ((x0 + sx (z_far - z_p)) / F, (y0 + sy (z_far - z_p)) / F, 1) of (right, up, forward).

    Parameters
    ----------
    focal : float
        F = hologram width / (2 tan(fov_x / 2)), meters.
    beta : float
        Meters squared; F^2 is what a thin lens of focal length F does, and f^2 what the lens of the bench does.
    z_far : float
        Hologram-space depth of world infinity, meters.
    center_x, center_y : float
        Tangents of the view direction at the hologram's center (lens shift).
    """

    focal: float
    beta: float
    z_far: float
    center_x: float = 0.0
    center_y: float = 0.0

    @classmethod
    def of(cls, hologram: Hologram, camera: Camera, near: float | None = None) -> DepthMapping:
        """Mapping of a hologram seen through a camera.

        Parameters
        ----------
        hologram : Hologram
        camera : Camera
        near : float, optional
            World depth at `hologram.depth_near` for the `fit` mapping, meters; needed when
            ``hologram.near`` is not set.
        """
        hologram = hologram.in_air
        width = hologram.width * hologram.pitch_x
        focal = width / (2 * math.tan(camera.fov_x / 2))
        lens = hologram.optics.lens
        if hologram.depth_mapping == "eyepiece":
            beta = lens.focal**2 if lens else focal**2
        else:
            near = hologram.near or near
            beta = (hologram.depth_near - hologram.depth_far) * near
        shift = width / focal
        return cls(focal, beta, hologram.depth_far, camera.shift_x * shift, camera.shift_y * shift)

    def depth_to_z(self, depth: ArrayLike) -> Any:
        """Hologram-space z in meters of a world depth in meters (infinity allowed)."""
        depth = np.asarray(depth, dtype=np.float64)
        if not (depth > 0).all():
            raise InvalidInput(
                "A focus distance must be in front of the camera: give a positive number of meters, or inf."
            )
        return self.z_far + self.beta / depth

    def z_to_depth(self, z: ArrayLike) -> Any:
        """World depth in meters of a hologram-space z in meters; infinite at and beyond the far end."""
        offset = np.asarray(z, dtype=np.float64) - self.z_far
        with np.errstate(divide="ignore"):
            return np.where(offset > 0, self.beta / np.where(offset > 0, offset, 1.0), np.inf)

    def pupil_radius(self, max_slope: float) -> float:
        """Radius in meters, in the world, of the pupil that a cone of slope `max_slope` fills."""
        return max_slope * self.beta / self.focal


def squared(camera: Camera, hologram: Hologram) -> tuple[Camera, Hologram]:
    """Camera and grid of pictures, `Hologram.picture`: they see what a hologram's pixels do, and at most a pixel more.

    With square pixels, and colors that lie on each other, both come back as they are.

    Parameters
    ----------
    camera : Camera
    hologram : Hologram
    """
    if hologram.in_air is not hologram:
        return camera, hologram.in_air
    if hologram.plain:
        return camera, hologram
    picture = hologram.picture
    return _seen_over(camera, picture.width * picture.pitch_x / (hologram.width * hologram.pitch_x)), picture


def traced(camera: Camera, hologram: Hologram) -> tuple[Camera, Hologram]:
    """Camera and grid of rays: those of pictures, and behind a lens all that its light reaches.

    Parameters
    ----------
    camera : Camera
    hologram : Hologram
    """
    camera, picture = squared(camera, hologram)
    if not isinstance(picture, AerialImage) or picture.whole is picture:
        return camera, picture
    return _seen_over(camera, picture.whole.width / picture.width), picture.whole


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
    size = {"width": hologram.width + 2 * beside, "height": hologram.height + 2 * beside}
    wide = replace(hologram, **size, optics=hologram.optics.of_rays)
    return _seen_over(camera, wide.width / hologram.width), wide


def filled(camera: Camera, image: AerialImage) -> tuple[Camera, AerialImage]:
    """Camera and grid of an image of one wavelength alone, on pixels of which that fills the band.

    It sees as much more than the picture that all wavelengths share as this one's light reaches farther.

    Parameters
    ----------
    camera : Camera
    image : AerialImage
        Of one wavelength.
    """
    (wavelength,) = image.wavelengths
    times = wavelength / image.shortest
    return _seen_over(camera, times), replace(image, pitch=image.pitch * times, shortest=wavelength)


def _seen_over(camera, times):
    """A camera that sees so many times as wide, and the rest where it was."""
    fov = 2 * math.atan(times * math.tan(camera.fov_x / 2))
    shifts = camera.shift_x / times, camera.shift_y / times  # in image widths
    return replace(camera, fov_x=fov, shift_x=shifts[0], shift_y=shifts[1])
