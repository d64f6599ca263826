"""The calibration of a device: from phases to its levels and back, and the calibration file."""

from __future__ import annotations

import difflib
import json
import math
import os
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engine.errors import InvalidInput
from ..engine.files import check_palette
from ..engine.pixels import coarsest
from ..engine.scene import variants
from ..engine.waves.display_model import DisplayModel
from ..engine.waves.modulator import MIN_LEVELS, Levels, check_variation, gray_levels, one_turn, unwrapped
from .sensor import Sensor
from .tables import MAX_TURNS, read_response

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from ..engine.hologram import Hologram

FORMAT, FORMAT_VERSION = "HoloPath SLM calibration", 1
STEPS = 1 << 16  # of a turn, in the table from phase to level
# Where the response varies: factors between the smallest and the largest, each with a table of fewer steps
FACTORS, COARSE_STEPS = 256, 1 << 12
MAX_SIDE = 1 << 15  # pixels
FIT_TOLERANCE = 3e-9  # meters from the wavelength of a fitted model, within which it holds
MAX_CORRECTION = float(1 << 20)  # radians, which float32 resolves to a hundredth of a turn
SAME_WAVELENGTH = 0.5e-9  # meters between wavelengths that count as one
# Keys of the file, and of the objects within it by their names
KEYS = {
    "the file": (
        *("format", "format_version", "device", "bits", "size", "flip_x", "flip_y", "shift", "falling"),
        *("responses", "correction", "variation", "displays"),
    ),
    "responses": ("wavelength_nm", "range", "curve", "file"),
    "correction": ("file", "wavelength_nm"),
    "variation": ("file",),
    "displays": (*DisplayModel(5e-7).to_dict(), "camera"),
    "camera": ("size", "gain", "black", "gamma", "homographies"),
    "homographies": ("focus_mm", "matrix"),
}


def _scale(reference, wavelength):
    """Ratio of the phase at a wavelength to that at a reference wavelength: the optical path is the same."""
    return (
        1.0 if wavelength is None or abs(wavelength - reference) < SAME_WAVELENGTH else reference / wavelength
    )


def _check_wavelength(wavelength):
    if not 1e-7 < wavelength < 1e-4:
        raise InvalidInput(f"Expected a wavelength from 100 to 100000 nm, got {wavelength * 1e9:g} nm.")


@dataclass(frozen=True)
class Response:
    """Phase of a device's levels at one wavelength.

    Parameters
    ----------
    wavelength : float
        Wavelength of the measurement, meters.
    range : float
        Turns (fractions of 2 pi) that all levels span together: level n of N has the phase 2 pi range n / N.
    curve : tuple of (float, float), optional
        A measured curve instead: at least two pairs of level and unwrapped phase in radians, which span all levels and
        are interpolated linearly.

    Raises
    ------
    InvalidInput
        If no device can have such a response.
    """

    wavelength: float
    range: float = 1.0
    curve: tuple | None = None

    def __post_init__(self):
        _check_wavelength(self.wavelength)
        if not 0.05 <= self.range <= MAX_TURNS:
            raise InvalidInput(
                f"Expected a range from 0.05 to {MAX_TURNS} turns, got {self.range:g}. SLMs have about 1."
            )
        if self.curve is not None:
            try:
                curve = np.asarray(self.curve, float)
            except (TypeError, ValueError):
                curve = np.empty(0)
            if curve.ndim != 2 or curve.shape[1] != 2 or len(curve) < 2 or not np.isfinite(curve).all():
                raise InvalidInput(
                    "Expected a measured curve of two or more pairs of level and phase in radians."
                )
            if (np.diff(curve[:, 0]) <= 0).any():
                raise InvalidInput("The levels of a measured curve must increase.")
            if np.abs(curve[:, 1]).max() > MAX_TURNS * 2 * math.pi:
                raise InvalidInput(
                    f"The measured curve exceeds {MAX_TURNS} turns. Give its phases in radians."
                )
            object.__setattr__(self, "curve", tuple(map(tuple, curve.tolist())))

    def phases(self, bits: int, wavelength: float | None = None) -> np.ndarray:
        """Phase of each level at a wavelength, radians, array of 2^bits.

        The phase scales as 1 / wavelength from that of the measurement: the optical path stays, dispersion is
        neglected.

        Parameters
        ----------
        bits : int
            Bits of a level.
        wavelength : float, optional
            Meters. Default: that of the measurement.

        Raises
        ------
        InvalidInput
            If the curve does not span all levels, or runs beyond them.
        """
        levels = np.arange(2**bits)
        if self.curve is None:
            phases = levels * (2 * math.pi * self.range / 2**bits)
        else:
            at, phases = np.transpose(self.curve)
            if at[0] > 0 or at[-1] < levels[-1]:
                raise InvalidInput(
                    f"The curve at {self.wavelength * 1e9:g} nm runs from level {at[0]:g} to {at[-1]:g}. Measure it "
                    f"from 0 to {levels[-1]}, or give a range of {len(levels)}/L instead if it rises evenly to 2 pi at "
                    "level L."
                )
            if at[-1] > len(levels):
                raise InvalidInput(
                    f"The curve at {self.wavelength * 1e9:g} nm runs to level {at[-1]:g}, but the highest level of "
                    f"{bits} bits is {levels[-1]}. Give the bits of its levels."
                )
            phases = np.interp(levels, at, unwrapped(phases))
        return phases * _scale(self.wavelength, wavelength)

    def linear(self, wavelength: float) -> bool:
        """Whether the levels are even steps of one whole turn at a wavelength in meters."""
        return self.curve is None and math.isclose(
            self.range * _scale(self.wavelength, wavelength), 1.0, rel_tol=1e-9
        )


@dataclass(frozen=True, eq=False)
class Calibration:
    """A device's map from phases to levels.

    Parameters
    ----------
    device : str
        Name of the device.
    bits : int
        Bits of a level, 1 to 16.
    size : (int, int), optional
        Width and height in pixels. Default: the hologram's.
    flip_x, flip_y : bool
        Mirror left and right, up and down.
    shift : (int, int)
        Pixels by which the hologram is moved right and down from the device's center.
    responses : tuple of Response
        Responses at one or more wavelengths; the nearest one is scaled. Default: even steps of one turn at every
        wavelength.
    correction : numpy.ndarray, float32, shape (y, x), optional
        Phase in radians that is added at each of the device's pixels, so that a flat hologram is flat.
    correction_wavelength : float, optional
        Wavelength of the correction, meters; at others it scales as 1 / wavelength.
    models : tuple of engine.DisplayModel
        Other effects of the display on light, fitted at one or more wavelengths; see `calibrate`.
    sensors : tuple of Sensor
        The camera of each model.
    variation : numpy.ndarray, float32, shape (y, x), optional
        Factor of the response at each of the device's pixels, from level 0 on; see `engine.Levels`.
    falling : bool
        Whether the phase of the light falls as the level rises, by as much as the responses rise. Set it for even
        steps and ranges; a measured curve that falls needs no mark.

    Raises
    ------
    InvalidInput
        If no device can have such a calibration, or its parts contradict each other.
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
            raise InvalidInput(f"Expected 1 to 16 bits, got {self.bits}.")
        if self.size is not None and not (1 <= min(self.size) and max(self.size) <= MAX_SIDE):
            raise InvalidInput(
                f"Expected a size from 1 to {MAX_SIDE} pixels a side, got {self.size[0]} x {self.size[1]}."
            )
        if max(map(abs, self.shift)) > MAX_SIDE:
            raise InvalidInput(
                f"Expected a shift of at most {MAX_SIDE} pixels, got {max(map(abs, self.shift))}."
            )
        for response in self.responses:
            shown = response.phases(self.bits)  # its curve spans the levels
            if self.falling and shown[-1] < shown[0]:
                raise InvalidInput(
                    f"The curve at {response.wavelength * 1e9:g} nm falls already. Omit falling."
                )
        if self.correction is not None:
            correction = np.asarray(self.correction)
            if correction.ndim != 2 or not correction.size or correction.dtype.kind not in "fiu":
                raise InvalidInput("Expected a correction of one phase per pixel, in radians.")
            if not np.abs(correction, dtype=float).max() <= MAX_CORRECTION:  # false for NaN, too
                raise InvalidInput(f"Expected a finite correction of at most {MAX_CORRECTION:.0f} radians.")
            correction = np.ascontiguousarray(correction, np.float32)
            self._check_size("correction", correction)
            if self.correction_wavelength is None:
                raise InvalidInput("The correction lacks its wavelength. Give that of the measurement.")
            _check_wavelength(self.correction_wavelength)
            object.__setattr__(self, "correction", correction)
        if self.variation is not None:
            object.__setattr__(self, "variation", check_variation(self.variation))
            self._check_size("variation", self.variation)
            if self.models:
                raise InvalidInput(
                    "A response that varies over the device cannot be combined with a fitted display. Omit the "
                    "variation or the displays."
                )

    def _check_size(self, name, values):
        if self.size is not None and values.shape != tuple(self.size)[::-1]:
            raise InvalidInput(
                f"Expected a {name} of the device's {self.size[0]} x {self.size[1]} pixels, got "
                f"{values.shape[1]} x {values.shape[0]}."
            )

    @property
    def plain(self) -> bool:
        """Whether nothing is mirrored, moved, corrected, varying or falling."""
        changes = self.flip_x or self.flip_y or any(self.shift) or self.falling
        return not changes and self.correction is None and self.variation is None

    def response(self, wavelength: float) -> Response:
        """The `Response` measured nearest to a wavelength in meters."""
        if not self.responses:
            return Response(wavelength)
        return min(self.responses, key=lambda r: abs(r.wavelength - wavelength))

    def phases(self, wavelength: float) -> np.ndarray:
        """Phase of each level at a wavelength in meters, radians, shape (level,)."""
        phases = self.response(wavelength).phases(self.bits, wavelength)
        return -phases if self.falling else phases

    def levels_of(self, hologram: Hologram) -> list[Levels]:
        """The device's levels under a hologram at each wavelength, for `engine.encode`.

        Raises
        ------
        InvalidInput
            If a map does not fit the device, or the hologram lies beside it.
        """
        shape = hologram.height, hologram.width
        device = shape if self.size is None else self.size[::-1]
        all_levels, variation = [], self._checked_variation(device)
        if variation is not None:
            variation = self._at_hologram(variation - 1, shape) + 1
        for wavelength in hologram.wavelengths:
            correction = self._scaled_correction(wavelength, device)
            if correction is not None:
                correction = self._at_hologram(correction, shape)
            phases = self.phases(wavelength)
            if self.models:
                phases = phases[self._levels_in_use(phases)]
            all_levels.append(Levels(phases, correction, variation))
        return all_levels

    def display(self, wavelengths: Sequence[float]) -> list[DisplayModel] | None:
        """FitResult models for `engine.encode`, one per wavelength in meters; None without any.

        Raises
        ------
        InvalidInput
            If there are models, but none of a wavelength.
        """
        return [self._fit_at(each)[0] for each in wavelengths] if self.models else None

    def sensor(self, wavelength: float) -> Sensor:
        """The camera of the model fitted at a wavelength in meters.

        Raises
        ------
        InvalidInput
            If there is none.
        """
        return self._fit_at(wavelength)[1]

    def _fit_at(self, wavelength):
        pairs = list(zip(self.models, self.sensors, strict=True))
        apart = [abs(model.wavelength - wavelength) for model, _ in pairs]
        if min(apart, default=FIT_TOLERANCE) < FIT_TOLERANCE:
            return pairs[apart.index(min(apart))]
        known = ", ".join(f"{model.wavelength * 1e9:g}" for model in self.models) or "none"
        raise InvalidInput(
            f"Expected a wavelength at which the display is calibrated ({known} nm), got {wavelength * 1e9:g} nm. Run "
            "`holopath calibrate` there."
        )

    def table(self, wavelength: float) -> np.ndarray:
        """Nearest level, on the circle, of each of `STEPS` phases of a turn.

        With a variation: a table for each of `FACTORS` factors between the smallest and the largest, shape (`FACTORS`,
        `COARSE_STEPS`). With a response of one turn and factors from 0.9 to 1.1 its phases are within 0.01 rad.

        Parameters
        ----------
        wavelength : float
            Meters.
        """
        phases = self.phases(wavelength)
        if self.variation is not None:
            factors = np.linspace(self.variation.min(), self.variation.max(), FACTORS)
            return np.stack(
                [self._table(phases[0] + factor * (phases - phases[0]), COARSE_STEPS) for factor in factors]
            )
        return self._table(phases, STEPS)

    def _levels_in_use(self, phases):
        """Mask of the levels in use: those of one turn where a model's crosstalk allows no more."""
        return one_turn(phases, 2 if self.models else MIN_LEVELS)

    def _table(self, phases, steps):
        levels = np.flatnonzero(self._levels_in_use(phases))
        phases = np.mod(phases[levels], 2 * math.pi)
        order = np.argsort(phases, kind="stable")
        ring, order = phases[order], levels[order]
        edges = np.append((ring[1:] + ring[:-1]) / 2, (ring[0] + 2 * math.pi + ring[-1]) / 2)
        targets = np.arange(steps) * (2 * math.pi / steps)
        targets = np.where(targets < edges[-1] - 2 * math.pi, targets + 2 * math.pi, targets)
        nearest = np.searchsorted(edges, targets, side="left") % len(ring)
        return order[nearest].astype(np.uint8 if self.bits <= 8 else np.uint16)

    def levels(self, phases: np.ndarray, wavelength: float, table: np.ndarray | None = None) -> np.ndarray:
        """Convert phases to levels of the device's pixels.

        Parameters
        ----------
        phases : numpy.ndarray, shape (y, x)
            Radians of a hologram that is no larger than the device.
        wavelength : float
            Meters.
        table : numpy.ndarray, optional
            Result of `table` at that wavelength, to save its computation.

        Returns
        -------
        numpy.ndarray, uint8 or uint16, shape (height, width)

        Raises
        ------
        InvalidInput
            If the hologram does not fit.
        """
        phases = np.asarray(phases, np.float32)[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1]
        phases = self._on_device(phases)
        correction = self._scaled_correction(wavelength, phases.shape)
        if correction is not None:
            phases = np.mod(phases + correction, np.float32(2 * math.pi))
        variation = self._checked_variation(phases.shape)
        if variation is None and not self.falling and self.response(wavelength).linear(wavelength):
            return gray_levels(phases, self.bits).astype(np.uint8 if self.bits <= 8 else np.uint16)
        table = self.table(wavelength) if table is None else table
        steps = table.shape[-1]
        step = np.round(phases * np.float32(steps / (2 * math.pi))).astype(np.uint32) & (steps - 1)
        if variation is None:
            return table[step]
        low, high = variation.min(), variation.max()
        return table[
            np.round((variation - low) * ((FACTORS - 1) / max(high - low, 1e-6))).astype(np.uint8), step
        ]

    def _checked_variation(self, shape):
        """The variation, whose shape must be the device's; None where all pixels are alike."""
        if self.variation is not None and self.variation.shape != shape:
            raise InvalidInput(
                f"The variation has {self.variation.shape[1]} x {self.variation.shape[0]} pixels, the hologram "
                f"{shape[1]} x {shape[0]}. Give the device's size in the calibration."
            )
        return self.variation

    def _scaled_correction(self, wavelength, shape):
        if self.correction is None or self.correction_wavelength is None:
            return None
        if self.correction.shape != shape:
            raise InvalidInput(
                f"The correction has {self.correction.shape[1]} x {self.correction.shape[0]} pixels, the hologram "
                f"{shape[1]} x {shape[0]}. Give the device's size in the calibration."
            )
        return np.float32(_scale(self.correction_wavelength, wavelength)) * self.correction

    def _on_device(self, phases):
        """Place a hologram's phases in the device's center, moved by the shift; phase 0 surrounds them."""
        height, width = phases.shape
        to_width, to_height = self.size or (width, height)
        if width > to_width or height > to_height:
            raise InvalidInput(
                f"The hologram has {width} x {height} pixels, the device only {to_width} x {to_height}. Render it "
                "for this device, or choose another."
            )
        if (to_width, to_height) == (width, height) and tuple(self.shift) == (0, 0):
            return phases
        on_device, on_hologram = self._windows(phases.shape, (to_height, to_width))
        whole = np.zeros((to_height, to_width), np.float32)
        whole[on_device] = phases[on_hologram]
        return whole

    def _windows(self, hologram, device):
        """Slices of the device and of the hologram, shapes (y, x), where they overlap."""
        on_device, on_hologram = [], []
        for size, whole, shift in zip(hologram, device, self.shift[::-1], strict=True):
            begin = (whole - size) // 2 + shift
            first, last = max(begin, 0), min(begin + size, whole)
            if first >= last:
                raise InvalidInput(
                    f"A shift of {self.shift[0]}, {self.shift[1]} pixels moves the hologram off the device. Give less."
                )
            on_device.append(slice(first, last))
            on_hologram.append(slice(first - begin, last - begin))
        return tuple(on_device), tuple(on_hologram)

    def shown_phases(
        self,
        levels: np.ndarray,
        wavelength: float,
        shape: tuple[int, int],
        crosstalk: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> np.ndarray:
        """Phases that the device shows for levels: the inverse of `levels`.

        Parameters
        ----------
        levels : numpy.ndarray, integers, shape (height, width)
            Levels of the device's pixels.
        wavelength : float
            Meters.
        shape : (int, int)
            Rows and columns of the hologram.
        crosstalk : callable, optional
            Crosstalk between pixels: maps the response's phases, radians, shape (height, width), possibly of more than
            a turn, to the panel's.

        Returns
        -------
        numpy.ndarray, float32, shape (y, x)
            Phases in [0, 2 pi) at the hologram's pixels; 0 where they lie beside the device.
        """
        response = self.phases(wavelength).astype(np.float32)
        phases = response[levels]
        variation = self._checked_variation(phases.shape)
        if variation is not None:
            phases = response[0] + variation * (phases - response[0])
        if crosstalk is not None:
            phases = crosstalk(phases)
        correction = self._scaled_correction(wavelength, phases.shape)
        if correction is not None:
            phases = phases - correction
        return self._at_hologram(np.mod(phases, np.float32(2 * math.pi)), shape)

    def _at_hologram(self, values, shape):
        """Values of the device's pixels under a hologram of a shape; 0 where it extends beyond the device."""
        on_device, on_hologram = self._windows(shape, values.shape)
        result = np.zeros(shape, np.float32)
        result[on_hologram] = values[on_device]
        return result[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1]

    def save(self, path: Path | str) -> None:
        """Write a JSON file, and ``.npy`` files of the correction and the variation beside it.

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
        data = {
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
        part.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
        os.replace(part, path)

    @classmethod
    def load(cls, path: Path | str) -> Calibration:
        """Read a file of `save`, or one written by hand: every key but ``format`` is optional.

        The correction may also be a picture of 8 bits, 256 levels a turn, as makers of SLMs supply it. It is unwrapped,
        so neighboring pixels must differ by less than half a turn.

        Parameters
        ----------
        path : path

        Raises
        ------
        InvalidInput
            If the file cannot be read, or no device can have such a calibration.
        """
        path = Path(path)
        with _calibration(path) as data:
            correction = at = variation = None
            if data.get("correction"):
                at = float(data["correction"]["wavelength_nm"]) * 1e-9
                correction = _read_map(_map_file(path, data, "correction"))
            if data.get("variation"):
                variation = np.load(_map_file(path, data, "variation"), allow_pickle=False)
            size = data.get("size")
            calibration = cls(
                str(data.get("device", "")),
                _whole(data.get("bits", 8)),
                _pair(size) if size else None,
                _boolean(data.get("flip_x", False)),
                _boolean(data.get("flip_y", False)),
                _pair(data.get("shift", (0, 0))),
                tuple(
                    Response(
                        float(r["wavelength_nm"]) * 1e-9,
                        float(r.get("range", 1.0)),
                        tuple(enumerate(read_response(path.with_name(str(r["file"])))))
                        if r.get("file")
                        else r.get("curve"),
                    )
                    for r in data.get("responses", ())
                ),
                correction,
                at,
                tuple(DisplayModel.from_dict(each) for each in data.get("displays", ())),
                tuple(Sensor.from_dict(each["camera"]) for each in data.get("displays", ())),
                variation,
                _boolean(data.get("falling", False)),
            )
        return calibration


@contextmanager
def _calibration(path: Path) -> Iterator[dict]:
    """The JSON object of a calibration file; errors raised in the block name the file."""
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig"))  # editors on Windows begin with a mark
        if not isinstance(data, dict):
            raise ValueError("expected a JSON object")
        if data["format"] != FORMAT or data.get("format_version", 1) != FORMAT_VERSION:
            raise ValueError("another format, or a newer version")
        _check_keys(data)
        yield data
    except InvalidInput as error:
        raise InvalidInput(f"The calibration {path}: {error}") from None
    except Exception as error:  # a file may hold anything
        reason = f"it lacks {error}" if isinstance(error, KeyError) else _reason(error)
        if isinstance(error, json.JSONDecodeError) and path.suffix.lower() != ".json":
            reason = "it is not JSON; a table of levels goes into a calibration by its name, as a response's `file`"
        raise InvalidInput(
            f"The calibration {path} cannot be read ({reason}). See docs/slm.md for its format."
        ) from None


def _check_keys(entries, place="the file"):
    """Refuse keys that nothing reads, as misspelled ones would be ignored."""
    for key, value in entries.items():
        if key not in KEYS[place]:
            near = next(iter(difflib.get_close_matches(key, KEYS[place], 1)), None)
            remedy = f"Write {near}, or remove it" if near else "Remove it"
            known = ", ".join(KEYS[place])
            raise InvalidInput(f"Expected keys of {place} ({known}), got {key[:40]!r}. {remedy}.")
        for each in value if isinstance(value, list) else [value]:
            if key in KEYS and isinstance(each, dict):
                _check_keys(each, key)


def measured_levels(path: Path | str, hologram: Hologram) -> list[Levels]:
    """Read the levels of a device, for `engine.encode`.

    Parameters
    ----------
    path : path
        A `Calibration` in a .json file, or a text file for `read_response`, whose phases hold at every wavelength.
    hologram : engine.Hologram

    Returns
    -------
    list of engine.Levels
        One per wavelength.

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
    """All files that `measured_levels` reads for a path, by their role.

    Raises
    ------
    InvalidInput
    """
    files = {"response": Path(path)}
    if _calibrates(files["response"]):
        with _calibration(files["response"]) as data:
            for name in ("correction", "variation"):
                if data.get(name):
                    files[name] = _map_file(files["response"], data, name)
            for number, response in enumerate(data.get("responses", ())):
                if response.get("file"):
                    files[f"table {number}"] = files["response"].with_name(str(response["file"]))
    return files


def _calibrates(path):
    return path.suffix.lower() == ".json"


def _map_file(path, data, name):
    return path.with_name(str(data[name]["file"]))


def _write_map(path, name, values):
    """Write a map beside a file, and return its name."""
    file_name = f"{path.stem}.{name}.npy"
    part = path.with_name(f".part-{file_name}")
    with open(part, "wb") as file:
        np.save(file, values)
    os.replace(part, path.with_name(file_name))
    return file_name


def fitted_display(path: Path | str, wavelengths: Sequence[float]) -> list[DisplayModel] | None:
    """Read the fitted display models of a `Calibration` file at wavelengths in meters; None without any.

    Raises
    ------
    InvalidInput
    """
    if Path(path).suffix.lower() != ".json":
        return None
    return Calibration.load(path).display(wavelengths)


def colors_of(path: Path | str, hologram: Hologram) -> dict[str, Any]:
    """Scale, distance and shift of each color in a calibration, as arguments of `engine.Optics`.

    The scale and the shift come from the homographies at the focus nearest to the SLM, relative to the color in the
    middle of the spectrum: a camera's magnification is not known by itself. The distance comes from the fitted
    defocus. With Noll's fourth polynomial, sqrt(3) (2 rho^2 - 1), and rho = 1 at a sine of wavelength / (2 pitch),
    a defocus a moves the picture by 8 sqrt(3) a pitch^2 / (pi wavelength) towards the viewer.

    Parameters
    ----------
    path : path
        A `Calibration`.
    hologram : engine.Hologram

    Returns
    -------
    dict
        `color_scale`, and `color_distance` and `color_shift` in meters.

    Raises
    ------
    InvalidInput
        If a wavelength was not calibrated, or the colors share no focus.
    """
    calibration, wavelengths = Calibration.load(path), hologram.wavelengths
    models, sensors = zip(*(calibration._fit_at(each) for each in wavelengths), strict=True)
    foci = set.intersection(*(set(sensor.homographies) for sensor in sensors))
    if not foci:
        raise InvalidInput(
            f"The colors of the calibration {path} share no focus. Calibrate each color at the same foci."
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


def _boolean(value):
    if not isinstance(value, bool):
        raise ValueError(f"expected true or false, got {value!r}")
    return value


def _pair(values):
    first, second = values
    return _whole(first), _whole(second)


def _whole(value):
    if isinstance(value, bool) or value != int(value) or abs(value) > MAX_SIDE:
        raise ValueError(f"expected a whole number up to {MAX_SIDE}, got {value!r}")
    return int(value)


def _reason(error):
    """An error's text in one line."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def _read_map(path):
    """Read phases in radians from an array or a picture."""
    if path.suffix.lower() == ".npy":
        phases = np.load(path, allow_pickle=False)
        if phases.dtype.kind != "f":
            raise ValueError(f"{path.name} has whole numbers instead of radians; write levels as a picture")
        return phases
    levels = np.array(variants.read_bitmap(path), copy=False)
    if levels.dtype != np.uint8:
        raise ValueError(f"{path.name} is not a picture of 8 bits")
    if path.suffix.lower() == ".bmp":
        check_palette(path, levels)
    if levels.ndim == 3:
        colors = levels[..., : levels.shape[-1] - (levels.shape[-1] in (2, 4))]  # without alpha
        if (colors != colors[..., :1]).any():
            raise ValueError(f"{path.name} has colors instead of gray levels")
        levels = colors[..., 0]
    # a correction of more than a turn is wrapped, and a turn at another wavelength is another length
    turns = np.unwrap(np.unwrap(levels / 256.0, axis=0, period=1.0), axis=1, period=1.0)
    return (2 * math.pi * turns).astype(np.float32)
