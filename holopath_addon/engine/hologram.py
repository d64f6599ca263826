"""What is to be displayed: the hologram's grid, colours and depth volume; and how it is to be computed."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace

from .baselines import BASELINES
from .errors import InvalidInput

QUALITIES = ("draft", "preview", "balanced", "full")
METHODS = ("auto", "full", "fast", "direct", *BASELINES)
ESTIMATORS = ("lattice", "paper")
PHASE_FIELDS = ("designed", "random")
RADIANCES = ("grain", "ray")
DEPTH_MAPPINGS = ("fit", "eyepiece")
VIRTUAL_IMAGES = ("curvature", "opl")


@dataclass(frozen=True)
class Hologram:
    """Grid, wavelengths and depth volume of a hologram. The SLM lies at z = 0, light runs to +z.

    Parameters
    ----------
    width, height : int
        Pixels.
    pitch : float
        Pixel pitch d, metres. The recordable cone is asin(wavelength / (2 d)).
    wavelengths : tuple of float
        Vacuum wavelengths, metres; each takes the red, green or blue radiance of the scene,
        whichever is nearest (`channel`).
    depth_far, depth_near : float
        Distance from the SLM of the far end (world infinity) and of the near end, metres.
    depth_mapping : {'fit', 'eyepiece'}
        How world depth fills the volume, see `mapping.DepthMapping`.
    near : float, optional
        World depth that `fit` maps to `depth_near`, metres. Default: the nearest surface in view.

    Raises
    ------
    InvalidInput
        On a value that no display can have.
    """

    width: int
    height: int
    pitch: float
    wavelengths: tuple = (640e-9, 516.5e-9, 455.4e-9)
    depth_far: float = 80e-3
    depth_near: float = 85e-3
    depth_mapping: str = "fit"
    near: float | None = None

    def __post_init__(self):
        object.__setattr__(self, "wavelengths", tuple(float(w) for w in self.wavelengths))
        if self.width < 1 or self.height < 1:
            raise InvalidInput(
                f"The hologram's resolution is {self.width} x {self.height}: both must be at least 1 pixel."
            )
        if self.width * self.height > 1 << 26:
            raise InvalidInput(
                f"The hologram's resolution {self.width} x {self.height} is over 67 megapixels: choose a smaller one."
            )
        if not (math.isfinite(self.pitch) and self.pitch > 0):
            raise InvalidInput(f"The pixel pitch must be positive, not {self.pitch * 1e6:g} µm.")
        if not self.wavelengths:
            raise InvalidInput("The hologram needs at least one wavelength.")
        for wavelength in self.wavelengths:
            if not 100e-9 <= wavelength <= 10e-6:
                raise InvalidInput(f"The wavelength {wavelength * 1e9:g} nm is outside 100 nm to 10000 nm.")
            if wavelength >= 2 * self.pitch:
                raise InvalidInput(
                    f"The pixel pitch {self.pitch * 1e6:g} µm is too small for {wavelength * 1e9:g} nm: "
                    f"make it larger than half the wavelength."
                )
        if not (
            math.isfinite(self.depth_far)
            and math.isfinite(self.depth_near)
            and self.depth_near > self.depth_far
        ):
            raise InvalidInput(
                f"The depth range must run from far to near with near farther from the SLM, not "
                f"{self.depth_far * 1e3:g} mm to {self.depth_near * 1e3:g} mm: make the near end larger."
            )
        if self.depth_mapping not in DEPTH_MAPPINGS:
            raise InvalidInput(
                f"Unknown depth mapping '{self.depth_mapping}': choose one of {', '.join(DEPTH_MAPPINGS)}."
            )
        if self.near is not None and not (math.isfinite(self.near) and self.near > 0):
            raise InvalidInput(f"The near end of the scene must be a positive distance, not {self.near:g} m.")

    def max_slope(self, wavelength: float) -> float:
        """Slope tan(asin(wavelength / (2 pitch))) of the recordable cone's edge."""
        return math.tan(math.asin(wavelength / (2 * self.pitch)))

    def to_dict(self) -> dict:
        """JSON-able form, see `from_dict`."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict) -> Hologram:
        """Inverse of `to_dict`."""
        return cls(**values)


def channel(wavelength: float) -> int:
    """Index (0 red, 1 green, 2 blue) of the scene's radiance channel that a wavelength in metres shows."""
    return 0 if wavelength > 580e-9 else 1 if wavelength > 490e-9 else 2


@dataclass(frozen=True)
class Settings:
    """How a hologram is computed. Defaults suit most scenes; the plan fills what is left open.

    Parameters
    ----------
    frames : int
        Time-multiplexed frames M; more have less speckle.
    speckle : float, optional
        Speckle contrast to reach: as many frames as that takes, in place of `frames`.
    method : {'auto', 'full', 'fast', 'direct'} or one of `baselines.BASELINES`
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

    def resolved(self) -> Settings:
        """These settings with what the method implies, `direct` the paper's estimator, and a wished speckle the frames.

        Raises
        ------
        InvalidInput
            If no number of frames has so little speckle.
        """
        from .phase_fields import frames_for

        estimator = "paper" if self.method == "direct" else self.estimator
        frames = self.frames if self.speckle is None else frames_for(self.phase_field, self.speckle)
        return replace(self, estimator=estimator, frames=frames)
