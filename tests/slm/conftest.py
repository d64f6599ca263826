"""Two virtual monitors, of an X server that these tests start."""

import os
import select
import shutil
import subprocess
import time

import pytest

from tests.patience import NEVER

CONFIGURATION = """
Section "ServerFlags"
  Option "AutoAddDevices" "false"
  Option "AutoAddGPU" "false"
EndSection
Section "Monitor"
  Identifier "first"
  HorizSync 5-1000
  VertRefresh 5-200
  Modeline "1920x1080" 148.50 1920 2008 2052 2200 1080 1084 1089 1125 +hsync +vsync
  Option "PreferredMode" "1920x1080"
  Option "Primary" "true"
EndSection
Section "Monitor"
  Identifier "second"
  HorizSync 5-1000
  VertRefresh 5-200
  Modeline "1920x1080" 148.50 1920 2008 2052 2200 1080 1084 1089 1125 +hsync +vsync
  Option "PreferredMode" "1920x1080"
  Option "Enable" "true"
  Option "RightOf" "DUMMY0"
EndSection
Section "Device"
  Identifier "card"
  Driver "dummy"
  VideoRam 256000
  Option "Monitor-DUMMY0" "first"
  Option "Monitor-DUMMY1" "second"
EndSection
Section "Screen"
  Identifier "screen"
  Device "card"
  Monitor "first"
  DefaultDepth 24
  SubSection "Display"
    Depth 24
    Modes "1920x1080"
    Virtual 3840 1080
  EndSubSection
EndSection
"""
FIRST, SECOND = "DUMMY0", "DUMMY1"  # 1920 x 1080 each, the first at the left and primary


@pytest.fixture(scope="session")
def x_server(tmp_path_factory):
    """``DISPLAY`` of an X server with two monitors, for the whole session."""
    server = shutil.which("Xorg")
    if server is None:
        pytest.skip("Xorg is missing: run ./install_monitors.sh as root")
    folder = tmp_path_factory.mktemp("monitors")
    (folder / "xorg.conf").write_text(CONFIGURATION)
    told, tell = os.pipe()
    options = [
        "-noreset",
        "-config",
        folder / "xorg.conf",
        "-logfile",
        folder / "log",
        "-displayfd",
        str(tell),
    ]
    process = subprocess.Popen([server, *options], pass_fds=[tell], stderr=subprocess.DEVNULL)
    os.close(tell)
    number = ""
    while not number.endswith("\n") and select.select([told], [], [], 30)[0]:
        piece = os.read(told, 20).decode()
        if not piece:
            break
        number += piece
    number = number.strip()
    if not number:
        process.kill()
        process.wait()
        pytest.skip(f"Xorg's dummy driver does not start: {(folder / 'log').read_text()[-500:]}")
    time.sleep(0.5)
    yield f":{number}"
    process.terminate()
    process.wait(NEVER)
    os.close(told)  # not before: the server ends where it cannot write all of its number


@pytest.fixture
def two_monitors(x_server, monkeypatch):
    """Programs that are started show their windows there."""
    monkeypatch.setenv("DISPLAY", x_server)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    return x_server
