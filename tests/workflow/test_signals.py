import signal
import subprocess
import sys
import threading

import pytest

from holopath_addon.workflow.signals import ignore_signals_of_writes

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")

WRITE = """
import resource, signal, subprocess, sys
for number in (signal.SIGPIPE, signal.SIGXFSZ):
    signal.signal(number, signal.SIG_DFL)  # as in Blender
from holopath_addon.workflow.signals import ignore_signals_of_writes
if len(sys.argv) > 3:
    ignore_signals_of_writes()
reader = subprocess.Popen([sys.executable, "-c", ""], stdin=subprocess.PIPE, bufsize=0)
reader.wait()
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
with open(sys.argv[2], "wb", buffering=0) as file:
    file.write(bytes(1000))
    try:
        {"pipe": reader.stdin, "file": file}[sys.argv[1]].write(b"a picture")
    except OSError as error:
        print(type(error).__name__)
"""


@pytest.mark.parametrize(
    ("to", "error", "number"), [("pipe", "BrokenPipeError", "SIGPIPE"), ("file", "OSError", "SIGXFSZ")]
)
def test_a_write_that_fails_raises(tmp_path, to, error, number):
    """To a program that has ended, and beyond the largest size of a file; without the function they end the process."""

    def write(*words):
        command = [sys.executable, "-c", WRITE, to, str(tmp_path / "file"), *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return done.stdout.split(), done.returncode

    assert write("ignored") == ([error], 0)
    assert write() == ([], -getattr(signal, number))


def test_other_threads_and_other_handlers_are_left_alone(monkeypatch):
    calls = []
    monkeypatch.setattr(signal, "signal", lambda *words: calls.append(words))
    monkeypatch.setattr(signal, "getsignal", lambda number: print)
    ignore_signals_of_writes()
    monkeypatch.setattr(signal, "getsignal", lambda number: signal.SIG_DFL)
    thread = threading.Thread(target=ignore_signals_of_writes)
    thread.start()
    thread.join()
    assert calls == []
    ignore_signals_of_writes()
    assert calls == [(signal.SIGPIPE, signal.SIG_IGN), (signal.SIGXFSZ, signal.SIG_IGN)]
