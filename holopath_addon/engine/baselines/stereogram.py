"""Holographic stereogram: the light field on a plane as a wave, by an overlap-add of short-time Fourier transforms.

Padmanaban, Peng and Wetzstein, ACM TOG 38(6), 214 (2019), "OLAS": around each pixel p of a plane the wave is a hogel of
W x W pixels, a sum of plane waves of frequencies f on a grid of W x W. Each has the brightness of the ray through p
with its slope, and the phase at which light arrives from the surface point q that the ray hits:

    U(x) = sum_p w(x - p) sum_f g(dz) sqrt(L(p, f)) exp(i (psi + 2 pi f (x - p)))
    psi = phi(q) + 2 pi f (p - q) + k dz (1 - cos theta),  sin theta = wavelength f

with w a Hann window, dz the height of q over the plane, and g the factor for the right brightness of a point. The
authors' phases are smooth: light through the middle of the pupil. Here phi is random for each pixel and frame, for
diffuse light through all of the pupil. q is rounded to pixels, so that all hogels agree on a point's wave.

All frames share the rays, one for each pixel, frequency and wavelength. A hogel must contain the Fresnel zone of the
points that it shows, so W grows with sqrt(wavelength dz) / pitch. Therefore hogels are smallest on a plane in the
middle of the depths, from which the whole wave is propagated to the SLM. At the maximum of W, points that are farther
away lose detail (20 mm at 8 µm and 516 nm). Mirrors and glass show their image on their own surface.
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
from ..tracing.wave_kernel import wrap_index
from ..viewing.preview import path_tracer
from ..waves.propagation import carrier, circular_band, field_of, padded_shape, spectrum, transfer_function
from ..waves.supervision import FramePool
from .layers import random_phasor
from .light_field import PICTURES

if TYPE_CHECKING:
    from ..progress import PartProgress, Progress
    from . import BaselineInput

ZONE = 2.5  # width of a hogel in units of sqrt(wavelength dz)
MIN_SIDE, MAX_SIDE = 8, 32  # of a hogel, pixels
HEIGHTS = 33  # entries of the table of g, by the height over the plane
CHUNK_RAYS = 1 << 20  # between two calls of progress


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """Wave field at the SLM; parameters and result as of `baselines.field`."""
    from ..scene.dispersion import tuned

    hologram = job.hologram
    plane = 0.5 * (job.z_low + job.z_high)
    out = np.empty((job.settings.frames, len(hologram.wavelengths), *job.shape), np.complex64)
    each_color = parts(progress, len(hologram.wavelengths))
    for k, wavelength in enumerate(hologram.wavelengths):
        side = hogel_side(hologram.pitch, wavelength, job.z_high - plane)
        with tuned(job.scene, (wavelength,)):
            waves = stereogram(job, plane, k, side, named(each_color[k], "Stereogram"))
        padded = padded_shape(job.shape, hologram.pitch, wavelength, plane)
        transfer = transfer_function(padded, hologram.pitch, wavelength, -plane) * carrier(wavelength, -plane)
        for m, wave in enumerate(waves):
            out[m, k] = field_of(spectrum(wave, padded) * transfer, job.shape)
            each_color[k](1.0, "Stereogram")
    return out


def hogel_side(pitch: float, wavelength: float, reach: float) -> int:
    """Side in pixels, an even number, of hogels that show points up to `reach` meters from their plane."""
    return int(np.clip(2 * math.ceil(0.5 * ZONE * math.sqrt(wavelength * reach) / pitch), MIN_SIDE, MAX_SIDE))


def frequencies(side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies of a hogel's plane waves, cycles per pixel to the right and up, and a mask of the recordable ones.

    All have the shape (side, side).
    """
    axis = (np.arange(side) + 0.5) / side - 0.5
    right, up = np.meshgrid(axis, axis)
    return right, up, np.hypot(right, up) <= 0.5


def window(offset: np.ndarray, side: int) -> np.ndarray:
    """Hann window w along one axis, `offset` pixels from a hogel's center."""
    return np.where(2 * np.abs(offset) < side, np.cos(math.pi * offset / side) ** 2, 0)


def point_energy(side: int, spread: float) -> float:
    """Energy of the wave of a point at a height over the plane, in the recordable band, for g = L = 1.

    Parameters
    ----------
    side : int
        W, pixels.
    spread : float
        Height as wavelength dz / pitch^2.
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
    """Waves of all frames on a plane.

    Parameters
    ----------
    job : BaselineInput
    plane : float
        Meters from the SLM.
    k : int
        Index of the wavelength.
    side : int
        W in pixels, an even number.
    progress : callable
        ``progress(done)``, may raise `Cancelled`.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, y, x)
    """
    (rows, columns), half = job.shape, side // 2
    across, upward, inside = frequencies(side)
    rays = _LightField(job, plane, k, side)
    # random for any number of frames, because `point_energy` assumes points without interference
    phasors = [random_phasor(job, m, k, 1.0).ravel() for m in range(job.settings.frames)]
    offset = np.arange(1 - half, half)
    # plane waves by offset to the right and frequency; conjugate for rows, which run down where frequencies run up
    waves = window(offset, side)[:, None] * np.exp(2j * math.pi * np.outer(offset, across[0]))
    waves = waves.astype(np.complex64)
    out = np.zeros((len(phasors), rows + 2 * half - 2, columns + 2 * half - 2), np.complex64)
    height = max(1, CHUNK_RAYS // (columns * inside.sum()))
    with FramePool() as pool:
        for first in range(0, rows, height):
            progress(first / rows)
            amplitude, cells = rays.strip(first, min(height, rows - first))

            def add(m, first=first, amplitude=amplitude, cells=cells):
                hogels = np.zeros((*inside.shape, *amplitude.shape[1:]), np.complex64)
                hogels[inside] = amplitude * phasors[m][cells]
                part = _overlap_add(waves.conj(), hogels)  # (frequency across, y, x)
                part = _overlap_add(waves, part)
                out[m, first : first + part.shape[0]] += part

            pool.each(add, len(phasors))
    return out[:, half - 1 : half - 1 + rows, half - 1 : half - 1 + columns]


def _overlap_add(waves, hogels):
    """Sum of waves, shape (offset, frequency), over the hogels' first axis, with offsets added along the third."""
    pieces = np.tensordot(waves, hogels, 1)
    count, size, *rest = pieces.shape[1:]
    total = np.zeros((count, size + len(waves) - 1, *rest), np.complex64)
    for shift, piece in enumerate(pieces):
        total[:, shift : shift + size] += piece
    return total


class _LightField:
    """Light field on a plane: rays through each pixel with all slopes; parameters as of `stereogram`."""

    def __init__(self, job, plane, k, side):
        hologram, settings = job.hologram, job.settings
        self.wavelength, self.plane, self.columns = hologram.wavelengths[k], plane, hologram.width
        across, upward, inside = frequencies(side)
        across, upward = across[inside], upward[inside]
        sines = np.stack([across, upward]) * self.wavelength / hologram.pitch
        cosines = np.sqrt(1 - (sines**2).sum(0))
        retardation = 2 * math.pi / self.wavelength * (sines**2).sum(0) / (1 + cosines)  # k - kz
        self.count = len(cosines)
        values = [across, upward, *(sines / cosines), retardation]
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

    def strip(self, first, rows):
        """Complex amplitudes in some rows of pixels, and indices of the pixels that the surface points lie in.

        Both have the shape (frequency, y, x).
        """
        job, rays = self.job, self.rays
        index = dr.arange(mi.UInt32, self.count * rows * self.columns)
        place, column = index // self.columns, mi.Float(index % self.columns)
        number, row = place // rows, mi.Float(place % rows + dr.opaque(mi.UInt32, first))
        across, upward, slope_x, slope_y, retardation = (dr.gather(mi.Float, v, number) for v in self.table)
        ray, depth_rate = rays.world(*rays.place(column, row), slope_x, slope_y)
        surface = intersect(job.scene, ray, coherent=True)
        dz = rays.height_over_plane(surface.t, depth_rate, surface.is_valid())
        dz = dr.clip(dz, job.z_low - self.plane, job.z_high - self.plane)
        # offset of the surface point's pixel
        right, down = dr.round(slope_x * dz / rays.pitch), dr.round(-slope_y * dz / rays.pitch)
        phase = (2 * math.pi) * (upward * down - across * right) + retardation * dz
        self.sampler.seed(dr.opaque(mi.UInt32, (self.seed + first) & 0xFFFFFFFF), dr.width(index))

        def body(n, light, sampler):
            offset = sampler.next_2d() - 0.5
            ray, _ = rays.world(*rays.place(column + offset.x, row + offset.y), slope_x, slope_y)
            radiance, _, _ = self.integrator.sample(job.scene, sampler, mi.RayDifferential3f(ray))
            return n + 1, light + radiance[self.channel], sampler

        state = (mi.UInt32(0), mi.Float(0), self.sampler)
        _, light, _ = dr.while_loop(state, lambda n, *_: n < self.paths, body, label="light field")
        sine, cosine = dr.sincos(phase)
        height = mi.UInt32(dr.round(dr.abs(dz) * ((HEIGHTS - 1) / self.reach)))
        amplitude = dr.gather(mi.Float, self.gain, height) * dr.sqrt(dr.maximum(light / self.paths, 0))
        height, width = job.shape
        cell = wrap_index(mi.Int(row + down), height) * width + wrap_index(mi.Int(column + right), width)
        real, imaginary = amplitude * cosine, amplitude * sine
        dr.eval(real, imaginary, cell)
        shape = self.count, rows, self.columns
        wave = np.asarray(real).reshape(shape) + 1j * np.asarray(imaginary).reshape(shape)
        return wave, np.array(cell).reshape(shape)  # a copy, because threads must not hold Dr.Jit's memory
