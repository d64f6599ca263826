"""The computer's end of the serial line: everything sent arrives once and in order, or `DeviceLost` is raised.

Go-back-N: packets carry a sequence number, the device takes only the one it expects and reports which that is
(Tanenbaum, Computer Networks, 5th ed., section 3.4.2). The protocol is written down in docs/serial-protocol.md.
"""

from __future__ import annotations

import random
import time
import zlib
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..errors import DeviceLost
from . import packets
from .packets import Can, Kind

if TYPE_CHECKING:
    import numpy as np
    import serial

PATIENCE = 1.5  # seconds of silence after which a device is lost
START_PATIENCE = 5.0  # many controllers restart when their port is opened
STUCK = 20.0  # seconds in which a device that answers must take something
ANSWER = 256  # bytes of payload that a device may send
SHORTEST = 32  # bytes of payload, on a line that damages much
WINDOW = 16  # packets under way
ON_LINE = 0.05  # seconds at most that one packet takes
UNDER_WAY = 0.2  # and all that are under way
GONE = OSError, TypeError, ValueError  # pyserial raises the latter two on a port that is closed
SEQUENCES, SESSIONS = 1 << 16, 1 << 8


@dataclass
class Message:
    """What is to be sent: a head, and where it is a frame the pixels, which are cut into parts.

    Attributes
    ----------
    kind : Kind
    head : bytes
    body : memoryview
    sent, taken : int
        How many steps: the head is the first, each byte of the body another.
    """

    kind: Kind
    head: bytes
    body: memoryview = field(default_factory=lambda: memoryview(b""))
    sent: int = 0
    taken: int = 0

    def next(self, size: int) -> tuple[Kind, tuple, int]:
        """Kind, payload in pieces and the step after it, of at most `size` bytes."""
        if self.sent == 0:
            return self.kind, (self.head,), 1
        begin = self.sent - 1
        part = self.body[begin : begin + size - packets.PART.size]
        return Kind.PART, (packets.PART.pack(begin), part), self.sent + len(part)

    @property
    def steps(self) -> int:
        """All of them."""
        return 1 + len(self.body)


@dataclass
class _Flight:
    """A packet that is not reported as taken."""

    data: bytes
    message: Message
    step: int
    written: float
    tries: int = 1


@dataclass(frozen=True)
class Device:
    """What a device says of itself.

    Attributes
    ----------
    name : str
    width, height, bits : int
        0 where it takes no frames.
    can : Can
    """

    name: str
    width: int
    height: int
    bits: int
    can: Can


class Link:
    """A stream of messages to one device.

    Parameters
    ----------
    stream : int, optional
        Tells the device whether it knows this stream already. Default: at random.

    Attributes
    ----------
    device : Device or None
    frames : int
        Whole frames that the device has taken, as it last reported.
    triggers : int
    position : int
        Of the focus.
    moving : bool
    resent : int
        Packets that were sent once more.
    """

    def __init__(self, stream: int | None = None) -> None:
        self._stream = random.getrandbits(32) if stream is None else stream
        self._session = 0
        self._port: serial.Serial | None = None
        self._messages = deque()  # the first ones may be partly under way
        self._flight = deque()
        self._next = 0  # sequence of the next new packet
        self._expected = 0  # sequence of the first packet under way
        self._welcomed = self._continued = False
        self._longest, self._window, self._size = packets.LONGEST, 1, SHORTEST
        self._room = 0.0  # bytes that may be under way
        self._clean = 0
        self._trip = 0.0  # seconds from writing to the report, smoothed
        self._in_vain = 0  # times that was sent again since anything was taken
        self._heard = self._advanced = self._went_back = 0.0
        self.device = None
        self.frames = self.triggers = self.position = self.resent = 0
        self.moving = False

    def connect(self, port: serial.Serial, patience: float = START_PATIENCE) -> None:
        """Shake hands, and go on with what was not reported as taken.

        Parameters
        ----------
        port : serial.Serial
            Open, with short time-outs for reading and writing.
        patience : float
            Seconds to wait for the device's answer.

        Raises
        ------
        DeviceLost
            If there is none, or it speaks another version.
        """
        self._port, self._decoder = port, packets.Decoder(ANSWER)
        self._shake_hands(patience)

    def disconnect(self) -> None:
        """Let go of the port; what is under way is sent again after the next `connect`."""
        self._port = None

    def frame(self, number: int, pixels: np.ndarray, bits: int = 8, wavelength: int = 0) -> None:
        """Send a frame.

        Parameters
        ----------
        number : int
            Counts up by one for every frame of the stream.
        pixels : numpy.ndarray, shape (y, x), integers
        bits : int
            Of each pixel.
        wavelength : int
            Its index.
        """
        body = memoryview(pixels.tobytes())
        height, width = pixels.shape
        head = packets.FRAME.pack(number, width, height, bits, wavelength, len(body), zlib.crc32(body))
        self._send(Message(Kind.FRAME, head, body))

    def trigger(self, number: int, microseconds: int) -> None:
        """Have the device give a pulse."""
        self._send(Message(Kind.TRIGGER, packets.TRIGGER.pack(number, microseconds)))

    def focus(self, position: int) -> None:
        """Have the focus moved; returns when the device knows of it, see `moving`."""
        self._send(Message(Kind.FOCUS, packets.FOCUS.pack(position)))
        self.finish()

    def forget(self, kind: Kind) -> None:
        """Messages of a kind that the device has not taken are not sent any more."""
        self._messages = deque(message for message in self._messages if message.kind != kind)

    def status(self) -> None:
        """Ask for a report and wait for it."""
        before = self._heard
        asked = 0.0

        def told():
            nonlocal asked
            if self._heard > before:
                return True
            if time.perf_counter() - asked > self._patience_of_one():
                asked = time.perf_counter()
                self._write(packets.encode(Kind.STATUS, self._session, 0))
            return False

        self._pump(told)

    def finish(self) -> None:
        """Wait until the device has taken everything."""
        self._pump(lambda: not self._messages)

    def _send(self, message):
        self._messages.append(message)
        # what was sent before may have been sent back to its beginning: all of it must be under way
        self._pump(lambda: self._messages[-1].sent == self._messages[-1].steps if self._messages else True)

    def _pump(self, done):
        """Write what the window takes and read what arrives, until `done()`."""
        self._require_port()
        waiting = time.perf_counter()
        while not done():
            wrote = self._write_more()
            self._read(wait=not wrote)
            now = time.perf_counter()
            if now - max(self._heard, waiting) > PATIENCE:
                raise DeviceLost(
                    f"The device does not answer for {PATIENCE:g} s: check its cable and power, then go on."
                )
            if self._flight and now - max(self._advanced, waiting) > STUCK:
                raise DeviceLost(
                    f"The device answers, but takes nothing for {STUCK:g} s: restart it, then go on."
                )
            if self._flight and now - self._flight[0].written > self._patience_of_one():
                self._in_vain += 1
                self._go_back()

    def _patience_of_one(self):
        """Seconds after which a packet without report is sent again."""
        usual = max(0.005, 4 * self._trip) * 2 ** min(self._in_vain, 4)
        return min(usual, 0.2) + self._bytes_under_way() * 10 / self._require_port().baudrate

    def _bytes_under_way(self):
        return sum(len(packet.data) for packet in self._flight)

    def _write_more(self):
        """Write one more packet if the window has room; whether it had."""
        if len(self._flight) >= self._window or self._bytes_under_way() > self._room:
            return False
        message = next((m for m in self._messages if m.sent < m.steps), None)
        if message is None:
            return False
        kind, payload, step = message.next(self._size)
        data = packets.encode(kind, self._session, self._next, *payload)
        self._next = (self._next + 1) % SEQUENCES
        message.sent = step
        self._flight.append(_Flight(data, message, step, time.perf_counter()))
        self._write(data)
        return True

    def _go_back(self):
        """Something was lost: send again all that is under way, in smaller pieces where large ones do not pass."""
        self._size, self._clean = max(SHORTEST, self._size // 2), 0
        head = self._flight[0]
        if head.tries >= 2 and len(head.data) > 2 * (self._size + packets.OVERHEAD):
            self._shake_hands(PATIENCE)
            return
        self._went_back = time.perf_counter()
        for packet in self._flight:
            packet.tries += 1
            packet.written = time.perf_counter()
            self._write(packet.data)
        self.resent += len(self._flight)

    def _shake_hands(self, patience):
        """Begin a new session: packets of the last one that are still on the line mean nothing then."""
        # a device that has not answered may yet have heard of this one
        if self._welcomed or self._session == 0:
            self._session = (self._session + 1) % SESSIONS
        self._welcomed = False
        hello = packets.encode(
            Kind.HELLO, self._session, 0, packets.HELLO.pack(packets.VERSION, 0, self._stream)
        )
        end, asked = time.perf_counter() + patience, 0.0
        while not self._welcomed:
            now = time.perf_counter()
            if now > end:
                raise DeviceLost(
                    f"The device does not answer for {patience:g} s: check port, cable and power, and that its "
                    "firmware speaks HoloPath's protocol (docs/serial-protocol.md)."
                )
            if now - asked > 0.1:
                asked = now
                self._write(hello)
            self._read(wait=True)
        for message in self._messages:
            if not self._continued:
                message.taken = 0
            message.sent = message.taken
        self._trip = self._trip or time.perf_counter() - asked
        self._flight.clear()
        self._next = self._expected
        self._heard = self._advanced = time.perf_counter()

    def _read(self, wait):
        """Take in what has arrived."""
        port = self._require_port()
        try:
            data = port.read(port.in_waiting or 1) if wait or port.in_waiting else b""
        except GONE as error:
            raise DeviceLost(f"The device is gone ({error}): plug it in again, then go on.") from error
        for packet in self._decoder.feed(data) if data else ():
            if packet.session == self._session:
                self._take(packet)

    def _take(self, packet):
        payload = packet.payload
        if packet.kind == Kind.WELCOME and len(payload) >= packets.WELCOME.size:
            self._welcome(packets.WELCOME.unpack_from(payload), payload[packets.WELCOME.size :])
        elif packet.kind == Kind.REPORT and len(payload) == packets.REPORT.size and self._welcomed:
            expected, again, moving, self.frames, self.triggers, self.position = packets.REPORT.unpack(
                payload
            )
            self._heard, self.moving = time.perf_counter(), bool(moving)
            advanced = self._advance((expected - self._expected) % SEQUENCES)
            if again and not advanced and self._flight and time.perf_counter() - self._went_back > self._trip:
                self._go_back()

    def _welcome(self, said, name):
        version, goes_on, longest, window, expected, frames, position, width, height, bits, can = said
        if version != packets.VERSION:
            raise DeviceLost(
                f"The device speaks version {version} of the protocol, this HoloPath version {packets.VERSION}: "
                "update its firmware (docs/serial-protocol.md)."
            )
        if self._welcomed:
            return  # a second answer to a second question
        taken = (expected - self._expected) % SEQUENCES
        # a device that has restarted may have learnt the stream from an old HELLO, and says that it goes on
        self._welcomed, self._continued = True, bool(goes_on) and taken <= len(self._flight)
        if self._continued:
            self._advance(taken)
        else:
            self.triggers = 0
        self._expected = expected
        self.frames, self.position = frames, position
        self._longest = max(SHORTEST, min(longest, packets.LONGEST))
        self._window = max(1, min(window, WINDOW))
        if self.device is None:
            speed = self._require_port().baudrate / 10  # bytes a second
            self._size = max(SHORTEST, int(speed * ON_LINE))
            self._room = speed * UNDER_WAY
        self._size = min(self._size, self._longest)
        self.device = Device(name.decode("utf-8", "replace")[:64], width, height, bits, Can(can & 7))

    def _advance(self, count):
        """The device has taken `count` more packets; whether any. More than are under way: an old report."""
        if not 0 < count <= len(self._flight):
            return False
        now = self._advanced = time.perf_counter()
        self._in_vain = 0
        for _ in range(count):
            packet = self._flight.popleft()
            packet.message.taken = packet.step
            if packet.tries == 1:
                self._trip += 0.125 * (now - packet.written - self._trip)
                self._clean += 1
            while self._messages and self._messages[0].taken == self._messages[0].steps:
                self._messages.popleft()
        self._expected = (self._expected + count) % SEQUENCES
        if self._clean >= 32 and self._trip < ON_LINE:  # the line is good, and maybe faster than its baud say
            self._size, self._clean = min(2 * self._size, self._longest), 0
            self._room = min(2 * self._room, WINDOW * packets.LONGEST)
        return True

    def _write(self, data):
        port = self._require_port()
        try:
            port.write(data)
        except GONE as error:
            raise DeviceLost(
                f"The device is gone or stands still ({error}): plug it in again, then go on."
            ) from error

    def _require_port(self):
        if self._port is None:
            raise DeviceLost("The device is not connected: open it first.")
        return self._port
