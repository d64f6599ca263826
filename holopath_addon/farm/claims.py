"""Who makes what: claims on pieces of work, as files in the folder that all processes share.

A claim is a file that only one process can make (``O_EXCL``, which network file systems keep, too). No locks, and no
clocks of different machines: the age of a claim is told by its file's time and that of a file touched now, which are
both the file server's. To take over what a killed process held, a process first claims the taking over of that very
claim, by the token in it, so that of two that find it at once one removes it, and never what has come in its place.
A process that was only slow may find its claim taken over: both then make the same, which does no harm.
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

from . import processes

FOLDER = ".claims"
BEAT = 15.0  # seconds from one touch of a claim to the next
STALE = 60.0  # seconds without one after which a process of another machine is taken for gone
WAIT = 0.1  # seconds from one look at what another process holds for moments to the next, at first
LONGEST_WAIT = 3.0  # and at most, so that a thousand who wait leave the server time for the one who is in
ENOUGH = 8  # living processes after which one that leaves lets others clear away what killed ones left
TRIES = 10


@dataclass(frozen=True)
class Claim:
    """What a claim tells of the process that holds it.

    Attributes
    ----------
    host : str
        Name of its machine.
    place, pid, started
        Which process it is, see `processes`.
    tag : str
        What it works for.
    token : str
        Unlike any other claim's.
    """

    host: str = "another machine"
    place: str = ""
    pid: int = 0
    started: str = ""
    tag: str = ""
    token: str = ""


class Claims:
    """Claims of this process in a folder, while the block runs.

    Parameters
    ----------
    folder : path
        Made if it does not exist.
    tag : str
        What this process works for: a digest of all that decides the results; empty where it only looks.

    Raises
    ------
    OSError
        On entering, and from `claim`, if the folder cannot be written to.
    """

    def __init__(self, folder: Path | str, tag: str) -> None:
        self._folder, self._tag = Path(folder) / FOLDER, tag
        self._held: dict[str, Claim] = {}  # by name
        self._alive: dict[str, tuple[Claim, float]] = {}  # others' by name, and until when they surely are
        self._here = f".{secrets.token_hex(8)}"  # this process's own claim, and the server's clock
        self._ended = threading.Event()
        self._heart = threading.Thread(target=self._beat, name="claims", daemon=True)

    def __enter__(self) -> Claims:
        try:
            while self._here not in self._held:
                self._folder.mkdir(parents=True, exist_ok=True)
                with suppress(FileNotFoundError):  # another process ended just now and took the folder along
                    self._make(self._here)
            self._heart.start()
        except BaseException:
            self._ended.set()
            self._leave()
            raise
        return self

    def __exit__(self, *_) -> None:
        with processes.uninterrupted():
            self._ended.set()
            self._heart.join()
            with suppress(OSError):
                self._clear()
            self._leave()

    @contextmanager
    def claim(self, name: str) -> Iterator[bool]:
        """Hold the claim on a piece of work while the block runs, if no other process does.

        Yields
        ------
        bool
            Whether this process holds it.
        """
        before = name in self._held
        try:
            yield self._claimed(name)
        finally:
            if not before and name in self._held:
                self._release(name)

    @contextmanager
    def wait(self, name: str) -> Iterator[None]:
        """Hold a claim that nobody holds for longer than moments."""
        pause = WAIT
        while True:
            with self.claim(name) as held:
                if held:
                    yield
                    return
            time.sleep(pause * random.uniform(0.5, 1.0))
            pause = min(1.5 * pause, LONGEST_WAIT)

    def names(self) -> list[str]:
        """Of all claims, living or not, by one look at the folder; a dot begins those on no piece of work.

        That it is touched has network file systems ask the server, and not tell what was there a minute ago.
        """
        os.utime(self._folder)
        return os.listdir(self._folder)

    def alive(self, name: str) -> bool:
        """Whether a claim's holder lives for all that `claim` found, told without a look at the folder."""
        claim, until = self._alive.get(name, (Claim(), 0.0))
        here = claim.place == processes.place()
        return time.monotonic() < until and not (here and processes.started(claim.pid) != claim.started)

    def lost(self, name: str) -> bool:
        """Whether another process has taken over a claim that this one holds."""
        found = self._read(name)
        return found is None or found[0] != self._held[name]

    def holder(self, name: str) -> Claim | None:
        """The living process that holds a claim; None where there is none."""
        found = self._read(name)
        return None if found is None or self._left(*found) < 0 else found[0]

    def holders(self) -> dict[str, Claim]:
        """Claims of all living processes by name; a dot begins names of those on no piece of work."""
        found = {name: self.holder(name) for name in sorted(os.listdir(self._folder))}
        return {name: claim for name, claim in found.items() if claim}

    def _claimed(self, name):
        for _ in range(2):
            if self._make(name):
                return True
            found = self._read(name)
            if found is None:
                continue  # released meanwhile
            left = self._left(*found)
            if left >= 0:
                self._alive[name] = found[0], time.monotonic() + left
                return False
            with self.claim(f".{name.lstrip('.')}.{found[0].token}") as mine:
                again = self._read(name)
                if mine and again is not None and again[0] == found[0]:
                    self._remove(name)
        return False

    def _make(self, name):
        """Whether there was no such claim before."""
        claim = Claim(
            processes.host(),
            processes.place(),
            os.getpid(),
            processes.started(os.getpid()),
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
            self._held[name] = claim
        return True

    def _clear(self):
        """Remove what killed processes left, as far as there are not many who do so after this one."""
        living, names = 0, [name for name in self.names() if name not in self._held]
        for name in random.sample(names, len(names)):
            with self.claim(name) as held:
                living += not held
            if living == ENOUGH:
                return

    def _leave(self):
        for name in list(self._held):
            self._release(name)
        with suppress(OSError):
            self._folder.rmdir()  # unless others work here

    def _release(self, name):
        with processes.uninterrupted():
            if not self.lost(name):
                self._remove(name)
            del self._held[name]

    def _remove(self, name):
        for _ in range(TRIES):
            try:
                (self._folder / name).unlink(missing_ok=True)
                return
            except OSError:  # Windows deletes nothing that another process reads just now
                time.sleep(WAIT / TRIES)

    def _read(self, name):
        """A claim and the server's time of its last touch, seconds; None where there is none.

        A claim is empty for the moment in which it is made. That it is opened has network file systems ask the server.
        """
        try:
            with open(self._folder / name) as stream:
                touched, text = os.fstat(stream.fileno()).st_mtime, stream.read()
        except OSError:
            return None
        try:
            return Claim(**json.loads(text)), touched
        except (ValueError, TypeError):
            return Claim(), touched

    def _left(self, claim, touched):
        """Seconds for which the process that holds a claim cannot be taken for gone; negative if it runs no more."""
        if claim.place == processes.place():
            return STALE if processes.started(claim.pid) == claim.started else -math.inf
        with suppress(OSError):
            os.utime(self._folder / self._here)
        now = self._read(self._here)
        return STALE if now is None else STALE - (now[1] - touched)

    def _beat(self):
        while not self._ended.wait(BEAT):
            for name in list(self._held):
                with suppress(OSError, KeyError):  # released meanwhile, or the server is away
                    if not self.lost(name):
                        os.utime(self._folder / name)
