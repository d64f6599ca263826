"""Pixels of the reconstruction in Blender's image."""

import bpy
import numpy as np

from holopath_addon.operators import session


def picture():
    """Pixels of the reconstruction, row 0 at the top."""
    image = bpy.data.images[session.IMAGE]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[::-1]
