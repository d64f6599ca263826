import signal
import subprocess
import sys
import threading

import pytest

from holopath_addon.workflow.pipes import ignore_signals_of_writes

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")

WRITE = """
import resource, signal, subprocess, sys
for number in (signal.SIGPIPE, signal.SIGXFSZ):
    signal.signal(number, signal.SIG_DFL)  # as in Blender
from holopath_addon.workflow.pipes import ignore_signals_of_writes
if len(sys.argv) > 2:
    ignore_signals_of_writes()
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
reader = subprocess.Popen([sys.executable, "-c", ""], stdin=subprocess.PIPE, bufsize=0)
reader.wait()
with open(sys.argv[1], "wb", buffering=0) as file:
    file.write(bytes(1000))
    for writer in (reader.stdin, file):
        try:
            writer.write(b"a picture")
        except OSError as error:
            print(type(error).__name__, flush=True)
"""


def write(*words):
    done = subprocess.run([sys.executable, "-c", WRITE, *words], capture_output=True, text=True, check=False)
    return done.stdout.split(), done.returncode


def test_writes_that_fail_raise(tmp_path):
    """To a program that has ended, and beyond a file's largest size: without the function they end the process."""
    file = str(tmp_path / "file")
    assert write(file, "ignored") == (["BrokenPipeError", "OSError"], 0)
    assert write(file) == ([], -signal.SIGPIPE)


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
