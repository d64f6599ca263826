"""World space to hologram space and back: the transform T of the paper (section 4.2, eq. 3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .errors import InvalidInput

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike

    from .camera import Camera
    from .hologram import Hologram


@dataclass(frozen=True)
class DepthMapping:
    """The projective map x_h = F X / D, z_h = z_far + beta / D (paper eq. 3; D is depth along the axis).

    A straight line of hologram space is a straight line of the world: the line through (x0, y0) on the
    plane z_p with slopes (sx, sy) leaves the pupil at X = sx beta / F in the direction
    ((x0 + sx (z_far - z_p)) / F, (y0 + sy (z_far - z_p)) / F, 1) of (right, up, forward).

    Parameters
    ----------
    focal : float
        F = hologram width / (2 tan(fov_x / 2)), metres.
    beta : float
        Metres squared; F^2 is what a thin lens of focal length F does, and f^2 what the lens of the bench does.
    z_far : float
        Hologram-space depth of world infinity, metres.
    centre_x, centre_y : float
        Tangents of the view direction at the hologram's centre (lens shift).
    """

    focal: float
    beta: float
    z_far: float
    centre_x: float = 0.0
    centre_y: float = 0.0

    @classmethod
    def of(cls, hologram: Hologram, camera: Camera, near: float | None = None) -> DepthMapping:
        """Mapping of a hologram seen through a camera.

        Parameters
        ----------
        hologram : Hologram
        camera : Camera
        near : float, optional
            World depth at `hologram.depth_near` for the `fit` mapping, metres; needed when
            ``hologram.near`` is not set.
        """
        hologram = hologram.picture
        width = hologram.width * hologram.pitch
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
        """Hologram-space z in metres of a world depth in metres (infinity allowed)."""
        depth = np.asarray(depth, dtype=np.float64)
        if not (depth > 0).all():
            raise InvalidInput(
                "A focus distance must be in front of the camera: give a positive number of meters, or inf."
            )
        return self.z_far + self.beta / depth

    def z_to_depth(self, z: ArrayLike) -> Any:
        """World depth in metres of a hologram-space z in metres; infinite at and beyond the far end."""
        offset = np.asarray(z, dtype=np.float64) - self.z_far
        with np.errstate(divide="ignore"):
            return np.where(offset > 0, self.beta / np.where(offset > 0, offset, 1.0), np.inf)

    def pupil_radius(self, max_slope: float) -> float:
        """Radius in metres, in the world, of the pupil that a cone of slope `max_slope` fills."""
        return max_slope * self.beta / self.focal
