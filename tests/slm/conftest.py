"""Two virtual monitors, of an X server that these tests start."""

import pytest

from tests.monitors import NoMonitors, monitors


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
