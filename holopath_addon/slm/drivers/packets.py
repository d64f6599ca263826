"""Packets of the serial protocol: encoding, and decoding of damaged streams of bytes.

docs/serial-protocol.md specifies the protocol. All numbers are little-endian.
"""

from __future__ import annotations

import enum
import struct
import zlib
from dataclasses import dataclass

VERSION = 1
SYNC = b"\xa5\x5a"
# sync, kind, session, sequence, length, CRC-32 of the six bytes in between
HEADER = struct.Struct("<2sBBHHI")
CHECK = struct.Struct("<I")  # CRC-32 of the payload; absent without a payload
OVERHEAD = HEADER.size + CHECK.size
MAX_PAYLOAD = 0xFFFF  # bytes

HELLO = struct.Struct("<BBI")  # version, 0, stream
FRAME = struct.Struct("<IHHBBII")  # number, width, height, bits, wavelength, bytes, CRC-32 of them all
PART = struct.Struct("<I")  # bytes of the frame before this part
TRIGGER = struct.Struct("<II")  # number, microseconds
FOCUS = struct.Struct("<i")  # position
# version, 1 if the stream goes on, longest payload, window, next sequence, frames, position, width, height, bits, can
WELCOME = struct.Struct("<BBHHHIiHHBB")  # and the name, UTF-8
# next sequence, 1 if something was damaged or missing, 1 in motion, frames, triggers, position
REPORT = struct.Struct("<HBBIIi")


class Kind(enum.IntEnum):
    """Kinds of packets: below 128 to the device, above from it."""

    HELLO = 1
    FRAME = 2
    PART = 3
    TRIGGER = 4
    FOCUS = 5
    STATUS = 6
    WELCOME = 129
    REPORT = 130


class Can(enum.IntFlag):
    """Abilities of a device."""

    FRAMES = 1
    TRIGGERS = 2
    FOCUS = 4


@dataclass(frozen=True)
class Packet:
    """A complete packet.

    Attributes
    ----------
    kind, session, sequence : int
        See `encode`.
    payload : bytes
    """

    kind: int
    session: int
    sequence: int
    payload: bytes


def encode(kind: int, session: int, sequence: int, *payload) -> bytes:
    """Encode a packet.

    Parameters
    ----------
    kind : int
        A `Kind`.
    session : int
        Number of the session, 0 to 255.
    sequence : int
        Number of the packet, 0 to 65535.
    *payload : bytes-like
        Pieces of the payload, together at most `MAX_PAYLOAD` bytes.

    Returns
    -------
    bytes
    """
    length = sum(map(len, payload))
    body = struct.pack("<BBHH", kind, session, sequence, length)
    head = SYNC + body + CHECK.pack(zlib.crc32(body))
    if not length:
        return head
    check = 0
    for piece in payload:
        check = zlib.crc32(piece, check)
    return b"".join((head, *payload, CHECK.pack(check)))


class Decoder:
    """A decoder of packets in a stream of any bytes.

    Memory is bounded by the longest accepted packet and the bytes fed at once.

    Parameters
    ----------
    max_payload : int
        Bytes; packets that claim more are skipped.

    Attributes
    ----------
    damaged : int
        Number of packets whose check failed.
    """

    def __init__(self, max_payload: int = MAX_PAYLOAD) -> None:
        self._max_payload = max_payload
        self._buffer = bytearray()
        self.damaged = 0

    def feed(self, data: bytes) -> list[Packet]:
        """Add bytes to the stream, and return the packets that they complete.

        After a damaged packet the search resumes at its second byte, so that no complete packet is lost.

        Returns
        -------
        list of Packet
        """
        buffer, packets, at = self._buffer, [], 0
        buffer += data
        while True:
            at = buffer.find(SYNC, at)
            if at < 0:
                at = len(buffer) - buffer.endswith(SYNC[:1])
                break
            if len(buffer) - at < HEADER.size:
                break
            _, kind, session, sequence, length, check = HEADER.unpack_from(buffer, at)
            if zlib.crc32(buffer[at + 2 : at + 8]) != check or length > self._max_payload:
                self.damaged += 1
                at += 1
                continue
            begin = at + HEADER.size
            if not length:
                packets.append(Packet(kind, session, sequence, b""))
                at = begin
                continue
            end = begin + length
            if len(buffer) < end + CHECK.size:
                break
            payload = bytes(memoryview(buffer)[begin:end])
            if zlib.crc32(payload) != CHECK.unpack_from(buffer, end)[0]:
                self.damaged += 1
                at += 1
                continue
            packets.append(Packet(kind, session, sequence, payload))
            at = end + CHECK.size
        del buffer[:at]
        return packets

    def __len__(self) -> int:
        """Number of bytes of an incomplete packet."""
        return len(self._buffer)
