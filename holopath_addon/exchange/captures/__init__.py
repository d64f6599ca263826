"""Readers of pictures with depth, point clouds and views, and their scenes."""

from .depths import DEPTHS, UNIT_WORDS, UNITS, read_depth
from .opening import SUFFIXES, open_capture
from .options import CaptureOptions, with_depth_beside
from .picture import ALONG, PictureFile, downsample
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
    "PictureFile",
    "PointFile",
    "ViewFile",
    "downsample",
    "open_capture",
    "read_depth",
    "read_picture",
    "read_points",
    "with_depth_beside",
]
