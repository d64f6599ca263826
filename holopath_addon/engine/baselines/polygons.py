"""Polygons: each visible facet emits from its own tilted plane and blocks light from behind it.

A facet is a surface function on its plane: the root of its radiance with random phases, which spread the light of a
large facet over the whole cone (Matsushima, Appl. Opt. 44, 4607 (2005); Matsushima and Nakahara, Appl. Opt. 48, H54
(2009)). The transform of a triangle of constant phase (Kim, Hahn and Lee, Appl. Opt. 47, D117 (2008)) would shine into
a narrow cone and show no texture. The angular spectrum is that of the surface function h with the frequencies rotated
with the plane (Ahrenberg et al., Appl. Opt. 47, 1567 (2008)): with dz(x) = a.x the facet's height over a plane and
lag = k - kz

    U(f) = int h(x) exp(i lag(f) dz(x) - 2 pi i f.x) d2x = H(f - a lag(f) / (2 pi))

In these methods most of the time goes into resampling H for each facet. Here volumes are cut into slabs of half
thickness t, for which the kernel separates (Jacobi-Anger expansion), so that a few transforms give all facets of a slab
at once, in any number:

    exp(i lag dz) = sum_j (2 - [j = 0]) i^j J_j(lag t) T_j(dz / t)

Hidden surfaces are removed by the silhouette method, from far to near (Matsushima, Nakamura and Nakahara, Opt. Express
22, 24450 (2014)): facets block light from behind in the middle of their slab. They do not block the adjacent slab,
because the same surface continues there, and silhouettes made of pixels would clip its light.

Facets are found by rays through the pixels, not by projecting vertices: spheres and millions of triangles cost no more
than one, and of several facets within a pixel one counts. Radiance is that from the pupil's center: highlights do not
move across the pupil, and mirrors and glass show their image on their own surface. Hidden facets near edges have paths
of their own; only the first one behind another that faces the viewer counts.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
from scipy.ndimage import minimum_filter
from scipy.special import jv

from ..waves.propagation import (
    circular_band,
    field_of,
    phase_retardation,
    propagate,
    spectrum,
    transfer_function,
)
from .layers import gain_for, random_phasor
from .shots import in_each_wavelength, picture_with_depth

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput

MAX_SLABS = 64
TOLERANCE = 0.05  # absolute error of the kernel at the band's edge
MIN_GAP = 2  # slabs between a hidden facet and the one before it: facets do not block nearer ones
MAX_CASTS = 8  # surfaces in a row to look behind
BRANCH_SHIFT = 37  # pixels between the random phases of facets behind one another
CHUNK_PATHS = 1 << 18  # between two calls of progress


@dataclass(frozen=True)
class Sheet:
    """Facets at the pixels' centers, one for each pixel.

    Attributes
    ----------
    radiance : numpy.ndarray, float32, shape (wavelength, y, x)
    z : numpy.ndarray, float64, shape (y, x)
        Meters from the SLM; NaN where there is no facet.
    """

    radiance: np.ndarray
    z: np.ndarray


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """Wave field at the SLM; parameters and result as of `baselines.field`."""
    hologram, frames = job.hologram, job.settings.frames
    sheets = sheets_of(job, lambda done, message: progress(0.4 * done, message))
    count, half = slabs_of(job)
    places = [_place(sheet.z, job.z_low, count, half) for sheet in sheets]
    margin = math.ceil(hologram.widest_slope * (job.z_high - job.z_low) / hologram.pitch) + 8
    # light that leaves the image on its way may return to the SLM
    window = [n + 2 * margin for n in job.shape]
    padded = tuple(scipy.fft.next_fast_len(n) for n in window)
    to_slm = -(job.z_low + (2 * count - 1) * half)
    out = np.empty((frames, len(hologram.wavelengths), *job.shape), np.complex64)
    for k, wavelength in enumerate(hologram.wavelengths):
        step = transfer_function(padded, hologram.pitch, wavelength, 2 * half)
        bessel = tilts(padded, hologram.pitch, wavelength, half)
        for m in range(frames):
            phasor = random_phasor(job, m, k)
            gain = np.float32(gain_for(frames))
            light = [
                np.sqrt(sheet.radiance[k]) * np.roll(phasor, number * BRANCH_SHIFT, (0, 1)) * gain
                for number, sheet in enumerate(sheets)
            ]
            done = (k * frames + m) / (len(hologram.wavelengths) * frames)
            slab_fraction = 0.6 / (len(hologram.wavelengths) * frames * count)
            far, last = None, None  # spectra of the slabs behind, and of the one directly behind
            for slab in range(count):
                progress(0.4 + 0.6 * done + slab * slab_fraction, "Polygons")
                masks = [number == slab for number, _ in places]
                far = _block(None if far is None else far * step, np.logical_or.reduce(masks))
                if last is not None:
                    far = last * step if far is None else far + last * step
                last = _slab_spectrum(light, masks, [height for _, height in places], bessel, padded)
            total = sum(part for part in (far, last) if part is not None)
            wave = np.roll(field_of(total, padded), margin, (0, 1))[: window[0], : window[1]]
            wave = propagate(wave, hologram.pitch, wavelength, to_slm)
            out[m, k] = wave[margin : margin + job.shape[0], margin : margin + job.shape[1]]
    return out


def slabs_of(job: BaselineInput) -> tuple[int, float]:
    """Number of slabs, up to `MAX_SLABS` of a quarter of a depth of focus each, and half their thickness in meters."""
    thickness = job.z_high - job.z_low
    count = int(np.clip(math.ceil(thickness / (0.25 * job.hologram.depth_of_focus)), 1, MAX_SLABS))
    return count, max(0.5 * thickness / count, 1e-9)


def tilts(shape: tuple[int, int], pitch: float, wavelength: float, half: float) -> list[np.ndarray]:
    """Terms J_j(lag t) of the kernel's expansion, up to the tolerance.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns of the FFT.
    pitch, wavelength : float
        Meters.
    half : float
        Half thickness t of a slab, meters.

    Returns
    -------
    list of numpy.ndarray, float32, `shape`, in FFT order
    """
    band, turn = circular_band(shape), phase_retardation(shape, pitch, wavelength) * half
    steepest = float(turn[band].max())
    terms = next(j for j in itertools.count(1) if j > steepest and abs(2 * jv(j, steepest)) < TOLERANCE)
    table = np.linspace(0, steepest, 1 << 12)
    return [np.where(band, np.interp(turn, table, jv(j, table)), 0).astype(np.float32) for j in range(terms)]


def _place(z, low, count, half):
    """Slab of each facet, -1 where there is no facet, and height over the slab's middle in half thicknesses."""
    position = np.where(np.isnan(z), -1, (z - low) / (2 * half))
    slab = np.minimum(np.floor(position), count - 1).astype(int)
    return slab, (2 * (position - slab) - 1).astype(np.float32)


def _slab_spectrum(light, masks, heights, bessel, padded):
    """Spectrum of a slab's facets in the middle of the slab; None where it has none."""
    if not any(mask.any() for mask in masks):
        return None
    source = sum(np.where(mask, value, 0) for mask, value in zip(masks, light, strict=True))
    height = sum(np.where(mask, value, 0) for mask, value in zip(masks, heights, strict=True))
    total = np.zeros(padded, np.complex64)
    before, chebyshev = height, np.ones_like(height)  # T_-1 = T_1
    for j, weight in enumerate(bessel):
        part = spectrum(np.complex64((1 if j == 0 else 2) * 1j**j) * chebyshev * source, padded)
        part *= weight
        total += part
        before, chebyshev = chebyshev, 2 * height * chebyshev - before
    return total


def _block(waves, mask):
    """Spectrum of waves behind facets that fill the pixels of a mask."""
    if waves is None or not mask.any():
        return waves
    wave = field_of(waves, waves.shape)
    wave[: mask.shape[0], : mask.shape[1]][mask] = 0
    return spectrum(wave, waves.shape)


def sheets_of(job: BaselineInput, progress: Progress) -> list[Sheet]:
    """Facets that the pupil's center sees, and hidden ones that other parts of the pupil may see.

    Parameters
    ----------
    job : BaselineInput
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    list of Sheet
        One or two.
    """
    radiance, z = picture_with_depth(job, lambda done, message: progress(0.7 * done, message))
    gap = MIN_GAP * 2 * slabs_of(job)[1]
    reach = math.ceil(job.hologram.widest_slope * (job.z_high - job.z_low) / job.hologram.pitch)
    beside_edge = minimum_filter(z, 2 * reach + 1) < z - gap
    if not beside_edge.any():
        return [Sheet(radiance, z)]
    behind = hidden_sheet(
        job, z, gap, np.flatnonzero(beside_edge), lambda done, message: progress(0.7 + 0.3 * done, message)
    )
    return [Sheet(radiance, z), behind]


def hidden_sheet(
    job: BaselineInput, z: np.ndarray, gap: float, pixels: np.ndarray, progress: Progress
) -> Sheet:
    """The nearest facets that lie behind the visible ones and face the viewer.

    Parameters
    ----------
    job : BaselineInput
    z : numpy.ndarray, shape (y, x)
        Depths of the visible facets, meters from the SLM.
    gap : float
        Minimum distance from these, meters.
    pixels : numpy.ndarray of int
        Pixels to look at, numbered row by row.
    progress : callable
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    Sheet
    """
    import drjit as dr
    import mitsuba as mi

    from ..scene.buffers import loaded
    from ..scene.rays import Rays

    hologram, mapping = job.hologram, job.mapping
    rays = Rays(hologram, job.camera, mapping, 0.0)
    row, column = np.divmod(pixels, hologram.width)
    ray, _ = rays.world(*rays.place(mi.Float(column), mi.Float(row)), 0.0, 0.0)
    limit = loaded(mi.Float, z.ravel()[pixels] - gap)
    surface = job.scene.ray_intersect(ray)
    searching, found, place = surface.is_valid(), mi.Bool(False), mi.Float(math.nan)
    for _ in range(MAX_CASTS):
        progress(0.0, "Hidden facets")
        ray.o = dr.select(searching, surface.spawn_ray(ray.d).o, ray.o)
        surface = job.scene.ray_intersect(ray, searching)
        depth = dr.dot(surface.p - rays.position, rays.forward)
        empty = ~surface.is_valid() | (depth >= job.camera.clip_end)
        own_z = dr.select(empty, job.z_low, mapping.z_far + mapping.beta / depth)
        fits = searching & (own_z < limit) & (empty | (dr.dot(surface.n, ray.d) < 0))
        place, found = dr.select(fits, own_z, place), found | fits
        searching &= ~(fits | empty)
        dr.eval(ray, surface, searching, found, place)
    found = np.asarray(found)
    origins, directions = (np.asarray(v)[:, found] for v in (ray.o, ray.d))
    depths = np.full(z.size, np.nan)
    depths[pixels[found]] = np.clip(np.asarray(place)[found], job.z_low, job.z_high)
    radiance = np.zeros((len(hologram.wavelengths), z.size), np.float32)
    radiance[:, pixels[found]] = in_each_wavelength(
        job, lambda: _radiance(job, origins, directions, progress)
    )
    return Sheet(radiance.reshape(-1, *z.shape), depths.reshape(z.shape))


def _radiance(job, origins, directions, progress):
    """Radiance along rays, shape (3, ray), by a quarter of a pixel's paths: only a part of the pupil sees it."""
    import drjit as dr
    import mitsuba as mi

    from ..viewing.preview import path_tracer

    integrator = path_tracer(job.scene, job.camera.sees_sky, job.settings.max_depth)
    paths = max(1, job.paths // 4)
    limit, colors = dr.opaque(mi.UInt32, paths), np.empty(origins.shape, np.float32)
    chunk = max(1, CHUNK_PATHS // paths)
    for first in range(0, origins.shape[1], chunk):
        progress(first / origins.shape[1], "Hidden facets")
        part = slice(first, first + chunk)
        ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(origins[:, part]), mi.Vector3f(directions[:, part])))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(dr.opaque(mi.UInt32, (job.settings.seed * 9973 + first) & 0xFFFFFFFF), dr.width(ray))

        def body(number, light, sampler, ray=ray):
            radiance, _, _ = integrator.sample(job.scene, sampler, ray, None, True)
            return number + 1, light + radiance, sampler

        state = (mi.UInt32(0), dr.zeros(mi.Color3f, dr.width(ray)), sampler)
        _, light, _ = dr.while_loop(state, lambda number, *_: number < limit, body, label="hidden facets")
        colors[:, part] = np.asarray(light) / paths
    return colors
