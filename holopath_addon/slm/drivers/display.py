"""A monitor that is an SLM: full screen in a process of its own, pixel for pixel."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import mmap
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import OrderedDict, deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...engine.errors import Cancelled, InvalidInput
from ..driver import DROPPED, LATE, SHOWN, Info
from ..errors import DeviceLost

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..driver import Picture

RING_BYTES = 256 << 20  # of pictures that the window's process can reach
FEWEST, MOST = 3, 64  # of them
START = 20.0  # seconds that the window may take to appear
TURN = 0.1  # seconds that one attempt may wait
STILL = 3.0  # seconds without a refresh after which the window is lost
NO_WINDOW = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # Windows would open a console
AHEAD = 8  # pictures under way to the window


@dataclass(frozen=True)
class Monitor:
    """One of the computer's monitors.

    Attributes
    ----------
    name : str
    x, y, width, height : int
        Pixels.
    refresh : float
        A second.
    primary : bool
    """

    name: str
    x: int
    y: int
    width: int
    height: int
    refresh: float
    primary: bool

    @property
    def geometry(self) -> str:
        """``1920x1080+1920+0``."""
        return f"{self.width}x{self.height}{self.x:+d}{self.y:+d}"

    def __str__(self) -> str:
        return f"{self.name} {self.geometry} {self.refresh:g} Hz{' (primary)' if self.primary else ''}"


def monitors() -> list[Monitor]:
    """The monitors, the primary one first.

    Raises
    ------
    InvalidInput
        If there is no screen, or no SDL to ask.
    """
    command = [sys.executable, *_program(), "--list", *_libraries()]
    try:
        done = subprocess.run(
            command,
            creationflags=NO_WINDOW,
            capture_output=True, text=True, timeout=START, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        said = json.loads(done.stdout.splitlines()[-1]) if done.stdout.strip() else {}
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise InvalidInput(f"The monitors cannot be listed ({error}): log in at a desktop.") from error
    if "monitors" not in said:
        raise InvalidInput(said.get("text") or f"The monitors cannot be listed: {_last_line(done.stderr)}.")
    return [Monitor(**row) for row in said["monitors"]]


def choose(
    found: list[Monitor],
    wanted: str | None = None,
    primary: bool = False,
    size: tuple[int, int] | None = None,
) -> Monitor:
    """The monitor that is meant.

    Parameters
    ----------
    found : list of Monitor
    wanted : str, optional
        Name or geometry, or both (``HDMI-1 1920x1080+1920+0``). Default: the only one that is not primary, or of
        those the only one of this size.
    primary : bool
        Whether the primary one, where the user works, may be taken.
    size : (int, int), optional
        Of the pictures.

    Returns
    -------
    Monitor

    Raises
    ------
    InvalidInput
        If there is none, or more than one; or it is the primary one and that was not allowed.
    """
    there = "; ".join(map(str, found)) or "none"
    if wanted:
        able = [m for m in found if wanted in (m.name, m.geometry, f"{m.name} {m.geometry}")]
    else:
        others = [m for m in found if primary or not m.primary]
        able = [m for m in others if len(others) == 1 or size in (None, (m.width, m.height))]
    if len(able) == 1 and able[0].primary and not primary:
        raise InvalidInput(
            f"{able[0].name} is the primary monitor, where you work: choose the SLM's (there are: {there}), or say "
            "that you mean it (--primary)."
        )
    if len(able) != 1:
        of = f" of {size[0]} x {size[1]} pixels" if size and len(found) > 2 else ""
        which = f"'{wanted}'" if wanted else f"for the SLM{of} besides the primary one"
        raise InvalidInput(
            f"There {'is no monitor' if not able else 'are several monitors'} {which}: name it by name or geometry "
            f"(there are: {there})."
        )
    return able[0]


class DisplayDriver:
    """A monitor. It keeps time itself, by the monitor's refresh.

    Parameters
    ----------
    monitor : str, optional
    primary : bool
        See `choose`.
    size : (int, int), optional
        Of the pictures, to choose by.
    """

    def __init__(
        self, monitor: str | None = None, primary: bool = False, size: tuple[int, int] | None = None
    ) -> None:
        self._wanted, self._primary, self._size = monitor, primary, size
        self._window = None
        self.info = Info("display", channels=3)

    def open(self, rate: float | None, told: Callable[[int, str], None]) -> None:
        """Open the window; see `Driver`. A user who closes it, or presses Esc there, ends what shows pictures."""
        self.close()
        if rate is not None and not 0 < rate < 1e5:
            raise InvalidInput(f"A rate of {rate:g} pictures a second cannot be shown.")
        monitor = self._monitor()
        self._window = _Window(monitor, rate, told)
        ready = self._window.ready()
        self.info = Info(
            monitor.name, monitor.width, monitor.height, rate=ready["rate"], drops=True, channels=3,
            note=f"{monitor.geometry}, {ready['rate']:.4g} pictures a second, "
            f"{'in step with the monitor' if ready['waits'] else 'by the clock'} ({ready['renderer']})",
        )  # fmt: skip

    def _monitor(self):
        """The one that is meant; after the first time the very same."""
        try:
            monitor = choose(monitors(), self._wanted, self._primary, self._size)
        except InvalidInput as error:
            if self.info.width:
                raise DeviceLost(str(error)) from error
            raise
        self._wanted = f"{monitor.name} {monitor.geometry}"
        return monitor

    def show(self, number: int, picture: Picture) -> bool:
        """Hand a picture to the window; False where it has no room yet."""
        pixels = picture.pixels
        if pixels.dtype != np.uint8 or pixels.shape[:2] != (self.info.height, self.info.width):
            raise InvalidInput(
                f"The picture has {pixels.shape[1]} x {pixels.shape[0]} pixels of {8 * pixels.itemsize} bits, the "
                f"monitor {self.info.width} x {self.info.height} of 8: give a calibration that says so."
            )
        assert self._window is not None  # `open` comes first
        return self._window.give(number, picture)

    def close(self, finish: bool = False) -> bool | None:
        """Close the window; False where it still shows what it was to finish."""
        if self._window is None:
            return None
        if finish and not self._window.finished():
            return False
        window, self._window = self._window, None
        window.close()
        return None


class _Window:
    """One process with its window, from its start to its end, and the memory that both share.

    Parameters
    ----------
    monitor : Monitor
    rate : float or None
    told : callable
        See `Driver`; called in a thread of its own.
    """

    def __init__(self, monitor, rate, told):
        size = 4 * monitor.width * monitor.height
        self._ring, self._path = _shared(size)
        count = len(self._ring) // size
        self._slots = np.frombuffer(self._ring, np.uint8).reshape(count, monitor.height, monitor.width, 4)
        self._keys = OrderedDict()  # key of a picture to its slot and version, longest unused first
        self._version, self._unused = 0, list(range(count))
        self._told, self._changed = told, threading.Condition()
        self._under_way, self._room = deque(), min(AHEAD, count - 1)
        self._ready: dict = {}
        self._trouble: Exception | None = None
        self._asked = self._end = False
        self._moved, self._patience = time.perf_counter(), START
        wanted = {
            "ring": self._path, "width": monitor.width, "height": monitor.height, "x": monitor.x, "y": monitor.y,
            "refresh": monitor.refresh, "rate": rate,
        }  # fmt: skip
        self._errors = tempfile.TemporaryFile()  # a pipe that nobody reads would fill up and stop the window
        try:
            self._process = subprocess.Popen(
                [sys.executable, *_program(), json.dumps(wanted), *_libraries()],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors,
                text=True, errors="replace", creationflags=NO_WINDOW,
            )  # fmt: skip
        except BaseException:
            self._let_go()
            raise
        assert self._process.stdin is not None and self._process.stdout is not None  # pipes, as asked for
        self._orders, self._said = self._process.stdin, self._process.stdout
        self._reader = threading.Thread(target=self._listen, name="HoloPath SLM", daemon=True)
        self._reader.start()

    def ready(self):
        """Wait for the window; what it says of itself.

        Raises
        ------
        DeviceLost
        """
        while not self._until(lambda: self._ready):
            pass
        self._patience = STILL + 2 / self._ready["rate"]
        with contextlib.suppress(OSError):  # Windows: not while it is mapped
            os.unlink(self._path)
        return self._ready

    def give(self, number, picture):
        """Order a picture to be shown; False where there is no room yet."""
        if not self._until(lambda: len(self._under_way) < self._room):
            return False
        slot = self._slot_of(picture)
        with self._changed:
            if not self._under_way:
                self._moved = time.perf_counter()
            self._under_way.append((number, slot))
        self._order(f"show {slot} {self._keys[picture.key][1]} {number}")
        return True

    def finished(self):
        """Whether all is shown; nothing more may be given."""
        if not self._asked:
            self._asked, self._moved = True, time.perf_counter()
            self._order("end")
        return self._until(lambda: self._end)

    def _until(self, done):
        """Wait a moment; whether it is done. Raises what is wrong with the window."""
        with self._changed:
            self._changed.wait_for(lambda: done() or self._trouble, TURN)
            if done():
                return True
            if self._trouble:
                raise self._trouble
            if time.perf_counter() - self._moved > self._patience:
                raise DeviceLost(f"The SLM's window stands still for {self._patience:.0f} s: try again.")
            return False

    def _slot_of(self, picture):
        """Where the picture's pixels lie: where they already do, or in the slot that is unused for the longest time."""
        if picture.key in self._keys:
            self._keys.move_to_end(picture.key)
            return self._keys[picture.key][0]
        if self._unused:
            slot = self._unused.pop()
        else:
            with self._changed:
                busy = {slot for _, slot in self._under_way}
            old = next(key for key, (slot, _) in self._keys.items() if slot not in busy)
            slot, _ = self._keys.pop(old)
        if picture.pixels.ndim == 3:
            self._slots[slot, ..., 2::-1] = picture.pixels
        else:  # grey in all three channels, four bytes at once
            np.multiply(picture.pixels, 0x010101, out=self._slots[slot].view("<u4")[..., 0], dtype=np.uint32)
        self._version += 1
        self._keys[picture.key] = slot, self._version
        return slot

    def _order(self, line):
        try:
            self._orders.write(line + "\n")
            self._orders.flush()
        except (OSError, ValueError) as error:
            with self._changed:  # its last words say more
                self._changed.wait_for(lambda: self._trouble, 1.0)
                raise self._trouble or DeviceLost(
                    f"The SLM's window is gone ({error}): try again."
                ) from error

    def _listen(self):
        """What the window tells, until it ends."""
        for line in self._said:
            try:
                said = json.loads(line)
            except ValueError:
                continue  # a graphics driver that writes to standard output
            with self._changed:
                self._moved = time.perf_counter()
                shown = self._hear(said)
                self._changed.notify_all()
            if shown:
                self._told(*shown)
        status = self._process.wait()
        self._errors.seek(0)
        reason = _last_line(self._errors.read().decode("utf-8", "replace")) or f"status {status}"
        with self._changed:
            if not self._end and self._trouble is None:
                self._trouble = DeviceLost(f"The SLM's window has crashed ({reason}): try again.")
            self._changed.notify_all()

    def _hear(self, said):
        """Take in a line; number and fate of a picture, if it tells of one."""
        what = said["event"]
        if what in (SHOWN, LATE, DROPPED):
            number, _ = self._under_way.popleft()
            return number, what
        if what == "ready":
            self._ready = said
        elif what == "end":
            self._end = True
        elif what == "trouble":
            self._trouble = DeviceLost(said["text"])
        elif what == "closed":
            self._trouble = Cancelled("Stopped: the SLM's window was closed.")
        elif what == "unplugged":
            self._trouble = DeviceLost("The SLM's monitor was unplugged: plug it in again.")
        return None

    def close(self):
        """End the process, whatever it does."""
        with contextlib.suppress(OSError, ValueError):
            self._orders.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(2.0)
        self._said.close()
        self._let_go()

    def _let_go(self):
        del self._slots, self._ring
        self._errors.close()
        with contextlib.suppress(OSError):
            os.unlink(self._path)


def _shared(size):
    """Memory that two programs share, for some pictures of so many bytes: a map of a file, and the file's path.

    It is asked for at once: where a file's room ends only when it is written, the program that writes dies.
    """
    count = min(MOST, max(FEWEST, RING_BYTES // size))
    folders = [tempfile.gettempdir()]
    if os.access("/dev/shm", os.W_OK):  # memory, where the system has such a folder
        folders.insert(0, "/dev/shm")
    for folder, pictures in ((folder, n) for n in (count, FEWEST) for folder in folders):
        handle, path = tempfile.mkstemp(prefix="holopath-ring-", dir=folder)
        try:
            with os.fdopen(handle, "r+b") as file:
                _allocate(file, pictures * size)
                return mmap.mmap(file.fileno(), pictures * size), path
        except OSError:
            os.unlink(path)
    raise InvalidInput(
        f"There is no room for {FEWEST * size / 1e6:.0f} MB of pictures in {' or '.join(folders)}: free some."
    )


def _allocate(file, size):
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
        return
    for begin in range(0, size, 1 << 20):
        file.write(bytes(min(1 << 20, size - begin)))
    file.flush()


def _program():
    return ["-I", str(Path(__file__).with_name("display_window.py"))]


def _libraries():
    """Folders of PySDL2 and its library, wherever this Python has them."""
    folders = []
    for name in ("sdl2", "sdl2dll"):
        found = importlib.util.find_spec(name)
        if found is None and name == "sdl2":
            raise InvalidInput(
                "The driver display needs PySDL2: install it with `pip install pysdl2 pysdl2-dll`."
            )
        if found is not None and found.origin is not None:
            folders.append(str(Path(found.origin).parents[1]))
    return sorted(set(folders))


def _last_line(text):
    lines = text.strip().splitlines()
    return lines[-1] if lines else ""
