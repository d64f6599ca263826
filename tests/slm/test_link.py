"""Packets, and messages over a good, a bad and a broken line, to firmware that is written from the protocol alone."""

import struct
import time
import tracemalloc
import types
import zlib

import numpy as np
import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

from holopath_addon.slm.drivers import link as link_module
from holopath_addon.slm.drivers import packets
from holopath_addon.slm.drivers.link import Link
from holopath_addon.slm.drivers.packets import Decoder, Packet, encode
from holopath_addon.slm.errors import DeviceLost
from tests.patience import SOON
from tests.slm.device import Board, Firmware

BAUD = 4000000


def opened(board):
    return serial.Serial(board.path, BAUD, timeout=0.002, write_timeout=SOON)


def connected(board, link=None):
    link = link or Link()
    link.connect(opened(board))
    return link


# Packets


def test_the_written_form():
    """Byte for byte as docs/serial-protocol.md has it."""
    assert zlib.crc32(b"123456789") == 0xCBF43926
    body = bytes([3, 7, 0x34, 0x12, 2, 0])
    expected = (
        b"\xa5\x5a"
        + body
        + struct.pack("<I", zlib.crc32(body))
        + b"ab"
        + struct.pack("<I", zlib.crc32(b"ab"))
    )
    assert encode(3, 7, 0x1234, b"ab") == expected
    assert encode(6, 0, 0) == b"\xa5\x5a\x06\0\0\0\0\0" + struct.pack("<I", zlib.crc32(b"\x06\0\0\0\0\0"))


PACKETS = st.builds(
    Packet, st.integers(0, 255), st.integers(0, 255), st.integers(0, 65535), st.binary(max_size=300)
)


def cut(data, places):
    """Pieces of data between sorted places."""
    at = sorted(place % (len(data) + 1) for place in places)
    return [data[a:b] for a, b in zip([0, *at], [*at, len(data)], strict=True)]


@given(
    st.lists(st.tuples(PACKETS, st.binary(max_size=40)), max_size=8),
    st.lists(st.integers(0, 10**6), max_size=12),
)
@settings(max_examples=60)
def test_packets_are_found_in_any_pieces(sent, places):
    """Packets are found among any bytes, except those that look like the start of a packet."""
    data = b"".join(
        encode(p.kind, p.session, p.sequence, p.payload) + junk.replace(b"\xa5", b"") for p, junk in sent
    )
    decoder, found = Decoder(), []
    for piece in cut(data, places):
        found += decoder.feed(piece)
    assert found == [packet for packet, _ in sent] and decoder.damaged == 0


@given(PACKETS, PACKETS, st.data())
@settings(max_examples=60)
def test_a_damaged_packet_is_never_taken(first, second, data):
    """A packet with any changed byte is rejected, and the next one is found."""
    good = encode(first.kind, first.session, first.sequence, first.payload)
    at, change = data.draw(st.integers(0, len(good) - 1)), data.draw(st.integers(1, 255))
    bad = good[:at] + bytes([good[at] ^ change]) + good[at + 1 :]
    after = encode(second.kind, second.session, second.sequence, second.payload)
    found = Decoder(300).feed(bad + after)
    assert found == [second]


def test_hostile_lengths_wait_for_nothing():
    """A header that claims more than is taken is skipped at once."""
    header = struct.pack("<BBHH", 130, 1, 0, 65535)
    hostile = b"\xa5\x5a" + header + struct.pack("<I", zlib.crc32(header))
    decoder = Decoder(64)
    packet = Packet(130, 1, 0, b"x" * 15)
    assert decoder.feed(hostile + encode(130, 1, 0, b"x" * 15)) == [packet]
    assert len(decoder) == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_million_random_bytes(seed):
    """Nothing is found, nothing grows, nothing takes long; then a packet is found."""
    chance = np.random.default_rng(seed)
    data = bytearray(chance.integers(0, 256, 1_000_000, np.uint8).tobytes())
    for at in chance.integers(0, len(data) - 20, 3000):  # beginnings, some with a length that holds
        data[at : at + 2] = packets.SYNC
        if at % 2:
            body = struct.pack("<BBHH", 130, 1, 0, int(chance.integers(0, 65536)))
            data[at + 2 : at + 12] = body + struct.pack("<I", zlib.crc32(body))
    decoder = Decoder()
    tracemalloc.start()
    start, begin = time.monotonic(), 0
    while begin < len(data):
        end = begin + int(chance.integers(1, 5000))
        for packet in decoder.feed(bytes(data[begin:end])):
            assert not packet.payload  # of length 0: its header is all there is
        assert len(decoder) < packets.MAX_PAYLOAD + packets.OVERHEAD
        begin = end
    assert time.monotonic() - start < SOON
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()
    decoder.feed(bytes(packets.MAX_PAYLOAD + packets.OVERHEAD))
    assert decoder.feed(encode(1, 2, 3, b"abc")) == [Packet(1, 2, 3, b"abc")]


# Messages


def send(link, numbers, chance, sent):
    """Triggers, and every fourth time a frame."""
    for number in numbers:
        if number % 4:
            link.trigger(number, 3 * number)
            sent["triggers"].append((number, 3 * number))
        else:
            shape = (int(chance.integers(1, 9)), int(chance.integers(1, 17)))
            pixels = chance.integers(0, 256, shape, np.uint8)
            link.frame(number, pixels, wavelength=number % 3)
            sent["shown"].append((number, shape, 8, number % 3, pixels.tobytes()))


def check(firmware, sent):
    assert firmware.shown == sent["shown"]
    assert firmware.triggers == sent["triggers"]


@pytest.mark.parametrize(
    "share, count", [(0.0, 1000), (0.01, 1000), pytest.param(0.01, 10000, marks=pytest.mark.slow)]
)
def test_every_message_once_and_in_order(share, count, monkeypatch):
    """Everything arrives with 1 % of the bytes corrupted, dropped, doubled or delayed, in both directions."""
    if not share:  # an answer that other programs keep waiting is no loss: time is this program's own
        monkeypatch.setattr(link_module, "time", types.SimpleNamespace(perf_counter=time.process_time))
    firmware, sent = Firmware(), {"shown": [], "triggers": []}
    with Board(firmware, share, seed=11) as board:
        link = connected(board)
        assert (link.device.name, link.device.width, link.device.bits) == ("Test device", 64, 8)
        send(link, range(count), np.random.default_rng(3), sent)
        link.finish()
        check(firmware, sent)
        assert link.frames == len(sent["shown"])
        if share:
            done = board.to_device.counts
            assert min(done.values()) > 0.001 * board.received and link.resent > count / 10
        else:
            assert link.resent < count / 10


def test_large_frames_on_a_bad_line():
    """Long packets do not get through: they are cut smaller, also those that are under way."""
    firmware = Firmware(longest=4096, size=(200, 100))
    with Board(firmware, 0.005, seed=5) as board:
        link = connected(board)
        frames = np.random.default_rng(0).integers(0, 256, (3, 100, 200), np.uint8)
        for number, pixels in enumerate(frames):
            link.frame(number, pixels)
        link.finish()
        assert [f[4] for f in firmware.shown] == [f.tobytes() for f in frames]


def test_ten_bits():
    firmware = Firmware(bits=10)
    with Board(firmware) as board:
        link = connected(board)
        pixels = np.arange(64, dtype=np.uint16).reshape(8, 8) * 16
        link.frame(0, pixels, bits=10, wavelength=2)
        link.finish()
        assert firmware.shown == [(0, (8, 8), 10, 2, pixels.astype("<u2").tobytes())]


def test_little_is_added():
    """Long packets: what is sent besides the pixels is under a tenth, so that a line's speed is used."""
    firmware = Firmware(longest=1024, size=(640, 480))
    with Board(firmware) as board:
        link = connected(board)
        pixels = np.zeros((480, 640), np.uint8)
        before = board.received
        for number in range(4):
            link.frame(number, pixels)
        link.finish()
        again = link.resent * (1024 + packets.OVERHEAD)  # where the machine lets the board's thread wait
        assert (board.received - before - again) * 0.9 < 4 * pixels.nbytes


class Fragile(Board):
    """Pulls its own plug after so many bytes."""

    def __init__(self, firmware, after, **others):
        self.after = after
        super().__init__(firmware, **others)

    def _run(self):
        while self.received < self.after and not self._stop.is_set():
            self._step()
        self._close()


@pytest.mark.parametrize("after", [1, 30, 59, 60, 61, 100, 257, 1000, 3001, 20011, 60000])
@pytest.mark.parametrize("restart", [False, True])
def test_unplugged_at_any_point(after, restart):
    """An error within two seconds; plugged in again all goes on, also on a device that lost its memory."""
    firmware, sent = Firmware(longest=512), {"shown": [], "triggers": []}
    chance, link = np.random.default_rng(after), Link(stream=77)
    number, broken = 0, Fragile(firmware, after)
    start = time.monotonic()
    with pytest.raises(DeviceLost):
        link.connect(opened(broken))
        for number in range(100000):
            start = time.monotonic()
            send(link, [number], chance, sent)
    assert time.monotonic() - start < SOON
    broken.unplug()
    link.disconnect()
    if link.device is not None and len(sent["shown"]) + len(sent["triggers"]) == number:
        # the message that was being sent is remembered by the link, though it never was by `send`
        last = link._messages[-1] if link._messages else None
        if number % 4:
            sent["triggers"].append((number, 3 * number))
        elif last is not None:
            _, width, height, bits, wavelength, _, _ = packets.FRAME.unpack(last.head)
            sent["shown"].append((number, (height, width), bits, wavelength, bytes(last.body)))
        number += 1
    before = len(firmware.shown), len(firmware.triggers)
    if restart:
        firmware.restart()
    with Board(firmware) as board:
        link.connect(opened(board))
        send(link, range(number, number + 40), chance, sent)
        link.finish()
    if not restart:
        check(firmware, sent)
        return
    # what was done before the restart, but not reported, is done again: nothing else is
    for kind, done in (("shown", before[0]), ("triggers", before[1])):
        found = getattr(firmware, kind)
        again = len(found) - len(sent[kind])
        assert (
            0 <= again <= 16
            and found[:done] == sent[kind][:done]
            and found[done:] == sent[kind][done - again :]
        )


def test_silence(monkeypatch):
    """A device that stands still is lost; it goes on when it awakes."""
    firmware = Firmware()
    with Board(firmware) as board:
        link = connected(board)
        link.trigger(0, 1)
        link.finish()
        monkeypatch.setattr(link_module, "PATIENCE", 0.5)
        board.mute = True
        start = time.monotonic()
        with pytest.raises(DeviceLost, match="has not answered"):
            link.trigger(1, 1)
            link.finish()
        assert time.monotonic() - start < SOON
        monkeypatch.setattr(link_module, "PATIENCE", SOON)
        board.mute = False
        link.finish()
        assert firmware.triggers == [(0, 1), (1, 1)]


@settings(max_examples=15)
@given(st.binary(min_size=1, max_size=3000), st.integers(0, 2**32 - 1))
def test_replies_of_any_kind(junk, seed):
    """A device that answers with anything, well-formed packets of any content too, is lost or works; it never hangs."""
    chance = np.random.default_rng(seed)

    class Liar(Firmware):
        def receive(self, data):
            answer = super().receive(data)
            kinds = [129, 130, int(chance.integers(0, 256))]
            lies = [self._packet(kind, chance.integers(0, 256, size, np.uint8).tobytes())
                    for kind, size in zip(kinds, (25, 16, int(chance.integers(0, 400))), strict=True)]  # fmt: skip
            return b"".join([junk, *lies, answer][:: int(chance.choice([1, -1]))])

    with Board(Liar()) as board:
        link, start = Link(), time.monotonic()
        try:
            link.connect(opened(board), 0.3)
            for number in range(20):
                link.trigger(number, 1)
            link.finish()
        except DeviceLost:
            pass
        assert time.monotonic() - start < SOON


def test_another_version():
    with Board(Firmware(version=2)) as board, pytest.raises(DeviceLost, match="version 2 .* version 1"):
        connected(board)


def test_nobody_there():
    with Board(None) as board:
        start = time.monotonic()
        with pytest.raises(DeviceLost, match="has not answered for 0.5 s"):
            Link().connect(opened(board), 0.5)
        assert time.monotonic() - start < SOON


def test_focus():
    firmware = Firmware()
    firmware.speed = 5000
    with Board(firmware) as board:
        link = connected(board)
        for position in (2000, -500):
            link.focus(position)
            link.status()
            assert link.moving and link.position != position
            end = time.monotonic() + SOON
            while link.moving:
                assert time.monotonic() < end and -500 <= link.position <= 2000
                time.sleep(0.01)
                link.status()
            assert link.position == position
        assert firmware.positions == [2000, -500]


def test_a_restarted_device_that_hears_an_old_hello():
    """It says that the stream goes on, yet expects the first packet: the frame that was half sent is sent anew."""
    firmware, link = Firmware(longest=256, window=2), Link(stream=5)
    pixels = np.random.default_rng(0).integers(0, 256, (40, 60), np.uint8)
    broken = Fragile(firmware, 1200)
    link.connect(opened(broken))
    with pytest.raises(DeviceLost):
        link.frame(0, pixels)
        link.finish()
    broken.unplug()
    assert 1 < link._messages[0].accepted < 2400
    firmware.restart()
    firmware.receive(encode(1, link._session, 0, packets.HELLO.pack(1, 0, 5)))
    with Board(firmware) as board:
        link.connect(opened(board))
        link.finish()
        assert [f[4] for f in firmware.shown] == [pixels.tobytes()]


def test_many_vain_attempts():
    """A device that runs on takes the next HELLO for a new one, however often it was not heard."""
    firmware, link = Firmware(), Link()
    with Board(firmware) as board:
        link.connect(opened(board))
        board.mute = True
        port = opened(board)
        for _ in range(200):
            with pytest.raises(DeviceLost):
                link.connect(port, 0.004)
        board.mute = False
        link.connect(port, 1.0)
        link.trigger(0, 1)
        link.finish()
        assert firmware.triggers == [(0, 1)]
