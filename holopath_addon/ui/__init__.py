"""Panels of the 3D View, the Render properties and the Image Editor."""

from .panels import CLASSES
from .shared_panels import share_panels, unshare_panels

__all__ = ["CLASSES", "share_panels", "unshare_panels"]
