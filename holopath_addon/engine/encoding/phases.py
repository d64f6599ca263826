"""Phases during a descent, and their light."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING

import numpy as np

from ..waves import arrays
from ..waves.modulator import wrapped

if TYPE_CHECKING:
    from ..waves.arrays import Array
    from ..waves.lens import Collins
    from ..waves.modulator import Levels
    from ..waves.supervision import FramePool
    from .shown_light import ShownLight

# Decays of Adam's means (Kingma and Ba, ICLR 2015): of slopes, if each step evaluates everything, of slopes if it
# evaluates few of many views, and of squares. With 0.9 and 0.99 for few views, 40 steps are 0.7 dB worse
# (docs/theory.md).
MEMORY, FEW_VIEWS_MEMORY, SQUARES_MEMORY = 0.9, 0.6, 0.9
MIN_SQUARE = 1e-30  # for pixels whose slope is zero
FINE = 0.1  # radians between levels, up to which it is enough to round phases at the end
WHOLE = 0.0, 2 * math.pi * (1 - 1 / 256)  # ends of a turn, radians
BLOCK = 1 << 16  # pixels that fit into a processor's cache; with fewer, threads often wait for Python


class Phases:
    """Phases of all frames in one wavelength.

    Pixels are processed block by block in the threads of the FFTs: a second pool of threads, of Dr.Jit's kernels, would
    cost more time than the blocks do.

    Parameters
    ----------
    start : array, float32 or float64, shape (frame, y, x)
        Phases to start with, radians. Its type and library are those of the computation.
    pool : FramePool
    display : ShownLight, optional
        Display that turns phases into light; its phases stay between `ends`, as it would blur neighboring pixels across
        the jump from one turn to the next. Default: an ideal display.
    ends : (float, float)
        Minimum and maximum phase of the display, radians.
    beam : array, complex, shape (y, x), optional
        Light that illuminates an ideal display. Default: 1.
    lens : Collins, optional
        Propagation from an ideal display to where light is compared. Default: light is compared at the display.

    Attributes
    ----------
    light : array, complex, shape (frame, y, x)
        beam exp(i phase), or the display's light, or that behind the lens.
    """

    def __init__(
        self,
        start: Array,
        pool: FramePool,
        display: ShownLight | None = None,
        ends: tuple[float, float] = WHOLE,
        beam: Array | None = None,
        lens: Collins | None = None,
    ) -> None:
        self._xp = xp = arrays.namespace(start)
        self._angle = xp.reshape(arrays.copied(start), (start.shape[0], -1))
        if display is not None:
            self._angle = ends[0] + xp.remainder(self._angle - ends[0], 2 * math.pi)
        self._pool, self._shape = pool, tuple(start.shape)
        self._beam = None if beam is None else xp.reshape(beam, (-1,))
        kind = "complex64" if start.dtype == xp.float32 else "complex128"
        self._light = arrays.empty(self._angle.shape, kind, start)
        self._means: Array | None = None
        self._free: Array | None = None
        self._count = 0
        self._local, self._display, self._ends = threading.local(), display, ends
        self._lens = lens
        self._each(self._show)

    @property
    def light(self) -> Array:
        """Light of the phases where it is compared, see the class."""
        display, lens = self._display, self._lens
        if display is not None:
            return self._stack(lambda frame: display.light(self._frame(frame)))
        light = self._xp.reshape(self._light, self._shape)
        return light if lens is None else self._stack(lambda frame: lens.propagate(light[frame, ...]))

    def _stack(self, work):
        """Stack of the results of a function of the frame's index."""
        return self._xp.stack(self._pool.each(work, self._shape[0]))

    def _frame(self, frame):
        """Phases of a frame, shape (y, x)."""
        return self._xp.reshape(self._angle[frame, :], self._shape[1:])

    def descend(self, back: Array, factors: np.ndarray, rate: float, memory: float = MEMORY) -> None:
        """Take a step of Adam.

        Sums of slopes and of their squares are kept instead of means, which takes fewer passes over the pixels.

        Parameters
        ----------
        back : array, complex, shape (frame, y, x)
            G with dL = 2 Re sum conj(G) du for a change du of the light, so that the phases' slope is 2 Im(conj(u) G).
        factors : sequence of complex
            Factor of each frame of `back`.
        rate : float
            Length of a step with a constant slope, radians.
        memory : float
            Decay of the mean of earlier slopes.
        """
        if self._means is None:
            self._means = arrays.zeros((2, *self._angle.shape), self._angle.dtype, self._angle)
            self._means[1, ...] = MIN_SQUARE
        means, free, xp = self._means, self._free, self._xp
        back, weights = self._at_pixels(back, factors)
        self._count += 1
        first, second = memory, SQUARES_MEMORY
        scale = (1 - first) / (1 - first**self._count), (1 - second) / (1 - second**self._count)
        length = rate * scale[0] / math.sqrt(scale[1])

        def move(frame, block, rows):
            mean, square = means[0, frame, block], means[1, frame, block]
            slope = self._slope(frame, block, back[frame, rows, :], weights[frame])
            mean *= first
            mean += slope
            slope *= slope
            square *= second
            square += slope
            slope = arrays.into(slope, xp.sqrt, square)
            slope = arrays.into(slope, xp.divide, mean, slope)
            slope *= length
            if free is not None:
                slope *= free[frame, block]
            self._angle[frame, block] -= slope
            self._show(frame, block, rows)

        self._each(move)

    def fix(self, fraction: float, levels: Levels) -> None:
        """Fix a fraction of each frame's pixels to their levels for good: those nearest to them.

        The free pixels compensate for the error in the next steps. Rounding in each step while the phases below it go
        on (a straight-through estimator) was worse than rounding afterwards, this is better (docs/theory.md). Pixels
        between levels no farther apart than `FINE` stay free, as it is enough to round them at the end. If most are,
        the others are soon fixed, and there is time to compensate for them.

        Parameters
        ----------
        fraction : float
            Fraction of all pixels that are fixed afterwards, 0 to 1.
        levels : Levels
        """
        xp = self._xp
        if self._free is None:
            self._free = arrays.mask(np.ones(self._angle.shape, bool), self._angle)

        def each(frame):
            angle, free = self._angle[frame, :], self._free[frame, :]
            target, gaps = levels.nearest(angle)
            fixable = (free > 0) & (gaps > FINE)
            free_count, max_count = (int(xp.count_nonzero(each)) for each in (free, fixable))
            count = min(round(fraction * angle.shape[0]) - (angle.shape[0] - free_count), max_count)
            if count < 1:
                return
            distance = xp.where(fixable, xp.abs(angle - target), math.inf)
            chosen = fixable & (distance <= arrays.smallest(distance, count))
            angle[chosen], free[chosen] = target[chosen], 0

        self._pool.each(each, self._shape[0])
        self._each(self._show)

    def set(self, values: Array) -> None:
        """Set the phases to earlier `values`."""
        self._angle[...] = self._xp.reshape(values, self._angle.shape)
        self._each(self._show)

    def values(self) -> Array:
        """Return the phases, radians in [0, 2 pi), float32."""
        return self._xp.reshape(wrapped(self._angle), self._shape)

    def _at_pixels(self, back, factors):
        """G and factors with respect to exp(i phase), from those with respect to `light`."""
        display, lens = self._display, self._lens
        if lens is not None:
            return self._stack(lambda frame: lens.adjoint(back[frame, ...])), factors
        if display is None:
            return back, factors
        light = self._xp.reshape(self._light, self._shape)

        def each(frame):
            slope = display.slope(self._frame(frame), back[frame, ...] * complex(factors[frame]))
            return 0.5j * light[frame, ...] * slope

        return arrays.as_type(self._stack(each), light.dtype), [1.0] * len(factors)

    def _slope(self, frame, block, back, factor):
        (product, slope, _), xp = self._scratch(block), self._xp
        product = arrays.into(product, xp.conj, self._light[frame, block])
        shaped = xp.reshape(product, back.shape)
        product = xp.reshape(arrays.into(shaped, xp.multiply, shaped, back), (-1,))
        factor = complex(factor)
        if factor.imag:
            product *= factor
            factor = 1 + 0j
        return arrays.into(slope, xp.multiply, xp.imag(product), 2 * factor.real)

    def _show(self, frame, block, rows):
        (_, first, second), xp = self._scratch(block), self._xp
        angle, light = self._angle[frame, block], self._light[frame, block]
        if self._display is not None:
            arrays.put(angle, xp.clip, angle, *self._ends)
        arrays.set_parts(light, arrays.into(first, xp.cos, angle), arrays.into(second, xp.sin, angle))
        if self._beam is not None:
            light *= self._beam[block]

    def _scratch(self, block):
        """Scratch memory of this thread for a block, one complex and two real arrays; None except on the processor."""
        if self._xp is not np:
            return [None] * 3
        count = block.stop - block.start
        if getattr(self._local, "size", 0) < count:
            self._local.size = count
            self._local.scratch = np.empty(count, self._light.dtype), *np.empty((2, count), self._angle.dtype)
        return [memory[:count] for memory in self._local.scratch]

    def _each(self, work):
        """Call ``work(frame, block of pixels, the same block as rows)`` for all blocks."""
        rows, columns = self._shape[1:]
        height = max(1, BLOCK // columns) if self._xp is np else rows

        def each(frame):
            for first in range(0, rows, height):
                last = min(first + height, rows)
                work(frame, slice(first * columns, last * columns), slice(first, last))

        self._pool.each(each, self._shape[0])
