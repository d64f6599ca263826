"""The bench around the SLM: the beam that falls on it, stop and lens behind it, and the viewer's pupil.

One word has one meaning: the pupil is the viewer's, the stop the relay's, the aperture the SLM's.

Fourier plane: frequencies g = (g_x, g_y), to the right and up, in units of the band's edge, 1 / (2 pitch) of the larger
pitch, are those of
what the SLM's pixels let through; its zero order lies at g = 0. The picture's middle ray lies at the carrier c: a wave
field, which is rendered on axis, has the frequencies f = g - c.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy.ndimage

from .errors import InvalidInput
from .pixels import Pitch, axes, coarsest, frequencies

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

# How many numbers each kind of beam has, and what they are.
BEAMS = {
    "flat": ((0,), "no number"),
    "tilt": ((2,), "two angles, to the right and up"),
    "point": ((1,), "one distance, which is not 0"),
    "gaussian": ((1, 3), "a waist over 0, and where its middle is, to the right and up"),
    "measured": ((0,), "an array"),
}
MISSED = (
    0.1  # of a beam's largest amplitude, 1 % of its intensity: a panel that is darker everywhere is missed
)
# The same of each kind of stop.
STOPS = {
    "circle": ((0, 1), "a radius over 0, of the band's edge, or none"),
    "half": ((0, 1), "an angle, or none"),
    "rectangle": ((2,), "a width and a height over 0, of the band's edge"),
    "measured": ((0,), "an array"),
}
ZERO_ORDER = (
    0.02  # of the band's edge: as far around it an off-axis stop is closed, 5 bins of 256 pixels and more
)
IMAGE = (
    1e-3  # of the way from the SLM to the picture's plane: with a smaller reach that is the SLM's own image
)
MIN_SHARE = 0.1  # of what pixels reach behind a lens, along a side of the picture
COLORS = ("color_scale", "color_distance", "color_shift")
SCALES = 0.5, 2.0  # least and largest of a color
GRID = 257  # points a side on which areas in the Fourier plane are taken
BEAM_FILE, STOP_FILE = "beam.npy", "stop.npy"


@dataclass(frozen=True)
class Pupil:
    """A circular part of the viewer's pupil plane, in world meters about the camera's axis.

    Attributes
    ----------
    x, y : float
        Center, to the right and up.
    diameter : float
        Positive. What lies beyond the recordable cone holds no light.
    """

    x: float
    y: float
    diameter: float

    def __post_init__(self):
        if not all(map(math.isfinite, (self.x, self.y, self.diameter))) or self.diameter <= 0:
            raise InvalidInput("A pupil needs a finite position and a positive diameter.")


@dataclass(frozen=True)
class Beam:
    """Light that falls on the SLM, of amplitude 1 where it is brightest.

    With x to the right and y up from the panel's middle, in meters, and k = 2 pi / wavelength::

        flat      1
        tilt      exp(i k (x sin a + y sin b)) with two angles a and b
        point     (abs(D) / r) exp(i k sign(D) (r - abs(D))), r^2 = D^2 + x^2 + y^2: spherical waves from a point D
                  before the SLM or, with D below 0, towards a point as far behind it
        gaussian  exp(-((x - x_0)^2 + (y - y_0)^2) / w^2) with a waist w at the SLM, the radius at 1/e^2 of the
                  intensity

    Parameters
    ----------
    kind : str
        Of `BEAMS`.
    numbers : tuple of float
        Of a tilt a and b, radians; of a point D, meters; of a Gaussian beam w, x_0 and y_0, meters, of which the
        last two may be left out.
    measured : array_like, shape (y, x) or (wavelength, y, x), optional
        Instead of numbers, the amplitude at each pixel of the panel as it was measured, of any scale; complex where
        the phase was measured, too.

    Raises
    ------
    InvalidInput
        On a beam that cannot be.
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
            raise InvalidInput(f"There is no beam '{self.kind}': choose one of {', '.join(BEAMS)}.")
        numbers, (counts, what) = tuple(map(float, self.numbers)), BEAMS[self.kind]
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
            raise InvalidInput(f"A beam of the kind {self.kind} has {what}, not {given} (meters, radians).")

    def light(self, shape: Sequence[int], pitch: Pitch, wavelength: float, number: int = 0) -> np.ndarray:
        """Complex amplitude at the panel's pixels, complex64, shape (y, x).

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the panel.
        pitch : float or (float, float)
        wavelength : float
            Meters.
        number : int
            Of the wavelength, where each has a measured beam of its own.
        """
        if self.measured is not None:
            return self.measured if self.measured.ndim == 2 else self.measured[number]
        x, y = _positions(shape, pitch)
        amplitude, way = 1.0, np.zeros(shape)
        if self.kind == "tilt":
            way = x * math.sin(self.numbers[0]) + y * math.sin(self.numbers[1])
        elif self.kind == "point":
            (distance,) = self.numbers
            radius = np.sqrt(distance**2 + x**2 + y**2)
            amplitude = abs(distance) / radius
            way = math.copysign(1.0, distance) * (x**2 + y**2) / (radius + abs(distance))
        elif self.kind == "gaussian":
            waist, x_0, y_0 = (*self.numbers, 0.0, 0.0)[:3]
            amplitude = np.exp(-((x - x_0) ** 2 + (y - y_0) ** 2) / waist**2)
        return (amplitude * np.exp(2j * math.pi * np.mod(way / wavelength, 1.0))).astype(np.complex64)

    def check(self, shape: Sequence[int], pitch: Pitch, wavelengths: Sequence[float]) -> None:
        """Refuse a beam that does not go with a panel of such pixels.

        Raises
        ------
        InvalidInput
        """
        if self.measured is not None:
            self._check_measured(shape, len(wavelengths))
        elif self.kind == "gaussian":
            x, y = _positions(shape, pitch)
            waist, x_0, y_0 = (*self.numbers, 0.0, 0.0)[:3]
            nearest = math.hypot(np.abs(x - x_0).min(), np.abs(y - y_0).min())
            if math.exp(-((nearest / waist) ** 2)) < MISSED:
                raise InvalidInput(
                    f"The beam, of a waist of {waist * 1e3:g} mm, passes the panel at a distance of "
                    f"{nearest * 1e3:.3g} mm: move its middle onto the panel."
                )
        steepest, edge = self._steepest(shape, pitch), min(wavelengths) / (2 * coarsest(pitch))
        if steepest > edge:
            raise InvalidInput(
                f"The beam meets the panel at {math.degrees(math.asin(min(1.0, steepest))):.3g} degrees, and pixels of "
                f"{coarsest(pitch) * 1e6:g} µm make up for {math.degrees(math.asin(edge)):.3g} at most: tilt or "
                "focus it less."
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
                f"The measured beam has {columns} x {rows} pixels, the panel {shape[1]} x {shape[0]}: give one of its "
                "size."
            )
        count = len(self.measured) if self.measured.ndim == 3 else 1
        if count not in (1, wavelengths):
            raise InvalidInput(
                f"The beam was measured at {count} wavelengths of {wavelengths}: give as many."
            )
        if count < wavelengths and self.measured.imag.any():
            raise InvalidInput(
                f"The beam's phase was measured at one wavelength of {wavelengths}: give a beam for each, as an array "
                "of shape (wavelength, y, x)."
            )


@dataclass(frozen=True)
class Stop:
    """What the relay lets through in its Fourier plane, see the module.

    Parameters
    ----------
    kind : str
        Of `STOPS`: a circle around the carrier; the half of the band on one side of the zero order; a rectangle around
        the carrier; or as measured.
    numbers : tuple of float
        Of a circle its radius (default: the largest that lies in the band and, off axis, leaves out the zero order); of
        a half the angle of its middle, radians from the right upwards (default: 0); of a rectangle its width and
        height, of which 2 is all.
    measured : array_like of bool, shape (y, x), optional
        Instead of numbers, what is open of the square g_x, g_y = -1 to 1; row 0 is the top.

    Raises
    ------
    InvalidInput
        On a stop that cannot be.
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
                    "A measured stop is an array of true and false, of shape (y, x), that is open somewhere."
                )
            object.__setattr__(self, "measured", measured)
            object.__setattr__(self, "digest", hashlib.sha256(np.packbits(measured).tobytes()).hexdigest())
        if self.kind not in STOPS:
            raise InvalidInput(f"There is no stop '{self.kind}': choose one of {', '.join(STOPS)}.")
        numbers, (counts, what) = tuple(map(float, self.numbers)), STOPS[self.kind]
        object.__setattr__(self, "numbers", numbers)
        good = len(numbers) in counts and all(map(math.isfinite, numbers))
        good &= (self.kind == "measured") == (self.measured is not None)
        if self.kind in ("circle", "rectangle"):
            good &= all(number > 0 for number in numbers)
        if not good:
            given = ", ".join(f"{number:g}" for number in numbers) or "none"
            raise InvalidInput(f"A stop of the kind {self.kind} has {what}, not {given}.")

    @property
    def direction(self) -> tuple[float, float]:
        """Of the middle of a half, to the right and up."""
        angle = (*self.numbers, 0.0)[0]
        return math.cos(angle), math.sin(angle)

    def middle(self) -> tuple[float, float]:
        """Carrier of a picture in the middle of the stop, which leaves out the zero order where it can."""
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
    """A thin lens behind the SLM.

    Somebody looks through it (depth mapping ``eyepiece``), or the picture stands in the air behind it (``fit``).

    Parameters
    ----------
    focal : float
        Focal length f, meters; below 0 of a lens that diverges, which has no distance nor picture by default.
    distance : float, optional
        L, from the SLM to the lens, meters, 0 or more. Default: f.
    picture : float, optional
        s, from the lens to the plane that the picture stands around, meters, over 0. Default: f, the back focal plane.
    share : float
        Of the width that light of pixels reaches there, what the picture has, over 0 to 1. What lies beside it is free:
        phases leave their errors there.

    Raises
    ------
    InvalidInput
        On a lens that cannot be, or a picture's plane that is the SLM's own image.
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
                f"A picture behind a lens has {MIN_SHARE:g} to 1 of the width that light reaches there, not "
                f"{self.share:g}: 1 is all of it."
            )
        object.__setattr__(self, "focal", float(self.focal))
        if not (math.isfinite(self.focal) and self.focal):
            raise InvalidInput(
                f"The focal length of a lens is finite and not 0, not {self.focal * 1e3:g} mm."
            )
        if self.focal < 0 and None in (self.distance, self.picture):
            raise InvalidInput(
                f"A lens of {self.focal * 1e3:g} mm diverges, and its focal plane is before it: for a picture behind "
                "it give its distance from the SLM and that of the picture from it, and to look through take one that "
                "converges."
            )
        object.__setattr__(self, "distance", float(self.focal if self.distance is None else self.distance))
        if not (math.isfinite(self.distance) and self.distance >= 0):
            raise InvalidInput(
                f"A lens stands behind the SLM, 0 mm away or more, not {self.distance * 1e3:g} mm."
            )
        if self.picture is None:
            return
        object.__setattr__(self, "picture", float(self.picture))
        if not (math.isfinite(self.picture) and self.picture > 0):
            raise InvalidInput(
                f"The picture stands behind the lens, over 0 mm away, not {self.picture * 1e3:g} mm."
            )
        if abs(self.reach) < IMAGE * (self.distance + self.picture):
            raise InvalidInput(
                f"The plane {self.picture * 1e3:g} mm behind the lens is the SLM's own image, where each pixel is a "
                "point: put the picture elsewhere, as in the back focal plane, which is the default."
            )

    @property
    def curvature(self) -> float:
        """A = 1 - s / f of the ray matrix from the SLM to the picture's plane; 0 in the back focal plane."""
        return 0.0 if self.picture is None else 1 - self.picture / self.focal

    @property
    def reach(self) -> float:
        """B = L + s - L s / f of the ray matrix, meters: how far aside light of a slope of 1 on the axis arrives."""
        if self.picture is None:
            return self.focal
        return self.distance + self.picture - self.distance * self.picture / self.focal


@dataclass(frozen=True)
class Optics:
    """The bench around the SLM. By default light falls evenly on it, and a round stop lets through its band.

    Parameters
    ----------
    beam : Beam
        That falls on the SLM.
    carrier : (float, float) or 'auto', optional
        Where in the Fourier plane the middle of the picture's light lies, to the right and up of the zero order, in
        units of the band's edge; 'auto' for the middle of the stop. Default: that of a half; of other stops the zero
        order.
    stop : Stop
        In the Fourier plane behind the SLM.
    color_scale : sequence of float
        Magnification of each wavelength's picture over what it should be. Default: 1.
    color_distance : sequence of float
        How far each wavelength's picture lies too near to the viewer, meters. Default: 0.
    color_shift : sequence of (float, float)
        How far each wavelength's picture lies aside, meters to the right and up. Default: 0.
    lens : Lens, optional
        Behind the SLM and its relay. Default: none.

    For light of a wavelength the panel's pixels lie where lenses image them: as far apart, at that distance and that
    far aside. Free space begins there.

    Raises
    ------
    InvalidInput
        If the stop does not lie in the band, or lets nothing of the picture through, or a color cannot lie there.
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
        carrier = self.stop.middle() if carrier == "auto" else tuple(map(float, carrier))
        if len(carrier) != 2 or not all(map(math.isfinite, carrier)) or math.hypot(*carrier) >= 1:
            given = ", ".join(f"{number:g}" for number in carrier)
            raise InvalidInput(
                f"A carrier lies within the band, closer than 1 to the zero order, not at {given}."
            )
        object.__setattr__(self, "carrier", carrier)
        reach = 0.0
        if self.stop.kind == "circle":
            reach = math.hypot(*carrier) + self._radius
        elif self.stop.kind == "rectangle":
            reach = max(abs(c) + side / 2 for c, side in zip(carrier, self.stop.numbers, strict=True))
        if reach > 1 + 1e-9:
            raise InvalidInput(
                f"The stop reaches {reach:.3g} times as far as the band, beyond which pixels send no light: make it "
                "smaller, or its carrier."
            )
        if self.stopped and not self._open_grid().any():
            raise InvalidInput("The stop lets nothing of the picture through: move it, or its carrier.")

    def _set_colors(self):
        """Numbers of all colors; none where all are as they should be."""
        scale, distance = (tuple(map(float, each)) for each in (self.color_scale, self.color_distance))
        shift = tuple(tuple(map(float, pair)) for pair in self.color_shift)
        for each in scale:
            if not SCALES[0] <= each <= SCALES[1]:
                raise InvalidInput(
                    f"The scale of a color is relative, {SCALES[0]:g} to {SCALES[1]:g}, not {each:g}: 1 is as it "
                    "should be."
                )
        if not all(map(math.isfinite, distance)):
            raise InvalidInput(
                "The distance of a color must be finite: leave out what was not measured, or say 0."
            )
        if not all(len(pair) == 2 and all(map(math.isfinite, pair)) for pair in shift):
            raise InvalidInput("The shift of a color is two finite numbers, to the right and up.")
        object.__setattr__(self, "color_scale", scale if any(each != 1 for each in scale) else ())
        object.__setattr__(self, "color_distance", distance if any(distance) else ())
        object.__setattr__(self, "color_shift", shift if any(map(any, shift)) else ())

    @property
    def stopped(self) -> bool:
        """Whether carrier or stop are others than by default."""
        return any(self.carrier) or self.stop != Stop()

    @property
    def _radius(self):
        """Of a circle."""
        aside = math.hypot(*self.carrier)
        return (
            self.stop.numbers[0]
            if self.stop.numbers
            else min(1 - aside, aside - ZERO_ORDER)
            if aside
            else 1.0
        )

    def open_at(self, f_x: np.ndarray, f_y: np.ndarray) -> np.ndarray:
        """Whether light of the picture's frequencies, to the right and up in units of the band's edge, passes."""
        square = f_x**2 + f_y**2
        passes = square <= 1
        if not self.stopped:
            return passes
        g_x, g_y = f_x + self.carrier[0], f_y + self.carrier[1]
        passes = passes & (np.abs(g_x) <= 1) & (np.abs(g_y) <= 1)
        if any(self.carrier):
            passes &= g_x**2 + g_y**2 > ZERO_ORDER**2
        if self.stop.kind == "circle":
            return passes & (square <= self._radius**2)
        if self.stop.kind == "half":
            x, y = self.stop.direction
            return passes & (g_x * x + g_y * y > 0) & (g_x**2 + g_y**2 <= 1)
        if self.stop.kind == "rectangle":
            width, height = self.stop.numbers
            return passes & (np.abs(f_x) <= width / 2) & (np.abs(f_y) <= height / 2)
        assert self.stop.measured is not None
        rows, columns = (
            np.clip(((1 + g) / 2 * n).astype(int), 0, n - 1)
            for g, n in zip((-g_y, g_x), self.stop.measured.shape, strict=True)
        )
        return passes & self.stop.measured[rows, columns]

    @property
    def of_rays(self) -> Optics:
        """The same with light as it should be: without the beam, which may be measured pixel by pixel, and with colors
        that lie on each other."""
        return replace(self, beam=Beam(), **dict.fromkeys(COLORS, ()))

    @property
    def colors_apart(self) -> bool:
        """Whether colors do not lie on each other by themselves."""
        return bool(self.color_scale or self.color_distance or self.color_shift)

    def color(self, number: int) -> tuple[float, float, tuple[float, float]]:
        """Scale, distance and shift of the wavelength of this number."""
        return (
            self.color_scale[number] if self.color_scale else 1.0,
            self.color_distance[number] if self.color_distance else 0.0,
            self.color_shift[number] if self.color_shift else (0.0, 0.0),
        )

    def passes(self, shape: Sequence[int], pitch: Pitch = 1.0) -> np.ndarray:
        """FFT bins of a field on a grid of the pixels' pitch that pass the stop, bool; row 0 is the top.

        Pixels of any size are alike if they are square, which is the default.
        """
        fy, fx = frequencies(shape, pitch)
        return self.open_at(2 * fx[None, :], -2 * fy[:, None])

    def _open_grid(self):
        axis = np.linspace(-1, 1, GRID)
        return self.open_at(axis[None, :], -axis[:, None])

    @property
    def opening(self) -> tuple[float, float, float]:
        """Middle, from the picture's middle ray, and radius of the largest circle that is open; of the band's edge."""
        if not self.stopped:
            return 0.0, 0.0, 1.0
        if self.stop.kind == "circle":
            return 0.0, 0.0, self._radius
        inside = scipy.ndimage.distance_transform_edt(np.pad(self._open_grid(), 1))[1:-1, 1:-1]
        rows, columns = np.nonzero(
            inside > inside.max() - 1.5
        )  # of circles as large, the one around the middle ray
        step = 2 / (GRID - 1)
        x, y = columns * step - 1, 1 - rows * step
        middle = np.argmin(np.hypot(x, y))
        radius = (inside[rows[middle], columns[middle]] - 0.5) * step
        return float(x[middle]), float(y[middle]), float(radius)

    def share(self, x: float, y: float, radius: float) -> float:
        """Of what is open, how much lies in a circle, all in units of the band's edge."""
        axis, passes = np.linspace(-1, 1, GRID), self._open_grid()
        inside = np.hypot(axis[None, :] - x, -axis[:, None] - y) <= radius
        return float((passes & inside).sum() / passes.sum())

    def check(self, shape: Sequence[int], pitch: Pitch, wavelengths: Sequence[float]) -> None:
        """Refuse what does not go with a panel of such pixels.

        Raises
        ------
        InvalidInput
        """
        self.beam.check(shape, pitch, wavelengths)
        for name, each in (
            ("scale", self.color_scale),
            ("distance", self.color_distance),
            ("shift", self.color_shift),
        ):
            if each and len(each) != len(wavelengths):
                raise InvalidInput(
                    f"The bench has a {name} of {len(each)} colors, the hologram {len(wavelengths)}: give one for each "
                    "wavelength."
                )
        if self.colors_apart and len(set(wavelengths)) < len(wavelengths):
            raise InvalidInput(
                "Of equal wavelengths none can lie apart: give each once, or leave out where colors lie."
            )

    def illumination(
        self, shape: Sequence[int], pitch: Pitch, wavelength: float, number: int = 0
    ) -> np.ndarray | None:
        """What the transmission of the SLM's pixels is multiplied with to be the picture's light; None for 1.

        It is the beam, seen along the carrier: exp(-i pi (c_x x + c_y y) / pitch) times `Beam.light`.
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
        """JSON-able form of what is not as by default; of arrays their SHA-256."""
        told = {}
        for name, part, default in (("beam", self.beam, Beam()), ("stop", self.stop, Stop())):
            if part != default:
                told[name] = {"kind": part.kind, "numbers": list(part.numbers)}
                told[name] |= {"sha256": part.digest} if part.digest else {}
        if self.stopped:
            told["carrier"] = list(self.carrier)
        if self.lens is not None:
            told["lens"] = asdict(self.lens)
        for name in COLORS:
            if getattr(self, name):
                told[name] = [list(each) if isinstance(each, tuple) else each for each in getattr(self, name)]
        return told

    def save(self, folder: Path) -> None:
        """Write arrays that `to_dict` leaves out into a folder."""
        for name, part in ((BEAM_FILE, self.beam), (STOP_FILE, self.stop)):
            if part.measured is not None:
                np.save(folder / name, part.measured)

    @classmethod
    def from_dict(cls, values: dict, folder: Path | None = None) -> Optics:
        """Inverse of `to_dict`, with arrays of the folder into which `save` wrote them.

        Raises
        ------
        InvalidInput
            If arrays are not there.
        """
        beam, stop = (
            _part(kind, values.get(name, {}), folder, f"{name}.npy")
            for name, kind in (("beam", Beam), ("stop", Stop))
        )
        lens = Lens(**values["lens"]) if "lens" in values else None
        return cls(beam, values.get("carrier"), stop, *(values.get(name, ()) for name in COLORS), lens=lens)


ON_AXIS = Optics()


def _part(kind, values, folder, name):
    """A beam or a stop of its values."""
    if values.get("kind") != "measured":
        return kind(**values)
    if folder is None or not (folder / name).is_file():
        word = name.partition(".")[0]
        raise InvalidInput(f"The {word} was measured, and its array is not there: give it by --{word}.")
    return kind("measured", measured=np.load(folder / name, allow_pickle=False))


def _positions(shape, pitch):
    """x to the right and y up, meters from the panel's middle, of columns and rows."""
    y, x = ((np.arange(n) - (n - 1) / 2) * d for n, d in zip(shape, axes(pitch), strict=True))
    return x[None, :], -y[:, None]


def _scaled_to_1(measured: ArrayLike) -> np.ndarray:
    """A measured beam, complex64, of amplitude 1 where it is brightest."""
    array = np.asarray(measured)
    if array.ndim not in (2, 3) or not array.size or array.dtype.kind not in "fciub":
        raise InvalidInput("A measured beam is an array of numbers, of shape (y, x) or (wavelength, y, x).")
    if array.dtype.kind != "c" and (array < 0).any():
        raise InvalidInput("The measured beam's amplitude goes below 0: give complex numbers for phases.")
    array = array.astype(np.complex128)
    largest = np.abs(array).max(initial=0.0)
    if not 0 < largest < math.inf:
        raise InvalidInput("The measured beam is dark, or has values that are not finite: measure it again.")
    return (array / largest).astype(np.complex64)
