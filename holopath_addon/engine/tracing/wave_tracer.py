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
from ..progress import Pace
from ..scene.buffers import PHASOR_SCALE, gather_phasors, loaded, packed_phasors
from ..scene.rays import PACKET
from ..scene.variants import CUDA, activate, chunks_at_once, units_at_first, units_at_once
from ..waves import arrays, libraries
from ..waves.arrays import PROCESSOR, Array

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from concurrent.futures import Executor

    from ..hologram import Hologram
    from ..light.path_tracer import PathsPerRay
    from ..progress import PartProgress
    from ..scene.rays import Rays
    from ..scene.specular_chains import FirstHits, SpecularChains
    from .estimators import LatticeEstimator, RandomEstimator
    from .grains import RadianceMap

CHUNK_RAYS = 1 << 22  # of a block; well below a second on two cores
BRANCH_SHIFT = 37  # pixels; farther than phases are correlated
STRIPE = 16  # pixels, a power of two: wide enough that stripes stay what they are out of focus
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
    in_phase : bool
        Whether surfaces are in phase, in part: branches are then apart by phases of their own.
    """

    pixels: np.ndarray
    rays: Rays
    estimator: LatticeEstimator | RandomEstimator
    optics: FirstHits | SpecularChains
    in_phase: bool = False

    @property
    def rays_per_pixel(self) -> int:
        """Branches included."""
        return self.estimator.rays * self.optics.branches


@dataclass(frozen=True)
class Block:
    """Pixels of a `Part` that are traced at once, and the frames whose waves are added up meanwhile.

    Attributes
    ----------
    part : int
        Its number.
    first, count : int
        Pixels of the part, by their place in its list.
    start, stop : int
        Frames.
    rays : int
        Of all its pixels.
    """

    part: int
    first: int
    count: int
    start: int
    stop: int
    rays: int

    @property
    def work(self) -> int:
        """Rays, times frames."""
        return self.rays * (self.stop - self.start)


def blocks_of(parts: Sequence[tuple[int, int]], frames: int, colours: int, chunk: int) -> list[Block]:
    """All that is to be traced on a recording plane.

    Parameters
    ----------
    parts : sequence of (int, int)
        Pixels of each `Part`, and rays of one of them.
    frames, colours : int
        Whose sums a pixel has.
    chunk : int
        Bytes of the sums of pixels that are traced at once.
    """
    found = []
    for start in range(0, frames, FRAMES_TOGETHER):
        stop = min(frames, start + FRAMES_TOGETHER)
        for number, (pixels, rays) in enumerate(parts):
            together = min(CHUNK_RAYS // rays, chunk // (8 * (stop - start) * colours))
            # of whole packets rays meet the same surfaces, however many frames they are for
            together = max(1, together // PACKET * PACKET or together)
            for first in range(0, pixels, together):
                count = min(together, pixels - first)
                found.append(Block(number, first, count, start, stop, count * rays))
    return found


def trace_blocks(
    scene: mi.Scene,
    hologram: Hologram,
    parts: Sequence[Part],
    blocks: Sequence[Block],
    radiance: RadianceMap | PathsPerRay,
    phasors: np.ndarray,
    seed: int,
    chunk: int,
    progress: PartProgress,
    on: Array = PROCESSOR,
) -> Iterator[tuple[Block, np.ndarray, Array]]:
    """The wave field on the recording plane, block by block: all wavelengths from one traversal.

    Blocks side by side are traced as one while that is quick, with the same result.

    Parameters
    ----------
    scene : mitsuba.Scene
    hologram : Hologram
    parts : sequence of Part
        What is in none stays dark.
    blocks : sequence of Block
        Of `blocks_of` for the same parts and frames.
    radiance : RadianceMap or PathsPerRay
    phasors : numpy.ndarray, complex64, shape (frames, rows, columns)
        One period of the phase maps.
    seed : int
        Of the radiance paths.
    chunk : int
        As of `blocks_of`.
    progress : callable
        ``progress(done)``, may raise.
    on : array, optional
        Of the library whose arrays values of a card are: without a copy if it computes there. Default: NumPy's.

    Yields
    ------
    block : Block
    pixels : numpy.ndarray of uint32
        Numbers, row by row.
    values : array, complex64, shape (frames of the block, wavelengths, pixels)
        Unfiltered: energy outside the circular band is junk, which `propagation` cuts.
    """
    width, colours = hologram.width, len(hologram.wavelengths)
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
            if part.in_phase:
                kernel = _apart(kernel, seen.aside, grain_column)
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
        return _sums(field, frames, colours, size, on)

    work, done, packed = sum(block.work for block in blocks), 0, (-1, None)
    most = chunks_at_once() * chunk // (8 * colours)  # pixels of one frame in a launch
    pace, traced, left = Pace(units_at_once(), units_at_first()), -1, list(blocks)
    while left:
        if left[0].part != traced:  # whose rays may be dearer
            pace, traced = Pace(units_at_once(), units_at_first()), left[0].part
        block, part, frames = left[0], parts[left[0].part], left[0].stop - left[0].start
        if packed[0] != block.start:  # the frames that are traced together
            packed = block.start, packed_phasors(phasors[block.start : block.stop])
        # random numbers are each block's own
        drawn = part.estimator.random(0, 1) is not None or radiance.sampler(0, 1) is not None
        joined = _joined(left[: 1 if drawn else pace.together], most // frames)
        size = sum(each.count for each in joined)
        with pace():
            values = trace_chunk(part, block.first, size, packed[1], frames)
        for each in joined:
            at = slice(each.first - block.first, each.first - block.first + each.count)
            yield each, part.pixels[each.first : each.first + each.count], values[..., at]
            done += each.work
            progress(done / work)
        del left[: len(joined)], values


def _apart(kernel, aside, column):
    """The kernel of each wavelength, turned by a quarter for what is seen `aside`: intensities add up.

    What is so by the second choice, as is the reflection in the back of a pane, is turned forth and back in stripes:
    added to what is so by the first its mean is right, too, and it stays apart from the strongest.
    """
    first, second = (aside & 1) != 0, (aside & 2) != 0
    negative = second & ((column & STRIPE) != 0)
    turned = []
    for real, imag in zip(kernel[::2], kernel[1::2], strict=True):
        for straight, quarter in ((real, -imag), (imag, real)):
            value = dr.select(first != second, quarter, straight)
            turned.append(dr.select(negative, -value, value))
    return turned


def _sums(field, frames, colours, size, on):
    """Sums of a launch, real and imaginary parts of each wavelength's frames, as complex64 (frames, colours, size).

    A graphics card puts them in order in its own memory. Where its arrays compute waves they stay there, and else it
    sends them in one piece. Copied one by one they take the processor eight times as long as all rays take the card
    (docs/measurements.md). The processor's own lie in its memory as they are.
    """
    scale = 1 / PHASOR_SCALE
    if activate() == CUDA:
        ordered = dr.empty(mi.Float, 2 * frames * colours * size)
        pixel, across = dr.arange(mi.UInt32, size), dr.opaque(mi.UInt32, size)
        for k, m in np.ndindex(colours, frames):
            at = 2 * (k * frames + m)
            wave = mi.Vector2f(field[at], field[at + 1]) * scale
            place = (m * colours + k) * across + pixel
            # without this mode Dr.Jit would trace anew for each
            dr.scatter(ordered, wave, place, mode=dr.ReduceMode.NoConflicts)
        return libraries.from_drjit(ordered, on).reshape(frames, colours, size)
    dr.eval(field)
    values = np.empty((frames, colours, size), np.complex64)
    for k, m in np.ndindex(colours, frames):
        for n, half in enumerate((values[m, k].real, values[m, k].imag)):
            np.multiply(np.asarray(field[2 * (k * frames + m) + n]), np.float32(scale), out=half)
    return values


def _joined(blocks, most):
    """The first of some blocks, and those after it that can be traced with it: so many pixels in a row at most."""
    joined = blocks[:1]
    for block in blocks[1:]:
        last = joined[-1]
        alike = (block.part, block.start, block.stop) == (last.part, last.start, last.stop)
        if not alike or block.first != last.first + last.count:
            break
        if block.first + block.count - joined[0].first > most:
            break
        joined.append(block)
    return joined


def add_pixels(out: Array, hologram: Hologram, pixels: np.ndarray, values: Array, executor: Executor) -> None:
    """Add the values of some of the hologram's pixels.

    Parameters
    ----------
    out : array, complex64, shape (frames, wavelengths, height, width)
        Of NumPy, CuPy or PyTorch. With a margin around the hologram's pixels or without.
    hologram : Hologram
    pixels : numpy.ndarray of uint32
        Numbers, row by row.
    values : array, complex64, shape (frames, wavelengths, pixels)
    executor : concurrent.futures.Executor
        Of threads, by frames.
    """
    across, flat = out.shape[-1], out.reshape(*out.shape[:2], -1)
    begin = (out.shape[-2] - hologram.height) // 2 * across + (across - hologram.width) // 2
    places = (begin + pixels // hologram.width * across + pixels % hologram.width).astype(np.intp)
    if not isinstance(out, np.ndarray):
        flat[..., arrays.like(places, out)] += arrays.like(values, out)
        return

    def add(frame):
        for wave, more in zip(flat[frame], values[frame], strict=True):
            wave[places] += more

    list(executor.map(add, range(len(values))))


def _wrapped(index, size):
    """Index modulo size, not negative: the phase maps are periodic."""
    rest = index % size
    return dr.select(rest < 0, rest + size, rest)
