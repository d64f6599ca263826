"""Two virtual monitors, of an X server that these tests start, and patience with devices."""

import pytest

from holopath_addon.slm.drivers import controller
from holopath_addon.slm.drivers import display as display_module
from holopath_addon.slm.drivers import link as link_module
from tests.monitors import NoMonitors, monitors
from tests.patience import SOON


@pytest.fixture(scope="session")
def x_server(tmp_path_factory):
    """``DISPLAY`` of an X server with two monitors, for the whole session."""
    try:
        with monitors(tmp_path_factory.mktemp("monitors")) as display:
            yield display
    except NoMonitors as error:
        pytest.skip(str(error))


@pytest.fixture
def two_monitors(x_server, monkeypatch):
    """Programs that are started show their windows there."""
    monkeypatch.setenv("DISPLAY", x_server)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    return x_server


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """No device is lost only because other programs have the processor; tests of silence set what they wait for."""
    monkeypatch.setattr(link_module, "PATIENCE", SOON)
    monkeypatch.setattr(link_module, "PROGRESS_TIMEOUT", SOON)
    monkeypatch.setattr(controller, "WRITE_TIMEOUT", SOON)
    monkeypatch.setattr(display_module, "STALL_TIMEOUT", SOON)
