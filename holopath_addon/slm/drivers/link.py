"""The computer's end of the serial line: messages arrive once and in order, or `DeviceLost` is raised.

Go-back-N: packets carry a sequence number; the device accepts only the next one, and reports its number
(Tanenbaum, Computer Networks, 5th ed., section 3.4.2). docs/serial-protocol.md specifies the protocol.
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
PROGRESS_TIMEOUT = 20.0  # seconds in which a device that answers must accept a packet
MAX_ANSWER = 256  # bytes of payload from a device
MIN_PAYLOAD = 32  # bytes, on a line that damages many packets
MAX_WINDOW = 16  # packets in flight
PACKET_SECONDS = 0.05  # maximum duration of a packet
FLIGHT_SECONDS = 0.2  # maximum duration of all packets in flight
PORT_ERRORS = OSError, TypeError, ValueError  # pyserial raises the latter two on a closed port
SEQUENCES, SESSIONS = 1 << 16, 1 << 8


@dataclass
class Message:
    """A message: a head, and the pixels of a frame, which are split into parts.

    Attributes
    ----------
    kind : Kind
    head : bytes
    body : memoryview
    sent, accepted : int
        Numbers of steps: the head is the first one, and each byte of the body another.
    """

    kind: Kind
    head: bytes
    body: memoryview = field(default_factory=lambda: memoryview(b""))
    sent: int = 0
    accepted: int = 0

    def next(self, size: int) -> tuple[Kind, tuple, int]:
        """Kind, payload in pieces and last step of the next packet of at most `size` bytes."""
        if self.sent == 0:
            return self.kind, (self.head,), 1
        begin = self.sent - 1
        part = self.body[begin : begin + size - packets.PART.size]
        return Kind.PART, (packets.PART.pack(begin), part), self.sent + len(part)

    @property
    def steps(self) -> int:
        """Total number of steps."""
        return 1 + len(self.body)


@dataclass
class _Flight:
    """A packet in flight: sent, and not reported as accepted."""

    data: bytes
    message: Message
    step: int
    written: float
    tries: int = 1


@dataclass(frozen=True)
class Device:
    """Properties of a device, as it reports them.

    Attributes
    ----------
    name : str
    width, height, bits : int
        Size in pixels and bits of a level; 0 where it takes no frames.
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
        Identifier by which the device recognizes the stream after a loss. Default: random.

    Attributes
    ----------
    device : Device or None
        Known after the first `connect`.
    frames, triggers : int
        Numbers of frames and pulses that the device last reported as complete.
    position : int
        Last reported position of the focus.
    moving : bool
        Whether the focus moved at the last report.
    lost_position : int
        Position of the focus before the device restarted, which forgets it; else 0.
    resent : int
        Number of packets that were sent again.
    """

    def __init__(self, stream: int | None = None) -> None:
        self._stream = random.getrandbits(32) if stream is None else stream
        self._session = 0
        self._port: serial.Serial | None = None
        self._messages = deque()  # the first ones may be partly in flight
        self._flight = deque()
        self._next = 0  # sequence of the next new packet
        self._expected = 0  # sequence of the first packet in flight
        self._is_open = self._resumes = False
        self._max_payload, self._window, self._size = packets.MAX_PAYLOAD, 1, MIN_PAYLOAD
        self._room = 0.0  # bytes that may be in flight
        self._clean = 0
        self._trip = 0.0  # seconds from writing to the report, moving average
        self._retries = 0  # retries since the device last accepted a packet
        self._last_answer = self._last_advance = self._last_retry = 0.0
        self.device = None
        self.frames = self.triggers = self.position = self.resent = 0
        self.lost_position = 0
        self._complete = 0  # frames that the device accepted in this stream
        self.moving = False

    def connect(self, port: serial.Serial, patience: float = START_PATIENCE) -> None:
        """Shake hands, and resume with what was not reported as accepted.

        Parameters
        ----------
        port : serial.Serial
            An open port with short timeouts for reading and writing.
        patience : float
            Seconds to wait for the device's answer.

        Raises
        ------
        DeviceLost
            If the device does not answer, or speaks another version.
        """
        self._port, self._decoder = port, packets.Decoder(MAX_ANSWER)
        self._shake_hands(patience)

    def disconnect(self) -> None:
        """Release the port; packets in flight are sent again after the next `connect`."""
        self._port = None

    def frame(self, number: int, pixels: np.ndarray, bits: int = 8, wavelength: int = 0) -> None:
        """Send a frame.

        Parameters
        ----------
        number : int
            Number of the frame, which increases by one.
        pixels : numpy.ndarray, shape (y, x), integers
            Levels.
        bits : int
            Bits of each pixel.
        wavelength : int
            Index of the wavelength.

        Raises
        ------
        DeviceLost
        """
        body = memoryview(pixels.tobytes())
        height, width = pixels.shape
        head = packets.FRAME.pack(number, width, height, bits, wavelength, len(body), zlib.crc32(body))
        self._send(Message(Kind.FRAME, head, body))

    def trigger(self, number: int, microseconds: int) -> None:
        """Request a pulse for a picture of a number."""
        self._send(Message(Kind.TRIGGER, packets.TRIGGER.pack(number, microseconds)))

    def focus(self, position: int) -> None:
        """Start a motion of the focus, and return when the device has accepted it; see `moving`."""
        self._send(Message(Kind.FOCUS, packets.FOCUS.pack(position)))
        self.finish()

    def forget(self, kind: Kind) -> None:
        """Drop the waiting messages of a kind."""
        self._messages = deque(message for message in self._messages if message.kind != kind)

    def status(self) -> None:
        """Request a report, and wait for it."""
        before = self._last_answer
        request_time = 0.0

        def has_answered():
            nonlocal request_time
            if self._last_answer > before:
                return True
            if time.perf_counter() - request_time > self._patience_of_one():
                request_time = time.perf_counter()
                self._write(packets.encode(Kind.STATUS, self._session, 0))
            return False

        self._pump(has_answered)

    @property
    def refused(self) -> int:
        """Number of frames that the device has accepted in full, but not shown."""
        return self._complete - self.frames

    @property
    def silence(self) -> float:
        """Seconds since the device's last answer."""
        return time.perf_counter() - self._last_answer

    def finish(self) -> None:
        """Wait until the device has accepted everything."""
        self._pump(lambda: not self._messages)

    def _send(self, message):
        self._messages.append(message)
        # a retry may have reset earlier messages: wait until all of it is in flight
        self._pump(lambda: self._messages[-1].sent == self._messages[-1].steps if self._messages else True)

    def _pump(self, done):
        """Write as the window allows and read answers, until `done()`."""
        self._require_port()
        waiting = time.perf_counter()
        while not done():
            has_written = self._write_more()
            self._read(wait=not has_written)
            now = time.perf_counter()
            if now - max(self._last_answer, waiting) > PATIENCE:
                raise DeviceLost(
                    f"The device has not answered for {PATIENCE:g} s. Check its cable and power, then go on."
                )
            if self._flight and now - max(self._last_advance, waiting) > PROGRESS_TIMEOUT:
                raise DeviceLost(
                    f"The device answers, but has accepted nothing for {PROGRESS_TIMEOUT:g} s. Restart it, then go on."
                )
            if self._flight and now - self._flight[0].written > self._patience_of_one():
                self._retries += 1
                self._go_back()

    def _patience_of_one(self):
        """Seconds after which a packet without a report is sent again."""
        usual = max(0.005, 4 * self._trip) * 2 ** min(self._retries, 4)
        return min(usual, 0.2) + self._bytes_under_way() * 10 / self._require_port().baudrate

    def _bytes_under_way(self):
        return sum(len(packet.data) for packet in self._flight)

    def _write_more(self):
        """Write one more packet if the window has room; whether it was written."""
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
        """Send all packets in flight again after a loss, in smaller pieces if large ones do not pass."""
        self._size, self._clean = max(MIN_PAYLOAD, self._size // 2), 0
        head = self._flight[0]
        if head.tries >= 2 and len(head.data) > 2 * (self._size + packets.OVERHEAD):
            self._shake_hands(PATIENCE)
            return
        self._last_retry = time.perf_counter()
        for packet in self._flight:
            packet.tries += 1
            packet.written = time.perf_counter()
            self._write(packet.data)
        self.resent += len(self._flight)

    def _shake_hands(self, patience):
        """Start a new session, which makes packets of the last one void."""
        # a device that has not answered may still know the current session
        if self._is_open or self._session == 0:
            self._session = (self._session + 1) % SESSIONS
        self._is_open = False
        hello = packets.encode(
            Kind.HELLO, self._session, 0, packets.HELLO.pack(packets.VERSION, 0, self._stream)
        )
        end, request_time = time.perf_counter() + patience, 0.0
        while not self._is_open:
            now = time.perf_counter()
            if now > end:
                raise DeviceLost(
                    f"The device has not answered for {patience:g} s. Check port, cable and power, and that its "
                    "firmware speaks HoloPath's protocol (docs/serial-protocol.md)."
                )
            if now - request_time > 0.1:
                request_time = now
                self._write(hello)
            self._read(wait=True)
        for message in self._messages:
            if not self._resumes:
                message.accepted = 0
            message.sent = message.accepted
        self._trip = self._trip or time.perf_counter() - request_time
        self._flight.clear()
        self._next = self._expected
        self._last_answer = self._last_advance = time.perf_counter()

    def _read(self, wait):
        """Read and process what has arrived."""
        port = self._require_port()
        try:
            data = port.read(port.in_waiting or 1) if wait or port.in_waiting else b""
        except PORT_ERRORS as error:
            raise DeviceLost(f"The device is gone ({error}). Plug it in again, then go on.") from error
        for packet in self._decoder.feed(data) if data else ():
            if packet.session == self._session:
                self._take(packet)

    def _take(self, packet):
        payload = packet.payload
        if packet.kind == Kind.WELCOME and len(payload) >= packets.WELCOME.size:
            self._welcome(packets.WELCOME.unpack_from(payload), payload[packets.WELCOME.size :])
        elif packet.kind == Kind.REPORT and len(payload) == packets.REPORT.size and self._is_open:
            expected, again, moving, self.frames, self.triggers, self.position = packets.REPORT.unpack(
                payload
            )
            self._last_answer, self.moving = time.perf_counter(), bool(moving)
            advanced = self._advance((expected - self._expected) % SEQUENCES)
            if (
                again
                and not advanced
                and self._flight
                and time.perf_counter() - self._last_retry > self._trip
            ):
                self._go_back()

    def _welcome(self, fields, name):
        version, goes_on, max_payload, window, expected, frames, position, width, height, bits, can = fields
        if version != packets.VERSION:
            raise DeviceLost(
                f"The device speaks version {version} of the protocol, this HoloPath version {packets.VERSION}. "
                "Update its firmware (docs/serial-protocol.md)."
            )
        if self._is_open:
            return  # the answer to a repeated HELLO
        count = (expected - self._expected) % SEQUENCES
        # a restarted device may know the stream from an old HELLO, and claim that it goes on
        self._is_open, self._resumes = True, bool(goes_on) and count <= len(self._flight)
        if self._resumes:
            self._advance(count)
        else:
            self.triggers, self._complete = 0, frames
            # other programs begin a stream, too, but the device then knows where the focus is
            if position == 0 and self.position:
                self.lost_position = self.position
        self._expected = expected
        self.frames, self.position = frames, position
        self._max_payload = max(MIN_PAYLOAD, min(max_payload, packets.MAX_PAYLOAD))
        self._window = max(1, min(window, MAX_WINDOW))
        if self.device is None:
            speed = self._require_port().baudrate / 10  # bytes per second
            self._size = max(MIN_PAYLOAD, int(speed * PACKET_SECONDS))
            self._room = speed * FLIGHT_SECONDS
        self._size = min(self._size, self._max_payload)
        self.device = Device(name.decode("utf-8", "replace")[:64], width, height, bits, Can(can & 7))

    def _advance(self, count):
        """Record `count` more accepted packets; whether there are any. An old report has more than are in flight."""
        if not 0 < count <= len(self._flight):
            return False
        now = self._last_advance = time.perf_counter()
        self._retries = 0
        for _ in range(count):
            packet = self._flight.popleft()
            packet.message.accepted = packet.step
            if packet.tries == 1:
                self._trip += 0.125 * (now - packet.written - self._trip)
                self._clean += 1
            while self._messages and self._messages[0].accepted == self._messages[0].steps:
                self._complete += self._messages.popleft().kind == Kind.FRAME
        self._expected = (self._expected + count) % SEQUENCES
        if (
            self._clean >= 32 and self._trip < PACKET_SECONDS
        ):  # the line is good, and may be faster than its baud rate
            self._size, self._clean = min(2 * self._size, self._max_payload), 0
            self._room = min(2 * self._room, MAX_WINDOW * packets.MAX_PAYLOAD)
        return True

    def _write(self, data):
        port = self._require_port()
        try:
            port.write(data)
        except PORT_ERRORS as error:
            raise DeviceLost(
                f"The device is gone or blocked ({error}). Plug it in again, then go on."
            ) from error

    def _require_port(self):
        if self._port is None:
            raise DeviceLost("The device is not connected. Open it first.")
        return self._port
