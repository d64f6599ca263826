"""Driver of SLMs that are monitors: full screen in a separate process, pixel for pixel."""

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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...engine.errors import Cancelled, InvalidInput
from ..driver import DROPPED, LATE, SHOWN, Info
from ..errors import DeviceLost

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..driver import Picture

RING_BYTES = 256 << 20  # of pictures in memory shared with the window's process
MIN_SLOTS, MAX_SLOTS = 3, 64  # pictures in that memory
START_TIMEOUT = 20.0  # seconds that the window may take to appear
POLL_INTERVAL = 0.1  # seconds that a call may wait
STALL_TIMEOUT = 3.0  # seconds without a refresh after which the window is lost
NO_WINDOW = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # Windows would open a console
MAX_QUEUED = 8  # pictures sent to the window and not shown yet


@dataclass(frozen=True)
class Monitor:
    """One of the computer's monitors.

    Attributes
    ----------
    name : str
    x, y, width, height : int
        Position and size in pixels.
    refresh : float
        Refreshes per second.
    primary : bool
        Whether it is the user's main monitor.
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
        """Size and position, such as ``1920x1080+1920+0``."""
        return f"{self.width}x{self.height}{self.x:+d}{self.y:+d}"

    def __str__(self) -> str:
        return f"{self.name} {self.geometry} {self.refresh:g} Hz{' (primary)' if self.primary else ''}"


def monitors() -> list[Monitor]:
    """List the monitors, the primary one first.

    Raises
    ------
    InvalidInput
        If there is no screen, or no SDL.
    """
    command = [sys.executable, *_program(), "--list", *_libraries()]
    try:
        done = subprocess.run(
            command,
            creationflags=NO_WINDOW,
            capture_output=True, text=True, timeout=START_TIMEOUT, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        listing = json.loads(done.stdout.splitlines()[-1]) if done.stdout.strip() else {}
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise InvalidInput(f"The monitors cannot be listed ({error}). Log in at a desktop.") from error
    if "monitors" not in listing:
        raise InvalidInput(
            listing.get("text") or f"The monitors cannot be listed: {_last_line(done.stderr)}."
        )
    return [Monitor(**row) for row in listing["monitors"]]


def choose(
    available: list[Monitor],
    name: str | None = None,
    primary: bool = False,
    size: tuple[int, int] | None = None,
) -> Monitor:
    """Choose the SLM's monitor.

    Parameters
    ----------
    available : list of Monitor
    name : str, optional
        Name or geometry, or both (``HDMI-1 1920x1080+1920+0``). Default: the only monitor that is not primary, or the
        only one of these with the size of the pictures.
    primary : bool
        Whether the primary monitor, where the user works, is allowed.
    size : (int, int), optional
        Width and height of the pictures.

    Returns
    -------
    Monitor

    Raises
    ------
    InvalidInput
        If no monitor or several match, or the only one is the primary monitor and not allowed.
    """
    listing = "; ".join(map(str, available)) or "none"
    if name:
        matches = [m for m in available if name in (m.name, m.geometry, f"{m.name} {m.geometry}")]
    else:
        others = [m for m in available if primary or not m.primary]
        matches = [m for m in others if len(others) == 1 or size in (None, (m.width, m.height))]
    if len(matches) == 1 and matches[0].primary and not primary:
        raise InvalidInput(
            f"{matches[0].name} is the primary monitor, where you work. Choose the SLM's (there are: {listing}), or "
            "allow it by --primary."
        )
    if len(matches) != 1:
        of = f" of {size[0]} x {size[1]} pixels" if size and len(available) > 2 else ""
        which = f"'{name}'" if name else f"for the SLM{of} besides the primary one"
        raise InvalidInput(
            f"There {'is no monitor' if not matches else 'are several monitors'} {which}. Give its name or geometry "
            f"(there are: {listing})."
        )
    return matches[0]


class DisplayDriver:
    """A driver of a monitor. It keeps time itself, by the monitor's refresh.

    Parameters
    ----------
    monitor : str, optional
    primary : bool
        See `choose`.
    size : (int, int), optional
        Width and height of the pictures, see `choose`.
    """

    def __init__(
        self, monitor: str | None = None, primary: bool = False, size: tuple[int, int] | None = None
    ) -> None:
        self._name, self._primary, self._size = monitor, primary, size
        self._window = None
        self.info = Info("display", channels=3)

    def open(self, rate: float | None, on_picture: Callable[[int, str], None]) -> None:
        """Open the window; see `Driver`. If the user closes it or presses Esc there, `show` raises `Cancelled`."""
        self.close()
        if rate is not None and not 0 < rate < 1e5:
            raise InvalidInput(f"Expected a rate from 0 to 100000 pictures a second, got {rate:g}.")
        monitor = self._monitor()
        self._window = _Window(monitor, rate, on_picture)
        ready = self._window.ready()
        self.info = Info(
            monitor.name, monitor.width, monitor.height, rate=ready["rate"], drops=True, channels=3,
            note=self._window.note,
        )  # fmt: skip

    def _monitor(self):
        """The chosen monitor, which must stay the same after a loss."""
        try:
            monitor = choose(monitors(), self._name, self._primary, self._size)
        except InvalidInput as error:
            if self.info.width:
                raise DeviceLost(str(error)) from error
            raise
        self._name = f"{monitor.name} {monitor.geometry}"
        return monitor

    def show(self, number: int, picture: Picture) -> bool:
        """Send a picture to the window; False if it is busy, see `Driver`."""
        pixels = picture.pixels
        if pixels.dtype != np.uint8 or pixels.shape[:2] != (self.info.height, self.info.width):
            raise InvalidInput(
                f"The monitor has {self.info.width} x {self.info.height} pixels of 8 bits, the picture "
                f"{pixels.shape[1]} x {pixels.shape[0]} of {8 * pixels.itemsize} bits. Give the monitor's calibration."
            )
        assert self._window is not None  # `open` comes first
        if self.info.note != self._window.note:
            self.info = replace(self.info, note=self._window.note)
        return self._window.give(number, picture)

    def close(self, finish: bool = False) -> bool | None:
        """Close the window; False while it still shows waiting pictures, see `Driver`."""
        if self._window is None:
            return None
        if finish and not self._window.is_finished():
            return False
        window, self._window = self._window, None
        window.close()
        return None


class _Window:
    """The process of a window, and the memory shared with it.

    Parameters
    ----------
    monitor : Monitor
    rate : float or None
    on_picture : callable
        See `Driver`; called in a separate thread.
    """

    def __init__(self, monitor, rate, on_picture):
        size = 4 * monitor.width * monitor.height
        self._ring, self._path = _allocate_ring(size)
        count = len(self._ring) // size
        self._slots = np.frombuffer(self._ring, np.uint8).reshape(count, monitor.height, monitor.width, 4)
        self._keys = OrderedDict()  # key of a picture to its slot and version, least recently used first
        self._version, self._free_slots = 0, list(range(count))
        self._on_picture, self._changed = on_picture, threading.Condition()
        self._in_flight, self._room = deque(), min(MAX_QUEUED, count - 1)
        self._ready: dict = {}
        self._geometry = monitor.geometry
        self._trouble: Exception | None = None
        self._ending = self._end = False
        self._last_event, self._patience = time.perf_counter(), START_TIMEOUT
        request = {
            "ring": self._path, "width": monitor.width, "height": monitor.height, "x": monitor.x, "y": monitor.y,
            "refresh": monitor.refresh, "rate": rate,
        }  # fmt: skip
        self._errors = tempfile.TemporaryFile()  # an unread pipe would fill up and block the window
        try:
            self._process = subprocess.Popen(
                [sys.executable, *_program(), json.dumps(request), *_libraries()],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors,
                text=True, errors="replace", creationflags=NO_WINDOW,
            )  # fmt: skip
        except BaseException:
            self._release()
            raise
        assert self._process.stdin is not None and self._process.stdout is not None  # pipes, see above
        self._orders, self._reports = self._process.stdin, self._process.stdout
        self._reader = threading.Thread(target=self._listen, name="HoloPath SLM", daemon=True)
        self._reader.start()

    def ready(self):
        """Wait for the window, and return its properties.

        Raises
        ------
        DeviceLost
        """
        while not self._until(lambda: self._ready):
            pass
        self._patience = STALL_TIMEOUT + 2 / self._ready["rate"]
        with contextlib.suppress(OSError):  # Windows cannot delete a mapped file
            os.unlink(self._path)
        return self._ready

    @property
    def note(self):
        """The monitor's geometry, the rate, and what keeps time at the moment."""
        ready = self._ready
        clock = "in step with the monitor" if ready["waits"] else "by the clock"
        return f"{self._geometry}, {ready['rate']:.4g} pictures a second, {clock} ({ready['renderer']})"

    def give(self, number, picture):
        """Order a picture to be shown; False if the queue is full."""
        if not self._until(lambda: len(self._in_flight) < self._room):
            return False
        slot = self._slot_of(picture)
        with self._changed:
            if not self._in_flight:
                self._last_event = time.perf_counter()
            self._in_flight.append((number, slot))
        self._order(f"show {slot} {self._keys[picture.key][1]} {number}")
        return True

    def is_finished(self):
        """Whether all pictures are shown; the first call closes the queue."""
        if not self._ending:
            self._ending, self._last_event = True, time.perf_counter()
            self._order("end")
        return self._until(lambda: self._end)

    def _until(self, done):
        """Wait a moment for a condition; whether it holds. Raises the window's trouble."""
        with self._changed:
            self._changed.wait_for(lambda: done() or self._trouble, POLL_INTERVAL)
            if done():
                return True
            if self._trouble:
                raise self._trouble
            if time.perf_counter() - self._last_event > self._patience:
                raise DeviceLost(f"The SLM's window has shown nothing for {self._patience:.0f} s. Try again.")
            return False

    def _slot_of(self, picture):
        """Slot of the picture's pixels; new pixels replace the least recently used."""
        if picture.key in self._keys:
            self._keys.move_to_end(picture.key)
            return self._keys[picture.key][0]
        if self._free_slots:
            slot = self._free_slots.pop()
        else:
            with self._changed:
                busy = {slot for _, slot in self._in_flight}
            old = next(key for key, (slot, _) in self._keys.items() if slot not in busy)
            slot, _ = self._keys.pop(old)
        if picture.pixels.ndim == 3:
            self._slots[slot, ..., 2::-1] = picture.pixels
        else:  # gray in all three channels, four bytes at once
            np.multiply(picture.pixels, 0x010101, out=self._slots[slot].view("<u4")[..., 0], dtype=np.uint32)
        self._version += 1
        self._keys[picture.key] = slot, self._version
        return slot

    def _order(self, line):
        try:
            self._orders.write(line + "\n")
            self._orders.flush()
        except (OSError, ValueError) as error:
            with self._changed:  # the process's last report says more
                self._changed.wait_for(lambda: self._trouble, 1.0)
                raise self._trouble or DeviceLost(
                    f"The SLM's window is gone ({error}). Try again."
                ) from error

    def _listen(self):
        """Read the window's reports until it ends."""
        for line in self._reports:
            try:
                report = json.loads(line)
            except ValueError:
                continue  # a graphics driver that writes to standard output
            with self._changed:
                self._last_event = time.perf_counter()
                picture = self._receive(report)
                self._changed.notify_all()
            if picture:
                self._on_picture(*picture)
        status = self._process.wait()
        self._errors.seek(0)
        reason = _last_line(self._errors.read().decode("utf-8", "replace")) or f"status {status}"
        with self._changed:
            if not self._end and self._trouble is None:
                self._trouble = DeviceLost(f"The SLM's window has crashed ({reason}). Try again.")
            self._changed.notify_all()

    def _receive(self, report):
        """Process a report; number and outcome of a picture, if it is about one."""
        event = report["event"]
        if event in (SHOWN, LATE, DROPPED):
            number, _ = self._in_flight.popleft()
            return number, event
        if event == "ready":
            self._ready = report
        elif event == "clock":
            self._ready["waits"] = False
        elif event == "end":
            self._end = True
        elif event == "trouble":
            self._trouble = DeviceLost(report["text"])
        elif event == "closed":
            self._trouble = Cancelled("Stopped: the SLM's window was closed.")
        elif event == "unplugged":
            self._trouble = DeviceLost("The SLM's monitor was unplugged. Plug it in again.")
        return None

    def close(self):
        """End the process, by force if needed."""
        with contextlib.suppress(OSError, ValueError):
            self._orders.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(2.0)
        self._reports.close()
        self._release()

    def _release(self):
        del self._slots, self._ring
        self._errors.close()
        with contextlib.suppress(OSError):
            os.unlink(self._path)


def _allocate_ring(size):
    """Memory for pictures of a size in bytes, to share with a process: a mapped file, and its path.

    The file is allocated at once: a program that writes to a mapped file on a full disk dies.
    """
    count = min(MAX_SLOTS, max(MIN_SLOTS, RING_BYTES // size))
    folders = [tempfile.gettempdir()]
    if os.access("/dev/shm", os.W_OK):  # memory, where the system has such a folder
        folders.insert(0, "/dev/shm")
    for folder, pictures in ((folder, n) for n in (count, MIN_SLOTS) for folder in folders):
        handle, path = tempfile.mkstemp(prefix="holopath-ring-", dir=folder)
        try:
            with os.fdopen(handle, "r+b") as file:
                _allocate(file, pictures * size)
                return mmap.mmap(file.fileno(), pictures * size), path
        except OSError:
            os.unlink(path)
    raise InvalidInput(
        f"There is no room for {MIN_SLOTS * size / 1e6:.0f} MB of pictures in {' or '.join(folders)}. Free some."
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
    """Folders of PySDL2 and of its library in this Python."""
    folders = []
    for name in ("sdl2", "sdl2dll"):
        spec = importlib.util.find_spec(name)
        if spec is None and name == "sdl2":
            raise InvalidInput("The driver display needs PySDL2. Run `pip install pysdl2 pysdl2-dll`.")
        if spec is not None and spec.origin is not None:
            folders.append(str(Path(spec.origin).parents[1]))
    return sorted(set(folders))


def _last_line(text):
    lines = text.strip().splitlines()
    return lines[-1] if lines else ""
