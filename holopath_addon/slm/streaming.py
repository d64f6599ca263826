"""Streaming of a sequence to a device: in time, with counts of late pictures, and across losses of the device."""

from __future__ import annotations

import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

from ..engine.errors import Cancelled, InvalidInput
from .calibrating import place_in_center
from .driver import DROPPED, LATE, SHOWN, Picture
from .errors import DeviceLost
from .packing import pack, packing_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Self

    import numpy as np

    from .driver import Driver
    from .sequence import Sequence

QUEUE = 8  # pictures that are prepared ahead
PROGRESS_INTERVAL = 0.1  # seconds
STILL_TIMEOUT = 5.0  # seconds in which a device must show a still
RETRY_INTERVAL = 0.5  # seconds between attempts to open a lost device


class Stills:
    """Context manager of a device that shows single pictures, each until the next, for a camera.

    Parameters
    ----------
    driver : Driver
        Opened on entry and closed on exit.
    packing : str
        Packing of the device's pictures, see `packing_of`. Several holograms in a picture are all the same.
    light : int
        Index of the light source that a controller switches on.

    Raises
    ------
    InvalidInput
        If there is no such packing.
    """

    def __init__(self, driver: Driver, packing: str = "time", light: int = 0) -> None:
        self._driver, self._numbers, self._reports = driver, count(), SimpleQueue()
        self._light = light
        self._packing, self._kind = packing, packing_of(packing)

    def __enter__(self) -> Self:
        try:
            self._driver.open(None, lambda *report: self._reports.put(report))
        except BaseException:
            self._driver.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._driver.close()

    def show(self, levels: np.ndarray, bits: int) -> None:
        """Show levels, and return when the device reports them as shown.

        Parameters
        ----------
        levels : numpy.ndarray, uint8 or uint16, shape (y, x)
            Levels for the center of the device, see `place_in_center`.
        bits : int
            Bits of a level.

        Raises
        ------
        InvalidInput
            If the levels do not fit the device.
        DeviceLost
        Cancelled
            If the user closed the device's window.
        """
        number, info, kind = next(self._numbers), self._driver.info, self._kind
        _require_channels(info, self._packing)
        kind.require(bits)
        if info.bits and info.bits != bits and not kind.own_bits:
            raise InvalidInput(f"Expected levels of {info.bits} bits for {info.name}, got {bits}.")
        (rows, columns), (across, down) = levels.shape, kind.grid
        whole = place_in_center(levels, (info.width // across or columns, info.height // down or rows), bits)
        picture = Picture(
            pack([whole] * kind.each, self._packing), number, ((0, self._light),) * kind.each, bits
        )
        until = time.monotonic() + STILL_TIMEOUT
        while not self._send(number, picture):
            if time.monotonic() > until:
                raise DeviceLost(
                    f"{info.name} does not report the picture as shown. Check the device, and try again."
                )

    def _send(self, number, picture):
        """Send a picture and wait for its report a moment; whether it came. A device in trouble raises when called."""
        while self._driver.show(number, picture) is False:
            pass
        if self._driver.info.rate is None:
            return True
        # such a device keeps time itself: a window starts a moment after its first picture
        with suppress(Empty):
            while True:
                reported, outcome = self._reports.get(timeout=RETRY_INTERVAL)
                if reported == number and outcome != DROPPED:
                    return True
        return False


@dataclass
class Counts:
    """Counts of pictures by their outcome so far.

    Attributes
    ----------
    shown : int
        Pictures shown in time or late.
    late : int
        Shown pictures that were half a period or more behind.
    dropped : int
        Pictures that were skipped, as their time had passed.
    reconnected : int
        Number of times that the device was lost and found again.
    seconds : float
        Seconds since the first picture.
    total : int or None
        Number of pictures to show; None until it is stopped.
    lost : str
        Why the device is lost at the moment; empty while it is there.
    """

    shown: int = 0
    late: int = 0
    dropped: int = 0
    reconnected: int = 0
    seconds: float = 0.0
    total: int | None = None
    lost: str = ""

    def __str__(self) -> str:
        rate = f", {self.shown / self.seconds:.1f} a second" if self.seconds > 0 and self.shown > 1 else ""
        again = f", {self.reconnected} reconnected" if self.reconnected else ""
        return f"{self.shown} shown{rate}, {self.late} late, {self.dropped} dropped{again}"


@dataclass
class _Tally:
    """Record of a driver's reports, from any thread."""

    counts: Counts
    trigger: Callable[[int], None] | None
    next: int = 0  # the first picture without a report
    done: int = 0  # the first picture that is not complete, its pulse included
    error: BaseException | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    def report(self, number, outcome):
        with self.lock:
            if number < self.next:
                return  # from an earlier connection
            self.next = number + 1
            self.counts.dropped += outcome == DROPPED
            self.counts.late += outcome == LATE
            self.counts.shown += outcome != DROPPED
            if outcome != DROPPED and self.trigger is not None and self.error is None:
                try:
                    self.trigger(number)
                except Exception as error:
                    self.error = error  # the streamer's thread raises it
            if self.error is None:
                self.done = self.next


def stream(
    sequence: Sequence,
    driver: Driver,
    rate: float | None = None,
    loops: int | None = 1,
    progress: Callable[[Counts], None] | None = None,
    trigger: Callable[[int], None] | None = None,
    patience: float = 0.0,
) -> Counts:
    """Show a sequence on a device.

    Parameters
    ----------
    sequence : Sequence
    driver : Driver
    rate : float, optional
        Pictures per second. Default: the device's own rate, or as fast as it takes them.
    loops : int or None
        Number of rounds; None until it is stopped.
    progress : callable, optional
        ``progress(counts)``, several times a second; may raise `engine.Cancelled`, which ends the streaming.
    trigger : callable, optional
        ``trigger(number)`` as each picture is shown, in any thread.
    patience : float
        Seconds to wait for a lost device, before going on with the first picture that was not shown.

    Returns
    -------
    Counts

    Raises
    ------
    engine.InvalidInput
        If the pictures do not fit the device.
    DeviceLost
        If the device is lost for longer than `patience`.
    """
    counts = Counts(total=None if loops is None else loops * len(sequence))
    tally = _Tally(counts, trigger)
    clock = _Clock(counts, progress)
    workers = ThreadPoolExecutor(1, "HoloPath pictures")
    try:
        while not _run(sequence, driver, rate, tally, clock, workers, patience):
            pass
    finally:
        workers.shutdown(cancel_futures=True)
    clock.stop()
    return counts


def _run(sequence, driver, rate, tally, clock, workers, patience):
    """Open the device, show the remaining pictures, close it; False where the device was lost."""
    counts = tally.counts
    try:
        driver.open(rate, tally.report)
        if counts.lost:
            counts.reconnected, counts.lost = counts.reconnected + 1, ""
        _show_all(sequence, driver, rate, tally, clock, workers)
        if tally.error is not None:
            raise tally.error
        return True
    except DeviceLost as error:
        driver.close()
        tally.error = None  # it may be the trigger's
        clock.lose(error, patience, tally.done)
        return False
    except BaseException:
        driver.close()
        raise


class _Clock:
    """Clock of the streaming: its start, the time of a loss, and the time of the next progress."""

    def __init__(self, counts, progress):
        self._counts, self._progress = counts, progress
        self._start: float | None = None
        self._lost_at: float | None = None
        self._lost_picture = 0
        self._reported_at = 0.0

    def begin(self):
        """Start the clock at the first picture; the time now."""
        now = time.perf_counter()
        self._start = self._start or now
        return now

    def report(self, always=False):
        """Report progress, if it is due."""
        now = time.perf_counter()
        self._counts.seconds = now - self._start if self._start else 0.0
        if self._progress is not None and (always or now - self._reported_at >= PROGRESS_INTERVAL):
            self._reported_at = now
            self._progress(self._counts)

    def stop(self):
        """Report the end, which cannot be canceled any more."""
        with suppress(Cancelled):
            self.report(always=True)

    def lose(self, error, patience, number):
        """Wait before the next attempt; raise the error where patience is over, or the device was never there."""
        now = time.perf_counter()
        if self._lost_at is None or number > self._lost_picture:
            self._lost_at, self._lost_picture = now, number
        if self._start is None or now - self._lost_at >= patience:
            raise error
        self._counts.lost = str(error)
        while time.perf_counter() - now < RETRY_INTERVAL:
            self.report(always=True)
            time.sleep(0.05)


def _show_all(sequence, driver, rate, tally, clock, workers):
    """Show the remaining pictures, at a rate unless the device keeps time itself."""
    info, total = driver.info, tally.counts.total
    _check_fits(sequence, info)
    period = 1 / rate if rate and info.rate is None else 0.0
    first = ahead = number = tally.next
    queue = deque()
    start = None
    while total is None or number < total:
        if tally.error is not None:
            raise tally.error
        while len(queue) < QUEUE and (total is None or ahead < total):
            queue.append(workers.submit(sequence.picture, ahead))
            ahead += 1
        if start is None:
            while not queue[
                -1
            ].done():  # one worker prepares them in order: all are ready when the clock starts
                clock.report()
                time.sleep(0.002)
            start = clock.begin()
        picture, behind = queue.popleft().result(), 0.0
        if period:
            due = start + (number - first) * period
            _wait(due, clock)
            behind = time.perf_counter() - due
        if info.drops and behind > period:
            tally.report(number, DROPPED)
        else:
            while driver.show(number, picture) is False:
                clock.report()
            if info.rate is None:
                tally.report(number, LATE if behind > period / 2 else SHOWN)
        number += 1
        clock.report()
    if period and start is not None:
        _wait(start + (number - first) * period, clock)  # the last picture lasts as long as the others
    while driver.close(finish=True) is False:
        clock.report()


def _wait(due, clock):
    """Wait until a time, and report progress meanwhile."""
    while (seconds := due - time.perf_counter()) > 0:
        clock.report()
        # sleep may last too long: poll the last two milliseconds
        time.sleep(min(seconds - 1e-3, 0.05) if seconds > 2e-3 else 0)


def _check_fits(sequence, info):
    """Adapt the pictures to the device, or refuse them before the first is shown."""
    _require_channels(info, sequence.packing)
    sequence.fit(info.width, info.height, info.bits, info.name)


def _require_channels(info, packing):
    """Refuse pictures in color for a device that takes only levels."""
    if info.channels > 1 or packing == "time":
        return
    each = packing_of(packing).each
    raise InvalidInput(
        f"{info.name} takes one hologram at a time, not {each} in one picture. Use --packing time."
        if each > 1
        else f"{info.name} takes levels as numbers, not in the bits of red, green and blue. Use --packing time."
    )
