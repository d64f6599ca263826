"""Calibration of a display by a camera: show patterns, capture them, and fit a model."""

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
from .fitting import Capture, FitResult, Setup, drift, even_knots, fit
from .patterns import patterns, references
from .sensor import Sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..engine.progress import Progress

CAPTURE_FRACTION = 0.3  # of the progress
MIN_EXPLAINED = 0.8  # fraction of the pictures' variance
CURVE_POINTS = 33  # of a measured response, interpolated linearly
# The center of the range that displays and cameras have
TYPICAL = {"falloff": 0.25, "size": 2e-4, "bandwidth": 4e-9, "crosstalk": 0.45}
TYPICAL_GAIN, TYPICAL_BLACK = 0.35, 0.02


@dataclass(frozen=True)
class PatternWindow:
    """The part of a device, in its center, on which patterns are shown.

    Attributes
    ----------
    side : int
        Pixels along each side.
    pitch : float or (float, float)
        Pixel pitch, meters.
    wavelength : float
        Meters.
    bits : int
        Bits of a level.
    """

    side: int
    pitch: Pitch
    wavelength: float
    bits: int = 8


def place_in_center(levels: np.ndarray, size: tuple[int, int], bits: int) -> np.ndarray:
    """Place levels in the center of a device.

    Around them is a checkerboard of half a turn, whose light the stop in the Fourier plane blocks.

    Parameters
    ----------
    levels : numpy.ndarray, integers, shape (y, x)
    size : (int, int)
        Width and height of the device, pixels.
    bits : int
        Bits of a level.

    Returns
    -------
    numpy.ndarray, shape (height, width)

    Raises
    ------
    InvalidInput
        If the levels do not fit.
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


def nominal_setup(
    window: PatternWindow, distances: Sequence[float], shape: tuple[int, int], view: Sequence[float]
) -> Setup:
    """The setup of an ideal display and camera, at which the fit starts.

    Parameters
    ----------
    window : PatternWindow
    distances : sequence of float
        Distances of the foci from the SLM, meters.
    shape : (int, int)
        Rows and columns of the camera's pictures.
    view : (float, float)
        Half of the camera's shorter side in half sides of the window, to the right and down; negative: mirrored.
    """
    model = DisplayModel(window.wavelength, half=window.side / 2 * min(axes(window.pitch)), **TYPICAL)
    matrix = (float(view[0]), 0.0, 0.0, 0.0, float(view[1]), 0.0, 0.0, 0.0)
    sensor = Sensor(shape, TYPICAL_GAIN, TYPICAL_BLACK, 1.0, dict.fromkeys(distances, matrix))
    return Setup(model, even_knots(window.bits), sensor)


def calibrate(
    capture: Callable[[np.ndarray, float], np.ndarray],
    window: PatternWindow,
    distances: Sequence[float],
    view: Sequence[float] = (1.0, 1.0),
    count: int = 64,
    seed: int = 0,
    progress: Progress | None = None,
) -> FitResult:
    """Show patterns, capture them, and fit a model of the display and its camera.

    Parameters
    ----------
    capture : callable
        ``capture(levels, distance)`` shows levels on the window, focuses the camera at a distance in meters, and
        returns its picture: values from 0 to 1, shape (y, x).
    window : PatternWindow
    distances : sequence of float
        Distances of at least two foci from the SLM, meters.
    view : (float, float)
        See `nominal_setup`.
    count : int
        Number of captures.
    seed : int
        Seed of the patterns.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    FitResult

    Raises
    ------
    InvalidInput
        If the display or the camera moved meanwhile, or the pictures do not fit the model.
    """
    progress = progress or (lambda done, message: None)
    if len(distances) < 2 or count < 10 * len(distances):
        raise InvalidInput(
            "Expected two or more foci and at least ten captures at each, got "
            f"{count} captures at {len(distances)} foci."
        )
    shape, captures = (window.side, window.side), []
    repeats = references(count)
    sequence = patterns(shape, window.bits, window.pitch, window.wavelength, distances, count, seed)
    for number, (levels, distance) in enumerate(sequence):
        progress(CAPTURE_FRACTION * number / count, f"Capture {number + 1} of {count}")
        picture = np.asarray(capture(levels, distance), np.float32)
        if captures and picture.shape != captures[0].picture.shape:
            raise InvalidInput("The camera's pictures differ in size. Take all of them at one resolution.")
        captures.append(Capture(levels, distance, picture))
        so_far = [each for each in repeats if each <= number]
        change = drift(captures, so_far) if number in repeats and len(so_far) > 2 else None
        if change is not None:
            raise InvalidInput(
                f"The bench changed between captures {change[0] + 1} and {change[1] + 1}: the same picture differs by "
                f"{change[2]:.1f} times its noise. Let the bench settle, and calibrate again."
            )
    extremes = {float(extreme(each.picture)) for each in captures for extreme in (np.min, np.max)}
    if len(extremes) == 1:
        raise InvalidInput(
            f"Expected captures of patterns, got {count} that are {extremes.pop():g} everywhere. Check the light "
            "source, the camera's exposure, and that it sees the SLM."
        )
    start = nominal_setup(window, distances, captures[0].picture.shape, view)
    progress = stage(progress, CAPTURE_FRACTION, 1.0)
    result = fit(captures, start, shape, window.pitch, window.bits, progress)
    if result.explained < MIN_EXPLAINED:
        raise InvalidInput(
            f"The model explains only {result.explained:.0%} of the pictures' variance. Check the foci, the pitch, the "
            "wavelength, --view, and that the camera's values are linear in light."
        )
    gamma = result.setup.sensor.gamma
    bounds = next(row.bounds for row in result.parameters if row.name == "gamma")
    if any(math.isclose(gamma, bound) for bound in bounds):
        raise InvalidInput(
            f"Expected captures that are linear in light, got the exponent {gamma:.3g}, where the fit's range ends. "
            "Switch gamma, tone curves and HDR of the camera off, or capture its raw values."
        )
    return result


def calibration_of(
    result: FitResult, window: PatternWindow, device: str = "", earlier: Calibration | None = None
) -> Calibration:
    """A `Calibration` of a fit, which keeps the fits of an earlier one at other wavelengths.

    Parameters
    ----------
    result : FitResult
    window : PatternWindow
        The window and wavelength of the fit.
    device : str
        Name of the device. Default: that of the earlier calibration.
    before : Calibration, optional
        An earlier calibration of the same device.
    """
    setup, wavelength = result.setup, window.wavelength
    levels = np.unique(np.round(np.linspace(0, 2**window.bits - 1, CURVE_POINTS)).astype(int))
    phases = setup.phases(window.bits)
    curve = tuple((int(level), float(phases[level])) for level in levels)
    others = [] if earlier is None else list(zip(earlier.models, earlier.sensors, strict=True))
    others = [pair for pair in others if not math.isclose(pair[0].wavelength, wavelength, rel_tol=1e-3)]
    pairs = sorted([*others, (setup.model, setup.sensor)], key=lambda pair: -pair[0].wavelength)
    responses = [] if earlier is None else list(earlier.responses)
    responses = [r for r in responses if not math.isclose(r.wavelength, wavelength, rel_tol=1e-3)]
    return Calibration(
        device or (earlier.device if earlier else ""),
        window.bits,
        earlier.size if earlier else None,
        responses=(*responses, Response(wavelength, curve=curve)),
        models=tuple(model for model, _ in pairs),
        sensors=tuple(sensor for _, sensor in pairs),
    )
