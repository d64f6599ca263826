"""Camera of the viewer, which anchors hologram space in the world."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from .errors import InvalidInput, real_number

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True)
class Camera:
    """Pinhole camera at the center of the viewer's pupil.

    Parameters
    ----------
    to_world : array_like, shape (4, 4)
        Rigid transform from camera to world space, meters. The camera looks along its own -z, y is up
        (Blender's convention). A reflection is allowed: the view is then mirrored.
    fov_x : float
        Full horizontal field of view, radians, in (0, pi).
    shift_x, shift_y : float
        Offset of the principal point in fractions of the image *width*: positive values move the
        view to the right and up (Blender's lens shift).
    clip_start, clip_end : float
        Range of visible depths, meters.
    sees_sky : bool
        Whether the environment is visible where there is no surface, or only clear ones that do not refract. It lights
        the scene either way, and is visible in mirrors and through glass.

    Raises
    ------
    InvalidInput
        If the transform is not rigid, the angle is out of range, a shift is not finite, or the clipping range is empty.

    Examples
    --------
    >>> import math
    >>> import numpy as np
    >>> from holopath_addon import engine
    >>> to_world = np.eye(4)
    >>> to_world[:3, 3] = 0.0, 0.1, 0.6  # 10 cm up, 60 cm before the origin, looking along -z
    >>> camera = engine.Camera(to_world, math.radians(30))
    >>> camera.position
    array([0. , 0.1, 0.6])
    """

    to_world: np.ndarray = field(repr=False)
    fov_x: float
    shift_x: float = 0.0
    shift_y: float = 0.0
    clip_start: float = 0.0
    clip_end: float = math.inf
    sees_sky: bool = True

    def __post_init__(self):
        matrix = np.asarray(self.to_world, dtype=np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise InvalidInput("Expected the camera's transform as a finite 4 x 4 matrix.")
        rotation = matrix[:3, :3]
        if not np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-4):
            raise InvalidInput("Expected a rigid transform of the camera. Remove its scale and shear.")
        object.__setattr__(self, "to_world", matrix)
        for name in ("fov_x", "shift_x", "shift_y", "clip_start", "clip_end"):
            object.__setattr__(self, name, real_number(getattr(self, name), name))
        if not (
            math.isfinite(self.shift_x) and math.isfinite(self.shift_y) and self.clip_start <= self.clip_end
        ):
            raise InvalidInput(
                "Expected finite shifts of the camera, and a clipping range that ends after its start, got shifts "
                f"{self.shift_x:g}, {self.shift_y:g} and {self.clip_start:g} to {self.clip_end:g} m."
            )
        if not 0.0 < self.fov_x < np.pi:
            raise InvalidInput(
                f"Expected a field of view of the camera between 0 and 180 degrees, got {np.degrees(self.fov_x):g}. "
                "Choose another focal length of its lens."
            )

    @property
    def position(self) -> np.ndarray:
        """Center of the pupil in the world, meters, shape (3,)."""
        return self.to_world[:3, 3]

    @property
    def axes(self) -> np.ndarray:
        """Right, up and forward unit vectors in the world, shape (3, 3), one in each row."""
        right, up, back = self.to_world[:3, :3].T
        return np.stack([right, up, -back])

    def moved(self, offset: Sequence[float], yaw: float = 0.0, pitch: float = 0.0) -> Camera:
        """The same camera at another place.

        Parameters
        ----------
        offset : (float, float, float)
            Offset to the right, up and forward, meters.
        yaw, pitch : float
            Rotation to the left about the camera's own up axis, and then up, radians.
        """
        right, up, forward = offset
        (s, c), (t, d) = ((math.sin(angle), math.cos(angle)) for angle in (yaw, pitch))
        step = np.eye(4)
        step[:3, :3] = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array(
            [[1, 0, 0], [0, d, -t], [0, t, d]]
        )
        step[:3, 3] = right, up, -forward
        return replace(self, to_world=self.to_world @ step)

    def to_dict(self) -> dict:
        """Return the values as JSON has them, see `from_dict`."""
        return {
            "to_world": self.to_world.tolist(),
            "fov_x": self.fov_x,
            "shift_x": self.shift_x,
            "shift_y": self.shift_y,
            "clip_start": self.clip_start,
            "clip_end": None if math.isinf(self.clip_end) else self.clip_end,
            "sees_sky": self.sees_sky,
        }

    @classmethod
    def from_dict(cls, values: dict) -> Camera:
        """Return a camera; inverse of `to_dict`.

        Parameters
        ----------
        values : dict
            Values as of `to_dict`.
        """
        end = values.get("clip_end")
        return cls(**values | {"clip_end": math.inf if end is None else end})
