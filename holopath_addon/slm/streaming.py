"""Shows a sequence on a device: in time, counting what came late, and going on after the device was lost."""

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
from .calibrating import placed
from .driver import DROPPED, LATE, SHOWN, Picture
from .errors import DeviceLost
from .packing import pack, packing_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Self

    import numpy as np

    from .driver import Driver
    from .sequence import Sequence

RING = 8  # pictures that are prepared ahead
TOLD = 0.1  # seconds between two reports of progress
STILL = 5.0  # seconds in which a still is shown
AGAIN = 0.5  # seconds between two attempts to open a lost device


class Stills:
    """Pictures on a device, each until the next: for a camera that looks at each. Opens it, and lets go of it.

    Parameters
    ----------
    driver : Driver
    packing : str
        How the device takes levels, see `packing_of`. Of several holograms in a picture all are the same.

    Raises
    ------
    InvalidInput
        If there is no such packing.
    """

    def __init__(self, driver: Driver, packing: str = "time") -> None:
        self._driver, self._numbers, self._told = driver, count(), SimpleQueue()
        self._packing, self._kind = packing, packing_of(packing)

    def __enter__(self) -> Self:
        try:
            self._driver.open(None, lambda *told: self._told.put(told))
        except BaseException:
            self._driver.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._driver.close()

    def show(self, levels: np.ndarray, bits: int) -> None:
        """Show levels; returns when the device says that it does.

        Parameters
        ----------
        levels : numpy.ndarray, uint8 or uint16, shape (y, x)
            In the middle of it, see `placed`.
        bits : int
            Of a level.

        Raises
        ------
        InvalidInput
            If they do not fit.
        DeviceLost
        Cancelled
            If the user closed its window.
        """
        number, info, kind = next(self._numbers), self._driver.info, self._kind
        _require_channels(info, self._packing)
        kind.require(bits)
        if info.bits and info.bits != bits and not kind.own_bits:
            raise InvalidInput(f"The levels have {bits} bits, {info.name} takes {info.bits}: give as many.")
        (rows, columns), (across, down) = levels.shape, kind.grid
        whole = placed(levels, (info.width // across or columns, info.height // down or rows), bits)
        picture = Picture(pack([whole] * kind.each, self._packing), number, ((0, 0),) * kind.each, bits)
        until = time.monotonic() + STILL
        while not self._shown(number, picture):
            if time.monotonic() > until:
                raise DeviceLost(
                    f"{info.name} does not say that it shows the picture: look at it, and try again."
                )

    def _shown(self, number, picture):
        """Show it once more, and listen for a while: a device in trouble says so when it is asked."""
        while self._driver.show(number, picture) is False:
            pass
        if self._driver.info.rate is None:
            return True
        # it keeps time itself: a window begins a moment after its first picture
        with suppress(Empty):
            while True:
                told, what = self._told.get(timeout=AGAIN)
                if told == number and what != DROPPED:
                    return True
        return False


@dataclass
class Counts:
    """What became of the pictures so far.

    Attributes
    ----------
    shown : int
        In time or late.
    late : int
        Of those shown, half a picture's time or more behind.
    dropped : int
        Left out, as their time had passed.
    reconnected : int
        Times that the device was lost and found again.
    seconds : float
        Since the first picture.
    total : int or None
        Pictures that are to be shown; None: until it is stopped.
    lost : str
        Why the device is lost just now, in a sentence; empty while it is there.
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
    """Takes in what a driver tells, from whatever thread."""

    counts: Counts
    trigger: Callable[[int], None] | None
    next: int = 0  # the first picture of which nothing was told
    done: int = 0  # and of which not all was done, its pulse too
    error: BaseException | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    def told(self, number, what):
        with self.lock:
            if number < self.next:
                return  # of an earlier connection
            self.next = number + 1
            self.counts.dropped += what == DROPPED
            self.counts.late += what == LATE
            self.counts.shown += what != DROPPED
            if what != DROPPED and self.trigger is not None and self.error is None:
                try:
                    self.trigger(number)
                except Exception as error:
                    self.error = error  # belongs to the streamer's thread
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
    """Show a sequence.

    Parameters
    ----------
    sequence : Sequence
    driver : Driver
    rate : float, optional
        Pictures a second. Default: as the device does best, or as fast as it takes them.
    loops : int or None
        Rounds; None: until it is stopped.
    progress : callable, optional
        ``progress(counts)``, some times a second; may raise `engine.Cancelled`, which ends it.
    trigger : callable, optional
        ``trigger(number)`` as each picture is shown, in any thread.
    patience : float
        Seconds to wait for a lost device to come back; then it goes on with the first picture that was not shown.

    Returns
    -------
    Counts

    Raises
    ------
    engine.InvalidInput
        If the pictures do not fit the device.
    DeviceLost
        If it is lost for longer than `patience`.
    """
    counts = Counts(total=None if loops is None else loops * len(sequence))
    tally = _Tally(counts, trigger)
    clock = _Clock(counts, progress)
    workers = ThreadPoolExecutor(1, "HoloPath pictures")
    try:
        while not _shown(sequence, driver, rate, tally, clock, workers, patience):
            pass
    finally:
        workers.shutdown(cancel_futures=True)
    clock.stop()
    return counts


def _shown(sequence, driver, rate, tally, clock, workers, patience):
    """Open the device, show what was not shown yet, close it; whether all was shown, or the device was lost."""
    counts = tally.counts
    try:
        driver.open(rate, tally.told)
        if counts.lost:
            counts.reconnected, counts.lost = counts.reconnected + 1, ""
        _show_all(sequence, driver, rate, tally, clock, workers)
        if tally.error is not None:
            raise tally.error
        return True
    except DeviceLost as error:
        driver.close()
        tally.error = None  # where it was the trigger's
        clock.lose(error, patience, tally.done)
        return False
    except BaseException:
        driver.close()
        raise


class _Clock:
    """When the streaming began, how long the device is lost, and when progress is to be told."""

    def __init__(self, counts, progress):
        self._counts, self._progress = counts, progress
        self._began: float | None = None
        self._lost: float | None = None
        self._next = 0  # picture at the last loss
        self._told = 0.0

    def begin(self):
        """The first picture is about to be shown, or the next one after the device was lost; the time."""
        now = time.perf_counter()
        self._began = self._began or now
        return now

    def tell(self, always=False):
        """Report progress, if it is time."""
        now = time.perf_counter()
        self._counts.seconds = now - self._began if self._began else 0.0
        if self._progress is not None and (always or now - self._told >= TOLD):
            self._told = now
            self._progress(self._counts)

    def stop(self):
        """The last picture was shown: too late to cancel."""
        with suppress(Cancelled):
            self.tell(always=True)

    def lose(self, error, patience, number):
        """Wait a little before the next attempt; raise the error where patience has ended, or it was never there."""
        now = time.perf_counter()
        if self._lost is None or number > self._next:
            self._lost, self._next = now, number
        if self._began is None or now - self._lost >= patience:
            raise error
        self._counts.lost = str(error)
        while time.perf_counter() - now < AGAIN:
            self.tell(always=True)
            time.sleep(0.05)


def _show_all(sequence, driver, rate, tally, clock, workers):
    """Show what was not shown yet, at a rate where the driver does not keep time itself."""
    info, total = driver.info, tally.counts.total
    _check_fits(sequence, info)
    period = 1 / rate if rate and info.rate is None else 0.0
    first = ahead = number = tally.next
    ring = deque()
    start = None
    while total is None or number < total:
        if tally.error is not None:
            raise tally.error
        while len(ring) < RING and (total is None or ahead < total):
            ring.append(workers.submit(sequence.picture, ahead))
            ahead += 1
        if start is None:
            while not ring[-1].done():  # one worker prepares them in order: all lie ready when time begins
                clock.tell()
                time.sleep(0.002)
            start = clock.begin()
        picture, behind = ring.popleft().result(), 0.0
        if period:
            due = start + (number - first) * period
            _wait(due, clock)
            behind = time.perf_counter() - due
        if info.drops and behind > period:
            tally.told(number, DROPPED)
        else:
            while driver.show(number, picture) is False:
                clock.tell()
            if info.rate is None:
                tally.told(number, LATE if behind > period / 2 else SHOWN)
        number += 1
        clock.tell()
    if period and start is not None:
        _wait(start + (number - first) * period, clock)  # the last one has its time, too
    while driver.close(finish=True) is False:
        clock.tell()


def _wait(due, clock):
    """Until a time, reporting progress meanwhile."""
    while (left := due - time.perf_counter()) > 0:
        clock.tell()
        # sleep may last a little too long: what is left is waited for awake
        time.sleep(min(left - 1e-3, 0.05) if left > 2e-3 else 0)


def _check_fits(sequence, info):
    """Make the pictures as large as the device, and refuse before the first what it cannot show."""
    _require_channels(info, sequence.packing)
    sequence.fit(info.width, info.height, info.bits, info.name)


def _require_channels(info, packing):
    """Refuse pictures in color for a device that takes levels alone."""
    if info.channels > 1 or packing == "time":
        return
    each = packing_of(packing).each
    raise InvalidInput(
        f"{info.name} takes one hologram at a time, not {each} in one picture: use --packing time."
        if each > 1
        else f"{info.name} takes levels as numbers, not in the bits of red, green and blue: use --packing time."
    )
