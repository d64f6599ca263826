"""Holographic stereogram: the light field on a plane as a wave, by an overlap-add of short-time Fourier transforms.

Padmanaban, Peng and Wetzstein, ACM TOG 38(6), 214 (2019), "OLAS": around each pixel p of a plane the wave is a hogel of
W x W pixels, a sum of plane waves of frequencies f on a grid of W x W. Each is as bright as the ray through p that has
its slope, and has the phase with which light of the surface point q that the ray sees arrives:

    U(x) = sum_p w(x - p) sum_f g(dz) sqrt(L(p, f)) exp(i (psi + 2 pi f (x - p)))
    psi = phi(q) + 2 pi f (p - q) + k dz (1 - cos theta),  sin theta = wavelength f

with w a Hann window, dz the height of q over the plane, and g such that a point is as bright as it should be. Theirs
has smooth phases: light through the middle of the pupil. Here phi is random from pixel to pixel and frame to frame, for
diffuse light through all of it; q is rounded to pixels, so that all hogels agree on a point's wave.

All frames share the rays, one a pixel, frequency and wavelength. A hogel must hold the Fresnel zone of the points that
it shows, so W grows with sqrt(wavelength dz) / pitch: hence a plane in the middle of the depths, from which the wave
goes on to the SLM as a whole, needs the fewest. With W at its most, points farther from it lose detail (20 mm at 8 µm
and 516 nm). Mirrors and glass show like pictures painted on them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..hologram import channel
from ..progress import named, parts
from ..scene.rays import Rays, intersect
from ..viewing.preview import path_tracer
from ..waves.propagation import carrier, circular_band, field_of, padded_shape, spectrum, transfer_function
from ..waves.supervision import Frames
from .layers import random_phasor
from .light_field import PICTURES

if TYPE_CHECKING:
    from ..progress import PartProgress, Progress
    from . import BaselineInput

ZONE = 2.5  # width of a hogel, of sqrt(wavelength dz)
LEAST, MOST = 8, 32  # pixels along a side of a hogel
HEIGHTS = 33  # over the plane, that g is tabulated at
CHUNK_RAYS = 1 << 20  # between two looks at progress and cancel


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """As of `layers.field`."""
    from ..scene.dispersion import tuned

    hologram = job.hologram
    plane = 0.5 * (job.z_low + job.z_high)
    out = np.empty((job.settings.frames, len(hologram.wavelengths), *job.shape), np.complex64)
    told = parts(progress, len(hologram.wavelengths))
    for k, wavelength in enumerate(hologram.wavelengths):
        side = hogel_side(hologram.pitch, wavelength, job.z_high - plane)
        with tuned(job.scene, (wavelength,)):
            waves = stereogram(job, plane, k, side, named(told[k], "Stereogram"))
        padded = padded_shape(job.shape, hologram.pitch, wavelength, plane)
        transfer = transfer_function(padded, hologram.pitch, wavelength, -plane) * carrier(wavelength, -plane)
        for m, wave in enumerate(waves):
            out[m, k] = field_of(spectrum(wave, padded) * transfer, job.shape)
            told[k](1.0, "Stereogram")
    return out


def hogel_side(pitch: float, wavelength: float, reach: float) -> int:
    """Pixels along a side of hogels, even, that show points up to `reach` meters from their plane."""
    return int(np.clip(2 * math.ceil(0.5 * ZONE * math.sqrt(wavelength * reach) / pitch), LEAST, MOST))


def frequencies(side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of a hogel's plane waves, cycles a pixel to the right and up, shape (side, side), and which are recordable."""
    axis = (np.arange(side) + 0.5) / side - 0.5
    right, up = np.meshgrid(axis, axis)
    return right, up, np.hypot(right, up) <= 0.5


def window(offset: np.ndarray, side: int) -> np.ndarray:
    """w along one axis, `offset` pixels from a hogel's center."""
    return np.where(2 * np.abs(offset) < side, np.cos(math.pi * offset / side) ** 2, 0)


def point_energy(side: int, spread: float) -> float:
    """What the wave of a point holds, in the recordable band, of g = L = 1 and of a height over the plane.

    Parameters
    ----------
    side : int
        W.
    spread : float
        wavelength dz / pitch^2.
    """
    across, upward, inside = frequencies(side)
    x = np.arange(-math.ceil(0.5 * (spread + side)), math.ceil(0.5 * (spread + side)) + 1)
    columns, rows = (
        window(x[:, None] + np.round(spread * f[inside]), side)
        * np.exp(2j * math.pi * x[:, None] * f[inside])
        for f in (across, upward)
    )
    wave = rows * np.exp(1j * math.pi * spread * (across**2 + upward**2)[inside]) @ columns.T
    shape = 2 * len(x), 2 * len(x)
    return (np.abs(np.fft.fft2(wave, shape)[circular_band(shape)]) ** 2).sum() / math.prod(shape)


def stereogram(job: BaselineInput, plane: float, k: int, side: int, progress: PartProgress) -> np.ndarray:
    """The waves of all frames on a plane.

    Parameters
    ----------
    job : BaselineInput
    plane : float
        Meters from the SLM.
    k : int
        Number of the wavelength.
    side : int
        W, even.
    progress : callable
        ``progress(done)``, may raise.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, y, x)
    """
    (rows, columns), half = job.shape, side // 2
    across, upward, inside = frequencies(side)
    rays = _LightField(job, plane, k, side)
    # however few: `point_energy` is that of points whose light does not add up
    phasors = [random_phasor(job, m, k, 1.0).ravel() for m in range(job.settings.frames)]
    offset = np.arange(1 - half, half)
    # from frequencies to pixels to the right; rows go down where frequencies go up
    waves = window(offset, side)[:, None] * np.exp(2j * math.pi * np.outer(offset, across[0]))
    waves = waves.astype(np.complex64)
    out = np.zeros((len(phasors), rows + 2 * half - 2, columns + 2 * half - 2), np.complex64)
    height = max(1, CHUNK_RAYS // (columns * inside.sum()))
    with Frames() as threads:
        for first in range(0, rows, height):
            progress(first / rows)
            amplitude, cells = rays.band(first, min(height, rows - first))

            def add(m, first=first, amplitude=amplitude, cells=cells):
                hogels = np.zeros((*inside.shape, *amplitude.shape[1:]), np.complex64)
                hogels[inside] = amplitude * phasors[m][cells]
                part = _overlap_added(waves.conj(), hogels)  # (frequency across, y, x)
                part = _overlap_added(waves, part)
                out[m, first : first + part.shape[0]] += part

            threads.each(add, len(phasors))
    return out[:, half - 1 : half - 1 + rows, half - 1 : half - 1 + columns]


def _overlap_added(waves, hogels):
    """Sums over the first axis, frequencies, of waves (offset, frequency), shifted along the third."""
    pieces = np.tensordot(waves, hogels, 1)
    count, size, *rest = pieces.shape[1:]
    total = np.zeros((count, size + len(waves) - 1, *rest), np.complex64)
    for shift, piece in enumerate(pieces):
        total[:, shift : shift + size] += piece
    return total


class _LightField:
    """Rays through each pixel of a plane, of all slopes; parameters as of `stereogram`."""

    def __init__(self, job, plane, k, side):
        hologram, settings = job.hologram, job.settings
        self.wavelength, self.plane, self.columns = hologram.wavelengths[k], plane, hologram.width
        across, upward, inside = frequencies(side)
        across, upward = across[inside], upward[inside]
        sines = np.stack([across, upward]) * self.wavelength / hologram.pitch
        cosines = np.sqrt(1 - (sines**2).sum(0))
        lag = 2 * math.pi / self.wavelength * (sines**2).sum(0) / (1 + cosines)
        self.count = len(cosines)
        values = [across, upward, *(sines / cosines), lag]
        self.table = [mi.Float(np.float32(v)) for v in values]
        self.reach = max(job.z_high - plane, plane - job.z_low, 1e-12)
        spreads = np.linspace(0, self.wavelength * self.reach / hologram.pitch**2, HEIGHTS)
        self.gain = mi.Float(np.float32([point_energy(side, u) ** -0.5 for u in spreads]))
        self.job, self.channel = job, channel(self.wavelength)
        self.rays = Rays(hologram, job.camera, job.mapping, plane)
        self.integrator = path_tracer(job.scene, job.camera.sees_sky, settings.max_depth)
        colors = len(hologram.wavelengths)
        self.paths = dr.opaque(mi.UInt32, math.ceil(PICTURES * job.paths / (self.count * colors)))
        self.sampler = mi.load_dict({"type": "independent"})
        self.seed = (settings.seed * colors + k) * 9973

    def band(self, first, rows):
        """Amplitudes, complex, at some rows of pixels, and numbers of the pixels where the light comes from.

        Both of shape (frequency, y, x).
        """
        job, rays = self.job, self.rays
        index = dr.arange(mi.UInt32, self.count * rows * self.columns)
        place, column = index // self.columns, mi.Float(index % self.columns)
        number, row = place // rows, mi.Float(place % rows + dr.opaque(mi.UInt32, first))
        across, upward, slope_x, slope_y, lag = (dr.gather(mi.Float, v, number) for v in self.table)
        ray, depth_rate = rays.world(*rays.place(column, row), slope_x, slope_y)
        seen = intersect(job.scene, ray, coherent=True)
        dz = rays.height_over_plane(seen.t, depth_rate, seen.is_valid())
        dz = dr.clip(dz, job.z_low - self.plane, job.z_high - self.plane)
        # from the pixel to that of the surface point
        right, down = dr.round(slope_x * dz / rays.pitch), dr.round(-slope_y * dz / rays.pitch)
        phase = (2 * math.pi) * (upward * down - across * right) + lag * dz
        self.sampler.seed(dr.opaque(mi.UInt32, (self.seed + first) & 0xFFFFFFFF), dr.width(index))

        def body(n, light, sampler):
            aside = sampler.next_2d() - 0.5
            ray, _ = rays.world(*rays.place(column + aside.x, row + aside.y), slope_x, slope_y)
            found, _, _ = self.integrator.sample(job.scene, sampler, mi.RayDifferential3f(ray))
            return n + 1, light + found[self.channel], sampler

        state = (mi.UInt32(0), mi.Float(0), self.sampler)
        _, light, _ = dr.while_loop(state, lambda n, *_: n < self.paths, body, label="light field")
        sine, cosine = dr.sincos(phase)
        height = mi.UInt32(dr.round(dr.abs(dz) * ((HEIGHTS - 1) / self.reach)))
        amplitude = dr.gather(mi.Float, self.gain, height) * dr.sqrt(dr.maximum(light / self.paths, 0))
        height, width = job.shape
        cell = _wrapped(mi.Int(row + down), height) * width + _wrapped(mi.Int(column + right), width)
        real, imaginary = amplitude * cosine, amplitude * sine
        dr.eval(real, imaginary, cell)
        shape = self.count, rows, self.columns
        wave = np.asarray(real).reshape(shape) + 1j * np.asarray(imaginary).reshape(shape)
        return wave, np.array(cell).reshape(shape)  # a copy: threads are not to hold what is Dr.Jit's


def _wrapped(index, size):
    """Index modulo size, not negative."""
    rest = index % size
    return dr.select(rest < 0, rest + size, rest)
