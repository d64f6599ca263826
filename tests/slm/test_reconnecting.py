"""A serial SLM that is unplugged while pictures are shown, and plugged in again: nothing is lost or shown twice."""

import contextlib
import os
import threading
import time

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.slm import Controller, DeviceLost, Info, Sequence, SerialDriver, Stills, stream
from holopath_addon.slm.drivers import controller, serial_device
from holopath_addon.slm.drivers import link as link_module
from tests.patience import NEVER, SOON
from tests.slm.device import Board, Firmware


@pytest.fixture
def sequence():
    volume = engine.Hologram(64, 48, 8e-6, (640e-9, 520e-9))
    data = np.random.default_rng(4).uniform(0, 2 * np.pi, (4, 2, 48, 64)).astype(np.float32)
    return Sequence([engine.PhaseHologram(data, volume, engine.Camera(np.eye(4), 0.7), 0.5, "dpac", (1, 1))])


@pytest.mark.parametrize("restart", [False, True])
def test_unplugged_and_plugged_in(sequence, tmp_path, restart):
    firmware, port = Firmware(size=(64, 48)), tmp_path / "port"
    board = Board(firmware)
    port.symlink_to(board.path)
    lost, boards = [], []

    def replug():
        """Twice."""
        nonlocal board
        for shown in (20, 50):
            while len(firmware.shown) < shown:
                time.sleep(0.001)
            board.unplug()
            port.unlink()
            time.sleep(0.3)
            if restart:
                firmware.restart()
            board = Board(firmware)
            boards.append(board)
            port.symlink_to(board.path)

    def reports(counts):
        if counts.lost and counts.lost not in lost:
            lost.append(counts.lost)

    hand = threading.Thread(target=replug)
    hand.start()
    counts = stream(sequence, SerialDriver(str(port), 1000000), 150, 20, reports, patience=SOON)
    hand.join()
    boards[-1].unplug()
    assert counts.shown == 160 and counts.dropped == 0 and counts.reconnected == 2
    numbers = [frame[0] for frame in firmware.shown]
    if restart:  # what was shown, but not reported before, is shown once more
        assert len(numbers) <= 162 and sorted(set(numbers)) == list(range(160)) == list(
            dict.fromkeys(numbers)
        )
    else:
        assert numbers == list(range(160))
    for number, *_, pixels in firmware.shown:
        assert pixels == sequence.picture(number).pixels.tobytes()
    assert lost and all(text.endswith((".", "again.")) for text in lost)


def test_never_plugged_in_again(sequence, tmp_path):
    board = Board(Firmware(size=(64, 48)))
    hand = threading.Timer(0.3, board.unplug)
    hand.start()
    start = time.monotonic()
    with pytest.raises(DeviceLost):
        stream(sequence, SerialDriver(board.path, 1000000), 100, None, patience=0.6)
    assert time.monotonic() - start < SOON
    hand.join()


def test_not_there_at_first(sequence, monkeypatch):
    """Patience is for a device that was there: one that never answered is told of at once."""
    monkeypatch.setattr(controller, "START_PATIENCE", 0.5)
    with Board(None) as board:
        start = time.monotonic()
        with pytest.raises(DeviceLost, match="has not answered"):
            stream(sequence, SerialDriver(board.path, 1000000), 100, None, patience=NEVER)
        assert time.monotonic() - start < SOON


def test_focus_after_the_port_is_back(tmp_path):
    """The next command opens it again; those that failed are not done later."""
    firmware, port = Firmware(), tmp_path / "port"
    board = Board(firmware)
    port.symlink_to(board.path)
    controller = Controller(str(port), 1000000)
    controller.focus(100)
    board.unplug()
    port.unlink()
    for position in (200, 300):
        with pytest.raises(DeviceLost):
            controller.focus(position)
    with Board(firmware) as board:
        port.symlink_to(board.path)
        assert controller.position() == 100
        controller.focus(400)
        controller.close()
    assert firmware.positions == [100, 400]


@pytest.mark.parametrize("restart", [False, True])
def test_focus_after_a_restart(restart, tmp_path):
    """A controller that restarted forgot where it is, which is said once; another program's stream is no restart."""
    firmware, port = Firmware(), tmp_path / "port"
    board = Board(firmware)
    port.symlink_to(board.path)
    controller, other = Controller(str(port), 1000000), Controller(str(port), 1000000)
    controller.focus(100)
    board.unplug()
    port.unlink()
    with pytest.raises(DeviceLost):
        controller.position()
    if restart:
        firmware.restart()
    with Board(firmware) as board:
        port.symlink_to(board.path)
        other.position()
        other.close()
        if restart:
            assert controller.position() == 0
            with pytest.raises(engine.InvalidInput, match="has restarted.*it says 0, and was at 100"):
                controller.focus(200)
            assert firmware.positions == [100]
        controller.focus(200)
        controller.close()
    assert firmware.positions == [100, 200]


def test_patience_with_a_lost_trigger(sequence):
    """Pictures without their pulses are no progress."""

    class Device:
        info, opened = Info("device"), 0

        def open(self, rate, reports):
            self.opened += 1

        def show(self, number, picture):
            pass

        def close(self, finish=False):
            pass

    def trigger(number):
        if number >= 5:
            raise DeviceLost("The trigger is gone: plug it in.")

    start, device = time.monotonic(), Device()
    with pytest.raises(DeviceLost, match="trigger is gone"):
        stream(sequence, device, 100, None, trigger=trigger, patience=1.2)
    assert 1 < time.monotonic() - start < SOON and device.opened < 6


def test_a_board_that_prints_without_end(monkeypatch):
    """Text between the reports is no sign of life."""

    class Talkative(Board):
        def _step(self):
            if self.mute:
                with contextlib.suppress(BlockingIOError):
                    os.write(self.master, b"debug: all is well\r\n")
            super()._step()

    firmware = Firmware()
    with Talkative(firmware) as board:
        controller = Controller(board.path, 1000000)
        controller.trigger(0)
        os.set_blocking(board.master, False)
        monkeypatch.setattr(link_module, "PATIENCE", 0.5)
        board.mute = True
        start = time.monotonic()
        with pytest.raises(DeviceLost):
            controller.trigger(1)
        assert time.monotonic() - start < SOON
        controller.close()


def test_lost_when_all_was_shown(sequence):
    """Nothing is left to show: it ends well."""

    class Device:
        info, shown, closed = Info("device"), [], 0

        def open(self, rate, reports):
            pass

        def show(self, number, picture):
            self.shown.append(number)

        def close(self, finish=False):
            self.closed += 1
            if finish and self.closed == 1:
                raise DeviceLost("Gone at the end: plug it in.")

    device = Device()
    counts = stream(sequence, device, 200, 1, patience=SOON)
    assert device.shown == list(range(8)) and counts.reconnected == 1


def test_a_device_hears_from_the_computer_while_a_picture_is_held(monkeypatch):
    """Otherwise it would switch the laser off; nothing is sent once the driver is closed."""
    monkeypatch.setattr(serial_device, "KEEP_ALIVE", 0.05)
    with Board(Firmware()) as board, Stills(SerialDriver(board.path)) as stills:
        stills.show(np.zeros((4, 4), np.uint8), 8)
        before, end = board.received, time.monotonic() + SOON
        while board.received < before + 5 * 12:  # five times STATUS
            assert time.monotonic() < end
            time.sleep(0.01)
        stills.__exit__()
        after = board.received
        time.sleep(0.2)
        assert board.received == after
