"""Streaming: every picture once and in time, what is counted, and how it goes on or ends."""

import math
import queue
import threading
import time

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.slm import Calibration, Counts, DeviceLost, Sequence, Stills, stream, streaming
from holopath_addon.slm.driver import DROPPED, LATE, SHOWN, Info
from tests.patience import NEVER, SOON


def made(pictures=5, packing="time", calibration=None):
    """A sequence whose pictures have their number as their level."""
    data = np.empty((pictures, 1, 2, 3), np.float32)
    data[:] = (np.arange(pictures) * (2 * math.pi / 256))[:, None, None, None]
    grid = engine.Hologram(3, 2, 8e-6, (516.5e-9,), depth_far=1e-3, depth_near=2e-3)
    hologram = engine.PhaseHologram(data, grid, engine.Camera(np.eye(4), 0.5), 0.5, "dpac", (1.0,))
    return Sequence([hologram], calibration or Calibration(), packing)


class Device:
    """Follows `Driver`, and notes what happens to it; `trouble(number)` may raise or wait before a picture."""

    clock = time

    def __init__(self, trouble=None, opening=None, **info):
        self.info = Info("test", **info)
        self.trouble, self.opening = trouble or (lambda number: None), opening or (lambda time: None)
        self.shown, self.times, self.rates, self.closed = [], [], [], []
        self.open_now = False

    def open(self, rate, reports):
        assert not self.open_now, "open twice"
        self.rates.append(rate)
        self.opening(len(self.rates))
        self.open_now, self.reports = True, reports

    def show(self, number, picture):
        assert self.open_now, "shown on a device that is closed"
        self.times.append(self.clock.monotonic())
        self.trouble(number)
        self.shown.append((number, int(picture.pixels.max())))

    def close(self, finish=False):
        self.open_now = False
        self.closed.append(finish)

    def in_order(self, count, of_one=5):
        """Assert that pictures 0 to `count` were shown, each once and the right one."""
        return self.shown == [(number, number % of_one) for number in range(count)]


def lost(*numbers):
    """Trouble: lost at each of these pictures, as often as it is named."""
    left = list(numbers)

    def trouble(number):
        if number in left:
            left.remove(number)
            raise DeviceLost(f"Gone at {number}: plug it in.")

    return trouble


def within(seconds=SOON):
    """Progress that ends what would last for ever."""
    end = time.monotonic() + seconds

    def progress(counts):
        if time.monotonic() > end:
            raise engine.Cancelled

    return progress


class Clock:
    """Time that passes only while somebody sleeps, so that a busy machine makes nothing late."""

    def __init__(self):
        self.now = 1.0

    def perf_counter(self):
        return self.now

    monotonic = perf_counter

    def sleep(self, seconds):
        self.now += max(seconds, 1e-4)
        time.sleep(1e-5)  # pictures are prepared by another thread


@pytest.fixture
def clock(monkeypatch):
    """The time of the streamer and of devices."""
    clock = Clock()
    monkeypatch.setattr(streaming, "time", clock)
    monkeypatch.setattr(Device, "clock", clock)
    return clock


@pytest.fixture
def at_once(monkeypatch):
    """Lost devices are tried again soon."""
    monkeypatch.setattr(streaming, "RETRY_INTERVAL", 0.02)


# In order


@pytest.mark.parametrize("loops", [1, 3])
def test_all_once_and_in_order(loops):
    device, reports = Device(), []
    counts = stream(made(), device, loops=loops, progress=lambda counts: reports.append(str(counts)))
    assert device.in_order(5 * loops) and device.closed == [True] and device.rates == [None]
    assert (counts.shown, counts.late, counts.dropped, counts.reconnected) == (5 * loops, 0, 0, 0)
    assert counts.total == 5 * loops and counts.lost == "" and counts.seconds > 0
    assert reports[-1] == str(counts)


def test_one_picture():
    device = Device()
    assert stream(made(1), device).shown == 1 and device.shown == [(0, 0)]


def test_what_counts_say():
    assert str(Counts()) == "0 shown, 0 late, 0 dropped"
    assert str(Counts(30, 2, 1, 1, 0.5)) == "30 shown, 60.0 a second, 2 late, 1 dropped, 1 reconnected"


# In time


def test_rate(clock):
    """Each picture at its time from the first one, though the device takes a third of the time for itself."""
    device = Device(lambda number: clock.sleep(0.003))
    counts = stream(made(), device, rate=100, loops=10)
    times = np.array(device.times)
    assert device.in_order(50) and device.rates == [100]
    assert np.diff(times).mean() == pytest.approx(0.01, rel=0.03)
    behind = times - times[0] - np.arange(50) * 0.01
    assert np.median(np.abs(behind)) < 2e-3 and behind.min() > -3e-3
    assert counts.seconds == pytest.approx(0.49, rel=0.1) and counts.dropped == 0


def test_without_a_rate_as_fast_as_it_takes_them(clock):
    device = Device(lambda number: clock.sleep(0.002))
    stream(made(), device, loops=20)
    assert device.times[-1] - device.times[0] == pytest.approx(99 * 0.002)


def test_slow_device_that_drops(clock):
    """The schedule is kept: what cannot be shown in time is left out, what is shown is the right one."""
    device = Device(lambda number: clock.sleep(0.023), drops=True)
    counts = stream(made(), device, rate=100, loops=10)
    # from the first picture on: before it, time passes while pictures are prepared
    assert clock.monotonic() - device.times[0] < 0.55  # all of them would take 1.15 s
    assert counts.shown + counts.dropped == counts.total == 50
    assert counts.shown == len(device.shown) and 10 < counts.dropped < 45
    numbers = [number for number, _ in device.shown]
    assert numbers == sorted(set(numbers)) and all(value == number % 5 for number, value in device.shown)
    behind = np.array(device.times) - device.times[0] - np.array(numbers) * 0.01
    assert behind.max() < 0.015  # none more than a picture's time late
    assert abs(counts.late - (behind > 0.005).sum()) <= 2


def test_slow_device_that_does_not_drop(clock):
    device = Device(lambda number: clock.sleep(0.008))
    counts = stream(made(), device, rate=200, loops=4)
    assert device.in_order(20) and counts.shown == 20 and counts.dropped == 0
    # 3 ms further behind with each
    assert 18 <= counts.late <= 20


def test_catches_up(clock):
    """Late once, on schedule again: the clock counts from the beginning."""
    device = Device(lambda number: clock.sleep(0.05 if number == 4 else 0))
    counts = stream(made(), device, rate=100, loops=4)
    assert device.in_order(20) and 3 <= counts.late <= 6
    behind = np.array(device.times) - device.times[0] - np.arange(20) * 0.01
    assert np.median(np.abs(behind[12:])) < 2e-3


def test_the_last_picture_has_its_time(clock):
    class Last(Device):
        def close(self, finish=False):
            super().close(finish)
            self.times.append(clock.monotonic())

    device = Last()
    stream(made(), device, rate=10)
    assert len(device.times) == 6 and np.diff(device.times) == pytest.approx(0.1, abs=0.005)


# Lost


@pytest.mark.parametrize("number", range(7))
def test_goes_on_with_the_first_that_was_not_shown(number, at_once):
    device, described = Device(lost(number)), []
    counts = stream(
        made(7),
        device,
        patience=SOON,
        progress=lambda counts: described.append((counts.lost, counts.reconnected)),
    )
    assert device.in_order(7, 7), device.shown
    assert (counts.shown, counts.reconnected, counts.lost) == (7, 1, "")
    assert device.closed == [False, True] and len(device.rates) == 2
    assert (f"Gone at {number}: plug it in.", 0) in described and described[-1] == ("", 1)


def test_lost_again_and_again(at_once):
    device = Device(lost(2, 2, 3, 9, 9, 9))
    counts = stream(made(), device, rate=500, loops=2, patience=SOON)
    assert device.in_order(10) and (counts.shown, counts.reconnected) == (10, 6)


def test_not_there_for_a_while(at_once):
    """Several attempts to open it."""

    def opening(time):
        if time in (2, 3, 4, 6):
            raise DeviceLost("Not there: plug it in.")

    device = Device(lost(3, 4), opening)
    counts = stream(made(), device, patience=SOON)
    assert device.in_order(5) and (counts.shown, counts.reconnected) == (5, 2) and len(device.rates) == 7


def test_never_there():
    """Patience is for a device that was lost."""

    def opening(time):
        raise DeviceLost("Not there: plug it in.")

    device = Device(opening=opening)
    with pytest.raises(DeviceLost, match="Not there"):
        stream(made(), device, patience=NEVER, progress=within())
    assert device.closed == [False] and len(device.rates) == 1


def test_the_time_away_is_no_reason_to_drop(at_once, clock):
    """The schedule of a device that drops starts again after a loss."""
    device = Device(lost(3), drops=True)
    counts = stream(made(), device, rate=200, loops=2, patience=SOON)
    assert device.in_order(10) and counts.dropped == 0


def test_lost_while_it_finishes(at_once):
    """Everything was shown: nothing is shown again."""

    class Late(Device):
        def close(self, finish=False):
            super().close(finish)
            if finish and self.closed.count(True) == 1:
                raise DeviceLost("Gone at the end: plug it in.")

    device = Late()
    assert stream(made(), device, patience=SOON).shown == 5 and device.in_order(5)


def test_without_patience():
    device = Device(lost(3))
    with pytest.raises(DeviceLost, match="Gone at 3"):
        stream(made(), device)
    assert device.in_order(3) and device.closed == [False]


def test_patience_over(clock):
    """The device stays away: given up when the patience is over, not much later."""

    def opening(time):
        if time > 1:
            raise DeviceLost("Still away: plug it in.")

    device = Device(lost(3), opening)
    with pytest.raises(DeviceLost, match="Still away"):
        stream(made(), device, patience=3)
    assert 3 <= clock.monotonic() - device.times[3] < 3 + 1.2 * streaming.RETRY_INTERVAL
    assert device.in_order(3) and not any(device.closed) and not device.open_now


def test_patience_with_a_device_that_opens_but_shows_nothing(clock):
    """It answers, but takes no picture: that is no coming back, and is given up too."""
    device = Device(lost(*[3] * 1000))
    with pytest.raises(DeviceLost, match="Gone at 3"):
        stream(made(), device, patience=3)
    assert len(device.times) < 20
    assert device.in_order(3) and not device.open_now


def test_patience_begins_anew_after_each_picture(clock):
    """A bad plug: away for a short while, often, for longer than the patience in all."""
    device = Device(lost(*range(5)))
    counts = stream(made(), device, patience=1.2)
    assert device.in_order(5) and counts.reconnected == 5 and counts.seconds > 2


# Stopped


@pytest.mark.parametrize("case", ["fast", "waiting", "slow device", "lost"])
def test_cancelled(case):
    def stop(counts):
        nonlocal request
        if time.monotonic() - start > 0.1:
            request = request or time.monotonic()
            raise engine.Cancelled

    def opening(time):
        if case == "lost" and time > 1:
            raise DeviceLost("Away: plug it in.")

    trouble = lost(3) if case == "lost" else lambda number: time.sleep(0.05 if case == "slow device" else 0)
    device, start, request = Device(trouble, opening), time.monotonic(), None
    with pytest.raises(engine.Cancelled):
        stream(
            made(),
            device,
            rate=1 / NEVER if case == "waiting" else None,
            loops=None,
            progress=stop,
            patience=NEVER,
        )
    assert time.monotonic() - start < SOON and request
    assert not device.open_now and device.closed and not any(device.closed)
    assert threading.active_count() < 20


def test_cancelled_while_pictures_are_prepared(monkeypatch):
    """Large ones take a while: it does not wait for those that no one will see."""
    sequence, make, begun = made(), Sequence.picture, []

    def picture(self, number):
        begun.append(number)
        time.sleep(0.4)
        return make(self, number)

    def stop(counts):
        if begun:
            raise engine.Cancelled

    monkeypatch.setattr(streaming, "PROGRESS_INTERVAL", 0.0)
    monkeypatch.setattr(Sequence, "picture", picture)
    device = Device()
    with pytest.raises(engine.Cancelled):
        stream(sequence, device, loops=None, progress=stop)
    assert len(begun) < streaming.QUEUE and not device.open_now


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, MemoryError])
def test_whatever_is_raised_closes_the_device(error):
    def trouble(number):
        if number == 2:
            raise error

    device = Device(trouble)
    with pytest.raises(error):
        stream(made(), device, patience=NEVER)
    assert device.in_order(2) and device.closed == [False]


def test_pictures_that_cannot_be_made(monkeypatch):
    """An error of the preparing thread arrives."""

    def fail(self, number):
        raise OSError("no disk")

    monkeypatch.setattr(Sequence, "picture", fail)
    device = Device()
    with pytest.raises(OSError, match="no disk"):
        stream(made(), device)
    assert device.shown == [] and device.closed == [False]


# Triggers


def test_a_trigger_for_each_picture():
    device, pulses = Device(), []
    stream(made(), device, loops=2, trigger=lambda number: pulses.append((number, len(device.shown))))
    assert pulses == [(number, number + 1) for number in range(10)]  # once it is shown


def test_no_trigger_for_what_is_dropped():
    device, pulses = Device(lambda number: time.sleep(0.023), drops=True), []
    counts = stream(made(), device, rate=100, loops=4, trigger=pulses.append)
    assert pulses == [number for number, _ in device.shown] and len(pulses) == counts.shown < 20


@pytest.mark.parametrize("number", [0, 3, 4])
@pytest.mark.parametrize("threaded", [False, True])
def test_a_trigger_that_raises_ends_it(number, threaded):
    """An error of the trigger ends the streaming, also at the last picture and in a thread of the device."""

    def trigger(now):
        pulses.append(now)
        if now == number:
            raise ValueError(f"no pulse {now}")

    device, pulses = Clockwork() if threaded else Device(), []
    with pytest.raises(ValueError, match=f"no pulse {number}"):
        stream(made(), device, trigger=trigger, patience=NEVER)
    assert pulses == list(range(number + 1)) and not device.open_now


def test_lost_in_a_trigger(at_once):
    """A device that gives the pulses itself may be lost then too: it goes on."""
    device, pulses, trouble = Device(), [], lost(2)

    def trigger(number):
        pulses.append(number)
        trouble(number)

    counts = stream(made(), device, trigger=trigger, patience=SOON, progress=within())
    assert device.in_order(5) and counts.shown == 5 and counts.reconnected == 1
    assert [n for n in pulses if n != 2] == [0, 1, 3, 4]


# What does not fit


@pytest.mark.parametrize(
    ("options", "info", "says"),
    [
        ({"packing": "color"}, {}, "one hologram at a time, not 3.*--packing time"),
        ({"packing": "bits", "calibration": Calibration(bits=1)}, {}, "not 24"),
        (
            {"packing": "slm-200", "calibration": Calibration(bits=10)},
            {},
            "not in the bits of red.*--packing time",
        ),
        ({"calibration": Calibration(bits=10)}, {"bits": 8}, "10 bits, test takes 8"),
        ({}, {"bits": 4}, "8 bits, test takes 4"),
        ({}, {"width": 2, "height": 2}, "3 x 2 pixels"),
        ({"calibration": Calibration(size=(5, 4))}, {"width": 6, "height": 4}, "5 x 4 pixels.* 6 x 4"),
        ({"calibration": Calibration(size=(2, 2))}, {}, "only 2 x 2"),
    ],
)
def test_refused_before_the_first(options, info, says):
    device = Device(**info)
    with pytest.raises(engine.InvalidInput, match=says):
        stream(made(**options), device, patience=NEVER)
    assert device.shown == [] and device.closed == [False]


def test_larger_device():
    """The pictures are made as large as it."""
    device = Device(width=7, height=6)
    sizes = []
    device.show = lambda number, picture: sizes.append(picture.pixels.shape)
    stream(made(), device)
    assert sizes == [(6, 7)] * 5


# Devices that keep time


class Clockwork(Device):
    """Shows in a thread of its own, each picture 3 ms after the last, and tells then; takes four ahead."""

    def __init__(self, *words, fates=None, **info):
        super().__init__(*words, rate=333.0, **info)
        self.fates = fates or {}
        self.view, self.max_waiting = [], 0

    def open(self, rate, reports):
        super().open(rate, reports)
        self.waiting, self.end = queue.Queue(4), threading.Event()
        self.thread = threading.Thread(target=self._run, args=(self.waiting, self.end, reports))
        self.thread.start()

    def show(self, number, picture):
        super().show(number, picture)
        self.waiting.put(number)
        self.max_waiting = max(self.max_waiting, self.waiting.qsize())

    def _run(self, waiting, end, reports):
        while not (end.is_set() and waiting.empty()):
            try:
                number = waiting.get(timeout=0.003)
            except queue.Empty:
                continue
            time.sleep(0.003)
            self.view.append(number)
            reports(number, self.fates.get(number, SHOWN))

    def close(self, finish=False):
        if self.open_now:
            while not finish and not self.waiting.empty():
                self.waiting.get()
            self.end.set()
            self.thread.join()
        super().close(finish)


def test_device_that_keeps_time():
    """The streamer neither waits nor counts: what the device tells is what was."""
    device, pulses, rate = Clockwork(fates={3: LATE, 4: DROPPED, 7: LATE}), [], 1 / SOON
    start = time.monotonic()
    counts = stream(made(), device, rate=rate, loops=4, trigger=pulses.append)
    assert time.monotonic() - start < SOON  # as much as each would take
    assert device.rates == [rate] and device.view == list(range(20)) and device.max_waiting > 1
    assert (counts.shown, counts.late, counts.dropped) == (19, 2, 1)
    assert pulses == [number for number in range(20) if number != 4]


def test_device_that_keeps_time_lost(at_once):
    """Pictures not shown are sent again and counted once, even if an old thread reports them late."""
    device, old = Clockwork(lost(9)), []
    counts = stream(
        made(), device, loops=4, patience=SOON, progress=lambda counts: old.append(device.reports(0, SHOWN))
    )
    assert device.view == sorted(device.view) and device.view == list(range(20))
    assert (counts.shown, counts.dropped, counts.reconnected) == (20, 0, 1) and old
    again = [number for number, _ in device.shown]
    assert again.count(8) == 2 and again[-1] == 19  # it had been taken, but not shown


@pytest.mark.parametrize("rate", [60.0, None])
def test_a_still_is_there_when_it_returns(rate):
    """A device that keeps time itself begins a moment later, and says so; others show it at once."""

    def later(number):
        if rate:
            threading.Timer(0.05, lambda: view.append(number) or device.reports(number, LATE)).start()
        else:
            view.append(number)

    view, device = [], Device(later, rate=rate, width=4, height=4)
    with Stills(device) as stills:
        for number in range(3):
            stills.show(np.full((2, 2), number, np.uint8), 8)
            assert view == list(range(number + 1))
    assert device.closed == [False] and device.shown == [(n, 128) for n in range(3)]  # with what is around


def test_a_still_in_the_bits_of_channels():
    """A checkerboard of half a turn surrounds a still; both holograms of a picture are the same."""
    pictures = []
    device = Device(width=4, height=4, bits=8, channels=3)
    device.show = lambda number, picture: pictures.append(picture)
    with Stills(device, "slm-200-120hz") as stills:
        stills.show(np.full((2, 2), 1023, np.uint16), 10)
        with pytest.raises(engine.InvalidInput, match="levels of 10 bits, got 8"):
            stills.show(np.zeros((2, 2), np.uint8), 8)
    (picture,) = pictures
    with (
        pytest.raises(engine.InvalidInput, match="not 2 in one picture. Use --packing time"),
        Stills(Device(), "slm-200-120hz") as stills,
    ):
        stills.show(np.full((2, 2), 1023, np.uint16), 10)
    assert picture.pixels[1, 1].tolist() == [0b11101110, 0b11101110, 255] and len(picture.parts) == 2
    assert picture.pixels[0, 1].tolist() == [0b10001000, 0, 0]  # 512


def test_a_still_that_never_comes(monkeypatch):
    monkeypatch.setattr(streaming, "STILL_TIMEOUT", 0.05)
    monkeypatch.setattr(streaming, "RETRY_INTERVAL", 0.02)
    device = Device(rate=60.0)
    with pytest.raises(DeviceLost, match="test does not report the picture"), Stills(device) as stills:
        stills.show(np.zeros((2, 2), np.uint8), 8)
    assert not device.open_now


def test_a_still_on_a_device_in_trouble(monkeypatch):
    """It is asked again and again, and its own words count."""
    monkeypatch.setattr(streaming, "RETRY_INTERVAL", 0.02)

    def closed(number):
        if len(device.times) > 1:
            raise engine.Cancelled("Stopped: the SLM's window was closed.")

    device = Device(closed, rate=60.0)
    with pytest.raises(engine.Cancelled, match="window was closed"), Stills(device) as stills:
        stills.show(np.zeros((2, 2), np.uint8), 8)
    assert not device.open_now
