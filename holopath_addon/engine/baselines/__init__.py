"""Methods to compare wave path tracing with: each goes from the same scene to a field for the same display.

Each follows its authors' description, as fast as that allows, except for the images of the scene that it starts from:
Mitsuba renders these, with mirrors, glass and all light.
"""

from __future__ import annotations

import dataclasses
import importlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.ndimage

from ..mapping import DepthMapping, squared
from ..settings.choices import BASELINES
from ..waves.panels import propagate_fields
from ..waves.phase_fields import FEW_FRAMES
from ..waves.propagation import OPTIMIZATION_GUARD

if TYPE_CHECKING:
    import mitsuba as mi

    from ..camera import Camera
    from ..hologram import Hologram
    from ..progress import Progress
    from ..settings import Settings

LIGHT_RANDOMNESS = (
    0.0,
    0.1,
)  # randomness of fixed phases of the scene's light, for one frame, two frames and more
# Modules that find phases of the panel's own pixels. All others give waves on square pixels, see `mapping`.
PHASE_MODULES = ("focal_stack", "light_field", "rgbd_descent")
PATHS = {"draft": 4, "preview": 16, "balanced": 64, "high": 256}  # for each pixel of an image, by quality


@dataclass(frozen=True)
class BaselineInput:
    """Input of a baseline.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
        Frames, seed, quality and the longest path count; `spp` sets the number of paths for each pixel of an image.
    near : float
        World depth of the volume's near end, meters.
    z_low, z_high : float
        Range of hologram-space depths of the visible surfaces, meters from the SLM.
    notes : list of str
        Receives notes for the user.
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
        """Number of paths for each pixel of an image."""
        return self.settings.spp or PATHS[self.settings.quality]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the hologram."""
        return self.hologram.height, self.hologram.width

    @property
    def of_pictures(self) -> BaselineInput:
        """The same input on the grid `Hologram.picture`, whose pixels are square and shared by all colors."""
        camera, square = squared(self.camera, self.hologram)
        return replace(self, camera=camera, hologram=square)

    def at_pixels(self, picture: np.ndarray, color: int, order: int = 1) -> np.ndarray:
        """Resample an image from the grid `of_pictures` to the panel's pixels, where a wavelength's light has them.

        Parameters
        ----------
        picture : numpy.ndarray, shape (y, x)
        color : int
            Index of the wavelength.
        order : int
            Order of the spline between pixels; 0 takes the nearest. Values beyond the border are those of the border.

        Returns
        -------
        numpy.ndarray, shape (y, x) of the panel
        """
        if self.hologram.plain:
            return picture
        raster = self.hologram.raster(self.hologram.wavelengths[color])
        lines = raster.lines_on(self.hologram.picture.raster())
        places = (line.first + line.step * np.arange(line.count) for line in lines)
        coordinates = np.meshgrid(*places, indexing="ij")
        return scipy.ndimage.map_coordinates(picture, coordinates, order=order, mode="nearest")


def light_randomness(frames: int) -> float:
    """Best randomness of the phases of a scene's light for a number of frames: from 0, all equal, to 1, random.

    The fewer the frames, the less random (Yoo et al., Opt. Lett. 46, 4769 (2021)).
    """
    return LIGHT_RANDOMNESS[min(frames, len(LIGHT_RANDOMNESS)) - 1] if frames < FEW_FRAMES else 1.0


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """Wave field at the SLM by the baseline that the settings name, one of `BASELINES`.

    Parameters
    ----------
    job : BaselineInput
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, wavelength, y, x)
        As bright as the scene. Methods that find phases give the light of these, which has one modulus.
    """
    name = BASELINES[job.settings.method][0]
    module, hologram = importlib.import_module(f"{__name__}.{name}"), job.hologram
    if hologram.plain or name in PHASE_MODULES:
        return module.field(job, progress)
    square = hologram.picture
    waves = module.field(job.of_pictures, progress)
    out = np.empty((*waves.shape[:2], hologram.height, hologram.width), np.complex64)
    for k, m, wave in propagate_fields(waves, square, 0.0, display=hologram, guard=OPTIMIZATION_GUARD):
        out[m, k] = wave
    return out
