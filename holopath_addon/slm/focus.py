"""Focus planes of the camera: distances from the SLM, each with its calibrated motor position."""

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
CAMERA_TIMEOUT = 60.0  # seconds that a camera's command may take


@dataclass(frozen=True)
class Plane:
    """A focus plane.

    Attributes
    ----------
    distance : float
        Distance from the SLM, meters.
    position : int or None
        Position of the motor, in its own steps; None where it is not calibrated.
    """

    distance: float
    position: int | None = None


@dataclass(frozen=True)
class FocusPlanes:
    """Focus planes in the order of their distances.

    Parameters
    ----------
    planes : tuple of Plane
        In any order.

    Raises
    ------
    InvalidInput
        If there is none, or two have the same distance.
    """

    planes: tuple

    def __post_init__(self):
        planes = tuple(sorted(self.planes, key=lambda plane: plane.distance))
        distances = [plane.distance for plane in planes]
        if not planes or not np.isfinite(distances).all() or len(set(distances)) < len(planes):
            raise InvalidInput("Expected one or more focus planes, each at a different finite distance.")
        object.__setattr__(self, "planes", planes)

    @classmethod
    def spread(cls, first: float = 80e-3, last: float = 85e-3, count: int = 5) -> FocusPlanes:
        """Evenly spaced planes; by default those of the paper's prototype (section 5).

        Parameters
        ----------
        first, last : float
            Distances of the first and the last plane, meters.
        count : int
            Number of planes.

        Raises
        ------
        InvalidInput
        """
        if count < 1 or (count > 1 and last <= first):
            raise InvalidInput(
                "Expected one or more focus planes from a nearer to a farther distance, got "
                f"{count} from {first * 1e3:g} to {last * 1e3:g} mm."
            )
        return cls(tuple(Plane(round(float(z), 9)) for z in np.linspace(first, last, count)))

    def with_position(self, number: int, position: int) -> FocusPlanes:
        """These planes, with a new motor position of one of them.

        Parameters
        ----------
        number : int
            Index of the plane.
        position : int
            Motor position at which the camera is in focus.

        Raises
        ------
        InvalidInput
            If there is no such plane.
        """
        self._check(number)
        planes = list(self.planes)
        planes[number] = replace(planes[number], position=int(position))
        return FocusPlanes(tuple(planes))

    def position(self, number: int) -> int:
        """Motor position of the plane of an index.

        Raises
        ------
        InvalidInput
            If there is no such plane, or it is not calibrated.
        """
        self._check(number)
        plane = self.planes[number]
        if plane.position is None:
            raise InvalidInput(
                f"Focus plane {number} ({plane.distance * 1e3:g} mm) has no motor position yet. Focus the camera "
                "there, then store the position."
            )
        return plane.position

    def position_at(self, distance: float) -> int:
        """Motor position at a distance in meters, interpolated linearly between calibrated planes.

        Raises
        ------
        InvalidInput
            If the distance lies outside the calibrated planes.
        """
        usable = [plane for plane in self.planes if plane.position is not None]
        if not usable or not usable[0].distance - 1e-9 <= distance <= usable[-1].distance + 1e-9:
            within = (
                f"{usable[0].distance * 1e3:g} to {usable[-1].distance * 1e3:g} mm"
                if usable
                else "none is calibrated"
            )
            raise InvalidInput(
                f"Expected a distance within the calibrated planes ({within}), got {distance * 1e3:g} mm."
            )
        return round(float(np.interp(distance, [p.distance for p in usable], [p.position for p in usable])))

    def _check(self, number):
        if not 0 <= number < len(self.planes):
            raise InvalidInput(f"Expected a focus plane from 0 to {len(self.planes) - 1}, got {number}.")

    def save(self, path: Path | str) -> None:
        """Write a JSON file.

        Raises
        ------
        OSError
        """
        path = Path(path)
        data = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "planes": [
                {"distance_mm": round(p.distance * 1e3, 6), "position": p.position} for p in self.planes
            ],
        }
        part = path.with_name(f".part-{path.name}")
        part.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
        os.replace(part, path)

    @classmethod
    def load(cls, path: Path | str) -> FocusPlanes:
        """Read what `save` wrote.

        Raises
        ------
        InvalidInput
        """
        try:
            data = json.loads(Path(path).read_text(encoding="utf-8"))
            if data["format"] != FORMAT or data["format_version"] != FORMAT_VERSION:
                raise ValueError("another format, or a newer version")
            return cls(tuple(_plane(row) for row in data["planes"]))
        except InvalidInput as error:
            raise InvalidInput(f"The focus planes {path}: {error}") from None
        except Exception as error:  # a file may hold anything
            raise InvalidInput(
                f"The focus planes {path} cannot be read ({error}). See docs/slm.md."
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
    """Focus on each plane in turn and take a picture.

    Parameters
    ----------
    planes : FocusPlanes
    move : callable
        ``move(number)`` moves the camera's focus to a plane and returns when the motor has stopped.
    capture : callable
        ``capture(number)`` takes a picture by any camera.
    progress : callable, optional
        ``progress(done, message)``, may raise `engine.Cancelled`.
    """
    for number, plane in enumerate(planes.planes):
        if progress is not None:
            progress(number / len(planes.planes), f"Focus at {plane.distance * 1e3:g} mm")
        move(number)
        capture(number)


def run_camera(command: str, file: Path, number: int, distance: float) -> None:
    """Run a user's own program that takes a picture.

    Parameters
    ----------
    command : str
        Words quoted as in a shell, though none is used; ``{file}``, ``{plane}`` and ``{mm}`` stand for the arguments
        below.
    file : pathlib.Path
        The picture that it writes.
    number : int
        Index of the focus plane.
    distance : float
        Distance of the plane, meters.

    Raises
    ------
    InvalidInput
        If the program does not run, fails, or writes no file.
    """
    try:
        split = shlex.split(command, posix=os.name != "nt")  # Windows has backslashes in its paths
        words = [word.strip('"').format(file=file, plane=number, mm=f"{distance * 1e3:g}") for word in split]
        Path(file).unlink(missing_ok=True)
        done = subprocess.run(
            words, capture_output=True, text=True, errors="replace", timeout=CAMERA_TIMEOUT, check=False,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )  # fmt: skip
    except (OSError, LookupError, AttributeError, ValueError, subprocess.TimeoutExpired) as error:
        raise InvalidInput(
            f"The camera's command `{command}` does not run ({error}). See docs/slm.md."
        ) from error
    if done.returncode != 0 or not Path(file).exists():
        reason = (done.stderr.strip().splitlines() or ["it wrote no file"])[-1]
        raise InvalidInput(f"The camera's command `{command}` took no picture at plane {number}: {reason}.")
