"""An X server with two virtual monitors, for tests of the display and for pictures of the window."""

import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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


class NoMonitors(RuntimeError):
    """The server does not start, and why."""


@contextmanager
def monitors(folder: Path) -> Iterator[str]:
    """Start the server; it ends with the context.

    Parameters
    ----------
    folder : Path
        Where its configuration and its log go.

    Yields
    ------
    str
        Its ``DISPLAY``.

    Raises
    ------
    NoMonitors
    """
    server = shutil.which("Xorg")
    if server is None:
        raise NoMonitors("Xorg is missing: run ./install_monitors.sh as root")
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
    try:
        if not number:
            log = (folder / "log").read_text()[-500:]
            raise NoMonitors(f"Xorg's dummy driver does not start: {log}")
        time.sleep(0.5)
        yield f":{number}"
    finally:
        process.terminate()
        process.wait(NEVER)
        os.close(told)  # not before: the server ends where it cannot write all of its number
