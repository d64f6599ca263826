"""World space to hologram space and back: the transform T of the paper (section 4.2, eq. 3), and the grid of its rays.

Rays are traced through squares of the larger pitch, `Hologram.picture`. They record the same light as pixels that are
not square, with fewer rays; the display's own pixels then sample the wave, for each color at their place in its light.
The grid may be wider than the picture, because light from beside it also crosses the SLM's aperture: it blurs into the
border of an image that is focused elsewhere. On a recording plane at a distance z from the SLM it passes up to slope
times z beside the aperture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .errors import InvalidInput
from .hologram import MAX_PIXELS, AerialImage

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike

    from .camera import Camera
    from .hologram import Hologram

MAX_BORDER_FRACTION = (
    0.25  # of the picture's pixels; far from the SLM most light of a wider border misses the aperture
)


@dataclass(frozen=True)
class DepthMapping:
    """Projective map x_h = F X / D, z_h = z_far + beta / D (paper eq. 3; D is depth along the axis).

    A straight line in hologram space is a straight line in the world: the line through (x0, y0) on the
    plane z_p with slopes (sx, sy) leaves the pupil at X = sx beta / F in the direction
    ((x0 + sx (z_far - z_p)) / F, (y0 + sy (z_far - z_p)) / F, 1) of (right, up, forward).

    Parameters
    ----------
    focal : float
        F = hologram width / (2 tan(fov_x / 2)), meters.
    beta : float
        Scale of depths, meters squared: F^2 for a thin lens of focal length F, f^2 for the lens of the bench.
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
        """Mapping of a hologram for a camera.

        Parameters
        ----------
        hologram : Hologram
        camera : Camera
        near : float, optional
            World depth at `hologram.depth_near` for the `fit` mapping, meters; required if
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
        """Hologram-space z in meters of world depths in meters.

        Parameters
        ----------
        depth : array_like
            Positive; infinity is allowed.

        Raises
        ------
        InvalidInput
            If a depth is not in front of the camera.
        """
        depth = np.asarray(depth, dtype=np.float64)
        if not (depth > 0).all():
            raise InvalidInput(
                f"Expected a focus distance of a positive number of meters, or inf, got {depth.min():g} m."
            )
        return self.z_far + self.beta / depth

    def z_to_depth(self, z: ArrayLike) -> Any:
        """World depths in meters of hologram-space z in meters; infinite at and beyond the far end."""
        offset = np.asarray(z, dtype=np.float64) - self.z_far
        with np.errstate(divide="ignore"):
            return np.where(offset > 0, self.beta / np.where(offset > 0, offset, 1.0), np.inf)

    def pupil_radius(self, max_slope: float) -> float:
        """Radius in world meters of the pupil that a cone of slope `max_slope` fills."""
        return max_slope * self.beta / self.focal


def squared(camera: Camera, hologram: Hologram) -> tuple[Camera, Hologram]:
    """Camera and grid of images, `Hologram.picture`: their view is a hologram's, extended by less than a pixel.

    Both are returned unchanged if pixels are square and colors coincide.

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
    return _widen_view(camera, picture.width * picture.pitch_x / (hologram.width * hologram.pitch_x)), picture


def traced(camera: Camera, hologram: Hologram) -> tuple[Camera, Hologram]:
    """Camera and grid of rays: those of images; behind a lens as wide as its light reaches.

    Parameters
    ----------
    camera : Camera
    hologram : Hologram
    """
    camera, picture = squared(camera, hologram)
    if not isinstance(picture, AerialImage) or picture.whole is picture:
        return camera, picture
    return _widen_view(camera, picture.whole.width / picture.width), picture.whole


def border_pixels(hologram: Hologram, camera: Camera, near: float) -> int:
    """Number of pixels at an edge through which light of the volume's farther end passes.

    Parameters
    ----------
    hologram : Hologram
        Grid of square pixels.
    camera : Camera
    near : float
        World depth of the volume's near end, meters.
    """
    far, z_near = hologram.depth_far, hologram.depth_near
    if hologram.depth_mapping == "eyepiece":
        z_near = float(DepthMapping.of(hologram, camera).depth_to_z(near))
    return math.ceil(hologram.widest_slope * max(abs(far), abs(z_near)) / hologram.pitch_x)


def pixels_beside(hologram: Hologram, camera: Camera, near: float) -> int:
    """Number of pixels beyond each edge through which light of the volume crosses the aperture.

    0 if the border has more than `MAX_BORDER_FRACTION` of the picture's pixels, or the grid would be too large.

    Parameters
    ----------
    hologram, camera, near
        See `border_pixels`.
    """
    beside = border_pixels(hologram, camera, near)
    pixels = (hologram.width + 2 * beside) * (hologram.height + 2 * beside)
    largest = min((1 + MAX_BORDER_FRACTION) * hologram.width * hologram.height, MAX_PIXELS)
    return beside if pixels <= largest else 0


def widened(camera: Camera, hologram: Hologram, beside: int) -> tuple[Camera, Hologram]:
    """Camera and grid with a border; the view within it is the same.

    Parameters
    ----------
    camera : Camera
    hologram : Hologram
    beside : int
        Number of pixels beyond each edge.
    """
    if not beside:
        return camera, hologram
    size = {"width": hologram.width + 2 * beside, "height": hologram.height + 2 * beside}
    wide = replace(hologram, **size, optics=hologram.optics.of_rays)
    return _widen_view(camera, wide.width / hologram.width), wide


def filled(camera: Camera, image: AerialImage) -> tuple[Camera, AerialImage]:
    """Camera and grid of an aerial image of one wavelength, with pixels whose band it fills.

    The view is wider than that of the image of all wavelengths, because the light of this one reaches farther.

    Parameters
    ----------
    camera : Camera
    image : AerialImage
        Image of one wavelength.
    """
    (wavelength,) = image.wavelengths
    factor = wavelength / image.shortest
    return _widen_view(camera, factor), replace(image, pitch=image.pitch * factor, shortest=wavelength)


def _widen_view(camera, factor):
    """A camera with a wider view, whose middle is the same."""
    fov = 2 * math.atan(factor * math.tan(camera.fov_x / 2))
    shifts = camera.shift_x / factor, camera.shift_y / factor  # in image widths
    return replace(camera, fov_x=fov, shift_x=shifts[0], shift_y=shifts[1])
