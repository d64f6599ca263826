"""Which kind of capture a file is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .picture import PictureFile
from .pixels import PICTURES
from .points import POINTS, PointFile
from .views import QUILT, VIEWS, ViewFile

if TYPE_CHECKING:
    from pathlib import Path

    from .options import CaptureOptions

SUFFIXES = (*PICTURES, *POINTS, *VIEWS)


def capture(path: Path, options: CaptureOptions) -> PictureFile | PointFile | ViewFile:
    """Open a picture with depth, a point cloud or views; its options are checked, and its files are not read yet.

    Raises
    ------
    InvalidInput
        If an option is missing, or is not for such a file.
    """
    suffix = path.suffix.lower()
    if suffix in POINTS:
        return PointFile(path, options)
    named = QUILT.search(path.stem) and options.depth is None
    given = any(name.startswith("view_") for name in options.given)
    return (ViewFile if suffix in VIEWS or named or given else PictureFile)(path, options)
