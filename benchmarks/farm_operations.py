"""What the code of `holopath_addon.farm` asks of a file server, counted."""

from __future__ import annotations

import builtins
import io
import json
import os
import tempfile
from dataclasses import asdict
from pathlib import Path

from holopath_addon.farm import claims, work
from holopath_addon.farm.claims import FOLDER, Claim, Claims
from holopath_addon.farm.job import SharedJob
from holopath_addon.farm.units import Unit

from .farm_simulation import OPENED, PRESENT, Rules


class Operations:
    """Counts operations on files of a folder that a file server would be asked for."""

    def __init__(self, folder):
        self.count, self.found, self._folder, self._last = 0, {}, str(folder), 0

    def __enter__(self):
        self._before = {(place, name): getattr(place, name) for place, name in self._calls()}
        for (place, name), call in self._before.items():
            setattr(place, name, self._counted(call, OPENED if name == "open" else 1))
        return self

    def __exit__(self, *_):
        for (place, name), call in self._before.items():
            setattr(place, name, call)

    def since(self, name):
        """Call what there was since the last call by a name."""
        self.found[name], self._last = self.count - self._last, self.count

    def _calls(self):
        once = "open mkdir rmdir unlink remove rename replace utime chmod stat lstat listdir scandir access".split()
        return [(os, name) for name in once] + [(builtins, "open"), (io, "open")]

    def _counted(self, call, weight):
        def counted(*args, **kwargs):
            ours = bool(args) and str(args[0]).startswith(self._folder)
            self.count += ours
            result = call(*args, **kwargs)
            self.count += ours * (weight - 1)  # what a file that there is needs besides
            return result

        return counted


class _Enough(Exception):
    pass


def rules() -> Rules:
    """Count what the code in `holopath_addon.farm` asks of the file system."""
    alone, few, many = (_counts(others, 0) for others in (0, 64, 128))
    waiting = _counts(0, 64)

    def each(name):
        return (many[name] - few[name]) / 64

    def fixed(name):
        return few[name] - 64 * each(name)

    return Rules(
        **{name: fixed(name) for name in ("join", "leave", "visit")},
        **{f"{name}_each": each(name) for name in ("join", "leave", "visit")},
        **{name: alone[name] for name in ("look", "unit", "refused")},
        look_held=(many["look"] - alone["look"]) / 128,
        look_waiting=(waiting["look"] - alone["look"]) / 64,
        beat=alone["beat"] * (PRESENT + 1) / claims.TOUCH_INTERVAL,
    )


def _counts(others, waiting):
    """File operations of a process where as many others hold a unit each, and some units wait for the first one."""
    job = SharedJob("scene", {}, {}, {})
    held, late = [f"unit_{n}" for n in range(max(others, 1))], [f"late_{n}" for n in range(waiting)]
    with tempfile.TemporaryDirectory() as top:
        folder = Path(top) / "out"
        (folder / FOLDER).mkdir(parents=True)
        if others:
            job._write(folder, frozenset(held + late))
        claim = json.dumps(asdict(Claim("elsewhere", "elsewhere", 1, "1", job.digest, "0")))
        for name in [*held, *(f".{n}" for n in range(PRESENT * others))]:
            (folder / FOLDER / name).write_text(claim)
        units = [
            Unit(name, _nothing, (folder / name).exists, held[:1] if name in late else ())
            for name in held + late
        ]
        mine = Unit("mine", lambda progress: (folder / "mine").mkdir(), (folder / "mine").exists)
        with Operations(folder) as asked:
            with job.join(folder, held + late), Claims(folder, job.digest) as claimed:
                asked.since("join")
                with claimed.claim(held[0]):
                    asked.since("refused")
                mine.done()
                work._make(folder, mine, claimed, _nothing)
                asked.since("unit")
                claimed.is_lost(next(iter(claimed._own)))
                asked.since("beat")
                asked.found["look"] = _look(folder, units, job.digest, asked)
                asked.since("looks")
            asked.since("leave")
            with Claims(folder, job.digest):
                pass
            asked.since("visit")
        asked.found["beat"] += 1  # the touch
        asked.found["unit"] -= 1  # the folder that is its result
    return asked.found


def _look(folder, units, tag, asked):
    """Operations of a look at units that are all held or wait, after the first looks."""
    looks = []

    def told(done, message):
        if asked.count not in looks:  # it is told several times in a look
            looks.append(asked.count)
        if len(looks) == 3:
            raise _Enough

    poll, work.POLL = work.POLL, 0.001
    try:
        work.work_off(folder, units, tag, told, _nothing)
    except _Enough:
        return looks[2] - looks[1]
    finally:
        work.POLL = poll


def _nothing(*_):
    pass
