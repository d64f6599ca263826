"""Request of a render: one record, from the button or the command line to the engine and into the report."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from .. import engine
from ..engine.baselines import network
from ..engine.planning.planner import resolved

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mitsuba as mi

    from ..engine.encoding.phase_hologram import PhaseHologram
    from ..engine.waves.display_model import DisplayModel
    from ..engine.waves.modulator import Levels

CENTER = "center"  # focus on the middle of the view, as stored in reports


@dataclass(frozen=True)
class Encoding:
    """Method and options of the encoding of a field.

    Attributes
    ----------
    method : str
        Method of `engine.encode`; ``auto`` for that of `engine.plan_encoding`, ``none`` for no phases.
    seconds : float or None
        Time limit after the field, see `engine.plan_encoding`.
    eyebox : float or None
        Weight of parts of the pupil, see `engine.plan_encoding`.
    bits : int or None
        Bits of the SLM's levels.
    levels : sequence of engine.Levels, or None
        Levels of the SLM at each wavelength.
    display : sequence of engine.DisplayModel, or None
        Model of the display at each wavelength.
    previous : engine.PhaseHologram or None
        The previous frame's phases, if the optimization starts from them.
    """

    method: str = "none"
    seconds: float | None = None
    eyebox: float | None = None
    bits: int | None = None
    levels: Sequence[Levels] | None = None
    display: Sequence[DisplayModel] | None = None
    previous: PhaseHologram | None = None

    @property
    def is_requested(self) -> bool:
        """Whether phases are requested."""
        return self.method != "none"

    @property
    def descends(self) -> bool:
        """Whether phases are found by gradient descent, which takes time."""
        return self.method not in ("none", "dpac")

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of `engine.encode` that describe the display."""
        return {"bits": self.bits, "levels": self.levels, "display": self.display}


@dataclass(frozen=True)
class Outputs:
    """Files to write besides the field, its images and its phases.

    Attributes
    ----------
    reference : bool
        Whether to write images by a thin-lens camera, and report PSNR and SSIM of every image.
    rgbd : bool
        Whether to write a pinhole image with its depths.
    light_field : int or None
        Number of views in a row and in a column of pinhole images through points of the pupil.
    quilt : (int, int) or None
        Columns and rows of one image of such views, from the left of the pupil to its right.
    contact_sheet : str or None
        Name of an overview image, see `output.contact_sheet`.
    """

    reference: bool = False
    rgbd: bool = False
    light_field: int | None = None
    quilt: tuple[int, int] | None = None
    contact_sheet: str | None = None


@dataclass(frozen=True)
class Origin:
    """Origin of a scene, for the report.

    Attributes
    ----------
    name : str
        Name of the scene's file, or of the scene.
    notes : list of dict
        Approximations and omissions of the exporter, see `export.Note`.
    scene_state : dict
        Options to open the scene again: its frame and the name of its camera, None if it has none, and others.
    job : str or None
        Digest of the job that the render belongs to, see `farm.job.SharedJob`. It identifies a finished render without
        its scene.
    """

    name: str = ""
    notes: list[dict] = field(default_factory=list)
    scene_state: dict = field(default_factory=dict)
    job: str | None = None


@dataclass(frozen=True)
class Request:
    """Scene, settings and outputs of a render.

    Attributes
    ----------
    hologram : engine.Hologram
    settings : engine.Settings
    focus : sequence of (float or CENTER), CENTER, or None
        World depths of the images, meters. `CENTER` is `pipeline.center_depth`, or the nearest surface without one.
        Equal depths give one image. None: `pipeline.default_focus`.
    pupil : engine.Pupil or None
        Part of the viewer's pupil that images are seen through; None for all of it.
    store : engine.BakeStore or None
        Store of baked light.
    encoding : Encoding
    outputs : Outputs
    origin : Origin
    method : str or None
        Method of light transport for all frames of an animation, if the settings leave it open.
    scene : mitsuba.Scene
        None until it is built, see `with_scene`.
    camera : engine.Camera
        Camera of the scene; None until the scene is built.
    """

    hologram: engine.Hologram
    settings: engine.Settings = engine.Settings()
    focus: Sequence | str | None = None
    pupil: engine.Pupil | None = None
    store: engine.BakeStore | None = None
    encoding: Encoding = Encoding()
    outputs: Outputs = Outputs()
    origin: Origin = field(default_factory=Origin)
    method: str | None = None
    scene: mi.Scene = None  # pyrefly: ignore[bad-assignment]  # until it is built
    camera: engine.Camera = None  # pyrefly: ignore[bad-assignment]

    def with_scene(self, scene: mi.Scene, camera: engine.Camera, notes: Sequence[dict]) -> Request:
        """Add the built scene to the request.

        Parameters
        ----------
        scene : mitsuba.Scene
        camera : engine.Camera
        notes : sequence of dict
            See `Origin`.

        Returns
        -------
        Request
        """
        return replace(self, scene=scene, camera=camera, origin=replace(self.origin, notes=list(notes)))

    @property
    def autofocus(self) -> bool:
        """Whether the first image is focused on the middle of the view."""
        return bool(self.focus) and self.focus[0] == CENTER

    @property
    def max_depth(self) -> int:
        """Maximum number of vertices of a path, in the field and in the path tracer's images."""
        return resolved(self.settings).max_depth

    @cached_property
    def inputs(self) -> dict[str, Any]:
        """Every input that affects the result, by the report's keys."""
        from ..engine.scene.fingerprint import scene_digest

        encoding, outputs = self.encoding, self.outputs
        return {
            "scene_digest": scene_digest(self.scene),
            "camera": self.camera.to_dict(),
            "hologram": self.hologram.to_dict(),
            "settings": asdict(self.settings),
            "requested_focus": self.focus,
            "pupil_m": asdict(self.pupil) if self.pupil else None,
            "compare_reference": outputs.reference,
            "encode": encoding.method,
            "encoding_bits": encoding.bits,
            "encoding_levels": encoding.levels and [each.to_dict() for each in encoding.levels],
            "encoding_display": encoding.display and [model.to_dict() for model in encoding.display],
            "rgbd": outputs.rgbd or None,  # None as in reports of earlier versions
            "light_field": outputs.light_field,
            "quilt": outputs.quilt and list(outputs.quilt),
            "encode_seconds": encoding.seconds,
            "eyebox": encoding.eyebox,
            "previous_phases": encoding.previous and encoding.previous.report.get("sha256"),
            "contact_sheet": outputs.contact_sheet,
            "method": self.method,
            "network": network.digests() if self.settings.method == "network" else None,
        }
