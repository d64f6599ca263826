"""Point cloud: a spherical wave from each visible surface point, by a lookup table near recording planes.

    U(x, z_p) = sum_q sqrt(L_q) exp(i phi_q) h(x - x_q, z_p - z_q)    (Waters, Appl. Phys. Lett. 9, 405 (1966))

summed on planes z_p amid the points, where each point's wave h is a few pixels wide (Shimobaba, Masuda and Ito, Opt.
Lett. 34, 3133 (2009)), and from these propagated to the SLM by the angular spectrum method. h is looked up in a table
of depths (Lucente, J. Electron. Imaging 2, 28 (1993)); the number of planes is the fastest one (two: Phan et al., Appl.
Opt. 53, 4817 (2014)). The pupil's center sees one point in each pixel, so that the points form a grid already, and each
pixel of a plane gathers those within its reach, for all frames and wavelengths at once.

phi is random, the same in all wavelengths, and includes the carrier exp(i k z). Points do not occlude one another:
points that an edge hides from other parts of the pupil shine through, and surfaces seen only from there are missing.
Each point has the same radiance in all directions; mirrors and glass show their image on their own surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.fft
import scipy.ndimage

from ..progress import Stages, named, parts
from ..scene.buffers import PHASOR_SCALE, gather_phasors, gather_row, loaded, packed, packed_phasors
from ..slabs import split_depths
from ..tracing.kernel_table import LEVELS, LEVELS_A_GRAIN
from ..tracing.wave_tracer import FRAMES_TOGETHER
from ..waves.propagation import field_of, padded_shape, spectrum, transfer_function
from .layers import gain_for, random_phasor
from .shots import picture_with_depth

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike

    from ..hologram import Hologram
    from ..progress import PartProgress, Progress
    from . import BaselineInput

CONE, TAIL = 1.15, 2.0  # reach of a sub-hologram: factor of the recordable cone's, and pixels to add
PLANE_POINTS = 100  # points that each pixel gathers in the time of propagation to the next plane
MAX_PLANES = 64
DEPTHS = 4096  # resolution of depths for the placement of planes
CHUNK_POINTS = 1 << 24  # gathered between two calls of progress
CHUNK_BYTES = 1 << 27  # of their sums


def field(job: BaselineInput, progress: Progress) -> np.ndarray:
    """Wave field at the SLM; parameters and result as of `baselines.field`."""
    hologram, frames = job.hologram, range(job.settings.frames)
    stages = Stages(progress, "points")
    radiance, z = picture_with_depth(job, stages["image"])
    slabs = slabs_of(hologram, z)
    planes = [0.5 * (low + high) for low, high in slabs]
    slab = np.searchsorted([0.5 * (below[1] + above[0]) for below, above in pairwise(slabs)], z)
    waves = SubHolograms.of(hologram, max(high - low for low, high in slabs) / 2)
    groups = [frames[first:][:FRAMES_TOGETHER] for first in frames[::FRAMES_TOGETHER]]
    phasors = [
        packed_phasors([np.pad(random_phasor(job, m, 0), waves.margin) for m in group]) for group in groups
    ]
    amplitude = np.sqrt(radiance) * np.float32(gain_for(job.settings.frames))
    out = np.zeros((len(frames), *radiance.shape), np.complex64)
    each_plane = parts(stages["waves"], len(planes))
    for number, on_plane in zip(reversed(range(len(planes))), each_plane, strict=True):  # towards the SLM
        points = np.where(slab == number, amplitude, 0)
        plane_stages = Stages(on_plane, "plane of points")
        on_points, on_propagation = (
            named(plane_stages[each], "Points") for each in ("points", "propagation")
        )
        gather(out, waves, planes[number] - z, points, groups, phasors, on_points)
        step = (planes[number - 1] if number else 0.0) - planes[number]
        propagate(out, hologram, step, on_propagation)
    return out


def slabs_of(hologram: Hologram, z: np.ndarray) -> list[tuple[float, float]]:
    """Slabs of the depths, each with a recording plane in its middle: ends (low, high) in meters from the SLM.

    Their number takes the least time, where a pixel gathers pi R^2 points from a slab, R the reach of its outermost.

    Parameters
    ----------
    hologram : Hologram
    z : numpy.ndarray
        Depths of the points, meters from the SLM.
    """
    low, high = float(z.min()), float(z.max())
    depths = low + np.unique(np.round((z - low) / max(high - low, 1e-12) * DEPTHS)) / DEPTHS * (high - low)
    best, min_cost = [], math.inf
    for count in range(1, MAX_PLANES + 1):
        if PLANE_POINTS * count > min_cost:
            break
        slabs = split_depths(depths, count)
        points = sum(math.pi * reach(hologram, 0.5 * (end - begin)) ** 2 for begin, end in slabs)
        if points + PLANE_POINTS * count < min_cost:
            best, min_cost = slabs, points + PLANE_POINTS * count
    return best


def reach(hologram: Hologram, distance: ArrayLike) -> Any:
    """Radius in pixels of the sub-hologram of a point at a distance in meters from the plane."""
    return CONE * hologram.widest_slope * np.abs(distance) / hologram.pitch + TAIL


@dataclass(frozen=True)
class SubHolograms:
    """Lookup table of the waves h of points at all distances from a plane.

    Attributes
    ----------
    values : numpy.ndarray, complex64, shape (level, |y|, |x|, wavelength)
        Waves by pixels from the point, for points before the plane; behind it the wave is the conjugate.
    radii : numpy.ndarray, shape (level,)
        Radius in pixels; the wave is 0 outside.
    scale : float
        Levels per meter.
    """

    values: np.ndarray
    radii: np.ndarray
    scale: float

    @classmethod
    def of(cls, hologram: Hologram, limit: float) -> SubHolograms:
        """Compute the table for points up to a distance.

        h(x, d) = inverse DFT of exp(-i d (k - kz)), even in both frequencies, hence a cosine transform. Frequencies
        outside the recordable circle remain, because propagation removes them: without an edge there waves are
        narrower.

        Parameters
        ----------
        hologram : Hologram
        limit : float
            Largest distance from the plane, meters.
        """
        limit = limit + 1e-9
        widest = reach(hologram, limit)
        levels = int(np.clip(math.ceil(LEVELS_A_GRAIN * widest), *LEVELS))
        distances = (np.arange(levels) + 0.5) / levels * limit
        radii = reach(hologram, distances)
        side = int(widest) + 1
        half = scipy.fft.next_fast_len(side + 24)
        squared = np.arange(half + 1) ** 2 / (2 * half) ** 2
        squared = squared[:, None] + squared
        from_point = np.hypot(*np.mgrid[:side, :side])
        values = np.empty((levels, side, side, len(hologram.wavelengths)), np.complex64)
        for k, wavelength in enumerate(hologram.wavelengths):
            u = (wavelength / hologram.pitch) ** 2 * squared
            retardation = (2 * math.pi / wavelength) * u / (1 + np.sqrt(np.maximum(1 - u, 0)))  # k - kz
            phase = -distances[:, None, None].astype(np.float32) * retardation.astype(np.float32)
            waves = scipy.fft.dctn(np.exp(1j * phase), 1, axes=(1, 2))
            values[..., k] = waves[:, :side, :side] / (2 * half) ** 2
        values[from_point > radii[:, None, None]] = 0
        return cls(values, radii, levels / limit)

    @property
    def margin(self) -> int:
        """Radius of the widest wave, pixels."""
        return self.values.shape[1] - 1


def gather(
    out: np.ndarray,
    waves: SubHolograms,
    distance: np.ndarray,
    amplitude: np.ndarray,
    groups: list[range],
    phasors: list,
    progress: PartProgress,
) -> None:
    """Add the waves of points to fields on a plane.

    Parameters
    ----------
    out : numpy.ndarray, complex64, shape (frame, wavelength, y, x)
        Fields to add to.
    waves : SubHolograms
    distance : numpy.ndarray, shape (y, x)
        Distance from each pixel's point to the plane, meters.
    amplitude : numpy.ndarray, shape (wavelength, y, x)
        Amplitudes of the points; 0 where there is none.
    groups : list of range
        Frames that are summed together.
    phasors : list
        `packed_phasors` of each group's frames, padded by the margin of `waves`.
    progress : callable
        ``progress(done)``, may raise `Cancelled`.
    """
    frames, colors, height, width = out.shape
    margin, side, stride = waves.margin, waves.margin + 1, width + 2 * waves.margin
    level = distance * waves.scale
    points = np.pad(np.stack([level, *amplitude]), ((0, 0), (margin, margin), (margin, margin)))
    points = packed(points.reshape(colors + 1, -1).T.astype(np.float32))
    table = packed(waves.values.reshape(-1, colors).view(np.float32))

    # By growing distance: offset of the point from the pixel in the flat grid, modulo 2^32, and its table entry.
    down, right = np.mgrid[-margin:side, -margin:side].reshape(2, -1)
    order = np.argsort(np.hypot(down, right), kind="stable")
    down, right = down[order], right[order]
    steps = packed(
        np.stack([down * stride + right, abs(down) * side + abs(right)], axis=-1).astype(np.uint32)
    )

    # Each pixel gathers from as far as the widest wave around it.
    radius = waves.radii[np.minimum(abs(level).astype(int), len(waves.radii) - 1)] * amplitude.any(0)
    radius = scipy.ndimage.maximum_filter(radius, 2 * int(radius.max()) + 1, mode="constant")
    counts = np.where(radius > 0, np.searchsorted(np.hypot(down, right), radius, "right"), 0).ravel()
    pixels = np.flatnonzero(counts)
    counts = counts[pixels]
    places = (pixels // width + margin) * stride + pixels % width + margin

    chunk = min(CHUNK_BYTES // (8 * len(groups[0]) * colors), CHUNK_POINTS // counts.max(initial=1))
    out, done = out.reshape(frames, colors, -1), 0
    for group, phasor in zip(groups, phasors, strict=True):
        for first in range(0, len(pixels), chunk):
            part = slice(first, first + chunk)
            sums = _gathered(places[part], counts[part], steps, points, phasor, len(group), table, waves)
            for number, (k, m) in enumerate(np.ndindex(colors, len(group))):
                real, imaginary = (np.asarray(sums[2 * number + n]) for n in (0, 1))
                out[group[m], k, pixels[part]] += (real + 1j * imaginary) / PHASOR_SCALE
            done += counts[part].sum()
            progress(done / (counts.sum() * len(groups)))


def _gathered(places, counts, steps, points, phasors, frames, table, waves):
    """Sums over the first `counts` of the steps from each place: real and imaginary parts by wavelength and frame."""
    levels, side, _, colors = waves.values.shape
    place, limit = (loaded(mi.UInt32, values) for values in (places, counts))
    size, last = dr.opaque(mi.UInt32, side * side), dr.opaque(mi.Float, levels - 1)

    def body(step, sums):
        on, entry = gather_row(steps, step, 2)
        level, *amplitude = gather_row(points, place + on, 1 + colors)
        phasor = gather_phasors(phasors, place + on, frames)
        wave = gather_row(table, mi.UInt32(dr.minimum(dr.abs(level), last)) * size + entry, 2 * colors)
        sums = list(sums)
        for k in range(colors):
            real, imaginary = amplitude[k] * wave[2 * k], amplitude[k] * wave[2 * k + 1]
            imaginary = dr.select(level < 0, -imaginary, imaginary)
            for m in range(frames):
                cosine, sine, at = phasor[2 * m], phasor[2 * m + 1], 2 * (k * frames + m)
                sums[at] = dr.fma(real, cosine, dr.fma(-imaginary, sine, sums[at]))
                sums[at + 1] = dr.fma(real, sine, dr.fma(imaginary, cosine, sums[at + 1]))
        return step + 1, sums

    state = (mi.UInt32(0), [dr.zeros(mi.Float, len(places)) for _ in range(2 * frames * colors)])
    _, sums = dr.while_loop(state, lambda step, *_: step < limit, body, label="point cloud")
    dr.eval(sums)
    return sums


def propagate(out: np.ndarray, hologram: Hologram, distance: float, progress: PartProgress) -> None:
    """Propagate fields in place.

    Parameters
    ----------
    out : numpy.ndarray, complex64, shape (frame, wavelength, y, x)
    hologram : Hologram
    distance : float
        Meters, positive towards the viewer.
    progress : callable
        ``progress(done)``, may raise `Cancelled`.
    """
    frames, colors, *shape = out.shape
    for k, wavelength in enumerate(hologram.wavelengths):
        padded = padded_shape(shape, hologram.pitch, wavelength, distance)
        transfer = transfer_function(padded, hologram.pitch, wavelength, distance)
        for m in range(frames):
            out[m, k] = field_of(spectrum(out[m, k], padded) * transfer, shape)
            progress((k * frames + m + 1) / (colors * frames))
