"""The window on the SLM's monitor: a separate program, which `display` starts. It needs SDL, and no HoloPath.

    python display_window.py --list              monitors, a JSON list
    python display_window.py '{"monitor": ...}'  a window; orders on standard input, reports on standard output

Orders are lines: ``show SLOT VERSION NUMBER``, and ``end`` after the last one. The window closes with the end of the
input. The pixels of a slot lie in a file that both programs map; four bytes each: blue, green, red and an unused one.
A slot is read when its picture is shown. Reports are lines of JSON.
"""

from __future__ import annotations

import ctypes
import json
import math
import mmap
import signal
import sys
import threading
import time
import warnings
from collections import deque
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import sdl2  # `main` imports it from a given folder

TRIES = 20  # presentations that show whether the window waits for the monitor
MAX_DEVIATION = 0.02  # of the monitor's rate from the nominal one, as a fraction
MAX_AHEAD = 3.0  # refreshes by which presentations may be early: a graphics card queues that many
EARLY = (
    10  # presentations in a row that are too early, after which the window no longer waits for the monitor
)
PRELOAD = 6  # pictures to have before the first is shown
PATIENCE = 0.2  # seconds to wait for them
IN_MEMORY = {b"dummy", b"offscreen", b"evdev"}  # drivers of SDL that show nothing on a screen
HINTS = {
    b"SDL_VIDEO_MINIMIZE_ON_FOCUS_LOSS": b"0",
    b"SDL_WINDOW_NO_ACTIVATION_WHEN_SHOWN": b"1",
    b"SDL_RENDER_SCALE_QUALITY": b"nearest",
    b"SDL_WINDOWS_DPI_AWARENESS": b"permonitorv2",
}


def report(**fields) -> None:
    """Write a report on standard output."""
    print(json.dumps(fields), flush=True)


class Trouble(Exception):
    """An error with a remedy for the user."""


def monitors() -> list[dict]:
    """List SDL's monitors, the primary one first."""
    rows = []
    for index in range(sdl2.SDL_GetNumVideoDisplays()):
        bounds, mode = sdl2.SDL_Rect(), sdl2.SDL_DisplayMode()
        sdl2.SDL_GetDisplayBounds(index, bounds)
        sdl2.SDL_GetDesktopDisplayMode(index, mode)
        name = (sdl2.SDL_GetDisplayName(index) or b"").decode("utf-8", "replace")
        rows.append(
            {
                "name": name or f"monitor {index}",
                "x": bounds.x,
                "y": bounds.y,
                "width": bounds.w,
                "height": bounds.h,
                "refresh": float(mode.refresh_rate or 60),
                "primary": index == 0,
            }
        )
    return rows


class Orders:
    """Orders from standard input, which a thread reads."""

    def __init__(self) -> None:
        self.shows = deque()
        self.complete = self.quit = False
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in sys.stdin:
            word, *numbers = line.split()
            if word == "show":
                self.shows.append(tuple(map(int, numbers)))
            elif word == "end":
                self.complete = True
        self.quit = True  # also when the parent program is gone


class Refresh:
    """Counter of the monitor's refreshes: by the duration of presentations, or by a clock if these do not wait.

    Attributes
    ----------
    waits : bool
        Whether presenting waits for the monitor.
    rate : float
        Refreshes per second: measured if presenting waits, else nominal.
    count : int
        Number of refreshes so far.
    """

    def __init__(self, present: Callable[[], None], nominal: float, may_wait: bool) -> None:
        self._present = present
        times = []
        for _ in range(TRIES if may_wait else 1):
            present()
            times.append(time.perf_counter())
        gaps = sorted(b - a for a, b in zip(times[4:], times[5:], strict=False))
        middle = gaps[len(gaps) // 2] if gaps else 0.0
        even = sum(abs(gap - middle) < 0.1 * middle for gap in gaps) > 0.8 * len(gaps)
        # Windows rounds rates down: 29 is 29.97, and 23 is 23.976
        self.waits = even and abs(middle * nominal - 1) < max(MAX_DEVIATION, 1.05 / nominal)
        self.rate = 1 / middle if self.waits else nominal
        self.count = self._early = 0
        self._start = time.perf_counter()

    def next(self) -> None:
        """Present, and wait for the refresh that shows it, whose number is `count` afterwards."""
        self._present()
        now = (time.perf_counter() - self._start) * self.rate
        if self.waits:
            self.count = max(self.count + 1, round(now))
            if self.count - now > MAX_AHEAD:  # nothing waits where the screen is locked or the window covered
                time.sleep((self.count - now - MAX_AHEAD) / self.rate)
                self._early += 1
                if self._early == EARLY:
                    self.waits = False
                    report(event="clock")
                return
            self._early = 0
            # the monitor's clock differs from this computer's: follow it slowly
            self._start += 0.05 * (now - self.count) / self.rate
            return
        self.count = max(self.count, int(now)) + 1
        while (seconds := self._start + self.count / self.rate - time.perf_counter()) > 0:
            time.sleep(seconds - 1e-3 if seconds > 2e-3 else 0)


class Window:
    """A borderless window that covers a monitor, pixel for pixel."""

    def __init__(self, request: dict) -> None:
        self._width, self._height = request["width"], request["height"]
        flags = (
            sdl2.SDL_WINDOW_BORDERLESS
            | sdl2.SDL_WINDOW_FULLSCREEN_DESKTOP
            | sdl2.SDL_WINDOW_ALLOW_HIGHDPI
            | sdl2.SDL_WINDOW_SKIP_TASKBAR
        )
        place = (request["x"], request["y"], self._width, self._height)
        self._window = sdl2.SDL_CreateWindow(b"HoloPath SLM", *place, flags)
        if not self._window:
            raise Trouble(
                f"The window cannot be opened ({error()}). Log in at the desktop that the monitor belongs to."
            )
        self._display = sdl2.SDL_GetWindowDisplayIndex(self._window)
        sdl2.SDL_ShowCursor(sdl2.SDL_DISABLE)
        self._renderer = self._make_renderer()
        width, height = ctypes.c_int(), ctypes.c_int()
        sdl2.SDL_GetRendererOutputSize(self._renderer, width, height)
        if (width.value, height.value) != (self._width, self._height):
            raise Trouble(
                f"The window has {width.value} x {height.value} pixels, not {self._width} x {self._height}. Set the "
                "monitor's scale to 100 % in the system's settings."
            )
        self._textures = {}
        self._slot = None
        sdl2.SDL_SetRenderDrawColor(self._renderer, 0, 0, 0, 255)

    def _make_renderer(self):
        """Create SDL's default renderer, or that of the environment variable SDL_RENDER_DRIVER."""
        renderer = sdl2.SDL_CreateRenderer(self._window, -1, 0)
        if not renderer:
            raise Trouble(f"No renderer can draw into the window ({error()}). Update the graphics driver.")
        info = sdl2.SDL_RendererInfo()
        sdl2.SDL_GetRendererInfo(renderer, info)
        self.renderer = info.name.decode()
        # a renderer without a graphics card only pretends to wait for the monitor
        self.may_wait = self.renderer != "software" and sdl2.SDL_RenderSetVSync(renderer, 1) == 0
        return renderer

    def load(self, slot: int, address: int) -> None:
        """Copy a slot's pixels from an address to the graphics card."""
        if slot not in self._textures:
            size = self._width, self._height
            kind = sdl2.SDL_PIXELFORMAT_ARGB8888, sdl2.SDL_TEXTUREACCESS_STREAMING
            self._textures[slot] = sdl2.SDL_CreateTexture(self._renderer, *kind, *size)
            if not self._textures[slot]:
                raise Trouble(
                    f"The graphics card has no room for the pictures ({error()}). Use fewer, or smaller ones."
                )
            sdl2.SDL_SetTextureBlendMode(self._textures[slot], sdl2.SDL_BLENDMODE_NONE)
        if sdl2.SDL_UpdateTexture(self._textures[slot], None, address, 4 * self._width):
            raise Trouble(f"The picture cannot be drawn ({error()}). Update the graphics driver.")

    def choose(self, slot: int) -> None:
        """Choose the slot to present."""
        self._slot = slot

    def present(self) -> None:
        """Draw the chosen slot; black before the first choice."""
        sdl2.SDL_RenderClear(self._renderer)
        if self._slot is not None:
            sdl2.SDL_RenderCopy(self._renderer, self._textures[self._slot], None, None)
        sdl2.SDL_RenderPresent(self._renderer)

    def close_reason(self) -> str:
        """Event that closes the window; empty without one."""
        event = sdl2.SDL_Event()
        while sdl2.SDL_PollEvent(ctypes.byref(event)):
            if event.type == sdl2.SDL_QUIT or (
                event.type == sdl2.SDL_KEYDOWN and event.key.keysym.sym == sdl2.SDLK_ESCAPE
            ):
                return "closed"
            if (
                event.type == sdl2.SDL_DISPLAYEVENT
                and event.display.event == sdl2.SDL_DISPLAYEVENT_DISCONNECTED
                and event.display.display == self._display
            ):
                return "unplugged"
        return ""


def error() -> str:
    """SDL's last error."""
    return sdl2.SDL_GetError().decode("utf-8", "replace") or "no reason given"


def play(request: dict) -> None:
    """Show the ordered pictures, each for the same number of refreshes."""
    size = 4 * request["width"] * request["height"]
    with open(request["ring"], "r+b") as file:
        ring = mmap.mmap(file.fileno(), 0)
    begin = ctypes.addressof(ctypes.c_char.from_buffer(ring))
    window, orders = Window(request), Orders()
    refresh = Refresh(window.present, request["refresh"], window.may_wait)
    # whole refreshes, never faster than requested, up to the difference of clocks and errors of its measurement
    hold = max(1, math.ceil(request["refresh"] / request["rate"] - 0.05)) if request["rate"] else 1
    report(event="ready", rate=refresh.rate / hold, waits=refresh.waits, renderer=window.renderer)
    versions, due, waits = {}, None, 0  # due: the refresh that shows the next picture; waits: for the first
    while not orders.quit:
        reason = window.close_reason()
        if reason:
            report(event=reason)
            return
        if due is None:  # time starts with the first picture, once more are ready or no more come
            waits = waits + 1 if orders.shows else 0
            if not (len(orders.shows) >= PRELOAD or waits > refresh.rate * PATIENCE or orders.complete):
                refresh.next()
                continue
            due = refresh.count + 1
        if refresh.count + 1 >= due:
            while len(orders.shows) > 1 and due + hold <= refresh.count + 1:  # its time has passed
                slot, version, number = orders.shows.popleft()
                report(event="dropped", number=number)
                due += hold
            if orders.shows:
                slot, version, number = orders.shows.popleft()
                if versions.get(slot) != version:
                    window.load(slot, begin + slot * size)
                    versions[slot] = version
                window.choose(slot)
                refresh.next()
                report(event="late" if refresh.count > due else "shown", number=number)
                due += hold
                continue
            if orders.complete:
                report(event="end")
                return
        refresh.next()


def main(words: Sequence[str]) -> None:
    """Run the program with arguments: a request, and folders of libraries."""
    global sdl2
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent program
    request = None if words[0] == "--list" else json.loads(words[0])
    sys.path[:0] = words[1:]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PySDL2 names the SDL that it uses
        import sdl2 as module
    sdl2 = module
    for name, value in HINTS.items():
        sdl2.SDL_SetHint(name, value)
    if sdl2.SDL_Init(sdl2.SDL_INIT_VIDEO) or sdl2.SDL_GetCurrentVideoDriver() in IN_MEMORY:
        raise Trouble(f"There is no usable screen ({error()}). Log in at a desktop.")
    if request is None:
        report(monitors=monitors())
    else:
        play(request)
    sdl2.SDL_Quit()


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except Trouble as trouble:
        report(event="trouble", text=str(trouble))
        sys.exit(1)
