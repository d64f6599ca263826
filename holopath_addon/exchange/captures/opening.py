"""Opening of a capture by the kind of its file."""

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


def open_capture(path: Path, options: CaptureOptions) -> PictureFile | PointFile | ViewFile:
    """Open a picture with depth, a point cloud or views: check the options, without reading the files yet.

    Parameters
    ----------
    path : Path
        Its suffix is one of `SUFFIXES`.
    options : CaptureOptions

    Raises
    ------
    InvalidInput
        If a required option is missing, or an option does not apply to the kind of file.
    """
    suffix = path.suffix.lower()
    if suffix in POINTS:
        return PointFile(path, options)
    is_quilt = QUILT.search(path.stem) and options.depth is None
    has_views = any(name.startswith("view_") for name in options.names)
    return (ViewFile if suffix in VIEWS or is_quilt or has_views else PictureFile)(path, options)
