"""From a display and a camera to a calibration file: patterns are shown, looked at, and fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..engine.errors import InvalidInput
from ..engine.pixels import Pitch, axes
from ..engine.progress import stage
from ..engine.waves.display_model import DisplayModel
from .calibration import Calibration, Response
from .fitting import Capture, Fitted, Setup, drift, even_knots, fit
from .patterns import patterns, references
from .sensor import Sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..engine.progress import Progress

LOOKING = 0.3  # of the progress
LEAST_EXPLAINED = 0.8  # of the variance of pictures
POINTS = 33  # of a measured curve, between which lines are drawn
USUAL = {
    "falloff": 0.25,
    "size": 2e-4,
    "bandwidth": 4e-9,
    "crosstalk": 0.45,
}  # the middle of what displays have
GAIN, BLACK = 0.35, 0.02


@dataclass(frozen=True)
class PatternWindow:
    """The part of a device on which patterns are shown, in its middle.

    Attributes
    ----------
    side : int
        Pixels.
    pitch : float or (float, float)
    wavelength : float
        Metres.
    bits : int
        Of a level.
    """

    side: int
    pitch: Pitch
    wavelength: float
    bits: int = 8


def placed(levels: np.ndarray, size: tuple[int, int], bits: int) -> np.ndarray:
    """Levels in the middle of a device of a width and height.

    Around them is a checkerboard of half a turn, whose light the stop in the Fourier plane takes away.

    Raises
    ------
    InvalidInput
        If they do not fit.
    """
    width, height = size
    rows, columns = levels.shape
    if columns > width or rows > height:
        raise InvalidInput(
            f"The device has {width} x {height} pixels: choose a window of no more than {min(size)}."
        )
    y, x = np.indices((height, width))
    whole = ((x + y) % 2 * 2 ** (bits - 1)).astype(levels.dtype)
    top, left = (height - rows) // 2, (width - columns) // 2
    whole[top : top + rows, left : left + columns] = levels
    return whole


def nominal(
    window: PatternWindow, distances: Sequence[float], shape: tuple[int, int], view: Sequence[float]
) -> Setup:
    """What a display and its camera are meant to be.

    Parameters
    ----------
    window : PatternWindow
    distances : sequence of float
        Of the foci from the SLM, metres.
    shape : (int, int)
        Rows and columns of the camera's pictures.
    view : (float, float)
        What half the camera's shorter side sees of the window's, to the right and down; negative: mirrored.
    """
    model = DisplayModel(window.wavelength, half=window.side / 2 * min(axes(window.pitch)), **USUAL)
    matrix = (float(view[0]), 0.0, 0.0, 0.0, float(view[1]), 0.0, 0.0, 0.0)
    sensor = Sensor(shape, GAIN, BLACK, 1.0, dict.fromkeys(distances, matrix))
    return Setup(model, even_knots(window.bits), sensor)


def calibrate(
    look: Callable[[np.ndarray, float], np.ndarray],
    window: PatternWindow,
    distances: Sequence[float],
    view: Sequence[float] = (1.0, 1.0),
    count: int = 64,
    seed: int = 0,
    progress: Progress | None = None,
) -> Fitted:
    """Show patterns, look at them, and find what the display and its camera are.

    Parameters
    ----------
    look : callable
        ``look(levels, distance)`` shows levels on the window, focuses at a distance and gives the camera's picture,
        values of 0 to 1, shape (y, x).
    window : PatternWindow
    distances : sequence of float
        Of at least two foci from the SLM, metres.
    view : (float, float)
        See `nominal`.
    count : int
        Of captures.
    seed : int
        Of the patterns.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.

    Raises
    ------
    InvalidInput
        If the display or the camera moved meanwhile, or pictures do not fit the model at all.
    """
    progress = progress or (lambda done, message: None)
    if len(distances) < 2 or count < 10 * len(distances):
        raise InvalidInput(
            f"A calibration needs two foci or more, and ten captures at each: not {count} at {len(distances)}."
        )
    shape, captures = (window.side, window.side), []
    known = references(count)
    shown = patterns(shape, window.bits, window.pitch, window.wavelength, distances, count, seed)
    for number, (levels, distance) in enumerate(shown):
        progress(LOOKING * number / count, f"Capture {number + 1} of {count}")
        picture = np.asarray(look(levels, distance), np.float32)
        if captures and picture.shape != captures[0].picture.shape:
            raise InvalidInput("The camera's pictures differ in size: let it take all alike.")
        captures.append(Capture(levels, distance, picture))
        so_far = [each for each in known if each <= number]
        moved = drift(captures, so_far) if number in known and len(so_far) > 2 else None
        if moved is not None:
            raise InvalidInput(
                f"The bench changed between captures {moved[0] + 1} and {moved[1] + 1}: the same picture is off by "
                f"{moved[2]:.1f} times its noise. Let it come to rest, and calibrate again."
            )
    start = nominal(window, distances, captures[0].picture.shape, view)
    found = fit(captures, start, shape, window.pitch, window.bits, stage(progress, LOOKING, 1.0))
    if found.explained < LEAST_EXPLAINED:
        raise InvalidInput(
            f"The model explains only {found.explained:.0%} of what the camera saw: check the foci, the pitch, the "
            "wavelength, and what the camera sees of the window."
        )
    return found


def calibration_of(
    found: Fitted, window: PatternWindow, device: str = "", before: Calibration | None = None
) -> Calibration:
    """A `Calibration` of what was found, with what was found earlier at other wavelengths.

    Parameters
    ----------
    found : Fitted
    window : PatternWindow
    device : str
    before : Calibration, optional
    """
    setup, wavelength = found.setup, window.wavelength
    levels = np.unique(np.round(np.linspace(0, 2**window.bits - 1, POINTS)).astype(int))
    phases = setup.phases(window.bits)
    curve = tuple((int(level), float(phases[level])) for level in levels)
    others = [] if before is None else list(zip(before.models, before.sensors, strict=True))
    others = [pair for pair in others if not math.isclose(pair[0].wavelength, wavelength, rel_tol=1e-3)]
    fitted = sorted([*others, (setup.model, setup.sensor)], key=lambda pair: -pair[0].wavelength)
    responses = [] if before is None else list(before.responses)
    responses = [r for r in responses if not math.isclose(r.wavelength, wavelength, rel_tol=1e-3)]
    return Calibration(
        device or (before.device if before else ""),
        window.bits,
        before.size if before else None,
        responses=(*responses, Response(wavelength, curve=curve)),
        models=tuple(model for model, _ in fitted),
        sensors=tuple(sensor for _, sensor in fitted),
    )
