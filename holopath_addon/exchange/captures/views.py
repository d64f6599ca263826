"""Views from a row or a grid of viewpoints, as a scene."""

from __future__ import annotations

import math
import re
from functools import cached_property
from typing import TYPE_CHECKING

from ...engine import InvalidInput
from ...engine.scene.captured.views import view_scene
from .options import CapturedScene, CaptureOptions, check_fov, fov_note, fov_of, note, refuse, shape_notes
from .pixels import read_picture
from .view_arrays import read_views

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np

VIEWS = (".npy", ".npz")  # besides quilts, which are pictures
# End of a quilt's name, as Looking Glass displays read it: columns, rows, and the width of a view over its height.
QUILT = re.compile(r"_qs([1-9]\d*)x([1-9]\d*)a(\d+(?:\.\d+)?)$")


class ViewFile:
    """Views from a row or a grid of viewpoints: a quilt, or an array.

    Parameters
    ----------
    path : Path
        A picture whose name ends as `QUILT`, or arrays as `read_views` reads them.
    options : CaptureOptions
    """

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        self.path, self._options = path, options
        refuse(
            options,
            ("depth", "depth_unit", "depth_ends", "depth_along", "axes", "point_radius"),
            f"{path} holds views, without depth",
        )
        self._over = 0, 0  # columns of pixels at the right and rows at the top that no view has
        self._layout = QUILT.search(path.stem)
        if self._layout is None and path.suffix.lower() not in VIEWS:
            raise InvalidInput(
                f"{path} does not say how its views lie: end its name with columns, rows and the width of a view over "
                "its height, as quilt_qs8x6a0.75.png, or leave out --view-span, --view-focus and --view-panel."
            )
        if options.view_span is None or options.view_focus is None:
            raise InvalidInput(
                f"{path} does not say where its views were seen from: add --view-span with the meters from the first "
                "view to the last, and --view-focus with the distance at which all views agree."
            )
        if options.view_focus == math.inf and options.view_panel is None:
            raise InvalidInput(
                f"{path} has views that agree at infinity: add --view-panel with a distance in the middle of what they "
                "show, at which it is sharpest."
            )
        check_fov(options)

    @property
    def files(self) -> dict[str, Path]:
        """Paths by names."""
        return {"views": self.path}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a view in square pixels."""
        height, width = self.views.shape[2:4]
        return width, max(1, round(width / self._aspect)) if self._layout else height

    @property
    def size_from(self) -> str:
        """Where the size is from, as words."""
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
                f"{self.path} has {image.shape[1]} x {image.shape[0]} pixels, which are not {columns} x {rows} views: "
                "correct its name."
            )
        # As Looking Glass's shader cuts it, from the lower left: HoloPlayShaders.h of its LookingGlassCoreSDK, by the
        # sizes that Toolkit-API/Device/QuiltSettings.cs of its LKG-Toolkit finds.
        self._over = image.shape[1] % columns, image.shape[0] % rows
        image = image[self._over[1] :, : columns * width]
        cut = image.reshape(rows, height, columns, width, 3).swapaxes(1, 2)
        return cut[::-1].reshape(1, -1, *cut.shape[2:])  # the first view is at the lower left

    def _left_out(self):
        """A note where a quilt's pixels are no whole number of views; after `views`."""
        right, top = self._over
        if not (right or top):
            return []
        height, width = self.views.shape[2:4]
        effect = (
            f"each has {width} x {height} pixels, from the lower left, as Looking Glass displays take them: {right} at "
            f"the right and {top} at the top of the picture are left out"
        )
        return [note(self.path, "a picture that its views do not fill", effect)]

    def build(self, size: tuple[int, int], camera: str | None = None) -> CapturedScene:
        """Make the scene, for a hologram of `size` pixels.

        Raises
        ------
        InvalidInput
            As of `views`, if the span is not of such views, or if a `camera` is named.
        """
        options, views = self._options, self.views
        if camera is not None:
            raise InvalidInput(f"{self.path} has no camera '{camera}': leave out --camera.")
        rows, columns = views.shape[:2]
        span, needed = tuple(options.view_span or ()), 2 if rows > 1 and columns > 1 else 1
        if len(span) != needed:
            raise InvalidInput(
                f"{self.path} has {columns} x {rows} views: give {needed} number{'s' if needed > 1 else ''} with "
                f"--view-span, {'RIGHT,DOWN' if needed > 1 else 'from the first view to the last'}, not {len(span)}."
            )
        if needed == 1:
            span = (0.0, *span) if columns == 1 else (*span, 0.0)
        notes = [fov_note(self.path, options)] if options.fov is None else []
        notes += self._left_out() + shape_notes(self.path, self.size, size)
        if rows == 1 or columns == 1:
            effect = "no parallax across the row: before and behind the panel lines along it stay focused on the panel"
            notes.append(note(self.path, "one row of views", effect))
        try:
            scene, viewer = view_scene(
                views, span, options.view_focus or 0.0, fov_of(options), self._aspect, options.view_panel
            )
        except InvalidInput as error:
            raise InvalidInput(f"{self.path}: {error}") from None
        return CapturedScene(scene, viewer, notes)
