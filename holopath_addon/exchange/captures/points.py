"""Scenes of a point cloud with a color for each point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...engine import InvalidInput
from ...engine.scene.captured.points import VIEWERS, point_scene
from ..built_scene import BuiltScene
from .options import CaptureOptions, check_fov, fov_note, fov_of, note, refuse
from .ply import read_points

if TYPE_CHECKING:
    from pathlib import Path

POINTS = (".ply",)
# Directions of the viewer's right, up and back in the point cloud: rows of the rotation to the view.
AXES = {
    "y-up": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "y-down": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "z-up": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
}
AXES_WORDS = (
    "y-up (view along -z, as in glTF), y-down (+z, as in OpenCV and COLMAP), or z-up (+y, as in Blender)"
)


class PointFile:
    """A point cloud with a color for each point.

    Parameters
    ----------
    path : Path
        A .ply file.
    options : CaptureOptions

    Raises
    ------
    InvalidInput
        If a required option is missing, or an option does not apply.
    """

    size, size_from = (512, 512), "HoloPath's default"

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        self.path, self._options = path, options
        refuse(
            options,
            ("depth", "depth_unit", "depth_ends", "depth_along", "view_span", "view_focus", "view_panel"),
            f"{path} is a point cloud, not a picture",
        )
        if options.axes not in AXES:
            raise InvalidInput(f"The axes of {path} are unknown. Add --axes with {AXES_WORDS}.")
        check_fov(options)

    @property
    def files(self) -> dict[str, Path]:
        """Paths of the files by role."""
        return {"points": self.path}

    def build(self, size: tuple[int, int], camera: str | None = None) -> BuiltScene:
        """Build the scene.

        Parameters
        ----------
        size : (int, int)
            Width and height of the hologram in pixels.
        camera : str, optional
            ``front``, the default, or ``origin``.

        Raises
        ------
        InvalidInput
            If the file cannot be read, or there is no such camera.
        """
        options = self._options
        camera = camera or VIEWERS[0]
        if camera not in VIEWERS:
            raise InvalidInput(
                f"{self.path} has no camera '{camera}'. Choose --camera front, before all points, or --camera origin."
            )
        points, colors = read_points(self.path)
        notes = [fov_note(self.path, options)] if options.fov is None else []
        finite = np.isfinite(points).all(1) & np.isfinite(colors).all(1)
        if not finite.all():
            count = np.count_nonzero(~finite)
            notes.append(note(self.path, f"{count} points that are not finite numbers", "omitted"))
        points = points[finite] @ np.array(AXES[options.axes or ""], float).T
        try:
            scene, viewer = point_scene(
                points, colors[finite], options.point_radius, fov_of(options), size[0] / size[1], camera
            )
        except InvalidInput as error:
            raise InvalidInput(f"{self.path}: {error}") from None
        return BuiltScene(scene, viewer, notes)
