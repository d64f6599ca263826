"""The wave path tracer: rays from the recording plane through the scene, and back as a wave field.

The paper's stages (section 4) by name: s1 a direction at a pixel (`estimators`), s2 hologram space to world and s3 the
first hit (`rays`), s4 the coherent chain (`specular_chains`), s5 the radiance at its end (`grains`, `path_tracer`), s6
the image point Q in hologram space (`rays`), s7 the path's phase (`estimators`), s8 one random phase a frame and s9 the
accumulation (here).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..hologram import channel
from ..scene.buffers import PHASOR_SCALE, gather_phasors, loaded, packed_phasors

if TYPE_CHECKING:
    from ..hologram import Hologram
    from ..light.path_tracer import PathsPerRay
    from ..progress import PartProgress
    from ..scene.rays import Rays
    from ..scene.specular_chains import FirstHits, SpecularChains
    from .estimators import LatticeEstimator, RandomEstimator
    from .grains import RadianceMap

CHUNK_RAYS = 1 << 22  # between two looks at progress and cancel; well below a second on two cores
BRANCH_SHIFT = 37  # pixels; farther than phases are correlated
FRAMES_TOGETHER = 32  # accumulators of one kernel; more frames trace again


@dataclass(frozen=True)
class Part:
    """Pixels that are traced alike.

    Attributes
    ----------
    pixels : numpy.ndarray of uint32
        Numbers, row by row.
    rays : Rays
    estimator : LatticeEstimator or RandomEstimator
    optics : FirstHits or SpecularChains
    """

    pixels: np.ndarray
    rays: Rays
    estimator: LatticeEstimator | RandomEstimator
    optics: FirstHits | SpecularChains

    @property
    def rays_per_pixel(self) -> int:
        """Branches included."""
        return self.estimator.rays * self.optics.branches


def trace_field(
    scene: mi.Scene,
    hologram: Hologram,
    parts: list[Part],
    radiance: RadianceMap | PathsPerRay,
    phasors: np.ndarray,
    seed: int,
    progress: PartProgress,
    out: np.ndarray,
    chunk: int = 1 << 27,
) -> None:
    """Add the wave field on the recording plane: all frames and wavelengths from one traversal.

    Parameters
    ----------
    scene : mitsuba.Scene
    hologram : Hologram
    parts : list of Part
        What is in none of them stays dark.
    radiance : RadianceMap or PathsPerRay
    phasors : numpy.ndarray, complex64, shape (frames, rows, columns)
        One period of the phase maps.
    seed : int
        Of the radiance paths.
    progress : callable
        ``progress(done)``, may raise.
    out : numpy.ndarray, complex64, shape (frames, wavelengths, height, width)
        To which the field is added, with a margin around the hologram's pixels or without. It is unfiltered: energy
        outside the circular band is junk, which `propagation` cuts.
    chunk : int
        Bytes of the sums of pixels that are traced at once.
    """
    width, height, colours = hologram.width, hologram.height, len(hologram.wavelengths)
    channels = [channel(w) for w in hologram.wavelengths]
    _, period_rows, period_columns = phasors.shape

    def trace_chunk(part, first, size, phasor_buffer, frames):
        rays, estimator, optics = part.rays, part.estimator, part.optics
        index = loaded(mi.UInt32, part.pixels[first : first + size])
        across = dr.opaque(mi.UInt32, width)
        column, row = mi.Int(index % across), mi.Int(index // across)
        x, y = rays.place(mi.Float(column), mi.Float(row))
        random = estimator.random(first, size)
        sampler = radiance.sampler(seed * 9973 + first, size)
        field = [dr.zeros(mi.Float, size) for _ in range(2 * frames * colours)]

        def body(step, field, random, sampler):
            branch = step % optics.branches
            slope_x, slope_y, place = estimator.direction(step // optics.branches, random)  # s1
            ray, depth_rate = rays.world(x, y, slope_x, slope_y)  # s2
            seen = optics.view(scene, ray, branch)  # s3, s4
            dz = rays.height_over_plane(seen.distance, depth_rate, seen.hit)  # s6
            first = rays.height_over_plane(seen.first, depth_rate, dr.isfinite(seen.first))
            share, dz = rays.share(first, dz), rays.within(dz)
            over, up = offset = estimator.offset(place, dz)  # s7
            grain_column, grain_row = column + over, row - up
            grain = (grain_column, grain_row, rays.plane + dz)
            amplitude, tilt = radiance.amplitudes(
                scene, rays, sampler, seen, grain, (slope_x, slope_y), channels
            )  # s5
            kernel = estimator.kernel(place, offset, dz, tilt)  # s7
            amplitude = [dr.select(seen.exists, a, 0) for a in amplitude]
            if share is not None:
                amplitude = [a * share for a in amplitude]
            if seen.weight is not None:
                shares = [seen.weight[c] for c in channels]
                amplitude = [
                    a * dr.sqrt(dr.maximum(share, 0)) for a, share in zip(amplitude, shares, strict=True)
                ]
            # branches that end at the same place must not interfere: each looks elsewhere in the phase maps
            aside = mi.Int(seen.branch) * BRANCH_SHIFT
            grain = _wrapped(grain_row + aside, period_rows) * period_columns
            grain += _wrapped(grain_column + aside, period_columns)
            phasor = gather_phasors(phasor_buffer, mi.UInt32(grain), frames)  # s8
            field = list(field)
            for k, a in enumerate(amplitude):  # s9
                real, imag = a * kernel[2 * k], a * kernel[2 * k + 1]
                for m in range(frames):
                    cosine, sine, at = phasor[2 * m], phasor[2 * m + 1], 2 * (k * frames + m)
                    field[at] = dr.fma(real, cosine, dr.fma(-imag, sine, field[at]))
                    field[at + 1] = dr.fma(real, sine, dr.fma(imag, cosine, field[at + 1]))
            return step + 1, field, random, sampler

        limit = dr.opaque(mi.UInt32, part.rays_per_pixel)
        state = (mi.UInt32(0), field, random, sampler)
        _, field, _, _ = dr.while_loop(state, lambda step, *_: step < limit, body, label="wave path tracer")
        dr.eval(field)
        return field

    across = out.shape[-1]
    begin = (out.shape[-2] - height) // 2 * across + (across - width) // 2
    flat = out.reshape(len(phasors), colours, -1)
    work = len(phasors) * sum(len(part.pixels) * part.rays_per_pixel for part in parts)
    done = 0
    for start in range(0, len(phasors), FRAMES_TOGETHER):
        group = phasors[start : start + FRAMES_TOGETHER]
        phasor_buffer = packed_phasors(group)
        for part in parts:
            together = min(CHUNK_RAYS // part.rays_per_pixel, chunk // (8 * len(group) * colours))
            for first in range(0, len(part.pixels), max(1, together)):
                pixels = part.pixels[first : first + max(1, together)]
                field = trace_chunk(part, first, len(pixels), phasor_buffer, len(group))
                places = begin + pixels // width * across + pixels % width
                for k, m in np.ndindex(colours, len(group)):
                    real, imaginary = (np.asarray(field[2 * (k * len(group) + m) + n]) for n in (0, 1))
                    flat[start + m, k, places] += (real + 1j * imaginary) * np.float32(1 / PHASOR_SCALE)
                done += len(pixels) * part.rays_per_pixel * len(group)
                progress(done / work)


def _wrapped(index, size):
    """Index modulo size, not negative: the phase maps are periodic."""
    rest = index % size
    return dr.select(rest < 0, rest + size, rest)
