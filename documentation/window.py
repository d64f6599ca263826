"""Pictures of the window: a real Blender on an X server with two monitors, brought into a state by `in_window`."""

import json
import os
import shlex
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import mss
from PIL import Image

from tests.monitors import NoMonitors, monitors
from tests.real_blender import Blender, install

from .pictures import IMAGES, LABELS, SIZES, joined

SCRIPT = Path(__file__).with_name("in_window.py")
BLENDER = "HOLOPATH_BLENDER_ON_DISPLAY"
MONITOR = 1920, 1080  # pixels of each monitor; the second is at the right of the first
QUALITY = 65  # of JPEG: small print can be read, and 150 kB hold a window with a hologram in it
SMALLER = 0.5  # size of the second monitor in a picture of both
PATIENCE = 600.0  # seconds for a picture's state


@contextmanager
def opened() -> Iterator[Callable[[str], None]]:
    """Start the X server, and install the extension in a Blender with an empty user folder.

    Yields
    ------
    callable
        Takes the picture of that name, and writes it and its labels to docs/images.

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
                yield lambda name: _take(blender, command, display, name)
        except NoMonitors as error:
            raise SystemExit(str(error)) from None


def _take(blender, command, display, name):
    """One picture, by a Blender of its own."""
    width, height = SIZES[name]
    with tempfile.TemporaryDirectory(prefix="holopath-picture-") as folder:
        words = ["--factory-startup", "--addons", "bl_ext.user_default.holopath"]
        words += ["--window-geometry", "0", str(MONITOR[1] - height), str(width), str(height)]  # from below
        words += ["--python", str(SCRIPT), "--", name.replace("-", "_"), folder]
        process = blender.start(
            [*command, *words], {"DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1", "WAYLAND_DISPLAY": ""}
        )
        try:
            state = _wait(process, Path(folder))
            picture = _screen(display, state["box"])
            if name == "device":
                picture = joined([picture, _smaller(_screen(display, (MONITOR[0], 0, *MONITOR)))])
            (Path(folder) / "taken").touch()
            process.communicate(timeout=60)
        finally:
            blender.end(process)
    picture.save(IMAGES / f"{name}.jpg", quality=QUALITY, optimize=True, progressive=True)
    _note_labels(f"{name}.jpg", state["labels"])


def _wait(process, folder):
    """What the script tells of the state, once it is reached."""
    end = time.monotonic() + PATIENCE
    while not (folder / "ready.json").exists():
        if (folder / "failed").exists():
            raise RuntimeError((folder / "failed").read_text("utf-8"))
        if process.poll() is not None or time.monotonic() > end:
            raise RuntimeError(f"Blender does not come to the picture:\n{process.communicate(timeout=10)[0]}")
        time.sleep(0.05)
    return json.loads((folder / "ready.json").read_text("utf-8"))


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
