"""A simulated bench that is not what it should be: a display and a camera with errors and noise, to be calibrated.

It computes light in another way than the model that is fitted (`engine.waves.display_model`): twelve samples in a
pixel's side, other points of the source and its spectrum, frequencies twice as fine, aberrations at four
places of the field along each axis, double precision, and a camera that takes the mean over 81 points of a pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
import scipy.ndimage
from scipy.special import j1

from ..engine.pixels import Pitch, axes, coarsest, half_sides
from ..engine.waves.display_model import DisplayModel, zernike
from ..engine.waves.gaussian_points import SEVENTH
from ..engine.waves.propagation import padded_shape
from .fitting import KNOTS, Setup, parameters, setup_of
from .sensor import Sensor

if TYPE_CHECKING:
    from .calibrating import PatternWindow

FINE, GRID = 12, 2
SPOTS = tuple((n - 4) / 9 for n in range(9))
NEAR = 4  # bins of a stop's edge that light passes
ROOM = 2.0  # of the padded grid
PLACES = np.cos(math.pi * (np.arange(4) + 0.5) / 4)  # Chebyshev's


TURN = 0.4  # radians of the source's points, which are no longer where those of a fit are


def _turned(points):
    """Points in the x-y plane, turned: as exact as before, at other places."""
    cosine, sine = math.cos(TURN), math.sin(TURN)
    return tuple((cosine * x - sine * y, sine * x + cosine * y, z, weight) for x, y, z, weight in points)


@dataclass(frozen=True)
class Bench:
    """Takes levels, gives the camera's pictures.

    Parameters
    ----------
    model : DisplayModel
    phases : numpy.ndarray
        Radians of each level.
    sensor : Sensor
    shape : (int, int)
        Rows and columns of the SLM.
    pitch : float or (float, float)
        Metres.
    full_well : float
        Electrons of the highest value; their number is random as Poisson has it.
    read_noise : float
        Electrons.
    source : tuple of (x, y, wavelength, weight)
        Points that stand for a Gaussian source, in its standard deviations.
    seed : int
        Of the noise.
    """

    model: DisplayModel
    phases: np.ndarray
    sensor: Sensor
    shape: tuple
    pitch: Pitch
    full_well: float = 10000.0
    read_noise: float = 8.0
    source: tuple = _turned(SEVENTH)
    seed: int = 0
    taken: list = field(default_factory=list, repr=False)

    def capture(self, levels: np.ndarray, distance: float, number: int = 0) -> np.ndarray:
        """Picture of 8 bits at a distance from the SLM, uint8; `number` says which noise."""
        sensor, rng = self.sensor, np.random.default_rng([self.seed, number])
        seen = self._seen(self.light(self.phases[levels], distance), distance)
        electrons = rng.poisson(np.maximum(sensor.gain * seen, 0) * self.full_well)
        electrons = electrons + rng.normal(0, self.read_noise, seen.shape)
        bent = np.maximum(electrons / (self.full_well * sensor.gain), 0)
        return np.round(255 * np.clip(sensor.value(bent), 0, 1)).astype(np.uint8)

    def look(self, levels: np.ndarray, distance: float) -> np.ndarray:
        """Values of 0 to 1 of a new capture; for `calibrate`."""
        self.taken.append(distance)
        return (self.capture(levels, distance, len(self.taken)) / 255).astype(np.float32)

    def light(self, phases: np.ndarray, distance: float) -> np.ndarray:
        """Intensity on a grid of `GRID` samples in a pixel's side, from the first pixel's middle on."""
        model, padded = self.model, self._padded(distance)
        points = self.source if model.size or model.bandwidth else [(0.0, 0.0, 0.0, 1.0)]
        fine = np.repeat(np.repeat(phases, FINE, 0), FINE, 1)
        if model.crosstalk:
            fine = scipy.ndimage.gaussian_filter(fine, FINE * model.crosstalk, mode="nearest")
        total = np.zeros([GRID * n for n in padded])
        for x, y, c, weight in points:
            sx, sy = model.tilt[0] + model.size * x, model.tilt[1] + model.size * y
            wavelength = model.wavelength + model.bandwidth * c
            wave = self._relayed(self._pixels(fine, padded, sx, sy, wavelength), padded, wavelength)
            fy, fx = (
                scipy.fft.fftfreq(GRID * n, d / GRID) for n, d in zip(padded, axes(self.pitch), strict=True)
            )
            root = np.sqrt(np.maximum(wavelength**-2 - fy[:, None] ** 2 - fx[None, :] ** 2, 0))
            wave = scipy.fft.ifft2(wave * np.exp(2j * math.pi * distance * (root - 1 / wavelength)))
            total += weight * np.abs(wave) ** 2
        return total

    def picture(self, phases: np.ndarray, distance: float) -> np.ndarray:
        """Intensity without a camera or noise at the SLM's pixels, to judge by."""
        light = self.light(phases, distance)
        return light[: GRID * self.shape[0] : GRID, : GRID * self.shape[1] : GRID]

    def _padded(self, distance):
        needed = padded_shape(self.shape, self.pitch, self.model.wavelength, distance)
        return [scipy.fft.next_fast_len(math.ceil(ROOM * n)) for n in needed]

    def _pixels(self, fine, padded, sx, sy, wavelength):
        """Spectrum of the light of the pixels, on the grid of `GRID` samples."""
        model, half = self.model, half_sides(self.shape, self.pitch)
        y, x = ((np.arange(FINE * n) + 0.5) / FINE - n / 2 for n in self.shape)  # pixels, from the middle
        beam = np.exp(
            -model.falloff
            * (
                (y[:, None] / half[0] - model.position[1]) ** 2
                + (x[None, :] / half[1] - model.position[0]) ** 2
            )
        )
        down, across = axes(self.pitch)
        ramp = np.exp(2j * math.pi / wavelength * (down * sy * y[:, None] + across * sx * x[None, :]))
        light = math.sqrt(1 - abs(model.unmodulated) ** 2) * np.exp(
            1j * fine * (model.wavelength / wavelength)
        )
        wave = (light + model.unmodulated) * beam * ramp * (GRID / FINE) ** 2
        for axis, n in enumerate(padded):
            keep = np.round(scipy.fft.fftfreq(GRID * n, 1 / (GRID * n))).astype(int)
            wave = scipy.fft.fft(wave, FINE * n, axis=axis).take(keep, axis=axis)
            f = scipy.fft.fftfreq(GRID * n, 1 / GRID)
            factor = np.exp(-2j * math.pi * f * (0.5 / FINE - 0.5))
            wave *= factor[:, None] if axis == 0 else factor[None, :]
        return wave

    def _relayed(self, wave, padded, wavelength):
        """Spectrum behind the relay."""
        model, stop = self.model, self.model.wavelength / (2 * coarsest(self.pitch))
        y, x = (
            scipy.fft.fftfreq(GRID * n, d / GRID) * wavelength / stop
            for n, d in zip(padded, axes(self.pitch), strict=True)
        )
        y, x = y[:, None], x[None, :]
        radius = np.hypot(x, y)
        mask = _round_stop(tuple(padded), axes(self.pitch), stop / wavelength)
        side = min(n * d for n, d in zip(padded, axes(self.pitch), strict=True))
        inside = radius < 1 + NEAR * wavelength / side / stop
        terms = [np.broadcast_to(each, inside.shape)[inside] for each in zernike(x, y)]
        weights = []
        for n, size, half in zip(padded, self.shape, half_sides(self.shape, self.pitch), strict=True):
            at = np.arange(GRID * n) / GRID
            at = np.where(at > (n + size) / 2, at - n, at)
            at = np.clip((at - (size - 1) / 2) / half, -1, 1)
            weights.append([
                np.prod([(at - o) / (p - o) for o in PLACES if o != p], axis=0) for p in PLACES
            ])  # fmt: skip
        light = np.zeros(wave.shape, complex)
        for eta, rows in zip(PLACES, weights[0], strict=True):
            for xi, columns in zip(PLACES, weights[1], strict=True):
                amounts = np.array(model.aberrations)
                amounts[:3] += xi * np.array(model.across) + eta * np.array(model.down)
                relay = np.zeros(wave.shape, complex)
                phase = sum(a * t for a, t in zip(amounts, terms, strict=True))
                relay[inside] = mask[inside] * np.exp(1j * phase * (model.wavelength / wavelength))
                light += rows[:, None] * columns[None, :] * scipy.fft.ifft2(relay * wave)
        return scipy.fft.fft2(light)

    def _seen(self, light, distance):
        """Intensity at the camera's pixels."""
        many = scipy.fft.fftshift(scipy.fft.fft2(light))
        pads = [(n // 2, n - n // 2) for n in many.shape]
        many = scipy.fft.ifft2(scipy.fft.ifftshift(np.pad(many, pads))).real * 4
        xi, eta = self.sensor.points(distance, SPOTS)
        half = half_sides(self.shape, self.pitch)
        at = [(v * h + (n - 1) / 2) * 2 * GRID for v, h, n in zip((eta, xi), half, self.shape, strict=True)]
        return scipy.ndimage.map_coordinates(many, at, order=3, mode="grid-wrap").mean(axis=(0, 1))


@lru_cache(8)
def _round_stop(padded, pitches, radius):
    """Spectrum of a round stop's light of a point, J1(2 pi r R) R / r, which ends at half of the grid.

    It falls so slowly that a stop's sharp edge on a periodic grid adds what comes round.
    """
    y, x = (d * scipy.fft.fftfreq(GRID * n, 1 / n) for n, d in zip(padded, pitches, strict=True))
    away = np.maximum(np.hypot(y[:, None], x[None, :]), 1e-6 * pitches[0])
    light = radius * j1(2 * math.pi * radius * away) / away * math.prod(pitches) / GRID**2
    light *= np.clip(2 - away / (0.25 * min(n * d for n, d in zip(padded, pitches, strict=True))), 0, 1)
    return scipy.fft.fft2(light).real


def mis_set(start: Setup, window: PatternWindow, seed: int) -> tuple[Bench, Setup]:
    """A bench that is off in every parameter, anywhere in its range, and what it really is."""
    rng = np.random.default_rng(seed)
    rows = parameters(start)
    values = np.array([rng.uniform(row.low, row.high) for row in rows])
    at = np.arange(1, KNOTS + 1) / KNOTS
    span, bend, bow = rng.uniform(0.8, 1.1), *rng.uniform(-0.06, 0.06, 2)
    curve = 2 * math.pi * (span * at + bend * np.sin(2 * math.pi * at) + bow * np.sin(math.pi * at))
    values[[row.name.startswith("response") for row in rows]] = curve
    truth, shape = setup_of(values, start), (window.side, window.side)
    return Bench(truth.model, truth.phases(window.bits), truth.sensor, shape, window.pitch, seed=seed), truth
