"""What a render is asked for: one record, from the button or the command line to the engine and into the report."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import engine
from ..engine.planning.planner import resolved

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mitsuba as mi

    from ..engine.waves.display_model import DisplayModel
    from ..engine.waves.modulator import Levels


@dataclass(frozen=True)
class Encoding:
    """How the phases of a field are to be found.

    Attributes
    ----------
    method : str
        Of `engine.encode`; ``auto`` leaves it to `engine.plan_encoding`, and with ``none`` there are no phases.
    seconds : float or None
        Time limit after the field, see `engine.plan_encoding`.
    eyebox : float or None
        Weight of parts of the pupil, see `engine.plan_encoding`.
    bits : int or None
        Of the SLM.
    levels : sequence of engine.Levels, or None
        That the SLM has at each wavelength.
    display : sequence of engine.DisplayModel, or None
        What the display does to light at each wavelength.
    before : Path or None
        Folder of the hologram whose phases these begin with: the previous frame's.
    """

    method: str = "none"
    seconds: float | None = None
    eyebox: float | None = None
    bits: int | None = None
    levels: Sequence[Levels] | None = None
    display: Sequence[DisplayModel] | None = None
    before: Path | None = None

    @property
    def is_requested(self) -> bool:
        """Whether there are to be phases."""
        return self.method != "none"

    @property
    def descends(self) -> bool:
        """Whether phases are found by descents, which take their time."""
        return self.method not in ("none", "dpac")

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of `engine.encode` that describe the display."""
        return {"bits": self.bits, "levels": self.levels, "display": self.display}


@dataclass(frozen=True)
class Outputs:
    """What is to be written besides the field, its images and its phases.

    Attributes
    ----------
    reference : bool
        Images by a thin-lens camera, and PSNR and SSIM of every image.
    rgbd : bool
        An image in which everything is sharp, with the depths in it.
    light_field : int or None
        Points of the pupil in a row and in a column to write such images through.
    quilt : (int, int) or None
        Columns and rows of such images, from the left of the pupil to its right, to write as one.
    contact_sheet : str or None
        Name of an image that shows everything at a glance, see `output.contact_sheet`.
    """

    reference: bool = False
    rgbd: bool = False
    light_field: int | None = None
    quilt: tuple[int, int] | None = None
    contact_sheet: str | None = None


@dataclass(frozen=True)
class Origin:
    """Where a scene comes from, for the report.

    Attributes
    ----------
    name : str
        Of the scene's file, or of the scene.
    notes : list of dict
        What the exporter approximated or left out, see `export.Note`.
    opened : dict
        What it takes to open the scene again: its frame and the name of the camera, None each where there is none.
    job : str or None
        Digest of the job that the render is made for, see `farm.job.SharedJob`: by it, what is done is known without
        its scene.
    """

    name: str = ""
    notes: list[dict] = field(default_factory=list)
    opened: dict = field(default_factory=dict)
    job: str | None = None


@dataclass(frozen=True)
class Request:
    """A scene, and all that a render of it is to bring.

    Attributes
    ----------
    hologram : engine.Hologram
    settings : engine.Settings
    focus : sequence of float or 'centre', 'centre', or None
        World depths of the images, metres; 'centre', alone or among them, is `pipeline.center_depth`, else the nearest
        surface. Those that coincide give one image. None: `pipeline.default_focus`.
    pupil : engine.Pupil or None
    store : engine.BakeStore or None
        Where baked light is kept.
    encoding : Encoding
    outputs : Outputs
    origin : Origin
    method : str or None
        How light is found, where that was decided for all frames of an animation and the settings leave it open.
    scene : mitsuba.Scene
        None until it is built, see `with_scene`.
    camera : engine.Camera
        That the scene is seen by; None likewise.
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
        """The same of a scene that was built, and what its exporter approximated or left out."""
        return replace(self, scene=scene, camera=camera, origin=replace(self.origin, notes=list(notes)))

    @property
    def autofocus(self) -> bool:
        """Whether the first image is at what is in the middle of the view."""
        return bool(self.focus) and self.focus[0] == "centre"

    @property
    def max_depth(self) -> int:
        """Maximum number of vertices of a path, which its images by the path tracer have, too."""
        return resolved(self.settings).max_depth

    @cached_property
    def inputs(self) -> dict[str, Any]:
        """Everything that decides the result, as the report holds it."""
        from ..engine.scene.fingerprint import scene_digest

        encoding, outputs = self.encoding, self.outputs
        return {
            "scene_digest": scene_digest(self.scene),
            "camera": self.camera.to_dict(),
            "hologram": self.hologram.to_dict(),
            "settings": asdict(self.settings),
            "focus_asked": self.focus,
            "pupil_m": asdict(self.pupil) if self.pupil else None,
            "compared": outputs.reference,
            "encoded": encoding.method,
            "encoding_bits": encoding.bits,
            "encoding_levels": encoding.levels and [each.to_dict() for each in encoding.levels],
            "encoding_display": encoding.display and [model.to_dict() for model in encoding.display],
            "rgbd": outputs.rgbd or None,  # None as in reports of versions that did not know them
            "light_field": outputs.light_field,
            "quilt": outputs.quilt and list(outputs.quilt),
            "encode_seconds": encoding.seconds,
            "eyebox": encoding.eyebox,
            "phases_before": encoding.before and encoding.before.parent.name,
            "contact_sheet": outputs.contact_sheet,
        }
