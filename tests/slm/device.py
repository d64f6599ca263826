"""A device at the other end of a pty: firmware written from docs/serial-protocol.md alone, and a bad line.

It shares no code with `holopath_addon.slm`.
"""

import contextlib
import os
import pty
import random
import select
import struct
import threading
import time
import tty
import zlib


class Firmware:
    """A controller's processing of bytes; `answer` has its reply."""

    def __init__(self, longest=4096, window=8, size=(64, 64), bits=8, can=7, version=1):
        self.longest, self.window, self.size, self.bits, self.can, self.version = (
            longest,
            window,
            size,
            bits,
            can,
            version,
        )
        self.shown, self.triggers, self.positions = [], [], []  # all that ever took effect
        self.speed = None  # positions a second; None: at once
        self.restart()

    def restart(self):
        """Power off and on."""
        self.stream, self.goes_on, self.heard = None, 0, 0.0
        self.session = self.expected = self.frames = self.pulses = self.position = 0
        self.target, self.arrival = 0, 0.0
        self.buffer, self.frame, self.needed = bytearray(), None, 0

    def receive(self, data):
        """Bytes from the line; returns bytes to the line."""
        out, news, now = [], False, time.monotonic()
        if self.buffer and now - self.heard > 0.05:
            del self.buffer[:1]  # a false beginning, or one that was cut
            self.needed = 0
        self.heard = now
        self.buffer += data
        if len(self.buffer) < self.needed:
            return b""
        for kind, session, number, payload in self._packets():
            if kind == 1 and len(payload) == 6:
                out += self._hello(session, payload)
            elif session != self.session or self.stream is None:
                continue
            elif kind == 6:
                out.append(self._report())
            elif kind in (2, 3, 4, 5):
                if number == self.expected:
                    self.expected = (self.expected + 1) & 0xFFFF
                    self._do(kind, payload)
                    news = True
                elif ((self.expected - number) & 0xFFFF) < 0x8000:
                    news = True
                else:
                    out.append(self._report(again=1))
        if news:
            out.append(self._report())
        return b"".join(out)

    def _packets(self):
        buffer = self.buffer
        while True:
            at = buffer.find(b"\xa5\x5a")
            del buffer[: at if at >= 0 else len(buffer) - buffer.endswith(b"\xa5")]
            self.needed = 12
            if len(buffer) < 12:
                return
            kind, session, number, length, check = struct.unpack_from("<BBHHI", buffer, 2)
            if zlib.crc32(buffer[2:8]) != check or length > self.longest:
                del buffer[:1]
                continue
            end = self.needed = 12 + length + (4 if length else 0)
            if len(buffer) < end:
                return
            payload = bytes(memoryview(buffer)[12 : 12 + length])
            if length and struct.unpack_from("<I", buffer, end - 4)[0] != zlib.crc32(payload):
                del buffer[:1]
                continue
            del buffer[:end]
            yield kind, session, number, payload

    def _hello(self, session, payload):
        _, _, stream = struct.unpack("<BBI", payload)
        if stream != self.stream:
            self.expected = self.frames = self.pulses = 0
            self.stream, self.goes_on, self.frame = stream, 0, None
        elif session != self.session:
            if ((session - self.session) & 0xFF) >= 128:
                return []
            self.goes_on = 1
        self.session = session
        described = struct.pack(
            "<BBHHHIiHHBB", self.version, self.goes_on, self.longest, self.window, self.expected, self.frames,
            self._now(), *self.size, self.bits, self.can,
        )  # fmt: skip
        return [self._packet(129, described + b"Test device")]

    def _do(self, kind, payload):
        if kind == 2:
            number, width, height, bits, wavelength, length, check = struct.unpack("<IHHBBII", payload)
            self.frame = [number, (height, width), bits, wavelength, length, check, bytearray()]
        elif kind == 3 and self.frame is not None:
            (offset,) = struct.unpack_from("<I", payload)
            if offset != len(self.frame[6]) or offset + len(payload) - 4 > self.frame[4]:
                return
            self.frame[6] += memoryview(payload)[4:]
            if len(self.frame[6]) == self.frame[4] and zlib.crc32(self.frame[6]) == self.frame[5]:
                number, shape, bits, wavelength, _, _, pixels = self.frame
                self.shown.append((number, shape, bits, wavelength, bytes(pixels)))
                self.frame, self.frames = None, self.frames + 1
        elif kind == 4:
            self.triggers.append(struct.unpack("<II", payload))
            self.pulses += 1
        elif kind == 5:
            self.position, (self.target,) = self._now(), struct.unpack("<i", payload)
            self.positions.append(self.target)
            way = abs(self.target - self.position)
            self.arrival = time.monotonic() + (way / self.speed if self.speed else 0)

    def _now(self):
        left = max(0.0, self.arrival - time.monotonic())
        if not left:
            return self.target
        return round(self.target + (1 if self.position > self.target else -1) * left * self.speed)

    def _report(self, again=0):
        moving = time.monotonic() < self.arrival
        return self._packet(
            130, struct.pack("<HBBIIi", self.expected, again, moving, self.frames, self.pulses, self._now())
        )

    def _packet(self, kind, payload):
        head = struct.pack("<BBHH", kind, self.session, 0, len(payload))
        check = struct.pack("<I", zlib.crc32(head))
        return b"\xa5\x5a" + head + check + payload + struct.pack("<I", zlib.crc32(payload))


class Noise:
    """A line that corrupts, drops, doubles and delays bytes, a share of them each."""

    def __init__(self, share, seed):
        self.share, self.random = share, random.Random(seed)
        self.held, self.until = b"", 0.0
        self.counts = dict.fromkeys(("corrupted", "dropped", "doubled", "delayed"), 0)

    def __call__(self, data):
        """The part of these bytes that arrives now."""
        if not self.share:
            return data
        out, begin, chance = bytearray(), 0, self.random
        while True:
            # bytes until the next one that something happens to
            step = int(chance.expovariate(self.share))
            out += data[begin : begin + step]
            begin += step
            if begin >= len(data):
                break
            what = chance.choice(list(self.counts))
            self.counts[what] += 1
            if what == "corrupted":
                out.append(data[begin] ^ chance.randrange(1, 256))
            elif what == "doubled":
                out += data[begin : begin + 1] * 2
            elif what == "delayed":  # it, and as it is a line all behind it, comes later
                out += data[begin : begin + 1]
                self.until = max(self.until, time.monotonic() + chance.random() * 0.002)
            begin += 1
        out, self.held = self.held + bytes(out), b""
        if time.monotonic() < self.until:
            self.held, out = out, b""
        return out


class Board:
    """Firmware behind a pty, in a thread. `path` is the port to open; with no firmware it only swallows bytes."""

    def __init__(self, firmware, share=0.0, seed=0):
        self.firmware = firmware
        self.received = 0
        self.mute = False
        self.to_device, self.to_computer = Noise(share, seed), Noise(share, seed + 1)
        self.master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        while not self._stop.is_set():
            self._step()

    def _step(self):
        ready, _, _ = select.select([self.master], [], [], 0.001 if self._held() else 0.05)
        data = os.read(self.master, 65536) if ready else b""
        self.received += len(data)
        data = self.to_device(data)
        if self.firmware is None or self.mute:
            return
        answer = self.to_computer(self.firmware.receive(data) if data else b"")
        while answer:
            answer = answer[os.write(self.master, answer) :]

    def _held(self):
        return self.to_device.held or self.to_computer.held

    def unplug(self):
        """Pull the plug: the port is gone."""
        self._stop.set()
        self._thread.join()
        self._close()

    def _close(self):
        for end in (self.master, self._slave):
            with contextlib.suppress(OSError):
                os.close(end)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.unplug()
