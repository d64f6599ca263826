import signal
import subprocess
import sys
import threading

import pytest

from holopath_addon.workflow.pipes import ignore_broken_pipes

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGPIPE")

WRITE = """
import signal, subprocess, sys
signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # as in Blender
from holopath_addon.workflow.pipes import ignore_broken_pipes
restore = ignore_broken_pipes()
reader = subprocess.Popen([sys.executable, "-c", ""], stdin=subprocess.PIPE, bufsize=0)
reader.wait()
for _ in range(2):
    try:
        reader.stdin.write(b"a picture")
    except BrokenPipeError:
        print("raised", flush=True)
    restore()
"""


def test_a_write_to_a_program_that_has_ended():
    """It raises, and after `restore` it ends the process again, as Blender had it."""
    done = subprocess.run([sys.executable, "-c", WRITE], capture_output=True, text=True, check=False)
    assert done.stdout == "raised\n" and done.returncode == -signal.SIGPIPE, done.stderr


def test_signals_are_left_alone_in_other_threads():
    before = signal.getsignal(signal.SIGPIPE)
    called = []
    thread = threading.Thread(target=lambda: called.append(ignore_broken_pipes()))
    thread.start()
    thread.join()
    called[0]()
    assert signal.getsignal(signal.SIGPIPE) is before
