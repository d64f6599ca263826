"""A job whose units sleep and write a file: `python -m tests.farm.toy worker` makes them."""

import os
import sys
import time
from pathlib import Path

from holopath_addon.engine import InvalidInput
from holopath_addon.engine.files import whole_folder
from holopath_addon.farm import work, worker
from holopath_addon.farm.units import Unit

TAG = "toy"


def units(words):
    """``folder seconds name[<needed]...``; a name that begins with ``bad`` is refused, with ``crash`` dies once."""
    folder, seconds, *names = words
    found = []
    for text in names:
        name, _, needs = text.partition("<")
        target = Path(folder) / name
        found.append(
            Unit(name, Make(target, float(seconds), needs), target.exists, (needs,) if needs else ())
        )
    return Path(folder), found


class Make:
    def __init__(self, target, seconds, needs):
        self.target, self.seconds, self.needs = target, seconds, needs

    def __call__(self, progress):
        print("Blender says something on standard output", flush=True)
        name, crashed = self.target.name, self.target.with_name(f"{self.target.name}.crashed")
        if name.startswith("bad"):
            raise InvalidInput(f"{name} cannot be made.")
        if name.startswith("crash") and not crashed.exists():
            crashed.touch()
            os.abort()
        if self.needs:
            assert self.target.with_name(self.needs).is_dir()
        end = time.monotonic() + self.seconds
        with whole_folder(self.target, lambda folder: None) as part:
            while time.monotonic() < end:
                time.sleep(0.02)
                progress(1 - (end - time.monotonic()) / max(self.seconds, 1e-9), "Sleeping")
            (part / "pid").write_text(str(os.getpid()))
            (part / "threads").write_text(os.environ.get("HOLOPATH_THREADS", ""))


def open_job(words, say):
    folder, found = units(words)
    opened = folder.with_name(f"{folder.name}.opened")
    if opened.exists():
        (opened / str(os.getpid())).touch()
    by_name = {unit.name: unit for unit in found}

    def make(name, progress):
        work.work_off(folder, [by_name[name]], TAG, progress, say)

    return make


if __name__ == "__main__":
    assert sys.argv[1:] == ["worker"]
    worker.serve(open_job)
