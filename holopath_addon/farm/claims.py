"""Claims on units of work, as files in the folder that all processes share.

A claim is a file that only one process can create (``O_EXCL``, which network file systems respect, too). There are no
locks, and clocks of machines are not compared: the age of a claim is the difference between its file's time and that
of a file touched now, both by the file server's clock. To take over a dead process's claim, a process first claims
that takeover, by the token in the claim. So of two processes that find it at once, one removes it, and never a new
claim in its place. A slow process may lose its claim: then both make the same, which is harmless.
"""

from __future__ import annotations

import json
import math
import os
import random
import secrets
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from ..engine.files import is_of_browser
from . import processes

FOLDER = ".claims"
TOUCH_INTERVAL = 15.0  # seconds
STALE_AFTER = 60.0  # seconds without a touch, after which a process of another machine counts as dead
MIN_WAIT = 0.1  # first seconds between attempts to claim what another process holds for a moment
MAX_WAIT = (
    3.0  # last seconds between them, so that a thousand waiting processes do not block the one that holds it
)
ENOUGH_ALIVE = 8  # living processes, which clear away dead claims later
TRIES = 10


@dataclass(frozen=True)
class Claim:
    """Contents of a claim: the process that holds it.

    Attributes
    ----------
    host : str
        Name of its machine.
    place, pid, started
        Identity of the process, see `processes`.
    tag : str
        Tag of its job.
    token : str
        Unique token of the claim.
    """

    host: str = "another machine"
    place: str = ""
    pid: int = 0
    started: str = ""
    tag: str = ""
    token: str = ""


class Claims:
    """Context manager of this process's claims in a folder.

    Parameters
    ----------
    folder : path
        Created if it does not exist.
    tag : str
        Tag of the job: a digest of every input that affects the results; empty for a process that only looks.

    Raises
    ------
    OSError
        On entry, and from `claim`, if the folder cannot be written to.
    """

    def __init__(self, folder: Path | str, tag: str) -> None:
        self._folder, self._tag = Path(folder) / FOLDER, tag
        self._own: dict[str, Claim] = {}  # by name
        self._alive: dict[
            str, tuple[Claim, float]
        ] = {}  # others' claims by name, and until when they are alive
        self._here = (
            f".{secrets.token_hex(8)}"  # this process's own claim, which also reads the server's clock
        )
        self._stop = threading.Event()
        self._toucher = threading.Thread(target=self._touch, name="claims", daemon=True)

    def __enter__(self) -> Claims:
        try:
            while self._here not in self._own:
                self._folder.mkdir(parents=True, exist_ok=True)
                with suppress(FileNotFoundError):  # another process has just ended and removed the folder
                    self._make(self._here)
            self._toucher.start()
        except BaseException:
            self._stop.set()
            self._leave()
            raise
        return self

    def __exit__(self, *_) -> None:
        with processes.uninterrupted():
            self._stop.set()
            self._toucher.join()
            with suppress(OSError):
                self._clear()
            self._leave()

    @contextmanager
    def claim(self, name: str) -> Iterator[bool]:
        """Hold the claim on a unit within the block, if no other process holds it.

        Yields
        ------
        bool
            Whether this process holds it.
        """
        was_held = name in self._own
        try:
            yield self._try_claim(name)
        finally:
            if not was_held and name in self._own:
                self._release(name)

    @contextmanager
    def wait(self, name: str) -> Iterator[None]:
        """Hold a claim within the block, after waiting for other processes, which hold it for moments only."""
        pause = MIN_WAIT
        while True:
            with self.claim(name) as is_mine:
                if is_mine:
                    yield
                    return
            time.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(1.5 * pause, MAX_WAIT)

    def names(self) -> list[str]:
        """Names of all claims, alive or dead, by one listing of the folder; names with a dot are not units.

        Touching the folder makes network file systems ask the server instead of a cache.
        """
        os.utime(self._folder)
        return self._listed()

    def alive(self, name: str) -> bool:
        """Whether a claim's holder is alive as far as `claim` has found, without access to the folder."""
        claim, until = self._alive.get(name, (Claim(), 0.0))
        here = claim.place == processes.place()
        return time.monotonic() < until and not (here and processes.start_time(claim.pid) != claim.started)

    def is_lost(self, name: str) -> bool:
        """Whether another process has taken over a claim of this one."""
        content = self._read(name)
        return content is None or content[0] != self._own[name]

    def holder(self, name: str) -> Claim | None:
        """Claim of a living process; None without one."""
        content = self._read(name)
        return None if content is None or self._seconds_alive(*content) < 0 else content[0]

    def holders(self) -> dict[str, Claim]:
        """Claims of all living processes by name; names with a dot are not units."""
        claims = {name: self.holder(name) for name in sorted(self._listed())}
        return {name: claim for name, claim in claims.items() if claim}

    def _listed(self):
        return [name for name in os.listdir(self._folder) if not is_of_browser(name)]

    def _try_claim(self, name):
        for _ in range(2):
            if self._make(name):
                return True
            content = self._read(name)
            if content is None:
                continue  # released meanwhile
            seconds = self._seconds_alive(*content)
            if seconds >= 0:
                self._alive[name] = content[0], time.monotonic() + seconds
                return False
            with self.claim(f".{name.lstrip('.')}.{content[0].token}") as is_mine:
                again = self._read(name)
                if is_mine and again is not None and again[0] == content[0]:
                    self._remove(name)
        return False

    def _make(self, name):
        """Create a claim; False if it exists."""
        claim = Claim(
            processes.host(),
            processes.place(),
            os.getpid(),
            processes.start_time(os.getpid()),
            self._tag,
            secrets.token_hex(8),
        )
        with processes.uninterrupted():
            try:
                handle = os.open(self._folder / name, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
            except FileExistsError:
                return False
            try:
                with os.fdopen(handle, "w") as stream:
                    json.dump(asdict(claim), stream)
            except BaseException:
                self._remove(name)
                raise
            self._own[name] = claim
        return True

    def _clear(self):
        """Remove claims of dead processes, unless many living ones can do so later."""
        alive, names = 0, [name for name in self.names() if name not in self._own]
        for name in random.sample(names, len(names)):
            with self.claim(name) as is_mine:
                alive += not is_mine
            if alive == ENOUGH_ALIVE:
                return

    def _leave(self):
        for name in list(self._own):
            self._release(name)
        with suppress(OSError):
            self._folder.rmdir()  # unless others work here

    def _release(self, name):
        with processes.uninterrupted():
            if not self.is_lost(name):
                self._remove(name)
            del self._own[name]

    def _remove(self, name):
        for _ in range(TRIES):
            try:
                (self._folder / name).unlink(missing_ok=True)
                return
            except OSError:  # Windows does not delete a file that another process reads
                time.sleep(MIN_WAIT / TRIES)

    def _read(self, name):
        """Read a claim and the server's time of its last touch, seconds; None without a claim.

        A claim is empty at the moment of its creation. Opening it makes network file systems ask the server.
        """
        try:
            with open(self._folder / name, errors="replace") as stream:
                touch_time, text = os.fstat(stream.fileno()).st_mtime, stream.read()
        except OSError:
            return None
        try:
            return Claim(**json.loads(text)), touch_time
        except (ValueError, TypeError):
            return Claim(), touch_time

    def _seconds_alive(self, claim, touch_time):
        """Seconds until the holder of a claim may count as dead; negative if it is dead."""
        if claim.place == processes.place():
            return STALE_AFTER if processes.start_time(claim.pid) == claim.started else -math.inf
        with suppress(OSError):
            os.utime(self._folder / self._here)
        now = self._read(self._here)
        return STALE_AFTER if now is None else STALE_AFTER - (now[1] - touch_time)

    def _touch(self):
        while not self._stop.wait(TOUCH_INTERVAL):
            for name in list(self._own):
                with suppress(OSError, KeyError):  # released meanwhile, or the server is unavailable
                    if not self.is_lost(name):
                        os.utime(self._folder / name)
