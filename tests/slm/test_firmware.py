"""The reference firmware in docs/firmware/holopath, compiled for this computer, at the other end of a pty."""

import contextlib
import itertools
import os
import random
import re
import select
import shutil
import struct
import subprocess
import threading
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

termios = pytest.importorskip("termios", reason="There are ptys on Unix alone.")
pty = pytest.importorskip("pty")
tty = pytest.importorskip("tty")
serial = pytest.importorskip("serial")

from holopath_addon.slm.drivers import link as link_module  # noqa: E402
from holopath_addon.slm.drivers.link import Link  # noqa: E402
from holopath_addon.slm.drivers.packets import Can, Decoder, encode  # noqa: E402
from holopath_addon.slm.errors import DeviceLost  # noqa: E402
from tests.patience import NEVER, SOON  # noqa: E402
from tests.slm.device import Noise  # noqa: E402

FIRMWARE = Path(__file__).parents[2] / "docs" / "firmware" / "holopath"
WARNINGS = ("-std=c++11", "-Wall", "-Wextra", "-Werror")
WIDTH, HEIGHT = 16, 12
HELLO, FRAME, PART, TRIGGER, FOCUS, STATUS, WELCOME, REPORT = 1, 2, 3, 4, 5, 6, 129, 130


@pytest.fixture(scope="module")
def compiler():
    """The C++ compiler as a function of its arguments."""
    path = shutil.which("c++") or shutil.which("g++")
    if path is None:
        pytest.skip("This machine has no C++ compiler, c++ or g++.")

    def run(*arguments):
        done = subprocess.run([path, *WARNINGS, *arguments], capture_output=True, text=True, timeout=NEVER)
        assert done.returncode == 0, done.stderr

    return run


@pytest.fixture(scope="module")
def program(compiler, tmp_path_factory):
    """The firmware as a program of this machine."""
    path = tmp_path_factory.mktemp("firmware") / "host"
    compiler("-O1", Path(__file__).with_name("firmware_host.cpp"), "-o", path)
    return path


@pytest.fixture
def start(program, tmp_path):
    """Starts the firmware; it is ended with the test."""
    running, count = [], itertools.count()

    def run(line, speed=1000, longest=512, silence=0.05):
        log = tmp_path / f"log{next(count)}"
        log.touch()
        command = [
            program,
            str(line),
            f"{WIDTH}x{HEIGHT}",
            log,
            str(speed),
            str(longest),
            str(round(1e3 * silence)),
        ]
        process = subprocess.Popen(command, pass_fds=[line] if isinstance(line, int) else [])
        process.log = lambda: log.read_text().splitlines()
        running.append(process)
        return process

    yield run
    for process in running:
        process.kill()
        process.wait()


@pytest.fixture
def raw_pty():
    """Master and slave; held open, so that neither end sees the other one leave."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield master, slave
    os.close(master)
    os.close(slave)


class Cable:
    """Two ptys and what is between them: noise, or after so many bytes to the device nothing."""

    def __init__(self, share=0.0, seed=0):
        self.noise = Noise(share, seed), Noise(share, seed + 1)
        self._passed, self._end = 0, None  # bytes to the device, and after how many nothing more passes
        (self.near, self._near_slave), (self.far, self.far_slave) = self._ends = pty.openpty(), pty.openpty()
        for _, slave in self._ends:
            tty.setraw(slave)
        for master, _ in self._ends:
            os.set_blocking(master, False)
        self.computer, self.device = os.ttyname(self._near_slave), os.ttyname(self.far_slave)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        while not self._stop.is_set():
            held = any(noise.held for noise in self.noise)
            ready, _, _ = select.select([self.near, self.far], [], [], 0.001 if held else 0.02)
            down = self.noise[0](os.read(self.near, 4096) if self.near in ready else b"")
            up = self.noise[1](os.read(self.far, 4096) if self.far in ready else b"")
            end = self._end
            if end is not None:
                left = max(0, end - self._passed)
                down, up = down[:left], up if left else b""
            self._passed += len(down)
            self._write(self.far, down)
            self._write(self.near, up)

    def _write(self, end, data):
        while data and not self._stop.is_set():
            try:
                data = data[os.write(end, data) :]
            except BlockingIOError:  # full
                time.sleep(0.001)

    def cut(self, after):
        """Nothing passes in either direction once so many more bytes have passed to the device."""
        self._end = self._passed + after

    def mend(self):
        self._end = None

    def close(self):
        self._stop.set()
        self._thread.join()
        for end in itertools.chain(*self._ends):
            os.close(end)


@pytest.fixture
def cable():
    """Makes one, which is closed with the test."""
    with contextlib.ExitStack() as stack:

        def make(*arguments):
            made = Cable(*arguments)
            stack.callback(made.close)
            return made

        yield make


def open_port(path):
    return serial.Serial(path, 4000000, timeout=0.002, write_timeout=SOON)


def messages(seed):
    """Endless (line of the log, what sends it), with all that a device takes."""
    chance = random.Random(seed)
    for number in itertools.count():
        kind = chance.choice(("frame", "frame", "trigger", "trigger", "focus"))
        if kind == "frame":
            height, width, bits = (
                chance.randint(1, HEIGHT),
                chance.randint(1, WIDTH),
                chance.choice((1, 8, 12)),
            )
            pixels = np.frombuffer(chance.randbytes(height * width * (2 if bits > 8 else 1)), np.uint8)
            pixels = pixels.view("<u2" if bits > 8 else np.uint8).reshape(height, width)
            color = chance.randrange(3)
            line = f"frame {number} {width} {height} {bits} {color} {zlib.crc32(pixels.tobytes()):08x}"
            yield line, lambda link, a=(number, pixels, bits, color): link.frame(*a)
        elif kind == "trigger":
            length = chance.randrange(1 << 32)
            yield f"trigger {number} {length}", lambda link, a=(number, length): link.trigger(*a)
        else:
            position = chance.randint(-(1 << 31), (1 << 31) - 1)
            yield f"focus {position}", lambda link, a=position: link.focus(a)


def send(link, stream, count):
    """Send so many messages; returns the lines that the log must have."""
    lines = []
    for line, act in itertools.islice(stream, count):
        lines.append(line)
        act(link)
    link.finish()
    return lines


def send_until_lost(link, stream, monkeypatch):
    """Send until the device is lost; returns the lines of all that was given to the link."""
    lines = []
    with monkeypatch.context() as patched, pytest.raises(DeviceLost):
        patched.setattr(link_module, "PATIENCE", 0.25)
        for line, act in itertools.islice(stream, 2000):
            lines.append(line)
            act(link)
        link.finish()
    return lines


def counts(lines):
    return tuple(sum(line.startswith(kind) for line in lines) for kind in ("frame", "trigger"))


SILENCE = 0.5  # seconds


class Wire:
    """Packets as the test wants them to the firmware, and its answers."""

    MARK = 201  # session of a HELLO of a version that is none: it is answered always, and changes nothing

    def __init__(self, master):
        self._master, self._decoder = master, Decoder()

    def __call__(self, *data, session=1):
        """Send this and STATUS; returns the answers as (kind, session, payload), once all is read by the device."""
        data = b"".join(data) + encode(STATUS, session, 0)
        data += encode(HELLO, self.MARK, 0, struct.pack("<BBI", 99, 0, 0))
        answers, end = [], time.monotonic() + SOON
        while not answers or answers[-1][1] != self.MARK:
            assert time.monotonic() < end, "no answer"
            ready, free, _ = select.select([self._master], [self._master] if data else [], [], 0.1)
            if free:
                data = data[os.write(self._master, data[:1000]) :]
            if ready:
                found = self._decoder.feed(os.read(self._master, 4096))
                answers += [(packet.kind, packet.session, packet.payload) for packet in found]
        assert self._decoder.damaged == 0
        kind, _, payload = answers.pop()
        assert kind == WELCOME and payload[0] == 1
        return answers

    def state(self, *data, session=1):
        """Send this; returns the next sequence number, frames and triggers, as reported then."""
        kind, described, payload = self(*data, session=session)[-1]
        assert (kind, described) == (REPORT, session)
        expected, _, _, frames, triggers, _ = struct.unpack("<HBBIIi", payload)
        return expected, frames, triggers


def hello(session, stream, version=1, size=6):
    payload = struct.pack("<BBIQ", version, 0, stream, 0)[:size]
    return encode(HELLO, session, 0, payload)


def trigger(sequence, number, session=1):
    return encode(TRIGGER, session, sequence, struct.pack("<II", number, 7))


def frame(sequence, number, pixels, width, height, bits=8, color=2, session=1):
    head = struct.pack("<IHHBBII", number, width, height, bits, color, len(pixels), zlib.crc32(pixels))
    return encode(FRAME, session, sequence, head)


def part(sequence, offset, pixels, session=1):
    return encode(PART, session, sequence, struct.pack("<I", offset) + pixels)


@pytest.fixture(params=[512, 64])
def wire(request, start, raw_pty):
    """A wire to firmware with `longest` and `log`, after the first handshake: session 1, stream 77."""
    master, slave = raw_pty
    # other programs may stop this one between two parts of a packet
    process = start(os.ttyname(slave), longest=request.param, silence=SILENCE)
    wire = Wire(master)
    wire.longest, wire.log = request.param, process.log
    assert [answer[:2] for answer in wire(hello(1, 77))] == [(WELCOME, 1), (REPORT, 1)]
    return wire


@pytest.mark.parametrize("longest", [512, 64])
def test_handshake_and_messages_on_a_clean_line(start, raw_pty, longest):
    """The firmware describes the device, and everything sent has its effect once and in order."""
    master, slave = raw_pty
    process, link = start(master, longest=longest), Link()
    with open_port(os.ttyname(slave)) as port:
        link.connect(port)
        device = link.device
        assert (device.name, device.width, device.height, device.bits) == ("Host", WIDTH, HEIGHT, 16)
        assert device.can == Can.FRAMES | Can.TRIGGERS | Can.FOCUS
        lines = send(link, messages(1), 300)
        link.status()
    assert process.log() == lines
    assert (link.frames, link.triggers) == counts(lines) and link.refused == 0
    assert min(counts(lines)) > 80


@pytest.mark.parametrize(("longest", "count"), [(512, 300), (64, 100)])
def test_messages_on_a_noisy_line(start, cable, longest, count):
    """One byte of 100 corrupted, dropped, doubled or delayed, both ways."""
    line = cable(0.01, 3)
    process, link = start(line.device, longest=longest), Link()
    with open_port(line.computer) as port:
        link.connect(port)
        lines = send(link, messages(2), count)
        link.status()
    assert process.log() == lines
    assert (link.frames, link.triggers) == counts(lines) and link.refused == 0
    assert link.resent and all(min(noise.counts.values()) > 5 for noise in line.noise)


def test_focus_takes_its_time(start, raw_pty):
    master, slave = raw_pty
    start(master, speed=200)
    link = Link()
    with open_port(os.ttyname(slave)) as port:
        link.connect(port)
        for goal in (100, -60):
            begin = link.position
            link.focus(goal)
            assert link.moving
            observed = []
            while link.moving:
                observed.append(link.position)
                link.status()
            assert link.position == goal
            assert observed == sorted(observed, reverse=goal < begin)
            assert len(set(observed)) > 1


@pytest.mark.parametrize("longest", [512, 64])
def test_garbage_before_the_handshake(start, raw_pty, longest, monkeypatch):
    """Random bytes, and headers that are right but for what they claim."""
    master, slave = raw_pty
    process, link = start(master, longest=longest), Link()
    chance = random.Random(4)
    with open_port(os.ttyname(slave)) as port:
        garbage = [chance.randbytes(20000)]
        for length in (65535, longest + 1, longest, 4, 0):
            for kind in (*range(8), WELCOME, REPORT, 255):
                body = struct.pack("<BBHH", kind, chance.randrange(256), chance.randrange(3), length)
                garbage.append(
                    b"\xa5\x5a" + body + struct.pack("<I", zlib.crc32(body)) + chance.randbytes(length % 9)
                )
        # of a program that was killed
        garbage.append(trigger(0, 1) + part(1, 0, bytes(longest - 4))[:-longest])
        for data in garbage:
            port.write(data)
        sent, write = [], port.write
        monkeypatch.setattr(port, "write", lambda data: sent.append(len(data)) or write(data))
        link.connect(port)
        # not so many HELLOs that they have filled the last packet
        assert longest == 64 or sum(sent) < longest / 2
        assert process.log() == []
        lines = send(link, messages(5), 50)
    assert process.log() == lines


def test_a_new_port_while_the_firmware_goes_on(start, cable, monkeypatch):
    """Everything in flight, even half a frame, arrives once."""
    line = cable()
    process, link, stream, chance = start(line.device), Link(), messages(6), random.Random(7)
    lines = []
    for _ in range(8):  # reports are lost
        port = open_port(line.computer)
        link.connect(port)
        for text, act in itertools.islice(stream, chance.randrange(8)):
            lines.append(text)
            act(link)
        port.close()
    for _ in range(8):  # packets too
        port = open_port(line.computer)
        link.connect(port)
        line.cut(chance.randrange(3000))
        lines += send_until_lost(link, stream, monkeypatch)
        port.close()
        line.mend()
    with open_port(line.computer) as port:
        link.connect(port)
        lines += send(link, stream, 20)
        link.status()
    assert process.log() == lines
    assert (link.frames, link.triggers) == counts(lines) and link.refused == 0


def test_a_new_port_and_firmware_that_has_restarted(start, cable, monkeypatch):
    """All arrives in order; twice only what was done just before and not yet reported."""
    line = cable()
    link, stream, chance = Link(), messages(8), random.Random(9)
    lines, logs = [], []
    for life in range(7):
        process = start(line.device)
        with open_port(line.computer) as port:
            link.connect(port)
            if life < 6:
                line.cut(chance.randrange(3000))
                lines += send_until_lost(link, stream, monkeypatch)
            else:
                lines += send(link, stream, 20)
        process.kill()
        process.wait()
        logs.append(process.log())
        termios.tcflush(line.far_slave, termios.TCIFLUSH)  # what it had not read is gone with it
        line.mend()
    assert link.frames == counts(logs[-1])[0] and link.refused == 0
    done = 0
    for log in logs:
        begins = [
            begin for begin in range(max(0, done - 8), done + 1) if lines[begin : begin + len(log)] == log
        ]
        assert begins, (lines[max(0, done - 8) : done + len(log)], log)
        done = max(begins[-1] + len(log), done)
    assert done == len(lines)


def test_a_window_and_a_longest_payload_are_told(wire):
    (_, _, welcome), _ = wire(hello(1, 77))
    version, goes_on, longest, window, expected, frames, position, width, height, bits, can = struct.unpack(
        "<BBHHHIiHHBB", welcome[:22]
    )
    assert (version, goes_on, longest, window) == (1, 0, wire.longest, 8 if wire.longest == 512 else 2)
    assert (expected, frames, position, width, height, bits, can) == (0, 0, 0, WIDTH, HEIGHT, 16, 7)
    assert welcome[22:] == b"Host"


def test_nothing_whole_is_lost_behind_false_beginnings(wire):
    """The search goes on at the byte behind a false beginning, whatever that claimed to hold."""
    chance = random.Random(10)
    data = []
    for number in range(400):
        length = chance.choice((0, 1, 4, 8, 18, 40, wire.longest, wire.longest + 1, 65535))
        head = encode(chance.randrange(7), 1, number, bytes(length))[:12]
        data += [
            chance.choice((
                b"",
                b"\xa5" * chance.randrange(4),
                b"\xa5\x5a" * chance.randrange(4),
                head if length else b"",
                head[: chance.randrange(12)],
                head[:8] + b"\xa5\x5a\xa5\x5a",
                head[:8] + b"\0\0\0\0" + bytes(length % 99),
                trigger(number, 999)[: chance.randrange(24)],
                trigger(number, 999)[:-1] + b"\xa5",  # wrong in its last byte, the CRC's
                chance.randbytes(chance.randrange(30)),
            )),
            trigger(number, number),
        ]  # fmt: skip
    expected, _, triggers = wire.state(*data, bytes(wire.longest + 16))
    assert wire.log() == [f"trigger {number} 7" for number in range(400)]
    assert (expected, triggers) == (400, 400)


def test_what_a_silence_cuts_off_is_given_up(wire, raw_pty):
    """Packets after the start of an incomplete one are accepted when nothing else arrives."""
    os.write(raw_pty[0], part(0, 0, bytes(wire.longest - 4))[:20] + trigger(0, 8) + trigger(1, 9)[:-1])
    end = time.monotonic() + SOON
    while not wire.log() and time.monotonic() < end:
        time.sleep(0.005)
    assert wire.log() == ["trigger 8 7"]
    time.sleep(2 * SILENCE)
    assert wire.state() == (1, 0, 1)


def test_numbers_are_taken_once_and_in_order(wire):
    def again(answers):
        return [payload[2] for kind, _, payload in answers if kind == REPORT]

    assert again(wire(trigger(0, 10))) == [0]
    assert set(again(wire(trigger(0, 11), trigger(65535, 12), trigger(0x8002, 13)))) == {0}
    assert again(wire(trigger(2, 14), trigger(3, 15), trigger(0x8000, 16))) == [1, 1, 1, 0]
    assert wire.state(trigger(1, 17)) == (2, 0, 2)
    # a frame's parts come once, too
    pixels = bytes(range(48))
    wire(
        frame(2, 18, pixels, 16, 3),
        part(3, 0, pixels[:24]),
        part(3, 0, pixels[:24]),
        part(5, 24, pixels[24:]),
    )
    assert wire.state(part(4, 24, pixels[24:])) == (5, 1, 2)
    assert wire.log() == ["trigger 10 7", "trigger 17 7", f"frame 18 16 3 8 2 {zlib.crc32(pixels):08x}"]


def test_numbers_begin_again_at_0(wire):
    """65536 numbers, most of them of packets without a meaning."""
    empty = [encode(FOCUS, 1, number) for number in range(65535)]
    assert wire.state(*empty, trigger(65535, 1), trigger(0, 2), trigger(65535, 3), trigger(0, 4)) == (1, 0, 2)
    assert wire.log() == ["trigger 1 7", "trigger 2 7"]


def test_what_makes_no_sense_is_taken_without_effect(wire):
    pixels = bytes(range(100, 140))
    right = f"frame 5 8 5 8 2 {zlib.crc32(pixels):08x}"
    numbers = itertools.count()

    def taken(make, *arguments, **more):
        number = next(numbers)
        assert wire.state(make(number, *arguments, **more))[0] == number + 1

    taken(part, 0, pixels)  # of no frame
    for width, height, bits, length in (
        (WIDTH + 1, 1, 8, WIDTH + 1),
        (1, HEIGHT + 1, 8, HEIGHT + 1),
        (65535, 65535, 8, 60),
        (8, 5, 12, 40),  # two bytes each
        (2, 5, 12, 21),
        (8, 5, 8, 41),
        (8, 5, 8, 39),
        (8, 5, 0, 40),
        (2, 5, 17, 20),
        (0, 5, 8, 0),
    ):
        taken(frame, 4, bytes(length), width, height, bits=bits)
        taken(part, 0, bytes(length))
    assert wire.log() == []
    taken(frame, 4, pixels, 8, 5)
    taken(part, 0, pixels[:20])
    taken(frame, 5, pixels, 8, 5)  # begins anew
    taken(part, 20, pixels[20:])
    taken(part, 1, pixels[1:])
    taken(part, 0, pixels + b"!")
    taken(part, 0, pixels[:30])
    taken(part, 0, pixels[:30])
    taken(part, 30, pixels)
    taken(part, 0xFFFFFFFF, pixels)
    taken(part, 30, b"")
    for kind in (FRAME, PART, TRIGGER, FOCUS):
        if kind != FRAME:
            taken(lambda number, kind=kind: encode(kind, 1, number))
            taken(lambda number, kind=kind: encode(kind, 1, number, b"123"))
        if kind in (TRIGGER, FOCUS):
            taken(lambda number, kind=kind: encode(kind, 1, number, b"123456789"))
    assert wire.log() == []
    taken(part, 30, pixels[30:])
    assert wire.log() == [right]
    taken(part, 40, b"!")
    taken(part, 40, b"")
    taken(part, 0, pixels)
    assert wire.log() == [right]
    # pixels that are not those announced
    taken(frame, 6, pixels, 8, 5)
    taken(part, 0, pixels[:-1] + b"!")
    taken(part, 0, pixels)
    assert wire.log() == [right, "damaged 6"]
    number = next(numbers)
    assert wire.state() == (number, 1, 0)
    # other kinds have no number
    assert wire.state(*(encode(kind, 1, number) for kind in (0, 7, WELCOME, 255))) == (number, 1, 0)


def test_sessions_and_streams(wire):
    """The handshake's four cases, and that packets of other sessions mean nothing."""
    pixels = bytes(range(40))

    def described(answers):
        """Session, goes on, next sequence number and frames of each WELCOME."""
        return [
            (session, payload[1], *struct.unpack_from("<HI", payload, 6))
            for kind, session, payload in answers
            if kind == WELCOME
        ]

    wire(frame(0, 1, pixels, 8, 5), part(1, 0, pixels))
    wire(frame(2, 2, pixels, 8, 5), part(3, 0, pixels[:20]))
    # the same again: as it did
    assert described(wire(hello(1, 77))) == [(1, 0, 4, 1)]
    # older, by as much as it may be, and one that speaks another version
    assert described(wire(hello(0, 77), hello(129, 77), hello(200, 77))) == []
    assert described(wire(hello(9, 78, version=2))) == [(9, 0, 4, 1)]
    # none that makes sense
    assert described(wire(*(hello(5, 80, size=size) for size in (0, 1, 5, 7)))) == []
    # other sessions
    assert wire(trigger(4, 3, session=0), trigger(4, 4, session=2), session=2) == []
    assert wire.state() == (4, 1, 0)
    # it goes on, with half a frame
    assert described(wire(hello(128, 77), session=128)) == [(128, 1, 4, 1)]
    assert described(wire(hello(128, 77), session=128)) == [(128, 1, 4, 1)]
    assert described(wire(hello(1, 77), session=128)) == []
    assert wire(trigger(4, 5), part(4, 20, pixels[20:])) == []
    assert wire.state(part(4, 20, pixels[20:], session=128), session=128) == (5, 2, 0)
    assert described(wire(hello(255, 77), hello(3, 77), session=3)) == [(255, 1, 5, 2), (3, 1, 5, 2)]
    assert wire.state(trigger(5, 6, session=3), session=3) == (6, 2, 1)
    # another stream, of any session, forgets all: half a frame, too
    wire(frame(6, 7, pixels, 8, 5, session=3), part(7, 0, pixels[:20], session=3), session=3)
    assert described(wire(hello(2, 78), session=2)) == [(2, 0, 0, 0)]
    assert described(wire(hello(2, 78), session=2)) == [(2, 0, 0, 0)]
    assert wire.state(part(0, 20, pixels[20:], session=2), session=2) == (1, 0, 0)
    right = f"8 5 8 2 {zlib.crc32(pixels):08x}"
    assert wire.log() == [f"frame 1 {right}", f"frame 2 {right}", "trigger 6 7"]


def test_nothing_is_taken_before_the_first_handshake(start, raw_pty):
    master, slave = raw_pty
    process, wire = start(os.ttyname(slave)), Wire(master)
    early = [trigger(0, 1, session=session) for session in range(256)]
    assert wire(*early, session=0) == []
    assert wire.state(hello(1, 0), trigger(0, 2)) == (1, 0, 1)
    assert process.log() == ["trigger 2 7"]


ARDUINO = """
#pragma once
#include <stddef.h>
#include <stdint.h>
enum { LOW = 0, HIGH = 1, OUTPUT = 1 };
unsigned long micros();
unsigned long millis();
void delayMicroseconds(unsigned int);
void pinMode(uint8_t, uint8_t);
void digitalWrite(uint8_t, uint8_t);
struct Port {
    void begin(unsigned long);
    void setRxBufferSize(size_t);
    int available();
    int read();
    size_t write(const uint8_t *, size_t);
};
extern Port Serial;
"""
BOARD = """
// A board: stdin arrives, a byte each so many microseconds, stdout is what it sends, stderr the pins and when they
// change. Arguments: microseconds of a byte, until micros() begins again at 0, and between two loop()s.
#include "sketch.ino"
#include <stdio.h>
#include <stdlib.h>
static uint64_t started, now;
static int byte_time;
static uint8_t bytes[65536], levels[256];
static int at = 0, count = 0;
unsigned long micros() { return uint32_t(now); }
unsigned long millis() { return uint32_t(now / 1000); }
void delayMicroseconds(unsigned int n) { now += n; }
void pinMode(uint8_t, uint8_t) {}
void digitalWrite(uint8_t pin, uint8_t level) {
    now += 2;
    if (levels[pin] == level) return;
    levels[pin] = level;
    fprintf(stderr, "%d %d %d\\n", pin, level, int(now - started));
}
Port Serial;
void Port::begin(unsigned long) {}
void Port::setRxBufferSize(size_t) {}
int Port::available() {
    const int arrived = int((now - started) / byte_time);
    return (arrived < count ? arrived : count) - at;
}
int Port::read() { return bytes[at++]; }
size_t Port::write(const uint8_t *data, size_t n) { return fwrite(data, 1, n, stdout); }
int main(int, char **arguments) {
    byte_time = atoi(arguments[1]);
    const int loop_time = atoi(arguments[3]);
    now = started = (1ull << 32) - atoi(arguments[2]);
    count = int(fread(bytes, 1, sizeof bytes, stdin));
    setup();
    while (now < started + uint64_t(count) * byte_time + 100000) {
        loop();
        now += loop_time;
    }
    return 0;
}
"""


@pytest.fixture
def sketch(compiler, tmp_path):
    """Writes the sketch, changed as asked, with a board around it; returns the path of that."""
    (tmp_path / "Arduino.h").write_text(ARDUINO)
    (tmp_path / "board.cpp").write_text(BOARD)

    def write(**constants):
        text = (FIRMWARE / "holopath.ino").read_text()
        for name, value in constants.items():
            text, found = re.subn(rf"\b{name} = \w+", f"{name} = {value}", text)
            assert found == 1
        (tmp_path / "sketch.ino").write_text(text)
        return tmp_path / "board.cpp"

    return write


@pytest.mark.parametrize("board", ["__AVR__", "ESP32", "TEENSYDUINO"])
def test_sketch_compiles(compiler, tmp_path, sketch, board):
    sketch()
    arguments = ("-fsyntax-only", f"-D{board}", f"-I{tmp_path}")
    compiler(*arguments, "-x", "c++", FIRMWARE / "holopath.ino")
    compiler(*arguments, f"-I{FIRMWARE}", tmp_path / "board.cpp")


def run_board(compiler, source, data, byte_time=87, wrap=8700, loop_time=10):
    """Answers as packets, and the levels of each pin with their start times."""
    program = source.with_name("board")
    compiler(f"-I{FIRMWARE}", f"-I{source.parent}", source, "-o", program)
    done = subprocess.run(
        [program, str(byte_time), str(wrap), str(loop_time)], input=data, capture_output=True, timeout=NEVER
    )
    assert done.returncode == 0
    pins = {}
    for line in done.stderr.decode().splitlines():
        pin, level, at = map(int, line.split())
        pins.setdefault(pin, []).append((level, at))
    decoder = Decoder()
    answers = decoder.feed(done.stdout)
    assert decoder.damaged == 0 and len(decoder) == 0
    return answers, pins


@pytest.mark.parametrize("wrap", [8700, 70000])  # in a pulse, and between steps
def test_sketch_pulses_and_steps(compiler, sketch, wrap):
    pause = bytes(600)  # 52 ms
    data = hello(1, 5) + trigger(0, 1) + encode(TRIGGER, 1, 1, struct.pack("<II", 2, 30000))
    data += encode(TRIGGER, 1, 2, struct.pack("<II", 3, 1000)) + encode(STATUS, 1, 0) + pause
    data += encode(FOCUS, 1, 3, struct.pack("<i", 12)) + bytes(70)
    data += encode(FOCUS, 1, 4, struct.pack("<i", -3)) + encode(STATUS, 1, 0) + pause + encode(STATUS, 1, 0)
    data += (
        encode(TRIGGER, 1, 5, struct.pack("<II", 4, 200)) + frame(6, 6, bytes(8), 4, 2) + part(7, 0, bytes(8))
    )
    answers, pins = run_board(compiler, sketch(), data, wrap=wrap)
    welcome = struct.unpack("<BBHHHIiHHBB", answers[0].payload[:22])
    assert welcome == (1, 0, 512, 8, 0, 0, 0, 0, 0, 8, Can.TRIGGERS | Can.FOCUS)
    assert answers[0].payload[22:] == b"HoloPath board"
    assert struct.unpack("<HBBIIi", answers[-1].payload) == (8, 0, 0, 0, 4, -3)

    # a pulse each, though the second one was still on as the third came
    levels, times = zip(*pins[2], strict=True)
    assert levels == (1, 0) * 4
    lengths = [end - begin for begin, end in zip(times[::2], times[1::2], strict=True)]
    assert 7 <= lengths[0] < 150 and lengths[1] < 3000
    assert 1000 <= lengths[2] < 1150 and 200 <= lengths[3] < 350
    assert all(2 <= after - before for before, after in itertools.pairwise(times))

    # up, and down to the last goal, each step with the direction set before it and never too fast
    direction = dict((at, level) for level, at in [(1, 0), *pins[4]])
    steps = [at for level, at in pins[3] if level]
    signs = [1 if direction[max(time for time in direction if time <= at)] else -1 for at in steps]
    turn = signs.index(-1)
    assert 3 < turn < 12
    assert signs == [1] * turn + [-1] * (turn + 3)
    assert all(1250 <= after - before < 1400 for before, after in itertools.pairwise(steps))
    moving = [(packet.payload[3], struct.unpack("<i", packet.payload[12:])[0]) for packet in answers[1:]]
    assert (1, turn) in moving and moving[-1] == (0, -3)
    assert not any(at for pin in (5, 6, 7) for _, at in pins.get(pin, ()))


def test_sketch_switches_the_laser_of_a_frame(compiler, sketch):
    """Answers to valid bytes that arrive faster than loop() reads them, one per microsecond."""
    pixels = bytes(8)
    data = hello(1, 5) + frame(0, 1, pixels, 4, 2, color=2) + part(1, 0, pixels)
    data += frame(2, 2, pixels, 4, 2, color=1) + part(3, 0, pixels[:-1] + b"!")
    data += frame(4, 3, pixels, 4, 2, color=0) + part(5, 0, pixels) + encode(STATUS, 1, 0)
    answers, pins = run_board(compiler, sketch(WIDTH=4, HEIGHT=2), data, byte_time=1, loop_time=60)
    assert answers[0].payload[21] == Can.FRAMES | Can.TRIGGERS | Can.FOCUS
    assert struct.unpack("<HBBIIi", answers[-1].payload) == (6, 0, 0, 2, 0, 0)
    assert [level for level, _ in pins[7]] == [1, 0]
    assert [level for level, _ in pins[5]] == [1]
    assert pins[7][0][1] < pins[5][0][1]
    assert 6 not in pins


def test_sketch_switches_lasers_off_without_the_computer(compiler, sketch):
    """They stay on while it asks, go off when it is silent, and when a new stream begins."""
    pixels, pause = bytes(8), bytes(600)  # 52 ms
    data = hello(1, 5) + frame(0, 1, pixels, 4, 2, color=2) + part(1, 0, pixels)
    data += (pause + encode(STATUS, 1, 0)) * 4 + 5 * pause + encode(STATUS, 1, 0)
    data += frame(2, 2, pixels, 4, 2, color=0) + part(3, 0, pixels) + hello(2, 5) + hello(3, 6)
    _, pins = run_board(compiler, sketch(WIDTH=4, HEIGHT=2, LASER_TIMEOUT=100), data)
    (on, begin), (off, end) = pins[7]
    assert (on, off) == (1, 0) and 300e3 < end - begin < 330e3  # four pauses, then the timeout
    assert [level for level, _ in pins[5]] == [1, 0] and 6 not in pins
    assert pins[5][1][1] - pins[5][0][1] < 10e3  # not by the timeout
