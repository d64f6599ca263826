"""Output of the command line that batch systems read: signs of life, and saved files."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from holopath_addon import cli
from holopath_addon.cli import console, sources
from holopath_addon.workflow import output
from tests.farm import flamenco

ROOT = Path(__file__).parents[2]
SCENE = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="40"/>
 <transform name="to_world"><lookat origin="0,0,0" target="0,0,1" up="0,1,0"/></transform></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate y="1" angle="180"/>
 <translate z="0.5"/></transform><emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>
</scene>"""
SMALL = ["--resolution", "32x32", "--frames", "1", "--wavelengths", "516.5", "--quality", "preview"]


class Hours:
    """Clock of the console that advances while its thread waits, with events by their second."""

    def __init__(self, monkeypatch, events):
        self.now, self.events = 0.0, sorted(events.items(), reverse=True)
        monkeypatch.setattr(console, "time", self)
        monkeypatch.setattr(console.threading, "Event", lambda: self)
        monkeypatch.setattr(console.threading, "Thread", lambda target, args, daemon: self)
        with console.heartbeat():
            console._repeat(self)

    def monotonic(self):
        return self.now

    def wait(self, seconds):
        end = self.now + seconds
        while self.events and self.events[-1][0] <= end:
            self.now, happens = self.events.pop()
            happens()
        self.now = end
        return not self.events

    def start(self):
        """Method of a thread without effect: the test runs its function."""

    set = join = start


def test_silent_work_repeats_its_progress(capfd, monkeypatch):
    heard, progress = [], None

    def listen():
        heard.append(capfd.readouterr().err)

    def begin():
        nonlocal progress
        progress = console.Progress()
        progress(0.2, "Wave tracing")  # too soon to be printed by itself

    events = {
        125: listen,
        130: begin,
        310: listen,
        311: lambda: progress(1.0, "Done"),
        320: listen,
        900: listen,
    }
    Hours(monkeypatch, events)
    # No progress yet; then at 180, 240 and 300 s.
    assert heard == ["", " 20% Wave tracing (still at work)\n" * 3, "100% Done\n", ""]


def test_nothing_is_repeated_soon_after_news(capfd, monkeypatch):
    progress = []
    news = {40 * n: lambda n=n: progress[0](n / 6, "Radiance") for n in range(1, 6)}
    Hours(monkeypatch, {1: lambda: progress.append(console.Progress())} | news | {250: lambda: None})
    error = capfd.readouterr().err
    assert error.count("Radiance") == 5 and "still" not in error


def test_quiet_work_prints_nothing(capfd, monkeypatch):
    progress = console.Progress(quiet=True)
    saved = {1: lambda: progress(0.2, "Wave tracing"), 2: lambda: progress.saved(Path("/a/b.png"), 3)}
    Hours(monkeypatch, saved | {900: lambda: None})
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.0, "00:00.00"), (83.456, "01:23.45"), (3725.5, "01:02:05.50"), (59.999, "00:59.99")],
)
def test_saved_files_are_printed_as_by_blender(seconds, text, capfd):
    console.Progress().saved(Path("/films/it's new/frame.png"), seconds)
    printed = capfd.readouterr().out
    assert printed == f"Saved: '/films/it's new/frame.png'\nTime: {text}\n"
    assert flamenco.produced(printed) == ([Path("/films/it's new/frame.png")], 1)


def test_a_stills_viewable_image_is_printed(tmp_path):
    """Its name has letters that the encoding of standard output lacks."""
    (tmp_path / "scene.xml").write_text(SCENE)
    words = ["render", "scene.xml", *SMALL, "--focus", "2m,0.5m", "--out", "Füße"]
    run = subprocess.run(
        [sys.executable, "-m", "holopath_addon", *words],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    saved, took = run.stdout.decode("ascii").splitlines()
    path = saved.removeprefix("Saved: '").removesuffix("'").encode().decode("unicode_escape")
    assert Path(path) == tmp_path / "Füße" / "reconstruction" / "focus_2m.png"
    assert Path(path).read_bytes().startswith(b"\x89PNG")
    assert re.fullmatch(r"Time: \d\d:\d\d\.\d\d", took)
    assert b"100% Done in" in run.stderr


def test_a_quiet_still_prints_nothing(tmp_path, capfd):
    (tmp_path / "scene.xml").write_text(SCENE)
    words = ["render", str(tmp_path / "scene.xml"), *SMALL, "--out", str(tmp_path / "out"), "--quiet"]
    assert cli.main(words) == 0
    assert capfd.readouterr() == ("", "")
    picture = output.first_picture(tmp_path / "out", output.read_report(tmp_path / "out"))
    assert picture.is_file()


def test_an_interrupt_within_blenders_handlers_is_not_lost(empty_scene):
    """Blender would print it and go on."""
    bpy = pytest.importorskip("bpy")
    reached = []

    def handler(*_):
        signal.raise_signal(signal.SIGTERM)
        reached.append(True)

    bpy.app.handlers.frame_change_post.append(handler)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            sources.BlenderSource().go_to(3)
    finally:
        signal.signal(signal.SIGTERM, before)
        bpy.app.handlers.frame_change_post.remove(handler)
    assert reached == [True]
