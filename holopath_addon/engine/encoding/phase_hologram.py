"""Phase holograms, and their form on disk."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..camera import Camera
from ..errors import InvalidInput
from ..files import overwrite_check, whole_folder
from ..hologram import Hologram
from ..optics import BEAM_FILE, STOP_FILE
from ..scene import variants
from ..wavefield import WaveField
from ..waves import arrays
from ..waves.modulator import Modulator, gray_levels, wrapped
from .shown_light import ShownLight

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..progress import Progress
    from ..waves.display_model import DisplayModel
    from ..waves.modulator import Levels

FORMAT_VERSION = 1


@dataclass(frozen=True)
class PhaseHologram:
    """Phases at the SLM plane.

    Attributes
    ----------
    data : array, float32, shape (frame, wavelength, y, x)
        Radians in [0, 2 pi), in the library of the encoded field; row 0 is the top.
    hologram : Hologram
    camera : Camera
    near : float
        World depth in meters at the volume's near end.
    method : str
        Method of `encode`.
    gains : tuple of float
        Amplitude of the light to send in at each wavelength, with which the image is as bright as the scene; 0 for a
        wavelength without light.
    report : dict
        Steps, seconds and PSNR of each stage of the encoding.
    """

    data: np.ndarray = field(repr=False)
    hologram: Hologram
    camera: Camera
    near: float
    method: str
    gains: tuple
    report: dict = field(default_factory=dict, repr=False)

    def field(
        self,
        modulator: Modulator | None = None,
        display: Sequence[DisplayModel] | None = None,
        levels: Sequence[Levels] | None = None,
    ) -> WaveField:
        """Compute the `WaveField` that leaves the SLM under the beam of its optics, for refocusing through their stop.

        Parameters
        ----------
        modulator : Modulator, optional
            Limits of the display. Default: none.
        display : sequence of DisplayModel, optional
            Model of the display at each wavelength instead, for the center of its source.
        levels : sequence of Levels, optional
            Levels of the display at each wavelength, see `encode`; the nearest are shown. Default: any phase, or the
            even steps of `Modulator.bits`.

        Raises
        ------
        InvalidInput
            If a map of the levels does not fit, the number of levels is not that of wavelengths, or levels are given
            with bits or a display, or a display with optics of the hologram.
        """
        if levels is not None and (
            display is not None or (modulator is not None and modulator.bits is not None)
        ):
            raise InvalidInput("Measured levels exclude bits and a display model. Omit one of them.")
        if display is not None and not self.hologram.flat_bench:
            raise InvalidInput(
                "A fitted display has a beam and a stop of its own, and no lens behind it. Omit the display model or "
                "the hologram's optics."
            )
        if levels is not None and len(levels) != self.data.shape[1]:
            raise InvalidInput(
                f"Expected one set of levels for each of the wavelengths, {self.data.shape[1]}, got {len(levels)}."
            )
        for each in levels or ():
            for name in ("correction", "variation"):
                values = getattr(each, name, None)
                if values is not None and values.shape != tuple(self.data.shape[-2:]):
                    raise InvalidInput(
                        f"The {name} of the levels has the shape {values.shape}, the phases {self.data.shape[-2:]}. "
                        "Give one of their shape."
                    )
        gains = arrays.like(np.asarray(self.gains, np.float32)[:, None, None], self.data)
        if display is None:
            light = (modulator or Modulator()).light(self._nearest(levels))
            for color in range(self.data.shape[1]):
                illumination = self.hologram.illumination(color)
                if illumination is not None:
                    light[:, color, ...] *= arrays.like(illumination, light)
        else:
            light = arrays.empty(self.data.shape, "complex64", self.data)
            for color, model in enumerate(display):
                shown = ShownLight(model, self.data.shape[-2:], self.hologram.pitch, on=self.data)
                for frame in range(self.data.shape[0]):
                    light[frame, color, ...] = shown.light(self.data[frame, color, ...])
        return WaveField(gains * light, self.hologram, self.camera, self.near, modulated=True)

    def _nearest(self, levels):
        if levels is None:
            return self.data
        phases = arrays.empty(self.data.shape, "float32", self.data)
        for color, each in enumerate(levels):
            for frame in range(self.data.shape[0]):
                phases[frame, color, ...] = wrapped(each.nearest(self.data[frame, color, ...])[0])
        return phases

    @property
    def digest(self) -> str:
        """SHA-256 of the phases, hexadecimal."""
        return hashlib.sha256(np.ascontiguousarray(arrays.on_processor(self.data)).data).hexdigest()

    def save(self, folder: Path | str, progress: Progress | None = None) -> None:
        """Write ``phase.npy``, an image of 8 bits for each frame and wavelength, and ``meta.json``.

        The folder appears only when complete. A gray level of n is a phase of 2 pi n / 256.

        Parameters
        ----------
        folder : path
            Replaced if it has an earlier hologram.
        progress : callable, optional
            ``progress(done, message)``, may raise `Cancelled`.

        Raises
        ------
        InvalidInput
            If the folder exists and has something other than a hologram.
        OSError
            If it cannot be written; nothing is left behind.
        """
        progress = progress or (lambda done, message: None)
        wavelengths = self.hologram.wavelengths
        with whole_folder(
            folder,
            overwrite_check(
                "a hologram", "phase.npy", "meta.json", others=("frame_*.png", BEAM_FILE, STOP_FILE)
            ),
        ) as part:
            data = arrays.on_processor(self.data)
            np.save(part / "phase.npy", data)
            self.hologram.optics.save(part)
            for m, frame in enumerate(data):
                for phases, name in zip(frame, picture_names(m, wavelengths), strict=True):
                    variants.write_png(part / name, gray_levels(phases).astype(np.uint8))
                progress((m + 1) / len(data), "Writing the hologram")
            meta = {
                "format_version": FORMAT_VERSION,
                "axes": ["frame", "wavelength", "y", "x"],
                "units": "radians; gray level n of the pictures is 2 pi n / 256",
                "method": self.method,
                "gains": list(self.gains),
                "near_m": self.near,
                "hologram": self.hologram.to_dict(),
                "camera": self.camera.to_dict(),
                "report": self.report,
            }
            (part / "meta.json").write_text(json.dumps(meta, indent=1))

    @classmethod
    def load(cls, folder: Path | str) -> PhaseHologram:
        """Load a hologram from the folder of `save`; the phases are memory-mapped.

        Raises
        ------
        InvalidInput
            If the folder has no readable hologram.
        """
        folder = Path(folder)
        try:
            meta = json.loads((folder / "meta.json").read_text())
            if meta["format_version"] != FORMAT_VERSION:
                raise ValueError(f"format version {meta['format_version']}")
            data = np.load(folder / "phase.npy", mmap_mode="r", allow_pickle=False)
            hologram = Hologram.from_dict(meta["hologram"], folder)
            camera = Camera.from_dict(meta["camera"])
            if data.shape[1:] != (len(hologram.wavelengths), hologram.height, hologram.width):
                raise ValueError("phase.npy does not fit meta.json")
            gains = tuple(map(float, meta["gains"]))
            near, report = float(meta["near_m"]), meta.get("report", {})
            return cls(data, hologram, camera, near, meta["method"], gains, report)
        except FileNotFoundError as error:
            raise InvalidInput(
                f"{folder} holds no hologram ({Path(error.filename).name} is missing): encode one first."
            ) from None
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise InvalidInput(f"{folder} holds a damaged hologram ({error}): encode it again.") from None


def picture_names(frame: int, wavelengths: Sequence[float]) -> list[str]:
    """File names of a frame's images, one for each wavelength: ``frame_000_640nm.png``, see `color_names`."""
    return [f"frame_{frame:03d}_{name}.png" for name in color_names(wavelengths)]


def color_names(wavelengths: Sequence[float]) -> list[str]:
    """Names of wavelengths for files: ``640nm``.

    Decimals distinguish wavelengths that are equal in whole nanometers, and numbers equal ones.
    """
    digits = 0
    while len({f"{w * 1e9:.{digits}f}" for w in wavelengths}) < len(set(wavelengths)):
        digits += 1
    names = [f"{w * 1e9:.{digits}f}nm" for w in wavelengths]
    return [f"{name}{f'_{k}' if names.count(name) > 1 else ''}" for k, name in enumerate(names)]
