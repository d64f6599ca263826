"""Scenes of a picture with a depth for each pixel."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path

import numpy as np

from ...engine import InvalidInput
from ...engine.scene.captured.picture import picture_scene
from ..built_scene import BuiltScene
from .depths import DEPTHS, UNIT_WORDS, UNITS, depth_notes, read_depth
from .options import CaptureOptions, check_fov, fov_note, fov_of, refuse, shape_notes
from .pixels import read_picture

ALONG = ("axis", "ray")  # the camera's axis, or the line of sight


class PictureFile:
    """A picture with a depth for each pixel.

    Parameters
    ----------
    path : Path
        The picture; its suffix is one of `PICTURES`.
    options : CaptureOptions

    Raises
    ------
    InvalidInput
        If a required option is missing, or an option does not apply.
    """

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        self.path, self._options = path, options
        refuse(options, ("axes", "point_radius"), f"{path} is a picture, not a .ply")
        if options.depth is None:
            raise InvalidInput(
                f"{path} is a picture without depth. Add --depth FILE and --depth-unit, or end the name of a quilt "
                "with its layout, such as _qs8x6a0.75."
            )
        self.depth_path = Path(options.depth)
        if not self.depth_path.is_file():
            raise InvalidInput(f"The depth {options.depth} does not exist. Give another file.")
        if self.depth_path.suffix.lower() not in DEPTHS:
            raise InvalidInput(f"Expected a depth of {', '.join(DEPTHS)}, got {options.depth}.")
        if options.depth_unit not in UNITS:
            raise InvalidInput(
                f"The unit of the depths in {options.depth} is unknown. Add --depth-unit with {UNIT_WORDS}."
            )
        if (options.depth_unit == "inverse") != (options.depth_ends is not None):
            raise InvalidInput(
                "--depth-unit inverse needs --depth-ends FAR,NEAR, in meters. With another unit omit "
                "--depth-ends."
            )
        check_fov(options)

    @property
    def files(self) -> dict[str, Path]:
        """Paths of the files by role."""
        return {"picture": self.path, "depth": self.depth_path}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.image.shape[1], self.image.shape[0]

    @property
    def size_from(self) -> str:
        """Source of the size, for messages."""
        return f"the picture {self.path.name}"

    @cached_property
    def image(self) -> np.ndarray:
        """Linear radiance, float32, shape (y, x, 3)."""
        return read_picture(self.path)

    def depth(self, fov: float) -> np.ndarray:
        """Distance of each pixel along the camera's axis, meters, float64, shape (y, x).

        Parameters
        ----------
        fov : float
            Full horizontal field of view, radians, by which distances along the line of sight are converted.

        Raises
        ------
        InvalidInput
            If the files cannot be read, their sizes differ or a depth is not positive and finite.
        """
        depth = read_depth(self.depth_path, self._options.depth_unit or "", self._options.depth_ends)
        if depth.shape != self.image.shape[:2]:
            raise InvalidInput(
                f"{self.path} has {self.size[0]} x {self.size[1]} pixels and {self.depth_path} has {depth.shape[1]} x "
                f"{depth.shape[0]}: give a depth for each pixel."
            )
        return depth / _lengths(self.size, fov) if self._options.depth_along == "ray" else depth

    def build(self, size: tuple[int, int], camera: str | None = None) -> BuiltScene:
        """Build the scene.

        Parameters
        ----------
        size : (int, int)
            Width and height of the hologram in pixels.
        camera : None
            A picture has only one camera.

        Raises
        ------
        InvalidInput
            See `depth`; or if a `camera` is given.
        """
        if camera is not None:
            raise InvalidInput(f"{self.path} has no camera '{camera}'. Omit --camera.")
        fov = fov_of(self._options)
        depth = self.depth(fov)
        notes = [fov_note(self.path, self._options)] if self._options.fov is None else []
        notes += depth_notes(self.depth_path, depth, self._options.depth_unit or "")
        notes += shape_notes(self.path, self.size, size)
        image, depth, (fraction, _) = downsample(self.image, depth, size)
        try:
            scene, viewer = picture_scene(image, depth, 2 * math.atan(fraction * math.tan(fov / 2)))
        except InvalidInput as error:
            raise InvalidInput(f"{self.path}, {self.depth_path}: {error}") from None
        return BuiltScene(scene, viewer, notes)


def _lengths(size, fov):
    """Length of the line of sight through each pixel's center to depth 1."""
    pixel = 2 * math.tan(fov / 2) / size[0]
    across, down = ((np.arange(side) - 0.5 * (side - 1)) * pixel for side in size)
    return np.sqrt(1 + across**2 + down[:, None] ** 2)


def downsample(
    image: np.ndarray, depth: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Downsample a picture with depth that has at least twice a hologram's pixels along both sides.

    Blocks become pixels with the mean of the colors and the median of the depths, the nearer one of two. Remaining
    pixels at the borders are cropped.

    Parameters
    ----------
    image : numpy.ndarray, shape (y, x, 3)
    depth : numpy.ndarray, shape (y, x)
    size : (int, int)
        Width and height of the hologram in pixels.

    Returns
    -------
    image : numpy.ndarray, shape (y, x, 3)
    depth : numpy.ndarray, shape (y, x)
    fractions : (float, float)
        Fractions of width and height that are not cropped.
    """
    block = min(image.shape[1] // size[0], image.shape[0] // size[1])
    if block < 2:
        return image, depth, (1.0, 1.0)
    height, width = depth.shape
    rows, columns = height // block, width // block
    inner = tuple(
        slice((side - count * block) // 2, (side - count * block) // 2 + count * block)
        for side, count in ((height, rows), (width, columns))
    )
    image = image[inner].reshape(rows, block, columns, block, 3).mean((1, 3))
    blocks = depth[inner].reshape(rows, block, columns, block).swapaxes(1, 2).reshape(rows, columns, -1)
    middle = (block**2 - 1) // 2
    fractions = columns * block / width, rows * block / height
    return image, np.partition(blocks, middle, axis=-1)[..., middle], fractions
