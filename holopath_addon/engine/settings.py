"""How a hologram is computed: what may be asked for."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from .errors import InvalidInput

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

QUALITIES = ("draft", "preview", "balanced", "full")
METHODS = ("auto", "full", "fast", "direct", *BASELINES)
ESTIMATORS = ("lattice", "paper")
PHASE_FIELDS = ("designed", "random")
RADIANCES = ("grain", "ray")
VIRTUAL_IMAGES = ("curvature", "opl")


@dataclass(frozen=True)
class Settings:
    """How a hologram is computed. Defaults suit most scenes; the plan fills what is left open.

    Parameters
    ----------
    frames : int
        Time-multiplexed frames M; more have less speckle.
    speckle : float, optional
        Speckle contrast to reach: as many frames as that takes, in place of `frames`.
    method : {'auto', 'full', 'fast', 'direct'} or one of `BASELINES`
        Where diffuse light comes from: paths for this view alone (`full`), or a cache of baked light, which other
        views share (`fast`); `auto` takes the sooner. `direct` traces straight from the SLM with the paper's
        estimator: its slow baseline. The baselines are other people's methods, to be compared with; of these settings
        they take `frames`, `quality`, `spp` (paths of a picture's pixel), `max_depth` and `seed`.
    estimator : {'lattice', 'paper'}
        Lattice of directions with the exact kernel, or the paper's random directions with a
        spherical wave.
    phase_field : {'designed', 'random'}
        Phases of the frames: maps designed for little speckle, or independent random fields as published.
    radiance : {'grain', 'ray'}
        Average the path-traced radiance per grain before the root is taken, or take a few paths for each ray.
    paths : int
        Of each ray where radiance is 'ray'.
    quality : {'draft', 'preview', 'balanced', 'full'}
        Sets rays and radiance samples where `spp` does not; a draft shows mirrors and clear surfaces as pictures on
        themselves.
    spp : int, optional
        Most rays a pixel, on average: with fewer than are needed far depths show their middle views only.
    wrp : 'auto' or float
        Distance of the wave recording plane from the SLM, metres.
    planes : 'auto' or int
        Most recording planes; by itself the plan takes what is worth its time. More need fewer rays, and each shades
        what lies behind it as a wave.
    max_depth : int
        Vertices of a radiance path, as Mitsuba counts them: 1 emission only, 2 direct light.
    virtual_image : {'curvature', 'opl'}
        Where the image in a mirror or lens lies: where its wavefront's curvature says, or at the optical path
        length as in the paper.
    most_hits : int
        Longest chain of mirrors and clear surfaces that is followed; 0 shows them as pictures on themselves.
    despeckle : int
        Gradient steps that take speckle out of this scene's own fields, see `despeckle`; 0: none.
    seed : int
        Of every random number used.
    fixed : dict
        Values of decisions that the planner would else take, see `planner.FIXABLE`.

    Raises
    ------
    InvalidInput
        On a value out of range.
    """

    frames: int = 8
    speckle: float | None = None
    method: str = "auto"
    estimator: str = "lattice"
    phase_field: str = "designed"
    radiance: str = "grain"
    paths: int = 1
    quality: str = "balanced"
    spp: int | None = None
    wrp: str | float = "auto"
    planes: int | str = "auto"
    max_depth: int = 8
    virtual_image: str = "curvature"
    most_hits: int = 8
    despeckle: int = 0
    seed: int = 0
    fixed: dict = field(default_factory=dict)

    def __post_init__(self):
        for name, known in (
            ("method", METHODS),
            ("estimator", ESTIMATORS),
            ("phase_field", PHASE_FIELDS),
            ("radiance", RADIANCES),
            ("quality", QUALITIES),
            ("virtual_image", VIRTUAL_IMAGES),
        ):
            value = getattr(self, name)
            if value not in known:
                raise InvalidInput(
                    f"Unknown {name.replace('_', ' ')} '{value}': choose one of {', '.join(known)}."
                )
        if not 1 <= self.frames <= 256:
            raise InvalidInput(f"The number of frames must be between 1 and 256, not {self.frames}.")
        if self.speckle is not None and not 0 < self.speckle <= 1:
            raise InvalidInput(f"The speckle contrast must be above 0 and at most 1, not {self.speckle:g}.")
        if self.spp is not None and not 1 <= self.spp <= 1 << 20:
            raise InvalidInput(f"Rays a pixel must be between 1 and {1 << 20}, not {self.spp}.")
        if self.wrp != "auto" and not (isinstance(self.wrp, (int, float)) and math.isfinite(self.wrp)):
            raise InvalidInput(
                "The recording plane must be 'auto' or a distance from the SLM in millimeters."
            )
        if self.planes != "auto" and not (isinstance(self.planes, int) and 1 <= self.planes <= 32):
            raise InvalidInput(f"Recording planes must be 'auto' or 1 to 32, not {self.planes}.")
        if not 1 <= self.paths <= 1 << 16:
            raise InvalidInput(f"Radiance paths a ray must be 1 to {1 << 16}, not {self.paths}.")
        if self.max_depth < 1:
            raise InvalidInput(f"Paths need at least 1 vertex, not {self.max_depth}.")
        if not 0 <= self.most_hits <= 64:
            raise InvalidInput(f"Chains of mirrors must be 0 to 64 hits long, not {self.most_hits}.")
        if not 0 <= self.despeckle <= 1 << 16:
            raise InvalidInput(f"Steps against speckle must be 0 to {1 << 16}, not {self.despeckle}.")
        if self.seed < 0:
            raise InvalidInput(f"The seed must not be negative, not {self.seed}.")
