"""The command `holopath stream`: what it shows, writes and refuses."""

import importlib.util
import json
import math
import os
import re
import shlex
import signal
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("termios", reason="There are ptys on Unix alone.")

from holopath_addon import cli, engine
from holopath_addon.engine.scene import variants
from holopath_addon.slm import (
    Calibration,
    FocusPlanes,
    Plane,
    Response,
    Sequence,
    SerialDriver,
    stream,
    streaming,
)
from holopath_addon.slm.drivers import link as link_module
from holopath_addon.workflow import output
from tests.patience import SOON
from tests.slm.device import Board, Firmware

WIDTH, HEIGHT = 24, 16
WAVELENGTHS = (640e-9, 516.5e-9)
FAR, NEAR = 1e-3, 2e-3
FRAMES, TRIGGERS, FOCUS = 1, 2, 4
CAMERA = """
import sys, time
file, plane, mm = sys.argv[1:4]
with open(file, "w") as picture:
    picture.write(f"{plane} {mm} {time.monotonic()}")
"""


def levels_of(seed=1, frames=2):
    """Any levels of 8 bits, shape (frame, wavelength, y, x)."""
    shape = (frames, len(WAVELENGTHS), HEIGHT, WIDTH)
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


def hologram_of(levels):
    grid = engine.Hologram(WIDTH, HEIGHT, 8e-6, WAVELENGTHS, depth_far=FAR, depth_near=NEAR)
    data = (levels * (2 * math.pi / 256)).astype(np.float32)
    return engine.PhaseHologram(data, grid, engine.Camera(np.eye(4), 0.5), 0.5, "dpac", (0.7, 1.2))


@pytest.fixture
def folder(tmp_path):
    """An output folder as `holopath render --encode` leaves it, but for the field."""
    path = tmp_path / "out"
    hologram_of(levels_of()).save(path / "hologram")
    output.write_report(path, {})
    return path


@pytest.fixture
def board():
    with Board(Moved(size=(WIDTH, HEIGHT))) as found:
        yield found


class Moved(Firmware):
    """Notes when each motion of the focus ends."""

    def __init__(self, **options):
        self.arrivals = []
        super().__init__(**options)

    def _do(self, kind, payload):
        super()._do(kind, payload)
        if kind == 5:
            self.arrivals.append(self.arrival)


def run(*words):
    return cli.main(["stream", *map(str, words)])


def everything(folder):
    """Paths and contents."""
    return {p.relative_to(folder): p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


def one_line(capfd, status, says, expected_status=2):
    """An error is one line that says what is wrong."""
    described = capfd.readouterr()
    lines = [line for line in described.err.splitlines() if line.startswith("holopath: ")]
    assert status == expected_status and len(lines) == 1 and "Traceback" not in described.err, described.err
    assert re.search(says, lines[0]), lines[0]
    assert "a bug in HoloPath" not in lines[0] and described.out == ""


def read(path):
    mi = variants.bitmaps()
    return np.array(mi.Bitmap(str(path)))


# Files


def test_files(folder, capfd):
    assert run(folder, "--driver", "files") == 0
    pictures = folder / "pictures"
    assert len(list(pictures.iterdir())) == 5
    for n, levels in enumerate(levels_of().reshape(4, HEIGHT, WIDTH)):
        np.testing.assert_array_equal(read(pictures / f"picture_{n:06d}.png"), levels)
    described = capfd.readouterr()
    assert re.search(r"100% Done: 4 shown.*0 late, 0 dropped", described.err) and described.out == ""


def test_the_output_folder_stays_holopaths_own(folder):
    """Pictures in it do not keep `holopath render` from replacing it."""
    assert run(folder, "--driver", "files") == 0
    with output.output_folder(folder):
        pass


def test_files_of_many_kinds(folder, tmp_path):
    """Raw, packed, in another order, two rounds, with a rate; from the hologram's own folder."""
    levels = levels_of()
    words = ["--driver", "files", "--packing", "color", "--order", "GBR", "--kind", "raw", "--loops", "2"]
    assert run(folder / "hologram", *words, "--rate", "500", "--out", tmp_path / "raw", "--quiet") == 0
    described = json.loads((tmp_path / "raw" / "pictures.json").read_text())
    assert (described["pictures"], described["channels"], described["rate_hz"]) == (8, 3, 500)
    data = np.frombuffer((tmp_path / "raw" / "pictures.raw").read_bytes(), np.uint8)
    data = data.reshape(8, HEIGHT, WIDTH, 3)
    shown = levels.reshape(4, HEIGHT, WIDTH)
    for n in range(8):
        first = [shown[(3 * n + k) % 4] for k in range(3)]
        np.testing.assert_array_equal(data[n], np.stack([first[2], first[0], first[1]], axis=-1))


@pytest.mark.parametrize(("words", "bits"), [(["--bits", "4"], 4), (["--packing", "bits"], 1)])
def test_bits(words, bits, folder, tmp_path):
    assert run(folder, "--driver", "files", *words, "--out", tmp_path / "o", "--quiet") == 0
    found = read(tmp_path / "o" / "picture_000000.png")
    levels = levels_of().reshape(4, HEIGHT, WIDTH).astype(int)
    shown = [found]
    if bits == 1:
        shown = [(found[..., n // 8] >> n % 8) & 1 for n in range(24)]
    assert np.max(shown) == 2**bits - 1
    for n, level in enumerate(shown):
        away = (level.astype(int) * 2 ** (8 - bits) - levels[n % 4] + 128) % 256 - 128
        assert np.abs(away).max() <= 2 ** (7 - bits)  # half a step, around the circle


@pytest.mark.parametrize("packing", ["slm-200", "R7-0,G7-6"])
def test_ten_bits_of_channels_and_back(packing, folder, tmp_path):
    """A calibration of 10 bits that makes 1.25 turns; the phases that its levels have are those that were stored."""
    Calibration(bits=10, responses=(Response(WAVELENGTHS[0], 1.25),)).save(tmp_path / "device.json")
    words = ["--calibration", tmp_path / "device.json", "--packing", packing, "--out", tmp_path / "o"]
    assert run(folder, "--driver", "files", *words, "--quiet") == 0
    pictures = [str(path) for path in sorted((tmp_path / "o").glob("*.png"))]
    assert len(pictures) == 4
    described = [
        "--packing",
        packing,
        "--pitch",
        "8",
        "--wavelengths",
        "640",
        "--out",
        str(tmp_path / "again"),
    ]
    assert cli.main(["import", pictures[0], *described, "--quiet"]) == 0
    levels = engine.PhaseHologram.load(tmp_path / "again" / "hologram").data[0, 0] * (1024 / (2 * math.pi))
    away = np.mod(levels * 1.25 / 4 - levels_of()[0, 0] + 128, 256) - 128
    assert np.abs(away).max() <= 0.5 * 1.25 / 4 + 0.01  # half a level of 1024, in levels of 256
    assert run(folder, "--driver", "virtual", *words[:-2], "--quiet") == 0


def test_calibration(folder, tmp_path):
    """Mirrored, on a larger device."""
    Calibration(size=(WIDTH + 4, HEIGHT + 2), flip_x=True, shift=(1, 0)).save(tmp_path / "device.json")
    words = ["--driver", "files", "--calibration", tmp_path / "device.json", "--out", tmp_path / "o"]
    assert run(folder, *words, "--quiet") == 0
    expected = np.zeros((HEIGHT + 2, WIDTH + 4), int)
    expected[1:-1, 3 : 3 + WIDTH] = levels_of()[0, 0, :, ::-1]
    np.testing.assert_array_equal(read(tmp_path / "o" / "picture_000000.png"), expected)


def test_phases_of_a_calibrated_device_without_its_calibration(tmp_path, capfd):
    """A note says so, and none where it is there, or where no calibration was in the encoding."""
    hologram = hologram_of(levels_of())
    Calibration(responses=(Response(640e-9),)).save(tmp_path / "device.json")
    Calibration(flip_x=True).save(tmp_path / "mirrored.json")
    words = [tmp_path / "out", "--driver", "virtual"]
    for report, more, noted in (
        ({"measured_levels": True}, ["--bits", "8"], True),
        ({"display_model": True}, [], True),
        ({"measured_levels": True}, ["--calibration", tmp_path / "device.json"], False),
        ({"measured_levels": True}, ["--calibration", tmp_path / "mirrored.json"], False),
        ({"measured_levels": False, "display_model": False}, [], False),
    ):
        replace(hologram, report=report).save(tmp_path / "out" / "hologram")
        assert run(*words, *more) == 0
        described = capfd.readouterr().err
        assert ("note: The phases are for the levels of a calibrated device" in described) == noted, report
        assert ("--calibration" in described) == noted


def test_animation(tmp_path):
    """Frame after frame, each twice; what else lies there does not matter."""
    frames = {2: levels_of(2), 9: levels_of(9), 10: levels_of(10), 10000: levels_of(4)}
    for number, levels in frames.items():
        hologram_of(levels).save(output.frame_folder(tmp_path / "film", number) / "hologram")
    (tmp_path / "film" / "frame_notes").mkdir()
    words = ["--driver", "files", "--kind", "raw", "--repeats", "2", "--quiet"]
    assert run(tmp_path / "film", *words, "--out", tmp_path / "o") == 0
    data = np.frombuffer((tmp_path / "o" / "pictures.raw").read_bytes(), np.uint8)
    expected = [levels for number in (2, 9, 10, 10000) for levels in [frames[number]] * 2]
    np.testing.assert_array_equal(data, np.ravel(expected))


# The virtual bench


def ideal(depths):
    """The engine's view, as red, green and blue."""
    hologram = hologram_of(levels_of())
    images = engine.reconstruct(hologram.field(engine.Modulator(bits=8)), depths)
    return [engine.to_rgb(image, WAVELENGTHS) for image in images]


def depth_of(distance):
    """World depth of a distance from the SLM, by the formula."""
    return (NEAR - FAR) * 0.5 / (distance - FAR) if distance > FAR else math.inf


@pytest.mark.parametrize("packing", ["time", "color"])
def test_captures_of_the_virtual_bench(packing, folder, tmp_path):
    """Five planes over the volume, linear and to be looked at."""
    words = ["--driver", "virtual", "--packing", packing, "--captures", tmp_path / "seen", "--quiet"]
    assert run(folder, *words) == 0
    distances = [1e-3, 1.25e-3, 1.5e-3, 1.75e-3, 2e-3]
    stems = [f"plane_{n}_{z * 1e3:.4g}mm" for n, z in enumerate(distances)]
    names = sorted(f"{stem}.{kind}" for stem in stems for kind in ("exr", "png"))
    assert sorted(path.name for path in (tmp_path / "seen").iterdir()) == names
    pictures = ideal([depth_of(z) for z in distances])
    white = np.percentile(pictures, 99)
    for stem, picture in zip(stems, pictures, strict=True):
        found = read(tmp_path / "seen" / f"{stem}.exr")
        np.testing.assert_allclose(found, picture, rtol=1e-3, atol=1e-3 * picture.max())
        linear = np.clip(picture / white, 0, 1)
        shown = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055) * 255
        assert np.abs(read(tmp_path / "seen" / f"{stem}.png") - shown).max() < 1.5


def test_captures_at_planes_of_ones_own(folder, tmp_path):
    """Captures on the virtual bench need no positions, and the right calibration gives the ideal picture."""
    FocusPlanes((Plane(1.3e-3), Plane(1.6e-3))).save(tmp_path / "planes.json")
    Calibration(size=(WIDTH + 8, HEIGHT + 8), flip_y=True, shift=(2, -1)).save(tmp_path / "device.json")
    words = [
        "--driver",
        "virtual",
        "--focus-planes",
        tmp_path / "planes.json",
        "--captures",
        tmp_path / "seen",
    ]
    assert run(folder, *words, "--calibration", tmp_path / "device.json", "--quiet") == 0
    assert len(list((tmp_path / "seen").iterdir())) == 4
    picture = ideal([depth_of(1.6e-3)])[0]
    found = read(tmp_path / "seen" / "plane_1_1.6mm.exr")
    np.testing.assert_allclose(found, picture, rtol=1e-3, atol=1e-3 * picture.max())


def test_virtual_bench_alone(folder, capfd):
    assert run(folder, "--driver", "virtual") == 0
    assert "Done: 4 shown" in capfd.readouterr().err


# A device on a serial line


def test_serial(board, folder):
    """Every picture, once and in order, with its number and wavelength."""
    assert run(folder, "--driver", "serial", "--port", board.path, "--loops", "2", "--quiet") == 0
    levels = levels_of()
    expected = [(n, (HEIGHT, WIDTH), 8, n % 2, levels[n // 2 % 2, n % 2].tobytes()) for n in range(8)]
    assert board.firmware.shown == expected and board.firmware.triggers == []


def test_serial_with_triggers(board, folder):
    """A pulse for each picture."""
    words = ["--driver", "serial", "--port", board.path, "--loops", "1", "--trigger", "--pulse", "250"]
    assert run(folder, *words, "--rate", "100", "--quiet") == 0
    assert [shown[0] for shown in board.firmware.shown] == [0, 1, 2, 3]
    assert board.firmware.triggers == [(n, 250) for n in range(4)]


def test_triggers_of_another_controller(board, folder):
    """The pictures go elsewhere."""
    words = ["--driver", "virtual", "--port", board.path, "--trigger", "--quiet"]
    assert run(folder, *words) == 0
    assert [number for number, _ in board.firmware.triggers] == [0, 1, 2, 3] and board.firmware.shown == []


def test_a_device_that_shows_no_frames(folder, capfd):
    """Its firmware takes them, and counts none."""

    class Blind(Firmware):
        def _do(self, kind, payload):
            super()._do(kind, payload)
            self.frames = min(self.frames, 2)

    with Board(Blind(size=(WIDTH, HEIGHT))) as board:
        status = run(folder, "--driver", "serial", "--port", board.path, "--loops", "1", "--quiet")
    one_line(capfd, status, "device 'Test device' on .* has received picture 2, and does not show it")


def test_larger_device(folder):
    with Board(Firmware(size=(WIDTH + 6, HEIGHT))) as board:
        words = ["--driver", "serial", "--port", board.path, "--loops", "1", "--quiet"]
        assert run(folder, *words) == 0
        pixels = np.frombuffer(board.firmware.shown[0][4], np.uint8).reshape(HEIGHT, WIDTH + 6)
    np.testing.assert_array_equal(pixels[:, 3:-3], levels_of()[0, 0])
    assert not pixels[:, :3].any() and not pixels[:, -3:].any()


@pytest.mark.parametrize(
    ("options", "words", "says"),
    [
        ({"can": TRIGGERS | FOCUS}, [], "'Test device' on .* takes no frames"),
        ({"can": FRAMES}, ["--trigger"], "takes no triggers"),
        ({"size": (8, 8)}, [], f"{WIDTH} x {HEIGHT} pixels.*8 x 8"),
        ({"bits": 4}, ["--bits", "8"], "8 bits, Test device takes 4"),
        ({}, ["--packing", "color"], "one hologram at a time, not 3"),
        ({}, ["--trigger", "--pulse", "-5"], "pulse"),
        ({}, ["--trigger", "--pulse", "5000000000"], "pulse"),
    ],
)
def test_devices_that_do_not_fit(options, words, says, folder, capfd):
    with Board(Firmware(**{"size": (WIDTH, HEIGHT)} | options)) as board:
        start = time.monotonic()
        status = run(folder, "--driver", "serial", "--port", board.path, "--loops", "1", *words)
        one_line(capfd, status, says)
        assert time.monotonic() - start < SOON and len(board.firmware.shown) <= 1


@pytest.mark.parametrize("loops", ["0", "9999"])
def test_interrupted(loops, board, folder, capfd):
    """Ctrl-C is how a show without end ends; one with an end is cancelled."""

    def interrupt():
        while len(board.firmware.shown) < 5:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    start = time.monotonic()
    status = run(folder, "--driver", "serial", "--port", board.path, "--loops", loops, "--rate", "50")
    assert time.monotonic() - start < SOON
    if loops == "0":
        described = capfd.readouterr().err
        assert status == 0 and re.search(r"Done: \d+ shown", described) and "holopath: " not in described
    else:
        one_line(capfd, status, r"Canceled: \d+ shown", expected_status=1)
    shown = [number for number, *_ in board.firmware.shown]
    assert shown == list(range(len(shown))) and len(shown) > 3


class Interrupted(Moved):
    """The line is dead for a while after so many bytes."""

    def __init__(self, after, **options):
        super().__init__(**options)
        self.after, self.board = after, None

    def receive(self, data):
        answer = super().receive(data)
        self.after -= len(data)
        if self.after < 0:
            self.after = math.inf
            self.board.mute = True
            threading.Timer(0.2, lambda: setattr(self.board, "mute", False)).start()
        return answer


@pytest.mark.parametrize(
    ("after", "trigger"), [(100, False), (600, False), (1000, False), (430, True), (1000, True)]
)
def test_line_is_dead_for_a_while(after, trigger, monkeypatch):
    """Each picture and pulse is accepted once, if the line dies within a picture, between two or in a pulse."""
    monkeypatch.setattr(link_module, "PATIENCE", 0.1)
    monkeypatch.setattr(streaming, "RETRY_INTERVAL", 0.05)
    firmware = Interrupted(after, size=(WIDTH, HEIGHT))
    with Board(firmware) as board:
        firmware.board = board
        driver = SerialDriver(board.path)
        sequence = Sequence([hologram_of(levels_of())])
        pulse = driver.controller.trigger if trigger else None
        counts = stream(sequence, driver, trigger=pulse, patience=SOON)
    assert counts.reconnected >= 1 and counts.shown == 4
    assert [(number, pixels) for number, _, _, _, pixels in firmware.shown] == [
        (n, levels_of()[n // 2, n % 2].tobytes()) for n in range(4)
    ]
    assert [number for number, _ in firmware.triggers] == [0, 1, 2, 3] * trigger


# Pictures by a camera


@pytest.fixture
def camera(tmp_path):
    """The command of a camera that writes plane, distance and time."""
    (tmp_path / "camera.py").write_text(CAMERA)
    words = [sys.executable, "-I", "-S", str(tmp_path / "camera.py")]
    return f"{shlex.join(words)} {{file}} {{plane}} {{mm}}"


@pytest.fixture
def planes(tmp_path):
    """The five planes, calibrated."""
    found = FocusPlanes.spread()
    for number in range(5):
        found = found.with_position(number, 100 * (number + 1))
    found.save(tmp_path / "planes.json")
    return tmp_path / "planes.json"


def test_captures_by_a_camera(board, folder, tmp_path, camera, planes):
    """A capture at every plane waits until the focus has stopped there, while the hologram is shown."""
    board.firmware.speed = 1000
    words = [
        "--driver",
        "serial",
        "--port",
        board.path,
        "--captures",
        tmp_path / "seen",
        "--focus-planes",
        planes,
    ]
    assert run(folder, *words, "--camera", camera, "--rate", "100", "--quiet") == 0
    assert board.firmware.positions == [100, 200, 300, 400, 500]
    names = [f"plane_{n}_{mm}mm.png" for n, mm in enumerate(["80", "81.25", "82.5", "83.75", "85"])]
    assert sorted(path.name for path in (tmp_path / "seen").iterdir()) == names
    for number, name in enumerate(names):
        plane, mm, moment = (tmp_path / "seen" / name).read_text().split()
        assert (int(plane), float(mm)) == (number, 80 + 1.25 * number)
        assert float(moment) >= board.firmware.arrivals[number]
    shown = [number for number, *_ in board.firmware.shown]
    assert shown == list(range(len(shown))) and len(shown) > 40


def test_captures_of_a_device_without_a_pause(board, folder, tmp_path, camera, planes):
    """Pictures as fast as it takes them do not keep the focus waiting."""
    words = [
        "--driver",
        "serial",
        "--port",
        board.path,
        "--captures",
        tmp_path / "seen",
        "--focus-planes",
        planes,
    ]
    start = time.monotonic()
    assert run(folder, *words, "--camera", camera, "--quiet") == 0
    assert board.firmware.positions == [100, 200, 300, 400, 500] and time.monotonic() - start < SOON


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("{python} -c 'import sys; sys.exit(\"no light\")'", "took no picture at plane 0: no light"),
        ("{python} -c pass", "wrote no file"),
        ("/nowhere/camera {{file}}", "does not run"),
        ("{python} 'unclosed", "does not run"),
        ("{python} {{nothing}}", "does not run"),
        ("{python} {{file.nothing}}", "does not run"),
        (" ", "camera"),
    ],
)
def test_cameras_that_take_no_picture(command, says, board, folder, tmp_path, planes, capfd):
    words = [
        "--driver",
        "serial",
        "--port",
        board.path,
        "--captures",
        tmp_path / "seen",
        "--focus-planes",
        planes,
    ]
    command = command.format(python=shlex.join([sys.executable, "-I", "-S"]))
    one_line(capfd, run(folder, *words, "--camera", command), says)
    assert not (tmp_path / "seen").exists() or list((tmp_path / "seen").iterdir()) == []


def test_a_picture_of_an_earlier_time_is_none(board, folder, tmp_path, planes, capfd):
    """A camera that writes nothing is found out, though a file of that name is there."""
    (tmp_path / "seen").mkdir()
    (tmp_path / "seen" / "plane_0_80mm.png").write_text("old")
    words = [
        "--driver",
        "serial",
        "--port",
        board.path,
        "--captures",
        tmp_path / "seen",
        "--focus-planes",
        planes,
    ]
    command = f"{shlex.join([sys.executable, '-I', '-S'])} -c pass"
    one_line(capfd, run(folder, *words, "--camera", command), "took no picture at plane 0")


@pytest.mark.parametrize(
    ("lacks", "says"),
    [
        ("--focus-planes", "focus planes are missing"),
        ("--camera", "camera is missing"),
        ("positions", r"Focus plane 0 \(80 mm\) has no motor position yet"),
    ],
)
def test_captures_that_lack_something(lacks, says, board, folder, tmp_path, camera, planes, capfd):
    if lacks == "positions":
        FocusPlanes.spread().save(planes)
    words = ["--driver", "serial", "--port", board.path, "--captures", tmp_path / "seen"]
    words += [] if lacks == "--focus-planes" else ["--focus-planes", planes]
    words += [] if lacks == "--camera" else ["--camera", camera]
    one_line(capfd, run(folder, *words), says)
    assert board.firmware.shown == board.firmware.positions == [] and not (tmp_path / "seen").exists()


@pytest.mark.parametrize(
    ("can", "says"), [(TRIGGERS | FOCUS, "takes no frames"), (FRAMES | TRIGGERS, "takes no focus commands")]
)
def test_captures_with_a_device_that_cannot(can, says, folder, tmp_path, camera, planes, capfd):
    with Board(Firmware(size=(WIDTH, HEIGHT), can=can)) as board:
        words = ["--driver", "serial", "--port", board.path, "--captures", tmp_path / "seen"]
        one_line(capfd, run(folder, *words, "--focus-planes", planes, "--camera", camera), says)
        assert board.firmware.positions == []
    assert not (tmp_path / "seen").exists() or list((tmp_path / "seen").iterdir()) == []


def test_captures_without_the_port(folder, tmp_path, camera, planes, capfd):
    words = ["--driver", "serial", "--port", tmp_path / "none", "--captures", tmp_path / "seen"]
    status = run(folder, *words, "--focus-planes", planes, "--camera", camera)
    one_line(capfd, status, "none cannot be opened.*holopath devices")


# Refusals


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["{tmp}/missing"], "missing does not exist"),
        (["{tmp}"], "holds no hologram"),
        (["{tmp}/damaged"], "damaged hologram"),
        (["{tmp}/film"], "Hologram 1 differs from the first"),
        (["{out}", "--rate", "0"], "positive rate.*got 0"),
        (["{out}", "--rate", "-5"], "positive rate.*got -5"),
        (["{out}", "--rate", "nan"], "positive rate.*got nan"),
        (["{out}", "--rate", "inf"], "positive rate.*got inf"),
        (["{out}", "--rate", "fast"], "invalid float"),
        (["{out}", "--loops", "-1"], "0 or more rounds, got -1"),
        (["{out}", "--repeats", "0"], "at least 1"),
        (["{out}", "--bits", "0"], "1 to 16"),
        (["{out}", "--bits", "10", "--packing", "color"], "at most 8 bits"),
        (["{out}", "--bits", "8", "--packing", "bits"], "at most 1 bit"),
        (["{out}", "--bits", "8", "--packing", "slm-200"], "levels of 10 bits, got 8"),
        (["{out}", "--packing", "R5-7"], "highest bit of a level first, got R5-7"),
        (["{out}", "--packing", "color", "--order", "RGG"], "order of the channels R, G and B"),
        (["{out}", "--packing", "magic"], "no packing magic: choose one of time"),
        (["{out}", "--kind", "tiff"], "invalid choice"),
        (["{out}", "--driver", "magic"], "invalid choice"),
        (["{out}", "--calibration", "{tmp}/missing.json"], "missing.json cannot be read"),
        (["{out}", "--calibration", "{tmp}/damaged.json"], "damaged.json cannot be read"),
        (["{out}", "--calibration", "{tmp}/small.json"], "24 x 16 pixels, the device only 8 x 8"),
        (["{out}", "--driver", "slmsuite", "--options", "no"], "JSON object, got no"),
        (["{out}", "--driver", "slmsuite", "--options", "[1]"], "options as a JSON object"),
        pytest.param(
            ["{out}", "--driver", "slmsuite", "--device", "pluto"],
            "Expected a device of slmsuite .*got 'pluto'",
            marks=pytest.mark.oracle,  # slmsuite knows
        ),
        (["{out}", "--driver", "serial", "--port", "{tmp}/none"], "none cannot be opened"),
        (["{out}", "--driver", "serial", "--port", "{tmp}/none", "--baud", "3"], "got 3"),
        (["{out}", "--driver", "virtual", "--trigger", "--port", "{tmp}/none"], "none cannot be opened"),
        (["{out}", "--out", "{tmp}/film"], "something other than a sequence"),
        (
            ["{out}", "--driver", "virtual", "--captures", "{tmp}/seen", "--focus-planes", "{tmp}/none"],
            "cannot be read",
        ),
        ([], "required"),
    ],
)
def test_refusals(words, says, folder, tmp_path, capfd):
    for number, size in ((1, (8, 8)), (2, (8, 9))):
        grid = engine.Hologram(*size, 8e-6, WAVELENGTHS[:1], depth_far=FAR, depth_near=NEAR)
        data = np.zeros((1, 1, *size[::-1]), np.float32)
        camera = engine.Camera(np.eye(4), 0.5)
        other = engine.PhaseHologram(data, grid, camera, 0.5, "dpac", (1.0,))
        other.save(output.frame_folder(tmp_path / "film", number) / "hologram")
    hologram_of(levels_of()).save(tmp_path / "damaged")
    (tmp_path / "damaged" / "phase.npy").write_bytes(b"no")
    (tmp_path / "damaged.json").write_text("{")
    Calibration(size=(8, 8)).save(tmp_path / "small.json")
    before = everything(tmp_path)
    words = [word.format(tmp=tmp_path, out=folder) for word in words]
    words += [] if "--driver" in words or not words else ["--driver", "files"]
    one_line(capfd, run(*words), says)
    assert everything(tmp_path) == before


def test_slmsuite_is_absent(folder, capfd, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *words: None if name == "slmsuite" else find(name)
    )
    one_line(capfd, run(folder, "--driver", "slmsuite"), "`pip install slmsuite`")


def test_quiet(folder, tmp_path, capfd):
    assert run(folder, "--driver", "files", "--out", tmp_path / "o", "--quiet") == 0
    assert capfd.readouterr() == ("", "")


def test_files_for_micromirrors(folder, tmp_path):
    """Four holograms in 24 planes of twice as many pixels; without the mirrors' heights they are refused."""
    words = ["--driver", "files", "--packing", "plm-047", "--out", tmp_path / "o", "--quiet"]
    Calibration(bits=4, flip_x=True).save(tmp_path / "flips.json")
    for more in ((), ("--bits", "4"), ("--calibration", tmp_path / "flips.json")):
        assert run(folder, *words, *more) == 2 and not (tmp_path / "o").exists()
    heights = tuple((n, 0.35 * n) for n in range(16))
    Calibration(bits=4, responses=(Response(640e-9, curve=heights),)).save(tmp_path / "plm.json")
    assert run(folder, *words, "--calibration", tmp_path / "plm.json") == 0
    found = read(tmp_path / "o" / "picture_000000.png")
    assert found.shape == (2 * HEIGHT, 2 * WIDTH, 3) and len(list((tmp_path / "o").iterdir())) == 2


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["--out", "pictures"], "--out"),
        (["--driver", "virtual", "--kind", "raw"], "--kind"),
        (["--driver", "files", "--pulse", "5"], "--pulse"),
        (["--driver", "files", "--trigger"], "--trigger"),
        (["--camera", "true"], "--camera"),
        (["--focus-planes", "planes.json"], "--focus-planes"),
        (["--driver", "files", "--order", "BGR"], "--order"),
        (["--driver", "serial", "--captures", "c", "--loops", "2"], "--loops"),
    ],
)
def test_options_without_effect(folder, capfd, words, option):
    one_line(capfd, run(folder, *words), f"{option} would have no effect here")


def test_captures_of_a_film_on_the_virtual_bench(tmp_path, capfd):
    """It keeps one hologram, the last."""
    for number in (1, 2):
        hologram_of(levels_of()).save(output.frame_folder(tmp_path / "film", number) / "hologram")
    words = ["--driver", "virtual", "--captures", tmp_path / "seen"]
    one_line(capfd, run(tmp_path / "film", *words), "Expected one hologram for captures.*got 2")
    assert not (tmp_path / "seen").exists()
