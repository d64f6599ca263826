"""Files of pictures, depths, point clouds and views, and the scenes that they are."""

from .depths import DEPTHS, UNIT_WORDS, UNITS, read_depth
from .opening import SUFFIXES, capture
from .options import CapturedScene, CaptureOptions, with_depth_beside
from .picture import ALONG, PictureFile, reduced
from .pixels import PICTURES, read_picture
from .ply import read_points
from .points import AXES, AXES_WORDS, PointFile
from .views import VIEWS, ViewFile

__all__ = [
    "ALONG",
    "AXES",
    "AXES_WORDS",
    "DEPTHS",
    "PICTURES",
    "SUFFIXES",
    "UNITS",
    "UNIT_WORDS",
    "VIEWS",
    "CaptureOptions",
    "CapturedScene",
    "PictureFile",
    "PointFile",
    "ViewFile",
    "capture",
    "read_depth",
    "read_picture",
    "read_points",
    "reduced",
    "with_depth_beside",
]
