"""Plan of a render: the decisions of planning, which rendering obeys."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Generic, TypeVar

from .settings import Settings
from .settings.former_names import with_current_names
from .slabs import Slab

T = TypeVar("T")
SLABS = "slab", "images"  # fields of a recording plane
CARD_STAGES = "wave tracing", "propagation", "reconstruction"  # keys of `Plan.card_memory`, besides encodings
# Keys of `Plan.phases`, see `planning.costs.CostModel.encoding_seconds`
PHASES = "sgd", "joint", "look", "light", "rays", "frame", "step"


@dataclass(frozen=True)
class RecordingPlane:
    """Plane that rays start from, and the slab of the volume that it records. Distances from the SLM in meters.

    Attributes
    ----------
    z : float
        Depth of the plane.
    sees : {'all', 'surfaces', 'images'}
        What the plane records: everything, surfaces that rays hit directly, or those that they reach over mirrors and
        clear surfaces.
    slab : Slab
        Depths of the first surfaces that its rays hit.
    images : Slab
        Depths of the images in mirrors and clear surfaces that it records.
    low : float
        Depth from which on surfaces are in no slab of a farther plane, and occlude the light of these.
    depth_limit : float
        Largest distance of a surface from the plane.
    rays : int
        Number of rays for a pixel, where it is largest.
    plain, chained : float
        Estimated rays for each pixel that see no mirror or clear surface, and that see one, means over all pixels.
    """

    z: float
    sees: str
    slab: Slab
    images: Slab
    low: float
    depth_limit: float
    rays: int
    plain: float
    chained: float


@dataclass(frozen=True)
class Decision:
    """One decision of the plan, in plain words.

    Attributes
    ----------
    name, value : str
        Name and result of the decision.
    reason : str
        Why it was made.
    saving : str
        Work that it saves; empty if none.
    error : float or None
        Estimated error of the wave field due to it, relative to the field; None without an estimate.

    Examples
    --------
    >>> from holopath_addon import engine
    >>> print(engine.Decision("recording planes", "2", "two groups of depths", "half of the rays", 0.001))
    recording planes: 2 (two groups of depths; saves half of the rays; error about 0.10%)
    """

    name: str
    value: str
    reason: str
    saving: str = ""
    error: float | None = None

    @property
    def why(self) -> str:
        """Reason, saving and error in one text."""
        notes = [self.reason]
        if self.saving:
            notes.append(f"saves {self.saving}")
        if self.error is not None:
            notes.append(f"error about {self.error:.2%}" if self.error >= 5e-5 else "no error")
        return "; ".join(notes)

    def __str__(self) -> str:
        return f"{self.name}: {self.value} ({self.why})"


@dataclass(frozen=True)
class Decided(Generic[T]):
    """Result of a step of planning, with its decisions and warnings."""

    value: T
    decisions: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Plan of a render, made by `plan`. Distances in meters.

    Attributes
    ----------
    near : float
        World depth at the near end of the volume (`fit`), or of the nearest surface (`eyepiece`).
    z_low, z_high : float
        Range of hologram-space depths of the visible surfaces.
    planes : tuple of RecordingPlane
        Recording planes from the far end to the near one.
    rays_per_pixel : int
        Number of wave rays for a pixel on all planes, where it is largest.
    passes : int
        Number of radiance paths for each grain.
    max_passes, target_error : int, float
        Largest number of paths, and the error of the wave field due to the radiance's noise at which they end earlier.
    white : float
        Radiance of the bright parts of the view.
    gray : bool
        Whether all wavelengths share one radiance.
    traversals : int
        Number of times that rays are traced: once for all wavelengths, or for each where visible glass disperses.
    margin, slabs, bins : int
        Radiance map: pixels beyond each edge, depth slabs, and bins of the pupil.
    regions : bool
        Whether each tile of the recording plane has its own number of rays, and chains only where they are visible.
    cached : bool
        Whether diffuse light comes from the radiance cache.
    texel_noise, texel_samples : float, int
        Relative standard error to which visible texels are baked, and the largest number of samples of each.
    max_depth : int
        Largest number of vertices of a radiance path.
    radiance_limit : float
        Upper bound of the indirect light of one path.
    chain : int
        Longest chain of specular hits; 0 omits their code.
    splits : int
        Number of hits of a chain at which both reflection and refraction are followed.
    virtual_image : str
        'curvature', or 'opl' where it is requested or exact.
    pupil : float
        Radius of the pupil for which nearly smooth mirrors are followed; 0 if none is visible.
    coherent : bool
        Whether neighboring rays are traced in packets.
    cone : float
        Half-angle of the lattice in recordable slopes.
    levels : int
        Minimum number of levels of the kernel tables.
    reach : int
        Number of columns to either side over which grains of one surface share their light; 0 for none.
    textures : int or None
        Number of rays for each pixel that see textures only; None where the first paths decide.
    chunk : int
        Bytes of the sums of pixels that are traced at once.
    stages : dict of str to float
        Estimated seconds of each stage on this machine; empty for baselines, which have no estimates.
    phases : dict of str to float
        Estimated seconds of the parts of encodings, by `PHASES`; empty for baselines.
    phases_memory : dict of str to float
        Estimated bytes of each encoding, the field included; empty for baselines.
    error : float
        Estimated error of the wave field due to the radiance's noise, relative to the field.
    memory_bytes : int
        Estimated peak memory of the arrays.
    requested : Settings
        Settings that the plan was made for.
    settings : Settings
        The same with their implications, see `planning.planner.resolved`; rendering obeys these.
    decisions : tuple of Decision
    warnings : tuple of str
    library : str
        Array library that computes waves and phases, see `waves.libraries`.
    beside : int
        Number of pixels beyond each edge of the picture that are also traced, see `mapping`.
    card_memory : dict of str to float
        Estimated bytes of a graphics card's memory for each of `CARD_STAGES` and each encoding; empty without a card
        that computes waves.
    """

    near: float
    z_low: float
    z_high: float
    planes: tuple
    rays_per_pixel: int
    passes: int
    max_passes: int
    target_error: float
    white: float
    gray: bool
    traversals: int
    margin: int
    slabs: int
    bins: int
    regions: bool
    cached: bool
    texel_noise: float
    texel_samples: int
    max_depth: int
    radiance_limit: float
    chain: int
    splits: int
    virtual_image: str
    pupil: float
    coherent: bool
    cone: float
    levels: int
    reach: int
    textures: int | None
    chunk: int
    stages: dict
    phases: dict
    phases_memory: dict
    error: float
    memory_bytes: int
    requested: Settings = field(repr=False)
    settings: Settings = field(repr=False)
    decisions: tuple = field(repr=False)
    warnings: tuple = ()
    library: str = "numpy"
    # defaults for files of versions without these
    beside: int = 0
    card_memory: dict = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Estimated time on this machine; 0 for baselines."""
        return sum(self.stages.values())

    @property
    def z_gathered(self) -> float:
        """Depth of the plane on which the waves of all planes are summed, see `gathered_on`."""
        return gathered_on(self.planes).z

    @property
    def z_middle(self) -> float:
        """Middle of the recording planes, the origin of the radiance map's view."""
        return middle_of(self.planes)

    def to_dict(self) -> dict:
        """Return the values as JSON has them, with null for infinity."""
        return _finite({**asdict(self), "seconds": self.seconds})

    @classmethod
    def from_dict(cls, values: dict) -> Plan:
        """Return a plan; inverse of `to_dict`.

        Parameters
        ----------
        values : dict
            Values as of `to_dict`.

        Raises
        ------
        KeyError, TypeError, InvalidInput
            If they come from another version than this or the last.
        """
        values = with_current_names("plan entry", values, tell=lambda text: None)
        if values["phases"] and set(values["phases"]) != set(PHASES):
            raise KeyError("phases")
        unlimited = {name: math.inf for name in ("white", "radiance_limit") if values[name] is None}
        return cls(
            **{name: value for name, value in values.items() if name != "seconds"}
            | {
                "planes": tuple(map(_plane, values["planes"])),
                **{name: Settings(**values[name]) for name in ("requested", "settings")},
                "decisions": tuple(Decision(**decision) for decision in values["decisions"]),
                "warnings": tuple(values["warnings"]),
            }
            | unlimited
        )

    def __str__(self) -> str:
        lines = [str(decision) for decision in self.decisions]
        if self.seconds:
            lines.append(
                f"time: about {self.seconds:.0f} s, memory: about {self.memory_bytes / 1e6:.0f} MB, "
                f"error of the field: about {self.error:.1%}"
            )
        return "\n".join(lines + [f"warning: {w}" for w in self.warnings])


def _plane(values):
    """A recording plane from its JSON."""
    slabs = {name: Slab(**{end: _ends(end, values[name][end]) for end in ("far", "near")}) for name in SLABS}
    return RecordingPlane(**{**values, **slabs, "low": _unlimited(values["low"], -math.inf)})


def _ends(end, values):
    return tuple(_unlimited(value, -math.inf if end == "far" else math.inf) for value in values)


def _unlimited(value, limit):
    return limit if value is None else value


def _finite(value):
    """Values with None for infinite numbers, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and math.isinf(value) else value


def gathered_on(planes: Sequence[RecordingPlane]) -> RecordingPlane:
    """Plane on which the waves of all planes are summed: the nearest to the viewer that records surfaces."""
    return [plane for plane in planes if plane.sees != "images"][-1]


def middle_of(planes: Sequence[RecordingPlane]) -> float:
    """Middle of the recording planes, the origin of the radiance map's view."""
    depths = [plane.z for plane in planes]
    return 0.5 * (min(depths) + max(depths))
