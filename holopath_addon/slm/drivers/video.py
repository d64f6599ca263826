"""Lossless video files of pictures, written by the program ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from contextlib import ExitStack, suppress
from fractions import Fraction
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from ...engine.encoding.phase_hologram import color_names
from ...engine.errors import BackendUnavailable, InvalidInput

if TYPE_CHECKING:
    from pathlib import Path

    from ..driver import Picture
    from ..sequence import Sequence

MAX_DENOMINATOR = 1001  # of a rate, such as 60000 / 1001 Hz
# Ut Video is lossless and keeps red, green and blue unchanged; some players assume a narrower range of levels for gray
# or YUV. Files of phases are as large as FFV1's, and take a fifth of the time to decode (docs/slm.md).
CODEC = "-c:v", "utvideo", "-pix_fmt", "gbrp"


def ffmpeg() -> str:
    """Path of the program ffmpeg: the system's, else that of the package imageio-ffmpeg.

    Raises
    ------
    BackendUnavailable
        If there is neither.
    """
    path = shutil.which("ffmpeg")
    if path is None:
        try:
            path = import_module("imageio_ffmpeg").get_ffmpeg_exe()
        except (ImportError, RuntimeError) as error:
            raise BackendUnavailable(
                "A video needs the program ffmpeg. Install it, or run `pip install imageio-ffmpeg`, or choose --kind "
                "png."
            ) from error
    return path


class Videos:
    """Videos of a sequence: ``pictures.mkv``, or one per color, such as ``pictures_640nm.mkv``.

    They are lossless, with 8 bits in red, green and blue.

    Parameters
    ----------
    sequence : Sequence
    rate : float or None
        Pictures per second of each video.
    per_color : bool
        Whether each color has its own video.

    Raises
    ------
    InvalidInput
        Without a rate.
    BackendUnavailable
        See `ffmpeg`.
    """

    def __init__(self, sequence: Sequence, rate: float | None, per_color: bool) -> None:
        if rate is None:
            raise InvalidInput("A video needs a rate. Give --rate, the pictures a second that the SLM shows.")
        self._program = ffmpeg()
        self._sequence, self._rate, self._per_color = sequence, rate, per_color
        self._videos: dict[str, tuple[_Video, int | None]] = {}  # by name, with the index of the wavelength

    def add(self, picture: Picture, folder: Path) -> None:
        """Write a picture to its video.

        Parameters
        ----------
        picture : Picture
        folder : pathlib.Path
            Folder of the videos.

        Raises
        ------
        InvalidInput
            If the picture has more than 8 bits, or several colors where each has its own video.
        OSError
        """
        name, color = "pictures.mkv", None
        if self._per_color:
            colors = {color for _, color in picture.parts}
            if len(colors) > 1:
                raise InvalidInput(
                    f"A picture of the packing {self._sequence.packing} holds several colors. Choose --kind video, or "
                    "the packing time."
                )
            (color,) = colors
            name = f"pictures_{color_names(self._wavelengths)[color]}.mkv"
        if picture.pixels.dtype != np.uint8:
            raise InvalidInput(
                f"A video has levels of 8 bits, got {picture.bits}. Choose --kind png or raw, or the packing that "
                "spreads them over red, green and blue."
            )
        if name not in self._videos:
            height, width = picture.pixels.shape[:2]
            self._videos[name] = _Video(self._program, folder / name, width, height, self._rate), color
        self._videos[name][0].add(picture.pixels)

    def close(self, finish: bool) -> None:
        """Complete the files if `finish`, or abandon them.

        Raises
        ------
        OSError
            If one cannot be completed.
        """
        with ExitStack() as stack:
            for video, _ in self._videos.values():
                stack.callback(video.close)
            for video, _ in self._videos.values() if finish else ():
                video.finish()

    def timing(self, pictures: int) -> dict[str, dict]:
        """Color, number of pictures and duration of a hologram in each video, of `pictures` in total."""
        holograms = pictures / self._sequence.pictures_each
        return {
            name: {
                "wavelength_nm": None if color is None else round(1e9 * self._wavelengths[color], 6),
                "pictures": video.pictures,
                "pictures_of_a_hologram": round(video.pictures / holograms),
                "seconds_of_a_hologram": video.pictures / holograms / self._rate,
            }
            for name, (video, color) in self._videos.items()
        }

    @property
    def _wavelengths(self):
        return self._sequence.holograms[0].hologram.wavelengths


class _Video:
    """A video in writing, of pictures of 8 bits, gray or RGB."""

    def __init__(self, program, file, width, height, rate):
        self.pictures = 0
        self._errors = tempfile.TemporaryFile()
        self._process = subprocess.Popen(
            [
                *(program, "-nostdin", "-loglevel", "error", "-y"),
                *("-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", f"{width}x{height}"),
                *("-framerate", str(Fraction(rate).limit_denominator(MAX_DENOMINATOR)), "-i", "pipe:0"),
                *(*CODEC, str(file)),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
        )

    def add(self, pixels):
        rgb = pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=-1)
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(np.ascontiguousarray(rgb).data)
        except OSError:  # ffmpeg has ended; `finish` raises its reason
            self.finish()
            raise
        self.pictures += 1

    def finish(self):
        self._process.communicate()
        if self._process.returncode:
            self._errors.seek(0)
            lines = self._errors.read().decode(errors="replace").strip().splitlines()
            raise OSError(f"ffmpeg: {lines[-1] if lines else 'no reason given'}")

    def close(self):
        self._process.kill()
        self._process.wait()
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        self._errors.close()
