"""A point cloud with a color for each point, as a scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...engine import InvalidInput
from ...engine.scene.captured.points import VIEWERS, point_scene
from .options import CapturedScene, CaptureOptions, check_fov, fov_note, fov_of, note, refuse
from .ply import read_points

if TYPE_CHECKING:
    from pathlib import Path

POINTS = (".ply",)
# Axes of a point cloud as the viewer's right, up and back: rows of what turns its points into view.
AXES = {
    "y-up": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "y-down": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "z-up": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
}
AXES_WORDS = (
    "y-up (seen along -z, as in glTF), y-down (along +z, as cameras of OpenCV and COLMAP have it), or z-up (along +y, "
    "as in Blender)"
)


class PointFile:
    """A point cloud with a color for each point.

    Parameters
    ----------
    path : Path
        A .ply.
    options : CaptureOptions
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
            raise InvalidInput(f"{path} does not say how its axes lie: add --axes with {AXES_WORDS}.")
        check_fov(options)

    @property
    def files(self) -> dict[str, Path]:
        """Paths by names."""
        return {"points": self.path}

    def build(self, size: tuple[int, int], camera: str | None = None) -> CapturedScene:
        """Make the scene, for a hologram of `size` pixels; `camera` is `front`, which is the default, or `origin`.

        Raises
        ------
        InvalidInput
            If the file cannot be read, or there is no such camera.
        """
        options = self._options
        camera = camera or VIEWERS[0]
        if camera not in VIEWERS:
            raise InvalidInput(
                f"{self.path} has no camera '{camera}': choose --camera front, before all points, or --camera origin."
            )
        places, colors = read_points(self.path)
        notes = [fov_note(self.path, options)] if options.fov is None else []
        there = np.isfinite(places).all(1) & np.isfinite(colors).all(1)
        if not there.all():
            count = np.count_nonzero(~there)
            notes.append(note(self.path, f"{count} points that are not finite numbers", "left out"))
        places = places[there] @ np.array(AXES[options.axes or ""], float).T
        try:
            scene, viewer = point_scene(
                places, colors[there], options.point_radius, fov_of(options), size[0] / size[1], camera
            )
        except InvalidInput as error:
            raise InvalidInput(f"{self.path}: {error}") from None
        return CapturedScene(scene, viewer, notes)
