"""What a device needs so that its pixels have the phases that are meant, and its form on disk."""

from __future__ import annotations

import json
import math
import os
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engine.errors import InvalidInput
from ..engine.pixels import coarsest
from ..engine.scene import variants
from ..engine.waves.display_model import DisplayModel
from ..engine.waves.modulator import MIN_LEVELS, Levels, grey_levels, one_turn, unwrapped, varying
from .sensor import Sensor
from .tables import MAX_TURNS, read_response

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from ..engine.hologram import Hologram

FORMAT, FORMAT_VERSION = "HoloPath SLM calibration", 1
STEPS = 1 << 16  # of a turn, in the table from phase to level
# Where a response varies: shares of it between the least and the largest, each with a table of fewer steps
SHARES, COARSE_STEPS = 256, 1 << 12
LARGEST = 1 << 15  # pixels of a side
FITTED = 3e-9  # metres from the wavelength at which a model was fitted, within which it holds
MOST_CORRECTION = float(1 << 20)  # radians, that float32 holds to a hundredth of a turn
SAME = 0.5e-9  # metres within which a wavelength is the one that was measured


def _scale(measured, wavelength):
    """Phase at a wavelength in terms of that at the one where it was measured: the optical path is the same."""
    return 1.0 if wavelength is None or abs(wavelength - measured) < SAME else measured / wavelength


def _check_wavelength(wavelength):
    if not 1e-7 < wavelength < 1e-4:
        raise InvalidInput(
            f"A wavelength of {wavelength * 1e9:g} nm is out of reach: give one in nm, 100 to 100000."
        )


@dataclass(frozen=True)
class Response:
    """Phase that a device's levels give at one wavelength.

    Parameters
    ----------
    wavelength : float
        Metres, at which it was measured.
    range : float
        Turns (fractions of 2 pi) that all levels span together: level n of N gives 2 pi range n / N.
    curve : tuple of (float, float), optional
        Measured instead: level and phase in radians, not wrapped, at least two, between which lines are drawn; they
        span all levels.

    Raises
    ------
    InvalidInput
        On a response that no device can have.
    """

    wavelength: float
    range: float = 1.0
    curve: tuple | None = None

    def __post_init__(self):
        _check_wavelength(self.wavelength)
        if not 0.05 <= self.range <= MAX_TURNS:
            raise InvalidInput(f"A range of {self.range:g} turns is no SLM's: give a number near 1.")
        if self.curve is not None:
            try:
                curve = np.asarray(self.curve, float)
            except (TypeError, ValueError):
                curve = np.empty(0)
            if curve.ndim != 2 or curve.shape[1] != 2 or len(curve) < 2 or not np.isfinite(curve).all():
                raise InvalidInput(
                    "A measured curve is a list of pairs of level and phase in radians, at least two."
                )
            if (np.diff(curve[:, 0]) <= 0).any():
                raise InvalidInput("The levels of a measured curve must rise.")
            if np.abs(curve[:, 1]).max() > MAX_TURNS * 2 * math.pi:
                raise InvalidInput(
                    f"A measured curve of more than {MAX_TURNS} turns is no SLM's: give its phases in radians."
                )
            object.__setattr__(self, "curve", tuple(map(tuple, curve.tolist())))

    def phases(self, bits: int, wavelength: float | None = None) -> np.ndarray:
        """Phase of each level at a wavelength, radians, array of 2^bits.

        Away from where it was measured the phase goes as 1 / wavelength: the optical path stays, dispersion is left
        out.
        """
        levels = np.arange(2**bits)
        if self.curve is None:
            phases = levels * (2 * math.pi * self.range / 2**bits)
        else:
            at, phases = np.transpose(self.curve)
            if at[0] > 0 or at[-1] < levels[-1]:
                raise InvalidInput(
                    f"The curve at {self.wavelength * 1e9:g} nm runs from level {at[0]:g} to {at[-1]:g}: measure it "
                    f"from 0 to {levels[-1]}."
                )
            phases = np.interp(levels, at, unwrapped(phases))
        return phases * _scale(self.wavelength, wavelength)

    def linear(self, wavelength: float) -> bool:
        """Whether the levels are even steps of one whole turn."""
        return self.curve is None and math.isclose(
            self.range * _scale(self.wavelength, wavelength), 1.0, rel_tol=1e-9
        )


@dataclass(frozen=True, eq=False)
class Calibration:
    """How phases become a device's levels.

    Parameters
    ----------
    device : str
    bits : int
        Of a level, 1 to 16.
    size : (int, int), optional
        Width and height in pixels. Default: the hologram's.
    flip_x, flip_y : bool
        Mirror left and right, up and down.
    shift : (int, int)
        Pixels that the hologram is moved right and down from the device's middle.
    responses : tuple of Response
        Measured at one or more wavelengths; the nearest one is taken and scaled. Default: even steps of one turn at
        every wavelength.
    correction : numpy.ndarray, float32, shape (y, x), optional
        Phase in radians that is added at each of the device's pixels, so that a flat hologram is flat.
    correction_wavelength : float, optional
        Metres, at which that was measured; at others it goes as 1 / wavelength.
    models : tuple of engine.DisplayModel
        What else the display does to light, fitted at one or more wavelengths; see `slm.fit`.
    sensors : tuple of Sensor
        The camera of each of them.
    variation : numpy.ndarray, float32, shape (y, x), optional
        How many times the response each of the device's pixels shows, counted from level 0; see `engine.Levels`.
    falling : bool
        Whether the phase of the light falls as the level rises, by as much as the responses say that it rises. A
        measured curve says it itself.

    Raises
    ------
    InvalidInput
    """

    device: str = ""
    bits: int = 8
    size: tuple | None = None
    flip_x: bool = False
    flip_y: bool = False
    shift: tuple = (0, 0)
    responses: tuple = ()
    correction: np.ndarray | None = field(default=None, repr=False)
    correction_wavelength: float | None = None
    models: tuple = ()
    sensors: tuple = ()
    variation: np.ndarray | None = field(default=None, repr=False)
    falling: bool = False

    def __post_init__(self):
        if not 1 <= self.bits <= 16:
            raise InvalidInput(f"An SLM has 1 to 16 bits, not {self.bits}.")
        if self.size is not None and not (1 <= min(self.size) and max(self.size) <= LARGEST):
            raise InvalidInput(
                f"A device of {self.size[0]} x {self.size[1]} pixels cannot be: give its size."
            )
        if max(map(abs, self.shift)) > LARGEST:
            raise InvalidInput(f"A shift has {LARGEST} pixels at most: give one that stays on the device.")
        for response in self.responses:
            shown = response.phases(self.bits)  # its curve spans the levels
            if self.falling and shown[-1] < shown[0]:
                raise InvalidInput(
                    f"The curve at {response.wavelength * 1e9:g} nm falls already: leave out that phases fall."
                )
        if self.correction is not None:
            correction = np.asarray(self.correction)
            if correction.ndim != 2 or not correction.size or correction.dtype.kind not in "fiu":
                raise InvalidInput("The correction is no map of phases, one a pixel: give its radians.")
            if not np.abs(correction, dtype=float).max() <= MOST_CORRECTION:  # NaN is no less
                raise InvalidInput(
                    f"The correction is not finite, or goes beyond {MOST_CORRECTION:.0f}: give its radians."
                )
            correction = np.ascontiguousarray(correction, np.float32)
            self._check_size("correction", correction)
            if self.correction_wavelength is None:
                raise InvalidInput("The correction lacks the wavelength at which it was measured.")
            _check_wavelength(self.correction_wavelength)
            object.__setattr__(self, "correction", correction)
        if self.variation is not None:
            object.__setattr__(self, "variation", varying(self.variation))
            self._check_size("variation", self.variation)
            if self.models:
                raise InvalidInput(
                    "A response that varies over the device does not go with a display that was fitted: leave out the "
                    "variation or the displays."
                )

    def _check_size(self, name, values):
        if self.size is not None and values.shape != tuple(self.size)[::-1]:
            raise InvalidInput(
                f"The {name} has {values.shape[1]} x {values.shape[0]} pixels, the device "
                f"{self.size[0]} x {self.size[1]}: give one of the device's size."
            )

    @property
    def plain(self) -> bool:
        """Whether levels are shown where and as they are found: not mirrored, moved, corrected, varying or falling."""
        moved = self.flip_x or self.flip_y or any(self.shift) or self.falling
        return not moved and self.correction is None and self.variation is None

    def response(self, wavelength: float) -> Response:
        """The `Response` that was measured nearest to a wavelength."""
        if not self.responses:
            return Response(wavelength)
        return min(self.responses, key=lambda r: abs(r.wavelength - wavelength))

    def phases(self, wavelength: float) -> np.ndarray:
        """Phase of each level at a wavelength, radians, shape (level,)."""
        shown = self.response(wavelength).phases(self.bits, wavelength)
        return -shown if self.falling else shown

    def levels_of(self, hologram: Hologram) -> list[Levels]:
        """What the device can show of a hologram at each wavelength, for `engine.encode`.

        Raises
        ------
        InvalidInput
            If a map does not fit the device, or the hologram lies beside it.
        """
        shape = hologram.height, hologram.width
        device = shape if self.size is None else self.size[::-1]
        found, variation = [], self._shown_variation(device)
        if variation is not None:
            variation = self._under(variation - 1, shape) + 1
        for wavelength in hologram.wavelengths:
            correction = self._scaled_correction(wavelength, device)
            if correction is not None:
                correction = self._under(correction, shape)
            phases = self.phases(wavelength)
            if self.models:
                phases = phases[self._used(phases)]
            found.append(Levels(phases, correction, variation))
        return found

    def display(self, wavelengths: Sequence[float]) -> list[DisplayModel] | None:
        """Fitted models for `engine.encode`, one a wavelength in metres; None where none was fitted.

        Raises
        ------
        InvalidInput
            If a wavelength was not fitted.
        """
        return [self._fitted(each)[0] for each in wavelengths] if self.models else None

    def sensor(self, wavelength: float) -> Sensor:
        """The camera, as it was found with the model of a wavelength.

        Raises
        ------
        InvalidInput
            If there was none.
        """
        return self._fitted(wavelength)[1]

    def _fitted(self, wavelength):
        pairs = list(zip(self.models, self.sensors, strict=True))
        apart = [abs(model.wavelength - wavelength) for model, _ in pairs]
        if min(apart, default=FITTED) < FITTED:
            return pairs[apart.index(min(apart))]
        known = ", ".join(f"{model.wavelength * 1e9:g}" for model in self.models) or "none"
        raise InvalidInput(
            f"The display was not calibrated at {wavelength * 1e9:g} nm, only at {known}: run `holopath "
            "calibrate` there."
        )

    def table(self, wavelength: float) -> np.ndarray:
        """Level for each of `STEPS` phases of a turn: the one whose phase is nearest, around the circle.

        With a variation a table for each of `SHARES` between the least and the largest, shape (`SHARES`,
        `COARSE_STEPS`): phases are right to 0.01 rad where it is within a tenth of 1, of a response of a turn.
        """
        phases = self.phases(wavelength)
        if self.variation is not None:
            shares = np.linspace(self.variation.min(), self.variation.max(), SHARES)
            return np.stack(
                [self._table(phases[0] + share * (phases - phases[0]), COARSE_STEPS) for share in shares]
            )
        return self._table(phases, STEPS)

    def _used(self, phases):
        """Which levels are; a model's crosstalk knows no more than a turn."""
        return one_turn(phases, 2 if self.models else MIN_LEVELS)

    def _table(self, phases, steps):
        used = np.flatnonzero(self._used(phases))
        phases = np.mod(phases[used], 2 * math.pi)
        order = np.argsort(phases, kind="stable")
        ring, order = phases[order], used[order]
        edges = np.append((ring[1:] + ring[:-1]) / 2, (ring[0] + 2 * math.pi + ring[-1]) / 2)
        wanted = np.arange(steps) * (2 * math.pi / steps)
        wanted = np.where(wanted < edges[-1] - 2 * math.pi, wanted + 2 * math.pi, wanted)
        nearest = np.searchsorted(edges, wanted, side="left") % len(ring)
        return order[nearest].astype(np.uint8 if self.bits <= 8 else np.uint16)

    def levels(self, phases: np.ndarray, wavelength: float, table: np.ndarray | None = None) -> np.ndarray:
        """Levels for the device's pixels.

        Parameters
        ----------
        phases : numpy.ndarray, shape (y, x)
            Radians, of a hologram that is no larger than the device.
        wavelength : float
            Metres.
        table : numpy.ndarray, optional
            `table` of that wavelength, where it is kept.

        Returns
        -------
        numpy.ndarray, uint8 or uint16, shape (height, width)

        Raises
        ------
        InvalidInput
            If the hologram does not fit.
        """
        phases = np.asarray(phases, np.float32)[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1]
        phases = self._placed(phases)
        correction = self._scaled_correction(wavelength, phases.shape)
        if correction is not None:
            phases = np.mod(phases + correction, np.float32(2 * math.pi))
        variation = self._shown_variation(phases.shape)
        if variation is None and not self.falling and self.response(wavelength).linear(wavelength):
            return grey_levels(phases, self.bits).astype(np.uint8 if self.bits <= 8 else np.uint16)
        table = self.table(wavelength) if table is None else table
        steps = table.shape[-1]
        step = np.round(phases * np.float32(steps / (2 * math.pi))).astype(np.uint32) & (steps - 1)
        if variation is None:
            return table[step]
        low, high = variation.min(), variation.max()
        return table[
            np.round((variation - low) * ((SHARES - 1) / max(high - low, 1e-6))).astype(np.uint8), step
        ]

    def _shown_variation(self, shape):
        """The variation of a device of such a shape; None where all pixels are alike."""
        if self.variation is not None and self.variation.shape != shape:
            raise InvalidInput(
                f"The variation has {self.variation.shape[1]} x {self.variation.shape[0]} pixels, what is shown "
                f"{shape[1]} x {shape[0]}: give the device's size in the calibration."
            )
        return self.variation

    def _scaled_correction(self, wavelength, shape):
        if self.correction is None or self.correction_wavelength is None:
            return None
        if self.correction.shape != shape:
            raise InvalidInput(
                f"The correction has {self.correction.shape[1]} x {self.correction.shape[0]} pixels, what is shown "
                f"{shape[1]} x {shape[0]}: give the device's size in the calibration."
            )
        return np.float32(_scale(self.correction_wavelength, wavelength)) * self.correction

    def _placed(self, phases):
        """On the device, in its middle but for the shift; around it is phase 0."""
        height, width = phases.shape
        to_width, to_height = self.size or (width, height)
        if width > to_width or height > to_height:
            raise InvalidInput(
                f"The hologram has {width} x {height} pixels, the device only {to_width} x {to_height}: render it "
                "for this device, or choose another."
            )
        if (to_width, to_height) == (width, height) and tuple(self.shift) == (0, 0):
            return phases
        there, here = self._windows(phases.shape, (to_height, to_width))
        placed = np.zeros((to_height, to_width), np.float32)
        placed[there] = phases[here]
        return placed

    def _windows(self, hologram, device):
        """Slices of the device's and of the hologram's pixels, shapes (y, x), that lie on each other."""
        there, here = [], []
        for size, whole, shift in zip(hologram, device, self.shift[::-1], strict=True):
            begin = (whole - size) // 2 + shift
            first, last = max(begin, 0), min(begin + size, whole)
            if first >= last:
                raise InvalidInput(
                    f"A shift of {self.shift[0]}, {self.shift[1]} pixels moves the hologram off the device."
                )
            there.append(slice(first, last))
            here.append(slice(first - begin, last - begin))
        return tuple(there), tuple(here)

    def seen(
        self,
        levels: np.ndarray,
        wavelength: float,
        shape: tuple[int, int],
        blurred: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> np.ndarray:
        """What a device that this calibration describes makes of levels: the reverse of `levels`.

        Parameters
        ----------
        levels : numpy.ndarray, integers, shape (height, width)
            Of the device's pixels.
        wavelength : float
            Metres.
        shape : (int, int)
            Rows and columns of the hologram.
        blurred : callable, optional
            What neighboring pixels do to each other: from phases that the response gives, which may be of more than a
            turn, radians, shape (height, width), to those that the panel has.

        Returns
        -------
        numpy.ndarray, float32, shape (y, x)
            Phases in [0, 2 pi) at the hologram's pixels; 0 where they lie beside the device.
        """
        response = self.phases(wavelength).astype(np.float32)
        phases = response[levels]
        variation = self._shown_variation(phases.shape)
        if variation is not None:
            phases = response[0] + variation * (phases - response[0])
        if blurred is not None:
            phases = blurred(phases)
        correction = self._scaled_correction(wavelength, phases.shape)
        if correction is not None:
            phases = phases - correction
        return self._under(np.mod(phases, np.float32(2 * math.pi)), shape)

    def _under(self, values, shape):
        """Of the device's pixels, those under a hologram of such a shape; 0 where it lies beside the device."""
        there, here = self._windows(shape, values.shape)
        under = np.zeros(shape, np.float32)
        under[here] = values[there]
        return under[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1]

    def save(self, path: Path | str) -> None:
        """Write a JSON file, and beside it ``.npy`` for the correction and the variation.

        Raises
        ------
        OSError
        """
        path = Path(path)
        correction = variation = None
        if self.correction is not None and self.correction_wavelength is not None:
            correction = {
                "file": _write_map(path, "correction", self.correction),
                "wavelength_nm": self.correction_wavelength * 1e9,
            }
        if self.variation is not None:
            variation = {"file": _write_map(path, "variation", self.variation)}
        said = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "device": self.device,
            "bits": self.bits,
            "size": list(self.size) if self.size else None,
            "flip_x": self.flip_x,
            "flip_y": self.flip_y,
            "shift": list(self.shift),
            "responses": [
                {"wavelength_nm": r.wavelength * 1e9, "range": r.range, "curve": r.curve}
                for r in self.responses
            ],
            "falling": self.falling,
            "correction": correction,
            "variation": variation,
            "displays": [
                {**model.to_dict(), "camera": sensor.to_dict()}
                for model, sensor in zip(self.models, self.sensors, strict=True)
            ],
        }
        part = path.with_name(f".part-{path.name}")
        part.write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")
        os.replace(part, path)

    @classmethod
    def load(cls, path: Path | str) -> Calibration:
        """Read what `save` wrote, or what was written by hand: all but ``format`` may be left out.

        The correction may also be a picture of 8 bits, of which 256 levels are a turn, as makers of SLMs give it. It is
        unwrapped: for that its neighbors differ by less than half a turn.

        Raises
        ------
        InvalidInput
            If the file cannot be read or says what no device has.
        """
        path = Path(path)
        with _calibration(path) as said:
            correction = at = variation = None
            if said.get("correction"):
                at = float(said["correction"]["wavelength_nm"]) * 1e-9
                correction = _read_map(_map_file(path, said, "correction"))
            if said.get("variation"):
                variation = np.load(_map_file(path, said, "variation"), allow_pickle=False)
            size = said.get("size")
            found = cls(
                str(said.get("device", "")),
                _whole(said.get("bits", 8)),
                _pair(size) if size else None,
                _truth(said.get("flip_x", False)),
                _truth(said.get("flip_y", False)),
                _pair(said.get("shift", (0, 0))),
                tuple(
                    Response(
                        float(r["wavelength_nm"]) * 1e-9,
                        float(r.get("range", 1.0)),
                        _curve(path.with_name(str(r["file"]))) if r.get("file") else r.get("curve"),
                    )
                    for r in said.get("responses", ())
                ),
                correction,
                at,
                tuple(DisplayModel.from_dict(each) for each in said.get("displays", ())),
                tuple(Sensor.from_dict(each["camera"]) for each in said.get("displays", ())),
                variation,
                _truth(said.get("falling", False)),
            )
        return found


@contextmanager
def _calibration(path: Path) -> Iterator[dict]:
    """What a file says; errors of the block name it."""
    try:
        said = json.loads(path.read_text(encoding="utf-8-sig"))  # editors on Windows begin with a mark
        if not isinstance(said, dict):
            raise ValueError("it is no JSON object")
        if said["format"] != FORMAT or said.get("format_version", 1) != FORMAT_VERSION:
            raise ValueError("another format, or a newer one")
        yield said
    except InvalidInput as error:
        raise InvalidInput(f"The calibration {path}: {error}") from None
    except Exception as error:  # there is no end to what a file may hold
        reason = f"it lacks {error}" if isinstance(error, KeyError) else _reason(error)
        raise InvalidInput(
            f"The calibration {path} cannot be read ({reason}): write it as docs/slm.md says."
        ) from None


def measured_levels(path: Path | str, hologram: Hologram) -> list[Levels]:
    """What a device can show, for `engine.encode`.

    Parameters
    ----------
    path : path
        A `Calibration`, ending on .json, or a text file as `read_response` takes it, whose phases are those of every
        wavelength.
    hologram : engine.Hologram

    Returns
    -------
    list of engine.Levels
        For each wavelength.

    Raises
    ------
    InvalidInput
    """
    path = Path(path)
    given = Calibration.load(path) if _calibrates(path) else read_response(path)
    try:
        if isinstance(given, Calibration):
            return given.levels_of(hologram)
        return [Levels(given)] * len(hologram.wavelengths)
    except InvalidInput as error:
        raise InvalidInput(f"The file {path}: {error}") from None


def response_files(path: Path | str) -> dict[str, Path]:
    """Files of which `measured_levels` is made, by what they are.

    Raises
    ------
    InvalidInput
    """
    files = {"response": Path(path)}
    if _calibrates(files["response"]):
        with _calibration(files["response"]) as said:
            for name in ("correction", "variation"):
                if said.get(name):
                    files[name] = _map_file(files["response"], said, name)
            for number, response in enumerate(said.get("responses", ())):
                if response.get("file"):
                    files[f"table {number}"] = files["response"].with_name(str(response["file"]))
    return files


def _calibrates(path):
    return path.suffix.lower() == ".json"


def _map_file(path, said, name):
    return path.with_name(str(said[name]["file"]))


def _write_map(path, name, values):
    """A map beside a file; gives its name."""
    file_name = f"{path.stem}.{name}.npy"
    part = path.with_name(f".part-{file_name}")
    with open(part, "wb") as file:
        np.save(file, values)
    os.replace(part, path.with_name(file_name))
    return file_name


def fitted_display(path: Path | str, wavelengths: Sequence[float]) -> list[DisplayModel] | None:
    """What a display does to light at each wavelength, metres, of a `Calibration` file; None where none was fitted.

    Raises
    ------
    InvalidInput
    """
    if Path(path).suffix.lower() != ".json":
        return None
    return Calibration.load(path).display(wavelengths)


def colors_of(path: Path | str, hologram: Hologram) -> dict[str, Any]:
    """Where the cameras of a calibration saw each color of a hologram, as `engine.Optics` takes it.

    The scale and the shift are those of the homographies at the focus nearest to the SLM, in terms of the color in the
    middle of the spectrum: a camera's magnification is not known by itself. The distance is that of the fitted
    defocus. With Noll's fourth polynomial, sqrt(3) (2 rho^2 - 1), and rho = 1 at a sine of wavelength / (2 pitch),
    a defocus a looks like a picture that lies 8 sqrt(3) a pitch^2 / (pi wavelength) too near to the viewer.

    Parameters
    ----------
    path : path
        A `Calibration`.
    hologram : engine.Hologram

    Returns
    -------
    dict
        `color_scale`, `color_distance` in meters and `color_shift` in meters.

    Raises
    ------
    InvalidInput
        If a wavelength was not calibrated, or no focus is one of all colors.
    """
    calibration, wavelengths = Calibration.load(path), hologram.wavelengths
    models, sensors = zip(*(calibration._fitted(each) for each in wavelengths), strict=True)
    foci = set.intersection(*(set(sensor.homographies) for sensor in sensors))
    if not foci:
        raise InvalidInput(
            f"The calibration {path} has no focus at which a camera saw every color: calibrate each at the same foci."
        )
    focus, middle = min(foci, key=abs), sorted(wavelengths)[len(wavelengths) // 2]
    reference = sensors[wavelengths.index(middle)]
    scale, shift = [], []
    for model, sensor in zip(models, sensors, strict=True):
        at, size = sensor.middle(focus)
        scale.append(round(size / reference.middle(focus)[1], 6))
        half = model.half or hologram.shorter_side / 2
        xi, eta = reference.on_slm(focus, at)
        shift.append((round(xi * half, 9), round(-eta * half, 9)))
    distance = (
        round(
            8
            * math.sqrt(3)
            * model.aberrations[0]
            * coarsest(hologram.pitch) ** 2
            / (math.pi * model.wavelength),
            9,
        )
        for model in models
    )
    return {"color_scale": tuple(scale), "color_distance": tuple(distance), "color_shift": tuple(shift)}


def _curve(path):
    """Level and phase of a table's file."""
    return tuple((level, float(phase)) for level, phase in enumerate(read_response(path)))


def _truth(value):
    if not isinstance(value, bool):
        raise ValueError(f"{value!r} is neither true nor false")
    return value


def _pair(values):
    first, second = values
    return _whole(first), _whole(second)


def _whole(value):
    if isinstance(value, bool) or value != int(value) or abs(value) > LARGEST:
        raise ValueError(f"{value!r} is no whole number up to {LARGEST}")
    return int(value)


def _reason(error):
    """What an error says, in a line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def _read_map(path):
    """Phases in radians from an array or a picture."""
    if path.suffix.lower() == ".npy":
        return np.load(path, allow_pickle=False)
    levels = np.array(variants.bitmaps().Bitmap(str(path)), copy=False)
    if levels.dtype != np.uint8:
        raise ValueError(f"{path.name} is no picture of 8 bits")
    levels = levels if levels.ndim == 2 else levels[..., 0]
    # of more than a turn it is wrapped, and for other wavelengths a turn is another length
    turns = np.unwrap(np.unwrap(levels / 256.0, axis=0, period=1.0), axis=1, period=1.0)
    return (2 * math.pi * turns).astype(np.float32)
