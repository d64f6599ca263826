"""A real Blender with its own, empty user folder, for tests and for pictures of the window."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from distribution.wheels import this_platform

ROOT = Path(__file__).parents[1]


class Blender:
    """A Blender with its own, empty user folder.

    Parameters
    ----------
    folder : Path
        The user folder.
    command : sequence of str
        What runs Blender.
    """

    def __init__(self, folder: Path, command: Sequence[str]):
        self.folder = folder
        self._command = list(command)
        self.environment = os.environ | {
            "BLENDER_USER_RESOURCES": str(folder),
            "BLENDER_USER_EXTENSIONS": str(folder / "extensions"),
            "HOLOPATH_CACHE": "",  # as users have it: the extension's own folder, below
        }

    def __call__(self, *arguments: object, timeout: float = 900) -> tuple[int, str]:
        """Run Blender and return its status and all that it printed; it never outlives `timeout` seconds."""
        process = self.start([*self._command, *map(str, arguments)])
        try:
            output, _ = process.communicate(timeout=timeout)
        finally:
            self.end(process)
        return process.returncode, output

    def start(self, command: Sequence[str], more: Mapping[str, str] | None = None) -> subprocess.Popen[str]:
        """The process of a command that runs Blender, with more in its environment."""
        return subprocess.Popen(
            command,
            cwd=ROOT,
            env=self.environment | dict(more or {}),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def end(self, process: subprocess.Popen[str]) -> None:
        """Whatever it still does."""
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


def python_of(blender: Blender) -> str:
    """Version of a Blender's Python, as 3.13; the first call may have to set the Blender up."""
    tell = "import sys; print('python=%d.%d' % sys.version_info[:2])"
    status, output = blender("--background", "--factory-startup", "--python-expr", tell, timeout=900)
    found = re.search(r"^python=([\d.]+)$", output, re.MULTILINE)
    assert status == 0 and found, output
    return found[1]


def install(blender: Blender, folder: Path) -> None:
    """Build the extension, install it from its zip and enable it.

    Parameters
    ----------
    blender : Blender
    folder : Path
        Where the zip goes.
    """
    command = [sys.executable, "-m", "distribution", "extension", "--stored", "--out", str(folder)]
    command += ["--platform", this_platform(), "--python", python_of(blender)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    assert built.returncode == 0, built.stderr
    words = ["extension", "install-file", "-r", "user_default", "-e", built.stdout.strip()]
    status, output = blender("--command", *words)
    assert status == 0, output
