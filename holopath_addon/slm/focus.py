"""Where the camera looks: planes at distances from the SLM, each with the motor's position that was found for it."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engine.errors import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..engine.progress import Progress

FORMAT, FORMAT_VERSION = "HoloPath focus planes", 1
CAMERA_PATIENCE = 60.0  # seconds that a camera's command may take


@dataclass(frozen=True)
class Plane:
    """One plane.

    Attributes
    ----------
    distance : float
        From the SLM, metres.
    position : int or None
        Of the motor, in its own steps; None: not calibrated yet.
    """

    distance: float
    position: int | None = None


@dataclass(frozen=True)
class FocusPlanes:
    """Planes in the order of their distances.

    Raises
    ------
    InvalidInput
        If there is none, or two have one distance.
    """

    planes: tuple

    def __post_init__(self):
        planes = tuple(sorted(self.planes, key=lambda plane: plane.distance))
        distances = [plane.distance for plane in planes]
        if not planes or not np.isfinite(distances).all() or len(set(distances)) < len(planes):
            raise InvalidInput("A list of focus planes has at least one, each at a distance of its own.")
        object.__setattr__(self, "planes", planes)

    @classmethod
    def spread(cls, first: float = 80e-3, last: float = 85e-3, count: int = 5) -> FocusPlanes:
        """Even steps; by default those of the paper's prototype, 80 to 85 mm in steps of 1.25 mm (section 5)."""
        if count < 1 or (count > 1 and last <= first):
            raise InvalidInput("Focus planes run from a nearer to a farther distance, and are one or more.")
        return cls(tuple(Plane(round(float(z), 9)) for z in np.linspace(first, last, count)))

    def calibrated(self, number: int, position: int) -> FocusPlanes:
        """These planes, one of them with the position at which the camera was seen to be in focus."""
        self._check(number)
        planes = list(self.planes)
        planes[number] = replace(planes[number], position=int(position))
        return FocusPlanes(tuple(planes))

    def position(self, number: int) -> int:
        """Of the motor for a plane.

        Raises
        ------
        InvalidInput
            If there is no such plane, or it is not calibrated.
        """
        self._check(number)
        plane = self.planes[number]
        if plane.position is None:
            raise InvalidInput(
                f"Focus plane {number} ({plane.distance * 1e3:g} mm) has no position yet: focus the camera there, then "
                "store where the motor is."
            )
        return plane.position

    def position_at(self, distance: float) -> int:
        """Of the motor for any distance between calibrated planes, on the line between the two nearest.

        Raises
        ------
        InvalidInput
            If it lies outside them.
        """
        known = [plane for plane in self.planes if plane.position is not None]
        if not known or not known[0].distance - 1e-9 <= distance <= known[-1].distance + 1e-9:
            within = (
                f"{known[0].distance * 1e3:g} to {known[-1].distance * 1e3:g} mm"
                if known
                else "none is calibrated"
            )
            raise InvalidInput(
                f"The distance {distance * 1e3:g} mm lies outside the calibrated planes ({within})."
            )
        return round(float(np.interp(distance, [p.distance for p in known], [p.position for p in known])))

    def _check(self, number):
        if not 0 <= number < len(self.planes):
            raise InvalidInput(f"There is no focus plane {number}: they are 0 to {len(self.planes) - 1}.")

    def save(self, path: Path | str) -> None:
        """Write a JSON file.

        Raises
        ------
        OSError
        """
        path = Path(path)
        said = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "planes": [
                {"distance_mm": round(p.distance * 1e3, 6), "position": p.position} for p in self.planes
            ],
        }
        part = path.with_name(f".part-{path.name}")
        part.write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")
        os.replace(part, path)

    @classmethod
    def load(cls, path: Path | str) -> FocusPlanes:
        """Read what `save` wrote.

        Raises
        ------
        InvalidInput
        """
        try:
            said = json.loads(Path(path).read_text(encoding="utf-8"))
            if said["format"] != FORMAT or said["format_version"] != FORMAT_VERSION:
                raise ValueError("another format, or a newer one")
            return cls(tuple(_plane(row) for row in said["planes"]))
        except InvalidInput as error:
            raise InvalidInput(f"The focus planes {path}: {error}") from None
        except Exception as error:  # there is no end to what a file may hold
            raise InvalidInput(
                f"The focus planes {path} cannot be read ({error}): see docs/slm.md."
            ) from None


def _plane(row):
    position = row.get("position")
    return Plane(float(row["distance_mm"]) * 1e-3, None if position is None else int(position))


def sweep(
    planes: FocusPlanes,
    move: Callable[[int], None],
    capture: Callable[[int], Any],
    progress: Progress | None = None,
) -> None:
    """Look at every plane in turn.

    Parameters
    ----------
    planes : FocusPlanes
    move : callable
        ``move(number)`` moves the camera's focus to a plane and returns when it stands.
    capture : callable
        ``capture(number)`` takes a picture, whatever the camera: the hook for a user's own.
    progress : callable, optional
        ``progress(done, message)``, may raise `engine.Cancelled`.
    """
    for number, plane in enumerate(planes.planes):
        if progress is not None:
            progress(number / len(planes.planes), f"Focus at {plane.distance * 1e3:g} mm")
        move(number)
        capture(number)


def run_camera(command: str, file: Path, number: int, distance: float) -> None:
    """Have a user's own program take a picture.

    Parameters
    ----------
    command : str
        Words as in a shell, though none is used; ``{file}``, ``{plane}`` and ``{mm}`` stand for the arguments below.
    file : pathlib.Path
        Where it writes the picture.
    number : int
        Of the focus plane.
    distance : float
        Of it, metres.

    Raises
    ------
    InvalidInput
        If it does not run, fails, or writes nothing.
    """
    try:
        split = shlex.split(command, posix=os.name != "nt")  # Windows has backslashes in its paths
        words = [word.strip('"').format(file=file, plane=number, mm=f"{distance * 1e3:g}") for word in split]
        Path(file).unlink(missing_ok=True)
        done = subprocess.run(
            words, capture_output=True, text=True, errors="replace", timeout=CAMERA_PATIENCE, check=False,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )  # fmt: skip
    except (OSError, LookupError, AttributeError, ValueError, subprocess.TimeoutExpired) as error:
        raise InvalidInput(
            f"The camera's command `{command}` does not run ({error}): see docs/slm.md."
        ) from error
    if done.returncode != 0 or not Path(file).exists():
        said = (done.stderr.strip().splitlines() or ["it wrote no file"])[-1]
        raise InvalidInput(f"The camera's command `{command}` took no picture at plane {number}: {said}.")
