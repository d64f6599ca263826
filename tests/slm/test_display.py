"""The display driver on two virtual monitors: what stands on the second is what was sent, and only there."""

import ctypes
import ctypes.util
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import mss
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.errors import InvalidInput
from holopath_addon.slm import (
    Calibration,
    DeviceLost,
    DisplayDriver,
    Monitor,
    Picture,
    Sequence,
    monitors,
    stream,
)
from holopath_addon.slm.drivers import display, display_window
from holopath_addon.slm.drivers.display import choose
from holopath_addon.slm.drivers.display_window import Refresh
from tests.monitors import FIRST, SECOND
from tests.patience import NEVER, SOON

WIDTH, HEIGHT = 1920, 1080
ROOT = Path(__file__).parents[2]
# what a crash of the window's process loses is shown again by the next
PATIENCE = SOON


def pictures(count, seed=0):
    """Random levels: gray, and red, green and blue in turn."""
    chance = np.random.default_rng(seed)
    shapes = [(HEIGHT, WIDTH), (HEIGHT, WIDTH, 3)]
    return [Picture(chance.integers(0, 256, shapes[n % 2], np.uint8), n, ((0, 0),)) for n in range(count)]


def small():
    """A hologram of five frames."""
    volume = engine.Hologram(64, 64, 8e-6, (520e-9,))
    data = np.random.default_rng(2).uniform(0, 6, (5, 1, 64, 64)).astype(np.float32)
    return engine.PhaseHologram(data, volume, engine.Camera(np.eye(4), 0.7), 0.5, "dpac", (1,))


def screenshot(left, top=0, width=WIDTH, height=HEIGHT):
    with mss.MSS() as screen:
        grabbed = screen.grab({"left": left, "top": top, "width": width, "height": height})
    return np.asarray(grabbed)[..., 2::-1]


class Reports:
    """Takes in what a driver tells."""

    def __init__(self):
        self.what = {}

    def __call__(self, number, what):
        self.what[number] = what

    def wait(self, number):
        end = time.monotonic() + SOON
        while number not in self.what:
            assert time.monotonic() < end
            time.sleep(0.005)
        time.sleep(0.1)  # the X server may draw after the window says so


def show(driver, number, picture):
    """Show a picture as the streamer does."""
    while driver.show(number, picture) is False:
        pass


def finish(driver):
    while driver.close(finish=True) is False:
        pass


def window_of(driver):
    return driver._window._process.pid


def test_monitors(two_monitors):
    first, second = monitors()
    assert (first.name, first.geometry, first.primary) == (FIRST, "1920x1080+0+0", True)
    assert (second.name, second.geometry, second.primary) == (SECOND, "1920x1080+1920+0", False)
    assert second.refresh == 60


LEFT = Monitor("A", 0, 0, 1920, 1080, 60.0, True)
RIGHT = Monitor("B", 1920, 0, 1920, 1080, 60.0, False)
SMALL = Monitor("C", 3840, 0, 800, 600, 60.0, False)
TWIN = Monitor("B", 3840, -200, 1920, 1080, 60.0, False)


def test_choose():
    assert choose([LEFT, RIGHT]) is RIGHT
    assert choose([LEFT, RIGHT, SMALL], size=(1920, 1080)) is RIGHT
    assert choose([LEFT, RIGHT, SMALL], "C") is SMALL
    assert choose([LEFT, RIGHT, TWIN], "1920x1080+3840-200") is TWIN
    assert choose([LEFT, RIGHT, TWIN], "B 1920x1080+1920+0") is RIGHT
    assert choose([LEFT, RIGHT], "A", primary=True) is LEFT
    assert choose([LEFT], primary=True) is LEFT


@pytest.mark.parametrize(
    "found, target, message",
    [
        ([LEFT, RIGHT], "A", "the primary monitor, where you work"),
        ([LEFT], None, "no monitor for the SLM"),
        ([], None, "no monitor"),
        ([LEFT, RIGHT], "Z", "no monitor 'Z'"),
        ([LEFT, RIGHT, TWIN], "B", "several monitors 'B'"),
        ([LEFT, RIGHT, SMALL], None, "several monitors for the SLM"),
    ],
)
def test_no_choice(found, target, message):
    with pytest.raises(InvalidInput, match=message) as error:
        choose(found, target)
    assert all(str(monitor) in str(error.value) for monitor in found)


def test_primary_is_refused(two_monitors):
    with pytest.raises(InvalidInput, match="primary"):
        DisplayDriver(FIRST).open(None, print)


@pytest.mark.parametrize("renderer", [None, pytest.param("software", marks=pytest.mark.slow)])
def test_every_pixel(two_monitors, monkeypatch, renderer):
    """Screenshots of the second monitor are what was sent; the first one stays as it was."""
    before = screenshot(0)
    if renderer:
        monkeypatch.setenv("SDL_RENDER_DRIVER", renderer)
    driver, reports = DisplayDriver(), Reports()
    driver.open(60, reports)
    assert renderer is None or f"({renderer})" in driver.info.note
    try:
        assert (driver.info.name, driver.info.width, driver.info.height) == (SECOND, WIDTH, HEIGHT)
        assert not screenshot(WIDTH).any()
        sent = pictures(4)
        for number, which in enumerate((0, 1, 2, 0, 3)):  # one of them again
            show(driver, number, sent[which])
            reports.wait(number)
            pixels = sent[which].pixels
            np.testing.assert_array_equal(
                screenshot(WIDTH), pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, 2)
            )
        assert (screenshot(0) == before).all()
    finally:
        driver.close()
    assert not (screenshot(WIDTH) == sent[3].pixels).all(), "the window is still there"


def test_a_hologram(two_monitors):
    """A packed sequence smaller than the monitor is shown in its center; the last picture stays."""
    volume = engine.Hologram(640, 480, 8e-6, (640e-9, 520e-9, 450e-9))
    data = np.random.default_rng(1).uniform(0, 2 * np.pi, (2, 3, 480, 640)).astype(np.float32)
    hologram = engine.PhaseHologram(data, volume, engine.Camera(np.eye(4), 0.7), 0.5, "dpac", (1, 1, 1))
    taken = []

    def look(counts):
        if counts.shown >= 5 and not taken:
            taken.append(screenshot(WIDTH))
            raise engine.Cancelled

    driver = DisplayDriver()
    with pytest.raises(engine.Cancelled):
        stream(Sequence([hologram], Calibration(flip_x=True), "color", "BGR"), driver, 10, None, look)
    levels = np.round(data * (256 / (2 * np.pi))).astype(int) % 256
    expected = np.zeros((2, HEIGHT, WIDTH, 3), int)
    # the first wavelength in blue, as the order says
    expected[:, 300:780, 640:1280] = np.moveaxis(levels[:, ::-1, :, ::-1], 1, -1)
    assert any((taken[0] == frame).all() for frame in expected)


def test_sixty_a_second(two_monitors):
    """The schedule is kept, whatever comes late or is left out: `python -m benchmarks slm` says how many do."""
    driver, reports = DisplayDriver(), Reports()
    driver.open(60, reports)
    sent = pictures(6)
    start = time.monotonic()
    for number in range(60):
        show(driver, number, sent[number % len(sent)])
    finish(driver)
    assert 0.9 < time.monotonic() - start < SOON
    assert sorted(reports.what) == list(range(60))
    assert Counter(reports.what.values())["dropped"] < 60  # how many are in time is the machine's doing


class Clock:
    """Time that passes while a presentation waits for the monitor, or a program sleeps."""

    def __init__(self, rate):
        self.now, self.rate, self.waits, self.queued = 100.0, rate, True, 0

    def perf_counter(self):
        return self.now

    def sleep(self, seconds):
        self.now += max(seconds, 1e-5)

    def present(self):
        if not self.waits:
            self.now += 1e-4
        elif self.queued:  # a graphics card takes them at once
            self.queued -= 1
        else:
            self.now = (int(self.now * self.rate + 1e-6) + 1) / self.rate


def test_a_monitor_that_stops_waiting(monkeypatch, capsys):
    """Behind a lock screen presentations return at once: the window goes on by the clock."""
    clock = Clock(60.0)
    monkeypatch.setattr(display_window, "time", clock)
    refresh = Refresh(clock.present, 60.0, True)
    for _ in range(100):
        refresh.next()
    clock.now += 0.1  # six refreshes late, after which the card's queue is empty
    clock.queued = 3
    for _ in range(100):
        refresh.next()
    assert refresh.waits and capsys.readouterr().out == ""
    start, first, clock.waits = clock.now, refresh.count, False
    for _ in range(300):
        refresh.next()
    assert clock.now - start == pytest.approx((refresh.count - first) / 60, abs=5 / 60)
    assert not refresh.waits and capsys.readouterr().out == '{"event": "clock"}\n'


def test_the_parent_of_a_window_that_stops_waiting():
    window = object.__new__(display._Window)
    window._geometry = "1920x1080+0+0"
    window._receive({"event": "ready", "rate": 60.0, "waits": True, "renderer": "opengl"})
    assert window.note == "1920x1080+0+0, 60 pictures a second, in step with the monitor (opengl)"
    window._receive({"event": "clock"})
    assert "by the clock" in window.note


@pytest.mark.parametrize(
    ("nominal", "rate", "waits"),
    [(60, 59.94, True), (29, 29.97, True), (23, 23.976, True), (60, 62, False), (144, 60, False)],
)
def test_rates_that_the_system_rounds(nominal, rate, waits, monkeypatch):
    clock = Clock(rate)
    monkeypatch.setattr(display_window, "time", clock)
    refresh = Refresh(clock.present, float(nominal), True)
    assert refresh.waits == waits and refresh.rate == pytest.approx(rate if waits else nominal)


def test_rate_below_the_monitors(two_monitors):
    driver, reports = DisplayDriver(), Reports()
    driver.open(20, reports)
    assert driver.info.rate == pytest.approx(
        20, rel=0.05
    )  # whatever a busy machine measures of the monitor's
    start = time.monotonic()
    for number, picture in enumerate(pictures(10)):
        show(driver, number, picture)
    finish(driver)
    assert 0.4 < time.monotonic() - start < SOON  # at 60 a second it would take 0.17


def test_a_crash_of_the_window(two_monitors):
    """An error within two seconds; the streamer opens another and shows the rest, each once."""
    driver, reports, sent = DisplayDriver(), Reports(), pictures(4)
    driver.open(60, reports)
    show(driver, 0, sent[0])
    reports.wait(0)
    os.kill(window_of(driver), signal.SIGKILL)
    start = time.monotonic()
    with pytest.raises(DeviceLost, match="window has crashed"):
        for number in range(1, 1000):
            show(driver, number, sent[number % 4])
    assert time.monotonic() - start < SOON
    driver.close()

    class Fragile(DisplayDriver):
        shown = []

        def show(self, number, picture):
            if number == 20 and 20 not in self.shown:
                self.shown.append(number)
                os.kill(window_of(self), signal.SIGKILL)
                raise DeviceLost("Killed.")
            return super().show(number, picture)

    counts = stream(Sequence([small()]), Fragile(), 60, 8, patience=PATIENCE)
    assert counts.shown + counts.dropped == 40 and counts.reconnected == 1


def test_the_window_closes_with_its_program(two_monitors):
    """However that ends."""
    code = (
        "import os, sys; sys.path.insert(0, sys.argv[1])\n"
        "from holopath_addon.slm import DisplayDriver\n"
        "driver = DisplayDriver(); driver.open(60, print)\n"
        "print(driver._window._process.pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(ROOT)], capture_output=True, text=True, timeout=NEVER
    )
    window, end = int(done.stdout), time.monotonic() + SOON
    while Path(f"/proc/{window}").exists() and time.monotonic() < end:
        time.sleep(0.05)
    gone = not Path(f"/proc/{window}").exists() or "zombie" in Path(f"/proc/{window}/status").read_text()
    assert gone


def press_escape(display):
    """A key pressed on the keyboard of an X server, by its extension for tests."""
    server, test = (ctypes.CDLL(ctypes.util.find_library(name)) for name in ("X11", "Xtst"))
    server.XOpenDisplay.restype = ctypes.c_void_p
    server.XOpenDisplay.argtypes = [ctypes.c_char_p]
    for function in (server.XFlush, server.XCloseDisplay):
        function.argtypes = [ctypes.c_void_p]
    server.XKeysymToKeycode.argtypes = [ctypes.c_void_p, ctypes.c_ulong]
    test.XTestFakeKeyEvent.argtypes = [ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_ulong]
    connection = server.XOpenDisplay(display.encode())
    key = server.XKeysymToKeycode(connection, 0xFF1B)
    for down in (1, 0):
        test.XTestFakeKeyEvent(connection, key, down, 0)
    server.XFlush(connection)
    server.XCloseDisplay(connection)


@pytest.mark.skipif(not ctypes.util.find_library("Xtst"), reason="libxtst6 is not installed")
def test_the_users_escape(two_monitors):
    """Closes a window on the primary monitor for good, however patient the streamer is."""
    pressed = []

    def press(counts):
        if counts.shown > 20 and not pressed:
            press_escape(two_monitors)
            pressed.append(time.monotonic())
        assert not pressed or time.monotonic() < pressed[0] + SOON, "it is still shown"

    driver = DisplayDriver(FIRST, primary=True)
    with pytest.raises(engine.Cancelled, match="window was closed"):
        stream(Sequence([small()]), driver, 60, None, press, patience=1e9)
    assert pressed


@pytest.mark.parametrize("rate, loops", [(1e-3, None), (1e-3, 1), (60, None)])
def test_stopped_at_any_rate(two_monitors, rate, loops):
    """Cancellation acts at once: the next picture of 0.001 a second would come after a thousand seconds."""
    start = []

    def stop(counts):
        start.append(time.monotonic())
        if start[-1] > start[0] + 0.5:
            raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        stream(Sequence([small()]), DisplayDriver(), rate, loops, stop)
    assert time.monotonic() - start[-1] < SOON


def test_a_talkative_graphics_driver(two_monitors):
    """A window that writes a lot to standard error is not blocked."""
    driver, reports = DisplayDriver(), Reports()
    driver.open(60, reports)
    os.write(driver._window._errors.fileno(), b"warning: this card is old\n" * 10000)
    show(driver, 0, pictures(1)[0])
    reports.wait(0)
    driver.close()


def test_no_room_for_the_ring(monkeypatch, tmp_path):
    """Asked for before it is used: a program that writes where there is none would die."""
    request = []

    def full(file, size):
        request.append((Path(file.name) if isinstance(file.name, str) else file.name, size))
        raise OSError(28, "No space left on device")

    before = set(os.listdir("/dev/shm")) if Path("/dev/shm").exists() else set()
    monkeypatch.setattr(display, "_allocate", full)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(InvalidInput, match="no room"):
        display._allocate_ring(1 << 20)
    assert {size for _, size in request} == {64 << 20, 3 << 20}
    assert not list(tmp_path.iterdir()) and (not before or set(os.listdir("/dev/shm")) <= before)


def test_pictures_of_another_size(two_monitors):
    driver = DisplayDriver()
    driver.open(60, print)
    try:
        with pytest.raises(InvalidInput, match="1920 x 1080 .* 800 x 600"):
            show(driver, 0, Picture(np.zeros((600, 800), np.uint8), 0, ((0, 0),)))
        with pytest.raises(InvalidInput, match="16 bits"):
            show(driver, 0, Picture(np.zeros((HEIGHT, WIDTH), np.uint16), 0, ((0, 0),)))
    finally:
        driver.close()


def test_no_screen(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InvalidInput, match="Log in at a desktop"):
        monitors()
    with pytest.raises(InvalidInput, match="Log in at a desktop"):
        DisplayDriver().open(60, print)


def test_no_sdl(monkeypatch):
    import importlib.util

    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "sdl2" else find(name))
    with pytest.raises(InvalidInput, match="pip install pysdl2"):
        monitors()
