"""The window on the SLM's monitor: a program of its own, which `display` starts. Needs SDL, and nothing of HoloPath.

    python display_window.py --list              monitors, a JSON list
    python display_window.py '{"monitor": ...}'  a window; orders on standard input, what happens on standard output

Orders, a line each: ``show SLOT VERSION NUMBER`` and ``end`` (nothing more will come); with the end of the input the
window closes. The pixels of a slot lie in a file that both programs map; four bytes each, blue, green, red and one
without use. A slot is read when its picture is shown; what became of each is told in lines of JSON.
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

    import sdl2  # `main` does, from where it is told

TRIES = 20  # presentations by which to see whether the window waits for the monitor
READY = 6  # pictures that lie ready when time begins
PATIENCE = 0.2  # seconds to wait for them
IN_MEMORY = {b"dummy", b"offscreen", b"evdev"}  # drivers of SDL that show nothing on a screen
HINTS = {
    b"SDL_VIDEO_MINIMIZE_ON_FOCUS_LOSS": b"0",
    b"SDL_WINDOW_NO_ACTIVATION_WHEN_SHOWN": b"1",
    b"SDL_RENDER_SCALE_QUALITY": b"nearest",
    b"SDL_WINDOWS_DPI_AWARENESS": b"permonitorv2",
}


def tell(**what) -> None:
    """A line on standard output."""
    print(json.dumps(what), flush=True)


class Trouble(Exception):
    """Something that the user can do something about."""


def monitors() -> list[dict]:
    """All of them, the primary one first, as SDL has it."""
    found = []
    for index in range(sdl2.SDL_GetNumVideoDisplays()):
        bounds, mode = sdl2.SDL_Rect(), sdl2.SDL_DisplayMode()
        sdl2.SDL_GetDisplayBounds(index, bounds)
        sdl2.SDL_GetDesktopDisplayMode(index, mode)
        name = (sdl2.SDL_GetDisplayName(index) or b"").decode("utf-8", "replace")
        found.append(
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
    return found


class Orders:
    """What is read from standard input, by a thread."""

    def __init__(self) -> None:
        self.shows = deque()
        self.ended = self.quit = False
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in sys.stdin:
            word, *numbers = line.split()
            if word == "show":
                self.shows.append(tuple(map(int, numbers)))
            elif word == "end":
                self.ended = True
        self.quit = True  # also when the program that started this one is gone


class Refresh:
    """Counts the monitor's refreshes: by how long presenting takes, or by a clock where nothing waits for the monitor.

    Attributes
    ----------
    waits : bool
        Whether presenting waits for the monitor.
    rate : float
        Refreshes a second, as measured if so, else as the monitor says.
    count : int
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
        self.waits = even and abs(middle * nominal - 1) < 0.02
        self.rate = 1 / middle if self.waits else nominal
        self.count = 0
        self._start = time.perf_counter()

    def next(self) -> None:
        """Present, and wait for the refresh that shows it; `count` is then its number."""
        self._present()
        now = (time.perf_counter() - self._start) * self.rate
        if self.waits:
            self.count = max(self.count + 1, round(now))
            # the monitor's clock is not this computer's: follow it slowly
            self._start += 0.05 * (now - self.count) / self.rate
            return
        self.count = max(self.count, int(now)) + 1
        while (left := self._start + self.count / self.rate - time.perf_counter()) > 0:
            time.sleep(left - 1e-3 if left > 2e-3 else 0)


class Window:
    """A borderless window that covers a monitor, pixel for pixel."""

    def __init__(self, wanted: dict) -> None:
        self._width, self._height = wanted["width"], wanted["height"]
        flags = (
            sdl2.SDL_WINDOW_BORDERLESS
            | sdl2.SDL_WINDOW_FULLSCREEN_DESKTOP
            | sdl2.SDL_WINDOW_ALLOW_HIGHDPI
            | sdl2.SDL_WINDOW_SKIP_TASKBAR
        )
        place = (wanted["x"], wanted["y"], self._width, self._height)
        self._window = sdl2.SDL_CreateWindow(b"HoloPath SLM", *place, flags)
        if not self._window:
            raise Trouble(
                f"The window cannot be opened ({error()}): log in at the desktop that the monitor belongs to."
            )
        self._display = sdl2.SDL_GetWindowDisplayIndex(self._window)
        sdl2.SDL_ShowCursor(sdl2.SDL_DISABLE)
        self._renderer = self._make_renderer()
        width, height = ctypes.c_int(), ctypes.c_int()
        sdl2.SDL_GetRendererOutputSize(self._renderer, width, height)
        if (width.value, height.value) != (self._width, self._height):
            raise Trouble(
                f"The window has {width.value} x {height.value} pixels, not {self._width} x {self._height}: set the "
                "monitor's scale to 100 % in the system's settings."
            )
        self._textures = {}
        self._shown = None
        sdl2.SDL_SetRenderDrawColor(self._renderer, 0, 0, 0, 255)

    def _make_renderer(self):
        """SDL's choice, or that of its environment variable SDL_RENDER_DRIVER."""
        renderer = sdl2.SDL_CreateRenderer(self._window, -1, 0)
        if not renderer:
            raise Trouble(f"Nothing can draw into the window ({error()}): update the graphics driver.")
        info = sdl2.SDL_RendererInfo()
        sdl2.SDL_GetRendererInfo(renderer, info)
        self.renderer = info.name.decode()
        # a renderer without a graphics card only pretends to wait for the monitor
        self.may_wait = self.renderer != "software" and sdl2.SDL_RenderSetVSync(renderer, 1) == 0
        return renderer

    def load(self, slot: int, address: int) -> None:
        """Read a slot's pixels."""
        if slot not in self._textures:
            size = self._width, self._height
            kind = sdl2.SDL_PIXELFORMAT_ARGB8888, sdl2.SDL_TEXTUREACCESS_STREAMING
            self._textures[slot] = sdl2.SDL_CreateTexture(self._renderer, *kind, *size)
            if not self._textures[slot]:
                raise Trouble(
                    f"The graphics card has no room for the pictures ({error()}): use fewer, or a smaller ring."
                )
            sdl2.SDL_SetTextureBlendMode(self._textures[slot], sdl2.SDL_BLENDMODE_NONE)
        if sdl2.SDL_UpdateTexture(self._textures[slot], None, address, 4 * self._width):
            raise Trouble(f"The picture cannot be drawn ({error()}): update the graphics driver.")

    def choose(self, slot: int) -> None:
        """The slot to present from now on."""
        self._shown = slot

    def present(self) -> None:
        """Draw what is chosen, black at first."""
        sdl2.SDL_RenderClear(self._renderer)
        if self._shown is not None:
            sdl2.SDL_RenderCopy(self._renderer, self._textures[self._shown], None, None)
        sdl2.SDL_RenderPresent(self._renderer)

    def closed(self) -> str:
        """Why the window is to be closed, if it is."""
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
    """What SDL says went wrong."""
    return sdl2.SDL_GetError().decode("utf-8", "replace") or "no reason given"


def play(wanted: dict) -> None:
    """Show what is ordered, each picture for the same number of refreshes."""
    size = 4 * wanted["width"] * wanted["height"]
    with open(wanted["ring"], "r+b") as file:
        ring = mmap.mmap(file.fileno(), 0)
    begin = ctypes.addressof(ctypes.c_char.from_buffer(ring))
    window, orders = Window(wanted), Orders()
    refresh = Refresh(window.present, wanted["refresh"], window.may_wait)
    # whole refreshes, never faster than asked, but for what clocks differ (and what a busy computer measures of them)
    hold = max(1, math.ceil(wanted["refresh"] / wanted["rate"] - 0.05)) if wanted["rate"] else 1
    tell(event="ready", rate=refresh.rate / hold, waits=refresh.waits, renderer=window.renderer)
    versions, due, waited = {}, None, 0  # refresh at which the next picture is to appear, and until the first
    while not orders.quit:
        why = window.closed()
        if why:
            tell(event=why)
            return
        if due is None:  # time begins with the first picture, when some more lie ready or do not come
            waited = waited + 1 if orders.shows else 0
            if not (len(orders.shows) >= READY or waited > refresh.rate * PATIENCE or orders.ended):
                refresh.next()
                continue
            due = refresh.count + 1
        if refresh.count + 1 >= due:
            while len(orders.shows) > 1 and due + hold <= refresh.count + 1:  # its time is over
                slot, version, number = orders.shows.popleft()
                tell(event="dropped", number=number)
                due += hold
            if orders.shows:
                slot, version, number = orders.shows.popleft()
                if versions.get(slot) != version:
                    window.load(slot, begin + slot * size)
                    versions[slot] = version
                window.choose(slot)
                refresh.next()
                tell(event="late" if refresh.count > due else "shown", number=number)
                due += hold
                continue
            if orders.ended:
                tell(event="end")
                return
        refresh.next()


def main(words: Sequence[str]) -> None:
    global sdl2
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program that started this one
    request = None if words[0] == "--list" else json.loads(words[0])
    sys.path[:0] = words[1:]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PySDL2 says which SDL it has found
        import sdl2 as module
    sdl2 = module
    for name, value in HINTS.items():
        sdl2.SDL_SetHint(name, value)
    if sdl2.SDL_Init(sdl2.SDL_INIT_VIDEO) or sdl2.SDL_GetCurrentVideoDriver() in IN_MEMORY:
        raise Trouble(f"There is no screen that can be used ({error()}): log in at a desktop.")
    if request is None:
        tell(monitors=monitors())
    else:
        play(request)
    sdl2.SDL_Quit()


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except Trouble as trouble:
        tell(event="trouble", text=str(trouble))
        sys.exit(1)
