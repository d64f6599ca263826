"""Scenes of views from a row or a grid of viewpoints."""

from __future__ import annotations

import math
import re
from functools import cached_property
from typing import TYPE_CHECKING

from ...engine import InvalidInput
from ...engine.scene.captured.views import view_scene
from ..built_scene import BuiltScene
from .options import CaptureOptions, check_fov, fov_note, fov_of, note, refuse, shape_notes
from .pixels import read_picture
from .view_arrays import read_views

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

VIEWS = (".npy", ".npz")  # besides quilts, which are pictures
# End of a quilt's name for Looking Glass displays: columns, rows, and a view's width over its height.
QUILT = re.compile(r"_qs([1-9]\d*)x([1-9]\d*)a(\d+(?:\.\d+)?)$")


class ViewFile:
    """Views from a row or a grid of viewpoints: a quilt, or an array.

    Parameters
    ----------
    path : Path
        A picture whose name ends like `QUILT`, or arrays for `read_views`.
    options : CaptureOptions

    Raises
    ------
    InvalidInput
        If a required option is missing, or an option does not apply.
    """

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        self.path, self._options = path, options
        refuse(
            options,
            ("depth", "depth_unit", "depth_ends", "depth_along", "axes", "point_radius"),
            f"{path} has views, without depth",
        )
        self._surplus = 0, 0  # columns of pixels at the right and rows at the top that belong to no view
        self._layout = QUILT.search(path.stem)
        if self._layout is None and path.suffix.lower() not in VIEWS:
            raise InvalidInput(
                f"The layout of the views in {path} is unknown. End its name with columns, rows and a view's width "
                "over its height, such as quilt_qs8x6a0.75.png, or omit --view-span, --view-focus and --view-panel."
            )
        if options.view_span is None or options.view_focus is None:
            raise InvalidInput(
                f"The viewpoints of {path} are unknown. Add --view-span with the meters from the first viewpoint to "
                "the last, and --view-focus with the distance at which all views agree."
            )
        if options.view_focus == math.inf and options.view_panel is None:
            raise InvalidInput(
                f"{path} has views that agree at infinity. Add --view-panel with a distance in the middle of the "
                "scene, at which it is sharpest."
            )
        check_fov(options)

    @property
    def files(self) -> dict[str, Path]:
        """Paths of the files by role."""
        return {"views": self.path}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a view in square pixels."""
        height, width = self.views.shape[2:4]
        return width, max(1, round(width / self._aspect)) if self._layout else height

    @property
    def size_from(self) -> str:
        """Source of the size, for messages."""
        return f"a view of {self.path.name}"

    @property
    def _aspect(self):
        height, width = self.views.shape[2:4]
        return float(self._layout[3]) if self._layout else width / height

    @cached_property
    def views(self) -> np.ndarray:
        """Linear radiance, float32, shape (view row, view column, y, x, 3).

        Raises
        ------
        InvalidInput
            If the file cannot be read, or has another shape.
        """
        if self._layout is None:
            return read_views(self.path)
        columns, rows, aspect = int(self._layout[1]), int(self._layout[2]), float(self._layout[3])
        image = read_picture(self.path)
        height, width = (side // count for side, count in zip(image.shape[:2], (rows, columns), strict=True))
        if not (height and width and aspect):
            raise InvalidInput(
                f"{self.path} has {image.shape[1]} x {image.shape[0]} pixels, which cannot be {columns} x {rows} "
                "views. Correct its name."
            )
        # The layout of Looking Glass's shader, from the lower left: HoloPlayShaders.h of its LookingGlassCoreSDK, with
        # the sizes of Toolkit-API/Device/QuiltSettings.cs of its LKG-Toolkit.
        self._surplus = image.shape[1] % columns, image.shape[0] % rows
        image = image[self._surplus[1] :, : columns * width]
        grid = image.reshape(rows, height, columns, width, 3).swapaxes(1, 2)
        return grid[::-1].reshape(1, -1, *grid.shape[2:])  # the first view is at the lower left

    def _surplus_notes(self):
        """A note on surplus pixels of a quilt; known after `views`."""
        right, top = self._surplus
        if not (right or top):
            return []
        height, width = self.views.shape[2:4]
        effect = (
            f"each has {width} x {height} pixels, from the lower left, as on Looking Glass displays: {right} at the "
            f"right and {top} at the top of the picture are omitted"
        )
        return [note(self.path, "a picture that its views do not fill", effect)]

    def build(self, size: tuple[int, int], camera: str | None = None) -> BuiltScene:
        """Build the scene.

        Parameters
        ----------
        size : (int, int)
            Width and height of the hologram in pixels.
        camera : None
            Views have only one camera.

        Raises
        ------
        InvalidInput
            See `views`; or if the span does not fit the views, or a `camera` is given.
        """
        options, views = self._options, self.views
        if camera is not None:
            raise InvalidInput(f"{self.path} has no camera '{camera}'. Omit --camera.")
        rows, columns = views.shape[:2]
        span, count = tuple(options.view_span or ()), 2 if rows > 1 and columns > 1 else 1
        if len(span) != count:
            raise InvalidInput(
                f"Expected {count} number{'s' if count > 1 else ''} for --view-span of {columns} x {rows} views in "
                f"{self.path}, {'RIGHT,DOWN' if count > 1 else 'from the first view to the last'}, got {len(span)}."
            )
        if count == 1:
            span = (0.0, *span) if columns == 1 else (*span, 0.0)
        notes = [fov_note(self.path, options)] if options.fov is None else []
        notes += self._surplus_notes() + shape_notes(self.path, self.size, size)
        if rows == 1 or columns == 1:
            effect = "no parallax across the row: lines along it stay focused on the panel, even before and behind it"
            notes.append(note(self.path, "one row of views", effect))
        try:
            scene, viewer = view_scene(
                views, span, options.view_focus or 0.0, fov_of(options), self._aspect, options.view_panel
            )
        except InvalidInput as error:
            raise InvalidInput(f"{self.path}: {error}") from None
        return BuiltScene(scene, viewer, notes)
