"""What planning decides, and all that follows obeys."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Generic, TypeVar

from .settings import Settings
from .slabs import Slab

T = TypeVar("T")
SLABS = "slab", "images"  # of a recording plane
CARD_STAGES = "wave tracing", "propagation", "reconstruction"  # of `Plan.card_memory`, beside encodings
PHASES = "sgd", "joint", "look", "light", "rays", "frame", "step"  # see `planning.costs.phases`


@dataclass(frozen=True)
class RecordingPlane:
    """A plane that rays start from, and the slab of the volume that it records. Distances from the SLM in meters.

    Attributes
    ----------
    z : float
        Of the plane.
    sees : {'all', 'surfaces', 'images'}
        What it records: everything, what rays meet straight on, or what they meet over mirrors and clear surfaces.
    slab : Slab
        Depths of the first surfaces that its rays meet.
    images : Slab
        Depths of what it records of what these show.
    low : float
        Where what lies wholly beyond the farther planes' slabs begins, and with it the silhouette.
    depth_limit : float
        Largest distance of a surface from the plane.
    rays : int
        A pixel, where it needs most.
    plain, chained : float
        Estimated rays a pixel that no mirror or clear surface is in view of, and others, means over all pixels.
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
    """One choice of the plan, in plain words.

    Attributes
    ----------
    name, value : str
        What was decided, and how.
    reason : str
    saving : str
        What is not done because of it; empty where nothing is saved.
    error : float or None
        Estimated error of the wave field that comes of it, relative to the field; None where there is no estimate.
    """

    name: str
    value: str
    reason: str
    saving: str = ""
    error: float | None = None

    @property
    def why(self) -> str:
        """Reason, saving and error in one."""
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
    """What was chosen, the decisions that say so, and what to warn of."""

    value: T
    decisions: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """What will be computed. Distances in meters.

    Attributes
    ----------
    near : float
        World depth at the near end of the volume (`fit`), or of the nearest surface (`eyepiece`).
    z_low, z_high : float
        Hologram-space depths between which surfaces were seen.
    planes : tuple of RecordingPlane
        From the far end to the near one.
    rays_per_pixel, passes, margin, slabs, bins : int
        Rays of the wave on all planes where they need most, radiance paths, and the radiance map's pixels beyond each
        edge, depth slabs and pupil bins.
    most_passes, wanted_error : int, float
        Paths that may be taken until the radiance's noise leaves so small an error of the wave field.
    white : float
        Radiance of the bright parts of the view.
    grey : bool
        Whether all wavelengths share one radiance.
    traversals : int
        Times that rays are traced: once for all wavelengths, or for each where glass in view disperses.
    regions : bool
        Whether each tile of the recording plane has as many rays as it needs, and chains only where they are seen.
    cached : bool
        Whether diffuse light comes from the radiance cache.
    texel_noise, texel_samples : float, int
        Relative standard error that its texels in view are baked to, and most samples of each.
    max_depth : int
        Vertices of a radiance path.
    radiance_limit : float
        Most that indirect light may add to one path.
    chain : int
        Longest chain of specular hits; 0 leaves the code for them out.
    splits : int
        Hits of a chain at which more than one way on is followed.
    virtual_image : str
        'curvature', or 'opl' where it is asked for or exact.
    pupil : float
        Radius of the pupil that nearly smooth mirrors are followed for, meters; 0 where none is in view.
    coherent : bool
        Whether neighboring rays are traced in packets.
    cone : float
        Half-angle of the lattice in recordable slopes.
    levels : int
        Of the kernel tables at least.
    reach : int
        Columns to either side that grains of one surface share their light over; 0: none.
    textures : int or None
        Rays a pixel that see textures alone; None where the first paths tell how many.
    chunk : int
        Bytes of the sums of pixels that are traced at once.
    stages : dict of str to float
        Estimated seconds of each stage on this machine; empty for baselines, of which nothing is foretold.
    phases : dict of str to float
        Those of what its encodings are made of, by `PHASES`; empty for baselines.
    phases_memory : dict of str to float
        Estimated bytes that each encoding takes, with the field; empty for baselines.
    error : float
        Estimated error of the wave field by the radiance's noise, relative to the field.
    memory_bytes : int
        Estimated peak of the arrays.
    requested : Settings
        For which it was made.
    settings : Settings
        Those with what they imply, see `planning.planner.resolved`; what renders obeys these.
    decisions : tuple of Decision
    warnings : tuple of str
    library : str
        That computes waves and phases, see `waves.libraries`.
    beside : int
        Pixels beyond each edge of the picture that are traced, too, see `mapping`.
    card_memory : dict of str to float
        Estimated bytes of a graphics card's memory that each of `CARD_STAGES` and each encoding takes; empty without a
        card that computes waves.
    """

    near: float
    z_low: float
    z_high: float
    planes: tuple
    rays_per_pixel: int
    passes: int
    most_passes: int
    wanted_error: float
    white: float
    grey: bool
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
    # as in files of versions that did not have these
    beside: int = 0
    card_memory: dict = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Estimated time on this machine; 0 for baselines."""
        return sum(self.stages.values())

    @property
    def z_gathered(self) -> float:
        """Where the field of all planes is brought together, on the nearest to the viewer that has no images only."""
        return gathered_on(self.planes).z

    @property
    def z_middle(self) -> float:
        """Middle of the recording planes, from which the radiance map is seen."""
        return middle_of(self.planes)

    def to_dict(self) -> dict:
        """JSON-able form; null for what is unlimited."""
        return _finite({**asdict(self), "seconds": self.seconds})

    @classmethod
    def from_dict(cls, values: dict) -> Plan:
        """A plan from what `to_dict` gave.

        Raises
        ------
        KeyError, TypeError
            If it is another version's.
        """
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
    """Infinite numbers, which JSON does not have, as None."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and math.isinf(value) else value


def gathered_on(planes: Sequence[RecordingPlane]) -> RecordingPlane:
    """The plane that the waves of all planes are brought together on: the nearest to the viewer of surfaces."""
    return [plane for plane in planes if plane.sees != "images"][-1]


def middle_of(planes: Sequence[RecordingPlane]) -> float:
    """Middle of the planes, from which the radiance map is seen."""
    places = [plane.z for plane in planes]
    return 0.5 * (min(places) + max(places))
