"""The operators of the display device, against a virtual bench, files and a board behind a pty."""

import json
import sys

import bpy
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.operators import devices, long_modal, session
from holopath_addon.workflow import output
from tests.slm.device import Board, Firmware

SIZE = 64


@pytest.fixture
def phase():
    """A hologram of random phases; each of its pictures is another."""
    volume = engine.Hologram(SIZE, SIZE, 8e-6, (640e-9, 520e-9), depth_far=80e-3, depth_near=85e-3)
    data = np.random.default_rng(5).uniform(0, 2 * np.pi, (2, 2, SIZE, SIZE)).astype(np.float32)
    return engine.PhaseHologram(data, volume, engine.Camera(np.eye(4), 0.7), 0.5, "dpac", (1.0, 0.5))


@pytest.fixture
def device(scene, phase):
    """Settings of the device, with a hologram to show."""
    session.keep_phase(phase)
    yield scene.holopath.device
    session.keep_phase(None)


def image():
    block = bpy.data.images[devices.CAMERA]
    pixels = np.empty(4 * block.size[0] * block.size[1], np.float32)
    block.pixels.foreach_get(pixels)
    return pixels.reshape(block.size[1], block.size[0], 4)[::-1]


def test_nothing_to_show(scene):
    assert not bpy.ops.holopath.stream.poll()
    scene.holopath.device.driver = "virtual"
    with pytest.raises(RuntimeError, match="no focus planes"):
        bpy.ops.holopath.capture()


def test_numbers_never_cover_a_hologram(scene, monkeypatch):
    """Monitors are identified while nothing is shown."""
    assert bpy.ops.holopath.identify_monitors.poll()
    monkeypatch.setattr(devices, "streaming", lambda: True)
    assert not bpy.ops.holopath.identify_monitors.poll()


def test_files_give_no_pulses(device, tmp_path):
    """A controller is not even looked for."""
    device.driver, device.trigger, device.port = "files", True, str(tmp_path / "none")
    device.folder = str(tmp_path / "pictures")
    assert bpy.ops.holopath.stream() == {"FINISHED"}
    assert devices.current.counts.shown == 4


def test_virtual_bench(device, phase):
    device.driver = "virtual"
    with pytest.raises(RuntimeError, match="press Stream to Device"):
        bpy.ops.holopath.capture()
    assert bpy.ops.holopath.stream() == {"FINISHED"}
    assert devices.current.counts.shown == 4 and not devices.streaming()
    pictures = []
    for plane, distance in ((0, 80e-3), (4, 85e-3)):
        device.plane = plane
        assert bpy.ops.holopath.capture() == {"FINISHED"}
        field = phase.field(engine.Modulator(bits=8))
        expected = engine.reconstruct(field, [float(field.mapping.z_to_depth(distance))])[0]
        np.testing.assert_allclose(
            image(), session.to_rgba(expected, phase.hologram.wavelengths)[::-1], atol=1e-5
        )
        pictures.append(image())
    assert abs(pictures[0] - pictures[1]).max() > 0.2 * pictures[0][..., :3].max()
    device.plane = 5
    with pytest.raises(RuntimeError, match="got 5"):
        bpy.ops.holopath.capture()


def test_bits_of_channels(device, phase):
    """The bench sees levels of 12 bits that were spread over red and green."""
    device.driver, device.packing = "virtual", "layout"
    with pytest.raises(RuntimeError, match="bits of the channels are missing"):
        bpy.ops.holopath.stream()
    device.bit_layout, device.order = "R7-0,G7-4", "GBR"  # the order of channels does not count here
    assert bpy.ops.holopath.stream() == {"FINISHED"}
    assert devices.current.counts.shown == 4
    (level, *_), wavelengths = devices.current.driver._levels.values(), phase.hologram.wavelengths
    assert len(wavelengths) == 2 and level.dtype == np.uint16 and level.max() > 4000


def test_phases_of_a_calibrated_device_without_its_calibration(device, phase, capfd):
    phase.report["measured_levels"] = True
    device.driver = "virtual"
    assert bpy.ops.holopath.stream() == {"FINISHED"}
    assert "The phases are for the levels of a calibrated device" in capfd.readouterr().out


def test_files(device, tmp_path):
    device.driver = "files"
    with pytest.raises(RuntimeError, match="No folder"):
        bpy.ops.holopath.stream()
    assert "No folder" in devices.current.error
    device.folder = str(tmp_path / "pictures")
    assert bpy.ops.holopath.stream() == {"FINISHED"} and not devices.current.error
    assert json.loads((tmp_path / "pictures" / "pictures.json").read_text())["pictures"] == 4


def test_bad_settings(device, tmp_path):
    device.driver = "virtual"
    device.calibration = str(tmp_path / "missing.json")
    with pytest.raises(RuntimeError, match="calibration .* cannot be read"):
        bpy.ops.holopath.stream()
    device.calibration = ""
    device.driver, device.options = "slmsuite", "[1]"
    with pytest.raises(RuntimeError, match="JSON object|slmsuite needs"):
        bpy.ops.holopath.stream()
    device.driver, device.port = "serial", str(tmp_path / "port")
    with pytest.raises(RuntimeError, match="cannot be opened"):
        bpy.ops.holopath.stream()


def test_board(device, phase, tmp_path):
    """Frames, triggers, and the focus by planes that are made and calibrated here."""
    firmware = Firmware(size=(SIZE, SIZE))
    firmware.speed = 20000
    planes = tmp_path / "planes.json"
    images = len(bpy.data.images)
    with Board(firmware) as board:
        device.driver, device.port, device.baud = "serial", board.path, 1000000
        device.loops, device.trigger, device.pulse = 2, True, 250
        assert bpy.ops.holopath.stream() == {"FINISHED"}
        levels = engine.waves.modulator.gray_levels(phase.data).astype(np.uint8).reshape(4, SIZE, SIZE)
        assert [np.frombuffer(f[4], np.uint8).tolist() for f in firmware.shown] == [
            level.ravel().tolist() for level in (*levels, *levels)
        ]
        assert [wavelength for *_, wavelength, _ in firmware.shown] == [0, 1, 0, 1] * 2
        assert firmware.triggers == [(n, 250) for n in range(8)]
        with pytest.raises(RuntimeError, match="no focus planes"):
            bpy.ops.holopath.focus_plane()
        assert bpy.ops.holopath.new_planes(filepath=str(planes)) == {"FINISHED"}
        assert device.planes == str(planes)
        with pytest.raises(RuntimeError, match="exists"):
            bpy.ops.holopath.new_planes(filepath=str(planes))
        with pytest.raises(RuntimeError, match="no motor position yet"):
            bpy.ops.holopath.focus_plane()
        for plane, position in ((0, 1000), (4, 3000)):
            devices.controller(device.port, device.baud).focus(position)
            device.plane = plane
            assert bpy.ops.holopath.store_plane() == {"FINISHED"}
        stored = [row["position"] for row in json.loads(planes.read_text())["planes"]]
        assert stored == [1000, None, None, None, 3000]
        device.plane = 0
        assert bpy.ops.holopath.focus_plane() == {"FINISHED"}
        assert firmware.positions[-1] == 1000
        assert bpy.ops.holopath.stream() == {"FINISHED"}  # the port is shared
        assert len(firmware.shown) == 16
        write = f"{sys.executable} -c \"open(r'{{file}}', 'wb').write(%s)\""
        device.camera = write % "b'no picture'"
        with pytest.raises(RuntimeError, match="picture .* cannot be read"):
            bpy.ops.holopath.capture()
        assert devices.CAMERA not in bpy.data.images
        for level in (50, 200):
            gray = output.encode_png(np.full((4, 6, 3), level, np.float32), 255.0)
            (tmp_path / "gray.png").write_bytes(gray)
            device.camera = write % f"open(r'{tmp_path / 'gray.png'}', 'rb').read()"
            assert bpy.ops.holopath.capture() == {"FINISHED"}
            assert image().shape == (4, 6, 4) and len(bpy.data.images) == images + 1
        device.camera = "no-such-camera {file}"
        with pytest.raises(RuntimeError, match="does not run"):
            bpy.ops.holopath.capture()
    devices.release()


def test_another_file_lets_go(device):
    firmware = Firmware()
    with Board(firmware) as board:
        devices.controller(board.path, 115200)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        assert devices.current.controller is None and devices.current.phase is None


def test_a_stream_goes_on_after_another_render(device, monkeypatch):
    """It shows what it began with, and its watcher makes way for an auto-save as ever."""
    monkeypatch.setattr(long_modal, "_paused", {"holopath.stream": {}})
    session.keep_phase(None)
    assert bpy.ops.holopath.stream.poll()
    monkeypatch.setattr(long_modal, "_paused", {})
    assert not bpy.ops.holopath.stream.poll()
