"""Schedule of the wave tracer: blocks of a recording plane's pixels, launch by launch."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from ..progress import Pace
from ..scene.rays import PACKET
from ..scene.variants import chunks_at_once, units_at_first, units_at_once
from ..waves import arrays
from .wave_kernel import PhasorMaps

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from concurrent.futures import Executor

    from ..hologram import Hologram
    from ..progress import PartProgress
    from ..waves.arrays import Array
    from .wave_kernel import Part, WaveKernel

CHUNK_RAYS = 1 << 22  # of a block; well below a second on two cores
FRAMES_TOGETHER = 32  # accumulators of one kernel; more frames trace again


@dataclass(frozen=True)
class Block:
    """Pixels of a `Part` that are traced at once, and the frames whose waves are added up.

    Attributes
    ----------
    part : int
        Number of the part.
    first, count : int
        First pixel in the part's list, and number of pixels.
    start, stop : int
        Range of frames.
    rays : int
        Rays of all its pixels.
    """

    part: int
    first: int
    count: int
    start: int
    stop: int
    rays: int

    @property
    def work(self) -> int:
        """Rays times frames."""
        return self.rays * (self.stop - self.start)


def blocks_of(parts: Sequence[tuple[int, int]], frames: int, colors: int, chunk: int) -> list[Block]:
    """Divide the pixels and frames of a recording plane into blocks.

    Parameters
    ----------
    parts : sequence of (int, int)
        Pixels of each `Part`, and rays of each pixel.
    frames, colors : int
        Numbers of frames and wavelengths, each of which has a sum per pixel.
    chunk : int
        Maximum bytes of the sums of a block.
    """
    blocks = []
    for start in range(0, frames, FRAMES_TOGETHER):
        stop = min(frames, start + FRAMES_TOGETHER)
        for number, (pixels, rays) in enumerate(parts):
            size = min(CHUNK_RAYS // rays, chunk // (8 * (stop - start) * colors))
            # of whole packets, so that rays meet the same surfaces for any number of frames
            size = max(1, size // PACKET * PACKET or size)
            for first in range(0, pixels, size):
                count = min(size, pixels - first)
                blocks.append(Block(number, first, count, start, stop, count * rays))
    return blocks


def trace_blocks(
    kernel: WaveKernel,
    parts: Sequence[Part],
    blocks: Sequence[Block],
    phasors: np.ndarray,
    chunk: int,
    progress: PartProgress,
) -> Iterator[tuple[Block, np.ndarray, Array]]:
    """Trace the wave field on a recording plane block by block.

    Adjacent blocks are traced in one launch while that is quick, with the same result.

    Parameters
    ----------
    kernel : WaveKernel
    parts : sequence of Part
        Pixels in none of them stay dark.
    blocks : sequence of Block
        Result of `blocks_of` for the same parts and frames.
    phasors : numpy.ndarray, complex64, shape (frames, rows, columns)
        One period of the phase maps.
    chunk : int
        Parameter of `blocks_of`.
    progress : callable
        ``progress(done)``, may raise.

    Yields
    ------
    block : Block
    pixels : numpy.ndarray of uint32
        Numbers, row by row.
    values : array, complex64, shape (frames of the block, wavelengths, pixels)
        Unfiltered: energy outside the circular band is junk, which `propagation` cuts.
    """
    # pixels of one frame in a launch
    max_pixels = chunks_at_once() * chunk // (8 * len(kernel.hologram.wavelengths))
    work, done = sum(block.work for block in blocks), 0
    for (start, stop), same_frames in groupby(blocks, lambda block: (block.start, block.stop)):
        maps = PhasorMaps.of(phasors[start:stop])
        for number, run in groupby(same_frames, lambda block: block.part):
            part = parts[number]
            for block, values in _trace_run(kernel, part, list(run), maps, max_pixels // maps.frames):
                yield block, part.pixels[block.first : block.first + block.count], values
                done += block.work
                progress(done / work)


def _trace_run(kernel, part, blocks, maps, max_pixels):
    """Trace blocks of one part and the same frames; yield each block and its values."""
    pace = Pace(units_at_once(), units_at_first())
    apart = kernel.draws_random_numbers(part)
    while blocks:
        joined = _join(blocks[: 1 if apart else pace.together], max_pixels)
        first, count = joined[0].first, sum(block.count for block in joined)
        with pace():
            values = kernel.trace(part, first, count, maps)
        for block in joined:
            yield block, values[..., block.first - first : block.first - first + block.count]
        blocks = blocks[len(joined) :]


def _join(blocks, max_pixels):
    """Join the first block and those that follow it without a gap, up to a number of pixels."""
    joined = blocks[:1]
    for block in blocks[1:]:
        adjacent = block.first == joined[-1].first + joined[-1].count
        if not adjacent or block.first + block.count - joined[0].first > max_pixels:
            break
        joined.append(block)
    return joined


def add_pixels(out: Array, hologram: Hologram, pixels: np.ndarray, values: Array, executor: Executor) -> None:
    """Add the values of some of the hologram's pixels to a field.

    Parameters
    ----------
    out : array, complex64, shape (frames, wavelengths, height, width)
        NumPy, CuPy or PyTorch; may have a margin around the hologram's pixels. Changed in place.
    hologram : Hologram
    pixels : numpy.ndarray of uint32
        Numbers, row by row.
    values : array, complex64, shape (frames, wavelengths, pixels)
    executor : concurrent.futures.Executor
        Threads, each of which adds a frame.
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
