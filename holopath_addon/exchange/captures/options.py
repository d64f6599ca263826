"""Options of captures, and notes on their defaults."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ...engine import InvalidInput
from ...engine.scene.captured.picture import FIELD_OF_VIEW

if TYPE_CHECKING:
    from collections.abc import Iterable


ASPECT_TOLERANCE = 0.01  # relative difference of aspects


@dataclass(frozen=True)
class CaptureOptions:
    """Options of a capture, for information that its files lack.

    Attributes
    ----------
    depth : str or None
        File of a picture's depth.
    depth_unit : str or None
        Unit of the depths, one of `UNITS`.
    depth_ends : sequence of float, or None
        Depths in meters of the inverse depths 0 and 1.
    depth_along : str or None
        Direction of the depths, one of `ALONG`. Default: the camera's axis.
    fov : float or None
        Full horizontal field of view, degrees.
    axes : str or None
        Axes of a point cloud, one of `AXES`.
    point_radius : float or None
        Radius of the points of a point cloud, meters.
    view_span : sequence of float, or None
        Distance from the first viewpoint to the last, to the right, and down for several rows, meters.
    view_focus : float or None
        Distance of the plane at which all views agree, meters.
    view_panel : float or None
        Distance of the panel that shows the views, meters. Default: `view_focus`.
    """

    depth: str | None = None
    depth_unit: str | None = None
    depth_ends: tuple | None = None
    depth_along: str | None = None
    fov: float | None = None
    axes: str | None = None
    point_radius: float | None = None
    view_span: tuple | None = None
    view_focus: float | None = None
    view_panel: float | None = None

    @property
    def names(self) -> list[str]:
        """Names of the options that are set."""
        return [each.name for each in fields(self) if getattr(self, each.name) is not None]

    def to_dict(self) -> dict:
        """JSON form of the options that are set, with the depth file's absolute path; see `from_dict`."""
        values = {name: value for name, value in asdict(self).items() if value is not None}
        if self.depth is not None:
            values["depth"] = str(Path(self.depth).absolute())
        return values

    @classmethod
    def from_dict(cls, values: dict) -> CaptureOptions:
        """Options of the JSON form of `to_dict`."""
        names = {each.name for each in fields(cls)}
        values = {name: value for name, value in values.items() if name in names}
        if "view_focus" in values:
            values["view_focus"] = float(values["view_focus"])  # JSON has no infinity, which is a string
        return cls(**values)


def with_depth_beside(options: CaptureOptions, path: Path) -> CaptureOptions:
    """The options with the depth file beside the picture of a path, unless it exists elsewhere."""
    if options.depth is None or Path(options.depth).exists():
        return options
    return replace(options, depth=str(path.parent / Path(options.depth).name))


def refuse(options: CaptureOptions, names: Iterable[str], reason: str) -> None:
    """Refuse options of some names with a reason.

    Raises
    ------
    InvalidInput
    """
    for name in names:
        if name in options.names:
            raise InvalidInput(f"{reason}. Omit --{name.replace('_', '-')}.")


def check_fov(options: CaptureOptions) -> None:
    """Refuse a field of view that no camera can have.

    Raises
    ------
    InvalidInput
    """
    if options.fov is not None and not 0 < options.fov < 180:
        raise InvalidInput(f"The field of view must lie between 0 and 180 degrees, got {options.fov:g}.")


def fov_of(options: CaptureOptions) -> float:
    """Full horizontal field of view in radians: the option's, or the default."""
    return FIELD_OF_VIEW if options.fov is None else math.radians(options.fov)


def fov_note(path: Path, options: CaptureOptions) -> dict[str, str]:
    """A note on the default field of view."""
    effect = "the default, that of a 50 mm lens on 36 mm of film; use --fov DEGREES for another one"
    return note(path, f"field of view of {math.degrees(fov_of(options)):.1f} degrees", effect)


def shape_notes(path: Path, own: tuple[int, int], size: tuple[int, int]) -> list[dict[str, str]]:
    """A note, if a hologram of width and height `size` does not show all of a picture of width and height `own`."""
    if abs(size[0] * own[1] / (size[1] * own[0]) - 1) <= ASPECT_TOLERANCE:
        return []
    effect = (
        f"the hologram's {size[0]} x {size[1]} have another aspect: the width of the view stays; omit --resolution "
        "and --display to see all"
    )
    return [note(path, f"{own[0]} x {own[1]} pixels", effect)]


def note(path: Path, feature: str, effect: str) -> dict[str, str]:
    """A note on a file, for reports."""
    return {"object": path.name, "feature": feature, "effect": effect, "material": ""}
