"""Bench around the SLM: the beam that falls on it, stop and lens behind it, and the viewer's pupil.

Each word has one meaning: the pupil is the viewer's, the stop the relay's, the aperture the SLM's.

Fourier plane: frequencies g = (g_x, g_y) of the light behind the SLM, to the right and up, in units of the band's edge,
1 / (2 pitch) of the larger pitch. The zero order of a beam along the axis is at g = 0. The picture's middle ray is at
the carrier c: a wave field, which is rendered on axis, has the frequencies f = g - c. The picture fills the circle |f|
<= 1, the band. Pixels send light into the square |g_x|, |g_y| <= 1: circles and halves stay in the circle |g| <= 1
there, rectangles and measured stops may have its corners.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy.ndimage

from .errors import InvalidInput, real_numbers
from .pixels import Pitch, axes, coarsest, frequencies

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

# Kinds of beams: allowed counts of numbers, and their meaning.
BEAMS = {
    "flat": ((0,), "no number"),
    "tilt": ((2,), "two angles, to the right and up"),
    "point": ((1,), "one distance, which is not 0"),
    "gaussian": ((1, 3), "a waist over 0, and where its middle is, to the right and up"),
    "measured": ((0,), "an array"),
}
MIN_AMPLITUDE = 0.1  # of a beam at its brightest place on the panel, fraction of its maximum
# Kinds of stops, likewise.
STOPS = {
    "circle": ((0, 1), "a radius over 0, of the band's edge, or none"),
    "half": ((0, 1), "an angle, or none"),
    "rectangle": ((2,), "a width and a height over 0, of the band's edge"),
    "measured": ((0,), "an array"),
}
ZERO_ORDER = (
    0.02  # radius of the zero order that off-axis stops block, in units of the band's edge: 5 bins of 256
)
MIN_REACH = (
    1e-3  # of `Lens.reach`, fraction of the distance from the SLM to the picture: below it is the SLM's image
)
MIN_SHARE = 0.1  # side of the picture behind a lens, fraction of the width that light of pixels reaches
COLORS = ("color_scale", "color_distance", "color_shift")
SCALES = 0.5, 2.0  # minimum and maximum of a color's scale
GRID = 257  # points along a side of the Fourier plane for areas
BEAM_FILE, STOP_FILE = "beam.npy", "stop.npy"


@dataclass(frozen=True)
class Pupil:
    """Circular part of the viewer's pupil plane, in world meters around the camera's axis.

    Attributes
    ----------
    x, y : float
        Center, to the right and up.
    diameter : float
        Positive. The part outside the recordable cone is dark.

    Raises
    ------
    InvalidInput
        If the position is not finite or the diameter not positive.
    """

    x: float
    y: float
    diameter: float

    def __post_init__(self):
        if not all(map(math.isfinite, (self.x, self.y, self.diameter))) or self.diameter <= 0:
            raise InvalidInput("Expected a finite position and a positive diameter of the pupil.")


@dataclass(frozen=True)
class Beam:
    """Light that falls on the SLM, with an amplitude of 1 where it is brightest.

    With x to the right and y up from the panel's center, in meters, and k = 2 pi / wavelength::

        flat      1
        tilt      exp(i k (x sin a + y sin b)) with two angles a and b
        point     (abs(D) / r) exp(i k sign(D) (r - abs(D))), r^2 = D^2 + x^2 + y^2: spherical waves from a point D
                  before the SLM or, with D below 0, towards a point as far behind it
        gaussian  exp(-((x - x_0)^2 + (y - y_0)^2) / w^2) with a waist w at the SLM, the radius at 1/e^2 of the
                  intensity

    Parameters
    ----------
    kind : {'flat', 'tilt', 'point', 'gaussian', 'measured'}
    numbers : tuple of float
        For a tilt a and b, radians; for a point D, meters; for a Gaussian beam w, x_0 and y_0, meters, the last two
        optional.
    measured : array_like, shape (y, x) or (wavelength, y, x), optional
        Instead of numbers, the measured amplitude at each pixel of the panel, in any unit; complex if the phase was
        also measured.

    Raises
    ------
    InvalidInput
        If kind and numbers do not fit, or a number is out of range.
    """

    kind: str = "flat"
    numbers: tuple = ()
    measured: np.ndarray | None = field(default=None, repr=False, compare=False)
    digest: str = field(default="", init=False, repr=False)

    def __post_init__(self):
        if self.measured is not None:
            measured = _scaled_to_1(self.measured)
            object.__setattr__(self, "measured", measured)
            object.__setattr__(self, "digest", hashlib.sha256(measured.tobytes()).hexdigest())
        if self.kind not in BEAMS:
            raise InvalidInput(
                f"Expected a kind of beam, got '{self.kind}'. Choose one of {', '.join(BEAMS)}."
            )
        numbers, (counts, what) = real_numbers(self.numbers, "the numbers of the beam"), BEAMS[self.kind]
        object.__setattr__(self, "numbers", numbers)
        good = len(numbers) in counts and all(map(math.isfinite, numbers))
        good &= (self.kind == "measured") == (self.measured is not None)
        if self.kind == "tilt":
            good &= all(abs(angle) < math.pi / 2 for angle in numbers)
        if self.kind == "point":
            good &= any(numbers)
        if self.kind == "gaussian":
            good &= numbers[:1] > (0.0,)
        if not good:
            given = ", ".join(f"{number:g}" for number in numbers) or "none"
            raise InvalidInput(
                f"Expected {what} for a beam of the kind {self.kind}, got {given} (meters, radians)."
            )

    def light(self, shape: Sequence[int], pitch: Pitch, wavelength: float, number: int = 0) -> np.ndarray:
        """Complex amplitude at the panel's pixels, complex64, shape (y, x).

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the panel.
        pitch : float or (float, float)
            Pixel pitch, meters.
        wavelength : float
            Meters.
        number : int
            Index of the wavelength, for beams measured at each.
        """
        if self.measured is not None:
            return self.measured if self.measured.ndim == 2 else self.measured[number]
        x, y = _positions(shape, pitch)
        amplitude, path = 1.0, np.zeros(shape)
        if self.kind == "tilt":
            path = x * math.sin(self.numbers[0]) + y * math.sin(self.numbers[1])
        elif self.kind == "point":
            (distance,) = self.numbers
            radius = np.sqrt(distance**2 + x**2 + y**2)
            amplitude = abs(distance) / radius
            path = math.copysign(1.0, distance) * (x**2 + y**2) / (radius + abs(distance))
        elif self.kind == "gaussian":
            waist, x_0, y_0 = (*self.numbers, 0.0, 0.0)[:3]
            amplitude = np.exp(-((x - x_0) ** 2 + (y - y_0) ** 2) / waist**2)
        return (amplitude * np.exp(2j * math.pi * np.mod(path / wavelength, 1.0))).astype(np.complex64)

    def check(self, shape: Sequence[int], pitch: Pitch, wavelengths: Sequence[float]) -> None:
        """Check that a beam fits a panel.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the panel.
        pitch : float or (float, float)
            Pixel pitch, meters.
        wavelengths : sequence of float
            Meters.

        Raises
        ------
        InvalidInput
            If it misses the panel, is steeper than the pixels resolve, or was measured at other pixels or wavelengths.
        """
        if self.measured is not None:
            self._check_measured(shape, len(wavelengths))
        elif self.kind == "gaussian":
            x, y = _positions(shape, pitch)
            waist, x_0, y_0 = (*self.numbers, 0.0, 0.0)[:3]
            nearest = math.hypot(np.abs(x - x_0).min(), np.abs(y - y_0).min())
            if math.exp(-((nearest / waist) ** 2)) < MIN_AMPLITUDE:
                raise InvalidInput(
                    f"The beam, with a waist of {waist * 1e3:g} mm, passes the panel at a distance of "
                    f"{nearest * 1e3:.3g} mm. Move its center onto the panel."
                )
        steepest, edge = self._steepest(shape, pitch), min(wavelengths) / (2 * coarsest(pitch))
        if steepest > edge:
            raise InvalidInput(
                f"The beam meets the panel at {math.degrees(math.asin(min(1.0, steepest))):.3g} degrees, and pixels of "
                f"{coarsest(pitch) * 1e6:g} µm compensate {math.degrees(math.asin(edge)):.3g} degrees at most. "
                "Tilt or focus it less."
            )

    def _steepest(self, shape, pitch):
        """Largest sine of the beam's direction, to either side, on the panel."""
        if self.kind == "tilt":
            return max(abs(math.sin(angle)) for angle in self.numbers)
        if self.kind == "point":
            corner = [n * d / 2 for n, d in zip(shape, axes(pitch), strict=True)]
            return max(corner) / math.hypot(self.numbers[0], *corner)
        return 0.0

    def _check_measured(self, shape, wavelengths):
        assert self.measured is not None
        if self.measured.shape[-2:] != tuple(shape):
            rows, columns = self.measured.shape[-2:]
            raise InvalidInput(
                f"Expected a measured beam of {shape[1]} x {shape[0]} pixels, the panel's, got {columns} x {rows}."
            )
        count = len(self.measured) if self.measured.ndim == 3 else 1
        if count not in (1, wavelengths):
            raise InvalidInput(
                f"Expected a measured beam for each of {wavelengths} wavelengths, or one for all, got {count}."
            )
        if count < wavelengths and self.measured.imag.any():
            raise InvalidInput(
                f"The beam's phase was measured at one wavelength of {wavelengths}. Give a beam for each, as an array "
                "of shape (wavelength, y, x)."
            )


@dataclass(frozen=True)
class Stop:
    """Opening in the Fourier plane of the relay, see the module.

    Parameters
    ----------
    kind : {'circle', 'half', 'rectangle', 'measured'}
        A circle or a rectangle around the carrier, the half of the band on one side of the zero order, or a measured
        shape.
    numbers : tuple of float
        For a circle its radius (default: the largest in the band that, off axis, excludes the zero order); for a half
        the angle of its middle, radians from the right upwards (default: 0); for a rectangle its width and height. In
        units of the band's edge, so that 2 is the whole width.
    measured : array_like of bool, shape (y, x), optional
        Instead of numbers, the open places of the square g_x, g_y = -1 to 1; row 0 is the top.

    Raises
    ------
    InvalidInput
        If kind and numbers do not fit, or a number is out of range.
    """

    kind: str = "circle"
    numbers: tuple = ()
    measured: np.ndarray | None = field(default=None, repr=False, compare=False)
    digest: str = field(default="", init=False, repr=False)

    def __post_init__(self):
        if self.measured is not None:
            measured = np.asarray(self.measured)
            if measured.ndim != 2 or measured.dtype != bool or not measured.any():
                raise InvalidInput(
                    "Expected a measured stop as an array of booleans, of shape (y, x), that is open somewhere."
                )
            object.__setattr__(self, "measured", measured)
            object.__setattr__(self, "digest", hashlib.sha256(np.packbits(measured).tobytes()).hexdigest())
        if self.kind not in STOPS:
            raise InvalidInput(
                f"Expected a kind of stop, got '{self.kind}'. Choose one of {', '.join(STOPS)}."
            )
        numbers, (counts, what) = real_numbers(self.numbers, "the numbers of the stop"), STOPS[self.kind]
        object.__setattr__(self, "numbers", numbers)
        good = len(numbers) in counts and all(map(math.isfinite, numbers))
        good &= (self.kind == "measured") == (self.measured is not None)
        if self.kind in ("circle", "rectangle"):
            good &= all(number > 0 for number in numbers)
        if not good:
            given = ", ".join(f"{number:g}" for number in numbers) or "none"
            raise InvalidInput(f"Expected {what} for a stop of the kind {self.kind}, got {given}.")

    @property
    def direction(self) -> tuple[float, float]:
        """Unit vector to the middle of a half, to the right and up."""
        angle = (*self.numbers, 0.0)[0]
        return math.cos(angle), math.sin(angle)

    def middle(self) -> tuple[float, float]:
        """Carrier that puts the picture into the middle of the stop, away from the zero order where possible."""
        if self.kind == "circle":
            radius = (*self.numbers, 0.5)[0]
            return max(1 - radius, 0.0), 0.0
        if self.kind == "half":
            return tuple(0.5 * each for each in self.direction)
        if self.kind == "rectangle":
            return max(1 - self.numbers[0] / 2, 0.0), 0.0
        assert self.measured is not None
        rows, columns = np.nonzero(self.measured)
        height, width = self.measured.shape
        return (
            float(2 * (columns.mean() + 0.5) / width - 1),
            float(1 - 2 * (rows.mean() + 0.5) / height),
        )


@dataclass(frozen=True)
class Lens:
    """Thin lens behind the SLM.

    The viewer looks through it (depth mapping ``eyepiece``), or the picture floats in the air behind it (``fit``).

    Parameters
    ----------
    focal : float
        Focal length f, meters. Negative for a diverging lens, which needs both distances.
    distance : float, optional
        Distance L from the SLM to the lens, meters, 0 or more. Default: f.
    picture : float, optional
        Distance s from the lens to the picture's plane, meters, positive. Default: f, the back focal plane.
    share : float
        Width of the picture as a fraction of the width that light of pixels reaches there, `MIN_SHARE` to 1. The area
        beside it may contain the errors of phases.

    Raises
    ------
    InvalidInput
        If a number is out of range, or the picture's plane is the SLM's own image.
    """

    focal: float
    # pyrefly: ignore[bad-assignment]  # a number from `__post_init__` on
    distance: float = None
    picture: float | None = None
    share: float = 1.0

    def __post_init__(self):
        object.__setattr__(self, "share", float(self.share))
        if not MIN_SHARE <= self.share <= 1:
            raise InvalidInput(
                f"Expected a picture behind a lens of {MIN_SHARE:g} to 1 of the width that light reaches there, got "
                f"{self.share:g}."
            )
        object.__setattr__(self, "focal", float(self.focal))
        if not (math.isfinite(self.focal) and self.focal):
            raise InvalidInput(
                f"Expected a focal length that is finite and not 0, got {self.focal * 1e3:g} mm."
            )
        if self.focal < 0 and None in (self.distance, self.picture):
            raise InvalidInput(
                f"A lens of {self.focal * 1e3:g} mm diverges, and its focal plane is before it. For a picture behind "
                "it give its distance from the SLM and that of the picture from it; to look through it choose a "
                "converging one."
            )
        object.__setattr__(self, "distance", float(self.focal if self.distance is None else self.distance))
        if not (math.isfinite(self.distance) and self.distance >= 0):
            raise InvalidInput(
                f"Expected a distance of the lens from the SLM of 0 mm or more, got {self.distance * 1e3:g} mm."
            )
        if self.picture is None:
            return
        object.__setattr__(self, "picture", float(self.picture))
        if not (math.isfinite(self.picture) and self.picture > 0):
            raise InvalidInput(
                f"Expected a distance of the picture from the lens above 0 mm, got {self.picture * 1e3:g} mm."
            )
        if abs(self.reach) < MIN_REACH * (self.distance + self.picture):
            raise InvalidInput(
                f"The plane {self.picture * 1e3:g} mm behind the lens is the SLM's own image, where each pixel is a "
                "point. Put the picture elsewhere, for example in the back focal plane, which is the default."
            )

    @property
    def curvature(self) -> float:
        """A = 1 - s / f of the ray matrix from the SLM to the picture's plane; 0 in the back focal plane."""
        return 0.0 if self.picture is None else 1 - self.picture / self.focal

    @property
    def reach(self) -> float:
        """B = L + s - L s / f of the ray matrix, meters: height at which a ray of slope 1 from the axis arrives."""
        if self.picture is None:
            return self.focal
        return self.distance + self.picture - self.distance * self.picture / self.focal


@dataclass(frozen=True)
class Optics:
    """Bench around the SLM. By default an even beam falls on it, and a round stop passes its band.

    The panel's pixels are where lenses image them for the light of each wavelength: scaled, at another distance, and
    shifted. Free space begins there.

    Parameters
    ----------
    beam : Beam
        Light that falls on the SLM.
    carrier : (float, float) or 'auto', optional
        Place of the picture's middle ray in the Fourier plane, to the right and up of the zero order, in units of the
        band's edge; 'auto' for the middle of the stop. Default: 'auto' for a half, the zero order for other stops.
    stop : Stop
        Opening in the Fourier plane behind the SLM.
    color_scale : sequence of float
        Relative magnification of each wavelength's picture. Default: 1.
    color_distance : sequence of float
        Offset of each wavelength's picture towards the viewer, meters. Default: 0.
    color_shift : sequence of (float, float)
        Offset of each wavelength's picture, meters to the right and up. Default: 0.
    lens : Lens, optional
        Lens behind the SLM and its relay. Default: none.

    Raises
    ------
    InvalidInput
        If the stop reaches beyond the band or passes nothing of the picture, or a number is out of range.

    Examples
    --------
    >>> from holopath_addon import engine
    >>> engine.Optics(stop=engine.Stop("half")).carrier  # off axis, in the middle of the stop
    (0.5, 0.0)
    """

    beam: Beam = field(default_factory=Beam)
    # pyrefly: ignore[bad-assignment]  # numbers from `__post_init__` on
    carrier: tuple = None
    stop: Stop = field(default_factory=Stop)
    color_scale: tuple = ()
    color_distance: tuple = ()
    color_shift: tuple = ()
    lens: Lens | None = None

    def __post_init__(self):
        self._set_colors()
        carrier = self.carrier
        if carrier is None:
            carrier = "auto" if self.stop.kind == "half" else (0.0, 0.0)
        is_auto = isinstance(carrier, str) and carrier == "auto"
        carrier = self.stop.middle() if is_auto else real_numbers(carrier, "the carrier")
        if len(carrier) != 2 or not all(map(math.isfinite, carrier)) or math.hypot(*carrier) >= 1:
            given = ", ".join(f"{number:g}" for number in carrier)
            raise InvalidInput(
                f"Expected a carrier within the band, closer than 1 to the zero order, got {given}."
            )
        object.__setattr__(self, "carrier", carrier)
        if self.stop.kind == "circle":
            reach = math.hypot(*carrier) + self._radius
        elif self.stop.kind == "rectangle":
            reach = max(abs(c) + side / 2 for c, side in zip(carrier, self.stop.numbers, strict=True))
        else:
            assert self.stop.kind in ("half", "measured")  # they end with the band
            reach = 1.0
        if reach > 1 + 1e-9:
            raise InvalidInput(
                f"Expected a stop within the band, outside which pixels send no light, got one that reaches "
                f"{reach:.3g} times as far. Choose a smaller stop or carrier."
            )
        if self.stopped and not self._open_grid().any():
            raise InvalidInput("The stop passes nothing of the picture. Move it, or its carrier.")

    def _set_colors(self):
        """Check the numbers of all colors, and set those to () that are all at their defaults."""
        scale, distance = (real_numbers(getattr(self, name), name) for name in COLORS[:2])
        if not all(map(np.ndim, self.color_shift)):
            raise InvalidInput("Expected a pair of numbers for each color_shift, to the right and up.")
        shift = tuple(real_numbers(pair, "color_shift") for pair in self.color_shift)
        for each in scale:
            if not SCALES[0] <= each <= SCALES[1]:
                raise InvalidInput(
                    f"Expected a relative scale of a color from {SCALES[0]:g} to {SCALES[1]:g}, got {each:g}. The "
                    "default is 1."
                )
        if not all(map(math.isfinite, distance)):
            raise InvalidInput(
                "Expected finite distances of colors. Omit those that were not measured, or give 0."
            )
        if not all(len(pair) == 2 and all(map(math.isfinite, pair)) for pair in shift):
            raise InvalidInput("Expected two finite numbers for the shift of a color, to the right and up.")
        object.__setattr__(self, "color_scale", scale if any(each != 1 for each in scale) else ())
        object.__setattr__(self, "color_distance", distance if any(distance) else ())
        object.__setattr__(self, "color_shift", shift if any(map(any, shift)) else ())

    @property
    def stopped(self) -> bool:
        """Whether carrier or stop differ from the default."""
        return any(self.carrier) or self.stop != Stop()

    @property
    def _radius(self):
        """Radius of a circular stop, in units of the band's edge."""
        if self.stop.numbers:
            return self.stop.numbers[0]
        offset = math.hypot(*self.carrier)
        return min(1 - offset, offset - ZERO_ORDER) if offset else 1.0

    def open_at(self, f_x: np.ndarray, f_y: np.ndarray) -> np.ndarray:
        """Whether light of the picture passes the stop.

        Parameters
        ----------
        f_x, f_y : array_like
            Frequencies to the right and up, in units of the band's edge; they are broadcast.

        Returns
        -------
        numpy.ndarray of bool
        """
        square = f_x**2 + f_y**2
        is_open = square <= 1
        if not self.stopped:
            return is_open
        g_x, g_y = f_x + self.carrier[0], f_y + self.carrier[1]
        is_open = is_open & (np.abs(g_x) <= 1) & (np.abs(g_y) <= 1)
        if any(self.carrier):
            is_open &= g_x**2 + g_y**2 > ZERO_ORDER**2
        if self.stop.kind == "circle":
            return is_open & (square <= self._radius**2)
        if self.stop.kind == "half":
            x, y = self.stop.direction
            return is_open & (g_x * x + g_y * y > 0) & (g_x**2 + g_y**2 <= 1)
        if self.stop.kind == "rectangle":
            width, height = self.stop.numbers
            return is_open & (np.abs(f_x) <= width / 2) & (np.abs(f_y) <= height / 2)
        assert self.stop.measured is not None
        rows, columns = (
            np.clip(((1 + g) / 2 * n).astype(int), 0, n - 1)
            for g, n in zip((-g_y, g_x), self.stop.measured.shape, strict=True)
        )
        return is_open & self.stop.measured[rows, columns]

    @property
    def of_rays(self) -> Optics:
        """Ideal bench for rays: an even beam, which has no pixels, and colors that coincide."""
        return replace(self, beam=Beam(), **dict.fromkeys(COLORS, ()))

    @property
    def colors_apart(self) -> bool:
        """Whether colors differ in scale, distance or shift."""
        return bool(self.color_scale or self.color_distance or self.color_shift)

    def color(self, number: int) -> tuple[float, float, tuple[float, float]]:
        """Scale, distance in meters and shift in meters of the wavelength of index `number`."""
        return (
            self.color_scale[number] if self.color_scale else 1.0,
            self.color_distance[number] if self.color_distance else 0.0,
            self.color_shift[number] if self.color_shift else (0.0, 0.0),
        )

    def stop_mask(self, shape: Sequence[int], pitch: Pitch = 1.0) -> np.ndarray:
        """FFT bins of a field that pass the stop.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the FFT; row 0 of the field is the top.
        pitch : float or (float, float)
            Pixel pitch of the field. For square pixels, the default, its value does not matter.

        Returns
        -------
        numpy.ndarray of bool, `shape`
            In FFT order.
        """
        fy, fx = frequencies(shape, pitch)
        return self.open_at(2 * fx[None, :], -2 * fy[:, None])

    def _open_grid(self):
        axis = np.linspace(-1, 1, GRID)
        return self.open_at(axis[None, :], -axis[:, None])

    @property
    def stop_circle(self) -> tuple[float, float, float]:
        """Largest open circle: center, from the picture's middle ray, and radius, in units of the band's edge."""
        if not self.stopped:
            return 0.0, 0.0, 1.0
        if self.stop.kind == "circle":
            return 0.0, 0.0, self._radius
        return _largest_circle(self)

    def fraction_within(self, x: float, y: float, radius: float) -> float:
        """Fraction of the open area that is within a circle.

        Parameters
        ----------
        x, y, radius : float
            Center, to the right and up, and radius, in units of the band's edge.
        """
        axis, is_open = np.linspace(-1, 1, GRID), self._open_grid()
        inside = np.hypot(axis[None, :] - x, -axis[:, None] - y) <= radius
        return float((is_open & inside).sum() / is_open.sum())

    def check(self, shape: Sequence[int], pitch: Pitch, wavelengths: Sequence[float]) -> None:
        """Check that the bench fits a panel.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the panel.
        pitch : float or (float, float)
            Pixel pitch, meters.
        wavelengths : sequence of float
            Meters.

        Raises
        ------
        InvalidInput
            If the beam does not fit, see `Beam.check`, or the numbers of colors and wavelengths differ.
        """
        self.beam.check(shape, pitch, wavelengths)
        for name, each in (
            ("scale", self.color_scale),
            ("distance", self.color_distance),
            ("shift", self.color_shift),
        ):
            if each and len(each) != len(wavelengths):
                raise InvalidInput(
                    f"Expected a {name} for each of {len(wavelengths)} wavelengths, got {len(each)}."
                )
        if self.colors_apart and len(set(wavelengths)) < len(wavelengths):
            raise InvalidInput(
                "Expected different wavelengths, because their colors differ in place. Give each wavelength once."
            )

    def zero_order_note(self, pitch: Pitch, wavelengths: Sequence[float]) -> str:
        """Note on an off-axis stop that a tilted beam's zero order passes, as it goes where the beam does; or empty.

        Parameters
        ----------
        pitch : float or (float, float)
            Pixel pitch of the panel, meters.
        wavelengths : sequence of float
            Meters.
        """
        if self.beam.kind != "tilt" or not any(self.carrier):
            return ""
        for wavelength in wavelengths:
            zero = (math.sin(angle) * 2 * coarsest(pitch) / wavelength for angle in self.beam.numbers)
            f_x, f_y = (np.asarray(g - c) for g, c in zip(zero, self.carrier, strict=True))
            if self.open_at(f_x, f_y):
                return (
                    f"The tilted beam's zero order passes the stop at {wavelength * 1e9:g} nm: choose another carrier, "
                    "tilt or stop, or a smaller one."
                )
        return ""

    def illumination(
        self, shape: Sequence[int], pitch: Pitch, wavelength: float, number: int = 0
    ) -> np.ndarray | None:
        """Factor of the SLM's transmission for the picture's light, complex64, shape (y, x); None for 1.

        It is the beam relative to the carrier: exp(-i pi (c_x x + c_y y) / pitch) times `Beam.light`, which has the
        same parameters.
        """
        if self.beam == Beam() and not any(self.carrier):
            return None
        light = self.beam.light(shape, pitch, wavelength, number)
        if not any(self.carrier):
            return light
        x, y = _positions(shape, pitch)
        turns = (self.carrier[0] * x + self.carrier[1] * y) / (2 * coarsest(pitch))
        return (light * np.exp(-2j * math.pi * np.mod(turns, 1.0))).astype(np.complex64)

    def to_dict(self) -> dict:
        """Return the values that differ from their defaults, as JSON has them; for arrays their SHA-256."""
        values = {}
        for name, part, default in (("beam", self.beam, Beam()), ("stop", self.stop, Stop())):
            if part != default:
                values[name] = {"kind": part.kind, "numbers": list(part.numbers)}
                values[name] |= {"sha256": part.digest} if part.digest else {}
        if self.stopped:
            values["carrier"] = list(self.carrier)
        if self.lens is not None:
            values["lens"] = asdict(self.lens)
        for name in COLORS:
            if getattr(self, name):
                values[name] = [
                    list(each) if isinstance(each, tuple) else each for each in getattr(self, name)
                ]
        return values

    def save(self, folder: Path) -> None:
        """Write the measured arrays, which `to_dict` omits, into the folder `folder`."""
        for name, part in ((BEAM_FILE, self.beam), (STOP_FILE, self.stop)):
            if part.measured is not None:
                np.save(folder / name, part.measured)

    @classmethod
    def from_dict(cls, values: dict, folder: Path | None = None) -> Optics:
        """Return a bench; inverse of `to_dict` and `save`.

        Parameters
        ----------
        values : dict
            Values as of `to_dict`.
        folder : path, optional
            Folder of `save`. Default: none, for benches without measured parts.

        Raises
        ------
        InvalidInput
            If an array is missing.
        """
        beam, stop = (
            _part(kind, values.get(name, {}), folder, f"{name}.npy")
            for name, kind in (("beam", Beam), ("stop", Stop))
        )
        lens = Lens(**values["lens"]) if "lens" in values else None
        return cls(beam, values.get("carrier"), stop, *(values.get(name, ()) for name in COLORS), lens=lens)


ON_AXIS = Optics()


def _part(kind, values, folder, name):
    """Beam or stop from its values."""
    if values.get("kind") != "measured":
        return kind(**values)
    if folder is None or not (folder / name).is_file():
        word = name.partition(".")[0]
        raise InvalidInput(f"The array of the measured {word} is missing. Give it by --{word}.")
    return kind("measured", measured=np.load(folder / name, allow_pickle=False))


@lru_cache(maxsize=8)  # panels draw it often
def _largest_circle(optics):
    inside = scipy.ndimage.distance_transform_edt(np.pad(optics._open_grid(), 1))[1:-1, 1:-1]
    rows, columns = np.nonzero(
        inside > inside.max() - 1.5
    )  # of the largest, the one nearest to the middle ray
    step = 2 / (GRID - 1)
    x, y = columns * step - 1, 1 - rows * step
    middle = np.argmin(np.hypot(x, y))
    radius = (inside[rows[middle], columns[middle]] - 0.5) * step
    return float(x[middle]), float(y[middle]), float(radius)


def _positions(shape, pitch):
    """Positions of columns, x to the right, and of rows, y up, meters from the panel's center."""
    y, x = ((np.arange(n) - (n - 1) / 2) * d for n, d in zip(shape, axes(pitch), strict=True))
    return x[None, :], -y[:, None]


def _scaled_to_1(measured: ArrayLike) -> np.ndarray:
    """A measured beam, complex64, scaled to an amplitude of 1 where it is brightest."""
    array = np.asarray(measured)
    if array.ndim not in (2, 3) or not array.size or array.dtype.kind not in "fciub":
        raise InvalidInput(
            "Expected a measured beam as an array of numbers, of shape (y, x) or (wavelength, y, x)."
        )
    if array.dtype.kind != "c" and (array < 0).any():
        raise InvalidInput(
            "Expected amplitudes of 0 or more of the measured beam. Give complex numbers for phases."
        )
    array = array.astype(np.complex128)
    largest = np.abs(array).max(initial=0.0)
    if not 0 < largest < math.inf:
        raise InvalidInput("Expected a measured beam with light and finite values. Measure it again.")
    return (array / largest).astype(np.complex64)
