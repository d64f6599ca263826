"""Lossless video files, written by the program ffmpeg."""

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
# Ut Video is lossless. It holds red, green and blue as they are: gray or YUV some players take for a narrower range of
# levels. Of phases its files are as large as FFV1's, and a fifth of the work to decode (docs/slm.md).
CODEC = "-c:v", "utvideo", "-pix_fmt", "gbrp"


def ffmpeg() -> str:
    """Path of the program ffmpeg: the system's, else that of the package imageio-ffmpeg.

    Raises
    ------
    BackendUnavailable
        If there is neither.
    """
    found = shutil.which("ffmpeg")
    if found is None:
        try:
            found = import_module("imageio_ffmpeg").get_ffmpeg_exe()
        except (ImportError, RuntimeError) as error:
            raise BackendUnavailable(
                "A video needs the program ffmpeg: install it, or `pip install holopath[video]`, or choose --kind png."
            ) from error
    return found


class Videos:
    """All pictures of a sequence in ``pictures.mkv``, or those of each color in one, ``pictures_640nm.mkv``.

    Lossless, of 8 bits in red, green and blue.

    Parameters
    ----------
    sequence : Sequence
    rate : float or None
        Pictures a second, of each video.
    per_color : bool

    Raises
    ------
    InvalidInput
        Without a rate.
    BackendUnavailable
        See `ffmpeg`.
    """

    def __init__(self, sequence: Sequence, rate: float | None, per_color: bool) -> None:
        if rate is None:
            raise InvalidInput("A video has a rate: give --rate, the pictures a second that the SLM shows.")
        self._program = ffmpeg()
        self._sequence, self._rate, self._per_color = sequence, rate, per_color
        self._videos: dict[str, tuple[_Video, int | None]] = {}  # by name, and of which wavelength

    def add(self, picture: Picture, folder: Path) -> None:
        """Write a picture into its video.

        Raises
        ------
        InvalidInput
            If it has more than 8 bits, or several colors where each has a video.
        OSError
        """
        name, color = "pictures.mkv", None
        if self._per_color:
            colors = {color for _, color in picture.parts}
            if len(colors) > 1:
                raise InvalidInput(
                    f"A picture of the packing {self._sequence.packing} holds several colors: choose --kind video, or "
                    "the packing time."
                )
            (color,) = colors
            name = f"pictures_{color_names(self._wavelengths)[color]}.mkv"
        if picture.pixels.dtype != np.uint8:
            raise InvalidInput(
                f"A video has levels of 8 bits, these have {picture.bits}: choose --kind png or raw, or the packing "
                "that spreads them over red, green and blue."
            )
        if name not in self._videos:
            height, width = picture.pixels.shape[:2]
            self._videos[name] = _Video(self._program, folder / name, width, height, self._rate), color
        self._videos[name][0].add(picture.pixels)

    def close(self, finish: bool) -> None:
        """End the files, or leave them as they are.

        Raises
        ------
        OSError
            If one cannot be ended.
        """
        with ExitStack() as stack:
            for video, _ in self._videos.values():
                stack.callback(video.close)
            for video, _ in self._videos.values() if finish else ():
                video.finish()

    def timing(self, pictures: int) -> dict[str, dict]:
        """Of each video its color, its pictures and how long a hologram lasts; so many pictures are in all."""
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
    """A video that is being written; pictures are levels of 8 bits, or red, green and blue of each."""

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
        except OSError:  # it has ended, and says why
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
