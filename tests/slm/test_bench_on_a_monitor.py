"""Calibrating and tuning as on a bench: a monitor, a motor on a serial port, a camera that is another program.

Only light is simulated: the camera takes what stands on the monitor for the SLM's levels.
"""

import contextlib
import socket
import sys
import threading

import mss.tools
import numpy as np
import pytest

pytest.importorskip("termios", reason="There are ptys on Unix alone.")

from holopath_addon import cli, engine, slm
from holopath_addon.engine.waves.gaussian_points import THIRD
from holopath_addon.slm import FocusPlanes, Plane
from holopath_addon.slm.fitting import STAGES
from holopath_addon.slm.patterns import patterns
from tests.monitors import SECOND
from tests.patience import NEVER
from tests.slm.device import Board, Firmware

GREEN, PITCH, FOCI, SIDE = 520e-9, 8e-6, (0.5e-3, 1e-3), 16
POSITIONS = (40, -25)  # of the camera's motor at the foci
SHUTTER = """
import socket, sys
line = socket.socket(socket.AF_UNIX)
line.connect(sys.argv[1])
line.sendall(" ".join(sys.argv[2:]).encode())
sys.exit(line.recv(100).decode() or None)
"""


class Eye:
    """A camera that records the second monitor and the motor at each capture, and the bench's picture of them."""

    def __init__(self, bench, firmware, path):
        self.bench, self.firmware, self.view = bench, firmware, []
        self._door = socket.socket(socket.AF_UNIX)
        self._door.bind(path)
        self._door.listen()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        with contextlib.suppress(OSError), mss.MSS() as screen:
            while True:
                line, _ = self._door.accept()
                with line:
                    file, mm = line.recv(1000).decode().split()
                    try:
                        self._click(screen, file, float(mm) * 1e-3)
                    except Exception as error:
                        line.sendall(repr(error).encode()[:100])

    def _click(self, screen, file, distance):
        shot = screen.grab({"left": 1920, "top": 0, "width": 1920, "height": 1080})
        whole = np.asarray(shot)[..., 0]
        top, left = (n // 2 - SIDE // 2 for n in whole.shape)
        levels = whole[top : top + SIDE, left : left + SIDE]
        around = np.unique(whole[:top])
        self.view.append((levels, distance, self.firmware._now(), tuple(around)))
        picture = self.bench.capture(levels, distance, len(self.view))
        mss.tools.to_png(np.repeat(picture[..., None], 3, -1).tobytes(), picture.shape[::-1], output=file)

    def close(self):
        self._door.shutdown(socket.SHUT_RDWR)  # which wakes the thread
        self._thread.join(NEVER)
        self._door.close()


@pytest.fixture
def bench(two_monitors, tmp_path):
    """The eye, and the words that say where all is."""
    window = slm.PatternWindow(SIDE, PITCH, GREEN)
    found, _ = slm.perturbed_bench(slm.nominal_setup(window, FOCI, (22, 22), (0.95, 0.95)), window, 1)
    found = slm.Bench(found.model, found.phases, found.sensor, found.shape, PITCH, source=THIRD)
    planes = FocusPlanes(tuple(Plane(*pair) for pair in zip(FOCI, POSITIONS, strict=True)))
    planes.save(tmp_path / "planes.json")
    (tmp_path / "shutter.py").write_text(SHUTTER)
    firmware = Firmware()
    firmware.speed = 2000
    eye = Eye(found, firmware, str(tmp_path / "eye"))
    shutter = f"'{sys.executable}' -S '{tmp_path / 'shutter.py'}' '{tmp_path / 'eye'}' {{file}} {{mm}}"
    with Board(firmware) as board:
        words = ["--monitor", SECOND, "--port", board.path, "--focus-planes", str(tmp_path / "planes.json")]
        yield eye, [*words, "--settle", "0.05", "--camera", shutter]
    eye.close()


@pytest.mark.slow
def test_from_the_monitor_to_the_file_and_back_to_the_monitor(bench, tmp_path, monkeypatch):
    """Each pattern stands there, in focus, when the camera looks; so do the frames that are tuned afterwards."""
    monkeypatch.setattr("holopath_addon.slm.fitting.STAGES", STAGES[:1])
    monkeypatch.setattr("holopath_addon.slm.calibrating.MIN_EXPLAINED", -99)
    eye, words = bench
    file = str(tmp_path / "slm.json")
    what = "--wavelength 520 --pitch 8 --window 16 --captures 20".split()
    assert cli.main(["calibrate", *what, *words, "--out", file, "--quiet"]) == 0
    shown = patterns((SIDE, SIDE), 8, PITCH, GREEN, FOCI, 20, 0)
    assert len(eye.view) == len(shown)
    for (levels, distance), (view, mm, position, around) in zip(shown, eye.view, strict=True):
        assert np.array_equal(view, levels) and mm == pytest.approx(distance)
        assert position == POSITIONS[FOCI.index(distance)] and around == (0, 128)

    eye.view.clear()
    rng, frames = np.random.default_rng(0), 2
    volume = engine.Hologram(SIDE, SIDE, PITCH, (GREEN,), depth_far=FOCI[0], depth_near=FOCI[1])
    light = np.exp(2j * np.pi * rng.random((frames, 1, SIDE, SIDE))).astype(np.complex64)
    field = engine.WaveField(light, volume, engine.Camera(np.eye(4), 0.6), 0.5)
    calibration = slm.Calibration.load(file)
    phase = engine.encode(
        field, "joint", levels=calibration.levels_of(volume), display=calibration.display([GREEN])
    )
    field.save(tmp_path / "out" / "wavefield")
    phase.save(tmp_path / "out" / "hologram")
    tune = ["tune", str(tmp_path / "out"), "--calibration", file, "--rounds", "1", "--quiet", *words]
    assert cli.main(tune) == 0
    assert len(eye.view) == 2 * frames * len(FOCI)  # a round, and a last look
    expected = [calibration.levels(frame[0], GREEN) for frame in phase.data]
    for number, (view, mm, position, _) in enumerate(eye.view[: frames * len(FOCI)]):
        assert np.array_equal(view, expected[number % frames]), number
        assert position == POSITIONS[FOCI.index(pytest.approx(mm))]
    report = engine.PhaseHologram.load(tmp_path / "out" / "hologram").report
    assert len(report["tuned"][0]["psnr_db"]) == 2


@pytest.mark.slow
def test_a_camera_that_fails_on_the_bench(bench, tmp_path, capsys):
    """One sentence, and no file."""
    _, words = bench
    words[-1] = f"'{sys.executable}' -c 'raise SystemExit(\"no light\")' {{file}}"
    what = "--wavelength 520 --pitch 8 --window 16 --captures 20 --quiet".split()
    assert cli.main(["calibrate", *what, *words, "--out", str(tmp_path / "slm.json")]) == 2
    assert "took no picture at plane 0: no light" in capsys.readouterr().err
    assert not (tmp_path / "slm.json").exists()
