"""The wave tracer's kernel: rays from pixels of a recording plane through the scene, and back as a wave field.

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
from ..scene.variants import CUDA, activate
from ..waves import libraries

if TYPE_CHECKING:
    from typing import Any

    from ..hologram import Hologram
    from ..light.path_tracer import PathsPerRay
    from ..scene.rays import Rays
    from ..scene.specular_chains import FirstHits, SpecularChains
    from ..waves.arrays import Array
    from .estimators import LatticeEstimator, RandomEstimator
    from .grains import RadianceMap

BRANCH_SHIFT = 37  # pixels; beyond the correlation length of phase maps
STRIPE = 16  # pixels, a power of two: wide enough that stripes stay distinct out of focus


@dataclass(frozen=True)
class Part:
    """Pixels that are traced in the same way.

    Attributes
    ----------
    pixels : numpy.ndarray of uint32
        Numbers, row by row.
    rays : Rays
    estimator : LatticeEstimator or RandomEstimator
    image_finder : FirstHits or SpecularChains
    in_phase : bool
        Whether some light of surfaces is in phase: branches are then kept apart by phases of their own.
    """

    pixels: np.ndarray
    rays: Rays
    estimator: LatticeEstimator | RandomEstimator
    image_finder: FirstHits | SpecularChains
    in_phase: bool = False

    @property
    def rays_per_pixel(self) -> int:
        """Rays of a pixel, branches included."""
        return self.estimator.rays * self.image_finder.branches


@dataclass(frozen=True)
class PhasorMaps:
    """Periodic maps of unit phasors, one per frame, in Dr.Jit memory.

    Attributes
    ----------
    buffer : drjit array
        Result of `packed_phasors`.
    frames, rows, columns : int
        Frames, and pixels of one period.
    """

    buffer: Any
    frames: int
    rows: int
    columns: int

    @classmethod
    def of(cls, phasors: np.ndarray) -> PhasorMaps:
        """Pack complex phasors of shape (frames, rows, columns)."""
        return cls(packed_phasors(phasors), *phasors.shape)

    def at(self, column: mi.Int, row: mi.Int) -> list:
        """Phasors at a column and row, which may lie outside of the period; see `gather_phasors`."""
        index = wrap_index(row, self.rows) * self.columns
        index += wrap_index(column, self.columns)
        return gather_phasors(self.buffer, mi.UInt32(index), self.frames)


@dataclass(frozen=True)
class WaveKernel:
    """The loop over the rays of pixels, one kernel for all wavelengths and frames.

    Attributes
    ----------
    scene : mitsuba.Scene
    hologram : Hologram
    radiance : RadianceMap or PathsPerRay
    seed : int
        Seed of the radiance paths.
    like : array
        Array of the library that a card's results are handed to, without a copy if it computes there.
    """

    scene: mi.Scene
    hologram: Hologram
    radiance: RadianceMap | PathsPerRay
    seed: int
    like: Array

    def draws_random_numbers(self, part: Part) -> bool:
        """Whether rays of a part draw random numbers, which depend on the launch's first pixel."""
        return part.estimator.random(0, 1) is not None or self.radiance.sampler(0, 1) is not None

    def trace(self, part: Part, first: int, count: int, phasors: PhasorMaps) -> Array:
        """Trace the rays of some pixels in one launch, and add up their waves.

        Parameters
        ----------
        part : Part
        first, count : int
            First pixel in the part's list, and number of pixels.
        phasors : PhasorMaps
            Maps of the frames.

        Returns
        -------
        array, complex64, shape (frames, wavelengths, count)
        """
        colors, frames = len(self.hologram.wavelengths), phasors.frames
        pixel = loaded(mi.UInt32, part.pixels[first : first + count])
        across = dr.opaque(mi.UInt32, self.hologram.width)
        column, row = mi.Int(pixel % across), mi.Int(pixel // across)
        pixels = column, row, *part.rays.place(mi.Float(column), mi.Float(row))
        random = part.estimator.random(first, count)
        sampler = self.radiance.sampler(self.seed * 9973 + first, count)
        field = [dr.zeros(mi.Float, count) for _ in range(2 * frames * colors)]

        def body(step, field, random, sampler):
            amplitudes, kernel, grain = self._ray(part, pixels, step, random, sampler)
            phasor = phasors.at(*grain)  # s8
            field = list(field)
            for k, amplitude in enumerate(amplitudes):  # s9
                real, imag = amplitude * kernel[2 * k], amplitude * kernel[2 * k + 1]
                for m in range(frames):
                    cosine, sine, at = phasor[2 * m], phasor[2 * m + 1], 2 * (k * frames + m)
                    field[at] = dr.fma(real, cosine, dr.fma(-imag, sine, field[at]))
                    field[at + 1] = dr.fma(real, sine, dr.fma(imag, cosine, field[at + 1]))
            return step + 1, field, random, sampler

        limit = dr.opaque(mi.UInt32, part.rays_per_pixel)
        state = (mi.UInt32(0), field, random, sampler)
        _, field, _, _ = dr.while_loop(state, lambda step, *_: step < limit, body, label="wave path tracer")
        return _collect(field, frames, colors, count, self.like)

    def _ray(self, part, pixels, step, random, sampler):
        """Amplitude and kernel of each wavelength for one ray of each pixel, and column and row in the phase maps."""
        column, row, x, y = pixels
        rays, estimator, image_finder = part.rays, part.estimator, part.image_finder
        channels = [channel(w) for w in self.hologram.wavelengths]
        branch = step % image_finder.branches
        slope_x, slope_y, direction = estimator.direction(step // image_finder.branches, random)  # s1
        ray, depth_rate = rays.world(x, y, slope_x, slope_y)  # s2
        point = image_finder.view(self.scene, ray, branch)  # s3, s4
        dz = rays.height_over_plane(point.distance, depth_rate, point.hit)  # s6
        first = rays.height_over_plane(point.first, depth_rate, dr.isfinite(point.first))
        weight, dz = rays.weight(first, dz), rays.within(dz)
        right, up = offset = estimator.offset(direction, dz)  # s7
        column, row = column + right, row - up
        grain = (column, row, rays.plane + dz)
        amplitudes, tilt = self.radiance.amplitudes(
            self.scene, rays, sampler, point, grain, (slope_x, slope_y), channels
        )  # s5
        kernel = estimator.kernel(direction, offset, dz, tilt)  # s7
        if part.in_phase:
            kernel = _turn_branches(kernel, point.aside, column)
        amplitudes = [dr.select(point.exists, a, 0) for a in amplitudes]
        if weight is not None:
            amplitudes = [a * weight for a in amplitudes]
        if point.weight is not None:
            weights = [point.weight[c] for c in channels]
            amplitudes = [a * dr.sqrt(dr.maximum(w, 0)) for a, w in zip(amplitudes, weights, strict=True)]
        # branches that end at the same place must not interfere: each uses another part of the phase maps
        shift = mi.Int(point.branch) * BRANCH_SHIFT
        return amplitudes, kernel, (column + shift, row + shift)


def _turn_branches(kernel, aside, column):
    """Turn the kernel of each wavelength by a quarter for branches that are `aside`, so that intensities add up.

    Branches of the second choice, as the reflection in the back of a pane, are turned forth and back in stripes: their
    sum with those of the first choice has the right mean, too, and stays apart from the strongest branch.
    """
    first, second = (aside & 1) != 0, (aside & 2) != 0
    negative = second & ((column & STRIPE) != 0)
    turned = []
    for real, imag in zip(kernel[::2], kernel[1::2], strict=True):
        for straight, quarter in ((real, -imag), (imag, real)):
            value = dr.select(first != second, quarter, straight)
            turned.append(dr.select(negative, -value, value))
    return turned


def _collect(field, frames, colors, count, like):
    """Collect the sums of a launch by wavelength and frame, as an array (frames, colors, count).

    A graphics card puts them in order in its own memory. Where its arrays compute waves they stay there, and else it
    sends them in one piece. Copied one by one they take the processor eight times as long as all rays take the card
    (docs/measurements.md). The processor's own lie in its memory as they are.
    """
    scale = 1 / PHASOR_SCALE
    if activate() == CUDA:
        ordered = dr.empty(mi.Float, 2 * frames * colors * count)
        pixel, across = dr.arange(mi.UInt32, count), dr.opaque(mi.UInt32, count)
        for k, m in np.ndindex(colors, frames):
            at = 2 * (k * frames + m)
            wave = mi.Vector2f(field[at], field[at + 1]) * scale
            place = (m * colors + k) * across + pixel
            # without this mode Dr.Jit would trace anew for each
            dr.scatter(ordered, wave, place, mode=dr.ReduceMode.NoConflicts)
        return libraries.from_drjit(ordered, like).reshape(frames, colors, count)
    dr.eval(field)
    values = np.empty((frames, colors, count), np.complex64)
    for k, m in np.ndindex(colors, frames):
        for n, half in enumerate((values[m, k].real, values[m, k].imag)):
            np.multiply(np.asarray(field[2 * (k * frames + m) + n]), np.float32(scale), out=half)
    return values


def wrap_index(index: mi.Int, size: int) -> mi.Int:
    """Index modulo size, not negative: the phase maps are periodic."""
    rest = index % size
    return dr.select(rest < 0, rest + size, rest)
