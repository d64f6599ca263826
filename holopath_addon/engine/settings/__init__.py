"""Settings of a computation, each declared once for the command line, Blender, the checks and the guide."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from ..errors import InvalidInput
from .choices import ESTIMATORS, METHODS, PHASE_FIELDS, QUALITIES, RADIANCES, VIRTUAL_IMAGES
from .former_names import current_name, with_current_names


@dataclass(frozen=True)
class Switch:
    """Blender's switch beside a setting that need not be set by hand.

    Attributes
    ----------
    name, label, help : str
        Name of the property, its label and description.
    by_hand : bool
        Position of the switch, on or off, in which the user's value of the setting counts.
    heading : str
        Text in front of it in a panel.
    """

    name: str
    label: str
    help: str
    by_hand: bool
    heading: str


@dataclass(frozen=True)
class Declaration:
    """Declaration of a setting: its texts and its allowed values.

    Attributes
    ----------
    label, help : str
        Label in Title Case, and description as a sentence without a full stop, as in Blender.
    advice : str
        Value to start with, for the guide; the default if empty.
    section : str
        Panel that shows it.
    bounds : (float, float)
        Minimum and maximum of a number, which is whole if these are.
    soft : (float, float), optional
        Range of the slider in Blender.
    chosen : dict of str to Choice
        Allowed values of a setting that is a word.
    unit : str
        'mm' for lengths, which the engine has in meters.
    initial : float or None
        First value of an optional number when it is switched on.
    switch : Switch, optional
        Switch of an optional number.
    instead_of : str
        Setting that it replaces: only one of the two is given.
    metavar : str
        Placeholder of the value on the command line.
    """

    label: str
    help: str
    advice: str = ""
    section: str = "advanced"
    bounds: tuple[float, float] = (-math.inf, math.inf)
    soft: tuple | None = None
    chosen: dict = field(default_factory=dict)
    unit: str = ""
    initial: float | None = None
    switch: Switch | None = None
    instead_of: str = ""
    metavar: str = "N"

    def check(self, value: Any) -> None:
        """Check a value.

        Raises
        ------
        InvalidInput
            If the value is not allowed.
        """
        if self.chosen:
            if value not in self.chosen:
                raise InvalidInput(f"Unknown {self.label.lower()} '{value}'. Choose {self.allowed}.")
            return
        low, high = self.bounds
        number = isinstance(value, (int, self.kind)) and math.isfinite(value)
        if not (number and low <= value <= high):
            raise InvalidInput(f"{self.label} must be {self.allowed}, got {value}.")

    @property
    def kind(self) -> type:
        """Type of a number, `int` or `float`."""
        return type(self.bounds[0])

    @property
    def allowed(self) -> str:
        """Allowed values, in words."""
        if self.chosen:
            return f"one of {', '.join(self.chosen)}"
        auto, (low, high) = "auto or " if self.switch and not self.switch.by_hand else "", self.bounds
        if math.isinf(low):
            return f"{auto}a number"
        return f"{auto}{low} or more" if math.isinf(high) else f"{auto}from {low} to {high}"


def _setting(default, label, help, **options) -> Any:
    declared = Declaration(label, help, **options)
    if isinstance(default, dict):
        return field(default_factory=dict, metadata={"declared": declared})
    return field(default=default, metadata={"declared": declared})


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a computation. Defaults suit most scenes; the plan decides what they leave open.

    The `BASELINES`, other people's methods for comparison, use `frames`, `quality`, `spp` (paths for each pixel of an
    image), `max_depth` and `seed` only. Distances are in meters here, whatever their unit elsewhere. `fixed` holds
    values by name, see `FIXABLE`.

    Raises
    ------
    InvalidInput
        If a value is not allowed.

    Examples
    --------
    >>> from holopath_addon import engine
    >>> settings = engine.Settings(quality="draft", frames=3)
    >>> settings.max_depth
    8
    >>> engine.Settings(frames=0)
    Traceback (most recent call last):
    holopath_addon.engine.errors.InvalidInput: Frames must be from 1 to 256, got 0.
    """

    quality: str = _setting(
        "balanced",
        "Quality",
        "Rays and radiance samples per pixel: more take longer and reduce noise",
        advice="`draft` for a complete hologram within a second, `preview` for a first look, `high` for figures in a "
        "paper",
        section="quality",
        chosen=QUALITIES,
    )
    speckle: float | None = _setting(
        None,
        "Speckle",
        "Target speckle contrast, standard deviation over mean of the intensity, which sets the number of frames",
        advice="instead of frames: 0.2 is hardly visible in motion, 0.05 in stills",
        section="quality",
        bounds=(0.01, 1.0),
        soft=(0.01, 0.6),
        initial=0.15,
        switch=Switch(
            "wish_speckle",
            "Frames by Speckle",
            "Set the number of frames by the target speckle contrast",
            True,
            "By Speckle",
        ),
        instead_of="frames",
        metavar="CONTRAST",
    )
    frames: int = _setting(
        8,
        "Frames",
        "Time-multiplexed frames per color: 1 for an SLM of 60 Hz, or of 180 Hz in color, 3 for one of 540 Hz, 8 and "
        "more for fast ones. More frames have less speckle and take longer",
        advice="what your SLM shows: 1 for most, 8 and more for fast ones; a display's preset sets its own",
        section="quality",
        bounds=(1, 256),
        soft=(1, 32),
        metavar="M",
    )
    method: str = _setting(
        "auto",
        "Method",
        "How diffusely scattered light is computed",
        advice="`auto`. See [baked light](how-to/baked-light.md) and [other methods](how-to/compare.md)",
        section="quality",
        chosen=METHODS,
    )
    despeckle: int = _setting(
        0,
        "Despeckle",
        "Steps that remove speckle from the finished fields, towards the mean of 96 frames. These are also traced "
        "and multiply the time. 60 steps remove most of it, 0 nothing. Up to five frames have no speckle in the field "
        "with 0, and show less with steps",
        advice="0; with six frames and more 60 for a still image, 200 for the best",
        section="quality",
        bounds=(0, 1 << 16),
        soft=(0, 200),
        metavar="STEPS",
    )
    max_depth: int = _setting(
        8,
        "Max Path Depth",
        "Longest light path, in vertices: 1 is emission only, 2 direct light, and each more adds a bounce",
        section="quality",
        bounds=(1, 1 << 16),
        soft=(1, 16),
    )
    seed: int = _setting(
        0,
        "Seed",
        "Seed of all random numbers: another one gives different noise",
        bounds=(0, math.inf),
        metavar="S",
    )
    phase_field: str = _setting(
        "auto",
        "Phase Fields",
        "Kind of phases of the frames; all take the same time",
        advice="`auto`; `designed` for the whole eyebox with few frames, `random` to compare with the paper",
        chosen=PHASE_FIELDS,
    )
    randomness: float | None = _setting(
        None,
        "Randomness",
        "Randomness of smooth phase fields, from 0, in phase, to 1, random. More spreads light over the eyebox and has "
        "more speckle",
        advice="automatic: 0 for fields; phases start with 0 for one frame and 0.1 for two to seven, and for more with "
        "an eyebox of 0",
        bounds=(0.0, 1.0),
        initial=0.3,
        switch=Switch(
            "set_randomness",
            "Set Randomness",
            "Set the randomness of smooth phase fields by hand",
            True,
            "Set Randomness",
        ),
        metavar="R",
    )
    spp: int | None = _setting(
        None,
        "Rays per Pixel",
        "Maximum number of rays per pixel, on average. Fewer than needed fill a narrower cone",
        advice="as many as needed",
        bounds=(1, 1 << 20),
        soft=(1, 4096),
        initial=256,
        switch=Switch(
            "limit_rays",
            "Limit Rays",
            "Set the largest number of rays per pixel by hand",
            True,
            "Limit Rays",
        ),
        instead_of="quality",
    )
    estimator: str = _setting(
        "lattice",
        "Estimator",
        "How the rays of a pixel are distributed and summed",
        advice="`lattice`; `paper` to compare with the paper",
        chosen=ESTIMATORS,
    )
    radiance: str = _setting(
        "grain",
        "Radiance",
        "How path-traced light becomes amplitude",
        advice="`grain`; `ray` to compare with the paper",
        chosen=RADIANCES,
    )
    paths: int = _setting(
        1,
        "Paths per Ray",
        "Number of radiance paths to average for each ray, where Radiance is Per Ray. With few, indirect light is too "
        "dark",
        bounds=(1, 1 << 16),
        soft=(1, 64),
    )
    max_specular_depth: int = _setting(
        8,
        "Specular Hits",
        "Maximum number of mirrors and clear surfaces in a row that a ray follows. Objects behind more of them are "
        "black. With 0, reflections lie on the mirror's surface",
        bounds=(0, 64),
        soft=(0, 16),
    )
    virtual_image: str = _setting(
        "curvature",
        "Virtual Images",
        "Depth at which objects in mirrors and behind clear glass come into focus",
        advice="`curvature`; `opl` to compare with the paper",
        chosen=VIRTUAL_IMAGES,
    )
    wrp: str | float = _setting(
        "auto",
        "Recording Plane",
        "Distance of the wave recording plane from the SLM, in millimeters",
        advice="`auto`: among the visible depths, where the fewest rays are needed",
        soft=(-200.0, 500.0),
        unit="mm",
        initial=12.5,
        switch=Switch(
            "wrp_auto",
            "Automatic Recording Plane",
            "Put wave recording planes among the visible depths, where they need the fewest rays",
            False,
            "Plane Depths",
        ),
        metavar="MM",
    )
    planes: int | str = _setting(
        "auto",
        "Recording Planes",
        "Maximum number of planes that rays start from, each near its part of the scene. More planes need fewer rays, "
        "and avoid dark rims at the edges of near objects",
        advice="`auto`: as many as are worth their time; 1 as published",
        bounds=(1, 32),
        soft=(1, 8),
        initial=4,
        switch=Switch(
            "planes_auto",
            "Automatic Number of Planes",
            "As many recording planes as are worth their time, by the visible depths, edges and mirrors",
            False,
            "Plane Count",
        ),
        metavar="J",
    )
    fixed: dict = _setting(
        {},
        "Fixed Decisions",
        "Decisions of the plan that you make yourself, for example chain=4,passes=64",
        advice="none: `holopath plan` shows all decisions",
        metavar="NAME=N[,..]",
    )

    def __post_init__(self):
        for name, declared in DECLARED.items():
            value = getattr(self, name)
            if isinstance(value, np.generic):
                value = value.item()
                object.__setattr__(self, name, value)
            if name != "fixed" and not (declared.switch and value == default_of(name)):
                declared.check(value)


# Settings of encodings, which do not affect fields.
ENCODE_SECONDS = Declaration(
    "Encoding Seconds",
    "Time limit of encoding in seconds, without the field: Automatic chooses the best encoding for it, and each "
    "encoding gives its best result when time is up",
    section="hologram",
    bounds=(0.1, math.inf),
    soft=(1.0, 300.0),
    initial=30.0,
    switch=Switch(
        "limit_encoding",
        "Encode by the Clock",
        "Limit the time of encoding, and get the best result for it",
        True,
        "By the Clock",
    ),
    metavar="S",
)


EYEBOX = Declaration(
    "Eyebox",
    "Weight of parts of the pupil, besides the whole, in phases of all frames: with 1 the image holds as the eye "
    "moves, with 0 it is best for an eye in the middle, and parts of the pupil are dark. Few frames cannot do both",
    advice="automatic: 0 with up to six frames, 1 from eight on; in less time than the default takes 0 with up to 15",
    section="hologram",
    bounds=(0.0, 1.0),
    soft=(0.0, 1.0),
    initial=1.0,
    switch=Switch(
        "eyebox_auto",
        "Automatic Eyebox",
        "As much as the number of frames allows",
        False,
        "Eyebox",
    ),
    metavar="SHARE",
)


_init = Settings.__init__


def _init_with_current_names(self, **values):
    values = with_current_names("setting", values)
    for name, value in values.items():
        if name == "fixed":
            values[name] = with_current_names("decision", value)
        elif isinstance(value, str):
            values[name] = current_name(name, value)
    _init(self, **values)


Settings.__init__ = _init_with_current_names
DECLARED: dict[str, Declaration] = {each.name: each.metadata["declared"] for each in fields(Settings)}


PARAMETERS = "".join(
    f"{name} : {declared.allowed}\n    {declared.help.replace('millimeters', 'meters')}.\n"
    for name, declared in DECLARED.items()
)
Settings.__doc__ = inspect.cleandoc(Settings.__doc__ or "").replace(
    "Raises\n", f"Parameters\n----------\n{PARAMETERS}\nRaises\n", 1
)


def default_of(name: str) -> Any:
    """Default of a setting."""
    return getattr(Settings, name, {})
