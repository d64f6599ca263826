"""Fit of a display and its camera to captures of known levels, through the propagation of light.

Levenberg-Marquardt least squares (Nocedal and Wright, Numerical Optimization, 2nd ed., section 10.3) of

    sum over captures and pixels of (predicted - captured)^2 / (captured + FLOOR)

from coarse to fine: pictures are compared blurred at first, which locates them, and sharp in the end. The Jacobian
is computed by finite differences, as there are few parameters, and used for two steps if the first one gains much:
scipy.optimize.least_squares, which computes one for each step, finds the same parameters in 1.3 times the seconds
(24 x 24 pixels, 32 captures, 28 November 2026).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
import scipy.ndimage

from ..engine.waves.display_model import GRID, MIN_CROSSTALK, DisplayLight, DisplayModel
from ..engine.waves.gaussian_points import FIFTH, SEVENTH
from .sensor import Sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..engine.pixels import Pitch
    from ..engine.progress import Progress

# Captures to compare, in rounds of all foci, 0 for all; blur of the pictures, camera pixels; maximum number of steps;
# minimum relative gain of a step, 0 for that of the noise
STAGES = (
    (2, 4.0, 6, 1e-4),
    (2, 2.0, 6, 1e-4),
    (10, 2.0, 8, 1e-4),
    (10, 1.0, 8, 1e-4),
    (8, 0.0, 8, 1e-4),
    (0, 0.0, 8, 0.0),
)
SIGN_STAGES = 2  # first stages, which both signs of the response pass: the better one goes on
NOISE_GAIN = 0.2  # times one parameter's noise in the loss: a step that gains less is the last
KNOTS = 8  # of the response, besides that of level 0
FLOOR = 0.02  # variance in units of values: noise that does not grow with light
DIFFERENCE = 2e-3  # of a parameter's range
MAX_DAMPING, MIN_DAMPING = 1e6, 1e-9
REUSE_GAIN = 0.1  # relative gain above which the Jacobian is used for another step
DRIFT, MIN_NOISE = 1.25, 1e-3  # times the noise that count as drift; noise that any camera has
MARGIN = 0.25  # of a range, by which a parameter may leave it


@dataclass(frozen=True)
class Parameter:
    """A parameter of the fit.

    Steps change the value to the power of `exponent`: pictures depend on the square of the source's extent, and a
    descent would stop at an extent of 0, where the slope vanishes.

    Attributes
    ----------
    name, unit : str
    low, high : float
        The typical range.
    part : str
        The part that it changes: ``pixels``, ``relay``, ``source`` or ``sensor``.
    first_stage : int
        The first of `STAGES` that fits it.
    minimum : float
        Physical lower bound.
    distance : float
        The only focus that it affects, meters; 0 for all.
    """

    name: str
    unit: str
    low: float
    high: float
    part: str
    first_stage: int
    minimum: float = -math.inf
    distance: float = 0.0

    @property
    def exponent(self) -> int:
        """Exponent of the value in steps of the fit."""
        return 2 if self.part == "source" else 1

    @property
    def span(self) -> float:
        """Range of the value to the power of `exponent`."""
        return self.high**self.exponent - self.low**self.exponent

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the fit: the range and a `MARGIN` on both sides, at least `minimum`."""
        room = MARGIN * (self.high - self.low)
        return max(self.minimum, self.low - room), self.high + room

    def step(self, value: float, fraction: float) -> float:
        """The value after a step by a fraction of `span`, at least the lower bound."""
        exponent = self.exponent
        return max(value**exponent + fraction * self.span, self.bounds[0] ** exponent) ** (1 / exponent)


@dataclass(frozen=True)
class Setup:
    """Parameters of a display and its camera.

    Attributes
    ----------
    model : DisplayModel
    knots : tuple of `KNOTS` floats
        Phase in radians of evenly spaced levels up to the highest; level 0 has phase 0.
    sensor : Sensor
    """

    model: DisplayModel
    knots: tuple
    sensor: Sensor

    def phases(self, bits: int) -> np.ndarray:
        """Phase of each level of `bits` bits, radians: a cubic spline through the knots."""
        from scipy.interpolate import CubicSpline  # here, as its import is slow

        at = np.linspace(0, 2**bits - 1, KNOTS + 1)
        return CubicSpline(at, (0.0, *self.knots), bc_type="natural")(np.arange(2**bits))


@dataclass(frozen=True)
class Capture:
    """Levels on the display, the focus in meters, and the camera's picture, values from 0 to 1."""

    levels: np.ndarray
    distance: float
    picture: np.ndarray


def even_knots(bits: int) -> tuple:
    """Knots of an ideal display: even steps of a turn."""
    return tuple(2 * math.pi * (1 - 2.0**-bits) * np.arange(1, KNOTS + 1) / KNOTS)


def parameters(start: Setup) -> list[Parameter]:
    """The parameters of the fit from a start, in the order of `vector`."""
    rows = [
        Parameter("position x", "half sides", -0.3, 0.3, "pixels", 2),
        Parameter("position y", "half sides", -0.3, 0.3, "pixels", 2),
        Parameter("falloff", "per square half side", 0.05, 0.5, "pixels", 2, 0.0),
        Parameter("tilt x", "rad", -4e-3, 4e-3, "pixels", 3),
        Parameter("tilt y", "rad", -4e-3, 4e-3, "pixels", 3),
        Parameter("source size", "rad", 0.05e-3, 0.5e-3, "source", 4, 0.0),
        Parameter("bandwidth", "m", 0.5e-9, 12e-9, "source", 4, 0.0),
        Parameter("unmodulated, real", "", -0.25, 0.25, "pixels", 2),
        Parameter("unmodulated, imaginary", "", -0.25, 0.25, "pixels", 2),
        Parameter("crosstalk", "pixels", 0.2, 0.8, "pixels", 4, MIN_CROSSTALK),
    ]
    rows += [Parameter(f"Zernike {j}", "rad", -0.5, 0.5, "relay", 3) for j in range(4, 12)]
    for way in ("across", "down"):
        rows += [
            Parameter(f"Zernike {j} {way}", "rad per half side", -0.25, 0.25, "relay", 3) for j in range(4, 7)
        ]
    falling = start.knots[-1] < 0
    for k in range(1, KNOTS + 1):
        full = 2 * math.pi * k / KNOTS
        ends = 0.75 * full - 0.5, 1.15 * full + 0.5
        low, high = (-ends[1], -ends[0]) if falling else ends
        rows.append(Parameter(f"response {k}/{KNOTS}", "rad", low, high, "pixels", 2))
    rows += [
        Parameter("gain", "", 0.2, 0.5, "sensor", 0, 0.0),
        Parameter("black", "", 0.0, 0.06, "sensor", 0, 0.0),
        Parameter("gamma", "", 0.85, 1.2, "sensor", 4, 0.5),
    ]
    kinds = {"a": (0.04, 1), "b": (0.04, 1), "c": (0.1, 0), "d": (0.04, 1), "e": (0.04, 1), "f": (0.1, 0)}
    kinds |= {"g": (0.02, 4), "h": (0.02, 4)}
    for distance, middle in start.sensor.homographies.items():
        for value, (name, (span, since)) in zip(middle, kinds.items(), strict=True):
            name = f"homography {name} at {distance * 1e3:g} mm"
            rows.append(Parameter(name, "", value - span, value + span, "sensor", since, -math.inf, distance))
    return rows


def vector(setup: Setup) -> np.ndarray:
    """The parameters' values of a setup; homographies are those of a beam without tilt, see `_along`."""
    model, sensor = setup.model, setup.sensor
    light = (
        *model.position, model.falloff, *model.tilt, model.size, model.bandwidth,
        model.unmodulated.real, model.unmodulated.imag, model.crosstalk,
        *model.aberrations, *model.across, *model.down,
    )  # fmt: skip
    matrices = [_along(row, distance, model, -1) for distance, row in sensor.homographies.items()]
    return np.array([*light, *setup.knots, sensor.gain, sensor.black, sensor.gamma, *np.ravel(matrices)])


def setup_of(values: np.ndarray, start: Setup) -> Setup:
    """The inverse of `vector`; `start` has what is not fitted."""
    remaining = iter(map(float, values))

    def take(count):
        return tuple(islice(remaining, count))

    position, (falloff,), tilt = take(2), take(1), take(2)
    size, bandwidth, real, imaginary, crosstalk = take(5)
    model = DisplayModel(
        start.model.wavelength, position, falloff, tilt, size, bandwidth, complex(real, imaginary), crosstalk,
        take(8), take(3), take(3),
    )  # fmt: skip
    knots, (gain, black, gamma) = take(KNOTS), take(3)
    model = replace(model, half=start.model.half)
    matrices = {distance: _along(take(8), distance, model, 1) for distance in start.sensor.homographies}
    return Setup(model, knots, Sensor(start.sensor.shape, gain, black, gamma, matrices))


def _along(matrix, distance, model, sign):
    """Add (sign 1) or remove (-1) the beam's sideways path in a homography: the fit cannot tell them apart."""
    x, y = (sign * distance * sine / model.half for sine in model.tilt)
    a, b, c, d, e, f, g, h = matrix
    return a + x * g, b + x * h, c + x, d + y * g, e + y * h, f + y, g, h


class Prediction:
    """Prediction of the camera's pictures, and its derivatives by the parameters.

    Parameters
    ----------
    captures : sequence of Capture
        Captures to compare with.
    start : Setup
        The nominal setup.
    shape : (int, int)
        Rows and columns of the SLM.
    pitch : float or (float, float)
        Pixel pitch, meters.
    bits : int
        Bits of a level.
    blur : float
        Standard deviation, camera pixels, of the Gaussian that blurs pictures before they are compared.
    source : tuple
        See `DisplayLight`.
    """

    def __init__(
        self,
        captures: Sequence[Capture],
        start: Setup,
        shape: tuple[int, int],
        pitch: Pitch,
        bits: int,
        blur: float = 0.0,
        source: tuple = FIFTH,
    ) -> None:
        self._source = source
        self.captures, self.start, self.shape, self.pitch, self.bits = captures, start, shape, pitch, bits
        self.blur, self.parameters = blur, parameters(start)
        self._reach = max(start.sensor.homographies)
        self._pictures = np.array([self._blur(each.picture) for each in captures])
        self._weights = 1 / np.sqrt(self._pictures + FLOOR)
        deviations = self._weights * (self._pictures - self._pictures.mean())
        self.variance, self.size = float(np.mean(deviations**2)), deviations.size

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Errors of all pixels in units of their noise, float32, flat."""
        return self._predict(setup_of(values, self.start))[0].ravel()

    def jacobian(
        self, values: np.ndarray, numbers: Sequence[int], on_progress: Callable[[float], object]
    ) -> np.ndarray:
        """Derivatives of the residuals by steps of some parameters, shape (residual, parameter).

        Except for the source's own extent it is that of a point source, which takes a fifth of the time and is good
        enough for a direction. All columns share this light: otherwise near cancellations would be lost.

        Parameters
        ----------
        values : numpy.ndarray
            Values of all parameters.
        numbers : sequence of int
            Indices of the parameters to differentiate by.
        on_progress : callable
            ``on_progress(fraction)``, may raise `Cancelled`.
        """
        base = self._predict(setup_of(values, self.start))[0]
        point = self._predict(_point_source(setup_of(values, self.start)))
        columns = np.zeros((len(numbers), base.size), np.float32)
        for column, number in enumerate(numbers):
            on_progress(column / len(numbers))
            parameter = self.parameters[number]
            trial = values.copy()
            trial[number] = parameter.step(values[number], DIFFERENCE)
            setup = setup_of(trial, self.start)
            if parameter.part == "sensor":
                at = [k for k, c in enumerate(self.captures) if parameter.distance in (0.0, c.distance)]
                change = np.zeros_like(base)
                change[at] = self._errors(setup, point[2], at) - point[0][at]
            elif parameter.part == "source":
                change = self._predict(setup)[0] - base
            else:
                spectra = point[1] if parameter.part == "relay" else None
                change = self._predict(_point_source(setup), spectra)[0] - point[0]
            columns[column] = change.ravel() / DIFFERENCE
        return columns.T

    def _predict(self, setup, spectra=None):
        """Residuals, and the spectra and pictures behind them."""
        light = DisplayLight(setup.model, self.shape, self.pitch, self._reach, self._source)
        if spectra is None:
            phases = setup.phases(self.bits)
            spectra = [light.spectra(phases[each.levels]) for each in self.captures]
        pictures = [
            light.picture(each, capture.distance)
            for each, capture in zip(spectra, self.captures, strict=True)
        ]
        return self._errors(setup, pictures, range(len(pictures))), spectra, pictures

    def _errors(self, setup, pictures, at):
        """Residuals of the captures of some numbers."""
        errors = np.empty((len(at), *self._pictures.shape[1:]), np.float32)
        for error, number in zip(errors, at, strict=True):
            distance = self.captures[number].distance
            values = setup.sensor.predict(pictures[number], self.shape, GRID, distance, self.pitch)
            error[:] = self._weights[number] * (self._blur(np.minimum(values, 1)) - self._pictures[number])
        return errors

    def _blur(self, picture):
        return scipy.ndimage.gaussian_filter(picture, self.blur) if self.blur else picture


def _point_source(setup):
    return replace(setup, model=replace(setup.model, size=0.0, bandwidth=0.0))


def descend(
    prediction: Prediction,
    values: np.ndarray,
    numbers: Sequence[int],
    steps: int,
    tolerance: float,
    on_progress: Callable[[float, float], object],
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt minimization.

    Parameters
    ----------
    prediction : Prediction
    values : numpy.ndarray
        Values of all parameters to start at.
    numbers : sequence of int
        Indices of the parameters to fit.
    steps : int
        Maximum number of Jacobians.
    tolerance : float
        Relative gain of the last step.
    on_progress : callable
        ``on_progress(fraction, error)`` with the root mean square of the residuals, may raise `Cancelled`.

    Returns
    -------
    values, deviations : numpy.ndarray
        Values of all parameters, and standard deviations due to noise; infinite for those that are not fitted.
    """
    numbers, damping, step, reuse = list(numbers), 1e-3, 0, False
    matrix, normal = np.empty((0, 0), np.float32), np.empty((0, 0))
    errors = prediction.residuals(values)
    square = float(errors @ errors)
    while step < steps or reuse:
        if not reuse:
            error = math.sqrt(square / errors.size)
            matrix = prediction.jacobian(values, numbers, partial(_report, on_progress, step, steps, error))
            normal, step = (matrix.T @ matrix).astype(float), step + 1
        slope, before = (matrix.T @ errors).astype(float), square
        while damping < MAX_DAMPING:
            ridge = damping * np.diag(np.diag(normal) + MIN_DAMPING * normal.trace() / len(normal))
            trial = values.copy()
            for number, fraction in zip(numbers, np.linalg.solve(normal + ridge, slope), strict=True):
                parameter = prediction.parameters[number]
                trial[number] = min(parameter.step(values[number], -fraction), parameter.bounds[1])
            new_errors = prediction.residuals(trial)
            new = float(new_errors @ new_errors)
            if new < square:
                values, square, errors, damping = trial, new, new_errors, max(damping / 10, MIN_DAMPING)
                break
            if reuse:
                break
            damping *= 10
        gain = (before - square) / before
        if gain <= tolerance and not reuse:
            break
        reuse = gain > REUSE_GAIN
    freedom = max(1, errors.size - len(numbers))
    deviations = np.full(len(values), np.inf)
    fractions = np.sqrt(np.diag(np.linalg.pinv(normal)) * square / freedom)
    for number, fraction in zip(numbers, fractions, strict=True):
        deviations[number] = prediction.parameters[number].step(values[number], fraction) - values[number]
    return values, deviations


def _report(on_progress, step, steps, error, fraction):
    on_progress(step / steps + 1 / steps * fraction, error)


@dataclass(frozen=True)
class FitResult:
    """Result of a fit.

    Attributes
    ----------
    setup : Setup
    parameters : list of Parameter
    values, deviations : numpy.ndarray
        Values of the parameters, and their standard deviations due to noise.
    error : float
        Root mean square of the residuals.
    explained : float
        Fraction of the pictures' variance that the model explains.
    """

    setup: Setup
    parameters: list
    values: np.ndarray
    deviations: np.ndarray
    error: float
    explained: float


def fit(
    captures: Sequence[Capture],
    start: Setup,
    shape: tuple[int, int],
    pitch: Pitch,
    bits: int,
    progress: Progress | None = None,
) -> FitResult:
    """Fit a display and its camera to captures.

    Parameters
    ----------
    captures : sequence of Capture
        Captures of `patterns.patterns`, in their order.
    start : Setup
        The nominal setup; the sign of its response is fitted, too.
    shape : (int, int)
        Rows and columns of the SLM.
    pitch : float or (float, float)
        Pixel pitch, meters.
    bits : int
        Bits of a level.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.
    """
    progress = progress or (lambda done, message: None)
    prediction = Prediction(captures, start, shape, pitch, bits, source=SEVENTH)
    first, others = range(len(STAGES))[:SIGN_STAGES], range(len(STAGES))[SIGN_STAGES:]
    done, count = 0, 2 * len(first) + len(others)

    def stages(numbers, start, values):
        """The values after some stages, their deviations, and the mean square of the last residuals."""
        nonlocal done
        rows, foci = parameters(start), len(start.sensor.homographies)
        extent = [number for number, p in enumerate(rows) if p.part == "source"]
        deviations, square = np.full(len(values), np.inf), math.inf
        for stage in numbers:
            rounds, blur, steps, tolerance = STAGES[stage]
            fitted = [number for number, p in enumerate(rows) if p.first_stage <= stage]
            coherent = [number for number in extent if number not in fitted]
            trial = values.copy()
            trial[coherent] = 0  # faster
            source = SEVENTH if not (rounds or blur) else FIFTH
            some = Prediction(captures[: rounds * foci or None], start, shape, pitch, bits, blur, source)

            def on_progress(fraction, error, done=done):
                progress((done + fraction) / count, f"Fitting the display, {100 * error:.1f} % off")

            tolerance = tolerance or NOISE_GAIN / some.size
            trial, deviations = descend(some, trial, fitted, steps, tolerance, on_progress)
            values = values.copy()
            values[fitted] = trial[fitted]
            square, done = float(np.mean(some.residuals(trial) ** 2)), done + 1
        return values, deviations, square

    starts = start, replace(start, knots=tuple(-knot for knot in start.knots))
    tries = [(each, *stages(first, each, vector(each))) for each in starts]
    start, values, deviations, _ = min(tries, key=lambda each: each[-1])
    if others:
        values, deviations, _ = stages(others, start, values)
    errors = prediction.residuals(values)
    square = float(np.mean(errors**2))
    explained = 1 - square / prediction.variance
    setup = setup_of(values, start)
    return FitResult(setup, parameters(start), values, deviations, math.sqrt(square), explained)


def drift(captures: Sequence[Capture], references: Sequence[int]) -> tuple[int, int, float] | None:
    """Find the first change of a repeated picture by more than its noise.

    Parameters
    ----------
    captures : sequence of Capture
    references : sequence of int
        Numbers of the captures of one picture; the first two, taken in succession, give the noise.

    Returns
    -------
    (int, int, float) or None
        The last unchanged capture, the first changed one, and its difference in units of the noise.
    """
    first, again, *others = (np.asarray(captures[number].picture) for number in references)
    weights = 1 / np.sqrt((first + again) / 2 + FLOOR)
    noise = np.sqrt(np.mean((weights * (again - first)) ** 2))
    before = references[1]
    for number, picture in zip(references[2:], others, strict=True):
        off = np.sqrt(np.mean((weights * (picture - first)) ** 2)) / max(noise, MIN_NOISE)
        if off > DRIFT:
            return before, number, float(off)
        before = number
    return None
