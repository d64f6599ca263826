"""Effect of a real spatial light modulator on the phases that it is sent."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import scipy.ndimage

from ..errors import InvalidInput
from . import arrays
from .propagation import filtered

if TYPE_CHECKING:
    from .arrays import Array

VARIATION_RANGE = 0.5, 2.0  # of a pixel's response in terms of the mean
MIN_LEVELS = 32  # levels in a turn with which a panel of more than a turn needs no others


@dataclass(frozen=True)
class Modulator:
    """Limits of a phase-only SLM; the defaults are an ideal one's.

    Parameters
    ----------
    bits : int, optional
        Bits of a pixel's phase, 1 to 16, in even steps of a turn. Default: any phase.
    fill_factor : float, optional
        Fraction of a pixel's area that modulates, over 0 to 1. A square pixel of side a emits within an envelope sinc(a
        fx) sinc(a fy), even if it has no gap; gaps are dark (Goodman, Introduction to Fourier Optics, 3rd ed., section
        2.2). Default: no envelope, as of pixels that are points of the same power.
    unmodulated : float
        Fraction of the light, 0 to 1, that is not modulated: the DC term, a spot in the Fourier plane.
    crosstalk : float
        Standard deviation, in pixels, of the Gaussian that blurs the phases, as fields reach into neighboring pixels
        (Moser et al., Opt. Express 27, 25046 (2019)).

    Raises
    ------
    InvalidInput
        On a value that no display can have.
    """

    bits: int | None = None
    fill_factor: float | None = None
    unmodulated: float = 0.0
    crosstalk: float = 0.0

    def __post_init__(self):
        if self.bits is not None and not 1 <= self.bits <= 16:
            raise InvalidInput(f"Expected 1 to 16 bits, got {self.bits}.")
        if self.fill_factor is not None and not 0 < self.fill_factor <= 1:
            raise InvalidInput(f"Expected a fill factor over 0 and up to 1, got {self.fill_factor:g}.")
        if not 0 <= self.unmodulated <= 1:
            raise InvalidInput(
                f"Expected a fraction of unmodulated light from 0 to 1, got {self.unmodulated:g}."
            )
        if not (0 <= self.crosstalk < 10):
            raise InvalidInput(f"Expected a crosstalk from 0 to below 10 pixels, got {self.crosstalk:g}.")

    def shown(self, phases: Array) -> Array:
        """Return the phases that pixels show if sent these, radians, float32, shape (..., y, x)."""
        phases = arrays.as_type(arrays.known(phases), "float32")
        if self.bits is not None:
            levels = arrays.as_type(gray_levels(phases, self.bits), "float64")
            phases = arrays.as_type(levels * (2 * math.pi / 2**self.bits), "float32")
        return self._blurred(phases) if self.crosstalk else phases

    def _blurred(self, phases):
        if isinstance(phases, np.ndarray):
            sigma = (0,) * (phases.ndim - 2) + (self.crosstalk,) * 2
            return scipy.ndimage.gaussian_filter(phases, sigma, mode="nearest")
        rows, columns = (
            scipy.ndimage.gaussian_filter1d(np.eye(n, dtype=np.float32), self.crosstalk, 0, mode="nearest")
            for n in phases.shape[-2:]
        )
        return arrays.like(rows, phases) @ phases @ arrays.like(columns.T, phases)

    def light(self, phases: Array) -> Array:
        """Return the field that leaves the pixels, of amplitude up to 1, complex64, shape (..., y, x).

        The envelope of the pixels' shape is applied to the sampled field, whose frequencies are within the SLM's range:
        higher orders are left out, as a stop in the Fourier plane blocks them.
        """
        shown = self.shown(phases)
        light = arrays.namespace(shown).exp(1j * arrays.as_type(shown, "complex64"))
        if self.unmodulated:
            light *= math.sqrt(1 - self.unmodulated)
            light += math.sqrt(self.unmodulated)
        return light if self.fill_factor is None else self._pixels(light, self.fill_factor)

    def _pixels(self, light, area):
        side = math.sqrt(area)
        fy, fx = (np.sinc(side * np.fft.fftfreq(n)) for n in light.shape[-2:])
        envelope = arrays.like((area * fy[:, None] * fx[None, :]).astype(np.float32), light)
        for index in np.ndindex(light.shape[:-2]):
            light[(*index, ...)] = filtered(light[(*index, ...)], envelope)
        return light


@dataclass(frozen=True, eq=False)
class Levels:
    """Phases that the pixels of an SLM with few levels can show.

    Parameters
    ----------
    phases : array_like
        Radians, two or more different ones, in any order and of any turn; kept in [0, 2 pi), rising. Of more than a
        turn, those of `one_turn` are kept.
    correction : array_like, shape (y, x), optional
        Radians that are added at each pixel before its level is chosen, as for a panel that is not flat: a pixel shows
        one of `phases` minus its correction.
    variation : array_like, shape (y, x), optional
        Factor v of each pixel's steps from the first phase given: liquid crystal varies in thickness, and a pixel shows
        phi_0 + v (phi_n - phi_0) (Engström et al., Opt. Express 21, 16086 (2013)).

    Raises
    ------
    InvalidInput
    """

    phases: np.ndarray
    correction: np.ndarray | None = None
    variation: np.ndarray | None = None
    _first: float = field(init=False, repr=False)
    _steps: np.ndarray = field(init=False, repr=False)  # from the first, rising, of any turn
    _all_turns: bool = field(init=False, repr=False)  # whether levels of all turns are used
    _ends: tuple[float, float] = field(init=False, repr=False)

    def __post_init__(self):
        given = np.asarray(self.phases, float).ravel()
        if not np.isfinite(given).all() or len(np.unique(np.mod(given, 2 * math.pi))) < 2:
            raise InvalidInput("Expected two or more different phases as levels, in radians.")
        given = unwrapped(given)
        kept = one_turn(given)
        object.__setattr__(self, "phases", np.unique(np.mod(given[kept], 2 * math.pi)))
        object.__setattr__(self, "_first", float(given[0]))
        object.__setattr__(self, "_steps", np.unique(given - given[0]))
        object.__setattr__(self, "_all_turns", bool(kept.all()))
        turn = given[kept] if np.ptp(given[kept]) < 2 * math.pi else self.phases
        object.__setattr__(self, "_ends", (float(turn.min()), float(turn.max())))
        if self.variation is not None:
            object.__setattr__(self, "variation", check_variation(self.variation))
        if self.correction is not None:
            correction = np.mod(np.asarray(self.correction, float), 2 * math.pi)
            object.__setattr__(self, "correction", correction.astype(np.float32))

    @property
    def ends(self) -> tuple[float, float]:
        """Minimum and maximum phase, radians, of a turn that the panel covers without a jump."""
        return self._ends

    @classmethod
    def even(cls, bits: int) -> Levels:
        """Levels of 2^bits even steps of a turn."""
        return cls(np.arange(2**bits) * (2 * math.pi / 2**bits))

    def __len__(self) -> int:
        return len(self.phases)

    def nearest(self, phases: Array) -> tuple[Array, Array]:
        """Return the phases nearest to given ones that pixels can show, around the circle.

        Parameters
        ----------
        phases : array, float
            Radians, of any turn; with a correction or a variation, of its pixels.

        Returns
        -------
        nearest, gaps : array
            Radians, of the library, shape and type of `phases`: the nearest phases, in the same turn, and the distances
            between the levels on both sides.
        """
        xp, turn, correction = arrays.namespace(phases), 2 * math.pi, 0.0
        if self.correction is not None:
            correction = arrays.like(self.correction.ravel(), phases)
        if self.variation is not None:
            correction = correction - self._first
        flat = xp.reshape(phases, (-1,)) + correction
        turns = xp.floor(flat / turn) * turn
        within = flat - turns
        if self.variation is None:
            low, high = self._around(within)
        else:
            low, high = self._around_each(within, self.variation)
        level = xp.where(within - low <= high - within, low, high) + turns - correction
        nearest, gaps = (
            xp.reshape(arrays.as_type(each, phases.dtype), phases.shape) for each in (level, high - low)
        )
        return nearest, gaps

    def _around(self, within):
        """Levels on both sides of phases in [0, 2 pi)."""
        xp, turn = arrays.namespace(within), 2 * math.pi
        ring = np.concatenate([[self.phases[-1] - turn], self.phases, [self.phases[0] + turn]])
        ring = arrays.like(ring, within)
        above = xp.clip(_places(ring, within), 1, len(self) + 1)
        return xp.take(ring, above - 1), xp.take(ring, above)

    def _around_each(self, within, variation):
        """Levels on both sides of phases for steps from the first level, times each pixel's `variation`."""
        xp, turn, first, last = arrays.namespace(within), 2 * math.pi, 0, len(self._steps)
        steps, factor = (arrays.like(each.ravel(), within) for each in (self._steps, variation))
        if not self._all_turns:
            first, last = _places(steps, -turn / factor, "right"), _places(steps, turn / factor)
        low = arrays.zeros(within.shape, "float64", within) - math.inf
        high = -low
        ends = self._steps[[0, -1]] * variation.max() / turn
        for turns in range(math.floor(ends[0]) - 1, math.ceil(ends[1]) + 2):
            place = _places(steps, (within + turns * turn) / factor)
            below, above = xp.minimum(place, last), xp.maximum(place, first)
            level = factor * xp.take(steps, xp.maximum(below - 1, 0)) - turns * turn
            low = xp.where(below > first, xp.maximum(low, level), low)
            level = factor * xp.take(steps, xp.minimum(above, len(self._steps) - 1)) - turns * turn
            high = xp.where(above < last, xp.minimum(high, level), high)
        return low, high

    def to_dict(self) -> dict:
        """Return a JSON-able form, with the SHA-256 of maps."""
        maps = {"correction": self.correction, "variation": self.variation}
        entries = {
            name: None if each is None else hashlib.sha256(each.tobytes()).hexdigest()
            for name, each in maps.items()
            if name == "correction" or each is not None  # as in reports of versions without a variation
        }
        if self.variation is not None:  # which depends on the order and the turns
            entries |= {"first": self._first, "steps": self._steps.tolist()}
        return {"phases": self.phases.tolist(), **entries}

    @property
    def widest_gap(self) -> float:
        """Largest distance between neighboring levels around the circle, radians."""
        factors = (1.0,) if self.variation is None else np.quantile(self.variation, np.linspace(0, 1, 33))
        turn = math.inf if self._all_turns else 2 * math.pi
        steps = (factor * self._steps for factor in factors)
        rings = (np.unique(np.mod(each[np.abs(each) < turn], 2 * math.pi)) for each in steps)
        return float(max(np.diff(ring, append=ring[0] + 2 * math.pi).max() for ring in rings))


def _places(rising, values, side="left"):
    """Places of values in a rising sequence of double precision."""
    return arrays.namespace(values).searchsorted(rising, arrays.as_type(values, "float64"), side=side)


def unwrapped(phases: np.ndarray) -> np.ndarray:
    """Phases of levels without jumps of a turn, if a monotonic response was written modulo 2 pi.

    It was if there are 16 or more levels within a turn, and every step is less than a quarter of a turn, or more than
    three quarters.

    Parameters
    ----------
    phases : numpy.ndarray, shape (level,)
        Radians.
    """
    steps = np.abs(np.diff(phases))
    jumps = steps > 1.5 * math.pi
    whole = len(phases) >= 16 and np.ptp(phases) <= 2 * math.pi and jumps.any()
    return np.unwrap(phases) if whole and (steps[~jumps] < math.pi / 2).all() else phases


def one_turn(phases: np.ndarray, min_levels: int = MIN_LEVELS) -> np.ndarray:
    """Mask of the levels that are used of a panel of more than a turn, shape (level,).

    Of two levels that are a turn apart, the same one must always be used. Otherwise smooth phases become a pattern of
    both, and crosstalk between neighbors that differ by a turn shows phases in between. So the levels within a turn of
    the smallest phase of a rising response are used, or of the largest phase of a falling one. All are used if fewer
    than `min_levels` would be left, as for a PLM, where rounding costs more.

    Parameters
    ----------
    phases : numpy.ndarray, shape (level,)
        Radians, `unwrapped`.
    min_levels : int
        Minimum number of levels in a turn.
    """
    turn = 2 * math.pi - 1e-9
    kept = phases < phases.min() + turn if phases[-1] >= phases[0] else phases > phases.max() - turn
    return kept if np.count_nonzero(kept) >= min_levels else np.ones(len(phases), bool)


def check_variation(variation: np.ndarray) -> np.ndarray:
    """Check a map of the `variation` of `Levels`, and return it as float32.

    Raises
    ------
    InvalidInput
        If it is not a map, or a value is out of range.
    """
    variation = np.asarray(variation)
    low, high = VARIATION_RANGE
    if variation.ndim != 2 or not variation.size or variation.dtype.kind not in "fiu":
        raise InvalidInput("Expected a map of numbers near 1 as variation, one for each pixel.")
    if not (low <= variation.min() and variation.max() <= high):  # NaN is neither
        raise InvalidInput(
            f"Expected variations of pixels' responses from {low:g} to {high:g} times the mean."
        )
    return np.ascontiguousarray(variation, np.float32)


def wrapped(phases: Array) -> Array:
    """Return phases in [0, 2 pi), float32."""
    xp, turn = arrays.namespace(phases), float(np.float32(2 * math.pi))
    phases = arrays.as_type(xp.remainder(phases, 2 * math.pi), "float32")
    return xp.where(phases < turn, phases, 0.0)  # the largest float below a turn is rounded to it


def gray_levels(phases: Array, bits: int = 8) -> Array:
    """Levels of an SLM for phases in radians: integers in [0, 2^bits), where a whole turn is 0 again.

    Parameters
    ----------
    phases : array, float
        Radians.
    bits : int
        Bits of a level.
    """
    levels = arrays.namespace(phases).round(phases * (2**bits / (2 * math.pi)))
    return arrays.as_type(levels, "int32") % 2**bits
