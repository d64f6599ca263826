"""A display and its camera found from captures of known levels: descent through the light's own propagation.

Levenberg and Marquardt's least squares (Nocedal and Wright, Numerical Optimization, 2nd ed., section 10.3) of

    sum over captures and pixels of (predicted - captured)^2 / (captured + FLOOR)

from coarse to fine: pictures are first compared blurred, which tells where they lie, and then as they are. The
Jacobian is by differences, as there are few parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import scipy.ndimage

from ..engine.waves.display_model import GRID, LEAST_CROSSTALK, DisplayLight, DisplayModel
from ..engine.waves.gaussian_points import FIFTH, SEVENTH
from .sensor import Sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..engine.pixels import Pitch
    from ..engine.progress import Progress

# Captures that are looked at, in turns of all foci, 0 for all; the blur of pictures, camera pixels; most steps; and the
# share of the loss that a step must gain; 0 in the end, where noise says it.
STAGES = (
    (2, 4.0, 6, 1e-4),
    (2, 2.0, 6, 1e-4),
    (10, 2.0, 8, 1e-4),
    (10, 1.0, 8, 1e-4),
    (8, 0.0, 8, 1e-4),
    (0, 0.0, 8, 0.0),
)
SIGN_STAGES = 2  # of them tell whether the phase rises or falls with the level: both are tried
NOISE = 0.2  # of one parameter's noise, in the loss: a step that gains less is the last
KNOTS = 8  # of the response, beside that of level 0
FLOOR = 0.02  # of values: noise that does not grow with light
DIFFERENCE = 2e-3  # of a parameter's range
MOST_DAMPING, LEAST = 1e6, 1e-9  # of Levenberg's and Marquardt's steps
KEPT = 0.1  # of the loss: as long as a step gains as much, the Jacobian is kept
DRIFT, LEAST_NOISE = 1.25, 1e-3  # times the noise that is drift; noise that any camera has
BEYOND = 0.25  # of a range, how far out of it a parameter may be found


@dataclass(frozen=True)
class Parameter:
    """One number that is fitted.

    Attributes
    ----------
    name, unit : str
    low, high : float
        Its range.
    part : str
        What it changes: ``pixels``, ``relay``, ``source`` or ``sensor``.
    since : int
        The stage of `STAGES` from which on it is fitted.
    least : float
        What it cannot be below.
    distance : float
        The only focus at which it counts, metres; 0: at all.

    Steps are taken of its `power`: pictures change with the square of the source's extent, whose own slope ends at 0,
    and would hold a descent there.
    """

    name: str
    unit: str
    low: float
    high: float
    part: str
    since: int
    least: float = -math.inf
    distance: float = 0.0

    @property
    def power(self) -> int:
        return 2 if self.part == "source" else 1

    @property
    def span(self) -> float:
        """Range of its power."""
        return self.high**self.power - self.low**self.power

    @property
    def reach(self) -> tuple[float, float]:
        """Between what it may be found: `BEYOND` its range, and not below `least`."""
        room = BEYOND * (self.high - self.low)
        return max(self.least, self.low - room), self.high + room

    def moved(self, value: float, share: float) -> float:
        """The value whose power is a share of `span` more; not below its reach."""
        return max(value**self.power + share * self.span, self.reach[0] ** self.power) ** (1 / self.power)


@dataclass(frozen=True)
class Setup:
    """A display and its camera.

    Attributes
    ----------
    model : DisplayModel
    knots : tuple of `KNOTS` floats
        Phase in radians of evenly spaced levels, up to the highest; that of level 0 is 0.
    sensor : Sensor
    """

    model: DisplayModel
    knots: tuple
    sensor: Sensor

    def phases(self, bits: int) -> np.ndarray:
        """Phase of each level, radians: a cubic spline through the knots."""
        from scipy.interpolate import CubicSpline  # late, as it takes long to load

        at = np.linspace(0, 2**bits - 1, KNOTS + 1)
        return CubicSpline(at, (0.0, *self.knots), bc_type="natural")(np.arange(2**bits))


@dataclass(frozen=True)
class Capture:
    """Levels that were shown, the focus, and what the camera then saw, values of 0 to 1."""

    levels: np.ndarray
    distance: float
    picture: np.ndarray


def even_knots(bits: int) -> tuple:
    """Of an ideal display: even steps of a turn."""
    return tuple(2 * math.pi * (1 - 2.0**-bits) * np.arange(1, KNOTS + 1) / KNOTS)


def parameters(start: Setup) -> list[Parameter]:
    """What is fitted, in the order of `vector`."""
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
        Parameter("crosstalk", "pixels", 0.2, 0.8, "pixels", 4, LEAST_CROSSTALK),
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
    """The parameters' values; homographies are those of what lies where the beam would go if it had no tilt."""
    model, sensor = setup.model, setup.sensor
    light = (
        *model.position, model.falloff, *model.tilt, model.size, model.bandwidth,
        model.unmodulated.real, model.unmodulated.imag, model.crosstalk,
        *model.aberrations, *model.across, *model.down,
    )  # fmt: skip
    matrices = [_along(row, distance, model, -1) for distance, row in sensor.homographies.items()]
    return np.array([*light, *setup.knots, sensor.gain, sensor.black, sensor.gamma, *np.ravel(matrices)])


def setup_of(values: np.ndarray, start: Setup) -> Setup:
    """The reverse of `vector`; what is not fitted is that of `start`."""
    left = list(map(float, values))

    def take(count):
        taken = tuple(left[:count])
        del left[:count]
        return taken

    position, (falloff,), tilt, (size, bandwidth, real, imaginary, crosstalk) = (
        take(2),
        take(1),
        take(2),
        take(5),
    )
    model = DisplayModel(
        start.model.wavelength, position, falloff, tilt, size, bandwidth, complex(real, imaginary), crosstalk,
        take(8), take(3), take(3),
    )  # fmt: skip
    knots, (gain, black, gamma) = take(KNOTS), take(3)
    model = replace(model, half=start.model.half)
    matrices = {distance: _along(take(8), distance, model, 1) for distance in start.sensor.homographies}
    return Setup(model, knots, Sensor(start.sensor.shape, gain, black, gamma, matrices))


def _along(matrix, distance, model, sign):
    """A homography, with or without the way to the side that the beam goes: fitted without, as both look alike."""
    x, y = (sign * distance * sine / model.half for sine in model.tilt)
    a, b, c, d, e, f, g, h = matrix
    return a + x * g, b + x * h, c + x, d + y * g, e + y * h, f + y, g, h


class Prediction:
    """What the camera should see, and how that changes with the parameters.

    Parameters
    ----------
    captures : sequence of Capture
    start : Setup
    shape : (int, int)
        Rows and columns of the SLM.
    pitch : float or (float, float)
        Metres.
    bits : int
        Of a level.
    blur : float
        Standard deviation, camera pixels, of a Gaussian by which pictures are compared.
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
        self._seen = np.array([self._blurred(each.picture) for each in captures])
        self._weights = 1 / np.sqrt(np.array([each.picture for each in captures]) + FLOOR)
        if blur:
            self._weights = 1 / np.sqrt(self._seen + FLOOR)
        weighted = self._weights * (self._seen - self._seen.mean())
        self.variance, self.size = float(np.mean(weighted**2)), weighted.size

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Errors by their noise, float32, flat."""
        return self._look(setup_of(values, self.start))[0].ravel()

    def jacobian(
        self, values: np.ndarray, chosen: Sequence[int], told: Callable[[float], object]
    ) -> np.ndarray:
        """Change of the residuals with each chosen parameter's power over its range, shape (residual, chosen).

        It is that of light of the source's middle, but for the source's own extent: it only points the way,
        and takes a fifth of the time. All are of the same light, or what nearly cancels would not.
        """
        base = self._look(setup_of(values, self.start))[0]
        middle = self._look(_without_extent(setup_of(values, self.start)))
        columns = np.zeros((len(chosen), base.size), np.float32)
        for column, number in enumerate(chosen):
            told(column / len(chosen))
            parameter = self.parameters[number]
            moved = values.copy()
            moved[number] = parameter.moved(values[number], DIFFERENCE)
            setup = setup_of(moved, self.start)
            if parameter.part == "sensor":
                at = [k for k, c in enumerate(self.captures) if parameter.distance in (0.0, c.distance)]
                change = np.zeros_like(base)
                change[at] = self._errors(setup, middle[2], at) - middle[0][at]
            elif parameter.part == "source":
                change = self._look(setup)[0] - base
            else:
                spectra = middle[1] if parameter.part == "relay" else None
                change = self._look(_without_extent(setup), spectra)[0] - middle[0]
            columns[column] = change.ravel() / DIFFERENCE
        return columns.T

    def _look(self, setup, spectra=None):
        """Residuals, and from which spectra and pictures."""
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
        """Residuals of some captures."""
        errors = np.empty((len(at), *self._seen.shape[1:]), np.float32)
        for error, number in zip(errors, at, strict=True):
            distance = self.captures[number].distance
            seen = setup.sensor.sees(pictures[number], self.shape, GRID, distance, self.pitch)
            error[:] = self._weights[number] * (self._blurred(np.minimum(seen, 1)) - self._seen[number])
        return errors

    def _blurred(self, picture):
        return scipy.ndimage.gaussian_filter(picture, self.blur) if self.blur else picture


def _without_extent(setup):
    return replace(setup, model=replace(setup.model, size=0.0, bandwidth=0.0))


def descend(
    prediction: Prediction,
    values: np.ndarray,
    chosen: Sequence[int],
    steps: int,
    tolerance: float,
    told: Callable[[float, float], object],
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg's and Marquardt's way down.

    Returns
    -------
    values, deviations : numpy.ndarray
        The parameters, and the standard deviations that noise leaves those that were chosen; infinite for others.
    """
    chosen, damping, step, kept = list(chosen), 1e-3, 0, False
    matrix, normal = np.empty((0, 0), np.float32), np.empty((0, 0))
    errors = prediction.residuals(values)
    square = float(errors @ errors)
    while step < steps or kept:
        if not kept:
            look = partial(_told, told, step / steps, 1 / steps, math.sqrt(square / errors.size))
            matrix = prediction.jacobian(values, chosen, look)
            normal, step = (matrix.T @ matrix).astype(float), step + 1
        slope, before = (matrix.T @ errors).astype(float), square
        while damping < MOST_DAMPING:
            damped = normal + damping * np.diag(np.diag(normal) + LEAST * normal.trace() / len(normal))
            tried = values.copy()
            for number, share in zip(chosen, np.linalg.solve(damped, slope), strict=True):
                parameter = prediction.parameters[number]
                tried[number] = min(parameter.moved(values[number], -share), parameter.reach[1])
            found = prediction.residuals(tried)
            new = float(found @ found)
            if new < square:
                values, square, errors, damping = tried, new, found, max(damping / 10, LEAST)
                break
            if kept:
                break
            damping *= 10
        gained = (before - square) / before
        if gained <= tolerance and not kept:
            break
        kept = gained > KEPT
    freedom = max(1, errors.size - len(chosen))
    deviations = np.full(len(values), np.inf)
    shares = np.sqrt(np.diag(np.linalg.pinv(normal)) * square / freedom)
    for number, share in zip(chosen, shares, strict=True):
        deviations[number] = prediction.parameters[number].moved(values[number], share) - values[number]
    return values, deviations


def _told(told, begun, share, error, done):
    told(begun + share * done, error)


@dataclass(frozen=True)
class Fitted:
    """What was found.

    Attributes
    ----------
    setup : Setup
    parameters : list of Parameter
    values, deviations : numpy.ndarray
        Of the parameters, and the standard deviation that noise leaves them.
    error : float
        Root mean square of the residuals.
    explained : float
        Share of the pictures' variance that the model explains.
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
) -> Fitted:
    """Find a display and its camera.

    Parameters
    ----------
    captures : sequence of Capture
        Of `patterns.patterns`, in their order.
    start : Setup
        What they are meant to be; the phase may as well fall.
    shape : (int, int)
        Rows and columns of the SLM.
    pitch : float or (float, float)
        Metres.
    bits : int
        Of a level.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.
    """
    progress = progress or (lambda done, message: None)
    prediction = Prediction(captures, start, shape, pitch, bits, source=SEVENTH)
    first, others = range(len(STAGES))[:SIGN_STAGES], range(len(STAGES))[SIGN_STAGES:]
    passed, count = 0, 2 * len(first) + len(others)

    def stages(numbers, start, values):
        """The parameters after some stages, their deviations, and the mean square of the last residuals."""
        nonlocal passed
        found, foci = parameters(start), len(start.sensor.homographies)
        extent = [number for number, p in enumerate(found) if p.part == "source"]
        deviations, square = np.full(len(values), np.inf), math.inf
        for stage in numbers:
            turns, blur, steps, tolerance = STAGES[stage]
            chosen = [number for number, p in enumerate(found) if p.since <= stage]
            coherent = [number for number in extent if number not in chosen]
            tried = values.copy()
            tried[coherent] = 0  # faster
            source = SEVENTH if not (turns or blur) else FIFTH
            some = Prediction(captures[: turns * foci or None], start, shape, pitch, bits, blur, source)

            def told(done, error, passed=passed):
                progress((passed + done) / count, f"Fitting the display, {100 * error:.1f} % off")

            tolerance = tolerance or NOISE / some.size
            tried, deviations = descend(some, tried, chosen, steps, tolerance, told)
            values = values.copy()
            values[chosen] = tried[chosen]
            square, passed = float(np.mean(some.residuals(tried) ** 2)), passed + 1
        return values, deviations, square

    starts = start, replace(start, knots=tuple(-knot for knot in start.knots))
    tries = [(each, *stages(first, each, vector(each))) for each in starts]
    start, values, deviations, _ = min(tries, key=lambda each: each[-1])
    if others:
        values, deviations, _ = stages(others, start, values)
    errors = prediction.residuals(values)
    square = float(np.mean(errors**2))
    explained = 1 - square / prediction.variance
    found = parameters(start)
    return Fitted(setup_of(values, start), found, values, deviations, math.sqrt(square), explained)


def drift(captures: Sequence[Capture], references: Sequence[int]) -> tuple[int, int, float] | None:
    """Whether a picture that is shown again and again changes by more than its noise.

    Parameters
    ----------
    captures : sequence of Capture
    references : sequence of int
        Numbers of those captures of one and the same picture; the first two, at once one after the other, say what
        noise there is.

    Returns
    -------
    (int, int, float) or None
        The last capture that was as before, the first that was not, and how many times the noise it is off.
    """
    first, again, *others = (np.asarray(captures[number].picture) for number in references)
    weights = 1 / np.sqrt((first + again) / 2 + FLOOR)
    noise = np.sqrt(np.mean((weights * (again - first)) ** 2))
    before = references[1]
    for number, picture in zip(references[2:], others, strict=True):
        off = np.sqrt(np.mean((weights * (picture - first)) ** 2)) / max(noise, LEAST_NOISE)
        if off > DRIFT:
            return before, number, float(off)
        before = number
    return None
