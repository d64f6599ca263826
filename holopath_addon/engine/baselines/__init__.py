"""The methods that wave path tracing is measured against, each from the same scene to a field for the same display.

They are what their authors describe, as fast as that allows, but for the pictures of the scene that they start from:
those Mitsuba renders, with mirrors, glass and all light.
"""

from __future__ import annotations

import dataclasses
import importlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.ndimage

from ..mapping import DepthMapping, squared
from ..pixels import beyond
from ..settings import BASELINES
from ..waves.phase_fields import FEW_FRAMES
from ..waves.propagation import (
    TEACHING_GUARD,
    carrier,
    commensurate,
    moved,
    padded_shape,
    transfer_function,
)

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..progress import Progress
    from ..settings import Settings

LIGHT_RANDOMNESS = (
    0.0,
    0.1,
)  # of the phases of the scene's light, which stay as they are, by frames from one on
# These find phases of the panel's own pixels; all others waves, which squares record, see `mapping`.
OF_PIXELS = ("focal_stack", "light_field", "rgbd_descent")
PATHS = {"draft": 4, "preview": 16, "balanced": 64, "high": 256}  # of a pixel of a picture


@dataclass(frozen=True)
class BaselineInput:
    """What a baseline is to show.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
        Frames, seed, quality and the longest path; `spp` sets the paths of a picture's pixel.
    near : float
        World depth of the volume's near end, meters.
    z_low, z_high : float
        Hologram-space depths between which surfaces were seen, meters from the SLM.
    notes : list of str
        Takes what the user is to know of how it went.
    """

    scene: mi.Scene
    camera: Camera
    hologram: Hologram
    settings: Settings
    near: float
    z_low: float
    z_high: float
    notes: list[str] = dataclasses.field(default_factory=list)

    @property
    def mapping(self) -> DepthMapping:
        """World to hologram space."""
        return DepthMapping.of(self.hologram, self.camera, self.near)

    @property
    def paths(self) -> int:
        """Of a pixel of a picture."""
        return self.settings.spp or PATHS[self.settings.quality]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the hologram."""
        return self.hologram.height, self.hologram.width

    @property
    def of_pictures(self) -> BaselineInput:
        """The same on the grid of pictures, whose pixels are square and all colors' own."""
        camera, square = squared(self.camera, self.hologram)
        return replace(self, camera=camera, hologram=square)

    def at_pixels(self, picture: np.ndarray, color: int, order: int = 1) -> np.ndarray:
        """A picture on the grid `of_pictures` where the light of a wavelength has the panel's pixels.

        Parameters
        ----------
        picture : numpy.ndarray, shape (y, x)
        color : int
            Number of the wavelength.
        order : int
            Of the spline between pixels: 0 takes the nearest. Beyond the border it is that of the border.

        Returns
        -------
        numpy.ndarray, shape (y, x) of the panel
        """
        if self.hologram.plain:
            return picture
        raster = self.hologram.raster(self.hologram.wavelengths[color])
        lines = raster.lines_on(self.hologram.picture.raster())
        places = (line.first + line.step * np.arange(line.count) for line in lines)
        at = np.meshgrid(*places, indexing="ij")
        return scipy.ndimage.map_coordinates(picture, at, order=order, mode="nearest")


def light_randomness(frames: int) -> float:
    """How random the phases of a scene's light had best be for so many frames: 0, all the same, to 1, random.

    The fewer the frames, the less random (Yoo et al., Opt. Lett. 46, 4769 (2021)).
    """
    return LIGHT_RANDOMNESS[min(frames, len(LIGHT_RANDOMNESS)) - 1] if frames < FEW_FRAMES else 1.0


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """The wave at the SLM by the method of a job's settings, one of the `BASELINES`.

    Parameters
    ----------
    job : BaselineInput
    progress : callable
        ``progress(done, message)``, may raise.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, wavelength, y, x)
        Of methods that find phases, the light of these, as bright as the scene.
    """
    name = BASELINES[job.settings.method][0]
    module, hologram = importlib.import_module(f"{__name__}.{name}"), job.hologram
    if hologram.plain or name in OF_PIXELS:
        return module.field(job, progress)
    square = hologram.picture
    waves = module.field(job.of_pictures, progress)
    shape = waves.shape[-2:]
    out = np.empty((*waves.shape[:2], hologram.height, hologram.width), np.complex64)
    for k, wavelength in enumerate(hologram.wavelengths):
        lines, distance = (
            hologram.raster(wavelength).lines_on(square.raster()),
            hologram.distance_at(wavelength),
        )
        guard = max(TEACHING_GUARD, beyond(lines, shape))
        padded = commensurate(padded_shape(shape, square.pitch, wavelength, distance, guard), lines)
        transfer = transfer_function(padded, square.pitch, wavelength, distance) * carrier(
            wavelength, distance
        )
        for m, wave in enumerate(moved(waves[:, k], transfer, lines)):
            out[m, k] = wave
    return out
