"""A real Blender, named by HOLOPATH_BLENDER, with the built extension."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from distribution.wheels import this_platform

ROOT = Path(__file__).parents[2]
BLENDER = os.environ.get("HOLOPATH_BLENDER", "")


class Blender:
    """A Blender with its own, empty user folder."""

    def __init__(self, folder):
        self.folder = folder
        self.environment = os.environ | {
            "BLENDER_USER_RESOURCES": str(folder),
            "BLENDER_USER_EXTENSIONS": str(folder / "extensions"),
            "HOLOPATH_CACHE": "",  # as users have it: the extension's own folder, below
        }

    def __call__(self, *arguments, timeout=300):
        """Run Blender and return its status and all that it printed; it never outlives `timeout` seconds."""
        process = self.start([BLENDER, *map(str, arguments)])
        try:
            output, _ = process.communicate(timeout=timeout)
        finally:
            self.end(process)
        return process.returncode, output

    def start(self, command, more=()):
        """The process of a command that runs Blender, with more in its environment."""
        return subprocess.Popen(
            command,
            cwd=ROOT,
            env=self.environment | dict(more),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def end(self, process):
        """Whatever it still does."""
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


def python_of(blender):
    """Version of a Blender's Python, as 3.13; the first call may have to set the Blender up."""
    tell = "import sys; print('python=%d.%d' % sys.version_info[:2])"
    status, output = blender("--background", "--factory-startup", "--python-expr", tell, timeout=900)
    assert status == 0, output
    return re.search(r"^python=([\d.]+)$", output, re.MULTILINE)[1]


@pytest.fixture(scope="session", autouse=True)
def there_is_one():
    if not BLENDER:
        pytest.skip("HOLOPATH_BLENDER names no Blender")


@pytest.fixture(scope="session")
def blender(tmp_path_factory):
    """A Blender with the extension installed from its zip and enabled; for all tests, which leave it there."""
    folder = tmp_path_factory.mktemp("blender")
    blender = Blender(folder / "user")
    python = python_of(blender)
    command = [sys.executable, "-m", "distribution", "extension", "--stored", "--out", folder]
    command += ["--platform", this_platform(), "--python", python]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900, check=False)
    assert built.returncode == 0, built.stderr
    status, output = blender(
        "--command", "extension", "install-file", "-r", "user_default", "-e", built.stdout.strip()
    )
    assert status == 0, output
    return blender
