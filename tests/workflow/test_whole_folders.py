"""Folders that several processes replace at once: always complete, and by one of them."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from holopath_addon.engine import files
from holopath_addon.engine.errors import FolderInUse
from holopath_addon.workflow import failures
from tests.patience import NEVER

ROOT = Path(__file__).parents[2]
WRITES = """
import json, os, sys, time
from pathlib import Path
from holopath_addon.workflow import output
folder, me = Path(sys.argv[1]), sys.argv[2]
end = time.monotonic() + 1
while time.monotonic() < end:
    with output.output_folder(folder) as part:
        (part / "wavefield").mkdir()
        (part / "wavefield" / "field.npy").write_text(me)
        (part / "reconstruction").mkdir()
        (part / "reconstruction" / "focus.exr").write_text(me)
        output.write_report(part, {"scene": me})
"""


def test_writers_that_meet_leave_one_whole_result(tmp_path):
    out = tmp_path / "out"
    words = [sys.executable, "-c", WRITES, str(out)]
    writers = [subprocess.Popen([*words, f"writer {n}"], cwd=ROOT, stderr=subprocess.PIPE) for n in range(3)]
    for writer in writers:
        _, error = writer.communicate(timeout=NEVER)
        assert writer.returncode == 0, error.decode()
    assert os.listdir(tmp_path) == ["out"]
    authors = {
        (out / "wavefield" / "field.npy").read_text(),
        (out / "reconstruction" / "focus.exr").read_text(),
    }
    assert len(authors) == 1 and f'"{authors.pop()}"' in (out / "report.json").read_text()
    assert sorted(os.listdir(out)) == ["reconstruction", "report.json", "wavefield"]


def test_what_was_swept_away_and_made_again_is_not_put_in_place(tmp_path):
    """A process that others took for dead has lost the files that it wrote before."""
    out = tmp_path / "out"
    with pytest.raises(FileNotFoundError), files.whole_folder(out, lambda folder: None) as part:
        (part / "first").write_text("first")
        files.sweep(out)
        part.mkdir()
        (part / "second").write_text("second")
    assert os.listdir(tmp_path) == []


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    file = tmp_path / "file"
    with files.whole_file(file) as part:
        part.write_text("before")
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "full")))
    with pytest.raises(OSError, match="full"), files.whole_file(file) as part:
        part.write_text("after")
    assert file.read_text() == "before" and os.listdir(tmp_path) == ["file"]


@pytest.fixture
def interruptible():
    """Ctrl-C works, even if a shell started the tests in the background and had them ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_a_second_interrupt_leaves_nothing_either(tmp_path, monkeypatch, kind, interruptible):
    """It comes while the leftovers of the first one are deleted."""
    remove, unlink = shutil.rmtree, Path.unlink
    monkeypatch.setattr(
        shutil, "rmtree", lambda *a, **k: (signal.raise_signal(signal.SIGINT), remove(*a, **k))
    )
    monkeypatch.setattr(Path, "unlink", lambda *a: (signal.raise_signal(signal.SIGINT), unlink(*a)))
    out = tmp_path / "out"
    whole = files.whole_folder(out, lambda _: None) if kind == "folder" else files.whole_file(out)
    with pytest.raises(KeyboardInterrupt), whole as part:
        (part / "a" if kind == "folder" else part).write_text("half")
        raise KeyboardInterrupt
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


class InUse(PermissionError):
    """Windows' error of a rename while another program has something in the folder open."""

    winerror = 32


def refused(monkeypatch, refuses):
    """Have `os.replace` refuse some renames, by source and target."""
    replace = os.replace

    def perhaps(source, target):
        if refuses(Path(source), Path(target)):
            raise InUse(13, "in use", str(source), None, str(target))
        replace(source, target)

    monkeypatch.setattr(os, "replace", perhaps)
    monkeypatch.setattr(files, "RENAME_TIMEOUT", 0.3)


def test_a_folder_in_use_for_a_moment_is_waited_for(tmp_path, monkeypatch):
    times = []

    def refuses(source, target):
        times.append(source)
        return len(times) < 3

    refused(monkeypatch, refuses)
    with files.whole_folder(tmp_path / "out", lambda folder: None) as part:
        (part / "file").write_text("made")
    assert len(times) == 3 and os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("is_new_one", [False, True])
def test_a_result_is_kept_beside_a_folder_in_use(tmp_path, monkeypatch, is_new_one):
    """Hours of work are not lost because a program has the earlier result, or the new one, open."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "file").write_text("earlier")
    (tmp_path / "out-new").mkdir()  # of the last time
    refused(
        monkeypatch,
        lambda source, target: source.name.startswith(".out.part-") if is_new_one else source == out,
    )
    with (
        pytest.raises(FolderInUse, match=r"out cannot be replaced .*(out-new1|part-\w+): close") as caught,
        files.whole_folder(out, lambda folder: None) as part,
    ):
        (part / "file").write_text("made")
    [kept] = set(tmp_path.iterdir()) - {out, tmp_path / "out-new"}
    assert failures.status(caught.value) == 1 and failures.sentence(caught.value) == str(caught.value)
    assert str(kept) in str(caught.value)
    assert (kept / "file").read_text() == "made" and (out / "file").read_text() == "earlier"


def test_new_folders_are_readable_as_their_parent(tmp_path):
    """Those of Python's `mkdtemp` are for their owner alone, on Windows also after they were renamed."""
    before = os.umask(0o022)
    try:
        first, second = files.new_folder(tmp_path, ".a-"), files.new_folder(tmp_path, ".a-")
    finally:
        os.umask(before)
    assert first != second and first.name.startswith(".a-") and first.is_dir()
    assert os.name == "nt" or first.stat().st_mode & 0o777 == 0o755


def test_files_of_browsers_are_nobodys(tmp_path):
    """macOS leaves ._NAME beside files on disks of other systems."""
    out = tmp_path / "out"
    for _ in range(2):
        with files.whole_folder(out, files.overwrite_check("a hologram", "phase.npy")) as part:
            (part / "phase.npy").touch()
        (out / "._phase.npy").touch()


def test_a_file_that_a_program_has_open_is_said_to_be():
    error = PermissionError(13, "Permission denied", ".part-1/table.csv", None, "table.csv")
    assert failures.sentence(error) == (
        "Files could not be written or read: Permission denied (table.csv). Close programs that have it open, or "
        "choose another folder."
    )
