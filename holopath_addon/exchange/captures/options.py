"""What the files of a capture do not say of themselves, and what is told where it is taken for granted."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ...engine import InvalidInput
from ...engine.scene.captured.picture import FIELD_OF_VIEW

if TYPE_CHECKING:
    from collections.abc import Iterable

    import mitsuba as mi

    from ...engine import Camera

ANOTHER_SHAPE = 0.01  # relative difference of aspects


@dataclass(frozen=True)
class CaptureOptions:
    """What the files of a capture do not say of themselves.

    Attributes
    ----------
    depth : str or None
        File of a picture's depth.
    depth_unit : str or None
        One of `UNITS`.
    depth_ends : sequence of float, or None
        Depths in meters of the inverse depths 0 and 1.
    depth_along : str or None
        One of `ALONG`: of what depths are distances. Default: the axis.
    fov : float or None
        Full horizontal field of view, degrees.
    axes : str or None
        One of `AXES`, of a point cloud.
    point_radius : float or None
        Meters.
    view_span : sequence of float, or None
        Distance from the first view to the last, to the right, and down where there are several rows, meters.
    view_focus : float or None
        Distance of the plane at which all views agree, meters.
    view_panel : float or None
        Distance of the panel that shows them, meters. Default: that at which they agree.
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
    def given(self) -> list[str]:
        """Names of those that are given."""
        return [each.name for each in fields(self) if getattr(self, each.name) is not None]

    def to_dict(self) -> dict:
        """JSON-able form of those that are given, with the depth file's whole path; see `from_dict`."""
        kept = {name: value for name, value in asdict(self).items() if value is not None}
        if self.depth is not None:
            kept["depth"] = str(Path(self.depth).absolute())
        return kept

    @classmethod
    def from_dict(cls, values: dict) -> CaptureOptions:
        """Inverse of `to_dict`."""
        known = {each.name for each in fields(cls)}
        kept = {name: value for name, value in values.items() if name in known}
        if "view_focus" in kept:
            kept["view_focus"] = float(kept["view_focus"])  # JSON has no infinity, so it is text there
        return cls(**kept)


@dataclass(frozen=True)
class CapturedScene:
    """A capture as a scene.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    notes : list of dict
        What was taken for granted: object, feature, effect, material.
    """

    scene: mi.Scene
    camera: Camera
    notes: list


def with_depth_beside(options: CaptureOptions, path: Path) -> CaptureOptions:
    """The options, with a depth file that is not there looked for beside the picture."""
    if options.depth is None or Path(options.depth).exists():
        return options
    return replace(options, depth=str(path.parent / Path(options.depth).name))


def refuse(options: CaptureOptions, names: Iterable[str], why: str) -> None:
    """Refuse options that are given and are not for such a file.

    Raises
    ------
    InvalidInput
    """
    for name in names:
        if name in options.given:
            raise InvalidInput(f"{why}: leave out --{name.replace('_', '-')}.")


def check_fov(options: CaptureOptions) -> None:
    """Refuse a field of view that no camera has.

    Raises
    ------
    InvalidInput
    """
    if options.fov is not None and not 0 < options.fov < 180:
        raise InvalidInput(f"The field of view must lie between 0 and 180 degrees, not {options.fov:g}.")


def fov_of(options: CaptureOptions) -> float:
    """The full horizontal field of view in radians, or the default."""
    return FIELD_OF_VIEW if options.fov is None else math.radians(options.fov)


def fov_note(path: Path, options: CaptureOptions) -> dict[str, str]:
    """What is told where nobody gave the field of view."""
    effect = "that of a 50 mm lens on 36 mm of film, for nothing else is said; --fov DEGREES for another one"
    return note(path, f"field of view of {math.degrees(fov_of(options)):.1f} degrees", effect)


def shape_notes(path: Path, own: tuple[int, int], size: tuple[int, int]) -> list[dict[str, str]]:
    """A note where a hologram of another shape does not show all of a picture of `own` width and height."""
    if abs(size[0] * own[1] / (size[1] * own[0]) - 1) <= ANOTHER_SHAPE:
        return []
    effect = (
        f"the hologram's {size[0]} x {size[1]} have another shape: the width of the view is kept; leave out "
        "--resolution and --display to see all"
    )
    return [note(path, f"{own[0]} x {own[1]} pixels", effect)]


def note(path: Path, feature: str, effect: str) -> dict[str, str]:
    """What is told of a file."""
    return {"object": path.name, "feature": feature, "effect": effect, "material": ""}
