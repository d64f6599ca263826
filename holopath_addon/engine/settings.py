"""How a hologram is computed: each setting declared once, for the command line, Blender, the checks and the guide."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

from .errors import InvalidInput


@dataclass(frozen=True)
class Choice:
    """One of the values that a setting may have.

    Attributes
    ----------
    name, label, help : str
        In words on the command line, as Blender's menus have it, and what it does.
    number : int
        By which .blend files hold it, for ever.
    """

    name: str
    label: str
    help: str
    number: int


def choices(*rows: tuple[str, str, str], numbered: tuple[str, ...] = ()) -> dict[str, Choice]:
    """Choices by name, numbered in this order, or in that of `numbered`."""
    order = list(numbered or [row[0] for row in rows])
    return {row[0]: Choice(*row, order.index(row[0])) for row in rows}


# name: module of `baselines`, what it is called, what it does
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
METHODS = choices(
    ("auto", "Auto", "Bake diffuse light where that takes less time than tracing it for this view"),
    ("full", "Full", "Trace all light for this view alone"),
    ("fast", "Fast", "Bake diffuse light into a texture, once for all views and focus distances of a scene"),
    ("direct", "Direct", "Trace straight from the SLM with random directions: the paper's slow baseline"),
    *((name, label, f"To compare with: {what}") for name, (_, label, what) in BASELINES.items()),
)
QUALITIES = choices(
    (
        "draft",
        "Draft",
        "A true hologram at once, with much noise: mirrors and glass show pictures on their own surface",
    ),
    ("preview", "Preview", "Few rays and radiance samples, for a first look"),
    ("balanced", "Balanced", "Enough rays for every depth in view"),
    ("high", "High", "A wider cone of rays and more radiance samples"),
    numbered=("preview", "balanced", "high", "draft"),
)
ESTIMATORS = choices(
    ("lattice", "Lattice", "Directions on a lattice with the exact kernel: no noise but the radiance's"),
    ("paper", "Paper", "Random directions with a spherical wave, as published"),
)
PHASE_FIELDS = choices(
    ("auto", "Auto", "Smooth with up to five frames, which cannot average speckle; designed with more"),
    (
        "smooth",
        "Smooth",
        "Surfaces as far in phase as the randomness says: little speckle with few frames, and less light to the rim of "
        "the eyebox",
    ),
    ("designed", "Designed", "Maps designed so that the frames' mean has little speckle, at any focus"),
    (
        "random",
        "Random",
        "Independent for each frame, as published: speckle of one over the root of the frames",
    ),
    numbered=("designed", "random", "auto", "smooth"),
)
RADIANCES = choices(
    (
        "grain",
        "Per Grain",
        "Average every grain's radiance before the root is taken: right where light is indirect",
    ),
    ("ray", "Per Ray", "Light paths of its own for each ray, as published: dark where light is indirect"),
)
VIRTUAL_IMAGES = choices(
    ("curvature", "Wavefront", "Where neighboring rays cross: right for curved mirrors and lenses"),
    ("opl", "Path Length", "At the optical path length, as published: right for flat mirrors only"),
)
DEPTH_MAPPINGS = choices(
    ("fit", "Fit Scene", "Spread the scene from its near end to infinity over the depth range"),
    ("eyepiece", "Eyepiece", "Place depths as an eyepiece that shows the hologram in the camera's view does"),
)
ENCODINGS = choices(
    (
        "dpac",
        "Double Phase",
        "Neighboring pixels whose mean is the complex amplitude: at once, for a first look",
    ),
    (
        "auto",
        "Automatic",
        "The best that the seconds allow: Many Frames where the scene is at hand, or All Frames; with one frame "
        "Each Frame",
    ),
    ("sgd", "Each Frame", "Gradient descent towards each frame's complex field"),
    (
        "joint",
        "All Frames",
        "Each frame, then all together, so that what is seen through them is what the field shows",
    ),
    (
        "refine",
        "Many Frames",
        "Each frame, then all together towards the mean of many more frames, which are traced for it: nearest to the "
        "scene, and takes longer",
    ),
)


# What choices were called in the version before; these names still work, with a word.
FORMERLY = {"quality": {"full": "high"}}


def _warn(text):
    warnings.warn(text, DeprecationWarning, stacklevel=5)


def current(name: str, value: Any, tell: Callable[[str], object] = _warn) -> Any:
    """A setting's value by the name that it has now; `tell` gets a sentence where it was called otherwise."""
    new = FORMERLY[name].get(value, value) if name in FORMERLY else value
    if new is not value:
        tell(f"The {name} {value} is called {new} now; the old name goes with the next version.")
    return new


@dataclass(frozen=True)
class Switch:
    """Blender's switch beside a setting that need not be set by hand.

    Attributes
    ----------
    name, label, help : str
        The property's, its label, and what it does.
    by_hand : bool
        Whether the setting is taken by hand where it is on, or where it is off.
    heading : str
        In front of it in a panel.
    """

    name: str
    label: str
    help: str
    by_hand: bool
    heading: str


@dataclass(frozen=True)
class Declaration:
    """What those who set a setting are told of it, and what it may be.

    Attributes
    ----------
    label, help : str
        In Title Case, and a sentence without a full stop, as Blender has them.
    advice : str
        What to start with, for the guide; its default where empty.
    section : str
        The panel that shows it.
    bounds : (float, float)
        Least and most of a number; whole numbers where these are.
    soft : (float, float), optional
        What a slider in Blender covers.
    chosen : dict of str to Choice
        What it may be, where that is a word.
    unit : str
        'mm' of what the engine has in meters.
    initial : float or None
        What a number that need not be set is at first when it is.
    switch : Switch, optional
        Whether it is.
    instead_of : str
        The setting that it takes the place of: only one of the two is given.
    metavar : str
        Its value on the command line.
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
        """Refuse a value that it cannot have.

        Raises
        ------
        InvalidInput
        """
        if self.chosen:
            if value not in self.chosen:
                raise InvalidInput(f"Unknown {self.label.lower()} '{value}': choose {self.allowed}.")
            return
        least, most = self.bounds
        number = isinstance(value, (int, self.kind)) and math.isfinite(value)
        if not (number and least <= value <= most):
            raise InvalidInput(f"{self.label} must be {self.allowed}, not {value}.")

    @property
    def kind(self) -> type:
        """Of a number: `int` or `float`."""
        return type(self.bounds[0])

    @property
    def allowed(self) -> str:
        """What it may be, in words."""
        if self.chosen:
            return f"one of {', '.join(self.chosen)}"
        auto, (least, most) = "auto or " if self.switch and not self.switch.by_hand else "", self.bounds
        if math.isinf(least):
            return f"{auto}a number"
        return f"{auto}{least} or more" if math.isinf(most) else f"{auto}from {least} to {most}"


def _setting(default, label, help, **told) -> Any:
    declared = Declaration(label, help, **told)
    if isinstance(default, dict):
        return field(default_factory=dict, metadata={"declared": declared})
    return field(default=default, metadata={"declared": declared})


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How a hologram is computed. Defaults suit most scenes; the plan fills what is left open.

    For the `BASELINES`, which are other people's methods, to be compared with, these count: `frames`, `quality`, `spp`
    (paths of a picture's pixel), `max_depth` and `seed`. Distances are in meters here, whatever their unit elsewhere.
    `fixed` holds values by name, see `FIXABLE`.

    Raises
    ------
    InvalidInput
        On a value out of range.
    """

    quality: str = _setting(
        "balanced",
        "Quality",
        "Rays and radiance samples per pixel: more take longer and leave less noise",
        advice="`draft` for something true within a second, `preview` to look, `high` for figures in a paper",
        section="quality",
        chosen=QUALITIES,
    )
    speckle: float | None = _setting(
        None,
        "Speckle",
        "Speckle contrast that may be left: standard deviation over mean of the intensity. As many frames are taken as "
        "it needs",
        advice="instead of frames: 0.2 is hardly seen in motion, 0.05 in stills",
        section="quality",
        bounds=(0.01, 1.0),
        soft=(0.01, 0.6),
        initial=0.15,
        switch=Switch(
            "wish_speckle",
            "Frames by Speckle",
            "Take as many frames as the wanted speckle contrast needs",
            True,
            "By Speckle",
        ),
        instead_of="frames",
        metavar="CONTRAST",
    )
    frames: int = _setting(
        8,
        "Frames",
        "Time-multiplexed frames per color: 1 for an SLM of 60 pictures a second or of 180 in colors, 3 for one of "
        "540, 8 and more for fast ones. More have less speckle and take longer",
        advice="what your SLM shows: 1 for most, 8 and more for fast ones; a display's preset brings its own",
        section="quality",
        bounds=(1, 256),
        soft=(1, 32),
        metavar="M",
    )
    method: str = _setting(
        "auto",
        "Method",
        "Where the light that surfaces scatter diffusely comes from",
        advice="`auto`. See [baked light](how-to/baked-light.md) and [other methods](how-to/compare.md)",
        section="quality",
        chosen=METHODS,
    )
    despeckle: int = _setting(
        0,
        "Despeckle",
        "Steps that take speckle out of the finished fields, towards the mean of 96 frames. These are traced for it "
        "and multiply the time. 60 steps do most, 0 nothing",
        advice="0; 60 for a still picture with few frames, 200 for the best",
        section="quality",
        bounds=(0, 1 << 16),
        soft=(0, 200),
        metavar="STEPS",
    )
    max_depth: int = _setting(
        8,
        "Max Path Depth",
        "Longest light path, in vertices: 1 is emission only, 2 direct light, each further one a bounce",
        section="quality",
        bounds=(1, 1 << 16),
        soft=(1, 16),
    )
    seed: int = _setting(
        0,
        "Seed",
        "Seed of all random numbers: another one gives other noise",
        bounds=(0, math.inf),
        metavar="S",
    )
    phase_field: str = _setting(
        "auto",
        "Phase Fields",
        "Where the phases of the frames come from; they cost the same",
        advice="`auto`; `designed` for the whole eyebox with few frames, `random` to compare with the paper",
        chosen=PHASE_FIELDS,
    )
    randomness: float | None = _setting(
        None,
        "Randomness",
        "How far smooth phase fields are from in phase, 0, to random, 1. More spreads light over the eyebox and leaves "
        "more speckle",
        advice="automatic: 0 for fields; phases begin with 0 for one frame and 0.1 for two to seven",
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
        "Most rays per pixel, on average. Fewer than are needed fill a narrower cone",
        advice="as many as are needed",
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
        "How the rays of a pixel are chosen and summed",
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
        "Radiance paths that are averaged for each ray, where radiance is taken per ray. With few, indirect light is "
        "too dark",
        bounds=(1, 1 << 16),
        soft=(1, 64),
    )
    most_hits: int = _setting(
        8,
        "Specular Hits",
        "Most mirrors and clear surfaces in a row that a ray follows to what is seen in them. What is beyond is black. "
        "With 0, reflections lie on the mirror's surface",
        bounds=(0, 64),
        soft=(0, 16),
    )
    virtual_image: str = _setting(
        "curvature",
        "Virtual Images",
        "Depth at which things seen in mirrors and through clear glass come into focus",
        advice="`curvature`; `opl` to compare with the paper",
        chosen=VIRTUAL_IMAGES,
    )
    wrp: str | float = _setting(
        "auto",
        "Recording Plane",
        "Distance of the wave recording plane from the SLM, in millimeters",
        advice="`auto`: amid the depths in view, where the fewest rays are needed",
        soft=(-200.0, 500.0),
        unit="mm",
        initial=12.5,
        switch=Switch(
            "wrp_auto",
            "Automatic Recording Plane",
            "Put wave recording planes amid the depths in view, where they need the fewest rays",
            False,
            "Plane Depths",
        ),
        metavar="MM",
    )
    planes: int | str = _setting(
        "auto",
        "Recording Planes",
        "Most planes that rays start from, each near its part of the scene. More planes need fewer rays, and keep the "
        "edges of near things free of dark rims",
        advice="`auto`: as many as are worth their time; 1 as published",
        bounds=(1, 32),
        soft=(1, 8),
        initial=4,
        switch=Switch(
            "planes_auto",
            "Automatic Number of Planes",
            "As many recording planes as are worth their time, by the depths, edges and mirrors in view",
            False,
            "Plane Count",
        ),
        metavar="J",
    )
    fixed: dict = _setting(
        {},
        "Fixed Decisions",
        "Decisions of the plan that you take yourself, for example chain=4,passes=64",
        advice="none: `holopath plan` says what it decides",
        metavar="NAME=N[,..]",
    )

    def __post_init__(self):
        for name, declared in DECLARED.items():
            value = current(name, getattr(self, name))
            object.__setattr__(self, name, value)
            if name != "fixed" and not (declared.switch and value == default_of(name)):
                declared.check(value)


# Of encodings, which fields know nothing of.
ENCODE_SECONDS = Declaration(
    "Encoding Seconds",
    "Seconds that encoding may take, from the field on: Automatic then chooses the encoding that is best by then, and "
    "each gives what it has when they are over",
    section="hologram",
    bounds=(0.1, math.inf),
    soft=(1.0, 300.0),
    initial=30.0,
    switch=Switch(
        "limit_encoding",
        "Encode by the Clock",
        "Let encoding take as many seconds as you give it, and make the best of them",
        True,
        "By the Clock",
    ),
    metavar="S",
)


EYEBOX = Declaration(
    "Eyebox",
    "How much parts of the pupil count besides the whole in the phases of all frames: with 1 the picture holds as the "
    "eye moves, with 0 it is best for an eye in the middle. Few frames cannot show both",
    advice="automatic: 0 with up to six frames, 1 from eight on",
    section="hologram",
    bounds=(0.0, 1.0),
    soft=(0.0, 1.0),
    initial=1.0,
    switch=Switch(
        "eyebox_auto",
        "Automatic Eyebox",
        "As much as so many frames can show",
        False,
        "Eyebox",
    ),
    metavar="SHARE",
)


DECLARED: dict[str, Declaration] = {each.name: each.metadata["declared"] for each in fields(Settings)}


Settings.__doc__ = f"{Settings.__doc__}\n    Parameters\n    ----------\n" + "".join(
    f"    {name} : {declared.allowed}\n        {declared.help.replace('millimeters', 'meters')}.\n"
    for name, declared in DECLARED.items()
)


def default_of(name: str) -> Any:
    """Default of a setting."""
    return getattr(Settings, name, {})
