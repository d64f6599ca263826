"""Pictures of the window: a real Blender on an X server with two monitors, brought into a state by `in_window`."""

import json
import os
import shlex
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import mss
from PIL import Image, ImageChops

from tests.monitors import NoMonitors, monitors
from tests.real_blender import Blender, install

from .pictures import FILM, FILMED, IMAGES, LABELS, SIZES, joined

SCRIPT = Path(__file__).with_name("in_window.py")
BLENDER = "HOLOPATH_BLENDER_ON_DISPLAY"
MONITOR = 1920, 1080  # pixels of each monitor; the second is at the right of the first
QUALITY = 65  # of JPEG: small print can be read, and 150 kB hold a window with a hologram in it
SMALLER = 0.5  # size of the second monitor in a picture of both
PATIENCE = 600.0  # seconds for a picture's state
RATE = 3.0  # pictures of the film a second, most
LONGEST = 60.0  # seconds of the film: what takes longer is shown faster
WIDTH = 848  # pixels of the film
FILM_QUALITY = 50  # of WebP


@contextmanager
def opened() -> Iterator[Callable[[str], None]]:
    """Start the X server, and install the extension in a Blender with an empty user folder.

    Yields
    ------
    callable
        Takes the picture or the film of that name, and writes it and its labels to docs/images.

    Raises
    ------
    SystemExit
        Where there is no Blender, or no X server.
    """
    command = shlex.split(os.environ.get(BLENDER, ""))
    if not command:
        raise SystemExit(
            f"{BLENDER} names no Blender: set it to a command that runs one on the screen DISPLAY."
        )
    with tempfile.TemporaryDirectory(prefix="holopath-pictures-", ignore_cleanup_errors=True) as folder:
        try:
            with monitors(Path(folder)) as display:
                blender = Blender(Path(folder) / "user", command)
                install(blender, Path(folder))
                yield lambda name: (_film if name in FILMED else _take)(blender, command, display, Path(name))
        except NoMonitors as error:
            raise SystemExit(str(error)) from None


def _take(blender, command, display, path):
    """One picture, by a Blender of its own."""
    name = path.stem
    with _started(blender, command, display, name, SIZES[name]) as (process, folder):
        state = _wait(process, folder, "ready")
        picture = _screen(display, state["box"])
        if name == "device":
            picture = joined([picture, _smaller(_screen(display, (MONITOR[0], 0, *MONITOR)))])
        (folder / "taken").touch()
        process.communicate(timeout=60)
    picture.save(IMAGES / path, quality=QUALITY, optimize=True, progressive=True)
    _note_labels(path.name, state["labels"])


def _film(blender, command, display, path):
    """All that the window shows from the first step to the last."""
    images, times = [], []
    with _started(blender, command, display, "film", FILM) as (process, folder):
        box = _wait(process, folder, "recording")["box"]
        begin = time.monotonic()
        while not (folder / "ready.json").exists():
            _check(process, folder, begin + PATIENCE)
            image = _screen(display, box)
            image = image.resize((WIDTH, round(WIDTH * image.height / image.width)), Image.Resampling.LANCZOS)
            if not images or ImageChops.difference(image, images[-1]).getbbox():
                images.append(image)
                times.append(time.monotonic() - begin)
            time.sleep(1 / RATE)
        times.append(time.monotonic() - begin)
        (folder / "taken").touch()
        process.communicate(timeout=60)
    save_film(images, times, IMAGES / path)


def save_film(images: Sequence[Image.Image], times: Sequence[float], path: Path) -> None:
    """Write pictures as an animated WebP that begins anew at its end.

    Parameters
    ----------
    images : sequence of PIL.Image.Image
    times : sequence of float
        Seconds at which each is there, and of the end. Where that is later than `LONGEST`, all goes faster. Of pictures
        that would then follow each other faster than `RATE` the last one counts.
    path : Path
    """
    faster = max(1.0, (times[-1] - times[0]) / LONGEST)
    begins, kept = [], []
    for image, begin in zip(images, times, strict=False):
        if begins and begin - begins[-1] < faster / RATE:
            kept[-1] = image
        else:
            begins.append(begin)
            kept.append(image)
    durations = [round(1e3 * (after - before) / faster) for before, after in pairwise([*begins, times[-1]])]
    first, *others = kept
    first.save(
        path, save_all=True, append_images=others, duration=durations, loop=0, quality=FILM_QUALITY, method=6
    )


@contextmanager
def _started(blender, command, display, name, size):
    """A Blender that comes to the state of a name, and the folder in which it tells of it."""
    width, height = size
    with tempfile.TemporaryDirectory(prefix="holopath-picture-") as folder:
        words = ["--factory-startup", "--addons", "bl_ext.user_default.holopath"]
        words += ["--window-geometry", "0", str(MONITOR[1] - height), str(width), str(height)]  # from below
        words += ["--python", str(SCRIPT), "--", name.replace("-", "_"), folder]
        process = blender.start(
            [*command, *words], {"DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1", "WAYLAND_DISPLAY": ""}
        )
        try:
            yield process, Path(folder)
        finally:
            blender.end(process)


def _wait(process, folder, name):
    """What the script tells of a state, once it is reached."""
    end = time.monotonic() + PATIENCE
    while not (folder / f"{name}.json").exists():
        _check(process, folder, end)
        time.sleep(0.05)
    return json.loads((folder / f"{name}.json").read_text("utf-8"))


def _check(process, folder, end):
    """Raise where the script failed, Blender ended, or it takes too long."""
    if (folder / "failed").exists():
        raise RuntimeError((folder / "failed").read_text("utf-8"))
    if process.poll() is not None or time.monotonic() > end:
        raise RuntimeError(f"Blender does not come to the picture:\n{process.communicate(timeout=10)[0]}")


def _screen(display, box):
    """A part of the screen: left, top, width and height, pixels."""
    with mss.MSS(display=display) as screen:
        grabbed = screen.grab(dict(zip(("left", "top", "width", "height"), box, strict=True)))
    return Image.frombytes("RGB", grabbed.size, grabbed.bgra, "raw", "BGRX")


def _smaller(image):
    size = (round(SMALLER * side) for side in image.size)
    return image.resize(tuple(size), Image.Resampling.LANCZOS)


def _note_labels(name, texts):
    """Keep a picture's labels beside those of the others."""
    known = json.loads(LABELS.read_text("utf-8")) if LABELS.exists() else {}
    known[name] = texts
    LABELS.write_text(json.dumps(dict(sorted(known.items())), indent=1, ensure_ascii=False) + "\n", "utf-8")
