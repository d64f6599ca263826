"""Identification of monitors."""

import threading
import time

import numpy as np
import pytest

from holopath_addon import cli
from holopath_addon.slm.drivers.identify import numeral
from tests.patience import SOON
from tests.slm.test_display import WIDTH, screenshot


@pytest.mark.parametrize(("number", "lit"), [(1, 5), (8, 13), (4, 9), (0, 12), (12, 5 + 11)])
def test_numerals(number, lit):
    """So many squares of the grid are white, all alike, within half of the height."""
    picture = numeral(number, 320, 200)
    rows, columns = np.nonzero(picture)
    side = 20
    assert set(np.unique(picture)) == {0, 255} and np.count_nonzero(picture) == lit * side**2
    assert np.ptp(rows) + 1 == 100 and rows.min() == 50
    assert len({numeral(n, 64, 64).tobytes() for n in range(100)}) == 100


def test_on_each_monitor_its_own(two_monitors, capsys):
    thread = threading.Thread(target=cli.main, args=(["devices", "--identify", "3"],))
    thread.start()
    reference = [np.repeat(numeral(n, 1920, 1080)[..., None], 3, 2) for n in (1, 2)]
    end = time.monotonic() + SOON

    def is_shown(at, picture):
        """The rest is only looked at where a part of the numeral is there."""
        part = screenshot(at + 800, 400, 200, 200) == picture[400:600, 800:1000]
        return part.all() and (screenshot(at) == picture).all()

    while not all(is_shown(at, picture) for at, picture in zip((0, WIDTH), reference, strict=True)):
        assert time.monotonic() < end and thread.is_alive()
        time.sleep(0.05)
    thread.join()
    reports = capsys.readouterr().out
    assert "  1  " in reports and "  2  " in reports
    assert not (screenshot(WIDTH) == reference[1]).all()


def test_what_is_refused(two_monitors, capsys, monkeypatch):
    assert cli.main(["devices", "--identify", "0"]) == 2
    assert "Expected a time of up to an hour" in capsys.readouterr().err
    monkeypatch.delenv("DISPLAY")
    assert cli.main(["devices", "--identify"]) == 2
