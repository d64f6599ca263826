"""Phases under way, and the light that they make."""

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
    from ..waves.supervision import Frames
    from .shown_light import ShownLight

# Decays of Adam's means (Kingma and Ba, ICLR 2015): of slopes, where each step sees all and where it sees a view or a
# few of many, and of their squares. With 0.9 and 0.99 for a few views, 40 steps are 0.7 dB worse (docs/theory.md).
FULL, PARTLY, SQUARES = 0.9, 0.6, 0.9
TINY = 1e-30  # for pixels whose slope is nothing
FINE = 0.1  # radians between levels, for which it is enough to round phases in the end
WHOLE = 0.0, 2 * math.pi * (1 - 1 / 256)  # radians, of a turn
BLOCK = 1 << 16  # pixels: they stay near the processor, and threads seldom wait for Python


class Phases:
    """Phases of all frames in one wavelength.

    What is done to a pixel is done block by block beside the FFTs, in their threads: two pools of threads, one of
    Dr.Jit's kernels and one of FFTs, cost each other more than the blocks do.

    Parameters
    ----------
    start : array, float32 or float64, shape (frame, y, x)
        Radians. The type and the library are those of all that is computed.
    threads : Frames
    display : ShownLight, optional
        What makes light of phases. Default: an ideal display. Phases then stay between `ends`: neighbours blur, and
        would over a jump from one turn to the next.
    ends : (float, float)
        Least and largest phase, radians, that it has.
    beam : array, complex, shape (y, x), optional
        Light that falls on an ideal display. Default: 1.
    way : Collins, optional
        From an ideal display to where light is compared. Default: it is compared on the display.

    Attributes
    ----------
    light : array, complex, shape (frame, y, x)
        beam exp(i phase), or what the display or the way makes of it.
    """

    def __init__(
        self,
        start: Array,
        threads: Frames,
        display: ShownLight | None = None,
        ends: tuple[float, float] = WHOLE,
        beam: Array | None = None,
        way: Collins | None = None,
    ) -> None:
        self._xp = xp = arrays.namespace(start)
        self._angle = xp.reshape(arrays.copied(start), (start.shape[0], -1))
        if display is not None:
            self._angle = ends[0] + xp.remainder(self._angle - ends[0], 2 * math.pi)
        self._threads, self._shape = threads, tuple(start.shape)
        self._beam = None if beam is None else xp.reshape(beam, (-1,))
        kind = "complex64" if start.dtype == xp.float32 else "complex128"
        self._light = arrays.empty(self._angle.shape, kind, start)
        self._means: Array | None = None
        self._free: Array | None = None
        self._count = 0
        self._local, self._display, self._ends = threading.local(), display, ends
        self._way = way
        self._each(self._show)

    @property
    def light(self) -> Array:
        display, way = self._display, self._way
        if display is not None:
            return self._frames(lambda frame: display.light(self._turns(frame)))
        light = self._xp.reshape(self._light, self._shape)
        return light if way is None else self._frames(lambda frame: way.there(light[frame, ...]))

    def _frames(self, work):
        """Stack of what there is of each frame."""
        return self._xp.stack(self._threads.each(work, self._shape[0]))

    def _turns(self, frame):
        """Phases of a frame."""
        return self._xp.reshape(self._angle[frame, :], self._shape[1:])

    def descend(self, back: Array, factors: np.ndarray, rate: float, memory: float = FULL) -> None:
        """A step of Adam.

        Parameters
        ----------
        back : array, complex, shape (frame, y, x)
            G with dL = 2 Re sum conj(G) du for a change du of the light, so that the phases' slope is 2 Im(conj(u) G).
        factors : sequence of complex
            To be multiplied with each frame of it.
        rate : float
            Radians, the longest step or so.
        memory : float
            Decay of the mean of earlier slopes.
        """
        if self._means is None:
            self._means = arrays.zeros((2, *self._angle.shape), self._angle.dtype, self._angle)
            self._means[1, ...] = TINY
        means, free, xp = self._means, self._free, self._xp
        back, shares = self._at_pixels(back, factors)
        self._count += 1
        first, second = memory, SQUARES
        # sums of slopes and of their squares, not yet means
        scale = (1 - first) / (1 - first**self._count), (1 - second) / (1 - second**self._count)
        length = rate * scale[0] / math.sqrt(scale[1])

        def move(frame, block, rows):
            mean, square = means[0, frame, block], means[1, frame, block]
            slope = self._slope(frame, block, back[frame, rows, :], shares[frame])
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

    def fix(self, share: float, levels: Levels) -> None:
        """Bring a share of each frame's pixels to one of the levels for good: those that are nearest to theirs.

        The others make up for the error in the steps that follow. Rounding in each step while the phases move on
        below it (a straight-through estimator) was worse than rounding afterwards, this is better (docs/theory.md).
        Pixels between levels that are no farther apart than `FINE` stay free: it is enough to round them in the end.
        Where these are most, the others are soon done, and there is time to make up for them.
        """
        xp = self._xp
        if self._free is None:
            self._free = arrays.mask(np.ones(self._angle.shape, bool), self._angle)

        def each(frame):
            angle, free = self._angle[frame, :], self._free[frame, :]
            target, gaps = levels.nearest(angle)
            wanting = (free > 0) & (gaps > FINE)
            left, able = (int(xp.count_nonzero(each)) for each in (free, wanting))
            count = min(round(share * angle.shape[0]) - (angle.shape[0] - left), able)
            if count < 1:
                return
            apart = xp.where(wanting, xp.abs(angle - target), math.inf)
            chosen = wanting & (apart <= arrays.smallest(apart, count))
            angle[chosen], free[chosen] = target[chosen], 0

        self._threads.each(each, self._shape[0])
        self._each(self._show)

    def set(self, values: Array) -> None:
        """Go back to earlier `values`."""
        self._angle[...] = self._xp.reshape(values, self._angle.shape)
        self._each(self._show)

    def values(self) -> Array:
        """Radians in [0, 2 pi), float32."""
        return self._xp.reshape(wrapped(self._angle), self._shape)

    def _at_pixels(self, back, factors):
        """G and factors with respect to exp(i phase), of those with respect to the display's light."""
        display, way = self._display, self._way
        if way is not None:
            return self._frames(lambda frame: way.back(back[frame, ...])), factors
        if display is None:
            return back, factors
        light = self._xp.reshape(self._light, self._shape)

        def each(frame):
            slope = display.slope(self._turns(frame), back[frame, ...] * complex(factors[frame]))
            return 0.5j * light[frame, ...] * slope

        return arrays.as_type(self._frames(each), light.dtype), [1.0] * len(factors)

    def _slope(self, frame, block, back, factor):
        (product, slope, _), xp = self._room(block), self._xp
        product = arrays.into(product, xp.conj, self._light[frame, block])
        shaped = xp.reshape(product, back.shape)
        product = xp.reshape(arrays.into(shaped, xp.multiply, shaped, back), (-1,))
        factor = complex(factor)
        if factor.imag:
            product *= factor
            factor = 1 + 0j
        return arrays.into(slope, xp.multiply, xp.imag(product), 2 * factor.real)

    def _show(self, frame, block, rows):
        (_, first, second), xp = self._room(block), self._xp
        angle, light = self._angle[frame, block], self._light[frame, block]
        if self._display is not None:
            arrays.put(angle, xp.clip, angle, *self._ends)
        arrays.set_parts(light, arrays.into(first, xp.cos, angle), arrays.into(second, xp.sin, angle))
        if self._beam is not None:
            light *= self._beam[block]

    def _room(self, block):
        """Arrays of this thread's own, one complex and two real, to work on a block; None but for the processor."""
        if self._xp is not np:
            return [None] * 3
        count = block.stop - block.start
        if getattr(self._local, "size", 0) < count:
            self._local.size = count
            self._local.rooms = np.empty(count, self._light.dtype), *np.empty((2, count), self._angle.dtype)
        return [room[:count] for room in self._local.rooms]

    def _each(self, work):
        """``work(frame, block of pixels, the same as rows)`` on all."""
        rows, columns = self._shape[1:]
        height = max(1, BLOCK // columns) if self._xp is np else rows

        def each(frame):
            for first in range(0, rows, height):
                last = min(first + height, rows)
                work(frame, slice(first * columns, last * columns), slice(first, last))

        self._threads.each(each, self._shape[0])
