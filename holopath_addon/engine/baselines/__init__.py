"""The methods that wave path tracing is measured against, each from the same scene to a field for the same display.

They are what their authors describe, as fast as that allows, but for the pictures of the scene that they start from:
those Mitsuba renders, with mirrors, glass and all light.
"""

import importlib
import time
from dataclasses import dataclass, replace

from ..mapping import DepthMapping

# name: module here, what it is called, what it does
BASELINES = {
    "point": ("point_cloud", "Point Cloud", "a spherical wave from each visible surface point"),
    "polygon": ("polygons", "Polygons", "the field of each visible facet, by its angular spectrum"),
    "rgbd": ("layers", "RGB-D Layers", "layers of a picture with depth, each blocking those behind it"),
    "rgbd-sgd": (
        "rgbd_descent",
        "RGB-D Descent",
        "phases that show a picture with depth sharp on its layers",
    ),
    "focal-stack": (
        "focal_stack",
        "Focal Stack",
        "phases that show pictures through a lens at several depths",
    ),
    "light-field": ("light_field", "Light Field", "phases that show pictures from all over the pupil"),
    "stereogram": (
        "stereogram",
        "Stereogram",
        "pictures from all over the pupil, by a short-time Fourier transform",
    ),
    "gaussian": (
        "gaussians",
        "Gaussians",
        "the wave of each Gaussian on the surfaces, blended from far to near",
    ),
    "network": ("network", "Network", "a function of your own from a picture with depth to a field"),
}
PATHS = {"preview": 16, "balanced": 64, "full": 256}  # of a pixel of a picture


@dataclass(frozen=True)
class Job:
    """What a baseline is to show.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings
        Frames, seed, quality and the longest path; `spp` sets the paths of a picture's pixel.
    near : float
        World depth of the volume's near end, metres.
    z_low, z_high : float
        Hologram-space depths between which surfaces were seen, metres from the SLM.
    """

    scene: object
    camera: object
    hologram: object
    settings: object
    near: float
    z_low: float
    z_high: float

    @property
    def mapping(self):
        """World to hologram space."""
        return DepthMapping.of(self.hologram, self.camera, self.near)

    @property
    def paths(self):
        """Of a pixel of a picture."""
        return self.settings.spp or PATHS[self.settings.quality]

    @property
    def shape(self):
        """Rows and columns of the hologram."""
        return self.hologram.height, self.hologram.width


def render(scene, camera, hologram, settings, plan, progress):
    """The wave field of a scene by one of the `BASELINES`; parameters as of `engine.render`.

    Returns
    -------
    WaveField
        Of methods that find phases, the light of these, as bright as the scene.
    """
    from ..wavefield import WaveField

    module = importlib.import_module(f"{__name__}.{BASELINES[settings.method][0]}")
    begun = time.perf_counter()
    field = module.field(Job(scene, camera, hologram, settings, plan.near, plan.z_low, plan.z_high), progress)
    report = {"seconds": {settings.method: time.perf_counter() - begun}, "frames": settings.frames}
    return WaveField(field, hologram, camera, plan.near, plan.to_dict(), report)


def planned(plan, settings):
    """A plan as a baseline has it: the depths in view, and the method; nothing is foretold."""
    from ..planner import Decision

    _, label, what = BASELINES[settings.method]
    own = Decision("method", label, f"{what}; as asked, to be compared with HoloPath's own")
    frames = Decision("frames", str(settings.frames), "as asked")
    return replace(plan, decisions=(plan.decisions[0], own, frames), seconds=0.0, error=0.0, warnings=())
