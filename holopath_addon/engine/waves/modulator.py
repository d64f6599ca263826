"""What a real spatial light modulator makes of the phases that it is sent."""

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

VARIES = 0.5, 2.0  # times its mean response that a pixel's may be
MIN_LEVELS = 32  # in a turn, of which the others of a panel of more than a turn are not needed


@dataclass(frozen=True)
class Modulator:
    """Limits of a phase-only SLM; the defaults are an ideal one's.

    Parameters
    ----------
    bits : int, optional
        Of phase that a pixel takes, 1 to 16. Default: any phase.
        Their steps are even, and a whole turn.
    fill_factor : float, optional
        Fraction of a pixel's area that modulates, over 0 to 1. A square pixel of side a emits within an envelope sinc(a
        fx) sinc(a fy), the whole pixel too; what is between pixels is dark (Goodman, Introduction to Fourier Optics,
        3rd ed., section 2.2). Default: no envelope, as of pixels that are points of the same power.
    unmodulated : float
        Share of the light, 0 to 1, that leaves as it came: the DC term, which focuses to a spot in the Fourier plane.
    crosstalk : float
        Standard deviation, in pixels, of the Gaussian that blurs what is shown: fields reach into neighbouring pixels
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
            raise InvalidInput(f"An SLM has 1 to 16 bits, not {self.bits}.")
        if self.fill_factor is not None and not 0 < self.fill_factor <= 1:
            raise InvalidInput(f"The fill factor must be over 0 and at most 1, not {self.fill_factor:g}.")
        if not 0 <= self.unmodulated <= 1:
            raise InvalidInput(f"The unmodulated light is a share of 0 to 1, not {self.unmodulated:g}.")
        if not (0 <= self.crosstalk < 10):
            raise InvalidInput(f"The crosstalk is 0 to 10 pixels, not {self.crosstalk:g}.")

    def shown(self, phases: Array) -> Array:
        """Phases that the pixels have when sent these, radians, float32, shape (..., y, x)."""
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
        """Field of amplitude 1 at most that leaves the pixels, complex64, shape (..., y, x).

        The envelope of the pixels' shape is applied to the sampled field, whose frequencies lie within the SLM's own
        range: higher orders are left out, as a stop in the Fourier plane takes them away.
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
    """Phases that the pixels of an SLM can have, where they are few.

    Parameters
    ----------
    phases : array_like
        Radians, two or more different ones, in any order and of any turn; kept in [0, 2 pi), rising. Of more than a
        turn those of `one_turn` are kept.
    correction : array_like, shape (y, x), optional
        Radians that are added at each pixel before its level is found, as for a panel that is not flat: what a pixel
        shows is one of `phases` less its correction.
    variation : array_like, shape (y, x), optional
        How many times the step from the first of `phases`, as they are given, each pixel makes: liquid crystal is not
        as thick everywhere, and a pixel shows phi_0 + v (phi_n - phi_0) (Engström et al., Opt. Express 21, 16086
        (2013)).

    Raises
    ------
    InvalidInput
    """

    phases: np.ndarray
    correction: np.ndarray | None = None
    variation: np.ndarray | None = None
    _first: float = field(init=False, repr=False)
    _steps: np.ndarray = field(init=False, repr=False)  # from the first, rising, of any turn
    _whole: bool = field(init=False, repr=False)  # levels of all turns are taken
    _ends: tuple[float, float] = field(init=False, repr=False)

    def __post_init__(self):
        given = np.asarray(self.phases, float).ravel()
        if not np.isfinite(given).all() or len(np.unique(np.mod(given, 2 * math.pi))) < 2:
            raise InvalidInput("Levels of an SLM are two or more different phases in radians.")
        given = unwrapped(given)
        kept = one_turn(given)
        object.__setattr__(self, "phases", np.unique(np.mod(given[kept], 2 * math.pi)))
        object.__setattr__(self, "_first", float(given[0]))
        object.__setattr__(self, "_steps", np.unique(given - given[0]))
        object.__setattr__(self, "_whole", bool(kept.all()))
        turn = given[kept] if np.ptp(given[kept]) < 2 * math.pi else self.phases
        object.__setattr__(self, "_ends", (float(turn.min()), float(turn.max())))
        if self.variation is not None:
            object.__setattr__(self, "variation", check_variation(self.variation))
        if self.correction is not None:
            correction = np.mod(np.asarray(self.correction, float), 2 * math.pi)
            object.__setattr__(self, "correction", correction.astype(np.float32))

    @property
    def ends(self) -> tuple[float, float]:
        """Least and largest phase, radians, of a turn through which the panel goes without a jump."""
        return self._ends

    @classmethod
    def even(cls, bits: int) -> Levels:
        """Even steps of a whole turn, 2^bits of them."""
        return cls(np.arange(2**bits) * (2 * math.pi / 2**bits))

    def __len__(self) -> int:
        return len(self.phases)

    def nearest(self, phases: Array) -> tuple[Array, Array]:
        """What pixels can show that is nearest to phases, around the circle.

        Parameters
        ----------
        phases : array, float
            Radians, of any turn; where there is a correction or a variation, of as many pixels.

        Returns
        -------
        shown, gaps : array
            Radians, as `phases` by library, shape and type: what is shown, in the turn of the phase; and how far the
            levels on both sides of it are from each other.
        """
        xp, turn, correction = arrays.namespace(phases), 2 * math.pi, 0.0
        if self.correction is not None:
            correction = arrays.like(self.correction.ravel(), phases)
        if self.variation is not None:
            correction = correction - self._first
        wanted = xp.reshape(phases, (-1,)) + correction
        begun = xp.floor(wanted / turn) * turn
        within = wanted - begun
        if self.variation is None:
            low, high = self._around(within)
        else:
            low, high = self._around_each(within, self.variation)
        level = xp.where(within - low <= high - within, low, high) + begun - correction
        shown, gaps = (
            xp.reshape(arrays.as_type(each, phases.dtype), phases.shape) for each in (level, high - low)
        )
        return shown, gaps

    def _around(self, within):
        """Levels on both sides of phases in [0, 2 pi)."""
        xp, turn = arrays.namespace(within), 2 * math.pi
        ring = np.concatenate([[self.phases[-1] - turn], self.phases, [self.phases[0] + turn]])
        ring = arrays.like(ring, within)
        above = xp.clip(_places(ring, within), 1, len(self) + 1)
        return xp.take(ring, above - 1), xp.take(ring, above)

    def _around_each(self, within, variation):
        """The same of steps from the first level, of which each pixel makes a share."""
        xp, turn, first, last = arrays.namespace(within), 2 * math.pi, 0, len(self._steps)
        steps, share = (arrays.like(each.ravel(), within) for each in (self._steps, variation))
        if not self._whole:
            first, last = _places(steps, -turn / share, "right"), _places(steps, turn / share)
        low = arrays.zeros(within.shape, "float64", within) - math.inf
        high = -low
        ends = self._steps[[0, -1]] * variation.max() / turn
        for turns in range(math.floor(ends[0]) - 1, math.ceil(ends[1]) + 2):
            found = _places(steps, (within + turns * turn) / share)
            below, above = xp.minimum(found, last), xp.maximum(found, first)
            shown = share * xp.take(steps, xp.maximum(below - 1, 0)) - turns * turn
            low = xp.where(below > first, xp.maximum(low, shown), low)
            shown = share * xp.take(steps, xp.minimum(above, len(self._steps) - 1)) - turns * turn
            high = xp.where(above < last, xp.minimum(high, shown), high)
        return low, high

    def to_dict(self) -> dict:
        """JSON-able form; of maps their SHA-256."""
        maps = {"correction": self.correction, "variation": self.variation}
        told = {
            name: None if each is None else hashlib.sha256(each.tobytes()).hexdigest()
            for name, each in maps.items()
            if name == "correction" or each is not None  # as in reports of versions that did not know it
        }
        if self.variation is not None:  # for which the order counts, and the turns
            told |= {"first": self._first, "steps": self._steps.tolist()}
        return {"phases": self.phases.tolist(), **told}

    @property
    def widest_gap(self) -> float:
        """Radians between those neighbors that are farthest apart, around the circle."""
        shares = (1.0,) if self.variation is None else np.quantile(self.variation, np.linspace(0, 1, 33))
        turn = math.inf if self._whole else 2 * math.pi
        steps = (share * self._steps for share in shares)
        rings = (np.unique(np.mod(each[np.abs(each) < turn], 2 * math.pi)) for each in steps)
        return float(max(np.diff(ring, append=ring[0] + 2 * math.pi).max() for ring in rings))


def _places(rising, values, side="left"):
    """Where values lie between numbers of double precision."""
    return arrays.namespace(values).searchsorted(rising, arrays.as_type(values, "float64"), side=side)


def unwrapped(phases: np.ndarray) -> np.ndarray:
    """Phases of levels, without jumps of a turn where a response that rises or falls was written modulo 2 pi.

    It was if 16 or more levels lie within a turn, and all steps are less than a quarter of a turn but those that are
    more than three quarters.
    """
    steps = np.abs(np.diff(phases))
    jumps = steps > 1.5 * math.pi
    whole = len(phases) >= 16 and np.ptp(phases) <= 2 * math.pi and jumps.any()
    return np.unwrap(phases) if whole and (steps[~jumps] < math.pi / 2).all() else phases


def one_turn(phases: np.ndarray, min_levels: int = MIN_LEVELS) -> np.ndarray:
    """Which levels of a panel of more than a turn are used, shape (level,).

    Of two levels that are a turn apart, the same one must always be taken. Else smooth phases become a pattern of
    both, and where neighbors differ by a turn, what runs from pixel to pixel (crosstalk) shows phases in between. So
    those are used that lie within a turn from the least phase of a response that rises, from the largest of one that
    falls. All are used where fewer than `min_levels` would be left, as of a PLM: there rounding costs more.

    Parameters
    ----------
    phases : numpy.ndarray, shape (level,)
        Radians, `unwrapped`.
    min_levels : int
    """
    turn = 2 * math.pi - 1e-9
    kept = phases < phases.min() + turn if phases[-1] >= phases[0] else phases > phases.max() - turn
    return kept if np.count_nonzero(kept) >= min_levels else np.ones(len(phases), bool)


def check_variation(variation: np.ndarray) -> np.ndarray:
    """A map of how many times a step each pixel makes, float32, see `Levels`.

    Raises
    ------
    InvalidInput
        If it is none.
    """
    variation = np.asarray(variation)
    low, high = VARIES
    if variation.ndim != 2 or not variation.size or variation.dtype.kind not in "fiu":
        raise InvalidInput("The variation is no map of numbers near 1, one a pixel.")
    if not (low <= variation.min() and variation.max() <= high):  # NaN is neither
        raise InvalidInput(f"The variation of a pixel's response is {low:g} to {high:g} times the mean.")
    return np.ascontiguousarray(variation, np.float32)


def wrapped(phases: Array) -> Array:
    """Phases in [0, 2 pi), float32."""
    xp, turn = arrays.namespace(phases), float(np.float32(2 * math.pi))
    phases = arrays.as_type(xp.remainder(phases, 2 * math.pi), "float32")
    return xp.where(phases < turn, phases, 0.0)  # the largest float below a turn is rounded to it


def gray_levels(phases: Array, bits: int = 8) -> Array:
    """Phases in radians as an SLM takes them: whole numbers in [0, 2^bits), of which a full turn is 0 again."""
    levels = arrays.namespace(phases).round(phases * (2**bits / (2 * math.pi)))
    return arrays.as_type(levels, "int32") % 2**bits
