"""Driver that writes pictures as files, for devices with a player of their own."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...engine.errors import InvalidInput
from ...engine.files import overwrite_check, whole_folder
from ...engine.scene import variants
from ..driver import SHOWN, Info
from .video import Videos

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..driver import Picture
    from ..sequence import Sequence

VIDEO, VIDEOS = "video", "video-per-color"
KINDS = ("png", "raw", VIDEO, VIDEOS)
OTHERS = ("picture_*.png", "pictures.raw", "pictures*.mkv")


class FilesDriver:
    """A driver that writes a folder: ``picture_000000.png`` and so on, or one file or more; and ``pictures.json``.

    The folder appears when all pictures are written. Raw files have rows from the top, and one byte per pixel: two for
    more than 8 bits (low byte first), three (red, green, blue) for packings of several holograms. For videos see
    `video.Videos`.

    Parameters
    ----------
    folder : path
        An earlier sequence of pictures there is replaced.
    kind : str
        One of `KINDS`.
    sequence : Sequence, optional
        The sequence of the pictures; required for videos, which need its colors and times.

    Raises
    ------
    InvalidInput
    BackendUnavailable
        On opening, if there is no program that writes videos.
    """

    def __init__(self, folder: Path | str, kind: str = "png", sequence: Sequence | None = None) -> None:
        if kind not in KINDS:
            raise InvalidInput(f"Expected a kind of file among {', '.join(KINDS)}, got {kind}.")
        if kind in (VIDEO, VIDEOS) and sequence is None:
            raise InvalidInput("Videos have the colors and times of a sequence. Give the sequence.")
        self._sequence = sequence
        self._videos: Videos | None = None
        self._folder, self._kind = Path(folder), kind
        self._whole = None
        self.info = Info("files", bits=0, channels=3, note=f"{kind} in {folder}")

    def open(self, rate: float | None, on_picture: Callable[[int, str], None]) -> None:
        """Create the folder; see `Driver`. Files are written without delay: ``pictures.json`` has their rate."""
        if self._sequence is not None and self._kind in (VIDEO, VIDEOS):
            self._videos = Videos(self._sequence, rate, self._kind == VIDEOS)
        self._on_picture, self.info = on_picture, replace(self.info, rate=rate or math.inf)
        self._rate, self._parts, self._shape, self._raw = rate, [], None, None
        self._whole = whole_folder(
            self._folder,
            overwrite_check("a sequence of pictures", "pictures.json", others=OTHERS),
        )
        self._part = self._whole.__enter__()

    def show(self, number: int, picture: Picture) -> None:
        """Write a picture; see `Driver`."""
        pixels = picture.pixels
        self._shape = pixels.shape, pixels.dtype
        if self._kind == "png":
            variants.write_png(self._part / f"picture_{number:06d}.png", pixels)
        elif self._videos is not None:
            self._videos.add(picture, self._part)
        else:
            if self._raw is None:
                self._raw = open(self._part / "pictures.raw", "wb")
            self._raw.write(pixels.astype(pixels.dtype.newbyteorder("<")).tobytes())
        self._parts.append(picture.parts)
        self._on_picture(number, SHOWN)

    def close(self, finish: bool = False) -> None:
        """Move the finished folder into place, or delete an unfinished one; see `Driver`."""
        whole, self._whole = self._whole, None
        if whole is None:
            return
        if self._raw is not None:
            self._raw.close()
        if not finish or self._shape is None:
            if self._videos is not None:
                self._videos.close(False)
            whole.__exit__(InterruptedError, InterruptedError(), None)
            return
        try:
            if self._videos is not None:
                self._videos.close(True)
            self._describe(*self._shape)
        except BaseException as error:
            whole.__exit__(type(error), error, error.__traceback__)
            raise
        whole.__exit__(None, None, None)

    def _describe(self, shape, dtype):
        """Write ``pictures.json``."""
        height, width, *channels = shape
        description = {
            "format": "HoloPath pictures",
            "pictures": len(self._parts),
            "width": width,
            "height": height,
            "channels": channels[0] if channels else 1,
            "bytes_per_level": np.dtype(dtype).itemsize,
            "rate_hz": self._rate,
            "parts": [[list(part) for part in parts] for parts in self._parts],
            **({"videos": self._videos.timing(len(self._parts))} if self._videos is not None else {}),
        }
        (self._part / "pictures.json").write_text(json.dumps(description) + "\n", encoding="utf-8")
