"""Polygons: every facet in view shines from where it lies, tilted as it is, and blocks what lies behind it.

A facet is a surface function on its plane: the root of its radiance with random phases, which spread the light of a
large facet over the whole cone (Matsushima, Appl. Opt. 44, 4607 (2005); Matsushima and Nakahara, Appl. Opt. 48, H54
(2009)); the transform of a triangle of even phase (Kim, Hahn and Lee, Appl. Opt. 47, D117 (2008)) shines into a narrow
cone and shows no texture. Its angular spectrum is that of the surface function h with the frequencies turned with the
plane (Ahrenberg et al., Appl. Opt. 47, 1567 (2008)): with dz(x) = a.x the facet's height over a plane and lag = k - kz

    U(f) = int h(x) exp(i lag(f) dz(x) - 2 pi i f.x) d2x = H(f - a lag(f) / (2 pi))

Resampling H for each facet is what takes these authors' time. Here volumes are cut into slabs of half thickness t, for
which the kernel separates (Jacobi and Anger), so that a few transforms give all facets of a slab at once, however many:

    exp(i lag dz) = sum_j (2 - [j = 0]) i^j J_j(lag t) T_j(dz / t)

Hidden surfaces go by the silhouette method, from far to near (Matsushima, Nakamura and Nakahara, Opt. Express 22, 24450
(2014)): facets block what comes from behind, in the middle of their slab. They let the light of the slab next to theirs
pass, for that is where facets of the same surface continue, whose light silhouettes of pixels would clip.

Facets are found by rays through the pixels, not by projecting vertices: balls and millions of triangles cost no more
than one, and of those smaller than a pixel one is kept. Radiance is the pinhole's: highlights do not move across the
pupil, mirrors and glass are pictures on themselves. Hidden facets near edges have paths of their own; only the first
one behind another that faces the viewer is kept.
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

from ..waves.propagation import circular_band, field_of, lag, propagate, spectrum, transfer_function
from .layers import gain_for, random_phasor
from .shots import in_each_wavelength, picture_with_depth

if TYPE_CHECKING:
    from ..progress import Progress
    from . import BaselineInput

MOST_SLABS = 64
TOLERANCE = 0.05  # of the kernel where the band ends
GAP = 2  # slabs that a hidden facet lies behind what hides it at least: nearer ones are not blocked
CASTS = 8  # surfaces that are looked behind
BRANCH_SHIFT = 37  # pixels between the phases of facets behind one another
CHUNK_PATHS = 1 << 18


@dataclass(frozen=True)
class Sheet:
    """Facets that do not lie behind one another, at the pixels' centers.

    Attributes
    ----------
    radiance : numpy.ndarray, float32, shape (wavelength, y, x)
    z : numpy.ndarray, float64, shape (y, x)
        Meters from the SLM; NaN where there is none.
    """

    radiance: np.ndarray
    z: np.ndarray


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """The wave field at the SLM; parameters as of `baselines.BaselineInput`, progress may raise.

    Returns
    -------
    numpy.ndarray, complex64, shape (frame, wavelength, y, x)
    """
    hologram, frames = job.hologram, job.settings.frames
    sheets = sheets_of(job, lambda done, what: progress(0.4 * done, what))
    count, half = slabs_of(job)
    placed = [_placed(sheet.z, job.z_low, count, half) for sheet in sheets]
    walk = math.ceil(hologram.widest_slope * (job.z_high - job.z_low) / hologram.pitch) + 8
    # light that leaves the picture on its way may come back to the SLM
    window = [n + 2 * walk for n in job.shape]
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
            begun = (k * frames + m) / (len(hologram.wavelengths) * frames)
            share = 0.6 / (len(hologram.wavelengths) * frames * count)
            far, last = None, None  # spectra: of the slabs that have been passed, and of the one just behind
            for slab in range(count):
                progress(0.4 + 0.6 * begun + slab * share, "Polygons")
                here = [number == slab for number, _ in placed]
                far = _masked(None if far is None else far * step, np.logical_or.reduce(here))
                if last is not None:
                    far = last * step if far is None else far + last * step
                last = _slab_spectrum(light, here, [height for _, height in placed], bessel, padded)
            total = sum(part for part in (far, last) if part is not None)
            wave = np.roll(field_of(total, padded), walk, (0, 1))[: window[0], : window[1]]
            wave = propagate(wave, to_slm, hologram.pitch, wavelength)
            out[m, k] = wave[walk : walk + job.shape[0], walk : walk + job.shape[1]]
    return out


def slabs_of(job: BaselineInput) -> tuple[int, float]:
    """Number of slabs, a quarter of a depth of focus thick or as thick as `MOST_SLABS` are, and half the thickness."""
    thickness = job.z_high - job.z_low
    count = int(np.clip(math.ceil(thickness / (0.25 * job.hologram.depth_of_focus)), 1, MOST_SLABS))
    return count, max(0.5 * thickness / count, 1e-9)


def tilts(shape: tuple[int, int], pitch: float, wavelength: float, half: float) -> list[np.ndarray]:
    """J_j(lag t) for as many j as the tolerance asks for.

    Parameters
    ----------
    shape : (int, int)
        Padded rows and columns.
    pitch, wavelength : float
        Meters.
    half : float
        Half thickness t of a slab, meters.

    Returns
    -------
    list of numpy.ndarray, float32, `shape`, in FFT order
    """
    band, turn = circular_band(shape), lag(shape, pitch, wavelength) * half
    steepest = float(turn[band].max())
    terms = next(j for j in itertools.count(1) if j > steepest and abs(2 * jv(j, steepest)) < TOLERANCE)
    table = np.linspace(0, steepest, 1 << 12)
    return [np.where(band, np.interp(turn, table, jv(j, table)), 0).astype(np.float32) for j in range(terms)]


def _placed(z, low, count, half):
    """Slab of each facet, -1 where there is none, and height over its middle in half thicknesses."""
    position = np.where(np.isnan(z), -1, (z - low) / (2 * half))
    slab = np.minimum(np.floor(position), count - 1).astype(int)
    return slab, (2 * (position - slab) - 1).astype(np.float32)


def _slab_spectrum(light, here, heights, bessel, padded):
    """Spectrum in the middle of a slab of the facets in it, None without any."""
    if not any(part.any() for part in here):
        return None
    source = sum(np.where(part, value, 0) for part, value in zip(here, light, strict=True))
    height = sum(np.where(part, value, 0) for part, value in zip(here, heights, strict=True))
    total = np.zeros(padded, np.complex64)
    before, chebyshev = height, np.ones_like(height)  # T_-1 = T_1
    for j, weight in enumerate(bessel):
        part = spectrum(np.complex64((1 if j == 0 else 2) * 1j**j) * chebyshev * source, padded)
        part *= weight
        total += part
        before, chebyshev = chebyshev, 2 * height * chebyshev - before
    return total


def _masked(waves, blocked):
    """A spectrum after facets in the pixels `blocked`."""
    if waves is None or not blocked.any():
        return waves
    wave = field_of(waves, waves.shape)
    wave[: blocked.shape[0], : blocked.shape[1]][blocked] = 0
    return spectrum(wave, waves.shape)


def sheets_of(job: BaselineInput, progress: Progress) -> list[Sheet]:
    """Facets that the pinhole sees, and those they hide where others in the pupil may see them.

    Parameters
    ----------
    job : BaselineInput
    progress : callable
        ``progress(done, message)``, may raise.

    Returns
    -------
    list of Sheet
    """
    radiance, z = picture_with_depth(job, lambda done, what: progress(0.7 * done, what))
    gap = GAP * 2 * slabs_of(job)[1]
    reach = math.ceil(job.hologram.widest_slope * (job.z_high - job.z_low) / job.hologram.pitch)
    beside_edge = minimum_filter(z, 2 * reach + 1) < z - gap
    if not beside_edge.any():
        return [Sheet(radiance, z)]
    behind = hidden(
        job, z, gap, np.flatnonzero(beside_edge), lambda done, what: progress(0.7 + 0.3 * done, what)
    )
    return [Sheet(radiance, z), behind]


def hidden(job: BaselineInput, z: np.ndarray, gap: float, pixels: np.ndarray, progress: Progress) -> Sheet:
    """The nearest facets behind the first ones that face the viewer.

    Parameters
    ----------
    job : BaselineInput
    z : numpy.ndarray, shape (y, x)
        Of the first ones, meters from the SLM.
    gap : float
        Least distance from them, meters.
    pixels : numpy.ndarray of int
        Where to look, numbers row by row.
    progress : callable
        ``progress(done, message)``, may raise.

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
    for _ in range(CASTS):
        progress(0.0, "Hidden facets")
        ray.o = dr.select(searching, surface.spawn_ray(ray.d).o, ray.o)
        surface = job.scene.ray_intersect(ray, searching)
        depth = dr.dot(surface.p - rays.position, rays.forward)
        nothing = ~surface.is_valid() | (depth >= job.camera.clip_end)
        here = dr.select(nothing, job.z_low, mapping.z_far + mapping.beta / depth)
        fits = searching & (here < limit) & (nothing | (dr.dot(surface.n, ray.d) < 0))
        place, found = dr.select(fits, here, place), found | fits
        searching &= ~(fits | nothing)
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
    """Radiance along rays, shape (3, ray), by a quarter of the paths of a pixel: a part of the pupil sees them."""
    import drjit as dr
    import mitsuba as mi

    from ..viewing.preview import path_tracer

    integrator = path_tracer(job.scene, job.camera.sees_sky, job.settings.max_depth)
    paths = max(1, job.paths // 4)
    limit, colors = dr.opaque(mi.UInt32, paths), np.empty(origins.shape, np.float32)
    at_once = max(1, CHUNK_PATHS // paths)
    for first in range(0, origins.shape[1], at_once):
        progress(first / origins.shape[1], "Hidden facets")
        part = slice(first, first + at_once)
        ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(origins[:, part]), mi.Vector3f(directions[:, part])))
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(dr.opaque(mi.UInt32, job.settings.seed * 9973 + first), dr.width(ray))

        def body(number, light, sampler, ray=ray):
            found, _, _ = integrator.sample(job.scene, sampler, ray, None, True)
            return number + 1, light + found, sampler

        state = (mi.UInt32(0), dr.zeros(mi.Color3f, dr.width(ray)), sampler)
        _, light, _ = dr.while_loop(state, lambda number, *_: number < limit, body, label="hidden facets")
        colors[:, part] = np.asarray(light) / paths
    return colors
