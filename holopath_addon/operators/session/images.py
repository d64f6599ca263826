"""Image datablocks with the results, and redrawing of the editors that show them; on the main thread."""

import math

import bpy
import numpy as np

from ... import engine
from .results import encoded_hologram
from .state import current

# Names of the image datablocks.
IMAGE = "HoloPath Reconstruction"
TEXTURE = "HoloPath Baked Light"
PHASE = "HoloPath Phase"


def to_rgba(image, wavelengths):
    """Convert an image of wavelengths to the rows that Blender's images and render passes take.

    Parameters
    ----------
    image : numpy.ndarray, shape (y, x, wavelength)
        Linear intensities, row 0 at the top.
    wavelengths : sequence of float
        Meters.

    Returns
    -------
    numpy.ndarray, float32, shape (y, x, 4)
        Bottom row first.
    """
    return rgba_rows(engine.to_rgb(image, wavelengths))


def rgba_rows(rgb):
    """Rows of an RGB image, shape (y, x, 3), in Blender's form: see `to_rgba`."""
    return np.concatenate([rgb[::-1], np.ones_like(rgb[..., :1])], axis=-1)


def show(image, wavelengths):
    """Write a reconstruction into its image datablock.

    Parameters
    ----------
    image, wavelengths
        As in `to_rgba`.

    Returns
    -------
    bpy.types.Image
    """
    return write_image(IMAGE, to_rgba(image, wavelengths))


def show_rgb(rgb):
    """Write an RGB image, shape (y, x, 3), in place of the reconstruction; see `show`."""
    return write_image(IMAGE, rgba_rows(rgb))


def show_phase(frame):
    """Write a frame of the encoded hologram into its image datablock, 2π as white.

    Parameters
    ----------
    frame : int
        Index of the frame; the last one if it is too large.

    Returns
    -------
    bpy.types.Image

    Raises
    ------
    engine.InvalidInput
        If there is no hologram.
    """
    phase = encoded_hologram()
    current.shown_frame = frame
    levels = np.moveaxis(phase.data[min(frame, len(phase.data) - 1)], 0, -1) / (2 * math.pi)
    return write_image(PHASE, rgba_rows(engine.to_rgb(levels, phase.hologram.wavelengths)), light=False)


def show_texture():
    """Write the image of the baked light into its image datablock, which is returned."""
    return write_image(TEXTURE, rgba_rows(current.texture))


def write_image(name, pixels, light=True):
    """Write pixels into the image datablock of a name.

    A datablock of that name that the user has saved to a file is renamed and kept.

    Parameters
    ----------
    name : str
    pixels : numpy.ndarray, float32, shape (y, x, 4)
        Bottom row first.
    light : bool
        Whether the numbers are linear light; otherwise plain numbers.

    Returns
    -------
    bpy.types.Image
    """
    height, width = pixels.shape[:2]
    block, other = bpy.data.images.get(name), None
    if block is not None and (block.source != "GENERATED" or not block.is_float):
        block.name = name + " (other)"
        other, block = block, None
    if block is None:
        block = bpy.data.images.new(name, width, height, alpha=False, float_buffer=True)
        # pyrefly: ignore[bad-assignment, missing-attribute]  # Blender's stubs know no names of spaces
        block.colorspace_settings.name = "Linear Rec.709" if light else "Non-Color"
        block.use_view_as_render = light
        _replace_in_editors(other, block)
    elif tuple(block.size) != (width, height):
        block.scale(width, height)
    # pyrefly: ignore[missing-attribute]  # in Blender's stubs an array of numbers is one
    block.pixels.foreach_set(pixels.ravel())
    block.update()
    return block


def _replace_in_editors(old, new):
    """Show a new image in Image Editors that show an old one, which may be None."""
    if old is None:
        return
    for window in bpy.data.window_managers[0].windows:
        for area in window.screen.areas:
            space = area.spaces.active
            if isinstance(space, bpy.types.SpaceImageEditor) and space.image == old:
                space.image = new


def redraw(images=True):
    """Redraw the panels of every window, the images of Image Editors and the overlay of 3D Views.

    Parameters
    ----------
    images : bool
        Whether images, plan or focus may have changed; otherwise only panels are redrawn.
    """
    for window in bpy.data.window_managers[0].windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()
            elif area.type in {"VIEW_3D", "IMAGE_EDITOR"}:
                for region in area.regions:
                    if images or region.type == "UI":
                        region.tag_redraw()
