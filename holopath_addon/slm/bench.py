"""A simulated bench to calibrate: a display and a camera with errors and noise.

It computes light independently of the fitted model (`engine.waves.display_model`): twelve samples per pixel side,
other points of the source and its spectrum, frequencies twice as fine, aberrations at four field positions along
each axis, double precision, and a camera that averages over 81 points of a pixel.
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

FINE, GRID = 12, 2  # samples per pixel side: of the panel's light, and of the propagated light
PIXEL_POINTS = tuple((n - 4) / 9 for n in range(9))  # of a camera pixel, along each side
EDGE_BINS = 4  # frequency bins beyond the stop's edge at which its mask is still computed
PADDING = 2.0  # times the padded grid of the propagation
FIELD_NODES = np.cos(math.pi * (np.arange(4) + 0.5) / 4)  # Chebyshev nodes
SOURCE_ROTATION = 0.4  # radians, so that the source's points differ from those of the fit


def _rotate(points):
    """Rotate points in the x-y plane: an equally exact quadrature with other nodes."""
    cosine, sine = math.cos(SOURCE_ROTATION), math.sin(SOURCE_ROTATION)
    return tuple((cosine * x - sine * y, sine * x + cosine * y, z, weight) for x, y, z, weight in points)


@dataclass(frozen=True)
class Bench:
    """A display and a camera: turns levels into the camera's pictures.

    Parameters
    ----------
    model : DisplayModel
        Effect of the display on light.
    phases : numpy.ndarray
        Radians of each level.
    sensor : Sensor
        The camera.
    shape : (int, int)
        Rows and columns of the SLM.
    pitch : float or (float, float)
        Pixel pitch of the SLM, meters.
    full_well : float
        Electrons of the highest value; their number is Poisson distributed.
    read_noise : float
        Standard deviation, electrons.
    source : tuple of (x, y, wavelength, weight)
        Points that stand for a Gaussian source, in its standard deviations.
    seed : int
        Seed of the noise.
    """

    model: DisplayModel
    phases: np.ndarray
    sensor: Sensor
    shape: tuple
    pitch: Pitch
    full_well: float = 10000.0
    read_noise: float = 8.0
    source: tuple = _rotate(SEVENTH)
    seed: int = 0
    captures: list = field(default_factory=list, repr=False)  # distances of those of `capture_values`

    def capture(self, levels: np.ndarray, distance: float, number: int = 0) -> np.ndarray:
        """Take a picture of 8 bits.

        Parameters
        ----------
        levels : numpy.ndarray, integers, shape (y, x)
            Of the SLM's pixels.
        distance : float
            Focus of the camera from the SLM, meters.
        number : int
            Number of the capture: each has noise of its own.

        Returns
        -------
        numpy.ndarray, uint8
        """
        sensor, rng = self.sensor, np.random.default_rng([self.seed, number])
        intensity = self._at_camera(self.light(self.phases[levels], distance), distance)
        electrons = rng.poisson(np.maximum(sensor.gain * intensity, 0) * self.full_well)
        electrons = electrons + rng.normal(0, self.read_noise, intensity.shape)
        exposure = np.maximum(electrons / (self.full_well * sensor.gain), 0)
        return np.round(255 * np.clip(sensor.value(exposure), 0, 1)).astype(np.uint8)

    def capture_values(self, levels: np.ndarray, distance: float) -> np.ndarray:
        """Take a picture with new noise: values from 0 to 1, as `calibrate` expects them."""
        self.captures.append(distance)
        return (self.capture(levels, distance, len(self.captures)) / 255).astype(np.float32)

    def light(self, phases: np.ndarray, distance: float) -> np.ndarray:
        """Intensity at a distance in meters, `GRID` samples per pixel side, from the first pixel's center on."""
        model, grid_shape = self.model, self._grid_shape(distance)
        points = self.source if model.size or model.bandwidth else [(0.0, 0.0, 0.0, 1.0)]
        fine = np.repeat(np.repeat(phases, FINE, 0), FINE, 1)
        if model.crosstalk:
            fine = scipy.ndimage.gaussian_filter(fine, FINE * model.crosstalk, mode="nearest")
        total = np.zeros([GRID * n for n in grid_shape])
        for x, y, c, weight in points:
            sx, sy = model.tilt[0] + model.size * x, model.tilt[1] + model.size * y
            wavelength = model.wavelength + model.bandwidth * c
            wave = self._behind_relay(
                self._pixels(fine, grid_shape, sx, sy, wavelength), grid_shape, wavelength
            )
            fy, fx = (
                scipy.fft.fftfreq(GRID * n, d / GRID)
                for n, d in zip(grid_shape, axes(self.pitch), strict=True)
            )
            root = np.sqrt(np.maximum(wavelength**-2 - fy[:, None] ** 2 - fx[None, :] ** 2, 0))
            wave = scipy.fft.ifft2(wave * np.exp(2j * math.pi * distance * (root - 1 / wavelength)))
            total += weight * np.abs(wave) ** 2
        return total

    def picture(self, phases: np.ndarray, distance: float) -> np.ndarray:
        """Noise-free intensity at the SLM's pixels at a distance in meters: the ground truth."""
        light = self.light(phases, distance)
        return light[: GRID * self.shape[0] : GRID, : GRID * self.shape[1] : GRID]

    def _grid_shape(self, distance):
        needed = padded_shape(self.shape, self.pitch, self.model.wavelength, distance)
        return [scipy.fft.next_fast_len(math.ceil(PADDING * n)) for n in needed]

    def _pixels(self, fine, grid_shape, sx, sy, wavelength):
        """Spectrum of the pixels' light, `GRID` samples per pixel side."""
        model, half = self.model, half_sides(self.shape, self.pitch)
        y, x = ((np.arange(FINE * n) + 0.5) / FINE - n / 2 for n in self.shape)  # pixels, from the center
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
        for axis, n in enumerate(grid_shape):
            keep = np.round(scipy.fft.fftfreq(GRID * n, 1 / (GRID * n))).astype(int)
            wave = scipy.fft.fft(wave, FINE * n, axis=axis).take(keep, axis=axis)
            f = scipy.fft.fftfreq(GRID * n, 1 / GRID)
            factor = np.exp(-2j * math.pi * f * (0.5 / FINE - 0.5))
            wave *= factor[:, None] if axis == 0 else factor[None, :]
        return wave

    def _behind_relay(self, wave, grid_shape, wavelength):
        """Spectrum of the light behind the relay."""
        model, stop = self.model, self.model.wavelength / (2 * coarsest(self.pitch))
        y, x = (
            scipy.fft.fftfreq(GRID * n, d / GRID) * wavelength / stop
            for n, d in zip(grid_shape, axes(self.pitch), strict=True)
        )
        y, x = y[:, None], x[None, :]
        radius = np.hypot(x, y)
        mask = _round_stop(tuple(grid_shape), axes(self.pitch), stop / wavelength)
        side = min(n * d for n, d in zip(grid_shape, axes(self.pitch), strict=True))
        inside = radius < 1 + EDGE_BINS * wavelength / side / stop
        terms = [np.broadcast_to(each, inside.shape)[inside] for each in zernike(x, y)]
        weights = []
        for n, size, half in zip(grid_shape, self.shape, half_sides(self.shape, self.pitch), strict=True):
            at = np.arange(GRID * n) / GRID
            at = np.where(at > (n + size) / 2, at - n, at)
            at = np.clip((at - (size - 1) / 2) / half, -1, 1)
            weights.append([
                np.prod([(at - o) / (p - o) for o in FIELD_NODES if o != p], axis=0) for p in FIELD_NODES
            ])  # fmt: skip
        light = np.zeros(wave.shape, complex)
        for eta, rows in zip(FIELD_NODES, weights[0], strict=True):
            for xi, columns in zip(FIELD_NODES, weights[1], strict=True):
                amounts = np.array(model.aberrations)
                amounts[:3] += xi * np.array(model.across) + eta * np.array(model.down)
                relay = np.zeros(wave.shape, complex)
                phase = sum(a * t for a, t in zip(amounts, terms, strict=True))
                relay[inside] = mask[inside] * np.exp(1j * phase * (model.wavelength / wavelength))
                light += rows[:, None] * columns[None, :] * scipy.fft.ifft2(relay * wave)
        return scipy.fft.fft2(light)

    def _at_camera(self, light, distance):
        """Intensity at the camera's pixels."""
        spectrum = scipy.fft.fftshift(scipy.fft.fft2(light))
        pads = [(n // 2, n - n // 2) for n in spectrum.shape]
        finer = scipy.fft.ifft2(scipy.fft.ifftshift(np.pad(spectrum, pads))).real * 4
        xi, eta = self.sensor.points(distance, PIXEL_POINTS)
        half = half_sides(self.shape, self.pitch)
        at = [(v * h + (n - 1) / 2) * 2 * GRID for v, h, n in zip((eta, xi), half, self.shape, strict=True)]
        return scipy.ndimage.map_coordinates(finer, at, order=3, mode="grid-wrap").mean(axis=(0, 1))


@lru_cache(8)
def _round_stop(grid_shape, pitches, radius):
    """Transfer function of a round stop: the spectrum of its point spread J1(2 pi r R) R / r.

    The point spread is cut off at half of the grid: it falls so slowly that a sharp edge of the stop on a periodic
    grid would wrap around.
    """
    y, x = (d * scipy.fft.fftfreq(GRID * n, 1 / n) for n, d in zip(grid_shape, pitches, strict=True))
    r = np.maximum(np.hypot(y[:, None], x[None, :]), 1e-6 * pitches[0])
    light = radius * j1(2 * math.pi * radius * r) / r * math.prod(pitches) / GRID**2
    light *= np.clip(2 - r / (0.25 * min(n * d for n, d in zip(grid_shape, pitches, strict=True))), 0, 1)
    return scipy.fft.fft2(light).real


def perturbed_bench(start: Setup, window: PatternWindow, seed: int) -> tuple[Bench, Setup]:
    """A bench whose every parameter is drawn uniformly from its range, and its true setup.

    Parameters
    ----------
    start : Setup
        The nominal setup, see `nominal_setup`.
    window : PatternWindow
        The part of the device on which patterns are shown.
    seed : int
        Seed of the parameters and of the noise.
    """
    rng = np.random.default_rng(seed)
    rows = parameters(start)
    values = np.array([rng.uniform(row.low, row.high) for row in rows])
    at = np.arange(1, KNOTS + 1) / KNOTS
    span, bend, bow = rng.uniform(0.8, 1.1), *rng.uniform(-0.06, 0.06, 2)
    curve = 2 * math.pi * (span * at + bend * np.sin(2 * math.pi * at) + bow * np.sin(math.pi * at))
    values[[row.name.startswith("response") for row in rows]] = curve
    truth, shape = setup_of(values, start), (window.side, window.side)
    return Bench(truth.model, truth.phases(window.bits), truth.sensor, shape, window.pitch, seed=seed), truth
