"""To the SLM: how much of a serial line's speed is used, what a bad line costs, and 60 pictures a second on a monitor.

``python -m benchmarks slm [serial|noise|monitor|prepare]``
"""

import multiprocessing
import os
import pty
import select
import time
import tty
from collections import Counter

import numpy as np
import serial

from holopath_addon import slm
from holopath_addon.engine import Camera, Hologram, PhaseHologram
from holopath_addon.slm.drivers.link import Link
from tests.slm.device import Board, Firmware

from .parts import joined

SIZE = 1080, 1920
# bits a second: USB full speed in practice, a fast UART, a USB high speed controller, and as fast as the pty goes
LINES = ((8e6, 512), (8e6, 4096), (24e6, 16384), (240e6, 65535), (None, 65535))


def _far_end(master, longest, rate, wanted, done):
    """Reads as fast as the line is, and answers: the protocol, or one byte after so many where `wanted` is given."""
    firmware = Firmware(longest=longest, window=16, size=SIZE[::-1])
    start, total = None, 0
    while not done.is_set():
        if not select.select([master], [], [], 0.05)[0]:
            continue
        data = os.read(master, 4096 if rate and rate < 1e8 else 65536)
        start = start or time.perf_counter()
        total += len(data)
        if rate:  # a line of so many bits a second, eight a byte
            time.sleep(max(0.0, start + 8 * total / rate - time.perf_counter()))
        answer = firmware.receive(data) if wanted is None else b"x" * (total >= wanted)
        firmware.shown.clear()
        if answer:
            os.write(master, answer)


def _line(ours, rate, longest, frames, pixels):
    """Bytes of pixels a second."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    done = multiprocessing.Event()
    wanted = None if ours else frames * pixels.nbytes
    far = multiprocessing.Process(target=_far_end, args=(master, longest, rate, wanted, done))
    far.start()
    # baud only says how much may be under way: a pty has none
    with serial.Serial(os.ttyname(slave), 4000000, timeout=0.002, write_timeout=60) as port:
        start = time.perf_counter()
        if ours:
            link = Link()
            link.connect(port)
            start = time.perf_counter()
            for number in range(frames):
                link.frame(number, pixels)
            link.finish()
        else:
            data = pixels.tobytes()
            for _ in range(frames):
                port.write(data)
            port.timeout = 60
            port.read(1)
        seconds = time.perf_counter() - start
    done.set()
    far.join()
    for end in (master, slave):
        os.close(end)
    return frames * pixels.nbytes / seconds


def serial_table(size):
    """Frames over the protocol against the same bytes over the raw line, in turn."""
    rows = [
        "line (Mbit/s) | longest packet | raw (MB/s) | protocol (MB/s) | ratio",
        "--- | --- | --- | --- | ---",
    ]
    pixels = np.random.default_rng(0).integers(0, 256, size, np.uint8)
    for rate, longest in LINES:
        part = pixels if rate is None or rate > 1e8 else pixels[: size[0] // 4]
        frames = 10 if part is pixels else 4
        raw, ours = zip(
            *(
                (_line(False, rate, longest, frames, part), _line(True, rate, longest, frames, part))
                for _ in range(3)
            ),
            strict=True,
        )
        name = f"{rate / 1e6:.0f}" if rate else "no limit"
        ratio = np.median(np.divide(ours, raw))
        rows.append(
            f"{name} | {longest} | {np.median(raw) / 1e6:.2f} | {np.median(ours) / 1e6:.2f} | {ratio:.2f}"
        )
    return "\n".join(rows)


def noise_table(size):
    """Commands and small frames, every fourth one, over a line that spoils a share of its bytes."""
    count = 10000 if size == SIZE else 100
    rows = ["bytes spoiled | seconds | packets sent again | as sent", "--- | --- | --- | ---"]
    for share in (0.0, 0.001, 0.01):
        firmware, chance, sent = Firmware(), np.random.default_rng(0), []
        with Board(firmware, share, seed=1) as board:
            link = Link()
            link.connect(serial.Serial(board.path, 4000000, timeout=0.002, write_timeout=1.0))
            start = time.perf_counter()
            for number in range(count):
                if number % 4:
                    link.trigger(number, number)
                else:
                    sent.append(chance.integers(0, 256, (8, 16), np.uint8))
                    link.frame(number, sent[-1])
            link.finish()
            seconds = time.perf_counter() - start
        same = [f[4] for f in firmware.shown] == [pixels.tobytes() for pixels in sent]
        same &= [number for number, _ in firmware.triggers] == [n for n in range(count) if n % 4]
        rows.append(f"{share:.1%} | {seconds:.1f} | {link.resent} | {'yes' if same else 'NO'}")
    return "\n".join(rows)


def monitor_table(size):
    """24 pictures in turn, 60 a second, on the monitor that is not the primary one."""
    seconds = 60 if size == SIZE else 1
    rows = ["device | seconds | in time | late | dropped", "--- | --- | --- | --- | ---"]
    driver, told = slm.DisplayDriver(size=SIZE[::-1]), Counter()
    driver.open(60, lambda number, what: told.update([what]))
    shape = driver.info.height, driver.info.width
    chance = np.random.default_rng(0)
    pictures = [slm.Picture(chance.integers(0, 256, shape, np.uint8), n, ((0, 0),)) for n in range(24)]
    start = time.perf_counter()
    for number in range(60 * seconds):
        while driver.show(number, pictures[number % 24]) is False:
            pass
    while driver.close(finish=True) is False:
        pass
    spent = time.perf_counter() - start
    rows.append(f"{driver.info.note} | {spent:.1f} | {told['shown']} | {told['late']} | {told['dropped']}")
    return "\n".join(rows)


def prepare_table(size):
    """Milliseconds to make one picture of phases, as large as they are: what the ring has to keep up with."""
    chance = np.random.default_rng(0)
    data = chance.uniform(0, 2 * np.pi, (8, 1, *size)).astype(np.float32)
    volume = Hologram(size[1], size[0], 8e-6, (520e-9,))
    hologram = PhaseHologram(data, volume, Camera(np.eye(4), 0.7), 0.5, "dpac", (1.0,))
    curve = tuple((n, 2 * np.pi * (n / 255) ** 1.2) for n in range(256))
    correction = chance.uniform(0, 6, size).astype(np.float32)
    measured = slm.Calibration(responses=(slm.Response(520e-9, curve=curve),))
    corrected = slm.Calibration(correction=correction, correction_wavelength=520e-9)
    rows = ["calibration | packing | ms a picture", "--- | --- | ---"]
    for name, calibration, packing in (
        ("none", None, "time"),
        ("measured curve", measured, "time"),
        ("correction", corrected, "time"),
        ("none", None, "color"),
        ("1 bit", slm.Calibration(bits=1), "bits"),
    ):
        sequence = slm.Sequence([hologram], calibration, packing)
        count = min(len(sequence), 6)
        start = time.perf_counter()
        for number in range(count):
            sequence.picture(number)
        rows.append(f"{name} | {packing} | {(time.perf_counter() - start) / count * 1e3:.0f}")
    return "\n".join(rows)


TABLES = {"serial": serial_table, "noise": noise_table, "monitor": monitor_table, "prepare": prepare_table}


def run(*names, pixels=SIZE[1]):
    """Tables, all or those named; `pixels` is the width of pictures. Small ones come with few commands and seconds."""
    size = pixels * SIZE[0] // SIZE[1], pixels
    parts = {
        name: lambda table=TABLES[name], name=name: f"{name}\n\n{table(size)}" for name in names or TABLES
    }
    return joined(parts, between="\n\n")
