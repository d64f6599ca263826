"""From complex fields to the phases that an SLM shows."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.fft

from .camera import Camera
from .errors import InvalidInput
from .folders import earlier, whole_folder
from .hologram import Hologram
from .wavefield import WaveField

METHODS = ("dpac",)
FORMAT_VERSION = 1


@dataclass(frozen=True)
class PhaseHologram:
    """Phases at the SLM plane.

    Attributes
    ----------
    data : numpy.ndarray, float32, shape (frame, wavelength, y, x)
        Radians in [0, 2 pi); row 0 is the top.
    hologram : Hologram
    camera : Camera
    near : float
        World depth in metres at the volume's near end.
    method : str
        One of `METHODS`.
    gains : tuple of float
        Amplitude of the light to send in, one a wavelength: with it what is seen is as bright as the scene. 0
        where there is none of that colour.
    """

    data: np.ndarray
    hologram: Hologram
    camera: Camera
    near: float
    method: str
    gains: tuple

    def field(self):
        """`WaveField` of the light that leaves the SLM, to be refocused."""
        gains = np.asarray(self.gains, np.float32)[:, None, None]
        return WaveField(gains * np.exp(1j * self.data), self.hologram, self.camera, self.near)

    def save(self, folder, progress=None):
        """Write ``phase.npy``, a picture of 8 bits for each frame and wavelength, and ``meta.json``.

        The folder appears only when complete. A grey level of n is a phase of 2 pi n / 256.

        Parameters
        ----------
        folder : path
            Replaced if it holds an earlier hologram.
        progress : callable, optional
            ``progress(done, message)``, may raise `Cancelled`.

        Raises
        ------
        InvalidInput
            If the folder exists and is not a hologram's.
        OSError
            If it cannot be written; nothing is left behind.
        """
        import mitsuba as mi

        progress = progress or (lambda done, message: None)
        wavelengths = self.hologram.wavelengths
        with whole_folder(folder, earlier("a hologram", "phase.npy", "meta.json")) as part:
            np.save(part / "phase.npy", self.data)
            for m, frame in enumerate(self.data):
                for phases, name in zip(frame, picture_names(m, wavelengths), strict=True):
                    mi.Bitmap(grey_levels(phases).astype(np.uint8)).write(str(part / name))
                progress((m + 1) / len(self.data), "Writing the hologram")
            meta = {
                "format_version": FORMAT_VERSION,
                "axes": ["frame", "wavelength", "y", "x"],
                "units": "radians; grey level n of the pictures is 2 pi n / 256",
                "method": self.method,
                "gains": list(self.gains),
                "near_m": self.near,
                "hologram": self.hologram.to_dict(),
                "camera": self.camera.to_dict(),
            }
            (part / "meta.json").write_text(json.dumps(meta, indent=1))

    @classmethod
    def load(cls, folder):
        """Read what `save` wrote; the phases are memory-mapped.

        Raises
        ------
        InvalidInput
            If the folder holds no readable hologram.
        """
        folder = Path(folder)
        try:
            meta = json.loads((folder / "meta.json").read_text())
            if meta["format_version"] != FORMAT_VERSION:
                raise ValueError(f"format version {meta['format_version']}")
            data = np.load(folder / "phase.npy", mmap_mode="r", allow_pickle=False)
            hologram, camera = Hologram.from_dict(meta["hologram"]), Camera.from_dict(meta["camera"])
            if data.shape[1:] != (len(hologram.wavelengths), hologram.height, hologram.width):
                raise ValueError("phase.npy does not fit meta.json")
            gains = tuple(map(float, meta["gains"]))
            return cls(data, hologram, camera, float(meta["near_m"]), meta["method"], gains)
        except FileNotFoundError as error:
            raise InvalidInput(
                f"{folder} holds no hologram ({Path(error.filename).name} is missing): encode one first."
            ) from None
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise InvalidInput(f"{folder} holds a damaged hologram ({error}): encode it again.") from None


def picture_names(frame, wavelengths):
    """File names of a frame's pictures, one a wavelength: ``frame_000_640nm.png``.

    Wavelengths that are equal in whole nanometres are told apart by decimals.
    """
    digits = 0
    while len({f"{w * 1e9:.{digits}f}" for w in wavelengths}) < len(set(wavelengths)):
        digits += 1
    return [f"frame_{frame:03d}_{w * 1e9:.{digits}f}nm.png" for w in wavelengths]


def encode(field, method="dpac", progress=None):
    """Phases whose light, within the SLM's recordable cone, is that of a complex field.

    Parameters
    ----------
    field : WaveField
    method : str
        One of `METHODS`. ``dpac``: double phase (Hsueh and Sawchuk, Appl. Opt. 17, 3874 (1978)): neighbouring
        pixels of a checkerboard show arg U + acos(|U| / g) and arg U - acos(|U| / g), whose mean is U / g.
    progress : callable, optional
        ``progress(done, message)``, may raise `Cancelled`.

    Returns
    -------
    PhaseHologram

    Raises
    ------
    InvalidInput
        If there is no such method, or the field is not finite.
    """
    if method not in METHODS:
        raise InvalidInput(f"There is no encoding '{method}': choose one of {', '.join(METHODS)}.")
    progress = progress or (lambda done, message: None)
    frames, colours, *shape = field.data.shape
    keep = half_band(shape)
    phases, gains = np.empty(field.data.shape, np.float32), []
    for k in range(colours):
        # The gain is one for all frames: their mean intensity counts.
        waves = np.empty((frames, *shape), np.complex64)
        for m in range(frames):
            if not np.isfinite(field.data[m, k]).all():
                raise InvalidInput("The wave field holds values that are not finite: render it again.")
            waves[m] = scipy.fft.ifft2(scipy.fft.fft2(field.data[m, k], workers=-1) * keep, workers=-1)
            progress((k + 0.7 * (m + 1) / frames) / colours, "Encoding")
        gain = float(np.abs(waves).max())
        gains.append(gain)
        for m, wave in enumerate(waves):
            phases[m, k] = double_phase(wave / (gain or 1))
            progress((k + 0.7 + 0.3 * (m + 1) / frames) / colours, "Encoding")
    return PhaseHologram(phases, field.hologram, field.camera, field.near, method, tuple(gains))


def grey_levels(phases, bits=8):
    """Phases in radians as an SLM takes them: whole numbers in [0, 2^bits), of which a full turn is 0 again."""
    return np.round(phases * (2**bits / (2 * math.pi))).astype(np.uint32) % 2**bits


def half_band(shape):
    """FFT bins that a checkerboard's pixels of one colour sample without aliases: abs(fx) + abs(fy) <= 1 / (2 pitch).

    Double phase shows every second pixel's value twice; what is beyond becomes noise (Maimone et al., ACM TOG
    36(4), 85 (2017)).
    """
    fy, fx = (np.abs(scipy.fft.fftfreq(n)) for n in shape)
    return fx[None, :] + fy[:, None] <= 0.5


def double_phase(wave):
    """Phases, float32 in [0, 2 pi), of complex amplitudes of magnitude 1 at most, shape (y, x)."""
    spread = np.arccos(np.minimum(np.abs(wave), 1))
    rows, columns = np.indices(wave.shape, sparse=True)
    spread[(rows + columns) % 2 == 1] *= -1
    turn = np.float32(2 * math.pi)
    phase = np.mod(np.angle(wave) + spread, turn).astype(np.float32)
    return np.where(phase < turn, phase, 0)  # the largest float below a turn is rounded to it
