"""The bench around the SLM: the beam that falls on it, and the viewer's pupil.

One word has one meaning: the pupil is the viewer's, the aperture the SLM's.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .errors import InvalidInput

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
BEAM_FILE = "beam.npy"


@dataclass(frozen=True)
class Pupil:
    """A circular part of the viewer's pupil plane, in world metres about the camera's axis.

    Attributes
    ----------
    x, y : float
        Centre, to the right and up.
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

    With x to the right and y up from the panel's middle, in meters, and k = 2 pi / wavelength:

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

    def light(self, shape: Sequence[int], pitch: float, wavelength: float, number: int = 0) -> np.ndarray:
        """Complex amplitude at the panel's pixels, complex64, shape (y, x).

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of the panel.
        pitch, wavelength : float
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

    def check(self, shape: Sequence[int], pitch: float, wavelengths: Sequence[float]) -> None:
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
        steepest, edge = self._steepest(shape, pitch), min(wavelengths) / (2 * pitch)
        if steepest > edge:
            raise InvalidInput(
                f"The beam meets the panel at {math.degrees(math.asin(min(1.0, steepest))):.3g} degrees, and pixels of "
                f"{pitch * 1e6:g} µm make up for {math.degrees(math.asin(edge)):.3g} at most: tilt or focus it less."
            )

    def _steepest(self, shape, pitch):
        """Largest sine of the beam's direction, to either side, on the panel."""
        if self.kind == "tilt":
            return max(abs(math.sin(angle)) for angle in self.numbers)
        if self.kind == "point":
            corner = [n * pitch / 2 for n in shape]
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
class Optics:
    """The bench around the SLM. By default light falls evenly on it.

    Parameters
    ----------
    beam : Beam
        That falls on the SLM.

    Raises
    ------
    InvalidInput
    """

    beam: Beam = field(default_factory=Beam)

    def check(self, shape: Sequence[int], pitch: float, wavelengths: Sequence[float]) -> None:
        """Refuse what does not go with a panel of such pixels.

        Raises
        ------
        InvalidInput
        """
        self.beam.check(shape, pitch, wavelengths)

    def illumination(
        self, shape: Sequence[int], pitch: float, wavelength: float, number: int = 0
    ) -> np.ndarray | None:
        """What the transmission of the SLM's pixels is multiplied with, as `Beam.light`; None for 1."""
        if self.beam == Beam():
            return None
        return self.beam.light(shape, pitch, wavelength, number)

    def to_dict(self) -> dict:
        """JSON-able form of what is not as by default; of arrays their SHA-256."""
        told = {}
        if self.beam != Beam():
            told["beam"] = {"kind": self.beam.kind, "numbers": list(self.beam.numbers)}
            if self.beam.digest:
                told["beam"]["sha256"] = self.beam.digest
        return told

    def save(self, folder: Path) -> None:
        """Write arrays that `to_dict` leaves out into a folder."""
        if self.beam.measured is not None:
            np.save(folder / BEAM_FILE, self.beam.measured)

    @classmethod
    def from_dict(cls, values: dict, folder: Path | None = None) -> Optics:
        """Inverse of `to_dict`, with arrays of the folder into which `save` wrote them.

        Raises
        ------
        InvalidInput
            If arrays are not there.
        """
        beam = values.get("beam", {})
        if beam.get("kind") != "measured":
            return cls(Beam(**beam))
        if folder is None or not (folder / BEAM_FILE).is_file():
            raise InvalidInput("The beam was measured, and its array is not there: give it by --beam.")
        return cls(Beam("measured", measured=np.load(folder / BEAM_FILE, allow_pickle=False)))


def _positions(shape, pitch):
    """x to the right and y up, meters from the panel's middle, of columns and rows."""
    y, x = ((np.arange(n) - (n - 1) / 2) * pitch for n in shape)
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
